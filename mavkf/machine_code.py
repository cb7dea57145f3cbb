"""Loading compiled functions from numba's cache without what only a compiler needs.

For each function numba would first fill its registries (some two hundred modules), and parse the intermediate code that another function
might be compiled from. Neither is needed to call it, and what others are compiled from are parts of their own (`mavkf.parts`).
"""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from threading import RLock
from typing import Any

import llvmlite.binding
from numba.core.caching import FunctionCache
from numba.core.codegen import JITCodeLibrary
from numba.core.runtime import _nrt_python

_loading = RLock()
IS_KNOWN = all(hasattr(JITCodeLibrary, name) for name in ("_finalize_final_module", "_set_compiled_object")) and all(
    hasattr(owner, name) for owner, name in ((_nrt_python, "c_helpers"), (FunctionCache, "_load_overload"))
)
"""Whether numba has inside what is used of it here; another version that has not is left to do it in its own way."""


class Cache(FunctionCache):  # type: ignore[misc]
    """The cache of one function."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled function of a signature, None if it is not in the cache."""
        if not IS_KNOWN:
            return super().load_overload(sig, target_context)
        _name_helpers()
        with self._guard_against_spurious_io_errors(), _loaded_lightly(target_context.codegen()):
            return self._load_overload(sig, target_context)


class _Library(JITCodeLibrary):  # type: ignore[misc]
    """A library of machine code without the intermediate code (bitcode) that numba has kept beside it."""

    def get_pointer_to_function(self, name: str) -> int:
        """The address of a function of this library, 0 if it has none of this name."""
        self._ensure_finalized()
        return int(self._codegen._engine.get_function_address(name))

    @classmethod
    def _unserialize(cls, codegen: Any, state: Any) -> Any:
        name, kind, data = state
        if kind != "object":
            return super()._unserialize(codegen, state)
        library = codegen.create_library(name)
        library.enable_object_caching()
        machine_code, _ = data
        library._set_compiled_object(machine_code)
        library._finalize_final_module()
        return library


@cache
def _name_helpers() -> None:
    """Let machine code find what turns arrays into Python's and counts references to them; numba does it when it first compiles."""
    for name, address in _nrt_python.c_helpers.items():
        llvmlite.binding.add_symbol(name if name.startswith("_") else f"NRT_{name}", address)


@contextmanager
def _loaded_lightly(codegen: Any) -> Iterator[None]:
    """Have libraries loaded as `_Library` while this lasts."""
    with _loading:
        before = codegen._library_class
        codegen._library_class = _Library
        try:
            yield
        finally:
            codegen._library_class = before
