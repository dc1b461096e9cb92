"""Forward and inverse kinematics: the foot goes where it is sent, or the error says what is in the way."""

from dataclasses import replace

import numpy as np
import pytest
from biped import biped

from featherstone_gait.base.rotation import rotation_from_rpy
from featherstone_gait.model import Joint, Link, Model
from featherstone_gait.walking.inverse_kinematics import leg_joints, mid_range, solve_leg
from featherstone_gait.walking.kinematics import center_of_mass, joint_axes, link_index, link_poses

FOOT = "left_ankle_lateral_link"


def foot_pose(model, angles, point=(0.0, 0.0, 0.0)):
    poses, i = link_poses(model, angles), link_index(model, FOOT)
    return poses.position[:, i] + poses.rotation[:, i] @ np.array(point), poses.rotation[:, i]


def bent_legs(model, n, seed):
    """Postures in the middle three quarters of the joint ranges, knees bent forward."""
    rng = np.random.default_rng(seed)
    lower, upper = np.array([(j.lower, j.upper) for j in model.moving_joints]).T
    angles = 0.4 * (rng.random((n, len(lower))) - 0.5) * (upper - lower) + mid_range(model)
    for side in ("left", "right"):
        angles[:, model.joint_names.index(f"{side}_knee")] = -rng.uniform(0.3, 1.5, n)
    return angles


def test_planar_arm_has_the_textbook_forward_kinematics():
    links = (
        Link("base", 1.0, (0, 0, 0), (1, 0, 0, 1, 0, 1)),
        *(Link(n, 1.0, (0.5, 0, 0), (1, 0, 0, 1, 0, 1)) for n in "ab"),
    )
    joints = (
        Joint("first", "revolute", "base", "a", axis=(0, 0, 1)),
        Joint("second", "revolute", "a", "b", xyz=(1, 0, 0), axis=(0, 0, 1)),
    )
    model = Model("arm", links, joints)
    q1, q2 = 0.3, 0.8
    poses = link_poses(model, [[q1, q2]])
    assert poses.position[0, 2] == pytest.approx([np.cos(q1), np.sin(q1), 0.0])
    expected = [
        (1.5 * np.cos(q1) + 0.5 * np.cos(q1 + q2)) / 3,
        (1.5 * np.sin(q1) + 0.5 * np.sin(q1 + q2)) / 3,
        0.0,
    ]
    assert center_of_mass(model, [[q1, q2]])[0] == pytest.approx(expected)


def test_rpy_turns_about_fixed_axes_in_order():
    x, y, z = np.eye(3)
    quarter = np.pi / 2
    assert rotation_from_rpy((quarter, 0, 0)) @ y == pytest.approx(z, abs=1e-15)
    assert rotation_from_rpy((quarter, 0, quarter)) @ y == pytest.approx(z, abs=1e-15)
    assert rotation_from_rpy((0, quarter, quarter)) @ x == pytest.approx(-z, abs=1e-15)


def test_locked_joints_stay_where_they_are_held():
    model = replace(biped(), locked={"left_hip_rotation": 0.2, "right_hip_rotation": 0.0})
    free = biped(hip_rotation_locked=False)
    angles = np.zeros((1, 12))
    angles[0, free.joint_names.index("left_hip_rotation")] = 0.2
    assert np.array_equal(link_poses(model, np.zeros((1, 10))).position, link_poses(free, angles).position)


def test_a_link_turns_about_the_axis_of_its_joint():
    model, d = biped(hip_rotation_locked=False), 1e-6
    angles = bent_legs(model, 1, 5)
    poses = link_poses(model, angles)
    axes = joint_axes(model, poses)[0]
    for k, joint in enumerate(model.moving_joints):
        i = link_index(model, joint.child)
        turned = link_poses(model, angles + d * np.eye(12)[k]).rotation[0, i]
        spin = (turned - poses.rotation[0, i]) @ poses.rotation[0, i].T / d
        assert [spin[2, 1], spin[0, 2], spin[1, 0]] == pytest.approx(axes[k], abs=1e-6)


def test_leg_joints_run_from_the_root_outwards_and_leave_out_the_locked():
    names = [biped().joint_names[c] for c in leg_joints(biped(), FOOT)]
    assert names == ["left_hip_lateral", "left_hip_front", "left_knee", "left_ankle_front", "left_ankle_lateral"]


def test_a_leg_of_five_joints_puts_the_level_sole_where_it_is_sent():
    model = biped()
    rng = np.random.default_rng(1)
    home, level = foot_pose(model, np.zeros((1, 10)), (0.0, 0.01, -0.05))
    target = home + rng.uniform((-0.03, -0.02, 0.01), (0.03, 0.02, 0.05), (200, 3))
    angles = solve_leg(model, FOOT, target, point=(0.0, 0.01, -0.05))
    reached, rotation = foot_pose(model, angles, (0.0, 0.01, -0.05))
    assert np.abs(reached - target).max() < 1e-11
    assert np.abs(rotation @ (0, 0, 1) - level @ (0, 0, 1)).max() < 1e-11
    assert (angles[:, model.joint_names.index("left_knee")] < 0.0).all()


def test_a_leg_of_six_joints_meets_any_pose_it_can_have():
    model = biped(hip_rotation_locked=False)
    wanted = bent_legs(model, 50, 2)
    target, rotation = foot_pose(model, wanted)
    for k in range(len(wanted)):
        angles = solve_leg(model, FOOT, target[k], rotation=rotation[k], start=wanted[k] + 0.05)
        reached, turned = foot_pose(model, angles)
        assert np.abs(reached - target[k]).max() < 1e-11
        assert np.abs(turned - rotation[k]).max() < 1e-10


def test_joints_outside_the_leg_keep_the_start_and_the_result_repeats_to_the_bit():
    model = biped()
    start = bent_legs(model, 1, 3)[0]
    target = foot_pose(model, np.zeros((1, 10)))[0] + (0.0, 0.0, 0.02)
    angles = solve_leg(model, FOOT, target, start=start)
    right = [i for i, name in enumerate(model.joint_names) if name.startswith("right")]
    assert np.array_equal(angles[0, right], start[right])
    assert np.array_equal(angles, solve_leg(model, FOOT, target, start=start))


def test_a_target_out_of_reach_is_named_with_its_time():
    model = biped()
    home = foot_pose(model, np.zeros((1, 10)))[0]
    target = home + np.array([[0.0, 0.0, 0.02], [0.0, 0.0, -0.1]])
    with pytest.raises(ValueError, match=r"'left_ankle_lateral_link'.*cannot reach.*at t = 0\.700 s.*misses by"):
        solve_leg(model, FOOT, target, times=[0.5, 0.7])


def test_a_joint_limit_is_named_with_joint_angle_limit_and_time():
    model = biped()
    target = foot_pose(model, np.zeros((1, 10)))[0] + (0.0, 0.0, 0.095)
    with pytest.raises(
        ValueError, match=r"joint 'left_knee' needs -\d+\.\d+ deg at t = 0\.250 s.*-98\.00\.\.32\.00 deg"
    ):
        solve_leg(model, FOOT, target, times=[0.25])


def test_what_is_no_leg_is_refused():
    with pytest.raises(ValueError, match="no link 'tail'"):
        leg_joints(biped(), "tail")
    with pytest.raises(ValueError, match="no moving joint"):
        leg_joints(biped(), "trunk")
    with pytest.raises(ValueError, match=r"must be \(n, 10\)"):
        link_poses(biped(), np.zeros((3, 9)))
