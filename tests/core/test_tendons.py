"""Tendons: closed forms, MuJoCo with the same file, energy, orders, the row beside the fold, and the same bits."""

import math
from dataclasses import replace

import numpy as np
import pytest
from company import beside, in_company, simulated
from mujoco_oracle import mujoco_model
from random_tree import random_states, random_tree

from featherstone_gait import (
    Joint,
    Link,
    Loop,
    Mimic,
    Model,
    Tendon,
    Via,
    Wrap,
    close_loops,
    compile_scene,
    energy,
    forward_dynamics,
    inverse_dynamics,
    linearize,
    load_robot,
    loop_gaps,
    mass_matrix,
    save_robot,
    simulate,
    tendon_jacobian,
    tendon_lengths,
    trim,
)
from featherstone_gait.dynamics import momentum
from featherstone_gait.dynamics.tendons import spring_forces, tendon_energy
from featherstone_gait.run.simulate import initial_state

STILL = (0.0, 0.0, 0.0)
FIXED = ("implicit_euler", "midpoint", "rk4")
ALL = ("base_q", "q", "base_qd", "qd")
QUIET = {"estimate_error": False}
FILE = """<mujoco><compiler autolimits="true"/><worldbody><site name="w" pos=".3 .3 1"/>
<body pos="0 0 1"><joint name="a" axis="0 1 0" ref="15"/><site name="s0" pos=".05 .03 0"/>
<geom type="capsule" fromto="0 0 0 .2 0 0" size=".02" mass=".3"/>
<body pos=".2 0 0"><joint name="b" axis="0 1 1"/><geom type="box" size=".03 .05 .02" pos=".1 0 .02" mass=".2"/>
<site name="s1" pos=".1 .05 .02"/><body pos=".2 0 0"><joint name="c" type="slide" axis="0 0 1" damping="3"/>
<geom size=".03" mass=".1"/><site name="s2" pos="0 .05 .02"/><body pos="0 .1 0"><joint name="d" axis="1 0 0"/>
<geom size=".02" pos="0 .1 0" mass=".1"/><site name="s3" pos="0 .1 .05"/></body></body></body></body></worldbody>
<tendon><fixed name="t" stiffness="3" damping=".1" springlength=".1 .3"><joint joint="a" coef="1"/>
<joint joint="c" coef="3"/><joint joint="d" coef="-.5"/></fixed>
<fixed name="u" stiffness="2"><joint joint="a" coef=".7"/><joint joint="b" coef="-.5"/></fixed>
<spatial name="p" stiffness="20" damping=".2"><site site="w"/><site site="s1"/><site site="s2"/><pulley divisor="2"/>
<site site="s0"/><site site="s3"/><site site="s1"/></spatial></tendon></mujoco>"""


HUNG = """<mujoco><worldbody><site name="w" pos=".05 0 1.3"/><site name="v" pos=".5 .1 1.2"/>
<geom name="drum" type="cylinder" size=".06 .1" pos=".02 0 1.12" euler="80 10 0"/><site name="left" pos="-.2 0 1.12"/>
<body name="bob" pos="0 0 .5"><freejoint/><geom type="box" size=".1 .2 .3" mass="2"/><site name="s" pos=".1 .2 .3"/>
<site name="t" pos="-.1 .1 0"/></body></worldbody><tendon>
<spatial name="plain" stiffness="20" springlength=".1"><site site="v"/><site site="s"/></spatial>
<spatial name="bent" stiffness="30" springlength=".2"><site site="w"/><geom geom="drum" sidesite="left"/>
<site site="t"/></spatial></tendon></mujoco>"""


def tied(model, stiffness=1.0, damping=0.1):
    """The robot with two tendons of its joints, which share some, and one along a path."""
    n, links = model.joint_names, [link.name for link in model.links]
    path = [Via(links[1], (0.1, 0.0, 0.0)), Via(links[-1], (0.0, 0.1, 0.0)), Via(links[3], (0.0, 0.0, 0.2), 0.5)]
    tendons = [
        Tendon("a", [(n[0], 1.0), (n[3], -0.5), (n[-1], 2.0)], (), 5.0 * stiffness, damping, 0.2),
        Tendon("b", [(n[1], 0.7), (n[3], 0.5)], (), 8.0 * stiffness, 0.0, -0.3),
        Tendon("c", (), path, 20.0 * stiffness, 2.0 * damping, 0.3),
    ]
    return replace(model, tendons=tendons)


def anchored(model, damping=0.0):
    """The robot hung from the world: straight by its base, and around a drum of the world by its last link."""
    links = [link.name for link in model.links]
    drum = Wrap(None, "cylinder", 0.1, (0.1, 0.0, 2.0), (0.0, 1.0, 0.2), (0.1, 0.0, 2.5))
    straight = Via(None, (0.1, 0.0, 1.0)), Via(model.root, (0.1, 0.1, 0.0)), Via(None, (-1.0, 0.3, 1.2), 0.5)
    bent = Via(None, (1.2, 0.0, 1.5)), drum, Via(links[-1], (0.0, 0.1, 0.0))
    paths = enumerate((straight, bent))
    return replace(model, tendons=[Tendon(f"rope {k}", (), path, 30.0 + k, damping, 0.2) for k, path in paths])


def turned(tendon=None, **joint):
    """A disc about a vertical axis, with a tendon on its joint."""
    links = Link("base", 0.0, STILL, (0.0,) * 6), Link("disc", 0.5, STILL, (0.02, 0.0, 0.0, 0.02, 0.0, 0.02))
    hinge = Joint("j", "revolute", "base", "disc", axis=(0.0, 0.0, 1.0), **joint)
    return Model("wheel", links, (hinge,), tendons=[] if tendon is None else [tendon])


def state_of(scene, seed, speed=0.3):
    q, qd, _ = (x[0] for x in random_states(scene.model, 1, seed))
    return initial_state(scene, q, speed * qd)


# --- lengths and forces ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("base", ["fixed", "floating"])
def test_the_jacobian_is_how_lengths_change(base):
    """By joints; that a base moves changes none."""
    model = tied(random_tree(6, 3, base=base))
    q, qd, _ = random_states(model, 5, 1)
    h, J = 1e-6, tendon_jacobian(model, q)
    for k in range(5):
        ends = []
        for way in (h, -h):
            scene = compile_scene(model, integrator="rk4", timestep=h, gravity=STILL)
            turned = q[k].copy()
            turned[model.base_positions :] += way * qd[k][model.nv - len(model.joint_names) :]
            ends.append(tendon_lengths(scene.model, turned))
        np.testing.assert_allclose((ends[0] - ends[1]) / (2.0 * h), J[k] @ qd[k], rtol=0, atol=1e-8)
    np.testing.assert_allclose(J[..., : model.nv - 6], 0.0, atol=1e-12)


@pytest.mark.long
def test_a_mass_hung_from_the_world_bobs_with_its_period():
    """A free body below a point of the world: m x'' = -K x about rest."""
    m, K, g = 0.8, 50.0, 9.81
    body = Link("bob", m, STILL, (1e-3, 0.0, 0.0, 1e-3, 0.0, 1e-3))
    rope = Tendon("rope", (), (Via(None, (0.3, 0.2, 2.0)), Via("bob")), K)
    bob = Model("bob", [body], (), base="floating", tendons=[rope])
    low, start = 2.0 - m * g / K, np.array([0.3, 0.2, 2.0 - m * g / K - 0.1, 1.0, 0.0, 0.0, 0.0])
    scene = compile_scene(bob, integrator="dop853")
    run = simulate(scene, 0.5, initial_state(scene, start), rtol=1e-11, **QUIET)
    z = low - 0.1 * np.cos(np.sqrt(K / m) * run["time"])
    x, y = 0.3 + 0.0 * z, 0.2 + 0.0 * z
    np.testing.assert_allclose(run["base_q"][:, :3], np.column_stack([x, y, z]), rtol=0, atol=1e-9)
    assert tendon_lengths(bob, start)[0] == pytest.approx(m * g / K + 0.1, abs=1e-14)


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["dop853", "implicit_euler"])
def test_energy_of_a_robot_hung_from_the_world(integrator):
    model = anchored(random_tree(5, 3, base="floating"))
    scene = compile_scene(model, integrator=integrator, timestep=1e-4)
    run = simulate(scene, 0.05, state_of(scene, 3), rtol=1e-11, **QUIET)
    q, qd = (np.hstack([run[f"base_{name}"], run[name]]) for name in ("q", "qd"))
    total, bent = energy(model, q, qd).total, tendon_lengths(model, q)[:, 1]
    straight = replace(model.tendons[1], path=model.tendons[1].path[::2])
    assert (bent > tendon_lengths(replace(model, tendons=[straight]), q)[:, 0] + 1e-3).all()
    assert np.ptp(energy(model, q, qd).kinetic) > 0.01
    np.testing.assert_allclose(total, total[0], rtol=0, atol=1e-9 if integrator == "dop853" else 2e-3)


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["dop853", "ars343"])
def test_dampers_and_stops_of_a_hung_robot_take_what_its_energy_loses(integrator):
    """Kinetic and potential energy less the work of dampers and stops, to the accuracy of the motion."""
    model = anchored(random_tree(5, 3, base="floating"), damping=3.0)
    model = replace(model, tendons=[replace(one, lower=end) for one, end in zip(model.tendons, (1.5, 2.95))])
    scene, (rtol, error) = compile_scene(model, integrator=integrator), (1e-11, 1e-9)
    if integrator == "ars343":
        rtol, error = 1e-5, 1e-4
    run = simulate(scene, 0.05, state_of(scene, 3), record=(*ALL, "tendon_work"), rtol=rtol, **QUIET)
    q, qd = (np.hstack([run[f"base_{name}"], run[name]]) for name in ("q", "qd"))
    held, work = energy(model, q, qd), run["tendon_work"]
    assert work[-1, :, 1].max() < -1e-3
    assert np.abs(work[:, :, 2]).max() > 1e-3
    balance = held.total - work[..., 1:].sum(axis=(1, 2))
    np.testing.assert_allclose(balance, balance[0], rtol=0, atol=error)
    stored = tendon_energy(model, q)
    np.testing.assert_allclose(work[..., 0], stored[0] - stored, rtol=0, atol=error)


def test_springs_pull_by_the_slope_of_their_energy():
    model = tied(random_tree(6, 3))
    q = random_states(model, 1, 1)[0][0]
    still, bare = np.zeros(6), replace(model, tendons=())
    pull = inverse_dynamics(bare, q, still, still) - inverse_dynamics(model, q, still, still)
    h = 1e-5
    for k, e in enumerate(np.eye(6)):
        slope = (tendon_energy(model, q + h * e).sum() - tendon_energy(model, q - h * e).sum()) / (2.0 * h)
        assert pull[k] == pytest.approx(-slope, abs=1e-8)
        stored = energy(model, q, still).potential - energy(bare, q, still).potential
        assert stored == pytest.approx(tendon_energy(model, q).sum(), rel=1e-12)


# --- the implicit step -----------------------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.quick("1.0*fixed")
@pytest.mark.parametrize("base", ["fixed", "floating"])
@pytest.mark.parametrize("coupled", [False, True])
@pytest.mark.parametrize("stiffness", [1.0, 1e6])
def test_a_step_from_rest_is_that_of_the_whole_matrix(base, coupled, stiffness):
    """(M + h J' (C + h K) J) v = h (forces at the start): what rows beside the fold are to give, to rounding."""
    model = tied(random_tree(7, 3, base=base), stiffness)
    if coupled:
        joints = list(model.joints)
        joints[4] = replace(joints[4], mimic=Mimic(joints[1].name, 0.5, 0.1))
        model = replace(model, joints=joints)
    h = 1e-2  # which is also the tick
    scene = compile_scene(model, integrator="implicit_euler", timestep=h)
    scene.constants.tendons.table.fold = 1.0
    q = random_states(model, 1, 2)[0][0]
    if coupled:
        q[model.q_index(joints[4].name)] = 0.5 * q[model.q_index(joints[1].name)] + 0.1
    run = simulate(scene, h, initial_state(scene, q), record=("base_qd", "qd"), **QUIET)
    assert run.ok
    found = np.concatenate([run[name][-1] for name in ("base_qd", "qd") if run[name].size])
    J, still = tendon_jacobian(model, q), np.zeros(model.nv)
    slope = np.array([h * t.stiffness + t.damping for t in model.tendons])
    M = mass_matrix(model, q) + h * J.T @ (slope[:, None] * J)
    force = -inverse_dynamics(model, q, still, still)
    G = np.eye(model.nv)
    if coupled:
        first = model.nv - len(model.joint_names)
        G[first + 4, first + 1] = 0.5
        G = np.delete(G, first + 4, axis=1)
    exact = G @ np.linalg.solve(G.T @ M @ G, h * G.T @ force)
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-9 * np.abs(exact).max())
    assert run.info["newton_passes"] == 1


@pytest.mark.long
@pytest.mark.parametrize("integrator", FIXED)
def test_a_tendon_of_one_joint_is_the_joints_own_spring_and_stop(integrator):
    """With the coefficient c its stiffness and damping are c^2 times as large at the joint, and limits c times."""
    c, own = -0.4, {"stiffness": 0.5, "spring_reference": 0.3, "damping": 0.03}
    ends = {"lower": -0.2, "upper": 0.5}
    scenes = []
    for model in (
        turned(**own, **ends),
        turned(Tendon("t", [("j", c)], (), 0.5 / c**2, 0.03 / c**2, 0.3 * c, 0.5 * c, -0.2 * c), lower=-9.0, upper=9.0),
    ):
        scenes.append(compile_scene(model, integrator=integrator, timestep=2e-4))
    joint, along = (scene.constants for scene in scenes)
    assert along.tendons.stops.stiffness[0] * c**2 == pytest.approx(joint.stops.stiffness[0], rel=1e-12)
    runs = [simulate(scene, 0.5, initial_state(scene, [0.45], [2.0]), **QUIET) for scene in scenes]
    assert max(run["q"].max() for run in runs) > 0.5
    np.testing.assert_allclose(runs[0]["q"], runs[1]["q"], rtol=0, atol=1e-10)


@pytest.mark.long
@pytest.mark.parametrize(("integrator", "order"), [("implicit_euler", 1), ("midpoint", 2), ("rk4", 4)])
def test_order_of_fixed_steps(integrator, order):
    model = tied(random_tree(6, 3, base="floating"))
    exact_scene = compile_scene(model, integrator="dop853", gravity=STILL)
    exact = simulate(exact_scene, 0.2, state_of(exact_scene, 3), record=ALL, rtol=1e-13)
    errors = []
    for h in (2.5e-4, 1.25e-4):
        scene = compile_scene(model, integrator=integrator, timestep=h, gravity=STILL)
        scene.constants.tendons.table.fold = 1.0
        run = simulate(scene, 0.2, state_of(scene, 3), record=ALL, **QUIET)
        errors.append(max(np.abs(run[name][-1] - exact[name][-1]).max() for name in ALL))
    np.testing.assert_allclose(np.array(errors[:-1]) / errors[1:], 2.0**order, rtol=0.1)


@pytest.mark.long
@pytest.mark.parametrize(("integrator", "rtol", "error"), [("ars343", 1e-4, 1e-5), ("extrapolation", 1e-10, 1e-10)])
def test_error_control_meets_the_motion(integrator, rtol, error):
    model = tied(random_tree(6, 3, base="floating"))
    runs = []
    for name, tolerance in (("dop853", 1e-13), (integrator, rtol)):
        scene = compile_scene(model, integrator=name, gravity=STILL)
        runs.append(simulate(scene, 0.2, state_of(scene, 3), record=ALL, rtol=tolerance))
    for name in ALL:
        largest = np.abs(runs[0][name]).max()
        np.testing.assert_allclose(runs[1][name][-1], runs[0][name][-1], rtol=0, atol=error * largest)


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["midpoint", "ars343"])
def test_a_stiff_tendon_becomes_a_coupling(integrator):
    """At 1 ms, a million times what an explicit step allows: then the joints move as those of a mimic do."""
    tree = random_tree(4, 5)
    names, joints = tree.joint_names, list(tree.joints)
    joints[2] = replace(joints[2], mimic=Mimic(names[0], -0.5))
    coupled = replace(tree, joints=joints)
    stiff = replace(tree, tendons=[Tendon("t", [(names[2], 1.0), (names[0], 0.5)], (), 1e12, 1e9)])
    ends = []
    for model in (coupled, stiff):
        scene = compile_scene(model, integrator=integrator, timestep=1e-3)
        run = simulate(scene, 0.2, initial_state(scene, np.zeros(4), np.zeros(4)), **QUIET)
        assert run.ok
        ends.append(run["q"])
    assert np.ptp(ends[0]) > 0.1
    np.testing.assert_allclose(ends[0], ends[1], rtol=0, atol=1e-6 if integrator != "ars343" else 1e-3)


# --- closed forms, energy --------------------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["dop853", "midpoint"])
def test_a_slack_band_lets_a_disc_swing_freely_within(integrator):
    """A period of it is one of the spring, 2 pi / w, and two ways through the band at full speed."""
    K, speed, J, period = 2.0, 1.5, 0.02, 1.5
    band = 0.25 * speed * (period - 2.0 * math.pi * math.sqrt(J / K))
    model = turned(Tendon("t", [("j", 1.0)], (), K, 0.0, (-band, band)), lower=-9.0, upper=9.0)
    step = None if integrator != "midpoint" else 2e-4
    scene = compile_scene(model, integrator=integrator, timestep=step)
    run = simulate(scene, period, initial_state(scene, [0.0], [speed]), rtol=1e-9 if step is None else None, **QUIET)
    assert run["qd"][-1, 0] == pytest.approx(speed, abs=1e-5)
    assert run["q"][-1, 0] == pytest.approx(0.0, abs=1e-5)


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["dop853", "extrapolation"])
def test_energy_and_momentum(integrator):
    model = tied(random_tree(8, 4, base="floating"), damping=0.0)
    scene = compile_scene(model, integrator=integrator, gravity=STILL)
    run = simulate(scene, 0.5, state_of(scene, 4), record=ALL, rtol=1e-12)
    q, qd = np.hstack([run["base_q"], run["q"]]), np.hstack([run["base_qd"], run["qd"]])
    total, stored = energy(model, q, qd, gravity=STILL).total, tendon_energy(model, q).sum(axis=1)
    assert np.ptp(stored) > 0.1 * stored.max()
    np.testing.assert_allclose(total, total[0], rtol=1e-9)
    p = momentum(model, q, qd)
    np.testing.assert_allclose(p, np.broadcast_to(p[0], p.shape), rtol=0, atol=1e-8 * np.abs(p).max())


@pytest.mark.quick("rk4")
@pytest.mark.parametrize("integrator", FIXED)
def test_channels_of_tendons(integrator):
    """The force is that of the spring at the length, up to what a damper and half a step change."""
    model = tied(random_tree(6, 3), damping=0.0)
    q, qd, _ = (x[0] for x in random_states(model, 1, 3))
    how = {"record": ("q", "tendon_force", "tendon_length")}
    run = simulated(in_company(model, integrator, 1e-5), 1e-3, q, 0.3 * qd, **how)
    np.testing.assert_allclose(run["tendon_length"], tendon_lengths(model, run["q"]), rtol=0, atol=1e-15)
    expected = spring_forces(model.tendons, run["tendon_length"])
    assert np.abs(expected).max() > 1.0
    np.testing.assert_allclose(run["tendon_force"][1:], expected[1:], rtol=0, atol=1e-3 * np.abs(expected).max())


@pytest.mark.long
def test_a_robot_rests_and_its_linear_model_knows_the_tendons():
    model = tied(random_tree(5, 3), damping=0.2)
    model = replace(model, joints=[replace(j, damping=0.1) for j in model.joints])
    scene = compile_scene(model, integrator="implicit_euler", timestep=1e-3)
    rest = trim(scene, np.full(5, 0.2))
    assert rest.ok
    np.testing.assert_allclose(forward_dynamics(model, rest.q, np.zeros(5), rest.torque), 0.0, atol=1e-9)
    matrix = np.linalg.matrix_power(linearize(scene, rest.state, tau=rest.tau).A, scene.tick_steps)
    for k in range(5):
        ends = []
        for shift in (1e-4, -1e-4):
            start = initial_state(scene, rest.q + shift * np.eye(5)[k])
            run = simulate(scene, 1e-3 * scene.tick_steps, start, tau=rest.tau, record=("q", "qd"))
            ends.append(np.concatenate([run["q"][-1], run["qd"][-1]]))
        np.testing.assert_allclose(matrix[:, k], (ends[0] - ends[1]) / 2e-4, rtol=1e-5, atol=1e-5)
    loose = compile_scene(replace(model, tendons=()), integrator="implicit_euler", timestep=1e-3)
    without = linearize(loose, initial_state(loose, rest.q), tau=rest.tau).A
    assert np.abs(matrix - np.linalg.matrix_power(without, loose.tick_steps)).max() > 1e-3  # the tendons matter


# --- MuJoCo ----------------------------------------------------------------------------------------------------------


@pytest.mark.filterwarnings("error")
def test_passive_forces_are_those_of_mujoco_from_one_file(tmp_path):
    """Fixed and spatial tendons, with a dead band, a pulley and a site of the world; and from what is saved."""
    file, saved = tmp_path / "arm.xml", tmp_path / "saved.xml"
    file.write_text(FILE)
    model = load_robot(file, strict=True)
    save_robot(model, saved)
    assert load_robot(saved, strict=True).tendons == model.tendons
    damping = np.array([t.damping for t in model.tendons])
    joints = np.array([j.damping for j in model.moving_joints])
    for path in (file, saved):
        mujoco, m, d = mujoco_model(path)
        rng = np.random.default_rng(0)
        for _ in range(20):
            q, qd = rng.uniform(-1.0, 1.0, (2, 4))
            d.qpos, d.qvel = q, qd
            mujoco.mj_forward(m, d)
            lengths, J = tendon_lengths(model, q), tendon_jacobian(model, q)
            np.testing.assert_allclose(lengths, d.ten_length, rtol=0, atol=1e-13)
            force = J.T @ (spring_forces(model.tendons, lengths) - damping * (J @ qd)) - joints * qd
            largest = np.abs(d.qfrc_passive).max()
            np.testing.assert_allclose(force, d.qfrc_passive, rtol=0, atol=1e-12 * largest)
            tau = -J.T @ (damping * (J @ qd)) - joints * qd
            np.testing.assert_allclose(forward_dynamics(model, q, qd, tau), d.qacc, rtol=0, atol=1e-9 * largest)


@pytest.mark.long
def test_the_motion_is_that_of_mujoco(tmp_path):
    """From rest for half a second; MuJoCo by Runge-Kutta steps of 0.1 ms, of order 4 but for the dead band's ends."""
    file = tmp_path / "arm.xml"
    file.write_text(FILE)
    mujoco, m, d = mujoco_model(file)
    m.opt.timestep, m.opt.integrator = 1e-4, mujoco.mjtIntegrator.mjINT_RK4
    for _ in range(5000):
        mujoco.mj_step(m, d)
    run = simulate(compile_scene(load_robot(file), integrator="extrapolation"), 0.5, rtol=1e-9)
    np.testing.assert_allclose(run["q"][-1], d.qpos, rtol=0, atol=1e-6)


def test_tendons_and_what_joints_have_go_through_toml(tmp_path):
    tree = random_tree(5, 3)
    joints = [replace(joint, type="revolute", lower=-9.0, upper=9.0) for joint in tree.joints]
    model = tied(replace(tree, joints=joints))
    model = beside(replace(model, tendons=model.tendons + anchored(model).tendons))
    save_robot(model, tmp_path / "robot.urdf")
    again = load_robot(tmp_path / "robot.urdf")
    assert again.tendons == model.tendons
    assert again.joints[-3:] == model.joints[-3:]


def test_a_free_body_hung_from_sites_of_the_world_is_mujocos(tmp_path):
    file, saved = tmp_path / "hung.xml", tmp_path / "saved.xml"
    file.write_text(HUNG)
    model = load_robot(file, strict=True)
    assert [via.link for via in model.tendons[1].path] == [None, None, "bob"]
    save_robot(model, saved)
    rng = np.random.default_rng(1)
    for path in (file, saved):
        model = load_robot(path, strict=True)
        mujoco, m, d = mujoco_model(path)
        for _ in range(10):
            x, turn = rng.uniform(-0.2, 0.2, 3), rng.normal(size=4)
            q = np.concatenate([x, turn / np.linalg.norm(turn)])
            d.qpos, d.qvel = q, 0.0
            mujoco.mj_forward(m, d)
            np.testing.assert_allclose(tendon_lengths(model, q), d.ten_length, rtol=0, atol=1e-12)
            force = tendon_jacobian(model, q).T @ spring_forces(model.tendons, tendon_lengths(model, q))
            np.testing.assert_allclose(force, d.qfrc_passive, rtol=0, atol=1e-10)


# --- beside contacts and loops --------------------------------------------------------------------------------------


def pinched(stiffness, width=0.1):
    """Two boxes on one rail, which a tendon presses on each other."""
    from featherstone_gait import Box, Shape

    links = [Link("rail")]
    joints, shapes = [], []
    for name, side in (("left", -1.0), ("right", 1.0)):
        links.append(Link(name, 0.5, STILL, (1e-3, 0.0, 0.0, 1e-3, 0.0, 1e-3)))
        at, axis = (0.06 * side, 0.0, 0.0), (side, 0.0, 0.0)
        joints.append(Joint(f"{name}_slide", "prismatic", "rail", name, at, axis=axis, lower=-1.0, upper=1.0))
        shapes.append(Shape(name, Box((width, width, width))))
    squeeze = Tendon("squeeze", [("left_slide", 1.0), ("right_slide", 1.0)], (), stiffness, 0.02 * stiffness, -0.1)
    return Model("gripper", tuple(links), tuple(joints), shapes=tuple(shapes), tendons=(squeeze,))


@pytest.mark.long
@pytest.mark.parametrize("stiffness", [200.0, 2e4])
def test_a_tendon_presses_bodies_on_each_other(stiffness):
    """The contact carries what the tendon pulls, in steps that solve both together, as explicit ones of 20 us find."""
    runs = []
    for integrator, step in (("implicit_euler", 1e-3), ("rk4", 2e-5)):
        scene = compile_scene(pinched(stiffness), integrator=integrator, timestep=step, gravity=STILL, pairs="all")
        state = initial_state(scene, {"gripper": [0.0, 0.0]})
        runs.append(simulate(scene, 0.5, state, record=("q", "qd", "tendon_force", "pair_normal_force"), **QUIET))
        q, qd, pull = (runs[-1][name][-1] for name in ("q", "qd", "tendon_force"))
        assert runs[-1].ok
        assert pull[0] == pytest.approx(-stiffness * (q.sum() + 0.1 + 0.02 * qd.sum()), rel=1e-3)
        assert pull[0] < -10.0
        assert runs[-1]["pair_normal_force"][-1].sum() == pytest.approx(-pull[0], rel=1e-4)
    np.testing.assert_allclose(runs[0]["q"][-1], runs[1]["q"][-1], rtol=1e-3)


@pytest.mark.long
@pytest.mark.parametrize(("base", "integrator", "order"), [("floating", "midpoint", 2), ("fixed", "implicit_euler", 1)])
def test_a_loop_stays_closed_while_tendons_pull(base, integrator, order):
    """Slopes of tendons are in the factors in which the forces of loops are found, and in those that close them."""
    model = tied(random_tree(6, 3, base=base))
    rod = Loop("rod", "distance", model.links[-1].name, None, (0.1, 0.0, 0.0), (1.0, 0.5, 0.3), distance=2.0)
    model = replace(model, loops=[rod])
    q = close_loops(model, random_states(model, 1, 2)[0][0])
    ends = []
    for name, h in (("rk4", 1e-5), (integrator, 1e-4), (integrator, 5e-5)):
        scene = compile_scene(model, integrator=name, timestep=h)
        scene.constants.tendons.table.fold = 1.0
        run = simulate(scene, 0.02, initial_state(scene, q), record=("base_q", "q"), **QUIET)
        ends.append(np.concatenate([run["base_q"][-1], run["q"][-1]]))
        assert run.ok
        assert np.abs(loop_gaps(model, ends[-1])).max() < 1e-11
    errors = [np.abs(end - ends[0]).max() for end in ends[1:]]
    assert errors[0] / errors[1] == pytest.approx(2.0**order, rel=0.05)


# --- refusals --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"joints": ()}, "tendon 't': has neither joints nor a path; give one of them"),
        ({"joints": [("j", 0.0)]}, "coefficient of joint 'j' is 0.0; expected a number other than 0"),
        ({"joints": [("j", 1.0), ("j", 2.0)]}, "joint 'j' is given 2 times"),
        ({"joints": ["j"]}, "joints has 'j'; expected a name and a coefficient"),
        ({"joints": (), "path": [Via("disc")]}, "path has no length; give two points or more"),
        ({"stiffness": -1.0}, r"stiffness is -1.0 \[N/m or N m/rad\]; expected >= 0"),
        ({"rest": (1.0, 0.0)}, r"rest is \(1.0, 0.0\); expected a length, or a range that rises"),
        ({"lower": 1.0, "upper": 1.0}, "limits lower 1.0, upper 1.0; lower must be below upper"),
    ],
)
def test_a_wrong_tendon_is_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        Tendon(**({"name": "t", "joints": [("j", 1.0)]} | changes))


def test_names_that_do_not_exist_are_refused():
    with pytest.raises(ValueError, match=r"tendon 't': joint 'k' does not exist; joints of one degree .* are 'j'"):
        turned(Tendon("t", [("k", 1.0)]))
    with pytest.raises(ValueError, match="tendon 't': there is no link 'hub'; links are 'base', 'disc'"):
        turned(Tendon("t", (), [Via("base"), Via("hub")]))


# ---------------------------------------------------------------------------------------------- antagonists


def antagonists():
    """An arm that falls from level, with tendons straight through its axis at rest: no moment arm at zero."""
    links = (Link("post"), Link("bar", 0.5, (0.15, 0.0, 0.0), (1e-4, 0.0, 0.0, 3.75e-3, 0.0, 3.75e-3)))
    hinge = Joint("hinge", "revolute", "post", "bar", axis=(0.0, 1.0, 0.0), lower=-2.0, upper=2.0)
    path = (Via("post", (-0.2, 0.0, 0.0)), Via("bar", (0.1, 0.0, 0.0)))
    pair = [Tendon("far", (), path, lower=0.0, upper=0.3), Tendon("near", (), path, lower=0.26, upper=1.0)]
    return Model("antagonists", links, (hinge,), tendons=pair)


@pytest.mark.nojit
def test_stops_of_tendons_without_a_moment_arm_at_zero_are_damped_as_where_they_have_one():
    """Critically, to a factor of ten, where the moment arm is largest."""
    model = antagonists()
    assert np.array_equal(tendon_jacobian(model, np.zeros(1)), np.zeros((2, 1)))
    stops = compile_scene(model).constants.tendons.stops
    arm = np.abs(tendon_jacobian(model, np.linspace(-2.0, 2.0, 401)[:, None])).max(axis=0)[:, 0]
    critical = 2.0 * np.sqrt(mass_matrix(model, np.zeros(1))[0, 0] / arm**2 / stops.stiffness) / 1e-3
    assert (stops.damping > critical).all()
    assert (stops.damping < 11.0 * critical).all()


@pytest.mark.long
def test_an_arm_comes_to_rest_on_a_tendon_without_a_moment_arm_at_zero():
    """Its stop then holds the weight: K x r = m g c cos q."""
    model = antagonists()
    scene = compile_scene(model)
    run = simulate(scene, 3.0)
    q = run["q"][-1]
    assert run.ok
    depth, r = 0.26 - tendon_lengths(model, q)[1], -tendon_jacobian(model, q)[1, 0]
    held = scene.constants.tendons.stops.stiffness[1] * depth * r
    assert held == pytest.approx(0.5 * 9.81 * 0.15 * math.cos(q[0]), rel=1e-3)


@pytest.mark.nojit
def test_a_step_that_is_too_small_names_the_tendon_beyond_its_limit():
    from featherstone_gait.run.classify import _failure
    from featherstone_gait.run.status import Status

    scene = compile_scene(antagonists())
    message = _failure(scene, Status.STEP_TOO_SMALL, initial_state(scene, [1.2])).message
    # sqrt(0.05 + 0.04 cos 1.2) = 0.25396 m
    assert "where tendon 'near' is 0.00604 m or rad beyond its limit of 0.26: check this limit" in message
    assert "tendon" not in _failure(scene, Status.STEP_TOO_SMALL, initial_state(scene, [0.1])).message
