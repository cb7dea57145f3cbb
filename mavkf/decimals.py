"""Tables of numbers as text with fixed decimals, many at a time."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavkf.compiled import kernel, long_kernel

UNKNOWN = 1e18  # from here on a number is as good as not known
MOST_DECIMALS = 10
WIDEST = 32  # characters of a number: sign, 18 digits, point, decimals, comma
COMMA, POINT, MINUS, ZERO, NEWLINE = 44, 46, 45, 48, 10


def lines(
    table: NDArray[np.float64],
    decimals: Sequence[int],
    head: bytes,
    tails: Sequence[bytes],
    tail: NDArray[np.int64],
) -> bytes:
    """Numbers (n, m) as n lines: head, numbers apart by commas, a comma, one of the tails. Blank is what is not known.

    decimals: of each column, at most MOST_DECIMALS; tail: (n,) numbers of the tails. Rounded as printf does, but where a number is as
    near to one as to the other; no zero is negative. What is not finite, or UNKNOWN and more, is not known.
    """
    n, m = table.shape
    size = max(map(len, tails))
    ends = np.zeros((len(tails), size), np.uint8)
    for k, each in enumerate(tails):
        ends[k, : len(each)] = np.frombuffer(each, np.uint8)
    out = np.empty(n * (len(head) + m * WIDEST + size + 1), np.uint8)
    length = write_lines(
        np.ascontiguousarray(table),
        np.array(decimals, np.int64),
        np.array(list(head), np.uint8),
        ends,
        np.array([len(each) for each in tails], np.int64),
        np.ascontiguousarray(tail, np.int64),
        out,
    )
    return out[:length].tobytes()


@kernel
def write_digits(value: int, count: int, out: Any, at: int) -> None:
    """Write the last `count` digits of a whole number at a place."""
    for k in range(count):
        out[at + count - 1 - k] = ZERO + value % 10
        value //= 10


@kernel
def write_number(value: float, decimals: int, out: Any, at: int) -> int:
    """Write a number at a place, nothing if it is not known; return the place behind it."""
    if not abs(value) < UNKNOWN:
        return at
    scale = 1
    for _ in range(decimals):
        scale *= 10
    size = abs(value)
    whole = int(size)
    # the difference is exact, so that it is rounded once only
    fraction = int(np.rint((size - whole) * scale))
    if fraction == scale:
        whole += 1
        fraction = 0
    if value < 0.0 and (whole > 0 or fraction > 0):
        out[at] = MINUS
        at += 1
    count, rest = 1, whole // 10
    while rest > 0:
        count += 1
        rest //= 10
    write_digits(whole, count, out, at)
    at += count
    if decimals > 0:
        out[at] = POINT
        write_digits(fraction, decimals, out, at + 1)
        at += 1 + decimals
    return at


@long_kernel
def write_lines(table: Any, decimals: Any, head: Any, tails: Any, sizes: Any, tail: Any, out: Any) -> int:
    """Write lines to `out` (uint8), as of `lines`; return how many bytes."""
    at = 0
    for i in range(table.shape[0]):
        for j in range(head.size):
            out[at + j] = head[j]
        at += head.size
        for j in range(table.shape[1]):
            at = write_number(table[i, j], decimals[j], out, at)
            out[at] = COMMA
            at += 1
        k = tail[i]
        for j in range(sizes[k]):
            out[at + j] = tails[k, j]
        at += sizes[k]
        out[at] = NEWLINE
        at += 1
    return at
