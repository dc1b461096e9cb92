"""Stops at the limits of the joints.

The strongest torque at a joint drives it `STOP_DEPTH` into its stop: that is the stiffness K.  Where it is not known,
the robot's weight sinks in by 1 mm: at a lever of 0.1 m, or on a joint that slides.  The damping of Hunt and Crossley
grows with the depth, K d x; at a tenth of that depth, `CRITICAL_DEPTH`, it is critical,

    K d x = 2 sqrt(K J)    at x = CRITICAL_DEPTH,

J the inertia that the joint feels in the zero posture with all others free, 1 / (M^-1)_ii.  With servos "rotor" that
includes the rotor's reflected inertia; with "standard", which has no rotor, and with "mipsd", whose rotor turns behind
the gear's spring, it is that of the links alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..base.records import records
from ..core.effects.stop import STOP, STOP_DEPTH
from ..model import Joint, Model
from .actuator import Drive, stall_torque

LEVER = 0.1  # [m]; of the robot's weight on a joint whose strongest torque is not known
NO_LIMIT = 1e300  # [rad or m]
CRITICAL_DEPTH = 0.001  # [rad or m] at which a stop is critically damped


def build_stops(model: Model, drive: Drive, inertias: Sequence[float], g: float) -> np.recarray | None:
    """Build the STOP records, None if no joint has limits.

    inertias: those that the joints feel [kg m^2 or kg]; g: strength of gravity [m/s^2].
    """
    joints = model.moving_joints
    if not any(math.isfinite(j.lower) or math.isfinite(j.upper) for j in joints):
        return None
    table = records(len(joints), STOP)
    for row, joint, servo, inertia in zip(table, joints, drive.servos, inertias):
        row.lower, row.upper = max(joint.lower, -NO_LIMIT), min(joint.upper, NO_LIMIT)
        torque = stall_torque(servo) if servo else math.inf
        fill_stop(row, load_of(joint, model, g) if torque == math.inf else torque, inertia)
    return table


def load_of(joint: Joint | None, model: Model, g: float) -> float:
    """Return what drives a joint into its stop [N m or N]; None: what slides.

    That is the effort of the file, else such that the robot's weight at LEVER, or on a slider, sinks in by
    LEVER * STOP_DEPTH; without gravity the weight on Earth.
    """
    lever = 1.0 / LEVER if joint is None or joint.type == "prismatic" else LEVER
    known = joint is not None and joint.effort < 1e3
    return joint.effort if joint is not None and known else model.mass * (g or 9.81) * lever


def fill_stop(row: Any, torque: float, inertia: float, ratio: float = 1.0) -> None:
    """Set the stiffness under the strongest torque [N m or N] of a joint, and the damping.

    ratio: of the length that has the stop, by the joint's position.
    """
    row.stiffness = max(torque, 1e-6) / (STOP_DEPTH * ratio * ratio)
    row.damping = 2.0 * math.sqrt(inertia / row.stiffness) / (CRITICAL_DEPTH * ratio)
