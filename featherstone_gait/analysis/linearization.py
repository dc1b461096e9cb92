"""Linearize a scene about a state: the matrices of a step or of a controller period for small deviations.

    x[k+1] = A x[k] + B u[k],    y[k+1] = C x[k] + D u[k]

x are deviations from the given state, u those of references or torques, y those of recorded channels, all at the end of
the period.  The matrices contain everything that a step does: servos with their ticks, friction, contact and its
tangential deflection.

Deviations are independent ones: see `chart.py`.  They are differences of whole runs, eight runs to a vector.
Each column has central differences D(w) and D(w/2), whose errors fall with w^2:

    D = (4 D(w/2) - D(w)) / 3,    error <= |D(w/2) - D(w)| / 3 + rounding,

where the error is that of D(w/2) (L. F. Richardson, Phil. Trans. A 210 (1911)).  Columns for which that is not enough
are computed again with smaller widths, and each entry is kept from the width with the least error.  At a discontinuity,
such as a contact that just closes or a voltage at its limit, the differences to the left and to the right disagree for
any width: both are kept, as a `Discontinuity`.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import listed, one_of, truth, vector, whole
from ..base.brief import brief
from ..core.compile.lanes import WIDTH
from ..core.step.state import BY_NAME, IN_STATE, RECORDABLE
from ..run.prepare import prepare, with_steps, with_tolerance
from ..run.reference import Reference
from ..run.start import check_scene, columns_of
from ..run.trajectory import Trajectory
from ..scene.compile import CompiledScene
from ..scene.friction import sticks
from .chart import AnyChart, ClosedChart, beside, chart_of, coordinates_of, width_of
from .period_runs import PeriodRuns
from .tangents import tangent_columns

INPUTS = ("reference", "torque", "voltage")
KINDS = ("coordinates", "controlled")  # of channels that always count
MEMORY = ("held", "derived")  # of those that count where the next state depends on them
FIXED = ("pair", "pair_feature", "loop_closed", "loop_place")  # which contacts and loops there are stays as it is
RTOL = 1e-12  # of an integrator with error control, whose errors differ from run to run

FINER, ROUNDS = 8.0, 3  # ratio of the widths of one round to those of the next
ENOUGH = 1e-7  # relative error of an entry at which no smaller width is tried ...
SMALL = 1e-2  # ... relative to at least so much of the largest entry of its row, in units of the first widths
JUMP = 1e-3  # difference of left and right, relative to the larger of them, that is a discontinuity
ROUNDING = 4.0 * np.finfo(float).eps  # of the numbers of a run


class Discontinuity(NamedTuple):
    """A column in which the derivatives to the left and to the right differ.

    Attributes
    ----------
    column : str
        Name of the state or input.
    rows : tuple of str
        Names of the states and outputs whose derivatives differ.
    left, right : ndarray
        Derivatives (rows,) to either side.
    """

    column: str
    rows: tuple[str, ...]
    left: np.ndarray
    right: np.ndarray

    def __repr__(self) -> str:
        return brief(self)


@dataclass(frozen=True, eq=False)
class Linearization:
    """A linear model made by `linearize`, of n states, m inputs and p outputs.

    Attributes
    ----------
    A, B, C, D : ndarray
        Matrices (n, n), (n, m), (p, n) and (p, m).
    A_error, B_error, C_error, D_error : ndarray
        Largest possible error of each entry; at a discontinuity half of the difference between left and right.
    states, inputs, outputs : tuple of str
        Names of states, inputs and outputs.
    discontinuities : tuple of Discontinuity
        Columns in which the derivatives to the left and to the right differ.
    change : ndarray
        What the period does to the state itself (n,); zero at an equilibrium.
    period : float
        Length of the period [s].
    state : ndarray
        State (size,) from which deviations are counted.
    chart : Chart
        How deviations move a state and are read from it.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    A_error: np.ndarray
    B_error: np.ndarray
    C_error: np.ndarray
    D_error: np.ndarray
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    discontinuities: tuple[Discontinuity, ...]
    change: np.ndarray
    period: float
    state: np.ndarray
    chart: AnyChart = field(repr=False)

    __repr__ = brief

    def deviation(self, state: ArrayLike | Trajectory) -> np.ndarray:
        """Return the deviations x (n,) of a state (size,), or of the end of a trajectory."""
        y = state.final if isinstance(state, Trajectory) else vector("state", state, len(self.state))
        return self.chart.difference(y[:, None], self.state)[:, 0]

    def moved(self, x: ArrayLike) -> np.ndarray:
        """Return the state (size,) at the deviations x (n,)."""
        return self.chart.moved(self.state, vector("x", x, len(self.states))[:, None])[:, 0]

    def of(self, *channels: str) -> np.ndarray:
        """Return the indices of the states of some channels, such as "q"; ValueError for unknown channels."""
        for name in channels:
            one_of("channel", name, dict.fromkeys(state.split()[0] for state in self.states))
        return np.array([k for k, state in enumerate(self.states) if state.split()[0] in channels], dtype=int)


def linearize(
    scene: CompiledScene,
    state: ArrayLike | Trajectory | None = None,
    reference: ArrayLike | Reference | None = None,
    tau: ArrayLike | Reference | None = None,
    *,
    inputs: Sequence[str] | None = None,
    outputs: Iterable[str] = (),
    states: Iterable[str] | None = None,
    steps: int | None = None,
    rtol: float | None = None,
    threads: int | None = None,
    exact: bool = False,
) -> Linearization:
    """Linearize a scene about a state, over one controller period or a number of steps.

    Parameters
    ----------
    scene
        A compiled scene.
    state, reference, tau
        As in `simulate`; a reference may also be joint positions (joints,).  The run goes on from the state, so that
        the midpoint rule does not begin with Euler's step.
    inputs
        Some of "reference" (what controllers see at the tick with which the period begins, or continuous servos
        throughout), "torque" from outside, and "voltage" (held, and no controller acts).  None: "reference" where there
        are servos, else "torque".
    outputs
        Channels of `simulate`, at the end of the period.
    states
        Channels of the state.  None: coordinates, currents, rotors, filters and tangential deflections, and what else
        the next state depends on (integrals, last errors, accelerations of the midpoint rule).  Between bodies the
        points that touch stay the same; each bristle, `pair_deflection`, has three numbers in the axes of its second
        body, and along the normal of the contact the motion has a discontinuity.
    steps
        Number of steps.  None: a controller period, or one step of a scene without controllers.
    rtol
        Tolerance of an integrator that chooses its steps, 1e-12 if None; its choice causes errors of some rtol / width.
    threads
        Number of threads; results do not depend on it.  None: as many as pay off, at most one for each core.
    exact
        True: derivatives by tangents, exact to rounding, of an integrator of fixed steps.  Differences then look for
        discontinuities alone.  The first call compiles as long as two kinds of runs take.

    Returns
    -------
    Linearization

    Raises
    ------
    ValueError
        If arguments do not fit the scene, or a run falls or diverges within the period.

    Examples
    --------
    >>> model = linearize(scene, trim(scene).state)
    >>> model.A[np.ix_(model.of("q"), model.of("qd"))]
    """
    check_scene(scene)
    scene, tolerance, _ = with_tolerance(scene, RTOL if rtol is None and scene.adaptive else rtol, None)
    named = _inputs(scene, inputs)
    period = scene.tick_steps if scene.sampled else 1
    steps = whole("steps", period if steps is None else steps, 1, "give a number of steps", 10**6)
    outputs = tuple(listed("outputs", outputs, "give a list of channels, such as ('torque',)"))
    for name in outputs:
        one_of("outputs", name, [known for known in RECORDABLE if BY_NAME[known].kind != "computed"])
    if "q" in outputs and scene.tree.balls is not None:
        name = scene.model.name
        raise ValueError(f"{name}: outputs: q has quaternions of ball joints; read its states, or give ball_q")
    threads = None if threads is None else whole("threads", threads, 1, "one a core is usual", 1024)
    duration = steps * scene.timestep
    truth("exact", exact)
    driven = tau is not None or "torque" in named
    compiled = with_steps(prepare(scene, duration, outputs, rtol=tolerance, driven=driven), steps, steps)
    tau = np.zeros(scene.tree.n) if tau is None and driven else tau
    signals = _signal(scene, "reference", reference), _signal(scene, "tau", tau)
    system = PeriodRuns(compiled, state, *signals, named, threads)
    channels = _channels(system, states, named)
    held = ("voltage",) if "voltage" in named else ()
    at = scene, tuple(channels), held
    chart = ClosedChart(*at, system.y) if scene.model.loops else chart_of(*at)
    try:
        return (_exact if exact else _differences)(system, chart, outputs, duration)
    finally:
        system.close()


def _inputs(scene: CompiledScene, inputs: Sequence[str] | None) -> tuple[str, ...]:
    """Return the kinds of inputs, checked against what the scene has."""
    actuated = scene.follows
    if inputs is None:
        return ("reference",) if actuated else ("torque",)
    named = tuple(listed("inputs", inputs, f"give some of {', '.join(INPUTS)}"))
    for name in named:
        one_of("inputs", name, INPUTS)
    name = scene.model.name
    if "reference" in named and not actuated:
        raise ValueError(f"{name}: inputs: a reference needs servos; compile the scene with servos, or take 'torque'")
    if "voltage" in named and (not scene.sampled or "reference" in named or scene.adaptive):
        raise ValueError(
            f"{name}: inputs: voltages stand where sampled servos have no references; take 'voltage' without "
            "'reference', in a scene of sampled servos with fixed steps"
        )
    return named


def _signal(scene: CompiledScene, name: str, value: ArrayLike | Reference | None) -> Reference | None:
    if value is None or isinstance(value, Reference):
        return value
    return Reference([0.0], vector(name, value, columns_of(scene, value), "one a joint, or a Reference")[None])


# ------------------------------------------------------------------------------------------------ channels


@functools.lru_cache(maxsize=128)
def _possible(scene: CompiledScene, inputs: tuple[str, ...]) -> tuple[list[str], list[str]]:
    """Return channels that always count, and those that count if the next state depends on them."""
    there = [c for c in IN_STATE if c.name not in inputs and scene.part(c.name)[1] > scene.part(c.name)[0]]
    memory = [c.name for c in there if c.kind in MEMORY and c.name not in FIXED]
    return [c.name for c in there if c.kind in KINDS], memory


def _channels(system: PeriodRuns, states: Iterable[str] | None, inputs: tuple[str, ...]) -> list[str]:
    """Return the channels of the states: those given, or those on which the next state depends."""
    always, memory = _possible(system.scene, inputs)
    if states is not None:
        known = [c.name for c in IN_STATE if c.name in (*always, *memory)]
        chosen = listed("states", states, "give a list of channels, such as ('q', 'qd')")
        for name in chosen:
            one_of("states", name, known)
        return [name for name in known if name in chosen]
    return [*always, *_remembered(system, tuple(always), tuple(memory))]


def _remembered(system: PeriodRuns, always: tuple[str, ...], memory: tuple[str, ...]) -> list[str]:
    """Find the held or derived channels on which the next state depends, by runs in which one of them is moved."""
    if not memory:
        return []
    scene, count = system.scene, len(memory) + 1
    states, signals = system.beginnings(count)
    for block in range(len(states)):
        states[block] += _uneven(scene, memory)[:, block * system.lanes :][:, : system.lanes]
    system.run(states, signals)
    ends = np.concatenate(list(states), axis=1)[:, :count]
    changed = ends[:, 1:] != ends[:, :1]
    touched = {name: changed[slice(*scene.part(name))].any(axis=0) for name in (*always, *memory)}
    kept, more = set[str](), set(always)
    while more:
        kept |= more
        more = {name for k, name in enumerate(memory) if any(touched[one][k] for one in kept - {name})} - kept
    return [name for name in memory if name in kept]


@functools.lru_cache(maxsize=128)
def _uneven(scene: CompiledScene, memory: tuple[str, ...]) -> np.ndarray:
    """Return moves of the states of runs: none in the first, then a channel each, and none in the last lanes."""
    size, found = scene.layout["length"], []
    for name in memory:
        chart = chart_of(scene, (name,))
        x = np.array(chart.widths) * (1.0 + 0.3 * np.arange(len(chart.names)) / len(chart.names))
        found.append(chart.moved(np.zeros(size), x[:, None]))
    return np.concatenate([np.zeros((size, 1)), *found, np.zeros((size, WIDTH))], axis=1)


# ------------------------------------------------------------------------------------------------ differences


MOVES = (1.0, -1.0, 0.5, -0.5)  # of a column, in its widths


class _Columns(NamedTuple):
    """Derivatives (rows, columns), and what is known of them."""

    value: np.ndarray
    error: np.ndarray
    left: np.ndarray
    right: np.ndarray
    jump: np.ndarray  # from left to right, the smallest of all widths
    noise: np.ndarray  # of left and right, by rounding


def _discontinuous(found: _Columns, least: np.ndarray) -> np.ndarray:
    """Find where left and right differ (rows, columns) for all widths; least: derivatives below it do not count."""
    largest = np.maximum(np.abs(found.left), np.abs(found.right))
    return found.jump > JUMP * np.maximum(largest, least) + found.noise


@functools.lru_cache(maxsize=128)
def _named(scene: CompiledScene, chart: AnyChart, signals: tuple[str, ...]) -> tuple[tuple[str, ...], np.ndarray]:
    """Return the names of all columns and their first widths."""
    sticky = sticks(scene.constants.friction, scene.constants.tendons)
    widths = [*chart.widths, *(width_of(scene, sticky, name.split()[0], "") for name in signals)]
    return (*chart.names, *signals), np.array(widths)


def _differences(system: PeriodRuns, chart: AnyChart, outputs: tuple[str, ...], period: float) -> Linearization:
    """Compute all columns, each with widths as small as it takes."""
    names, first = _named(system.scene, chart, tuple(system.signals))
    found, end = _columns(system, chart, np.arange(len(names)), first)
    least = SMALL * (np.abs(found.value) * first).max(axis=1, initial=0.0)[:, None] / first
    jumps = _discontinuous(found, least)
    for k in range(1, ROUNDS):
        bad = found.error > ENOUGH * np.maximum(np.abs(found.value), least)
        again = np.flatnonzero((bad | jumps).any(axis=0))
        if not len(again):
            break
        found = _better(found, again, _columns(system, chart, again, first[again] / FINER**k)[0])
        jumps = _discontinuous(found, least)
    found.error[jumps] = 0.5 * np.abs(found.right - found.left)[jumps]
    computed, every = (found.value, found.error, end), np.arange(len(names))
    return _model(system, chart, outputs, period, computed, (every, found, jumps))


def _exact(system: PeriodRuns, chart: AnyChart, outputs: tuple[str, ...], period: float) -> Linearization:
    """Compute all columns by tangents, and look by differences for those where left and right differ."""
    signals = {name: len(system.names(name)) for name in system.inputs if name != "voltage"}
    start = system.start._replace(y=system.y)
    if "voltage" in system.inputs:
        start = start._replace(reference=None)
    value, error, end = tangent_columns(system.compiled, start, chart, signals)
    _, first = _named(system.scene, chart, tuple(system.signals))
    which, least = _suspects(system, chart, first, value)
    found, jumps = None, np.zeros((len(value), 0), bool)
    for k in range(ROUNDS if len(which) else 0):
        new = _columns(system, chart, which, first[which] / FINER**k)[0]
        found = new if found is None else _better(found, np.arange(len(which)), new)
        jumps = _discontinuous(found, least[:, which])
    for k, j in enumerate(which):
        assert found is not None
        error[jumps[:, k], j] = 0.5 * np.abs(found.right - found.left)[jumps[:, k], k]
        value[jumps[:, k], j] = found.value[jumps[:, k], k]
    return _model(system, chart, outputs, period, (value, error, end), (which, found, jumps))


def _suspects(
    system: PeriodRuns, chart: AnyChart, widths: np.ndarray, value: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the columns in which a step to one side may differ from that to the other by more than it curves.

    Also derivatives (rows, columns) below which they do not count.
    """
    count, read = len(widths), system.compiled.channels
    states, moves = system.beginnings(2 * count + 1)
    steps = np.concatenate([widths, -widths])
    _move(chart, system.y, states, moves, np.tile(np.arange(count), 2), steps)
    system.run(states, moves)
    block, lane = divmod(2 * count, system.lanes)
    F, end = states.swapaxes(0, 1), states[block, :, lane].copy()
    moved = np.concatenate([chart.difference(F, end), F[read] - beside(end[read], F)]).reshape(len(value), -1)
    sides = moved[:, : 2 * count].reshape(-1, 2, count) / steps.reshape(2, count)
    least = SMALL * (np.abs(sides.mean(axis=1)) * widths).max(axis=1, initial=0.0)[:, None] / widths
    size = np.maximum(np.abs(value), least)
    which = np.flatnonzero((np.abs(sides - value[:, None]) > JUMP * size[:, None]).any(axis=(0, 1)))
    return which, least


def _model(
    system: PeriodRuns,
    chart: AnyChart,
    outputs: tuple[str, ...],
    period: float,
    computed: tuple[np.ndarray, np.ndarray, np.ndarray],
    jumping: tuple[np.ndarray, _Columns | None, np.ndarray],
) -> Linearization:
    """Assemble the linear model.

    computed: values (rows, columns), errors and the state at the end; jumping: the columns that were examined for
    discontinuities, their differences, and where (rows, columns) left and right differ.
    """
    (value, error, end), (which, found, jumps), n = computed, jumping, chart.states
    names, _ = _named(system.scene, chart, tuple(system.signals))
    labels = (*chart.names[:n], *_labels(system.scene, outputs, system.compiled.channels))
    discontinuities = []
    for k in np.flatnonzero(jumps.any(axis=0)):
        assert found is not None
        rows = np.flatnonzero(jumps[:, k])
        sides = found.left[rows, k], found.right[rows, k]
        discontinuities.append(Discontinuity(names[which[k]], tuple(labels[i] for i in rows), *sides))
    return Linearization(
        A=value[:n, :n], B=value[:n, n:], C=value[n:, :n], D=value[n:, n:],
        A_error=error[:n, :n], B_error=error[:n, n:], C_error=error[n:, :n], D_error=error[n:, n:],
        states=names[:n], inputs=names[n:], outputs=labels[n:],
        discontinuities=tuple(discontinuities), change=chart.difference(end, system.y), period=period, state=system.y,
        chart=chart,
    )  # fmt: skip


def _columns(system: PeriodRuns, chart: AnyChart, which: np.ndarray, widths: np.ndarray) -> tuple[_Columns, np.ndarray]:
    """Compute columns with a width each; return them and the end state (size,) of the run that nothing moves."""
    k, read = len(which), system.compiled.channels
    steps = np.multiply.outer(MOVES, widths)
    states, signals = system.beginnings(4 * k + 1)  # to the right, to the left, half of it; the last one stays
    _move(chart, system.y, states, signals, np.tile(which, 4), steps.ravel())
    system.run(states, signals)
    block, lane = divmod(4 * k, system.lanes)
    F, end = states.swapaxes(0, 1), states[block, :, lane].copy()
    moved = np.concatenate([chart.difference(F, end), F[read] - beside(end[read], F)])
    moved = moved.reshape(len(moved), -1)[:, : 4 * k].reshape(-1, 4, k)
    wide_right, wide_left, right, left = (moved / steps).transpose(1, 0, 2)
    wide, narrow = 0.5 * (wide_right + wide_left), 0.5 * (right + left)
    size = np.abs(np.concatenate([end[chart.reads], end[read]]))
    rounding = 2.0 * ROUNDING * size[:, None] / widths
    to_right, to_left = 2.0 * right - wide_right, 2.0 * left - wide_left
    correction = (narrow - wide) / 3.0
    value = narrow + correction
    found = _Columns(
        value=value,
        error=np.abs(correction) + rounding + ROUNDING * np.abs(value),
        left=to_left,
        right=to_right,
        jump=np.abs(to_right - to_left),
        noise=4.0 * rounding,
    )
    return found, end


def _move(
    chart: AnyChart, y: np.ndarray, states: np.ndarray, signals: np.ndarray, which: np.ndarray, steps: np.ndarray
) -> None:
    """Move states y (blocks, size, lanes) or their signals, each run in one column, which (k,), by a step (k,)."""
    chart.move_each(states, y, which, steps)
    run = np.flatnonzero(which >= len(chart.names))
    block, lane = np.divmod(run, states.shape[2])
    signals[block, which[run] - len(chart.names), lane] = steps[run]


def _better(found: _Columns, again: np.ndarray, new: _Columns) -> _Columns:
    """Merge columns computed again: each entry from where its error is least, left and right from the last width."""
    better = new.error < found.error[:, again]
    for old, now in zip(found[:2], new[:2]):
        old[:, again] = np.where(better, now, old[:, again])
    new = new._replace(jump=np.minimum(new.jump, found.jump[:, again]))
    for old, now in zip(found[2:], new[2:]):
        old[:, again] = now
    return found


def _labels(scene: CompiledScene, outputs: tuple[str, ...], read: np.ndarray) -> tuple[str, ...]:
    """Return the names of the recorded numbers."""
    by_place = {}
    for name in outputs:
        first, end = scene.part(name)
        if name == "base_q":
            labels = BY_NAME[name].labels
        elif name == "ball_q":
            labels = tuple(f"{ball}.q{label}" for ball in scene.model.ball_names for label in BY_NAME[name].labels)
        elif name in ("q", "qd", "qdd"):
            labels = scene.model.joint_names
        else:
            labels = tuple(label for label, _, _ in coordinates_of(scene, name))
        by_place.update({first + k: f"{name} {label}".strip() for k, label in enumerate(labels[: end - first])})
    return tuple(by_place[place] for place in read.tolist())
