"""Measure along rays from a link, from the channels of a run: distances, and how dark the ground is where they end."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..base.arguments import instance
from ..base.fixed_order import applied, product
from ..base.rotation import rotation_from_quaternion
from ..core.shapes.distance import Room
from ..core.shapes.paint import COINCIDENT, cover
from ..core.shapes.ray import cast_rays
from ..core.step.state import BY_NAME
from ..dynamics import forward_kinematics
from ..geometry.distance import shape_tables
from ..model import FloorLine
from ..model.placed import Placed, link_name
from ..model.sensor import WORLD, LineSensor, RangeSensor, SampledSensor, Sensor
from ..scene.channels import owned
from ..scene.compile import CompiledScene
from ..scene.forest import Member
from ..scene.solids import Solid, of_ground
from .trajectory import Trajectory


def ranges(scene: CompiledScene, trajectory: Trajectory | Mapping[str, np.ndarray], sensor: RangeSensor) -> np.ndarray:
    """Measure the distances of a range sensor, without noise.

    Parameters
    ----------
    scene : CompiledScene
        The scene of the run.
    trajectory : Trajectory
        What `simulate` returns, with the channels q and, if anything floats, base_q.
    sensor : RangeSensor
        The sensor.

    Returns
    -------
    ndarray, shape (samples, rays)
        Distances [m], infinite where there is nothing within the reach; one a sample of a sonar; of a sensor with a
        `curve` voltages [V].

    Raises
    ------
    ValueError
        A channel was not recorded, or there is no such link.
    """
    instance("scene", scene, CompiledScene, "give what compile_scene returns")
    instance("sensor", sensor, RangeSensor, "give a RangeSensor")
    names, *poses = link_poses(scene, trajectory)
    body = _body_of(scene, sensor.link)
    solids = [one for one in _solids(scene, names) if not one.moves or _body_of(scene, one.link) != body]
    found = _cast(scene, names, poses, sensor, solids)
    if sensor.link != WORLD and (found == 0.0).any():  # it may begin within another shape of its robot, its housing
        robot = _robot_of(scene, sensor.link)
        own = [one.moves and _robot_of(scene, one.link) == robot for one in solids]
        found = _cast(scene, names, poses, sensor, [one for one, is_own in zip(solids, own) if not is_own])
        for one in itertools.compress(solids, own):
            far = _cast(scene, names, poses, sensor, [one])
            found = np.minimum(found, np.where(far > 0.0, far, np.inf))
    found = found.min(axis=1, keepdims=True) if sensor.nearest else found
    return sensor.voltage(found) if sensor.curve else found


def _body_of(scene: CompiledScene, link: str) -> int | None:
    """Return the rigid body that a link is part of, with those that are fixed to it; None for the world."""
    placed = scene.tree.placements.get(link)
    return None if placed is None else placed.row


def _robot_of(scene: CompiledScene, link: str) -> str:
    """Return the robot or object that a link is of."""
    return link.partition("/")[0] if scene.members else ""


def rays_of(scene: CompiledScene, channels: Mapping[str, np.ndarray], most: int = 48) -> np.ndarray | None:
    """Return rays of all range sensors of a scene (samples, rays, 7); None without any.

    Where they begin and end [m], and 1 if they meet something, else 0.  Those that meet nothing end at the reach, and
    where they begin if there is none.  Of a sensor `most` rays at most.
    """
    found = []
    for sensor in scene.sensors.values():
        inner = sensor.sensor if isinstance(sensor, SampledSensor) else sensor
        if isinstance(inner, RangeSensor):
            chosen = inner.directions[:: -(-len(inner.directions) // most)]
            shown = replace(inner, directions=chosen, nearest=False, curve=())
            names, *poses = link_poses(scene, channels)
            far = ranges(scene, channels, shown)
            met = np.isfinite(far)
            far = np.where(met, far, inner.reach if inner.reach < math.inf else 0.0)
            row, (origin, along) = row_of(scene, names, inner), np.split(shown.mounted, 2, axis=1)
            ends = np.stack([np.broadcast_to(origin, (*far.shape, 3)), origin + far[..., None] * along], axis=2)
            rotation, position = (part[:, row, None, None] for part in poses)
            ends = (position + applied(rotation, ends)).reshape(*far.shape, 6)
            found.append(np.concatenate([ends, met[..., None]], axis=2))
    return np.concatenate(found, axis=1) if found else None


def darkness(scene: CompiledScene, channels: Mapping[str, np.ndarray], sensor: LineSensor) -> np.ndarray:
    """Measure the share (samples, spots) of each spot of a line sensor that is dark."""
    names, *poses = link_poses(scene, channels)
    ground = [] if scene.ground is None else list(of_ground(scene.ground, len(names) - 1))
    far = _cast(scene, names, poses, sensor, ground)
    rotation, position = (part[:, row_of(scene, names, sensor)] for part in poses)
    origin, along = np.split(sensor.mounted, 2, axis=1)
    met = np.isfinite(far)
    end = origin + np.where(met, far, 0.0)[..., None] * along
    end = position[:, None] + applied(rotation[:, None], end)
    discs = np.concatenate([end[..., :2], np.full((*far.shape, 1), sensor.radius)], axis=-1).reshape(-1, 3)
    quads, out = strips(() if scene.ground is None else scene.ground.lines), np.zeros(len(discs))
    cover(quads, discs, np.zeros(len(quads), np.int64), out)
    return np.where(met, out.reshape(far.shape), 1.0)


def strips(lines: Sequence[FloorLine]) -> np.ndarray:
    """Return quadrilaterals (n, 4, 2), counterclockwise, that cover lines [m]: their pieces, and what corners lack."""
    found = []
    for line in lines:
        points, half = np.array(line.points), 0.5 * line.width
        along = np.diff(points, axis=0)
        along /= np.sqrt(along[:, :1] * along[:, :1] + along[:, 1:] * along[:, 1:])
        aside = half * np.stack([-along[:, 1], along[:, 0]], axis=1)
        for a, b, n in zip(points, points[1:], aside):
            found.append([a - n, b - n, b + n, a + n])
        closed = line.points[0] == line.points[-1]
        corners = itertools.pairwise([*range(len(along)), *([0] if closed else [])])
        for before, after in corners:
            p, m, n = points[before + 1], aside[before], aside[after]
            turn, alike = m[0] * n[1] - m[1] * n[0], m[0] * n[0] + m[1] * n[1]
            m, n = (-n, -m) if turn < 0.0 else (m, n)  # on the outer side ...
            m, n = -m, -n
            if abs(turn) <= COINCIDENT * half:
                continue  # straight on or straight back: its edges would be one to `cover`, without area between them
            if alike >= 0.0:
                tip = p + (m + n) / (1.0 + alike / (half * half))
                found.append([p, p + m, tip, p + n])
            else:
                found.append([p, p + m, p + n, p + n])
    return np.reshape(found, (-1, 4, 2))


def _cast(
    scene: CompiledScene, names: list[str], poses: Sequence[np.ndarray], sensor: RangeSensor | LineSensor,
    solids: Sequence[Solid],
) -> np.ndarray:  # fmt: skip
    """Return the distances (samples, rays) of a sensor to the first of some solids [m]."""
    carrier = row_of(scene, names, sensor)
    shapes = shape_tables([solid.shape for solid in solids], [solid.body for solid in solids])
    for row, solid in zip(shapes.table, solids):
        row.r = solid.r + applied(solid.E, row.r)
        row.E = product(solid.E, row.E.reshape(3, 3)).ravel()
    mounted = sensor.mounted
    out, count = np.zeros((len(poses[0]), len(mounted))), len(shapes.table)
    room, rays = Room(np.zeros((count, 9)), np.zeros((count, 3)), np.zeros((4, 3))), np.zeros((2, 8, len(mounted)))
    cast_rays(shapes, room, tuple(poses), carrier, mounted, sensor.reach, rays, out)
    return out


def row_of(scene: CompiledScene, names: list[str], sensor: Sensor) -> int:
    """Return the row of the link that carries a sensor among all; raise ValueError if there is none."""
    if sensor.link not in names:
        known = ", ".join(names)
        raise ValueError(f"{scene.model.name}: sensor {sensor.name!r} is on {sensor.link!r}; links: {known}")
    return names.index(sensor.link)


def members_of(scene: CompiledScene) -> list[Member]:
    """Return the members of a scene; of one robot itself, under an empty name."""
    return list(scene.members) or [Member(Placed(scene.model), scene)]


def link_poses(scene: CompiledScene, channels: Mapping[str, np.ndarray]) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Return the names of all links, the world last, and their poses (samples, links, ...)."""
    instance("trajectory", channels, Mapping, "give what simulate returns")
    names, rotations, positions = list[str](), [], []
    of = scene.shares
    for member in members_of(scene):
        model = member.model
        needed = ("base_q", "q") if model.base == "floating" else ("q",)
        missing = [name for name in needed if name not in channels]
        if missing:
            raise ValueError(f"trajectory: channels {missing} were not recorded; name them in simulate(record=...)")
        parts = [np.asarray(channels[name]) for name in needed]
        parts = [values.reshape(len(values), -1) for values in parts]
        if of:
            share = of[member.name]
            parts = [values[:, owned(BY_NAME[n], share, values.shape[1])] for n, values in zip(needed, parts)]
        poses = forward_kinematics(model, np.ascontiguousarray(np.hstack(parts)))
        rotation, position = poses.rotation, poses.position
        if of and model.base != "floating":
            turn = rotation_from_quaternion(np.array(member.placed.orientation))
            at = np.array((*member.placed.position, 0.0)[:3])
            rotation, position = product(turn, rotation), at + applied(turn, position)
        names += [link_name(member.name, link.name) if of else link.name for link in model.links]
        rotations.append(rotation)
        positions.append(position)
    samples = len(rotations[0])
    rotations.append(np.tile(np.eye(3), (samples, 1, 1, 1)))
    positions.append(np.zeros((samples, 1, 3)))
    return [*names, WORLD], np.concatenate(rotations, axis=1), np.concatenate(positions, axis=1)


def _solids(scene: CompiledScene, names: list[str]) -> Iterator[Solid]:
    """Yield all shapes in the frames of their links, obstacles and the ground in that of the world."""
    world, still = len(names) - 1, (np.eye(3), np.zeros(3))
    for member in members_of(scene):
        for shape in member.model.shapes:
            link = link_name(member.name, shape.link) if scene.members else shape.link
            yield Solid(link, member.name, 0, names.index(link), True, shape, *still)
    for placed in scene.obstacles:
        turn, at = rotation_from_quaternion(np.array(placed.orientation)), np.array((*placed.position, 0.0)[:3])
        for shape in placed.model.shapes:
            yield Solid(link_name(placed.name, shape.link), placed.name, 0, world, False, shape, turn, at)
    if scene.ground is not None:
        yield from of_ground(scene.ground, world)
