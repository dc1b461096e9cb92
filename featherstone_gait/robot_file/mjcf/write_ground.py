"""Write a floor as soft as the ground's static penetration requires.

At rest MuJoCo's contact of the constant impedance d carries the force f at the depth r with k r = (1 - d) / d w f: w is
the inverse inertia that the body offers to a force, and k = stiffness / d for solref = -stiffness -damping.  Small
motions about that have the stiffness d k and the damping damping, for each unit of mass.  Source: MuJoCo's pages on
computation ("Constraint model") and modeling ("Solver parameters").
"""

from __future__ import annotations

import math

import numpy as np

from ...dynamics import Wrench, energy, forward_dynamics
from ...model import Ground, HeightField, Link, Model
from .element import element, numbers
from .write_actuators import rotor_inertia
from .write_geoms import FLOOR

IMPEDANCE = 0.9  # MuJoCo's default
GRAVITY = 9.81  # [m/s^2]
FIELD_BASE = 1.0  # of a height field, thickness below its lowest point [m]


def floor_lines(model: Model, ground: Ground | None) -> tuple[list[str], list[str]]:
    """Write the ground as a plane or a height field, and return what of the ground is left out."""
    if ground is None:
        return [], []
    stiffness = GRAVITY * (1.0 - IMPEDANCE) / ground.penetration * _softness(model)
    damping = 2.0 * ground.damping_ratio * math.sqrt(stiffness)
    floor = {
        "name": FLOOR,
        **(_plane(ground) if ground.field is None else _field(ground.field, ground.height)),
        "friction": numbers((ground.friction, 0.005, 0.0001)),
        "solref": numbers((-stiffness, -damping)),
        "solimp": numbers((IMPEDANCE, IMPEDANCE, 0.001)),
        "priority": "1",
    }
    left = ["the steps of the ground are left out"] if ground.steps else []
    left += ["the ground ends at the edge of its field, whose cells are two triangles each"] if ground.field else []
    return [element("geom", floor)], left


def _plane(ground: Ground) -> dict[str, str]:
    return {
        "type": "plane",
        "size": "0 0 1",
        "pos": numbers((0.0, 0.0, ground.height)),
        "euler": numbers((0.0, -ground.slope, ground.heading)),
    }


def _field(field: HeightField, height: float) -> dict[str, str]:
    x, y = (o + half for o, half in zip(field.origin, _halves(field)))
    return {"type": "hfield", "hfield": FLOOR, "pos": numbers((x, y, height + field.heights.min()))}


def _halves(field: HeightField) -> list[float]:
    """Return half the width of a field along x and y [m]."""
    return [0.5 * step * (count - 1) for step, count in zip(field.spacing, field.heights.shape)]


def field_lines(ground: Ground | None) -> list[str]:
    """Write the height field; MuJoCo lists its rows from the largest y down, with heights from 0 to 1 of a size."""
    if ground is None or ground.field is None:
        return []
    field, (nx, ny) = ground.field, ground.field.heights.shape
    size = (*_halves(field), float(np.ptp(field.heights)) or FIELD_BASE, FIELD_BASE)
    elevation = numbers((field.heights - field.heights.min()).T[::-1].ravel().tolist())
    stated = {"nrow": str(ny), "ncol": str(nx), "size": numbers(size), "elevation": elevation}
    return [element("hfield", {"name": FLOOR, **stated})]


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
    q = np.zeros(model.nq)
    if model.base == "floating":
        q[3] = 1.0
    armature = np.array([joint.armature + rotor_inertia(model.servos.get(joint.name)) for joint in model.moving_joints])
    still, none = np.zeros(model.nv), (0.0, 0.0, 0.0)
    total = 0.0
    for e in np.eye(3):
        wrench = {link.name: Wrench(e, np.cross(link.center_of_mass, e))}
        qd = forward_dynamics(model, q, still, still, wrench=wrench, armature=armature, gravity=none)
        total += 2.0 * float(energy(model, q, qd, armature=armature, gravity=none).kinetic) / 3.0
    return total
