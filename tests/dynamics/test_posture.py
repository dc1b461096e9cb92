"""Postures: closed forms, what another program says of the answer, and what is said where there is none."""

import math
from dataclasses import replace

import numpy as np
import published
import pytest
from pinocchio_oracle import coordinates, pinocchio_model
from random_tree import random_states, random_tree

from featherstone_gait import Target, inverse_kinematics, load_robot
from featherstone_gait.base.rotation import rotation_from_rpy
from featherstone_gait.dynamics import center_of_mass, forward_kinematics
from featherstone_gait.dynamics.jacobians import link_index
from featherstone_gait.model import Joint, Link, Mimic, Model

INERTIA = (0.01, 0.0, 0.0, 0.01, 0.0, 0.01)
UPPER, LOWER = 0.5, 0.3  # [m]
HAND = (LOWER, 0.0, 0.0)


def planar_arm(**elbow):
    """Two links in the plane z = 0."""
    links = tuple(Link(name, 1.0, (0.1, 0.0, 0.0), INERTIA) for name in ("base", "upper", "lower"))
    z = (0.0, 0.0, 1.0)
    shoulder = Joint("shoulder", "continuous", "base", "upper", axis=z)
    joint = Joint("elbow", "revolute" if elbow else "continuous", "upper", "lower", (UPPER, 0.0, 0.0), axis=z, **elbow)
    return Model("planar", links, (shoulder, joint))


def pose(model, q, link, point=(0.0, 0.0, 0.0)):
    poses, row = forward_kinematics(model, q), link_index(model, link)
    return poses.position[row] + poses.rotation[row] @ point, poses.rotation[row]


def wrapped(angles):
    return (np.asarray(angles) + math.pi) % (2 * math.pi) - math.pi


@pytest.mark.nojit
@pytest.mark.parametrize("bend", [-1, 1])
@pytest.mark.parametrize(("x", "y"), [(0.6, 0.2), (-0.3, 0.4), (0.0, -0.7), (0.25, 0.0)])
def test_an_arm_of_two_links_has_the_textbook_angles(x, y, bend):
    elbow = bend * math.acos((x * x + y * y - UPPER**2 - LOWER**2) / (2 * UPPER * LOWER))
    shoulder = math.atan2(y, x) - math.atan2(LOWER * math.sin(elbow), UPPER + LOWER * math.cos(elbow))
    found = inverse_kinematics(
        planar_arm(), Target("lower", (x, y, 0.0), point=HAND), [shoulder + 0.3, elbow - 0.2 * bend]
    )
    assert found.status == "ok"
    assert wrapped(found.q - [shoulder, elbow]) == pytest.approx([0.0, 0.0], abs=1e-8)


def test_an_arm_that_does_not_reach_points_at_its_target_stretched():
    found = inverse_kinematics(planar_arm(), Target("lower", (0.9, 1.2, 0.0), point=HAND), [0.1, 0.4])
    assert found.status == "out of reach"
    assert found.error == pytest.approx(1.5 - UPPER - LOWER, rel=1e-9)
    assert wrapped(found.q) == pytest.approx([math.atan2(1.2, 0.9), 0.0], abs=1e-5)


def test_a_joint_at_its_limit_is_said_to_be_in_the_way():
    arm = planar_arm(lower=-0.5, upper=0.5)
    found = inverse_kinematics(arm, Target("lower", (0.1, 0.4, 0.0), point=HAND), [0.3, 0.2])
    assert found.status == "limits"
    assert abs(found.q[1]) == 0.5
    short = math.sqrt(UPPER**2 + LOWER**2 + 2 * UPPER * LOWER * math.cos(0.5))  # of the arm bent that far
    assert found.error == pytest.approx(short - math.hypot(0.1, 0.4), rel=1e-9)


def test_a_stretched_arm_finds_the_way_inwards():
    found = inverse_kinematics(planar_arm(), Target("lower", (0.5, 0.0, 0.0), point=HAND), [0.0, 0.0])
    assert found.status == "ok"


def test_too_few_iterations_do_not_converge():
    found = inverse_kinematics(
        planar_arm(), Target("lower", (0.1, 0.4, 0.0), point=HAND), [0.3, 0.2], max_iterations=2
    )
    assert (found.status, found.iterations) == ("not converged", 2)


def test_targets_that_disagree_are_missed_by_the_least_squares():
    links = tuple(Link(name, 1.0, (0.0, 0.0, 0.0), INERTIA) for name in ("rail", "slide"))
    model = Model("slider", links, (Joint("x", "prismatic", "rail", "slide"),))
    targets = [Target("slide", (1.0, 0.0, 0.0), weight=3.0), Target("slide", (2.0, 0.0, 0.0), weight=1.0)]
    found = inverse_kinematics(model, targets)
    assert found.status == "out of reach"
    assert found.q == pytest.approx([(9 * 1.0 + 1 * 2.0) / 10], abs=1e-5)


@pytest.mark.parametrize("base", ["fixed", "floating"])
def test_random_trees_meet_poses_that_they_can_have(base):
    for seed in range(10):
        model = random_tree(8, seed, branching=1.0, base=base)
        (q, start), link = random_states(model, 2, seed)[0], model.links[-1].name
        position, rotation = pose(model, q, link, (0.01, 0.02, 0.03))
        target = Target(link, position, rotation, (0.01, 0.02, 0.03))
        found = inverse_kinematics(model, target, start, restarts=20)
        assert found.status == "ok"
        reached, turned = pose(model, found.q, link, (0.01, 0.02, 0.03))
        assert reached == pytest.approx(position, abs=2e-9)
        assert turned == pytest.approx(rotation, abs=2e-9)


@pytest.fixture
def standing():
    model = load_robot("humanoid")
    q = np.zeros(model.nq)
    q[2:4] = 0.3, 1.0
    feet = [Target(foot, *pose(model, q, foot)) for foot in ("left_foot", "right_foot")]
    return model, q, feet


def test_a_humanoid_crouches_over_its_feet(standing):
    model, q, feet = standing
    center = center_of_mass(model, q) + np.array([0.01, 0.005, -0.03])
    hand = Target("left_forearm", orientation_weight=0.0, position=pose(model, q, "left_forearm")[0] + (0.02, 0.0, 0.0))
    found = inverse_kinematics(model, [*feet, Target(None, center), hand], q)
    assert found.status == "ok"
    assert center_of_mass(model, found.q) == pytest.approx(center, abs=2e-9)
    assert pose(model, found.q, "left_forearm")[0] == pytest.approx(hand.position, abs=2e-9)
    for foot in feet:
        position, rotation = pose(model, found.q, foot.link)
        assert position == pytest.approx(foot.position, abs=2e-9)
        assert rotation == pytest.approx(foot.rotation, abs=2e-9)
    lower, upper = np.array([(j.lower, j.upper) for j in model.moving_joints]).T
    assert (found.q[7:] >= lower).all()
    assert (found.q[7:] <= upper).all()
    assert np.linalg.norm(found.q[3:7]) == pytest.approx(1.0, abs=1e-15)


def test_what_is_held_keeps_its_bits(standing):
    model, q, _ = standing
    leg = [name for name in model.joint_names if name.startswith("left_hip") or "left_knee" in name]
    foot = Target("left_foot", pose(model, q, "left_foot")[0] + (0.01, 0.0, 0.02))
    found = inverse_kinematics(model, foot, q, hold_base=True, joints=leg, restarts=5)
    assert found.status == "ok"
    moved = [name for name, before, after in zip(model.joint_names, q[7:], found.q[7:]) if before != after]
    assert np.array_equal(found.q[:7], q[:7])
    assert moved
    assert set(moved) <= set(leg)


def test_a_weight_of_zero_leaves_an_axis_free(standing):
    """A sole of which only the tilt is asked for: what turns it about the vertical stays as it falls."""
    model, q, _ = standing
    R = rotation_from_rpy((0.1, -0.05, 0.0))
    target = Target("left_foot", rotation=R, orientation_weight=(1.0, 1.0, 0.0))
    found = inverse_kinematics(model, target, q, hold_base=True)
    turned = pose(model, found.q, "left_foot")[1]
    assert found.status == "ok"
    assert turned[2] == pytest.approx(R[2], abs=2e-9)  # the vertical, as the sole sees it


def test_roll_pitch_and_yaw_are_a_rotation():
    model = random_tree(7, 5, branching=1.0, base="floating")
    rpy = (0.3, -0.4, 3.0)
    found = inverse_kinematics(model, Target("body7", rotation=rpy))
    assert found.status == "ok"
    assert pose(model, found.q, "body7")[1] == pytest.approx(rotation_from_rpy(rpy), abs=2e-9)


@pytest.mark.parametrize("angle", [math.pi, math.pi - 1e-7, 3.0])
def test_a_half_turn_is_found(angle):
    links = tuple(Link(name, 1.0, (0.0, 0.0, 0.0), INERTIA) for name in ("base", "wheel"))
    model = Model("wheel", links, (Joint("axle", "continuous", "base", "wheel", axis=(0.0, 1.0, 0.0)),))
    found = inverse_kinematics(model, Target("wheel", rotation=(0.0, angle, 0.0)))
    assert found.status == "ok"
    assert np.cos(found.q[0] - angle) == pytest.approx(1.0, abs=1e-15)


def coupled_arm(multiplier, offset, leader="joint2", **limits):
    """A chain of five joints: the fourth follows the second, the fifth the leader with -0.5 times its angle + 0.1."""
    model = random_tree(5, 6, branching=1.0, prismatic=0.0)
    joints = list(model.joints)
    joints[3] = replace(joints[3], mimic=Mimic("joint2", multiplier, offset))
    joints[4] = replace(joints[4], type="revolute", mimic=Mimic(leader, -0.5, 0.1), **limits)
    return replace(model, joints=tuple(joints))


def follow(model, q, leader=1):
    """Positions of such an arm with its followers where they belong."""
    q = np.array(q)
    q[3] = model.joints[3].mimic.multiplier * q[1] + model.joints[3].mimic.offset
    q[4] = -0.5 * q[leader] + 0.1
    return q


@pytest.mark.parametrize(("leader", "column"), [("joint2", 1), ("joint4", 3)], ids=["one leader", "a chain"])
def test_coupled_joints_follow_exactly(leader, column):
    model, rng = coupled_arm(1.5, 0.2, leader), np.random.default_rng(1)
    for _ in range(5):
        q = follow(model, rng.uniform(-1.0, 1.0, 5), column)
        position, _ = pose(model, q, "body5")
        found = inverse_kinematics(model, Target("body5", position), q + rng.uniform(-0.2, 0.2, 5))
        assert found.status == "ok"
        assert found.q[3] == 1.5 * found.q[1] + 0.2
        assert found.q[4] == pytest.approx(-0.5 * found.q[column] + 0.1, abs=1e-15)


def test_the_limits_of_a_follower_bind_its_leader():
    free, bound = coupled_arm(1.0, 0.0), coupled_arm(1.0, 0.0, lower=0.05, upper=0.3)
    position, _ = pose(free, follow(free, [0.2, 0.6, -0.3, 0.0, 0.0]), "body5")
    found = inverse_kinematics(bound, Target("body5", position), follow(bound, [0.2, 0.0, -0.3, 0.0, 0.0]))
    assert found.status == "limits"
    assert 0.05 - 1e-15 <= found.q[4] <= 0.3 + 1e-15
    apart = list(bound.joints)
    apart[3] = replace(apart[3], type="revolute", lower=2.0, upper=3.0)
    with pytest.raises(ValueError, match="'joint2' has no position at which all that follow it are within"):
        inverse_kinematics(replace(bound, joints=tuple(apart)), Target("body5", position))


def test_what_follows_a_locked_joint_stands_still():
    free = coupled_arm(2.0, 0.1)
    model = replace(free, locked={"joint2": 0.3})
    found = inverse_kinematics(model, Target("body5", (0.1, 0.1, 0.1)))
    first, third = (found.q[model.joint_names.index(name)] for name in ("joint1", "joint3"))
    expected = pose(free, follow(free, [first, 0.3, third, 0.0, 0.0]), "body5")
    assert pose(model, found.q, "body5")[0] == pytest.approx(expected[0], abs=1e-14)
    assert pose(model, found.q, "body5")[1] == pytest.approx(expected[1], abs=1e-14)


def test_restarts_repeat_to_the_bit():
    model = random_tree(7, 4, branching=1.0)
    target = Target("body7", *pose(model, random_states(model, 1, 2)[0][0], "body7"))
    assert inverse_kinematics(model, target).status != "ok"
    first, again, other = (inverse_kinematics(model, target, restarts=30, seed=seed) for seed in (1, 1, 2))
    assert first.status == again.status == other.status == "ok"
    assert np.array_equal(first.q, again.q)
    assert not np.array_equal(first.q, other.q)


def agrees_with_pinocchio(model, q, targets):
    """Whether Pinocchio's forward kinematics puts the links' origins where they shall be."""
    import pinocchio as pin

    theirs, frames = pinocchio_model(model)
    data = theirs.createData()
    pin.framesForwardKinematics(theirs, data, coordinates(theirs, model, q)[0])
    for target in targets:
        place = data.oMf[frames[target.link]]
        assert place.translation == pytest.approx(target.position, abs=2e-9)
        assert place.rotation == pytest.approx(target.rotation, abs=2e-9)


def test_pinocchio_puts_the_feet_where_they_were_sent(standing):
    pytest.importorskip("pinocchio")
    model, q, feet = standing
    found = inverse_kinematics(model, [*feet, Target(None, center_of_mass(model, q) - (0.0, 0.0, 0.02))], q)
    assert found.status == "ok"
    agrees_with_pinocchio(model, found.q, feet)


def example(file):
    """A file of the package example-robot-data."""
    return published.folder("example-robot-data") / file


ROBOTS = {  # of example-robot-data: file, base, links that are sent somewhere
    "ur5": ("ur_description/urdf/ur5_robot.urdf", "fixed", ["tool0"]),
    "xarm7": ("xarm_description/urdf/xarm7.urdf", "fixed", ["link_eef"]),
    "kinova": ("kinova_description/robots/kinova.urdf", "fixed", ["j2s6s200_end_effector"]),
    "a1": ("a1_description/urdf/a1.urdf", "floating", ["FL_foot", "RR_foot"]),
    "g1": ("g1_description/urdf/g1_29dof_with_hand_rev_1_0.urdf", "floating", ["left_ankle_roll_link", "torso_link"]),
}


@pytest.mark.parametrize("robot", ROBOTS)
def test_robots_of_others_meet_poses_that_they_can_have(robot):
    pytest.importorskip("pinocchio")
    file, base, links = ROBOTS[robot]
    model, rng = load_robot(example(file), base), np.random.default_rng(2)
    lower, upper = np.array([(max(j.lower, -3.0), min(j.upper, 3.0)) for j in model.moving_joints]).T
    q = np.concatenate([[0.0, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0][: model.nq - len(lower)], rng.uniform(lower, upper)])
    targets = [Target(link, *pose(model, q, link)) for link in links]
    found = inverse_kinematics(model, targets, restarts=50)
    assert found.status == "ok"
    agrees_with_pinocchio(model, found.q, targets)


def test_bad_input_is_refused_by_name():
    model = load_robot("humanoid")
    there = Target("left_foot", (0.0, 0.0, 0.0))
    for arguments, says in (
        (dict(targets=[]), r"there is no target; give at least one"),
        (dict(targets=["left_foot"]), r"targets holds 'left_foot'; give Target\(link, position\) or a list of them"),
        (dict(targets=Target("tail", (0.0, 0.0, 0.0))), r"no link 'tail'; its links are"),
        (dict(targets=Target("left_foot")), r"link 'left_foot' has no position and no rotation; give one"),
        (dict(targets=Target(None)), r"center of mass has no position; give one"),
        (dict(targets=Target(None, (0, 0, 0), (0, 0, 0))), r"center of mass has a rotation, which a point has not"),
        (dict(targets=Target("left_foot", (0.0, math.nan, 0.0))), r"position must be 3 finite numbers.*nan"),
        (dict(targets=Target("left_foot", rotation=np.ones((3, 3)))), r"orthogonal and of determinant 1, or "),
        (dict(targets=Target("left_foot", rotation=np.diag([1.0, 1.0, -1.0]))), r"of determinant 1"),
        (dict(targets=Target("left_foot", (0, 0, 0), weight=-1.0)), r"weight is -1.0; give one number >= 0, or three"),
        (dict(targets=Target("left_foot", (0, 0, 0), weight=0)), r"'left_foot' has no weight above 0; leave"),
        (dict(targets=there, joints=["tail"]), r"joints: 'tail' is no moving joint of humanoid; they are"),
        (dict(targets=there, joints=[], hold_base=True), r"nothing may move; name joints"),
        (dict(targets=there, q0=[0.0]), r"q0 has the shape \(1,\).*of shape \(26\)"),
        (dict(targets=there, tolerance=0.0), r"tolerance is 0.0; expected a number"),
    ):
        with pytest.raises(ValueError, match=says):
            inverse_kinematics(model, **arguments)
