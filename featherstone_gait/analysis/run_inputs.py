"""Parameters of a run, and the derivatives of its inputs by them.

A run is a function of its state at the start, the cubics of its signals, and the constants of its scene.  Cubics are
linear in the values at their knots, and so are states in their deviations, but for quaternions.  The constants are
functions of the physical numbers that `Worlds` names: these are differentiated by central differences

    D = (4 D(w/2) - D(w)) / 3

(L. F. Richardson, Phil. Trans. A 210 (1911)) of the constants alone; nothing is simulated for them.
"""

from __future__ import annotations

import weakref
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ..base.arguments import shown
from ..core.effects.actuator import controller_of
from ..core.effects.controller import PID_SPEED
from ..core.step.state import BY_NAME, IN_STATE, shaped
from ..run.adjoint import Adjoint
from ..run.lane_constants import structure
from ..run.program import CompiledController
from ..run.reference import Reference
from ..run.start import driven_lengths, initial_state
from ..run.trajectory import Trajectory
from ..run.worlds import FIELDS, WHOLE, Worlds, nominal
from ..scene.compile import CompiledScene
from .chart import chart_of

WIDTH = 1e-3  # of differences of constants, relative to a number; of one that is zero, to the largest beside it, or 1
# Shares of the width at which constants are computed, and what their changes from the middle count; the second of
# numbers at a limit, zero, to one side (fourth order too).
CENTRAL = np.array([1.0, -1.0, 0.5, -0.5]), np.array([-1.0, 1.0, 8.0, -8.0]) / 6.0
ONE_SIDED = np.array([0.25, 0.5, 0.75, 1.0]), np.array([48.0, -36.0, 16.0, -3.0]) / 3.0
COORDINATES = ("base_q", "base_qd", "q", "qd")  # whose deviations are not all numbers of the state
WHOLE_NAMES = ("state", "reference", "tau", "controller", "gravity")
COLUMNS = 256  # of the map from knots to cubics at a time

Key = tuple[tuple[str, ...], str | None]  # where numbers stand in the constants: fields, and one of the records


def check_names(scene: CompiledScene, names: Sequence[str]) -> None:
    """Raise ValueError for names that are no parameters of runs of the scene."""
    for name in names:
        first, _, rest = name.partition(".")
        if name in WHOLE_NAMES or rest.rpartition(".")[2] in FIELDS.get(first, ()):
            continue
        known = [channel.name for channel in IN_STATE if channel.kind in ("coordinates", "controlled", "held")]
        if first == "state" and rest in known and np.ptp(scene.part(rest)):
            continue
        here = ", ".join(one for one in known if np.ptp(scene.part(one)))
        raise ValueError(
            f"parameters: there is no {shown(name)}; use 'state', 'state.' and one of {here}, 'reference', 'tau', "
            f"'controller', 'gravity', or a number of Worlds with its section ({', '.join(FIELDS)}), as "
            "'ground.friction'"
        )


def is_number(name: str) -> bool:
    """Return whether a parameter is a physical number of the scene."""
    return name == "gravity" or name.partition(".")[0] in FIELDS


def number_of(scene: CompiledScene, name: str) -> np.ndarray:
    """Return a physical number of the scene in its own shape: (parts, ...), without the axis where one is named."""
    if name == "gravity":
        return np.array(scene.gravity, dtype=float)
    section, _, key = name.partition(".")
    numbers = nominal(scene, section, key)[1]
    return numbers[0] if section in WHOLE or "." in key else numbers


def scenes_with(scene: CompiledScene, numbers: Mapping[str, np.ndarray]) -> list[CompiledScene]:
    """Return the scenes with other physical numbers, each (runs, ...) in their own shape."""
    given: dict[str, Any] = {}
    for name, values in numbers.items():
        section, _, key = name.partition(".")
        if name == "gravity":
            given["gravity"] = values
        else:
            alone = section in WHOLE or "." in key
            given.setdefault(section, {})[key] = values[:, None] if alone else values
    return Worlds(runs=len(next(iter(numbers.values()))), **given).scenes(scene) if given else [scene]


def numbers_of(value: Any) -> np.ndarray:
    """Return the numbers of an input of a run: those at the knots of a signal, but the last of a cyclic one."""
    if isinstance(value, Reference):
        return value.values[: len(value.times) - bool(value.cyclic)]
    return np.asarray(value.final if isinstance(value, Trajectory) else value, dtype=float)


class Table(NamedTuple):
    """Derivatives of a scene's constants and of its initial state by a physical number."""

    shape: tuple[int, ...]
    columns: list[dict[Key, np.ndarray]]  # of each entry, by those constants that depend on it
    states: np.ndarray  # (entries, length) of the initial state
    others: list[CompiledScene]  # whose constants differ from the scene's in all that depends on the number
    at_limit: np.ndarray  # whether an entry is zero and may not be negative, in its shape


_tables: weakref.WeakKeyDictionary[CompiledScene, dict[str, Table]] = weakref.WeakKeyDictionary()


def table_of(scene: CompiledScene, name: str) -> Table:
    """Differentiate a scene's constants by a physical number; ValueError where they are no function of it."""
    kept = _tables.setdefault(scene, {})
    if name not in kept:
        kept[name] = _table(scene, name)
    return kept[name]


def _table(scene: CompiledScene, name: str) -> Table:
    numbers = number_of(scene, name)
    if not np.isfinite(numbers).all():
        raise ValueError(f"{scene.model.name}: {name} is {shown(numbers)}; derivatives need finite numbers: give some")
    flat, largest = numbers.ravel(), np.abs(numbers).max() or 1.0
    widths = WIDTH * np.where(flat == 0.0, largest, np.abs(flat))
    rules = [_rule(scene, name, numbers, k, width) for k, width in enumerate(widths)]
    values = [moved(flat, k, share * width) for k, width in enumerate(widths) for share in rules[k][0]]
    every = flat + widths * (1.0 - 0.1 * np.arange(len(widths)) / len(widths))  # all at once, unequally
    varied = _scenes_at(scene, name, np.array([*values, every]).reshape(-1, *numbers.shape))
    for one in varied:
        _check_alike(scene, one, name)
    base, columns, others, known = dict(leaves(scene.constants)), [], [varied[-1]], _changed(scene, varied[-1])
    states, start = np.zeros((len(widths), scene.layout["length"])), initial_state(scene)
    for k, (width, rule) in enumerate(zip(widths, rules)):
        four = varied[len(rule[0]) * k : len(rule[0]) * (k + 1)]
        each = [dict(leaves(one.constants)) for one in four]
        changed = [key for key in base if any(not np.array_equal(one[key], base[key], equal_nan=True) for one in each)]
        columns.append({key: slope([one[key] for one in each], base[key], width, rule) for key in changed})
        if not known.issuperset(changed):
            others.append(four[0])
            known.update(changed)
        states[k] = slope([initial_state(one) for one in four], start, width, rule)
    at_limit = np.array([rule is ONE_SIDED for rule in rules], dtype=bool).reshape(numbers.shape)
    return Table(numbers.shape, columns, states, others, at_limit)


def moved(x: np.ndarray, k: int, change: float) -> np.ndarray:
    """Return a copy of x in which one number is changed."""
    x = x.copy()
    x[k] += change
    return x


def _rule(scene: CompiledScene, name: str, numbers: np.ndarray, k: int, width: float) -> tuple[np.ndarray, np.ndarray]:
    """Return by which differences a number is differentiated: to one side where it is zero and may not be negative."""
    if numbers.flat[k] == 0.0:
        try:
            scenes_with(scene, {name: moved(numbers.ravel(), k, -width).reshape(1, *numbers.shape)})
        except ValueError:
            return ONE_SIDED
    return CENTRAL


def _scenes_at(scene: CompiledScene, name: str, values: np.ndarray) -> list[CompiledScene]:
    try:
        return scenes_with(scene, {name: values})
    except ValueError as error:
        raise ValueError(
            f"{scene.model.name}: {name} is differentiated by differences of {WIDTH:g} of its numbers, at which there "
            f"is no scene: give numbers farther from their limits; {error}"
        ) from error


def _changed(scene: CompiledScene, other: CompiledScene) -> set[Key]:
    base = dict(leaves(scene.constants))
    return {key for key, value in leaves(other.constants) if not np.array_equal(value, base[key], equal_nan=True)}


def _check_alike(scene: CompiledScene, other: CompiledScene, name: str) -> None:
    """Raise ValueError where a number changes more of a scene than numbers of its constants."""
    if structure(other.constants) != structure(scene.constants):
        raise ValueError(
            f"{scene.model.name}: {name} turns a part of the scene on or off; give a number at which it is on"
        )
    for what, own, of_other in (
        ("the step", scene.timestep, other.timestep),
        ("the steps between ticks", scene.tick_steps, other.tick_steps),
        ("the lag of controllers", scene.lag, other.lag),
        ("where trees stand", scene.places.tobytes(), other.places.tobytes()),
    ):
        if own != of_other:
            raise ValueError(f"{scene.model.name}: {name} changes {what}, by which there are no gradients; leave it")


def leaves(constants: Any, path: tuple[str, ...] = ("scene",)) -> Iterator[tuple[Key, np.ndarray]]:
    """Yield all real numbers of the constants, array by array and field by field."""
    if isinstance(constants, tuple):
        for name, each in zip(constants._fields, constants):  # type: ignore[attr-defined]
            yield from leaves(each, (*path, name))
    elif isinstance(constants, np.ndarray):
        names = constants.dtype.names
        parts = [(None, constants)] if names is None else [(name, constants[name]) for name in names]
        yield from (((path, name), np.asarray(part)) for name, part in parts if part.dtype.kind == "f")
    elif isinstance(constants, float):
        yield (path, None), np.asarray(constants)


def slope(
    each: Sequence[np.ndarray], middle: np.ndarray, width: float, rule: tuple[np.ndarray, np.ndarray] = CENTRAL
) -> np.ndarray:
    """Return the extrapolated difference of numbers at shares of the width; 0 of infinite ones that stay so."""
    total = np.zeros(np.shape(middle))
    for weight, one in zip(rule[1], each):
        total += weight / width * np.subtract(one, middle, out=np.zeros(np.shape(middle)), where=one != middle)
    return total


def memory_of(controller: CompiledController) -> np.ndarray:
    """Return the numbers with which the memory of a controller begins (memory,)."""
    return np.zeros(controller.memory) + controller.first_memory


def shape_of(
    scene: CompiledScene, name: str, reference: Any, tau: Any, controller: CompiledController | None = None
) -> tuple[int, ...]:
    """Return the shape of the derivatives by a parameter."""
    if name == "controller":
        if controller is None:
            raise ValueError("parameters: 'controller' is one, but none is given: give controller=...")
        return (controller.memory,)
    if name == "state":
        return (scene.layout["length"],)
    if name.startswith("state."):
        channel = name.removeprefix("state.")
        if channel in COORDINATES:
            return (len(chart_of(scene, (channel,)).names),)
        first, end = scene.part(channel)
        return shaped(BY_NAME[channel], np.zeros((1, end - first))).shape[1:]
    if is_number(name):
        return number_of(scene, name).shape
    signal = reference if name == "reference" else tau
    if signal is None:
        raise ValueError(f"parameters: {name!r} is one, but no {name} is given: give the values at which to differ")
    if not isinstance(signal, Reference):
        return np.shape(signal)
    return (len(signal.times) - bool(signal.cyclic), signal.values.shape[1])


class Pulled:
    """Derivatives of a run's cost by its inputs, and by parameters.

    adjoint: after its `pull`, which returned `by_state` (length,); given: the scene as it was given, of which a
    controller may drive another.
    """

    def __init__(self, adjoint: Adjoint, by_state: np.ndarray, given: CompiledScene) -> None:
        self.scene, self.start, self.given = adjoint.compiled.scene, adjoint.start, given
        self.by_state, self.by_key = by_state.copy(), {}
        self.cubics: dict[str, np.ndarray] = {}
        controller = adjoint.compiled.controller
        self.by_memory = adjoint.by_kept[: 0 if controller is None else controller.memory].copy()
        for slot in adjoint.slots:
            found = adjoint.derivative(slot)
            if slot.path[0] == "signals":
                self.cubics[slot.path[1]] = found.copy()
            else:
                self.by_key[slot.path, slot.name] = found
        self._of_first_error()

    def _of_first_error(self) -> None:
        """Take the derivative by the controllers' last error to what makes it at a first start: `with_first_error`."""
        scene, y = self.scene, self.start.y
        if not scene.sampled or "reference" not in self.cubics or y[scene.layout["end_time"]] > 0:
            return
        firmware, n = scene.constants.firmware, scene.tree.n
        error, q, qd = (slice(scene.layout[name], scene.layout[name] + n) for name in ("last_error", "q", "qd"))
        of_speed = controller_of(scene.constants.actuator).law == PID_SPEED
        by_error = self.by_state[error].copy()
        self.by_state[error] = 0.0
        if firmware.band is not None:  # within the margin the error is zero
            by_error *= y[error] != 0.0
            margin = (("scene", "firmware", "band"), "compliance_margin")
            if margin in self.by_key:
                self.by_key[margin] = self.by_key[margin] - np.sign(y[error]) * by_error
        self.by_state[q] -= np.where(of_speed, 0.0, by_error)
        self.by_state[qd] -= np.where(of_speed, by_error, 0.0)
        if firmware.profile is None:
            self.cubics["reference"][0, :n, 0] += np.where(of_speed, 0.0, by_error)
        else:
            self.by_state[slice(*scene.part("profiled_reference"))] += np.where(of_speed, 0.0, by_error)

    def hold(self, joints: bool) -> None:
        """Let the reference be what is there at the start: lengths of driven tendons, and joints if none is given."""
        if "reference" in self.cubics:
            first, end = self.scene.part("q")
            by_value = self.cubics["reference"][:, :, 0].sum(axis=0)
            if joints:
                self.by_state[first:end] += by_value[: end - first]
            if len(by_value) > end - first:
                self._hold_tendons(by_value[end - first :])

    def _hold_tendons(self, by_length: np.ndarray) -> None:
        y = self.start.y
        for name in ("base_q", "ball_q", "q"):
            for k in range(*self.scene.part(name)):
                each = [driven_lengths(self.scene, moved(y, k, share * WIDTH)) for share in CENTRAL[0]]
                self.by_state[k] += by_length @ slope(each, driven_lengths(self.scene, y), WIDTH)

    def by(self, name: str, reference: Any, tau: Any, given_state: bool) -> np.ndarray:
        """Return the derivative by a parameter in its own shape."""
        if name == "state":
            return self.by_state.copy()
        if name == "controller":
            return self.by_memory.copy()
        if name.startswith("state."):
            return self._by_channel(name.removeprefix("state."))
        if is_number(name):
            table = table_of(self.given, name)
            by_scene = [sum(float(np.sum(self.by_key[key] * d)) for key, d in one.items()) for one in table.columns]
            by_start = np.zeros(len(by_scene)) if given_state else np.sum(table.states * self.by_state, axis=1)
            return (np.array(by_scene) + by_start).reshape(table.shape)
        signal = reference if name == "reference" else tau
        found = by_knots(signal if isinstance(signal, Reference) else None, self.cubics[_SIGNALS[name]])
        shape = shape_of(self.scene, name, reference, tau)
        return found[:, : shape[-1]].reshape(shape)

    def _by_channel(self, name: str) -> np.ndarray:
        """Return the derivative by a channel of the state at the start, by deviations of coordinates (chart.py)."""
        if name in COORDINATES:
            return chart_of(self.scene, (name,)).pulled(self.start.y, self.by_state)
        first, end = self.scene.part(name)
        return shaped(BY_NAME[name], self.by_state[None, first:end])[0].copy()


_SIGNALS = {"reference": "reference", "tau": "torques"}


def by_knots(signal: Reference | None, by_cubics: np.ndarray) -> np.ndarray:
    """Return derivatives by the values at knots (k, n) from those by cubics.

    signal None: one constant value; of a cyclic signal those of the last knot are in the first (k - 1, n).
    """
    signal = Reference([0.0], [[0.0]]) if signal is None else signal
    count = len(signal.times) - bool(signal.cyclic)
    found = np.zeros((count, by_cubics.shape[1]))
    for first in range(0, count, COLUMNS):
        ones = np.eye(count)[:, first : first + COLUMNS]
        values = np.vstack([ones, ones[:1]]) if signal.cyclic else ones
        cubics = Reference(signal.times, values, signal.kind, signal.cyclic).knots().cubics
        found[first : first + COLUMNS] = np.einsum("pfc,pjc->fj", cubics, by_cubics)
    return found
