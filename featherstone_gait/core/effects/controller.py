"""The servo's controller, sampled: once a tick a voltage from the angle and the filtered speed.

The laws are those of SimTwo (P33a/SimTwo, 2012), with sums and differences made independent of the period:

    state         u = Kp e + Kd (wref - f) + Ki integral(e) + Kf ref
    pid_position  u = Kp e + Ki integral(e) + Kd de/dt + Kf ref
    pid_speed     the same of the speed error wref - f

with e = ref - angle.  The two PID laws stop integrating while the voltage is at its limit.  What firmware adds to them
is in `firmware.py`, and what a source makes of the voltages in `supply.py`.
"""

from ..compile.by_type import overridable
from ..compile.jit import inline, kernel
from ..compile.lanes import clamp, select
from ..compile.structure import record
from .actuator import controller_of
from .decay import FILTER_DECAY
from .firmware import ROUND, beyond_margin, goal_and_rate, in_counts, issue, largest, short_way, with_punch
from .motor_stage import FILTER, MotorStage
from .supply import feed

STATE_FEEDBACK = 0
PID_POSITION = 1
PID_SPEED = 2
CONTROLLER = record(
    law=int,  # one of these
    Kp=float,  # [V/rad], of PID_SPEED [V s/rad] ...
    Ki=float,
    Kd=float,
    Kf=float,
    voltage_limit=float,  # [V]
    encoder_resolution=float,  # [rad], 0 = exact
    speed_filter=float,  # time constant [s]
)


@inline
def quantized(angle, resolution):
    """Return the angle as an encoder of that resolution reads it: the nearest count [rad]."""
    if_exact = resolution <= 0.0
    counts = (angle / select(if_exact, 1.0 + 0.0 * resolution, resolution) + ROUND) - ROUND
    return select(if_exact, angle, counts * resolution)


@kernel
def control_tick(controller, delay, scene, offsets, reference, noise, y, period):
    """Work out the voltages [V]; reference (n, 2) angle [rad] and rate [rad/s]; period since the last tick [s].

    noise (n, 2) is added to the angle that the encoder sees [rad] and to the voltage [V]; None: there is none.
    """
    firmware = scene.firmware
    apply_delayed(delay, scene, offsets, y, 0)
    for i in range(len(controller)):
        c = controller[i]
        angle = quantized(_plus(y[offsets.q + i], noise, i, 0), c.encoder_resolution)
        goal, rate = goal_and_rate(firmware.profile, firmware.wrap, offsets, reference, y, i, period)
        e = short_way(firmware.wrap, goal - angle, i)
        de = rate - select(c.speed_filter > 0.0, y[offsets.filtered_speed + i], y[offsets.qd + i])
        if c.law == PID_SPEED:
            e = de
        e = beyond_margin(firmware.band, e, i)
        integral = y[offsets.integral + i] + e * period
        u = c.Kp * e + c.Ki * integral + c.Kf * goal
        limit = largest(firmware.pwm, c, i)
        if c.law == STATE_FEEDBACK:
            u = with_punch(firmware.band, u + c.Kd * de, e, i)
        else:
            change = short_way(firmware.wrap, e - y[offsets.last_error + i], i)
            u = with_punch(firmware.band, u + c.Kd * (change / period), e, i)
            integral = select(abs(u) >= limit, y[offsets.integral + i], integral)
        y[offsets.integral + i] = integral
        y[offsets.last_error + i] = e
        u = in_counts(firmware.pwm, c, clamp(u, -limit, limit), i)
        issue(delay, offsets, y, i, len(controller), _plus(u, noise, i, 1))
    if delay is None:
        feed(scene.supply, scene.actuator, offsets, y)


@inline
def apply_delayed(delay, scene, offsets, y, since):
    """Apply what was worked out a delay ago, if it is due `since` steps after a tick."""
    if delay is not None:
        if delay.shift == since:
            n = len(controller_of(scene.actuator))
            for i in range(n):
                y[offsets.voltage + i] = y[offsets.delayed + i]
            for i in range((delay.slots - 1) * n):  # the others move up
                y[offsets.delayed + i] = y[offsets.delayed + n + i]
            feed(scene.supply, scene.actuator, offsets, y)


@inline
def _plus(x, noise, i, k):
    if noise is None:
        return x
    return x + noise[i, k]


@inline
def filter_speed(controller, step, i):
    """Move the filtered speed to the end of the step."""
    if controller is not None:
        y, offsets = step.y, step.offsets
        y[offsets.filtered_speed + i] = y[offsets.qd + i] + filter_left(step.decay, i) * (
            y[offsets.filtered_speed + i] - y[offsets.qd + i]
        )


@overridable
def filter_left(decay, i):
    """Return the share of a filtered speed's deviation that is left after the step [-]."""
    return decay[i, FILTER_DECAY]


filter_left.of(MotorStage)(lambda decay, i: decay.table[i, FILTER])


@inline
def filter_rate(controller, step, i, v):
    """Return the rate of the filtered speed [rad/s^2]."""
    time = controller[i].speed_filter
    filtered = time > 0.0
    return select(
        filtered, (v - step.y[step.offsets.filtered_speed + i]) / select(filtered, time, 1.0 + 0.0 * v), 0.0 * v
    )
