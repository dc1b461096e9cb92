"""The benchmarks' problems obey their physics, their errors fall as they must, and engines agree where compared."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from featherstone_gait.benchmark import case, linkages, precision, scenes
from featherstone_gait.dynamics import energy, loop_gaps
from featherstone_gait.run.simulate import simulate


def errors(problem, integrator, settings):
    rows = precision.measure(problem, repeats=1, settings=[(integrator, value) for value in settings])
    assert all(row.time > 0 and row.call > 0 and row.evaluations > 0 for row in rows)
    return [row.error for row in rows]


# --- problems ----------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_the_simple_box_turns_evenly():
    """Against its closed form: rounding only for order 8; the midpoint rule's quaternion lags as the step squared."""
    problem = scenes.free_box("simple")
    assert errors(problem, "dop853", [1e-12])[0] < 1e-11
    coarse, fine = errors(problem, "midpoint", [2e-2, 1e-2])
    assert coarse / fine == pytest.approx(4.0, rel=0.01)


@pytest.mark.long
def test_the_complex_box_keeps_momentum_and_energy_and_flies_a_parabola():
    problem = scenes.free_box("complex")
    scene = problem.by("dop853")
    run = simulate(scene, 10.0, problem.state, record=("base_q", "base_qd"), record_interval=0.1, rtol=1e-12)
    t, q, qd = run["time"], run["base_q"], run["base_qd"]
    parabola = np.outer(t, [-2.0, 2.0, 8.0]) + np.outer(0.5 * t * t, [0.0, 0.0, -9.8])
    assert np.abs(q[:, :3] - parabola).max() < 1e-9
    xx, _, _, yy, _, zz = problem.model.links[0].inertia
    w, x, y, z = q[:, 3:7].T
    spin = np.array([xx, yy, zz]) * qd[:, 3:]
    first = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], axis=1)
    along_x = (first * spin).sum(axis=1)  # the angular momentum along the world's x axis
    assert np.abs(along_x - along_x[0]).max() < 1e-9 * np.linalg.norm(spin[0])
    turning = 0.5 * (qd[:, 3:] * spin).sum(axis=1)
    assert turning == pytest.approx(turning[0], rel=1e-9)
    assert np.ptp(qd[:, 4]) > 9.0  # it tips over: the middle axis is unstable
    assert np.isfinite(energy(problem.model, q, qd)).all()


def test_the_pendulum_follows_the_elliptic_functions():
    """The bob's inertia, which the closed form has too, is 1e-9 of that of the pendulum; 30 rad of phase in ten s."""
    (error,) = errors(scenes.pendulum(), "dop853", [1e-13])
    assert error < 2e-11


@pytest.mark.long
def test_parallelograms_turn_like_one_pendulum_through_their_singular_postures():
    """In 10 s they pass the horizontal, where each window could fold for itself, ten times."""
    problem = linkages.parallelograms(2)
    rk4 = errors(problem, "rk4", [2e-3, 1e-3])
    assert rk4[0] / rk4[1] > 12.0  # order 4
    assert rk4[1] < 1e-10
    assert errors(problem, "extrapolation", [1e-9])[0] < 1e-8
    assert errors(linkages.parallelograms(8, 2.0), "rk4", [1e-3])[0] < 1e-9


@pytest.mark.long
def test_the_squeezer_ends_where_it_is_published_to():
    problem = linkages.squeezer()
    assert np.abs(loop_gaps(problem.model, problem.coordinates[0])).max() < 1e-15
    for integrator, setting in (("dop853", 1e-10), ("rk4", 1e-5)):
        assert errors(problem, integrator, [setting])[0] < 2e-9


@pytest.mark.long
def test_bricards_mechanism_follows_the_equation_of_its_one_freedom():
    """Alternate hinges have the angles x and y with cos x + cos y + cos x cos y = 0; energies by complex steps."""
    problem = linkages.bricard()
    bars = [link for link in problem.model.links if link.mass]
    axes = [np.array(joint.axis) for joint in problem.model.joints]
    along = [2.0 * np.array(link.center_of_mass) for link in bars]

    def angles(x):
        """All hinges by the first, counted from a right angle."""
        cosine = np.cos(0.5 * np.pi - x)
        y = np.arcsin(-cosine / (1.0 + cosine))
        return np.array([x, y, x, y, x])

    def motion(x):
        """Centers and rotations of the bars, at complex x too."""
        turn, end, found = np.eye(3, dtype=complex), np.zeros(3, complex), []
        for q, axis, bar in zip(angles(x), axes, along):
            cross = np.cross(np.eye(3), axis)
            turn = turn @ (np.eye(3) + np.sin(q) * cross + (1.0 - np.cos(q)) * cross @ cross)
            found.append((end + turn @ (0.5 * bar), turn))
            end = end + turn @ bar
        return found

    def inertia(x):
        total, tiny = 0.0, 1e-30
        for (center, turn), bar in zip(motion(x + 1j * tiny), bars):
            v, spin = center.imag / tiny, turn.real.T @ (turn.imag / tiny)
            w = np.array([spin[2, 1], spin[0, 2], spin[1, 0]])
            total += v @ v + w @ (np.array([bar.inertia[k] for k in (0, 3, 5)]) * w)
        return total

    def rates(t, state):
        x, v = state
        h = 1e-3
        slope = sum(k * (inertia(x + n * h) - inertia(x - n * h)) for n, k in ((1, 45), (2, -9), (3, 1))) / (60 * h)
        force = sum(9.81 * center.imag[1] / 1e-30 for center, _ in motion(x + 1e-30j))
        return [v, -(0.5 * slope * v * v + force) / inertia(x)]

    scene = problem.by("dop853")
    run = simulate(scene, 4.0, problem.state, record=("q",), record_interval=0.1, rtol=1e-11)
    sign = np.sign(run["q"][3, 0])
    exact = solve_ivp(rates, (0.0, 4.0), [0.0, 0.0], "DOP853", rtol=1e-11, atol=1e-11, t_eval=run["time"])
    assert np.ptp(exact.y[0]) > 3.0
    np.testing.assert_allclose(run["q"][:, 0] * sign, exact.y[0] * np.sign(exact.y[0, 3]), rtol=0, atol=1e-9)


@pytest.mark.long
def test_the_governor_rises_as_far_as_energy_and_momentum_let_it():
    """Of the same mechanism with rigid lower rods, whose one coordinate is the rods' angle; a spring of 8e5 N/m gives
    way by some 0.1 mm under 100 N, and its damper takes 1e-6 of the energy."""
    problem = scenes.governor()
    scene = problem.by("dop853")
    run = simulate(scene, 1.0, problem.state, record=("q",), record_interval=1e-3, rtol=1e-10)

    def height(angle):
        """Of slider and balls below the top, the lower rods as long as half a rod."""
        return -math.sin(angle)

    def inertia(angle):
        """About the vertical: shaft, slider, rods and balls."""
        r = math.cos(angle)
        rods = 2.0 * (0.3 * (0.05**2 + 0.05 * r + r * r / 3.0) + 0.3 * 1e-4 / 12.0 * (1.0 + math.sin(angle) ** 2))
        return 0.3 * 2e-4 / 12.0 + 3.0 * 0.01 / 6.0 + rods + 2.0 * 5.0 * (0.05 + r) ** 2

    spin = inertia(math.radians(30.0)) * 2.0 * math.pi

    def least_energy(angle):
        weight = 3.0 + 2.0 * (5.0 + 0.15)  # the rods' own weight lies half way down
        return 9.81 * weight * height(angle) + 0.5 * spin**2 / inertia(angle)

    start = least_energy(math.radians(30.0))
    top = brentq(lambda angle: least_energy(angle) - start, math.radians(25.0), 0.0)
    assert run["q"][:, 1].max() == pytest.approx(height(top) + 0.5, abs=2e-4)


@pytest.mark.long
@pytest.mark.parametrize(("integrator", "order"), [("midpoint", 2), ("implicit_euler", 1)])
def test_the_error_of_the_governor_falls_with_the_step(integrator, order):
    """Also far beyond the springs' limit of explicit steps, 0.25 ms; near it the order is lower for a while."""
    steps = {1: [1e-4, 5e-5], 2: [2e-3, 1e-3]}[order]
    coarse, fine = errors(scenes.governor(), integrator, steps)
    assert coarse / fine == pytest.approx(2.0**order, rel=0.02)


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["implicit_euler", "midpoint"])
def test_the_error_of_the_stiff_arm_falls_with_the_step(integrator):
    """Order 1 and 2; an explicit step of 1 ms is wrong by far."""
    order = {"implicit_euler": 1, "midpoint": 2}[integrator]
    problem = scenes.stiff_arm("standard")
    coarse, fine = errors(problem, integrator, [1e-3, 5e-4])
    assert coarse / fine == pytest.approx(2.0**order, rel=0.1)
    assert coarse < 1e-4
    if integrator == "implicit_euler":
        assert errors(problem, "rk4", [1e-3])[0] > 1e-2


@pytest.mark.long
def test_the_reference_is_closer_to_another_solver_than_the_errors_counted_from_it():
    for problem in (scenes.stiff_arm("rotor"), scenes.free_arm(), scenes.governor()):
        assert case.solution(problem)[1] < 1e-9


def test_deviation_does_not_mind_the_sign_of_a_quaternion():
    model = scenes.free_box("simple").model
    a = np.array([[1.0, 2.0, 3.0, math.cos(0.1), 0.0, math.sin(0.1), 0.0]])
    b = np.array([[1.0, 2.0, 3.5, -math.cos(0.2), 0.0, -math.sin(0.2), 0.0]])
    assert case.deviation(model, a, b) == pytest.approx((0.2, 0.5))
    assert case.deviation(model, a, a * [1, 1, 1, -1, -1, -1, -1]) == (0.0, 0.0)


@pytest.mark.long
def test_rows_survive_a_file_and_are_drawn(tmp_path):
    rows = precision.measure(scenes.free_box("simple"), 1, [("midpoint", 1e-2), ("dop853", 1e-6), ("dop853", 1e-9)])
    precision.write(tmp_path / "precision.csv", rows, "processor\nversions")
    again = precision.read(tmp_path / "precision.csv")
    assert [repr(row) for row in again] == [repr(row) for row in rows]
    precision.plot(tmp_path / "precision.png", again)
    assert (tmp_path / "precision.png").stat().st_size > 1000
