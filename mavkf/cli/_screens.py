"""What `mavkf watch` draws: a line for each vehicle, or one vehicle on a screen."""

from collections.abc import Callable, Collection, Iterable
from math import degrees, sqrt
from typing import TYPE_CHECKING, NamedTuple

from mavkf.cli._seen import STALE_S, Row
from mavkf.estimate import Mode, Pose

if TYPE_CHECKING:
    from rich.console import Group
    from rich.table import Table

GONE_S = 40.0  # silence after which a vehicle without a publisher leaves the table
_STYLES = {Mode.NAVIGATING: "green", Mode.DEAD_RECKONING: "red"}


class Column(NamedTuple):
    """A column: what stands in it, how wide that may be, and how soon it goes where the terminal is narrow (0: never)."""

    text: Callable[[Row], str]
    width: int
    goes: int = 0
    is_word: bool = False


def number(value: float | None, digits: int) -> str:
    """A number, or a dash where there is none."""
    return "-" if value is None else f"{value:.{digits}f}"


def numbers(values: Iterable[float | None] | None, digits: int) -> str:
    """Numbers, each with a dash where there is none."""
    return "-" if values is None else " ".join(number(value, digits) for value in values)


def sigma(row: Row, *axes: int, scale: float = 1.0, digits: int = 2) -> str:
    """Give the standard deviation along axes of the pose covariance, root of the sum of their variances."""
    covariance = row.pose.pose_covariance if row.pose else None
    variances = [covariance[7 * axis] if covariance else None for axis in axes]
    if any(variance is None or variance < 0 for variance in variances):
        return "-"
    return f"{scale * sqrt(sum(variance or 0.0 for variance in variances)):.{digits}f}"


def valid(row: Row) -> str:
    """What may be used, in words."""
    newest = row.pose or row.status
    names = [name for name in ("position", "velocity", "tilt", "yaw") if newest and getattr(newest.valid, name)]
    return "all" if len(names) == 4 else " ".join(names) or "nothing"


def mode(row: Row) -> str:
    """What the estimator is doing."""
    newest = row.pose or row.status
    return newest.mode.value if newest else "-"


def of_pose(get: Callable[[Pose], str]) -> Callable[[Row], str]:
    """What a pose says, or a dash where there is none yet."""
    return lambda row: get(row.pose) if row.pose else "-"


COLUMNS: dict[str, Column] = {
    "vehicle": Column(lambda row: row.vehicle, 8, is_word=True),
    "mode": Column(mode, 14, is_word=True),
    "valid": Column(valid, 12, goes=2, is_word=True),
    "lat deg": Column(of_pose(lambda pose: number(pose.lat_deg, 7)), 11, goes=4),
    "lon deg": Column(of_pose(lambda pose: number(pose.lon_deg, 7)), 11, goes=4),
    "alt m": Column(of_pose(lambda pose: number(pose.alt_amsl_m, 1)), 7),
    "v NED m/s": Column(of_pose(lambda pose: numbers(pose.velocity_ned_m_s, 1)), 16, goes=3),
    "roll pitch yaw": Column(of_pose(lambda pose: numbers(pose.euler_deg, 1)), 17),
    "\u03c3 h m": Column(lambda row: sigma(row, 0, 1), 6),
    "\u03c3 v": Column(lambda row: sigma(row, 2), 6, goes=1),
    "\u03c3 yaw": Column(lambda row: sigma(row, 5, scale=degrees(1.0), digits=1), 5, goes=1),
    "Hz": Column(lambda row: f"{row.rate_hz:.0f}", 4),
}
"""The columns of the table, and the words of a plain line."""


def fitting(width: int) -> list[str]:
    """The names of the columns that go into a terminal of so many characters."""
    left = dict(COLUMNS)
    room = width - 16  # age and words
    for goes in range(1, 5):
        if sum(max(column.width, len(name)) + 2 for name, column in left.items()) <= room:
            break
        left = {name: column for name, column in left.items() if column.goes != goes}
    return list(left)


def style(row: Row, now: float) -> str:
    """The colour of a vehicle."""
    return "dim" if row.age_s(now) >= STALE_S else _STYLES.get(row.pose.mode, "yellow") if row.pose else "yellow"


def fleet(rows: Collection[Row], alive: Collection[str], now: float, width: int) -> "Table":
    """Draw the vehicles that are there."""
    from rich import box
    from rich.table import Table

    names = fitting(width)
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, caption=None if rows else "waiting for a vehicle; Ctrl-C ends")
    for name in names:
        table.add_column(name, no_wrap=True, justify="left" if COLUMNS[name].is_word else "right")
    table.add_column("age s", justify="right")
    table.add_column("status")
    for row in sorted(rows, key=lambda row: row.vehicle):
        age = row.age_s(now)
        if row.vehicle in alive or age < GONE_S:
            cells = (COLUMNS[name].text(row) for name in names)
            table.add_row(*cells, f"{age:.1f}", row.words(now), style=style(row, now))
    return table


def detail(row: Row | None, vehicle: str, now: float) -> "Group":
    """Draw one vehicle: pose, inputs, what the innovations say, what happened lately."""
    from rich.console import Group
    from rich.text import Text

    if row is None:
        return Group(Text(f"waiting for {vehicle}; Ctrl-C ends"))
    newest = row.pose or row.status
    session = f", session {newest.session}" if newest else ""
    model = f", {row.status.model}" if row.status and row.status.model else ""
    head = Text(f"{row.vehicle}{session}: ", style="bold")
    head.append(mode(row), style=style(row, now))
    head.append(f"{model}, valid: {valid(row)}, {row.rate_hz:.0f} poses a second, {row.age_s(now):.1f} s old")
    words = row.words(now)
    parts = [head, Text(words, style="yellow")] if words else [head]
    return Group(*parts, _pose(row), _inputs(row), _innovations(row), _events(row))


def _bare(*titles: str) -> "Table":
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for k, title in enumerate(titles):
        table.add_column(title, justify="left" if k == 0 or title == "" else "right")
    return table


def _pose(row: Row) -> "Table":
    pose = row.pose
    table = _bare("pose", "value", "\u03c3", "unit")
    if pose is None:
        return table
    root = [sqrt(v) if v is not None and v >= 0 else None for v in (pose.velocity_covariance or ())[::4]]
    degree = degrees(1.0)
    table.add_row(
        "latitude longitude", f"{number(pose.lat_deg, 7)} {number(pose.lon_deg, 7)}", sigma(row, 0, 1), "deg, m"
    )
    table.add_row("altitude", number(pose.alt_amsl_m, 2), sigma(row, 2), "m")
    table.add_row("north east down", numbers(pose.position_ned_m, 2), "", "m from the origin")
    table.add_row("velocity NED", numbers(pose.velocity_ned_m_s, 2), numbers(root or None, 2), "m/s")
    tilt = " ".join(sigma(row, axis, scale=degree) for axis in (3, 4, 5))
    table.add_row("roll pitch yaw", numbers(pose.euler_deg, 2), tilt, "deg")
    table.add_row("protection levels", f"{number(pose.pl_h_m, 1)} {number(pose.pl_v_m, 1)}", "", "m, h and v")
    return table


def _inputs(row: Row) -> "Table":
    table = _bare("input", "Hz", "age s")
    for name, rate in (row.status.rates_hz if row.status else {}).items():
        if name != "poses":
            table.add_row(name, number(rate, 1), number(row.status.age_s.get(name) if row.status else None, 2))
    return table


def _innovations(row: Row) -> "Table":
    table = _bare("innovations of the last minute", "fused", "refused", "NIS", "newest", "")
    for name, each in (row.status.innovations if row.status else {}).items():
        last = row.innovations.get(name)
        newest = numbers(last.r, 2) if last else "-"
        if last and not last.fused:
            newest += f" {last.reason or 'refused'}"
        nis = number(each.nis, 2)
        table.add_row(name, str(each.count), str(each.refused), nis, newest, each.sentence or "")
    return table


def _events(row: Row) -> "Table":
    table = _bare("events", "")
    for event in reversed(row.events):
        table.add_row(f"{number(event.t_boot_s, 1)} s", event.text)
    return table
