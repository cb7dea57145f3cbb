"""Integrity: whether faults are found, named and survived, and whether the protection levels hold.

    MAVKF_FLIGHTS=FOLDER python -m benchmarks integrity [--only NAME,...] [--quick] [--json FILE] [--workers N]
        [--runs N] [--hours H] [--samples N] [--first N] [--set section.key=value]...

Parts, in the order in which they run:

    flights     a recorded flight whose receiver jumps, drifts and is lost
    false       fault events in recorded and simulated flights without faults
    detection   faults drawn at random, under the filter and under a plain gate at 5 sigma
    spoof       drifts whose velocity agrees with them: how far they lead
    protection  protection levels against errors, with faults; level over sigma without; recorded flights

Tables on stdout, progress on stderr. A number in bold is over its bar, which stands behind it. Every run and every simulated flight draws
from its number, so `--first N --runs 1` (or `--hours 0.25`, `--samples 13`) repeats one that the JSON names.
"""

import argparse
import importlib
import json
import multiprocessing
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from benchmarks.accuracy.common import estimate
from benchmarks.integrity.common import Settings, plain_gate, plain_values, say
from benchmarks.integrity.flown import fly
from mavkf.config import Config, with_settings
from mavkf.errors import UsageError

PARTS = ("flights", "false", "detection", "spoof", "protection")
FULL, QUICK = {"runs": 300, "hours": 20.0, "samples": 5000}, {"runs": 10, "hours": 1.0, "samples": 150}


def main(arguments: Sequence[str]) -> int:
    """Run the parts, print their tables, write JSON; exit code 1 where there are no flights, 2 where an argument is wrong."""
    options = _parser().parse_args(arguments)
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
        plain = plain_gate(config)
    except UsageError as error:
        print(error, file=sys.stderr)
        return 2
    amount = QUICK if options.quick else FULL
    given = {name: getattr(options, name) for name in amount if getattr(options, name) is not None}
    with ExitStack() as stack:
        work = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        estimate(fly(1, 60.0, work, config).rows, config, as_live=False)  # compiled once, before others need it
        settings = Settings(Path(folder), work, config, plain, **(amount | given), first=options.first)
        if options.workers > 1:
            processes: Executor = ProcessPoolExecutor(options.workers, multiprocessing.get_context("spawn"))
            settings = replace(settings, executor=stack.enter_context(processes))
        _run(settings, names, options.json)
    return 0


def _run(settings: Settings, names: Sequence[str], file: Path | None) -> None:
    results: dict[str, Any] = {}
    for name in PARTS:
        if name in names:
            begin = time.perf_counter()
            results[name] = importlib.import_module(f"benchmarks.integrity.{name}").run(settings)
            say(f"{name} took {time.perf_counter() - begin:.0f} s")
            if file is not None:  # after each part: the next may take long
                file.write_text(json.dumps(plain_values(results), indent=1))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks integrity",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--only", default=",".join(PARTS), metavar="NAME,...", help="these parts, by name")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all numbers there")
    parser.add_argument("--quick", action="store_true", help="few runs and flights")
    parser.add_argument("--runs", type=int, metavar="N", help="of each kind of fault (300, quick 10)")
    parser.add_argument("--hours", type=float, metavar="H", help="of simulated flight without faults (20, quick 1)")
    parser.add_argument("--samples", type=int, metavar="N", help="of the protection levels, at least (5000, quick 150)")
    parser.add_argument("--first", type=int, default=0, metavar="N", help="number of the first run and flight (0)")
    parser.add_argument("--workers", type=int, default=2, metavar="N", help="processes that share the work (2)")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="a setting, as of mavkf replay")
    return parser
