"""`python -m benchmarks NAME`: accuracy, forms, fuzz, integrity, soak, speed. Tables on stdout; `--json FILE` writes the numbers too."""

import importlib
import sys

NAMES = ("accuracy", "forms", "fuzz", "integrity", "soak", "speed")


def main() -> int:
    """Run the benchmark that is named, with the rest of the command line."""
    if len(sys.argv) < 2 or sys.argv[1] not in NAMES:
        print(f"python -m benchmarks NAME, where NAME is one of {', '.join(NAMES)}", file=sys.stderr)
        return 2
    module = importlib.import_module(f"benchmarks.{sys.argv[1]}")
    code = module.main(sys.argv[2:])
    return code if isinstance(code, int) else 0


sys.exit(main())
