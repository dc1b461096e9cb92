"""Distances between a robot's links: signed distances of their collision shapes.

Two shapes can meet if something moves between them.  Left out are shapes of links that are rigidly attached to each
other, of a link and its parent (with all that is rigidly attached to them) unless `Model.included` names them, of what
`Model.excluded` names, and those that overlap in the admissible posture nearest to zero already: `meeting_shapes` says
which.  Links without mass and shapes belong to the joint that they are in.

Spheres, capsules, boxes and cylinders are taken as they are; hulls and meshes by at most 32 corners, rounded by as much
as the hull reaches beyond them, so that the true distance is never less.  Distances of shapes apart are exact to 1e-9 m
or better.  Where shapes overlap, minus the distance is how far they must move to part: exactly so but for
cylinders, of which it is at most so.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..base.brief import brief
from ..base.fixed_order import applied
from ..base.flaws import quoted
from ..base.records import records
from ..base.rotation import rotation_from_rpy
from ..core.compile.elementary import SINCOS_LIMIT
from ..core.shapes.distance import (
    BOX,
    CYLINDER,
    FIELD,
    HALF_SPACE,
    HULL,
    POINT,
    SEGMENT,
    SHAPE,
    Room,
    Shapes,
    least_distances,
    pair_distances,
)
from ..core.shapes.field import COLUMNS, MANY, FieldBench
from ..core.shapes.patch import Bench
from ..dynamics import Poses, check_model, forward_kinematics
from ..model import HeightField, Model, rigid_bodies
from ..model.pair_friction import shape_names
from ..model.rest_posture import nearest_posture
from ..model.shapes import Box, Capsule, Cylinder, Shape, Sphere
from .contact_choice import corner_error, local_corners
from .hull import Sides, sides
from .polytope import Polytope, box, hull, segment

AT_ONCE = 10_000  # pairs in a call of a kernel, which Ctrl-C does not end


class Clearance(NamedTuple):
    """The least distance of shapes that can meet.

    Attributes
    ----------
    distance : numpy.ndarray
        Signed distance () or (n,) [m]; negative if shapes overlap.
    shapes : numpy.ndarray
        The two closest shapes, (2,) or (n, 2) indices into `model.shapes`.
    """

    distance: np.ndarray
    shapes: np.ndarray

    def __repr__(self) -> str:
        return brief(self)


class Meeting(NamedTuple):
    """The pairs of shapes that can meet."""

    pairs: np.ndarray  # (pairs, 2) indices into `model.shapes`
    notes: tuple[str, ...]  # one sentence for each two links that overlap from the start


def clearance(model: Model, q: ArrayLike, pairs: np.ndarray | None = None) -> Clearance:
    """Compute the least signed distance of collision shapes that can meet.

    Parameters
    ----------
    model : Model
        The robot.
    q : array_like
        Positions (nq,) or (n, nq) [m, -, rad or m].
    pairs : numpy.ndarray, optional
        Indices (pairs, 2) of the shapes to compare; None takes all that `meeting_shapes` finds.

    Returns
    -------
    Clearance
        Distances, and the closest shapes.

    Raises
    ------
    ValueError
        If no two shapes can meet, and for meshes that cannot be read.
    ImportError
        For meshes whose reader is not installed.
    """
    check_model(model)
    pairs = meeting_shapes(model).pairs if pairs is None else pairs
    if not len(pairs):
        raise ValueError(
            f"{model.name}: no two shapes that could meet, of {len(model.shapes)}; give links that are not neighbors "
            "collision shapes"
        )
    shapes, poses = shape_table(model), _rows(forward_kinematics(model, q))
    distance, closest = np.empty(len(poses.position)), np.zeros(len(poses.position), np.int64)
    least_distances(shapes, _room(shapes), pairs, *poses, distance, closest)
    found = Clearance(distance, pairs[closest])
    return found if np.ndim(q) > 1 else Clearance(found.distance[0], found.shapes[0])


def clearance_channel(model: Model, base_q: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Compute the recorded channel (samples, 1) [m]; (samples, 0) if no two shapes can meet.

    The value is NaN where a diverging run has turned its joints too far for exact sines.
    """
    if not len(meeting_shapes(model).pairs):
        return np.zeros((len(q), 0))
    known = (np.abs(q) <= SINCOS_LIMIT).all(axis=1)
    distance = np.full((len(q), 1), np.nan)
    distance[known, 0] = clearance(model, np.hstack([base_q, q])[known]).distance
    return distance


@functools.lru_cache(maxsize=64)
def meeting_shapes(model: Model) -> Meeting:
    """Find the pairs of shapes whose distance can change, except neighbors and those that overlap at rest."""
    apart = _apart(model)
    distance = shape_distances(model, nearest_posture(model), apart)
    links = [shape.link for shape in model.shapes]
    overlapping = dict.fromkeys((links[a], links[b]) for a, b in apart[distance < 0.0])
    notes = tuple(f"links {a!r} and {b!r} overlap at rest: not checked" for a, b in overlapping)
    return Meeting(apart[distance >= 0.0], notes)


def shape_distances(model: Model, q: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """Compute the signed distance (pairs,) [m] of pairs (pairs, 2) of shapes in one posture q (nq,) [rad, m]."""
    out = np.zeros(len(pairs))
    if not len(pairs):  # nothing is compiled for none
        return out
    shapes, poses = shape_table(model), _rows(forward_kinematics(model, q))
    rotation, position = poses.rotation[0], poses.position[0]
    room, pairs = _room(shapes), np.array(pairs, np.int64).reshape(-1, 2)
    for k in range(0, len(pairs), AT_ONCE):
        pair_distances(shapes, room, pairs[k : k + AT_ONCE], rotation, position, out[k : k + AT_ONCE])
    return out


def _apart(model: Model) -> np.ndarray:
    """Find the pairs (pairs, 2) of shapes that something moves, which touch; fields have no distance."""
    same, near = neighbors(model)
    solid = np.array([not isinstance(shape.geometry, HeightField) for shape in model.shapes], bool)
    touch = ~same & (~near | named_shapes(model, model.included)) & ~named_shapes(model, model.excluded)
    return np.argwhere(np.tril(touch & solid & solid[:, None], -1))[:, ::-1]


def neighbors(model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Find which shapes (n, n) are on one rigid body, and which on two with one joint between them.

    Links without mass and shapes, as between the joints of one body of MJCF, belong to the joint.
    """
    bodies, placements = rigid_bodies(model)
    carrying = {shape.link for shape in model.shapes}
    light = {link.name for link in model.degrees.between}
    light |= {link.name for link in model.links if not (link.mass or any(link.inertia) or link.name in carrying)}

    def carrier(row: int) -> int:
        """Return the row itself, or of a body within a joint the body that carries the joint."""
        while row and light.issuperset(bodies[row].links):
            row = bodies[row].frame.parent
        return row

    one, near = np.eye(len(bodies), dtype=bool), np.zeros((len(bodies),) * 2, bool)
    for k, body in enumerate(bodies[1:], 1):
        near[carrier(body.frame.parent), k] = True
    at = np.ix_(*[[placements[shape.link].row for shape in model.shapes]] * 2)
    return one[at], (near | near.T)[at]


def named_shapes(model: Model, pairs: Iterable[tuple[str, str]]) -> np.ndarray:
    """Find the shapes (n, n) of pairs of "link" or "link/shape"; raise ValueError for a shape that its link lacks."""
    found = np.zeros((len(model.shapes),) * 2, bool)
    rows = rows_by_name(shape_names("", shape)[1:] for shape in model.shapes)
    for a, b in pairs:
        for end in (a, b):
            link = end.rpartition("/")[0]
            if f"/{end}" not in rows and end not in model.link_rows and f"/{link}" in rows:
                own = [shape.name for shape in model.shapes if shape.link == link and shape.name]
                raise ValueError(
                    f"{model.name}: excluded or included names {end!r}, but link {link!r} has no shape of that name; "
                    f"expected one of {quoted(own)}: correct it, or name the link"
                )
        mark(found, rows.get(f"/{a}", []), rows.get(f"/{b}", []))
    return found


def rows_by_name(names: Iterable[Iterable[str]]) -> dict[str, list[int]]:
    """Return the rows of the shapes that go by each name."""
    rows: dict[str, list[int]] = {}
    for k, own in enumerate(names):
        for name in own:
            rows.setdefault(name, []).append(k)
    return rows


def mark(matrix: np.ndarray, one: Sequence[int], two: Sequence[int]) -> None:
    """Set a symmetric matrix true in the rows of one and the columns of the other."""
    matrix[np.ix_(one, two)] = matrix[np.ix_(two, one)] = True


def _rows(poses: Poses) -> Poses:
    """Return poses of many states; one state becomes an array of one."""
    rotation, position = (np.ascontiguousarray(part) for part in poses)
    return Poses(rotation, position) if position.ndim == 3 else Poses(rotation[None], position[None])


def _room(shapes: Shapes) -> Room:
    n = len(shapes.table)
    return Room(np.zeros((n, 9)), np.zeros((n, 3)), np.zeros((4, 3)))


@functools.lru_cache(maxsize=64)
def shape_table(model: Model) -> Shapes:
    """Lay the shapes of a robot out for the kernels."""
    return shape_tables(model.shapes, [model.link_rows[shape.link] for shape in model.shapes])


class HalfSpace(NamedTuple):
    """All that lies below the plane z = 0 of a frame."""

    xyz: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)


def shape_tables(shapes: Sequence[Shape | HalfSpace], links: Sequence[int]) -> Shapes:
    """Lay shapes out for the kernels; links: the row of the link that carries each."""
    table, parts = records(len(shapes), SHAPE), [_laid_out(shape) for shape in shapes]
    if parts:
        table[:] = np.concatenate([part.row for part in parts])
    table.link = links
    polytopes = [segment(0.0), *(part.polytope for part in parts)]
    faces, around, sides_ = (np.cumsum([len(one[k]) for one in polytopes]) for k in (1, 3, 4))
    table.first = table.first_vertex = _starts(part.polytope.vertices for part in parts)
    round_ = np.stack([table.disc, table.disc, np.zeros(len(table))], axis=1)
    table.extent = table.half + round_ + table.radius[:, None]
    heights = [_heights(shape, row) for shape, row in zip(shapes, table)]
    table.first_node = _starts(heights)
    for row, part in zip(table, parts):
        if row.kind == HULL:
            row.extent = np.abs(part.polytope.vertices).max(axis=0) + row.radius
    table.first_normal, table.first_edge = (_starts(part.sides[k] for part in parts) for k in (0, 1))
    table.first_face, table.first_side = faces[:-1], sides_[:-1]
    loops = [one.loops + np.array([[start, 0]]) for one, start in zip(polytopes[1:], around)]
    return Shapes(
        table,
        *(np.concatenate([np.zeros((0, 3)), *each]) for each in (
            [part.polytope.vertices for part in parts], *([part.sides[k] for part in parts] for k in (0, 1)),
        )),
        np.concatenate([one.planes for one in polytopes]),
        np.concatenate([polytopes[0].loops, *loops]),
        *(np.concatenate([one[k] for one in polytopes]) for k in (3, 4)),
        np.concatenate([np.zeros(0), *heights]),
    )  # fmt: skip


def _heights(shape: Shape | HalfSpace, row: Any) -> np.ndarray:
    """Return the heights of a field over the center of its row (nx ny,) [m], of another shape none."""
    field = getattr(shape, "geometry", None)
    if not isinstance(field, HeightField):
        return np.zeros(0)
    return (field.heights - _middle(field)[2]).ravel()


def _middle(field: HeightField) -> np.ndarray:
    """Return the center (3,) of a box about a field [m]; it is solid to a cell's width below its lowest node."""
    across = np.array(field.origin) + 0.5 * np.array(field.spacing) * (np.array(field.heights.shape) - 1)
    low = field.heights.min() - max(field.spacing)
    return np.array([*across, 0.5 * (low + field.heights.max())])


def _starts(parts: Iterable[np.ndarray]) -> np.ndarray:
    """Return where each of several arrays starts when they are put one after the other."""
    return np.cumsum([0, *map(len, parts)])[:-1]


class _LaidOut(NamedTuple):
    """A shape by itself; not to be changed."""

    row: np.recarray  # (1,) SHAPE
    sides: Sides
    polytope: Polytope


@functools.lru_cache(maxsize=1024)
def _laid_out(shape: Shape | HalfSpace) -> _LaidOut:
    table = records(1, SHAPE)
    row: Any = table[0]
    row.E = rotation_from_rpy(shape.rpy).ravel()
    more = _fill(row, shape)
    of_hull, polytope = sides(more) if len(more) else Sides(more, more), _polytope(row, more)
    row.corners, row.normals, row.edges = len(more), len(of_hull.normals), len(of_hull.edges)
    row.vertices, row.faces, row.sides = len(polytope.vertices), len(polytope.planes), len(polytope.sides)
    return _LaidOut(table, of_hull, polytope)


def contact_bench(shapes: Shapes) -> Bench:
    """Make the scratch arrays that contact of any two of these shapes needs; kinds that are absent have no code."""
    kinds = {int(kind) for kind in shapes.table["kind"]}
    vertices, sides = (max(int(shapes.table[name].max(initial=1)), 2) for name in ("vertices", "sides"))
    return Bench(
        np.zeros((4, 3)),
        np.zeros((4, 3)),
        np.zeros((2, vertices, 3)),
        np.zeros((2, 2 * vertices + 16, 6)),
        np.zeros((2, sides), np.int64) if kinds & {BOX, HULL} else None,
        np.zeros(0) if CYLINDER in kinds else None,
        field_bench(shapes) if FIELD in kinds else None,
    )


def field_bench(shapes: Shapes) -> FieldBench:
    """Make the scratch arrays of height fields: all shapes once more, and a segment, whose length kernels change."""
    table, corners = records(len(shapes.table) + 1, SHAPE), np.concatenate([shapes.corners, np.zeros((2, 3))])
    table[:-1] = shapes.table
    row: Any = table[-1]
    row.kind, row.vertices, row.sides = SEGMENT, 2, 1
    row.first_vertex, row.first_side = len(shapes.corners), len(shapes.sides)
    sides_ = np.concatenate([shapes.sides, [[0, 1, -1, -1]]])
    whole = shapes._replace(table=table, corners=corners, sides=sides_)
    return FieldBench(whole, np.zeros((8, 8)), np.zeros((MANY, COLUMNS)))


def _polytope(row: Any, corners: np.ndarray) -> Polytope:
    """Return the polytope of a core that is one; a cylinder or a half space has the point of its center."""
    if row.kind == HULL:
        return hull(corners)
    return box(row.half) if row.kind == BOX else segment(row.half[2] if row.kind == SEGMENT else 0.0)


def _fill(row: Any, shape: Shape | HalfSpace) -> np.ndarray:
    """Write a shape's sizes and place; return the corners (n, 3) of a hull about its center [m], else none."""
    corners, center = np.zeros((0, 3)), np.zeros(3)
    if isinstance(shape, HalfSpace):
        row.kind, row.r, row.bound = HALF_SPACE, shape.xyz, np.inf
        return corners
    match shape.geometry:
        case Sphere(radius):
            row.kind, row.radius = POINT, radius
        case Capsule(radius, length):
            row.kind, row.radius, row.half = SEGMENT if length > 0.0 else POINT, radius, (0.0, 0.0, 0.5 * length)
        case Cylinder(radius, length):
            row.kind, row.disc, row.half = CYLINDER if radius > 0.0 else SEGMENT, radius, (0.0, 0.0, 0.5 * length)
        case Box(size):
            row.kind, row.half = BOX, 0.5 * np.array(size)
        case HeightField() as field:
            row.kind, row.nodes, row.spacing, center = FIELD, field.heights.shape, field.spacing, _middle(field)
            row.half = np.array([*center[:2] - field.origin, center[2] - field.heights.min() + max(field.spacing)])
        case _:
            row.kind = HULL
            corners, row.radius = local_corners(shape), corner_error(shape)
            center = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
            corners = corners - center
    row.r = np.array(shape.xyz) + applied(rotation_from_rpy(shape.rpy), center)
    x, y, z = row.half
    core = np.sqrt(x * x + y * y + (z * z + row.disc * row.disc))
    row.bound = row.radius + max(core, float(np.sqrt((corners**2).sum(axis=1)).max(initial=0.0)))
    return corners
