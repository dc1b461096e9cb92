"""Friction and stops of the joints: torques that depend on the joint's own angle and speed, never rising with speed."""

from .jit import inline
from .lanes import select
from .layout import COULOMB, LOWER, STOP_D, STOP_K, UPPER, VISCOUS
from .motor import clamp

# Coulomb friction grows linearly up to this speed: a loaded joint that should stick creeps at a fraction of it.
STICK_SPEED = 1e-3  # [rad/s or m/s]


@inline
def friction_torque(friction, i, speed):
    """Torque on the joint [N m] and its slope -dT/d speed."""
    if friction is None:
        return 0.0, 0.0
    x = clamp(speed * (1.0 / STICK_SPEED), -1.0 + 0.0 * speed, 1.0 + 0.0 * speed)
    sticks = abs(x) < 1.0
    slope = friction[i, VISCOUS] + select(sticks, friction[i, COULOMB] * (1.0 / STICK_SPEED) + 0.0 * x, 0.0 * x)
    return -(friction[i, VISCOUS] * speed + friction[i, COULOMB] * x), slope


@inline
def stop_torque(stops, i, angle, speed, h):
    """Torque of the one-sided stops at the limits [N m] and its slope; the angle moves on by h speed."""
    if stops is None:
        return 0.0, 0.0
    at = angle + h * speed
    over, c_over = _pushed_back(stops, i, at - stops[i, UPPER], speed, h)
    under, c_under = _pushed_back(stops, i, stops[i, LOWER] - at, -speed, h)
    return under - over, c_over + c_under


@inline
def _pushed_back(stops, i, depth, speed, h):
    """K x (1 + d dx/dt) and its slope: Hunt and Crossley's law is continuous at touch-down, a plain damper is not."""
    k, d = stops[i, STOP_K], stops[i, STOP_D]
    grip = 1.0 + d * speed
    on = (depth > 0.0) & (grip > 0.0)
    return select(on, k * depth * grip, 0.0 * depth), select(on, k * (h * grip + d * depth), 0.0 * depth)
