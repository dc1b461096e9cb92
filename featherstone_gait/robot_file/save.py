"""Save a robot as URDF and TOML, or as MJCF."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import Field, fields
from pathlib import Path
from xml.sax.saxutils import quoteattr

from ..base.arguments import instance
from ..base.files import complete_together
from ..model import Ground, Joint, Link, Model
from ..model.shapes import Box, Capsule, Cylinder, Hull, Mesh, Shape, Sphere
from .mjcf.write import mjcf_text
from .servos import PARTS
from .toml import written
from .urdf import INERTIA, JOINT_NUMBERS

MJCF = (".xml", ".mjcf")  # suffixes


def save_robot(model: Model, path: str | os.PathLike, ground: Ground | None = None) -> None:
    """Save a robot as URDF with a TOML file beside it, or as MJCF (.xml or .mjcf) for MuJoCo.

    Loading the URDF gives the same numbers to the last bit; locked joints become the set "default" of the TOML file.

    MJCF keeps the dynamics to rounding, lists joints depth first, and says in comments what it lacks: servos become the
    closest actuators, contact points small geoms, locked joints welds.  Links that move as one get one inertia together
    if MuJoCo refuses that of one of them, and moving points get 1e-15 kg m^2.  Missing mesh files are left out.

    Parameters
    ----------
    model : Model
        The robot.
    path : str or path
        Path that ends in .urdf, .xml or .mjcf.  All files are written in full before any takes its place.
    ground : Ground, optional
        For MJCF: a floor of this friction and softness.

    Raises
    ------
    ValueError
        For another suffix, and for a robot that the format cannot state: MJCF refuses inertias that no rigid body has,
        which ``load_robot(..., repair_inertia=True)`` repairs.
    OSError
        If the files cannot be written.
    """
    instance("model", model, Model, "give what load_robot returns")
    instance("path", path, (str, os.PathLike), "give the path of a file")
    if ground is not None:
        instance("ground", ground, Ground, "write ground=Ground()")
    path = Path(path)
    if path.suffix in MJCF:
        texts = {path: mjcf_text(model, ground)}
    elif path.suffix == ".urdf":
        texts = {path: _urdf_text(model), path.with_suffix(".toml"): _toml_text(model)}
    else:
        raise ValueError(f"{path}: the file name must end in .urdf, where the TOML goes beside it, or in .xml for MJCF")
    if ground is not None and path.suffix == ".urdf":
        raise ValueError(f"{path}: URDF states no ground; give it to compile_scene, or write .xml")
    with complete_together(*texts) as temporaries:
        for temporary, text in zip(temporaries, texts.values()):
            temporary.write_text(text, encoding="utf-8", newline="\n")


def _urdf_text(model: Model) -> str:
    lines = ['<?xml version="1.0" encoding="utf-8"?>', f"<robot name={quoteattr(model.name)}>"]
    for link in model.links:
        lines += _link_lines(link, [shape for shape in model.shapes if shape.link == link.name])
    for joint in model.joints:
        lines += _joint_lines(joint)
    return "\n".join([*lines, "</robot>", ""])


def _link_lines(link: Link, shapes: list[Shape]) -> list[str]:
    inertial = [] if link.mass == 0 and not any((*link.center_of_mass, *link.inertia)) else _inertial_lines(link)
    lines = [*inertial, *(line for shape in shapes for line in _shape_lines(shape))]
    if not lines:
        return [f"  <link name={quoteattr(link.name)}/>"]
    return [f"  <link name={quoteattr(link.name)}>", *lines, "  </link>"]


def _inertial_lines(link: Link) -> list[str]:
    inertia = " ".join(f'{name}="{float(value)!r}"' for name, value in zip(INERTIA, link.inertia))
    return [
        "    <inertial>",
        f'      <origin xyz="{_numbers(link.center_of_mass)}"/>',
        f'      <mass value="{float(link.mass)!r}"/>',
        f"      <inertia {inertia}/>",
        "    </inertial>",
    ]


def _shape_lines(shape: Shape) -> list[str]:
    if isinstance(shape.geometry, Hull):
        return [f"    <!-- a hull of {len(shape.geometry.points)} points, which URDF cannot state -->"]
    named = f" name={quoteattr(shape.name)}" if shape.name else ""
    return [
        f"    <collision{named}>",
        f'      <origin xyz="{_numbers(shape.xyz)}" rpy="{_numbers(shape.rpy)}"/>',
        f"      <geometry>{_geometry(shape)}</geometry>",
        "    </collision>",
    ]


def _geometry(shape: Shape) -> str:
    match shape.geometry:
        case Sphere(radius):
            return f'<sphere radius="{float(radius)!r}"/>'
        case Capsule(radius, length):
            return f'<capsule radius="{float(radius)!r}" length="{float(length)!r}"/>'
        case Cylinder(radius, length):
            return f'<cylinder radius="{float(radius)!r}" length="{float(length)!r}"/>'
        case Box(size):
            return f'<box size="{_numbers(size)}"/>'
        case Mesh(file, scale):
            return f'<mesh filename={quoteattr(file)} scale="{_numbers(scale)}"/>'
        case Hull():
            raise AssertionError("URDF cannot state a hull")


def _joint_lines(joint: Joint) -> list[str]:
    lines = [
        f'  <joint name={quoteattr(joint.name)} type="{joint.type}">',
        f"    <parent link={quoteattr(joint.parent)}/>",
        f"    <child link={quoteattr(joint.child)}/>",
        f'    <origin xyz="{_numbers(joint.xyz)}" rpy="{_numbers(joint.rpy)}"/>',
    ]
    if joint.type != "fixed":
        limit = " ".join(f'{name}="{value!r}"' for name, value in _stated_limits(joint).items())
        lines += [
            f'    <axis xyz="{_numbers(joint.axis)}"{_stated(joint, "axis")}/>',
            f"    <limit {limit}/>",
            f"    <dynamics{_stated(joint, 'dynamics')}/>",
            *_mimic_lines(joint),
        ]
    return [*lines, "  </joint>"]


def _mimic_lines(joint: Joint) -> list[str]:
    if joint.mimic is None:
        return []
    numbers = f'multiplier="{float(joint.mimic.multiplier)!r}" offset="{float(joint.mimic.offset)!r}"'
    return [f"    <mimic joint={quoteattr(joint.mimic.joint)} {numbers}/>"]


def _stated(joint: Joint, tag: str) -> str:
    """Format the joint's numbers that are attributes of an element."""
    return "".join(f' {name}="{float(getattr(joint, name))!r}"' for name in JOINT_NUMBERS.get(tag, ()))


def _stated_limits(joint: Joint) -> dict[str, float]:
    """Return the limits that URDF can state: no infinite effort or velocity; raise ValueError for infinite stops."""
    limits = {name: float(getattr(joint, name)) for name in ("lower", "upper", "effort", "velocity")}
    if joint.type != "continuous" and not all(math.isfinite(limits[name]) for name in ("lower", "upper")):
        raise ValueError(
            f"joint {joint.name!r}: URDF cannot state the limits {joint.lower!r} to {joint.upper!r} of type "
            f"{joint.type!r}; give finite ones, or use type 'continuous'"
        )
    return {name: value for name, value in limits.items() if math.isfinite(value)}


def _toml_text(model: Model) -> str:
    lines = [f"base = {written(model.base)}", "contacts = ["]
    lines += [f"  {{{', '.join(_assignments(contact, fields(contact)))}}}," for contact in model.contacts]
    lines += ["]", "", "[locked.default]"]
    lines += [f"{written(name)} = {written(position)}" for name, position in model.locked.items()]
    for joint in model.joints:
        if joint.armature:
            lines += ["", f"[joints.{written(joint.name)}]", f"armature = {written(joint.armature)}"]
    for name, q in model.keyframes.items():
        lines += ["", f"[keyframes.{written(name)}]", *_posture_lines(model, q)]
    if model.supply is not None:
        lines += ["", "[supply]", *_assignments(model.supply, fields(model.supply))]
    for name, servo in model.servos.items():
        lines += ["", f"[servos.joints.{written(name)}]"]
        for part in (servo.controller, servo.gearbox, servo):
            lines += _assignments(part, PARTS[type(part)])
    return "\n".join([*lines, ""])


def _posture_lines(model: Model, q: tuple[float, ...]) -> list[str]:
    """Write a posture by joint name, since other files of the robot may list the joints in another order."""
    first = model.nq - len(model.joint_names)
    base = [f"base = {written(tuple(q[:first]))}"] if first else []
    return [*base, *(f"joints.{written(name)} = {written(x)}" for name, x in zip(model.joint_names, q[first:]))]


def _assignments(record: object, of: Sequence[Field]) -> list[str]:
    """Write fields of a record as lines `key = value`."""
    return [f"{f.name} = {written(getattr(record, f.name))}" for f in of]


def _numbers(values: tuple[float, ...]) -> str:
    return " ".join(repr(float(value)) for value in values)
