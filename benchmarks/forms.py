"""Recorded flights with every form of the filter: how far from the service's own, and what a step costs.

    MAVKF_FLIGHTS=FOLDER python -m benchmarks forms [--form NAME,...] [--json FILE]

Differences are the largest over all poses: of position, velocity and attitude in standard deviations of each, and of their covariances
against the product of the two standard deviations. Costs are means of the compiled steps alone, over the flight.
"""

import argparse
import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavkf.filters.forms import FORMS
from mavkf.navigation import layout as L
from mavkf.replay.options import Options
from mavkf.replay.results import SessionResult
from mavkf.replay.run import run

Array = NDArray[np.float64]
FLIGHTS = (("ap02_copter_gcs4hz", np.inf), ("ap01_copter_highrate", 100.0))  # and the end, s on the boot clock


def main(arguments: Sequence[str]) -> int:
    """Run the flights with the forms and print a table for each; exit code 1 where there are no flights."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks forms", description=__doc__)
    parser.add_argument("--form", default=",".join(FORMS), metavar="NAME,...", help="these forms only")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all numbers there")
    options = parser.parse_args(arguments)
    folder = os.environ.get("MAVKF_FLIGHTS")
    if not folder:
        print("MAVKF_FLIGHTS names no folder of recorded flights: nothing to measure", file=sys.stderr)
        return 1
    found = {flight: measure(Path(folder) / f"{flight}.tlog", end, options.form.split(",")) for flight, end in FLIGHTS}
    for flight, forms in found.items():
        print(
            f"\n{flight}\n\n| form | prediction, us | update, us | states, sigma | covariances |\n|---|---|---|---|---|"
        )
        for form, row in forms.items():
            print(
                f"| `{form}` | {row['prediction_us']:.0f} | {row['update_us']:.0f} | {row['states']:.0e} | {row['covariances']:.0e} |"
            )
    if options.json is not None:
        options.json.write_text(json.dumps(found, indent=1))
    return 0


def measure(log: Path, end: float, forms: Sequence[str]) -> dict[str, dict[str, Any]]:
    """By form: cost and largest differences on the log's longest session up to `end` (s)."""
    own = _longest(log, Options(span=(-np.inf, end)))
    rows = {}
    for form in forms:
        print(f"{log.stem}: {form}", file=sys.stderr)
        other = _longest(log, Options(span=(-np.inf, end), form=form))
        assert other.form is not None
        states, covariances = differences(other.output.poses, own.output.poses)
        rows[form] = {
            "prediction_us": other.form.prediction_us,
            "update_us": other.form.update_us,
            "predictions": other.form.predictions,
            "updates": other.form.updates,
            "restarts": other.form.restarts,
            "states": states,
            "covariances": covariances,
        }
    return rows


def _longest(log: Path, options: Options) -> SessionResult:
    return max(run(log, options).sessions, key=lambda session: session.output.poses.shape[0])


def differences(poses: Array, own: Array) -> tuple[float, float]:
    """The largest difference of position, velocity and attitude of pose rows (n, POSE_WIDTH) in sigma, and of their covariances."""
    states, covariances = [], []
    for first, place, size in ((L.R_NED, L.R_POSE_COVARIANCE, 6), (L.R_V, L.R_VELOCITY_COVARIANCE, 3)):
        P, P_own = (rows[:, place : place + size * size].reshape(-1, size, size) for rows in (poses, own))
        sigma = np.sqrt(np.diagonal(P_own, axis1=1, axis2=2))
        states.append((poses[:, first : first + 3] - own[:, first : first + 3]) / sigma[:, :3])
        covariances.append((P - P_own) / (sigma[:, :, None] * sigma[:, None, :]))
    turn = poses[:, L.R_EULER : L.R_EULER + 3] - own[:, L.R_EULER : L.R_EULER + 3]
    turn = (turn + np.pi) % (2.0 * np.pi) - np.pi
    states.append(turn / own[:, L.R_SIGMA_EULER : L.R_SIGMA_EULER + 3])
    return _largest(states), _largest(covariances)


def _largest(found: list[Array]) -> float:
    return max(float(np.nanmax(np.abs(each), initial=0.0)) for each in found)
