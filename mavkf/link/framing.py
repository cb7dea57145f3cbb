"""Find the MAVLink frames in bytes: a tlog (8-byte big-endian microseconds before each frame) or a bare stream.

MAVLink 1 and 2, signed or not. A frame counts when its CRC holds; after damage the scan goes on byte by byte until one
does, so nothing that is whole is lost to what stands before it. Every byte is accounted for in `FrameCounts`.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavkf.compiled import kernel, long_kernel
from mavkf.link.crc import frame_crc
from mavkf.link.layouts import CRC_EXTRA, HIGHEST_ID, KNOWN, MAX_LENGTH, frame_table

FRAME = np.dtype(
    [
        ("offset", np.int64),  # of the payload, bytes from the start of the data
        ("stamp", np.int64),  # arrival, microseconds UTC
        ("message", np.uint32),
        ("size", np.uint16),  # of the whole frame, header to signature, bytes
        ("length", np.uint8),  # of the payload as sent, bytes
        ("system", np.uint8),
        ("component", np.uint8),
        ("sequence", np.uint8),
        ("version", np.uint8),  # MAVLink 1 or 2
    ],
    align=True,
)
"""One frame; scanners return arrays of these."""

_PLAIN = np.dtype((np.void, FRAME.itemsize))  # concatenated ten times faster than fields are
STAMP_SIZE = 8
NO_STAMP = -1
BLOCK = 1 << 14
"""Frames found in one compiled call: what is made of them fits into the processor's cache."""

END, ARRIVAL, LAST = range(3)
"""Columns of the table of chunks."""

FRAMES, BAD_CRC, UNKNOWN, STRAY, TRUNCATED, BAD_STAMPS, FRAME_BYTES, BAD_BYTES, UNKNOWN_BYTES, TAIL_BYTES = range(10)


@dataclass(frozen=True)
class FrameCounts:
    """What the bytes were. The five counts of bytes add up to all bytes that were consumed.

    frames, frame_bytes:    frames whose CRC holds; with the stamps of a tlog.
    bad_crc, bad_bytes:     frames that are whole by their length but whose CRC does not hold.
    unknown, unknown_bytes: frames of messages that the dialect does not define (their CRC cannot be checked), followed
                            by another frame or by the end.
    stray_bytes:            bytes that belong to none of these.
    truncated, tail_bytes:  an unfinished frame at the end.
    bad_stamps:             stamps of a tlog that are missing or cannot be true; the frame's predecessor lends its own.
    """

    frames: int = 0
    bad_crc: int = 0
    unknown: int = 0
    stray_bytes: int = 0
    truncated: int = 0
    bad_stamps: int = 0
    frame_bytes: int = 0
    bad_bytes: int = 0
    unknown_bytes: int = 0
    tail_bytes: int = 0

    def as_dict(self) -> dict[str, int]:
        """Name the counts."""
        return asdict(self)


@kernel
def frame_end(data: Any, at: int) -> int:
    """Where a frame that begins at `at` would end by its header; 0: no frame begins there; -1: its header is cut."""
    if at >= data.size:
        return -1
    if data[at] == 0xFD:
        if at + 3 > data.size:
            return -1
        flags = int(data[at + 2])
        return at + 12 + int(data[at + 1]) + 13 * flags if flags <= 1 else 0
    if data[at] == 0xFE:
        return at + 8 + int(data[at + 1]) if at + 2 <= data.size else -1
    return 0


@kernel
def frame_message(data: Any, at: int) -> int:
    """Message id of the frame at `at`, whose header is whole."""
    if data[at] == 0xFD:
        return int(data[at + 7]) | int(data[at + 8]) << 8 | int(data[at + 9]) << 16
    return int(data[at + 5])


@kernel
def check(data: Any, at: int, first: bool, table: Any) -> int:
    """End of the valid frame at `at`; 0: there is none; -1: more bytes are needed to tell.

    `first` says that a frame is due here. Elsewhere an unknown message or an overlong MAVLink 1 payload cannot become a
    valid frame, so more bytes are not waited for.
    """
    end = frame_end(data, at)
    if end == 0:
        return 0
    two = data[at] == 0xFD if at < data.size else False
    header = 10 if two else 6
    if end < 0 or at + header > data.size:
        return -1
    message = frame_message(data, at)
    is_known = message <= HIGHEST_ID and table[KNOWN, message]
    if not first and (not is_known or (not two and data[at + 1] > table[MAX_LENGTH, message])):
        return 0
    if end > data.size:
        return -1
    if not is_known:
        return 0
    stop = at + header + int(data[at + 1])
    crc = int(data[stop]) | int(data[stop + 1]) << 8
    return end if frame_crc(data, at + 1, stop, table[CRC_EXTRA, message]) == crc else 0


@kernel
def classify(data: Any, begin: int, stop: int, head: int, last: bool, table: Any, counts: Any) -> None:
    """Count what data[begin:stop] is, where no valid frame begins; `last`: the data end at `stop`, for good."""
    at = begin
    in_step = True
    while at < stop:
        end = frame_end(data, at + head)
        whole = 0 < end <= stop
        if whole and (end == stop or frame_end(data, end + head) > 0):
            message = frame_message(data, at + head)
            is_known = message <= HIGHEST_ID and table[KNOWN, message]
            counts[BAD_CRC if is_known else UNKNOWN] += 1
            counts[BAD_BYTES if is_known else UNKNOWN_BYTES] += end - at
            at = end
            in_step = True
        elif last and in_step and (end < 0 or end > stop):
            counts[TRUNCATED] += 1
            counts[TAIL_BYTES] += stop - at
            at = stop
        else:
            counts[STRAY] += 1
            at += 1
            in_step = False


@long_kernel
def scan(data: Any, begin: int, head: int, last: bool, table: Any, frames: Any, counts: Any) -> tuple[int, int]:
    """Fill `frames` with the frames of data[begin:]; return how many, and the first byte not consumed.

    head: bytes of stamp before each frame (8 in a tlog, 0 in a stream). last: nothing will follow the data; otherwise
    an unfinished frame at the end is left for a next call. When `frames` is full the scan stops after the last of them.
    """
    n = 0
    while n < frames.size and begin < data.size:
        at = begin + head
        end = check(data, at, at == begin + head, table)
        if end == 0 or (end < 0 and last):
            # Nothing here. A frame may begin in what should be the stamp, too: bytes may be missing.
            at = begin
            while at < data.size:
                end = 0 if at == begin + head else check(data, at, at == begin + head, table)
                if end > 0 or (end < 0 and not last):
                    break
                at += 1
        record = at - head if at - head >= begin else at
        if end <= 0:
            stop = data.size if at >= data.size and last else max(begin, min(record, data.size))
            classify(data, begin, stop, head, last, table, counts)
            return n, stop
        classify(data, begin, record, head, last and record == data.size, table, counts)
        two = data[at] == 0xFD
        header = 10 if two else 6
        stamp = NO_STAMP
        if record < at:
            stamp = 0
            for i in range(record, at):
                stamp = stamp << 8 | int(data[i])
        frame = frames[n]
        frame.offset = at + header
        frame.stamp = stamp
        frame.message = frame_message(data, at)
        frame.size = end - at
        frame.length = data[at + 1]
        frame.sequence = data[at + header - (6 if two else 4)]
        frame.system = data[at + header - (5 if two else 3)]
        frame.component = data[at + header - (4 if two else 2)]
        frame.version = 2 if two else 1
        counts[FRAMES] += 1
        counts[FRAME_BYTES] += end - record
        n += 1
        begin = end
    return n, begin


@kernel
def scan_chunks(data: Any, chunks: Any, table: Any, frames: Any, counts: Any) -> tuple[int, int]:
    """Fill `frames` with the frames of chunks that follow each other in the data; return as `scan` does.

    chunks: (n, 3), of each its END in the data, the stamp that its frames get, and LAST, which is not 0 where nothing continues it.
    """
    n = begin = 0
    for k in range(chunks.shape[0]):
        found, begin = scan(data[: chunks[k, END]], begin, 0, chunks[k, LAST] != 0, table, frames[n:], counts)
        for i in range(n, n + found):
            frames[i].stamp = chunks[k, ARRIVAL]
        n += found
    return n, begin


def readonly(data: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Give the same bytes as a plain array that cannot be written, so that compiled code meets one type only."""
    data = np.asarray(data).view(np.ndarray)
    data.flags.writeable = False
    return data


class Scanner:
    """Finds the frames of a tlog (or, not `stamped`, of raw bytes) block by block, so that a log of any length needs little memory.

    for frames in Scanner(data): ...    # arrays of `FRAME`, in file order

    Never raises, whatever the bytes are. Stamps are as in the file: see `mavkf.link.stamps` for those that cannot be true.
    """

    def __init__(self, data: NDArray[np.uint8], *, stamped: bool = True) -> None:
        """data: uint8, mapped or in memory."""
        self._data = readonly(data)
        self._head = STAMP_SIZE if stamped else 0
        self._counts = np.zeros(len(FrameCounts.__annotations__), np.int64)
        self.position = 0
        """Bytes that are done."""

    @property
    def counts(self) -> FrameCounts:
        """Everything consumed so far."""
        return FrameCounts(*self._counts.tolist())

    def __iter__(self) -> Iterator[NDArray[np.void]]:
        table = frame_table()
        while self.position < self._data.size:
            frames = np.empty(min(BLOCK, self._data.size // 8 + 1), FRAME)
            found, self.position = scan(self._data, self.position, self._head, True, table, frames, self._counts)
            yield frames[:found]


def scan_records(data: NDArray[np.uint8], *, stamped: bool = True) -> tuple[NDArray[np.void], FrameCounts]:
    """Find all frames as a `Scanner` does, at once: array of `FRAME`, in file order, and the counts."""
    scanner = Scanner(data, stamped=stamped)
    return join_frames(list(scanner)), scanner.counts


def join_frames(parts: Sequence[NDArray[np.void]]) -> NDArray[np.void]:
    """Concatenate arrays of `FRAME`."""
    if len(parts) == 1:
        return parts[0]
    return np.concatenate([np.empty(0, _PLAIN), *(part.view(_PLAIN) for part in parts)]).view(FRAME)


class FrameStream:
    """Frames of a live byte stream (serial, TCP) or of datagrams (UDP).

    The frames do not depend on where the stream was cut into chunks. At most one unfinished frame (280 bytes) is kept.
    """

    def __init__(self) -> None:
        self._table = frame_table()
        self._pending = b""
        self._counts = np.zeros(len(FrameCounts.__annotations__), np.int64)

    @property
    def counts(self) -> FrameCounts:
        """Everything consumed since the start."""
        return FrameCounts(*self._counts.tolist())

    def push(self, chunk: bytes, arrival_us: int, *, last: bool = False) -> tuple[NDArray[np.uint8], NDArray[np.void]]:
        """Take a chunk; return the bytes that the frames' offsets refer to, and the frames completed by it.

        arrival_us: stamp of the chunk, microseconds UTC; each frame gets it. last: nothing of this frame will follow
        (a datagram, or the end of the stream), so what is unfinished is damage.
        """
        return self.push_all([(chunk, arrival_us, last)])

    def push_all(self, chunks: Iterable[tuple[bytes, int, bool]]) -> tuple[NDArray[np.uint8], NDArray[np.void]]:
        """Take several chunks at once, each with what `push` takes; the same frames come of it."""
        pieces, ends, size = [self._pending], [], len(self._pending)
        for chunk, arrival_us, last in chunks:
            pieces.append(chunk)
            size += len(chunk)
            ends.append((size, arrival_us, last))
        data = np.frombuffer(b"".join(pieces), np.uint8)
        frames = np.empty(size // 8 + 1, FRAME)
        found, consumed = scan_chunks(data, np.array(ends, np.int64).reshape(-1, 3), self._table, frames, self._counts)
        self._pending = data[consumed:].tobytes()
        return data, frames[:found]
