"""Preview control: published gains, optimality, and what the cart-table does with them."""

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are, toeplitz

from featherstone_gait.walking.preview_control import plan_com, preview_controller

KAJITA = dict(T=0.005, z_c=0.814, N=320, Q=1.0, R=1e-6)  # Kajita et al. 2003
SMALL = dict(T=0.01, z_c=0.21, N=120, Q=1.0, R=1e-6)  # a robot of 0.4 m


def closed_loop(controller):
    """The augmented cart-table of Kajita et al. (2003) under its own state feedback."""
    T, h = controller.T, controller.z_c / controller.g
    A = np.array([[1, T, T**2 / 2], [0, 1, T], [0, 0, 1]])
    b = np.array([T**3 / 6, T**2 / 2, T])
    c = np.array([1, 0, -h])
    A4 = np.block([[np.ones((1, 1)), (c @ A)[None]], [np.zeros((3, 1)), A]])
    return A4 - np.outer([c @ b, *b], [controller.integral_gain, *controller.state_gain])


@pytest.mark.parametrize(
    ("parameters", "integral", "state", "second_preview", "moduli"),
    [
        (KAJITA, 618.702, (72719.44, 21549.598, 177.0127), -777.507, (0.6295, 0.6295, 0.98279, 0.98279)),
        (SMALL, 673.790, (21818.44, 3641.676, 72.4454), -770.900, (0.7214, 0.7214, 0.93395, 0.93395)),
    ],
)
def test_gains_are_the_known_ones(parameters, integral, state, second_preview, moduli):
    controller = preview_controller(**parameters)
    assert controller.integral_gain == pytest.approx(integral, rel=1e-6)
    assert controller.state_gain == pytest.approx(state, rel=2e-6)
    assert controller.preview_gain[1] == pytest.approx(second_preview, rel=1e-6)
    assert np.sort(np.abs(np.linalg.eigvals(closed_loop(controller)))) == pytest.approx(moduli, rel=1e-4)


@pytest.mark.parametrize("parameters", [KAJITA, SMALL, {**KAJITA, "R": 1e-10}, {**SMALL, "R": 1e-2, "g": 1.62}])
def test_gains_solve_the_riccati_equation(parameters, monkeypatch):
    monkeypatch.setattr("featherstone_gait.walking.preview_control.GAIN_DIGITS", 15)
    controller = preview_controller(**parameters)
    T, h = controller.T, controller.z_c / controller.g
    b = np.array([T**3 / 6 - h * T, T**3 / 6, T**2 / 2, T])
    gains = np.array([controller.integral_gain, *controller.state_gain])
    A = closed_loop(controller) + np.outer(b, gains)
    P = solve_discrete_are(A, b[:, None], np.diag([parameters["Q"], 0, 0, 0]), [[parameters["R"]]])
    assert gains == pytest.approx(b @ P @ A / (parameters["R"] + b @ P @ b), rel=1e-9)


def test_preview_gain_starts_at_the_integral_gain_and_dies_out():
    controller = preview_controller(**KAJITA)
    preview = controller.preview_gain
    assert preview[0] == pytest.approx(-controller.integral_gain, rel=1e-6)
    assert preview.argmin() == 5
    assert preview[-1] / preview.min() == pytest.approx(4.3e-3, rel=0.02)
    # All of the future together holds the table where its position gain pushes it from.
    endless = preview_controller(**{**KAJITA, "N": 2000}).preview_gain
    assert endless.sum() == pytest.approx(-controller.state_gain[0], rel=1e-6)


def test_the_controller_attains_the_least_cost_that_any_input_can():
    T, z_c, N, Q, R, n = 0.01, 0.21, 200, 1.0, 1e-6, 500
    ref = np.where(np.arange(n) < 250, 0.0, 0.1)
    plan = plan_com(ref, T, z_c, N=N, Q=Q, R=R)
    jerk = np.diff(plan.acceleration) / T
    cost = Q * ((plan.zmp - ref) ** 2).sum() + R * (np.diff(jerk, prepend=0.0) ** 2).sum()
    # The same problem as one linear least squares over all inputs: the ZMP is their convolution with its response.
    k = np.arange(1, n + 1)
    response = T**3 * (3 * k * (k - 1) + 1) / 6 - z_c / 9.81 * T
    A = toeplitz(np.append(0.0, response[: n - 1]), np.zeros(n - 1))
    D = np.eye(n - 1) - np.eye(n - 1, k=-1)
    stacked = np.vstack([np.sqrt(Q) * A, np.sqrt(R) * D])
    target = np.concatenate([np.sqrt(Q) * ref, np.zeros(n - 1)])
    u = np.linalg.lstsq(stacked, target, rcond=None)[0]
    least = ((stacked @ u - target) ** 2).sum()
    assert least <= cost * (1 + 1e-9)
    assert cost == pytest.approx(least, rel=1e-3)


def test_zmp_follows_steps_of_300_mm():
    times = np.arange(0.0, 9.0, KAJITA["T"])
    changes = 1.6 + 0.8 * np.arange(6)
    ref = 0.3 * (times[:, None] >= changes - 1e-9).sum(axis=1)
    error = plan_com(ref, **KAJITA).zmp - ref
    far = np.abs(times[:, None] - changes).min(axis=1) > 0.1
    assert np.abs(error[far]).max() < 2.6e-3
    assert np.sqrt((error**2).mean()) < 11e-3
    assert abs(error[-1]) < 1e-9


def test_on_the_moon_the_zmp_follows_as_well_in_as_much_more_time():
    ref, s = np.where(np.arange(2000) < 800, 0.0, 0.3), np.sqrt(9.81 / 1.62)
    slower = {**KAJITA, "T": KAJITA["T"] * s, "R": KAJITA["R"] * s**6}
    earth, moon = plan_com(ref, **KAJITA), plan_com(ref, **slower, g=1.62)
    assert np.abs(moon.zmp - earth.zmp).max() < 1e-6
    assert np.allclose(moon.zmp, moon.position - 0.814 / 1.62 * moon.acceleration, rtol=0, atol=1e-14)


@pytest.mark.parametrize("parameters", [KAJITA, SMALL])
def test_a_table_over_a_resting_reference_stays_at_rest(parameters):
    plan = plan_com(np.full(1000, 0.1), **parameters)
    assert np.abs(plan.position - 0.1).max() < 1e-12
    assert np.abs(plan.acceleration).max() < 1e-9


def test_motion_is_consistent_and_axes_are_independent():
    ref = np.zeros((600, 2))
    ref[200:, 0], ref[300:, 1] = 0.05, -0.03
    plan = plan_com(ref, 0.01, 0.21)
    alone = plan_com(ref[:, 1], 0.01, 0.21)
    assert np.array_equal(plan.position[:, 1], alone.position)
    assert np.allclose(plan.zmp, plan.position - 0.21 / 9.81 * plan.acceleration, rtol=0, atol=1e-15)
    trapezoid = 0.01 * 0.5 * (plan.acceleration[1:] + plan.acceleration[:-1])
    assert np.allclose(np.diff(plan.velocity, axis=0), trapezoid, rtol=0, atol=1e-12)


def test_gains_carry_seven_digits_which_move_the_zmp_by_less_than_a_millionth_of_the_step(monkeypatch):
    ref = np.where(np.arange(2000) < 800, 0.0, 0.3)
    rounded = plan_com(ref, **KAJITA)
    assert float(f"{preview_controller(**KAJITA).integral_gain:.6e}") == preview_controller(**KAJITA).integral_gain
    monkeypatch.setattr("featherstone_gait.walking.preview_control.GAIN_DIGITS", 15)
    assert np.abs(plan_com(ref, **KAJITA).zmp - rounded.zmp).max() < 1e-6 * 0.3


@pytest.mark.parametrize("wrong", [dict(T=0.0), dict(z_c=-0.2), dict(N=0), dict(R=np.nan), dict(g=np.inf)])
def test_parameters_out_of_range_are_named(wrong):
    with pytest.raises(ValueError, match=f"{next(iter(wrong))} = .* must be finite and > 0"):
        preview_controller(**{**SMALL, **wrong})


@pytest.mark.parametrize("ref", [np.zeros(0), np.zeros((2, 2, 2)), np.array([0.0, np.nan])])
def test_a_reference_that_is_none_is_refused(ref):
    with pytest.raises(ValueError, match="zmp_ref"):
        plan_com(ref, 0.01, 0.21)
