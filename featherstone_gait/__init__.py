"""Articulated-body simulation of servo-driven robots, and gait optimization on top of it.

The public names are loaded when they are first used, so that importing the package costs nothing.  Walking patterns
are in `featherstone_gait.walking`, optimizers in `featherstone_gait.search`.
"""

import re
from importlib import import_module
from pkgutil import get_data
from sys import modules
from typing import Any

__version__ = "0.2.0"

# The stub lists the public names, each with its module.
_LINE = re.compile(rb"^from \.([\w.]+) import (\w+) as \2\r?$", re.MULTILINE)
_HOME = {name.decode(): home.decode() for home, name in _LINE.findall(get_data(__name__, "__init__.pyi") or b"")}

__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    """Load a public name from its module (PEP 562)."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f".{_HOME[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    rooms = [name for name in globals() if f"{__name__}.{name}" in modules]
    return sorted({*__all__, *rooms, *(name for name in globals() if name.startswith("__"))})
