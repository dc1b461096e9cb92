"""Write a robot as a tree of text."""

from __future__ import annotations

import math

from ..base.arguments import instance
from ..model import Joint, Model, depth_first
from ..model.links import COMPOSITE


def tree_text(model: Model) -> str:
    """Write a robot as a tree of text.

    Parameters
    ----------
    model : Model
        The robot.

    Returns
    -------
    str
        A line for each joint with its child link, indented under its parent: type, limits, servo, mass [kg].
    """
    instance("model", model, Model, "give a Model")
    mass = {link.name: link.mass for link in model.links}
    last = {joint.parent: joint.name for joint in depth_first(model)}  # of each link's joints
    moving = len(model.moving_joints)
    lines = [f"{model.name}: {model.base} base, {moving} moving joint{'s' * (moving != 1)}, {model.mass:.4g} kg"]
    lines.append(_link(model.root, mass[model.root]))
    under = {model.root: ""}
    for joint in depth_first(model):
        ends = last[joint.parent] == joint.name
        branch = under[joint.parent] + ("└─ " if ends else "├─ ")
        lines.append(f"{branch}{joint.name} ({_what(model, joint)}): {_link(joint.child, mass[joint.child])}")
        under[joint.child] = under[joint.parent] + ("   " if ends else "│  ")
    return "\n".join(lines)


def _link(name: str, mass: float) -> str:
    return f"{name}, {mass:.4g} kg" if mass > 0 else name


def _what(model: Model, joint: Joint) -> str:
    """Describe a joint: its type, range, and what holds or drives it."""
    parts: list[str] = [joint.type]
    if joint.type not in ("fixed", "continuous", *COMPOSITE):
        parts.append(f"{_position(joint, joint.lower, unit=False)} to {_position(joint, joint.upper)}")
    if joint.name in model.locked:
        parts.append(f"locked at {_position(joint, model.locked[joint.name])}")
    if joint.mimic is not None:
        parts.append(f"follows {joint.mimic.joint}: {joint.mimic.multiplier:g} times, {joint.mimic.offset:+g}")
    if joint.name in model.servos:
        servo = model.servos[joint.name]
        parts.append(f"servo {servo.controller.law}, {servo.gearbox.ratio:g} : 1")
    return ", ".join(parts)


def _position(joint: Joint, value: float, unit: bool = True) -> str:
    shown, name = (value, " m") if joint.type == "prismatic" else (math.degrees(value), " deg")
    return f"{shown:.4g}" + name * unit
