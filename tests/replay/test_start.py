"""What a replay does not wait for once everything is compiled."""

import subprocess
import sys
from pathlib import Path

import pytest

from mavkf.replay.simulation import simulate

CODE = """
import sys
from mavkf.cli import main
code = main(["replay", sys.argv[1], "--csv", sys.argv[2]])
loaded = ("numba.np.arraymath", "numba.np.linalg", "pymavlink", "rich", "matplotlib", "zenoh")
print([name for name in loaded if name in sys.modules], file=sys.stderr)
sys.exit(code)
"""


def test_a_warm_replay_loads_neither_the_compiler_nor_what_it_does_not_use(tmp_path: Path) -> None:
    log = tmp_path / "flight.tlog"
    simulate(log, duration_s=60.0)
    for _ in range(2):  # the first may compile
        done = subprocess.run(
            [sys.executable, "-c", CODE, str(log), str(tmp_path / "estimate.csv")],
            capture_output=True,
            text=True,
            check=True,
        )
    if "compil" in done.stderr:
        pytest.fail(f"it compiles each time: {done.stderr}")
    assert done.stderr.splitlines()[-1] == "[]"
