"""Plans of a straight walk by the zero-moment point (ZMP): footsteps, center of mass, feet, joint angles.

The ZMP reference rests on the standing foot's sole and moves over to the other in double support.  Preview control of
a cart-table turns it into a motion of the center of mass; the trunk, upright and level, is placed so that the whole
model's center of mass follows it; the swing foot goes through the air with its sole level; leg inverse kinematics gives
the joint angles.

A first plan treats the robot as a cart-table and misses what the legs' own swinging does to the ZMP.  As in
S. Kajita et al., "Biped walking pattern generation by using preview control of zero-moment point", ICRA 2003,
section 5, the error of the multibody ZMP goes through the preview controller once more and corrects the motion of the
center of mass.  Once is enough: on a robot of 0.43 m it takes the ZMP's rms error from 6 and 5 mm (ahead, sideways) to
3 and 2 mm; what remains comes from the swing foot's lift-off and touch-down, and each further pass looks another
preview ahead, for which there would have to be as much more standing before the walk.  That robot's center of mass
moves in its trunk by up to 1, 4 and 5 mm (ahead, sideways, up), which is what taking it as fixed there would miss.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import finite, is_real, one_of, real, shown, whole
from ..base.brief import brief
from ..base.portable_math import sincos
from ..dynamics import check_model
from ..dynamics.tree import GRAVITY
from ..model import Model
from .auxiliary_zmp import plan_com_auxiliary
from .inverse_kinematics import check_limits, closed, reach
from .kinematics import center_of_mass
from .preview_control import plan_com
from .stance import Sole, default_posture, first_base, soles_of
from .zero_moment_point import multibody_zmp, polygon_margin, support_polygon

Preview: TypeAlias = Literal["cart_table", "auxiliary_zmp"]
FOLLOWED = 1e-9  # tolerance of the center of mass along its path [m]
TINY, HUGE = 1e-12, 1e12  # settings of a walk [SI]
MOST_STEPS, MOST_SAMPLES = 10**4, 10**5  # of a walk; of a step, and of preview
STILL = 1e-3  # change of an angle by which the walk has begun [rad]
DECIMALS = 9  # of the angles [rad]: a plan survives changes of last bits; far below any servo's resolution

# With this walk four poses a stride carry a humanoid of the size of a Bioloid, on AX-12 servos and without feedback; of
# 256 gaits with all angles off by up to a degree 88 % walk ten strides.  3 mm narrower it is 79 %, 5 mm higher 86 %,
# with steps of 0.36 s 86 %, and with those of 0.24 s or the defaults of `WalkSettings` the gait itself falls; 3 mm
# wider it is 92 %, but slower; 5 mm lower the knees pass their limits.
BIOLOID_WALK = {"step_time": 0.32, "com_height": 0.205, "half_width": 0.039, "n_steps": 12}


@dataclass(frozen=True)
class WalkSettings:
    """Settings of a walk: a start from standing, steps of the same length, feet together at the end.

    Attributes
    ----------
    step_length : float
        Length of a step [m]; a swinging foot travels two.
    step_time : float
        Time of a step [s].
    n_steps : int
        Number of steps.
    com_height : float
        Height of the model's center of mass above the ground [m].
    half_width : float
        Distance from the walking line to the middle of a sole [m].
    lift : float
        Height to which the swinging sole is lifted [m].
    double_support : float
        Share of a step in which both feet stand [-].
    T : float
        Sample time [s].
    N : int
        Samples of preview; they should last about 8 sqrt(com_height / g).
    Q : float
        Weight of the ZMP error [1/m^2].
    R : float
        Weight of the change of jerk [s^6/m^2]; with "auxiliary_zmp", of the ZMP's speed [s^2/m^2].
    g : float
        Strength of gravity, which points straight down [m/s^2].
    preview : {"cart_table", "auxiliary_zmp"}
        Controller: that of `preview_control` or of `auxiliary_zmp`.
    """

    step_length: float = 0.025
    step_time: float = 0.32
    n_steps: int = 16
    com_height: float = 0.215
    half_width: float = 0.036
    lift: float = 0.025
    double_support: float = 0.2
    T: float = 0.01
    N: int = 120
    Q: float = 1.0
    R: float = 1e-7
    g: float = -GRAVITY[2]
    preview: Preview = "cart_table"

    __repr__ = brief

    def __post_init__(self) -> None:
        for one in fields(self):  # numbers of less precision would make times that miss the samples
            value, low = getattr(self, one.name), -HUGE if one.name == "step_length" else TINY
            if one.type == "float":
                if not (is_real(value) and low < value < HUGE):
                    expected = "lie between 0 and 1" if one.name == "double_support" else "be finite"
                    expected += " and > 0" if expected == "be finite" and low > 0 else ""
                    raise ValueError(f"walk: {one.name} = {shown(value)} must {expected}")
                object.__setattr__(self, one.name, float(value))
        if self.double_support >= 1.0:
            raise ValueError(f"walk: double_support = {self.double_support} must lie between 0 and 1")
        for name, least, most, remedy in (
            ("n_steps", 4, MOST_STEPS, "a settled stride takes some 16"),
            ("N", 1, MOST_SAMPLES, "give the samples of preview"),
        ):
            object.__setattr__(self, name, whole(f"walk: {name}", getattr(self, name), least, remedy, most))
        one_of("walk: preview", self.preview, get_args(Preview))
        if self.step_time / self.T > MOST_SAMPLES:
            raise ValueError(f"walk: step_time = {self.step_time} s is over {MOST_SAMPLES} samples T = {self.T} s")
        if abs(self.step_samples * self.T - self.step_time) > 1e-9:
            raise ValueError(f"walk: step_time = {self.step_time} s must be a whole number of samples T = {self.T} s")

    @property
    def step_samples(self) -> int:
        """Number of samples in a step."""
        return round(self.step_time / self.T)

    @property
    def start(self) -> float:
        """Time at which the weight passes to the first standing foot [s]; all of the preview lies before it."""
        return (self.N + self.step_samples) * self.T

    @property
    def end(self) -> float:
        """Time at which the last step ends [s]."""
        return self.start + self.n_steps * self.step_time


@dataclass(frozen=True, eq=False)
class Stride:
    """Two steps of a settled walk, from the middle of one double support to that two steps later.

    Attributes
    ----------
    joint_names : tuple of str
        Names of the joints.
    times : ndarray, shape (n,)
        Times from 0, without the period's end [s].
    angles : ndarray, shape (n, nj)
        Joint angles [rad].
    period : float
        Time of the stride [s].
    mismatch : float
        Largest difference to the angles one period later [rad].
    """

    joint_names: tuple[str, ...]
    times: np.ndarray
    angles: np.ndarray
    period: float
    mismatch: float

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class Plan:
    """A planned walk, in world axes: x ahead, y left, z up, ground at z = 0.

    Attributes
    ----------
    walk : WalkSettings
        The settings.
    joint_names : tuple of str
        Names of the joints.
    times : ndarray, shape (n,)
        Times [s].
    angles : ndarray, shape (n, nj)
        Joint angles [rad].
    base_position : ndarray, shape (n, 3)
        Position of the root link, which stays upright and level [m].
    com : ndarray, shape (n, 3)
        Center of mass of the whole model [m].
    feet : ndarray, shape (n, 2, 3)
        Middles of the left and the right sole [m].
    contact : ndarray of bool, shape (n, 2)
        Whether the left and the right foot stand.
    support : tuple of ndarray, shape (k, 2)
        Support polygons, convex and counter-clockwise [m].
    zmp_reference : ndarray, shape (n, 2)
        Reference of the zero-moment point (ZMP) [m].
    zmp : ndarray, shape (n, 2)
        ZMP of the moving links, by central differences [m].
    """

    walk: WalkSettings
    joint_names: tuple[str, ...]
    times: np.ndarray
    angles: np.ndarray
    base_position: np.ndarray
    com: np.ndarray
    feet: np.ndarray
    contact: np.ndarray
    support: tuple[np.ndarray, ...]
    zmp_reference: np.ndarray
    zmp: np.ndarray

    __repr__ = brief

    @property
    def standing(self) -> np.ndarray:
        """Posture (nj,) [rad] in which the walk starts."""
        return self.angles[0]

    @property
    def period(self) -> float:
        """Time of a stride, two steps [s]."""
        return 2 * self.walk.step_time

    def margin(self) -> np.ndarray:
        """Return the distance (n,) [m] of the ZMP from the edge of the support polygon; negative is outside."""
        return np.array([polygon_margin(p, polygon) for p, polygon in zip(self.zmp, self.support)])

    def stride(self) -> Stride:
        """Extract the stride in the middle of the walk.

        Raises ValueError if the walk does not repeat there to 1e-3 rad.
        """
        n = 2 * self.walk.step_samples
        first = round(self.walk.start / self.walk.T) + n * ((self.walk.n_steps - 3) // 4)
        angles = self.angles[first : first + n]
        mismatch = float(np.abs(self.angles[first + n : first + 2 * n] - angles).max())
        if mismatch > 1e-3:
            raise ValueError(f"the walk has not settled ({mismatch:.1e} rad from stride to stride); plan more n_steps")
        return Stride(self.joint_names, self.walk.T * np.arange(n), angles, self.period, mismatch)

    def start_up(self, strides: int = 2, *, tick: float = 0.04, phase: float = 0.0) -> np.ndarray:
        """Sample the walk at every `tick` [s] from standing still to `phase` [s] after the first `strides` strides.

        Returns joint angles (m, nj) [rad]; the next sample would be that of the stride at `phase`.  Raises ValueError
        if the walk is shorter.
        """
        if 2 * strides >= self.walk.n_steps:
            raise ValueError(f"a start-up of {strides} strides needs n_steps > {2 * strides}, got {self.walk.n_steps}")
        end = self.walk.start + strides * self.period + phase
        moving = (np.abs(self.angles - self.standing) > STILL).any(axis=1)
        ticks = int(np.ceil((end - self.times[moving.argmax()]) / tick)) + 1
        times = end - tick * np.arange(ticks, 0, -1)
        return _interpolated(times, self.times, self.angles)


def downward(gravity: Iterable[float]) -> float:
    """Return the strength of `gravity` (3,) [m/s^2]; raise ValueError unless it points along -z."""
    x, y, z = map(float, gravity)
    if x != 0.0 or y != 0.0 or not -np.inf < z < 0.0:
        raise ValueError(
            f"walk: gravity ({x:g}, {y:g}, {z:g}) m/s^2 must point straight down, along -z; for a walk on a hill keep "
            "it so and tilt the ground: Ground(slope=...)"
        )
    return -z


def walking_plan(
    model: Model,
    *,
    feet: Sequence[str] | None = None,
    posture: ArrayLike | None = None,
    followed: float = FOLLOWED,
    **settings: Any,
) -> Plan:
    """Plan the walk of a biped.

    Parameters
    ----------
    model : Model
        The robot.
    feet : sequence of str, optional
        Links of the left and the right foot; by default the two that carry the lowest contact points.
    posture : array_like, shape (nj,), optional
        Posture that the joints outside the legs keep and that decides how the knees bend [rad]; by default the keyframe
        "stand", "standing" or "home", without one the middle of the ranges of the leg joints, 0 elsewhere.
    followed : float
        Tolerance of the center of mass along its path [m]; with 1e-5 a plan takes half the time.
    **settings
        Settings of `WalkSettings`.

    Returns
    -------
    Plan
        The planned walk.

    Raises
    ------
    ValueError
        If the model does not have two soles, or a posture is out of reach.
    """
    check_model(model)
    walk = WalkSettings(**settings)
    followed = real("followed", followed, FOLLOWED, 1e-3, "give a distance [m]")
    soles = soles_of(model, feet)
    n = len(model.joint_names)
    posture = default_posture(model, soles) if posture is None else finite("posture", posture, (n,), "[rad]")
    times = walk.T * np.arange(round((walk.end + walk.start) / walk.T) + 1)
    footholds = _footholds(walk)
    feet_path, contact = _feet_path(walk, footholds, times)
    zmp_reference = _zmp_reference(walk, footholds, times)
    com = _com_path(walk, zmp_reference, walk.com_height)
    base = first_base(model, soles, posture, com)
    angles, base = _follow(model, soles, feet_path, com, posture, base, times, followed)
    error = zmp_reference - multibody_zmp(model, angles, base, walk.T, walk.g)
    correction = _com_path(walk, error, 0.0)
    com = com + correction
    angles, base = _follow(model, soles, feet_path, com, angles, base + correction, times, followed)
    angles = np.round(angles, DECIMALS)
    check_limits(model, angles, times)
    corners = feet_path[:, :, None, :2] + np.stack([sole.corners for sole in soles])
    support = tuple(support_polygon(np.concatenate(each[stands])) for each, stands in zip(corners, contact))
    zmp = multibody_zmp(model, angles, base, walk.T, walk.g)
    return Plan(walk, model.joint_names, times, angles, base, com, feet_path, contact, support, zmp_reference, zmp)


def _footholds(walk: WalkSettings) -> np.ndarray:
    """Return where the soles' middles stand (steps + 1, 2 feet, 2) before each step and after the last [m].

    The left foot stands in even steps.
    """
    x = np.zeros((walk.n_steps + 1, 2))
    for i in range(walk.n_steps):
        x[i + 1] = x[i, i % 2]
        x[i + 1, 1 - i % 2] += walk.step_length if i < walk.n_steps - 1 else 0.0
    y = np.broadcast_to([walk.half_width, -walk.half_width], x.shape)
    return np.stack([x, y], axis=-1)


def _feet_path(walk: WalkSettings, footholds: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the soles' paths (n, 2, 3) [m] and whether they stand (n, 2)."""
    path = np.zeros((len(times), 2, 3))
    contact = np.ones((len(times), 2), dtype=bool)
    path[..., :2] = footholds[0]
    swing_time = (1.0 - walk.double_support) * walk.step_time
    for i in range(walk.n_steps):
        foot = 1 - i % 2
        s = (times - walk.start - (i + 0.5 * walk.double_support) * walk.step_time) / swing_time
        going, gone = (s > 1e-9) & (s < 1.0 - 1e-9), s > 0.0
        way, passed = footholds[i + 1, foot] - footholds[i, foot], np.clip(s[gone], 0.0, 1.0)
        path[gone, foot, :2] = footholds[i, foot] + np.outer(passed * passed * (3.0 - 2.0 * passed), way)
        # Steep at both ends, so that a foot on a sagging leg clears the ground.
        path[going, foot, 2] = walk.lift * sincos(np.pi * s[going])[0]
        contact[going, foot] = False
    return path, contact


def _zmp_reference(walk: WalkSettings, footholds: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return the ZMP reference (n, 2) [m]: the middle of the standing sole; in double support, a line to the next."""
    standing = [footholds[i, i % 2] for i in range(walk.n_steps)]
    rests = [footholds[0].mean(axis=0), *standing, footholds[-1].mean(axis=0)]
    changes = walk.start + walk.step_time * np.arange(walk.n_steps + 1)
    half = 0.5 * walk.double_support * walk.step_time
    knots = np.stack([changes - half, changes + half], axis=1).ravel()
    values = np.repeat(np.array(rests), 2, axis=0)[1:-1]
    return _interpolated(times, knots, values)


def _interpolated(times: np.ndarray, knots: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Interpolate values (k, m) at rising `knots` (k,) linearly at `times` (n,), constant before and after."""
    slopes = np.zeros_like(values)
    slopes[:-1] = np.diff(values, axis=0) / np.diff(knots)[:, None]
    k = np.maximum(np.searchsorted(knots, times, side="right") - 1, 0)
    return slopes[k] * (np.clip(times, knots[0], knots[-1]) - knots[k])[:, None] + values[k]


def _com_path(walk: WalkSettings, zmp: np.ndarray, height: float) -> np.ndarray:
    """Return the path (n, 3) [m], at a height, of the center of mass whose ZMP is `zmp` (n, 2)."""
    planned = plan_com if walk.preview == "cart_table" else plan_com_auxiliary
    position = planned(zmp, walk.T, walk.com_height, N=walk.N, Q=walk.Q, R=walk.R, g=walk.g).position
    return np.column_stack([position, np.full(len(position), height)])


def _follow(
    model: Model,
    soles: Sequence[Sole],
    feet_path: np.ndarray,
    com: np.ndarray,
    angles: np.ndarray,
    base: np.ndarray,
    times: np.ndarray,
    followed: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Find joint angles and root positions with the soles on `feet_path` and the center of mass on `com`.

    A fixed-point iteration from `angles` and `base`: the root moves by the error of the center of mass, the legs
    follow.  The caller checks the joint limits: the iteration may pass them.
    """
    for _ in range(100):
        for k, sole in enumerate(soles):
            angles = reach(
                model, sole.link, feet_path[:, k] - base, point=sole.middle, rotation=sole.rotation,
                joints=sole.joints, start=angles, times=times, tolerance=1e-2 * followed,
            )  # fmt: skip
        angles = closed(model, angles, (column for sole in soles for column in sole.joints))
        missed = com - center_of_mass(model, angles, base)
        if np.abs(missed).max() < followed:
            return angles, base
        base = base + missed
    raise ValueError(f"the center of mass of {model.name!r} still misses its path by {np.abs(missed).max():.1e} m")
