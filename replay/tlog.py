"""Read a tlog: find its frames, decode its samples, and say what is in it."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavkf.ahead import Ahead
from mavkf.errors import LogError
from mavkf.link.decode import Address, DecodeCounts, decode
from mavkf.link.framing import FRAME, FrameCounts, Scanner, join_frames
from mavkf.link.gather import gather
from mavkf.link.layouts import message_ids, message_names
from mavkf.link.stamps import StampRepair
from mavkf.samples import KIND, Kind, Source
from mavkf.service.senders import is_vehicle


@dataclass(frozen=True)
class MessageCount:
    """How often one component sent one message: name, number of frames, and rate over the log (Hz, by arrival)."""

    name: str
    count: int
    rate_hz: float


@dataclass(frozen=True)
class Log:
    """A log in memory; payloads stay in the mapped file.

    path, size:  the file, bytes.
    data:        its bytes (uint8, mapped).
    frames:      its frames in file order (`mavkf.link.framing.FRAME`), stamps repaired (all 0 in a file of
                 bare frames, which has none).
    damage:      what its bytes were.
    refused:     messages that gave no rows.
    rows:        sample rows of each (system, component), in file order, without TIME and SESSION.
    """

    path: Path
    size: int
    data: NDArray[np.uint8] = field(repr=False)
    frames: NDArray[np.void] = field(repr=False)
    damage: FrameCounts
    refused: DecodeCounts
    rows: dict[Address, NDArray[np.float64]] = field(repr=False)

    @property
    def first_us(self) -> int:
        """Arrival of the first frame, microseconds UTC."""
        return int(self.frames["stamp"][0])

    @property
    def duration_s(self) -> float:
        """Arrival of the last frame after the first, seconds."""
        return float(self.frames["stamp"][-1] - self.frames["stamp"][0]) * 1e-6

    @cached_property
    def message_counts(self) -> dict[Address, list[MessageCount]]:
        """What each component sent, most frequent first."""
        f = self.frames
        keys = f["system"].astype(np.int64) << 40 | f["component"].astype(np.int64) << 32 | f["message"]
        result: dict[Address, list[MessageCount]] = {}
        for key, count in zip(*np.unique(keys, return_counts=True), strict=True):
            address = int(key) >> 40, int(key) >> 32 & 0xFF
            rate = (int(count) - 1) / self.duration_s if self.duration_s > 0 else 0.0
            result.setdefault(address, []).append(
                MessageCount(message_names()[int(key) & 0xFFFFFFFF], int(count), rate)
            )
        return {address: sorted(counts, key=lambda c: (-c.count, c.name)) for address, counts in result.items()}

    def messages(self, system: int, component: int, name: str) -> tuple[NDArray[np.void], NDArray[np.int64]]:
        """Give all messages called `name` of one component: structured array and arrival stamps (microseconds UTC).

        For comparison (ATTITUDE, SIM_STATE ...); nothing of it enters an estimate. Raises KeyError if the dialect has
        no such message.
        """
        f = self.frames
        chosen = f[(f["message"] == message_ids()[name]) & (f["system"] == system) & (f["component"] == component)]
        return gather(self.data, chosen, name), chosen["stamp"].copy()

    def vehicles(self) -> list[Address]:
        """List the components that sent IMU or GNSS samples and do not say that they are something else, in order."""
        return sorted(address for address, rows in self.rows.items() if _is_vehicle(rows))


def _is_vehicle(rows: NDArray[np.float64]) -> bool:
    return bool(np.isin(rows[:, KIND], (Kind.IMU, Kind.GNSS)).any()) and is_vehicle(rows) is not False


class Block(NamedTuple):
    """A piece of a log: its frames, in file order, stamps repaired; the sample rows that they give, as of `Log`."""

    frames: NDArray[np.void]
    rows: dict[Address, NDArray[np.float64]]


class TlogReader:
    """Reads a tlog of any MAVLink version, whole or damaged, block by block: a log of any length needs little memory.

    Another thread looks for the next frames while the last are decoded.

    reader = TlogReader(path)
    for block in reader: ...
    reader.damage, reader.refused    # complete once all blocks are read
    """

    def __init__(self, path: Path, messages: Iterable[Source] = tuple(Source)) -> None:
        """messages: those that give rows, or are counted as refused; frames are found of all.

        Raises LogError if the file cannot be opened or is empty.
        """
        self.path = Path(path)
        self.name = str(self.path)
        self.data = map_log(self.path)
        self.size = int(self.data.size)
        self.refused = DecodeCounts()
        self._messages = frozenset(messages)
        self._scanner, self._stamps = Scanner(self.data), StampRepair()

    def __iter__(self) -> Iterator[Block]:
        """The blocks. Raises LogError at the end if the file holds no MAVLink frame."""
        with Ahead(iter(self._scanner)) as scanned:
            for found in chain(scanned, (None,)):
                frames = self._stamps.push(np.empty(0, FRAME) if found is None else found, last=found is None)
                yield Block(frames, decode(self.data, frames, self.refused, self._messages))
        if self._scanner.counts.frames == 0:
            raise LogError(f"{self.path} holds no MAVLink frame; give a telemetry log (.tlog) of a ground station.")

    @property
    def damage(self) -> FrameCounts:
        """What the bytes were, as far as they are read."""
        return replace(self._scanner.counts, bad_stamps=self._stamps.bad)

    @property
    def share(self) -> float:
        """Of the file that is read, 0 to 1."""
        return self._scanner.position / self.size


def read_tlog(path: Path, progress: Callable[[float], object] = lambda share: None) -> Log:
    """Read a whole tlog into memory. progress: called with the share that is read. Raises LogError as `TlogReader` does."""
    reader = TlogReader(path)
    frames, rows = [], dict[Address, list[NDArray[np.float64]]]()
    for block in reader:
        frames.append(block.frames)
        for address, found in block.rows.items():
            rows.setdefault(address, []).append(found)
        progress(reader.share)
    joined = {address: np.concatenate(rows.pop(address)) for address in sorted(rows)}
    return Log(reader.path, reader.size, reader.data, join_frames(frames), reader.damage, reader.refused, joined)


def map_log(path: Path) -> NDArray[np.uint8]:
    """Map a file's bytes (uint8). Raises LogError if there is no such file, or it is empty or cannot be read."""
    if path.is_dir():
        raise LogError(f"{path} is a folder; give one log file inside it.")
    try:
        if path.stat().st_size == 0:
            raise LogError(f"{path} is empty; nothing was recorded into it, so give another log.")
        return np.memmap(path, np.uint8, "r")
    except FileNotFoundError:
        raise LogError(f"{path} does not exist; check the name and the folder.") from None
    except PermissionError:
        raise LogError(f"{path} may not be read by this user; change its permissions or copy it.") from None
    except (OSError, ValueError) as error:
        raise LogError(f"{path} cannot be read ({error}); give a regular file on a healthy disk.") from None
