"""What is said on one link: our heartbeats, and a conversation with each autopilot that is heard on it."""

import time
from collections import Counter
from collections.abc import Callable, Container
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from mavkf.link.decode import Address, decode
from mavkf.link.layouts import message_dtype, message_ids
from mavkf.samples import PARAMETER, PARAMETER_VALUE, AutopilotParameter
from mavkf.service.conversation import Conversation, Message
from mavkf.service.endpoints import Link
from mavkf.service.senders import is_autopilot
from mavkf.service.signing import Signing
from mavkf.service.streams import STREAMS

HEARTBEAT_S = 1.0
AWAY_S = 10.0  # without a heartbeat: nothing is said to it
FORGET_S = 120.0
MOST_TALKS = 16
UNKNOWN_BYTES_S = 5760.0  # of a link of unknown speed: those of the usual telemetry radio
PERIOD_S = 5.0  # over which a link's bytes are measured
_COUNTED = {message_ids()[name]: name for stream in STREAMS for name in stream.sources}
_RADIO = ("RADIO_STATUS", "RADIO")
_ANSWERS = {
    message_ids()[name]: name
    for name in ("HEARTBEAT", "SYSTEM_TIME", "MESSAGE_INTERVAL", "COMMAND_ACK", "PARAM_VALUE", "PARAM_ERROR", *_RADIO)
    if name in message_ids()  # PARAM_ERROR is newer than the oldest pymavlink that will do
}


@dataclass(frozen=True, kw_only=True)
class Manners:
    """How to talk.

    system, component: ours; system None: that of the vehicle talked to.
    request:           whether to ask for streams; None: only where nobody can be starved by it. False: say nothing at all.
    share:             of a link that may be asked for, 0 to 1.
    signing:           signs what is sent.
    say:               told what was asked for and granted.
    """

    system: int | None = None
    component: int = mavlink.MAV_COMP_ID_ONBOARD_COMPUTER
    request: bool | None = None
    share: float = 0.5
    signing: Signing | None = None
    say: Callable[[str], None] = lambda _: None


class Talk:
    """Hears the frames of one link and sends what there is to say. Not for several threads at once."""

    def __init__(
        self,
        link: Link,
        number: int,
        manners: Manners,
        now_us: Callable[[], int] = lambda: time.time_ns() // 1000,
    ) -> None:
        """number: of the link, its id in signatures; now_us: UTC, for signatures."""
        self.conversations: dict[Address, Conversation] = {}
        self._versions: dict[Address, int] = {}
        self._link, self._number, self._manners, self._now_us = link, number, manners, now_us
        self._senders: dict[int, mavlink.MAVLink] = {}
        self._has_radio = False
        self._beat_at = -np.inf
        self._bytes, self._bytes_s = 0, 0.0
        self._since: float | None = None

    def hear(self, data: NDArray[np.uint8], frames: NDArray[np.void], t: float) -> None:
        """Take frames of the link. data: what their offsets refer to; t: now, seconds of a clock that runs evenly."""
        if self._manners.request is False:
            return
        self._measure(int(frames["size"].sum()), t)
        counts: dict[Address, Counter[str]] = {}
        names = ["message", "system", "component", "version", "offset", "length"]
        for i, (message, system, component, version, offset, length) in enumerate(frames[names].tolist()):
            address = system, component
            if message in _COUNTED and address in self.conversations:
                counts.setdefault(address, Counter())[_COUNTED[message]] += 1
            name = _ANSWERS.get(message)
            if name is None:
                continue
            if name == "PARAM_VALUE":
                if address in self.conversations:
                    for row in decode(data, frames[i : i + 1]).get(address, ()):
                        parameter = AutopilotParameter(int(row[PARAMETER]))
                        self.conversations[address].parameters.heard(parameter, float(row[PARAMETER_VALUE]))
                continue
            fields = _fields(data[offset : offset + length].tobytes(), name)
            if name in _RADIO:
                self._note_radio()
            elif name == "HEARTBEAT":
                self._heartbeat(address, version, fields, t)
            elif address in self.conversations:
                _answer(self.conversations[address], name, fields, self._manners)
        for address, found in counts.items():
            self.conversations[address].heard(t, found)

    def cut(self) -> None:
        """The connection has ended; what is behind the next one may have been restarted."""
        for talk in self.conversations.values():
            talk.look_again()

    def session_ended(self) -> None:
        """A session was ended here, not by the vehicle: the next one must hear the parameters again."""
        for talk in self.conversations.values():
            talk.parameters.begin()

    def _note_radio(self) -> None:
        """A radio reports how it fares: what passes here is routed, and the pilot's."""
        if self._has_radio:
            return
        self._has_radio = True
        if self._manners.request is None and any(talk.has_asked for talk in self.conversations.values()):
            self._manners.say(f"{self._link.name}: there is a radio on the way: what was asked for is taken back")
            self.leave()

    def _heartbeat(self, address: Address, version: int, fields: np.void, t: float) -> None:
        if address[0] == 0 or not is_autopilot(int(fields["type"]), int(fields["autopilot"])):
            return
        if address not in self.conversations:
            self._forget(t)
            if len(self.conversations) >= MOST_TALKS:
                return
            name = f"vehicle {address[0]}-{address[1]} on {self._link.name}"
            self.conversations[address] = Conversation(
                address, int(fields["autopilot"]), t, self._budget, lambda text: self._manners.say(f"{name}: {text}")
            )
            self._versions[address] = version
        self._versions[address] = max(version, self._versions[address])
        self.conversations[address].heartbeat(t)

    def _forget(self, t: float) -> None:
        for address in [a for a, talk in self.conversations.items() if t - talk.heard_at > FORGET_S]:
            del self.conversations[address], self._versions[address]

    def _measure(self, size: int, t: float) -> None:
        """Count bytes; what they were a second is known anew after every second, of the last few."""
        if self._since is None or t - self._since > PERIOD_S:
            self._bytes, self._since = 0, t
        self._bytes += size
        if t - self._since >= 1.0:
            self._bytes_s = self._bytes / (t - self._since)

    @property
    def _is_near(self) -> bool:
        return self._link.is_local is True and not self._has_radio

    def _budget(self) -> float:
        """The bytes a second that may be asked for."""
        if self._link.baud is not None:
            return self._manners.share * self._link.baud / 10.0  # a byte is ten bits on the line
        if self._is_near:
            return float("inf")
        return self._manners.share * max(self._bytes_s, UNKNOWN_BYTES_S)

    def speak(self, t: float, given_up: Container[Address] = ()) -> None:
        """Send what there is to say now; call it several times a second. given_up: vehicles that nothing is estimated of."""
        if self._manners.request is False or self._link.is_local is None:
            return
        present = [
            address
            for address, talk in self.conversations.items()
            if address not in given_up and t - talk.heard_at < AWAY_S
        ]
        if t - self._beat_at >= HEARTBEAT_S:
            is_late = t - self._beat_at > 2 * HEARTBEAT_S
            self._beat_at = t if is_late else self._beat_at + HEARTBEAT_S  # once a second on the whole
            self._beat(present)
        for address in present:
            talk = self.conversations[address]
            talk.may_ask = self._manners.request is True or self._is_near
            for message in talk.step(t):
                self._send(message, address[0], self._versions[address])

    def _beat(self, present: list[Address]) -> None:
        versions: dict[int, int] = {}
        for address in present:
            versions[address[0]] = max(versions.get(address[0], 1), self._versions[address])
        if not versions and self._link.speaks_first:
            versions[1] = 2  # nobody is heard yet: most vehicles are number 1
        if self._manners.system is not None and versions:
            versions = {self._manners.system: max(versions.values())}
        for system, version in versions.items():
            beat = mavlink.MAVLink_heartbeat_message(
                mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
                mavlink.MAV_AUTOPILOT_INVALID,
                0,
                0,
                mavlink.MAV_STATE_ACTIVE,
                3,
            )
            self._send(beat, system, version)

    def leave(self) -> None:
        """Put back what was changed."""
        if self._link.is_local is None:
            return
        for address, talk in self.conversations.items():
            for message in talk.leave():
                self._send(message, address[0], self._versions[address])

    def tell(self, message: Message, address: Address) -> None:
        """Send a message of MAVLink 2 that is about a vehicle."""
        if self._link.is_local is not None:
            self._send(message, address[0], 2)

    def _send(self, message: Message, system: int, version: int) -> None:
        """Send as a component of a system, in the version of MAVLink that the vehicle speaks."""
        system = self._manners.system or system
        sender = self._senders.get(system)
        if sender is None:
            sender = self._senders[system] = mavlink.MAVLink(None, system, self._manners.component)
        signing = self._manners.signing
        if signing is not None:
            sender.signing.secret_key, sender.signing.link_id = signing.key, self._number & 0xFF
            sender.signing.timestamp = signing.next_stamp(self._now_us())
            sender.signing.sign_outgoing = True
        self._link.send(message.pack(sender, force_mavlink1=version == 1 and signing is None))
        sender.seq = (sender.seq + 1) % 256


def _fields(payload: bytes, name: str) -> np.void:
    """The fields of one message, as of `message_dtype`."""
    dtype = message_dtype(name)
    fields: np.void = np.frombuffer(payload[: dtype.itemsize].ljust(dtype.itemsize, b"\0"), dtype)[0]
    return fields


def _answer(talk: Conversation, name: str, fields: np.void, manners: Manners) -> None:
    if name == "SYSTEM_TIME":
        talk.boot_time(int(fields["time_boot_ms"]))
    elif name == "MESSAGE_INTERVAL":
        talk.interval(int(fields["message_id"]), int(fields["interval_us"]))
    elif not _is_to_us(talk, fields, manners):
        return
    elif name == "COMMAND_ACK":
        talk.acknowledged(int(fields["command"]), int(fields["result"]))
    elif name == "PARAM_ERROR":
        parameter = AutopilotParameter.__members__.get(fields["param_id"].decode("ascii", "replace"))
        if parameter is not None:
            talk.parameters.denied(parameter)


def _is_to_us(talk: Conversation, fields: np.void, manners: Manners) -> bool:
    """Whether an answer has our address, or nobody's."""
    return int(fields["target_system"]) in (0, manners.system or talk.address[0]) and int(
        fields["target_component"]
    ) in (0, manners.component)
