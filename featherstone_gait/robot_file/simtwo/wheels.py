"""Read <wheels> of SimTwo: cylinders on hinges of the first solid, with motors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from xml.etree.ElementTree import Element

from ...base.rotation import rotation_from_rpy
from ...model import Link
from ...model.rigid_bodies import inertia_tuple, turned_inertia
from ..markup import Read, children
from ..mjcf.tree import unused
from ..report import Report
from .expression import Numbers
from .motors import Parts, over, parts_of, servo_of, spring_of
from .solids import NOTHING, ROLLERS, ROLLING, Axis, Solid, attribute, cylinder, rolling

CONTROLLER: Parts = {
    "controller": Read("controller", {"kp": "0.5", "kf": "0.5"})
}  # defaults that differ from those of articulations
INHERITED = ("tyre", "surface", "offset", "omni")


def wheels_of(
    body: Element, numbers: Numbers, first: str, taken: list[str], report: Report
) -> list[tuple[Solid, Axis]]:
    """Read the valid wheels and report others; first: the solid that carries them; taken: names of other links."""
    found: list[tuple[Solid, Axis]] = []
    motor: Parts = CONTROLLER
    inherited: Parts = {}
    for element in (one for part in body.iterfind("wheels") for one in children(part, ("default", "wheel"))):
        parts, own = parts_of(element, "", motor), over(element, {tag: tag for tag in INHERITED}, inherited)
        if element.tag == "default":
            inherited, motor = own, parts
        else:
            with report.blaming(element):
                names = [*taken, *(solid.link.name for solid, _ in found)]
                name = attribute(element, "ID", "value", f"W{len(found) + 1}")
                found.append(_wheel(element, own, parts, numbers, (name, first, names)))
    return found


def _wheel(
    element: Element, own: Mapping[str, Element], parts: Parts, numbers: Numbers, named: tuple[str, str, list[str]]
) -> tuple[Solid, Axis]:
    """Make a wheel and its hinge; own: its properties with those of <default>; named: its name, its carrier, others.

    Its axis points inward, and it stands on the robot's plane z = 0 unless it is offset.
    """
    name, first, taken = named
    what = f"wheel {name!r}"
    tyre = own.get("tyre")
    defaults = (("mass", 0.13), ("radius", 0.09), ("width", 0.03), ("centerdist", 0.2))
    mass, radius, width, distance = (numbers.one(tyre, key, x, f"{what} <tyre>") for key, x in defaults)
    angle = math.radians(numbers.one(element.find("axis"), "angle", 0.0, f"{what} <axis>"))
    if not distance > 0:
        raise ValueError(f"{what}: centerdist is {distance!r} m; expected > 0, for the axis points to the center: "
                         "give the distance, or make it a cylinder with a hinge")  # fmt: skip
    offset, x, y = numbers.xyz(own.get("offset"), f"{what} <offset>"), math.cos(angle), math.sin(angle)
    place = (offset[0] + distance * x, offset[1] + distance * y, offset[2] + radius)
    geometry, (A, B, C), _ = cylinder(radius, width)
    rpy = (0.0, 0.5 * math.pi, angle)
    inertia = turned_inertia(rotation_from_rpy(rpy), (mass * A, 0.0, 0.0, mass * B, 0.0, mass * C))
    link = Link(unused(f"Tyre {round(math.degrees(angle))}", taken), mass, NOTHING, inertia_tuple(inertia))
    along, across = (
        numbers.one(own.get("surface"), key, x, f"{what} <surface>") for key, x in zip(("mu", "mu2"), ROLLING)
    )
    solid = Solid(link, place, rpy, geometry, along)
    if "omni" in own:
        solid = rolling(solid, radius, ROLLERS["omni"], along, across)
    servo, free = servo_of(parts, numbers, what)
    free |= spring_of(parts, numbers, what)
    stops = (-360.0, 360.0)
    return solid, Axis(name, "Hinge", first, link.name, place, (-x, -y, 0.0), stops, servo, free, element)
