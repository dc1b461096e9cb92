"""What a scene works out in plain NumPy is what the compiled kernels say."""

import numpy as np
import pytest
from random_tree import random_tree

from featherstone_gait import load_robot
from featherstone_gait.dynamics import center_of_mass, forward_kinematics, mass_matrix
from featherstone_gait.model.numpy_dynamics import link_poses, mass_center, mass_matrix_at


def robots():
    yield load_robot("humanoid")
    yield load_robot("arm7_spatial")
    yield from (random_tree(8, seed, base=base) for seed in range(3) for base in ("fixed", "floating"))


@pytest.mark.parametrize("model", list(robots()), ids=lambda model: f"{model.name}-{model.base}")
def test_it_agrees_with_the_kernels(model):
    rng = np.random.default_rng(1)
    q, zero = rng.normal(size=model.nq), np.zeros(model.nq)
    if model.base == "floating":
        q[3:7] /= np.linalg.norm(q[3:7])
        zero[3] = 1.0
    armature = rng.random(len(model.joint_names))
    poses = forward_kinematics(model, q)
    for ours, theirs in zip(link_poses(model, q), poses, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-13 * (1.0 + np.abs(theirs).max()))
    np.testing.assert_allclose(mass_center(model, q), center_of_mass(model, q), atol=1e-12)
    q[: model.nq - len(armature)] = zero[: model.nq - len(armature)]
    for at in (zero, q):
        H = mass_matrix(model, at, armature=armature)
        np.testing.assert_allclose(mass_matrix_at(model, at, armature), H, atol=1e-13 * np.abs(H).max())
