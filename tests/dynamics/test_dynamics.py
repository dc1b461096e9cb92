"""Forward and inverse dynamics, mass matrix, energy, momentum: against MuJoCo, closed forms and one another."""

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from mujoco_oracle import Oracle
from random_tree import numbers, random_states, random_tree

from featherstone_gait.base.rotation import rotation_from_rpy
from featherstone_gait.dynamics import (
    Wrench,
    center_of_mass,
    contact_positions,
    energy,
    forward_dynamics,
    forward_kinematics,
    inverse_dynamics,
    mass_matrix,
    momentum,
)
from featherstone_gait.dynamics.tree import compile_tree
from featherstone_gait.model import ContactPoint, Joint, Link, Model, inertia_matrix
from featherstone_gait.robot_file import load_robot, robot_names

SHAPES = [(1, 1.0), (2, 1.0), (3, 2.0), (7, 1.3), (20, 1.0), (20, 1.5), (50, 1.0), (50, 1.2), (50, 4.0)]


@pytest.fixture(params=robot_names())
def robot(request):
    return load_robot(request.param)


def tree_of(shape, base, seed=0):
    nb, branching = shape
    return random_tree(nb, seed + nb, branching=branching, base=base)


def error(x, exact):
    """Greatest difference of a state by the greatest value of that state, over all states."""
    return (np.abs(x - exact).max(axis=-1) / np.abs(exact).max(axis=-1)).max()


# Against MuJoCo


def forward_dynamics_error(model, count):
    q, qd, tau = random_states(model, count, seed=1)
    return error(forward_dynamics(model, q, qd, tau), Oracle(model).forward_dynamics(q, qd, tau))


def test_robots_accelerate_as_in_mujoco(robot):
    assert forward_dynamics_error(robot, 1000) <= 1e-10


@pytest.mark.parametrize("base", ["fixed", "floating"])
@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_random_trees_accelerate_as_in_mujoco(shape, base):
    assert forward_dynamics_error(tree_of(shape, base), 1000) <= 1e-10


@pytest.mark.parametrize("base", ["fixed", "floating"])
@pytest.mark.parametrize("branching", [1.0, 1.3, 3.0])
def test_trees_of_100_bodies_accelerate_as_in_mujoco(branching, base):
    assert forward_dynamics_error(tree_of((100, branching), base), 1000) <= 1e-9


@pytest.mark.nojit
@pytest.mark.parametrize("skew", [0.0, 0.5])
@pytest.mark.parametrize("base", ["fixed", "floating"])
def test_a_small_tree_accelerates_as_in_mujoco_in_rows_and_in_lanes(base, skew):
    model = random_tree(6, 1, base=base, skew=skew)
    assert forward_dynamics_error(model, 3) <= 1e-12
    assert forward_dynamics_error(model, 11) <= 1e-12


@pytest.mark.quick("*-floating")
@pytest.mark.nojit
@pytest.mark.parametrize("base", ["fixed", "floating"])
@pytest.mark.parametrize("shape", [(7, 1.3), (50, 1.2)], ids=str)
def test_wrenches_rotor_inertia_and_gravity_act_as_in_mujoco(shape, base):
    model = tree_of(shape, base)
    rng = np.random.default_rng(2)
    armature, gravity = rng.uniform(0, 1e-3, shape[0]), rng.normal(size=3)
    spatial = {f"body{k}": rng.normal(size=(16, 6)) for k in (0, shape[0] // 2, shape[0])}  # [moment; force]
    wrenches = {name: Wrench(f[:, 3:], f[:, :3]) for name, f in spatial.items()}
    q, qd, tau = random_states(model, 16, seed=3)
    ours = forward_dynamics(model, q, qd, tau, wrench=wrenches, armature=armature, gravity=gravity)
    oracle = Oracle(model, armature, gravity)
    for k in range(16):
        oracle.set(q[k], qd[k])
        for link, f in spatial.items():
            oracle.push(link, f[k])
        theirs = oracle.forward_dynamics(q[k : k + 1], qd[k : k + 1], tau[k : k + 1])
        assert error(ours[k], theirs) <= 1e-10


def test_mass_matrix_is_mujocos(robot):
    armature = np.linspace(0, 1e-3, len(robot.joint_names))
    oracle = Oracle(robot, armature)
    q, _, _ = random_states(robot, 20, seed=4)
    theirs = np.array([oracle.mass_matrix(x) for x in q])
    assert np.abs(mass_matrix(robot, q, armature=armature) - theirs).max() <= 1e-13 * np.abs(theirs).max()


@pytest.mark.parametrize("base", ["fixed", "floating"])
def test_mass_matrix_of_a_tree_is_mujocos(base):
    model = tree_of((50, 1.3), base)
    oracle = Oracle(model)
    q, _, _ = random_states(model, 20, seed=4)
    theirs = np.array([oracle.mass_matrix(x) for x in q])
    assert np.abs(mass_matrix(model, q) - theirs).max() <= 1e-13 * np.abs(theirs).max()


@pytest.mark.nojit
@pytest.mark.parametrize("base", ["fixed", "floating"])
@pytest.mark.parametrize("shape", [(1, 1.0), (7, 1.3), (50, 1.2)], ids=str)
def test_energy_center_of_mass_and_momentum_are_mujocos(shape, base):
    model = tree_of(shape, base)
    oracle = Oracle(model)
    q, qd, _ = random_states(model, 20, seed=5)
    ours = energy(model, q, qd), center_of_mass(model, q), momentum(model, q, qd)
    theirs = zip(*(oracle.measures(*state) for state in zip(q, qd)))
    for a, b in zip(ours, theirs):
        assert np.abs(a - np.array(b)).max() <= 1e-12 * np.abs(a).max()


def test_links_stand_where_mujocos_stand(robot):
    oracle = Oracle(robot)
    q, qd, _ = random_states(robot, 10, seed=6)
    poses = forward_kinematics(robot, q)
    ids = [oracle.m.body(link.name).id for link in robot.links]
    for k in range(10):
        oracle.set(q[k], qd[k])
        mujoco.mj_kinematics(oracle.m, oracle.d)
        np.testing.assert_allclose(poses.position[k], oracle.d.xpos[ids], rtol=0, atol=1e-14)
        np.testing.assert_allclose(poses.rotation[k].reshape(-1, 9), oracle.d.xmat[ids], rtol=0, atol=1e-14)


@pytest.mark.parametrize("base", ["fixed", "floating"])
def test_contact_points_move_with_their_links(base):
    rng = np.random.default_rng(7)
    model = tree_of((7, 1.5), base)
    points = tuple(ContactPoint(f"body{k}", numbers(rng.normal(size=3))) for k in (5, 0, 7, 5))
    model = replace(model, contacts=points)
    q, _, _ = random_states(model, 3, seed=7)
    found, poses = contact_positions(model, q), forward_kinematics(model, q)
    for k, point in enumerate(points):
        link = int(point.link[4:])
        expected = poses.position[:, link] + poses.rotation[:, link] @ point.position
        np.testing.assert_allclose(found[:, k], expected, rtol=0, atol=1e-15)
    assert (found[1] == contact_positions(model, q[1])).all()
    assert contact_positions(replace(model, contacts=()), q).shape == (3, 0, 3)
    assert contact_positions(replace(model, contacts=()), q[0]).shape == (0, 3)


# The algorithms against one another


def identity_error(model, count=200):
    q, qd, tau = random_states(model, count, seed=7)
    qdd = forward_dynamics(model, q, qd, tau)
    return error(forward_dynamics(model, q, qd, inverse_dynamics(model, q, qd, qdd)), qdd)


def test_aba_undoes_rnea_on_the_robots(robot):
    assert identity_error(robot, 1000) <= 1e-11


@pytest.mark.parametrize("base", ["fixed", "floating"])
@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_aba_undoes_rnea(shape, base):
    assert identity_error(tree_of(shape, base)) <= 1e-11


@pytest.mark.parametrize("base", ["fixed", "floating"])
@pytest.mark.parametrize("branching", [1.0, 1.3, 3.0])
def test_aba_undoes_rnea_with_100_bodies(branching, base):
    assert identity_error(tree_of((100, branching), base)) <= 3e-10


@pytest.mark.nojit
@pytest.mark.parametrize("count", [1, 9])
def test_aba_undoes_rnea_of_a_few_states(count):
    assert identity_error(load_robot("humanoid"), count) <= 1e-11


@pytest.mark.bounds
@pytest.mark.nojit
@pytest.mark.quick("*-floating")
@pytest.mark.parametrize("base", ["fixed", "floating"])
@pytest.mark.parametrize("count", [2, 9])
def test_aba_undoes_rnea_under_wrenches_with_rotors(base, count):
    model = tree_of((20, 1.5), base)
    q, qd, tau = random_states(model, count, seed=8)
    wrench = {"body20": Wrench([3.0, 4.0, 5.0], [0.0, 1.0, 2.0])}
    extra = {"wrench": wrench, "armature": np.full(20, 2e-3), "gravity": (1.0, -2.0, 3.0)}
    qdd = forward_dynamics(model, q, qd, tau, **extra)
    back = inverse_dynamics(model, q, qd, qdd, **extra)
    assert error(forward_dynamics(model, q, qd, back, **extra), qdd) <= 1e-11


@pytest.mark.nojit
@pytest.mark.parametrize("base", ["fixed", "floating"])
def test_columns_of_the_mass_matrix_are_forces_of_unit_accelerations(base):
    model = tree_of((7, 1.3), base)
    armature = np.linspace(0, 1e-2, 7)
    q, qd, _ = random_states(model, 1, seed=9)
    unit = np.eye(model.nv)
    columns = inverse_dynamics(model, q, 0 * qd, unit, armature=armature, gravity=np.zeros(3))
    H = mass_matrix(model, q[0], armature=armature)
    assert np.abs(columns.T - H).max() <= 1e-14 * np.abs(H).max()


@pytest.mark.parametrize("base", ["fixed", "floating"])
@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_equation_of_motion(shape, base):
    """H qdd + bias = tau, with H symmetric positive definite."""
    model = tree_of(shape, base)
    armature = np.full(shape[0], 1e-4)
    q, qd, qdd = random_states(model, 8, seed=10)
    H = mass_matrix(model, q, armature=armature)
    bias = inverse_dynamics(model, q, qd, 0 * qdd, armature=armature)
    tau = inverse_dynamics(model, q, qd, qdd, armature=armature)
    assert error(np.einsum("nij,nj->ni", H, qdd) + bias, tau) <= 1e-12
    assert (H == H.transpose(0, 2, 1)).all()
    assert (np.linalg.eigvalsh(H) > 0).all()


@pytest.mark.nojit
@pytest.mark.parametrize("base", ["fixed", "floating"])
@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_kinetic_energy_is_half_the_mass_matrix_by_the_velocities(shape, base):
    model = tree_of(shape, base)
    armature = np.full(shape[0], 1e-3)
    q, qd, _ = random_states(model, 20, seed=11)
    H = mass_matrix(model, q, armature=armature)
    half = 0.5 * np.einsum("ni,nij,nj->n", qd, H, qd)
    np.testing.assert_allclose(energy(model, q, qd, armature=armature)[:, 0], half, rtol=1e-12)


def test_momentum_is_the_base_rows_of_the_mass_matrix_by_the_velocities():
    model = load_robot("humanoid")
    q, qd, _ = random_states(model, 20, seed=12)
    rows = np.einsum("nij,nj->ni", mass_matrix(model, q)[:, :6], qd)
    E = forward_kinematics(model, q).rotation[:, 0]
    p = momentum(model, q, qd)
    about_base = p[:, :3] + np.cross(center_of_mass(model, q) - q[:, :3], p[:, 3:])
    assert error(rows[:, :3], p[:, 3:]) <= 1e-12
    assert error(np.einsum("nij,nj->ni", E, rows[:, 3:]), about_base) <= 1e-12


def test_weight_is_the_slope_of_the_potential_energy():
    """Forces that hold a robot at rest, against differences of its potential energy."""
    model = tree_of((7, 1.3), "fixed")
    q, qd, _ = random_states(model, 1, seed=13)
    hold = inverse_dynamics(model, q[0], 0 * qd[0], 0 * qd[0])
    h = 1e-3
    V = [energy(model, q + k * h * np.eye(7), 0 * qd)[:, 1] for k in (-2, -1, 1, 2)]
    slope = (V[0] - 8 * V[1] + 8 * V[2] - V[3]) / (12 * h)
    np.testing.assert_allclose(hold, slope, rtol=0, atol=1e-10 * np.abs(hold).max())


def test_a_wrench_does_the_work_of_its_force():
    """The forces against a pull on a point are minus the slope of the work of that pull."""
    model = tree_of((7, 1.3), "fixed")
    q, qd, _ = random_states(model, 1, seed=14)
    force = np.array([3.0, -1.0, 2.0])
    pull = {"body7": Wrench(force)}
    still = 0 * qd[0]
    against = inverse_dynamics(model, q[0], still, still, wrench=pull) - inverse_dynamics(model, q[0], still, still)
    h = 1e-3
    x = [forward_kinematics(model, q + k * h * np.eye(7)).position[:, -1] @ force for k in (-2, -1, 1, 2)]
    slope = (x[0] - 8 * x[1] + 8 * x[2] - x[3]) / (12 * h)
    np.testing.assert_allclose(against, -slope, rtol=0, atol=1e-10 * np.abs(slope).max())


# Closed forms


@pytest.mark.nojit
def test_double_pendulum():
    m1, m2, l1, c1, c2, I1, I2, g = 1.3, 0.7, 0.4, 0.15, 0.25, 0.02, 0.01, 9.81
    links = (Link("base", 0.0, (0, 0, 0), (0,) * 6), bar("one", m1, c1, I1), bar("two", m2, c2, I2))
    joints = (
        Joint("q1", "revolute", "base", "one", axis=(0.0, 1.0, 0.0)),
        Joint("q2", "revolute", "one", "two", (0.0, 0.0, -l1), axis=(0.0, 1.0, 0.0)),
    )
    model = Model("double_pendulum", links, joints)
    rng = np.random.default_rng(15)
    for q1, q2, u1, u2 in rng.normal(size=(10, 4)) * 2:
        k = m2 * l1 * c2
        M11 = I1 + I2 + m1 * c1**2 + m2 * (l1**2 + c2**2) + 2 * k * math.cos(q2)
        M12 = I2 + m2 * c2**2 + k * math.cos(q2)
        M = [[M11, M12], [M12, I2 + m2 * c2**2]]
        C = np.array([-k * math.sin(q2) * (2 * u1 * u2 + u2**2), k * math.sin(q2) * u1**2])
        lower = m2 * c2 * math.sin(q1 + q2)
        G = g * np.array([(m1 * c1 + m2 * l1) * math.sin(q1) + lower, lower])
        q, qd = np.array([q1, q2]), np.array([u1, u2])
        np.testing.assert_allclose(mass_matrix(model, q), M, rtol=1e-12)
        assert error(inverse_dynamics(model, q, qd, np.zeros(2), gravity=np.zeros(3)), C) <= 1e-12
        assert error(inverse_dynamics(model, q, np.zeros(2), np.zeros(2)), G) <= 1e-12
        assert error(forward_dynamics(model, q, qd, np.zeros(2)), np.linalg.solve(M, -C - G)) <= 1e-12


@pytest.mark.nojit
def test_pendulum_on_a_cart():
    cart, m, c, I, g = 0.9, 0.4, 0.3, 0.006, 9.81
    links = (Link("rail", 0.0, (0, 0, 0), (0,) * 6), bar("cart", cart, 0.0, 0.001), bar("pole", m, c, I))
    joints = (
        Joint("slide", "prismatic", "rail", "cart", axis=(1.0, 0.0, 0.0)),
        Joint("swing", "revolute", "cart", "pole", axis=(0.0, -1.0, 0.0)),
    )
    model = Model("cart_pole", links, joints)
    for a, u in np.random.default_rng(16).normal(size=(10, 2)):
        M = [[cart + m, m * c * math.cos(a)], [m * c * math.cos(a), I + m * c**2]]
        bias = np.array([-m * c * math.sin(a) * u**2, m * g * c * math.sin(a)])
        np.testing.assert_allclose(mass_matrix(model, [0.3, a]), M, rtol=1e-12)
        assert error(forward_dynamics(model, [0.3, a], [5.0, u], [0.0, 0.0]), np.linalg.solve(M, -bias)) <= 1e-12


def bar(name, mass, center, I):
    """A bar that hangs along -z, with inertia I about y through its center of mass."""
    return Link(name, mass, (0.0, 0.0, -center), (I, 0.0, 0.0, I, 0.0, 0.1 * I))


@pytest.mark.nojit
def test_a_thrown_body_falls_and_turns_as_euler_says():
    link = Link("stone", 0.5, (0.0, 0.0, 0.0), (1e-3, 0.0, 0.0, 2e-3, 0.0, 2.5e-3))
    model = Model("stone", (link,), (), "floating")
    q = [1.0, 2.0, 3.0, 0.5, -0.1, 0.7, 0.2]
    w, moment, force = np.array([1.0, -2.0, 3.0]), np.array([0.1, 0.2, -0.3]), np.array([1.0, 0.0, 2.0])
    I = np.array([1e-3, 2e-3, 2.5e-3])
    qdd = forward_dynamics(model, q, [4.0, 5.0, 6.0, *w], [*force, *moment])
    np.testing.assert_allclose(qdd[:3], force / 0.5 + [0, 0, -9.81], rtol=1e-13)
    np.testing.assert_allclose(qdd[3:], (moment - np.cross(w, I * w)) / I, rtol=1e-13)


# Symmetries


@pytest.mark.nojit
def test_turning_the_world_leaves_joint_accelerations_unchanged():
    model = load_robot("humanoid")
    q, qd, tau = (a[0] for a in random_states(model, 1, seed=17))
    axis, angle = np.array([2.0, -1.0, 2.0]) / 3, 0.83
    R = turn(axis, angle)
    turned_q, turned_qd, turned_tau = q.copy(), qd.copy(), tau.copy()
    turned_q[:3] = R @ q[:3] + [10.0, -20.0, 30.0]
    turned_q[3:7] = product(np.array([math.cos(angle / 2), *(math.sin(angle / 2) * axis)]), q[3:7])
    turned_qd[:3], turned_tau[:3] = R @ qd[:3], R @ tau[:3]
    qdd = forward_dynamics(model, q, qd, tau)
    turned = forward_dynamics(model, turned_q, turned_qd, turned_tau, gravity=R @ [0, 0, -9.81])
    assert error(turned[3:], qdd[3:]) <= 1e-12
    assert error(turned[:3], R @ qdd[:3]) <= 1e-12


def turn(axis, angle):
    """Rotation matrix about a unit axis (Rodrigues)."""
    K = np.cross(axis, np.eye(3)).T
    return np.eye(3) + math.sin(angle) * K + (1 - math.cos(angle)) * K @ K


def product(a, b):
    """Quaternion product."""
    return np.array([a[0] * b[0] - a[1:] @ b[1:], *(a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:]))])


def test_moving_away_changes_not_one_bit():
    model = load_robot("humanoid")
    q, qd, tau = (a[0] for a in random_states(model, 1, seed=18))
    far = q.copy()
    far[:3] = 1e6
    assert forward_dynamics(model, far, qd, tau).tobytes() == forward_dynamics(model, q, qd, tau).tobytes()


def test_the_length_of_the_quaternion_does_not_matter():
    model = load_robot("humanoid")
    q, qd, tau = (a[0] for a in random_states(model, 1, seed=19))
    long = q.copy()
    long[3:7] *= -3.7
    assert error(forward_dynamics(model, long, qd, tau), forward_dynamics(model, q, qd, tau)) <= 1e-13


@pytest.mark.parametrize("base", ["fixed", "floating"])
def test_the_order_of_joints_in_the_file_only_orders_the_results(base):
    model = tree_of((20, 1.5), base)
    q, qd, tau = random_states(model, 9, seed=20)
    order = np.random.default_rng(21).permutation(20)
    shuffled = replace(model, joints=tuple(model.joints[k] for k in order), links=model.links[::-1])
    first = model.nv - 20
    rows = np.concatenate([np.arange(first), first + order])
    positions = np.concatenate([np.arange(model.nq - 20), model.nq - 20 + order])
    qdd = forward_dynamics(shuffled, q[:, positions], qd[:, rows], tau[:, rows])
    assert error(qdd, forward_dynamics(model, q, qd, tau)[:, rows]) <= 1e-12


@pytest.mark.nojit
@pytest.mark.parametrize("base", ["fixed", "floating"])
def test_splitting_a_link_changes_nothing(base):
    """A link cut into two that a fixed joint holds together, their centers apart and one frame turned, moves as one."""
    model = tree_of((7, 1.3), base)
    whole = model.links[4]
    apart, shift, E = np.array([1e-3, -2e-3, 1e-3]), np.array([0.1, 0.2, -0.3]), turn((0.0, 0.0, 1.0), math.pi / 2)
    J = inertia_matrix(whole.inertia) / 2 - whole.mass / 2 * (apart @ apart * np.eye(3) - np.outer(apart, apart))
    center = np.array(whole.center_of_mass)
    first = body(whole.name, whole.mass / 2, center + apart, J)
    second = body("second", whole.mass / 2, E.T @ (center - apart - shift), E.T @ J @ E)
    glue = Joint("glue", "fixed", whole.name, "second", numbers(shift), (0.0, 0.0, math.pi / 2))
    split = replace(model, links=(*model.links[:4], first, *model.links[5:], second), joints=(*model.joints, glue))
    q, qd, tau = random_states(model, 9, seed=22)
    assert error(forward_dynamics(split, q, qd, tau), forward_dynamics(model, q, qd, tau)) <= 1e-12


def body(name, mass, center, J):
    return Link(name, mass, numbers(center), numbers(J[[0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]))


# Locked joints


@pytest.mark.nojit
def test_a_locked_joint_is_a_fixed_one():
    model = tree_of((12, 1.5), "floating")
    hinge = next(j for j in model.joints[1:] if j.type != "prismatic")
    slide = next(j for j in model.joints if j.type == "prismatic")
    locked = replace(model, locked={hinge.name: 0.7, slide.name: -0.05})
    fixed = replace(model, joints=tuple(held(j, locked.locked.get(j.name)) for j in model.joints))
    q, qd, tau = random_states(locked, 9, seed=23)
    assert error(forward_dynamics(locked, q, qd, tau), forward_dynamics(fixed, q, qd, tau)) <= 1e-12
    ours, theirs = forward_kinematics(locked, q), forward_kinematics(fixed, q)
    np.testing.assert_allclose(ours.position, theirs.position, rtol=0, atol=1e-14)
    np.testing.assert_allclose(ours.rotation, theirs.rotation, rtol=0, atol=1e-14)


def held(joint, position):
    """The joint, or a fixed one at that position."""
    if position is None:
        return joint
    E, xyz = rotation_from_rpy(joint.rpy), np.array(joint.xyz)
    if joint.type == "prismatic":
        xyz = xyz + E @ (position * np.array(joint.axis))
    else:
        E = E @ turn(joint.axis, position)
    rpy = math.atan2(E[2, 1], E[2, 2]), math.atan2(-E[2, 0], math.hypot(E[0, 0], E[1, 0])), math.atan2(E[1, 0], E[0, 0])
    return replace(joint, type="fixed", xyz=numbers(xyz), rpy=rpy)


def test_a_locked_humanoid_is_mujocos_welded_one():
    model = load_robot("humanoid")
    midway = {joint.name: (joint.lower + joint.upper) / 2 + 0.1 for joint in model.moving_joints[::3]}
    locked = replace(model, locked=model.locked | midway)
    assert locked.nv < model.nv
    assert forward_dynamics_error(locked, 1000) <= 1e-10


def test_a_locked_joint_is_one_of_endless_rotor_inertia():
    model = tree_of((7, 1.3), "fixed")
    locked = replace(model, locked={"joint4": 0.0})
    q, qd, tau = random_states(model, 9, seed=24)
    q[:, 3] = qd[:, 3] = 0.0
    rest = [0, 1, 2, 4, 5, 6]
    heavy = forward_dynamics(model, q, qd, tau, armature=np.eye(7)[3] * 1e12)
    assert error(heavy[:, rest], forward_dynamics(locked, q[:, rest], qd[:, rest], tau[:, rest])) <= 1e-9


# Functions


def test_calling_twice_is_calling_once_and_nothing_is_changed():
    model = load_robot("humanoid")
    states = random_states(model, 9, seed=25)
    before = [a.tobytes() for a in (*states, compile_tree(model).bodies)]
    once, twice = forward_dynamics(model, *states), forward_dynamics(model, *states)
    assert once.tobytes() == twice.tobytes()
    assert before == [a.tobytes() for a in (*states, compile_tree(model).bodies)]


@pytest.mark.nojit
def test_one_state_gives_one_row_and_one_argument_may_serve_all():
    model = tree_of((3, 1.0), "fixed")
    q, qd, tau = random_states(model, 4, seed=26)
    assert forward_dynamics(model, q[0], qd[0], tau[0]).shape == (3,)
    assert forward_dynamics(model, q[:1], qd[0], tau[0]).shape == (1, 3)
    assert mass_matrix(model, q).shape == (4, 3, 3)
    assert energy(model, q[0], qd[0]).shape == (2,)
    assert center_of_mass(model, q).shape == (4, 3)
    assert momentum(model, q, qd[0]).shape == (4, 6)
    same = forward_dynamics(model, q, np.tile(qd[0], (4, 1)), tau)
    assert forward_dynamics(model, q, qd[0], tau).tobytes() == same.tobytes()


CALLS = {
    "forward_dynamics": (forward_dynamics, ("q", "qd", "tau")),
    "inverse_dynamics": (inverse_dynamics, ("q", "qd", "qdd")),
    "mass_matrix": (mass_matrix, ("q",)),
    "energy": (energy, ("q", "qd")),
    "center_of_mass": (center_of_mass, ("q",)),
    "momentum": (momentum, ("q", "qd")),
    "forward_kinematics": (forward_kinematics, ("q",)),
    "contact_positions": (contact_positions, ("q",)),
}


@pytest.mark.nojit
@pytest.mark.parametrize("base", ["fixed", "floating"])
@pytest.mark.parametrize("name", CALLS)
def test_wrong_shapes_and_values_raise_and_name_the_argument(name, base):
    function, names = CALLS[name]
    model = tree_of((3, 1.0), base)
    q, qd, tau = (a[0] for a in random_states(model, 1, seed=27))
    for k, argument in enumerate(names):
        for bad, words in spoiled((q, qd, tau)[k]):
            arguments = [q, qd, tau][: len(names)]
            arguments[k] = bad
            with pytest.raises(ValueError, match=rf"{model.name}: {argument} .*{words}"):
                function(model, *arguments)


def spoiled(a):
    """Wrong versions of an argument, with what the message must say."""
    yield a[:-1], "shape"
    yield np.append(a, 0.0), "shape"
    yield a[None, None], "shape"
    yield 0.0, "shape"
    yield np.where(np.arange(len(a)) == len(a) - 1, np.nan, a), "not finite"
    yield np.where(np.arange(len(a)) == 0, -np.inf, a), "not finite"
    yield np.where(np.arange(len(a)) == 0, np.inf, np.array([a, a])), "not finite"


@pytest.mark.nojit
def test_arguments_that_do_not_fit_one_another_raise():
    model = tree_of((3, 1.0), "floating")
    q, qd, tau = random_states(model, 3, seed=28)
    with pytest.raises(ValueError, match="qd has 2 rows where another argument has 3"):
        forward_dynamics(model, q, qd[:2], tau)
    for armature in ([1.0], np.full(9, 0.1), [0.0, np.nan, 0.0]):
        with pytest.raises(ValueError, match="armature must be 3 finite numbers"):
            forward_dynamics(model, q, qd, tau, armature=armature)
    with pytest.raises(ValueError, match="gravity must be 3 finite numbers"):
        energy(model, q, qd, gravity=9.81)
    with pytest.raises(ValueError, match="no link 'tail' to push"):
        forward_dynamics(model, q, qd, tau, wrench={"tail": Wrench()})
    for wrench in (Wrench(np.zeros(6)), Wrench(np.zeros(3), np.zeros((2, 3))), Wrench(np.full(3, np.inf))):
        with pytest.raises(ValueError, match="wrench on body1 must be"):
            forward_dynamics(model, q, qd, tau, wrench={"body1": wrench})
    with pytest.raises(TypeError, match=r"wrench on body1 is .*; give Wrench\(force, moment\)"):
        forward_dynamics(model, q, qd, tau, wrench={"body1": np.zeros(6)})


@pytest.mark.nojit
def test_poses_that_are_none_raise():
    model = tree_of((3, 1.0), "floating")
    q, qd, tau = (a[0] for a in random_states(model, 1, seed=29))
    hinge = next(k for k, joint in enumerate(model.joints) if joint.type != "prismatic")
    endless = q.copy()
    endless[7 + hinge] = 1e10
    with pytest.raises(ValueError, match=f"angle of {model.joints[hinge].name} is 1e\\+10 rad"):
        forward_dynamics(model, endless, qd, tau)
    q[3:7] = 0.0
    with pytest.raises(ValueError, match="quaternion"):
        forward_dynamics(model, q, qd, tau)
