"""Bytes that nobody meant: through the frame scanner guided by coverage, then through the whole service.

    python -m benchmarks fuzz [--seconds 60] [--megabytes 10]

The scanner, uncompiled, is driven by atheris (libFuzzer) from a corpus of MAVLink 1 and 2 frames, signed and not. However the bytes are cut
into chunks the same frames must come out, every byte must be counted once, and what is kept must be bounded. Then a flight whose frames
are flipped, cut, filled with noise, or changed within and given a valid CRC again goes through scanner, decoder and the estimators of
all vehicles that arise; resident memory is printed on the way. Exit code 1 when anything is raised, or the memory of one vehicle grows.
"""

import argparse
import os
import random
import resource
import socket
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

SETTLED_MB = 2
GROWTH = 0.05
GUIDED = "MAVKF_FUZZ_GUIDED"  # in the environment of the process that libFuzzer takes over
CHUNK = 40  # frames handed to the service at once


def flight(folder: Path) -> list[bytes]:
    """The frames of a simulated flight."""
    import numpy as np

    from mavkf.link.framing import scan_records
    from mavkf.replay.simulation import simulate

    path = folder / "flight.tlog"
    simulate(path, duration_s=60.0)
    data = path.read_bytes()
    frames, _ = scan_records(np.frombuffer(data, np.uint8))
    starts = frames["offset"] - np.where(frames["version"] == 2, 10, 6)
    return [data[start : start + size] for start, size in zip(starts.tolist(), frames["size"].tolist(), strict=True)]


def write_corpus(folder: Path) -> None:
    """Leave frames of both versions, signed and not, as files."""
    from pymavlink.dialects.v20 import all as dialect

    messages = [
        dialect.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3),
        dialect.MAVLink_raw_imu_message(1_000_000, 1, 2, -1000, 3, 4, 5, 220, 10, 430),
        dialect.MAVLink_gps_raw_int_message(1_000_000, 3, 473977418, 85455938, 488_000, 80, 120, 3, 0, 12),
    ]
    for old, signed in ((True, False), (False, False), (False, True)):
        sender = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
        if signed:
            sender.signing.secret_key, sender.signing.timestamp = bytes(32), 1
            sender.signing.sign_outgoing = True
        packed = [bytes(message.pack(sender, force_mavlink1=old)) for message in messages]
        for k, content in enumerate((*packed, b"".join(packed))):
            (folder / f"{old}-{signed}-{k}").write_bytes(content)


def guided(corpus: str, seconds: int) -> None:
    """Let libFuzzer drive the scanner; it ends the process."""
    import atheris
    import numpy as np

    with atheris.instrument_imports(include=["mavkf.link.framing", "mavkf.link.crc"]):
        from mavkf.link.framing import FRAME, FrameCounts, scan
    from mavkf.link.layouts import frame_table

    table = frame_table()

    def found(chunks: Sequence[bytes]) -> tuple[list[Any], Any]:
        """Scan as FrameStream does; its array does not let uncompiled code reach fields as attributes."""
        pending, frames, counts = b"", [], np.zeros(len(FrameCounts.__annotations__), np.int64)
        for k, chunk in enumerate(chunks):
            data = np.frombuffer(pending + chunk, np.uint8)
            of_chunk = np.recarray(data.size // 8 + 1, FRAME)
            number, consumed = scan(data, 0, 0, k == len(chunks) - 1, table, of_chunk, counts)
            pending = data[consumed:].tobytes()
            assert len(pending) <= 280
            for one in of_chunk[:number]:
                begin, end = int(one["offset"]), int(one["offset"]) + int(one["length"])
                frames.append((one["message"], one["system"], one["sequence"], data[begin:end].tobytes()))
        return frames, FrameCounts(*counts.tolist())

    def check(content: bytes) -> None:
        cut = content[0] % (len(content) + 1) if content else 0
        whole, counts = found([content])
        pieces, counts_of_pieces = found([content[:cut], content[cut:]])
        assert pieces == whole, "the frames depend on where the bytes were cut"
        for one in (counts, counts_of_pieces):  # what damage is called may depend on it
            known = one.frame_bytes + one.bad_bytes + one.unknown_bytes + one.tail_bytes + one.stray_bytes
            assert known == len(content), f"{one} of {len(content)} bytes"

    atheris.Setup(
        [
            "fuzz",
            corpus,
            f"-max_total_time={seconds}",
            "-max_len=600",
            "-print_final_stats=1",
            f"-artifact_prefix={corpus}/",
        ],
        check,
    )
    atheris.Fuzz()


def mutated(frames: Sequence[bytes], rng: random.Random, forged: bool) -> bytes:
    """Give the next of the frames for the service, in six of eight cases damaged; forged: senders are made up too."""
    frame = bytearray(rng.choice(frames))
    match kind := rng.randrange(8):
        case 0:
            return rng.randbytes(rng.randrange(300))
        case 1:
            return bytes(frame[: rng.randrange(len(frame))])
        case 2:
            frame[rng.randrange(len(frame))] ^= rng.randrange(1, 256)
        case 3 | 4 | 5:  # valid, and nonsense: this reaches the estimator
            begin = (
                3 if forged and kind == 3 else 10 if frame[0] == 0xFD else 6
            )  # of the header too, or of the payload only
            for _ in range(rng.randrange(1, 9)):
                frame[rng.randrange(begin, len(frame) - 2)] = rng.randrange(256)
            seal(frame)
    return bytes(frame)


def seal(frame: bytearray) -> None:
    """Give an unsigned frame the CRC of what it holds."""
    from pymavlink.dialects.v20 import all as dialect
    from pymavlink.generator.mavcrc import x25crc

    number = int.from_bytes(frame[7:10], "little") if frame[0] == 0xFD else frame[5]
    kind = dialect.mavlink_map.get(number)
    if kind is not None:
        crc = x25crc(bytes(frame[1:-2]) + bytes([kind.crc_extra])).crc
        frame[-2:] = crc.to_bytes(2, "little")


def through_service(megabytes: float, *, forged: bool, seed: int = 1) -> dict[str, float]:
    """Send bytes through scanner, decoder and estimators; return counts, and resident MB after 2 MB and at the end."""
    from mavkf.link.framing import FrameStream
    from mavkf.publish.session import publishing_session
    from mavkf.service.fleet import Fleet, Options

    with socket.socket() as probe:  # a place of its own to meet
        probe.bind(("127.0.0.1", 0))
        os.environ["MAVKF_RENDEZVOUS"] = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    rng = random.Random(seed)
    with tempfile.TemporaryDirectory() as folder:
        frames = flight(Path(folder))
    stream, sent, vehicles, position = FrameStream(), 0, 0, 0
    memory: dict[int, float] = {}
    with publishing_session(listen=(), connect=(), config_file=None) as session:
        fleet = Fleet(session, Options(quiet=True), lambda _: None)
        while sent < megabytes * 1e6:
            # a window that moves on as the flight does, so that there is time to be estimated in
            window = frames[position % (len(frames) - CHUNK) :][:CHUNK]
            position += CHUNK // 4
            chunk = b"".join(mutated(window, rng, forged) for _ in range(CHUNK))
            sent += len(chunk)
            fleet.take(*stream.push(chunk, 1_760_000_000_000_000 + position * 2500))
            fleet.look_after()
            vehicles = max(vehicles, len(fleet.vehicles))
            if sent // 1_000_000 not in memory:
                memory[sent // 1_000_000] = resident_mb()
                print(f"{sent / 1e6:6.1f} MB sent, {memory[sent // 1_000_000]:7.1f} MB resident", flush=True)
        end = resident_mb()
        fleet.finish()  # each of the vehicles is estimated with what it has given
        fleet.close()
        poses = fleet.poses
    settled = memory.get(SETTLED_MB, end)
    return {
        "bytes": sent,
        "frames": stream.counts.frames,
        "vehicles": vehicles,
        "poses": poses,
        "settled_mb": settled,
        "end_mb": end,
        "finished_mb": resident_mb(),
    }


def resident_mb() -> float:
    """Resident memory of this process now, MB."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 1e6


def main(arguments: Sequence[str]) -> int:
    """Run both; exit code 1 when anything was raised."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks fuzz", description=__doc__)
    parser.add_argument("--seconds", type=int, default=60, help="of the scanner, guided by coverage")
    parser.add_argument("--megabytes", type=float, default=10.0, help="through the whole service; 0 for none")
    options = parser.parse_args(arguments)
    if corpus := os.environ.get(GUIDED):
        guided(corpus, options.seconds)
    with tempfile.TemporaryDirectory() as folder:
        write_corpus(Path(folder))
        command = [sys.executable, "-m", "benchmarks", "fuzz", "--seconds", str(options.seconds)]
        run = subprocess.run(command, env=os.environ | {GUIDED: folder, "NUMBA_DISABLE_JIT": "1"}, check=False)
    if run.returncode:
        return 1
    if options.megabytes:
        for forged in (False, True):
            print("made-up senders too" if forged else "one vehicle")
            found = through_service(options.megabytes, forged=forged)
            print(", ".join(f"{name} {value:,.0f}" for name, value in found.items()))
            # of made-up senders as many are followed as the service ever follows; until they are, memory grows
            if not forged and found["end_mb"] > found["settled_mb"] * (1.0 + GROWTH):
                print(f"memory has grown by more than {GROWTH:.0%}")
                return 1
    return 0
