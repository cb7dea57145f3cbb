"""Rows that are needed again: few are kept in memory, many in a temporary file, so that memory does not grow with a flight."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from mavkf.errors import UsageError

Array = NDArray[np.float64]
IN_MEMORY = 1 << 25  # bytes


@contextmanager
def needs_room() -> Iterator[None]:
    """For what is done to temporary files: raises UsageError where they have no room."""
    try:
        yield
    except OSError as error:
        raise UsageError(
            f"temporary files cannot be written ({error.strerror}): make room, or name a folder that has some in TMPDIR"
        ) from None


class Spool:
    """Rows of one width, written at the end or in place of others, and read by number."""

    def __init__(self, width: int) -> None:
        """width: numbers in a row."""
        self._width = width
        self._count = 0
        self._file = tempfile.SpooledTemporaryFile(IN_MEMORY)  # noqa: SIM115 (closed by __exit__)

    def __enter__(self) -> "Spool":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Let it go."""
        with suppress(OSError):  # what the disk has no room for is not wanted any more
            self._file.close()

    def __len__(self) -> int:
        return self._count

    def append(self, rows: Array) -> None:
        """Write rows (n, width) behind the last."""
        self.put(self._count, rows)

    def put(self, first: int, rows: Array) -> None:
        """Write rows (n, width) from number `first` on, in place of those that are there. Raises UsageError where the disk is full."""
        with needs_room():
            self._file.seek(8 * self._width * first)
            self._file.write(np.ascontiguousarray(rows, dtype=np.float64).data)
        self._count = max(self._count, first + len(rows))

    def block(self, first: int, last: int) -> Array:
        """Rows first..last (m, width), a copy; as many as there are. Raises UsageError: what was put may only now be written."""
        rows = np.empty((max(min(last, self._count) - first, 0), self._width))
        with needs_room():
            self._file.seek(8 * self._width * first)
            self._file.readinto(rows.data.cast("B"))
        return rows
