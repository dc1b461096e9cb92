"""Calls of functions that are compiled for themselves, by their address, and reads of what another thread writes.

What calls a function by its address need not be compiled anew for it.
"""

import llvmlite.ir as ir
from numba import types
from numba.core import cgutils
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


def call_entry(function, arguments):
    """Call an entry that returns an integer, with a tuple of arguments of the types for which `jit.address_of` made it.

    function: its address; with the JIT off, itself.
    """
    return function(*arguments)


@intrinsic
def _call_entry(typingctx, function, arguments):
    kinds = tuple(types.unliteral(kind) for kind in arguments.types)

    def codegen(context, builder, signature, args):
        convention = context.call_conv
        values = [
            context.cast(builder, builder.extract_value(args[1], k), given, kind)
            for k, (given, kind) in enumerate(zip(signature.args[1].types, kinds, strict=True))
        ]
        pointer = convention.get_function_type(types.int64, kinds).as_pointer()
        callee = builder.inttoptr(args[0], pointer)
        status, found = convention.call_function(builder, callee, types.int64, kinds, values)
        with cgutils.if_unlikely(builder, status.is_error):
            convention.return_status_propagate(builder, status)
        return found

    return types.int64(types.int64, arguments), codegen


@overload(call_entry, jit_options=INNER)
def _overload_call_entry(function, arguments):
    return lambda function, arguments: _call_entry(function, arguments)


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
