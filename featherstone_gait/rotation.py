"""Rotation matrices, which take vectors from the turned frame to the one that it is turned in.

What is made here ends in the numbers that kernels read, and must have the same bits on any processor: no BLAS, whose
order of summation depends on the processor, and no libm.
"""

from __future__ import annotations

import math

import numpy as np

from .core.compile.elementary import sincos

_sincos = getattr(sincos, "py_func", sincos)  # not compiled, with the bits of the compiled one


def sine_cosine(angle):
    """Sine and cosine of an angle or an array of them [rad], as the kernels have them; NaN beyond SINCOS_LIMIT."""
    if np.ndim(angle) == 0:
        return _sincos(float(angle))
    sine, cosine = _sincos(np.asarray(angle, dtype=float))
    return np.asarray(sine), np.asarray(cosine)


def rotation_from_rpy(rpy) -> np.ndarray:
    """Rotation (3, 3), child to parent, of roll, pitch and yaw [rad] about fixed axes: Rz Ry Rx (URDF)."""
    (sr, cr), (sp, cp), (sy, cy) = (sine_cosine(angle) for angle in rpy)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def rotation_about(axis, angle) -> np.ndarray:
    """Rotations (..., 3, 3) by an angle or an array (...) of them [rad] about a unit axis (3,): Rodrigues' formula."""
    x, y, z = axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    s, c = (np.asarray(part)[..., None, None] for part in sine_cosine(angle))
    return np.eye(3) + s * K + (1.0 - c) * product(K, K)


def rotation_z_to(axis) -> np.ndarray:
    """A rotation (3, 3) that takes z to a unit axis (3,); entries are exactly 0 and 1 for coordinate axes."""
    z = np.array(axis)
    x = cross(np.eye(3)[np.argmin(np.abs(z))], z)
    x /= math.sqrt(dot(x, x))
    return np.column_stack([x, cross(z, x), z])


def product(A, B) -> np.ndarray:
    """A B of matrices (..., 3, 3), summed in order."""
    first, second, third = (A[..., k, None] * B[..., None, k, :] for k in range(3))
    return first + second + third


def rotate(E, a) -> np.ndarray:
    """E a of matrices (..., 3, 3) and vectors (..., 3), summed in order."""
    first, second, third = (E[..., k] * a[..., k, None] for k in range(3))
    return first + second + third


def dot(a, b) -> float:
    """Scalar product of two vectors (3,), summed in order."""
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def cross(a, b) -> np.ndarray:
    """Vector product (3,) of two vectors (3,); np.cross takes ten times as long."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
