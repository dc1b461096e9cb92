"""Loops: constraints that close chains of links, rigid ones."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields
from typing import Any, Literal, cast, get_args

import numpy as np

from ..base.arguments import shown
from ..base.brief import brief
from ..base.flaws import quoted
from .checks import angle_flaws, check, choice_flaws, freeze, name_flaws, quantity, quantity_flaws, refuse, vector_flaws
from .links import AXIS_TOLERANCE, Link, Vector

LoopKind = Literal["connect", "weld", "hinge", "distance"]
ROWS = {  # equations of each kind, by what their forces are
    "connect": ("x", "y", "z"),
    "weld": ("x", "y", "z", "moment_x", "moment_y", "moment_z"),
    "hinge": ("x", "y", "z", "moment_1", "moment_2"),
    "distance": ("push",),
}


@dataclass(frozen=True)
class Loop:
    """A rigid constraint between two links, or a link and the world, which closes a loop of the tree.

    ``connect`` holds a point of one link at a point of the other. ``weld`` makes two frames coincide. ``hinge`` lets
    them turn about an axis alone. ``distance`` keeps the distance of two points, as a massless rod does.

    Attributes
    ----------
    name : str
        Name, unique among the loops of a robot.
    kind : {"connect", "weld", "hinge", "distance"}
        What the loop leaves free: all rotations, nothing, the rotation about `axis`, or all but the distance.
    a : str
        Name of the first link.
    b : str or None
        Name of the second link; None for the world.
    point_a, point_b : tuple of float
        Points (3,) in the frames of the two links, or of the world [m].
    rpy_a, rpy_b : tuple of float
        Orientations (3,) there of the frames of a weld or hinge: roll, pitch and yaw about fixed axes [rad].
    axis : tuple of float
        Axis (3,) of a hinge in both frames, of unit length.
    distance : float
        Distance of the two points [m], above zero for the kind ``distance``, else 0.

    Raises
    ------
    ValueError
        For values out of range; all problems of the loop are listed.
    """

    name: str
    kind: LoopKind
    a: str
    b: str | None = None
    point_a: Vector = (0.0, 0.0, 0.0)
    point_b: Vector = (0.0, 0.0, 0.0)
    rpy_a: Vector = (0.0, 0.0, 0.0)
    rpy_b: Vector = (0.0, 0.0, 0.0)
    axis: Vector = (0.0, 0.0, 1.0)
    distance: float = quantity(">= 0", "m", 0.0, "it is the length of a rod between the two points")

    __repr__ = brief

    def __post_init__(self) -> None:
        refuse(f"loop {self.name!r}", self._flaws(f"loop {self.name!r}"))
        freeze(self, "point_a", "point_b", "rpy_a", "rpy_b", "axis")

    @property
    def rows(self) -> int:
        """Number of equations."""
        return len(ROWS[self.kind])

    @property
    def row_names(self) -> tuple[str, ...]:
        """Names of the equations, by the forces that hold them: ``pin.x``."""
        return tuple(f"{self.name}.{row}" for row in ROWS[self.kind])

    def _flaws(self, what: str) -> Iterator[str]:
        yield from name_flaws("loop", self.name)
        yield from choice_flaws(what, "kind", self.kind, get_args(LoopKind))
        if not isinstance(self.a, str):
            yield f"{what}: a is {shown(self.a)}; expected the name of a link: write it in quotes"
        if self.b is not None and not isinstance(self.b, str):
            yield f"{what}: b is {shown(self.b)}; expected the name of a link, or None for the world: correct it"
        if isinstance(self.a, str) and isinstance(self.b, str) and self.a == self.b:
            yield f"{what}: both ends are on link {self.a!r}, which is rigid; name two different links"
        for name in ("point_a", "point_b"):
            yield from vector_flaws(what, name, getattr(self, name), 3)
        for name in ("rpy_a", "rpy_b"):
            turned = list(vector_flaws(what, name, getattr(self, name), 3))
            yield from turned or angle_flaws(what, name, getattr(self, name))
        crooked = list(vector_flaws(what, "axis", self.axis, 3))
        yield from crooked
        if not crooked and abs(math.hypot(*self.axis) - 1.0) > AXIS_TOLERANCE:
            yield f"{what}: axis {self.axis!r} is not of unit length; divide it by its length"
        yield from self._stray_flaws(what)
        flaws = list(quantity_flaws(what, self))
        yield from flaws
        rod = isinstance(self.kind, str) and self.kind == "distance"
        if not flaws and rod != (self.distance > 0):
            allowed = "a rod has one above 0" if rod else "only kind 'distance' has one"
            remedy = "give the length, or use kind 'connect'" if rod else "leave it out, or use kind 'distance'"
            yield f"{what}: distance is {self.distance!r} m with kind {self.kind!r}; {allowed}: {remedy}"

    def _stray_flaws(self, what: str) -> Iterator[str]:
        """Find what this kind of loop does not read."""
        turns = ("rpy_a", "rpy_b") if self.kind in ("connect", "distance") else ()
        for f in fields(self):
            stray = f.name in turns or (f.name == "axis" and self.kind != "hinge")
            if stray and not np.array_equal(getattr(self, f.name), cast(Any, f.default)):
                given = f"{what}: {f.name} is {shown(getattr(self, f.name))}"
                yield f"{given}, and kind {self.kind!r} has none: leave it out, or use another kind"


def check_loops(links: Iterable[Link], loops: Iterable[Loop]) -> None:
    """Raise ValueError unless the links of all loops exist, and no two loops have one name."""
    names, loops = [link.name for link in links], list(loops)
    for name, count in Counter(loop.name for loop in loops).items():
        if count > 1:
            raise ValueError(f"loop name {name!r} is used {count} times; give every loop its own name")
    for loop in loops:
        for end in (loop.a, loop.b):
            if end is not None and end not in names:
                check([f"loop {loop.name!r}: there is no link {end!r}; links are {quoted(names)}: use one of them"])
