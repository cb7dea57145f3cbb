"""Pictures of an estimate beside the truth (needs the extra `plot`)."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavkf.diagnostics.whiteness import autocorrelation
from mavkf.errors import UsageError
from mavkf.navigation import layout as L
from mavkf.navigation.codes import Sensor
from mavkf.navigation.records import SENSOR_NAMES
from mavkf.replay.advice import NED
from mavkf.replay.export import columns
from mavkf.replay.results import SessionResult
from mavkf.replay.truth import SIGMAS, Truth, errors

Floats = NDArray[np.float64]
SIGMAS_SHOWN = 2.0
LAGS = 20
LINE, BAND = "#b03a2e", "#cfe2f3"
COLOURS = ("#b03a2e", "#2471a3", "#1e8449")
DEGREES = float(np.degrees(1.0))
BANDS = (
    ("velocity north, east, down, m/s", tuple((L.R_V + i, L.R_VELOCITY_COVARIANCE + 4 * i) for i in range(3)), 1.0),
    ("roll, pitch, yaw, deg", tuple((L.R_EULER + i, L.R_SIGMA_EULER + i) for i in range(3)), DEGREES),
    ("gyro bias x, y, z, deg/s", tuple((L.R_BG + i, -1) for i in range(3)), DEGREES),
    ("accelerometer bias x, y, z, m/s^2", tuple((L.R_BA + i, -1) for i in range(3)), 1.0),
)
PANELS = (
    ("north_m", "north, m"),
    ("east_m", "east, m"),
    ("down_m", "down, m"),
    ("roll_deg", "roll, deg"),
    ("pitch_deg", "pitch, deg"),
    ("yaw_deg", "yaw, deg"),
)


def plot_run(path: Path, session: SessionResult, truth: Truth | None = None) -> None:
    """Draw one session: track, height, velocity, attitude, biases with two sigma, innovations in their gates, how those of GNSS correlate.

    With truth the errors too.

    Raises UsageError where matplotlib is missing or the file cannot be written.
    """
    estimate = columns(session.output.poses)
    figure = _figure(f"vehicle {session.vehicle}, session {session.session}", 20.0 if truth is not None else 12.0, 11.0)
    left, right = figure.subfigures(1, 2, width_ratios=(3, 2)) if truth is not None else (figure, None)
    grid = left.add_gridspec(5, 4)
    _track(left.add_subplot(grid[:2, :2]), estimate, truth)
    _height(left.add_subplot(grid[2, :2]), estimate, truth)
    _gates(left.add_subplot(grid[3, :2]), session.output.innovations)
    for k, (label, names, scale) in enumerate(BANDS):
        _bands(left.add_subplot(grid[k, 2:]), session.output.poses, label, names, scale)
    _correlations(left.add_subplot(grid[4, :2]), session.output.innovations, Sensor.GNSS_POSITION)
    _correlations(left.add_subplot(grid[4, 2:]), session.output.innovations, Sensor.GNSS_VELOCITY)
    if right is not None and truth is not None:
        _errors(right, right.add_gridspec(6, 1), estimate, truth, rows=6)
    _save(figure, path)


def plot_errors(path: Path, estimate: Mapping[str, Floats], truth: Truth, title: str) -> None:
    """Draw the track, and errors between plus and minus two claimed sigma over time, to a file (its ending says the format).

    estimate: columns as of `mavkf.replay.truth.errors`. Raises UsageError where matplotlib is missing or the file cannot be written.
    """
    figure = _figure(title, 12.0)
    grid = figure.add_gridspec(3, 4)
    _track(figure.add_subplot(grid[:2, :2]), estimate, truth)
    _height(figure.add_subplot(grid[2, :2]), estimate, truth)
    _errors(figure, grid[:, 2:].subgridspec(3, 2), estimate, truth, rows=3)
    _save(figure, path)


def _figure(title: str, width: float, height: float = 9.0) -> Any:
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise UsageError("a plot needs matplotlib: pip install 'mavkf[plot]'") from None
    figure = Figure(figsize=(width, height), layout="constrained")
    figure.suptitle(title)
    return figure


def _save(figure: Any, path: Path) -> None:
    try:
        figure.savefig(path, dpi=110)
    except (OSError, ValueError) as error:
        raise UsageError(f"{path}: the plot cannot be written ({error}); name a file such as flight.png") from None


def _errors(figure: Any, grid: Any, estimate: Mapping[str, Floats], truth: Truth, rows: int) -> None:
    """Errors in their two-sigma bands, a panel each, down the columns of a grid."""
    found = errors(estimate, truth)
    t = np.asarray(estimate["time_boot_s"])
    inside = (t >= found.time_boot_s[0]) & (t <= found.time_boot_s[-1])
    for k, (name, label) in enumerate(PANELS):
        axes = figure.add_subplot(grid[k % rows, k // rows])
        sigma = np.asarray(estimate[SIGMAS[name]])[inside]
        axes.fill_between(found.time_boot_s, -SIGMAS_SHOWN * sigma, SIGMAS_SHOWN * sigma, color=BAND, lw=0)
        axes.plot(found.time_boot_s, found.values[name], color=LINE, lw=0.8)
        settled = sigma[np.isfinite(sigma)]
        if settled.size:
            # the start, when little is known yet, would hide the rest
            limit = 1.5 * SIGMAS_SHOWN * float(np.percentile(settled, 90))
            limit = max(limit, float(np.nanpercentile(np.abs(found.values[name]), 99)))
            axes.set_ylim(-limit, limit)
        axes.set_title(f"error {label}, and 2 sigma", fontsize=9)
        axes.grid(alpha=0.3)
        if (k + 1) % rows == 0:
            axes.set_xlabel("boot time, s")


def _bands(axes: Any, poses: Floats, label: str, names: tuple[tuple[int, int], ...], scale: float) -> None:
    """Three values over time with two sigma, where a pose row has it. names: columns of value and of variance or sigma (-1: none)."""
    for (value, spread), colour in zip(names, COLOURS, strict=True):
        v = scale * poses[:, value]
        axes.plot(poses[:, L.R_TIME], v, color=colour, lw=0.8)
        if spread >= 0:
            s = poses[:, spread]
            sigma = SIGMAS_SHOWN * scale * (np.sqrt(s) if spread < L.R_SIGMA_EULER else s)
            axes.fill_between(poses[:, L.R_TIME], v - sigma, v + sigma, color=colour, alpha=0.2, lw=0)
    axes.set_title(label, fontsize=9)
    axes.grid(alpha=0.3)


def _gates(axes: Any, innovations: Floats) -> None:
    """NIS of every measurement against its limit; above 1 it was refused."""
    for sensor, name in enumerate(SENSOR_NAMES):
        mine = innovations[innovations[:, L.I_SENSOR] == sensor]
        if mine.shape[0]:
            share = np.maximum(mine[:, L.I_NIS] / mine[:, L.I_LIMIT], 1e-6)
            axes.semilogy(mine[:, L.I_TIME], share, ".", ms=1.5, label=name)
    axes.axhline(1.0, color="black", lw=0.8)
    axes.set_title("NIS over its limit (above 1: refused)", fontsize=9)
    axes.set_xlabel("boot time, s")
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize=7, markerscale=5, loc="lower right")
    axes.grid(alpha=0.3)


def _correlations(axes: Any, innovations: Floats, sensor: Sensor) -> None:
    """How innovations of a sensor correlate with those some measurements before, and the band that 95 % of white ones lie in."""
    mine = innovations[(innovations[:, L.I_SENSOR] == sensor) & (innovations[:, L.I_FUSED] > 0)]
    axes.set_title(f"{sensor.name.lower()}: correlation of innovations, and white noise's band", fontsize=9)
    axes.set_xlabel("measurements apart")
    axes.grid(alpha=0.3)
    n = len(mine)
    if n <= 4 * LAGS:
        return
    lags = np.arange(1, LAGS + 1)
    band = 1.96 / np.sqrt(n)
    axes.axhspan(-band, band, color=BAND, lw=0)
    size = int(mine[:, L.I_SIZE].min())
    for axis, name, colour in zip(range(size), NED, COLOURS, strict=False):
        variance = mine[np.arange(n), L.I_S + axis * (mine[:, L.I_SIZE].astype(int) + 1)]
        rho = autocorrelation(mine[:, L.I_R + axis] / np.sqrt(variance), LAGS)
        axes.plot(lags, rho, ".-", color=colour, lw=0.8, label=name)
    axes.set_ylim(-0.5, 1.0)
    axes.set_xticks(range(0, LAGS + 1, 5))
    axes.legend(fontsize=7, loc="upper right")


def _track(axes: Any, estimate: Mapping[str, Floats], truth: Truth | None) -> None:
    lat, lon = np.radians(estimate["lat_deg"]), np.radians(estimate["lon_deg"])
    known = np.flatnonzero(np.isfinite(lat))
    if not known.size:
        axes.set_title("position was never known", fontsize=9)
        return
    lat0, lon0 = (
        (float(lat[known[0]]), float(lon[known[0]])) if truth is None else (float(truth.lat[0]), float(truth.lon[0]))
    )
    scale = 6371000.0  # m: only a picture

    def east_north(lat: Floats, lon: Floats) -> tuple[Floats, Floats]:
        return (lon - lon0) * scale * np.cos(lat0), (lat - lat0) * scale

    if truth is not None:
        axes.plot(*east_north(truth.lat, truth.lon), color="black", lw=2.5, alpha=0.35, label="truth")
    axes.plot(*east_north(lat, lon), color=LINE, lw=0.9, label="mavkf")
    axes.set_aspect("equal", "datalim")
    axes.set_xlabel("east, m")
    axes.set_ylabel("north, m")
    axes.legend()
    axes.grid(alpha=0.3)


def _height(axes: Any, estimate: Mapping[str, Floats], truth: Truth | None) -> None:
    if truth is not None:
        axes.plot(truth.time_boot_s, truth.alt, color="black", lw=2.5, alpha=0.35)
    axes.plot(estimate["time_boot_s"], estimate["alt_amsl_m"], color=LINE, lw=0.9)
    axes.set_ylabel("height above sea level, m")
    axes.set_xlabel("boot time, s")
    axes.grid(alpha=0.3)
