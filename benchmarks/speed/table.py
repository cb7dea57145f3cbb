"""The tables of the figures, on stdout and between two markers of the README."""

import os
import platform
from collections.abc import Mapping, Sequence
from pathlib import Path

from benchmarks.speed.measure import Figure, Spread

BEGIN, END = "<!-- speed: begin -->", "<!-- speed: end -->"
COLUMNS = ("", "median", "ratio (least to most)", "to", "")


def number(value: float) -> str:
    """Write a number with three digits, or all that are before the point."""
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


def ratio_text(ratio: Spread) -> str:
    """Write a ratio with its spread."""
    return f"{number(ratio.median)} ({number(ratio.least)} to {number(ratio.most)})"


def table(figures: Sequence[Figure]) -> str:
    """Write a table in Markdown, a line for each figure."""
    lines = [f"| {' | '.join(COLUMNS)} |", "|---|--:|--:|---|---|"]
    for each in figures:
        value = "not measured" if each.value is None else f"{number(each.value.median)} {each.unit}"
        ratio = "" if each.ratio is None else ratio_text(each.ratio)
        lines.append(f"| {each.name} | {value} | {ratio} | {each.reference} | {each.note} |")
    return "\n".join(lines)


def document(results: Mapping[str, Sequence[Figure]], titles: Mapping[str, str]) -> str:
    """Write the tables of all parts, and on what they were measured."""
    parts = [f"**{titles[name]}**\n\n{table(figures)}" for name, figures in results.items()]
    return "\n\n".join([f"Measured on {machine()}.", *parts])


def machine() -> str:
    """Say what this was measured on."""
    model = next(
        (line.partition(":")[2].strip() for line in _lines(Path("/proc/cpuinfo")) if line.startswith("model name")),
        platform.machine(),
    )
    return f"{os.cpu_count()} cores ({model}), Python {platform.python_version()}"


def _lines(path: Path) -> list[str]:
    return path.read_text().splitlines() if path.exists() else []


def rewrite(path: Path, text: str) -> None:
    """Put a text between the markers of a file. Raises ValueError where they are not there once, in order."""
    whole = path.read_text()
    before, begin, rest = whole.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end or BEGIN in rest or END in after or END in before:
        raise ValueError(f"{path} must have {BEGIN} and after it {END}, each once")
    path.write_text(f"{before}{BEGIN}\n{text}\n{END}{after}")
