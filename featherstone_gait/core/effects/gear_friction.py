"""Friction of a gear train that falls with the speed and grows with the load: the models M2 to M6 of servos.

M. Duclusaud, G. Passault, V. Padois, O. Ly, Extended Friction Models for the Physics Simulation of Servo Actuators
(2024, arXiv 2410.08650).  The budget of friction.py is, with S = exp(-|v / v_s|^alpha),

    K_c + |K_e t_e - K_m t_m| + K_p |t_e t_m| + S (K_cs + |K_es t_e - K_ms t_m| + [K_eq t_e^2 or K_mq t_m^2])

and viscous friction besides; K_p is an addition: recordings show losses that grow faster than the load at any speed.
t_m is the torque that drives the joint (the motor's at the output, or the gear spring's) and t_e what the mechanism
does to the gear in this step: A dv/dt = t_m + t_f + t_e, A the armature and t_f all of the friction.  Quadratic terms
count where t_e and t_m oppose each other, the first where |t_e| < |t_m|, the second where it is larger; between the two
the law changes over within `BLEND` of their sum, for a jump has no solution.

Load and friction depend on each other, through t_e.  That is solved joint by joint: in closed form where the budget is
made of straight pieces, by Newton's method on one unknown where it has K_p or quadratic terms, or outgrows the load.
The slopes of the solution enter the step's own iteration, so that loads are taken at the step's end.  S is taken at the
speed that the method predicts: then nothing falls with the speed that is sought, and what the step solves has one
solution.  Where the budget outgrows what it opposes (K_e >= 1), no load moves a gear that stands; one that slides is
slowed by it as by K_e = 0.95.
"""

from typing import NamedTuple

import numpy as np

from ..compile.elementary import exp, log
from ..compile.jit import inline
from ..compile.lanes import any_lane, clamp, select, sign_beyond
from ..compile.structure import record, structure
from .friction import FRICTION, snap_to_rest, snapped, stops_at_once

GEAR_FRICTION = record(
    external_load_friction=float,  # K_e [-]
    motor_load_friction=float,  # K_m [-]
    load_product_friction=float,  # K_p [1/(N m)]
    stribeck_speed=float,  # v_s [rad/s]
    stribeck_exponent=float,  # alpha [-]
    stribeck_friction=float,  # K_cs [N m]
    stribeck_external_load=float,  # K_es [-]
    stribeck_motor_load=float,  # K_ms [-]
    quadratic_external_load=float,  # K_eq [1/(N m)]
    quadratic_motor_load=float,  # K_mq [1/(N m)]
    **dict.fromkeys(FRICTION.names or (), float),  # coulomb_friction: K_c
)
BLEND = 0.5  # of |t_e| + |t_m|, on either side of their equality: from a third of the other to three times
PASSES = 4  # a straight piece each, and one for the quadratic terms
LOCKED = 1e4  # [N m] of a gear that no load drives backwards
# Of K_e + S K_es at most, while a gear slides: driven, it would jam, and the step have no solution or several.
JAMMING_SHARE = 0.95
FLATTEST = 1e-9  # slope below which a budget outgrows what it opposes
SLOWEST = 1e-200  # of stribeck_speed, below which a speed counts as none


@structure
class GearFriction(NamedTuple):
    """The friction of a scene's joints, of which one at least has more than M1."""

    table: np.ndarray  # (n,) GEAR_FRICTION


@inline
def stribeck(f, v):
    """Return S, the share at the speed v of the friction that falls with speed [-]."""
    x = abs(v) / f.stribeck_speed
    S = 0.0 * x
    falls = f.stribeck_friction + (f.stribeck_external_load + f.stribeck_motor_load)
    if any_lane(falls + (f.quadratic_external_load + f.quadratic_motor_load) > S):
        S = exp(-exp(f.stribeck_exponent * log(select(x > SLOWEST, x, SLOWEST))))
    return S


@inline
def gear_friction(f, S, x, t_m, b):
    """Return dry friction [N m] where the share x of the budget opposes motion, and its slopes by x, t_m and b.

    f GEAR_FRICTION; S of `stribeck`; x of `direction`; t_m [N m]; b = A dv/dt + K_v v [N m], with which dry friction
    t_f leaves t_e = b - t_m - t_f.
    """
    one = 1.0 + 0.0 * (x + t_m + b)
    side = select(x >= 0.0, one, -one)
    r, by_m, by_b = _straight(f, S, side, t_m, b)
    grows = f.external_load_friction + S * f.stribeck_external_load
    curved = f.quadratic_external_load + f.quadratic_motor_load + f.load_product_friction
    iterated = (grows > JAMMING_SHARE) | (curved > 0.0 * one)
    if any_lane(iterated):
        jams = grows > JAMMING_SHARE
        E = select((abs(x) >= 1.0) & jams, JAMMING_SHARE / select(jams, grows, one), one)
        r_, by_m_, by_b_ = _opposing(f, S, E, side, t_m, b)
        r, by_m, by_b = select(iterated, r_, r), select(iterated, by_m_, by_m), select(iterated, by_b_, by_b)
    return abs(x) * r, side * r, abs(x) * by_m, abs(x) * by_b


@inline
def _straight(f, S, side, t_m, b):
    """Return what `_opposing` finds where the budget B is piecewise linear and grows less than the load.

    With the motion to the right, the load u = t_e meets u - c = B(u), c = b - t_m; to the left it is mirrored.
    u - c - B(u) rises and bends where a load term changes its sign; its sign there shows on which side
    the solution lies.
    """
    m, c = side * t_m, side * (b - t_m)
    K = f.coulomb_friction + S * f.stribeck_friction
    e, e_slow = f.external_load_friction, f.stribeck_external_load
    k, k_slow = f.motor_load_friction, f.stribeck_motor_load
    apart = (e_slow * k - e * k_slow) * m
    sign = _sign(e * (c + K) + S * abs(apart) - k * m)
    sign_slow = S * _sign(e_slow * (c + K) + abs(apart) - k_slow * m)
    by_e, by_m = sign * e + sign_slow * e_slow, sign * k + sign_slow * k_slow
    per = 1.0 / (1.0 - by_e)
    return -side * ((K - by_m * m + by_e * c) * per), (by_e + by_m) * per, -by_e * per


@inline
def _opposing(f, S, E, side, t_m, b):
    """Return the friction that opposes motion to a side (1 or -1) with the whole budget; slopes by t_m and b.

    E: of the load from outside, the share that counts.
    """
    zero = 0.0 * (E + t_m + b)
    r = zero
    for _ in range(PASSES):
        budget, by_e, _ = _budget(f, S, E, t_m, b - t_m - r)
        slope = 1.0 - side * by_e
        r = r - (r + side * budget) / select(slope > FLATTEST, slope, FLATTEST)
        r = clamp(r, zero - LOCKED, zero + LOCKED)
    _, by_e, by_m = _budget(f, S, E, t_m, b - t_m - r)
    slope = 1.0 - side * by_e
    free = (slope > FLATTEST) & (abs(r) < LOCKED)
    per = side / select(free, slope, 1.0 + zero)
    return r, select(free, (by_e - by_m) * per, zero), select(free, -by_e * per, zero)


@inline
def _budget(f, S, E, t_m, t_e):
    """Return the budget [N m] and its partial slopes by t_e and t_m."""
    load = f.external_load_friction * E * t_e - f.motor_load_friction * t_m
    slow = f.stribeck_external_load * E * t_e - f.stribeck_motor_load * t_m
    sign, sign_slow = _sign(load), S * _sign(slow)
    square, by_e, by_m = _quadratic(f, t_m, t_e)
    sign_e, sign_m, P = _sign(t_e), _sign(t_m), f.load_product_friction
    return (
        f.coulomb_friction + abs(load) + P * abs(t_e * t_m) + S * (f.stribeck_friction + abs(slow) + square),
        (sign * f.external_load_friction + sign_slow * f.stribeck_external_load) * E + S * by_e + P * abs(t_m) * sign_e,
        -(sign * f.motor_load_friction + sign_slow * f.stribeck_motor_load) + S * by_m + P * abs(t_e) * sign_m,
    )


@inline
def _quadratic(f, t_m, t_e):
    """Return the quadratic terms of M6 [N m] and their slopes by t_e and t_m."""
    size_e, size_m = abs(t_e), abs(t_m)
    total = size_e + size_m
    per = 1.0 / (BLEND * select(total > 0.0, total, 1.0 + total))
    w = 0.5 + 0.5 * (size_e - size_m) * per
    blends = (w > 0.0) & (w < 1.0)
    w = clamp(w, 0.0 * w, 1.0 + 0.0 * w)
    opposed = t_e * t_m < 0.0
    E, M = f.quadratic_external_load * (t_e * t_e), f.quadratic_motor_load * (t_m * t_m)
    change = select(blends, (M - E) * per / select(total > 0.0, total, 1.0 + total), 0.0 * total)
    by_e = 2.0 * (1.0 - w) * f.quadratic_external_load * t_e + change * size_m * _sign(t_e)
    by_m = 2.0 * w * f.quadratic_motor_load * t_m - change * size_e * _sign(t_m)
    zero = 0.0 * total
    return select(opposed, (1.0 - w) * E + w * M, zero), select(opposed, by_e, zero), select(opposed, by_m, zero)


@inline
def _sign(x):
    return select(x < 0.0, -1.0 + 0.0 * x, 1.0 + 0.0 * x)


@inline
def gear_branch(f, speed, t_m, t_e):
    """Return a number for the side on which friction acts in full and the sign of each load that it grows with."""
    load = f.external_load_friction * t_e - f.motor_load_friction * t_m
    slow = f.stribeck_external_load * t_e - f.stribeck_motor_load * t_m
    key = sign_beyond(f.steepness * speed, 1.0) + 3.0 * sign_beyond(load, 0.0) + 9.0 * sign_beyond(slow, 0.0)
    square = f.quadratic_external_load + f.quadratic_motor_load
    return key + 27.0 * sign_beyond((square + f.load_product_friction) * (t_e * t_m), 0.0)


stops_at_once.of(GearFriction)(lambda friction: True)
snap_to_rest.of(GearFriction)(
    lambda friction, step, i, v, here, there: snapped(step.extrapolation_ratio, step, i, v, here, there)
)
