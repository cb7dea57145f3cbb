"""The one decorator of compiled functions: options and the folder of the on-disk cache.

numba does not notice that a function called by a cached function has changed in another file: the old machine code
would go on being used. So the cache lives in a folder named by a hash of every source that is compiled (and of the
versions of Python, numba and numpy): any change means a new folder. The folder is the user's cache directory, never
the package's own, so a read-only installation works; where the user has none that can be written, a temporary folder
serves this process. Compiled functions call each other by direct module-level names only, because functions passed
as arguments are compiled anew in every process.

A function and all that it calls are optimised together, so a function that many others call is compiled as often as it has callers, and
theirs. `compiled_apart` cuts there: such a function is compiled once, and called by its address.
"""

import atexit
import hashlib
import inspect
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from functools import cache, cached_property, update_wrapper
from pathlib import Path
from threading import RLock
from typing import Any, TypeVar

import llvmlite.binding
import llvmlite.ir
import numba
import numpy
from numba.core import cgutils
from numba.extending import intrinsic

from mavkf.machine_code import Cache
from mavkf.parts import part_compiler

F = TypeVar("F", bound=Callable[..., Any])
# Types of numba, for `compiled_apart`
NOTHING, BOOLEAN, INTEGER, FLOAT = numba.void, numba.boolean, numba.int64, numba.float64
VECTOR, MATRIX, INTEGERS = FLOAT[::1], FLOAT[:, ::1], INTEGER[::1]


def several(*types: Any) -> Any:
    """Give the numba type of a tuple."""
    return numba.types.Tuple(types)


UNUSED_S = 30 * 86400.0
_setting_folder = RLock()
COMPILED_FOLDERS = ("models", "filters", "navigation", "link")  # and the constants in samples.py


@cache
def source_hash() -> str:
    """Hash (16 hex digits) of the compiled sources and of the versions that the machine code depends on."""
    package = Path(__file__).resolve().parent
    digest = hashlib.sha256(f"{sys.version}|{numba.__version__}|{numpy.__version__}".encode())
    paths = [package / f"{name}.py" for name in ("compiled", "parts", "samples", "stack", "decimals")]
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


def _mark(what: str) -> Path:
    """The file that says that a part is compiled: for this place of the sources, because numba looks for machine code by that."""
    place = hashlib.sha256(str(Path(__file__).resolve().parent).encode()).hexdigest()[:8]
    return cache_folder() / f"{what}-{place}"


def is_warm(what: str = "warm") -> bool:
    """Whether a part of these sources, by name, has been compiled before (nothing of it has to be compiled for a while now)."""
    return _mark(what).exists()


def mark_warm(what: str = "warm") -> None:
    """Remember that a part has been compiled; forget the machine code of sources that have not been used for a month."""
    _mark(what).touch()
    for other in cache_folder().parent.glob("[0-9a-f]" * 16):
        if time.time() - other.stat().st_mtime > UNUSED_S:
            shutil.rmtree(other, ignore_errors=True)


def compiled(function: F) -> F:
    """Compile a function of plain numbers and arrays when it is first called, cached on disk.

    Division by zero gives inf or NaN as in numpy, instead of an exception in the middle of a run.
    """
    return _later(function, True)  # said aloud, because numba takes what is not said from the caller


def kernel(function: F) -> F:
    """Compile a function as `compiled` does, that asks nothing of the allocator: its arrays are its caller's, or of `mavkf.stack`.

    Nothing counts references in it, which is half of the work where arrays are small. Numba refuses what allocates, and what returns an
    array: a function that gives a view of its argument is `compiled`.
    """
    return _later(function, False)


def long_kernel(function: F) -> F:
    """Compile a kernel whose calls take long: other threads work meanwhile. What Python hands to it nobody else may change."""
    return _later(function, False, nogil=True)


def fused_kernel(function: F) -> F:
    """Compile a kernel whose products and sums may be one instruction, rounded once, where the processor has it: for long sums only."""
    return _later(function, False, fastmath={"contract"})


def _later(function: F, with_allocator: bool, **options: Any) -> F:
    if not inspect.isfunction(function):
        raise TypeError(f"{function!r} is not a function")
    if numba.config.DISABLE_JIT:
        return function
    kept: F = _Later(function, with_allocator, options)  # type: ignore[assignment]
    return kept


class _Later:
    """A function that becomes one of numba's when Python or the compiler first asks for it.

    Hundreds are defined, and a run whose machine code is in the cache asks for a dozen.
    """

    def __init__(self, function: Callable[..., Any], with_allocator: bool, options: dict[str, Any]) -> None:
        update_wrapper(self, function)
        self._function, self._options = function, {"fastmath": False} | options | {"_nrt": with_allocator}

    @cached_property
    def _dispatcher(self) -> Any:
        with _setting_folder:
            before = (
                numba.config.CACHE_DIR
            )  # set only for this, so that other users of numba in the process keep theirs
            numba.config.CACHE_DIR = str(cache_folder())
            try:
                dispatcher = numba.njit(error_model="numpy", **self._options)(self._function)
                dispatcher._cache = Cache(self._function)
                return dispatcher
            finally:
                numba.config.CACHE_DIR = before

    @cached_property
    def _part(self) -> Any:
        """The dispatcher of what other compiled functions contain: nothing by which Python could call it is made, nor kept on disk."""
        return numba.njit(
            error_model="numpy",
            no_cpython_wrapper=True,
            no_cfunc_wrapper=True,
            pipeline_class=part_compiler(),
            **self._options,
        )(self._function)

    @property
    def _numba_type_(self) -> Any:
        """What the compiler takes this for."""
        return self._part._numba_type_

    def __call__(self, *arguments: Any) -> Any:
        return self._dispatcher(*arguments)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self._dispatcher, name)


_apart: list[tuple[Any, tuple[Any, ...], Any]] = []
"""The functions that are compiled apart: each with the types of its arguments, and the cell (1,) that holds its address."""
_called: list[tuple[Any, tuple[Any, ...]]] = []
"""Functions that Python calls, each with the types of its arguments."""


def called_with(*arguments: Any) -> Callable[[F], F]:
    """Name the numba types that Python calls a compiled function with, so that `compile_ahead` can compile it before it is called."""

    def decorate(function: F) -> F:
        if not numba.config.DISABLE_JIT:
            _called.append((function, arguments))
        return function

    return decorate


def _cell(name: str) -> Any:
    """Give a cell (1,) that machine code finds by a name; zero at first.

    By name, not by number: cached code must find the same function whatever was imported before.
    """
    cell = numpy.zeros(1, dtype=numpy.int64)
    if not llvmlite.binding.address_of_symbol(name):  # a second copy of this module must not take the name away
        llvmlite.binding.add_symbol(name, cell.ctypes.data)
    return cell


def compiled_apart(result: Any, *arguments: Any) -> Callable[[F], F]:
    """Compile a kernel for itself, of the numba types `arguments` and `result`; compiled functions call it by its address.

    What comes of it can be called by compiled functions only, after `link_apart` (an address that is missing is a RuntimeError);
    Python calls its attribute `python`.
    """

    def decorate(function: F) -> F:
        inner = kernel(function)
        if numba.config.DISABLE_JIT:
            inner.python = inner  # type: ignore[attr-defined]
            return inner
        name = f"{function.__module__}.{function.__qualname__}"
        _apart.append((inner, arguments, _cell(name)))

        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            """Emit the call, by numba's own calling convention."""
            convention = context.call_conv
            integer = llvmlite.ir.IntType(64)
            cell = builder.module.globals.get(name) or llvmlite.ir.GlobalVariable(builder.module, integer, name)
            address = builder.load(cell)
            with cgutils.if_unlikely(builder, cgutils.is_null(builder, address)):
                convention.return_user_exc(builder, RuntimeError, ("call link_apart() first",))
            kind = convention.get_function_type(signature.return_type, signature.args)
            target = builder.inttoptr(address, kind.as_pointer())
            status, value = convention.call_function(builder, target, signature.return_type, signature.args, values)
            with cgutils.if_unlikely(builder, status.is_error):
                convention.return_status_propagate(builder, status)
            return value

        def call(typing_context: Any, *types: Any) -> Any:
            return result(*arguments), generate

        names = ["typing_context", *inspect.signature(function).parameters]
        call.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
            [inspect.Parameter(name, inspect.Parameter.POSITIONAL_OR_KEYWORD) for name in names]
        )
        call.__name__ = function.__name__
        apart: F = intrinsic(call)
        apart.python = inner  # type: ignore[attr-defined]
        return apart

    return decorate


@cache
def link_apart() -> None:
    """Compile the functions that are compiled apart, or load them from the cache, and enter their addresses."""
    for function, arguments, cell in _apart:
        function.compile(arguments)
        result = function.overloads[arguments]
        cell[0] = result.library.get_pointer_to_function(result.fndesc.llvm_func_name)


def compile_ahead(claims: Path, *, last_first: bool = False) -> None:
    """Compile what is compiled apart and what Python calls: several processes share the work, each claims its part by a file in `claims`.

    What they leave in the cache is found there by `link_apart` and by the first call.
    """
    work = [*((function, arguments) for function, arguments, _ in _apart), *_called]
    for function, arguments in reversed(work) if last_first else work:
        types = hashlib.sha256(repr(arguments).encode()).hexdigest()[:8]
        try:
            (claims / f"{function.__module__}.{function.__qualname__}.{types}").open("x").close()
        except FileExistsError:
            continue
        function.compile(arguments)


def is_shared() -> bool:
    """Whether other processes use the same cache folder."""
    return cache_folder().name == source_hash()
