"""Estimate a log: offline in the order of measurement, or as live in the order of arrival."""

import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mavkf.ahead import Ahead
from mavkf.errors import LogError, UsageError
from mavkf.link.clocks import ClockCounts
from mavkf.link.decode import Address
from mavkf.replay.options import NOBODY, Options, Watch, check
from mavkf.replay.results import Result, SessionResult
from mavkf.replay.vehicle_run import VehicleRun, Work
from mavkf.service.playback import reader_of

Array = NDArray[np.float64]
BLOCK = 16_384  # rows that are taken at once


def vehicle_name(address: Address) -> str:
    """`<sysid>-<compid>` of a (system, component)."""
    return f"{address[0]}-{address[1]}"


def run(path: Path | Sequence[Path], options: Options, watch: Watch = NOBODY, *, keep: bool = True) -> Result:
    """Replay a log, or the logs of several links of one flight as one.

    keep: whether rows and outputs are wanted at the end; without, memory does not grow with the log, unless there are several or faults are
    put into it. Raises LogError, UsageError.
    """
    check(options)
    begin = time.perf_counter()
    reader = reader_of([path] if isinstance(path, Path) else path)
    vehicles: dict[Address, VehicleRun] = {}

    def prepared() -> Iterator[list[tuple[VehicleRun, list[Work]]]]:
        for block in reader:
            works = []
            for address, rows in block.rows.items():
                name = vehicle_name(address)
                if address not in vehicles:
                    wanted = options.vehicle in (None, name)
                    vehicles[address] = VehicleRun(name, options, watch, keep=keep, wanted=wanted)
                works.append((vehicles[address], vehicles[address].prepare(rows)))
            yield works

    try:
        with Ahead(prepared()) as blocks:
            for works in blocks:
                for vehicle, work in works:
                    vehicle.work(work)
                watch.progress("estimating", reader.share)
        chosen = _chosen(reader.name, {address: vehicles[address] for address in sorted(vehicles)}, options)
        sessions = [session for vehicle in chosen for session in vehicle.finish()]
    finally:
        for vehicle in vehicles.values():
            vehicle.close()
    if options.session is not None and not sessions:
        raise UsageError(
            f"--session {options.session}: no vehicle has a session of this number; `mavkf info {reader.name}` lists them"
        )
    clocks = {vehicle.name: vehicle.clock.counts for vehicle in chosen}
    total = time.perf_counter() - begin
    return Result(reader.name, reader.size, reader.damage, sessions, clocks, blocks.busy_s, total)


def _chosen(log: str, heard: dict[Address, VehicleRun], options: Options) -> list[VehicleRun]:
    """The vehicles that were to be replayed. Raises LogError or UsageError where there is none."""
    vehicles = [vehicle for vehicle in heard.values() if vehicle.is_vehicle]
    if not vehicles:
        raise LogError(
            f"{log} has no vehicle: no component in it sends IMU or GNSS messages; record the autopilot's own telemetry"
        )
    named = [vehicle for vehicle in vehicles if options.vehicle in (None, vehicle.name)]
    if not named:
        raise UsageError(f"--vehicle {options.vehicle}: this log has {', '.join(vehicle.name for vehicle in vehicles)}")
    return named


def run_rows(
    name: str, rows: Array, options: Options, watch: Watch = NOBODY
) -> tuple[list[SessionResult], ClockCounts]:
    """Estimate the sample rows (n, ROW_WIDTH) of one vehicle, in the order of arrival, as `run` does for each vehicle of a log.

    name: of the vehicle. TIME and SESSION of the rows are not read. Raises UsageError.
    """
    vehicle = VehicleRun(name, options, watch, keep=True, wanted=True)
    for first in range(0, len(rows), BLOCK):
        vehicle.work(vehicle.prepare(rows[first : first + BLOCK]))
    sessions = vehicle.finish()
    vehicle.close()
    return sessions, vehicle.clock.counts
