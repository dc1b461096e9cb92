"""Draw random numbers for each run of a study, as its tables [worlds] state.

    [worlds]
    links.mass = {kind = "uniform", scale = 0.1}               # independent for each link
    servos.voltage_limit = {kind = "normal", scale = 0.05, shared = true}
    reference.offset = {kind = "uniform", scale = 0.03}        # zeros of the joints' encoders [rad]

Names and tables are those of `Worlds` and `Distribution`; `reference.offset`, which is added to each servo's reference,
exists only in studies.  All numbers of one table form a group of the sample, so that "saltelli" gives Sobol's indices
of the group (I. M. Sobol, Mathematics and Computers in Simulation 55 (2001), section 7).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from ..base.arguments import shown
from ..run.worlds import FIELDS, Distribution, Worlds, nominal
from ..scene.compile import CompiledScene

OFFSET = "reference.offset"


class Draw(NamedTuple):
    """A table of [worlds]."""

    section: str
    key: str  # of `Worlds`
    spread: Distribution
    shape: tuple[int, ...]  # of what a run draws

    @property
    def name(self) -> str:
        """The name of the column in the study's table."""
        return f"worlds.{self.section}.{self.key}"

    @property
    def numbers(self) -> int:
        """Number of numbers that a run draws."""
        return math.prod(self.shape)


def read_draws(table: dict[str, Any], scene: CompiledScene) -> tuple[Draw, ...]:
    """Read the tables [worlds] for a scene.  Raises ValueError, naming the key."""
    found: list[Draw] = []
    for section, key, given in _tables(table):
        offset = f"{section}.{key}" == OFFSET
        spread = _spread(f"worlds.{section}.{key}", given, offset)
        if offset:
            numbers = np.zeros(len(scene.model.joint_names))
        else:
            fields: dict[str, Any] = {section: {key: spread}}
            Worlds(runs=1, **fields)
            numbers = nominal(scene, section, key)[1]
            _check_spread(f"worlds.{section}.{key}", key, spread, numbers)
        found.append(Draw(section, key, spread, spread.shape(numbers)))
    names = [draw.name for draw in found]
    for draw in found:
        whole = f"worlds.{draw.section}.{draw.key.rpartition('.')[2]}"
        if names.count(draw.name) > 1 or (draw.name != whole and whole in names):
            raise ValueError(f"{draw.name} is drawn twice, by {whole} too; keep one of the two")
    return tuple(found)


def _spread(name: str, given: dict[str, Any], offset: bool) -> Distribution:
    allowed = ("kind", "scale", "shared") if offset else ("kind", "scale", "additive", "shared")
    if not {"kind", "scale"} <= given.keys() <= {*allowed}:
        raise ValueError(f'{name} is {given!r}; give {{kind = "uniform", scale = 0.1}}, of {", ".join(allowed)}')
    if offset and given["kind"] == "lognormal":
        raise ValueError(f"{name}: kind is 'lognormal', which is a factor; use 'uniform' or 'normal'")
    try:
        spread = Distribution(**(given | {"additive": True} if offset else given))
    except (ValueError, TypeError) as error:
        raise ValueError(f"{name}: {error}") from error
    if offset and spread.scale > math.pi:
        raise ValueError(f"{name}: scale is {spread.scale:g} rad; give 0 to pi: 0.03 is usual")
    return spread


def _check_spread(name: str, key: str, spread: Distribution, numbers: np.ndarray) -> None:
    if key.rpartition(".")[2] == "period":
        raise ValueError(f"{name}: the time step must divide periods; vary servo.period instead")
    if not spread.additive and not (np.isfinite(numbers) & (numbers != 0.0)).any():
        value = float(numbers.ravel()[0])
        raise ValueError(f"{name} is {value:g} here and has no share to draw; add additive = true or set it")


def _tables(table: dict[str, Any]) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Yield section, key and table of every distribution."""
    sections = (*FIELDS, "reference")
    for section, inner in table.items():
        if section not in sections:
            raise ValueError(f"worlds: there is no section {shown(section)}; use one of {', '.join(sections)}")
        for key, given in _named("", inner, f"worlds.{section}", 2):
            if section == "reference" and key != "offset":
                raise ValueError(f"worlds.reference.{key} cannot be drawn; use {OFFSET}")
            yield section, key, given


def _named(prefix: str, table: object, what: str, deeper: int) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield tables by their names, PART.name or name."""
    if not isinstance(table, dict) or not table:
        raise ValueError(f'{what} is {shown(table)}; give a table as {{kind = "uniform", scale = 0.1}}')
    if prefix and (not deeper or not any(isinstance(value, dict) for value in table.values())):
        yield prefix, table
        return
    for key, inner in table.items():
        yield from _named(f"{prefix}.{key}" if prefix else key, inner, f"{what}.{key}", deeper - 1)


def drawn_scenes(
    scene: CompiledScene, draws: tuple[Draw, ...], x: list[tuple[np.ndarray, ...]]
) -> list[CompiledScene | ValueError]:
    """Make the scene of each run, or the error if there is none; x: the draws of each run, as of `Study.values`."""
    fields: dict[str, Any] = {}
    for k, draw in enumerate(draws):
        if draw.section in FIELDS:
            numbers = nominal(scene, draw.section, draw.key)[1]
            with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is refused as such
                values = draw.spread.applied(numbers, np.array([one[k].reshape(draw.shape) for one in x]))
            fields.setdefault(draw.section, {})[draw.key] = values
    try:
        return [*Worlds(runs=len(x), **fields).scenes(scene)] if fields else [scene] * len(x)
    except ValueError as error:
        if len(x) == 1:
            return [ValueError(str(error).removeprefix("world 0: "))]
    return [own for one in x for own in drawn_scenes(scene, draws, [one])]  # which of them fails each says by itself


def offset_of(draws: tuple[Draw, ...], x: tuple[np.ndarray, ...]) -> np.ndarray | float:
    """Find the offset (nj,) of the references of a run [rad]."""
    for draw, own in zip(draws, x):
        if f"{draw.section}.{draw.key}" == OFFSET:
            return draw.spread.scale * own
    return 0.0
