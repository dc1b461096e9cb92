"""Check arguments.  Each error names the argument, its value and what to give instead."""

from __future__ import annotations

import math
import operator
import os
from collections.abc import Iterable
from datetime import timedelta
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

FLOAT = np.dtype(float)
HUGE = 1e50  # beyond it products of several numbers overflow


def instance(name: str, value: object, kind: type | tuple[type, ...], remedy: str) -> None:
    """Raise TypeError unless the value is of a kind."""
    if not isinstance(value, kind):
        raise TypeError(f"{name} is {shown(value)}; {remedy}")


def real(name: str, value: Any, low: float, high: float, remedy: str) -> float:
    """Return a number between low and high, both included; raise ValueError for others.

    It is infinite only if a bound is.
    """
    found = _as_float(value)
    if found is None or not low <= found <= high:
        raise ValueError(f"{name} is {shown(value)}; expected a number from {low:g} to {high:g}: {remedy}")
    return found


def whole(name: str, value: Any, least: int, remedy: str, most: int = 2**53) -> int:
    """Return a whole number from least to most; raise ValueError for others, and for text and truth values."""
    try:
        found = None if isinstance(value, (bool, np.bool_)) else operator.index(value)
    except TypeError:
        found = int(value) if is_whole(value) else None
    if found is None or not least <= found <= most:
        raise ValueError(f"{name} is {shown(value)}; expected a whole number from {least} to {most:g}: {remedy}")
    return found


def floats(name: str, value: Any, remedy: str = "give real numbers, or an array of them") -> np.ndarray:
    """Return the value as an array of floats, without a copy if it is one.

    Raises ValueError for what is no array of real numbers: text, complex numbers, truth values, None, ragged lists.
    """
    if type(value) is np.ndarray and value.dtype is FLOAT:  # the usual case first: kernels are called often
        return value
    try:
        array = np.asarray(value)
    except (TypeError, ValueError, OverflowError, RuntimeError):
        array = np.array(None)
    if array.dtype.kind not in "iuf":
        raise ValueError(f"{name} is {shown(value)}; {remedy}")
    if np.ma.is_masked(value):
        raise ValueError(f"{name} has masked values: {shown(value)}; fill them, or leave them out")
    return array.astype(float, copy=False)


def vector(name: str, value: Any, width: int, remedy: str = "") -> np.ndarray:
    """Return a new array of `width` finite numbers; raise ValueError for others."""
    a = floats(name, value, f"give {width} finite numbers {remedy}".rstrip())
    if a.shape != (width,) or not (np.abs(a) <= HUGE).all():
        text = f"{name} must be {width} finite numbers; its shape is {a.shape}: {np.array2string(a, threshold=20)}"
        raise ValueError(f"{text}; give {remedy}" if remedy else text)
    return np.array(a)


def listed(name: str, value: Any, remedy: str) -> list[Any]:
    """Return the items of a list, tuple or other iterable; raise ValueError for text and what has no items."""
    scalar = isinstance(value, (str, bytes)) or (isinstance(value, np.ndarray) and value.ndim == 0)
    if scalar or not isinstance(value, Iterable):
        raise ValueError(f"{name} is {shown(value)}; {remedy}")
    return list(value)


def texts(name: str, value: Any, remedy: str = "give a list of names") -> list[str]:
    """Return the names in a list; raise ValueError for what is no list, TypeError for what is no name."""
    found = listed(name, value, remedy)
    for item in found:
        instance(name, item, str, remedy)
    return found


def one_of(name: str, value: object, choices: Iterable[str]) -> str:
    """Return the value; raise ValueError unless it is one of the choices."""
    known = list(choices)
    if not isinstance(value, str) or value not in known:
        text = ", ".join(map(repr, known[:-1])) + f" or {known[-1]!r}"
        raise ValueError(f"{name} is {shown(value)}; expected {text}: use one of these")
    return value


def shown(value: object) -> str:
    """Format a value for a message, cut short."""
    if isinstance(value, int) and abs(value) > 10**30:  # whose digits Python may refuse to write
        return f"a whole number of {value.bit_length()} bits"
    text = " ".join(repr(value).split())
    return (text if len(text) <= 80 else f"{text[:77]}...") + _not_float(value)


def _not_float(value: Any, depth: int = 3) -> str:
    """Say how to make a float of a number of a type that is refused, or of one in a list; "" for others."""
    if isinstance(value, (list, tuple)) or (isinstance(value, np.ndarray) and value.ndim > 0):
        return next(filter(None, (_not_float(item, depth - 1) for item in value[:20])), "") if depth else ""
    value = value.item() if isinstance(value, np.ndarray) and value.dtype.kind == "O" else value
    if isinstance(value, (Decimal, Fraction)):
        return f" (a {type(value).__name__}: convert it with float())"
    dtype = getattr(value, "dtype", None)
    if isinstance(value, timedelta) or (dtype is not None and dtype.kind == "m"):
        return f" (a {type(value).__name__} is no number of seconds: divide it by one second)"
    return ""


def is_real(value: object) -> bool:
    """Return whether the value is one real number that a float can hold; text and truth values are none."""
    return _as_float(value) is not None


def _as_float(value: Any) -> float | None:
    if type(value) is float:
        return value
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, float)):
        kind = value.dtype.kind if isinstance(value, (np.generic, np.ndarray)) and value.ndim == 0 else ""
        if kind not in ("i", "u", "f") or np.ma.is_masked(value):
            return None
    try:
        return float(value)
    except OverflowError:
        return None


def finite(name: str, value: Any, shape: tuple[int | None, ...], unit: str = "") -> np.ndarray:
    """Return the value as an array of finite floats of a shape (None: any length); raise ValueError for others."""
    sizes = ", ".join("n" if n is None else str(n) for n in shape)
    expected = f"expected finite numbers of shape ({sizes}) {unit}".strip()
    a = floats(name, value, expected)
    fits = a.ndim == len(shape) and all(n in (None, m) for n, m in zip(shape, a.shape))
    if not fits or not (np.abs(a) <= HUGE).all():
        raise ValueError(f"{name} has the shape {a.shape}: {np.array2string(a, threshold=20)}; {expected}")
    return a


def truth(name: str, value: object) -> bool:
    """Return True or False; raise TypeError for others."""
    instance(name, value, (bool, np.bool_), "give True or False")
    return bool(value)


def path(name: str, value: Any) -> Path:
    """Return the path of a file; raise TypeError for what is no path."""
    instance(name, value, (str, os.PathLike), "give the path of a file")
    if not os.fspath(value):
        raise ValueError(f"{name} is empty; give the path of a file")
    return Path(value)


def functions(*optional: str, **given: object) -> None:
    """Raise TypeError for what cannot be called; None is accepted of those named first."""
    for name, value in given.items():
        if not callable(value) and not (value is None and name in optional):
            raise TypeError(f"{name} is {shown(value)}; give a function")


def is_whole(value: Any) -> bool:
    """Return whether the value is a whole number, as int or float."""
    return is_real(value) and math.isfinite(value) and float(value).is_integer()
