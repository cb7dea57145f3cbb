"""Slow links: the IMU's messages thinned to lower and lower rates, everything else as it was."""

from collections import Counter
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.accuracy.common import QUANTITIES, Array, Settings, cell, estimate, head, read_rows, row, say
from mavkf.navigation.records import model_name
from mavkf.replay.export import columns
from mavkf.replay.truth import errors, read_truth
from mavkf.samples import IMU_SOURCES, SEQUENCE, SOURCE, TIME

RATES = (25.0, 10.0, 4.0, 2.0, 1.0)  # Hz
# flight, and the most that horizontal and down may be at any rate, m
FLIGHTS = (("ap01_copter_highrate", 0.15), ("ap05_plane_mission", 0.6))
BEGIN = 50.0  # s of boot time
MOST_TILT, TILT_RATE = 3.0, 2.0  # deg, at this rate (Hz) and above
MOST_ERROR_OVER_SIGMA = 2.0


def thin(rows: Array, rate_hz: float) -> Array:
    """Rows (n, ROW_WIDTH; in the order of arrival, timed) with each IMU message thinned to a rate, as a slow link carries it.

    A message is sent when its turn has come, whatever comes after it. With it goes all that it carries: IMU, magnetometer,
    barometer. One that is slower stays as it is.
    """
    keep: NDArray[np.bool_] = np.ones(rows.shape[0], dtype=bool)
    period = 1.0 / rate_hz
    for source in IMU_SOURCES:
        mine = np.flatnonzero(rows[:, SOURCE] == source)
        due, message, sent = -np.inf, (np.nan, np.nan), False
        for i, t, sequence in zip(mine, rows[mine, TIME], rows[mine, SEQUENCE], strict=True):
            if (t, sequence) != message:  # else it is another row of the same message
                message, sent = (t, sequence), t >= due
                if sent:
                    due = due + period if t < due + period else t + period
            keep[i] = sent
    return rows[keep]


def run(settings: Settings) -> list[dict[str, Any]]:
    """Measure both flights at all rates and print their table."""
    head(
        "decimation",
        ("flight", "IMU Hz", "model", "horizontal m", "down m", "tilt deg", "yaw deg", "error over sigma (the same)"),
    )
    results: list[dict[str, Any]] = []
    for name, bar in FLIGHTS:
        rows = read_rows(settings.folder / f"{name}.tlog", settings.config)
        truth = read_truth(settings.folder / f"{name}.truth.csv")
        for rate in RATES:
            session = estimate(thin(rows, rate), settings.config, settings.as_live)
            found = errors(columns(session.output.poses), truth, begin=BEGIN).statistics
            rms = {q: found[q].rms if q in found else np.nan for q in QUANTITIES}
            ratios = {q: found[q].error_over_sigma if q in found else np.nan for q in QUANTITIES}
            most = (bar, bar, MOST_TILT if rate >= TILT_RATE else np.inf, np.inf)
            model = Counter(model_name(pose) or "none" for pose in session.output.poses).most_common(1)[0][0]
            row(
                name.split("_")[0],
                f"{rate:g}",
                model,
                *(cell(rms[q], limit) for q, limit in zip(QUANTITIES, most, strict=True)),
                " / ".join(cell(ratios[q], MOST_ERROR_OVER_SIGMA, digits=2) for q in QUANTITIES),
            )
            results.append(
                {
                    "flight": name,
                    "rate_hz": rate,
                    "model": model,
                    "rms": rms,
                    "error_over_sigma": ratios,
                    "coverage": {q: found[q].coverage if q in found else 0.0 for q in QUANTITIES},
                }
            )
        mine = [result["rms"] for result in results if result["flight"] == name]
        steps = {q: max(b[q] / a[q] for a, b in pairwise(mine)) for q in QUANTITIES}
        say(
            f"{name}: largest step from one rate to the next {', '.join(f'{q} x{step:.1f}' for q, step in steps.items())}"
        )
    return results
