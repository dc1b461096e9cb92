"""Measure, for all worlds at once, how robots move and what their servos do."""

from __future__ import annotations

import numpy as np

from ..base.fixed_order import applied, total
from ..base.portable_math import angle as angle_of
from ..base.portable_math import sincos
from ..core.effects.energies import WORK
from ..core.step.state import BY_NAME
from ..dynamics import Poses, contact_positions_at, forward_kinematics
from ..run.session import Session
from ..scene.compile import CompiledScene
from .floors import Floors
from .observation import down_in_base

FULL = 1.0 - 1e-9  # of its limit, from which on a servo is saturated
STEPS = 0.01  # [s] least time between two looks at feet and at what is near a fall
SWING = 0.1  # [s] of the shortest swing: what is shorter is a foot that rebounds
NEAR = 0.5  # of a fall's tilt and sinking, from where on a robot is near a fall
FIGURES = {  # of a world, those in tables: unit, and what they are
    "speed": ("m/s", "speed along the command"),
    "aside": ("m", "drift to the side"),
    "turned": ("rad", "turn of the heading"),
    "power": ("W", "power of all servos"),
    "energy_per_way": ("J/m", "energy by way"),
    "cost_of_transport": ("-", "cost of transport"),
    "clearance": ("m", "foot clearance, median swing"),
    "least_clearance": ("m", "foot clearance, least swing"),
    "slip": ("m/m", "slip of what carries load, by way"),
    "near_fall": ("-", "share of time near a fall"),
    "largest_tilt": ("rad", "largest tilt of the base"),
    "largest_force": ("-", "largest force under a link, by the weight"),
    "saturated": ("-", "share of saturated samples, all joints"),
}
LABELS = BY_NAME["energy"].labels


def measured_channels(scene: CompiledScene) -> tuple[str, ...]:
    """Return the channels that a `Meter` reads of a session's scene."""
    motor = ("voltage", "current") if scene.sampled else ("energy",)
    return ("q", "qd", "base_q", "base_qd", "torque", "contact_force", *motor)


class Meter:
    """Sums, extremes and counts of each world (n,) and joint (n, joints) over the samples of its robots.

    direction: (2,) of the way that counts, in the heading of the robot.
    """

    def __init__(self, robots: Session, seen: dict[str, np.ndarray], direction: np.ndarray, sample: float) -> None:
        scene, n, joints = robots.scene, robots.n, robots.scene.tree.n
        self._robots, self._direction = robots, direction
        self._motor = bool(scene.sampled)
        self._limit = np.array([self._limits(one) for one in robots.scenes])
        self._place, self._yaw = seen["base_q"][:, :2].copy(), _yaw(seen["base_q"])
        self.way, self.aside, self.turned, self.samples, self.force = np.zeros((5, n))
        self.upright = np.ones(n)  # least cosine of the tilt
        self._up = np.array(scene.upright)
        links = np.array([point.link for point in scene.model.contacts])
        self._soles = [np.flatnonzero(links == one) for one in dict.fromkeys(links.tolist())]
        self.positive, self._work = np.zeros((2, n, joints))  # [J] work of servos: in samples with more than 0, in all
        self.peak_torque, self.squares, self.peak_current, self.saturated = np.zeros((4, n, joints))
        self.first = np.full((n, joints), np.inf)  # [s] when each joint was saturated first
        self._floors = Floors([one.ground for one in robots.scenes if one.ground is not None])
        self._masses = np.array([[link.mass for link in one.model.links] for one in robots.scenes])
        self._centers = np.array([[link.center_of_mass for link in one.model.links] for one in robots.scenes])
        tilt, low = scene.fall_upright, np.array([one.fall_height for one in robots.scenes])
        share = scene.options.fall_height
        self._near_tilt = np.cos(NEAR * np.arccos(tilt)) if tilt >= -1.0 else -np.inf
        self._near_height = low * (1.0 - NEAR * (1.0 - share)) / share if share > 0.0 else low
        self._every, self._taken = max(1, round(STEPS / sample)), 0
        self.near, self.looks, self.slip = np.zeros((3, n))
        self._rows = np.array([scene.model.link_index(point.link) for point in scene.model.contacts])
        root = scene.model.link_index(scene.model.root)
        self._feet = _Feet(n, [points for points in self._soles if self._rows[points[0]] != root], sample * self._every)
        self._poses, self._points, _, _ = self._seen_points(seen)
        self._force = seen["contact_force"][:, :, 0].copy()

    def _limits(self, scene: CompiledScene) -> list[float]:
        """Return the largest voltage [V], or torque of a torque law [N m], of each joint."""
        servos = [scene.model.servos.get(name) for name in scene.model.joint_names]
        if self._motor:
            return [one.voltage_limit * one.controller.duty_limit if one else np.inf for one in servos]
        return [one.controller.torque_limit if one else np.inf for one in servos]

    def take(self, seen: dict[str, np.ndarray], moving: np.ndarray) -> None:
        """Count a sample; moving (n,) bool: the worlds that had not failed before it."""
        place, yaw = seen["base_q"][:, :2], _yaw(seen["base_q"])
        moved, turn = place - self._place, _wrapped(yaw - self._yaw)
        heading = self._yaw + 0.5 * turn
        s, c = sincos(heading)
        ahead, left = c * moved[:, 0] + s * moved[:, 1], c * moved[:, 1] - s * moved[:, 0]
        d = self._direction
        self.way += ahead * d[0] + left * d[1]
        self.aside += left * d[0] - ahead * d[1]
        self.turned += turn
        self._place, self._yaw = place.copy(), yaw
        self.upright = np.minimum(self.upright, -total(down_in_base(seen["base_q"]) * self._up))
        normal = seen["contact_force"][:, :, 0]
        for points in self._soles:
            self.force = np.maximum(self.force, total(normal[:, points]))
        self._taken += 1
        if self._taken % self._every == 0:
            self._walk(seen, normal, moving)
        m = moving.astype(float)[:, None]
        torque = np.abs(seen["torque"])
        self.samples += m[:, 0]
        self.squares += m * torque**2
        np.maximum(self.peak_torque, m * torque, out=self.peak_torque)
        if self._motor:
            np.maximum(self.peak_current, m * np.abs(seen["current"]), out=self.peak_current)
        else:
            work = seen["energy"].reshape(len(m), -1, len(LABELS))[..., WORK]
            self.positive += m * np.maximum(work - self._work, 0.0)
            self._work = work.copy()
        full = (np.abs(seen["voltage"]) if self._motor else torque) >= FULL * self._limit
        full &= moving[:, None]
        self.saturated += full
        late = full & ~np.isfinite(self.first)
        self.first[late] = np.broadcast_to(self._robots.time[:, None], late.shape)[late]

    def _seen_points(self, seen: dict[str, np.ndarray]) -> tuple[Poses, np.ndarray, np.ndarray, np.ndarray]:
        """Return the links' poses, the contact points (n, points, 3), the ground's normals and the heights over it.

        The last row of points is the center of mass.
        """
        model = self._robots.scene.model
        poses = forward_kinematics(model, np.hstack([seen["base_q"], seen["q"]]))
        points, masses = contact_positions_at(model, poses), self._masses[..., None]
        center = total(masses * (poses.position + applied(poses.rotation, self._centers)), 1) / total(masses, 1)
        return poses, points, *self._floors.under(np.concatenate([points, center[:, None]], axis=1))

    def _walk(self, seen: dict[str, np.ndarray], force: np.ndarray, moving: np.ndarray) -> None:
        """Count slip, swings and the time near a fall."""
        poses, points, normals, over = self._seen_points(seen)
        before, r = self._poses, self._rows
        arm = total(before.rotation[:, r] * (self._points - before.position[:, r])[..., None], -2)
        carried = poses.position[:, r] + applied(poses.rotation[:, r], arm) - self._points  # of the link's matter
        along = carried - total(carried * normals[:, :-1])[..., None] * normals[:, :-1]
        load = np.minimum(force, self._force)
        borne = total(load)
        self.slip += moving * total(load * np.sqrt(total(along * along))) / np.where(borne > 0.0, borne, 1.0)
        up = -total(down_in_base(seen["base_q"]) * self._up)
        self.looks += moving
        self.near += moving & ((up < self._near_tilt) | (over[:, -1] < self._near_height))
        self._feet.take(over[:, :-1], force > 0.0, moving)
        self._poses, self._points, self._force = poses, points, force.copy()

    def result(self) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        """Return what was measured of each world (n,), and of each of its joints (n, joints)."""
        robots = self._robots
        time = np.maximum(robots.time, 1e-9)
        energy = robots.state_view["energy"].reshape(robots.n, -1, len(LABELS))
        drawn = energy[..., LABELS.index("electrical_no_regeneration")] if self._motor else self.positive
        model, gravity = robots.scene.model, np.linalg.norm(robots.scene.gravity)
        spent, samples = drawn.sum(axis=1), np.maximum(self.samples, 1.0)[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            per_way, slip = (np.where(self.way > 0.0, x / self.way, np.nan) for x in (spent, self.slip))
        clearance, least = self._feet.clearance()
        masses = np.array([sum(link.mass for link in one.model.links) for one in robots.scenes])
        worlds = {
            "time": robots.time, "way": self.way, "speed": self.way / time, "aside": self.aside,
            "turned": self.turned, "energy": spent, "power": spent / time, "energy_per_way": per_way,
            "cost_of_transport": per_way / (masses * gravity), "saturated": (self.saturated / samples).mean(axis=1),
            "largest_tilt": angle_of(np.sqrt(np.maximum(1.0 - self.upright**2, 0.0)), self.upright),
            "largest_force": self.force / (masses * gravity), "clearance": clearance, "least_clearance": least,
            "slip": slip, "near_fall": self.near / np.maximum(self.looks, 1.0),
        }  # fmt: skip
        joints = {
            "peak_torque": self.peak_torque, "rms_torque": np.sqrt(self.squares / samples),
            "saturated": self.saturated / samples, "first_saturated": self.first,
        }  # fmt: skip
        if self._motor:
            R = np.array([[resistance(one, name) for name in model.joint_names] for one in robots.scenes])
            copper = energy[..., LABELS.index("copper")]
            rms = np.sqrt(np.where(R > 0.0, copper / np.where(R > 0.0, R, 1.0), 0.0) / time[:, None])
            joints |= {"peak_current": self.peak_current, "rms_current": rms}
        return worlds, joints


class _Feet:
    """Follow the swings of feet, from where no point of a foot carries load to where one does again.

    soles: the contact points of each foot.  sample: time between samples [s].
    """

    def __init__(self, n: int, soles: list[np.ndarray], sample: float) -> None:
        self._soles, self._fewest = soles, SWING / sample - 0.5
        self._top, self._aloft = np.zeros((2, len(soles), n))  # of each swing: largest height [m], samples
        self._begun = np.zeros((len(soles), n), bool)  # feet that have touched, so that what follows is a swing
        self._swings: list[tuple[np.ndarray, np.ndarray]] = []  # worlds and heights

    def take(self, over: np.ndarray, loaded: np.ndarray, moving: np.ndarray) -> None:
        """Count a sample of heights over the ground [m] and whether points carry load (n, points)."""
        for k, points in enumerate(self._soles):
            touches, lowest = loaded[:, points].any(axis=1), over[:, points].min(axis=1)
            ends = np.flatnonzero(touches & moving & self._begun[k] & (self._aloft[k] >= self._fewest))
            if len(ends):
                self._swings.append((ends, self._top[k, ends]))
            self._begun[k] |= touches
            self._top[k] = np.where(touches, 0.0, np.maximum(self._top[k], lowest))
            self._aloft[k] = np.where(touches, 0.0, self._aloft[k] + 1.0)

    def clearance(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the median and the least clearance of all swings of each world (n,) [m], NaN without."""
        worlds, tops = (np.concatenate([np.zeros(0), *one]) for one in zip(*self._swings)) if self._swings else ([], [])
        by_world = [np.asarray(tops)[np.asarray(worlds) == k] for k in range(self._top.shape[1])]
        found = [(np.median(one), one.min()) if len(one) else (np.nan, np.nan) for one in by_world]
        median, least = np.array(found).T
        return median, least


def resistance(scene: CompiledScene, name: str) -> float:
    """Return the resistance of the servo of a joint, 0 without one [Ohm]."""
    servo = scene.model.servos.get(name)
    return 0.0 if servo is None else servo.resistance


def _yaw(q: np.ndarray) -> np.ndarray:
    w, x, y, z = q[:, 3:].T
    return angle_of(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def _wrapped(angle: np.ndarray) -> np.ndarray:
    return angle - 2.0 * np.pi * np.rint(angle / (2.0 * np.pi))
