"""Kinematics of a model whose root link stays upright, along a trajectory of joint angles.

Joint angles are ``(n, nj)`` in the order of ``Model.joint_names``; positions are ``(n, ..., 3)``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .. import dynamics
from ..base.arguments import floats
from ..dynamics import Poses
from ..dynamics.jacobians import joint_axes as joint_axes
from ..dynamics.jacobians import link_centers as link_centers
from ..dynamics.jacobians import link_index as link_index
from ..model import Model


def link_poses(model: Model, angles: ArrayLike, base_position: ArrayLike = 0.0) -> Poses:
    """Return the `dynamics.Poses` of all links for `angles` (n, nj) [rad].

    The root link is upright, at `base_position` (n, 3) [m] or the origin.  Raises ValueError if `angles` do not fit the
    model.
    """
    poses = dynamics.forward_kinematics(model, upright_states(model, angles))
    return poses._replace(position=poses.position + _shift(base_position)[:, None])


def center_of_mass(model: Model, angles: ArrayLike, base_position: ArrayLike = 0.0) -> np.ndarray:
    """Return the whole model's center of mass (n, 3) [m]; arguments as of `link_poses`."""
    return dynamics.center_of_mass(model, upright_states(model, angles)) + _shift(base_position)


def joint_limits(model: Model) -> np.ndarray:
    """Return the lower and the upper limits (2, nj) of the moving joints [rad]."""
    return np.reshape([(joint.lower, joint.upper) for joint in model.moving_joints], (-1, 2)).T


def upright_states(model: Model, angles: ArrayLike) -> np.ndarray:
    """Return states (n, nq) with these joint angles, the root link upright at the origin."""
    dynamics.check_model(model)
    angles = np.atleast_2d(floats("angles", angles))
    if angles.ndim != 2 or angles.shape[1] != len(model.joint_names):
        raise ValueError(f"joint angles of {model.name!r} must be (n, {len(model.joint_names)}), got {angles.shape}")
    base = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0] if model.base == "floating" else []
    return np.hstack([np.tile(base, (len(angles), 1)), angles])


def _shift(base_position: ArrayLike) -> np.ndarray:
    shift = np.atleast_2d(floats("base_position", base_position))
    if shift.ndim != 2 or shift.shape[1] not in (1, 3) or not np.isfinite(shift).all():
        raise ValueError(f"base_position has shape {shift.shape}; give finite numbers (3,) or (n, 3) [m]")
    return shift
