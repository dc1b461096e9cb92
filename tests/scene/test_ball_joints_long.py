"""Simulations with ball joints: conservation, order of the integrators, the same bits however they run."""

from dataclasses import replace

import numpy as np
import pytest

from featherstone_gait import Ground, compile_scene, initial_state, simulate
from featherstone_gait.dynamics import energy, momentum
from featherstone_gait.model import ContactPoint, Joint, Link, Model

pytestmark = pytest.mark.long

BOX = (0.010, 0.002, 0.001, 0.030, 0.0005, 0.020)


def pendulum(base="fixed"):
    """Two bodies that hang by ball joints."""
    links = (
        Link("base", 1.0, (0.0, 0.0, 0.1), BOX),
        Link("upper", 1.0, (0.02, 0.01, -0.2), BOX),
        Link("lower", 0.5, (0.0, 0.02, -0.15), BOX),
    )
    joints = (
        Joint("shoulder", "ball", "base", "upper", (0.0, 0.0, 1.0), (0.1, 0.2, 0.3)),
        Joint("elbow", "ball", "upper", "lower", (0.0, 0.0, -0.4)),
    )
    return Model("pendulum", links, joints, base)


def start(model):
    rng = np.random.default_rng(3)
    q, v = rng.normal(size=model.nq), rng.normal(size=model.nv)
    for at in [slice(3, 7)] * (model.base == "floating") + [model.position_slices[k] for k in model.balls]:
        q[at] /= np.linalg.norm(q[at])
    return q, v


def positions(model, run):
    return np.hstack([run["base_q"], run["q"]]) if model.base == "floating" else run["q"]


def velocities(model, run):
    return np.hstack([run["base_qd"], run["qd"]]) if model.base == "floating" else run["qd"]


@pytest.mark.parametrize("base", ["fixed", "floating"])
def test_a_double_ball_pendulum_keeps_energy_and_momentum(base):
    model, (q, v) = pendulum(base), start(pendulum(base))
    scene = compile_scene(model, integrator="dop853", gravity=(0.0, 0.0, -9.81 if base == "fixed" else 0.0))
    state = initial_state(scene, q, v)
    run = simulate(scene, 60.0, state, rtol=1e-13, record_interval=1.0, estimate_error=False)
    at, rates = positions(model, run), velocities(model, run)
    of = energy(model, at, rates, gravity=scene.gravity)
    total = of.kinetic + of.potential
    assert total == pytest.approx(np.full(61, total[0]), rel=1e-9)
    if base == "floating":
        L = momentum(model, at, rates)
        assert L == pytest.approx(np.tile(L[0], (61, 1)), abs=1e-9 * np.abs(L[0]).max())


@pytest.mark.parametrize(
    ("integrator", "steps", "order"),
    [("implicit_euler", (1e-3, 5e-4), 1), ("midpoint", (2e-3, 1e-3), 2), ("rk4", (4e-3, 2e-3), 4)],
)
def test_fixed_steps_keep_their_order(integrator, steps, order):
    model, (q, v) = pendulum("floating"), start(pendulum("floating"))
    exact = compile_scene(model, integrator="dop853")
    reference = simulate(exact, 0.2, initial_state(exact, q, v), rtol=1e-13)["q"][-1]
    errors = []
    for step in steps:
        scene = compile_scene(model, integrator=integrator, timestep=step)
        run = simulate(scene, 0.2, initial_state(scene, q, v), estimate_error=False)
        errors.append(np.abs(run["q"][-1] - reference).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.25)


@pytest.mark.parametrize("integrator", ["ars343", "extrapolation", "dop853"])
def test_tolerance_orders_the_error(integrator):
    model, (q, v) = pendulum("floating"), start(pendulum("floating"))
    exact = compile_scene(model, integrator="dop853")
    reference = simulate(exact, 0.5, initial_state(exact, q, v), rtol=1e-13)["q"][-1]
    scene = compile_scene(model, integrator=integrator)
    errors = []
    for rtol in (1e-4, 1e-6, 1e-8):
        run = simulate(scene, 0.5, initial_state(scene, q, v), rtol=rtol, estimate_error=False)
        errors.append(np.abs(run["q"][-1] - reference).max())
        assert errors[-1] < 100.0 * rtol
    assert errors[0] > errors[1] or errors[1] < 1e-13
    assert errors[1] > errors[2]


def test_damping_of_a_ball_joint_is_that_of_each_degree():
    # a ball of inertia I about its center, held there: each rate decays with the damping over I
    ball = Link("ball", 1.0, (0.0, 0.0, 0.0), (0.02, 0.0, 0.0, 0.02, 0.0, 0.02))
    model = Model("held", (Link("world"), ball), (Joint("at", "ball", "world", "ball", damping=0.1),))
    scene = compile_scene(model, integrator="extrapolation")
    run = simulate(scene, 0.5, initial_state(scene, None, (1.0, -2.0, 3.0)), rtol=1e-10)
    assert run["qd"][-1] == pytest.approx(np.array([1.0, -2.0, 3.0]) * np.exp(-0.1 / 0.02 * 0.5), rel=1e-8)
    angle = np.linalg.norm([1.0, -2.0, 3.0]) * 0.2 * (1 - np.exp(-2.5))
    assert 2 * np.arccos(run["q"][-1][0]) == pytest.approx(angle, rel=1e-8)


def test_a_robot_with_ball_joints_comes_to_rest_on_the_ground():
    model = pendulum("floating")
    corners = [(x, y, -0.3) for x in (-0.1, 0.1) for y in (-0.1, 0.1)]
    contacts = tuple(ContactPoint(link, at) for link in ("base", "upper", "lower") for at in corners)
    joints = tuple(replace(joint, damping=0.5) for joint in model.joints)
    robot = Model("robot", model.links, joints, "floating", contacts=contacts)
    scene = compile_scene(robot, ground=Ground(), fall_tilt=3.2, fall_height=-1.0)
    q = np.array([0.0, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    run = simulate(scene, 6.0, initial_state(scene, q), record=("qd", "contact_force"), estimate_error=False)
    assert run.status == "ok"
    assert np.abs(run["qd"][-1]).max() < 0.01
    assert run["contact_force"][-1][:, 0].sum() == pytest.approx(robot.mass * 9.81, rel=1e-5)
