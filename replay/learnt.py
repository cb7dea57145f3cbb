"""What the filter has learnt of slow errors in a flight, against what it was told to expect: a wrong delay, a bias, a wrong noise.

An estimated error is weighed by its prior: the sigma it began with and the walk it was allowed since, and what is uncertain about it now.
One that is more than BOUND of those away was not to be expected.
"""

import math
from dataclasses import dataclass

import numpy as np

from mavkf.models.strapdown import BA, BG, DBA, DBG, DDELAY, DELAY, DIRON, IRON
from mavkf.navigation import layout as L
from mavkf.navigation.learning import MOST_SCALE
from mavkf.navigation.parameter import Parameter
from mavkf.replay.results import SessionResult

BOUND = 3.29  # sigma: an axis of a right filter is farther away with a probability of 1e-3 (normal, two-sided)
AT_LIMIT = 0.8  # of the largest learnt variance


@dataclass(frozen=True)
class Learnt:
    """One slow error: name; value in a unit, and its sigma now; expected: one sigma before the flight; sentence: None if as expected."""

    name: str
    unit: str
    value: float
    sigma: float
    expected: float
    sentence: str | None


def learnt(session: SessionResult) -> list[Learnt]:
    """The slow errors that a session ended with; none without a position, which is what they are seen by."""
    s = session.state
    if not s[L.POSITION_KNOWN] or s[L.MODEL] == L.CONSTANT_VELOCITY:
        return []
    c = session.parameters
    flown = session.tally.flown_s
    nominal = session.setup.gnss_delay
    delay = s[DELAY]
    return [
        _weigh(
            session,
            "GNSS delay",
            ("s", 1.0),
            (DELAY, DDELAY, 1),
            (c[Parameter.DELAY], c[Parameter.DELAY_WALK] * math.sqrt(flown)),
            f"fixes are {abs(delay):.2f} s {'older' if delay > 0.0 else 'younger'} than the delay of {nominal:g} s in use: "
            f"set vehicle.gnss_delay_s={max(nominal + delay, 0.0):.2f}",
        ),
        _weigh(
            session,
            "gyro bias",
            ("deg/s", math.degrees(1.0)),
            (BG, DBG, 3),
            (c[Parameter.GYRO_BIAS], c[Parameter.GYRO_WALK] * math.sqrt(flown * max(s[L.SCALE_WALK], 1.0))),
            "the gyro is worse than noise.gyro_bias_initial says: calibrate it, or look for vibration",
        ),
        _weigh(
            session,
            "accelerometer bias",
            ("m/s^2", 1.0),
            (BA, DBA, 3),
            (c[Parameter.ACCEL_BIAS], c[Parameter.ACCEL_WALK] * math.sqrt(flown)),
            "more than noise.accelerometer_bias_initial says: calibrate the accelerometer, or look for vibration",
        ),
        _weigh(
            session,
            "vehicle's magnetic field",
            ("microtesla", 1e6),
            (IRON, DIRON, 3),
            (c[Parameter.IRON], 0.0),
            "more than a calibration leaves: calibrate the compass, and look for iron and currents near it",
        ),
        *_noise(session),
    ]


def _weigh(
    session: SessionResult,
    name: str,
    unit: tuple[str, float],
    place: tuple[int, int, int],
    prior: tuple[float, float],
    remedy: str,
) -> Learnt:
    """The component farthest out. unit: its name, and how many of it are one inside; place: in x, in dx, how many; prior: sigma, walk."""
    first, error, count = place
    values = session.state[first : first + count]
    k = int(np.argmax(np.abs(values)))
    value, expected = float(values[k]), math.hypot(*prior)
    sigma = math.sqrt(max(float(L.covariance(session.state)[error + k, error + k]), 0.0))
    text, scale = unit
    sentence = None
    if abs(value) > BOUND * math.hypot(expected, sigma):
        where = f" along {'xyz'[k]}" if count > 1 else ""
        sentence = f"{name}{where} learnt as {scale * value:+.2g} {text}, {abs(value) / expected:.0f} times the sigma expected: {remedy}"
    return Learnt(name, text, scale * value, scale * sigma, scale * expected, sentence)


def _noise(session: SessionResult) -> list[Learnt]:
    """Noise that is learnt as a factor on what is set, where the factor is at the end of its range."""
    found = []
    for sensor, slot, setting in (
        ("barometer", L.SCALE_BARO, "noise.barometer_m"),
        ("magnetometer", L.SCALE_FIELD, "noise.magnetometer_t"),
    ):
        scale = float(session.state[slot])
        factor = math.sqrt(max(scale, 0.0))
        sentence = None
        if scale >= AT_LIMIT * MOST_SCALE:
            sentence = f"{sensor} noise learnt as {factor:.0f} times {setting}, the most it is let grow: set {setting} to what it is"
        found.append(Learnt(f"{sensor} noise", f"times {setting}", factor, math.nan, 1.0, sentence))
    return found
