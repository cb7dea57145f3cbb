"""From frames to sample rows, per sending component.

Stateless: the rows of a frame depend on that frame only, so a log read at once and a stream read piece by piece give
the same rows.
"""

from dataclasses import dataclass
from math import isfinite, nan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavkf import samples as s
from mavkf.compiled import kernel, long_kernel
from mavkf.link import conversions as c
from mavkf.link.framing import readonly
from mavkf.link.rules import FIRST_UNIX_US, NOT_FINITE, OTHER_INSTANCES, WRITTEN, message_rows
from mavkf.samples import ROW_WIDTH, Clock

Address = tuple[int, int]
"""The (system, component) ids of a sender."""

MAX_PAYLOAD = 256
SENDERS = 1 << 16  # the most there can be

NO_CLOCK, BOOT_US, BOOT_MS, UNIX = int(Clock.NONE), int(Clock.BOOT_US), int(Clock.BOOT_MS), int(Clock.UNIX_US)


@dataclass
class DecodeCounts:
    """What messages did not give.

    not_finite:       rows whose sensor value is NaN or infinite.
    other_instances:  messages of another IMU or receiver of the same component (`id` above 0).
    """

    not_finite: int = 0
    other_instances: int = 0


@kernel
def named(payload: Any, offset: int, names: Any) -> float:
    """The number of the name, of those in `names` (n, TEXT), that stands in a payload; NaN where it is none of them."""
    for k in range(names.shape[0]):
        same = True
        for i in range(c.TEXT):
            if payload[offset + i] != names[k, i]:
                same = False
                break
            if names[k, i] == 0:
                break  # what stands behind the end is not said
        if same:
            return float(k)
    return nan


@kernel
def read_values(payload: Any, floats: Any, readings: Any, names: Any, first: int, last: int, values: Any) -> None:
    """Fill values with the fields of a zero-extended payload (uint8; floats: the same memory as float32)."""
    for k in range(first, last):
        offset, kind = int(readings[k, c.OFFSET]), int(readings[k, c.TYPE])
        if kind == 0:
            raw = float(floats[offset >> 2])
        elif kind == c.TEXT:
            raw = named(payload, offset, names)
        else:
            size = abs(kind)
            bits = 0
            for i in range(size):
                bits |= int(payload[offset + i]) << 8 * i
            if kind < 0 and size < 8 and bits >> (8 * size - 1):
                bits -= 1 << 8 * size
            raw = float(bits)
            if kind == 8 and bits < 0:
                raw += 2.0**64
        unknown = raw == readings[k, c.UNKNOWN] or not isfinite(raw)
        values[int(readings[k, c.SLOT])] = nan if unknown else raw * readings[k, c.SCALE]


@kernel
def stamp(values: Any) -> tuple[float, int]:
    """STAMP and CLOCK of a message; a time of 0 is one that was not filled in."""
    if values[c.TIME_BOOT_MS] > 0:
        return values[c.TIME_BOOT_MS] * 1e3, BOOT_MS
    if values[c.TIME_USEC] > 0:
        return values[c.TIME_USEC], UNIX if values[c.TIME_USEC] >= FIRST_UNIX_US else BOOT_US
    return nan, NO_CLOCK


@kernel
def choose_frames(frames: Any, sources: Any, families: Any, chosen: Any, senders: Any) -> tuple[int, int, bool]:
    """Fill `chosen` with the indices of the frames that give rows, `senders` with who sent them: system times 256 plus component.

    Returns how many they are, how many rows they give at most, and whether the senders are in order.
    """
    n = most = 0
    in_order = True
    for i in range(frames.size):
        source = sources[frames[i].message]
        if source < 0:
            continue
        chosen[n] = i
        senders[n] = int(frames[i].system) << 8 | int(frames[i].component)
        in_order = in_order and (n == 0 or senders[n - 1] <= senders[n])
        most += c.ROWS_OF_FAMILY[families[source]]
        n += 1
    return n, most, in_order


@long_kernel
def frame_rows(
    data: Any,
    frames: Any,
    chosen: Any,
    sources: Any,
    families: Any,
    first: Any,
    readings: Any,
    names: Any,
    work: Any,
    counts: Any,
    ends: Any,
    out: Any,
) -> None:
    """Write the rows of the chosen frames (indices) to `out`; ends (of each) is how many there are then. work: of `work_space`."""
    counts[WRITTEN] = 0
    payload, floats, values = work
    for n in range(chosen.size):
        frame = frames[chosen[n]]
        source = int(sources[frame.message])
        length = int(frame.length)
        for j in range(length):
            payload[j] = data[frame.offset + j]
        for j in range(length, MAX_PAYLOAD):
            payload[j] = 0
        for j in range(c.VALUES):
            values[j] = nan
        read_values(payload, floats, readings, names, first[source], first[source + 1], values)
        time, clock = stamp(values)
        begin = counts[WRITTEN]
        message_rows(values, families[source], counts, out)
        for k in range(begin, counts[WRITTEN]):
            row = out[k]
            # A receiver without a fix has no time of measurement: ArduPilot repeats that of the last fix.
            timeless = row[s.KIND] == c.KIND_GNSS and row[s.FIX] < 2
            row[s.STAMP] = nan if timeless else time
            row[s.CLOCK] = NO_CLOCK if timeless else clock
            row[s.ARRIVAL] = frame.stamp
            row[s.SOURCE] = source
            row[s.SEQUENCE] = frame.sequence
        ends[n] = counts[WRITTEN]


@kernel
def find_senders(senders: Any, ends: Any, spans: Any) -> int:
    """Fill spans (k, 3) with each sender of frames in the order of senders, and where its rows begin and end; return how many gave any."""
    k = begin = 0
    for n in range(senders.size):
        if n + 1 < senders.size and senders[n + 1] == senders[n]:
            continue
        if ends[n] > begin:
            spans[k, 0], spans[k, 1], spans[k, 2] = senders[n], begin, ends[n]
            k += 1
        begin = ends[n]
    return k


def work_space() -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.float64]]:
    """What `frame_rows` works in: a payload, zero-extended, the same memory as floats, and the values of a message."""
    payload = np.zeros(MAX_PAYLOAD, np.uint8)
    return payload, payload.view(np.float32), np.empty(c.VALUES)


def decode(
    data: NDArray[np.uint8], frames: NDArray[np.void], counts: DecodeCounts | None = None
) -> dict[Address, NDArray[np.float64]]:
    """Sample rows (m, ROW_WIDTH) of each sender, in the order of its frames; TIME and SESSION are not filled.

    data: the bytes that the frames' offsets refer to. One frame gives at most three rows: MAGNETOMETER, BAROMETER, IMU,
    in this order. What gives no row is added to `counts`.
    """
    tables = c.tables()
    chosen, senders = np.empty(len(frames), np.int64), np.empty(len(frames), np.int64)
    count, most, in_order = choose_frames(frames, tables.sources, tables.families, chosen, senders)
    chosen, senders = chosen[:count], senders[:count]
    if not in_order:
        order = np.argsort(senders, kind="stable")
        senders, chosen = senders[order], chosen[order]
    refused, ends, out = np.zeros(WRITTEN + 1, np.int64), np.empty(count, np.int64), np.empty((most, ROW_WIDTH))
    frame_rows(readonly(data), frames, chosen, *tables, work_space(), refused, ends, out)
    spans = np.empty((min(count, SENDERS), 3), np.int64)
    spans = spans[: find_senders(senders, ends, spans)]
    if counts is not None:
        counts.not_finite += int(refused[NOT_FINITE])
        counts.other_instances += int(refused[OTHER_INSTANCES])
    return {(sender >> 8, sender & 0xFF): out[begin:end] for sender, begin, end in spans.tolist()}
