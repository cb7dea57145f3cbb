"""What was heard of each sensor: how often, from when to when, by kind and source."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavkf.compiled import long_kernel
from mavkf.samples import FIX, KIND, SOURCE, TIME, Kind, Source

COUNT, FIRST, LAST, BEST_FIX = range(4)
"""Columns of a table: number of rows, first and last of their times (s), highest MAVLink fix type of a receiver."""
KINDS, SOURCES = max(Kind) + 1, max(Source) + 1
GNSS_KIND = int(Kind.GNSS)


def empty_table() -> NDArray[np.float64]:
    """Nothing was heard: (KINDS, SOURCES, 4)."""
    table = np.zeros((KINDS, SOURCES, 4))
    table[:, :, FIRST], table[:, :, LAST] = np.inf, -np.inf
    return table


@long_kernel
def hear(rows: Any, table: Any) -> None:
    """Add timed rows (n, ROW_WIDTH) to a table."""
    for i in range(rows.shape[0]):
        kind, source, t = int(rows[i, KIND]), int(rows[i, SOURCE]), rows[i, TIME]
        table[kind, source, COUNT] += 1.0
        table[kind, source, FIRST] = min(table[kind, source, FIRST], t)
        table[kind, source, LAST] = max(table[kind, source, LAST], t)
        if kind == GNSS_KIND:
            table[kind, source, BEST_FIX] = max(table[kind, source, BEST_FIX], rows[i, FIX])
