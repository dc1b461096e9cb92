"""Dry friction and inertia of tendons: MuJoCo from one file, closed forms, energy, orders, and the same bits."""

import math
from dataclasses import replace

import numpy as np
import pytest
from company import in_company, simulated
from mujoco_oracle import mujoco_model
from random_tree import random_states, random_tree
from test_tendons import state_of, tied, turned

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
    load_robot,
    mass_matrix,
    save_robot,
    simulate,
    tendon_lengths,
)
from featherstone_gait.run.simulate import initial_state

QUIET = {"estimate_error": False}
ALL = ("base_q", "q", "base_qd", "qd", "tendon_force", "tendon_work")
STILL = (0.0, 0.0, 0.0)
FILE = """<mujoco><compiler autolimits="true"/>
<option tolerance="0" iterations="200" ls_iterations="200" ls_tolerance="0"/>
<worldbody><site name="w" pos=".3 .3 1"/><body pos="0 0 1"><joint name="a" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 .2 0 0" size=".02" mass=".3"/><site name="s0" pos=".05 .03 0"/>
<body pos=".2 0 0"><joint name="b" axis="0 1 1"/><geom type="box" size=".03 .05 .02" pos=".1 0 .02" mass=".2"/>
<site name="s1" pos=".1 .05 .02"/><body pos=".2 0 0"><joint name="c" type="slide" axis="0 0 1" damping="3"/>
<geom size=".03" mass=".1"/><site name="s2" pos="0 .05 .02"/></body></body></body></worldbody>
<tendon><fixed name="t" armature=".02" damping=".1"><joint joint="a" coef="1"/><joint joint="c" coef="3"/></fixed>
<fixed name="u" frictionloss=".3"><joint joint="a" coef=".7"/><joint joint="b" coef="-.5"/></fixed>
<spatial name="p" stiffness="20" armature=".6" frictionloss=".7"><site site="w"/><site site="s1"/><site site="s2"/>
<pulley divisor="2"/><site site="s0"/><site site="s2"/></spatial></tendon>
<actuator><motor tendon="p" gear="2" armature=".05" damping=".2"/></actuator></mujoco>"""


def heavy(model, armature=0.3, friction=0.0):
    """The robot with tendons of inertia and friction, of joints and along a path."""
    return replace(model, tendons=[replace(t, armature=armature, friction=friction) for t in tied(model).tendons])


def slider(mass=2.0, **tendon):
    """A mass that slides down, held by a tendon of twice its way."""
    links = Link("wall"), Link("block", mass, STILL, (0.01, 0.0, 0.0, 0.01, 0.0, 0.01))
    joint = Joint("z", "prismatic", "wall", "block", axis=(0.0, 0.0, -1.0), lower=-9.0, upper=9.0)
    return Model("slider", links, (joint,), tendons=[Tendon("t", [("z", 2.0)], **tendon)])


@pytest.mark.filterwarnings("error")
def test_accelerations_are_mujocos_while_all_slide(tmp_path):
    """From the file and from what is saved; inertia of a path with its bias m J' Jdot qd."""
    file, saved = tmp_path / "arm.xml", tmp_path / "saved.xml"
    file.write_text(FILE)
    model = load_robot(file, strict=True)
    found = [(one.armature, one.friction, one.damping) for one in model.tendons]
    assert found == [(0.02, 0.0, 0.1), (0.0, 0.3, 0.0), (0.8, 0.7, 0.8)]
    save_robot(model, saved)
    assert load_robot(saved, strict=True).tendons == model.tendons
    mujoco, m, d = mujoco_model(file)
    scene = in_company(model, "rk4", 1e-6)
    rng, found = np.random.default_rng(0), []
    while len(found) < 20:
        q, qd = rng.uniform(-1.0, 1.0, (2, 3))
        run = simulated(scene, 1e-6, q, 3.0 * qd, record=("q", "qd", "qdd"), record_interval=1e-6)
        d.qpos, d.qvel = run["q"][1], run["qd"][1]
        mujoco.mj_forward(m, d)
        if (d.efc_force[:2] == -m.tendon_frictionloss[1:] * np.sign(d.ten_velocity[1:])).all():  # it is soft about rest
            found.append(np.abs(run["qdd"][1] - d.qacc).max() / np.abs(d.qacc).max())
    assert max(found) < 1e-9


def test_inertia_is_in_the_functions_of_the_model():
    """M + m J' J, forward and inverse dynamics that undo each other, and MuJoCo's kinetic energy by J qd."""
    for base in ("fixed", "floating"):
        model, rng = heavy(random_tree(6, 3, base=base)), np.random.default_rng(1)
        bare = replace(model, tendons=[replace(one, armature=0.0) for one in model.tendons])
        q = rng.uniform(-1.0, 1.0, model.nq)
        qd, tau = rng.uniform(-1.0, 1.0, (2, model.nv))
        M = mass_matrix(model, q)
        qdd = forward_dynamics(model, q, qd, tau)
        np.testing.assert_allclose(inverse_dynamics(model, q, qd, qdd), tau, rtol=0, atol=1e-10)
        assert energy(model, q, qd).kinetic == pytest.approx(0.5 * qd @ M @ qd, rel=1e-12)
        assert energy(model, q, qd).kinetic > energy(bare, q, qd).kinetic + 1e-3
        bias = inverse_dynamics(model, q, qd, np.zeros(model.nv))
        np.testing.assert_allclose(M @ qdd + bias, tau, rtol=0, atol=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["dop853", "ars343", "midpoint"])
def test_a_mass_falls_as_if_it_were_heavier(integrator):
    """(m + c^2 a) x'' = m g, exactly at each step of constant acceleration."""
    mass, a = 2.0, 0.4
    scene = compile_scene(slider(mass, armature=a), integrator=integrator)
    run = simulate(scene, 0.5, **QUIET)
    assert run["qd"][-1, 0] == pytest.approx(0.5 * mass * 9.81 / (mass + 4.0 * a), rel=1e-9)


@pytest.mark.long
@pytest.mark.parametrize(
    ("integrator", "order", "base"),
    [("implicit_euler", 1, "fixed"), ("midpoint", 2, "floating"), ("rk4", 4, "floating")],
)
def test_order_and_energy_with_inertia(integrator, order, base):
    model = heavy(random_tree(6, 3, base=base))
    model = replace(model, tendons=[replace(one, damping=0.0) for one in model.tendons])
    exact_scene = compile_scene(model, integrator="dop853", gravity=STILL)
    exact = simulate(exact_scene, 0.1, state_of(exact_scene, 3), record=ALL, rtol=1e-13)
    q, qd = np.hstack([exact["base_q"], exact["q"]]), np.hstack([exact["base_qd"], exact["qd"]])
    held = energy(model, q, qd, gravity=STILL)
    assert np.ptp(held.kinetic) > 1e-3
    np.testing.assert_allclose(held.total, held.total[0], rtol=1e-9)
    errors = []
    for h in (1e-3, 5e-4) if integrator == "rk4" else (2.5e-4, 1.25e-4):
        scene = compile_scene(model, integrator=integrator, timestep=h, gravity=STILL)
        run = simulate(scene, 0.1, state_of(scene, 3), record=ALL, **QUIET)
        errors.append(max(np.abs(run[name][-1] - exact[name][-1]).max(initial=0.0) for name in ALL[:4]))
    assert errors[0] / errors[1] == pytest.approx(2.0**order, rel=0.15)


@pytest.mark.long
@pytest.mark.parametrize("base", ["fixed", "floating"])
def test_loops_and_couplings_beside_inertia(base):
    """What a run finds beside a loop and a mimic is what forward dynamics finds by unit forces along the tendons."""
    model = heavy(random_tree(6, 3, base=base))
    joints = list(model.joints)
    joints[4] = replace(joints[4], mimic=Mimic(joints[1].name, 0.5, 0.1))
    rod = Loop("rod", "distance", model.links[-1].name, None, (0.1, 0.0, 0.0), (1.0, 0.5, 0.3), distance=2.0)
    model = replace(model, joints=joints, loops=[rod])
    model = replace(model, tendons=[replace(one, damping=0.0) for one in model.tendons])
    q = close_loops(model, random_states(model, 1, 2)[0][0])
    scene = compile_scene(model, integrator="rk4", timestep=1e-6)
    run = simulate(scene, 5e-3, initial_state(scene, q), record=(*ALL, "qdd"), record_interval=1e-3, **QUIET)
    q, qd = (np.hstack([run[f"base_{name}"], run[name]])[-1] for name in ("q", "qd"))
    found = forward_dynamics(model, q, qd, np.zeros(model.nv))[model.nv - 6 :]
    assert np.abs(qd).max() > 1e-2
    np.testing.assert_allclose(run["qdd"][-1], found, rtol=0, atol=1e-5 * np.abs(found).max())


@pytest.mark.quick("implicit_euler")
@pytest.mark.parametrize("integrator", ["implicit_euler", "midpoint", "ars343", "extrapolation"])
def test_friction_holds_a_mass_that_is_light_enough(integrator):
    """m g < c F: a mass at rest stays; one that moves stops by (c F - m g) / m, and gives its energy to friction."""
    mass, F, speed = 2.0, 15.0, 0.3
    slow = (2.0 * F - mass * 9.81) / mass
    end = speed / slow
    scene = in_company(slider(mass, friction=F), integrator, 1e-3)
    still = simulated(scene, 0.2)
    assert np.abs(still["q"]).max() < 1e-12
    run = simulated(scene, 0.2, [0.0], [speed], record=("q", "qd", "tendon_work"))
    assert end < 0.15
    assert abs(run["qd"][-1, 0]) < 1e-11
    assert run["q"][-1, 0] == pytest.approx(0.5 * speed * end, abs=2e-4)
    lost = 0.5 * mass * speed**2 + mass * 9.81 * run["q"][-1, 0]
    assert -run["tendon_work"][-1, 0, 4] == pytest.approx(lost, rel=1e-2 if integrator == "implicit_euler" else 1e-3)
    assert not run["tendon_work"][..., :4].any()


@pytest.mark.long
def test_friction_between_joints_holds_their_sum_while_they_move():
    """Two discs whose sum of angles is held: they turn against each other as the tree with a mimic does."""
    tree = random_tree(4, 5)
    n, joints = tree.joint_names, list(tree.joints)
    joints[2] = replace(joints[2], mimic=Mimic(n[0], -0.5))
    held = replace(tree, tendons=[Tendon("t", [(n[2], 1.0), (n[0], 0.5)], friction=1e4)])
    ends = []
    for model in (replace(tree, joints=joints), held):
        for integrator in ("implicit_euler", "midpoint"):
            scene = compile_scene(model, integrator=integrator, timestep=1e-3)
            run = simulate(scene, 0.2, initial_state(scene, np.zeros(4), np.zeros(4)), **QUIET)
            assert run.ok
            ends.append(run["q"])
    assert np.ptp(ends[0]) > 0.1
    for k in range(2):
        np.testing.assert_allclose(ends[k], ends[2 + k], rtol=0, atol=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["dop853", "rk4"])
def test_explicit_steps_see_a_softer_friction(integrator):
    """A loaded mass creeps at the load's share of 1 mm/s, and the second run says that this is an error."""
    mass, F = 2.0, 15.0
    scene = compile_scene(slider(mass, friction=F), integrator=integrator, timestep=1e-5)
    run = simulate(scene, 0.05, record=("q", "qd"))
    assert run["qd"][-1, 0] == pytest.approx(0.5e-3 * mass * 9.81 / (2.0 * F), rel=1e-3)
    assert scene.preflight.worst.cause == "Coulomb friction"
    if integrator == "dop853":
        assert run.error["q"][-1, 0] > 0.5 * run["q"][-1, 0]


def test_inertia_around_a_shape_is_refused(tmp_path):
    path = Via("base", (0.3, 0.0, 0.0)), Wrap("base", "sphere", 0.05), Via("disc", (0.0, 0.2, 0.0))
    with pytest.raises(ValueError, match=r"tendon 't': armature is 0\.5, and its path has a Wrap"):
        Tendon("t", path=path, armature=0.5)
    with pytest.raises(ValueError, match=r"friction is -1.0 \[N or N m\]; expected >= 0"):
        Tendon("t", [("j", 1.0)], friction=-1.0)
    model = turned(Tendon("t", [("j", 1.0)], friction=0.2, armature=0.1), lower=-9.0, upper=9.0)
    save_robot(model, tmp_path / "wheel.urdf")
    assert load_robot(tmp_path / "wheel.urdf").tendons == model.tendons
    assert math.isfinite(tendon_lengths(model, [0.3])[0])
