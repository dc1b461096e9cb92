"""How tendons change with the joints."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike

from ..base.fixed_order import total
from ..model import Model, Tendon
from .algorithms import forward_kinematics, lengths_of, pieces, positions_of, rotation_vectors
from .jacobians import jacobian_of

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
