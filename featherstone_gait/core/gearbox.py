"""Spring-damper gearbox (Lima et al. 2013, equations 3-6) with backlash, at the output side.

e = rotor angle / G - joint angle.  Without backlash T = K e + B de/dt, as printed.  With a gap on either side the teeth
touch beyond it and only push; a plain damper would then jump as they meet, so that they follow Hunt and Crossley,
T = K x (1 + d dx/dt) with x = |e| - gap, which is continuous and never falls with the closing speed.
"""

from .jit import inline
from .lanes import select
from .layout import DAMPING, GAP, STIFFNESS, TOOTH_D


@inline
def gear_torque(gear, i, e, de, h):
    """Torque on the joint [N m], its slope in de [N m s/rad] and the power it loses [W]; e moves on by h de."""
    K, B = gear[i, STIFFNESS], gear[i, DAMPING]
    tight = gear[i, GAP] <= 0.0
    side = select(e >= 0.0, 1.0 + 0.0 * e, -1.0 + 0.0 * e)
    x, closing = e * side - gear[i, GAP], de * side
    grip = 1.0 + gear[i, TOOTH_D] * closing
    on = (x > 0.0) & (grip > 0.0)
    push = select(on, K * x * grip, 0.0 * x)
    slope = select(on, K * (h * grip + gear[i, TOOTH_D] * x), 0.0 * x)
    loss = select(x > 0.0, (push - K * x) * closing, 0.0 * x)
    return (
        select(tight, K * e + B * de, push * side),
        select(tight, h * K + B + 0.0 * e, slope),
        select(tight, B * (de * de), loss),
    )


@inline
def wind_up(gear, i, e):
    """Deflection of the spring [rad]."""
    gap = gear[i, GAP]
    return select(e > gap, e - gap, select(e < -gap, e + gap, 0.0 * e))
