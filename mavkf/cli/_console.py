"""What commands share: where they write, and the options of those that use zenoh.

rich is imported where a terminal is written to, not before.
"""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

if TYPE_CHECKING:
    from rich.console import Console

Connect = Annotated[
    tuple[str, ...],
    Parameter(show_default=False, help="Zenoh endpoint to go to besides, as in tcp/192.168.1.5:7447; may be repeated."),
]
Listen = Annotated[
    tuple[str, ...],
    Parameter(
        show_default=False, help="Zenoh endpoint to be reached at besides, as in tcp/0.0.0.0:7448; may be repeated."
    ),
]
ZenohConfig = Annotated[
    Path | None, Parameter(help="Zenoh configuration file (JSON5) to use instead of the project's own settings.")
]


def say(text: str) -> None:
    """Tell the user something that is not a result: one line on stderr."""
    print(f"mavkf: {text}", file=sys.stderr, flush=True)


def output() -> "Console":
    """Give the console of stdout, for results."""
    from rich.console import Console

    return Console()


def messages() -> "Console":
    """Give the console of stderr, for progress."""
    from rich.console import Console

    return Console(stderr=True)


def compile_first(*, smoothing: bool = False) -> float:
    """Compile what is not compiled yet, with a spinner on a terminal; return the seconds it took."""
    from mavkf.service.warmup import ensure_compiled

    if not sys.stderr.isatty():
        return ensure_compiled(say, smoothing=smoothing)
    with messages().status("") as status:
        return ensure_compiled(status.update, smoothing=smoothing)
