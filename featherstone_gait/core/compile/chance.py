"""Look into a function for what differs from one call to the next: random numbers, clocks, what runs in Python.

The function is read as Numba reads it, with the functions that it calls, and not run.
"""

import random
import types

import numba
import numpy as np
from numba.core import compiler, ir
from numba.core.errors import NumbaError

CHANCE = ("random", "secrets", "time", "datetime", "uuid", "numpy.random")  # modules
DRAWING = (random.Random, np.random.RandomState, np.random.Generator)


def uses_chance(function):
    """Return the name of the first such thing that the function uses, None if it uses none."""
    return _found_in(function, set())


def _found_in(function, seen):
    code = getattr(function, "__code__", None)
    if code is None or code in seen:
        return None
    seen.add(code)
    try:
        read = compiler.run_frontend(function, inline_closures=True)
    except NumbaError:  # which compiling will name
        return None
    values = {}  # of variables, as far as they are Python's objects
    for _, block in sorted(read.blocks.items()):
        for one in block.find_insts(ir.Assign):
            value = _value(one.value, values)
            if value is None:
                continue
            values[one.target.name] = value
            found = _named(value) or _found_in(getattr(value, "py_func", value), seen)
            if found is not None:
                return found
    return None


def _value(node, values):
    """Return the object that a node of Numba's code stands for, None if it is known only when the code runs."""
    if isinstance(node, (ir.Global, ir.FreeVar)):
        return node.value
    if isinstance(node, ir.Var):
        return values.get(node.name)
    if isinstance(node, ir.Expr) and node.op == "getattr" and node.value.name in values:
        return getattr(values[node.value.name], node.attr, None)
    return None


def _named(value):
    """Return a name for what differs from call to call, None for all else."""
    if value is numba.objmode:
        return "objmode"
    if isinstance(value, types.ModuleType):
        return value.__name__ if value.__name__ in CHANCE else None
    module = getattr(value, "__module__", None) or ""
    if isinstance(getattr(value, "__self__", None), DRAWING) or module in CHANCE:
        return f"{module or 'random'}.{getattr(value, '__name__', value)}"
    return None
