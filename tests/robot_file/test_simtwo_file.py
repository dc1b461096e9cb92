"""Scenes of SimTwo: the humanoid written as one and read back, and what an axis, a solid and a motor mean in it."""

import math
from xml.sax.saxutils import quoteattr

import numpy as np
import pytest
from random_tree import random_states
from simtwo_scene import ARM

from featherstone_gait import RobotFileError, forward_dynamics, forward_kinematics, load_robot
from featherstone_gait.model.shapes import Box, Cylinder, Sphere

SCENE = """<?xml version="1.0"?>
<scene>
  <robot>
    <ID name="walker"/><pos x="1" y="0" z="0.5"/><rot_deg x="0" y="0" z="90"/>
    <body file="walker.xml"/>
  </robot>
</scene>
"""


def xyz(tag, values):
    return f"<{tag} " + " ".join(f"{name}='{value!r}'" for name, value in zip("xyz", values)) + "/>"


def as_simtwo(model):
    """A robot whose links are uniform boxes, with all frames parallel, for SimTwo; parents are first bodies."""
    origins = {model.root: np.zeros(3)}
    for joint in model.joints:
        origins[joint.child] = origins[joint.parent] + joint.xyz
    solids = "".join(_solid(link, origins[link.name]) for link in model.links)
    joints = "".join(_joint(joint, origins[joint.child], model.servos[joint.name]) for joint in model.joints)
    return f"<robot><kind value='humanoid'/><solids>{solids}</solids><articulations>{joints}</articulations></robot>"


def _solid(link, origin):
    xx, _, _, yy, _, zz = link.inertia
    size = [math.sqrt(6 * x / link.mass) for x in (yy + zz - xx, xx + zz - yy, xx + yy - zz)]
    place = xyz("pos", (origin + link.center_of_mass).tolist())
    return f"<cuboid><ID value={quoteattr(link.name)}/>{place}{xyz('size', size)}<mass value='{link.mass!r}'/></cuboid>"


def _joint(joint, origin, servo):
    axis = xyz("axis", [-x for x in joint.axis])
    limits = f"<limits Min='{math.degrees(joint.lower)!r}' Max='{math.degrees(joint.upper)!r}'/>"
    c, g = servo.controller, servo.gearbox
    return (
        f"<joint><ID value='{joint.name}'/>{xyz('pos', origin.tolist())}{axis}{limits}<type value='Hinge'/>"
        f"<connect B1='{joint.parent}' B2='{joint.child}'/><motor ri='{servo.resistance!r}' li='{servo.inductance!r}' "
        f"ki='{servo.motor_constant!r}' vmax='{servo.voltage_limit!r}' imax='{servo.current_limit!r}' active='1'/>"
        f"<rotor J='{g.rotor_inertia!r}' bv='0'/><gear ratio='{g.ratio!r}' ke='{g.stiffness!r}' be='{g.damping!r}'/>"
        f"<friction bv='{servo.viscous_friction!r}' fc='{servo.coulomb_friction!r}'/>"
        f"<controller mode='state' kp='{c.Kp!r}' ki='0' kd='0' kf='0' active='1' period='10'/></joint>"
    )


@pytest.fixture
def humanoid(tmp_path):
    """The humanoid and its scene's path."""
    model = load_robot("humanoid")
    (tmp_path / "walker.xml").write_text(as_simtwo(model))
    (tmp_path / "scene.xml").write_text(SCENE)
    return model, tmp_path / "scene.xml"


def test_the_humanoid_comes_back(humanoid):
    model, path = humanoid
    back = load_robot(path)
    assert (back.name, back.base, back.joint_names) == ("walker", "floating", model.joint_names)
    assert back.mass == pytest.approx(model.mass, rel=1e-14)
    q, qd, tau = random_states(model, 5, 2)
    before, after = forward_dynamics(model, q, qd, tau), forward_dynamics(back, q, qd, tau)
    assert np.abs(after - before).max() < 1e-10 * np.abs(before).max()
    for ours, theirs in zip(back.joints, model.joints):
        assert (ours.lower, ours.upper) == pytest.approx((theirs.lower, theirs.upper), rel=1e-14)


def test_the_humanoids_servos_come_back(humanoid):
    model, path = humanoid
    ours, theirs = load_robot(path).servos["left_knee"], model.servos["left_knee"]
    for name in ("resistance", "inductance", "motor_constant", "voltage_limit", "current_limit", "current_slew"):
        assert getattr(ours, name) == getattr(theirs, name), name
    assert ours.speed_filter == pytest.approx(theirs.speed_filter, rel=1e-4)
    assert ours.gearbox == theirs.gearbox
    assert (ours.controller.law, ours.controller.Kp, ours.controller.period) == ("state", 61.0, 0.01)


def test_the_place_in_the_scene_is_a_keyframe(humanoid):
    q = load_robot(humanoid[1]).keyframes["scene"]
    assert q[:7] == pytest.approx((1, 0, 0.5, math.sqrt(0.5), 0, 0, math.sqrt(0.5)))


def test_a_robots_own_file_loads_without_a_scene(humanoid):
    assert load_robot(humanoid[1].with_name("walker.xml")).name == "walker"


@pytest.fixture
def arm(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM % "0")
    return tmp_path / "arm.xml"


def test_axes_turn_as_first_bodies_against_second_ones(arm):
    model = load_robot(arm)
    assert (model.base, model.root) == ("fixed", "world")
    assert model.joint_names == ("turn", "cardan", "cardan_2", "lift")
    assert [joint.axis for joint in model.moving_joints] == [(0, 0, 1), (0, -1, 0), (-1, 0, 0), (0, 0, -1)]
    assert [joint.type for joint in model.moving_joints] == ["continuous", "revolute", "continuous", "prismatic"]
    poses = forward_kinematics(model, [math.pi / 2, 0.0, 0.0, 0.1])
    ball = poses.position[[link.name for link in model.links].index("ball")]
    np.testing.assert_allclose(ball, (0, 0.4, 0.3), atol=1e-15)


def test_solids_are_uniform(arm):
    model = load_robot(arm)
    links = {link.name: link for link in model.links}
    assert links["boom"].inertia[0] == pytest.approx((0.4**2 + 0.02**2) / 12, rel=1e-14)  # turned a quarter about z
    assert links["ball"].inertia[5] == pytest.approx(0.4 * 0.5 * 0.03**2, rel=1e-14)
    assert links["post"].inertia[5] == pytest.approx(0.5 * 2 * 0.05**2, rel=1e-14)
    assert links["post"].center_of_mass == (0, 0, 0.2)
    assert [type(shape.geometry) for shape in model.shapes] == [Cylinder, Box, Sphere]


def test_controllers_count_in_seconds(arm):
    servos = load_robot(arm).servos
    law = servos["turn"].controller
    assert (law.law, law.Kp, law.period) == ("pid_position", 3.0, 0.02)
    assert (law.Ki, law.Kd) == (pytest.approx(0.5 / 0.02), pytest.approx(7 * 0.02))
    assert "cardan_2" not in servos  # its motor is off


def test_springs_are_read(arm):
    """Inherited from <default> too; `zeropos` is in degrees."""
    arm.write_text((ARM % "2").replace('<motor ri="2"', '<spring k="0.5" zeropos="90"/><motor ri="2"'))
    joints = {joint.name: joint for joint in load_robot(arm, strict=True).joints}
    assert [joints[name].stiffness for name in ("turn", "cardan", "lift")] == [0.5, 0.5, 2.0]
    assert joints["turn"].spring_reference == pytest.approx(math.pi / 2)
    assert joints["cardan_2"].stiffness == 0.0  # <spring2> is that of the second axis
    arm.write_text(ARM % "-2")
    with pytest.raises(RobotFileError, match="stiffness"):
        load_robot(arm)


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ('value="0.4"', 'value="bogus"', "no constant 'bogus'"),
        ('value="0.4"', 'value="__import__(1)"', "not an expression"),
        ('value="0.4"', 'value="9^9999"', "constant 'L' is '9\\^9999'"),
        ('B2="boom"', 'B2="bloom"', "no solid 'bloom'"),
        ('value="Universal"', 'value="Screw"', "type 'Screw'"),
        ('mode="pidposition"', 'mode="fuzzy"', "controller mode 'fuzzy'"),
        ("<sphere>", "<belt/><sphere>", "link name ''"),
        ('period="20"', 'period="0"', "period is 0 ms"),
        ('mass value="1"', 'mass value="-1"', "mass is -1.0"),
        ('B1="boom" B2="ball"', 'B1="post" B2="boom"', "cut the closed loop"),
    ],
)
def test_bad_scenes_are_refused_by_name(arm, old, new, word):
    arm.write_text((ARM % "0").replace(old, new, 1))
    with pytest.raises(RobotFileError, match=word) as error:
        load_robot(arm)
    assert "arm.xml" in str(error.value)


WRONG = (
    ('mass value="1"', 'mass value="-1"', "mass is -1.0"),
    ('<pos x="L" z="L"/></sphere>', '<pos x="L+" z="L"/></sphere>', "'L+'"),
    ('B2="world"', 'B2="moon"', "no solid 'moon'"),
    ('value="Universal"', 'value="Screw"', "type 'Screw'"),
    ('Min="-0.1"', 'Min="0.3"', "Min 0.3 m, Max 0.2 m"),
)


def made_wrong(text):
    """A text with all that is wrong in it, and the lines where the elements are."""
    where = []
    for old, new, _ in WRONG:
        assert text.count(old) == 1
        text = text.replace(old, new)
    for _, new, _ in WRONG:
        before = text[: text.index(new)]
        start = max(before.rindex(tag) for tag in ("<cuboid", "<sphere", "<joint") if tag in before)
        where.append(before[:start].count("\n") + 1)
    return text, where


def test_all_that_is_wrong_is_said_at_once_with_its_line(arm):
    text, lines = made_wrong(ARM % "0")
    arm.write_text(text)
    with pytest.raises(RobotFileError) as error:
        load_robot(arm)
    assert len(error.value.problems) == len(WRONG)
    for line, (_, _, word) in zip(lines, WRONG):
        assert any(word in text and text.startswith(f"line {line}: ") for text in error.value.problems), word


def test_lines_are_those_of_the_robots_file(humanoid):
    path = humanoid[1].with_name("walker.xml")
    path.write_text(path.read_text().replace("<joint>", "\n<joint>").replace("'Hinge'", "'Screw'", 1))
    with pytest.raises(RobotFileError, match=r"walker\.xml: line 2: .*type 'Screw'"):
        load_robot(humanoid[1])


def test_limits_are_quoted_as_the_file_has_them(arm):
    arm.write_text((ARM % "0").replace('Min="-30"', 'Min="60"'))
    with pytest.raises(RobotFileError, match=r"Min 60\.0 deg, Max 40\.0 deg"):
        load_robot(arm)


@pytest.mark.parametrize(("count", "word"), [(0, "has 0 robots"), (2, "has 2 robots")])
def test_a_scene_holds_one_robot(humanoid, count, word):
    path = humanoid[1]
    body = SCENE[SCENE.index("<robot>") : SCENE.index("</scene>")]
    path.write_text(SCENE.replace(body, body * count))
    with pytest.raises(RobotFileError, match=word):
        load_robot(path)


def test_a_scene_without_its_robots_file_says_so(humanoid):
    humanoid[1].with_name("walker.xml").unlink()
    with pytest.raises(RobotFileError, match=r"no file 'walker\.xml'"):
        load_robot(humanoid[1])
