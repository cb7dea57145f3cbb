"""`mavkf simulate`: make a flight with known truth."""

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from mavkf.cli._console import messages, say
from mavkf.errors import UsageError


def simulate(
    out: Annotated[Path, Parameter(help="Telemetry log (.tlog) to write; an existing one is replaced.")],
    /,
    *,
    truth: Annotated[Path | None, Parameter(help="CSV file for the true motion, 100 rows a second.")] = None,
    seed: Annotated[int, Parameter(help="Draws the route and all sensor errors; the same seed, the same file.")] = 1,
    duration: Annotated[float, Parameter(help="Seconds from boot to the end, at least 60.")] = 120.0,
    vehicle: Annotated[Literal["copter", "plane"], Parameter(help="What flies.")] = "copter",
    imu_hz: Annotated[float, Parameter(help="Rate of RAW_IMU, 1 to 400.")] = 200.0,
    highres_imu: Annotated[bool, Parameter(help="Send HIGHRES_IMU too, at half that rate.")] = False,
    gnss_hz: Annotated[float, Parameter(help="Rate of fixes.")] = 5.0,
    gnss_delay: Annotated[float, Parameter(help="Seconds from the measurement of a fix to its stamp.")] = 0.085,
    noise: Annotated[float, Parameter(help="Factor on all sensor errors; 0 for none.")] = 1.0,
    lat: Annotated[float, Parameter(help="Latitude of the start, degrees.")] = 47.397742,
    lon: Annotated[float, Parameter(help="Longitude of the start, degrees.")] = 8.545594,
    alt: Annotated[float, Parameter(help="Height of the start above sea level, metres.")] = 488.0,
    heading: Annotated[float, Parameter(help="Heading at the start, degrees from north.")] = 30.0,
    fault: Annotated[
        tuple[str, ...],
        Parameter(
            show_default=False,
            help="A fault of the sensors, as gnss-step:at=60,for=8,size=40,towards=330; may be repeated; "
            "`mavkf replay --faults` lists the kinds.",
        ),
    ] = (),
    system_id: Annotated[int, Parameter(help="MAVLink system that sends.")] = 1,
) -> int:
    """Make a flight with known truth, written as the telemetry that an ArduPilot would send."""
    from rich.progress import Progress

    from mavkf.replay.faults import parse_fault
    from mavkf.replay.simulation import SensorNoise
    from mavkf.replay.simulation import simulate as fly

    if not noise >= 0.0:
        raise UsageError(f"--noise is {noise:g}, but must be 0 or more")
    if truth is not None and (
        truth.is_dir() or not truth.absolute().parent.is_dir() or truth.resolve() == out.resolve()
    ):
        raise UsageError(f"--truth is {truth}, but must be another file than the log, in an existing folder")
    faults = tuple(map(parse_fault, fault))
    console = messages()
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("flying", total=1.0)
        motion = fly(
            out,
            seed=seed,
            duration_s=duration,
            vehicle=vehicle,
            imu_hz=imu_hz,
            highres_imu=highres_imu,
            gnss_hz=gnss_hz,
            gnss_message_hz=gnss_hz,
            gnss_delay=gnss_delay,
            noise=SensorNoise().scaled(noise),
            start=(lat, lon, alt, heading),
            address=(system_id, 1),
            faults=faults,
            progress=lambda done: bar.update(task, completed=done),
        )
    say(f"wrote {out}: {duration:g} s of a {vehicle}, seed {seed}, {out.stat().st_size / 1e6:.1f} MB")
    for ordered in faults:
        say(f"{out} has a fault: {ordered}")
    if truth is not None:
        motion.write_csv(truth)
        say(f"wrote {truth}: the truth at {len(motion.time_boot_s)} times")
    return 0
