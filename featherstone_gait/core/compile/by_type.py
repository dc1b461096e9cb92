"""Functions of kernels that are chosen by the type of their first argument when a kernel is compiled.

    @by_type
    def force(actuator, s, i):
        \"\"\"Return the force of the actuator.\"\"\"

    @force.of(Servo)
    def _servo_force(actuator, s, i):
        ...

`Servo` is a NamedTuple class, or NoneType for an actuator that is absent.  A kind that a kernel is not compiled for
costs nothing, and new kinds register themselves.  What is `overridable` need not be registered for a type: its own body
holds for all others.  With the JIT off both are a look-up by `type`.
"""

import functools

from numba import types
from numba.core.errors import TypingError
from numba.extending import overload

from .jit import INLINE

NoneType = type(None)


def by_type(function, default=None):
    """Make `function` a choice among what `function.of(Type, ...)` registers; its own body never runs."""
    kinds = {}

    @functools.wraps(function)
    def call(chosen, *arguments):
        return found(type(chosen))(chosen, *arguments)

    def found(kind):
        if kind not in kinds and default is None:
            known = ", ".join(k.__name__ for k in kinds)
            raise TypingError(f"{function.__name__}: there is none of {kind}; there are those of {known}")
        return kinds.get(kind, default)

    def of(*types_):
        def register(implementation):
            kinds.update(dict.fromkeys(types_, implementation))
            return implementation

        return register

    @overload(call, jit_options=INLINE, strict=False)
    def _choose(chosen, *arguments):
        return found(NoneType if isinstance(chosen, types.NoneType) else getattr(chosen, "instance_class", chosen))

    call.of = of
    return call


def overridable(function):
    """Make `function` a choice by type too, whose own body holds for types for which nothing is registered."""
    return by_type(function, function)
