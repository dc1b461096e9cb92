"""Springs of joints: closed forms, MuJoCo with the same file, energy, linear models, and the same bits in any width."""

from dataclasses import replace

import numpy as np
import pytest
from company import in_company, simulated
from mujoco_oracle import mujoco_model
from random_tree import random_states, random_tree
from scipy.linalg import expm

from featherstone_gait import (
    Joint,
    Link,
    Model,
    Reference,
    Worlds,
    compile_scene,
    energy,
    forward_dynamics,
    inverse_dynamics,
    linearize,
    load_robot,
    load_servo,
    save_robot,
    simulate,
    simulate_batch,
    trim,
)
from featherstone_gait.core.effects.energies import FRICTION
from featherstone_gait.run.simulate import initial_state

STILL = (0.0, 0.0, 0.0)
J, K, Q0 = 0.02, 2.0, 0.3  # [kg m^2], [N m/rad], [rad]: 10 rad/s
FIXED = ("implicit_euler", "midpoint", "rk4")
FILE = """<mujoco><compiler autolimits="true"/><default><joint damping="0.02"/>
<default class="soft"><joint stiffness="3" springref="20"/></default></default>
<worldbody><body pos="0 0 1"><joint name="a" class="soft" axis="0 1 0" ref="15"/>
<geom type="capsule" fromto="0 0 0 .2 0 0" size=".02" mass=".3"/>
<body pos=".2 0 0" childclass="soft"><joint name="b" axis="0 1 1"/><geom type="box" size=".03 .05 .02" pos=".1 0 .02"
mass=".2"/><body pos=".2 0 0"><joint name="c" type="slide" axis="0 0 1" stiffness="40" springref=".05"/>
<geom size=".03" mass=".1"/><body pos="0 .1 0"><joint name="d" axis="1 0 0" stiffness="0"/><geom size=".02" pos="0 .1 0"
mass=".1"/></body></body></body></body></worldbody></mujoco>"""


def wheel(damping=0.0, stiffness=K, kind="continuous"):
    """A disc about a vertical axis: nothing but its spring acts."""
    links = Link("base", 0.0, STILL, (0.0,) * 6), Link("disc", J, STILL, (J, 0.0, 0.0, J, 0.0, J))
    spring = {"stiffness": stiffness, "spring_reference": Q0, "damping": damping}
    return Model("wheel", links, (Joint("j", kind, "base", "disc", axis=(0.0, 0.0, 1.0), **spring),))


def swing(t, damping):
    """The angle from rest at zero: J q'' = K (q0 - q) - c q'."""
    d = damping / (2.0 * J)
    f = np.sqrt(K / J - d * d)
    return Q0 - Q0 * np.exp(-d * t) * (np.cos(f * t) + d / f * np.sin(f * t))


def sprung(model, seed, damping=0.0):
    """The robot with a spring at each joint but the first."""
    rng = np.random.default_rng(seed)
    joints = [
        replace(j, damping=damping, stiffness=k * float(rng.uniform(0.1, 1.0)), spring_reference=float(rng.normal()))
        for k, j in enumerate(model.joints)
    ]
    return replace(model, joints=joints)


# --- closed forms ------------------------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize("kind", ["continuous", "prismatic"])
@pytest.mark.parametrize("damping", [0.0, 0.05])
@pytest.mark.parametrize(("integrator", "error"), [("dop853", 2e-9), ("extrapolation", 1e-12), ("ars343", 1e-6)])
def test_a_wheel_on_a_spring_swings_at_its_frequency(integrator, damping, kind, error):
    """A slider on a vertical rail swings alike about q0 - m g / K; here without gravity."""
    scene = compile_scene(wheel(damping, kind=kind), integrator=integrator, gravity=STILL)
    run = simulate(scene, 2.0, rtol=1e-5 if integrator == "ars343" else 1e-10)
    assert run.ok
    assert np.abs(run["q"][:, 0] - swing(run["time"], damping)).max() < error


@pytest.mark.quick("rk4*")
@pytest.mark.nojit
@pytest.mark.parametrize(("integrator", "order"), [("rk4", 4), ("midpoint", 2), ("implicit_euler", 1)])
def test_order_of_fixed_steps(integrator, order):
    errors = []
    for h in (4e-3, 2e-3):
        run = simulated(in_company(wheel(0.05), integrator, h), 0.2, record_interval=0.02)
        errors.append(np.abs(run["q"][:, 0] - swing(run["time"], 0.05)).max())
    assert errors[0] / errors[1] == pytest.approx(2.0**order, rel=0.1)


@pytest.mark.long
@pytest.mark.parametrize("integrator", FIXED)
def test_without_damping_no_fixed_step_loses_the_swing(integrator):
    """A hundred periods at 10 ms: 63 steps each, amplitude within 2 %."""
    scene = compile_scene(wheel(), integrator=integrator, timestep=1e-2)
    q = simulate(scene, 63.0, estimate_error=False)["q"][-63:, 0] - Q0
    assert np.abs(q).max() == pytest.approx(Q0, rel=0.02)


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["implicit_euler", "midpoint"])
def test_an_implicit_step_bears_any_stiffness(integrator):
    """Springs of a chain of 12 links, whose fastest mode is far beyond the limit of explicit steps, let it rest."""
    chain = sprung(random_tree(12, 3, branching=1), 3, damping=0.2)
    chain = replace(chain, joints=[replace(j, stiffness=1e4 * j.stiffness) for j in chain.joints])
    scene = compile_scene(chain, integrator=integrator, timestep=1e-3)
    assert scene.preflight.largest_explicit_step < 0.2 * scene.timestep
    rest = trim(scene, [j.spring_reference for j in chain.joints])
    run = simulate(scene, 1.0, rest.state, tau=rest.tau, estimate_error=False)
    assert run.ok
    assert np.abs(run["q"][-1] - rest.q).max() < 1e-6


@pytest.mark.long
@pytest.mark.parametrize(("factor", "status"), [(0.99, "ok"), (1.01, "not converged")])
def test_a_step_beyond_the_limit_of_an_explicit_method_says_so(factor, status):
    """A swing by Runge-Kutta steps of order 4 does not grow up to 2.8 / omega; 2 / omega is announced for Euler's."""
    check = compile_scene(wheel(), integrator="rk4").preflight
    assert check.largest_explicit_step == pytest.approx(2.0 / np.sqrt(K / J), rel=1e-12)
    assert check.worst.cause == "joint spring"
    step = 2.78 * factor / np.sqrt(K / J)
    run = simulate(compile_scene(wheel(), integrator="rk4", timestep=step), 50.0, estimate_error=False)
    assert run.status == status
    assert np.abs(run["q"] - Q0).max() < 1.01 * Q0


# --- nonlinear springs -------------------------------------------------------------------------------------------


def stiffening(K=0.0, b=0.0, c=K, damping=0.0):
    model = wheel(damping, stiffness=K)
    return replace(model, joints=[replace(model.joints[0], quadratic_stiffness=b, cubic_stiffness=c)])


@pytest.mark.long
@pytest.mark.parametrize(("integrator", "error"), [("dop853", 1e-8), ("extrapolation", 1e-8), ("midpoint", 1e-5)])
def test_a_cubic_spring_swings_faster_the_farther_it_goes(integrator, error):
    """J x'' = -c x^3 has the period Gamma(1/4)^2 / sqrt(pi) sqrt(J / c) / amplitude; here it is 2 s."""
    amplitude, period = 0.5, 2.0
    c = J * (7.416298709205487 / (amplitude * period)) ** 2
    step = 1e-4 if integrator == "midpoint" else None
    scene = compile_scene(stiffening(c=c), integrator=integrator, timestep=step, gravity=STILL)
    run = simulate(scene, period, initial_state(scene, [Q0 + amplitude]), rtol=None if step else 1e-10)
    assert run["q"][:, 0].min() == pytest.approx(Q0 - amplitude, abs=1e-4)
    assert run["q"][-1, 0] == pytest.approx(Q0 + amplitude, abs=error)


@pytest.mark.quick("rk4*")
@pytest.mark.parametrize(("integrator", "order"), [("rk4", 4), ("midpoint", 2), ("implicit_euler", 1)])
def test_order_with_a_nonlinear_spring(integrator, order):
    model, ends = stiffening(1.0, -2.0, 3.0, 0.02), []
    for name, h in (("rk4", 5e-4), (integrator, 4e-3), (integrator, 2e-3)):
        ends.append(simulated(in_company(model, name, h), 0.2, [1.3])["q"][-1, 0])
    assert (ends[1] - ends[0]) / (ends[2] - ends[0]) == pytest.approx(2.0**order, rel=0.1)


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["implicit_euler", "midpoint"])
def test_an_implicit_step_bears_any_nonlinear_spring(integrator):
    """With a damper D x = a / sqrt(1 + 2 c a^2 t / D) from a, but for inertia; at fifty times an explicit step."""
    c, damping, a, t = 1e6, 2000.0, 0.1, 0.5
    scene = compile_scene(stiffening(0.0, 0.0, c, damping), integrator=integrator, timestep=1e-3, gravity=STILL)
    assert scene.preflight.largest_explicit_step <= 2e-5
    run = simulate(scene, t, initial_state(scene, [Q0 + a]), estimate_error=False)
    assert run.ok
    assert run["q"][-1, 0] - Q0 == pytest.approx(a / np.sqrt(1.0 + 2.0 * c * a * a * t / damping), rel=1e-2)


def test_a_spring_that_gives_way_is_refused():
    with pytest.raises(ValueError, match=r"its spring gives way somewhere: quadratic_stiffness is 3\.0"):
        stiffening(1.0, 3.0, 2.9)


# --- MuJoCo ------------------------------------------------------------------------------------------------------


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("changes", "linear", "quadratic"),
    [
        ({}, [3, 3, 40, 0], [0, 0, 0, 0]),
        ({'="3"': '="3 -2 1"', 's="40"': 's="0 0 5e3"', '="0"': '="0 0 0"'}, [3, 3, 0, 0], [-2, -2, 0, 0]),
    ],
)
def test_accelerations_are_those_of_mujoco_from_one_file(tmp_path, changes, linear, quadratic):
    """With defaults, classes, a reference of the joint's own, a slide, and one without a spring; dampers too."""
    file, saved, text = tmp_path / "arm.xml", tmp_path / "saved.xml", FILE
    for old, new in changes.items():
        text = text.replace(old, new)
    file.write_text(text)
    if any(quadratic):
        pytest.importorskip("mujoco", minversion="4")
    model = load_robot(file, strict=True)
    assert [j.stiffness for j in model.moving_joints] == linear
    assert [j.quadratic_stiffness for j in model.moving_joints] == quadratic
    save_robot(model, saved)
    rng = np.random.default_rng(0)
    q, qd = rng.uniform(-1.0, 1.0, (2, 20, 4))
    damping = np.array([j.damping for j in model.moving_joints])
    found = forward_dynamics(model, q, qd, -damping * qd)
    for path in (file, saved):
        mujoco, m, d = mujoco_model(path)
        for k in range(len(q)):
            d.qpos, d.qvel = q[k], qd[k]
            mujoco.mj_forward(m, d)
            np.testing.assert_allclose(found[k], d.qacc, rtol=1e-9, atol=1e-9 * np.abs(d.qacc).max())
    assert load_robot(saved).joints == model.joints


@pytest.mark.long
def test_the_motion_is_that_of_mujoco(tmp_path):
    """From rest at the file's `ref` for a second; MuJoCo by Runge-Kutta steps of 0.1 ms."""
    file = tmp_path / "arm.xml"
    file.write_text(FILE)
    mujoco, m, d = mujoco_model(file)
    m.opt.timestep, m.opt.integrator = 1e-4, mujoco.mjtIntegrator.mjINT_RK4
    for _ in range(10000):
        mujoco.mj_step(m, d)
    run = simulate(compile_scene(load_robot(file)), 1.0, rtol=1e-9)
    np.testing.assert_allclose(run["q"][-1], d.qpos, rtol=0, atol=1e-8)


# --- statics, energy, linear models ------------------------------------------------------------------------------


@pytest.mark.parametrize("base", ["fixed", "floating"])
def test_inverse_and_forward_dynamics_agree(base):
    """And at rest the torque that springs take is the slope of the energy that they store."""
    model = sprung(random_tree(6, 1, base=base), 1)
    q, qd, tau = random_states(model, 9, 2)
    np.testing.assert_allclose(
        inverse_dynamics(model, q, qd, forward_dynamics(model, q, qd, tau)), tau, rtol=0, atol=1e-10
    )
    slack, n = np.zeros(len(model.joints)), len(model.joints)
    still = np.zeros(model.nv)
    pull = inverse_dynamics(model, q, still, still) - inverse_dynamics(model, q, still, still, stiffness=slack)
    for k, e in enumerate(np.eye(model.nq)[-n:]):
        h = 1e-5
        slope = [energy(one, q + h * e, still) - energy(one, q - h * e, still) for one in (model, unsprung(model))]
        np.testing.assert_allclose(pull[:, k - n], (slope[0] - slope[1]).potential / (2.0 * h), atol=1e-8)


def unsprung(model):
    return replace(model, joints=[replace(j, stiffness=0.0) for j in model.joints])


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["dop853", "extrapolation"])
def test_energy_of_a_floating_tree_is_what_friction_leaves(integrator):
    """With springs that stiffen."""
    bare = random_tree(8, 4, base="floating")
    joints = sprung(bare, 4, damping=1e-3).joints
    joints = [replace(j, quadratic_stiffness=j.stiffness, cubic_stiffness=j.stiffness) for j in joints]
    model = replace(bare, joints=joints)
    q, qd, tau = (x[0] for x in random_states(model, 1, 4))
    scene = compile_scene(model, integrator=integrator)
    run = simulate(
        scene, 0.5, initial_state(scene, q, qd), record=("base_q", "q", "base_qd", "qd", "energy"), rtol=1e-11
    )
    states = (np.hstack([run[f"base_{x}"], run[x]]) for x in ("q", "qd"))
    total = energy(model, *states).total + run["energy"][:, :, FRICTION].sum(axis=1)
    found = inverse_dynamics(model, q, qd, forward_dynamics(model, q, qd, tau))
    np.testing.assert_allclose(found, tau, rtol=0, atol=1e-9)
    stored = energy(model, q, qd).potential - energy(bare, q, qd).potential
    assert stored > 1.0
    np.testing.assert_allclose(total, total[0], rtol=0, atol=1e-8 * stored)


@pytest.mark.long
@pytest.mark.parametrize("kind", ["standard", "rotor"])
def test_what_drives_a_joint_does_not_count_its_spring(kind):
    """Energy and friction change by the work of the servo, with friction that knows the load too."""
    servo = load_servo("ax12")
    if kind == "rotor":
        servo = replace(servo, gearbox=replace(servo.gearbox, external_load_friction=0.05))
    model = replace(wheel(0.01), servos={"j": servo})
    scene = compile_scene(model, kind)
    run = simulate(scene, 0.5, reference=Reference([0.0], [[0.5]]), record=("q", "qd", "energy"), rtol=1e-6)
    assert run.ok
    armature = servo.gearbox.ratio**2 * servo.gearbox.rotor_inertia if kind == "rotor" else 0.0
    total = energy(model, run["q"], run["qd"], armature=[armature]).total
    work = run.column("energy", "work")[:, 0] - run.column("energy", "friction")[:, 0]
    np.testing.assert_allclose(total - total[0], work, rtol=0, atol=1e-4 * np.ptp(total))


@pytest.mark.long
@pytest.mark.parametrize("damping", [0.0, 0.05])
def test_a_linear_model_has_the_eigenvalues_of_the_oscillator(damping):
    scene = compile_scene(wheel(damping), integrator="dop853")
    model = linearize(scene, trim(scene, [Q0]).state)
    exact = expm(model.period * np.array([[0.0, 1.0], [-K / J, -damping / J]]))
    np.testing.assert_allclose(model.A[:2, :2], exact, rtol=0, atol=1e-9)


@pytest.mark.long
def test_rest_takes_the_torque_of_the_spring():
    scene = compile_scene(wheel(0.05), integrator="rk4", timestep=1e-3)
    found = trim(scene, [1.0])
    assert found.ok
    np.testing.assert_allclose(found.torque, K * (1.0 - Q0), rtol=1e-12)
    assert trim(scene, [Q0]).torque[0] == 0.0


# --- worlds and bits ---------------------------------------------------------------------------------------------


@pytest.mark.nojit
@pytest.mark.bounds
@pytest.mark.long
@pytest.mark.parametrize("integrator", FIXED)
def test_eight_worlds_of_other_springs_have_the_bits_of_each_alone(integrator):
    scene = compile_scene(wheel(0.05), integrator=integrator, timestep=1e-3)
    springs = {"stiffness": np.geomspace(0.1, 3e4, 9), "spring_reference": np.linspace(-1.0, 1.0, 9)}
    worlds = Worlds(joints=springs)
    runs = simulate_batch(scene, 0.01, worlds=worlds, estimate_error=False)
    for run, own in zip(runs, worlds.scenes(scene)):
        np.testing.assert_array_equal(run["q"], simulate(own, 0.01, estimate_error=False)["q"])
    assert len({run["q"].tobytes() for run in runs}) == 9


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"stiffness": -1.0}, r"joint 'j': stiffness is -1.0 \[SI\]; expected >= 0"),
        ({"stiffness": np.inf}, "stiffness is inf"),
        ({"spring_reference": np.nan}, "spring_reference is nan"),
    ],
)
def test_a_wrong_spring_is_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        replace(wheel().joints[0], **changes)
