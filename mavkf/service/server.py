"""The service: links or logs in, the poses of all vehicles published, until the end or until told to stop.

A thread for each link receives and stamps; one worker, the caller's thread, does the rest. Nothing of the machine's clock
reaches an estimate but the arrival stamps, so a recording holds all that decided it: what is published equals, bit for
bit (`utc_ns` aside), what `replay --as-live` computes from the recording that was made meanwhile.
"""

import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from threading import Thread

import numpy as np
import zenoh

from mavkf.errors import LogError
from mavkf.link.framing import FrameStream
from mavkf.publish.publisher import Publisher
from mavkf.replay.tlog import read_tlog
from mavkf.service.belief import Belief
from mavkf.service.control import Control
from mavkf.service.duplicates import Duplicates
from mavkf.service.endpoints import POLL_S, Link
from mavkf.service.fleet import Fleet, Options
from mavkf.service.inbox import Chunk, Inbox
from mavkf.service.metrics import Metrics
from mavkf.service.playback import Merged, due_times, merge
from mavkf.service.recorder import Recorder
from mavkf.service.talk import Manners, Talk

Say = Callable[[str], None]


@dataclass(frozen=True)
class Records:
    """Recordings: their folder, and how large (bytes) and how long (s) a file becomes before the next is begun."""

    folder: Path
    part_bytes: float = float("inf")
    part_s: float = float("inf")


SLICE = 512  # frames of a log between two looks at whether to stop
PATIENCE_S = 5.0
LAST_CHUNKS_S = 0.3
LATE_US, CAUGHT_UP_US = 2_000_000, 200_000  # behind the arrivals by so much outputs are left out, until it is so little
TELL_LATE_S = 5.0


def serve_links(
    links: Sequence[Link],
    session: zenoh.Session,
    options: Options,
    *,
    say: Say,
    stopped: Callable[[], bool],
    belief: Belief,
    manners: Manners,
    record: Records | None = None,
) -> int:
    """Serve live links until `stopped` says so or all have ended; return how many poses were published.

    stopped: asked several times a second, and between pieces of work. record: where and how to record.
    belief: which frames are believed; manners: how the links are talked to. Raises EndpointError, InputError.
    """
    with ExitStack() as ends:
        fleet = _fleet(ends, session, options, say)
        inbox = Inbox(say)
        for link in links:  # all ports first, so that nothing runs, nor is a recording begun, if one cannot be had
            link.open()
            ends.callback(link.close)
        talks = [Talk(link, number, manners) for number, link in enumerate(links)]
        worker = Worker(fleet, links, _recorders(ends, record, [link.name for link in links], say), talks, belief)
        if options.metrics is not None:
            counts = lambda: {link.name: stream.counts for link, stream in zip(links, worker.streams, strict=True)}  # noqa: E731
            ends.callback(Metrics(options.metrics, fleet, inbox, counts, say).close)
        threads = []
        for number, link in enumerate(links):
            take = partial(inbox.put, number, patient=link.is_patient)
            threads.append(Thread(target=link.receive, args=(take,), name=link.name, daemon=True))
            threads[-1].start()
        control = Control(session, fleet, say) if options.control else None
        if control is not None:
            ends.callback(control.close)
        begin = time.monotonic()
        told = False
        while not stopped():
            if control is not None:
                control.work()
            have_ended = all(link.has_ended for link in links)
            batch = inbox.get(POLL_S)
            worker.take(batch, inbox.lag_us)
            worker.speak()
            fleet.look_after()
            if not batch:
                worker.flush()
                if have_ended:
                    break
            if not told and time.monotonic() - begin > PATIENCE_S:
                told = True
                for link, stream in zip(links, worker.streams, strict=True):
                    if stream.counts.frames == 0:
                        say(f"no MAVLink has come from {link.name} yet; it is waited for")
        for link, talk in zip(links, talks, strict=True):
            talk.leave()
            link.close()
        inbox.close()
        for thread in threads:
            thread.join(2 * POLL_S)
        for number, stream in enumerate(worker.streams):
            if stream.counts.frames:
                inbox.put(number, b"", True)  # nothing continues what is unfinished
        deadline = time.monotonic() + LAST_CHUNKS_S
        while (batch := inbox.get(0.0)) and time.monotonic() < deadline:
            worker.take(batch)
        fleet.finish()
        worker.report(say)
        return fleet.poses


def serve_logs(
    paths: Sequence[Path],
    session: zenoh.Session,
    options: Options,
    *,
    say: Say,
    stopped: Callable[[], bool],
    record: Records | None = None,
    speed: float = 1.0,
    wait_subscriber_s: float | None = None,
) -> int:
    """Serve logs, merged by stamp, as if they came now; return how many poses were published.

    speed: times the recorded pace, 0 for as fast as possible. wait_subscriber_s: how long to wait for the first reader of
    the first vehicle. Raises LogError, InputError.
    """
    logs = [read_tlog(path) for path in paths]
    vehicles = sorted({address for log in logs for address in log.vehicles()})
    if not vehicles:
        names = ", ".join(map(str, paths))
        raise LogError(f"{names}: no component sends IMU or GNSS messages; record the autopilot's own telemetry")
    with ExitStack() as ends:
        fleet = _fleet(ends, session, options, say)
        # as replay does it: the whole log tells what is a vehicle
        fleet.ignore({address for log in logs for address in log.rows} - set(vehicles))
        recorders = _recorders(ends, record, [str(path) for path in paths], say)
        publishers = fleet.declare(vehicles)
        if wait_subscriber_s is not None:
            _wait(publishers[0], wait_subscriber_s, say, stopped)
        _play(merge(logs), fleet, recorders, speed, stopped)
        fleet.finish()
        if not fleet.poses and fleet.errors:
            raise fleet.errors[0]
        return fleet.poses


def _fleet(ends: ExitStack, session: zenoh.Session, options: Options, say: Say) -> Fleet:
    fleet = Fleet(session, options, say)
    ends.callback(fleet.close)
    return fleet


def _recorders(ends: ExitStack, record: Records | None, names: Sequence[str], say: Say) -> list[Recorder]:
    recorders: list[Recorder] = []
    for name in names if record is not None else ():
        assert record is not None
        recorders.append(Recorder(record.folder, name, say, record.part_bytes, record.part_s))
        ends.callback(recorders[-1].close)
    return recorders


class Worker:
    """From chunks to the fleet: frames of each link, recorded, then handed on together in the order of arrival."""

    def __init__(
        self,
        fleet: Fleet,
        links: Sequence[Link],
        recorders: Sequence[Recorder],
        talks: Sequence[Talk],
        belief: Belief,
    ) -> None:
        self._fleet, self._links, self._recorders, self._talks, self._belief = fleet, links, recorders, talks, belief
        self.duplicates = Duplicates()
        self.streams = [FrameStream() for _ in links]
        self._late_told_s = -np.inf
        fleet.when_ended = self._end_parts

    def take(self, batch: Sequence[Chunk], lag_us: int = 0) -> None:
        """Take chunks in the order of arrival; lag_us: how much had arrived after the first of them."""
        is_late = self._fleet.is_late = lag_us > (CAUGHT_UP_US if self._fleet.is_late else LATE_US)
        if is_late and time.monotonic() - self._late_told_s > TELL_LATE_S:
            self._late_told_s = time.monotonic()
            self._fleet.warn(
                "too slow for what arrives: innovations and all poses but the newest are not published, until it has caught up"
            )
        pieces, found, base = [], [], 0
        for chunk in batch:
            data, frames = self.streams[chunk.link].push(chunk.data, chunk.arrival_us, last=chunk.last)
            if chunk.last and not chunk.data:
                self._talks[chunk.link].cut()
            frames = self._belief.signed(data, frames)
            if not len(frames):
                continue
            if self._recorders:
                self._recorders[chunk.link].write(data, frames)
            frames = self._belief.allowed(frames)
            self._talks[chunk.link].hear(data, frames, time.monotonic())
            if len(self._links) > 1:
                frames = self.duplicates.dropped(data, frames, chunk.link)
            frames["offset"] += base
            base += data.size
            pieces.append(data)
            found.append(frames)
        if found:
            self._fleet.take(np.concatenate(pieces), np.concatenate(found))

    def speak(self) -> None:
        """Send over each link what there is to say."""
        for talk in self._talks:
            talk.speak(time.monotonic(), self._fleet.given_up)

    def _end_parts(self) -> None:
        for recorder in self._recorders:
            recorder.end_part()

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


def _wait(publisher: Publisher, patience_s: float, say: Say, stopped: Callable[[], bool]) -> None:
    deadline = time.monotonic() + patience_s
    while not stopped():
        left = deadline - time.monotonic()
        if publisher.wait_for_subscriber(max(0.0, min(left, POLL_S))):
            return
        if left <= 0.0:
            say(f"nobody subscribed to mavkf/{publisher.vehicle}/pose within {patience_s:g} s; going on")
            return


def _play(
    merged: Merged, fleet: Fleet, recorders: Sequence[Recorder], speed: float, stopped: Callable[[], bool]
) -> None:
    data, frames, log = merged
    due, skipped = due_times(np.ascontiguousarray(frames["stamp"]), speed)
    if speed > 0.0 and skipped.size:
        fleet.warn(f"the stamps jump by more than 5 s {skipped.size} times; these pauses are skipped")
    begin = time.monotonic()
    i = 0
    while i < len(frames) and not stopped():
        now = time.monotonic() - begin
        stop = min(int(np.searchsorted(due, now, "right")), i + SLICE)
        if stop <= i:
            time.sleep(min(due[i] - now, POLL_S))
            continue
        for number, recorder in enumerate(recorders):
            recorder.write(data, frames[i:stop][log[i:stop] == number])
        fleet.take(data, frames[i:stop])
        i = stop
