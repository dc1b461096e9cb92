"""Save a robot as URDF and TOML, or as MJCF."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from ..base.arguments import instance
from ..base.files import complete_together
from ..model import Ground, HeightField, Joint, Link, Model
from ..model.degrees import ball_name, is_first
from ..model.links import COMPOSITE
from ..model.shapes import Hull, Mesh, Shape
from .gazebo import FIELDS
from .markup import comment, element
from .mjcf.write import mjcf_text
from .sensors import sensor_table
from .servos import PARTS
from .toml import written
from .urdf import DYNAMICS, INERTIA

MJCF = (".xml", ".mjcf")  # suffixes
OWN_NAMES = {"free": "floating"}  # of joint types that URDF calls otherwise


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
    for name in ("friction", "torsional_friction", "rolling_friction"):
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


def _toml_text(model: Model) -> str:
    contacts = [f"  {{{', '.join(_assignments(asdict(contact)))}}}," for contact in model.contacts]
    of_links = {link.name: _of_link(model, link) for link in model.links}
    tables: dict[str, Mapping[str, Any]] = {
        "locked.default": {written(name): position for name, position in model.locked.items()},
        **{f"links.{written(name)}": stated for name, stated in of_links.items() if stated},
        **{f"joints.{written(j.name)}": own for j in model.joints if (own := _own(j))},
        **{f"keyframes.{written(name)}": _posture(model, q) for name, q in model.keyframes.items()},
        **({"supply": asdict(model.supply)} if model.supply else {}),
    }
    for name, servo in model.servos.items():
        parts = (servo.controller, servo.gearbox, servo)
        stated = {f.name: getattr(part, f.name) for part in parts for f in PARTS[type(part)]}
        tables[f"servos.joints.{written(name)}"] = stated
    lines = [line for title, table in tables.items() for line in ("", f"[{title}]", *_assignments(table))]
    for loop in model.loops:
        lines += ["", "[[loops]]", *_assignments(asdict(loop))]
    for tendon in model.tendons:
        stated = _stated(tendon)
        each = ({name: x for name, x in asdict(one).items() if x is not None} for one in tendon.path)
        points = {"path": tuple(each)} if tendon.path else {}
        law = {} if tendon.controller is None else {"controller": _stated(tendon.controller)}
        lines += ["", "[[tendons]]", *_assignments(stated | points | law)]
    for shape in model.immersed:
        geometry = {"shape": type(shape.geometry).__name__.lower(), **asdict(shape.geometry)}
        lines += ["", "[[immersed]]", *_assignments(_stated(shape) | {"geometry": geometry})]
    for sensor in model.sensors:
        table = sensor_table(sensor)
        lines += [f"# left out the sensor {sensor.name!r}, of a channel"] if table is None else []
        lines += [] if table is None else ["", "[[sensors]]", *_assignments(table)]
    for propeller in model.propellers:
        lines += ["", "[[propellers]]", *_assignments(_stated(propeller))]
    excluded = [f"excluded = {written(model.excluded)}"] if model.excluded else []
    return "\n".join([f"base = {written(model.base)}", "contacts = [", *contacts, "]", *excluded, *lines, ""])


def _stated(part: Any) -> dict[str, Any]:
    """Return the fields that differ from their defaults, and those that have none."""
    return {f.name: getattr(part, f.name) for f in fields(part) if getattr(part, f.name) != f.default}


def _of_link(model: Model, link: Link) -> dict[str, Any]:
    """Return what URDF cannot state of a link."""
    found: dict[str, Any] = {"gravity_compensation": link.gravity_compensation} if link.gravity_compensation else {}
    stated = (shape for shape in model.shapes if not isinstance(shape.geometry, Hull | HeightField))
    moving = [shape.surface for shape in stated if shape.link == link.name]
    if any(moving):
        rests = any(point.surface is None for point in model.contacts if point.link == link.name)
        each = tuple(asdict(surface) if surface else {} for surface in moving)
        found["surface"] = each if rests or len({*moving}) > 1 else each[0]
    return found


def _own(joint: Joint) -> dict[str, Any]:
    """Return what URDF cannot state of a joint."""
    names = "armature", "quadratic_stiffness", "cubic_stiffness", "quadratic_damping", "cubic_damping"
    found: dict[str, Any] = {name: getattr(joint, name) for name in names if getattr(joint, name)}
    if joint.degrees:
        found["degrees"] = {name: dict(own) for name, own in dict(joint.degrees).items()}
    return found | ({"upper": joint.upper} if joint.type == "ball" and joint.upper < math.inf else {})


def _posture(model: Model, q: tuple[float, ...]) -> dict[str, Any]:
    """Return a posture by joint name, since other files of the robot may list the joints in another order."""
    first = model.base_positions
    base = {"base": tuple(q[:first])} if first else {}
    joints: dict[str, Any] = {}
    for joint, place in zip(model.moving_joints, model.position_slices):
        if is_first(joint):
            joints[f"joints.{written(ball_name(joint))}"] = tuple(q[place])
        elif joint.type != "ball":
            joints[f"joints.{written(joint.name)}"] = q[place.start]
    return base | joints


def _assignments(table: Mapping[str, Any]) -> list[str]:
    return [f"{key} = {written(value)}" for key, value in table.items() if value is not None]
