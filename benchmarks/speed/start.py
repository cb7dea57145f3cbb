"""Start: the first run ever, which compiles, and what needs no compiler."""

import os
import socket
import subprocess
import sys
import tempfile

from benchmarks.speed.measure import Figure, Settings, alone, figure, in_turns
from benchmarks.speed.processes import IMPORTS, MAVKF, NOTHING, free_port, process_s

RUNS = 15
ASK = "import sys; from mavkf.cli import main; main(sys.argv[1:]); sys.exit(99 if 'numba' in sys.modules else 0)"
COMMANDS = {"`mavkf --help`": ["--help"], "`mavkf schema`": ["schema"], "`mavkf watch`": ["watch", "--seconds", "0.2"]}


def run(settings: Settings) -> list[Figure]:
    """Measure the help, look at what is imported, and compile everything once anew."""
    took = in_turns(
        {"help": lambda: process_s((*MAVKF, "--help")), "nothing": lambda: process_s(NOTHING)}, settings.runs(RUNS)
    )
    figures = [
        figure("`mavkf --help`", "s", took["help"], "`python -c pass`", took["nothing"]),
        alone("`python -c pass`", "s", took["nothing"]),
    ]
    figures += [_numba(name, words) for name, words in COMMANDS.items()]
    return figures if settings.quick else figures + _compile()


def _numba(name: str, words: list[str]) -> Figure:
    """Say whether a command imports numba: 1 or 0."""
    return alone(f"imports of numba by {name}", "", [float(imports_numba(words))])


def _compile() -> list[Figure]:
    with tempfile.TemporaryDirectory() as folder:
        here = {"MAVKF_CACHE": folder}
        first = [process_s((*MAVKF, "warmup"), here)]
        again = [process_s((*MAVKF, "warmup"), here)]
        imports = [process_s(IMPORTS)]
    reference = "importing numpy, numba, zenoh"
    return [
        figure("first `mavkf warmup`", "s", first, reference, imports, "compiles all; once for each version"),
        figure("later ones", "s", again, reference, imports),
    ]


def imports_numba(words: list[str]) -> bool:
    """Whether a command of `mavkf` imports numba. Raises RuntimeError where it cannot be run."""
    meeting = {"MAVKF_RENDEZVOUS": f"tcp/127.0.0.1:{free_port(socket.SOCK_STREAM)}"}
    done = subprocess.run(
        (sys.executable, "-c", ASK, *words), check=False, capture_output=True, env={**os.environ, **meeting}
    )
    if done.returncode not in (0, 99):
        raise RuntimeError(f"mavkf {' '.join(words)} ended with {done.returncode}: {done.stderr.decode()}")
    return done.returncode == 99
