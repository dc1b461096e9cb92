"""The explicit update order of SimTwo (P33a/SimTwo, 2012), for comparison.

Each step: the speed is filtered, the current moves on with the speed of the step's start, the torque is a constant of
the step.  The spring-damper gearbox follows commit f9dc76a: rotor by semi-implicit Euler, the damping torque on the
rotor limited to 0.2 J / h, G times that at the joint.  Only stops and contacts stay implicit, as they were constraints
of that engine.
"""

from typing import Any, NamedTuple

import numpy as np

from ..core.compile.by_type import by_type
from ..core.compile.jit import add_sources, inline
from ..core.compile.lanes import clamp
from ..core.compile.structure import structure
from ..core.effects.actuator import motor_of
from ..core.effects.decay import FILTER_DECAY
from ..core.effects.energies import ENERGIES, FRICTION, GEAR, WORK
from ..core.effects.gearbox import wind_up
from ..core.effects.mipsd_servo import MipsdServo
from ..core.effects.motor import add_electrical, current_step
from ..core.effects.rigid_servo import RigidServo
from ..core.effects.supply import move_source
from ..core.integrate import INTEGRATORS
from ..core.integrate.integrator import NEWTON_TOLERANCE, Integrator, Sizes, scratch, take_step
from ..core.step.advance import advance
from ..core.step.context import Scratch, Step
from ..core.step.newton import solve_step

add_sources(__name__, __file__)


@structure
class SimTwo(NamedTuple):
    """Workspace."""

    scratch: Scratch
    torques: np.ndarray  # (n,) of the servos, constant over a step [N m]


@take_step.of(SimTwo)
def simtwo_step(work: Any, run: Any, y: np.ndarray, t: float, theta: float) -> None:
    """One step; theta plays no part."""
    scene, h, torques = run.scene, run.plan.h, work.torques
    o, x = run.places[0], work.scratch
    servo = Step(
        scene=scene, actuator=scene.actuator, decay=scene.decay, o=o, y=y, tau=None, drive=None, predicted=None,
        t=t, span=h, h=h, sub=h, theta=1.0, ahead=None, tolerance=NEWTON_TOLERANCE, W=x.W, Z=x.Z, C=x.C, F=x.F,
    )  # fmt: skip
    for i in range(len(torques)):
        torques[i] = _servo_torque(scene.actuator, servo, i)
    bare = Step(
        scene=scene, actuator=None, decay=None, o=o, y=y, tau=torques, drive=None, predicted=None,
        t=t, span=h, h=h, sub=h, theta=1.0, ahead=None, tolerance=NEWTON_TOLERANCE, W=x.W, Z=x.Z, C=x.C, F=x.F,
    )  # fmt: skip
    solve_step(bare)
    advance(bare)


@inline
def _servo_torque(actuator: Any, s: Any, i: int) -> Any:
    """Torque on the joint of the whole step; the motor moves on."""
    y, o, E = s.y, s.o, s.o.energy + ENERGIES * i
    v = y[o.qd + i]
    f = v + s.decay[i, FILTER_DECAY] * (y[o.filtered_speed + i] - v)
    y[o.filtered_speed + i] = f
    viscous = motor_of(actuator)[i].viscous_friction * f
    y[E + FRICTION] += s.h * (viscous * v)
    y[E + WORK] += s.h * (viscous * v)
    return _geared(actuator, s, i, v, f, viscous)


@by_type
def _geared(actuator: Any, s: Any, i: int, v: Any, f: Any, viscous: Any) -> Any:
    """What gets through the gearbox, less the viscous friction."""


@_geared.of(RigidServo)
def _rigid(actuator: Any, s: Any, i: int, v: Any, f: Any, viscous: Any) -> Any:
    return actuator.motor[i].torque_constant * _current(actuator.motor, s, i, v) - viscous


@_geared.of(MipsdServo)
def _mipsd(actuator: Any, s: Any, i: int, v: Any, f: Any, viscous: Any) -> Any:
    y, o, h, g, E = s.y, s.o, s.h, actuator.gear[i], s.o.energy + ENERGIES * i
    w = y[o.rotor_speed + i]
    I = _current(actuator.motor, s, i, w)
    limit = 0.2 * g.inertia / (g.ratio * h)  # of the torque that the damper transmits
    T = g.stiffness * wind_up(g, y[o.rotor + i] - y[o.q + i])
    B = clamp(g.damping * (w - f), -limit + 0.0 * w, limit + 0.0 * w)
    w = w + h * (actuator.motor[i].torque_constant * I - g.rotor_damping * w - (T + B)) / g.inertia
    y[o.rotor_speed + i] = w
    y[o.rotor + i] += h * w
    y[E + GEAR] += h * (B * (w - v))
    y[E + FRICTION] += h * (g.rotor_damping * (w * w))
    return (T + B) - viscous


@inline
def _current(motor: Any, s: Any, i: int, w: Any) -> Any:
    """Current at the end of the step [A], with the electrical energies as that program counts them."""
    m, y, o, h, E = motor[i], s.y, s.o, s.h, s.o.energy + ENERGIES * i
    V = y[o.voltage + i]
    I, _, _ = current_step(m, s.decay, i, y[o.current + i], V, w, h)
    supply, copper = h * (V * I), h * (m.resistance * (I * I))
    stored = 0.5 * m.inductance * (I * I - y[o.current + i] * y[o.current + i])
    add_electrical(y, E, supply, copper, supply - copper - h * (m.torque_constant * w * I) - stored)
    move_source(s.scene.supply, s, i, I)
    y[o.current + i] = I
    return I


def _workspace(sizes: Sizes, zeros: Any) -> SimTwo:
    return SimTwo(scratch(sizes, zeros), zeros(sizes.n))


INTEGRATORS["simtwo"] = SIMTWO = Integrator("simtwo", 1, _workspace, drives=(RigidServo, MipsdServo))
