"""The one decorator of compiled functions: options and the folder of the on-disk cache.

numba does not notice that a function called by a cached function has changed in another file: the old machine code
would go on being used. So the cache lives in a folder named by a hash of every source that is compiled (and of the
versions of Python, numba and numpy): any change means a new folder. The folder is the user's cache directory, never
the package's own, so a read-only installation works; where the user has none that can be written, a temporary folder
serves this process. Compiled functions call each other by direct module-level names only, because functions passed
as arguments are compiled anew in every process.
"""

import atexit
import hashlib
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numba
import numpy

F = TypeVar("F", bound=Callable[..., Any])


UNUSED_S = 30 * 86400.0
COMPILED_FOLDERS = ("models", "filters", "navigation", "link")  # and the constants in samples.py


@cache
def source_hash() -> str:
    """Hash (16 hex digits) of the compiled sources and of the versions that the machine code depends on."""
    package = Path(__file__).resolve().parent
    digest = hashlib.sha256(f"{sys.version}|{numba.__version__}|{numpy.__version__}".encode())
    paths = [package / "compiled.py", package / "samples.py"]
    for folder in COMPILED_FOLDERS:
        paths += sorted((package / folder).resolve().rglob("*.py"))
    for path in paths:
        digest.update(path.name.encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


@cache
def cache_folder() -> Path:
    """The folder of machine code for exactly these sources; created when first asked for."""
    home = os.environ.get("MAVKF_CACHE") or os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    folder = Path(home) / "mavkf" / source_hash()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            folder.touch()  # in use
            return folder
    except OSError:
        folder = Path(tempfile.mkdtemp(prefix="mavkf-"))
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
        return folder


def is_warm() -> bool:
    """Whether these sources have been compiled before (nothing has to be compiled for a while now)."""
    return (cache_folder() / "warm").exists()


def mark_warm() -> None:
    """Remember that everything has been compiled; forget the machine code of sources that have not been used for a month."""
    (cache_folder() / "warm").touch()
    for other in cache_folder().parent.glob("[0-9a-f]" * 16):
        if time.time() - other.stat().st_mtime > UNUSED_S:
            shutil.rmtree(other, ignore_errors=True)


def compiled(function: F) -> F:
    """Compile a function of plain numbers and arrays, cached on disk.

    Division by zero gives inf or NaN as in numpy, instead of an exception in the middle of a run. The cache folder is
    set only while decorating, so that other users of numba in the process keep theirs.
    """
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(cache_folder())
    try:
        result: F = numba.njit(cache=True, error_model="numpy")(function)
    finally:
        numba.config.CACHE_DIR = before
    return result
