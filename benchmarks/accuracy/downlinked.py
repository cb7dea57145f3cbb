"""The autopilot's own estimate as it is downlinked, compared with poses. For comparison only: no estimate sees any of it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.accuracy.common import Array
from mavkf.models.earth import SEMI_MAJOR_AXIS
from mavkf.replay.results import SessionResult
from mavkf.replay.tlog import Log
from mavkf.replay.truth import Truth, errors
from mavkf.samples import ARRIVAL, FIX, HEIGHT_AMSL, KIND, TIME, Kind

CLOSE = 0.25  # s: a pose farther than this from a message is not compared with it
SAME_DATUM = 100.0  # m: heights of receiver and autopilot that are farther apart have not the same zero
EKF = (
    "velocity_variance",
    "pos_horiz_variance",
    "compass_variance",
)  # of EKF_STATUS_REPORT: test ratios, 1 is the gate


@dataclass(frozen=True)
class Differences:
    """Sums of squares and counts of pose less downlinked estimate, by quantity: horizontal_m, down_m, velocity_ms, tilt_deg, yaw_deg."""

    squares: dict[str, float]
    counts: dict[str, int]

    def rms(self, name: str) -> float:
        """Root mean square of a quantity, NaN where there is none."""
        count = self.counts.get(name, 0)
        return float(np.sqrt(self.squares[name] / count)) if count else np.nan

    def plus(self, other: "Differences") -> "Differences":
        """Both together."""
        names = self.squares.keys() | other.squares.keys()
        return Differences(
            {name: self.squares.get(name, 0.0) + other.squares.get(name, 0.0) for name in names},
            {name: self.counts.get(name, 0) + other.counts.get(name, 0) for name in names},
        )


def messages_of(log: Log, session: SessionResult, name: str) -> NDArray[np.void]:
    """All messages of a name that arrived during a session of the vehicle: structured array (n)."""
    system, component = (int(part) for part in session.vehicle.split("-"))
    found, arrival = log.messages(system, component, name)
    first, last = session.rows[:, ARRIVAL].min(), session.rows[:, ARRIVAL].max()
    during: NDArray[np.void] = found[(arrival >= first) & (arrival <= last)]
    return during


def differences(log: Log, session: SessionResult, pose: dict[str, Array], begin: float) -> Differences:
    """Compare poses (columns of equal length) with the downlinked ones from `begin`, s of boot time, on.

    Each message is compared with the pose nearest to its time, and brought to the time of that by its own rates.
    """
    result = Differences({}, {})
    for truth in (_attitude(log, session, pose, begin), _place(log, session, pose, begin)):
        if truth.time_boot_s.size:
            at = np.searchsorted(pose["time_boot_s"], truth.time_boot_s)
            values = errors({name: column[at] for name, column in pose.items()}, truth).values
            squares: dict[str, Array] = {
                name: values[name] ** 2 for name in ("horizontal_m", "down_m", "tilt_deg", "yaw_deg") if name in values
            }
            squares["velocity_ms"] = values["vn_ms"] ** 2 + values["ve_ms"] ** 2 + values["vd_ms"] ** 2
            known = {name: square[np.isfinite(square)] for name, square in squares.items()}
            result = result.plus(
                Differences({k: float(v.sum()) for k, v in known.items()}, {k: v.size for k, v in known.items()})
            )
    return result


def _nearest(pose: dict[str, Array], t: Array, begin: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Which messages (indices) have a pose near, and which pose that is; each pose once, rising."""
    times = pose["time_boot_s"]
    if times.size < 2:
        return np.empty(0, np.intp), np.empty(0, np.intp)
    after = np.clip(np.searchsorted(times, t), 1, times.size - 1)
    at = after - (t - times[after - 1] < times[after] - t)
    messages = np.flatnonzero((np.abs(times[at] - t) <= CLOSE) & (times[at] >= begin))
    at, first = np.unique(at[messages], return_index=True)
    return messages[first], at


def _attitude(log: Log, session: SessionResult, pose: dict[str, Array], begin: float) -> Truth:
    found = messages_of(log, session, "ATTITUDE")
    t = found["time_boot_ms"] * 1e-3
    use, at = _nearest(pose, t, begin)
    found, to = found[use], pose["time_boot_s"][at]
    dt = to - t[use]
    roll, pitch, yaw, p, q, r = (
        found[name].astype(np.float64) for name in ("roll", "pitch", "yaw", "rollspeed", "pitchspeed", "yawspeed")
    )
    turning = q * np.sin(roll) + r * np.cos(roll)
    euler = np.stack(
        [
            roll + (p + turning * np.tan(pitch)) * dt,
            pitch + (q * np.cos(roll) - r * np.sin(roll)) * dt,
            yaw + turning / np.cos(pitch) * dt,
        ],
        axis=1,
    )
    nothing = np.full(to.size, np.nan)
    return Truth(to, nothing, nothing, nothing, np.full((to.size, 3), np.nan), euler)


def _place(log: Log, session: SessionResult, pose: dict[str, Array], begin: float) -> Truth:
    found = messages_of(log, session, "GLOBAL_POSITION_INT")
    found = found[(found["lat"] != 0) | (found["lon"] != 0)]  # zero before the autopilot knows
    t = found["time_boot_ms"] * 1e-3
    use, at = _nearest(pose, t, begin)
    found, to = found[use], pose["time_boot_s"][at]
    dt = to - t[use]
    v = np.stack([found[name] * 0.01 for name in ("vx", "vy", "vz")], axis=1)
    latitude = np.radians(found["lat"] * 1e-7)
    height = found["alt"] * 1e-3 - v[:, 2] * dt
    # before home is set ArduCopter 3 sends a height that is not above sea level: its receiver's own says so
    fixes = session.rows[(session.rows[:, KIND] == Kind.GNSS) & (session.rows[:, FIX] >= 3)]
    if fixes.shape[0]:
        reported = np.interp(to, np.maximum.accumulate(fixes[:, TIME]), fixes[:, HEIGHT_AMSL])
        height[np.abs(height - reported) > SAME_DATUM] = np.nan
    return Truth(
        to,
        latitude + v[:, 0] * dt / SEMI_MAJOR_AXIS,
        np.radians(found["lon"] * 1e-7) + v[:, 1] * dt / (SEMI_MAJOR_AXIS * np.cos(latitude)),
        height,
        v,
        np.full((to.size, 3), np.nan),
    )
