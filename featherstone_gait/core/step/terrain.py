"""Bound the steps of error control near the ground, so that no point passes through it between two stages.

A step sees the ground at its stages alone.  The tip of a leg that swings past a ridge, or through the floor and out
again, between two of them feels nothing, however small the tolerance, and a second run is as blind.  So no point passes
more in a step than a share of its height over the ground, or else of what is narrow there: of the ground a length, and
of the arc on which the point moves an angle.
"""

from ..compile.by_type import overridable
from ..compile.jit import inline
from ..compile.lanes import sqrt
from ..compile.optional import if_present
from ..effects.contact import DEPTH, U0
from ..shapes.ground import narrowest
from ..tree.layout import V

OF_HEIGHT = 0.4  # way of a point in a step by its height over the ground, along the normal there
LEAST_SHARE, LARGEST_SHARE = 1.0 / 16.0, 0.5  # of what is narrow, that it may pass at least and at most
TURN = 0.1  # by which what carries it may turn otherwise [rad]: of an arc 1/800 of the radius lies behind its chord


@overridable
def last_stage(work):
    """Return the scratch arrays W and C as a step has left them, with an axis of lanes at their end."""
    W, C = work.scratch.W, work.scratch.C
    return W.reshape((W.shape[0], W.shape[1], 1)), C.reshape((C.shape[0], C.shape[1], 1))


@if_present(1e300)
def longest_over(contact, run, y, h, least):
    """Return how long a step may be [s], from `least` on; more than h where that is not less.

    The speeds of the points are those of the last stage; a wheel that rolls is as fast as the base that it carries.
    """
    (W, C), narrow = last_stage(run.work), narrowest(contact.ground)
    uneven = LEAST_SHARE * narrow < 1e200
    rate, base = 0.0, 0.0
    if uneven:
        base = _fastest_base(run.scene.floating, run, y)
    for c in range(len(contact.points)):
        for lane in range(C.shape[2]):
            speed, height = _length(C, c, U0, lane), OF_HEIGHT * abs(C[c, DEPTH, lane])
            if speed * h > height:
                turning = _fastest_turn(run.scene.tree, contact.points[c].body, W, lane) / TURN
                rate = max(rate, min(turning, speed / max(height, 1e-300)))
            if uneven:
                rate = max(rate, max(speed, base) / min(max(height, LEAST_SHARE * narrow), LARGEST_SHARE * narrow))
    return max(1.0 / rate, least) if rate * h > 1.0 else 1e300


@inline
def _fastest_turn(tree, i, W, lane):
    """Return the largest angular velocity of body i and those that carry it [rad/s]."""
    fastest = _length(W, i, V, lane)
    while i != tree[i].parent and i > 0:
        i = tree[i].parent
        fastest = max(fastest, _length(W, i, V, lane))
    return fastest


@inline
def _length(array, row, column, lane):
    squares = 0.0
    for k in range(3):
        squares += array[row, column + k, lane] * array[row, column + k, lane]
    return sqrt(squares)


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
