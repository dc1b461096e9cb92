"""Tables of the keys of TOML files, from the dataclasses that the reader fills; `docs/tables.py` writes them."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable
from dataclasses import MISSING, Field, fields
from typing import Any, get_args

from featherstone_gait.model import (
    ContactPoint,
    Controller,
    Fluid,
    Gearbox,
    Immersed,
    Joint,
    Link,
    Loop,
    Propeller,
    Servo,
    Supply,
    Surface,
    Tendon,
)
from featherstone_gait.model.fluid import LAWS
from featherstone_gait.model.loop import LoopKind
from featherstone_gait.model.servo import Law
from featherstone_gait.robot_file.servos import PARTS, SERVO_KEYS
from featherstone_gait.robot_file.settings import OWN

TABLES: dict[str, tuple[type, Iterable[str]]] = {
    "contacts": (ContactPoint, [f.name for f in fields(ContactPoint)]),
    "loops": (Loop, [f.name for f in fields(Loop)]),
    "tendons": (Tendon, [f.name for f in fields(Tendon)]),
    "immersed": (Immersed, [f.name for f in fields(Immersed)]),
    "propellers": (Propeller, [f.name for f in fields(Propeller)]),
    "fluid": (Fluid, [f.name for f in fields(Fluid)]),
    "links": (Link, OWN["links"]),
    "surface": (Surface, [f.name for f in fields(Surface)]),
    "joints": (Joint, OWN["joints"]),
    "supply": (Supply, [f.name for f in fields(Supply)]),
    **{part.__name__: (part, [f.name for f in PARTS[part]]) for part in (Controller, Gearbox, Servo)},
}
ATTRIBUTE = re.compile(r"^(\w[\w, ]*) : [^\n]*\n((?:    [^\n]*\n?)+)", re.MULTILINE)
UNIT = re.compile(r"\[([^\]]+)\]")
ALLOWED = {  # by type, of fields that state no range
    "str": "text",
    "Law": ", ".join(get_args(Law)),
    "FluidLaw": ", ".join(LAWS),
    "Geometry": "{shape, radius, ...}",
    "Surface | None": "{velocity, ...}",
    "float | Vector": "number >= 0, [x, y, z]",
    "tuple[float, ...]": "[number, ...]",
    "tuple[tuple[float, ...], ...] | None": "six rows of six",
    "LoopKind": ", ".join(get_args(LoopKind)),
    "str | None": "text",
    "bool": "true, false",
    "Mapping[str, Mapping[str, float]] | tuple[tuple[str, tuple[tuple[str, float], ...]], ...]": "tables by degree",
    "Vector": "[x, y, z]",
    "float | None": ">= 0",
    "tuple[Moment, ...]": "[[name, number], ...]",
    "tuple[Via, ...]": "[{link, point, share}, ...]",
    "float | tuple[float, float]": "number, [number, number]",
}


def table(kind: type, names: Iterable[str]) -> str:
    """Return the table of some fields of a dataclass: unit, range and default, and what the class says of them."""
    said = descriptions(kind)
    rows = [_row(f, said[f.name]) for f in fields(kind) if f.name in names]
    head = ["| key | unit | allowed | default | |", "| --- | --- | --- | --- | --- |"]
    return "".join(f"{row}\n" for row in [*head, *rows])


def descriptions(kind: type) -> dict[str, str]:
    """Return what the docstring of a class says of its attributes."""
    text = inspect.getdoc(kind) or ""
    return {
        name: " ".join(body.split())
        for names, body in ATTRIBUTE.findall(text.partition("Attributes\n")[2])
        for name in names.split(", ")
    }


def _row(f: Field[Any], said: str) -> str:
    unit = f.metadata.get("unit", "SI")
    unit = unit if unit != "SI" else next(iter(UNIT.findall(said)), "")
    allowed = f.metadata.get("rule", ALLOWED.get(str(f.type), ""))
    default = "required" if f.default is MISSING else _written(f.default)
    name = f"`{f.name}`" + (f", `{f.name}_deg`" if f"{f.name}_deg" in SERVO_KEYS else "")
    return f"| {name} | {unit} | {allowed} | {default} | {said.replace(f' [{unit}]', '')} |"


def _written(value: Any) -> str:
    if value is None:
        return "none"
    if isinstance(value, bool):
        return "true" if value else "false"
    return f"{value:g}" if isinstance(value, float) else str(list(value) if isinstance(value, tuple) else value)
