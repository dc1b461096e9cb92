"""Contact between bodies as a run tells of it: forces, impulses and gaps of two bodies, tables, saved runs, worlds."""

import numpy as np
import pytest
from scipy.linalg import expm
from touching import far

from featherstone_gait.analysis.equilibrium import trim
from featherstone_gait.analysis.linearization import linearize
from featherstone_gait.geometry.body import body
from featherstone_gait.model import Ground
from featherstone_gait.model.pair_contact import PairContact
from featherstone_gait.model.placed import Placed, SceneModel
from featherstone_gait.model.shapes import Box, Sphere
from featherstone_gait.run.simulate import initial_state, simulate, simulate_batch
from featherstone_gait.run.trajectory import Trajectory
from featherstone_gait.run.worlds import Worlds
from featherstone_gait.scene.compile import compile_scene
from featherstone_gait.view.plotting import plot

G = 9.81  # [m/s^2]
BOX, ONE, TWO = 2.0, 1.0, 0.25  # masses [kg]
LAW = PairContact(load=BOX)
SPEED = 1.0  # of one ball towards the other [m/s]
RECORD = ("base_q", "base_qd", "pair", "pair_force", "pair_normal_force", "pair_gap", "pair_position", "pair_work")


def table_and_balls(ground=None):
    """A box that rests on a table, and two balls in the air that will meet."""
    table = body(Box((1.0, 1.0, 0.5)), name="table", base="fixed")
    members = (
        Placed(body(Sphere(0.1), TWO, name="two"), position=(0.25, 0.0, 4.0)),
        Placed(body(Box((0.2, 0.2, 0.2)), BOX, name="box"), position=(0.0, 0.0, 0.6 - 5e-4)),
        Placed(body(Sphere(0.1), ONE, name="one"), position=(0.0, 0.0, 4.0)),
    )
    return SceneModel("meeting", members, (Placed(table, position=(0.0, 0.0, 0.25)), *far()), ground)


def compiled(pairs=LAW, timestep=1e-3, integrator="extrapolation", ground=None):
    return compile_scene(table_and_balls(ground), None, integrator=integrator, timestep=timestep, pairs=pairs)


def towards(scene):
    return initial_state(scene, qd={"one": [SPEED, 0.0, 0.0, 0.0, 0.0, 0.0]})


@pytest.fixture(scope="module")
def meeting():
    scene = compiled(timestep=1e-5)
    run = simulate(scene, 0.07, towards(scene), record=RECORD, record_interval=2e-5, rtol=1e-6)
    assert run.ok
    return scene, run


def test_a_table_carries_the_weight_of_what_rests_on_it(meeting):
    _, run = meeting
    carried = run.contact("box", "table")
    assert carried.force[-1] == pytest.approx([0.0, 0.0, BOX * G], rel=1e-6, abs=1e-6)
    assert carried.normal_force[-1] == pytest.approx(BOX * G, rel=1e-6)
    assert carried.gap[-1] == pytest.approx(-5e-4, rel=1e-5)
    assert carried.touching[1:].all()  # forces are known from the first step on
    pressed = run.contact("table/body", "box/body")
    assert np.array_equal(pressed.force, -carried.force)
    assert np.array_equal(pressed.gap, carried.gap)


def test_an_impulse_is_the_change_of_momentum(meeting):
    """Of each ball, with gravity; both together lose none, and the box feels nothing of it."""
    _, run = meeting
    time = run["time"][:, None]
    for name, mass, other in (("one", ONE, "two"), ("two", TWO, "one")):
        touch = run.contact(name, other)
        change = mass * (run[name]["base_qd"][:, :3] - run[name]["base_qd"][0, :3])
        assert touch.impulse == pytest.approx(change + mass * time * [0.0, 0.0, G], abs=2e-4 * TWO * SPEED)
        assert np.array_equal(run.contact(name).force, touch.force)  # there is nothing else
        assert touch.gap[0] == pytest.approx(0.05, abs=1e-3) or np.isinf(touch.gap[0])
        assert not touch.touching[0]
        assert touch.touching.any()
    assert np.abs(touch.impulse[-1]).max() > 0.2 * SPEED
    assert run.touched() == (("box/body", "table/body"), ("one/body", "two/body"))
    assert not run.contact("box", "one").touching.any()


def test_a_body_that_cannot_touch_is_an_error_that_names_who_can(meeting):
    _, run = meeting
    for wrong, says in (
        (("cup", "table"), "cup"), (("box", "sky"), "sky"), (("table", "table"), "box/body"), ((3,), "first is 3"),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=says):
            run.contact(*wrong)
    bare = simulate(compiled(), 0.01, record=("base_q", "pair"), estimate_error=False)
    with pytest.raises(ValueError, match="pair_force"):
        bare.contact("box")
    with pytest.raises(ValueError, match="pair_normal_force"):
        bare.touched()
    with pytest.raises(ValueError, match="pairs='all'"):
        Trajectory({"time": np.zeros(1)}, "ok", "", 0.0, np.zeros(0)).contact("box")


def test_the_run_of_a_member_is_one_of_its_own_scene(meeting):
    """Channels of slots stay with the whole run; errors of slots, which two runs use differently, are not stated."""
    scene, run = meeting
    for member in scene.members:
        own = run[member.name]
        assert [*own] == ["base_q", "base_qd", "time"] or {*own} == {"time", "base_q", "base_qd"}
        assert np.array_equal(own.final, scene.state_of(member.name, run.final))
        assert own.parts == member.scene.parts
    assert {*run.error} == {"base_q", "base_qd", "pair_work"}
    assert run.error["pair_work"].max() < 1e-3


def test_a_saved_run_tells_the_same_of_its_contacts(meeting, tmp_path):
    _, run = meeting
    run.save(tmp_path / "run")
    again = Trajectory.load(tmp_path / "run.npz")
    assert np.array_equal(again.contact("one", "two").force, run.contact("one", "two").force)
    assert again.touched() == run.touched()
    assert again.info == run.info


def test_tables_and_plots_name_the_links_that_touch(meeting):
    pytest.importorskip("pandas")
    pytest.importorskip("xarray")
    _, run = meeting
    frame = run.to_pandas()
    assert np.array_equal(frame["pair_force.one/body - two/body.x"], run.contact("one", "two").force[:, 0])
    assert np.array_equal(frame["pair_gap.box/body - table/body"], run.contact("box", "table").gap)
    data = run.to_xarray()
    links = list(data["pair_of_links"].values)
    assert {"one/body - two/body", "box/body - table/body"} <= {*links}
    assert data["pair_position"].dims == ("time", "slot", "pair_position_1")
    figure = plot(run, "pair_normal_force", "pair_force", "pair_gap")
    labels = [line.get_label() for line in figure.axes[0].lines]
    assert labels == ["box/body - table/body", "one/body - two/body"]
    assert [line.get_label() for line in figure.axes[1].lines][-1] == "one/body - two/body z"


def test_a_pool_that_is_too_small_ends_the_run_with_the_argument_to_change():
    scene = compiled(PairContact(max_points=8))  # the box on the table has them all when the balls come close
    run = simulate(scene, 0.1, towards(scene), record=RECORD)
    assert run.status == "too many contacts"
    assert run.failed
    assert "max_points" in run.message
    assert "8 points" in run.message
    assert "8 of which 'box/body' has" in run.message
    assert len(run.message) < 240
    assert "max_points" in run.status.remedy


def test_worlds_differ_in_the_numbers_of_pairs():
    """A box sinks as deep as its world says, a heavier ball slows the other more; a batch has the bits of one."""
    scene = compiled()
    depths = np.array([5e-4, 1e-3])
    places = {"box.position": [[[0.0, 0.0, 0.6 - depth]] for depth in depths]}
    worlds = Worlds(pairs={"penetration": depths}, links={"two/body.mass": [0.25, 1.0]}, places=places)
    starts = [towards(one) for one in worlds.scenes(scene)]
    runs = simulate_batch(scene, 0.1, worlds=worlds, states=starts, record=RECORD)
    for run, depth, one in zip(runs, depths, worlds.scenes(scene)):
        assert run.contact("box", "table").gap[-1] == pytest.approx(-depth, rel=1e-4)
        alone = simulate(one, 0.1, towards(one), record=RECORD)
        assert alone.final.tobytes() == run.final.tobytes()
    slow, fast = (run["one"]["base_qd"][-1, 0] for run in reversed(runs))
    assert slow < fast - 0.1
    with pytest.raises(ValueError, match="pairs"):
        Worlds(2, pairs={"penetration": 1e-3}).scenes(compile_scene(table_and_balls(), None, integrator="ars343"))
    with pytest.raises(ValueError, match="stiffness"):
        Worlds(2, pairs={"stiffness": 1.0})


@pytest.mark.long
def test_a_linear_model_of_a_box_on_a_table_has_the_stiffness_of_its_contact():
    """With gravity g and depth p at rest the height obeys z'' = -g / p z - g d z', d of Hunt and Crossley."""
    depth, h = 5e-4, 1e-3
    scene = compiled(integrator="ars343", ground=Ground())
    run = simulate(scene, 0.5, record=RECORD, estimate_error=False)
    model = linearize(scene, run, inputs=())
    at = [model.states.index(name) for name in ("base_q box z", "base_qd box vz")]
    law = np.array([[0.0, 1.0], [-G / depth, -G * 1.4 / np.sqrt(G * depth)]])
    assert model.A[np.ix_(at, at)] == pytest.approx(expm(h * law), rel=1e-6)
    assert not model.discontinuities
    with pytest.raises(ValueError, match=r"no forces between bodies.*box/body"):
        trim(scene)


@pytest.mark.long
@pytest.mark.nojit
def test_worlds_of_pairs_share_lanes():
    """Friction, damping and masses that vary within lanes: the bits of each alone, and Coulomb's law in each."""
    scene = compile_scene(table_and_balls(), None, integrator="implicit_euler", timestep=1e-3, pairs="all")
    speeds = {"one": [1.0, 0.0, 0.0, 0.0, 0.0, 0.0], "box": [0.3, 0.0, 0.0, 0.0, 0.0, 0.0]}
    start = initial_state(scene, {"two": [0.2003, 0.0, 4.0, 1.0, 0.0, 0.0, 0.0]}, speeds)
    frictions = [0.1, 0.2, 0.5, 0.9]
    numbers = {"friction": frictions, "damping_ratio": [0.1, 0.7, 0.7, 1.0]}
    worlds = Worlds(4, pairs=numbers, links={"two/body.mass": [0.25, 0.5, 1.0, 2.0]})
    runs = simulate_batch(scene, 0.005, worlds=worlds, states=[start] * 4, record=RECORD, estimate_error=False)
    for one, run, friction in zip(worlds.scenes(scene), runs, frictions):
        alone = simulate(one, 0.005, start, record=RECORD, estimate_error=False)
        assert alone.final.tobytes() == run.final.tobytes()
        dragged = run.contact("box", "table")
        last = dragged.normal_force[1:-1]  # a step's friction has the normal force of the one before as its limit
        assert -dragged.force[2:, 0] == pytest.approx(friction * last, rel=1e-9)
    assert len({run["one"]["base_qd"][-1, 0] for run in runs}) == 4


@pytest.mark.long
def test_a_run_that_has_ended_leaves_its_neighbors_in_lanes_their_contacts():
    scene = compile_scene(table_and_balls(), None, integrator="implicit_euler", timestep=1e-3, pairs="all")
    start = towards(scene)
    lost = start.copy()
    lost[scene.layout["base_qd"]] = 1e9
    first, *others = simulate_batch(scene, 0.1, states=[lost, *[start] * 7], record=RECORD, estimate_error=False)
    alone = simulate(scene, 0.1, start, record=RECORD, estimate_error=False)
    assert first.status == "diverged"
    assert alone.contact("one", "two").normal_force.max() > 0.0
    for run in others:
        for name in ("base_q", "base_qd", "pair_force", "pair_work"):
            assert run[name].tobytes() == alone[name].tobytes()
