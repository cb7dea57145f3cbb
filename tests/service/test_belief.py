"""What is believed: signatures against pymavlink's own, systems, and frames that came over two links."""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from mavkf.errors import UsageError
from mavkf.link.framing import FrameStream
from mavkf.replay.tlog import read_tlog
from mavkf.service.belief import Belief
from mavkf.service.duplicates import MOST, WINDOW_US, Duplicates
from mavkf.service.playback import merge
from mavkf.service.signing import EPOCH_US, MOST_STREAMS, Signing, read_key, stamp_of

from .conftest import BEGIN_US, Frames, tlog
from .test_conversation import Bench, Wire

KEY = hashlib.sha256(b"a secret").digest()


def sender(key: bytes | None = KEY, *, link: int = 3, stamp: int | None = None, system: int = 1) -> Any:
    """A MAVLink sender of pymavlink, which signs if it has a key."""
    wire = mavlink.MAVLink(None, srcSystem=system, srcComponent=1)
    if key is not None:
        wire.signing.secret_key, wire.signing.link_id, wire.signing.sign_outgoing = key, link, True
        wire.signing.timestamp = stamp_of(BEGIN_US) if stamp is None else stamp
    return wire


def beat(wire: Any) -> bytes:
    data: bytes = mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3).pack(wire)
    return data


class Checked:
    """A `Signing` that is given bytes."""

    def __init__(self, key: bytes = KEY, **options: Any) -> None:
        self.said: list[str] = []
        self.signing = Signing(key, self.said.append, **options)
        self._stream = FrameStream()

    def __call__(self, *frames: bytes, at_us: int = BEGIN_US) -> int:
        """How many frames are believed."""
        data, found = self._stream.push(b"".join(frames), at_us, last=True)
        assert len(found) == len(frames)
        return len(self.signing.check(data, found))


def test_what_is_signed_with_the_key_is_believed() -> None:
    wire, check = sender(), Checked()
    assert check(*(beat(wire) for _ in range(20))) == 20
    assert not check.said


def test_a_wrong_key_and_a_changed_byte_are_refused_and_said_once() -> None:
    check = Checked()
    wire = sender(bytes(32))
    assert check(*(beat(wire) for _ in range(5))) == 0
    forged = bytearray(beat(sender()))
    forged[-1] ^= 1
    assert check(bytes(forged)) == 0
    assert check.signing.refused == {"with a wrong signature": 6}
    assert len(check.said) == 1


def test_an_old_signature_is_refused() -> None:
    wire, check = sender(), Checked()
    frames = [beat(wire) for _ in range(5)]
    assert check(*frames) == 5
    assert check(*frames) == 0  # sent again
    assert check(beat(wire)) == 1
    assert check.signing.refused == {"with an old signature": 5}


def test_recorded_signatures_are_refused_by_a_service_that_starts_later() -> None:
    recorded = beat(sender())
    assert Checked()(recorded, at_us=BEGIN_US + 59_000_000) == 1
    assert Checked()(recorded, at_us=BEGIN_US + 61_000_000) == 0


def test_links_and_senders_have_stamps_of_their_own() -> None:
    check = Checked()
    later = sender(link=1, stamp=stamp_of(BEGIN_US) + 1000)
    assert check(beat(later), beat(sender(link=2)), beat(sender(link=1, system=2))) == 3
    assert check(beat(sender(link=1))) == 0


def test_a_new_stream_far_behind_the_others_is_refused() -> None:
    check = Checked()
    ahead = sender(stamp=stamp_of(BEGIN_US) + 100 * 6_000_000)
    assert check(beat(ahead)) == 1
    assert check(beat(sender(link=9))) == 0


def test_without_a_signature_a_frame_is_refused_unless_allowed() -> None:
    wire = sender(None)
    check = Checked()
    assert check(beat(wire)) == 0
    assert "--allow-unsigned" in check.said[0]
    lenient = Checked(allow_unsigned=True)
    assert lenient(beat(wire), beat(sender())) == 2
    assert lenient(beat(sender(bytes(32)))) == 0


def test_streams_remembered_are_bounded() -> None:
    check = Checked()
    wires = [sender(link=link, system=system) for system in range(1, 7) for link in range(256)]
    assert check(*map(beat, wires)) == MOST_STREAMS
    assert check(beat(wires[0])) == 1


def test_our_stamps_rise_whatever_the_clock_does() -> None:
    signing = Signing(KEY, print)
    first = signing.next_stamp(BEGIN_US)
    assert first == (BEGIN_US - EPOCH_US) // 10
    assert signing.next_stamp(BEGIN_US - 10**9) == first + 1
    assert signing.next_stamp(0) == first + 2
    check = Checked()
    check(beat(sender(stamp=first + 5000)))
    assert check.signing.next_stamp(BEGIN_US) > first + 5000


def test_what_we_send_is_what_pymavlink_believes() -> None:
    from ._autopilot import Autopilot

    vehicle = Autopilot()
    vehicle.wire.signing = sender().signing
    vehicle.ear.signing.secret_key = KEY
    vehicle.ear.signing.timestamp = stamp_of(BEGIN_US)
    vehicle.ear.signing.allow_unsigned_callback = lambda *_: False
    bench = Bench(vehicle, wire=Wire(), signing=Signing(KEY, print)).run(12)
    assert vehicle.intervals["HIGHRES_IMU"] == 10_000
    assert vehicle.ear.signing.goodsig_count == len(vehicle.asked) > 10
    assert vehicle.ear.signing.badsig_count == vehicle.ear.signing.unsigned_count == 0
    assert {message.get_link_id() for message in vehicle.asked} == {0}
    assert not bench.wire.unsent


@given(st.binary(max_size=300))
def test_no_bytes_are_believed_without_the_key(data: bytes) -> None:
    frame = beat(sender(bytes(32)))
    stream, signing = FrameStream(), Signing(KEY, lambda _: None)
    found, frames = stream.push(data + frame + data, BEGIN_US, last=True)
    assert len(signing.check(found, frames)) == 0


@pytest.mark.parametrize(
    "write", [lambda key: key, lambda key: key.hex().encode(), lambda key: key.hex().upper().encode() + b"\n"]
)
def test_a_key_is_read_from_a_file(write: Callable[[bytes], bytes], tmp_path: Path) -> None:
    path = tmp_path / "key"
    path.write_bytes(write(KEY))
    assert read_key(str(path)) == KEY


def test_a_key_is_given_in_digits_or_by_a_passphrase(tmp_path: Path) -> None:
    assert read_key(KEY.hex()) == KEY
    assert read_key("a secret") == KEY
    (tmp_path / "phrase").write_text("a secret\n")
    assert read_key(str(tmp_path / "phrase")) == KEY
    with pytest.raises(UsageError, match="empty"):
        read_key("")


def test_only_allowed_systems_are_believed() -> None:
    said: list[str] = []
    belief = Belief(systems=frozenset({2, 4}), say=said.append)
    data, frames = FrameStream().push(b"".join(beat(sender(None, system=k)) for k in (1, 2, 3, 4, 1)), 0, last=True)
    assert belief.allowed(belief.signed(data, frames))["system"].tolist() == [2, 4]
    assert len(said) == 1
    assert list(belief.report()) == ["3 frames of systems that are not allowed (1, 3) were left out"]


def over(links: list[tuple[int, int, bytes]]) -> tuple[NDArray[np.uint8], NDArray[np.void], NDArray[np.int64]]:
    """Frames of (link, stamp, bytes) as the duplicates are told of them."""
    stream = FrameStream()
    pieces = [stream.push(frame, stamp, last=True) for _, stamp, frame in links]
    frames = np.concatenate([found for _, found in pieces])
    frames["offset"] += np.concatenate([[0], np.cumsum([len(data) for data, _ in pieces])[:-1]])
    return np.concatenate([data for data, _ in pieces]), frames, np.array([link for link, _, _ in links])


def test_what_came_over_another_link_is_dropped_within_a_window() -> None:
    wire = sender(None)
    one, two = beat(wire), (setattr(wire, "seq", 1), beat(wire))[1]
    seen = [(0, 0, one), (1, 5, one), (1, 9, two), (0, 12, two), (1, WINDOW_US + 1, one), (1, WINDOW_US + 2, one)]
    duplicates = Duplicates()
    assert duplicates.are_new(*over(seen)).tolist() == [True, False, True, False, True, True]
    assert list(duplicates.report()) == ["2 frames came over a second link too, and were used once"]


def test_the_same_sequence_with_other_content_is_no_duplicate(flight: Frames) -> None:
    a, b = flight[0][1], flight[256][1]
    wire = sender(None)
    x, y = beat(wire), mavlink.MAVLink_heartbeat_message(2, 3, 0, 1, 4, 3).pack(wire)
    assert Duplicates().are_new(*over([(0, 0, a), (1, 1, b), (0, 2, x), (1, 3, y)])).all()


def test_duplicates_do_not_depend_on_how_the_frames_are_cut(flight: Frames) -> None:
    seen = [
        (k % 2, k, frame) for k, (_, frame) in enumerate(pair for record in flight[:50] for pair in (record, record))
    ]
    whole = Duplicates().are_new(*over(seen))
    assert whole.tolist() == [True, False] * 50
    cut = Duplicates()
    assert np.concatenate([cut.are_new(*over(seen[k : k + 3])) for k in range(0, 100, 3)]).tolist() == whole.tolist()


def test_what_is_remembered_of_a_flood_is_bounded() -> None:
    duplicates = Duplicates()
    wire = sender(None)
    frames = over([(0, 0, mavlink.MAVLink_heartbeat_message(2, 3, 0, k, 4, 3).pack(wire)) for k in range(2000)])
    for system in range(60):
        frames[1]["system"] = system
        duplicates.are_new(*frames)
    assert len(duplicates._seen) == MOST


def test_merged_recordings_hold_what_came_twice_once(flight: Frames, tmp_path: Path) -> None:
    paths = [tmp_path / "a.tlog", tmp_path / "b.tlog"]
    paths[0].write_bytes(tlog(flight))
    paths[1].write_bytes(tlog([(stamp + 40_000, frame) for stamp, frame in flight[100:]]))
    merged = merge([read_tlog(path) for path in paths])
    assert len(merged.frames) == len(flight)
    assert not merged.log.any()
