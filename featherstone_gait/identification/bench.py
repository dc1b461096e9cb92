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
import re
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from typing import Any, NamedTuple

import numpy as np

from ..base.arguments import instance, one_of, real
from ..base.arguments import path as path_of
from ..base.brief import brief, in_full
from ..base.files import FilePath, Format, read_columns, read_csv
from ..base.progress import progress_bar
from ..model import Servo
from ..run.worlds import FIELDS, servo_with
from .bench_rollouts import BASE, BLANK_SERVO, TIMES, Rollouts, numbers_of
from .estimate import Blocks, Errors, Fit, information, plot_rollouts, quantile
from .gauss_newton import DAMPING, advance
from .log import FitLog, FitRound
from .recording import check_recordings

__all__ = [
    "BENCHES", "MODELS", "STS3250", "XL330", "Bench", "BenchRecording", "Parameter", "ServoFit", "fit_servo",
    "leave_out", "plot_rollouts", "read_bench",
]  # fmt: skip

FORMAT = Format("servo recording")
COLUMNS = ("time_s", "angle_rad", "goal_rad", "supply_v", "torque_on")  # of a recording; others are passed over
SOFT = 0.02  # [rad], above which an error counts by its size
PRIOR = 0.04  # of the residuals' root mean square, that a parameter off by its width counts
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
        return servo_with(BLANK_SERVO, numbers_of(self.bench, self.recordings[0], self.values | self.held).servos)

    def predict(self, recordings: Sequence[BenchRecording]) -> list[np.ndarray]:
        """Return the simulated angles (k,) of other recordings, at their times [rad]."""
        return Rollouts(self.bench, recordings)([self.values | self.held])[0]

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
        work = _Residuals(Rollouts(bench, recordings), {name: every[name] for name in names}, held, bar.update)
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


class _Residuals:
    """Softened errors of all recordings, over values in units of their widths."""

    def __init__(
        self,
        rollouts: Rollouts,
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
