"""The state of servos that hold their joints by given torques at rest: the servo model, inverted."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal, TypeAlias

import numpy as np

from ..core.effects.actuator import controller_of, motor_of
from ..core.effects.controller import PID_SPEED
from ..core.effects.mipsd_servo import MipsdServo
from ..core.effects.pd_servo import PDServo
from ..scene.compile import CompiledScene

TrimStatus = Literal["ok", "tips", "slips", "touches", "too weak", "moves"]
Fault: TypeAlias = "tuple[TrimStatus, str] | None"


def put_servos(
    scene: CompiledScene, state: np.ndarray, angles: np.ndarray, torque: np.ndarray
) -> tuple[np.ndarray | None, Fault]:
    """Set the state of servos that hold these torques [N m]; return their references and a fault or None."""
    actuator, names = scene.constants.actuator, scene.model.joint_names
    if actuator is None:
        return None, None
    state[slice(*scene.part("torque"))] = torque
    if isinstance(actuator, PDServo):
        pd = actuator.pd
        free = pd.Kp > 0.0
        reference = angles + np.divide(torque, pd.Kp, out=np.zeros_like(angles), where=free)
        weak = (np.abs(torque) > pd.torque_limit) | (~free & (torque != 0.0))
        return reference, _weak(names, weak, torque)
    motor, controller = motor_of(actuator), controller_of(actuator)
    driven = motor.torque_constant > 0.0
    current = np.divide(torque, motor.torque_constant, out=np.zeros_like(angles), where=driven)
    voltage = motor.resistance * current
    if isinstance(actuator, MipsdServo):
        gear = actuator.gear
        wound = np.divide(torque, gear.stiffness, out=np.zeros_like(angles), where=gear.stiffness > 0.0)
        state[slice(*scene.part("rotor"))] = angles + wound + np.sign(torque) * gear.gap
    asked = _asked(scene, state, voltage, current)
    reference, integral, error, unreachable = _references(scene, angles, asked)
    goals = {"current": current, "voltage": voltage, "integral": integral, "last_error": error}
    goals["profiled_reference"] = reference
    view = scene.state_view(state)
    for name in view.keys() & goals.keys():
        view[name][...] = goals[name]
    delay = scene.constants.firmware.delay
    if delay is not None:
        state[slice(*scene.part("delayed"))] = np.tile(asked, delay.slots)
    pwm = scene.constants.firmware.pwm
    most = controller.voltage_limit * (1.0 if pwm is None else pwm.duty_limit)
    weak = (np.abs(asked) > most) | (np.abs(current) > motor.current_limit) | unreachable | (~driven & (torque != 0.0))
    return reference, _weak(names, weak, torque)


def _weak(names: Iterable[str], weak: np.ndarray, torque: np.ndarray) -> Fault:
    """Return the fault of servos that cannot hold their joints, or None."""
    found = [f"{name} {value:.3g} N m" for name, bad, value in zip(names, weak, torque) if bad]
    return ("too weak", f"servos cannot hold {', '.join(found)}: give another posture") if found else None


def _asked(scene: CompiledScene, state: np.ndarray, voltage: np.ndarray, current: np.ndarray) -> np.ndarray:
    """Return what controllers must demand (joints,) [V], at the nominal supply, for motors to get these voltages.

    Behind a source with a resistance the bus has the voltage V = V0 - R P / V, P the power that the motors draw.
    """
    if scene.constants.supply is None:
        return voltage
    source, controller = scene.constants.supply[0], controller_of(scene.constants.actuator)
    drawn = 4.0 * source.resistance * float(voltage @ current)
    bus = 0.5 * (source.voltage + np.sqrt(max(source.voltage**2 - drawn, 0.0)))
    state[slice(*scene.part("bus_voltage"))] = bus
    state[slice(*scene.part("duty"))] = voltage / bus
    return controller.voltage_limit * voltage / bus


def _references(
    scene: CompiledScene, angles: np.ndarray, voltage: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return references, integrals and errors (joints,) for which controllers demand these voltages; which cannot."""
    controller, band = controller_of(scene.constants.actuator), scene.constants.firmware.band
    reference, integral, error = angles.copy(), np.zeros_like(angles), np.zeros_like(angles)
    unreachable = np.zeros(len(angles), dtype=bool)
    for i, c in enumerate(controller):
        angle, resolution = float(angles[i]), float(c.encoder_resolution)
        if resolution > 0.0:  # as the encoder reads it
            angle = float(np.round(angle / resolution) * resolution)
        margin, punch = (0.0, 0.0) if band is None else (band[i].compliance_margin, band[i].punch)
        speed = c.law == PID_SPEED
        reference[i] = angle
        rest = float(voltage[i]) - c.Kf * angle
        if c.Ki != 0.0:
            integral[i] = rest / c.Ki
        elif rest != 0.0:
            side = np.sign(rest)
            slope = c.Kf if speed else c.Kp + c.Kf
            beyond = 0.0 if speed else c.Kp * margin - punch
            by = (rest + side * beyond) / slope if slope else 0.0
            reference[i] += by
            unreachable[i] = slope == 0.0 or (not speed and by * side < margin)
            error[i] = 0.0 if speed else by - side * margin
    return reference, integral, error, unreachable
