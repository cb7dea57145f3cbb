"""Message layouts, from pymavlink's dialect: CRC extras, payload lengths and numpy dtypes.

The dialect `all` is imported when first asked for, not with this module.
"""

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

HIGHEST_ID = 65535
"""Message ids above this are taken for unknown (no dialect defines any)."""

KNOWN, CRC_EXTRA, MAX_LENGTH = range(3)
"""Rows of the frame table."""


def _messages() -> dict[int, Any]:
    from pymavlink.dialects.v20 import all as dialect

    return dict(dialect.mavlink_map)


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
            table[:, message_id] = 1, message.crc_extra, message.unpacker.size
    return table


@cache
def message_names() -> dict[int, str]:
    """Give the names of all messages of the dialect by id."""
    return {message_id: message.msgname for message_id, message in _messages().items()}


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
    codes = message.native_format.decode().lstrip("<")
    fields: list[Any] = []
    for field, code, count in zip(message.ordered_fieldnames, codes, message.array_lengths, strict=True):
        if code in "cs":
            fields.append((field, f"S{count or 1}"))
        else:
            fields.append((field, np.dtype(code).newbyteorder("<"), (count,) if count else ()))
    dtype = np.dtype(fields)
    assert dtype.itemsize == message.unpacker.size
    return dtype
