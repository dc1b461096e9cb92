"""Matrices of a step or a controller period: closed forms, another engine's, and what the simulation itself does."""

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scenes import arm_scene, box_on, pendulum, resting
from scipy.linalg import expm

from featherstone_gait import Ground, Reference, compile_scene, initial_state, linearize, load_robot, simulate, trim
from featherstone_gait.analysis.period_runs import _spare
from featherstone_gait.benchmark.linearize import _falling
from featherstone_gait.model import Controller, Joint, Link, Mimic, Model, Servo, Spring
from featherstone_gait.walking.walker import load_walker

G, LENGTH, MASS, DAMPING = 9.81, 0.5, 1.0, 0.05  # of `pendulum`
INERTIA = MASS * LENGTH**2 / 3
KP, KD = 8.0, 0.4


def driven_pendulum():
    """By a servo of the law Kp e - Kd v."""
    servo = Servo(Controller("pd", Kp=KP, Kd=KD), resistance=1.0, motor_constant=1.0, voltage_limit=10.0)
    return replace(pendulum(), servos={"hinge": servo})


def exact(T, angle=0.0, Kp=KP, Kd=KD, input_gain=KP):
    """exp of [[F, g], [0, 0]] T of the pendulum about rest at an angle."""
    M = np.zeros((3, 3))
    stiffness = Kp + MASS * G * LENGTH / 2 * math.cos(angle)
    M[0, 1], M[1] = 1.0, np.array([-stiffness, -(Kd + DAMPING), input_gain]) / INERTIA
    E = expm(M * T)
    return E[:2, :2], E[:2, 2:]


@pytest.mark.long
@pytest.mark.parametrize("angle", [0.0, 0.7])
def test_a_pendulum_on_a_pd_servo_has_the_matrix_exponential_of_its_equation(angle):
    """At rest under the reference that holds it; error control integrates to 1e-12."""
    scene = compile_scene(driven_pendulum(), "standard", integrator="dop853")
    reference = [angle + MASS * G * LENGTH / 2 * math.sin(angle) / KP]
    found = linearize(scene, initial_state(scene, [angle]), reference, steps=scene.tick_steps)
    A, B = exact(found.period, angle)
    assert found.states == ("q hinge", "qd hinge")
    assert found.inputs == ("reference hinge",)
    np.testing.assert_allclose(found.A, A, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(found.B, B, rtol=1e-8, atol=1e-10)
    assert (np.abs(found.A - A) <= found.A_error + 1e-11).all()
    assert found.discontinuities == ()
    assert np.abs(found.change).max() < 1e-12


@pytest.mark.long
@pytest.mark.bounds
@pytest.mark.nojit
def test_of_the_midpoint_rule_they_approach_it_as_the_square_of_the_step():
    """Eigenvalues of two steps' lengths; the third, of the acceleration that the rule remembers, dies out."""
    A, _ = exact(0.01, Kp=0.0, Kd=0.0, input_gain=1.0)
    errors = []
    for h in (2e-3, 1e-3):
        scene = compile_scene(pendulum(), integrator="midpoint", timestep=h)
        found = linearize(scene, steps=round(0.01 / h))
        assert found.states == ("q hinge", "qd hinge", "qdd hinge")
        values = sorted(np.linalg.eigvals(found.A), key=abs)
        assert abs(values[0]) < 0.01
        pairs = zip(sorted(values[1:], key=np.imag), sorted(np.linalg.eigvals(A), key=np.imag))
        errors.append(max(abs(value - true) for value, true in pairs))
    assert 3.8 < errors[0] / errors[1] < 4.2
    state = initial_state(scene, [0.5])
    later = state.copy()
    later[scene.layout["end_time"]] = 1.0  # where no run begins by Euler's step
    assert linearize(scene, state, steps=3).A.tobytes() == linearize(scene, later, steps=3).A.tobytes()


@pytest.mark.long
def test_what_alternates_under_the_midpoint_rule_on_a_stiff_floor_dies_at_a_rate_that_both_steps_agree_on():
    """A motion e^-rt is multiplied by (1 - hr/2) / (1 + hr/2), so the soles' rates r follow from their eigenvalues."""
    rates = []
    for h in (1e-3, 2.5e-4):
        scene = compile_scene(load_walker("humanoid"), "mipsd", Ground(penetration=3e-5), "midpoint", h)
        rest = trim(scene)
        values = np.linalg.eigvals(linearize(scene, rest.state, rest.reference, steps=1).A)
        last = np.sort(values[abs(values.imag) < 1e-6].real)[:4]
        rates.append(2.0 / h * (1.0 - last) / (1.0 + last))
    np.testing.assert_allclose(*rates, rtol=0.01)
    assert rates[0].min() > 20_000.0


def sliders(count, stiffness, mass):
    """Masses on rails, from the wall on each tied to the next one by a spring."""
    names = ["wall", *(f"mass{k}" for k in range(count))]
    body = {"mass": mass, "center_of_mass": (0.0,) * 3, "inertia": (1e-3, 0.0, 0.0, 1e-3, 0.0, 1e-3)}
    links = (Link("wall", 0.0, (0.0,) * 3, (0.0,) * 6), *(Link(name, **body) for name in names[1:]))
    rail = {"axis": (1.0, 0.0, 0.0), "lower": -10.0, "upper": 10.0, "effort": 100.0}
    joints = tuple(
        Joint(f"rail{k}", "prismatic", "wall", f"mass{k}", (1.0 + k, 0.0, 0.0), **rail) for k in range(count)
    )
    springs = [Spring(a, b, stiffness=stiffness, length=1.0) for a, b in pairwise(names)]
    return Model("sliders", links, joints), springs


@pytest.mark.long
def test_a_chain_of_springs_has_the_matrix_exponential_of_its_equation():
    n, k, m = 3, 40.0, 0.5
    model, springs = sliders(n, k, m)
    scene = compile_scene(model, integrator="dop853", springs=springs, gravity=(0.0, 0.0, 0.0))
    found = linearize(scene, steps=20)
    K = k * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    K[-1, -1] = k
    F = np.block([[np.zeros((n, n)), np.eye(n), np.zeros((n, n))], [-K / m, np.zeros((n, n)), np.eye(n) / m]])
    E = expm(np.vstack([F, np.zeros((n, 3 * n))]) * found.period)
    np.testing.assert_allclose(found.A, E[: 2 * n, : 2 * n], rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(found.B, E[: 2 * n, 2 * n :], rtol=1e-8, atol=1e-10)


@pytest.mark.long
def test_two_periods_are_the_square_of_one_at_an_equilibrium():
    """Of the arm that its servos hold: all that is remembered from tick to tick is among the states."""
    scene = arm_scene(integrator="midpoint")
    state = simulate(scene, 30.0, reference=Reference([0.0], np.zeros((1, 7))), estimate_error=False).final
    one = linearize(scene, state, np.zeros(7))
    two = linearize(scene, state, np.zeros(7), steps=2 * scene.tick_steps)
    assert two.states == one.states
    assert np.abs(one.change[one.of("q", "qd")]).max() < 1e-9
    scale = np.abs(two.A).max(axis=1, keepdims=True)
    assert (np.abs(one.A @ one.A - two.A) / scale).max() < 1e-6
    scale = np.abs(two.B).max(axis=1, keepdims=True)
    assert (np.abs(one.A @ one.B + one.B - two.B) / scale).max() < 1e-6


@pytest.mark.long
def test_small_deviations_go_where_the_matrices_take_them():
    """What the linear model misses falls as the square of the deviation; a floating base and moving joints."""
    scene = compile_scene(load_robot("humanoid"), integrator="implicit_euler", timestep=1e-3, gravity=(0.0, 0.0, 0.0))
    rng = np.random.default_rng(3)
    n = scene.tree.n
    q = np.concatenate([[0.0, 0.0, 1.0, 0.8, 0.1, -0.5, 0.3], 0.3 * rng.normal(size=n)])
    state, tau = initial_state(scene, q, rng.normal(size=n + 6), allow_limit_violation=True), 0.1 * rng.normal(size=n)
    found = linearize(scene, state, tau=tau, steps=10, outputs=("qdd",))
    x, u = rng.normal(size=len(found.states)), rng.normal(size=n)
    missed = []
    for size in (2e-3, 1e-3):
        ends = [
            simulate(scene, 0.01, found.moved(s * x), tau=tau + s * u, estimate_error=False, record=()).final
            for s in (size, 0.0)
        ]
        moved = found.chart.difference(ends[0][:, None], ends[1])[:, 0]
        missed.append(np.abs(moved - size * (found.A @ x + found.B @ u)).max())
    assert missed[0] < 1e-3
    assert 3.5 < missed[0] / missed[1] < 4.5
    qdd = slice(*scene.part("qdd"))
    change = ends[0][qdd] - ends[1][qdd]
    np.testing.assert_allclose(change, size * (found.C @ x + found.D @ u), atol=0.02 * np.abs(change).max())


@pytest.mark.long
@pytest.mark.nojit
def test_moved_and_deviation_are_inverse():
    scene = box_on(Ground())
    found = linearize(scene, resting(scene))
    x = 0.1 * np.random.default_rng(0).normal(size=len(found.states))
    np.testing.assert_allclose(found.deviation(found.moved(x)), x, rtol=1e-12, atol=1e-15)


@pytest.mark.long
def test_a_resting_box_has_no_discontinuity_and_one_that_touches_has_one_that_is_named():
    """A point on the surface pushes when it is lower, and not when it is higher: k h / m of its speed in a step."""
    scene = box_on(Ground())
    assert linearize(scene, resting(scene)).discontinuities == ()
    ground = scene.ground
    q = np.array([0.0, 0.0, 0.05, 1.0, 0.0, 0.0, 0.0])
    quick = compile_scene(scene.model, ground=ground, integrator="rk4", timestep=1e-5)
    found = linearize(quick, initial_state(quick, q))
    height = next(each for each in found.discontinuities if each.column == "base_q z")
    row = height.rows.index("base_qd vz")
    k, m = scene.constants.contact.points.stiffness.sum(), scene.model.mass
    assert abs(height.right[row]) < 0.01 * abs(height.left[row])
    assert height.left[row] == pytest.approx(-k * 1e-5 / m, rel=0.05)
    column, line = found.states.index("base_q z"), found.states.index("base_qd vz")
    assert found.A_error[line, column] == pytest.approx(0.5 * (height.right[row] - height.left[row]))


def test_a_voltage_at_its_limit_is_a_discontinuity():
    """A reference beyond it changes nothing, one within it does."""
    model = load_robot("arm7")
    weaker = {name: replace(servo, voltage_limit=5.0) for name, servo in model.servos.items()}  # currents stay free
    arm = arm_scene(replace(model, servos=weaker))
    controller = arm.constants.actuator.controller
    limit = controller.voltage_limit[0] / controller.Kp[0]
    reference = np.zeros(7)
    reference[0] = limit
    found = linearize(arm, initial_state(arm), reference)
    switch = next(each for each in found.discontinuities if each.column == "reference joint1")
    row = switch.rows.index("current joint1")
    assert switch.right[row] == 0.0
    assert switch.left[row] > 1.0


@pytest.mark.long
def test_held_voltages_are_inputs_too():
    """The reference acts by way of the voltage alone, Kp volts by radian."""
    arm = arm_scene(load_robot("arm7"))
    by_reference, by_voltage = linearize(arm, None, np.zeros(7)), linearize(arm, inputs=("voltage",))
    Kp = arm.constants.actuator.controller.Kp
    assert by_voltage.inputs == tuple(f"voltage {name}" for name in arm.model.joint_names)
    rows = [by_reference.states.index(name) for name in by_voltage.states]
    scale = np.abs(by_reference.B).max()
    np.testing.assert_allclose(by_voltage.B * Kp, by_reference.B[rows], atol=1e-7 * scale)


@pytest.mark.long
def test_followers_are_no_states():
    free = load_robot("arm7_spatial")
    joints = [j if j.name != "joint3" else replace(j, mimic=Mimic("joint2", 0.5)) for j in free.joints]
    model = replace(free, joints=tuple(joints))
    scene = compile_scene(model, integrator="implicit_euler", timestep=1e-3)
    found = linearize(scene)
    assert "q joint3" not in found.states
    state = found.moved(0.01 * np.ones(len(found.states)))
    first = scene.part("q")[0]
    assert state[first + 2] == pytest.approx(0.005)


@pytest.mark.long
def test_threads_do_not_change_the_bits():
    scene = arm_scene(load_robot("arm7"), integrator="midpoint")
    one, three = (linearize(scene, threads=k, outputs=("torque",)) for k in (1, 3))
    for name in ("A", "B", "C", "D", "A_error", "change"):
        assert getattr(one, name).tobytes() == getattr(three, name).tobytes(), name


@pytest.mark.long
def test_calls_one_after_the_other_and_side_by_side_have_the_same_bits():
    """What a call computes in is left to the next one: other states, other signals, one that is refused between."""
    scene = arm_scene(load_robot("arm7"), integrator="midpoint")
    first, second = initial_state(scene), initial_state(scene, 0.1 * np.arange(7))
    moving = Reference([0.0, 0.3], np.array([np.zeros(7), np.full(7, 0.2)]), "linear")
    torque, rising = 0.1 * np.ones(7), Reference([0.0, 1.0], np.array([np.zeros(7), np.ones(7)]), "linear")
    given = [
        ((scene, first, np.zeros(7)), {}),
        ((scene, second, moving), {"outputs": ("torque", "current"), "steps": 25}),
        ((scene, second), {"inputs": ("voltage",)}),
        ((scene, first, np.zeros(7), torque), {"inputs": ("reference", "torque")}),
        ((scene, first, np.zeros(7), rising), {"inputs": ("reference", "torque"), "steps": 3}),
    ]

    def called(which):
        found = linearize(*given[which][0], **given[which][1])
        return [getattr(found, name).tobytes() for name in ("A", "B", "C", "D", "A_error", "change")]

    fresh = []
    for which in range(len(given)):
        _spare.cache_clear()
        fresh.append(called(which))
    order = [*range(len(given))] * 3
    with pytest.raises(ValueError, match="diverged"):
        linearize(scene, initial_state(scene, qd=np.full(7, 1e9)), np.zeros(7))
    assert [called(which) for which in order] == [fresh[which] for which in order]
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(called, order)) == [fresh[which] for which in order]


@pytest.mark.long
def test_an_error_is_no_less_than_what_rounding_makes_of_an_entry():
    """Of a mass on a rail, which nothing holds, the matrices are [[1, h], [0, 1]] and [h^2 / m, h / m], at zero too."""
    model, _ = sliders(1, 1.0, 0.7)
    scene = compile_scene(model, integrator="implicit_euler", timestep=1e-3, gravity=(0.0, 0.0, 0.0))
    for speed in (0.0, 0.3):
        found = linearize(scene, initial_state(scene, [0.0], [speed]))
        assert (np.abs(found.A - [[1.0, 1e-3], [0.0, 1.0]]) <= found.A_error).all()
        assert (np.abs(found.B - [[1e-6 / 0.7], [1e-3 / 0.7]]) <= found.B_error).all()
        assert found.A_error.max() < 1e-9


@pytest.mark.long
def test_mujoco_has_the_same_matrices():
    """mjd_transitionFD of the free arm under torques, by semi-implicit Euler; its own error is some 1e-8."""
    import mujoco
    from mujoco_oracle import Oracle

    model = load_robot("arm7_spatial")
    oracle = Oracle(model)
    m, d = oracle.m, mujoco.MjData(oracle.m)
    m.opt.timestep, m.opt.integrator = 1e-3, mujoco.mjtIntegrator.mjINT_EULER
    rng = np.random.default_rng(5)
    q, qd, tau = 0.5 * rng.normal(size=7), rng.normal(size=7), 0.05 * rng.normal(size=7)
    d.qpos[oracle.positions], d.qvel[oracle.dofs], d.qfrc_applied[oracle.dofs] = q, qd, tau
    A, B = np.zeros((14, 14)), np.zeros((14, m.nu))
    mujoco.mjd_transitionFD(m, d, 1e-6, True, A, B, None, None)
    scene = compile_scene(model, integrator="implicit_euler", timestep=1e-3)
    found = linearize(scene, initial_state(scene, q, qd, allow_limit_violation=True), tau=tau)
    order = [*oracle.dofs, *(7 + oracle.dofs)]
    theirs = A[np.ix_(order, order)]
    np.testing.assert_allclose(found.A, theirs, atol=2e-8 * np.abs(theirs).max())
    assert found.A_error.max() < 1e-8 * np.abs(theirs).max()


@pytest.mark.long
def test_the_benchmark_compares_what_is_comparable():
    """Falling, MuJoCo and we make the same steps: both meet what MuJoCo extrapolates to."""
    (theirs, _), (ours, _), _ = _falling(load_robot("humanoid"))
    assert theirs.error < 1e-6
    assert ours.error < 1e-8


@pytest.mark.nojit
@pytest.mark.parametrize(
    ("given", "what"),
    [
        ({"inputs": ("reference",)}, "a reference needs servos"),
        ({"inputs": ("voltage",)}, "voltages stand where"),
        ({"inputs": ("speed",)}, "expected 'reference', 'torque' or 'voltage'"),
        ({"outputs": ("power",)}, "outputs is 'power'; expected 'base_q'"),
        ({"states": ("torques",)}, "expected 'q', 'qd'"),
        ({"steps": 0}, "steps is 0"),
        ({"tau": [1.0, 2.0]}, "tau must be 1 finite numbers"),
        ({"threads": 0}, "threads is 0"),
    ],
)
def test_what_does_not_fit_is_named(given, what):
    scene = compile_scene(pendulum(), integrator="implicit_euler", timestep=1e-3)
    with pytest.raises(ValueError, match=what):
        linearize(scene, **given)


@pytest.mark.long
def test_a_robot_that_falls_within_the_period_is_named():
    scene = compile_scene(load_robot("humanoid"), ground=Ground(), integrator="implicit_euler", timestep=1e-3)
    lying = initial_state(scene, [0.0, 0.0, 0.3, 0.6, 0.0, 0.8, 0.0, *np.zeros(scene.tree.n)])
    with pytest.raises(ValueError, match="fell"):
        linearize(scene, lying)
