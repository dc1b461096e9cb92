"""Rotation matrices, which take vectors from the turned frame to the one that it is turned in.

What is made here ends in the numbers that kernels read, and must have the same bits on any processor: no BLAS, whose
order of summation depends on the processor, and no libm.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from .fixed_order import product
from .portable_math import sincos

Vector = Sequence[float] | np.ndarray  # (3,)


def rotation_from_rpy(rpy: Iterable[float]) -> np.ndarray:
    """Rotation (3, 3), child to parent, of roll, pitch and yaw [rad] about fixed axes: Rz Ry Rx (URDF)."""
    (sr, cr), (sp, cp), (sy, cy) = (sincos(angle) for angle in rpy)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def rotation_about(axis: Iterable[float], angle: float | np.ndarray) -> np.ndarray:
    """Rotations (..., 3, 3) by an angle or an array (...) of them [rad] about a unit axis (3,): Rodrigues' formula."""
    x, y, z = axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    s, c = (np.asarray(part)[..., None, None] for part in sincos(angle))
    return np.eye(3) + s * K + (1.0 - c) * product(K, K)


def rotation_z_to(axis: ArrayLike) -> np.ndarray:
    """A rotation (3, 3) that takes z to a unit axis (3,); entries are exactly 0 and 1 for coordinate axes."""
    z = np.array(axis)
    x = cross(np.eye(3)[np.argmin(np.abs(z))], z)
    x /= math.sqrt(dot(x, x))
    return np.column_stack([x, cross(z, x), z])


def dot(a: Vector, b: Vector) -> float:
    """Scalar product of two vectors (3,), summed in order."""
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def cross(a: Vector, b: Vector) -> np.ndarray:
    """Vector product (3,) of two vectors (3,); np.cross takes ten times as long."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def rotation_from_quaternion(quaternion: Vector) -> np.ndarray:
    """Rotation (3, 3), turned frame to the one that it is turned in, of a unit quaternion w x y z."""
    w, x, y, z = quaternion
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def rpy_from_rotation(R: np.ndarray) -> tuple[float, float, float]:
    """Fixed-axis roll, pitch and yaw [rad] of a rotation (3, 3), pitch within a quarter turn.

    Yaw first, and the others of what is left when it is undone: so their rotation is R to rounding where pitch is a
    quarter turn too, and the split between roll and yaw is lost.
    """
    yaw = math.atan2(R[1, 0], R[0, 0])
    s, c = sincos(yaw)
    pitch = math.atan2(-R[2, 0], c * R[0, 0] + s * R[1, 0])
    roll = math.atan2(s * R[0, 2] - c * R[1, 2], c * R[1, 1] - s * R[0, 1])
    return roll + 0.0, pitch + 0.0, yaw + 0.0  # no -0.0
