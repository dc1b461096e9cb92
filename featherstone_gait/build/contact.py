"""Contact points and ground."""

from __future__ import annotations

import math

import numpy as np

from ..core.effects.contact import PLANE, POINT, RISE, Contact
from ..dynamics import contact_positions
from ..elementary import sincos
from ..fixed_order import applied
from ..model import Ground, Model
from ..rotation import dot
from .records import fill, records
from .tree import Tree


def build_contact(model: Model, tree: Tree, ground: Ground | None, gravity: np.ndarray) -> Contact | None:
    """What can touch what under gravity (3,) [m/s^2], None without ground; ValueError where it has no meaning."""
    if ground is None:
        return None
    if not model.contacts:
        raise ValueError(f"{model.name}: ground without contact points; add contacts to its TOML, or ground=None")
    plane, g = _plane(ground), math.sqrt(dot(gravity, gravity))
    if not dot(plane[0].normal, gravity) < 0:
        raise ValueError(
            f"{model.name}: ground under gravity {tuple(gravity.tolist())} m/s^2, which presses nothing on it: its "
            "stiffness follows from the robot's weight; give a gravity that points into the ground, or ground=None"
        )
    return Contact(_points(model, tree, ground, g), plane, _rises(ground))


def _points(model: Model, tree: Tree, ground: Ground, g: float) -> np.recarray:
    """Stiffness and damping from sinking and damping ratio: k = m g / (N sinking), and for small motions about rest
    c = 2 zeta sqrt(k m / N), which Hunt and Crossley's law has at its static depth for d = 2 zeta / sqrt(g sinking)."""
    contacts = [model.contacts[k] for k in by_body(model, tree)]
    share = model.mass / len(contacts)
    k = share * g / ground.sinking
    table = records(len(contacts), POINT)
    for row, point in zip(table, contacts):
        place = tree.placements[point.link]
        fill(row, point, ground)
        row.body, row.position = place.row, place.r + applied(place.E, np.array(point.position))
        row.stiffness, row.damping = k, 2.0 * ground.damping_ratio / math.sqrt(g * ground.sinking)
        row.tangential_stiffness = k
        row.tangential_damping = 2.0 * max(ground.damping_ratio, 0.1) * math.sqrt(k * share)
    return table


def by_body(model: Model, tree: Tree) -> list[int]:
    """Indices of the contact points, those of one body together."""
    rows = [tree.placements[point.link].row for point in model.contacts]
    return sorted(range(len(rows)), key=rows.__getitem__)


def _plane(ground: Ground) -> np.recarray:
    s, c = sincos(ground.slope)
    plane = records(1, PLANE)
    plane[0].normal, plane[0].first, plane[0].second = (-s, 0.0, c), (c, 0.0, s), (0.0, 1.0, 0.0)
    plane[0].height = ground.height * c
    return plane


def _rises(ground: Ground) -> np.recarray:
    table = records(len(ground.steps), RISE)
    for row, (start, rise) in zip(table, ground.steps):
        row.start, row.rise = start, rise
    return table


def standing_height(model: Model, ground: Ground, q: np.ndarray) -> float:
    """Height of the base [m] at which the lowest contact point in the posture q has sunk in by the ground's sinking."""
    clearances = []
    s, c = sincos(ground.slope)
    for x in contact_positions(model, q):
        surface = ground.height + s / c * x[0]
        along = c * x[0] + s * surface
        rises = sum(rise for start, rise in ground.steps if along > start)
        clearances.append(x[2] - surface - rises / c)
    return -min(clearances) - ground.sinking / c


def fallen_height(model: Model, fraction: float) -> float:
    """Height of the base over the ground [m] below which the robot lies: a fraction of its own in the zero posture."""
    q = np.zeros(model.nq)
    q[3] = 1.0
    return -fraction * min(x[2] for x in contact_positions(model, q))
