"""Jacobians: against finite differences, the momentum of the dynamics, and Pinocchio."""

from dataclasses import replace

import numpy as np
import pytest
from pinocchio_oracle import coordinates, pinocchio_model
from random_tree import random_states, random_tree

from featherstone_gait import load_robot
from featherstone_gait.dynamics import center_of_mass, forward_kinematics, momentum
from featherstone_gait.dynamics.jacobians import center_of_mass_jacobian, jacobian, link_index
from featherstone_gait.model import Link, Mimic, Model

POINT = (0.03, -0.02, 0.05)
ROBOTS = {
    "fixed": random_tree(7, 1),
    "chain": random_tree(6, 2, branching=1.0, prismatic=0.5),
    "floating": random_tree(9, 3, base="floating"),
    "humanoid": load_robot("humanoid"),
    "locked": load_robot("humanoid", locked="simplified"),
}


def moved(model, q, v, dt):
    """Positions after a short time: q of the base along v, its quaternion by exp(dt omega / 2) in body axes."""
    if model.base == "fixed":
        return q + dt * v
    angle = dt * np.linalg.norm(v[3:6])
    turn = np.array([np.cos(angle / 2), *(np.sinc(angle / 2 / np.pi) * dt / 2 * v[3:6])])
    w, x, y, z = q[3:7]
    base = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]]) @ turn
    return np.concatenate([q[:3] + dt * v[:3], base, q[7:] + dt * v[6:]])


def central(model, q, column, of, dt=1e-5):
    """Derivative of a function of positions along a velocity coordinate, by a central difference of order four."""
    v = np.eye(model.nv)[column]
    values = [of(moved(model, q, v, k * dt)) for k in (-2, -1, 1, 2)]
    return (values[0] - 8 * values[1] + 8 * values[2] - values[3]) / (12 * dt)


@pytest.mark.nojit
@pytest.mark.parametrize("robot", ROBOTS)
def test_a_jacobian_is_the_derivative_of_the_pose(robot):
    model = ROBOTS[robot]
    q = random_states(model, 1, 4)[0][0]
    for link in (model.links[0].name, model.links[-1].name):
        row, J = link_index(model, link), jacobian(model, q, link, POINT)
        R = forward_kinematics(model, q).rotation[row]

        def pose(q, row=row):
            poses = forward_kinematics(model, q)
            return np.concatenate([poses.rotation[row].ravel(), poses.position[row] + poses.rotation[row] @ POINT])

        for column in range(model.nv):
            rate = central(model, q, column, pose)
            spin = rate[:9].reshape(3, 3) @ R.T
            expected = [spin[2, 1], spin[0, 2], spin[1, 0], *rate[9:]]
            assert J[:, column] == pytest.approx(expected, abs=1e-9)


@pytest.mark.bounds
@pytest.mark.nojit
@pytest.mark.parametrize("robot", ROBOTS)
def test_the_jacobian_of_the_center_of_mass_is_its_derivative(robot):
    model = ROBOTS[robot]
    q = random_states(model, 1, 5)[0][0]
    J = center_of_mass_jacobian(model, q)
    for column in range(model.nv):
        assert J[:, column] == pytest.approx(central(model, q, column, lambda q: center_of_mass(model, q)), abs=1e-9)


@pytest.mark.parametrize("robot", ["floating", "humanoid"])
def test_mass_times_velocity_of_the_center_is_the_momentum(robot):
    model = ROBOTS[robot]
    q, qd, _ = random_states(model, 5, 6)
    velocity = (center_of_mass_jacobian(model, q) @ qd[..., None])[..., 0]
    assert model.mass * velocity == pytest.approx(momentum(model, q, qd)[:, 3:], abs=1e-12)


@pytest.mark.parametrize("robot", ROBOTS)
def test_many_states_give_the_bits_of_one_by_one(robot):
    model = ROBOTS[robot]
    q, link = random_states(model, 11, 7)[0], model.links[-1].name
    assert np.array_equal(jacobian(model, q, link, POINT), [jacobian(model, row, link, POINT) for row in q])
    assert np.array_equal(center_of_mass_jacobian(model, q), [center_of_mass_jacobian(model, row) for row in q])


def test_body_axes_turn_the_rows():
    model = ROBOTS["humanoid"]
    q = random_states(model, 3, 8)[0]
    R = forward_kinematics(model, q).rotation[:, link_index(model, "left_foot")]
    world, body = (jacobian(model, q, "left_foot", POINT, frame) for frame in ("world", "body"))
    assert R @ body[:, :3] == pytest.approx(world[:, :3], abs=1e-14)
    assert R @ body[:, 3:] == pytest.approx(world[:, 3:], abs=1e-14)


def test_coupled_joints_keep_a_column_each():
    model = random_tree(4, 9, branching=1.0)
    joints = (*model.joints[:-1], replace(model.joints[-1], mimic=Mimic("joint1", 2.0)))
    q, coupled = random_states(model, 1, 10)[0][0], replace(model, joints=joints)
    assert np.array_equal(jacobian(coupled, q, "body4"), jacobian(model, q, "body4"))


@pytest.mark.parametrize("robot", ROBOTS)
def test_jacobians_agree_with_pinocchio(robot):
    pin = pytest.importorskip("pinocchio")
    model = ROBOTS[robot]
    theirs, frames = pinocchio_model(model, POINT)
    data = theirs.createData()
    for q in random_states(model, 10, 11)[0]:
        p, T = coordinates(theirs, model, q)
        pin.computeJointJacobians(theirs, data, p)
        pin.updateFramePlacements(theirs, data)
        for link, frame in frames.items():
            J = pin.getFrameJacobian(theirs, data, frame, pin.LOCAL_WORLD_ALIGNED) @ T
            ours = jacobian(model, q, link, POINT)
            assert ours == pytest.approx(np.vstack([J[3:], J[:3]]), abs=1e-12)
            assert jacobian(model, q, link, POINT, "body") == pytest.approx(
                np.vstack([*(pin.getFrameJacobian(theirs, data, frame, pin.LOCAL) @ T).reshape(2, 3, -1)[::-1]]),
                abs=1e-12,
            )
        share = pin.computeTotalMass(theirs) / model.mass  # a fixed base has no mass there
        J = share * pin.jacobianCenterOfMass(theirs, data, p) @ T
        assert center_of_mass_jacobian(model, q) == pytest.approx(J, abs=1e-12)


def test_robots_without_joints_have_the_columns_of_their_base():
    box = Link("box", 1.0, (0.0, 0.0, 0.1), (1.0, 0.0, 0.0, 1.0, 0.0, 1.0))
    free, frame = Model("box", (box,), (), "floating"), Link("frame", 0.0, (0.0, 0.0, 0.0), (0.0,) * 6)
    J = jacobian(free, [1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0], "box", (0.5, 0.0, 0.0))
    still, turn = np.zeros((3, 3)), np.eye(3)
    assert np.array_equal(J[:, :3], np.vstack([still, turn]))
    assert np.array_equal(J[:, 3:], np.vstack([turn, [[0, 0, 0], [0, 0, 0.5], [0, -0.5, 0]]]))
    assert center_of_mass_jacobian(Model("frame", (frame,), ()), []).shape == (3, 0)


def test_bad_input_is_refused_by_name():
    model = ROBOTS["humanoid"]
    q = random_states(model, 1, 12)[0][0]
    with pytest.raises(ValueError, match=r"no link 'tail'; its links are"):
        jacobian(model, q, "tail")
    with pytest.raises(ValueError, match=r"no frame 'local'; expected 'world', 'body'"):
        jacobian(model, q, "left_foot", frame="local")
    with pytest.raises(ValueError, match=r"point must be 3 finite numbers; .*\[m\]"):
        jacobian(model, q, "left_foot", (1, 2))
    with pytest.raises(ValueError, match=r"q has shape \(3,\)"):
        jacobian(model, q[:3], "left_foot")
