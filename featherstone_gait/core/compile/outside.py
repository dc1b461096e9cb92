"""Calls of functions that are compiled for themselves, by their address, and reads of what another thread writes.

What calls a function by its address need not be compiled anew for it.
"""

import llvmlite.ir as ir
from numba import types
from numba.extending import intrinsic, overload

from .jit import INNER

ARRAYS = 6  # that such a function takes after a number: pointers, of the second to int64, else to float64


def call_outside(function, x, arrays):
    """Call a function of `jit.outside` with a float and a tuple of `ARRAYS` arrays.

    function: its address; with the JIT off, itself.
    """
    function(x, *arrays)


@intrinsic
def _call(typingctx, function, x, arrays):
    def codegen(context, builder, signature, args):
        pointers = []
        for k, kind in enumerate(signature.args[2].types):
            array = context.make_array(kind)(context, builder, builder.extract_value(args[2], k))
            pointers.append(array.data)
        kind = ir.FunctionType(ir.VoidType(), [ir.DoubleType(), *[p.type for p in pointers]])
        builder.call(builder.inttoptr(args[0], kind.as_pointer()), [args[1], *pointers])
        return context.get_dummy_value()

    return types.void(types.int64, types.float64, arrays), codegen


@overload(call_outside, jit_options=INNER)
def _overload_call(function, x, arrays):
    return lambda function, x, arrays: _call(function, x, arrays)


def read_now(flag):
    """Read flag[0], int64, from memory now; an ordinary read may be moved out of a loop that does not write it."""
    return flag[0]


@intrinsic
def _read(typingctx, flag):
    def codegen(context, builder, signature, args):
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        return builder.load_atomic(data, "monotonic", 8)

    return types.int64(flag), codegen


overload(read_now, jit_options=INNER)(lambda flag: lambda flag: _read(flag))
