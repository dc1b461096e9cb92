"""Propellers: a joint that turns at w pushes what it carries by k w |w| + l w along its axis, and is held by q w |w|.

The moment of the medium acts on the propeller alone, -q w |w|: as a torque of the joint, with its slope, and as a
moment of the same size on the link that carries the joint, which takes the joint's reaction back.  That moment and the
thrust have no slope by a velocity of the same sign as their own; they are taken at the predicted speed.
"""

from typing import NamedTuple

import numpy as np

from ..compile.jit import inline, kernel
from ..compile.structure import record, structure
from ..tree.forest import base_index
from ..tree.layout import P, R, U, V
from ..tree.rigid_body import center_velocity
from ..tree.spatial import add, cross, dot, load3, scale

PROPELLER = record(
    body=int,  # row of the body that turns about its z axis
    parent=int,  # row of the one that carries it
    tree=int,  # number of its tree
    dof=int,  # index of the joint's coordinate
    thrust=float,  # k [N s^2/rad^2]
    torque=float,  # q [N m s^2/rad^2]
    linear_thrust=float,  # l [N s/rad]
)


@structure
class Propellers(NamedTuple):
    """The propellers of a scene."""

    table: np.ndarray  # (propellers,) PROPELLER
    torque: np.ndarray  # (n,) q of each joint, 0 of those without a propeller


@inline
def plus_propeller(propellers, i, v, T, c):
    """Return T plus the torque of the medium on the joint i at the speed v [N m], and c plus its slope -dT/dv."""
    if propellers is None:
        return T, c
    k = propellers.torque[i] * abs(v)
    return T - k * v, c + 2.0 * k


@inline
def _axis(p, W):
    return (W[p.body, R + 2], W[p.body, R + 5], W[p.body, R + 8])


@kernel
def add_propellers(propellers, v, W, F):
    """Add thrusts, and what the carriers take back, to F (n + 1, 6) at the joint speeds v."""
    for k in range(len(propellers.table)):
        p = propellers.table[k]
        n, square = _axis(p, W), v[p.dof] * abs(v[p.dof])
        f, m = scale(n, p.thrust * square + p.linear_thrust * v[p.dof]), scale(n, -p.torque * square)
        c = cross(load3(W, p.body, P), f)
        for j in range(3):
            F[p.body, j] += c[j]
            F[p.body, 3 + j] += f[j]
            F[p.parent, j] += m[j]


@kernel
def add_work(propellers, speeds, ends, h, lookahead, step, work, at):
    """Add h times the power of the medium on propellers to a number of `work`.

    speeds, ends: of joints, at which the thrust is taken and at the end of the step; lookahead: how far dA is followed.
    """
    W = step.W
    for k in range(len(propellers.table)):
        p = propellers.table[k]
        if p.tree == base_index(step.part):
            n, w, v, x = _axis(p, W), speeds[p.dof], ends[p.dof], load3(W, p.body, P)
            u = add(
                center_velocity(p.body, x, W),
                scale(add(load3(W, p.body, U + 3), cross(load3(W, p.body, U), x)), lookahead),
            )
            turn = add(load3(W, p.parent, V), scale(load3(W, p.parent, U), lookahead))
            thrust = p.thrust * (w * abs(w)) + p.linear_thrust * w
            power = thrust * dot(n, u) - p.torque * (w * abs(w) * dot(n, turn) + v * abs(v) * v)
            work[at] += h * power
