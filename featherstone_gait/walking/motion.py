"""Motions: a start and a stride that repeats, as the servos play them; read from the files of a gait."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import floats, texts, truth, whole
from ..base.arguments import path as path_of
from ..base.brief import brief
from ..base.files import FilePath, check_sound, read_arrays
from ..model import Ground, Model
from ..run.reference import Reference
from ..scene.contact import standing_height
from .gait import MOST_STRIDES, TICK, Gait, references
from .gait_file import ARRAYS, read_angles
from .kinematics import upright_states

SAME = 1e-9  # tolerance of the strides of a CSV [rad]
UNEVEN = 1e-6  # tolerance of its ticks [s]


@dataclass(frozen=True, eq=False)
class Motion:
    """References of the servos at every tick, joined by straight lines.

    Attributes
    ----------
    joint_names : tuple of str
        Names of the joints.
    start : ndarray, shape (m, nj)
        Joint angles before the first stride [rad].
    stride : ndarray, shape (k, nj)
        Joint angles of a stride, without its end [rad].
    poses : ndarray, shape (p, nj)
        Key poses of the gait; the stride itself if they are not known [rad].
    tick : float
        Time between references [s].
    """

    joint_names: tuple[str, ...]
    start: np.ndarray
    stride: np.ndarray
    poses: np.ndarray
    tick: float = TICK

    __repr__ = brief

    @property
    def period(self) -> float:
        """Time of a stride [s]."""
        return self.tick * len(self.stride)

    def begin(self, strides: int) -> float:
        """Return the time at which so many strides are over [s]."""
        return self.tick * len(self.start) + strides * self.period

    def reference(self, strides: int) -> Reference:
        """Return the reference of the start and `strides` strides."""
        strides = whole("strides", strides, 1, "give the number of strides", MOST_STRIDES)
        values = np.concatenate([self.start, np.tile(self.stride, (strides, 1)), self.stride[:1]])
        return Reference(self.tick * np.arange(len(values)), values, "linear")

    def digest(self) -> str:
        """Return a hash of the motion."""
        found = hashlib.sha256(repr((self.joint_names, self.tick, self.start.shape)).encode())
        for array in (self.start, self.stride):
            found.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
        return found.hexdigest()


def motion_of(gait: Gait, start: ArrayLike, blend_strides: int = 1) -> Motion:
    """Return the motion of a gait after its start.

    Parameters
    ----------
    gait, start, blend_strides
        As of `references`.

    Returns
    -------
    Motion
        The motion.
    """
    _, angles = references(gait, 0, start, blend_strides=blend_strides)
    stride = gait.angles(TICK * np.arange(round(gait.period / TICK)))
    return Motion(gait.joint_names, angles[:-1], stride, gait.poses)


def read_motion(path: FilePath, joint_names: Sequence[str] | None = None, *, first: bool = False) -> Motion:
    """Read a motion from the file of a gait.

    Parameters
    ----------
    path : path
        ROBOT_gait.npz, or a CSV of joint angles (`write_angles`) that ends in strides that repeat.
    joint_names : sequence of str, optional
        Joints of the robot, to check the file and to order its columns.
    first : bool
        Whether to read the gait that the search started from (of a .npz).

    Returns
    -------
    Motion
        The motion.

    Raises
    ------
    ValueError
        Naming the file, if it is damaged, of another robot, or its end does not repeat.
    """
    path, first = path_of("path", path), truth("first", first)
    if path.suffix == ".npz":
        return _of_arrays(path, joint_names, first)
    if path.suffix != ".csv":
        raise ValueError(f"path {path}: give a gait's .npz or its angles as .csv, as featherstone-gait optimize writes")
    if first:
        raise ValueError(f"{path}: only a gait's .npz has the gait that the search started from; give that")
    times, angles, names = read_angles(path, joint_names)
    gaps = np.diff(times)
    if len(times) < 7 or np.ptp(gaps) > UNEVEN:
        raise ValueError(f"{path}: its {len(times)} rows must be 7 or more, evenly spaced in time; sample it so")
    repeats = lambda n: np.abs(angles[-1 - n :] - angles[-1 - 2 * n : -n]).max() <= SAME  # noqa: E731
    period = next((n for n in range(3, (len(angles) - 1) // 2 + 1) if repeats(n)), 0)
    if not period:
        raise ValueError(f"{path}: its last rows do not repeat; it must end in two equal strides and their first row")
    end = len(angles) - 1 - period
    while end >= period and np.abs(angles[end - period : end] - angles[end : end + period]).max() <= SAME:
        end -= period
    stride = angles[end : end + period]
    return Motion(names, angles[:end], stride, stride, float(np.round(gaps.mean(), 9)))


def servo_of(path: FilePath) -> str | None:
    """Read which servo a gait was optimized with.

    Parameters
    ----------
    path : path
        The file of a gait.

    Returns
    -------
    str or None
        The servo of all joints, as given to `optimize --servo`; None for the robot's own, or if the file does not say.

    Raises
    ------
    ValueError
        Naming the file, if it is damaged.
    """
    path = path_of("path", path)
    found = read_arrays(path, ARRAYS).get("servo") if path.suffix == ".npz" else None
    if found is None:
        return None
    if found.ndim or found.dtype.kind != "U":
        raise ValueError(f"{path}: servo is {found!r}; expected a text: take an undamaged copy, or make it anew")
    return str(found) or None


def _of_arrays(path: Path, joint_names: Sequence[str] | None, first: bool) -> Motion:
    arrays = read_arrays(path, ARRAYS)
    of = "first_poses" if first else "poses"
    missing = {of, "start", "period", "joint_names"} - arrays.keys()
    if missing:
        what = ", ".join(sorted(missing))
        raise ValueError(f"{path}: lacks {what}; give the .npz that featherstone-gait optimize writes")
    names, poses = tuple(map(str, arrays["joint_names"].tolist())), floats(of, arrays[of])
    wanted = names if joint_names is None else tuple(texts("joint_names", joint_names))
    if sorted(names) != sorted(wanted):
        odd = ", ".join(sorted({*names} ^ {*wanted}))
        raise ValueError(f"{path}: its joints are not those of joint_names: {odd}; name the robot (--robot)")
    columns = [names.index(name) for name in wanted]
    for name in (of, "start"):
        check_sound(path, name, arrays[name])
    try:
        return motion_of(Gait(wanted, poses[:, columns], float(arrays["period"])), arrays["start"][:, columns])
    except (ValueError, IndexError) as error:
        raise ValueError(f"{path}: {error}") from error


def with_poses(model: Model, motion: Motion) -> Model:
    """Add the key poses of a motion to the robot as keyframes pose0, pose1, ..., standing upright on level ground.

    Pose k is that at k / p of the stride's period; "start" is the first posture.
    """
    postures = {"start": motion.reference(1).values[0]} | {f"pose{k}": pose for k, pose in enumerate(motion.poses)}
    frames = {}
    for name, angles in postures.items():
        q = upright_states(model, angles)[0]
        q[2] = standing_height(model, Ground(), q)
        frames[name] = tuple(q.tolist())
    return replace(model, keyframes=frames)
