"""When the statuses of a vehicle come."""

import numpy as np
import pytest

from mavkf.config import Config
from mavkf.estimate import Record, Status
from mavkf.link.decode import decode
from mavkf.link.framing import FrameStream
from mavkf.publish.records import name_of
from mavkf.samples import ARRIVAL, CLOCK, KIND, STAMP, UNIX_US, Clock, Kind
from mavkf.service.vehicle import VehicleStream
from mavkf.service.warmup import BEGIN_US, flight


def status_times(arrival_us: float, pieces: int) -> list[float]:
    """Boot times of the statuses of a flight that is heard from a time on."""
    data, frames = FrameStream().push(b"".join(frame for _, frame in flight()), BEGIN_US, last=True)
    rows = decode(data, frames)[1, 1]
    rows[:, ARRIVAL] += arrival_us
    stream = VehicleStream("1-1", Config())
    steps = [step for piece in np.array_split(rows, pieces) for step in stream.push(piece)]
    return [step.status.t_boot_s for step in steps if isinstance(step.status, Status) and step.status.t_boot_s]


@pytest.mark.parametrize("arrival_us", [0, 1, 777, np.nan])
def test_a_status_comes_once_a_second_however_the_rows_are_cut(arrival_us: float) -> None:
    times = status_times(arrival_us, 1)
    assert len(times) >= 10
    np.testing.assert_allclose(np.diff(times), 1.0, atol=0.021)
    assert status_times(arrival_us, 333) == times


def test_those_of_a_fleet_that_was_switched_on_together_are_spread_over_the_second() -> None:
    phases = sorted(status_times(200 * k, 1)[0] % 1.0 for k in range(20))
    assert np.diff([*phases, phases[0] + 1.0]).max() < 0.2


def test_the_utc_of_a_pose_is_by_what_was_known_then_however_the_rows_are_cut() -> None:
    """The vehicle's reports of the time come in the midst of a second, and each is a little better than those before."""
    data, frames = FrameStream().push(b"".join(frame for _, frame in flight()), BEGIN_US, last=True)
    rows = decode(data, frames)[1, 1]
    rng = np.random.default_rng(1)
    clock = rows[rows[:, KIND] == Kind.SYSTEM_TIME][0]
    made = []
    for k, row in enumerate(rows):
        made.append(row)
        if k % 37 == 20 and row[CLOCK] == Clock.BOOT_US:
            report = clock.copy()
            report[STAMP], report[CLOCK] = row[STAMP], row[CLOCK]
            report[UNIX_US] = BEGIN_US + row[STAMP] - rng.integers(0, 20_000)
            made.append(report)
    table = np.array(made)

    def records(size: int) -> dict[str, list[Record]]:
        """By key: what is on one key comes in order."""
        stream, found = VehicleStream("1-1", Config()), dict[str, list[Record]]()
        parts = [table[first : first + size] for first in range(0, len(table), size)]
        steps = (step for work in (*map(stream.push, parts), stream.finish()) for step in work)
        for step in steps:
            for record in stream.records(step):
                found.setdefault(name_of(record), []).append(record)
        return found

    whole = records(len(table))
    offsets = {pose.utc_ns - round(pose.t_boot_s * 1e9) for pose in whole["pose"] if pose.utc_ns and pose.t_boot_s}
    assert len(offsets) > 5
    assert records(1) == whole
    assert records(7) == whole
