"""Measure distances along rays: range finders, scanners and sonars on a link, from the channels of a run."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import instance, real, shown, vector, whole
from ..base.brief import brief
from ..base.fixed_order import applied, product, total
from ..base.rotation import rotation_from_quaternion, rotation_from_rpy
from ..core.step.state import BY_NAME
from ..core.tree.distance import Room
from ..core.tree.ray import cast_rays
from ..dynamics import forward_kinematics
from ..geometry.distance import shape_tables
from ..model.placed import Placed, link_name
from ..scene.channels import owned
from ..scene.compile import CompiledScene
from ..scene.forest import Member, shares
from ..scene.pairs import Solid, of_ground
from .trajectory import Trajectory

PARALLEL = 1e-9  # length of a direction below which it is none
WORLD = "world"


@dataclass(frozen=True, eq=False)
class RangeSensor:
    """Rays from a link, whose lengths to the first shape are measured: collision shapes, obstacles, the ground.

    Shapes of the link itself are transparent. A ray that begins within a shape measures 0, one that meets nothing
    infinity. Meshes count as their convex hulls.

    Attributes
    ----------
    link : str
        Name of the link that carries it, in a scene of several as "robot/link"; "world" for a fixed place.
    directions : ndarray, shape (rays, 3)
        Directions in the sensor's frame, of any length.
    position : tuple of float
        Where all rays begin (3,), in the frame of the link [m].
    rpy : tuple of float
        Orientation (3,) of the sensor there: roll, pitch and yaw about fixed axes [rad].
    reach : float
        Longest distance that it measures [m].
    nearest : bool
        Whether it measures the least of all rays alone, as a sonar does.
    name : str
        Name in what a session observes.

    Raises
    ------
    ValueError
        For values out of range.

    Examples
    --------
    >>> from featherstone_gait import Ground, RangeSensor, compile_scene, load_robot, ranges, simulate
    >>> scene = compile_scene(load_robot("humanoid"), gearbox="mipsd", ground=Ground())
    >>> run = simulate(scene, 0.1)
    >>> down = RangeSensor("world", [[0.0, 0.0, -1.0]], position=(1.0, 0.0, 0.5))
    >>> float(ranges(scene, run, down)[-1, 0])
    0.5
    """

    link: str
    directions: np.ndarray
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)
    reach: float = math.inf
    nearest: bool = False
    name: str = "range"

    __repr__ = brief

    def __post_init__(self) -> None:
        instance("range sensor: link", self.link, str, "give the name of a link, or 'world'")
        instance("range sensor: name", self.name, str, "give a text")
        instance("range sensor: nearest", self.nearest, bool, "give True or False")
        directions = _directions(self.directions)
        if not (self.reach == math.inf and isinstance(self.reach, float)):
            real("range sensor: reach", self.reach, 0.0, 1e6, "[m]; leave it out for a sensor without limit")
        object.__setattr__(self, "directions", directions)
        for name in ("position", "rpy"):
            value = vector(f"range sensor: {name}", getattr(self, name), 3, "[m]" if name == "position" else "[rad]")
            object.__setattr__(self, name, tuple(value.tolist()))

    @classmethod
    def fan(cls, link: str, angle: float, rays: int, **more: Any) -> RangeSensor:
        """Make a scanner whose rays lie in its x-y plane, evenly about x.

        Parameters
        ----------
        link : str
            Name of the link that carries it.
        angle : float
            Angle between the first and the last ray, counterclockwise [rad]; at 2 pi the last is one step before it.
        rays : int
            Number of rays.
        **more
            Further attributes.

        Returns
        -------
        RangeSensor
            The sensor.
        """
        angle = real("range sensor: angle", angle, 0.0, 2.0 * math.pi, "[rad]")
        count = whole("range sensor: rays", rays, 1, "give their number", 10**6)
        whole_turn = 2.0 * math.pi - angle < PARALLEL
        turns = np.linspace(-0.5 * angle, 0.5 * angle, count, endpoint=not whole_turn) if count > 1 else np.zeros(1)
        return cls(link, np.stack([np.cos(turns), np.sin(turns), 0.0 * turns], axis=1), **more)

    @classmethod
    def cone(cls, link: str, angle: float, rays: int = 64, **more: Any) -> RangeSensor:
        """Make a sonar: rays spread evenly over a cone about x, of which the nearest echo counts.

        Parameters
        ----------
        link : str
            Name of the link that carries it.
        angle : float
            Opening angle of the cone, from side to side [rad].
        rays : int
            Number of rays; the first lies on the axis.
        **more
            Further attributes.

        Returns
        -------
        RangeSensor
            The sensor.
        """
        angle = real("range sensor: angle", angle, 0.0, math.pi, "[rad]")
        count = whole("range sensor: rays", rays, 1, "give their number", 10**6)
        k = np.arange(count)
        along = 1.0 - (1.0 - math.cos(0.5 * angle)) * k / max(count - 1, 1)  # equal shares of the sphere's area
        turns, across = k * math.pi * (3.0 - math.sqrt(5.0)), np.sqrt(np.maximum(1.0 - along * along, 0.0))
        return cls(link, np.stack([along, across * np.cos(turns), across * np.sin(turns)], axis=1),
                   **{"nearest": True, **more})  # fmt: skip

    @property
    def mounted(self) -> np.ndarray:
        """Origins [m] and unit directions of the rays in the frame of the link (rays, 6)."""
        along = applied(rotation_from_rpy(self.rpy), self.directions)
        return np.hstack([np.tile(self.position, (len(along), 1)), along])


def ranges(scene: CompiledScene, trajectory: Trajectory | Mapping[str, np.ndarray], sensor: RangeSensor) -> np.ndarray:
    """Measure the distances of a range sensor.

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
        Distances [m], infinite where there is nothing within the reach; one a sample of a sonar.

    Raises
    ------
    ValueError
        A channel was not recorded, or there is no such link.
    """
    instance("scene", scene, CompiledScene, "give what compile_scene returns")
    instance("sensor", sensor, RangeSensor, "give a RangeSensor")
    names, rotation, position = _poses(scene, trajectory)
    if sensor.link not in names:
        known = ", ".join(names)
        raise ValueError(f"{scene.model.name}: sensor {sensor.name!r} is on {sensor.link!r}; links: {known}")
    solids = list(_solids(scene, names))
    shapes = shape_tables([solid.shape for solid in solids], [solid.body for solid in solids])
    for row, solid in zip(shapes.table, solids):
        row.r = solid.r + applied(solid.E, row.r)
        row.E = product(solid.E, row.E.reshape(3, 3)).ravel()
    mounted, out = sensor.mounted, np.zeros((len(rotation), len(sensor.directions)))
    count = len(shapes.table)
    room = Room(np.zeros((count, 9)), np.zeros((count, 3)), np.zeros((4, 3)))
    carrier, rays = names.index(sensor.link), np.zeros((2, 8, len(mounted)))
    hidden = -1 if sensor.link == WORLD else carrier
    cast_rays(shapes, room, rotation, position, carrier, hidden, mounted, sensor.reach, rays, out)
    return out.min(axis=1, keepdims=True) if sensor.nearest else out


def _directions(given: ArrayLike) -> np.ndarray:
    """Return unit directions (rays, 3); raise ValueError for what is none."""
    try:
        found = np.array(given, dtype=float)
    except (TypeError, ValueError):
        found = np.zeros(0)
    if found.ndim != 2 or found.shape[1:] != (3,) or not len(found) or not np.isfinite(found).all():
        raise ValueError(f"range sensor: directions are {shown(given)}; expected finite numbers (rays, 3): give a list")
    lengths = np.sqrt(total(found * found))
    if lengths.min() < PARALLEL:
        raise ValueError(f"range sensor: direction {int(lengths.argmin())} has no length; give another one")
    return found / lengths[:, None]


def _members(scene: CompiledScene) -> list[Member]:
    """Return the members of a scene; of one robot itself, under an empty name."""
    return list(scene.members) or [Member(Placed(scene.model), scene)]


def _poses(
    scene: CompiledScene, channels: Mapping[str, np.ndarray]
) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Return the names of all links, the world last, and their poses (samples, links, ...)."""
    instance("trajectory", channels, Mapping, "give what simulate returns")
    names, rotations, positions = list[str](), [], []
    of = shares(scene.members) if scene.members else {}
    for member in _members(scene):
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
    for member in _members(scene):
        for shape in member.model.shapes:
            link = link_name(member.name, shape.link) if scene.members else shape.link
            yield Solid(link, member.name, 0, names.index(link), True, shape, *still)
    for placed in scene.obstacles:
        turn, at = rotation_from_quaternion(np.array(placed.orientation)), np.array((*placed.position, 0.0)[:3])
        for shape in placed.model.shapes:
            yield Solid(link_name(placed.name, shape.link), placed.name, 0, world, False, shape, turn, at)
    if scene.ground is not None:
        yield from of_ground(scene.ground, world)
