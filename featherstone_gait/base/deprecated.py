"""Old names that still work, with a DeprecationWarning, until version 0.4."""

from __future__ import annotations

import dataclasses
import functools
import inspect
import sys
import warnings
from collections.abc import Callable, Mapping
from difflib import get_close_matches
from importlib import import_module
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, TypeVar

UNTIL = "0.4"
PACKAGE = str(Path(__file__).parents[1])
CONTEXT = str(dataclasses.__file__)  # where `dataclasses.replace` is
MOVED: set[str] = set()  # old modules that were imported
F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T")


def moved(module: str, target: str) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Make the `__getattr__` and the `__dir__` of a module whose names have moved to `target`."""
    MOVED.add(module)

    def __dir__() -> list[str]:
        there = import_module(target)
        return sorted(getattr(there, "__all__", [name for name in vars(there) if not name.startswith("_")]))

    def __getattr__(name: str) -> Any:
        if name == "__all__":
            return __dir__()
        if name.startswith("__"):
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        try:
            value = resolve_name(f"{target}:{name}")
        except AttributeError:
            raise AttributeError(f"module {module!r} has no attribute {name!r}") from None
        warn(f"{module}.{name}", f"{target}.{name}")
        return value

    return __getattr__, __dir__


def renamed(module: str, names: Mapping[str, str]) -> Callable[[str], Any]:
    """Make the `__getattr__` of a module some of whose names have changed: old name -> "module:new name"."""

    def __getattr__(name: str) -> Any:
        if name not in names:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        value = resolve_name(names[name])
        warn(f"{module}.{name}", names[name].replace(":", "."))
        return value

    return __getattr__


class _Old(property):
    """An old name of what a class has, which `dir` of its objects leaves out."""

    def __set_name__(self, owner: type, name: str) -> None:
        owner.__dir__ = _current_names  # type: ignore[assignment, method-assign]


def _current_names(self: object) -> list[str]:
    old = {name for kind in type(self).__mro__ for name, value in vars(kind).items() if isinstance(value, _Old)}
    return sorted({*object.__dir__(self)} - old)


def method(name: str, target: str) -> Any:
    """Make the method `name` that is the function `target` ("module:name") now, with the object as first argument."""

    def call(self: Any, *arguments: Any, **options: Any) -> Any:
        warn(name, target.replace(":", "."))
        return resolve_name(target)(self, *arguments, **options)

    return _Old(lambda self: functools.partial(call, self), doc=f"The old name of `{target.replace(':', '.')}`.")


def warn(old: str, new: str) -> None:
    """Warn that `old` is now called `new`, at the line outside of this package that has the old name."""
    frame = sys._getframe(1)
    while frame.f_back is not None and frame.f_code.co_filename.startswith((PACKAGE, "<frozen importlib", CONTEXT)):
        frame = frame.f_back
    text = f"{old} is now {new}; the old name works until version {UNTIL}"
    registry = frame.f_globals.setdefault("__warningregistry__", {})
    where = frame.f_code.co_filename, frame.f_lineno, frame.f_globals.get("__name__")
    warnings.warn_explicit(text, DeprecationWarning, *where, registry)


def keywords(_both: bool = False, /, **names: str) -> Callable[[F], F]:
    """Decorate a function some of whose keyword arguments have changed: old="new".

    Both names at once are refused, or the old one counts where `_both` is True: `dataclasses.replace` gives both.
    Unknown names are refused with the known ones.
    """

    def decorate(function: F) -> F:
        parameters = inspect.signature(function).parameters
        known = {name for name, one in parameters.items() if one.kind is not one.POSITIONAL_ONLY} - {"self"}
        open_ended = any(one.kind is one.VAR_KEYWORD for one in parameters.values())

        @functools.wraps(function)
        def call(*args: Any, **kwargs: Any) -> Any:
            for old in [name for name in names if name in kwargs]:
                if names[old] in kwargs and not _both:
                    raise TypeError(f"{function.__qualname__}: {old} is {names[old]} now; give one of them")
                warn(f"{function.__qualname__}: {old}", names[old])
                kwargs[names[old]] = kwargs.pop(old)
            for name in () if open_ended else kwargs.keys() - known:
                close = "".join(f"; did you mean {one}?" for one in get_close_matches(name, known, 1))
                text = f"{function.__qualname__} has no argument {name!r}{close}"
                raise TypeError(f"{text}; its arguments: {', '.join(one for one in parameters if one in known)}")
            return function(*args, **kwargs)

        return call  # type: ignore[return-value]

    return decorate


def fields(**names: str) -> Callable[[type[T]], type[T]]:
    """Decorate a dataclass some of whose fields have changed: old="new", to be given and to be read."""

    def decorate(cls: type[T]) -> type[T]:
        cls.__init__ = keywords(True, **names)(cls.__init__)  # type: ignore[method-assign]
        for old, new in names.items():
            setattr(cls, old, attribute(old, new))
            getattr(cls, old).__set_name__(cls, old)
        return cls

    return decorate


def attribute(old: str, new: str) -> Any:
    """Make the property `old` of a class whose attribute or method is called `new` now."""

    def read(self: object) -> Any:
        name = type(self).__name__
        warn(f"{name}.{old}", f"{name}.{new}")
        return getattr(self, new)

    return _Old(read, doc=f"The old name of `{new}`.")
