"""Find what lies on what where all bodies of a scene start: it sizes their contacts.

What is near a tree and ends higher may lie on it, directly or through others.  A rigid body on N points of one
stiffness puts m g / N on each if the load is in their middle, and up to m g on one of them if it is not: points that
bear more than twice the even share are so much stiffer that they sink by two penetrations.  The points of two bodies
are taken to be the corners of where boxes around them overlap, seen along gravity.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ..base.fixed_order import applied, product, total
from ..base.rotation import rotation_from_quaternion
from ..core.shapes.distance import FIELD, HALF_SPACE, POINT, SEGMENT, Shapes
from ..dynamics.tree import Tree
from ..model.numpy_dynamics import link_poses
from ..model.rest_posture import START, nearest_posture, standing_keyframe
from .contact import TWO_DEPTHS, plane_axes, standing_height
from .forest import Member, named
from .options import SceneOptions

CARRYING = 4  # of the points of two shapes, at most
ACROSS = 0.5  # cosine of the angle to the vertical, beyond which what divides two bodies stands between them
NEAR = 0.05  # distance of boxes around shapes that are near each other [m]
LINE = 1e-9  # of the squares of distances, below which points are on a line
ROUNDING = 1e-9  # of a share
LIGHTEST = 1e-300  # [kg]


class Loads(NamedTuple):
    """Hold what lies on what where all start.

    Attributes
    ----------
    near : ndarray
        Which pairs are near each other (pairs,).
    above : ndarray
        Mass that may lie on each tree (trees,) [kg].
    bears : ndarray
        Which pairs bear any of it (pairs,).
    most : ndarray
        Most that one of four points of each pair bears (pairs,) [kg], 0 of others.
    most_on_ground : ndarray
        The same of contact points with the ground, by their even share (trees,), 0 where nothing lies on the tree.
    """

    near: np.ndarray
    above: np.ndarray
    bears: np.ndarray
    most: np.ndarray
    most_on_ground: np.ndarray


class _Places(NamedTuple):
    """Poses of the bodies where all start, and which way is up there."""

    rotation: np.ndarray  # (bodies + 1, 3, 3), of the world the last
    position: np.ndarray  # (bodies + 1, 3) [m]
    up: np.ndarray  # (3,)

    def of_shapes(self, shapes: Shapes) -> tuple[np.ndarray, np.ndarray]:
        """Return centers (shapes, 3) [m] and axes (shapes, 3, 3) of boxes around shapes."""
        at = shapes.table
        turn = self.rotation[at.link]
        return self.position[at.link] + applied(turn, at.r), product(turn, at.E.reshape(-1, 3, 3))


def loads_at_start(
    table: np.recarray, shapes: Shapes, members: Sequence[Member], tree: Tree, options: SceneOptions
) -> Loads:
    """Find what lies on what where all start: on trees, on pairs of shapes and on one of their points."""
    places = _start(members, tree, options)
    gap, beside, lowest = _apart(table, shapes, places, options)
    near = gap < NEAR
    above, bears, borne = _above(table, near & ~beside, lowest, tree, options)
    a, b = table.tree_a, table.tree_b
    on_b = (lowest[table.a] > lowest[table.b]) | (shapes.table.kind[table.b] >= HALF_SPACE)
    over, under = np.where(on_b, [a, b], [b, a])
    resting, least = near & ~beside & (over != under) & (over >= 0), np.full(len(members) + 1, math.inf)
    np.minimum.at(least, over[resting], gap[resting])
    rows = np.flatnonzero(resting & (gap <= least[over] + _two_depths(options)))  # not on what is farther below
    supports = _Supports(rows, over[rows], under[rows], *_overlaps(table.a[rows], table.b[rows], shapes, places))
    most, on_ground = _on_one_point(table, supports, borne, members, tree, places, options)
    return Loads(near, above, bears, most, on_ground)


def _start(members: Sequence[Member], tree: Tree, options: SceneOptions) -> _Places:
    """Return the poses in which all start; up is against gravity, along z without."""
    bases, joints = [], []
    for member in members:
        model, (x, y, *height) = member.model, member.placed.position
        q = np.array(model.keyframes[START]) if START in model.keyframes else standing_keyframe(model)
        q = nearest_posture(model) if q is None else q
        if not height and options.ground is not None and model.base == "floating" and model.contacts:
            q[:7] = (x, y, 0.0, *member.placed.orientation)
            height = [standing_height(model, options.ground, q)]
        bases.append([x, y, *(height or [0.0]), *member.placed.orientation])
        joints.append(q[model.base_positions :])
    up = np.array([0.0, 0.0, 1.0]) if options.g == 0.0 else -np.asarray(options.gravity) / options.g
    return _Places(*body_poses(members, tree, np.array(bases), joints), up)


def _apart(
    table: np.recarray, shapes: Shapes, places: _Places, options: SceneOptions
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return how far boxes around each two shapes are apart (pairs,) [m], and which lie side by side.

    Also where shapes end below (shapes,) [m].
    """
    at, up = shapes.table, places.up
    center, axes = places.of_shapes(shapes)
    apart = center[table.a] - center[table.b]
    a, b = ((axes[one], at.extent[one]) for one in (table.a, table.b))
    flat = at.kind[table.b] == HALF_SPACE
    gaps = [_gap_along(axes[of][:, :, k], apart, a, b) for of in (table.a, table.b) for k in range(3)]
    above = total(apart * b[0][:, :, 2]) - _half_width(b[0][:, :, 2], *a)
    most = np.max(gaps, axis=0)
    rise = [abs(total(axes[of][:, :, k] * up)) for of in (table.a, table.b) for k in range(3)]
    across = np.take_along_axis(np.array(rise), np.argmax(gaps, axis=0)[None], axis=0)[0] < ACROSS
    reach = np.minimum(_half_width(np.tile(up, (len(axes), 1)), axes, at.extent), at.bound)
    return np.where(flat, above, most), ~flat & across & (most > _two_depths(options)), total(center * up) - reach


def _two_depths(options: SceneOptions) -> float:
    """Return two depths at rest [m], by which what stands beside another may be lower."""
    return TWO_DEPTHS * max(one.penetration for one in (options.pairs, options.ground) if one is not None)


def _above(
    table: np.recarray, near: np.ndarray, lowest: np.ndarray, tree: Tree, options: SceneOptions
) -> tuple[np.ndarray, np.ndarray, dict[int, list[int]]]:
    """Return the mass (trees,) that may lie on each tree where all start, directly or through others [kg].

    Also which pairs (pairs,) bear it, and which trees it is.  What is near another and ends higher may lie on it.

    near (pairs,): which are so, but for those side by side; lowest: see `_apart`.
    """
    mass, under, of = moving_masses(tree), dict[int, set[int]](), dict[int, list[int]]()
    between = near & (table.folded == 0) & (table.tree_a != table.tree_b)
    for row in table[between]:
        higher = lowest[row.a] - lowest[row.b]
        if abs(higher) > _two_depths(options):
            over, low = (row.tree_a, row.tree_b) if higher > 0.0 else (row.tree_b, row.tree_a)
            under.setdefault(int(low), set()).add(int(over))
    found = np.zeros(len(mass))
    for low in under:
        borne, left = {low}, [low]
        while left:
            new = under.get(left.pop(), set()) - borne
            borne |= new
            left += new
        of[low] = sorted(borne - {low})
        found[low] = math.fsum(mass[k] for k in of[low])
    return found, near & (between | ((table.folded == 1) & (found[table.tree_a] > 0.0))), of


class _Supports(NamedTuple):
    """Pairs of which one rests on the other."""

    pair: np.ndarray  # (supports,) its row
    over: np.ndarray  # (supports,) the tree that rests
    under: np.ndarray  # (supports,) the tree that it rests on, or -1
    low: np.ndarray  # (supports, 2) where they overlap, across gravity [m]
    high: np.ndarray  # (supports, 2) [m]


def _overlaps(a: np.ndarray, b: np.ndarray, shapes: Shapes, places: _Places) -> tuple[np.ndarray, np.ndarray]:
    """Return from where to where (pairs, 2) boxes around shapes a and b (pairs,) overlap across gravity [m]."""
    center, axes = places.of_shapes(shapes)
    across = _across(places.up)
    half = [_half_width(np.tile(one, (len(axes), 1)), axes, shapes.table.extent) for one in across]
    half = np.minimum(np.stack(half, axis=1), shapes.table.bound[:, None])
    half[shapes.table.kind >= HALF_SPACE] = math.inf
    middle = applied(across, center)
    low = np.maximum(*(middle[of] - half[of] for of in (a, b)))
    high = np.minimum(*(middle[of] + half[of] for of in (a, b)))
    between = 0.5 * (low + high)
    return np.minimum(low, between), np.maximum(high, between)


def _across(up: np.ndarray) -> np.ndarray:
    """Return two directions (2, 3) across gravity, x and y if it is along z."""
    first = np.eye(3)[np.abs(up).argmin()]
    first = first - total(first * up) * up
    first /= math.sqrt(total(first * first))
    return np.stack([first, np.cross(up, first)])


def _on_one_point(
    table: np.recarray,
    supports: _Supports,
    borne: dict[int, list[int]],
    members: Sequence[Member],
    tree: Tree,
    places: _Places,
    options: SceneOptions,
) -> tuple[np.ndarray, np.ndarray]:
    """Return what bears most on one point: see `Loads.most` and `Loads.most_on_ground`."""
    most, on_ground = np.zeros(len(table)), np.zeros(len(members))
    mass, centers = moving_masses(tree), applied(_across(places.up), _centers_of_mass(tree, places))
    carrying = np.minimum(table.slots[supports.pair], CARRYING) == CARRYING
    middle = 0.5 * (supports.low + supports.high)
    of = {t: np.flatnonzero(supports.over == t) for t in np.unique(supports.over).tolist()}
    for t in sorted(of.keys() | borne.keys()):
        if trees_of(tree)[t].fixed:
            continue
        rows = of.get(t, np.zeros(0, int))
        feet, count = _feet(members[t], tree, places, options) if t in borne else (np.zeros((0, 2)), 0)
        corners = [
            np.array([(x, y) for x in (low[0], high[0]) for y in (low[1], high[1])]) if four else point[None]
            for low, high, point, four in zip(supports.low[rows], supports.high[rows], middle[rows], carrying[rows])
        ]
        if not len(feet) + len(corners):
            continue
        moments, on = mass[t] * centers[t], supports.under == t
        low = supports.low[on].min(axis=0) if on.any() else centers[t]
        high = supports.high[on].max(axis=0) if on.any() else centers[t]
        for k in borne.get(t, []):
            alone = len(np.unique(supports.under[of[k]])) == 1  # what lies on several trees may be anywhere on this one
            moments = moments + mass[k] * (np.clip(centers[k], low, high) if alone else 0.5 * (low + high))
        whole = mass[t] + math.fsum(mass[k] for k in borne.get(t, []))
        shares = whole * _shares(np.concatenate([feet, *corners]), moments / whole)
        if len(feet):
            on_ground[t] = shares[: len(feet)].max() * count / whole
        of_corners = np.split(shares[len(feet) :], np.cumsum([len(one) for one in corners])[:-1])
        for row, own, four in zip(supports.pair[rows], of_corners, carrying[rows]):
            most[row] = own.max() if four else 0.0
    return most, on_ground


def _feet(member: Member, tree: Tree, places: _Places, options: SceneOptions) -> tuple[np.ndarray, int]:
    """Return the lowest contact points (points, 2) of a member, across gravity [m], and how many share its weight."""
    model, ground = member.model, options.ground
    points = [point for point in model.contacts if point.load_bearing] or model.contacts
    if ground is None or not points or not member.placed.ground_contact:
        return np.zeros((0, 2)), 0
    at = [tree.placements[named(member, point.link)] for point in points]
    own = np.array([one.r + applied(one.E, np.array(point.position)) for one, point in zip(at, points)])
    rows = [one.row for one in at]
    found = places.position[rows] + applied(places.rotation[rows], own)
    height = total(found * (places.up if ground.field is not None else plane_axes(ground)[0]))
    return applied(_across(places.up), found[height < height.min() + NEAR]), len(points)


def _centers_of_mass(tree: Tree, places: _Places) -> np.ndarray:
    """Return the center of mass (trees, 3) of each tree, without a root that is fixed [m]."""
    bodies = tree.bodies
    at = places.position[:-1] + applied(places.rotation[:-1], bodies.c)
    own = [slice(one.root + one.fixed, one.end) for one in trees_of(tree)]
    sums = [total(bodies.m[of, None] * at[of], axis=0) if of.start < of.stop else np.zeros(3) for of in own]
    return np.array(sums) / np.maximum(moving_masses(tree), LIGHTEST)[:, None]


def _shares(points: np.ndarray, load: np.ndarray) -> np.ndarray:
    """Return the shares (points,) of a load at a place (2,) that points (points, 2) of one stiffness bear.

    A rigid body sinks by a linear function of the place; points that it leaves bear nothing.
    """
    left, found = np.arange(len(points)), np.zeros(len(points))
    while True:
        middle = total(points[left], axis=0) / len(left)
        off = points[left] - middle
        (xx, xy), (_, yy) = total(off[:, :, None] * off[:, None, :], axis=0)
        both, det = xx + yy, xx * yy - xy * xy
        if det > LINE * both * both:
            inverse = np.array([[yy, -xy], [-xy, xx]]) / det
        else:
            inverse = np.array([[xx, xy], [xy, yy]]) / max(both * both, LIGHTEST)
        shares = 1.0 / len(left) + applied(off, applied(inverse, load - middle))
        if len(left) == 1 or shares.min() > -ROUNDING:
            found[left] = shares
            return found
        left = left[shares > 0.0]


def _gap_along(
    normal: np.ndarray, apart: np.ndarray, a: tuple[np.ndarray, np.ndarray], b: tuple[np.ndarray, np.ndarray]
) -> np.ndarray:
    """Return how far boxes, of axes (n, 3, 3) and extents (n, 3), are apart along normals (n, 3) [m]."""
    return np.abs(total(normal * apart)) - _half_width(normal, *a) - _half_width(normal, *b)


def _half_width(normal: np.ndarray, axes: np.ndarray, extent: np.ndarray) -> np.ndarray:
    """Return how far boxes reach from their centers along normals (n, 3) [m]."""
    return total(np.abs(total(axes * normal[:, :, None], axis=1)) * extent)


def body_poses(
    members: Sequence[Member], tree: Tree, bases: np.ndarray, joints: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Compute rotation (n + 1, 3, 3) and origin (n + 1, 3) [m] in the world of all bodies, and of the world itself.

    bases (members, 7): position and quaternion of each; joints: of each member (n,) [rad or m].
    """
    rotation = np.tile(np.eye(3), (len(tree.bodies) + 1, 1, 1))
    position = np.zeros((len(rotation), 3))
    for member, base, q in zip(members, bases, joints):
        still = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0] if member.model.base == "floating" else []
        poses = link_poses(member.model, np.array([*still, *q]))
        turn = rotation_from_quaternion(base[3:] / np.sqrt(total(base[3:] * base[3:])))
        for link, E, r in zip(member.model.links, poses.rotation, poses.position):
            place = tree.placements[named(member, link.name)]
            rotation[place.row] = E = product(product(turn, E), place.E.T)
            position[place.row] = base[:3] + applied(turn, r) - applied(E, place.r)
    return rotation, position


def trees_of(tree: Tree) -> Any:
    """Return the records TREE of a joined tree."""
    assert tree.trees is not None
    return tree.trees


def moving_masses(tree: Tree) -> list[float]:
    """Return the mass of each tree, without a root that is fixed [kg]."""
    return [math.fsum(tree.bodies.m[one.root + one.fixed : one.end].tolist()) for one in trees_of(tree)]


def carrying(table: np.recarray, shapes: Shapes) -> np.ndarray:
    """Return on how many points (pairs,) each pair carries a weight."""
    kinds = shapes.table.kind
    one, two = kinds[table.a], kinds[table.b]
    field = (one == FIELD) | (two == FIELD)
    low = np.minimum(one, two)
    on_field = np.where(low == POINT, 1, np.where(low == SEGMENT, 2, CARRYING))
    return np.where(field, on_field, np.minimum(table.slots, CARRYING))
