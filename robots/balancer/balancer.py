"""Balance the robot of this folder, by the voltages of its motors."""

import math

from featherstone_gait import controller

RADIUS = 0.04  # of a wheel [m]
# Linear-quadratic regulator of the linear model, sampled every 5 ms, whose weights are 100/m^2, 10/rad^2, 1 and 1 of
# the speeds, and 0.1/V^2.  Its closed loop has the poles -213, -3.0 +- 2.7i and -3.8 1/s.
PLACE = 21.2  # [V/m]
PITCH = 26.7  # [V/rad]
SPEED = 19.9  # [V s/m]
PITCH_RATE = 3.6  # [V s/rad]
TURN, TURN_RATE = 2.0, 0.2  # of the difference of the wheels [V/rad, V s/rad], chosen


@controller(writes="voltage")
def balance(t, state, reference, command, memory):
    """Follow the angles of the wheels in the reference: their mean is the way, their difference the turn."""
    w, x, y, z = state.base_q[3], state.base_q[4], state.base_q[5], state.base_q[6]
    pitch = math.asin(2.0 * (w * y - x * z))
    rate = state.base_qd[4]
    angle, speed = 0.5 * (state.q[0] + state.q[1]), 0.5 * (state.qd[0] + state.qd[1])
    goal, goal_rate = 0.5 * (reference[0, 0] + reference[1, 0]), 0.5 * (reference[0, 1] + reference[1, 1])
    both = PLACE * RADIUS * (angle + pitch - goal) + SPEED * RADIUS * (speed + rate - goal_rate)
    both += PITCH * pitch + PITCH_RATE * rate
    for i in range(2):
        own = TURN * (state.q[i] - angle - reference[i, 0] + goal)
        own += TURN_RATE * (state.qd[i] - speed - reference[i, 1] + goal_rate)
        command[i, 0] = both - own
