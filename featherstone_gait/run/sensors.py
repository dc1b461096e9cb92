"""What the sensors of a walking robot read, from the channels of a trajectory.

Encoders and an IMU on the trunk, pressure under the soles.  Each function names the channels it needs; leave one out
and it says so.  Readings are exact but for the encoders' steps: noise is for the caller to add.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from .. import dynamics
from ..base.arguments import instance, vector
from ..model import Ground
from ..scene.compile import CompiledScene
from ..scene.contact import ground_under, plane_axes
from .start import check_scene
from .trajectory import Trajectory


def encoders(scene: CompiledScene, trajectory: Trajectory) -> np.ndarray:
    """Joint angles (samples, joints) rounded to the servos' encoder steps [rad]; needs q."""
    check_scene(scene)
    q = _channels(trajectory, "q")[0]
    servos = [scene.model.servos.get(name) for name in scene.model.joint_names]
    steps = np.array([servo.encoder_resolution if servo else 0.0 for servo in servos])
    exact = steps == 0.0
    counts = np.rint(q / np.where(exact, 1.0, steps))
    return np.where(exact, q, counts * steps)


def gyroscope(scene: CompiledScene, trajectory: Trajectory) -> np.ndarray:
    """Angular velocity of the trunk (samples, 3), its own axes [rad/s]; needs base_qd."""
    _check_floating(scene)
    return _channels(trajectory, "base_qd")[0][:, 3:]


def accelerometer(scene: CompiledScene, trajectory: Trajectory, position: ArrayLike = (0.0, 0.0, 0.0)) -> np.ndarray:
    """Specific force (samples, 3) at a position [m] of the trunk, its own axes [m/s^2]: acceleration less gravity.

    Needs base_q, base_qd and base_qdd.  An acceleration is the mean over the step before the sample: the first sample
    of a run from rest, before any step, reads gravity alone.
    """
    _check_floating(scene)
    q, qd, qdd = _channels(trajectory, "base_q", "base_qd", "base_qdd")
    omega, alpha, r = qd[:, 3:], qdd[:, 3:], vector("position", position, 3, "[m]")
    linear = np.einsum("kji,kj->ki", _rotations(q), qdd[:, :3] - scene.constants.gravity)
    return linear + np.cross(alpha, r) + np.cross(omega, np.cross(omega, r))


def sole_forces(scene: CompiledScene, trajectory: Trajectory) -> dict[str, np.ndarray]:
    """Force of the ground on each link that has contact points (samples, 3), world axes [N]; needs contact_force."""
    check_scene(scene)
    forces = _point_forces(scene, trajectory)
    links = [point.link for point in scene.model.contacts]
    return {name: forces[:, [link == name for link in links]].sum(axis=1) for name in dict.fromkeys(links)}


def center_of_pressure(scene: CompiledScene, trajectory: Trajectory, link: str | None = None) -> np.ndarray:
    """Where the normal forces balance (samples, 3), world axes [m]: of one link's points, of all if None.

    NaN where nothing touches.  Needs q, base_q (of a floating robot) and contact_force.
    """
    check_scene(scene)
    points = [k for k, point in enumerate(scene.model.contacts) if link is None or point.link == str(link)]
    if not points:
        links = ", ".join(dict.fromkeys(point.link for point in scene.model.contacts))
        raise ValueError(f"{scene.model.name}: link {link!r} has no contact points; links that have: {links}")
    normal = _contact_forces(scene, trajectory)[:, points, 0]
    total = normal.sum(axis=1)
    share = normal / np.where(total > 0.0, total, np.nan)[:, None]
    return np.einsum("kc,kci->ki", share, contact_positions(scene, trajectory)[:, points])


def contact_positions(scene: CompiledScene, trajectory: Trajectory) -> np.ndarray:
    """Contact points (samples, points, 3) in the model's order, world axes [m]; needs q and base_q."""
    check_scene(scene)
    q = _channels(trajectory, "q")[0]
    if scene.tree.floating:
        q = np.hstack([_channels(trajectory, "base_q")[0], q])
    return dynamics.contact_positions(scene.model, q)


def _point_forces(scene: CompiledScene, trajectory: Trajectory) -> np.ndarray:
    """Force on each contact point (samples, points, 3), world axes [N]."""
    forces, ground = _contact_forces(scene, trajectory), scene.ground or Ground()
    return in_world(ground, forces, contact_positions(scene, trajectory) if ground.field else None)


def in_world(ground: Ground, forces: np.ndarray, positions: np.ndarray | None) -> np.ndarray:
    """Forces (..., points, 3) in the ground's axes turned into the world's; only a field asks for positions [m]."""
    if positions is None:
        return forces @ plane_axes(ground)
    under = ground_under(ground, positions.reshape(-1, 3))
    n, t = under[:, :3], under[:, 3:6]
    axes = np.stack([n, t, np.cross(n, t)], axis=1)
    return np.einsum("kc,kci->ki", forces.reshape(-1, 3), axes).reshape(forces.shape)


def _contact_forces(scene: CompiledScene, trajectory: Trajectory) -> np.ndarray:
    if scene.ground is None:
        raise ValueError(f"{scene.model.name}: no ground in this scene; compile it with ground=Ground()")
    return _channels(trajectory, "contact_force")[0]


def _channels(trajectory: Mapping[str, np.ndarray], *names: str) -> list[np.ndarray]:
    instance("trajectory", trajectory, Mapping, "give what simulate returns")
    missing = [name for name in names if name not in trajectory]
    if missing:
        raise ValueError(f"trajectory: channels {missing} were not recorded; name them in simulate(record=...)")
    return [trajectory[name] for name in names]


def _check_floating(scene: CompiledScene) -> None:
    check_scene(scene)
    if not scene.tree.floating:
        raise ValueError(f"{scene.model.name}: an IMU needs a floating base; this one stands still")


def _rotations(q: np.ndarray) -> np.ndarray:
    """Rotation matrices (samples, 3, 3), body -> world, of the unit quaternions in q[:, 3:7]."""
    w, v = q[:, 3, None, None], q[:, 4:7]
    cross = np.cross(np.eye(3), v[:, None])  # cross @ a = v x a
    return np.eye(3) + 2.0 * (w * cross + cross @ cross)
