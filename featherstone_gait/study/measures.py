"""Run the experiments of a study and measure them, in a worker.

- `hold`: servos pull all joints of a resting robot from `posture.tilt` [rad] to zero (or the limit nearest to it) and
  hold them there.  An unstable servo model or step shows in the second half of the run, when all should rest
  (Lima et al. 2013, Figs. 7-10).
- `stable_step`: find by bisection the largest step with which servos bring a robot to rest from eight postures that
  are `posture.tilt` [rad] away from zero.  A step is stable if all eight come to rest: the root mean square speed of
  joints and rotors in the last quarter of the run is at most `FADING` of that in the quarter before, or below `STILL`.
  A run takes `duration`, but at least `LEAST_STEPS` steps and `LEAST_TICKS` periods of the controllers; the period is
  rounded to a whole number of steps, at least one.
- `walk`: walk on the ground with a gait of four key poses, fitted to a walk planned by preview control (`gait.*`); its
  cost is that of `walking.cost`.

Every run gives a row: status ("ok", that of the trajectory, "no cost" for a walk without one, or "refused" for
parameters that make no scene), the columns of `COLUMNS`, None where there is no value, and a message.  Sums are
correctly rounded (`math.fsum`), so that a row has the same bits on every machine and in every batch.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..core.compile.lanes import WIDTH
from ..core.effects.energies import METER
from ..dynamics.tree import followed
from ..run.reference import Reference
from ..run.simulate import initial_state, simulate_batch, standing_state
from ..run.trajectory import Trajectory
from ..scene.compile import CompiledScene
from .bisection import largest
from .draws import drawn_scenes, offset_of
from .settings import ONLY, Setup, scene_of, section_of, servos_with

if TYPE_CHECKING:
    from ..run.program import CompiledController
    from ..walking.motion import Motion
    from .settings import Walk

INLINE: Any = SimpleNamespace(map=map)  # in place of an executor: a worker is one of many and starts no threads
TILT = 0.01  # default of posture.tilt [rad]
SMALLEST, LARGEST = 2e-5, 0.1  # steps that stable_step tries [s]
LEAST_STEPS, LEAST_TICKS = 200, 40  # of a run of stable_step
FADING, STILL = 0.9, 1e-6  # of speeds when a robot comes to rest [-], [rad/s]
COLUMNS = {  # name of a column -> what its axis says; the first one is plotted
    "hold": {
        "variance_deg2": "largest variance of a joint [deg²]",
        "offset_deg": "largest distance of a joint from its target [deg]",
        "chatter_rad_s": "chatter [rad/s]",
        "energy_J": "electrical energy [J]",
        "end_s": "time reached [s]",
    },
    "stable_step": {"stable_step_s": "largest stable step [s]", "unstable_step_s": "smallest unstable step [s]"},
    "walk": {
        "cost_J_m": "energy per distance [J/m]",
        "cost_of_transport": "cost of transport [-]",
        "speed_m_s": "speed [m/s]",
        "stride_length_m": "length of a stride [m]",
        "distance_m": "distance [m]",
        "sideways_m": "distance sideways [m]",
        "energy_J": "electrical energy [J]",
        "slip_m": "slip of a contact point per stride [m]",
        "walks": "walks forward to the end (1) or not (0) [-]",
    },
}


# Of `walking.cost.Measures`, in the order of the columns of a walk.
MEASURES = ("cost", "cost_of_transport", "speed", "stride_length", "distance", "sideways", "energy", "slip")


class _Task(NamedTuple):
    """The inputs of a run, and the function that makes its row."""

    scene: CompiledScene
    duration: float  # [s]
    state: np.ndarray
    reference: Reference
    record: tuple[str, ...]
    record_interval: float | None  # [s]
    row: Callable[[Trajectory], dict[str, Any]]
    controller: CompiledController | None = None


def run_batch(setup: Setup, points: list[tuple]) -> list[dict[str, Any]]:
    """Run points, each given by the varied parameters, and return their rows; runs of one structure share lanes."""
    setup = _known(setup)
    rows: dict[int, dict[str, Any]] = {}
    tasks: dict[float, dict[int, _Task]] = {}  # by their duration
    count = len(setup.names)
    each = [setup.fixed | dict(zip(setup.names, point)) for point in points]
    scenes: dict[int, CompiledScene | ValueError] = {}
    if setup.experiment != "stable_step":
        scenes = _scenes(setup, each, [point[count:] for point in points])
    for k, values in enumerate(each):
        try:
            if setup.experiment == "stable_step":
                rows[k] = _stable_step(setup, values)
                continue
            scene = scenes[k]
            if isinstance(scene, ValueError):
                raise scene
            task = _EXPERIMENTS[setup.experiment](setup, scene, values, offset_of(setup.draws, points[k][count:]))
            tasks.setdefault(task.duration, {})[k] = task
        except ValueError as error:
            rows[k] = _row(setup, "refused", str(error))
    for members in tasks.values():
        rows |= zip(members, _simulated(setup, [*members.values()]))
    return [rows[k] for k in range(len(points))]


def _scenes(
    setup: Setup, each: list[dict[str, Any]], drawn: list[tuple[np.ndarray, ...]]
) -> dict[int, CompiledScene | ValueError]:
    """Make the scene of each run, or the error if there is none."""
    found: dict[int, CompiledScene | ValueError] = {}
    alike: dict[tuple, list[int]] = {}  # runs by what their scene is drawn from
    for k, values in enumerate(each):
        alike.setdefault(_scene_values(values), []).append(k)
    for items, runs in alike.items():
        try:
            found |= zip(runs, drawn_scenes(_scene(setup, items), setup.draws, [drawn[k] for k in runs]))
        except ValueError as error:
            found |= dict.fromkeys(runs, error)
    return found


def _simulated(setup: Setup, tasks: list[_Task]) -> list[dict[str, Any]]:
    """Simulate runs of one duration and return their rows; if one is refused, each run alone."""
    scenes, _, states, references, _, _, _, acts = zip(*tasks)
    _, duration, _, _, record, record_interval, _, _ = tasks[0]
    how: dict[str, Any] = dict(record=record, record_interval=record_interval, executor=INLINE, estimate_error=False)
    try:
        runs = simulate_batch(scenes, duration, states, references, controller=acts if any(acts) else None, **how)
    except ValueError as error:
        if len(tasks) == 1:
            return [_row(setup, "refused", str(error))]
        return [row for task in tasks for row in _simulated(setup, [task])]
    return [task.row(run) for task, run in zip(tasks, runs)]


@functools.lru_cache(maxsize=4)
def _known(setup: Setup) -> Setup:
    """Return the first equal setup of this process, so that what was compiled for its model is used again."""
    return setup


def _scene_values(values: dict) -> tuple:
    return tuple(sorted(item for item in values.items() if item[0].partition(".")[0] not in ONLY))


def _row(setup: Setup, status: str, message: str, numbers: dict[str, float] | None = None) -> dict:
    found = {name: float((numbers or {}).get(name, math.nan)) for name in COLUMNS[setup.experiment]}
    finite = {name: value if math.isfinite(value) else None for name, value in found.items()}
    return {"status": status, **finite, "message": message}


@functools.lru_cache(maxsize=64)
def _scene(setup: Setup, items: tuple) -> CompiledScene:
    return scene_of(setup.model, dict(items))


# ---------------------------------------------------------------------------------------------- hold


def _hold(setup: Setup, scene: CompiledScene, values: dict, offset: np.ndarray | float) -> _Task:
    target = _target(scene)
    state = _resting(scene, target + values.get("posture.tilt", TILT))
    sent = Reference([0.0], (target + offset)[None])
    row = lambda run: _row(setup, run.status, run.message, _held(run, target))  # noqa: E731
    return _Task(scene, setup.duration, state, sent, ("q", "energy"), None, row)


def _target(scene: CompiledScene) -> np.ndarray:
    """Find zero, or the limit nearest to it, for each joint."""
    if scene.gearbox is None:
        raise ValueError("this experiment needs servos; set scene.gearbox to mipsd, rotor or standard")
    return np.array([min(max(0.0, joint.lower), joint.upper) for joint in scene.model.moving_joints])


def _resting(scene: CompiledScene, angles: np.ndarray) -> np.ndarray:
    angles = followed(scene.tree.coupling, angles)
    if scene.ground is not None and scene.model.base == "floating":
        return standing_state(scene, angles, allow_limit_violation=True)
    base = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0] if scene.model.base == "floating" else []
    return initial_state(scene, [*base, *angles], allow_limit_violation=True)


def _held(run: Trajectory, target: np.ndarray) -> dict[str, float]:
    """Measure variance and offset over the second half, if it was reached, and the run's chatter and energy."""
    numbers = {"chatter_rad_s": run.info["worst_chatter"], "end_s": run.end_time}
    if run.status in ("fell", "diverged"):
        return numbers
    angles = np.degrees(run["q"][len(run["time"]) // 2 :] - target)
    return numbers | {
        "variance_deg2": max(map(_variance, angles.T.tolist())),
        "offset_deg": float(np.abs(angles).max()),
        "energy_J": math.fsum(run["energy"][-1, :, METER].tolist()),
    }


def _variance(values: list[float]) -> float:
    mean = math.fsum(values) / len(values)
    return math.fsum((value - mean) ** 2 for value in values) / len(values)


# ---------------------------------------------------------------------------------------------- stable_step


def _stable_step(setup: Setup, values: dict) -> dict:
    tilt = values.get("posture.tilt", TILT)
    periods = (servo.controller.period for servo in servos_with(setup.model, values).servos.values())
    given = values | {"servo.period": max(periods, default=1.0)}  # the longest [s]
    good, bad = largest(lambda h: _comes_to_rest(setup, given, tilt, h), SMALLEST, LARGEST)
    numbers = {"stable_step_s": good, "unstable_step_s": bad}
    if math.isnan(good):
        return _row(setup, "unstable", f"no step from {SMALLEST:g} s on is stable", numbers)
    return _row(setup, "ok", f"stable up to {LARGEST:g} s, the largest step tried" * math.isnan(bad), numbers)


def _comes_to_rest(setup: Setup, values: dict, tilt: float, h: float) -> bool:
    steps = max(1, round(values["servo.period"] / h))
    scene = _scene(setup, _scene_values(values | {"scene.timestep": h, "servo.period": steps * h}))
    target = _target(scene)
    sides = np.sign(np.random.default_rng(0).normal(size=(WIDTH, len(target))))
    states = [_resting(scene, target + tilt * side) for side in sides]
    references = [Reference([0.0], target[None])] * WIDTH
    duration = max(setup.duration, LEAST_STEPS * h, LEAST_TICKS * steps * h)
    how: dict[str, Any] = dict(record=("qd", "rotor_speed"), executor=INLINE, estimate_error=False)
    return all(map(_rests, simulate_batch(scene, duration, states, references, **how)))


def _rests(run: Trajectory) -> bool:
    """Return whether all speeds fade, those of rotors too: they may chatter while joints hardly move."""
    if run.status in ("fell", "diverged"):
        return False
    for speeds in (run["qd"], run["rotor_speed"]):
        quarter = len(speeds) // 4
        parts = (speeds[-k * quarter :][:quarter] for k in (1, 2))
        last, before = (math.fsum((part**2).ravel().tolist()) / max(part.size, 1) for part in parts)
        if last > max(FADING**2 * before, STILL**2):
            return False
    return True


# ---------------------------------------------------------------------------------------------- walk


def _walk(setup: Setup, scene: CompiledScene, values: dict, offset: np.ndarray | float) -> _Task:
    from ..walking.cost import RECORD, SAMPLE, measured
    from ..walking.feedback import BalancedWalk

    walk = _gait(setup, scene, values)
    mark, end = walk.begin(setup.warm_up), walk.begin(setup.warm_up + setup.strides)
    sent = walk.reference(setup.warm_up + setup.strides)
    if isinstance(offset, np.ndarray):
        sent = Reference(sent.times, sent.values + offset, sent.kind)
    state = standing_state(scene, sent.values[0], allow_limit_violation=True)
    act = walk.controller(scene) if isinstance(walk, BalancedWalk) else None

    def row(run: Trajectory) -> dict[str, Any]:
        found = measured(scene, run, mark, end, setup.strides)
        ok = found.status == "ok"
        numbers = dict(zip(COLUMNS["walk"], [*(getattr(found, name) for name in MEASURES), float(ok)]))
        return _row(setup, "ok" if ok else "no cost", "" if ok else found.status, numbers)

    return _Task(scene, sent.times[-1], state, sent, RECORD, SAMPLE, row, act)


def _gait(setup: Setup, scene: CompiledScene, values: dict) -> Walk:
    """Return the gait of `gait.file`, or plan one by the parameters `gait.*` under the scene's gravity."""
    from ..walking.plan import downward

    if "gait.file" in values:
        return setup.walks[values["gait.file"]]
    wanted = tuple(sorted(section_of(values, "gait").items()))
    return _planned(setup, wanted, downward(scene.gravity))


@functools.lru_cache(maxsize=16)
def _planned(setup: Setup, values: tuple, g: float) -> Motion:
    """Plan a gait under gravity g [m/s^2], with its start-up."""
    from ..walking import fit_gait, mirror_of, walking_plan
    from ..walking.motion import motion_of

    walk = dict(values)
    if "period" in walk:
        walk["step_time"] = 0.5 * walk.pop("period")
    plan = walking_plan(setup.model, g=g, **walk)
    fit = fit_gait(plan.stride(), mirror=mirror_of(setup.model), fit_phase=True)
    return motion_of(fit.gait, plan.start_up(phase=fit.phase))


_EXPERIMENTS = {"hold": _hold, "walk": _walk}
