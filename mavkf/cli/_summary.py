"""The summary of a replay for people."""

from typing import Any

from mavkf.cli._findings import print_findings

MOST_EVENTS = 12


def print_summary(summary: dict[str, Any], findings: bool = False) -> None:
    """Print what `mavkf.replay.summary.summarise` found. findings: all of the diagnosis too."""
    line = print
    damage = summary["damage"]
    harm = [f"{damage[key]} {name}" for key, name in _DAMAGE.items() if damage[key]]
    line(
        f"{summary['log']}: {summary['size_bytes'] / 1e6:.2f} MB, {damage['frames']} frames, {', '.join(harm) or 'undamaged'}"
    )
    for session in summary["sessions"]:
        line()
        _session(line, session)
        if findings:
            print_findings(line, session["diagnosis"])
    time = summary["time"]
    line()
    line(
        f"{time['flown_s']:.1f} s of flight in {time['total_s']:.2f} s "
        f"(reading, meanwhile, {time['read_s']:.2f} s): {time['times_real_time']:.0f} times real time"
    )


_DAMAGE = {
    "bad_crc": "with a bad checksum",
    "unknown": "of unknown messages",
    "stray_bytes": "stray bytes",
    "truncated": "truncated",
    "bad_stamps": "bad stamps",
}


def _session(line: Any, session: dict[str, Any]) -> None:
    line(
        f"vehicle {session['vehicle']}, session {session['session']}: "
        f"{session['from_s']:.1f} s to {session['to_s']:.1f} s on the boot clock"
    )
    for reason in session["setup"] + session["smoothing"]:
        line(f"  {reason}")
    other = session["filter"]
    if other is not None:
        line(
            f"  form {other['form']}, order {other['order']}, model {other['model']}: {other['predictions']} predictions of "
            f"{other['prediction_us']:.1f} us, {other['updates']} updates of {other['update_us']:.1f} us; "
            f"begun anew from the fold {other['restarts']} times"
        )
    rates = session["rates_hz"]
    line("  rates: " + ", ".join(f"{name} {rate:g} Hz" for name, rate in rates.items()))
    gaps, counts = session["gaps"], session["counts"]
    line(
        f"  gaps: {gaps['imu']} of the IMU, {gaps['clock']} of the clock"
        + (f" (longest {gaps['longest_s']:.1f} s)" if gaps["clock"] else "")
        + f"; late {counts['late']}, bad stamps {counts['bad_stamps']}, "
        f"repeated values {counts['repeated']}, fixes without position {counts['without_fix']}"
    )
    if session["sensors"]:
        line(
            f"  {'sensor':<16}{'used':>8}{'refused':>9}{'NIS':>8}   (mean for each degree of freedom; 1 where the noise is as assumed)"
        )
    for name, found in session["sensors"].items():
        nis = "" if found["nis"] is None else f"{found['nis']:8.3f}"
        line(f"  {name:<16}{found['count'] - found['refused']:>8}{found['refused']:>9}{nis:>8}")
    _diagnosis(line, session["diagnosis"])
    coverage = session["coverage"]
    if coverage["tilt"] is not None:
        line("  valid: " + ", ".join(f"{name} {share:.1%}" for name, share in coverage.items()) + " of the time")
    end = session["end"]
    if end is not None:
        _end(line, end)
    told = [event for event in session["events"] if event["kind"] != "imu_gap"]  # those are counted above
    for event in told[:MOST_EVENTS]:
        line(f"  {event['t_s']:10.2f} s  {event['text']}")
    more = len(told) - MOST_EVENTS
    if more > 0:
        line(f"  ... and {more} more events (all of them by --json)")


def _diagnosis(line: Any, diagnosis: dict[str, Any]) -> None:
    for sentence in diagnosis["said"]:
        line(f"  ! {sentence}")
    verdicts = {name: sensor["verdict"] for name, sensor in diagnosis["sensors"].items()}
    if not diagnosis["said"] and any(verdict != "unknown" for verdict in verdicts.values()):
        marginal = ", ".join(name for name, verdict in verdicts.items() if verdict not in ("fine", "unknown"))
        line(
            "  diagnosis: nothing speaks against the filter"
            + (f"; marginal: {marginal} (--diagnose)" if marginal else "")
        )


def _end(line: Any, end: dict[str, Any]) -> None:
    if end["lat_deg"] is not None:
        north, east, down = end["sigma_position_m"]
        line(
            f"  at the end: {end['lat_deg']:.7f} {end['lon_deg']:.7f} deg, {end['alt_amsl_m']:.2f} m above mean sea level, "
            f"one sigma {north:.2f} {east:.2f} {down:.2f} m (north, east, down)"
        )
    if end["euler_deg"][0] is not None:
        angles = ["?" if angle is None else f"{angle:.2f}" for angle in end["euler_deg"]]
        sigmas = ["?" if sigma is None else f"{sigma:.2f}" for sigma in end["sigma_euler_deg"]]
        line(f"  roll, pitch, yaw {' '.join(angles)} deg, one sigma {' '.join(sigmas)} deg")
