"""The command line: what the commands are, and in one place what becomes of errors.

A command is the function NAME in `mavkf/cli/NAME.py`; it is imported when it is run, and returns an exit code or None
(which is 0). Exit codes: 0 done, 1 unusable input, 2 wrong usage, 130 interrupted. Results go to stdout, messages to
stderr.
"""

import gc
import os
import sys
from collections.abc import Iterable, Sequence
from importlib import import_module
from typing import TYPE_CHECKING

from mavkf import __version__
from mavkf.errors import MavkfError, UsageError

if TYPE_CHECKING:
    from cyclopts import App, CycloptsError

COMMANDS = {
    "demo": "Fly a simulated flight, serve it and watch it, in this terminal.",
    "serve": "Read live telemetry or a log, estimate, publish over zenoh.",
    "watch": "Show the poses that are published.",
    "replay": "Estimate from a log at full speed.",
    "info": "Say what is in a log.",
    "simulate": "Make a log of a simulated flight, with known truth.",
    "schema": "Print the JSON schema of what is published.",
    "warmup": "Compile the estimator now, so that nothing waits for it later.",
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command line (default: the process's own) and give its exit code."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    try:
        code = _run(words)
        sys.stdout.flush()
        return code
    except KeyboardInterrupt:
        return 130
    except MavkfError as error:
        return _fail(str(error), 2 if isinstance(error, UsageError) else 1)
    except BrokenPipeError:
        # The reader has gone; so that the flush at exit does not complain, it goes nowhere.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141


def entry() -> None:
    """Run the process's command line and end the process with its exit code."""
    code = main()
    sessions = sys.modules.get("mavkf.publish.session")
    if sessions is not None and sessions.is_closing():
        # zenoh is still busy with a close that it will not finish: ending the interpreter beneath it would abort
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    sys.exit(code)


def _run(words: list[str]) -> int:
    if not words or words[0] in ("--help", "-h", "help"):  # at once: the parser alone takes ten times longer to import
        print(_help())
        return 0
    if words[0] == "--version":
        print(__version__)
        return 0
    if words[0] not in COMMANDS:  # the parser would import every command to suggest one
        return _fail(f"there is no command {words[0]!r}{_nearest(words[0], COMMANDS)}: {', '.join(COMMANDS)}", 2)
    gc.disable()  # nothing that is imported is garbage, and to look for some costs a twentieth of the start
    from cyclopts import CycloptsError

    import_module(f"mavkf.cli.{words[0]}")
    gc.freeze()
    gc.enable()
    app = make_app()
    if words[0] == "serve":
        _read_options(app, words)
    try:
        code = app(words, exit_on_error=False, print_error=False)
    except CycloptsError as error:
        return _fail(_sentence(error, app), 2)
    return code if isinstance(code, int) else 0


def _read_options(app: "App", words: Sequence[str]) -> None:
    """Take from the configuration file what the command line does not say."""
    from mavkf.cli._config_file import named_file, serve_table

    path = named_file(words)
    table = serve_table(path) if path is not None else {}
    table.pop("sources", None)  # the parser has no place for those; the command reads them
    if table:
        from cyclopts.config import Dict

        app.config = (Dict({"serve": table}, source=str(path)),)


def make_app() -> "App":
    """Make the parser of all commands; none of them is imported."""
    from cyclopts import App, Parameter

    app = App(
        name="mavkf",
        help="The fused pose of a drone from its MAVLink telemetry.",
        version=__version__,
        result_action="return_value",
        suppress_keyboard_interrupt=False,
        default_parameter=Parameter(negative=()),
    )
    for name in COMMANDS:
        app.command(f"mavkf.cli.{name}:{name}", name=name)
    return app


def _help() -> str:
    lines = "\n".join(f"  {name:<10}{text}" for name, text in COMMANDS.items())
    return (
        "mavkf: the fused pose of a drone from its MAVLink telemetry.\n\n"
        f"Usage: mavkf COMMAND ...\n\n{lines}\n\n"
        "mavkf COMMAND --help shows its options, mavkf --version the version."
    )


def _sentence(error: "CycloptsError", app: "App") -> str:
    """Say what is wrong with a command line and what would be right, on one line."""
    from cyclopts import UnknownOptionError, UnusedCliTokensError

    command = " ".join(("mavkf", *(error.command_chain or ())))
    if isinstance(error, UnknownOptionError) and error.command_chain:
        known = app[error.command_chain[0]].assemble_argument_collection()
        options = [*sorted(argument.name for argument in known if argument.name.startswith("--")), "--help"]
        wrong = error.token.keyword or error.token.value
        if error.token.source != "cli":
            wrong += f" in {error.token.source}"
        return f"{command} has no option {wrong}{_nearest(wrong, options)}: {', '.join(options)}"
    if isinstance(error, UnusedCliTokensError):
        return f"{command} does not take {' '.join(error.unused_tokens or ())!r}; see {command} --help"
    return " ".join(str(error).split())


def _nearest(wrong: str, right: Iterable[str]) -> str:
    from difflib import get_close_matches

    near = get_close_matches(wrong, list(right), 1)
    return f" (did you mean {near[0]}?), only" if near else ", only"


def _fail(text: str, code: int) -> int:
    sys.stdout.flush()
    print(f"mavkf: {text}", file=sys.stderr)
    return code
