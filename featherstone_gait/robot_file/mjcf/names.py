"""Names in a compiled MJCF file, generated where the file gives none."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any


def names_of(m: Any, kind: str, count: int) -> list[str]:
    """Return unique names of all elements of a kind ("body", "joint", ...)."""
    given = [getattr(m, kind)(k).name for k in range(count)]
    return [name or unused(f"{kind}{k}", given) for k, name in enumerate(given)]


def unused(name: str, taken: Iterable[str]) -> str:
    """Lengthen a name until nothing else has it."""
    taken = set(taken)
    while name in taken:
        name += "_"
    return name


def actuator_count(m: Any) -> int:
    """Return the number of actuators; since MuJoCo 4 one may have several controls, or none."""
    return int(getattr(m, "nactuator", m.nu))
