"""Optional parts: None gives None, decided when a kernel is compiled.

Numba leaves out what an argument that is None makes unreachable, but not what an attribute that is None does.  Hence
kernels hand optional parts to functions as arguments of their own.  Of `if array is None: return None` and
`return array[i]` in one function it keeps both ways for an array and makes an optional value of them, tested at each
use: 1.3 times the run time in lanes, 1.2 times the compile time.  Hence these functions.
"""

import functools

from numba import types
from numba.extending import overload

from .jit import INNER, inline
from .lanes import as_lanes
from .structure import StructureType
from .varying import varies, varying_in_lanes


def if_present(instead=None):
    """Make a function whose first argument may be None, of which it then makes `instead`."""

    def decorate(function):
        def absent(first, *arguments):
            return instead

        @functools.wraps(function)
        def call(first, *arguments):
            return (absent if first is None else function)(first, *arguments)

        @overload(call, jit_options=INNER, strict=False)
        def _choose(first, *arguments):
            return absent if isinstance(first, types.NoneType) else function

        return call

    return decorate


@if_present()
def item(array, i):
    """Return array[i], None if there is no array."""
    return array[i]


@if_present(0.0)
def item_or_zero(array, i):
    """Return array[i], 0.0 if there is no array."""
    return array[i]


@if_present()
def slice_if(present, array, start, count):
    """Return array[start : start + count], None if `present` is None."""
    return array[start : start + count]


@if_present()
def only_if(present, x):
    """Return x, None if `present` is None."""
    return x


@inline
def plus_item(x, array, i):
    """Return x + array[i], x if there is no array."""
    if array is None:
        return x
    return x + array[i]


def any_present(a, b):
    """Return True if one of both is present, None if neither is."""
    return None if a is None and b is None else True


@overload(any_present, jit_options=INNER)
def _any_present(a, b):
    if isinstance(a, types.NoneType) and isinstance(b, types.NoneType):
        return lambda a, b: None
    return lambda a, b: True


def viewer(of_array, of_shared):
    """Make a function that views arrays by `of_array`; of a structure all fields, but those that its class names as
    `SHARED` by `of_shared`, which views what is `Varying` in them.
    """

    def view(x):
        if isinstance(x, tuple):
            shared = getattr(x, "SHARED", ())
            return type(x)(*((of_shared if name in shared else view)(a) for name, a in zip(x._fields, x)))
        return x if x is None or isinstance(x, bool) else of_array(x)

    @overload(view, jit_options=INNER)
    def _view(x):
        if isinstance(x, types.Array):
            return lambda x: of_array(x)
        if isinstance(x, types.BaseNamedTuple | StructureType):
            shared = getattr(x.instance_class, "SHARED", ())
            fields = ", ".join(
                _field(name, name in shared, field) for name, field in zip(x.fields, x.types, strict=True)
            )
            scope = {"kind": x.instance_class, "view": view, "of_shared": of_shared}
            exec(f"def viewed(x): return kind({fields})", scope)  # Numba loops over no fields of different types
            return scope["viewed"]
        return lambda x: x

    return view


def _field(name, shared, kind):
    if shared:
        return f"of_shared(x.{name})" if varies(kind) else f"x.{name}"
    return f"view(x.{name})"


in_lanes = viewer(as_lanes, varying_in_lanes)
