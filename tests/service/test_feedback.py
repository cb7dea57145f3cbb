"""`--mavlink-out`: ODOMETRY on the wire."""

import socket
import time
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from mavkf.cli import main

from .conftest import Frames, Reader, Serve, has_pose_at

Start = Callable[..., Serve]


def heard(sock: socket.socket) -> list[Any]:
    """What has come to a socket."""
    sock.settimeout(0.3)
    parser, found = mavlink.MAVLink(None), []
    try:
        while True:
            found += parser.parse_buffer(sock.recv(65_535)) or []
    except TimeoutError:
        return found


@pytest.mark.parametrize("to_vehicle", [True, False])
def test_odometry_goes_where_it_was_asked_for(to_vehicle: bool, serve: Start, reader: Reader, flight: Frames) -> None:
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other,
    ):
        other.bind(("127.0.0.1", 0))
        where = "vehicle" if to_vehicle else f"udpout:127.0.0.1:{other.getsockname()[1]}"
        process = serve("udpin:127.0.0.1:0", "--mavlink-out", where)
        vehicle.connect(("127.0.0.1", int(process.line("listens on").rsplit(":", 1)[1])))
        reader.wait_for_publisher()
        for _, frame in flight:
            vehicle.send(frame)
            time.sleep(0.0005)  # the pace of the sender
        poses = reader.wait(has_pose_at(20.9))["mavkf/1-1/pose"]
        found = [m for m in heard(vehicle if to_vehicle else other) if m.get_type() == "ODOMETRY"]
        none = [m for m in heard(other if to_vehicle else vehicle) if m.get_type() == "ODOMETRY"]
    assert process.interrupt() == 130
    assert none == []
    assert any("counts it twice" in line for line in process.lines)
    by_time = {round(pose["t_boot_s"] * 1e6): pose for pose in poses if all(pose["valid"].values())}
    assert len(found) > 150
    for message in found:
        pose = by_time[message.time_usec]
        assert [message.x, message.y, message.z] == pytest.approx(pose["position_ned_m"], abs=1e-5)
        assert (message.get_srcSystem(), message.get_srcComponent()) == (1, 191)
    times = [message.time_usec for message in found]
    assert min(b - a for a, b in pairwise(times)) >= 49_999


@pytest.mark.parametrize(
    ("words", "named"),
    [("--no-request --mavlink-out vehicle", "--no-request"), ("--mavlink-out nowhere:1", "nowhere")],
)
def test_what_cannot_be_is_one_sentence(words: str, named: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["serve", "udpin:127.0.0.1:0", *words.split()]) == 2
    assert named in capsys.readouterr().err
