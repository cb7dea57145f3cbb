"""A car with an IMU at 100 Hz, whose clock lags by about 0.05 s, and fixes once a second without velocity.

The recording is drive 2011_10_03_drive_0027 of KITTI as GTSAM carries it. Fixes and truth come from one solution, so what is measured is
the error between the fixes, and whether the filter finds the lag. No magnetometer, no barometer.
"""

from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.accuracy.common import Array, Settings, cell, estimate, head, row
from benchmarks.accuracy.sample_rows import gnss, heartbeats, imu, in_order_of_arrival
from mavkf.config import Config, with_settings
from mavkf.models.strapdown import DDELAY, DELAY
from mavkf.navigation import layout as L
from mavkf.replay.export import columns
from mavkf.replay.simulation.trajectory import ecef, geodetic
from mavkf.replay.truth import Truth, errors
from mavkf.service.vehicle import Step, VehicleStream

FOLDER = Path("public/gtsam-kitti")
ORIGIN = np.radians([49.0, 8.4])  # where east, north, up begin: near Karlsruhe
BEFORE = 46530.0  # s: boot, on the clock of the files
BOOT_UTC_US = 1317646530e6  # 3 October 2011
SIGMA = 0.07  # m: per axis, what GTSAM's example of this recording takes
GNSS_LATENCY = 0.1  # s
BEGIN = 60.0  # s of boot time: scored from here
BAR = 0.5  # m
TOLD_LAG = 0.05  # s


def to_geodetic(enu: Array) -> tuple[Array, Array, Array]:
    """Latitude, longitude (rad), height (m), each (n), of east, north, up (n, 3), m, in the plane that touches at ORIGIN."""
    latitude, longitude = ORIGIN
    (sl, cl), (so, co) = (np.sin(latitude), np.cos(latitude)), (np.sin(longitude), np.cos(longitude))
    C_e_enu = np.array([[-so, -sl * co, cl * co], [co, -sl * so, cl * so], [0.0, cl, sl]])
    return geodetic(ecef(np.array([latitude]), np.array([longitude]), np.zeros(1)) + enu @ C_e_enu.T)


def euler(quaternion: Array) -> Array:
    """Roll, pitch, yaw (n, 3), rad, of b (forward-right-down) in n, from quaternions x y z w (n, 4): forward-left-up to east-north-up."""
    x, y, z, w = (quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)).T
    C = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    C = np.array([C[1], C[0], -C[2]]) * np.array([1.0, -1.0, -1.0])[None, :, None]
    return np.stack([np.arctan2(C[2, 1], C[2, 2]), -np.arcsin(C[2, 0]), np.arctan2(C[1, 0], C[0, 0])], axis=1)


def read_kitti(folder: Path) -> tuple[Array, Truth]:
    """Rows in the order of arrival, and the truth on the clock of the fixes."""
    inertial = np.loadtxt(folder / "KittiEquivBiasedImu.txt", skiprows=2)  # the first row has no interval
    fixes = np.loadtxt(folder / "KittiGps_converted.txt", delimiter=",", skiprows=1)
    true = np.loadtxt(folder / "truth_imu_enu.csv", delimiter=",")
    t, fix_t = inertial[:, 0] - BEFORE, fixes[:, 0] - BEFORE
    to_b = np.array([1.0, -1.0, -1.0])  # forward-left-up to forward-right-down
    no_velocity = np.full((fix_t.size, 3), np.nan)
    rows = in_order_of_arrival(
        heartbeats(0.5, float(t[-1]), BOOT_UTC_US),
        imu(t, inertial[:, 5:8] * to_b, inertial[:, 2:5] * to_b, (0.0, 0.0), 0.0, BOOT_UTC_US),
        gnss(
            fix_t,
            to_geodetic(fixes[:, 1:4]),
            no_velocity,
            np.full(fix_t.size, 6),
            (SIGMA, SIGMA, np.nan),
            GNSS_LATENCY,
            BOOT_UTC_US,
        ),
    )
    unknown = np.full((true.shape[0], 3), np.nan)
    return rows, Truth(true[:, 0] - BEFORE, *to_geodetic(true[:, 1:4]), unknown, euler(true[:, 4:8]))


def measure(rows: Array, truth: Truth, config: Config, as_live: bool) -> dict[str, Any]:
    """One run: errors against the truth, on the IMU's clock and on that of the fixes, and the delay that was found."""
    course: list[tuple[float, float, float]] = []

    def watch(live: VehicleStream, _: Step) -> None:
        if live.estimator is not None and live.estimator.setup is not None:
            s = live.estimator.state
            course.append((s[L.T], s[L.X + DELAY], np.sqrt(L.covariance(s)[DDELAY, DDELAY])))

    session = estimate(rows, config, as_live, step=watch)
    pose = columns(session.output.poses)
    at_stamps = errors(pose, truth, begin=BEGIN).statistics
    result: dict[str, Any] = {
        "at_stamps": {name: each.rms for name, each in at_stamps.items()},
        "events": [[int(note[L.NOTE_CODE]), float(note[L.NOTE_END])] for note in session.output.notes],
    }
    if course:
        # a fix stamped s was measured at s - delay on the estimate's clock, so its time t is t + delay on that of the fixes
        when, delay, sigma = np.array(course).T
        order = np.argsort(when, kind="stable")
        shifted = pose | {
            "time_boot_s": pose["time_boot_s"] + np.interp(pose["time_boot_s"], when[order], delay[order])
        }
        found = errors(shifted, truth, begin=BEGIN).statistics
        result["on_clock_of_fixes"] = {name: {"rms": each.rms, "max": each.max} for name, each in found.items()}
        result["error_over_sigma"] = {name: each.error_over_sigma for name, each in found.items()}
        result["delay_s"], result["delay_sigma_s"] = float(delay[order[-1]]), float(sigma[order[-1]])
        result["delay_course"] = [
            [float(t), float(np.interp(t, when[order], delay[order]))] for t in np.arange(30.0, when.max(), 30.0)
        ]
    return result


def run(settings: Settings) -> dict[str, Any]:
    """Run with the lag unknown, and with it told; print both."""
    rows, truth = read_kitti(settings.folder / FOLDER)
    cases = {
        "lag to be found": settings.config,
        f"told that the IMU lags {TOLD_LAG:g} s": with_settings(
            settings.config, [f"vehicle.imu_delay_s={TOLD_LAG}", "noise.gnss_delay_initial_s=0"]
        ),
    }
    results = {}
    head(
        "kitti",
        (
            "case",
            "horizontal m rms",
            "max",
            "without the delay that was found, rms",
            "tilt deg",
            "yaw deg",
            "GNSS against IMU s",
            "sigma s",
        ),
    )
    for name, config in cases.items():
        result = results[name] = measure(rows, truth, config, settings.as_live)
        mapped = result.get("on_clock_of_fixes", {})
        nothing = {"rms": np.nan, "max": np.nan}
        row(
            name,
            cell(mapped.get("horizontal_m", nothing)["rms"], BAR),
            cell(mapped.get("horizontal_m", nothing)["max"], BAR),
            cell(result["at_stamps"].get("horizontal_m")),
            cell(mapped.get("tilt_deg", nothing)["rms"]),
            cell(mapped.get("yaw_deg", nothing)["rms"]),
            cell(result.get("delay_s")),
            cell(result.get("delay_sigma_s")),
        )
    return results
