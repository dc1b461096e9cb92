"""DC motor in the stages of a Runge-Kutta method: the exact course of its current since the start of the step.

After a controller's tick the current follows its new voltage within a fraction of a step, at first as fast as its rate
is limited.  It is known in closed form for a speed w that changes linearly over the time T of the stage:

    L dI/dt = V - K w(t) - R I:    I = (V - K w) / R + lag + (I1 - (V - K w1) / R - lag) exp(-(t - t1) R/L),

with lag = K (dw/dt) L / R^2, from the time t1 on at which the rate comes below its limit; before, I = I0 +- slew t.
Where no limit acts from the start, which the start alone decides, the current is affine in the speed at the end.

The torque of a stage is that of the current at its end, but of the last stage, whose weights are those of the step, of
what brings the sum of all to the mean current over the step: velocities then take up the whole impulse of a transient
that no quadrature of a few values would see.  Where the current is smooth that changes nothing of the method's order.
"""

from typing import NamedTuple

import numpy as np

from ..compile.elementary import exp
from ..compile.jit import inline
from ..compile.lanes import clamp
from ..compile.structure import structure

# Columns, one row a joint.
NOW = 0  # speed at the start of the step [rad/s]
CURRENT = 1  # current there [A]
LEFT = 2  # exp(-T R/L) of the stage's time T
MEAN = 3  # (1 - LEFT) / (T R/L)
FILTER = 4  # what Euler's implicit step leaves of a filtered speed's deviation
PAST = 5  # of the last stage: what the others bear of the mean current, by its weight [A]
USED = 6  # 4: current of each stage's torque [A]
MID_SPEED = 10  # speed at the end of the stage before the last [rad/s]
MID_CURRENT = 11  # current there [A]
FREE = 12  # 1 where no limit acts at the start of the step
END = 13  # current at the end of a free stage whose speed stays [A], and its slope -d/dw [A s/rad]
END_SLOPE = 14
AVERAGE = 15  # the same of its mean
AVERAGE_SLOPE = 16
COLUMNS = 17


@structure
class MotorStage(NamedTuple):
    """The stage that is being solved."""

    table: np.ndarray  # (n, COLUMNS)
    time: np.ndarray  # (3,) T since the start of the step [s], of the last stage 1 / its weight, else 0; which it is


@inline
def left_and_mean(T, tau):
    """Return what is left of a deviation after the time T [s], and its mean; time constant tau [s]."""
    if not T > 0.0:
        return 1.0, 1.0
    if not tau > 0.0:
        return 0.0, 0.0
    z = T / tau
    left = exp(-z)
    if z > 1e-3:
        return left, (1.0 - left) / z
    return left, 1.0 - z * (0.5 - z * (1.0 / 6.0 - z * (1.0 / 24.0)))


@inline
def course(m, voltage, w0, I0, w, T, left, mean):
    """Return the current at the end [A], its mean over T [s] and the slopes -d/dw of both [A s/rad].

    m MOTOR; w0 and w [rad/s] the speeds at start and end, left and mean: see the columns.
    """
    K, R, L = m.torque_constant, m.resistance, m.inductance
    tau, rate = L / R, K * (w - w0) / T
    lag, D0 = rate * tau / R, voltage - K * w0
    slope = (K / R) * (0.5 - (tau / T) * (1.0 - mean))
    slope_end = (K / R) * (1.0 - (tau / T) * (1.0 - left))
    s, I1, area = _limited(m, D0, rate, I0, T)
    if s > 0.0:
        left, mean = left_and_mean(T - s, tau)
        slope_end = (K / (R * T)) * (T - tau - (s - tau) * left)
        slope = (K / (R * T * T)) * (0.5 * (T * T - s * s) - tau * (T - s) - (s - tau) * (tau * (1.0 - left)))
    past = I1 - (D0 - rate * s) / R - lag
    end = (D0 - rate * T) / R + lag + past * left
    rest = (D0 - 0.5 * rate * (s + T)) / R + lag + past * mean
    average = (area + (T - s) * rest) / T
    return _within(m.current_limit, end, average, slope_end, slope)


@inline
def _within(limit, end, average, slope_end, slope):
    """Limit the currents and zero the slopes where the limit acts."""
    if abs(average) > limit:
        slope = 0.0
    if abs(end) > limit:
        slope_end = 0.0
    return clamp(end, -limit, limit), clamp(average, -limit, limit), slope_end, slope


@inline
def _limited(m, D0, rate, I0, T):
    """Return until when limits set the current [s], the current then [A], and its integral until then [A s].

    First its rate is limited, as far as its own limit, at which it stays while the voltage D0 - rate t drives it on.
    """
    s, I1, area, limit = 0.0, I0, 0.0, m.current_limit
    sign = 1.0 if D0 > m.resistance * I0 else -1.0
    excess = abs(D0 - m.resistance * I0) - m.inductance * m.current_slew
    if excess > 0.0:
        s = excess / max(m.resistance * m.current_slew + sign * rate, 1e-6 * m.resistance * m.current_slew)
        s = min(T, s, max(limit - sign * I0, 0.0) / m.current_slew)
        I1 = I0 + sign * (m.current_slew * s)
        area = 0.5 * s * (I0 + I1)
    outward = sign * (D0 - rate * s) - m.resistance * limit
    if sign * I1 >= (1.0 - 1e-12) * limit and outward > 0.0:
        hold = T - s
        if sign * rate * hold > outward:
            hold = outward / (sign * rate)
        s, area = s + hold, area + hold * I1
    return s, I1, area


@inline
def stage_current(m, stage, i, voltage, w):
    """Return the current of motor m at the stage's end, that of its torque [A], and the slope of that [A s/rad]."""
    row, T, share = stage.table[i], stage.time[0], stage.time[1]
    if row[FREE] > 0.0:
        more = w - row[NOW]
        end, mean = row[END] - row[END_SLOPE] * more, row[AVERAGE] - row[AVERAGE_SLOPE] * more
        end, mean, slope_end, slope = _within(m.current_limit, end, mean, row[END_SLOPE], row[AVERAGE_SLOPE])
    else:
        end, mean, slope_end, slope = course(m, voltage, row[NOW], row[CURRENT], w, T, row[LEFT], row[MEAN])
    if share > 0.0:
        return end, share * mean - row[PAST], share * slope
    return end, end, slope_end


@inline
def is_free(m, voltage, current, w):
    """Return whether no limit acts on the current at the speed w."""
    driving = voltage - m.torque_constant * w - m.resistance * current
    return (abs(driving) < m.inductance * m.current_slew) & (abs(current) < m.current_limit)


@inline
def missed(m, stage, i, voltage, current, w, T):
    """Return the error of the current at a step's end [A] if a limit has begun or ceased to act, else 0.

    It is the difference to the current that follows from the last part of the step, of length T [s], alone.
    """
    row = stage.table[i]
    if is_free(m, voltage, row[CURRENT], row[NOW]) and is_free(m, voltage, current, w):
        return 0.0
    left, mean = left_and_mean(T, m.inductance / m.resistance)
    end, _, _, _ = course(m, voltage, row[MID_SPEED], row[MID_CURRENT], w, T, left, mean)
    return current - end


@inline
def bend(m, stage, i, voltage, current, w, rate, h):
    """Return what the current of motor m at a step's end lacks where the speed's rate changes by `rate` [rad/s^3].

    The speed then sags below its chord by rate t (h - t) / 2.
    """
    if not is_free(m, voltage, current, w):
        return 0.0
    tau, left = m.inductance / m.resistance, stage.table[i, LEFT]
    sag = tau * h * (1.0 + left) - 2.0 * (tau * tau) * (1.0 - left)
    return 0.5 * (m.torque_constant / m.resistance) * rate * sag


@inline
def begin_stage(m, stage, i, voltage, T, past, filter_time, d):
    """Begin the stage whose end lies T after the start of the step [s], its own step d [s]."""
    row, tau = stage.table[i], m.inductance / m.resistance
    row[PAST] = past
    left, mean = left_and_mean(T, tau)
    row[LEFT], row[MEAN] = left, mean
    # What `course` gives where no limit acts from the start; z is the time constant by the stage's time.
    z, per_ohm, K, I0 = tau / T, 1.0 / m.resistance, m.torque_constant, row[CURRENT]
    row[FREE] = 1.0 if is_free(m, voltage, I0, row[NOW]) else 0.0
    steady = (voltage - K * row[NOW]) * per_ohm
    row[END], row[AVERAGE] = steady + (I0 - steady) * left, steady + (I0 - steady) * mean
    row[END_SLOPE] = (K * per_ohm) * (1.0 - z * (1.0 - left))
    row[AVERAGE_SLOPE] = (K * per_ohm) * (0.5 - z * (1.0 - mean))
    row[FILTER] = 0.0
    if filter_time > 0.0:
        row[FILTER] = 1.0 / (1.0 + d / filter_time)
