"""Tolerances of error control where none is given, with the measurements behind them."""

from __future__ import annotations

import math
from collections.abc import Iterable

from ..core.integrate.integrator import Integrator
from ..model import Controller, Servo

# Relative tolerances, but the integrator's own where that is less:
FREE = 1e-4  # of all but servos of a floating robot over ground, whose feet hold what an arm passes on
SLOW, FINE = 0.03, 1e-7  # [m/s]; see `usual_atol`
JUMPING = 1e-6  # where a controller's law jumps by more than an error of `JUMP` [rad] asks for,
JUMP = 2e-3  # of which a joint takes a third before the next tick


def usual_rtol(method: Integrator, jump: float, holds: bool) -> float:
    """Return the relative tolerance of an integrator.

    jump: largest jump of a control law [rad]; holds: feet hold what servos without a supply of their own pass on.

    Measured by steps of a reference that end more than 1e-3 rad off with the status "ok":

    - Seven servos (`arm7`, mipsd): 10 of 40 steps at a tolerance of 1e-2, 2 at 1e-3, one at 3e-4, none at 1e-4,
      which takes 1.6 times as long as 1e-2.  With a supply that sags: 9 of 25 at 1e-2.
    - Ten servos on feet, with falls and flights: none of 40 motions at 1e-2.
    - A servo with an encoder step of 5 mrad, whose control law jumps, so that the smallest error may decide on
      which side: 32 of 60 steps at 1e-2, 21 at 1e-3; of 80 others one at 1e-5, none at 1e-6.
    """
    if jump > JUMP:
        return min(method.rtol, JUMPING)
    return method.rtol if holds else min(method.rtol, FREE)


def usual_atol(rtol: float, touching: bool) -> float:
    """Return the absolute tolerance that goes with a relative one [rad, m, and their rates; A].

    Where bodies touch each other, slow ones count as much as fast ones, since the speed of a rebound is a share of
    that before: SLOW times rtol, down to FINE.  Of head-on collisions of two balls of 1 kg and 1 to 1000 kg at 0.05
    to 10 m/s the restitution is off by up to 7e-3 with atol = rtol = 1e-4, and by up to 7e-4 so.  A stack at rest
    takes 1.4 times as many steps, a ball that rolls twice as many.
    """
    return max(SLOW * rtol, min(rtol, FINE)) if touching and rtol <= FREE else rtol


def largest_jump(servos: Iterable[Servo]) -> float:
    """Return the largest jump of a control law, as the error that would cause the same output [rad]."""
    return max(max(servo.encoder_resolution, _punch(servo.controller)) for servo in servos)


def _punch(law: Controller) -> float:
    """Return the error that would cause the same voltage as the punch [rad]."""
    return law.punch / law.Kp if law.Kp else math.inf if law.punch else 0.0
