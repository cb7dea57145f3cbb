"""Files of RTKLIB: solutions (.pos), and a logged stream with its time tag (.tag), which says when each byte arrived."""

import struct
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from benchmarks.accuracy.common import Array

TAG_HEAD = 76  # bytes: 60 of text, tick (uint32, ms), GPS time of it (uint32, s since 1970, and float64, fraction)


@dataclass(frozen=True)
class Solution:
    """A solution, n epochs.

    t:      GPS time, s since 1970 (n).
    place:  latitude, longitude (rad), height above the ellipsoid (m), each (n).
    v_n:    m/s, frame n (n, 3).
    quality: RTKLIB's Q (n): 1 fixed, 2 float.
    sigma:  one sigma of the position per horizontal axis and vertically, m, and of the velocity per axis, m/s, each (n).
    """

    t: Array
    place: tuple[Array, Array, Array]
    v_n: Array
    quality: Array
    sigma: tuple[Array, Array, Array]


def read_solution(path: Path) -> Solution:
    """Read a .pos file with geodetic positions and, where it has them (else NaN), velocities.

    Its columns: date, time, latitude, longitude, height, Q, ns, deviations n e u ne eu un, age, ratio, speeds n e u, deviations of these.
    """
    rows = [line.split() for line in path.read_text(encoding="ascii").splitlines() if line and not line.startswith("%")]
    t = [
        datetime.strptime(f"{date} {time}", "%Y/%m/%d %H:%M:%S.%f").replace(tzinfo=UTC).timestamp()
        for date, time, *_ in rows
    ]
    (latitude, longitude, height, quality, _, *rest) = np.array([[float(x) for x in row[2:21]] for row in rows]).T
    sdn, sde, sdu = rest[:3]
    vn, ve, vu, sdvn, sdve, sdvu = rest[8:14] if len(rest) >= 14 else (np.full_like(height, np.nan),) * 6
    return Solution(
        np.array(t),
        (np.radians(latitude), np.radians(longitude), height),
        np.stack([vn, ve, -vu], axis=1),
        quality,
        (np.sqrt(0.5 * (sdn**2 + sde**2)), sdu, np.sqrt((sdvn**2 + sdve**2 + sdvu**2) / 3.0)),
    )


def arrivals(path: Path) -> Array:
    """When the end of each line (n) of a logged text stream arrived, GPS time, s since 1970, by the .tag file beside it; NaN: not known.

    After its head the tag holds pairs (uint32): ms since the head's tick, and bytes of the file there were by then.
    """
    data = path.read_bytes()
    tag = path.with_name(path.name + ".tag").read_bytes()
    _, seconds, fraction = struct.unpack_from("<IId", tag, TAG_HEAD - 16)
    count = (len(tag) - TAG_HEAD) // 8
    tick, there = np.frombuffer(tag, "<u4", 2 * count, TAG_HEAD).reshape(-1, 2).astype(np.int64).T
    ends = np.flatnonzero(np.frombuffer(data, np.uint8) == ord("\n")) + 1
    if there[-1] == len(data) + ends.size:  # the stream had CR LF where the file has LF
        ends += np.arange(1, ends.size + 1)
    first = np.searchsorted(there, ends)
    known = first < count
    result = np.full(ends.size, np.nan)
    result[known] = seconds + fraction + 1e-3 * tick[first[known]]
    return result


def clock_of(stamps: Array, arrived: Array) -> tuple[float, float]:
    """Offset (s) and rate of a clock: arrived = offset + rate * stamp + latency, the latency never negative and least where it can be.

    stamps: s on that clock (n); arrived: s (n), NaN where not known. A line through the least differences of blocks of the log.
    """
    known = np.isfinite(arrived)
    t, difference = stamps[known], (arrived - stamps)[known]
    blocks = np.array_split(np.arange(t.size), max(2, min(20, t.size // 500)))
    least = np.array([block[np.argmin(difference[block])] for block in blocks])
    middle = t[least].mean()
    slope, level = np.polyfit(t[least] - middle, difference[least], 1)
    return float(level - slope * middle), 1.0 + float(slope)
