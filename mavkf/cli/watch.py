"""`mavkf watch`: the published poses, one line a vehicle."""

import sys
import time
from collections.abc import Callable, Iterator
from math import degrees, inf, sqrt
from typing import TYPE_CHECKING

from mavkf.cli._console import Connect, Listen, ZenohConfig, output, say
from mavkf.errors import UsageError
from mavkf.estimate import Pose
from mavkf.publish.records import encode
from mavkf.publish.subscriber import Subscription, subscribe

if TYPE_CHECKING:
    from rich.table import Table

_REDRAW_S = 0.125
_LINE_S = 1.0  # a plain line for each vehicle at most this often
_PATIENCE_S = 2.0
_GONE_S = 10.0  # silence after which a vehicle without a publisher leaves the table


def watch(  # noqa: D417 (the rest is described in _console)
    vehicle: str = "*",
    /,
    *,
    json: bool = False,
    once: bool = False,
    seconds: float | None = None,
    connect: Connect = (),
    listen: Listen = (),
    zenoh_config: ZenohConfig = None,
) -> int:
    """Show the poses that are published; may be started before anything publishes.

    A live table in a terminal, else a line a second for each vehicle. Ends by Ctrl-C; exit code 1 if no pose came.

    Args:
        vehicle: SYSID-COMPID, as in 1-1, or its name; all if not given.
        json: Print every pose as one line of JSON.
        once: End after the first pose.
        seconds: End after so many seconds.

    """
    if seconds is not None and not 0 < seconds < inf:
        raise UsageError(f"--seconds {seconds:g} is not a time: give a number of seconds above 0")
    live = not json and not once and sys.stdout.isatty()
    with subscribe(
        vehicle, connect=connect, listen=listen, config_file=zenoh_config, latest_only=not json and not once
    ) as subscription:
        fleet = Fleet(subscription)
        show = _show_table if live else _show_json if json else _show_lines
        show(fleet, _poses(subscription, once=once, seconds=seconds))
        if not fleet.rows:
            say("no pose came: start mavkf serve, or give the place of one that runs by --connect")
        lost = subscription.counts["missed"] if json else 0
        if lost:
            say(f"{lost} poses were missed: this reader or the link was too slow")
    return 0 if fleet.rows else 1


class Row:
    """A vehicle's newest pose, when it came (seconds of this machine's steady clock), and how many come a second."""

    def __init__(self, pose: Pose, now: float) -> None:
        self.pose, self.came, self.rate_hz = pose, now, 0.0
        self._mark = (now, pose.session, pose.seq)

    def take(self, pose: Pose, now: float) -> None:
        """Note a newer pose; the rate follows from `seq`, so poses that were skipped count."""
        then, session, seq = self._mark
        if now - then >= 1.0 or session != pose.session:
            self.rate_hz = max(pose.seq - seq, 0) / (now - then) if session == pose.session and now > then else 0.0
            self._mark = (now, pose.session, pose.seq)
        self.pose, self.came = pose, now


class Fleet:
    """The vehicles that were seen."""

    def __init__(self, subscription: Subscription[Pose]) -> None:
        self._subscription = subscription
        self.rows: dict[str, Row] = {}

    def take(self, pose: Pose) -> Row:
        """Note a pose."""
        now = time.monotonic()
        row = self.rows.get(pose.vehicle)
        if row is None:
            row = self.rows[pose.vehicle] = Row(pose, now)
        else:
            row.take(pose, now)
        return row

    def table(self) -> "Table":
        """Draw the vehicles that are there."""
        from rich.table import Table

        now, alive = time.monotonic(), self._subscription.alive
        table = Table(caption=None if self.rows else "waiting for a pose; Ctrl-C ends", expand=False)
        for title in COLUMNS:
            table.add_column(title, no_wrap=title != "flags", justify="left" if title in _WORDS else "right")
        table.add_column("age s", justify="right")
        for name, row in sorted(self.rows.items()):
            age = now - row.came
            if name in alive or age < _GONE_S:
                style = "" if age < 1.0 else "dim"
                table.add_row(*(cell(row) for cell in COLUMNS.values()), f"{age:.1f}", style=style)
        return table


def _poses(subscription: Subscription[Pose], *, once: bool, seconds: float | None) -> Iterator[Pose | None]:
    """Give poses as they come, and None whenever none came for as long as a redraw; ends when it was asked to."""
    begin = time.monotonic()
    end = inf if seconds is None else begin + seconds
    hushed = True
    while (now := time.monotonic()) < end:
        pose = subscription.receive(min(_REDRAW_S, end - now))
        yield pose
        if pose is not None:
            hushed = False
            if once:
                return
        elif hushed and now - begin > _PATIENCE_S and not sys.stdout.isatty():
            hushed = False
            say("nothing is published yet; waiting")


def _show_table(fleet: Fleet, poses: Iterator[Pose | None]) -> None:
    from rich.live import Live

    drawn = 0.0
    with Live(fleet.table(), console=output(), auto_refresh=False, transient=False) as live:
        for pose in poses:
            if pose is not None:
                fleet.take(pose)
            if time.monotonic() - drawn >= _REDRAW_S:
                live.update(fleet.table(), refresh=True)
                drawn = time.monotonic()


def _show_json(fleet: Fleet, poses: Iterator[Pose | None]) -> None:
    for pose in poses:
        if pose is not None:
            fleet.take(pose)
            print(encode(pose).decode(), flush=True)


def _show_lines(fleet: Fleet, poses: Iterator[Pose | None]) -> None:
    printed: dict[str, float] = {}
    for pose in poses:
        if pose is None:
            continue
        row = fleet.take(pose)
        if row.came - printed.get(pose.vehicle, -inf) >= _LINE_S:
            printed[pose.vehicle] = row.came
            cells = ((title, cell(row)) for title, cell in COLUMNS.items())
            print(
                "  ".join(text if title in _WORDS else f"{title} {text}" for title, text in cells if text), flush=True
            )


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _numbers(values: tuple[float | None, ...] | None, digits: int) -> str:
    return "-" if values is None else " ".join(_number(value, digits) for value in values)


def _valid(row: Row) -> str:
    valid = row.pose.valid
    return " ".join(name for name in ("position", "velocity", "tilt", "yaw") if getattr(valid, name)) or "nothing"


def _sigma(row: Row, *axes: int, scale: float = 1.0, digits: int = 2) -> str:
    """Give the standard deviation along axes of the pose covariance, root of the sum of their variances."""
    covariance = row.pose.pose_covariance
    variances = [covariance[7 * axis] if covariance else None for axis in axes]
    if any(variance is None or variance < 0 for variance in variances):
        return "-"
    return f"{scale * sqrt(sum(variance or 0.0 for variance in variances)):.{digits}f}"


_WORDS = ("vehicle", "mode", "valid", "flags")
COLUMNS: dict[str, Callable[[Row], str]] = {
    "vehicle": lambda row: row.pose.vehicle,
    "mode": lambda row: row.pose.mode.value,
    "valid": _valid,
    "lat deg": lambda row: _number(row.pose.lat_deg, 7),
    "lon deg": lambda row: _number(row.pose.lon_deg, 7),
    "alt m": lambda row: _number(row.pose.alt_amsl_m, 2),
    "north east down m/s": lambda row: _numbers(row.pose.velocity_ned_m_s, 2),
    "roll pitch yaw deg": lambda row: _numbers(row.pose.euler_deg, 1),
    "sigma horizontal m": lambda row: _sigma(row, 0, 1),
    "down m": lambda row: _sigma(row, 2),
    "yaw deg": lambda row: _sigma(row, 5, scale=degrees(1.0), digits=1),
    "Hz": lambda row: f"{row.rate_hz:.0f}",
    "flags": lambda row: " ".join(row.pose.flags),
}
