"""Orientations of ball joints: quaternions w x y z child -> parent, which three rates of joints turn.

The rates are the angular velocity in the child's axes.  `balls` (balls,) holds the first of each joint's three
coordinates; None: the scene has no ball joints.  The three positions beside the rates are the integrals of the rates:
error control watches them, nothing else reads them.
"""

from ..compile.jit import inline
from ..compile.optional import slice_if
from .forest import balls_of
from .kinematics import turn, turn_rate, unit_quaternion


@inline
def ball_positions(balls, array, start):
    """Return the quaternions (4 balls,) that start at array[start]; None if there are none."""
    return slice_if(balls, array, start, 4 * _count(balls))


@inline
def last_balls(balls, array):
    """Return the quaternions (4 balls,) at the end of an array; None if there are none."""
    return slice_if(balls, array, len(array) - 4 * _count(balls), 4 * _count(balls))


@inline
def _count(balls):
    if balls is None:
        return 0
    return len(balls)


@inline
def move_balls(balls, part, q, v, h, out):
    """Turn the quaternions q of a tree for the time h by the rates v (n,); out may be q."""
    if balls is not None:
        first, end = balls_of(part, balls)
        for k in range(first, end):
            i = balls[k]
            turn(q, 4 * k, 0.5 * h * v[i], 0.5 * h * v[i + 1], 0.5 * h * v[i + 2], out, 4 * k)


@inline
def ball_rates(balls, part, q, v, out):
    """Fill out with the rates [1/s] of the quaternions q of a tree at the rates v (n,)."""
    if balls is not None:
        first, end = balls_of(part, balls)
        for k in range(first, end):
            i = balls[k]
            turn_rate(q, 4 * k, 0.5 * v[i], 0.5 * v[i + 1], 0.5 * v[i + 2], out, 4 * k)


@inline
def unit_balls(balls, start, y):
    """Bring the quaternions that start at y[start] back to length 1."""
    if balls is not None:
        for k in range(len(balls)):
            unit_quaternion(y, start + 4 * k)
