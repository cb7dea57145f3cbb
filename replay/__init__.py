"""Offline work on flight logs. The package itself can be called: `mavkf.replay(path, **options)`.

flights = mavkf.replay("flight.tlog", as_live=True)
first = flights["1-1"][0]           # vehicle, session
first["lat_deg"], first["sigma_n_m"]  # arrays, one value a row; NaN where nothing is known
"""

import sys
from pathlib import Path
from types import ModuleType
from typing import Any


class _Replay(ModuleType):
    def __call__(self, path: str | Path, **options: Any) -> "dict[str, dict[int, Any]]":
        """Estimate a log. Returns arrays by vehicle and session.

        Options are those of `mavkf.replay.options.Options` (as_live, rate_hz, span, vehicle, session, imu, model, config,
        faults, smooth, form, update); imu may be a name, and faults texts.
        Each session is a dict of arrays (n,): the columns of the CSV export, `time_boot_s` to `sigma_yaw_deg`.
        Raises LogError or UsageError.
        """
        from mavkf.replay.export import columns
        from mavkf.replay.faults import parse_fault
        from mavkf.replay.options import Options, imu_source
        from mavkf.replay.run import run

        if isinstance(options.get("imu"), str):
            options["imu"] = imu_source(options["imu"])
        if "faults" in options:
            options["faults"] = tuple(
                parse_fault(fault) if isinstance(fault, str) else fault for fault in options["faults"]
            )
        found: dict[str, dict[int, Any]] = {}
        for session in run(Path(path), Options(**options)).sessions:
            found.setdefault(session.vehicle, {})[session.session] = columns(session.output.poses)
        return found


sys.modules[__name__].__class__ = _Replay
