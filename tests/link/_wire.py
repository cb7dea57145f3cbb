"""Frames for tests, encoded by pymavlink."""

import struct
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import all as dialect

from mavkf.link.decode import decode
from mavkf.link.framing import scan_records

CLASSES = {message.msgname: message for message in dialect.mavlink_map.values()}


def message(name: str, **fields: Any) -> Any:
    """A message with 0 in the fields that are not given."""
    kind = CLASSES[name]
    counts = dict(zip(kind.ordered_fieldnames, kind.array_lengths, strict=True))
    values = {field: [0] * counts[field] if counts[field] else 0 for field in kind.fieldnames} | fields
    return kind(**values)


def frame(
    name: str,
    *,
    version: int = 2,
    system: int = 1,
    component: int = 1,
    sequence: int = 0,
    signed: bool = False,
    **f: Any,
) -> bytes:
    mav = dialect.MAVLink(None, srcSystem=system, srcComponent=component)
    mav.seq = sequence
    if signed:
        mav.signing.secret_key = bytes(range(32))
        mav.signing.link_id = 3
        mav.signing.timestamp = 1
        mav.signing.sign_outgoing = True
    return bytes(message(name, **f).pack(mav, force_mavlink1=version == 1))


def record(stamp_us: int, frame: bytes) -> bytes:
    return struct.pack(">Q", stamp_us) + frame


def array(raw: bytes) -> np.ndarray:
    return np.frombuffer(raw, np.uint8)


def rows_of(raw: bytes, address: tuple[int, int] = (1, 1)) -> np.ndarray:
    """Sample rows of one sender in bare frames."""
    frames, _ = scan_records(array(raw), stamped=False)
    return decode(array(raw), frames)[address]
