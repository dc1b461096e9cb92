"""Describe what is wrong with a robot, all of it at once."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple


class Flaw(NamedTuple):
    """One problem of an element of a robot."""

    element: str  # such as "link 'thigh'"
    text: str  # names the element, the value, what is allowed and a remedy


class FlawError(ValueError):
    """A robot that makes no sense; `flaws` lists all problems."""

    def __init__(self, flaws: Iterable[Flaw]) -> None:
        self.flaws = tuple(flaws)
        super().__init__(self.flaws)  # so that pickle makes it again

    def __str__(self) -> str:
        return "; ".join(flaw.text for flaw in self.flaws)


def quoted(items: Iterable[object]) -> str:
    """Join the items for a message, cut short after ten."""
    return listed([repr(item) for item in items])


def listed(shown: list[str]) -> str:
    """Join texts for a message, cut short after ten."""
    return ", ".join(shown[:10]) + (f" and {len(shown) - 10} more" if len(shown) > 10 else "")
