"""Arrays that may be absent: None gives None, decided when a kernel is compiled.

Of `if array is None: return None` and `return array[i]` in one function Numba keeps both ways for an array and makes an
optional value of them, tested at each use: 1.3 times the run time in lanes, 1.2 times the compile time.
"""

from numba import types
from numba.extending import overload

from .lanes import as_lanes


def item(array, i):
    """array[i], None if there is no array."""
    return None if array is None else array[i]


@overload(item)
def _item(array, i):
    if isinstance(array, types.NoneType):
        return lambda array, i: None
    return lambda array, i: array[i]


def viewed(array):
    """The array viewed as lanes, None if there is no array."""
    return None if array is None else as_lanes(array)


@overload(viewed)
def _viewed(array):
    if isinstance(array, types.NoneType):
        return lambda array: None
    return lambda array: as_lanes(array)


def lanes(array, i):
    """array[i] viewed as lanes, None if there is no array."""
    return None if array is None else as_lanes(array[i])


@overload(lanes)
def _lanes(array, i):
    if isinstance(array, types.NoneType):
        return lambda array, i: None
    return lambda array, i: as_lanes(array[i])


def part(present, array, start, count):
    """array[start : start + count], None if `present` is None."""
    return None if present is None else array[start : start + count]


@overload(part)
def _part(present, array, start, count):
    if isinstance(present, types.NoneType):
        return lambda present, array, start, count: None
    return lambda present, array, start, count: array[start : start + count]


def when(present, array):
    """The array, None if `present` is None."""
    return None if present is None else array


@overload(when)
def _when(present, array):
    if isinstance(present, types.NoneType):
        return lambda present, array: None
    return lambda present, array: array


def either(a, b):
    """True if one of both is present, None if neither is."""
    return None if a is None and b is None else True


@overload(either)
def _either(a, b):
    if isinstance(a, types.NoneType) and isinstance(b, types.NoneType):
        return lambda a, b: None
    return lambda a, b: True
