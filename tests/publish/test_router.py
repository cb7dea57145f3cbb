"""Publisher and subscriber as clients of a router that is late, dies, and returns."""

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

from mavkf.publish.publisher import Publisher
from mavkf.publish.session import open_session
from mavkf.publish.subscriber import subscribe

from .conftest import Child, make_pose

CLIENT = Path(__file__).parents[2] / "deploy" / "zenoh" / "client.json5"

ROUTER = """
import json, sys, threading, zenoh
config = zenoh.Config()
config.insert_json5("mode", '"router"')
config.insert_json5("listen/endpoints", json.dumps([sys.argv[1]]))
config.insert_json5("scouting/multicast/enabled", "false")
with zenoh.open(config):
    print("open")
    threading.Event().wait()
"""


def test_a_router_that_is_late_dies_and_returns(rendezvous: str, start: Callable[..., Child], tmp_path: Path) -> None:
    config = tmp_path / "client.json5"
    config.write_text(CLIENT.read_text().replace("tcp/router.example:7447", rendezvous))
    said: list[str] = []
    late = threading.Timer(1.5, lambda: routers.append(start(ROUTER, rendezvous)))
    routers: list[Child] = []
    late.start()
    stop = threading.Event()
    with (
        open_session(publishes=True, config_file=config, say=said.append) as session,
        Publisher(session, "1-1") as publisher,
        subscribe("1-1", config_file=config) as subscription,
    ):
        assert len(said) == 1
        assert f"nothing answers at {rendezvous} yet" in said[0]

        def publish() -> None:
            for seq in range(100_000):
                publisher.publish(make_pose(seq))
                if stop.wait(0.02):
                    return

        sender = threading.Thread(target=publish)
        sender.start()
        try:
            seqs = []
            for _ in range(3):
                pose = subscription.receive(20.0)
                assert pose is not None
                seqs.append(pose.seq)
                routers[-1].kill()
                while subscription.receive(0.3) is not None:  # what was under way
                    pass
                assert subscription.alive == frozenset()
                routers.append(start(ROUTER, rendezvous))
            assert seqs == sorted(seqs)
        finally:
            stop.set()
            sender.join()


def test_waiting_for_a_router_can_be_given_up(rendezvous: str, tmp_path: Path) -> None:
    config = tmp_path / "client.json5"
    config.write_text(CLIENT.read_text().replace("tcp/router.example:7447", rendezvous))
    words = [sys.executable, "-m", "mavkf", "serve", "udpin:127.0.0.1:0", "--zenoh-config", str(config)]
    process = subprocess.Popen(words, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    with process.stderr:
        assert "nothing answers" in process.stderr.readline()
        begin = time.monotonic()
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=10) == 130
        assert time.monotonic() - begin < 1.0
        assert process.stderr.read() == ""
