"""Whatever bytes come, over whichever links: nothing is raised, nothing grows, and what is whole is found."""

import random
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from mavkf.link.framing import FrameStream
from mavkf.service import duplicates as duplicates_module
from mavkf.service.belief import Belief
from mavkf.service.endpoints import Link
from mavkf.service.inbox import Chunk
from mavkf.service.signing import Signing
from mavkf.service.talk import MOST_TALKS, Manners, Talk
from mavkf.service.worker import Worker

from .conftest import BEGIN_US, Frames
from .test_conversation import Wire


class Fleet:
    """Takes the place of the vehicles."""

    given_up: frozenset[tuple[int, int]] = frozenset()
    is_late = False

    def __init__(self) -> None:
        self.frames = 0

    def take(self, data: NDArray[np.uint8], frames: NDArray[np.void]) -> None:
        assert (frames["offset"] + frames["length"] <= data.size).all()
        assert (np.diff(frames["stamp"]) >= 0).all()
        self.frames += len(frames)


class WayIn:
    """From chunks of three links to the vehicles, as the service has it."""

    def __init__(self, belief: Belief, manners: Manners) -> None:
        self.wires: list[Link] = [Wire(), Wire(local=False, baud=57600), Wire(local=None)]
        self.talks = [Talk(wire, number, manners) for number, wire in enumerate(self.wires)]
        self.fleet = Fleet()
        self.worker = Worker(self.fleet, self.wires, [], self.talks, belief, [FrameStream() for _ in self.wires])  # type: ignore[arg-type]
        self.now_us = BEGIN_US

    def take(self, chunks: list[tuple[int, bytes, bool]]) -> None:
        batch = []
        for link, data, last in chunks:
            self.now_us += 1000
            batch.append(Chunk(link, self.now_us, data, last))
        self.worker.take(batch)
        self.worker.speak()

    def assert_bounded(self) -> None:
        assert all(len(talk.conversations) <= MOST_TALKS for talk in self.talks)
        assert len(self.worker.duplicates._seen) <= duplicates_module.MOST
        assert sum(len(stream._pending) for stream in self.worker.streams) <= 3 * 280


BELIEFS: dict[str, Callable[[], Belief]] = {
    "all": Belief,
    "signed": lambda: Belief(signing=Signing(bytes(32), lambda _: None)),
    "lenient": lambda: Belief(signing=Signing(bytes(32), lambda _: None, allow_unsigned=True), systems=frozenset({1})),
}


@settings(max_examples=100, deadline=None)
@given(st.data())
def test_no_bytes_upset_the_way_in(flight: Frames, data: st.DataObject) -> None:
    way = WayIn(
        BELIEFS[data.draw(st.sampled_from(list(BELIEFS)))](),
        Manners(request=data.draw(st.sampled_from([None, True, False]))),
    )
    frames = st.integers(0, 200).map(lambda k: flight[k][1])
    mutated = st.builds(mutate, frames, st.integers(0, 60), st.integers(1, 255))
    piece = st.one_of(frames, mutated, st.binary(max_size=60), frames.map(lambda frame: frame[: len(frame) // 2]))
    chunk = st.tuples(st.integers(0, 2), st.lists(piece, max_size=4).map(b"".join), st.booleans())
    for chunks in data.draw(st.lists(st.lists(chunk, max_size=6), max_size=6)):
        way.take(chunks)
    way.assert_bounded()


def mutate(frame: bytes, at: int, bits: int) -> bytes:
    at %= len(frame)
    return frame[:at] + bytes([frame[at] ^ bits]) + frame[at + 1 :]


@pytest.mark.parametrize("belief", list(BELIEFS))
def test_a_long_mess_upsets_nothing_and_hides_nothing(flight: Frames, belief: str) -> None:
    rng = random.Random(belief)
    way = WayIn(BELIEFS[belief](), Manners(request=True))
    whole = 0
    for k in range(0, 1000, 8):
        chunks = []
        for _, frame in flight[k : k + 8]:
            kind = rng.randrange(4)
            mess = (mutate(frame, rng.randrange(len(frame)), rng.randrange(1, 256)), rng.randbytes(rng.randrange(300)))
            chunks.append((rng.randrange(3), mess[kind] if kind < 2 else frame, True))
            whole += kind >= 2
        way.take(chunks)
    way.assert_bounded()
    assert (whole <= way.fleet.frames <= whole + 5) == (belief == "all")
    assert (way.fleet.frames == 0) == (belief == "signed")
