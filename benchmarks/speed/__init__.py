"""How fast mavkf is, each figure beside a reference that is measured in the same run, in turns.

    [MAVKF_FLIGHTS=FOLDER] python -m benchmarks speed [--only NAME,...] [--quick] [--full] [--json FILE] [--readme]

Parts, in the order in which they run:

    reading    a log to arrays of IMU, GNSS and pressure, against pymavlink, fasttlogparser, and reading the bytes alone
    filtering  the fold and its pieces, against the C filter inslib and dense numpy
    command    `mavkf replay LOG --csv` as a process, and how time and memory grow with the flight
    live       datagram in to subscriber callback, messages a second, a hundred vehicles, against zenoh alone
    start      the first run ever, and those that need no compiler

The flight is ap01 of MAVKF_FLIGHTS, or a simulated one. `pip install -e '.[bench]'` brings what is compared with.
Tables on stdout (Markdown), progress on stderr; `--readme` writes them into README.md too.
"""

import argparse
import importlib
import json
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from benchmarks.speed.measure import Figure, Settings, say
from benchmarks.speed.table import document, rewrite

PARTS = {
    "reading": "Reading: a log to arrays of IMU, GNSS and pressure",
    "filtering": "Filtering: microseconds of the fold",
    "command": "The whole command: `mavkf replay LOG --csv`, compiled before",
    "live": "Live: datagram in to subscriber callback in another process",
    "start": "Start",
}
FLIGHT = "ap01_copter_highrate.tlog"
README = Path(__file__).resolve().parents[2] / "README.md"


def main(arguments: Sequence[str]) -> int:
    """Measure the parts and print their tables; exit code 2 where a part has no such name or options exclude each other."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks speed", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", default=",".join(PARTS), metavar="NAME,...", help="these parts, by name")
    parser.add_argument("--quick", action="store_true", help="little and once: whether it works, no numbers to keep")
    parser.add_argument("--full", action="store_true", help="also a log of 500 MB and a flight a hundred times as long")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures there")
    parser.add_argument("--readme", action="store_true", help="write the tables into README.md")
    options = parser.parse_args(arguments)
    names = options.only.split(",")
    wrong = [name for name in names if name not in PARTS]
    if wrong:
        print(f"--only {','.join(wrong)}: the parts are {', '.join(PARTS)}", file=sys.stderr)
        return 2
    if options.readme and (options.quick or set(names) != set(PARTS)):
        print("--readme tells all parts, measured well: leave --only and --quick out", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory() as folder:
        log, named = _flight(Path(folder), 60.0 if options.quick else 250.0)
        settings = Settings(log, named, options.quick, options.full)
        results: dict[str, list[Figure]] = {}
        for name in PARTS:
            if name in names:
                begin = time.perf_counter()
                results[name] = importlib.import_module(f"benchmarks.speed.{name}").run(settings)
                say(f"{name} took {time.perf_counter() - begin:.0f} s")
                if options.json is not None:  # after each part: the next may take long
                    options.json.write_text(
                        json.dumps({key: [asdict(each) for each in part] for key, part in results.items()}, indent=1)
                    )
    text = document(results, PARTS)
    print(text)
    if options.readme:
        rewrite(README, text)
    return 0


def _flight(folder: Path, duration_s: float) -> tuple[Path, str]:
    """Give the log to measure with, and its name."""
    flights = os.environ.get("MAVKF_FLIGHTS")
    if flights and (Path(flights) / FLIGHT).exists():
        return Path(flights) / FLIGHT, "ap01"
    from mavkf.replay.simulation import simulate

    simulate(folder / "simulated.tlog", duration_s=duration_s)
    return folder / "simulated.tlog", "a simulated flight"
