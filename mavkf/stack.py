"""Small arrays of kernels, on the stack: without the allocator, and without counting references.

    r = vector(3)                 (3,), not initialised
    H = matrix(3, n)              (3, n), not initialised; n a number that is known only when it runs
    R = zero_matrix(3, 3)
    P = block(s, first, n, n)     a view of n * n numbers of a vector, as a matrix
    q = flat(P)                   a view of a matrix as a vector
    copy(a, b)                    all numbers of b to a, which has as many and is not part of it

They live until the kernel that asked for them returns, so they must not be returned. A size is a constant, by its own
name or number (what is computed of constants is none for numba), or at most `MOST`; else ValueError.

Inside numba a temporary costs a call of the allocator, and each use of an array that may be somebody's an atomic
instruction or two; the optimiser keeps most of these in registers.
"""

from typing import Any

import llvmlite.ir
import numba
import numpy as np
from numba.core import cgutils, types
from numba.extending import intrinsic

MOST = 40
TOO_LARGE = f"an array on the stack has a side that is no constant and larger than {MOST}"
VECTOR, MATRIX = types.float64[::1], types.float64[:, ::1]


def _array(context: Any, builder: Any, kind: Any, data: Any, shape: list[Any]) -> Any:
    """Emit an array structure that owns nothing."""
    size = context.get_constant(types.intp, 8)
    result = context.make_array(kind)(context, builder)
    result.data = data
    result.shape = cgutils.pack_array(builder, shape)
    result.strides = cgutils.pack_array(builder, [size] if len(shape) == 1 else [builder.mul(shape[1], size), size])
    result.itemsize = size
    result.nitems = shape[0] if len(shape) == 1 else builder.mul(*shape)
    result.meminfo = cgutils.get_null_value(result.meminfo.type)
    result.parent = cgutils.get_null_value(result.parent.type)
    return result._getvalue()


def _shape(context: Any, builder: Any, values: Any, kinds: Any) -> list[Any]:
    return [context.cast(builder, value, kind, types.intp) for value, kind in zip(values, kinds, strict=True)]


def _on_stack(kind: Any, dimensions: Any, zero: bool) -> Any:
    """Give the code generator of an array of these dimensions (numba types)."""
    room = 1
    for dimension in dimensions:
        room *= dimension.literal_value if isinstance(dimension, types.IntegerLiteral) else MOST

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        with builder.goto_entry_block():  # once, not in each turn of a loop
            words = llvmlite.ir.Constant(llvmlite.ir.IntType(64), room)
            data = builder.alloca(llvmlite.ir.DoubleType(), size=words)
        shape = _shape(context, builder, values, signature.args)
        for size, dimension in zip(shape, dimensions, strict=True):
            if not isinstance(dimension, types.IntegerLiteral):
                with cgutils.if_unlikely(builder, builder.icmp_unsigned(">", size, size.type(MOST))):
                    context.call_conv.return_user_exc(builder, ValueError, (TOO_LARGE,))
        result = _array(context, builder, kind, data, shape)
        if zero:
            count = shape[0] if len(shape) == 1 else builder.mul(*shape)
            cgutils.memset(builder, data, builder.mul(count, count.type(8)), 0)
        return result

    return kind(*dimensions), generate


@intrinsic(prefer_literal=True)
def _vector(typing_context: Any, n: Any) -> Any:
    return _on_stack(VECTOR, (n,), False)


@intrinsic(prefer_literal=True)
def _zero_vector(typing_context: Any, n: Any) -> Any:
    return _on_stack(VECTOR, (n,), True)


@intrinsic(prefer_literal=True)
def _matrix(typing_context: Any, m: Any, n: Any) -> Any:
    return _on_stack(MATRIX, (m, n), False)


@intrinsic(prefer_literal=True)
def _zero_matrix(typing_context: Any, m: Any, n: Any) -> Any:
    return _on_stack(MATRIX, (m, n), True)


@intrinsic
def _block(typing_context: Any, array: Any, first: Any, m: Any, n: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        whole = context.make_array(signature.args[0])(context, builder, value=values[0])
        begin, *shape = _shape(context, builder, values[1:], signature.args[1:])
        return _array(context, builder, MATRIX, builder.gep(whole.data, [begin]), shape)

    return MATRIX(array, first, m, n), generate


@intrinsic
def _flat(typing_context: Any, array: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        whole = context.make_array(signature.args[0])(context, builder, value=values[0])
        return _array(context, builder, VECTOR, whole.data, [whole.nitems])

    return VECTOR(array), generate


@intrinsic
def _copy(typing_context: Any, target: Any, source: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        to, of = (
            context.make_array(kind)(context, builder, value=v) for kind, v in zip(signature.args, values, strict=True)
        )
        cgutils.raw_memcpy(builder, to.data, of.data, of.nitems, of.itemsize)
        return context.get_dummy_value()

    return types.void(target, source), generate


# What Python calls: the same with the JIT off, each array full of NaN that is not to be read before it is written.


vector: Any = _vector
zero_vector: Any = _zero_vector
matrix: Any = _matrix
zero_matrix: Any = _zero_matrix
block: Any = _block
flat: Any = _flat
copy: Any = _copy
if numba.config.DISABLE_JIT:
    vector = matrix = lambda *shape: np.full(shape, np.nan)
    zero_vector = zero_matrix = lambda *shape: np.zeros(shape)
    flat, copy = np.ravel, np.copyto
    block = lambda array, first, m, n: array[first : first + m * n].reshape((m, n))  # noqa: E731
