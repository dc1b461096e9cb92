"""Build pushes: external forces on the bodies for a time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..base.arguments import instance, is_real, listed, shown, vector
from ..base.brief import brief
from ..base.fixed_order import applied
from ..base.records import fill, records
from ..core.effects.push import PUSH
from ..dynamics.tree import Tree


class Push(NamedTuple):
    """An external force on a link from `start` to `end`.

    Attributes
    ----------
    link : str
        Name of the link.
    force, moment : tuple of float
        Force [N] and moment [N m] (3,) in world axes.
    point : tuple of float
        Where the force acts, (3,) in the frame of the link [m].
    start, end : float
        Interval of time [s].
    """

    link: str
    force: tuple[float, float, float] = (0.0, 0.0, 0.0)
    moment: tuple[float, float, float] = (0.0, 0.0, 0.0)
    point: tuple[float, float, float] = (0.0, 0.0, 0.0)
    start: float = 0.0
    end: float = math.inf

    def __repr__(self) -> str:
        return brief(self)


def build_pushes(tree: Tree, pushes: Sequence[Push]) -> np.recarray | None:
    """Build the PUSH records, None without pushes.

    Raises ValueError for unknown links and numbers that are not finite.
    """
    pushes = listed("pushes", pushes, "give a list of Push")
    if not pushes:
        return None
    table = records(len(pushes), PUSH)
    for row, push in zip(table, pushes):
        instance("pushes: push", push, Push, "give Push(link, force=(x, y, z))")
        if not isinstance(push.link, str) or push.link not in tree.placements:
            raise ValueError(f"push: no link {shown(push.link)}; links: {', '.join(tree.placements)}")
        for name in ("force", "moment", "point"):
            vector(f"push on {push.link}: {name}", getattr(push, name), 3)
        if not (is_real(push.start) and is_real(push.end) and -math.inf < push.start <= push.end):
            raise ValueError(f"push on {push.link}: give finite numbers, and a start before the end: {push}")
        place = tree.placements[push.link]
        fill(row, push)
        row.body, row.point = place.row, place.r + applied(place.E, np.array(push.point))
    return table
