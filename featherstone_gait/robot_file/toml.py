"""TOML files and their values, each refused by name where it is not what is expected."""

from __future__ import annotations

import json
import math
import sys
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

from .source import read_bytes


def read_toml(path: Path) -> dict[str, Any]:
    """The table of a TOML file.  Raises ValueError if it is not one."""
    data = read_bytes(path)
    try:
        return tomllib.loads(data.decode("utf-8"))
    except UnicodeDecodeError as error:
        raise ValueError(f"is not UTF-8 text: {error}; save it as UTF-8") from error
    except RecursionError as error:
        raise ValueError("nests its values too deeply; flatten it") from error
    except ValueError as error:
        raise ValueError(f"is not TOML: {error}; correct the syntax there (https://toml.io)") from error


def check_keys(table: Mapping[str, Any], known: tuple[str, ...], what: str) -> None:
    """Raise ValueError for a key that is not known."""
    for key in table:
        if key not in known:
            raise ValueError(f"{what}: unknown key {key!r}; expected {', '.join(known)}: correct it, or remove it")


def table_of(table: Mapping[str, Any], key: str, prefix: str) -> dict[str, Any]:
    """The table under a key, empty if there is none.  Raises ValueError for anything else."""
    value = table.get(key, {})
    if not isinstance(value, dict):
        raise ValueError(f"{prefix}{key} is {value!r}; expected a table: write [{prefix}{key}] and key = value lines")
    return value


def string(table: Mapping[str, Any], key: str, what: str) -> str:
    """The text under a key.  Raises ValueError for anything else."""
    value = table.get(key)
    if not isinstance(value, str):
        raise ValueError(f"{what}: {key} is {value!r}; expected a name: write it in quotes")
    return value


def real(value: Any, what: str) -> float:
    """A number as float, infinite ones included.  Raises ValueError for anything else."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ValueError(f"{what} is {value!r}; expected a number: write it like 0.15 or 2e-3, without quotes")
    if abs(value) > sys.float_info.max and value != math.inf:
        raise ValueError(f"{what} is beyond {sys.float_info.max:.1e}; expected a number: correct its size")
    return float(value)


def number(table: Mapping[str, Any], key: str, what: str) -> float:
    """The number under a key.  Raises ValueError for anything else."""
    return real(table.get(key), f"{what}: {key}")


def vector(table: Mapping[str, Any], key: str, what: str) -> tuple[float, ...]:
    """The three numbers under a key.  Raises ValueError for anything else."""
    value = table.get(key)
    if not isinstance(value, list) or len(value) != 3:
        raise ValueError(f"{what}: {key} is {value!r}; expected three numbers: write [x, y, z]")
    return tuple(real(x, f"{what}: {key}") for x in value)


def truth(table: Mapping[str, Any], key: str, what: str) -> bool:
    """The truth value under a key.  Raises ValueError for anything else."""
    value = table.get(key)
    if not isinstance(value, bool):
        raise ValueError(f"{what}: {key} is {value!r}; expected true or false: write it without quotes")
    return value


# How to read a field of a dataclass, by its type as `fields` gives it.
READ: dict[str, Callable[[Mapping[str, Any], str, str], Any]] = {
    "str": string,
    "bool": truth,
    "float": number,
    "Vector": vector,
}


def record(kind: type, table: Mapping[str, Any], what: str, named: str = "") -> Any:
    """Make a dataclass of a table whose keys are its fields.  Raises ValueError for other keys and wrong values.

    named: what messages on values call the table, if it differs.
    """
    known = fields(kind)
    check_keys(table, tuple(f.name for f in known), what)
    stated = [f for f in known if f.name in table or f.default is MISSING]
    return kind(**{f.name: READ[str(f.type)](table, f.name, named or what) for f in stated})


def written(value: str | float | tuple[float, ...]) -> str:
    """A text, a number or numbers as TOML that reads back the same."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)  # printable text needs no escapes but JSON's
    if isinstance(value, tuple):
        return f"[{', '.join(written(x) for x in value)}]"
    return repr(float(value))
