"""Find the numbers that have no effect in a scene: of servos by its gearbox, laws and integrator, of fixed joints."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import fields
from typing import Any

from ..base.flaws import quoted
from ..core.effects.friction import SOFT
from ..core.integrate.integrator import Integrator
from ..model import TORQUE_LAWS, Controller, Gearbox, Joint, Model, Servo
from ..model.links import OF_DEGREES
from .actuator import is_elastic
from .gearbox_kinds import GearboxKind

FIXED = "the joint is fixed; leave it out, or give the joint another type"
CONTINUOUS = "a torque law acts at every instant; use a sampled law"
SAMPLING = ("period", "lag")
ELASTIC = ("stiffness", "damping", "backlash")
MOTOR = ("inductance", "current_slew", "encoder_resolution", "speed_filter")
STALL = ("resistance", "motor_constant", "voltage_limit", "current_limit")


def unused(model: Model, gearbox: GearboxKind | None, method: Integrator) -> tuple[str, ...]:
    """Return a sentence for each number of servos, tendons' drives and fixed joints without effect, with the remedy.

    Parameters
    ----------
    model : Model
        The robot.
    gearbox : str or None
        Model of its gearboxes; None: its servos do not act.
    method : Integrator
        The integrator.

    Returns
    -------
    tuple of str
        The sentences.
    """
    found: dict[tuple[str, str], list[str]] = {}
    for owner, part, name, why in _all(model, gearbox, method):
        found.setdefault((f"{type(part).__name__}.{name} = {getattr(part, name):g}", why), []).append(owner)
    return tuple(f"{what} of {quoted(names)} has no effect: {why}" for (what, why), names in found.items())


def _all(model: Model, gearbox: GearboxKind | None, method: Integrator) -> Iterator[tuple[str, Any, str, str]]:
    """Yield whose number it is, record, field and reason."""
    for joint in model.joint_names if gearbox else ():
        if joint in model.servos:
            yield from ((joint, *one) for one in _of_servo(model.servos[joint], gearbox, method))
    for tendon in model.tendons:
        if tendon.controller is not None:
            yield from ((tendon.name, *one) for one in _stated(tendon.controller, SAMPLING, CONTINUOUS))
    for fixed in model.joints:
        if fixed.type == "fixed":
            yield from ((fixed.name, *one) for one in _stated(fixed, OF_DEGREES, FIXED))


def _of_servo(servo: Servo, kind: GearboxKind | None, method: Integrator) -> Iterator[tuple[Any, str, str]]:
    """Yield record, field and reason of what has no effect."""
    law = servo.controller.law
    also = " and a sampled law" if law in TORQUE_LAWS else ""
    if not is_elastic(servo):
        also += ", with a finite stiffness and a rotor_inertia above 0"
    if kind != "mipsd":
        yield from _stated(servo.gearbox, ELASTIC, f"the gearbox {kind!r} is rigid; use gearbox='mipsd'{also}")
    if kind == "standard":
        without = "the gearbox 'standard' has no rotor; use gearbox='rotor'"
        yield from _stated(servo.gearbox, ("rotor_inertia",), without)
    if law in TORQUE_LAWS:
        yield from _stated(servo.controller, SAMPLING, CONTINUOUS)
        limited = (
            servo.controller.torque_limit < math.inf
        )  # else stops are as stiff as the motor's stall torque asks for
        yield from _stated(
            servo,
            (*MOTOR, *STALL) if limited else MOTOR,
            "a torque law has neither motor nor encoder; use a sampled law",
        )
    if law == "pid_position" and not method.drives:  # whose friction takes the filtered speed
        yield from _stated(servo, ("speed_filter",), "the law 'pid_position' reads the angle alone; use law='state'")
    if law == "pid_speed":
        without = "the law 'pid_speed' reads the speed, not the encoder; use law='state' or 'pid_position'"
        yield from _stated(servo, ("encoder_resolution",), without)
    if method.soft and servo.stick_speed < SOFT:
        without = f"integrator {method.name!r} takes at least {SOFT:g} rad/s; use 'ars343', or a larger one"
        yield from _stated(servo, ("stick_speed",), without)


def _stated(
    part: Servo | Controller | Gearbox | Joint, names: Iterable[str], why: str
) -> Iterator[tuple[Any, str, str]]:
    """Yield those of the numbers that are not as they are where nothing is stated."""
    for f in fields(part):
        if f.name in names and getattr(part, f.name) != f.default:
            yield part, f.name, why
