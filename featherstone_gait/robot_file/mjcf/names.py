"""Names of what MuJoCo has compiled, made up where the file gives none."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any


def names_of(m: Any, kind: str, count: int) -> list[str]:
    """Names of all elements of a kind ("body", "joint", ...), each once."""
    given = [getattr(m, kind)(k).name for k in range(count)]
    return [name or unused(f"{kind}{k}", given) for k, name in enumerate(given)]


def unused(name: str, taken: Iterable[str]) -> str:
    """The name, lengthened until nothing else has it."""
    taken = set(taken)
    while name in taken:
        name += "_"
    return name


def actuator_count(m: Any) -> int:
    """Number of actuators; since MuJoCo 4 one may have several controls, or none."""
    return int(getattr(m, "nactuator", m.nu))
