"""The fuzzer of the frame scanner: it finds its way by coverage, and nothing that is wrong."""

import re
import subprocess
import sys

import pytest


def test_three_seconds_of_guided_bytes_upset_nothing() -> None:
    pytest.importorskip("atheris")
    command = [sys.executable, "-m", "benchmarks", "fuzz", "--seconds", "3", "--megabytes", "0"]
    run = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert run.returncode == 0, run.stderr[-2000:]
    found = re.search(r"new_units_added: +(\d+)", run.stderr)
    assert found is not None
    assert int(found[1]) > 10  # inputs that reached what none had reached before
