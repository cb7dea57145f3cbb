"""Which messages the filter needs, how often, and what of it a link can carry."""

from collections.abc import Iterable
from typing import NamedTuple

from mavkf.link.layouts import MAX_LENGTH, frame_table, message_ids

OVERHEAD = 12  # bytes of a MAVLink 2 frame beside its payload
SLOWEST_HZ = 0.5  # a stream that a link cannot carry at this rate is not asked for
RAW_SENSORS, EXTENDED_STATUS, EXTRA3 = 1, 2, 12  # MAV_DATA_STREAM
GROUP_HZ = {RAW_SENSORS: 50.0, EXTENDED_STATUS: 5.0, EXTRA3: 1.0}
"""What REQUEST_DATA_STREAM asks for: whole groups, so not faster than old autopilots send any."""
GROUP_BYTES = {RAW_SENSORS: 300, EXTENDED_STATUS: 300, EXTRA3: 200}
"""About what one round of a group costs."""


class Stream(NamedTuple):
    """What the filter needs.

    messages:  any of them will do; they are asked for in this order until one is granted.
    others:    messages that do as well where they come anyhow.
    rate_hz:   how often. group: the MAV_DATA_STREAM that holds it.
    required:  whether it is missed when it does not come.
    """

    messages: tuple[str, ...]
    others: tuple[str, ...]
    rate_hz: float
    group: int
    required: bool

    @property
    def sources(self) -> tuple[str, ...]:
        """All messages that do."""
        return (*self.messages, *self.others)


STREAMS = (
    # position and velocity; receivers measure 5 to 10 times a second, and an EKF with an IMU gains little above 5
    Stream(("GPS_RAW_INT",), ("HIL_GPS",), 5.0, EXTENDED_STATUS, True),
    # what time it was on the boot clock: two clocks that drift by parts in a million
    Stream(("SYSTEM_TIME",), (), 1.0, EXTRA3, True),
    # height between fixes: a barometer's noise is nearly white at 10 Hz, and its air moves slowly
    Stream(("SCALED_PRESSURE",), ("HIGHRES_IMU", "HIL_SENSOR", "SCALED_PRESSURE2"), 10.0, RAW_SENSORS, True),
    # a second receiver, of those who have one: it takes over when the first is jammed or lies
    Stream(("GPS2_RAW",), (), 5.0, EXTENDED_STATUS, False),
    # rotation and acceleration: a copter's manoeuvres reach 10 Hz, and are integrated from 100 without loss; HIGHRES_IMU is finer
    Stream(
        ("HIGHRES_IMU", "RAW_IMU"), ("SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3", "HIL_SENSOR"), 100.0, RAW_SENSORS, True
    ),
)
"""In the order in which a link that cannot carry all serves them; the IMU takes what is left."""


def message_bytes(name: str) -> int:
    """The most bytes that a message takes on the wire."""
    return OVERHEAD + int(frame_table()[MAX_LENGTH, message_ids()[name]])


def affordable(streams: Iterable[Stream], budget: float) -> dict[Stream, float]:
    """Share out a link: the rate (Hz) of each stream that it can carry. budget: bytes a second, may be infinite."""
    rates: dict[Stream, float] = {}
    for stream in STREAMS:
        if stream in streams:
            size = message_bytes(stream.messages[0])
            rate = min(stream.rate_hz, budget / size)
            if rate >= min(SLOWEST_HZ, stream.rate_hz):
                rates[stream] = rate
                budget -= rate * size
    return rates


def affordable_groups(groups: Iterable[int], budget: float) -> dict[int, int]:
    """The rate (whole Hz) of each MAV_DATA_STREAM that a link can carry. budget: bytes a second, may be infinite."""
    rates: dict[int, int] = {}
    for group in sorted(groups, key=GROUP_HZ.__getitem__):
        rate = int(min(GROUP_HZ[group], budget / GROUP_BYTES[group]))
        if rate >= 1:
            rates[group] = rate
            budget -= rate * GROUP_BYTES[group]
    return rates
