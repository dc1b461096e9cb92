"""Poses, velocities and accelerations of all bodies, root to tips, in the common frame.

The recursion of RBDA Table 5.1 (first loop) without the transforms: in one frame a child's motion is its parent's
plus the joint's.  `A` is the true acceleration less gravity, so that weight enters as an inertial force.
"""

from ..compile.jit import inline, kernel
from ..compile.lanes import sqrt
from ..compile.optional import item
from .forest import base_count, rows_of
from .joint import joint_motion, joint_pose, joint_velocity, rotation_matrix
from .layout import A, P, R, U, V
from .spatial import add, cross, load3, load9, rotate, rotate_back, store3, store9, sub


@kernel
def motion_pass(tree, part, gravity, motion, W):
    """Fill R, P, V and A of every row of a tree.

    tree (n+1,) BODY, part TREE or None, gravity (3,) [m/s^2], motion a `Motion`, of the tree's base and of all joints.
    """
    root, end = rows_of(part, tree)
    _root(root, motion.base_q, motion.base_qd, motion.base_qdd, gravity, W)
    for i in range(root + 1, end):
        b = tree[i]
        joint_pose(motion.ball_q, b, i, motion.q[b.dof], W)
        joint_motion(motion.ball_q, b, i, motion.qd[b.dof], item(motion.qdd, b.dof), W)


@kernel
def pose_pass(tree, part, base_q, ball_q, q, W):
    """Fill R and P of every row of a tree."""
    root, end = rows_of(part, tree)
    store3(W, root, P, (0.0, 0.0, 0.0))
    if base_q is None:
        store9(W, root, R, (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0))
    else:
        store9(W, root, R, quaternion_matrix(base_q))
    for i in range(root + 1, end):
        joint_pose(ball_q, tree[i], i, q[tree[i].dof], W)


@kernel
def velocity_pass(tree, part, motion, W):
    """Fill R, P and V of every row of a tree, of a `Motion` without accelerations."""
    root, end = rows_of(part, tree)
    _root(root, motion.base_q, motion.base_qd, None, (0.0, 0.0, 0.0), W)
    for i in range(root + 1, end):
        b = tree[i]
        joint_pose(motion.ball_q, b, i, motion.q[b.dof], W)
        joint_velocity(motion.ball_q, b, i, motion.qd[b.dof], W)


@inline
def _root(root, base_q, base_qd, base_qdd, gravity, W):
    """Fill the root's row: the world, or the floating base."""
    up = (-gravity[0], -gravity[1], -gravity[2])
    store3(W, root, P, (0.0, 0.0, 0.0))
    if base_q is None:
        store9(W, root, R, (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0))
        store3(W, root, V, (0.0, 0.0, 0.0))
        store3(W, root, V + 3, (0.0, 0.0, 0.0))
        store3(W, root, A, (0.0, 0.0, 0.0))
        store3(W, root, A + 3, up)
    else:
        E = quaternion_matrix(base_q)
        v = (base_qd[0], base_qd[1], base_qd[2])
        w = rotate(E, (base_qd[3], base_qd[4], base_qd[5]))
        store9(W, root, R, E)
        store3(W, root, V, w)
        store3(W, root, V + 3, v)
        linear = sub(up, cross(w, v))  # of the spatial acceleration: the origin's less w x v
        if base_qdd is None:
            store3(W, root, A, (0.0, 0.0, 0.0))
            store3(W, root, A + 3, linear)
        else:
            store3(W, root, A, rotate(E, (base_qdd[3], base_qdd[4], base_qdd[5])))
            store3(W, root, A + 3, add(linear, (base_qdd[0], base_qdd[1], base_qdd[2])))


@inline
def quaternion_matrix(base_q):
    """Return the rotation (9) of the quaternion base_q[3:7] = w x y z of any length but zero, body -> world."""
    return rotation_matrix(base_q[3], base_q[4], base_q[5], base_q[6])


@inline
def base_acceleration(root, base_qdd, W):
    """Write the floating base's dA, found in the U columns of the root's row, as [dv/dt (world); d omega/dt (body)].

    base_qdd None: the base is fixed.
    """
    if base_qdd is not None:
        alpha = rotate_back(load9(W, root, R), load3(W, root, U))
        for k in range(3):
            base_qdd[k] = W[root, U + 3 + k]
            base_qdd[3 + k] = alpha[k]


@inline
def move_base(bq, bv, h, out):
    """Move a free base for the time h; out may be bq."""
    for k in range(3):
        out[k] = bq[k] + h * bv[k]
    turn(bq, 3, 0.5 * h * bv[3], 0.5 * h * bv[4], 0.5 * h * bv[5], out, 3)


@inline
def turn(bq, k, x, y, z, out, n):
    """Turn the quaternion bq[k : k + 4] by Cayley's map of (x, y, z) = h omega / 2, exact to third order."""
    a, b, c, d = bq[k], bq[k + 1], bq[k + 2], bq[k + 3]
    w = a - b * x - c * y - d * z
    i = b + a * x + c * z - d * y
    j = c + a * y + d * x - b * z
    m = d + a * z + b * y - c * x
    r = 1.0 / sqrt(w * w + i * i + j * j + m * m)
    out[n] = w * r
    out[n + 1] = i * r
    out[n + 2] = j * r
    out[n + 3] = m * r


@inline
def quaternion_rate(bq, bv, out):
    """Fill out (4,) with 1/2 quaternion omega [1/s] of a base's position (7,) and velocity (6,)."""
    turn_rate(bq, 3, 0.5 * bv[3], 0.5 * bv[4], 0.5 * bv[5], out, 0)


@inline
def turn_rate(bq, k, p, q, r, out, n):
    """Fill out[n : n + 4] with the quaternion bq[k : k + 4] times (p, q, r) = omega / 2 [1/s]."""
    w, x, y, z = bq[k], bq[k + 1], bq[k + 2], bq[k + 3]
    out[n] = -(x * p + y * q + z * r)
    out[n + 1] = w * p + y * r - z * q
    out[n + 2] = w * q + z * p - x * r
    out[n + 3] = w * r + x * q - y * p


@inline
def unit_quaternions(floating, trees, start, y):
    """Bring the quaternions of the floating bases, whose positions start at y[start], back to length 1."""
    if floating is not None:
        for base in range(base_count(trees)):
            unit_quaternion(y, start + 7 * base + 3)


@inline
def unit_quaternion(y, k):
    """Bring the quaternion y[k : k + 4] back to length 1."""
    r = 1.0 / sqrt(y[k] * y[k] + y[k + 1] * y[k + 1] + y[k + 2] * y[k + 2] + y[k + 3] * y[k + 3])
    for i in range(4):
        y[k + i] = y[k + i] * r
