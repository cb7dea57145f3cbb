"""The few parameters that help: who is asked, how often, what comes of the answers, and that a recording holds it all."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from mavkf.config import Config, with_settings
from mavkf.link.decode import decode
from mavkf.link.framing import FrameStream
from mavkf.navigation.setup import choose
from mavkf.navigation.stated import FARTHEST, LONGEST_S, too_late, values_of
from mavkf.replay.options import Options, Watch
from mavkf.replay.run import run
from mavkf.samples import PARAMETER, PARAMETER_VALUE, ROW_WIDTH, AutopilotParameter, Source
from mavkf.service.belief import Belief
from mavkf.service.parameters import QUESTIONS, ROUNDS_S
from mavkf.service.talk import Manners
from mavkf.service.vehicle import VehicleStream
from mavkf.service.worker import Worker

from ._autopilot import UTC_US, Autopilot
from .test_conversation import Bench, Wire, radio
from .test_way_in import WayIn

ARDUPILOT, PX4 = (2, 3), (2, 12)
ARM = {
    "GPS1_POS_X": 0.3,
    "GPS1_POS_Y": -0.1,
    "GPS1_POS_Z": -0.2,
    "INS_POS1_X": 0.1,
    "INS_POS1_Y": 0.0,
    "INS_POS1_Z": 0.0,
}
OLD_ARM = {name.replace("GPS1_POS", "GPS_POS1"): value for name, value in ARM.items()}
PX4_ARM = {f"EKF2_GPS_POS_{axis}": value for axis, value in zip("XYZ", (0.3, -0.1, -0.2), strict=True)} | {
    f"EKF2_IMU_POS_{axis}": value for axis, value in zip("XYZ", (0.1, 0.0, 0.0), strict=True)
}
NEW_PX4_ARM = {name.replace("EKF2_GPS_POS_", "SENS_GPS0_OFF"): value for name, value in PX4_ARM.items()}
SENT = {"RAW_IMU": 20_000, "GPS_RAW_INT": 200_000, "SYSTEM_TIME": 1_000_000, "SCALED_PRESSURE": 100_000}


def asked(autopilot: Autopilot) -> list[str]:
    return [m.param_id for m in autopilot.asked if m.get_type() == "PARAM_REQUEST_READ"]


class Heard(Bench):
    """What was received as well as a log holds it, and as the estimator of the vehicle takes it."""

    def __init__(self, *autopilots: Autopilot, config: Config | None = None, **manners: Any) -> None:
        super().__init__(*autopilots, **manners)
        self.stream_of = VehicleStream("1-1", config or Config())
        self.records: list[Any] = []
        self.log: list[bytes] = []
        self.whole = FrameStream()

    def hear(self, data: bytes) -> None:
        super().hear(data)
        stamp = UTC_US + round(self.t * 1e6)
        found, frames = self.whole.push(data, stamp)
        for begin, size in zip(frames["offset"].tolist(), frames["size"].tolist(), strict=True):
            self.log.append(stamp.to_bytes(8, "big") + found[begin - 10 : begin - 10 + size].tobytes())
        rows = decode(found, frames).get((1, 1))
        if rows is not None:
            for step in self.stream_of.push(rows):
                self.records += self.stream_of.records(step)

    @property
    def setup(self) -> Any:
        assert self.stream_of.estimator is not None
        return self.stream_of.estimator.setup


@pytest.mark.parametrize("kind", [ARDUPILOT, PX4])
def test_who_answers_is_asked_once_and_told_in_a_line(kind: tuple[int, int]) -> None:
    names = {questions[0].name for questions in QUESTIONS[kind[1]]}
    vehicle = Autopilot(kind=kind, parameters=dict.fromkeys(names, 0.0), intervals_us=SENT)
    bench = Bench(vehicle).run(5.0)
    assert set(asked(vehicle)) >= names
    assert len(asked(vehicle)) == len(set(asked(vehicle)))
    told = [line for line in bench.said if "its parameters say" in line]
    assert len(told) == 1
    assert all(f"{name} 0" in told[0] for name in names)
    bench.run(60.0)
    assert len(asked(vehicle)) == len(set(asked(vehicle)))
    assert all((m.target_system, m.target_component, m.param_index) == (1, 1, -1) for m in vehicle.asked[1:2])


def test_the_first_question_comes_with_the_first_heartbeat() -> None:
    vehicle = Autopilot()
    Bench(vehicle).run(0.2)
    assert len(asked(vehicle)) > 2
    Bench(vehicle).run(1.0)
    assert {name.name for names in QUESTIONS[3] for name in names} <= set(asked(vehicle))


def test_who_is_silent_is_asked_three_times_and_never_again() -> None:
    mute = Autopilot(reads="silent")
    bench = Bench(mute).run(10.0)
    count = len(asked(mute))
    assert count == len(ROUNDS_S) * sum(map(len, QUESTIONS[3]))
    bench.run(300.0)
    assert len(asked(mute)) == count
    assert not any("parameters" in line for line in bench.said)


def test_who_denies_is_asked_once() -> None:
    unwilling = Autopilot(reads="deny")
    Bench(unwilling).run(60.0)
    assert len(asked(unwilling)) == sum(map(len, QUESTIONS[3]))


def test_what_others_are_told_is_not_asked_for() -> None:
    vehicle = Autopilot(parameters=ARM)
    bench = Bench(vehicle)
    bench.hear(b"".join(vehicle.advance(0.0)))
    bench.hear(b"".join(vehicle._packed(vehicle.parameter(name)) for name in ARM))
    bench.run(1.0)
    assert not set(asked(vehicle)) & set(ARM)


def test_what_is_lost_is_asked_for_again() -> None:
    vehicle = Autopilot(parameters=ARM)
    rng = np.random.default_rng(3)
    bench = Bench(vehicle).run(8.0, loss=lambda _: bool(rng.random() < 0.3))
    told = [line for line in bench.said if "its parameters say" in line][-1]
    assert sum(name in told for name in ARM) >= 5


def test_a_reboot_is_asked_again() -> None:
    vehicle = Autopilot(parameters=ARM)
    bench = Bench(vehicle).run(15.0)
    before = len(asked(vehicle))
    vehicle.reboot(bench.t)
    bench.run(30.0)
    assert len(asked(vehicle)) == 2 * before
    assert sum("its parameters say" in line for line in bench.said) == 1  # they are the same


def test_who_has_its_session_reset_is_asked_again() -> None:
    vehicle = Autopilot(parameters=ARM)
    bench = Bench(vehicle)
    fleet = WayIn(Belief(), Manners()).fleet
    worker = Worker(fleet, [bench.wire], [], [bench.talk], Belief(), [FrameStream()])  # type: ignore[arg-type]
    bench.run(10.0)
    before = len(asked(vehicle))
    worker._fleet.when_ended()
    bench.run(10.0)
    assert len(asked(vehicle)) == 2 * before


def test_nobody_is_asked_where_streams_may_not_be() -> None:
    for bench in (Bench(Autopilot(), wire=Wire(local=False, baud=57600)), Bench(Autopilot(), request=False)):
        bench.run(20.0)
        assert not asked(bench.autopilots[0])
    near = Bench(Autopilot())
    near.hear(radio())
    near.run(20.0)
    assert not asked(near.autopilots[0])
    wished = Bench(Autopilot(), wire=Wire(local=False, baud=57600), request=True).run(20.0)
    assert asked(wished.autopilots[0])


@pytest.mark.parametrize("kind", [(2, 0), (2, 8), (6, 3)])
def test_nobody_but_those_whose_parameters_are_known_is_asked(kind: tuple[int, int]) -> None:
    other = Autopilot(kind=kind)
    Bench(other).run(20.0)
    assert not asked(other)


def test_the_answers_stay_within_the_share_of_a_slow_link() -> None:
    vehicle = Autopilot(parameters=ARM | {"GPS1_DELAY_MS": 0, "COMPASS_USE": 1})
    bench = Bench(vehicle, wire=Wire(local=False, baud=9600), request=True, share=0.25)
    counts = []
    for _ in range(10):
        before = len(asked(vehicle))
        bench.run(0.5)
        counts.append(len(asked(vehicle)) - before)
    assert max(counts) * 37 <= 0.25 * 960 * (0.5 + 0.2) + 37
    assert sum(counts) > 10
    Bench(vehicle, wire=Wire(local=False, baud=9600), request=True, share=0.0).run(5.0)


@pytest.mark.parametrize(
    ("kind", "parameters"),
    [(ARDUPILOT, ARM), (ARDUPILOT, OLD_ARM), (PX4, PX4_ARM), (PX4, NEW_PX4_ARM)],
)
def test_an_antenna_that_is_stated_is_where_the_estimate_takes_it_to_be(
    kind: tuple[int, int], parameters: dict[str, float]
) -> None:
    vehicle = Autopilot(kind=kind, parameters=parameters, intervals_us=SENT)
    bench = Heard(vehicle).run(8.0)
    assert bench.setup.antenna == pytest.approx((0.2, -0.1, -0.2), abs=1e-6)
    assert "GNSS antenna 0.2 m ahead of, 0.1 m left of, 0.2 m above the IMU: from the autopilot's parameters" in (
        bench.setup.reasons
    )


@pytest.mark.parametrize(
    ("kind", "parameters", "delay"),
    [
        (ARDUPILOT, {"GPS1_DELAY_MS": 120}, 0.12),
        (ARDUPILOT, {"GPS_DELAY_MS": 120}, 0.12),
        (ARDUPILOT, {"GPS1_DELAY_MS": 0}, 0.085),
        (PX4, {"EKF2_GPS_DELAY": 110.0}, 0.11),
        (PX4, {"SENS_GPS0_DELAY": 110}, 0.11),
        (PX4, {"SENS_GPS0_DELAY": 0}, 0.0),
        (ARDUPILOT, {"GPS1_DELAY_MS": -5}, 0.085),
        (ARDUPILOT, {"GPS1_DELAY_MS": 1001}, 0.085),
    ],
)
def test_a_delay_that_is_stated_is_used_if_it_is_one(
    kind: tuple[int, int], parameters: dict[str, float], delay: float
) -> None:
    bench = Heard(Autopilot(kind=kind, parameters=parameters, intervals_us=SENT)).run(8.0)
    assert bench.setup.gnss_delay == pytest.approx(delay)
    is_told = f"GNSS delay {delay:g} s: from the autopilot's parameters" in bench.setup.reasons
    assert is_told == (delay != 0.085)
    assert any("is no delay" in reason for reason in bench.setup.reasons) == (
        parameters.get("GPS1_DELAY_MS") in (-5, 1001)
    )


@pytest.mark.parametrize(
    ("kind", "parameters", "is_used"),
    [
        (ARDUPILOT, {"COMPASS_USE": 1}, True),
        (ARDUPILOT, {"COMPASS_USE": 0}, False),
        (ARDUPILOT, {"COMPASS_USE2": 0}, True),
        (ARDUPILOT, {"COMPASS_ENABLE": 0}, False),
        (PX4, {"EKF2_MAG_TYPE": 0, "SYS_HAS_MAG": 1}, True),
        (PX4, {"EKF2_MAG_TYPE": 5}, False),
        (PX4, {"SYS_HAS_MAG": 0}, False),
    ],
)
def test_a_compass_that_the_autopilot_does_not_use_is_not_used(
    kind: tuple[int, int], parameters: dict[str, float], is_used: bool
) -> None:
    vehicle = Autopilot(kind=kind, parameters=parameters, intervals_us=SENT, denied=("HIGHRES_IMU",))
    bench = Heard(vehicle).run(20.0)
    assert (Source.RAW_IMU in bench.setup.magnetometers) == is_used
    assert any("the magnetometer of RAW_IMU is not used" in reason for reason in bench.setup.reasons) != is_used
    heading = [r for r in bench.records if "heading found from the magnetometer" in getattr(r, "text", "")]
    assert bool(heading) == is_used
    wished = Heard(
        Autopilot(kind=kind, parameters=parameters, intervals_us=SENT, denied=("HIGHRES_IMU",)),
        config=with_settings(Config(), ["use_magnetometer=true"]),
    ).run(8.0)
    assert Source.RAW_IMU in wished.setup.magnetometers


def test_what_the_user_has_set_stays() -> None:
    config = with_settings(Config(), ["gnss_antenna_b_m=[0, 0, 0]", "gnss_delay_s=0.2"])
    bench = Heard(Autopilot(parameters=ARM | {"GPS1_DELAY_MS": 120}, intervals_us=SENT), config=config).run(8.0)
    assert bench.setup.antenna == (0.0, 0.0, 0.0)
    assert bench.setup.gnss_delay == 0.2
    assert not any("parameters" in reason for reason in bench.setup.reasons)


def test_an_antenna_that_is_too_far_is_refused_and_told() -> None:
    bench = Heard(Autopilot(parameters=ARM | {"GPS1_POS_Y": 12.0}, intervals_us=SENT)).run(8.0)
    assert bench.setup.antenna == (0.0, 0.0, 0.0)
    assert "GPS1_POS_Y of the autopilot's parameters is not used: 12 m is farther than 5 m" in bench.setup.reasons


def test_the_parameters_of_another_component_are_not_the_autopilots() -> None:
    vehicle, camera = Autopilot(intervals_us=SENT), Autopilot(parameters=ARM, kind=(30, 8))
    camera.wire.srcComponent = 100
    bench = Heard(vehicle).run(2.0)
    bench.hear(b"".join(camera._packed(camera.parameter(name)) for name in ARM))
    bench.run(8.0)
    assert bench.setup.antenna == (0.0, 0.0, 0.0)
    assert "GPS1_POS_X" in asked(vehicle)
    assert not any("its parameters say" in line for line in bench.said)


def test_nothing_waits_for_parameters_and_those_that_are_too_late_are_told_once() -> None:
    vehicle = Autopilot(reads="silent", parameters=ARM | {"GPS1_DELAY_MS": 0, "COMPASS_USE3": 0}, intervals_us=SENT)
    bench = Heard(vehicle).run(7.0)
    assert bench.setup is not None
    for _ in range(3):
        bench.hear(b"".join(vehicle._packed(vehicle.parameter(name)) for name in vehicle.parameters))
        bench.run(3.0)
    assert bench.setup.antenna == (0.0, 0.0, 0.0)
    (event,) = [record for record in bench.records if getattr(record, "kind", None) == "parameters_late"]
    assert event.text.startswith("GPS1_POS_X, GPS1_POS_Y, GPS1_POS_Z of the autopilot's parameters came after")
    assert [r for r in bench.records if hasattr(r, "counts")][-1].counts["parameters_late"] == 3 * 3


def test_live_equals_the_replay_of_its_recording_however_it_was_cut(tmp_path: Any) -> None:
    vehicle = Autopilot(parameters=ARM | {"GPS1_DELAY_MS": 120, "COMPASS_USE2": 0}, intervals_us=SENT)
    bench = Heard(vehicle).run(12.0)
    vehicle.parameters["GPS1_POS_X"] = 1.0
    bench.hear(vehicle._packed(vehicle.parameter("GPS1_POS_X")))
    bench.run(4.0)
    for step in bench.stream_of.finish():
        bench.records += bench.stream_of.records(step)
    (tmp_path / "flight.tlog").write_bytes(b"".join(bench.log))
    replayed: list[Any] = []
    result = run(
        tmp_path / "flight.tlog",
        Options(as_live=True),
        Watch(step=lambda live, step: replayed.extend(live.records(step))),
    )
    (session,) = result.sessions
    assert session.setup == bench.setup
    assert session.setup.antenna == pytest.approx((0.2, -0.1, -0.2), abs=1e-6)
    assert len(replayed) > 500
    assert any(getattr(record, "kind", None) == "parameters_late" for record in replayed)
    # one after the other of a kind: what is published between poses is told apart by its key
    for kind in {type(record) for record in replayed}:
        assert [r for r in replayed if type(r) is kind] == [r for r in bench.records if type(r) is kind]
    offline = run(tmp_path / "flight.tlog", Options()).sessions[0].setup
    assert offline.antenna == bench.setup.antenna
    assert offline.reasons[-1].startswith("GPS1_POS_X of the autopilot's parameters came after")


NAMES, NUMBERS = (
    st.sampled_from(AutopilotParameter),
    st.one_of(st.floats(width=32), st.integers(-1100, 1100).map(float)),
)


@settings(max_examples=300, deadline=None)
@given(st.lists(st.tuples(NAMES, NUMBERS, st.integers(0, 255)), max_size=40), st.integers(0, 40))
def test_no_values_upset_the_choice_of_the_sensors(said: list[tuple[AutopilotParameter, float, int]], cut: int) -> None:
    vehicle, stream = Autopilot(), FrameStream()
    data = [
        vehicle._packed(mavlink.MAVLink_param_value_message(name.name.encode(), value, kind, 900, 0))
        for name, value, kind in said
    ]
    rows = decode(*stream.push(b"".join(data), 0)).get((1, 1), np.empty((0, ROW_WIDTH)))
    setup = choose(rows[:cut], Config())
    assert all(abs(d) <= 2 * FARTHEST for d in setup.antenna)
    assert 0.0 <= setup.gnss_delay <= LONGEST_S
    late = too_late(rows[cut:], setup.stated, Config().vehicle, setup.gnss, setup.magnetometer)
    assert set(late) <= {name.name for name, _, _ in said}
    # what has been used is not late
    known = values_of(rows[:cut])
    again = rows[:cut][[known[row[PARAMETER]] == row[PARAMETER_VALUE] for row in rows[:cut]]]
    assert not too_late(again, known, Config().vehicle, setup.gnss, setup.magnetometer)


def test_the_names_are_those_of_the_wire() -> None:
    assert all(len(name.name) <= 16 for name in AutopilotParameter)
    assert [name.value for name in AutopilotParameter] == list(range(len(AutopilotParameter)))
    assert {name for questions in QUESTIONS.values() for names in questions for name in names} == set(
        AutopilotParameter
    )
    vehicle = Autopilot(parameters=dict.fromkeys((name.name for name in AutopilotParameter), 0.5))
    stream = FrameStream()
    for name in AutopilotParameter:
        (row,) = decode(*stream.push(vehicle._packed(vehicle.parameter(name.name)), 0))[1, 1]
        assert (row[PARAMETER], row[PARAMETER_VALUE]) == (name, 0.5)
