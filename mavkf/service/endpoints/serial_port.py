"""A serial port, through pyserial."""

import errno
from typing import Any

from mavkf.errors import EndpointError, UsageError
from mavkf.service.endpoints.link import CHUNK, POLL_S, BackOff, Link, Outlet, Say, Take, reason


class SerialPort(Link):
    """Bytes of a serial port. It must be there at first; when it vanishes (a cable, a reset) it is tried again for ever."""

    def __init__(self, name: str, path: str, baud: int, say: Say) -> None:
        super().__init__(name, say)
        self._path, self.baud = path, baud
        self._outlet = Outlet()
        self._is_open = False

    def open(self) -> None:
        """Open the port. Raises EndpointError."""
        try:
            self._port = self._opened()
        except OSError as error:
            raise EndpointError(f"{self.name} {self._remedy(error)}") from None

    def _opened(self) -> Any:
        try:
            import serial
        except ImportError:
            raise EndpointError(f"{self.name} needs pyserial: pip install 'mavkf[serial]'") from None
        port = serial.Serial(self._path, self.baud, timeout=POLL_S, exclusive=True)
        self._outlet.attach(port.fileno())
        self._is_open = True
        return port

    def receive(self, take: Take) -> None:
        """Give what comes to `take` until closed."""
        back_off = BackOff(self.closed)
        while not self.closed.is_set():
            if not self._is_open:
                try:
                    self._port = self._opened()
                except OSError:
                    back_off.wait()
                    continue
                self.say(f"{self.name} is there again")
            try:
                while not self.closed.is_set():
                    chunk = self._port.read(1)
                    if chunk:
                        back_off.reset()
                        take(chunk + self._port.read(min(self._port.in_waiting, CHUNK)), False)
            except OSError as error:
                self.say(f"{self.name} has vanished ({reason(error)}); it is tried again until it is back")
            self._outlet.detach()
            self._is_open = False
            self._port.close()
            take(b"", True)
            back_off.wait()

    @property
    def is_local(self) -> bool | None:
        """Never: behind a serial port there may be a radio."""
        return False if self._is_open else None

    def _send(self, data: bytes) -> bool:
        return self._outlet.send(data)

    def _remedy(self, error: OSError) -> str:
        if error.errno == errno.EACCES:
            return (
                f"may not be opened by this user: `sudo usermod -a -G dialout $USER`, then log in again "
                f"(`ls -l {self._path}` shows the group)"
            )
        if error.errno in (errno.EBUSY, errno.EAGAIN):
            return (
                f"is used by another program: `fuser -v {self._path}` names it (a ground station, or ModemManager: "
                "`sudo systemctl stop ModemManager`)"
            )
        if error.errno == errno.ENOENT:
            return "does not exist: plug it in, `ls /dev/serial/by-id /dev/ttyACM* /dev/ttyUSB*` shows what there is"
        return f"cannot be opened as a serial port ({reason(error)}): check path and baud rate"


def path_baud(name: str, rest: str) -> tuple[str, int]:
    """Split PATH:BAUD; the path may have colons of its own. Raises UsageError."""
    path, _, baud = rest.rpartition(":")
    if not path or not baud.isascii() or not baud.isdigit() or not 0 < int(baud[:9]) <= 20_000_000:
        raise UsageError(f"{name}: expected path:baud after the colon, as in serial:/dev/ttyACM0:921600")
    return path, int(baud)
