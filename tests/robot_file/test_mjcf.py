"""MJCF: what is read moves as in MuJoCo, what cannot be is refused, and what is written is the same robot."""

import itertools
import math
import re
import sys
import warnings
from dataclasses import replace

import mujoco
import numpy as np
import published
import pytest
from company import in_company, simulated
from random_tree import random_states, random_tree

from featherstone_gait import (
    ContactPoint,
    Controller,
    Gearbox,
    Ground,
    Joint,
    Link,
    Model,
    RobotFileError,
    RobotFileWarning,
    Servo,
    compile_scene,
    forward_dynamics,
    forward_kinematics,
    inverse_dynamics,
    load_robot,
    mass_matrix,
    save_robot,
    tendon_jacobian,
)
from featherstone_gait.base.rotation import rotation_about, rotation_from_rpy, rpy_from_rotation
from featherstone_gait.model import Mimic
from featherstone_gait.model.shapes import Box, Capsule, Cylinder, Hull, Sphere
from featherstone_gait.robot_file.mjcf.tree import names_of
from featherstone_gait.scene.actuator import build_drive

OFF, WRAP = mujoco.mjtDisableBit, mujoco.mjtWrap
PASSIVE = OFF.mjDSBL_CONTACT | OFF.mjDSBL_CONSTRAINT | OFF.mjDSBL_DAMPER | OFF.mjDSBL_ACTUATION
BALL = '<geom size="0.1" mass="1"/>'

ODD = """
<mujoco model="odd">
  <compiler angle="degree"/>
  <default><joint armature="0.02" damping="0.3"/><default class="weak"><joint frictionloss="0.1"/></default></default>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body name="trunk" pos="0.1 0.2 0.3" euler="20 30 -40">
      <freejoint/>
      <inertial pos="0.01 0.02 -0.03" mass="3" fullinertia="0.04 0.05 0.03 0.001 0.002 -0.003"/>
      <geom name="belly" type="capsule" fromto="0 0 0 0.2 0 0.1" size="0.04"/>
      <body name="hip" pos="0 0.1 -0.1" euler="0 90 10">
        <joint name="yaw" axis="0 0 1" pos="0.01 -0.02 0.03" ref="35" limited="true" range="-60 100"/>
        <joint name="slide" type="slide" axis="1 1 0" ref="0.05" class="weak" range="-0.1 0.2"/>
        <joint name="pitch" axis="0 1 1" pos="0 0.04 0.02" ref="-15"/>
        <geom name="block" type="box" size="0.1 0.05 0.02" pos="0.05 0 0" quat="1 0.2 0 0.1"/>
        <body name="shin" pos="0 0 -0.2"><geom name="rod" type="cylinder" size="0.02 0.1" mass="0.4"/>
          <body name="foot" pos="0 0.05 -0.1"><joint axis="1 0 0"/><geom size="0.03" mass="0.2"/></body>
        </body>
      </body>
    </body>
  </worldbody>
  <keyframe><key name="crouch" qpos="0 0 0.5 1 0 0 0 0.1 0.02 -0.3 0.4"/></keyframe>
</mujoco>
"""


@pytest.fixture
def write(tmp_path):
    """Write MJCF text to a file; the number keeps names apart."""
    count = itertools.count()

    def written(text):
        path = tmp_path / f"robot{next(count)}.xml"
        path.write_text(text)
        return path

    return written


def robot(bodies, more=""):
    return f"<mujoco><worldbody>{bodies}</worldbody>{more}</mujoco>"


def passive_model(path):
    """MuJoCo's model of a file, without contact, limits, friction, damping, fluid and actuators.

    The springs are those of hinges and slides.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of deprecated attributes
        m = mujoco.MjSpec.from_file(str(path)).compile()
    m.opt.disableflags = (m.opt.disableflags | PASSIVE) & ~int(OFF.mjDSBL_GRAVITY)
    m.opt.density = m.opt.viscosity = 0
    m.tendon_stiffness[wraps_around_geoms(m)] = 0.0
    m.jnt_stiffness[m.jnt_type == mujoco.mjtJoint.mjJNT_FREE] = 0.0
    m.opt.gravity[:] = (0, 0, -9.81)
    return m


def wraps_around_geoms(m):
    """Which tendons do; they are left out."""
    parts = [m.wrap_type[a : a + n] for a, n in zip(m.tendon_adr, m.tendon_num)]
    return np.array([np.isin(part, (WRAP.mjWRAP_SPHERE, WRAP.mjWRAP_CYLINDER)).any() for part in parts], dtype=bool)


def relative_error(model, m, seed=3, count=5):
    """Largest difference of accelerations by the largest acceleration, at random states."""
    d = mujoco.MjData(m)
    error = 0.0
    at_q, at_v = places(model, m)
    for q, qd, tau in zip(*random_states(model, count, seed)):
        d.qpos[at_q], d.qvel[at_v], d.qfrc_applied[at_v] = q, qd, tau
        mujoco.mj_forward(m, d)
        qdd = d.qacc[at_v]
        error = max(error, np.abs(forward_dynamics(model, q, qd, tau) - qdd).max() / np.abs(qdd).max())
    return error


def places(model, m):
    """Where the model's coordinates are in MuJoCo's qpos and qvel."""
    if model.nv == m.nv:
        return slice(None), slice(None)
    names = names_of(m, "joint", m.njnt)
    joints = [names.index(name) for name in model.joint_names]
    at_q, at_v = m.jnt_qposadr[joints].tolist(), m.jnt_dofadr[joints].tolist()
    if model.base == "floating":
        b = names_of(m, "body", m.nbody).index(model.root)
        first = m.body_jntadr[b]
        at_q = [*range(m.jnt_qposadr[first], m.jnt_qposadr[first] + 7), *at_q]
        at_v = [*range(m.jnt_dofadr[first], m.jnt_dofadr[first] + 6), *at_v]
    return at_q, at_v


# ------------------------------------------------------------------------------------------------ reading


def test_odd_joints_move_as_in_mujoco(write):
    path = write(ODD)
    model, m = load_robot(path), passive_model(path)
    assert model.base == "floating"
    assert relative_error(model, m) < 1e-12
    d = mujoco.MjData(m)
    names = [link.name for link in model.links]
    for q, qd, _ in zip(*random_states(model, 5, 1)):
        d.qpos[:], d.qvel[:] = q, qd
        mujoco.mj_kinematics(m, d)
        poses = forward_kinematics(model, q)
        for body in ("trunk", "hip", "shin", "foot"):
            k, b = names.index(body), m.body(body).id
            np.testing.assert_allclose(poses.position[k], d.xpos[b], atol=1e-14)
            np.testing.assert_allclose(poses.rotation[k].ravel(), d.xmat[b], atol=1e-14)


def test_defaults_angles_and_names_are_those_of_the_file(write):
    model = load_robot(write(ODD))
    yaw, slide, pitch, last = model.moving_joints
    assert (model.name, yaw.name, slide.name, pitch.name) == ("odd", "yaw", "slide", "pitch")
    assert (yaw.type, slide.type, pitch.type) == ("revolute", "prismatic", "continuous")
    assert yaw.lower == pytest.approx(math.radians(-60), rel=1e-15)
    assert [joint.armature for joint in model.moving_joints] == [0.02] * 4
    assert [joint.damping for joint in model.moving_joints] == [0.3] * 4
    assert (slide.friction, pitch.friction) == (0.1, 0.0)
    assert last.child == "foot"
    assert model.keyframes["crouch"] == (0, 0, 0.5, 1, 0, 0, 0, 0.1, 0.02, -0.3, 0.4)


def test_keyframes_follow_base_and_locked_joints(write):
    model = load_robot(write(ODD), base="fixed", locked=["slide"])
    assert model.keyframes["crouch"] == (0.1, -0.3, 0.4)


def test_geoms_become_shapes_where_they_are(write):
    path = write(ODD)
    model, m = load_robot(path), passive_model(path)
    d = mujoco.MjData(m)
    mujoco.mj_kinematics(m, d)
    q = d.qpos.copy()
    poses, names = forward_kinematics(model, q), [link.name for link in model.links]
    kinds = {shape.name: type(shape.geometry) for shape in model.shapes}
    assert kinds["belly"] is Capsule
    assert kinds["block"] is Box
    assert kinds["rod"] is Cylinder
    assert Sphere(0.03) in [shape.geometry for shape in model.shapes]
    for shape in model.shapes[:3]:
        k, g = names.index(shape.link), m.geom(shape.name).id
        R = poses.rotation[k] @ rotation_from_rpy(shape.rpy)
        np.testing.assert_allclose(R.ravel(), d.geom_xmat[g], atol=1e-14)
        place = poses.position[k] + poses.rotation[k] @ np.array(shape.xyz)
        np.testing.assert_allclose(place, d.geom_xpos[g], atol=1e-14)
    belly = next(shape.geometry for shape in model.shapes if shape.name == "belly")
    assert belly.length == pytest.approx(math.hypot(0.2, 0.1), rel=1e-14)


def test_a_mesh_becomes_its_hull_and_what_touches_no_floor_is_left_out(write):
    corners = list(itertools.product((0.0, 0.1), (0.0, 0.2), (0.0, 0.3)))
    vertices = " ".join(f"{x}" for point in [*corners, (0.05, 0.1, 0.15)] for x in point)
    asset = f'<asset><mesh name="brick" vertex="{vertices}"/></asset>'
    inside = '<geom type="mesh" mesh="brick"/><geom size="1" contype="0" conaffinity="0" mass="0"/>'
    model = load_robot(write(robot(f"<body><joint/>{inside}</body>", asset)))
    (shape,) = model.shapes
    assert isinstance(shape.geometry, Hull)
    R = rotation_from_rpy(shape.rpy)
    found = sorted(tuple(np.round(R @ p + shape.xyz, 6) + 0.0) for p in np.array(shape.geometry.points))
    np.testing.assert_allclose(found, sorted(corners), atol=1e-6)  # MuJoCo keeps single precision
    assert any("touch no floor" in note for note in model.notes)


def test_trees_that_the_world_carries_are_branches_of_one(write):
    forearm = f'<body pos="0 0 1"><joint/>{BALL}</body>'
    arm = f'<body name="a" pos="1 0 0"><joint name="x" axis="0 1 0"/>{BALL}{forearm}</body>'
    path = write(robot(arm + f'<body name="b"><joint type="slide"/>{BALL}</body>'))
    model = load_robot(path, strict=True)
    assert (model.base, model.root, model.nv) == ("fixed", "world", 3)
    assert relative_error(model, passive_model(path)) < 1e-12


def test_of_several_trees_the_one_with_most_joints_is_taken(write):
    """What hangs together moves as in the whole, for nothing ties it to the rest."""
    robots = {
        name: f'<body name="{name}" pos="{k} 0 2"><freejoint/>{BALL}{f"<body><joint/>{BALL}" * n}{"</body>" * (n + 1)}'
        for k, (name, n) in enumerate({"ball": 0, "legs": 2, "other": 2}.items())
    }
    key = '<keyframe><key name="up" qpos="{} 0.7 0.8"/></keyframe>'
    arm = f'<body name="arm"><joint/>{BALL}</body>'
    whole = "".join(robots.values()) + arm
    free = "0 0 3 1 0 0 0"
    path = write(robot(whole, key.format(f"{free} {free} 0.3 0.4 {free}").replace("0.7 0.8", "0.5 0.6 0.7")))
    with pytest.warns(RobotFileWarning, match="left out bodies 'ball', 'other', 'arm' .* here 'legs'"):
        model = load_robot(path)
    alone = load_robot(write(robot(robots["legs"])))
    assert (model.base, model.root, model.nq) == ("floating", "legs", 9)
    assert [replace(link, name="x") for link in model.links] == [replace(link, name="x") for link in alone.links]
    assert model.keyframes["up"] == (0, 0, 3, 1, 0, 0, 0, 0.3, 0.4)
    assert load_robot(path, base="fixed").nv == 5  # where they stand, all are branches of the world
    longer = arm.replace("</body>", f"<body><joint/>{BALL}<body><joint/>{BALL}</body></body></body>")
    with pytest.warns(RobotFileWarning, match="left out bodies 'ball', 'legs', 'other' .* here 'arm'"):
        assert load_robot(write(robot(whole.replace(arm, longer)))).nv == 3


def test_meshes_are_found_by_a_relative_path_too(write, tmp_path, monkeypatch):
    """An included file's own folder, then `<compiler meshdir="">`: from elsewhere MuJoCo looks in the wrong place."""
    folder = tmp_path / "robots" / "arm"
    (folder / "meshes").mkdir(parents=True)
    (folder / "assets").mkdir()
    corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    (folder / "meshes" / "tetrahedron.obj").write_text("\n".join(lines))
    mesh = '<asset><mesh name="t" file="../meshes/tetrahedron.obj"/></asset>'
    (folder / "assets" / "assets.xml").write_text(f"<mujocoinclude>{mesh}</mujocoinclude>")
    body = '<body><joint/><geom type="mesh" mesh="t"/></body>'
    included = '<include file="assets/assets.xml"/><compiler meshdir=""/>'
    (folder / "arm.xml").write_text(f"<mujoco>{included}<worldbody>{body}</worldbody></mujoco>")
    monkeypatch.chdir(tmp_path)
    near, far = load_robot(folder / "arm.xml"), load_robot("robots/arm/arm.xml")
    assert (near.links, near.shapes) == (far.links, far.shapes)


def test_world_of_a_floating_robot_is_noted(write):
    model = load_robot(write(ODD))
    assert model.root == "trunk"
    assert any("geoms of the world" in note for note in model.notes)


def test_a_body_that_stands_in_the_world_can_float(write):
    text = robot(f'<body name="a" pos="0 0 1">{BALL}<body name="b" pos="0 0 1"><joint/>{BALL}</body></body>')
    assert load_robot(write(text)).root == "world"
    floating = load_robot(write(text), base="floating")
    assert (floating.root, floating.nv) == ("a", 7)


def test_equality_of_joints_becomes_a_coupling(write):
    arm = f'<body><joint name="a" ref="10"/>{BALL}<body pos="0 0 1"><joint name="b" ref="20"/>{BALL}</body></body>'
    model = load_robot(write(robot(arm, '<equality><joint joint1="b" joint2="a" polycoef="0.1 2"/></equality>')))
    follower = next(joint for joint in model.joints if joint.name == "b")
    assert follower.mimic.joint == "a"
    assert follower.mimic.multiplier == 2
    assert follower.mimic.offset == pytest.approx(math.radians(20) + 0.1 - 2 * math.radians(10), rel=1e-14)


TWO = f'<body><joint name="a"/>{BALL}<body pos="0 0 1"><joint name="b" ref="20"/>{BALL}</body></body>'
LINE = '<joint name="e" joint1="b" joint2="a" polycoef="0.1 2"/>'


def test_an_equality_of_one_joint_holds_it(write):
    held = '<equality><joint joint1="b" polycoef="0.3 0 0 0 0"/></equality>'
    path = write(robot(TWO, held))
    model = load_robot(path)
    assert model.joint_names == ("a",)
    assert any("held joints 'b'" in note for note in model.notes)
    m = passive_model(path)
    d = mujoco.MjData(m)
    m.opt.disableflags &= ~int(OFF.mjDSBL_CONSTRAINT)
    d.qpos[1] = model.held["b"]
    mujoco.mj_forward(m, d)
    assert d.efc_pos == pytest.approx([0.0], abs=1e-15)


CROSSED = """<tendon><fixed name="s"><joint joint="a" coef="0.5"/><joint joint="b" coef="-0.2"/></fixed>
<fixed name="t"><joint joint="a" coef="3"/></fixed></tendon><equality><tendon %s/></equality>"""


@pytest.mark.parametrize(
    "tendons", ['tendon1="s" polycoef="0.1 0 0 0 0"', 'tendon1="s" tendon2="t" polycoef="-0.1 2 0 0 0"']
)
def test_an_equality_of_fixed_tendons_is_the_line_that_mujoco_draws(write, tendons):
    path = write(robot(TWO, CROSSED % tendons))
    ((leader, follower, multiplier, offset),) = [(b, a, *line) for a, b, *line in load_robot(path).couplings]
    assert (leader, follower) == ("a", "b")
    m = passive_model(path)
    m.opt.disableflags &= ~int(OFF.mjDSBL_CONSTRAINT)
    d = mujoco.MjData(m)
    for d.qpos[0] in (-0.4, 0.0, 0.7):
        d.qpos[1] = multiplier * d.qpos[0] + offset
        mujoco.mj_forward(m, d)
        assert d.efc_pos == pytest.approx([0.0], abs=1e-15)


def test_an_equality_of_one_joint_by_a_tendon_holds_it(write):
    model = load_robot(write(robot(TWO, CROSSED % 'tendon1="t" polycoef="0.6 0 0 0 0"')))
    assert model.joint_names == ("b",)
    assert model.held == {"a": pytest.approx(0.2)}


def test_an_equality_of_three_joints_is_a_spring_as_soft_as_solref(write):
    """A mass 1/w on a spring and damper of this time constant and damping ratio; the sum stays near its rest."""
    third = f'<body pos="0 0 1"><joint name="c" axis="1 0 0"/>{BALL}</body>'
    text = (
        '<tendon><fixed name="sum"><joint joint="a" coef="1"/><joint joint="b" coef="-2"/><joint joint="c" coef=".5"/>'
        '</fixed></tendon><equality><tendon tendon1="sum" polycoef=".1 0 0 0 0" solref=".01 .8"/></equality>'
    )
    path = write(robot(TWO.replace("</body></body>", f"{third}</body></body>"), text))
    model, m = load_robot(path), mujoco.MjModel.from_xml_path(str(path))
    (tendon,) = model.tendons
    w = m.tendon_invweight0[0]
    assert dict(tendon.joints) == {"a": 1.0, "b": -2.0, "c": 0.5}
    assert (tendon.stiffness, tendon.damping) == (pytest.approx(1.0 / (w * 0.008**2)), pytest.approx(2.0 / (w * 0.01)))
    assert tendon.slack[0] == tendon.slack[1] == pytest.approx(0.1 - 2.0 * m.qpos0[1])
    scene, q = in_company(model, "implicit_euler", 1e-3), [tendon.slack[0], 0.0, 0.0]
    run = simulated(scene, 0.3, q, [2.0, 1.5, 2.0], record=("q", "tendon_length"))
    assert np.ptp(run["q"], axis=0).min() > 0.02
    assert np.abs(run["tendon_length"] - tendon.slack[0]).max() < 0.02


def test_a_motor_on_a_tendon_is_a_drive_without_gains(write):
    fixed = '<fixed name="sum"><joint joint="a" coef="1"/><joint joint="b" coef="-2"/></fixed>'
    text = f'<tendon>{fixed}</tendon><actuator><motor tendon="sum" ctrlrange="-1 1"/></actuator>'
    model = load_robot(write(robot(TWO, text)), strict=True)
    assert any("whose forces (gear gain control) are those of tau: '0'" in note for note in model.notes)
    np.testing.assert_array_equal(tendon_jacobian(model, [0.0, 0.0]), [[1.0, -2.0]])
    assert model.tendons[0].controller == Controller("pd_clamped")
    assert compile_scene(model).inputs == 3


def test_tendons_that_no_line_follows_are_refused(write):
    for tendons in ('tendon1="s" tendon2="t" polycoef="0 1 2 0 0"', 'tendon1="w" tendon2="t" polycoef="0 1 0 0 0"'):
        spatial = '<spatial name="w"><site site="u"/><site site="v"/></spatial></tendon>'
        sites = TWO.replace(BALL, BALL + '<site name="u"/>', 1).replace("</body></", '<site name="v"/></body></')
        text = (CROSSED % tendons).replace("</tendon><equality>", spatial + "<equality>")
        with pytest.raises(RobotFileError, match="<tendon> is not supported"):
            load_robot(write(robot(sites, text)))


@pytest.mark.parametrize("flag", ["equality", "constraint"])
def test_equalities_that_are_switched_off_couple_nothing(write, flag):
    text = robot(TWO, f'<equality>{LINE}</equality><option><flag {flag}="disable"/></option>')
    model = load_robot(write(text))
    assert model.joint_names == ("a", "b")
    assert not model.couplings
    assert any("1 equalities that are not active" in note for note in model.notes)


@pytest.mark.parametrize("other", ['<joint name="f" joint1="b" joint2="a"/>', '<joint name="f" joint1="b"/>'])
def test_a_joint_that_two_equalities_lead_is_refused(write, other):
    with pytest.raises(RobotFileError, match="joint 'b' is led by equalities 'e', 'f'"):
        load_robot(write(robot(TWO, f"<equality>{LINE}{other}</equality>")))


def test_a_bent_equality_is_refused_as_bent(write):
    with pytest.raises(RobotFileError, match=r"not linear: polycoef is \[0\.1, 2\.0, 3\.0"):
        load_robot(write(robot(TWO, f"<equality>{LINE.replace('0.1 2', '0.1 2 3')}</equality>")))


def test_a_turned_free_body_stays_turned_when_it_is_fixed(write):
    stands = ODD.replace("<freejoint/>", "").replace('qpos="0 0 0.5 1 0 0 0 0.1', 'qpos="0.1')
    model, m = load_robot(write(ODD), base="fixed"), passive_model(write(stands))
    assert model.base == "fixed"
    assert relative_error(model, m) < 1e-12
    d = mujoco.MjData(m)
    mujoco.mj_kinematics(m, d)
    trunk = forward_kinematics(model, d.qpos)
    k = [link.name for link in model.links].index("trunk")
    np.testing.assert_allclose(trunk.position[k], d.body("trunk").xpos, atol=1e-15)
    np.testing.assert_allclose(trunk.rotation[k].ravel(), d.body("trunk").xmat, atol=1e-15)


def test_a_robot_without_a_name_is_called_like_its_file(write):
    path = write(robot(TWO))
    assert load_robot(path).name == path.stem


# ------------------------------------------------------------------------------------------------ armature


def test_armature_is_part_of_the_mass_matrix_and_of_every_drive(write):
    path = write(robot('<body><joint name="j" axis="0 1 0" armature="0.7"/><geom size="0.1" mass="2"/></body>'))
    model = load_robot(path)
    own = 0.4 * 2 * 0.1**2
    assert mass_matrix(model, [0.3])[0, 0] == pytest.approx(own + 0.7, rel=1e-12)
    assert forward_dynamics(model, [0.3], [0.0], [1.0])[0] == pytest.approx(1 / (own + 0.7), rel=1e-12)
    assert inverse_dynamics(model, [0.3], [0.0], [1.0])[0] == pytest.approx(own + 0.7, rel=1e-12)
    assert mass_matrix(model, [0.3], armature=[0.0])[0, 0] == pytest.approx(own, rel=1e-12)
    assert compile_scene(model).constants.armature.tolist() == [0.7]


def test_a_motion_feels_the_armature(write):
    ball = '<joint name="j" axis="0 1 0" armature="0.7"/><geom size="0.1" mass="2"/>'
    model = load_robot(write(robot(f"<body>{ball}</body>")))
    run = simulated(in_company(model, "rk4", 0.01, gravity=(0, 0, 0)), 1.0, tau=[3.0], record=("q",))
    assert run["q"][-1, 0] == pytest.approx(0.5 * 3.0 / (0.7 + 0.4 * 2 * 0.1**2), rel=1e-9)


def test_rotors_come_on_top_of_the_armature_of_joints():
    links = tuple(Link(name, 1.0, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)) for name in "ab")
    servo = Servo(Controller("state"), Gearbox(10.0, rotor_inertia=1e-3), 1.0, 0.0, 0.01, 10.0)
    model = Model("m", links, (Joint("j", "continuous", "a", "b", armature=0.5),), servos={"j": servo})
    assert build_drive(model, "rotor").armature.tolist() == [0.5 + 0.1]
    assert build_drive(model, "standard").armature.tolist() == [0.5]


def test_a_robot_without_armature_has_none():
    assert build_drive(load_robot("humanoid"), "standard").armature is None


# ------------------------------------------------------------------------------------------------ actuators


def joint_torques(path, q, qd, control):
    """What the actuators of a file give its one joint."""
    m = mujoco.MjModel.from_xml_path(str(path))
    d = mujoco.MjData(m)
    d.qpos[:], d.qvel[:], d.ctrl[:] = q, qd, control
    mujoco.mj_forward(m, d)
    return float(d.qfrc_actuator[0])


NO = '<option><flag %s="disable"/></option>'
DC = 'motorconst="0.05 0.05" resistance="2" controller="0.02 0 0.004 0 0 6" gear="50" input="pos"'
JOINT = robot(f'<body><joint name="j" axis="0 1 0"/>{BALL}</body>', "<actuator>%s</actuator>")


@pytest.mark.parametrize("q", [-0.4, 0.05, 0.9])
def test_position_actuator_is_a_clamped_pd_servo(write, q):
    path = write(JOINT % '<position joint="j" kp="30" kv="2" gear="-3" forcerange="-5 5"/>')
    with pytest.warns(RobotFileWarning, match="u/gear"):
        law = load_robot(path).servos["j"].controller
    reference, qd = 0.2, 0.3
    ours = np.clip(law.Kp * (reference - q) - law.Kd * qd, -law.torque_limit, law.torque_limit)
    assert law.law == "pd_clamped"
    assert ours == pytest.approx(joint_torques(path, q, qd, -3 * reference), rel=1e-12)


@pytest.mark.parametrize(
    "actuator",
    [
        'position joint="j" kp="30" gear="-3" ctrlrange="-0.6 1.5"',
        'general joint="j" biastype="affine" gainprm="60" biasprm="0 -30 0" ctrlrange="-0.25 0.1"',
        f"dcmotor joint='j' {DC} ctrlrange='-25 10'",
    ],
)
def test_the_range_to_which_mujoco_clamps_references_is_kept_and_named(write, actuator, tmp_path):
    """Beyond it, controls give the torque of the reference at its end."""
    path = write(JOINT % f"<{actuator}/>")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RobotFileWarning)  # of the gear and the scale
        model = load_robot(path)
    (low, high), note = model.references["j"], next(note for note in model.notes if "as `Model.references`" in note)
    assert (low, high) == pytest.approx((-0.5, 0.2), abs=1e-15)
    assert f"{low:g} to {high:g}" in note
    for name in ("again.urdf", "again.xml"):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RobotFileWarning)
            save_robot(model, tmp_path / name)
            assert load_robot(tmp_path / name).references["j"] == pytest.approx((low, high), rel=1e-12)
    servo = model.servos["j"]
    ends = sorted(joint_torques(path, 0.0, 0.0, u) for u in (-1e3, 1e3))
    rotor = servo.gearbox.ratio * servo.motor_constant / servo.resistance if servo.resistance else 1.0
    most = servo.voltage_limit or np.inf
    ours = [rotor * np.clip(servo.controller.Kp * reference, -most, most) for reference in (low, high)]
    assert ours == pytest.approx(ends, rel=1e-12)


@pytest.mark.parametrize("q", [-0.4, 0.05, 0.9])
def test_an_actuator_of_a_tendon_is_one_of_the_joint_that_its_joints_follow(write, q):
    """As in a gripper: two fingers, of which one follows the other, and a control in counts."""
    more = (
        '<tendon><fixed name="both"><joint joint="a" coef="0.5"/><joint joint="b" coef="0.25"/></fixed></tendon>'
        '<equality><joint joint1="b" joint2="a" polycoef="0 -1 0 0 0"/></equality><actuator><general tendon="both" '
        'biastype="affine" gainprm="0.4" biasprm="0 -100 -10" gear="2" forcerange="-3 3"/></actuator>'
    )
    path = write(robot(TWO.replace(' ref="20"', ""), more))
    with pytest.warns(RobotFileWarning, match="control is scaled"):
        law = load_robot(path).servos["a"].controller
    reference, qd = 0.2, 0.3
    ours = np.clip(law.Kp * (reference - q) - law.Kd * qd, -law.torque_limit, law.torque_limit)
    m = mujoco.MjModel.from_xml_path(str(path))
    d = mujoco.MjData(m)
    gear = 2 * (0.5 - 0.25)
    d.qpos[:], d.qvel[:], d.ctrl[:] = (q, -q), (qd, -qd), 100 * gear * reference / 0.4
    mujoco.mj_forward(m, d)
    assert ours == pytest.approx(d.qfrc_actuator[0] - d.qfrc_actuator[1], rel=1e-12)


@pytest.mark.parametrize("q", [-2.0, 0.15, 0.4])
def test_dc_motor_becomes_a_servo_of_the_same_torque(write, q):
    motor = 'motorconst="0.05 0.05" resistance="2" saturation="0.2 0 0" controller="0.02 0 0.004 0 0 6" gear="50"'
    path = write(JOINT % f'<dcmotor joint="j" {motor} input="pos" armature="1e-5" damping="1e-6"/>')
    servo = load_robot(path).servos["j"]
    law, G, K, R = servo.controller, servo.gearbox.ratio, servo.motor_constant, servo.resistance
    reference, qd = 0.2, 0.3
    voltage = np.clip(law.Kp * (reference - q) - law.Kd * qd, -servo.voltage_limit, servo.voltage_limit)
    current = np.clip((voltage - G * K * qd) / R, -servo.current_limit, servo.current_limit)
    assert G * K * current == pytest.approx(joint_torques(path, q, qd, G * reference), rel=1e-12)
    assert (servo.gearbox.rotor_inertia, servo.viscous_friction) == (1e-5, pytest.approx(2500e-6))


def test_motor_gives_the_joint_its_effort(write):
    path = write(JOINT % '<motor name="m" joint="j" gear="40" ctrlrange="-0.5 0.5"/>')
    model = load_robot(path)
    assert model.moving_joints[0].effort == 20.0
    assert any("which limit no tau" in note and "-20 to 20 of 'm'" in note for note in model.notes)


def test_motors_whose_controls_are_not_clamped_have_no_limit(write):
    path = write(JOINT.replace("</mujoco>", NO % "clampctrl" + "</mujoco>") % '<motor joint="j" ctrlrange="-1 1"/>')
    assert load_robot(path).moving_joints[0].effort == math.inf


def test_motors_of_one_joint_add_up(write):
    two = '<motor joint="j" gear="40" ctrlrange="-0.5 0.5"/><motor joint="j" gear="-2" ctrlrange="-3 3"/>'
    model = load_robot(write(JOINT % two))
    assert model.moving_joints[0].effort == 26.0
    assert any("-20 to 20 of '0'; -6 to 6 of '1'" in note for note in model.notes)
    limited = JOINT.replace('name="j"', 'name="j" actuatorfrcrange="-7 7"')
    model = load_robot(write(limited % two))
    assert model.moving_joints[0].effort == 7.0
    assert any("-7 to 7 of '0'" in note for note in model.notes)


@pytest.mark.parametrize("kind", ['velocity name="v" kv="3"', 'intvelocity name="v" kp="3" actrange="-1 1"'])
def test_actuators_without_a_like_are_warned_of(write, kind):
    path = write(JOINT % f'<{kind} joint="j"/>')
    with pytest.warns(RobotFileWarning, match="an unsupported kind: 'v'"):
        assert not load_robot(path).servos


@pytest.mark.parametrize(
    ("actuator", "word"),
    [
        ('<position joint="j" kp="3" timeconst="0.1"/>', "took activations of actuators as being at once"),
        ('<position joint="j" kp="3" gear="-2"/>', "took the joint's angle, u/gear"),
        ('<position joint="j" kp="3" forcerange="-1 5"/>', "larger end of forcerange"),
        ('<position joint="j" kp="3" damping="0 2 0"/>', "nonlinear damping of actuators"),
        ('<position joint="j" kp="3" timeconst="0.1" delay="0.01" nsample="3"/>', "delay of actuators"),
        (f'<dcmotor joint="j" {DC.replace("50", "-50")}/>', "took the joint's angle, u/gear"),
        ('<motor joint="j" ctrlrange="0 1"/>', "larger limit of motors"),
        ('<motor joint="j" forcerange="-1 2"/>', "larger limit of motors"),
    ],
)
def test_what_of_an_actuator_is_taken_otherwise_is_warned_of(write, actuator, word):
    with pytest.warns(RobotFileWarning, match=word):
        load_robot(write(JOINT % actuator))


@pytest.mark.parametrize("off", ['actuatorgroupdisable="3"/>', '><flag actuation="disable"/></option>'])
def test_actuators_that_are_switched_off_are_no_servos(write, off):
    actuators = '<position name="p" joint="j" kp="3" group="3" armature="0.2"/>'
    path = write(JOINT.replace("</mujoco>", f"<option {off}</mujoco>") % actuators)
    with pytest.warns(RobotFileWarning, match="switches off: 'p'"):
        model = load_robot(path)
    assert not model.servos
    assert model.joints[0].armature == 0.2


def test_servos_of_two_kinds_are_remarked_on(write):
    actuators = f'<actuator><position joint="a" kp="3"/><dcmotor joint="b" {DC}/></actuator>'
    model = load_robot(write(robot(TWO, actuators)))
    assert any("compile_scene takes one kind" in note for note in model.notes)
    with pytest.raises(ValueError, match="mixes pd servos"):
        compile_scene(model, gearbox="rotor")


# ------------------------------------------------------------------------------------------------ refusals


DRAWN = '<equality><weld body1="hand" body2="a"/></equality>'
WIRE = '<tendon><fixed name="wire" %s><joint joint="a" coef="1"/></fixed></tendon>'


def test_all_reasons_come_at_once(write):
    text = robot(
        f'<body name="a"><joint name="socket"/>{BALL}</body>'
        f'<body name="b" pos="1 0 0"><joint name="t"/><joint name="u" axis="1 0 0"/>{BALL}<site name="s"/></body>',
        '<equality><joint joint1="t" joint2="u" polycoef="0 1 2 0 0"/>'
        '<joint joint1="u" joint2="socket" polycoef="0 1 3 0 0"/></equality>'
        '<tendon><fixed name="wire" stiffness="3"><joint joint="t" coef="1"/></fixed></tendon>',
    )
    with pytest.raises(RobotFileError) as error:
        load_robot(write(text))
    assert len(error.value.problems) == 2
    for word in ("equality 0", "equality 1", "polycoef"):
        assert word in str(error.value)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        (robot(f'<body><joint type="free" stiffness="2"/>{BALL}</body>'), "stiffness of the free joint"),
        (robot(f'<body><joint name="j" stiffness="0 5 0"/>{BALL}</body>'), "nonlinear stiffness"),
        (robot(f'<body><joint name="j" stiffness="1" springyield="0.1"/>{BALL}</body>'), "yield"),
        (robot(f'<body><joint name="j" actuatorfrcrange="-1 2"/>{BALL}</body>'), "larger end of actuatorfrcrange"),
        (robot(f"<body><joint/>{BALL}</body>", NO % "gravity"), r"gravity=\(0, 0, 0\)"),
        (robot(f'<body><joint damping="1"/>{BALL}</body>', NO % "damper"), "switches off dampers"),
        (robot(f'<body><joint range="0 1"/>{BALL}</body>', NO % "limit"), "switches off limits"),
        (robot(f'<body><joint range="0 1"/>{BALL}</body>', NO % "constraint"), "switches off limits"),
        (robot(f'<body><joint frictionloss="1"/>{BALL}</body>', NO % "frictionloss"), "switches off friction"),
        (robot(f'<body><joint frictionloss="1"/>{BALL}</body>', NO % "constraint"), "switches off friction"),
        (robot(f"<body><joint/>{BALL}</body>", '<option density="1000"/>'), "fluid"),
        (robot(f'<body gravcomp="1"><joint actuatorgravcomp="true"/>{BALL}</body>'), "gravcomp"),
        (robot(f"<body><joint/>{BALL}</body>", '<option gravity="0 0 -1.6"/>'), "gravity"),
        (robot(f'<body><joint type="free" damping="1"/>{BALL}</body>'), "free joint"),
        (robot(f"<body><freejoint/>{BALL}</body>" * 2), "left out bodies 'body2'"),
        (robot(f'<body mocap="true" name="hand"/><body name="a"><joint/>{BALL}</body>', DRAWN), "mocap body"),
        (robot("TWO", WIRE % 'stiffness="0 3 0"'), "ignored the nonlinear stiffness of tendons 'wire'"),
    ],
)
def test_what_changes_the_motion_is_warned_of_or_refused(write, text, word):
    path = write(text.replace("TWO", TWO))
    with pytest.warns(RobotFileWarning, match=word):
        model = load_robot(path)
    assert any(re.search(word, note) for note in model.notes)
    with pytest.raises(RobotFileError, match=word):
        load_robot(path, strict=True)


@pytest.mark.parametrize(("flag", "stiffness"), [("", 2.0), (NO % "spring", 0.0)])
def test_springs_are_read_unless_they_are_switched_off(write, flag, stiffness):
    model = load_robot(write(robot(f'<body><joint stiffness="2" springref="90"/>{BALL}</body>', flag)), strict=True)
    (joint,) = model.joints
    assert (joint.stiffness, joint.spring_reference) == (stiffness, pytest.approx(math.pi / 2 if stiffness else 0.0))


BORNE = """<body gravcomp="0.6"><joint axis="0 1 1"/><geom size="0.1" mass="1" pos=".2 0 0"/>
<body pos="0 0 .3" gravcomp="1.2"><geom size="0.1" mass="2" pos=".1 0 0"/></body></body>"""


@pytest.mark.parametrize(
    ("flag", "borne"),
    [("", [0.0, 0.6, 1.2]), ('<option><flag spring="disable" damper="disable"/></option>', [0.0, 0.0, 0.0])],
)
def test_weights_that_are_borne_act_as_in_mujoco(write, tmp_path, flag, borne):
    """Also of a body that is fixed to another, and after a round trip; both flags switch gravcomp off."""
    path, again = write(robot(BORNE, flag)), tmp_path / "again.xml"
    model = load_robot(path, strict=True)
    assert [link.gravity_compensation for link in model.links] == borne
    save_robot(model, again)
    for each in (path, again):
        assert relative_error(load_robot(each), mujoco.MjModel.from_xml_path(str(each))) < 1e-12


def test_reasons_and_doubts_come_at_once(write):
    inner = f'<body name="b"><joint name="u" stiffness="0 2"/>{BALL}</body>'
    inside = f'<body name="a"><joint name="t"/>{BALL}{inner}</body>'
    bent = '<equality><joint joint1="t" joint2="u" polycoef="0 1 2 0 0"/></equality>'
    text = robot(inside, bent + NO % "gravity")
    for strict, count in ((False, 1), (True, 3)):
        with pytest.raises(RobotFileError, match="is not linear") as error:
            load_robot(write(text), strict=strict)
        assert len(error.value.problems) == count


@pytest.mark.parametrize(
    ("text", "word"),
    [
        (robot("<body><joint/></body>"), "mass and inertia"),
        (robot(f'<body><joint axis="0 0 0"/>{BALL}</body>'), "axis"),
        (robot(f"<body><joint/>{BALL}</body><banana/>"), "banana"),
        ("<mujoco><worldbody>", "well-formed"),
        ('<!DOCTYPE m [<!ENTITY e "x">]><mujoco/>', "entities"),
        (robot('<replicate count="200000000"><body/></replicate>'), "at most 10000"),
        (robot('<replicate count="2000"><replicate count="2000"><body/></replicate></replicate>'), "at most 10000"),
        (robot("", '<size nkey="2000000000"/>'), "at most 10000"),
        (robot("", '<asset><hfield name="h" nrow="60000" ncol="60000" size="1 1 1 1"/></asset>'), "hfield"),
        ("<sdf/>", "expected <robot>"),
        ("", "empty"),
    ],
)
def test_bad_files_are_refused_by_name(write, text, word):
    path = write(text)
    with pytest.raises(RobotFileError, match=word) as error:
        load_robot(path)
    assert path.name in str(error.value)


MANY = '<replicate count="%s"><site/></replicate>'
BODY = f'<body name="b"><joint/>{BALL}%s</body>'
ATTACH = '<asset><model name="m" file="deep/b.xml"/></asset><worldbody>%s</worldbody>'
MANY_FILES = '<worldbody><replicate count="300"><include file="deep/b.xml"/></replicate></worldbody>'
ONE = '<attach model="m" body="b" prefix="p%d"/>'


@pytest.mark.parametrize(
    ("first", "second", "word"),
    [
        ('<include file="deep/b.xml"/>', '<include file="c.xml"/>', "c.xml: <replicate> asks for 30000"),
        (ATTACH % (ONE % 0), robot(BODY % (MANY % 30_000)), "b.xml: <replicate> asks for 30000"),
        (ATTACH % f'<replicate count="300">{ONE % 0}</replicate>', robot(BODY % (MANY % 100)), "asks for 30000"),
        (MANY_FILES, f"<mujocoinclude>{MANY % 100}</mujocoinclude>", "asks for 30000"),
        (ATTACH % "".join(ONE % k for k in range(12)), robot(BODY % (MANY % 9_000)), "more than 50000 elements"),
    ],
)
def test_too_much_in_other_files_is_refused(tmp_path, first, second, word):
    (tmp_path / "deep").mkdir()
    (tmp_path / "a.xml").write_text(f"<mujoco>{first}</mujoco>")
    (tmp_path / "deep" / "b.xml").write_text(second if second.startswith("<mujoco") else f"<mujoco>{second}</mujoco>")
    (tmp_path / "deep" / "c.xml").write_text(robot(MANY % 30_000))
    with pytest.raises(RobotFileError, match=word):
        load_robot(tmp_path / "a.xml")


def test_files_that_include_each_other_are_refused_soon(tmp_path):
    for this, other in ("ab", "ba"):
        (tmp_path / f"{this}.xml").write_text(f'<mujoco><include file="{other}.xml"/></mujoco>')
    with pytest.raises(RobotFileError, match="MuJoCo cannot read it"):
        load_robot(tmp_path / "a.xml")


@pytest.mark.parametrize(
    "bad",
    [
        '<body name="x">\n<geom size="-3"/></body>',
        '<body name="x">\n<geom sizze="3"/></body>',
        '<body name="x">\n<geom size="3"></body>',
    ],
)
def test_an_error_in_an_included_file_is_blamed_on_it(tmp_path, bad):
    (tmp_path / "arm.xml").write_text(f"<mujoco><worldbody>{bad}</worldbody></mujoco>")
    (tmp_path / "robot.xml").write_text('<mujoco>\n\n\n<include file="arm.xml"/></mujoco>')
    with pytest.raises(RobotFileError, match=r"arm\.xml.*line 2") as error:
        load_robot(tmp_path / "robot.xml")
    assert "robot.xml" not in str(error.value)


@pytest.mark.parametrize("strict", [True, False])
@pytest.mark.parametrize("inside", ["", "<worldbody/>", '<worldbody><geom size="1"/></worldbody>', "<asset/>"])
def test_a_file_without_bodies_is_refused(write, inside, strict):
    with pytest.raises(RobotFileError, match="<body>"):
        load_robot(write(f"<mujoco>{inside}</mujoco>"), strict=strict)


def test_an_attached_model_is_read(tmp_path):
    (tmp_path / "a.xml").write_text(f"<mujoco>{ATTACH.replace('deep/', '') % (ONE % 0)}</mujoco>")
    (tmp_path / "b.xml").write_text(robot(BODY % (MANY % 10)))
    assert load_robot(tmp_path / "a.xml").nv == 1


def test_a_bare_name_is_a_path(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(RobotFileError, match="no such file"):
        load_robot("simtwo.xml")


def test_what_mujoco_remarks_is_noted_and_leaves_no_file(write, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = write(robot(f"<body><joint/>{BALL}</body>", '<compiler settotalmass="2"/><option timestep="nan"/>'))
    assert any("settotalmass" in note for note in load_robot(path).notes)
    assert list(tmp_path.iterdir()) == [path]


def test_without_mujoco_the_command_is_named(write, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ImportError, match=r"pip install featherstone-gait\[mjcf\]"):
        load_robot(write(ODD))


# ------------------------------------------------------------------------------------------------ published models


def is_a_robot(m):
    """Joints with one freedom each, and no equality."""
    return m.njnt and not (m.jnt_type == 1).any() and m.neq == 0


@pytest.mark.parametrize(("package", "under"), [("gymnasium", "envs/mujoco/assets"), ("dm_control", "")])
@pytest.mark.filterwarnings("ignore::featherstone_gait.RobotFileWarning")
def test_published_robots_load_and_move_as_in_mujoco(package, under):
    compared = 0
    for path in sorted((published.folder(package) / under).rglob("*.xml")):
        try:
            m = passive_model(path)
        except ValueError:  # fragments, and files whose meshes are not shipped
            continue
        if is_a_robot(m):
            model = load_robot(path)
            if path.name == "quadruped.xml":  # whose equalities, which are off in m, are springs of tendons
                model = replace(model, tendons=())
            links = {link.name for link in model.links}
            masses = [m.body_mass[b] for b, name in enumerate(names_of(m, "body", m.nbody)) if b and name in links]
            assert model.mass == pytest.approx(sum(masses), rel=1e-12), path
            compared += 1
            if "drosophila" in path.name:  # whose mass matrix loses nine digits in any solver
                assert relative_force_error(model, m) < 1e-10
            else:
                assert relative_error(model, m) < 1e-10, path
    assert compared >= (14 if package == "gymnasium" else 33)


def relative_force_error(model, m):
    """Largest difference of M qdd + c by the largest force, at a random state."""
    d, forces = mujoco.MjData(m), np.zeros(m.nv)
    (q, *_), (qd, *_), (qdd, *_) = random_states(model, 1, 3)
    d.qpos[:], d.qvel[:], d.qacc[:] = q, qd, qdd
    mujoco.mj_kinematics(m, d)
    mujoco.mj_inverse(m, d)
    forces = d.qfrc_inverse
    return np.abs(inverse_dynamics(model, q, qd, qdd) - forces).max() / np.abs(forces).max()


# ------------------------------------------------------------------------------------------------ writing


def reordered(model, other, x, base):
    """Columns of a state of a model in the order of another with the same joints."""
    names = list(model.joint_names)
    return np.hstack([x[:, :base], x[:, [base + names.index(name) for name in other.joint_names]]])


def round_trip_error(model, path):
    """Largest difference of accelerations before and after a round trip, by the largest."""
    save_robot(model, path)
    back = load_robot(path)
    q, qd, tau = random_states(model, 5, 11)
    free = 6 if model.base == "floating" else 0
    before = reordered(model, back, forward_dynamics(model, q, qd, tau), free)
    q = reordered(model, back, q, free and 7)
    after = forward_dynamics(back, q, reordered(model, back, qd, free), reordered(model, back, tau, free))
    return np.abs(after - before).max() / np.abs(before).max()


@pytest.mark.parametrize("name", ["humanoid", "arm7", "arm7_spatial", "ax12_arm"])
def test_a_round_trip_keeps_the_dynamics(name, tmp_path):
    assert round_trip_error(load_robot(name), tmp_path / "robot.xml") < 1e-12


@pytest.mark.parametrize("seed", range(4))
def test_a_round_trip_keeps_the_dynamics_of_any_tree(seed, tmp_path):
    tree = random_tree(9, seed, base=("fixed", "floating")[seed % 2])
    assert round_trip_error(tree, tmp_path / "tree.xml") < 1e-12


def test_a_round_trip_keeps_joints_without_mass_between_them(write, tmp_path):
    model = load_robot(write(ODD))
    assert round_trip_error(model, tmp_path / "again.xml") < 1e-12
    back = load_robot(tmp_path / "again.xml")
    assert [joint.armature for joint in back.moving_joints] == [0.02] * 4
    assert [joint.lower for joint in back.moving_joints] == [joint.lower for joint in model.moving_joints]
    assert back.keyframes == model.keyframes
    assert len(back.shapes) == len(model.shapes)


def test_locked_joints_are_welded_where_they_are(tmp_path):
    locked = {name: 0.3 for name in ("right_elbow", "left_elbow")}
    model = load_robot("humanoid", locked=locked)
    assert round_trip_error(model, tmp_path / "robot.xml") < 1e-12


def test_couplings_make_the_round_trip(tmp_path):
    links = tuple(Link(name, 1.0, (0.0, 0.0, 0.1), (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)) for name in "abc")
    follower = Joint("k", "continuous", "b", "c", mimic=Mimic("j", -0.5, 0.2))
    model = Model("m", links, (Joint("j", "continuous", "a", "b"), follower))
    save_robot(model, tmp_path / "m.xml")
    assert load_robot(tmp_path / "m.xml").joints[1].mimic == Mimic("j", -0.5, 0.2)


def test_pd_servos_make_the_round_trip(tmp_path):
    links = tuple(Link(name, 1.0, (0.0, 0.0, 0.1), (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)) for name in "ab")
    law = Controller("pd_clamped", Kp=30.0, Kd=0.7, torque_limit=2.5)
    servo = Servo(law)
    save_robot(Model("m", links, (Joint("j", "continuous", "a", "b"),), servos={"j": servo}), tmp_path / "m.xml")
    back = load_robot(tmp_path / "m.xml").servos["j"].controller
    assert (back.law, back.Kp, back.Kd, back.torque_limit) == ("pd_clamped", 30.0, 0.7, 2.5)


def test_a_written_motor_gives_the_torque_of_the_servo(tmp_path):
    model = load_robot("ax12_arm")
    save_robot(model, tmp_path / "arm.xml")
    m = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    servo = model.servos["elbow"]
    K, R = servo.gearbox.ratio * servo.motor_constant, servo.resistance
    m.opt.timestep = 1e-4
    m.opt.disableflags |= OFF.mjDSBL_GRAVITY | OFF.mjDSBL_FRICTIONLOSS
    m.dof_armature[:] = 1e9  # it stands still while the current settles
    d = mujoco.MjData(m)
    d.ctrl[:] = 0.05
    mujoco.mj_step(m, d, 500)  # 50 ms, 80 time constants L/R
    settled = K * min(servo.controller.Kp * 0.05, servo.voltage_limit) / R
    assert d.qfrc_actuator[0] == pytest.approx(settled, rel=1e-9)


def test_a_robot_stands_on_the_written_ground_as_deep_as_it_sinks(tmp_path):
    block = Link("block", 2.0, (0.0, 0.0, 0.1), (0.02, 0.0, 0.0, 0.02, 0.0, 0.02))
    corners = [ContactPoint("block", (x, y, 0.0)) for x in (-0.1, 0.1) for y in (-0.1, 0.1)]
    model = Model("block", (block,), (), "floating", contacts=tuple(corners))
    save_robot(model, tmp_path / "block.xml", ground=Ground(penetration=1e-3, height=0.4))
    m = mujoco.MjModel.from_xml_path(str(tmp_path / "block.xml"))
    d = mujoco.MjData(m)
    d.qpos[2] = 0.401
    mujoco.mj_step(m, d, 2000)
    depth = 0.4 - (d.qpos[2] - 1e-4)  # the points are spheres of 0.1 mm
    assert np.abs(d.qvel).max() < 1e-6
    assert depth == pytest.approx(1e-3, rel=0.02)


def test_a_failed_save_leaves_nothing(tmp_path):
    links = (Link("a", 1.0, (0.0,) * 3, (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)), Link("b", 0.0, (0.0,) * 3, (0.0,) * 6))
    ends = tuple(Link(name, 1.0, (0.0,) * 3, (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)) for name in "cd")
    joints = (
        Joint("j", "continuous", "a", "b"),
        *(Joint(f"to_{n}", "continuous", "b", n, axis=(0.0, 1.0, 0.0)) for n in "cd"),
    )
    model = Model("fork", (*links, *ends), joints)
    with pytest.raises(ValueError, match="'b' moves without mass"):
        save_robot(model, tmp_path / "fork.xml")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["robot.sdf", "robot"])
def test_other_suffixes_are_refused(name, tmp_path):
    with pytest.raises(ValueError, match=r"must end in \.urdf"):
        save_robot(load_robot("arm7"), tmp_path / name)


def test_urdf_takes_no_ground(tmp_path):
    with pytest.raises(ValueError, match="URDF states no ground"):
        save_robot(load_robot("arm7"), tmp_path / "robot.urdf", ground=Ground())


def test_urdf_and_toml_keep_what_mjcf_says(write, tmp_path):
    model = load_robot(write(ODD))
    save_robot(model, tmp_path / "odd.urdf")
    again = load_robot(tmp_path / "odd.urdf")
    for name in ("links", "joints", "base", "keyframes", "shapes"):
        assert getattr(again, name) == getattr(model, name)


def test_urdf_states_couplings(tmp_path):
    links = tuple(Link(name, 1.0, (0.0, 0.0, 0.1), (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)) for name in "abc")
    follower = Joint("k", "continuous", "b", "c", mimic=Mimic("j", -0.5, 0.2))
    save_robot(Model("m", links, (Joint("j", "continuous", "a", "b"), follower)), tmp_path / "m.urdf")
    assert load_robot(tmp_path / "m.urdf").joints[1].mimic == follower.mimic


@pytest.mark.parametrize(
    ("toml", "word"),
    [
        ("[joints.knee]\narmature = 1.0", "no joint 'knee'"),
        ("[joints.elbow]\ninertia = 1.0", "unknown key 'inertia'"),
        ("[joints.elbow]\narmature = -1.0", "armature is -1.0"),
        ("[keyframes]\nhome = 1.0", "keyframes.home is 1.0"),
        ("[keyframes]\nhome = [0.0, 1.0]", "keyframe 'home'"),
    ],
)
def test_a_wrong_joint_or_keyframe_in_the_toml_is_refused(tmp_path, toml, word):
    save_robot(load_robot("ax12_arm"), tmp_path / "arm.urdf")
    (tmp_path / "arm.toml").write_text(toml)
    with pytest.raises(RobotFileError, match=word):
        load_robot(tmp_path / "arm.urdf")


@pytest.mark.parametrize("pitch", [0.0, 1.0, math.pi / 2, -math.pi / 2, math.pi / 2 - 1e-9])
def test_rpy_of_a_rotation_is_that_rotation(pitch):
    R = rotation_from_rpy((0.7, pitch, -2.1))
    np.testing.assert_allclose(rotation_from_rpy(rpy_from_rotation(R)), R, atol=5e-16)
    turn = rotation_about((0.6, 0.0, 0.8), 1.1)
    np.testing.assert_allclose(rotation_from_rpy(rpy_from_rotation(turn)), turn, atol=5e-16)
