"""Walking with feedback: a gait's offsets and its timing from gyroscope and accelerometer on the trunk, and the joints.

    walk = balanced(scene, motion, Feedback(ankle=3.0, wait=15.0))
    simulate(scene, walk.begin(20), reference=walk.reference(20), controller=walk.controller(scene))

Where the robot falls to is told by its capture point x + v / w, w = sqrt(g / h): where it would come to rest as an
inverted pendulum of its height h (J. Pratt et al., "Capture point: a step toward humanoid push recovery", Humanoids
2006).  It is seen from the sole of the leg that bears: angles and the direction up give where the center of mass is
from each sole, and the rate of that how fast it moves, as a sole that bears does not.  The lower sole bears.  What
differs from the gait at this phase where nothing disturbs it, ahead (> 0) and aside (> 0: left), is what is off; so is
the rate of the trunk's lean ahead.  They move the servos' references, so that feedback costs nothing on the flat:

    ankle of the leg that bears    + P off ahead     presses the sole down where the robot falls to
    hip of the leg that swings     - P off ahead     puts the foot where the robot falls to, its sole level
    hip of the leg that bears      + D lean's rate   holds the trunk
    time                           runs faster where it is off toward the leg that swings, slower away from it

Of what is off the first `quiet` meters count for nothing: gains can be large that would disturb the walk if they acted
all the time.  These are the strategies of ankle, hip and step of F. Horak, L. Nashner, "Central programming of postural
movements", J. Neurophysiology 55 (1986); time as of M. Khadiv et al., "Walking control based on step timing
adaptation", IEEE Trans. Robotics 36 (2020).  A heading that is off makes one leg sweep farther than the other.  How
much of the weight a leg bears where offsets are added is that of the undisturbed gait at this phase.

The sensors have noise, offsets and delay, the joints' angles the delay alone and the step of their encoders.  The
direction up is that of the gyroscope's integral, drawn to the accelerometer's over `Imu.settling` (the complementary
filter of R. Mahony, T. Hamel, J.-M. Pflimlin, IEEE Trans. Automatic Control 53 (2008)), heading the integral alone,
which drifts as the gyroscope's offset says.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from types import NoneType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import finite, instance, real, whole
from ..base.arguments import path as path_of
from ..base.files import FilePath, complete, read_arrays
from ..dynamics import check_model
from ..dynamics.jacobians import chains_of
from ..model import Model
from ..run.program import SEEN, CompiledController, State, controller
from ..run.reference import Reference
from ..run.simulate import simulate_batch, standing_state
from ..run.trajectory import Trajectory
from ..scene.compile import CompiledScene
from ..scene.contact import standing_posture
from .gait import Mirror
from .gait_file import ARRAYS
from .generic_servo import HEIGHT
from .inverse_kinematics import leg_joints
from .kinematics import joint_axes, link_centers, link_index, link_poses
from .motion import Motion, read_motion
from .plan import soles_of

ALONG = 0.9  # of an axis along x or y: the joint is one of roll or pitch
LARGEST = 1e4  # gain
MOST_DELAY = 0.2  # [s]
NOMINAL_STRIDES = 8  # over which the undisturbed motion is averaged, after two


def _gain(what: str, unit: str) -> Any:
    return field(default=0.0, metadata={"what": what, "unit": unit})


@dataclass(frozen=True)
class Feedback:
    """Gains; all zero: the gait is played as it is."""

    ankle: float = _gain("ankle of the leg that bears, by what is off ahead", "rad/m")
    foot: float = _gain("hip of the leg that swings, by what is off ahead", "rad/m")
    hip_rate: float = _gain("hip of the leg that bears, by the rate of the trunk's lean ahead", "s")
    hasten: float = _gain("how much faster time runs, by what is off toward the leg that swings", "1/m")
    wait: float = _gain("how much slower, by what is off away from it", "1/m")
    quiet: float = _gain("what is off counts from here on", "m")
    heading: float = _gain("how much farther one leg sweeps, by what heading is off", "1/rad")

    def __post_init__(self) -> None:
        for one in fields(self):
            least = 0.0 if one.name == "quiet" else -LARGEST
            value = real(f"feedback: {one.name}", getattr(self, one.name), least, LARGEST, "0 is no feedback")
            object.__setattr__(self, one.name, value)

    def to_vector(self) -> np.ndarray:
        """The gains (7,) in their order."""
        return np.array([getattr(self, one.name) for one in fields(self)])

    def scaled(self, length: float) -> Feedback:
        """The same for a robot that is alike but `length` times as large (dynamic similarity: times as its root)."""
        length = real("length", length, 1e-3, 1e3, "it is a factor")
        factor = {"rad/m": 1.0 / length, "1/m": 1.0 / length, "m": length, "s": math.sqrt(length), "1/rad": 1.0}
        return Feedback(*(getattr(self, one.name) * factor[one.metadata["unit"]] for one in fields(self)))


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
    encoder: float = 0.0  # step of the joints' angles [rad], 0: exact, as the servos' own controllers read them

    def __post_init__(self) -> None:
        for one in fields(self):
            low, high = (1e-2, 1e3) if one.name == "settling" else (0.0, MOST_DELAY if one.name == "delay" else 1e3)
            value = real(f"imu: {one.name}", getattr(self, one.name), low, high, "give it in SI units")
            object.__setattr__(self, one.name, value)


NONE, SENSORS = Feedback(), Imu()
BIOLOID = Feedback(  # gains of robots/humanoid/balanced_gait.npz, rounded
    ankle=4.2, foot=2.0, hip_rate=0.05, hasten=10.0, wait=24.0, quiet=0.007, heading=0.775,
)  # fmt: skip
BIOLOID_PUSH = 0.623  # see `size_of` [N s]

# The controller's memory: gains, numbers, what it remembers, tables.
GAINS = len(fields(Feedback))
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
UP = OFFSETS + 6
FILTERED = UP + 3
TURNED, AHEAD, BEGUN, COUNT = range(FILTERED + 3, FILTERED + 7)
FEET = COUNT + 1  # of left and right sole as the sensors say, upright axes, from the trunk (2, 3) [m]
FROM = FEET + 6  # where the center of mass is, from each sole ahead and aside (2, 2) [m]
SPEED = FROM + 4  # its rate, filtered (2, 2) [m/s]
LOWEST = SPEED + 4  # height of the lowest corner of each sole (2,) [m]
LINE = LOWEST + 2  # what the sensors read, as long as it is under way
READ = 6 + 2 * ROLES
LONGEST = 20  # ticks of delay
TABLE = LINE + READ * (LONGEST + 1)
COLUMNS = 6  # of the undisturbed motion: see `undisturbed`
FADE = 0.5  # in which feedback begins to act [s]
SLOWEST, FASTEST = 0.3, 3.0  # of the gait's time
MOST_RATE = 4.0  # of the lean that counts [rad/s]
MOST_SWEEP = 0.6  # that one leg sweeps farther [-]
MOST_ANKLE, MOST_FOOT = 0.15, 0.4  # of what is off [rad]
TOUCHING = 0.004  # by how much a sole is higher that bears nothing [m]


@controller(memory=0)
def balance(t: float, state: Any, reference: np.ndarray, command: np.ndarray, memory: np.ndarray) -> None:
    """The gait at its own time, with offsets; its memory is `BalancedWalk.memory`.

    One function without others: the same in Python, where another simulator plays the gait, and compiled.
    """
    # What the sensors read, noise and all, goes into a line; random numbers of mean 0 and variance 1 are the sum of
    # twelve of the multiplicative generator of Park and Miller.
    begun = memory[BEGUN] > 0.0
    count, slots, tick = int(memory[COUNT]), int(memory[DELAY]) + 1, memory[TICK]
    at, seed = LINE + READ * (count % slots), int(memory[SEED])
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
    for k in range(2 * ROLES):
        angle, step = state.q[int(memory[LEGS + k])], memory[ENCODER]
        memory[at + 6 + k] = step * math.floor(angle / step + 0.5) if step > 0.0 else angle
    # Direction up in the trunk's axes, heading and filtered rates, from the oldest reading in the line.
    if count >= slots - 1:
        at = LINE + READ * ((count + 1) % slots)
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
        # Axes ahead, aside and up, as rows of L in the trunk's axes.
        L, R, turned = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
        shift, sole, center = np.empty(3), np.empty(3), np.empty(3)
        x, y, z = memory[UP], memory[UP + 1], memory[UP + 2]
        size = 1.0 / math.sqrt(max(1.0 - x * x, 1e-9))
        L[0, 0], L[0, 1], L[0, 2] = (1.0 - x * x) * size, -x * y * size, -x * z * size
        L[1, 0], L[1, 1], L[1, 2] = 0.0, z * size, -y * size
        L[2, 0], L[2, 1], L[2, 2] = x, y, z
        # Each leg by the product of exponentials of its joints: a point p of the zero posture is at R p + shift.
        for i in range(3):
            center[i] = memory[BODY + i]
        for leg in range(2):
            chain = CHAIN + CHAIN_LENGTH * leg
            R[:], shift[:] = 0.0, 0.0
            R[0, 0] = R[1, 1] = R[2, 2] = 1.0
            for j in range(ROLES):
                axis, origin = chain + 3 * j, chain + 3 * (ROLES + j)
                middle, mass = chain + 3 * (2 * ROLES + j), memory[chain + 9 * ROLES + j]
                x = R[0, 0] * memory[axis] + R[0, 1] * memory[axis + 1] + R[0, 2] * memory[axis + 2]
                y = R[1, 0] * memory[axis] + R[1, 1] * memory[axis + 1] + R[1, 2] * memory[axis + 2]
                z = R[2, 0] * memory[axis] + R[2, 1] * memory[axis + 1] + R[2, 2] * memory[axis + 2]
                angle = memory[at + 6 + ROLES * leg + j]
                cosine, sine = math.cos(angle), math.sin(angle)
                for k in range(3):  # Rodrigues: columns of R turned about the axis
                    a, b, c = R[0, k], R[1, k], R[2, k]
                    along = (1.0 - cosine) * (x * a + y * b + z * c)
                    turned[0, k] = cosine * a + sine * (y * c - z * b) + along * x
                    turned[1, k] = cosine * b + sine * (z * a - x * c) + along * y
                    turned[2, k] = cosine * c + sine * (x * b - y * a) + along * z
                for i in range(3):
                    for k in range(3):
                        shift[i] += (R[i, k] - turned[i, k]) * memory[origin + k]
                        R[i, k] = turned[i, k]
                    center[i] += mass * shift[i]
                    for k in range(3):
                        center[i] += mass * R[i, k] * memory[middle + k]
            end = chain + 10 * ROLES  # the sole's center and half size
            for i in range(3):
                sole[i] = shift[i] + R[i, 0] * memory[end] + R[i, 1] * memory[end + 1] + R[i, 2] * memory[end + 2]
            for i in range(3):
                memory[FEET + 3 * leg + i] = L[i, 0] * sole[0] + L[i, 1] * sole[1] + L[i, 2] * sole[2]
            memory[LOWEST + leg] = memory[FEET + 3 * leg + 2]
            for k in range(2):
                tilt = L[2, 0] * R[0, k] + L[2, 1] * R[1, k] + L[2, 2] * R[2, k]
                memory[LOWEST + leg] -= abs(tilt) * memory[end + 3 + k]
        # The center of mass and its rate, seen from each sole.
        for leg in range(2):
            for i in range(2):
                k = 2 * leg + i
                now = (L[i, 0] * center[0] + L[i, 1] * center[1] + L[i, 2] * center[2]) / memory[MASS]
                now -= memory[FEET + 3 * leg + i]
                if count >= slots:
                    memory[SPEED + k] += passed * ((now - memory[FROM + k]) / tick - memory[SPEED + k])
                memory[FROM + k] = now
    memory[COUNT] += 1.0
    memory[BEGUN] = 1.0
    # The gait at its own time, by memory[AHEAD] ahead of the clock [s]: rows of the start, then of the stride.
    joints, samples, first = int(memory[JOINTS]), int(memory[SAMPLES]), int(memory[FIRST])
    width = joints + COLUMNS
    phase = max(t - memory[LAG], 0.0) / memory[SAMPLE] + memory[AHEAD] / memory[SAMPLE]
    k = math.floor(phase + 1e-9)
    s = max(phase - k, 0.0)
    low = k if k < first else first + (k - first) % samples
    high = k + 1 if k + 1 < first else first + (k + 1 - first) % samples
    low, high = TABLE + width * low, TABLE + width * high
    for j in range(joints):
        a, b = memory[low + j], memory[high + j]
        command[j, 0], command[j, 1] = a + s * (b - a), (b - a) / memory[SAMPLE]
    usual = np.empty(COLUMNS)
    for j in range(COLUMNS):
        usual[j] = (1.0 - s) * memory[low + joints + j] + s * memory[high + joints + j]
    # What is off, fading in.
    fade = min(t / FADE, 1.0)
    pitch_rate = fade * min(max(memory[FILTERED + 1] - usual[0], -MOST_RATE), MOST_RATE)
    left = usual[1]
    on_left = min(max(0.5 + 0.5 * (memory[LOWEST + 1] - memory[LOWEST]) / TOUCHING, 0.0), 1.0)
    ahead = aside = 0.0
    for leg in range(2):
        bears, k = on_left if leg == 0 else 1.0 - on_left, 2 * leg
        ahead += fade * bears * (memory[FROM + k] + memory[FALLING] * memory[SPEED + k] - usual[2 + k])
        aside += fade * bears * (memory[FROM + k + 1] + memory[FALLING] * memory[SPEED + k + 1] - usual[3 + k])
    quiet = memory[5]
    ahead, aside = ahead - min(max(ahead, -quiet), quiet), aside - min(max(aside, -quiet), quiet)
    # Offsets, the gains in the order of `Feedback`.
    ankle = min(max(memory[0] * ahead, -MOST_ANKLE), MOST_ANKLE)
    foot = -min(max(memory[1] * ahead, -MOST_FOOT), MOST_FOOT)
    farther = min(max(fade * memory[6] * memory[TURNED], -MOST_SWEEP), MOST_SWEEP)
    for leg in range(2):
        bears = left if leg == 0 else 1.0 - left
        swings, at, sign = 1.0 - bears, LEGS + ROLES * leg, SIGNS + ROLES * leg
        hip, below = int(memory[at + 1]), int(memory[at + 3])
        sweep = (1.0 - 2.0 * leg) * farther * (command[hip, 0] - memory[MEANS + leg]) * memory[sign + 1]
        command[hip, 0] += memory[sign + 1] * (bears * memory[2] * pitch_rate + swings * foot + sweep)
        command[below, 0] += memory[sign + 3] * (bears * ankle - swings * foot - sweep)
    if phase < first:
        return
    toward = (1.0 - 2.0 * left) * aside  # > 0: to where the leg is that swings
    rate = 1.0 + memory[3] * max(toward, 0.0) + memory[4] * min(toward, 0.0)
    memory[AHEAD] += tick * (min(max(rate, SLOWEST), FASTEST) - 1.0)


@dataclass(frozen=True, eq=False)
class BalancedWalk:
    """A gait with feedback; made by `balanced`."""

    motion: Motion
    feedback: Feedback
    imu: Imu
    undisturbed: np.ndarray  # (samples of start and stride, 6): see `undisturbed`

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
            sum(link.mass for link in scene.model.links), imu.encoder,
        )  # fmt: skip
        memory[BODY:OFFSETS] = chains_of_legs(scene.model, columns)
        memory[LEGS:SIGNS], memory[SIGNS:MEANS] = columns.ravel(), signs.ravel()
        memory[MEANS:BODY] = motion.stride[:, columns[:, 1]].mean(axis=0)
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
    shape = (len(motion.start) + len(motion.stride), COLUMNS)
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


def chains_of_legs(model: Model, columns: np.ndarray) -> np.ndarray:
    """What `leg_pose` takes: trunk, then left and right leg, at zero angles; columns (2, 5)."""
    poses = link_poses(model, np.zeros(len(model.joint_names)))
    chains, centers = chains_of(model), link_centers(model, poses)[0]
    mass = np.array([link.mass for link in model.links])
    axes, origins = joint_axes(model, poses)[0], poses.position[0, chains.children]
    carried = chains.moves[:, columns.ravel()].sum(axis=1) == 0
    found = [(mass[carried, None] * centers[carried]).sum(axis=0)]
    for row in columns:
        moved = chains.moves[:, row].sum(axis=1)
        masses = np.array([mass[moved == k + 1].sum() for k in range(ROLES)])
        middle = [(mass[moved == k + 1, None] * centers[moved == k + 1]).sum(axis=0) / max(masses[k], 1e-9)
                  for k in range(ROLES)]  # fmt: skip
        foot = [link_index(model, point.link) for point in model.contacts]
        corners = np.array([poses.position[0, k] + poses.rotation[0, k] @ point.position
                            for k, point in zip(foot, model.contacts) if moved[k] == ROLES])  # fmt: skip
        found += [axes[row], origins[row], middle, masses, corners.mean(axis=0), 0.5 * np.ptp(corners, axis=0)[:2]]
    return np.concatenate([np.ravel(one) for one in found])


def size_of(model: Model) -> tuple[float, float]:
    """How high a robot's center of mass is, standing, and how large a push is as hard, both of a Bioloid's.

    A push that is just held by soles of half sizes a and b takes the capture point to their edge: it grows as mass
    times sqrt(g / height) times sqrt(a b).
    """
    height, _ = standing_posture(model)
    a, b = np.ptp(soles_of(model)[0].corners, axis=0) / 2.0
    return height / HEIGHT, model.mass * math.sqrt(9.81 / height * a * b) / BIOLOID_PUSH


def generic_feedback(model: Model) -> Feedback:
    """Gains for a biped whose own are not known: those of a Bioloid, scaled to the height of its center of mass.

    Raises ValueError for a robot that is no biped.
    """
    check_model(model)
    legs_of(model)
    return BIOLOID.scaled(size_of(model)[0])


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
    if not isinstance(feedback, Feedback):
        feedback = feedback_of(finite("feedback", feedback, (len(fields(Feedback)),)))
    instance("imu", imu, Imu, "give Imu(...)")
    instance("mirror", mirror, (Mirror, NoneType), "give what mirror_of returns, or None")
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
        record=("base_q", "base_qd", "base_qdd", "q", "contact_force"), estimate_error=False,
    )  # fmt: skip
    return [
        undisturbed(scene, motion, run, imu, mirrored) if run.ok else None for motion, run in zip(motions, runs)
    ]


def undisturbed(scene: CompiledScene, motion: Motion, run: Trajectory, imu: Imu, mirrored: bool) -> np.ndarray:
    """What `BalancedWalk` compares with: the same sensors and estimates, without noise, on average.

    Columns: the pitch's rate [rad/s], the left leg's share of the load, and the capture point ahead and aside of
    the left sole and of the right one [m].  run: the motion after its start, without feedback, of at least two strides
    more than are averaged, a record a tick.
    """
    still = replace(
        imu, gyroscope_noise=0.0, gyroscope_offset=0.0, accelerometer_noise=0.0, accelerometer_offset=0.0
    )  # fmt: skip
    zeros = np.zeros((len(motion.start) + len(motion.stride), COLUMNS))
    memory = BalancedWalk(motion, Feedback(), still, zeros).memory(scene)
    force = run["contact_force"][:, :, 0]
    feet = [point.link for point in scene.model.contacts]
    columns, _ = legs_of(scene.model)
    left_foot = next(foot for foot in feet if columns[0, 0] in leg_joints(scene.model, foot))
    on_left = force[:, [foot == left_foot for foot in feet]].sum(axis=1)
    share = on_left / np.maximum(force.sum(axis=1), 1e-9)
    tick = scene.tick_steps * scene.timestep
    found = np.zeros((len(share), COLUMNS))
    command = np.zeros((scene.tree.n, 2))
    none = dict.fromkeys(SEEN, np.empty(0))
    for k in range(len(share)):
        state = State(**none | {name: run[name][k] for name in ("base_q", "base_qd", "base_qdd", "q")})
        balance(tick * k, state, command, command, memory)
        found[k, :2] = memory[FILTERED + 1], share[k]
        found[k, 2:] = memory[FROM : FROM + 4] + memory[FALLING] * memory[SPEED : SPEED + 4]
    samples, times = len(motion.stride), tick * np.arange(len(share))
    at = motion.begin(0) + scene.lag + motion.tick * np.arange(samples * 2, len(motion.stride) * (2 + NOMINAL_STRIDES))
    at = at[at <= times[-1]]
    at = at[: len(at) // samples * samples]
    table = np.stack([np.interp(at, times, x).reshape(-1, samples).mean(axis=0) for x in found.T], axis=1)
    if mirrored:
        other = np.roll(table, samples // 2, axis=0)[:, [0, 1, 4, 5, 2, 3]] * (1.0, -1.0, 1.0, -1.0, 1.0, -1.0)
        other[:, 1] += 1.0
        table = 0.5 * (table + other)
    begins = np.stack([np.interp(scene.lag + motion.tick * np.arange(len(motion.start)), times, x) for x in found.T])
    played = np.concatenate([begins.T, table])
    played[0, 2:] = played[1, 2:]  # the line of readings was empty
    return played
