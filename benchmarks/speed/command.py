"""The whole command: a process of `mavkf replay LOG --csv`, where its time goes, and how it grows with the flight."""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.speed.measure import Figure, Settings, alone, figure, in_turns
from benchmarks.speed.processes import IMPORTS, MAVKF, process_peak, process_s
from mavkf.replay.simulation import simulate
from mavkf.service.warmup import ensure_compiled

RUNS, GROWTH_RUNS = 7, 3
FLIGHT_S = 250.0
TITLE = "`mavkf replay --csv`"


def run(settings: Settings) -> list[Figure]:
    """Measure the process, its pieces, and its growth."""
    ensure_compiled(lambda _: None)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        csv = folder / "estimate.csv"
        took = in_turns(
            {
                "replay": lambda: process_s((*MAVKF, "replay", settings.log, "--csv", csv)),
                "imports": lambda: process_s(IMPORTS),
            },
            settings.runs(RUNS),
            warm=not settings.quick,
        )
        imports = "importing numpy, numba, zenoh"
        figures = [
            figure(TITLE, "s", took["replay"], imports, took["imports"], settings.named),
            alone(imports, "s", took["imports"], "a process that does nothing else"),
        ]
        splits = [_split(settings.log, csv) for _ in took["replay"]]
        figures += [
            figure(f"of it {piece}", "s", [each[piece] for each in splits], TITLE, took["replay"])
            for piece in splits[0]
        ]
        return figures + _growth(settings, folder)


def _split(log: Path, csv: Path) -> dict[str, float]:
    done = subprocess.run(
        (sys.executable, "-m", "benchmarks.speed.split", log, csv),
        check=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "BEGUN": str(time.monotonic())},
    )
    result: dict[str, float] = json.loads(done.stdout)
    return result


def _growth(settings: Settings, folder: Path) -> list[Figure]:
    """Time and memory of simulated flights, each ten times as long as the one before."""
    figures = []
    once_s: list[float] = []
    once_mb: list[float] = []
    for times in (1,) if settings.quick else (1, 10, 100) if settings.full else (1, 10):
        duration = FLIGHT_S * times
        log = folder / f"{times}.tlog"
        simulate(log, duration_s=duration)
        runs = [
            process_peak((*MAVKF, "replay", log, "--csv", folder / "grown.csv"))
            for _ in range(settings.runs(GROWTH_RUNS))
        ]
        took, memory = [wall for wall, _ in runs], [peak for _, peak in runs]
        if times == 1:
            once_s, once_mb = took, memory
        real_time = duration / sorted(took)[len(took) // 2]
        name, reference = f"a simulated flight of {duration:.0f} s", f"that of {FLIGHT_S:.0f} s"
        note = f"{real_time:.0f} times real time, start-up and CSV included"
        if times == 1:
            figures += [alone(name, "s", took, note), alone("its anonymous memory, at most", "MB", memory)]
        else:
            figures += [
                figure(name, "s", took, reference, once_s, note),
                figure("its anonymous memory, at most", "MB", memory, reference, once_mb),
            ]
        log.unlink()
    return figures
