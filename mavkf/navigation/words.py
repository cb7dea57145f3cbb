"""Events in words: for each code its evidence by name, and one sentence for people."""

import math
from typing import Any

from mavkf.navigation import layout as L
from mavkf.navigation.codes import FAULT_CODES, NoteCode
from mavkf.samples import Source


def words(code: NoteCode, start: float, end: float, size: float, a: float, b: float) -> tuple[dict[str, Any], str]:
    """Evidence and one sentence of a note, by its columns; end: NaN where it still lasts."""
    if code in FAULT_CODES:
        evidence, what = _fault(code, size, a, b)
        if not math.isfinite(end):
            return evidence, what
        return evidence, f"{what}; it lasted {end - start:.1f} s" if end > start else what
    return _happening(code, start, end, size, a, b)


def _fault(code: NoteCode, size: float, a: float, b: float) -> tuple[dict[str, Any], str]:
    """Evidence and one sentence of a fault."""
    match code:
        case NoteCode.GNSS_JUMP:
            return {"refused_fixes": int(a)}, f"GNSS position jumped by {size:.1f} m, its velocity did not: not fused"
        case NoteCode.GNSS_DRIFT:
            text = f"GNSS position drifts, by {size:.1f} m so far, against its own velocity and the IMU: not fused"
            return {"rate_m_s": a, "likelihood_ratio": b}, text
        case NoteCode.GNSS_HEIGHT_DRIFT:
            text = f"GNSS height drifted by {size:.1f} m against its own velocity, the IMU and the barometer: not fused"
            return {"down_m_s": a, "likelihood_ratio": b}, text
        case NoteCode.GNSS_VELOCITY_WRONG:
            text = f"GNSS velocity is off by {size:.1f} m/s against its own positions and the IMU: not fused"
            return {"likelihood_ratio": _known(b)}, text
        case NoteCode.GNSS_FROZEN:
            return {
                "repeats": int(size)
            }, f"GNSS repeats the same fix, {int(size)} times by now, while the vehicle moves: not fused"
        case NoteCode.GNSS_JAMMED:
            text = (
                f"GNSS positions scatter, by {size:.1f} m now, far more than the receiver claims: jamming or multipath"
            )
            return {"scattered_fixes": a, "times_claimed_sigma": b}, text
        case NoteCode.MAGNETIC_DISTURBANCE:
            return {}, f"magnetic field off by {size * 1e6:.1f} microtesla: not fused"
        case NoteCode.BAROMETER_DISTURBANCE:
            return {}, f"pressure height off by {size:.1f} m: not fused"
        case NoteCode.GYRO_STEP:
            return {"likelihood_ratio": b}, f"gyro bias stepped by {math.degrees(size):.2f} deg/s: corrected"
        case NoteCode.ACCELEROMETER_STEP if not b:
            text = f"height off by {abs(a):.1f} m against pressure and fixes alike: the accelerometer's bias is learnt anew"
            return {"height_m": a}, text
        case NoteCode.ACCELEROMETER_STEP:
            return {"likelihood_ratio": _known(b)}, f"accelerometer bias stepped by {size:.2f} m/s^2: corrected"
        case NoteCode.ACCELEROMETER_SCALE:
            text = f"accelerometer shows {size:.2f} m/s^2 at rest, where gravity is {a:.2f}: its scale is wrong, so it is not used"
            return {"gravity_m_s2": a}, text
        case NoteCode.IMU_CLIPPING:
            return {}, f"accelerometer is at the end of its range, {size:.0f} m/s^2"
        case NoteCode.IMU_VIBRATION:
            return {}, f"vibration of {size:.0f} m/s^2 at the accelerometer"
        case _:
            return {
                "samples": int(size)
            }, "IMU samples have no noise of their own: repeated or interpolated, not measured"


def _known(value: float) -> float | None:
    return value if math.isfinite(value) and value > 0.0 else None


def _happening(code: NoteCode, start: float, end: float, size: float, a: float, b: float) -> tuple[dict[str, Any], str]:
    """Evidence and one sentence of a note that is no fault."""
    match code:
        case NoteCode.ALIGNED:
            how = "standing still" if a else "moving"
            return {
                "still": bool(a),
                "force_m_s2": b,
            }, f"attitude found from gravity while {how}; tilt known to {math.degrees(size):.1f} deg"
        case NoteCode.YAW_ALIGNED:
            return (
                {"declination_deg": math.degrees(a), "field_tesla": b},
                f"heading found from the magnetometer, with a declination of {math.degrees(a):.1f} deg",
            )
        case NoteCode.POSITION_FOUND:
            return {
                "fixes": int(a),
                "fix_type": int(b),
            }, f"position found: {int(a)} fixes in a row agree; known to {size:.1f} m"
        case NoteCode.POSITION_RESET:
            return (
                {"refused_fixes": int(a), "down_m": b},
                f"position reset by {size:.1f} m: {int(a)} fixes that agree with each other had been refused for {end - start:.0f} s",
            )
        case NoteCode.GNSS_OUTAGE:
            return {"after_s": size}, f"no position fused for {size:.1f} s: dead reckoning"
        case NoteCode.GNSS_BACK:
            return {}, f"position fused again after {size:.1f} s"
        case NoteCode.POSITION_GIVEN_UP:
            return {
                "sigma_m": size
            }, f"position given up {end - start:.0f} s after the last fix: it was known to {size:.0f} m only"
        case NoteCode.IMU_GAP:
            return {}, f"no IMU sample for {size:.2f} s"
        case NoteCode.MODEL_CHANGED:
            return _model_changed(size, a, b)
        case NoteCode.VELOCITY_RESET:
            text = f"velocity reset by {size:.1f} m/s: {int(a)} velocities had been refused for {end - start:.0f} s"
            return {"refused_velocities": int(a)}, text
        case NoteCode.YAW_FROM_MOTION:
            return (
                {},
                f"heading found from the motion: GNSS velocity and acceleration agree, known to {math.degrees(size):.1f} deg",
            )
        case NoteCode.YAW_FROM_GNSS:
            text = f"heading taken from the receiver's two antennas: turned by {math.degrees(size):.1f} deg"
            return {"sigma_deg": math.degrees(a)}, text
        case (
            NoteCode.RECEIVER_CHANGED
            | NoteCode.IMU_CHANGED
            | NoteCode.MAGNETOMETER_CHANGED
            | NoteCode.BAROMETER_CHANGED
        ):
            before, now = Source(int(a)).name, Source(int(b)).name
            what = code.name.split("_")[0].lower().replace("imu", "IMU")
            why = "silent or refused" if code is NoteCode.RECEIVER_CHANGED else "silent"
            text = f"{now} is used as the {what} in place of {before}, {why} for {end - start:.1f} s"
            return {"before": before, "now": now}, text
        case NoteCode.MAGNETOMETER_RELEARNT:
            return (
                {},
                f"the magnetometer was off by {size * 1e6:.1f} microtesla for {end - start:.0f} s: its bias is learnt anew",
            )
        case NoteCode.ARMED:
            return {}, "the vehicle was armed"
        case _:
            return {}, "the vehicle was disarmed"


def _model_changed(odds: float, code: float, rate: float) -> tuple[dict[str, Any], str]:
    name = {L.CONSTANT_VELOCITY: "constant-velocity", L.STRAPDOWN: "strapdown", L.TELEMETRY: "telemetry"}[code]
    if rate:
        return (
            {"model": name, "log_odds": odds, "imu_hz": rate},
            f"model {name} leads now: with the IMU at {rate:.2g} Hz the other sensors find it likelier",
        )
    return {"model": name}, f"model {name} begins"
