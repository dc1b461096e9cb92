"""Reading URDF (https://wiki.ros.org/urdf/XML): links and joints, and what of it is skipped."""

from __future__ import annotations

import math
import re
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element, ParseError

from defusedxml.common import DefusedXmlException
from defusedxml.ElementTree import fromstring

from ..model import Joint, Link, check_angles, check_tree, turned_inertia
from ..rotation import dot, rotation_from_rpy
from .robot import Robot
from .source import read_bytes

Vector = tuple[float, float, float]

MAX_DEPTH = 64  # of nested XML elements
MAX_LINKS = 10_000
MAX_NUMBER = 1e30  # in a URDF, so that no product of masses and lengths overflows

_NUMBER = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?")  # what strtod reads in the C locale
_IGNORED_LENGTH_ERROR = 1e-14  # an axis this close to unit length is kept to the last bit
_NOTED_LENGTH_ERROR = 1e-6


class _Grammar(NamedTuple):
    """What an element of the URDF may hold."""

    required: str = ""  # attributes
    optional: str = ""
    needs: str = ""  # children, exactly one of each
    reads: str = ""  # children, at most one of each (any number below <robot>)


_URDF = {
    "robot": _Grammar(required="name", optional="version", reads="link joint"),
    "link": _Grammar(required="name", optional="type", reads="inertial"),
    "inertial": _Grammar(needs="mass inertia", reads="origin"),
    "mass": _Grammar(required="value"),
    "inertia": _Grammar(required="ixx ixy ixz iyy iyz izz"),
    "origin": _Grammar(optional="xyz rpy"),
    "joint": _Grammar(required="name type", needs="parent child", reads="origin axis limit dynamics"),
    "parent": _Grammar(required="link"),
    "child": _Grammar(required="link"),
    "axis": _Grammar(required="xyz"),
    "limit": _Grammar(optional="lower upper effort velocity acceleration deceleration jerk"),
    "dynamics": _Grammar(optional="damping friction"),
}
_SKIPPED = {
    "robot": {
        "material": "colours play no part",
        "transmission": "servos and gearboxes come from the TOML file",
        "gazebo": "another simulator's settings",
        "mujoco": "another simulator's settings",
        "ros2_control": "controllers come from the TOML file",
    },
    "link": {
        "visual": "shapes play no part and meshes are never opened",
        "collision": "contact points come from the TOML file and meshes are never opened",
    },
    "joint": {
        "calibration": "encoders start calibrated",
        "safety_controller": "controllers come from the TOML file",
    },
}
_REFUSED_TYPES = {
    "planar": "replace it by two prismatic joints and a continuous one",
    "floating": "remove it together with its massless parent and load the robot with base='floating'",
}
JOINT_NUMBERS = {"dynamics": ("damping", "friction")}  # fields of Joint that are 0 where an element does not state them
INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def read_urdf(path: Path) -> Robot:
    """Read a URDF strictly.  Raises ValueError for what URDF does not know or the simulator cannot do."""
    root = _read_xml(path)
    notes = _check_elements(root)
    links = tuple(_link(element) for element in root.iterfind("link"))
    floating = [element for element in root.iterfind("joint") if element.get("type") == "floating"]
    joints = tuple(_joint(element, notes) for element in root.iterfind("joint") if element not in floating)
    if floating:
        links = _without_world(links, joints, floating, notes)
    check_tree(links, joints)
    sentences = tuple(sentence + (f" ({count} times)" if count > 1 else "") for sentence, count in notes.items())
    return Robot(root.attrib["name"], links, joints, "floating" if floating else None, sentences)


def _read_xml(path: Path) -> Element:
    data = read_bytes(path)
    try:
        root = fromstring(data, forbid_dtd=True)
    except DefusedXmlException as error:
        raise ValueError(f"declares a document type or entities ({error}); remove the <!DOCTYPE ...>") from error
    except ParseError as error:
        raise ValueError(f"is not well-formed XML: {error}; correct the syntax there, and give a URDF file") from error
    except (ValueError, LookupError) as error:
        raise ValueError(f"has an encoding that cannot be read: {error}; save it as UTF-8") from error
    _check_depth(root)
    _drop_default_namespace(root)
    return root


def _check_depth(root: Element) -> None:
    """Refuse deep nesting, level by level, so that no recursion ever meets it."""
    level = [root]
    for _ in range(MAX_DEPTH):
        level = [child for element in level for child in element]
        if not level:
            return
    raise ValueError(f"nests <{level[0].tag}> more than {MAX_DEPTH} elements deep; a URDF needs 5: flatten it")


def _drop_default_namespace(root: Element) -> None:
    """`<robot xmlns="...">` puts every tag into a namespace; strip that one and no other."""
    namespace = root.tag[: root.tag.find("}") + 1]
    if namespace:
        for element in root.iter():
            element.tag = element.tag.removeprefix(namespace)


def _check_elements(root: Element) -> Counter[str]:
    """Check tags and attributes against the grammar; return a note for each kind of element that is skipped."""
    if root.tag != "robot":
        raise ValueError(f"root element is <{root.tag}>; expected <robot>: convert the file to URDF")
    if len(root.findall("link")) > MAX_LINKS:
        raise ValueError(f"has {len(root.findall('link'))} links; at most {MAX_LINKS} are read: reduce them")
    notes: Counter[str] = Counter()
    stack = [(root, _label(root, ""))]
    while stack:
        element, what = stack.pop()
        skipped = _SKIPPED.get(element.tag, {})
        notes.update(f"skipped <{child.tag}>: {skipped[child.tag]}" for child in element if child.tag in skipped)
        children = [child for child in element if child.tag not in skipped]
        _check_children(element, children, what)
        _check_attributes(element, what)
        stack.extend((child, _label(child, what)) for child in reversed(children))
    return notes


def _label(element: Element, parent: str) -> str:
    """What messages call an element: link 'shank', or link 'shank' <inertial> <mass>."""
    if element.tag in ("robot", "link", "joint"):
        return f"{element.tag} {element.get('name')!r}"
    return f"{parent} <{element.tag}>"


def _check_children(element: Element, children: list[Element], what: str) -> None:
    grammar = _URDF[element.tag]
    legal = f"{grammar.needs} {grammar.reads}".split()
    counts = Counter(child.tag for child in children)
    for tag, count in counts.items():
        if tag not in legal:
            expected = f"expected {', '.join(f'<{t}>' for t in legal) or 'none'}"
            raise ValueError(f"{what}: unknown element <{tag}>; {expected}: {_remedy(tag)}")
        if count > 1 and element.tag != "robot":
            raise ValueError(f"{what}: {count} elements <{tag}>; at most one is allowed: remove the others")
    for tag in grammar.needs.split():
        if tag not in counts:
            raise ValueError(f"{what}: element <{tag}> is missing; exactly one is required: add it")
    text = "".join([element.text or "", *(child.tail or "" for child in element)]).strip()
    if text:
        raise ValueError(f"{what}: stray text {text[:40]!r}; values stand in attributes: remove it")


def _remedy(tag: str) -> str:
    if "xacro" in tag:
        return "expand the file with xacro first"
    if tag == "mimic":
        return "coupled joints are not simulated, so remove it and lock the joint, or give it a servo of its own"
    return "correct the spelling, or remove it"


def _check_attributes(element: Element, what: str) -> None:
    grammar = _URDF[element.tag]
    required, optional = grammar.required.split(), grammar.optional.split()
    for name in required:
        if name not in element.attrib:
            raise ValueError(f"{what}: attribute {name!r} of <{element.tag}> is missing; it is required: add it")
    for name in element.attrib:
        foreign = element.tag == "robot" and name.startswith("{")  # xsi:schemaLocation and the like
        if name not in required and name not in optional and not foreign:
            raise ValueError(
                f"{what}: unknown attribute {name!r} of <{element.tag}>; expected "
                f"{', '.join(required + optional) or 'none'}: correct the spelling, or remove it"
            )


def _link(element: Element) -> Link:
    what = _label(element, "")
    inertial = element.find("inertial")
    if inertial is None:
        return Link(element.attrib["name"], 0.0, (0.0, 0.0, 0.0), (0.0,) * 6)
    mass = _number(inertial.findall("mass")[0], "value", what)
    inertia = tuple(_number(inertial.findall("inertia")[0], name, what) for name in INERTIA)
    center, rpy = _origin(inertial, what)
    check_angles(f"{what}: <origin>", "rpy", rpy)
    link = Link(element.attrib["name"], mass, center, inertia)
    return replace(link, inertia=_turned(inertia, rpy)) if any(rpy) else link


def _turned(inertia: tuple[float, ...], rpy: tuple[float, ...]) -> tuple[float, ...]:
    """The inertia in link axes, given in axes turned by rpy."""
    I = turned_inertia(rotation_from_rpy(rpy), inertia)
    return tuple(((I + I.T) / 2)[(0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2)].tolist())


def _joint(element: Element, notes: Counter[str]) -> Joint:
    what, name = _label(element, ""), element.attrib["name"]
    kind: Any = element.attrib["type"]  # any text: the checks of Joint refuse what is none of its types
    if kind in _REFUSED_TYPES:
        raise ValueError(f"{what}: type {kind!r} is not simulated; {_REFUSED_TYPES[kind]}")
    parent, child = (element.findall(end)[0].attrib["link"] for end in ("parent", "child"))
    xyz, rpy = _origin(element, what)
    if kind == "fixed":
        return Joint(name, kind, parent, child, xyz, rpy)
    motion: dict[str, Any] = {**_limits(element, what, notes), **_numbers(element, what)}
    return Joint(name, kind, parent, child, xyz, rpy, _axis(element, what, notes), **motion)


def _axis(element: Element, what: str, notes: Counter[str]) -> Vector:
    """The axis at unit length; (1, 0, 0) if the file has none, as URDF says."""
    stated = element.find("axis")
    if stated is None:
        return (1.0, 0.0, 0.0)
    axis = _vector(stated, "xyz", what)
    largest = max(abs(x) for x in axis)
    if not largest > 0:
        raise ValueError(f"{what}: axis {axis!r} has length {largest!r}; expected > 0: give a direction such as 0 0 1")
    scaled = [x / largest for x in axis]  # so that the squares of tiny numbers do not vanish
    length = math.sqrt(dot(scaled, scaled)) * largest
    if abs(length - 1.0) <= _IGNORED_LENGTH_ERROR:
        return axis
    if abs(length - 1.0) > _NOTED_LENGTH_ERROR:
        notes[f"{what}: axis {axis!r} was scaled to unit length"] += 1
    x, y, z = (x / math.sqrt(dot(scaled, scaled)) for x in scaled)
    return x, y, z


def _limits(element: Element, what: str, notes: Counter[str]) -> dict[str, float]:
    limit, kind = element.find("limit"), element.get("type")
    if limit is None:
        if kind in ("revolute", "prismatic"):
            remedy = "add it, or use type 'continuous'" if kind == "revolute" else "add it"
            raise ValueError(f"{what}: type {kind!r} needs a <limit> with lower, upper, effort and velocity: {remedy}")
        return {}
    for name in [name for name in ("acceleration", "deceleration", "jerk") if name in limit.attrib]:
        notes[f"skipped {name} of <limit>: the servo limits the motion"] += 1
    stated = [name for name in ("effort", "velocity") if name in limit.attrib]
    values: dict[str, float] = {name: _number(limit, name, what) for name in stated}
    if len(values) < 2:
        notes["a <limit> states no effort or no velocity: taken as unlimited"] += 1
    if kind != "continuous":
        return values | {name: _number(limit, name, what, default=0.0) for name in ("lower", "upper")}
    if "lower" in limit.attrib or "upper" in limit.attrib:
        notes["skipped lower and upper of a continuous joint, which has no stops"] += 1
    return values


def _numbers(element: Element, what: str) -> dict[str, float]:
    children = [(child, JOINT_NUMBERS[child.tag]) for child in element if child.tag in JOINT_NUMBERS]
    return {name: _number(child, name, what, default=0.0) for child, names in children for name in names}


def _origin(element: Element, what: str) -> tuple[Vector, Vector]:
    origin = element.find("origin")
    if origin is None:
        return (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    return _vector(origin, "xyz", what), _vector(origin, "rpy", what)


def _vector(element: Element, attribute: str, what: str) -> Vector:
    """Three numbers; zeros where the attribute is left out."""
    words = element.get(attribute, "0 0 0").split()
    if len(words) != 3:
        raise ValueError(
            f"{what}: <{element.tag}> {attribute}={element.get(attribute)!r} has {len(words)} numbers; "
            "expected 3, separated by spaces: correct it"
        )
    x, y, z = (_parsed(word, f"{what}: <{element.tag}> {attribute}") for word in words)
    return x, y, z


def _number(element: Element, attribute: str, what: str, default: float | None = None) -> float:
    if default is not None and attribute not in element.attrib:
        return default
    return _parsed(element.attrib[attribute].strip(), f"{what}: <{element.tag}> {attribute}")


def _parsed(word: str, what: str) -> float:
    """A finite number as XML Schema and C write it; float() alone would take 1_0, nan and Arabic digits too."""
    value = float(word) if _NUMBER.fullmatch(word) else math.nan
    if not abs(value) <= MAX_NUMBER:
        raise ValueError(
            f"{what} is {word[:40]!r}; expected a number up to {MAX_NUMBER:g}: write it like -0.15 or 2e-3"
        )
    return value


def _without_world(
    links: tuple[Link, ...], joints: tuple[Joint, ...], floating: list[Element], notes: Counter[str]
) -> tuple[Link, ...]:
    """Drop the massless root of a floating joint; the joint's child becomes the floating base."""
    what, world = _label(floating[0], ""), floating[0].findall("parent")[0].attrib["link"]
    others = [joint.name for joint in joints if world in (joint.parent, joint.child)]
    massless = [link.name for link in links if link.mass == 0]
    if len(floating) > 1 or others or world not in massless:
        raise ValueError(
            f"{what}: type 'floating' from link {world!r}; expected one such joint, from a massless root link that no "
            f"other joint uses: {_REFUSED_TYPES['floating']}"
        )
    notes[f"dropped link {world!r} and {what}: the base floats, and its pose is part of the state"] += 1
    return tuple(link for link in links if link.name != world)
