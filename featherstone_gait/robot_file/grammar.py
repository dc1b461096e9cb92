"""Report what of a URDF (https://wiki.ros.org/urdf/XML) no reader has asked for.

An element or attribute that URDF does not know is ignored, as urdfdom, Pinocchio and MuJoCo do, unless it seems to mean
something: an unexpanded xacro, a rotation by quaternion, a misspelled name, a link or joint in the wrong place. Of a
repeated element the first counts, as with urdfdom.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from xml.etree.ElementTree import Element, tostring

from .markup import Read, children, meant
from .report import Report

SKIPPED = {  # why what URDF knows is not read, by "element child" or "element @attribute"
    "robot material": "colors do not affect the simulation",
    "robot transmission": "servos and gearboxes come from the TOML file",
    "robot mujoco": "another simulator's settings",
    "robot ros2_control": "controllers come from the TOML file",
    "robot sensor": "sensors come from the TOML file",
    "robot @version": "all versions are read alike",
    "link visual": "visual shapes do not affect the simulation",
    "link @type": "it names a link",
    "joint calibration": "encoders start calibrated",
    "joint safety_controller": "controllers come from the TOML file",
    "joint axis": "the joint turns about no single one",
    "collision verbose": "it names a shape",
    "collision @group": "it names shapes",
    "collision material": "colors do not affect the simulation",
    **{f"limit @{name}": "the servo limits the motion" for name in ("acceleration", "deceleration", "jerk")},
}
PAINT = ("color", "texture")
_MEANINGFUL = {("origin", "quat_xyzw"): "write the rotation as rpy, and remove it"}


def label(element: Element, parent: str = "") -> str:
    """Name an element for messages: link 'shank', or link 'shank' <inertial> <mass>."""
    if element.tag in ("robot", "link", "joint"):
        return f"{element.tag} {element.get('name')!r}"
    return f"{parent} <{element.tag}>".strip()


def tidy(element: Element, what: str, report: Report) -> None:
    """Take commas in a link or joint for spaces, and remove an inertia or axis that says nothing."""
    for child in list(element):
        if child.tag in ("inertial", "axis") and not child.attrib and not len(child):
            found = f"<{child.tag}> is empty"
            report.assume(child, what, found, "as if it were not there", "fill it, or remove it")
            element.remove(child)
        for name in ("xyz", "rpy"):
            text = child.attrib.get(name, "")
            if re.search(r",\s", text):  # `0,5` could be one number or two, and stays for the reader to refuse
                found = f"<{child.tag}> {name}={text[:40]!r} has commas"
                where = label(child, what)
                report.assume(child, where, found, "taken for spaces", "separate the numbers by spaces")
                child.set(name, re.sub(r",(?=\s)", " ", text))
        tidy(child, label(child, what), report)


def need(element: Element, what: str, report: Report, attributes: str = "", tags: str = "") -> None:
    """Report attributes and children that an element lacks."""
    for name in attributes.split():
        if element.get(name) is None:
            report.refuse(element, f"{what}: attribute {name!r} of <{element.tag}> is missing; it is required: add it")
    for tag in tags.split():
        if element.find(tag) is None:
            report.refuse(element, f"{what}: element <{tag}> is missing; exactly one is required: add it")


def pass_over_paint(element: Element) -> None:
    """Ask for all that a <material> may say."""
    for material in children(element, ("material",)):
        material.get("name")
        for child in children(material, PAINT):
            child.get("rgba"), child.get("filename")


def look_through(element: Element, what: str, report: Report) -> None:
    """Report what of an element no reader has asked for, and do the same with its children, but those of <robot>."""
    if not isinstance(element, Read) or element.whole:
        return
    text = "".join([element.text or "", *(child.tail or "" for child in element)]).strip()
    if text:
        remedy = "values stand in attributes: remove it"
        report.assume(element, what, f"stray text {text[:40]!r}", "ignored", remedy)
    for name in element.attrib:
        if why := SKIPPED.get(f"{element.tag} @{name}"):
            report.remark(f"skipped {name} of <{element.tag}>: {why}")
        elif name not in element.names and not (element.tag == "robot" and name.startswith("{")):  # xsi:schemaLocation
            found = f"unknown attribute {name!r} of <{element.tag}>"
            absent = [one for one in element.names if one not in element.attrib]
            _pass_over(element, what, found, [*element.names], _meaning(element.tag, name, absent), report)
    seen: dict[str, int] = {}
    tags = [child.tag for child in element]
    for child in element:
        tag, seen[child.tag] = child.tag, seen.get(child.tag, 0) + 1
        asked = tag in element.tags
        if (why := SKIPPED.get(f"{element.tag} {tag}")) and not (asked and element.tag == "joint"):
            report.remark(f"skipped <{tag}>: {why}")
        elif not asked:
            absent = [one for one in element.tags if one not in tags or element.tag == "robot"]
            expected, meaning = [f"<{one}>" for one in element.tags], _meaning(element.tag, tag, absent)
            _pass_over(child, what, f"unknown element <{tag}>", expected, meaning, report)
        elif seen[tag] == 2 and not element.tags[tag]:
            same = len({tostring(other).strip() for other in element if other.tag == tag}) == 1
            taken = "all the same" if same else "the first was taken"
            remedy = "at most one is allowed: remove the others"
            report.assume(child, what, f"{tags.count(tag)} elements <{tag}>", taken, remedy)
        if asked and element.tag != "robot" and (seen[tag] == 1 or element.tags[tag]):
            look_through(child, label(child, what), report)


def _pass_over(element: Element, what: str, found: str, expected: Iterable[str], meaning: str, report: Report) -> None:
    """Ignore something unknown, or refuse it if it seems to mean something."""
    known = f"expected {', '.join(expected) or 'none'}"
    if meaning:
        report.refuse(element, f"{what}: {found}; {known}: {meaning}")
    else:
        report.assume(element, what, found, "ignored", f"{known}: correct the spelling, or remove it")


def _meaning(parent: str, name: str, absent: list[str]) -> str:
    """Return what to do about an unknown name that seems to mean something; empty if it does not."""
    if "xacro" in name:
        return "expand the file with xacro first"
    if (parent, name) in _MEANINGFUL:
        return _MEANINGFUL[parent, name]
    if name in ("link", "joint", "inertial"):
        return "move it to where it belongs"
    close = meant(name, absent)
    return f"correct the spelling if {close!r} is meant, or remove it" if close else ""
