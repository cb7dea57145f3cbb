"""Addresses: how they are written, which of them are near, and what to do about one that cannot be opened."""

import errno
import ipaddress
import re
import socket
import struct
from collections.abc import Iterator

from mavkf.errors import EndpointError, UsageError
from mavkf.service.endpoints.link import reason

_HOST_PORT = re.compile(r"(\[(?P<six>[0-9A-Fa-f:.%\w]+)\]|(?P<host>[^:\s\[\]]+)):(?P<port>\d{1,5})")
_SIOCGIFADDR, _SIOCGIFNETMASK = 0x8915, 0x891B


def host_port(name: str, rest: str) -> tuple[str, int]:
    """Split what follows the scheme. Raises UsageError."""
    match = _HOST_PORT.fullmatch(rest)
    if match is None or int(match["port"]) > 65_535:
        raise UsageError(f"{name}: expected host:port after the colon, as in {name.partition(':')[0]}:127.0.0.1:14550")
    return match["six"] or match["host"], int(match["port"])


def bound(name: str, host: str, port: int, kind: socket.SocketKind) -> socket.socket:
    """A non-blocking socket of a kind at an address of this machine. Raises EndpointError."""
    made = None
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=kind)[0]
        made = socket.socket(family, kind, protocol)
        if kind == socket.SOCK_STREAM:  # else a port is not to be had for a minute after its last connection
            made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        made.bind(address)
        if kind == socket.SOCK_STREAM:
            made.listen(4)
    except OSError as error:
        if made is not None:
            made.close()
        raise EndpointError(f"{name} {_remedy(error)}") from None
    made.setblocking(False)
    return made


def _remedy(error: OSError) -> str:
    if error.errno == errno.EADDRINUSE:
        return "is taken by another program (a ground station, or a second mavkf): end that one or choose another port"
    if error.errno == errno.EADDRNOTAVAIL:
        return "is no address of this machine: use 127.0.0.1, or 0.0.0.0 for all of its addresses"
    if error.errno == errno.EACCES:
        return "may not be opened by this user: choose a port above 1023"
    return f"cannot be opened ({reason(error)}): check host and port"


def is_near(host: str) -> bool:
    """Whether a numeric address is this machine's, or a private one of a network that it is on itself."""
    try:
        address = ipaddress.ip_address(host.partition("%")[0])
    except ValueError:
        return False
    if isinstance(address, ipaddress.IPv6Address) and address.ipv4_mapped is not None:
        address = address.ipv4_mapped
    if address.is_loopback or address.is_link_local:
        return True
    return address.is_private and any(address in network for network in own_networks())


def own_networks() -> Iterator[ipaddress.IPv4Network]:
    """The IPv4 networks of this machine's interfaces, as Linux tells them; none elsewhere."""
    try:
        from fcntl import ioctl
    except ImportError:
        return
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asked:
        for _, name in socket.if_nameindex():
            request = struct.pack("256s", name.encode()[:15])
            try:
                address, mask = (
                    socket.inet_ntoa(ioctl(asked.fileno(), code, request)[20:24])
                    for code in (_SIOCGIFADDR, _SIOCGIFNETMASK)
                )
            except OSError:  # an interface without an address
                continue
            yield ipaddress.IPv4Network(f"{address}/{mask}", strict=False)
