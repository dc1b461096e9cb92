"""Servos identified from recordings of a real one that swings a weight: friction models M1 to M6, motor and firmware.

    recordings = [read_bench(path, XL330) for path in paths]
    fit = fit_servo(recordings, XL330, "m4p", progress=True)
    print(fit.summary())

The bench is that of Rhoban's BAM project (https://github.com/Rhoban/bam; arXiv 2410.08650): the servo's axis is
horizontal and carries a rod with a weight at its end; zero hangs down.  The servo follows its goal by its own firmware,
duty = gain kp (goal - angle), and may let go.  Simulated is the whole rollout, from the first sample on and with no
correction on the way: a rod on a `Servo` with rotor and `Gearbox` friction, its controller at 500 Hz.

The simulated angle is brought to the recorded one in the mean absolute sense (a soft absolute value, `SOFT`), each
recording counting alike.  Some combinations of parameters hardly show in such recordings; a weak prior keeps them near
the figures that are published for servos of the kind, as wide as those differ (`Parameter`).  The supply is what the
servo measures at rest: its column under load is a beat of its converter with the bridge's switching, and predicts worse
(27 mrad in place of 22 where a gain is left out).

Intervals are those of identification.py, of a model that has the servo's physics; the error on recordings left out
(`leave_out`) tells how far it has.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from tqdm import tqdm

from .arguments import instance, listed, one_of, real
from .arguments import path as path_of
from .build.scene import CompiledScene, compile_scene
from .files import FilePath, Format, number, read_csv
from .intervals import covariances, quantile
from .model import Controller, Gearbox, Joint, Link, Model, Servo
from .reference import Reference
from .run.simulate import initial_state, simulate_batch
from .worlds import Worlds

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMAT = Format("servo recording")
COLUMNS = ("time_s", "angle_rad", "goal_rad", "supply_v", "torque_on")  # of a recording; others are passed over
STEP = 2e-3  # of simulation and firmware [s]; 0.1 ms changes the errors by 0.1 mrad
SOFT = 0.02  # [rad], above which an error counts by its size
PRIOR = 0.04  # of an error of `SOFT` in every sample, that a parameter off by its width counts
OPEN = 1e-9  # current limit of a bridge that has let go [A]
SLOPE_STEP = 1e-3  # of the widths, of forward differences
MOST_ITERATIONS = 30
RESTING = 30.0  # duty in units of the servo, below which it measures its supply at rest
EARLY = 1e-7  # a goal that comes with a tick counts for it, whatever the rounding of times [s]


class Parameter(NamedTuple):
    """What is searched: where from, within which bounds, and how wide the prior is about the start."""

    start: float
    low: float
    high: float
    width: float
    unit: str


@dataclass(frozen=True)
class Bench:
    """A kind of servo on a bench: its firmware, the weight, and where the search starts."""

    name: str
    mass: float  # at the end of the rod [kg]
    length: float  # of the rod [m]
    duty: float  # per rad and unit of gain
    largest_duty: float
    goal_lead: float  # from a goal's effect to its time stamp [s]
    torque_constant: float  # published, of this servo or of one like it [N m/A]
    resistance: float  # [Ohm]
    armature: float  # [kg m^2]
    coulomb_friction: float  # [N m]
    viscous_friction: float  # [N m s/rad]

    def parameters(self) -> dict[str, Parameter]:
        """All that may be searched, by name."""
        k, g, A = self.torque_constant, self.torque_constant / self.resistance, self.armature
        stall = 7.0 * g  # [N m], to which frictions go
        return {
            "torque_constant": Parameter(k, 0.25 * k, 4.0 * k, 0.15 * k, "N m/A"),
            "torque_per_volt": Parameter(g, 0.2 * g, 5.0 * g, 0.35 * g, "N m/V"),
            "armature": Parameter(A, 0.1 * A, 10.0 * A, 0.3 * A, "kg m^2"),
            "rod_mass": Parameter(0.02, 0.0, 0.06, 0.015, "kg"),
            "zero": Parameter(0.0, -0.1, 0.1, 0.02, "rad"),
            "coulomb_friction": Parameter(self.coulomb_friction, 0.0, 0.3 * stall, 0.01 * stall, "N m"),
            "viscous_friction": Parameter(self.viscous_friction, 0.0, 0.2 * stall, 0.006 * stall, "N m s/rad"),
            "load_friction": Parameter(0.05, 0.0, 0.6, 0.05, "-"),
            "external_load_friction": Parameter(0.05, 0.0, 0.6, 0.1, "-"),
            "motor_load_friction": Parameter(0.05, 0.0, 0.6, 0.1, "-"),
            "load_product_friction": Parameter(0.3 / stall, 0.0, 3.0 / stall, 0.4 / stall, "1/(N m)"),
            "stribeck_speed": Parameter(2.0, 0.01, 10.0, 1.0, "rad/s"),
            "stribeck_exponent": Parameter(1.0, 0.3, 8.0, 0.5, "-"),
            "stribeck_friction": Parameter(0.005 * stall, 0.0, 0.3 * stall, 0.01 * stall, "N m"),
            "stribeck_load": Parameter(0.1, 0.0, 0.6, 0.1, "-"),
            "stribeck_external_load": Parameter(0.1, 0.0, 0.6, 0.1, "-"),
            "stribeck_motor_load": Parameter(0.1, 0.0, 0.6, 0.1, "-"),
            "quadratic_external_load": Parameter(0.02, 0.0, 0.5, 0.05, "1/(N m)"),
            "quadratic_motor_load": Parameter(0.02, 0.0, 0.5, 0.05, "1/(N m)"),
            "angle_age": Parameter(0.003, -0.02, 0.03, 0.003, "s"),
        }


# Weights, gains, firmware and times: the bench's own notes and columns; motors: published fits (arXiv 2410.08650 and
# BAM's documentation), of the STS3250 its data sheet (4.9 N m and 75 rpm at 12 V).
_DUTY = 4096 / (2 * math.pi) / (256 * 885)
XL330 = Bench("xl330", 0.49, 0.1, _DUTY, 1.0, 0.0035, 0.3862, 3.403, 0.0019, 0.0088, 0.0046)
STS3250 = Bench("sts3250", 1.13, 0.12, 0.166, 0.97, 0.0135, 1.5, 2.0, 0.015, 0.03, 0.03)
BENCHES = {bench.name: bench for bench in (XL330, STS3250)}
BASE = ("torque_constant", "torque_per_volt", "armature", "rod_mass", "zero", "coulomb_friction", "viscous_friction")
TIMES = ("angle_age",)
FALLS = ("stribeck_speed", "stribeck_exponent", "stribeck_friction")
M5 = ("external_load_friction", "motor_load_friction", *FALLS, "stribeck_external_load", "stribeck_motor_load")
MODELS = {  # what each adds; m4p: the product of loads besides
    "m1": (),
    "m2": FALLS,
    "m3": ("load_friction",),
    "m4": ("load_friction", *FALLS, "stribeck_load"),
    "m4p": ("load_friction", *FALLS, "stribeck_load", "load_product_friction"),
    "m5": M5,
    "m6": (*M5, "quadratic_external_load", "quadratic_motor_load"),
}
SHARED = {  # numbers of M3 and M4 that are two of `Gearbox`
    "load_friction": ("external_load_friction", "motor_load_friction"),
    "stribeck_load": ("stribeck_external_load", "stribeck_motor_load"),
}


@dataclass(frozen=True, eq=False)
class BenchRecording:
    """One trajectory: time (k,) rising [s]; angle (k,) and goal (k,) [rad], each goal held until the next."""

    name: str
    time: np.ndarray
    angle: np.ndarray
    goal: np.ndarray
    release: float  # when the servo lets go [s]; infinite if it never does
    supply: float  # [V] at rest
    gain: float  # kp, in the firmware's units
    mass: float  # [kg]
    length: float  # [m]

    @property
    def motion(self) -> str:
        """The name without servo and gain."""
        return re.sub(r"^.*_kp\d+_", "", self.name)


def read_bench(
    path: FilePath,
    bench: Bench,
    *,
    gain: float | None = None,
    mass: float | None = None,
    length: float | None = None,
) -> BenchRecording:
    """Read a CSV with the columns time_s, angle_rad, goal_rad, supply_v and torque_on; others are passed over.

    gain: kp of the firmware; None takes it from a name like xl330_kp400_lift.csv.  mass [kg], length [m]: those of the
    bench where not given.  Raises ValueError, naming file, line and column, on anything that is not such a table.
    """
    path = path_of("path", path)
    instance("bench", bench, Bench, f"give one of {', '.join(BENCHES)} in BENCHES")
    lines = list(read_csv(path, FORMAT)) or [(1, [])]
    names = [name.strip() for name in lines[0][1]]
    for column in COLUMNS:
        if names.count(column) != 1:
            raise ValueError(f"{path}: column {column} is there {names.count(column)} times; give {', '.join(COLUMNS)}")
    rows = [_numbers(path, line, names, cells) for line, cells in lines[1:]]
    if len(rows) < 20:
        raise ValueError(f"{path}: has {len(rows)} samples; record 20 or more")
    table = dict(zip(names, np.array(rows).T))
    time, on = table["time_s"], table["torque_on"] > 0.5
    wrong = np.flatnonzero(np.diff(time) <= 0.0)
    if wrong.size:
        raise ValueError(f"{path}, line {lines[wrong[0] + 2][0]}: the time does not rise; sort the samples")
    off = np.flatnonzero(~on)
    if off.size and on[off[0] :].any():
        raise ValueError(f"{path}, line {lines[off[0] + 1][0]}: it lets go and takes hold again; cut the file there")
    if gain is None:
        found = re.search(r"_kp(\d+(?:\.\d+)?)_", path.name)
        if found is None:
            raise ValueError(f"{path}: the name has no _kpNNN_; give gain (on the command line --gain)")
        gain = float(found[1])
    resting = np.abs(table["pwm"]) < RESTING if "pwm" in table else np.ones(len(time), bool)
    supply = table["supply_v"][resting if resting.any() else slice(None)]
    return BenchRecording(
        name=path.stem,
        time=time,
        angle=table["angle_rad"],
        goal=table["goal_rad"],
        release=float(time[off[0]]) if off.size else math.inf,
        supply=float(np.median(supply)),
        gain=real("gain", gain, 1e-6, 1e6, "it is kp in the firmware's units"),
        mass=real("mass", bench.mass if mass is None else mass, 0.0, 1e3, "give kg"),
        length=real("length", bench.length if length is None else length, 1e-4, 10.0, "give metres"),
    )


def _numbers(path: Path, line: int, names: Sequence[str], cells: list[str]) -> list[float]:
    if len(cells) != len(names):
        raise ValueError(f"{path}, line {line}: has {len(cells)} values, expected {len(names)}; complete or delete it")
    values = [number(cell) for cell in cells]
    for name, value, cell in zip(names, values, cells):
        if name in COLUMNS and not math.isfinite(value):
            raise ValueError(f"{path}, line {line}, column {name!r}: {cell[:40]!r} is no finite number; delete it")
    return values


@dataclass(frozen=True, eq=False)
class ServoFit:
    """What `fit_servo` found."""

    bench: Bench
    friction: str  # which of MODELS
    values: dict[str, float]  # see `Bench.parameters`
    intervals: dict[str, tuple[float, float]]  # of 95 %
    correlation: np.ndarray  # (parameters, parameters)
    recordings: tuple[BenchRecording, ...]
    angles: tuple[np.ndarray, ...]  # simulated, at the times of each recording [rad]
    simulations: int
    message: str

    @cached_property
    def errors(self) -> np.ndarray:
        """Mean absolute error of each recording [rad]."""
        return np.array([np.abs(a - r.angle).mean() for a, r in zip(self.angles, self.recordings)])

    @property
    def servo(self) -> Servo:
        """The servo as it is simulated, at the supply and gain of the first recording."""
        world = _numbers_of(self.bench, self.recordings[0], self.values)
        return _scene(self.bench, world).model.servos["turn"]

    def predict(self, recordings: Sequence[BenchRecording]) -> list[np.ndarray]:
        """Simulated angles of other recordings, at their times [rad]."""
        return _Rollouts(self.bench, recordings, tuple(self.values))([self.values])[0]

    def summary(self) -> str:
        """A table of the parameters, and the errors."""
        units = self.bench.parameters()
        lines = [f"{'parameter':24} {'value':>10} {'95 % interval':>24}  unit"]
        for name, value in self.values.items():
            low, high = self.intervals[name]
            lines.append(f"{name:24} {value:10.4g} {f'{low:.4g} to {high:.4g}':>24}  {units[name].unit}")
        lines += [f"{r.name}: {1e3 * e:.1f} mrad" for r, e in zip(self.recordings, self.errors)]
        lines.append(f"mean of the recordings {1e3 * self.errors.mean():.1f} mrad ({self.simulations} simulations)")
        return "\n".join(lines)

    def plot(self) -> Figure:
        """Goal, recorded and simulated angle of each recording, and the error below."""
        return plot_rollouts(self.recordings, self.angles)


def fit_servo(
    recordings: Sequence[BenchRecording], bench: Bench, friction: str = "m4p", *, progress: bool = False
) -> ServoFit:
    """Fit a servo with a friction model to recordings.

    friction: "m1" to "m6", or "m4p", M4 with losses that grow with the product of the loads.  Raises ValueError for
    another one and for no recordings.
    """
    from scipy.optimize import least_squares

    recordings = _checked(recordings, bench)
    one_of("friction", friction, MODELS)
    every = bench.parameters()
    names = (*BASE, *MODELS[friction], *TIMES)
    start, low, high, width = (np.array([every[name][k] for name in names]) for k in range(4))
    rollouts = _Rollouts(bench, recordings, names)
    with tqdm(disable=not progress, desc=f"identify {bench.name} {friction}", unit="iteration") as bar:
        work = _Residuals(rollouts, start, width, (low, high), bar.update)
        found = least_squares(
            work.residuals, start / width, work.jacobian, (low / width, high / width), max_nfev=MOST_ITERATIONS,
            x_scale=1.0, xtol=1e-5, ftol=1e-5,
        )  # fmt: skip
    x = found.x * width
    lengths = [len(r.time) for r in recordings]
    _, robust, independent = covariances(found.jac[: sum(lengths)], found.fun[: sum(lengths)], lengths)
    spread = np.sqrt(np.diag(robust)) * width
    reach = spread * quantile(0.95, independent - len(x))
    values = dict(zip(names, x.tolist()))
    return ServoFit(
        bench=bench,
        friction=friction,
        values=values,
        intervals={n: (v - r, v + r) for (n, v), r in zip(values.items(), reach)},
        correlation=robust / np.maximum(np.outer(spread / width, spread / width), 1e-300),
        recordings=tuple(recordings),
        angles=tuple(rollouts([values])[0]),
        simulations=rollouts.count,
        message=found.message,
    )


def leave_out(
    recordings: Sequence[BenchRecording],
    bench: Bench,
    friction: str = "m4p",
    by: Callable[[BenchRecording], object] = lambda r: r.gain,
    *,
    progress: bool = False,
) -> dict[object, tuple[ServoFit, list[np.ndarray], np.ndarray]]:
    """Of each group of recordings: the fit to all others, the angles it predicts, and their mean absolute errors [rad].

    by: what tells the groups; their gain, or their motion.  Raises ValueError where there are less than two.
    """
    recordings = _checked(recordings, bench)
    groups = sorted({by(r) for r in recordings}, key=str)
    if len(groups) < 2:
        raise ValueError(f"there is one group, {groups[0]}; give recordings of two or more")
    results: dict[object, tuple[ServoFit, list[np.ndarray], np.ndarray]] = {}
    for group in groups:
        fit = fit_servo([r for r in recordings if by(r) != group], bench, friction, progress=progress)
        rest = [r for r in recordings if by(r) == group]
        angles = fit.predict(rest)
        results[group] = fit, angles, np.array([np.abs(a - r.angle).mean() for a, r in zip(angles, rest)])
    return results


def _checked(recordings: Sequence[BenchRecording], bench: Bench) -> list[BenchRecording]:
    instance("bench", bench, Bench, f"give one of {', '.join(BENCHES)} in BENCHES")
    found = listed("recordings", recordings, "give a list of BenchRecording")
    for recording in found:
        instance("recordings", recording, BenchRecording, "give a list of what read_bench returns")
    if not found:
        raise ValueError("recordings: there is none; give one or more, see read_bench")
    return found


# ---------------------------------------------------------------------------------------------- rollouts


class _World(NamedTuple):
    """Numbers of one simulation, by the names of `Worlds`."""

    servos: dict[str, float]
    mass: float  # of the rod with its weight [kg]
    center: float  # below the axis [m]
    inertia: float  # about its centre of mass [kg m^2]


def _numbers_of(bench: Bench, recording: BenchRecording, values: dict[str, float]) -> _World:
    k, g = values["torque_constant"], values["torque_per_volt"]
    own = {name: x for name, x in values.items() if name not in (*BASE, *TIMES)}
    for name, both in SHARED.items():
        if name in own:
            own |= dict.fromkeys(both, own.pop(name))
    servos = {
        "motor_constant": k,
        "resistance": k / g,
        "voltage_limit": bench.largest_duty * recording.supply,
        "Kp": bench.duty * recording.gain * recording.supply,
        "rotor_inertia": values["armature"],
        "coulomb_friction": max(values["coulomb_friction"], 0.0),
        "viscous_friction": max(values["viscous_friction"], 0.0),
        **own,
    }
    rod, m, l = values["rod_mass"], recording.mass, recording.length
    mass = m + rod
    center = (m * l + 0.5 * rod * l) / mass
    return _World(servos, mass, center, m * l * l + rod * l * l / 3.0 - mass * center * center)


def _scene(bench: Bench, world: _World) -> CompiledScene:
    """The bench: a rod on the servo, which hangs down at zero."""
    mine = world.servos
    gear = {name: mine[name] for name in mine if name in Gearbox.__dataclass_fields__}
    own = {name: mine[name] for name in mine if name in Servo.__dataclass_fields__}
    servo = Servo(Controller("state", mine["Kp"], period=STEP, lag=0.0), Gearbox(1.0, **gear), **own)
    J = world.inertia
    links = (
        Link("stand", 1.0, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)),
        Link("rod", world.mass, (0.0, 0.0, -world.center), (J, 0.0, 0.0, J, 0.0, J)),
    )
    joint = Joint("turn", "continuous", "stand", "rod", axis=(0.0, -1.0, 0.0))
    model = Model(f"{bench.name}_bench", links, (joint,), servos={"turn": servo})
    return compile_scene(model, "rotor", integrator="implicit_euler", timestep=STEP)


class _Rollouts:
    """All recordings with several sets of values at once, eight simulations to a vector."""

    def __init__(self, bench: Bench, recordings: Sequence[BenchRecording], names: tuple[str, ...]) -> None:
        self.bench, self.recordings, self.names, self.count = bench, list(recordings), names, 0

    def __call__(self, sets: Sequence[dict[str, float]]) -> list[list[np.ndarray]]:
        """Angles of each recording at its times [rad], for each set of values."""
        pairs = [(values, r) for values in sets for r in self.recordings]
        self.count += len(pairs)
        alike: dict[tuple[int, int], list[int]] = {}
        for k, (_, r) in enumerate(pairs):
            alike.setdefault(_steps(r), []).append(k)
        angles: list[np.ndarray] = [np.empty(0)] * len(pairs)
        for (held, free), members in alike.items():
            for k, path in zip(members, self._paths([pairs[k] for k in members], held, free)):
                values, r = pairs[k]
                time = r.time - values["angle_age"] - r.time[0]
                angles[k] = np.interp(time, STEP * np.arange(len(path)), path) + values["zero"]
        n = len(self.recordings)
        return [angles[k * n : (k + 1) * n] for k in range(len(sets))]

    def _paths(self, pairs: list[tuple[dict[str, float], BenchRecording]], held: int, free: int) -> list[np.ndarray]:
        """Angles at each step (1 + held + free,) [rad], of which in the last ones the bridge has let go."""
        worlds = [_numbers_of(self.bench, r, values) for values, r in pairs]
        worlds.append(_another(worlds[0]))  # in every batch the same numbers differ, for which one kernel is compiled
        scene = _scene(self.bench, worlds[0])
        starts: list = [initial_state(scene, [r.angle[0] - values["zero"]]) for values, r in pairs]
        goals = [
            Reference(r.time - r.time[0] - self.bench.goal_lead - EARLY, r.goal[:, None] - values["zero"], "hold")
            for values, r in pairs
        ]
        starts, goals = [*starts, starts[0]], [*goals, goals[0]]
        first = _run(scene, held, starts, goals, worlds, math.inf)
        if not free:
            return [run["q"][:, 0] for run in first[:-1]]
        rest = _run(scene, free, [run.final for run in first], goals, worlds, OPEN)
        return [np.concatenate([a["q"][:, 0], b["q"][1:, 0]]) for a, b in zip(first[:-1], rest)]


def _steps(r: BenchRecording) -> tuple[int, int]:
    """Steps of a recording until the servo lets go, and from then on."""
    length = math.ceil((r.time[-1] - r.time[0]) / STEP) + 40  # beyond the end: the angle's age may be negative
    held = length if r.release == math.inf else round((r.release - r.time[0]) / STEP)
    return held, length - held


def _another(world: _World) -> _World:
    """A world all numbers of which are others."""
    servos = {name: 1.01 * x + 1e-6 for name, x in world.servos.items()}
    return _World(servos, 1.01 * world.mass, 1.01 * world.center, world.inertia + 1e-6)


def _run(
    scene: CompiledScene, steps: int, starts: list, goals: list[Reference], worlds: list[_World], limit: float
) -> list:
    limits = np.full(len(worlds), limit)
    limits[-1] = 1.0
    servos = {name: np.array([world.servos[name] for world in worlds]) for name in worlds[0].servos}
    zero = np.zeros(len(worlds))
    J = np.array([world.inertia for world in worlds])
    links = {
        "rod.mass": np.array([world.mass for world in worlds]),
        "rod.center_of_mass": np.column_stack([zero, zero, [-world.center for world in worlds]])[:, None, :],
        "rod.inertia": np.column_stack([J, zero, zero, J, zero, J])[:, None, :],
    }
    return simulate_batch(
        scene, steps * STEP, starts, goals, record=("q",), sample=STEP, estimate_error=False,
        worlds=Worlds(servos=servos | {"current_limit": limits}, links=links),
    )  # fmt: skip


class _Residuals:
    """Softened errors of all recordings and the prior's, with their slopes, over values in units of their widths."""

    def __init__(
        self,
        rollouts: _Rollouts,
        start: np.ndarray,
        width: np.ndarray,
        bounds: tuple[np.ndarray, np.ndarray],
        progress: Callable[[], object],
    ) -> None:
        self.rollouts, self.start, self.width, self.high, self.progress = rollouts, start, width, bounds[1], progress
        self.at: np.ndarray | None = None
        self.rows: list[np.ndarray] = []
        self.steps = np.empty(0)

    def residuals(self, x: np.ndarray) -> np.ndarray:
        return self._rows(x)[0]

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        rows = self._rows(x)
        return np.column_stack([(row - rows[0]) / step for row, step in zip(rows[1:], self.steps)])

    def _rows(self, x: np.ndarray) -> list[np.ndarray]:
        """Residuals at x and beside it: one batch, so that lanes are full."""
        if self.at is None or not np.array_equal(x, self.at):
            self.steps = np.where(x + SLOPE_STEP > self.high / self.width, -SLOPE_STEP, SLOPE_STEP)
            points = [x, *(x + step * unit for step, unit in zip(self.steps, np.eye(len(x))))]
            sets = [dict(zip(self.rollouts.names, (point * self.width).tolist())) for point in points]
            self.rows = [self._softened(a, point) for a, point in zip(self.rollouts(sets), points)]
            self.at = x.copy()
            self.progress()
        return self.rows

    def _softened(self, angles: list[np.ndarray], x: np.ndarray) -> np.ndarray:
        recordings = self.rollouts.recordings
        parts = []
        for angle, r in zip(angles, recordings):
            e = np.nan_to_num((angle - r.angle) / SOFT, nan=1e3, posinf=1e3, neginf=-1e3)
            rho = np.sqrt(2.0 * (np.sqrt(1.0 + e * e) - 1.0))
            parts.append(np.copysign(rho, e) / math.sqrt(len(angle) * len(recordings)))
        return np.concatenate([*parts, PRIOR * (x - self.start / self.width)])


def plot_rollouts(recordings: Sequence[BenchRecording], angles: Sequence[np.ndarray]) -> Figure:
    """Goal, recorded and simulated angle of each recording [deg], and below the simulated less the recorded one."""
    from matplotlib.figure import Figure

    columns = min(4, len(recordings))
    rows = -(-len(recordings) // columns)
    figure = Figure(figsize=(3.4 * columns, 2.9 * rows), layout="constrained")
    grid = figure.add_gridspec(2 * rows, columns, height_ratios=[2.0, 1.0] * rows)
    above = below = None
    for k, (r, angle) in enumerate(zip(recordings, angles)):
        row, column = divmod(k, columns)
        above = figure.add_subplot(grid[2 * row, column])
        below = figure.add_subplot(grid[2 * row + 1, column], sharex=above)
        held = np.where(r.time < r.release, r.goal, np.nan)
        above.plot(r.time, np.degrees(held), color="0.7", linewidth=1.0, label="goal")
        above.plot(r.time, np.degrees(r.angle), color="C0", linewidth=2.4, label="recorded")
        above.plot(r.time, np.degrees(angle), color="C1", linewidth=1.0, label="simulated")
        below.plot(r.time, np.degrees(angle - r.angle), color="0.3", linewidth=0.7)
        above.set_title(f"{r.name}\n{1e3 * np.abs(angle - r.angle).mean():.1f} mrad", fontsize=8)
        above.tick_params(labelbottom=False, labelsize=7)
        below.tick_params(labelsize=7)
        for axes in (above, below):
            axes.grid(alpha=0.3)
        if column == 0:
            above.set_ylabel("angle [deg]", fontsize=8)
            below.set_ylabel("error [deg]", fontsize=8)
        if row == rows - 1:
            below.set_xlabel("time [s]", fontsize=8)
    if above is not None:
        figure.legend(*above.get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
    return figure
