"""Lengths and energies of tendons and of springs between links, and how lengths change with the joints."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import listed
from ..base.fixed_order import applied, product, total
from ..core.shapes.wrap import ways_around
from ..model import Model, Spring, Tendon, Via, Wrap
from ..model.numpy_dynamics import Poses
from ..model.tree_checks import check_springs
from .jacobians import jacobian_of
from .kinematics import forward_kinematics, points_on_links, rotation_vectors
from .states import check_model, positions_of
from .tree import wrap_record

EVEN = math.sqrt(1.0 / 3.0)  # direction in which a ball joint in its zero orientation is taken to turn


def tendon_jacobian(model: Model, q: ArrayLike) -> np.ndarray:
    """Compute the Jacobian of the tendons: J qd is the rate of `tendon_lengths`, J' f the torques of forces along them.

    Parameters
    ----------
    model : Model
        The robot.
    q : array_like
        Positions (nq,) or (n, nq) [m, -, rad or m].

    Returns
    -------
    numpy.ndarray
        J (tendons, nv) or (n, tendons, nv).

    Raises
    ------
    ValueError
        For wrong shapes and values that are not finite.
    """
    return rows_of(model, positions_of(model, q), model.tendons)


def rows_of(model: Model, q: np.ndarray, tendons: Iterable[Tendon]) -> np.ndarray:
    """Compute the Jacobian (..., k, nv) of any tendons; zero of pieces whose points coincide."""
    tendons = list(tendons)
    J = np.zeros((*q.shape[:-1], len(tendons), model.nv))
    poses = forward_kinematics(model, q) if any(one.path for one in tendons) else None
    for k, tendon in enumerate(tendons):
        for name, c in tendon.joints:
            if name in model.ball_names:
                first = model.balls[model.ball_names.index(name)]
                x, own = rotation_vectors(model, q, first), model.nv - len(model.moving_joints) + first
                size = np.sqrt(total(x * x))[..., None]
                J[..., k, own : own + 3] += c * np.where(size > 0.0, x, EVEN) / np.where(size > 0.0, size, 1.0)
            elif name not in model.held:
                J[..., k, model.qd_index(name)] += c
        if poses is not None:
            for one in pieces(model, poses, tendon):
                for link, at, sign in ((one.link_a, one.a, -one.share), (one.link_b, one.b, one.share)):
                    if link is not None:
                        moves = jacobian_of(model, poses, link, at)[..., 3:, :]
                        J[..., k, :] += sign * total(np.swapaxes(one.direction[..., :, None] * moves, -1, -2))
    return J


def tendon_length_channel(model: Model, base_q: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Compute the recorded channel (samples, tendons) [m or rad]."""
    return lengths_of(model, np.hstack([base_q, q]), model.tendons)


def tendon_lengths(model: Model, q: ArrayLike) -> np.ndarray:
    """Compute the lengths of the tendons.

    Parameters
    ----------
    model : Model
        The robot.
    q : array_like
        Positions (nq,) or (n, nq) [m, -, rad or m].

    Returns
    -------
    numpy.ndarray
        Length of each tendon (tendons,) or (n, tendons) [m or rad].

    Raises
    ------
    ValueError
        For wrong shapes and values that are not finite.
    """
    return lengths_of(model, positions_of(model, q), model.tendons)


def tendon_energy(model: Model, q: ArrayLike) -> np.ndarray:
    """Compute the energy stored in the springs of the tendons.

    Parameters
    ----------
    model : Model
        The robot.
    q : array_like
        Positions (nq,) or (n, nq) [m, -, rad or m].

    Returns
    -------
    numpy.ndarray
        Energy of each tendon (tendons,) or (n, tendons) [J].

    Raises
    ------
    ValueError
        For wrong shapes and values that are not finite.
    """
    force = spring_forces(model.tendons, tendon_lengths(model, q))
    stiffness = np.array([one.stiffness for one in model.tendons])
    return 0.5 * force * force / np.where(stiffness > 0.0, stiffness, 1.0)


def lengths_of(model: Model, q: np.ndarray, tendons: Iterable[Tendon]) -> np.ndarray:
    """Compute the lengths (..., k) of any tendons."""
    tendons = list(tendons)
    lengths, single = np.zeros((*q.shape[:-1], len(tendons))), model.single_positions(q)
    poses = forward_kinematics(model, q) if any(one.path for one in tendons) else None
    for k, tendon in enumerate(tendons):
        for name, c in tendon.joints:
            if name in model.ball_names:
                x = rotation_vectors(model, q, model.balls[model.ball_names.index(name)])
                lengths[..., k] += c * np.sqrt(total(x * x))
                continue
            held = name in model.held
            lengths[..., k] += c * (model.held[name] if held else single[..., model.joint_rows[name]])
        if poses is not None:
            for one in pieces(model, poses, tendon):
                lengths[..., k] += one.share * one.length
    return lengths


def spring_forces(tendons: Iterable[Tendon], lengths: np.ndarray) -> np.ndarray:
    """Return the forces of the tendons' springs (..., k) [N or N m] at lengths, positive where they lengthen."""
    tendons = list(tendons)
    lower, upper = np.array([one.slack for one in tendons]).reshape(-1, 2).T
    stiffness = np.array([one.stiffness for one in tendons])
    return stiffness * (np.maximum(lower - lengths, 0.0) - np.maximum(lengths - upper, 0.0))


class Piece(NamedTuple):
    """A straight piece of a tendon between points of two links, None for the world."""

    link_a: str | None
    a: np.ndarray  # (..., 3) in the world [m]
    link_b: str | None
    b: np.ndarray
    direction: np.ndarray  # (..., 3)
    length: np.ndarray  # (...) with that of the bend after it [m]
    share: float


def pieces(model: Model, poses: Poses, tendon: Tendon) -> Iterator[Piece]:
    """Yield the straight pieces of a path; around a shape two, the first of the whole length where it does not turn."""
    for k, after in enumerate(tendon.path):
        wrap = tendon.path[k - 1] if k else None
        before = tendon.path[k - 2] if isinstance(wrap, Wrap) else wrap
        if not (isinstance(before, Via) and isinstance(after, Via) and after.share > 0):
            continue
        a, b = (_place_of(model, poses, one.link, one.point) for one in (before, after))
        distance, way = _direction(a, b)
        if not isinstance(wrap, Wrap):
            yield Piece(before.link, a, after.link, b, way, distance, after.share)
            continue
        turns, c, d, arc = _touching_points(model, poses, wrap, a, b)
        (first, e), (last, f), bent = _direction(a, c), _direction(d, b), turns[..., None]
        c, d = np.where(bent, c, b), np.where(bent, d, b)
        length = np.where(turns, first + arc + last, distance)
        yield Piece(before.link, a, wrap.link, c, np.where(bent, e, way), length, after.share)
        yield Piece(wrap.link, d, after.link, b, np.where(bent, f, way), 0.0 * length, after.share)


def _place_of(model: Model, poses: Poses, link: str | None, point: Sequence[float]) -> np.ndarray:
    if link is None:
        return np.zeros_like(poses.position[..., 0, :]) + np.array(point)
    row = model.link_index(link)
    return poses.position[..., row, :] + applied(poses.rotation[..., row, :, :], np.array(point))


def _direction(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the distance (...) of points and the direction (..., 3) from one to the other, 0 where they meet."""
    way = b - a
    distance = np.sqrt(total(way * way))
    return distance, way / np.where(distance > 0.0, distance, 1.0)[..., None]


def _touching_points(
    model: Model, poses: Poses, wrap: Wrap, a: np.ndarray, b: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return whether the way around a shape turns (...), its points of contact (..., 3) and its bend (...) [m]."""
    table = wrap_record(wrap, np.eye(3))
    E = table.E[0].reshape(3, 3)
    if wrap.link is not None:
        E = product(poses.rotation[..., model.link_index(wrap.link), :, :], E)
    center, back = _place_of(model, poses, wrap.link, wrap.point), np.swapaxes(E, -1, -2)
    local = [np.ascontiguousarray(applied(back, one - center).reshape(-1, 3)) for one in (a, b)]
    out = np.zeros((len(local[0]), 8))
    ways_around(table, *local, out)
    out = out.reshape(*a.shape[:-1], 8)
    c, d = (center + applied(E, out[..., k : k + 3]) for k in (1, 4))
    return out[..., 0] > 0, c, d, out[..., 7]


def spring_energy(model: Model, springs: Sequence[Spring], q: ArrayLike) -> np.ndarray:
    """Compute the energy stored in springs between links.

    Parameters
    ----------
    model : Model
        The robot.
    springs : sequence of Spring
        The springs.
    q : array_like
        Positions (nq,) or (n, nq) [m, -, rad or m].

    Returns
    -------
    numpy.ndarray
        Energy of each spring (springs,) or (n, springs) [J].

    Raises
    ------
    ValueError
        For links that do not exist, wrong shapes and values that are not finite.
    """
    springs = listed("springs", springs, "give a list of Spring")
    stretch = np.linalg.norm(spring_vectors(model, springs, q), axis=-1) - [spring.length for spring in springs]
    return 0.5 * np.array([spring.stiffness for spring in springs]) * stretch**2


def spring_vectors(model: Model, springs: Sequence[Spring], q: ArrayLike) -> np.ndarray:
    """Compute the vectors from point a to point b of springs between links.

    Parameters
    ----------
    model : Model
        The robot.
    springs : sequence of Spring
        The springs.
    q : array_like
        Positions (nq,) or (n, nq) [m, -, rad or m].

    Returns
    -------
    numpy.ndarray
        Vectors (springs, 3) or (n, springs, 3) in world axes [m].

    Raises
    ------
    ValueError
        For links that do not exist, wrong shapes and values that are not finite.
    """
    check_model(model)
    check_springs(model.links, springs)
    poses = forward_kinematics(model, q)
    b = points_on_links(list(model.link_rows), poses, [(spring.b, spring.point_b) for spring in springs])
    return b - points_on_links(list(model.link_rows), poses, [(spring.a, spring.point_a) for spring in springs])
