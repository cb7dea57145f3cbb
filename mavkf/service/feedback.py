"""The estimate back to the vehicle, or to another endpoint, as ODOMETRY; off unless asked for."""

from collections import Counter
from collections.abc import Callable, Sequence

from mavkf.estimate import Event, Pose, Record
from mavkf.link.decode import Address
from mavkf.publish.odometry import odometry
from mavkf.service.talk import Talk

RATE_HZ = 20.0
"""Of boot time: enough for the autopilots, which want 4 Hz at least, at 5 kB/s."""
JUMPS = ("position_reset", "velocity_reset", "position_found", "reboot", "reset", "forgotten")


class Feedback:
    """Takes what is published of each vehicle, and sends its poses on."""

    def __init__(self, talks: Sequence[Talk], to_vehicle: bool, say: Callable[[str], None]) -> None:
        """talks: over what is sent; to_vehicle: only where that vehicle is heard."""
        self._talks, self._to_vehicle = talks, to_vehicle
        self._resets: Counter[Address] = Counter()
        self._sent: dict[Address, tuple[int, float]] = {}  # session and time, s
        say(
            "ODOMETRY is sent: it rests on the vehicle's own GNSS, so an autopilot that fuses that as well counts it twice; "
            "let it fuse one of them only"
        )

    def take(self, address: Address, record: Record) -> None:
        """Take a record that was published of a vehicle."""
        if isinstance(record, Event):
            self._resets[address] += record.kind in JUMPS
        elif isinstance(record, Pose) and record.t_boot_s is not None:
            session, t = self._sent.get(address, (-1, 0.0))
            if session == record.session and record.t_boot_s - t < 1.0 / RATE_HZ - 1e-6:
                return
            message = odometry(record, self._resets[address])
            if message is None:
                return
            self._sent[address] = record.session, record.t_boot_s
            for talk in self._talks:
                if not self._to_vehicle or address in talk.conversations:
                    talk.tell(message, address)
