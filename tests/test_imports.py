"""The imports point one way: what each part of the house may import from the others."""

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import mavkf

ROOT = Path(mavkf.__file__).parent
BASE = {"errors", "samples", "estimate", "config", "compiled", "stack", "decimals", "machine_code", "parts", "ahead"}
PARTS = BASE | {"models", "filters", "navigation", "diagnostics", "link", "publish", "service", "replay", "cli"}
JOINERS = PARTS - {"service", "replay", "cli"}

# Each may import itself too. "" is mavkf/__init__.py, which others import for the version.
MAY: dict[str, set[str]] = {
    "": {"publish", "errors", "estimate", "replay", "service", "config"},
    "errors": set(),
    "samples": set(),
    "estimate": set(),
    "compiled": {"errors", "machine_code", "parts"},
    "parts": set(),
    "machine_code": set(),
    "ahead": set(),
    "config": {"errors"},
    "decimals": {"compiled"},
    "models": {"compiled", "stack"},
    "filters": {"compiled", "stack", "errors"},
    "navigation": {"models", "filters", *BASE},
    "diagnostics": {"filters", "compiled", "errors"},
    "link": {"samples", "errors", "compiled", "config"},
    "publish": {"estimate", "errors", "config"},
    "service": JOINERS | {"replay"},
    "replay": JOINERS | {"service"},
    "cli": PARTS,
    "__main__": {"cli"},
}
OUTSIDE = {"models": {"numpy"}, "filters": {"numpy"}, "estimate": {"msgspec"}, "errors": set()}
"""The third parties of parts that must stay light; the standard library is everybody's."""


def imported(source: str, module: str) -> Iterator[tuple[int, str]]:
    """The modules that a source text imports, absolute, with their lines; `from a import b` counts as a.b."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parent = module.split(".")[: -node.level]
                base = ".".join([*parent, *([base] if base else [])])
            yield from ((node.lineno, f"{base}.{alias.name}") for alias in node.names)


def wrong_imports(source: str, module: str) -> list[str]:
    """The sentences about what a module of mavkf imports and may not; `module` names a package by its __init__."""
    names = module.split(".")
    part = names[1] if len(names) > 1 and names[1] != "__init__" else ""
    found = []
    for line, name in imported(source, module):
        top, *rest = name.split(".")
        if top == "mavkf":
            other = rest[0] if rest and rest[0] in PARTS else ""
            allowed = other in MAY[part] | {part} or (other == "" and part == "cli")
        else:
            allowed = part not in OUTSIDE or top in OUTSIDE[part] | sys.stdlib_module_names
        if not allowed:
            found.append(f"{module} line {line} imports {name}")
    return found


def modules() -> list[tuple[str, Path]]:
    """Every module of the package, through the links of models and replay too."""
    found = []
    for folder in (ROOT, *(entry for entry in sorted(ROOT.iterdir()) if entry.is_dir())):
        for path in sorted(folder.glob("*.py") if folder == ROOT else folder.rglob("*.py")):
            found.append((".".join(("mavkf", *path.relative_to(ROOT).with_suffix("").parts)), path))
    return found


@pytest.mark.parametrize(("module", "path"), modules(), ids=lambda value: value if isinstance(value, str) else "")
def test_imports_point_one_way(module: str, path: Path) -> None:
    assert not wrong_imports(path.read_text(), module)


def test_the_house_is_seen_whole() -> None:
    names = {module for module, _ in modules()}
    assert names >= {"mavkf.models.__init__", "mavkf.replay.__init__", "mavkf.publish.session", "mavkf.errors"}
    assert {name.split(".")[1] for name in names} - {"__init__", "__main__"} <= PARTS


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("mavkf.publish.wire", "from mavkf.navigation.fold import fold"),
        ("mavkf.publish.wire", "from mavkf import navigation"),
        ("mavkf.publish.wire", "import mavkf.navigation"),
        ("mavkf.publish.wire", "from ..navigation import fold"),
        ("mavkf.publish.wire", "def late():\n    import mavkf.link.decode"),
        ("mavkf.link.decode", "from mavkf.navigation import fold"),
        ("mavkf.models.strapdown", "import scipy"),
        ("mavkf.models.strapdown", "from mavkf.filters import joseph"),
        ("mavkf.filters.joseph", "from mavkf.samples import Kind"),
        ("mavkf.diagnostics.nis", "from mavkf.estimate import Innovation"),
        ("mavkf.navigation.fold", "from mavkf.link import clocks"),
        ("mavkf.service.live", "from mavkf.cli import main"),
        ("mavkf.estimate", "import numpy"),
        ("mavkf.__init__", "from mavkf.cli import main"),
    ],
)
def test_a_wrong_import_is_caught(module: str, source: str) -> None:
    assert wrong_imports(source, module)


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("mavkf.publish.wire", "from .records import encode\nfrom mavkf.errors import UsageError\nimport zenoh"),
        ("mavkf.models.strapdown", "import numpy as np\nfrom mavkf.compiled import compiled"),
        ("mavkf.navigation.fold", "from mavkf.models import strapdown\nfrom mavkf.filters.joseph import correct"),
        ("mavkf.cli.watch", "from mavkf import __version__\nimport mavkf.navigation.fold"),
    ],
)
def test_a_right_import_is_let_pass(module: str, source: str) -> None:
    assert not wrong_imports(source, module)
