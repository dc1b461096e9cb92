"""Read TOML files and their values; errors name line and key, all of a file at once."""

from __future__ import annotations

import difflib
import json
import math
import sys
import tomllib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import MISSING, fields, replace
from pathlib import Path
from typing import Any, cast

from ..base.arguments import is_real, shown
from ..base.flaws import Flaw, FlawError, quoted
from ..model import Controller, Surface, Via, Wrap
from ..model.checks import check, field_flaws
from ..model.shapes import Box, Capsule, Cylinder, Geometry, Hull, Mesh, Sphere
from .source import read_bytes
from .toml_lines import with_lines


def read_toml(path: Path) -> dict[str, Any]:
    """Read the table of a TOML file; raise ValueError if it is none."""
    try:
        return parsed(read_bytes(path).decode("utf-8"))
    except UnicodeDecodeError as error:
        raise ValueError(f"is not UTF-8 text: {error}; save it as UTF-8") from error


def parsed(text: str) -> dict[str, Any]:
    """Return the table of TOML text; raise ValueError if it is none."""
    try:
        return with_lines(tomllib.loads(text), text)
    except RecursionError as error:
        raise ValueError("nests its values too deeply; flatten it") from error
    except ValueError as error:
        raise ValueError(f"is not TOML: {error}; correct the syntax there (https://toml.io)") from error


class Wrong(FlawError):
    """Report all flaws of a TOML file; the element of each is its line."""


@contextmanager
def at(table: Mapping[str, Any], key: str = "") -> Iterator[None]:
    """Put the line of a key, or else that of its table, before the messages of errors that have none."""
    try:
        yield
    except Wrong:
        raise
    except ValueError as error:
        lines, own = getattr(table, "lines", {}), getattr(table, "line", 0)
        line = lines.get(key, own)
        texts = [flaw.text for flaw in error.flaws] if isinstance(error, FlawError) else [str(error)]
        raise Wrong(Flaw(f"{line}", f"line {line}: {text}" if line else text) for text in texts) from error


class Problems:
    """Collect what is wrong."""

    def __init__(self) -> None:
        self.found: list[Flaw] = []

    @contextmanager
    def at(self, table: Mapping[str, Any], key: str = "") -> Iterator[None]:
        """Catch errors, and add them with the line of a key, or else of the table."""
        try:
            with at(table, key):
                yield
        except Wrong as error:
            self.found += error.flaws

    def raise_all(self) -> None:
        """Raise Wrong with all that was found, in the order of the lines."""
        if self.found:
            raise Wrong(sorted(dict.fromkeys(self.found), key=lambda flaw: int(flaw.element)))


def check_keys(table: Mapping[str, Any], known: tuple[str, ...], what: str) -> None:
    """Raise ValueError for unknown keys."""
    problems = Problems()
    for key in table:
        with problems.at(table, key):
            if key not in known:
                near = difflib.get_close_matches(key.lower(), {name.lower() for name in known}, 1)
                meant = next((f" (did you mean {name}?)" for name in known if name.lower() in near), "")
                expected = f"expected {', '.join(known)}: correct it, or remove it"
                raise ValueError(f"{what}: unknown key {key!r}{meant}; {expected}")
    problems.raise_all()


def table_of(table: Mapping[str, Any], key: str, prefix: str) -> dict[str, Any]:
    """Return the table under a key, empty if there is none; raise ValueError for anything else."""
    value = table.get(key, {})
    with at(table, key):
        if not isinstance(value, dict):
            such = f"type = '{value}'" if isinstance(value, str) and prefix == "servos.joints." else "key = value lines"
            raise ValueError(f"{prefix}{key} is {value!r}; expected a table: write [{prefix}{key}] and {such}")
    return value


def string(table: Mapping[str, Any], key: str, what: str) -> str:
    """Return the text under a key; raise ValueError for anything else."""
    value = table.get(key)
    with at(table, key):
        if not isinstance(value, str):
            raise ValueError(f"{what}: {key} is {value!r}; expected a name: write it in quotes")
    return value


def real(value: Any, what: str) -> float:
    """Return a number as float, infinite ones included; raise ValueError for anything else."""
    if (not isinstance(value, int) and not is_real(value)) or isinstance(value, bool):
        raise ValueError(f"{what} is {shown(value)}; expected a number: write it like 0.15 or 2e-3, without quotes")
    if abs(value) > sys.float_info.max and value != math.inf:
        raise ValueError(f"{what} is beyond {sys.float_info.max:.1e}; expected a number: correct its size")
    return float(value)


def number(table: Mapping[str, Any], key: str, what: str) -> float:
    """Return the number under a key; raise ValueError for anything else."""
    with at(table, key):
        return real(table.get(key), f"{what}: {key}")


def vector(table: Mapping[str, Any], key: str, what: str) -> tuple[float, ...]:
    """Return the three numbers under a key; raise ValueError for anything else."""
    value = table.get(key)
    if not isinstance(value, list) or len(value) != 3:
        raise ValueError(f"{what}: {key} is {value!r}; expected three numbers: write [x, y, z]")
    return tuple(real(x, f"{what}: {key}") for x in value)


def truth(table: Mapping[str, Any], key: str, what: str) -> bool:
    """Return the truth value under a key; raise ValueError for anything else."""
    value = table.get(key)
    if not isinstance(value, bool):
        raise ValueError(f"{what}: {key} is {value!r}; expected true or false: write it without quotes")
    return value


def name_pairs_of(table: Mapping[str, Any], key: str, remedy: str) -> tuple[tuple[str, str], ...]:
    """Return the pairs of names under a key; raise ValueError for anything else."""
    rows = table.get(key, [])
    with at(table, key):
        if not isinstance(rows, list) or not all(
            isinstance(row, list) and len(row) == 2 and all(isinstance(name, str) for name in row) for row in rows
        ):
            raise ValueError(f"{key} is {shown(rows)}; expected pairs of names: {remedy}")
    return tuple((one, two) for one, two in rows)


def moments(table: Mapping[str, Any], key: str, what: str) -> tuple[tuple[str, float], ...]:
    """Return the names and numbers under a key; raise ValueError for anything else."""
    rows = table.get(key)
    with at(table, key):
        fit = isinstance(rows, list) and all(isinstance(one, list) and len(one) == 2 for one in rows)
        if not fit or not all(isinstance(name, str) for name, _ in rows or ()):
            remedy = 'write [["elbow", 0.02], ...]'
            raise ValueError(f"{what}: {key} is {shown(rows)}; expected names and numbers: {remedy}")
        return tuple((name, real(x, f"{what}: {key}: {name!r}")) for name, x in rows or ())


def path(table: Mapping[str, Any], key: str, what: str) -> tuple[Via | Wrap, ...]:
    """Return the points under a key; raise ValueError for anything else."""
    rows = table.get(key)
    with at(table, key):
        if not isinstance(rows, list) or not all(isinstance(one, dict) for one in rows):
            raise ValueError(f'{what}: {key} is {shown(rows)}; expected points: write [{{link = "hand"}}, ...]')
    kinds = (Wrap if "shape" in one or "radius" in one else Via for one in rows)
    return tuple(record(kind, one, f"{what}: {key}[{k}]") for k, (kind, one) in enumerate(zip(kinds, rows)))


def controller(table: Mapping[str, Any], key: str, what: str) -> Controller:
    """Return the controller under a key; raise ValueError for anything else."""
    row = table.get(key)
    with at(table, key):
        if not isinstance(row, dict):
            raise ValueError(f"{what}: {key} is {shown(row)}; expected a table: write {{law = 'pd', Kp = 10.0}}")
    return record(Controller, row, f"{what}: {key}")


def span(table: Mapping[str, Any], key: str, what: str) -> float | tuple[float, ...]:
    """Return the number or the two numbers under a key; raise ValueError for anything else."""
    value = table.get(key)
    with at(table, key):
        if isinstance(value, list) and len(value) == 2:
            return tuple(real(x, f"{what}: {key}") for x in value)
        return real(value, f"{what}: {key}")


SHAPES: dict[str, type] = {kind.__name__.lower(): kind for kind in (Sphere, Capsule, Cylinder, Box, Mesh, Hull)}


def kind_of(row: Mapping[str, Any], what: str) -> type:
    """Read which kind of shape a table states."""
    with at(row, "shape"):
        shape = string(row, "shape", what)
        if shape not in SHAPES:
            raise ValueError(f"{what}: shape is {shape!r}; expected one of {quoted(SHAPES)}: use one of these")
    return SHAPES[shape]


def geometry_of(kind: type, row: Mapping[str, Any], what: str) -> Geometry:
    """Read a shape of a kind from the fields that a table states."""
    own = tuple(f.name for f in fields(kind))
    missing = [name for name in own if name not in row and name != "scale"]
    if missing:
        raise ValueError(f"{what}: {missing[0]} is missing; a {kind.__name__.lower()} needs it: add {missing[0]} = ...")
    read: dict[str, Callable[..., Any]] = {"size": vector, "scale": vector, "file": string}
    stated: dict[str, Any] = {}
    for key in (name for name in own if name in row):
        with at(row, key):
            if key == "points":
                points = row[key] if isinstance(row[key], list) else []
                stated[key] = tuple(vector({key: point}, key, what) for point in points)
            else:
                stated[key] = read.get(key, number)(row, key, what)
    return kind(**stated)


def beside(geometry: Geometry, folder: Path) -> Geometry:
    """Return a shape whose file, of a mesh, is in a folder."""
    return replace(geometry, file=str(folder / geometry.file)) if isinstance(geometry, Mesh) else geometry


def _geometry(table: Mapping[str, Any], key: str, what: str) -> Geometry:
    """Read a shape given as a table of its own: {shape = "box", size = [...]}."""
    inside = table_of(table, key, "")
    kind = kind_of(inside, what)
    check_keys(inside, ("shape", *(f.name for f in fields(kind))), what)
    return geometry_of(kind, inside, what)


def surface(table: Mapping[str, Any], key: str, what: str) -> Surface:
    """Read how a surface moves, given as a table of its own: {velocity = [...], drive = "left"}."""
    return cast(Surface, record(Surface, table_of(table, key, ""), f"{what}: {key}"))


def _number_or_three(table: Mapping[str, Any], key: str, what: str) -> float | tuple[float, ...]:
    return vector(table, key, what) if isinstance(table.get(key), list) else number(table, key, what)


def _reals(table: Mapping[str, Any], key: str, what: str) -> tuple[float, ...]:
    if not isinstance(table.get(key), list):
        raise ValueError(f"{what}: {key} is {table.get(key)!r}; expected a list of numbers")
    return tuple(real(x, f"{what}: {key}") for x in table[key])


def _matrix(table: Mapping[str, Any], key: str, what: str) -> tuple[tuple[float, ...], ...]:
    if not isinstance(table.get(key), list):
        raise ValueError(f"{what}: {key} is {table.get(key)!r}; expected a list of rows")
    return tuple(_reals({key: row}, key, what) for row in table[key])


# How to read a field of a dataclass, by its type as `fields` gives it.
READ: dict[str, Callable[[Mapping[str, Any], str, str], Any]] = {
    "str": string,
    "bool": truth,
    "float": number,
    "float | None": number,
    "Vector": vector,
    "LoopKind": string,
    "str | None": string,
    "tuple[Moment, ...]": moments,
    "tuple[Via | Wrap, ...]": path,
    "WrapShape": string,
    "Vector | None": vector,
    "Controller | None": controller,
    "Law": string,
    "float | tuple[float, float]": span,
    "Geometry": _geometry,
    "float | Vector": _number_or_three,
    "FluidLaw": string,
    "Surface | None": surface,
    "tuple[float, ...]": _reals,
    "tuple[tuple[float, ...], ...] | None": _matrix,
    "tuple[tuple[float, float], ...]": _matrix,
    "np.ndarray": _matrix,
    "tuple[float, float, float]": vector,
    "tuple[tuple[float, float, float], ...]": _matrix,
}


def record(kind: type, table: Mapping[str, Any], what: str, named: str = "") -> Any:
    """Make a dataclass from a table whose keys are its fields; raise ValueError for other keys and wrong values.

    named: name of the table in messages on values, if it differs.
    """
    known, problems, values = fields(kind), Problems(), dict[str, Any]()
    with problems.at(table):
        check_keys(table, tuple(f.name for f in known), what)
    for f in known:
        if f.name not in table and f.default is MISSING and str(f.type).endswith("| None"):
            values[f.name] = None
        elif f.name in table or f.default is MISSING:
            with problems.at(table, f.name):
                values[f.name] = READ[str(f.type)](table, f.name, named or what)
                check(field_flaws(named or what, f.name, values[f.name], f))
    problems.raise_all()
    with at(table):
        return kind(**values)


def written(value: str | float | tuple[Any, ...] | dict[str, Any]) -> str:
    """Write a text, a number, or a list or table of them as TOML that reads back the same."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)  # printable text needs no escapes but JSON's
    if isinstance(value, dict):
        return f"{{{', '.join(f'{key} = {written(x)}' for key, x in value.items())}}}"
    if isinstance(value, tuple):
        return f"[{', '.join(written(x) for x in value)}]"
    if isinstance(value, int) and abs(value) < 2**63:  # as a float a seed would lose digits
        return repr(value)
    return repr(float(value))
