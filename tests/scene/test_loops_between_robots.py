"""Loops between robots and objects of a scene: rigid bodies, rods, contact beside them, files, names, lanes."""

import math
from dataclasses import replace

import numpy as np
import pytest
from touching import G

from featherstone_gait import (
    Box,
    Ground,
    Joint,
    Link,
    Loop,
    Model,
    PairContact,
    Placed,
    SceneModel,
    Shape,
    body,
    compile_scene,
    energy,
    initial_state,
    linearize,
    load_robot,
    load_scene,
    momentum,
    save_scene,
    simulate,
    simulate_batch,
    switch_loop,
)
from featherstone_gait.base.rotation import rotation_about
from featherstone_gait.run.start import gaps_and_speeds

ONCE = {"estimate_error": False}
AT, ANGLE = (0.3, 0.1, 0.2), 0.7  # of the second body in the first [m], about z [rad]
TURN = (math.cos(0.5 * ANGLE), 0.0, 0.0, math.sin(0.5 * ANGLE))
ROTATION = rotation_about((0.0, 0.0, 1.0), ANGLE)
LEFT = Link("hull", 1.3, (0.02, 0.01, 0.03), (0.02, 0.001, 0.0, 0.012, 0.0, 0.009))
RIGHT = Link("load", 0.7, (-0.01, 0.03, 0.0), (0.01, 0.0, 0.001, 0.013, 0.002, 0.011))
WELD = Loop("weld", "weld", "left/hull", "right/load", AT, rpy_b=(0.0, 0.0, -ANGLE))
V, W = np.array([0.3, 0.2, 1.0]), np.array([0.7, -1.1, 0.9])
AS_ONE = {"left": [*V, *W], "right": [*(V + np.cross(W, AT)), *(ROTATION.T @ W)]}


def two(z=1.0, shapes=((), ())):
    """Two free bodies, the second where the weld holds it."""
    left, right = (
        Model(link.name, (link,), (), base="floating", shapes=own) for link, own in zip((LEFT, RIGHT), shapes)
    )
    return [Placed(left, "left", (0.0, 0.0, z)), Placed(right, "right", (AT[0], AT[1], AT[2] + z), TURN)]


def totals(run, members):
    """Energy and momentum of both."""
    states = [(one.model, run[one.name]["base_q"], run[one.name]["base_qd"]) for one in members]
    return sum(energy(*state).total for state in states), sum(momentum(*state) for state in states)


@pytest.mark.long
@pytest.mark.nojit
@pytest.mark.parametrize("integrator", ["rk4", "dop853", "ars343"])
def test_two_free_bodies_that_a_weld_joins_move_as_one_rigid_body(integrator):
    """The runs without JIT are short; energy and momentum are those of the fall."""
    members = two()
    one = Model("one", (LEFT, RIGHT), (Joint("fix", "fixed", "hull", "load", AT, (0.0, 0.0, ANGLE)),), base="floating")
    scene = compile_scene(members, integrator=integrator, timestep=1e-3, loops=[WELD])
    alone = compile_scene(one, integrator=integrator, timestep=1e-3)
    how = {"record": ("base_q", "base_qd"), **ONCE} | ({} if integrator == "rk4" else {"rtol": 1e-11})
    run = simulate(scene, 0.1, initial_state(scene, qd=AS_ONE), **how)
    rigid = simulate(alone, 0.1, initial_state(alone, [0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0], AS_ONE["left"]), **how)
    assert run.status == "ok"
    for channel in ("base_q", "base_qd"):
        np.testing.assert_allclose(run["left"][channel], rigid[channel], rtol=0, atol=1e-9)
    E, P = totals(run, members)
    assert np.ptp(E) < 1e-9
    np.testing.assert_allclose(P[:, 3:5], P[0, 3:5] + np.zeros((len(P), 2)), rtol=0, atol=1e-9)
    np.testing.assert_allclose(P[:, 5] + 2.0 * G * run["time"], P[0, 5], rtol=0, atol=1e-9)
    assert np.linalg.norm(run["left"]["base_qd"][-1, 3:] - W) > 1e-3  # it tumbles


@pytest.mark.long
def test_a_linear_model_of_pendulums_that_a_rod_joins_is_that_of_one():
    """Two equal pendulums with a rod as long as they are apart turn alike; the second faces the other way."""
    bob = Link("bob", 1.2, (0.0, 0.0, -0.3), (0.01, 0.0, 0.0, 0.02, 0.0, 0.01))
    one = Model("one", (Link("wall"), bob), (Joint("hinge", "continuous", "wall", "bob", axis=(0.0, 1.0, 0.0)),))
    free = Model("free", (LEFT,), (), base="floating")
    places = Placed(one, "a"), Placed(free, "free", (0.0, 3.0, 0.0)), Placed(one, "b", (0.5, 0.0, 0.0), (0, 0, 0, 1))
    rod = Loop("rod", "distance", "a/bob", "b/bob", (0.0, 0.0, -0.3), (0.0, 0.0, -0.3), distance=0.5)
    scene = compile_scene(places, integrator="rk4", timestep=1e-3, loops=[rod])
    alone = compile_scene(one, integrator="rk4", timestep=1e-3)
    start = initial_state(scene, {"a": [0.4], "b": [-0.4]}, {"a": [1.0], "b": [-1.0]})
    found, single = linearize(scene, start), linearize(alone, initial_state(alone, [0.4], [1.0]))
    own = [k for k, name in enumerate(found.states) if name.endswith("hinge")]
    assert [found.states[k].split()[0] for k in own] == ["q", "qd"]
    np.testing.assert_allclose(np.abs(found.A[np.ix_(own, own)]), np.abs(single.A), rtol=0, atol=1e-9)
    assert np.abs(np.delete(found.A[own], own, axis=1)).max() < 1e-12
    x = np.zeros(len(found.states))
    x[own] = 0.01, -0.02
    assert np.abs(gaps_and_speeds(scene, found.moved(x))).max() < 1e-10


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["midpoint", "rk4", "ars343"])
def test_a_rod_between_two_free_bodies_does_what_it_does_in_one_robot(integrator):
    """In one robot the second body hangs on a free joint."""
    members, ends = two(), ((0.1, 0.0, 0.0), (0.0, 0.1, 0.0))
    length = float(np.linalg.norm(np.array(AT) + ROTATION @ ends[1] - ends[0]))
    rod = Loop("rod", "distance", "left/hull", "right/load", *ends, distance=length)
    alone = Model(
        "both", (LEFT, RIGHT), (Joint("apart", "free", "hull", "load"),), base="floating",
        loops=(replace(rod, a="hull", b="load"),),
    )  # fmt: skip
    scene = compile_scene(members, integrator=integrator, timestep=1e-3, loops=[rod])
    single = compile_scene(alone, integrator=integrator, timestep=1e-3)
    how = {"record": ("base_q", "base_qd", "loop_force"), **ONCE} | ({"rtol": 1e-11} if scene.adaptive else {})
    run = simulate(scene, 0.5, initial_state(scene, qd=AS_ONE), **how)
    start = initial_state(single, [0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, *AT, *TURN], [*AS_ONE["left"], *np.zeros(6)])
    same = simulate(single, 0.5, start, **how)
    assert (run.status, same.status) == ("ok", "ok")
    error = 1e-5 if integrator == "midpoint" else 1e-9
    np.testing.assert_allclose(run["left"]["base_q"], same["base_q"], rtol=0, atol=error)
    if integrator != "midpoint":
        E, P = totals(run, members)
        assert np.ptp(E) < 1e-9
        assert np.abs(P[:, 3:5] - P[0, 3:5]).max() < 1e-9
        np.testing.assert_allclose(run["loop_force"], same["loop_force"], rtol=0, atol=1e-7)


# ---------------------------------------------------------------------------------------------- contact


@pytest.mark.nojit
@pytest.mark.long
@pytest.mark.parametrize(("integrator", "atol"), [("rk4", 1e-11), ("implicit_euler", 1e-7)])
def test_welded_boxes_that_slide_on_another_move_as_one_rigid_body(integrator, atol):
    """Both touch the box below; the weld couples points of trees that do not touch each other.

    Without friction, whose damping depends on the mass of each tree.
    """
    sides = Box((0.1, 0.1, 0.1)), Box((0.1, 0.1, 0.1))
    inertia = (0.004, 0.0, 0.0, 0.005, 0.0, 0.006)
    links = Link("hull", 1.3, inertia=inertia), Link("load", 0.7, inertia=inertia)
    at, height = (0.15, 0.0, 1e-4), 0.1498
    parts = [Model(f"m{k}", (link,), (), base="floating", shapes=(Shape(link.name, box),)) for k, (link, box) in
             enumerate(zip(links, sides))]  # fmt: skip
    joined = Model(
        "one", links, (Joint("fix", "fixed", "hull", "load", at),), base="floating",
        shapes=tuple(Shape(link.name, box) for link, box in zip(links, sides)),
    )  # fmt: skip
    floor = Placed(body(Box((0.8, 0.8, 0.1)), 5.0), "floor", (0.0, 0.0, 0.05))
    how = {"pairs": PairContact(load=2.0, friction=0.0), "integrator": integrator, "timestep": 1e-4}
    weld = Loop("weld", "weld", "left/hull", "right/load", at)
    apart = [Placed(parts[0], "left", (0.0, 0.0, height)), Placed(parts[1], "right", (at[0], 0.0, height + at[2]))]
    scene = compile_scene([*apart, floor], None, Ground(), loops=[weld], **how)
    whole = compile_scene([Placed(joined, "left", (0.0, 0.0, height)), floor], None, Ground(), **how)
    v = [0.4, 0.1, 0.0, 0.0, 0.0, 0.0]
    record = ("base_q", "base_qd", "pair_work")
    start = initial_state(scene, qd={"left": v, "right": v})
    run = simulate(scene, 0.01, start, record=(*record, "loop_force"), **ONCE)
    rigid = simulate(whole, 0.01, initial_state(whole, qd={"left": v}), record=record, **ONCE)
    assert (run.status, rigid.status) == ("ok", "ok")
    assert np.abs(run["loop_force"]).max() > 0.1
    np.testing.assert_allclose(run["left"]["base_q"], rigid["left"]["base_q"], rtol=0, atol=atol)
    np.testing.assert_allclose(run["pair_work"], rigid["pair_work"], rtol=0, atol=max(1e2 * atol, 1e-9))


@pytest.mark.long
def test_joined_bodies_in_lanes_have_the_bits_of_each_alone():
    shapes = (Shape("hull", Box((0.1, 0.1, 0.1))),), (Shape("load", Box((0.1, 0.1, 0.1))),)
    floor = Placed(body(Box((0.8, 0.8, 0.1)), 5.0), "floor", (0.0, 0.0, 0.05))
    scene = compile_scene(
        [*two(0.2, shapes), floor], None, Ground(), "rk4", 5e-4, pairs=PairContact(load=2.0), loops=[WELD]
    )
    starts = []
    for k in range(9):
        speeds = {name: [0.3 * k, *qd[1:]] for name, qd in AS_ONE.items()}
        start = initial_state(scene, qd=speeds, open_loops=["weld"])
        starts.append(switch_loop(scene, start, "weld", True) if k % 3 else start)
    how = {"record": ("base_q", "base_qd", "loop_force", "loop_closed", "pair_work"), **ONCE}
    runs = simulate_batch(scene, 0.2, states=starts, **how)
    for run, start in zip(runs, starts):
        assert run.status == "ok"
        alone = simulate(scene, 0.2, start, **how)
        for channel in how["record"]:
            assert alone[channel].tobytes() == run[channel].tobytes(), channel
    assert len({run.final.tobytes() for run in runs}) == len(runs)


@pytest.mark.long
@pytest.mark.nojit
def test_a_box_that_is_caught_moves_on_with_the_common_momentum_until_it_is_let_go():
    cube = Box((0.1, 0.1, 0.1))
    hand, box = Placed(body(cube, 3.0), "hand", (0.0, 0.0, 1.0)), Placed(body(cube, 1.0), "box", (0.2, 0.0, 1.0))
    grip = Loop("grip", "weld", "hand/body", "box/body")
    scene = compile_scene([hand, box], gravity=(0.0, 0.0, 0.0), integrator="rk4", timestep=1e-3, loops=[grip])
    start = initial_state(scene, qd={"hand": [2.0, *np.zeros(5)]}, open_loops=["grip"])
    with pytest.raises(ValueError, match=r"'grip' is open by 0\.2 m"):
        switch_loop(scene, start, "grip", True)
    with pytest.raises(ValueError, match=r"'grip' is open by 0\.2 m.*place the members.*open_loops"):
        initial_state(scene)
    caught = switch_loop(scene, start, "grip", True, within=math.inf)
    view = scene.state_view(caught)
    np.testing.assert_allclose(view.base_qd, [[1.5, *np.zeros(5)]] * 2, rtol=0, atol=1e-12)
    assert view.loop_loss[0] == pytest.approx(0.5 * 3.0 * 4.0 - 0.5 * 4.0 * 2.25, rel=1e-12)
    run = simulate(scene, 0.02, caught, record=("base_q",), **ONCE)
    np.testing.assert_allclose(run["box"]["base_q"][-1, :3], [0.23, 0.0, 1.0], rtol=0, atol=1e-12)
    freed = switch_loop(scene, run, "grip", False)
    assert simulate(scene, 0.01, freed, record=("loop_force",), **ONCE)["loop_force"].any() == 0.0


# ---------------------------------------------------------------------------------------------- files and names


def test_loops_of_a_scene_are_read_from_toml(tmp_path):
    text = """
    [[objects]]
    name = "left"
    shape = "box"
    size = [0.1, 0.1, 0.1]
    mass = 1.0
    [[objects]]
    name = "right"
    shape = "sphere"
    radius = 0.1
    mass = 2.0
    position = [0.5, 0.0, 0.0]
    [[loops]]
    name = "rod"
    kind = "distance"
    a = "left/body"
    b = "right/{link}"
    distance = 0.5
    """
    path = tmp_path / "scene.toml"
    path.write_text(text.format(link="body"))
    scene = load_scene(path)
    assert scene.loops == (Loop("rod", "distance", "left/body", "right/body", distance=0.5),)
    assert [loop.name for loop in compile_scene(scene).model.loops] == ["rod"]
    path.write_text(text.format(link="hand"))
    with pytest.raises(ValueError, match=r"loops names 'right/hand'.*'right/body'"):
        load_scene(path)


def test_loops_of_a_scene_go_to_mjcf_and_back(tmp_path):
    mujoco = pytest.importorskip("mujoco")
    members = two()
    rod = Loop("rod", "distance", "left/hull", "right/load", (0.1, 0.0, 0.0), distance=0.5)
    pin = Loop("pin", "connect", "right/load", "left/hull", (0.0, 0.1, 0.0), (0.2, 0.1, 0.0))
    scene = SceneModel("joined", tuple(members), loops=(WELD, rod, pin))
    save_scene(scene, tmp_path / "joined.xml")
    back = load_scene(tmp_path / "joined.xml")
    assert any("rigid loops" in note for note in back.notes)
    for one, other in zip(scene.loops, back.loops, strict=True):
        assert (one.name, one.kind, one.a, one.b) == (other.name, other.kind, other.a, other.b)
        for field in ("point_a", "point_b", "rpy_a", "rpy_b", "distance"):
            np.testing.assert_allclose(getattr(one, field), getattr(other, field), rtol=0, atol=1e-12)
    m = mujoco.MjModel.from_xml_path(str(tmp_path / "joined.xml"))
    d = mujoco.MjData(m)
    mujoco.mj_forward(m, d)
    assert np.abs(d.efc_pos[:6]).max() < 1e-12  # closed at the start there too


def test_wrong_loops_of_a_scene_are_refused():
    members = two()
    for loops, problem in (
        ([replace(WELD, b="right/hull")], r"loops names 'right/hull'.*'right/load'"),
        ([WELD, WELD], "2 loops are named 'weld'"),
    ):
        with pytest.raises(ValueError, match=problem):
            compile_scene(members, loops=loops)
        with pytest.raises(ValueError, match=problem):
            SceneModel("scene", tuple(members), loops=tuple(loops))
    with pytest.raises(TypeError, match="loops"):
        compile_scene(members, loops=["weld"])
    arm = load_robot("arm7")
    grip = Loop("grip", "weld", *(f"{name}/{arm.links[-1].name}" for name in ("one", "other")))
    with pytest.raises(ValueError, match=r"scene: integrator 'simtwo'.*'grip'"):
        compile_scene([Placed(arm, "one"), Placed(arm, "other")], "standard", integrator="simtwo", loops=[grip])


TIED = """<mujoco><worldbody><body name="a" pos="0.3 0 1" euler="0 0 30"><freejoint/><geom size=".1" mass="1"/>
<body name="b" pos=".2 0 0"><joint axis="0 1 0"/><geom size=".05" pos=".1 0 0" mass="1"/></body></body></worldbody>
<equality>{tie}</equality></mujoco>"""
TIES = ('<connect body1="a" anchor="0 0 .1"/>', '<weld body1="a"/>', '<connect body1="b" anchor=".2 0 0"/>')


@pytest.mark.parametrize("tie", TIES)
def test_a_body_tied_to_the_world_starts_where_its_file_puts_it(tie, tmp_path):
    """There nothing has to move: MuJoCo's gap is 0 too.  A robot alone moves from the origin to its tie."""
    path = tmp_path / "tied.xml"
    path.write_text(TIED.format(tie=tie))
    scene = compile_scene(load_scene(path))
    state = initial_state(scene)
    at = [0.3, 0.0, 1.0, math.cos(math.pi / 12.0), 0.0, 0.0, math.sin(math.pi / 12.0)]
    np.testing.assert_allclose(scene.state_view(state).base_q, at, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(scene.state_view(state).q, [0.0])
    assert np.abs(gaps_and_speeds(scene, state)[0]).max() < 1e-9
    alone = compile_scene(load_robot(path))
    assert np.abs(gaps_and_speeds(alone, initial_state(alone))[0]).max() < 1e-9
