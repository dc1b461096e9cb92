"""Checks of the fields of a model's dataclasses.

A function `..._flaws` yields one text for each problem; `check` raises the first, `refuse` all of them.  A text names
the element, the value, what is allowed and a remedy.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import field, fields
from typing import Any

import numpy as np

from ..base.arguments import floats, is_real, shown
from ..base.flaws import Flaw, FlawError, quoted
from ..core.compile.elementary import NEAR

FRICTION = "0 is ice, 1 is rubber"
LARGEST = 1e50  # number of a robot [SI]: products of several stay within floats, and so do their inverses

_RULES: dict[str, Callable[[float], bool]] = {
    "> 0": lambda x: 1.0 / LARGEST <= x <= LARGEST,
    ">= 0": lambda x: 0 <= x <= LARGEST,
    "> 0 or inf": lambda x: x >= 1.0 / LARGEST,
    ">= 0 or inf": lambda x: x >= 0,
    "finite": lambda x: abs(x) <= LARGEST,
    "0 or >= 1": lambda x: x == 0 or 1 <= x <= LARGEST,
    "> 0 and <= 1": lambda x: 0 < x <= 1,
}


def check(*flaws: Iterable[str]) -> None:
    """Raise ValueError with the first flaw, if there is any."""
    for texts in flaws:
        for text in texts:
            raise ValueError(text)


def refuse(element: str, texts: Iterable[str]) -> None:
    """Raise FlawError with all flaws of an element, if there are any."""
    flaws = [Flaw(element, text) for text in texts]
    if flaws:
        raise FlawError(flaws)


def allowed(rule: str, unit: str, remedy: str = "") -> dict[str, str]:
    """Return the metadata of a dataclass field for a number of a range (a key of `_RULES`) and unit.

    remedy: what to do about a number out of range.
    """
    return {"rule": rule, "unit": unit, "remedy": remedy or f"correct it, and mind the unit {unit}"}


def quantity(rule: str, unit: str, default: float, remedy: str = "") -> Any:
    """Declare such a field with a default."""
    return field(default=default, metadata=allowed(rule, unit, remedy))


def quantity_flaws(what: str, record: Any) -> Iterator[str]:
    """Check the fields that are declared with `allowed` or `quantity`."""
    for name, metadata in _declared(type(record)):  # type: ignore[arg-type]  # which hashes
        yield from number_flaws(what, name, getattr(record, name), **metadata)


def field_flaws(what: str, name: str, value: Any, declared: Any) -> Iterator[str]:
    """Check a value, called by a name, against a field of a dataclass."""
    if declared.metadata:
        yield from number_flaws(what, name, value, **declared.metadata)


@functools.cache
def _declared(kind: type) -> list[tuple[str, Mapping[str, str]]]:
    return [(f.name, f.metadata) for f in fields(kind) if f.metadata]


def number_flaws(what: str, name: str, value: Any, rule: str, unit: str, remedy: str) -> Iterator[str]:
    """Check a number against a rule of `_RULES`."""
    if not ((type(value) is float or is_real(value)) and _RULES[rule](value)):  # the usual type first, for speed
        nonzero = is_real(value) and 0 < abs(value) < math.inf
        size = f", of a size from {1 / LARGEST:g} to {LARGEST:g}" if nonzero else ""
        yield f"{what}: {name} is {shown(value)} [{unit}]; expected {rule}{size}: {remedy}"


def friction_flaws(what: str, friction: float | None) -> Iterator[str]:
    """Check a coefficient of friction with the ground; None is the ground's own."""
    if friction is not None:
        yield from number_flaws(what, "friction", friction, ">= 0", "-", FRICTION)


def name_flaws(kind: str, name: str) -> Iterator[str]:
    """Check that a name is printable text and not empty."""
    if not isinstance(name, str) or not name or not name.isprintable():
        yield f"{kind} name {name!r} is empty or has characters that cannot be printed; use a plain name"


def choice_flaws(what: str, name: str, value: str, choices: tuple[str, ...]) -> Iterator[str]:
    """Check that a text is one of the choices."""
    if not isinstance(value, str) or value not in choices:
        yield f"{what}: {name} is {value!r}; expected one of {quoted(choices)}: use one of these"


def vector_flaws(what: str, name: str, value: tuple[float, ...], size: int) -> Iterator[str]:
    """Check that a vector has `size` finite numbers."""
    if type(value) is tuple and len(value) == size and all(type(x) is float and abs(x) <= LARGEST for x in value):
        return  # the usual case first: batches of worlds make many links
    try:
        numbers = floats(name, value)
    except ValueError:
        numbers = np.zeros(0)
    if numbers.shape != (size,) or not (np.abs(numbers) <= LARGEST).all():
        yield f"{what}: {name} is {shown(value)}; expected {size} finite numbers: correct it"


def angle_flaws(what: str, name: str, angles: Iterable[float]) -> Iterator[str]:
    """Check that angles [rad] are small enough for their sines to be exact."""
    for angle in angles:
        if not abs(angle) <= NEAR:
            yield f"{what}: {name} is {angle!r} rad; at most {NEAR:.0f} rad: subtract whole turns"


def check_angles(what: str, name: str, angles: Iterable[float]) -> None:
    """Raise ValueError for an angle [rad] too large for its sine to be exact."""
    check(angle_flaws(what, name, angles))


def freeze(record: Any, *names: str) -> None:
    """Turn checked vectors of a frozen dataclass into tuples of floats, which cannot be changed."""
    for name in names:
        if type(getattr(record, name)) is not tuple:
            object.__setattr__(record, name, tuple(float(x) for x in getattr(record, name)))
