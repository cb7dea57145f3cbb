"""From frames to sample rows, per sending component; and to the fields of any other message.

Stateless: the rows of a frame depend on that frame only, so a log read at once and a stream read piece by piece give
the same rows.
"""

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavkf.compiled import compiled
from mavkf.link.conversions import CONVERTERS, DecodeCounts
from mavkf.link.framing import readonly
from mavkf.link.layouts import HIGHEST_ID, message_dtype, message_ids
from mavkf.samples import ARRIVAL, ROW_WIDTH, SEQUENCE, SOURCE, Source

Address = tuple[int, int]
"""The (system, component) ids of a sender."""

ROWS_PER_FRAME = 4


@compiled
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


@cache
def _sources() -> NDArray[np.int8]:
    """`Source` of each message id, -1 for messages that give no rows."""
    sources = np.full(HIGHEST_ID + 1, -1, np.int8)
    for name in CONVERTERS:
        sources[message_ids()[name]] = Source[name]
    return sources


def decode(
    data: NDArray[np.uint8], frames: NDArray[np.void], counts: DecodeCounts | None = None
) -> dict[Address, NDArray[np.float64]]:
    """Sample rows (m, ROW_WIDTH) of each sender, in the order of its frames; TIME and SESSION are not filled.

    One frame gives at most three rows: MAGNETOMETER, BAROMETER, IMU, in this order. Messages of non-finite values are
    dropped and added to `counts`.
    """
    counts = DecodeCounts() if counts is None else counts
    sources = _sources()[frames["message"]]
    ranks, blocks = [], []
    for source in np.unique(sources):
        if source < 0:
            continue
        where = np.flatnonzero(sources == source)
        chosen = frames[where]
        name = Source(source).name
        for place, (indices, rows) in enumerate(CONVERTERS[name](gather(data, chosen, name), counts)):
            rows[:, SOURCE] = source
            rows[:, ARRIVAL] = chosen["stamp"][indices]
            rows[:, SEQUENCE] = chosen["sequence"][indices]
            ranks.append(where[indices] * ROWS_PER_FRAME + place)
            blocks.append(rows)
    if not blocks:
        return {}
    rank = np.concatenate(ranks)
    order = np.argsort(rank, kind="stable")
    senders = frames["system"].astype(np.int32) << 8 | frames["component"]
    senders = senders[rank[order] // ROWS_PER_FRAME]
    rows = np.concatenate(blocks)
    return {
        (int(sender) >> 8, int(sender) & 0xFF): rows[order[senders == sender]].reshape(-1, ROW_WIDTH)
        for sender in np.unique(senders)
    }
