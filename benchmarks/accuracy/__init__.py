"""Accuracy, as live, with one set of defaults, against the bars that the project sets itself.

    MAVKF_FLIGHTS=FOLDER python -m benchmarks accuracy [--only NAME,...] [--json FILE] [--offline] [--quick] [--set section.key=value]...

Parts, in the order in which they run:

    flights      recorded flights against their truth
    decimation   the same with the IMU thinned to what slow links carry
    outages      GNSS cut out of a flight: error at the end of the gap
    smoothed     recorded flights and outages, each pose by what came later too
    honesty      error over claimed sigma, on a recorded flight and pooled over simulated ones; NEES
    drive        a car with an RTK receiver, its fixes hidden for 15 s at a time
    kitti        a car with fixes once a second and an IMU whose clock lags
    ingredients  what each part of the filter is worth: errors without it
    public       logs without truth: innovations, and the difference to the autopilot's own estimate

Tables on stdout, progress on stderr. A number in bold is over its bar, which stands behind it.
"""

import argparse
import importlib
import json
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.accuracy.common import Settings, say
from mavkf.config import Config, with_settings
from mavkf.errors import UsageError

PARTS = ("flights", "decimation", "outages", "smoothed", "honesty", "drive", "kitti", "ingredients", "public")


def main(arguments: Sequence[str]) -> int:
    """Run the parts, print their tables, write JSON; exit code 1 where there are no flights, 2 where a part has no such name."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks accuracy", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", default=",".join(PARTS), metavar="NAME,...", help="these parts, by name")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all numbers there")
    parser.add_argument("--offline", action="store_true", help="in the order of measurement instead of as live")
    parser.add_argument("--quick", action="store_true", help="fewer simulated flights, fewer outages")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="a setting, as of mavkf replay")
    options = parser.parse_args(arguments)
    names = options.only.split(",")
    wrong = [name for name in names if name not in PARTS]
    if wrong:
        print(f"--only {','.join(wrong)}: the parts are {', '.join(PARTS)}", file=sys.stderr)
        return 2
    folder = os.environ.get("MAVKF_FLIGHTS")
    if not folder:
        print("MAVKF_FLIGHTS names no folder of recorded flights: nothing to measure", file=sys.stderr)
        return 1
    try:
        config = with_settings(Config(), options.set)
    except UsageError as error:
        print(error, file=sys.stderr)
        return 2
    settings = Settings(Path(folder), config, not options.offline, options.quick)
    results: dict[str, Any] = {}
    for name in PARTS:
        if name in names:
            begin = time.perf_counter()
            results[name] = importlib.import_module(f"benchmarks.accuracy.{name}").run(settings)
            say(f"{name} took {time.perf_counter() - begin:.0f} s")
            if options.json is not None:  # after each part: the next may take long
                options.json.write_text(json.dumps(_plain(results), indent=1))
    return 0


def _plain(value: Any) -> Any:
    """Values that JSON has: NaN and infinities become null."""
    if isinstance(value, dict):
        return {str(key): _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_plain(each) for each in value]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return value.item() if isinstance(value, np.generic) else value
