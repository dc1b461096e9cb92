"""The shapes of a scene: of robots, of obstacles and of the ground."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..base.rotation import rotation_from_quaternion
from ..dynamics.tree import Tree
from ..geometry.distance import HalfSpace, meeting_shapes
from ..model import Ground, HeightField
from ..model.pair_contact import GROUND
from ..model.pair_friction import shape_names
from ..model.placed import Placed, link_name
from ..model.shapes import Box, Shape
from .contact import plane_axes
from .forest import Member, named
from .loads import trees_of

WORLD = -1  # the tree of what never moves
WIDE, UNDER = 100.0, 1.0  # of the treads of steps, how far they reach from the origin, and below the lowest one [m]


class Solid(NamedTuple):
    """A shape in the scene."""

    link: str  # name in the scene
    of: str  # name of the member or obstacle
    tree: int  # number of the tree, or WORLD
    body: int  # row of the body, or one beyond all of them
    moves: bool
    shape: Shape | HalfSpace
    E: np.ndarray  # rotation (3, 3) of the shape's link in the frame of the body, or in the world
    r: np.ndarray  # its origin there (3,) [m]
    on_points: bool = True  # its link touches the ground with points, or not at all

    @property
    def kind(self) -> type:
        """Return the type of the shape."""
        return HalfSpace if isinstance(self.shape, HalfSpace) else type(self.shape.geometry)

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names that the shape goes by."""
        return (GROUND,) if isinstance(self.shape, HalfSpace) else shape_names(self.of, self.shape)

    @property
    def is_surface(self) -> bool:
        """Return whether the shape is a half space or a height field, two of which have no distance."""
        return self.kind in (HalfSpace, HeightField)


class Parts(NamedTuple):
    """All shapes of a scene."""

    solids: list[Solid]
    meeting: np.ndarray  # (n, 2) indices of the shapes of one robot that can meet
    notes: list[str]


def parts_of(members: Sequence[Member], obstacles: Sequence[Placed], tree: Tree, ground: Ground | None) -> Parts:
    """Gather all shapes: of members in the frames of their bodies, of obstacles and the ground in the world."""
    solids: list[Solid] = []
    meeting, notes = [np.zeros((0, 2), np.int64)], list[str]()
    for number, member in enumerate(members):
        model, own = member.model, trees_of(tree)[number]
        if not model.shapes:
            notes.append(f"{member.name}: it has no collision shapes, and touches nothing but the ground")
            continue
        found = meeting_shapes(model)
        meeting.append(found.pairs + len(solids))
        notes += [f"{member.name}: {note}" for note in found.notes]
        pointed = {point.link for point in model.contacts}
        for shape in model.shapes:
            name = named(member, shape.link)
            row, E, r = tree.placements[name]
            moves = row > own.root or not own.fixed
            on_points = shape.link in pointed or not member.placed.ground_contact
            solids.append(Solid(name, member.name, number, row, moves, shape, E, r, on_points))
    beyond = len(tree.bodies)
    for placed in obstacles:
        turn, at = rotation_from_quaternion(np.array(placed.orientation)), np.array((*placed.position, 0.0)[:3])
        for shape in placed.model.shapes:
            link = link_name(placed.name, shape.link)
            solids.append(Solid(link, placed.name, WORLD, beyond, False, shape, turn, at))
    if ground is not None and any(solid.moves and not solid.on_points for solid in solids):
        if ground.moves:
            raise ValueError(
                "ground: its surface moves under contact points alone, and links without these touch it; give them "
                "contact points, or leave out velocity and turning"
            )
        solids += of_ground(ground, beyond)
    return Parts(solids, np.concatenate(meeting), notes)


def of_ground(ground: Ground, beyond: int) -> list[Solid]:
    """Return the ground as a height field, or as all below its lowest tread with a box for each other one."""
    if ground.field is not None:
        place = np.eye(3), np.array([0.0, 0.0, ground.height])
        return [Solid(GROUND, GROUND, WORLD, beyond, False, Shape(GROUND, ground.field), *place)]
    normal, first, second = plane_axes(ground)
    turn, levels = np.stack([first, second, normal], axis=1), [ground.height * float(normal[2])]
    steps = sorted(ground.steps)
    for _, rise in steps:
        levels.append(levels[-1] + rise)
    low = min(levels)
    found = [Solid(GROUND, GROUND, WORLD, beyond, False, HalfSpace(), turn, low * normal)]
    for level, (start, _), (end, _) in zip(levels, [(-WIDE, 0.0), *steps], [*steps, (WIDE, 0.0)]):
        if level > low and end > start:
            size = (end - start, 2.0 * WIDE, level - low + UNDER)
            at = 0.5 * (start + end) * first + (level - 0.5 * size[2]) * normal
            found.append(Solid(GROUND, GROUND, WORLD, beyond, False, Shape(GROUND, Box(size)), turn, at))
    return found
