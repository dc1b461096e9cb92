"""Joint types: the pose and the motion subspace of a joint, `jcalc` of RBDA section 4.4.  No other kernel knows them.

A joint turns about, or slides along, the z axis of its body's frame.  In the common frame, with s that axis in the
world and p the frame's origin, the subspace is S = [s; p x s] of a revolute and S = [0; s] of a prismatic joint.
"""

from ..compile.elementary import sincos
from ..compile.jit import inline
from .layout import A, P, R, U, V
from .spatial import add, compose, cross, dot, load3, load9, rotate, rotate_back, scale, store3, store9, sub, symmetric


@inline
def _axis(i, W):
    return (W[i, R + 2], W[i, R + 5], W[i, R + 8])


@inline
def joint_pose(b, i, q, W):
    """Fill R = R_parent E Rz(q) and the origin P [m]; a prismatic joint moves along z instead."""
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
def joint_motion(b, i, qd, qdd, W):
    """Fill V = V_parent + S qd and A = A_parent + V_parent x S qd + S qdd; qdd None for zero."""
    s = _axis(i, W)
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
    """Return a + s qdd, a where there is no qdd."""
    if qdd is None:
        return a
    return add(a, scale(s, qdd))


@inline
def project(b, i, J, H, M, n, f, W):
    """Return U = IA S as moment and force, D = S' U and S' pA, of IA = [[J, H], [H', M]] and pA = [n; f]."""
    s = _axis(i, W)
    if b.prismatic:
        Un, Uf = rotate(H, s), symmetric(M, s)
        D, Sp = dot(s, Uf), dot(s, f)
    else:
        r = cross(load3(W, i, P), s)
        Un, Uf = add(symmetric(J, s), rotate(H, r)), add(rotate_back(H, s), symmetric(M, r))
        D, Sp = dot(s, Un) + dot(r, Uf), dot(s, n) + dot(r, f)
    return Un, Uf, D, Sp


@inline
def along(b, i, n, f, W):
    """Return S' [n; f]: what a moment and a force do along the joint."""
    s = _axis(i, W)
    if b.prismatic:
        x = dot(s, f)
    else:
        x = dot(s, n) + dot(cross(load3(W, i, P), s), f)
    return x


@inline
def accelerate(b, i, dn, df, qdd, W):
    """Store dA = dA_parent + S qdd; dA_parent = [dn; df]."""
    s = _axis(i, W)
    if b.prismatic:
        store3(W, i, U, dn)
        store3(W, i, U + 3, add(df, scale(s, qdd)))
    else:
        store3(W, i, U, add(dn, scale(s, qdd)))
        store3(W, i, U + 3, add(df, scale(cross(load3(W, i, P), s), qdd)))


@inline
def unit_momentum(b, i, J, h, m, W):
    """Return I S of a rigid inertia (J, h, m): its momentum at unit joint rate, as moment and force."""
    s = _axis(i, W)
    if b.prismatic:
        return cross(h, s), scale(s, m)
    r = cross(load3(W, i, P), s)
    return add(symmetric(J, s), cross(h, r)), sub(scale(r, m), cross(h, s))
