"""One hour of flight at 20 times its pace through UDP: what becomes of the service's memory, and what a reader misses.

python -m benchmarks soak [--minutes 60] [--speed 20] [--json FILE]
"""

import argparse
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from mavkf.replay.simulation import simulate
from mavkf.replay.tlog import Log, read_tlog

SETTLED_S = 300.0  # of the flight: what is compared with the end
PAGE = os.sysconf("SC_PAGE_SIZE")


def main(arguments: list[str]) -> int:
    """Fly, serve, watch; 1 where memory grew by more than 5 % or a number was missed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks soak", description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--speed", type=float, default=20.0)
    parser.add_argument("--json", type=Path)
    words = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "hour.tlog"
        simulate(log, duration_s=60.0 * words.minutes, imu_hz=200.0, gnss_hz=5.0, gnss_message_hz=5.0)
        found = _soak(read_tlog(log), words.speed)
    print("\n".join(f"{name:<28}{value:10.1f}" for name, value in found.items()))
    if words.json is not None:
        words.json.write_text(json.dumps(found, indent=2) + "\n")
    return int(found["growth %"] > 5.0 or found["missed"] > 0)


def _soak(log: Log, speed: float) -> dict[str, float]:
    port = _free(socket.SOCK_DGRAM)
    place = f"tcp/127.0.0.1:{_free(socket.SOCK_STREAM)}"
    os.environ["MAVKF_RENDEZVOUS"] = place
    command = [sys.executable, "-m", "mavkf", "serve", f"udpin:127.0.0.1:{port}", "--quiet", "--no-request"]
    process = subprocess.Popen(command)
    reader = subprocess.Popen([sys.executable, "-c", _READER], stdout=subprocess.PIPE, text=True)
    try:
        time.sleep(5.0)
        settled, late = _play(log, speed, port, process.pid)
        end = _resident(process.pid)
        process.send_signal(signal.SIGINT)
        process.wait(20)
        reader.send_signal(signal.SIGINT)
        counts = json.loads(reader.communicate(timeout=20)[0])
    finally:
        process.kill()
        reader.kill()
    return {
        "flight s": log.duration_s,
        "player late s": late,
        "MB after five minutes": settled / 1e6,
        "MB at the end": end / 1e6,
        "growth %": 100.0 * (end - settled) / settled,
        "poses received": counts["received"],
        "missed": counts["missed"] + counts["dropped"],
    }


_READER = """
import json, signal
from mavkf.publish.subscriber import subscribe
signal.signal(signal.SIGINT, signal.default_int_handler)  # started in the background it would be ignored
with subscribe() as poses:
    try:
        for _ in poses:
            pass
    except KeyboardInterrupt:
        pass
    print(json.dumps(poses.counts))
"""


def _play(log: Log, speed: float, port: int, pid: int) -> tuple[int, float]:
    """Send the frames at a pace; resident bytes of the service after SETTLED_S, and how late the end was, s."""
    settled = 0
    begin = time.monotonic()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.connect(("127.0.0.1", port))
        late = 0.0
        for offset, stamp, size, version in log.frames[["offset", "stamp", "size", "version"]].tolist():
            t = (stamp - log.first_us) * 1e-6
            late = time.monotonic() - begin - t / speed
            if late < 0.0:
                time.sleep(-late)
            if not settled and t > min(SETTLED_S, log.duration_s / 2):
                settled = _resident(pid)
            at = offset - (10 if version == 2 else 6)
            sender.send(log.data[at : at + size].tobytes())
    time.sleep(1.0)
    return settled, max(late, 0.0)


def _resident(pid: int) -> int:
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * PAGE


def _free(kind: int) -> int:
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port
