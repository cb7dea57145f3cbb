"""Made-up vehicles, built by pymavlink before any clock runs, and sent at their times."""

import socket
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mavkf.link.framing import scan_records
from mavkf.replay.tlog import map_log

BOOT_US = 1_000_000
BEGIN_US = 1_760_000_000_000_000


class Datagram(NamedTuple):
    """When to send (us of boot time), the vehicle's number if it is an IMU sample, else 0, and the frame."""

    us: int
    vehicle: int
    frame: bytes


def vehicles(count: int, duration_s: float, imu_hz: int) -> list[Datagram]:
    """Frames of vehicles 1 to count at rest, in the order of time: IMU, GNSS at 5 Hz (late, as fixes are), pressure, heartbeat.

    Each at its own phase of a second.
    """
    from pymavlink.dialects.v20 import ardupilotmega as mavlink

    random = np.random.default_rng(1)
    result: list[Datagram] = []
    for vehicle in range(1, count + 1):
        sender = mavlink.MAVLink(None, srcSystem=vehicle, srcComponent=1)
        phase = (vehicle - 1) * 1_000_000 // count  # autopilots do not know of each other
        noise = random.integers(-5, 6, (int(duration_s * imu_hz), 9)).tolist()
        for k, draw in enumerate(noise):
            us = BOOT_US + k * 1_000_000 // imu_hz
            a, g = draw[:3], draw[3:6]
            messages = []
            if k % imu_hz == 0:
                messages.append(mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3))
                messages.append(mavlink.MAVLink_system_time_message(BEGIN_US + us, us // 1000))
            if k % (imu_hz // 5) == 0:
                fix = (us, 3, 473977418 + draw[6], 85455938 + draw[7], 488_000 + draw[8], 80, 120, 3, 0, 12)
                messages.append(mavlink.MAVLink_gps_raw_int_message(*fix))
                messages.append(mavlink.MAVLink_scaled_pressure_message(us // 1000, 960.0 + 0.01 * draw[6], 0.0, 2500))
            imu = mavlink.MAVLink_raw_imu_message(us, a[0], a[1], -1000 + a[2], *g, 220 + a[1], 10 + a[0], 430 + g[0])
            for message in (*messages, imu):
                result.append(Datagram(us + phase, vehicle if message is imu else 0, message.pack(sender)))
                sender.seq = (sender.seq + 1) % 256
    return sorted(result, key=lambda one: one.us)


def recorded(log: Path) -> list[Datagram]:
    """The frames of a log, each a datagram at its stamp; none counts as an IMU sample."""
    data = map_log(log)
    frames, _ = scan_records(data)
    begins = frames["offset"] - np.where(frames["version"] == 2, 10, 6)
    return [
        Datagram(us, 0, data[begin : begin + size].tobytes())
        for us, begin, size in zip(frames["stamp"].tolist(), begins.tolist(), frames["size"].tolist(), strict=True)
    ]


def send(port: int, datagrams: Sequence[Datagram], pace: float = 1.0) -> dict[tuple[int, int], int]:
    """Send each at its time, `pace` times as fast as it says; when (ns, monotonic) each IMU sample went, by vehicle and boot time (us)."""
    sent: dict[tuple[int, int], int] = {}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.connect(("127.0.0.1", port))
        begin, first = time.monotonic_ns(), datagrams[0].us
        for us, vehicle, frame in datagrams:
            due = begin + int((us - first) * 1000 / pace)
            while (left := due - time.monotonic_ns()) > 0:
                time.sleep(left * 1e-9)
            if vehicle:
                sent[vehicle, int.from_bytes(frame[10:18], "little")] = time.monotonic_ns()
            one.send(frame)
    return sent
