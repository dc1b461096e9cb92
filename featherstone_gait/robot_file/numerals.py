"""Parse numbers in attributes, as XML Schema and C write them."""

from __future__ import annotations

import math
import re
from xml.etree.ElementTree import Element

Vector = tuple[float, float, float]

MAX_NUMBER = 1e30  # in a robot file, so that no product of masses and lengths overflows

_NUMBER = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?")  # what strtod reads in the C locale


def vector(element: Element, attribute: str, what: str, default: str = "0 0 0") -> Vector:
    """Return three numbers, or the default if the attribute is missing; raise ValueError for anything else."""
    text = element.get(attribute, default)
    if "$(" in text or "${" in text:
        raise ValueError(f"{what}: <{element.tag}> {attribute}={text!r} is a macro: expand the file with xacro first")
    words = text.split()
    if len(words) != 3:
        raise ValueError(
            f"{what}: <{element.tag}> {attribute}={element.get(attribute)!r} has {len(words)} numbers; "
            "expected 3, separated by spaces: correct it"
        )
    x, y, z = (_parsed(word, f"{what}: <{element.tag}> {attribute}") for word in words)
    return x, y, z


def number(element: Element, attribute: str, what: str, default: float | None = None) -> float:
    """Return a finite number; raise ValueError for anything else, and if the attribute is missing without a default."""
    if attribute not in element.attrib:
        if default is None:
            raise ValueError(f"{what}: attribute {attribute!r} of <{element.tag}> is missing; it is required: add it")
        return default
    return _parsed(element.attrib[attribute].strip(), f"{what}: <{element.tag}> {attribute}")


def number_or_inf(element: Element, attribute: str, what: str) -> float:
    """Return a number that may be infinite; raise ValueError for anything else."""
    word = element.get(attribute, "").strip().lower()
    if word.lstrip("+-") in ("inf", "infinity"):
        return -math.inf if word.startswith("-") else math.inf
    return number(element, attribute, what)


def _parsed(word: str, what: str) -> float:
    """Return a finite number; float() alone would accept 1_0, nan and Arabic digits too."""
    value = float(word) if _NUMBER.fullmatch(word) else math.nan
    if not abs(value) <= MAX_NUMBER:
        raise ValueError(
            f"{what} is {word[:40]!r}; expected a number up to {MAX_NUMBER:g}: write it like -0.15 or 2e-3"
        )
    return value
