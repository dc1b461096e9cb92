"""The explicit update order of SimTwo (P33a/SimTwo, 2012), for comparison.

Each step: the speed is filtered, the current moves on with the speed of the step's start, the torque is a constant of
the step.  The spring-damper gearbox follows commit f9dc76a: rotor by semi-implicit Euler, the damping torque on the
rotor limited to 0.2 J / h.  Only stops and contacts stay implicit, as they were constraints of that engine.
"""

from .advance import advance
from .gearbox import wind_up
from .jit import inline, kernel
from .lanes import select
from .layout import (
    BV,
    COPPER,
    DAMPING,
    DRIVER,
    ENERGIES,
    FADE,
    FRICTION,
    GEAR,
    IND,
    INERTIA,
    KT,
    METER,
    RES,
    ROTOR_DAMPING,
    STIFFNESS,
    SUPPLY,
    WORK,
)
from .motor import clamp, current_step
from .scene import driven
from .step import solve_step


@kernel
def simtwo_step(scene, o, y, t, h, torques, W, Z, C, F):
    """Move y over the step h; torques (n,) scratch."""
    n = len(scene.tree) - 1
    for i in range(n):
        torques[i] = _servo(scene.servo, scene.gear, o, y, h, i)
    bare = driven(scene, None, None, None, None)
    solve_step(bare, bare.points, bare.push, o, y, t, h, None, torques, None, h, h, W, Z, C, F)
    advance(bare, bare.servo, bare.gear, bare.points, bare.floating, o, y, None, torques, None, h, h, 1.0, W, Z, C)


@inline
def _servo(servo, gear, o, y, h, i):
    """Torque on the joint of the whole step; the motor moves on."""
    v = y[o.qd + i]
    f = v + servo[i, FADE] * (y[o.filtered + i] - v)
    y[o.filtered + i] = f
    viscous = servo[i, BV] * f
    E = o.energy + ENERGIES * i
    y[E + FRICTION] += h * (viscous * v)
    y[E + WORK] += h * (viscous * v)
    if gear is None:
        return servo[i, KT] * _current(servo, o, y, h, i, v, E) - viscous
    w = y[o.rotor_speed + i]
    I = _current(servo, o, y, h, i, w, E)
    limit = 0.2 * gear[i, INERTIA] / h  # of the torque that the damper transmits
    T = gear[i, STIFFNESS] * wind_up(gear, i, y[o.rotor + i] - y[o.q + i])
    B = clamp(gear[i, DAMPING] * (w - f), -limit + 0.0 * w, limit + 0.0 * w)
    w = w + h * (servo[i, KT] * I - gear[i, ROTOR_DAMPING] * w - (T + B)) / gear[i, INERTIA]
    y[o.rotor_speed + i] = w
    y[o.rotor + i] += h * w
    y[E + GEAR] += h * (B * (w - v))
    y[E + FRICTION] += h * (gear[i, ROTOR_DAMPING] * (w * w))
    return (T + B) - viscous


@inline
def _current(servo, o, y, h, i, w, E):
    """Current at the end of the step [A], with the electrical energies as that program counts them."""
    V = y[o.voltage + i]
    I, _, _ = current_step(servo, i, y[o.current + i], V, w, h)
    supply, copper = h * (V * I), h * (servo[i, RES] * (I * I))
    y[E + SUPPLY] += supply
    y[E + METER] += select(supply > 0.0, supply, 0.0 * supply)
    y[E + COPPER] += copper
    stored = 0.5 * servo[i, IND] * (I * I - y[o.current + i] * y[o.current + i])
    y[E + DRIVER] += supply - copper - h * (servo[i, KT] * w * I) - stored
    y[o.current + i] = I
    return I
