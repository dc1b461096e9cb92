"""Gradients of whole runs: closed forms, extrapolated differences of the cost, and equal bits."""

import math

import numpy as np
import pytest
from scenes import box, box_on, pendulum, resting

from featherstone_gait import (
    Ground,
    Reference,
    RunObjective,
    Worlds,
    compile_scene,
    gradient,
    gradient_batch,
    initial_state,
    load_robot,
    run_cost,
    simulate,
)
from featherstone_gait.analysis.run_inputs import table_of
from featherstone_gait.benchmark.skip import free_arm
from featherstone_gait.model import Joint, Link, Model
from featherstone_gait.run import adjoint as adjoint_module
from featherstone_gait.run.adjoint import Adjoint
from featherstone_gait.run.prepare import prepare

G = 9.81  # [m/s^2]


@run_cost
def mixed(time, q, qd):
    """Weigh all records, unequally."""
    total = 0.0
    for k in range(len(time)):
        for j in range(q.shape[1]):
            total += math.sin(1.0 + k + j) * q[k, j] + 0.1 * (qd[k, j] - 0.3) ** 2
    return total


@run_cost
def reached(base_q):
    return base_q[-1, 0]


def difference(f, width):
    """Extrapolated central difference at zero, and what it may be off by."""
    central = [(f(w) - f(-w)) / (2.0 * w) for w in (width, 0.5 * width)]
    return (4.0 * central[1] - central[0]) / 3.0, abs(central[1] - central[0])


def agree(found, f, width, tolerance=1e-8):
    """Assert that a derivative equals extrapolated differences, and that these have converged."""
    by_difference, _ = difference(f, width)
    finer, _ = difference(f, 0.5 * width)
    size = max(abs(found), 1e-9)
    assert abs(by_difference - finer) < tolerance * size  # the differences have converged
    assert abs(found - finer) < tolerance * size


@pytest.fixture(scope="module")
def arm():
    """An arm that moves gently, with its state and torques."""
    scene = compile_scene(load_robot("arm7"), None, integrator="midpoint")
    rng = np.random.default_rng(0)
    state = initial_state(scene, 0.3 * rng.standard_normal(7))
    tau = Reference(np.linspace(0.0, 0.05, 5), 0.01 * rng.standard_normal((5, 7)), "cubic")
    return scene, state, tau


def value(scene, duration, cost, record, **given):
    return cost(simulate(scene, duration, record=record, estimate_error=False, **given))[0]


ALL = ("state.q", "state.qd", "tau", "links.mass", "links.center_of_mass", "links.inertia", "gravity")


@pytest.mark.long
def test_gradients_by_all_that_a_run_starts_from_are_those_of_differences(arm):
    scene, state, tau = arm
    found = gradient(scene, 0.05, mixed, ALL, state, tau=tau)
    assert found.value == value(scene, 0.05, mixed, ("q", "qd"), state=state, tau=tau)
    rng = np.random.default_rng(1)
    for name in ("q", "qd"):
        along, (first, end) = rng.standard_normal(7), scene.part(name)

        def at(h, along=along, first=first, end=end):
            moved = state.copy()
            moved[first:end] += h * along
            return value(scene, 0.05, mixed, ("q", "qd"), state=moved, tau=tau)

        agree(found[f"state.{name}"] @ along, at, 1e-3)
    along = rng.standard_normal((5, 7))

    def with_torques(h):
        signal = Reference(tau.times, tau.values + h * along, "cubic")
        return value(scene, 0.05, mixed, ("q", "qd"), state=state, tau=signal)

    agree(np.sum(found["tau"] * along), with_torques, 1e-4)
    for name in ("links.mass", "links.center_of_mass", "links.inertia"):
        section, _, key = name.partition(".")
        own = np.array([getattr(link, key) for link in scene.model.links])
        along = own * rng.uniform(0.5, 1.0, (len(own),) + (1,) * (own.ndim - 1))

        def at(h, own=own, along=along, section=section, key=key):
            world = Worlds(runs=1, **{section: {key: (own + h * along)[None]}}).scenes(scene)[0]
            return value(world, 0.05, mixed, ("q", "qd"), state=state, tau=tau)

        agree(np.sum(found[name] * along), at, 1e-3)


@pytest.mark.long
def test_a_tangent_times_an_adjoint_is_the_same_from_both_sides(arm):
    """<u, J v> = <J' u, v>, to rounding."""
    scene, state, tau = arm
    run = prepare(scene, 0.05, ("q", "qd"))
    others = [prepare(one, 0.05, ("q", "qd")) for one in table_of(scene, "links.mass").others]
    adjoint, rng = Adjoint(run, run.start(state, None, tau), others), np.random.default_rng(2)
    out = adjoint.run()
    weights = rng.standard_normal(out.shape)
    by_state = adjoint.pull(weights)
    tangents = rng.standard_normal((adjoint.length, 3))
    directions = np.vstack([np.zeros((1, 3)), rng.standard_normal((adjoint.entries - 1, 3))])
    pushed, _ = adjoint.push(tangents, directions)
    from_results = np.einsum("rc,rcp->p", weights, pushed)
    from_inputs = by_state @ tangents + adjoint.adjoints @ directions
    np.testing.assert_allclose(from_results, from_inputs, rtol=1e-12)


@pytest.mark.long
def test_bits_do_not_depend_on_threads_or_company(arm):
    scene, state, tau = arm
    states = [state, initial_state(scene), 0.5 * (state + initial_state(scene))]
    alone = [gradient(scene, 0.05, mixed, ALL, one, tau=tau) for one in states]
    for threads in (1, 3):
        together = gradient_batch(scene, 0.05, mixed, ALL, states, taus=[tau] * 3, threads=threads)
        for one, other in zip(alone, together):
            assert one.value == other.value
            assert all(one[name].tobytes() == other[name].tobytes() for name in ALL)


@pytest.mark.long
def test_segments_give_the_bits_of_one_piece(arm, monkeypatch):
    scene, state, tau = arm
    whole = gradient(scene, 0.05, mixed, ALL, state, tau=tau)
    monkeypatch.setattr(adjoint_module, "MOST_STATES", 25 * len(state))
    pieces = gradient(scene, 0.05, mixed, ALL, state, tau=tau)
    assert pieces.value == whole.value
    assert all(whole[name].tobytes() == pieces[name].tobytes() for name in ALL)


def projectile():
    """1 kg on two rails, along x and z."""
    links = Link("base"), Link("rail"), Link("stone", 1.0, inertia=(0.01, 0.0, 0.0, 0.01, 0.0, 0.01))
    rails = Joint("x", "prismatic", "base", "rail"), Joint("z", "prismatic", "rail", "stone", axis=(0.0, 0.0, 1.0))
    return compile_scene(Model("projectile", links, rails), integrator="implicit_euler", timestep=1e-3)


def test_a_projectile_comes_down_farther_by_its_speed_and_thrust():
    """x = v t + f t^2 / 2, z = v t + (f - g) t^2 / 2, to rounding where Euler's rule has t (t + h) for t^2."""
    scene, T = projectile(), 0.4

    @run_cost
    def far_and_high(q):
        return q[-1, 0] + 10.0 * q[-1, 1]

    found = gradient(scene, T, far_and_high, ["state.q", "state.qd", "tau"], initial_state(scene, None, [2.0, 3.0]),
                     tau=np.zeros(2))  # fmt: skip
    np.testing.assert_allclose(found["state.q"], [1.0, 10.0], atol=1e-12)
    np.testing.assert_allclose(found["state.qd"], [T, 10.0 * T], atol=1e-12)
    np.testing.assert_allclose(found["tau"], np.array([1.0, 10.0]) * T * (T + 1e-3) / 2, atol=1e-12)


@pytest.mark.long
def test_terminal_speed_falls_with_the_damping_of_the_joint():
    """A torque t on a vertical hinge with damping c turns it at t / c in the end."""
    scene = compile_scene(pendulum(damping=0.5, mass=0.01), gravity=(0.0, 0.0, 0.0), integrator="implicit_euler")

    @run_cost
    def speed(qd):
        return qd[-1, 0]

    found = gradient(scene, 1.0, speed, ["joints.damping", "tau"], tau=[0.2])
    assert found.value == pytest.approx(0.2 / 0.5, rel=1e-9)
    assert found["joints.damping"][0] == pytest.approx(-0.2 / 0.5**2, rel=1e-9)
    assert found["tau"] == pytest.approx(1.0 / 0.5, rel=1e-9)


@pytest.mark.long
def test_a_pendulum_swings_more_slowly_the_longer_it_is():
    """q = a cos(w t), w^2 = m g l / (I + m l^2) of a center of mass l below, for small a."""
    scene = compile_scene(pendulum(damping=0.0), integrator="midpoint", timestep=1e-3)
    a, T, m, length = 1e-4, 1.3, 1.0, 0.25
    inertia = m * 0.5**2 / 12

    @run_cost
    def at_the_end(q):
        return q[-1, 0]

    found = gradient(scene, T, at_the_end, ["links.rod.center_of_mass"], initial_state(scene, [a]))
    q = lambda l: a * math.cos(math.sqrt(m * G * l / (inertia + m * l * l)) * T)  # noqa: E731
    slope, _ = difference(lambda h: q(length + h), 1e-4)
    assert found.value == pytest.approx(q(length), rel=1e-4)
    assert -found["links.rod.center_of_mass"][2] == pytest.approx(slope, rel=1e-4)


@pytest.mark.long
def test_a_sliding_block_stops_after_a_way_that_its_friction_gives():
    """s = v^2 / (2 mu g); by mu it falls by s / mu, by v it grows by v / (mu g); less what springs back."""
    mu, v = 0.5, 1.0
    scene = box_on(Ground(friction=mu, penetration=1e-4), "implicit_euler", 1e-4, box(size=(0.4, 0.4, 0.001)))
    state = resting(scene, (v, 0.0, 0.0))
    found = gradient(scene, 0.3, reached, ["ground.friction", "state.base_qd"], state, record_interval=0.01)
    way = v * v / (2.0 * mu * G)
    assert found.value == pytest.approx(way, rel=1.5e-3)
    assert found["ground.friction"] == pytest.approx(-way / mu, rel=1.5e-3)
    assert found["state.base_qd"][0] == pytest.approx(v / (mu * G), rel=1.5e-3)


def test_an_objective_throws_a_projectile_where_it_is_to_land():
    """By BFGS; the range from flat ground is 2 vx vz / g, so that the least speed is at 45 degrees."""
    from scipy.optimize import minimize

    scene = projectile()

    @run_cost
    def miss(q, target):
        return (q[-1, 0] - target[0]) ** 2 + (q[-1, 1] - target[1]) ** 2

    def thrown(x):
        return {"state": initial_state(scene, None, x), "tau": np.zeros(2)}

    objective = RunObjective(scene, 0.4, miss.given(target=[1.0, 0.2]), thrown)
    found = minimize(objective, [0.0, 0.0], jac=True, method="BFGS")
    assert found.fun < 1e-20
    np.testing.assert_allclose(found.x, [1.0 / 0.4, 0.2 / 0.4 + G * 0.401 / 2], rtol=1e-6)
    assert found.nfev < 20


def test_more_knots_than_a_tape_holds_at_first(monkeypatch):
    scene = compile_scene(free_arm(), integrator="implicit_euler")
    times, values = np.linspace(0.0, 0.05, 40), 0.01 * np.random.default_rng(0).standard_normal((40, 7))
    whole = gradient(scene, 0.05, mixed, ["tau"], tau=Reference(times, values))["tau"]
    monkeypatch.setattr(adjoint_module, "ENTRIES", 50)
    assert np.array_equal(gradient(scene, 0.05, mixed, ["tau"], tau=Reference(times, values))["tau"], whole)
    monkeypatch.setattr(adjoint_module, "MOST_ENTRIES", 1000)
    with pytest.raises(ValueError, match=r"1092 numbers of signals.* at most 500: give signals fewer knots"):
        gradient(scene, 0.05, mixed, ["tau"], tau=Reference(times, values))


def test_a_cost_that_is_no_number_is_refused():
    scene = compile_scene(free_arm(), integrator="implicit_euler")
    with pytest.raises(ValueError, match="cost is nan of a run that ended well"):
        gradient(scene, 0.05, lambda channels: (math.nan, {}), ["tau"], tau=np.zeros(7), record=("q",))
