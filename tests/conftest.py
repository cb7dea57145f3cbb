"""What all tests share: no session of theirs may meet a real one on this machine."""

import socket

import pytest


@pytest.fixture(autouse=True)
def rendezvous(monkeypatch: pytest.MonkeyPatch) -> str:
    """A place of its own for every test's zenoh sessions, and those of its processes, to meet."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    monkeypatch.setenv("MAVKF_RENDEZVOUS", endpoint)
    return endpoint
