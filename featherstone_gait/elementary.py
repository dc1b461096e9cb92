"""Sine and cosine with the bits that the kernels' have: what these read must not come from a libm, which differs."""

from __future__ import annotations

from typing import Any

import numpy as np

from .core.compile import elementary

# With the JIT on a kernel cannot be called from Python, but its source can: on arrays it is NumPy, number by number.
_sincos = getattr(elementary.sincos, "py_func", elementary.sincos)


def sincos(x: float | np.ndarray) -> tuple[Any, Any]:
    """Sine and cosine of an angle or of angles of any shape [rad]; NaN beyond SINCOS_LIMIT, some 1.7e9 rad."""
    if np.ndim(x) == 0:
        return _sincos(float(x))
    sine, cosine = _sincos(np.asarray(x, dtype=float))
    return np.asarray(sine), np.asarray(cosine)
