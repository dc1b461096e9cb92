"""Read what other programs add to the shapes and joints of a URDF: friction of Drake and SDF, rotors of Drake."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any
from xml.etree.ElementTree import Element

from .grammar import label
from .markup import number
from .report import Report

ODE = "friction/ode"  # of <surface>, as SDF has it


def local(element: Element) -> str:
    """Return the name of an element without its namespace."""
    return str(element.tag).rpartition("}")[2]


def read_frictions(root: Element, report: Report) -> dict[Element, float]:
    """Read the coefficients of friction of <collision>s; elements that are understood are removed."""
    read: dict[Element, float] = {}
    for link in root.iterfind("link"):
        for collision in link.iterfind("collision"):
            for child in list(collision):
                found = _READERS.get(local(child))
                if found is not None:
                    collision.remove(child)
                    with report.blaming(collision):
                        mu = found(child, f"{label(link)} <collision>", collision, report)
                        read |= {} if mu is None else {collision: mu}
            for geometry in collision.iterfind("geometry"):
                for parent in list(geometry.iter()):
                    for child in [one for one in parent if local(one) == "declare_convex"]:
                        parent.remove(child)  # as all meshes are
    return read


def read_rotors(root: Element, report: Report) -> dict[str, dict[str, Any]]:
    """Read what rotors of Drake add to the inertia of joints, by joint: rotor_inertia gear_ratio²."""
    read: dict[str, dict[str, Any]] = {}
    for transmission in root.iterfind("transmission"):
        joint = next((str(one.get("name", "")) for one in transmission.iterfind("joint")), "")
        what, stated = f"<transmission> of joint {joint!r}", dict[str, float]()
        for one in transmission.iter():
            if local(one) in ("gear_ratio", "rotor_inertia") and one.tag != local(one):
                with report.blaming(transmission):
                    stated[local(one)] = number(one, "value", f"{what} <{local(one)}>")
            elif one.tag == "mechanicalReduction":
                report.remark(f"skipped <mechanicalReduction> of the {what}: it turns no rotor")
        ratio, inertia = stated.get("gear_ratio", 1.0), stated.get("rotor_inertia", 0.0)
        if "rotor_inertia" in stated:
            read[joint] = {"armature": ratio * ratio * inertia}
        elif stated:
            report.remark(f"skipped <gear_ratio> of the {what}: it turns no rotor")
    for joint in read.keys() - {one.get("name", "") for one in root.iterfind("joint")}:
        report.refuse(
            None, f"<transmission>: there is no joint {joint!r} for its rotor; correct the name, or remove it"
        )
    return read


def _of_drake(child: Element, what: str, collision: Element, report: Report) -> float | None:
    """Return mu_dynamic, which counts where nothing slips too, else mu_static."""
    stated = {local(one): number(one, "value", f"{what} <{local(one)}>") for one in child if "mu_" in local(one)}
    _skip(report, "<proximity_properties>", [local(one) for one in child if local(one) not in stated])
    return stated.get("mu_dynamic", stated.get("mu_static"))


def _of_coefficients(child: Element, what: str, collision: Element, report: Report) -> float | None:
    _skip(report, "<contact_coefficients>", [name for name in child.attrib if name != "mu"])
    return number(child, "mu", f"{what} <contact_coefficients>") if "mu" in child.attrib else None


def _of_surface(child: Element, what: str, collision: Element, report: Report) -> float | None:
    """Return mu of SDF, which programs that read URDF pass over; report what else it says."""
    said = {path: Element(local(one), {"value": (one.text or "").strip()}) for path, one in _leaves(child)}
    read = {
        path: number(said[path], "value", f"{what} <surface>") for path in (f"{ODE}/mu", f"{ODE}/mu2") if path in said
    }
    ignored = [path for path in said if path not in read]
    if len({*read.values()}) == 2:
        ignored.append(f"{ODE}/mu2")
    mu = next(iter(read.values()), None)
    taken = ["no friction" if mu is None else f"friction {mu:g}", *(f"{path} ignored" for path in ignored)]
    remedy = "state friction in [shapes.NAME] of the TOML file, and remove it"
    report.assume(collision, what, "<surface> of SDF", ", ".join(taken), remedy)
    return mu


def _leaves(element: Element, path: str = "") -> Iterator[tuple[str, Element]]:
    """Yield the elements without children below one, by path."""
    for child in element:
        name = f"{path}{local(child)}"
        yield from _leaves(child, f"{name}/") if len(child) else [(name, child)]


def _skip(report: Report, where: str, names: list[str]) -> None:
    if names:
        remedy = "contacts give way as Ground and PairContact say"
        report.remark(f"skipped {', '.join(names)} of {where}: {remedy}")


_READERS = {"proximity_properties": _of_drake, "contact_coefficients": _of_coefficients, "surface": _of_surface}
