"""Spring-damper gearbox with backlash (Lima et al. 2013, equations 3-6), at the output side.

e = rotor angle / G - joint angle; the teeth touch beyond the gap and push only:
T = K (e -+ gap) + B de/dt where |e| > gap and T has the sign of e, else 0.
"""

from .jit import inline
from .lanes import select
from .layout import DAMPING, GAP, STIFFNESS


@inline
def gear_torque(gear, i, e, de):
    """Torque on the joint [N m] and whether the teeth touch; e [rad], de [rad/s]."""
    side = select(e >= 0.0, 1.0 + 0.0 * e, -1.0 + 0.0 * e)
    wind = e - side * gear[i, GAP]
    torque = gear[i, STIFFNESS] * wind + gear[i, DAMPING] * de
    # Without backlash the teeth are always in contact: the spring-damper of the paper.
    touch = (gear[i, GAP] <= 0.0) | ((wind * side > 0.0) & (torque * side > 0.0))
    return select(touch, torque, 0.0 * torque), touch


@inline
def wind_up(gear, i, e):
    """Deflection of the spring [rad]."""
    gap = gear[i, GAP]
    return select(e > gap, e - gap, select(e < -gap, e + gap, 0.0 * e))
