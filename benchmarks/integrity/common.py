"""What the parts share: settings, work spread over processes, what a table says of many runs."""

import sys
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from mavkf.config import Config, with_settings

Array = NDArray[np.float64]
Job = TypeVar("Job")
Done = TypeVar("Done")
PLAIN = ("integrity.monitors=false", "gates.false_rejection=5.7e-7", "gates.reset_s=600.0")
"""Settings of a plain gate at 5 sigma: what is refused, and nothing that doubts a refusal."""


@dataclass(frozen=True)
class Settings:
    """How to measure.

    folder: of the recorded flights; work: for what is flown.
    config: of the filter; plain: the same with its monitors off and a plain gate at 5 sigma.
    runs: of each kind of fault; hours: of simulated flight without faults; samples: of the protection levels, one each 60 s.
    first: number of the first run and of the first simulated flight, which draw from their numbers.
    executor: of the processes that share the work, None: this one does it.
    """

    folder: Path
    work: Path
    config: Config
    plain: Config
    runs: int
    hours: float
    samples: int
    first: int = 0
    executor: Executor | None = None


def plain_gate(config: Config) -> Config:
    """The same filter without its monitors, with a plain gate at 5 sigma."""
    return with_settings(config, PLAIN)


def say(text: str) -> None:
    """Progress, on stderr."""
    print(f"integrity: {text}", file=sys.stderr, flush=True)


def spread(settings: Settings, work: Callable[[Job], Done], jobs: Sequence[Job], what: str) -> list[Done]:
    """What `work` makes of each job, in their order, by as many processes as there are; what: the jobs are, for the progress."""
    begin, told = time.perf_counter(), 0.0
    done: list[Done] = []
    results: Iterable[Done] = (
        map(work, jobs) if settings.executor is None else settings.executor.map(work, jobs, chunksize=2)
    )
    for result in results:
        done.append(result)
        passed = time.perf_counter() - begin
        if passed - told > 20.0 or len(done) == len(jobs):
            told = passed
            say(f"{len(done)} of {len(jobs)} {what} in {passed:.0f} s")
    return done


def middle(values: Iterable[float]) -> tuple[float, float]:
    """Median and 90 % of what is finite; NaN of nothing."""
    known = np.array(list(values), dtype=np.float64)
    known = known[np.isfinite(known)]
    if not known.size:
        return float("nan"), float("nan")
    return float(np.median(known)), float(np.percentile(known, 90.0))


def pair(values: Sequence[float], digits: int = 1) -> str:
    """A median and a 90 % as a table has them."""
    return " / ".join(f"{value:.{digits}f}" if np.isfinite(value) else "-" for value in values)


def plain_values(value: Any) -> Any:
    """Values that JSON has: NaN and infinities become null."""
    if isinstance(value, dict):
        return {str(key): plain_values(each) for key, each in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [plain_values(each) for each in value]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return value.item() if isinstance(value, np.generic) else value
