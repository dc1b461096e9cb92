"""SimTwo's chain of a servo in its order of updates, a torque that stands over a step.

Filter of the speed, controller at its ticks (that of the rest of the package), back-EMF with the speed of the step's
start, current with the exact exponential, limits of its slew and size, energy, gearbox, torque.  Slew and filter are of
a step, whatever its length, as they were in that program: at 1 ms they are those of the servo's data.
"""

from __future__ import annotations

from typing import Any

from ...core.compile.by_type import NoneType, by_type, overridable
from ...core.compile.jit import inline
from ...core.compile.lanes import clamp
from ...core.effects.decay import MOTOR_DECAY
from ...core.effects.energies import COPPER, ENERGIES, FRICTION, GEAR, METER, SUPPLY, WORK
from ...core.effects.gearbox import wind_up
from ...core.effects.mipsd_servo import MipsdServo
from ...core.effects.rigid_servo import RigidServo


@overridable
def filter_speeds(actuator: Any, run: Any, w: Any, y: Any) -> None:
    """Update the filtered speeds."""
    offsets = run.offsets[0]
    for i in range(len(w.drive)):
        v = y[offsets.qd + i]
        y[offsets.filtered_speed + i] = v + w.drive[i].filter_left * (y[offsets.filtered_speed + i] - v)


filter_speeds.of(NoneType)(lambda actuator, run, w, y: None)


@by_type
def servo_torque(actuator: Any, run: Any, w: Any, y: Any, i: int) -> Any:
    """Return the torque of servo i on its joint over the coming step [N m]; update motor and rotor."""


@servo_torque.of(NoneType)
def _none(actuator: Any, run: Any, w: Any, y: Any, i: int) -> float:
    return 0.0


@servo_torque.of(RigidServo)
def _rigid(actuator: Any, run: Any, w: Any, y: Any, i: int) -> float:
    m, d, offsets = actuator.motor[i], w.drive[i], run.offsets[0]
    emf = clamp(m.torque_constant * y[offsets.qd + i], -d.voltage_limit, d.voltage_limit)
    I = _current(m, d, run, y, (i, emf))
    return m.torque_constant * I - d.viscous * y[offsets.filtered_speed + i]


@servo_torque.of(MipsdServo)
def _geared(actuator: Any, run: Any, w: Any, y: Any, i: int) -> float:
    m, g, d, offsets, h = actuator.motor[i], actuator.gear[i], w.drive[i], run.offsets[0], run.plan.h
    speed = y[offsets.rotor_speed + i]
    I = _current(m, d, run, y, (i, m.torque_constant * speed))
    e = wind_up(g, y[offsets.rotor + i] - y[offsets.q + i])
    slip = speed - y[offsets.filtered_speed + i]
    damper = clamp(g.damping * slip, -d.damper_limit, d.damper_limit)
    T = g.stiffness * (1.0 + d.hardening * abs(e)) * e + damper
    speed += h * (m.torque_constant * I - g.rotor_damping * speed - T) / g.inertia
    y[offsets.rotor_speed + i] = speed
    y[offsets.rotor + i] += h * speed
    y[offsets.energy + ENERGIES * i + GEAR] += h * (damper * slip)
    return T - d.viscous * y[offsets.filtered_speed + i]


@inline
def _current(m: Any, d: Any, run: Any, y: Any, what: Any) -> float:
    """Return the current at the end of the step [A], and add the energies; what: joint and back-EMF [V]."""
    i, emf = what
    offsets, h = run.offsets[0], run.plan.h
    E, V, last, left = (
        offsets.energy + ENERGIES * i,
        y[offsets.voltage + i],
        y[offsets.current + i],
        run.scene.decay[i, MOTOR_DECAY],
    )
    I = left * last + (1.0 - left) * ((V - emf) / m.resistance)
    I = clamp(clamp(I, last - d.slew, last + d.slew), -m.current_limit, m.current_limit)
    y[offsets.current + i] = I
    y[E + SUPPLY] += h * (V * I)
    y[E + METER] += h * max(V * I, 0.0)
    y[E + COPPER] += h * (m.resistance * (I * I))
    return I


@inline
def drive_joints(actuator: Any, run: Any, w: Any, x: Any, y: Any) -> None:
    """Compute the torques of all axes from servos and joint damping, and add their energies."""
    offsets, h = run.offsets[0], run.plan.h
    for k in range(len(w.axes)):
        i = w.axes[k].dof
        v, T = y[offsets.qd + i], 0.0
        if w.drive[i].on:
            T = servo_torque(actuator, run, w, y, i)
            y[offsets.energy + ENERGIES * i + WORK] += h * (T * v)
        damped = w.axes[k].damping * v
        y[offsets.energy + ENERGIES * i + FRICTION] += h * (damped * v)
        y[offsets.torque + i] = T
        x.angles[k, 2] = T - damped
