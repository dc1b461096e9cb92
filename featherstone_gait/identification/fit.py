"""Servo parameters from recordings of one joint.

    recordings = [read_recording("fast.csv", Kp=61.0), read_recording("slow.csv", Kp=20.0)]
    result = identify(model, recordings, ["motor_constant", "viscous_friction", "rotor_inertia"])
    print(result.summary())

The servo, with a load whose mass is known, follows a reference; the simulated servo follows the same one, and nonlinear
least squares (`scipy.optimize.least_squares`) brings the simulated angles to the recorded ones: the output-error method
of L. Ljung, "System Identification", 2nd ed. (1999).  Parameters are fitted as logarithms, so they stay positive; where
each recording starts within its first encoder count is fitted too, if `start_range` says how wide that is.

Intervals.  With J the Jacobian of the residuals e, the covariance of textbooks is s^2 (J'J)^-1.  It takes residuals as
independent, which those of a servo are not: noise and encoder steps go round the control loop, and what the model
lacks lasts for many samples.  So s^2 J'J in the middle of the sandwich (J'J)^-1 (s^2 J'J) (J'J)^-1 is replaced by the
sum of e_i e_j J_i'J_j over neighbors, with the weights and bandwidth of Newey & West (1987, doi 10.2307/1913610) and
Andrews (1991, doi 10.2307/2938229), where that widens the interval: what narrows it in a few hundred samples is chance
as often as not.  The quantile is Student's t for the number of independent samples.  An encoder step adds step^2 / 12
to the variance, as independent noise, if the joint moves over many steps or the noise is half a step or more; at rest
under less noise it is a bias that no interval knows: record motions, not rests.  Intervals hold for a model that has
the servo's physics; `prediction_error` on a recording left out tells whether it has.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from tqdm import tqdm

from ..base.arguments import finite, floats, instance, is_real, listed, real, shown, truth
from ..base.arguments import path as path_of
from ..base.files import FilePath, Format, number, read_csv, write_csv
from ..dynamics import check_model
from ..model import SERVO_UNITS, Model
from ..run.reference import Reference
from ..run.simulate import initial_state, simulate_batch
from ..run.trajectory import Trajectory
from ..run.worlds import servo_with
from ..scene.compile import ServoKind, compile_scene
from ..view.style import BLUE, ORANGE, look
from .covariance import covariances, quantile

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMAT = Format("recording")
COLUMNS = ("time [s]", "reference [rad]", "angle [rad]", "voltage [V]")
MOTOR_OFF = {"current_limit": 1e-9}  # settings of a recording with open terminals: no current, no torque
LEAST_SAMPLES = 10
LARGEST_ANGLE = 4.0 * math.pi  # beyond it a file is taken to be in degrees [rad]
LARGEST_GAP = 0.5  # beyond it a file is taken to be in milliseconds [s]
FIXED = ("period", "encoder_resolution", "pwm_steps", "delay")  # the simulation is no smooth function of these
RANGE = 1e3  # factor either way within which a parameter is searched
LOG_STEP = 1e-3  # of the central differences, relative
START_STEP = 1e-3  # of those of the start angles [rad]
STEP = 5e-4  # of the simulation [s]: at 1 ms its kinks, where limits begin to act, shift parameters by 0.2 %
RECORD = 1e-3  # between simulated samples, if the step is shorter [s]
EARLY = 1e-7  # a command that comes with a controller tick counts for it, whatever the rounding of times [s]
UNDETERMINED = 100.0  # an interval whose ends differ by this factor says that the recordings do not tell


@dataclass(frozen=True, eq=False)
class Recording:
    """A joint that follows a reference, from rest.

    time (k,) rising from 0 [s]; reference (k,), each value held until the next [rad]; angle (k,) as measured [rad];
    voltage (k,) at the motor [V], None if it was not recorded.  settings: servo parameters that hold here alone, for
    instance {"Kp": 20.0} or `MOTOR_OFF`.  Raises ValueError on arrays and settings that do not fit.
    """

    name: str
    time: np.ndarray
    reference: np.ndarray
    angle: np.ndarray
    voltage: np.ndarray | None = None
    settings: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        instance("recording: name", self.name, str, "give a text")
        instance(f"recording {self.name}: settings", self.settings, Mapping, "give {name: value}")
        _check_names(self.settings, f"recording {self.name}: settings")
        for name, value in self.settings.items():
            if not is_real(value):
                raise ValueError(f"recording {self.name}: settings: {name} is {shown(value)}; expected a number")
        for name in ("time", "reference", "angle", "voltage"):
            if name == "voltage" and self.voltage is None:
                continue
            values = np.array(floats(f"recording {self.name}: {name}", getattr(self, name)))
            if values.ndim != 1 or values.shape != np.shape(self.time) or not np.isfinite(values).all():
                raise ValueError(
                    f"recording {self.name}: {name} has shape {values.shape}, time {np.shape(self.time)}; give as many "
                    "finite numbers of each"
                )
            object.__setattr__(self, name, values)
        if len(self.time) < LEAST_SAMPLES or self.time[0] != 0.0 or (np.diff(self.time) <= 0).any():
            raise ValueError(f"recording {self.name}: give {LEAST_SAMPLES} times or more that rise from 0")


def read_recording(path: FilePath, **settings: float) -> Recording:
    """Read a CSV with the columns `time [s]`, `reference [rad]`, `angle [rad]` and, if recorded, `voltage [V]`.

    The first time becomes 0.  settings: servo parameters that hold in this recording alone, such as Kp=20.0.
    Raises ValueError, naming file, line and column, on anything that is not such a table.
    """
    path = path_of("path", path)
    lines = list(read_csv(path, FORMAT)) or [(1, [])]
    names = _header(path, *lines[0])
    values = np.array([_row(path, line, names, row) for line, row in lines[1:]])
    if len(values) < LEAST_SAMPLES:
        raise ValueError(f"{path}: has {len(values)} samples; record {LEAST_SAMPLES} or more")
    column = {name.split()[0]: values[:, k] for k, name in enumerate(names)}
    _check_times(path, [line for line, _ in lines[1:]], column["time"])
    column["time"] = column["time"] - column["time"][0]
    return Recording(path.stem, **column, settings=settings)


def write_recording(path: FilePath, recording: Recording) -> None:
    """Write what `read_recording` reads, whole or not at all; the settings are not part of the file."""
    instance("recording", recording, Recording, "give a Recording")
    path = path_of("path", path)
    measured = (recording.time, recording.reference, recording.angle, recording.voltage)
    columns = [column for column in measured if column is not None]
    write_csv(path, FORMAT, COLUMNS[: len(columns)], np.column_stack(columns).tolist())


def _header(path: Path, line: int, row: list[str]) -> list[str]:
    names = [name.strip() for name in row]
    wrong = [name for name in names if name not in COLUMNS]
    missing = [name for name in COLUMNS[:3] if name not in names]
    if wrong or missing or len(set(names)) < len(names):
        problem = f"column {wrong[0]!r} is unknown" if wrong else f"column {missing[0]!r} is missing" if missing else ""
        raise ValueError(
            f"{path}, line {line}: {problem or 'a column is there twice'}; name the columns {', '.join(COLUMNS)} "
            "(the last may be left out), separated by commas"
        )
    return names


def _row(path: Path, line: int, names: list[str], row: list[str]) -> list[float]:
    if len(row) != len(names):
        raise ValueError(f"{path}, line {line}: has {len(row)} values, expected {len(names)}; complete or delete it")
    return [_value(path, line, name, text) for name, text in zip(names, row)]


def _value(path: Path, line: int, name: str, text: str) -> float:
    what = f"{path}, line {line}, column {name!r}: {text[:40]!r}"
    value = number(text)
    if not math.isfinite(value):
        raise ValueError(f"{what} is not a finite number; correct the value, or delete the line")
    if name.endswith("[rad]") and abs(value) > LARGEST_ANGLE:
        raise ValueError(f"{what} is more than two turns ({LARGEST_ANGLE:.4g} rad); convert degrees to radians")
    return value


def _check_times(path: Path, lines: Sequence[int], time: np.ndarray) -> None:
    steps = np.diff(time)
    wrong = (steps <= 0) | (steps > LARGEST_GAP)
    if wrong.any():
        k = int(wrong.argmax())
        remedy = f"times must rise by at most {LARGEST_GAP:g} s: sort them, give seconds, or cut the file at the gap"
        raise ValueError(
            f"{path}, line {lines[k + 1]}, column 'time [s]': {time[k + 1]:g} follows {time[k]:g}; {remedy}"
        )


@dataclass(frozen=True, eq=False)
class Identification:
    """What `identify` found.  Dictionaries and arrays are in the order of the parameters."""

    values: dict[str, float]  # [SI], see SERVO_UNITS
    intervals: dict[str, tuple[float, float]]  # confidence intervals
    start: dict[str, float]  # where the search began
    confidence: float
    standard_errors: np.ndarray  # of the logarithms, with autocorrelation
    textbook_errors: np.ndarray  # of the logarithms, as if residuals were independent
    correlation: np.ndarray  # (parameters, parameters) of the estimates
    model: Model  # with the fitted servo
    recordings: tuple[Recording, ...]
    angles: tuple[np.ndarray, ...]  # simulated, at the times of each recording [rad]
    independent_samples: float
    converged: bool
    message: str
    evaluations: int  # simulations of all recordings

    @property
    def residuals(self) -> tuple[np.ndarray, ...]:
        """Simulated less recorded angle of each recording [rad]."""
        return tuple(angle - recording.angle for angle, recording in zip(self.angles, self.recordings))

    @property
    def rms(self) -> np.ndarray:
        """Root mean square of the residuals of each recording [rad]."""
        return np.array([math.sqrt(np.mean(e**2)) for e in self.residuals])

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Parameters about which the recordings say little: the interval covers a factor of 100 or more."""
        return tuple(name for name, (low, high) in self.intervals.items() if not high < UNDETERMINED * low)

    def summary(self) -> str:
        """A table of the parameters, and how well the recordings are met."""
        samples = sum(len(recording.time) for recording in self.recordings)
        lines = [f"{'parameter':18} {'start':>10} {'value':>10} {f'{self.confidence:.0%} interval':>24}  unit"]
        for name, value in self.values.items():
            low, high = self.intervals[name]
            interval = "not determined" if name in self.undetermined else f"{low:.4g} to {high:.4g}"
            unit = SERVO_UNITS[name]
            lines.append(f"{name:18} {self.start[name]:10.4g} {value:10.4g} {interval:>24}  {unit}")
        widening = self.standard_errors / self.textbook_errors
        return "\n".join(
            [
                *lines,
                f"residuals: rms {math.degrees(math.sqrt(np.mean(np.concatenate(self.residuals) ** 2))):.3g} deg; "
                f"{samples} samples, {self.independent_samples:.0f} independent; intervals {widening.min():.2g} to "
                f"{widening.max():.2g} times those of independent residuals",
                f"search: {self.message} ({self.evaluations} evaluations)",
            ]
        )

    @look()
    def plot(self) -> Figure:
        """Recorded and simulated angles above, residuals below, a column for each recording."""
        from matplotlib.figure import Figure

        n = len(self.recordings)
        figure = Figure(figsize=(min(max(6.0, 2.4 * n), 15.0), 4.6), layout="constrained")
        panels = figure.subplots(2, n, sharex="col", sharey="row", squeeze=False, height_ratios=(2, 1))
        for k, (recording, angle, residual) in enumerate(zip(self.recordings, self.angles, self.residuals)):
            above, below = panels[:, k]
            above.plot(recording.time, np.degrees(recording.reference), color="0.7", linewidth=1.0, label="reference")
            above.plot(recording.time, np.degrees(recording.angle), color=BLUE, linewidth=2.4, label="recorded")
            above.plot(recording.time, np.degrees(angle), color=ORANGE, linewidth=1.0, label="simulated")
            below.plot(recording.time, np.degrees(residual), color="0.3", linewidth=0.6)
            above.set_title(recording.name)
            below.set_xlabel("time [s]")
        panels[0, 0].set_ylabel("angle [deg]")
        panels[1, 0].set_ylabel("simulated\n- recorded [deg]")
        figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
        return figure


def identify(
    model: Model | Sequence[Model],
    recordings: Sequence[Recording],
    parameters: Sequence[str],
    servos: ServoKind = "mipsd",
    *,
    confidence: float = 0.95,
    start_range: float = 0.0,
    voltage_weight: float = 0.0,
    timestep: float = STEP,
    progress: bool = False,
) -> Identification:
    """Fit parameters of the servo to recordings.

    model: a robot of one moving joint with a servo, whose values the search starts from; or one such robot for each
    recording, if loads differ (servo and start are then those of the first).  parameters: fields of `Servo`,
    `Controller` or `Gearbox`, see `SERVO_UNITS`; the others are known.  start_range: [rad] how far a recording may
    start from its first angle, such as an encoder step; 0: not at all.  voltage_weight: [rad/V] how much an error of
    the voltage counts beside one of the angle (ratio of their noises); 0 fits angles alone.  timestep: [s], of the
    midpoint rule; halve it to see how much it matters.
    Raises ValueError on models, recordings and parameters that do not fit.
    """
    from scipy.optimize import least_squares

    recordings = _listed(recordings)
    models = _models(model, recordings)
    start = _start(models[0], recordings, parameters)
    truth("progress", progress)
    if not (is_real(confidence) and 0 < confidence < 1):
        raise ValueError(f"confidence is {shown(confidence)}; give a share between 0 and 1, such as 0.95")
    real("voltage_weight", voltage_weight, 0.0, 1e12, "0 fits angles alone")
    if voltage_weight and any(recording.voltage is None for recording in recordings):
        raise ValueError("voltage_weight: a recording has no voltage; leave the weight 0, or record it")
    if not (is_real(start_range) and 0 <= start_range <= LARGEST_ANGLE):
        raise ValueError(f"start_range is {shown(start_range)} rad; give the encoder's step, or 0")
    fit = _Fit(models, tuple(recordings), tuple(parameters), servos, voltage_weight, timestep)
    starts = [recording.angle[0] for recording in recordings] if start_range else []
    x = np.array([*map(math.log, start.values()), *starts])
    reach = np.array([*[math.log(RANGE)] * len(start), *[start_range] * len(starts)])
    with tqdm(disable=not progress, desc="identify", unit="evaluation") as bar:
        fit.bar = bar
        found = least_squares(fit.residuals, x, fit.jacobian, (x - reach, x + reach), x_scale="jac", ftol=1e-7)
    count = len(start)
    textbook, robust, independent = covariances(found.jac, found.fun, fit.lengths(found.fun))
    spread = np.sqrt(np.diag(robust)[:count])
    textbook = np.sqrt(np.diag(textbook)[:count])
    error = np.maximum(spread, textbook)
    values = dict(zip(parameters, np.exp(found.x[:count]).tolist()))
    reach = error * quantile(confidence, independent - len(x))
    return Identification(
        values=values,
        intervals={name: (v * _exp(-r), v * _exp(r)) for (name, v), r in zip(values.items(), reach)},
        start=start,
        confidence=confidence,
        standard_errors=error,
        textbook_errors=textbook,
        correlation=robust[:count, :count] / np.outer(spread, spread),
        model=changed(models[0], **values),
        recordings=tuple(recordings),
        angles=tuple(angle for angle, _ in fit.simulated(found.x)),
        independent_samples=independent,
        converged=bool(found.success),
        message=found.message,
        evaluations=fit.evaluations,
    )


def changed(model: Model, **values: float) -> Model:
    """The model with parameters of all its servos changed: fields of `Servo`, `Controller` or `Gearbox` [SI].

    Raises ValueError on an unknown name and on a value out of range.
    """
    check_model(model)
    _check_names(values, model.name)
    return replace(model, servos={joint: servo_with(servo, values) for joint, servo in model.servos.items()})


def predict(
    model: Model,
    recordings: Sequence[Recording],
    starts: Sequence[float] | np.ndarray | None = None,
    servos: ServoKind = "mipsd",
    timestep: float = STEP,
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Angle [rad] and voltage [V] that the model has at the times of each recording, from rest.

    starts: first angles [rad]; None takes the recorded ones.
    """
    check_model(model)
    recordings = _listed(recordings)
    if starts is None:
        starts = [recording.angle[0] for recording in recordings]
    starts = finite("starts", starts, (len(recordings),), "[rad]")
    real("timestep", timestep, 1e-9, 10.0, "give seconds, 5e-4 is usual")
    results: list = [None] * len(recordings)
    alike: dict[tuple, list[int]] = {}
    for k, recording in enumerate(recordings):
        alike.setdefault(tuple(sorted(recording.settings.items())), []).append(k)
    for settings, members in alike.items():
        scene = compile_scene(changed(model, **dict(settings)), servos, integrator="midpoint", timestep=timestep)
        states = [initial_state(scene, [starts[k]], beyond_limits=True) for k in members]
        references = [Reference(recordings[k].time - EARLY, recordings[k].reference[:, None], "hold") for k in members]
        longest = max(recordings[k].time[-1] for k in members)
        sample = max(1, round(RECORD / timestep)) * timestep
        runs = simulate_batch(
            scene, longest, states, references, record=("q", "voltage"), sample=sample, estimate_error=False
        )
        for k, run in zip(members, runs):
            results[k] = _sampled(run, recordings[k].time)
    return results


def prediction_error(model: Model, recordings: Sequence[Recording], servos: ServoKind = "mipsd") -> np.ndarray:
    """Root mean square [rad] of predicted less recorded angle, of each recording: the test, if they were not fitted."""
    recordings = _listed(recordings)
    runs = predict(model, recordings, servos=servos)
    return np.array([math.sqrt(np.mean((q - r.angle) ** 2)) for (q, _), r in zip(runs, recordings)])


def _sampled(run: Trajectory, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angle, interpolated, and voltage, held, at the times of a recording."""
    grid = run["time"]
    held = np.clip(np.searchsorted(grid, time + 1e-9, side="right") - 1, 0, len(grid) - 1)
    return np.interp(time, grid, run["q"][:, 0]), run["voltage"][held, 0]


class _Fit:
    """Residuals and their Jacobian over the logarithms of the parameters and, if fitted, the start angles."""

    def __init__(
        self,
        models: Sequence[Model],
        recordings: Sequence[Recording],
        parameters: Sequence[str],
        servos: ServoKind,
        voltage_weight: float,
        timestep: float,
    ) -> None:
        self.models, self.recordings, self.parameters = models, recordings, parameters
        self.servos, self.voltage_weight, self.timestep = servos, voltage_weight, timestep
        self.evaluations = 0
        self.bar: tqdm | None = None

    def simulated(self, x: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Angle and voltage of each recording."""
        count = len(self.parameters)
        values, starts = dict(zip(self.parameters, np.exp(x[:count]))), x[count:]
        if not len(starts):
            starts = np.array([recording.angle[0] for recording in self.recordings])
        results: list = [None] * len(self.recordings)
        for model in dict.fromkeys(self.models):
            members = [k for k, other in enumerate(self.models) if other is model]
            recordings, own = [self.recordings[k] for k in members], [starts[k] for k in members]
            runs = predict(changed(model, **values), recordings, own, self.servos, self.timestep)
            for k, run in zip(members, runs):
                results[k] = run
        self.evaluations += 1
        if self.bar is not None:
            self.bar.update()
        return results

    def blocks(self, x: np.ndarray) -> list[np.ndarray]:
        """Residuals of each recording."""
        blocks = []
        for (angle, voltage), recording in zip(self.simulated(x), self.recordings):
            parts = [angle - recording.angle]
            if self.voltage_weight:
                parts.append(self.voltage_weight * (voltage - recording.voltage))
            blocks.append(np.concatenate(parts))
        return blocks

    def residuals(self, x: np.ndarray) -> np.ndarray:
        return np.concatenate(self.blocks(x))

    def lengths(self, residuals: np.ndarray) -> list[int]:
        """Lengths of the parts of the residuals that are a signal over time."""
        parts = 2 if self.voltage_weight else 1
        return [len(recording.time) for recording in self.recordings for _ in range(parts)]

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """Central differences; a start angle moves its own recording only, so all take two evaluations."""
        count = len(self.parameters)
        columns = []
        for k in range(count):
            step = np.zeros(len(x))
            step[k] = LOG_STEP
            columns.append((self.residuals(x + step) - self.residuals(x - step)) / (2.0 * LOG_STEP))
        if len(x) == count:
            return np.column_stack(columns)
        step = np.where(np.arange(len(x)) < count, 0.0, START_STEP)
        ends = zip(self.blocks(x + step), self.blocks(x - step))
        slopes = [(above - below) / (2.0 * START_STEP) for above, below in ends]
        starts = np.zeros((sum(map(len, slopes)), len(slopes)))
        first = 0
        for k, slope in enumerate(slopes):
            starts[first : first + len(slope), k] = slope
            first += len(slope)
        return np.column_stack([*columns, starts])


def _exp(x: float) -> float:
    return math.exp(min(max(x, -700.0), 700.0))


def _listed(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings.  Raises ValueError or TypeError for what is no list of them."""
    found = listed("recordings", recordings, "give a list of Recording")
    if not found:
        raise ValueError("recordings: there is no recording; give one or more, see read_recording")
    for recording in found:
        instance("recordings", recording, Recording, "give a list of Recording")
    return found


def _models(model: Model | Sequence[Model], recordings: Sequence[Recording]) -> tuple[Model, ...]:
    """The robot of each recording, checked."""
    remedy = "give a Model, or one for each recording"
    models = (model,) * len(recordings) if isinstance(model, Model) else tuple(listed("model", model, remedy))
    for one in models:
        check_model(one)
    if len(models) != len(recordings):
        raise ValueError(f"{len(models)} models and {len(recordings)} recordings; give one model, or one for each")
    for one in dict.fromkeys(models):
        if one.base != "fixed" or len(one.joint_names) != 1 or one.joint_names[0] not in one.servos:
            raise ValueError(
                f"{one.name}: {one.base} base, moving joints {', '.join(one.joint_names) or 'none'}; a recording is of "
                "a fixed robot with one moving joint that has a servo: lock the others"
            )
    servo = models[0].servos[models[0].joint_names[0]]
    driven = {one: replace(one, servos={one.joint_names[0]: servo}) for one in dict.fromkeys(models)}
    return tuple(driven[one] for one in models)


def _start(model: Model, recordings: Sequence[Recording], parameters: Sequence[str]) -> dict[str, float]:
    """Where the search begins: the model's values."""
    parameters = listed("parameters", parameters, "give a list of names, each once")
    _check_names(parameters, "parameters")
    if not parameters or len(set(parameters)) < len(parameters):
        raise ValueError(f"parameters are {parameters!r}; give a list of names, each once")
    servo = model.servos[model.joint_names[0]]
    values = {f.name: getattr(part, f.name) for part in (servo, servo.controller, servo.gearbox) for f in fields(part)}
    for name in parameters:
        if name in FIXED:
            raise ValueError(f"parameters: {name} cannot be fitted, the motion is no smooth function of it; set it")
        if not 0 < values[name] < math.inf:
            raise ValueError(
                f"parameters: {name} starts at {values[name]!r} {SERVO_UNITS[name]}; it is searched as a logarithm: "
                "give the model's servo a finite value > 0 to start from"
            )
        if any(name in recording.settings for recording in recordings):
            raise ValueError(f"parameters: {name} is set by a recording; fit it, or give it, but not both")
    return {name: float(values[name]) for name in parameters}


def _check_names(names: Iterable[str], where: str) -> None:
    for name in names:
        if not isinstance(name, str) or name not in SERVO_UNITS:
            raise ValueError(f"{where}: a servo has no parameter {shown(name)}; parameters: {', '.join(SERVO_UNITS)}")
