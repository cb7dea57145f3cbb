"""Numbers as text: against printf, which is right to the last digit."""

import math
from fractions import Fraction

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mavkf.decimals import lines

numbers = st.floats(-1e15, 1e15) | st.floats(-400.0, 400.0) | st.sampled_from([0.0, -0.0, 0.5, 0.125, 9.9999999, 1e17])


def text(value: float, decimals: int) -> str:
    line = lines(np.array([[value]]), [decimals], b"", [b""], np.zeros(1, np.int64)).decode()
    assert line.endswith(",\n")
    return line[:-2]


@given(numbers, st.integers(0, 10))
def test_as_printf_writes_them(value: float, decimals: int) -> None:
    expected = f"{value:.{decimals}f}"
    got = text(value, decimals)
    if float(expected) == 0.0:
        expected = expected.lstrip("-")
    # exactly, but where the two neighbours are equally near
    off = abs(Fraction(got) - Fraction(value)) * 10**decimals
    assert got == expected or abs(off - Fraction(1, 2)) < Fraction(1, 10**5)


@given(st.sampled_from([math.nan, math.inf, -math.inf, 1e18, -1e300]), st.integers(0, 10))
def test_what_is_not_known_is_blank(value: float, decimals: int) -> None:
    assert text(value, decimals) == ""


def test_lines_have_their_head_and_tail() -> None:
    table = np.array([[1.0, -2.25], [math.nan, 1e-9]])
    made = lines(table, [0, 1], b"1-1,0,", [b"aligning", b""], np.array([0, 1]))
    assert made == b"1-1,0,1,-2.2,aligning\n1-1,0,,0.0,\n"
