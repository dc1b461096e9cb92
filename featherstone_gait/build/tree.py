"""From links and joints to the bodies that kernels read: merging, locking, frames, order and accumulators."""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np

from ..core.layout import BODY, COLUMNS
from ..model import Joint, Link, Model, inertia_matrix, rotation_from_rpy

GRAVITY = (0.0, 0.0, -9.81)  # [m/s^2]


class Placement(NamedTuple):
    """Where a link sits: the moving body that carries it and its frame in that body's frame."""

    row: int  # row of the body; 0 is the world or the floating base
    E: np.ndarray  # (3, 3) rotation link -> body frame
    r: np.ndarray  # (3,) origin of the link frame in the body frame [m]


class Tree(NamedTuple):
    """A model laid out for the kernels."""

    bodies: np.recarray  # (n + 1,) BODY
    floating: bool
    names: tuple[str, ...]  # of the rows: the root link, then each joint's child
    placements: dict[str, Placement]  # of every link
    rows: int  # of the workspace: bodies, slots, contact rows

    @property
    def n(self) -> int:
        """Number of moving joints."""
        return len(self.bodies) - 1

    def workspace_shape(self) -> tuple[int, int]:
        return (self.rows, COLUMNS)


@functools.lru_cache(maxsize=64)
def compile_tree(model: Model) -> Tree:
    """Merge what is rigidly connected, turn every joint to z and order bodies depth first, parents before children."""
    links = {link.name: link for link in model.links}
    order = _depth_first(model)
    dof = {name: k for k, name in enumerate(model.joint_names)}
    bodies = np.zeros(len(dof) + 1, BODY)
    bodies[0]["E"] = np.eye(3).ravel()
    root = ({link.name for link in model.links} - {joint.child for joint in model.joints}).pop()
    placements = {root: Placement(0, np.eye(3), np.zeros(3))}
    groups: list[list[str]] = [[root]]
    for joint in order:
        parent = placements[joint.parent]
        E = parent.E @ rotation_from_rpy(joint.rpy)
        r = parent.r + parent.E @ np.array(joint.xyz)
        if joint.name not in dof:
            E, r = _held(joint, model.locked.get(joint.name, 0.0), E, r)
            placements[joint.child] = Placement(parent.row, E, r)
            groups[parent.row].append(joint.child)
            continue
        Q = _rotation_z_to(joint.axis)
        row = len(groups)
        body = bodies[row]
        body["parent"], body["dof"], body["prismatic"] = parent.row, dof[joint.name], joint.type == "prismatic"
        body["E"], body["r"] = (E @ Q).ravel(), r
        placements[joint.child] = Placement(row, Q.T, np.zeros(3))
        groups.append([joint.child])
    for body, group in zip(bodies, groups):
        _merge(body, [(links[name], placements[name]) for name in group])
    rows = len(bodies) + _assign_slots(bodies)
    for row in sorted({placements[point.link].row for point in model.contacts}):
        bodies[row]["contact"] = rows
        rows += 1
    names = tuple(group[0] for group in groups)
    return Tree(bodies.view(np.recarray), model.base == "floating", names, placements, rows)


def _depth_first(model: Model) -> list[Joint]:
    """The joints so that each chain is contiguous: the accumulator of a chain is then reused along it."""
    children: dict[str, list[Joint]] = {}
    for joint in model.joints:
        children.setdefault(joint.parent, []).append(joint)
    root = ({link.name for link in model.links} - {joint.child for joint in model.joints}).pop()
    order, stack = [], children.get(root, [])[::-1]
    while stack:
        joint = stack.pop()
        order.append(joint)
        stack.extend(children.get(joint.child, [])[::-1])
    return order


def rotation_axis(axis, angle: float) -> np.ndarray:
    """Rotation about a unit axis (Rodrigues)."""
    x, y, z = axis
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * K + (1 - math.cos(angle)) * (K @ K)


def _held(joint: Joint, position: float, E, r) -> tuple[np.ndarray, np.ndarray]:
    """The child frame of a fixed or locked joint."""
    if position == 0.0:
        return E, r
    if joint.type == "prismatic":
        return E, r + E @ (position * np.array(joint.axis))
    return E @ rotation_axis(joint.axis, position), r


def _rotation_z_to(axis) -> np.ndarray:
    """A rotation that takes z to the unit vector `axis`; entries are exactly 0 and 1 for coordinate axes."""
    z = np.array(axis)
    x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
    x /= math.sqrt(x @ x)
    return np.column_stack([x, np.cross(z, x), z])


def _merge(body, group: list[tuple[Link, Placement]]) -> None:
    """Mass, centre of mass and inertia of the links that move as one, in the body's frame."""
    m = math.fsum(link.mass for link, _ in group)
    centers = [place.r + place.E @ np.array(link.center_of_mass) for link, place in group]
    c = sum((link.mass * center for (link, _), center in zip(group, centers)), np.zeros(3))
    c = c / m if m > 0 else c
    J = np.zeros((3, 3))
    for (link, place), center in zip(group, centers):
        d = center - c
        J += place.E @ inertia_matrix(link.inertia) @ place.E.T + link.mass * ((d @ d) * np.eye(3) - np.outer(d, d))
    body["m"], body["c"] = m, c
    body["J"] = J[[0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]


def _assign_slots(bodies) -> int:
    """Give each parent an accumulator row, reusing rows whose parent has been passed; return how many are needed."""
    n = len(bodies)
    slot = [-1] * n
    free: list[int] = []
    used = 0
    for i in range(n - 1, -1, -1):
        bodies[i]["leaf"] = slot[i] < 0
        if slot[i] >= 0:
            free.append(slot[i])
        parent = bodies[i]["parent"]
        if i > 0 and slot[parent] < 0:
            bodies[i]["last"] = 1
            if not free:
                free.append(used)
                used += 1
            slot[parent] = free.pop()
    bodies["slot"] = [n + max(s, 0) for s in slot]
    return used
