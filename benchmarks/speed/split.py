"""A process that runs `mavkf replay LOG --csv` twice and prints where its time went: `python -m benchmarks.speed.split LOG CSV`.

The second run has everything loaded; what the first took longer is the load of the machine code.
"""

import contextlib
import importlib
import io
import json
import os
import sys
import time


def main() -> None:
    """Print seconds as JSON: start-up, load of machine code, reading (in its own thread), fold and CSV, and the summary."""
    begun = float(os.environ["BEGUN"])
    from mavkf.cli import main as command

    importlib.import_module("mavkf.cli.replay")  # as the command line does it

    started = time.monotonic()
    walls, times = [], {}
    for _ in range(2):
        begin = time.monotonic()
        with contextlib.redirect_stdout(io.StringIO()) as said:
            command(["replay", sys.argv[1], "--csv", sys.argv[2], "--json"])
        walls.append(time.monotonic() - begin)
        times = json.loads(said.getvalue())["time"]
    print(
        json.dumps(
            {
                "start-up": started - begun,
                "load of machine code": walls[0] - walls[1],
                "reading": times["read_s"],
                "fold and CSV": times["total_s"],
                "summary": walls[1] - times["total_s"],
            }
        )
    )


if __name__ == "__main__":
    main()
