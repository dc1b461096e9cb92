"""Scenes of several robots and objects: each moves as it does alone."""

import math
from dataclasses import replace

import numpy as np
import pytest

from featherstone_gait.analysis.equilibrium import trim
from featherstone_gait.analysis.linearization import linearize
from featherstone_gait.model import ContactPoint, Ground, Link, Model, Supply
from featherstone_gait.model.placed import Placed
from featherstone_gait.robot_file import load_robot
from featherstone_gait.run.reference import Reference
from featherstone_gait.run.sensors import sole_forces
from featherstone_gait.run.session import Session
from featherstone_gait.run.simulate import Push, initial_state, simulate, simulate_batch
from featherstone_gait.run.trajectory import Trajectory
from featherstone_gait.run.worlds import Worlds
from featherstone_gait.scene.compile import compile_scene

RADIUS = 0.1
RECORD = ("q", "qd", "base_q", "base_qd", "energy", "contact_force", "contact_work", "current")
TURNED = (math.cos(0.3), 0.0, 0.0, math.sin(0.3))
STEPS = dict(integrator="implicit_euler", timestep=1e-3)


def ball(mass=1.0):
    inertia = 0.4 * mass * RADIUS**2
    point = ContactPoint("ball", (0.0, 0.0, 0.0), radius=RADIUS)
    link = Link("ball", mass, inertia=(inertia, 0.0, 0.0, inertia, 0.0, inertia))
    return Model("ball", (link,), (), base="floating", contacts=(point,))


def box(side=0.2, mass=1.0):
    inertia = mass * side**2 / 6.0
    corners = [(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]
    contacts = tuple(ContactPoint("box", tuple(side * c for c in corner)) for corner in corners)
    link = Link("box", mass, inertia=(inertia, 0.0, 0.0, inertia, 0.0, inertia))
    return Model("box", (link,), (), base="floating", contacts=contacts)


def test_a_scene_of_many_members_has_a_short_name():
    balls = [Placed(ball(), f"ball {k}", (0.3 * k, 0.0)) for k in range(30)]
    assert compile_scene(balls[:3], **STEPS).model.name == "ball 0 and ball 1 and ball 2"
    assert compile_scene(balls, **STEPS).model.name == "ball 0 and ball 1 and ball 2 and ball 3 and 26 more"


def company(**how):
    """A walking robot, an arm on a turned base, a ball in the air and one that rests."""
    robot, arm = load_robot("humanoid"), load_robot("arm7")
    placed = [
        Placed(ball(), name="high", position=(5.0, 5.0, 2.0)),
        Placed(arm, name="arm", position=(1.0, 2.0, 0.5), orientation=TURNED),
        Placed(robot, name="robot"),
        Placed(ball(), name="low", position=(-3.0, 0.0)),
    ]
    return compile_scene(placed, ground=Ground(), **how)


def recorded(scene):
    return [name for name in RECORD if scene.part(name)[1] > scene.part(name)[0]]


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["implicit_euler", "midpoint", "rk4"])
def test_at_fixed_steps_each_moves_to_the_bits_of_one_alone(integrator):
    scene = company(gearbox="mipsd", integrator=integrator, timestep=1e-3)
    run = simulate(scene, 0.3, estimate_error=False, record=RECORD)
    first = initial_state(scene)
    for member in scene.members:
        alone = simulate(
            member.scene, 0.3, scene.state_of(member.name, first), estimate_error=False, record=recorded(member.scene)
        )
        own = run[member.name]
        for name in recorded(member.scene):
            assert np.array_equal(own[name], alone[name]), (member.name, name)
        assert own.final.shape == alone.final.shape
        assert np.array_equal(own.state["base_q" if member.model.base == "floating" else "q"], alone.state[
            "base_q" if member.model.base == "floating" else "q"
        ])  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["ars343", "extrapolation"])
def test_under_error_control_each_moves_as_alone_to_the_tolerance(integrator):
    scene = company(gearbox="mipsd", integrator=integrator)
    run = simulate(scene, 0.3, estimate_error=False, rtol=1e-6)
    for member in scene.members:
        first = scene.state_of(member.name, initial_state(scene))
        alone = simulate(member.scene, 0.3, first, estimate_error=False, rtol=1e-6)
        for name in run[member.name].keys() - {"time"}:
            assert np.abs(run[member.name][name] - alone[name]).max(initial=0.0) < 1e-4, (member.name, name)


@pytest.mark.long
def test_a_robot_out_of_balance_does_not_change_the_other():
    """Newton's iteration of one tree may take more passes than that of another."""
    robot = load_robot("humanoid")
    scene = compile_scene(
        [Placed(robot, name="left"), Placed(robot, name="right", position=(3.0, 1.0))],
        gearbox="mipsd", ground=Ground(), fall_height=-1.0, fall_tilt=math.pi, **STEPS,
    )  # fmt: skip
    push = Push(f"right/{robot.root}", force=(60.0, 10.0, 0.0), end=0.2)
    run = simulate(scene, 0.4, pushes=[push], estimate_error=False)
    still = simulate(scene, 0.4, estimate_error=False)
    assert np.array_equal(run["left"]["q"], still["left"]["q"])
    assert np.abs(run["right"]["base_q"] - still["right"]["base_q"]).max() > 0.1


def test_a_ball_rolls_down_a_slope_and_a_box_slides_to_rest():
    """A rolling ball has 5/7 g sin a; a box of friction 0.3 stops from 1 m/s after v^2 / (2 mu g)."""
    slope, g = 0.1, 9.81
    scene = compile_scene([Placed(ball(), name="ball"), Placed(box(), name="box", position=(0.0, 2.0))],
                          ground=Ground(friction=0.8, slope=slope), **STEPS)  # fmt: skip
    run = simulate(scene, 1.0, estimate_error=False)
    speed = np.linalg.norm(run["ball"]["base_qd"][-1, :3]) - np.linalg.norm(run["ball"]["base_qd"][50, :3])
    assert speed == pytest.approx(5 / 7 * g * math.sin(slope) * (run["time"][-1] - run["time"][50]), rel=2e-3)
    settled = run["box"]["base_q"][len(run["time"]) // 2 :, :3]  # it starts level, and first tilts onto the slope
    assert np.abs(settled - settled[0]).max() < 1e-4
    flat = compile_scene([Placed(ball(), name="ball"), Placed(box(), name="box", position=(0.0, 2.0))],
                         ground=Ground(friction=0.3), **STEPS)  # fmt: skip
    first = initial_state(flat, qd={"box": [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]})
    end = simulate(flat, 1.0, first, estimate_error=False)["box"]
    assert end["base_q"][-1, 0] == pytest.approx(1.0 / (2 * 0.3 * g), rel=0.02)
    assert np.abs(end["base_qd"][-1]).max() < 1e-3


@pytest.mark.long
def test_the_run_says_which_robot_fell():
    robot = load_robot("humanoid")
    scene = compile_scene([Placed(robot, name="left"), Placed(robot, name="right", position=(3.0, 1.0))],
                          gearbox="mipsd", ground=Ground(), **STEPS)  # fmt: skip
    run = simulate(scene, 2.0, pushes=[Push(f"right/{robot.root}", force=(80.0, 0.0, 0.0))], estimate_error=False)
    assert run.status == "fell"
    assert "right" in run.message
    assert "left" not in run.message


def objects():
    return compile_scene(
        [Placed(ball(), name="ball", position=(0.0, 0.0, 0.5)), Placed(box(), name="box", position=(1.0, 0.0))],
        ground=Ground(), **STEPS,
    )  # fmt: skip


@pytest.mark.long
def test_worlds_vary_a_member_and_share_vectors():
    scene = objects()
    worlds = Worlds(runs=3, links={"ball/ball.mass": [0.5, 1.0, 2.0]}, ground={"friction": [0.2, 0.5, 0.9]})
    runs = simulate_batch(scene, 0.5, worlds=worlds, estimate_error=False)
    for one, run in zip(worlds.scenes(scene), runs):
        alone = simulate(one, 0.5, estimate_error=False)
        assert all(np.array_equal(alone[name], run[name]) for name in alone)
    assert [one.members[0].model.mass for one in worlds.scenes(scene)] == [0.5, 1.0, 2.0]


@pytest.mark.long
def test_worlds_place_members_elsewhere():
    worlds = Worlds(places={"box.position": [[[1.0, 0.0]], [[2.0, -1.0]], [[3.0, 0.5]]]})
    runs = simulate_batch(objects(), 0.1, worlds=worlds, estimate_error=False)
    assert [run["box"]["base_q"][-1, :2].tolist() for run in runs] == [[1.0, 0.0], [2.0, -1.0], [3.0, 0.5]]
    assert all(np.array_equal(run["ball"]["base_q"], runs[0]["ball"]["base_q"]) for run in runs)
    with pytest.raises(ValueError, match="name one"):
        simulate_batch(objects(), 0.1, worlds=Worlds(2, places={"position": 0.0}))


@pytest.mark.long
def test_worlds_vary_the_supply_of_a_member():
    arm = replace(load_robot("arm7"), supply=Supply(11.1, 0.3))
    scene = compile_scene([Placed(ball(), position=(2.0, 0.0)), Placed(arm)], "mipsd", Ground(), **STEPS)
    worlds = Worlds(supply={"voltage": [9.0, 11.1]})
    low, usual = simulate_batch(scene, 0.1, worlds=worlds, record=("bus_voltage",), estimate_error=False)
    assert low["bus_voltage"][0, 0] == pytest.approx(9.0, abs=0.2)
    assert usual["bus_voltage"][0, 0] == pytest.approx(11.1, abs=0.2)


@pytest.mark.long
def test_a_session_steps_many_scenes():
    scene = objects()
    with Session(scene, n=64) as session:
        for _ in range(5):
            session.step(np.zeros((64, 0)))
        run = simulate(scene, 5 * session.tick, estimate_error=False)
        assert np.array_equal(session.state_view.base_q[63], run["base_q"][-1])


def test_a_run_is_saved_and_goes_on(tmp_path):
    scene = objects()
    half, whole = (simulate(scene, t, estimate_error=False) for t in (0.2, 0.4))
    half.save(tmp_path / "run")
    read = Trajectory.load(tmp_path / "run")
    assert np.array_equal(read["ball"]["base_q"], half["ball"]["base_q"])
    assert np.array_equal(simulate(scene, 0.2, read, estimate_error=False).final, whole.final)
    again = simulate(scene.member("box").scene, 0.2, read["box"], estimate_error=False)
    assert np.array_equal(again["base_q"], simulate(scene, 0.2, read, estimate_error=False)["box"]["base_q"])


@pytest.mark.long
def test_an_uncertain_base_is_told_by_its_member():
    scene = compile_scene(
        [Placed(box(), name="still"), Placed(box(), name="tumbling", position=(2.0, 0.0, 1.0))],
        ground=Ground(), integrator="implicit_euler", timestep=2e-3,
    )  # fmt: skip
    run = simulate(scene, 2.0, initial_state(scene, qd={"tumbling": [1.0, 2.0, 0.0, 3.0, 4.0, 5.0]}))
    assert run.status == "inaccurate"
    assert "of tumbling" in run.message
    assert run["still"].error["base_q"].max() < 1e-3 < 1e-2 < run["tumbling"].error["base_q"].max()  # the limit is 1e-2


def test_names_and_places_are_checked():
    with pytest.raises(ValueError, match="'ball' is the name of several"):
        compile_scene([ball(), ball()])
    with pytest.raises(ValueError, match="empty"):
        compile_scene([])
    with pytest.raises(TypeError, match="Placed"):
        compile_scene([ball(), "box"])
    with pytest.raises(ValueError, match=r"position is array\(1\.\); expected 3"):
        Placed(ball(), position=np.array(1.0))
    scene = objects()
    with pytest.raises(ValueError, match="there are ball, box"):
        initial_state(scene, {"bal": np.zeros(7)})
    with pytest.raises(TypeError, match="dictionary"):
        initial_state(scene, np.zeros(14))
    run = simulate(scene, 0.1, estimate_error=False)
    with pytest.raises(ValueError, match="there are ball, box"):
        run.of("bal")


def test_a_joint_may_have_the_name_of_a_root():
    arm = load_robot("arm7")
    first = arm.joints[0].name
    joints = tuple(replace(one, name=arm.root) if one.name == first else one for one in arm.joints)
    servos = {arm.root if name == first else name: servo for name, servo in arm.servos.items()}
    scene = compile_scene([Placed(replace(arm, joints=joints, servos=servos), name="a"), Placed(ball())], "mipsd")
    assert scene.model.joint_names[0] == f"a/{arm.root}"


def test_servos_that_cannot_act_in_one_scene_are_refused():
    arm = load_robot("arm7")
    with pytest.raises(ValueError, match="servos of several kinds"):
        compile_scene([Placed(arm, name="a"), Placed(arm, name="b", gearbox="rotor")], gearbox="mipsd")


def pair(**how):
    arm = load_robot("arm7")
    placed = [Placed(arm, name="a"), Placed(arm, name="b", position=(1.0, 0.0, 0.0), orientation=TURNED)]
    return compile_scene([*placed, Placed(box(), name="box", position=(0.0, 2.0))], ground=Ground(), **how)


@pytest.mark.long
def test_linear_models_are_those_of_each_alone():
    scene = pair(gearbox="mipsd", **STEPS)
    rest = trim(scene)
    assert rest.ok, rest.message
    whole = linearize(scene, rest.state, Reference([0.0], rest.reference[None]))
    assert not any("base" in name and (" a " in name or " b " in name) for name in whole.states)
    for member in scene.members[:2]:
        own = trim(member.scene)
        alone = linearize(member.scene, own.state, Reference([0.0], own.reference[None]))
        rows = [whole.states.index(_of_member(name, member.name)) for name in alone.states]
        assert np.abs(whole.A[np.ix_(rows, rows)] - alone.A).max() < 1e-7
        others = [k for k in range(len(whole.states)) if k not in rows]
        assert np.abs(whole.A[np.ix_(others, rows)]).max() < 1e-9


def _of_member(name, member):
    channel, _, joint = name.partition(" ")
    return f"{channel} {member}/{joint}"


@pytest.mark.long
def test_all_members_rest_where_each_rests_alone():
    scene = pair(gearbox="mipsd", **STEPS)
    rest = trim(scene)
    assert rest.ok, rest.message
    assert rest.contact_force[:, 0].sum() == pytest.approx(9.81, rel=1e-9)
    run = simulate(scene, 0.5, rest.state, Reference([0.0], rest.reference[None]), estimate_error=False)
    assert np.abs(run["q"] - run["q"][0]).max() < 1e-6
    with pytest.raises(ValueError, match="there are a, b, box"):
        trim(scene, {"c": np.zeros(7)})


def test_what_is_of_one_robot_says_so():
    scene = objects()
    run = simulate(scene, 0.1, estimate_error=False, record=("base_q", "contact_force"))
    with pytest.raises(ValueError, match="of one robot alone"):
        sole_forces(scene, run)
    forces = sole_forces(scene.member("box").scene, run["box"])
    assert forces["box"].shape == (11, 3)
    with pytest.raises(ValueError, match="of one robot alone"):
        simulate(scene, 0.1, record=("clearance",))
