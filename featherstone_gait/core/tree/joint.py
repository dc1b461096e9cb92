"""Joint types: the pose and the motion subspace of a joint, `jcalc` of RBDA section 4.4.  No other kernel knows them.

A joint turns about, or slides along, the z axis of its body's frame.  In the common frame, with s that axis in the
world and p the frame's origin, the subspace is S = [s; p x s] of a revolute, S = [0; s] of a prismatic joint and
S = [s; p x s + pitch s] of a screw.

The subspace of a ball joint has three columns, [s; p x s] about the child's axes x, y and z, and the rates are the
child's angular velocity in its own axes.  Each column has a row of the tree: the first turns by the quaternion, and in
their frames z is the child's x, then y, then z.  The elimination of one column after the other is that of the
joint's 3 x 3 matrix D.
"""

from ..compile.elementary import sincos
from ..compile.jit import inline
from .layout import BALL, BALL_AXIS, PRISMATIC, SCREW, A, P, R, V
from .spatial import add, compose, cross, dot, load3, load9, rotate, rotate_back, scale, store3, store9, sub, symmetric


@inline
def _axis(i, W):
    return (W[i, R + 2], W[i, R + 5], W[i, R + 8])


@inline
def _lever(b, i, s, W):
    """Return the linear part of S of a joint that turns, about the axis s."""
    r = cross(load3(W, i, P), s)
    if b.kind == SCREW:
        r = add(r, scale(s, b.pitch))
    return r


@inline
def joint_pose(ball_q, b, i, q, W):
    """Fill R = R_parent E Rz(q) and the origin P [m]; ball_q (4 balls,): see `Motion`."""
    if ball_q is None:
        _moved(b, i, q, W)
    elif b.kind == BALL:
        k = 4 * b.ball  # z is the child's x, so that its x and y are the child's y and z
        turned = rotation_matrix(ball_q[k], ball_q[k + 2], ball_q[k + 3], ball_q[k + 1])
        Rp = load9(W, b.parent, R)
        store9(W, i, R, compose(compose(Rp, b.E), turned))
        store3(W, i, P, add(load3(W, b.parent, P), rotate(Rp, b.r)))
    elif b.kind == BALL_AXIS:
        store9(W, i, R, compose(load9(W, b.parent, R), b.E))
        store3(W, i, P, load3(W, b.parent, P))
    else:
        _moved(b, i, q, W)


@inline
def rotation_matrix(w, x, y, z):
    """Return the rotation (9) of a quaternion of any length but zero."""
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
def _moved(b, i, q, W):
    """Turn about z, or slide along it, or both."""
    Rp = load9(W, b.parent, R)
    E = compose(Rp, b.E)
    p = add(load3(W, b.parent, P), rotate(Rp, b.r))
    if b.kind == PRISMATIC:
        store9(W, i, R, E)
        store3(W, i, P, add(p, scale((E[2], E[5], E[8]), q)))
    else:
        s, c = sincos(q)
        if b.kind == SCREW:
            p = add(p, scale((E[2], E[5], E[8]), b.pitch * q))
        store3(W, i, R, (E[0] * c + E[1] * s, E[1] * c - E[0] * s, E[2]))
        store3(W, i, R + 3, (E[3] * c + E[4] * s, E[4] * c - E[3] * s, E[5]))
        store3(W, i, R + 6, (E[6] * c + E[7] * s, E[7] * c - E[6] * s, E[8]))
        store3(W, i, P, p)


@inline
def joint_motion(ball_q, b, i, qd, qdd, W):
    """Fill V = V_parent + S qd and A = A_parent + V_parent x S qd + S qdd; qdd None for zero.

    The axes of a ball joint turn with the child, whose V x S qd, over all of them, is V_parent x S qd.
    """
    if ball_q is None:
        _moving(b, i, qd, qdd, load3(W, b.parent, V), load3(W, b.parent, V + 3), W)
    else:
        k = b.carrier
        _moving(b, i, qd, qdd, load3(W, k, V), load3(W, k, V + 3), W)
        if b.kind == BALL_AXIS:  # the rows before move too
            store3(W, i, V, add(load3(W, i, V), sub(load3(W, b.parent, V), load3(W, k, V))))
            store3(W, i, V + 3, add(load3(W, i, V + 3), sub(load3(W, b.parent, V + 3), load3(W, k, V + 3))))


@inline
def joint_velocity(ball_q, b, i, qd, W):
    """Fill V = V_parent + S qd alone."""
    k = b.parent
    if ball_q is not None:
        k = b.carrier
    s, wp, vp = _axis(i, W), load3(W, k, V), load3(W, k, V + 3)
    sd = scale(s, qd)
    if b.kind == PRISMATIC:
        store3(W, i, V, wp)
        store3(W, i, V + 3, add(vp, sd))
    else:
        store3(W, i, V, add(wp, sd))
        store3(W, i, V + 3, add(vp, scale(_lever(b, i, s, W), qd)))
    if ball_q is not None:
        if b.kind == BALL_AXIS:
            store3(W, i, V, add(load3(W, i, V), sub(load3(W, b.parent, V), wp)))
            store3(W, i, V + 3, add(load3(W, i, V + 3), sub(load3(W, b.parent, V + 3), vp)))


@inline
def _moving(b, i, qd, qdd, wp, vp, W):
    s = _axis(i, W)
    ap = load3(W, b.parent, A)
    bp = load3(W, b.parent, A + 3)
    sd = scale(s, qd)
    if b.kind == PRISMATIC:
        store3(W, i, V, wp)
        store3(W, i, V + 3, add(vp, sd))
        store3(W, i, A, ap)
        store3(W, i, A + 3, _plus(add(bp, cross(wp, sd)), s, qdd))
    else:
        r = _lever(b, i, s, W)
        rd = scale(r, qd)
        store3(W, i, V, add(wp, sd))
        store3(W, i, V + 3, add(vp, rd))
        store3(W, i, A, _plus(add(ap, cross(wp, sd)), s, qdd))
        store3(W, i, A + 3, _plus(add(bp, add(cross(wp, rd), cross(vp, sd))), r, qdd))


@inline
def _plus(a, s, qdd):
    """Return a + s qdd, a where there is no qdd."""
    if qdd is None:
        return a
    return add(a, scale(s, qdd))


@inline
def project(b, i, J, H, M, n, f, W):
    """Return U = IA S as moment and force, D = S' U and S' pA, of IA = [[J, H], [H', M]] and pA = [n; f]."""
    s = _axis(i, W)
    if b.kind == PRISMATIC:
        Un, Uf = rotate(H, s), symmetric(M, s)
        D, Sp = dot(s, Uf), dot(s, f)
    else:
        r = _lever(b, i, s, W)
        Un, Uf = add(symmetric(J, s), rotate(H, r)), add(rotate_back(H, s), symmetric(M, r))
        D, Sp = dot(s, Un) + dot(r, Uf), dot(s, n) + dot(r, f)
    return Un, Uf, D, Sp


@inline
def along(b, i, n, f, W):
    """Return S' [n; f]: what a moment and a force do along the joint."""
    s = _axis(i, W)
    if b.kind == PRISMATIC:
        x = dot(s, f)
    else:
        x = dot(s, n) + dot(_lever(b, i, s, W), f)
    return x


@inline
def accelerate(b, i, dn, df, qdd, W, out, column):
    """Store dA = dA_parent + S qdd in row i of `out`, from a column on; dA_parent = [dn; df]."""
    s = _axis(i, W)
    if b.kind == PRISMATIC:
        store3(out, i, column, dn)
        store3(out, i, column + 3, add(df, scale(s, qdd)))
    else:
        store3(out, i, column, add(dn, scale(s, qdd)))
        store3(out, i, column + 3, add(df, scale(_lever(b, i, s, W), qdd)))


@inline
def unit_momentum(b, i, J, h, m, W):
    """Return I S of a rigid inertia (J, h, m): its momentum at unit joint rate, as moment and force."""
    s = _axis(i, W)
    if b.kind == PRISMATIC:
        return cross(h, s), scale(s, m)
    r = _lever(b, i, s, W)
    return add(symmetric(J, s), cross(h, r)), sub(scale(r, m), cross(h, s))
