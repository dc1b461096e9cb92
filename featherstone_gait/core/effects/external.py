"""External forces on the bodies: the sum of all that is not folded into the step."""

from ..compile.jit import inline
from ..compile.optional import any_present
from .push import add_pushes
from .spring import add_springs


@inline
def external_forces(push, springs, step):
    """Fill s.F (n + 1, 6) with what acts, as [moment; force] about the common origin; None where nothing does."""
    _clear(any_present(push, springs), step.F)
    if push is not None:
        add_pushes(push, step.t, step.span, step.W, step.F)
    if springs is not None:
        add_springs(springs, step.W, step.F)


@inline
def _clear(present, F):
    if present is not None:
        for i in range(len(F)):
            for k in range(6):
                F[i, k] = 0.0
