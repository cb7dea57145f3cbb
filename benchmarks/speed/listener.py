"""A process that subscribes and keeps when each sample came: `python -m benchmarks.speed.listener KEY OUT`.

Prints `ready` once it is subscribed; at the end of its stdin it writes lines of `monotonic_ns key beginning-of-payload` to OUT.
"""

import sys
import time
from pathlib import Path

import zenoh
from zenoh.handlers import Callback

from mavkf.publish.session import open_session

HEAD = 200  # bytes kept of a payload: its time is among them


def main() -> None:
    """Subscribe, wait for the end of stdin, write."""
    came: list[tuple[int, str, bytes]] = []

    def take(sample: zenoh.Sample) -> None:
        came.append((time.monotonic_ns(), str(sample.key_expr), sample.payload.to_bytes()[:HEAD]))

    with open_session(publishes=False) as session:
        subscriber = session.declare_subscriber(sys.argv[1], Callback(take, indirect=False))
        print("ready", flush=True)
        sys.stdin.buffer.read()
        subscriber.undeclare()
    with Path(sys.argv[2]).open("wb") as file:
        for at, key, head in came:
            file.write(f"{at} {key} ".encode() + head + b"\n")


if __name__ == "__main__":
    main()
