"""Build the friction of joint and servo together."""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np

from ..base.records import fill, filled, records
from ..core.effects.drag import DRAG
from ..core.effects.friction import FRICTION, SOFT, STUCK
from ..core.effects.friction import explicit_limits as limits_of_friction
from ..core.effects.gear_friction import GEAR_FRICTION, GearFriction
from ..core.effects.tendon import Tendons
from ..model import Joint, Model, Servo, depends_on_load_or_speed
from .actuator import Drive, stall_torque

Friction: TypeAlias = np.recarray | GearFriction
FAST = 10.0  # [rad/s or m/s]
LOADS = ("external_load_friction", "motor_load_friction", "stribeck_external_load", "stribeck_motor_load")
BUDGETS = ("coulomb_friction", "stribeck_friction")
QUADRATIC = ("load_product_friction", "quadratic_external_load", "quadratic_motor_load")


def build_friction(model: Model, drive: Drive, own_drive: bool = False, soft: bool = False) -> Friction | None:
    """Build the friction of each joint, None if there is none.

    own_drive: leave out the viscous friction of servos, but not that of a rigid gear's rotor; soft: limit the steepness
    so that explicit steps stay stable.
    """
    table = records(len(model.moving_joints), GEAR_FRICTION)
    table.stribeck_speed = table.stribeck_exponent = 1.0
    for row, joint, servo in zip(table, model.moving_joints, drive.servos):
        if servo is not None:
            fill(row, servo.gearbox, servo)
            if own_drive:
                row.viscous_friction = 0.0
            if drive.kind != "mipsd":  # whose rotor turns by itself
                row.viscous_friction += servo.gearbox.reflected_damping
        row.steepness = 1.0 / max(_width(joint, servo), SOFT if soft else STUCK)
        row.viscous_friction = joint.damping + row.viscous_friction
        row.coulomb_friction = joint.friction + row.coulomb_friction
    if any(servo and depends_on_load_or_speed(servo.gearbox) for servo in drive.servos):
        return GearFriction(table)
    if not (table.viscous_friction.any() or table.coulomb_friction.any()):
        return None
    plain = records(len(table), FRICTION)
    for name in FRICTION.names or ():
        plain[name] = table[name]
    return plain


def build_drag(model: Model) -> np.recarray | None:
    """Build the DRAG records, None if all damping is linear."""
    table = filled(DRAG, [(joint,) for joint in model.moving_joints])
    return table if table.quadratic_damping.any() or table.cubic_damping.any() else None


def fastest_damping(model: Model) -> np.ndarray:
    """Return the nonlinear damping (n,) at the velocity limits of the joints, or at `FAST` [N m s/rad or N s/m]."""
    joints = model.moving_joints
    speed = np.array([joint.velocity if joint.velocity < math.inf else FAST for joint in joints])
    b2, b3 = (np.array([getattr(joint, name) for joint in joints]) for name in DRAG.names or ())
    return speed * (2.0 * np.abs(b2) + 3.0 * b3 * speed)


def _width(joint: Joint, servo: Servo | None) -> float:
    """Return the speed range of dry friction about rest [rad/s or m/s]; dry friction of the joint itself holds it."""
    return 0.0 if servo is None or joint.friction else servo.stick_speed


def widened(friction: Friction | None, model: Model, driven: bool, factor: float) -> Friction | None:
    """Return the friction with wider ranges about rest in joints where explicit steps already widen it.

    driven: whether the model's servos act.  None if there is no such joint, and for user-defined laws.
    """
    if not isinstance(friction, np.ndarray | GearFriction):
        return None
    table = friction.table if isinstance(friction, GearFriction) else friction
    servos = [model.servos.get(joint.name) if driven else None for joint in model.moving_joints]
    own = np.array([_width(joint, servo) for joint, servo in zip(model.moving_joints, servos)])
    dry = sum(table[name] for name in (*BUDGETS, *LOADS, *QUADRATIC) if name in (table.dtype.names or ()))
    soft = (own < SOFT) & (np.asarray(dry) > 0.0)
    if not soft.any():
        return None
    wide = table.copy()
    wide["steepness"][soft] /= factor
    return GearFriction(wide) if isinstance(friction, GearFriction) else wide


def sticks(friction: Friction | None, tendons: Tendons | None = None) -> bool:
    """Return whether anything has dry friction, whose steep part about zero speed acts like a strong damper."""
    if isinstance(friction, GearFriction) or (tendons is not None and tendons.friction is not None):
        return True
    return friction is not None and bool(friction.coulomb_friction.any())


def explicit_limits(friction: Friction | None, drive: Drive) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Return dampers [N m s/rad] and springs [N m/rad] of each joint that limit an explicit step, by name.

    Friction that grows with the load is taken at the stall torque of the servo.
    """
    if friction is None:
        return {}, {}
    if not isinstance(friction, GearFriction):
        return limits_of_friction(friction.viscous_friction, friction.coulomb_friction)
    table = friction.table
    stall = np.array([stall_torque(servo) if servo else 0.0 for servo in drive.servos])
    stall = np.where(np.isfinite(stall), stall, 0.0)
    dry = table.coulomb_friction + table.stribeck_friction
    dry = dry + stall * sum(table[name] for name in LOADS) + stall**2 * sum(table[name] for name in QUADRATIC)
    return limits_of_friction(table.viscous_friction, dry)
