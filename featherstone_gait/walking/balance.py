"""The control law of a gait with feedback, compiled into the run; `feedback` says what it does.

The controller reads the sensors into a delay line, estimates the direction up and where the center of mass is from each
sole, plays the gait at its own time and adds offsets.  All that it knows and remembers is in its memory, whose layout
`BalancedWalk.memory` fills; random numbers too.  Its parts run as Python where another simulator plays the gait.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..core.compile.jit import callable_from_compiled
from ..run.program import controller

# The memory: gains in the order of `Feedback`, numbers, state, tables.
ANKLE, FOOT, HIP_RATE, HASTEN, WAIT, QUIET, HEADING_GAIN = range(7)
GAINS = 7
(
    JOINTS, SAMPLES, SAMPLE, FIRST, LAG, TICK, GRAVITY, SEED, GYROSCOPE, GYROSCOPE_OFFSET, ACCELEROMETER,
    ACCELEROMETER_OFFSET, DELAY, FILTER, SETTLING, FALLING, MASS, ENCODER, LEGS,
) = range(GAINS, GAINS + 19)  # fmt: skip
ROLES = 5  # joints of a leg: roll and pitch of the hip, knee, pitch and roll of the ankle
SIGNS = LEGS + 2 * ROLES  # whether they turn about +x or +y, 1 or -1
MEANS = SIGNS + 2 * ROLES  # of the hips' pitch over a stride [rad]
BODY = MEANS + 2  # of the trunk and all that it carries: mass times center [kg m]
CHAIN = BODY + 3  # of a leg at zero angles: axes, origins, centers of mass (5, 3), masses, the sole's center, half size
CHAIN_LENGTH = 10 * ROLES + 5
OFFSETS = CHAIN + 2 * CHAIN_LENGTH  # of the sensors in this run
UP = OFFSETS + 6  # direction up in the trunk's axes (3,)
RATES = UP + 3  # of the gyroscope, filtered (3,) [rad/s]
HEADING, LEAD, STARTED, COUNT = range(RATES + 3, RATES + 7)  # heading [rad]; by how much the gait is ahead of t [s]
FEET = COUNT + 1  # of left and right sole as the sensors say, upright axes, from the trunk (2, 3) [m]
FROM = FEET + 6  # where the center of mass is from each sole, ahead and aside (2, 2) [m]
SPEED = FROM + 4  # its rate, filtered (2, 2) [m/s]
LOWEST = SPEED + 4  # height of the lowest corner of each sole (2,) [m]
LINE = LOWEST + 2  # the delay line of readings
READING = 6 + 2 * ROLES  # numbers of a reading
LONGEST = 20  # ticks of delay
TABLE = LINE + READING * (LONGEST + 1)  # the gait, and what it does undisturbed
COLUMNS = 6  # of the undisturbed motion: see `feedback.undisturbed`
FADE = 0.5  # time in which feedback fades in [s]
SLOWEST, FASTEST = 0.3, 3.0  # of the gait's time
MOST_RATE = 4.0  # of the lean that counts [rad/s]
MOST_SWEEP = 0.6  # that one leg sweeps farther [-]
MOST_ANKLE, MOST_FOOT = 0.15, 0.4  # offsets [rad]
TOUCHING = 0.004  # by how much a sole is higher that bears nothing [m]


@controller(memory=0)
def balance(t: float, state: Any, reference: np.ndarray, command: np.ndarray, memory: np.ndarray) -> None:
    """Play the gait at its own time, with offsets; its memory is `BalancedWalk.memory`."""
    count, slots = int(memory[COUNT]), int(memory[DELAY]) + 1
    read_sensors(state, memory[LINE + READING * (count % slots) :], memory)
    if count >= slots - 1:
        oldest = memory[LINE + READING * ((count + 1) % slots) :]
        estimate_orientation(oldest, memory)
        locate_center_of_mass(oldest, memory)
    memory[COUNT] += 1.0
    memory[STARTED] = 1.0
    nominal = np.empty(COLUMNS)
    begun = play(t, command, nominal, memory)
    aside = add_offsets(min(t / FADE, 1.0), command, nominal, memory)
    if begun:
        toward = (1.0 - 2.0 * nominal[1]) * aside  # > 0: to where the leg is that swings
        rate = 1.0 + memory[HASTEN] * max(toward, 0.0) + memory[WAIT] * min(toward, 0.0)
        memory[LEAD] += memory[TICK] * (min(max(rate, SLOWEST), FASTEST) - 1.0)


@callable_from_compiled
def read_sensors(state: Any, reading: np.ndarray, memory: np.ndarray) -> None:
    """Read gyroscope, accelerometer and joint angles, with noise and offsets.

    Random numbers of mean 0 and variance 1 are the sum of twelve of the multiplicative generator of Park and Miller.
    """
    started, seed = memory[STARTED] > 0.0, int(memory[SEED])
    w, x, y, z = state.base_q[3], state.base_q[4], state.base_q[5], state.base_q[6]
    a, b, c = state.base_qdd[0], state.base_qdd[1], state.base_qdd[2] + memory[GRAVITY]
    for k in range(3):
        reading[k] = state.base_qd[3 + k]
    reading[3] = (1.0 - 2.0 * (y * y + z * z)) * a + 2.0 * (x * y + w * z) * b + 2.0 * (x * z - w * y) * c
    reading[4] = 2.0 * (x * y - w * z) * a + (1.0 - 2.0 * (x * x + z * z)) * b + 2.0 * (y * z + w * x) * c
    reading[5] = 2.0 * (x * z + w * y) * a + 2.0 * (y * z - w * x) * b + (1.0 - 2.0 * (x * x + y * y)) * c
    for k in range(6 if started else 12):
        drawn = -6.0
        for _ in range(12):
            seed = (seed * 48271) % 2147483647
            drawn += seed / 2147483647.0
        if not started and k < 6:
            memory[OFFSETS + k] = memory[GYROSCOPE_OFFSET if k < 3 else ACCELEROMETER_OFFSET] * drawn
        else:
            reading[k % 6] += memory[OFFSETS + k % 6] + memory[GYROSCOPE if k % 6 < 3 else ACCELEROMETER] * drawn
    memory[SEED] = seed
    for k in range(2 * ROLES):
        angle, step = state.q[int(memory[LEGS + k])], memory[ENCODER]
        reading[6 + k] = step * math.floor(angle / step + 0.5) if step > 0.0 else angle


@callable_from_compiled
def estimate_orientation(reading: np.ndarray, memory: np.ndarray) -> None:
    """Update the direction up in the trunk's axes, the heading and the filtered rates (complementary filter)."""
    tick, arrived = memory[TICK], memory[COUNT] - memory[DELAY] + 1.0
    p, q, r = reading[0], reading[1], reading[2]
    a, b, c = reading[3], reading[4], reading[5]
    size = 1.0 / max(math.sqrt(a * a + b * b + c * c), 1e-9)
    x, y, z = memory[UP], memory[UP + 1], memory[UP + 2]
    share = max(tick / memory[SETTLING], 1.0 / arrived)  # at first the mean of the readings
    nx = x + tick * (y * r - z * q) + share * (a * size - x)
    ny = y + tick * (z * p - x * r) + share * (b * size - y)
    nz = z + tick * (x * q - y * p) + share * (c * size - z)
    length = 1.0 / max(math.sqrt(nx * nx + ny * ny + nz * nz), 1e-9)
    memory[UP], memory[UP + 1], memory[UP + 2] = nx * length, ny * length, nz * length
    memory[HEADING] += tick * (p * nx + q * ny + r * nz) * length
    passed = tick / (tick + memory[FILTER])
    for k in range(3):
        memory[RATES + k] += passed * (reading[k] - memory[RATES + k])


@callable_from_compiled
def locate_center_of_mass(reading: np.ndarray, memory: np.ndarray) -> None:
    """Find the soles and the center of mass from the joint angles, and its rate seen from each sole."""
    upright, rotation, turned = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    shift, sole, center = np.empty(3), np.empty(3), np.empty(3)
    x, y, z = memory[UP], memory[UP + 1], memory[UP + 2]
    size = 1.0 / math.sqrt(max(1.0 - x * x, 1e-9))
    # Axes ahead, aside and up, as rows in the trunk's axes.
    upright[0, 0], upright[0, 1], upright[0, 2] = (1.0 - x * x) * size, -x * y * size, -x * z * size
    upright[1, 0], upright[1, 1], upright[1, 2] = 0.0, z * size, -y * size
    upright[2, 0], upright[2, 1], upright[2, 2] = x, y, z
    for i in range(3):
        center[i] = memory[BODY + i]
    for leg in range(2):
        chain = memory[CHAIN + CHAIN_LENGTH * leg :]
        rotation[:], shift[:] = 0.0, 0.0
        rotation[0, 0] = rotation[1, 1] = rotation[2, 2] = 1.0
        for j in range(ROLES):
            turn_joint(chain, j, reading[6 + ROLES * leg + j], rotation, turned, shift)
            for i in range(3):
                center[i] += chain[9 * ROLES + j] * shift[i]
                for k in range(3):
                    center[i] += chain[9 * ROLES + j] * rotation[i, k] * chain[3 * (2 * ROLES + j) + k]
        end = chain[10 * ROLES :]  # the sole's center and half size
        for i in range(3):
            sole[i] = shift[i] + rotation[i, 0] * end[0] + rotation[i, 1] * end[1] + rotation[i, 2] * end[2]
        for i in range(3):
            memory[FEET + 3 * leg + i] = upright[i, 0] * sole[0] + upright[i, 1] * sole[1] + upright[i, 2] * sole[2]
        memory[LOWEST + leg] = memory[FEET + 3 * leg + 2]
        for k in range(2):
            tilt = upright[2, 0] * rotation[0, k] + upright[2, 1] * rotation[1, k] + upright[2, 2] * rotation[2, k]
            memory[LOWEST + leg] -= abs(tilt) * end[3 + k]
    passed = memory[TICK] / (memory[TICK] + memory[FILTER])
    for leg in range(2):
        for i in range(2):
            k = 2 * leg + i
            now = (upright[i, 0] * center[0] + upright[i, 1] * center[1] + upright[i, 2] * center[2]) / memory[MASS]
            now -= memory[FEET + 3 * leg + i]
            if memory[COUNT] > memory[DELAY]:
                memory[SPEED + k] += passed * ((now - memory[FROM + k]) / memory[TICK] - memory[SPEED + k])
            memory[FROM + k] = now


@callable_from_compiled
def turn_joint(
    chain: np.ndarray, j: int, angle: float, rotation: np.ndarray, turned: np.ndarray, shift: np.ndarray
) -> None:
    """Turn a leg at its joint j (product of exponentials): a point p at zero angles is at rotation p + shift."""
    axis, origin = 3 * j, 3 * (ROLES + j)
    x = rotation[0, 0] * chain[axis] + rotation[0, 1] * chain[axis + 1] + rotation[0, 2] * chain[axis + 2]
    y = rotation[1, 0] * chain[axis] + rotation[1, 1] * chain[axis + 1] + rotation[1, 2] * chain[axis + 2]
    z = rotation[2, 0] * chain[axis] + rotation[2, 1] * chain[axis + 1] + rotation[2, 2] * chain[axis + 2]
    cosine, sine = math.cos(angle), math.sin(angle)
    for k in range(3):  # Rodrigues: columns turned about the axis
        a, b, c = rotation[0, k], rotation[1, k], rotation[2, k]
        along = (1.0 - cosine) * (x * a + y * b + z * c)
        turned[0, k] = cosine * a + sine * (y * c - z * b) + along * x
        turned[1, k] = cosine * b + sine * (z * a - x * c) + along * y
        turned[2, k] = cosine * c + sine * (x * b - y * a) + along * z
    for i in range(3):
        for k in range(3):
            shift[i] += (rotation[i, k] - turned[i, k]) * chain[origin + k]
            rotation[i, k] = turned[i, k]


@callable_from_compiled
def play(t: float, command: np.ndarray, nominal: np.ndarray, memory: np.ndarray) -> bool:
    """Command the gait at its own time, and look up what it does undisturbed; return whether the start is over."""
    joints, samples, first = int(memory[JOINTS]), int(memory[SAMPLES]), int(memory[FIRST])
    width = joints + COLUMNS
    phase = max(t - memory[LAG], 0.0) / memory[SAMPLE] + memory[LEAD] / memory[SAMPLE]
    k = math.floor(phase + 1e-9)
    s = max(phase - k, 0.0)
    low = TABLE + width * (k if k < first else first + (k - first) % samples)
    high = TABLE + width * (k + 1 if k + 1 < first else first + (k + 1 - first) % samples)
    for j in range(joints):
        a, b = memory[low + j], memory[high + j]
        command[j, 0], command[j, 1] = a + s * (b - a), (b - a) / memory[SAMPLE]
    for j in range(COLUMNS):
        nominal[j] = (1.0 - s) * memory[low + joints + j] + s * memory[high + joints + j]
    return phase >= first


@callable_from_compiled
def add_offsets(fade: float, command: np.ndarray, nominal: np.ndarray, memory: np.ndarray) -> float:
    """Add offsets of hips and ankles to the command; return by how much the capture point is off aside [m]."""
    pitch_rate = fade * min(max(memory[RATES + 1] - nominal[0], -MOST_RATE), MOST_RATE)
    on_left = min(max(0.5 + 0.5 * (memory[LOWEST + 1] - memory[LOWEST]) / TOUCHING, 0.0), 1.0)
    ahead = aside = 0.0
    for leg in range(2):
        bears, k = on_left if leg == 0 else 1.0 - on_left, 2 * leg
        ahead += fade * bears * (memory[FROM + k] + memory[FALLING] * memory[SPEED + k] - nominal[2 + k])
        aside += fade * bears * (memory[FROM + k + 1] + memory[FALLING] * memory[SPEED + k + 1] - nominal[3 + k])
    quiet = memory[QUIET]
    ahead, aside = ahead - min(max(ahead, -quiet), quiet), aside - min(max(aside, -quiet), quiet)
    ankle = min(max(memory[ANKLE] * ahead, -MOST_ANKLE), MOST_ANKLE)
    foot = -min(max(memory[FOOT] * ahead, -MOST_FOOT), MOST_FOOT)
    farther = min(max(fade * memory[HEADING_GAIN] * memory[HEADING], -MOST_SWEEP), MOST_SWEEP)
    for leg in range(2):
        bears = nominal[1] if leg == 0 else 1.0 - nominal[1]
        swings, joint, sign = 1.0 - bears, LEGS + ROLES * leg, SIGNS + ROLES * leg
        hip, below = int(memory[joint + 1]), int(memory[joint + 3])
        sweep = (1.0 - 2.0 * leg) * farther * (command[hip, 0] - memory[MEANS + leg]) * memory[sign + 1]
        command[hip, 0] += memory[sign + 1] * (bears * memory[HIP_RATE] * pitch_rate + swings * foot + sweep)
        command[below, 0] += memory[sign + 3] * (bears * ankle - swings * foot - sweep)
    return aside
