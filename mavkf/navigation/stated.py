"""What the autopilot's own parameters state of its sensors, as far as it was heard in time and the user has not set it otherwise.

Names, units, ranges and the meaning of 0: ArduPilot's AP_GPS_Params.cpp, AP_GPS.cpp (get_lag), AP_InertialSensor.cpp and AP_Compass.cpp,
PX4's params_gnss.yaml, params_magnetometer.yaml, ekf2_params.c and VehicleGPSPosition (sensors). Places are metres in b from an origin
of the autopilot's (the centre of gravity, as a rule); delays are milliseconds by which a fix is older than its stamp.
"""

from collections.abc import Container, Iterable, Iterator, Mapping

import msgspec
import numpy as np
from numpy.typing import NDArray

from mavkf.config import Vehicle
from mavkf.samples import IMU_SOURCES, KIND, PARAMETER, PARAMETER_VALUE, Kind, Source
from mavkf.samples import AutopilotParameter as Name

Place = tuple[float, float, float]
Values = Mapping[int, float]

FARTHEST = 5.0  # m along an axis: the range that ArduPilot gives them
LONGEST_S = 1.0
GNSS_PLACES = (
    (Name.GPS1_POS_X, Name.GPS1_POS_Y, Name.GPS1_POS_Z),
    (Name.GPS_POS1_X, Name.GPS_POS1_Y, Name.GPS_POS1_Z),
    (Name.SENS_GPS0_OFFX, Name.SENS_GPS0_OFFY, Name.SENS_GPS0_OFFZ),
    (Name.EKF2_GPS_POS_X, Name.EKF2_GPS_POS_Y, Name.EKF2_GPS_POS_Z),
)
IMU_PLACES = (
    (Name.INS_POS1_X, Name.INS_POS1_Y, Name.INS_POS1_Z),
    (Name.EKF2_IMU_POS_X, Name.EKF2_IMU_POS_Y, Name.EKF2_IMU_POS_Z),
)
DELAYS = (
    # 0 is the receiver driver's own, which is not told
    (Name.GPS1_DELAY_MS, False),
    (Name.GPS_DELAY_MS, False),
    (Name.SENS_GPS0_DELAY, True),
    (Name.EKF2_GPS_DELAY, True),
)
"""The delays, each with whether 0 is a delay."""
COMPASSES = {
    Name.COMPASS_USE: (Source.RAW_IMU, Source.SCALED_IMU, Source.HIGHRES_IMU, Source.HIL_SENSOR),
    Name.COMPASS_USE2: (Source.SCALED_IMU2,),
    Name.COMPASS_USE3: (Source.SCALED_IMU3,),
    Name.COMPASS_ENABLE: IMU_SOURCES,
    Name.SYS_HAS_MAG: IMU_SOURCES,
}
"""Where 0 stands in a parameter, the compass in these messages is not used by the autopilot."""
NO_MAGNETOMETER = 5
"""EKF2_MAG_TYPE of a PX4 that uses none."""


class Stated(msgspec.Struct, frozen=True, kw_only=True):
    """What is stated; None or empty where nothing is.

    antenna: of the first receiver, m from the IMU in b; gnss_delay: of its fixes, s; compasses_off: messages whose magnetometer the
    autopilot does not use, and the parameter that says so; reasons: place and delay in words, and what of them was not believed.
    """

    antenna: Place | None = None
    gnss_delay: float | None = None
    compasses_off: dict[Source, Name] = {}
    reasons: tuple[str, ...] = ()


def values_of(rows: NDArray[np.float64]) -> dict[int, float]:
    """The last value of each parameter in rows (n, ROW_WIDTH)."""
    mine = rows[rows[:, KIND] == Kind.PARAMETER]
    return {int(name): value for name, value in mine[:, [PARAMETER, PARAMETER_VALUE]].tolist()}


def stated(values: Values, vehicle: Vehicle, receiver: Source) -> Stated:
    """What parameters state of what the user's settings leave open. receiver: that is used; they tell of the first only."""
    reasons: list[str] = []
    is_first = receiver is not Source.GPS2_RAW
    antenna = _antenna(values, reasons) if vehicle.gnss_antenna_b_m is None and is_first else None
    delay = _delay(values, reasons) if vehicle.gnss_delay_s is None and is_first else None
    off = _compasses_off(values) if vehicle.use_magnetometer is None else {}
    return Stated(antenna=antenna, gnss_delay=delay, compasses_off=off, reasons=tuple(reasons))


def too_late(
    rows: NDArray[np.float64], used: Values, vehicle: Vehicle, receiver: Source, compass: Source | None
) -> list[str]:
    """The names, for each row, of parameters that came after the choice and would have changed it.

    rows: (n, ROW_WIDTH) that came since; used: what had come before; receiver, compass: that were chosen.
    """
    mine = rows[rows[:, KIND] == Kind.PARAMETER]
    if not len(mine):
        return []
    chosen = stated(used, vehicle, receiver)

    def matters(name: Name, value: float) -> bool:
        # of a place the other axes may come later still
        axes = next((place for place in (*GNSS_PLACES, *IMU_PLACES) if name in place), ())
        new = stated({axis: 0.0 for axis in axes} | dict(used) | {name: value}, vehicle, receiver)
        concerned = {compass, *chosen.compasses_off}
        return (new.antenna, new.gnss_delay) != (
            chosen.antenna,
            chosen.gnss_delay,
        ) or concerned & new.compasses_off.keys() != concerned & chosen.compasses_off.keys()

    news = ((Name(int(name)), value) for name, value in mine[:, [PARAMETER, PARAMETER_VALUE]].tolist())
    return [name.name for name, value in news if used.get(name) != value and matters(name, value)]


def late_words(names: Iterable[str]) -> str:
    """That parameters came too late, in a sentence."""
    return (
        f"{', '.join(dict.fromkeys(names))} of the autopilot's parameters came after the sensors had been chosen: "
        "not used in this session"
    )


def _place(places: tuple[tuple[Name, ...], ...], values: Values, reasons: list[str]) -> Place | None:
    """The first place that is known in all its axes, and can be one."""
    for axes in places:
        if all(axis in values for axis in axes):
            if all(abs(values[axis]) <= FARTHEST for axis in axes):
                return values[axes[0]], values[axes[1]], values[axes[2]]
            far = max(axes, key=lambda axis: abs(values[axis]))
            reasons.append(
                f"{far.name} of the autopilot's parameters is not used: {values[far]:g} m is farther than {FARTHEST:g} m"
            )
            return None
    return None


def _antenna(values: Values, reasons: list[str]) -> Place | None:
    """The lever arm, unless both ends are at the origin: nobody has measured them."""
    gnss = _place(GNSS_PLACES, values, reasons)
    if gnss is None:
        return None
    imu = _place(IMU_PLACES, values, reasons) or (0.0, 0.0, 0.0)
    if not any(gnss) and not any(imu):
        return None
    # a float of the wire has seven digits
    arm = (round(gnss[0] - imu[0], 6), round(gnss[1] - imu[1], 6), round(gnss[2] - imu[2], 6))
    reasons.append(f"GNSS antenna {place_words(arm)}: from the autopilot's parameters")
    return arm


def place_words(arm: Place) -> str:
    """A place (m in b) from the IMU, in words."""
    words = (("ahead of", "behind"), ("right of", "left of"), ("below", "above"))
    parts = [f"{abs(d):.3g} m {pair[d < 0.0]}" for d, pair in zip(arm, words, strict=True) if d]
    return f"{', '.join(parts) or 'at'} the IMU"


def _delay(values: Values, reasons: list[str]) -> float | None:
    for name, zero_is_one in DELAYS:
        if name not in values or (values[name] == 0.0 and not zero_is_one):
            continue
        delay = values[name] * 1e-3
        if 0.0 <= delay <= LONGEST_S:
            reasons.append(f"GNSS delay {delay:.3g} s: from the autopilot's parameters")
            return delay
        reasons.append(f"{name.name} of the autopilot's parameters is not used: {values[name]:g} ms is no delay")
        return None
    return None


def _compasses_off(values: Values) -> dict[Source, Name]:
    off = {source: name for name, sources in COMPASSES.items() if values.get(name) == 0.0 for source in sources}
    if values.get(Name.EKF2_MAG_TYPE) == NO_MAGNETOMETER:
        off |= dict.fromkeys(IMU_SOURCES, Name.EKF2_MAG_TYPE)
    return off


def compass_words(off: Mapping[Source, Name], present: Container[Source]) -> Iterator[str]:
    """Which of the magnetometers that are present are not used and why, in sentences."""
    for source, name in off.items():
        if source in present:
            yield (
                f"the magnetometer of {source.name} is not used, as the autopilot does not either ({name.name}); "
                "vehicle.use_magnetometer=true uses it"
            )
