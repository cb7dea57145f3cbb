"""What comes of a replay."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mavkf.link.clocks import ClockCounts
from mavkf.link.framing import FrameCounts
from mavkf.navigation.estimator import Output
from mavkf.navigation.setup import Setup
from mavkf.replay.tally import Tally

if TYPE_CHECKING:
    from mavkf.navigation.any_form import FormRun

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SessionResult:
    """What came of one session of one vehicle.

    tally: what its rows and outputs were; counts: what the fold counted; state: of the fold at the end (STATE_SIZE,); parameters: what
    it was told (PARAMETERS,); hindsight: what smoothing made of the flight, in words; form: what another form and order cost, where they
    made the pose rows. rows, output: its timed sample rows (n, ROW_WIDTH), in the order of arrival, and all that the fold wrote; both
    without rows where they were not to be kept.
    """

    vehicle: str
    session: int
    setup: Setup
    tally: Tally
    rows: Array
    output: Output
    counts: dict[str, int]
    state: Array
    parameters: Array
    hindsight: tuple[str, ...] = ()
    form: "FormRun | None" = None


@dataclass(frozen=True)
class Result:
    """A replayed log: its name, bytes and damage; its sessions by vehicle, the counts of each vehicle's clock, and the seconds of work.

    read_s: reading and putting in order, which another thread does meanwhile; total_s: all of it.
    """

    log: str
    size: int
    damage: FrameCounts
    sessions: list[SessionResult]
    clocks: dict[str, ClockCounts]
    read_s: float
    total_s: float
