"""The elements that a URDF may hold (https://wiki.ros.org/urdf/XML), and what happens to others.

An element or attribute that URDF does not know is ignored, as urdfdom, Pinocchio and MuJoCo do, unless it seems to mean
something: an unexpanded xacro, a rotation by quaternion, a misspelled name, a link or joint in the wrong place. Of a
repeated element the first counts, as with urdfdom.
"""

from __future__ import annotations

import difflib
import re
from collections import Counter
from typing import NamedTuple
from xml.etree.ElementTree import Element, tostring

from .report import Report

SIMILAR = 0.8  # from here on a name is taken for a misspelled one (difflib's ratio)


class _Grammar(NamedTuple):
    """The attributes and children that an element of the URDF may hold."""

    required: str = ""  # attributes
    optional: str = ""
    needs: str = ""  # children, exactly one of each
    reads: str = ""  # children, at most one of each but of `_MANY`


_URDF = {
    "robot": _Grammar(optional="name version", reads="link joint"),
    "link": _Grammar(required="name", optional="type", reads="inertial collision"),
    "inertial": _Grammar(needs="mass inertia", reads="origin"),
    "collision": _Grammar(optional="name group", reads="origin geometry material"),
    "visual": _Grammar(optional="name", reads="origin geometry material"),
    "geometry": _Grammar(reads="box sphere cylinder capsule mesh"),
    "box": _Grammar(optional="size"),  # a shape without its size is left out by its reader
    "sphere": _Grammar(optional="radius"),
    "cylinder": _Grammar(optional="radius length"),
    "capsule": _Grammar(optional="radius length"),
    "mesh": _Grammar(optional="filename scale"),
    "material": _Grammar(optional="name", reads="color texture"),
    "color": _Grammar(optional="rgba"),
    "texture": _Grammar(optional="filename"),
    "mass": _Grammar(required="value"),
    "inertia": _Grammar(required="ixx iyy izz", optional="ixy ixz iyz"),
    "origin": _Grammar(optional="xyz rpy"),
    "joint": _Grammar(required="name type", needs="parent child", reads="origin axis axis2 screw limit dynamics mimic"),
    "parent": _Grammar(required="link"),
    "child": _Grammar(required="link"),
    "axis": _Grammar(required="xyz"),
    "axis2": _Grammar(required="xyz"),  # of a universal joint; URDF knows neither
    "screw": _Grammar(required="pitch"),
    "limit": _Grammar(optional="lower upper effort velocity acceleration deceleration jerk"),
    "dynamics": _Grammar(optional="damping friction"),
    "mimic": _Grammar(required="joint", optional="multiplier offset"),
}
_SKIPPED = {
    "robot": {
        "material": "colors do not affect the simulation",
        "transmission": "servos and gearboxes come from the TOML file",
        "mujoco": "another simulator's settings",
        "ros2_control": "controllers come from the TOML file",
    },
    "link": {"visual": "visual shapes do not affect the simulation"},
    "joint": {
        "calibration": "encoders start calibrated",
        "safety_controller": "controllers come from the TOML file",
    },
    "collision": {"verbose": "it names a shape"},
}
_MANY = {"robot": ("link", "joint"), "link": ("collision",)}  # children of which there may be several
_EMPTY_IS_ABSENT = ("inertial", "axis")
_MEANINGFUL = {("origin", "quat_xyzw"): "write the rotation as rpy, and remove it"}


def label(element: Element, parent: str = "") -> str:
    """Name an element for messages: link 'shank', or link 'shank' <inertial> <mass>."""
    if element.tag in ("robot", "link", "joint"):
        return f"{element.tag} {element.get('name')!r}"
    return f"{parent} <{element.tag}>".strip()


def tidy(element: Element, what: str, report: Report) -> None:
    """Remove from an element all that is not read, report it, and do the same with its children.

    The children of <robot> are left for separate calls.
    """
    text = "".join([element.text or "", *(child.tail or "" for child in element)]).strip()
    if text:
        remedy = "values stand in attributes: remove it"
        report.assume(element, what, f"stray text {text[:40]!r}", "ignored", remedy)
    _tidy_attributes(element, what, report)
    _tidy_children(element, what, report)
    for child in element:
        if element.tag != "robot":
            tidy(child, label(child, what), report)


def _tidy_attributes(element: Element, what: str, report: Report) -> None:
    grammar = _URDF[element.tag]
    required, optional = grammar.required.split(), grammar.optional.split()
    missing = [name for name in (*required, *optional) if name not in element.attrib]
    for name in required:
        if name not in element.attrib:
            report.refuse(element, f"{what}: attribute {name!r} of <{element.tag}> is missing; it is required: add it")
    for name in list(element.attrib):
        if name in required or name in optional:
            _tidy_commas(element, name, what, report)
        elif not (element.tag == "robot" and name.startswith("{")):  # xsi:schemaLocation and the like
            found = f"unknown attribute {name!r} of <{element.tag}>"
            expected = f"expected {', '.join(required + optional) or 'none'}"
            _pass_over(element, what, found, expected, _meaning(element.tag, name, missing), report)


def _tidy_commas(element: Element, name: str, what: str, report: Report) -> None:
    """Read commas followed by a space as separators.

    `0,5` could be one number or two, and stays for the reader to refuse.
    """
    text = element.attrib[name]
    if name in ("xyz", "rpy") and re.search(r",\s", text):
        found = f"<{element.tag}> {name}={text[:40]!r} has commas"
        report.assume(element, what, found, "taken for spaces", "separate the numbers by spaces")
        element.set(name, re.sub(r",(?=\s)", " ", text))


def _tidy_children(element: Element, what: str, report: Report) -> None:
    grammar, skipped = _URDF[element.tag], _SKIPPED.get(element.tag, {})
    legal = f"{grammar.needs} {grammar.reads}".split()
    tags = [child.tag for child in element]
    many = _MANY.get(element.tag, ())
    seen: Counter[str] = Counter()
    for child in list(element):
        if child.tag in skipped:
            report.remark(f"skipped <{child.tag}>: {skipped[child.tag]}")
        elif child.tag not in legal:
            missing = [tag for tag in legal if tag not in tags or element.tag == "robot"]
            expected = f"expected {', '.join(f'<{tag}>' for tag in legal) or 'none'}"
            meaning = _meaning(element.tag, child.tag, missing)
            _pass_over(child, what, f"unknown element <{child.tag}>", expected, meaning, report)
        elif child.tag in _EMPTY_IS_ABSENT and not child.attrib and not len(child):
            found = f"<{child.tag}> is empty"
            report.assume(child, what, found, "as if it were not there", "fill it, or remove it")
        else:
            seen[child.tag] += 1
            if seen[child.tag] == 1 or child.tag in many:
                continue
            if seen[child.tag] == 2:
                texts = {tostring(other).strip() for other in element.iterfind(child.tag)}
                found = f"{tags.count(child.tag)} elements <{child.tag}>"
                same = "all the same" if len(texts) == 1 else "the first was taken"
                report.assume(child, what, found, same, "at most one is allowed: remove the others")
        element.remove(child)
    for tag in grammar.needs.split():
        if tag not in tags:
            report.refuse(element, f"{what}: element <{tag}> is missing; exactly one is required: add it")


def _pass_over(element: Element, what: str, found: str, expected: str, meaning: str, report: Report) -> None:
    """Ignore something unknown, or refuse it if it seems to mean something."""
    if meaning:
        report.refuse(element, f"{what}: {found}; {expected}: {meaning}")
    else:
        report.assume(element, what, found, "ignored", f"{expected}: correct the spelling, or remove it")


def _meaning(parent: str, name: str, missing: list[str]) -> str:
    """Return what to do about an unknown name that seems to mean something; empty if it does not."""
    if "xacro" in name:
        return "expand the file with xacro first"
    if (parent, name) in _MEANINGFUL:
        return _MEANINGFUL[parent, name]
    if name in ("link", "joint", "inertial"):
        return "move it to where it belongs"
    close = difflib.get_close_matches(name[:40], missing, 1, SIMILAR)
    return f"correct the spelling if {close[0]!r} is meant, or remove it" if close else ""
