"""Reading: a tlog to arrays of IMU, GNSS and pressure.

mavkf finds and checks every frame, repairs the stamps, and gives sample rows in SI; fasttlogparser gives arrays of fields, pymavlink
message objects, `numpy.fromfile` the bytes alone.
"""

import os
import tempfile
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from benchmarks.speed.measure import Figure, Settings, alone, figure, in_turns, missing, seconds
from mavkf.ahead import Ahead
from mavkf.link.framing import scan_records
from mavkf.replay.tlog import TlogReader, map_log, read_tlog
from mavkf.samples import ACCEL, FIX, GNSS_YAW, GYRO, IMU_TEMPERATURE, KIND, PRESSURE, SOURCE, STAMP, Kind, Source

Array = NDArray[np.float64]
COLUMNS = {
    Kind.IMU: [STAMP, SOURCE, *range(GYRO, ACCEL + 3), IMU_TEMPERATURE],
    Kind.GNSS: [STAMP, SOURCE, *range(FIX, GNSS_YAW + 1)],
    Kind.BAROMETER: [STAMP, SOURCE, PRESSURE],
}
MESSAGES = (Source.RAW_IMU, Source.GPS_RAW_INT, Source.SCALED_PRESSURE)
TYPES = [message.name for message in MESSAGES]
SIZE = 100_000_000  # bytes
PARSED = 20_000_000  # bytes that pymavlink reads of it: its time grows with them
RUNS = 5


def run(settings: Settings) -> list[Figure]:
    """Read a log that is repeated to so many bytes."""
    figures = _read(settings, settings.log.stat().st_size if settings.quick else SIZE)
    return figures + (_read(settings, 5 * SIZE) if settings.full else [])


def _read(settings: Settings, size: int) -> list[Figure]:
    flight = settings.log.read_bytes()
    times = max(1, round(size / len(flight)))
    fast = fasttlogparser()
    with tempfile.TemporaryDirectory() as folder:
        whole, part = Path(folder) / "whole.tlog", Path(folder) / "part.tlog"
        with whole.open("wb") as file:
            for _ in range(times):
                file.write(flight)
        part.write_bytes(flight * max(1, min(times, PARSED // len(flight))))
        megabytes = times * len(flight) / 1e6
        works = {
            "bytes": lambda: megabytes / seconds(lambda: np.fromfile(whole, np.uint8)),
            "read": lambda: megabytes / seconds(lambda: arrays(whole)),
            "all": lambda: megabytes / seconds(lambda: arrays(whole, Source)),
            "log": lambda: megabytes / seconds(lambda: read_tlog(whole)),
            "scan": lambda: megabytes / seconds(lambda: scan_records(map_log(whole))),
            "pymavlink": lambda: part.stat().st_size / 1e6 / seconds(lambda: count(part)),
        }
        if fast is not None:
            works["fast"] = lambda: megabytes / seconds(lambda: fast.parseTLog(str(whole), whitelist=TYPES))
        took = in_turns(works, settings.runs(RUNS), warm=not settings.quick)
    on = f"{settings.named} {times} times, {megabytes:.0f} MB"
    read, unit = took["read"], "MB/s"
    title = "mavkf `TlogReader`, to arrays"
    figures = [
        figure(title, unit, read, "pymavlink `recv_match`", took["pymavlink"], on),
        figure(title, unit, read, "`numpy.fromfile`", took["bytes"], "of the same bytes, which gives no fields"),
    ]
    if fast is None:
        figures.append(missing("fasttlogparser", "not installed: `pip install --no-build-isolation fasttlogparser`"))
    else:
        figures.insert(1, figure(title, unit, read, "fasttlogparser", took["fast"], "of the same messages"))
        figures.append(alone("fasttlogparser", unit, took["fast"]))
    return [
        *figures,
        figure(
            "mavkf `TlogReader`, of all sensors", unit, took["all"], title, read, "IMU, GNSS, pressure of all messages"
        ),
        figure("mavkf `scan_records` alone", unit, took["scan"], title, read, "frames found, CRC checked"),
        figure("mavkf `read_tlog`", unit, took["log"], title, read, "all rows, of all sensors, in memory"),
        alone("pymavlink `recv_match`", unit, took["pymavlink"]),
        alone("`numpy.fromfile`", unit, took["bytes"], "bound by the memory"),
    ]


def arrays(path: Path, messages: Iterable[Source] = MESSAGES) -> dict[Kind, Array]:
    """Read arrays of the IMU, GNSS and pressure samples of some messages: STAMP, SOURCE and what was measured."""
    parts: dict[Kind, list[Array]] = {kind: [] for kind in COLUMNS}
    with Ahead(iter(TlogReader(path, messages))) as blocks:
        for block in blocks:
            for rows in block.rows.values():
                kinds = rows[:, KIND].astype(np.int8)
                for kind, columns in COLUMNS.items():
                    mine = np.flatnonzero(kinds == kind)
                    parts[kind].append(np.take(rows, mine, axis=0)[:, columns])
    return {kind: np.concatenate(found) for kind, found in parts.items()}


def count(path: Path) -> int:
    """Count the messages of `TYPES` by pymavlink."""
    os.environ |= {"MAVLINK20": "1", "MAVLINK_DIALECT": "ardupilotmega"}
    from pymavlink import mavutil

    log = mavutil.mavlogfile(str(path), robust_parsing=True)
    result = 0
    while log.recv_match(type=TYPES) is not None:
        result += 1
    log.close()
    return result


def fasttlogparser() -> ModuleType | None:
    """Give the module, where it is installed."""
    try:
        import fasttlogparser as module
    except ImportError:
        return None
    result: ModuleType = module
    return result
