"""Compile everything once, on a short made-up flight, so that no link waits for it."""

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numba
import numpy as np
from numpy.typing import NDArray

from mavkf.compiled import compile_ahead, is_shared, is_warm, mark_warm
from mavkf.config import Config
from mavkf.decimals import lines
from mavkf.link.clocks import VehicleClock
from mavkf.link.decode import decode
from mavkf.link.framing import FrameStream, scan_records
from mavkf.link.gather import gather
from mavkf.link.layouts import message_ids
from mavkf.link.stamps import StampRepair
from mavkf.navigation.offline import run_offline
from mavkf.navigation.setup import MODELS
from mavkf.service.vehicle import VehicleStream

BEGIN_US = 1_750_000_000_000_000
SECONDS = 12


REASON = "compiling the estimator, once: about half a minute"
SMOOTHER = "smoother"


def ensure_compiled(say: Callable[[str], None], *, smoothing: bool = False) -> float:
    """Compile what is not compiled yet, with a word to the user before; return the seconds it took (0: nothing to do).

    smoothing: whether the smoother is needed too, which live estimates never do.
    """
    begin = time.perf_counter()
    done = is_warm() and (not smoothing or is_warm(SMOOTHER))
    if done:
        return 0.0
    if not is_warm():
        say(REASON)
        compile_all()
    if smoothing and not is_warm(SMOOTHER):
        say("compiling the smoother, once: about ten seconds")
        compile_smoother()
    return time.perf_counter() - begin


def compile_all() -> None:
    """Compile every path of `serve` and `replay`, all models: scanner, decoder, clock, live and offline estimator."""
    with tempfile.TemporaryDirectory() as claims, _second_process(Path(claims)):
        rows = _rows()
        compile_ahead(Path(claims))
    for model in MODELS:
        live = VehicleStream("1-1", Config(), model=model)
        for step in live.push(rows):
            for _ in live.records(step):
                pass
        run_offline(_timed(rows), Config(), model=model)
    lines(np.zeros((1, 1)), [1], b"", [b""], np.zeros(1, np.int64))
    mark_warm()


def compile_smoother() -> None:
    """Compile what `replay --smooth` needs beside."""
    rows = _timed(_rows())
    for model in MODELS:
        run_offline(rows, Config(), model=model, smoothing=True)
    mark_warm(SMOOTHER)


@contextmanager
def _second_process(claims: Path) -> Iterator[None]:
    """Let another process take its share of `compile_ahead`; what it does not do for whatever reason is done here."""
    if numba.config.DISABLE_JIT or not is_shared():
        yield
        return
    code = (
        "import sys; from pathlib import Path; import mavkf.navigation.history, mavkf.navigation.outward; "
        "from mavkf.compiled import compile_ahead; "
        "compile_ahead(Path(sys.argv[1]), last_first=True)"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code, str(claims)], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL
    ) as other:
        try:
            yield
        except BaseException:
            other.terminate()
            raise


def _rows() -> NDArray[np.float64]:
    """The sample rows of the flight, read as a log and as a stream."""
    log = b"".join(stamp.to_bytes(8, "big") + frame for stamp, frame in flight())
    data = np.frombuffer(log, np.uint8)
    frames, _ = scan_records(data)
    frames = StampRepair().push(frames, last=True)
    gather(data, frames[frames["message"] == message_ids()["RAW_IMU"]], "RAW_IMU")
    FrameStream().push(b"".join(frame for _, frame in flight()), BEGIN_US, last=True)
    rows = decode(data, frames)[1, 1]
    VehicleClock().push(rows)
    return rows


def _timed(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    clock = VehicleClock()
    return np.concatenate([clock.push(rows), clock.flush()])


def flight() -> Iterator[tuple[int, bytes]]:
    """Yield (arrival in microseconds UTC, frame) of a vehicle at rest, with every sensor that is fused."""
    from pymavlink.dialects.v20 import ardupilotmega as mavlink

    sender = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    for k in range(SECONDS * 50):
        us = 1_000_000 + k * 20_000
        jitter = k * 7 % 5  # a sensor that repeats its value is a broken one
        messages = [mavlink.MAVLink_raw_imu_message(us, jitter, 0, -1000 + jitter, 0, jitter, 0, 220, 10, 430)]
        if k % 5 == 0:
            messages.append(mavlink.MAVLink_scaled_pressure_message(us // 1000, 960.0 + 0.01 * jitter, 0.0, 2500))
        if k % 10 == 0:
            fix = (us, 3, 473977418 + jitter, 85455938, 488_000, 80, 120, 3, 0, 12)
            messages.append(mavlink.MAVLink_gps_raw_int_message(*fix))
        if k % 50 == 0:
            messages.append(mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3))
            messages.append(mavlink.MAVLink_system_time_message(BEGIN_US + us, us // 1000))
        for message in messages:
            yield BEGIN_US + us, message.pack(sender)
            sender.seq = (sender.seq + 1) % 256
