"""Gaits of key poses, which an optimizer changes and a robot plays back.

A gait holds ``n_poses`` postures, evenly spaced over one stride (two steps); between them the joint angles follow the
periodic cubic spline, so that positions, speeds and accelerations are continuous from stride to stride.  Four states of
ten joints make the forty parameters of J. Lima et al., "Humanoid gait optimization resorting to an improved simulation
model", Int. J. Advanced Robotic Systems 10 (2013), section 4.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import finite, floats, instance, is_real, real, shown, texts, truth, whole
from ..base.brief import brief
from ..base.fixed_order import product, solve, total
from ..dynamics import check_model
from ..model import Model
from .kinematics import joint_axes, joint_limits, link_index, link_poses
from .plan import Stride

SIDE = re.compile("left|right|Left|Right|LEFT|RIGHT")
OTHER_SIDE = {a: b for one in (("left", "right"), ("Left", "Right"), ("LEFT", "RIGHT")) for a, b in (one, one[::-1])}
ALIKE = 1e-3  # tolerance of left and right [m]
PARALLEL = 1e-6  # tolerance of the cosine of axes
TICK = 0.04  # [s] between the references sent to the servos (Lima et al. 2013, figure 2)
SHORTEST, LONGEST = 1e-6, 1e6  # times of a gait [s]
MOST_STRIDES = 10**5
DECIMALS = 9  # of fitted poses [rad]: a gait outlives changes of last bits; far below any servo's resolution


@dataclass(frozen=True, eq=False)
class Mirror:
    """The mirror image of postures in the plane y = 0: ``mirrored[i] = sign[i] * angles[index[i]]``.

    Attributes
    ----------
    index : ndarray, shape (nj,)
        Column of each joint's partner.
    sign : ndarray, shape (nj,)
        +1 or -1.
    """

    index: np.ndarray
    sign: np.ndarray

    __repr__ = brief

    def __call__(self, angles: np.ndarray) -> np.ndarray:
        """Mirror postures (..., nj) [rad]."""
        return self.sign * angles[..., self.index]


@dataclass(frozen=True, eq=False)
class Gait:
    """Key poses over one stride.

    Attributes
    ----------
    joint_names : tuple of str
        Names of the joints.
    poses : ndarray, shape (n_poses, nj)
        Joint angles [rad]; pose k is at time k / n_poses of the period.
    period : float
        Time of a stride [s].
    mirror : Mirror, optional
        With it, the second half of the poses is the first half mirrored left to right.
    """

    joint_names: tuple[str, ...]
    poses: np.ndarray
    period: float
    mirror: Mirror | None = None

    __repr__ = brief

    def __post_init__(self) -> None:
        names = texts("gait: joint_names", self.joint_names)
        poses = np.array(floats("gait: poses", self.poses))
        if poses.ndim != 2 or poses.shape[1] != len(names) or len(poses) < 3:
            raise ValueError(f"gait: poses must be (>= 3, {len(names)}), got {poses.shape}, of as many joint_names")
        if not np.isfinite(poses).all():
            pose, joint = np.argwhere(~np.isfinite(poses))[0]
            raise ValueError(f"gait: pose {pose} of joint {names[joint]!r} is not finite")
        object.__setattr__(self, "joint_names", tuple(names))
        object.__setattr__(self, "poses", poses)
        if not (is_real(self.period) and 0 < self.period < LONGEST):
            raise ValueError(f"gait: period = {shown(self.period)} s must be finite and > 0")
        _check_mirror(self.mirror, len(names), len(poses))

    def to_vector(self) -> np.ndarray:
        """Return the free poses as a vector (D,) [rad], pose by pose."""
        return self.poses[: self._free_poses].ravel()

    def from_vector(self, x: ArrayLike) -> Gait:
        """Return the gait with the free poses `x` (D,) [rad]; the exact inverse of `to_vector`."""
        x, free = floats("gait vector x", x), self._free_poses
        if x.shape != (free * len(self.joint_names),):
            raise ValueError(f"gait vector x must be ({free * len(self.joint_names)},), got {x.shape}")
        if not np.isfinite(x).all():
            raise ValueError(f"gait vector x is not finite at index {int(np.isfinite(x).argmin())}; correct it")
        poses = x.reshape(free, -1).copy()
        if self.mirror:
            poses = np.concatenate([poses, self.mirror(poses)])
        return replace(self, poses=poses)

    def angles(self, times: ArrayLike) -> np.ndarray:
        """Return joint angles (n, nj) [rad] at `times` (n,) [s] of the repeating stride."""
        return periodic_spline(self.poses, finite("times", times, (None,), "[s]") / self.period)

    @property
    def _free_poses(self) -> int:
        return len(self.poses) // 2 if self.mirror else len(self.poses)


@dataclass(frozen=True, eq=False)
class GaitFit:
    """A gait fitted to a stride.

    Attributes
    ----------
    gait : Gait
        The gait.
    phase : float
        Time of the stride at which the gait's first pose lies [s].
    rms, largest : ndarray, shape (nj,)
        Root mean square and largest absolute value of each joint's residual [deg].
    """

    gait: Gait
    phase: float
    rms: np.ndarray
    largest: np.ndarray

    __repr__ = brief


def mirror_of(model: Model) -> Mirror:
    """Pair the joints of `model` left to right by name ("left", "right"), else by place, and compare their axes.

    A rotation about ``(x, y, z)`` looks in the mirror like one about ``(-x, y, -z)``.

    Parameters
    ----------
    model : Model
        The robot.

    Returns
    -------
    Mirror
        The mirror image of its postures.

    Raises
    ------
    ValueError
        For a joint that has no partner, or whose partner's axis is not its mirror image.
    """
    check_model(model)
    names = model.joint_names
    places, axes = joint_places(model, np.zeros(len(names)))
    index, sign = [], []
    for k, name in enumerate(names):
        partner = SIDE.sub(lambda side: OTHER_SIDE[side[0]], name)
        if partner == name:
            found = partner_by_place(k, places, axes)
            if found is None:
                raise ValueError(f"joint {name!r} of {model.name!r} has no partner at its mirror image")
            partner = names[found]
        if partner not in names:
            raise ValueError(f"joint {name!r} of {model.name!r} has no partner {partner!r} on the other side")
        index.append(names.index(partner))
        cosine = mirrored_cosines(axes[index[-1:]], axes[k])[0]
        if abs(abs(cosine) - 1.0) > PARALLEL:
            raise ValueError(f"the axes of {name!r} and {partner!r} of {model.name!r} do not mirror each other")
        sign.append(float(np.sign(cosine)))
    return Mirror(np.array(index), np.array(sign))


def joint_places(model: Model, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the positions (nj, 3) [m] and axes (nj, 3) of the joints in a posture (nj,) [rad], seen from the root."""
    poses = link_poses(model, angles)
    rows = [link_index(model, joint.child) for joint in model.moving_joints]
    return poses.position[0, rows], joint_axes(model, poses)[0]


def partner_by_place(k: int, places: np.ndarray, axes: np.ndarray) -> int | None:
    """Find the joint at the mirror image of joint k, with a mirrored axis; None if there is none."""
    off = np.abs(places - places[k] * (1.0, -1.0, 1.0)).max(axis=1)
    fits = (off < ALIKE) & (np.abs(np.abs(mirrored_cosines(axes, axes[k])) - 1.0) < PARALLEL)
    return int(fits.argmax()) if fits.any() else None


def mirrored_cosines(axes: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Return the cosines (n,) of `axes` (n, 3) and the mirror image of `axis` (3,), as an axis of rotation."""
    return total(axes * (axis * (-1.0, 1.0, -1.0)))


def fit_gait(stride: Stride, n_poses: int = 4, *, mirror: Mirror | None = None, fit_phase: bool = False) -> GaitFit:
    """Fit key poses to a planned stride by least squares over its samples.

    Parameters
    ----------
    stride : Stride
        Of `Plan.stride` or `four_legged_stride`.
    n_poses : int
        Number of key poses.
    mirror : Mirror, optional
        With it only half of the poses are free.
    fit_phase : bool
        Whether the first pose may lie on any sample of the stride before the second pose, wherever the residual is
        least.

    Returns
    -------
    GaitFit
        The gait and its residual.
    """
    instance("stride", stride, Stride, "give what Plan.stride returns")
    n_poses = whole("n_poses", n_poses, 3, "give the number of key poses", len(stride.times))
    _check_mirror(mirror, len(stride.joint_names), n_poses)
    fit_phase = truth("fit_phase", fit_phase)
    phases = stride.times[stride.times < stride.period / n_poses] if fit_phase else stride.times[:1]
    fits = [_fit_at(stride, n_poses, mirror, phase) for phase in phases]
    return min(fits, key=lambda fit: total(fit.rms * fit.rms))


def references(
    gait: Gait, n_strides: int, start: ArrayLike, *, tick: float = TICK, blend_strides: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    """Sample a start and strides of a gait at every tick.

    Over its last `blend_strides` the start is blended into the gait with the weight ``3 s^2 - 2 s^3``; after it the
    gait plays alone.  The last sample is that of the first pose.

    Parameters
    ----------
    gait : Gait
        The gait.
    n_strides : int
        Number of strides after the start.
    start : array_like, shape (nj,) or (m, nj)
        A standing posture, which is held over `blend_strides`, or a start-up sampled at every tick that is in step with
        the gait (`Plan.start_up`) [rad].
    tick : float
        Time between samples [s]; the period must be a whole number of ticks.
    blend_strides : int
        Number of strides over which the start is blended.

    Returns
    -------
    times : ndarray, shape (n,)
        Times [s].
    angles : ndarray, shape (n, nj)
        Joint angles [rad].
    """
    instance("gait", gait, Gait, "give a Gait, as fit_gait(...).gait")
    n_strides = whole("n_strides", n_strides, 0, "give the number of strides", MOST_STRIDES)
    blend_strides = whole("blend_strides", blend_strides, 0, "give the number of strides", MOST_STRIDES)
    tick = real("tick", tick, SHORTEST, LONGEST, "give the time between samples [s]")
    per_stride = round(gait.period / tick)
    if abs(per_stride * tick - gait.period) > 1e-9:
        raise ValueError(
            f"gait: the period of {gait.period} s is not a whole number of ticks of {tick} s; "
            f"take {max(per_stride, 1) * tick:g} s"
        )
    ramp = blend_strides * per_stride
    start = floats("start", start)
    if not np.isfinite(start).all():
        raise ValueError("start has an angle that is not finite; correct it")
    if start.ndim == 1:
        start = np.tile(start, (ramp, 1))
    if start.shape[1:] != (len(gait.joint_names),) or len(start) < ramp:
        raise ValueError(f"start must be (nj,) or (>= {ramp}, nj) with nj = {len(gait.joint_names)}, got {start.shape}")
    stride = gait.angles(tick * np.arange(per_stride))
    s = np.arange(ramp)[:, None] / max(ramp, 1)
    weight = s * s * (3.0 - 2.0 * s)
    held, blended = np.split(start, [len(start) - ramp])
    blended = blended + weight * (np.tile(stride, (blend_strides, 1)) - blended)
    angles = np.concatenate([held, blended, np.tile(stride, (n_strides, 1)), stride[:1]])
    return tick * np.arange(len(angles)), angles


def bounds(model: Model, gait: Gait) -> np.ndarray:
    """Return lower and upper bounds of the gait vector from the joint limits.

    Parameters
    ----------
    model : Model
        The robot.
    gait : Gait
        A gait of its joints.

    Returns
    -------
    ndarray, shape (D, 2)
        Bounds [rad].
    """
    check_model(model)
    instance("gait", gait, Gait, "give a Gait, as fit_gait(...).gait")
    limits = joint_limits(model).T
    return np.tile(limits, (len(gait.to_vector()) // len(limits), 1))


def check_names(name: str, gait: Gait, angles: ArrayLike) -> None:
    """Raise ValueError unless angles (nj,) or (m, nj) fit the gait's joints."""
    a = floats(name, angles)
    if a.ndim not in (1, 2) or a.shape[-1] != len(gait.joint_names) or not np.isfinite(a).all():
        raise ValueError(f"{name} must be finite and ({len(gait.joint_names)},) or with as many columns, got {a.shape}")


def _check_mirror(mirror: Mirror | None, count: int, poses: int) -> None:
    if mirror is None:
        return
    instance("mirror", mirror, Mirror, "give what mirror_of returns, or None")
    if np.shape(mirror.index) != (count,) or np.shape(mirror.sign) != (count,):
        raise ValueError(f"mirror is of {np.shape(mirror.index)} joints; expected {count}: give mirror_of(model)")
    if poses % 2:
        raise ValueError(
            f"gait: a mirrored gait needs an even number of poses (n_poses), got {poses}: give {poses + 1}"
        )


def periodic_spline(values: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Evaluate at `s` (n,), in periods, the periodic cubic spline through `values` (k, ...), evenly spaced.

    The second derivatives solve ``M_(i-1) + 4 M_i + M_(i+1) = 6 (y_(i-1) - 2 y_i + y_(i+1))``, with the unit of length
    the gap between values; the inverse of that circulant matrix is known in closed form.  Only sums and products are
    used, so that the bits are the same on every machine.
    """
    k = len(values)
    u = np.mod(s, 1.0) * k
    i = np.minimum(u.astype(int), k - 1)
    right = (u - i).reshape(-1, *(1,) * (values.ndim - 1))
    left = 1.0 - right
    z = np.sqrt(3.0) - 2.0  # root of z^2 + 4 z + 1
    power = np.cumprod(np.concatenate([[1.0], np.full(k, z)]))
    green = (power[:k] + power[:0:-1]) / ((1.0 - power[k]) * 2.0 * np.sqrt(3.0))
    rhs = 6.0 * (np.roll(values, 1, axis=0) - 2.0 * values + np.roll(values, -1, axis=0))
    M = np.zeros_like(values)
    for j in range(k):
        M += green[j] * np.roll(rhs, j, axis=0)
    j = (i + 1) % k
    bent = (left * left * left - left) * M[i] + (right * right * right - right) * M[j]
    return left * values[i] + right * values[j] + bent / 6.0


def _fit_at(stride: Stride, n_poses: int, mirror: Mirror | None, phase: float) -> GaitFit:
    angles = stride.angles
    if mirror:
        half = len(angles) // 2
        angles = 0.5 * (angles + mirror(np.roll(angles, -half, axis=0)))
    basis = periodic_spline(np.eye(n_poses), (stride.times - phase) / stride.period)
    poses = np.round(solve(product(basis.T, basis), product(basis.T, angles)), DECIMALS)
    gait = Gait(stride.joint_names, poses, stride.period, mirror)
    gait = gait.from_vector(gait.to_vector())
    residual = np.degrees(gait.angles(stride.times - phase) - stride.angles)
    rms = np.sqrt(total(residual * residual, axis=0) / len(residual))
    return GaitFit(gait, float(phase), rms, np.abs(residual).max(axis=0))
