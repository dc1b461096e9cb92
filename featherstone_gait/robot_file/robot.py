"""The content of a robot's file of any format."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

from ..model import Base, ContactPoint, Immersed, Joint, Link, Loop, Model, Propeller, Servo, Tendon
from ..model.sensor import SampledSensor, Sensor
from ..model.shapes import Shape
from .settings import Posture, Settings

MASSLESS: dict[str, Any] = {"mass": 0.0, "center_of_mass": (0.0, 0.0, 0.0), "inertia": (0.0,) * 6}  # of a Link


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
    sensors: tuple[Sensor | SampledSensor, ...] = ()
    included: tuple[tuple[str, str], ...] = ()  # neighbors that do
    references: Mapping[str, tuple[float, float]] = {}  # ranges, by joint
    stated: Settings = Settings()  # by a <text> of this package


def with_rollers(model: Model, rollers: Mapping[str, ContactPoint]) -> Model:
    """Return the model with the rollers of its wheels in place of other contact points there."""
    bearing = {name: [p.load_bearing for p in model.contacts if p.link == name] for name in rollers}
    rolling = (replace(point, load_bearing=any(bearing[name])) for name, point in rollers.items() if bearing[name])
    return replace(model, contacts=(*(p for p in model.contacts if p.link not in rollers), *rolling))
