"""Compile everything once, on a short made-up flight, so that no link waits for it."""

import time
from collections.abc import Callable, Iterator

import numpy as np

from mavkf.compiled import is_warm, mark_warm
from mavkf.config import Config
from mavkf.link.clocks import VehicleClock
from mavkf.link.decode import decode
from mavkf.link.framing import FrameStream, scan_records
from mavkf.link.gather import gather
from mavkf.link.layouts import message_ids
from mavkf.link.stamps import repair_stamps
from mavkf.navigation.estimator import run_offline
from mavkf.service.vehicle import VehicleStream

BEGIN_US = 1_750_000_000_000_000
SECONDS = 12


def ensure_compiled(say: Callable[[str], None]) -> float:
    """Compile what is not compiled yet, with a word to the user before; return the seconds it took (0: nothing to do)."""
    if is_warm():
        return 0.0
    say("compiling the estimator, once: about two minutes")
    begin = time.perf_counter()
    compile_all()
    return time.perf_counter() - begin


def compile_all() -> None:
    """Run every compiled path of `serve` and `replay`: scanner, decoder, clock, live and offline estimator, smoother, all models."""
    log = b"".join(stamp.to_bytes(8, "big") + frame for stamp, frame in flight())
    data = np.frombuffer(log, np.uint8)
    frames, _ = scan_records(data)
    repair_stamps(frames)
    gather(data, frames[frames["message"] == message_ids()["RAW_IMU"]], "RAW_IMU")
    rows = decode(data, frames)[1, 1]
    FrameStream().push(b"".join(frame for _, frame in flight()), BEGIN_US, last=True)
    for model in ("strapdown", "telemetry", "constant-velocity"):
        live = VehicleStream("1-1", Config(), model=model)
        for step in live.push(rows):
            for _ in live.records(step):
                pass
        clock = VehicleClock()
        run_offline(np.concatenate([clock.push(rows), clock.flush()]), Config(), model=model, smoothing=True)
    mark_warm()


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
