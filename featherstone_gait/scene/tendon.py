"""Lay out the tendons of a robot, and the springs between its links, which are tendons with two points.

The stop at a limit is that of a joint (stop.py): the robot's weight, or the effort of the joint with the largest
coefficient c, drives that joint `STOP_DEPTH` into it, and the tendon c times as far.  So a tendon of one joint has the
stop that the joint itself would have.  A path is taken for a joint that slides.  The damping is that of the inertia at
zero, unless it is more than `AT_LIMITS` times the least of several postures, as of an antagonist that has no moment arm
where it rests: see `preflight.py`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..base.fixed_order import applied
from ..core.effects.friction import FRICTION, SOFT, STUCK
from ..core.effects.stop import STOP
from ..core.effects.tendon import BEGIN, BEND, DRIVE, JOINT, PART, POINT, TENDON, TURN, WORLD, Tendons
from ..core.integrate.integrator import Integrator
from ..model import Model, Placement, Tendon, Wrap
from .actuator import pd_laws
from .records import records
from .stop import NO_LIMIT, fill_stop, load_of
from .tree import Tree, wrap_record

IN_WORLD = Placement(WORLD, np.eye(3), np.zeros(3))


def with_rows(tree: Tree, tendons: Sequence[Tendon]) -> Tree:
    """Return the tree with rows of the workspace for tendons."""
    return tree._replace(rows=tree.rows + len(tendons), tendons=len(tendons))


def build_tendons(model: Model, tree: Tree, tendons: Sequence[Tendon]) -> Tendons | None:
    """Lay out tendons, without stops; None without tendons.  tree: with rows for them."""
    if not tendons:
        return None
    parts: list[np.ndarray] = []
    table = records(len(tendons), TENDON)
    body = {int(dof): row for row, dof in enumerate(tree.bodies.dof) if row}
    wraps: list[np.recarray] = []
    tied = np.zeros(len(tendons), int)
    for k, (row, tendon) in enumerate(zip(table, tendons)):
        row.row, row.first = tree.rows - len(tendons) + k, len(parts)
        row.stiffness, row.damping, (row.lower, row.upper) = tendon.stiffness, tendon.damping, tendon.slack
        for name, c in tendon.joints:
            if name in model.held:
                row.offset += c * model.held[name]
            elif name in model.ball_names:
                dof = model.balls[model.ball_names.index(name)]
                parts.append(_part(TURN, body[dof], c, dof, (0.0, 0.0, 0.0)))
            else:
                dof = model.joint_rows[name]
                parts.append(_part(JOINT, body[dof], c, dof, (0.0, 0.0, 0.0)))
        for j, via in enumerate(tendon.path):
            anchored = via.link is None and tree.floating
            place = IN_WORLD if anchored else tree.placements[via.link or model.root]
            at, tied[k] = place.r + applied(place.E, np.array(via.point)), tied[k] or anchored
            if isinstance(via, Wrap):
                parts.append(_part(BEND, place.row, 0.0, len(wraps), at))
                wraps.append(wrap_record(via, place.E))
                continue
            kind = POINT if j and via.share > 0 else BEGIN
            parts.append(_part(kind, place.row, via.share, 0, at))
        row.end = len(parts)
    drives = build_drives(tendons, len(model.moving_joints))
    around = np.concatenate(wraps).view(np.recarray) if wraps else None
    pieces = np.concatenate(parts or [records(0, PART)]).view(np.recarray)
    tied_to = tied if tied.any() else None
    armature = np.array([one.armature for one in tendons])
    rubs = _build_friction(tendons)
    return Tendons(table, pieces, None, drives, around, tied_to, rubs, armature if armature.any() else None)


def _build_friction(tendons: Sequence[Tendon]) -> np.recarray | None:
    """Lay out the dry friction of tendons, as steep as implicit steps take it; None without."""
    table, dry = records(len(tendons), FRICTION), np.array([one.friction for one in tendons])
    table.coulomb_friction = dry
    table.steepness = 1.0 / STUCK
    return table if dry.any() else None


def build_drives(tendons: Sequence[Tendon], joints: int) -> np.recarray | None:
    """Lay out the drives of tendons, whose inputs follow those of so many joints; None without drives."""
    if not any(one.driven for one in tendons):
        return None
    table = pd_laws([one.controller for one in tendons], DRIVE)
    number_drives(table, [one.driven for one in tendons], joints)
    return table


def number_drives(table: np.recarray, driven: Sequence[bool] | np.ndarray, joints: int) -> None:
    """Give the tendons that are driven their inputs, which follow those of so many joints."""
    table.input = np.where(driven, joints - 1 + np.cumsum(driven), -1)


def _part(kind: int, body: int, coefficient: float, dof: int, point: Sequence[float] | np.ndarray) -> np.ndarray:
    part = np.zeros(1, PART)
    for name, value in zip(part.dtype.names or (), (kind, body, dof, coefficient, point)):
        part[name] = value
    return part


def with_stops(
    laid_out: Tendons | None, model: Model, tendons: Sequence[Tendon], inertias: Sequence[float], g: float
) -> Tendons | None:
    """Return the tendons with stops at their limits.

    inertias: those that the tendons feel [kg m^2 or kg]; g: strength of gravity [m/s^2].
    """
    if laid_out is None or not any(one.limited for one in tendons):
        return laid_out
    table = records(len(tendons), STOP)
    for row, tendon, inertia in zip(table, tendons, inertias):
        row.lower, row.upper = max(tendon.lower, -NO_LIMIT), min(tendon.upper, NO_LIMIT)
        joint, c = max(tendon.joints, key=lambda one: abs(one[1]), default=("", 1.0))
        found = next((one for one in model.degrees.joints if one.name == joint), None)
        fill_stop(row, load_of(found, model, g), inertia, abs(c))
    return laid_out._replace(stops=table)


def fold_tendons(tendons: Tendons | None, integrator: Integrator, h: float, inertias: Sequence[float]) -> None:
    """Take the springs at the end of the implicit step h [s] only where their periods need it, all or none.

    As `fold_joint_springs`.  Dry friction is less steep where all steps are explicit.

    inertias: those that the tendons feel [kg m^2 or kg].
    """
    if tendons is not None:
        if tendons.friction is not None and integrator.soft:
            tendons.friction.steepness = 1.0 / SOFT
        stiffness = tendons.table.stiffness + (0.0 if tendons.drives is None else tendons.drives.Kp)
        each = (k / inertia for k, inertia in zip(stiffness, inertias))
        tendons.table.fold = integrator.folds_spring or h * h * math.fsum(each) > 1.0
        if tendons.drives is not None:
            tendons.drives.fold = tendons.table.fold
