"""Bytes from standard input, as from a pipe of another program."""

import os
import select
import sys

from mavkf.errors import EndpointError
from mavkf.service.endpoints.link import CHUNK, POLL_S, Link, Take


class StandardInput(Link):
    """A raw stream; its writer waits when it is faster than the estimator, and its end is the link's."""

    is_patient = True

    def open(self) -> None:
        """See that there is one. Raises EndpointError."""
        try:
            self._file = sys.stdin.fileno()
        except (AttributeError, OSError, ValueError):
            raise EndpointError(
                "stdin is closed: pipe something into it, as in `socat ... | mavkf serve stdin`"
            ) from None

    def receive(self, take: Take) -> None:
        """Give what comes to `take` until the end or until closed."""
        while not self.closed.is_set():
            if not select.select([self._file], [], [], POLL_S)[0]:
                continue
            chunk = os.read(self._file, CHUNK)
            if not chunk:
                break
            take(chunk, False)
        take(b"", True)
        self.has_ended = True
