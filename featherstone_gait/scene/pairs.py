"""Build the pairs of shapes that may touch each other, and the law of their contact.

**Which.**  Of two robots, objects or obstacles, each shape of one with each of the other, if one of both can move.  Of
one robot those that `meeting_shapes` finds: no neighbors, and none that overlap at rest.  What the scene excludes is
left out.  A pair of links that is asked for by name is taken although they are neighbors or overlap at rest.  Links
without contact points touch the ground with their shapes.

**How.**  Of a pair that rests under the weight of a mass m on N points, each point has the stiffness k = m g / (N
penetration), and Hunt and Crossley's damping d = 2 zeta / sqrt(g penetration), as points on the ground have (see
contact.py).  m is the stated load, else the mass of the heavier of the two trees, without a root that is fixed; N is 1
for spheres, 2 for capsules, 4 else.  The tangential damping is that of the reduced mass of the two.  The coefficient of
friction is the geometric mean of those of the two shapes, in place of which the scene's stands where one has none.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from ..base.fixed_order import applied, product
from ..base.rotation import rotation_from_quaternion
from ..core.effects.pair import PAIR, Pairs
from ..core.tree.distance import SHAPE, Shapes
from ..geometry.distance import meeting_shapes, shape_table
from ..model import Ground, Joint
from ..model.pair_contact import ALL, PairContact
from ..model.placed import SEPARATOR, Placed, link_name
from ..model.shapes import Capsule, Sphere
from .forest import Member, named, shifts
from .options import SceneOptions
from .records import records
from .tree import GRAVITY, Tree

WORLD = -1  # the tree of what never moves
FAR = 1e6  # way of a sliding joint without limits [m]
BEYOND = 1.1  # how far a sliding joint goes, of its limits: stops give way
LEAST_POINTS = 32  # of the pool
NEIGHBORS = 3  # of a free object, each of which it shares with another: a grid's
EARTH = math.sqrt(sum(g * g for g in GRAVITY))  # in place of no gravity [m/s^2]


class Touching(NamedTuple):
    """The pairs of a scene.

    Attributes
    ----------
    table : Pairs or None
        What the kernels read; None if nothing can touch.
    names : tuple of (str, str)
        The links of each row of the table.
    notes : tuple of str
        What is left out, one sentence each.
    """

    table: Pairs | None = None
    names: tuple[tuple[str, str], ...] = ()
    notes: tuple[str, ...] = ()


NOTHING = Touching()


class Solid(NamedTuple):
    """A shape in the scene."""

    link: str  # name in the scene
    of: str  # name of the member or obstacle
    tree: int  # number of the tree, or WORLD
    body: int  # row of the body, or one beyond all of them
    moves: bool
    kind: type
    friction: float | None
    on_points: bool  # its link touches the ground with points, or not at all


class Parts(NamedTuple):
    """All shapes of a scene, in the order of the table."""

    solids: list[Solid]
    shapes: Shapes
    meeting: np.ndarray  # (n, 2) rows of the shapes of one robot that can meet
    notes: list[str]


def build_pairs(
    members: Sequence[Member],
    obstacles: Sequence[Placed],
    excluded: Sequence[tuple[str, str]],
    tree: Tree,
    options: SceneOptions,
) -> tuple[Touching, Tree]:
    """Return the pairs that the options ask for, and the joined tree with workspace rows for all bodies of pairs.

    Raises ValueError for names that are not in the scene, and for pairs of names of which nothing can touch.
    """
    option = options.pairs
    if option is None:
        return NOTHING, tree
    parts = _parts(members, obstacles, tree, options.ground)
    chosen = _chosen(parts, option, _excluded(members, excluded))
    used = np.unique(chosen)
    if not len(used):
        return Touching(notes=(*parts.notes, "no two shapes can touch each other")), tree
    parts, chosen = _only(parts, used), np.searchsorted(used, chosen)
    table, tree, own_rows = _with_rows(_table(parts, chosen), tree, _with_points(members))
    _fill_law(table, [parts.solids[k] for k in table.a], [parts.solids[k] for k in table.b], tree, options)
    reach, radius = _bounds(parts, tree, [joint for one in members for joint in one.model.moving_joints])
    slots = np.array([min(int(table.slots.sum()), option.max_points or _enough(table, tree))])
    pairs = Pairs(parts.shapes, table, own_rows, reach, radius, slots, option.penetration)
    names = tuple((parts.solids[a].link, parts.solids[b].link) for a, b in zip(table.a, table.b))
    return Touching(pairs, names, tuple(parts.notes)), tree


# ---------------------------------------------------------------------------------------------- shapes


def _parts(members: Sequence[Member], obstacles: Sequence[Placed], tree: Tree, ground: Ground | None) -> Parts:
    """Gather all shapes: of members in the frames of their bodies, of obstacles in the world."""
    solids: list[Solid] = []
    tables: list[Shapes] = []
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
        table = _copied(shape_table(model))
        for row, shape in zip(table.table, model.shapes):
            place = tree.placements[named(member, shape.link)]
            row.link = place.row
            _move(row, place.E, place.r)
            moves = place.row > own.root or not own.fixed
            on_points = shape.link in pointed or not member.placed.ground_contact
            solid = (named(member, shape.link), member.name, number, place.row, moves, type(shape.geometry))
            solids.append(Solid(*solid, shape.friction, on_points))
        tables.append(table)
    for placed in obstacles:
        table, turn = _copied(shape_table(placed.model)), rotation_from_quaternion(np.array(placed.orientation))
        for row, shape in zip(table.table, placed.model.shapes):
            row.link = len(tree.bodies)
            _move(row, turn, np.array((*placed.position, 0.0)[:3]))
            link = link_name(placed.name, shape.link)
            solids.append(
                Solid(link, placed.name, WORLD, row.link, False, type(shape.geometry), shape.friction, True)
            )
        tables.append(table)
    return Parts(solids, _joined(tables), np.concatenate(meeting), notes)


def _copied(shapes: Shapes) -> Shapes:
    return shapes._replace(table=shapes.table.copy())


def _move(row: np.void, E: np.ndarray, r: np.ndarray) -> None:
    """Express a shape in another frame, in which its own has the rotation E and the origin r [m]."""
    row["r"] = r + applied(E, row["r"])
    row["E"] = product(E, row["E"].reshape(3, 3)).ravel()


def _joined(tables: Sequence[Shapes]) -> Shapes:
    """Put tables one after the other."""
    starts = ("first", "corners"), ("first_normal", "normals"), ("first_edge", "edges")
    for name, field in starts:
        at = 0
        for shapes in tables:
            shapes.table[name] += at
            at += len(getattr(shapes, field))
    empty = Shapes(records(0, SHAPE), *(np.zeros((0, 3)) for _ in starts))
    joined = (np.concatenate([getattr(one, field) for one in (empty, *tables)]) for field in Shapes._fields)
    table, *points = joined
    return Shapes(table.view(np.recarray), *points)


def _only(parts: Parts, used: np.ndarray) -> Parts:
    """Keep the shapes of these rows."""
    shapes = parts.shapes._replace(table=parts.shapes.table[used].view(np.recarray))
    return parts._replace(solids=[parts.solids[k] for k in used], shapes=shapes)


# ---------------------------------------------------------------------------------------------- which


def _chosen(parts: Parts, option: PairContact, excluded: Iterable[tuple[str, str]]) -> np.ndarray:
    """Return the rows (pairs, 2) of the shapes that may touch each other."""
    solids, n = parts.solids, len(parts.solids)
    tree, body = np.array([s.tree for s in solids], int), np.array([s.body for s in solids], int)
    moves = np.array([s.moves for s in solids], bool)
    possible = (moves[:, None] | moves) & (body[:, None] != body)
    usual = possible & (tree[:, None] != tree)
    usual[tuple(parts.meeting.T)] = usual[tuple(parts.meeting.T[::-1])] = True
    usual &= possible
    rows = _rows_by_name(solids)
    apart = np.zeros((n, n), bool)
    for one, two in excluded:
        _mark(apart, rows.get(one, []), rows.get(two, []))
    if isinstance(option.select, str):
        chosen = usual if option.select == ALL else np.zeros_like(usual)
    else:
        chosen = np.zeros_like(usual)
        for pair in option.select:
            chosen |= _asked_for(pair, rows, usual, possible, apart)
    return np.argwhere(np.triu(chosen & ~apart, 1))


def _asked_for(
    pair: tuple[str, str], rows: dict[str, list[int]], usual: np.ndarray, possible: np.ndarray, apart: np.ndarray
) -> np.ndarray:
    """Return which shapes (n, n) a pair of names stands for; raise ValueError if it is none."""
    for name in pair:
        if name not in rows:
            known = ", ".join(map(repr, list(rows)[:20]))
            raise ValueError(
                f"pairs: {name!r} is no member, obstacle or link with a collision shape; expected one of {known}: "
                "correct the name, or give the link a shape"
            )
    found = np.zeros_like(usual)
    _mark(found, *(rows[name] for name in pair))
    found &= possible if all(SEPARATOR in name for name in pair) else usual
    if not (found & ~apart).any():
        cause = "are excluded" if (found & apart).any() else "do not move against each other, or are neighbors"
        raise ValueError(f"pairs: {pair[0]!r} and {pair[1]!r} cannot touch: all their shapes {cause}; leave them out")
    return found


def _mark(matrix: np.ndarray, one: Sequence[int], two: Sequence[int]) -> None:
    matrix[np.ix_(one, two)] = matrix[np.ix_(two, one)] = True


def _rows_by_name(solids: Sequence[Solid]) -> dict[str, list[int]]:
    """Return the rows of each link, and of each member or obstacle."""
    rows: dict[str, list[int]] = {}
    for k, solid in enumerate(solids):
        for name in dict.fromkeys((solid.of, solid.link)):
            rows.setdefault(name, []).append(k)
    return rows


def _excluded(members: Sequence[Member], excluded: Sequence[tuple[str, str]]) -> Iterator[tuple[str, str]]:
    """Yield the pairs of links that do not touch: those of the scene, and of each robot."""
    yield from excluded
    for member in members:
        yield from ((named(member, one), named(member, two)) for one, two in member.model.excluded)


# ---------------------------------------------------------------------------------------------- records


def _table(parts: Parts, chosen: np.ndarray) -> np.recarray:
    """Make a record for each two shapes: a is the one that moves; of two that do, that of the later tree or body."""
    solids = parts.solids
    rank = [(solid.moves, solid.tree, solid.body, k) for k, solid in enumerate(solids)]
    ordered = [(i, j) if rank[i] > rank[j] else (j, i) for i, j in chosen.tolist()]
    ordered.sort(key=lambda pair: [rank[k][part] for part in (1, 2, 3) for k in pair])
    table = records(len(ordered), PAIR)
    for row, (i, j) in zip(table, ordered):
        a, b = solids[i], solids[j]
        row.a, row.b = i, j
        row.tree_a, row.tree_b, row.body_a, row.body_b = a.tree, b.tree, a.body, b.body
        row.folded, row.slots = not b.moves, points_of({a.kind, b.kind})
    return table


def points_of(kinds: set[type]) -> int:
    """Return how many points two shapes of these kinds can touch at."""
    if Sphere in kinds:
        return 1
    if Capsule in kinds:
        return 2
    return 8


def _with_points(members: Sequence[Member]) -> np.ndarray:
    """Return the rows of the bodies that touch the ground with points."""
    contacts = [member.scene.constants.contact for member in members]
    moved = shifts([member.scene for member in members])
    rows = [one.points.body + at.body for one, at in zip(contacts, moved) if one is not None]
    return np.unique(np.concatenate([np.zeros(0, int), *rows]))


def _with_rows(table: np.recarray, tree: Tree, pointed: np.ndarray) -> tuple[np.recarray, Tree, np.ndarray]:
    """Give each body of a pair a workspace row for its contacts; return also those that points on the ground lack.

    pointed: rows of the bodies with such points.
    """
    bodies = tree.bodies.copy()
    touched = np.unique(np.concatenate([table.body_a, table.body_b[table.tree_b != WORLD]]))
    new = touched[bodies.contact[touched] == 0]
    bodies.contact[new] = tree.rows + np.arange(len(new))
    own = bodies.contact[np.setdiff1d(touched, pointed)]
    still = table.tree_b == WORLD
    table.body_b = np.where(still, 0, table.body_b)
    table.row_a = bodies.contact[table.body_a]
    table.row_b = np.where(still, 0, bodies.contact[table.body_b])
    return table, tree._replace(bodies=bodies, rows=tree.rows + len(new)), own


def _fill_law(table: np.recarray, a: Sequence[Solid], b: Sequence[Solid], tree: Tree, options: SceneOptions) -> None:
    """Fill stiffness, damping and friction of each pair."""
    option, g = options.pairs, options.g or EARTH
    assert option is not None
    mass = np.array([*moving_masses(tree), 0.0])  # of WORLD, the last, none
    one, two = mass[table.tree_a], np.where(table.folded, 0.0, mass[table.tree_b])
    load = np.maximum(one, two) if option.load is None else np.full(len(table), option.load)
    points = np.minimum(table.slots, 4)
    reduced = np.where(table.folded, one, one * two / np.where(one + two > 0.0, one + two, 1.0))
    table.stiffness = k = load * g / (points * option.penetration)
    table.damping = 2.0 * option.damping_ratio / math.sqrt(g * option.penetration)
    table.tangential_stiffness = k
    table.tangential_damping = 2.0 * max(option.damping_ratio, 0.1) * np.sqrt(k * reduced / points)
    mu = ([option.friction if s.friction is None else s.friction for s in solids] for solids in (a, b))
    table.friction = np.sqrt(np.multiply(*map(np.array, mu)))


def trees_of(tree: Tree) -> Any:
    """Return the records TREE of a joined tree."""
    assert tree.trees is not None
    return tree.trees


def moving_masses(tree: Tree) -> list[float]:
    """Return the mass of each tree, without a root that is fixed [kg]."""
    return [math.fsum(tree.bodies.m[one.root + one.fixed : one.end].tolist()) for one in trees_of(tree)]


def _enough(table: np.recarray, tree: Tree) -> int:
    """Return the slots of the pool: some for all robots, and for each free object those of `NEIGHBORS` pairs."""
    most = np.zeros(len(tree.bodies), int)
    for body, solid in ((table.body_a, table.tree_a >= 0), (table.body_b, table.folded == 0)):
        np.maximum.at(most, body[solid], table.slots[solid])
    free = [one.root for one in trees_of(tree) if one.end - one.root == 1]
    return LEAST_POINTS + NEIGHBORS * int(most[free].sum())


def _bounds(parts: Parts, tree: Tree, joints: Sequence[Joint]) -> tuple[np.ndarray, np.ndarray]:
    """Return how far shapes move by a radian or meter of each joint, and how far from its base a tree reaches [m].

    Both are upper bounds for all postures within the limits of sliding joints: the ways along the tree, put straight.
    """
    bodies = tree.bodies
    out, across = np.full((2, len(bodies) + 1), -math.inf)  # from origin and from z axis to the farthest point
    for solid, row in zip(parts.solids, parts.shapes.table):
        x, y, z = row.r.tolist()
        out[solid.body] = max(out[solid.body], math.sqrt(x * x + y * y + z * z) + row.bound)
        across[solid.body] = max(across[solid.body], math.sqrt(x * x + y * y) + row.bound)
    roots = {int(one.root) for one in trees_of(tree)}
    reach = np.zeros(len(joints))
    for i in range(len(bodies) - 1, -1, -1):
        if i in roots or out[i] < 0.0:
            continue
        body = bodies[i]
        (x, y, z), way = body.r.tolist(), _travel(joints[body.dof]) if body.prismatic else 0.0
        reach[body.dof] = 1.0 if body.prismatic else across[i]
        parent = body.parent
        out[parent] = max(out[parent], math.sqrt(x * x + y * y + z * z) + way + out[i])
        across[parent] = max(across[parent], math.sqrt(x * x + y * y) + way + out[i])
    return reach, np.maximum(out[trees_of(tree).root], 0.0)


def _travel(joint: Joint) -> float:
    """Return how far a sliding joint can be from zero [m]."""
    return min(BEYOND * max(abs(joint.lower), abs(joint.upper)), FAR)
