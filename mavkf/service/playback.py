"""Logs in place of a link: merged by arrival, and when each frame is due."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavkf.link.decode import DecodeCounts, decode
from mavkf.link.framing import BLOCK, FrameCounts
from mavkf.replay.tlog import Block, Log, TlogReader, read_tlog
from mavkf.service.duplicates import Duplicates
from mavkf.service.recorder import label_of

LONGEST_WAIT_US = 5_000_000
"""A step of the stamps longer than this is a pause of the recording, or damage; nobody wants to sit through it."""


class Merged(NamedTuple):
    """Several logs as one.

    data: the bytes of all; frames: of all, in the order of arrival, offsets into `data`; log: the number of each frame's.
    """

    data: NDArray[np.uint8]
    frames: NDArray[np.void]
    log: NDArray[np.int64]


def merge(logs: Sequence[Log]) -> Merged:
    """Merge logs by stamp, ties in argument order; the order within each file stays, even where its stamps fall.

    What came over several links is taken once (`mavkf.service.duplicates`).
    """
    if len(logs) == 1:
        return Merged(logs[0].data, logs[0].frames, np.zeros(len(logs[0].frames), np.int64))
    parts, base = [], 0
    for log in logs:
        frames = log.frames.copy()
        frames["offset"] += base
        base += log.data.size
        parts.append(frames)
    order = np.argsort(np.concatenate([np.maximum.accumulate(part["stamp"]) for part in parts]), kind="stable")
    numbers = np.repeat(np.arange(len(logs)), [len(part) for part in parts])
    data, frames, numbers = np.concatenate([log.data for log in logs]), np.concatenate(parts)[order], numbers[order]
    new = Duplicates().are_new(data, frames, _links(logs)[numbers])
    return Merged(data, frames[new], numbers[new])


def _links(logs: Sequence[Log]) -> NDArray[np.int64]:
    """The number of each log's link: recordings of one link may be in several parts."""
    labels = [label_of(log.path) for log in logs]
    return np.array([k if label is None else labels.index(label) for k, label in enumerate(labels)])


class MergedReader:
    """The tlogs of several links of one flight, read as one log, merged as a service that heard them all took them.

    As `mavkf.replay.tlog.TlogReader`, but for the memory: which frames are in which log has to be known first.
    """

    def __init__(self, paths: Sequence[Path]) -> None:
        """Raises LogError."""
        logs = [read_tlog(path) for path in paths]
        self._merged = merge(logs)
        self._done = 0
        self.name = " + ".join(map(str, paths))
        self.size = sum(log.size for log in logs)
        self.damage = FrameCounts(
            *(sum(counts) for counts in zip(*(log.damage.as_dict().values() for log in logs), strict=True))
        )
        self.refused = DecodeCounts()

    def __iter__(self) -> Iterator[Block]:
        data, frames, _ = self._merged
        for first in range(0, len(frames), BLOCK):
            some = frames[first : first + BLOCK]
            yield Block(some, decode(data, some, self.refused))
            self._done = first + len(some)

    @property
    def share(self) -> float:
        """Of the frames that is read, 0 to 1."""
        return self._done / max(len(self._merged.frames), 1)


def reader_of(paths: Sequence[Path]) -> TlogReader | MergedReader:
    """Give what reads the logs of one flight block by block. Raises LogError."""
    return TlogReader(paths[0]) if len(paths) == 1 else MergedReader(paths)


def due_times(stamps: NDArray[np.int64], speed: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """When each frame is due, s after the first, from stamps (microseconds) played at `speed` (0: all at once).

    Steps back take no time, nor do steps of more than LONGEST_WAIT_US; the second array holds the frames after those.
    """
    steps = np.diff(stamps, prepend=stamps[:1])
    skipped = np.flatnonzero(np.abs(steps) > LONGEST_WAIT_US)
    steps = np.where((steps > 0) & (steps <= LONGEST_WAIT_US), steps, 0)
    due = np.cumsum(steps) * 1e-6 / speed if speed > 0.0 else np.zeros(len(steps))
    return due, skipped
