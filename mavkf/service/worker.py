"""The one worker of live links: chunks in, in the order of arrival; frames recorded, believed, and handed to the vehicles."""

import time
from collections.abc import Callable, Sequence
from itertools import groupby

import numpy as np

from mavkf.link.framing import FrameStream, join_frames
from mavkf.service.belief import Belief
from mavkf.service.duplicates import Duplicates
from mavkf.service.endpoints import Link
from mavkf.service.fleet import Fleet
from mavkf.service.inbox import Chunk
from mavkf.service.recorder import Recorder
from mavkf.service.talk import Talk

Say = Callable[[str], None]
LATE_US, CAUGHT_UP_US = 2_000_000, 200_000  # behind the arrivals by so much outputs are left out, until it is so little
TELL_LATE_S = 5.0


class Worker:
    """From chunks to the fleet: frames of each link, recorded, then handed on together in the order of arrival."""

    def __init__(
        self,
        fleet: Fleet,
        links: Sequence[Link],
        recorders: Sequence[Recorder],
        talks: Sequence[Talk],
        belief: Belief,
        streams: Sequence[FrameStream],
    ) -> None:
        self._fleet, self._links, self._recorders, self._talks, self._belief = fleet, links, recorders, talks, belief
        self.duplicates = Duplicates()
        self.streams = streams
        self._late_told_s = -np.inf
        fleet.when_ended = self._session_ended

    def take(self, batch: Sequence[Chunk], lag_us: int = 0) -> None:
        """Take chunks in the order of arrival; lag_us: how much had arrived after the first of them."""
        is_late = self._fleet.is_late = lag_us > (CAUGHT_UP_US if self._fleet.is_late else LATE_US)
        if is_late and time.monotonic() - self._late_told_s > TELL_LATE_S:
            self._late_told_s = time.monotonic()
            self._fleet.warn(
                "too slow for what arrives: innovations and all poses but the newest are not published, until it has caught up"
            )
        pieces, found, base = [], [], 0
        for (link, is_end), chunks in groupby(batch, _stretch):
            data, frames = self.streams[link].push_all([(one.data, one.arrival_us, one.last) for one in chunks])
            if is_end:
                self._talks[link].cut()
            frames = self._belief.signed(data, frames)
            if not len(frames):
                continue
            if self._recorders:
                self._recorders[link].write(data, frames)
            frames = self._belief.allowed(frames)
            self._talks[link].hear(data, frames, time.monotonic())
            if len(self._links) > 1:
                frames = self.duplicates.dropped(data, frames, link)
            frames["offset"] += base
            base += data.size
            pieces.append(data)
            found.append(frames)
        if found:
            self._fleet.take(pieces[0] if len(pieces) == 1 else np.concatenate(pieces), join_frames(found))

    def speak(self) -> None:
        """Send over each link what there is to say."""
        for talk in self._talks:
            talk.speak(time.monotonic(), self._fleet.given_up)

    def _session_ended(self) -> None:
        for recorder in self._recorders:
            recorder.end_part()
        for talk in self._talks:
            talk.session_ended()

    def flush(self) -> None:
        """Hand what is recorded to the operating system."""
        for recorder in self._recorders:
            recorder.flush()

    def report(self, say: Say) -> None:
        """Say what of each link was damaged."""
        for link, stream in zip(self._links, self.streams, strict=True):
            counts = stream.counts
            if counts.bad_crc or counts.stray_bytes or counts.truncated:
                say(
                    f"{link.name}: beside {counts.frames} frames {counts.bad_crc} with a bad CRC, "
                    f"{counts.truncated} unfinished, {counts.stray_bytes} stray bytes"
                )
            if link.unsent:
                say(f"{link.name}: {link.unsent} messages could not be sent")
        for text in (*self._belief.report(), *self.duplicates.report()):
            say(text)
        left_out = self._fleet.unpublished
        if left_out:
            say(
                f"{left_out['pose']} poses and {left_out['innovation']} innovations were not published: there was no time"
            )


def _stretch(chunk: Chunk) -> tuple[int, bool]:
    """What chunks that are taken at once have in common: their link, and whether they are its end."""
    return chunk.link, chunk.last and not chunk.data
