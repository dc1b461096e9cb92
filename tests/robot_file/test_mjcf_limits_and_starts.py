"""Limits of actuators' forces and the start in MJCF are MuJoCo's; what is dropped of them is named."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from featherstone_gait import (
    Controller,
    RobotFileError,
    RobotFileWarning,
    Servo,
    compile_scene,
    forward_kinematics,
    initial_state,
    load_robot,
    load_scene,
    save_robot,
    save_scene,
)

BALL = '<geom size="0.1" mass="1"/>'
ARM = f'<body name="a"><joint name="j" {{}}/>{BALL}<body name="b" pos="0 0 1"><joint name="k"/>{BALL}</body></body>'
FIXED = '<tendon><fixed name="t" {}><joint joint="j" coef="{}"/>{}</fixed></tendon>'
BOTH = '<joint joint="k" coef="1"/>'
DC = 'motorconst="0.05 0.05" resistance="2" controller="0.02 0 0.004 0 0 6" gear="50" input="pos"'


def put(tmp_path, bodies, more=""):
    path = tmp_path / "file.xml"
    path.write_text(f"<mujoco><worldbody>{bodies}</worldbody>{more}</mujoco>")
    return path


def strongest(path):
    """The force [N m] that MuJoCo gives the first joint where the error of the position is large."""
    m = mujoco.MjModel.from_xml_path(str(path))
    d = mujoco.MjData(m)
    d.ctrl[:] = 1e3
    mujoco.mj_forward(m, d)
    return abs(d.qfrc_actuator[0])


def named(load, path, sentence):
    """Load a file whose warning says a sentence, and which strict=True refuses with it."""
    with pytest.raises(RobotFileError, match=sentence):
        load(path, strict=True)
    with pytest.warns(RobotFileWarning, match=sentence):
        return load(path)


@pytest.mark.filterwarnings("ignore:.*(u/gear|control is scaled):featherstone_gait.RobotFileWarning")
@pytest.mark.parametrize(
    ("limit", "tendon", "actuator"),
    [
        ('actuatorfrcrange="-5 5"', "", '<position joint="j" kp="500"/>'),
        ('actuatorfrcrange="-5 5"', "", '<position joint="j" kp="500" gear="-3"/>'),
        ('actuatorfrcrange="-5 5"', "", '<position joint="j" kp="500" gear="3" forcerange="-1 1"/>'),
        ('actuatorfrcrange="-5 5"', FIXED.format("", -2, ""), '<position tendon="t" kp="500" gear="3"/>'),
        ("", FIXED.format('actuatorfrcrange="-4 4"', -2, ""), '<position tendon="t" kp="500" gear="3"/>'),
        ('actuatorfrcrange="-9 9"', FIXED.format('actuatorfrcrange="-4 4"', 2, ""), '<position tendon="t" kp="500"/>'),
    ],
)
def test_the_force_of_a_servo_ends_where_mujoco_s_does(tmp_path, limit, tendon, actuator):
    path = put(tmp_path, ARM.format(limit), f"{tendon}<actuator>{actuator}</actuator>")
    assert load_robot(path).servos["j"].controller.torque_limit == pytest.approx(strongest(path), rel=1e-14)


def test_the_current_of_a_motor_ends_at_the_limit_of_its_joint(tmp_path):
    more = f'<actuator><dcmotor joint="j" {DC}/></actuator>'
    servo = load_robot(put(tmp_path, ARM.format('actuatorfrcrange="-2 2"'), more)).servos["j"]
    assert servo.gearbox.ratio * servo.motor_constant * servo.current_limit == pytest.approx(2.0, rel=1e-14)


def test_the_force_of_a_tendon_s_drive_ends_where_mujoco_s_does(tmp_path):
    more = FIXED.format('actuatorfrcrange="-4 4"', 1, BOTH) + '<actuator><position tendon="t" kp="500"/></actuator>'
    path = put(tmp_path, ARM.format(""), more)
    (tendon,) = load_robot(path, strict=True).tendons
    assert tendon.controller.torque_limit == strongest(path) == 4.0
    named(load_robot, put(tmp_path, ARM.format(""), more.replace("-4 4", "-3 4")), "larger end of forcerange")


def test_limits_of_joints_that_a_drive_of_a_tendon_does_not_have_are_named(tmp_path):
    more = FIXED.format("", 1, BOTH) + '<actuator><position tendon="t" kp="500"/></actuator>'
    path = put(tmp_path, ARM.format('actuatorfrcrange="-5 5"'), more)
    named(load_robot, path, "ignored actuatorfrcrange of joints 'j' for drives of tendons")


@pytest.mark.parametrize("limit", [2.0, 9.0])
def test_a_servo_stronger_than_its_effort_comes_back(tmp_path, limit):
    """MuJoCo limits it by the effort; this package does not, unless the file is another program's."""
    path = put(tmp_path, ARM.format('actuatorfrcrange="-5 5"'), '<actuator><position joint="j" kp="50"/></actuator>')
    servo = Servo(Controller("pd_clamped", 50.0, torque_limit=limit))
    save_robot(replace(load_robot(path), servos={"j": servo}), tmp_path / "saved.xml")
    assert load_robot(tmp_path / "saved.xml").servos == {"j": servo}
    assert strongest(tmp_path / "saved.xml") == min(limit, 5.0)


REFERRED = (
    '<body name="ball" pos=".4 0 .3"><joint name="x" type="slide" axis="1 0 0" ref=".4"/>'
    f'<joint name="y" axis="0 1 0" pos=".1 0 0" ref="30"/>{BALL}</body>'
)


@pytest.mark.parametrize("load", [load_robot, load_scene])
def test_a_run_begins_at_the_references_of_joints(tmp_path, load):
    path = put(tmp_path, REFERRED)
    read = load(path, strict=True)
    scene = compile_scene(read)
    m = mujoco.MjModel.from_xml_path(str(path))
    d = mujoco.MjData(m)
    mujoco.mj_forward(m, d)
    view = scene.state_view(initial_state(scene))
    np.testing.assert_array_equal(view.q, m.qpos0)
    robot = read if load is load_robot else read.members[0].model
    place = 0.0 if load is load_robot else np.array(read.members[0].position)
    np.testing.assert_allclose(forward_kinematics(robot, view.q).position[-1] + place, d.xpos[1], atol=1e-15)
    (save_robot if load is load_robot else save_scene)(read, tmp_path / "saved.xml")
    again = compile_scene(load(tmp_path / "saved.xml"))
    np.testing.assert_array_equal(again.state_view(initial_state(again)).q, m.qpos0)


@pytest.mark.parametrize("what", ["cutoff", "noise", "delay", "interval"])
def test_what_else_sensors_have_is_named(tmp_path, what):
    if what in ("delay", "interval") and not hasattr(mujoco.MjModel, f"sensor_{what}"):
        pytest.skip(f"MuJoCo {mujoco.__version__} has no {what} of sensors to read: version 4 has")
    more = f'<sensor><force name="f" site="s" nsample="2" {what}=".02"/><force name="g" site="s"/></sensor>'
    more = more if what in ("delay", "interval") else more.replace(' nsample="2"', "")
    body = '<body name="w"><joint/><geom size=".1"/><site name="s"/></body>'
    notes = load_robot(put(tmp_path, body, more)).notes
    assert [note.partition(":")[0] for note in notes if note.startswith("ignored")] == [
        f"ignored {what} of sensors 'f'"
    ]


def test_what_else_keyframes_have_is_named(tmp_path):
    hand = f'<body name="hand" mocap="true" pos="1 0 0"/>{ARM.format("")}'
    keys = (
        '<key name="still" qpos=".1 .2"/><key name="fast" qpos="0 0" qvel="3 0" ctrl=".4"/>'
        '<key name="away" mpos="2 0 0"/><key name="turned" mquat="0 1 0 0"/>'
    )
    more = f'<actuator><position joint="j" kp="1"/></actuator><keyframe>{keys}</keyframe>'
    notes = load_robot(put(tmp_path, hand, more)).notes
    assert [note.partition("of keyframes ")[2] for note in notes if "of keyframes" in note] == [
        "'fast', without their qvel, ctrl", "'away', without their mpos", "'turned', without their mquat",
    ]  # fmt: skip


def test_bodies_that_sleep_at_the_start_are_named(tmp_path):
    bodies = f'<body name="up" sleep="init" pos="0 0 1"><freejoint/>{BALL}</body>{ARM.format("")}'
    path = put(tmp_path, bodies, '<option><flag sleep="enable"/></option>')
    named(load_scene, path, "bodies 'up' sleep at the start")
    load_scene(put(tmp_path, bodies), strict=True)  # without the flag they do not sleep in MuJoCo


def test_what_rays_do_not_see_is_named(tmp_path):
    def scene(ghost):
        wall = f'<geom name="ghost" type="box" size=".1 1 1" pos="1 0 0" {ghost}/>'
        eye = f'<body name="a"><freejoint/>{BALL}<geom size=".2" contype="0" conaffinity="0"/><site name="s"/></body>'
        sensor = '<sensor><rangefinder name="r" site="s" cutoff="3"/></sensor>'
        return put(tmp_path, wall + eye, sensor)

    named(load_scene, scene('contype="0" conaffinity="0"'), "pass through geoms 'ghost', which touch nothing")
    for seen in ("", 'contype="0" conaffinity="0" rgba="0 0 0 0"'):  # rays of MuJoCo miss what is transparent
        notes = load_scene(scene(seen), strict=True).notes
        assert any("rangefinders 'r' read inf" in note for note in notes)
