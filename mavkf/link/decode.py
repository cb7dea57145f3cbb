"""From frames to sample rows, per sending component.

Stateless: the rows of a frame depend on that frame only, so a log read at once and a stream read piece by piece give
the same rows.
"""

from dataclasses import dataclass
from math import isfinite, nan
from typing import Any, NamedTuple

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
def whole_number(payload: Any, offset: int, size: int, signed: bool) -> float:
    """A whole number of so many bytes, wherever it lies."""
    bits = 0
    for i in range(size):
        bits |= int(payload[offset + i]) << 8 * i
    if signed and size < 8 and bits >> (8 * size - 1):
        bits -= 1 << 8 * size
    return float(bits) if signed or bits >= 0 else float(bits) + 2.0**64


@kernel
def keep(raw: float, k: int, places: Any, units: Any, values: Any) -> None:
    """Put a raw value into its place, in its unit, or NaN where it is unknown."""
    unknown = raw == units[k, c.UNKNOWN] or not isfinite(raw)
    values[places[k, c.SLOT]] = nan if unknown else raw * units[k, c.SCALE]


@kernel
def read_values(work: Any, runs: Any, places: Any, units: Any, names: Any, first: int, last: int, values: Any) -> None:
    """Fill values with the fields of the payload, those of one type after those of another: no field asks for its type."""
    payload = work.payload
    for r in range(first, last):
        kind, begin, end = runs[r, c.TYPE], runs[r, c.BEGIN], runs[r, c.END]
        if kind == -2:
            for k in range(begin, end):
                keep(float(work.int16[places[k, c.OFFSET] >> 1]), k, places, units, values)
        elif kind == 0:
            for k in range(begin, end):
                keep(float(work.float32[places[k, c.OFFSET] >> 2]), k, places, units, values)
        elif kind == 2:
            for k in range(begin, end):
                keep(float(work.uint16[places[k, c.OFFSET] >> 1]), k, places, units, values)
        elif kind == -4:
            for k in range(begin, end):
                keep(float(work.int32[places[k, c.OFFSET] >> 2]), k, places, units, values)
        elif kind == 4:
            for k in range(begin, end):
                keep(float(work.uint32[places[k, c.OFFSET] >> 2]), k, places, units, values)
        elif kind == c.TEXT:
            for k in range(begin, end):
                keep(named(payload, places[k, c.OFFSET], names), k, places, units, values)
        else:
            for k in range(begin, end):
                number = whole_number(payload, places[k, c.OFFSET], abs(kind) % c.SPLIT, kind < 0)
                keep(number, k, places, units, values)


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
    runs: Any,
    places: Any,
    units: Any,
    names: Any,
    work: Any,
    counts: Any,
    ends: Any,
    out: Any,
) -> None:
    """Write the rows of the chosen frames (indices) to `out`; ends (of each) is how many there are then. work: of `work_space`."""
    counts[WRITTEN] = 0
    payload = work.payload
    for n in range(chosen.size):
        frame = frames[chosen[n]]
        source = int(sources[frame.message])
        length = int(frame.length)
        for j in range(length):
            payload[j] = data[frame.offset + j]
        for j in range(length, MAX_PAYLOAD):
            payload[j] = 0
        values = work.values[source]  # a message overwrites all that the one before it has read
        read_values(work, runs, places, units, names, first[source], first[source + 1], values)
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


class WorkSpace(NamedTuple):
    """A payload, zero-extended, the same memory as other numbers, and the values of a message of each source."""

    payload: NDArray[np.uint8]
    uint16: NDArray[np.uint16]
    int16: NDArray[np.int16]
    uint32: NDArray[np.uint32]
    int32: NDArray[np.int32]
    float32: NDArray[np.float32]
    values: NDArray[np.float64]


def work_space() -> WorkSpace:
    """What `frame_rows` works in."""
    payload = np.zeros(MAX_PAYLOAD, np.uint8)
    return WorkSpace(
        payload,
        payload.view(np.uint16),
        payload.view(np.int16),
        payload.view(np.uint32),
        payload.view(np.int32),
        payload.view(np.float32),
        np.full((len(c.MESSAGES), c.VALUES), nan),
    )


def decode(
    data: NDArray[np.uint8],
    frames: NDArray[np.void],
    counts: DecodeCounts | None = None,
    messages: frozenset[s.Source] = c.ALL,
) -> dict[Address, NDArray[np.float64]]:
    """Sample rows (m, ROW_WIDTH) of each sender, in the order of its frames; TIME and SESSION are not filled.

    data: the bytes that the frames' offsets refer to. One frame gives at most three rows: MAGNETOMETER, BAROMETER, IMU,
    in this order. What gives no row is added to `counts`. messages: those that are read, of all there are.
    """
    tables = c.tables(messages)
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
