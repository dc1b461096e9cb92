"""Continuous servo: a torque Kp e - Kd v that follows its reference at every instant, clamped."""

from typing import NamedTuple

import numpy as np

from ..compile.jit import inline
from ..compile.lanes import clamp, select, sign_beyond
from ..compile.structure import record, structure
from .actuator import actuator_branch, actuator_force, actuator_rates, controller_of, motor_of
from .firmware import short_way

PD = record(
    Kp=float,  # [N m/rad]
    Kd=float,  # [N m s/rad]
    torque_limit=float,  # [N m]
    free_damping=float,  # 1 = the damping stays outside the limit
    fold=float,  # 1 = the spring acts at the end of the step, 0 = at its start
)


@structure
class PDServo(NamedTuple):
    """The servos of a scene."""

    pd: np.ndarray  # (n,) PD
    wrap: np.ndarray | None = None  # (n,) as of `Firmware`

    PARTS = ()

    def explicit_limits(self):
        """Return dampers [N m s/rad], springs [N m/rad] that limit an explicit step, by name, and rotors' mobility."""
        return {"pd damping": self.pd["Kd"]}, {"pd spring": self.pd["Kp"]}, 0.0


@inline
def pd_torque(p, e, v, h_implicit):
    """Return Kp e - Kd v [N m] of the record p, clamped whole or without its damping, and its slope [N m s/rad].

    e: at the start of the step; the spring acts at its end where it must.
    """
    e = e - p.fold * h_implicit * v
    outside = p.free_damping > 0.0
    spring = p.Kp * e
    inner = select(outside, spring, spring - p.Kd * v)
    held = clamp(inner, -p.torque_limit, p.torque_limit)
    free = held == inner
    stiff = select(free, p.Kp * p.fold * h_implicit + 0.0 * v, 0.0 * v)
    slope = stiff + select(free | outside, p.Kd + 0.0 * v, 0.0 * v)
    return select(outside, held - p.Kd * v, held), slope


@inline
def pd_branch(p, e, v, h_implicit):
    """Return the side on which the torque of `pd_torque` is clamped, 0 where it is not."""
    spring = p.Kp * (e - p.fold * h_implicit * v)
    return sign_beyond(select(p.free_damping > 0.0, spring, spring - p.Kd * v), p.torque_limit)


@inline
def _error(actuator, step, i):
    return short_way(actuator.wrap, step.drive[i, 0] - step.y[step.offsets.q + i], i)


@actuator_force.of(PDServo)
def _force(actuator, step, i, v, w, T, c):
    torque, slope = pd_torque(actuator.pd[i], _error(actuator, step, i), v, step.h_implicit)
    return T + torque, 0.0, c + slope, 0.0, 0.0


@actuator_rates.of(PDServo)
def _rates(actuator, step, dy, i, v):
    torque, _ = pd_torque(actuator.pd[i], _error(actuator, step, i), v, 0.0)
    return torque


@actuator_branch.of(PDServo)
def _branch(actuator, step, i, v, w):
    return pd_branch(actuator.pd[i], _error(actuator, step, i), v, step.h_implicit)


motor_of.of(PDServo)(lambda actuator: None)
controller_of.of(PDServo)(lambda actuator: None)
