"""Read and write the tables [[sensors]] of a robot's TOML file.

A table has the fields of a sensor's class, of a `fan` or a `cone` the arguments of the method of that name, and beside
them those of `SampledSensor`, if the sensor is one.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import fields
from inspect import signature
from typing import Any

import numpy as np

from ..model.sensor import ContactSensor, ForceTorqueSensor, LineSensor, RangeSensor, SampledSensor, check_sensors
from .toml import READ, Problems, at, check_keys, number, real, string

KINDS: dict[str, type] = {
    "range": RangeSensor, "line": LineSensor, "force_torque": ForceTorqueSensor, "contact": ContactSensor,
}  # fmt: skip
MADE: dict[str, tuple[Callable[..., RangeSensor], tuple[str, ...]]] = {  # and their own keys
    "fan": (RangeSensor.fan, ("angle", "rays")),
    "cone": (RangeSensor.cone, ("angle", "rays")),
    "infrared": (RangeSensor.infrared, ()),
}
SAMPLED = ("noise", "rate", "delay", "seed")


def read_sensors(rows: Any, links: Collection[str]) -> tuple[Any, ...]:
    """Read the tables; raise ValueError for what they say wrongly."""
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise ValueError(f"sensors is {rows!r}; expected tables: write [[sensors]] above each")
    found, problems = list[Any](), Problems()
    for k, row in enumerate(rows):
        with problems.at(row):
            found.append(_read(row, f"sensors[{k}]"))
            check_sensors("sensors", found, links)
    problems.raise_all()
    return tuple(found)


def _read(row: Mapping[str, Any], what: str) -> Any:
    with at(row, "kind"):
        kind = string(row, "kind", what)
        if kind not in (*KINDS, *MADE):
            raise ValueError(f"{what}: kind is {kind!r}; expected one of {', '.join((*KINDS, *MADE))}")
    own = fields(KINDS.get(kind, RangeSensor))
    make, more = MADE.get(kind, (KINDS.get(kind, RangeSensor), ()))
    own = tuple(f for f in own if kind in KINDS or f.name != "directions")
    check_keys(row, ("kind", *(f.name for f in own), *more, *SAMPLED), what)
    asked = signature(make).parameters.values()
    missing = [p.name for p in asked if p.default is p.empty and p.kind is not p.VAR_KEYWORD and p.name not in row]
    if missing:
        raise ValueError(f"{what}: {missing[0]} is missing; add {missing[0]} = ...")
    problems, given = Problems(), dict[str, Any]()
    for f in own:
        if f.name in row:
            with problems.at(row, f.name):
                given[f.name] = READ[str(f.type)](row, f.name, what)
    for name in more:
        if name in row:
            with problems.at(row, name):
                given[name] = _number(row, name, what)
    problems.raise_all()
    with at(row):
        return _sampled(row, make(**given), what)


def _number(row: Mapping[str, Any], key: str, what: str) -> Any:
    """Return the number under a key, a whole one as such: some of a sensor's are to be whole, and seeds have digits."""
    value = number(row, key, what)
    if isinstance(row[key], int):
        return row[key]
    return int(value) if value.is_integer() else value


def _sampled(row: Mapping[str, Any], sensor: Any, what: str) -> Any:
    """Return the sensor with its noise, rate, delay and seed, if the table states any."""
    given: dict[str, Any] = {name: _number(row, name, what) for name in SAMPLED[1:] if name in row}
    if "noise" in row:
        several = row["noise"] if isinstance(row["noise"], list) else None
        given["noise"] = (
            number(row, "noise", what) if several is None else tuple(real(x, f"{what}: noise") for x in several)
        )
    return SampledSensor(sensor, **given) if given else sensor


def sensor_table(sensor: Any) -> dict[str, Any] | None:
    """Return the table of a sensor; None for one of a channel, which a file cannot state."""
    more: dict[str, Any] = {}
    if isinstance(sensor, SampledSensor):
        if isinstance(sensor.sensor, str):
            return None
        given = ((name, getattr(sensor, name)) for name in SAMPLED)
        more = {name: value for name, value in given if value} | {"name": sensor.name}
        sensor = sensor.sensor
    kind = next(name for name, own in KINDS.items() if isinstance(sensor, own))
    table: dict[str, Any] = {"kind": kind}
    for f in fields(sensor):
        value = getattr(sensor, f.name)
        if isinstance(value, np.ndarray):
            table[f.name] = tuple(map(tuple, value.tolist()))
        elif value != f.default:
            table[f.name] = value
    return table | more
