"""Reading a scene of SimTwo, or the file of one of its robots."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element

from ...model import Base, Joint, Link, Servo, turned_inertia
from ...rotation import rotation_from_rpy
from ...shape import Box, Cylinder, Geometry, Shape, Sphere
from ..errors import refusal
from ..markup import read_markup
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

    name: str
    mass: float
    position: tuple[float, float, float]
    rpy: tuple[float, float, float]
    geometry: Geometry
    inertia: tuple[float, ...]  # about its centre, in the robot's axes


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


def read_simtwo(path: Path, root: Element, base: Base | None) -> Robot:
    """Read the robot of a scene (<scene>), or a robot's file (<robot>).

    base : None is "fixed" if a joint holds the robot to the world, else "floating"

    Raises ValueError for what has no meaning, RobotFileError for all that the simulator cannot do.
    """
    name, pose, body, constants = path.stem, (NOTHING, NOTHING), root, constants_of(root, {})
    if root.tag == "scene":
        name, pose, body, constants = _of_scene(path, root, constants)
    numbers = Numbers(constants_of(body, constants))
    solids = [_solid(element, numbers) for element in _all(body, "solids") if element.tag in SHAPES]
    _check_solids(path, body, solids)
    axes = list(_axes(body, numbers, [solid.name for solid in solids]))
    fixed = any(WORLD in (axis.parent, axis.child) for axis in axes)
    return _robot(name, solids, axes, base or ("fixed" if fixed else "floating"), pose, _doubts(body, numbers))


def _of_scene(path: Path, root: Element, constants: dict[str, float]) -> tuple[str, tuple, Element, dict[str, float]]:
    """Name, position and angles, file and constants of the one robot of a scene."""
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
    return names[0], pose, read_markup(file).root, constants_of(robot, constants)


def _attribute(element: Element, tag: str, name: str, default: str) -> str:
    child = element.find(tag)
    return default if child is None else child.get(name, default)


def _all(root: Element, tag: str) -> list[Element]:
    return [child for part in root.iterfind(tag) for child in part]


def _angles(element: Element, numbers: Numbers, what: str) -> tuple[float, ...]:
    """Angles about x, y and z [rad]: the rotation is Rz Ry Rx."""
    return tuple(math.radians(angle) for angle in numbers.xyz(element.find("rot_deg"), f"{what} <rot_deg>"))


# ---------------------------------------------------------------------------------------------- solids


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
    inertia = tuple(((I + I.T) / 2)[(0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2)].tolist())
    return Solid(name, mass, numbers.xyz(element.find("pos"), f"{what} <pos>"), (x, y, z), geometry, inertia)


def _cuboid(element: Element, numbers: Numbers, what: str) -> tuple[Geometry, tuple[float, float, float]]:
    """A box, and its moments of inertia by its mass."""
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


def _check_solids(path: Path, body: Element, solids: list[Solid]) -> None:
    """Refuse what is no rigid body, all at once."""
    elements = _all(body, "solids")
    strange = sorted({element.tag for element in elements if element.tag in UNSUPPORTED})
    problems = [f"<{tag}> has no like here; remove it" for tag in strange]
    hung = [_attribute(element, "ID", "value", "") for element in elements if element.find("solid") is not None]
    problems += [f"solid {name!r} is placed in another's frame; give its place in the robot's" for name in hung]
    if not solids:
        problems.append("there is no solid; a robot needs one: give the file that has <solids>")
    if body.find("wheels") is not None and len(body.findall("wheels/*")):
        problems.append("<wheels> have no like here; describe them as cylinders with hinges")
    if problems:
        raise refusal(path, problems)


# ---------------------------------------------------------------------------------------------- articulations


def _axes(body: Element, numbers: Numbers, names: list[str]) -> Iterator[Axis]:
    """The axes of all articulations, each from the link nearer to the root."""
    inherited: list[dict[str, dict[str, str]]] = [{}, {}]
    found = []
    for element in _all(body, "articulations"):
        parts = [parts_of(element, suffix, defaults) for suffix, defaults in zip(("", "2"), inherited)]
        if element.tag == "default":
            inherited = parts
        elif element.tag == "joint":
            found.append((element, parts))
    ends = [_ends(element, names) for element, _ in found]
    order = _outwards(ends, WORLD if any(WORLD in pair for pair in ends) else names[0] if names else "")
    for k, parent in order:
        element, parts = found[k]
        yield from _axes_of(element, parts, numbers, ends[k], parent)


def _ends(element: Element, names: list[str]) -> tuple[str, str]:
    """The two bodies of a joint, the first being the one that its angle belongs to."""
    what = f"joint {_attribute(element, 'ID', 'value', '')!r}"
    given = [_attribute(element, "connect", f"B{k}", _attribute(element, "connect", f"S{k}", "")) for k in (1, 2)]
    first, second = (WORLD if name in ("0", WORLD) and name not in names else name for name in given)
    for name in (first, second):
        if name not in (*names, WORLD):
            raise ValueError(
                f"{what}: there is no solid {name!r}; expected one of {', '.join(names)}: correct <connect>"
            )
    return (second, first) if first == WORLD else (first, second)


def _outwards(ends: list[tuple[str, str]], root: str) -> Iterator[tuple[int, str]]:
    """Joints in an order that begins at the root, each with its parent; then those that nothing joins to it."""
    reached, waiting = {root}, dict(enumerate(ends))
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
    """One axis, or the two of a universal joint with a frame without mass between them.

    An angle is that of the first body against the second, so that it counts the other way round where the first one is
    the parent.
    """
    name, kind = _attribute(element, "ID", "value", ""), _attribute(element, "type", "value", "")
    what = f"joint {name!r}"
    if kind not in TYPES:
        raise ValueError(
            f"{what}: type {kind!r} has no like here; expected one of {', '.join(TYPES)}: use one of these"
        )
    first, second = ends
    child, sign = (second, -1.0) if parent == first else (first, 1.0)
    place = numbers.xyz(element.find("pos"), f"{what} <pos>")
    if kind != "Universal":
        direction, limits, servo = _motion(element, parts[0], numbers, "", what)
        yield Axis(name, kind, parent, child, place, _scaled(direction, sign, what), limits, servo)
        return
    middle, order = f"{name}_cross", ("", "2") if parent == first else ("2", "")
    for suffix, ends_here in zip(order, ((parent, middle), (middle, child))):
        direction, limits, servo = _motion(element, parts[suffix == "2"], numbers, suffix, what)
        joint = f"{name}_2" if suffix else name
        yield Axis(joint, "Hinge", *ends_here, place, _scaled(direction, sign, what), limits, servo)


def _motion(
    element: Element, parts: Mapping[str, dict[str, str]], numbers: Numbers, suffix: str, what: str
) -> tuple[tuple[float, float, float], tuple[float, float], Servo | None]:
    """Direction, limits and servo of an axis; suffix: "2" for the second one of a universal joint."""
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


def _robot(name: str, solids: list[Solid], axes: list[Axis], base: Base, pose: tuple, doubts: list[str]) -> Robot:
    """Links with their frames at their joints, parallel to the robot's."""
    origins = {axis.child: axis.position for axis in axes}
    links = [_link(solid, origins.get(solid.name, NOTHING)) for solid in solids]
    known = {solid.name for solid in solids}
    frames = [end for axis in axes for end in (axis.parent, axis.child) if end not in known]
    links += [Link(frame, 0.0, NOTHING, (0.0,) * 6) for frame in dict.fromkeys(frames)]
    joints = tuple(_joint(axis, origins.get(axis.parent, NOTHING)) for axis in axes)
    shapes = (Shape(s.name, s.geometry, _minus(s.position, origins.get(s.name, NOTHING)), s.rpy) for s in solids)
    start = Posture((*pose[0], *_quaternion(pose[1])), {joint.name: 0.0 for joint in joints if joint.type != "fixed"})
    return Robot(
        name=name,
        links=tuple(links),
        joints=joints,
        base=base,
        notes=(*doubts, "skipped colours, shells, sensors, surfaces and drag of the scene"),
        servos={axis.name: axis.servo for axis in axes if axis.servo is not None and axis.kind != "Fixed"},
        shapes=tuple(shapes),
        postures={"scene": start},
        doubts=tuple(doubts),
    )


def _link(solid: Solid, origin: tuple[float, float, float]) -> Link:
    return Link(solid.name, solid.mass, _minus(solid.position, origin), solid.inertia)


def _joint(axis: Axis, origin: tuple[float, float, float]) -> Joint:
    xyz, ends = _minus(axis.position, origin), (axis.parent, axis.child)
    if axis.kind == "Fixed":
        return Joint(axis.name, "fixed", *ends, xyz)
    stops = [x if abs(x) < FULL_TURN else math.copysign(math.inf, x) for x in axis.limits]
    if axis.kind == "Slider":
        return Joint(axis.name, "prismatic", *ends, xyz, axis=axis.direction, lower=stops[0], upper=stops[1])
    if stops == [-math.inf, math.inf]:
        return Joint(axis.name, "continuous", *ends, xyz, axis=axis.direction)
    lower, upper = (math.radians(x) for x in stops)
    return Joint(axis.name, "revolute", *ends, xyz, axis=axis.direction, lower=lower, upper=upper)


def _minus(a: tuple[float, ...], b: tuple[float, ...]) -> tuple[float, float, float]:
    x, y, z = (p - q for p, q in zip(a, b))
    return x, y, z


def _quaternion(rpy: tuple[float, ...]) -> tuple[float, float, float, float]:
    """Quaternion w x y z of roll, pitch and yaw [rad]."""
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(angle / 2), math.sin(angle / 2)) for angle in rpy)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def _doubts(body: Element, numbers: Numbers) -> list[str]:
    """What changes the motion and is passed over."""
    springs = [e for e in body.iter() if e.tag in ("spring", "spring2") and numbers.one(e, "k", 0.0, "<spring>")]
    unknown = sorted({e.tag for e in _all(body, "solids") if e.tag not in (*SHAPES, *UNSUPPORTED)})
    found = ["passed over the springs of axes: joints have none here"] if springs else []
    return found + [f"passed over <{tag}> in <solids>, which is no known solid" for tag in unknown]
