"""Old names that still work, with a DeprecationWarning, until version 0.4."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable, Mapping
from pkgutil import resolve_name
from typing import Any, TypeVar

UNTIL = "0.4"
F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T")


def moved(module: str, target: str) -> Callable[[str], Any]:
    """Make the `__getattr__` of a module whose names have moved to `target`."""

    def __getattr__(name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        try:
            value = resolve_name(f"{target}:{name}")
        except AttributeError:
            raise AttributeError(f"module {module!r} has no attribute {name!r}") from None
        warn(f"{module}.{name}", f"{target}.{name}")
        return value

    return __getattr__


def renamed(module: str, names: Mapping[str, str]) -> Callable[[str], Any]:
    """Make the `__getattr__` of a module some of whose names have changed: old name -> "module:new name"."""

    def __getattr__(name: str) -> Any:
        if name not in names:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        value = resolve_name(names[name])
        warn(f"{module}.{name}", names[name].replace(":", "."))
        return value

    return __getattr__


def method(name: str, target: str) -> Callable[..., Any]:
    """Make the method `name` that is the function `target` ("module:name") now, with the object as first argument."""

    def call(self: Any, *arguments: Any, **options: Any) -> Any:
        warn(name, target.replace(":", "."))
        return resolve_name(target)(self, *arguments, **options)

    return call


def warn(old: str, new: str, level: int = 3) -> None:
    """Warn that `old` is now called `new`."""
    warnings.warn(f"{old} is now {new}; the old name works until version {UNTIL}", DeprecationWarning, stacklevel=level)


def keywords(**names: str) -> Callable[[F], F]:
    """Decorate a function some of whose keyword arguments have changed: old="new"."""

    def decorate(function: F) -> F:
        @functools.wraps(function)
        def call(*args: Any, **kwargs: Any) -> Any:
            for old in names.keys() & kwargs.keys():
                if names[old] in kwargs:
                    raise TypeError(f"{function.__qualname__}: {old} is {names[old]} now; give one of them")
                warn(f"{function.__qualname__}: {old}", names[old])
                kwargs[names[old]] = kwargs.pop(old)
            return function(*args, **kwargs)

        return call  # type: ignore[return-value]

    return decorate


def fields(**names: str) -> Callable[[type[T]], type[T]]:
    """Decorate a dataclass some of whose fields have changed: old="new", to be given and to be read."""

    def decorate(cls: type[T]) -> type[T]:
        cls.__init__ = keywords(**names)(cls.__init__)  # type: ignore[method-assign]
        for old, new in names.items():
            setattr(cls, old, property(functools.partial(_read, old=old, new=new)))
        return cls

    return decorate


def _read(self: object, old: str, new: str) -> Any:
    name = type(self).__name__
    warn(f"{name}.{old}", f"{name}.{new}")
    return getattr(self, new)
