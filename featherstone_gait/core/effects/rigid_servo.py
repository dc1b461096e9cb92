"""Servo with a rigid gearbox: sampled controller and DC motor; a rotor's inertia is added to the joint's (armature)."""

from typing import NamedTuple

import numpy as np

from ..compile.structure import structure
from . import motor as dc_motor
from .actuator import actuator_branch, actuator_force, actuator_rates, move_actuator
from .controller import filter_rate
from .motor import motor_branch, motor_rates, motor_torque, move_motor


@structure
class RigidServo(NamedTuple):
    """The servos of a scene."""

    motor: np.ndarray  # (n,) MOTOR
    controller: np.ndarray  # (n,) CONTROLLER

    PARTS = ("servo",)

    def explicit_limits(self):
        """Return dampers [N m s/rad], springs [N m/rad] that limit an explicit step, by name, and rotors' mobility."""
        return *dc_motor.explicit_limits(self.motor), 0.0


@actuator_force.of(RigidServo)
def _force(actuator, step, i, v, w, T, c):
    torque, slope = motor_torque(step.decay, actuator.motor, step, i, v)
    return T + torque, 0.0, c + slope, 0.0, 0.0


@actuator_rates.of(RigidServo)
def _rates(actuator, step, dy, i, v):
    dy[step.offsets.filtered_speed + i] = filter_rate(actuator.controller, step, i, v)
    return motor_rates(actuator.motor, step, dy, i, v)


move_actuator.of(RigidServo)(lambda actuator, step, i, v, w: move_motor(step.decay, actuator.motor, step, i, v))
actuator_branch.of(RigidServo)(lambda actuator, step, i, v, w: motor_branch(step.decay, actuator.motor, step, i, v))
