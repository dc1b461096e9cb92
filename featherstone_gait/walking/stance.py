"""How a biped stands: its soles, the joints of its legs, and the size that scales a walk.

It stands in the keyframe "stand", "standing" or "home" of its file; without one with all joints at zero.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..base.arguments import texts
from ..base.brief import brief
from ..base.fixed_order import applied, product, total
from ..base.rotation import cross, rotation_from_quaternion
from ..dynamics import contact_positions_at
from ..dynamics.jacobians import point_at
from ..model import Model
from ..model.rest_posture import standing_keyframe
from .inverse_kinematics import leg_joints, leg_length_to, mid_range, nearest
from .kinematics import center_of_mass, joint_limits, link_index, link_poses

SOLE_THICKNESS = 1e-3  # contact points this close to a foot's lowest one belong to its sole [m]
BENT = 0.1  # share of the way to the middle of a joint's range, by which a knee that is straight in a keyframe bends
HIGHER, HEIGHTS = 0.5, 201  # how much higher than in its keyframe a robot may stand, in its heights; those tried
NEAR = 2e-3  # tolerance of a sole that is in reach [m and rad]


@dataclass(frozen=True, eq=False)
class Sole:
    """A foot's sole, level as the robot stands.

    Attributes
    ----------
    link : str
        Link of the foot.
    middle : ndarray, shape (3,)
        Middle of the sole in the link's axes [m].
    corners : ndarray, shape (k, 2)
        Contact points from the middle, in world axes [m].
    rotation : ndarray, shape (3, 3)
        Rotation, link to world, with the sole level and the robot facing along x.
    joints : tuple of int
        Columns of the leg's joints; those that move both feet belong to neither leg.
    """

    link: str
    middle: np.ndarray
    corners: np.ndarray
    rotation: np.ndarray
    joints: tuple[int, ...]

    __repr__ = brief


class Size(NamedTuple):
    """Hold the lengths of a biped that set the size of its steps [m]."""

    leg: float  # length of a leg
    height: float  # of the center of mass over soles on straight legs
    half_width: float  # distance of a sole from the middle


def standing(model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Return the joint angles (nj,) [rad] at which a robot stands and its root's rotation (3, 3), facing along x."""
    q, n = standing_keyframe(model), len(model.joint_names)
    if model.balls:
        names = ", ".join(model.ball_names)
        raise ValueError(f"{model.name}: servos that walk turn single axes, and {names} are ball joints; lock them")
    if q is None:
        return np.zeros(n), np.eye(3)
    root = rotation_from_quaternion(q[3:7]) if model.base == "floating" else np.eye(3)
    (c, s), size = root[:2, 0], math.sqrt(root[0, 0] ** 2 + root[1, 0] ** 2)
    if size > 0.0:
        root = product(np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, size]]) / size, root)
    return q[model.nq - n :], root


def soles_of(model: Model, feet: Sequence[str] | None = None) -> tuple[Sole, ...]:
    """Find the left and the right sole from the contact points, as the robot stands; `feet`: as of `walking_plan`.

    Raises ValueError for a model without two soles.
    """
    angles, root = standing(model)
    poses = link_poses(model, angles)
    points, links = contact_positions_at(model, poses)[0], np.array([contact.link for contact in model.contacts])
    placed = {link: applied(root, points[links == link]) for link in dict.fromkeys(links.tolist())}
    if feet is None:
        feet = sorted(placed, key=lambda link: placed[link][:, 2].min())[:2]
        feet.sort(key=lambda link: -placed[link][:, 1].mean())
    feet = texts("feet", feet, "give the names of the left and the right foot")
    if len(feet) != 2 or not all(link in list(placed) for link in feet):
        raise ValueError(f"model {model.name!r}: a walk needs contact points on two feet, got {feet} of {list(placed)}")
    legs, soles = [leg_joints(model, link) for link in feet], []
    for k, (i, link) in enumerate((link_index(model, link), link) for link in feet):
        at, rotation = placed[link], product(root, poses.rotation[0, i])
        if standing_keyframe(model) is not None:
            turn = _to_level(at)
            at, rotation = applied(turn, at), product(turn, rotation)
        low = at[:, 2] < at[:, 2].min() + SOLE_THICKNESS
        if low.sum() < 3:
            raise ValueError(
                f"model {model.name!r}: the sole of {link!r} needs 3 or more contact points, got {low.sum()}"
            )
        middle = total(points[links == link][low], axis=0) / low.sum()
        local = applied(poses.rotation[0, i].T, middle - poses.position[0, i])
        corners = (at[low] - total(at[low], axis=0) / low.sum())[:, :2]
        joints = tuple(column for column in legs[k] if column not in legs[1 - k])
        soles.append(Sole(link, local, corners, rotation, joints))
    return tuple(soles)


def _to_level(points: np.ndarray) -> np.ndarray:
    """Return the rotation (3, 3) that levels the plane on which a foot with `points` (k, 3) rests when pressed down.

    No point lies below it, and no other plane of which that is true is higher at the middle of the points.
    """
    from scipy.optimize import linprog

    x, y, z = (points - total(points, axis=0) / len(points)).T
    a, b, _ = linprog([0.0, 0.0, -1.0], np.column_stack([x, y, np.ones_like(x)]), z, bounds=(None, None)).x
    up = np.array([-a, -b, 1.0]) / math.sqrt(1.0 + a * a + b * b)
    u, v, _ = cross(up, np.array([0.0, 0.0, 1.0]))
    K = np.array([[0.0, 0.0, v], [0.0, 0.0, -u], [-v, u, 0.0]])
    return np.eye(3) + K + product(K, K) / (1.0 + up[2])


def default_posture(model: Model, soles: Iterable[Sole]) -> np.ndarray:
    """Return the posture (nj,) [rad] that decides how the knees bend.

    It is the keyframe in which the robot stands, with legs slightly bent, or without one the middle of the ranges of
    the leg joints, 0 elsewhere.
    """
    (posture, _), columns = standing(model), [k for sole in soles for k in sole.joints]
    share = 1.0 if standing_keyframe(model) is None else BENT
    posture[columns] += share * (mid_range(model) - posture)[columns]
    return posture


def first_base(model: Model, soles: Sequence[Sole], posture: np.ndarray, com: np.ndarray) -> np.ndarray:
    """Guess root positions (n, 3) [m]: that of the center of mass in `posture`.

    Without a keyframe legs are far more bent in `posture` than in a walk: the height is that at which it stands.
    """
    base = com - center_of_mass(model, posture)
    if standing_keyframe(model) is None:
        base[:, 2] = -_sole_at(model, soles[0], posture)[2]
    return base


def size_of(model: Model, soles: Sequence[Sole]) -> Size:
    """Measure a biped, all joints at zero; with a keyframe as high as it can stand, its left sole where it is there."""
    left, (angles, _) = soles[0], standing(model)
    sole = _sole_at(model, left, angles)
    leg = leg_length_to(model, left.link, sole)
    if standing_keyframe(model) is not None:
        lower = np.linspace(0.0, HIGHER, HEIGHTS)[:, None] * [0.0, 0.0, sole[2]]
        postures, missed = nearest(
            model, left.link, sole + lower, point=left.middle, rotation=left.rotation,
            joints=left.joints, start=default_posture(model, soles), tolerance=NEAR,
        )  # fmt: skip
        low, high = joint_limits(model)
        within = (missed < NEAR) & ((postures >= low) & (postures <= high)).all(axis=1)
        angles = postures[within.nonzero()[0][-1]] if within.any() else angles
        sole = _sole_at(model, left, angles)
        hip = link_index(model, model.moving_joints[left.joints[0]].child)
        leg = float(link_poses(model, angles).position[0, hip, 2] - sole[2])
    height = float(center_of_mass(model, angles)[0, 2] - sole[2])
    return Size(leg, height, abs(float(sole[1])))


def _sole_at(model: Model, sole: Sole, angles: np.ndarray) -> np.ndarray:
    """Return the middle of a sole (3,) [m] seen from the root, which is upright."""
    return np.asarray(point_at(link_poses(model, angles), link_index(model, sole.link), sole.middle)[0])
