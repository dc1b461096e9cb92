"""Measure forces from the channels of a run: what a joint bears, by Newton and Euler, and whether a link touches.

What the rest of the robot does to a link, through the joint that carries it, is what all links beyond it need for their
motion, less what acts on them from outside: sum of m (a - g) and of the rates of angular momentum, less forces of the
ground and between bodies.  Accelerations are carried outward from the base, joint by joint (J. Luh, M. Walker, R. Paul,
"On-line computational scheme for mechanical manipulators", J. Dyn. Sys. Meas. Control 102, 1980).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from ..base.fixed_order import applied, product
from ..base.rotation import rotation_from_rpy
from ..core.step.state import BY_NAME
from ..dynamics import Poses, contact_positions_at
from ..dynamics.jacobians import chains_of, joint_axes
from ..model import Ground, Model, inertia_matrix
from ..model.placed import link_name
from ..model.rigid_bodies import depth_first_joints
from ..model.sensor import ContactSensor, ForceTorqueSensor
from ..scene.channels import owned
from ..scene.compile import CompiledScene
from ..scene.forest import Member
from .range_sensor import link_poses, members_of, row_of
from .sensors import in_world

UNKNOWN = {  # constants of a scene whose forces no channel states where they act
    "loops": "loops", "tendons": "tendons or springs between links", "fluid": "a fluid", "propellers": "propellers",
    "lifts": "links with gravity_compensation", "push": "pushes",
}  # fmt: skip


class Motion(NamedTuple):
    """How a link moves at each sample, in world axes (samples, 3)."""

    at: np.ndarray  # origin of its frame [m]
    turning: np.ndarray  # angular velocity [rad/s]
    turning_rate: np.ndarray  # [rad/s^2]
    acceleration: np.ndarray  # of the origin [m/s^2]


def bears(scene: CompiledScene, channels: Mapping[str, np.ndarray], sensor: ForceTorqueSensor) -> np.ndarray:
    """Measure force and moment (samples, 6) on the link of a sensor by what carries it, in the sensor's axes."""
    what = f"{scene.model.name}: sensor {sensor.name!r}"
    for name, found in UNKNOWN.items():
        if getattr(scene.constants, name) is not None:
            raise ValueError(f"{what} does not know where {found} act; leave them out, or the sensor")
    names, rotation, position = link_poses(scene, channels)
    row = row_of(scene, names, sensor)
    member, first = _member_of(scene, row)
    model, own = member.model, slice(first, first + len(member.model.links))
    if row == own.start + model.link_index(model.root) and model.base == "floating":
        raise ValueError(f"{what} is on {sensor.link!r}, which nothing carries; give a link that a joint carries")
    poses = Poses(rotation[:, own], position[:, own])
    motions = _motions(scene, member, channels, poses)
    beyond = _beyond(model, model.links[row - first].name)
    at = position[:, row] + applied(rotation[:, row], np.array(sensor.position))
    force, moment = np.zeros((2, len(at), 3))
    for k in beyond:
        link, move, R = model.links[k], motions[model.links[k].name], poses.rotation[:, k]
        arm = applied(R, np.array(link.center_of_mass))
        needed = link.mass * (_acceleration(move, arm) - scene.constants.gravity)
        inertia = product(product(R, inertia_matrix(link.inertia)), np.swapaxes(R, 1, 2))
        spin = applied(inertia, move.turning_rate) + np.cross(move.turning, applied(inertia, move.turning))
        force += needed
        moment += spin + np.cross(poses.position[:, k] + arm - at, needed)
    inside = {link_name(member.name, model.links[k].name) if scene.members else model.links[k].name for k in beyond}
    for place, pushed in _outside(scene, member, channels, poses, inside):
        force -= pushed
        moment -= np.cross(place - at, pushed)
    axes = np.swapaxes(product(rotation[:, row], rotation_from_rpy(sensor.rpy)), 1, 2)
    return np.concatenate([applied(axes, force), applied(axes, moment)], axis=1)


def touches(scene: CompiledScene, channels: Mapping[str, np.ndarray], sensor: ContactSensor) -> np.ndarray:
    """Measure whether the ground and other bodies push a link by more than a threshold: 1 or 0 (samples, 1)."""
    names, rotation, _ = link_poses(scene, channels)
    member, first = _member_of(scene, row_of(scene, names, sensor))
    normal, link = np.zeros(len(rotation)), names[row_of(scene, names, sensor)]
    name = member.model.links[names.index(link) - first].name
    for k, point in enumerate(member.model.contacts):
        if point.link == name and scene.constants.contact is not None:
            normal += _own(scene, member, channels, "contact_force").reshape(len(normal), -1, 3)[:, k, 0]
    if scene.pairs:
        of = np.array([False, *(link in pair for pair in scene.pairs)])[channels["pair"].astype(int)]
        pushes = np.where(of, channels["pair_normal_force"], 0.0)
        for k in range(pushes.shape[1]):
            normal += pushes[:, k]
    return (normal > sensor.threshold).astype(float)[:, None]


def _member_of(scene: CompiledScene, row: int) -> tuple[Member, int]:
    """Return the member whose link is in a row of all, and the row of its first link."""
    first = 0
    for member in members_of(scene):
        if row < first + len(member.model.links):
            return member, first
        first += len(member.model.links)
    raise ValueError(f"{scene.model.name}: nothing carries the world; give the link of a robot")


def _own(scene: CompiledScene, member: Member, channels: Mapping[str, np.ndarray], name: str) -> np.ndarray:
    """Return the numbers (samples, all) of a channel that are a member's."""
    values = np.asarray(channels[name])
    values = values.reshape(len(values), -1)
    if not scene.members:
        return values
    return values[:, owned(BY_NAME[name], scene.shares[member.name], values.shape[1])]


def _motions(
    scene: CompiledScene, member: Member, channels: Mapping[str, np.ndarray], poses: Poses
) -> dict[str, Motion]:
    """Return the motions of all links of a member, and of what is between the degrees of its joints."""
    model, chains, axes = member.model, chains_of(member.model), joint_axes(member.model, poses)
    qd, qdd = (_own(scene, member, channels, name) for name in ("qd", "qdd"))
    root = model.link_index(model.root)
    still = np.zeros_like(poses.position[:, root])
    found = {model.root: Motion(poses.position[:, root], still, still, still)}
    if model.base == "floating":
        rates, R = [_own(scene, member, channels, name) for name in ("base_qd", "base_qdd")], poses.rotation[:, root]
        turning, rate = (applied(R, x[:, 3:]) for x in rates)
        found[model.root] = Motion(poses.position[:, root], turning, rate, rates[1][:, :3])
    ball = found[model.root]
    for joint in depth_first_joints(model.root, model.degrees.joints):
        before = found[joint.parent]
        end = joint.child
        while end not in model.link_rows:  # a link between the degrees of a joint
            end = model.degrees.after[end]
        at = poses.position[:, model.link_index(end)]
        move = before._replace(at=at, acceleration=_acceleration(before, at - before.at))
        if joint.name in model.joint_rows:
            k = model.joint_rows[joint.name]
            speed, push = axes[:, k] * qd[:, k, None], axes[:, k] * qdd[:, k, None]
            if joint.type != "ball" or joint.parent in model.link_rows or joint.name.endswith(".rx"):
                ball = before  # the axes of a ball joint are those of its child: they turn against its parent together
            around = ball if joint.type == "ball" else before
            slide = 1.0 if chains.slides[k, 0] else chains.pitches[k, 0]
            if slide:
                drift = 2.0 * np.cross(before.turning, speed) + push
                move = move._replace(acceleration=move.acceleration + slide * drift)
            if not chains.slides[k, 0]:
                rate = before.turning_rate + push + np.cross(around.turning, speed)
                move = move._replace(turning=before.turning + speed, turning_rate=rate)
        found[joint.child] = move
    return found


def _acceleration(move: Motion, arm: np.ndarray) -> np.ndarray:
    """Return the acceleration of the point of a link that is away from its origin by an arm."""
    turned = np.cross(move.turning, np.cross(move.turning, arm))
    return move.acceleration + np.cross(move.turning_rate, arm) + turned


def _beyond(model: Model, link: str) -> list[int]:
    """Return the rows of a link and of all that it carries."""
    found = [link]
    for name in found:  # grows
        found += [joint.child for joint in model.joints if joint.parent == name]
    return [model.link_index(name) for name in found]


def _outside(
    scene: CompiledScene, member: Member, channels: Mapping[str, np.ndarray], poses: Poses, inside: set[str]
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield places [m] and forces [N] (samples, 3) that act on links "robot/link" from outside of them."""
    model = member.model
    if member.scene.constants.contact is not None and scene.constants.contact is not None:
        places = contact_positions_at(model, poses)
        forces = _own(scene, member, channels, "contact_force").reshape(len(places), -1, 3)
        ground = scene.ground or Ground()
        forces = in_world(ground, forces, places if ground.field else None)
        for k, point in enumerate(model.contacts):
            if (link_name(member.name, point.link) if scene.members else point.link) in inside:
                yield places[:, k], forces[:, k]
    if scene.pairs:
        signs = np.array([0.0, *(float(a in inside) - float(b in inside) for a, b in scene.pairs)])
        sign = signs[channels["pair"].astype(int)]
        for k in range(sign.shape[1]):
            yield channels["pair_position"][:, k], sign[:, k, None] * channels["pair_force"][:, k]
