"""Read a scene of SimTwo, or the file of one of its robots."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias
from xml.etree.ElementTree import Element

from ...base.rotation import rotation_from_rpy
from ...model import Base, Joint, Link, Servo
from ...model.rigid_bodies import inertia_tuple, turned_inertia
from ...model.shapes import Box, Cylinder, Geometry, Shape, Sphere
from ..markup import Vector, read_markup
from ..report import Report
from ..robot import MASSLESS, Posture, Robot
from .expression import Numbers, constants_of
from .motors import Parts, parts_of, servo_of, spring_of

WORLD = "world"
FULL_TURN = 180.0  # [deg] a stop at or beyond it stops nothing
TYPES = ("Hinge", "Slider", "Universal", "Fixed")
UNSUPPORTED = ("belt", "propeller")
NOTHING = (0.0, 0.0, 0.0)

Shaped: TypeAlias = tuple[Geometry, Vector]  # a shape, and its moments of inertia divided by its mass


class Solid(NamedTuple):
    """A rigid body, in the robot's frame."""

    link: Link  # in axes through its center, parallel to the robot's
    position: Vector
    rpy: Vector
    geometry: Geometry


class Axis(NamedTuple):
    """A joint between two links, in the robot's frame."""

    name: str
    kind: str  # Hinge, Slider or Fixed
    parent: str
    child: str
    position: Vector
    direction: Vector
    limits: tuple[float, float]  # [deg or m]
    servo: Servo | None
    spring: dict[str, Any]  # numbers of Joint
    element: Element


def read_simtwo(path: Path, root: Element, base: Base | None, report: Report, robot: Element | None = None) -> Robot:
    """Read a robot of a scene (<scene>), by default its only one, or a robot's file (<robot>).

    base: None is "fixed" if a joint holds the robot to the world, else "floating".  What is ignored goes into the
    report.  Raises ValueError for meaningless constants or scenes, RobotFileError for all that is wrong with the robot,
    with the lines of its file.
    """
    name, pose, file, body, constants = path.stem, (NOTHING, NOTHING), path, root, constants_of(root, {})
    if root.tag == "scene":
        robot = _only_robot(root) if robot is None else robot
        name, file = name_of(robot), _file_of(path, robot)
        outer = Numbers(constants)
        pose = outer.xyz(robot.find("pos"), "<pos>"), angles_of(robot, outer, "<robot>")
        body, report.lines, _ = read_markup(file)
        constants = constants_of(robot, constants)
    numbers = Numbers(constants_of(body, constants))
    solids = _solids(body, numbers, report)
    axes = _axes(body, numbers, report)
    origins = {axis.child: axis.position for axis in axes}  # of the frames of links that have a joint to their parent
    joints = []
    for axis in axes:
        with report.blaming(axis.element):
            joints.append(_joint(axis, origins.get(axis.parent, NOTHING)))
    _doubt(body, report)
    report.raise_problems(file)
    report.remark("skipped colors, shells, sensors, surfaces and drag of the scene")
    fixed = any(WORLD in (axis.parent, axis.child) for axis in axes)
    return _robot(name, pose, solids, axes, joints, base or ("fixed" if fixed else "floating"))


def _only_robot(root: Element) -> Element:
    """Return the one robot of a scene."""
    robots = root.findall("robot")
    if len(robots) != 1:
        names = ", ".join(name_of(robot) for robot in robots)
        raise ValueError(
            f"has {len(robots)} robots ({names}); expected one: remove the others, or load all of them with load_scene"
        )
    return robots[0]


def name_of(robot: Element) -> str:
    """Return the name of a robot of a scene."""
    return attribute(robot, "ID", "name", attribute(robot, "ID", "value", "robot"))


def _file_of(path: Path, robot: Element) -> Path:
    file = path.parent / attribute(robot, "body", "file", "")
    if not file.is_file():
        raise ValueError(
            f"robot {name_of(robot)!r}: there is no file {file.name!r} beside the scene; correct <body file=...>"
        )
    return file


def attribute(element: Element, tag: str, name: str, default: str) -> str:
    """Return an attribute of a child, or the default where there is none."""
    child = element.find(tag)
    return default if child is None else child.get(name, default)


def _all(root: Element, tag: str) -> list[Element]:
    return [child for part in root.iterfind(tag) for child in part]


def angles_of(element: Element, numbers: Numbers, what: str) -> Vector:
    """Return angles about x, y and z [rad]: the rotation is Rz Ry Rx."""
    x, y, z = map(math.radians, numbers.xyz(element.find("rot_deg"), f"{what} <rot_deg>"))
    return x, y, z


# ---------------------------------------------------------------------------------------------- solids


def _solids(body: Element, numbers: Numbers, report: Report) -> list[Solid]:
    """Read the valid solids; report what is wrong with others, and what is no rigid body."""
    solids, elements = [], _all(body, "solids")
    for element in elements:
        if element.tag in UNSUPPORTED:
            report.refuse(element, f"<{element.tag}> is not supported; remove it")
        if element.find("solid") is not None:
            name = attribute(element, "ID", "value", "")
            report.refuse(element, f"solid {name!r} is placed in another's frame; give its place in the robot's")
        if element.tag in SHAPES:
            with report.blaming(element):
                solids.append(solid_of(element, numbers))
    if not any(element.tag in SHAPES for element in elements):
        report.refuse(body, "there is no solid; a robot needs one: give the file that has <solids>")
    for wheel in body.findall("wheels/*"):
        report.refuse(wheel, "<wheels> are not supported; describe them as cylinders with hinges")
    return solids


def solid_of(element: Element, numbers: Numbers, unnamed: str = "") -> Solid:
    """Read a solid; raise ValueError for a wrong one.  unnamed: name of one without an ID."""
    name, stated = attribute(element, "ID", "value", unnamed), element.find("mass")
    what = f"solid {name!r}"
    mass = numbers.one(stated, "value", 1.0, f"{what} <mass>")
    geometry, (A, B, C) = SHAPES[element.tag](element, numbers, what)
    rpy = angles_of(element, numbers, what)
    inertia: tuple[float, ...] = (mass * A, 0.0, 0.0, mass * B, 0.0, mass * C)
    if stated is not None and "I11" in stated.attrib:
        names = ("I11", "I12", "I13", "I22", "I23", "I33")
        inertia = tuple(numbers.one(stated, name, 0.0, f"{what} <mass>") for name in names)
    link = Link(name, mass, NOTHING, inertia_tuple(turned_inertia(rotation_from_rpy(rpy), inertia)))
    return Solid(link, numbers.xyz(element.find("pos"), f"{what} <pos>"), rpy, geometry)


def _cuboid(element: Element, numbers: Numbers, what: str) -> Shaped:
    x, y, z = numbers.xyz(element.find("size"), f"{what} <size>", (1.0, 1.0, 1.0))
    return Box((x, y, z)), ((y * y + z * z) / 12, (x * x + z * z) / 12, (x * x + y * y) / 12)


def _cylinder(element: Element, numbers: Numbers, what: str) -> Shaped:
    size = element.find("size")
    r = numbers.one(size, "radius", numbers.one(size, "x", 1.0, f"{what} <size>"), f"{what} <size>")
    h = numbers.one(size, "z", 1.0, f"{what} <size>")
    across = (3 * r * r + h * h) / 12
    return Cylinder(r, h), (across, across, r * r / 2)


def _sphere(element: Element, numbers: Numbers, what: str) -> Shaped:
    size = numbers.one(element.find("size"), "radius", 1.0, f"{what} <size>")
    r = numbers.one(element.find("radius"), "value", size, f"{what} <radius>")
    return Sphere(r), (0.4 * r * r, 0.4 * r * r, 0.4 * r * r)


SHAPES = {"cuboid": _cuboid, "cylinder": _cylinder, "sphere": _sphere}


# ---------------------------------------------------------------------------------------------- articulations


def _axes(body: Element, numbers: Numbers, report: Report) -> list[Axis]:
    """Read the axes of all valid articulations, each from the link nearer to the root; report others."""
    names = [attribute(element, "ID", "value", "") for element in _all(body, "solids") if element.tag in SHAPES]
    ends: dict[int, tuple[str, str]] = {}
    found: list[tuple[Element, list[Parts]]] = []  # joints, with their motors' parts over those of the last <default>
    inherited: list[Parts] = [{}, {}]
    for element in _all(body, "articulations"):
        parts = [parts_of(element, suffix, defaults) for suffix, defaults in zip(("", "2"), inherited)]
        if element.tag == "default":
            inherited = parts
        elif element.tag == "joint":
            found.append((element, parts))
            with report.blaming(element):
                ends[len(found) - 1] = _ends(element, names)
    axes: list[Axis] = []
    reached = {WORLD if any(WORLD in pair for pair in ends.values()) else (names or [""])[0]}
    while ends:  # outward from the root, then those that nothing joins to it
        k = next((k for k, pair in ends.items() if reached & {*pair}), next(iter(ends)))
        first, second = pair = ends.pop(k)
        element, parts = found[k]
        with report.blaming(element):
            axes += _axes_of(element, parts, numbers, pair, second if second in reached else first)
        reached |= {*pair}
    return axes


def _ends(element: Element, names: list[str]) -> tuple[str, str]:
    """Return the two bodies of a joint, first the one that its angle belongs to."""
    what = f"joint {attribute(element, 'ID', 'value', '')!r}"
    given = [attribute(element, "connect", f"B{k}", attribute(element, "connect", f"S{k}", "")) for k in (1, 2)]
    first, second = (WORLD if name in ("0", WORLD) and name not in names else name for name in given)
    for name in (first, second):
        if name not in (*names, WORLD):
            raise ValueError(
                f"{what}: there is no solid {name!r}; expected one of {', '.join(names)}: correct <connect>"
            )
    return (second, first) if first == WORLD else (first, second)


def _axes_of(
    element: Element, parts: list[Parts], numbers: Numbers, ends: tuple[str, str], parent: str
) -> Iterator[Axis]:
    """Yield one axis, or the two of a universal joint with a massless frame between them.

    An angle is that of the first body against the second, so its sign changes if the first one is the parent.
    """
    name, kind = attribute(element, "ID", "value", ""), attribute(element, "type", "value", "")
    what = f"joint {name!r}"
    if kind not in TYPES:
        raise ValueError(
            f"{what}: type {kind!r} is not supported; expected one of {', '.join(TYPES)}: use one of these"
        )
    first, second = ends
    child, sign = (second, -1.0) if parent == first else (first, 1.0)
    place = numbers.xyz(element.find("pos"), f"{what} <pos>")
    if kind != "Universal":
        direction, limits, servo, spring = _motion(element, parts[0], numbers, "", what)
        yield Axis(name, kind, parent, child, place, _scaled(direction, sign, what), limits, servo, spring, element)
        return
    middle, order = f"{name}_cross", ("", "2") if parent == first else ("2", "")
    for suffix, ends_here in zip(order, ((parent, middle), (middle, child))):
        direction, limits, servo, spring = _motion(element, parts[suffix == "2"], numbers, suffix, what)
        joint = f"{name}_2" if suffix else name
        yield Axis(joint, "Hinge", *ends_here, place, _scaled(direction, sign, what), limits, servo, spring, element)


def _motion(
    element: Element, parts: Parts, numbers: Numbers, suffix: str, what: str
) -> tuple[Vector, tuple[float, float], Servo | None, dict[str, Any]]:
    """Return direction, limits, servo and spring of an axis; suffix: "2" for the second one of a universal joint."""
    default = (0.0, 0.0, 1.0) if suffix else (1.0, 0.0, 0.0)
    direction = numbers.xyz(element.find(f"axis{suffix}"), f"{what} <axis{suffix}>", default)
    stops = element.find(f"limits{suffix}")
    limits = tuple(numbers.one(stops, end, v, f"{what} <limits>") for end, v in (("Min", -360.0), ("Max", 360.0)))
    return direction, (limits[0], limits[1]), servo_of(parts, numbers, what), spring_of(parts, numbers, what)


def _scaled(direction: tuple[float, ...], sign: float, what: str) -> Vector:
    length = math.hypot(*direction)
    if not length > 0:
        raise ValueError(f"{what}: axis {direction!r} has no length; give a direction such as 0 0 1")
    x, y, z = (sign * x / length + 0.0 for x in direction)
    return x, y, z


# ---------------------------------------------------------------------------------------------- the robot


def _robot(
    name: str, pose: tuple[Vector, Vector], solids: list[Solid], axes: list[Axis], joints: list[Joint], base: Base
) -> Robot:
    """Build links with their frames at their joints, parallel to the robot's."""
    origins = {axis.child: axis.position for axis in axes}
    places = [(solid, _minus(solid.position, origins.get(solid.link.name, NOTHING))) for solid in solids]
    links = [replace(solid.link, center_of_mass=place) for solid, place in places]
    known = {solid.link.name for solid in solids}
    frames = [end for axis in axes for end in (axis.parent, axis.child) if end not in known]
    links += [Link(frame, **MASSLESS) for frame in dict.fromkeys(frames)]
    start = (*pose[0], *quaternion_from_rpy(pose[1]))
    return Robot(
        name=name,
        links=tuple(links),
        joints=tuple(joints),
        base=base,
        servos={axis.name: axis.servo for axis in axes if axis.servo is not None and axis.kind != "Fixed"},
        shapes=tuple(Shape(solid.link.name, solid.geometry, place, solid.rpy) for solid, place in places),
        postures={"scene": Posture(start, {joint.name: 0.0 for joint in joints if joint.type != "fixed"})},
    )


def _joint(axis: Axis, origin: Vector) -> Joint:
    joint = Joint(axis.name, "fixed", axis.parent, axis.child, _minus(axis.position, origin))
    if axis.kind == "Fixed":
        return joint
    joint = replace(joint, **axis.spring)
    lower, upper = axis.limits
    if lower > upper:
        unit = "m" if axis.kind == "Slider" else "deg"
        raise ValueError(
            f"joint {axis.name!r}: <limits> have Min {lower!r} {unit}, Max {upper!r} {unit}; Min must be below Max: "
            "swap them"
        )
    lower, upper = (x if abs(x) < FULL_TURN else math.copysign(math.inf, x) for x in axis.limits)
    if axis.kind == "Slider":
        return replace(joint, type="prismatic", axis=axis.direction, lower=lower, upper=upper)
    if (lower, upper) == (-math.inf, math.inf):
        return replace(joint, type="continuous", axis=axis.direction)
    lower, upper = math.radians(lower), math.radians(upper)
    return replace(joint, type="revolute", axis=axis.direction, lower=lower, upper=upper)


def _minus(a: tuple[float, ...], b: tuple[float, ...]) -> Vector:
    x, y, z = (p - q for p, q in zip(a, b))
    return x, y, z


def quaternion_from_rpy(rpy: tuple[float, ...]) -> tuple[float, float, float, float]:
    """Compute the quaternion w x y z of roll, pitch and yaw [rad]."""
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(angle / 2), math.sin(angle / 2)) for angle in rpy)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def _doubt(body: Element, report: Report) -> None:
    """Report what changes the motion and is ignored."""
    for tag in sorted({e.tag for e in _all(body, "solids") if e.tag not in (*SHAPES, *UNSUPPORTED)}):
        report.doubt(f"ignored <{tag}> in <solids>, which is no known solid")
