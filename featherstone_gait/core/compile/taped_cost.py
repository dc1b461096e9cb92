"""Costs of a run: functions written by users, compiled for taped numbers, with what they take from math and NumPy.

Such a function takes arrays of numbers on the tape and plain ones, and returns one number.
"""

import math
import operator

import numpy as np
from numba import types
from numba.extending import overload, register_jitable

from . import elementary
from .jit import INLINE, JIT, checked, entry
from .lanes import sqrt
from .taped import (
    ADJOINT,
    Tape,
    Taped,
    chained,
    chained_by_two,
    entry_of,
    on_the_tape,
    place_of,
    sweep,
    taped_view,
    value_of,
)

FIRST_ENTRIES, MOST_ENTRIES = 2**16, 2**21 - 2  # of a tape at first, and at most


def _of_one(functions, change):
    """Let functions of math and NumPy take a taped number; change(v): the value and the slope at the number v."""
    change = register_jitable(change)

    def chosen(x):
        def changed(x):
            number, slope = change(value_of(x))
            return chained(x, number, slope)

        return changed if x is Taped else None

    for function in functions:
        overload(function, jit_options=INLINE)(chosen)


def _root(v):
    r = sqrt(v)
    return r, 0.5 / r


def _exponential(v):
    e = elementary.exp(v)
    return e, e


def _tangent(v):
    s, c = elementary.sincos(v)
    return s / c, 1.0 / (c * c)


def _hyperbolic_tangent(v):
    t = math.tanh(v)
    return t, 1.0 - t * t


def _cosine(v):
    s, c = elementary.sincos(v)
    return c, -s


_of_one((math.sin, np.sin), lambda v: elementary.sincos(v))
_of_one((math.cos, np.cos), _cosine)
_of_one((math.tan, np.tan), _tangent)
_of_one((math.tanh, np.tanh), _hyperbolic_tangent)
_of_one((math.exp, np.exp), _exponential)
_of_one((math.log, np.log), lambda v: (elementary.log(v), 1.0 / v))
_of_one((math.sqrt, np.sqrt), _root)
_of_one((math.asin, np.arcsin), lambda v: (math.asin(v), 1.0 / math.sqrt(1.0 - v * v)))
_of_one((math.acos, np.arccos), lambda v: (math.acos(v), -1.0 / math.sqrt(1.0 - v * v)))
_of_one((math.atan, np.arctan), lambda v: (math.atan(v), 1.0 / (1.0 + v * v)))
_of_one((math.fabs, np.abs), lambda v: (abs(v), -1.0 if v < 0.0 else 1.0))


def _both(x, y):
    """Return whether two types are of numbers of which one is taped."""
    numbers = (types.Float, types.Integer)
    return Taped in (x, y) and all(each is Taped or isinstance(each, numbers) for each in (x, y))


def _angle(y, x):
    def angle(y, x):
        a, b = on_the_tape(y), on_the_tape(x)
        v, w = value_of(a), value_of(b)
        r = v * v + w * w
        return chained_by_two(a, b, math.atan2(v, w), w / r, -v / r)

    return angle if _both(y, x) else None


def _larger(a, b):
    return (lambda a, b: on_the_tape(a) if a > b else on_the_tape(b)) if _both(a, b) else None


def _smaller(a, b):
    return (lambda a, b: on_the_tape(a) if a < b else on_the_tape(b)) if _both(a, b) else None


def _length(x, y):
    return (lambda x, y: math.sqrt(x * x + y * y)) if _both(x, y) else None


def _power(x, y):
    """A taped number to a constant power; to a taped one by exponential and logarithm."""

    def to_integer(x, y):
        v = value_of(x)
        return chained(x, v**y, y * v ** (y - 1) if y != 0 else 0.0)

    def to_number(x, y):
        v = value_of(x)
        return chained(x, v**y, y * v ** (y - 1.0))

    if x is Taped and isinstance(y, types.Integer):
        return to_integer
    if x is Taped and isinstance(y, types.Float):
        return to_number
    return (lambda x, y: math.exp(y * math.log(x))) if _both(x, y) else None


def _sum(a):
    def total(a):
        found = on_the_tape(0.0)
        for x in a.flat:
            found += x
        return found

    return total if isinstance(a, types.Array) and a.dtype is Taped else None


def _mean(a):
    return (lambda a: np.sum(a) / a.size) if isinstance(a, types.Array) and a.dtype is Taped else None


for _function, _kind in (
    (math.atan2, _angle), (np.arctan2, _angle), (max, _larger), (min, _smaller), (np.maximum, _larger),
    (np.minimum, _smaller), (math.hypot, _length), (np.hypot, _length), (operator.pow, _power), (np.sum, _sum),
    (np.mean, _mean),
):  # fmt: skip
    overload(_function, jit_options=INLINE)(_kind)


@entry
def _sweep(numbers, links, end):
    sweep(numbers, links, 2, end)


class TapedFunction:
    """A function of arrays that returns one number, with its derivative by those that are taped.

    taped: of each of its arguments whether it is.
    """

    def __init__(self, function, taped):
        self.taped, self.entries, self.call = taped, FIRST_ENTRIES, None
        if JIT:
            inner = checked(function)
            names = [f"a{k}" for k in range(len(taped))]
            given = ", ".join(f"taped_view({name})" if is_taped else name for name, is_taped in zip(names, taped))
            scope = {"function": inner, "taped_view": taped_view, "ended": _ended}
            exec(f"def call({', '.join(names)}):\n    return ended(function({given}))", scope)
            self.call = checked(scope["call"])

    def value_and_derivatives(self, arrays):
        """Return the value, and the derivatives by each taped array, in its shape; None of others."""
        if self.call is None:
            raise NotImplementedError("derivatives of costs need compiled kernels: unset NUMBA_DISABLE_JIT")
        while True:
            total = sum(array.size for array in arrays)
            if total + self.entries > MOST_ENTRIES:
                raise ValueError(
                    f"cost: it takes {total} numbers and more than {self.entries // 4} operations; both together may "
                    f"be {MOST_ENTRIES}: record fewer channels, or less often"
                )
            tape = Tape(self.entries + total)
            given, firsts = [], []
            for array, taped in zip(arrays, self.taped):
                memory = np.ascontiguousarray(array, dtype=float)
                if taped:
                    memory = np.zeros((*array.shape, 2))
                    memory[..., 0] = array
                    firsts.append(tape.inputs(memory))
                given.append(memory)
            value, last = self.call(*given)
            if tape.first < len(tape.numbers) - 1:
                break
            self.entries *= 4
        if last:
            tape.numbers[last, ADJOINT] = 1.0
            _sweep(tape.numbers, tape.links, tape.first)
        found, firsts = [], iter(firsts)
        for array, taped in zip(arrays, self.taped):
            first = next(firsts) if taped else 0
            numbers = tape.numbers[first : first + array.size, ADJOINT].reshape(array.shape).copy()
            found.append(numbers if taped else None)
        return value, found


@checked
def _ended(x):
    result = on_the_tape(x)
    return value_of(result), place_of(entry_of(result))
