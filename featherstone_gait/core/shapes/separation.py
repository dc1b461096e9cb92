"""Lower bounds of the gap of two shapes, by spheres and boxes about them, also in lanes: the broad phase of contact."""

from ..compile.jit import inline
from ..compile.lanes import any_lane, select, sqrt
from ..tree.spatial import dot, rotate_back
from .distance import HALF_SPACE


@inline
def gap_at_least(a, b, Ea, Eb, c, enough):
    """Return a lower bound of the gap of two shapes [m]; one that is not below `enough` may be any other that is not.

    Ea, Eb: rotations shape -> world; c: from the center of b to that of a, world axes [m].
    """
    if b.kind == HALF_SPACE:
        n = (Eb[2], Eb[5], Eb[8])
        return dot(n, c) - _smaller(half_width(a, Ea, n), a.bound + 0.0 * c[0])
    gap = sqrt(dot(c, c)) - (a.bound + b.bound)
    if any_lane(gap < enough):
        gap = _of_boxes(a, b, Ea, Eb, c, gap)
    return gap


@inline
def _of_boxes(a, b, Ea, Eb, c, gap):
    """Return how far boxes are apart along the face normal that divides them best, or `gap` if that is more [m].

    C. Ericson, "Real-Time Collision Detection", Elsevier 2005, section 4.4.1.
    """
    for k in range(3):
        n = (Ea[k], Ea[3 + k], Ea[6 + k])
        gap = _larger(gap, abs(dot(n, c)) - a.extent[k] - half_width(b, Eb, n))
        n = (Eb[k], Eb[3 + k], Eb[6 + k])
        gap = _larger(gap, abs(dot(n, c)) - b.extent[k] - half_width(a, Ea, n))
    return gap


@inline
def half_width(shape, E, n):
    """Return how far the box of a shape reaches from its center along the unit vector n [m]."""
    x, y, z = rotate_back(E, n)
    return abs(x) * shape.extent[0] + abs(y) * shape.extent[1] + abs(z) * shape.extent[2]


@inline
def _larger(x, y):
    return select(x > y, x, y)


@inline
def _smaller(x, y):
    return select(x < y, x, y)
