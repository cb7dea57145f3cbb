"""What each part of the filter is worth: the errors on a few telling flights without it."""

from typing import Any

from benchmarks.accuracy.common import Settings, cell, head, row, say
from benchmarks.accuracy.flights import FLIGHTS, measure
from mavkf.config import settings as known_settings
from mavkf.config import with_settings

TELLING = ("ap01", "ap02", "ap04b", "ap05", "ap07")
COLUMNS = ("horizontal_m", "tilt_deg", "yaw_deg")
INGREDIENTS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("everything", ()),
    ("no GNSS delay at all", ("vehicle.gnss_delay_s=0.0", "noise.gnss_delay_initial_s=0.0")),
    ("GNSS delay to be found from nothing", ("vehicle.gnss_delay_s=0.0", "noise.gnss_delay_initial_s=0.1")),
    ("GNSS delay fixed at its nominal value", ("noise.gnss_delay_initial_s=0.0",)),
    ("no lingering GNSS error", ("noise.gnss_colour=0.0", "noise.gnss_colour_vertical=0.0")),
    ("no IMU delay", ("vehicle.imu_delay_s=0.0",)),
    ("no magnetometer delay", ("vehicle.magnetometer_delay_s=0.0",)),
    ("no barometer delay", ("vehicle.barometer_delay_s=0.0",)),
    ("IMU noise not adapted to the samples", ("noise.sampling=0.0",)),
    ("low floor of the GNSS velocity", ("noise.gnss_speed_floor_m_s=0.03",)),
    ("no standing still", ("vehicle.use_rest=false",)),
    ("no yaw from motion", ("vehicle.use_motion_yaw=false",)),
    ("no magnetometer", ("vehicle.use_magnetometer=false",)),
    ("no barometer", ("vehicle.use_barometer=false",)),
    ("no telemetry model", ("model.telemetry=false",)),
    ("no knowledge of the vehicle's class", ("vehicle.use_class=false",)),
)
"""Name, and the settings that leave it out; one whose key does not exist (yet) is passed over."""


def run(settings: Settings) -> list[dict[str, Any]]:
    """Leave out one after the other, and print the table."""
    flights = [flight for flight in FLIGHTS if flight.name in TELLING]
    known = {name for name, _, _ in known_settings()}
    head("ingredients: horizontal m / tilt deg / yaw deg", ("without", *(flight.name for flight in flights)))
    results = []
    for name, assignments in INGREDIENTS:
        missing = [each for each in assignments if each.split("=")[0] not in known]
        if missing:
            say(f"{name}: passed over, no setting {', '.join(missing)}")
            continue
        config = with_settings(settings.config, assignments)
        found = {flight.name: measure(settings.folder, flight, config, settings.as_live) for flight in flights}
        results.append({"without": name, "settings": assignments, "flights": found})
        row(name, *(" / ".join(cell(found[f.name]["rms"][q]) for q in COLUMNS) for f in flights))
    return results
