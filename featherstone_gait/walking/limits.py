"""Limits of a real robot: by how much a run violates them, and where it is worst.

    swing    height of the lowest point of a foot while the foot is faster than half of its largest speed [m]
    tilt     angle between a sole and the ground while it bears more than a tenth of the robot's weight [rad]
    apart    distance between links of different limbs [m]
    torque   torque of a joint over the stall torque of its servo at its supply voltage
    line     (R I + k v) / supply: the share of the voltage that current and speed need; 1 is the torque-speed line
    drift    sideways over forward displacement

The first five are quantities over time, reported with joint or foot and time.  Drift is of a whole run; of several
worlds it is the signed mean, because a gait whose legs mirror each other drifts to either side alike.  Only `apart`
follows from the references, without a simulation.  The others do not: a servo as stiff as the AX-12 yields by 2 degrees
under 0.5 N m and lags, so that of 25 mm of planned lift 5 remain.

The thresholds (half of the foot's largest speed in the run, a tenth of the weight) and the absolute value of the
voltage R I + k v, braking included, are conventions that the report's figures depend on.

A search sees by how much each quantity violates its limit at each moment of each stride, in units of `scale` and with
limits that are stricter by `margin` (`Watch.beyond`).  The ground is level, at height 0.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..base.arguments import instance
from ..base.fixed_order import total
from ..dynamics import contact_positions_at, forward_kinematics
from ..geometry.distance import clearance, meeting_shapes, shape_distances
from ..identification.curve import torque_speed
from ..model import TORQUE_LAWS, Model, Servo, depth_first
from ..run.trajectory import Trajectory
from ..scene.compile import CompiledScene
from .kinematics import upright_states

RECORD = ("base_q", "q", "qd", "torque", "current", "contact_force", "energy")
FAST = 0.5  # of its largest speed: a foot that swings
BEARS = 0.1  # of the robot's weight: a foot that stands
FADES = 6.0  # scales by which a violation is reduced where the quantity does not count at all
TINY = 1e-30  # squared speed of feet that do not move [m^2/s^2]


class Limit(NamedTuple):
    """A bound, and its weight in a search."""

    name: str
    what: str
    unit: str
    bound: float  # [SI]
    most: bool  # whether it is an upper bound, not a lower one
    margin: float  # distance that a search keeps from the bound
    scale: float  # unit of its violations


LIMITS = (
    Limit("swing", "fast foot over the ground", "m", 5e-3, False, 1e-3, 5e-3),
    Limit("tilt", "loaded sole against the ground", "rad", math.radians(5.0), True, math.radians(1.6),
          math.radians(3.0)),
    Limit("apart", "links apart", "m", 5e-3, False, 1e-3, 5e-3),
    Limit("torque", "torque over stall torque", "-", 0.8, True, 0.05, 0.2),
    Limit("line", "voltage taken over supply", "-", 0.8, True, 0.03, 0.2),
    Limit("drift", "sideways over forwards", "-", 0.02, True, 0.01, 0.04),
)  # fmt: skip
BY_NAME = {limit.name: limit for limit in LIMITS}


class Worst(NamedTuple):
    """The worst value of a quantity."""

    name: str
    value: float  # nan if the quantity never counts
    where: str  # joint, foot or links
    time: float  # [s]; nan of a whole run
    share: float  # of the samples that count, of those beyond the bound

    @property
    def kept(self) -> bool:
        """True if the bound is met, as it is if the quantity never counts."""
        limit = BY_NAME[self.name]
        return not (self.value > limit.bound if limit.most else self.value < limit.bound)

    def as_dict(self) -> dict:
        """Return the values for JSON."""
        limit = BY_NAME[self.name]
        named = self._asdict() | {key: getattr(limit, key) for key in ("what", "unit", "bound", "most")}
        named["kept"] = self.kept
        return {key: None if isinstance(x, float) and math.isnan(x) else x for key, x in named.items()}


@dataclass(frozen=True, eq=False)
class Quantity:
    """A quantity over time."""

    values: np.ndarray  # (n, parts)
    share: np.ndarray  # (n, parts) of the threshold from which it counts: it does from 1 on
    parts: Sequence[str]  # names (parts,), or (n,) of a quantity with one part at a time

    def worst(self, name: str, times: np.ndarray) -> Worst:
        """Find the worst value; times (n,) [s]."""
        limit, values, counts = BY_NAME[name], self.values, self.share >= 1.0
        if not counts.any():
            return Worst(name, math.nan, "", math.nan, 0.0)
        signed = np.where(counts, values if limit.most else -values, -np.inf)
        row, part = np.unravel_index(signed.argmax(), values.shape)
        where = self.parts[int(part) if len(self.parts) == values.shape[1] else int(row)]
        beyond = signed > (limit.bound if limit.most else -limit.bound)
        return Worst(name, float(values[row, part]), where, float(times[row]), float(beyond.sum() / counts.sum()))

    def beyond(self, limit: Limit) -> np.ndarray:
        """Return the violations (n, parts) of the bound less its margin, in units of the scale.

        They are reduced where the quantity does not count, in proportion: so they change steadily with the gait.
        """
        beyond = ((self.values - limit.bound) * (1.0 if limit.most else -1.0) + limit.margin) / limit.scale
        return beyond - FADES * np.maximum(1.0 - self.share, 0.0)


class Watch:
    """Measures the limited quantities of a robot's runs with `RECORD`, in scenes that differ in numbers alone.

    standing (nj,) [rad]: the posture in which the walk starts, base upright and soles level.
    """

    def __init__(self, model: Model, standing: np.ndarray) -> None:
        instance("model", model, Model, "give what load_robot returns")
        self.model = model
        self.standing = np.asarray(standing, dtype=float)
        owners = [contact.link for contact in model.contacts]
        self.feet = tuple(dict.fromkeys(owners))
        self._foot = np.array([self.feet.index(name) for name in owners])  # (points,) which foot a contact point is of
        upright = forward_kinematics(model, upright_states(model, self.standing), self.feet)
        self._normals = upright.rotation[0, :, 2]  # of the soles, link axes
        pairs, limit = self._of_limbs(), BY_NAME["apart"]
        distance = shape_distances(model, upright_states(model, self.standing)[0], pairs)
        self.pairs = pairs[distance >= limit.bound + limit.margin]  # without those of `close`

    def close(self) -> list[tuple[str, str]]:
        """Return links of different limbs that are not watched: they are too close in the first posture already."""
        watched = {tuple(pair) for pair in self.pairs.tolist()}
        links = [shape.link for shape in self.model.shapes]
        left = (pair for pair in self._of_limbs().tolist() if tuple(pair) not in watched)
        return [*dict.fromkeys((links[a], links[b]) for a, b in left)]

    def _of_limbs(self) -> np.ndarray:
        """Return pairs of shapes on different branches; on the same branch the joint limits keep links apart."""
        shapes, above = self.model.shapes, {self.model.root: set[str]()}  # the ancestors of each link
        for joint in depth_first(self.model):
            above[joint.child] = above[joint.parent] | {joint.parent}
        pairs = [
            (a, b)
            for a, b in meeting_shapes(self.model).pairs.tolist()
            if shapes[a].link not in above[shapes[b].link] and shapes[b].link not in above[shapes[a].link]
        ]
        return np.array(pairs, dtype=np.int64).reshape(-1, 2)

    def quantities(self, scene: CompiledScene, run: Trajectory, window: slice) -> dict[str, Quantity]:
        """Measure all quantities but `apart` in a window of a run's samples."""
        return self.of_feet(scene, run, window) | of_servos(scene, run, window)

    def beyond(self, scene: CompiledScene, run: Trajectory, window: slice, strides: int) -> np.ndarray:
        """Return `Quantity.beyond` of all quantities but `apart` (strides, moments times parts).

        The strides start at the first sample of the window.
        """
        n = (window.stop - window.start) // strides * strides
        found = self.quantities(scene, run, window)
        each = [quantity.beyond(BY_NAME[name])[:n].reshape(strides, -1) for name, quantity in found.items()]
        return np.concatenate(each, axis=1)

    def of_feet(self, scene: CompiledScene, run: Trajectory, window: slice) -> dict[str, Quantity]:
        """Measure swing and tilt."""
        model, normals = self.model, self._normals
        poses = forward_kinematics(model, np.hstack([run["base_q"], run["q"]])[window], self.feet)
        points = contact_positions_at(model, poses, self.feet)
        force = run["contact_force"][window, :, 0]
        weight = scene.model.mass * math.hypot(*scene.gravity)
        up = poses.rotation[:, :, 2, :]
        cosine = up[..., 0] * normals[:, 0] + up[..., 1] * normals[:, 1] + up[..., 2] * normals[:, 2]
        tilt = np.sqrt(2.0 * np.maximum(1.0 - cosine, 0.0))  # 2 sin(angle / 2), with the same bits everywhere
        height, fast, loaded = np.empty((3, *cosine.shape))
        for foot in range(len(self.feet)):
            own = np.flatnonzero(self._foot == foot)
            height[:, foot] = points[:, own, 2].min(axis=1)
            u, v = np.gradient(total(points[:, own, :2], axis=1), axis=0).T
            speed = u * u + v * v
            fast[:, foot] = np.sqrt(speed / max(speed.max(), TINY)) / FAST
            loaded[:, foot] = sum(force[:, k] for k in own) / (BEARS * weight)
        return {"swing": Quantity(height, fast, self.feet), "tilt": Quantity(tilt, loaded, self.feet)}

    def apart(self, q: np.ndarray) -> Quantity:
        """Measure how far links are apart in postures (n, nj) [rad]."""
        if not len(self.pairs):
            return Quantity(np.full((len(q), 1), np.inf), np.zeros((len(q), 1)), ("",))
        found = clearance(self.model, upright_states(self.model, q), self.pairs)
        names = [" and ".join(self.model.shapes[k].link for k in pair) for pair in found.shapes]
        return Quantity(found.distance[:, None], np.ones((len(q), 1)), names)

    def worst(self, scene: CompiledScene, run: Trajectory, window: slice) -> list[Worst]:
        """Find the worst value of each quantity in a window of a run, in the order of `LIMITS`."""
        found = self.quantities(scene, run, window) | {"apart": self.apart(run["q"][window])}
        times, base = run["time"][window], run["base_q"][window]
        ahead, sideways = (base[-1] - base[0])[:2].tolist()
        drift = Worst("drift", abs(sideways / ahead), "", math.nan, 0.0)
        return [found[one.name].worst(one.name, times) if one.name in found else drift
                for one in LIMITS if one.name in found or one.name == "drift"]  # fmt: skip


def of_servos(scene: CompiledScene, run: Trajectory, window: slice) -> dict[str, Quantity]:
    """Measure torque and line of the servos that drive motors; return nothing if there are none."""
    model = scene.model
    names = [name for name in model.joint_names if name in model.servos]
    driven, servos = [model.joint_names.index(name) for name in names], [model.servos[name] for name in names]
    if not scene.gearbox or not servos or any(servo.controller.law in TORQUE_LAWS for servo in servos):
        return {}
    columns = [(net_stall_torque(s), s.resistance, s.gearbox.ratio * s.motor_constant, s.voltage_limit) for s in servos]
    stall, R, k, V = np.array(columns).T
    torque = np.abs(run["torque"][window][:, driven]) / stall
    line = np.abs(R * run["current"][window][:, driven] + k * run["qd"][window][:, driven]) / V
    always = np.ones(torque.shape)
    return {"torque": Quantity(torque, always, names), "line": Quantity(line, always, names)}


@functools.lru_cache(maxsize=1024)
def net_stall_torque(servo: Servo) -> float:
    """Return the torque of a servo that stalls at its supply voltage, less its friction [N m]."""
    return torque_speed(servo, points=2).stall_torque
