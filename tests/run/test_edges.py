"""Torques, references and pushes that change within fixed steps: none is lost, and the estimate covers the rest."""

import math
from dataclasses import replace

import numba
import numpy as np
import pytest
from scenes import pendulum
from scipy.interpolate import PPoly

from featherstone_gait import (
    Joint,
    Link,
    Model,
    Push,
    Reference,
    Session,
    compile_scene,
    initial_state,
    load_servo,
    simulate,
    simulate_batch,
)
from featherstone_gait.core.step.signals import _over_step
from featherstone_gait.run.error_estimate import edges_on_steps

FIXED = ("implicit_euler", "midpoint", "rk4")
MASS = 2.0  # [kg]


def slider():
    """A mass on a frictionless rail."""
    links = (
        Link("base", 0.0, (0.0, 0.0, 0.0), (0.0,) * 6),
        Link("car", MASS, (0.0, 0.0, 0.0), (0.01, 0, 0, 0.01, 0, 0.01)),
    )
    joint = Joint("rail", "prismatic", "base", "car", axis=(1.0, 0.0, 0.0), lower=-math.inf, upper=math.inf)
    return Model("slider", links, (joint,))


def pulse(begin, length, force):
    """A force that is held for a time, and zero before and after it."""
    times, values = [begin, begin + length], [[force], [0.0]]
    return Reference([0.0, *times], [[0.0], *values], "hold") if begin > 0.0 else Reference(times, values, "hold")


def polynomial(signal):
    """A signal that is not cyclic, as SciPy has it."""
    knots = signal.knots()
    held = np.zeros((4, 1))
    held[3] = signal.values[-1]
    return PPoly(np.hstack([knots.cubics[:, 0, ::-1].T, held]), np.append(knots.times, 1e3))


@numba.njit
def sweep(knots, begin, h, at, out):
    for k in range(len(begin)):
        _over_step(knots, begin[k], h, at[k], out[k])


# --- the mean over a step ------------------------------------------------------------------------------------------


@pytest.mark.nojit
@pytest.mark.parametrize("kind", ["hold", "linear", "cubic"])
@pytest.mark.parametrize("cyclic", [False, True])
def test_a_step_with_knots_takes_the_mean(kind, cyclic):
    rng = np.random.default_rng(3)
    times = np.concatenate([[0.0], (np.arange(30) + rng.uniform(size=30)) / 30, [1.0]])  # none 0.07 s apart
    values = rng.normal(size=(32, 1))
    values[-1] = values[0] if cyclic else values[-2]
    signal, h = Reference(times, values, kind, cyclic), 0.07
    begin = h * np.arange(14 if not cyclic else 40)
    found = np.zeros((len(begin), 1, 2))
    sweep(signal.knots(), begin, h, begin, found)
    if cyclic:
        knots = signal.knots()
        curve = PPoly(knots.cubics[:, 0, ::-1].T, knots.times, extrapolate="periodic")
    else:
        curve = polynomial(signal)
    expected = [curve.integrate(a, a + h) / h for a in begin]
    np.testing.assert_allclose(found[:, 0, 0], expected, rtol=0, atol=1e-11)


@pytest.mark.nojit
def test_a_step_between_knots_takes_the_value_at_its_time_and_a_constant_stays_itself():
    found = np.zeros((3, 1, 2))
    signal = Reference([0.0, 0.1, 0.2], [[1.0], [2.0], [4.0]], "hold")
    sweep(signal.knots(), np.array([0.0, 0.1, 0.2]), 0.1, np.array([0.1, 0.2, 0.3]), found)
    assert found[:, 0, 0].tolist() == [1.0, 2.0, 4.0]  # each step ends at a knot, and knows what was before it
    signal = Reference([0.0, 0.1, 0.2], [[1.0], [2.0], [4.0]])
    sweep(signal.knots(), np.array([0.0, 0.1, 0.15]), 0.05, np.array([0.02, 0.15, 0.2]), found)
    np.testing.assert_allclose(found[:, 0, 0], [1.2, 3.0, 4.0], rtol=1e-15)
    constant = Reference([0.0, 0.013, 0.017], np.full((3, 1), 0.1))
    sweep(constant.knots(), np.zeros(1), 0.1, np.zeros(1), found)
    assert found[0, 0, 0] == 0.1


# --- runs ----------------------------------------------------------------------------------------------------------


def torque(begin, length, force):
    return {"tau": pulse(begin, length, force)}


def push(begin, length, force):
    return {"pushes": [Push("car", (force, 0.0, 0.0), start=begin, end=begin + length)]}


@pytest.mark.long
@pytest.mark.parametrize("kind", [torque, push], ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("integrator", FIXED)
def test_a_kick_keeps_its_impulse_and_its_estimate_covers_its_place(integrator, kind):
    """Also shorter than a step, late in one, on the steps, and at the very start and end."""
    kicks = [
        (1e-3, 0.1003, 3e-4, 20e3), (1e-2, 0.1013, 3e-3, 2e3), (1e-3, 0.0, 1e-3, 20e3), (1e-3, 0.0, 1e-4, 20e3),
        (5e-3, 0.1, 5e-3, 2.4e3), (1e-3, 0.10095, 5e-5, 480e3), (1e-3, 0.4999, 1e-4, 20e3), (1e-3, 0.499, 1e-3, 2e3),
    ]  # fmt: skip
    for h, begin, length, force in kicks:
        scene = compile_scene(slider(), integrator=integrator, timestep=h)
        speed = force * length / MASS
        run = simulate(scene, 0.5, **kind(begin, length, force))
        assert run["qd"][-1, 0] == pytest.approx(speed, rel=1e-9)
        off = abs(run["q"][-1, 0] - speed * (0.5 - begin - length / 2))
        assert off < speed * h
        assert off < 1.2 * run.error["q"][-1, 0] + 1e-9
        assert run.ok == (run.error["q"].max() <= 1e-2)


def drawn(rng, duration, h):
    """A random force: a pulse, a spike, noise, a ramp, on the steps or off them, or one that repeats."""
    kind, case = str(rng.choice(["hold", "linear", "cubic"])), rng.integers(5)
    if case == 0:
        length = 10.0 ** rng.uniform(-5.0, -1.5)
        begin = float(rng.choice([0.0, duration - 2 * length, rng.uniform(0.0, duration)]))
        times = begin + length * np.array([-1.0, 0.0, 0.5, 1.0, 2.0])
        values = 10.0 ** rng.uniform(-1.0, 1.0) / length * np.array([0.0, kind == "hold", 1.0, 0.0, 0.0])
    elif case == 1:
        times = np.sort(rng.choice(round(duration / 1e-5), rng.integers(2, 40), replace=False)) * 1e-5
        values = 5.0 * rng.normal(size=len(times))
    elif case == 2:
        times = np.sort(rng.choice(round(duration / h) + 1, rng.integers(2, 12), replace=False)) * h
        values = 20.0 * rng.normal(size=len(times))
    elif case == 3:
        times, values = np.sort(rng.uniform(0.0, duration, 2)), 5.0 * rng.normal(size=2)
    else:
        period = 10.0 ** rng.uniform(-3.0, -0.5)
        times, values = period * np.array([0.0, 0.2, 0.35, 0.8, 1.0]), 5.0 * rng.normal(size=5)
        values[-1] = values[0]
    return Reference(times, values[:, None], kind, cyclic=bool(case == 4))


def followed():
    """A pendulum whose servo follows its reference at every instant."""
    servo = load_servo("ax12", law="pd", Kp=20.0, Kd=0.8, viscous_friction=0.0, coulomb_friction=0.0)
    return replace(pendulum(), servos={"hinge": servo})


def covered(integrator, make, seed):
    """Check that a run under a random signal is within its estimate, and not wrong where it says ok."""
    rng = np.random.default_rng(seed)
    h, model = float(rng.choice([5e-4, 1e-3, 2e-3, 5e-3, 1e-2])), make()
    gearbox = "standard" if model.servos else None
    signal, small = drawn(rng, 0.5, h), 0.02 if model.servos else 0.3
    signal = Reference(signal.times, small * signal.values, signal.kind, signal.cyclic)
    how = {"reference" if model.servos else "tau": signal, "record_interval": 0.01}
    scene, exactly = (compile_scene(model, gearbox, None, name, h) for name in (integrator, "extrapolation"))
    begin = initial_state(scene, [0.3])
    run, exact = (
        simulate(scene, 0.5, begin, **how),
        simulate(exactly, 0.5, begin, **how, rtol=1e-10, estimate_error=False),
    )
    off, fast = (np.abs(run[name] - exact[name]).max() for name in ("q", "qd"))
    assert off < 10.0 * run.error["q"].max() + 1e-6
    assert fast < 10.0 * run.error["qd"].max() + 1e-5
    assert not run.ok or (off < 1e-2 and fast < 0.1 * max(1.0, np.abs(run["qd"]).max()))


@pytest.mark.long
@pytest.mark.parametrize("make", [slider, pendulum, followed], ids=lambda make: make.__name__)
@pytest.mark.parametrize("integrator", FIXED)
def test_no_random_signal_is_misplaced_unsaid(integrator, make):
    for seed in range(100, 130):
        covered(integrator, make, seed)


@pytest.mark.long
@pytest.mark.parametrize("integrator", FIXED)
def test_a_torque_in_lanes_has_the_bits_of_one_alone(integrator):
    scene = compile_scene(pendulum(), integrator=integrator, timestep=1e-3)
    taus = [Reference([0.0, 0.0203, 0.0206], [[0.1], [30.0 * k], [0.0]], "hold") for k in range(9)]
    for tau, run in zip(taus, simulate_batch(scene, 0.05, taus=taus)):
        alone = simulate(scene, 0.05, tau=tau)
        assert run.final.tobytes() == alone.final.tobytes()
        assert run.error["q"].tobytes() == alone.error["q"].tobytes()


@pytest.mark.long
def test_a_push_late_in_a_step_of_a_session_is_in_its_error():
    scene = compile_scene(slider(), integrator="implicit_euler", timestep=1e-3)
    begin, length = 0.10095, 1e-5
    session = Session(
        scene, 2, pushes=[Push("car", (24.0 / length, 0.0, 0.0), start=begin, end=begin + length)], estimate_error=True
    )
    for _ in range(20):
        session.step()
    off = np.abs(session.state_view.q - 12.0 * (0.2 - begin - length / 2))
    assert (off > 1e-2).all()
    assert (off < 1.1 * session.error("q")).all()
    assert session.status == ["inaccurate"] * 2


@pytest.mark.nojit
def test_edges_lie_on_steps_or_within_them():
    scene = compile_scene(slider(), integrator="midpoint", timestep=1e-3)

    def found(*times, begin=0.0, cyclic=False):
        values = np.arange(len(times), dtype=float)[:, None] % (len(times) - 1 if cyclic else len(times))
        return edges_on_steps(scene, begin, (), Reference(times, values, cyclic=cyclic))

    assert found(0.0, 0.1, 0.3) == 2
    assert found(0.0, 0.1, 0.301) == 1
    assert found(0.0, 0.1, 0.3003) == 0
    assert found(0.0, 0.1, 0.3, begin=0.05) == 2
    assert found(0.0, 0.1, 0.3, begin=0.0003) == 0
    assert found(0.0, 0.1, 0.3, cyclic=True) == 2
    assert found(0.0, 0.1, 0.3003, cyclic=True) == 0
    assert edges_on_steps(scene, 0.0, (), Reference([0.0, 0.3003], [[1.0], [1.0]])) == 2
    assert edges_on_steps(scene, 0.0, [Push("car")]) == 2
    wave = Reference([0.0, 0.1, 0.2], [[0.0], [1.0], [0.0]], cyclic=True)
    assert edges_on_steps(scene, 0.0, [Push("car")], wave) == 2
    assert edges_on_steps(scene, 0.3, [Push("car", start=0.1, end=0.2003)]) == 2
    assert edges_on_steps(scene, 0.0, [Push("car", start=0.1, end=0.2003)]) == 0
    assert edges_on_steps(scene, 0.0, [Push("car", start=0.1, end=0.2003)], until=0.2) == 2
