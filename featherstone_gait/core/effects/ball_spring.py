"""Springs of ball joints: a torque that turns a joint back to its zero orientation, -K x of its rotation vector x.

In the child's axes, in which the joint's rates are, x dx/dt = x w: the torque has the potential K x^2 / 2.  An implicit
step takes it at its end, where the rotation vector is x + h w but for terms of second order in the step, so its slope
is h K about each axis.
"""

from ..compile.elementary import angle
from ..compile.jit import inline
from ..compile.lanes import select, sqrt
from ..tree.forest import balls_of


@inline
def rotation_vector(q, k):
    """Return the rotation vector (3) [rad] of the quaternion w x y z at q[k] of any length, at most half a turn."""
    w, x, y, z = q[k], q[k + 1], q[k + 2], q[k + 3]
    s = sqrt(x * x + y * y + z * z)
    none = s == 0.0
    half = angle(s, abs(w)) / select(none, 1.0 + 0.0 * s, s)
    f = select(none, 0.0 * s, 2.0 * select(w < 0.0, -half, half))
    return f * x, f * y, f * z


@inline
def place_ball_springs(springs, balls, part, q, v, ahead, angles):
    """Fill `angles` (n,) with the rotation vectors from which a tree's joints move on with the speeds v (n,).

    q: the joints' quaternions `ahead` [s] after the step's start.
    """
    if springs is not None:
        first, end = balls_of(part, balls)
        for k in range(first, end):
            i, x = balls[k], rotation_vector(q, 4 * k)
            for j in range(3):
                angles[i + j] = x[j] - ahead * v[i + j]


@inline
def plus_ball_spring(springs, angles, h, i, v, T, c):
    """Return T plus the torque of a ball joint's spring about one axis at the speed v [N m], and c plus its slope."""
    if springs is None:
        return T, c
    return T - springs[i] * (angles[i] + h * v), c + h * springs[i]
