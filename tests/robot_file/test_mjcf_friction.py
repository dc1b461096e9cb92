"""The friction that geoms of MJCF have with each other is the one that MuJoCo takes."""

import re
import warnings

import numpy as np
import pytest

from featherstone_gait import (
    Box,
    Ground,
    PairContact,
    PairFriction,
    Placed,
    RobotFileError,
    RobotFileWarning,
    SceneModel,
    body,
    compile_scene,
    load_scene,
    save_scene,
    simulate,
)
from featherstone_gait.model.shapes import Sphere

mujoco = pytest.importorskip("mujoco")

LEAST = 1.1e-5  # of MuJoCo's coefficients, which has none below 1e-5
BENCHES = {
    "obstacle": '<geom name="t" type="box" size="3 2 .1" pos="0 0 -.1" {0}/>',
    "body": '<body name="bench" pos="0 0 -.1"><freejoint/><geom name="t" type="box" size="3 2 .1" {0}/></body>',
    "ground": '<geom name="t" type="plane" size="3 2 .1" {0}/>',
}
TOP = '<body name="top" pos="0 0 {2}"><freejoint/><geom name="b" {1} mass="1" {0}/></body>'
BALL, CUBE = 'type="sphere" size=".1"', 'type="box" size=".1 .1 .05"'
PAIR = '<contact><pair geom1="t" geom2="b" {0}/></contact>'
TILTED = '<option gravity="5.5 0 -8.1" timestep="2e-4" cone="elliptic" impratio="100"/>'
CASES = {  # attributes of the geom below, of the one above, of a pair
    "both slippery": ('friction=".05"', 'friction=".05"', None),
    "one slippery": ('friction=".05"', 'friction=".7"', None),
    "defaults": ("", "", None),
    "neither slides": ('condim="1"', 'condim="1"', None),
    "one slides": ('friction=".3" condim="1"', 'friction=".1"', None),
    "the one that does not is rougher": ('friction="1.5" condim="1"', 'friction=".1"', None),
    "one spins": ('friction=".3 .02 .001"', 'friction=".4 .01 .002" condim="4"', None),
    "both spin": ('friction=".3 .02 .001" condim="4"', 'friction=".4 .01 .002" condim="4"', None),
    "one rolls": ('friction=".3 .02 .001"', 'friction=".4 .01 .002" condim="6"', None),
    "one rolls, one spins": ('friction=".3 .02 .003" condim="4"', 'friction=".4 .01 .002" condim="6"', None),
    "one rolls, one does not slide": ('friction=".9 .02 .003" condim="1"', 'friction=".4 .01 .002" condim="6"', None),
    "the upper one decides": ('friction="1.2"', 'friction=".3" priority="1"', None),
    "the lower one decides": ('friction=".2" priority="3"', 'friction=".9 .1 .1" condim="6" priority="2"', None),
    "one below zero": ('friction=".2" priority="-1"', 'friction=".1"', None),
    "one that does not slide decides": ('condim="1" priority="1"', 'friction=".9" condim="6"', None),
    "one that rolls decides": ('condim="1"', 'friction=".9 .04 .02" condim="6" priority="1"', None),
    "equal priorities": ('friction=".2" priority="1"', 'friction=".3" priority="1"', None),
    "a pair": ('friction="1.2"', 'friction="1.2"', 'friction=".2 .2 .005 .0001 .0001"'),
    "a pair of defaults": ('friction=".2"', 'friction=".2"', ""),
    "a pair that does not slide": ('friction=".2"', 'friction=".2"', 'condim="1" friction="1 1"'),
    "a pair that spins": ('friction=".2"', 'condim="1"', 'condim="4" friction=".6 .6 .03"'),
    "a pair that rolls": ('friction=".2"', 'priority="2"', 'condim="6" friction=".6 .6 .03 .004 .004"'),
    "a pair of geoms that meet by it alone": ('contype="0" conaffinity="0"', "", 'friction=".25 .25"'),
}


def written(tmp_path, below, above, pair=None, bench="obstacle", kind=BALL, option="", depth=1e-4):
    height = (0.1 if kind == BALL else 0.05) - depth
    bodies = BENCHES[bench].format(below) + TOP.format(above, kind, height)
    more = "" if pair is None else PAIR.format(pair)
    path = tmp_path / "scene.xml"
    path.write_text(f"<mujoco>{option}<worldbody>{bodies}</worldbody>{more}</mujoco>")
    return path


def in_mujoco(path):
    """The numbers of the contact of two geoms that count, by its condim."""
    m = mujoco.MjModel.from_xml_path(str(path))
    d = mujoco.MjData(m)
    mujoco.mj_forward(m, d)
    (contact,) = d.contact
    counts = contact.dim >= np.array([3, 4, 6])
    return np.where(counts, contact.friction[[0, 2, 3]], 0.0)


def between(scene, **options):
    """The coefficients of sliding, spinning and rolling of the one pair of a scene that touches."""
    table = compile_scene(scene, **{"pairs": "all"} | options).constants.pairs
    (row,) = table.pairs
    turning = None if table.turning is None else table.turning[0]
    return np.array([row.friction, *((0.0, 0.0) if turning is None else (turning.torsional, turning.rolling))])


def on_ground(scene):
    """Those of sliding and rolling of the one contact point of a scene on the ground."""
    (member,) = compile_scene(scene).members
    contact = member.scene.constants.contact
    rolling = 0.0 if contact.rolling is None else contact.rolling.friction[0]
    return np.array([contact.points.friction[0], rolling])


@pytest.mark.parametrize("bench", BENCHES)
@pytest.mark.parametrize("case", CASES)
def test_two_geoms_have_the_friction_that_mujoco_takes(tmp_path, case, bench):
    """Also after they are saved: in the file that load_scene reads, and in MuJoCo that opens it."""
    path = written(tmp_path, *CASES[case], bench)
    theirs = in_mujoco(path)
    if bench == "ground" and theirs[1] > LEAST:  # which has no torsional friction
        with pytest.raises(RobotFileError, match=rf"torsional friction .* 'b' {theirs[1]:.3g};"):
            load_scene(path, strict=True)
        with pytest.warns(RobotFileWarning, match="torsional friction"):
            scene = load_scene(path)
    else:
        scene = load_scene(path, strict=True)
    save_scene(scene, tmp_path / "saved.xml")
    again = load_scene(tmp_path / "saved.xml")
    if bench == "ground":
        assert on_ground(scene) == pytest.approx(theirs[[0, 2]], abs=LEAST)
        assert on_ground(again) == pytest.approx(on_ground(scene), abs=0.0)
        return
    assert between(scene) == pytest.approx(theirs, abs=LEAST)
    assert between(again) == pytest.approx(between(scene), abs=0.0)
    assert in_mujoco(tmp_path / "saved.xml") == pytest.approx(theirs, abs=LEAST)


@pytest.mark.parametrize("seed", range(4))
def test_all_pairs_of_random_geoms_have_the_friction_that_mujoco_takes(tmp_path, seed):
    """Margins are so wide that all contacts are there; by the names of bodies, which have one geom each."""
    random = np.random.default_rng(seed)
    bodies, pairs = [], []
    for k in range(16):
        mu, torsional, rolling = random.choice([0.05, 0.3, 1.0, 2.0], 3) * [1.0, 0.1, 0.01]
        rank, kind = random.choice([0, 0, 0, 1, 2]), random.choice([1, 3, 3, 4, 6])
        stated = f'friction="{mu} {torsional} {rolling}" condim="{kind}" priority="{rank}"'
        joint = "<freejoint/>" if k < 10 else ""
        bodies.append(f'<body name="x{k}" pos="{k} 0 0">{joint}<geom name="x{k}" size=".1" {stated}/></body>')
    for one, two in {tuple(sorted(random.choice(10, 2, replace=False).tolist())) for _ in range(8)}:
        kind, mu = random.choice([1, 3, 4, 6]), random.choice([0.1, 0.7])
        stated = f'condim="{kind}" friction="{mu} {mu} {0.02 * mu} {0.001 * mu} {0.001 * mu}"'
        pairs.append(f'<pair geom1="x{one}" geom2="x{two}" {stated}/>')
    path = tmp_path / "scene.xml"
    path.write_text(f"<mujoco><worldbody>{''.join(bodies)}</worldbody><contact>{''.join(pairs)}</contact></mujoco>")
    m = mujoco.MjModel.from_xml_path(str(path))
    m.geom_margin[:] = m.pair_margin[:] = m.body_margin[:] = 100.0
    d = mujoco.MjData(m)
    mujoco.mj_forward(m, d)
    theirs = {}
    for contact in d.contact:
        names = frozenset(m.geom(g).name for g in (contact.geom1, contact.geom2))
        theirs[names] = np.where(contact.dim >= np.array([3, 4, 6]), contact.friction[[0, 2, 3]], 0.0)
    scene = load_scene(path, strict=True)
    save_scene(scene, tmp_path / "saved.xml")
    for one in (scene, load_scene(tmp_path / "saved.xml", strict=True)):
        compiled = compile_scene(one, pairs="all")
        table, turning = compiled.constants.pairs.pairs, compiled.constants.pairs.turning
        ours = np.stack([table.friction, turning.torsional, turning.rolling], axis=1)
        found = {frozenset(link.split("/")[0] for link in pair): row for pair, row in zip(compiled.pairs, ours)}
        assert found.keys() == theirs.keys()
        assert len(found) == 105
        for names, row in found.items():
            assert row == pytest.approx(theirs[names], abs=LEAST), names


def test_friction_of_a_class_is_that_of_its_geoms(tmp_path):
    path = written(tmp_path, "", 'class="ice"')
    ice = '<geom friction=".2"/><default class="ice"><geom friction=".04" condim="4"/></default>'
    path.write_text(path.read_text().replace("<mujoco>", f"<mujoco><default>{ice}</default>"))
    assert between(load_scene(path)) == pytest.approx(in_mujoco(path), abs=LEAST)


def test_links_of_one_robot_have_the_friction_of_their_geoms(tmp_path):
    """The links are on two branches, since MuJoCo lets a link touch its parent only by a <pair>."""
    arm = '<body name="{0}" pos="0 {1} 0"><joint axis="1 0 0"/><geom name="{0}" size=".1" mass="1" {2}/></body>'
    left, right = arm.format("l", -0.0999, 'friction=".3" condim="1"'), arm.format("r", 0.0999, 'friction=".2"')
    trunk = '<body name="trunk"><freejoint/><geom name="t" size=".02" mass="1"/>'
    path = tmp_path / "scene.xml"
    path.write_text(f"<mujoco><worldbody>{trunk}{left}{right}</body></worldbody></mujoco>")
    assert between(load_scene(path), pairs=[("trunk/l", "trunk/r")]) == pytest.approx(in_mujoco(path), abs=LEAST)


def test_numbers_of_pair_contact_are_those_of_shapes_that_state_none(tmp_path):
    scene = load_scene(written(tmp_path, 'friction=".05"', 'friction=".05"'))
    assert between(scene, pairs=PairContact(friction=0.9))[0] == 0.05
    own = Placed(body(Sphere(0.1), 1.0, name="own"), position=(0.0, 0.0, 0.3))
    mixed = SceneModel("mixed", [own], scene.obstacles)
    assert between(mixed, pairs=PairContact(friction=0.8))[0] == pytest.approx(0.2, abs=1e-15)  # sqrt(0.8 0.05)


# ---------------------------------------------------------------------------------------------- our own


def wall_and_ball(frictions=(), pairs="all", **moments):
    ball = body(Sphere(0.1), 1.0, name="ball", friction=0.4, **moments)
    wall = body(Box((0.1, 1.0, 1.0)), name="wall", base="fixed", friction=0.9)
    members = [Placed(ball, position=(0.0, 0.0, 0.1))]
    return SceneModel("one", members, [Placed(wall, position=(1, 0, 0.5))], Ground(), pairs=pairs, frictions=frictions)


@pytest.mark.parametrize(
    "frictions",
    [
        (),
        (PairFriction("ball", "wall", 0.3),),
        (PairFriction("wall/body", "ball/body", 0.3, 0.02), PairFriction("ball", "wall", rolling_friction=1e-3)),
        (PairFriction("ball", "ground", 0.3), PairFriction("ball", "wall", 0.0)),
    ],
)
@pytest.mark.parametrize("pairs", ["all", PairContact(friction=0.2, torsional_friction=1e-3)])
def test_friction_that_a_scene_states_is_saved(tmp_path, frictions, pairs):
    """The last statement that fits two shapes counts; numbers that it leaves out are those of the shapes."""
    scene = wall_and_ball(frictions, pairs, rolling_friction=2e-4)
    save_scene(scene, tmp_path / "one.xml")
    again = load_scene(tmp_path / "one.xml", strict=True)
    usual = np.array([0.6, 0.0 if pairs == "all" else 1e-3, 2e-4])
    names = ("friction", "torsional_friction", "rolling_friction")
    stated = [getattr(frictions[-1], name) if frictions else None for name in names]
    wanted = [x if y is None else y for x, y in zip(usual, stated)]
    assert between(scene, pairs=None) == pytest.approx(wanted, abs=1e-15)
    assert between(again, pairs=None) == pytest.approx(wanted, abs=1e-15)
    assert on_ground(again) == pytest.approx(on_ground(scene), abs=0.0)


def test_toml_states_friction_of_obstacles_and_pairs(tmp_path):
    text = """
[[objects]]
name = "ball"
shape = "sphere"
radius = 0.1
mass = 1.0
friction = 0.4

[[obstacles]]
name = "wall"
shape = "box"
size = [0.1, 1.0, 1.0]
friction = 0.9
"""
    path = tmp_path / "scene.toml"
    path.write_text(text)
    assert between(load_scene(path))[0] == pytest.approx(0.6, abs=1e-15)
    path.write_text(f'{text}\n[[frictions]]\na = "ball"\nb = "wall/body"\nfriction = 0.1\nrolling_friction = 2e-3\n')
    assert between(load_scene(path)).tolist() == [0.1, 0.0, 2e-3]
    path.write_text(f'{text}\n[[frictions]]\na = "ball"\nb = "wall"\nfriction = -0.1\n')
    with pytest.raises(ValueError, match=r"line 15.*friction is -0.1"):
        load_scene(path)


@pytest.mark.parametrize(
    ("frictions", "says"),
    [
        ([PairFriction("ball", "gate", 0.1)], "'gate'"),
        ([("ball", "wall", 0.1)], "PairFriction"),
    ],
)
def test_friction_between_what_is_not_there_is_refused(frictions, says):
    with pytest.raises((ValueError, TypeError), match=says):
        wall_and_ball(frictions)


@pytest.mark.parametrize(
    "data", ["1", "[1]", '{"ball/shape0": 1}', '{"ball/shape0": [1, 2]}', '{"ball/shape0": [-1, 0, 0]}']
)
def test_frictions_of_a_file_that_are_none_are_refused(tmp_path, data):
    save_scene(wall_and_ball(), tmp_path / "one.xml")
    text = (tmp_path / "one.xml").read_text()
    changed = re.sub(r'(featherstone_gait_frictions" )data="[^"]*"', rf"\1data='{data}'", text)
    assert changed != text
    (tmp_path / "one.xml").write_text(changed)
    with pytest.raises(RobotFileError, match="friction"):
        load_scene(tmp_path / "one.xml")


# ---------------------------------------------------------------------------------------------- what is not read


@pytest.mark.parametrize(
    ("below", "above", "pair", "says"),
    [
        ("", 'margin=".01"', None, "margin of geoms 'b'"),
        ('margin=".01"', "", None, "margin of geoms 't'"),
        ("", "", 'margin=".01"', "margin in the <pair>"),
        ("", "", 'friction=".4 .2"', "first of the two frictions"),
        ("", "", 'condim="6" friction=".4 .4 .1 .2 .3"', "first of the two frictions"),
    ],
)
@pytest.mark.parametrize("bench", ["obstacle", "ground"])
def test_what_of_contact_is_taken_otherwise_is_warned_of(tmp_path, below, above, pair, says, bench):
    path = written(tmp_path, below, above, pair, bench)
    with pytest.warns(RobotFileWarning, match=says):
        load_scene(path)
    with pytest.raises(RobotFileError, match=says):
        load_scene(path, strict=True)


def test_a_flag_for_all_contacts_is_warned_of(tmp_path):
    with pytest.warns(RobotFileWarning, match="overrides the numbers of all contacts"):
        load_scene(written(tmp_path, "", "", option='<option><flag override="enable"/></option>'))


@pytest.mark.parametrize(
    ("above", "pair", "noted"),
    [("", None, False), ('solref=".01 1"', None, True), ('solimp=".8 .9"', None, True), ("", 'solref=".01 1"', True)],
)
def test_how_geoms_give_way_is_noted_if_a_file_states_it(tmp_path, above, pair, noted):
    scene = load_scene(written(tmp_path, "", above, pair), strict=True)
    assert any("solref" in note and "'b'" in note for note in scene.notes) == noted


# ---------------------------------------------------------------------------------------------- motion


@pytest.mark.long
@pytest.mark.parametrize("case", ["both slippery", "neither slides", "the upper one decides", "a pair"])
def test_a_box_slides_down_a_slope_as_in_mujoco(tmp_path, case):
    """At 34 degrees, by 0.2 to 0.25 m within 0.3 s; it starts at rest on the bench."""
    path = written(tmp_path, *CASES[case], kind=CUBE, option=TILTED, depth=0.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run = simulate(compile_scene(load_scene(path), pairs="all"), 0.3, record=("base_qd",))
    m = mujoco.MjModel.from_xml_path(str(path))
    d = mujoco.MjData(m)
    mujoco.mj_step(m, d, 1500)
    assert run.status == "ok"
    assert np.ravel(run["base_qd"][-1])[0] == pytest.approx(d.qvel[0], rel=0.01)
