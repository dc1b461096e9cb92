"""Write the friction of shapes with each other, of a scene.

Of two shapes MuJoCo takes the larger numbers, also where this package takes the geometric mean.  A <text> says which
shapes these are, and what they state, for `load_scene`.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Iterator, Sequence
from itertools import combinations
from typing import NamedTuple
from xml.etree.ElementTree import Element

from ...model.pair_contact import PairContact
from ...model.pair_friction import FIELDS, Frictions, own_friction, shape_names
from ...model.placed import Placed, SceneModel, link_name
from ...model.shapes import Shape
from .frictions import COUNTS, ROLLS, SPINS
from .touching import FRICTIONLESS


class Geom(NamedTuple):
    """A shape that is written as a geom."""

    name: str
    shape: Shape
    names: tuple[str, ...]  # of the shape, in the scene
    near: frozenset[str]  # its link in the scene, and the neighbors of that


def geoms_of(placed: Placed, named: Iterable[Shape]) -> list[Geom]:
    """Return the shapes of a member or obstacle, given with the names with which they are written."""
    near: dict[str, set[str]] = {link.name: {link_name(placed.name, link.name)} for link in placed.model.links}
    for joint in placed.model.joints:
        near[joint.parent].add(link_name(placed.name, joint.child))
        near[joint.child].add(link_name(placed.name, joint.parent))
    return [
        Geom(link_name(placed.name, new.name), old, shape_names(placed.name, old), frozenset(near[old.link]))
        for old, new in zip(placed.model.shapes, named)
    ]


def contact_of(scene: SceneModel) -> PairContact:
    """Return the numbers of a scene's contacts, for shapes that have none of their own."""
    return scene.pairs if isinstance(scene.pairs, PairContact) else PairContact()


def write_friction(geom: Element, shape: Shape, contact: PairContact) -> None:
    """Write the friction and priority of a shape."""
    rolls = shape.rolling_friction is not None
    least = ROLLS if rolls else FRICTIONLESS if shape.torsional_friction is None else SPINS
    geom.attrib.update(_stated(own_friction(shape, contact), least))
    if shape.priority:
        geom.set("priority", str(shape.priority))


def _stated(numbers: Sequence[float], least: int = FRICTIONLESS) -> dict[str, str]:
    """Return condim, at least one, and friction."""
    kinds = (kind for kind, x in zip(COUNTS, numbers) if x)
    return {"condim": str(max(least, *kinds, FRICTIONLESS)), "friction": " ".join(map(repr, numbers))}


def friction_pairs(scene: SceneModel, geoms: Sequence[Geom], written: Collection[str]) -> Iterator[Element]:
    """Yield a <pair> of each two geoms of which the scene states the friction; written: the geoms that are there.

    Neighbors get one if the scene names their shapes, since a <pair> lets them touch in MuJoCo.
    """
    frictions, apart = Frictions(scene.frictions, contact_of(scene)), {*map(frozenset, scene.excluded)}
    for one, two in combinations(geoms, 2) if scene.frictions else ():
        stated, links = frictions.stated(one.names, two.names), (one.names[1], two.names[1])
        if stated is None or frozenset(links) in apart or not (one.name in written and two.name in written):
            continue
        if links[1] in one.near and {stated.a, stated.b} != {one.names[-1], two.names[-1]}:
            continue
        mu, torsional, rolling = frictions.of((one.names, two.names), one.shape, two.shape)
        attributes = {"geom1": one.name, "geom2": two.name, **_stated((mu, torsional, rolling))}
        attributes["friction"] = " ".join(map(repr, (mu, mu, torsional, rolling, rolling)))
        yield Element("pair", attributes)


def unranked(geoms: Iterable[Geom], written: Iterable[str]) -> str:
    """Write what shapes without priority state, by their geoms, as JSON; contact points state nothing."""
    shapes, found = {geom.name: geom.shape for geom in geoms}, {}
    for name in written:
        if name not in shapes or shapes[name].priority is None:
            found[name] = [getattr(shapes.get(name), field, None) for field in FIELDS]
    return json.dumps(found)
