"""The configuration file: `[serve]` holds sources and options of `mavkf serve`, the other tables the estimator's settings."""

import tomllib
from collections.abc import Sequence
from pathlib import Path
from textwrap import wrap
from typing import Any

from mavkf.errors import UsageError

_NOT_IN_FILE = {"config", "print_config", "set"}


def named_file(words: Sequence[str]) -> Path | None:
    """The file that `--config` of a command line names."""
    for word, following in zip(words, [*words[1:], ""], strict=True):
        if word == "--config" and following:
            return Path(following)
        if word.startswith("--config="):
            return Path(word.partition("=")[2])
    return None


def serve_table(path: Path) -> dict[str, Any]:
    """The `[serve]` table of a file, by names as in Python; empty where the file is none (the settings' own reader says so).

    Raises UsageError.
    """
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8")).get("serve", {})
    except (OSError, tomllib.TOMLDecodeError, UnicodeDecodeError):
        return {}
    if not isinstance(table, dict):
        raise UsageError(f"{path}: serve must be a table, [serve]")
    table = {name.replace("-", "_"): value for name, value in table.items()}
    for name in _NOT_IN_FILE & table.keys():
        raise UsageError(f"{path}: {name} has no place in [serve]: settings have tables of their own")
    return table


def sources(path: Path) -> tuple[str, ...]:
    """The sources of a file. Raises UsageError."""
    found = serve_table(path).get("sources", [])
    if not (isinstance(found, list) and all(isinstance(one, str) for one in found)):
        raise UsageError(f'{path}: sources in [serve] must be a list, as in ["udpin:127.0.0.1:14550"]')
    return tuple(found)


def written(arguments: Any, values: dict[str, Any], settings: Any) -> str:
    """A configuration file of everything, with meanings.

    arguments: of `mavkf serve`, as cyclopts has them; values: of them, by name; settings: a `Config`.
    """
    from mavkf.config import settings as known

    lines = ["# mavkf serve --config FILE; what the command line says comes first", "", "[serve]"]
    for argument in arguments:
        name = argument.name.removeprefix("--").replace("-", "_")
        if name in _NOT_IN_FILE:
            continue
        name = "sources" if argument.name in ("SOURCES", "--sources") else name
        lines += [f"# {line}" for line in wrap(argument.parameter.help or "", 110)]
        # a key is written down nowhere by itself
        lines += [_line(name, values.get(name) if name != "signing_key" else None), ""]
    section = ""
    for key, _, meaning in known():
        table, name = key.split(".")
        if table != section:
            section = table
            lines += [f"[{table}]"]
        lines += [f"# {line}" for line in wrap(meaning, 110)]
        lines += [_line(name, getattr(getattr(settings, table), name))]
    return "\n".join(lines) + "\n"


def _line(name: str, value: Any) -> str:
    return f"# {name} =" if value is None else f"{name} = {_toml(value)}"


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str | Path):
        text = str(value).replace("\\", "\\\\").replace('"', '\\"')
        return f'"{text}"'
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(_toml, value))}]"
    return repr(value)
