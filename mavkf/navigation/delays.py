"""How old the sensors' values are when an autopilot sends them, as far as it is known."""

ARDUPILOT, PX4 = 3, 12  # MAV_AUTOPILOT
# Delays of ArduPilot, s. GNSS: a fix is stamped at reception (AP_GPS), measured on its simulator and near u-blox's; IMU: two-pole
# low-pass at 20 Hz (INS_ACCEL_FILTER, INS_GYRO_FILTER); magnetometer and barometer: sampled slower than sent, and held.
DELAYS = {
    ARDUPILOT: {"gnss": 0.085, "imu": 0.0125, "magnetometer": 0.055, "barometer": 0.045},
    # PX4 stamps at measurement and removes its own delays, but averages magnetometer and barometer and holds them between its updates.
    PX4: {"gnss": 0.0, "imu": 0.0, "magnetometer": 0.05, "barometer": 0.0},
}
NO_DELAYS = {"gnss": 0.0, "imu": 0.0, "magnetometer": 0.0, "barometer": 0.0}
