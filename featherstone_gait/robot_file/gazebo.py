"""Read what a URDF says about the motion in <gazebo>: springs of joints, friction of links, and what is doubtful.

Of `<gazebo reference="JOINT">` the elements springStiffness and springReference are read, as Gazebo's converter to SDF
does: the last one counts, its value is text or the attribute `value`.  How Gazebo integrates a spring
(implicitSpringDamper, cfmDamping) does not change its law.  Of `<gazebo reference="LINK">` mu1 is the friction of its
shapes; a mu2 that differs, across, is reported.
"""

from __future__ import annotations

from typing import Any, NamedTuple
from xml.etree.ElementTree import Element

from .markup import number, unread
from .report import Report

FIELDS = {"springStiffness": "stiffness", "springReference": "spring_reference"}  # of Joint
LAWLESS = ("implicitSpringDamper", "cfmDamping")  # of numerics
YES = ("1", "true", "yes")
GRAVITY = {"turnGravityOff": YES, "gravity": ("0", "false", "no")}  # and what switches it off
FRICTION = ("mu1", "mu2")
SPRINGS = ("spring_stiffness", "spring_reference", "spring_constant", *FIELDS)


class Gazebo(NamedTuple):
    """Hold what Gazebo adds to joints and links."""

    joints: dict[str, dict[str, Any]]  # fields of Joint, by joint
    frictions: dict[str, float]  # by link


def read_gazebo(root: Element, report: Report) -> Gazebo:
    """Read the joints' springs and the links' friction; the elements are removed."""
    links = {link.get("name", "") for link in root.iterfind("link")}
    slip: dict[str, dict[str, float]] = {}
    skipped: dict[str, None] = {}
    joints = {joint.get("name", "") for joint in root.iterfind("joint") if joint.get("type") != "fixed"}
    read: dict[str, dict[str, Any]] = {}
    for gazebo in root.findall("gazebo"):
        name = gazebo.get("reference", "")
        what = f"<gazebo reference={name!r}>" if name else "<gazebo>"
        for child in list(gazebo):
            if name in joints and child.tag in FIELDS:
                with report.blaming(gazebo):
                    read.setdefault(name, {})[FIELDS[child.tag]] = _value(child, f"{what} <{child.tag}>")
            elif name in joints and child.tag == "damping":
                with report.blaming(gazebo):
                    read.setdefault(name, {})["damping"] = _value(child, f"{what} <damping>")
                    found, taken = "<damping>, which Gazebo does not read there", "taken for that of <dynamics>"
                    report.assume(gazebo, what, found, taken, "write it as <dynamics damping=...> of the joint")
            elif name in links and child.tag in FRICTION:
                with report.blaming(gazebo):
                    slip.setdefault(name, {})[child.tag] = _value(child, f"{what} <{child.tag}>")
            else:
                if not (name in joints and child.tag in LAWLESS):
                    _doubt(gazebo, child, what, report)
                skipped[f"<{child.tag}>"] = None
                continue
            for _, part, _ in unread(child):
                _ignore(gazebo, part, child.tag, what, report)
        for part in (name for name in gazebo.attrib if name != "reference"):
            _ignore(gazebo, part, "gazebo", what, report)
        mu = slip.get(name, {})
        if len({*mu.values()}) == 2:
            found = f"<mu1> {mu['mu1']} and <mu2> {mu['mu2']} differ"
            report.assume(gazebo, what, found, "the first in all directions", "give both the same number")
        root.remove(gazebo)
    if skipped:
        report.remark(f"skipped <gazebo>, another simulator's settings: {', '.join(skipped)}")
    return Gazebo(read, {name: mu.get("mu1", next(iter(mu.values()))) for name, mu in slip.items() if mu})


def _ignore(gazebo: Element, part: str, tag: str, what: str, report: Report) -> None:
    report.assume(gazebo, what, f"unknown {part!r} of <{tag}>", "ignored", "correct the spelling, or remove it")


def _value(child: Element, what: str) -> float:
    """Return the number of an element."""
    return number(Element(child.tag, {"value": _said(child)}), "value", what)


def _said(child: Element) -> str:
    return str(child.get("value", child.text or "")).strip().lower()


def _doubt(gazebo: Element, child: Element, what: str, report: Report) -> None:
    """Report what changes the motion and is ignored."""
    said = _said(child)
    springs = sorted({f"<{element.tag}>" for element in child.iter() if element.tag in SPRINGS})
    if springs:
        remedy = "write <gazebo reference=JOINT> with <springStiffness> and <springReference>, or remove it"
        report.assume(gazebo, what, f"{', '.join(springs)} of no joint that moves", "ignored", remedy)
    elif child.tag in GRAVITY and said in GRAVITY[child.tag]:
        remedy = "state gravity_compensation = 1 of links in the TOML file for that, and remove it"
        report.assume(gazebo, what, f"<{child.tag}> switches gravity off in Gazebo", "gravity acts", remedy)
    elif child.tag == "dampingFactor" and said not in ("", "0", "0.0"):
        report.assume(gazebo, what, f"<dampingFactor> {said[:40]}", "ignored", "use <dynamics damping=...> of joints")
    elif child.tag == "static" and said in YES:
        report.assume(
            gazebo, what, "<static>: nothing moves in Gazebo", "it moves", 'fix it with base="fixed" and locked'
        )
    elif child.tag in FRICTION:
        report.assume(gazebo, what, f"<{child.tag}> of no link", "ignored", "correct the reference, or remove it")
    elif child.tag in ("joint", "link"):
        report.assume(gazebo, what, f"<{child.tag}> of SDF", "ignored", "write it as URDF, outside of <gazebo>")
