"""A car, IMU at 100 Hz, RTK fixes at 4 Hz; the fixes are hidden for 15 s at a time and compared with the pose when they come back.

The recording is drive_0708 of rtklibexplorer/GNSS_IMU: an ICM-45686 and a u-blox X20 on the roof. No magnetometer, no barometer.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.accuracy.common import Array, Settings, cell, estimate, head, row
from benchmarks.accuracy.outages import cut
from benchmarks.accuracy.rtklib import arrivals, clock_of, read_solution
from benchmarks.accuracy.sample_rows import gnss, heartbeats, imu, in_order_of_arrival
from mavkf.config import with_settings
from mavkf.models.earth import STANDARD_GRAVITY
from mavkf.replay.boot_clock import on_boot_clock
from mavkf.replay.export import columns
from mavkf.replay.truth import Truth, errors

FOLDER = Path("public/GNSS_IMU/drive_0708")
# The recording's notes turn the body's vectors into the IMU's by roll, pitch, yaw of (179.71, -6.60, 185.35) deg; this is the way back.
MOUNTING = ("vehicle.imu_rotation_deg=[-179.6726, 6.5983, -174.6478]", "vehicle.gnss_antenna_b_m=[0.0, -0.05, 0.0]")
LOGGING_DELAY = 0.185
"""s: age of an IMU sample when its line arrives.

The notes say 0.125 s on a clock that lets the first line come at the tag's begin and the last at its end; by the tag itself the first
came 0.14 s after its begin, and the lines kept a steady pace that ends 0.02 s before its end: on the mean that clock is 0.06 s early.
"""
GNSS_LATENCY = 0.1  # s: a fix is there this long after its epoch
COUNTS = 1e-3  # of the file: g, deg/s
FIRST, EVERY, LENGTH, LAST = 40.0, 45.0, 15.0, 30.0  # s: first outage, period, length; none in the last
BAR = 3.5  # m: median of the horizontal error at the end


@dataclass(frozen=True)
class Drive:
    """Timed rows of all sensors in the order of arrival, those of the IMU in its own axes, and the fixes as truth, on the IMU's clock."""

    rows: Array
    fixes: Truth


def read_drive(folder: Path, window_s: float) -> Drive:
    """Read the recording; window_s: of the timeline."""
    (log,) = folder.glob("imu_*.csv")
    (solution_file,) = folder.glob("gnss_*.pos")
    table = np.loadtxt(log, delimiter=",")
    ms = table[:, 6] * 1e-3
    offset, rate = clock_of(ms, arrivals(log)[: ms.size])
    # on the logger's clock, from the first sample on
    origin = offset + rate * ms[0] - LOGGING_DELAY - 1.0
    t = offset + rate * ms - LOGGING_DELAY - origin
    utc_us = origin * 1e6
    omega, force = np.radians(table[:, 3:6]), table[:, :3] * STANDARD_GRAVITY
    s = read_solution(solution_file)
    fix_t = s.t - origin
    use = fix_t > 0.0  # the receiver was on before the IMU
    place = (s.place[0][use], s.place[1][use], s.place[2][use])
    fix = np.where(s.quality[use] == 1, 6, np.where(s.quality[use] == 2, 5, 3))  # MAVLink: RTK fixed, RTK float, 3D
    sigma = (s.sigma[0][use], s.sigma[1][use], s.sigma[2][use])
    rows = in_order_of_arrival(
        heartbeats(0.5, float(t[-1]), utc_us),
        imu(t, omega, force, (math.radians(COUNTS), COUNTS * STANDARD_GRAVITY), LOGGING_DELAY, utc_us),
        gnss(fix_t[use], place, s.v_n[use], fix, sigma, GNSS_LATENCY, utc_us),
    )
    unknown = np.full((int(use.sum()), 3), np.nan)
    return Drive(on_boot_clock(rows, window_s)[0], Truth(fix_t[use], *place, s.v_n[use], unknown))


def outages(fixes: Truth) -> list[tuple[float, float]]:
    """Begin and end, s, of the outages: the first FIRST s after the first fix, none in the last LAST s."""
    first, last = fixes.time_boot_s[0], fixes.time_boot_s[-1]
    count = math.floor((last - LAST - first - FIRST - LENGTH) / EVERY) + 1
    return [(first + FIRST + i * EVERY, first + FIRST + i * EVERY + LENGTH) for i in range(count)]


def run(settings: Settings) -> dict[str, Any]:
    """One run with all outages; print the error at the end of each."""
    drive = read_drive(settings.folder / FOLDER, settings.config.timeline.window_s)
    rows = drive.rows
    for begin, end in outages(drive.fixes):
        rows = cut(rows, begin, end)
    config = with_settings(settings.config, MOUNTING)
    pose = columns(estimate(rows, config, settings.as_live).output.poses)
    ends: list[dict[str, Any]] = []
    head("drive", ("outage from s", "speed m/s", "horizontal m", "down m", "error over sigma, horizontal"))
    for begin, end in outages(drive.fixes):
        last = int(np.searchsorted(pose["time_boot_s"], end, side="right")) - 1
        found = errors({name: column[last : last + 1] for name, column in pose.items()}, drive.fixes).statistics
        known = "horizontal_m" in found
        speed = float(np.linalg.norm(drive.fixes.velocity[np.searchsorted(drive.fixes.time_boot_s, begin), :2]))
        result = {
            "begin_s": begin,
            "speed_m_s": speed,
            "horizontal_m": found["horizontal_m"].max if known else np.nan,
            "down_m": found["down_m"].max if known else np.nan,
            "error_over_sigma": found["horizontal_m"].error_over_sigma if known else np.nan,
        }
        ends.append(result)
        row(f"{begin:.0f}", f"{speed:.1f}", *(cell(result[key], digits=2) for key in list(result)[2:]))
    # the car has not moved before the first one, so its heading is not known yet
    later = [end["horizontal_m"] for end in ends[1:]]
    median = float(np.median(later))
    row(
        "median but for the first",
        "",
        cell(median, BAR, digits=2),
        f"{np.median([e['down_m'] for e in ends[1:]]):.2f}",
        "",
    )
    row("largest but for the first", "", f"{np.max(later):.2f}", f"{np.max([e['down_m'] for e in ends[1:]]):.2f}", "")
    full = columns(estimate(drive.rows, settings.config, settings.as_live).output.poses)
    with_fixes = errors(full, drive.fixes, begin=drive.fixes.time_boot_s[0] + 50.0).statistics
    row("none: with all fixes, rms", "", f"{with_fixes['horizontal_m'].rms:.3f}", f"{with_fixes['down_m'].rms:.3f}", "")
    return {
        "median_m": median,
        "max_m": float(np.max(later)),
        "outages": ends,
        "with_fixes": {name: with_fixes[name].rms for name in ("horizontal_m", "down_m")},
    }
