"""Sums, products and small linear systems, stacked, in a fixed order of operations.

BLAS and LAPACK choose their code by the processor, with fused multiply-add or without and in vectors of this or that
width, and the last bits follow.  What is planned here ends up in kernels, which have the same bits everywhere; so it
is made of elementwise + - * / alone, which IEEE 754 rounds in one way.
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
    """Matrices (..., m, k) times vectors (..., k)."""
    return total(A * x[..., None, :])


def product(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """Matrices (..., m, k) times matrices (..., k, n)."""
    return total(A[..., :, :, None] * B[..., None, :, :], axis=-2)


def solve(A: ArrayLike, B: ArrayLike) -> np.ndarray:
    """X (..., m, n) with A X = B for symmetric positive definite A (..., m, m): Gaussian elimination, no pivoting."""
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
