"""Estimate a log: offline in the order of measurement, or as live in the order of arrival."""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mavkf.config import Config
from mavkf.errors import LogError, UsageError
from mavkf.link.clocks import ClockCounts
from mavkf.navigation.estimator import Output, SessionEstimator, fold_counts, joined, run_offline
from mavkf.navigation.setup import MODELS, Setup
from mavkf.replay.boot_clock import boot_times, on_boot_clock
from mavkf.replay.faults import Fault, apply_faults
from mavkf.replay.tlog import Log
from mavkf.samples import IMU_SOURCES, KIND, SESSION, Kind, Source
from mavkf.service.playback import read_together
from mavkf.service.vehicle import Step, VehicleStream, state_counts, within

if TYPE_CHECKING:
    from mavkf.navigation.any_form import FormRun

Array = NDArray[np.float64]
OWN_FORM, OWN_ORDER = "joseph", "first"  # of the fold
BLOCK = 50_000  # rows between two calls of `progress`


@dataclass(frozen=True, kw_only=True)
class Options:
    """How to replay.

    as_live: in the order of arrival, each pose as it would have been published; else in the order of measurement.
    rate_hz: rows a second of boot time, 0 for every step. span: boot times (s) to use.
    vehicle: `<sysid>-<compid>`, session: its number; None: all.
    imu: the IMU message to use; model: one of MODELS; None: chosen from the session's first seconds.
    faults: to put into the samples first. smooth: whether each pose rests on what came later too (not as_live).
    form, update: a form and an order of `mavkf.filters`, to run the flight with (not as_live, not smooth); None: as the service does.
    """

    as_live: bool = False
    rate_hz: float = 50.0
    span: tuple[float, float] = (-math.inf, math.inf)
    vehicle: str | None = None
    session: int | None = None
    imu: Source | None = None
    model: str | None = None
    config: Config = field(default_factory=Config)
    faults: tuple[Fault, ...] = ()
    smooth: bool = False
    form: str | None = None
    update: str | None = None

    @property
    def other_filter(self) -> tuple[str, str] | None:
        """The form and order to run with, where one of them was asked for."""
        if self.form is None and self.update is None:
            return None
        return self.form or OWN_FORM, self.update or OWN_ORDER


@dataclass(frozen=True)
class SessionResult:
    """What came of one session of one vehicle.

    rows: its timed sample rows (n, ROW_WIDTH), in the order of arrival; output: pose rows, innovations and notes of the fold;
    counts: what the fold counted; state: of the fold at the end (STATE_SIZE,); parameters: what it was told (PARAMETERS,);
    hindsight: what smoothing made of the flight, in words; form: what another form and order cost, where they made the pose rows.
    """

    vehicle: str
    session: int
    setup: Setup
    rows: Array
    output: Output
    counts: dict[str, int]
    state: Array
    parameters: Array
    hindsight: tuple[str, ...] = ()
    form: "FormRun | None" = None


@dataclass(frozen=True)
class Result:
    """A replayed log, without its rows: its sessions by vehicle, the counts of each vehicle's clock, and the seconds of work."""

    log: Log
    sessions: list[SessionResult]
    clocks: dict[str, ClockCounts]
    read_s: float
    estimate_s: float


def imu_source(name: str | None) -> Source | None:
    """The IMU message of a name. Raises UsageError."""
    if name is None:
        return None
    for source in IMU_SOURCES:
        if source.name == name.upper():
            return source
    raise UsageError(
        f"--imu {name}: no IMU message of this name; choose one of {', '.join(source.name for source in IMU_SOURCES)}"
    )


def check(options: Options) -> Options:
    """The options, if they make sense. Raises UsageError."""
    if options.model is not None and options.model not in MODELS:
        raise UsageError(f"--model {options.model}: choose one of {', '.join(MODELS)}")
    if options.smooth and options.as_live:
        raise UsageError(
            "--smooth uses what came later, which no live run knows: leave --as-live, --jsonl and --publish out"
        )
    if options.other_filter is not None:
        from mavkf.filters.forms import FORMS  # what few runs need is imported for them
        from mavkf.filters.orders import ORDERS

        for option, name, known in (("form", options.form, FORMS), ("update", options.update, ORDERS)):
            if name is not None and name not in known:
                raise UsageError(f"--{option} {name}: choose one of {', '.join(known)}")
    if options.other_filter is not None and options.as_live:
        raise UsageError(
            "--form and --update go over a whole flight, which no live run has: leave --as-live, --jsonl and --publish out"
        )
    if options.other_filter is not None and options.smooth:
        raise UsageError("--smooth goes back over the filter's own form: leave --form and --update out")
    if not 0.0 <= options.rate_hz <= 10_000.0:
        raise UsageError(f"--rate {options.rate_hz:g}: give rows a second, or 0 for every step")
    if not options.span[0] < options.span[1]:
        raise UsageError(f"--from {options.span[0]:g} --to {options.span[1]:g}: the end must come after the beginning")
    return options


def chosen_vehicles(log: Log, options: Options) -> list[tuple[int, int]]:
    """The (system, component) of the vehicles to replay. Raises LogError or UsageError where there is none."""
    vehicles = log.vehicles()
    if not vehicles:
        raise LogError(
            f"{log.path} has no vehicle: no component in it sends IMU or GNSS messages; record the autopilot's own telemetry"
        )
    if options.vehicle is None:
        return vehicles
    named = [address for address in vehicles if vehicle_name(address) == options.vehicle]
    if not named:
        raise UsageError(f"--vehicle {options.vehicle}: this log has {', '.join(map(vehicle_name, vehicles))}")
    return named


def vehicle_name(address: tuple[int, int]) -> str:
    """`<sysid>-<compid>` of a (system, component)."""
    return f"{address[0]}-{address[1]}"


def run(
    path: Path | Sequence[Path],
    options: Options,
    progress: Callable[[str, float], object] | None = None,
    each: Callable[[VehicleStream, Step], object] | None = None,
) -> Result:
    """Replay a log, or the logs of several links of one flight as one.

    progress: called with what is being done ("reading", "estimating") and the share that is done.
    each: called with every step of a run as live, for what needs records. Raises LogError, UsageError.
    """
    check(options)
    begin = time.perf_counter()
    paths = [path] if isinstance(path, Path) else path
    log = read_together(paths, (lambda share: progress("reading", share)) if progress else None)
    addresses = chosen_vehicles(log, options)
    read = time.perf_counter()
    sessions: list[SessionResult] = []
    clocks: dict[str, ClockCounts] = {}
    for k, address in enumerate(addresses):

        def part(share: float, k: int = k) -> None:
            if progress:
                progress("estimating", (k + share) / len(addresses))

        name = vehicle_name(address)
        found, clocks[name] = run_rows(name, log.rows.pop(address), options, part, each, keep=False)
        sessions += found
    if options.session is not None and not sessions:
        raise UsageError(
            f"--session {options.session}: no vehicle has a session of this number; `mavkf info {paths[0]}` lists them"
        )
    return Result(log, sessions, clocks, read - begin, time.perf_counter() - read)


def run_rows(
    name: str,
    rows: Array,
    options: Options,
    progress: Callable[[float], object] | None = None,
    each: Callable[[VehicleStream, Step], object] | None = None,
    *,
    keep: bool = True,
) -> tuple[list[SessionResult], ClockCounts]:
    """Estimate the sample rows (n, ROW_WIDTH) of one vehicle, in the order of arrival; `run` does this for each vehicle of a log.

    name: of the vehicle; progress: called with the share that is done; each: as of `run`. TIME and SESSION of the rows are not
    read. keep: whether the caller needs the rows as they are; else what is made of them may take their place. Raises UsageError.
    """
    if options.faults:
        rows = apply_faults(rows, options.faults, boot_times(rows, options.config.timeline.window_s))
    timed, counts = on_boot_clock(rows, options.config.timeline.window_s, in_place=not keep and not options.as_live)
    timed = within(timed, options.span)
    if not options.as_live:
        rows = timed  # the others may go
    estimate = _as_live if options.as_live else _offline
    part = progress or (lambda _: None)
    return list(estimate(name, rows, timed, options, part, each)), counts


def _sessions(rows: Array, options: Options) -> Iterator[tuple[int, Array]]:
    """The wanted sessions of timed rows, with those of their rows that have a sensor's sample among them."""
    for session in np.unique(rows[:, SESSION]).astype(int):
        its = rows[:, SESSION] == session
        mine = rows if its.all() else rows[its]
        if options.session in (None, session) and np.isin(mine[:, KIND], (Kind.IMU, Kind.GNSS)).any():
            yield int(session), mine


def _offline(
    name: str, _: Array, rows: Array, options: Options, part: Callable[[float], object], __: object
) -> Iterator[SessionResult]:
    for session, mine in _sessions(rows, options):
        done = run_offline(
            mine,
            options.config,
            options.rate_hz,
            options.imu,
            options.model,
            part,
            options.smooth,
            options.other_filter,
        )
        yield SessionResult(
            name,
            session,
            done.setup,
            mine,
            done.output,
            fold_counts(done.state),
            done.state,
            done.parameters,
            done.hindsight,
            done.form,
        )


def _as_live(
    name: str,
    arrived: Array,
    rows: Array,
    options: Options,
    part: Callable[[float], object],
    each: Callable[[VehicleStream, Step], object] | None,
) -> Iterator[SessionResult]:
    live = VehicleStream(name, options.config, options.rate_hz, options.imu, options.model, options.span)
    outputs: dict[int, list[Output]] = {}
    ends: dict[int, SessionEstimator] = {}
    for i in range(0, arrived.shape[0] + 1, BLOCK):
        last = i + BLOCK > arrived.shape[0]
        for step in chain(live.push(arrived[i : i + BLOCK]), live.finish() if last else ()):
            outputs.setdefault(step.session, []).append(step.output)
            estimator = live.estimator
            if estimator is not None and estimator.setup is not None and step.session == live.session:
                ends[step.session] = estimator
            if each is not None and options.session in (None, step.session):
                each(live, step)
        part(min(1.0, i / arrived.shape[0]))
    for session, mine in _sessions(rows, options):
        if session in ends:
            end = ends[session]
            assert end.setup is not None
            counts = state_counts(end)
            yield SessionResult(
                name, session, end.setup, mine, joined(outputs[session]), counts, end.state, end.parameters
            )
