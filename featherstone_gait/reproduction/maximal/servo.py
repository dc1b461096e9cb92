"""SimTwo's chain of a servo in its order of updates, a torque that stands over a step.

Filter of the speed, controller at its ticks (that of the rest of the package), back-EMF with the speed of the step's
start, current with the exact exponential, limits of its slew and size, energy, gearbox, torque.  Slew and filter are of
a step, whatever its length, as they were in that program: at 1 ms they are those of the servo's data.
"""

from __future__ import annotations

from typing import Any

from ...core.compile.by_type import NoneType, by_type
from ...core.compile.jit import inline
from ...core.compile.lanes import clamp
from ...core.effects.decay import MOTOR_DECAY
from ...core.effects.energies import COPPER, ENERGIES, FRICTION, GEAR, METER, SUPPLY, WORK
from ...core.effects.gearbox import wind_up
from ...core.effects.mipsd_servo import MipsdServo
from ...core.effects.rigid_servo import RigidServo


@inline
def filter_speeds(actuator: Any, run: Any, w: Any, y: Any) -> None:
    """Update the filtered speeds, where there are servos."""
    offsets = run.offsets[0]
    if actuator is not None:
        for i in range(len(w.axes)):
            v = y[offsets.qd + i]
            y[offsets.filtered_speed + i] = v + w.axes[i].filter_left * (y[offsets.filtered_speed + i] - v)


@by_type
def servo_torque(actuator: Any, run: Any, axis: Any, y: Any, i: int) -> Any:
    """Return the torque of servo i on its axis over the coming step [N m]; update motor and rotor."""


servo_torque.of(NoneType)(lambda actuator, run, axis, y, i: 0.0)


@servo_torque.of(RigidServo)
def _rigid(actuator: Any, run: Any, axis: Any, y: Any, i: int) -> float:
    m, offsets = actuator.motor[i], run.offsets[0]
    emf = clamp(m.torque_constant * y[offsets.qd + i], -axis.voltage_limit, axis.voltage_limit)
    return m.torque_constant * _current(m, axis, run, y, (i, emf)) - axis.viscous * y[offsets.filtered_speed + i]


@servo_torque.of(MipsdServo)
def _geared(actuator: Any, run: Any, axis: Any, y: Any, i: int) -> float:
    offsets, h = run.offsets[0], run.plan.h
    m, g, speed = actuator.motor[i], actuator.gear[i], y[offsets.rotor_speed + i]
    I = _current(m, axis, run, y, (i, m.torque_constant * speed))
    e = wind_up(g, y[offsets.rotor + i] - y[offsets.q + i])
    slip = speed - y[offsets.filtered_speed + i]
    damper = clamp(g.damping * slip, -axis.damper_limit, axis.damper_limit)
    T = g.stiffness * (1.0 + axis.hardening * abs(e)) * e + damper
    speed += h * (m.torque_constant * I - g.rotor_damping * speed - T) / g.inertia
    y[offsets.rotor_speed + i] = speed
    y[offsets.rotor + i] += h * speed
    y[offsets.energy + ENERGIES * i + GEAR] += h * (damper * slip)
    return T - axis.viscous * y[offsets.filtered_speed + i]


@inline
def _current(m: Any, axis: Any, run: Any, y: Any, against: Any) -> float:
    """Return the current at the end of the step [A], and add the energies; against: joint and back-EMF [V]."""
    (i, emf), offsets, h = against, run.offsets[0], run.plan.h
    E, V, last = offsets.energy + ENERGIES * i, y[offsets.voltage + i], y[offsets.current + i]
    left = run.scene.decay[i, MOTOR_DECAY]
    I = left * last + (1.0 - left) * ((V - emf) / m.resistance)
    I = clamp(clamp(I, last - axis.slew, last + axis.slew), -m.current_limit, m.current_limit)
    y[offsets.current + i] = I
    y[E + SUPPLY] += h * (V * I)
    y[E + METER] += h * max(V * I, 0.0)
    y[E + COPPER] += h * (m.resistance * (I * I))
    return I


@inline
def drive_joints(actuator: Any, run: Any, w: Any, x: Any, y: Any) -> None:
    """Compute the torques of all axes from servos and joint damping, and add their energies."""
    offsets, h = run.offsets[0], run.plan.h
    for i in range(len(w.axes)):
        v, E = x.qd[i], offsets.energy + ENERGIES * i
        T, damped = servo_torque(actuator, run, w.axes[i], y, i), w.axes[i].damping * v
        y[E + WORK] += h * (T * v)
        y[E + FRICTION] += h * (damped * v)
        y[offsets.torque + i] = T
        x.torque[i] = T - damped
