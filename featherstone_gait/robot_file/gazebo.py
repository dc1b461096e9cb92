"""Read what a URDF says about the motion in <gazebo>: springs of joints, and what is doubtful.

Of `<gazebo reference="JOINT">` the elements springStiffness and springReference are read, as Gazebo's converter to SDF
does: the last one counts, its value is text or the attribute `value`.  How Gazebo integrates a spring
(implicitSpringDamper, cfmDamping) does not change its law.
"""

from __future__ import annotations

from typing import Any
from xml.etree.ElementTree import Element

from .markup import number
from .report import Report

FIELDS = {"springStiffness": "stiffness", "springReference": "spring_reference"}  # of Joint
LAWLESS = ("implicitSpringDamper", "cfmDamping")  # of numerics
GRAVITY = {"turnGravityOff": ("1", "true", "yes"), "gravity": ("0", "false", "no")}  # and what switches it off
SPRINGS = ("spring_stiffness", "spring_reference", "spring_constant", *FIELDS)


def read_gazebo(root: Element, report: Report) -> dict[str, dict[str, Any]]:
    """Read stiffness and reference of the joints' springs, by joint; elements that are understood are removed."""
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
            elif not (name in joints and child.tag in LAWLESS):
                _doubt(gazebo, child, what, report)
                continue
            gazebo.remove(child)
        if name in joints and not len(gazebo):
            root.remove(gazebo)
    return read


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
    elif child.tag in ("joint", "link"):
        report.assume(gazebo, what, f"<{child.tag}> of SDF", "ignored", "write it as URDF, outside of <gazebo>")
