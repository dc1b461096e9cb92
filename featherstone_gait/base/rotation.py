"""Rotation matrices; they map vectors from a rotated frame to its reference frame.

The results end up in the numbers that kernels read and must have the same bits on any processor: no BLAS, whose order
of summation depends on the processor, and no libm.
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
    """Compute the rotation (3, 3), child to parent, of roll, pitch and yaw [rad] about fixed axes: Rz Ry Rx (URDF)."""
    (sr, cr), (sp, cp), (sy, cy) = (sincos(angle) for angle in rpy)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def rotation_about(axis: Iterable[float], angle: float | np.ndarray) -> np.ndarray:
    """Compute rotations (..., 3, 3) by angles (...) [rad] about a unit axis (3,) by Rodrigues' formula."""
    x, y, z = axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    s, c = (np.asarray(part)[..., None, None] for part in sincos(angle))
    return np.eye(3) + s * K + (1.0 - c) * product(K, K)


def rotation_z_to(axis: ArrayLike) -> np.ndarray:
    """Compute a rotation (3, 3) that maps z to a unit axis (3,); entries are exactly 0 and 1 for coordinate axes."""
    z = np.array(axis)
    x = cross(np.eye(3)[np.argmin(np.abs(z))], z)
    x /= math.sqrt(dot(x, x))
    return np.column_stack([x, cross(z, x), z])


def dot(a: Vector, b: Vector) -> float:
    """Multiply two vectors (3,) as scalars, summed in order."""
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def cross(a: Vector, b: Vector) -> np.ndarray:
    """Compute the vector product (3,) of two vectors (3,); np.cross takes ten times as long."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def rotation_from_quaternion(quaternion: Vector) -> np.ndarray:
    """Compute the rotation (3, 3), rotated frame to reference frame, of a unit quaternion w x y z."""
    w, x, y, z = quaternion
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def rpy_from_rotation(R: np.ndarray) -> tuple[float, float, float]:
    """Compute fixed-axis roll, pitch and yaw [rad] of a rotation (3, 3), pitch within a quarter turn.

    Yaw comes first, and the others follow from what is left when it is undone.  So their rotation is R to rounding even
    where pitch is a quarter turn and the split between roll and yaw is lost.
    """
    yaw = math.atan2(R[1, 0], R[0, 0])
    s, c = sincos(yaw)
    pitch = math.atan2(-R[2, 0], c * R[0, 0] + s * R[1, 0])
    roll = math.atan2(s * R[0, 2] - c * R[1, 2], c * R[1, 1] - s * R[0, 1])
    return roll + 0.0, pitch + 0.0, yaw + 0.0  # no -0.0
