"""Walking with feedback: a gait's offsets and its timing from what a gyroscope and an accelerometer on the trunk tell.

    walk = balanced(cost, gait, Feedback(foot_pitch_rate=0.1))
    simulate(cost.scene, walk.end(20), walk.state(cost.scene), walk.reference(20), controller=walk.controller(scene))

Lean and its rate are compared with those that the gait has at this phase where nothing disturbs it, so that feedback
costs nothing on the flat.  What differs, about the trunk's y (pitch, > 0: forwards) and x (roll, > 0: to the right),
moves the servos' references:

    ankle of the leg that bears        + (P lean + D rate)    presses the sole down where the robot falls to
    hip of the leg that bears          + (P lean + D rate)    sets the trunk upright
    hip of the leg that swings         - (P lean + D rate)    puts the foot where the robot falls to, its sole level
    time                               runs faster where it falls towards the leg that swings, slower away from it

Of lean + rate / w, w = sqrt(g / h), which is where the robot would come to rest as an inverted pendulum of its height h
(the capture point of J. Pratt et al., "Capture point: a step toward humanoid push recovery", Humanoids 2006), what is
beyond `QUIET` has gains of its own: strong ones, which would disturb the walk if they acted all the time.  These are
the strategies of ankle, hip and step of F. Horak, L. Nashner, "Central programming of postural movements", J.
Neurophysiology 55 (1986); that a step goes to where the lean says is of M. Raibert, "Legged Robots That Balance" (MIT
Press 1986), chapter 2.  The integral of the lean, in pitch, levels a slope.  A heading that is off makes one leg
sweep farther than the other.  How much of the weight a leg bears is that of the undisturbed gait at this phase:
nothing but the gyroscope and the accelerometer is read.

The sensors have noise, offsets and delay.  The direction up is that of the gyroscope's integral, drawn to the
accelerometer's over `Imu.settling` (the complementary filter of R. Mahony, T. Hamel, J.-M. Pflimlin, IEEE Trans.
Automatic Control 53 (2008)), heading the integral alone, which drifts as the gyroscope's offset says.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..arguments import finite, instance, real, whole
from ..arguments import path as path_of
from ..build.contact import standing_posture
from ..build.scene import CompiledScene
from ..files import FilePath, complete, read_arrays
from ..model import Model
from ..reference import Reference
from ..run.program import SEEN, CompiledController, State, controller
from ..run.simulate import simulate_batch, standing_state
from ..trajectory import Trajectory
from .gait import Mirror
from .gait_file import ARRAYS
from .inverse_kinematics import leg_joints
from .kinematics import joint_axes, link_poses
from .motion import Motion, read_motion

ALONG = 0.9  # of an axis along x or y: the joint is one of roll or pitch
LARGEST = 100.0  # gain
MOST_DELAY = 0.2  # [s]
NOMINAL_STRIDES = 8  # over which the undisturbed motion is averaged, after two
LEAN, RATE, SHARE = 0, 2, 4  # columns of the undisturbed motion: roll and pitch, their rates, the left leg's load


def _gain(what: str, unit: str) -> Any:
    return field(default=0.0, metadata={"what": what, "unit": unit})


@dataclass(frozen=True)
class Feedback:
    """Gains; all zero: the gait is played as it is."""

    ankle_pitch: float = _gain("ankle of the leg that bears, by lean", "rad/rad")
    ankle_pitch_rate: float = _gain("... by its rate", "s")
    hip_pitch: float = _gain("hip of the leg that bears, by lean", "rad/rad")
    hip_pitch_rate: float = _gain("... by its rate", "s")
    foot_pitch: float = _gain("hip of the leg that swings, by lean", "rad/rad")
    foot_pitch_rate: float = _gain("... by its rate", "s")
    level: float = _gain("both ankles, by the integral of lean ahead", "1/s")
    ankle_roll: float = _gain("as ankle_pitch, sideways", "rad/rad")
    ankle_roll_rate: float = _gain("... by its rate", "s")
    hip_roll: float = _gain("as hip_pitch, sideways", "rad/rad")
    hip_roll_rate: float = _gain("... by its rate", "s")
    foot_roll: float = _gain("as foot_pitch, sideways", "rad/rad")
    foot_roll_rate: float = _gain("... by its rate", "s")
    time_roll: float = _gain("how much faster time runs, by lean towards the leg that swings", "1/rad")
    time_roll_rate: float = _gain("... by its rate", "s/rad")
    heading: float = _gain("how much farther one leg sweeps, by what heading is off", "1/rad")
    caught_ankle_pitch: float = _gain("as ankle_pitch, by how far the robot is beyond `QUIET`", "rad/rad")
    caught_hip_pitch: float = _gain("as hip_pitch, likewise", "rad/rad")
    caught_foot_pitch: float = _gain("as foot_pitch, likewise", "rad/rad")
    caught_ankle_roll: float = _gain("as ankle_roll, likewise", "rad/rad")
    caught_hip_roll: float = _gain("as hip_roll, likewise", "rad/rad")
    caught_foot_roll: float = _gain("as foot_roll, likewise", "rad/rad")
    caught_time: float = _gain("as time_roll, likewise", "1/rad")

    def __post_init__(self) -> None:
        for one in fields(self):
            value = real(f"feedback: {one.name}", getattr(self, one.name), -LARGEST, LARGEST, "0 is no feedback")
            object.__setattr__(self, one.name, value)

    def to_vector(self) -> np.ndarray:
        """The gains (23,) in their order."""
        return np.array([getattr(self, one.name) for one in fields(self)])


def feedback_of(gains: ArrayLike) -> Feedback:
    """The inverse of `Feedback.to_vector`."""
    return Feedback(*finite("gains", gains, (len(fields(Feedback)),)).tolist())


@dataclass(frozen=True)
class Imu:
    """Gyroscope and accelerometer of the trunk, read at each tick of the servos' controllers.

    Noise by default as of an MPU-6050 with its filter at 100 Hz (InvenSense, MPU-6000/6050 product specification, rev.
    3.4, section 6: 0.05 deg/s rms; 400 ug/sqrt(Hz)); its offset is what remains after it has been zeroed at rest.
    """

    gyroscope_noise: float = math.radians(0.05)  # standard deviation of each reading [rad/s]
    gyroscope_offset: float = math.radians(0.05)  # standard deviation, one draw an axis and run [rad/s]
    accelerometer_noise: float = 0.04  # standard deviation of each reading [m/s^2]
    accelerometer_offset: float = 0.1  # standard deviation, one draw an axis and run [m/s^2]
    delay: float = 0.02  # from a reading to what is sent to the servos for it, whole ticks [s]
    filter: float = 0.01  # time constant of the first-order low-pass behind the gyroscope [s]
    settling: float = 2.0  # in which the direction up is drawn to the accelerometer's [s]

    def __post_init__(self) -> None:
        for one in fields(self):
            low, high = (1e-2, 1e3) if one.name == "settling" else (0.0, MOST_DELAY if one.name == "delay" else 1e3)
            value = real(f"imu: {one.name}", getattr(self, one.name), low, high, "give it in SI units")
            object.__setattr__(self, one.name, value)


NONE, SENSORS = Feedback(), Imu()

# The controller's memory: gains, numbers, what it remembers, tables.
GAINS = len(fields(Feedback))
(
    JOINTS, SAMPLES, SAMPLE, FIRST, LAG, TICK, GRAVITY, SEED, GYROSCOPE, GYROSCOPE_OFFSET, ACCELEROMETER,
    ACCELEROMETER_OFFSET, DELAY, FILTER, SETTLING, FALLING, LEGS,
) = range(GAINS, GAINS + 17)  # fmt: skip
ROLES = 5  # of a leg: columns of roll and pitch of the hip, knee, pitch and roll of the ankle; -1: it has none
SIGNS = LEGS + 2 * ROLES  # whether they turn about +x or +y, 1 or -1
MEANS = SIGNS + 2 * ROLES  # of the hips' pitch over a stride [rad]
OFFSETS = MEANS + 2  # of the sensors in this run
UP = OFFSETS + 6
FILTERED = UP + 3
TURNED, AHEAD, TILTED, BEGUN, COUNT = range(FILTERED + 3, FILTERED + 8)
LINE = COUNT + 1  # what the sensors read, as long as it is under way
LONGEST = 20  # ticks of delay
TABLE = LINE + 6 * (LONGEST + 1)
QUIET = 0.1  # of lean and rate by the time in which the robot falls, up to which it is not caught [rad]
FADE = 0.5  # in which feedback begins to act [s]
SLOWEST, FASTEST = 0.5, 1.6  # of the gait's time
MOST_LEAN, MOST_RATE = 0.5, 4.0  # that count [rad, rad/s]
MOST_TILT = 0.15  # that the integral of the lean adds to the ankles [rad]
MOST_SWEEP = 0.6  # that one leg sweeps farther [-]


@controller(memory=0)
def balance(t: float, state: Any, reference: np.ndarray, command: np.ndarray, memory: np.ndarray) -> None:
    """The gait at its own time, with offsets; its memory is `BalancedWalk.memory`.

    One function without others: the same in Python, where another simulator plays the gait, and compiled.
    """
    # What the sensors read, noise and all, goes into a line; random numbers of mean 0 and variance 1 are the sum of
    # twelve of the multiplicative generator of Park and Miller.
    begun = memory[BEGUN] > 0.0
    count, slots, tick = int(memory[COUNT]), int(memory[DELAY]) + 1, memory[TICK]
    at, seed = LINE + 6 * (count % slots), int(memory[SEED])
    w, x, y, z = state.base_q[3], state.base_q[4], state.base_q[5], state.base_q[6]
    a, b, c = state.base_qdd[0], state.base_qdd[1], state.base_qdd[2] + memory[GRAVITY]
    for k in range(3):
        memory[at + k] = state.base_qd[3 + k]
    memory[at + 3] = (1.0 - 2.0 * (y * y + z * z)) * a + 2.0 * (x * y + w * z) * b + 2.0 * (x * z - w * y) * c
    memory[at + 4] = 2.0 * (x * y - w * z) * a + (1.0 - 2.0 * (x * x + z * z)) * b + 2.0 * (y * z + w * x) * c
    memory[at + 5] = 2.0 * (x * z + w * y) * a + 2.0 * (y * z - w * x) * b + (1.0 - 2.0 * (x * x + y * y)) * c
    for k in range(12 if not begun else 6):
        drawn = -6.0
        for _ in range(12):
            seed = (seed * 48271) % 2147483647
            drawn += seed / 2147483647.0
        if not begun and k < 6:
            memory[OFFSETS + k] = memory[GYROSCOPE_OFFSET if k < 3 else ACCELEROMETER_OFFSET] * drawn
        else:
            memory[at + k % 6] += memory[OFFSETS + k % 6] + memory[GYROSCOPE if k % 6 < 3 else ACCELEROMETER] * drawn
    memory[SEED] = seed
    # Direction up in the trunk's axes, heading and filtered rates, from the oldest reading in the line.
    if count >= slots - 1:
        at = LINE + 6 * ((count + 1) % slots)
        p, q, r = memory[at], memory[at + 1], memory[at + 2]
        a, b, c = memory[at + 3], memory[at + 4], memory[at + 5]
        size = 1.0 / max(math.sqrt(a * a + b * b + c * c), 1e-9)
        x, y, z = memory[UP], memory[UP + 1], memory[UP + 2]
        share = max(tick / memory[SETTLING], 1.0 / (count - slots + 2))  # at first the mean of what has arrived
        nx = x + tick * (y * r - z * q) + share * (a * size - x)
        ny = y + tick * (z * p - x * r) + share * (b * size - y)
        nz = z + tick * (x * q - y * p) + share * (c * size - z)
        length = 1.0 / max(math.sqrt(nx * nx + ny * ny + nz * nz), 1e-9)
        memory[UP], memory[UP + 1], memory[UP + 2] = nx * length, ny * length, nz * length
        memory[TURNED] += tick * (p * nx + q * ny + r * nz) * length
        passed = tick / (tick + memory[FILTER])
        for k in range(3):
            memory[FILTERED + k] += passed * (memory[at + k] - memory[FILTERED + k])
    memory[COUNT] += 1.0
    memory[BEGUN] = 1.0
    # The gait at its own time, by memory[AHEAD] ahead of the clock [s]: rows of the start, then of the stride.
    joints, samples, first = int(memory[JOINTS]), int(memory[SAMPLES]), int(memory[FIRST])
    width = joints + 5
    phase = max(t - memory[LAG], 0.0) / memory[SAMPLE] + memory[AHEAD] / memory[SAMPLE]
    k = math.floor(phase + 1e-9)
    s = max(phase - k, 0.0)
    low = k if k < first else first + (k - first) % samples
    high = k + 1 if k + 1 < first else first + (k + 1 - first) % samples
    low, high = TABLE + width * low, TABLE + width * high
    for j in range(joints):
        a, b = memory[low + j], memory[high + j]
        command[j, 0], command[j, 1] = a + s * (b - a), (b - a) / memory[SAMPLE]
    # What is off, fading in.
    fade = min(t / FADE, 1.0)
    low, high, rest = low + joints, high + joints, 1.0 - s
    roll = memory[UP + 1] - rest * memory[low] - s * memory[high]
    pitch = -memory[UP] - rest * memory[low + 1] - s * memory[high + 1]
    roll_rate = memory[FILTERED] - rest * memory[low + 2] - s * memory[high + 2]
    pitch_rate = memory[FILTERED + 1] - rest * memory[low + 3] - s * memory[high + 3]
    left = rest * memory[low + 4] + s * memory[high + 4]
    roll, pitch = fade * min(max(roll, -MOST_LEAN), MOST_LEAN), fade * min(max(pitch, -MOST_LEAN), MOST_LEAN)
    roll_rate = fade * min(max(roll_rate, -MOST_RATE), MOST_RATE)
    pitch_rate = fade * min(max(pitch_rate, -MOST_RATE), MOST_RATE)
    # Offsets, the gains in the order of `Feedback`.
    memory[TILTED] = min(max(memory[TILTED] + tick * memory[6] * pitch, -MOST_TILT), MOST_TILT)
    ahead, aside = pitch + memory[FALLING] * pitch_rate, roll + memory[FALLING] * roll_rate
    ahead, aside = ahead - min(max(ahead, -QUIET), QUIET), aside - min(max(aside, -QUIET), QUIET)
    ankle_pitch = memory[0] * pitch + memory[1] * pitch_rate + memory[16] * ahead
    hip_pitch = memory[2] * pitch + memory[3] * pitch_rate + memory[17] * ahead
    foot_pitch = -memory[4] * pitch - memory[5] * pitch_rate - memory[18] * ahead
    ankle_roll = memory[7] * roll + memory[8] * roll_rate + memory[19] * aside
    hip_roll = memory[9] * roll + memory[10] * roll_rate + memory[20] * aside
    foot_roll = -memory[11] * roll - memory[12] * roll_rate - memory[21] * aside
    farther = min(max(fade * memory[15] * memory[TURNED], -MOST_SWEEP), MOST_SWEEP)
    for leg in range(2):
        bears = left if leg == 0 else 1.0 - left
        swings, at, sign = 1.0 - bears, LEGS + ROLES * leg, SIGNS + ROLES * leg
        hip = int(memory[at + 1])
        sweep = (1.0 - 2.0 * leg) * farther * (command[hip, 0] - memory[MEANS + leg]) * memory[sign + 1]
        command[int(memory[at]), 0] += memory[sign] * (bears * hip_roll + swings * foot_roll)
        command[hip, 0] += memory[sign + 1] * (bears * hip_pitch + swings * foot_pitch + sweep)
        level = memory[TILTED] - swings * foot_pitch - sweep
        command[int(memory[at + 3]), 0] += memory[sign + 3] * (bears * ankle_pitch + level)
        command[int(memory[at + 4]), 0] += memory[sign + 4] * (bears * ankle_roll - swings * foot_roll)
    if k < first:
        return
    rate = 1.0 + (2.0 * left - 1.0) * (memory[13] * roll + memory[14] * roll_rate + memory[22] * aside)
    memory[AHEAD] += tick * (min(max(rate, SLOWEST), FASTEST) - 1.0)


@dataclass(frozen=True, eq=False)
class BalancedWalk:
    """A gait with feedback; made by `balanced`."""

    motion: Motion
    feedback: Feedback
    imu: Imu
    undisturbed: np.ndarray  # (samples of start and stride, 5): roll, pitch [rad], rates [rad/s], left leg's load [-]

    def controller(self, scene: CompiledScene, seed: int = 0) -> CompiledController:
        """What `simulate(..., controller=it)` takes for this scene; seed: of the sensors' noise and offsets."""
        return balance.beginning_with(self.memory(scene, seed))

    def memory(self, scene: CompiledScene, seed: int = 0) -> np.ndarray:
        """What the controller's memory begins with."""
        instance("scene", scene, CompiledScene, "give what compile_scene returns")
        seed = whole("seed", seed, 0, "it is the seed of the sensors' noise", 2**31 - 3)
        motion, imu, tick = self.motion, self.imu, scene.tick_steps * scene.timestep
        columns, signs = legs_of(scene.model)
        delay = round(imu.delay / tick)
        if abs(delay * tick - imu.delay) > 1e-9 or delay > LONGEST:
            raise ValueError(f"imu: delay is {imu.delay:g} s; give whole ticks of {tick:g} s, at most {LONGEST}")
        memory = np.zeros(TABLE)
        memory[:GAINS] = self.feedback.to_vector()
        memory[JOINTS:LEGS] = (
            len(motion.joint_names), len(motion.stride), motion.tick, len(motion.start), scene.lag, tick,
            math.hypot(*scene.gravity), seed + 1,
            imu.gyroscope_noise, imu.gyroscope_offset, imu.accelerometer_noise, imu.accelerometer_offset, delay,
            imu.filter, imu.settling, math.sqrt(standing_posture(scene.model)[0] / math.hypot(*scene.gravity)),
        )  # fmt: skip
        memory[LEGS:SIGNS], memory[SIGNS:MEANS] = columns.ravel(), signs.ravel()
        memory[MEANS:OFFSETS] = motion.stride[:, columns[:, 1]].mean(axis=0)
        played = np.concatenate([motion.start, motion.stride])
        return np.concatenate([memory, np.hstack([played, self.undisturbed]).ravel()])

    def reference(self, strides: int) -> Reference:
        """The start and `strides` strides: what is played without feedback."""
        return self.motion.reference(strides)

    def begin(self, strides: int) -> float:
        """When so many strides are over, without feedback [s]."""
        return self.motion.begin(strides)

    def digest(self) -> str:
        """A hash of all of it."""
        found = hashlib.sha256(f"{self.motion.digest()} {self.feedback} {self.imu}".encode())
        found.update(np.ascontiguousarray(self.undisturbed, dtype="<f8").tobytes())
        return found.hexdigest()

    def arrays(self) -> dict[str, np.ndarray]:
        """What a gait's .npz holds besides the gait."""
        imu = np.array([getattr(self.imu, one.name) for one in fields(Imu)])
        return {"feedback": self.feedback.to_vector(), "imu": imu, "undisturbed": self.undisturbed}


def add_feedback(path: FilePath, walk: BalancedWalk) -> None:
    """Put feedback into a gait's .npz, as `read_walk` reads it; raises ValueError for a file of another gait."""
    instance("walk", walk, BalancedWalk, "give what balanced returns")
    arrays = read_arrays(path_of("path", path), ARRAYS)
    if read_motion(path, walk.motion.joint_names).digest() != walk.motion.digest():
        raise ValueError(f"{path}: its gait is another than that of the feedback; write the feedback of this gait")
    with complete(path) as temporary, open(temporary, "wb") as file:
        kept: dict[str, Any] = {"format": np.array(str(ARRAYS))} | arrays | walk.arrays()
        np.savez_compressed(file, **kept)


def read_walk(path: FilePath, joint_names: Sequence[str] | None = None) -> Motion | BalancedWalk:
    """Read a gait as `read_motion` does, with its feedback where the file has some; raises as that does."""
    motion = read_motion(path, joint_names)
    arrays = read_arrays(path_of("path", path), ARRAYS) if path_of("path", path).suffix == ".npz" else {}
    if "feedback" not in arrays:
        return motion
    missing = {"imu", "undisturbed"} - arrays.keys()
    shape = (len(motion.start) + len(motion.stride), 5)
    if missing or arrays["undisturbed"].shape != shape or not np.isfinite(arrays["undisturbed"]).all():
        raise ValueError(f"{path}: its feedback lacks imu and undisturbed {shape}; write it with add_feedback")
    try:
        imu = Imu(*finite("imu", arrays["imu"], (len(fields(Imu)),)).tolist())
        return BalancedWalk(motion, feedback_of(arrays["feedback"]), imu, arrays["undisturbed"])
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def legs_of(model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Columns (2, 5) of a biped's joints, left leg first, and signs (2, 5); in the order of `ROLES`.

    Raises ValueError for a robot without two legs that have hips and ankles of roll and pitch.
    """
    feet = list(dict.fromkeys(point.link for point in model.contacts))
    poses = link_poses(model, np.zeros(len(model.joint_names)))
    axes = joint_axes(model, poses)[0]
    if len(feet) != 2:
        on = ", ".join(feet) or "none"
        raise ValueError(f"{model.name}: feedback is for two legs; its contact points are on {on}")
    found = []
    for foot in feet:
        columns = leg_joints(model, foot)
        roll = [j for j in columns if abs(axes[j][0]) > ALONG]
        pitch = [j for j in columns if abs(axes[j][1]) > ALONG]
        if len(roll) < 2 or len(pitch) < 3:
            raise ValueError(
                f"{model.name}: feedback moves roll and pitch of hips and ankles; the leg of {foot} has "
                f"{len(roll)} joints of roll and {len(pitch)} of pitch, of 2 and 3"
            )
        found.append((roll[0], pitch[0], pitch[1], pitch[-1], roll[-1]))
    side = [float(poses.position[0, [link.name for link in model.links].index(foot), 1]) for foot in feet]
    if side[0] < side[1]:
        found.reverse()
    signs = np.array([[np.sign(axes[j][k]) for j, k in zip(row, (0, 1, 1, 1, 0))] for row in found])
    return np.array(found), signs


def balanced(
    scene: CompiledScene,
    motion: Motion,
    feedback: Feedback | Sequence[float] = NONE,
    imu: Imu = SENSORS,
    mirror: Mirror | None = None,
) -> BalancedWalk:
    """The motion with feedback about what its trunk does on the flat, where it must walk.

    mirror: of a gait whose second half is its first half mirrored; the trunk's motion is then taken to be so too.
    Raises ValueError for a robot that is no biped, and for a motion that falls on the scene's ground.
    """
    instance("scene", scene, CompiledScene, "give what compile_scene returns")
    instance("motion", motion, Motion, "give what motion_of or read_motion returns")
    feedback = feedback if isinstance(feedback, Feedback) else feedback_of(feedback)
    legs_of(scene.model)
    (table,) = undisturbed_of(scene, [motion], imu, mirror is not None)
    if table is None:
        raise ValueError(f"{scene.model.name}: the motion falls on the scene's ground; give one that walks by itself")
    return BalancedWalk(motion, feedback, imu, table)


def undisturbed_of(
    scene: CompiledScene, motions: Sequence[Motion], imu: Imu, mirrored: bool
) -> list[np.ndarray | None]:
    """What motions that begin alike do undisturbed, as `BalancedWalk` takes it; None for one that falls.

    mirrored: the second half of a stride is taken to be the first one mirrored.
    """
    strides = 2 + NOMINAL_STRIDES
    signals = [motion.reference(strides) for motion in motions]
    states = [standing_state(scene, signal.values[0], beyond_limits=True) for signal in signals]
    runs = simulate_batch(
        [scene] * len(motions), motions[0].begin(strides), states, signals,
        record=("base_q", "base_qd", "base_qdd", "contact_force"), estimate_error=False,
    )  # fmt: skip
    return [
        undisturbed(scene, motion, run, imu, mirrored) if run.ok else None for motion, run in zip(motions, runs)
    ]


def undisturbed(scene: CompiledScene, motion: Motion, run: Trajectory, imu: Imu, mirrored: bool) -> np.ndarray:
    """What `BalancedWalk` compares with: the same sensors and estimates, without noise, on average.

    run: the motion after its start, without feedback, of at least two strides more than are averaged, a record a tick.
    """
    still = replace(
        imu, gyroscope_noise=0.0, gyroscope_offset=0.0, accelerometer_noise=0.0, accelerometer_offset=0.0
    )  # fmt: skip
    zeros = np.zeros((len(motion.start) + len(motion.stride), 5))
    memory = BalancedWalk(motion, Feedback(), still, zeros).memory(scene)
    force = run["contact_force"][:, :, 0]
    feet = [point.link for point in scene.model.contacts]
    columns, _ = legs_of(scene.model)
    left_foot = next(foot for foot in feet if columns[0, 0] in leg_joints(scene.model, foot))
    on_left = force[:, [foot == left_foot for foot in feet]].sum(axis=1)
    share = on_left / np.maximum(force.sum(axis=1), 1e-9)
    tick = scene.tick_steps * scene.timestep
    found = np.empty((len(share), 5))
    command = np.zeros((scene.tree.n, 2))
    none = dict.fromkeys(SEEN, np.empty(0))
    for k in range(len(share)):
        state = State(**none | {name: run[name][k] for name in ("base_q", "base_qd", "base_qdd")})
        balance(tick * k, state, command, command, memory)
        found[k] = memory[UP + 1], -memory[UP], memory[FILTERED], memory[FILTERED + 1], share[k]
    samples, times = len(motion.stride), tick * np.arange(len(share))
    at = motion.begin(0) + scene.lag + motion.tick * np.arange(samples * 2, len(motion.stride) * (2 + NOMINAL_STRIDES))
    at = at[at <= times[-1]]
    at = at[: len(at) // samples * samples]
    table = np.stack([np.interp(at, times, found[:, k]).reshape(-1, samples).mean(axis=0) for k in range(5)], axis=1)
    if mirrored:
        other = np.roll(table, samples // 2, axis=0) * (-1.0, 1.0, -1.0, 1.0, -1.0) + (0.0, 0.0, 0.0, 0.0, 1.0)
        table = 0.5 * (table + other)
    begins = np.stack([np.interp(scene.lag + motion.tick * np.arange(len(motion.start)), times, x) for x in found.T])
    return np.concatenate([begins.T, table])
