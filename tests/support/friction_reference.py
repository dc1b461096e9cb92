"""A rod on a servo with the friction models M1 to M6, by SciPy: sliding and sticking as two equations with events."""

import math

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

BLEND = 0.5  # over which the quadratic terms change over, of the sum of both torques


def budget(p, v, t_m, t_e):
    """tau_f of the source's table, without viscous friction; p: fields of `Gearbox`, and coulomb_friction."""
    S = math.exp(-((abs(v) / p["stribeck_speed"]) ** p["stribeck_exponent"])) if v else 1.0
    square = 0.0
    if t_e * t_m < 0.0:
        w = min(max(0.5 + 0.5 * (abs(t_e) - abs(t_m)) / (BLEND * (abs(t_e) + abs(t_m))), 0.0), 1.0)
        square = (1.0 - w) * p["quadratic_external_load"] * t_e**2 + w * p["quadratic_motor_load"] * t_m**2
    slow = p["stribeck_friction"] + abs(p["stribeck_external_load"] * t_e - p["stribeck_motor_load"] * t_m) + square
    load = abs(p["external_load_friction"] * t_e - p["motor_load_friction"] * t_m)
    return p["coulomb_friction"] + load + p["load_product_friction"] * abs(t_e * t_m) + S * slow


def friction(p, side, v, t_m, load, A, J, static):
    """Dry friction of a joint that slides to `side`: of inertia J with armature A, under t_m and a load [N m]."""
    if static:
        return -side * budget(p, v, t_m, load)
    viscous = p["viscous_friction"] * v

    def missing(r):
        a = (t_m + r - viscous + load) / (A + J)
        return r + side * budget(p, v, t_m, A * a - t_m - r + viscous)

    return brentq(missing, *sorted((0.0, -side * 1e3)), xtol=1e-15, rtol=1e-14)


def course(p, A, J, load, motor, start, times, static=False, method="DOP853"):
    """Angles [rad] at the times, from (angle, speed); load(q) [N m], motor(t, q, v) [N m].  Also the events' times.

    static: t_e is the load of a joint that does not accelerate, not what goes through the gear.
    """

    def rates(side):
        def slide(t, y):
            t_m, q, v = motor(t, *y), y[0], y[1]
            r = friction(p, side, v, t_m, load(q), A, J, static)
            return [v, (t_m + r - p["viscous_friction"] * v + load(q)) / (A + J)]

        return slide

    def excess(t, q):
        t_m = motor(t, q, 0.0)
        return abs(t_m + load(q)) - budget(p, 0.0, t_m, load(q))

    def rests(t, y):
        return y[1]

    def breaks(t, y):
        return excess(t, y[0])

    rests.terminal = breaks.terminal = True
    breaks.direction = 1.0
    t, y, angles, events = 0.0, np.array(start, dtype=float), np.zeros(len(times)), []
    while t < times[-1]:
        sticks = y[1] == 0.0 and excess(t, y[0]) <= 0.0
        if sticks:
            function, event = lambda t, y: [0.0, 0.0], breaks
        else:
            side = math.copysign(1.0, y[1] if y[1] else motor(t, y[0], 0.0) + load(y[0]))
            function, event = rates(side), rests
            rests.direction = -side
        run = solve_ivp(function, (t, times[-1]), y, method, None, True, event, rtol=1e-11, atol=1e-12, max_step=0.05)
        part = (times >= t) & (times <= run.t[-1])
        if part.any():
            angles[part] = run.sol(times[part])[0]
        t, y = run.t[-1], run.y[:, -1].copy()
        if run.status == 1:
            events.append(t)
            y[1] = 0.0
            if sticks:  # off the edge of the budget
                t += 1e-13
                y[1] = 1e-13 * math.copysign(1.0, motor(t, y[0], 0.0) + load(y[0]))
    return angles, events
