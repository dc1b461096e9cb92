"""Preview control with the ZMP's speed as its input: gains, optimality, what an unforeseen ZMP does."""

import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_are

from featherstone_gait.walking.auxiliary_zmp import auxiliary_zmp_controller, plan_com_auxiliary
from featherstone_gait.walking.preview_control import plan_com

SMALL = dict(T=0.01, z_c=0.21, N=120, R=1e-5)  # a robot of 0.4 m
LARGE = dict(T=0.005, z_c=0.814, N=320, R=1e-6)


@pytest.mark.parametrize("parameters", [SMALL, LARGE, {**SMALL, "g": 1.62}])
def test_the_pendulum_over_a_sample_is_that_of_its_differential_equation(parameters):
    controller = auxiliary_zmp_controller(**parameters)
    w2 = parameters.get("g", 9.81) / parameters["z_c"]
    rates = np.array([[0, 0, 0, 1], [0, 0, 1, 0], [-w2, w2, 0, 0], [0, 0, 0, 0]])  # of ZMP, position, velocity, input
    exact = expm(rates * parameters["T"])
    assert np.column_stack([controller.A, controller.b]) == pytest.approx(exact[:3], abs=1e-15)


@pytest.mark.parametrize("parameters", [SMALL, LARGE, {**SMALL, "R": 1e-9}, {**SMALL, "R": 1e-2, "g": 1.62}])
def test_gains_solve_the_riccati_equation_and_hold_the_center_of_mass(parameters, monkeypatch):
    monkeypatch.setattr("featherstone_gait.walking.preview_control.GAIN_DIGITS", 15)
    c = auxiliary_zmp_controller(**parameters)
    R = parameters["R"]
    P = solve_discrete_are(c.A, c.b[:, None], np.diag([1.0, 0.0, 0.0]), [[R]])
    assert c.state_gain == pytest.approx(c.b @ P @ c.A / (R + c.b @ P @ c.b), rel=1e-7)
    assert np.abs(np.linalg.eigvals(c.A - np.outer(c.b, c.state_gain))).max() < 1.0


def test_the_controller_attains_the_least_cost_that_any_input_can():
    """Of those that end at rest over the reference, found as one linear least squares over all inputs."""
    T, z_c, R, n = 0.01, 0.21, 1e-5, 300
    ref = np.where(np.arange(n) < 150, 0.0, 0.1)
    plan = plan_com_auxiliary(ref, T, z_c, N=200, R=R)
    cost = ((plan.zmp - ref) ** 2).sum() + R * ((np.diff(plan.zmp) / T) ** 2).sum()
    c = auxiliary_zmp_controller(T, z_c, N=200, R=R)
    reach = np.array([np.linalg.matrix_power(c.A, k) @ c.b for k in range(n - 1)])
    zmp = np.array([[T if j < i else 0.0 for j in range(n - 1)] for i in range(n)])
    end = reach[::-1][:, 1:].T  # position and velocity after the last input
    stacked = np.vstack([zmp, np.sqrt(R) * np.eye(n - 1), 1e3 * end / np.abs(end).max()])
    target = np.concatenate([ref, np.zeros(n - 1), 1e3 * np.array([0.1, 0.0]) / np.abs(end).max()])
    u = np.linalg.lstsq(stacked, target, rcond=None)[0]
    least = ((zmp @ u - ref) ** 2).sum() + R * (u**2).sum()
    assert cost == pytest.approx(least, rel=1e-4)


def test_the_motion_begins_and_ends_at_rest_over_the_reference_wherever_that_is():
    ref = np.where(np.arange(600) < 200, 0.0, 0.3)
    plan, far = (plan_com_auxiliary(ref + x, 0.01, 0.21, N=60, R=1e-5) for x in (0.0, 7.0))
    assert far.position - 7.0 == pytest.approx(plan.position, abs=1e-9)
    assert plan.position[[0, -1]] == pytest.approx([0.0, 0.3], abs=1e-9)
    assert plan.velocity[[0, -1]] == pytest.approx([0.0, 0.0], abs=1e-9)
    assert plan.acceleration == pytest.approx(9.81 / 0.21 * (plan.position - plan.zmp), abs=1e-12)


def test_a_zmp_that_nobody_foresaw_pushes_the_center_of_mass_away_and_back():
    """The mean of the ZMP is that of the center of mass, as all that is pushed comes to rest again."""
    pushed = np.zeros(500)
    pushed[100:110] = 0.01
    plan = plan_com_auxiliary(np.zeros(500), 0.01, 0.21, R=1e-5, auxiliary=pushed)
    assert np.abs(plan.position[:101]).max() < 1e-15
    assert np.abs(plan.position).max() > 5e-4
    assert np.abs(plan.position[-1]) < 1e-9
    corrected = plan.zmp - pushed
    assert corrected.min() < -1e-3  # first to the other side of the push: under the center of mass that flees from it
    assert plan.zmp.sum() == pytest.approx(plan.position.sum(), rel=0.01)


def test_the_zmp_follows_steps_more_closely_than_that_of_a_smooth_jerk():
    ref = np.where(np.arange(400) % 100 < 50, -0.04, 0.04)
    error = [np.abs(plan(ref, 0.01, 0.21).zmp - ref).mean() for plan in (plan_com_auxiliary, plan_com)]
    assert error[0] < 0.2 * error[1]


def test_what_makes_no_controller_is_refused():
    with pytest.raises(ValueError, match=r"R = 0\.0 must be finite and > 0"):
        auxiliary_zmp_controller(0.01, 0.2, N=10, R=0.0)
    with pytest.raises(ValueError, match="zmp_ref must be"):
        plan_com_auxiliary([[[0.0]]], 0.01, 0.2)
    with pytest.raises(ValueError, match="auxiliary"):
        plan_com_auxiliary(np.zeros(5), 0.01, 0.2, auxiliary=np.nan)
