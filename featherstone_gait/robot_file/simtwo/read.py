"""Read a scene of SimTwo, or the file of one of its robots."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from ...base.rotation import rotation_from_rpy
from ...model import Base, Joint, Link, Propeller, Servo
from ...model.sensor import Sensor
from ...model.shapes import Shape
from ..markup import Vector, children, read_markup
from ..mjcf.tree import unused
from ..report import Report
from ..robot import MASSLESS, Robot
from ..settings import Posture
from .differences import SHELLS, SOLIDS, TOOLS, Differences, merge_repeated
from .expression import Numbers, constants_of
from .motors import Parts, parts_of, servo_of, spring_of
from .sensors import Carrier, read_sensor
from .solids import AIR, NOTHING, Axis, Solid, angles_of, attribute, placed_in, shell_of, solid_of, tell_driven
from .wheels import wheels_of

WORLD = "world"
FULL_TURN = 180.0  # [deg] a stop at or beyond it stops nothing
TYPES = ("Hinge", "Slider", "Universal", "Ball", "Fixed")
DAMPED = "left out that SimTwo takes 1e-5 of the velocity and 1e-3 of the turning of solids without <drag> a step"


def is_simtwo(root: Element) -> bool:
    """Return whether a file is of SimTwo."""
    return root.tag == "scene" or any(child.tag == "solids" for child in root)


def read_simtwo(
    path: Path, root: Element, base: Base | None, report: Report, robot: Element | None = None, member: str = ""
) -> Robot:
    """Read a robot of a scene (<scene>), by default its only one, or a robot's file (<robot>).

    base: None is "fixed" if a joint holds the robot to the world, else "floating"; member: its name in a scene of
    several.  What is ignored goes into the report.  Raises ValueError for meaningless constants or scenes,
    RobotFileError for all that is wrong with the robot, with the lines of its file.
    """
    name, pose, file, body, constants = path.stem, (NOTHING, NOTHING), path, root, constants_of(root, {})
    if root.tag == "scene":
        robot = _only_robot(root) if robot is None else robot
        name, file = name_of(robot), file_of(path, robot)
        if not file.is_file():
            raise ValueError(
                f"robot {name!r}: there is no file {file.name!r} beside the scene; correct <body file=...>"
            )
        outer = Numbers(constants)
        pose = outer.xyz(robot.find("pos"), "<pos>"), angles_of(robot, outer, "<robot>")
        body, report.lines, doubts = read_markup(file)
        for doubt in doubts:
            report.doubt(doubt)
        constants = constants_of(robot, constants)
        if not member:
            report.remark(f"{path.name}: only the robot is read; load_scene reads all of the scene")
    merge_repeated(body)
    numbers, differences = Numbers(constants_of(body, constants)), Differences(file, report)
    solids = _solids(body, numbers, report, differences)
    axes = _axes(body, numbers, report)
    if not solids:
        report.raise_problems(file)
    propellers = _propellers(body, solids, axes, differences)
    parts = _shells(body, numbers, solids, report, differences)
    taken = [solid.link.name for solid in (*solids, *(shell for shell, _ in parts))]
    parts += wheels_of(body, numbers, solids[0].link.name, taken, report)
    axes += [axis for _, axis in parts]
    origins = {axis.child: axis.position for axis in axes}  # of the frames of links that have a joint to their parent
    joints = []
    for axis in axes:
        with report.blaming(axis.element):
            joints.append(_joint(axis, origins.get(axis.parent, NOTHING)))
    everything = [*solids, *(solid for solid, _ in parts)]
    sensors = _sensors(body, numbers, everything, origins, report, differences)
    differences.look_through(body)
    differences.tell()
    if any(solid.immersed for solid in everything) and not member:
        report.remark(f"for drag and buoyancy of solids give fluid=Fluid({AIR}) to compile_scene")
    report.remark(f"{differences.file.name}: {DAMPED}")
    report.raise_problems(file)
    fixed = any(WORLD in (axis.parent, axis.child) for axis in axes)
    base = base or ("fixed" if fixed else "floating")
    return _robot(member or name, pose, everything, axes, joints, base)._replace(sensors=sensors, propellers=propellers)


def _propellers(
    body: Element, solids: list[Solid], axes: list[Axis], differences: Differences
) -> tuple[Propeller, ...]:
    """Return the propellers that joints turn, and say what drives belts and propellers."""
    named = {solid.link.name: solid for solid in solids}
    found = list[Propeller]()
    for element in _all(body, "solids", SOLIDS):
        solid = named.get(attribute(element, "ID", "value", ""))
        if solid is not None:
            found += tell_driven(element, solid, differences, axes)
    return tuple(found)


def _sensors(
    body: Element, numbers: Numbers, solids: list[Solid], origins: Mapping[str, Vector], report: Report,
    differences: Differences,
) -> tuple[Sensor, ...]:  # fmt: skip
    """Read the sensors; say what is read otherwise than SimTwo does, or not at all."""
    carriers, found = {}, list[Sensor]()
    for solid in solids:
        name = solid.link.name
        origin = np.array(origins.get(name, NOTHING))
        carriers[name] = Carrier(name, np.array(solid.position) - origin, rotation_from_rpy(solid.rpy), origin)
    for element in (*_all(body, "sensors", TOOLS), *_all(body, "tools", TOOLS)):
        with report.blaming(element):
            taken = [one.name for one in found]
            sensor = read_sensor(element, numbers, carriers, carriers[solids[0].link.name], differences, taken)
            found += [] if sensor is None else [sensor]
    return tuple(found)


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
    return attribute(robot, "ID", "name value", "robot")


def file_of(path: Path, robot: Element) -> Path:
    """Return the file of a robot of a scene, which may not exist."""
    return path.parent / attribute(robot, "body", "file", "")


def _all(root: Element, section: str, tags: str) -> list[Element]:
    return [child for part in root.iterfind(section) for child in children(part, tags.split())]


# ---------------------------------------------------------------------------------------------- solids


def _solids(body: Element, numbers: Numbers, report: Report, differences: Differences) -> list[Solid]:
    """Read the valid solids; report what is wrong with others, and what some do in SimTwo alone."""
    solids: list[Solid] = []
    elements = _all(body, "solids", SOLIDS)
    for element in elements:
        with report.blaming(element):
            solid, named = solid_of(element, numbers), element.find("solid")
            if named is not None:
                mothers = [one for one in solids if one.link.name == named.get("id")]
                solid = placed_in(mothers[0], solid) if mothers else solid
                if not mothers:
                    differences.add(element, "a solid names none before it: it is in the robot's frame, as in SimTwo")
            solids.append(solid)
    if not elements:
        report.refuse(body, "there is no solid; a robot needs one: give the file that has <solids>")
    return solids


def _shells(
    body: Element, numbers: Numbers, solids: list[Solid], report: Report, differences: Differences
) -> list[tuple[Solid, Axis]]:
    """Read the valid shells; report others."""
    found: list[tuple[Solid, Axis]] = []
    by_name = {solid.link.name: solid for solid in solids}
    for element in _all(body, "shells", SHELLS):
        named, mother = element.find("solid"), solids[0]
        if named is not None:
            mother = by_name.get(named.get("id", ""), mother)
            if mother.link.name != named.get("id"):
                differences.add(element, "a shell names no solid that is there: it is on the first, as in SimTwo")
        own = attribute(element, "ID", "value", "") or "shell"
        taken = [*by_name, *(solid.link.name for solid, _ in found)]
        with report.blaming(element):
            found.append(shell_of(element, numbers, mother, unused(f"{mother.link.name}_{own}", taken)))
    return found


# ---------------------------------------------------------------------------------------------- articulations


def _axes(body: Element, numbers: Numbers, report: Report) -> list[Axis]:
    """Read the axes of all valid articulations, each from the link nearer to the root; report others."""
    names = [attribute(element, "ID", "value", "") for element in _all(body, "solids", SOLIDS)]
    ends: dict[int, tuple[str, str]] = {}
    found: list[tuple[Element, list[Parts]]] = []  # joints, with their motors' parts over those of the last <default>
    inherited: list[Parts] = [{}, {}]
    for element in _all(body, "articulations", "joint default"):
        both = element.tag == "default" or attribute(element, "type", "value", "") == "Universal"
        parts = [parts_of(element, suffix, defaults) for suffix, defaults in zip(("", "2")[: 1 + both], inherited)]
        if element.tag == "default":
            inherited = parts
        else:
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
    given = [attribute(element, "connect", f"B{k} S{k}", "") for k in (1, 2)]
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
    if kind in ("Ball", "Fixed"):
        yield Axis(name, kind, parent, child, place, (1.0, 0.0, 0.0), (-360.0, 360.0), None, {}, element)
        return
    if kind != "Universal":
        direction, limits, servo, free = _motion(element, parts[0], numbers, "", what)
        yield Axis(name, kind, parent, child, place, _scaled(direction, sign, what), limits, servo, free, element)
        return
    middle, order = f"{name}_cross", ("", "2") if parent == first else ("2", "")
    for suffix, ends_here in zip(order, ((parent, middle), (middle, child))):
        direction, limits, servo, free = _motion(element, parts[suffix == "2"], numbers, suffix, what)
        joint = f"{name}_2" if suffix else name
        yield Axis(joint, "Hinge", *ends_here, place, _scaled(direction, sign, what), limits, servo, free, element)


def _motion(
    element: Element, parts: Parts, numbers: Numbers, suffix: str, what: str
) -> tuple[Vector, tuple[float, float], Servo | None, dict[str, Any]]:
    """Return direction, limits, servo and numbers of the joint of an axis; suffix: "2" for the second one."""
    default = (0.0, 0.0, 1.0) if suffix else (1.0, 0.0, 0.0)
    direction = numbers.xyz(element.find(f"axis{suffix}"), f"{what} <axis{suffix}>", default)
    stops = element.find(f"limits{suffix}")
    limits = tuple(numbers.one(stops, end, v, f"{what} <limits>") for end, v in (("Min", -360.0), ("Max", 360.0)))
    servo, free = servo_of(parts, numbers, what)
    return direction, (limits[0], limits[1]), servo, free | spring_of(parts, numbers, what)


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
        servos={axis.name: axis.servo for axis in axes if axis.servo is not None},
        shapes=tuple(
            Shape(solid.link.name, solid.geometry, place, solid.rpy, friction=solid.friction, surface=solid.surface)
            for solid, place in places
        ),
        postures={"scene": Posture(start, {joint.name: _zero(joint) for joint in joints if joint.type != "fixed"})},
        immersed=tuple(replace(one, xyz=_plus(one.xyz, place)) for solid, place in places for one in solid.immersed),
        rollers={
            solid.link.name: replace(solid.rollers, position=place)
            for solid, place in places
            if solid.rollers is not None
        },
    )


def _zero(joint: Joint) -> Any:
    return (1.0, 0.0, 0.0, 0.0) if joint.type == "ball" else 0.0


def _joint(axis: Axis, origin: Vector) -> Joint:
    joint = Joint(axis.name, "fixed", axis.parent, axis.child, _minus(axis.position, origin))
    if axis.kind == "Fixed":
        return joint
    if axis.kind == "Ball":
        return replace(joint, type="ball")
    joint = replace(joint, **axis.numbers)
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


def _plus(a: tuple[float, ...], b: tuple[float, ...]) -> Vector:
    x, y, z = (p + q for p, q in zip(a, b))
    return x, y, z


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
