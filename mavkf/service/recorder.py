"""A recording of a link: standard tlogs of the frames that were understood, with the stamps the estimator used."""

import errno
import os
import re
import shutil
import struct
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from threading import Condition, Thread
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from mavkf.errors import InputError

FLUSH_US = 1_000_000
AGAIN_US = 30_000_000  # after a disk failed
LITTLE_BYTES = 500_000_000
_STAMP = struct.Struct(">q")
_NAME = re.compile(r"\d{8}T\d{6}Z(\.\d+)?-(?P<label>.+)\.tlog")


def label_of(path: Path) -> str | None:
    """The link that a recording is of, by its name; None: it has another name."""
    match = _NAME.fullmatch(path.name)
    return match["label"] if match else None


class Recorder:
    """Writes 8-byte big-endian microseconds UTC and the frame, for each frame of one link.

    At most a second of it (by arrival) is not yet with the operating system, so a killed process leaves a readable file; at most about
    another second is not yet on the disk. A disk that fails interrupts the recording, not the service.
    """

    def __init__(
        self,
        folder: Path,
        link: str,
        say: Callable[[str], None],
        part_bytes: float = float("inf"),
        part_s: float = float("inf"),
    ) -> None:
        """Create a new file in a folder (made if need be), named by time and link; further ones when a part is so large or old.

        Raises InputError.
        """
        self._folder = folder
        self._label = re.sub(r"[^A-Za-z0-9.]+", "-", Path(link).stem if Path(link).exists() else link).strip("-")
        self._say = say
        self._part_bytes, self._part_us = part_bytes, part_s * 1e6
        self._flushed_us = 0
        self._failed_us: int | None = None
        self._is_little_told = False
        self._syncer = _Syncer()
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._open()
        except OSError as error:
            reason = error.strerror or str(error)
            raise InputError(
                f"--record {folder}: no recording can be made there ({reason}); give another folder"
            ) from None

    def _open(self) -> None:
        begin = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
        for k in range(1, 1000):
            self.path = self._folder / f"{begin}{f'.{k}' if k > 1 else ''}-{self._label}.tlog"
            try:
                self._file: BinaryIO = self.path.open("xb", buffering=1 << 16)
                break
            except FileExistsError:
                continue
        else:
            raise OSError(f"{begin}-{self._label} exists too often")
        self._bytes, self._begun_us = 0, -1
        self._is_over = False

    def write(self, data: NDArray[np.uint8], frames: NDArray[np.void]) -> None:
        """Append frames (`mavkf.link.framing.FRAME`, stamps filled) whose offsets refer to `data`."""
        if not len(frames):
            return
        first, last = int(frames["stamp"][0]), int(frames["stamp"][-1])
        if self._failed_us is not None and 0 <= last - self._failed_us < AGAIN_US:
            return
        try:
            if self._failed_us is not None or self._is_over:
                self._begin_part()
            if self._begun_us < 0:
                self._begun_us = first
            for offset, stamp, size, version in frames[["offset", "stamp", "size", "version"]].tolist():
                begin = offset - (10 if version == 2 else 6)
                self._file.write(_STAMP.pack(stamp) + data[begin : begin + size].tobytes())
                self._bytes += _STAMP.size + size
            if not 0 <= last - self._flushed_us < FLUSH_US:
                self._flushed_us = last
                self._file.flush()
                self._syncer.sync(self._file.fileno())
                self._look_at_room()
            self._is_over |= self._bytes >= self._part_bytes or last - self._begun_us >= self._part_us
        except OSError as error:
            self._fail(error, last)

    def end_part(self) -> None:
        """Write what comes next into another file."""
        self._is_over |= self._begun_us >= 0

    def flush(self) -> None:
        """Hand everything to the operating system."""
        try:
            if not self._file.closed:
                self._file.flush()
        except OSError as error:
            self._fail(error, self._flushed_us)

    def close(self) -> None:
        """End the recording."""
        self._syncer.close()
        try:
            self._file.close()
        except OSError as error:
            self._say(f"the end of {self.path} could not be written ({error.strerror})")

    def _begin_part(self) -> None:
        if not self._file.closed:
            self._file.close()
        self._open()
        if self._failed_us is not None:
            self._failed_us = None
            self._say(f"recording goes on in {self.path}")

    def _look_at_room(self) -> None:
        free = shutil.disk_usage(self._folder).free
        if free < LITTLE_BYTES and not self._is_little_told:
            self._say(
                f"only {free / 1e6:.0f} MB are free for recordings: delete old ones in {self._folder}, "
                "or record to another disk"
            )
        self._is_little_told = free < LITTLE_BYTES

    def _fail(self, error: OSError, now_us: int) -> None:
        if self._failed_us is None:
            remedy = f": delete old recordings in {self._folder}" if error.errno == errno.ENOSPC else ""
            self._say(
                f"recording to {self.path} is interrupted ({error.strerror}){remedy}; "
                "it is tried again, and the estimate goes on"
            )
        self._failed_us = now_us
        with suppress(OSError):  # the buffer cannot be written either; the file is closed all the same
            self._file.close()


class _Syncer:
    """Has the newest file synced in a thread of its own: a slow disk may take seconds."""

    def __init__(self) -> None:
        self._changed = Condition()
        self._file: int | None = None
        self._is_closed = False
        Thread(target=self._run, name="recording", daemon=True).start()

    def sync(self, file: int) -> None:
        with self._changed:
            if self._file is None:
                self._file = os.dup(file)  # the recorder may close its own meanwhile
                self._changed.notify()

    def close(self) -> None:
        with self._changed:
            self._is_closed = True
            self._changed.notify()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._file is not None or self._is_closed)
                file = self._file
            if file is None:
                return
            with suppress(OSError):  # what does not reach the disk shows at the next write
                os.fsync(file)
            os.close(file)
            with self._changed:
                self._file = None
