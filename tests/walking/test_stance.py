"""Bipeds of other making: soles, legs and size come from the keyframe in which the robot stands."""

from dataclasses import replace

import numpy as np
import pytest
from biped import biped

from featherstone_gait.model import Joint, Link
from featherstone_gait.walking.gait import mirror_of
from featherstone_gait.walking.kinematics import center_of_mass, link_index, link_poses
from featherstone_gait.walking.plan import walking_plan
from featherstone_gait.walking.stance import size_of, soles_of, standing

WALK = {"com_height": 0.212, "half_width": 0.042, "step_length": 0.02, "lift": 0.015, "T": 0.02, "N": 60, "n_steps": 12}


def crouching(model, pitch=0.0, yaw=0.0, **more):
    """Return the model with a keyframe "stand" whose soles are level, with its trunk turned by pitch and yaw [rad]."""
    angles = dict.fromkeys(model.joint_names, 0.0)
    for name in angles:
        _, _, part = name.partition("_")
        angles[name] = {"hip_front": -0.4 - pitch, "knee": -0.8, "ankle_front": 0.4}.get(part, 0.0) + more.get(
            name, 0.0
        )
    half = np.array([pitch, yaw]) / 2.0
    (sp, sy), (cp, cy) = np.sin(half), np.cos(half)
    q = (0.0, 0.0, 0.25, cy * cp, -sy * sp, cy * sp, sy * cp, *angles.values())
    return replace(model, keyframes={"stand": q})


def without_limits(model):
    return replace(model, joints=[replace(joint, lower=-np.inf, upper=np.inf) for joint in model.joints])


@pytest.mark.parametrize(
    ("pitch", "yaw", "roll"), [(0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.1, 2.0, 0.0), (0.0, 1.0, 0.05)]
)
def test_soles_lie_level_as_the_robot_stands_however_its_trunk_is_turned(pitch, yaw, roll):
    robot = crouching(biped(), pitch, yaw, left_ankle_lateral=roll, right_ankle_lateral=roll)
    for sole, flat in zip(soles_of(robot), soles_of(biped())):
        assert (sole.link, sole.joints) == (flat.link, flat.joints)
        np.testing.assert_allclose(sole.middle, flat.middle, atol=1e-9)
        np.testing.assert_allclose(sole.corners, flat.corners, atol=2e-3 * (roll != 0.0) + 1e-9)
        np.testing.assert_allclose(sole.rotation[2], flat.rotation[2], atol=1e-9)


def test_a_robot_is_as_high_as_on_straight_legs_and_as_wide_as_it_stands():
    robot, free = crouching(biped()), crouching(without_limits(biped()))
    for each in (robot, free):
        size, (angles, _) = size_of(each, soles_of(each)), standing(each)
        poses = link_poses(each, angles)
        height = center_of_mass(each, angles)[0, 2] - poses.position[0, link_index(each, "left_ankle_front_link"), 2]
        assert size.height > height + 0.04
        assert size.half_width == pytest.approx(size_of(biped(), soles_of(biped())).half_width, abs=1e-5)
        straight = size_of(biped(), soles_of(biped()))
        assert size.height == pytest.approx(straight.height, rel=0.02)
        assert size.leg == pytest.approx(straight.leg, rel=0.06)


def test_knees_without_limits_bend_as_in_the_keyframe():
    robot = crouching(without_limits(biped()))
    plan = walking_plan(robot, followed=1e-5, **WALK)
    knees = plan.angles[:, [robot.joint_names.index(f"{side}_knee") for side in ("left", "right")]]
    assert (knees < 0.0).all()
    assert plan.margin().min() > 0.0
    with pytest.raises(ValueError, match=r"cannot reach|outside its limits"):
        walking_plan(without_limits(biped()), followed=1e-5, **WALK)


def test_a_joint_that_moves_both_feet_stays_as_in_the_keyframe():
    robot = biped()
    moved = [replace(joint, parent="pelvis") if joint.parent == "trunk" else joint for joint in robot.joints]
    waist = Joint("waist", "revolute", "trunk", "pelvis", axis=(0.0, 0.0, 1.0), lower=-1.0, upper=1.0)
    pelvis = Link("pelvis", 0.1, (0.0, 0.0, 0.0), (1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4))
    robot = crouching(replace(robot, links=(robot.links[0], pelvis, *robot.links[1:]), joints=(waist, *moved)))
    waist = robot.joint_names.index("waist")
    assert not any(waist in sole.joints for sole in soles_of(robot))
    plan = walking_plan(robot, followed=1e-5, **WALK)
    assert (plan.angles[:, waist] == 0.0).all()
    for k, sole in enumerate(soles_of(robot)):
        poses = link_poses(robot, plan.angles, plan.base_position)
        i = link_index(robot, sole.link)
        at = poses.position[:, i] + poses.rotation[:, i] @ sole.middle
        np.testing.assert_allclose(at, plan.feet[:, k], atol=1e-6)


def test_a_leg_that_turns_but_does_not_roll_its_ankle_keeps_pitch_and_heading_of_its_sole():
    locked = {"left_ankle_lateral": 0.0, "right_ankle_lateral": 0.0}
    robot = crouching(replace(biped(hip_rotation_locked=False), locked=locked))
    plan = walking_plan(robot, followed=1e-5, **WALK)
    for k, sole in enumerate(soles_of(robot)):
        poses = link_poses(robot, plan.angles, plan.base_position)
        i = link_index(robot, sole.link)
        at = poses.position[:, i] + poses.rotation[:, i] @ sole.middle
        np.testing.assert_allclose(at, plan.feet[:, k], atol=1e-6)
        ahead = poses.rotation[:, i] @ sole.rotation.T[:, 0]
        assert np.abs(ahead[:, 1:]).max() < 5e-3  # of pitch and yaw, on a sole that rolls
        assert np.abs(np.diff(poses.rotation[:, i, 2, 1])).max() > 0.0


@pytest.mark.parametrize("sides", [("l_", "r_"), ("Left_", "Right_"), ("LL_", "LR_"), ("L", "R")])
def test_joints_are_paired_whatever_the_sides_are_called(sides):
    names = dict(zip(("left_", "right_"), sides))

    def called(name):
        return next((name.replace(side, short) for side, short in names.items() if side in name), name)

    robot = biped(hip_rotation_locked=False)
    other = replace(robot, joints=[replace(joint, name=called(joint.name)) for joint in robot.joints])
    expected, found = mirror_of(robot), mirror_of(other)
    np.testing.assert_array_equal(found.index, expected.index)
    np.testing.assert_array_equal(found.sign, expected.sign)


def test_a_joint_without_a_mirror_image_is_named():
    robot = biped()
    moved = [replace(joint, name="knee") if joint.name == "left_knee" else joint for joint in robot.joints]
    longer = [replace(joint, xyz=(0.02, *joint.xyz[1:])) if joint.name == "knee" else joint for joint in moved]
    with pytest.raises(ValueError, match="knee"):
        mirror_of(replace(robot, joints=longer))
