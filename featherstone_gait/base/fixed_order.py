"""Sums, products and small linear systems, stacked, in a fixed order of operations.

BLAS and LAPACK choose their code by the processor (fused multiply-add, width of vectors), and the last bits differ.
What is computed here ends up in kernels, which have the same bits everywhere; so it consists of elementwise + - * /
alone, which IEEE 754 rounds in one way.
"""

from __future__ import annotations

from functools import reduce

import numpy as np
from numpy.typing import ArrayLike


def total(x: np.ndarray, axis: int = -1) -> np.ndarray:
    """Sum along an axis that is not empty, from first to last."""
    axis %= x.ndim  # np.moveaxis takes ten times as long
    return reduce(np.add, x.transpose(axis, *range(axis), *range(axis + 1, x.ndim)))


def applied(A: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Multiply matrices (..., m, k) by vectors (..., k)."""
    return total(A * x[..., None, :])


def product(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """Multiply matrices (..., m, k) by matrices (..., k, n)."""
    found = A[..., :, 0, None] * B[..., None, 0, :]
    for k in range(1, B.shape[-2]):
        found += A[..., :, k, None] * B[..., None, k, :]
    return found


def solve(A: ArrayLike, B: ArrayLike) -> np.ndarray:
    """Solve A X = B for X (..., m, n), A (..., m, m) symmetric positive definite.

    Gaussian elimination without pivoting.
    """
    A, X = np.array(A, dtype=float), np.array(B, dtype=float)
    m = A.shape[-1]
    for k in range(m):
        below = A[..., k + 1 :, k, None] / A[..., k, None, k, None]
        A[..., k + 1 :, k + 1 :] -= below * A[..., k, None, k + 1 :]
        X[..., k + 1 :, :] -= below * X[..., k, None, :]
    for k in reversed(range(m)):
        X[..., k, :] /= A[..., k, k, None]
        X[..., :k, :] -= A[..., :k, k, None] * X[..., k, None, :]
    return X
