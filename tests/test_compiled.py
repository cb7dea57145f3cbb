"""The folder of machine code: named by the sources, never inside the package, and never in the way of other users of numba."""

import os
import re
import shutil
import subprocess
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import numba
import numpy as np
import pytest
from numba.core.compiler import Compiler

import mavkf
from mavkf import parts
from mavkf.compiled import FLOAT, VECTOR, cache_folder, compiled, compiled_apart, kernel, link_apart, source_hash

# A package of the same layout, small enough to compile in no time.
FUNCTION = """
from mavkf.compiled import compiled


@compiled
def answer(x):
    return 2.0 * x
"""
ASK = """
import warnings
warnings.simplefilter("error")
import numba
import numpy as np
from mavkf import compiled
before = numba.config.CACHE_DIR
from mavkf.models.answer import answer
print(compiled.source_hash())
print(compiled.cache_folder())
print(answer(1.5))
print(numba.config.CACHE_DIR == before)
print(sum(answer.stats.cache_hits.values()))
"""


SOURCE = Path(mavkf.__file__).resolve().parent


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package of the same layout with one small compiled function: mavkf/ and models/ beside each other, linked."""
    root = tmp_path / "site"
    (root / "models").mkdir(parents=True)
    for folder in ("", "filters", "navigation", "link"):
        (root / "mavkf" / folder).mkdir(parents=True, exist_ok=True)
        (root / "mavkf" / folder / "__init__.py").write_text("")
    for file in ("compiled.py", "machine_code.py", "parts.py", "samples.py", "stack.py", "decimals.py"):
        shutil.copy(SOURCE / file, root / "mavkf")
    (root / "models" / "__init__.py").write_text("")
    (root / "models" / "answer.py").write_text(FUNCTION)
    (root / "mavkf" / "models").symlink_to(Path("..") / "models", target_is_directory=True)
    return root


def load(package: Path) -> ModuleType:
    """The copy's `compiled` module, anew each time."""
    spec = spec_from_file_location("copied", package / "mavkf" / "compiled.py")
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def ask(package: Path, home: Path, **environment: str) -> list[str]:
    """In a fresh process: the hash, the folder, an answer, whether numba's own folder was left alone, and the cache hits."""
    kept = {
        key: value
        for key, value in os.environ.items()
        if key not in ("MAVKF_CACHE", "XDG_CACHE_HOME", "NUMBA_CACHE_DIR")
    }
    result = subprocess.run(
        [sys.executable, "-c", ASK],
        check=False,
        cwd=package,
        env=kept | {"HOME": str(home), "PYTHONPATH": str(package), "PYTHONDONTWRITEBYTECODE": "1"} | environment,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert result.returncode == 0, result.stderr
    return result.stdout.split()


def test_compiled_once_and_read_from_then_on(package: Path, tmp_path: Path) -> None:
    home = tmp_path / "home"
    first, second = ask(package, home), ask(package, home)
    assert first[1] == str(home / ".cache" / "mavkf" / first[0])
    assert first[2:4] == ["3.0", "True"]
    assert first[4] == "0"
    assert second == [*first[:4], "1"]


def compiled_files() -> set[Path]:
    """Files of the package, relative to it, with compiled functions in them, and all of the package that those import."""
    paths = {path.relative_to(SOURCE) for part in (".", "models", "replay") for path in (SOURCE / part).rglob("*.py")}
    found = {
        path
        for path in paths
        if re.search(r"^@(compiled|kernel|fused_kernel|compiled_apart\()", (SOURCE / path).read_text(), re.M)
    }
    imported = set()
    for path in found:
        for module, name in re.findall(r"^from mavkf\.?(\S*) import (\w*)", (SOURCE / path).read_text(), re.M):
            folder = Path(*module.split("."))
            imported |= {folder / f"{name}.py", folder.parent / f"{folder.name}.py"}
    return found | (imported & paths)


def test_every_source_that_is_compiled_changes_the_hash(tmp_path: Path) -> None:
    root = tmp_path / "site"
    hidden = shutil.ignore_patterns("__pycache__")
    shutil.copytree(SOURCE, root / "mavkf", ignore=hidden)  # links become folders, as in a wheel
    before = load(root).source_hash()
    files = compiled_files()
    assert {Path("models/rotation.py"), Path("samples.py"), Path("navigation/layout.py"), Path("link/crc.py")} <= files
    for path in files:
        text = (root / "mavkf" / path).read_text()
        (root / "mavkf" / path).write_text(text + "# another line\n")
        assert load(root).source_hash() != before, path
        (root / "mavkf" / path).write_text(text)
    assert load(root).source_hash() == before


@pytest.mark.parametrize("changed", ["mavkf/compiled.py", "models/answer.py", "models/new.py", "mavkf/link/new.py"])
def test_any_change_of_a_source_means_a_new_folder(
    package: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, changed: str
) -> None:
    monkeypatch.setenv("MAVKF_CACHE", str(tmp_path))
    before = load(package)
    assert load(package).source_hash() == before.source_hash()
    with (package / changed).open("a") as file:
        file.write("\n# another line\n")
    after = load(package)
    assert after.source_hash() != before.source_hash()
    assert after.cache_folder() != before.cache_folder()


def test_a_function_called_from_another_file_is_never_stale(package: Path, tmp_path: Path) -> None:
    home = tmp_path / "home"
    (package / "models" / "factor.py").write_text(FUNCTION.replace("answer", "factor"))
    (package / "models" / "answer.py").write_text(
        "from mavkf.compiled import compiled\nfrom mavkf.models.factor import factor\n\n\n"
        "@compiled\ndef answer(x):\n    return factor(x) + 1.0\n"
    )
    assert ask(package, home)[2] == "4.0"
    (package / "models" / "factor.py").write_text(FUNCTION.replace("answer", "factor").replace("2.0", "4.0"))
    assert ask(package, home)[2] == "7.0"


def test_the_same_sources_elsewhere_have_the_same_hash(package: Path, tmp_path: Path) -> None:
    other = tmp_path / "elsewhere"
    shutil.copytree(package, other, symlinks=True)
    assert load(package).source_hash() == load(other).source_hash()


def test_warm_is_said_of_the_place_where_it_was_compiled(
    package: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MAVKF_CACHE", str(tmp_path / "cache"))
    other = tmp_path / "elsewhere"
    shutil.copytree(package, other, symlinks=True)
    load(package).mark_warm()
    assert load(package).is_warm() and not load(other).is_warm()


def test_another_version_of_numba_has_its_own_folder(package: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = load(package).source_hash()
    monkeypatch.setattr(numba, "__version__", "0.0.1")
    assert load(package).source_hash() != before


def files(folder: Path) -> set[Path]:
    return {path for path in folder.rglob("*") if path.is_file()}


def test_a_read_only_package_works_and_nothing_is_written_into_it(package: Path, tmp_path: Path) -> None:
    before = files(package)
    everything = [path for path in (package, *package.rglob("*")) if not path.is_symlink()]
    for path in everything:
        path.chmod(0o555 if path.is_dir() else 0o444)
    try:
        assert ask(package, tmp_path / "home")[2] == "3.0"
    finally:
        for path in everything:
            path.chmod(0o755)
    # root may write anywhere, so that is not all
    assert files(package) == before
    assert files(tmp_path / "home")


def test_without_a_home_that_can_be_written_a_temporary_folder_serves(package: Path, tmp_path: Path) -> None:
    # a file where the folder should be stops root too
    home = tmp_path / "home"
    home.write_text("not a folder")
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    answers = ask(package, home, TMPDIR=str(temporary))
    assert answers[2:4] == ["3.0", "True"]
    assert Path(answers[1]).parent == temporary


@pytest.mark.parametrize("variable", ["MAVKF_CACHE", "XDG_CACHE_HOME"])
def test_the_folder_can_be_chosen(
    package: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, variable: str
) -> None:
    for name in ("MAVKF_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv(variable, str(tmp_path / "chosen"))
    module = load(package)
    assert module.cache_folder() == tmp_path / "chosen" / "mavkf" / module.source_hash()
    assert module.cache_folder().is_dir()
    assert not (tmp_path / "home").exists()


def test_numba_keeps_its_own_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(numba.config, "CACHE_DIR", "/somewhere/else")

    @compiled
    def half(x):
        return 0.5 * x

    assert half(3.0) == 1.5
    assert numba.config.CACHE_DIR == "/somewhere/else"
    assert len(source_hash()) == 16
    assert cache_folder().name == source_hash() or not os.access(Path.home(), os.W_OK)


def test_numba_keeps_its_own_folder_where_compiling_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(numba.config, "CACHE_DIR", "/somewhere/else")
    with pytest.raises(TypeError):
        compiled(3)  # not a function
    assert numba.config.CACHE_DIR == "/somewhere/else"


def test_division_by_zero_is_infinity_and_no_exception() -> None:
    @compiled
    def ratio(a, b):
        return a / b

    assert ratio(1.0, 0.0) == float("inf")
    assert ratio(0.0, 0.0) != ratio(0.0, 0.0)


def test_a_function_compiled_apart_is_called_by_its_address_once_it_is_linked() -> None:
    @compiled_apart(FLOAT, VECTOR, FLOAT)
    def weighed(a, factor):
        if factor < 0.0:
            raise ValueError
        a[0] = factor
        return factor * a.sum()

    @compiled
    def caller(a, factor):
        return weighed(a, factor) + 1.0

    a = np.array([1.0, 2.0, 3.0])
    if numba.config.DISABLE_JIT:
        assert caller(a, 2.0) == 15.0
        return
    with pytest.raises(RuntimeError, match="link_apart"):
        caller(a, 2.0)
    link_apart.__wrapped__()
    assert caller(a, 2.0) == 15.0
    assert a[0] == 2.0
    with pytest.raises(ValueError):
        caller(a, -1.0)


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_a_part_has_no_machine_code_and_what_contains_it_gives_the_same() -> None:
    @kernel
    def square(x):
        return x * x

    @kernel
    def both(x, y):
        return square(x) - square(y)

    @compiled
    def caller(x, y):
        return both(x, y) + square(x)

    assert parts.part_compiler() is not Compiler  # of this version of numba
    assert caller(3.0, 2.0) == 14.0
    for part in (square, both):
        (result,) = part._part.overloads.values()
        assert result.library.get_pointer_to_function(result.fndesc.llvm_func_name) == 0
        assert not part.overloads
    assert both(3.0, 2.0) == 5.0  # Python may call it all the same


CALLED = """
from mavkf.compiled import _called
from mavkf.service import warmup
warmup.compile_ahead = lambda claims: None
warmup.compile_all()
for function, types in _called:
    assert list(function.overloads) == [types], function.py_func
print(len(_called))
"""


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_python_calls_with_the_types_that_were_named() -> None:
    done = subprocess.run([sys.executable, "-c", CALLED], check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) >= 8
