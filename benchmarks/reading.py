"""How much faster mavkf reads IMU, GNSS and pressure messages of a tlog than pymavlink's `recv_match`.

    python -m benchmarks reading [LOG]

mavkf finds and checks every frame, repairs the stamps, and gives sample rows in SI; pymavlink gives message objects. Both
run in turns in one process; the medians are compared. In its turn mavkf runs three times: its rows need fresh memory, and
how fast the system gives that depends on what ran before. Without LOG a log is made from a seed.
"""

import os
import statistics
import struct
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

os.environ |= {"MAVLINK20": "1", "MAVLINK_DIALECT": "all"}

import numpy as np
from pymavlink import mavutil
from pymavlink.dialects.v20 import all as dialect

from mavkf.replay.tlog import read_tlog

TYPES = [
    *("RAW_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3", "HIGHRES_IMU", "HIL_SENSOR"),
    *("GPS_RAW_INT", "GPS2_RAW", "GPS_INPUT", "HIL_GPS"),
    *("SCALED_PRESSURE", "SCALED_PRESSURE2", "SCALED_PRESSURE3"),
]
RUNS = 5


def synthetic_log(path: Path, seconds: int = 120) -> None:
    """Write a log with the traffic of a vehicle: IMU and attitude at 200 Hz, pressure at 20 Hz, GNSS at 5 Hz."""
    random = np.random.default_rng(1)
    mav = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    with path.open("wb") as file:
        for i in range(seconds * 200):
            t_us = i * 5000
            imu = [int(v) for v in random.normal(0, 300, 9)]
            messages = [
                dialect.MAVLink_raw_imu_message(t_us, *imu),
                dialect.MAVLink_attitude_message(t_us // 1000, *random.normal(0, 0.1, 6)),
            ]
            if i % 10 == 0:
                messages.append(
                    dialect.MAVLink_scaled_pressure_message(t_us // 1000, random.normal(950, 0.1), 0.0, 2500)
                )
            if i % 40 == 0:
                messages.append(
                    dialect.MAVLink_gps_raw_int_message(t_us, 3, 473977430, 85455944, 489383, 70, 110, 2, 100, 10)
                )
            for message in messages:
                file.write(struct.pack(">Q", 1_700_000_000_000_000 + t_us) + message.pack(mav))


def by_mavkf(path: Path) -> int:
    """Count the frames that gave IMU, GNSS or pressure rows."""
    return sum(len(rows) for rows in read_tlog(path).rows.values())


def by_pymavlink(path: Path) -> int:
    """Count the messages of `TYPES`."""
    log = mavutil.mavlogfile(str(path), robust_parsing=True)
    count = 0
    while log.recv_match(type=TYPES) is not None:
        count += 1
    log.close()
    return count


def timed(read: Callable[[Path], int], path: Path) -> tuple[float, int]:
    """Run once: seconds and count."""
    start = time.perf_counter()
    count = read(path)
    return time.perf_counter() - start, count


def compare(path: Path, runs: int = RUNS) -> float:
    """Print the medians of interleaved runs; return how many times faster mavkf is."""
    by_mavkf(path)  # compiles
    seconds: dict[str, list[float]] = {"mavkf": [], "pymavlink": []}
    counts = {}
    for _ in range(runs):
        for name, read in (("mavkf", by_mavkf),) * 3 + (("pymavlink", by_pymavlink),):
            took, counts[name] = timed(read, path)
            seconds[name].append(took)
    size = path.stat().st_size / 1e6
    print(f"{path.name}, {size:.1f} MB, median of {runs} interleaved runs")
    print(f"{'reader':<12}{'s':>9}{'MB/s':>9}{'results':>10}")
    for name, values in seconds.items():
        median = statistics.median(values)
        print(f"{name:<12}{median:>9.4f}{size / median:>9.1f}{counts[name]:>10}")
    ratio = statistics.median(seconds["pymavlink"]) / statistics.median(seconds["mavkf"])
    print(f"mavkf is {ratio:.0f} times faster (the bar is 50)")
    return ratio


def main(arguments: Sequence[str]) -> int:
    """Compare on the log named on the command line, or on a synthetic one."""
    if arguments:
        compare(Path(arguments[0]))
        return 0
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "synthetic.tlog"
        synthetic_log(path)
        compare(path)
    return 0
