"""Pictures of an estimate beside the truth (needs the extra `plot`)."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavkf.errors import UsageError
from mavkf.replay.truth import SIGMAS, Truth, errors

Floats = NDArray[np.float64]
SIGMAS_SHOWN = 2.0
PANELS = (
    ("north_m", "north, m"),
    ("east_m", "east, m"),
    ("down_m", "down, m"),
    ("roll_deg", "roll, deg"),
    ("pitch_deg", "pitch, deg"),
    ("yaw_deg", "yaw, deg"),
)


def plot_errors(path: Path, estimate: Mapping[str, Floats], truth: Truth, title: str) -> None:
    """Draw the track, and errors between plus and minus two claimed sigma over time, to a file (its ending says the format).

    estimate: columns as of `mavkf.replay.truth.errors`. Raises UsageError where matplotlib is missing or the file cannot be written.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise UsageError("a plot needs matplotlib: pip install 'mavkf[plot]'") from None
    found = errors(estimate, truth)
    figure = Figure(figsize=(12.0, 8.0), layout="constrained")
    figure.suptitle(title)
    grid = figure.add_gridspec(3, 4)
    _track(figure.add_subplot(grid[:2, :2]), estimate, truth)
    _height(figure.add_subplot(grid[2, :2]), estimate, truth)
    t = np.asarray(estimate["time_boot_s"])
    inside = (t >= found.time_boot_s[0]) & (t <= found.time_boot_s[-1])
    for k, (name, label) in enumerate(PANELS):
        axes = figure.add_subplot(grid[k % 3, 2 + k // 3])
        sigma = np.asarray(estimate[SIGMAS[name]])[inside]
        axes.fill_between(found.time_boot_s, -SIGMAS_SHOWN * sigma, SIGMAS_SHOWN * sigma, color="#cfe2f3", lw=0)
        axes.plot(found.time_boot_s, found.values[name], color="#b03a2e", lw=0.8)
        settled = sigma[np.isfinite(sigma)]
        if settled.size:
            # the start, when little is known yet, would hide the rest
            limit = 1.5 * SIGMAS_SHOWN * float(np.percentile(settled, 90))
            limit = max(limit, float(np.nanpercentile(np.abs(found.values[name]), 99)))
            axes.set_ylim(-limit, limit)
        axes.set_title(f"error {label}, and 2 sigma", fontsize=9)
        axes.grid(alpha=0.3)
        if k % 3 == 2:
            axes.set_xlabel("boot time, s")
    try:
        figure.savefig(path, dpi=110)
    except (OSError, ValueError) as error:
        raise UsageError(f"{path}: the plot cannot be written ({error}); name a file such as flight.png") from None


def _track(axes: Any, estimate: Mapping[str, Floats], truth: Truth) -> None:
    lat0, lon0 = float(truth.lat[0]), float(truth.lon[0])
    scale = 6371000.0  # m: only a picture

    def east_north(lat: Floats, lon: Floats) -> tuple[Floats, Floats]:
        return (lon - lon0) * scale * np.cos(lat0), (lat - lat0) * scale

    axes.plot(*east_north(truth.lat, truth.lon), color="black", lw=2.5, alpha=0.35, label="truth")
    axes.plot(
        *east_north(np.radians(estimate["lat_deg"]), np.radians(estimate["lon_deg"])),
        color="#b03a2e",
        lw=0.9,
        label="mavkf",
    )
    axes.set_aspect("equal", "datalim")
    axes.set_xlabel("east, m")
    axes.set_ylabel("north, m")
    axes.legend()
    axes.grid(alpha=0.3)


def _height(axes: Any, estimate: Mapping[str, Floats], truth: Truth) -> None:
    axes.plot(truth.time_boot_s, truth.alt, color="black", lw=2.5, alpha=0.35)
    axes.plot(estimate["time_boot_s"], estimate["alt_amsl_m"], color="#b03a2e", lw=0.9)
    axes.set_ylabel("height above sea level, m")
    axes.set_xlabel("boot time, s")
    axes.grid(alpha=0.3)
