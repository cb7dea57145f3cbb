"""Ctrl-C and SIGTERM of a command that has something to finish."""

import os
import signal
import socket
import threading
from types import FrameType

from mavkf.cli._console import say

PATIENCE_S = 0.8  # after a signal, before the process is ended by force


class Signals:
    """Notes SIGINT and SIGTERM instead of dying of them in the middle of a record.

    A flag that is looked at, not an event that is waited for: a handler may run while this very thread holds the event's
    lock. Where a reader that does not read holds this thread inside zenoh (`may_block`) no handler runs at all; then a
    thread that hears the signal by a socket ends the process.
    """

    def __init__(self, *, may_block: bool) -> None:
        self._may_block = may_block
        self.received: int | None = None
        self._ear, self._mouth = socket.socketpair()
        self._mouth.setblocking(False)

    def stopped(self) -> bool:
        return self.received is not None

    def exit_code(self) -> int:
        return 130 if self.received == signal.SIGINT else 0

    def _note(self, number: int, _: FrameType | None) -> None:
        self.received = number

    def _watch(self) -> None:
        heard = self._ear.recv(1)
        if heard and heard[0] in self._before:
            self.received = heard[0]
            if self._may_block and not self._left.wait(PATIENCE_S):
                say("a subscriber that does not read holds up the end; left without it")
                os._exit(self.exit_code())

    def __enter__(self) -> "Signals":
        self._before = {number: signal.signal(number, self._note) for number in (signal.SIGINT, signal.SIGTERM)}
        signal.set_wakeup_fd(self._mouth.fileno(), warn_on_full_buffer=False)
        self._left = threading.Event()
        self._watcher = threading.Thread(target=self._watch, daemon=True)
        self._watcher.start()
        return self

    def __exit__(self, *_: object) -> None:
        signal.set_wakeup_fd(-1)
        for number, handler in self._before.items():
            signal.signal(number, handler)
        self._left.set()
        self._mouth.close()  # the watcher hears the end
        self._watcher.join()
        self._ear.close()
