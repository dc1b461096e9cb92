"""Drives of tendons: servo laws and forces along a length, alone, against MuJoCo, and with the same bits everywhere."""

import math
from dataclasses import replace

import numpy as np
import pytest
from company import AT_REST, begun, in_company, simulated
from mujoco_oracle import mujoco_model
from random_tree import random_tree
from test_ball_springs import top, turned_by
from test_wrapping import wound

from featherstone_gait import (
    Controller,
    Joint,
    Link,
    Model,
    Placed,
    Reference,
    SceneModel,
    Session,
    Spring,
    Tendon,
    Via,
    Wrap,
    compile_scene,
    energy,
    linearize,
    load_robot,
    load_scene,
    mass_matrix,
    save_robot,
    save_scene,
    simulate,
    simulate_batch,
    tendon_jacobian,
    tendon_lengths,
)
from featherstone_gait.dynamics import tendon_energy
from featherstone_gait.run.simulate import initial_state

QUIET = {"estimate_error": False}
ALL = ("q", "qd", "tendon_force")
FILE = """<mujoco><compiler autolimits="true"/><worldbody><site name="w" pos=".3 .3 1"/>
<body pos="0 0 1"><joint name="a" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 .2 0 0" size=".02" mass=".3"/>
<body pos=".2 0 0"><joint name="b" axis="0 1 1"/><geom type="box" size=".03 .05 .02" pos=".1 0 .02" mass=".2"/>
<site name="s1" pos=".1 .05 .02"/><body pos=".2 0 0"><joint name="c" type="slide" axis="0 0 1" damping="3"/>
<geom size=".03" mass=".1"/><site name="s2" pos="0 .05 .02"/></body></body></body></worldbody>
<tendon><fixed name="idle" stiffness="1"><joint joint="a" coef="1"/><joint joint="b" coef="1"/></fixed>
<fixed name="moved"><joint joint="a" coef="1"/><joint joint="c" coef="3"/></fixed>
<fixed name="held" damping=".2"><joint joint="a" coef=".7"/><joint joint="b" coef="-.5"/></fixed>
<spatial name="pulled"><site site="w"/><site site="s1"/><site site="s2"/></spatial>
<fixed name="slowed"><joint joint="b" coef="1"/><joint joint="c" coef="-2"/></fixed></tendon>
<actuator><motor tendon="moved" gear="-2"/><position tendon="held" kp="4" kv=".3" gear="1.5" forcerange="-1.2 1.2"/>
<general tendon="pulled" biastype="affine" gainprm="13" biasprm="2 -20 -1"/>
<velocity tendon="slowed" kv=".4"/></actuator></mujoco>"""
KP, KD = (0.0, 9.0, 20.0, 0.0), (0.0, 0.675, 1.0, 0.4)


def arm():
    """A random arm with a spring, a drive along joints, one along a path, and a motor."""
    tree = random_tree(5, 3)
    n, links = tree.joint_names, [link.name for link in tree.links]
    path = Via(links[1]), Via(links[-1], (0.0, 0.1, 0.0))
    clamped = Controller("pd_clamped", 30.0, Kd=2.0, torque_limit=4.0)
    tendons = [
        Tendon("spring", [(n[0], 1.0), (n[1], 1.0)], (), 2.0),
        Tendon("coupled", [(n[0], 1.0), (n[3], -0.5)], controller=clamped),
        Tendon("cable", (), path, controller=Controller("pd", 40.0, Kd=1.0)),
        Tendon("motor", [(n[2], 1.0), (n[4], 2.0)], controller=Controller("pd")),
    ]
    return replace(tree, tendons=tendons)


def drive_forces(model, reference, tau, lengths, rates):
    """Return the forces of drives by their law, one a tendon, 0 of those without."""
    out = np.zeros(len(model.tendons))
    driven = [k for k, one in enumerate(model.tendons) if one.controller]
    for k, goal, push in zip(driven, reference, tau):
        law = model.tendons[k].controller
        spring, damper, limit = law.Kp * (goal - lengths[k]), -law.Kd * rates[k], law.torque_limit
        inside, outside = (spring, damper) if law.law == "pd" else (spring + damper, 0.0)
        out[k] = np.clip(inside, -limit, limit) + outside + push
    return out


@pytest.mark.filterwarnings("error")
def test_drives_are_mujocos_actuators(tmp_path):
    """Accelerations with controls between and beyond the limits of forces, from the file and from what is saved."""
    file, saved = tmp_path / "arm.xml", tmp_path / "saved.xml"
    file.write_text(FILE)
    with pytest.warns(match="took the tendon's length as the reference"):
        model = load_robot(file)
    laws = [one.controller for one in model.tendons]
    assert laws[0] is None
    assert [law.Kp for law in laws[1:]] == pytest.approx(KP)
    assert [law.Kd for law in laws[1:]] == pytest.approx(KD)
    assert laws[2].torque_limit == pytest.approx(1.8)
    save_robot(model, saved)
    assert load_robot(saved, strict=True).tendons == model.tendons
    mujoco, m, d = mujoco_model(file)
    scene = in_company(model, "rk4", 1e-6)
    rng, clamped = np.random.default_rng(0), 0
    for _ in range(20):
        (q, qd), u = rng.uniform(-1.0, 1.0, (2, 3)), rng.uniform(-0.5, 0.5, 4)
        goal = [0.0, u[1] / 1.5, (13.0 * u[2] + 2.0) / 20.0, 0.0]
        push = [-2.0 * u[0], 0.0, 0.0, 0.4 * u[3]]
        signals = Reference([0.0], [[0.0, 0.0, 0.0, *goal]]), [0.0, 0.0, 0.0, *push]
        run = simulated(scene, 1e-6, q, qd, *signals, record=("q", "qd", "qdd", "tendon_force"), record_interval=1e-6)
        q, qd = (run[name][1] for name in ("q", "qd"))
        d.qpos, d.qvel, d.ctrl = q, qd, u
        mujoco.mj_forward(m, d)
        clamped += abs(d.actuator_force[1]) == 1.2
        np.testing.assert_allclose(run["qdd"][1], d.qacc, rtol=0, atol=1e-10 * np.abs(d.qacc).max())
        lengths, rates = tendon_lengths(model, q), tendon_jacobian(model, q) @ qd
        expected = drive_forces(model, goal, push, lengths, rates)[1:]
        expected[1] -= 0.2 * rates[2]
        np.testing.assert_allclose(run["tendon_force"][1, 1:], expected, rtol=0, atol=1e-9)
    assert 0 < clamped < 20


def test_the_work_of_tendons_closes_the_balance_of_energy(tmp_path):
    """Drives within and beyond their limit, dampers and a force from outside: each by what it does along its length."""
    (tmp_path / "arm.xml").write_text(FILE)
    with pytest.warns(match="took the tendon's length as the reference"):
        model = load_robot(tmp_path / "arm.xml")
    goal, push = [0.0, 0.4, 0.6, 0.0], [0.5, 0.0, 0.2, -0.3]
    run = simulated(in_company(model, "rk4", 1e-4), 0.2, np.full(3, 0.2), [3.0, -2.0, 1.0],
                Reference([0.0], [[0.0, 0.0, 0.0, *goal]]), [0.0, 0.0, 0.0, *push], record_interval=0.02,
                record=("q", "qd", "energy", "tendon_work", "tendon_length"))  # fmt: skip
    work, held = run["tendon_work"], energy(model, run["q"], run["qd"]).total
    lost = run["energy"][..., 4].sum(axis=1)
    balance = held + lost - work[..., 1:].sum(axis=(1, 2))
    assert (np.abs(work[-1]).max(axis=0)[[0, 1, 3]] > (1e-3, 1e-3, 1e-2)).all()
    assert np.ptp(held) > 0.1
    np.testing.assert_allclose(balance, balance[0], rtol=0, atol=1e-9)
    stored = tendon_energy(model, run["q"])
    np.testing.assert_allclose(work[..., 0], stored[0] - stored, rtol=0, atol=1e-9)
    way = run["tendon_length"][:, 1] - run["tendon_length"][0, 1]
    np.testing.assert_allclose(work[:, 1, 3], push[0] * way, rtol=0, atol=1e-9)  # of a motor
    assert not work[..., [2, 4]].any()


@pytest.mark.long
@pytest.mark.parametrize("reference", [(0.1, 0.5, 0.0), (9.0, 0.5, 0.0)])
def test_one_implicit_step_is_a_dense_solution(reference):
    """(M + h J' (K h + C) J) a = J' f, with a drive beyond its limit or within."""
    model, h = arm(), 2e-3
    scene = compile_scene(model, integrator="implicit_euler", timestep=h, gravity=(0.0, 0.0, 0.0))
    for table in (scene.constants.tendons.table, scene.constants.tendons.drives):
        table.fold = 1.0
    q, tau = np.linspace(-0.4, 0.5, 5), np.array([0.0, 0.0, 0.7])
    signal = Reference([0.0], [[*q, *reference]])
    run = simulate(scene, h, initial_state(scene, q), signal, [*np.zeros(5), *tau], (), ("qd",), h, **QUIET)
    lengths, J = tendon_lengths(model, q), tendon_jacobian(model, q)
    K, C = np.zeros(4), np.zeros(4)
    K[0] = 2.0
    f = drive_forces(model, reference, tau, lengths, np.zeros(4))
    f[0] = -2.0 * lengths[0]
    for k, one in enumerate(model.tendons[1:], 1):
        free = one.controller.law == "pd" or abs(f[k]) < one.controller.torque_limit
        K[k], C[k] = (one.controller.Kp, one.controller.Kd) if free else (0.0, 0.0)
    qd = h * np.linalg.solve(mass_matrix(model, q) + h * J.T @ np.diag(h * K + C) @ J, J.T @ f)
    np.testing.assert_allclose(run["qd"][1], qd, rtol=0, atol=1e-11 * np.abs(qd).max())


def test_a_reference_of_joints_alone_holds_the_tendons(tmp_path):
    """A drive without a column holds the length of its tendon at the start, and gets no force from outside."""
    model = arm()
    scene = in_company(model, "implicit_euler", 2e-3, gravity=(0.0, 0.0, 0.0))
    q = np.linspace(-0.4, 0.5, 5)
    start, lengths = begun(scene, q), tendon_lengths(scene.model, [*q, *AT_REST])
    given = Reference([0.0], [[*q, *np.zeros(5), *lengths[1:5]]])
    runs = [simulate(scene, 0.02, start, one, np.zeros(n), record=ALL, **QUIET) for one, n in ((None, 10), (given, 14))]
    for name in ALL:
        np.testing.assert_array_equal(runs[0][name], runs[1][name])
    with pytest.raises(ValueError, match=r"tau has 6 columns; .* has 10 joints: .*, and 4 driven tendons: coupled"):
        simulate(scene, 0.02, start, tau=Reference([0.0], np.zeros((1, 6))))
    save_robot(replace(model, joints=[replace(j, type="continuous") for j in model.joints]), tmp_path / "arm.urdf")
    assert load_robot(tmp_path / "arm.urdf").tendons == model.tendons


@pytest.mark.long
def test_a_session_commands_tendons_after_joints():
    model = arm()
    scene = compile_scene(model, integrator="implicit_euler", timestep=2e-3, gravity=(0.0, 0.0, 0.0))
    q = np.linspace(-0.4, 0.5, 5)
    goal = np.array([*q, 0.3, 0.6, 0.0])
    run = simulate(scene, 5 * scene.tick_steps * 2e-3, initial_state(scene, q), Reference([0.0], [goal]), **QUIET)
    with Session(scene, observe=("q",)) as session:
        session.reset(state=initial_state(scene, q))
        for _ in range(5):
            session.step(goal)
        np.testing.assert_array_equal(session.state[0], run.final)
        with pytest.raises(ValueError, match=r"give \(1, 8\) or \(8,\), of .*, coupled, cable, motor"):
            session.step(q)


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["dop853", "ars343", "extrapolation", "midpoint"])
def test_all_integrators_find_one_motion(integrator):
    """A drive that begins beyond its limit, follows a cubic reference and bears a force that changes at knots."""
    model = arm()
    q = np.linspace(-0.4, 0.5, 5)
    times = [0.0, 0.1, 0.2, 0.3]
    goals = np.outer(np.ones(4), [*q, 0.0, 0.6, 0.0])
    goals[:, 5:] += np.outer([1.0, 0.2, -0.5, 0.1], [1.0, 0.3, 0.0])
    pushes = np.outer([0.0, 0.05, -0.05, 0.02], [0.0] * 7 + [1.0])
    ends = []
    for name, step in (("rk4", 2e-5), (integrator, 2e-5 if integrator == "midpoint" else None)):
        scene = compile_scene(model, integrator=name, timestep=step)
        tolerance = {} if step else {"rtol": 1e-9}
        run = simulate(scene, 0.3, initial_state(scene, q), Reference(times, goals, "cubic"), Reference(times, pushes),
                       record=("q", "qd"), **tolerance, **QUIET)  # fmt: skip
        assert run.ok
        ends.append(run["q"][-1])
    assert np.abs(ends[0] - q).max() > 0.3
    np.testing.assert_allclose(ends[1], ends[0], rtol=0, atol=1e-5)


@pytest.mark.long
def test_a_linear_model_knows_references_and_forces_of_tendons():
    model = arm()
    scene = compile_scene(model, integrator="implicit_euler", timestep=1e-3)
    state, h = initial_state(scene, np.linspace(-0.4, 0.5, 5)), 1e-5
    found = linearize(scene, state, inputs=("reference", "torque"))
    names = [name.split()[-1] for name in found.inputs[5:8]]
    assert names == ["coupled", "cable", "motor"]
    lengths = tendon_lengths(model, np.linspace(-0.4, 0.5, 5))[1:]
    for k in range(3):
        ends = []
        for sign in (1.0, -1.0):
            tau = np.zeros(8)
            tau[5 + k] = sign * h
            goal = Reference([0.0], [[*np.zeros(5), *lengths]])
            ends.append(simulate(scene, 1e-3, state, goal, tau, (), ("qd",), 1e-3, **QUIET)["qd"][1])
        slope = (ends[0] - ends[1]) / (2.0 * h)
        np.testing.assert_allclose(found.B[found.of("qd"), 13 + k], slope, rtol=1e-6, atol=1e-8)
    assert np.abs(found.B[:, 5]).max() > 1e-3
    assert not found.B[:, 7].any()  # a motor follows no reference


@pytest.mark.long
@pytest.mark.nojit
@pytest.mark.parametrize("integrator", ["midpoint", pytest.param("rk4", marks=pytest.mark.bounds)])
def test_eight_at_once_have_the_bits_of_one(integrator):
    """With all that is passive: drag, springs, friction, ball joints, couplings, drives and cords around shapes."""
    ball, body = top(offset=(0.1, 0.2, -0.1), stiffness=3.0, upper=1.0), wound()
    drag = {"damping": 0.2, "quadratic_damping": -0.2, "cubic_damping": 0.1}
    joints = [*(replace(one, **drag) for one in body.joints), replace(ball.joints[0], parent=body.root, child="top")]
    links = *body.links, replace(ball.links[1], name="top")
    rubbing = [replace(one, friction=2.0) for one in body.tendons]
    model = replace(body, links=links, joints=joints, tendons=[*rubbing, *arm().tendons])
    spring = Spring(body.root, "top", (0.5, 0.0, 0.0), (0.0, 0.0, 0.1), 20.0, 0.2, 0.3)
    scene = in_company(model, integrator, 1e-3, springs=[spring])
    rng, record = np.random.default_rng(0), (*ALL, "energy")
    q, qd = rng.normal(size=(8, 6)), rng.normal(size=(8, 9))
    states = [begun(scene, [*x, *turned_by(*x[:3])], v) for x, v in zip(q, qd)]
    goals = [Reference([0.0], [goal]) for goal in rng.uniform(-1.0, 1.0, (8, scene.inputs))]
    taus = list(rng.uniform(-0.1, 0.1, (8, scene.inputs)))
    batch = simulate_batch(scene, 0.01, states, goals, taus, record=record, **QUIET)
    for run, *given in zip(batch, states, goals, taus):
        alone = simulate(scene, 0.01, *given, record=record, **QUIET)
        for name in record:
            np.testing.assert_array_equal(run[name], alone[name])


@pytest.mark.parametrize(
    ("law", "message"),
    [
        (Controller("pid_speed"), "its controller has the law 'pid_speed'; expected one of 'pd', 'pd_clamped'"),
        (Controller("pd", wrap=True), "tendon 't': its controller has wrap=True, and a length is no angle"),
        (3.0, "tendon 't': controller is 3.0; expected a Controller"),
    ],
)
def test_a_wrong_controller_is_refused(law, message):
    with pytest.raises(ValueError, match=message):
        Tendon("t", [("j", 1.0)], controller=law)


def test_drives_and_wraps_of_a_scene_are_written_and_read(tmp_path):
    """Names of tendons, of what drives them and of what they run around have that of their robot before them."""
    pytest.importorskip("mujoco")
    bob = Link("bob", 0.5, (0.0, 0.0, -0.5), (0.1, 0.0, 0.0, 0.1, 0.0, 0.1))
    links = Link("base", 0.0, (0.0,) * 3, (0.0,) * 6), bob
    hinge = Joint("j", "continuous", "base", "bob", axis=(0.0, 1.0, 0.0))
    drum = Wrap("base", "cylinder", 0.1, (0.2, 0.0, -0.2), (0.0, 1.0, 0.0), (0.6, 0.0, -0.2))
    path = Via("base", (0.3, 0.0, 0.2)), drum, Via("bob", (0.0, 0.0, -0.5))
    law = Controller("pd_clamped", 30.0, Kd=1.0, torque_limit=4.0)
    model = Model("crane", links, (hinge,), tendons=(Tendon("cord", (), path, controller=law),))
    save_scene(SceneModel("two", (Placed(model, "a"), Placed(model, "b", position=(1.0, 0.0)))), tmp_path / "two.xml")
    for one in load_scene(tmp_path / "two.xml", strict=True).members:
        (found,) = one.model.tendons
        assert (found.controller, [type(part) for part in found.path]) == (law, [Via, Wrap, Via])
        assert found.path[1].side == drum.side


def test_sampled_servos_and_followed_lengths_do_not_mix():
    model = load_robot("arm7")
    drive = Tendon("t", [(model.joint_names[0], 1.0), (model.joint_names[1], 1.0)], controller=Controller("pd", 3.0))
    with pytest.raises(ValueError, match="controllers of tendons follow their references at every instant"):
        compile_scene(replace(model, tendons=[drive]), gearbox="rotor")
    assert math.isfinite(compile_scene(replace(model, tendons=[drive])).timestep)
