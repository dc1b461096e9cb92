"""Identify a real servo from recordings of a swinging weight: friction models M1 to M6, motor and firmware.

    recordings = [read_bench(path, XL330) for path in paths]
    fit = fit_servo(recordings, XL330, "m4p", progress=True)
    print(fit.summary())

The bench is that of Rhoban's BAM project (https://github.com/Rhoban/bam; arXiv 2410.08650): the servo's axis is
horizontal and carries a rod with a weight at its end; at zero it hangs down.  The servo's firmware follows the goal
with duty = gain kp (goal - angle), and may switch the motor off.  Each recording is simulated as a whole, from its
first sample and without correction on the way: a rod on a `Servo` with rotor and `Gearbox` friction, its controller at
500 Hz.

The fit minimizes the mean absolute error of the angle (a soft absolute value, `SOFT`), with equal weight for each
recording.  Some combinations of parameters have little effect on such recordings; a weak prior keeps them near
published values of similar servos, with a width like the differences between those (`Parameter`).  The prior weighs as
much as 1 / `PRIOR`^2 independent samples, however well the model fits.  The supply is the one that the servo measures
at rest: under load its column aliases the switching of the bridge.

The search (`gauss_newton.py`) runs in rounds, each with a Jacobian of its own.  A `FitLog` stores them, and an
interrupted fit resumes with the next round, to the same bits.

Intervals are those of `identification.fit`, with the prior, and hold for a model with the servo's physics; the error on
recordings that were not fitted (`leave_out`) shows how good the model is.
"""

from __future__ import annotations

import math
import os
import re
import time
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from typing import Any, NamedTuple

import numpy as np

from ..base.arguments import instance, one_of, real
from ..base.arguments import path as path_of
from ..base.brief import brief, in_full
from ..base.files import FilePath, Format, read_columns, read_csv
from ..base.progress import progress_bar
from ..core.compile.lanes import WIDTH
from ..core.step.signals import Signals
from ..model import Controller, Gearbox, Joint, Link, Model, Servo
from ..run.batch import family, over_threads
from ..run.compiled_run import CompiledRun, RunInput, Vector, lane_zeros
from ..run.lane_engine import sampled
from ..run.prepare import each_once, prepare
from ..run.reference import Reference
from ..run.simulate import initial_state
from ..run.worlds import FIELDS, Worlds, servo_with
from ..scene.compile import CompiledScene, GearboxKind, compile_scene
from .estimate import Blocks, Errors, Fit, information, plot_rollouts, quantile
from .gauss_newton import DAMPING, advance
from .log import FitLog, FitRound
from .recording import EARLY, check_recordings

__all__ = [
    "BENCHES", "MODELS", "STS3250", "XL330", "Bench", "BenchRecording", "Parameter", "ServoFit", "fit_servo",
    "leave_out", "plot_rollouts", "read_bench",
]  # fmt: skip

FORMAT = Format("servo recording")
COLUMNS = ("time_s", "angle_rad", "goal_rad", "supply_v", "torque_on")  # of a recording; others are passed over
# Of simulation and firmware [s].  Steps of 1 and 0.5 ms change the error of a recording of the XL330 by at most 0.5 and
# 0.8 mrad, and the mean of the twelve by 0.05; a firmware at 1 kHz by 0.9 and 0.02 (model m4p, fitted to all).
STEP = 2e-3
SOFT = 0.02  # [rad], above which an error counts by its size
PRIOR = 0.04  # of the residuals' root mean square, that a parameter off by its width counts
OPEN = 1e-9  # current limit of a bridge that has let go [A]
SLOPE_STEP = 1e-6  # of the widths, of forward differences: they agree with tangents to 1e-6
COUNTED_STEP = 1e-3  # the same where the servo counts, and angles jump
COUNTS = ("encoder_resolution", "pwm_steps")
MOST_ROUNDS = 30
CONFIDENCE = 0.95  # of the intervals
RESTING = 30.0  # duty in units of the servo, below which it measures its supply at rest


class Parameter(NamedTuple):
    """A parameter of the fit.

    Attributes
    ----------
    start : float
        Where the search starts, and the mean of the prior.
    low, high : float
        Bounds of the search.
    width : float
        Standard deviation of the prior.
    unit : str
    """

    start: float
    low: float
    high: float
    width: float
    unit: str


@dataclass(frozen=True)
class Bench:
    """A kind of servo on a bench: its firmware, the weight, and where the search starts.

    Attributes
    ----------
    name : str
    mass : float
        Of the weight at the end of the rod [kg].
    length : float
        Of the rod [m].
    supply : float
        Nominal supply [V].
    duty : float
        Duty cycle per rad and unit of gain.
    largest_duty : float
    goal_lead : float
        Time by which a goal takes effect before its time stamp [s].
    torque_constant, resistance, armature, coulomb_friction, viscous_friction : float
        Published values of this servo or a similar one, at its output [N m/A, Ohm, kg m^2, N m, N m s/rad].
    """

    name: str
    mass: float  # at the end of the rod [kg]
    length: float  # of the rod [m]
    supply: float  # nominal [V]
    duty: float  # per rad and unit of gain
    largest_duty: float
    goal_lead: float  # from a goal's effect to its time stamp [s]
    torque_constant: float  # published, of this servo or of one like it [N m/A]
    resistance: float  # [Ohm]
    armature: float  # [kg m^2]
    coulomb_friction: float  # [N m]
    viscous_friction: float  # [N m s/rad]

    __repr__ = brief

    def parameters(self) -> dict[str, Parameter]:
        """Return all parameters that can be fitted, by name."""
        k, g, A = self.torque_constant, self.torque_constant / self.resistance, self.armature
        stall = 7.0 * g  # [N m], to which frictions go
        return {
            "torque_constant": Parameter(k, 0.25 * k, 4.0 * k, 0.05 * k, "N m/A"),
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
            "angle_age": Parameter(self.goal_lead, -0.02, 0.03, 0.003, "s"),
            "stiffness": Parameter(25.0 * stall, 2.0 * stall, 1000.0 * stall, 25.0 * stall, "N m/rad"),
            "damping": Parameter(0.06 * stall, 0.001 * stall, 1.0 * stall, 0.06 * stall, "N m s/rad"),
            "backlash": Parameter(0.005, 0.0, 0.05, 0.005, "rad"),
        }


# Weights, gains, firmware and times: the bench's own notes and columns; motors: published fits (arXiv 2410.08650 and
# BAM's documentation), of the STS3250 its data sheet (4.9 N m and 75 rpm at 12 V).
_DUTY = 4096 / (2 * math.pi) / (256 * 885)
XL330 = Bench("xl330", 0.49, 0.1, 7.4, _DUTY, 1.0, 0.0035, 0.3862, 3.403, 0.0019, 0.0088, 0.0046)
STS3250 = Bench("sts3250", 1.13, 0.12, 12.0, 0.166, 0.97, 0.0135, 1.5, 2.0, 0.015, 0.03, 0.03)
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
    """A recording of a servo on the bench.

    Attributes
    ----------
    name : str
    time : (k,) ndarray
        Rising [s].
    angle : (k,) ndarray
        [rad]
    goal : (k,) ndarray
        Each value is held until the next [rad].
    release : float
        When the servo switches its motor off [s]; infinite if it never does.
    supply : float
        At rest [V].
    gain : float
        kp, in the firmware's units.
    mass : float
        Of the weight [kg].
    length : float
        Of the rod [m].
    """

    name: str
    time: np.ndarray
    angle: np.ndarray
    goal: np.ndarray
    release: float
    supply: float
    gain: float
    mass: float
    length: float

    __repr__ = brief

    @property
    def reference(self) -> np.ndarray:
        """Goal while the servo holds, NaN after its release (k,) [rad]."""
        return np.where(self.time < self.release, self.goal, np.nan)

    @property
    def motion(self) -> str:
        """The name without servo and gain."""
        return re.sub(r"^.*_kp\d+_", "", self.name)


def read_bench(
    path: FilePath, bench: Bench, *, gain: float | None = None, mass: float | None = None, length: float | None = None
) -> BenchRecording:
    """Read a recording of a servo on the bench from a CSV file.

    Parameters
    ----------
    path : path-like
        A table with the columns time_s, angle_rad, goal_rad, supply_v and torque_on; other columns are ignored.
    bench : Bench
    gain : float, optional
        kp of the firmware; by default from a file name like xl330_kp400_lift.csv.
    mass, length : float, optional
        Of weight [kg] and rod [m]; by default those of the bench.

    Returns
    -------
    BenchRecording

    Raises
    ------
    ValueError
        If the file is not such a table; the message names file, line and column.
    OSError
        If the file cannot be read.
    """
    path = path_of("path", path)
    instance("bench", bench, Bench, f"give one of {', '.join(BENCHES)} in BENCHES")
    table, lines = read_columns(path, FORMAT, COLUMNS, (), least=20, others=True)
    time, on = table["time_s"], table["torque_on"] > 0.5
    wrong = np.flatnonzero(np.diff(time) <= 0.0)
    if wrong.size:
        raise ValueError(f"{path}, line {lines[wrong[0] + 1]}: the time does not rise; sort the samples")
    off = np.flatnonzero(~on)
    if off.size and on[off[0] :].any():
        raise ValueError(f"{path}, line {lines[off[0]]}: the servo lets go and takes hold again; cut the file there")
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
        length=real("length", bench.length if length is None else length, 1e-4, 10.0, "give meters"),
    )


def is_bench_recording(path: FilePath) -> bool:
    """Return whether a CSV file has all columns that `read_bench` needs; OSError if it cannot be read."""
    try:
        _, head = next(iter(read_csv(path, FORMAT)), (1, []))
    except ValueError:
        return False
    return set(COLUMNS) <= {cell.strip() for cell in head}


@dataclass(frozen=True, eq=False)
class ServoFit(Fit):
    """A servo with a friction model that `fit_servo` has fitted to recordings.

    Attributes
    ----------
    values, start, intervals, units, confidence, correlation, recordings, angles, message
        As in `Fit`.
    bench : Bench
    friction : str
        Friction model, one of `MODELS`.
    held : dict of str to float
        Values that were given.
    simulations : int
        Of this process.
    seconds : float
        Time of all rounds [s].
    """

    bench: Bench
    friction: str
    held: dict[str, float]
    simulations: int
    seconds: float

    __repr__ = brief

    @property
    def servo(self) -> Servo:
        """The servo as it is simulated, at the supply and gain of the first recording."""
        return servo_with(_SERVO, _numbers_of(self.bench, self.recordings[0], self.values | self.held).servos)

    def predict(self, recordings: Sequence[BenchRecording]) -> list[np.ndarray]:
        """Return the simulated angles (k,) of other recordings, at their times [rad]."""
        return _Rollouts(self.bench, recordings)([self.values | self.held])[0]

    def summary(self) -> str:
        """Return a table of the parameters, and the errors, as text."""
        lines = self.table() + [f"correlation of {a} and {b}: {rho:.2f}" for a, b, rho in self.correlated()]
        lines += [f"{r.name}: {1e3 * e:.1f} mrad" for r, e in zip(self.recordings, self.errors)]
        lines.append(f"mean of the recordings {1e3 * self.errors.mean():.1f} mrad ({self.simulations} simulations)")
        return "\n".join(lines)


def fit_servo(
    recordings: Sequence[BenchRecording],
    bench: Bench,
    friction: str = "m4p",
    *,
    more: Sequence[str] = (),
    held: Mapping[str, float] | None = None,
    log: FitLog | None = None,
    progress: bool = False,
) -> ServoFit:
    """Fit a servo with a friction model to recordings.

    Parameters
    ----------
    recordings : sequence of BenchRecording
    bench : Bench
    friction : str
        "m1" to "m6", or "m4p", which is M4 with losses that grow with the product of the loads.
    more : sequence of str
        Further parameters of `Bench.parameters` to fit, such as "stiffness", "damping" and "backlash" of the gearbox.
    held : mapping of str to float, optional
        Known values, of `Bench.parameters` or of a servo: {"rod_mass": 0.0}, {"encoder_resolution": 2 * pi / 4096}.
    log : FitLog, optional
        Where finished rounds are stored, and read from.
    progress : bool
        Show a progress bar.

    Returns
    -------
    ServoFit

    Raises
    ------
    ValueError
        For unknown names and for no recordings.
    """
    recordings = _checked(recordings, bench)
    one_of("friction", friction, MODELS)
    every, held = bench.parameters(), {} if held is None else dict(held)
    for name in more:
        one_of("more", name, every)
    for name in held:
        one_of("held", name, (*every, *FIELDS["servos"]))
    names = tuple(name for name in (*BASE, *MODELS[friction], *TIMES, *more) if name not in held)
    key = _key(bench, recordings, names, held)
    with progress_bar(progress=progress, desc=f"identify {bench.name} {friction}", unit="evaluation") as bar:
        work = _Residuals(_Rollouts(bench, recordings), {name: every[name] for name in names}, held, bar.update)
        row = _searched(work, key, log)
        x = np.array(row["x"])
        J, e = work.slopes(x), work.errors(x)
    found, independent = information(J, e, [len(r.time) for r in recordings])
    known = np.linalg.inv(found + np.eye(len(x)))  # with a prior of width one
    spread = np.sqrt(np.diag(known))
    reach = spread * quantile(CONFIDENCE, independent - len(x)) * work.width
    values = work.values(x)
    ends = ((n, values[n] - r, values[n] + r) for n, r in zip(names, reach))
    return ServoFit(
        bench=bench,
        friction=friction,
        values=values,
        start={name: every[name].start for name in names},
        held=held,
        intervals={name: (max(low, every[name].low), min(high, every[name].high)) for name, low, high in ends},
        units={name: every[name].unit for name in names},
        confidence=CONFIDENCE,
        correlation=known / np.outer(spread, spread),
        recordings=tuple(recordings),
        angles=tuple(work.rollouts([values | held])[0]),
        simulations=work.rollouts.count,
        seconds=row["seconds"],
        message=row["message"],
    )


def _searched(work: _Residuals, key: str, log: FitLog | None) -> FitRound:
    """Do the rounds of the search that are missing; return the last."""
    row = None if log is None else log.last(key)
    if row is None:
        row = FitRound(round=0, x=(work.start / work.width).tolist(), damping=DAMPING, seconds=0.0, message="")
    prior = work.start / work.width, PRIOR
    while not row["message"]:
        begun, k = time.perf_counter(), row["round"] + 1
        x, damping, done = advance(work.errors, work.slopes, prior, work.bounds, np.array(row["x"]), row["damping"])
        message = f"converged in round {k}" if done else f"stopped after round {k}" if k == MOST_ROUNDS else ""
        seconds = row["seconds"] + time.perf_counter() - begun
        row = FitRound(round=k, x=x.tolist(), damping=damping, seconds=seconds, message=message)
        if log is not None:
            log.append(key, row)
    return row


def _key(bench: Bench, recordings: Sequence[BenchRecording], names: Sequence[str], held: Mapping[str, float]) -> str:
    """Return a hash of all that a fit depends on: bench, recordings, fitted parameters and given values."""
    content = (bench, names, sorted(held.items()), [replace(r, time=0, angle=0, goal=0) for r in recordings])  # type: ignore[arg-type]
    data = [column.tobytes() for r in recordings for column in (r.time, r.angle, r.goal)]
    return sha256(b"".join([in_full(content).encode(), *data])).hexdigest()[:16]


def leave_out(
    recordings: Sequence[BenchRecording],
    bench: Bench,
    friction: str = "m4p",
    by: Callable[[BenchRecording], object] = lambda r: r.gain,
    **options: Any,
) -> dict[object, tuple[ServoFit, list[np.ndarray], np.ndarray]]:
    """Cross-validate: predict each group of recordings with a fit to all others.

    Parameters
    ----------
    recordings : sequence of BenchRecording
    bench : Bench
    friction : str
        As for `fit_servo`.
    by : callable
        Returns the group of a recording, by default its gain.
    **options
        Options of `fit_servo`.

    Returns
    -------
    dict of object to (ServoFit, list of (k,) ndarray, (recordings,) ndarray)
        For each group the fit to all others, the angles that it predicts at the times of the group's recordings
        [rad], and their mean absolute errors [rad].

    Raises
    ------
    ValueError
        If there are fewer than two groups, and as `fit_servo`.
    """
    recordings = _checked(recordings, bench)
    groups = sorted({by(r) for r in recordings}, key=str)
    if len(groups) < 2:
        raise ValueError(f"there is one group, {groups[0]}; give recordings of two or more")
    results: dict[object, tuple[ServoFit, list[np.ndarray], np.ndarray]] = {}
    for group in groups:
        fit = fit_servo([r for r in recordings if by(r) != group], bench, friction, **options)
        rest = [r for r in recordings if by(r) == group]
        angles = fit.predict(rest)
        results[group] = fit, angles, np.array([np.abs(a - r.angle).mean() for a, r in zip(angles, rest)])
    return results


def _checked(recordings: Sequence[BenchRecording], bench: Bench) -> list[BenchRecording]:
    instance("bench", bench, Bench, f"give one of {', '.join(BENCHES)} in BENCHES")
    return check_recordings(recordings, BenchRecording)


# ---------------------------------------------------------------------------------------------- rollouts


class _World(NamedTuple):
    """Numbers of one simulation, by the names of `Worlds`."""

    servos: dict[str, float]
    mass: float  # of the rod with its weight [kg]
    center: float  # below the axis [m]
    inertia: float  # about its center of mass [kg m^2]


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
        "coulomb_friction": values["coulomb_friction"],
        "viscous_friction": values["viscous_friction"],
        **own,
    }
    rod, m, l = values["rod_mass"], recording.mass, recording.length
    mass = m + rod
    center = (m * l + 0.5 * rod * l) / mass
    return _World(servos, mass, center, m * l * l + rod * l * l / 3.0 - mass * center * center)


_SERVO = Servo(
    Controller("state", period=STEP, lag=0.0), Gearbox(1.0), resistance=1.0, motor_constant=1.0, voltage_limit=1.0
)  # what a world's numbers go into


def _scene(bench: Bench, world: _World) -> CompiledScene:
    """Compile the bench."""
    servo = servo_with(_SERVO, world.servos)
    model = pendulum(f"{bench.name}_bench", servo, world.mass, world.center, world.inertia)
    kind: GearboxKind = "rotor" if servo.gearbox.stiffness == math.inf else "mipsd"
    return compile_scene(model, kind, integrator="implicit_euler", timestep=STEP)


def pendulum(name: str, servo: Servo, mass: float, length: float, inertia: float = 0.0) -> Model:
    """Return a robot whose only joint, `turn`, is the servo, with a rod that hangs down at zero.

    Parameters
    ----------
    name : str
    servo : Servo
    mass : float
        Of rod and weight [kg].
    length : float
        From the axis to their center of mass [m].
    inertia : float
        About that [kg m^2]; 0 of a weight alone.

    Returns
    -------
    Model
    """
    links = (
        Link("stand", 1.0, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)),
        Link("rod", mass, (0.0, 0.0, -length), (inertia, 0.0, 0.0, inertia, 0.0, inertia)),
    )
    joint = Joint("turn", "continuous", "stand", "rod", axis=(0.0, -1.0, 0.0))
    return Model(name, links, (joint,), servos={"turn": servo})


class _Rollouts:
    """Simulations of all recordings with several sets of values at once, eight to a vector."""

    def __init__(self, bench: Bench, recordings: Sequence[BenchRecording]) -> None:
        self.bench, self.recordings, self.count = bench, list(recordings), 0
        self.steps = max(map(_steps, self.recordings))
        self.held = [_held(r, self.steps) for r in self.recordings]
        self.scene: CompiledScene | None = None  # of the first call

    def __call__(self, sets: Sequence[dict[str, float]]) -> list[list[np.ndarray]]:
        """Return the angles of each recording at its times [rad], for each set of values."""
        n = len(self.recordings)
        pairs = [(values, k) for values in sets for k in range(n)]
        self.count += len(pairs)
        worlds = [_numbers_of(self.bench, self.recordings[k], values) for values, k in pairs]
        servos, *others = worlds[0]  # one more world, so that in every batch the same numbers differ: for one kernel
        worlds.append(_World({k: 1.01 * x + 1e-6 for k, x in servos.items()}, *(1.01 * x + 1e-6 for x in others)))
        self.scene = self.scene or _scene(self.bench, worlds[0])
        scenes = _scenes(self.scene, worlds)
        runs = each_once(lambda scene: prepare(scene, self.steps * STEP, ("q",), STEP), scenes)
        begun: dict[tuple[int, float], tuple[RunInput, np.ndarray]] = {}
        for values, k in pairs:
            if (k, values["zero"]) not in begun:
                begun[k, values["zero"]] = self._begin(runs[k], self.recordings[k], values["zero"])
        alike: dict[Hashable, list[int]] = {}  # several where a value at its bound leaves a part of the servo out
        for i, key in enumerate(each_once(family, runs)):
            alike.setdefault(key, []).append(i)
        parts: list[tuple[CompiledRun, list[int]]] = []
        for members in alike.values():
            own = list({id(runs[i]): runs[i] for i in members}.values())
            lanes = own[0].among([*own, _released(own[0])])
            order = sorted(set(members) - {len(pairs)}, key=lambda i: self.held[pairs[i][1]])  # those released together
            parts.extend((lanes, order[i : i + WIDTH]) for i in range(0, len(order), WIDTH))

        def advance(job: tuple[CompiledRun, list[int]]) -> np.ndarray:
            lanes, part = job
            found = [begun[k, values["zero"]] for values, k in (pairs[i] for i in part)]
            starts = [start._replace(compiled=runs[i]) for i, (start, _) in zip(part, found)]
            held = [self.held[pairs[i][1]] for i in part]
            return self._advance(lanes, starts, [ticks for _, ticks in found], held)

        angles: list[np.ndarray] = [np.empty(0)] * len(pairs)
        for (_, part), paths in zip(parts, over_threads(runs[0], advance, parts, os.cpu_count() or 1)):
            for i, path in zip(part, paths.T):
                (values, k), times = pairs[i], STEP * np.arange(len(path))
                time = self.recordings[k].time - values["angle_age"] - self.recordings[k].time[0]
                angles[i] = np.interp(time, times, path) + values["zero"]
        return [angles[k : k + n] for k in range(0, len(angles), n)]

    def _begin(self, run: CompiledRun, r: BenchRecording, zero: float) -> tuple[RunInput, np.ndarray]:
        """Return what a recording starts from, and what its controller sees at each tick (ticks, 1, 2)."""
        times = r.time - r.time[0] - self.bench.goal_lead - EARLY
        goal = Reference(times, r.goal[:, None] - zero, "hold")
        start = run.start(initial_state(run.scene, [r.angle[0] - zero]), goal)
        return start, sampled(start, run.schedule(start.y), 0, self.steps)

    def _advance(
        self, lanes: CompiledRun, starts: list[RunInput], ticks: list[np.ndarray], held: list[int]
    ) -> np.ndarray:
        """Simulate up to eight runs, whose bridges let go after `held` steps; return their angles (steps + 1, runs)."""
        idle, count = WIDTH - len(starts), len(starts)
        signals = Signals(None, lane_zeros((1, 2)), None, None, None, None, None, None)
        vector = Vector(lanes, signals, out=lane_zeros((self.steps + 1, 1)))
        for lane, start in enumerate([*starts, *[starts[-1]] * idle]):
            vector.put(lane, start)
        seen = lane_zeros((self.steps, 1, 2))
        seen[...] = np.stack([*ticks, *[ticks[-1]] * idle], axis=-1)
        limits, at = vector.run.scene.actuator.motor.values["current_limit"], 0
        for end in sorted({*held, self.steps}):
            plan = vector.run.plan._replace(steps=end - at)
            vector.step(vector.out[at : end + 1], plan=plan, signals=signals._replace(samples=seen[at:end]))
            limits[:, [lane for lane, last in enumerate(held) if last == end]] = OPEN
            at = end
        return vector.out[:, 0, :count]


def _steps(r: BenchRecording) -> int:
    """Return the steps of a recording, some more than it lasts: the angle's age may be negative."""
    return math.ceil((r.time[-1] - r.time[0]) / STEP) + 40


def _held(r: BenchRecording, steps: int) -> int:
    """Return the steps of a recording until the servo switches off, all if it never does."""
    return steps if r.release == math.inf else round((r.release - r.time[0]) / STEP)


def _released(run: CompiledRun) -> CompiledRun:
    """Return the run with a bridge that has let go."""
    constants = run.scene.constants
    motor = constants.actuator.motor.copy()
    motor["current_limit"] = OPEN
    constants = constants._replace(actuator=constants.actuator._replace(motor=motor))
    return replace(run, scene=replace(run.scene, constants=constants))


def _scenes(scene: CompiledScene, worlds: list[_World]) -> list[CompiledScene]:
    """Return the scene of each world; equal worlds, such as those of one gain, share one."""
    keys = [(*world.servos.values(), *world[1:]) for world in worlds]
    places = {key: k for k, key in enumerate(dict.fromkeys(keys))}
    others = list(dict(zip(keys, worlds)).values())
    zero, J = np.zeros(len(others)), np.array([world.inertia for world in others])
    links = {
        "rod.mass": np.array([world.mass for world in others]),
        "rod.center_of_mass": np.column_stack([zero, zero, [-world.center for world in others]])[:, None, :],
        "rod.inertia": np.column_stack([J, zero, zero, J, zero, J])[:, None, :],
    }
    servos = {name: np.array([world.servos[name] for world in others]) for name in others[0].servos}
    made = Worlds(servos=servos, links=links).scenes(scene)
    return [made[places[key]] for key in keys]


class _Residuals:
    """Softened errors of all recordings, over values in units of their widths."""

    def __init__(
        self,
        rollouts: _Rollouts,
        parameters: Mapping[str, Parameter],
        held: Mapping[str, float],
        progress: Callable[[], object],
    ) -> None:
        self.rollouts, self.names, self.held = rollouts, tuple(parameters), held
        self.start, low, high, self.width = (np.array([each[k] for each in parameters.values()]) for k in range(4))
        self.bounds = low / self.width, high / self.width
        self.step = COUNTED_STEP if any(held.get(name, 0.0) for name in COUNTS) else SLOPE_STEP
        self.errors = Errors(self._softened, progress)

    def values(self, x: np.ndarray) -> dict[str, float]:
        """Return the values at a point, by name."""
        return dict(zip(self.names, (x * self.width).tolist()))

    def slopes(self, x: np.ndarray) -> np.ndarray:
        """Return the slopes of the softened errors, backward where a forward step would leave the bounds."""
        return self.errors.slopes(x, np.where(x + self.step > self.bounds[1], -self.step, self.step))

    def _softened(self, points: Sequence[np.ndarray]) -> list[Blocks]:
        """Return errors whose squares grow like the absolute error beyond `SOFT`."""
        recordings = self.rollouts.recordings

        def soft(error: np.ndarray) -> np.ndarray:
            e = np.nan_to_num(error / SOFT, nan=1e3, posinf=1e3, neginf=-1e3)
            rho = np.sqrt(2.0 * (np.sqrt(1.0 + e * e) - 1.0))
            return np.copysign(rho, e) / math.sqrt(len(e) * len(recordings))

        sets = self.rollouts([{**self.values(x), **self.held} for x in points])
        return [[soft(angle - r.angle) for angle, r in zip(angles, recordings)] for angles in sets]
