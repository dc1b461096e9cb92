"""The default gearbox model is the one that the servos have numbers for."""

from dataclasses import replace

import pytest

from featherstone_gait import compile_scene, load_robot
from featherstone_gait.optimize import walking_cost
from featherstone_gait.robot_file.servos import servo_names, with_servo
from featherstone_gait.scene.actuator import servo_gearbox, usual_gearbox
from featherstone_gait.study.settings import scene_of
from featherstone_gait.walking.walker import load_walker


@pytest.mark.parametrize("servo", servo_names())
def test_mipsd_is_usual_where_it_can_be_compiled(servo):
    arm = with_servo(load_robot("ax12_arm"), servo)
    try:
        compile_scene(arm, "mipsd")
        known = "mipsd"
    except ValueError:
        known = "rotor"
    assert usual_gearbox(arm) == servo_gearbox(arm, None) == known
    assert compile_scene(arm, known).gearbox == known
    assert servo_gearbox(arm, "standard") == "standard"


def test_one_rigid_gear_among_elastic_ones_makes_all_rigid():
    arm = load_robot("arm7")
    joint = arm.joint_names[3]
    rigid = with_servo(arm, "xl430").servos[joint]
    assert (usual_gearbox(arm), usual_gearbox(replace(arm, servos={**arm.servos, joint: rigid}))) == ("mipsd", "rotor")


def test_a_robot_without_servos_has_none():
    bare = replace(load_robot("arm7"), servos={})
    assert usual_gearbox(bare) is None
    with pytest.raises(ValueError, match="has no servos"):
        servo_gearbox(bare, None)


@pytest.mark.quick("xm430-rotor")
@pytest.mark.parametrize(("servo", "kind"), [("ax12", "mipsd"), ("xm430", "rotor")])
def test_walks_and_studies_take_it(servo, kind):
    assert walking_cost(with_servo(load_walker("humanoid"), servo)).scene.gearbox == kind
    assert scene_of(load_robot("arm7"), {"servo.type": servo}).gearbox == kind
    assert scene_of(load_robot("arm7"), {"servo.type": servo, "scene.gearbox": "none"}).gearbox is None
