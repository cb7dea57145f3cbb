"""Sensors as they are bought: ranges of their errors by datasheets, and a set of sensors drawn from them.

A range goes from the best to the worst of the parts that autopilots carry; a draw is uniform in the logarithm. A figure with the number of
its document was compared with that; of the others none was at hand: they are typical of their class.
"""

import math

from numpy.random import Generator

from mavkf.replay.simulation.sensors import SensorNoise

MILLI_DPS, MICRO_G = math.radians(1e-3), 9.80665e-6
CEP = 1.1774  # radius that holds half of a circular normal distribution, in sigmas of an axis

RANGES = {
    # TDK ICM-42688-P (DS-000347): 2.8 mdps/sqrt(Hz), 70 ug/sqrt(Hz). InvenSense MPU-6000 (PS-MPU-6000A-00, 6.1 and 6.2): 5 mdps/sqrt(Hz)
    # and 400 ug/sqrt(Hz), both at 10 Hz. Bosch gyros such as that of the BMI088: 14 mdps/sqrt(Hz), typical of their class.
    "gyro_density": (2.8 * MILLI_DPS, 14.0 * MILLI_DPS),
    "accel_density": (70.0 * MICRO_G, 400.0 * MICRO_G),
    # no part's but the frame's: what its motors shake through the mounting
    "gyro_vibration": (2e-4, 1e-3),
    "accel_vibration": (4e-3, 2e-2),
    # what the calibrations at boot and at set-up leave
    "gyro_bias": (5e-4, 2e-3),
    "accel_bias": (0.015, 0.06),
    "gyro_walk": (3e-6, 3e-5),
    "accel_walk": (3e-5, 3e-4),
    # from magneto-inductive ones (PNI RM3100: some 15 nT) to those with counts of 0.3 uT (iSentek IST8310): typical of their class
    "magnetometer_noise": (1.5e-8, 3e-7),
    "hard_iron": (2e-7, 1e-6),
    # TE MS5611-01BA03 (data sheet, table of sensor performances): resolution of 0.012 mbar at an oversampling of 4096, 0.027 mbar at 1024
    "baro_noise": (1.2, 2.7),
    # its temperature, air that flows past it, and the weather
    "baro_drift": (3.0, 12.0),
    "baro_time_constant": (100.0, 400.0),
    "gnss_horizontal": (0.05, 0.2),
    # u-blox M8 and its like: 2.5 m CEP over a day, typical of their class; in a good hour a quarter of it
    "gnss_drift_horizontal": (2.5 / CEP / 4.0, 2.5 / CEP),
    "gnss_time_constant": (30.0, 120.0),
    # 0.05 m/s, half of the time (the same receivers)
    "gnss_speed_horizontal": (0.05 / CEP, 3.0 * 0.05 / CEP),
    # as long as receivers smooth their velocity
    "gnss_speed_time_constant": (0.1, 0.6),
    "gnss_claim": (0.7, 1.4),
}
VERTICAL = (1.2, 1.8)  # vertical errors of GNSS over horizontal ones


def draw_noise(rng: Generator) -> SensorNoise:
    """Draw the errors of all sensors of a vehicle."""

    def between(low: float, high: float) -> float:
        return low * math.exp(math.log(high / low) * float(rng.random()))

    drawn = {name: between(*limits) for name, limits in RANGES.items()}
    ratio = between(*VERTICAL)
    return SensorNoise(
        **drawn,
        gnss_vertical=ratio * drawn["gnss_horizontal"],
        gnss_drift_vertical=ratio * drawn["gnss_drift_horizontal"],
        gnss_speed_vertical=ratio * drawn["gnss_speed_horizontal"],
    )
