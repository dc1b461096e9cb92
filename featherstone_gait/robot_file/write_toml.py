"""Write as TOML what URDF and MJCF cannot state of a robot: beside a URDF as a file, within MJCF as a <text>."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import asdict, fields
from typing import Any

from ..model import HeightField, Joint, Link, Model, Tendon
from ..model.degrees import ball_name, is_first
from ..model.fluid import Immersed
from ..model.pair_friction import FIELDS
from ..model.shapes import Hull, Shape
from .sensors import sensor_table
from .servos import PARTS
from .settings import PASSIVE
from .toml import written


def toml_text(model: Model) -> str:
    """Write what URDF cannot state."""
    tables: dict[str, Mapping[str, Any]] = {"locked.default": {written(k): at for k, at in model.locked.items()}}
    of_links = {link.name: _of_link(model, link) for link in model.links}
    tables |= {f"links.{written(name)}": stated for name, stated in of_links.items() if stated}
    tables |= {f"joints.{written(j.name)}": own for j in model.joints if (own := _own(j))}
    tables |= {f"keyframes.{written(name)}": _posture(model, q) for name, q in model.keyframes.items()}
    lines = [f"base = {written(model.base)}", *contact_lines(model)]
    lines += touching_lines(model.excluded, model.included)
    tables |= shape_tables(
        {shape.name: shape for shape in model.shapes if shape.name and rubs(shape) and is_in_urdf(shape)}
    )
    lines += [*table_lines(tables), *drive_lines(model, model.servos)]
    for loop in model.loops:
        lines += ["", "[[loops]]", *_assignments(asdict(loop))]
    return "\n".join(
        [*lines, *_tendon_lines(model.tendons), *immersed_lines(model.immersed), *carried_lines(model), ""]
    )


def touching_lines(excluded: tuple[tuple[str, str], ...], included: tuple[tuple[str, str], ...]) -> list[str]:
    """Return the lines of what does not touch, and of the neighbors that do."""
    pairs = {"excluded": excluded, "included": included}
    return [f"{name} = {written(value)}" for name, value in pairs.items() if value]


def _tendon_lines(tendons: Iterable[Tendon]) -> list[str]:
    lines: list[str] = []
    for tendon in tendons:
        stated = _stated(tendon)
        each = ({name: x for name, x in asdict(one).items() if x is not None} for one in tendon.path)
        points = {"path": tuple(each)} if tendon.path else {}
        law = {} if tendon.controller is None else {"controller": _stated(tendon.controller)}
        lines += ["", "[[tendons]]", *_assignments(stated | points | law)]
    return lines


def mjcf_lines(
    model: Model,
    joints: Iterable[Joint],
    servos: Collection[str],
    immersed: Iterable[Immersed],
    tendons: Iterable[Tendon],
    geoms: tuple[str, ...],
    shapes: Mapping[str, Shape],
) -> list[str]:
    """Write what MJCF cannot state.

    joints: as they are written; servos: joints whose servos MJCF does not state, and whose friction and inertia stand
    with the joint there; immersed, tendons: those that MJCF does not state; geoms: those of contact points; shapes: by
    geom, those of which MJCF does not state all.
    """
    tables: dict[str, Mapping[str, Any]] = {}
    for joint in joints:
        names = [name for name in PASSIVE if joint.name in servos or name == "velocity"]
        stated = {name: x for name in names if not (x := getattr(joint, name)) == math.inf}
        tables |= {f"joints.{written(joint.name)}": stated} if stated else {}
    tables |= shape_tables(shapes)
    points = [*(contact_lines(model) if geoms else []), f"geoms = {written(geoms)}"] if geoms or model.shapes else []
    return [
        *points,
        *table_lines(tables),
        *drive_lines(model, servos),
        *_tendon_lines(tendons),
        *immersed_lines(immersed),
        *carried_lines(model),
    ]


def is_in_urdf(shape: Shape) -> bool:
    """Return whether URDF has an element for a shape."""
    return not isinstance(shape.geometry, Hull | HeightField)


def rubs(shape: Shape) -> bool:
    """Return whether a shape states friction or priority of its own."""
    return any(getattr(shape, name) is not None for name in (*FIELDS, "priority"))


def shape_tables(shapes: Mapping[str, Shape]) -> dict[str, dict[str, Any]]:
    """Return the tables of shapes, by their names."""
    tables = {}
    for name, shape in shapes.items():
        stated = {key: getattr(shape, key) for key in (*FIELDS, "priority")}
        tables[f"shapes.{written(name)}"] = stated | {"surface": shape.surface and asdict(shape.surface)}
    return tables


def contact_lines(model: Model) -> list[str]:
    """Write the contact points."""
    return ["contacts = [", *(f"  {{{', '.join(_assignments(asdict(one)))}}}," for one in model.contacts), "]"]


def table_lines(tables: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Write tables."""
    return [line for title, table in tables.items() for line in ("", f"[{title}]", *_assignments(table))]


def drive_lines(model: Model, servos: Collection[str]) -> list[str]:
    """Write the source, and the servos of some joints."""
    tables: dict[str, Mapping[str, Any]] = {"supply": asdict(model.supply)} if model.supply else {}
    for name, servo in ((name, servo) for name, servo in model.servos.items() if name in servos):
        parts = (servo.controller, servo.gearbox, servo)
        stated = {f.name: getattr(part, f.name) for part in parts for f in PARTS[type(part)]}
        tables[f"servos.joints.{written(name)}"] = stated
    ranges = {written(name): limits for name, limits in model.references.items() if name in servos}
    return table_lines(tables | ({"references": ranges} if ranges else {}))


def immersed_lines(immersed: Iterable[Immersed]) -> list[str]:
    """Write shapes on which a fluid acts."""
    lines: list[str] = []
    for shape in immersed:
        geometry = {"shape": type(shape.geometry).__name__.lower(), **asdict(shape.geometry)}
        lines += ["", "[[immersed]]", *_assignments(_stated(shape) | {"geometry": geometry})]
    return lines


def carried_lines(model: Model) -> list[str]:
    """Write propellers and sensors."""
    lines = sensor_lines(model.sensors)
    for propeller in model.propellers:
        lines += ["", "[[propellers]]", *_assignments(_stated(propeller))]
    return lines


def sensor_lines(sensors: Iterable[Any]) -> list[str]:
    """Write sensors, but those of a channel."""
    tables = filter(None, map(sensor_table, sensors))
    return [line for table in tables for line in ("", "[[sensors]]", *_assignments(table))]


def _stated(part: Any) -> dict[str, Any]:
    """Return the fields that differ from their defaults, and those that have none."""
    return {f.name: getattr(part, f.name) for f in fields(part) if getattr(part, f.name) != f.default}


def _of_link(model: Model, link: Link) -> dict[str, Any]:
    """Return what URDF cannot state of a link."""
    found: dict[str, Any] = {"gravity_compensation": link.gravity_compensation} if link.gravity_compensation else {}
    moving = [shape.surface for shape in filter(is_in_urdf, model.shapes) if shape.link == link.name]
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
