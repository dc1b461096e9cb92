"""Recursive Newton-Euler algorithm, RBDA Table 5.1, in one common frame: the forces that a motion takes."""

from ..compile.jit import inline, kernel
from .joint import along
from .kinematics import motion_pass
from .layout import SF, R
from .rigid_body import inertial_force, mass_center
from .spatial import accumulate3, add, load3, load9, rotate_back, sub


@kernel
def rnea(robot, motion, wrench, W, base_tau, tau):
    """Compute inverse dynamics: fill tau (n,) [N m or N] and, of a floating base, base_tau (6,) [N; N m].

    The arguments are those of `aba`, with the accelerations given and the forces asked for.  base_tau is the force on
    the base in world axes and the moment about its origin in body axes, the dual of base_qd.
    """
    tree = robot.tree
    motion_pass(tree, None, robot.gravity, motion, W)
    for k in range(1, len(tree)):
        i = len(tree) - k
        b = tree[i]
        n, f = _force(b, i, wrench, W)
        tau[b.dof] = _with_rotor(along(b, i, n, f, W), robot.armature, motion.qdd, b.dof)
        accumulate3(W, tree[b.parent].slot, SF, b.last, n)
        accumulate3(W, tree[b.parent].slot, SF + 3, b.last, f)
    _base(motion.base_q, tree[0], wrench, W, base_tau)


@inline
def _base(base_q, b, wrench, W, base_tau):
    if base_q is not None:
        n, f = _force(b, 0, wrench, W)
        n = rotate_back(load9(W, 0, R), n)
        for k in range(3):
            base_tau[k] = f[k]
            base_tau[3 + k] = n[k]


@inline
def _with_rotor(tau, armature, qdd, i):
    if armature is None:
        return tau
    return tau + armature[i] * qdd[i]


@inline
def _force(b, i, wrench, W):
    """Return the force [n; f] across the joint of body i: its own and what its children left in its slot."""
    c, Jc = mass_center(b, i, W)
    n, f = inertial_force(b, i, c, Jc, W)
    if wrench is not None:
        n = sub(n, load3(wrench, i, 0))
        f = sub(f, load3(wrench, i, 3))
    if b.leaf:
        return n, f
    return add(n, load3(W, b.slot, SF)), add(f, load3(W, b.slot, SF + 3))
