"""Walking with feedback: offsets and timing of a gait from an IMU on the trunk and the joint angles.

    walk = balanced(scene, motion, Feedback(ankle=3.0, wait=15.0))
    simulate(scene, walk.begin(20), reference=walk.reference(20), controller=walk.controller(scene))

Where the robot falls to is given by its capture point x + v / w, w = sqrt(g / h): where it would come to rest as an
inverted pendulum of its height h (J. Pratt et al., "Capture point: a step toward humanoid push recovery", Humanoids
2006).  It is measured from the sole of the stance leg: the joint angles and the direction up give the position of the
center of mass relative to each sole, and its rate gives the velocity, because the stance sole does not move.  The lower
sole is the stance sole.  The error is the difference to the undisturbed gait at the same phase, ahead (> 0) and aside
(> 0: left); so is that of the rate of the trunk's forward lean.  These errors move the servos' references, so that
feedback costs nothing on the flat:

    ankle of the stance leg    + P error ahead       presses the sole down where the robot falls to
    hip of the swing leg       - P error ahead       puts the foot where the robot falls to, its sole level
    hip of the stance leg      + D lean's rate       holds the trunk
    time                       runs faster if the error points toward the swing leg, slower if it points away

The first `quiet` meters of the error are ignored: gains can then be large that would disturb the walk if they always
acted.  These are the strategies of ankle, hip and step of F. Horak, L. Nashner, "Central programming of postural
movements", J. Neurophysiology 55 (1986); timing as in M. Khadiv et al., "Walking control based on step timing
adaptation", IEEE Trans. Robotics 36 (2020).  A heading error makes one leg sweep farther than the other.  The share of
the weight that a leg bears where offsets are added is that of the undisturbed gait at the same phase.

The sensors have noise, offsets and delay; the joint angles have the delay and the resolution of their encoders.  The
direction up is the integral of the gyroscope, drawn to the accelerometer's over `Imu.settling` (the complementary
filter of R. Mahony, T. Hamel, J.-M. Pflimlin, IEEE Trans. Automatic Control 53 (2008)); heading is the integral alone,
which drifts with the gyroscope's offset.  `balance` has the control law.
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
from ..base.brief import brief
from ..base.files import FilePath, complete, read_arrays
from ..dynamics import check_model
from ..dynamics.jacobians import chains_of
from ..model import Model
from ..run.program import SEEN, CompiledController, State
from ..run.reference import Reference
from ..run.trajectory import Trajectory
from ..scene.compile import CompiledScene
from ..scene.contact import standing_posture
from . import balance as law
from .cost import walk_runs
from .gait import Mirror
from .gait_file import ARRAYS
from .generic_servo import HEIGHT
from .inverse_kinematics import leg_joints
from .kinematics import joint_axes, link_centers, link_index, link_poses
from .motion import Motion, read_motion
from .stance import soles_of

ALONG = 0.9  # component of an axis along x or y from which the joint is one of roll or pitch
LARGEST = 1e4  # gain
MOST_DELAY = 0.2  # [s]
MOST_ROLL = 0.3  # largest roll of the ground [rad]
READ = ("base_q", "base_qd", "base_qdd", "q")  # channels that the controller reads
LEAN_OF_HIPS, LEAN_OF_ANKLES = -1.5, 2.5  # roll by the ground's roll; above 1, since soft servos yield under the load
NOMINAL_STRIDES = 8  # over which the undisturbed motion is averaged, after two others


def _gain(what: str, unit: str) -> Any:
    return field(default=0.0, metadata={"what": what, "unit": unit})


@dataclass(frozen=True)
class Feedback:
    """Gains of the feedback; with all zero the gait is played unchanged.

    Attributes
    ----------
    ankle, foot : float
        Offset of the stance ankle and of the swing hip per error ahead [rad/m].
    hip_rate : float
        Offset of the stance hip per error of the trunk's lean rate [s].
    hasten, wait : float
        How much faster time runs per error toward the swing leg, and how much slower per error away from it [1/m].
    quiet : float
        Error that is ignored (dead band) [m].
    heading : float
        How much farther one leg sweeps per heading error [1/rad].
    """

    ankle: float = _gain("ankle of the stance leg, per error ahead", "rad/m")
    foot: float = _gain("hip of the swing leg, per error ahead", "rad/m")
    hip_rate: float = _gain("hip of the stance leg, per error of the trunk's lean rate", "s")
    hasten: float = _gain("how much faster time runs, per error toward the swing leg", "1/m")
    wait: float = _gain("how much slower time runs, per error away from the swing leg", "1/m")
    quiet: float = _gain("dead band of the error", "m")
    heading: float = _gain("how much farther one leg sweeps, per heading error", "1/rad")

    def __post_init__(self) -> None:
        for one in fields(self):
            least = 0.0 if one.name == "quiet" else -LARGEST
            value = real(f"feedback: {one.name}", getattr(self, one.name), least, LARGEST, "0 is no feedback")
            object.__setattr__(self, one.name, value)

    def to_vector(self) -> np.ndarray:
        """Return the gains (7,) in their order."""
        return np.array([getattr(self, one.name) for one in fields(self)])

    def scaled(self, length: float) -> Feedback:
        """Return the gains for a robot `length` times as large (dynamic similarity: times scale with its root)."""
        length = real("length", length, 1e-3, 1e3, "it is a factor")
        factor = {"rad/m": 1.0 / length, "1/m": 1.0 / length, "m": length, "s": math.sqrt(length), "1/rad": 1.0}
        return Feedback(*(getattr(self, one.name) * factor[one.metadata["unit"]] for one in fields(self)))


def feedback_of(gains: ArrayLike) -> Feedback:
    """Return the feedback of a vector of gains: the inverse of `Feedback.to_vector`."""
    return Feedback(*finite("gains", gains, (len(fields(Feedback)),)).tolist())


@dataclass(frozen=True)
class Imu:
    """Gyroscope and accelerometer of the trunk, read at each tick of the servos' controllers.

    The default noise is that of an MPU-6050 with its filter at 100 Hz (InvenSense, MPU-6000/6050 product specification,
    rev. 3.4, section 6: 0.05 deg/s rms; 400 ug/sqrt(Hz)); the offset remains after the sensor has been zeroed at rest.

    Attributes
    ----------
    gyroscope_noise, accelerometer_noise : float
        Standard deviation of each reading [rad/s, m/s^2].
    gyroscope_offset, accelerometer_offset : float
        Standard deviation of the offset, one draw for each axis and run [rad/s, m/s^2].
    delay : float
        Time from a reading to the references that it changes, in whole ticks [s].
    filter : float
        Time constant of the gyroscope's first-order low-pass filter [s].
    settling : float
        Time constant with which the direction up is drawn to the accelerometer's [s].
    encoder : float
        Resolution of the joint angles [rad]; 0: exact, as the servos' own controllers read them.
    """

    gyroscope_noise: float = math.radians(0.05)
    gyroscope_offset: float = math.radians(0.05)
    accelerometer_noise: float = 0.04
    accelerometer_offset: float = 0.1
    delay: float = 0.02
    filter: float = 0.01
    settling: float = 2.0
    encoder: float = 0.0

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


@dataclass(frozen=True, eq=False)
class BalancedWalk:
    """A gait with feedback, made by `balanced`.

    Attributes
    ----------
    motion : Motion
        The gait.
    feedback : Feedback
        The gains.
    imu : Imu
        The sensors.
    undisturbed : ndarray, shape (n, 6)
        What sensors and estimates show without disturbance, for each sample of start and stride.
    """

    motion: Motion
    feedback: Feedback
    imu: Imu
    undisturbed: np.ndarray

    __repr__ = brief

    def controller(self, scene: CompiledScene, seed: int = 0) -> CompiledController:
        """Return the controller for `simulate` and this scene; seed: of the sensors' noise and offsets."""
        return law.balance.beginning_with(self.memory(scene, seed))

    def memory(self, scene: CompiledScene, seed: int = 0) -> np.ndarray:
        """Return the initial memory of the controller; its layout is in `balance`."""
        instance("scene", scene, CompiledScene, "give what compile_scene returns")
        seed = whole("seed", seed, 0, "it is the seed of the sensors' noise", 2**31 - 3)
        motion, imu, tick = self.motion, self.imu, scene.tick_steps * scene.timestep
        columns, signs = legs_of(scene.model)
        delay = round(imu.delay / tick)
        if abs(delay * tick - imu.delay) > 1e-9 or delay > law.LONGEST:
            raise ValueError(f"imu: delay is {imu.delay:g} s; give whole ticks of {tick:g} s, at most {law.LONGEST}")
        memory = np.zeros(law.TABLE)
        memory[: law.GAINS] = self.feedback.to_vector()
        memory[law.JOINTS:law.LEGS] = (
            len(motion.joint_names), len(motion.stride), motion.tick, len(motion.start), scene.lag, tick,
            math.hypot(*scene.gravity), seed + 1,
            imu.gyroscope_noise, imu.gyroscope_offset, imu.accelerometer_noise, imu.accelerometer_offset, delay,
            imu.filter, imu.settling, math.sqrt(standing_posture(scene.model)[0] / math.hypot(*scene.gravity)),
            sum(link.mass for link in scene.model.links), imu.encoder,
        )  # fmt: skip
        memory[law.BODY : law.OFFSETS] = chains_of_legs(scene.model, columns)
        memory[law.LEGS : law.SIGNS], memory[law.SIGNS : law.MEANS] = columns.ravel(), signs.ravel()
        memory[law.MEANS : law.BODY] = motion.stride[:, columns[:, 1]].mean(axis=0)
        played = np.concatenate([motion.start, motion.stride])
        return np.concatenate([memory, np.hstack([played, self.undisturbed]).ravel()])

    def leaning(self, model: Model, roll: float) -> BalancedWalk:
        """Return the gait for ground that is known to slope across the way: the legs lean uphill.

        Parameters
        ----------
        model : Model
            The robot.
        roll : float
            Angle of the ground about x [rad], > 0 where it rises to the left: ``Ground(slope=roll, heading=pi / 2)``.

        Returns
        -------
        BalancedWalk
            The gait with other references of the lateral joints, and with the same feedback.

        Raises
        ------
        ValueError
            For a robot without two legs whose hips and ankles have roll and pitch.
        """
        check_model(model)
        roll = real("roll", roll, -MOST_ROLL, MOST_ROLL, "give radians")
        columns, signs = legs_of(model)
        offset = np.zeros(len(self.motion.joint_names))
        offset[columns[:, 0]] = LEAN_OF_HIPS * roll * signs[:, 0]
        offset[columns[:, -1]] = LEAN_OF_ANKLES * roll * signs[:, -1]
        moved = {name: getattr(self.motion, name) + offset for name in ("start", "stride", "poses")}
        return replace(self, motion=replace(self.motion, **moved))

    def reference(self, strides: int) -> Reference:
        """Return the reference of the start and `strides` strides, without feedback."""
        return self.motion.reference(strides)

    def begin(self, strides: int) -> float:
        """Return the time at which so many strides are over, without feedback [s]."""
        return self.motion.begin(strides)

    def digest(self) -> str:
        """Return a hash of the gait and its feedback."""
        found = hashlib.sha256(f"{self.motion.digest()} {self.feedback} {self.imu}".encode())
        found.update(np.ascontiguousarray(self.undisturbed, dtype="<f8").tobytes())
        return found.hexdigest()

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays that a gait's .npz holds besides the gait."""
        imu = np.array([getattr(self.imu, one.name) for one in fields(Imu)])
        return {"feedback": self.feedback.to_vector(), "imu": imu, "undisturbed": self.undisturbed}


def add_feedback(path: FilePath, walk: BalancedWalk) -> None:
    """Add feedback to the file of a gait, for `read_walk`.

    Parameters
    ----------
    path : path
        The .npz of the gait.
    walk : BalancedWalk
        The same gait with feedback.

    Raises
    ------
    ValueError
        If the file is of another gait.
    """
    instance("walk", walk, BalancedWalk, "give what balanced returns")
    arrays = read_arrays(path_of("path", path), ARRAYS)
    if read_motion(path, walk.motion.joint_names).digest() != walk.motion.digest():
        raise ValueError(f"{path}: the file holds another gait than the feedback; give the file of this gait")
    with complete(path) as temporary, open(temporary, "wb") as file:
        kept: dict[str, Any] = {"format": np.array(str(ARRAYS))} | arrays | walk.arrays()
        np.savez_compressed(file, **kept)


def read_walk(path: FilePath, joint_names: Sequence[str] | None = None) -> Motion | BalancedWalk:
    """Read a gait, with its feedback if the file has any.

    Parameters
    ----------
    path, joint_names
        As of `read_motion`.

    Returns
    -------
    Motion or BalancedWalk
        The gait.

    Raises
    ------
    ValueError
        As `read_motion`.
    """
    motion = read_motion(path, joint_names)
    arrays = read_arrays(path_of("path", path), ARRAYS) if path_of("path", path).suffix == ".npz" else {}
    if "feedback" not in arrays:
        return motion
    missing = {"imu", "undisturbed"} - arrays.keys()
    shape = (len(motion.start) + len(motion.stride), law.COLUMNS)
    if missing or arrays["undisturbed"].shape != shape or not np.isfinite(arrays["undisturbed"]).all():
        raise ValueError(f"{path}: its feedback lacks imu and undisturbed {shape}; write it with add_feedback")
    try:
        imu = Imu(*finite("imu", arrays["imu"], (len(fields(Imu)),)).tolist())
        return BalancedWalk(motion, feedback_of(arrays["feedback"]), imu, arrays["undisturbed"])
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def legs_of(model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Return the columns (2, 5) of a biped's leg joints, left leg first, and their signs (2, 5).

    The order is that of `balance.ROLES`.  Raises ValueError for a robot without two legs whose hips and ankles have
    roll and pitch.
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
    left, right = (poses.position[0, link_index(model, foot), 1] for foot in feet)
    if left < right:
        found.reverse()
    signs = np.array([[np.sign(axes[j][k]) for j, k in zip(row, (0, 1, 1, 1, 0))] for row in found])
    return np.array(found), signs


def chains_of_legs(model: Model, columns: np.ndarray) -> np.ndarray:
    """Return trunk, left and right leg at zero angles as `balance` reads them; columns (2, 5): of `legs_of`."""
    poses = link_poses(model, np.zeros(len(model.joint_names)))
    chains, centers = chains_of(model), link_centers(model, poses)[0]
    mass = np.array([link.mass for link in model.links])
    axes, origins = joint_axes(model, poses)[0], poses.position[0, chains.children]
    carried = chains.moves[:, columns.ravel()].sum(axis=1) == 0
    found = [(mass[carried, None] * centers[carried]).sum(axis=0)]
    for row in columns:
        moved = chains.moves[:, row].sum(axis=1)
        masses = np.array([mass[moved == k + 1].sum() for k in range(law.ROLES)])
        middle = [(mass[moved == k + 1, None] * centers[moved == k + 1]).sum(axis=0) / max(masses[k], 1e-9)
                  for k in range(law.ROLES)]  # fmt: skip
        foot = [link_index(model, point.link) for point in model.contacts]
        corners = np.array([poses.position[0, k] + poses.rotation[0, k] @ point.position
                            for k, point in zip(foot, model.contacts) if moved[k] == law.ROLES])  # fmt: skip
        found += [axes[row], origins[row], middle, masses, corners.mean(axis=0), 0.5 * np.ptp(corners, axis=0)[:2]]
    return np.concatenate([np.ravel(one) for one in found])


def size_of(model: Model) -> tuple[float, float]:
    """Return a robot's height of the center of mass and the push that is as hard for it, relative to a Bioloid.

    A push that soles of half sizes a and b just hold takes the capture point to their edge: it grows as mass times
    sqrt(g / height) times sqrt(a b).
    """
    height, _ = standing_posture(model)
    a, b = np.ptp(soles_of(model)[0].corners, axis=0) / 2.0
    return height / HEIGHT, model.mass * math.sqrt(9.81 / height * a * b) / BIOLOID_PUSH


def generic_feedback(model: Model) -> Feedback:
    """Scale the gains of a Bioloid to another biped, by the height of its center of mass.

    Parameters
    ----------
    model : Model
        The robot.

    Returns
    -------
    Feedback
        The gains.

    Raises
    ------
    ValueError
        For a robot that is no biped.
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
    """Give a motion feedback about its undisturbed walk on the scene's ground.

    Parameters
    ----------
    scene : CompiledScene
        The robot on flat ground, on which the motion walks by itself.
    motion : Motion
        The gait.
    feedback : Feedback or array_like, shape (7,)
        The gains.
    imu : Imu
        The sensors.
    mirror : Mirror, optional
        Of a gait whose second half is its first half mirrored; the undisturbed walk is then symmetrized too.

    Returns
    -------
    BalancedWalk
        The gait with feedback.

    Raises
    ------
    ValueError
        For a robot that is no biped, and for a motion that falls.
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
    """Simulate motions that start alike, undisturbed; return tables for `BalancedWalk`, None for one that falls.

    mirrored: whether the second half of a stride is the first half mirrored.
    """
    strides = 2 + NOMINAL_STRIDES
    signals, record = [motion.reference(strides) for motion in motions], [*READ, "contact_force"]
    runs = walk_runs([scene] * len(motions), motions[0].begin(strides), signals, record=record)
    return [undisturbed(scene, motion, run, imu, mirrored) if run.ok else None for motion, run in zip(motions, runs)]


def undisturbed(scene: CompiledScene, motion: Motion, run: Trajectory, imu: Imu, mirrored: bool) -> np.ndarray:
    """Average what the sensors and estimates of `balance` show in an undisturbed walk, without noise.

    Columns: the pitch rate [rad/s], the left leg's share of the load, and the capture point ahead and aside of the left
    sole and of the right one [m].  run: of at least two strides more than are averaged, recorded at every tick.
    """
    still = replace(
        imu, gyroscope_noise=0.0, gyroscope_offset=0.0, accelerometer_noise=0.0, accelerometer_offset=0.0
    )  # fmt: skip
    zeros = np.zeros((len(motion.start) + len(motion.stride), law.COLUMNS))
    memory = BalancedWalk(motion, Feedback(), still, zeros).memory(scene)
    force, left_hip = run["contact_force"][:, :, 0], legs_of(scene.model)[0][0, 0]
    on_left = force[:, [left_hip in leg_joints(scene.model, point.link) for point in scene.model.contacts]].sum(axis=1)
    share = on_left / np.maximum(force.sum(axis=1), 1e-9)
    tick = scene.tick_steps * scene.timestep
    found = np.zeros((len(share), law.COLUMNS))
    command = np.zeros((scene.tree.n, 2))
    none = dict.fromkeys(SEEN, np.empty(0))
    for k in range(len(share)):
        state = State(**none | {name: run[name][k] for name in READ})
        law.balance(tick * k, state, command, command, memory)
        found[k, :2] = memory[law.RATES + 1], share[k]
        found[k, 2:] = memory[law.FROM : law.FROM + 4] + memory[law.FALLING] * memory[law.SPEED : law.SPEED + 4]
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
