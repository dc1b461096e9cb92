"""Links that fixed and held joints connect, merged to rigid bodies.

The numbers end up in what kernels read: sums are taken in a fixed order.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ..base.fixed_order import applied, product
from ..base.rotation import rotation_about, rotation_from_rpy, rotation_z_to
from .degrees import TO_AXIS
from .links import Joint, Link


class Placement(NamedTuple):
    """The place of a link: the body that carries it and the link's frame in that body's frame.

    Attributes
    ----------
    row : int
        Row of the body; 0 is the world or the floating base.
    E : numpy.ndarray
        Rotation (3, 3) link -> body.
    r : numpy.ndarray
        Origin (3,) of the link's frame in the body's frame [m].
    """

    row: int
    E: np.ndarray
    r: np.ndarray


class Frame(NamedTuple):
    """Frame of a body in that of its parent, with the joint at zero: origin at the joint, z along the joint's axis."""

    joint: Joint | None  # that moves the body; None for the root's
    parent: int  # row of the body that the joint hangs on
    E: np.ndarray  # (3, 3) rotation body -> parent
    r: np.ndarray  # (3,) origin in the parent [m]


class RigidBody(NamedTuple):
    """Links that move as one, and their mass properties together, in the body's frame.

    Attributes
    ----------
    frame : Frame
        Frame of the body in that of its parent.
    links : tuple of str
        Names of the links, the joint's child first.
    mass : float
        Mass [kg].
    center : numpy.ndarray
        Center of mass (3,) [m].
    inertia : numpy.ndarray
        Inertia (3, 3) about the center of mass [kg m^2].
    """

    frame: Frame
    links: tuple[str, ...]
    mass: float
    center: np.ndarray
    inertia: np.ndarray


def depth_first_joints(root: str, joints: Sequence[Joint]) -> list[Joint]:
    """Order joints depth first: a parent's before its children's, each chain in one piece, children in file order."""
    children: dict[str, list[Joint]] = {}
    for joint in joints:
        children.setdefault(joint.parent, []).append(joint)
    order, stack = [], children.get(root, [])[::-1]
    while stack:
        joint = stack.pop()
        order.append(joint)
        stack.extend(children.get(joint.child, [])[::-1])
    return order


def lay_out(
    root: str, joints: Sequence[Joint], moving: Collection[str], held: Mapping[str, float]
) -> tuple[list[Frame], dict[str, Placement]]:
    """Compute the frame of each body, and where each link sits.

    moving: names of the joints that have a coordinate; held: positions of others that are not fixed [rad or m].
    """
    frames = [Frame(None, 0, np.eye(3), np.zeros(3))]
    placements = {root: Placement(0, np.eye(3), np.zeros(3))}
    for joint in depth_first_joints(root, joints):
        row, E, r = placements[joint.parent]
        E, r = product(E, rotation_from_rpy(joint.rpy)), r + applied(E, np.array(joint.xyz))
        if joint.name in moving:
            Q = TO_AXIS[joint.axis] if joint.type == "ball" else rotation_z_to(joint.axis)
            placements[joint.child] = Placement(len(frames), Q.T, np.zeros(3))
            frames.append(Frame(joint, row, product(E, Q), r))
        else:
            placements[joint.child] = Placement(row, *held_frame(joint, held.get(joint.name, 0.0), E, r))
    return frames, placements


def held_frame(joint: Joint, position: float, E: np.ndarray, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Move the child frame of a joint (rotation E, origin r at zero) to a position [rad or m]."""
    if position == 0.0:
        return E, r
    if joint.type == "prismatic":
        return E, r + applied(E, position * np.array(joint.axis))
    if joint.pitch:
        r = r + applied(E, joint.pitch * position * np.array(joint.axis))
    return product(E, rotation_about(joint.axis, position)), r


def merge(
    links: Sequence[Link], joints: Sequence[Joint], frames: list[Frame], placements: dict[str, Placement]
) -> tuple[list[RigidBody], dict[str, Placement]]:
    """Merge the links that `lay_out` puts on one body; the frames take the joints given, of the same names."""
    by_name, joint_of = {link.name: link for link in links}, {joint.name: joint for joint in joints}
    groups: list[list[tuple[Link, Placement]]] = [[] for _ in frames]
    for name, place in placements.items():
        groups[place.row].append((by_name[name], place))
    frames = [frame._replace(joint=frame.joint and joint_of[frame.joint.name]) for frame in frames]
    names = [tuple(link.name for link, _ in group) for group in groups]
    return [RigidBody(*body) for body in zip(frames, names, *_mass_properties(groups))], placements


def _mass_properties(
    groups: list[list[tuple[Link, Placement]]],
) -> tuple[list[float], list[np.ndarray], list[np.ndarray]]:
    """Sum up mass, center of mass and inertia about it of the links of each body, in the body's frame."""
    links = [link for group in groups for link, _ in group]
    places = [place for group in groups for _, place in group]
    E, mass = np.array([place.E for place in places]), np.array([link.mass for link in links])
    centers = np.array([place.r for place in places]) + applied(E, np.array([link.center_of_mass for link in links]))
    inertias = turned(E, np.array([inertia_matrix(link.inertia) for link in links]))
    ends = np.cumsum([len(group) for group in groups]).tolist()
    parts = [slice(end - len(group), end) for group, end in zip(groups, ends)]
    masses = [math.fsum(link.mass for link, _ in group) for group in groups]
    weighted = mass[:, None] * centers
    means = [functools.reduce(np.add, weighted[part], np.zeros(3)) for part in parts]
    means = [c / m if m > 0 else c for m, c in zip(masses, means)]
    d = centers - np.repeat(means, [len(group) for group in groups], axis=0)
    square = (d[:, 0] * d[:, 0] + d[:, 1] * d[:, 1] + d[:, 2] * d[:, 2])[:, None, None]
    about = inertias + mass[:, None, None] * (square * np.eye(3) - d[:, :, None] * d[:, None, :])
    return masses, means, [functools.reduce(np.add, about[part], np.zeros((3, 3))) for part in parts]


def turned_inertia(E: np.ndarray, inertia: tuple[float, ...]) -> np.ndarray:
    """Turn an inertia ixx ixy ixz iyy iyz izz [kg m^2] by the rotation E: E I E' (3, 3)."""
    return turned(E, inertia_matrix(inertia))


def turned(E: np.ndarray, inertia: np.ndarray) -> np.ndarray:
    """Turn matrices (..., 3, 3): E I E'."""
    return product(product(E, inertia), E.swapaxes(-1, -2))


def inertia_matrix(inertia: tuple[float, ...]) -> np.ndarray:
    """Return the matrix of an inertia.

    Parameters
    ----------
    inertia : tuple of float
        ixx, ixy, ixz, iyy, iyz, izz [kg m^2].

    Returns
    -------
    numpy.ndarray
        Symmetric matrix (3, 3) [kg m^2].
    """
    xx, xy, xz, yy, yz, zz = inertia
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def inertia_tuple(matrix: np.ndarray) -> tuple[float, ...]:
    """Return ixx ixy ixz iyy iyz izz of a matrix (3, 3), made symmetric."""
    return tuple(((matrix + matrix.T) / 2)[(0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2)].tolist())
