"""When the statuses of a vehicle come."""

import numpy as np
import pytest

from mavkf.config import Config
from mavkf.estimate import Status
from mavkf.link.decode import decode
from mavkf.link.framing import FrameStream
from mavkf.samples import ARRIVAL
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
