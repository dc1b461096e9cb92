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
        """Dampers [N m s/rad] and springs [N m/rad] that limit an explicit step, by name; mobility that rotors add.

        The gear's spring and damper act between link and rotor: with either of them they can move.
        """
        geared = self.gear["stiffness"] > 0
        return *gearbox.explicit_limits(self.gear), np.where(geared, 1.0 / self.gear["inertia"], 0.0)


@actuator_force.of(MipsdServo)
def _force(actuator, s, i, v, w, T, c):
    g, y, o = actuator.gear[i], s.y, s.o
    torque, slope = motor_torque(actuator.motor, s, i, w)
    e = y[o.rotor + i] - y[o.q + i] + s.sub * (w - v)
    Tg, cg, _ = gear_torque(g, e, w - v, s.sub)
    F = torque - g.rotor_damping * w - Tg
    return T + Tg, F, c, cg, slope + g.rotor_damping


@actuator_rates.of(MipsdServo)
def _rates(actuator, s, dy, i, v):
    g, y, o, E = actuator.gear[i], s.y, s.o, s.o.energy + ENERGIES * i
    dy[o.filtered_speed + i] = filter_rate(actuator.controller, s, i, v)
    w = y[o.rotor_speed + i]
    T, _, loss = gear_torque(g, y[o.rotor + i] - y[o.q + i], w - v, 0.0)
    F = motor_rates(actuator.motor, s, dy, i, w) - g.rotor_damping * w - T
    dy[o.rotor + i] = w
    dy[o.rotor_speed + i] = F / g.inertia
    dy[E + GEAR] = loss
    dy[E + FRICTION] += g.rotor_damping * (w * w)
    return T


@move_actuator.of(MipsdServo)
def _move(actuator, s, i, v, w):
    g, y, o, E = actuator.gear[i], s.y, s.o, s.o.energy + ENERGIES * i
    e = y[o.rotor + i] - y[o.q + i] + s.sub * (w - v)
    _, _, loss = gear_torque(g, e, w - v, s.sub)
    y[E + GEAR] += s.h * loss
    y[E + FRICTION] += s.h * (g.rotor_damping * (w * w))
    move_motor(actuator.motor, s, i, w)
    y[o.rotor + i] += s.h * w
    y[o.rotor_speed + i] += (w - y[o.rotor_speed + i]) * (1.0 / s.theta)


@actuator_branch.of(MipsdServo)
def _branch(actuator, s, i, v, w):
    g, y, o = actuator.gear[i], s.y, s.o
    e = y[o.rotor + i] - y[o.q + i] + s.sub * (w - v)
    return motor_branch(actuator.motor, s, i, w) + 5.0 * gear_branch(g, e, w - v)


@rotor_of.of(MipsdServo)
def _rotor(actuator):
    return actuator.gear
