"""Spring-damper gearbox (Lima et al. 2013, equations 3-6) with backlash, at the output side.

e = rotor angle / G - joint angle.  Without backlash T = K e + B de/dt, as printed.  With a gap on either side the teeth
touch beyond it and only push; a plain damper would then jump as they meet, so that they follow Hunt and Crossley,
T = K x (1 + d dx/dt) with x = |e| - gap, which is continuous and never falls with the closing speed.
"""

from ..compile.jit import inline
from ..compile.lanes import select, sign_beyond
from ..compile.structure import record

GEAR = record(
    stiffness=float,  # K [N m/rad]
    damping=float,  # B [N m s/rad]
    gap=float,  # half the backlash [rad]
    ratio=float,  # G
    inertia=float,  # of the rotor, G^2 J [kg m^2]
    rotor_damping=float,  # G^2 B_vr [N m s/rad]
    tooth_damping=float,  # Hunt and Crossley's d of teeth that meet across a gap [s/rad]
)


@inline
def gear_torque(g, e, de, h):
    """Return the joint's torque [N m], its slope in de [N m s/rad] and the power lost [W]; e moves on by h de."""
    K, B = g.stiffness, g.damping
    tight = g.gap <= 0.0
    side = select(e >= 0.0, 1.0 + 0.0 * e, -1.0 + 0.0 * e)
    x, closing = e * side - g.gap, de * side
    grip = 1.0 + g.tooth_damping * closing
    on = (x > 0.0) & (grip > 0.0)
    push = select(on, K * x * grip, 0.0 * x)
    slope = select(on, K * (h * grip + g.tooth_damping * x), 0.0 * x)
    loss = select(x > 0.0, (push - K * x) * closing, 0.0 * x)
    return (
        select(tight, K * e + B * de, push * side),
        select(tight, h * K + B + 0.0 * e, slope),
        select(tight, B * (de * de), loss),
    )


@inline
def gear_branch(g, e, de):
    """Return which flanks of teeth push across a gap: 1, -1, or 0 if none; 0 without a gap."""
    T, _, _ = gear_torque(g, e, de, 0.0)
    return select(g.gap <= 0.0, 0.0 * T, sign_beyond(T, 0.0))


@inline
def wind_up(g, e):
    """Return the deflection of the spring [rad]."""
    return select(e > g.gap, e - g.gap, select(e < -g.gap, e + g.gap, 0.0 * e))


def explicit_limits(gear):
    """Return dampers [N m s/rad] and springs [N m/rad] of each joint that limit an explicit step, by name."""
    return {"gearbox damping": gear["damping"]}, {"gearbox spring": gear["stiffness"]}
