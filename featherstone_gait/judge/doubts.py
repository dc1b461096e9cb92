"""Read what differs between worlds, and draw it: physical numbers, zeros, sensors, delays, pushes.

The file `worlds.toml` beside this one is the default.  Each draw depends on the seed, its name and the number of the
world alone, so that more worlds, or other tables, change none of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np

from ..base.arguments import real
from ..base.files import FilePath
from ..robot_file.toml import check_keys, read_toml
from ..run.worlds import Worlds
from ..scene.compile import CompiledScene
from ..study.draws import OFFSET, read_draws

DEFAULT = Path(__file__).parent / "worlds.toml"
MOTOR = ("voltage_limit", "resistance", "motor_constant", "backlash")  # without effect on servos of a torque law
AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Numbers:
    """The tables [sensing], [link] and [pushes]: what is no number of the scene; 0 is none of it."""

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


TABLES = {"sensing": [f.name for f in fields(Numbers)][:7], "link": ["delay", "lost"], "pushes": ["speed", "every"]}


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
        worlds = Worlds(runs=len(rows), **tables)
        return self._replace(worlds=worlds, sensing=sensing, delay=self.delay[rows], who=self.who[rows])


def draw_worlds(
    scene: CompiledScene, count: int, seed: int = 0, source: FilePath | Mapping[str, Any] | None = None
) -> Drawn:
    """Draw worlds; source: a TOML file or its tables, None for the default, of which what does not apply is left out.

    Raises ValueError, naming file and key.
    """
    path = DEFAULT if source is None else source
    try:
        table: Mapping[str, Any] = path if isinstance(path, Mapping) else read_toml(Path(path))
        check_keys(table, ("worlds", *TABLES), "worlds")
        numbers = _numbers(table)
        given, left_out = _applying(scene, table.get("worlds", {}), source is None)
        found = read_draws(given, scene) if given else ()
    except ValueError as error:
        raise error if isinstance(path, Mapping) else ValueError(f"{path}: {error}") from error
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
    return Drawn(worlds, sensing, delay, _factors(scene, worlds, sensing, delay), left_out, np.arange(count))


def _generator(seed: int, name: str) -> np.random.Generator:
    return np.random.default_rng([seed, crc32(name.encode())])


def _numbers(table: Mapping[str, Any]) -> Numbers:
    given: dict[str, float] = {}
    for name, keys in TABLES.items():
        own = table.get(name, {})
        check_keys(own, tuple(keys), name)
        given |= {key: real(f"{name}.{key}", value, 0.0, 1e6, "0 is none of it") for key, value in own.items()}
    real("link.lost", given.get("lost", 0.0), 0.0, 0.9, "it is a share")
    real("pushes.every", given.get("every", 1.0), 1e-3, 1e6, "give the mean time between pushes [s]")
    return Numbers(**given)


def _applying(scene: CompiledScene, table: Mapping[str, Any], default: bool) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the tables that apply to a scene, and why others do not; those of a user's file all have to."""
    if not default:
        return dict(table), {}
    kept: dict[str, Any] = {}
    left_out: dict[str, str] = {}
    for section, inner in table.items():
        for key, spread in inner.items():
            if section == "servos" and key in MOTOR and not scene.sampled:
                left_out[f"{section}.{key}"] = "the servos have no motor"
                continue
            if section == "servos" and key == "voltage_limit" and scene.constants.supply is not None:
                left_out[f"{section}.{key}"] = "the supply's voltage is drawn"
                continue
            try:
                read_draws({section: {key: spread}}, scene)
            except ValueError as error:
                left_out[f"{section}.{key}"] = str(error)
            else:
                kept.setdefault(section, {})[key] = spread
    return kept, left_out


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
