"""The algorithms over many states: one row a state, or eight rows at a time in lanes."""

from .aba import aba
from .crba import crba
from .elementary import exp
from .energy import center_of_mass, energy, momentum
from .jit import entry
from .kinematics import motion_pass
from .optional import item, lanes
from .rnea import rnea


@entry
def aba_rows(tree, base_q, base_qd, base_tau, q, qd, tau, armature, wrench, gravity, W, base_qdd, qdd):
    for i in range(len(q)):
        bq, bv, bt, ba = item(base_q, i), item(base_qd, i), item(base_tau, i), item(base_qdd, i)
        aba(tree, bq, bv, bt, q[i], qd[i], tau[i], armature, item(wrench, i), gravity, W[0], ba, qdd[i])


@entry
def aba_lanes(tree, base_q, base_qd, base_tau, q, qd, tau, armature, wrench, gravity, W, base_qdd, qdd):
    for i in range(len(q)):
        bq, bv, bt, ba = lanes(base_q, i), lanes(base_qd, i), lanes(base_tau, i), lanes(base_qdd, i)
        x, v, f, a = lanes(q, i), lanes(qd, i), lanes(tau, i), lanes(qdd, i)
        aba(tree, bq, bv, bt, x, v, f, armature, lanes(wrench, i), gravity, lanes(W, 0), ba, a)


@entry
def rnea_rows(tree, base_q, base_qd, base_qdd, q, qd, qdd, armature, wrench, gravity, W, base_tau, tau):
    for i in range(len(q)):
        bq, bv, ba, bt = item(base_q, i), item(base_qd, i), item(base_qdd, i), item(base_tau, i)
        rnea(tree, bq, bv, ba, q[i], qd[i], qdd[i], armature, item(wrench, i), gravity, W[0], bt, tau[i])


@entry
def rnea_lanes(tree, base_q, base_qd, base_qdd, q, qd, qdd, armature, wrench, gravity, W, base_tau, tau):
    for i in range(len(q)):
        bq, bv, ba, bt = lanes(base_q, i), lanes(base_qd, i), lanes(base_qdd, i), lanes(base_tau, i)
        x, v, a, f = lanes(q, i), lanes(qd, i), lanes(qdd, i), lanes(tau, i)
        rnea(tree, bq, bv, ba, x, v, a, armature, lanes(wrench, i), gravity, lanes(W, 0), bt, f)


@entry
def crba_rows(tree, base_q, zero6, q, zero, armature, gravity, W, H):
    for i in range(len(q)):
        crba(tree, item(base_q, i), zero6, q[i], zero, armature, gravity, W[0], H[i])


@entry
def measures_rows(tree, base_q, base_qd, q, qd, armature, gravity, W, energies, centers, momenta):
    """Energy (n, 2), centre of mass and its velocity (n, 6) and momentum (n, 6) of each state."""
    for i in range(len(q)):
        bq = item(base_q, i)
        motion_pass(tree, bq, item(base_qd, i), None, q[i], qd[i], None, gravity, W[0])
        energy(tree, bq, qd[i], armature, gravity, W[0], energies[i])
        center_of_mass(tree, bq, W[0], centers[i])
        momentum(tree, bq, W[0], momenta[i])


@entry
def poses_rows(tree, base_q, zero6, q, zero, gravity, W, poses):
    """Poses (n, bodies, 12) of each state: rotation row by row, then the position from the base [m]."""
    for i in range(len(q)):
        motion_pass(tree, item(base_q, i), zero6, None, q[i], zero, None, gravity, W[0])
        for k in range(len(tree)):
            for c in range(12):
                poses[i, k, c] = W[0, k, c]


@entry
def exponential(x):
    """exp(x), the same on every machine."""
    return exp(x)
