"""The forces on a robot at rest, and how its contact points see them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..dynamics import Poses, deepest_points, forward_kinematics, inverse_dynamics
from ..dynamics.jacobians import jacobian_at, link_index
from ..model import Spring
from ..scene.compile import CompiledScene
from ..scene.contact import by_body, ground_under


class Loads(NamedTuple):
    """Forces on a robot at rest in k poses."""

    force: np.ndarray  # (k, nv) needed at rest, without contacts
    springs: np.ndarray  # (k, nv) that the springs give
    J: np.ndarray  # (k, points, 3, nv) velocities of the contacts in the ground's axes; (k, points, 5, nv) if some
    # resist rolling, with the angular velocities about the tangents by the coefficient of rolling friction
    depth: np.ndarray  # (k, points) [m]
    axes: np.ndarray  # (k, points, 3, 3) normal and tangents in rows


def loads_at(scene: CompiledScene, q: np.ndarray) -> Loads:
    """Compute the forces at rest in the postures q (k, nq)."""
    model, still = scene.model, np.zeros((len(q), scene.model.nv))
    poses = forward_kinematics(model, q)
    springs = sum((_spring_force(scene, poses, spring) for spring in scene.springs), np.zeros_like(still))
    force = inverse_dynamics(model, q, still, still, gravity=scene.gravity) - springs
    if scene.ground is None:
        empty = np.zeros((len(q), 0))
        return Loads(force, springs, empty.reshape(len(q), 0, 3, model.nv), empty, empty.reshape(len(q), 0, 3, 3))
    x = deepest_points(model, poses, (0.0, 0.0, 1.0))
    for _ in range(2):  # the deepest point of a curved contact depends on the normal under it
        under = ground_under(scene.ground, x.reshape(-1, 3)).reshape(*x.shape[:2], 7)
        x = deepest_points(model, poses, under[..., :3])
    under = ground_under(scene.ground, x.reshape(-1, 3)).reshape(*x.shape[:2], 7)
    normal, first = under[..., :3], under[..., 3:6]
    axes = np.stack([normal, first, np.cross(normal, first)], axis=-2)
    columns = [_velocity(scene, poses, point.link, x[:, k]) for k, point in enumerate(model.contacts)]
    J, rho = axes @ np.stack(columns, axis=1), rolling_friction(scene)
    if rho.any():
        turns = [by * jacobian_at(model, poses, point.link)[:, :3] for by, point in zip(rho, model.contacts)]
        J = np.concatenate([J, axes[..., 1:, :] @ np.stack(turns, axis=1)], axis=2)
    return Loads(force, springs, J, -under[..., 6] * normal[..., 2], axes)


def rolling_friction(scene: CompiledScene) -> np.ndarray:
    """Return the coefficients of rolling friction of the contact points (points,) [m]."""
    return np.array([point.rolling_friction for point in scene.model.contacts])


def _velocity(scene: CompiledScene, poses: Poses, link: str, x: np.ndarray) -> np.ndarray:
    """Return the Jacobian (k, 3, nv) of the point of a link that is at x (k, 3) in the world."""
    J = jacobian_at(scene.model, poses, link)
    arm = x - poses.position[:, link_index(scene.model, link)]
    return J[:, 3:] + np.cross(J[:, :3], arm[:, :, None], axis=1)


def _spring_force(scene: CompiledScene, poses: Poses, spring: Spring) -> np.ndarray:
    """Return the generalized force (k, nv) of a spring."""
    model, ends = scene.model, []
    for link, point in ((spring.a, spring.point_a), (spring.b, spring.point_b)):
        row = link_index(model, link)
        ends.append(poses.position[:, row] + poses.rotation[:, row] @ np.array(point))
    way = ends[1] - ends[0]
    length = np.linalg.norm(way, axis=1, keepdims=True)
    pull = spring.stiffness * (length - spring.length) * way / length
    J = _velocity(scene, poses, spring.a, ends[0]) - _velocity(scene, poses, spring.b, ends[1])
    return np.einsum("ki,kij->kj", pull, J)


def of_points(scene: CompiledScene, name: str = "stiffness") -> np.ndarray:
    """Return a number of the contact points, in the order of the model."""
    assert scene.constants.contact is not None
    found = np.zeros(len(scene.model.contacts))
    found[by_body(scene.model, scene.tree)] = scene.constants.contact.points[name]
    return found
