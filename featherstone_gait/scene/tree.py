"""Lay rigid bodies and couplings out in the rows that kernels read; find positions that agree with the couplings."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ..base.fixed_order import applied, product
from ..base.rotation import dot, rotation_z_to
from ..core.tree.coupling import COUPLING
from ..core.tree.layout import BALL, BALL_AXIS, BODY, COLUMNS, PRISMATIC, REVOLUTE, SCREW
from ..core.tree.wrap import INSIDE, OUTSIDE, WRAP
from ..model import Model, Placement, RigidBody, Wrap, rigid_bodies
from .records import fill, records

GRAVITY = (0.0, 0.0, -9.81)  # [m/s^2]
KINDS = {"prismatic": PRISMATIC, "screw": SCREW}  # all others turn
AGREEMENT = 1e-9  # how far a follower may be from where its leader wants it [rad or m; rad/s or m/s]


class Tree(NamedTuple):
    """A model laid out for the kernels."""

    bodies: np.recarray  # (n + 1,) BODY
    floating: bool
    names: tuple[str, ...]  # of the rows: the root link, then each joint's child
    placements: dict[str, Placement]  # of every link
    rows: int  # of the workspace: bodies, slots, rows of contacts and fluids, couplings, tendons
    coupling: np.recarray | None  # (couplings,) COUPLING
    trees: np.recarray | None = None  # (trees,) TREE of a scene of several trees
    balls: np.ndarray | None = None  # (balls,) first coordinate of each ball joint
    tendons: int = 0  # the last rows are theirs

    @property
    def n(self) -> int:
        """Number of moving joints."""
        return len(self.bodies) - (1 if self.trees is None else len(self.trees))

    @property
    def bases(self) -> int:
        """Number of bases that have coordinates."""
        return int(self.floating) if self.trees is None else len(self.trees)

    def split_positions(self, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """Split the joints' part of q to degrees (rows, n), 0 of ball joints, and quaternions (rows, 4 balls)."""
        if self.balls is None:
            return joints, None
        single, turned, at, dof = np.zeros((len(joints), self.n)), [], 0, 0
        first = set(self.balls.tolist())
        while dof < self.n:
            if dof in first:
                turned.append(joints[:, at : at + 4])
                at, dof = at + 4, dof + 3
            else:
                single[:, dof] = joints[:, at]
                at, dof = at + 1, dof + 1
        return single, np.concatenate(turned, axis=1)

    def workspace_shape(self) -> tuple[int, int]:
        """Return rows and columns of the workspace."""
        return (self.rows, COLUMNS)


def compile_tree(model: Model) -> Tree:
    """Lay the rigid bodies out in rows, parents before children, and assign their accumulators."""
    return _compiled(model.skeleton)


@functools.lru_cache(maxsize=256)  # more than a batch of worlds has
def _compiled(model: Model) -> Tree:
    merged, placements = rigid_bodies(model)
    bodies = np.zeros(len(merged), BODY)
    for row, body in zip(bodies, merged):
        _fill(row, body, model.joint_rows)
    balls = _mark_balls(model, merged, bodies)
    rows = len(bodies) + _assign_slots(bodies)
    acted_on = [*(point.link for point in model.contacts), *(shape.link for shape in model.immersed)]
    for row in sorted({placements[link].row for link in acted_on}):
        bodies[row]["contact"] = rows
        rows += 1
    moved = {body.frame.joint.name: k for k, body in enumerate(merged) if body.frame.joint is not None}
    coupling = _build_coupling(model, moved)
    names = tuple(body.links[0] for body in merged)
    return Tree(bodies.view(np.recarray), model.base == "floating", names, placements, rows, coupling, balls=balls)


def wrap_record(wrap: Wrap, E: np.ndarray) -> np.recarray:
    """Return the WRAP record of a shape whose link has the rotation E (3, 3) in its body."""
    row = np.zeros(1, WRAP).view(np.recarray)
    axis = np.array(wrap.axis)
    own = rotation_z_to(axis / math.sqrt(dot(axis, axis)))
    row.cylinder, row.radius, row.E = wrap.shape == "cylinder", wrap.radius, product(E, own).ravel()
    if wrap.side is not None:
        row.side = side = applied(own.T, np.array(wrap.side) - wrap.point)
        row.sided = INSIDE if math.sqrt(dot(side, side)) < wrap.radius else OUTSIDE
    return row


def joint_armature(model: Model) -> np.ndarray | None:
    """Return the armature of the moving joints (n,) [kg m^2 or kg]; None if no joint has any, which costs nothing."""
    armature = np.array([joint.armature for joint in model.moving_joints])
    return armature if armature.any() else None


def _fill(row: np.void, body: RigidBody, dof: Mapping[str, int]) -> None:
    """Write a body's frame and mass into its row."""
    joint, row["parent"], E, row["r"] = body.frame
    row["E"] = E.ravel()
    if joint is not None:
        fill(row, joint)
        row["dof"], row["carrier"] = dof[joint.name], row["parent"]
        row["kind"] = KINDS.get(joint.type, REVOLUTE)
    row["m"], row["c"] = body.mass, body.center
    row["J"] = body.inertia[[0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]


def _mark_balls(model: Model, merged: list[RigidBody], bodies: np.ndarray) -> np.ndarray | None:
    """Mark the rows of ball joints, and return the first coordinate of each; None if there are none."""
    number = {dof: k for k, dof in enumerate(model.balls)}
    for row, body in zip(bodies, merged):
        if body.frame.joint is not None and body.frame.joint.type == "ball":
            up = bodies[row["parent"]]
            first = row["dof"] in number
            row["kind"] = BALL if first else BALL_AXIS
            row["ball"] = number[int(row["dof"])] if first else up["ball"]
            row["carrier"] = row["parent"] if first else up["carrier"]
    return np.array(model.balls, dtype=np.int64) if model.balls else None


def _assign_slots(bodies: np.ndarray) -> int:
    """Assign an accumulator row to each parent, and return how many are needed.

    Rows are reused when their parent has been passed.
    """
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


def _build_coupling(model: Model, rows: dict[str, int]) -> np.recarray | None:
    """Build the COUPLING records, None without coupled joints; rows: bodies by the joints that move them."""
    dof, table = model.joint_rows, records(len(model.couplings), COUPLING)
    for row, (follower, leader, multiplier, offset) in zip(table, model.couplings):
        row.body, row.dof = rows[follower], dof[follower]
        row.leader, row.leader_dof = rows[leader], dof[leader]
        row.multiplier, row.offset = multiplier, offset
    return table if len(table) else None


def followed(coupling: np.recarray | None, joints: np.ndarray) -> np.ndarray:
    """Return positions of the joints (n,) [rad or m] in which followers are where their leaders put them."""
    joints = joints.copy()
    for k in () if coupling is None else coupling:
        joints[k.dof] = k.multiplier * joints[k.leader_dof] + k.offset
    return joints


def check_followers(model: Model, coupling: np.recarray | None, q: np.ndarray, qd: np.ndarray) -> None:
    """Raise ValueError unless followers have the positions q (n,) and velocities qd (n,) that their leaders ask for."""
    if coupling is None:
        return
    names = model.joint_names
    for k in coupling:
        for what, unit, x, offset in (("q", "", q, k.offset), ("qd", "/s", qd, 0.0)):
            wanted = k.multiplier * x[k.leader_dof] + offset
            if not abs(x[k.dof] - wanted) <= AGREEMENT * max(1.0, abs(wanted)):
                kind = "m" if model.moving_joints[k.dof].type == "prismatic" else "rad"
                raise ValueError(
                    f"{model.name}: {what} of joint {names[k.dof]} is {float(x[k.dof])!r} {kind}{unit}, but it follows "
                    f"{names[k.leader_dof]}: give {float(wanted)!r} {kind}{unit}, or another {what} of the latter"
                )
