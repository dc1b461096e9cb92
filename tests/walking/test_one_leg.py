"""Torques of the joints of a leg on which a robot stands alone, and the servos that are strong enough for them."""

from dataclasses import replace

import numpy as np
import pytest

from featherstone_gait import load_robot
from featherstone_gait.robot_file.servos import load_servo, servo_names
from featherstone_gait.walking import walking_plan
from featherstone_gait.walking.kinematics import link_centers, link_poses
from featherstone_gait.walking.one_leg import check_strength, one_leg_torques

TOO_WEAK = {"xl320", "xl330"}  # no plan walks with them


@pytest.fixture(scope="module")
def robot():
    return load_robot("humanoid", locked="simplified")


@pytest.fixture(scope="module")
def plan(robot):
    return walking_plan(robot)


def test_at_rest_a_joint_bears_the_weight_of_all_above_it(robot, plan):
    """Its moment about the joint's axis, by the masses and places of the links that the leg carries."""
    posture, n = plan.angles[len(plan.angles) // 2], 7
    still = replace(
        plan, times=0.01 * np.arange(n), angles=np.tile(posture, (n, 1)), base_position=np.zeros((n, 3)),
        contact=np.tile([True, False], (n, 1)),
    )  # fmt: skip
    poses = link_poses(robot, posture[None])
    places, found = link_centers(robot, poses)[0], dict(zip(robot.joint_names, one_leg_torques(robot, still)))
    for name in ("left_hip_lateral", "left_knee", "left_ankle_front"):
        joint = next(one for one in robot.joints if one.name == name)
        carried = {joint.child}
        for one in robot.joints:
            if one.parent in carried:
                carried.add(one.child)
        at = poses.position[0, robot.link_index(joint.child)]
        axis = poses.rotation[0, robot.link_index(joint.child)] @ np.array(joint.axis)
        weight = sum(
            link.mass * np.cross(places[k] - at, [0.0, 0.0, -9.81])
            for k, link in enumerate(robot.links)
            if link.name not in carried
        )
        assert found[name] == pytest.approx(abs(axis @ weight), rel=1e-9)


@pytest.mark.parametrize("name", servo_names())
def test_servos_that_no_plan_walks_with_are_too_weak_to_stand_on_one_leg(name, robot, plan):
    model = replace(robot, servos=dict.fromkeys(robot.servos, load_servo(name)))
    if name not in TOO_WEAK:
        check_strength(model, plan)
        return
    with pytest.raises(ValueError, match=r"hip_lateral bears 0\.60 N m.* xc330"):
        check_strength(model, plan)
