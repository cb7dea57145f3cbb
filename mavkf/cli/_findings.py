"""All findings of a session for people: `mavkf replay --diagnose`."""

from collections.abc import Callable
from typing import Any


def print_findings(line: Callable[[str], object], diagnosis: dict[str, Any]) -> None:
    """Print what `mavkf.replay.diagnosis.diagnose` found with its details: what it costs first, then each test."""
    line("")
    line(
        "  What departures cost: the share that lies outside the region that should hold 95 % (fine to 6 %, marginal to 10 %)"
    )
    for name, sensor in diagnosis["sensors"].items():
        line(f"  {name}: {sensor['verdict']} (of {sensor['used']} that were used)")
        for finding in sensor["consequences"]:
            line(
                f"    {finding['name']:<10}{finding['verdict']:<10}{100.0 * finding['value']:6.1f} %   {finding['sentence']}"
            )
    line("  Slow errors that were learnt, and one sigma that was expected")
    for each in diagnosis["learnt"]:
        sigma = "" if each["sigma"] is None else f" +- {each['sigma']:.2g}"
        line(f"    {each['name']}: {each['value']:.2g}{sigma} {each['unit']}, expected {each['expected']:.2g}")
    line("  Linearisation and covariance")
    for name, finding in diagnosis["linearisation"].items():
        line(f"    {name:<18}{finding['verdict']:<10}{finding['sentence']}")
    for finding in diagnosis["covariance"]:
        line(f"    {finding['name']:<18}{finding['verdict']:<10}{finding['sentence']}")
    line(
        "  Every test by itself, however little it costs: a filter with learnt noise and floors is not meant to pass them all"
    )
    for name, sensor in diagnosis["sensors"].items():
        line(f"  {name}")
        for finding in sensor["findings"]:
            test = f"{finding['name']} {finding['axis']}".strip()
            line(f"    {test:<30}{finding['verdict']:<10}{finding['sentence']}")
