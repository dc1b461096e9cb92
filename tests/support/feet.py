"""Measures of a walk, recomputed by NumPy from the channels of a run."""

import itertools
import math

import numpy as np

from featherstone_gait.dynamics import center_of_mass, contact_positions_at, forward_kinematics
from featherstone_gait.scene.contact import plane_axes


def steps_of(run, scene):
    """Clearances of all swings, slip [m] and share of time near a fall; run: channels every 10 ms."""
    model, q = scene.model, np.hstack([run["base_q"], run["q"]])
    poses, force = forward_kinematics(model, q), run["contact_force"][:, :, 0]
    points, heights, slip = contact_positions_at(model, poses), [], 0.0
    links = [point.link for point in model.contacts]
    up, level = plane_axes(scene.ground)[0], scene.ground.height * plane_axes(scene.ground)[0, 2]
    for foot in dict.fromkeys(links):
        own = [k for k, link in enumerate(links) if link == foot]
        on = np.flatnonzero((force[:, own] > 0.0).any(axis=1))
        for a, b in itertools.pairwise(on):
            if b - a > 0.1 / 0.01:
                heights.append((points[a + 1 : b, own] @ up - level).min(axis=1).max())
    rows = [model.link_index(link) for link in links]
    for k in range(len(q) - 1):
        load = np.minimum(force[k], force[k + 1])
        R, other = poses.rotation[k, rows], poses.rotation[k + 1, rows]
        arm = np.einsum("pji,pj->pi", R, points[k] - poses.position[k, rows])
        moved = poses.position[k + 1, rows] + np.einsum("pij,pj->pi", other, arm) - points[k]
        along = np.linalg.norm(moved - np.outer(moved @ up, up), axis=1)
        slip += load @ along / load.sum() if load.any() else 0.0
    near = center_of_mass(model, q) @ up - level < 0.8 * scene.fall_height / 0.6
    tilted = poses.rotation[:, 0, 2, 2] < math.cos(math.radians(22.5))
    return heights, slip, (near | tilted)[1:].mean()
