"""MAVLink 2 signing: which of the frames that came are to be believed, and the stamps of our own.

A signature is the first six bytes of SHA-256 over the key and the frame, with a link id and a stamp of 48 bits (units of
10 microseconds since 2015) inside. Whoever lacks the key cannot make one, and the stamps keep old frames from being sent again:
those of one link id, system and component must rise, and the first may be a minute old at most.
"""

import hashlib
import hmac
import re
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mavkf.errors import InputError, UsageError

EPOCH_US = 1_420_070_400_000_000
"""2015-01-01 UTC, microseconds."""
UNIT_US = 10
KEY_SIZE, SIGNATURE_SIZE = 32, 13
OLDEST = 60_000_000 // UNIT_US
MOST_STREAMS = 1024
"""Senders of one key whose last stamp is remembered; more than any vehicle has."""


def read_key(text: str) -> bytes:
    """The key (32 bytes) that a file holds, raw or as 64 hex digits, or that a text of 64 hex digits or a passphrase is.

    A passphrase stands for its SHA-256, as in MAVProxy and Mission Planner. Raises UsageError, InputError.
    """
    content = text
    if Path(text).is_file():
        try:
            raw = Path(text).read_bytes()
        except OSError as error:
            raise InputError(f"--signing-key {text} cannot be read ({error.strerror}); check its permissions") from None
        if len(raw) == KEY_SIZE:
            return raw
        content = raw.decode("utf-8", "replace").strip()
    if not content:
        raise UsageError(f"--signing-key {text!r} is empty: give a file, 64 hex digits or a passphrase")
    if re.fullmatch(r"[0-9A-Fa-f]{64}", content):
        return bytes.fromhex(content)
    return hashlib.sha256(content.encode()).digest()


def stamp_of(arrival_us: int) -> int:
    """The stamp (10 microseconds since 2015) of a time (microseconds UTC)."""
    return max(0, arrival_us - EPOCH_US) // UNIT_US


class Signing:
    """One key: checks what comes, and says with which stamp to sign."""

    def __init__(self, key: bytes, say: Callable[[str], None], *, allow_unsigned: bool = False) -> None:
        """key: 32 bytes; say: told once for each reason why a frame was refused."""
        self.key, self._say, self._allow_unsigned = key, say, allow_unsigned
        self.refused: Counter[str] = Counter()
        self._newest = 0
        self._last: dict[bytes, int] = {}

    def check(self, data: NDArray[np.uint8], frames: NDArray[np.void]) -> NDArray[np.void]:
        """The frames (`mavkf.link.framing.FRAME`, stamps filled, offsets refer to `data`) that are to be believed."""
        keep = np.ones(len(frames), bool)
        fields = frames[["offset", "stamp", "size", "length", "version"]].tolist()
        for i, (offset, arrival_us, size, length, version) in enumerate(fields):
            if version == 2 and size == length + 12 + SIGNATURE_SIZE:
                why = self._fault(data[offset - 10 : offset - 10 + size].tobytes(), arrival_us)
            else:
                why = None if self._allow_unsigned else "without a signature"
            if why is not None:
                keep[i] = False
                self.refused[why] += 1
                if self.refused[why] == 1:
                    self._say(f"a frame {why} is refused; further ones are counted{_REMEDIES.get(why, '')}")
        return frames[keep]

    def _fault(self, frame: bytes, arrival_us: int) -> str | None:
        """Why a signed frame is not to be believed; None: it is."""
        if not hmac.compare_digest(hashlib.sha256(self.key + frame[:-6]).digest()[:6], frame[-6:]):
            return "with a wrong signature"
        stamp = int.from_bytes(frame[-12:-6], "little")
        stream = frame[-13:-12] + frame[5:7]
        last = self._last.get(stream)
        if last is None:
            is_old = stamp < max(self._newest, stamp_of(arrival_us)) - OLDEST or len(self._last) >= MOST_STREAMS
        else:
            is_old = stamp <= last
        if is_old:
            return "with an old signature"
        self._last[stream] = stamp
        self._newest = max(self._newest, stamp)
        return None

    def next_stamp(self, now_us: int) -> int:
        """The stamp for a frame of ours: later than all before, ours and theirs, whatever the clock (microseconds UTC) does."""
        self._newest = max(self._newest + 1, stamp_of(now_us))
        return self._newest


_REMEDIES = {
    "without a signature": " (--allow-unsigned takes them)",
    "with a wrong signature": ": is it the vehicle's key?",
}
