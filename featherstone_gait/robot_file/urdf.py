"""Read URDF (https://wiki.ros.org/urdf/XML): links, joints and collision shapes."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar
from xml.etree.ElementTree import Element

import numpy as np

from ..base.rotation import dot, rotation_from_rpy
from ..model import Joint, Link, Mimic, inertia_matrix
from ..model.checks import check_angles
from ..model.mass_checks import DEFINITE_TOLERANCE
from ..model.rigid_bodies import inertia_tuple, turned_inertia
from .collision import MeshFinder, read_shapes
from .dialects import read_frictions, read_rotors
from .gazebo import read_gazebo
from .grammar import label, look_through, need, tidy
from .markup import Read, Vector, children, number, number_or_inf, vector
from .report import Report
from .robot import MASSLESS, Robot

T = TypeVar("T")

MAX_LINKS = 10_000
TRIANGLE_TOLERANCE = 1e-6  # relative; a flat plate meets A + B = C exactly, and files round to about seven digits

_IGNORED_LENGTH_ERROR = 1e-14  # an axis this close to unit length is kept to the last bit
_NOTED_LENGTH_ERROR = 1e-6

_NAMES = {"spherical": "ball", "floating": "free"}  # of joint types that are called otherwise here
DYNAMICS = ("damping", "friction")  # fields of Joint
INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def read_urdf(root: Element, path: Path, meshes: MeshFinder, report: Report, repair_inertia: bool = False) -> Robot:
    """Read a URDF.  Problems go into the report, and valid parts replace wrong ones, so that reading goes on.

    Raises ValueError for what is no URDF at all.
    """
    if root.tag != "robot":
        raise ValueError(f"root element is <{root.tag}>; expected <robot>, or <mujoco> of MJCF: convert the file")
    if len(root.findall("link")) > MAX_LINKS:
        raise ValueError(f"has {len(root.findall('link'))} links; at most {MAX_LINKS} are read: reduce them")
    gazebo, rotors = read_gazebo(root, report), read_rotors(root, report)
    more = {name: {**gazebo.joints.get(name, {}), **rotors.get(name, {})} for name in {**gazebo.joints, **rotors}}
    frictions: dict[Any, float] = {**gazebo.frictions, **read_frictions(root, report)}
    if root.get("name") is None:
        report.assume(root, "<robot>", "attribute 'name' is missing", f"called {path.stem!r}", "add it")
    for element in (*root.iterfind("link"), *root.iterfind("joint")):
        tidy(element, label(element), report)
    shapes = [shape for element in root.iterfind("link") for shape in read_shapes(element, meshes, frictions, report)]
    links = tuple(_link(element, report, repair_inertia) for element in root.iterfind("link"))
    floating = _base_joints(root, links)
    joints = tuple(_joint(element, more, report) for element in root.iterfind("joint") if element not in floating)
    look_through(root, label(root), report)
    if floating:
        links = _without_world(links, floating, report)
    return Robot(
        name=root.get("name", path.stem),
        links=links,
        joints=joints,
        shapes=tuple(shape for shape in shapes if any(shape.link == link.name for link in links)),
        base="floating" if floating else None,
        held={joint.name: joint.lower for joint in joints if joint.lower == joint.upper},
    )


def _link(element: Element, report: Report, repair_inertia: bool) -> Link:
    """Read a link; if anything is wrong with it, return a valid one of its name."""
    link = _sound(element, report, _body)
    if link is None:
        return Link(_printable_name(element, report), 1.0, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 1.0, 0.0, 1.0))
    link = _repaired(link, report) if repair_inertia else link
    _note_inertia(link, element, report)
    return link


def _joint(element: Element, more: Mapping[str, dict[str, Any]], report: Report) -> Joint:
    """Read a joint; if anything is wrong with it, return a fixed one of its name between the same links."""

    def read(element: Element, what: str, report: Report) -> Joint:
        joint = _moving_joint(element, what, report)
        return joint if joint.type == "fixed" else replace(joint, **more.get(joint.name, {}))

    joint = _sound(element, report, read)
    if joint is None:
        parent, child = (_end(element, tag) for tag in ("parent", "child"))
        return Joint(_printable_name(element, report), "fixed", parent, child if child != parent else f"{child} ")
    return joint


def _sound(element: Element, report: Report, read: Callable[[Element, str, Report], T]) -> T | None:
    """Read a link or joint; report what is wrong with it, and return None then."""
    what, before, found = label(element), len(report.problems), None
    report.places.setdefault(what, report.lines[element])
    need(element, what, report, "name type" if element.tag == "joint" else "name")
    with report.blaming(element):
        found = read(element, what, report)
    look_through(element, what, report)
    return found if len(report.problems) == before else None


def _printable_name(element: Element, report: Report) -> str:
    """Return the element's name, or a substitute if that is invalid."""
    name = element.get("name", "")
    return name if name and name.isprintable() else f"of line {report.lines[element]}"


def _stated(
    element: Element | None, names: Iterable[str], what: str, report: Report, read: Callable = number
) -> dict[str, Any]:
    """Return the numbers that an element states, by name, without wrong ones, which are reported."""
    values = {}
    for name in names:
        if element is not None and element.get(name) is not None:
            with report.blaming(element):
                values[name] = read(element, name, what)
    return values


def _body(element: Element, what: str, report: Report) -> Link:
    name, inertial = element.get("name", ""), element.find("inertial")
    if inertial is None:
        return Link(name, **MASSLESS)
    _need_inside(inertial, label(inertial, what), report, mass="value", inertia="ixx iyy izz")
    mass = _stated(inertial.find("mass"), ("value",), what, report)
    stated = _stated(_with_products(inertial, what, report), INERTIA, what, report)
    inertia = tuple(stated.get(name, 0.0) for name in INERTIA)
    origin = _stated(inertial.find("origin"), ("xyz", "rpy"), what, report, vector)
    rpy = origin.get("rpy", (0.0, 0.0, 0.0))
    with report.blaming(inertial):
        check_angles(f"{what}: <origin>", "rpy", rpy)
        link = Link(name, mass.get("value", 0.0), origin.get("xyz", (0.0, 0.0, 0.0)), inertia)
        turned = inertia_tuple(turned_inertia(rotation_from_rpy(rpy), inertia))
        return replace(link, inertia=turned) if any(rpy) else link
    return Link(name, **MASSLESS)


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


def _need_inside(element: Element, what: str, report: Report, **attributes: str) -> None:
    """Report children, by tag, that an element lacks, and attributes that these lack."""
    need(element, what, report, tags=" ".join(attributes))
    for tag, names in attributes.items():
        child = element.find(tag)
        if child is not None:
            need(child, label(child, what), report, names)


def _end(element: Element, tag: str) -> str:
    """Return the link at an end of a joint."""
    end = element.find(tag)
    return "" if end is None else end.get("link", "")


def _moving_joint(element: Element, what: str, report: Report) -> Joint:
    kind: Any = element.get("type", "fixed")  # any text: the checks of Joint refuse what is none of its types
    kind = _NAMES.get(kind, kind)
    _need_inside(element, what, report, parent="link", child="link")
    name, parent, child = element.get("name", ""), _end(element, "parent"), _end(element, "child")
    origin = _stated(element.find("origin"), ("xyz", "rpy"), what, report, vector)
    if kind == "fixed":
        for still in children(element, ("axis", "limit", "dynamics", "mimic", "screw", "axis2")):
            report.remark(f"skipped <{still.tag}> of a fixed joint, which does not move")
            assert isinstance(still, Read)
            still.whole = True
        return Joint(name, kind, parent, child, **origin)
    kind, motion = _stops(element, kind, what, report)
    motion |= _limits(element, what, report) | _stated(element.find("dynamics"), DYNAMICS, what, report)
    if kind not in ("ball", "free"):
        with report.blaming(element):
            motion["axis"] = _axis(element, what, report)
    if kind == "universal" and element.find("axis2") is not None:
        with report.blaming(element):
            motion["axis2"] = _axis(element, what, report, "axis2")
    for tag, owner in (("axis2", "universal"), ("screw", "screw")):
        if kind != owner and (other := element.find(tag)) is not None:
            found, remedy = f"<{tag}> of a joint of type {kind!r}", f"only {owner} joints have one: remove it"
            report.assume(element, what, found, "ignored", remedy)
            assert isinstance(other, Read)
            other.whole = True
    if kind == "screw":
        motion |= _stated(element.find("screw"), ("pitch",), what, report)
        if "pitch" not in motion:
            report.assume(element, what, "a screw without <screw pitch>", "pitch 0", "state how far it slides [m/rad]")
    mimic = element.find("mimic")
    if mimic is not None:
        need(mimic, label(mimic, what), report, "joint")
    if mimic is not None and mimic.get("joint"):  # else it is refused as missing
        motion["mimic"] = Mimic(mimic.get("joint", ""), **_stated(mimic, ("multiplier", "offset"), what, report))
    return Joint(name, kind, parent, child, **origin, **motion)


def _axis(element: Element, what: str, report: Report, tag: str = "axis") -> Vector:
    """Return the axis at unit length; (1, 0, 0) if the file has none, as URDF says."""
    stated = element.find(tag)
    if stated is not None:
        need(stated, label(stated, what), report, "xyz")
    axis: Vector = _stated(stated, ("xyz",), what, report, vector).get("xyz", (1.0, 0.0, 0.0))
    largest = max(abs(x) for x in axis)
    if not largest > 0:
        raise ValueError(f"{what}: {tag} {axis!r} has length {largest!r}; expected > 0: give a direction such as 0 0 1")
    scaled = [x / largest for x in axis]  # so that the squares of tiny numbers do not vanish
    length = math.sqrt(dot(scaled, scaled)) * largest
    if abs(length - 1.0) <= _IGNORED_LENGTH_ERROR:
        return axis
    if abs(length - 1.0) > _NOTED_LENGTH_ERROR:
        report.remark(f"{what}: axis {axis!r} was scaled to unit length")
    x, y, z = (x / math.sqrt(dot(scaled, scaled)) for x in scaled)
    return x, y, z


def _stops(element: Element, kind: str, what: str, report: Report) -> tuple[Any, dict[str, Any]]:
    """Return type and stops of a joint.

    URDF requires <limit>, whose lower and upper are 0 by default.  As in MuJoCo, both 0 means no stops.
    """
    limit, stops = element.find("limit"), {"lower": 0.0, "upper": 0.0}
    if kind == "continuous":
        if limit is not None and any([limit.get(name) is not None for name in stops]):
            report.remark("skipped lower and upper of a continuous joint, which has no stops")
        return kind, {}
    if kind not in ("revolute", "prismatic", "screw") or (kind == "screw" and not stops.keys() & _attributes(limit)):
        if limit is not None and any([limit.get(name) is not None for name in stops]):
            remedy = "limit joints of one degree of freedom"
            report.assume(element, what, f"type {element.get('type')!r} has limits", "without limits", remedy)
        return kind, {}
    stated = _stated(limit, stops, what, report, number_or_inf)
    if limit is not None and len(stated) < sum(name in limit.attrib for name in stops):  # a wrong one is reported
        return kind, {}
    stops |= stated
    limits = f"limits lower {stops['lower']!r}, upper {stops['upper']!r}"
    found = limits if limit is not None else f"type {kind!r} has no <limit>"
    if stops["lower"] == stops["upper"] == 0.0 or (stops["lower"], stops["upper"]) == (-math.inf, math.inf):
        remedy = "state the limits, or use type 'fixed'" + (" or 'continuous'" if kind == "revolute" else "")
        report.assume(element, what, found, "no stops", remedy)
        return ("continuous" if kind == "revolute" else kind), {}
    if len(stated) == 1:
        report.assume(element, what, f"<limit> states only {next(iter(stated))}", "the other is 0", "state both")
    if stops["lower"] == stops["upper"]:
        report.assume(element, what, found, "held there", "use type 'fixed' for a joint that does not move")
    return kind, stops


def _attributes(element: Element | None) -> set[str]:
    return set() if element is None else set(element.attrib)


def _limits(element: Element, what: str, report: Report) -> dict[str, float]:
    """Return effort and velocity."""
    limit = element.find("limit")
    if limit is None:
        return {}
    if not ("effort" in limit.attrib and "velocity" in limit.attrib):
        report.remark("a <limit> states no effort or no velocity: taken as unlimited")
    return _stated(limit, ("effort", "velocity"), what, report, number_or_inf)


def _base_joints(root: Element, links: tuple[Link, ...]) -> list[Element]:
    """Return the floating joint that moves the base, the only one of the massless root link; others are of the tree."""
    joints = list(root.iterfind("joint"))
    massless = {link.name for link in links if link.mass == 0}
    children = {_end(element, "child") for element in joints}
    for element in joints:
        world = _end(element, "parent")
        alone = sum(_end(one, "parent") == world for one in joints) == 1
        if element.get("type") == "floating" and world in massless and world not in children and alone:
            return [element]
    return []


def _without_world(links: tuple[Link, ...], floating: list[Element], report: Report) -> tuple[Link, ...]:
    """Drop the massless root of a floating joint; the joint's child becomes the floating base."""
    what, world = label(floating[0]), _end(floating[0], "parent")
    report.remark(f"dropped link {world!r} and {what}: the base floats, and its pose is part of the state")
    return tuple(link for link in links if link.name != world)


# ---------------------------------------------------------------------------------------------- inertias


def _note_inertia(link: Link, element: Element, report: Report) -> None:
    """Report an inertia that no distribution of the mass has; points and rods have a possible one."""
    what, inertia = f"link {link.name!r}", tuple(link.inertia)
    if link.mass == 0:
        if any(inertia):
            found = f"mass is 0 but inertia is {inertia!r}"
            report.assume(element, what, found, "taken as stated", "give a mass > 0, or set both to 0")
        return
    A, B, C = _moments(link)
    if A < -DEFINITE_TOLERANCE * max(C, -A):
        found = f"inertia {inertia!r} kg m^2 is not positive definite (principal moments {A:.6g}, {B:.6g}, {C:.6g})"
        remedy = "all must be > 0: correct the diagonal and the signs of the products, or load with repair_inertia=True"
        report.assume(element, what, found, "taken as stated", remedy)
    elif A + B < C * (1.0 - TRIANGLE_TOLERANCE):
        found = f"principal moments of inertia {A:.6g}, {B:.6g}, {C:.6g} kg m^2 break the triangle inequality"
        remedy = (
            f"no body has one above the sum of the others (relative tolerance {TRIANGLE_TOLERANCE:g}): "
            "compute the inertia about the center of mass again, or load with repair_inertia=True"
        )
        report.assume(element, what, found, "taken as stated", remedy)


def _repaired(link: Link, report: Report) -> Link:
    """Return the link with an inertia that a rigid body can have.

    As in MuJoCo's compiler with `boundinertia` and `balanceinertia`: principal moments below zero are raised, here to
    DEFINITE_TOLERANCE of the largest, and if one is then above the sum of the others all three become their mean.
    Massless links, links without a positive moment, and possible inertias stay as they are.
    """
    A, B, C = _moments(link)
    possible = A >= -DEFINITE_TOLERANCE * max(C, -A) and A + B >= C * (1.0 - TRIANGLE_TOLERANCE)
    if link.mass == 0 or possible or not C > 0:
        return link
    moments, axes = np.linalg.eigh(inertia_matrix(link.inertia))
    moments = np.maximum(moments, DEFINITE_TOLERANCE * C)
    if moments[0] + moments[1] < moments[2] * (1.0 - TRIANGLE_TOLERANCE):
        moments = np.full(3, moments.mean())
    I = (axes * moments) @ axes.T
    change = f"{A:.6g}, {B:.6g}, {C:.6g} to {', '.join(f'{x:.6g}' for x in moments.tolist())}"
    report.remark(f"link {link.name!r}: principal moments of inertia repaired from {change} kg m^2")
    return replace(link, inertia=tuple(float(I[i, j]) for i, j in zip((0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2))))


def _moments(link: Link) -> list[float]:
    """Compute the principal moments of inertia, ascending [kg m^2]."""
    return np.linalg.eigvalsh(inertia_matrix(link.inertia)).tolist()
