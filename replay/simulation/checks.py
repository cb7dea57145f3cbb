"""What can be flown, and where it can be written."""

import math
from pathlib import Path
from typing import BinaryIO

from mavkf.errors import UsageError


def create(path: Path) -> BinaryIO:
    """Open the file to write. Raises UsageError."""
    if path.is_dir():
        raise UsageError(f"{path} is a folder; name the file to write, such as {path / 'flight.tlog'}")
    try:
        return path.open("wb")
    except OSError as error:
        raise UsageError(f"{path} cannot be written ({error.strerror}); name a file in an existing folder") from None


def check(
    *,
    seed: int,
    duration_s: float,
    vehicle: str,
    imu_hz: float,
    gnss_hz: float,
    gnss_message_hz: float,
    gnss_delay: float,
    start: tuple[float, float, float, float],
    address: tuple[int, int],
) -> None:
    """Raise UsageError, naming the option of the command line, for a value that cannot be flown."""
    latitude, longitude, height, heading = start
    for good, option, value, right in (
        (seed >= 0, "--seed", seed, "0 or more"),
        (60.0 <= duration_s <= 86400.0, "--duration", duration_s, "60 s (take-off, flight, landing) to 86400 s"),
        (vehicle in ("copter", "plane"), "--vehicle", vehicle, "copter or plane"),
        (1.0 <= imu_hz <= 400.0, "--imu-hz", imu_hz, "1 to 400 Hz"),
        (0.2 <= gnss_hz <= 20.0, "--gnss-hz", gnss_hz, "0.2 to 20 Hz"),
        (0.2 <= gnss_message_hz <= 50.0, "gnss_message_hz", gnss_message_hz, "0.2 to 50 Hz"),
        (0.0 <= gnss_delay <= 1.0, "--gnss-delay", gnss_delay, "0 to 1 s"),
        (abs(latitude) <= 85.0, "--lat", latitude, "-85 to 85 degrees"),
        (abs(longitude) <= 180.0, "--lon", longitude, "-180 to 180 degrees"),
        (-500.0 <= height <= 8000.0, "--alt", height, "-500 to 8000 m above sea level"),
        (math.isfinite(heading), "--heading", heading, "degrees from north"),
        (all(1 <= part <= 255 for part in address), "--system-id", address[0], "1 to 255"),
    ):
        if not good:
            raise UsageError(f"{option} is {value}, but must be {right}")
