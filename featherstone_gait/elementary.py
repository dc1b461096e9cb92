"""Sine and cosine for arrays, with the bits that the kernels' have: for what they read must not come from a libm."""

from __future__ import annotations

import numpy as np

from .core import elementary

# With the JIT on a kernel cannot be called from Python, but its source can: on arrays it is NumPy, number by number.
_sincos = getattr(elementary.sincos, "py_func", elementary.sincos)


def sincos(x) -> tuple[np.ndarray, np.ndarray]:
    """Sine and cosine of angles of any shape [rad]; NaN beyond `core.elementary.SINCOS_LIMIT`, some 2e5 rad."""
    sine, cosine = _sincos(np.atleast_1d(np.asarray(x, dtype=float)))
    return tuple(np.asarray(a).reshape(np.shape(x)) for a in (sine, cosine))
