"""One step ahead: the next item of an iterator is made by another thread while this one works on the last."""

import time
from collections.abc import Generator, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import Generic, TypeVar

Item = TypeVar("Item")


class Ahead(Generic[Item]):
    """The items of an iterator, in order; what it raises is raised here.

    with Ahead(source) as items:
        for item in items: ...
    items.busy_s    # how long the iterator has worked
    """

    def __init__(self, source: Iterator[Item]) -> None:
        """source: nobody else may use it meanwhile; a generator is closed at the end."""
        self._source = source
        self._pool = ThreadPoolExecutor(1, "mavkf-ahead")
        self.busy_s = 0.0

    def __enter__(self) -> "Ahead[Item]":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._pool.shutdown(cancel_futures=True)
        if isinstance(self._source, Generator):
            self._source.close()

    def __iter__(self) -> Iterator[Item]:
        nothing = object()
        coming: Future[Item | object] = self._pool.submit(self._next, nothing)
        while (item := coming.result()) is not nothing:
            coming = self._pool.submit(self._next, nothing)
            yield item  # type: ignore[misc]

    def _next(self, nothing: object) -> Item | object:
        begin = time.perf_counter()
        item = next(self._source, nothing)
        self.busy_s += time.perf_counter() - begin
        return item
