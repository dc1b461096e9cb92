"""Compute what the sensors of a walking robot read, from the channels of a trajectory.

There are encoders, an IMU on the trunk and force sensors under the soles.  Each function names the channels that it
needs.  Readings are exact except for the encoders' resolution; callers add noise.
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
from .start import check_one
from .trajectory import Trajectory


def encoders(scene: CompiledScene, trajectory: Trajectory) -> np.ndarray:
    """Read the joints' encoders.

    Parameters
    ----------
    scene : CompiledScene
        The scene of the run.
    trajectory : Trajectory
        What `simulate` returns, with the channel q.

    Returns
    -------
    ndarray, shape (samples, joints)
        Joint angles rounded to the servos' encoder resolution [rad].

    Raises
    ------
    ValueError
        A channel was not recorded.
    """
    check_one(scene, "a sensor")
    q = _channels(trajectory, "q")[0]
    servos = [scene.model.servos.get(name) for name in scene.model.joint_names]
    steps = np.array([servo.encoder_resolution if servo else 0.0 for servo in servos])
    exact = steps == 0.0
    counts = np.rint(q / np.where(exact, 1.0, steps))
    return np.where(exact, q, counts * steps)


def gyroscope(scene: CompiledScene, trajectory: Trajectory) -> np.ndarray:
    """Read a gyroscope on the trunk.

    Parameters
    ----------
    scene : CompiledScene
        The scene of the run.
    trajectory : Trajectory
        What `simulate` returns, with the channel base_qd.

    Returns
    -------
    ndarray, shape (samples, 3)
        Angular velocity of the trunk in its own axes [rad/s].

    Raises
    ------
    ValueError
        A channel was not recorded, or the base is fixed.
    """
    _check_floating(scene)
    return _channels(trajectory, "base_qd")[0][:, 3:]


def accelerometer(scene: CompiledScene, trajectory: Trajectory, position: ArrayLike = (0.0, 0.0, 0.0)) -> np.ndarray:
    """Read an accelerometer on the trunk.

    An acceleration is the mean over the step before the sample, in the first sample of a run that at its start.

    Parameters
    ----------
    scene : CompiledScene
        The scene of the run.
    trajectory : Trajectory
        What `simulate` returns, with the channels base_q, base_qd and base_qdd.
    position : array_like, shape (3,)
        Place of the sensor in the trunk's axes [m].

    Returns
    -------
    ndarray, shape (samples, 3)
        Specific force, which is acceleration minus gravity, in the trunk's axes [m/s^2].

    Raises
    ------
    ValueError
        A channel was not recorded, or the base is fixed.
    """
    _check_floating(scene)
    q, qd, qdd = _channels(trajectory, "base_q", "base_qd", "base_qdd")
    omega, alpha, r = qd[:, 3:], qdd[:, 3:], vector("position", position, 3, "[m]")
    linear = np.einsum("kji,kj->ki", _rotations(q), qdd[:, :3] - scene.constants.gravity)
    return linear + np.cross(alpha, r) + np.cross(omega, np.cross(omega, r))


def sole_forces(scene: CompiledScene, trajectory: Trajectory) -> dict[str, np.ndarray]:
    """Sum the ground's forces on each link that has contact points.

    Parameters
    ----------
    scene : CompiledScene
        The scene of the run.
    trajectory : Trajectory
        What `simulate` returns, with the channel contact_force, and on a height field q and base_q.

    Returns
    -------
    dict of ndarray, shape (samples, 3)
        Force on each link in world axes [N].

    Raises
    ------
    ValueError
        A channel was not recorded, or the scene has no ground.
    """
    check_one(scene, "a sensor")
    forces, ground = _contact_forces(scene, trajectory), scene.ground or Ground()
    forces = in_world(ground, forces, contact_positions(scene, trajectory) if ground.field else None)
    links = [point.link for point in scene.model.contacts]
    return {name: forces[:, [link == name for link in links]].sum(axis=1) for name in dict.fromkeys(links)}


def center_of_pressure(scene: CompiledScene, trajectory: Trajectory, link: str | None = None) -> np.ndarray:
    """Find the center of pressure.

    Parameters
    ----------
    scene : CompiledScene
        The scene of the run.
    trajectory : Trajectory
        What `simulate` returns, with the channels q, base_q (of a floating robot) and contact_force.
    link : str, optional
        The link whose contact points count; by default those of all links.

    Returns
    -------
    ndarray, shape (samples, 3)
        Where the normal forces balance in world axes [m]; NaN where nothing touches.

    Raises
    ------
    ValueError
        A channel was not recorded, the scene has no ground, or the link no contact points.
    """
    check_one(scene, "a sensor")
    points = [k for k, point in enumerate(scene.model.contacts) if link is None or point.link == str(link)]
    if not points:
        links = ", ".join(dict.fromkeys(point.link for point in scene.model.contacts))
        raise ValueError(f"{scene.model.name}: link {link!r} has no contact points; use one of {links}")
    normal = _contact_forces(scene, trajectory)[:, points, 0]
    total = normal.sum(axis=1)
    share = normal / np.where(total > 0.0, total, np.nan)[:, None]
    return np.einsum("kc,kci->ki", share, contact_positions(scene, trajectory)[:, points])


def contact_positions(scene: CompiledScene, trajectory: Trajectory) -> np.ndarray:
    """Find the contact points over time.

    Parameters
    ----------
    scene : CompiledScene
        The scene of the run.
    trajectory : Trajectory
        What `simulate` returns, with the channels q and, of a floating robot, base_q.

    Returns
    -------
    ndarray, shape (samples, points, 3)
        Contact points in the model's order, in world axes [m].

    Raises
    ------
    ValueError
        A channel was not recorded.
    """
    check_one(scene, "a sensor")
    q = _channels(trajectory, "q")[0]
    if scene.tree.floating:
        q = np.hstack([_channels(trajectory, "base_q")[0], q])
    return dynamics.contact_positions(scene.model, q)


def in_world(ground: Ground, forces: np.ndarray, positions: np.ndarray | None) -> np.ndarray:
    """Turn forces from the ground's axes into the world's.

    Parameters
    ----------
    ground : Ground
        The ground that acts.
    forces : ndarray, shape (..., points, 3)
        Normal and tangential forces on contact points [N].
    positions : ndarray, shape (..., points, 3), or None
        Contact points in world axes [m]; only a height field needs them.

    Returns
    -------
    ndarray, shape (..., points, 3)
        The forces in world axes [N].
    """
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
    check_one(scene, "a sensor")
    if not scene.tree.floating:
        raise ValueError(f"{scene.model.name}: an IMU needs a floating base; load the robot with base='floating'")


def _rotations(q: np.ndarray) -> np.ndarray:
    """Convert the unit quaternions in q[:, 3:7] to rotation matrices (samples, 3, 3), body to world."""
    w, v = q[:, 3, None, None], q[:, 4:7]
    cross = np.cross(np.eye(3), v[:, None])  # cross @ a = v x a
    return np.eye(3) + 2.0 * (w * cross + cross @ cross)
