"""Where the links of a model are: forward kinematics over whole trajectories, in NumPy.

A trajectory of joint angles is ``(n, nj)`` in the order of ``Model.joint_names``; positions come out as
``(n, ..., 3)``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class LinkPoses:
    """Poses of all links in world axes."""

    position: np.ndarray  # (n, links, 3) [m]
    rotation: np.ndarray  # (n, links, 3, 3), link axes to world axes
    axis: np.ndarray  # (n, joints, 3), joint axes in world axes, in the order of Model.joints


def root_link(model):
    """Return the name of the link that no joint has as its child."""
    return next(iter({link.name for link in model.links} - {joint.child for joint in model.joints}))


def link_index(model, name):
    """Return the position of the link `name` in ``model.links``.  Raises ValueError if there is none."""
    for i, link in enumerate(model.links):
        if link.name == name:
            return i
    known = ", ".join(link.name for link in model.links)
    raise ValueError(f"model {model.name!r} has no link {name!r}; its links are {known}")


def link_poses(model, angles, base_position=None):
    """Compute the poses of all links for `angles` (n, nj) [rad].

    The root link is upright, at `base_position` (n, 3) [m] or the origin.
    """
    angles = as_trajectory(model, angles)
    n = len(angles)
    position = np.zeros((n, len(model.links), 3))
    rotation = np.tile(np.eye(3), (n, len(model.links), 1, 1))
    axis = np.zeros((n, len(model.joints), 3))
    if base_position is not None:
        position[:, link_index(model, root_link(model))] = base_position
    values = joint_values(model, angles)
    for k in base_to_tip(model):
        joint = model.joints[k]
        i, j = link_index(model, joint.parent), link_index(model, joint.child)
        frame = rotation[:, i] @ rpy_rotation(joint.rpy)
        position[:, j] = position[:, i] + rotation[:, i] @ np.array(joint.xyz)
        axis[:, k] = frame @ np.array(joint.axis)
        if joint.type == "prismatic":
            position[:, j] += values[k][:, None] * axis[:, k]
            rotation[:, j] = frame
        else:
            rotation[:, j] = frame @ axis_rotation(joint.axis, values[k])
    return LinkPoses(position, rotation, axis)


def as_trajectory(model, angles):
    """Return `angles` as a float array (n, nj).  Raises ValueError if its shape does not fit the model."""
    angles = np.atleast_2d(np.asarray(angles, dtype=float))
    if angles.ndim != 2 or angles.shape[1] != len(model.joint_names):
        raise ValueError(f"joint angles of {model.name!r} must be (n, {len(model.joint_names)}), got {angles.shape}")
    return angles


def joint_values(model, angles):
    """Return one (n,) array a joint of ``model.joints``: moving from `angles`, locked as held, fixed 0."""
    column = {name: angles[:, i] for i, name in enumerate(model.joint_names)}
    return [column.get(j.name, np.full(len(angles), model.locked.get(j.name, 0.0))) for j in model.joints]


def base_to_tip(model):
    """Return the indices of ``model.joints`` ordered so that a joint's parent link is placed before its child."""
    children = {}
    for k, joint in enumerate(model.joints):
        children.setdefault(joint.parent, []).append(k)
    order, pending = [], [root_link(model)]
    while pending:
        below = children.get(pending.pop(), [])
        order += below
        pending += [model.joints[k].child for k in below]
    return order


def rpy_rotation(rpy):
    """Return the rotation matrix of fixed-axis roll, pitch, yaw [rad] (URDF)."""
    roll, pitch, yaw = rpy
    x, y, z = np.eye(3)
    return axis_rotation(z, yaw) @ axis_rotation(y, pitch) @ axis_rotation(x, roll)


def axis_rotation(axis, angle):
    """Return rotations (..., 3, 3) by `angle` (...) [rad] about a unit `axis` (3,): Rodrigues' formula."""
    x, y, z = axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    angle = np.asarray(angle, dtype=float)[..., None, None]
    return np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * (K @ K)


def center_of_mass(model, poses):
    """Return the whole model's centre of mass (n, 3) [m]."""
    mass = np.array([link.mass for link in model.links])
    return np.einsum("l,nlk->nk", mass / mass.sum(), link_centers(model, poses))


def link_centers(model, poses):
    """Return the links' centres of mass (n, links, 3) [m]."""
    local = np.array([link.center_of_mass for link in model.links])
    return poses.position + np.einsum("nlij,lj->nli", poses.rotation, local)
