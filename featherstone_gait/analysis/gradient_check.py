"""Compare gradients with differences of whole runs: what changes of contacts leave out.

A run of soft contacts in fixed steps is a piecewise smooth function of what it starts from.  Its gradient is that of
the piece; what the cost jumps by from piece to piece is in no derivative.  A central difference over a width that
spans pieces has both.  Where the two disagree, an optimizer with steps of that width cannot trust the gradient.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ..core.step.state import IN_STATE
from ..run.program import CompiledController
from ..run.reference import Reference
from ..run.simulate import simulate_batch
from ..run.start import initial_state
from ..run.trajectory import Trajectory
from ..scene.compile import CompiledScene
from .chart import chart_of
from .run_inputs import COORDINATES, is_number, memory_of, number_of, numbers_of, scenes_with, shape_of, table_of

NOTABLE = 1e-3  # share of the largest part of the gradient below which no part is doubted


class Given(NamedTuple):
    """Inputs of one run, as arguments of `simulate`."""

    scene: CompiledScene
    state: Any = None
    reference: Reference | None = None
    tau: Any = None
    controller: CompiledController | None = None


class How(NamedTuple):
    """Arguments that all runs share."""

    duration: float
    pushes: Sequence[Any]
    record: Any
    record_interval: float | None


class GradientCheck(NamedTuple):
    """A gradient beside differences of whole runs.

    Attributes
    ----------
    slope : float
        How fast the cost grows along the gradient by its derivatives, for parameters in units of their scales.
    difference : float
        The same by a central difference of two runs.
    agrees : bool
        Whether they differ by less than the tolerance of the larger, and no derivative that was compared by itself is
        doubtful.
    differences : dict of ndarray
        Central differences by each parameter, in its shape; nan by numbers that are zero and may not be negative, and
        of a whole state by all but coordinates, currents, rotors, filters and deflections.  Empty where the two agree,
        unless they were asked for.
    doubtful : dict of ndarray
        Which of the derivatives differ by more than the tolerance from them; all False where the two agree.
    """

    slope: float
    difference: float
    agrees: bool
    differences: dict[str, np.ndarray]
    doubtful: dict[str, np.ndarray]


def compare(
    given: Given,
    derivatives: Mapping[str, np.ndarray],
    values: Callable[[list[Given]], np.ndarray],
    width: float,
    tolerance: float,
    each: bool,
) -> GradientCheck:
    """Compare derivatives of a run with differences over a share `width` of the parameters' scales."""
    scales = {name: scale_of(given, name) for name in derivatives}
    scaled = np.concatenate([(scales[name] * found).ravel() for name, found in derivatives.items()])
    slope = float(np.sqrt(np.sum(scaled * scaled)))
    unit = scaled / slope if slope > 0.0 else scaled
    ends = {name: width * scales[name] * step for name, step in in_shape(unit, derivatives).items()}
    up, down = values([moved_by(given, ends, sign) for sign in (1.0, -1.0)])
    difference = float(up - down) / (2.0 * width)
    agrees = slope > 0.0 and abs(difference - slope) <= tolerance * max(abs(difference), slope)
    differences: dict[str, np.ndarray] = {}
    doubtful = {name: np.zeros(found.shape, dtype=bool) for name, found in derivatives.items()}
    if each or not agrees:
        differences = _of_each(given, scales, values, width)
        least = NOTABLE * np.abs(scaled).max(initial=0.0)
        for name, found in derivatives.items():
            own, other = scales[name] * found, scales[name] * differences[name]
            larger = np.maximum(np.abs(own), np.abs(other))
            near = (np.abs(own - other) <= tolerance * larger) | (larger <= least)
            doubtful[name] = ~near & (scales[name] > 0.0)  # nan too: a run on one side has failed
        none = not any(each_one.any() for each_one in doubtful.values())
        agrees = none and (agrees or slope == 0.0)
    return GradientCheck(slope, difference, agrees, differences, doubtful)


def _of_each(
    given: Given, scales: Mapping[str, np.ndarray], values: Callable[[list[Given]], np.ndarray], width: float
) -> dict[str, np.ndarray]:
    """Return central differences by each parameter, in its shape."""
    runs = []
    for name, scale in scales.items():
        for k in np.flatnonzero(scale):
            step = np.zeros(scale.size)
            step[k] = width * scale.flat[k]
            runs += [moved_by(given, {name: step.reshape(scale.shape)}, sign) for sign in (1.0, -1.0)]
    found, differences, at = values(runs).reshape(-1, 2), {}, 0
    for name, scale in scales.items():
        differences[name], moved = np.full(scale.shape, np.nan), scale > 0.0  # what does not move has no difference
        ends, at = found[at : at + moved.sum()], at + int(moved.sum())
        differences[name][moved] = (ends[:, 0] - ends[:, 1]) / (2.0 * width * scale[moved])
    return differences


def in_shape(numbers: np.ndarray, like: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Cut numbers (n,) into those of each parameter, in its shape."""
    ends = np.cumsum([one.size for one in like.values()])
    return {name: one.reshape(like[name].shape) for name, one in zip(like, np.split(numbers, ends[:-1]))}


def scale_of(given: Given, name: str) -> np.ndarray:
    """Return the scale of each number of a parameter: its size, of zeros the largest one's; of others 1 in its unit.

    What is zero and may not be negative has the scale 0: it does not move.
    """
    if name == "state":  # of which only what moves is moved
        moving = np.zeros(_shape(given, name))
        for channel in IN_STATE:
            if channel.kind in ("coordinates", "controlled"):
                moving[slice(*given.scene.part(channel.name))] = 1.0
        return moving
    if not is_number(name):
        return np.ones(_shape(given, name))
    size = np.abs(number_of(given.scene, name))
    found = np.where(size > 0.0, size, size.max() or 1.0)
    return np.where(table_of(given.scene, name).at_limit, 0.0, found)


def _shape(given: Given, name: str) -> tuple[int, ...]:
    return shape_of(given.scene, name, given.reference, given.tau, given.controller)


def moved_by(given: Given, ends: Mapping[str, np.ndarray], sign: float = 1.0) -> Given:
    """Return what a run is given whose parameters are moved."""
    numbers = {
        name: (number_of(given.scene, name) + sign * step)[None] for name, step in ends.items() if is_number(name)
    }
    scene = scenes_with(given.scene, numbers)[0]
    moved = given._replace(scene=scene)
    for name, step in ends.items():
        if name in ("reference", "tau"):
            moved = moved._replace(**{name: _signal_moved(getattr(given, name), sign * step)})
        elif name == "controller":
            moved = moved._replace(controller=with_memory(given.controller, sign * step))
        elif name.startswith("state"):
            y = initial_state(scene) if moved.state is None else numbers_of(moved.state)
            moved = moved._replace(state=_state_moved(scene, y.copy(), name, sign * step))
    return moved


def with_memory(controller: CompiledController | None, step: np.ndarray) -> CompiledController:
    """Return a controller whose memory begins with other numbers."""
    assert controller is not None
    return controller.beginning_with(memory_of(controller) + step)


def _signal_moved(signal: Any, step: np.ndarray) -> Any:
    if not isinstance(signal, Reference):
        return np.asarray(signal) + step
    step = np.vstack([step, step[:1]]) if signal.cyclic else step
    return Reference(signal.times, signal.values + step, signal.kind, signal.cyclic)


def _state_moved(scene: CompiledScene, y: np.ndarray, name: str, step: np.ndarray) -> np.ndarray:
    channel = name.removeprefix("state").removeprefix(".")
    if channel in COORDINATES:
        return chart_of(scene, (channel,)).moved(y, step[:, None])[:, 0]
    first, end = scene.part(channel) if channel else (0, len(y))
    y[first:end] += step.ravel()
    return y


def values_of(cost: Callable[..., Any], how: How, runs: list[Given]) -> np.ndarray:
    """Return the costs of runs, eight to a vector; infinite of those that end before their time."""
    found: list[Trajectory] = simulate_batch(
        [run.scene for run in runs], how.duration, [run.state for run in runs], [run.reference for run in runs],
        [run.tau for run in runs], how.pushes, how.record, how.record_interval, estimate_error=False,
        controller=[run.controller for run in runs] if any(run.controller for run in runs) else None,
    )  # fmt: skip
    return np.array([np.inf if run.failed else float(cost(run.channels)[0]) for run in found])
