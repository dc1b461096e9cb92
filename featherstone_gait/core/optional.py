"""Arrays that may be absent: None gives None, decided when a kernel is compiled.

Of `if array is None: return None` and `return array[i]` in one function Numba keeps both ways for an array and makes an
optional value of them, tested at each use: 1.3 times the run time in lanes, twice the compile time.
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


def lanes(array, i):
    """array[i] viewed as lanes, None if there is no array."""
    return None if array is None else as_lanes(array[i])


@overload(lanes)
def _lanes(array, i):
    if isinstance(array, types.NoneType):
        return lambda array, i: None
    return lambda array, i: as_lanes(array[i])
