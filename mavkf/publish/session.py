"""Zenoh sessions that find each other on one machine without set-up, and are closed to the network unless asked.

A publisher listens on the rendezvous (tcp/127.0.0.1:7447) if nothing does; every session listens on a free loopback
port beside it, and tries the rendezvous for ever. Both are needed: two peers that only connect to a third do not see
each other. When the holder of the rendezvous dies, zenoh's own retry gives it to a surviving publisher.
"""

import errno
import json
import os
import re
import socket
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import zenoh

from mavkf.errors import EndpointError, UsageError

RENDEZVOUS = "tcp/127.0.0.1:7447"
"""Where sessions of one machine meet; the environment variable MAVKF_RENDEZVOUS names another place."""

_FREE_PORT = "tcp/127.0.0.1:0"
_RETRY = {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 2.0}
_PATIENCE_S = 1.0  # how long an asked endpoint may take before it is said that it is not there
_CLOSING_S = 0.5  # how long a session may take to close
_STRANGER_S = 3.0  # how long whoever holds the rendezvous may take to show that it speaks zenoh
_OTHER = re.compile(r"(serial|vsock|unixsock-stream|unixpipe)/\S+")
_HOST_PORT = re.compile(
    r"(?P<protocol>tcp|tls|udp|quic|ws)/(\[(?P<six>[^\]]+)\]|(?P<host>[^:\s]+)):(?P<port>\d{1,5})([?#]\S*)?"
)


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def open_session(
    *,
    publishes: bool,
    listen: Sequence[str] = (),
    connect: Sequence[str] = (),
    config_file: Path | None = None,
    rendezvous: str | None = None,
    say: Callable[[str], None] = _say,
    stopped: Callable[[], bool] = lambda: False,
) -> zenoh.Session:
    """Open a session; close it, or use it in a `with`.

    Args:
        publishes: it publishes, so it may hold the rendezvous.
        listen: endpoints to be reached at besides, such as "tcp/0.0.0.0:7448".
        connect: endpoints to go to besides; one that is not there yet is said once and tried for ever.
        config_file: a zenoh configuration (JSON5) to use as it is instead of the above, plus `listen` and `connect`.
        rendezvous: where the sessions of this machine meet; default MAVKF_RENDEZVOUS or `RENDEZVOUS`.
        say: takes the sentences for the user; default to stderr.
        stopped: asked while a client waits for its router; True: that is given up.

    Raises:
        KeyboardInterrupt: `stopped` said so.
        UsageError: an endpoint or the configuration file is not what zenoh takes.
        EndpointError: an endpoint to listen on cannot be opened.

    """
    meeting = rendezvous or os.environ.get("MAVKF_RENDEZVOUS") or RENDEZVOUS
    _check_endpoint("MAVKF_RENDEZVOUS", meeting)
    for endpoint in connect:
        _check_endpoint("--connect", endpoint)
    for endpoint in listen:
        _check_endpoint("--listen", endpoint)
        _check_free(endpoint)

    if config_file is None:
        config = _loopback_config()
        # what was asked for comes first: it may be the rendezvous port on all interfaces
        _insert(config, "listen/endpoints", [*listen, *([meeting] if publishes else []), _FREE_PORT])
        _insert(config, "connect/endpoints", [*connect, meeting])
    else:
        config = _user_config(config_file)
        for name, extra in (("listen/endpoints", listen), ("connect/endpoints", connect)):
            if extra:
                _insert(config, name, _extended(json.loads(config.get_json(name)), list(extra)))
    held = config_file is None and _is_taken(meeting)
    try:
        session = _open(config, say, stopped)
    except zenoh.ZError as error:
        source = f"--zenoh-config {config_file}" if config_file else "the zenoh session"
        raise EndpointError(f"{source} cannot be opened: {_short(error)}") from error
    if connect:
        timer = threading.Timer(_PATIENCE_S, _tell_absent, (session, list(connect), say))
        timer.daemon = True
        timer.start()
    if held:
        timer = threading.Timer(_STRANGER_S, _tell_stranger, (session, meeting, say))
        timer.daemon = True
        timer.start()
    return session


def _open(config: zenoh.Config, say: Callable[[str], None], stopped: Callable[[], bool]) -> zenoh.Session:
    """Open a session; zenoh holds up whoever opens that of a client until its router is there, so that is done in a thread."""
    if json.loads(config.get_json("mode")) != "client":
        return zenoh.open(config)
    opened: list[zenoh.Session | zenoh.ZError] = []

    def work() -> None:
        try:
            opened.append(zenoh.open(config))
        except zenoh.ZError as error:
            opened.append(error)

    opener = threading.Thread(target=work, daemon=True)
    opener.start()
    opener.join(_PATIENCE_S)
    if not opened:
        say(f"mavkf: nothing answers at {', '.join(_endpoints(config))} yet; nothing begins before the router is there")
        _closers.append(opener)  # also where the wait is interrupted
    while not opened:
        opener.join(0.1)
        if stopped():
            raise KeyboardInterrupt
    if isinstance(opened[0], zenoh.ZError):
        raise opened[0]
    return opened[0]


def _endpoints(config: zenoh.Config) -> list[str]:
    found = json.loads(config.get_json("connect/endpoints"))
    return list(found.get("client") or []) if isinstance(found, dict) else list(found or [])


@contextmanager
def publishing_session(
    *,
    listen: Sequence[str] = (),
    connect: Sequence[str] = (),
    config_file: Path | None = None,
    stopped: Callable[[], bool] = lambda: False,
) -> Iterator[zenoh.Session]:
    """A session of `open_session` that publishes, closed at the end, within a moment.

    While another process holds the rendezvous, zenoh's close waits ten seconds for its own listen retry and then
    fails: it is left to a thread that the end of the process ends.
    """
    session = open_session(publishes=True, listen=listen, connect=connect, config_file=config_file, stopped=stopped)
    try:
        yield session
    finally:
        closer = threading.Thread(target=_close, args=(session,), daemon=True)
        _closers.append(closer)
        closer.start()
        closer.join(_CLOSING_S)


_closers: list[threading.Thread] = []


def is_closing() -> bool:
    """Whether zenoh is still busy with the close of a session of `publishing_session`, or with an opening that was given up."""
    return any(closer.is_alive() for closer in _closers)


def _close(session: zenoh.Session) -> None:
    with suppress(zenoh.ZError):
        session.close()  # type: ignore[no-untyped-call]


def _loopback_config() -> zenoh.Config:
    config = zenoh.Config()
    _insert(config, "mode", "peer")
    _insert(config, "scouting/multicast/enabled", False)
    # Gossip tells peers of each other's loopback ports, so that they stay connected without the one they met at.
    _insert(config, "scouting/gossip/enabled", True)
    _insert(config, "timestamping/enabled", True)
    # Room for the burst with which a session begins: with the two batches that are zenoh's default a reader that is there in time
    # still misses some of it.
    _insert(config, "transport/link/tx/queue/size/data", 16)
    _insert(config, "transport/link/tx/queue/congestion_control/drop/wait_before_drop", 10_000)  # microseconds
    for side in ("listen", "connect"):
        _insert(config, f"{side}/timeout_ms", -1)  # for ever: 0 would never retake the rendezvous
        _insert(config, f"{side}/exit_on_failure", False)
        _insert(config, f"{side}/retry", _RETRY)
    return config


def _user_config(path: Path) -> zenoh.Config:
    try:
        return zenoh.Config.from_file(str(path))
    except (zenoh.ZError, OSError) as error:
        reason = _short(error) if path.is_file() else "there is no such file"
        raise UsageError(f"--zenoh-config {path}: {reason}; give a zenoh configuration in JSON5") from error


def _extended(present: Any, extra: list[str]) -> Any:
    if isinstance(present, dict):  # one list for each mode
        return {mode: [*(endpoints or []), *extra] for mode, endpoints in present.items()}
    return [*(present or []), *extra]


def _insert(config: zenoh.Config, name: str, value: Any) -> None:
    try:
        config.insert_json5(name, json.dumps(value))
    except zenoh.ZError as error:
        raise UsageError(f"zenoh does not take {value!r} as {name}: {_short(error)}") from error


def _check_endpoint(option: str, endpoint: str) -> None:
    match = _HOST_PORT.fullmatch(endpoint)
    good = int(match["port"]) <= 65535 if match else _OTHER.fullmatch(endpoint) is not None
    if not good:
        raise UsageError(
            f"{option} {endpoint!r} is not a zenoh endpoint: write protocol/address:port, as in tcp/192.168.1.5:7447"
        )


def _check_free(endpoint: str) -> None:
    """Raise EndpointError if a TCP endpoint to listen on cannot be had; zenoh itself would retry without a word."""
    error = _bind_error(endpoint, listening=True)
    if error is not None:
        raise EndpointError(
            f"--listen {endpoint} cannot be opened ({error.strerror}): choose a free port of an address of this machine"
        ) from error


def _bind_error(endpoint: str, *, listening: bool) -> OSError | None:
    """Why a TCP endpoint cannot be had; None if it can, or is of another kind. Without `listening` nobody notices the try."""
    match = _HOST_PORT.fullmatch(endpoint)
    if match is None or match["protocol"] in ("udp", "quic"):
        return None
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            match["six"] or match["host"], int(match["port"]), type=socket.SOCK_STREAM
        )[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
            if listening:
                probe.listen(1)
    except OSError as error:
        return error
    return None


def _is_taken(endpoint: str) -> bool:
    error = _bind_error(endpoint, listening=False)
    return error is not None and error.errno == errno.EADDRINUSE


def _tell_stranger(session: zenoh.Session, meeting: str, say: Callable[[str], None]) -> None:
    """Say that the rendezvous is held by something that is no zenoh: then nobody finds anybody."""
    if _links(session) == [] and _is_taken(meeting):
        say(
            f"mavkf: {meeting}, where publishers and subscribers meet, is taken by a program that does not speak zenoh: "
            "end that program, or set MAVKF_RENDEZVOUS to another place, as in tcp/127.0.0.1:7450"
        )


def _tell_absent(session: zenoh.Session, asked: list[str], say: Callable[[str], None]) -> None:
    links = _links(session)
    if links is None:
        return
    reached = {link.dst.split("?")[0].split("#")[0] for link in links}
    for endpoint in asked:
        if not reached & _locators(endpoint):
            say(f"mavkf: nothing answers at {endpoint} yet; it is tried again until something does")


def _links(session: zenoh.Session) -> list[zenoh.Link] | None:
    """The links of a session; None: it is closed, or another thread is at it just now, of which zenoh's Python makes a RuntimeError."""
    try:
        return None if session.is_closed() else list(session.info.links())
    except (RuntimeError, zenoh.ZError):
        return None


def _locators(endpoint: str) -> set[str]:
    """Give the names that zenoh may show for an endpoint: host names become addresses."""
    match = _HOST_PORT.fullmatch(endpoint)
    if match is None:
        return {endpoint}
    try:
        found = socket.getaddrinfo(match["six"] or match["host"], int(match["port"]))
    except OSError:
        return set()
    hosts = {f"[{address[0]}]" if family == socket.AF_INET6 else address[0] for family, *_, address in found}
    return {f"{match['protocol']}/{host}:{match['port']}" for host in hosts}


def _short(error: Exception) -> str:
    """Give zenoh's reason on one line, without the places in its own source."""
    return " ".join(re.sub(r"\s+at /\S+", "", str(error)).split()).rstrip(".")[:300]
