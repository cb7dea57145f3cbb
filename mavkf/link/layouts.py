"""Message layouts, from pymavlink's dialect: CRC extras, payload lengths and numpy dtypes.

What is needed of the dialect `all` is kept beside the compiled code, for this version of pymavlink; it is imported once, to fill that.
"""

import tempfile
from contextlib import suppress
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from mavkf.compiled import cache_folder

HIGHEST_ID = 65535
"""Message ids above this are taken for unknown (no dialect defines any)."""

KNOWN, CRC_EXTRA, MAX_LENGTH = range(3)
"""Rows of the frame table."""


class Layout(msgspec.Struct, array_like=True, frozen=True):
    """A message: id, name, CRC extra, length with all extensions (bytes); of each field name, struct code, array length (0: none)."""

    number: int
    name: str
    crc_extra: int
    size: int
    fields: list[tuple[str, str, int]]


@cache
def _messages() -> dict[int, Layout]:
    """All messages by id, from the cache: to import the dialect takes longer than to read most logs."""
    path = cache_folder() / f"layouts-{version('pymavlink')}.json"
    try:
        found = msgspec.json.decode(path.read_bytes(), type=list[Layout])
    except (OSError, msgspec.DecodeError):
        found = _from_pymavlink()
        with suppress(OSError), tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:
            file.write(msgspec.json.encode(found))
            file.flush()
            Path(file.name).replace(path)  # whole or not at all, whoever else reads it now
    return {layout.number: layout for layout in found}


def _from_pymavlink() -> list[Layout]:
    from pymavlink.dialects.v20 import all as dialect

    return [
        Layout(
            number,
            message.msgname,
            message.crc_extra,
            message.unpacker.size,
            list(
                zip(
                    message.ordered_fieldnames,
                    message.native_format.decode().lstrip("<"),
                    message.array_lengths,
                    strict=True,
                )
            ),
        )
        for number, message in dialect.mavlink_map.items()
    ]


@cache
def frame_table() -> NDArray[np.uint8]:
    """Tabulate what a scanner must know of every message: uint8 (3, HIGHEST_ID + 1), columns are message ids.

    KNOWN:       1 where the dialect defines the message.
    CRC_EXTRA:   the byte that the CRC of this message ends with.
    MAX_LENGTH:  length of the payload with all extensions, bytes.
    """
    table = np.zeros((3, HIGHEST_ID + 1), np.uint8)
    for message_id, message in _messages().items():
        if message_id <= HIGHEST_ID:
            table[:, message_id] = 1, message.crc_extra, message.size
    return table


@cache
def message_names() -> dict[int, str]:
    """Give the names of all messages of the dialect by id."""
    return {message_id: message.name for message_id, message in _messages().items()}


@cache
def message_ids() -> dict[str, int]:
    """Give the ids of all messages of the dialect by name."""
    return {name: message_id for message_id, name in message_names().items()}


def enum_words(enum: str, value: float) -> str:
    """Put a value of an enum (MAV_TYPE ...) in words: what follows the enum's name, in lower case."""
    from pymavlink.dialects.v20 import all as dialect

    entry = dialect.enums[enum].get(int(value))
    return entry.name.removeprefix(f"{enum}_").replace("_", " ").lower() if entry else f"unknown ({value:.0f})"


@cache
def message_dtype(name: str) -> np.dtype[Any]:
    """Build the packed little-endian dtype of a message's payload, fields in wire order.

    Raises KeyError if the dialect has no message of that name.
    """
    message = _messages()[message_ids()[name]]
    fields: list[Any] = []
    for field, code, count in message.fields:
        if code in "cs":
            fields.append((field, f"S{count or 1}"))
        else:
            fields.append((field, np.dtype(code).newbyteorder("<"), (count,) if count else ()))
    dtype = np.dtype(fields)
    assert dtype.itemsize == message.size
    return dtype
