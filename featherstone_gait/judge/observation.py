"""Make the observations of a policy for all worlds at once, as its description says, with errors of the sensors."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..base.portable_math import sincos
from ..model.sensor import SampledSensor
from ..run.measure import noise_of
from ..scene.compile import CompiledScene
from .description import Block, PolicyDescription
from .doubts import Drawn

WHOLE = 1e-6  # tolerance of delays in samples
OBSERVED = ("q", "qd", "base_q", "base_qd")
MORE = {"accelerometer": ("base_qdd",), "contacts": ("contact_force",)}  # channels that blocks read besides


def channels_of(description: PolicyDescription) -> tuple[str, ...]:
    """Return the channels that a session must observe."""
    more = (name for block in description.observation for name in MORE.get(block.name, ()))
    return tuple(dict.fromkeys((*OBSERVED, *more)))


class Observer:
    """Make observations of the robots of a session; keeps the older ones and the last samples."""

    def __init__(
        self, description: PolicyDescription, scene: CompiledScene, drawn: Drawn, period: float, sample: float
    ) -> None:
        self.description, self.scene, self.sensing, self._period = description, scene, drawn.sensing, period
        sensing = drawn.sensing
        self.n, joints = len(sensing.offset), scene.model.joint_names
        self.columns = np.array([joints.index(name) for name in description.joints], int)
        self.pose = np.array(description.pose)
        self._noise = SampledSensor("q", noise=sensing.deviations(len(joints)), seed=sensing.seed, name="judge")
        self._histories: dict[int, np.ndarray] = {}
        self._robots, self._rows = drawn.who, np.arange(self.n)
        self._late = np.floor(sensing.late / sample + WHOLE).astype(int)  # in samples
        self._bases: list[np.ndarray] = []  # (n, 13) of the last samples, the newest last
        links = [point.link for point in scene.model.contacts]
        self._feet = {
            k: np.array([[link == one for link in links] for one in block.links])
            for k, block in enumerate(description.observation) if block.name == "contacts"
        }  # fmt: skip

    def sample(self, seen: dict[str, np.ndarray]) -> None:
        """Keep the bases of a sample, since the inertial sensor is late."""
        self._bases = [
            *self._bases[-int(self._late.max(initial=0)) - 1 :],
            np.hstack([seen["base_q"], seen["base_qd"]]),
        ]

    def look(
        self, seen: dict[str, np.ndarray], number: int, actions: np.ndarray, targets: np.ndarray, command: np.ndarray
    ) -> np.ndarray:
        """Return the observations (n, size) of the policy's step `number`.

        seen: of the session.  actions, targets: the last ones (n, joints).  command: (3,).
        """
        self._seen, self._number = self._measured(seen, number), number
        self._own = {"actions": actions, "targets": targets, "command": np.broadcast_to(command, (self.n, 3))}
        parts = []
        for k, block in enumerate(self.description.observation):
            now = np.asarray(block.scale) * (self._value(k, block) + np.asarray(block.offset))
            if block.history > 1:
                now = self._with_history(k, block, now, number == 0)
            parts.append(now)
        return np.hstack(parts) if parts else np.zeros((self.n, 0))

    def _measured(self, seen: dict[str, np.ndarray], number: int) -> dict[str, Any]:
        """Return what the sensors say: gyroscope, gravity, joints and their speeds, with their errors."""
        s, joints = self.sensing, seen["q"].shape[1]
        noise = noise_of(self._noise, (6 + 2 * joints,), self._robots, np.full(self.n, number))
        noise = np.broadcast_to(noise, (self.n, 6 + 2 * joints))
        last = len(self._bases) - 1
        base = np.array(self._bases)[np.maximum(last - self._late, 0), self._rows]
        q, gyroscope = base[:, :7], base[:, 10:]
        down = down_in_base(q)
        tilted = gravity = down + np.cross(down, s.mounting)
        if noise.any():
            gravity = tilted + noise[:, 3:6]
            gravity = gravity / np.sqrt((gravity * gravity).sum(axis=1, keepdims=True))
        found = {
            "base_ang_vel": gyroscope + np.cross(gyroscope, s.mounting) + s.bias + noise[:, :3],
            "projected_gravity": gravity,
            "joint_pos": (seen["q"] + s.offset + noise[:, 6 : 6 + joints])[:, self.columns] - self.pose,
            "joint_vel": (seen["qd"] + noise[:, 6 + joints :])[:, self.columns],
            "base_lin_vel": in_base(q, base[:, 7:10]),
        }
        if "base_qdd" in seen:
            found["accelerometer"] = in_base(seen["base_q"], seen["base_qdd"][:, :3] - self.scene.constants.gravity)
        if "contact_force" in seen:
            found["touching"] = seen["contact_force"][:, :, 0] > 0.0
        return found

    def _value(self, k: int, block: Block) -> np.ndarray:
        """Return the present value of a block (n, width)."""
        time = self._number * self._period
        if block.name == "time":
            return np.full((self.n, 1), time)
        if block.name == "constant":
            return np.broadcast_to(np.array(block.values), (self.n, len(block.values)))
        if block.name == "phase":
            turn = 2.0 * np.pi * time / block.period + np.array(block.phases)
            return np.broadcast_to(np.concatenate(sincos(turn)[::-1]), (self.n, 2 * len(turn)))
        if block.name == "contacts":
            return (self._seen["touching"][:, None, :] & self._feet[k]).any(axis=2).astype(float)
        value = self._own[block.name] if block.name in self._own else self._seen[block.name]
        return np.hstack([value, np.zeros((self.n, block.zeros))]) if block.zeros else value

    def _with_history(self, k: int, block: Block, now: np.ndarray, first: bool) -> np.ndarray:
        """Return the newest and the older observations of a block; before the first there is that one."""
        if first:
            self._histories[k] = np.repeat(now[None], block.history, axis=0)
        else:
            self._histories[k] = np.concatenate([now[None], self._histories[k][:-1]])
        kept = self._histories[k][::-1] if block.oldest_first else self._histories[k]
        return kept.transpose(1, 0, 2).reshape(self.n, -1)


def down_in_base(q: np.ndarray) -> np.ndarray:
    """Return the direction down (n, 3) in the axes of bases with positions and quaternions (n, 7)."""
    w, x, y, z = q[:, 3:].T
    return -np.column_stack([2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)])


def in_base(q: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Return vectors (n, 3) of world axes in the axes of bases (n, 7)."""
    w, u = q[:, 3:4], -q[:, 4:]
    twice = 2.0 * np.cross(u, vectors)
    return vectors + w * twice + np.cross(u, twice)
