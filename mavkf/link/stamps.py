"""Arrival stamps of a tlog, which no CRC protects, checked against their neighbours.

A log may be of any year and may jump (a recording that was paused): a stamp is believed when it follows its predecessor
within a minute, or when the stamps after it agree with it.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavkf.compiled import kernel

NEAR_US = 60_000_000
CLOSE_US = 1_000_000
FOLLOWERS = 5
LATEST_US = 1 << 52


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
def repair(stamps: Any) -> int:
    """Overwrite stamps (n, int64 microseconds) that cannot be true by their predecessor's; return how many."""
    bad = 0
    last = -1
    for i in range(stamps.size):
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
    return bad


def repair_stamps(frames: NDArray[np.void]) -> int:
    """Repair the stamps of a tlog's frames in place; return how many were missing or could not be true."""
    stamps = np.ascontiguousarray(frames["stamp"])
    bad = int(repair(stamps))
    frames["stamp"] = stamps
    return bad
