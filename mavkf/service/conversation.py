"""The talk with one autopilot over one link: asks for the streams that the filter needs, checks what comes, asks again.

Beside that it asks for the few parameters that help (`mavkf.service.parameters`). A pure state machine: it is told what was heard and what
time it is (seconds of any clock that runs evenly), and gives messages to send. It opens nothing and waits for nothing.

    listen     what comes anyhow is measured; where that is enough nothing is asked
    ask        each stream: GET_MESSAGE_INTERVAL (to restore it), then SET_MESSAGE_INTERVAL; another message where one is denied.
               Who does not answer one question is not waited for at the next
    verify     by the rates that come; for what does not, REQUEST_DATA_STREAM
    watch      until a rate falls or the vehicle reboots; then from the start
    leave      every interval as it was found
"""

from collections.abc import Callable, Generator, Iterator, Mapping
from typing import NamedTuple, TypeAlias

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from mavkf.link.decode import Address
from mavkf.link.layouts import message_ids
from mavkf.service.parameters import ParameterQuestions
from mavkf.service.rates import Rates
from mavkf.service.streams import STREAMS, Stream, affordable, affordable_groups

Message: TypeAlias = mavlink.MAVLink_message
Say = Callable[[str], None]

ANSWER_S, TRIES = 0.5, 2
LISTEN_S, LOOK_S = (
    1.2,
    0.5,
)  # before the first asking, and before another: which IMU is used is decided in a session's first 5 s
SETTLE_S = 3.0
AGAIN_S = (3.0, 60.0)  # between askings that did not help
SILENT_S = 5.0  # without a heartbeat: away
ENOUGH = 0.6  # of the rate that was asked for: loss, and schedulers that round
FALLEN = 0.5  # of the rate that came
REFUSED = -2  # in place of an interval, which is -1 where a message is off


class _Pause(NamedTuple):
    """What the script waits for: some seconds or until `done`; what it sends first."""

    seconds: float
    messages: tuple[Message, ...] = ()
    done: Callable[[], bool] = lambda: False


class Conversation:
    """The talk with one vehicle."""

    def __init__(self, address: Address, autopilot: int, t: float, budget: Callable[[], float], say: Say) -> None:
        """address, autopilot: of the autopilot, its MAV_AUTOPILOT; t: now; say: told what was granted and read.

        budget: the bytes a second that may be asked for.
        """
        self.address = address
        self.parameters = ParameterQuestions(address, autopilot, budget, say)
        self.may_ask = False
        """Set from outside: whether asking is allowed on this link, now."""
        self.heard_at = t
        self._t = self._since = t
        self._budget, self._say = budget, say
        self._rates = Rates()
        self._rebooted = False
        self._boot_ms = -1
        self._awaited: str | None = None
        self._answer: int | None = None
        self._is_mute = {"get": False, "set": False}  # it has not answered such a question
        self._asked: dict[Stream, float] = {}  # Hz
        self._granted: set[Stream] = set()
        self._set: dict[str, int] = {}  # intervals asked for, microseconds
        self._found: dict[str, int] = {}  # intervals before that
        self._groups: dict[int, int] = {}  # data streams asked for: their rates before, Hz
        self._told = ""
        self._script = self._talk()
        self._pause = next(self._script)

    def heartbeat(self, t: float) -> None:
        """The autopilot's HEARTBEAT has come."""
        self.heard_at = t

    def look_again(self) -> None:
        """What is sent may not be what was set: look from the start."""
        self._rebooted = True
        self._rates = Rates()
        self.parameters.begin()

    @property
    def has_asked(self) -> bool:
        """Whether there is something to put back."""
        return bool(self._set or self._groups)

    def boot_time(self, boot_ms: int) -> None:
        """A SYSTEM_TIME has come: a boot clock that falls is a reboot."""
        if boot_ms < self._boot_ms - 1000:
            self.look_again()
        self._boot_ms = boot_ms

    def heard(self, t: float, counts: Mapping[str, int]) -> None:
        """Messages of `STREAMS` have come, by name."""
        self._rates.add(t, counts)

    def interval(self, message: int, interval_us: int) -> None:
        """A MESSAGE_INTERVAL has come."""
        if self._awaited == f"get {message}":
            self._answer = interval_us

    def acknowledged(self, command: int, result: int) -> None:
        """A COMMAND_ACK has come."""
        if result == mavlink.MAV_RESULT_IN_PROGRESS or self._awaited is None:
            return
        if command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL and self._awaited == "set":
            self._answer = result
        if (
            command == mavlink.MAV_CMD_GET_MESSAGE_INTERVAL
            and self._awaited.startswith("get")
            and result != mavlink.MAV_RESULT_ACCEPTED
        ):
            self._answer = REFUSED

    def step(self, t: float) -> list[Message]:
        """What to send now. Call it whenever something was heard, and several times a second."""
        self._t = t
        messages: list[Message] = []
        while self._pause.done() or t - self._since >= self._pause.seconds:
            self._since = t
            self._pause = next(self._script)
            messages += self._pause.messages
        return messages + self.parameters.step(t) if self.may_ask else messages

    def leave(self) -> list[Message]:
        """What puts everything back as it was found."""
        messages = [self._set_interval(message, self._found.get(message, 0)) for message in self._set]
        for group, rate in self._groups.items():
            messages.append(mavlink.MAVLink_request_data_stream_message(*self.address, group, rate, int(rate > 0)))
        return messages

    # the script

    def _talk(self) -> Iterator[_Pause]:
        wait = AGAIN_S[0]
        while True:
            self._rebooted = False
            yield _Pause(LOOK_S if self.has_asked else LISTEN_S)
            missing = self._missing()
            if missing and not self.may_ask:
                self._tell(f"would ask for {_wish(affordable(missing, self._budget()))}: --request lets it")
                while not self.may_ask:
                    yield _Pause(1.0)
                continue
            if missing:
                yield from self._ask(missing)
                yield _Pause(SETTLE_S)
                yield from self._ask_groups()
                self._tell(self._outcome())
            yield from self._watch(wait)
            self._rates = Rates()
            wait = AGAIN_S[0] if self._rebooted else min(2.0 * wait, AGAIN_S[1])

    def _missing(self) -> list[Stream]:
        """The streams to ask for; none where all that is required comes."""
        short = [s for s in STREAMS if not self._rates.reaches(self._t, s.sources, ENOUGH * s.rate_hz)]
        return short if any(stream.required for stream in short) else []

    def _ask(self, missing: list[Stream]) -> Iterator[_Pause]:
        self._is_mute = {"get": False, "set": False}
        self._asked = affordable(missing, self._budget())
        self._granted.clear()
        for stream, rate in sorted(self._asked.items(), key=lambda item: -item[1]):  # the IMU first
            wanted_us = round(1e6 / rate)
            for name in stream.messages:
                found = yield from self._get(name)
                if found is not None and not _is_close(found, self._set.get(name)):
                    self._found[name] = found if found >= -1 else 0
                if found is not None and 0 < found <= 1.1 * wanted_us:
                    self._granted.add(stream)  # it is set already, and comes as well as it can
                    break
                before = self._set.get(name)
                self._set[name] = wanted_us
                result = yield from self._command("set", self._set_interval(name, wanted_us), "set")
                if result == mavlink.MAV_RESULT_ACCEPTED:
                    self._granted.add(stream)
                if result in (None, mavlink.MAV_RESULT_ACCEPTED):
                    break
                del self._set[name]  # denied: there is nothing to put back but what was granted before
                if before is not None:
                    self._set[name] = before

    def _ask_groups(self) -> Iterator[_Pause]:
        """Ask for whole groups where streams were not granted and did not come."""
        groups: dict[int, int] = {}
        for stream, rate in self._asked.items():
            if (
                stream.required
                and stream not in self._granted
                and not self._rates.reaches(self._t, stream.sources, ENOUGH * rate)
            ):
                groups[stream.group] = 0
        for stream in STREAMS:
            if stream.group in groups:
                groups[stream.group] = max(groups[stream.group], round(self._rate(stream)))
        messages = []
        for group, rate_hz in affordable_groups(groups, self._budget()).items():
            self._groups.setdefault(group, groups[group])
            faster = max(rate_hz, groups[group])  # what comes is never made slower
            messages.append(mavlink.MAVLink_request_data_stream_message(*self.address, group, faster, 1))
        if messages:
            yield _Pause(SETTLE_S, tuple(messages))

    def _watch(self, wait: float) -> Iterator[_Pause]:
        """Until the vehicle reboots, or what came falls, or, after `wait`, what did not come is to be asked for again."""
        came = {stream: self._rate(stream) for stream in STREAMS if stream.required}
        is_short = any(rate == 0.0 for stream, rate in came.items() if stream in self._asked)
        until = self._t + wait
        while True:
            yield _Pause(1.0, done=lambda: self._rebooted)
            if self._rebooted:
                return
            if self._t < until or self._t - self.heard_at > SILENT_S:
                continue
            if is_short or any(
                rate > 0.0 and not self._rates.reaches(self._t, stream.sources, FALLEN * min(rate, stream.rate_hz))
                for stream, rate in came.items()
            ):
                return

    def _get(self, name: str) -> Generator[_Pause, None, int | None]:
        """The interval of a message; None: unanswered."""
        if self._is_mute["get"]:
            return None
        number = message_ids()[name]
        command = self._command_long(mavlink.MAV_CMD_GET_MESSAGE_INTERVAL, number)
        return (yield from self._command("get", command, f"get {number}"))

    def _command(self, kind: str, message: Message, awaited: str) -> Generator[_Pause, None, int | None]:
        """Send a command until it is answered; None: it was not."""
        if self._is_mute[kind]:
            yield _Pause(0.0, (message,))
            return None
        self._awaited, self._answer = awaited, None
        for _ in range(TRIES):
            yield _Pause(ANSWER_S, (message,), lambda: self._answer is not None)
            if self._answer is not None:
                break
        self._awaited = None
        self._is_mute[kind] = self._answer is None
        return self._answer

    def _set_interval(self, name: str, interval_us: int) -> Message:
        return self._command_long(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, message_ids()[name], interval_us)

    def _command_long(self, command: int, first: float, second: float = 0.0) -> Message:
        return mavlink.MAVLink_command_long_message(*self.address, command, 0, first, second, 0, 0, 0, 0, 0)

    def _rate(self, stream: Stream) -> float:
        return self._rates.rate(self._t, stream.sources)

    def _outcome(self) -> str:
        """What was asked for and what came of it, in a sentence."""
        parts = []
        for stream, rate in self._asked.items():
            name = max(stream.sources, key=lambda name: self._rates.count(self._t, (name,)))
            came = self._rates.rate(self._t, (name,))
            if came > 0.0:
                parts.append(f"{stream.messages[0]} at {rate:.3g} Hz ({name} comes at {came:.0f})")
            elif stream.required:
                parts.append(f"{stream.messages[0]} at {rate:.3g} Hz (does not come)")
        if not parts:
            return "nothing was asked for: the share of the link is too small (--link-share)"
        return "asked for " + ", ".join(parts)

    def _tell(self, text: str) -> None:
        """Say something unless it was the last that was said."""
        if text != self._told:
            self._say(text)
        self._told = text


def _is_close(one: int, other: int | None) -> bool:
    """Whether two intervals are the same but for how the autopilot rounds."""
    return other is not None and abs(one - other) <= 0.1 * other


def _wish(rates: Mapping[Stream, float]) -> str:
    return ", ".join(f"{stream.messages[0]} at {rate:.3g} Hz" for stream, rate in rates.items())
