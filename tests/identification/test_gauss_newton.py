"""The search of servo fits: what it minimizes, where it ends, what its Jacobian costs."""

import numpy as np
import pytest
from scipy.optimize import minimize

from featherstone_gait.identification.estimate import covariances, information
from featherstone_gait.identification.gauss_newton import DAMPING, advance, within

PRIOR = np.zeros(2), 0.3
FAR = np.full(2, -10.0), np.full(2, 10.0)


def valley(x):
    """Rosenbrock's valley, with errors that no point makes zero."""
    return np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0], 0.5 + 0.1 * x[0], 0.3 - 0.2 * x[1]])


def slopes(x):
    return np.array([[-20.0 * x[0], 10.0], [-1.0, 0.0], [0.1, 0.0], [0.0, -0.2]])


def searched(x, bounds=FAR, errors=valley):
    damping, rounds, done = DAMPING, 0, False
    while not done:
        x, damping, done = advance(errors, slopes, PRIOR, bounds, x, damping)
        rounds += 1
    return x, rounds


def merit(x):
    return np.log(np.sum(valley(x) ** 2)) + PRIOR[1] ** 2 * np.sum((x - PRIOR[0]) ** 2)


@pytest.mark.parametrize("bounds", [FAR, (np.array([-2.0, -2.0]), np.array([0.6, 2.0]))])
def test_it_finds_what_a_general_minimizer_finds(bounds):
    x, _ = searched(np.array([-1.2, 1.0]), bounds)
    other = minimize(merit, [-0.5, 0.5], bounds=np.transpose(bounds), method="L-BFGS-B", options={"ftol": 1e-14})
    assert merit(x) < other.fun + 2e-4
    assert np.abs(x - other.x).max() < 0.05
    assert (bounds[0] <= x).all()
    assert (x <= bounds[1]).all()


def test_secants_save_jacobians():
    """A round makes up to four steps from one Jacobian: the valley takes fewer rounds than steps."""
    steps = []
    _, rounds = searched(np.array([-1.2, 1.0]), errors=lambda x: (steps.append(1), valley(x))[1])
    assert rounds < 0.4 * len(steps)


def test_an_infinite_error_is_no_step():
    wall = lambda x: np.where(x[0] > 0.2, 1e6, valley(x))  # noqa: E731
    x, _ = searched(np.array([-1.2, 1.0]), errors=wall)
    assert x[0] <= 0.2


def test_a_step_within_bounds_is_the_best_there():
    """The minimum of a quadratic function in a box: its gradient vanishes, or points outwards at a bound."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        A, g = rng.normal(size=(6, 4)), rng.normal(size=4)
        H, low, high = A.T @ A, np.full(4, -0.3), np.full(4, 0.3)
        y = within(H, g, np.zeros(4), (low, high))
        slope = g + H @ y
        assert np.abs(slope[(y > low) & (y < high)]).max(initial=0.0) < 1e-9
        assert (slope[y == low] >= 0.0).all()
        assert (slope[y == high] <= 0.0).all()


def test_information_is_the_inverse_of_the_covariance():
    rng = np.random.default_rng(1)
    J, e = rng.normal(size=(400, 3)), np.cumsum(rng.normal(size=400))
    found, independent = information(J, e, [250, 150])
    _, robust, same = covariances(J, e, [250, 150])
    assert np.allclose(found @ robust, np.eye(3), atol=1e-9)
    assert independent == same < 200.0  # of 400 that wander


def test_what_errors_say_nothing_about_has_no_information():
    """Columns of zeros, and two that are the same: the prior alone separates these, the others are known as before."""
    rng = np.random.default_rng(2)
    J, e = rng.normal(size=(300, 2)), rng.normal(size=300)
    alone = np.linalg.inv(information(J, e, [300])[0] + np.eye(2))
    both = np.linalg.inv(information(np.hstack([J, J[:, 1:], 0.0 * J]), e, [300])[0] + np.eye(5))
    assert np.allclose(np.diag(both)[3:], 1.0)
    assert abs(both[0, 0] / alone[0, 0] - 1.0) < 0.02
    assert 0.5 < both[1, 1] < 0.51  # of the two together 1 / 400
