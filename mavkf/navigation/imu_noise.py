"""What the samples of an IMU show of their own noise, and of what the vehicle does between them."""

import math

from mavkf.compiled import kernel
from mavkf.navigation import layout as L
from mavkf.navigation.disturbances import MADE_UP_AFTER
from mavkf.navigation.parameter import Parameter
from mavkf.navigation.propagation import COAST_RATE, roaming
from mavkf.samples import ACCEL_RESOLUTION, GYRO, GYRO_RESOLUTION
from mavkf.stack import zero_vector

DIFFERENCE_TIME = 20.0  # s: memory of how restless the samples are
SMOOTHNESS = 1e-10  # of the usual variance of second differences: what the digits of a log leave of a line
MOVES, TURNS = 0.3, 0.03  # m/s, rad/s


@kernel
def unseen_share(square, product):
    """Variance of what a trapezoid of two samples misses, in squares of dt times the mean squared difference of samples.

    square: mean squared difference of successive samples; product: mean product of successive differences. Three signals tell
    themselves apart by the correlation rho of the differences. White noise (rho = -1/2; vibration) of variance s^2 makes differences of
    2 s^2 and is integrated as it is: 1/2. A random walk (rho = 0) leaves a Brownian bridge, of variance 1/12 (Karatzas and Shreve,
    "Brownian Motion and Stochastic Calculus", section 5.6). A smooth signal (rho to 1) leaves less and less.
    """
    if not square > 0.0:
        return 0.0
    rho = min(max(product / square, -0.5), 1.0)
    if rho < 0.0:
        return -rho + (1.0 + 2.0 * rho) / 12.0
    return (1.0 - rho) / 12.0


@kernel
def follow_smoothness(s, e, second):
    """Count the samples in a row that lie on a line with the two before, given the squares (2,) of the second differences of now.

    Those of real samples have the variance 2 (D - T) by the mean squares D and products T of first differences. Samples without any of
    it have been repeated or interpolated: somebody has filled a gap with them. (A simulated IMU may
    have no noise, and stand still, while the vehicle rolls along.)
    """
    smooth = True
    for k in range(2):
        usual = 2.0 * (s[L.DIFFERENCE_GYRO + k] - s[L.TURN_GYRO + k])
        smooth = smooth and second[k] < SMOOTHNESS * usual and usual > (2.0 * e[GYRO_RESOLUTION + k]) ** 2
    runs, turns = False, False
    for i in range(6):
        runs = runs or s[L.LAST_DIFFERENCE + i] != 0.0
        turns = turns or (i < 3 and abs(s[L.IMU + i]) > TURNS)
    moves = turns or (runs and s[L.GNSS_SPEED] ** 2 + s[L.GNSS_SPEED + 1] ** 2 > MOVES**2)
    s[L.SMOOTH] = s[L.SMOOTH] + 1.0 if smooth and moves else 0.0


@kernel
def watch_samples(s, e, c, imu, dt):
    """Noise densities in use from how much successive samples differ: what happens between them is not seen.

    dt times the larger of now and the 20 s average of the squared differences, times the `unseen_share` of each sensor, plus the
    rounding to whole counts. Returns the squared differences of now, gyro and accelerometer, per axis.
    """
    square = zero_vector(2)
    product = zero_vector(2)
    last_square = zero_vector(2)
    for i in range(6):
        difference = imu[i] - s[L.IMU + i]
        square[i // 3] += difference * difference / 3.0
        last_square[i // 3] += s[L.LAST_DIFFERENCE + i] ** 2 / 3.0
        product[i // 3] += difference * s[L.LAST_DIFFERENCE + i] / 3.0
        s[L.LAST_DIFFERENCE + i] = difference
    weight = 1.0 - math.exp(-dt / DIFFERENCE_TIME)
    for k in range(2):
        last_square[k] += square[k] - 2.0 * product[k]
    follow_smoothness(s, e, last_square)
    for k in range(2):
        s[L.DIFFERENCE_GYRO + k] += weight * (square[k] - s[L.DIFFERENCE_GYRO + k])
        s[L.TURN_GYRO + k] += weight * (product[k] - s[L.TURN_GYRO + k])
        s[L.SQUARE_GYRO + k] = square[k]
        share = unseen_share(s[L.DIFFERENCE_GYRO + k], s[L.TURN_GYRO + k])
        unseen = share * max(square[k], s[L.DIFFERENCE_GYRO + k])
        resolution = e[GYRO_RESOLUTION + k]
        s[L.NOISE_GYRO + k] = c[Parameter.GYRO + k] ** 2 + dt * (
            c[Parameter.SAMPLING] * s[L.SCALE_IMU] * unseen + resolution * resolution / 12.0
        )
    if s[L.SMOOTH] >= MADE_UP_AFTER:
        s[L.NOISE_GYRO] += COAST_RATE**2
        s[L.NOISE_ACCEL] += roaming(c)
    return square[0], square[1]


@kernel
def untruncated(e, c, imu):
    """Fill imu (6,) with the sample; values that were cut off toward zero to whole counts are half a count larger in the mean."""
    for i in range(6):
        value = e[GYRO + i]
        count = c[Parameter.TRUNCATION] * (e[GYRO_RESOLUTION] if i < 3 else e[ACCEL_RESOLUTION])
        if value > 0.0:
            value += 0.5 * count
        elif value < 0.0:
            value -= 0.5 * count
        imu[i] = value
