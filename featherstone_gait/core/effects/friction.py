"""Friction of a joint: a torque that depends on its speed and never rises with it."""

import numpy as np

from ..compile.jit import inline
from ..compile.lanes import clamp, select, sign_beyond
from .energies import ENERGIES
from .energies import FRICTION as LOSS

FRICTION = np.dtype(
    [
        ("viscous_friction", np.float64),  # [N m s/rad]
        ("coulomb_friction", np.float64),  # [N m]
    ],
    align=True,
)

# Coulomb friction grows linearly up to this speed: a loaded joint that should stick creeps at a fraction of it.
STICK_SPEED = 1e-3  # [rad/s or m/s]
DRY = "Coulomb friction"


@inline
def friction_torque(friction, i, speed):
    """Torque on the joint [N m] and its slope -dT/d speed; its power is T times the speed."""
    if friction is None:
        return 0.0, 0.0
    f = friction[i]
    x = clamp(speed * (1.0 / STICK_SPEED), -1.0 + 0.0 * speed, 1.0 + 0.0 * speed)
    sticks = abs(x) < 1.0
    slope = f.viscous_friction + select(sticks, f.coulomb_friction * (1.0 / STICK_SPEED) + 0.0 * x, 0.0 * x)
    return -(f.viscous_friction * speed + f.coulomb_friction * x), slope


@inline
def friction_branch(friction, i, speed):
    """Which way Coulomb friction acts in full: 1, -1, or 0 where it sticks."""
    if friction is None:
        return 0.0
    return select(friction[i].coulomb_friction > 0.0, sign_beyond(speed, STICK_SPEED), 0.0 * speed)


@inline
def move_friction(friction, s, i, v):
    """Energy that friction takes in the step s at the speed v; its torque [N m]."""
    if friction is None:
        return 0.0
    T, _ = friction_torque(friction, i, v)
    s.y[s.o.energy + ENERGIES * i + LOSS] -= s.h * (T * v)
    return T


@inline
def friction_rates(friction, actuator, s, dy, i, v):
    """Set the power that friction takes in dy, to which an actuator, if there is one, may add; the torque [N m]."""
    if friction is None:
        _no_loss(actuator, s, dy, i, v)
        return 0.0
    T, _ = friction_torque(friction, i, v)
    dy[s.o.energy + ENERGIES * i + LOSS] = -T * v
    return T


@inline
def _no_loss(actuator, s, dy, i, v):
    if actuator is not None:
        dy[s.o.energy + ENERGIES * i + LOSS] = 0.0 * v


def explicit_limits(friction):
    """Dampers [N m s/rad] and springs [N m/rad] of each joint that limit an explicit step, by name.

    Dry friction limits it while a joint sticks.
    """
    return {"viscous friction": friction["viscous_friction"], DRY: friction["coulomb_friction"] / STICK_SPEED}, {}
