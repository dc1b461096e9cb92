"""Articulated-body algorithm, RBDA section 7.3 (Table 7.1), in one common frame and in inverse-dynamics form.

Let a_i be the acceleration that body i has when every joint acceleration is zero (velocity products and gravity
included), and dA_i what the joint accelerations add to it.  Then

    pA_i = I_i a_i + v_i x* I_i v_i - fext_i + sum over children (pA_j + U_j u_j / D_j)
    IA_i = I_i + sum over children (IA_j - U_j U_j' / D_j)
    U_i = IA_i S_i,   D_i = S_i' U_i + armature_i,   u_i = tau_i - S_i' pA_i
    qdd_i = (u_i - U_i' dA_parent) / D_i,   dA_i = dA_parent + S_i qdd_i

which is Table 7.1 with c_i moved from the articulated to the rigid inertia: 24 multiplications instead of 36.  In one
frame a child's inertia is *added* to its parent's, with no transform.
"""

from ..compile.jit import inline, kernel
from ..compile.lanes import select
from .coupling import couple
from .joint import accelerate, project
from .kinematics import base_acceleration, motion_pass
from .layout import DINV, SF, SH, SJ, SM, TOUCH, UU, R, U
from .rigid_body import inertial_force, mass_center
from .spatial import about_origin, add, dot, load3, load6, load9, rotate, scale, solve6, store3, sub


@kernel
def aba(robot, motion, base_tau, tau, wrench, W, base_qdd, qdd):
    """Forward dynamics: fill qdd (n,) [rad/s^2 or m/s^2] and, of a floating base, base_qdd (6,).

    robot a `Robot`; motion a `Motion` without accelerations; base_tau (6,) [N; N m] or None; tau (n,) [N m or N];
    wrench (n+1, 6) external [moment; force] about the common origin, world axes [N m; N] or None; W workspace.
    """
    motion_pass(robot.tree, robot.gravity, motion, W)
    articulated_pass(robot.tree, motion.base_q, base_tau, tau, robot.armature, wrench, None, W)
    constrain(robot.coupling, motion.base_q, None, robot.tree, W)
    acceleration_pass(robot.tree, W, qdd)
    _base(motion.base_q, base_qdd, W)


@inline
def _base(base_q, base_qdd, W):
    if base_q is not None:
        base_acceleration(base_qdd, W)


@kernel
def articulated_pass(tree, base_q, base_tau, tau, armature, wrench, contact, W):
    """Fill U, 1/D and u of every joint, tips to root, and dA of the root in its U columns.

    `contact` None leaves the bodies' contact rows out of account.
    """
    for k in range(1, len(tree)):
        i = len(tree) - k
        b = tree[i]
        J, H, M, n, f = _articulated_body(b, i, wrench, contact, W)
        Un, Uf, D, Sp = project(b, i, J, H, M, n, f, W)
        D = _enlarged(D, armature, b.dof)
        Dinv = 1.0 / D
        u = tau[b.dof] - Sp
        store3(W, i, U, Un)
        store3(W, i, U + 3, Uf)
        W[i, DINV] = Dinv
        W[i, UU] = u
        _to_parent(tree[b.parent].slot, b.last, (J, H, M), (n, f), (Un, Uf), Dinv, u, W)
    _root(tree, base_q, base_tau, wrench, contact, W)


@inline
def _enlarged(D, armature, i):
    if armature is None:
        return D
    return D + armature[i]


@inline
def _articulated_body(b, i, wrench, contact, W):
    """IA = [[J, H], [H', M]] and pA = [n; f] of body i: its own, its children's and its contacts'."""
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
    cJ, cM = load6(W, k, SJ), load6(W, k, SM)
    cH = load9(W, k, SH)
    J = (J[0] + cJ[0], J[1] + cJ[1], J[2] + cJ[2], J[3] + cJ[3], J[4] + cJ[4], J[5] + cJ[5])
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
    a, c, d = load6(W, k, SJ), load9(W, k, SH), load6(W, k, SM)
    J = (
        select(on, J[0] + a[0], J[0]),
        select(on, J[1] + a[1], J[1]),
        select(on, J[2] + a[2], J[2]),
        select(on, J[3] + a[3], J[3]),
        select(on, J[4] + a[4], J[4]),
        select(on, J[5] + a[5], J[5]),
    )
    H = (
        select(on, H[0] + c[0], H[0]),
        select(on, H[1] + c[1], H[1]),
        select(on, H[2] + c[2], H[2]),
        select(on, H[3] + c[3], H[3]),
        select(on, H[4] + c[4], H[4]),
        select(on, H[5] + c[5], H[5]),
        select(on, H[6] + c[6], H[6]),
        select(on, H[7] + c[7], H[7]),
        select(on, H[8] + c[8], H[8]),
    )
    M = (
        select(on, M[0] + d[0], M[0]),
        select(on, M[1] + d[1], M[1]),
        select(on, M[2] + d[2], M[2]),
        select(on, M[3] + d[3], M[3]),
        select(on, M[4] + d[4], M[4]),
        select(on, M[5] + d[5], M[5]),
    )
    n = _choose(on, sub(n, load3(W, k, SF)), n)
    f = _choose(on, sub(f, load3(W, k, SF + 3)), f)
    return J, H, M, n, f


@inline
def _choose(mask, a, b):
    return (select(mask, a[0], b[0]), select(mask, a[1], b[1]), select(mask, a[2], b[2]))


@inline
def _to_parent(slot, first, IA, pA, U, Dinv, u, W):
    """Add IA - U U'/D and pA + U u/D to the parent's slot; the first child to come sets it."""
    (J, H, M), (n, f), (Un, Uf) = IA, pA, U
    Vn, Vf = scale(Un, Dinv), scale(Uf, Dinv)
    _accumulate(W, slot, SJ + 0, first, J[0] - Vn[0] * Un[0])
    _accumulate(W, slot, SJ + 1, first, J[1] - Vn[0] * Un[1])
    _accumulate(W, slot, SJ + 2, first, J[2] - Vn[0] * Un[2])
    _accumulate(W, slot, SJ + 3, first, J[3] - Vn[1] * Un[1])
    _accumulate(W, slot, SJ + 4, first, J[4] - Vn[1] * Un[2])
    _accumulate(W, slot, SJ + 5, first, J[5] - Vn[2] * Un[2])
    _accumulate(W, slot, SH + 0, first, H[0] - Vn[0] * Uf[0])
    _accumulate(W, slot, SH + 1, first, H[1] - Vn[0] * Uf[1])
    _accumulate(W, slot, SH + 2, first, H[2] - Vn[0] * Uf[2])
    _accumulate(W, slot, SH + 3, first, H[3] - Vn[1] * Uf[0])
    _accumulate(W, slot, SH + 4, first, H[4] - Vn[1] * Uf[1])
    _accumulate(W, slot, SH + 5, first, H[5] - Vn[1] * Uf[2])
    _accumulate(W, slot, SH + 6, first, H[6] - Vn[2] * Uf[0])
    _accumulate(W, slot, SH + 7, first, H[7] - Vn[2] * Uf[1])
    _accumulate(W, slot, SH + 8, first, H[8] - Vn[2] * Uf[2])
    _accumulate(W, slot, SM + 0, first, M[0] - Vf[0] * Uf[0])
    _accumulate(W, slot, SM + 1, first, M[1] - Vf[0] * Uf[1])
    _accumulate(W, slot, SM + 2, first, M[2] - Vf[0] * Uf[2])
    _accumulate(W, slot, SM + 3, first, M[3] - Vf[1] * Uf[1])
    _accumulate(W, slot, SM + 4, first, M[4] - Vf[1] * Uf[2])
    _accumulate(W, slot, SM + 5, first, M[5] - Vf[2] * Uf[2])
    _accumulate(W, slot, SF + 0, first, n[0] + Vn[0] * u)
    _accumulate(W, slot, SF + 1, first, n[1] + Vn[1] * u)
    _accumulate(W, slot, SF + 2, first, n[2] + Vn[2] * u)
    _accumulate(W, slot, SF + 3, first, f[0] + Vf[0] * u)
    _accumulate(W, slot, SF + 4, first, f[1] + Vf[1] * u)
    _accumulate(W, slot, SF + 5, first, f[2] + Vf[2] * u)


@inline
def _accumulate(W, slot, k, first, x):
    if first:
        W[slot, k] = x
    else:
        W[slot, k] += x


@inline
def _root(tree, base_q, base_tau, wrench, contact, W):
    """dA of the root: zero for the world, the solution of IA dA = -pA for a floating base."""
    if base_q is None:
        store3(W, 0, U, (0.0, 0.0, 0.0))
        store3(W, 0, U + 3, (0.0, 0.0, 0.0))
    else:
        J, H, M, n, f = _articulated_body(tree[0], 0, wrench, contact, W)
        if base_tau is not None:
            n = sub(n, rotate(load9(W, 0, R), (base_tau[3], base_tau[4], base_tau[5])))
            f = sub(f, (base_tau[0], base_tau[1], base_tau[2]))
        dA = solve6(J, H, M, n, f)
        for k in range(6):
            W[0, U + k] = -dA[k]


@inline
def constrain(coupling, base_q, contact, tree, W):
    """To be called between the two passes: make followers go with their leaders, as coupling.py does.

    `coupling` None: there are none; base_q and contact as the first pass had them.
    """
    if coupling is not None:
        _constrain(base_q, coupling, contact, tree, W)


@inline
def _constrain(base_q, coupling, contact, tree, W):
    if base_q is None:
        couple(None, coupling, tree, W)
    else:
        J, H, M, _, _ = _articulated_body(tree[0], 0, None, contact, W)
        couple((J, H, M), coupling, tree, W)


@kernel
def acceleration_pass(tree, W, qdd):
    """Fill qdd, root to tips; dA replaces U."""
    for i in range(1, len(tree)):
        b = tree[i]
        dn, df = load3(W, b.parent, U), load3(W, b.parent, U + 3)
        a = (W[i, UU] - (dot(load3(W, i, U), dn) + dot(load3(W, i, U + 3), df))) * W[i, DINV]
        qdd[b.dof] = a
        accelerate(b, i, dn, df, a, W)
