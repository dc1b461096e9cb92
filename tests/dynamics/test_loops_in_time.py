"""Loops in time: orders of integrators, tolerances, energy, momentum, lanes."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from test_loops import (
    closed_rates,
    four_bar,
    four_bar_angles,
    four_bar_rates,
    one_freedom,
    piston_place,
    rod_angle,
    rods_on_an_ankle,
    slider_crank,
    slider_crank_height,
    slider_crank_inertia,
)

from featherstone_gait import (
    Cylinder,
    Distribution,
    Fluid,
    Ground,
    Immersed,
    Joint,
    Link,
    Loop,
    Model,
    Reference,
    Session,
    Worlds,
    close_loops,
    compile_scene,
    energy,
    forward_kinematics,
    initial_state,
    load_robot,
    loop_forces,
    loop_gaps,
    loop_jacobian,
    momentum,
    simulate,
    simulate_batch,
)
from featherstone_gait.model.numpy_dynamics import with_quaternions
from featherstone_gait.robot_file.servos import with_servo


def at_crank(angle):
    """Closed positions of the slider-crank."""
    return np.array([angle, rod_angle(angle), piston_place(angle)])


@pytest.fixture(scope="module")
def swung():
    """The crank's angle after a second from rest, by its one equation of motion."""

    def rates(_, x):
        return [x[1], one_freedom(slider_crank_inertia, slider_crank_height, x[0], x[1], 0.0)]

    return solve_ivp(rates, (0.0, 1.0), [0.3, 0.0], method="DOP853", rtol=1e-12, atol=1e-13).y[0, -1]


def swing(integrator, **options):
    """Let the crank go, and return the run; its loop is closed in all records."""
    model, (numbers, how) = slider_crank(), ({}, {})
    for name, value in options.items():
        (how if name == "rtol" else numbers)[name] = value
    scene = compile_scene(model, integrator=integrator, **numbers)
    recorded = {"record": ("q", "qd"), "record_interval": 0.04, "estimate_error": False}
    run = simulate(scene, 1.0, initial_state(scene, at_crank(0.3)), **recorded, **how)
    assert run.status == "ok"
    J = loop_jacobian(model, run["q"])
    assert np.abs(loop_gaps(model, run["q"])).max() < 1e-12
    assert np.abs(np.einsum("nij,nj->ni", J, run["qd"])).max() < 1e-11
    if integrator not in ("implicit_euler", "midpoint"):  # these may leave what one more move would take away
        assert np.abs(loop_gaps(model, run["q"])).max() < 1e-14
    return run


@pytest.mark.long
@pytest.mark.parametrize(("integrator", "order", "step", "most"), [("implicit_euler", 1, 4e-3, 2e-3),
                         ("midpoint", 2, 4e-3, 1e-5), ("rk4", 4, 8e-3, 1e-8)])  # fmt: skip
def test_a_slider_crank_runs_to_the_order_of_the_integrator(swung, integrator, order, step, most):
    errors = [abs(swing(integrator, timestep=h)["q"][-1, 0] - swung) for h in (step, step / 2, step / 4)]
    assert errors[2] < most
    for coarse, fine in itertools.pairwise(errors):
        assert 0.75 * 2**order < coarse / fine < 1.4 * 2**order


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["dop853", "ars343", "extrapolation"])
def test_the_tolerance_orders_the_error_of_a_slider_crank(swung, integrator):
    errors = [abs(swing(integrator, rtol=rtol)["q"][-1, 0] - swung) for rtol in (1e-4, 1e-6)]
    assert errors[0] < 3e-5
    assert errors[1] < 1e-8
    if integrator != "extrapolation":  # whose steps end on records: its error is rounding
        assert errors[1] < 0.05 * errors[0]


@pytest.mark.long
def test_loops_stay_closed_and_keep_their_energy_over_ten_minutes():
    model, lost = slider_crank(), []
    scene = compile_scene(model)
    assert scene.integrator == "dop853"
    for rtol in (1e-7, 1e-10):
        recorded = {"record": ("q", "qd"), "record_interval": 0.1, "estimate_error": False}
        run = simulate(scene, 600.0, initial_state(scene, at_crank(0.3)), rtol=rtol, **recorded)
        assert run.status == "ok"
        assert np.abs(loop_gaps(model, run["q"])).max() < 1e-14
        measured = energy(model, run["q"], run["qd"])
        lost.append(np.ptp(measured.total) / measured.kinetic.max())
    assert lost[0] < 1e-5
    assert lost[1] < 1e-8


@pytest.mark.long
@pytest.mark.parametrize(("gearbox", "integrator"), [(None, "dop853"), ("mipsd", "ars343")])
def test_the_integrator_is_chosen_as_without_loops_and_says_why(gearbox, integrator):
    scene = compile_scene(servo_four_bar(), gearbox)
    assert scene.integrator == integrator
    assert scene.preflight.reason.endswith("; loops 'pin' are closed after each step")
    opened = compile_scene(replace(scene.model, loops=()), gearbox)
    assert (opened.integrator, opened.timestep) == (scene.integrator, scene.timestep)
    run = simulate(scene, 0.01, initial_state(scene, four_bar_angles(1.0)), estimate_error=False)
    assert run.info["loops"] == ["pin"]
    assert run.info["reason"] == scene.preflight.reason


def servo_four_bar():
    """The four-bar, with a servo on its crank."""
    model = four_bar()
    limits = {"type": "revolute", "lower": -9.0, "upper": 9.0}
    driven = with_servo(replace(model, joints=tuple(replace(joint, **limits) for joint in model.joints)), "ax12")
    return replace(driven, servos={"crank": driven.servos["crank"]})


@pytest.mark.long
@pytest.mark.parametrize("gearbox", ["standard", "mipsd"])
def test_a_servo_moves_a_four_bar_to_the_order_of_the_implicit_step(gearbox):
    model, q = servo_four_bar(), four_bar_angles(1.0)
    reference = Reference([0.0, 0.5], np.stack([q, np.add(q, (0.4, 0.0, 0.0))]))

    def end(integrator, h=None, rtol=None):
        scene = compile_scene(model, gearbox, None, integrator, h, (0.0, 0.0, -1.0))
        run = simulate(scene, 0.5, initial_state(scene, q), reference, record=("q",), rtol=rtol, estimate_error=False)
        assert run.status == "ok"
        assert np.abs(loop_gaps(model, run["q"])).max() < 1e-12
        return run["q"][-1, 0]

    exact = end("extrapolation", rtol=1e-10)
    assert exact > q[0] + 0.3
    for integrator, order, most in (("implicit_euler", 1, 1e-4), ("midpoint", 2, 2e-6)):
        errors = [abs(end(integrator, h) - exact) for h in (1e-3, 5e-4)]
        assert errors[0] < most
        assert errors[0] / errors[1] == pytest.approx(2**order, rel=0.1)


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["midpoint", "ars343"])
def test_a_rod_between_the_shanks_of_a_standing_humanoid(integrator):
    """Servos, ground and loop act at once: servos spread the legs, which the rod holds together."""
    model = load_robot("humanoid", locked="simplified")
    alone = compile_scene(model, "mipsd", slippery := Ground(friction=0.02))
    stand = alone.state_view(initial_state(alone))
    q, places = np.concatenate([stand.base_q, stand.q]), forward_kinematics(model, np.r_[stand.base_q, stand.q])
    ends = [places.position[model.link_index(f"{side}_shank")] for side in ("left", "right")]
    rod = Loop("rod", "distance", "left_shank", "right_shank", distance=float(np.linalg.norm(ends[0] - ends[1])))
    spread = {"left_hip_lateral": 0.1, "right_hip_lateral": -0.1}
    goal = stand.q + [spread.get(name, 0.0) for name in model.joint_names]
    reference, opened = Reference([0.0, 0.2], np.array([stand.q, goal])), {}
    tied = replace(model, loops=(rod,))
    for name, one in (("free", model), ("tied", tied)):
        scene = compile_scene(one, "mipsd", slippery, integrator, 1e-3)
        run = simulate(scene, 0.4, initial_state(scene, q), reference, record=("base_q", "q"), estimate_error=False)
        assert run.status == "ok"
        opened[name] = np.abs(loop_gaps(tied, np.hstack([run["base_q"], run["q"]]))).max()
        angles = dict(zip(model.joint_names, run["q"][-1]))
        assert angles["left_hip_lateral"] == pytest.approx(-angles["right_hip_lateral"], abs=1e-9)
    assert opened["free"] > 5e-3
    assert opened["tied"] < 1e-12


@pytest.mark.long
def test_a_floating_robot_with_rods_keeps_its_momentum(tmp_path):
    model, q = rods_on_an_ankle(tmp_path)
    qd = 0.3 * closed_rates(model, q, 3)
    scene = compile_scene(model, integrator="rk4", timestep=1e-3, gravity=(0.0, 0.0, 0.0))
    run = simulate(scene, 1.0, initial_state(scene, q, qd), record=("base_q", "q", "base_qd", "qd", "ball_q"),
                   record_interval=0.1)  # fmt: skip
    assert run.status == "ok"
    ends = [scene.state_view(y) for y in (initial_state(scene, q, qd), run.final)]
    found = []
    for view in ends:
        at = np.concatenate([view.base_q, with_quaternions(model, view.q, view.ball_q.ravel())])
        rates = np.concatenate([view.base_qd, view.qd])
        assert np.abs(loop_gaps(model, at)).max() < 1e-12
        assert np.abs(loop_jacobian(model, at) @ rates).max() < 1e-11
        found.append((energy(model, at, rates, gravity=np.zeros(3)).kinetic, *momentum(model, at, rates)))
    np.testing.assert_allclose(found[0], found[1], rtol=1e-8, atol=1e-9)


@pytest.mark.long
def test_worlds_and_sessions_with_loops_give_the_bits_of_one_run():
    model, q = servo_four_bar(), four_bar_angles(1.0)
    scene = compile_scene(model, "mipsd", None, "implicit_euler", 1e-3)
    reference = Reference([0.0, 0.1], np.stack([q, np.add(q, (0.1, 0.0, 0.0))]))
    worlds = Worlds(9, links={"mass": Distribution("uniform", 0.2)}, servos={"Kp": Distribution("uniform", 0.2)})
    start = initial_state(scene, q)
    plain = {"record": ("q",), "estimate_error": False}
    together = simulate_batch(scene, 0.1, [start] * 9, [reference] * 9, worlds=worlds, **plain)
    for world, run in zip(worlds.scenes(scene), together, strict=True):
        alone = simulate(world, 0.1, start, reference, **plain)
        assert alone.final.tobytes() == run.final.tobytes()
        assert np.abs(loop_gaps(model, run["q"])).max() < 1e-12
    with Session(scene, estimate_error=False) as session:
        session.reset(state=start)
        goal = np.add(q, (0.1, 0.0, 0.0))
        for _ in range(10):
            session.step(goal)
        alone = simulate(scene, 10 * session.tick, start, Reference([0.0], goal[None]), **plain)
        assert alone.final.tobytes() == session.state[0].tobytes()


# ------------------------------------------------------------------------------------------------ forces


@pytest.mark.long
@pytest.mark.nojit
@pytest.mark.parametrize("integrator", ["implicit_euler", "midpoint", "rk4", "dop853"])
def test_a_weight_on_a_rod_pulls_with_its_weight(integrator):
    slide = Joint("slide", "prismatic", "frame", "weight", axis=(0.0, 0.0, 1.0))
    rod = Loop("rod", "distance", "weight", "frame", point_b=(0.3, 0.0, 0.5), distance=math.hypot(0.3, 0.5))
    model = Model("hung", (Link("frame"), Link("weight", 2.0)), (slide,), loops=(rod,))
    scene = compile_scene(model, integrator=integrator, timestep=1e-3)
    run = simulate(scene, 0.01, record=("q", "loop_force"), estimate_error=False)
    assert run["loop_force"].shape == (2, 1)
    assert run["loop_force"][-1, 0] * -0.5 / rod.distance == pytest.approx(2.0 * 9.81, rel=1e-12)  # the rod is drawn
    assert run["q"][-1, 0] == pytest.approx(0.0, abs=1e-15)


@pytest.mark.long
def test_forces_of_loops_are_those_of_the_accelerations_and_do_no_work():
    model, tau = slider_crank(), np.array([2.0, 0.0, 0.0])
    scene = compile_scene(model)
    how = {"record": ("q", "qd", "loop_force", "energy"), "rtol": 1e-10, "estimate_error": False}
    run = simulate(scene, 0.5, initial_state(scene, at_crank(0.3)), tau=tau, **how)
    forces = loop_forces(model, run["q"][1:], run["qd"][1:], np.tile(tau, (len(run["q"]) - 1, 1)))
    np.testing.assert_allclose(run["loop_force"][1:], forces, rtol=0, atol=1e-9 * np.abs(forces).max())
    total = energy(model, run["q"], run["qd"]).total
    np.testing.assert_allclose(run.column("energy", "work").sum(axis=1), total - total[0], rtol=0, atol=1e-8)


@pytest.mark.long
def test_a_chain_of_fifty_links_hung_at_both_ends_hangs_as_a_catenary_and_swings():
    """Check posture and pull of the chain against those of a chain at rest, then energy and gaps while it swings.

    Each of the n bars has the weight w.  At rest the horizontal force H is the same everywhere, and the tangent of the
    angle of bar k below the horizontal is ((n + 1) / 2 - k) w / H.  H follows from the distance of the two ends.
    """
    n, length, span, weight = 50, 0.1, 3.0, 0.1 * 9.81
    inertia = 0.1 * length**2 / 12
    links = [Link("post"), *(Link(f"bar{k}", 0.1, (0.5 * length, 0.0, 0.0), (1e-7, 0.0, 0.0, inertia, 0.0, inertia))
                             for k in range(n))]  # fmt: skip
    joints = [
        Joint(f"joint{k}", "continuous", a.name, b.name, (length if k else 0.0, 0.0, 0.0), axis=(0.0, 1.0, 0.0))
        for k, (a, b) in enumerate(itertools.pairwise(links))
    ]
    pin = Loop("pin", "connect", f"bar{n - 1}", None, (length, 0.0, 0.0), (span, 0.0, 0.0))
    chain = Model("chain", tuple(links), tuple(joints), loops=(pin,))
    rises = (0.5 * (n + 1) - np.arange(1, n + 1)) * weight
    pull = brentq(lambda h: length * np.cos(np.arctan(rises / h)).sum() - span, 0.1, 1e3, xtol=1e-14)
    angles = np.arctan(rises / pull)  # of a bar below the horizontal; about y that is positive
    q = np.diff(angles, prepend=0.0)
    scene = compile_scene(chain)
    assert np.abs(loop_gaps(chain, q)).max() < 1e-12
    still = simulate(scene, 1.0, initial_state(scene, q), record=("q", "loop_force"), rtol=1e-9)
    assert still.ok
    np.testing.assert_allclose(still["q"][-1], q, atol=1e-8)
    np.testing.assert_allclose(still["loop_force"][-1], [pull, 0.0, 0.5 * n * weight], rtol=1e-7, atol=1e-9)
    away = close_loops(chain, q + 0.1 * np.sin(np.arange(n)))
    swing = simulate(scene, 2.0, initial_state(scene, away), record=("q", "qd"))
    assert swing.ok
    both = energy(chain, swing["q"], swing["qd"])
    total = both.kinetic + both.potential
    assert np.ptp(both.kinetic) > 0.05
    assert np.abs(total - total[0]).max() < 1e-6 * np.ptp(both.kinetic)
    assert max(np.abs(loop_gaps(chain, one)).max() for one in swing["q"]) < 1e-10


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["implicit_euler", "midpoint", "rk4"])
def test_a_mass_on_a_rod_turns_on_without_gaining_speed(integrator):
    """Check the speed of a mass that turns by 0.2 rad a step for 6 turns.

    Moved along the tangent of either end of the step alone, it would gain or lose 2 % of its speed in each.
    """
    slides = (
        Joint("x", "prismatic", "post", "cart", axis=(1.0, 0.0, 0.0)),
        Joint("z", "prismatic", "cart", "mass", axis=(0.0, 0.0, 1.0)),
    )
    rod = Loop("rod", "distance", "mass", None, distance=1.0)
    model = Model("circle", (Link("post"), Link("cart"), Link("mass", 1.0)), slides, loops=(rod,))
    scene = compile_scene(model, integrator=integrator, timestep=1e-2, gravity=(0.0, 0.0, 0.0))
    run = simulate(scene, 2.0, initial_state(scene, [1.0, 0.0], [0.0, 20.0]), record=("qd",), estimate_error=False)
    assert run.ok
    speed = np.hypot(*run["qd"].T)
    assert (np.diff(speed) < 1e-10).all()
    assert speed[-1] > 0.9 * speed[0]
    slow = simulate(scene, 2.0, initial_state(scene, [1.0, 0.0], [0.0, 10.0]), record=("qd",), estimate_error=False)
    kept = 1.0 - np.hypot(*slow["qd"][-1]) / 10.0
    assert kept < (1.0 - speed[-1] / speed[0]) / 6.0  # the third power of the rate, and less


@pytest.mark.long
def test_error_control_takes_a_four_bar_through_its_dead_point():
    model = four_bar(0.5, 0.4, 0.6, 0.5)
    scene, q = compile_scene(model, integrator="dop853"), close_loops(model, [-1.2, 0.8, -1.0])
    ends = []
    for rtol in (1e-6, 1e-9):
        run = simulate(scene, 2.0, initial_state(scene, q), record=("q", "qd"), record_interval=0.01, rtol=rtol)
        assert run.status == "ok"
        assert np.abs(loop_gaps(model, run["q"])).max() < 1e-12
        assert np.ptp(energy(model, run["q"], run["qd"]).total) < 10.0 * rtol * 16.0  # [J] that move
        ends.append(run["q"][-1])
    np.testing.assert_allclose(ends[0], ends[1], rtol=0, atol=1e-6)


@pytest.mark.long
def test_a_four_bar_with_added_mass_moves_to_the_order_of_the_integrator():
    """The loop's forces move what the fluid adds to the links too, of which one link has twice its volume."""
    dry, x = four_bar(), 0.7
    crank = Immersed("crank", Cylinder(0.04, 0.3), xyz=(0.15, 0.0, 0.0), rpy=(0.0, np.pi / 2, 0.0), added_mass=2.0)
    model, q = replace(dry, immersed=(replace(crank, buoyant=False),)), four_bar_angles(x)
    qd = 3.0 * four_bar_rates(q)

    def end(integrator, h):
        scene = compile_scene(model, None, None, integrator, h, (0.0, 0.0, 0.0), fluid=Fluid(1000.0))
        run = simulate(scene, 0.2, initial_state(scene, q, qd), record=("q",), estimate_error=False)
        assert run.status == "ok"
        return run["q"][-1, 0]

    exact = end("rk4", 5e-4)
    assert abs(exact - x) > 0.3
    for integrator, order, steps in (("implicit_euler", 1, (1e-3, 5e-4)), ("midpoint", 2, (2e-3, 1e-3))):
        errors = [abs(end(integrator, h) - exact) for h in steps]
        assert errors[1] < 1e-3
        assert errors[0] / errors[1] == pytest.approx(2**order, rel=0.2)
