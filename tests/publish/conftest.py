"""Records to publish, a rendezvous of the test's own, and child processes that are told and heard by lines."""

import os
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from mavkf.estimate import Mode, Origin, Pose, Validity


def make_pose(seq: int = 0, vehicle: str = "1-1", **fields: object) -> Pose:
    values: dict[str, object] = {
        "session": 0,
        "t_boot_s": 12.5 + 0.02 * seq,
        "utc_ns": 1_790_000_000_000_000_000 + seq,
        "lat_deg": 47.397742,
        "lon_deg": 8.545594,
        "alt_amsl_m": 488.25,
        "origin": Origin(lat_deg=47.3977, lon_deg=8.5455, alt_amsl_m=480.0),
        "position_ned_m": (4.67, 7.09, -8.25),
        "velocity_ned_m_s": (1.5, -0.25, 0.125),
        "quaternion_nb": None,
        "euler_deg": (1.0, -2.0, None),
        "angular_rate_b_rad_s": (0.01, 0.02, -0.03),
        "pose_covariance": (*(0.5 if i % 7 == 0 else 0.0 for i in range(30)), *(None,) * 6),
        "velocity_covariance": tuple(0.1 if i % 4 == 0 else 0.0 for i in range(9)),
        "valid": Validity(position=True, velocity=True, tilt=True),
        "mode": Mode.NAVIGATING,
        "flags": ("still",),
    }
    return Pose(vehicle=vehicle, seq=seq, **(values | fields))  # type: ignore[arg-type]


class Child:
    """A Python process whose lines can be waited for."""

    def __init__(self, code: str, *arguments: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-u", "-c", code, *arguments], stdout=subprocess.PIPE, stdin=subprocess.PIPE, text=True
        )
        self._lines: queue.Queue[str] = queue.Queue()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self._lines.put(line.rstrip("\n"))

    def line(self, timeout_s: float = 20.0) -> str:
        return self._lines.get(timeout=timeout_s)

    def wait_for(self, wanted: str, timeout_s: float = 20.0) -> None:
        end = time.monotonic() + timeout_s
        while (line := self.line(max(end - time.monotonic(), 0.001))) != wanted:
            assert time.monotonic() < end, f"{wanted!r} did not come, the last line is {line!r}"

    def forget(self) -> None:
        """Drop what it has said so far."""
        while not self._lines.empty():
            self._lines.get()

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()
        self._reader.join()
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdin.close()
        self.process.stdout.close()


@pytest.fixture
def start() -> Iterator[Callable[..., Child]]:
    children: list[Child] = []

    def begin(code: str, *arguments: str) -> Child:
        children.append(Child(code, *arguments))
        return children[-1]

    yield begin
    for child in children:
        child.kill()


def listening(pid: int) -> set[str]:
    """The addresses that a process listens on, as /proc writes them ("0100007F:1D17" is 127.0.0.1:7447)."""
    sockets = set()
    for link in Path(f"/proc/{pid}/fd").iterdir():
        try:
            sockets.add(os.readlink(link))
        except FileNotFoundError:  # closed meanwhile
            continue
    found = set()
    for table, state in (("tcp", "0A"), ("tcp6", "0A"), ("udp", "07"), ("udp6", "07")):
        for row in Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
            columns = row.split()
            if columns[3] == state and f"socket:[{columns[9]}]" in sockets:
                found.add(f"{table} {columns[1]}")
    return found
