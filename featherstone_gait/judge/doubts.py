"""Read what differs between worlds, and draw it: physical numbers, zeros, sensors, delays, pushes.

The file `worlds.toml` beside this one is the default.  Each draw depends on the seed, its name and the number of the
world alone, so that more worlds, or other tables, change none of them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np

from ..base.arguments import real
from ..base.files import FilePath
from ..robot_file.toml import check_keys, read_toml, table_of
from ..run.worlds import Worlds
from ..scene.compile import CompiledScene
from ..study.draws import OFFSET, read_draws
from .floors import MOST_NODES, rough_fields, start_radius

DEFAULT = Path(__file__).parent / "worlds.toml"
MOTOR = ("voltage_limit", "resistance", "motor_constant", "backlash")  # without effect on servos of a torque law
AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Numbers:
    """The tables [roughness], [sensing], [link] and [pushes]: what is no number of the scene; 0 is none of it."""

    gyroscope_noise: float = 0.0  # [rad/s]
    gyroscope_bias: float = 0.0  # [rad/s]
    gravity_noise: float = 0.0
    mounting: float = 0.0  # [rad]
    joint_noise: float = 0.0  # [rad]
    joint_speed_noise: float = 0.0  # [rad/s]
    sensor_delay: float = 0.0  # [s]
    delay: float = 0.0  # [s]
    lost: float = 0.0
    speed: float = 0.0  # [m/s]
    every: float = 3.0  # [s]
    height: float = 0.0  # [m]
    cell: float = 0.05  # [m]


TABLES = {
    "roughness": ["height", "cell"], "sensing": [f.name for f in fields(Numbers)][:7], "link": ["delay", "lost"],
    "pushes": ["speed", "every"],
}  # fmt: skip


class Sensing(NamedTuple):
    """Errors of the sensors of each world."""

    offset: np.ndarray  # (n, joints) zeros [rad]
    bias: np.ndarray  # (n, 3) [rad/s]
    mounting: np.ndarray  # (n, 3) [rad]
    late: np.ndarray  # (n,) of the inertial sensor [s]
    numbers: Numbers
    seed: int

    def deviations(self, joints: int) -> tuple[float, ...]:
        """Return the standard deviations of gyroscope, gravity, joints and their speeds."""
        s = self.numbers
        return (*[s.gyroscope_noise] * 3, *[s.gravity_noise] * 3, *[s.joint_noise] * joints,
                *[s.joint_speed_noise] * joints)  # fmt: skip


class Drawn(NamedTuple):
    """The worlds of a judgment."""

    worlds: Worlds
    sensing: Sensing
    delay: np.ndarray  # (n,) [s]
    factors: dict[str, np.ndarray]  # (n,) by name, what was drawn
    left_out: dict[str, str]  # why tables of the default file are not drawn
    who: np.ndarray  # (n,) their numbers

    def uniform(self, name: str, *shape: int) -> np.ndarray:
        """Draw numbers (n, *shape) from 0 to 1, for each world whatever the others."""
        return _generator(self.sensing.seed, name).random((int(self.who.max()) + 1, *shape))[self.who]

    def only(self, scene: CompiledScene, who: Sequence[int]) -> Drawn:
        """Return some of the worlds of all."""
        rows, tables = [*who], dict[str, Any]()
        for section, name, parts, values in self.worlds.columns(scene):
            key = f"{parts[0]}.{name}" if len(parts) == 1 and parts[0] else name
            tables.setdefault(section, {})[key] = values[rows]
        s = self.sensing
        sensing = s._replace(**{name: getattr(s, name)[rows] for name in ("offset", "bias", "mounting", "late")})
        worlds = Worlds(runs=len(rows), **tables, fields=[self.worlds.fields[k] for k in rows if self.worlds.fields])
        return self._replace(worlds=worlds, sensing=sensing, delay=self.delay[rows], who=self.who[rows])


def draw_worlds(
    scene: CompiledScene, count: int, seed: int = 0, source: FilePath | Mapping[str, Any] | None = None,
    reach: float = 3.0,
) -> Drawn:  # fmt: skip
    """Draw worlds; source: a TOML file or its tables, None for the default.

    A table that does not apply to the robot is left out if it is as in the default.
    reach: how far from the start a rough ground goes on, to each side [m].

    Raises ValueError, naming file and key.
    """
    path = DEFAULT if source is None else source
    try:
        table: Mapping[str, Any] = path if isinstance(path, Mapping) else read_toml(Path(path))
        check_keys(table, ("worlds", *TABLES), "worlds")
        numbers = _numbers(table)
        if numbers.height:
            _check_roughness(scene, numbers, count, reach)
        given, left_out = _applying(scene, table_of(table, "worlds", ""))
        found = read_draws(given, scene) if given else ()
    except ValueError as error:
        if isinstance(path, Mapping):
            raise
        raise ValueError(f"{path}: {str(error).removeprefix(f'{path}: ')}") from error
    tables: dict[str, Any] = {}
    offset = np.zeros((count, len(scene.model.joint_names)))
    for draw in found:
        if f"{draw.section}.{draw.key}" == OFFSET:
            offset = draw.spread.drawn(np.zeros(offset.shape[1]), count, _generator(seed, OFFSET))
        else:
            tables.setdefault(draw.section, {})[draw.key] = draw.spread
    worlds = Worlds(runs=count, seed=seed, **tables)

    def either(name: str, width: int) -> np.ndarray:
        return getattr(numbers, name) * _generator(seed, name).uniform(-1.0, 1.0, (count, width))

    delay, late = (
        getattr(numbers, name) * _generator(seed, name).uniform(0.0, 1.0, count) for name in ("delay", "sensor_delay")
    )
    sensing = Sensing(offset, either("gyroscope_bias", 3), either("mounting", 3), late, numbers, seed)
    factors = _factors(scene, worlds, sensing, delay)
    if numbers.height:
        worlds, factors["roughness"] = _roughened(scene, worlds, numbers, reach)
    return Drawn(worlds, sensing, delay, factors, left_out, np.arange(count))


def _check_roughness(scene: CompiledScene, numbers: Numbers, count: int, reach: float) -> None:
    """Raise ValueError for a ground that cannot be roughened, and for too many nodes."""
    ground = scene.ground
    assert ground is not None
    own = "a field" if ground.field is not None else "steps" if ground.steps else "a surface that moves"
    if ground.field is not None or ground.steps or ground.moves:
        raise ValueError(
            f"roughness.height is {numbers.height:g} m, and the ground of {scene.model.name} has {own}: roughness "
            "takes a plane at rest; leave one of the two out"
        )
    real("roughness.cell", numbers.cell, 1e-3, 10.0, "it is the distance of two nodes [m]: 0.05 is half a foot")
    nodes = count * (2.0 * reach / numbers.cell + 1.0) ** 2
    if nodes > MOST_NODES:
        least = 2.0 * reach / ((MOST_NODES / count) ** 0.5 - 1.0)
        raise ValueError(
            f"roughness.cell is {numbers.cell:g} m: {count} worlds of {2.0 * reach:.3g} m width have {nodes:.2g} "
            f"nodes, at most {MOST_NODES:.0e}; give a cell of {least:.2g} m or more, fewer worlds or less time"
        )


def _roughened(scene: CompiledScene, worlds: Worlds, numbers: Numbers, reach: float) -> tuple[Worlds, np.ndarray]:
    """Return worlds on height fields, which have the slope of their planes, and the roughness of each (n,) [m]."""
    plane = {"slope": np.full(len(worlds), scene.ground.slope), "heading": np.full(len(worlds), scene.ground.heading)}  # type: ignore[union-attr]
    plane |= {one.name: one.values[:, 0] for one in worlds.columns(scene) if one.name in plane}
    heights = numbers.height * _generator(worlds.seed, "roughness").random(len(worlds))
    even = start_radius(scene) + numbers.cell
    seed = [worlds.seed, crc32(b"heights")]
    fields = rough_fields(heights, plane["slope"], plane["heading"], numbers.cell, reach, even, seed)
    level = {**worlds.ground, "slope": 0.0, "heading": 0.0}
    return dataclasses.replace(worlds, ground=level, fields=fields), heights


def _generator(seed: int, name: str) -> np.random.Generator:
    return np.random.default_rng([seed, crc32(name.encode())])


def _numbers(table: Mapping[str, Any]) -> Numbers:
    given: dict[str, float] = {}
    for name, keys in TABLES.items():
        own = table_of(table, name, "")
        check_keys(own, tuple(keys), name)
        given |= {key: real(f"{name}.{key}", value, 0.0, 1e6, "0 is none of it") for key, value in own.items()}
    real("link.lost", given.get("lost", 0.0), 0.0, 0.9, "it is a share")
    real("pushes.every", given.get("every", 1.0), 1e-3, 1e6, "give the mean time between pushes [s]")
    return Numbers(**given)


def _applying(scene: CompiledScene, table: dict[str, Any]) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the tables without those of the default file that do not apply to a scene, and why these do not."""
    kept, left_out = dict(table), dict[str, str]()
    for section, usual in read_toml(DEFAULT)["worlds"].items():
        given = table.get(section)
        if isinstance(given, dict):
            common = [key for key in given if given[key] == usual.get(key)]
            why = {key: text for key in common if (text := _without(scene, section, key, given[key]))}
            left_out |= {f"{section}.{key}": text for key, text in why.items()}
            kept[section] = {key: spread for key, spread in given.items() if key not in why}
            if why and not kept[section]:
                del kept[section]
    return kept, left_out


def _without(scene: CompiledScene, section: str, key: str, spread: dict[str, Any]) -> str:
    """Say why a distribution does not apply to a scene; "" if it does."""
    if section == "servos" and key in MOTOR and not scene.sampled:
        return "the servos have no motor"
    if section == "servos" and key == "voltage_limit" and scene.constants.supply is not None:
        return "the supply's voltage is drawn"
    try:
        read_draws({section: {key: spread}}, scene)
    except ValueError as error:
        return str(error)
    return ""


def _factors(scene: CompiledScene, worlds: Worlds, sensing: Sensing, delay: np.ndarray) -> dict[str, np.ndarray]:
    """Return what was drawn, as one number a world each: of several servos, links or joints their mean and each."""
    found: dict[str, np.ndarray] = {}
    for column in worlds.columns(scene):
        values = column.values if column.values.ndim == 3 else column.values[:, :, None]
        name = f"{column.section}.{column.name}"
        for k in range(values.shape[2]):
            axis = f" {AXES[k]}" if values.shape[2] == 3 else ""
            found[f"{name}{axis}" if len(column.parts) < 2 else f"mean {name}{axis}"] = values[:, :, k].mean(axis=1)
        if values.shape[2] == 1 and len(column.parts) > 1:
            found |= {f"{name} of {part}": values[:, j, 0] for j, part in enumerate(column.parts)}
    found |= {f"zero of {name}": sensing.offset[:, j] for j, name in enumerate(scene.model.joint_names)}
    for what, values in (("gyroscope bias", sensing.bias), ("mounting of the sensor", sensing.mounting)):
        found |= {f"{what} {axis}": values[:, k] for k, axis in enumerate(AXES)}
    found |= {"delay": delay, "delay of the sensor": sensing.late}
    return {name: values for name, values in found.items() if np.ptp(values) > 0.0}
