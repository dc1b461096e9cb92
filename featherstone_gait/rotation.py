"""Rotation matrices, which take vectors from the turned frame to the one that it is turned in."""

from __future__ import annotations

import math

import numpy as np


def rotation_from_rpy(rpy) -> np.ndarray:
    """Rotation (3, 3), child to parent, of roll, pitch and yaw [rad] about fixed axes: Rz Ry Rx (URDF)."""
    (cr, cp, cy), (sr, sp, sy) = [math.cos(a) for a in rpy], [math.sin(a) for a in rpy]
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def rotation_about(axis, angle: float) -> np.ndarray:
    """Rotation (3, 3) by an angle [rad] about a unit axis (3,): Rodrigues' formula."""
    x, y, z = axis
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * K + (1 - math.cos(angle)) * (K @ K)


def rotation_z_to(axis) -> np.ndarray:
    """A rotation (3, 3) that takes z to a unit axis (3,); entries are exactly 0 and 1 for coordinate axes."""
    z = np.array(axis)
    x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
    x /= math.sqrt(x @ x)
    return np.column_stack([x, np.cross(z, x), z])
