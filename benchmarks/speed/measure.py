"""Figures: a quantity measured in turns with what it is compared with, its median and spread, and the ratio of the two."""

import ctypes
import os
import statistics
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Settings:
    """How to measure.

    log: the flight; named: what tables call it. quick: little and once, to see that it works; full: the long lengths too.
    """

    log: Path
    named: str
    quick: bool = False
    full: bool = False

    def runs(self, usual: int) -> int:
        """How often a measurement is repeated: once where it is quick."""
        return 1 if self.quick else usual


@dataclass(frozen=True)
class Spread:
    """Median of repetitions, the least and the most."""

    median: float
    least: float
    most: float


def spread(values: Sequence[float]) -> Spread:
    """Sum up repetitions."""
    return Spread(statistics.median(values), min(values), max(values))


@dataclass(frozen=True)
class Figure:
    """One line of a table.

    value: in `unit`. reference: what the ratio is to, measured in the same run, empty where there is none; ratio: value over that of the
    reference, turn by turn. note: what else there is to know of it; of what could not be measured, why (value is None).
    """

    name: str
    unit: str
    value: Spread | None
    reference: str = ""
    ratio: Spread | None = None
    note: str = ""


def figure(
    name: str, unit: str, values: Sequence[float], reference: str, others: Sequence[float], note: str = ""
) -> Figure:
    """Compare the values of a quantity with those of its reference, each measured in the same turn."""
    ratios = [value / other for value, other in zip(values, others, strict=True)]
    return Figure(name, unit, spread(values), reference, spread(ratios), note)


def alone(name: str, unit: str, values: Sequence[float], note: str = "") -> Figure:
    """Give a quantity that others are compared with."""
    return Figure(name, unit, spread(values), note=note)


def missing(name: str, why: str) -> Figure:
    """Give the line of what could not be measured."""
    return Figure(name, "", None, note=why)


def seconds(work: Callable[[], object]) -> float:
    """Do it once; give the time that it took."""
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


def in_turns(works: Mapping[str, Callable[[], float]], runs: int, warm: bool = True) -> dict[str, list[float]]:
    """What each work says of itself, `runs` times, one after the other in turns; before, each once for nothing (`warm`)."""
    results: dict[str, list[float]] = {name: [] for name in works}
    for turn in range(-int(warm), runs):
        for name, work in works.items():
            result = work()
            if turn >= 0:
                results[name].append(result)
    return results


@contextmanager
def hushed() -> Iterator[None]:
    """Let nothing reach stdout or stderr, not even what a library in C writes there."""
    library = ctypes.CDLL(None)

    def flush() -> None:
        sys.stdout.flush()
        sys.stderr.flush()
        library.fflush(None)

    flush()
    kept = os.dup(1), os.dup(2)
    with Path(os.devnull).open("wb") as nowhere:
        for stream in (1, 2):
            os.dup2(nowhere.fileno(), stream)
        try:
            yield
        finally:
            flush()
            for stream, old in zip((1, 2), kept, strict=True):
                os.dup2(old, stream)
                os.close(old)


def say(text: str) -> None:
    """Progress, on stderr."""
    print(f"speed: {text}", file=sys.stderr, flush=True)
