"""The zero-moment point (ZMP) of a moving robot, summed over its links, and its support polygon.

The ZMP is the point of the ground plane ``z = 0`` about which gravity and inertia have no horizontal moment.  With the
links' masses ``m``, centers ``c``, angular momenta ``L`` about them and ``F = m (c'' + g)``:

    p_x = sum(c_x F_z - c_z F_x - L'_y) / sum F_z,    p_y = sum(c_y F_z - c_z F_y + L'_x) / sum F_z.

Reference: M. Vukobratovic, B. Borovac, "Zero-moment point - thirty five years of its life", Int. J. Humanoid Robotics
1 (2004); S. Kajita et al., "Introduction to Humanoid Robotics" (Springer 2014), section 3.2.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import finite, real
from ..base.fixed_order import applied, total
from ..dynamics import check_model
from ..dynamics.tree import GRAVITY
from ..model import Model, inertia_matrix
from .kinematics import link_centers, link_poses

LEAST_SAMPLES = 5  # samples of a motion


def multibody_zmp(
    model: Model, angles: ArrayLike, base_position: ArrayLike, T: float, g: float = -GRAVITY[2]
) -> np.ndarray:
    """Compute the zero-moment point (ZMP) of a motion whose root link stays upright.

    Velocities and accelerations are central differences, so that the error is O(T^2); the first and last two samples
    repeat their neighbor's value.

    Parameters
    ----------
    model : Model
        The robot.
    angles : array_like, shape (n, nj)
        Joint angles [rad].
    base_position : array_like, shape (n, 3)
        Position of the root link [m].
    T : float
        Time between samples [s].
    g : float
        Strength of gravity [m/s^2].

    Returns
    -------
    ndarray, shape (n, 2)
        ZMP [m].
    """
    T = real("T", T, 1e-9, 1e9, "give the time between samples [s]")
    g = real("g", g, 1e-9, 1e9, "give the strength of gravity [m/s^2]")
    angles = finite("angles", angles, (None, len(check_model(model).joint_names)), "[rad]")
    base_position = finite("base_position", base_position, (len(angles), 3), "[m]")
    if len(angles) < LEAST_SAMPLES:
        raise ValueError(f"angles have {len(angles)} samples; accelerations take {LEAST_SAMPLES} or more")
    poses = link_poses(model, angles, base_position)
    mass, centers = np.array([link.mass for link in model.links]), link_centers(model, poses)
    center, acceleration = centers[2:-2], (centers[3:-1] - 2 * centers[2:-2] + centers[1:-3]) / (T * T)
    force = mass[:, None] * (acceleration + np.array([0.0, 0.0, g]))
    here, rate = poses.rotation[1:-1], _central_difference(poses.rotation, T)
    omega = 0.5 * total(np.cross(here, rate, axis=-2))  # of axes e that turn, the sum of e x e' is twice omega
    I = np.array([inertia_matrix(link.inertia) for link in model.links])
    momentum = applied(here, applied(I, applied(here.swapaxes(-1, -2), omega)))  # of links about their centers
    momentum_rate = total(_central_difference(momentum, T), axis=1)
    weight = total(force[..., 2])
    lever = total(center[..., :2] * force[..., 2:] - center[..., 2:] * force[..., :2], axis=1)
    zmp = (lever + np.stack([-momentum_rate[:, 1], momentum_rate[:, 0]], axis=1)) / weight[:, None]
    return np.pad(zmp, ((2, 2), (0, 0)), mode="edge")


def support_polygon(points: np.ndarray) -> np.ndarray:
    """Return the convex hull (k, 2) of ground `points` (m, 2) [m], counter-clockwise."""
    from scipy.spatial import ConvexHull  # slow to import

    return points[ConvexHull(points).vertices]


def polygon_margin(point: np.ndarray, polygon: np.ndarray) -> float:
    """Return how far `point` (2,) lies inside a convex, counter-clockwise `polygon` (k, 2) [m]; negative is outside.

    Inside, it is the distance to the nearest edge; outside, that to the farthest of the edges' lines that it is beyond.
    """
    edge = np.roll(polygon, -1, axis=0) - polygon
    offset = point - polygon
    inside = edge[:, 0] * offset[:, 1] - edge[:, 1] * offset[:, 0]
    return float((inside / np.hypot(*edge.T)).min())


def _central_difference(x: np.ndarray, T: float) -> np.ndarray:
    return (x[2:] - x[:-2]) / (2 * T)
