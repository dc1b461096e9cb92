"""Leg inverse kinematics: joint angles that put a point of a foot at a position, with a given orientation of the sole.

A damped Newton iteration solves a whole trajectory at once: with the task error ``e`` and its Jacobian ``J``,
``dq = J^T (J J^T + |e|^2 1)^-1 e``.  The damping vanishes with the error, so that convergence stays superlinear, and a
target out of reach yields the nearest pose instead of diverging (T. Sugihara, "Solvability-unconcerned
inverse kinematics by the Levenberg-Marquardt method", IEEE T-RO 27 (2011)).

A chain of six joints or more meets position and orientation; one of five, position and the tilt of the sole (roll and
pitch), with an arbitrary yaw, or with a joint about the vertical its pitch and yaw, with an arbitrary roll, since its
ankle does not roll; one of three or four, the position of a point foot.

`dynamics.inverse_kinematics` solves one posture at a time, for several targets.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import finite, floats, instance
from ..base.fixed_order import applied, product, solve, total
from ..dynamics import check_model
from ..dynamics.jacobians import jacobian_at, point_at
from ..dynamics.loops import DEPENDENT, loop_measures
from ..model import Model
from .kinematics import joint_axes, joint_limits, link_index, link_poses, upright_states

TOLERANCE = 1e-11  # of the task error [m and rad]; rounding alone leaves 1e-16
MAX_ITERATIONS = 200
UPRIGHT = 0.9  # vertical component of an axis about which a leg turns to the side
MAX_STEP = 0.3  # of a joint in one iteration [rad]; keeps the iteration on the branch it starts on


def leg_joints(model: Model, foot: str) -> tuple[int, ...]:
    """Return the columns of ``model.joint_names`` that move the link `foot`, from the root outwards.

    Raises ValueError if one of them is not a revolute joint or none moves it.
    """
    by_child = {joint.child: joint for joint in model.joints}
    link_index(model, foot)
    columns: list[int] = []
    link = foot
    while link != model.root:
        joint = by_child[link]
        if joint.name in model.joint_names:
            if joint.type not in ("revolute", "continuous"):
                raise ValueError(
                    f"joint {joint.name!r} on the way to {foot!r} is {joint.type}; a leg must be all revolute"
                )
            columns.append(model.joint_names.index(joint.name))
        link = joint.parent
    if not columns:
        raise ValueError(f"no moving joint leads from {model.root!r} to {foot!r}")
    return tuple(reversed(columns))


def leg_length_to(model: Model, foot: str, end: np.ndarray) -> float:
    """Return the length of a leg [m], all joints at zero: from joint to joint and to a point `end` (3,) of its foot."""
    places = link_poses(model, np.zeros(len(model.joint_names))).position[0]
    joints = [places[link_index(model, model.moving_joints[k].child)] for k in leg_joints(model, foot)]
    return float(np.linalg.norm(np.diff([*joints, end], axis=0), axis=1).sum())


def solve_leg(model: Model, foot: str, target: ArrayLike, *, times: np.ndarray | None = None, **how: Any) -> np.ndarray:
    """Solve for the joints between the root link and a foot, within their limits.

    Parameters
    ----------
    model : Model
        The robot.
    foot : str
        Link of the foot.
    target : array_like, shape (n, 3)
        Positions of a point of the foot, seen from the root link [m].
    times : ndarray, shape (n,), optional
        Times of the targets, for messages [s].
    **how
        point, rotation, joints, start and tolerance: see `inverse_kinematics.nearest`.

    Returns
    -------
    ndarray, shape (n, nj)
        Joint angles [rad].

    Raises
    ------
    ValueError
        Naming joint, angle, limit and time, if a target is out of reach or a joint limit is violated.
    """
    angles = reach(model, foot, target, times=times, **how)
    check_limits(model, angles, times)
    return angles


def reach(
    model: Model,
    foot: str,
    target: ArrayLike,
    *,
    times: np.ndarray | None = None,
    tolerance: float = TOLERANCE,
    **how: Any,
) -> np.ndarray:
    """Solve for the joints between the root link and the link `foot`, regardless of their limits.

    how: as of `nearest`; tolerance: of the task error [m and rad].  Returns joint angles (n, nj) [rad].  Raises
    ValueError, naming foot and time, for a target out of reach.
    """
    angles, size = nearest(model, foot, target, tolerance=tolerance, **how)
    times = None if times is None else finite("times", times, (len(size),), "[s]")
    if (size < tolerance).all():
        return angles
    target = np.atleast_2d(floats("target", target))
    k = int(size.argmax())
    x, y, z = target[k]
    raise ValueError(
        f"link {foot!r} of {model.name!r} cannot reach ({x:.4f}, {y:.4f}, {z:.4f}) m from the root link with the sole "
        f"as asked {_when(k, times)}: the nearest posture misses by {size[k]:.2e} (m and rad); take a "
        "shorter step (step_length) or a lower center of mass (com_height)"
    )


def nearest(
    model: Model,
    foot: str,
    target: ArrayLike,
    *,
    point: ArrayLike = (0.0, 0.0, 0.0),
    rotation: np.ndarray | None = None,
    joints: tuple[int, ...] | None = None,
    start: np.ndarray | None = None,
    tolerance: float = TOLERANCE,
    iterations: int = MAX_ITERATIONS,
) -> tuple[np.ndarray, np.ndarray]:
    """Solve for the joints between the root link and a foot, approaching targets out of reach as nearly as possible.

    target (n, 3) [m]: positions of `point` (in the foot's axes), seen from the root link; rotation (3, 3): the foot's
    orientation, by default that of the zero posture; joints: columns of the joints that move, by default `leg_joints`;
    start: posture (nj,) or postures (n, nj) from which the iteration starts, by default the middle of the joint ranges;
    it decides how the knee bends, and joints outside the leg keep its values.  Returns joint angles (n, nj) [rad] and
    the error of each target (n,) [m and rad].
    """
    check_model(model)
    instance("foot", foot, str, "give the name of a link")
    target = finite("target", np.atleast_2d(floats("target", target)), (None, 3), "[m]")
    columns, index = list(leg_joints(model, foot) if joints is None else joints), link_index(model, foot)
    met = _met(model, columns)
    moved = [model.nv - len(model.joint_names) + column for column in columns]
    if rotation is None:
        rotation = link_poses(model, np.zeros(len(model.joint_names))).rotation[0, index]
    start = mid_range(model) if start is None else start
    angles = np.broadcast_to(start, (len(target), len(model.joint_names))).astype(float)
    for k in range(iterations):
        poses = link_poses(model, angles)
        # Half the sum of the cross products of the axes: the rotation's axis times the sine of its angle.
        turn = 0.5 * total(np.cross(poses.rotation[:, index], rotation[None], axis=1))
        error = np.concatenate([target - point_at(poses, index, point), turn], axis=1)[:, met]
        size = np.sqrt(total(error * error))
        if (size < tolerance).all() or k == iterations - 1:
            break
        J = jacobian_at(model, poses, foot, point)[:, [3, 4, 5, 0, 1, 2]][:, met][:, :, moved]
        transposed, damping = J.transpose(0, 2, 1), (size * size)[:, None, None] * np.eye(J.shape[1])
        step = product(transposed, solve(product(J, transposed) + damping, error[..., None]))
        angles[:, columns] += np.clip(step[..., 0], -MAX_STEP, MAX_STEP)
    return angles, size


def closed(model: Model, angles: np.ndarray, held: Iterable[int]) -> np.ndarray:
    """Close loops and couplings of postures (n, nj) [rad], and return them; the columns `held` stay as they are.

    Each step is the shortest that closes them to first order.  Raises ValueError, naming the gap, where they do not.
    """
    free = np.setdiff1d(np.arange(len(model.joint_names)), list(held))
    rows, first = model.joint_rows, model.nv - len(model.joint_names)
    tied = [(rows[a], rows[b], k, offset) for a, b, k, offset in model.couplings if rows[a] in free or rows[b] in free]
    if not model.loops and not tied:
        return angles
    C = np.zeros((len(tied), len(rows)))
    for row, (follower, leader, multiplier, _) in zip(C, tied):
        row[follower], row[leader] = 1.0, -multiplier
    angles, offsets = angles.copy(), np.array([offset for *_, offset in tied])
    for _ in range(MAX_ITERATIONS):
        measures, J = loop_measures(model, upright_states(model, angles))
        gaps = np.concatenate([measures[:, 0], applied(C, angles) - offsets], axis=1)
        if np.abs(gaps).max(initial=0.0) < TOLERANCE:
            return angles
        J = np.concatenate([J[:, :, first:], np.broadcast_to(C, (len(angles), *C.shape))], axis=1)[:, :, free]
        step = np.linalg.pinv(J, rcond=DEPENDENT) @ gaps[:, :, None]
        angles[:, free] -= np.clip(step[..., 0], -MAX_STEP, MAX_STEP)
    raise ValueError(f"loops of {model.name!r} do not close in the planned postures: a gap of {np.abs(gaps).max():.2e}")


def _met(model: Model, columns: list[int]) -> list[int]:
    """Return the rows of the task that a leg meets, of position, roll, pitch and yaw."""
    if len(columns) > 5:
        return [0, 1, 2, 3, 4, 5]
    if len(columns) in (3, 4):
        return [0, 1, 2]
    axes = joint_axes(model, link_poses(model, np.zeros(len(model.joint_names))))[0, columns]
    return [0, 1, 2, 4, 5] if (np.abs(axes[:, 2]) > UPRIGHT).any() else [0, 1, 2, 3, 4]


def mid_range(model: Model) -> np.ndarray:
    """Return the posture (nj,) [rad] in the middle of the joint ranges, 0 where a range is unbounded."""
    ranges = joint_limits(model)
    bounded = np.isfinite(ranges).all(axis=0)
    return 0.5 * np.where(bounded, ranges, 0.0).sum(axis=0)


def check_limits(model: Model, angles: np.ndarray, times: np.ndarray | None = None) -> None:
    """Raise ValueError for the joint of `angles` (n, nj) [rad] that is farthest outside its limits, if one is."""
    lower, upper = joint_limits(model)
    excess = np.maximum(lower - angles, angles - upper)
    if excess.size == 0 or excess.max() <= 0.0:
        return
    k, i = np.unravel_index(excess.argmax(), excess.shape)
    low, high, angle = np.degrees([lower[i], upper[i], angles[k, i]])
    raise ValueError(
        f"joint {model.joint_names[i]!r} needs {angle:.2f} deg {_when(k, times)}, outside its limits "
        f"{low:.2f}..{high:.2f} deg; take a shorter step, a lower lift or another height of the center of mass"
    )


def _when(k: int, times: np.ndarray | None) -> str:
    return f"at sample {k}" if times is None else f"at t = {times[k]:.3f} s"
