"""The CRC of MAVLink frames (X.25, reflected, initial value 0xFFFF), eight bytes a step."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavkf.compiled import kernel


def _slices() -> NDArray[np.int32]:
    """Eight tables (8, 256): entry [k, b] is the CRC of byte b followed by k zero bytes."""
    tables = np.zeros((8, 256), np.int32)
    for byte in range(256):
        crc = byte
        for _ in range(8):
            crc = (crc >> 1) ^ (0x8408 if crc & 1 else 0)
        tables[0, byte] = crc
    for k in range(1, 8):
        tables[k] = (tables[k - 1] >> 8) ^ tables[0, tables[k - 1] & 0xFF]
    return tables


SLICES = _slices()


@kernel
def frame_crc(data: Any, start: int, stop: int, extra: int) -> int:
    """CRC of data[start:stop] (uint8) followed by the message's CRC extra."""
    crc = 0xFFFF
    i = start
    while i + 8 <= stop:
        crc ^= int(data[i]) | int(data[i + 1]) << 8
        crc = int(
            SLICES[7, crc & 0xFF]
            ^ SLICES[6, crc >> 8]
            ^ SLICES[5, data[i + 2]]
            ^ SLICES[4, data[i + 3]]
            ^ SLICES[3, data[i + 4]]
            ^ SLICES[2, data[i + 5]]
            ^ SLICES[1, data[i + 6]]
            ^ SLICES[0, data[i + 7]]
        )
        i += 8
    while i < stop:
        crc = crc >> 8 ^ SLICES[0, (crc ^ int(data[i])) & 0xFF]
        i += 1
    return int(crc >> 8 ^ SLICES[0, (crc ^ int(extra)) & 0xFF])
