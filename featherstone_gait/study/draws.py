"""Numbers that each run of a study draws for itself: the tables of [worlds].

    [worlds]
    links.mass = {law = "uniform", width = 0.1}               # each link by itself
    servos.voltage_limit = {law = "normal", width = 0.05, alike = true}
    reference.offset = {law = "uniform", width = 0.03}        # zeros of the joints' encoders [rad]

Names and tables are those of `Worlds` and `Spread`; `reference.offset`, what each servo is sent beyond its reference,
is a study's own.  In the sample the draws of one name go together, so that "saltelli" tells what all of them make of a
measure: Sobol's indices of a group (I. M. Sobol, Mathematics and Computers in Simulation 55 (2001), section 7).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from ..arguments import shown
from ..build.scene import CompiledScene
from ..worlds import FIELDS, Spread, Worlds, nominal

OFFSET = "reference.offset"


class Draw(NamedTuple):
    """One table of [worlds]."""

    section: str
    key: str  # of `Worlds`
    spread: Spread
    shape: tuple[int, ...]  # of what a run draws

    @property
    def name(self) -> str:
        """As the table has it."""
        return f"worlds.{self.section}.{self.key}"

    @property
    def numbers(self) -> int:
        """How many a run draws."""
        return math.prod(self.shape)


def read_draws(table: dict[str, Any], scene: CompiledScene) -> tuple[Draw, ...]:
    """The draws that a table [worlds] asks for in a scene.  Raises ValueError, naming the key."""
    found = []
    for section, key, given in _tables(table):
        name = f"worlds.{section}.{key}"
        if f"{section}.{key}" == OFFSET:
            given = {**given, "added": True}
        unknown = given.keys() - {"law", "width", "added", "alike"}
        if unknown or not {"law", "width"} <= given.keys():
            raise ValueError(f'{name} is {given!r}; give {{law = "uniform", width = 0.1}}, and if need be added, alike')
        try:
            spread = Spread(**given)
        except (ValueError, TypeError) as error:
            raise ValueError(f"{name}: {error}") from error
        if f"{section}.{key}" == OFFSET:
            numbers = np.zeros(len(scene.model.joint_names))
        else:
            _worlds(1, {section: {key: spread}})
            numbers = nominal(scene, section, key)[1]
        found.append(Draw(section, key, spread, spread.shape(numbers)))
    return tuple(found)


def _tables(table: dict[str, Any]) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Section, key and table of every spread."""
    sections = (*FIELDS, "reference")
    for section, inner in table.items():
        if section not in sections:
            raise ValueError(f"worlds: there is no section {shown(section)}; use one of {', '.join(sections)}")
        for key, given in _named("", inner, f"worlds.{section}"):
            if section == "reference" and key != "offset":
                raise ValueError(f"worlds.reference.{key} is no number that can be drawn; use {OFFSET}")
            yield section, key, given


def _named(prefix: str, table: object, what: str) -> Iterator[tuple[str, dict[str, Any]]]:
    if not isinstance(table, dict):
        raise ValueError(f'{what} is {table!r}; give a table as {{law = "uniform", width = 0.1}}')
    if prefix and not any(isinstance(value, dict) for value in table.values()):
        yield prefix, table
        return
    for key, inner in table.items():
        yield from _named(f"{prefix}.{key}" if prefix else key, inner, f"{what}.{key}")


def drawn_scenes(
    scene: CompiledScene, draws: tuple[Draw, ...], x: list[tuple[np.ndarray, ...]]
) -> list[CompiledScene | ValueError]:
    """The scene of each run, or why there is none; x: what each run has drawn, as `Study.values` has it."""
    fields: dict[str, dict[str, np.ndarray]] = {}
    for k, draw in enumerate(draws):
        if draw.section in FIELDS:
            numbers = nominal(scene, draw.section, draw.key)[1]
            values = draw.spread.applied(numbers, np.array([one[k].reshape(draw.shape) for one in x]))
            fields.setdefault(draw.section, {})[draw.key] = values
    if not fields:
        return [scene] * len(x)
    worlds = _worlds(len(x), fields)
    try:
        return [*worlds.scenes(scene)]
    except ValueError:  # one of them; which, each says by itself
        return [_alone(worlds, scene, run) for run in range(len(x))]


def _worlds(runs: int, fields: dict[str, Any]) -> Worlds:
    return Worlds(runs=runs, **fields)


def _alone(worlds: Worlds, scene: CompiledScene, run: int) -> CompiledScene | ValueError:
    try:
        return worlds.scenes(scene, [run])[0]
    except ValueError as error:
        return ValueError(str(error).partition(": ")[2])


def offset_of(draws: tuple[Draw, ...], x: tuple[np.ndarray, ...]) -> np.ndarray | float:
    """What is added to the references of a run (nj,) [rad]."""
    for draw, own in zip(draws, x):
        if f"{draw.section}.{draw.key}" == OFFSET:
            return draw.spread.width * own
    return 0.0
