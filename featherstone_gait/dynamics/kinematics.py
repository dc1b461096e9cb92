"""Poses of links, and where contact points and points of links are."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ..base.fixed_order import applied, product, total
from ..base.portable_math import angle
from ..core.effects.touch import FLATNESS
from ..core.tree import batch
from ..core.tree.layout import Robot
from ..model import Model
from ..model.numpy_dynamics import Poses
from .states import as_given, as_rows, at_rest, check_model, workspace_of
from .tree import Tree, compile_tree


def forward_kinematics(model: Model, q: ArrayLike, link: str | Sequence[str] | None = None) -> Poses:
    """Compute the pose of every link, of some, or of one.

    Parameters
    ----------
    model : Model
        The robot.
    q : array_like
        Positions (nq,) or (n, nq) [m, -, rad or m].
    link : str or sequence of str, optional
        Name of a link, or names of some; None for all links, in the order of `model.links`.

    Returns
    -------
    Poses
        Rotations (..., links, 3, 3) and positions (..., links, 3) [m]; of one link (..., 3, 3) and (..., 3).

    Raises
    ------
    ValueError
        For wrong shapes, values that are not finite and a link that does not exist.
    """
    check_model(model)
    if link is None or not isinstance(link, str):
        names = model.link_rows if link is None else (model.link(name).name for name in link)
        return poses_of_links(model, q, [*names])
    rotation, position = poses_of_links(model, q, [model.link(link).name])
    return Poses(rotation[..., 0, :, :], position[..., 0, :])


def poses_of_links(model: Model, q: ArrayLike, links: Sequence[str]) -> Poses:
    """Compute the poses of links by their names, rotations (..., links, 3, 3) and positions (..., links, 3) [m]."""
    x, tree = as_rows(model, q=q), compile_tree(model)
    poses = body_poses(tree, x["q"])
    places = [tree.placements[name] for name in links]
    E = poses[:, [place.row for place in places], :9].reshape(len(poses), -1, 3, 3)
    rotation = product(E, np.array([place.E for place in places]))
    position = poses[:, [place.row for place in places], 9:] + applied(E, np.array([place.r for place in places]))
    if tree.floating:
        position = position + x["q"][:, None, :3]
    return Poses(as_given(rotation, q), as_given(position, q))


def body_poses(tree: Tree, q: np.ndarray) -> np.ndarray:
    """Compute rotation and position from the base's origin, (n, bodies, 12)."""
    out = np.zeros((len(q), tree.n + 1, 12))
    batch.poses_rows(Robot(tree.bodies, None, np.zeros(3)), at_rest(tree, q), workspace_of(tree), out)
    return out


def contact_positions(model: Model, q: ArrayLike) -> np.ndarray:
    """Compute where the contact points are in the world; of spheres and discs their lowest points.

    Parameters
    ----------
    model : Model
        The robot.
    q : array_like
        Positions (nq,) or (n, nq) [m, -, rad or m].

    Returns
    -------
    numpy.ndarray
        Positions (points, 3) or (n, points, 3) [m], in the order of `model.contacts`.

    Raises
    ------
    ValueError
        For wrong shapes and values that are not finite.
    """
    check_model(model)
    links = [point.link for point in model.contacts]
    links = list(dict.fromkeys(links)) or list(model.link_rows)
    return deepest_points(model, poses_of_links(model, q, links), (0.0, 0.0, 1.0), links)


def contact_positions_at(model: Model, poses: Poses, links: Sequence[str] | None = None) -> np.ndarray:
    """Compute `contact_positions` for poses that are known.

    Parameters
    ----------
    model : Model
        The robot.
    poses : Poses
        Poses of links.
    links : sequence of str, optional
        Names of the links of the poses, in their order, with all that have contacts; None for all of the model.

    Returns
    -------
    numpy.ndarray
        Positions (..., points, 3) [m].
    """
    return deepest_points(model, poses, (0.0, 0.0, 1.0), links)


def deepest_points(model: Model, poses: Poses, normal: ArrayLike, links: Sequence[str] | None = None) -> np.ndarray:
    """Compute where each contact reaches deepest against a normal (`core/effects/touch.py`).

    Parameters
    ----------
    model : Model
        The robot.
    poses : Poses
        Poses of links.
    normal : array_like
        Normal (3,), or one for each point (..., points, 3).
    links : sequence of str, optional
        Names of the links of the poses, in their order; None for all of the model.

    Returns
    -------
    numpy.ndarray
        Positions (..., points, 3) in the world [m].
    """
    links = list(model.link_rows) if links is None else links
    points = points_on_links(links, poses, [(point.link, point.position) for point in model.contacts])
    if not any(point.radius or point.circle_radius for point in model.contacts):
        return points
    rows = {name: k for k, name in enumerate(links)}
    E = poses.rotation[..., [rows[point.link] for point in model.contacts], :, :]
    a = applied(E, np.array([point.axis for point in model.contacts]))
    radius, rim = np.array([(point.radius, point.circle_radius) for point in model.contacts]).T[..., None]
    n = np.broadcast_to(np.asarray(normal, dtype=float), a.shape)
    across = (a * n).sum(axis=-1, keepdims=True)
    level = n - across * a
    thin = FLATNESS**2 * across
    size = np.sqrt((level * level).sum(axis=-1, keepdims=True) + thin * across)
    return points - radius * n - rim / size * (level + thin * a)


def points_on_links(links: Sequence[str], poses: Poses, points: list[tuple[str, Sequence[float]]]) -> np.ndarray:
    """Compute world positions (..., points, 3) of points given by their link and their position in its frame."""
    rows = {name: k for k, name in enumerate(links)}
    at = [rows[link] for link, _ in points]
    local = np.array([position for _, position in points], dtype=float).reshape(-1, 3)
    return poses.position[..., at, :] + applied(poses.rotation[..., at, :, :], local)


def rotation_vectors(model: Model, q: np.ndarray, first: int) -> np.ndarray:
    """Compute the rotation vectors (..., 3) [rad] of the ball joint whose first degree this is, in the child's axes."""
    at = model.position_slices[first].start
    w, x = q[..., at], q[..., at + 1 : at + 4]
    size = np.sqrt(total(x * x))
    turned = 2.0 * np.where(w < 0.0, -1.0, 1.0) * angle(size, abs(w))
    return (turned / np.where(size > 0.0, size, 1.0))[..., None] * x
