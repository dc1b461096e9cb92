"""Follow the line of the track with seven spots on the floor under the robot."""

import math

from featherstone_gait import controller

# The track: two straights of 0.8 m along x, joined by half circles of 0.4 m radius, of dark tape on a bright floor.
HALF, BEND, WIDTH = 0.4, 0.4, 0.02  # [m]
SPOTS, SPACING, RADIUS = 7, 0.01, 0.005  # [m]
AHEAD = 0.06  # of the axles [m]
SPEED = 0.1  # [m/s]
STEER = 25.0  # [rad/s/m] angular velocity by the distance of the line from the middle spot
WHEEL, TRACK = 0.033, 0.16  # radius and distance of the wheels [m]


@controller(memory=SPOTS + 1)
def follow(t, state, reference, command, memory):
    """Steer to the middle of what is dark; memory: readings of the spots from right to left, last offset [m]."""
    x, y = state.base_q[0], state.base_q[1]
    w, q1, q2, q3 = state.base_q[3], state.base_q[4], state.base_q[5], state.base_q[6]
    heading = math.atan2(2.0 * (w * q3 + q1 * q2), 1.0 - 2.0 * (q2 * q2 + q3 * q3))
    c, s = math.cos(heading), math.sin(heading)
    moment, total = 0.0, 0.0
    for k in range(SPOTS):
        left = (k - (SPOTS - 1) // 2) * SPACING
        px, py = x + AHEAD * c - left * s, y + AHEAD * s + left * c
        away = math.hypot(px - min(max(px, -HALF), HALF), py) - BEND  # from the middle of the tape, outwards
        dark = 0.0
        for edge, sign in ((-WIDTH / 2, 1.0), (WIDTH / 2, -1.0)):
            # the share of a disc beyond a straight edge, from there outwards
            reach = min(max((edge - away) / RADIUS, -1.0), 1.0)
            dark += sign * (math.acos(reach) - reach * math.sqrt(1.0 - reach * reach)) / math.pi
        memory[k] = dark
        moment += dark * left
        total += dark
    if total > 0.01:
        memory[SPOTS] = moment / total
    turn = STEER * memory[SPOTS]
    command[0, 1] = (SPEED - 0.5 * TRACK * turn) / WHEEL
    command[1, 1] = (SPEED + 0.5 * TRACK * turn) / WHEEL
