"""Bytes from standard input, as from a pipe of another program."""

import select
import sys

from mavkf.service.endpoints.link import CHUNK, POLL_S, Link, Take


class StandardInput(Link):
    """A raw stream; its writer waits when it is faster than the estimator, and its end is the link's."""

    is_patient = True

    def receive(self, take: Take) -> None:
        """Give what comes to `take` until the end or until closed."""
        source = sys.stdin.buffer.raw if hasattr(sys.stdin.buffer, "raw") else sys.stdin.buffer
        while not self.closed.is_set():
            if not select.select([source], [], [], POLL_S)[0]:
                continue
            chunk = source.read(CHUNK)
            if not chunk:
                break
            take(chunk, False)
        take(b"", True)
        self.has_ended = True
