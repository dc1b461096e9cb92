"""Stops at the limits of a joint: one-sided springs with the damping of Hunt and Crossley.

T = K x (1 + d dx/dt), never pulling, x the depth: continuous at touch-down, where a plain damper jumps.
"""

import numpy as np

from ..compile.jit import inline
from ..compile.lanes import select, sign_beyond
from ..compile.structure import record
from .energies import ENERGIES, STOPS

STOP = record(
    lower=float,  # [rad or m]
    upper=float,  # [rad or m]
    stiffness=float,  # [N m/rad or N/m]
    damping=float,  # Hunt and Crossley's d [s/rad or s/m]
)

STOP_DEPTH = 0.01  # [rad or m] that the strongest torque at a joint drives it into its stop


@inline
def stop_torque(stops, i, angle, speed, h):
    """Return the joint's torque [N m] and its slope -dT/d speed; the angle moves on by h speed."""
    if stops is None:
        return 0.0, 0.0
    stop = stops[i]
    at = angle + h * speed
    over, c_over = _pushed_back(stop, at - stop.upper, speed, h)
    under, c_under = _pushed_back(stop, stop.lower - at, -speed, h)
    return under - over, c_over + c_under


@inline
def stop_branch(stops, i, angle, speed, h):
    """Return which stop pushes: 1 the lower one, -1 the upper one, 0 none."""
    if stops is None:
        return 0.0
    T, _ = stop_torque(stops, i, angle, speed, h)
    return sign_beyond(T, 0.0)


@inline
def move_stop(stops, step, i, v):
    """Add the work done on the stops in the step at the speed v; return their torque [N m]."""
    if stops is None:
        return 0.0
    T, _ = stop_torque(stops, i, step.y[step.offsets.q + i], v, step.h_implicit)
    step.y[step.offsets.energy + ENERGIES * i + STOPS] -= step.h * (T * v)
    return T


@inline
def stop_rates(stops, step, dy, i, v):
    """Set the power done on the stops in dy; return their torque [N m]."""
    if stops is None:
        return 0.0
    T, _ = stop_torque(stops, i, step.y[step.offsets.q + i], v, 0.0)
    dy[step.offsets.energy + ENERGIES * i + STOPS] = -T * v
    return T


@inline
def _pushed_back(stop, depth, speed, h):
    k, d = stop.stiffness, stop.damping
    grip = 1.0 + d * speed
    on = (depth > 0.0) & (grip > 0.0)
    return select(on, k * depth * grip, 0.0 * depth), select(on, k * (h * grip + d * depth), 0.0 * depth)


def explicit_limit(stops, inertias):
    """Step [s] of each joint up to which an explicit method resolves its stop.

    That is a fortieth of the period on its spring, or the time constant J / c of its damper, c = K d x, at the depth to
    which the strongest torque drives the joint.  inertias (n,) that the joints feel [kg m^2 or kg].
    """
    J, K = np.asarray(inertias), stops["stiffness"]
    damper = K * np.maximum(stops["damping"], 1e-300) * STOP_DEPTH
    return np.minimum(2.0 * np.pi * np.sqrt(J / K) / 40.0, J / damper)
