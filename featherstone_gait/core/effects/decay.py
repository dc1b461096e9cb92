"""Decay of motor currents and filtered speeds over a step, which depends on the length of the step alone."""

from ..compile.elementary import exp
from ..compile.jit import entry, inline
from ..compile.lanes import select

# Columns, one row a joint.
MOTOR_DECAY = 0  # exp(-h R/L), 0 without inductance: what is left of a current
MEAN = 1  # (1 - exp(-h R/L)) / (h R/L): its mean over the step
FILTER_DECAY = 2  # exp(-h / time constant), 0 without a filter: what is left of a speed's deviation
DECAYS = 3


def set_decay(motor, controller, h, decay):
    """Fill decay (n, DECAYS) for the step h [s]."""
    for i in range(len(motor)):
        if motor[i].inductance > 0.0:
            z = h * (motor[i].resistance / motor[i].inductance)
            left = exp(-z)
            series = 1.0 - z * (0.5 - z * (1.0 / 6.0 - z * (1.0 / 24.0)))  # where the difference loses digits
            decay[i, MOTOR_DECAY] = left
            decay[i, MEAN] = select(z < 1e-3, series, (1.0 - left) / z)
        if controller[i].speed_filter > 0.0:
            decay[i, FILTER_DECAY] = exp(-h / controller[i].speed_filter)


fill_decay, set_decay = entry(set_decay), inline(set_decay)  # from Python, from kernels
