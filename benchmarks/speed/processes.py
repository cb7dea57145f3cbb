"""Processes that are measured: how long they run, and how much memory of their own they take meanwhile."""

import os
import socket
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from benchmarks.speed.measure import seconds

MAVKF = (sys.executable, "-m", "mavkf")
IMPORTS = (sys.executable, "-c", "import numpy, numba, zenoh")
NOTHING = (sys.executable, "-c", "pass")
POLL_S = 0.01


def process_s(words: Sequence[str | Path], environment: Mapping[str, str] | None = None) -> float:
    """Run a process to its end; the seconds that took. Raises CalledProcessError."""
    return seconds(
        lambda: subprocess.run(
            words,
            check=True,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env={**os.environ, **(environment or {})},
        )
    )


def process_peak(words: Sequence[str | Path]) -> tuple[float, float]:
    """Run a process to its end: seconds, and the most anonymous memory (MB) that was seen. Raises CalledProcessError."""
    begin = time.perf_counter()
    peak = 0
    with subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as one:
        while one.poll() is None:
            peak = max(peak, _anonymous_kb(one.pid))
            time.sleep(POLL_S)
    if one.returncode:
        raise subprocess.CalledProcessError(one.returncode, [str(word) for word in words])
    return time.perf_counter() - begin, peak / 1e3


def _anonymous_kb(pid: int) -> int:
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return 0
    return next((int(line.split()[1]) for line in lines if line.startswith("RssAnon")), 0)


def cpu_s(pid: int) -> float:
    """Processor seconds that a process has had."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def free_port(kind: socket.SocketKind) -> int:
    """Give a port of the loopback that nothing has."""
    with socket.socket(socket.AF_INET, kind) as one:
        one.bind(("127.0.0.1", 0))
        port: int = one.getsockname()[1]
        return port
