"""Measure, for all worlds at once, how robots move and what their servos do."""

from __future__ import annotations

import numpy as np

from ..base.fixed_order import total
from ..base.portable_math import angle as angle_of
from ..base.portable_math import sincos
from ..core.step.state import BY_NAME
from ..run.session import Session
from ..scene.compile import CompiledScene
from .observation import down_in_base

FULL = 1.0 - 1e-9  # of its limit, from which on a servo is saturated
LABELS = BY_NAME["energy"].labels


def measured_channels(scene: CompiledScene) -> tuple[str, ...]:
    """Return the channels that a `Meter` reads of a session's scene."""
    motor = ("voltage", "current") if scene.sampled else ()
    return ("q", "qd", "base_q", "base_qd", "torque", "contact_force", *motor)


class Meter:
    """Sums, extremes and counts of each world (n,) and joint (n, joints) over the samples of its robots.

    direction: (2,) of the way that counts, in the heading of the robot.
    """

    def __init__(self, robots: Session, seen: dict[str, np.ndarray], direction: np.ndarray, sample: float) -> None:
        scene, n, joints = robots.scene, robots.n, robots.scene.tree.n
        self._robots, self._sample, self._direction = robots, sample, direction
        self._motor = bool(scene.sampled)
        self._limit = np.array([self._limits(one) for one in robots.scenes])
        self._place, self._yaw = seen["base_q"][:, :2].copy(), _yaw(seen["base_q"])
        self.way, self.aside, self.turned, self.samples, self.force = np.zeros((5, n))
        self.upright = np.ones(n)  # least cosine of the tilt
        self._up = np.array(scene.upright)
        links = np.array([point.link for point in scene.model.contacts])
        self._soles = [np.flatnonzero(links == one) for one in dict.fromkeys(links.tolist())]
        self.positive = np.zeros((n, joints))  # [J] mechanical work of the servos where it is positive
        self.peak_torque, self.squares, self.peak_current, self.saturated = np.zeros((4, n, joints))
        self.first = np.full((n, joints), np.inf)  # [s] when each joint was saturated first

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
        m = moving.astype(float)[:, None]
        torque = np.abs(seen["torque"])
        self.samples += m[:, 0]
        self.squares += m * torque**2
        self.positive += m * self._sample * np.maximum(seen["torque"] * seen["qd"], 0.0)
        np.maximum(self.peak_torque, m * torque, out=self.peak_torque)
        if self._motor:
            np.maximum(self.peak_current, m * np.abs(seen["current"]), out=self.peak_current)
        full = (np.abs(seen["voltage"]) if self._motor else torque) >= FULL * self._limit
        full &= moving[:, None]
        self.saturated += full
        late = full & ~np.isfinite(self.first)
        self.first[late] = np.broadcast_to(self._robots.time[:, None], late.shape)[late]

    def result(self) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        """Return what was measured of each world (n,), and of each of its joints (n, joints)."""
        robots = self._robots
        time = np.maximum(robots.time, 1e-9)
        energy = robots.state_view["energy"].reshape(robots.n, -1, len(LABELS))
        drawn = energy[..., LABELS.index("electrical_no_regeneration")] if self._motor else self.positive
        model, gravity = robots.scene.model, np.linalg.norm(robots.scene.gravity)
        spent, samples = drawn.sum(axis=1), np.maximum(self.samples, 1.0)[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            per_way = np.where(self.way > 0.0, spent / self.way, np.nan)
        masses = np.array([sum(link.mass for link in one.model.links) for one in robots.scenes])
        worlds = {
            "time": robots.time, "way": self.way, "speed": self.way / time, "aside": self.aside,
            "turned": self.turned, "energy": spent, "power": spent / time, "energy_per_way": per_way,
            "cost_of_transport": per_way / (masses * gravity), "saturated": (self.saturated / samples).mean(axis=1),
            "largest_tilt": angle_of(np.sqrt(np.maximum(1.0 - self.upright**2, 0.0)), self.upright),
            "largest_force": self.force / (masses * gravity),
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


def resistance(scene: CompiledScene, name: str) -> float:
    """Return the resistance of the servo of a joint, 0 without one [Ohm]."""
    servo = scene.model.servos.get(name)
    return 0.0 if servo is None else servo.resistance


def _yaw(q: np.ndarray) -> np.ndarray:
    w, x, y, z = q[:, 3:].T
    return angle_of(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def _wrapped(angle: np.ndarray) -> np.ndarray:
    return angle - 2.0 * np.pi * np.rint(angle / (2.0 * np.pi))
