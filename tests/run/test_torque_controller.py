"""Compiled controllers that write torques: sampled, held, and the same as a loop of one's own around the equations."""

import hashlib
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm, solve_discrete_are

from featherstone_gait.dynamics import energy
from featherstone_gait.model import Joint, Link, Model
from featherstone_gait.run.program import controller
from featherstone_gait.run.reference import Reference
from featherstone_gait.run.session import Session
from featherstone_gait.run.simulate import initial_state, simulate, simulate_batch
from featherstone_gait.run.worlds import Worlds
from featherstone_gait.scene.compile import compile_scene

G = 9.81  # [m/s^2]
CART, POLE, LENGTH, INERTIA = 1.0, 0.2, 0.5, 0.02  # [kg], of the pole's center of mass [m], about it [kg m^2]
PERIOD = 0.02  # [s]
TIGHT = {"rtol": 1e-12, "atol": 1e-12}


def cart_pole():
    """A cart on rails and a pole that stands up at zero."""
    links = (
        Link("rails", 1.0, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)),
        Link("cart", CART, (0.0, 0.0, 0.0), (0.01, 0.0, 0.0, 0.01, 0.0, 0.01)),
        Link("pole", POLE, (0.0, 0.0, LENGTH), (INERTIA, 0.0, 0.0, INERTIA, 0.0, 0.001)),
    )
    slide = Joint("slide", "prismatic", "rails", "cart", axis=(1.0, 0.0, 0.0))
    hinge = Joint("hinge", "continuous", "cart", "pole", axis=(0.0, 1.0, 0.0))
    return Model("cart_pole", links, (slide, hinge))


def equations(t, x, force):
    """Rates of (cart, angle and their speeds) by Lagrange's equations."""
    _, angle, v, w = x
    s, c = math.sin(angle), math.cos(angle)
    M = np.array([[CART + POLE, POLE * LENGTH * c], [POLE * LENGTH * c, POLE * LENGTH**2 + INERTIA]])
    return np.r_[v, w, np.linalg.solve(M, [force + POLE * LENGTH * s * w * w, POLE * G * LENGTH * s])]


def sampled_loop(law, x, duration):
    """States at the ticks of a law (x, t) -> force that is held for a period, by SciPy's DOP853."""
    states = [np.array(x)]
    for k in range(round(duration / PERIOD)):
        held = law(states[-1], k * PERIOD)
        run = solve_ivp(equations, (0.0, PERIOD), states[-1], "DOP853", args=(held,), rtol=1e-12, atol=1e-12)
        states.append(run.y[:, -1])
    return np.array(states)


def regulator():
    """Gains (4,) of the discrete LQR about the upright pole."""
    A, small = np.zeros((4, 4)), 1e-6
    for k in range(4):
        dx = small * np.eye(4)[k]
        A[:, k] = (equations(0.0, dx, 0.0) - equations(0.0, -dx, 0.0)) / (2.0 * small)
    B = (equations(0.0, np.zeros(4), small) - equations(0.0, np.zeros(4), -small)) / (2.0 * small)
    whole = expm(PERIOD * np.block([[A, B[:, None]], [np.zeros((1, 5))]]))
    A, B = whole[:4, :4], whole[:4, 4:]
    P = solve_discrete_are(A, B, np.diag([1.0, 10.0, 0.1, 0.1]), np.array([[0.1]]))
    return np.linalg.solve(0.1 + B.T @ P @ B, B.T @ P @ A)[0]


@controller(memory=4, period=PERIOD, writes="torque")
def lqr(t, state, reference, command, memory):
    """Gains in its memory; the second joint has no motor."""
    x, angle = state.q[0] - reference[0, 0], state.q[1]
    command[0, 0] = -(memory[0] * x + memory[1] * angle + memory[2] * state.qd[0] + memory[3] * state.qd[1])


@controller(period=PERIOD, writes="torque")
def spring(t, state, reference, command, memory):
    for i in range(2):
        command[i, 0] = 20.0 * (reference[i, 0] - state.q[i]) + 2.0 * (reference[i, 1] - state.qd[i])


@controller(period=0.0073, writes="torque")
def odd(t, state, reference, command, memory):
    command[0, 0] = t


@controller(writes="torque", memory=1)
def broken(t, state, reference, command, memory):
    command[1, 0] = memory[0] / 3.0
    memory[0] = np.inf


@controller(writes="torque")
def divides(t, state, reference, command, memory):
    command[0, 0] = 1 // (3 - round(100.0 * t))


def start(scene):
    return initial_state(scene, [0.1, 0.2], [0.3, -0.4])


@pytest.mark.long
def test_a_regulator_holds_the_pole_as_its_own_loop_does():
    gains, goal = regulator(), Reference([0.0, 0.5], [[0.0, 0.0], [0.4, 0.0]])
    scene = compile_scene(cart_pole())
    run = simulate(scene, 2.0, start(scene), goal, controller=lqr.beginning_with(gains), estimate_error=False, **TIGHT)
    wanted = lambda t: np.array([0.8 * min(t, 0.5), 0.0, 0.0, 0.0])  # noqa: E731
    own = sampled_loop(lambda x, t: -gains @ (x - wanted(t)), [0.1, 0.2, 0.3, -0.4], 2.0)
    assert np.abs(run["q"][-1] - [0.4, 0.0]).max() < 0.1
    assert np.abs(run["q"] - own[:, :2]).max() < 1e-8
    assert np.abs(run["qd"] - own[:, 2:]).max() < 1e-8


def test_digests_tell_controllers_of_one_name_apart():
    """By the numbers that a controller has from outside, and those that its memory begins with."""

    def made(gain):
        @controller(writes="torque")
        def law(t, state, reference, command, memory):
            command[0, 0] = -gain * state.q[0]

        return law.digest()

    assert made(1.0) == made(1.0)
    assert made(1.0) != made(2.0)
    assert lqr.digest() != lqr.beginning_with(np.ones(4)).digest()


@pytest.mark.long
def test_what_fails_within_a_run_is_told():
    scene = compile_scene(cart_pole())
    with pytest.raises(ValueError, match=r"broken wrote inf as torque of joint hinge, command\[1, 0\], at 0\.01 s"):
        simulate(scene, 0.1, controller=broken, estimate_error=False)
    with pytest.raises(ValueError, match=r"divides failed at 0\.03 s: ZeroDivisionError"):
        simulate(scene, 0.1, controller=divides, estimate_error=False)


def test_what_does_not_fit_is_refused():
    scene = compile_scene(cart_pole(), integrator="rk4", timestep=1e-3)
    with pytest.raises(ValueError, match="add tau there"):
        simulate(scene, 0.1, controller=spring, tau=[1.0, 0.0], estimate_error=False)
    with pytest.raises(ValueError, match=r"its period is 0\.0073 s"):
        simulate(scene, 0.1, controller=odd)


@pytest.mark.long
@pytest.mark.parametrize(
    ("integrator", "order"), [("implicit_euler", 1), ("midpoint", 2), ("rk4", 4), ("ars343", None), ("dop853", None)]
)
def test_all_integrators_agree(integrator, order):
    """Fixed steps by their order, error control within its tolerance."""
    scene = compile_scene(cart_pole())
    exact = simulate(scene, 0.5, start(scene), controller=spring, estimate_error=False, **TIGHT)["q"]
    errors = []
    for h in (2e-3, 1e-3):
        scene = compile_scene(cart_pole(), integrator=integrator, timestep=h)
        run = simulate(scene, 0.5, start(scene), controller=spring, **({} if order else {"rtol": 1e-8}))
        assert run.ok
        errors.append(np.abs(run["q"] - exact).max())
        assert errors[-1] < 3.0 * run.error["q"].max() + 1e-10
    if order:
        assert errors[0] / errors[1] > 0.8 * 2**order
    else:
        assert errors[0] < 1e-6


@pytest.mark.long
def test_the_period_need_not_divide_a_millisecond():
    """The torque 7.3 ms * k from the k-th tick on moves a cart alone by a sum."""
    scene = compile_scene(cart_pole(), gravity=(0.0, 0.0, 0.0))
    model = scene.model
    alone = compile_scene(Model("cart", model.links[:2], model.joints[:1]))
    run = simulate(alone, 0.073, controller=odd, estimate_error=False, **TIGHT)
    speeds = np.cumsum(np.r_[0.0, 0.0073 * (0.0073 * np.arange(10))]) / CART
    assert np.allclose(run["time"], 0.0073 * np.arange(11), rtol=0, atol=1e-15)
    assert np.abs(run["qd"][:, 0] - speeds).max() < 1e-12


@pytest.mark.long
def test_its_work_is_in_the_energy_balance():
    scene = compile_scene(cart_pole())
    run = simulate(
        scene, 1.0, start(scene), Reference([0.0, 0.3], [[0.0, 0.0], [0.5, 1.0]]), controller=spring,
        record=("q", "qd", "energy"), estimate_error=False, **TIGHT,
    )  # fmt: skip
    work = run.column("energy", "work").sum(axis=1)
    total = energy(scene.model, run["q"], run["qd"]).total
    assert np.abs(work).max() > 0.5
    assert np.abs(total - total[0] - work).max() < 1e-9


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["midpoint", "dop853"])
def test_batches_worlds_and_sessions_have_the_bits_of_single_runs(integrator):
    scene = compile_scene(cart_pole(), integrator=integrator, timestep=1e-3)
    states = [initial_state(scene, [0.1 * k, 0.2]) for k in range(9)]
    goals = np.random.default_rng(0).uniform(-0.2, 0.2, size=(5, 9, 2))
    times = PERIOD * np.arange(5)
    references = [Reference(times, goals[:, k], "hold") for k in range(9)]
    alone = [
        simulate(scene, 0.1, state, reference, controller=spring, estimate_error=False)
        for state, reference in zip(states, references)
    ]
    batch = simulate_batch(scene, 0.1, states, references, controller=spring, estimate_error=False)
    assert [run.final.tobytes() for run in alone] == [run.final.tobytes() for run in batch]
    session = Session(scene, 9, controller=spring)
    session.reset(state=states)
    assert session.tick == PERIOD
    for goal in goals:
        session.step(goal)
    assert [run.final.tobytes() for run in alone] == [y.tobytes() for y in session.state]
    worlds = Worlds(runs=9, links={"pole.mass": np.linspace(0.1, 0.3, 9)})
    other = worlds.scenes(scene)[7]
    last = simulate_batch(scene, 0.1, states, references, worlds=worlds, controller=spring, estimate_error=False)[7]
    single = simulate(other, 0.1, states[7], references[7], controller=spring, estimate_error=False)
    assert last.final.tobytes() == single.final.tobytes() != alone[7].final.tobytes()


@pytest.mark.long
@pytest.mark.nojit
def test_the_bits_are_these_compiled_or_not():
    found = []
    for integrator in ("midpoint", "ars343", "dop853"):
        scene = compile_scene(cart_pole(), integrator=integrator, timestep=1e-3)
        found.append(simulate(scene, 0.1, start(scene), controller=spring, estimate_error=False).final.tobytes())
    assert hashlib.sha256(b"".join(found)).hexdigest()[:16] == "a320ef608e9f1ce6"


def double_pendulum():
    """Two uniform rods of 1 kg and 0.4 m that hang down at zero."""
    inertia = (0.4**2 / 12, 0.0, 0.0, 0.4**2 / 12, 0.0, 1e-3)
    links = (
        Link("stand", 1.0, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)),
        *(Link(name, 1.0, (0.0, 0.0, -0.2), inertia) for name in ("upper", "lower")),
    )
    shoulder = Joint("shoulder", "continuous", "stand", "upper", axis=(0.0, -1.0, 0.0))
    elbow = Joint("elbow", "continuous", "upper", "lower", (0.0, 0.0, -0.4), axis=(0.0, -1.0, 0.0))
    return Model("double_pendulum", links, (shoulder, elbow))


def computed_torque(period):
    """M(q) (a_ref - 20 e' - 100 e) + bias, for sines of 1 and 2 rad/s."""

    @controller(period=period, writes="torque")
    def law(t, state, reference, command, memory):
        m, d, L, J = 1.0, 0.2, 0.4, 0.4**2 / 12
        a, b, u, v = state.q[0], state.q[1], state.qd[0], state.qd[1]
        cos, sin = math.cos(b), math.sin(b)
        wanted = (
            -math.sin(t) + 20.0 * (math.cos(t) - u) + 100.0 * (math.sin(t) - a),
            -4.0 * math.sin(2.0 * t) + 20.0 * (2.0 * math.cos(2.0 * t) - v) + 100.0 * (math.sin(2.0 * t) - b),
        )
        lower = J + m * d * d
        both = lower + m * L * d * cos
        whole = J + m * d * d + m * L * L + lower + 2.0 * m * L * d * cos
        pull = 9.81 * m * d * math.sin(a + b)
        command[0, 0] = whole * wanted[0] + both * wanted[1] - m * L * d * sin * (2.0 * u * v + v * v)
        command[0, 0] += 9.81 * m * (d + L) * math.sin(a) + pull
        command[1, 0] = both * wanted[0] + lower * wanted[1] + m * L * d * sin * u * u + pull

    return law


@pytest.mark.long
def test_computed_torque_makes_the_error_decay_as_if_linear():
    """e'' + 20 e' + 100 e = 0, so that e = (1 + 10 t) exp(-10 t) e(0) here, but for what holding the torque does."""
    scene, errors = compile_scene(double_pendulum()), []
    for period in (2e-3, 1e-3):
        first = initial_state(scene, [0.3, -0.2], [1.0, 2.0])
        run = simulate(scene, 2.0, first, controller=computed_torque(period), estimate_error=False)
        t = run["time"]
        tracked = run["q"] - np.column_stack([np.sin(t), np.sin(2.0 * t)])
        linear = ((1.0 + 10.0 * t) * np.exp(-10.0 * t))[:, None] * [0.3, -0.2]
        errors.append(np.abs(tracked - linear).max())
    assert errors[1] < 5e-3
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.1)
