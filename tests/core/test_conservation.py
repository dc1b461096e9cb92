"""Balances of power and momentum, instant by instant: how fast energy and momentum change along the motion."""

import numpy as np
import pytest
from random_tree import random_states, random_tree

from featherstone_gait.dynamics import Wrench, center_of_mass, energy, forward_dynamics, forward_kinematics, momentum
from featherstone_gait.robot_file import load_robot

STEP = 1e-4  # [s]
GRAVITY = np.array([0.0, 0.0, -9.81])
MODELS = {
    "arm": lambda: load_robot("arm7_spatial"),
    "humanoid": lambda: load_robot("humanoid"),
    "fixed tree": lambda: random_tree(20, 1),
    "floating tree": lambda: random_tree(20, 2, base="floating"),
}


@pytest.fixture(params=MODELS)
def model(request):
    return MODELS[request.param]()


def gentle_state(model, seed):
    """A state whose accelerations are some 10^3 rad/s^2 at most, so that differences in time resolve them."""
    q, qd, tau = (a[0] for a in random_states(model, 1, seed))
    return q, qd, 0.1 * tau


def moved(model, q, qd, qdd, t):
    """The state after time t, to first order (a quaternion of any length is a rotation)."""
    joints = len(model.moving_joints)
    later = q.copy()
    later[model.nq - joints :] += t * qd[model.nv - joints :]
    if model.base == "floating":
        later[:3] += t * qd[:3]
        w, x, y, z = q[3:7]
        later[3:7] += 0.5 * t * np.array([[-x, -y, -z], [w, -z, y], [z, w, -x], [-y, x, w]]) @ qd[3:6]
    return later, qd + t * qdd


def rate(model, measure, q, qd, qdd):
    """Time derivative of measure(q, qd) along the motion (central differences of fourth order)."""
    before2, before, after, after2 = (measure(*moved(model, q, qd, qdd, k * STEP)) for k in (-2, -1, 1, 2))
    return (before2 - 8 * before + 8 * after - after2) / (12 * STEP)


def test_energy_grows_by_the_power_of_the_forces(model):
    q, qd, tau = gentle_state(model, 1)
    armature = np.full(len(model.joint_names), 1e-4)
    qdd = forward_dynamics(model, q, qd, tau, armature=armature)
    power = rate(model, lambda q, qd: energy(model, q, qd, armature=armature), q, qd, qdd)
    assert abs(power.sum() - tau @ qd) <= 1e-9 * np.abs(power).max()


def test_energy_grows_by_the_power_of_a_wrench(model):
    q, qd, tau = gentle_state(model, 2)
    link = model.links[-1].name
    wrench = np.array([0.01, -0.02, 0.03, 0.4, -0.5, 0.6])
    qdd = forward_dynamics(model, q, qd, 0 * tau, wrench={link: Wrench(wrench[3:], wrench[:3])})
    gain = rate(model, lambda q, qd: energy(model, q, qd), q, qd, qdd)
    velocity = rate(model, lambda q, qd: forward_kinematics(model, q).position[-1], q, qd, qdd)
    E = forward_kinematics(model, q).rotation[-1]
    spin = rate(model, lambda q, qd: forward_kinematics(model, q).rotation[-1], q, qd, qdd) @ E.T
    turning = np.array([spin[2, 1], spin[0, 2], spin[1, 0]])
    work = wrench @ np.concatenate([turning, velocity])
    assert abs(gain.sum() - work) <= 1e-9 * np.abs(gain).max()


@pytest.mark.nojit
@pytest.mark.parametrize("name", ["humanoid", "floating tree"])
def test_inner_forces_change_no_momentum_and_weight_only_the_linear_one(name):
    model = MODELS[name]()
    q, qd, tau = gentle_state(model, 3)
    tau[:6] = 0.0
    qdd = forward_dynamics(model, q, qd, tau)
    force = rate(model, lambda q, qd: momentum(model, q, qd), q, qd, qdd)
    largest = np.abs(qdd).max() * model.mass
    np.testing.assert_allclose(force[3:], model.mass * GRAVITY, rtol=0, atol=1e-10 * largest)
    np.testing.assert_allclose(force[:3], 0.0, rtol=0, atol=1e-11 * largest)


def test_a_push_on_the_base_changes_momentum_by_its_force_and_moment():
    model = load_robot("humanoid")
    q, qd, tau = gentle_state(model, 4)
    tau[:6] = [1.0, -2.0, 3.0, 0.1, 0.2, -0.3]
    qdd = forward_dynamics(model, q, qd, tau, gravity=np.zeros(3))
    change = rate(model, lambda q, qd: momentum(model, q, qd), q, qd, qdd)
    moment = forward_kinematics(model, q).rotation[0] @ tau[3:6]
    arm = q[:3] - center_of_mass(model, q)
    scale = np.abs(qdd).max() * model.mass
    np.testing.assert_allclose(change[3:], tau[:3], rtol=0, atol=1e-10 * scale)
    np.testing.assert_allclose(change[:3], moment + np.cross(arm, tau[:3]), rtol=0, atol=1e-11 * scale)


def test_linear_momentum_is_mass_by_the_velocity_of_the_center_of_mass(model):
    q, qd, _ = gentle_state(model, 5)
    velocity = rate(model, lambda q, qd: center_of_mass(model, q), q, qd, 0 * qd)
    p = momentum(model, q, qd)[3:]
    np.testing.assert_allclose(model.mass * velocity, p, rtol=0, atol=1e-9 * np.abs(p).max())


def test_a_robot_in_free_fall_feels_no_weight():
    """Of a thrown robot only the path of the base depends on gravity."""
    model = load_robot("humanoid")
    q, qd, tau = gentle_state(model, 6)
    fall, float_ = (forward_dynamics(model, q, qd, tau, gravity=g) for g in (GRAVITY, np.zeros(3)))
    scale = np.abs(float_).max()
    np.testing.assert_allclose(fall[:3] - GRAVITY, float_[:3], rtol=0, atol=1e-13 * scale)
    np.testing.assert_allclose(fall[3:], float_[3:], rtol=0, atol=1e-13 * scale)
