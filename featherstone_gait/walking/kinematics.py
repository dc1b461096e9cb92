"""Where the links of a model are whose root stays upright, and what leg inverse kinematics needs of their joints.

A trajectory of joint angles is ``(n, nj)`` in the order of ``Model.joint_names``; positions come out as
``(n, ..., 3)``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from featherstone_gait import dynamics, renamed
from featherstone_gait.dynamics import Poses
from featherstone_gait.fixed_order import applied
from featherstone_gait.model import Model


def link_index(model: Model, name: str) -> int:
    """Return the position of the link `name` in ``model.links``.  Raises ValueError if there is none."""
    for i, link in enumerate(model.links):
        if link.name == name:
            return i
    known = ", ".join(link.name for link in model.links)
    raise ValueError(f"model {model.name!r} has no link {name!r}; its links are {known}")


def link_poses(model: Model, angles: ArrayLike, base_position: ArrayLike = 0.0) -> Poses:
    """Return the `dynamics.Poses` of all links for `angles` (n, nj) [rad].

    The root link is upright, at `base_position` (n, 3) [m] or the origin.  Raises ValueError if `angles` do not fit the
    model.
    """
    poses = dynamics.forward_kinematics(model, _upright(model, angles))
    return poses._replace(position=poses.position + _shift(base_position)[:, None])


def center_of_mass(model: Model, angles: ArrayLike, base_position: ArrayLike = 0.0) -> np.ndarray:
    """Return the whole model's centre of mass (n, 3) [m]; arguments as of `link_poses`."""
    return dynamics.center_of_mass(model, _upright(model, angles)) + _shift(base_position)


def link_centers(model: Model, poses: Poses) -> np.ndarray:
    """Return the links' centres of mass (n, links, 3) [m]."""
    return poses.position + applied(poses.rotation, np.array([link.center_of_mass for link in model.links]))


def joint_axes(model: Model, poses: Poses) -> np.ndarray:
    """Return the moving joints' axes in the world (n, nj, 3): a link turns about its joint's axis, which stays."""
    children = [link_index(model, joint.child) for joint in model.moving_joints]
    return applied(poses.rotation[:, children], np.reshape([joint.axis for joint in model.moving_joints], (-1, 3)))


def _upright(model: Model, angles: ArrayLike) -> np.ndarray:
    """States (n, nq) with these joint angles, the root link upright at the origin."""
    angles = np.atleast_2d(np.asarray(angles, dtype=float))
    if angles.ndim != 2 or angles.shape[1] != len(model.joint_names):
        raise ValueError(f"joint angles of {model.name!r} must be (n, {len(model.joint_names)}), got {angles.shape}")
    base = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0] if model.base == "floating" else []
    return np.hstack([np.tile(base, (len(angles), 1)), angles])


def _shift(base_position: ArrayLike) -> np.ndarray:
    return np.atleast_2d(np.asarray(base_position, dtype=float))


def __getattr__(name: str) -> Any:
    return renamed.lookup(__name__, name)
