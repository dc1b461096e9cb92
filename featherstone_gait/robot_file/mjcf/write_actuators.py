"""Write servos as MuJoCo's actuators; the laws are those of `actuators.py`, at the output of the gearbox (gear 1)."""

from __future__ import annotations

import math

from ...model import Controller, Joint, Model, Servo, Tendon, depends_on_load_or_speed
from ..markup import element
from .tree import unused

LOADED = "no friction that falls with the speed or grows with the load"
LONG_WAY = "the reference is followed as it is, not the short way round"
DAMPED = "the limit of the torque holds the damping too"
CONTINUOUS = ("pd", "pd_clamped")
MOTORS = ("state", "pid_position")  # laws that `dcmotor` has


def actuator_lines(model: Model) -> tuple[list[str], list[str]]:
    """Write the actuators, and what they lack."""
    servos = {joint.name: model.servos[joint.name] for joint in model.moving_joints if joint.name in model.servos}
    lacking: dict[str, list[str]] = {}
    lines = [line for name, servo in servos.items() for line in _actuator(name, servo, model.references.get(name))]
    rods = [loop.name for loop in model.loops if loop.kind == "distance"]
    for tendon in model.tendons:
        if tendon.controller is not None and moves(model, tendon):
            lines += _drive(unused(tendon.name, servos), unused(tendon.name, rods), tendon.controller)
            if tendon.controller.law == "pd" and tendon.controller.torque_limit < math.inf:
                lacking.setdefault(DAMPED, []).append(tendon.name)
    for name, servo in servos.items():
        for what in _lacking(servo):
            lacking.setdefault(what, []).append(name)
    source = [] if model.supply is None else ["of the supply: each actuator has its own, whatever the others draw"]
    alike: dict[str, list[str]] = {}
    for what, names in lacking.items():
        alike.setdefault(", ".join(names), []).append(what)
    return lines, source + [f"of the servos {names}: {', '.join(whats)}" for names, whats in alike.items()]


def passive(model: Model, joint: Joint) -> tuple[float, float, float]:
    """Return damping, Coulomb friction and armature of a joint, with what its servo's actuator cannot state."""
    servo = model.servos.get(joint.name)
    if servo is None:
        return joint.damping, joint.friction, joint.armature
    damping, armature = (0.0, 0.0) if servo.controller.law in MOTORS else (_damping(servo), rotor_inertia(servo))
    if servo.controller.law == "pid_speed":
        damping += (servo.gearbox.ratio * servo.motor_constant) ** 2 / servo.resistance
    return joint.damping + damping, joint.friction + servo.coulomb_friction, joint.armature + armature


def _damping(servo: Servo) -> float:
    """Return the damping at the output, with the rotor's [N m s/rad]."""
    return servo.viscous_friction + servo.gearbox.reflected_damping


def _speed_gain(servo: Servo) -> float:
    """Return the torque of a motor by the error of the speed, back-EMF apart [N m s/rad]."""
    return servo.gearbox.ratio * servo.motor_constant / servo.resistance * servo.controller.Kp


def is_stated(servo: Servo, effort: float) -> bool:
    """Return whether MJCF states all of the servo of a joint with this effort, by which MuJoCo limits servos."""
    law = servo.controller
    if law.law != "pd_clamped" or law.torque_limit > effort:
        return False
    return servo == Servo(Controller(law.law, law.Kp, Kd=law.Kd, torque_limit=law.torque_limit))


def rotor_inertia(servo: Servo | None) -> float:
    """Return G^2 J, which a servo adds to its joint [kg m^2]."""
    return servo.gearbox.reflected_inertia if servo else 0.0


def _actuator(name: str, servo: Servo, reference: tuple[float, float] | None) -> list[str]:
    """Write the actuator of a servo; none if MuJoCo has no such law.  reference: its range."""
    law, gear = servo.controller, servo.gearbox
    if law.law == "pid_speed":  # with the back-EMF among the joint's damping
        most = _speed_gain(servo) / law.Kp * servo.voltage_limit if law.Kp else 0.0
        kv = {"kv": _speed_gain(servo), "forcerange": (-most, most)}
        return element("velocity", {"name": name, "joint": name, **kv}) if law.Kp else []
    if law.law in CONTINUOUS:
        limit = (-law.torque_limit, law.torque_limit) if law.torque_limit < math.inf else None
        own = {"name": name, "joint": name, "kp": law.Kp, "kv": law.Kd, "forcerange": limit, "ctrlrange": reference}
        return element("position", own)
    K, R = gear.ratio * servo.motor_constant, servo.resistance
    current = servo.current_limit if servo.current_limit < math.inf else 0.0
    slew = servo.current_slew if servo.current_slew < math.inf and servo.inductance else 0.0
    attributes = {
        "name": name,
        "joint": name,
        "motorconst": (K, K),
        "resistance": R,
        "inductance": (servo.inductance, 0.0) if servo.inductance else None,
        "saturation": (0.0, current, slew) if current or slew else None,
        "input": "pos",
        "ctrlrange": reference,
        "controller": (K / R * law.Kp, K / R * law.Ki, K / R * (law.Kd + K), 0.0, 0.0, servo.voltage_limit),
        "armature": rotor_inertia(servo) or None,
        "damping": _damping(servo) or None,
    }
    return element("dcmotor", attributes)


def moves(model: Model, tendon: Tendon) -> bool:
    """Return whether a tendon that MJCF states has a length that changes."""
    return bool(tendon.path) != any(name not in model.held for name, _ in tendon.joints)


def _drive(name: str, tendon: str, law: Controller) -> list[str]:
    """Write the actuator of a tendon."""
    limit = (-law.torque_limit, law.torque_limit) if law.torque_limit < math.inf else None
    attributes = {"name": name, "tendon": tendon, "forcerange": limit}
    if law.Kp:
        return element("position", attributes | {"kp": law.Kp, "kv": law.Kd})
    if law.Kd:
        return element("general", attributes | {"biastype": "affine", "biasprm": (0.0, 0.0, -law.Kd)})
    return element("motor", attributes)


def _lacking(servo: Servo) -> list[str]:
    """Return what the actuator lacks of a servo."""
    law, gear = servo.controller, servo.gearbox
    if law.law in CONTINUOUS:
        limited = law.law == "pd" and law.torque_limit < math.inf
        return [DAMPED] * limited + [LONG_WAY] * law.wrap + _beside(servo)
    speed = law.law == "pid_speed"
    found = {
        "left out, since without Kp no actuator follows the speed": speed and not law.Kp,
        "no integral and derivative of the speed's error, inductance and limit of the current": speed
        and (law.Ki > 0 or law.Kd > 0 or servo.inductance > 0 or servo.current_limit < math.inf),
        "the controller acts at all times, not at ticks, and without lag": True,
        "the gearbox is rigid": gear.stiffness < math.inf,
        "no backlash": gear.backlash > 0,
        "the friction stands with the joint": servo.coulomb_friction > 0,
        LOADED: depends_on_load_or_speed(gear),
        "the encoder is exact": servo.encoder_resolution > 0,
        "the speed is not filtered": servo.speed_filter > 0,
        "no feed-forward of the angle (Kf)": law.Kf != 0,
        "no limit of the current's rate without inductance": servo.current_slew < math.inf and not servo.inductance,
        "the damping acts on the speed, not on the error's rate": law.law == "pid_position" and law.Kd > 0,
        "no dead band and no punch": law.compliance_margin > 0 or law.punch > 0,
        "the duty cycle is continuous": law.pwm_steps > 0,
        "no limit of the duty cycle": law.duty_limit < 1,
        "the goal is the reference, without a profile's speed": law.profile_speed < math.inf,
        "no delay from reading to voltage": law.delay > 0,
        LONG_WAY: law.wrap,
    }
    return [what for what, holds in found.items() if holds] + (_beside(servo) if speed else [])


def _beside(servo: Servo) -> list[str]:
    """Return what of a servo without a `dcmotor` is written at its joint."""
    stated = servo.coulomb_friction or _damping(servo) or rotor_inertia(servo)
    lacking = ["the rotor's inertia and the friction stand with the joint"] if stated else []
    return lacking + [LOADED] * depends_on_load_or_speed(servo.gearbox)
