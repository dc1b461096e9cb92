"""Read a scene of SimTwo, or the file of one of its robots."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element

from ...base.rotation import rotation_from_rpy
from ...model import Base, Joint, Link, Servo
from ...model.rigid_bodies import inertia_tuple, turned_inertia
from ...model.shapes import Box, Cylinder, Geometry, Shape, Sphere
from ..markup import Markup, read_markup
from ..report import Report
from ..robot import Posture, Robot
from .expression import Numbers, constants_of
from .motors import parts_of, servo_of

WORLD = "world"
FULL_TURN = 180.0  # [deg] a stop at or beyond it stops nothing
TYPES = ("Hinge", "Slider", "Universal", "Fixed")
UNSUPPORTED = ("belt", "propeller")
NOTHING = (0.0, 0.0, 0.0)


class Solid(NamedTuple):
    """A rigid body, in the robot's frame."""

    link: Link  # in axes through its center, parallel to the robot's
    position: tuple[float, float, float]
    rpy: tuple[float, float, float]
    geometry: Geometry


class Axis(NamedTuple):
    """A joint between two links, in the robot's frame."""

    name: str
    kind: str  # Hinge, Slider or Fixed
    parent: str
    child: str
    position: tuple[float, float, float]
    direction: tuple[float, float, float]
    limits: tuple[float, float]  # [deg or m]
    servo: Servo | None
    element: Element


def read_simtwo(path: Path, root: Element, base: Base | None, report: Report) -> Robot:
    """Read the robot of a scene (<scene>), or a robot's file (<robot>).

    base: None is "fixed" if a joint holds the robot to the world, else "floating".  What is ignored goes into the
    report.  Raises ValueError for meaningless constants or scenes, RobotFileError for all that is wrong with the robot,
    with the lines of its file.
    """
    scene = _Scene(path.stem, (NOTHING, NOTHING), path, Markup(root, dict(report.lines)), constants_of(root, {}))
    if root.tag == "scene":
        scene = _of_scene(path, root, scene.constants)
        report.lines = scene.markup.lines
    body = scene.markup.root
    numbers = Numbers(constants_of(body, scene.constants))
    solids = _solids(body, numbers, report)
    axes = _axes(body, numbers, report)
    joints = _joints(axes, report)
    for sentence in _doubts(body, numbers, report):
        report.doubt(sentence)
    report.raise_problems(scene.file)
    report.remark("skipped colors, shells, sensors, surfaces and drag of the scene")
    fixed = any(WORLD in (axis.parent, axis.child) for axis in axes)
    return _robot(scene, solids, axes, joints, base or ("fixed" if fixed else "floating"))


class _Scene(NamedTuple):
    """The robot of a scene."""

    name: str
    pose: tuple  # position and angles
    file: Path
    markup: Markup
    constants: dict[str, float]


def _of_scene(path: Path, root: Element, constants: dict[str, float]) -> _Scene:
    """Return the one robot of a scene."""
    robots = [element for element in root.iterfind("robot")]
    names = [_attribute(robot, "ID", "name", _attribute(robot, "ID", "value", "robot")) for robot in robots]
    if len(robots) != 1:
        raise ValueError(f"has {len(robots)} robots ({', '.join(names)}); expected one: remove the others")
    robot, numbers = robots[0], Numbers(constants)
    file = path.parent / _attribute(robot, "body", "file", "")
    if not file.is_file():
        raise ValueError(
            f"robot {names[0]!r}: there is no file {file.name!r} beside the scene; correct <body file=...>"
        )
    pose = numbers.xyz(robot.find("pos"), "<pos>"), _angles(robot, numbers, "<robot>")
    return _Scene(names[0], pose, file, read_markup(file), constants_of(robot, constants))


def _attribute(element: Element, tag: str, name: str, default: str) -> str:
    child = element.find(tag)
    return default if child is None else child.get(name, default)


def _all(root: Element, tag: str) -> list[Element]:
    return [child for part in root.iterfind(tag) for child in part]


def _angles(element: Element, numbers: Numbers, what: str) -> tuple[float, ...]:
    """Return angles about x, y and z [rad]: the rotation is Rz Ry Rx."""
    return tuple(math.radians(angle) for angle in numbers.xyz(element.find("rot_deg"), f"{what} <rot_deg>"))


# ---------------------------------------------------------------------------------------------- solids


def _solids(body: Element, numbers: Numbers, report: Report) -> list[Solid]:
    """Read the valid solids; report what is wrong with others."""
    _check_solids(body, report)
    solids = []
    for element in _all(body, "solids"):
        if element.tag in SHAPES:
            with report.blaming(element):
                solids.append(_solid(element, numbers))
    return solids


def _solid(element: Element, numbers: Numbers) -> Solid:
    name = _attribute(element, "ID", "value", "")
    what = f"solid {name!r}"
    mass = numbers.one(element.find("mass"), "value", 1.0, f"{what} <mass>")
    geometry, moments = SHAPES[element.tag](element, numbers, what)
    x, y, z = _angles(element, numbers, what)
    stated = element.find("mass")
    if stated is not None and "I11" in stated.attrib:
        names = ("I11", "I12", "I13", "I22", "I23", "I33")
        principal = tuple(numbers.one(stated, name, 0.0, f"{what} <mass>") for name in names)
    else:
        principal = (mass * moments[0], 0.0, 0.0, mass * moments[1], 0.0, mass * moments[2])
    I = turned_inertia(rotation_from_rpy((x, y, z)), principal)
    link = Link(name, mass, NOTHING, inertia_tuple(I))
    return Solid(link, numbers.xyz(element.find("pos"), f"{what} <pos>"), (x, y, z), geometry)


def _cuboid(element: Element, numbers: Numbers, what: str) -> tuple[Geometry, tuple[float, float, float]]:
    """Return a box, and its moments of inertia divided by its mass."""
    x, y, z = numbers.xyz(element.find("size"), f"{what} <size>", (1.0, 1.0, 1.0))
    return Box((x, y, z)), ((y * y + z * z) / 12, (x * x + z * z) / 12, (x * x + y * y) / 12)


def _cylinder(element: Element, numbers: Numbers, what: str) -> tuple[Geometry, tuple[float, float, float]]:
    size = element.find("size")
    r = numbers.one(size, "radius", numbers.one(size, "x", 1.0, f"{what} <size>"), f"{what} <size>")
    h = numbers.one(size, "z", 1.0, f"{what} <size>")
    across = (3 * r * r + h * h) / 12
    return Cylinder(r, h), (across, across, r * r / 2)


def _sphere(element: Element, numbers: Numbers, what: str) -> tuple[Geometry, tuple[float, float, float]]:
    size = numbers.one(element.find("size"), "radius", 1.0, f"{what} <size>")
    r = numbers.one(element.find("radius"), "value", size, f"{what} <radius>")
    return Sphere(r), (0.4 * r * r, 0.4 * r * r, 0.4 * r * r)


SHAPES = {"cuboid": _cuboid, "cylinder": _cylinder, "sphere": _sphere}


def _check_solids(body: Element, report: Report) -> None:
    """Report what is no rigid body."""
    elements = _all(body, "solids")
    for element in elements:
        if element.tag in UNSUPPORTED:
            report.refuse(element, f"<{element.tag}> is not supported; remove it")
        if element.find("solid") is not None:
            name = _attribute(element, "ID", "value", "")
            report.refuse(element, f"solid {name!r} is placed in another's frame; give its place in the robot's")
    if not any(element.tag in SHAPES for element in elements):
        report.refuse(body, "there is no solid; a robot needs one: give the file that has <solids>")
    for wheel in body.findall("wheels/*"):
        report.refuse(wheel, "<wheels> are not supported; describe them as cylinders with hinges")


# ---------------------------------------------------------------------------------------------- articulations


def _axes(body: Element, numbers: Numbers, report: Report) -> list[Axis]:
    """Read the axes of all valid articulations, each from the link nearer to the root; report others."""
    names = [_attribute(element, "ID", "value", "") for element in _all(body, "solids") if element.tag in SHAPES]
    ends: dict[int, tuple[str, str]] = {}
    found = _articulations(body)
    for k, (element, _) in enumerate(found):
        with report.blaming(element):
            ends[k] = _ends(element, names)
    axes: list[Axis] = []
    for k, parent in _outwards(ends, WORLD if any(WORLD in pair for pair in ends.values()) else (names or [""])[0]):
        element, parts = found[k]
        with report.blaming(element):
            axes += _axes_of(element, parts, numbers, ends[k], parent)
    return axes


def _articulations(body: Element) -> list[tuple[Element, list[dict[str, dict[str, str]]]]]:
    """Return the joints, each with its motors' parts over those of the last <default>."""
    inherited: list[dict[str, dict[str, str]]] = [{}, {}]
    found = []
    for element in _all(body, "articulations"):
        parts = [parts_of(element, suffix, defaults) for suffix, defaults in zip(("", "2"), inherited)]
        if element.tag == "default":
            inherited = parts
        elif element.tag == "joint":
            found.append((element, parts))
    return found


def _ends(element: Element, names: list[str]) -> tuple[str, str]:
    """Return the two bodies of a joint, first the one that its angle belongs to."""
    what = f"joint {_attribute(element, 'ID', 'value', '')!r}"
    given = [_attribute(element, "connect", f"B{k}", _attribute(element, "connect", f"S{k}", "")) for k in (1, 2)]
    first, second = (WORLD if name in ("0", WORLD) and name not in names else name for name in given)
    for name in (first, second):
        if name not in (*names, WORLD):
            raise ValueError(
                f"{what}: there is no solid {name!r}; expected one of {', '.join(names)}: correct <connect>"
            )
    return (second, first) if first == WORLD else (first, second)


def _outwards(ends: Mapping[int, tuple[str, str]], root: str) -> Iterator[tuple[int, str]]:
    """Yield joints outward from the root, each with its parent; then those that nothing joins to it."""
    reached, waiting = {root}, dict(ends)
    while waiting:
        near = [k for k, pair in waiting.items() if reached & {*pair}]
        k = near[0] if near else next(iter(waiting))
        first, second = waiting.pop(k)
        parent = second if second in reached else first
        reached |= {first, second}
        yield k, parent


def _axes_of(
    element: Element, parts: list[dict[str, dict[str, str]]], numbers: Numbers, ends: tuple[str, str], parent: str
) -> Iterator[Axis]:
    """Yield one axis, or the two of a universal joint with a massless frame between them.

    An angle is that of the first body against the second, so its sign changes if the first one is the parent.
    """
    name, kind = _attribute(element, "ID", "value", ""), _attribute(element, "type", "value", "")
    what = f"joint {name!r}"
    if kind not in TYPES:
        raise ValueError(
            f"{what}: type {kind!r} is not supported; expected one of {', '.join(TYPES)}: use one of these"
        )
    first, second = ends
    child, sign = (second, -1.0) if parent == first else (first, 1.0)
    place = numbers.xyz(element.find("pos"), f"{what} <pos>")
    if kind != "Universal":
        direction, limits, servo = _motion(element, parts[0], numbers, "", what)
        yield Axis(name, kind, parent, child, place, _scaled(direction, sign, what), limits, servo, element)
        return
    middle, order = f"{name}_cross", ("", "2") if parent == first else ("2", "")
    for suffix, ends_here in zip(order, ((parent, middle), (middle, child))):
        direction, limits, servo = _motion(element, parts[suffix == "2"], numbers, suffix, what)
        joint = f"{name}_2" if suffix else name
        yield Axis(joint, "Hinge", *ends_here, place, _scaled(direction, sign, what), limits, servo, element)


def _motion(
    element: Element, parts: Mapping[str, dict[str, str]], numbers: Numbers, suffix: str, what: str
) -> tuple[tuple[float, float, float], tuple[float, float], Servo | None]:
    """Return direction, limits and servo of an axis; suffix: "2" for the second one of a universal joint."""
    default = (0.0, 0.0, 1.0) if suffix else (1.0, 0.0, 0.0)
    direction = numbers.xyz(element.find(f"axis{suffix}"), f"{what} <axis{suffix}>", default)
    stops = element.find(f"limits{suffix}")
    limits = tuple(numbers.one(stops, end, v, f"{what} <limits>") for end, v in (("Min", -360.0), ("Max", 360.0)))
    return direction, (limits[0], limits[1]), servo_of(parts, numbers, what)


def _scaled(direction: tuple[float, ...], sign: float, what: str) -> tuple[float, float, float]:
    length = math.hypot(*direction)
    if not length > 0:
        raise ValueError(f"{what}: axis {direction!r} has no length; give a direction such as 0 0 1")
    x, y, z = (sign * x / length + 0.0 for x in direction)
    return x, y, z


# ---------------------------------------------------------------------------------------------- the robot


def _robot(scene: _Scene, solids: list[Solid], axes: list[Axis], joints: tuple[Joint, ...], base: Base) -> Robot:
    """Build links with their frames at their joints, parallel to the robot's."""
    origins = _origins(axes)
    places = [(solid, _minus(solid.position, origins.get(solid.link.name, NOTHING))) for solid in solids]
    links = [replace(solid.link, center_of_mass=place) for solid, place in places]
    known = {solid.link.name for solid in solids}
    frames = [end for axis in axes for end in (axis.parent, axis.child) if end not in known]
    links += [Link(frame, 0.0, NOTHING, (0.0,) * 6) for frame in dict.fromkeys(frames)]
    position, angles = scene.pose
    start = Posture((*position, *_quaternion(angles)), {joint.name: 0.0 for joint in joints if joint.type != "fixed"})
    return Robot(
        name=scene.name,
        links=tuple(links),
        joints=joints,
        base=base,
        servos={axis.name: axis.servo for axis in axes if axis.servo is not None and axis.kind != "Fixed"},
        shapes=tuple(Shape(solid.link.name, solid.geometry, place, solid.rpy) for solid, place in places),
        postures={"scene": start},
    )


def _origins(axes: list[Axis]) -> dict[str, tuple[float, float, float]]:
    """Return where the frames of links are that have a joint to their parent."""
    return {axis.child: axis.position for axis in axes}


def _joints(axes: list[Axis], report: Report) -> tuple[Joint, ...]:
    """Build the valid joints; report what is wrong with others."""
    origins, joints = _origins(axes), []
    for axis in axes:
        with report.blaming(axis.element):
            joints.append(_joint(axis, origins.get(axis.parent, NOTHING)))
    return tuple(joints)


def _joint(axis: Axis, origin: tuple[float, float, float]) -> Joint:
    xyz, ends = _minus(axis.position, origin), (axis.parent, axis.child)
    if axis.kind == "Fixed":
        return Joint(axis.name, "fixed", *ends, xyz)
    _check_limits(axis)
    stops = [x if abs(x) < FULL_TURN else math.copysign(math.inf, x) for x in axis.limits]
    if axis.kind == "Slider":
        return Joint(axis.name, "prismatic", *ends, xyz, axis=axis.direction, lower=stops[0], upper=stops[1])
    if stops == [-math.inf, math.inf]:
        return Joint(axis.name, "continuous", *ends, xyz, axis=axis.direction)
    lower, upper = (math.radians(x) for x in stops)
    return Joint(axis.name, "revolute", *ends, xyz, axis=axis.direction, lower=lower, upper=upper)


def _check_limits(axis: Axis) -> None:
    lower, upper = axis.limits
    if lower > upper:
        unit = "m" if axis.kind == "Slider" else "deg"
        raise ValueError(
            f"joint {axis.name!r}: <limits> have Min {lower!r} {unit}, Max {upper!r} {unit}; Min must be below Max: "
            "swap them"
        )


def _minus(a: tuple[float, ...], b: tuple[float, ...]) -> tuple[float, float, float]:
    x, y, z = (p - q for p, q in zip(a, b))
    return x, y, z


def _quaternion(rpy: tuple[float, ...]) -> tuple[float, float, float, float]:
    """Compute the quaternion w x y z of roll, pitch and yaw [rad]."""
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(angle / 2), math.sin(angle / 2)) for angle in rpy)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def _doubts(body: Element, numbers: Numbers, report: Report) -> list[str]:
    """Return what changes the motion and is ignored."""
    stiffnesses = []
    for element in body.iter():
        if element.tag in ("spring", "spring2"):
            with report.blaming(element):
                stiffnesses.append(numbers.one(element, "k", 0.0, f"<{element.tag}>"))
    unknown = sorted({e.tag for e in _all(body, "solids") if e.tag not in (*SHAPES, *UNSUPPORTED)})
    found = ["ignored the springs of axes: not supported"] if any(stiffnesses) else []
    return found + [f"ignored <{tag}> in <solids>, which is no known solid" for tag in unknown]
