"""The main job: a robot's planned walk as a gait of four poses, made cheaper by the paper's search, and all the files.

    cost = walking_cost(load_robot("humanoid", locked="simplified"))
    result = optimize_gait(cost, iterations=800, seed=0)

The search is that of J. Lima et al., "Humanoid gait optimization resorting to an improved simulation model", Int. J.
Advanced Robotic Systems 10 (2013), section 4: forty joint angles, energy per distance.  Its perturbations are 1 degree
wide.  On seeds 0 to 3, 800 candidates of 0.7, 1, 1.5 and 2 degrees cut the humanoid's 65 J/m to 24, 24, 23 and 25 in
the mean (implicit Euler at 1 ms), but of the gaits found with 1 degree 83 % still walk with all angles off by up to a
degree, with 2 degrees 64 %; those of 3 degrees wander off sideways, those of 5 may fall at a finer step.  Measured are
8 strides after 2: of 16 gaits that were optimized over 4 strides after 1, seven fall in the next.
"""

from __future__ import annotations

import functools
import json
import math
import tempfile
import textwrap
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, get_args

import numpy as np
from scipy.optimize import OptimizeResult
from tqdm import tqdm

from .. import __version__
from ..base.arguments import one_of, real, whole
from ..base.files import FilePath, Format, claim, moving_up, parse_json
from ..crosscheck import crosscheck as walk_elsewhere
from ..crosscheck import motion_of, verdict
from ..crosscheck.in_mujoco import mujoco_version
from ..crosscheck.run import files as crosscheck_files
from ..model import Ground, Model
from ..robot_file import load_servo
from ..robot_file.servos import servo_names
from ..run.simulate import streams
from ..scene.compile import ServoKind, compile_scene
from ..scene.tree import GRAVITY
from ..search import minimize
from ..search.annealing import REMEDY as HISTORY_REMEDY
from ..view.animation import write_animation
from ..view.gait_page import least_so_far, parts_of, write_gait_page
from ..view.style import BAD, BLUE, look
from ..walking.cheapest_plan import PlanKind, States, first_gait
from ..walking.cost import Measures, WalkingCost
from ..walking.cost_in_worlds import MOST_WORLDS, CostInWorlds, in_worlds
from ..walking.descent import WORK, descend
from ..walking.feedback import BalancedWalk, add_feedback
from ..walking.gait import bounds, mirror_of
from ..walking.gait_file import ARRAYS, write_angles, write_goal_positions
from ..walking.limits import LIMITS, Watch
from ..walking.motion import Motion
from ..walking.walker import GENERIC, driven, load_walker
from ..walking.worth import STANDBY, UNSEEN, Quality, chosen, plausible, quality, with_standby, worth_elsewhere
from .feedback import feedback_history, search_feedback, told

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "AMPLITUDE",
    "BASELINES",
    "main_job",
    "optimize_gait",
    "optimize_with_limits",
    "plot_angles",
    "plot_convergence",
    "summary",
    "walking_cost",
    "write_results",
]

REPORT = Format("gait report")
AMPLITUDE = math.radians(1.0)  # of the search [rad]; see above
MAX_MISS = 20
BATCH = 16  # candidates evaluated at once where lanes cannot be at different times
NOT_CHECKED = "not run; whether the gait walks on other ground is not known (optimize --crosscheck)"
WORLDS = 8  # that a candidate walks in
STARTS = 8  # of the cheapest candidates, that a descent may begin with
BASELINES: dict[str, dict[str, Any]] = {  # plans that what is found is compared with, by what they change of the walk
    "plain plan": {},
    "plan of 35 mm": {"step_length": 0.035},
}
CHEAPEST = "cheapest plan"  # that which is found within the limits of the search (`walking.cheapest_plan`)
BASELINE_WORLDS = 50  # of those that are not the first gait, which walks in all
ALIKE = 0.05  # by how much speeds may differ that are called equal [-]
SHOWN_IN = {"m": ("mm", 1e3), "rad": ("deg", math.degrees(1.0)), "-": ("%", 100.0)}  # units of limits in tables
SHOWN = 12  # strides in the files and the animation
# Processor seconds of one core of an AMD EPYC, compiled before (docs/optimize.md, docs/walking.md, docs/feedback.md):
SECONDS = {"candidate in a world": 0.0175, "report": 60.0, "crosscheck": 95.0, "plans": 27.0, "feedback": 0.4}


def walking_cost(
    model: Model,
    servos: ServoKind = "mipsd",
    ground: Ground | None = None,
    gravity: Sequence[float] | np.ndarray = GRAVITY,
    states: States = "stride",
    plan: PlanKind = "plain",
    **walk: Any,
) -> WalkingCost:
    """Plan a walk of a biped, fit the four-pose gait to it and return its cost on flat ground.

    `gravity` (3,) [m/s^2] points straight down; `walk` overrides `BIOLOID_WALK`.  `states`: whether the four poses are
    those of a stride, or of a step, which the other leg mirrors.  The paper's words allow both ("a complete and
    symmetrical step can be composed of 4 states").  `plan`: "cheapest" looks for one (`walking.first_gait`).  Raises
    ValueError for a robot that is no biped or cannot take these steps, and for states of a step where left and right
    are no mirror images.
    """
    one_of("states", states, get_args(States))
    return first_gait(compile_scene(model, servos, ground or Ground(), "midpoint", 1e-3, gravity), plan, states, **walk)


def optimize_gait(
    cost: WalkingCost | CostInWorlds,
    *,
    iterations: int = 800,
    seed: int = 0,
    amplitude: float = AMPLITUDE,
    max_miss: int = MAX_MISS,
    **how: Any,
) -> OptimizeResult:
    """Search for a cheaper gait than that of `cost`, within the joints' limits; return the result of `search.minimize`.

    `cost`: in one world, or in several at once (`walking.in_worlds`); `iterations`: how many candidates are tried;
    `amplitude`: of their perturbations [rad].  Of the result x (D,) is the best gait's vector [rad], for
    `cost.gait.from_vector`, and fun its cost [J/m], infinite if no gait walks.

    `how`: its other arguments, history, resume, progress and callback among them.  The result depends on seed and
    settings alone, not on the machine's load or number of cores; but for nfev, wasted and what is added here:
    occupancy, the share of the lane-steps that a candidate was in (nan with servos that are not sampled).  Raises as
    `search.minimize`.
    """
    occupancy = [math.nan]
    if streams(cost.scene):
        how["evaluate"] = lambda candidates: occupancy.append(cost.evaluate(candidates))
    result = minimize(
        cost, cost.gait.to_vector(), amplitude=amplitude, max_miss=max_miss, max_iterations=iterations, seed=seed,
        bounds=bounds(cost.scene.model, cost.gait), map=type(cost).costs, batch=BATCH, **how,
    )  # fmt: skip
    result.occupancy = occupancy[-1]
    return result


def optimize_with_limits(
    cost: CostInWorlds, watch: Watch, history: Path, *, iterations: int = 800, **how: Any
) -> OptimizeResult:
    """Half of the candidates for energy alone, then as long a descent that keeps to what a real robot asks for too.

    The descent (`walking.descent`) begins with the cheapest candidate that walks where runs whose speeds ring are
    repeated.  The result is that of `optimize_gait` with the gaits that its steps end with in history; added are
    limited, its own result, and since, the place of its first gait.  Both are left out if the first half is
    interrupted or finds nothing that walks, or `iterations` is 0.

    `watch`: measures what the limits are of; `history`: a file of JSON lines, the second half's is beside it; `how`:
    seed, resume and progress.  Raises as `optimize_gait`.
    """
    first = optimize_gait(cost, iterations=iterations // 2, history=history, **how)
    steps = (iterations - first.nit - 1) // WORK
    if steps < 0 or not first.success:
        return first
    order = np.argsort(first.history["f"], kind="stable")[:STARTS]
    starts = [first.history["x"][k] for k in order if np.isfinite(first.history["f"][k])]
    result = descend(cost, watch, starts, steps=steps, history=limits_history(history), **how)
    both = {key: np.concatenate([first.history[key], result.history[key]]) for key in ("x", "f")}
    counts = {"nit": first.nit + WORK * result.nit, "nfev": first.nfev + -(-result.nfev // len(cost.scenes))}
    kept = {key: first[key] for key in ("wasted", "occupancy")} | {"since": first.nit + 1}
    return OptimizeResult({**result, **counts, **kept, "history": both, "limited": result})


def expected(iterations: int, worlds: int, unseen: int, crosscheck: bool, plans: int, feedback: bool) -> float:
    """About how long `main_job` takes on two cores [min], compiling aside; plans: searches for the cheapest one."""
    seconds = SECONDS["candidate in a world"] * iterations * max(worlds, 1) + SECONDS["report"] * unseen / UNSEEN
    seconds += SECONDS["crosscheck"] * crosscheck + SECONDS["plans"] * plans
    return (seconds + SECONDS["feedback"] * (iterations // 2) * feedback) / 120.0


def limits_history(history: Path) -> Path:
    """The file of the second half of a search, beside that of the first."""
    return history.with_name(history.name.replace("_history", "_limits_history"))


def main_job(
    robot: FilePath = "humanoid",
    *,
    servos: ServoKind = "mipsd",
    servo: FilePath | None = None,
    iterations: int = 800,
    seed: int = 0,
    out: FilePath = ".",
    resume: bool = False,
    progress: bool = True,
    states: States | None = None,
    worlds: int = WORLDS,
    unseen: int = UNSEEN,
    crosscheck: int = 0,
    limits: bool = True,
    electronics: float | None = None,
    holding: float | None = None,
    plan: PlanKind | None = None,
    fair: bool = True,
    feedback: bool = False,
    legs_only: bool = False,
) -> dict:
    """Optimize a robot's gait and write all files into the folder `out`; return what the JSON file holds.

    `robot`: a name or a .urdf file, as of `load_robot`; of "humanoid" the paper's simplified one; `legs_only`: hold all
    joints but those of its legs.  `servo`: a name or a .toml file, as of `load_servo`, of the servo in all joints that
    turn, or "generic", an AX-12 scaled to the robot (`walking.walker.driven`); in place of the robot's own, with which
    the first gait is then measured too.  `resume` goes on from the history in `out`, if there is one.

    `states`: what the four poses are, as of `walking_cost`, None for those of a step where the legs mirror each other
    and of a stride elsewhere; `worlds`: in how many a candidate walks
    (`walking.in_worlds`), 0 for the paper's search, on one floor; `unseen`: how many others tell what both gaits are
    worth elsewhere.  `crosscheck`: in how many processes the gait that was found is walked on the floors of
    `featherstone_gait.crosscheck` in MuJoCo, 0 for not at all.

    In worlds the second half of the work is a descent that keeps to what a real robot asks for (`walking.descent`), and
    of the gaits that it tried that is taken which keeps most limits and does best in 16 more worlds
    (`walking.worth.chosen`); with `limits` False all candidates are for energy alone.  `electronics`, `holding`: what
    the electronics of all servos take, and what the locked ones take to hold still [W]; told beside the motors' energy.
    `plan`: which gait the search begins with, as of `walking_cost`, None for the plain one and, where that cannot be
    planned or falls in a world, the cheapest if there is one; `fair`: after a search in worlds, look for the cheapest
    plan too and compare with that.
    `feedback`: after the search half as many candidates more, of poses and gains together, in worlds and under pushes
    (`optimize_feedback`); the .npz then holds the gait with its feedback.

    KeyboardInterrupt ends the search, and the files hold what was found, measured on the robot's own ground alone.
    A process that is killed leaves the history, from which it resumes to the same files; they appear only when all of
    them are complete.  Raises ValueError if no gait walks or the history is of another robot, FileExistsError if there
    is a history and `resume` is not set, OSError if files cannot be written or another process is at work with the
    history, if possible before the search, ImportError if a crosscheck is asked for without MuJoCo.
    """
    began = time.perf_counter()
    own = load_walker(robot, legs_only=legs_only)
    model = own if servo is None else driven(own, servo)
    if not model.servos:
        raise ValueError(f"{own.name} has no servos; name one (--servo): {GENERIC!r} is an AX-12 scaled to the robot")
    worlds = whole("worlds", worlds, 0, "0 is the robot's own ground alone", MOST_WORLDS)
    if feedback and not worlds:
        raise ValueError("feedback is searched in worlds, and worlds is 0; leave out --nominal and --worlds 0")
    unseen = whole("unseen", unseen, 0, "0 asks for none", MOST_WORLDS)
    iterations = whole("iterations", iterations, 0, "0 measures the first gait alone")
    if crosscheck:
        mujoco_version()
    _check_folder(Path(out))
    stem = Path(out) / f"{Path(robot).stem}_gait"
    history = stem.with_name(stem.name + "_history.jsonl")
    if history.exists() and not resume:
        raise FileExistsError(f"{history} exists; resume (--resume) to go on from it, or give another folder (--out)")
    if history.exists():
        with _alone_with(history):  # rather said now than after the first gait
            pass
    for name, power in (("electronics", electronics), ("holding", holding)):
        if power is not None:
            real(name, power, 0.0, 1e6, "it is a power [W]")
    judged = plan != "cheapest" and fair and worlds > 0
    minutes = expected(iterations, worlds, unseen, crosscheck > 0, judged + (plan == "cheapest"), feedback)
    if progress:
        compiling = "the first time half a minute more, to compile"
        if robot == "humanoid":
            print(f"takes about {max(minutes, 1.0):.0f} min on two cores; {compiling}")
        else:
            print(f"the first gait tells how long it takes; {compiling}")
    begin = functools.partial(_begun, model, servos, states or _states_of(model), worlds)
    begun = begin(plan or "plain", hopeful=plan is None)
    if plan is None and begun.status != "ok":
        if progress:
            print(_folded(f"plain plan: {begun.status}; looks for the cheapest that walks"))
        cheapest = begin("cheapest", hopeful=begun.cost is not None)
        if cheapest.cost is not None:  # else a search may still come from a gait that falls to one that does not
            judged, plan, begun = False, "cheapest", cheapest
    plan, (cost, searched, first_cost, status) = plan or "plain", begun
    assert cost is not None
    x0 = cost.gait.to_vector()
    first = cost.measure([x0])[0]
    watch = Watch(model, cost.start[0])
    _check_history(history, first_cost)
    if progress:
        print(f"first gait: {_described(first)}")
        if worlds:
            print(f"in {worlds} worlds: {first_cost:.1f} J/m" if status == "ok" else f"in {worlds} worlds: {status}")
        if robot != "humanoid":
            again = time.process_time()  # the first time may have compiled
            searched(x0)
            slower = (time.process_time() - again) / (SECONDS["candidate in a world"] * max(worlds, 1))
            print(f"takes about {max(slower * minutes, 1.0):.0f} min on two cores")
    searching = time.perf_counter()
    how: dict[str, Any] = {"seed": seed, "resume": resume, "progress": progress}
    if isinstance(searched, CostInWorlds) and limits:
        result = optimize_with_limits(searched, watch, history, iterations=iterations, **how)
    else:
        result = optimize_gait(searched, iterations=iterations, history=history, **how)
    searching = time.perf_counter() - searching
    if not np.isfinite(result.fun):
        why = status if first.status == "ok" else first.status
        remedy = "stronger servos (--servo generic:4)" if plan == "cheapest" else "the cheapest plan (--plan cheapest)"
        raise ValueError(f"{model.name}: none of {result.nit + 1} gaits walked; the first: {why}; try {remedy}")
    if result.status == 2:  # interrupted: who waits has waited enough
        unseen, crosscheck, fair = 0, 0, False
        if progress:
            print("interrupted: measures the best so far and writes the files; Ctrl-C again leaves the history alone")
    choice: list[dict[str, Any]] = []
    if "limited" in result and result.status != 2:
        result.x, choice = chosen(cost, watch, result.limited.tried, progress=progress)
    walk = None
    if feedback and result.status != 2:
        begins = in_worlds(replace(cost, gait=cost.gait.from_vector(result.x)), worlds)
        found = search_feedback(begins, iterations=iterations // 2, history=feedback_history(history), **how)
        result.x, walk = found.x_poses, found.walk
    before, after = (quality(cost, x) for x in (x0, result.x))
    elsewhere = worth_elsewhere(cost, [x0, walk or result.x], unseen, progress) if unseen else None
    motion = walk or motion_of(cost.gait.from_vector(result.x), cost.start, cost.blend_strides)
    checked = _crosschecked(cost, motion, own, servo, stem, crosscheck, progress) if crosscheck else None
    baselines = _baselines(cost, plan, min(unseen, BASELINE_WORLDS), progress, judged and fair)
    if elsewhere:
        baselines[0]["elsewhere"] = elsewhere[0]
    with _alone_with(history), _appearing_together(stem) as folder:
        files = write_results(folder / stem.name, cost, result, _kept_servo(servo))
        if walk is not None:
            add_feedback(files["arrays"], walk)
        report = {
            "format": str(REPORT),
            "robot": model.name,
            "source": model.source,
            "joints": cost.gait.joint_names,
            "version": __version__,
            "settings": {"servo": str(servo or _servo_name(own)), "plan": plan}
            | _settings(cost, iterations, seed, worlds)
            | {"limits": {one.name: one.bound for one in LIMITS} if "limited" in result else None},
            "search": {
                "candidates": result.nit, "message": result.message, "first": _number(first_cost), "best": result.fun,
                "with_limits_from": result.get("since"),
                "chosen_among": choice,
            },
            "before": before.as_dict(),
            "after": after.as_dict(),
            "elsewhere": elsewhere and dict(zip(("before", "after"), elsewhere)),
            **({} if servo is None else {"with_own_servos": _with_own_servos(own, cost)}),
            "feedback": walk and told(cost, walk, worlds),
            "crosscheck": checked,
            "crosscheck_floors": _floors(stem) if checked else [],
            "plausible": {
                "before": plausible(cost, x0, watch), "after": plausible(cost, result.x, watch),
                "servo": _servo_told(model), "not_watched": watch.close(),
            },
            "standby": _standby(own, electronics, holding, before, after),
            "baselines": baselines,
            "at_equal_speed": _at_equal_speed(cost, result, baselines),
            # What differs from run to run:
            "evaluations": {"begun": result.nfev, "wasted": result.wasted, "lane_occupancy": _number(result.occupancy)},
            "seconds": {"search": searching, "all": time.perf_counter() - began},
            "files": {kind: str(stem.parent / path.name) for kind, path in files.items()}
            | {"history": str(history)}
            | ({"limits_history": str(limits_history(history))} if "limited" in result else {})
            | (_crosscheck_files(stem) if checked else {}),
        }
        text = json.dumps(report, indent=2)
        files["report"].write_text(text, encoding="utf-8")
        write_gait_page(files["page"], report, result.history["f"])
    if progress:
        print(_folded(summary(report)))
    return json.loads(text)


class _Begun(NamedTuple):
    """A plan's gait: its cost, that which the search sees, what that is [J/m], and its status or why there is none."""

    cost: WalkingCost | None
    searched: Any
    first: float
    status: str


def _begun(
    model: Model, servos: ServoKind, states: States, worlds: int, plan: PlanKind, hopeful: bool = False
) -> _Begun:
    """The gait that a search begins with; hopeful: that it cannot be planned is a status, else a ValueError."""
    try:
        cost = walking_cost(model, servos, states=states, plan=plan)
    except ValueError as error:
        if not hopeful:
            raise
        return _Begun(None, None, math.inf, str(error))
    searched = in_worlds(cost, worlds) if worlds else cost
    return _Begun(cost, searched, *searched(cost.gait.to_vector()))


def _folded(text: str) -> str:
    """Lines that go on below where a terminal has no room for them."""
    lines = (textwrap.wrap(line, 79, subsequent_indent="    ", break_long_words=False) for line in text.split("\n"))
    return "\n".join(part for line in lines for part in line)


def _states_of(model: Model) -> States:
    try:
        mirror_of(model)
    except ValueError:
        return "stride"
    return "step"


def _baselines(
    cost: WalkingCost, plan: PlanKind, unseen: int, progress: bool, cheapest: bool
) -> list[dict[str, Any]]:
    """Each of `BASELINES`, measured as the gait that is found; of one that cannot be planned or falls the reason.

    The first is that of `cost`, of `plan`.
    """
    scene, found = cost.scene, []
    asked: dict[str, dict[str, Any]] = BASELINES | ({CHEAPEST: {"plan": "cheapest"}} if cheapest else {})
    if plan == "cheapest":
        asked = {CHEAPEST: {}} | {name: walk for name, walk in asked.items() if walk}
    for name, walk in tqdm(asked.items(), "baselines", disable=not progress or not unseen, unit="plan"):
        row: dict[str, Any] = {"name": name, "walk": walk, "status": "ok", "elsewhere": None}
        try:
            assert scene.servos is not None
            states: States = "stride" if cost.gait.mirror is None else "step"
            one = cost
            if walk:
                one = walking_cost(scene.model, scene.servos, scene.ground, scene.gravity, states, **walk)
        except ValueError as error:
            found.append(row | {"status": str(error)})
            continue
        x = one.gait.to_vector()
        row |= one.measure([x])[0].as_dict()
        if walk and unseen and row["status"] == "ok":  # of the first one it is known
            (row["elsewhere"],) = worth_elsewhere(one, [x], unseen, False)
        found.append(row)
    return found


def _at_equal_speed(cost: WalkingCost, result: OptimizeResult, baselines: Sequence[dict]) -> list[dict[str, Any]]:
    """Of each baseline that walks the cheapest gait as fast as it, among those on the search's way.

    Of plans with its period equal speeds are equal steps.  The way was not looked for at that speed: what is gained
    there is at least what is told.
    """
    best = np.concatenate([least_so_far(part) for part in parts_of(result.history["f"], result.get("since"))])
    improving = np.flatnonzero((best < np.concatenate([[np.inf], best[:-1]])) & np.isfinite(best))
    way = cost.measure(result.history["x"][improving]) if len(improving) else []
    found = []
    for row in baselines:
        if row["status"] == "ok":
            alike = [one for one in way if one.status == "ok" and abs(one.speed / row["speed"] - 1.0) <= ALIKE]
            cheapest = min(alike, key=lambda one: one.cost, default=None)
            found.append({
                "baseline": row["name"], "cost": row["cost"], "speed": row["speed"],
                "found": cheapest and cheapest.as_dict(),
                "gain": cheapest and 1.0 - cheapest.cost / row["cost"],
            })  # fmt: skip
    return found


def _standby(
    own: Model, electronics: float | None, holding: float | None, before: Quality, after: Quality
) -> dict[str, Any]:
    """What is drawn all the time [W], and energy per distance with it [J/m]: what each adds to those before it.

    By default the electronics of each servo take `STANDBY` amperes, and locked servos no more than that.
    """
    moving = {joint.name for joint in own.moving_joints}
    watts = {"walking": 0.0, "locked": 0.0}
    for name, servo in own.servos.items():
        if servo.voltage_limit < math.inf:
            watts["walking" if name in moving else "locked"] += STANDBY * servo.voltage_limit
    if electronics is not None:
        share = sum(name in moving for name in own.servos) / max(len(own.servos), 1)
        watts = {"walking": share * electronics, "locked": (1.0 - share) * electronics}
    watts = {
        "electronics of the servos that walk": watts["walking"],
        "electronics of the locked servos": watts["locked"],
        "locked servos that hold": holding or 0.0,
    }
    sides = {name: with_standby(one.measures.as_dict(), watts) for name, one in (("before", before), ("after", after))}
    return {"watts": watts, "assumed": electronics is None} | sides


def _servo_name(model: Model) -> str:
    """Names of a robot's servos, as far as they are among those that come with the package."""
    known = {load_servo(name): name for name in servo_names()}
    return ", ".join(dict.fromkeys(known.get(servo, "as in its file") for servo in model.servos.values()))


def _kept_servo(servo: FilePath | None) -> str:
    """What a gait's file calls its servo: a name as it is, a file by its whole path, "" for the robot's own."""
    if servo is None or str(servo).startswith(GENERIC) or str(servo) in servo_names():
        return str(servo or "")
    return str(Path(servo).resolve())


def _with_own_servos(own: Model, cost: WalkingCost) -> dict:
    """The first gait of `cost` with the robot's own servos."""
    if not own.servos:
        return {"servo": "none", "status": "it has none"}
    with_own = replace(cost, scene=cost.scene.recompiled(own))
    return {"servo": _servo_name(own)} | with_own.measure([cost.gait.to_vector()])[0].as_dict()


def _crosschecked(
    cost: WalkingCost,
    motion: Motion | BalancedWalk,
    robot: Model,
    servo: FilePath | None,
    stem: Path,
    count: int,
    progress: bool,
) -> str:
    """What a gait does in MuJoCo, in words; if that cannot be told, why: the search is not to be lost by it."""
    out, servos = stem.with_name(stem.name + "_crosscheck"), cost.scene.servos
    assert servos is not None
    try:
        return verdict(
            walk_elsewhere(
                motion, robot, servos=servos, servo=servo, out=out, processes=count, progress=progress
            )
        )
    except (ValueError, OSError) as error:
        return f"not run: {error}"
    except KeyboardInterrupt:
        return "interrupted; featherstone-gait crosscheck goes on with it"


def _floors(stem: Path) -> list[dict[str, Any]]:
    """Of each floor of the crosscheck J/m in MuJoCo and here, None where the gait falls."""
    path = crosscheck_files(stem.with_name(stem.name + "_crosscheck"))[0]
    rows = parse_json(path.read_bytes(), str(path), "delete it")["floors"] if path.exists() else []
    return [
        {"floor": row["floor"], "soles": row["soles"]} | {side: row[side]["cost"] for side in ("mujoco", "own")}
        for row in rows
    ]


def _servo_told(model: Model) -> str:
    """What the servo can take, in words."""
    servo = next((servo for servo in model.servos.values() if servo.voltage_limit < math.inf), None)
    if servo is None:
        return ""
    limit = f", and lets no more than {servo.current_limit:g} A pass" if servo.current_limit < math.inf else ""
    return (
        f"This servo stalls at {servo.voltage_limit / servo.resistance:.2f} A from {servo.voltage_limit:g} V{limit}; "
        "a real AX-12 at 1.5 A from 12 V (its manual), which is for moments: the manual calls motions stable up to a "
        "fifth of the stall torque."
    )


def _crosscheck_files(stem: Path) -> dict[str, str]:
    """The files of the crosscheck by kind, if it has written any."""
    paths = crosscheck_files(stem.with_name(stem.name + "_crosscheck"))
    return {kind: str(path) for kind, path in zip(("crosscheck", "crosscheck_table"), paths) if path.exists()}


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _check_folder(folder: Path) -> None:
    """Make the folder and a file in it; raise OSError unless that works."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(b"0")
    except OSError as error:
        why = f"{folder}: no file can be written here ({error.strerror}); give another folder (--out)"
        raise OSError(why) from error


@contextmanager
def _alone_with(history: Path) -> Iterator[None]:
    """Keep other processes from a history and the files beside it.  Raises OSError if one is at work there."""
    with history.open("r+b") as file:
        claim(file, history)
        yield


@contextmanager
def _appearing_together(stem: Path) -> Iterator[Path]:
    """A folder whose files take their places beside it when all are complete; if they cannot be, none does."""
    try:
        with moving_up(stem.parent, stem.name + ".partial") as folder:
            yield folder
    except OSError as error:
        raise OSError(
            f"{stem.parent}: the results cannot be written ({error.strerror}); the search is kept in its history: make "
            "room, then resume (--resume)"
        ) from error


def _check_history(path: Path, first: float) -> None:
    """Raise ValueError unless the history's first gait cost what it costs now; the search compares all else."""
    lines = path.read_bytes().split(b"\n")[:-1] if path.exists() else []
    if len(lines) < 2:
        return
    cost = parse_json(lines[1], f"{path}, line 2", HISTORY_REMEDY).get("f")
    if (math.inf if cost is None else cost) != first:
        raise ValueError(
            f"{path}, line 2: the first gait cost {cost} J/m, but costs {first} now; the history is of another robot, "
            "other servos or another version: give another folder, or delete it"
        )


def write_results(
    stem: Path, cost: WalkingCost, result: OptimizeResult, servo: str = ""
) -> dict[str, Path]:
    """Write arrays, plots, animation and the motion for the real robot; return the files by kind, with the report's.

    stem: path of the files without their endings, in a folder that exists; result: what `optimize_gait` returns; servo:
    that took the place of the robot's own, as of `servo_of`.  The report and its page, of the kinds "report" and
    "page", are named and not written: `main_job` does that.  Raises OSError if a file cannot be written.
    """
    endings = {
        "report": ".json", "arrays": ".npz", "convergence": "_convergence.png", "angles_plot": "_angles.png",
        "page": "_report.html", "animation": "_animation.html", "angles": "_angles.csv",
        "goal_positions": "_goal_positions.csv",
    }  # fmt: skip
    files = {kind: stem.with_name(stem.name + ending) for kind, ending in endings.items()}
    first, names = cost.gait.to_vector(), cost.gait.joint_names
    motion = cost.reference(result.x, SHOWN)
    np.savez_compressed(
        files["arrays"], format=str(ARRAYS), x=result.x, first=first, period=cost.gait.period, joint_names=names,
        start=cost.start, poses=cost.gait.from_vector(result.x).poses, times=motion.times, angles=motion.values,
        costs=result.history["f"], visited=result.history["x"], first_poses=cost.gait.poses,
        servo=servo,
    )  # fmt: skip
    write_angles(files["angles"], motion.times, motion.values, names)
    write_goal_positions(files["goal_positions"], motion.times, motion.values, names)
    plot_convergence(result).savefig(files["convergence"], dpi=130)
    plot_angles(cost, first, result.x).savefig(files["angles_plot"], dpi=130)
    vectors = {"first gait": first, "optimized gait": result.x}
    runs = cost.simulate(vectors.values(), strides=SHOWN)
    captions = [f"{name}: {_described(m)}" for name, m in zip(vectors, cost.measure(vectors.values()))]
    title = f"{cost.scene.model.name}, {cost.scene.servos} servos"
    write_animation(files["animation"], cost.scene.model, dict(zip(captions, runs)), title)
    return files


def summary(report: dict) -> str:
    """The report as a table to read.

    report: what `main_job` returns, or its JSON file holds.
    """
    search, sides = report["search"], (report["before"], report["after"])
    before, after = (side | {"finer_cost": side["at_a_quarter_of_the_step"]["cost"]} for side in sides)
    elsewhere = report["elsewhere"]
    if elsewhere is not None:
        before, after = (
            side | {"walks": found["walks"], "sideways_share": found["sideways"]}
            | dict(zip(("cost_5", "cost_50", "cost_95"), found["cost"] or [None] * 3))
            for side, found in ((before, elsewhere["before"]), (after, elsewhere["after"]))
        )  # fmt: skip
    rows = [
        ("energy per distance", "cost", "J/m", 1.0, 1),
        ("... at a quarter of the step", "finer_cost", "J/m", 1.0, 1),
        ("cost of transport", "cost_of_transport", "", 1.0, 2),
        ("step length", "stride_length", "mm", 500.0, 1),
        ("speed", "speed", "mm/s", 1e3, 1),
        ("slip a stride", "slip", "mm", 1e3, 1),
        ("walks with angles off by 1 deg", "safe", "%", 100.0, 0),
    ]
    if elsewhere is not None:
        rows += [
            (f"walks in {elsewhere['after']['worlds']} other worlds", "walks", "%", 100.0, 1),
            ("energy there: median", "cost_50", "J/m", 1.0, 1),
            ("... 5th percentile", "cost_5", "J/m", 1.0, 1),
            ("... 95th percentile", "cost_95", "J/m", 1.0, 1),
            ("largest drift sideways there", "sideways_share", "%", 100.0, 1),
        ]
    settings = report["settings"]
    where = f"{settings['worlds']} worlds" if settings["worlds"] else "one floor"
    lines = [f"servo {settings['servo']}, poses of a {settings['states']}, {where}"]
    own = report.get("with_own_servos")
    if own is not None and own["servo"] != "none":
        a, b = (
            f"{x['cost']:.1f} J/m at {1e3 * x['speed']:.0f} mm/s" if x["status"] == "ok" else x["status"]
            for x in (before, own)
        )
        lines.append(f"first gait with it: {a}; with the robot's own, {own['servo']}: {b}")
    lines.append(f"{'':30} {'first':>10} {'optimized':>10} {'change':>8}")
    for name, key, unit, scale, digits in rows:
        a, b = (math.nan if side[key] is None else scale * side[key] for side in (before, after))
        change = f"{100.0 * (b / a - 1.0):+.0f} %" if a > 0.0 and b > 0.0 and unit != "%" else ""
        cells = ["fails" if math.isnan(x) else f"{x:.{digits}f}" for x in (a, b)]
        lines.append(f"{name:30} {cells[0]:>10} {cells[1]:>10} {change:>8} {unit}".rstrip())
    lines += _limits_told(report["plausible"])
    lines += _gains_told(report)
    work, lanes = report["evaluations"], report["evaluations"]["lane_occupancy"]
    lines += [
        f"{search['candidates']} candidates in {report['seconds']['search']:.1f} s, all in "
        f"{report['seconds']['all']:.1f} s: {search['message']}",
        f"{work['begun']} evaluations begun, {work['wasted']} of them wasted by speculation"
        + (f"; lanes {100.0 * lanes:.1f} % occupied" if lanes is not None else ""),
        *_pushes_told(report.get("feedback")),
        f"crosscheck: {report.get('crosscheck') or NOT_CHECKED}",
        *(f"{kind:16} {path}" for kind, path in report["files"].items()),
    ]
    return "\n".join(lines)


def _pushes_told(feedback: dict | None) -> list[str]:
    """A line about what feedback is worth."""
    if not feedback:
        return []
    with_it, without = (math.fsum(feedback["pushes"][side]) / 8 for side in ("with", "without"))
    return [
        f"pushes that half survive, mean of eight sides: {with_it:.3g} N s with feedback, {without:.3g} without; other "
        "worlds and crosscheck are with it"
    ]


def _limits_told(plausible: dict) -> list[str]:
    """What a real robot asks for, on the robot's own floor: a line a limit."""
    sides = [{one["name"]: one for one in plausible[side]["limits"] or []} for side in ("before", "after")]
    lines = ["limits of a real robot, worst values on its own floor (! beyond the limit)"] if any(sides) else []
    for limit in LIMITS:
        unit, scale = SHOWN_IN[limit.unit]
        cells, where = [], ""
        for side in sides:
            one = side.get(limit.name)
            known = one is not None and one["value"] is not None
            cells.append(f"{scale * one['value']:.1f}{'' if one['kept'] else '!'}" if one and known else "none")
            if one and known and one["time"] is not None:
                where = f"{one['where']} at {one['time']:.2f} s"
        if any(sides):
            bound = f"{'at most' if limit.most else 'at least'} {scale * limit.bound:g} {unit}"
            lines.append(f"{limit.what:30} {cells[0]:>10} {cells[1]:>10} {bound}")
            lines += [f"    worst: {where}"] if where else []
    return lines


def _gains_told(report: dict) -> list[str]:
    """With what is drawn all the time, and at equal speed."""
    standby, found = report["standby"], report["after"]["cost"]
    lines = []
    for row in report["baselines"][1:]:
        if row["status"] == "ok" and found is not None:
            walk, gain = f"{row['cost']:.1f} J/m, {1e3 * row['speed']:.0f} mm/s", 100.0 * (found / row["cost"] - 1.0)
            lines.append(f"against the {row['name']} ({walk}): {gain:+.0f} %")
    for name in standby["watts"]:
        a, b = standby["before"][name], standby["after"][name]
        if a is not None and b is not None and standby["watts"][name]:
            watts = f"J/m, {standby['watts'][name]:.1f} W{' assumed' if standby['assumed'] else ''}"
            what = "+ " + name.replace("electronics of the ", "electronics: ")
            lines.append(f"{what:31}{a:10.1f} {b:10.1f} {100.0 * (b / a - 1.0):+6.0f} % {watts}")
    for row in report["at_equal_speed"]:
        what = f"as fast as the {row['baseline']} ({1e3 * row['speed']:.0f} mm/s, {row['cost']:.1f} J/m)"
        if row["found"] is None:
            lines.append(f"{what}: no gait on the search's way")
        else:
            lines.append(f"{what}: {row['found']['cost']:.1f} J/m, {-100.0 * row['gain']:+.0f} %")
    return lines


def _described(measures: Measures) -> str:
    if measures.status != "ok":
        return measures.status
    return f"{measures.cost:.1f} J/m, steps of {500.0 * measures.stride_length:.0f} mm, {1e3 * measures.speed:.0f} mm/s"


def _settings(cost: WalkingCost, iterations: int, seed: int, worlds: int) -> dict:
    scene = cost.scene
    return {
        "servos": scene.servos, "integrator": scene.integrator, "timestep": scene.timestep,
        "ground": scene.ground and asdict(scene.ground), "iterations": iterations, "seed": seed, "max_miss": MAX_MISS,
        "worlds": worlds,
        "states": "stride" if cost.gait.mirror is None else "step",
        "amplitude_deg": math.degrees(AMPLITUDE), "period": cost.gait.period, "poses": len(cost.gait.poses),
        "warm_up_strides": cost.warm_up, "measured_strides": cost.strides, "start_of_measurement": cost.mark,
    }  # fmt: skip


@look()
def plot_convergence(result: OptimizeResult) -> Figure:
    """Cost of every candidate and the best so far [J/m]; from where a search keeps to limits on, anew.

    result: of `optimize_gait` or `optimize_with_limits`, in which some gait walks.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 4.0), layout="constrained")
    axes = figure.subplots()
    costs = result.history["f"]
    best = np.concatenate([least_so_far(part) for part in parts_of(costs, result.get("since"))])
    start = best[np.isfinite(best)][0]
    failed = np.flatnonzero(~(costs < 1.5 * start))
    axes.plot(costs, ".", color="0.65", markersize=3, label="candidate")
    axes.plot(failed, np.full(len(failed), 1.5 * start), "|", color=BAD, alpha=0.4, label="fell, or costs more")
    axes.step(np.arange(len(best)), best, where="post", color=BLUE, label="best so far")
    axes.set(xlabel="candidate", ylabel="energy per distance [J/m]", ylim=(0.0, 1.55 * start), xlim=(0, len(costs)))
    axes.legend(loc="lower left")
    return figure


@look()
def plot_angles(cost: WalkingCost, first: np.ndarray, best: np.ndarray) -> Figure:
    """The joint angles of a stride [deg], before and after, with the poses.

    first, best: gait vectors (D,) [rad], as of `cost.gait.to_vector()`.
    """
    from matplotlib.figure import Figure

    names, n = cost.gait.joint_names, len(cost.gait.joint_names)
    columns = math.ceil(n / 2)
    figure = Figure(figsize=(max(2.4 * columns, 5.0), 5.0), layout="constrained")
    panels = figure.subplots(2, columns, sharex=True, squeeze=False).ravel()
    times = np.linspace(0.0, cost.gait.period, 121)
    for x, style, label in ((first, "0.6", "first gait"), (best, BLUE, "optimized gait")):
        gait = cost.gait.from_vector(x)
        knots = np.arange(len(gait.poses)) * gait.period / len(gait.poses)
        for k, panel in enumerate(panels[:n]):
            panel.plot(times, np.degrees(gait.angles(times)[:, k]), color=style, label=label)
            panel.plot(knots, np.degrees(gait.poses[:, k]), "o", color=style, markersize=4)
    for panel, name in zip(panels, names):
        panel.set_title(name.replace("_", " "))
    for panel in panels[n:]:
        panel.set_axis_off()
    figure.supxlabel("time in the stride [s]", fontsize="medium")
    figure.supylabel("joint angle [deg]", fontsize="medium")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure
