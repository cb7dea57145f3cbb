"""What the parts share: settings, reading and estimating, tables."""

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mavkf.config import Config
from mavkf.replay.boot_clock import on_boot_clock
from mavkf.replay.options import Options, Watch
from mavkf.replay.results import SessionResult
from mavkf.replay.run import run_rows, vehicle_name
from mavkf.replay.tlog import read_tlog
from mavkf.service.vehicle import Step, VehicleStream

Array = NDArray[np.float64]
QUANTITIES = ("horizontal_m", "down_m", "tilt_deg", "yaw_deg")


@dataclass(frozen=True)
class Settings:
    """How to measure.

    folder: of the recorded flights; config: of the filter; as_live: in the order of arrival, else of measurement; quick: fewer runs.
    """

    folder: Path
    config: Config
    as_live: bool = True
    quick: bool = False


def read_rows(path: Path, config: Config, vehicle: str | None = None) -> Array:
    """Sample rows (n, ROW_WIDTH) of one vehicle of a log, in the order of arrival, with their boot times.

    vehicle: `<sysid>-<compid>`, None: the first.
    """
    log = read_tlog(path)
    address = next(found for found in log.vehicles() if vehicle in (None, vehicle_name(found)))
    return on_boot_clock(log.rows[address], config.timeline.window_s)[0]


def estimate(
    rows: Array,
    config: Config,
    as_live: bool = True,
    rate_hz: float = 50.0,
    step: Callable[[VehicleStream, Step], object] | None = None,
) -> SessionResult:
    """The estimate of the first session of rows (n, ROW_WIDTH) in the order of arrival; step: as of `mavkf.replay.options.Watch`."""
    return run_rows("1-1", rows, Options(as_live=as_live, rate_hz=rate_hz, config=config), Watch(step=step))[0][0]


def say(text: str) -> None:
    """Progress, on stderr."""
    print(f"accuracy: {text}", file=sys.stderr, flush=True)


def head(title: str, columns: Sequence[str]) -> None:
    """Begin a table."""
    print(f"\n## {title}\n")
    print(f"| {' | '.join(columns)} |")
    print("|" + "---|" * len(columns), flush=True)


def row(*cells: str) -> None:
    """One row of a table."""
    print(f"| {' | '.join(cells)} |", flush=True)


def cell(value: float | None, most: float = np.inf, least: float = -np.inf, digits: int = 3) -> str:
    """A number, bold with its bar where it is beyond it."""
    if value is None or not np.isfinite(value):
        return "not known"
    text = f"{value:.{digits}f}"
    if value > most:
        return f"**{text}** ({most:g})"
    return f"**{text}** ({least:g})" if value < least else text
