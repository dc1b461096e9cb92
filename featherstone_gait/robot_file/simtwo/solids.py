"""Read solids of SimTwo: their shapes and masses, what a fluid does to them, and shells that are fixed to them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypeAlias
from xml.etree.ElementTree import Element

import numpy as np

from ...base.fixed_order import applied, product
from ...base.rotation import rotation_from_rpy, rpy_from_rotation
from ...model import ContactPoint, Immersed, Link, Propeller, Servo, Surface
from ...model.rigid_bodies import inertia_tuple, turned_inertia
from ...model.shapes import Box, Cylinder, Geometry, Sphere
from ..markup import Vector
from .differences import Differences
from .expression import Numbers, stated

NOTHING = (0.0, 0.0, 0.0)
AIR = 1.293  # [kg/m^3] density of the medium in SimTwo
BELT = (
    "its surface moves along its x axis at 0.5 m/s, as in SimTwo until a script sets its speed; command_surface and "
    "Session.command_surface set it here"
)
BELT_SPEED = 0.5  # [m/s] of SimTwo's belts, until a script sets another
TAKEN = "N s/rad, is along the axis of its joint {joint!r}, by its speed; SimTwo takes the solid's whole turning"
LOST = "N s/rad times its angular velocity, is left out: it is the outer body of no Hinge, whose speed would give it"
STEP = 1e-3  # [s] in which SimTwo takes the shares `stokes` and `roll` of the velocities away
ROLLERS = {"omni": 0.5 * math.pi, "mecanumleft": 0.25 * math.pi, "mecanumright": -0.25 * math.pi}  # angle [rad]
ROLLING = (1.0, 0.001)  # friction along and across rollers, unless a <surface> of <wheels> states it

Shaped: TypeAlias = tuple[Geometry, Vector, Vector]  # moments of inertia divided by the mass, and outlines [m^2]


class Solid(NamedTuple):
    """A rigid body, in the robot's frame."""

    link: Link  # in axes through its center, parallel to the robot's
    position: Vector
    rpy: Vector
    geometry: Geometry
    friction: float | None = None
    immersed: tuple[Immersed, ...] = ()  # about its center
    rollers: ContactPoint | None = None  # what touches the ground if it is a wheel with rollers, about its center
    surface: Surface | None = None  # of a belt
    thrust: float = 0.0  # of a propeller, by its angular velocity [N s/rad]


class Axis(NamedTuple):
    """A joint between two links, in the robot's frame."""

    name: str
    kind: str  # Hinge, Slider, Ball or Fixed
    parent: str
    child: str
    position: Vector
    direction: Vector
    limits: tuple[float, float]  # [deg or m]
    servo: Servo | None
    numbers: dict[str, Any]  # of Joint
    element: Element


def attribute(element: Element, tag: str, names: str, default: str) -> str:
    """Return the first of some attributes that a child has, or the default where there is none."""
    child = element.find(tag)
    name = stated(child, names)
    return default if child is None or name is None else child.get(name, default)


def angles_of(element: Element, numbers: Numbers, what: str) -> Vector:
    """Return angles about x, y and z [rad]: the rotation is Rz Ry Rx."""
    x, y, z = map(math.radians, numbers.xyz(element.find("rot_deg"), f"{what} <rot_deg>"))
    return x, y, z


def solid_of(element: Element, numbers: Numbers, unnamed: str = "", moves: bool = True) -> Solid:
    """Read a solid; raise ValueError for a wrong one.

    unnamed: name of one without an ID; moves: whether it moves by itself, else it has no mass unless it states one.
    """
    name, own = attribute(element, "ID", "value", unnamed), element.find("mass")
    what = f"solid {name!r}"
    mass = numbers.one(own, "value", 1.0 if moves else 0.0, f"{what} <mass>")
    geometry, (A, B, C), outlines = SHAPES[element.tag](element, numbers, what)
    rpy = angles_of(element, numbers, what)
    inertia: tuple[float, ...] = (mass * A, 0.0, 0.0, mass * B, 0.0, mass * C)
    if moves and stated(own, "I11"):
        names = ("I11", "I12", "I13", "I22", "I23", "I33")
        inertia = tuple(numbers.one(own, name, 0.0, f"{what} <mass>") for name in names)
    weightless = float(moves and element.find("nogravity") is not None)
    link = Link(name, mass, NOTHING, inertia_tuple(turned_inertia(rotation_from_rpy(rpy), inertia)), weightless)
    mu = numbers.one(element.find("surface"), "mu", -1.0, f"{what} <surface>")  # SimTwo's "not stated"
    solid = Solid(link, numbers.xyz(element.find("pos"), f"{what} <pos>"), rpy, geometry, mu if mu >= 0 else None)
    if not moves:
        return solid
    if element.tag == "belt":
        solid = solid._replace(surface=Surface(along_x(rpy), command=BELT_SPEED))
    if element.tag == "propeller":
        thrust = numbers.one(element.find("thrust"), "coefficient", 0.1, f"{what} <thrust>")
        solid = solid._replace(thrust=thrust)
    if isinstance(geometry, Cylinder) and (kind := attribute(element, "ID", "kind", "")) in ROLLERS:
        solid = rolling(solid, geometry.radius, ROLLERS[kind], *ROLLING)
    immersed = [*_drag(element, numbers, solid, inertia, outlines), *_buoyancy(element, numbers, solid)]
    return solid._replace(immersed=tuple(immersed))


def tell_driven(element: Element, solid: Solid, differences: Differences, axes: Sequence[Axis] = ()) -> list[Propeller]:
    """Add what drives a belt, and what turns a propeller; return the propeller of a joint, none without."""
    name = solid.link.name
    if element.tag == "belt":
        differences.add(element, f"<belt> {name!r}: {BELT}")
    if not solid.thrust:
        return []
    joint = next((axis.name for axis in axes if axis.child == name and axis.kind == "Hinge"), None)
    said = LOST if joint is None else TAKEN.format(joint=joint)
    differences.add(element, f"the thrust of <propeller> {name!r}, {solid.thrust:g} {said}", doubt=joint is None)
    return [] if joint is None else [Propeller(joint, 0.0, linear_thrust=solid.thrust)]


def along_x(rpy: Vector) -> Vector:
    """Return the x axis of a solid in axes parallel to the robot's; times a belt's command, the velocity in m/s."""
    x, y, z = rotation_from_rpy(rpy)[:, 0].tolist()
    return x, y, z


def rolling(solid: Solid, radius: float, angle: float, along: float, across: float) -> Solid:
    """Return a cylinder as a wheel with rollers; along and across their axes: coefficients of friction."""
    x, y, z = rotation_from_rpy(solid.rpy)[:, 2].tolist()
    point = ContactPoint(
        solid.link.name, NOTHING, circle_radius=radius, axis=(x, y, z), friction=along, roller_angle=angle,
        roller_friction=across,
    )  # fmt: skip
    return solid._replace(friction=along, rollers=point)


def _drag(
    element: Element, numbers: Numbers, solid: Solid, inertia: tuple[float, ...], outlines: Vector
) -> list[Immersed]:
    """Return the drag of a solid that states one: the shares of its velocities that a step takes away, and by squares.

    inertia: in the solid's axes.
    """
    own = element.find("drag")
    if own is None:
        return []
    what = f"solid {solid.link.name!r} <drag>"
    shares = (("coefficient", 0.0), ("stokes", 1e-5), ("roll", 1e-3))
    drag, linear, roll = (numbers.one(own, name, default, what) for name, default in shares)
    fifth, turning = _ball_radius(solid.geometry) ** 5, NOTHING
    if drag and fifth > 0:  # which it is not of the tiniest
        x, y, z = (outline * roll / fifth for outline in outlines)
        turning = (x, y, z)
    a, b, c = (inertia[k] * roll / STEP for k in (0, 3, 5))
    acting = Immersed(
        solid.link.name, solid.geometry, rpy=solid.rpy, drag=drag, turning_drag=turning, stokes=0.0,
        linear_damping=solid.link.mass * linear / STEP, turning_damping=(a, b, c), buoyant=False,
    )  # fmt: skip
    return [acting]


def _ball_radius(geometry: Geometry) -> float:
    """Return the radius of the ball of a shape's volume [m]."""
    match geometry:
        case Box():
            volume = math.prod(geometry.size)
        case Cylinder():
            volume = math.pi * geometry.radius**2 * geometry.length
        case _:
            return geometry.radius  # type: ignore[union-attr]
    return math.cbrt(0.75 * volume / math.pi)


def _buoyancy(element: Element, numbers: Numbers, solid: Solid) -> list[Immersed]:
    """Return what lifts a solid: a ball that displaces the stated mass, which is negative, of air."""
    found = []
    for tag in ("buoyant", "buoyance"):
        own = element.find(tag)
        if own is None:
            continue
        what = f"solid {solid.link.name!r} <{tag}>"
        mass = numbers.one(own, "mass", 0.0, what)
        if mass > 0:
            raise ValueError(f"{what}: mass is {mass!r} kg; expected <= 0, which lifts: change its sign, or add <mass>")
        if mass < 0:
            x, y, z = applied(rotation_from_rpy(solid.rpy), np.array(numbers.xyz(own, what))).tolist()
            ball = Sphere(math.cbrt(-0.75 * mass / (math.pi * AIR)))
            found.append(Immersed(solid.link.name, ball, (x, y, z), stokes=0.0))
    return found


def placed_in(mother: Solid, solid: Solid) -> Solid:
    """Return a solid that is stated in another's frame."""
    R = rotation_from_rpy(mother.rpy)

    def turned(vector: Vector) -> Vector:
        x, y, z = applied(R, np.array(vector)).tolist()
        return x, y, z

    x, y, z = (a + b for a, b in zip(mother.position, turned(solid.position)))
    rpy, rollers = rpy_from_rotation(product(R, rotation_from_rpy(solid.rpy))), solid.rollers
    return solid._replace(
        link=replace(solid.link, inertia=inertia_tuple(turned_inertia(R, solid.link.inertia))),
        position=(x, y, z),
        rpy=rpy,
        immersed=tuple(replace(one, xyz=turned(one.xyz), rpy=rpy) for one in solid.immersed),
        rollers=rollers and replace(rollers, axis=turned(rollers.axis)),
        surface=solid.surface and replace(solid.surface, velocity=along_x(rpy)),
    )


def shell_of(element: Element, numbers: Numbers, mother: Solid, name: str) -> tuple[Solid, Axis]:
    """Read a shell, which is fixed to a solid and placed in its frame."""
    shell = placed_in(mother, solid_of(element, numbers, name, moves=False))
    link = replace(shell.link, name=name, gravity_compensation=mother.link.gravity_compensation)
    axis = Axis(name, "Fixed", mother.link.name, name, shell.position, (1.0, 0.0, 0.0), NOTHING[:2], None, {}, element)
    return shell._replace(link=link), axis


def _cuboid(element: Element, numbers: Numbers, what: str) -> Shaped:
    x, y, z = numbers.xyz(element.find("size"), f"{what} <size>", (1.0, 1.0, 1.0))
    moments = ((y * y + z * z) / 12, (x * x + z * z) / 12, (x * x + y * y) / 12)
    return Box((x, y, z)), moments, (y * z, x * z, x * y)


def _cylinder(element: Element, numbers: Numbers, what: str) -> Shaped:
    size = element.find("size")
    r = numbers.one(size, "radius x", 1.0, f"{what} <size>")
    h = numbers.one(size, "z", 1.0, f"{what} <size>")
    return cylinder(r, h)


def cylinder(r: float, h: float) -> Shaped:
    """Return a cylinder of radius r and length h [m]."""
    across = (3 * r * r + h * h) / 12
    return Cylinder(r, h), (across, across, r * r / 2), (2 * r * h, 2 * r * h, math.pi * r * r)


def _sphere(element: Element, numbers: Numbers, what: str) -> Shaped:
    own = element.find("radius")
    if stated(own, "value"):
        r = numbers.one(own, "value", 1.0, f"{what} <radius>")
    else:
        r = numbers.one(element.find("size"), "radius", 1.0, f"{what} <size>")
    moment, outline = 0.4 * r * r, math.pi * r * r
    return Sphere(r), (moment, moment, moment), (outline, outline, outline)


SHAPES = {
    "cuboid": _cuboid, "cylinder": _cylinder, "sphere": _sphere, "belt": _cuboid, "propeller": _cuboid,
    "camera": _cuboid,
}  # fmt: skip
