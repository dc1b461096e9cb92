"""Compute what sensors read from the channels of a run: by name, as objects, with noise, rate and delay."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypeAlias, get_args
from zlib import crc32

import numpy as np

from ..base.arguments import instance, listed, shown, whole
from ..base.portable_math import log, sincos
from ..core.step.state import RECORDABLE
from ..model.sensor import (
    BUILT_IN,
    ContactSensor,
    ForceTorqueSensor,
    LineSensor,
    RangeSensor,
    SampledSensor,
    Sensor,
    check_name,
)
from ..scene.compile import CompiledScene
from . import sensors
from .force_sensor import bears, touches
from .range_sensor import darkness, ranges
from .trajectory import Trajectory

What: TypeAlias = str | Sensor | SampledSensor
OBJECTS = (*get_args(Sensor), SampledSensor)
MOVING = ("base_q", "base_qd", "base_qdd", "q", "qd", "qdd")
PUSHED = ("contact_force", "pair")
NAMED: dict[str, tuple[Callable[..., Any], tuple[str, ...]]] = {
    name: (getattr(sensors, name), needed) for name, needed in BUILT_IN.items()
}
KINDS: dict[type, tuple[Callable[..., Any], tuple[str, ...]]] = {
    RangeSensor: (ranges, ("base_q", "q")),
    LineSensor: (darkness, ("base_q", "q")),
    ForceTorqueSensor: (bears, (*MOVING, *PUSHED, "pair_position", "pair_force")),
    ContactSensor: (touches, ("base_q", "q", *PUSHED, "pair_normal_force")),
}
ON_TIME = 1e-6  # of a record or tick, by which periods and delays may be off
MIX = (0xBF58476D1CE4E5B9, 0x94D049BB133111EB)  # of splitmix64 (G. Steele, D. Lea, C. Flood, OOPSLA 2014)
GOLDEN = 0x9E3779B97F4A7C15


def measure(
    scene: CompiledScene, trajectory: Trajectory | Mapping[str, np.ndarray], sensor: What, robot: int = 0
) -> np.ndarray:
    """Compute what a sensor has read at each record of a run.

    ``simulate(..., record=(sensor,))`` does the same, and records the channels that it needs.

    Parameters
    ----------
    scene : CompiledScene
        The scene of the run.
    trajectory : Trajectory
        What `simulate` returns, with the channels that the sensor needs.
    sensor : a sensor, or str
        A sensor or the name of one of the scene's, one of encoders, gyroscope, accelerometer, center_of_pressure and
        contact_positions, or a channel.
    robot : int
        Number of the run in a batch, or of the robot in a session, of which its noise depends.

    Returns
    -------
    ndarray, shape (samples, ...)
        What it has read, in its unit.

    Raises
    ------
    ValueError
        A channel was not recorded, the sensor does not fit the scene, or its period or delay the time between records.
    """
    instance("scene", scene, CompiledScene, "give what compile_scene returns")
    instance("trajectory", trajectory, Mapping, "give what simulate returns")
    robot = whole("robot", robot, 0, "it is the number of the run in a batch")
    sensor = resolved(scene, sensor, "sensor")
    function, _ = found(sensor)
    if missing := [name for name in here(scene, sensor) if name not in trajectory]:
        raise ValueError(f"trajectory: channels {missing} were not recorded; name them in simulate(record=...)")
    exact = function(scene, trajectory)
    if not isinstance(sensor, SampledSensor):
        return exact
    time = np.asarray(trajectory["time"])
    interval = float(time[1] - time[0]) if len(time) > 1 else 1.0 / (sensor.rate or 1.0)
    pace = Pace(sensor, interval, "records")
    age = np.rint(time / interval).astype(np.int64)
    first = age[0] // pace.period
    number = np.maximum((age - pace.delay) // pace.period, first)
    return exact[np.maximum(number * pace.period - age[0], 0)] + noise_of(sensor, exact.shape[1:], robot, number)


class Pace:
    """Period and delay of a sampled sensor in whole ticks or records."""

    def __init__(self, sensor: SampledSensor, interval: float, of: str) -> None:
        self.period = 1
        if sensor.rate is not None:
            self.period = _whole_in(sensor, "period", 1.0 / sensor.rate, interval, of, 1)
        self.delay = _whole_in(sensor, "delay", sensor.delay, interval, of, 0)


def _whole_in(sensor: SampledSensor, what: str, span: float, interval: float, of: str, least: int) -> int:
    count = round(span / interval)
    if count < least or abs(count - span / interval) > ON_TIME:
        raise ValueError(
            f"sampled sensor {sensor.name!r}: its {what} of {span:g} s is not a whole number of {of} of {interval:g} s"
            f": change its {'rate' if least else what}, or the time between {of}"
        )
    return count


def noise_of(
    sensor: SampledSensor, shape: tuple[int, ...], robot: int | np.ndarray, number: np.ndarray
) -> np.ndarray | float:
    """Return the noise (n, *shape) of measurements (n,) by their number, of one robot or of one each."""
    deviation = np.array(sensor.noise)
    if deviation.ndim and deviation.shape != shape[-1:]:
        raise ValueError(
            f"sampled sensor {sensor.name!r}: noise has {len(deviation)} entries; it reads {shape}: give one number, "
            f"or {shape[-1] if shape else 1}"
        )
    if not deviation.any():
        return 0.0
    key = _mixed(np.uint64(sensor.seed))
    for part in (crc32(sensor.name.encode()), robot, number):
        key = _mixed(key ^ np.asarray(part).astype(np.uint64))
    count = int(np.prod(shape, dtype=np.int64))
    each = np.arange(1, 2 * count + 1, dtype=np.uint64) * np.uint64(GOLDEN)
    bits = _mixed(key[:, None] + each) >> np.uint64(11)
    share = (bits.astype(float) + 0.5) * 2.0**-53
    radius = np.sqrt(-2.0 * log(share[:, :count]))  # G. Box, M. Muller, Ann. Math. Stat. 29 (1958)
    return (radius * sincos(2.0 * np.pi * share[:, count:])[1]).reshape(-1, *shape) * deviation


def _mixed(z: Any) -> Any:
    """Scatter whole numbers over 64 bits."""
    with np.errstate(over="ignore"):
        z = z + np.uint64(GOLDEN)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(MIX[0])
        z = (z ^ (z >> np.uint64(27))) * np.uint64(MIX[1])
        return z ^ (z >> np.uint64(31))


def resolved(scene: CompiledScene, what: Any, who: str = "observe") -> Any:
    """Return the sensor of a scene that has a name; a channel, a sensor of `NAMED` and a sensor itself as they are.

    Raises ValueError for a name of nothing.
    """
    if isinstance(what, SampledSensor) and isinstance(what.sensor, str):
        inner = resolved(scene, what.sensor, who)
        if isinstance(inner, SampledSensor):
            raise ValueError(f"sampled sensor {what.name!r}: {what.sensor!r} is sampled already: change the model's")
        return what if isinstance(inner, str) else replace(what, sensor=inner)
    own = scene.sensors
    if isinstance(what, str) and what in own:
        return resolved(scene, own[what], who)
    if not isinstance(what, str) or what in NAMED or what in RECORDABLE:
        return what
    known = ", ".join((*RECORDABLE, *NAMED, *own))
    raise ValueError(f"{who}: there is no channel or sensor {shown(what)}; there are {known}")


def found(what: What, who: str = "observe") -> tuple[Callable[..., Any], tuple[str, ...]]:
    """Return what computes the exact readings (samples, ...) from scene and channels, and the channels it needs.

    Raises ValueError for what is no sensor and no channel.
    """
    sensor = what.sensor if isinstance(what, SampledSensor) else what
    if isinstance(sensor, OBJECTS):
        function, needed = KINDS[type(sensor)]
        return lambda scene, channels: function(scene, channels, sensor), needed
    if isinstance(sensor, str) and sensor in NAMED:
        if isinstance(what, SampledSensor) and sensor == "sole_forces":
            raise ValueError("sampled sensor: sole_forces are several arrays, by link; give a channel, or a sensor")
        return NAMED[sensor]
    if isinstance(sensor, str) and sensor in RECORDABLE:
        return lambda scene, channels: channels[sensor], (sensor,)
    known = ", ".join((*RECORDABLE, *NAMED))
    raise ValueError(f"{who}: there is no channel or sensor {shown(what)}; there are {known}")


def here(scene: CompiledScene, what: What) -> tuple[str, ...]:
    """Return the channels of those that a sensor needs that a scene has, or the one that it is."""
    needed, acts, has = found(what)[1], scene.constants, {"base": scene.tree.floating}
    inner = what.sensor if isinstance(what, SampledSensor) else what
    if isinstance(inner, str) and inner not in NAMED:
        return needed
    has |= {"contact": acts.contact is not None, "pair": acts.pairs is not None}
    return tuple(name for name in needed if has.get(name.partition("_")[0], True))


def name_of(what: Any) -> Any:
    """Return the name under which a channel or a sensor is observed and recorded."""
    return what.name if isinstance(what, OBJECTS) else what


def check_names(given: Iterable[Any], who: str) -> tuple[Any, ...]:
    """Return channels and sensors; raise ValueError for sensors called alike, or as what every scene has."""
    given = tuple(given)
    names = [one.name for one in given if isinstance(one, OBJECTS)]
    for name in names:
        check_name(who, name)
    if len(set(names)) < len(names):
        raise ValueError(f"{who}: two have the same name; the sensors are called {', '.join(names)}")
    return given


class Chosen(NamedTuple):
    """What is to be recorded."""

    channels: tuple[str, ...] | None  # with those that sensors need; None for the usual ones
    kept: frozenset[str]  # those of the channels that stay
    sensors: list[What]


def split(scenes: Sequence[CompiledScene], record: Iterable[Any] | None) -> Chosen:
    """Sort a `record` into channels and sensors; raise ValueError for sensors that it cannot have."""
    if record is None or isinstance(record, str):
        return Chosen(record, frozenset(), [])  # type: ignore[arg-type]
    given = listed("record", record, "give a list of channels, such as ('q', 'qd')")
    if scenes and isinstance(scenes[0], CompiledScene):
        given = [resolved(scenes[0], one, "record") for one in given]
    chosen = [one for one in given if isinstance(one, OBJECTS) or (isinstance(one, str) and one in NAMED)]
    if not chosen:
        return Chosen(tuple(given), frozenset(), [])
    check_names(given, "record")
    if "sole_forces" in chosen:
        raise ValueError("record: sole_forces are several arrays, by link; record contact_force, and call sole_forces")
    channels = [one for one in given if one not in chosen]
    needed = [name for one in chosen for scene in scenes for name in here(scene, one)]
    kept = frozenset(one for one in channels if isinstance(one, str))
    return Chosen(tuple(dict.fromkeys([*channels, *needed])), kept | {"time"}, chosen)


def with_readings(scene: CompiledScene, run: Trajectory, chosen: Chosen, robot: int = 0) -> Trajectory:
    """Return a run with what sensors have read, and without the channels that only they needed."""
    channels = {name: values for name, values in run.channels.items() if name in chosen.kept}
    channels |= {name_of(one): measure(scene, run, one, robot) for one in chosen.sensors}
    error = None if run.error is None else {name: x for name, x in run.error.items() if name in chosen.kept}
    return replace(run, channels=channels, error=error)
