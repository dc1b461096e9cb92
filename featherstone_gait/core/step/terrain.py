"""Bound the steps of error control over ground that has narrow parts: steps, or the cells of a height field.

A step sees the ground at its stages alone.  The tip of a leg that swings past a ridge between two of them feels
nothing, however small the tolerance, and a second run is as blind.  So no point passes more in a step than a share of
its height over the ground, or of what is narrow there; on a plane nothing is.
"""

from ..compile.by_type import overridable
from ..compile.jit import inline
from ..compile.lanes import sqrt
from ..compile.optional import if_present
from ..effects.contact import DEPTH, U0
from ..effects.ground import narrowest

OF_HEIGHT = 0.4  # way of a point in a step by its height over the ground, along the normal there
LEAST, MOST = 1.0 / 16.0, 0.5  # of what is narrow, that it may pass at least and at most


@overridable
def last_points(work):
    """Return the scratch array of the contact points as a step has left it, with an axis of lanes at its end."""
    C = work.scratch.C
    return C.reshape((C.shape[0], C.shape[1], 1))


@if_present(1e300)
def longest_over(contact, run, y, h, least):
    """Return how long a step may be [s], from `least` on; more than h where that is not less.

    The speeds of the points are those of the last stage; a wheel that rolls is as fast as the base that it carries.
    """
    C, narrow = last_points(run.work), narrowest(contact.ground)
    if LEAST * narrow > 1e200:
        return 1e300
    rate, base = 0.0, _fastest_base(run.scene.floating, run, y)
    for c in range(len(contact.points)):
        for lane in range(C.shape[2]):
            squares = 0.0
            for k in range(3):
                squares += C[c, U0 + k, lane] * C[c, U0 + k, lane]
            way = min(max(OF_HEIGHT * abs(C[c, DEPTH, lane]), LEAST * narrow), MOST * narrow)
            rate = max(rate, max(sqrt(squares), base) / way)
    return max(1.0 / rate, least) if rate * h > 1.0 else 1e300


@if_present(0.0)
def _fastest_base(floating, run, y):
    """Return the largest speed of a base [m/s]."""
    fastest = 0.0
    for k in range(_count(run.scene.trees)):
        v = run.offsets[0].base_qd + 6 * k
        fastest = max(fastest, sqrt(y[v] * y[v] + y[v + 1] * y[v + 1] + y[v + 2] * y[v + 2]))
    return fastest


@inline
def _count(trees):
    if trees is None:
        return 1
    return len(trees)
