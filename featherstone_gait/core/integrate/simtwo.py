"""The explicit update order of SimTwo (P33a/SimTwo, 2012), for comparison.

Each step: the speed is filtered, the current moves on with the speed of the step's start, the torque is a constant of
the step.  The spring-damper gearbox follows commit f9dc76a: rotor by semi-implicit Euler, the damping torque on the
rotor limited to 0.2 J / h, G times that at the joint.  Only stops and contacts stay implicit, as they were constraints
of that engine.
"""

from typing import Any, NamedTuple

import numpy as np

from ..compile.by_type import by_type
from ..compile.jit import inline
from ..compile.lanes import clamp
from ..compile.structure import structure
from ..effects.actuator import motor_of
from ..effects.decay import FILTER_DECAY
from ..effects.energies import ENERGIES, FRICTION, GEAR, WORK
from ..effects.gearbox import wind_up
from ..effects.mipsd_servo import MipsdServo
from ..effects.motor import add_electrical, current_step
from ..effects.rigid_servo import RigidServo
from ..effects.supply import move_source
from ..step.advance import step_trees
from ..step.context import NEWTON_TOLERANCE, Scratch, Step
from .integrator import Integrator, Sizes, scratch, take_step


@structure
class SimTwo(NamedTuple):
    """Workspace."""

    scratch: Scratch
    torques: np.ndarray  # (n,) of the servos, constant over a step [N m]


@take_step.of(SimTwo)
def simtwo_step(work: Any, run: Any, y: np.ndarray, t: float, theta: float) -> None:
    """Make one step; theta is ignored."""
    scene, h, torques = run.scene, run.plan.h, work.torques
    offsets, scratch = run.offsets[0], work.scratch
    servo = Step(
        scene=scene, actuator=scene.actuator, decay=scene.decay, offsets=offsets, y=y, tau=None, drive=None,
        predicted=None, t=t, span=h, h=h, h_implicit=h, theta=1.0, extrapolation_ratio=None,
        tolerance=NEWTON_TOLERANCE, W=scratch.W, Z=scratch.Z, C=scratch.C, F=scratch.F, N=scratch.N,
        pool=scratch.pool, part=None, rows=scratch.rows, closing=scratch.closing,
    )  # fmt: skip
    for i in range(len(torques)):
        torques[i] = _servo_torque(scene.actuator, servo, i)
    bare = Step(
        scene=scene, actuator=None, decay=None, offsets=offsets, y=y, tau=torques, drive=None, predicted=None,
        t=t, span=h, h=h, h_implicit=h, theta=1.0, extrapolation_ratio=None,
        tolerance=NEWTON_TOLERANCE, W=scratch.W, Z=scratch.Z, C=scratch.C, F=scratch.F, N=scratch.N,
        pool=scratch.pool, part=None, rows=scratch.rows, closing=scratch.closing,
    )  # fmt: skip
    step_trees(bare)


@inline
def _servo_torque(actuator: Any, step: Any, i: int) -> Any:
    """Return the torque on the joint over the whole step, and update the motor."""
    y, offsets, E = step.y, step.offsets, step.offsets.energy + ENERGIES * i
    v = y[offsets.qd + i]
    f = v + step.decay[i, FILTER_DECAY] * (y[offsets.filtered_speed + i] - v)
    y[offsets.filtered_speed + i] = f
    viscous = motor_of(actuator)[i].viscous_friction * f
    y[E + FRICTION] += step.h * (viscous * v)
    y[E + WORK] += step.h * (viscous * v)
    return _geared(actuator, step, i, v, f, viscous)


@by_type
def _geared(actuator: Any, step: Any, i: int, v: Any, f: Any, viscous: Any) -> Any:
    """Return the torque through the gearbox minus the viscous friction."""


@_geared.of(RigidServo)
def _rigid(actuator: Any, step: Any, i: int, v: Any, f: Any, viscous: Any) -> Any:
    return actuator.motor[i].torque_constant * _current(actuator.motor, step, i, v) - viscous


@_geared.of(MipsdServo)
def _mipsd(actuator: Any, step: Any, i: int, v: Any, f: Any, viscous: Any) -> Any:
    y, offsets, h, g, E = step.y, step.offsets, step.h, actuator.gear[i], step.offsets.energy + ENERGIES * i
    w = y[offsets.rotor_speed + i]
    I = _current(actuator.motor, step, i, w)
    limit = 0.2 * g.inertia / (g.ratio * h)  # of the torque that the damper transmits
    T = g.stiffness * wind_up(g, y[offsets.rotor + i] - y[offsets.q + i])
    B = clamp(g.damping * (w - f), -limit + 0.0 * w, limit + 0.0 * w)
    w = w + h * (actuator.motor[i].torque_constant * I - g.rotor_damping * w - (T + B)) / g.inertia
    y[offsets.rotor_speed + i] = w
    y[offsets.rotor + i] += h * w
    y[E + GEAR] += h * (B * (w - v))
    y[E + FRICTION] += h * (g.rotor_damping * (w * w))
    return (T + B) - viscous


@inline
def _current(motor: Any, step: Any, i: int, w: Any) -> Any:
    """Return the current at the end of the step [A], and add the energies as that program counts them."""
    m, y, offsets, h, E = motor[i], step.y, step.offsets, step.h, step.offsets.energy + ENERGIES * i
    V = y[offsets.voltage + i]
    I, _, _ = current_step(m, step.decay, i, y[offsets.current + i], V, w, h)
    supply, copper = h * (V * I), h * (m.resistance * (I * I))
    stored = 0.5 * m.inductance * (I * I - y[offsets.current + i] * y[offsets.current + i])
    add_electrical(y, E, supply, copper, supply - copper - h * (m.torque_constant * w * I) - stored)
    move_source(step.scene.supply, step, i, I)
    y[offsets.current + i] = I
    return I


def _workspace(sizes: Sizes, zeros: Any) -> SimTwo:
    return SimTwo(scratch(sizes, zeros), zeros(sizes.n))


SIMTWO = Integrator("simtwo", 1, _workspace, drives=(RigidServo, MipsdServo), closes=False)
