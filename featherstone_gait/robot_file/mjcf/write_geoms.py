"""Write collision shapes and contact points as geoms, and a floor as soft as the ground's static penetration requires.

At rest MuJoCo's contact of the constant impedance d carries the force f at the depth r with k r = (1 - d) / d w f: w is
the inverse inertia that the body offers to a force, and k = stiffness / d for solref = -stiffness -damping.  Small
motions about that have the stiffness d k and the damping damping, for each unit of mass.  Source: MuJoCo's pages on
computation ("Constraint model") and modeling ("Solver parameters").
"""

from __future__ import annotations

import math
import os
from typing import Any

import numpy as np

from ...base.fixed_order import applied
from ...base.rotation import rotation_from_rpy
from ...dynamics import Wrench, energy, forward_dynamics
from ...model import ContactPoint, Ground, HeightField, Link, Model, Surface
from ...model.links import Vector
from ...model.numpy_dynamics import zero_position
from ...model.shapes import Box, Capsule, Cylinder, Geometry, Hull, Mesh, Shape, Sphere
from ..markup import comment, element
from ..write_toml import rubs
from .tree import FLOOR, unused
from .write_actuators import rotor_inertia

IMPEDANCE = 0.9  # MuJoCo's default
GRAVITY = 9.81  # [m/s^2]
FIELD_BASE = 1.0  # of a height field, thickness below its lowest point [m]
POINT_RADIUS = 1e-4  # of a contact point as a sphere, half the thickness of a circle [m]
READ = (".stl", ".obj", ".msh")  # mesh files
MOST_TRIANGLES = 200_000  # of an STL
ROLLING = (0.005, 0.0001)  # friction of spinning and of rolling, MuJoCo's defaults [m]
MASSLESS = {"mass": "0"}
TOUCHING = {"contype": "1", "conaffinity": "0"}  # a floor, and not each other
SILENT = {"contype": "0", "conaffinity": "0"}


def geom_lines(model: Model, link: str) -> list[str]:
    """Write the shapes and contact points of a link.

    A contact point is a sphere, or a flat cylinder for a circle; if the model has contact points, shapes touch no
    floor.
    """
    names = geom_names(model)
    bits, lines = (SILENT if model.contacts else TOUCHING), []
    for k, shape in enumerate(model.shapes):
        if shape.link == link:
            lines += _shape_lines(k, names[k], shape, bits)
    for name, point in zip(names[len(model.shapes) :], model.contacts):
        if point.link == link:
            moments = _moments(point.friction, None, point.rolling_friction or None)
            lines += element("geom", {"name": name, **_point(point), **MASSLESS, **TOUCHING, **moments})
    return lines


def geom_names(model: Model) -> list[str]:
    """Return names of the shapes, then of the contact points; empty for a shape that has and needs none."""
    names: list[str] = []
    for k, shape in enumerate(model.shapes):
        paired = rubs(shape) or shape.surface or (model.contacts and has_extent(shape.geometry))
        name = shape.name or (f"shape{k}" if paired else "")
        names.append(unused(name, [FLOOR, *names]) if name else "")
    for k in range(len(model.contacts)):
        names.append(unused(f"contact{k}", [FLOOR, *names]))
    return names


def pair_lines(model: Model, ground: Ground | None) -> list[str]:
    """Write what touches the ground with a friction of its own, or resists rolling, as pairs with the floor.

    In pairs, since the floor's friction has priority over that of a geom.
    """
    if ground is None:
        return []
    written = [bool(_geometry(k, shape.geometry)) and not model.contacts for k, shape in enumerate(model.shapes)]
    items: list[Shape | ContactPoint] = [*model.shapes, *model.contacts]
    lines = []
    for name, item, touches in zip(geom_names(model), items, [*written, *[True] * len(model.contacts)]):
        mu, rolls = ground.friction if item.friction is None else item.friction, item.rolling_friction
        if touches and (rolls or item.friction is not None):
            friction = (mu, mu, 0.0, rolls, rolls) if rolls else (mu, mu, *ROLLING, ROLLING[-1])
            stated = {"geom1": FLOOR, "geom2": name, "condim": "6" if rolls else None, "friction": friction}
            lines += element("pair", stated | _give(model, ground))
    return lines


def _shape_lines(k: int, name: str, shape: Shape, bits: dict[str, str]) -> list[str]:
    stated, geometry = _geometry(k, shape.geometry), shape.geometry
    if not stated:
        what = geometry.file if isinstance(geometry, Mesh) else f"{type(geometry).__name__} without extent"
        return [comment(f"left out {name or 'a shape'}: {what}")]
    place = shape.xyz
    if isinstance(geometry, HeightField):  # MuJoCo's lies about its middle, with its lowest node at 0
        low = (*(o + half for o, half in zip(geometry.origin, _halves(geometry))), geometry.heights.min())
        x, y, z = (np.array(place) + applied(rotation_from_rpy(shape.rpy), np.array(low))).tolist()
        place = (x, y, z)
    attributes = {"name": name or None, **stated, "pos": place, "euler": shape.rpy, **MASSLESS, **bits}
    moments = _moments(shape.friction, shape.torsional_friction, shape.rolling_friction)
    return element("geom", attributes | moments | _surface(shape.surface, place, shape.rpy))


def _surface(surface: Surface | None, place: Vector, rpy: Vector) -> dict[str, Any]:
    """Write how a surface moves at its first command, in the frame of a geom that is placed in the link's."""
    if surface is None:
        return {}
    back, turning = rotation_from_rpy(rpy).T, np.array(surface.turning)
    v = np.array(surface.velocity) + np.cross(turning, np.array(place) - np.array(surface.center))
    both = [*applied(back, v), *applied(back, turning)]
    return {"surfacevel": tuple(surface.command * float(x) for x in both)}


def _moments(sliding: float | None, torsional: float | None, rolling: float | None) -> dict[str, Any]:
    """Write what resists spinning and rolling."""
    if torsional is None and rolling is None:
        return {}
    friction = 1.0 if sliding is None else sliding, torsional or 0.0, rolling or 0.0
    return {"condim": "4" if rolling is None else "6", "friction": friction}


def _geometry(k: int, geometry: Geometry) -> dict[str, Any]:
    """Return MuJoCo's type and size of a geometry, or the name of its mesh; empty if MuJoCo does not accept it."""
    match geometry:
        case HeightField():
            return {"type": "hfield", "hfield": f"field{k}"}
        case Hull():
            return {"type": "mesh", "mesh": f"mesh{k}"}
        case Mesh(file):
            return {"type": "mesh", "mesh": f"mesh{k}"} if _readable(file) else {}
        case Sphere(radius):
            size: tuple[float, ...] = (radius,)
        case Box((x, y, z)):
            size = (0.5 * x, 0.5 * y, 0.5 * z)
        case Capsule(radius, length) | Cylinder(radius, length):
            size = (radius, 0.5 * length)
    return {"type": type(geometry).__name__.lower(), "size": size} if min(size) > 0 else {}


def has_extent(geometry: Geometry) -> bool:
    """Return whether MuJoCo accepts a geometry other than a mesh file."""
    return bool(_geometry(0, geometry))


def _readable(file: str) -> bool:
    """Return whether MuJoCo reads a mesh file: it exists, of a known kind, as binary STL or OBJ of finite numbers."""
    kind = os.path.splitext(file)[1].lower()
    if kind not in READ or not os.path.isfile(file):
        return False
    if kind == ".stl":  # a header of 80 bytes, the number of triangles, and 50 bytes for each
        with open(file, "rb") as stream:
            count = int.from_bytes(stream.read(84)[80:], "little")
        return 0 < count <= MOST_TRIANGLES and os.path.getsize(file) == 84 + 50 * count
    with open(file, encoding="utf-8", errors="replace") as stream:
        points = (line for line in stream if line.startswith("v ")) if kind == ".obj" else ()
        return not any("nan" in line or "inf" in line for line in points)


def unread_meshes(model: Model) -> list[str]:
    """Return files of shapes that do not exist, or that MuJoCo does not read."""
    files = dict.fromkeys(shape.geometry.file for shape in model.shapes if isinstance(shape.geometry, Mesh))
    return [file for file in files if not _readable(file)]


def mesh_lines(model: Model) -> list[str]:
    """Write the hulls and height fields, and the files that shapes name.

    They state inertia="shell", since MuJoCo requires a volume even of massless meshes.
    """
    lines = []
    for k, shape in enumerate(model.shapes):
        if isinstance(shape.geometry, HeightField):
            lines += _field_lines(f"field{k}", shape.geometry)
        stated: dict[str, Any] = {}
        match shape.geometry:
            case Hull(points):
                stated = {"vertex": points}
            case Mesh(file, scale) if _readable(file):
                stated = {"file": file, "scale": scale}
        if stated:
            lines += element("mesh", {"name": f"mesh{k}", **stated, "inertia": "shell"})
    return lines


def _point(point: ContactPoint) -> dict[str, Any]:
    if point.circle_radius > 0:
        size = (point.circle_radius, POINT_RADIUS)
        return {"type": "cylinder", "pos": point.position, "zaxis": point.axis, "size": size}
    moving = _surface(point.surface, point.position, (0.0, 0.0, 0.0))
    return {"type": "sphere", "pos": point.position, "size": point.radius or POINT_RADIUS, **moving}


# ---------------------------------------------------------------------------------------------- ground


def floor_lines(model: Model, ground: Ground | None) -> tuple[list[str], list[str]]:
    """Write the ground as a plane or a height field, and return what of the ground is left out."""
    if ground is None:
        return [], []
    if ground.field is None:
        turn = (0.0, -ground.slope, ground.heading)
        place = (0.0, 0.0, ground.height)
        kind = {"type": "plane", "size": "0 0 1", "pos": place, "euler": turn}
        kind |= _surface(_of_ground(ground, rotation_from_rpy(turn)), place, turn)
    else:
        x, y = (o + half for o, half in zip(ground.field.origin, _halves(ground.field)))
        kind = {"type": "hfield", "hfield": FLOOR, "pos": (x, y, ground.height + ground.field.heights.min())}
    floor = {
        "name": FLOOR,
        **kind,
        "friction": (ground.friction, *ROLLING),
        **_give(model, ground),
        "priority": "1",
    }
    left = ["the steps of the ground are left out"] if ground.steps else []
    left += ["the ground ends at the edge of its field, whose cells are two triangles each"] if ground.field else []
    return element("geom", floor), left


def _of_ground(ground: Ground, E: np.ndarray) -> Surface | None:
    """Return how the surface of a plane ground moves in the world; E (3, 3): its tangents and normal, in columns."""
    if not ground.moves:
        return None
    velocity, turning = applied(E, np.array([*ground.velocity, 0.0])), ground.turning * E[:, 2]
    (x, y), normal = ground.center, E[:, 2]
    z = ground.height - float(normal[0] * x + normal[1] * y) / float(normal[2])
    return Surface(tuple(velocity.tolist()), tuple(turning.tolist()), (x, y, z))


def _give(model: Model, ground: Ground) -> dict[str, Any]:
    """Return how the ground gives way."""
    stiffness = GRAVITY * (1.0 - IMPEDANCE) / ground.penetration * _softness(model)
    damping = 2.0 * ground.damping_ratio * math.sqrt(stiffness)
    return {"solref": (-stiffness, -damping), "solimp": (IMPEDANCE, IMPEDANCE, 0.001)}


def _halves(field: HeightField) -> list[float]:
    """Return half the width of a field along x and y [m]."""
    return [0.5 * step * (count - 1) for step, count in zip(field.spacing, field.heights.shape)]


def field_lines(ground: Ground | None) -> list[str]:
    """Write the height field of the ground."""
    return [] if ground is None or ground.field is None else _field_lines(FLOOR, ground.field)


def _field_lines(name: str, field: HeightField) -> list[str]:
    """Write a height field; MuJoCo lists its rows from the largest y down, with heights from 0 to 1 of a size."""
    nx, ny = field.heights.shape
    size = (*_halves(field), float(np.ptp(field.heights)) or FIELD_BASE, FIELD_BASE)
    elevation = (field.heights - field.heights.min()).T[::-1]
    stated = {"nrow": str(ny), "ncol": str(nx), "size": size, "elevation": elevation}
    return element("hfield", {"name": name, **stated})


def _softness(model: Model) -> float:
    """Compute the mean over the contacts of w m / n, their share of the weight by the mass they feel.

    It is 1 without contacts.
    """
    touching = [item.link for item in model.contacts or model.shapes]
    if not touching:
        return 1.0
    links = {link.name: link for link in model.links}
    seen = {name: _inverse_inertia(model, links[name]) for name in dict.fromkeys(touching)}
    return sum(seen[name] for name in touching) / len(touching) ** 2 * model.mass


def _inverse_inertia(model: Model, link: Link) -> float:
    """Compute the mean inverse inertia [1/kg] that a link's center of mass offers to a force along an axis, at zero.

    A unit impulse e gives the velocities M^-1 J' e, and twice their kinetic energy is e' J M^-1 J' e.
    """
    q = zero_position(model)
    armature = np.array([joint.armature + rotor_inertia(model.servos.get(joint.name)) for joint in model.moving_joints])
    still, slack, none = np.zeros(model.nv), np.zeros(len(armature)), (0.0, 0.0, 0.0)
    total = 0.0
    for e in np.eye(3):
        wrench = {link.name: Wrench(e, np.cross(link.center_of_mass, e))}
        qd = forward_dynamics(model, q, still, still, wrench=wrench, armature=armature, stiffness=slack, gravity=none)
        total += 2.0 * float(energy(model, q, qd, armature=armature, gravity=none).kinetic) / 3.0
    return total
