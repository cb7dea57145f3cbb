"""Frames found in whole, cut, flipped and foreign bytes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.generator.mavcrc import x25crc

from mavkf.link.crc import frame_crc
from mavkf.link.framing import FrameStream, Scanner, scan_records

from ._wire import array, frame, record

T0 = 1_500_000_000_000_000
ATTITUDES = [frame("ATTITUDE", time_boot_ms=1000 + i, roll=0.1 * i, yaw=1.1, sequence=i) for i in range(20)]
TLOG = b"".join(record(T0 + 1000 * i, f) for i, f in enumerate(ATTITUDES))


def fields(frames: np.ndarray, *names: str) -> list[tuple[int, ...]]:
    return [tuple(int(one[name]) for name in names) for one in frames]


@given(st.binary(max_size=300), st.integers(0, 255))
def test_crc_is_pymavlinks(data: bytes, extra: int) -> None:
    expected = x25crc(data + bytes([extra])).crc
    assert frame_crc(array(data), 0, len(data), extra) == expected


@pytest.mark.parametrize(
    ("version", "signed", "header", "size"), [(1, False, 6, 36), (2, False, 10, 28), (2, True, 10, 41)]
)
def test_both_versions_and_signatures(version: int, signed: bool, header: int, size: int) -> None:
    raw = frame(
        "ATTITUDE",
        version=version,
        signed=signed,
        system=7,
        component=9,
        sequence=200,
        time_boot_ms=5,
        pitch=1.5,
        yaw=2.0,
    )
    frames, counts = scan_records(array(record(T0, raw)))
    # MAVLink 2 cuts the three rates of zero, four bytes each, from the end of the payload of 28.
    assert len(raw) == size
    assert fields(frames, "offset", "stamp", "message", "size", "system", "component", "sequence", "version") == [
        (8 + header, T0, 30, size, 7, 9, 200, version)
    ]
    assert counts.frames == 1
    assert counts.frame_bytes == size + 8


def test_a_stream_without_stamps() -> None:
    frames, counts = scan_records(array(b"".join(ATTITUDES)), stamped=False)
    assert [int(s) for s in frames["sequence"]] == list(range(20))
    assert counts.frames == 20
    assert counts.stray_bytes == 0


def test_stray_bytes_before_a_frame_are_counted_and_cost_nothing() -> None:
    cut = len(record(T0, ATTITUDES[0])) * 3
    frames, counts = scan_records(array(TLOG[:cut] + b"\xfd\xfe\x09" + TLOG[cut:]))
    assert counts.frames == 20
    assert counts.stray_bytes == 3
    assert [int(s) for s in frames["stamp"]] == [T0 + 1000 * i for i in range(20)]


def test_orphan_stamps_are_stray_bytes_and_the_frame_keeps_its_own() -> None:
    orphan = (T0 + 1).to_bytes(8, "big")
    frames, counts = scan_records(array(orphan * 3 + record(T0 + 500, ATTITUDES[0]) + orphan + TLOG))
    assert counts.frames == 21
    assert counts.stray_bytes == 32
    assert int(frames["stamp"][0]) == T0 + 500
    assert int(frames["stamp"][1]) == T0


def test_magic_bytes_inside_stamps_do_not_lead_astray() -> None:
    stamps = [0x0005_FDFE_FDFE_FD00 + i for i in range(20)]
    frames, counts = scan_records(array(b"".join(record(s, f) for s, f in zip(stamps, ATTITUDES, strict=True))))
    assert [int(s) for s in frames["stamp"]] == stamps
    assert counts.stray_bytes == 0


def test_a_flipped_byte_costs_one_frame_that_is_counted_whole() -> None:
    raw = bytearray(TLOG)
    size = len(record(T0, ATTITUDES[0]))
    raw[size * 0 + 8 + 12] ^= 0x40
    frames, counts = scan_records(array(bytes(raw)))
    assert (counts.frames, counts.bad_crc, counts.bad_bytes, counts.stray_bytes) == (19, 1, size, 0)
    assert int(frames["sequence"][0]) == 1


def test_bytes_missing_from_a_frame_cost_that_frame_only() -> None:
    size = len(record(T0, ATTITUDES[0]))
    frames, counts = scan_records(array(TLOG[: size + 20] + TLOG[size + 25 :]))
    # Frame 1 lacks five bytes; its length runs into the stamp of the next, whose frame is found all the same.
    assert 1 not in frames["sequence"]
    assert counts.frames == 19
    assert counts.stray_bytes == len(record(T0, ATTITUDES[1])) - 5


def test_bytes_missing_from_a_stamp_cost_the_stamp_only() -> None:
    size = len(record(T0, ATTITUDES[0]))
    frames, counts = scan_records(array(TLOG[:size] + TLOG[size + 3 :]))
    assert counts.frames == 20
    assert int(frames["stamp"][1]) == -1
    assert counts.stray_bytes == 5


def test_a_damaged_length_does_not_swallow_the_frames_after_it() -> None:
    raw = bytearray(TLOG)
    raw[9] = 255
    _, counts = scan_records(array(bytes(raw)))
    assert counts.frames == 19


def test_an_unfinished_frame_at_the_end_is_told_from_stray_bytes() -> None:
    _, counts = scan_records(array(TLOG + record(T0, ATTITUDES[0])[:19]))
    assert (counts.frames, counts.truncated, counts.tail_bytes, counts.stray_bytes) == (20, 1, 19, 0)


def test_unknown_messages_are_frames_when_another_follows() -> None:
    unknown = bytearray(ATTITUDES[0])
    unknown[7:10] = (50_123).to_bytes(3, "little")
    raw = record(T0, ATTITUDES[0]) + record(T0, bytes(unknown)) * 2 + record(T0, ATTITUDES[1])
    frames, counts = scan_records(array(raw))
    assert [int(s) for s in frames["sequence"]] == [0, 1]
    assert (counts.unknown, counts.unknown_bytes, counts.bad_crc, counts.stray_bytes) == (
        2,
        2 * (len(unknown) + 8),
        0,
        0,
    )


def test_text_holds_no_frame() -> None:
    frames, counts = scan_records(array(b"The quick brown fox. " * 100))
    assert len(frames) == 0
    assert counts.stray_bytes == 2100


def test_a_long_log_comes_in_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    data = array(TLOG[:700] + b"\xfd\xfe\x09" + TLOG[700:])
    frames, counts = scan_records(data)
    monkeypatch.setattr("mavkf.link.framing.BLOCK", 3)
    scanner, blocks, done = Scanner(data), [], [0]
    for block in scanner:
        assert len(block) <= 3
        blocks.append(block.copy())
        done.append(scanner.position)
    assert np.array_equal(np.concatenate(blocks), frames)
    assert scanner.counts == counts
    assert done == sorted(done) and done[-1] == data.size


damage = st.lists(
    st.tuples(st.sampled_from(("flip", "insert", "cut")), st.integers(0, 10_000), st.binary(min_size=1, max_size=40)),
    max_size=8,
)


def damaged(raw: bytes, harm: list[tuple[str, int, bytes]]) -> bytes:
    data = bytearray(raw)
    for how, where, what in harm:
        at = where % (len(data) + 1)
        if how == "insert":
            data[at:at] = what
        elif how == "cut":
            del data[at : at + len(what)]
        else:
            for i, byte in enumerate(what[:4]):
                if at + i < len(data):
                    data[at + i] ^= byte
    return bytes(data)


def bytes_of(counts: object) -> int:
    return sum(getattr(counts, n) for n in ("frame_bytes", "bad_bytes", "unknown_bytes", "stray_bytes", "tail_bytes"))


@given(damage, st.booleans())
def test_whatever_the_damage_all_bytes_are_accounted_for_and_all_whole_frames_found(
    harm: list[tuple[str, int, bytes]], stamped: bool
) -> None:
    raw = damaged(TLOG if stamped else b"".join(ATTITUDES), harm)
    frames, counts = scan_records(array(raw), stamped=stamped)
    assert bytes_of(counts) == len(raw)
    assert counts.frames == len(frames)
    found = [raw[f["offset"] - 10 : f["offset"] - 10 + f["size"]] for f in frames]
    assert set(found) <= set(ATTITUDES)
    assert len(found) == sum(raw.count(one) for one in ATTITUDES)


@given(st.binary(max_size=3000), st.booleans())
def test_any_bytes_at_all(raw: bytes, stamped: bool) -> None:
    _, counts = scan_records(array(raw), stamped=stamped)
    assert bytes_of(counts) == len(raw)


@given(st.lists(st.sampled_from([0xFD, 0xFE, 0, 1, 2, 9, 33]), max_size=1500).map(bytes), st.booleans())
def test_bytes_full_of_false_beginnings(raw: bytes, stamped: bool) -> None:
    _, counts = scan_records(array(raw), stamped=stamped)
    assert bytes_of(counts) == len(raw)


@given(damage, st.lists(st.integers(1, 90), min_size=1, max_size=60))
def test_a_stream_gives_the_same_frames_however_it_is_cut(harm: list[tuple[str, int, bytes]], cuts: list[int]) -> None:
    raw = damaged(b"".join(ATTITUDES), harm)
    expected, _ = scan_records(array(raw), stamped=False)
    stream, found, at = FrameStream(), [], 0
    for i in range(len(raw) + 1):
        size = cuts[i % len(cuts)]
        last = at + size >= len(raw)
        data, frames = stream.push(raw[at : at + size], 1000 + at, last=last)
        assert (frames["stamp"] == 1000 + at).all()
        found += [data[f["offset"] - 10 : f["offset"] - 10 + f["size"]].tobytes() for f in frames]
        at += size
        if last:
            break
    assert found == [raw[f["offset"] - 10 : f["offset"] - 10 + f["size"]] for f in expected]
    assert bytes_of(stream.counts) == len(raw)


@given(damage, st.lists(st.tuples(st.integers(0, 90), st.booleans()), min_size=1, max_size=60))
def test_chunks_taken_at_once_give_what_they_give_one_by_one(
    harm: list[tuple[str, int, bytes]], cuts: list[tuple[int, bool]]
) -> None:
    raw, at, chunks = damaged(b"".join(ATTITUDES), harm), 0, []
    for k, (size, last) in enumerate(cuts):
        chunks.append((raw[at : at + size], 1000 + k, last))
        at += size
    one, all_at_once = FrameStream(), FrameStream()
    wanted = []
    for chunk, arrival, last in chunks:
        data, frames = one.push(chunk, arrival, last=last)
        wanted += [(int(f["stamp"]), frame_bytes(data, f)) for f in frames]
    half = len(chunks) // 2
    found = []
    for some in (chunks[:half], chunks[half:]):
        data, frames = all_at_once.push_all(some)
        found += [(int(f["stamp"]), frame_bytes(data, f)) for f in frames]
    assert found == wanted
    assert (all_at_once.counts, all_at_once._pending) == (one.counts, one._pending)


def frame_bytes(data: np.ndarray, frame: np.void) -> bytes:
    return bytes(data[frame["offset"] - 10 : frame["offset"] - 10 + frame["size"]].tobytes())


def test_a_stream_keeps_an_unfinished_frame_and_no_more() -> None:
    stream = FrameStream()
    for _ in range(100):
        stream.push(b"\xfd\xff\x00" * 50, 0)
    assert len(stream._pending) <= 280
    _, frames = stream.push(ATTITUDES[0] * 20, 5)
    assert len(frames) >= 10


def test_a_datagram_stands_for_itself() -> None:
    stream = FrameStream()
    stream.push(ATTITUDES[0][:20], 1, last=True)
    _, frames = stream.push(ATTITUDES[1], 2, last=True)
    assert fields(frames, "sequence", "stamp") == [(1, 2)]
    assert stream.counts.truncated == 1
