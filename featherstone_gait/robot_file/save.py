"""Save a robot as URDF and TOML, or as MJCF."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ..base.arguments import instance, truth
from ..base.files import complete_together
from ..model import Ground, HeightField, Joint, Link, Model
from ..model.links import COMPOSITE
from ..model.pair_friction import FIELDS as FRICTIONS
from ..model.shapes import Hull, Mesh, Shape
from .gazebo import FIELDS
from .markup import comment, element
from .mjcf.write import mjcf_text
from .report import refuse_losses, warn_losses
from .sensors import sensor_table
from .urdf import DYNAMICS, INERTIA
from .write_toml import is_in_urdf, rubs, toml_text

MJCF = (".xml", ".mjcf")  # suffixes
OWN_NAMES = {"free": "floating"}  # of joint types that URDF calls otherwise


def save_robot(model: Model, path: str | os.PathLike, ground: Ground | None = None, *, strict: bool = False) -> None:
    """Save a robot as URDF with a TOML file beside it, or as MJCF (.xml or .mjcf) for MuJoCo.

    Loading the URDF gives the same numbers to the last bit; locked joints become the set "default" of the TOML file.

    MJCF keeps the dynamics to rounding and lists joints depth first: servos become the closest actuators, contact
    points small geoms, locked joints welds.  Links that move as one get one inertia together if MuJoCo refuses that of
    one of them, and moving points get 1e-15 kg m^2.  Missing mesh files are left out.  A <text> has for `load_robot`
    what MJCF has no element for: servos, contact points, sensors, propellers, immersed shapes, velocities of joints.
    One RobotFileWarning, and comments in the file, name what another program misses in it.

    Parameters
    ----------
    model : Model
        The robot.
    path : str or path
        Path that ends in .urdf, .xml or .mjcf.  All files are written in full before any takes its place.
    ground : Ground, optional
        For MJCF: a floor of this friction and softness.
    strict : bool, optional
        Raise an error in place of the warning, and write nothing.

    Raises
    ------
    ValueError
        For another suffix, and for a robot that the format cannot state: MJCF refuses inertias that no rigid body has,
        which ``load_robot(..., repair_inertia=True)`` repairs.
    RobotFileError
        A ValueError that lists all that the file would lack, with `strict`.
    OSError
        If the files cannot be written.
    """
    instance("model", model, Model, "give what load_robot returns")
    instance("path", path, (str, os.PathLike), "give the path of a file")
    if ground is not None:
        instance("ground", ground, Ground, "write ground=Ground()")
    truth("strict", strict)
    path = Path(path)
    if path.suffix in MJCF:
        text, lost = mjcf_text(model, ground)
        texts = {path: text}
    elif path.suffix == ".urdf":
        texts, lost = {path: _urdf_text(model), path.with_suffix(".toml"): toml_text(model)}, _lost(model)
    else:
        raise ValueError(f"{path}: the file name must end in .urdf, where the TOML goes beside it, or in .xml for MJCF")
    if ground is not None and path.suffix == ".urdf":
        raise ValueError(f"{path}: URDF states no ground; give it to compile_scene, or write .xml")
    if strict:
        refuse_losses(path, lost)
    with complete_together(*texts) as temporaries:
        for temporary, text in zip(temporaries, texts.values()):
            temporary.write_text(text, encoding="utf-8", newline="\n")
    warn_losses(path, lost, stacklevel=2)


def _lost(model: Model) -> list[str]:
    """Return what neither URDF nor its TOML file state of a robot."""
    of_kind: dict[str, list[str]] = {}
    for k, shape in enumerate(model.shapes):
        kind, name = type(shape.geometry).__name__, f"{shape.name or k} of link {shape.link}"
        if not is_in_urdf(shape):
            of_kind.setdefault(f"left out shapes of the kind {kind}, which URDF does not state", []).append(name)
            continue
        if rubs(shape) and not shape.name:
            of_kind.setdefault("left out friction and priority of shapes, which take a name", []).append(name)
    for sensor in model.sensors:
        if sensor_table(sensor) is None:
            of_kind.setdefault("left out sensors of a channel", []).append(sensor.name)
    return [f"{what}: {', '.join(map(repr, names))}" for what, names in of_kind.items()]


def _urdf_text(model: Model) -> str:
    links = [line for link in model.links for line in _link_lines(link, model.shapes)]
    joints = [line for joint in model.joints for line in _joint_lines(joint)]
    robot = element("robot", {"name": model.name}, [*links, *joints])
    return "\n".join(['<?xml version="1.0" encoding="utf-8"?>', *robot, ""])


def _link_lines(link: Link, shapes: Sequence[Shape]) -> list[str]:
    inside = [line for shape in shapes if shape.link == link.name for line in _shape_lines(shape)]
    if link.mass != 0 or any((*link.center_of_mass, *link.inertia)):
        origin, mass = element("origin", {"xyz": link.center_of_mass}), element("mass", {"value": link.mass})
        inertia = element("inertia", dict(zip(INERTIA, link.inertia)))
        inside = element("inertial", {}, [*origin, *mass, *inertia]) + inside
    return element("link", {"name": link.name}, inside)


def _shape_lines(shape: Shape) -> list[str]:
    match shape.geometry:
        case Hull(points):
            return [comment(f"a hull of {len(points)} points, which URDF cannot state")]
        case HeightField():
            return [comment("a height field, which URDF cannot state")]
        case Mesh(file, scale):
            geometry = element("mesh", {"filename": file, "scale": scale})
        case other:  # whose fields are named as in URDF
            geometry = element(type(other).__name__.lower(), asdict(other))
    origin = element("origin", {"xyz": shape.xyz, "rpy": shape.rpy})
    for name in FRICTIONS:
        if (value := getattr(shape, name)) is not None:
            origin += [comment(f"its {name.replace('_', ' ')} is {value!r}, which URDF cannot state")]
    if shape.surface is not None:
        origin += [comment("its surface moves as the TOML file says")]
    return element("collision", {"name": shape.name or None}, [*origin, *element("geometry", {}, geometry)])


def _joint_lines(joint: Joint) -> list[str]:
    parts: dict[str, dict[str, Any]] = {
        "parent": {"link": joint.parent},
        "child": {"link": joint.child},
        "origin": {"xyz": joint.xyz, "rpy": joint.rpy},
    }
    if joint.type not in ("fixed", "ball", "free"):
        parts["axis"] = {"xyz": joint.axis}
    if joint.axis2 is not None:
        parts["axis2"] = {"xyz": joint.axis2}
    if joint.type == "screw":
        parts["screw"] = {"pitch": joint.pitch}
    if joint.type != "fixed":
        parts["limit"] = _stated_limits(joint)
        parts["dynamics"] = {name: getattr(joint, name) for name in DYNAMICS}
    if joint.type != "fixed" and joint.mimic:
        parts["mimic"] = asdict(joint.mimic)
    inside = [line for tag, attributes in parts.items() for line in element(tag, attributes)]
    sprung = joint.stiffness or joint.cubic_stiffness
    spring = element("gazebo", {"reference": joint.name}, _spring_lines(joint)) if sprung else []
    return [*element("joint", {"name": joint.name, "type": OWN_NAMES.get(joint.type, joint.type)}, inside), *spring]


def _spring_lines(joint: Joint) -> list[str]:
    return [f"<{tag}>{float(getattr(joint, name))!r}</{tag}>" for tag, name in FIELDS.items()]


def _stated_limits(joint: Joint) -> dict[str, float]:
    """Return the limits that URDF can state: no infinite effort or velocity; raise ValueError for infinite stops."""
    limits = {name: float(getattr(joint, name)) for name in ("lower", "upper", "effort", "velocity")}
    if joint.type == "ball" or (
        joint.type in (*COMPOSITE, "screw") and (joint.lower, joint.upper) == (-math.inf, math.inf)
    ):
        return {name: limits[name] for name in ("effort", "velocity") if math.isfinite(limits[name])}
    if joint.type != "continuous" and not all(math.isfinite(limits[name]) for name in ("lower", "upper")):
        raise ValueError(
            f"joint {joint.name!r}: URDF cannot state the limits {joint.lower!r} to {joint.upper!r} of type "
            f"{joint.type!r}; give finite ones, or use type 'continuous'"
        )
    return {name: value for name, value in limits.items() if math.isfinite(value)}
