"""Build the surfaces that move on their bodies, and number their drives."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..base.fixed_order import applied
from ..base.records import records
from ..core.effects.surface import SURFACE
from ..model import ContactPoint, Model, Surface
from ..model.placed import Placed, link_name
from ..model.shapes import Shape


def drives_of(model: Model) -> dict[str, float]:
    """Return the commands at the start of the drives of surfaces by name, in the order of shapes, then contact points.

    Raises ValueError where one drive is given two commands.
    """
    found: dict[str, float] = {}
    parts: tuple[Shape | ContactPoint, ...] = (*model.shapes, *model.contacts)
    for one in parts:
        if one.surface is not None:
            name, command = drive_of(one, one.surface), one.surface.command
            if found.setdefault(name, command) != command:
                raise ValueError(
                    f"{model.name}: surface on link {one.link!r}: command is {command!r}, and another surface of drive "
                    f"{name!r} has {found[name]!r}; give both the same, or drives of other names"
                )
    return found


def drive_of(part: Shape | ContactPoint, surface: Surface) -> str:
    """Return the name of the drive of a surface."""
    return surface.drive or part.link


def build_commands(model: Model) -> np.ndarray | None:
    """Return the commands of all drives at the start (drives,); None without."""
    return np.array(list(drives_of(model).values())) if drives_of(model) else None


def joined_commands(placed: Sequence[Placed]) -> np.ndarray | None:
    """Return those of robots, objects and obstacles, one after the other."""
    found = [x for one in placed for x in drives_of(one.model).values()]
    return np.array(found) if found else None


def scene_drives(placed: Sequence[Placed]) -> tuple[str, ...]:
    """Return the names of the drives of the models in a scene."""
    return tuple(link_name(one.name, drive) for one in placed for drive in drives_of(one.model))


def build_surfaces(
    parts: Sequence[tuple[Any, np.ndarray, np.ndarray, dict[str, int]]],
) -> np.recarray | None:
    """Return the surfaces of parts (parts,) in the frames of their bodies; None where all are at rest.

    Each part comes with rotation (3, 3) and origin (3,) [m] of its link in the body, and the numbers of its drives.
    """
    if all(getattr(part, "surface", None) is None for part, *_ in parts):
        return None
    table = records(len(parts), SURFACE)
    table.drive = -1
    for row, (part, E, r, numbers) in zip(table, parts):
        surface = getattr(part, "surface", None)
        if surface is not None:
            row.drive = numbers[drive_of(part, surface)]
            row.velocity, row.turning = applied(E, np.array(surface.velocity)), applied(E, np.array(surface.turning))
            row.center = r + applied(E, np.array(surface.center))
    return table
