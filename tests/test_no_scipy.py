"""Compiled code asks nothing of SciPy: numba's own products and decompositions would, and it is no dependency."""

import ast
import re
from pathlib import Path

import pytest

import mavkf

ROOT = Path(mavkf.__file__).parent
FILES = [
    path
    for folder in (ROOT, *ROOT.iterdir())
    if folder.is_dir()
    for path in sorted(folder.glob("**/*.py" if folder != ROOT else "*.py"))
]


def offences(source: str) -> list[str]:
    """What compiled functions of a source text use that numba gives to SciPy."""
    found = []
    for function in ast.walk(ast.parse(source)):
        if isinstance(function, ast.FunctionDef) and any(
            isinstance(d, ast.Name) and d.id == "compiled" for d in function.decorator_list
        ):
            for node in ast.walk(function):
                if isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult):
                    found.append(f"{function.name} line {node.lineno}: @")
                if isinstance(node, ast.Attribute) and node.attr in ("linalg", "dot", "vdot", "matmul"):
                    found.append(f"{function.name} line {node.lineno}: {node.attr}")
    return found


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_no_scipy_in_compiled_code(path: Path) -> None:
    assert not offences(path.read_text())
    assert not re.search(r"^\s*(import|from) scipy", path.read_text(), re.M)


@pytest.mark.parametrize("line", ["A @ B", "np.linalg.solve(A, B)", "np.dot(A, B)", "A.dot(B)"])
def test_it_would_be_seen(line: str) -> None:
    assert offences(f"@compiled\ndef product(A, B):\n    return {line}")
    assert not offences(f"def product(A, B):\n    return {line}")
