"""Covariances of fitted parameters, residuals correlated over time; identification.py tells the method."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np


def covariances(J: np.ndarray, e: np.ndarray, lengths: Sequence[int]) -> tuple[np.ndarray, np.ndarray, float]:
    """Covariance with independent and with autocorrelated residuals, and the number of independent samples."""
    # A parameter without effect has no finite variance: a tiny eigenvalue makes it huge instead of failing.
    scale = np.linalg.norm(J, axis=0)
    scale[scale == 0.0] = 1.0
    Z = J / scale
    bread = np.linalg.pinv(Z.T @ Z + 1e-14 * np.eye(J.shape[1]), hermitian=True)
    degrees = max(len(e) - J.shape[1], 1)
    signals = np.split(e, np.cumsum(lengths)[:-1])
    scores = np.split(Z * e[:, None], np.cumsum(lengths)[:-1])
    bandwidth = _bandwidth([_autocorrelation([s[:, k] for s in scores], 1) for k in range(J.shape[1])], lengths)
    meat, sum_of_rho = sum(s.T @ s for s in scores), 0.0
    for lag in range(1, bandwidth + 1):
        weight = 1.0 - lag / (bandwidth + 1.0)
        cross = sum(s[lag:].T @ s[:-lag] for s in scores)
        meat = meat + weight * (cross + cross.T)
        sum_of_rho += weight * _autocorrelation(signals, lag)
    independent = len(e) / max(1.0 + 2.0 * sum_of_rho, 1.0)
    outer = np.outer(scale, scale)
    textbook = bread * (e @ e) / degrees / outer
    robust = bread @ meat @ bread * (len(e) / degrees) / outer
    return textbook, robust, independent


def _autocorrelation(signals: Sequence[np.ndarray], lag: int) -> float:
    power = sum(s @ s for s in signals)
    return float(sum(s[lag:] @ s[:-lag] for s in signals) / power) if power > 0 else 0.0


def _bandwidth(correlations: Sequence[float], lengths: Sequence[int]) -> int:
    """Lags to keep: Andrews (1991), equations (6.2) and (6.4), for first-order processes and Bartlett's weights."""
    rho = np.minimum(np.abs(correlations), 0.97)
    alpha = float(np.mean(4.0 * rho**2 / (1.0 - rho**2) ** 2))
    return min(math.ceil(1.1447 * (alpha * sum(lengths)) ** (1.0 / 3.0)), min(lengths) // 4)


def quantile(confidence: float, degrees: float) -> float:
    """Student's, two-sided, of that many degrees of freedom."""
    from scipy.stats import t

    return float(t.ppf(0.5 + 0.5 * confidence, max(degrees, 1.0)))
