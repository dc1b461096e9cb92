"""Gauss-Newton with Levenberg-Marquardt damping, for the logarithm of a sum of squares with a prior.

Minimized is log |e(x)|^2 + |w (x - x0)|^2 within bounds, x in units of the prior's widths: with S the sum of squares
the gradient of its half is J'e / S + w^2 (x - x0), so that the prior weighs as much as 1 / w^2 independent errors,
however well the model fits.  A step solves (J'J / S + (w^2 + damping) I) d = -gradient, and the damping falls where the
model foresees what a step gains and grows where it does not (D. Marquardt, J. SIAM 11 (1963)).

A Jacobian costs as much as many evaluations of the errors.  So after a step it is corrected by what the step has shown
(C. G. Broyden, Math. Comp. 19 (1965)), and measured anew after `SECANTS` such steps, or where one does not help.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy.optimize import lsq_linear

DAMPING = 1e-2  # of the first step
GOOD, FAIR = 0.5, 0.2  # gain over the foreseen one, above which the damping falls, and is kept
LESS, MORE, RETRY = 0.25, 4.0, 8.0  # factors of the damping; the last where a step is no better
TRIALS = 6  # of the damping, with a new Jacobian
SECANTS = 3  # steps with a corrected Jacobian
TINY = 1e-24  # sum of squares of errors that are rounding
LEAST_GAIN = 3e-4  # of a step with a new Jacobian, below which the search ends: 1.5e-4 of the root mean square


def advance(
    errors: Callable[[np.ndarray], np.ndarray],
    slopes: Callable[[np.ndarray], np.ndarray],
    prior: tuple[np.ndarray, float],
    bounds: tuple[np.ndarray, np.ndarray],
    x: np.ndarray,
    damping: float,
) -> tuple[np.ndarray, float, bool]:
    """Make the steps of one Jacobian, at x (n,); return where they end, the next damping, and if the search is done.

    errors (n,) -> (m,) and slopes (n,) -> (m, n) belong to a point; prior: its mean (n,) and its weight w.
    """
    mean, weight = prior

    def merit(e: np.ndarray, x: np.ndarray) -> float:
        return math.log(_squares(e)) + weight**2 * _squares(x - mean)

    e, J, unit = errors(x), slopes(x), np.eye(len(x))
    for k in range(1 + SECANTS):
        S = _squares(e)
        H, g = J.T @ J / S + weight**2 * unit, J.T @ e / S + weight**2 * (x - mean)
        for _ in range(1 if k else TRIALS):
            y = within(H + damping * unit, g, x, bounds)
            d, e_there = y - x, errors(y)
            gain, foreseen = merit(e, x) - merit(e_there, y), -(2.0 * g @ d + d @ H @ d)
            if gain > 0.0:
                break
            damping *= RETRY
        else:
            return x, damping, k == 0
        if gain < FAIR * foreseen:
            damping *= MORE
        elif gain > GOOD * foreseen:
            damping *= LESS
        J = J + np.outer(e_there - e - J @ d, d / (d @ d))
        x, e = y, e_there
        if gain < LEAST_GAIN or gain < FAIR * foreseen:
            return x, damping, k == 0 and gain < LEAST_GAIN
    return x, damping, False


def _squares(v: np.ndarray) -> float:
    return max(float(np.sum(v * v)), TINY)  # v @ v would start threads, which take longer


def within(H: np.ndarray, g: np.ndarray, x: np.ndarray, bounds: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Return x + d for the d that minimizes g'd + d'H d / 2 and keeps x + d within bounds."""
    L = np.linalg.cholesky(H)
    free = -np.linalg.solve(L, g)  # H = L L', so that the least |L'd - free|^2 is wanted
    low, high = bounds
    return np.clip(x + lsq_linear(L.T, free, (low - x, high - x), method="bvls").x, low, high)
