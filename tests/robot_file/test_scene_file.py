"""Scenes of several models from MJCF and TOML, against what MuJoCo makes of them."""

import contextlib
import math
import random
import re
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from published import missing
from simtwo_scene import ARM as SIMTWO_ARM

from featherstone_gait import (
    Box,
    FloorLine,
    Ground,
    Link,
    Loop,
    Model,
    PairContact,
    Placed,
    RobotFileError,
    RobotFileWarning,
    SceneModel,
    Tendon,
    Via,
    Wrap,
    body,
    compile_scene,
    initial_state,
    inverse_dynamics,
    load_robot,
    load_scene,
    load_servo,
    mass_matrix,
    save_scene,
    simulate,
)
from featherstone_gait.base.rotation import rotation_from_quaternion, rotation_from_rpy
from featherstone_gait.model.shapes import Sphere

mujoco = pytest.importorskip("mujoco")

FREE = 0  # mjtJoint
IDLE = (1 << 0) | (1 << 4) | (1 << 11)  # <flag>: no constraints, contacts, drives
ARM = """
<body name="{0}/shoulder" pos="{1} 0.2 0.5" euler="10 20 30" gravcomp="0.3">
  <joint name="{0}/turn" axis="0 0 1" range="-90 90" damping="0.1" armature="0.01"/>
  <geom name="{0}/upper" type="capsule" fromto="0 0 0 0.3 0 0" size="0.03"/>
  <body name="{0}/fore" pos="0.3 0 0">
    <joint name="{0}/bend" axis="0 1 0" pos="0.01 0 0.02"/>
    <geom type="box" size="0.1 0.02 0.02" pos="0.1 0 0" friction="1.2"/>
  </body>
</body>
"""
SCENE = f"""
<mujoco model="bench">
  <option gravity="0 0.5 -9"/>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 1" pos="0 0 -0.1" euler="0 -5 0" friction="0.7"/>
    <geom name="pillar" type="cylinder" size="0.1 0.5" pos="1 1 0.5" euler="0 0 30"/>
    {ARM.format("left", 0)}
    {ARM.format("right", 1)}
    <body name="cup" pos="0.5 0 0.1" euler="0 0 45">
      <freejoint/>
      <geom type="sphere" size="0.05" mass="0.2"/>
      <geom type="box" size="0.05 0.02 0.01" pos="0 0.1 0" mass="0.1" contype="2" conaffinity="2"/>
    </body>
    <body name="table" pos="0 1 0">
      <geom type="box" size="0.4 0.4 0.01" pos="0 0 0.3"/>
      <body pos="0.4 0 0" euler="0 0 90"><geom type="sphere" size="0.02" pos="0 0.1 0"/></body>
    </body>
    <body name="bulb" pos="0 0 2"><geom type="sphere" size="0.1" contype="0" conaffinity="0"/></body>
  </worldbody>
  <contact>
    <exclude body1="left/fore" body2="right/fore"/>
    <pair geom1="pillar" geom2="left/upper"/>
  </contact>
  <actuator>
    <position joint="left/bend" kp="20"/>
    <motor joint="right/turn" gear="3" ctrllimited="true" ctrlrange="-1 1"/>
  </actuator>
  <equality><joint joint1="right/bend" joint2="right/turn" polycoef="0 0.5 0 0 0"/></equality>
  <keyframe><key name="home" qpos="0.1 0.2 0.3 0.4 0.5 0.6 0.7 0 1 0 0"/></keyframe>
</mujoco>
"""
TOML = """
gravity = [0.0, 0.0, -9.0]
excluded = [["left/base", "cup/body"]]

[ground]
friction = 0.8
steps = [[0.5, 0.02]]
lines = [{points = [[0.0, 0.0], [1.0, 0.0]], width = 0.03}]

[[robots]]
file = "arm7"
name = "left"
position = [0.0, 0.3, 0.0]
rpy = [0.0, 0.0, 1.5]
gearbox = "none"

[[robots]]
file = "ax12_arm"
orientation = [1, 0, 0, 1]
ground_contact = false
[robots.servos]
default = "ax12a"

[[objects]]
name = "cup"
shape = "cylinder"
radius = 0.04
length = 0.1
mass = 0.2
friction = 0.5

[[obstacles]]
name = "table"
shape = "box"
size = [0.8, 0.8, 0.02]
position = [0.5, 0.0, 0.7]
"""


def written(tmp_path, text, name="scene.xml"):
    (tmp_path / name).write_text(text, encoding="utf-8")
    return tmp_path / name


def quiet(path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RobotFileWarning)
        return load_scene(path)


def in_mujoco(path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return mujoco.MjSpec.from_file(str(path)).compile()


def assert_moves_as_in_mujoco(path, scene, tolerance=1e-10):
    """Mass matrix and bias forces of each member are its block of MuJoCo's, in the first keyframe."""
    m = in_mujoco(path)
    m.opt.disableflags |= IDLE
    m.opt.density = m.opt.viscosity = 0.0
    if hasattr(m, "actuator_armature"):
        m.actuator_armature[:] = 0.0  # rotors, which belong to servos here
    data = mujoco.MjData(m)
    data.qvel[:] = np.random.default_rng(1).normal(size=m.nv)
    if m.nkey:
        data.qpos[:] = m.key_qpos[0]
    mujoco.mj_forward(m, data)
    M, unit = np.zeros((m.nv, m.nv)), np.eye(m.nv)
    for k in range(m.nv):
        mujoco.mj_mulM(m, data, M[k], unit[k])
    tops = sorted({int(b) for b in m.body_rootid[m.dof_bodyid]})
    assert len(tops) == len(scene.members)
    for top, placed in zip(tops, scene.members):
        model, own = placed.model, np.flatnonzero(m.body_rootid[m.dof_bodyid] == top)
        joints = np.flatnonzero(m.body_rootid[m.jnt_bodyid] == top)
        q = np.concatenate([data.qpos[m.jnt_qposadr[j] :][: 7 if m.jnt_type[j] == FREE else 1] for j in joints])
        if m.nkey:
            assert next(iter(model.keyframes.values())) == pytest.approx(q, abs=1e-15)
        armature = np.array([joint.armature for joint in model.moving_joints])
        here = M[np.ix_(own, own)] - np.diag([*m.dof_armature[own[: len(own) - len(armature)]], *(0.0 * armature)])
        assert mass_matrix(model, q, armature=armature) == pytest.approx(here, abs=tolerance)
        fixed = rotation_from_quaternion(placed.orientation) if model.base == "fixed" else np.eye(3)
        still, slack = np.zeros(len(own)), np.zeros(len(armature))
        gravity = tuple(fixed.T @ scene.gravity)
        bias = inverse_dynamics(model, q, data.qvel[own], still, armature=armature, stiffness=slack, gravity=gravity)
        assert bias == pytest.approx((data.qfrc_bias - data.qfrc_gravcomp)[own], abs=tolerance)


@pytest.fixture
def bench(tmp_path):
    return quiet(written(tmp_path, SCENE))


def test_each_tree_moves_as_in_mujoco(tmp_path):
    path = written(tmp_path, re.sub("<equality>.*</equality>", "", SCENE))
    assert_moves_as_in_mujoco(path, quiet(path))


def test_names_places_and_what_is_still(bench):
    assert [placed.name for placed in bench.members] == ["left", "right", "cup"]
    assert [joint.name for joint in bench.member("right").model.moving_joints] == ["turn", "bend"]
    assert bench.member("right").position == (1.0, 0.2, 0.5)
    assert bench.member("cup").orientation == pytest.approx((np.cos(np.pi / 8), 0.0, 0.0, np.sin(np.pi / 8)))
    assert {placed.name: len(placed.model.shapes) for placed in bench.obstacles} == {"table": 2, "pillar": 1}
    far = bench.member("table").model.shapes[1]
    assert far.xyz == pytest.approx((0.3, 0.0, 0.0), abs=1e-15)
    assert bench.gravity == (0.0, 0.5, -9.0)
    assert bench.member("left").model.keyframes["home"] == (0.1, 0.2)


def test_drives_and_couplings_stay_with_their_tree(bench):
    left, right = bench.member("left").model, bench.member("right").model
    assert list(left.servos) == ["bend"]
    assert not right.servos
    assert right.joint("turn").effort == 3.0
    assert right.joint("bend").mimic.joint == "turn"


def test_what_acts_between_trees_is_told_by_name_and_refused_by_strict(tmp_path):
    slide = '<joint name="j{0}" type="slide"/><geom size=".05" contype="0" conaffinity="0"/><site name="s{0}"/>'
    bodies = "".join(f'<body name="{x}">{slide.format(x)}</body>' for x in "abc")
    a, b, c = (f'<joint joint="j{x}" coef="1"/>' for x in "abc")
    fixed = {"sum": a + b, "other": c, "pulled": a + c}
    tendons = "".join(f'<fixed name="{name}">{joints}</fixed>' for name, joints in fixed.items())
    for name, more in {
        "cable": '<tendon><spatial name="cable" range="0 1"><site site="sa"/><site site="sb"/></spatial></tendon>',
        "tie": f'<tendon>{tendons}</tendon><equality><tendon name="tie" tendon1="sum" tendon2="other"/></equality>',
        "winch": f'<tendon>{tendons}</tendon><actuator><motor name="winch" tendon="pulled"/></actuator>',
    }.items():
        path = tmp_path / f"{name}.xml"
        path.write_text(f"<mujoco><worldbody>{bodies}</worldbody>{more}</mujoco>")
        with pytest.warns(RobotFileWarning, match=f"ignored .*'{name}'"):
            scene = load_scene(path)
        assert not any(one.startswith("took") and name in one for one in scene.notes)
        with pytest.raises(RobotFileError, match=f"'{name}'"):
            load_scene(path, strict=True)


def test_the_plane_is_the_ground_with_the_larger_friction_of_two(bench):
    ground = bench.ground
    assert (ground.friction, ground.height) == (0.7, -0.1)
    assert (ground.slope, ground.heading) == pytest.approx((np.radians(5.0), 0.0), abs=1e-12)
    fore = {point.friction for point in bench.member("left").model.contacts if point.link == "fore"}
    assert fore == {1.2}
    assert len(bench.member("cup").model.contacts) == 1
    assert len(bench.member("cup").model.shapes) == 2


def test_a_plane_on_which_nothing_presses_is_no_ground(tmp_path):
    scene = quiet(written(tmp_path, SCENE.replace("0 0.5 -9", "0 0 0")))
    assert scene.ground is None
    assert scene.gravity == (0.0, 0.0, 0.0)
    assert any("ground" in note for note in scene.notes)


def test_links_that_never_touch_are_listed(bench):
    pairs = {frozenset(pair) for pair in bench.excluded}
    assert {"left/fore", "right/fore"} in pairs
    assert not {frozenset(("left/shoulder", "pillar/body")), frozenset(("cup/cup", "pillar/body"))} & pairs
    pointed = {f"{placed.name}/{point.link}" for placed in bench.members for point in placed.model.contacts}
    shaped = {f"{placed.name}/{shape.link}" for placed in bench.members for shape in placed.model.shapes}
    assert {link for pair in pairs if "ground" in pair for link in pair} - {"ground"} == shaped - pointed
    assert bench.pairs == "none"


def test_what_touches_is_what_touches_in_mujoco(tmp_path):
    """Whose margins are so wide that all contacts are there that its filters let through."""
    path = written(tmp_path, SCENE)
    m = in_mujoco(path)
    m.geom_margin[:] = m.pair_margin[:] = m.body_margin[:] = 100.0
    data = mujoco.MjData(m)
    mujoco.mj_forward(m, data)

    def owner(g):
        b = int(m.geom_bodyid[g])
        if m.geom(g).name == "floor":
            return "ground"
        if not m.body_weldid[b]:
            top = int(m.body_rootid[b])
            return f"{m.body(top).name if top else m.geom(g).name}/body"
        return m.body(b).name if "/" in m.body(b).name else f"{m.body(b).name}/{m.body(b).name}"

    theirs = {frozenset((owner(one.geom1), owner(one.geom2))) for one in data.contact}
    scene = quiet(path)
    compiled = compile_scene(scene, pairs="all")
    ours = {frozenset(pair) for pair in compiled.pairs}
    by_points = {frozenset((f"{p.name}/{c.link}", "ground")) for p in scene.members for c in p.model.contacts}
    assert len(theirs) > 15
    assert ours | by_points == theirs
    assert any('pairs="all"' in note for note in scene.notes)


def test_load_robot_names_load_scene_for_what_it_leaves_out(tmp_path):
    with pytest.warns(RobotFileWarning, match="load_scene"):
        load_robot(written(tmp_path, SCENE.replace("<equality>", "<!--").replace("</equality>", "-->")))


def test_a_toml_file_names_robots_objects_and_obstacles(tmp_path):
    scene = load_scene(written(tmp_path, TOML, "kitchen.toml"))
    assert scene.name == "kitchen"
    left, other, cup = scene.members
    assert (left.gearbox, other.gearbox, other.name) == (None, "scene", "ax12_arm")
    assert left.orientation == pytest.approx((np.cos(0.75), 0.0, 0.0, np.sin(0.75)), abs=1e-15)
    assert not other.ground_contact
    assert {servo.gearbox for servo in other.model.servos.values()} == {load_servo("ax12a").gearbox}
    assert cup.model.mass == 0.2
    assert scene.obstacles[0].model.shapes[0].geometry == Box((0.8, 0.8, 0.02))
    lines = (FloorLine(((0.0, 0.0), (1.0, 0.0)), 0.03),)
    assert scene.ground == Ground(0.8, steps=((0.5, 0.02),), lines=lines)
    assert scene.excluded == (("left/base", "cup/body"),)


@pytest.mark.parametrize(
    ("line", "pairs"),
    [
        ('pairs = "all"', "all"),
        ('pairs = [["cup", "table"], ["left/base", "table"]]', (("cup", "table"), ("left/base", "table"))),
        (
            'pairs.select = [["cup", "table"]]\npairs.penetration = 1e-4\npairs.load = 2\npairs.max_points = 9',
            PairContact([("cup", "table")], penetration=1e-4, load=2.0, max_points=9),
        ),
    ],
)
def test_a_toml_file_says_what_touches_what(tmp_path, line, pairs):
    assert load_scene(written(tmp_path, f"{line}\n{TOML}", "kitchen.toml")).pairs == pairs
    assert load_scene(written(tmp_path, TOML, "kitchen.toml")).pairs == "none"


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ('pairs = "some"', ["line 1", "'some'", '"all"']),
        ('pairs = [["cup"]]', ["line 1", "['cup']", "pairs of names"]),
        ('pairs = [["cup", "tabel"]]', ["'tabel'", "'table'"]),
        ("pairs = 3", ["line 1", "3", "pairs of names"]),
        ("pairs.penetration = -1", ["line 1", "penetration", "-1", "> 0"]),
        ("pairs.max_points = 1.5", ["line 1", "max_points", "1.5", "whole number"]),
        ("pairs.stiffness = 1", ["line 1", "'stiffness'", "penetration"]),
    ],
)
def test_pairs_that_are_none_are_refused_by_line(tmp_path, line, says):
    with pytest.raises(ValueError, match=r"kitchen\.toml: ") as error:
        load_scene(written(tmp_path, f"{line}\n{TOML}", "kitchen.toml"))
    assert all(word in str(error.value) for word in says), str(error.value)


def test_angles_that_are_not_finite_are_refused_by_line(tmp_path):
    with pytest.raises(ValueError, match=r"robots\[0\]: rpy is \[0\.0, 0\.0, inf\].*roll"):
        load_scene(written(tmp_path, TOML.replace("1.5]", "inf]"), "kitchen.toml"))


SIMTWO = """
<scene>
  <robot><ID name="one"/><pos x="1" y="0" z="0.5"/><rot_deg x="0" y="0" z="90"/><body file="arm.xml"/></robot>
  <robot><ID name="two"/><pos x="-1" y="0" z="0.5"/><body file="arm.xml"/></robot>
  <things file="things.xml"/>
  <obstacle><ID name="shelf"/><pos x="0" y="5" z="0"/><rot_deg x="0" y="0" z="90"/><body file="boards.xml"/></obstacle>
  <obstacles>
    <cuboid><ID value="wall"/><size x="1" y="0.1" z="1"/><pos x="3" y="0" z="0.5"/></cuboid>
  </obstacles>
</scene>
"""
THINGS = """
<things>
  <defines><const name="r" value="0.1"/></defines>
  <sphere><ID value="ball"/><mass value="0.3"/><size radius="r"/><pos x="0" y="2" z="r"/></sphere>
</things>
"""
BOARDS = """
<obstacles>
  <cuboid><ID value="board"/><size x="1" y="0.2" z="0.02"/><pos x="0.5" y="0" z="0.3"/></cuboid>
  <cuboid><ID value="board"/><size x="1" y="0.2" z="0.02"/><pos x="0.5" y="0" z="0.6"/></cuboid>
</obstacles>
"""


def test_a_scene_of_simtwo_has_all_of_its_robots_things_and_obstacles(tmp_path):
    written(tmp_path, SIMTWO_ARM % "0", "arm.xml")
    written(tmp_path, THINGS, "things.xml")
    written(tmp_path, BOARDS, "boards.xml")
    scene = quiet(written(tmp_path, SIMTWO))
    assert [placed.name for placed in scene.all] == ["one", "two", "ball", "wall", "shelf_board", "shelf_board_2"]
    assert scene.member("shelf_board").position == pytest.approx((0.0, 5.5, 0.3))
    assert scene.member("shelf_board").orientation == pytest.approx((0.5**0.5, 0.0, 0.0, 0.5**0.5))
    assert scene.member("two").position == (-1.0, 0.0, 0.5)
    assert scene.member("one").orientation == pytest.approx((0.5**0.5, 0.0, 0.0, 0.5**0.5))
    assert scene.member("one").model.links == load_robot(tmp_path / "arm.xml").links
    ball = scene.member("ball").model
    assert (ball.mass, ball.shapes[0].geometry) == (0.3, Sphere(0.1))
    assert ball.links[0].inertia[0] == pytest.approx(0.4 * 0.3 * 0.01)
    assert scene.ground == Ground()
    with pytest.raises(ValueError, match="load_scene"):
        load_robot(tmp_path / "scene.xml")
    attack(tmp_path, SIMTWO, "scene.xml", 30, seed=4)
    for wrong in ('value=""', 'value="wall"/><mass value="x"'):
        with pytest.raises(ValueError, match=r"scene\.xml: line 8"):
            quiet(written(tmp_path, SIMTWO.replace('value="wall"', wrong)))
    (tmp_path / "things.xml").unlink()
    with pytest.warns(RobotFileWarning, match=r"things\.xml"):
        scene = load_scene(written(tmp_path, SIMTWO))
    assert "ball" not in [placed.name for placed in scene.all]
    with pytest.raises(ValueError, match=r"things\.xml"):
        load_scene(tmp_path / "scene.xml", strict=True)


# ---------------------------------------------------------------------------------------------- saving


def assert_alike(one, two):
    """Two scenes move alike and touch the same."""
    assert [placed.name for placed in one.all] == [placed.name for placed in two.all]
    assert (one.name, one.gravity) == (two.name, two.gravity)
    assert {*map(frozenset, one.excluded)} == {*map(frozenset, two.excluded)}
    assert (one.ground is None) == (two.ground is None)
    if one.ground is not None and one.ground.field is None:
        fields = ("friction", "height", "slope", "heading")
        assert [getattr(one.ground, x) for x in fields] == pytest.approx([getattr(two.ground, x) for x in fields])
    for a, b in zip(one.all, two.all):
        assert (a.position, a.orientation) == (pytest.approx(b.position), pytest.approx(b.orientation))
        assert [x.name for x in a.model.links if x.mass] == [x.name for x in b.model.links if x.mass]
        assert a.model.joint_names == b.model.joint_names
        assert len(a.model.shapes) == len(b.model.shapes)
        points = [
            sorted((p.link, p.friction or -1.0, *np.round(p.position, 7)) for p in x.model.contacts) for x in (a, b)
        ]
        assert [x[:2] for x in points[0]] == [x[:2] for x in points[1]]
        assert np.array([x[2:] for x in points[0]]) == pytest.approx(np.array([x[2:] for x in points[1]]), abs=1e-6)


def test_a_saved_scene_moves_and_touches_as_before(tmp_path):
    scene = quiet(written(tmp_path, re.sub("<equality>.*</equality>", "", SCENE)))
    save_scene(scene, tmp_path / "saved.xml")
    again = quiet(tmp_path / "saved.xml")
    assert_alike(scene, again)
    assert_moves_as_in_mujoco(tmp_path / "saved.xml", again)
    assert_moves_as_in_mujoco(tmp_path / "saved.xml", scene)


def test_a_long_tail_with_tendons_comes_back_by_its_names(tmp_path):
    n = 80
    inside = "".join(
        f'<body pos=".1 0 0"><joint name="j{k}" axis="0 1 0"/><geom size=".01"/><site name="s{k}"/>' for k in range(n)
    )
    tendon = '<spatial name="string" stiffness="3"><site site="s0"/><site site="s79"/></spatial>'
    text = f"<mujoco><worldbody>{inside}{'</body>' * n}</worldbody><tendon>{tendon}</tendon></mujoco>"
    scene = quiet(written(tmp_path, text))
    for _ in range(2):
        save_scene(scene, tmp_path / "saved.xml")
        scene = quiet(tmp_path / "saved.xml")
    assert [tendon.name for tendon in scene.members[0].model.tendons] == ["string"]
    assert len(scene.members[0].model.joint_names) == n


def test_a_scene_of_toml_is_saved_as_mjcf(tmp_path):
    scene = load_scene(written(tmp_path, TOML, "kitchen.toml"))
    save_scene(scene, tmp_path / "saved.xml")
    again = quiet(tmp_path / "saved.xml")
    assert [placed.name for placed in again.all] == ["left", "ax12_arm", "cup", "table"]
    assert_moves_as_in_mujoco(tmp_path / "saved.xml", again)
    assert again.excluded[:1] == scene.excluded[:1] or not scene.member("left").model.shapes
    with pytest.raises(ValueError, match=r"\.xml"):
        save_scene(scene, tmp_path / "saved.toml")


@pytest.mark.parametrize(
    "pairs",
    [
        "none",
        "all",
        (("ball", "wall"), ("ball/body", "ground")),
        PairContact("all", penetration=1e-4, damping_ratio=0.3, friction=0.2, rolling_friction=1e-3, max_points=40),
        PairContact((("ball", "wall/body"),), load=2.0),
    ],
)
def test_what_touches_what_is_saved_and_read(tmp_path, pairs):
    ball = body(Sphere(0.1), 1.0, name="ball", torsional_friction=2e-3, rolling_friction=1e-4)
    wall = body(Box((0.1, 1.0, 1.0)), name="wall", base="fixed", torsional_friction=3e-3)
    members = [Placed(ball, position=(0.0, 0.0, 0.1))]
    scene = SceneModel("one", members, [Placed(wall, position=(1.0, 0.0, 0.5))], Ground(), pairs=pairs)
    save_scene(scene, tmp_path / "one.xml")
    again = load_scene(tmp_path / "one.xml")
    assert again.pairs == scene.pairs
    found = [again.member(name).model.shapes[0] for name in ("ball", "wall")]
    assert [(one.torsional_friction, one.rolling_friction) for one in found] == [(2e-3, 1e-4), (3e-3, None)]


@pytest.mark.parametrize("data", ["all", '{"select": 3}', '{"of": 1}', "[1]"])
def test_what_touches_what_is_refused_if_it_is_none(tmp_path, data):
    ball = Placed(body(Sphere(0.1), 1.0), position=(0.0, 0.0, 1.0))
    save_scene(SceneModel("one", [ball], pairs="all"), tmp_path / "a.xml")
    text = (tmp_path / "a.xml").read_text()
    changed = re.sub('data=".*?"', f"data='{data}'", text)
    assert changed != text
    (tmp_path / "a.xml").write_text(changed)
    with pytest.raises(RobotFileError, match="PairContact"):
        load_scene(tmp_path / "a.xml")


@pytest.mark.parametrize(
    ("condim", "moments"), [(1, (None, None)), (3, (None, None)), (4, (0.02, None)), (6, (0.02, 0.003))]
)
def test_condim_says_which_frictions_of_a_geom_count(tmp_path, condim, moments):
    geom = f'<geom type="sphere" size="0.1" friction="0.8 0.02 0.003" condim="{condim}"/>'
    (tmp_path / "a.xml").write_text(f"<mujoco><worldbody><body><freejoint/>{geom}</body></worldbody></mujoco>")
    (shape,) = load_scene(tmp_path / "a.xml").members[0].model.shapes
    assert (shape.torsional_friction, shape.rolling_friction) == moments


def test_an_ellipsoid_is_a_hull_whose_error_is_told(tmp_path):
    """Supports of the hull lie within 4.03 % of those of the ellipsoid, on either side."""
    geom = '<geom name="egg" type="ellipsoid" size="0.1 0.2 0.3"/>'
    (tmp_path / "a.xml").write_text(f"<mujoco><worldbody><body><freejoint/>{geom}</body></worldbody></mujoco>")
    with pytest.warns(RobotFileWarning, match=r"ellipsoids as hulls of 32 corners.*'egg' 0\.0121 m"):
        scene = load_scene(tmp_path / "a.xml")
    (shape,) = scene.members[0].model.shapes
    for load in (load_scene, load_robot):
        with pytest.raises(RobotFileError, match=r"'egg' 0\.0121 m"):
            load(tmp_path / "a.xml", strict=True)
    u = np.random.default_rng(0).normal(size=(5000, 3))
    ratio = (u @ np.array(shape.geometry.points).T).max(axis=1) / np.linalg.norm(u * [0.1, 0.2, 0.3], axis=1)
    assert 1.0 - 0.0403 < ratio.min() < 0.97
    assert 1.03 < ratio.max() <= 1.0403 + 1e-12
    error = (ratio - 1.0) * np.linalg.norm(u * [0.1, 0.2, 0.3], axis=1) / np.linalg.norm(u, axis=1)
    assert 0.01 < np.abs(error).max() < 0.0121


def test_an_ellipsoid_that_touches_nothing_or_is_a_ball_is_no_approximation(tmp_path):
    egg, ball = (f'<geom name="{size[1]}" type="ellipsoid" size="{size}"' for size in (".1 .2 .3", ".2 .2 .2"))
    inside = f'{egg} contype="0" conaffinity="0"/>{ball}/>'
    (tmp_path / "a.xml").write_text(f"<mujoco><worldbody><body><freejoint/>{inside}</body></worldbody></mujoco>")
    assert [shape.geometry for shape in load_robot(tmp_path / "a.xml", strict=True).shapes] == [Sphere(0.2)]
    scene = load_scene(tmp_path / "a.xml", strict=True)
    assert [shape.geometry for shape in scene.members[0].model.shapes] == [Sphere(0.2)]


def test_saved_links_without_contact_points_touch_the_ground_where_bodies_touch(tmp_path):
    robot = load_robot("humanoid")
    pointed, shaped = {point.link for point in robot.contacts}, {shape.link for shape in robot.shapes}
    placed, out = [Placed(robot, "one")], [("one/left_forearm", "ground")]
    for pairs, low in (("none", pointed), ("all", shaped - {"left_forearm"})):
        save_scene(SceneModel("x", placed, ground=Ground(), excluded=out, pairs=pairs), tmp_path / "saved.xml")
        again = quiet(tmp_path / "saved.xml").member("one").model
        assert {point.link for point in again.contacts} == low


@pytest.mark.parametrize("root", ["trunk", "world"])
def test_what_a_floating_robot_has_in_the_world_is_saved_in_the_world_of_the_scene(tmp_path, root):
    """A tendon and a rod from the world to a robot at a place of its own, in coordinates of the scene."""
    trunk = Link(root, 1.0, inertia=(0.01, 0.0, 0.0, 0.01, 0.0, 0.01))
    around = Wrap(None, "sphere", 0.1, (9.0, 9.0, 9.0), side=(9.5, 9.0, 9.0))
    path = Via(None, (0.3, 0.1, 3.0)), around, Via(root, (0.1, 0.0, 0.0))
    rod = Loop("rod", "distance", root, None, point_b=(0.0, 0.0, 2.0), distance=1.0)
    robot = Model("kite", (trunk,), (), "floating", tendons=(Tendon("rope", path=path, stiffness=40.0),), loops=(rod,))
    scene = SceneModel("x", [Placed(robot, "kite", (0.2, 0.0, 1.0), (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)))])
    save_scene(scene, tmp_path / "saved.xml")
    m = mujoco.MjModel.from_xml_path(str(tmp_path / "saved.xml"))
    d = mujoco.MjData(m)
    mujoco.mj_forward(m, d)
    at = {m.tendon(k).name: d.ten_length[k] for k in range(m.ntendon)}
    rope, rod = math.dist((0.3, 0.1, 3.0), (0.2, 0.1, 1.0)), math.dist((0.0, 0.0, 2.0), (0.2, 0.0, 1.0))
    assert at == {"kite/rope": pytest.approx(rope, abs=1e-12), "kite/rod": pytest.approx(rod, abs=1e-12)}
    (again,) = quiet(tmp_path / "saved.xml").members
    assert again.model.base == "floating"
    assert [via.link is None for via in again.model.tendons[0].path] == [True, True, False]
    assert again.model.tendons[0].path[0].point == pytest.approx((0.3, 0.1, 3.0))


# ---------------------------------------------------------------------------------------------- attacks

VALUES = (
    "",
    "x",
    "nan",
    "inf",
    "-1",
    "0",
    "1e300",
    "0 0",
    "1 2 3 4 5 6 7 8",
    "true",
    "left/turn",
    "mesh",
    "%s",
    "[]",
    "''",
)


def mutated(text, random):
    """Damage a text: change a value or a number, remove or repeat a line, cut the rest off."""
    kind = random.randrange(5)
    if kind <= 1:
        spots = [*re.finditer(r'"[^"]*"' if kind else r"[-\d.]+", text)]
        spot = random.choice(spots)
        value = random.choice(VALUES)
        return text[: spot.start()] + (f'"{value}"' if kind else value or "1e999") + text[spot.end() :]
    lines = text.splitlines(keepends=True)
    k = random.randrange(len(lines))
    if kind == 2:
        return "".join(lines[:k] + lines[k + 1 :])
    if kind == 3:
        return "".join(lines[: k + 1] + lines[k:])
    at = random.randrange(len(text))
    return (
        text[:at]
        + random.choice(["", '"', "<", "=", "[", "\0", "\u00e9", "<body>", "</body>"])
        + text[at + random.randrange(9) :]
    )


def attack(tmp_path, text, name, count, seed):
    """Load damaged files; each is read, or refused with the name of a file.  What is read compiles, or is refused."""
    draws, refused = random.Random(seed), 0
    for _ in range(count):
        damaged = mutated(text, draws)
        for _ in range(draws.randrange(3)):
            damaged = mutated(damaged, draws)
        path = written(tmp_path, damaged, name)
        scene, message = None, str(tmp_path)
        try:
            scene = quiet(path)
        except ValueError as error:
            refused += 1
            message = str(error)
        assert str(tmp_path) in message, damaged
        if scene is not None:
            with contextlib.suppress(ValueError):
                compile_scene(scene, None, pairs="all" if scene.pairs == "none" else None)
    return refused


TOUCHING = f"""pairs.select = [["cup", "table"], ["left", "cup"]]
pairs.penetration = 1e-3
pairs.max_points = 40
{TOML}"""
STACK = """
pairs = {select = "all", penetration = 1e-4, damping_ratio = 0.5, friction = 0.3, rolling_friction = 1e-4, load = 2.0}
excluded = [["ball/body", "table/body"], ["egg/body", "ground"]]
[ground]
friction = 0.8
slope = 0.1
[[objects]]
name = "ball"
shape = "sphere"
radius = 0.1
mass = 0.5
torsional_friction = 1e-3
position = [0.0, 0.0, 0.6]
[[objects]]
name = "egg"
shape = "hull"
points = [[0.1, 0.0, 0.0], [-0.1, 0.05, 0.0], [0.0, -0.1, 0.02], [0.0, 0.0, 0.15]]
mass = 0.2
friction = 0.5
position = [0.0, 0.3, 0.8]
[[objects]]
name = "rod"
shape = "capsule"
radius = 0.02
length = 0.3
mass = 0.1
rpy = [0.0, 1.57, 0.0]
position = [0.3, 0.0, 0.7]
[[obstacles]]
name = "table"
shape = "box"
size = [0.8, 0.8, 0.02]
position = [0.0, 0.0, 0.4]
rolling_friction = 1e-3
"""
PILE = """
<mujoco model="pile">
  <custom><text name="featherstone_gait_pairs" data='{"select": "all", "load": 2.0}'/></custom>
  <asset>
    <hfield name="hills" nrow="3" ncol="4" size="1 1 0.2 0.1" elevation="0 1 0 1 1 0 1 0 0 1 1 0"/>
    <mesh name="wedge" vertex="0 0 0 0.2 0 0 0 0.2 0 0 0 0.2"/>
  </asset>
  <worldbody>
    <geom name="land" type="hfield" hfield="hills" friction="0.7 0.01 0.002" condim="4"/>
    <geom name="shelf" type="box" size="0.3 0.3 0.01" pos="0 0 0.6" solref="0.01 1" solimp="0.9 0.95 0.001"/>
    <body name="ball" pos="0 0 0.8">
      <freejoint/><geom type="sphere" size="0.1" condim="6" friction="0.9 0.02 0.003"/>
    </body>
    <body name="egg" pos="0.3 0 0.9">
      <freejoint/><geom type="ellipsoid" size="0.1 0.1 0.15" condim="1" mass="0.2"/>
    </body>
    <body name="block" pos="0 0.4 0.7">
      <freejoint/>
      <geom type="mesh" mesh="wedge" priority="1"/>
      <body pos="0 0 0.3">
        <joint axis="1 0 0" range="-1 1" limited="true"/>
        <geom type="capsule" size="0.02" fromto="0 0 0 0 0 0.2" margin="0.001" gap="0.001"/>
      </body>
    </body>
  </worldbody>
  <contact>
    <exclude body1="ball" body2="egg"/>
    <pair geom1="shelf" geom2="land" friction="1 1 0.1 0.1 0.1" condim="3"/>
  </contact>
</mujoco>
"""
SEEDS = {"scene.xml": SCENE, "scene.toml": TOUCHING, "pile.xml": PILE, "stack.toml": STACK}


@pytest.mark.parametrize("name", SEEDS)
def test_damaged_files_are_refused_or_read(tmp_path, name):
    assert attack(tmp_path, SEEDS[name], name, 40, seed=1) > 10


@pytest.mark.long
@pytest.mark.parametrize("name", SEEDS)
def test_many_damaged_files_are_refused_or_read(tmp_path, name):
    assert attack(tmp_path, SEEDS[name], name, 1500, seed=2) > 500


# ---------------------------------------------------------------------------------------------- published files

FOLDERS = [Path(folder) / package for folder in sys.path for package in ("gymnasium", "dm_control", "pybullet_data")]
LOOPS = ("quadruped.xml",)  # whose equalities bind three joints: springs of another softness than in MuJoCo


def published():
    """Files of installed packages that have several trees."""
    for path in sorted(path for folder in FOLDERS for path in folder.rglob("*.xml")):
        try:
            m = in_mujoco(path)
        except (ValueError, RuntimeError):
            continue
        if len({*m.body_rootid[m.dof_bodyid].tolist()}) > 1 and path.name not in LOOPS:
            yield path


@pytest.mark.long
def test_published_scenes_move_as_in_mujoco(tmp_path):
    paths = [*published()]
    if not paths:
        missing("any of gymnasium, dm_control and pybullet")
    for path in paths:
        scene = quiet(path)
        assert_moves_as_in_mujoco(path, scene)
        save_scene(scene, tmp_path / "saved.xml")
        again = quiet(tmp_path / "saved.xml")
        assert_alike(scene, again)
        assert_moves_as_in_mujoco(tmp_path / "saved.xml", again)


# ------------------------------------------------------------------------------------------------ planes and remedies


WALLS = """<mujoco><worldbody><geom name="floor" type="plane" size="0 0 1"/>
<geom name="wall" type="plane" size="0 0 1" pos="1 0 0" zaxis="-1 0 0"/>
<body name="hall" pos="0 0 2" euler="0 30 0"><geom name="roof" type="plane" size="1 1 1" pos="0.1 0.2 0.3"/></body>
<body name="ball" pos="0.5 0 0.1"><freejoint/><geom size="0.1" mass="1"/></body></worldbody></mujoco>"""


def test_planes_beside_the_ground_are_boxes_with_a_warning_that_names_them(tmp_path):
    path = written(tmp_path, WALLS)
    with pytest.warns(RobotFileWarning, match="took planes 'wall', 'roof', which are not the ground, as boxes"):
        scene = load_scene(path)
    with pytest.raises(RobotFileError, match="write boxes"):
        load_scene(path, strict=True)
    assert scene.ground is not None
    m = in_mujoco(path)
    d = mujoco.MjData(m)
    mujoco.mj_forward(m, d)
    assert len(scene.obstacles) == 2
    for placed in scene.obstacles:
        (shape,) = placed.model.shapes
        turn = rotation_from_quaternion(np.array(placed.orientation))
        face = np.array(shape.xyz) + rotation_from_rpy(shape.rpy) @ (0.0, 0.0, 0.5 * shape.geometry.size[2])
        g = m.geom(shape.name).id
        np.testing.assert_allclose(turn @ face + placed.position, d.geom_xpos[g], atol=1e-12)
        np.testing.assert_allclose(turn @ rotation_from_rpy(shape.rpy), d.geom_xmat[g].reshape(3, 3), atol=1e-12)


@pytest.mark.long
def test_a_ball_does_not_pass_a_wall_that_is_a_plane(tmp_path):
    scene = compile_scene(quiet(written(tmp_path, re.sub('<body name="hall".*?</body>', "", WALLS))), pairs="all")
    run = simulate(scene, 0.4, initial_state(scene, qd={"ball": [2.0, 0.0, 0.0, 0.0, 0.0, 0.0]}))
    assert run.ok
    assert 0.9 < run["base_q"][:, 0].max() < 0.905


@pytest.mark.parametrize(
    ("inside", "says"),
    [
        ("", "it is empty"),
        ('<geom type="plane" size="1 1 1"/><geom size="0.1"/>', "its 2 geoms are ground and obstacles alone"),
        ('<body><geom size="0.1"/></body>', "its 1 geoms are"),
    ],
)
def test_a_world_in_which_nothing_moves_is_refused_with_a_remedy_that_works(tmp_path, inside, says):
    path = written(tmp_path, f"<mujoco><worldbody>{inside}</worldbody></mujoco>")
    with pytest.raises(RobotFileError, match=f"nothing in the file can move, {says}.*freejoint") as refused:
        load_scene(path)
    (remedy,) = re.findall("<body>.*</body>", str(refused.value))
    assert len(load_scene(written(tmp_path, f"<mujoco><worldbody>{inside}{remedy}</worldbody></mujoco>")).members) == 1


SLIDE = """<mujoco><worldbody><geom type="plane" size="5 5 1"/>
<body pos="0 0 0.5"><joint type="slide" axis="0 0 1"/><geom size="0.1" mass="1"/></body></worldbody></mujoco>"""


@pytest.mark.parametrize("text", [SLIDE, SLIDE.replace('<joint type="slide" axis="0 0 1"/>', "<freejoint/>")])
def test_the_remedy_for_missing_contact_points_works(tmp_path, text):
    model = load_robot(written(tmp_path, text))
    with pytest.raises(ValueError, match="without contact points") as refused:
        compile_scene(model, ground=Ground())
    (choice,) = re.findall("contacts='([a-z]+)'", str(refused.value))
    assert compile_scene(load_robot(tmp_path / "scene.xml", contacts=choice), ground=Ground())
    assert compile_scene(model, ground=None)
    with pytest.raises(ValueError, match="or collision shapes to its file"):
        compile_scene(replace(model, shapes=()), ground=Ground())


def test_the_remedy_for_feet_that_are_not_found_works(tmp_path):
    with pytest.raises(RobotFileError, match="give contacts='all'"):
        load_robot(written(tmp_path, SLIDE), contacts="feet")
    assert len(load_robot(tmp_path / "scene.xml", contacts="all").contacts) == 1


FIELD = """<mujoco><asset><hfield name="h" nrow="2" ncol="3" size="1 0.5 1 .1"/></asset><worldbody>
<geom name="land" type="hfield" hfield="h" pos="0.5 0 0"/><body name="a" pos="{at}"><freejoint/><geom size=".1"/></body>
</worldbody></mujoco>"""


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("at", ["1.49 0 .15", "-0.49 -0.49 .15"])
def test_the_edge_of_a_height_field_is_noted(at, tmp_path):
    path = tmp_path / "field.xml"
    path.write_text(FIELD.format(at=at))
    assert any("x -0.5 to 1.5 m, y -0.5 to 0.5 m" in note for note in load_scene(path, strict=True).notes)


@pytest.mark.parametrize("at", ["1.51 0 .15", "0 0.51 .15"])
def test_a_body_that_starts_beyond_a_height_field_is_warned_of(at, tmp_path):
    path = tmp_path / "field.xml"
    path.write_text(FIELD.format(at=at))
    with pytest.warns(RobotFileWarning, match=r"'land'.*'a' start there"):
        load_scene(path)
    with pytest.raises(RobotFileError, match=r"'land'.*'a' start there"):
        load_scene(path, strict=True)
