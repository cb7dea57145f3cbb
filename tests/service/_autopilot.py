"""A scripted autopilot: sends messages at intervals that can be set, asked for, denied or ignored; pymavlink encodes and decodes."""

import random
import struct
from collections.abc import Callable, Mapping
from typing import Any, Literal

from pymavlink.dialects.v20 import ardupilotmega as mavlink

Manner = Literal["grant", "deny", "silent"]
GROUPS = {1: ("RAW_IMU", "SCALED_PRESSURE"), 2: ("GPS_RAW_INT",), 12: ("SYSTEM_TIME",)}
"""The messages of the MAV_DATA_STREAMs that it knows."""
UTC_US = 1_760_000_000_000_000


class Autopilot:
    """At rest, level, with a fix. Time is what `advance` is told."""

    def __init__(
        self,
        *,
        system: int = 1,
        sets: Manner = "grant",
        gets: Manner = "grant",
        streams: Manner = "grant",
        reads: Manner = "grant",
        parameters: Mapping[str, float] | None = None,
        denied: tuple[str, ...] = (),
        intervals_us: dict[str, int] | None = None,
        version: int = 2,
        kind: tuple[int, int] = (2, 3),
    ) -> None:
        """sets, gets, streams, reads: what it does with each kind of question; denied: messages that it does not have;
        parameters: their values, of others it says nothing; intervals_us: what it sends at first beside heartbeats;
        kind: MAV_TYPE and MAV_AUTOPILOT of its heartbeats."""
        self.sets, self.gets, self.streams, self.denied = sets, gets, streams, denied
        self.reads, self.parameters = reads, dict(parameters or {})
        self.default = dict(intervals_us or {})
        self.intervals = dict(self.default)
        self.asked: list[Any] = []
        self.kind, self.version = kind, version
        self.booted_s = 0.0
        self.wire = mavlink.MAVLink(None, srcSystem=system, srcComponent=1)
        self.ear = mavlink.MAVLink(None)
        self.ear.robust_parsing = True
        self._due = {"HEARTBEAT": 0.0}
        self._answers: list[bytes] = []
        self._random = random.Random(1)

    def reboot(self, t: float) -> None:
        """Begin anew with what it sends at first."""
        self.booted_s, self.intervals, self._due = t, dict(self.default), {"HEARTBEAT": t}

    def hear(self, data: bytes) -> None:
        for message in self.ear.parse_buffer(bytearray(data)) or []:
            self.asked.append(message)
            name = message.get_type()
            if name == "COMMAND_LONG" and message.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
                self._set(mavlink.mavlink_map[int(message.param1)].msgname, int(message.param2))
            elif name == "COMMAND_LONG" and message.command == mavlink.MAV_CMD_GET_MESSAGE_INTERVAL:
                self._get(int(message.param1))
            elif name == "PARAM_REQUEST_READ":
                self._read(message.param_id)
            elif name == "REQUEST_DATA_STREAM" and self.streams == "grant":
                for one in GROUPS[message.req_stream_id]:
                    self.intervals[one] = (
                        round(1e6 / message.req_message_rate) if message.start_stop else self.default.get(one, -1)
                    )

    def _set(self, name: str, interval_us: int) -> None:
        if self.sets == "silent":
            return
        is_denied = self.sets == "deny" or name in self.denied
        if not is_denied:
            self.intervals[name] = self.default.get(name, -1) if interval_us == 0 else interval_us
        self._acknowledge(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, is_denied)

    def _get(self, message: int) -> None:
        if self.gets == "silent":
            return
        if self.gets == "grant":
            interval = self.intervals.get(mavlink.mavlink_map[message].msgname, -1)
            self._answers.append(self._packed(mavlink.MAVLink_message_interval_message(message, interval)))
        self._acknowledge(mavlink.MAV_CMD_GET_MESSAGE_INTERVAL, self.gets == "deny")

    def _read(self, name: str) -> None:
        if self.reads == "deny":
            error = mavlink.MAVLink_param_error_message(1, mavlink.MAV_COMP_ID_ONBOARD_COMPUTER, name.encode(), -1, 1)
            self._answers.append(self._packed(error))
        elif self.reads == "grant" and name in self.parameters:
            self._answers.append(self._packed(self.parameter(name)))

    def parameter(self, name: str) -> Any:
        """PARAM_VALUE as its firmware encodes it: whole numbers as INT32 by their bytes (PX4), or as a small one by value."""
        value, number = self.parameters[name], mavlink.MAV_PARAM_TYPE_REAL32
        if isinstance(value, int) and self.kind[1] == mavlink.MAV_AUTOPILOT_PX4:
            (value,), number = struct.unpack("<f", struct.pack("<i", value)), mavlink.MAV_PARAM_TYPE_INT32
        elif isinstance(value, int):
            number = mavlink.MAV_PARAM_TYPE_INT16
        return mavlink.MAVLink_param_value_message(name.encode(), value, number, 900, 0xFFFF)

    def _acknowledge(self, command: int, is_denied: bool) -> None:
        result = mavlink.MAV_RESULT_UNSUPPORTED if is_denied else mavlink.MAV_RESULT_ACCEPTED
        self._answers.append(self._packed(mavlink.MAVLink_command_ack_message(command, result)))

    def _packed(self, message: Any) -> bytes:
        data: bytes = message.pack(self.wire, force_mavlink1=self.version == 1)
        self.wire.seq = (self.wire.seq + 1) % 256
        return data

    def advance(self, t: float) -> list[bytes]:
        """The frames that it sends up to a time (s)."""
        frames, self._answers = self._answers, []
        due: list[tuple[float, str]] = []
        for name, interval in {"HEARTBEAT": 1_000_000, **self.intervals}.items():
            if interval > 0:
                at = self._due.setdefault(name, t)
                while at <= t:
                    due.append((at, name))
                    at += interval * 1e-6
                self._due[name] = at
            else:
                self._due.pop(name, None)
        return frames + [self._packed(_MESSAGES[name](self, at - self.booted_s)) for at, name in sorted(due)]

    def noise(self, size: int) -> int:
        return self._random.randint(-size, size)


def _us(boot_s: float) -> int:
    return 1_000_000 + round(boot_s * 1e6)


def _raw_imu(a: Autopilot, s: float) -> Any:
    n = a.noise
    return mavlink.MAVLink_raw_imu_message(_us(s), n(5), n(5), -1000 + n(5), n(3), n(3), n(3), 220, 10, 430)


def _highres_imu(a: Autopilot, s: float) -> Any:
    g, w = [a.noise(50) * 1e-3 for _ in range(3)], [a.noise(30) * 1e-4 for _ in range(3)]
    field = (0.22, 0.01, 0.43)
    return mavlink.MAVLink_highres_imu_message(
        _us(s), g[0], g[1], g[2] - 9.81, *w, *field, 955.0, 0.0, 480.0, 25.0, 0xFFF
    )


def _fix(a: Autopilot, s: float) -> Any:
    n = a.noise
    place = (473977418 + n(10), 85455938 + n(10), 488_000 + n(200))
    return mavlink.MAVLink_gps_raw_int_message(_us(s), 3, *place, 80, 120, 3, 0, 12)


_MESSAGES: dict[str, Callable[[Autopilot, float], Any]] = {
    "HEARTBEAT": lambda a, _: mavlink.MAVLink_heartbeat_message(*a.kind, 0, 0, 4, 3),
    "RAW_IMU": _raw_imu,
    "HIGHRES_IMU": _highres_imu,
    "GPS_RAW_INT": _fix,
    "GPS2_RAW": lambda _, s: mavlink.MAVLink_gps2_raw_message(_us(s), 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0),
    "SCALED_PRESSURE": lambda a, s: mavlink.MAVLink_scaled_pressure_message(
        _us(s) // 1000, 955 + a.noise(9) * 1e-3, 0, 25
    ),
    "SYSTEM_TIME": lambda _, s: mavlink.MAVLink_system_time_message(UTC_US + _us(s), _us(s) // 1000),
}
