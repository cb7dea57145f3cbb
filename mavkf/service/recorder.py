"""A recording of a link: a standard tlog of the frames that were understood, with the stamps the estimator used."""

import re
import struct
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mavkf.errors import InputError

FLUSH_US = 1_000_000
_STAMP = struct.Struct(">q")


class Recorder:
    """Writes 8-byte big-endian microseconds UTC and the frame, for each frame of one link.

    At most a second of it (by arrival) is not yet with the operating system, so a killed process leaves a readable file.
    A disk that fails ends the recording, not the service.
    """

    def __init__(self, folder: Path, link: str, say: Callable[[str], None]) -> None:
        """Create a new file in a folder (made if need be), named by time and link. Raises InputError."""
        label = re.sub(r"[^A-Za-z0-9.]+", "-", Path(link).stem if Path(link).exists() else link).strip("-")
        begin = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
        self._say = say
        self._flushed_us = 0
        try:
            folder.mkdir(parents=True, exist_ok=True)
            for k in range(1, 1000):
                self.path = folder / f"{begin}-{label}{f'-{k}' if k > 1 else ''}.tlog"
                try:
                    self._file = self.path.open("xb", buffering=1 << 16)
                    return
                except FileExistsError:
                    continue
            raise OSError(f"{begin}-{label} exists too often")
        except OSError as error:
            reason = error.strerror or str(error)
            raise InputError(
                f"--record {folder}: no recording can be made there ({reason}); give another folder"
            ) from None

    def write(self, data: NDArray[np.uint8], frames: NDArray[np.void]) -> None:
        """Append frames (`mavkf.link.framing.FRAME`, stamps filled) whose offsets refer to `data`."""
        if self._file.closed or not len(frames):
            return
        try:
            for offset, stamp, size, version in frames[["offset", "stamp", "size", "version"]].tolist():
                begin = offset - (10 if version == 2 else 6)
                self._file.write(_STAMP.pack(stamp) + data[begin : begin + size].tobytes())
            stamp = int(frames["stamp"][-1])
            if not 0 <= stamp - self._flushed_us < FLUSH_US:
                self._flushed_us = stamp
                self._file.flush()
        except OSError as error:
            self._fail(error)

    def flush(self) -> None:
        """Hand everything to the operating system."""
        try:
            if not self._file.closed:
                self._file.flush()
        except OSError as error:
            self._fail(error)

    def close(self) -> None:
        """End the recording."""
        try:
            self._file.close()
        except OSError as error:
            self._say(f"the end of {self.path} could not be written ({error.strerror})")

    def _fail(self, error: OSError) -> None:
        self._say(f"recording to {self.path} has ended ({error.strerror}); the estimate goes on")
        with suppress(OSError):  # the buffer cannot be written either; the file is closed all the same
            self._file.close()
