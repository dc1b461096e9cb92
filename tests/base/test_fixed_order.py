"""Sums, products and solutions: right, and of the bits that their order of operations gives."""

import numpy as np
import pytest

from featherstone_gait.base.fixed_order import applied, product, solve, total


def test_a_sum_goes_from_first_to_last():
    x = np.array([[1.0, 2.0**-53, 2.0**-53, -1.0], [2.0**-53, 2.0**-53, 1.0, -1.0]])
    assert total(x).tolist() == [0.0, 2.0**-52]
    assert total(x, axis=0).tolist() == (x[0] + x[1]).tolist()


def test_products_are_those_of_linear_algebra():
    rng = np.random.default_rng(0)
    A, B, x = rng.normal(size=(7, 3, 4)), rng.normal(size=(7, 4, 5)), rng.normal(size=(7, 4))
    np.testing.assert_allclose(product(A, B), A @ B, rtol=0, atol=1e-14)
    np.testing.assert_allclose(applied(A, x), (A @ x[..., None])[..., 0], rtol=0, atol=1e-14)
    assert product(A[0], B[0]).tobytes() == product(A, B)[0].tobytes()


@pytest.mark.parametrize("m", [1, 3, 6])
def test_solutions_are_those_of_linear_algebra(m):
    rng = np.random.default_rng(m)
    J, B = rng.normal(size=(20, m, m + 2)), rng.normal(size=(20, m, 2))
    A = J @ J.swapaxes(1, 2)
    before = A.copy(), B.copy()
    np.testing.assert_allclose(solve(A, B), np.linalg.solve(A, B), rtol=1e-9)
    assert np.array_equal(A, before[0])
    assert np.array_equal(B, before[1])
