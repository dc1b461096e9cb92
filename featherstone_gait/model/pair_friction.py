"""Friction between two shapes: what follows from the two, and what a scene states of them."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from ..base.arguments import instance
from ..base.brief import brief
from .checks import FRICTION, check, number_flaws
from .pair_contact import GROUND, MOMENT, PairContact
from .shapes import Shape

Coefficients = tuple[float, float, float]  # of sliding [-], spinning [m] and rolling [m]
FIELDS = {"friction": ("-", FRICTION), "torsional_friction": ("m", MOMENT), "rolling_friction": ("m", MOMENT)}


@dataclass(frozen=True)
class PairFriction:
    """Friction between two shapes, in place of what follows from the two.

    Attributes
    ----------
    a, b : str
        What the two shapes are of: "name" for all shapes of a member or obstacle, "name/link" for those of a link,
        "name/link/shape" for one that has a name; one of both may be "ground", for links without contact points.
    friction : float or None
        Coefficient of friction [-]; None: what follows from the two shapes, as for the other two.
    torsional_friction : float or None
        Coefficient of the moment that resists spinning about the normal, by the normal force [m].
    rolling_friction : float or None
        Coefficient of the moment that resists rolling [m].

    Raises
    ------
    ValueError
        For numbers out of range.
    TypeError
        For names that are none.
    """

    a: str
    b: str
    friction: float | None = None
    torsional_friction: float | None = None
    rolling_friction: float | None = None

    __repr__ = brief

    def __post_init__(self) -> None:
        for name in ("a", "b"):
            instance(f"pair friction: {name}", getattr(self, name), str, 'give a name such as "cup" or "arm/hand"')
        for name, (unit, remedy) in FIELDS.items():
            if (value := getattr(self, name)) is not None:
                what = f"pair friction of {self.a!r} and {self.b!r}"
                check(number_flaws(what, name, value, ">= 0", unit, f"{remedy}, or None"))


def shape_names(placed: str, shape: Shape) -> tuple[str, ...]:
    """Return what a shape of a member or obstacle goes by in a scene: "name", "name/link" and "name/link/shape"."""
    link = f"{placed}/{shape.link}"
    return (placed, link, f"{link}/{shape.name}") if shape.name else (placed, link)


class Frictions:
    """The frictions between shapes of a scene."""

    def __init__(self, stated: Iterable[PairFriction], contact: PairContact) -> None:
        self._stated = list(stated)
        self._rows = {frozenset((one.a, one.b)): k for k, one in enumerate(self._stated)}
        self._named = {name for one in self._stated for name in (one.a, one.b)}
        self._contact = contact

    def kind(self, names: Iterable[str], shape: Any) -> tuple[Any, ...]:
        """Return what the coefficients of a shape, or half space, depend on."""
        own = (getattr(shape, name, None) for name in (*FIELDS, "priority"))
        return (*own, isinstance(shape, Shape), *(name for name in names if name in self._named))

    def stated(self, one: Iterable[str], other: Iterable[str]) -> PairFriction | None:
        """Return what the scene states of two shapes, given by all of their names: the last of what it states."""
        if not self._rows:
            return None
        row = max(self._rows.get(frozenset((a, b)), -1) for a in one for b in other)
        return None if row < 0 else self._stated[row]

    def of(self, names: tuple[Iterable[str], Iterable[str]], one: Any, other: Any) -> Coefficients:
        """Return the coefficients of friction between two shapes, or half spaces, given with their names."""
        return _replaced(friction_of(one, other, self._contact), self.stated(*names))

    def on_ground(self, names: Iterable[str], shape: Any, ground: float) -> Coefficients:
        """Return those between a shape and the ground, whose coefficient of sliding is given."""
        mu, found = shape.friction, friction_of(shape, None, self._contact)
        if mu is None or shape.priority is not None:
            mu = ground if mu is None else max(mu, ground)
        return _replaced((mu, *found[1:]), self.stated(names, (GROUND,)))


def _replaced(found: Coefficients, stated: PairFriction | None) -> Coefficients:
    if stated is None:
        return found
    own = (getattr(stated, name) for name in FIELDS)
    mu, torsional, rolling = (x if y is None else y for x, y in zip(found, own))
    return mu, torsional, rolling


def friction_of(one: Any, other: Any, contact: PairContact) -> Coefficients:
    """Return the coefficients of friction that follow from two shapes, or half spaces.

    Of two shapes with priorities the higher one's coefficients count, and the larger ones where these are equal:
    MuJoCo's rule.  Else sliding has the geometric mean, and the moments the larger coefficient.
    """
    (mu, *moments), (nu, *others) = (own_friction(shape, contact) for shape in (one, other))
    torsional, rolling = map(max, moments, others)
    high, low = getattr(one, "priority", None), getattr(other, "priority", None)
    if high is None or low is None:
        return math.sqrt(mu * nu), torsional, rolling
    if high == low:
        return max(mu, nu), torsional, rolling
    return own_friction(one if high > low else other, contact)


def own_friction(shape: Any, contact: PairContact) -> Coefficients:
    """Return the coefficients of a shape, with those of the contact where it has none."""
    own = (getattr(shape, name, None) for name in FIELDS)
    mu, torsional, rolling = (getattr(contact, name) if x is None else x for name, x in zip(FIELDS, own))
    return mu, torsional, rolling
