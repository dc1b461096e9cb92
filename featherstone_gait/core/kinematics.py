"""Poses, velocities and accelerations of all bodies, root to tips, in the common frame.

The recursion of RBDA Table 5.1 (first loop) without the transforms: in one frame a child's motion is its parent's
plus the joint's.  `A` is the true acceleration less gravity, so that weight enters as an inertial force.
"""

from .elementary import sincos
from .jit import inline, kernel
from .layout import A, P, R, U, V
from .optional import item
from .spatial import add, compose, cross, load3, load9, rotate, rotate_back, scale, store3, store9, sub


@kernel
def motion_pass(tree, base_q, base_qd, base_qdd, q, qd, qdd, gravity, W):
    """Fill R, P, V and A of every row.

    tree (n+1,) BODY; base_q (7,) and base_qd, base_qdd (6,) of a floating base, None of a fixed one (base_qdd also
    None for zero); q, qd (n,) joints [rad or m, per s]; qdd (n,) [per s^2] or None for zero; gravity (3,) [m/s^2].
    """
    _root(base_q, base_qd, base_qdd, gravity, W)
    for i in range(1, len(tree)):
        b = tree[i]
        _pose(b, i, q[b.dof], W)
        _joint_motion(b, i, qd[b.dof], item(qdd, b.dof), W)


@inline
def _root(base_q, base_qd, base_qdd, gravity, W):
    """Row 0: the world, or the floating base."""
    up = (-gravity[0], -gravity[1], -gravity[2])
    store3(W, 0, P, (0.0, 0.0, 0.0))
    if base_q is None:
        store9(W, 0, R, (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0))
        store3(W, 0, V, (0.0, 0.0, 0.0))
        store3(W, 0, V + 3, (0.0, 0.0, 0.0))
        store3(W, 0, A, (0.0, 0.0, 0.0))
        store3(W, 0, A + 3, up)
    else:
        E = quaternion_matrix(base_q)
        v = (base_qd[0], base_qd[1], base_qd[2])
        w = rotate(E, (base_qd[3], base_qd[4], base_qd[5]))
        store9(W, 0, R, E)
        store3(W, 0, V, w)
        store3(W, 0, V + 3, v)
        _root_acceleration(E, w, v, base_qdd, up, W)


@inline
def _root_acceleration(E, w, v, base_qdd, up, W):
    """Spatial acceleration of the base: the linear part is that of the origin less w x v."""
    linear = sub(up, cross(w, v))
    if base_qdd is None:
        store3(W, 0, A, (0.0, 0.0, 0.0))
        store3(W, 0, A + 3, linear)
    else:
        store3(W, 0, A, rotate(E, (base_qdd[3], base_qdd[4], base_qdd[5])))
        store3(W, 0, A + 3, add(linear, (base_qdd[0], base_qdd[1], base_qdd[2])))


@inline
def quaternion_matrix(base_q):
    """Rotation of the quaternion base_q[3:7] = w x y z of any length but zero."""
    w, x, y, z = base_q[3], base_q[4], base_q[5], base_q[6]
    s = 2.0 / (w * w + x * x + y * y + z * z)
    return (
        1.0 - s * (y * y + z * z),
        s * (x * y - w * z),
        s * (x * z + w * y),
        s * (x * y + w * z),
        1.0 - s * (x * x + z * z),
        s * (y * z - w * x),
        s * (x * z - w * y),
        s * (y * z + w * x),
        1.0 - s * (x * x + y * y),
    )


@inline
def _pose(b, i, q, W):
    """R = R_parent E Rz(q) and the origin; a prismatic joint moves along z instead."""
    Rp = load9(W, b.parent, R)
    E = compose(Rp, b.E)
    p = add(load3(W, b.parent, P), rotate(Rp, b.r))
    if b.prismatic:
        store9(W, i, R, E)
        store3(W, i, P, add(p, scale((E[2], E[5], E[8]), q)))
    else:
        s, c = sincos(q)
        store3(W, i, R, (E[0] * c + E[1] * s, E[1] * c - E[0] * s, E[2]))
        store3(W, i, R + 3, (E[3] * c + E[4] * s, E[4] * c - E[3] * s, E[5]))
        store3(W, i, R + 6, (E[6] * c + E[7] * s, E[7] * c - E[6] * s, E[8]))
        store3(W, i, P, p)


@inline
def _joint_motion(b, i, qd, qdd, W):
    """V = V_parent + S qd and A = A_parent + V_parent x S qd + S qdd."""
    s = (W[i, R + 2], W[i, R + 5], W[i, R + 8])
    wp = load3(W, b.parent, V)
    vp = load3(W, b.parent, V + 3)
    ap = load3(W, b.parent, A)
    bp = load3(W, b.parent, A + 3)
    sd = scale(s, qd)
    if b.prismatic:
        store3(W, i, V, wp)
        store3(W, i, V + 3, add(vp, sd))
        store3(W, i, A, ap)
        store3(W, i, A + 3, _plus(add(bp, cross(wp, sd)), s, qdd))
    else:
        r = cross(load3(W, i, P), s)
        rd = scale(r, qd)
        store3(W, i, V, add(wp, sd))
        store3(W, i, V + 3, add(vp, rd))
        store3(W, i, A, _plus(add(ap, cross(wp, sd)), s, qdd))
        store3(W, i, A + 3, _plus(add(bp, add(cross(wp, rd), cross(vp, sd))), r, qdd))


@inline
def _plus(a, s, qdd):
    """a + s qdd, a where there is no qdd."""
    if qdd is None:
        return a
    return add(a, scale(s, qdd))


@inline
def base_acceleration(base_qdd, W):
    """Write the floating base's dA, found in the U columns of row 0, as [dv/dt (world); d omega/dt (body)]."""
    alpha = rotate_back(load9(W, 0, R), load3(W, 0, U))
    for k in range(3):
        base_qdd[k] = W[0, U + 3 + k]
        base_qdd[3 + k] = alpha[k]
