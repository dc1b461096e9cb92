"""Contact between bodies: which may touch, and how they give way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from ..base.arguments import listed, shown, texts, whole
from ..base.brief import brief
from .checks import FRICTION, check, number_flaws, quantity, quantity_flaws

PairWord = Literal["none", "all"]
NONE: Literal["none"] = "none"
ALL: Literal["all"] = "all"
GROUND = "ground"  # its name in pairs
MOMENT = "give the largest moment by the normal force [m], 0 for none"
PAIR_REMEDY = 'give "all", "none" or pairs such as ("robot/hand", "cup")'


@dataclass(frozen=True)
class PairContact:
    """Contact between bodies, described by quantities that can be measured.

    `compile_scene` derives stiffness and damping from them, as from those of `Ground`.

    Attributes
    ----------
    select : str or tuple of (str, str)
        "all", or pairs of names: "name/link", or "name" for all links of a member or obstacle; "ground" is the ground.
    penetration : float
        Depth of a contact that carries the weight of `load` [m]; a smaller weight sinks less.
    damping_ratio : float
        Damping ratio of small motions about rest; 1 is critical [-].
    friction : float
        Coefficient of friction of shapes that have none of their own [-].
    torsional_friction : float
        Coefficient of the moment that resists spinning about the normal, by the normal force [m]; 0 is none.
    rolling_friction : float
        Coefficient of the moment that resists rolling [m]; 0 is none.
    load : float or None
        Mass that two bodies carry at that depth [kg]; the ground bears it, too, under what others can touch.  None:
        the mass of all robots and objects that can touch these two, directly or through others.
    max_points : int or None
        Points of all pairs that can be near each other at a time, of a pair all that it can touch at; None: 32, twice
        those of pairs that are near where all start, and for each free object those of three of its pairs.

    Raises
    ------
    ValueError
        For numbers out of range and pairs that are no pairs of names.
    """

    select: PairWord | tuple[tuple[str, str], ...] = ALL
    penetration: float = quantity("> 0", "m", 5e-4, "0.0005 suits a small robot")
    damping_ratio: float = quantity(">= 0", "-", 0.7, "0.7 hardly bounces")
    friction: float = quantity(">= 0", "-", 0.95, FRICTION)
    torsional_friction: float = quantity(">= 0", "m", 0.0, MOMENT)
    rolling_friction: float = quantity(">= 0", "m", 0.0, MOMENT)
    load: float | None = None
    max_points: int | None = None

    __repr__ = brief

    def __post_init__(self) -> None:
        if isinstance(self.select, str) and self.select not in (ALL, NONE):
            raise ValueError(f"pairs: select is {shown(self.select)}; expected names or a word: {PAIR_REMEDY}")
        if not isinstance(self.select, str):
            object.__setattr__(self, "select", name_pairs("pairs: select", self.select, PAIR_REMEDY))
        check(quantity_flaws("pairs", self))
        if self.load is not None:
            check(number_flaws("pairs", "load", self.load, "> 0", "kg", "give the mass that rests on a pair, or None"))
        if self.max_points is not None:
            given = whole("pairs: max_points", self.max_points, 1, "give a number of points, or None", MOST_POINTS)
            object.__setattr__(self, "max_points", given)


MOST_POINTS = 10**6


def pair_contact(given: Any) -> PairContact | None:
    """Return what `pairs` asks for: a word, pairs of names or a PairContact; None where nothing touches."""
    found = given if isinstance(given, PairContact) else PairContact(NONE if given is None else given)
    return None if found.select == NONE or found.select == () else found


def name_pairs(what: str, given: Any, remedy: str) -> tuple[tuple[str, str], ...]:
    """Return pairs of names; raise ValueError or TypeError for what is none."""
    found = []
    for pair in listed(what, given, remedy):
        names = texts(what, pair, remedy)
        if len(names) != 2:
            raise ValueError(f"{what} has {shown(pair)}; expected two names: {remedy}")
        found.append((names[0], names[1]))
    return tuple(found)
