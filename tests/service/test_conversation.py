"""What is said to an autopilot, and when: a scripted one answers, denies or stays silent, on made-up time."""

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from mavkf.link.framing import FrameStream
from mavkf.link.layouts import message_ids
from mavkf.service.endpoints import Link
from mavkf.service.streams import STREAMS, affordable, message_bytes
from mavkf.service.talk import FORGET_S, MOST_TALKS, Manners, Talk

from ._autopilot import Autopilot, Manner

SET, GET = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAV_CMD_GET_MESSAGE_INTERVAL
NEEDED = {"GPS_RAW_INT": 200_000, "SYSTEM_TIME": 1_000_000, "SCALED_PRESSURE": 100_000, "HIGHRES_IMU": 10_000}


class Wire(Link):
    """A link whose other end is the test."""

    def __init__(self, *, local: bool | None = True, baud: int | None = None, speaks_first: bool = False) -> None:
        super().__init__("wire", print)
        self.local, self.baud, self.speaks_first = local, baud, speaks_first  # type: ignore[misc]
        self.sent: list[bytes] = []

    @property
    def is_local(self) -> bool | None:
        return self.local

    def _send(self, data: bytes) -> bool:
        self.sent.append(data)
        return True


class Bench:
    """Autopilots at one end of a wire, our talk at the other, and a clock."""

    def __init__(self, *autopilots: Autopilot, wire: Wire | None = None, **manners: Any) -> None:
        self.autopilots, self.wire, self.said = autopilots, wire or Wire(), list[str]()
        self.talk = Talk(self.wire, 0, Manners(**manners, say=self.said.append), lambda: 1_760_000_000_000_000)
        self.stream = FrameStream()
        self.t = 0.0
        self.received = 0
        self.given_up: set[tuple[int, int]] = set()

    def run(self, seconds: float, loss: Callable[[bytes], bool] = lambda _: False) -> "Bench":
        for _ in range(round(seconds / 0.1)):
            self.t += 0.1
            for autopilot in self.autopilots:
                self.hear(b"".join(frame for frame in autopilot.advance(self.t) if not loss(frame)))
            self.talk.speak(self.t, self.given_up)
            self.deliver()
        return self

    def hear(self, data: bytes) -> None:
        self.received += len(data)
        self.talk.hear(*self.stream.push(data, round(self.t * 1e6)), self.t)

    def deliver(self) -> None:
        for data in self.wire.sent:
            for autopilot in self.autopilots:
                autopilot.hear(data)
        self.wire.sent.clear()

    def leave(self) -> None:
        self.talk.leave()
        self.deliver()


def commands(autopilot: Autopilot, command: int) -> list[tuple[str, int]]:
    """The messages and second parameters of the commands that it heard."""
    return [
        (mavlink.mavlink_map[int(m.param1)].msgname, int(m.param2))
        for m in autopilot.asked
        if m.get_type() == "COMMAND_LONG" and m.command == command
    ]


def heartbeats(autopilot: Autopilot) -> list[Any]:
    return [m for m in autopilot.asked if m.get_type() == "HEARTBEAT"]


def of_streams(autopilot: Autopilot) -> list[Any]:
    """What it was asked about streams."""
    return [m for m in autopilot.asked if m.get_type() in ("COMMAND_LONG", "REQUEST_DATA_STREAM")]


def test_a_shy_autopilot_is_asked_and_grants() -> None:
    shy = Autopilot()
    bench = Bench(shy).run(12)
    assert {name: shy.intervals[name] for name in NEEDED} == NEEDED
    assert all(get in commands(shy, GET) for get in [(name, 0) for name in NEEDED])
    assert [line for line in bench.said if "asked for" in line] == bench.said
    assert len(bench.said) == 1
    assert re.search(r"HIGHRES_IMU at 100 Hz \(HIGHRES_IMU comes at (9[5-9]|10\d)\)", bench.said[0])
    assert "vehicle 1-1 on wire" in bench.said[0]
    bench.run(60)  # what was granted is not asked for again
    assert len(commands(shy, SET)) == len(STREAMS)
    assert len(bench.said) == 1


def test_our_heartbeat_is_an_onboard_computers_of_the_vehicles_system_once_a_second() -> None:
    vehicle = Autopilot(system=7)
    Bench(vehicle).run(20)
    beats = heartbeats(vehicle)
    assert 19 <= len(beats) <= 20
    assert {(b.get_srcSystem(), b.get_srcComponent(), b.type, b.autopilot) for b in beats} == {
        (7, mavlink.MAV_COMP_ID_ONBOARD_COMPUTER, mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID)
    }
    sequences = [m.get_seq() for m in vehicle.asked]
    assert sequences == [k % 256 for k in range(len(sequences))]


def test_our_identity_can_be_given() -> None:
    vehicle = Autopilot()
    Bench(vehicle, system=42, component=197).run(12)
    assert {(m.get_srcSystem(), m.get_srcComponent()) for m in vehicle.asked} == {(42, 197)}
    assert len(commands(vehicle, SET)) == len(STREAMS)


def test_what_comes_well_enough_is_not_asked_for() -> None:
    vehicle = Autopilot(intervals_us={**NEEDED, "RAW_IMU": 5000, "HIGHRES_IMU": 0})
    bench = Bench(vehicle).run(30)
    assert not of_streams(vehicle)
    assert not bench.said


def test_a_rate_that_others_set_is_never_lowered() -> None:
    vehicle = Autopilot(intervals_us={"GPS_RAW_INT": 100_000, "SCALED_PRESSURE": 20_000, "RAW_IMU": 250_000})
    bench = Bench(vehicle).run(12)
    assert vehicle.intervals["GPS_RAW_INT"] == 100_000
    assert vehicle.intervals["SCALED_PRESSURE"] == 20_000
    bench.leave()
    assert vehicle.intervals["GPS_RAW_INT"] == 100_000


def test_another_message_is_asked_for_where_one_is_denied() -> None:
    vehicle = Autopilot(denied=("HIGHRES_IMU",))
    bench = Bench(vehicle).run(12)
    assert vehicle.intervals["RAW_IMU"] == 10_000
    assert re.search(r"HIGHRES_IMU at 100 Hz \(RAW_IMU comes at (9[5-9]|10\d)\)", bench.said[0])
    bench.leave()
    assert len([name for name, _ in commands(vehicle, SET) if name == "HIGHRES_IMU"]) == 1  # nothing to put back


@pytest.mark.parametrize("sets", ["deny", "silent"])
@pytest.mark.parametrize("gets", ["grant", "deny", "silent"])
def test_data_streams_are_asked_for_where_intervals_are_not_granted(sets: Manner, gets: Manner) -> None:
    old = Autopilot(sets=sets, gets=gets)
    bench = Bench(old).run(15)
    assert old.intervals == {
        "RAW_IMU": 20_000,
        "SCALED_PRESSURE": 20_000,
        "GPS_RAW_INT": 200_000,
        "SYSTEM_TIME": 1_000_000,
    }
    assert re.search(r"\(RAW_IMU comes at (4[7-9]|5[0-3])\)", bench.said[0])
    if gets == "deny":
        assert len(commands(old, GET)) == len(set(commands(old, GET)))  # a refusal is an answer
    bench.leave()
    assert set(old.intervals.values()) == {-1}  # all were silent before


def test_who_answers_nothing_is_asked_less_and_less_and_told_once() -> None:
    mute = Autopilot(sets="silent", gets="silent", streams="silent")
    bench = Bench(mute).run(60)
    first = len(of_streams(mute))
    bench.run(240)
    assert first < len(of_streams(mute)) < 2.5 * first
    assert len(bench.said) == 1
    assert bench.said[0].count("does not come") == len([s for s in STREAMS if s.required])


def test_a_reboot_is_asked_again_at_once() -> None:
    vehicle = Autopilot()
    bench = Bench(vehicle).run(15)
    vehicle.reboot(bench.t + 3)
    bench.run(12)
    assert {name: vehicle.intervals[name] for name in NEEDED} == NEEDED
    assert len(commands(vehicle, SET)) == 2 * len(STREAMS)


def test_a_reboot_that_is_heard_by_its_clock_is_asked_again() -> None:
    vehicle = Autopilot()
    bench = Bench(vehicle).run(30)
    vehicle.default["SYSTEM_TIME"] = 1_000_000
    vehicle.reboot(bench.t)
    before = len(commands(vehicle, SET))
    bench.run(4)
    assert len(commands(vehicle, SET)) > before


def test_what_is_lost_on_the_way_is_not_set_again_nor_taken_for_somebody_elses_wish() -> None:
    vehicle = Autopilot(intervals_us={"GPS_RAW_INT": 500_000})
    bench = Bench(vehicle).run(15)
    before, asked = len(commands(vehicle, SET)), len(commands(vehicle, GET))
    rng = np.random.default_rng(3)
    bench.run(30, loss=lambda frame: frame[7] == message_ids()["HIGHRES_IMU"] and bool(rng.random() < 0.8))
    assert len(commands(vehicle, GET)) > asked
    assert len(commands(vehicle, SET)) == before
    bench.leave()
    assert {name: interval for name, interval in vehicle.intervals.items() if interval > 0} == vehicle.default


def test_a_rate_that_falls_is_asked_for_again() -> None:
    vehicle = Autopilot()
    bench = Bench(vehicle).run(20)
    vehicle.intervals["HIGHRES_IMU"] = 500_000  # another program's doing
    bench.run(12)
    assert vehicle.intervals["HIGHRES_IMU"] == 10_000
    bench.leave()
    assert vehicle.intervals["HIGHRES_IMU"] == 500_000  # as it was found the last time


def test_leaving_puts_back_what_was_found() -> None:
    vehicle = Autopilot(intervals_us={"RAW_IMU": 250_000, "GPS_RAW_INT": 500_000})
    vehicle.intervals["SCALED_PRESSURE"] = 2_000_000
    before = dict(vehicle.intervals)
    bench = Bench(vehicle).run(15)
    assert vehicle.intervals != before
    bench.leave()
    assert {name: interval for name, interval in vehicle.intervals.items() if interval > 0} == before


def test_leaving_gives_the_default_back_where_nothing_was_said_of_it() -> None:
    vehicle = Autopilot(gets="silent", intervals_us={"GPS_RAW_INT": 500_000})
    bench = Bench(vehicle).run(15)
    assert vehicle.intervals["GPS_RAW_INT"] == 200_000
    bench.leave()
    assert vehicle.intervals["GPS_RAW_INT"] == 500_000


def test_a_radio_is_listened_to_and_told_once_what_would_be_asked() -> None:
    vehicle = Autopilot(intervals_us={"RAW_IMU": 250_000})
    bench = Bench(vehicle, wire=Wire(local=False, baud=57600)).run(60)
    assert heartbeats(vehicle) == vehicle.asked
    assert len(vehicle.asked) > 50
    assert len(bench.said) == 1
    assert "would ask for" in bench.said[0]
    assert "--request" in bench.said[0]


def test_nothing_at_all_is_sent_where_nothing_may_be() -> None:
    vehicle = Autopilot()
    Bench(vehicle, request=False).run(30)
    assert not vehicle.asked


def radio() -> bytes:
    """What a telemetry radio on the way says of itself."""
    data: bytes = mavlink.MAVLink_radio_status_message(180, 170, 90, 40, 38, 0, 0).pack(mavlink.MAVLink(None, 51, 68))
    return data


def test_a_radio_behind_a_near_link_is_spared() -> None:
    vehicle = Autopilot()
    bench = Bench(vehicle)
    bench.hear(radio())
    bench.run(20)
    assert heartbeats(vehicle) == vehicle.asked
    assert "would ask for" in bench.said[0]


def test_what_was_asked_for_is_taken_back_when_a_radio_shows() -> None:
    vehicle = Autopilot(intervals_us={"RAW_IMU": 250_000})
    bench = Bench(vehicle).run(15)
    assert vehicle.intervals["HIGHRES_IMU"] == 10_000
    bench.hear(radio())
    bench.run(60)
    assert {name: interval for name, interval in vehicle.intervals.items() if interval > 0} == {"RAW_IMU": 250_000}
    assert sum("radio on the way" in line for line in bench.said) == 1


def test_a_radio_is_asked_within_its_share_on_request() -> None:
    vehicle = Autopilot()
    bench = Bench(vehicle, request=True)
    bench.hear(radio())
    bench.run(20)
    assert dict(commands(vehicle, SET))["HIGHRES_IMU"] > 20_000


def test_a_connection_that_was_cut_is_looked_at_again_at_once() -> None:
    vehicle = Autopilot()
    bench = Bench(vehicle).run(20)
    vehicle.reboot(bench.t)
    bench.talk.cut()
    before = len(commands(vehicle, SET))
    bench.run(2.5)
    assert len(commands(vehicle, SET)) > before


@pytest.mark.parametrize("share", [0.2, 0.5, 1.0])
@pytest.mark.parametrize("baud", [9600, 57600])
def test_what_is_asked_for_stays_within_the_share_of_a_serial_link(baud: int, share: float) -> None:
    vehicle = Autopilot()
    bench = Bench(vehicle, wire=Wire(local=False, baud=baud), request=True, share=share).run(12)
    bench.received = 0
    bench.run(30)
    assert 0.3 * share * baud / 10 < bench.received / 30 < share * baud / 10 + 40  # heartbeats come anyhow
    asked = dict(commands(vehicle, SET))
    assert asked["GPS_RAW_INT"] <= 400_000  # the little that matters most comes first


def test_of_an_unknown_distant_link_the_share_is_of_what_it_carries() -> None:
    slow, fast = Autopilot(), Autopilot(intervals_us={"GPS2_RAW": 500})
    for vehicle in (slow, fast):
        Bench(vehicle, wire=Wire(local=False), request=True).run(20)
    assert dict(commands(slow, SET))["HIGHRES_IMU"] > 20_000  # what the usual radio carries
    assert dict(commands(fast, SET))["HIGHRES_IMU"] == 10_000


def test_a_share_is_never_exceeded() -> None:
    for budget in np.geomspace(1.0, 1e5, 50):
        rates = affordable(STREAMS, float(budget))
        assert sum(rate * message_bytes(stream.messages[0]) for stream, rate in rates.items()) <= budget + 1e-9
        assert all(0.5 <= rate <= stream.rate_hz for stream, rate in rates.items())
    assert {stream: stream.rate_hz for stream in STREAMS} == affordable(STREAMS, float("inf"))


@pytest.mark.parametrize(
    "kind",
    [
        (mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID),
        (mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_GENERIC),
        (mavlink.MAV_TYPE_CAMERA, mavlink.MAV_AUTOPILOT_INVALID),
        (mavlink.MAV_TYPE_GIMBAL, mavlink.MAV_AUTOPILOT_INVALID),
        (mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID),
        (mavlink.MAV_TYPE_ADSB, mavlink.MAV_AUTOPILOT_INVALID),
    ],
)
def test_nobody_but_autopilots_is_talked_to(kind: tuple[int, int]) -> None:
    other = Autopilot(kind=kind)
    Bench(other).run(20)
    assert not other.asked


def test_two_vehicles_on_one_link_are_each_asked() -> None:
    vehicles = Autopilot(system=1), Autopilot(system=2)
    Bench(*vehicles).run(12)
    targets = {m.target_system for m in vehicles[0].asked if m.get_type() == "COMMAND_LONG"}
    assert targets == {1, 2}
    assert {b.get_srcSystem() for b in heartbeats(vehicles[0])} == {1, 2}


def test_a_vehicle_that_is_given_up_or_silent_is_not_talked_to() -> None:
    vehicle = Autopilot()
    bench = Bench(vehicle)
    bench.given_up.add((1, 1))
    bench.run(5)
    assert not vehicle.asked
    bench.given_up.clear()
    bench.run(5)
    assert vehicle.asked
    bench.autopilots = ()
    bench.run(11)
    bench.wire.sent.clear()
    bench.talk.speak(bench.t + 1.5)
    assert not bench.wire.sent


def test_who_must_be_spoken_to_first_is() -> None:
    bench = Bench(wire=Wire(speaks_first=True))
    bench.talk.speak(0.0)
    assert len(bench.wire.sent) == 1
    vehicle = Autopilot()
    vehicle.hear(bench.wire.sent[0])
    assert heartbeats(vehicle)


def test_one_identity_has_one_heartbeat_however_many_vehicles_there_are() -> None:
    vehicles = Autopilot(system=1), Autopilot(system=2)
    Bench(*vehicles, system=42).run(10)
    assert 9 <= len(heartbeats(vehicles[0])) <= 10


def test_a_vehicle_of_mavlink_1_is_answered_in_mavlink_1() -> None:
    vehicle = Autopilot(version=1)
    bench = Bench(vehicle)
    firsts = set()
    for _ in range(120):
        bench.t += 0.1
        bench.hear(b"".join(vehicle.advance(bench.t)))
        bench.talk.speak(bench.t)
        firsts |= {data[0] for data in bench.wire.sent}
        bench.deliver()
    assert firsts == {0xFE}
    assert {name: vehicle.intervals[name] for name in NEEDED} == NEEDED


def test_a_flood_of_made_up_vehicles_is_bounded_and_forgotten() -> None:
    bench = Bench()
    for system in range(1, 250):
        bench.hear(b"".join(Autopilot(system=system).advance(0.0)))
    bench.talk.speak(0.1)
    assert len(bench.talk.conversations) == MOST_TALKS
    bench.t += FORGET_S + 1
    vehicle = Autopilot(system=250)
    bench.autopilots = (vehicle,)
    bench.run(12)
    assert {name: vehicle.intervals[name] for name in NEEDED} == NEEDED
    assert len(bench.talk.conversations) == 1


@pytest.mark.parametrize("target", [(255, 190), (255, 191), (1, 190)])
def test_an_answer_to_somebody_else_is_not_ours(target: tuple[int, int]) -> None:
    vehicle = Autopilot(sets="silent", gets="silent", streams="silent")
    bench = Bench(vehicle)
    for _ in range(100):
        refusal = mavlink.MAVLink_command_ack_message(SET, mavlink.MAV_RESULT_DENIED, 0, 0, *target)
        bench.hear(refusal.pack(vehicle.wire))
        bench.run(0.1)
    assert len([name for name, _ in commands(vehicle, SET) if name == "RAW_IMU"]) == 0


def test_a_lossy_link_is_asked_until_it_answers() -> None:
    vehicle = Autopilot()
    rng = np.random.default_rng(3)
    Bench(vehicle).run(60, loss=lambda _: bool(rng.random() < 0.3))
    assert {name: vehicle.intervals[name] for name in NEEDED} == NEEDED


@settings(max_examples=25, deadline=None)
@given(st.data())
def test_no_bytes_upset_the_conversation(data: st.DataObject) -> None:
    vehicle = Autopilot(sets=data.draw(st.sampled_from(["grant", "deny", "silent"])))
    bench = Bench(vehicle)
    for _ in range(data.draw(st.integers(1, 30))):
        bench.t += data.draw(st.floats(0.0, 20.0))
        frames = bytearray(b"".join(vehicle.advance(bench.t)[:40]))
        for at in data.draw(st.lists(st.integers(0, 4000), max_size=4)):
            if at < len(frames):
                frames[at] ^= data.draw(st.integers(1, 255))
        bench.hear(bytes(frames) + data.draw(st.binary(max_size=40)))
        odd = data.draw(st.sampled_from(list(_ODD)))
        bench.hear(_ODD[odd](data).pack(vehicle.wire))
        bench.talk.speak(bench.t)
        assert len(bench.wire.sent) < 60
        bench.deliver()
    bench.leave()


_ODD: dict[str, Callable[[Any], Any]] = {
    "ack": lambda data: mavlink.MAVLink_command_ack_message(
        data.draw(st.sampled_from([SET, GET, 0, 65535])), data.draw(st.integers(0, 255))
    ),
    "interval": lambda data: mavlink.MAVLink_message_interval_message(
        data.draw(st.sampled_from([*(message_ids()[name] for name in NEEDED), 0, 65535])),
        data.draw(st.integers(-(2**31), 2**31 - 1)),
    ),
    "time": lambda data: mavlink.MAVLink_system_time_message(0, data.draw(st.integers(0, 2**32 - 1))),
    "heartbeat": lambda data: mavlink.MAVLink_heartbeat_message(
        data.draw(st.integers(0, 255)), data.draw(st.integers(0, 255)), 0, 0, 0, 3
    ),
}
