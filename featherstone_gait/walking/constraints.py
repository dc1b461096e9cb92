"""Constraints of a gait as penalties, which are reported apart from its cost.

    penalty = weight * sum over the components of the mean over the measured time of max(0, violation)^2,

the quadratic penalty of J. Nocedal, S. Wright, "Numerical Optimization" (2nd ed., Springer 2006), section 17.1, taken
from outside: exactly zero where a limit is kept, so that it leaves the costs of sound gaits alone; continuous with its
gradient where it is passed, so that a search from a gait that passes it finds the way back; and never infinite.  The
mean over time, not the largest value: the support polygon grows by a whole foot at a touch-down, whose time moves with
the gait, and the largest value would jump with it.  A penalty gives way where that is cheaper: what remains of a
violation falls in proportion to 1 / weight, and the report says how large it is.  A trajectory is looked at every
10 ms: what happens between two samples is not seen.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import instance, is_real, shown
from ..base.brief import brief
from ..dynamics import contact_positions_at, forward_kinematics
from ..dynamics.tree import GRAVITY
from ..geometry.distance import clearance
from ..model import Model
from ..run.trajectory import Trajectory
from .cost import LOADED, RECORD, BatchCost, Measures, WalkingCost, window_of
from .kinematics import joint_limits

Channels = Mapping[str, np.ndarray]  # a `Trajectory`, or as much of one as is needed

ALIKE = 1e-9  # points of the sole closer than this are one [m]


@dataclass(frozen=True)
class Constraints:
    """Limits of a gait and the weights of their penalties; a limit of None is not checked.

    With the default weights, violations of 0.1 N m, 1 degree, 1 mm of slip, 10 mm of ZMP and 1 mm of clearance, root
    mean square over the measured time, each cost 1 J/m.

    Attributes
    ----------
    torque : float or None
        Largest torque of a servo, at the joint [N m].
    joint_margin : float or None
        Least distance from the joint limits [rad].
    slip : float or None
        Largest path of a contact point under load [m per stride]; see `Measures.slip`.
    zmp_margin : float or None
        Least distance of the zero-moment point (ZMP) from the edge of the support polygon [m].
    clearance : float or None
        Least distance between links that could collide [m].
    torque_weight, joint_weight : float
        Weights of the sums over the joints [J/m per (N m)^2, J/m per rad^2].
    slip_weight, zmp_weight, clearance_weight : float
        Weights [J/m per m^2].
    """

    torque: float | None = None
    joint_margin: float | None = None
    slip: float | None = None
    zmp_margin: float | None = None
    clearance: float | None = None
    torque_weight: float = 1e2
    joint_weight: float = math.degrees(1.0) ** 2
    slip_weight: float = 1e6
    zmp_weight: float = 1e4
    clearance_weight: float = 1e6

    __repr__ = brief

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if value is not None and not (is_real(value) and 0.0 <= value < math.inf):
                raise ValueError(f"constraints: {field.name} = {shown(value)} must be >= 0 and finite")

    @property
    def weights(self) -> dict[str, float]:
        """Weights of the limits that are set, by name."""
        names = ("torque", "joint_margin", "slip", "zmp_margin", "clearance")
        set_ = [name for name in names if getattr(self, name) is not None]
        return {name: getattr(self, f"{name.removesuffix('_margin')}_weight") for name in set_}

    def violations(
        self, model: Model, run: Channels, window: slice, slip: float, gravity: Sequence[float] | np.ndarray = GRAVITY
    ) -> dict[str, np.ndarray]:
        """Return the violation of each limit that is set, negative where the limit is met.

        run: with the channels `cost.RECORD` and torque; window: of its samples; slip [m per stride]; gravity (3,): of
        the scene [m/s^2].  The arrays are (samples, components) in the limit's unit.
        """
        found = {}
        if self.torque is not None:
            found["torque"] = np.abs(run["torque"][window]) - self.torque
        if self.joint_margin is not None:
            (lower, upper), q = joint_limits(model), run["q"][window]
            found["joint_margin"] = self.joint_margin - np.minimum(q - lower, upper - q)
        if self.slip is not None:
            found["slip"] = np.array([[slip - self.slip]])
        if self.zmp_margin is not None:
            found["zmp_margin"] = self.zmp_margin - zmp_margins(model, run, window, gravity)[:, None]
        if self.clearance is not None:
            q = np.hstack([run["base_q"], run["q"]])[window]
            found["clearance"] = self.clearance - clearance(model, q).distance[:, None]
        return found


@dataclass(frozen=True)
class ConstraintReport:
    """Cost and penalties of a gait; numbers are nan or infinite if it does not walk.

    Attributes
    ----------
    measures : Measures
        Measures of the walk.
    penalties : dict of str to float
        Penalties by the name of the limit [J/m].
    violations : dict of str to float
        Largest violations in the limit's unit; 0 where the limit is met.
    """

    measures: Measures
    penalties: dict[str, float]
    violations: dict[str, float]

    __repr__ = brief

    @property
    def cost(self) -> float:
        """Energy per distance [J/m]."""
        return self.measures.cost

    @property
    def total(self) -> float:
        """Sum of cost and penalties [J/m]."""
        return self.cost + sum(self.penalties.values()) if math.isfinite(self.cost) else math.inf


@dataclass(frozen=True, eq=False)
class ConstrainedCost(BatchCost):
    """The cost of walking plus the penalties of constraints, for the same searches as `WalkingCost`.

    Attributes
    ----------
    walking : WalkingCost
        The cost without penalties.
    constraints : Constraints
        The limits and weights.
    """

    walking: WalkingCost
    constraints: Constraints

    __repr__ = brief

    def __post_init__(self) -> None:
        instance("walking", self.walking, WalkingCost, "give WalkingCost(scene, gait, start)")
        instance("constraints", self.constraints, Constraints, "give Constraints(...)")

    def costs(self, vectors: Iterable[ArrayLike]) -> list[tuple[float, str]]:
        """Evaluate many vectors at once; for the searches ``map=ConstrainedCost.costs``."""
        return [(report.total, report.measures.status) for report in self.reports(vectors)]

    def report(self, x: ArrayLike) -> ConstraintReport:
        """Return cost, penalties and violations of one vector."""
        return self.reports([x])[0]

    def reports(self, vectors: Iterable[ArrayLike]) -> list[ConstraintReport]:
        """Simulate gait vectors once and report on each."""
        return [self._report(run) for run in self.walking.simulate(vectors, record=(*RECORD, "torque"))]

    def _report(self, run: Trajectory) -> ConstraintReport:
        cost, names = self.walking, self.constraints.weights
        scene, measures = cost.scene, cost.measured(run)
        if measures.status != "ok":
            return ConstraintReport(measures, dict.fromkeys(names, math.nan), dict.fromkeys(names, math.nan))
        window = window_of(run, cost.mark, cost.end)
        found = self.constraints.violations(scene.model, run, window, measures.slip, scene.gravity)
        excess = {name: np.maximum(violation, 0.0) for name, violation in found.items()}
        penalties = {name: names[name] * float((e**2).mean(axis=0).sum()) for name, e in excess.items()}
        return ConstraintReport(measures, penalties, {name: float(e.max()) for name, e in excess.items()})


def zmp_margins(
    model: Model, run: Channels, window: slice = slice(None), gravity: Sequence[float] | np.ndarray = GRAVITY
) -> np.ndarray:
    """Return the distance (n,) [m] of the ZMP from the edge of the support polygon, inside positive.

    run: with the channels base_q, q and contact_force.

    The ZMP is the center of pressure of the contact points, with which it coincides on level ground (M. Vukobratovic,
    B. Borovac, Int. J. Humanoid Robotics 1 (2004), section 2).  A simulation knows it exactly; `multibody_zmp`, which
    takes the trunk as upright and differentiates twice, misses it by 8 mm on the humanoid's first gait.  The polygon is
    that of all contact points of the links that bear more than `LOADED` of the weight in `gravity` (3,) [m/s^2]: on
    tiptoe, on the edge of a sole, the margin is 0, and in the air, where there is no ZMP, it is taken as 0.
    """
    poses = forward_kinematics(model, np.hstack([run["base_q"], run["q"]])[window])
    points = contact_positions_at(model, poses)[..., :2]
    force = run["contact_force"][window, :, 0]
    links = np.array([contact.link for contact in model.contacts])
    together = links[:, None] == links
    stands = force @ together > LOADED * model.mass * math.hypot(*gravity)
    force = np.where(stands, force, 0.0)
    pressed = stands.any(axis=1)
    zmp = np.einsum("nk,nki->ni", force, points) / np.where(pressed, force.sum(axis=1), 1.0)[:, None]
    return np.where(pressed, hull_margins(zmp, points, stands), 0.0)


def hull_margins(point: np.ndarray, points: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Return how far `point` (n, 2) lies inside the convex hull of those `points` (n, m, 2) that are `used` (n, m).

    Like `polygon_margin`, but for many hulls of a few points: a side of the hull is a pair of points that has all
    others to its left; nan where there is no pair.
    """
    edge = points[:, None, :, :] - points[:, :, None, :]  # (n, from, to, 2)
    length = np.linalg.norm(edge, axis=-1)
    pair = used[:, :, None] & used[:, None, :] & (length > ALIKE)
    along = edge / np.where(pair, length, 1.0)[..., None]
    normal = np.stack([-along[..., 1], along[..., 0]], axis=-1)  # to the left
    offset = np.einsum("nijx,nix->nij", normal, points)
    left = np.einsum("nijx,nkx->nijk", normal, points) - offset[..., None]
    side = pair & np.where(used[:, None, None, :], left >= -ALIKE, True).all(axis=-1)
    margin = np.einsum("nijx,nx->nij", normal, point) - offset
    least = np.where(side, margin, np.inf).min(axis=(1, 2))
    return np.where(side.any(axis=(1, 2)), least, np.nan)
