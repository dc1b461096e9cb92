"""Read URDF (https://wiki.ros.org/urdf/XML): links, joints and collision shapes."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

from ..base.rotation import dot, rotation_from_rpy
from ..model import Joint, Link, Mimic
from ..model.checks import check_angles
from ..model.rigid_bodies import inertia_tuple, turned_inertia
from .collision import MeshFinder, read_shapes
from .grammar import label, tidy
from .inertia import note_inertia, repaired
from .numerals import Vector, number, number_or_inf, vector
from .report import Report
from .robot import Robot

MAX_LINKS = 10_000

_IGNORED_LENGTH_ERROR = 1e-14  # an axis this close to unit length is kept to the last bit
_NOTED_LENGTH_ERROR = 1e-6

_REFUSED_TYPES = {
    "planar": "replace it by two prismatic joints and a continuous one",
    "spherical": "replace it by three continuous ones with massless links between them",
    "ball": "replace it by three continuous ones with massless links between them",
    "floating": "remove it together with its massless parent and load the robot with base='floating'",
}
JOINT_NUMBERS = {"dynamics": ("damping", "friction")}  # fields of Joint that are 0 where an element does not state them
INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def read_urdf(root: Element, path: Path, meshes: MeshFinder, report: Report, repair_inertia: bool = False) -> Robot:
    """Read a URDF.  Problems go into the report, and valid parts replace wrong ones, so that reading goes on.

    Raises ValueError for what is no URDF at all.
    """
    _check_root(root)
    tidy(root, label(root), report)
    name = _robot_name(root, path, report)
    links = tuple(_link(element, report, repair_inertia) for element in root.iterfind("link"))
    shapes = [shape for element in root.iterfind("link") for shape in read_shapes(element, meshes, report)]
    held: dict[str, float] = {}
    floating = [element for element in root.iterfind("joint") if element.get("type") == "floating"]
    joints = tuple(_joint(element, held, report) for element in root.iterfind("joint") if element not in floating)
    if floating:
        links = _without_world(links, joints, floating, report)
    shapes = [shape for shape in shapes if any(shape.link == link.name for link in links)]
    return Robot(name, links, joints, tuple(shapes), "floating" if floating else None, held)


def _check_root(root: Element) -> None:
    if root.tag != "robot":
        raise ValueError(f"root element is <{root.tag}>; expected <robot>, or <mujoco> of MJCF: convert the file")
    if len(root.findall("link")) > MAX_LINKS:
        raise ValueError(f"has {len(root.findall('link'))} links; at most {MAX_LINKS} are read: reduce them")


def _robot_name(root: Element, path: Path, report: Report) -> str:
    if "name" not in root.attrib:
        report.assume(root, "<robot>", "attribute 'name' is missing", f"called {path.stem!r}", "add it")
    return root.get("name", path.stem)


def _link(element: Element, report: Report, repair_inertia: bool) -> Link:
    """Read a link; if anything is wrong with it, return a valid one of its name."""
    what, before = label(element), len(report.problems)
    report.places.setdefault(what, report.lines[element])
    tidy(element, what, report)
    name, link = element.get("name", ""), None
    with report.blaming(element):
        link = _body(name, element.find("inertial"), what, report)
    if link is None or len(report.problems) > before:
        return Link(_sound_name(element, report), 1.0, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 1.0, 0.0, 1.0))
    link = repaired(link, report) if repair_inertia else link
    note_inertia(link, element, report)
    return link


def _sound_name(element: Element, report: Report) -> str:
    """Return the element's name, or a substitute if that is invalid."""
    name = element.get("name", "")
    return name if name and name.isprintable() else f"of line {report.lines[element]}"


def _body(name: str, inertial: Element | None, what: str, report: Report) -> Link:
    if inertial is None:
        return Link(name, 0.0, (0.0, 0.0, 0.0), (0.0,) * 6)
    mass = _numbers(inertial.find("mass"), ("value",), what, report)["value"]
    inertia = tuple(_numbers(_with_products(inertial, what, report), INERTIA, what, report).values())
    center, rpy = _origin(inertial, what, report)
    with report.blaming(inertial):
        check_angles(f"{what}: <origin>", "rpy", rpy)
        link = Link(name, mass, center, inertia)
        turned = inertia_tuple(turned_inertia(rotation_from_rpy(rpy), inertia))
        return replace(link, inertia=turned) if any(rpy) else link
    return Link(name, 0.0, (0.0, 0.0, 0.0), (0.0,) * 6)


def _with_products(inertial: Element, what: str, report: Report) -> Element | None:
    """Return the element <inertia>, with zeros for missing products of inertia."""
    inertia = inertial.find("inertia")
    left_out = [] if inertia is None else [name for name in ("ixy", "ixz", "iyz") if name not in inertia.attrib]
    if inertia is not None and left_out:
        found = f"<inertia> states no {', '.join(left_out)}"
        report.assume(inertia, what, found, "taken as 0", "add it: six numbers make an inertia")
        for name in left_out:
            inertia.set(name, "0")
    return inertia


def _joint(element: Element, held: dict[str, float], report: Report) -> Joint:
    """Read a joint; if anything is wrong with it, return a fixed one of its name between the same links."""
    what, before = label(element), len(report.problems)
    report.places.setdefault(what, report.lines[element])
    tidy(element, what, report)
    name, joint = element.get("name", ""), None
    parent, child = (_end(element, tag) for tag in ("parent", "child"))
    with report.blaming(element):
        joint = _moving_joint(element, name, parent, child, held, report)
    if joint is None or len(report.problems) > before:
        return Joint(_sound_name(element, report), "fixed", parent, child if child != parent else f"{child} ")
    return joint


def _end(element: Element, tag: str) -> str:
    """Return the link at an end of a joint."""
    end = element.find(tag)
    return "" if end is None else end.get("link", "")


def _moving_joint(
    element: Element, name: str, parent: str, child: str, held: dict[str, float], report: Report
) -> Joint:
    what = label(element)
    kind: Any = element.get("type", "fixed")  # any text: the checks of Joint refuse what is none of its types
    if kind in _REFUSED_TYPES:
        raise ValueError(f"{what}: type {kind!r} is not simulated; {_REFUSED_TYPES[kind]}")
    xyz, rpy = _origin(element, what, report)
    if kind == "fixed":
        return Joint(name, kind, parent, child, xyz, rpy)
    kind, stops = _stops(element, kind, what, report)
    motion: dict[str, Any] = {**stops, **_limits(element, what, report), **_stated_numbers(element, what, report)}
    axis = (1.0, 0.0, 0.0)
    with report.blaming(element):
        axis = _axis(element, what, report)
    joint = Joint(name, kind, parent, child, xyz, rpy, axis, **motion, mimic=_mimic(element, what, report))
    if joint.lower == joint.upper:
        held[name] = joint.lower
    return joint


def _mimic(element: Element, what: str, report: Report) -> Mimic | None:
    stated = element.find("mimic")
    if stated is None or not stated.get("joint"):  # which is refused as missing
        return None
    multiplier = offset = 0.0
    with report.blaming(stated):
        multiplier = number(stated, "multiplier", what, default=1.0)
        offset = number(stated, "offset", what, default=0.0)
    return Mimic(stated.get("joint", ""), multiplier, offset)


def _axis(element: Element, what: str, report: Report) -> Vector:
    """Return the axis at unit length; (1, 0, 0) if the file has none, as URDF says."""
    stated = element.find("axis")
    if stated is None:
        return (1.0, 0.0, 0.0)
    axis = (1.0, 0.0, 0.0)
    with report.blaming(stated):
        axis = vector(stated, "xyz", what)
    largest = max(abs(x) for x in axis)
    if not largest > 0:
        raise ValueError(f"{what}: axis {axis!r} has length {largest!r}; expected > 0: give a direction such as 0 0 1")
    scaled = [x / largest for x in axis]  # so that the squares of tiny numbers do not vanish
    length = math.sqrt(dot(scaled, scaled)) * largest
    if abs(length - 1.0) <= _IGNORED_LENGTH_ERROR:
        return axis
    if abs(length - 1.0) > _NOTED_LENGTH_ERROR:
        report.remark(f"{what}: axis {axis!r} was scaled to unit length")
    x, y, z = (x / math.sqrt(dot(scaled, scaled)) for x in scaled)
    return x, y, z


def _stops(element: Element, kind: str, what: str, report: Report) -> tuple[str, dict[str, float]]:
    """Return type and stops of a joint.

    URDF requires <limit>, whose lower and upper are 0 by default.  As in MuJoCo, both 0 means no stops.
    """
    limit, stops = element.find("limit"), {"lower": 0.0, "upper": 0.0}
    if kind == "continuous":
        if limit is not None and ("lower" in limit.attrib or "upper" in limit.attrib):
            report.remark("skipped lower and upper of a continuous joint, which has no stops")
        return kind, {}
    if kind not in ("revolute", "prismatic"):
        return kind, {}
    found, stated = f"type {kind!r} has no <limit>", []
    if limit is not None:
        stated = [name for name in stops if name in limit.attrib]
        with report.blaming(limit):
            stops |= {name: number_or_inf(limit, name, what) for name in stated}
        found = f"limits lower {stops['lower']!r}, upper {stops['upper']!r}"
    if stops["lower"] == stops["upper"] == 0.0 or (stops["lower"], stops["upper"]) == (-math.inf, math.inf):
        remedy = "state the limits, or use type 'fixed'" + (" or 'continuous'" if kind == "revolute" else "")
        report.assume(element, what, found, "no stops", remedy)
        return ("continuous" if kind == "revolute" else kind), {}
    if len(stated) == 1:
        report.assume(element, what, f"<limit> states only {stated[0]}", "the other is 0", "state both")
    if stops["lower"] == stops["upper"]:
        report.assume(element, what, found, "held there", "use type 'fixed' for a joint that does not move")
    return kind, stops


def _limits(element: Element, what: str, report: Report) -> dict[str, float]:
    """Return effort and velocity."""
    limit = element.find("limit")
    if limit is None:
        return {}
    for skipped in [name for name in ("acceleration", "deceleration", "jerk") if name in limit.attrib]:
        report.remark(f"skipped {skipped} of <limit>: the servo limits the motion")
    values: dict[str, float] = {}
    for name in [name for name in ("effort", "velocity") if name in limit.attrib]:
        with report.blaming(limit):
            values[name] = number_or_inf(limit, name, what)
    if not ("effort" in limit.attrib and "velocity" in limit.attrib):
        report.remark("a <limit> states no effort or no velocity: taken as unlimited")
    return values


def _stated_numbers(element: Element, what: str, report: Report) -> dict[str, float]:
    children = [(child, JOINT_NUMBERS[child.tag]) for child in element if child.tag in JOINT_NUMBERS]
    return {k: v for child, names in children for k, v in _numbers(child, names, what, report, 0.0).items()}


def _numbers(
    element: Element | None, names: tuple[str, ...], what: str, report: Report, default: float | None = None
) -> dict[str, float]:
    """Return numbers of an element by name; 0 for a wrong one, which is reported."""
    values = dict.fromkeys(names, 0.0)
    if element is None:  # which has been reported, as what is required and missing has
        return values
    for name in names:
        if name in element.attrib or default is not None:
            with report.blaming(element):
                values[name] = number(element, name, what, default)
    return values


def _origin(element: Element, what: str, report: Report) -> tuple[Vector, Vector]:
    origin, xyz, rpy = element.find("origin"), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    if origin is not None:
        with report.blaming(origin):
            xyz = vector(origin, "xyz", what)
        with report.blaming(origin):
            rpy = vector(origin, "rpy", what)
    return xyz, rpy


def _without_world(
    links: tuple[Link, ...], joints: tuple[Joint, ...], floating: list[Element], report: Report
) -> tuple[Link, ...]:
    """Drop the massless root of a floating joint; the joint's child becomes the floating base."""
    what, world = label(floating[0]), _end(floating[0], "parent")
    others = [joint.name for joint in joints if world in (joint.parent, joint.child)]
    massless = [link.name for link in links if link.mass == 0]
    if len(floating) > 1 or others or world not in massless:
        text = (
            f"{what}: type 'floating' from link {world!r}; expected one such joint, from a massless root link that no "
            f"other joint uses: {_REFUSED_TYPES['floating']}"
        )
        report.refuse(floating[0], text)
        return links
    report.remark(f"dropped link {world!r} and {what}: the base floats, and its pose is part of the state")
    return tuple(link for link in links if link.name != world)
