"""Contact bits, <exclude> and <pair> of MJCF decide what touches the ground, and with which friction."""

import math

import mujoco
import numpy as np
import pytest

from featherstone_gait import (
    ContactPoint,
    Ground,
    RobotFileError,
    RobotFileWarning,
    compile_scene,
    load_robot,
    save_robot,
    simulate,
)
from featherstone_gait.model.shapes import Shape, Sphere

BY_PAIRS = 'contype="0" conaffinity="0"'
SOLES = {"sphere": 'type="sphere" size="0.05"', "box": 'type="box" size="0.08 0.05 0.02"'}
STEPS = {"integrator": "implicit_euler", "timestep": 1e-3}
HEIGHTS = {"sphere": 0.25, "box": 0.22}  # of the trunk over the floor [m]


def scene(sole=SOLES["box"], pair='friction="0.4 0.4"', more="", floor=BY_PAIRS, bits=BY_PAIRS):
    """A trunk on a foot, which touches the floor by a pair."""
    return f"""
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 1" {floor}/>
    <body name="trunk" pos="0 0 0.26"><freejoint/>
      <geom name="belly" type="box" size="0.1 0.1 0.02" mass="2" {BY_PAIRS}/>
      <body name="foot" pos="0 0 -0.2"><geom name="sole" {sole} mass="1" {bits}/></body>
    </body>
  </worldbody>
  <contact><pair geom1="sole" geom2="floor" {pair}/>{more}</contact>
</mujoco>"""


@pytest.fixture
def load(tmp_path):
    """Load MJCF text."""

    def load(text, **options):
        (tmp_path / "robot.xml").write_text(text)
        return load_robot(tmp_path / "robot.xml", **options)

    return load


@pytest.mark.quick("box")
@pytest.mark.parametrize("kind", SOLES)
def test_a_foot_that_touches_by_a_pair_rests_at_mujocos_height(load, kind):
    """Balls roll, so that one foot is a ball only where nothing tips: both stand upright within their penetration."""
    text, ground = scene(SOLES[kind]), Ground(penetration=1e-4)
    run = simulate(compile_scene(load(text, contacts="feet"), ground=ground, **STEPS), 1.0)
    m = mujoco.MjModel.from_xml_string(text)
    d = mujoco.MjData(m)
    mujoco.mj_step(m, d, int(1.0 / m.opt.timestep))
    height = run["base_q"][-1, 2]
    assert height == pytest.approx(HEIGHTS[kind] - ground.penetration, abs=1e-6)
    assert abs(height - d.qpos[2]) < ground.penetration + np.abs(d.contact.dist).max()


@pytest.mark.parametrize("tilt", [0.3, 0.6])
def test_the_friction_of_a_pair_holds_a_foot_up_to_its_angle(load, tilt):
    """At a slope of the tangent t it slides with g cos (t - mu), or not at all."""
    g = 9.81 / math.hypot(1.0, tilt)
    model = load(scene(), contacts="feet")
    run = simulate(compile_scene(model, ground=Ground(friction=5.0), gravity=(tilt * g, 0.0, -g), **STEPS), 1.0)
    speeds = run["base_qd"][:, 0]
    if tilt < 0.4:
        assert abs(speeds[-1]) < 1e-5
    else:
        half = len(speeds) // 2
        rate = (speeds[-1] - speeds[half]) / (run["time"][-1] - run["time"][half])
        assert rate == pytest.approx(g * (tilt - 0.4), rel=1e-3)


@pytest.mark.parametrize(
    ("pair", "friction"),
    [
        ('friction="0.4 0.4"', 0.4),
        ("", None),
        ('condim="1"', 0.0),
        ('friction="1 1"', 1.0),
    ],
)
def test_a_pair_makes_a_shape_of_its_friction(load, pair, friction):
    model = load(scene(pair=pair), contacts="feet", strict=True)
    (shape,) = model.shapes
    assert shape.friction == friction
    assert {point.friction for point in model.contacts} == {friction}
    assert any("'sole'" in note and "<pair>" in note for note in model.notes)


def test_a_class_of_pairs_states_their_friction(load):
    default = '<mujoco><default><default class="slick"><pair friction="0.1 0.1"/></default></default>'
    model = load(scene(pair='class="slick"').replace("<mujoco>", default))
    assert model.shapes[0].friction == 0.1


@pytest.mark.parametrize(
    ("text", "word"),
    [
        (scene(pair='friction="0.4 0.2"'), "first of the two frictions"),
        (scene(pair='margin="0.01"'), "margin"),
        (scene(more='<pair geom1="floor" geom2="sole" friction="0.9 0.9"/>'), "first <pair>"),
    ],
)
def test_what_of_a_pair_is_taken_otherwise_is_warned_of(load, text, word):
    with pytest.warns(RobotFileWarning, match=word):
        load(text)
    with pytest.raises(RobotFileError, match=word):
        load(text, strict=True)


def test_pairs_of_links_are_noted_and_exclusions_between_them_are_read(load):
    joint = '<body name="foot" pos="0 0 -0.2"><joint/>'
    more = '<pair geom1="sole" geom2="belly" name="inner"/><exclude body1="trunk" body2="foot"/>'
    model = load(scene(more=more).replace('<body name="foot" pos="0 0 -0.2">', joint))
    assert [shape.name for shape in model.shapes] == ["sole"]
    assert any("'inner'" in note for note in model.notes)


LINKED = """
<mujoco><worldbody>
  <geom name="floor" type="plane" size="5 5 1"/>
  <body name="a" pos="0 0 1"><freejoint/><geom size="0.1"/>
    <body name="b" pos="1 0 0"><joint axis="0 1 0"/><geom size="0.1"/>
      <body name="c" pos="1 0 0"><joint axis="0 1 0"/><geom size="0.1" contype="2" conaffinity="1"/>
        <body name="d" pos="1 0 0"><joint axis="0 1 0"/><geom size="0.1" contype="4" conaffinity="1"/></body>
      </body>
    </body>
  </body>
</worldbody><contact><exclude body1="a" body2="c"/></contact></mujoco>
"""


def test_links_that_never_touch_are_excluded_in_the_model_and_its_file(load, tmp_path):
    """By <exclude>, and where the bits of contype and conaffinity do not meet."""
    model = load(LINKED)
    assert {*map(frozenset, model.excluded)} == {frozenset("ac"), frozenset("cd")}
    for path in (tmp_path / "saved.urdf", tmp_path / "saved.xml"):
        save_robot(model, path)
    assert load_robot(tmp_path / "saved.urdf").excluded == model.excluded
    assert {*map(frozenset, load_robot(tmp_path / "saved.xml").excluded)} >= {*map(frozenset, model.excluded)}


def test_an_excluded_body_touches_the_floor_by_its_pair_alone(load):
    out = '<exclude body1="world" body2="foot"/>'
    assert [shape.name for shape in load(scene(bits="", floor="")).shapes] == ["sole"]
    assert load(scene(bits="", floor="", more=out)).shapes[0].friction == 0.4
    alone = scene(bits="", floor="", more=out).replace('<pair geom1="sole" geom2="floor" friction="0.4 0.4"/>', "")
    assert not load(alone).shapes


def test_numbers_of_geoms_that_are_not_read_are_noted(load):
    """Those of geoms that touch outside of pairs, where the file states others than MuJoCo's defaults."""

    def unread(sole):
        text = scene(f'type="sphere" size="0.05" {sole}', floor="", bits="")
        return [
            note for note in load(text.replace("<pair", "<!--").replace("/></c", "--></c")).notes if "not read" in note
        ]

    assert unread("") == []
    friction, margin = unread('friction="0.3 0 0" margin="0.01"')
    assert "(0.3)" in friction
    assert "(0.01 m)" in margin


def test_a_floor_may_be_a_body_that_stands_still(load):
    plane = f'<geom name="floor" type="plane" size="5 5 1" {BY_PAIRS}/>'
    for inside in (plane, plane.replace("plane", "box")):
        model = load(scene().replace(plane, f'<body name="hall">{inside}</body>'))
        assert [shape.friction for shape in model.shapes] == [0.4]


def test_without_any_shape_the_remedy_is_that_of_mjcf(load):
    text = scene().replace('<pair geom1="sole" geom2="floor" friction="0.4 0.4"/>', "")
    with pytest.raises(ValueError, match="<pair>"):
        load(text, contacts="feet")


def test_a_friction_of_its_own_makes_the_round_trip(load, tmp_path):
    model = load(scene(), contacts="feet")
    save_robot(model, tmp_path / "again.urdf")
    assert load_robot(tmp_path / "again.urdf").contacts == model.contacts
    save_robot(model, tmp_path / "again.xml", ground=Ground())
    again = load_robot(tmp_path / "again.xml")
    assert again.contacts == model.contacts
    assert [shape.friction for shape in again.shapes] == [0.4]


@pytest.mark.parametrize("friction", [-1.0, math.nan, "0.4", True])
def test_a_wrong_friction_is_refused(friction):
    with pytest.raises(ValueError, match="friction"):
        ContactPoint("foot", (0.0, 0.0, 0.0), friction=friction)
    with pytest.raises(ValueError, match="friction"):
        Shape("foot", Sphere(0.1), friction=friction)
