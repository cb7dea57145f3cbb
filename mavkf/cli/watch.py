"""`mavkf watch`: the vehicles that are published, one line each, or one in detail."""

import sys
import time
from collections.abc import Callable, Iterator
from math import inf
from typing import TYPE_CHECKING

from mavkf.cli._console import Connect, Listen, ZenohConfig, output, say
from mavkf.cli._screens import COLUMNS, detail, fleet
from mavkf.cli._seen import Seen
from mavkf.errors import UsageError
from mavkf.estimate import Pose, Record
from mavkf.publish.records import What, encode
from mavkf.publish.subscriber import Subscription, subscribe

if TYPE_CHECKING:
    from rich.console import RenderableType

_REDRAW_S = 0.125
_LINE_S = 1.0  # a plain line for each vehicle at most this often
_PATIENCE_S = 2.0


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
    """Show the vehicles that are published; may be started before anything publishes.

    In a terminal a live table, or, of one VEHICLE, its pose, inputs, innovations and events. Else a line a second for each
    vehicle. Ends by Ctrl-C; exit code 1 if no pose came.

    Args:
        vehicle: SYSID-COMPID, as in 1-1, or its name; all if not given.
        json: Print every pose as one line of JSON.
        once: End after the first pose.
        seconds: End after so many seconds.

    """
    if seconds is not None and not 0 < seconds < inf:
        raise UsageError(f"--seconds {seconds:g} is not a time: give a number of seconds above 0")
    is_live = not json and not once and sys.stdout.isatty()
    whole = is_live and vehicle != "*"
    what: tuple[What, ...] = ("pose",)
    if is_live:
        what = ("pose", "status", "innovation", "event") if whole else ("pose", "status")
    with subscribe(
        vehicle,
        what=what,
        connect=connect,
        listen=listen,
        config_file=zenoh_config,
        latest_only=not json and not once and not whole,
    ) as subscription:
        seen = Seen()
        records = _records(subscription, once=once, seconds=seconds)
        if is_live:
            _show_screen(seen, records, lambda: _screen(seen, subscription, vehicle))
        else:
            (_show_json if json else _show_lines)(seen, records)
        if not seen.poses:
            say("no pose came: start mavkf serve, or give the place of one that runs by --connect")
        lost = subscription.counts["missed"] if json else 0
        if lost:
            say(f"{lost} poses were missed: this reader or the link was too slow")
    return 0 if seen.poses else 1


def _records(subscription: Subscription[Record], *, once: bool, seconds: float | None) -> Iterator[Record | None]:
    """Give records as they come, and None whenever none came for as long as a redraw; ends when it was asked to."""
    begin = time.monotonic()
    end = inf if seconds is None else begin + seconds
    hushed = True
    while (now := time.monotonic()) < end:
        record = subscription.receive(min(_REDRAW_S, end - now))
        yield record
        if record is not None:
            hushed = False
            if once:
                return
        elif hushed and now - begin > _PATIENCE_S and not sys.stdout.isatty():
            hushed = False
            say("nothing is published yet; waiting")


def _screen(seen: Seen, subscription: Subscription[Record], vehicle: str) -> "RenderableType":
    now = time.monotonic()
    if vehicle != "*":
        return detail(seen.rows.get(vehicle), vehicle, now)
    return fleet(seen.rows.values(), subscription.alive, now, output().width)


def _show_screen(seen: Seen, records: Iterator[Record | None], draw: Callable[[], "RenderableType"]) -> None:
    from rich.live import Live

    drawn = 0.0
    with Live(draw(), console=output(), auto_refresh=False, transient=False) as live:
        for record in records:
            if record is not None:
                seen.take(record)
            if time.monotonic() - drawn >= _REDRAW_S:
                live.update(draw(), refresh=True)
                drawn = time.monotonic()


def _show_json(seen: Seen, records: Iterator[Record | None]) -> None:
    for record in records:
        if record is not None:
            seen.take(record)
            print(encode(record).decode(), flush=True)


def _show_lines(seen: Seen, records: Iterator[Record | None]) -> None:
    printed: dict[str, float] = {}
    for record in records:
        if not isinstance(record, Pose):
            continue
        row = seen.take(record)
        if row.came - printed.get(row.vehicle, -inf) >= _LINE_S:
            printed[row.vehicle] = row.came
            cells = [(title, column, column.text(row)) for title, column in COLUMNS.items()]
            print(
                "  ".join(text if column.is_word else f"{title} {text}" for title, column, text in cells if text),
                row.words(row.came),
                flush=True,
            )
