"""Composite-rigid-body algorithm, RBDA Table 6.2, in one common frame: the joint-space inertia matrix."""

from ..compile.jit import inline, kernel
from .joint import along, unit_momentum
from .kinematics import motion_pass
from .layout import SH, SJ, SM, R
from .rigid_body import mass_center
from .spatial import about_origin, accumulate3, add, cross, load3, load9, rotate_back, scale, symmetric


@kernel
def crba(robot, motion, W, H):
    """Fill H (nv, nv) [kg m^2, kg m, kg]: of a floating base the first six rows are its force and moment.

    robot a `Robot`, motion a `Motion`, on whose velocities the poses do not depend.
    """
    motion_pass(robot.tree, None, robot.gravity, motion, W)
    _columns(robot.tree, motion.base_q, robot.armature, W, H)


@inline
def _columns(tree, base_q, armature, W, H):
    first = 0
    if base_q is not None:
        first = 6
    for k in range(1, len(tree)):
        i = len(tree) - k
        b = tree[i]
        J, h, m = _composite(b, i, W)
        n, f = unit_momentum(b, i, J, h, m, W)
        _column(tree, i, n, f, first, H, W)
        if armature is not None:
            H[first + b.dof, first + b.dof] += armature[b.dof]
        _to_parent(tree[b.parent].slot, b.last, J, h, m, W)
        if base_q is not None:  # the coupling of the joint with the base: force in world axes, moment in body axes
            n = rotate_back(load9(W, 0, R), n)
            for j in range(3):
                H[j, first + b.dof] = H[first + b.dof, j] = f[j]
                H[3 + j, first + b.dof] = H[first + b.dof, 3 + j] = n[j]
    if base_q is not None:
        _base_block(_composite(tree[0], 0, W), W, H)


@inline
def _composite(b, i, W):
    """Return the inertia (J, h, m) of body i and all that it carries."""
    c, Jc = mass_center(b, i, W)
    J, h = about_origin(Jc, b.m, c), scale(c, b.m)
    if b.leaf:
        return J, h, b.m
    J = add(J[:3], load3(W, b.slot, SJ)) + add(J[3:], load3(W, b.slot, SJ + 3))
    return J, add(h, load3(W, b.slot, SH)), b.m + W[b.slot, SM]


@inline
def _column(tree, i, n, f, first, H, W):
    """Fill H[i, j] = S_j' Ic S_i for i and each joint j on its way to the root."""
    column = first + tree[i].dof
    j = i
    while j > 0:
        b = tree[j]
        x = along(b, j, n, f, W)
        H[first + b.dof, column] = H[column, first + b.dof] = x
        j = b.parent


@inline
def _to_parent(slot, first, J, h, m, W):
    accumulate3(W, slot, SJ, first, J[:3])
    accumulate3(W, slot, SJ + 3, first, J[3:])
    accumulate3(W, slot, SH, first, h)
    if first:
        W[slot, SM] = m
    else:
        W[slot, SM] += m


@inline
def _base_block(inertia, W, H):
    """Fill the base's own 6 x 6 block."""
    J, h, m = inertia
    E = load9(W, 0, R)
    for k in range(3):
        for j in range(3):
            H[k, j] = m if j == k else 0.0
        s = (E[k], E[3 + k], E[6 + k])
        n = rotate_back(E, symmetric(J, s))
        f = cross(s, h)
        for j in range(k + 1):  # symmetric to the last bit
            H[3 + j, 3 + k] = H[3 + k, 3 + j] = n[j]
        for j in range(3):
            H[j, 3 + k] = H[3 + k, j] = f[j]
