"""One call written out many times when a kernel is compiled: for each number of tuples, for each part that is there.

Numba loops over no values of different types, and a loop over a tuple costs a jump an item.
"""

import functools
import inspect
import re

from numba import types
from numba.extending import overload

from .jit import INLINE


def componentwise(expression, joined=", ", **scope):
    """Make a function of tuples of one length, and numbers, by what it makes of one component of each.

    expression : str
        In terms of its arguments' components {0}, {1} ... and of what is in `scope`.
    joined : str
        Between the components: ", " makes a tuple of them, " + " the sum from the first to the last.
    """

    @functools.cache
    def written(*widths):  # 0: a number
        names = [f"x{k}" for k in range(len(widths))]
        parts = [
            expression.format(*(f"{name}[{k}]" if width else name for name, width in zip(names, widths)))
            for k in range(max(widths))
        ]
        return _defined(", ".join(names), f"return ({joined.join(parts)}{',' if joined == ', ' else ''})", **scope)

    def call(*arguments):
        return written(*(len(x) if isinstance(x, tuple) else 0 for x in arguments))(*arguments)

    @overload(call, jit_options=INLINE, strict=False)
    def _choose(*kinds):
        return written(*(len(kind) if isinstance(kind, types.BaseTuple) else 0 for kind in kinds))

    return call


def for_each(function, parts, carried=(), **scope):
    """Make a function of `step` and more that calls `function` for each of the parts, in their order.

    parts : sequence of str
        The first arguments of the calls: expressions of `step` and of what is in `scope`.  A part whose attribute of
        `step` is None is left out.
    carried : sequence of str
        Arguments of `function` that it returns anew, for the next call and in the end.
    """
    names = [*inspect.signature(function).parameters][1:]
    at, back = names.index("step"), ", ".join(carried)

    @functools.cache
    def written(present):
        calls = [f"function({part}, {', '.join(names)})" for part, there in zip(parts, present) if there]
        lines = [f"{back} = {call}" if back else call for call in calls]
        return _defined(", ".join(names), "; ".join([*lines, f"return {back}"]), function=function, **scope)

    def call(*arguments):
        return written(tuple(_is_there(part, arguments[at], type(None)) for part in parts))(*arguments)

    @overload(call, jit_options=INLINE, strict=False)
    def _choose(*kinds):
        return written(tuple(_is_there(part, kinds[at], types.NoneType) for part in parts))

    return call


def _is_there(part, step, absent):
    """Return whether the attribute of `step` in an expression is there; of a Numba type, whether its type is."""
    for name in re.findall(r"(?<=\.)\w+", part):
        if isinstance(step, absent):
            return False
        step = step.types[step.fields.index(name)] if isinstance(step, types.Type) else getattr(step, name)
    return not isinstance(step, absent)


def _defined(names, body, **scope):
    exec(f"def written_out({names}): {body}", scope)
    return scope["written_out"]
