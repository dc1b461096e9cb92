"""Drag: damping of joints that grows with the speed, -(b2 |v| + b3 v^2) v beside the viscous friction of friction.py.

An implicit step takes it at the speed that it solves for, with its slope, so that no drag limits the step.
"""

from ..compile.jit import inline
from ..compile.structure import record
from .energies import ENERGIES
from .energies import FRICTION as LOSS

DRAG = record(
    quadratic_damping=float,  # b2 [N m s^2/rad^2 or N s^2/m^2]
    cubic_damping=float,  # b3 [N m s^3/rad^3 or N s^3/m^3]
)


@inline
def plus_drag(drags, i, v, T, c):
    """Return T plus the drag of joint i at the speed v [N m], and c plus its slope -dT/dv."""
    if drags is None:
        return T, c
    d, speed = drags[i], abs(v)
    return T - _drag(d, v), c + speed * (2.0 * d.quadratic_damping + 3.0 * d.cubic_damping * speed)


@inline
def _drag(d, v):
    speed = abs(v)
    return v * (speed * (d.quadratic_damping + d.cubic_damping * speed))


@inline
def move_drag(drags, step, i, v, T):
    """Add the energy that drag takes in the step at the speed v; return T plus its torque [N m]."""
    if drags is None:
        return T
    drag = _drag(drags[i], v)
    step.y[step.offsets.energy + ENERGIES * i + LOSS] += step.h * (drag * v)
    return T - drag


@inline
def drag_rates(drags, step, dy, i, v, T):
    """Add the power that drag takes to dy; return T plus its torque [N m]."""
    if drags is None:
        return T
    drag = _drag(drags[i], v)
    dy[step.offsets.energy + ENERGIES * i + LOSS] += drag * v
    return T - drag


def explicit_limits(damping):
    """Return the dampers [N m s/rad or N s/m] of each joint that limit an explicit step, by name, and no springs."""
    return {"nonlinear damping": damping}, {}
