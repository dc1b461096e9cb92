"""Find when a run changes from one branch of a law to another: where its derivatives change suddenly."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ..core.effects.actuator import controller_of
from ..core.effects.gear_friction import GearFriction
from ..scene.compile import CompiledScene
from ..scene.contact import by_body

AT_LIMIT = 1e-9  # relative distance from a limit that is at it
DRY = ("coulomb_friction", "stribeck_friction", "external_load_friction", "motor_load_friction")
RECORD = ("q", "qd", "contact_force", "voltage", "duty", "pair", "pair_normal_force")


class Event(NamedTuple):
    """A change from one branch of a law to another.

    Attributes
    ----------
    time : float
        End of the step in which it happened [s].
    what : str
        "contact made", "contact broken", "contact slips", "contact sticks", "joint slips", "joint sticks", "voltage at
        its limit", "voltage off its limit", "stop reached", "stop left", "bodies touch", "bodies part", "tendon pulls"
        or "tendon slack".
    where : str
        The contact point, the joint, the pair, or the tendon.
    """

    time: float
    what: str
    where: str


def channels_of(scene: CompiledScene) -> tuple[str, ...]:
    """Return the channels of a scene from which its events are found."""
    found = (name for name in RECORD if name in scene.parts and np.ptp(scene.part(name)))
    return (*found, *["tendon_length"] * (bool(scene.model.tendons) and not scene.members))


def events_in(scene: CompiledScene, run: Mapping[str, np.ndarray]) -> tuple[Event, ...]:
    """Find the events of a run of which every step was recorded, in the order of time."""
    found: list[Event] = []
    for (begins, ends), where, on in _branches(scene, run):
        steps, which = np.nonzero(on[1:] != on[:-1])
        for k, i in zip(steps.tolist(), which.tolist()):
            found.append(Event(float(run["time"][k + 1]), begins if on[k + 1, i] else ends, where[i]))
    return tuple(sorted(found, key=lambda event: event.time))


def _branches(
    scene: CompiledScene, run: Mapping[str, np.ndarray]
) -> list[tuple[tuple[str, str], list[str], np.ndarray]]:
    """Return kinds of branches: what it is called to get there and away, whose they are, and who is there (steps, n).

    The first record has no forces yet: it counts as the second.
    """
    found, constants = [], scene.constants
    joints = list(scene.model.joint_names)
    if constants.contact is not None:
        force = _from_second(run["contact_force"])
        touches = force[..., 0] > 0.0
        limit = constants.contact.points["friction"] * force[..., 0]
        slips = touches & (np.hypot(force[..., 1], force[..., 2]) >= (1.0 - AT_LIMIT) * limit)
        points = _point_names(scene, force.shape[1])
        found.append((("contact made", "contact broken"), points, touches))
        both = touches[1:] & touches[:-1]  # slipping begins and ends while a point touches
        slips[1:] = np.where(both, slips[1:], False)
        found.append((("contact slips", "contact sticks"), points, _held(slips, touches)))
    if constants.friction is not None:
        friction = constants.friction.table if isinstance(constants.friction, GearFriction) else constants.friction
        dry = np.any([friction[name] > 0.0 for name in DRY if name in friction.dtype.names], axis=0)
        found.append((("joint slips", "joint sticks"), joints, (np.abs(run["qd"]) * friction.steepness >= 1.0) & dry))
    if "voltage" in run:
        limits = controller_of(constants.actuator)["voltage_limit"]
        size = np.abs(run["duty"]) if "duty" in run else np.abs(run["voltage"]) / np.maximum(limits, 1e-300)
        found.append((("voltage at its limit", "voltage off its limit"), joints, size >= 1.0 - AT_LIMIT))
    if constants.stops is not None:
        limits = np.stack([constants.stops["lower"], constants.stops["upper"]], axis=1)
        found.append((("stop reached", "stop left"), joints, _outside(run["q"], limits)))
    if "pair" in run:
        touching = _from_second(run["pair_normal_force"]) > 0.0
        which = np.where(touching, run["pair"], 0.0).astype(int)
        pairs = [" and ".join(pair) for pair in scene.pairs]
        each = np.stack([(which == 1 + k).any(axis=1) for k in range(len(pairs))], axis=1)
        found.append((("bodies touch", "bodies part"), pairs, each))
    if "tendon_length" in run:
        tendons, length = scene.model.tendons, run["tendon_length"]
        names = [one.name for one in tendons]
        slack = np.array([one.rest for one in tendons])
        limits = np.array([(one.lower, one.upper) for one in tendons])
        springs = np.array([one.stiffness > 0.0 for one in tendons]) & (slack[:, 0] < slack[:, 1])
        found.append((("tendon pulls", "tendon slack"), names, _outside(length, slack) & springs))
        found.append((("stop reached", "stop left"), names, _outside(length, limits)))
    return found


def _outside(values: np.ndarray, range_: np.ndarray) -> np.ndarray:
    """Return which values (records, n) are outside of their range (n, 2)."""
    return (values < range_[:, 0]) | (values > range_[:, 1])


def _from_second(values: np.ndarray) -> np.ndarray:
    return np.concatenate([values[1:2], values[1:]]) if len(values) > 1 else values


def _held(slips: np.ndarray, touches: np.ndarray) -> np.ndarray:
    """Let a point that does not touch be as it was, so that only changes while it touches count."""
    held = slips.copy()
    for k in range(1, len(held)):
        held[k] = np.where(touches[k], slips[k], held[k - 1])
    return held


def _point_names(scene: CompiledScene, count: int) -> list[str]:
    if not scene.members:
        return [f"{scene.model.contacts[k].link} {k}" for k in by_body(scene.model, scene.tree)]
    names = [
        f"{one.name}/{one.model.contacts[k].link} {k}"
        for one in scene.members
        for k in by_body(one.model, one.scene.tree)
    ]
    return names if len(names) == count else [f"contact point {k}" for k in range(count)]
