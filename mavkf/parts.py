"""Compiling what is only a part of other compiled functions, without the work that a function needs to stand alone.

numba makes each function ready to be called: it optimises it with all that it contains, and turns that into machine code. A kernel that
is called by kernels is then optimised in each of them again, and again in theirs. A part that contains others is left as it was written;
what is optimised and turned into machine code is the function that Python calls, or that is called by its address, with all its parts.
A part cannot call itself, and what it raises has arguments that are known when it is compiled.
"""

from functools import cache
from typing import Any

from numba import float64, njit
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.errors import NumbaError


class _Codegen:
    """Code generation as a part sees it."""

    def __init__(self, codegen: Any) -> None:
        self._codegen = codegen

    def set_env(self, name: str, environment: Any) -> None:
        """Enter nothing: what is not machine code has no place for its environment."""

    def __getattr__(self, name: str) -> Any:
        return getattr(self._codegen, name)


class _Part(JITCodeLibrary):  # type: ignore[misc]
    """The intermediate code of a part."""

    long_sums = False

    @property
    def codegen(self) -> Any:
        """Code generation, as far as a part needs it."""
        return _Codegen(self._codegen)

    def get_pointer_to_function(self, name: str) -> int:
        """No address."""
        self._ensure_finalized()
        return 0

    def _optimize_final_module(self) -> None:
        # Loops become vector instructions best where nothing stands around them; what contains no other part is done once this way.
        if self.long_sums or not self._linking_libraries:
            super()._optimize_final_module()

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


class _PartCompiler(Compiler):  # type: ignore[misc]
    """numba's compiler, that makes parts."""

    def compile_extra(self, func: Any) -> Any:
        """Compile a function."""
        library = _Part(self.state.targetctx.codegen(), func.__qualname__)
        library.long_sums = bool(self.state.flags.fastmath.flags)
        self.state.library = library
        return super().compile_extra(func)


@cache
def part_compiler() -> Any:
    """The compiler of parts; where numba's inside is not what it is taken for here, its own, which takes longer."""
    try:
        njit(no_cpython_wrapper=True, no_cfunc_wrapper=True, pipeline_class=_PartCompiler)(_trial).compile((float64,))
    except (AttributeError, TypeError, NumbaError):
        return Compiler
    return _PartCompiler


def _trial(x: float) -> float:
    return x
