"""One vehicle heard over several links is one vehicle: what came over another link already is dropped.

The live service and the merging of recordings use this one rule, on frames in the order of arrival, so that what is published
and what the recordings give stay the same.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

WINDOW_US = 3_000_000
"""By how much one link may be behind another."""
MOST = 1 << 16
"""Frames remembered: those of three seconds of ten fast links."""


class Duplicates:
    """Remembers what came over which link lately."""

    def __init__(self) -> None:
        self.count = 0
        self._seen: dict[tuple[int, int, int, int, bytes], tuple[int, int]] = {}  # link and stamp, oldest first

    def dropped(self, data: NDArray[np.uint8], frames: NDArray[np.void], link: int) -> NDArray[np.void]:
        """The frames (`mavkf.link.framing.FRAME`, in the order of arrival) less those that another link brought.

        data: the bytes that their offsets refer to.
        """
        return frames[self.are_new(data, frames, np.full(len(frames), link))]

    def are_new(self, data: NDArray[np.uint8], frames: NDArray[np.void], links: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Which frames were not brought by another link within WINDOW_US: the same sender, sequence, message and content.

        What comes twice over one link is left alone. links: the number of the link of each frame.
        """
        keep = np.ones(len(frames), bool)
        names = ["offset", "stamp", "message", "length", "system", "component", "sequence"]
        for i, (values, link) in enumerate(zip(frames[names].tolist(), links.tolist(), strict=True)):
            offset, stamp, message, length, system, component, sequence = values
            key = system, component, sequence, message, data[offset : offset + length].tobytes()
            before = self._seen.get(key)
            if before is not None and before[0] != link and stamp - before[1] <= WINDOW_US:
                keep[i] = False
                continue
            self._seen.pop(key, None)
            self._seen[key] = link, stamp
            self._forget(stamp)
        self.count += int(len(frames) - keep.sum())
        return keep

    def _forget(self, now_us: int) -> None:
        while self._seen:
            oldest = next(iter(self._seen))
            if now_us - self._seen[oldest][1] <= WINDOW_US and len(self._seen) <= MOST:
                return
            del self._seen[oldest]

    def report(self) -> Iterator[str]:
        """What was dropped, in a sentence."""
        if self.count:
            yield f"{self.count} frames came over a second link too, and were used once"
