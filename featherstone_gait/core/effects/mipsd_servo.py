"""Servo with a spring-damper gearbox (MIPSD): sampled controller, DC motor, rotor and gear."""

from typing import NamedTuple

import numpy as np

from ..compile.structure import structure
from . import gearbox
from .actuator import actuator_branch, actuator_force, actuator_rates, move_actuator, rotor_of
from .controller import filter_rate
from .energies import ENERGIES, FRICTION, GEAR
from .gearbox import gear_branch, gear_torque
from .motor import motor_branch, motor_rates, motor_torque, move_motor


@structure
class MipsdServo(NamedTuple):
    """The servos of a scene."""

    motor: np.ndarray  # (n,) MOTOR
    controller: np.ndarray  # (n,) CONTROLLER
    gear: np.ndarray  # (n,) GEAR

    PARTS = ("servo", "rotor")

    def explicit_limits(self):
        """Return dampers [N m s/rad], springs [N m/rad] that limit an explicit step, by name, and rotors' mobility.

        The gear's spring and damper act between link and rotor: with either of them they can move.
        """
        geared = self.gear["stiffness"] > 0
        return *gearbox.explicit_limits(self.gear), np.where(geared, 1.0 / self.gear["inertia"], 0.0)


@actuator_force.of(MipsdServo)
def _force(actuator, step, i, v, w, T, c):
    g, y, offsets = actuator.gear[i], step.y, step.offsets
    torque, slope = motor_torque(step.decay, actuator.motor, step, i, w)
    e = y[offsets.rotor + i] - y[offsets.q + i] + step.h_implicit * (w - v)
    Tg, cg, _ = gear_torque(g, e, w - v, step.h_implicit)
    F = torque - g.rotor_damping * w - Tg
    return T + Tg, F, c, cg, slope + g.rotor_damping


@actuator_rates.of(MipsdServo)
def _rates(actuator, step, dy, i, v):
    g, y, offsets, E = actuator.gear[i], step.y, step.offsets, step.offsets.energy + ENERGIES * i
    dy[offsets.filtered_speed + i] = filter_rate(actuator.controller, step, i, v)
    w = y[offsets.rotor_speed + i]
    T, _, loss = gear_torque(g, y[offsets.rotor + i] - y[offsets.q + i], w - v, 0.0)
    F = motor_rates(actuator.motor, step, dy, i, w) - g.rotor_damping * w - T
    dy[offsets.rotor + i] = w
    dy[offsets.rotor_speed + i] = F / g.inertia
    dy[E + GEAR] = loss
    dy[E + FRICTION] += g.rotor_damping * (w * w)
    return T


@move_actuator.of(MipsdServo)
def _move(actuator, step, i, v, w):
    g, y, offsets, E = actuator.gear[i], step.y, step.offsets, step.offsets.energy + ENERGIES * i
    e = y[offsets.rotor + i] - y[offsets.q + i] + step.h_implicit * (w - v)
    _, _, loss = gear_torque(g, e, w - v, step.h_implicit)
    y[E + GEAR] += step.h * loss
    y[E + FRICTION] += step.h * (g.rotor_damping * (w * w))
    move_motor(step.decay, actuator.motor, step, i, w)
    y[offsets.rotor + i] += step.h * w
    y[offsets.rotor_speed + i] += (w - y[offsets.rotor_speed + i]) * (1.0 / step.theta)


@actuator_branch.of(MipsdServo)
def _branch(actuator, step, i, v, w):
    g, y, offsets = actuator.gear[i], step.y, step.offsets
    e = y[offsets.rotor + i] - y[offsets.q + i] + step.h_implicit * (w - v)
    return motor_branch(step.decay, actuator.motor, step, i, w) + 5.0 * gear_branch(g, e, w - v)


rotor_of.of(MipsdServo)(lambda actuator: actuator.gear)
