"""Jacobians of points of links and of the center of mass, for one state or many.

Columns are the velocity coordinates of `model/robot.py`: of a floating base first its velocity in world axes, then its
angular velocity in body axes, then the joints' rates in file order.  Joints that are coupled (`Joint.mimic`) keep a
column each.  A column is the joint's axis, moved to the point (Featherstone, *Rigid Body Dynamics Algorithms* (2008),
section 4.5).
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import shown, vector
from ..base.fixed_order import applied, product, total
from ..base.flaws import quoted
from ..base.rotation import cross, rotation_from_rpy
from ..model import Joint, Model
from ..model.links import COMPOSITE
from ..model.rigid_bodies import depth_first_joints
from .kinematics import Poses, forward_kinematics
from .states import check_model

link_index = Model.link_index


class Chains(NamedTuple):
    """The joints that move each link, and their axes."""

    children: list[int]  # of each moving joint: the row of its child link, whose frame sits at the joint
    carriers: list[int]  # row of the link in whose frame the axis stays: the child, or the parent
    axes: np.ndarray  # (n, 3) in that frame
    slides: np.ndarray  # (n, 1) whether the joint is prismatic
    pitches: np.ndarray  # (n, 1) of screw joints, else 0 [m/rad]
    moves: np.ndarray  # (links, n) 1 where the joint moves the link, else 0
    root: int | None  # row of the floating base's link; None where the base is fixed
    share: np.ndarray  # (links,) of the robot's mass


def jacobian(
    model: Model, q: ArrayLike, link: str, point: ArrayLike = (0.0, 0.0, 0.0), frame: str = "world"
) -> np.ndarray:
    """Compute the Jacobian of a point of a link: its velocity is J qd.

    Parameters
    ----------
    model : Model
        The robot.
    q : array_like
        Positions (nq,) or (n, nq) [m, -, rad or m].
    link : str
        Name of the link.
    point : array_like, optional
        The point (3,) in the frame of the link [m].
    frame : str, optional
        In whose axes the rows are: "world", "body" (those of the link), or the name of any link.

    Returns
    -------
    numpy.ndarray
        J (6, nv) or (n, 6, nv): first the angular velocity of the link [rad/s], then the velocity of the point [m/s].

    Raises
    ------
    ValueError
        For wrong shapes, and for a link or a frame that does not exist.
    """
    check_model(model)
    axes = link if isinstance(frame, str) and frame == "body" else frame
    if not isinstance(axes, str) or (axes != "world" and axes not in model.link_rows):
        known = f"expected 'world', 'body' or one of its links {quoted(model.link_rows)}"
        raise ValueError(f"model {model.name!r} has no frame {shown(axes)}; {known}")
    poses = forward_kinematics(model, q)
    J = jacobian_at(model, poses, link, point)
    if axes == "world":
        return J
    inverse = np.swapaxes(poses.rotation[..., model.link_rows[axes], :, :], -1, -2)
    return np.concatenate([product(inverse, J[..., :3, :]), product(inverse, J[..., 3:, :])], axis=-2)


def center_of_mass_jacobian(model: Model, q: ArrayLike) -> np.ndarray:
    """Compute the Jacobian of the center of mass: its velocity in world axes is J qd.

    Parameters
    ----------
    model : Model
        The robot.
    q : array_like
        Positions (nq,) or (n, nq) [m, -, rad or m].

    Returns
    -------
    numpy.ndarray
        J (3, nv) or (n, 3, nv) [m/s]; a fixed base counts as in `center_of_mass`.

    Raises
    ------
    ValueError
        For wrong shapes and values that are not finite.
    """
    return center_of_mass_jacobian_at(model, forward_kinematics(model, q))


def jacobian_at(model: Model, poses: Poses, link: str, point: ArrayLike = (0.0, 0.0, 0.0)) -> np.ndarray:
    """Compute `jacobian` (..., 6, nv) in world axes for poses that are known."""
    return jacobian_of(model, poses, link, point_at(poses, model.link_index(link), point))


def jacobian_of(model: Model, poses: Poses, link: str, where: np.ndarray) -> np.ndarray:
    """Compute the same (..., 6, nv) of points of a link whose world positions (..., 3) are given [m]."""
    chains, row, axes = chains_of(model), model.link_index(link), joint_axes(model, poses)
    lever = where[..., None, :] - poses.position[..., chains.children, :]
    turn = np.where(chains.slides, 0.0, axes)
    move = np.where(chains.slides, axes, _cross(axes, lever) + chains.pitches * axes)
    columns = np.concatenate([turn, move], axis=-1) * chains.moves[row][:, None]
    if chains.root is not None:
        columns = np.concatenate([_base_columns(poses, chains.root, where), columns], axis=-2)
    return np.swapaxes(columns, -1, -2)


def center_of_mass_jacobian_at(model: Model, poses: Poses) -> np.ndarray:
    """Compute `center_of_mass_jacobian` (..., 3, nv) for poses that are known."""
    chains, centers, axes = chains_of(model), link_centers(model, poses), joint_axes(model, poses)
    behind = (chains.moves * chains.share[:, None]).T  # (n, links) of the mass that a joint moves
    lever = product(behind, centers) - total(behind)[:, None] * poses.position[..., chains.children, :]
    along = axes * total(behind)[:, None]
    columns = np.where(chains.slides, along, _cross(axes, lever) + chains.pitches * along)
    if chains.root is not None:
        center = center_of_mass_at(model, poses)
        columns = np.concatenate([_base_columns(poses, chains.root, center)[..., 3:], columns], axis=-2)
    return np.swapaxes(columns, -1, -2)


def center_of_mass_at(model: Model, poses: Poses) -> np.ndarray:
    """Compute `center_of_mass` (..., 3) [m] for poses that are known."""
    return total(chains_of(model).share[:, None] * link_centers(model, poses), axis=-2)


def point_at(poses: Poses, row: int, point: ArrayLike) -> np.ndarray:
    """Compute the world position (..., 3) [m] of a point (3,) of a link; row: of the link."""
    local = vector("point", point, 3, "[m] in the frame of the link")
    return poses.position[..., row, :] + applied(poses.rotation[..., row, :, :], local)


@functools.lru_cache(maxsize=64)
def chains_of(model: Model) -> Chains:
    """Collect what the Jacobians of a model need."""
    joints = model.moving_joints
    mass = np.array([link.mass for link in model.links])
    return Chains(
        children=[model.link_index(_ends(model, joint)[1]) for joint in joints],
        carriers=[model.link_index(link) for link, _ in map(functools.partial(_axis_of, model), joints)],
        axes=np.reshape([axis for _, axis in map(functools.partial(_axis_of, model), joints)], (-1, 3)),
        slides=np.array([[joint.type == "prismatic"] for joint in joints], dtype=bool).reshape(-1, 1),
        pitches=np.array([[joint.pitch] for joint in joints], dtype=float).reshape(-1, 1),
        moves=_moves(model),
        root=model.link_index(model.root) if model.base == "floating" else None,
        share=mass / (total(mass) or 1.0),  # frames alone have none
    )


def _moves(model: Model) -> np.ndarray:
    """Return (links, n) 1 where the moving joint lies between root and link, else 0."""
    rows, columns = model.link_rows, model.joint_rows
    moves = np.zeros((len(rows), len(columns)))
    of_link = {model.root: moves[rows[model.root]]}
    for joint in depth_first_joints(model.root, model.degrees.joints):
        of_link[joint.child] = of_link[joint.parent].copy()
        if joint.name in columns:
            of_link[joint.child][columns[joint.name]] = 1.0
    for name, row in rows.items():
        moves[row] = of_link[name]
    return moves


def _ends(model: Model, joint: Joint) -> tuple[str, str]:
    """Return the links that the joint connects of which a degree is one."""
    child = joint.child
    while child not in model.link_rows:  # a link without mass between the degrees of a joint
        child = model.degrees.after[child]
    return next((one.parent, one.child) for one in model.joints if one.child == child)


def _axis_of(model: Model, joint: Joint) -> tuple[str, tuple[float, ...]]:
    """Return the link in whose frame a degree's axis stays, and the axis (3,) there."""
    parent, child = _ends(model, joint)
    whole = model.joint(next(one.name for one in model.joints if one.child == child))
    if whole.type in COMPOSITE and joint.child != child and joint.type != "ball":
        return parent, tuple(applied(rotation_from_rpy(whole.rpy), np.array(joint.axis)).tolist())
    return child, joint.axis


def _base_columns(poses: Poses, root: int, where: np.ndarray) -> np.ndarray:
    """Compute angular velocity and velocity at a point (..., 3), a row (..., 6, 6) for each coordinate of the base."""
    axes = np.swapaxes(poses.rotation[..., root, :, :], -1, -2)  # of the base, a row each
    move = _cross(axes, (where - poses.position[..., root, :])[..., None, :])
    along = np.broadcast_to(np.eye(3), axes.shape)
    return np.concatenate(
        [np.concatenate([0.0 * along, along], axis=-1), np.concatenate([axes, move], axis=-1)], axis=-2
    )


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Compute vector products (..., 3); np.cross takes several times as long."""
    return cross(a.T, b.T).T


def link_centers(model: Model, poses: Poses) -> np.ndarray:
    """Return the links' centers of mass (..., links, 3) [m]."""
    return poses.position + applied(poses.rotation, np.array([link.center_of_mass for link in model.links]))


def joint_axes(model: Model, poses: Poses) -> np.ndarray:
    """Return the moving joints' axes in the world (..., n, 3): a link turns about its joint's axis, which stays."""
    chains = chains_of(model)
    return applied(poses.rotation[..., chains.carriers, :, :], chains.axes)
