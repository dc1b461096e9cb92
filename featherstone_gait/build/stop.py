"""Stops at the limits of the joints."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ..core.effects.stop import STOP
from ..model import Joint, Model, Servo
from .actuator import Drive, stall_torque
from .records import records

STOP_DEPTH = 0.01  # [rad or m] that the strongest torque at a joint drives it into its stop


def build_stops(model: Model, drive: Drive, inertias: Sequence[float]) -> np.recarray | None:
    """STOP of each joint, None if no joint has limits; inertias: that the joints feel [kg m^2 or kg]."""
    joints = model.moving_joints
    if not any(math.isfinite(j.lower) or math.isfinite(j.upper) for j in joints):
        return None
    table = records(len(joints), STOP)
    for row, joint, servo, inertia in zip(table, joints, drive.servos, inertias):
        row.lower, row.upper = max(joint.lower, -1e300), min(joint.upper, 1e300)
        row.stiffness = max(_strongest(model, joint, servo), 1e-6) / STOP_DEPTH
        row.damping = 2.0 * math.sqrt(row.stiffness * inertia)
    return table


def _strongest(model: Model, joint: Joint, servo: Servo | None) -> float:
    """The strongest torque at a joint [N m or N]: of its servo, by its file, or of the robot's weight at 0.1 m."""
    if servo is not None:
        return stall_torque(servo)
    return joint.effort if joint.effort < 1e3 else model.mass * 9.81 * 0.1


def stop_periods(stops: np.recarray, inertias: ArrayLike) -> np.ndarray:
    """Period of each joint on its stop [s]."""
    return 2.0 * math.pi * np.sqrt(np.array(inertias) / stops.stiffness)
