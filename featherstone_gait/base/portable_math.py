"""Elementary functions with the bits of the kernels; a libm would differ between systems."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..core.compile import elementary

# With the JIT on a kernel cannot be called from Python, but its source can: on arrays it is NumPy, number by number.
_sincos, _angle, _exp, _log = (
    getattr(f, "py_func", f) for f in (elementary._sincos, elementary._angle, elementary._exp, elementary._log)
)


def sincos(x: float | np.ndarray) -> tuple[Any, Any]:
    """Compute sine and cosine of an angle or of angles of any shape [rad]; NaN beyond SINCOS_LIMIT, some 1.7e9 rad."""
    if np.ndim(x) == 0:
        return _sincos(float(x))
    sine, cosine = _sincos(np.asarray(x, dtype=float))
    return np.asarray(sine), np.asarray(cosine)


def angle(y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Compute the angles of directions (x, y) to that of x [rad], from -pi to pi, 0 of no direction."""
    return np.asarray(_angle(np.asarray(y, dtype=float), np.asarray(x, dtype=float)))


def exp(x: np.ndarray) -> np.ndarray:
    """Compute the exponential of an array."""
    return np.asarray(_exp(x))


def log(x: np.ndarray) -> np.ndarray:
    """Compute the natural logarithm of an array of normal numbers > 0."""
    return np.asarray(_log(np.asarray(x, dtype=float)))


def power(x: float, exponent: float) -> float:
    """Compute x ** exponent of x >= 0; 0 and 1 keep their values."""
    return x if x in (0.0, 1.0) else float(_exp(exponent * float(_log(float(x)))))
