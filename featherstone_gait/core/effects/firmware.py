"""Firmware of a servo, besides its controller's law: dead band and punch, duty cycle, profile speed, delay.

The law is a voltage u at the nominal supply, `voltage_limit`; the duty cycle is d = u / voltage_limit.

- Dead band: the law sees e' = e - clamp(e, -margin, margin), and where e' is not 0 a punch of its sign is added.  With
  Ki = Kd = Kf = 0 that is the law of the AX-12 (ROBOTIS, Dynamixel AX-12 user's manual, control table 0x1A to 0x1D and
  0x30): nothing within the compliance margin, the punch at its edge, from there a slope Kp up to the full output.
- Duty cycle: limited, then rounded to the nearest of the counts that a full one has.
- Profile: the goal that the law sees goes toward the reference by at most profile_speed * period a tick.
- Delay: voltages wait in the state; `slots` of them are under way just before the oldest is applied.
- Wrap: the error of a continuous joint is taken the short way round, e - 2 pi k in (-pi, pi], and so are the gap of the
  profile and the error's change.

Each is None where no servo has it, and costs nothing then.
"""

from typing import NamedTuple

import numpy as np

from ..compile.jit import inline
from ..compile.lanes import clamp, select, sign_beyond
from ..compile.structure import record, structure
from ..compile.taped import constant

BAND = record(
    compliance_margin=float,  # [rad], of PID_SPEED [rad/s]
    punch=float,  # [V]
)
PWM = record(
    pwm_steps=float,  # counts of a full duty cycle, 0: continuous
    duty_limit=float,  # largest duty cycle, a whole number of counts
)
ROUND = 6755399441055744.0  # 1.5 * 2**52: adding and subtracting it rounds to an integer
TURN = 6.283185307179586  # [rad]


@structure
class Delay(NamedTuple):
    """Time that voltages wait, the same for all servos."""

    slots: int  # voltages of each servo that wait at most
    shift: int  # steps after a tick at which the oldest is applied, 0: at the tick


@structure
class Firmware(NamedTuple):
    """The firmware of a scene's servos, one row a joint."""

    band: np.ndarray | None = None  # (n,) BAND
    pwm: np.ndarray | None = None  # (n,) PWM
    profile: np.ndarray | None = None  # (n,) speeds [rad/s]
    delay: Delay | None = None
    wrap: np.ndarray | None = None  # (n,) 1: the short way round, 0: as the reference says


@inline
def short_way(wrap, angle, i):
    """Return the angle between two positions of joint i, in (-pi, pi] if it goes the short way round [rad]."""
    if wrap is None:
        return angle
    turns = angle / TURN
    whole = constant((turns + ROUND) - ROUND)
    whole = whole - select(turns - whole <= -0.5, 1.0 + 0.0 * turns, 0.0 * turns)
    return select(wrap[i] > 0.0, angle - whole * TURN, angle)


@inline
def goal_and_rate(profile, wrap, offsets, reference, y, i, period):
    """Return what the law follows: the reference and its rate, or the profile on its way there [rad, rad/s]."""
    if profile is None:
        return reference[i, 0], reference[i, 1]
    speed, gap = profile[i], short_way(wrap, reference[i, 0] - y[offsets.profiled_reference + i], i)
    most = speed * period
    goal = select(abs(gap) <= most, reference[i, 0], y[offsets.profiled_reference + i] + clamp(gap, -most, most))
    y[offsets.profiled_reference + i] = goal
    return goal, select(gap > most, speed, select(gap < -most, -speed, reference[i, 1]))


@inline
def beyond_margin(band, e, i):
    """Return the error less the dead band."""
    if band is None:
        return e
    return e - clamp(e, -band[i].compliance_margin, band[i].compliance_margin)


@inline
def with_punch(band, u, e, i):
    """Return the voltage with the punch in the direction of the error [V]."""
    if band is None:
        return u
    return u + band[i].punch * sign_beyond(e, 0.0)


@inline
def largest(pwm, c, i):
    """Return the largest voltage of the controller c [V]."""
    if pwm is None:
        return c.voltage_limit
    return c.voltage_limit * pwm[i].duty_limit


@inline
def in_counts(pwm, c, u, i):
    """Return the voltage at the nearest count of the duty cycle [V]."""
    if pwm is None:
        return u
    steps, full, one = pwm[i].pwm_steps, c.voltage_limit, 1.0 + 0.0 * u
    exact = steps * full <= 0.0
    counts = (u / select(exact, one, full * one) * steps + ROUND) - ROUND
    return select(exact, u, counts / select(exact, one, steps * one) * full)


@inline
def issue(delay, offsets, y, i, n, u):
    """Apply the voltage u of servo i, of n, or put it last among those that wait."""
    if delay is None:
        y[offsets.voltage + i] = u
    else:
        y[offsets.delayed + (delay.slots - 1) * n + i] = u
