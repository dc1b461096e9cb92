"""Find which geoms of a compiled MJCF file touch the ground, and with what friction.

A geom touches the floor, the first plane or height field that does not move, as contype and conaffinity say, unless an
<exclude> names their two bodies.  A <pair> of a geom with one of the ground makes it touch whatever those say, with a
friction of its own.  The ground are the geoms of the world, of bodies that are no links, and planes and height fields.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ...base.flaws import quoted
from .tree import HFIELD, PLANE, Tree, moments_of, names_of

FRICTIONLESS = 1  # condim
NO_FILTER = 1 << 10  # mjtDisableBit, of <flag filterparent>
DEFAULT_FRICTION = 1.0  # MuJoCo's of a geom


class Touching(NamedTuple):
    """Hold what an MJCF file lets touch the ground."""

    friction: dict[int, float | None]  # by geom; None is the ground's
    doubts: list[str]
    remarks: list[str]


def read_touching(m: Any, tree: Tree, stated: bool) -> Touching:
    """Read what touches the ground.

    stated: whether the file states a friction of a <pair>; otherwise MuJoCo's default of 1 is none of the file's.
    """
    ground = {g for g in range(m.ngeom) if _is_ground(m, tree, g)}
    links = [g for g in range(m.ngeom) if g not in ground and tree.holds(m, int(m.geom_bodyid[g]))]
    floor = next((g for g in sorted(ground) if m.geom_type[g] in (PLANE, HFIELD)), None)
    excluded = excluded_bodies(m)
    friction: dict[int, float | None] = {
        g: None for g in links if meets(m, g, floor) and (_body(m, floor), int(m.geom_bodyid[g])) not in excluded
    }
    by_pair: dict[int, list[int]] = {}
    others: list[str] = []
    for k in range(m.npair):
        moving = [g for g in (int(m.pair_geom1[k]), int(m.pair_geom2[k])) if g not in ground]
        if len(moving) == 1 and moving[0] in links:
            by_pair.setdefault(moving[0], []).append(k)
        elif len(moving) == 2:
            others.append(m.pair(k).name or str(k))
    for g, pairs in by_pair.items():
        friction[g] = _friction(m, pairs[0], stated)
    remarks = [f"skipped the numbers in <pair> {quoted(others)} of two links"] if others else []
    remarks += _by_pair(m, {g: friction[g] for g in by_pair})
    remarks += _unread(m, [g for g in friction if g not in by_pair])
    return Touching(friction, list(_doubts(m, by_pair, stated)), remarks)


def _unread(m: Any, geoms: list[int]) -> list[str]:
    """Say which numbers of geoms that touch the ground outside of pairs are not read, where they are not MuJoCo's."""
    frictions = sorted({float(m.geom_friction[g, 0]) for g in geoms})
    margins = sorted({float(x) for g in geoms for x in (m.geom_margin[g], m.geom_gap[g])} - {0.0})
    said = []
    if any(friction != DEFAULT_FRICTION for friction in frictions):
        said.append(f"friction of geoms ({_span(frictions)}) is not read: contacts have that of the ground")
    names = names_of(m, "geom", m.ngeom)
    if spinning := [names[g] for g in geoms if moments_of(m, g)[0]]:
        said.append(f"torsional friction of geoms {quoted(spinning)} counts between bodies alone, not on the ground")
    if margins:
        said.append(f"margin and gap of geoms ({_span(margins)} m) are not read: forces begin where shapes touch")
    return said


def _span(values: list[float]) -> str:
    return f"{values[0]:g}" if len(values) == 1 else f"{values[0]:g} to {values[-1]:g}"


def _is_ground(m: Any, tree: Tree, g: int) -> bool:
    b = int(m.geom_bodyid[g])
    still = m.body_weldid[b] == 0
    return b == 0 or (still and (m.geom_type[g] in (PLANE, HFIELD) or not tree.holds(m, b)))


def _body(m: Any, floor: int | None) -> int:
    return 0 if floor is None else int(m.geom_bodyid[floor])


def meets(m: Any, g: int, floor: int | None) -> bool:
    """Return whether the bits of a geom meet those of the floor, or without one those that geoms have by default."""
    kind, affinity = (1, 1) if floor is None else (m.geom_contype[floor], m.geom_conaffinity[floor])
    return bool(m.geom_contype[g] & affinity or m.geom_conaffinity[g] & kind)


def excluded_bodies(m: Any) -> set[tuple[int, int]]:
    """Return the bodies that each <exclude> names, in either order."""
    found = [divmod(int(signature), 1 << 16) for signature in m.exclude_signature]
    return {*found, *((two, one) for one, two in found)}


def paired_geoms(m: Any) -> set[tuple[int, int]]:
    """Return the geoms that each <pair> names."""
    return {(int(one), int(two)) for one, two in zip(m.pair_geom1, m.pair_geom2)}


def collisions(
    m: Any, geoms: list[int], rows: list[int], paired: set[tuple[int, int]], alike: bool = False
) -> np.ndarray:
    """Return which of the geoms in some rows (k,) may touch which (k, n).

    That is by contype and conaffinity, <exclude> and <pair>.  alike: whether contype and conaffinity do not count.
    """
    kind, affinity, body = (x[geoms] for x in (m.geom_contype, m.geom_conaffinity, m.geom_bodyid))
    found = (kind[rows, None] & affinity != 0) | (affinity[rows, None] & kind != 0) | alike
    for one, two in excluded_bodies(m):
        found[np.ix_(body[rows] == one, body == two)] = False
    column, row = {g: k for k, g in enumerate(geoms)}, {geoms[r]: k for k, r in enumerate(rows)}
    for pair in paired:
        for one, two in (pair, pair[::-1]):
            if one in row and two in column:
                found[row[one], column[two]] = True
    return found


def neighbors_that_touch(m: Any, geoms: list[int]) -> np.ndarray:
    """Return which geoms (n, n) may touch with one joint between: by a <flag>, a <pair>, or as one stands still."""
    rigid = m.body_weldid[m.geom_bodyid[geoms]]
    carrier = m.body_weldid[m.body_parentid[rigid]]
    near = (carrier[:, None] == rigid) & (rigid != 0)[:, None]
    near |= near.T
    row, still = {g: k for k, g in enumerate(geoms)}, np.asarray(rigid == 0)
    found = near & (still | still[:, None] | bool(m.opt.disableflags & NO_FILTER))
    for one, two in paired_geoms(m):
        if one in row and two in row:
            found[row[one], row[two]] = found[row[two], row[one]] = near[row[one], row[two]]
    return found


def as_names(links: list[str], shapes: list[str], rows: list[int], wanted: np.ndarray) -> list[tuple[str, str]]:
    """Return pairs of shapes by few names: those of their links, "link/shape" where not all of a link are.

    links: of each shape; shapes: "link/shape"; wanted: (k, n) of some rows (k,), all those of their links.
    """
    own = dict[str, list[int]]()
    for k, link in enumerate(links):
        own.setdefault(link, []).append(k)
    names, at = [*own], {row: k for k, row in enumerate(rows)}
    number = {link: k for k, link in enumerate(names)}
    of = np.array([number[link] for link in links], int)
    mine = np.unique(of[rows])
    some = np.zeros((len(mine), len(names)), bool)
    for k, row in zip(np.searchsorted(mine, of[rows]), wanted):
        some[k, of[row]] = True
    each, other = np.nonzero(some)
    meeting = {(min(both), max(both)) for both in zip(mine[each].tolist(), other.tolist()) if both[0] != both[1]}
    found = list[tuple[str, str]]()
    for i, j in sorted(meeting):
        first, turned = (i, False) if own[names[i]][0] in at else (j, True)
        one, two = own[names[first]], own[names[j if first == i else i]]
        part = wanted[np.ix_([at[k] for k in one], two)]
        one, two, part = (two, one, part.T) if turned else (one, two, part)
        if part.all():
            found.append((names[i], names[j]))
            continue
        whole, across = (np.asarray(part.all(axis=axis)) for axis in (1, 0))
        found += [(shapes[one[k]], names[j]) for k in np.flatnonzero(whole)]
        found += [(names[i], shapes[two[k]]) for k in np.flatnonzero(across)]
        left = np.argwhere(part & ~whole[:, None] & ~across)
        found += [(shapes[one[a]], shapes[two[b]]) for a, b in left]
    return found


def _friction(m: Any, pair: int, stated: bool) -> float | None:
    if m.pair_dim[pair] == FRICTIONLESS:
        return 0.0
    return float(m.pair_friction[pair, 0]) if stated else None


def _by_pair(m: Any, friction: dict[int, float | None]) -> list[str]:
    """Return what to say of the geoms that touch the ground by a <pair>."""
    names = names_of(m, "geom", m.ngeom)
    alike: dict[float | None, list[str]] = {}
    for g, mu in friction.items():
        alike.setdefault(mu, []).append(names[g])
    return [
        f"geoms {quoted(geoms)} touch the ground by <pair>, with "
        + ("the ground's friction" if mu is None else f"a friction of {mu:g} in place of the ground's")
        for mu, geoms in alike.items()
    ]


def _doubts(m: Any, by_pair: dict[int, list[int]], stated: bool) -> Any:
    """Yield what of a <pair> with the ground is taken otherwise."""
    names = names_of(m, "geom", m.ngeom)
    several = [g for g, pairs in by_pair.items() if len({_friction(m, k, stated) for k in pairs}) > 1]
    if several:
        yield f"took the first <pair> of geoms {quoted(names[g] for g in several)}, whose frictions differ"
    first = {g: pairs[0] for g, pairs in by_pair.items()}
    turned = [g for g, k in first.items() if _friction(m, k, stated) and np.ptp(m.pair_friction[k, :2])]
    if turned:
        yield (
            f"took the first of the two frictions in the <pair> of geoms {quoted(names[g] for g in turned)} in all "
            "directions; write both alike"
        )
    early = [g for g, k in first.items() if m.pair_margin[k] > m.pair_gap[k]]
    if early:
        yield (
            f"ignored the margin in the <pair> of geoms {quoted(names[g] for g in early)}: they touch where they meet "
            "the ground"
        )
