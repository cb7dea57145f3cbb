"""`mavkf info`: what is in a log."""

import json as json_format
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mavkf.cli._console import messages, output
from mavkf.errors import LogError
from mavkf.link.clocks import VehicleClock
from mavkf.link.decode import Address
from mavkf.link.layouts import enum_words
from mavkf.replay.tlog import Log, read_tlog
from mavkf.samples import AUTOPILOT, FIX, KIND, SATELLITES, SESSION, SOURCE, TIME, VEHICLE_TYPE, Kind, Source

if TYPE_CHECKING:
    from rich.console import Console

Rows = NDArray[np.float64]

_SENSORS = {Kind.IMU: "IMU", Kind.GNSS: "GNSS", Kind.MAGNETOMETER: "magnetometer", Kind.BAROMETER: "barometer"}
_WORDS = {"gcs": "ground station", "ardupilotmega": "ArduPilot", "px4": "PX4", "invalid": "no autopilot"}
_FIX_3D = 3
_GAP_S = 1.0


def info(log: Path, *, json: bool = False) -> int:
    """Say what is in a log: vehicles, sessions, rates of their sensors, GNSS fix, gaps and damage.

    Args:
        log: A telemetry log of a ground station (.tlog).
        json: Print it as JSON.

    """
    from rich.progress import Progress

    console = messages()
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("reading", total=1.0)
        content = read_tlog(log, lambda share: progress.update(task, completed=share))
    if not content.vehicles():
        raise LogError(_no_vehicle(content))
    summary = summarise(content)
    if json:
        print(json_format.dumps(summary, indent=2, allow_nan=False))
    else:
        show(summary, output())
    return 0


def _no_vehicle(log: Log) -> str:
    seen = ", ".join(f"{system}/{component}" for system, component in sorted(log.message_counts))
    return (
        f"{log.path} holds {len(log.frames)} messages of {seen}, but neither IMU nor GNSS messages of a vehicle: "
        "give a log that was recorded while a vehicle was connected and streaming its sensors."
    )


def summarise(log: Log) -> dict[str, Any]:
    """Collect what is in a log as plain values with units in their names; None is what is not known."""
    start = datetime.fromtimestamp(log.first_us * 1e-6, UTC).isoformat(timespec="seconds") if log.first_us else None
    vehicles = log.vehicles()
    return {
        "path": str(log.path),
        "size_bytes": log.size,
        "start_utc": start,
        "duration_s": round(log.duration_s, 3),
        "messages": len(log.frames),
        "damage": log.damage.as_dict(),
        "refused": {"not_finite": log.refused.not_finite, "other_instances": log.refused.other_instances},
        "vehicles": [_vehicle(log, address) for address in vehicles],
        "others": [_sender(log, address) for address in sorted(log.message_counts) if address not in vehicles],
    }


def _words(enum: str, value: float) -> str:
    words = enum_words(enum, value)
    return _WORDS.get(words, words)


def _sender(log: Log, address: Address) -> dict[str, Any]:
    """Who sent: the newest HEARTBEAT in words, and how many messages."""
    rows = log.rows.get(address, np.empty((0, KIND + 1)))
    beats = rows[rows[:, KIND] == Kind.HEARTBEAT]
    words: tuple[str | None, str | None] = (None, None)
    if len(beats):
        words = _words("MAV_TYPE", beats[-1, VEHICLE_TYPE]), _words("MAV_AUTOPILOT", beats[-1, AUTOPILOT])
    counts = log.message_counts[address]
    return {
        "system": address[0],
        "component": address[1],
        "type": words[0],
        "autopilot": words[1],
        "messages": sum(count.count for count in counts),
    }


def _vehicle(log: Log, address: Address) -> dict[str, Any]:
    clock = VehicleClock()
    rows = np.concatenate([clock.push(log.rows[address]), clock.flush()])
    counts = clock.counts
    return {
        **_sender(log, address),
        "reboots": counts.reboots,
        "late": counts.late,
        "bad_stamps": counts.bad_stamps,
        "untimed": counts.untimed,
        "sessions": [_session(rows[rows[:, SESSION] == number]) for number in np.unique(rows[:, SESSION])],
    }


def _session(rows: Rows) -> dict[str, Any]:
    """One boot of a vehicle, from its rows."""
    steps = np.diff(np.maximum.accumulate(rows[:, TIME]))
    gaps = steps[steps > _GAP_S]
    sensors, receivers = [], []
    for kind in _SENSORS:
        of_kind = rows[rows[:, KIND] == kind]
        for source in np.unique(of_kind[:, SOURCE]):
            mine = of_kind[of_kind[:, SOURCE] == source]
            sensors.append(_sensor(kind, Source(int(source)), mine))
            if kind == Kind.GNSS:
                receivers.append(_receiver(Source(int(source)), mine))
    return {
        "boot_start_s": round(float(rows[:, TIME].min()), 3),
        "boot_end_s": round(float(rows[:, TIME].max()), 3),
        "gaps": len(gaps),
        "longest_gap_s": round(float(gaps.max()), 3) if len(gaps) else None,
        "sensors": sensors,
        "receivers": receivers,
    }


def _sensor(kind: Kind, source: Source, rows: Rows) -> dict[str, Any]:
    span = float(np.ptp(rows[:, TIME]))
    rate = round((len(rows) - 1) / span, 2) if span > 0 else None
    return {"sensor": _SENSORS[kind], "message": source.name, "samples": len(rows), "rate_hz": rate}


def _receiver(source: Source, rows: Rows) -> dict[str, Any]:
    fixed = rows[rows[:, FIX] >= _FIX_3D]
    satellites = rows[np.isfinite(rows[:, SATELLITES]), SATELLITES]
    return {
        "message": source.name,
        "best_fix": enum_words("GPS_FIX_TYPE", rows[:, FIX].max()),
        "fix_3d_share": round(len(fixed) / len(rows), 4),
        "first_fix_boot_s": round(float(fixed[0, TIME]), 3) if len(fixed) else None,
        "satellites": [int(satellites.min()), int(satellites.max())] if len(satellites) else None,
    }


def show(summary: dict[str, Any], console: "Console") -> None:
    """Print a summary for people."""
    from rich.markup import escape

    when = f", begun {summary['start_utc'].replace('T', ' ').replace('+00:00', ' UTC')}" if summary["start_utc"] else ""
    console.print(
        f"[bold]{escape(Path(summary['path']).name)}[/bold]  {summary['size_bytes'] / 1e6:.1f} MB{when}", soft_wrap=True
    )
    console.print(
        f"{_minutes(summary['duration_s'])} of link time, {summary['messages']} messages; {_damage(summary)}",
        soft_wrap=True,
    )
    for vehicle in summary["vehicles"]:
        _show_vehicle(vehicle, console)
    if summary["others"]:
        console.print()
        others = (
            f"{o['system']}/{o['component']} {o['type'] or 'of unknown type'} ({_many(o['messages'], 'message#')})"
            for o in summary["others"]
        )
        console.print(f"Also heard: {', '.join(others)}", soft_wrap=True)


def _damage(summary: dict[str, Any]) -> str:
    damage, refused = summary["damage"], summary["refused"]
    words = {
        "message# with a wrong checksum": damage["bad_crc"],
        "message# of an unknown kind": damage["unknown"],
        "stray byte#": damage["stray_bytes"],
        "unfinished message# at the end": damage["truncated"],
        "wrong time stamp#": damage["bad_stamps"],
        "sample# that are no numbers": refused["not_finite"],
    }
    return ", ".join(_many(count, what) for what, count in words.items() if count) or "no damage"


def _many(count: int, what: str) -> str:
    """Count things; # is where the plural has an s."""
    return f"{count} {what.replace('#', '' if count == 1 else 's')}"


def _show_vehicle(vehicle: dict[str, Any], console: "Console") -> None:
    from rich.table import Table

    console.print()
    kind = f"{vehicle['type'] or 'vehicle of unknown type'}, {vehicle['autopilot'] or 'autopilot unknown'}"
    reboots = f", {_many(vehicle['reboots'], 'reboot#')}" if vehicle["reboots"] else ""
    dropped = vehicle["late"] + vehicle["bad_stamps"]
    console.print(
        f"[bold]Vehicle {vehicle['system']}/{vehicle['component']}[/bold]  {kind}{reboots}"
        + (f", {_many(dropped, 'sample#')} too late or of a wrong time" if dropped else ""),
        soft_wrap=True,
    )
    if not vehicle["sessions"]:
        console.print("  no message carries the time since boot, so nothing can be put in order", soft_wrap=True)
    for number, session in enumerate(vehicle["sessions"]):
        start, end = session["boot_start_s"], session["boot_end_s"]
        gaps = (
            f", {_many(session['gaps'], 'gap#')} (longest {session['longest_gap_s']:.1f} s)" if session["gaps"] else ""
        )
        console.print(
            f"  Session {number}: {_minutes(end - start)}, {start:.1f} to {end:.1f} s after boot{gaps}", soft_wrap=True
        )
        table = Table("sensor", "message", box=None, padding=(0, 2, 0, 2))
        table.add_column("rate", justify="right")
        table.add_column("samples", justify="right")
        for sensor in session["sensors"]:
            rate = f"{sensor['rate_hz']:.1f} Hz" if sensor["rate_hz"] is not None else "-"
            table.add_row(sensor["sensor"], sensor["message"], rate, str(sensor["samples"]))
        console.print(table)
        for receiver in session["receivers"]:
            console.print(f"    {receiver['message']}: {_fix(receiver, start)}", soft_wrap=True)


def _fix(receiver: dict[str, Any], start_s: float) -> str:
    satellites = receiver["satellites"]
    seen = f", {'-'.join(str(n) for n in sorted(set(satellites)))} satellites" if satellites else ""
    if receiver["first_fix_boot_s"] is None:
        return f"never a 3D fix{seen}"
    after = receiver["first_fix_boot_s"] - start_s
    return f"3D fix in {receiver['fix_3d_share']:.1%}, first after {after:.1f} s, best {receiver['best_fix']}{seen}"


def _minutes(seconds: float) -> str:
    return f"{int(seconds) // 60} min {seconds % 60:04.1f} s" if seconds >= 60 else f"{seconds:.1f} s"
