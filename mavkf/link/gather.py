"""The fields of any message, for comparison with an estimate (ATTITUDE, SIM_STATE ...); nothing of it becomes a sample."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavkf.compiled import kernel
from mavkf.link.framing import readonly
from mavkf.link.layouts import message_dtype


@kernel
def copy_payloads(data: Any, offsets: Any, lengths: Any, out: Any) -> None:
    """Copy payloads into the rows of `out` (n, size; uint8), zero-extended or cut to its width."""
    for i in range(out.shape[0]):
        offset = offsets[i]
        count = min(int(lengths[i]), out.shape[1])
        for j in range(count):
            out[i, j] = data[offset + j]
        for j in range(count, out.shape[1]):
            out[i, j] = 0


def gather(data: NDArray[np.uint8], frames: NDArray[np.void], name: str) -> NDArray[np.void]:
    """Copy the payloads of `frames`, all of message `name`, into a structured array (see `message_dtype`)."""
    dtype = message_dtype(name)
    payloads = np.empty((len(frames), dtype.itemsize), np.uint8)
    copy_payloads(
        readonly(data), np.ascontiguousarray(frames["offset"]), np.ascontiguousarray(frames["length"]), payloads
    )
    return payloads.view(dtype).reshape(len(frames))
