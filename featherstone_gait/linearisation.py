"""A scene about a state as matrices: what a step or a controller period makes of small deviations.

    x[k+1] = A x[k] + B u[k],    y[k+1] = C x[k] + D u[k]

x are deviations from the state given, u those of references or torques, y those of recorded channels, all at the end of
the period.  Everything that a step does is in them: servos with their ticks, friction, contact and its bristles.

A floating base's quaternion has one number too many: its deviation is a rotation vector r [rad] in body axes, to first
order; of joints that follow others the leaders alone count.  Deviations are differences of whole runs, eight runs to a
vector: of each column the central differences D(w) and D(w/2), whose errors are as w^2, give

    D = (4 D(w/2) - D(w)) / 3,    error <= |D(w/2) - D(w)| / 3 + rounding,

the error being that of D(w/2) (L. F. Richardson, Phil. Trans. A 210 (1911)).  Columns in which that does not suffice
are taken again in smaller widths, and each entry is kept from where its error is least.  At a kink, such as a contact
that is just made or a voltage at its limit, the differences to the left and to the right disagree however small the
width: both are kept, as a `Kink`.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .arguments import listed, one_of, vector, whole
from .build.contact import by_body
from .build.friction import sticks
from .build.scene import CompiledScene
from .core.compile.lanes import WIDTH, aligned
from .core.integrate.rollout import OK, rollout_lanes
from .core.step.context import Run
from .core.step.signals import sample_ticks
from .core.step.state import BY_NAME, IN_STATE, RECORDABLE
from .dynamics import coupling_matrix
from .fixed_order import total
from .reference import Reference
from .run.prepared import Prepared, prepare, with_steps, with_tolerance
from .run.simulate import initial_state
from .run.start import check_scene
from .run.verdict import STATUS
from .trajectory import Trajectory

INPUTS = ("reference", "torque", "voltage")
KINDS = ("coordinates", "controlled")  # of channels that always count
MEMORY = ("held", "derived")  # of those that count where the next state depends on them
BASE = {"base_q": ("x", "y", "z", "rx", "ry", "rz"), "base_qd": ("vx", "vy", "vz", "wx", "wy", "wz")}
RTOL = 1e-12  # of an integrator with error control, whose errors differ from run to run

# The first width of a column: where nothing sticks, where joints do, and on the ground, by how much it moves a point.
SMOOTH, STICKING = 1e-4, 2e-6  # [rad, m, rad/s, m/s]
OF_SINKING, LEVER = 0.04, 0.2  # [-], [m]
OTHER = {"voltage": 100.0, "duty": 10.0, "bus": 100.0, "delayed": 100.0, "current": 10.0}  # [V, -, V, V, A] by these
BRISTLE = 1e-6  # [m]
FINER, ROUNDS = 8.0, 3  # each round's widths by the next one's
ENOUGH = 1e-7  # error of an entry, of its value, at which no smaller width is tried ...
SMALL = 1e-2  # ... or of so much of what is largest in its row, in units of the first widths
KINK = 1e-3  # difference of left and right, of the larger of them, that is a kink
ROUNDING = 4.0 * np.finfo(float).eps  # of the numbers of a run


class Kink(NamedTuple):
    """A column in which the derivatives to the left and to the right differ."""

    column: str  # state or input
    rows: tuple[str, ...]  # states and outputs that have the kink
    left: np.ndarray  # (rows,) derivatives
    right: np.ndarray  # (rows,)


@dataclass(frozen=True, eq=False)
class Linearisation:
    """What `linearise` found; n states, m inputs, p outputs, all named.

    An error is the largest that an entry may have; at a kink it is half of what left and right differ by.
    """

    A: np.ndarray  # (n, n)
    B: np.ndarray  # (n, m)
    C: np.ndarray  # (p, n)
    D: np.ndarray  # (p, m)
    A_error: np.ndarray  # of the entries
    B_error: np.ndarray
    C_error: np.ndarray
    D_error: np.ndarray
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    kinks: tuple[Kink, ...]
    change: np.ndarray  # (n,) what the period does to the state itself; zero at an equilibrium
    period: float  # [s]
    state: np.ndarray  # (size,) that deviations are counted from
    chart: Chart

    def deviation(self, state: ArrayLike | Trajectory) -> np.ndarray:
        """x (n,) of a state (size,), or of the end of a trajectory."""
        y = state.final if isinstance(state, Trajectory) else vector("state", state, len(self.state))
        return self.chart.difference(y[:, None], self.state)[:, 0]

    def moved(self, x: ArrayLike) -> np.ndarray:
        """The state (size,) at the deviations x (n,)."""
        return self.chart.moved(self.state, vector("x", x, len(self.states))[:, None])[:, 0]

    def of(self, *channels: str) -> np.ndarray:
        """Which states are those of some channels, such as "q": their indices.  ValueError for others."""
        for name in channels:
            one_of("channel", name, dict.fromkeys(state.split()[0] for state in self.states))
        return np.array([k for k, state in enumerate(self.states) if state.split()[0] in channels], dtype=int)


def linearise(
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
) -> Linearisation:
    """The matrices of one controller period, or of so many steps, about a state.

    state, reference, tau: as `simulate`, a reference may be (joints,) angles too; the run is taken to go on from there,
    so that the midpoint rule does not begin with Euler's step;
    inputs: some of "reference" (what the controllers see at the tick with which the period begins, or a continuous
    servo throughout), "torque" from outside, and "voltage" (held, and no controller acts); None is the first where
    there are servos, else the second;
    outputs: channels of `simulate`, as they are at the end of the period;
    states: channels of the state; None: coordinates, currents, rotors, filters and bristles, and of what else is
    remembered (integrals, last errors, the midpoint rule's accelerations) what the next state depends on;
    steps: None is a whole controller period, of a scene without controllers a single step;
    rtol: of an integrator that chooses its steps, 1e-12 if None; their choice is an error of some rtol by width;
    threads: one a core if None; any number gives the same bits.
    Raises ValueError on what does not fit, and where a run falls or diverges within the period.
    """
    check_scene(scene)
    scene, tolerance, _ = with_tolerance(scene, RTOL if rtol is None and scene.adaptive else rtol, None)
    named = _inputs(scene, inputs)
    steps = whole("steps", _default_steps(scene) if steps is None else steps, 1, "give a number of steps", 10**6)
    outputs = tuple(listed("outputs", outputs, "give a list of channels, such as ('torque',)"))
    threads = whole("threads", os.cpu_count() or 1 if threads is None else threads, 1, "one a core is usual")
    duration = steps * scene.timestep
    driven = tau is not None or "torque" in named
    ready = prepare(scene, duration, _recorded(outputs), rtol=tolerance, driven=driven)
    ready = with_steps(ready, steps, steps)
    system = _System(ready, state, _signal(scene, "reference", reference), _torques(scene, tau, driven), named, threads)
    channels = _channels(system, states, named)
    held = ("voltage",) if "voltage" in named else ()
    chart = chart_of(scene, tuple(channels), held)
    return _differences(system, chart, outputs, duration)


def _inputs(scene: CompiledScene, inputs: Sequence[str] | None) -> tuple[str, ...]:
    """The kinds of inputs, checked against what the scene has."""
    actuated = scene.constants.actuator is not None
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


def _default_steps(scene: CompiledScene) -> int:
    return scene.tick_steps if scene.sampled else 1


def _recorded(outputs: tuple[str, ...]) -> tuple[str, ...]:
    for name in outputs:
        one_of("outputs", name, [known for known in RECORDABLE if BY_NAME[known].kind != "computed"])
    return outputs


def _signal(scene: CompiledScene, name: str, value: ArrayLike | Reference | None) -> Reference | None:
    if value is None or isinstance(value, Reference):
        return value
    return Reference([0.0], vector(name, value, scene.tree.n, "one a joint, or a Reference")[None])


def _torques(scene: CompiledScene, tau: ArrayLike | Reference | None, driven: bool) -> Reference | None:
    return _signal(scene, "tau", np.zeros(scene.tree.n) if tau is None and driven else tau)


# ------------------------------------------------------------------------------------------------ states as vectors


class Chart:
    """Deviations of a state: which numbers of it they move, and how they are read off again."""

    def __init__(self, scene: CompiledScene, channels: Sequence[str], held: Sequence[str] = ()) -> None:
        """channels: of the states; held: of what follows them, moved but no states."""
        self.channels = (*channels, *held)
        self.names: list[str] = []
        self.widths: list[float] = []
        self.quaternion = scene.part("base_q")[0] + 3 if "base_q" in channels and scene.tree.floating else None
        self.turns: list[int] = []
        reads: list[int] = []
        moves: list[tuple[int, int, float]] = []  # number of the state, deviation, factor
        self.states, sticky = 0, sticks(scene.constants.friction)
        for name in self.channels:
            for label, at, moved in _coordinates(scene, name):
                k = len(self.names)
                self.names.append(f"{name} {label}".strip())
                self.widths.append(_width(scene, sticky, name, label))
                reads.append(at)
                moves.extend((number, k, factor) for number, factor in moved)
                if not moved:
                    self.turns.append(k)
            if name in channels:
                self.states = len(self.names)
        self._reads = np.array(reads, dtype=int)
        self._moves = [np.array(column) for column in zip(*moves)] if moves else [np.zeros(0, int)] * 3

    def moved(self, y: np.ndarray, x: np.ndarray) -> np.ndarray:
        """States (size, k) at the deviations x (states, k) from y (size,)."""
        Y = np.repeat(y[:, None], x.shape[1], axis=1)
        numbers, columns, factors = self._moves
        kept = columns < len(x)
        Y[numbers[kept]] += factors[kept, None] * x[columns[kept]]
        if self.quaternion is not None:
            at = slice(self.quaternion, self.quaternion + 4)
            Y[at] = _turned(y[at], x[self.turns])
        return Y

    def difference(self, Y: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Deviations (all, k) of the states Y (size, k) from y (size,)."""
        X = Y[self._reads] - y[self._reads, None]
        if self.quaternion is not None:
            at = slice(self.quaternion, self.quaternion + 4)
            X[self.turns] = _turn_between(y[at], Y[at])
        return X[: self.states]


@functools.lru_cache(maxsize=128)
def chart_of(scene: CompiledScene, channels: tuple[str, ...], held: tuple[str, ...] = ()) -> Chart:
    """The `Chart` of a scene's channels."""
    return Chart(scene, channels, held)


def _coordinates(scene: CompiledScene, name: str) -> list[tuple[str, int, list[tuple[int, float]]]]:
    """Of each deviation of a channel its label, the number that reads it, and those that it moves, with factors.

    A turn of the base moves none: see `_turned`.
    """
    first, end = scene.part(name)
    joints = scene.model.joint_names
    if name in BASE and end > first:
        turn = (3, 4, 5) if name == "base_q" else ()
        return [(label, first + k, [] if k in turn else [(first + k, 1.0)]) for k, label in enumerate(BASE[name])]
    if name in ("q", "qd", "qdd"):
        G = coupling_matrix(scene.model).matrix[scene.model.nv - len(joints) :, scene.model.nv - len(joints) :]
        leading = []
        for column in G.T:
            moved = [(first + int(k), float(column[k])) for k in np.flatnonzero(column)]
            leader = next(number for number, factor in moved if factor == 1.0)
            leading.append((joints[leader - first], leader, moved))
        return leading
    channel, width = BY_NAME[name], BY_NAME[name].width
    labels: list[str] = [str(k) for k in range((end - first) // width)]
    if len(labels) == len(joints) and channel.of != "point":
        labels = list(joints)
    if channel.of == "point":
        order = by_body(scene.model, scene.tree)
        labels = [f"{scene.model.contacts[k].link} {k}" for k in order]
    if channel.of in ("run", "source"):
        labels = [""] * len(labels)
    parts = channel.labels if width > 1 else ("",)
    found = [f"{label} {part}".strip() for label in labels for part in parts]
    return [(label, first + k, [(first + k, 1.0)]) for k, label in enumerate(found)]


def _width(scene: CompiledScene, sticky: bool, name: str, label: str) -> float:
    """The first width of a deviation: what sticks must go on to do so, and contacts must stay as they are."""
    if name == "bristle":
        return BRISTLE
    width = STICKING if sticky else SMOOTH
    if scene.ground is not None:
        slip = OF_SINKING * scene.ground.sinking
        width = min(width, slip if label in ("x", "y", "z") else slip / LEVER)
    return width * OTHER.get(name, 1.0)


def _turned(quaternion: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Unit quaternions w x y z (4, k) after turns (3, k) in body axes: r / 2 is the tangent of half the angle."""
    w, x, y, z = quaternion
    a, b, c = 0.5 * turn
    new = np.stack([w - x * a - y * b - z * c, x + w * a + y * c - z * b, y + w * b + z * a - x * c,
                    z + w * c + x * b - y * a])  # fmt: skip
    return new / np.sqrt(total(new * new, axis=0))


def _turn_between(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The turns (3, k) in body axes from a quaternion (4,) to others (4, k); the inverse of `_turned`."""
    w, x, y, z = start
    a, b, c, d = end
    real = w * a + x * b + y * c + z * d
    return 2.0 * np.stack([w * b - x * a - y * d + z * c, w * c - y * a - z * b + x * d,
                           w * d - z * a - x * c + y * b]) / real  # fmt: skip


# ------------------------------------------------------------------------------------------------ runs


class _System:
    """The map from states and inputs to states at the end of the period."""

    def __init__(
        self,
        ready: Prepared,
        state: ArrayLike | Trajectory | None,
        reference: Reference | None,
        tau: Reference | None,
        inputs: tuple[str, ...],
        threads: int,
    ) -> None:
        self.ready, self.inputs, self.threads, self.scene = ready, inputs, threads, ready.scene
        self.start = ready.start(initial_state(ready.scene) if state is None else state, reference, tau)
        self.course = ready.course(self.start)
        self.y = self.start.y.copy()
        self._maps: list[Callable[[np.ndarray, np.ndarray], np.ndarray]] = []  # one a thread
        o = self.scene.layout
        self.y[o["end"]] = max(self.y[o["end"]], self.scene.timestep)  # it goes on: no first step
        if self.y[o["status"]] != OK:
            raise ValueError(f"{self.scene.model.name}: state: that run has ended; give the state of a sound one")

    def signals(self) -> list[str]:
        """Of each input that is a signal its name."""
        joints = self.scene.model.joint_names
        return [f"{name} {joint}" for name in self.inputs if name != "voltage" for joint in joints]

    def ends(self, Y: np.ndarray, U: np.ndarray) -> np.ndarray:
        """States (size, k) at the end of runs from Y (size, k), signals beside their own by U (signals, k)."""
        size, count = 1 if self.scene.adaptive else WIDTH, Y.shape[1]
        blocks = -(-count // size)
        states, signals = (_blocks(part, blocks, size) for part in (Y, U))
        threads = min(self.threads, blocks)
        while len(self._maps) < threads:
            self._maps.append(_one(self) if self.scene.adaptive else _eight(self))

        def work(k: int) -> None:
            for block in range(k, blocks, threads):
                states[block] = self._maps[k](states[block], signals[block])

        if threads == 1:
            work(0)
        else:
            with ThreadPoolExecutor(threads) as pool:
                list(pool.map(work, range(threads)))
        F = states.transpose(1, 0, 2).reshape(len(Y), blocks * size)[:, :count]
        self._check(F)
        return F

    def _check(self, F: np.ndarray) -> None:
        """Raise ValueError where a run has ended."""
        status = F[self.scene.layout["status"]]
        if (status != OK).any():
            raise ValueError(
                f"{self.scene.model.name}: within the period a run ends: {STATUS[int(status.max())]}; linearise about "
                "a state farther from that"
            )

    def split(self, U: np.ndarray) -> tuple[np.ndarray | None, np.ndarray | None]:
        """What the references and the torques (joints, k) are moved by."""
        n, given = self.scene.tree.n, [name for name in self.inputs if name != "voltage"]
        parts = {name: U[k * n : (k + 1) * n] for k, name in enumerate(given)}
        return parts.get("reference"), parts.get("torque")


def _blocks(X: np.ndarray, blocks: int, size: int) -> np.ndarray:
    """Columns (rows, k) in blocks (blocks, rows, size); the last one is repeated."""
    columns = np.minimum(np.arange(blocks * size), X.shape[1] - 1)
    return np.ascontiguousarray(X[:, columns].reshape(len(X), blocks, size).transpose(1, 0, 2))


def _eight(system: _System) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """The map in lanes: of states (size, 8) and inputs (signals, 8)."""
    ready = system.ready
    run, y, out = ready.arguments_in_lanes([system.start])
    run = run._replace(plan=system.course)
    if "voltage" in system.inputs:
        run = run._replace(signals=run.signals._replace(reference=None))
    elif system.scene.sampled and run.signals.torques is None:  # the kernel of `simulate_batch`
        run = run._replace(signals=run.signals._replace(reference=None, samples=_ticks(system)))
    put = _setter(run)

    def call(Y: np.ndarray, U: np.ndarray) -> np.ndarray:
        put(*system.split(U))
        y[:] = Y
        ready.call(rollout_lanes, run, y, out)
        return y

    return call


def _ticks(system: _System) -> np.ndarray:
    """What the controllers see at each tick (ticks, joints, 2, lanes)."""
    plan = system.course
    ticks = -(-plan.steps // plan.per_tick)
    values = np.zeros((ticks, system.scene.tree.n, 2))
    sample_ticks(system.start.reference, plan, 0, values)
    samples = aligned((*values.shape, WIDTH))
    samples[:] = values[..., None]
    return samples


def _one(system: _System) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """The map of one run: of states (size, 1) and inputs (signals, 1)."""
    ready = system.ready
    run, y, out = ready.arguments(system.start)
    put = _setter(run)

    def call(Y: np.ndarray, U: np.ndarray) -> np.ndarray:
        put(*(None if part is None else part[:, 0] for part in system.split(U)))
        y[:] = Y[:, 0]
        ready.call(ready.kernel, run, y, out)
        return y[:, None]

    return call


def _setter(run: Run) -> Callable[[np.ndarray | None, np.ndarray | None], None]:
    """What moves the signals of a run by so much, for all of the period."""
    signals, places = run.signals, []
    if signals.samples is not None:
        places.append((0, signals.samples, signals.samples[:, :, 0]))
    elif signals.reference is not None:
        places.append((0, signals.reference.cubics, signals.reference.cubics[:, :, 0]))
    if signals.torques is not None:
        places.append((1, signals.torques.cubics, signals.torques.cubics[:, :, 0]))
    rest = [(which, part, part.copy()) for which, _, part in places]

    def put(*moves: np.ndarray | None) -> None:
        for which, part, own in rest:
            by = moves[which]
            if by is not None:
                part[:] = own + by

    return put


def _channels(system: _System, states: Iterable[str] | None, inputs: tuple[str, ...]) -> list[str]:
    """The channels of the states: those given, or those on which the next state depends."""
    scene = system.scene
    there = [c for c in IN_STATE if scene.part(c.name)[1] > scene.part(c.name)[0]]
    possible = [c for c in there if c.kind in (*KINDS, *MEMORY) and c.name not in inputs]
    if states is not None:
        known = [c.name for c in possible]
        chosen = listed("states", states, "give a list of channels, such as ('q', 'qd')")
        for name in chosen:
            one_of("states", name, known)
        return [name for name in known if name in chosen]
    always = [c.name for c in possible if c.kind in KINDS]
    return [*always, *_remembered(system, always, [c.name for c in possible if c.kind in MEMORY])]


def _remembered(system: _System, always: list[str], memory: list[str]) -> list[str]:
    """Which channels of what is held or derived the next state depends on: a run with all of it moved tells."""
    if not memory:
        return []
    scene, charts = system.scene, {name: chart_of(system.scene, (name,)) for name in memory}
    Y = np.repeat(system.y[:, None], len(memory) + 1, axis=1)
    for k, name in enumerate(memory, start=1):
        chart = charts[name]
        uneven = 1.0 + 0.3 * np.arange(len(chart.names)) / len(chart.names)
        Y[:, k] = chart.moved(system.y, (np.array(chart.widths) * uneven)[:, None])[:, 0]
    F = system.ends(Y, np.zeros((len(system.signals()), Y.shape[1])))
    changed = F[:, 1:] != F[:, :1]

    def touched(name: str, k: int) -> bool:
        return bool(changed[slice(*scene.part(name)), k].any())

    kept = [name for k, name in enumerate(memory) if any(touched(other, k) for other in always)]
    while True:
        more = [
            name
            for k, name in enumerate(memory)
            if name not in kept and any(touched(other, k) for other in kept if other != name)
        ]
        if not more:
            return [name for name in memory if name in kept]
        kept += more


# ------------------------------------------------------------------------------------------------ differences


class _Columns(NamedTuple):
    """Derivatives (rows, columns), and what is known of them."""

    value: np.ndarray
    error: np.ndarray
    left: np.ndarray
    right: np.ndarray
    jump: np.ndarray  # from left to right, the least of all widths
    noise: np.ndarray  # of left and right, by rounding


def _kinked(found: _Columns, least: np.ndarray) -> np.ndarray:
    """Where left and right differ (rows, columns), in all widths alike; least: what counts."""
    largest = np.maximum(np.abs(found.left), np.abs(found.right))
    return found.jump > KINK * np.maximum(largest, least) + found.noise


def _differences(system: _System, chart: Chart, outputs: tuple[str, ...], period: float) -> Linearisation:
    """All columns, each in widths as small as it takes."""
    scene, signals = system.scene, system.signals()
    names = [*chart.names, *signals]
    sticky = sticks(scene.constants.friction)
    first = np.array([*chart.widths, *(_width(scene, sticky, name.split()[0], "") for name in signals)])
    end = system.ends(system.y[:, None], np.zeros((len(signals), 1)))[:, 0]
    read = system.ready.channels

    def rows(F: np.ndarray) -> np.ndarray:
        return np.concatenate([chart.difference(F, end), F[read] - end[read, None]])

    size = np.abs(np.concatenate([end[chart._reads[: chart.states]], end[read]]))
    found = _columns(system, chart, rows, np.arange(len(names)), first, size)
    least = SMALL * (np.abs(found.value) * first).max(axis=1, initial=0.0)[:, None] / first
    for k in range(1, ROUNDS):
        bad = found.error > ENOUGH * np.maximum(np.abs(found.value), least)
        again = np.flatnonzero((bad | _kinked(found, least)).any(axis=0))
        if not len(again):
            break
        found = _better(found, again, _columns(system, chart, rows, again, first[again] / FINER**k, size))
    kinked = _kinked(found, least)
    found = found._replace(error=np.where(kinked, 0.5 * np.abs(found.right - found.left), found.error))
    n, labels = chart.states, (*chart.names[: chart.states], *_labels(scene, outputs, read))
    kinks = tuple(
        Kink(names[j], tuple(labels[i] for i in np.flatnonzero(column)), found.left[column, j], found.right[column, j])
        for j, column in enumerate(kinked.T)
        if column.any()
    )
    value, error = found.value, found.error
    return Linearisation(
        A=value[:n, :n], B=value[:n, n:], C=value[n:, :n], D=value[n:, n:],
        A_error=error[:n, :n], B_error=error[:n, n:], C_error=error[n:, :n], D_error=error[n:, n:],
        states=tuple(names[:n]), inputs=tuple(names[n:]), outputs=labels[n:], kinks=kinks,
        change=chart.difference(end[:, None], system.y)[:, 0], period=period, state=system.y, chart=chart,
    )  # fmt: skip


def _columns(
    system: _System,
    chart: Chart,
    rows: Callable[[np.ndarray], np.ndarray],
    which: np.ndarray,
    widths: np.ndarray,
    size: np.ndarray,
) -> _Columns:
    """Some columns, in a width each; rows: of states at the end; size: of the rows' numbers."""
    k = len(which)
    moves = np.zeros((len(chart.names) + len(system.signals()), 4, k))
    for row, factor in enumerate((1.0, -1.0, 0.5, -0.5)):
        moves[which, row, np.arange(k)] = factor * widths
    states, signals = np.split(moves.reshape(len(moves), 4 * k), [len(chart.names)])
    ends = system.ends(chart.moved(system.y, states), signals)
    wide_right, wide_left, right, left = rows(ends).reshape(-1, 4, k).transpose(1, 0, 2)
    half = 0.5 * widths
    wide, narrow = (wide_right - wide_left) / (2.0 * widths), (right - left) / widths
    rounding = ROUNDING * size[:, None] / half
    to_right = 2.0 * right / half - wide_right / widths
    to_left = wide_left / widths - 2.0 * left / half
    return _Columns(
        value=(4.0 * narrow - wide) / 3.0,
        error=np.abs(narrow - wide) / 3.0 + rounding,
        left=to_left,
        right=to_right,
        jump=np.abs(to_right - to_left),
        noise=4.0 * rounding,
    )


def _better(found: _Columns, again: np.ndarray, new: _Columns) -> _Columns:
    """The columns, of those taken again each entry from where its error is least, left and right from the last."""
    better = new.error < found.error[:, again]
    for old, now in zip(found[:2], new[:2]):
        old[:, again] = np.where(better, now, old[:, again])
    new = new._replace(jump=np.minimum(new.jump, found.jump[:, again]))
    for old, now in zip(found[2:], new[2:]):
        old[:, again] = now
    return found


def _labels(scene: CompiledScene, outputs: tuple[str, ...], read: np.ndarray) -> tuple[str, ...]:
    """Names of the recorded numbers."""
    by_place = {}
    for name in outputs:
        first, end = scene.part(name)
        if name == "base_q":
            labels = BY_NAME[name].labels
        elif name in ("q", "qd", "qdd"):
            labels = scene.model.joint_names
        else:
            labels = tuple(label for label, _, _ in _coordinates(scene, name))
        by_place.update({first + k: f"{name} {label}".strip() for k, label in enumerate(labels[: end - first])})
    return tuple(by_place[place] for place in read.tolist())
