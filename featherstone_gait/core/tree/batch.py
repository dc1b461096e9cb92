"""The algorithms over many states: one row a state, or eight rows at a time in lanes."""

from ..compile.elementary import exp
from ..compile.jit import entry, inline
from ..compile.optional import if_present, in_lanes, item
from .crba import crba
from .energy import center_of_mass, energy, momentum
from .forward_dynamics import aba
from .kinematics import motion_pass
from .layout import Motion
from .loop import BIAS, GAP, PULL, SPEED, fill_loops, loop_jacobian
from .rnea import rnea


@inline
def _row(motion, i):
    """Return state i of the states `motion`."""
    return Motion(
        item(motion.base_q, i),
        item(motion.base_qd, i),
        item(motion.base_qdd, i),
        motion.q[i],
        motion.qd[i],
        item(motion.qdd, i),
        item(motion.ball_q, i),
    )


def aba_rows(robot, motion, base_tau, tau, wrench, scratch, base_qdd, qdd, forces):
    """Call `aba` for each row of the arrays; scratch: W (1, rows, columns) and rows; forces (n, m) of loops or None."""
    work = scratch[0][0], scratch[1]
    for i in range(len(tau)):
        aba(robot, _row(motion, i), item(base_tau, i), tau[i], item(wrench, i), work, item(base_qdd, i), qdd[i])
        _keep_forces(forces, i, scratch[1])


aba_rows, _aba_all = entry(aba_rows), inline(aba_rows)


@entry
def aba_lanes(robot, motion, base_tau, tau, wrench, scratch, base_qdd, qdd, forces):
    """Do the same with eight states to a row: the arrays have a last axis of lanes."""
    seen, work = (in_lanes(base_tau), in_lanes(tau), in_lanes(wrench)), (in_lanes(scratch[0]), in_lanes(scratch[1]))
    out = in_lanes(base_qdd), in_lanes(qdd), in_lanes(forces)
    _aba_all(robot, in_lanes(motion), seen[0], seen[1], seen[2], work, out[0], out[1], out[2])


@if_present()
def _keep_forces(forces, i, rows):
    for r in range(len(rows.loops)):
        forces[i, r] = rows.loops[r, PULL]


def rnea_rows(robot, motion, wrench, W, base_tau, tau):
    """Call `rnea` for each row of the arrays; W (1, rows, columns)."""
    for i in range(len(tau)):
        rnea(robot, _row(motion, i), item(wrench, i), W[0], item(base_tau, i), tau[i])


rnea_rows, _rnea_all = entry(rnea_rows), inline(rnea_rows)


@entry
def rnea_lanes(robot, motion, wrench, W, base_tau, tau):
    """Do the same with eight states to a row: the arrays have a last axis of lanes."""
    _rnea_all(robot, in_lanes(motion), in_lanes(wrench), in_lanes(W), in_lanes(base_tau), in_lanes(tau))


@entry
def crba_rows(robot, motion, W, H):
    """Fill the mass matrices H (n, nv, nv) of each row of the arrays."""
    for i in range(len(H)):
        crba(robot, _row(motion, i), W[0], H[i])


@entry
def measures_rows(robot, motion, W, energies, centers, momenta):
    """Fill energy (n, 2), center of mass and its velocity (n, 6) and momentum (n, 6) of each state."""
    for i in range(len(energies)):
        at = _row(motion, i)
        motion_pass(robot.tree, None, robot.gravity, at, W[0])
        energy(robot.tree, at.base_q, at.qd, robot.armature, robot.gravity, W[0], energies[i])
        center_of_mass(robot.tree, at.base_q, W[0], centers[i])
        momentum(robot.tree, at.base_q, W[0], momenta[i])


@entry
def poses_rows(robot, motion, W, poses):
    """Fill the poses (n, bodies, 12) of each state: rotation row by row, then the position from the base [m]."""
    for i in range(len(poses)):
        motion_pass(robot.tree, None, robot.gravity, _row(motion, i), W[0])
        for k in range(len(robot.tree)):
            for c in range(12):
                poses[i, k, c] = W[0, k, c]


@entry
def loop_rows(robot, loops, motion, W, rows, measures, base_J, J):
    """Fill gap, speed and bias (n, 3, m) of the rows of loops, and their Jacobians (n, m, 6) and (n, m, joints).

    loops: LOOP and what is `held` of `fill_loops`.
    """
    loop, held = loops
    for i in range(len(measures)):
        at = _row(motion, i)
        motion_pass(robot.tree, None, robot.gravity, at, W[0])
        fill_loops(loop, (0, len(loop)), held, robot.gravity, at.base_q, W[0], rows)
        for r in range(len(rows)):
            measures[i, 0, r] = rows[r, GAP]
            measures[i, 1, r] = rows[r, SPEED]
            measures[i, 2, r] = rows[r, BIAS]
        loop_jacobian(robot.tree, loop, rows, W[0], item(base_J, i), J[i])


@entry
def exponential(x):
    """Return exp(x), the same on every machine."""
    return exp(x)
