"""Arrival stamps of a tlog, which no CRC protects, checked against their neighbours.

A log may be of any year and may jump (a recording that was paused): a stamp is believed when it follows its predecessor
within a minute, or when the stamps after it agree with it.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavkf.compiled import kernel
from mavkf.link.framing import FRAME, join_frames

NEAR_US = 60_000_000
CLOSE_US = 1_000_000
FOLLOWERS = 5
LATEST_US = 1 << 52
LONGEST_WAIT = 1 << 16  # frames: a file of bare frames has no stamps at all


@kernel
def confirmed(stamps: Any, i: int) -> bool:
    """Whether most of the next stamps are near stamp i (all of them, where the log ends)."""
    near = 0
    followers = min(FOLLOWERS, stamps.size - 1 - i)
    for j in range(i + 1, i + 1 + followers):
        if abs(stamps[j] - stamps[i]) <= NEAR_US:
            near += 1
    return bool(2 * near > followers or followers == 0)


@kernel
def repair(stamps: Any, last: int, stop: int) -> tuple[int, int]:
    """Overwrite those before index `stop` of stamps (n, int64 microseconds) that cannot be true by their predecessor's.

    last: the newest true stamp before them, -1: there was none. Returns how many were not true, and the newest that is.
    """
    bad = 0
    for i in range(stop):
        stamp = stamps[i]
        sane = 0 <= stamp < LATEST_US
        if sane and last < 0:
            sane = confirmed(stamps, i)
        elif sane and abs(stamp - last) > NEAR_US:
            sane = confirmed(stamps, i) and i + 1 < stamps.size
        elif sane and abs(stamp - last) > CLOSE_US and i + 1 < stamps.size:
            # Its two neighbours agree with each other and not with it.
            after = stamps[i + 1]
            sane = not (0 <= after - last <= CLOSE_US and abs(stamp - after) > CLOSE_US)
        if not sane:
            bad += 1
            if last >= 0:
                stamps[i] = last
            continue
        if last < 0:
            for j in range(i):
                stamps[j] = stamp
        last = stamp
    return bad, last


class StampRepair:
    """Repairs the stamps of a tlog's frames block by block; the last few of a block wait for those that follow."""

    def __init__(self) -> None:
        """Nothing has come yet."""
        self.bad = 0
        """How many were missing or could not be true."""
        self._last = -1
        self._waiting = np.empty(0, FRAME)

    def push(self, frames: NDArray[np.void], *, last: bool = False) -> NDArray[np.void]:
        """Take frames (of `FRAME`, in file order); return those whose stamps are certain by now, all if these were the last.

        A stamp is 0 where none has been true yet: a file of bare frames has none.
        """
        frames = join_frames([self._waiting, frames])
        stop = len(frames) if last else max(len(frames) - FOLLOWERS, 0)
        stamps = np.ascontiguousarray(frames["stamp"])
        bad, newest = repair(stamps, self._last, stop)
        if newest < 0 and not last and len(frames) < LONGEST_WAIT:
            self._waiting = frames  # the first that is true is lent to those before it
            return frames[:0]
        self._last = newest
        self.bad += bad
        self._waiting = frames[stop:].copy()
        frames = frames[:stop]
        frames["stamp"] = stamps[:stop] if self._last >= 0 else 0
        return frames
