"""Read motors of SimTwo as servos.

Sums and differences of the controllers are per tick in the program of 2012, and independent of the period here: Ki is
ki over the period, and Kd of the PID laws kd times the period.  Of a gear, `ke` and `bv` are at the rotor's side, which
makes G ke and G^2 bv of them at the output; `ke` and `be` of later files are at the output.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias
from xml.etree.ElementTree import Element

from ...model import Controller, Gearbox, Servo
from ..markup import Read
from .expression import Numbers, stated

Parts: TypeAlias = Mapping[str, Element]  # a motor and its parts

LAWS = {"state": "state", "pidposition": "pid_position", "pidspeed": "pid_speed"}
SPEED_FILTER = -1e-3 / math.log(0.95)  # [s] 0.95 of the old speed a step of 1 ms
CURRENT_SLEW = 150.0  # [A/s] 0.15 A a step of 1 ms
PARTS = ("motor", "rotor", "gear", "friction", "spring", "controller")


def parts_of(element: Element, suffix: str, inherited: Parts) -> Parts:
    """Return a motor and its parts, over those inherited from <default>."""
    return over(element, {name: name + suffix for name in PARTS}, inherited)


def over(element: Element, tags: Mapping[str, str], inherited: Parts) -> Parts:
    """Return properties of an element by name, over those inherited; tags: of the properties."""
    found = dict(inherited)
    for name, tag in tags.items():
        own = element.find(tag)
        if isinstance(own, Read):
            own.under, found[name] = found.get(name), own
    return found


def spring_of(parts: Parts, numbers: Numbers, what: str) -> dict[str, Any]:
    """Return stiffness and reference of the spring of an axis; `zeropos` is in degrees, of sliders too."""
    k, zero = (numbers.one(parts.get("spring"), name, 0.0, f"{what} <spring>") for name in ("k", "zeropos"))
    return {"stiffness": k, "spring_reference": math.radians(zero)}


def servo_of(parts: Parts, numbers: Numbers, what: str) -> tuple[Servo | None, dict[str, Any]]:
    """Return the servo of an axis; without one, if the motor is switched off, what turns with the axis, of Joint."""

    def read(part: str, name: str, default: float) -> float:
        return numbers.one(parts.get(part), name, default, f"{what} <{part}>")

    if not read("motor", "active", 1.0):
        ratio, J = read("gear", "ratio", 10.0), read("rotor", "J j", 0.0)
        damping = read("friction", "bv", 1e-5) + (ratio**2 * read("rotor", "bv", 1e-3) if J else 0.0)
        return None, {"damping": damping, "friction": read("friction", "fc", 1e-3), "armature": ratio**2 * J}
    return Servo(
        _controller(read, parts, what),
        _gearbox(read, parts.get("gear")),
        resistance=read("motor", "ri", 1.0),
        inductance=read("motor", "li", 0.0),
        motor_constant=read("motor", "ki", 0.014),
        voltage_limit=read("motor", "vmax", 24.0),
        current_limit=read("motor", "imax", 4.0),
        current_slew=CURRENT_SLEW,
        viscous_friction=read("friction", "bv", 1e-5),
        coulomb_friction=read("friction", "fc", 1e-3),
        speed_filter=SPEED_FILTER,
    ), {}


def _controller(read: Callable[[str, str, float], float], parts: Parts, what: str) -> Controller:
    """Return the law; without gains if the controller is switched off."""
    period = 1e-3 * read("controller", "period", 10.0)
    mode = parts["controller"].get("mode", "pidspeed") if "controller" in parts else "pidspeed"
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


def _gearbox(read: Callable[[str, str, float], float], gear: Element | None) -> Gearbox:
    ratio, J = read("gear", "ratio", 10.0), read("rotor", "J j", 0.0)
    rotor_damping = read("rotor", "bv", 1e-3) if J else 0.0
    if stated(gear, "ke") is None:
        return Gearbox(ratio, J, rotor_damping)
    at_output = stated(gear, "be") is not None
    stiffness = read("gear", "ke", 0.0) * (1.0 if at_output else ratio)
    damping = read("gear", "be bv", 0.0) * (1.0 if at_output else ratio**2)
    return Gearbox(ratio, J, rotor_damping, stiffness, damping)
