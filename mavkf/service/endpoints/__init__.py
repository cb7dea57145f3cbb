"""Where telemetry comes from: one registry, one syntax (`KINDS`); anything else is the path of a log.

What a link gives away has no stamp yet: the `Inbox` takes the arrival stamp, once.
"""

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import zenoh

from mavkf.errors import LogError, UsageError
from mavkf.publish.session import open_session
from mavkf.service.endpoints.link import POLL_S, Link, Say
from mavkf.service.endpoints.network import host_port
from mavkf.service.endpoints.serial_port import SerialPort, path_baud
from mavkf.service.endpoints.stdin import StandardInput
from mavkf.service.endpoints.tcp import TcpClient, TcpListener
from mavkf.service.endpoints.udp import UdpClient, UdpListener
from mavkf.service.endpoints.zenoh_key import ZenohKey

__all__ = ["KINDS", "POLL_S", "Kind", "Link", "Say", "source"]

Session = Callable[[], zenoh.Session]
_SCHEME = re.compile(r"(?P<scheme>[a-z][a-z0-9]*):(?P<rest>.*)", re.DOTALL)


class Kind(NamedTuple):
    """One kind of link: how it is written, what it is, and what makes it from its whole name and what follows the colon."""

    syntax: str
    meaning: str
    make: Callable[[str, str, Session, Say], Link]


KINDS: dict[str, Kind] = {
    "udpin": Kind(
        "udpin:HOST:PORT",
        "listen for datagrams",
        lambda name, rest, _, say: UdpListener(name, *host_port(name, rest), say),
    ),
    "udpout": Kind(
        "udpout:HOST:PORT",
        "send datagrams there first, and listen for the answers",
        lambda name, rest, _, say: UdpClient(name, *host_port(name, rest), say),
    ),
    "tcp": Kind(
        "tcp:HOST:PORT",
        "connect to a server",
        lambda name, rest, _, say: TcpClient(name, *host_port(name, rest), say),
    ),
    "tcpin": Kind(
        "tcpin:HOST:PORT",
        "be the server, for one connection at a time",
        lambda name, rest, _, say: TcpListener(name, *host_port(name, rest), say),
    ),
    "serial": Kind(
        "serial:PATH:BAUD",
        "a serial port",
        lambda name, rest, _, say: SerialPort(name, *path_baud(name, rest), say),
    ),
    "zenoh": Kind(
        "zenoh:KEY",
        "raw MAVLink frames on a zenoh key, as mavlink_raw/out",
        ZenohKey,
    ),
    "stdin": Kind("stdin", "raw MAVLink from standard input", lambda _, __, ___, say: StandardInput("stdin", say)),
}
"""Every kind of link by its scheme."""


def source(text: str, say: Say, session: Session = lambda: open_session(publishes=False)) -> Link | Path:
    """Give the link or the log that a SOURCE of the command line means; nothing is opened.

    say: takes what the link has to tell while it runs, also from its thread. session: opens a zenoh session.

    Raises UsageError for an unknown scheme or a malformed address, LogError for a log that is not there.
    """
    if os.path.exists(text):  # not Path.exists, which raises where a name is too long for a file
        return Path(text)
    if text == "stdin":
        return KINDS["stdin"].make(text, "", session, say)
    match = _SCHEME.fullmatch(text)
    if match is None:
        raise LogError(f"{text} does not exist; check the name and the folder, or give {_syntax('udpin', 'tcp')}")
    kind = KINDS.get(match["scheme"])
    if kind is None:
        raise UsageError(f"{text}: there is no source {match['scheme']}:, only {_syntax(*KINDS)} or the path of a log")
    return kind.make(text, match["rest"], session, say)


def _syntax(*schemes: str) -> str:
    return ", ".join(KINDS[scheme].syntax for scheme in schemes)
