"""`mavkf replay`: estimate from a log at full speed."""

import math
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from mavkf.cli._console import Connect, Listen, ZenohConfig, compile_first, messages, say
from mavkf.config import Config, read_config, with_settings
from mavkf.config import settings as known_settings
from mavkf.errors import UsageError
from mavkf.estimate import Pose, Record
from mavkf.publish.records import encode
from mavkf.replay.export import CsvFile
from mavkf.replay.faults import describe, parse_fault
from mavkf.replay.options import NOBODY, Options, Watch, imu_source
from mavkf.replay.results import Result
from mavkf.replay.run import run
from mavkf.replay.summary import estimated, summarise
from mavkf.replay.tlog import map_log
from mavkf.service.vehicle import Step, VehicleStream

LONG_BYTES = 20_000_000  # files from here on get a progress bar


def replay(  # noqa: D417 (the rest is described in _console)
    *logs: Path,
    csv: Path | None = None,
    jsonl: Path | None = None,
    as_live: bool = False,
    smooth: bool = False,
    form: str | None = None,
    update: str | None = None,
    start: Annotated[float, Parameter(name="--from")] = -math.inf,
    end: Annotated[float, Parameter(name="--to")] = math.inf,
    rate: float = 50.0,
    vehicle: str | None = None,
    session: int | None = None,
    imu: str | None = None,
    model: str | None = None,
    config: Path | None = None,
    set: tuple[str, ...] = (),
    settings: bool = False,
    fault: tuple[str, ...] = (),
    faults: bool = False,
    plot: Path | None = None,
    truth: Path | None = None,
    json: bool = False,
    diagnose: bool = False,
    publish: bool = False,
    connect: Connect = (),
    listen: Listen = (),
    zenoh_config: ZenohConfig = None,
) -> int:
    """Estimate from a log (tlog) at full speed and say what was found.

    Samples are taken in the order in which they were measured; with --as-live in the order in which they arrived, and each pose is
    what a live run would have published at that moment. Exit code 1 if nothing could be estimated.

    Args:
        logs: A log, or the recordings of several links of one flight, which are merged by arrival.
        csv: Write the estimates to this file.
        jsonl: Write the pose records to this file, one JSON object a line, as they are published (implies --as-live).
        as_live: Feed the samples in their order of arrival.
        smooth: Let each pose rest on the whole flight, what came later included.
        form: Run the flight with this form of the filter, as ud (any other name lists them).
        update: first, iterated or second-order: the order of the updates.
        start: Use samples from this boot time on, s.
        end: Use samples up to this boot time, s.
        rate: Rows (poses) a second of boot time; 0 for every step.
        vehicle: Only this vehicle, as 1-1.
        session: Only this session (boot), from 0.
        imu: Use this IMU message, as RAW_IMU.
        model: strapdown, telemetry or constant-velocity, instead of the automatic choice.
        config: Settings from this TOML file.
        set: One setting, as vehicle.gnss_delay_s=0.2; may be repeated.
        settings: List all settings with their defaults, and end.
        fault: A fault to put into the samples, as gnss-step:at=60,for=8,size=40,towards=330; may be repeated.
        faults: List all kinds of faults, and end.
        plot: Draw the session with the longest estimate to this file (png, svg, pdf).
        truth: Draw the errors against this truth too (CSV, columns as of mavkf simulate --truth).
        json: Print the summary as JSON, with all findings of the diagnosis.
        diagnose: Print all findings of the diagnosis below the summary.
        publish: Publish over zenoh what a live run would have published, waiting for slow readers.

    """
    if settings:
        return _list_settings()
    if faults:
        return _list_faults()
    if not logs:
        raise UsageError("mavkf replay needs the path of a log (.tlog)")
    for log in logs:
        _check_outputs(log, csv, jsonl, plot)
    if truth is not None and plot is None:
        raise UsageError("--truth is drawn by --plot: give that too")
    if not publish and (connect or listen or zenoh_config):
        raise UsageError("--connect, --listen and --zenoh-config say where --publish goes: give that too")
    options = Options(
        as_live=as_live or publish or jsonl is not None,
        rate_hz=rate,
        span=(start, end),
        vehicle=vehicle,
        session=session,
        imu=imu_source(imu),
        model=model,
        config=with_settings(read_config(config) if config else Config(), set),
        faults=tuple(map(parse_fault, fault)),
        smooth=smooth,
        form=form,
        update=update,
    )
    for log in logs:
        map_log(log)  # a wrong path is said at once, not after the compiler
    compile_first(smoothing=smooth)
    for ordered in options.faults:
        say(f"put into {' + '.join(map(str, logs))}: {ordered}")
    with (
        _progress(max(logs, key=_size)) as progress,
        _pose_file(jsonl) as write,
        CsvFile(csv) if csv is not None else nullcontext() as table,
        _publishing(publish, connect, listen, zenoh_config) as send,
    ):

        def each(stream: VehicleStream, step: Step) -> None:
            if send is not None:
                for record in stream.records(step):
                    send(record)
                    if write is not None and isinstance(record, Pose):
                        write([encode(record) + b"\n"])
            elif write is not None:
                write(encode(pose) + b"\n" for pose in stream.poses(step))

        watch = Watch(
            progress=progress,
            step=each if write is not None or send is not None else None,
            poses=table.take if table is not None else None,
        )
        result = run(logs, options, watch, keep=plot is not None)
        rows = (
            table.finish(dict.fromkeys(session.vehicle for session in result.sessions)) if table is not None else None
        )
    _report(result, json, diagnose)
    if not result.sessions:
        say("nothing was estimated: no IMU or GNSS sample with a boot time lies in what was asked for (--from, --to)")
    if rows is not None:
        say(f"{csv}: {rows} rows")
    if plot is not None and result.sessions:
        _draw(result, plot, truth)
    return 0 if any(estimated(found) for found in result.sessions) else 1


def _draw(result: Result, path: Path, truth: Path | None) -> None:
    from mavkf.replay.plot import plot_run
    from mavkf.replay.truth import read_truth

    longest = max(result.sessions, key=lambda session: session.output.poses.shape[0])
    plot_run(path, longest, read_truth(truth) if truth is not None else None)
    say(f"{path}: vehicle {longest.vehicle}, session {longest.session}")


def _check_outputs(log: Path, *outputs: Path | None) -> None:
    """Raise UsageError where a file to write is the log itself: what was recorded is never lost."""
    for path in outputs:
        if path is not None and path.resolve() == log.resolve():
            raise UsageError(f"{path} is the log itself: give another file to write to")


def _list_settings() -> int:
    for name, default, description in known_settings():
        print(f"{name} = {_shown(default)}\n    {description}")
    return 0


def _list_faults() -> int:
    for name, form, meaning in describe():
        print(f"{name}:{form}\n    {meaning}" if form else f"{name}\n    {meaning}")
    return 0


def _shown(default: Any) -> str:
    """A default as it is written in TOML."""
    if default is None:
        return "(automatic)"
    if isinstance(default, tuple):
        return f"[{', '.join(map(_shown, default))}]"
    return str(default).lower() if isinstance(default, bool) else f"{default:g}"


def _size(log: Path) -> int:
    return log.stat().st_size if log.is_file() else 0


@contextmanager
def _progress(log: Path) -> Iterator[Callable[[str, float], object]]:
    """A progress bar on stderr for a long file in a terminal, else nothing."""
    if not (sys.stderr.isatty() and _size(log) > LONG_BYTES):
        yield NOBODY.progress
        return
    from rich.progress import Progress

    with Progress(console=messages(), transient=True) as bar:
        tasks: dict[str, Any] = {}

        def show(what: str, share: float) -> None:
            if what not in tasks:
                tasks[what] = bar.add_task(what, total=1.0)
            bar.update(tasks[what], completed=share)

        yield show


@contextmanager
def _pose_file(path: Path | None) -> Iterator[Callable[[Iterable[bytes]], None] | None]:
    """A function that writes lines to a file; None where there is no file. Raises UsageError where it cannot be written."""
    if path is None:
        yield None
        return

    def unwritable(error: OSError, remedy: str) -> UsageError:
        return UsageError(f"{path}: cannot be written ({error.strerror}); {remedy}")

    try:
        file = path.open("wb")
    except OSError as error:
        raise unwritable(error, "give the path of a file in a folder that exists") from None

    def write(lines: Iterable[bytes]) -> None:
        try:
            file.writelines(lines)
        except OSError as error:
            raise unwritable(error, "make room, or give another path") from None

    try:
        yield write
    except BaseException:
        with suppress(OSError):  # of what was not written: the first error is told
            file.close()
        raise
    try:
        file.close()
    except OSError as error:
        raise unwritable(error, "make room, or give another path") from None


@contextmanager
def _publishing(
    wanted: bool, connect: tuple[str, ...], listen: tuple[str, ...], config: Path | None
) -> Iterator[Callable[[Record], object] | None]:
    """A function that publishes a record under its vehicle, waiting for slow readers."""
    if not wanted:
        yield None
        return
    from mavkf.publish.publisher import Publisher
    from mavkf.publish.session import publishing_session

    publishers: dict[str, Publisher] = {}
    with publishing_session(connect=connect, listen=listen, config_file=config) as session:

        def send(record: Record) -> None:
            if record.vehicle not in publishers:
                publishers[record.vehicle] = Publisher(session, record.vehicle, congestion="block")
            publishers[record.vehicle].publish(record)

        try:
            yield send
        finally:
            for publisher in publishers.values():
                publisher.close()


def _report(result: Result, as_json: bool, findings: bool) -> None:
    summary = summarise(result, details=as_json or findings)
    if as_json:
        import msgspec

        sys.stdout.write(msgspec.json.format(msgspec.json.encode(summary), indent=1).decode() + "\n")
        return
    from mavkf.cli._summary import print_summary

    print_summary(summary, findings)
    for session in summary["sessions"]:
        for warning in session["warnings"]:
            say(f"{session['vehicle']} session {session['session']}: {warning}")
