"""Write XML elements without children, their numbers, and comments."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from xml.sax.saxutils import quoteattr


def element(tag: str, attributes: Mapping[str, str | None]) -> str:
    """Write <tag .../> with the attributes that are not None."""
    stated = "".join(f" {name}={quoteattr(value)}" for name, value in attributes.items() if value is not None)
    return f"<{tag}{stated}/>"


def number(value: float) -> str:
    """Write a number that reads back the same."""
    return repr(float(value))


def numbers(values: Iterable[float]) -> str:
    """Write numbers separated by spaces."""
    return " ".join(number(value) for value in values)


def comment(text: str) -> str:
    """Write <!-- text -->, without the two hyphens in a row that XML forbids in it."""
    return f"<!-- {re.sub('-(?=-)', '- ', text)} -->"
