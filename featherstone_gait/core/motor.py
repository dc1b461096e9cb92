"""DC motor: L dI/dt = V - K omega - R I, with limits on the current and on its rate.

All quantities at the output side: KT = G K, so that KT omega is the back-EMF and KT I the torque.  For constant V and
omega the current approaches (V - KT omega)/R exponentially; the step uses that solution, its end and its mean, exactly.
"""

from .jit import inline
from .lanes import invert, select
from .layout import DECAY, IMAX, IND, KT, MEAN, RES, SLEW


@inline
def clamp(x, lower, upper):
    return select(x < lower, lower, select(x > upper, upper, x))


@inline
def current_step(servo, i, current, voltage, speed, h):
    """Current after h [A], its mean over the step [A] and the slope -d mean/d speed [A s/rad].

    A limit that acts makes the current independent of the speed: the slope is then zero.
    """
    steady = (voltage - servo[i, KT] * speed) / servo[i, RES]
    decay, mean = servo[i, DECAY], servo[i, MEAN]
    free = steady + (current - steady) * decay
    end = clamp(free, current - servo[i, SLEW] * h, current + servo[i, SLEW] * h)
    end = clamp(end, -servo[i, IMAX], servo[i, IMAX])
    slope = select(end == free, (1.0 - mean) * servo[i, KT] / servo[i, RES], 0.0 * free)
    steady = (end - decay * current) / (1.0 - decay)
    return end, (1.0 - mean) * steady + mean * current, slope


@inline
def square_mean(servo, i, current, end):
    """Mean of I^2 over the step whose current went from `current` to `end` [A^2]."""
    decay, mean = servo[i, DECAY], servo[i, MEAN]
    steady = (end - decay * current) / (1.0 - decay)
    d = current - steady
    return steady * steady + d * (2.0 * steady * mean + d * (0.5 * mean * (1.0 + decay)))


@inline
def current_rate(servo, i, current, voltage, speed):
    """Current [A] and its rate [A/s] as a differential equation; without inductance the current is algebraic."""
    driving = voltage - servo[i, KT] * speed
    inductive = servo[i, IND] > 0.0
    steady = clamp(driving / servo[i, RES], -servo[i, IMAX], servo[i, IMAX])
    I = select(inductive, current, steady)
    rate = (driving - servo[i, RES] * I) / select(inductive, servo[i, IND], 1.0)
    rate = clamp(rate, -servo[i, SLEW], servo[i, SLEW])
    outward = ((I >= servo[i, IMAX]) & (rate > 0.0)) | ((I <= -servo[i, IMAX]) & (rate < 0.0))
    return I, select(invert(outward) & inductive, rate, 0.0 * rate)
