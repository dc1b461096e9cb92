"""The content of a robot's file of any format."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

from ..model import Base, ContactPoint, Immersed, Joint, Link, Loop, Model, Propeller, Servo, Tendon
from ..model.degrees import ball_name, degrees_of, is_first
from ..model.sensor import Sensor
from ..model.shapes import Shape

MASSLESS: dict[str, Any] = {"mass": 0.0, "center_of_mass": (0.0, 0.0, 0.0), "inertia": (0.0,) * 6}  # of a Link


class Posture(NamedTuple):
    """A named posture of a file."""

    base: tuple[float, ...]  # position [m] and quaternion w x y z of the root link in the world
    joints: Mapping[
        str, Any
    ]  # of all degrees [rad or m]; by the names of ball joints quaternions w x y z

    def numbers(self, joints: tuple[Joint, ...], held: Mapping[str, float]) -> tuple[float, ...]:
        """Return the joints' part of q."""
        found: list[float] = []
        for one in degrees_of(joints).joints:
            if one.type == "fixed" or one.name in held:
                continue
            if is_first(one):
                found += self.joints[ball_name(one)]
            elif one.type != "ball":
                found.append(self.joints[one.name])
        return tuple(found)


class Robot(NamedTuple):
    """A robot as its file describes it."""

    name: str
    links: tuple[Link, ...]
    joints: tuple[Joint, ...]
    shapes: tuple[Shape, ...]
    base: Base | None
    held: Mapping[str, float] = {}  # joints that cannot move, and where they are [rad or m]
    servos: Mapping[str, Servo] = {}
    postures: Mapping[str, Posture] = {}
    excluded: tuple[tuple[str, str], ...] = ()  # links that do not touch each other
    loops: tuple[Loop, ...] = ()
    tendons: tuple[Tendon, ...] = ()
    immersed: tuple[Immersed, ...] = ()
    rollers: Mapping[str, ContactPoint] = {}  # of wheels with rollers, by link
    propellers: tuple[Propeller, ...] = ()
    sensors: tuple[Sensor, ...] = ()


def with_rollers(model: Model, rollers: Mapping[str, ContactPoint]) -> Model:
    """Return the model with the rollers of its wheels in place of other contact points there."""
    bearing = {name: [p.load_bearing for p in model.contacts if p.link == name] for name in rollers}
    rolling = (replace(point, load_bearing=any(bearing[name])) for name, point in rollers.items() if bearing[name])
    return replace(model, contacts=(*(p for p in model.contacts if p.link not in rollers), *rolling))
