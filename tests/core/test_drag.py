"""Damping of joints that grows with the speed: closed forms, orders, energy, MuJoCo with the same file, equal bits."""

import math
from dataclasses import replace

import numpy as np
import pytest
from company import in_company, simulated
from mujoco_oracle import mujoco_model
from random_tree import random_states, random_tree

from featherstone_gait import (
    Joint,
    Link,
    Model,
    compile_scene,
    energy,
    forward_dynamics,
    load_robot,
    mass_matrix,
    save_robot,
    simulate,
)
from featherstone_gait.run.simulate import initial_state

STILL = (0.0, 0.0, 0.0)
J = 0.02  # [kg m^2]
QUIET = {"estimate_error": False}


def braked(damping=0.0, quadratic=0.0, cubic=0.0):
    """A disc about a vertical axis, which drag brakes."""
    links = Link("base", 0.0, STILL, (0.0,) * 6), Link("disc", 0.5, STILL, (J, 0.0, 0.0, J, 0.0, J))
    drag = {"damping": damping, "quadratic_damping": quadratic, "cubic_damping": cubic}
    return Model("wheel", links, (Joint("j", "continuous", "base", "disc", axis=(0.0, 0.0, 1.0), **drag),))


def dragged(tree, share=1.0):
    """The robot with drag on its joints, in which the power of v^2 lessens that of the others on every second joint."""
    joints = []
    for k, joint in enumerate(tree.joints):
        b2 = 0.3 * share if k % 2 else -0.2 * share
        joints.append(replace(joint, damping=0.2 * share, quadratic_damping=b2, cubic_damping=0.1 * share))
    return replace(tree, joints=joints)


def test_the_speed_decays_as_one_over_time():
    """J dv/dt = -b v |v|: v = v0 / (1 + b v0 t / J), either way round; J dv/dt = -c v^3: 1 / v^2 grows by 2 c t / J."""
    t, b = 0.5, 0.03
    for v0 in (4.0, -4.0):
        run = simulated(in_company(braked(quadratic=b), "rk4", 1e-3), t, [0.0], [v0])
        assert run["qd"][-1, 0] == pytest.approx(v0 / (1.0 + b * abs(v0) * t / J), rel=1e-9)
        run = simulated(in_company(braked(cubic=b), "rk4", 1e-3), t, [0.0], [v0])
        assert run["qd"][-1, 0] == pytest.approx(v0 / math.sqrt(1.0 + 2.0 * b * v0 * v0 * t / J), rel=1e-9)


def test_an_implicit_step_bears_any_drag():
    """One step of Euler's method solves J (v - v0) = -h (b1 + b2 |v| + b3 v^2) v, at 1e6 times an explicit step."""
    h, v0, b = 1e-2, -3.0, (10.0, 2e3, 4e4)
    scene = in_company(braked(*b), "implicit_euler", h)
    assert scene.preflight.largest_explicit_step < 1e-7
    v = simulated(scene, h, [0.0], [v0], record_interval=h)["qd"][1, 0]
    power = b[0] * v + b[1] * v * abs(v) + b[2] * v**3
    assert J * (v - v0) == pytest.approx(-h * power, rel=1e-8)
    assert -0.1 < v < 0.0


@pytest.mark.nojit
def test_one_implicit_step_is_a_dense_solution():
    """M (v - v0) = -h (b1 + b2 |v| + b3 v^2) v by Newton's method on the whole matrix."""
    model, h = dragged(random_tree(5, 3), 5.0), 2e-3
    (q,), (qd,), _ = random_states(model, 1, 2)
    scene = in_company(model, "implicit_euler", h, gravity=STILL)
    run = simulated(scene, h, q, qd, record=("qd",), record_interval=h)
    b1, b2, b3 = (np.array([getattr(j, f"{n}damping") for j in model.joints]) for n in ("", "quadratic_", "cubic_"))
    M, free = mass_matrix(model, q), qd + h * forward_dynamics(model, q, qd, np.zeros(5), gravity=STILL)
    v = free.copy()
    for _ in range(50):
        size = abs(v)
        slope = np.diag(b1 + 2.0 * b2 * size + 3.0 * b3 * size**2)
        v = v - np.linalg.solve(M + h * slope, M @ (v - free) + h * (b1 + b2 * size + b3 * size**2) * v)
    np.testing.assert_allclose(run["qd"][1], v, rtol=0, atol=1e-9 * np.abs(v).max())
    assert np.abs(v - free).max() > 0.05 * np.abs(v).max()


@pytest.mark.parametrize("integrator", ["rk4", pytest.param("dop853", marks=pytest.mark.long)])
def test_what_drag_takes_is_in_the_energies(integrator):
    model = dragged(random_tree(5, 3), 0.1)
    (q,), (qd,), _ = random_states(model, 1, 4)
    scene = in_company(model, integrator, 1e-4 if integrator == "rk4" else None)
    how = {} if integrator == "rk4" else {"rtol": 1e-11}
    run = simulated(scene, 0.2, q, qd, record=("q", "qd", "energy"), **how)
    total = energy(model, run["q"], run["qd"]).total
    lost = run.column("energy", "friction").sum(axis=-1)
    assert lost[-1] > 0.02 * np.ptp(energy(model, run["q"], run["qd"]).potential)
    np.testing.assert_allclose(total + lost, total[0], rtol=0, atol=1e-8 * np.abs(total).max())


@pytest.mark.long
@pytest.mark.parametrize(("integrator", "order"), [("midpoint", 2), ("implicit_euler", 1), ("ars343", 3)])
def test_order_with_drag(integrator, order):
    model = dragged(random_tree(4, 3), 0.2)
    (q,), (qd,), _ = random_states(model, 1, 4)
    ends = []
    for name, h in (("rk4", 2e-5), (integrator, 2e-3), (integrator, 1e-3)):
        adaptive = name == "ars343"
        scene = compile_scene(model, integrator=name, timestep=None if adaptive else h)
        how = {"rtol": 1e-9} if adaptive else {}
        ends.append(simulate(scene, 0.1, initial_state(scene, q, qd), **how, **QUIET)["q"][-1])
    errors = [np.abs(end - ends[0]).max() for end in ends[1:]]
    if integrator == "ars343":
        assert max(errors) < 1e-6
    else:
        assert errors[0] / errors[1] == pytest.approx(2.0**order, rel=0.15)


@pytest.mark.filterwarnings("error")
def test_drag_is_that_of_mujoco(tmp_path):
    """Hinges, a slide and a ball joint, each rate of which is braked for itself; also from what is saved."""
    pytest.importorskip("mujoco", minversion="4")
    file, saved = tmp_path / "arm.xml", tmp_path / "saved.xml"
    file.write_text("""<mujoco><worldbody><body><joint name="a" axis="0 1 0" damping=".5 .2 .1"/>
    <geom type="capsule" fromto="0 0 0 .2 0 0" size=".02" mass=".3"/><body pos=".2 0 0">
    <joint name="b" type="slide" axis="0 1 1" damping="1 -1 2"/><geom type="box" size=".03 .05 .02" mass=".2"/>
    <body pos=".2 0 0"><joint name="c" type="ball" damping="0 .02 .01"/><geom type="box" size=".03 .05 .02" pos=".1 0 0"
    mass=".1"/></body></body></body></worldbody></mujoco>""")
    model = load_robot(file, strict=True)
    assert [j.quadratic_damping for j in model.moving_joints] == [0.2, -1.0, 0.02, 0.02, 0.02]
    save_robot(model, saved)
    assert load_robot(saved, strict=True).joints == model.joints
    scene = in_company(model, "rk4", 1e-6)
    mujoco, m, d = mujoco_model(saved)
    rng = np.random.default_rng(0)
    for _ in range(5):
        q, qd = rng.uniform(-1.0, 1.0, 6), rng.uniform(-3.0, 3.0, 5)
        q[2:] /= np.linalg.norm(q[2:])
        run = simulated(scene, 1e-6, q, qd, record=("q", "qd", "qdd"), record_interval=1e-6)
        d.qpos, d.qvel = run["q"][1], run["qd"][1]
        mujoco.mj_forward(m, d)
        np.testing.assert_allclose(run["qdd"][1], d.qacc, rtol=0, atol=1e-9 * np.abs(d.qacc).max())


def test_a_damper_that_weakens_is_refused():
    with pytest.raises(ValueError, match=r"its damper weakens as the speed grows: quadratic_damping is -3\.0"):
        braked(1.0, -3.0, 2.9)
    braked(1.0, -3.0, 3.0)
    braked(0.0, 3.0)
