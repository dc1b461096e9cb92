"""What may be absent: None gives None, decided when a kernel is compiled.

Numba leaves out what an argument that is None makes unreachable, but not what an attribute that is None does.  Hence
kernels hand optional parts to functions as arguments of their own.  Of `if array is None: return None` and
`return array[i]` in one function it keeps both ways for an array and makes an optional value of them, tested at each
use: 1.3 times the run time in lanes, 1.2 times the compile time.  Hence these functions.
"""

from numba import types
from numba.extending import overload

from .jit import INNER
from .lanes import as_lanes
from .structure import StructureType
from .varying import varies, varying_in_lanes


def item(array, i):
    """array[i], None if there is no array."""
    return None if array is None else array[i]


@overload(item, jit_options=INNER)
def _item(array, i):
    if isinstance(array, types.NoneType):
        return lambda array, i: None
    return lambda array, i: array[i]


def item_or_zero(array, i):
    """array[i], 0.0 if there is no array."""
    return 0.0 if array is None else array[i]


@overload(item_or_zero, jit_options=INNER)
def _item_or_zero(array, i):
    if isinstance(array, types.NoneType):
        return lambda array, i: 0.0
    return lambda array, i: array[i]


def item_in_lanes(array, i):
    """array[i] viewed as lanes, None if there is no array."""
    return None if array is None else as_lanes(array[i])


@overload(item_in_lanes, jit_options=INNER)
def _item_in_lanes(array, i):
    if isinstance(array, types.NoneType):
        return lambda array, i: None
    return lambda array, i: as_lanes(array[i])


def slice_if(present, array, start, count):
    """array[start : start + count], None if `present` is None."""
    return None if present is None else array[start : start + count]


@overload(slice_if, jit_options=INNER)
def _slice_if(present, array, start, count):
    if isinstance(present, types.NoneType):
        return lambda present, array, start, count: None
    return lambda present, array, start, count: array[start : start + count]


def only_if(present, array):
    """The array, None if `present` is None."""
    return None if present is None else array


@overload(only_if, jit_options=INNER)
def _only_if(present, array):
    if isinstance(present, types.NoneType):
        return lambda present, array: None
    return lambda present, array: array


def any_present(a, b):
    """True if one of both is present, None if neither is."""
    return None if a is None and b is None else True


@overload(any_present, jit_options=INNER)
def _any_present(a, b):
    if isinstance(a, types.NoneType) and isinstance(b, types.NoneType):
        return lambda a, b: None
    return lambda a, b: True


def in_lanes(x):
    """Arrays viewed as lanes: of a tuple each field that its class does not name as `SHARED` by all lanes.

    Of what is shared it is what is `Varying` in it.
    """
    if isinstance(x, tuple):
        shared = getattr(x, "SHARED", ())
        return type(x)(*(varying_in_lanes(a) if name in shared else in_lanes(a) for name, a in zip(x._fields, x)))
    return x if x is None or isinstance(x, bool) else as_lanes(x)


@overload(in_lanes, jit_options=INNER)
def _in_lanes(x):
    if isinstance(x, types.Array):
        return lambda x: as_lanes(x)
    if isinstance(x, types.BaseNamedTuple | StructureType):
        kind = x.instance_class
        shared = getattr(kind, "SHARED", ())
        fields = ", ".join(
            _field(name, name in shared, field) for name, field in zip(x.fields, x.types, strict=True)
        )
        scope = {"kind": kind, "in_lanes": in_lanes, "varying_in_lanes": varying_in_lanes}
        exec(f"def view(x): return kind({fields})", scope)  # Numba loops over no fields of different types
        return scope["view"]
    return lambda x: x


def _field(name, shared, kind):
    if shared:
        return f"varying_in_lanes(x.{name})" if varies(kind) else f"x.{name}"
    return f"in_lanes(x.{name})"
