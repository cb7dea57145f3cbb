"""Which parameters an autopilot is asked for, and when: at its first heartbeat, so that they are there when the sensors are chosen.

Who does not answer is asked again twice, later and later, and then left alone: of names that it does not have an ArduPilot says nothing, a
newer one PARAM_ERROR. What others make it say counts as well. Nothing waits for an answer.
"""

import math
from collections.abc import Callable, Iterator

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from mavkf.link.decode import Address
from mavkf.navigation.delays import ARDUPILOT, PX4
from mavkf.samples import AutopilotParameter as Name
from mavkf.service.streams import message_bytes

# After each round of questions, for its answers: all within the time in which the sensors are chosen.
ROUNDS_S = (1.0, 2.0, 1.0)
LEAST_GAP_S = 0.02  # between questions: ArduPilot's queue holds 20
BURST_S = 0.2  # of gaps that may be made up for
QUESTIONS: dict[int, tuple[tuple[Name, ...], ...]] = {
    ARDUPILOT: (
        (Name.GPS1_POS_X, Name.GPS_POS1_X),
        (Name.GPS1_POS_Y, Name.GPS_POS1_Y),
        (Name.GPS1_POS_Z, Name.GPS_POS1_Z),
        (Name.INS_POS1_X,),
        (Name.INS_POS1_Y,),
        (Name.INS_POS1_Z,),
        (Name.GPS1_DELAY_MS, Name.GPS_DELAY_MS),
        (Name.COMPASS_USE,),
        (Name.COMPASS_USE2,),
        (Name.COMPASS_USE3,),
        (Name.COMPASS_ENABLE,),
    ),
    PX4: (
        (Name.SENS_GPS0_OFFX, Name.EKF2_GPS_POS_X),
        (Name.SENS_GPS0_OFFY, Name.EKF2_GPS_POS_Y),
        (Name.SENS_GPS0_OFFZ, Name.EKF2_GPS_POS_Z),
        (Name.EKF2_IMU_POS_X,),
        (Name.EKF2_IMU_POS_Y,),
        (Name.EKF2_IMU_POS_Z,),
        (Name.SENS_GPS0_DELAY, Name.EKF2_GPS_DELAY),
        (Name.EKF2_MAG_TYPE,),
        (Name.SYS_HAS_MAG,),
    ),
}
"""By MAV_AUTOPILOT what to ask for; of each, the names that it has had, one of which is enough."""


class ParameterQuestions:
    """The questions to one autopilot. Pure: it is told what was heard and what time it is, and gives messages to send."""

    def __init__(
        self, address: Address, autopilot: int, budget: Callable[[], float], say: Callable[[str], None]
    ) -> None:
        """address, autopilot: of the autopilot, its MAV_AUTOPILOT; say: told what was read, again only where it is other.

        budget: the bytes a second that its answers may take.
        """
        self._address, self._budget, self._say = address, budget, say
        self._questions = QUESTIONS.get(autopilot, ())
        self._told = ""
        self.begin()

    def begin(self) -> None:
        """Take it that nothing is known."""
        self._values: dict[Name, float] = {}
        self._denied: set[Name] = set()
        self._next_s = -math.inf
        self._script = self._ask()
        self._is_over = False

    def heard(self, name: Name, value: float) -> None:
        """A PARAM_VALUE has come."""
        self._values[name] = value

    def denied(self, name: Name) -> None:
        """A PARAM_ERROR has come."""
        self._denied.add(name)

    def step(self, t: float) -> list[mavlink.MAVLink_message]:
        """What to ask now. Call it several times a second."""
        messages: list[mavlink.MAVLink_message] = []
        budget = self._budget()
        if self._is_over or budget <= 0.0:
            return messages
        self._next_s = max(self._next_s, t - BURST_S)
        while t >= self._next_s and not self._is_over:
            name = next(self._script, None)
            if name is None:
                self._is_over = True
            elif isinstance(name, Name):
                messages.append(mavlink.MAVLink_param_request_read_message(*self._address, name.name.encode(), -1))
                self._next_s += max(LEAST_GAP_S, message_bytes("PARAM_VALUE") / budget)
            else:
                self._next_s = t + name
        return messages

    def _ask(self) -> Iterator[Name | float]:
        """The names to ask for one by one, and the seconds to wait in between."""
        for wait in ROUNDS_S:
            for names in self._questions:
                for name in names:
                    if name not in self._denied and not self._has_answer(names):
                        yield name
            if not all(map(self._has_answer, self._questions)):
                yield wait
            self._tell()
            if all(map(self._has_answer, self._questions)):
                return

    def _has_answer(self, names: tuple[Name, ...]) -> bool:
        return any(name in self._values for name in names) or self._denied.issuperset(names)

    def _tell(self) -> None:
        text = ", ".join(f"{name.name} {value:.6g}" for name, value in sorted(self._values.items()))
        if text and text != self._told:
            self._say(f"its parameters say {text}")
            self._told = text
