"""Choose which shapes of a scene may touch each other."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from ..geometry.distance import rows_by_name
from ..model.pair_contact import ALL, GROUND, PairContact
from ..model.placed import SEPARATOR
from .forest import Member, named
from .solids import Parts

MANY_PAIRS, MOST_PAIRS = 300_000, 5_000_000  # of shapes, above which a warning says so, and which are refused
PAIR_BYTES, PAIR_TIME = 700, 6e-6  # at most, of compiling each [B, s]


class _Shapes(NamedTuple):
    """Hold what decides which shapes of a scene may touch; a pair of rows i < j has the number i n + j."""

    tree: np.ndarray
    body: np.ndarray
    moves: np.ndarray
    surface: np.ndarray
    ground: np.ndarray
    on_points: np.ndarray
    meeting: np.ndarray  # numbers of the pairs of one robot that can meet

    @classmethod
    def of(cls, parts: Parts) -> _Shapes:
        """Gather it."""
        rows = [(s.tree, s.body, s.moves, s.is_surface, s.link == GROUND, s.on_points) for s in parts.solids]
        tree, body, *which = np.array(rows, int).reshape(-1, 6).T
        moves, surface, ground, on_points = (one.astype(bool) for one in which)
        meeting = _numbers(parts.meeting[:, 0], parts.meeting[:, 1], len(rows))
        return cls(tree, body, moves, surface, ground, on_points, meeting)

    def possible(self, pairs: np.ndarray) -> np.ndarray:
        """Return which pairs (pairs,) can touch at all."""
        i, j = np.divmod(pairs, len(self.tree))
        on_points = (self.ground[i] & self.on_points[j]) | (self.ground[j] & self.on_points[i])
        return (
            (self.moves[i] | self.moves[j])
            & (self.body[i] != self.body[j])
            & ~on_points
            & ~(self.surface[i] & self.surface[j])
        )

    def usual(self, pairs: np.ndarray) -> np.ndarray:
        """Return which pairs (pairs,) touch unless the scene says otherwise."""
        i, j = np.divmod(pairs, len(self.tree))
        return self.possible(pairs) & ((self.tree[i] != self.tree[j]) | np.isin(pairs, self.meeting))

    def every(self, apart: np.ndarray) -> np.ndarray:
        """Return the usual pairs; raise ValueError, before any is listed, if without those apart they are too many."""
        _check_count(self._count() - int(self.usual(apart).sum()))
        n, still, found = len(self.tree), np.flatnonzero(~self.moves), []
        for i in np.flatnonzero(self.moves).tolist():
            pairs = _numbers(i, np.concatenate([still[still < i], np.arange(i + 1, n)]), n)
            found.append(pairs[self.usual(pairs)])
        return np.concatenate([np.zeros(0, np.int64), *found])

    def _count(self) -> int:
        """Return how many pairs of two trees, of which one moves, there are, and of one robot."""
        each = np.unique(self.tree[self.moves], return_counts=True)[1]
        moving, on_points = each.sum(), self.on_points[self.moves].sum() * self.ground.sum()
        between = (moving**2 - (each**2).sum()) // 2
        return int(between + moving * (~self.moves).sum() - on_points + len(self.meeting))


def _numbers(one: Any, two: Any, n: int) -> np.ndarray:
    """Return the numbers of pairs of n shapes."""
    return np.minimum(one, two) * n + np.maximum(one, two)


def _between(one: Sequence[int], two: Sequence[int], n: int) -> np.ndarray:
    """Return the numbers of the pairs of each shape of one with each of another."""
    return np.unique(_numbers(np.array(one, np.int64)[:, None], np.array(two, np.int64), n))


def _check_count(count: int) -> None:
    """Raise ValueError if pairs are too many to be compiled, and warn if it takes long."""
    text = (
        f"pairs: {count} pairs of shapes may touch each other, which take about {count * PAIR_BYTES / 1e9:.2g} GB and "
        f"{count * PAIR_TIME:.2g} s to compile, and every step passes through all of them"
    )
    remedy = "give pairs of the names of those that meet, or exclude links"
    if count > MOST_PAIRS:
        raise ValueError(f"{text}; at most {MOST_PAIRS} are taken: {remedy}")
    if count > MANY_PAIRS:
        warnings.warn(f"{text}: {remedy}", stacklevel=7)


def chosen_pairs(parts: Parts, option: PairContact, excluded: Iterable[tuple[str, str]]) -> np.ndarray:
    """Return the rows (pairs, 2) of the shapes that may touch each other, in their order."""
    n, shapes, rows = len(parts.solids), _Shapes.of(parts), rows_by_name(solid.names for solid in parts.solids)
    none = np.zeros(0, np.int64)
    apart = np.unique(np.concatenate([none, *(_between(rows.get(a, []), rows.get(b, []), n) for a, b in excluded)]))
    rows = rows_by_name(dict.fromkeys((solid.of, solid.link)) for solid in parts.solids)
    if isinstance(option.select, str):
        chosen = shapes.every(apart) if option.select == ALL else none
    else:
        chosen = np.concatenate([none, *(_asked_for(pair, rows, shapes, apart) for pair in option.select)])
    return np.stack(np.divmod(np.setdiff1d(chosen, apart), max(n, 1)), axis=1)


def _asked_for(pair: tuple[str, str], rows: dict[str, list[int]], shapes: _Shapes, apart: np.ndarray) -> np.ndarray:
    """Return the numbers of the pairs that a pair of names stands for; raise ValueError if it is none."""
    for name in pair:
        if name not in rows:
            known = ", ".join(map(repr, list(rows)[:20]))
            raise ValueError(
                f"pairs: {name!r} is no member, obstacle or link with a collision shape; expected one of {known}: "
                "correct the name, or give the link a shape"
            )
    one, two = (rows[name] for name in pair)
    found = _between(one, two, len(shapes.tree))
    found = found[shapes.possible(found) if all(SEPARATOR in name for name in pair) else shapes.usual(found)]
    if np.isin(found, apart).all():
        cause = "are excluded" if len(found) else "are neighbors, do not move, or have contact points there"
        raise ValueError(f"pairs: {pair[0]!r} and {pair[1]!r} cannot touch: all their shapes {cause}; leave them out")
    return found


def excluded_pairs(members: Sequence[Member], excluded: Sequence[tuple[str, str]]) -> Iterator[tuple[str, str]]:
    """Yield the pairs of links or shapes that do not touch: those of the scene, and of each robot."""
    yield from excluded
    for member in members:
        yield from ((named(member, one), named(member, two)) for one, two in member.model.excluded)
