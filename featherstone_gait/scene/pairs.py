"""Build the pairs of shapes that may touch each other, and the law of their contact.

**Which.**  Of two robots, objects or obstacles, each shape of one with each of the other, if one of both can move.  Of
one robot those that `meeting_shapes` finds: no neighbors, and none that overlap at rest.  What the scene excludes is
left out.  A pair of links that is asked for by name is taken although they are neighbors or overlap at rest.  Links
without contact points touch the ground with their shapes.

**How.**  Of a pair that rests under the weight of a mass m on N points, each point has the stiffness k = m g / (N
penetration), and Hunt and Crossley's damping d = 2 zeta / sqrt(g penetration), as points on the ground have (see
contact.py).  m is the stated load, else all that may come to rest on the pair: the mass of its trees and of all that
these can touch directly or through others, without roots that are fixed.  N is 1 for spheres, 2 for capsules, 4 else.
The ground bears each tree by its own mass and that of all that lies on it where all start (see loads.py), or by a
stated load that is more.  Where one of N points bears more than twice m g / N there, points are stiffer.
Of two bodies that bear others there, and of which one is thin, the penetration is a tenth of its thickness.
The tangential damping is that of the reduced mass of the two.  The coefficients of friction are those that the scene
states of the two shapes, else follow from theirs (see model/pair_friction.py).  On the ground a shape has the numbers
that a point of its link would have, for the weight of its own tree.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from ..base.fixed_order import applied, product
from ..base.records import records
from ..core.effects.pair import PAIR, TURNING, Pairs
from ..core.shapes.distance import Shapes
from ..core.tree.layout import PRISMATIC
from ..dynamics.tree import Tree
from ..geometry.contact_choice import thinned
from ..geometry.distance import shape_tables
from ..geometry.mesh import hull_excess
from ..model import HeightField, Joint
from ..model.pair_contact import GROUND
from ..model.pair_friction import Frictions, PairFriction
from ..model.placed import Placed
from ..model.shapes import Capsule, Cylinder, Mesh, Shape, Sphere
from .contact import TWO_DEPTHS, half_thickness
from .forest import Member, shifts
from .loads import LIGHTEST, Loads, carrying, loads_at_start, moving_masses, trees_of
from .options import SceneOptions
from .pair_choice import chosen_pairs, excluded_pairs
from .preflight import SPRING, Limit, Preflight
from .solids import WORLD, Solid, parts_of
from .surface import build_surfaces, drives_of

LONGEST_SLIDE = 1e6  # way of a sliding joint without limits [m]
BEYOND = 1.1  # how far a sliding joint goes, of its limits: stops give way
POINTS_AT_ONCE = 96  # points between bodies that can move, of which so many can act at once
LEAST_POINTS = 32  # of the pool
THIN = 0.1  # of its thickness, that a thin body is pressed in where others lie on it at the start
NOTABLE_EXCESS = 1.05  # ratio of the volumes of a mesh's hull and of the mesh above which a note gives it
NEIGHBORS = 3  # of a free object, each of which it shares with another: a grid's


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
    loads : ndarray or None
        Mass that the ground bears where all start, by the tree's own (trees,); None where nothing lies on another.
    """

    table: Pairs | None = None
    names: tuple[tuple[str, str], ...] = ()
    notes: tuple[str, ...] = ()
    loads: np.ndarray | None = None


NOTHING = Touching()


def build_pairs(
    members: Sequence[Member],
    obstacles: Sequence[Placed],
    excluded: Sequence[tuple[str, str]],
    tree: Tree,
    options: SceneOptions,
    frictions: Sequence[PairFriction] = (),
) -> tuple[Touching, Tree]:
    """Return the pairs that the options ask for, and the joined tree with workspace rows for all bodies of pairs.

    Raises ValueError for names that are not in the scene, and for pairs of names of which nothing can touch.
    """
    option = options.pairs
    if option is None:
        return NOTHING, tree
    parts = parts_of(members, obstacles, tree, options.ground)
    chosen = chosen_pairs(parts, option, excluded_pairs(members, excluded))
    used = np.unique(chosen)
    if not len(used):
        return Touching(notes=(*parts.notes, "no two shapes can touch each other")), tree
    solids, chosen = [parts.solids[k] for k in used], np.searchsorted(used, chosen)
    bodies = tree.bodies
    table, tree, own_rows = _with_rows(_table(solids, chosen), tree, _with_points(members))
    shapes = _shapes(solids)
    rubs = _coefficients(table, solids, options, frictions)
    table.friction = rubs[:, 0]
    loads = loads_at_start(table, shapes, members, tree, options)
    _fill_law(table, solids, shapes, tree, options, loads)
    reach, radius = _bounds(solids, shapes, tree, [joint for one in members for joint in one.model.moving_joints])
    enough = LEAST_POINTS + _piled(table, tree) + 2 * int(table.slots[loads.near].sum())
    slots = min(int(table.slots.sum()), option.max_points or enough)
    if slots < table.slots.max():
        raise ValueError(
            f"pairs: max_points is {slots}; expected {table.slots.max()} or more, which two of the shapes can touch at"
        )
    margin = max(option.penetration, options.ground.penetration if _has_ground(solids) and options.ground else 0.0)
    room = np.array([slots, min(slots, max(POINTS_AT_ONCE, 3 * len(trees_of(tree))))])
    turning = _turning(table, shapes, rubs[:, 1], rubs[:, 2])
    outside = np.zeros(len(radius), np.int64)
    for one, other in ((table.tree_a, table.tree_b), (table.tree_b, table.tree_a)):
        outside[one[(one != other) & (one != WORLD)]] = 1
    surfaces = _surfaces(solids, members, obstacles)
    pairs = Pairs(shapes, table, bodies, own_rows, reach, outside, radius, room, margin, turning, surfaces)
    names = tuple((solids[a].link, solids[b].link) for a, b in zip(table.a.tolist(), table.b.tolist()))
    coarse = thinned(solid.shape for solid in solids if isinstance(solid.shape, Shape))
    notes = *parts.notes, *_concave(solids), *coarse
    return Touching(pairs, names, notes, _stiffer(table, loads, tree, option.load)), tree


def _stiffer(table: np.recarray, loads: Loads, tree: Tree, stated: float | None) -> np.ndarray | None:
    """Return by how much the ground is stiffer under each tree (trees,) than for its own mass; None: nowhere.

    stated: what it bears there at least, under trees that others can touch [kg].
    """
    own, above = np.maximum(moving_masses(tree), LIGHTEST), loads.above
    if stated is not None:
        between = table[table.folded == 0]
        touched = np.isin(np.arange(len(own)), np.concatenate([between.tree_a, between.tree_b]))
        above = np.where(touched, np.maximum(stated - own, 0.0), 0.0)
    even = 1.0 + above / own
    stiffer = even if stated is not None else np.maximum(even, 0.5 * loads.most_on_ground * even)
    return stiffer if (stiffer > 1.0).any() else None


def no_pairs(tree: Tree) -> Pairs:
    """Return pairs of which there is none, for trees that are solved together all the same."""
    trees, none = len(trees_of(tree)), np.zeros(0, np.int64)
    at_least = np.ones(2, np.int64)
    return Pairs(
        _shapes([]), records(0, PAIR), tree.bodies, none, np.zeros(tree.n), np.zeros(trees, np.int64), np.zeros(trees),
        at_least, 0.0, None,
    )  # fmt: skip


def _concave(solids: Sequence[Solid]) -> Iterator[str]:
    """Yield a note on each mesh that is smaller than its convex hull, or whose volume is not known."""
    for solid in solids:
        mesh = getattr(solid.shape, "geometry", None)
        if isinstance(mesh, Mesh) and not (excess := hull_excess(mesh)) <= NOTABLE_EXCESS:
            known = f"which has {excess:.3g} times its volume" if excess > NOTABLE_EXCESS else "as it is not closed"
            yield (
                f"{solid.link}: the mesh {mesh.file} touches as its convex hull, {known}; where that matters, give the "
                "link several convex shapes in its place"
            )


# ---------------------------------------------------------------------------------------------- shapes


def _shapes(solids: Sequence[Solid]) -> Shapes:
    """Lay the shapes out, in the frames of their bodies."""
    shapes = shape_tables([solid.shape for solid in solids], [solid.body for solid in solids])
    for row, solid in zip(shapes.table, solids):
        row.r = solid.r + applied(solid.E, row.r)
        row.E = product(solid.E, row.E.reshape(3, 3)).ravel()
    return shapes


def _has_ground(solids: Sequence[Solid]) -> bool:
    return any(solid.link == GROUND for solid in solids)


# ---------------------------------------------------------------------------------------------- records


def _table(solids: Sequence[Solid], chosen: np.ndarray) -> np.recarray:
    """Make a record for each two shapes: a is the one that moves; of two that do, that of the later tree or body."""
    tree, body, moves = (np.array([solid[k] for solid in solids], int) for k in (2, 3, 4))
    order = np.empty(len(solids), int)
    order[np.lexsort((body, tree, moves))] = np.arange(len(solids))
    low, high = chosen.T
    a, b = np.where(order[low] > order[high], [low, high], [high, low])
    rows = np.lexsort((b, a, body[b], body[a], tree[b], tree[a]))
    a, b = a[rows], b[rows]
    table = records(len(rows), PAIR)
    table.a, table.b, table.tree_a, table.tree_b = a, b, tree[a], tree[b]
    table.body_a, table.body_b, table.folded = body[a], body[b], 1 - moves[b]
    kinds = [solid.kind for solid in solids]
    known = [*dict.fromkeys(kinds)]
    kind = np.array([known.index(one) for one in kinds])
    slots = np.array([[points_of({x, y}) for y in known] for x in known])
    table.slots = slots[kind[a], kind[b]]
    return table


def points_of(kinds: set[type]) -> int:
    """Return how many points two shapes of these kinds can touch at."""
    if HeightField in kinds:
        return 4 if Sphere in kinds else 8
    if Sphere in kinds:
        return 1
    if Capsule in kinds:
        return 3 if Cylinder in kinds else 2  # where the capsule crosses the border of an end, and the deepest
    return 8


def _with_points(members: Sequence[Member]) -> np.ndarray:
    """Return the rows of the bodies that touch the ground with points, or have shapes in a fluid."""
    contacts = [member.scene.constants.contact for member in members]
    moved = shifts([member.scene for member in members])
    rows = [one.points.body + at.body for one, at in zip(contacts, moved) if one is not None]
    fluids = [member.scene.constants.fluid for member in members]
    rows += [one.table.body + at.body for one, at in zip(fluids, moved) if one is not None]
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
    table.own_a, table.own_b = (np.isin(of, pointed, invert=True) for of in (table.body_a, table.body_b))
    still = table.tree_b == WORLD
    table.body_b = np.where(still, 0, table.body_b)
    table.row_a = bodies.contact[table.body_a]
    table.row_b = np.where(still, 0, bodies.contact[table.body_b])
    parent, same = bodies.parent.tolist(), np.flatnonzero(table.tree_a == table.tree_b)
    meet, both = np.full(len(table), len(bodies)), zip(table.body_a[same].tolist(), table.body_b[same].tolist())
    meet[same] = [_common(parent, a, b) for a, b in both]
    table.meet = meet
    return table, tree._replace(bodies=bodies, rows=tree.rows + len(new)), own


def _common(parent: Sequence[int], a: int, b: int) -> int:
    """Return the last body that two bodies of one tree hang on."""
    while a != b:
        a, b = (parent[a], b) if a > b else (a, parent[b])
    return a


def _fill_law(
    table: np.recarray,
    solids: Sequence[Solid],
    shapes: Shapes,
    tree: Tree,
    options: SceneOptions,
    loads: Loads,
) -> None:
    """Fill stiffness and damping of each pair; the ground's are those that it has for points."""
    option, ground, g = options.pairs, options.ground, options.pressing
    assert option is not None
    on_ground = np.array([solid.link == GROUND for solid in solids])[table.b]
    load = _resting(table, tree, on_ground, loads.above) if option.load is None else np.full(len(table), option.load)
    points, reduced = carrying(table, shapes), _reduced(table, tree)
    depth, ratio = np.full(len(table), option.penetration), np.full(len(table), option.damping_ratio)
    half = half_thickness(shapes)
    thinner = np.minimum(half[table.a], half[table.b])
    if option.load is None:
        depth = np.where(loads.bears, np.minimum(depth, np.maximum(2.0 * THIN * thinner, THIN * depth)), depth)
    if ground is not None:
        depth[on_ground], ratio[on_ground] = ground.penetration, ground.damping_ratio
    table.deepest = np.maximum(thinner, TWO_DEPTHS * depth)
    most = loads.most if option.load is None else 0.0
    table.stiffness = k = np.maximum(load * g / (points * depth), most * g / (2.0 * depth))
    table.damping = 2.0 * ratio / np.sqrt(g * depth)
    table.tangential_stiffness = k
    table.tangential_damping = 2.0 * np.maximum(ratio, 0.1) * np.sqrt(k * reduced / points)


def _coefficients(
    table: np.recarray, solids: Sequence[Solid], options: SceneOptions, stated: Sequence[PairFriction]
) -> np.ndarray:
    """Return the coefficients (pairs, 3) of sliding [-], spinning and rolling [m] of each pair."""
    assert options.pairs is not None
    frictions, ground = Frictions(stated, options.pairs), options.ground.friction if options.ground else 0.0
    kinds: dict[Any, int] = {}  # shapes with the same coefficients of which the scene states the same
    kind = np.array([kinds.setdefault(frictions.kind(solid.names, solid.shape), len(kinds)) for solid in solids])
    _, first, of = np.unique(kind[table.a] * len(kinds) + kind[table.b], return_index=True, return_inverse=True)
    found = []
    for a, b in ((solids[row.a], solids[row.b]) for row in table[first]):
        if b.link == GROUND:
            found.append(frictions.on_ground(a.names, a.shape, ground))
        else:
            found.append(frictions.of((a.names, b.names), a.shape, b.shape))
    return np.array(found)[of]


def _turning(table: np.recarray, shapes: Shapes, torsional: np.ndarray, rolling: np.ndarray) -> np.recarray | None:
    """Return the resistance to rolling and spinning, None where no pair has any.

    Its springs and dampers are those of friction at the distance to which the smaller shape reaches.
    """
    found, lever = records(len(table), TURNING), np.minimum(shapes.table.bound[table.a], shapes.table.bound[table.b])
    found.torsional, found.rolling = torsional, rolling
    found.tangential_stiffness = table.tangential_stiffness * lever * lever
    found.tangential_damping = table.tangential_damping * lever * lever
    return found if (found.torsional > 0.0).any() or (found.rolling > 0.0).any() else None


def _surfaces(solids: Sequence[Solid], members: Sequence[Member], obstacles: Sequence[Placed]) -> np.recarray | None:
    """Return the surfaces of shapes, whose drives are numbered as those of the scene; None where all are at rest."""
    numbers: dict[str, dict[str, int]] = {GROUND: {}}
    count = 0
    for placed in (*(member.placed for member in members), *obstacles):
        names = drives_of(placed.model)
        numbers[placed.name] = {name: count + k for k, name in enumerate(names)}
        count += len(names)
    return build_surfaces([(solid.shape, solid.E, solid.r, numbers[solid.of]) for solid in solids])


def _resting(table: np.recarray, tree: Tree, on_ground: np.ndarray, above: np.ndarray) -> np.ndarray:
    """Return the mass (pairs,) that may come to rest on each pair [kg].

    It is the mass of the group of trees that can touch each other, directly or through others.  on_ground: (pairs,)
    whether a pair is one with the ground, which bears each tree by its own mass and what lies on it at the start.
    """
    from scipy.sparse import coo_array  # slow to import
    from scipy.sparse.csgraph import connected_components

    mass, both = np.array(moving_masses(tree)), table.folded == 0
    meeting = coo_array((np.ones(both.sum()), (table.tree_a[both], table.tree_b[both])), shape=(len(mass), len(mass)))
    group = connected_components(meeting, directed=False)[1]
    return np.where(on_ground, (mass + above)[table.tree_a], np.bincount(group, mass)[group[table.tree_a]])


def _reduced(table: np.recarray, tree: Tree) -> np.ndarray:
    """Return the reduced mass of the two trees of each pair [kg]."""
    mass = np.array([*moving_masses(tree), 0.0])  # of WORLD, the last, none
    one, two = mass[table.tree_a], mass[table.tree_b]
    return np.where(table.folded, one, one * two / np.maximum(one + two, LIGHTEST))


def limited(check: Preflight, touching: Touching, tree: Tree) -> Preflight:
    """Return the limits of explicit steps with that of contact between bodies, as if both were free and rigid."""
    if touching.table is None:
        return check
    table = touching.table.pairs
    steps = 2.0 * np.sqrt(_reduced(table, tree) / (carrying(table, touching.table.shapes) * table.stiffness))
    k = int(steps.argmin())
    limit = Limit(" - ".join(touching.names[k]), float(steps[k]), SPRING)
    largest, sliding = (min(one, limit.step) for one in (check.largest_explicit_step, check.sliding_step))
    check = check._replace(largest_explicit_step=largest, sliding_step=sliding)
    return check._replace(limits=(*check.limits, limit))


def _piled(table: np.recarray, tree: Tree) -> int:
    """Return the points of `NEIGHBORS` pairs of each free object, which may be piled up."""
    most = np.zeros(len(tree.bodies), int)
    for body, solid in ((table.body_a, table.tree_a >= 0), (table.body_b, table.folded == 0)):
        np.maximum.at(most, body[solid], table.slots[solid])
    free = [one.root for one in trees_of(tree) if one.end - one.root == 1]
    return NEIGHBORS * int(most[free].sum())


def _bounds(
    solids: Sequence[Solid], shapes: Shapes, tree: Tree, joints: Sequence[Joint]
) -> tuple[np.ndarray, np.ndarray]:
    """Return how far shapes move by a radian or meter of each joint, and how far from its base a tree reaches [m].

    Both are upper bounds for all postures within the limits of sliding joints: the ways along the tree, put straight.
    """
    bodies = tree.bodies
    out, across = np.full((2, len(bodies) + 1), -math.inf)  # from origin and from z axis to the farthest point
    for solid, row in zip(solids, shapes.table):
        x, y, z = row.r.tolist()
        out[solid.body] = max(out[solid.body], math.sqrt(x * x + y * y + z * z) + row.bound)
        across[solid.body] = max(across[solid.body], math.sqrt(x * x + y * y) + row.bound)
    roots = {int(one.root) for one in trees_of(tree)}
    reach = np.zeros(len(joints))
    for i in range(len(bodies) - 1, -1, -1):
        if i in roots or out[i] < 0.0:
            continue
        body = bodies[i]
        (x, y, z), way = body.r.tolist(), _travel(joints[body.dof]) if body.kind == PRISMATIC else 0.0
        reach[body.dof] = 1.0 if body.kind == PRISMATIC else across[i] + abs(body.pitch)
        parent = body.parent
        out[parent] = max(out[parent], math.sqrt(x * x + y * y + z * z) + way + out[i])
        across[parent] = max(across[parent], math.sqrt(x * x + y * y) + way + out[i])
    return reach, np.maximum(out[trees_of(tree).root], 0.0)


def _travel(joint: Joint) -> float:
    """Return how far a sliding joint can be from zero [m]."""
    return min(BEYOND * max(abs(joint.lower), abs(joint.upper)), LONGEST_SLIDE)
