"""Friction of the joints: that of joint and servo together."""

from __future__ import annotations

import numpy as np

from ..core.effects.friction import FRICTION
from ..model import Model
from .actuator import Drive
from .records import fill, records


def build_friction(model: Model, drive: Drive, own_drive: bool = False) -> np.recarray | None:
    """FRICTION of each joint, None if there is none; own_drive: viscous friction of servos is not ours."""
    table = records(len(model.moving_joints), FRICTION)
    for row, joint, servo in zip(table, model.moving_joints, drive.servos):
        if servo is not None:
            fill(row, servo)
            if own_drive:
                row.viscous_friction = 0.0
        row.viscous_friction = joint.damping + row.viscous_friction
        row.coulomb_friction = joint.friction + row.coulomb_friction
    return table if any(table[name].any() for name in FRICTION.names) else None


def sticks(friction: np.recarray | None) -> bool:
    """Whether a joint has Coulomb friction, whose steep part about zero speed is a strong damper."""
    return friction is not None and bool(friction.coulomb_friction.any())
