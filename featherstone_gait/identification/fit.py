"""Servo parameters from recordings of one joint.

    recordings = [read_recording("fast.csv", Kp=61.0), read_recording("slow.csv", Kp=20.0)]
    result = identify(model, recordings, ["motor_constant", "viscous_friction", "rotor_inertia"])
    print(result.summary())

The servo, with a load whose mass is known, follows a reference; the simulated servo follows the same one, and nonlinear
least squares (`scipy.optimize.least_squares`) brings the simulated angles to the recorded ones: the output-error method
of L. Ljung, "System Identification", 2nd ed. (1999).  Parameters are fitted as logarithms, so they stay positive.
Where each recording starts is fitted too, since its first angle is as noisy as the others: `start_range` says how far
from there it may be.

Counts.  With a servo that counts angles or voltages the errors are a staircase of the parameters: their differences are
noise, and a search by them ends where it began.  So slopes are those without counts, and the search begins at the
optimum without counts; errors are those with counts.

Intervals.  With J the Jacobian of the residuals e, the covariance of textbooks is s^2 (J'J)^-1.  It takes residuals as
independent, which those of a servo are not: noise and encoder steps go round the control loop, and what the model
lacks lasts for many samples.  So s^2 J'J in the middle of the sandwich (J'J)^-1 (s^2 J'J) (J'J)^-1 is replaced by
J'VJ, V the covariance of noise that is an autoregression over time (`estimate.py`), where that widens the interval.
What a fit takes away from slow noise is put back: without that, and with the weights of Newey & West (1987), noise
correlated over 50 ms left 95 % intervals that held in 60 to 85 of 100 trials.  The quantile is Student's t for the
number of independent samples.  An encoder step adds step^2 / 12 to the variance, as independent noise, if the joint
moves over many steps or the noise is half a step or more; at rest under less noise it is a bias that no interval knows:
record motions, not rests.  Intervals hold for a model that has the servo's physics; `prediction_error` on a recording
left out shows whether it has.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from ..base.arguments import finite, is_real, listed, real, shown, truth
from ..base.brief import brief
from ..base.progress import progress_bar
from ..dynamics import check_model
from ..model import SERVO_UNITS, Model
from ..run.reference import Reference
from ..run.simulate import initial_state, simulate_batch
from ..run.trajectory import Trajectory
from ..run.worlds import servo_with
from ..scene.actuator import servo_gearbox
from ..scene.compile import GearboxKind, compile_scene
from .estimate import Blocks, Errors, Fit, covariances, quantile
from .recording import EARLY, LARGEST_ANGLE, Recording, check_names, check_recordings

FIXED = ("period", "encoder_resolution", "pwm_steps", "delay")  # the simulation is no smooth function of these
UNCOUNTED = {"encoder_resolution": 0.0, "pwm_steps": 0.0}
RANGE = 1e3  # factor either way within which a parameter is searched
LOG_STEP = 1e-3  # of the central differences, relative
START_STEP = 1e-3  # of those of the start angles [rad]
STEP = 5e-4  # of the simulation [s]: at 1 ms the discontinuities where limits begin to act shift parameters by 0.2 %
RECORD = 1e-3  # between simulated samples, if the step is shorter [s]
UNDETERMINED = 100.0  # ratio of an interval's ends from which on the recordings do not determine a parameter


@dataclass(frozen=True, eq=False)
class Identification(Fit):
    """Parameters of a servo that `identify` has fitted to recordings.

    Attributes
    ----------
    values, start, intervals, units, confidence, correlation, recordings, angles, message
        As in `Fit`.
    standard_errors : (parameters,) ndarray
        Of the logarithms of the parameters, for residuals that are correlated over time.
    textbook_errors : (parameters,) ndarray
        The same as if residuals were independent.
    model : Model
        The robot with the fitted servo.
    independent_samples : float
        Number of independent samples with as much information as all samples.
    converged : bool
    evaluations : int
        Simulations of all recordings.
    """

    standard_errors: np.ndarray
    textbook_errors: np.ndarray
    model: Model
    independent_samples: float
    converged: bool
    evaluations: int

    __repr__ = brief

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Parameters about which the recordings say little: the interval covers a factor of 100 or more."""
        return tuple(name for name, (low, high) in self.intervals.items() if not high < UNDETERMINED * low)

    def summary(self) -> str:
        """Return a table of the parameters, and how well the recordings are met, as text."""
        widening = self.standard_errors / self.textbook_errors
        residuals = np.concatenate(self.residuals)
        return "\n".join(
            [
                *self.table(),
                f"residuals: rms {math.degrees(math.sqrt(np.mean(residuals**2))):.3g} deg; {len(residuals)} samples, "
                f"{self.independent_samples:.0f} independent; intervals {widening.min():.2g} to {widening.max():.2g} "
                "times those of independent residuals",
                f"search: {self.message} ({self.evaluations} evaluations)",
            ]
        )


def _most(start_range: float | None) -> float:
    """Return how far the joint may start from the first recorded angle [rad]."""
    if start_range is None:
        return math.inf
    return real("start_range", start_range, 0.0, LARGEST_ANGLE, "give the encoder's step [rad], 0, or None")


def identify(
    model: Model | Sequence[Model],
    recordings: Sequence[Recording],
    parameters: Sequence[str],
    gearbox: GearboxKind | None = None,
    *,
    confidence: float = 0.95,
    start_range: float | None = None,
    voltage_weight: float = 0.0,
    timestep: float = STEP,
    progress: bool = False,
) -> Identification:
    """Fit parameters of a servo to recordings of its joint.

    Parameters
    ----------
    model : Model or sequence of Model
        A robot with one moving joint and a servo, at whose values the search starts; or one such robot for each
        recording, if loads differ (the servo is then that of the first).
    recordings : sequence of Recording
    parameters : sequence of str
        Fields of `Servo`, `Controller` or `Gearbox` to fit, see `SERVO_UNITS`; the others are known.
    gearbox : {"mipsd", "rotor", "standard"}, optional
        Gearbox model; None: "mipsd" if all gears are elastic, else "rotor".
    confidence : float
        Probability of the intervals.
    start_range : float, optional
        How far the joint may start from the first recorded angle [rad], such as an encoder step; 0: not at all, and
        intervals take the first angles as exact.  None: as far as the angles say.
    voltage_weight : float
        Weight of an error of the voltage beside one of the angle [rad/V], the ratio of their noises; 0 fits angles
        alone.
    timestep : float
        Of the midpoint rule [s]; halve it to see how much it matters.
    progress : bool
        Show a progress bar.

    Returns
    -------
    Identification

    Raises
    ------
    ValueError
        If models, recordings and parameters do not fit together.
    """
    recordings = check_recordings(recordings, Recording)
    models = _models(model, recordings)
    start = _start(models[0], recordings, parameters)
    truth("progress", progress)
    if not (is_real(confidence) and 0 < confidence < 1):
        raise ValueError(f"confidence is {shown(confidence)}; give a share between 0 and 1, such as 0.95")
    most = _most(start_range)
    real("voltage_weight", voltage_weight, 0.0, 1e12, "0 fits angles alone")
    if voltage_weight and any(recording.voltage is None for recording in recordings):
        raise ValueError("voltage_weight: a recording has no voltage; leave the weight 0, or record it")
    kind = servo_gearbox(models[0], gearbox)
    work = _Simulations(models, recordings, tuple(parameters), kind, voltage_weight, timestep)
    count, own = len(start), len(recordings) if most else 0
    x = np.array([*map(math.log, start.values()), *[recording.angle[0] for recording in recordings[:own]]])
    reach = np.array([math.log(RANGE)] * count + [most] * own)
    from scipy.optimize import least_squares  # slow to import

    steps = np.array([LOG_STEP] * count + [START_STEP] * own)
    with progress_bar(progress=progress, desc="identify", unit="evaluation") as bar:
        smooth, errors = Errors(work.smooth().errors, bar.update), Errors(work.errors, bar.update)
        slopes = lambda x: smooth.slopes(x, steps, central=True, own=own)  # noqa: E731
        bounds = x - reach, x + reach
        if work.counts:
            x = least_squares(smooth, x, slopes, bounds, x_scale="jac", ftol=1e-7).x
        found = least_squares(errors, x, slopes, bounds, x_scale="jac", ftol=1e-7)
    lengths = [len(recording.time) for recording in recordings for _ in range(2 if voltage_weight else 1)]
    textbook, robust, independent = covariances(found.jac, found.fun, lengths)
    spread, textbook = (np.sqrt(np.diag(matrix)[:count]) for matrix in (robust, textbook))
    error = np.maximum(spread, textbook)
    values = dict(zip(parameters, np.exp(found.x[:count]).tolist()))
    widths = error * quantile(confidence, independent - len(x))
    return Identification(
        values=values,
        start=start,
        intervals={name: (v * _exp(-w), v * _exp(w)) for (name, v), w in zip(values.items(), widths)},
        units=SERVO_UNITS,
        confidence=confidence,
        correlation=robust[:count, :count] / np.outer(spread, spread),
        recordings=tuple(recordings),
        angles=tuple(angle for angle, _ in work.simulated(found.x)),
        message=found.message,
        standard_errors=error,
        textbook_errors=textbook,
        model=changed(models[0], **values),
        independent_samples=independent,
        converged=bool(found.success),
        evaluations=errors.evaluations + smooth.evaluations,
    )


def changed(model: Model, **values: float) -> Model:
    """Return the model with parameters of all its servos changed.

    Parameters
    ----------
    model : Model
    **values : float
        Fields of `Servo`, `Controller` or `Gearbox` [SI].

    Returns
    -------
    Model

    Raises
    ------
    ValueError
        For an unknown name and for a value out of range.
    """
    check_model(model)
    check_names(values, model.name)
    return replace(model, servos={joint: servo_with(servo, values) for joint, servo in model.servos.items()})


def predict(
    model: Model,
    recordings: Sequence[Recording],
    starts: Sequence[float] | np.ndarray | None = None,
    gearbox: GearboxKind | None = None,
    timestep: float = STEP,
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Simulate a model from rest with the references of recordings.

    Parameters
    ----------
    model : Model
    recordings : sequence of Recording
    starts : sequence of float, optional
        First angles [rad]; by default the recorded ones.
    gearbox : {"mipsd", "rotor", "standard"}, optional
        Gearbox model; None: "mipsd" if all gears are elastic, else "rotor".
    timestep : float
        Of the midpoint rule [s].

    Returns
    -------
    list of ((k,) ndarray, (k,) ndarray)
        Angle [rad] and voltage [V] at the times of each recording.
    """
    check_model(model)
    recordings = check_recordings(recordings, Recording)
    if starts is None:
        starts = [recording.angle[0] for recording in recordings]
    starts = finite("starts", starts, (len(recordings),), "[rad]")
    return _predicted([model] * len(recordings), recordings, starts, servo_gearbox(model, gearbox), timestep)


def _predicted(
    models: Sequence[Model],
    recordings: Sequence[Recording],
    starts: Sequence[float] | np.ndarray,
    gearbox: GearboxKind,
    timestep: float,
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Simulate each recording's model; those with equal settings share a scene, and lanes."""
    real("timestep", timestep, 1e-9, 10.0, "give seconds, 5e-4 is usual")
    found: dict[int, tuple[np.ndarray, np.ndarray]] = {}
    groups: dict[tuple[Model, tuple], list[int]] = {}
    for k, (model, recording) in enumerate(zip(models, recordings)):
        groups.setdefault((model, tuple(sorted(recording.settings.items()))), []).append(k)
    for (model, settings), members in groups.items():
        scene = compile_scene(changed(model, **dict(settings)), gearbox, integrator="midpoint", timestep=timestep)
        runs = simulate_batch(
            scene,
            max(recordings[k].time[-1] for k in members),
            [initial_state(scene, [starts[k]], allow_limit_violation=True) for k in members],
            [Reference(recordings[k].time - EARLY, recordings[k].reference[:, None], "hold") for k in members],
            record=("q", "voltage"),
            record_interval=max(1, round(RECORD / timestep)) * timestep,
            estimate_error=False,
        )
        found |= {k: _sampled(run, recordings[k].time) for k, run in zip(members, runs)}
    return [found[k] for k in range(len(recordings))]


def prediction_error(model: Model, recordings: Sequence[Recording], gearbox: GearboxKind | None = None) -> np.ndarray:
    """Return how well a model predicts recordings, which is a test if they were not fitted.

    Parameters
    ----------
    model : Model
    recordings : sequence of Recording
    gearbox : {"mipsd", "rotor", "standard"}, optional
        Gearbox model; None: "mipsd" if all gears are elastic, else "rotor".

    Returns
    -------
    (recordings,) ndarray
        Root mean square of predicted less recorded angle [rad].
    """
    recordings = check_recordings(recordings, Recording)
    runs = predict(model, recordings, gearbox=gearbox)
    return np.array([math.sqrt(np.mean((q - r.angle) ** 2)) for (q, _), r in zip(runs, recordings)])


def _sampled(run: Trajectory, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return angle, interpolated, and voltage, held, at the times of a recording."""
    grid = run["time"]
    held = np.clip(np.searchsorted(grid, time + 1e-9, side="right") - 1, 0, len(grid) - 1)
    voltage = run["voltage"][held, 0] if run["voltage"].size else np.full(len(time), np.nan)  # of a torque law
    return np.interp(time, grid, run["q"][:, 0]), voltage


@dataclass(frozen=True, eq=False)
class _Simulations:
    """Recordings simulated at points: logarithms of the parameters and, if fitted, the start angles."""

    models: Sequence[Model]  # of each recording
    recordings: Sequence[Recording]
    parameters: Sequence[str]
    gearbox: GearboxKind
    voltage_weight: float
    timestep: float

    @property
    def counts(self) -> bool:
        """Return whether a servo rounds angles or voltages to counts: the errors then change in jumps."""
        both = zip(self.models, self.recordings)
        servos = [servo_with(model.servos[model.joint_names[0]], r.settings) for model, r in both]
        return any(servo.encoder_resolution or servo.controller.pwm_steps for servo in servos)

    def smooth(self) -> _Simulations:
        """Return the same without counts, whose errors have slopes."""
        if not self.counts:
            return self
        recordings = [replace(one, settings={**one.settings, **UNCOUNTED}) for one in self.recordings]
        return replace(self, recordings=recordings)

    def simulated(self, x: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return angle and voltage of each recording."""
        count = len(self.parameters)
        values, starts = dict(zip(self.parameters, np.exp(x[:count]))), x[count:]
        if not len(starts):
            starts = np.array([recording.angle[0] for recording in self.recordings])
        fitted = {model: changed(model, **values) for model in dict.fromkeys(self.models)}
        models = [fitted[model] for model in self.models]
        return _predicted(models, self.recordings, starts, self.gearbox, self.timestep)

    def errors(self, points: Sequence[np.ndarray]) -> list[Blocks]:
        """Return the errors of the angle [rad] of each recording, and of the voltage where it has a weight."""
        w = self.voltage_weight
        return [
            [
                np.concatenate([angle - r.angle, *([w * (voltage - r.voltage)] if w else [])])
                for (angle, voltage), r in zip(self.simulated(x), self.recordings)
            ]
            for x in points
        ]


def _exp(x: float) -> float:
    return math.exp(min(max(x, -700.0), 700.0))


def _models(model: Model | Sequence[Model], recordings: Sequence[Recording]) -> tuple[Model, ...]:
    """Return the robot of each recording, with the servo of the first."""
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
    """Return the model's values, at which the search starts."""
    parameters = listed("parameters", parameters, "give a list of names, each once")
    check_names(parameters, "parameters")
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
