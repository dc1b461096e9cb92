"""The servo's controller, sampled: once a tick a voltage from the angle and the filtered speed.

The laws are those of SimTwo (P33a/SimTwo, 2012), with sums and differences made independent of the period:

    state         u = Kp e + Kd (wref - f) + Ki integral(e) + Kf ref
    pid_position  u = Kp e + Ki integral(e) + Kd de/dt + Kf ref
    pid_speed     the same of the speed error wref - f

with e = ref - angle.  The two PID laws stop integrating while the voltage is at its limit.
"""

from .jit import inline, kernel
from .lanes import select
from .layout import ENCODER, FILTER, KD, KF, KI, KP, VMAX
from .motor import clamp

STATE_FEEDBACK = 0
PID_POSITION = 1
PID_SPEED = 2
_ROUND = 6755399441055744.0  # 1.5 * 2**52: adding and subtracting it rounds to an integer


@inline
def quantised(angle, resolution):
    """The angle as an encoder reads it: the nearest count."""
    if_exact = resolution <= 0.0
    counts = (angle / select(if_exact, 1.0 + 0.0 * resolution, resolution) + _ROUND) - _ROUND
    return select(if_exact, angle, counts * resolution)


@kernel
def control_tick(o, law, servo, reference, noise, y, period):
    """Set the voltages; reference (n, 2) angle [rad] and rate [rad/s]; period since the last tick [s].

    noise (n, 2) is added to the angle that the encoder sees [rad] and to the voltage [V]; None: there is none.
    """
    for i in range(len(law)):
        angle = quantised(_plus(y[o.q + i], noise, i, 0), servo[i, ENCODER])
        e = reference[i, 0] - angle
        de = reference[i, 1] - select(servo[i, FILTER] > 0.0, y[o.filtered + i], y[o.qd + i])
        if law[i] == PID_SPEED:
            e = de
        integral = y[o.integral + i] + e * period
        u = servo[i, KP] * e + servo[i, KI] * integral + servo[i, KF] * reference[i, 0]
        if law[i] == STATE_FEEDBACK:
            u = u + servo[i, KD] * de
        else:
            u = u + servo[i, KD] * ((e - y[o.last_error + i]) / period)
            integral = select(abs(u) >= servo[i, VMAX], y[o.integral + i], integral)
        y[o.integral + i] = integral
        y[o.last_error + i] = e
        y[o.voltage + i] = _plus(clamp(u, -servo[i, VMAX], servo[i, VMAX]), noise, i, 1)


@inline
def _plus(x, noise, i, k):
    if noise is None:
        return x
    return x + noise[i, k]
