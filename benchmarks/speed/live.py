"""Live: a real `mavkf serve`, datagrams in, and a subscriber in another process; beside it zenoh alone with the same payload."""

import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from benchmarks.speed.measure import Figure, Settings, alone, figure, missing
from benchmarks.speed.processes import MAVKF, cpu_s, free_port
from benchmarks.speed.traffic import Datagram, recorded, send, vehicles
from mavkf.publish.session import open_session
from mavkf.service.warmup import ensure_compiled

SETTLING_S = 12.0  # of boot time: until the set-up is decided, first poses have come, and what waited for it is done
SOON = 8.0  # times real time at which one vehicle settles; many, which decide all at once, at their own pace
QUIET_S = 1.0  # for what is on its way to arrive
ECHO = "mavkf/echo/pose"
PAYLOAD = 1_900  # bytes, where no pose tells
RATES = (2_000, 5_000, 10_000, 20_000, 30_000, 40_000, 60_000)  # messages a second
SUSTAINED_S = 3.0
BACKLOG_S = 0.1  # that the last pose may come after the last datagram
COMPLETE = 0.95  # of the poses that must have come: what was dropped was not taken
RUNS = 3
STAMPED = ("--set", "vehicle.imu_delay_s=0")  # so that a pose has the time of the sample that made it


class Service:
    """A `mavkf serve` and a listener; `arrivals` after the end."""

    def __init__(self, folder: Path, *words: str, core: int | None = None) -> None:
        self.port = free_port(socket.SOCK_DGRAM)
        self._out = folder / "arrivals"
        self.serve = subprocess.Popen(
            [*MAVKF, "serve", f"udpin:127.0.0.1:{self.port}", *STAMPED, *words], stderr=subprocess.PIPE, text=True
        )
        assert self.serve.stderr is not None
        for line in self.serve.stderr:
            if "listens on" in line:
                break
        if core is not None:
            for task in Path(f"/proc/{self.serve.pid}/task").iterdir():
                os.sched_setaffinity(int(task.name), {core})
        self._drain = threading.Thread(target=self.serve.stderr.read, daemon=True)  # a full pipe would hold it up
        self._drain.start()
        self.listener = subprocess.Popen(
            [sys.executable, "-m", "benchmarks.speed.listener", "mavkf/*/pose", str(self._out)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        assert self.listener.stdout is not None
        self.listener.stdout.readline()
        time.sleep(QUIET_S)  # for the two sessions to find each other

    def end(self) -> dict[tuple[str, int], int]:
        """End both; when (ns, monotonic) each pose came, by vehicle and boot time (us), or each echo by its number."""
        time.sleep(QUIET_S)
        assert self.listener.stdin is not None
        self.listener.stdin.close()
        self.listener.wait(timeout=60.0)
        self.serve.terminate()
        self.serve.wait(timeout=20.0)
        arrivals: dict[tuple[str, int], int] = {}
        for line in self._out.read_bytes().splitlines():
            at, key, head = line.split(b" ", 2)
            if b'"t_boot_s":' in head:
                t = float(head.split(b'"t_boot_s":')[1].split(b",")[0])
                arrivals[key.decode().split("/")[1], round(t * 1e6)] = int(at)
            else:
                arrivals["echo", int(head.split(b" ")[0])] = int(at)
        return arrivals

    def kill(self) -> None:
        """End what still runs."""
        for process in (self.listener, self.serve):
            if process.poll() is None:
                process.kill()
                process.wait()


@contextmanager
def service(*words: str, core: int | None = None) -> Iterator[Service]:
    """Run a service on ports of its own."""
    before = os.environ.get("MAVKF_RENDEZVOUS")
    os.environ["MAVKF_RENDEZVOUS"] = f"tcp/127.0.0.1:{free_port(socket.SOCK_STREAM)}"
    with tempfile.TemporaryDirectory() as folder:
        one = Service(Path(folder), *words, core=core)
        try:
            yield one
        finally:
            one.kill()
            if before is None:
                del os.environ["MAVKF_RENDEZVOUS"]
            else:
                os.environ["MAVKF_RENDEZVOUS"] = before


def run(settings: Settings) -> list[Figure]:
    """Measure latency of one vehicle and of many, and the most messages."""
    ensure_compiled(lambda _: None)
    seconds = 2.0 if settings.quick else 10.0
    figures = _latency("one vehicle, IMU 200 Hz", vehicles(1, SETTLING_S + seconds, 200), settings, "--rate", "0")
    if settings.quick:
        return figures
    figures += _latency("100 vehicles, IMU 50 Hz", vehicles(100, SETTLING_S + seconds, 50), settings)
    return [*figures, *_most(settings)]


def split_at(datagrams: Sequence[Datagram]) -> int:
    """The index from which on the time counts."""
    first = datagrams[0].us + SETTLING_S * 1e6
    return next(i for i, each in enumerate(datagrams) if each.us >= first)


def _latency(name: str, datagrams: Sequence[Datagram], settings: Settings, *words: str) -> list[Figure]:
    """Median and p99 from datagram to callback, against zenoh's own, ms."""
    medians: list[float] = []
    tails: list[float] = []
    own_medians: list[float] = []
    own_tails: list[float] = []
    first = split_at(datagrams)
    for _ in range(settings.runs(RUNS)):
        with service(*words) as one:
            send(one.port, datagrams[:first], SOON if "--rate" in words else 1.0)
            stop = threading.Event()
            echoes: dict[int, int] = {}
            echo = threading.Thread(target=_echo, args=(stop, echoes))
            echo.start()
            sent = send(one.port, datagrams[first:])
            stop.set()
            echo.join()
            came = one.end()
        mine = [
            (came[f"{vehicle}-1", us] - at) * 1e-6 for (vehicle, us), at in sent.items() if (f"{vehicle}-1", us) in came
        ]
        own = [(came["echo", number] - at) * 1e-6 for number, at in echoes.items() if ("echo", number) in came]
        if not mine or not own:
            return [missing(f"{name}, latency", f"{len(mine)} poses and {len(own)} echoes came")]
        for values, median, tail in ((mine, medians, tails), (own, own_medians, own_tails)):
            median.append(float(np.median(values)))
            tail.append(float(np.quantile(values, 0.99)))
    return [
        figure(
            f"{name}, latency, median",
            "ms",
            medians,
            "zenoh alone, median",
            own_medians,
            f"{len(mine)} of {len(sent)} poses came",
        ),
        figure(f"{name}, latency, p99", "ms", tails, "zenoh alone, p99", own_tails, "meanwhile, the same payload"),
        alone("zenoh alone, median", "ms", own_medians),
        alone("zenoh alone, p99", "ms", own_tails),
    ]


def _echo(stop: threading.Event, echoes: dict[int, int]) -> None:
    """Publish a payload of a pose's size a hundred times a second, from here; when each number went."""
    with open_session(publishes=False) as session:
        publisher = session.declare_publisher(ECHO)
        time.sleep(QUIET_S)
        number = 0
        while not stop.wait(0.0101):
            number += 1
            payload = f"{number} ".encode().ljust(PAYLOAD, b"x")
            echoes[number] = time.monotonic_ns()
            publisher.put(payload)


def _most(settings: Settings) -> list[Figure]:
    """The most of a flight's messages a second that one core takes without backlog, against pymavlink's parser on the same frames."""
    flight = recorded(settings.log)
    first = next(i for i, each in enumerate(flight) if each.us >= flight[0].us + SETTLING_S * 1e6)
    best, cost = 0.0, 0.0
    for rate in RATES:
        piece = flight[first : first + int(rate * SUSTAINED_S)]
        with service(core=0) as one:
            send(one.port, flight[:first], 3.0)
            time.sleep(QUIET_S)
            begin, used = time.monotonic_ns(), cpu_s(one.serve.pid)
            send(one.port, [Datagram(i, 0, each.frame) for i, each in enumerate(piece)], rate * 1e-6)
            ended = time.monotonic_ns()
            time.sleep(QUIET_S)
            used = cpu_s(one.serve.pid) - used
            came = [at for at in one.end().values() if at > begin]
        expected = 50e-6 * (piece[-1].us - piece[0].us)
        if len(came) < COMPLETE * expected or max(came) - ended > BACKLOG_S * 1e9:
            break
        best, cost = len(piece) / ((ended - begin) * 1e-9), used / len(piece)
    if not best:
        return [missing("messages a second on one core", f"less than {RATES[0]}")]
    from pymavlink.dialects.v20 import ardupilotmega as mavlink

    parser = mavlink.MAVLink(None)
    data = b"".join(each.frame for each in flight[first : first + 20_000])
    start = time.perf_counter()
    parsed = len(parser.parse_buffer(data))
    peer = parsed / (time.perf_counter() - start)
    return [
        figure(
            "messages a second on one core",
            "",
            [best],
            "pymavlink `parse_buffer`",
            [peer],
            f"the highest of the steps tried without backlog; {1e6 * cost:.0f} us of processor a message, poses published",
        ),
        alone("pymavlink `parse_buffer`", "", [peer], "parsing alone"),
    ]
