"""Read which friction the geoms of an MJCF file have with each other.

MuJoCo takes the numbers of a <pair> of the two geoms.  Else it takes condim and friction of the geom of higher
priority, of equal ones the larger number of each.  condim says which of the numbers count: none if it is 1, sliding
from 3 on, spinning from 4 on, rolling from 6 on.  A shape gets those numbers of its geom that count, and the geom's
priority.  Where two shapes give other numbers than MuJoCo takes, the friction of the two is stated by itself.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, TypeAlias
from xml.etree.ElementTree import Element

import numpy as np

from ...base.flaws import listed, quoted
from ...model.pair_friction import PairFriction
from ...model.shapes import Shape
from .touching import FRICTIONLESS, excluded_bodies, meets
from .tree import FRICTIONS, moments_of, names_of

SLIDES, SPINS, ROLLS = COUNTS = (3, 4, 6)  # condim from which on they count
USUAL = {"solref": (0.02, 1.0), "solimp": (0.9, 0.95, 0.001, 0.5, 2.0), "solreffriction": (0.0, 0.0)}  # MuJoCo's
Numbers: TypeAlias = tuple[float | None, float | None, float | None]  # of sliding, spinning and rolling


def own_frictions(documents: Iterable[Element]) -> dict[str, Numbers]:
    """Return what `save_scene` has written of shapes without priority, by geom; raise ValueError if it is none."""
    texts = {each.get("name"): each.get("data", "") for root in documents for each in root.iter("text")}
    try:
        found = json.loads(texts.get(FRICTIONS, "{}"))
        return {name: (mu, torsional, rolling) for name, (mu, torsional, rolling) in found.items()}
    except (AttributeError, TypeError, ValueError) as error:
        raise ValueError(f"<text name={FRICTIONS!r}> states no frictions of geoms: {error}; remove it") from error


def friction_of(m: Any, g: int, own: Mapping[str, Numbers]) -> tuple[Numbers, int | None]:
    """Return the numbers of a geom that count, and its priority."""
    if (name := m.geom(g).name) in own:
        return own[name], None
    mu = 0.0 if m.geom_condim[g] == FRICTIONLESS else float(m.geom_friction[g, 0])
    return (mu, *moments_of(m, g)), int(m.geom_priority[g])


def friction_on_floor(m: Any, g: int, floor: int | None, stated: bool) -> Iterator[tuple[float | None, float | None]]:
    """Yield the coefficients of sliding and rolling of a geom with the ground; nothing if it does not touch it.

    None is the ground's own.  stated: whether the file states a friction of a <pair>, which then is no ground's.
    """
    if floor is None:
        if meets(m, g, None):
            yield None, moments_of(m, g)[1]
        return
    usual = float(m.geom_friction[floor, 0])
    for k in range(m.npair):
        if {int(m.pair_geom1[k]), int(m.pair_geom2[k])} == {g, floor}:
            mu, _, rolling = _of_pair(m, k)
            yield None if mu == usual and not stated else mu, rolling or None
            return
    if meets(m, g, floor) and (int(m.geom_bodyid[floor]), int(m.geom_bodyid[g])) not in excluded_bodies(m):
        (mu, _, rolling), *_ = _combined(m, np.array([g]), np.array([floor])).tolist()
        yield None if mu == usual else mu, rolling or None


def spinning_doubts(m: Any, geoms: Iterable[int], floor: int | None) -> Iterator[str]:
    """Yield which geoms have a friction against spinning on the ground, where nothing resists it here."""
    names, found = names_of(m, "geom", m.ngeom), []
    for g in geoms if floor is not None else ():
        pairs = (k for k in range(m.npair) if {int(m.pair_geom1[k]), int(m.pair_geom2[k])} == {g, floor})
        k = next(pairs, None)
        numbers = _combined(m, np.array([g]), np.array([floor]))[0].tolist() if k is None else _of_pair(m, k)
        found += [f"{names[g]!r} {numbers[1]:.3g}"] if numbers[1] > 0 else []
    if found:
        yield (
            "ignored the torsional friction [m] of geoms on the ground (condim 4 and 6), where nothing resists "
            f"spinning: {listed(found)}; take a box of the world as floor to have it"
        )


def _of_pair(m: Any, k: int) -> tuple[float, float, float]:
    """Return the numbers of a <pair> that count; of two directions the first."""
    mu, torsional, rolling = np.where(m.pair_dim[k] >= np.array(COUNTS), m.pair_friction[k, [0, 2, 3]], 0.0).tolist()
    return mu, torsional, rolling


def _combined(m: Any, one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the numbers (pairs, 3) that MuJoCo takes for two geoms each, without those that do not count."""
    kinds = _stronger(m, one, other, m.geom_condim[:, None])
    return np.where(kinds >= np.array(COUNTS), _stronger(m, one, other, m.geom_friction), 0.0)


def _stronger(m: Any, one: np.ndarray, other: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the values (pairs, n) of the geoms of higher priority, of equal ones the larger."""
    a, b, rank = values[one], values[other], (m.geom_priority[one] - m.geom_priority[other])[:, None]
    return np.where(rank > 0, a, np.where(rank < 0, b, np.maximum(a, b)))


def pair_frictions(
    m: Any, shapes: Mapping[int, Shape], rows: list[int], collide: np.ndarray, names: Mapping[int, str]
) -> list[PairFriction]:
    """Return the frictions of pairs of geoms that do not follow from those of their shapes.

    collide: (rows, n) which those in these rows touch; names: what the shapes are called in the scene.
    """
    geoms = np.array([*shapes], int)
    ranked = [g for g, shape in shapes.items() if shape.priority is not None]
    has_rank, moves = np.isin(geoms, ranked), np.isin(np.arange(len(geoms)), rows)
    numbers = np.zeros((m.ngeom, 3))
    for g, shape in shapes.items():
        numbers[g] = [shape.friction or 0.0, shape.torsional_friction or 0.0, shape.rolling_friction or 0.0]
    differing: list[tuple[tuple[int, int], list[float]]] = []
    for k, touched in zip(rows, collide):  # one after the other: all pairs together take too much memory
        once = np.flatnonzero(touched & has_rank & has_rank[k] & ((np.arange(len(geoms)) > k) | ~moves))
        one, two = np.minimum(geoms[k], geoms[once]), np.maximum(geoms[k], geoms[once])
        usual = ~_joined(m, one, two)
        one, two = one[usual], two[usual]
        found = _combined(m, one, two)
        other = (found != _stronger(m, one, two, numbers)).any(axis=1)
        differing += zip(zip(one[other].tolist(), two[other].tolist()), found[other].tolist())
    stated: dict[tuple[int, int], Iterable[float]] = dict(sorted(differing))
    for k, both in enumerate(zip(m.pair_geom1.tolist(), m.pair_geom2.tolist())):
        if {*both} <= shapes.keys():
            stated[min(both), max(both)] = _of_pair(m, k)
    return [PairFriction(names[a], names[b], *friction) for (a, b), friction in stated.items()]


def _joined(m: Any, one: np.ndarray, two: np.ndarray) -> np.ndarray:
    """Return which geoms are of one body, or of a body and its parent, which do not touch in MuJoCo."""
    a, b = (m.body_weldid[m.geom_bodyid[g]] for g in (one, two))
    above, below = (m.body_weldid[m.body_parentid[x]] for x in (a, b))
    return (a == b) | (((above == b) | (below == a)) & (a > 0) & (b > 0))


def friction_doubts(m: Any, geoms: Iterable[int]) -> Iterator[str]:
    """Yield what of the contact of geoms is taken otherwise than in MuJoCo."""
    names, geoms = names_of(m, "geom", m.ngeom), {*geoms}
    pairs = [k for k in range(m.npair) if {int(m.pair_geom1[k]), int(m.pair_geom2[k])} <= geoms]

    def of(rows: Iterable[int]) -> str:
        return ", ".join(f"({quoted([names[m.pair_geom1[k]], names[m.pair_geom2[k]]])})" for k in rows)

    twice = {SLIDES: slice(0, 2), ROLLS: slice(3, 5)}
    uneven = [k for k in pairs for n in twice if m.pair_dim[k] >= n and np.ptp(m.pair_friction[k, twice[n]])]
    if uneven:
        yield (
            f"took the first of the two frictions in the <pair> of geoms {of(dict.fromkeys(uneven))} in all "
            "directions; write both alike"
        )
    wide = [g for g in sorted(geoms) if m.geom_margin[g] or m.geom_gap[g]]
    apart = [k for k in pairs if m.pair_margin[k] or m.pair_gap[k]]
    if wide:
        yield f"ignored gap and margin of geoms {quoted(names[g] for g in wide)}: forces begin where shapes touch"
    if apart:
        yield f"ignored gap and margin in the <pair> of geoms {of(apart)}: forces begin where shapes touch"


def slack_notes(m: Any, geoms: Iterable[int]) -> Iterator[str]:
    """Yield a note on geoms that state how their contact with others gives way."""
    names, geoms = names_of(m, "geom", m.ngeom), {*geoms}
    found = {g for g in geoms if _states(m, "geom", g)}
    for k, both in enumerate(zip(m.pair_geom1.tolist(), m.pair_geom2.tolist())):
        found |= {*both} if {*both} <= geoms and _states(m, "pair", k) else set()
    if found:
        yield (
            f"took the friction of geoms {quoted(names[g] for g in sorted(found))}, and not how they give way (solref, "
            "solimp): that follows from PairContact and Ground"
        )


def _states(m: Any, kind: str, row: int) -> bool:
    values = ((getattr(m, f"{kind}_{name}", None), usual) for name, usual in USUAL.items())
    return any(of is not None and of[row].tolist() != [*usual] for of, usual in values)
