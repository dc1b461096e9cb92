"""Read motors of SimTwo as servos.

Sums and differences of the controllers are per tick in the program of 2012, and independent of the period here: Ki is
ki over the period, and Kd of the PID laws kd times the period.  Of a gear, `ke` and `bv` are at the rotor's side, which
makes G ke and G^2 bv of them at the output; `ke` and `be` of later files are at the output.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, TypeAlias
from xml.etree.ElementTree import Element

from ...model import Controller, Gearbox, Servo
from .expression import Numbers

Parts: TypeAlias = Mapping[str, dict[str, str]]  # attributes of a motor and its parts

LAWS = {"state": "state", "pidposition": "pid_position", "pidspeed": "pid_speed"}
SPEED_FILTER = -1e-3 / math.log(0.95)  # [s] 0.95 of the old speed a step of 1 ms
CURRENT_SLEW = 150.0  # [A/s] 0.15 A a step of 1 ms
PARTS = ("motor", "rotor", "gear", "friction", "spring", "controller")


def parts_of(element: Element, suffix: str, inherited: Parts) -> Parts:
    """Return attributes of a motor and its parts, over those inherited from <default>."""
    parts = {name: dict(inherited.get(name, {})) for name in PARTS}
    for child in element:
        name = child.tag.removesuffix(suffix) if suffix else child.tag
        if child.tag == name + suffix and name in PARTS:
            parts[name].update(child.attrib)
    return parts


def spring_of(parts: Parts, numbers: Numbers, what: str) -> dict[str, Any]:
    """Return stiffness and reference of the spring of an axis; `zeropos` is in degrees, of sliders too."""
    read = partial(numbers.one, Element("spring", parts["spring"]), what=f"{what} <spring>")
    return {"stiffness": read("k", 0.0), "spring_reference": math.radians(read("zeropos", 0.0))}


def servo_of(parts: Parts, numbers: Numbers, what: str) -> Servo | None:
    """Return the servo of an axis; None if the motor is switched off."""

    def read(part: str, name: str, default: float) -> float:
        return numbers.one(Element(part, parts[part]), name, default, f"{what} <{part}>")

    if not read("motor", "active", 1.0):
        return None
    return Servo(
        _controller(read, parts["controller"].get("mode", "pidspeed"), what),
        _gearbox(read, parts["gear"]),
        resistance=read("motor", "ri", 1.0),
        inductance=read("motor", "li", 0.0),
        motor_constant=read("motor", "ki", 0.014),
        voltage_limit=read("motor", "vmax", 24.0),
        current_limit=read("motor", "imax", 4.0),
        current_slew=CURRENT_SLEW,
        viscous_friction=read("friction", "bv", 1e-5),
        coulomb_friction=read("friction", "fc", 1e-3),
        speed_filter=SPEED_FILTER,
    )


def _controller(read: Callable[[str, str, float], float], mode: str, what: str) -> Controller:
    """Return the law; without gains if the controller is switched off."""
    period = 1e-3 * read("controller", "period", 10.0)
    if mode not in LAWS:
        raise ValueError(f"{what}: controller mode {mode!r}; expected {', '.join(LAWS)}: use one of these")
    law: Any = LAWS[mode]
    if not read("controller", "active", 0.0):
        return Controller(law, period=period, lag=0.0)
    if not period > 0:
        raise ValueError(f"{what}: controller period is {period * 1e3:g} ms; expected > 0: correct it")
    return Controller(
        law,
        Kp=read("controller", "kp", 1.0),
        Ki=read("controller", "ki", 0.0) / period,
        Kd=read("controller", "kd", 0.0) * (1.0 if law == "state" else period),
        Kf=read("controller", "kf", 0.0),
        period=period,
        lag=0.0,
    )


def _gearbox(read: Callable[[str, str, float], float], stated: Mapping[str, str]) -> Gearbox:
    ratio = read("gear", "ratio", 10.0)
    J = read("rotor", "J", read("rotor", "j", 0.0))
    rotor_damping = read("rotor", "bv", 1e-3) if J else 0.0
    if "ke" not in stated:
        return Gearbox(ratio, J, rotor_damping)
    at_output = "be" in stated
    stiffness = read("gear", "ke", 0.0) * (1.0 if at_output else ratio)
    damping = read("gear", "be", 0.0) if at_output else ratio**2 * read("gear", "bv", 0.0)
    return Gearbox(ratio, J, rotor_damping, stiffness, damping)
