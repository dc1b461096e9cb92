"""Estimate the global error of a run from a second run in other steps.

The error is a share of the difference of the two runs.  `docs/theory/error_control.md` has a table of second runs and
shares, with the reasons.  A run that the second run makes inaccurate gets a third one, whose verdict counts: on stiff
stops errors grow faster than any power of the step, and where steps are long they fall faster than the tolerance.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..core.effects.energies import ENERGIES
from ..core.step import pace
from ..scene.channels import joint_labels, unit_of
from ..scene.compile import CompiledScene
from ..scene.external import Push
from ..scene.friction import widened
from .classify import beyond_stability
from .prepare import steps_between_records, with_tolerance
from .reference import Reference
from .status import Status
from .trajectory import Trajectory, with_error

COARSER = 10.0  # tolerance of the second run, by the run's
SHARE = 0.35  # of the difference, that is taken for the error
WHOLE_OF_IT = 1.0  # where the second run is finer or has wider friction, or where discontinuities decide, as of pairs
OF_TENTH = 1.2  # of the difference to a third run at a tenth of the tolerance, which has a tenth of the error or more
STRICTEST = 1e-14  # tolerance
# Of a controller that counts, a joint may hover at the edge of a count, where two alike runs are on the wrong side.
FAR_FINER = 1000.0  # tolerance of the second run there, by the run's: half as much again in time as a tenth of it
DECIDED = 1e-9  # tolerance up to which counts are decided
MANY = 0.5  # of those taken; some 0.1 are of a smooth motion
OF_TWICE, OF_HALF = {1: 2.4, 2: 1.2}, 2.0  # of a step of 2 h, by order, others `OF_HIGHER`; of h / 2
OF_HIGHER = 0.38
OF_ROOT = 3.4  # of h / 2, where the error may fall with the root of h
ORDERLY = 0.05  # by how much the share that halving the step leaves of a difference may be off a half
WITHIN_STEPS = 1e-6  # tolerance of the second run where something changes within fixed steps
ON_STEP = 1e-6  # of a step, by which an edge may be off it
ROUNDING = 1e-13  # of the values, the least error that is estimated
LIMIT = 1e-3  # of angles [rad] and positions [m]: beyond it a run is inaccurate
FIXED_LIMIT = 1e-2  # the same at fixed steps, which are chosen by name
SPEED_LIMIT = 10.0  # of speeds by the largest there is or 1, in the above: an impact a moment late is a jump missed
SLOWEST = 0.03  # in place of 1 of a body's velocity where bodies touch each other and error control runs [m/s]
ENERGY_LIMIT = 1e-2  # of energies, where they are recorded, by the largest there is ...
LEAST_ENERGY = 1e-3  # ... or this [J]


class SecondRun(NamedTuple):
    """Scene and tolerances of the second run, and the share of the difference to take as the error."""

    scene: CompiledScene
    rtol: float | None = None
    atol: float | None = None
    share: float = WHOLE_OF_IT  # of the difference to the run, that is the run's error
    finer: SecondRun | None = None  # a third run, where the second makes the run inaccurate; its share is not used

    @property
    def changes(self) -> dict[str, Any]:
        """Return what differs from the run."""
        return {"scene": self.scene, "rtol": self.rtol, "atol": self.atol}


def second_run(
    scene: CompiledScene, rtol: float | None, atol: float | None, record_interval: float | None, edges: int = 2
) -> SecondRun | None:
    """Choose the second run of a scene, with `edges_on_steps`; None where steps are fixed and there is none.

    That is of "simtwo", which has no continuous limit, and of a scene with constants put in by hand.
    """
    if rtol is not None and atol is not None:
        finer = SecondRun(scene, max(rtol / COARSER, STRICTEST), max(atol / COARSER, STRICTEST))
        if scene.counts and rtol > DECIDED:
            if scene.method.name == "extrapolation":
                return SecondRun(scene, max(rtol / FAR_FINER, DECIDED), max(atol / FAR_FINER, DECIDED))
            return finer
        other = _with_coarser_tolerance(scene)
        coarser = SecondRun(other, min(1.0, COARSER * rtol), min(1.0, COARSER * atol))
        softer = other.constants.friction is not scene.constants.friction
        share = WHOLE_OF_IT if scene.pairs or (scene.method.soft and scene.stiff) else SHARE
        return coarser if softer else coarser._replace(share=share, finer=finer)
    if scene.method.drives or scene.by_hand:
        return None
    if edges == 0:
        other, rtol, atol = _with_error_control(scene)
        wide = _softer(other)
        return SecondRun(other if wide is None else wide, rtol, atol)
    wide = _softer(_with_step(scene, 0.5)) if scene.method.soft else None
    if wide is not None:
        return SecondRun(wide, share=OF_ROOT)  # where friction chatters, too
    every, tick, delay = steps_between_records(scene, record_interval), scene.tick_steps, scene.constants.firmware.delay
    if edges == 2 and every % 2 == 0 and tick % 2 == 0 and (delay is None or delay.shift % 2 == 0):
        coarse = _with_step(scene, 2.0)
        if not beyond_stability(coarse):
            share = OF_TWICE.get(scene.method.order, OF_HIGHER)
            return SecondRun(coarse, share=share, finer=SecondRun(_with_step(scene, 0.5)))
    return SecondRun(_with_step(scene, 0.5), share=OF_HALF)


def edges_on_steps(
    scene: CompiledScene,
    begin: float,
    pushes: Sequence[Push],
    torques: Reference | ArrayLike | None = None,
    reference: Reference | None = None,
    until: float = math.inf,
) -> int:
    """Return 2 if what acts on a run changes at every second of its steps only, 1 at steps, else 0.

    The run goes from `begin` to `until` [s].

    Sampled controllers see their reference at ticks: it does not count.
    """
    times, periods = [np.array([push.start, push.end]) for push in pushes], []
    followed = scene.follows and not scene.sampled
    for signal in (torques, reference if followed else None):
        if isinstance(signal, Reference) and (signal.values != signal.values[0]).any():
            times.append(signal.times)
            periods += [float(signal.times[-1] - signal.times[0])] * signal.cyclic
    ends = (t for t in np.concatenate([[], *times]).tolist() if math.isfinite(t) and (periods or begin < t < until))
    edges = np.array([t - begin for t in ends])
    steps = np.append(edges, periods) / scene.timestep
    return next((n for n in (2, 1) if (np.abs(steps - n * np.round(steps / n)) < ON_STEP).all()), 0)


@functools.lru_cache(maxsize=16)
def _with_coarser_tolerance(scene: CompiledScene) -> CompiledScene:
    """Return the scene whose integrator takes its steps as a second run; one object, for it remembers its layout."""
    other = replace(scene, method=scene.method._replace(second_run=True))
    wide = _softer(other)
    return other if wide is None else wide


def _softer(scene: CompiledScene) -> CompiledScene | None:
    """Return the scene with twice as wide dry friction about rest, None unless explicit steps widen it."""
    wide: dict[str, Any] = {}
    if scene.method.soft:
        found = widened(scene.constants.friction, scene.model, scene.gearbox is not None, 2.0)
        wide |= {} if found is None else {"friction": found}
        along = scene.constants.tendons
        if along is not None and along.friction is not None:
            rubs = along.friction.copy()
            rubs["steepness"] /= 2.0
            wide["tendons"] = along._replace(friction=rubs)
    if not wide:
        return None
    constants, compiled = (one._replace(**wide) for one in (scene.constants, scene.compiled))
    return replace(scene, constants=constants, compiled=compiled)


@functools.lru_cache(maxsize=16)
def _with_step(scene: CompiledScene, factor: float) -> CompiledScene:
    """Return the scene with so many times its step, and the same ticks."""
    other = scene.recompiled(timestep=factor * scene.timestep)
    return replace(other, tick_steps=round(scene.tick_steps / factor))


@functools.lru_cache(maxsize=16)
def _with_error_control(scene: CompiledScene) -> tuple[CompiledScene, float | None, float | None]:
    """Return the scene with steps of any length, and the tolerances."""
    return with_tolerance(scene, WITHIN_STEPS, WITHIN_STEPS)


def with_error_estimate(run: Trajectory, other: Trajectory, share: float, record: Sequence[str]) -> Trajectory:
    """Return the run with its error, a share of the difference to another; inaccurate if that is too large.

    Only the channels of `record` are kept.
    """
    error = _difference(run, other, share)
    error = {name: e + ROUNDING * np.abs(run[name]) for name, e in error.items()}
    run = with_accuracy(replace(run, error=error))
    return replace(with_channels(run, record), second_final=other.final)


def with_channels(run: Trajectory, record: Sequence[str]) -> Trajectory:
    """Return the run with the channels of `record` alone, and with their errors."""
    channels = {name: values for name, values in run.channels.items() if name in ("time", *record)}
    error = run.error and {name: values for name, values in run.error.items() if name in record}
    return replace(run, channels=channels, error=error)


def with_accuracy(run: Trajectory) -> Trajectory:
    """Return the run, `inaccurate` if coordinates or energies are too uncertain; of a fall the message says so."""
    wrong = _inaccurate(run, run.error or {}) if run.status in (Status.OK, Status.FELL) else None
    if wrong is None:
        return run
    if run.status is Status.FELL:
        return replace(run, message=f"{run.message}; {wrong}")
    return replace(run, status=Status.INACCURATE, message=wrong)


def share_of_third(run: Trajectory, coarse: Trajectory, fine: Trajectory, order: int) -> float:
    """Return what of the difference to the third run is the error; coarse: the second."""
    if "rtol" in run.info:
        return OF_TENTH
    if order != 1:
        return OF_HALF
    far, near = (
        max(float((error / limit).max()) for _, error, limit, _ in _limited(run, _difference(run, other, 1.0)))
        for other in (coarse, fine)
    )
    return OF_HALF if abs(near - 0.5 * far) < ORDERLY * far else OF_ROOT


def share_by_steps(run: Trajectory, begun: Any, other: Trajectory, other_begun: Any, share: float) -> float:
    """Return the share, or 1 where discontinuities or events decide the steps; begun: states given to both runs."""
    if not {"steps"} <= run.info.keys() & other.info.keys() or run.parts is None:  # fixed steps
        return share
    counts = run.parts["step_control"][0] + np.array([pace.STEPS, pace.REJECTED])
    taken, rejected = _counted(run, begun, counts)
    finer = other.status.complete and _counted(other, other_begun, counts)[0] > taken
    return max(share, WHOLE_OF_IT) if rejected > MANY * taken or finer else share


def _counted(run: Trajectory, begun: Any, counts: np.ndarray) -> np.ndarray:
    first = begun.final if isinstance(begun, Trajectory) else begun
    return run.final[counts] - (0.0 if first is None else np.asarray(first)[counts])


def _difference(run: Trajectory, other: Trajectory, share: float) -> dict[str, np.ndarray]:
    """Return a share of the difference of each channel; infinite unless both came to their end, or ended alike."""
    if run.status.complete and other.status.complete and run.status is not other.status:
        other = replace(other, status=run.status)
    return with_error(run, other, share).error or {}


def fastest(speeds: np.ndarray, by_body: bool | None) -> Any:
    """Return the largest of speeds (samples, ...), 1 at least, by which their errors are judged.

    Of velocities of bodies, if asked for, one for each number (numbers,): the largest of the body's own, SLOWEST at
    least; of angular ones 1 rad/s at least.
    """
    if not by_body:
        return max(float(np.abs(speeds).max()), 1.0)
    own = np.abs(speeds).reshape(len(speeds), -1, 2, 3).max(axis=(0, 3))
    return np.repeat(np.maximum(own, [SLOWEST, 1.0]).ravel(), 3)


def _angles(run: Trajectory, name: str, errors: np.ndarray) -> np.ndarray:
    """Return errors (samples, columns) with the angle [rad] in place of each number of a quaternion."""
    if name == "base_q":
        turns = [7 * k + 3 for k in range(errors.shape[1] // 7)]
    else:
        turns = [k for k, label in enumerate(run.info.get("positions", ())) if label.endswith(".qw")]
    errors = errors.copy()
    for k in turns:
        errors[:, k : k + 4] = 2.0 * np.linalg.norm(errors[:, k : k + 4], axis=1, keepdims=True)
    return errors


def _limited(run: Trajectory, errors: dict[str, np.ndarray]) -> Iterator[tuple[str, np.ndarray, Any, str]]:
    """Yield name, error (samples, columns), its limit and unit of the coordinates and energies that have an error.

    The limit is a number, or one for each column.

    An error of an energy counts from where it lasts: where an impact is a moment late, so are its losses.
    """
    largest = LIMIT if "rtol" in run.info else FIXED_LIMIT
    slow = True if "rtol" in run.info and run.info.get("pairs") else None
    for name, unit in (("q", "rad or m"), ("base_q", "m or rad"), ("qd", "rad/s or m/s"), ("base_qd", "m/s or rad/s")):
        if name in errors and errors[name].size:
            limit, error = largest, errors[name].reshape(len(errors[name]), -1)
            if name.endswith("qd"):
                limit = SPEED_LIMIT * largest * fastest(run[name], slow if name == "base_qd" else None)
            yield name, error if name.endswith("qd") else _angles(run, name, error), limit, unit
    if "energy" in errors and errors["energy"].size:
        lasting = np.minimum.accumulate(errors["energy"][::-1])[::-1]
        limit = ENERGY_LIMIT * max(float(np.abs(run["energy"]).max()), LEAST_ENERGY)
        yield "energy", lasting.reshape(len(lasting), -1), limit, "J"


def _inaccurate(run: Trajectory, error: dict[str, np.ndarray]) -> str | None:
    """Describe from which record on the error of a run exceeds its limit; return None if it never does."""
    found = []
    for name, errors, limit, unit in _limited(run, error):
        beyond = (errors > limit).any(axis=1)
        if beyond.any():
            k = int(beyond.argmax())
            found.append((k, name, limit, unit, errors[k]))
    if not found:
        return None
    k, name, limit, unit, errors = min(found, key=lambda one: one[:2])
    column = int((errors / limit).argmax())
    limit = float(np.broadcast_to(limit, errors.shape)[column])
    what = run.info["joints"][column // ENERGIES] if name == "energy" else f"number {column} of {name}"
    if name.startswith("base") and "members" in run.info:
        member, number = divmod(column, run[name].shape[-1])
        what = f"{[*run.info['members']][member]}, number {number},"
    if name == "q" and "positions" in run.info:
        what = joint_labels(run.info, name)[column]
    elif name in ("q", "qd"):
        what, unit = run.info["joints"][column], unit_of(name, run.info.get("joint_types", ())[column : column + 1])
    finer = f"rtol than {run.info['rtol']:g}" if "rtol" in run.info else f"timestep than {run.info['timestep']:g} s"
    far = errors[column]
    by = "(the same run in other steps ended otherwise)"
    if math.isfinite(far):
        by = f"by {far:.2g} {unit} (limit {limit:.2g})"
    return (
        f"{run.info['robot']}: from {run['time'][k]:.4g} s on {name} of {what} is uncertain {by}: give a smaller "
        f"{finer}; if that does not help, the motion is chaotic and cannot be predicted so far ahead"
    )
