"""Say in a few lines why a user's function failed where it is compiled: what Python says of the same call."""

from __future__ import annotations

import re
import traceback
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

# Lines in which Numba says what it met.
TELLING = re.compile(">>> |[Cc]annot |Invalid |Unknown |[Uu]nsupported|not supported|has no |is not |Use of ")


def failure_of(function: Callable[..., Any], arguments: Mapping[str, Any], error: Exception, one: bool = False) -> str:
    """Return name and place of a function, why it failed, and the shapes of its arguments.

    It is called in Python with the arguments; one: it must return one number.  error: of the compiled function.
    """
    line, why, name = None, "", Path(function.__code__.co_filename).name
    try:
        with np.errstate(all="ignore"):
            answer = function(*arguments.values())
    except Exception as raised:
        line, why = line_of(function, raised), f"{type(raised).__name__}: {raised}"
    else:
        if one and np.ndim(answer):
            why = f"it returns an array {np.shape(answer)}, where one number is needed"
    if not why:
        lines = [each.strip() for each in str(error).splitlines() if each.strip()]
        found = re.search(rf'File "[^"]*{re.escape(name)}", line (\d+)', str(error))
        line = int(found[1]) if found else None
        why = next((each for each in lines if TELLING.search(each)), lines[0] if lines else type(error).__name__)
    return f"{function.__qualname__} ({place_of(function, line)}): {why}; its arguments here: {shapes_of(arguments)}"


def line_of(function: Callable[..., Any], raised: Exception) -> int | None:
    """Return the line of a function's file in which it raised an exception."""
    frames = traceback.extract_tb(raised.__traceback__)
    return next((each.lineno for each in reversed(frames) if each.filename == function.__code__.co_filename), None)


def place_of(function: Callable[..., Any], line: int | None = None) -> str:
    """Return a function's file and a line there, by default its first."""
    code = function.__code__
    return f'File "{code.co_filename}", line {line or code.co_firstlineno}'


def shapes_of(arguments: Mapping[str, Any]) -> str:
    """List arguments with their shapes."""
    return ", ".join(_shapes(arguments))


def _shapes(arguments: Mapping[str, Any]) -> Iterator[str]:
    for name, value in arguments.items():
        if hasattr(value, "_asdict"):
            yield from _shapes({f"{name}.{key}": each for key, each in value._asdict().items() if np.size(each)})
        else:
            yield f"{name} {np.shape(value)}" if np.ndim(value) else f"{name} a number"
