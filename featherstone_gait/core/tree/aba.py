"""Articulated-body algorithm, RBDA section 7.3 (Table 7.1), in one common frame and in inverse-dynamics form.

Let a_i be the acceleration that body i has when every joint acceleration is zero (velocity products and gravity
included), and dA_i what the joint accelerations add to it.  Then

    pA_i = I_i a_i + v_i x* I_i v_i - fext_i + sum over children (pA_j + U_j u_j / D_j)
    IA_i = I_i + sum over children (IA_j - U_j U_j' / D_j)
    U_i = IA_i S_i,   D_i = S_i' U_i + armature_i,   u_i = tau_i - S_i' pA_i
    qdd_i = (u_i - U_i' dA_parent) / D_i,   dA_i = dA_parent + S_i qdd_i

which is Table 7.1 with c_i moved from the articulated to the rigid inertia: 24 multiplications instead of 36.  In one
frame a child's inertia is *added* to its parent's, with no transform.  Of the three passes the first, which finds the
poses, velocities and a_i, is `motion_pass` (kinematics.py).
"""

from ..compile.jit import inline, kernel
from ..compile.optional import plus_item
from .forest import is_fixed, rows_of
from .joint import accelerate, project
from .layout import DINV, SF, SH, SJ, SM, TOUCH, UU, R, U
from .rigid_body import inertial_force, mass_center
from .spatial import about_origin, accumulate3, add, choose, dot, load3, load9, rotate, scale, solve6, store3, sub

# ------------------------------------------------------------------------- pass 2, tips to root: IA, pA, U, D and u


@kernel
def articulated_pass(tree, part, base_q, base_tau, tau, armature, wrench, contact, W):
    """Fill U, 1/D and u of every joint of a tree, tips to root, and dA of the root in its U columns.

    `contact` None leaves the bodies' contact rows out of account.
    """
    root, end = rows_of(part, tree)
    for k in range(1, end - root):
        i = end - k
        b = tree[i]
        J, H, M, n, f = _articulated_body(b, i, wrench, contact, W)
        Un, Uf, D, Sp = project(b, i, J, H, M, n, f, W)
        Dinv = 1.0 / plus_item(D, armature, b.dof)
        u = tau[b.dof] - Sp
        store3(W, i, U, Un)
        store3(W, i, U + 3, Uf)
        W[i, DINV] = Dinv
        W[i, UU] = u
        _to_parent(tree[b.parent].slot, b.last, (J, H, M), (n, f), (Un, Uf), Dinv, u, W)
    _root(tree, part, base_q, base_tau, wrench, contact, W)


@inline
def _articulated_body(b, i, wrench, contact, W):
    """Return IA = [[J, H], [H', M]] and pA = [n; f] of body i: its own, its children's and its contacts'."""
    c, Jc = mass_center(b, i, W)
    n, f = inertial_force(b, i, c, Jc, W)
    J, h = about_origin(Jc, b.m, c), scale(c, b.m)
    if wrench is not None:
        n = sub(n, load3(wrench, i, 0))
        f = sub(f, load3(wrench, i, 3))
    return _with_contacts(b, contact, W, *_with_children(b, J, h, n, f, W))


@inline
def _with_children(b, J, h, n, f, W):
    if b.leaf:
        H = (0.0, -h[2], h[1], h[2], 0.0, -h[0], -h[1], h[0], 0.0)
        M = (b.m, 0.0, 0.0, b.m, 0.0, b.m)
        return J, H, M, n, f
    k = b.slot
    cH, cM = load9(W, k, SH), load3(W, k, SM) + load3(W, k, SM + 3)
    J = add(J[:3], load3(W, k, SJ)) + add(J[3:], load3(W, k, SJ + 3))
    H = (cH[0], cH[1] - h[2], cH[2] + h[1], cH[3] + h[2], cH[4], cH[5] - h[0], cH[6] - h[1], cH[7] + h[0], cH[8])
    M = (b.m + cM[0], cM[1], cM[2], b.m + cM[3], cM[4], b.m + cM[5])
    return J, H, M, add(n, load3(W, k, SF)), add(f, load3(W, k, SF + 3))


@inline
def _with_contacts(b, contact, W, J, H, M, n, f):
    """Add the contact row of the body in the lanes where it touches."""
    if contact is None:
        return J, H, M, n, f
    k = b.contact
    if k == 0:
        return J, H, M, n, f
    on = W[k, TOUCH] > 0.0
    J = _added(on, J[:3], W, k, SJ) + _added(on, J[3:], W, k, SJ + 3)
    H = _added(on, H[:3], W, k, SH) + _added(on, H[3:6], W, k, SH + 3) + _added(on, H[6:], W, k, SH + 6)
    M = _added(on, M[:3], W, k, SM) + _added(on, M[3:], W, k, SM + 3)
    n = choose(on, sub(n, load3(W, k, SF)), n)
    f = choose(on, sub(f, load3(W, k, SF + 3)), f)
    return J, H, M, n, f


@inline
def _added(on, a, W, k, column):
    return choose(on, add(a, load3(W, k, column)), a)


@inline
def _to_parent(slot, first, IA, pA, U, Dinv, u, W):
    """Add IA - U U'/D and pA + U u/D to the parent's slot; the first child to come sets it."""
    (J, H, M), (n, f), (Un, Uf) = IA, pA, U
    Vn, Vf = scale(Un, Dinv), scale(Uf, Dinv)
    _accumulate_symmetric(W, slot, SJ, first, J, Vn, Un)
    accumulate3(W, slot, SH, first, sub(H[:3], scale(Uf, Vn[0])))
    accumulate3(W, slot, SH + 3, first, sub(H[3:6], scale(Uf, Vn[1])))
    accumulate3(W, slot, SH + 6, first, sub(H[6:], scale(Uf, Vn[2])))
    _accumulate_symmetric(W, slot, SM, first, M, Vf, Uf)
    accumulate3(W, slot, SF, first, add(n, scale(Vn, u)))
    accumulate3(W, slot, SF + 3, first, add(f, scale(Vf, u)))


@inline
def _accumulate_symmetric(W, slot, k, first, J, V, U):
    accumulate3(W, slot, k, first, sub(J[:3], scale(U, V[0])))
    accumulate3(W, slot, k + 3, first, (J[3] - V[1] * U[1], J[4] - V[1] * U[2], J[5] - V[2] * U[2]))


@inline
def _root(tree, part, base_q, base_tau, wrench, contact, W):
    """Set dA of the root: zero for the world, the solution of IA dA = -pA for a floating base."""
    root, _ = rows_of(part, tree)
    if base_q is None:
        store3(W, root, U, (0.0, 0.0, 0.0))
        store3(W, root, U + 3, (0.0, 0.0, 0.0))
    elif is_fixed(part):
        for k in range(6):
            W[root, U + k] = 0.0
    else:
        J, H, M, n, f = _articulated_body(tree[root], root, wrench, contact, W)
        if base_tau is not None:
            n = sub(n, rotate(load9(W, root, R), (base_tau[3], base_tau[4], base_tau[5])))
            f = sub(f, (base_tau[0], base_tau[1], base_tau[2]))
        dA = solve6(J, H, M, n, f)
        for k in range(6):
            W[root, U + k] = -dA[k]


@inline
def root_inertia(tree, part, contact, W):
    """Return the articulated inertia (J, H, M) of a floating base, which the first pass has left."""
    root, _ = rows_of(part, tree)
    J, H, M, _, _ = _articulated_body(tree[root], root, None, contact, W)
    return J, H, M


# ------------------------------------------------------------------------- pass 3, root to tips: qdd and dA


@kernel
def acceleration_pass(tree, part, W, qdd):
    """Fill qdd of a tree's joints, root to tips; dA replaces U."""
    root, end = rows_of(part, tree)
    for i in range(root + 1, end):
        b = tree[i]
        dn, df = load3(W, b.parent, U), load3(W, b.parent, U + 3)
        a = (W[i, UU] - (dot(load3(W, i, U), dn) + dot(load3(W, i, U + 3), df))) * W[i, DINV]
        qdd[b.dof] = a
        accelerate(b, i, dn, df, a, W, W, U)
