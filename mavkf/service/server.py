"""The service: links or logs in, the poses of all vehicles published, until the end or until told to stop.

A thread for each link receives and stamps; one worker, the caller's thread, does the rest. Nothing of the machine's clock
reaches an estimate but the arrival stamps, so a recording holds all that decided it: what is published equals, bit for
bit (`utc_ns` aside), what `replay --as-live` computes from the recording that was made meanwhile.
"""

import gc
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from threading import Thread
from typing import Literal

import numpy as np
import zenoh

from mavkf.errors import LogError
from mavkf.link.framing import FrameStream
from mavkf.publish.publisher import Publisher
from mavkf.replay.tlog import read_tlog
from mavkf.service.belief import Belief
from mavkf.service.control import Control
from mavkf.service.endpoints import POLL_S, Link
from mavkf.service.feedback import Feedback
from mavkf.service.fleet import Fleet, Options
from mavkf.service.inbox import Inbox
from mavkf.service.metrics import Metrics
from mavkf.service.playback import Merged, due_times, merge
from mavkf.service.recorder import Recorder
from mavkf.service.talk import Manners, Talk
from mavkf.service.worker import Worker

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
CARE_S = 0.05  # between two looks at who has fallen silent and what there is to say


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
    feedback: Link | Literal["vehicle"] | None = None,
) -> int:
    """Serve live links until `stopped` says so or all have ended; return how many poses were published.

    stopped: asked several times a second, and between pieces of work. record: where and how to record.
    belief: which frames are believed; manners: how the links are talked to. feedback: where the poses are sent back to as
    ODOMETRY, None: nowhere. Raises EndpointError, InputError.
    """
    with ExitStack() as ends:
        fleet = _fleet(ends, session, options, say)
        inbox = Inbox(say)
        streams = [FrameStream() for _ in links]
        if options.metrics is not None:
            counts = lambda: {link.name: stream.counts for link, stream in zip(links, streams, strict=True)}  # noqa: E731
            ends.callback(Metrics(options.metrics, fleet, inbox, counts, say).close)
        for link in links:  # all ports first, so that nothing runs, nor is a recording begun, if one cannot be had
            link.open()
            ends.callback(link.close)
        talks = [Talk(link, number, manners) for number, link in enumerate(links)]
        worker = Worker(
            fleet, links, _recorders(ends, record, [link.name for link in links], say), talks, belief, streams
        )
        if feedback is not None:
            ends.enter_context(_feeding(feedback, talks, manners, fleet))
        threads = []
        for number, link in enumerate(links):
            take = partial(inbox.put, number, patient=link.is_patient)
            threads.append(Thread(target=link.receive, args=(take,), name=link.name, daemon=True))
            threads[-1].start()
        control = Control(session, fleet, say) if options.control else None
        if control is not None:
            ends.callback(control.close)
        ends.callback(gc.unfreeze)
        gc.freeze()  # modules and machine code stay: to look at them again and again would hold up what comes
        begin = time.monotonic()
        due, told = begin, False
        while not stopped():
            if control is not None:
                control.work()
            have_ended = all(link.has_ended for link in links)
            batch = inbox.get(POLL_S)
            worker.take(batch, inbox.lag_us)
            if (now := time.monotonic()) >= due:  # not with each datagram: it is work for every vehicle
                due = now + CARE_S
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


@contextmanager
def _feeding(to: Link | Literal["vehicle"], talks: Sequence[Talk], manners: Manners, fleet: Fleet) -> Iterator[None]:
    """Send the poses back while this lasts."""
    if to == "vehicle":
        fleet.when_published = Feedback(talks, True, manners.say).take
        yield
        return
    to.open()
    reader = Thread(
        target=to.receive, args=(lambda _, __: None,), name=to.name, daemon=True
    )  # what it says is not heard
    reader.start()
    fleet.when_published = Feedback([Talk(to, len(talks), manners)], False, manners.say).take
    try:
        yield
    finally:
        to.close()
        reader.join(2 * POLL_S)


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
