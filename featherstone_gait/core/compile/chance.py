"""Look into a function for what differs from one call to the next: random numbers, clocks, what runs in Python.

What its code names is looked up, with the functions that it calls; nothing runs.
"""

import dis
import random
import types

import numba
import numpy as np

CHANCE = ("random", "secrets", "time", "datetime", "uuid", "numpy.random")  # modules
DRAWING = (random.Random, np.random.RandomState, np.random.Generator)
KNOWN = ("numpy", "numba", "scipy")  # packages whose functions Numba has of its own


def uses_chance(function):
    """Return the name of the first such thing that the function uses, None if it uses none."""
    return _found_in(function, set())


def _found_in(function, seen):
    code = getattr(function, "__code__", None)
    if code is None or code in seen or (function.__module__ or "").partition(".")[0] in KNOWN:
        return None
    seen.add(code)
    own, attributes = _names(code, "LOAD_GLOBAL"), _names(code, "LOAD_ATTR", "LOAD_METHOD")
    used = [function.__globals__[name] for name in own if name in function.__globals__]
    used += [cell.cell_contents for cell in function.__closure__ or () if _is_full(cell)]
    for value in used:  # grows: what the code may take from a module, by the attributes that it names
        found = _named(value) or _found_in(getattr(value, "py_func", value), seen)
        if found is not None:
            return found
        if isinstance(value, types.ModuleType) and value not in seen:
            seen.add(value)
            used += [getattr(value, name) for name in attributes if hasattr(value, name)]
    return None


def _names(code, *operations):
    """Return the names on which a code, with those within it, does such operations, each once."""
    names = [one.argval for one in dis.get_instructions(code) if one.opname in operations]
    inner = [name for each in code.co_consts if isinstance(each, types.CodeType) for name in _names(each, *operations)]
    return list(dict.fromkeys([*names, *inner]))


def _is_full(cell):
    """Return whether a variable of an outer function has its value already."""
    try:
        return cell.cell_contents is not cell
    except ValueError:
        return False


def _named(value):
    """Return a name for what differs from call to call, None for all else."""
    if value is numba.objmode:
        return "objmode"
    if isinstance(value, types.ModuleType):
        return value.__name__ if value.__name__ in CHANCE else None
    module = getattr(value, "__module__", None) or ""
    if isinstance(value, DRAWING) or isinstance(getattr(value, "__self__", None), DRAWING) or module in CHANCE:
        return f"{module or 'random'}.{getattr(value, '__name__', type(value).__name__)}"
    return None
