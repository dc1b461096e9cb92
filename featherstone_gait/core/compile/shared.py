"""What another thread may change while a kernel runs."""

from numba import types
from numba.extending import intrinsic, overload

from .jit import INNER


def read_now(flag):
    """Read flag[0], int64, from memory now; an ordinary read may be moved out of a loop that does not write it."""
    return flag[0]


@intrinsic
def _read(typingctx, flag):
    def codegen(context, builder, signature, args):
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        return builder.load_atomic(data, "monotonic", 8)

    return types.int64(flag), codegen


@overload(read_now, jit_options=INNER)
def _overload_read_now(flag):
    return lambda flag: _read(flag)
