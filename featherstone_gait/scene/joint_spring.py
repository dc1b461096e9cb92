"""Build the springs of the joints."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..base.records import filled
from ..core.effects.joint_spring import JOINT_SPRING, STIFFENING
from ..core.integrate.integrator import Integrator
from ..model import Model


def build_joint_springs(model: Model) -> np.recarray | None:
    """Build the JOINT_SPRING records, None if no joint has a spring."""
    table = filled(JOINT_SPRING, [(joint,) for joint in model.moving_joints])
    return table if table.stiffness.any() else None


def build_stiffening(model: Model) -> np.recarray | None:
    """Build the STIFFENING records, None if all springs are linear."""
    table = filled(STIFFENING, [(joint,) for joint in model.moving_joints])
    return table if table.quadratic_stiffness.any() or table.cubic_stiffness.any() else None


def build_ball_springs(model: Model) -> np.ndarray | None:
    """Return the stiffness of ball joints about each of their axes (n,) [N m/rad], None if none has a spring."""
    found = np.zeros(len(model.moving_joints))
    for first, joint in zip(model.balls, model.ball_joints):
        found[first : first + 3] = joint.stiffness
    return found if found.any() else None


def stiffest(model: Model) -> np.ndarray:
    """Return the stiffness (n,) that limits explicit steps [N m/rad or N/m].

    Of a nonlinear spring that is the slope at the farther limit of the joint, or one radian or meter away.
    """
    found, balls = [], build_ball_springs(model)
    for joint in model.moving_joints:
        ways = [abs(end - joint.spring_reference) for end in (joint.lower, joint.upper)]
        x = max(ways) if max(ways) < math.inf else 1.0
        found.append(joint.stiffness + 2.0 * abs(joint.quadratic_stiffness) * x + 3.0 * joint.cubic_stiffness * x * x)
    return np.array(found) + (0.0 if balls is None else balls)


def fold_joint_springs(
    springs: np.recarray | None, integrator: Integrator, h: float, inertias: Sequence[float]
) -> None:
    """Take the springs at the end of the implicit step h [s] only where their periods need it, all or none.

    The largest (h omega)^2 of the robot is at most the sum of those of the joints, h^2 K / inertia, each with the
    inertia [kg m^2 or kg] that its joint feels; at the start of the step springs are stable while it is below 4.
    """
    if springs is not None:
        springs.fold = integrator.folds_spring or h * h * float((springs.stiffness / np.array(inertias)).sum()) > 1.0
