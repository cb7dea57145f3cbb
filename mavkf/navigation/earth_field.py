"""The earth's magnetic field at a fix, from the World Magnetic Model (pygeomag): a fact that depends on the fix alone.

Position is rounded to 0.1 deg and the date to a day, so that the same fix gives the same field to the last bit, live and offline.
"""

import math
from datetime import datetime
from functools import lru_cache

from pygeomag import GeoMag

DAY_US = 86_400_000_000
DAYS_PER_YEAR = 365.25
FIRST_YEAR, LAST_YEAR = 2010.0, 2030.0  # of the models that pygeomag carries
NANOTESLA = 1e-9


@lru_cache(maxsize=8)
def _model(base_year: int) -> GeoMag:
    return GeoMag(base_year=datetime(base_year, 1, 1))


@lru_cache(maxsize=4096)
def _field(latitude_tenths: int, longitude_tenths: int, day: int) -> tuple[float, float, float]:
    # a log whose clock was never set is dated 1970: the nearest model is the best guess for its field
    year = min(max(1970.0 + day / DAYS_PER_YEAR, FIRST_YEAR), LAST_YEAR - 1e-3)
    result = _model(int(year // 5) * 5).calculate(latitude_tenths / 10.0, longitude_tenths / 10.0, 0.0, year, True)
    return NANOTESLA * result.x, NANOTESLA * result.y, NANOTESLA * result.z


def earth_field(latitude: float, longitude: float, utc_us: float) -> tuple[float, float, float]:
    """The field (tesla; north, east, down) at a position (rad) at sea level on the day of a time (microseconds UTC).

    NaN where the position is not a position.
    """
    if not (abs(latitude) <= 0.5 * math.pi and abs(longitude) <= 2.0 * math.pi and math.isfinite(utc_us)):
        return (math.nan, math.nan, math.nan)
    return _field(round(math.degrees(latitude) * 10.0), round(math.degrees(longitude) * 10.0), int(utc_us // DAY_US))
