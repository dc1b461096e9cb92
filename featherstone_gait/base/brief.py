"""Show objects at the prompt in a line: fields that say something, large ones by their size."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sized
from dataclasses import MISSING, fields, is_dataclass
from itertools import islice
from typing import Any

LONGEST = 60  # characters of a value
NESTED = 160  # characters of a value that has fields itself
FEW = 8  # numbers or entries that are written out


def brief(self: Any) -> str:
    """Show a dataclass or a named tuple by the fields that say something; to be its `__repr__`."""
    shown = (f"{name}={_value(value)}" for name, value, default in _fields(self) if not _absent(value, default))
    return f"{type(self).__name__}({', '.join(shown)})"


def clipped(text: str) -> str:
    """Cut a long text short."""
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 3]}..."


def some(items: Iterable[object], most: int = FEW, between: str = ", ") -> str:
    """Join items for a line, cut short after `most`."""
    texts = [str(item) for item in items]
    return between.join(texts[:most]) + f" and {len(texts) - most} more" * (len(texts) > most)


def in_full(value: Any) -> str:
    """Write a value with all of its fields, for digests that depend on every number of it."""
    if isinstance(value, Mapping):
        text = ", ".join(f"{key!r}: {in_full(one)}" for key, one in value.items())
        return f"{{{text}}}" if isinstance(value, dict) else f"{type(value).__name__}({{{text}}})"
    if is_dataclass(value) or hasattr(value, "_fields"):
        text = ", ".join(f"{name}={in_full(one)}" for name, one, _ in _fields(value))
        return f"{type(value).__qualname__}({text})"
    if isinstance(value, list):
        return f"[{', '.join(map(in_full, value))}]"
    if isinstance(value, tuple):
        return f"({', '.join(map(in_full, value))}{',' * (len(value) == 1)})"
    return repr(value)


def _fields(value: Any) -> list[tuple[str, Any, Any]]:
    """List name, value and default of each field."""
    if is_dataclass(value):
        made = [(f, f.default if f.default_factory is MISSING else f.default_factory()) for f in fields(value)]
        return [(f.name, getattr(value, f.name), default) for f, default in made if f.repr]
    return [(name, one, value._field_defaults.get(name, MISSING)) for name, one in zip(value._fields, value)]


def _absent(value: Any, default: Any) -> bool:
    """Return whether a value says nothing: None, nothing in it, or a default that is zero or no limit."""
    if hasattr(value, "dtype"):
        return False
    if value is None or (isinstance(value, Sized) and not len(value)):
        return True
    if value is not default and value != default:
        return False
    return value == math.inf or (not any(value) if isinstance(value, tuple) else not value)


def _value(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    if hasattr(value, "dtype"):
        return _array(value)
    if isinstance(value, str):
        return repr(clipped(value))
    if is_dataclass(value) or hasattr(value, "_fields"):
        text = repr(value)
        return text if len(text) <= NESTED else f"{type(value).__name__}(...)"
    if isinstance(value, (Mapping, tuple, list)):
        return _entries(value)
    return clipped(repr(value))


def _array(value: Any) -> str:
    import numpy as np  # late: `featherstone-gait --help` does without

    if value.size > FEW or value.ndim > 1:
        return f"array {value.shape}"
    return np.array2string(value, precision=4, separator=", ", max_line_width=10**6)


def _entries(value: Any) -> str:
    """Write the entries of a table or a list, or how many there are."""
    few = list(islice(value.items() if isinstance(value, Mapping) else value, FEW))
    if isinstance(value, Mapping):
        text = "{" + ", ".join(f"{key}: {_value(one)}" for key, one in few) + "}"
    else:
        text = "({})".format(", ".join(map(_value, few)))
    return text if len(value) <= FEW and len(text) <= LONGEST else f"{len(value)} entries"
