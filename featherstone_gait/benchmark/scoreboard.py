"""Compare with MuJoCo, Pinocchio, Bullet and Drake on public problems: error beside time, won or lost.

multibody   IFToMM A01 to A05: pendulum, parallelograms, Andrews' squeezer, Bricard's mechanism, flyball governor; the
            error is that of the joints at the end, against closed forms, published angles, or error control near
            rounding.
servos      An arm of seven joints, free, on stiff servos without rotors, and with rotors; errors as above.
contact     Tests of SimBenchmark, against the motion of rigid bodies: what rests, rolls, and bounces (`contact.py`).
creep       A box on a slope and a joint, which friction holds for ten minutes (`creep.py`).
walking     A humanoid walks four seconds with a planned gait; the error is the way by which the trunk's path leaves the
            path of the same engine at 1/16 ms.  And ten strides of the optimized gait, with its energy per distance.
gradients   A cost of a fall of 0.2 s by 399 torques, against extrapolated differences (`gradients.py`).
first       CPU time of a new process to a first result: from an empty cache, and from a filled one.

All methods of a case are timed in turn in one process, in processor time without the preparation of a run; of some
runs the least counts.  Times of ours are those of one run, without the second one that estimates its error.  What
takes longer than some seconds is left out, and what an engine cannot state has a row that says so.

`time_ratio` is the time over that of ours at the same error.  An error counts only if all shorter steps of that method
keep it too, and the cost at an error is interpolated between settings, but not across a jump of more than a factor
1000, where a step becomes stable.

A case is written when it is finished, so that --resume continues; --only measures one part and keeps the others.

    featherstone-gait benchmark scoreboard        half an hour
"""

from __future__ import annotations

import atexit
import math
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np

from ..base.files import read_csv
from ..base.progress import progress_bar
from ..crosscheck.floors import FLOORS, WARM_UP
from ..crosscheck.in_mujoco import TIMESTEP, Floor, replay, sinking, standing
from ..model import Ground
from ..robot_file import load_robot, save_robot
from ..run.simulate import simulate, standing_state
from ..run.trajectory import Trajectory
from ..scene.compile import CompiledScene, compile_scene
from ..view.style import COLORS, look, subplots
from ..walking.cost import measured as walked
from ..walking.motion import Motion, read_motion
from . import contact, creep, first, gradients, in_bullet, rollouts
from .case import Case
from .costs import Point, cheapest, steady
from .engines import quick_mujoco
from .linkages import linkages
from .methods import ENGINES, WHEELS, Method, Once, Result, cannot, methods, release
from .scenes import free_arm, governor, pendulum, stiff_arm
from .table import TABLE, installed, machine, print_table, save_figure, tabulate, write_table

ROUNDS, ROUNDS_FULL, ENOUGH = 3, 9, 0.3  # turns; CPU seconds after which a setting is not run again
SLOWEST = 1.0  # of a run, beyond which shorter steps are left out [CPU s]
SMOOTH = ("dop853", "extrapolation", "rk4", "midpoint")
STIFF = ("dop853", "extrapolation", "midpoint", "implicit_euler")
ENDS = (1e-2, 1e-4, 1e-6, 1e-8)  # errors of joints at which engines are compared [rad]
STRIDES = 10  # of the optimized gait
PLOTTED = ("multibody", "servos", "contact", "walking")


class Comparison(NamedTuple):
    """Describe a case that all engines run."""

    part: str
    name: str
    unit: str  # of the error
    per: str  # of what the times are
    span: float  # so many of these a run takes
    asked: Sequence[float]  # errors at which engines are compared
    methods: Callable[[], Iterator[Method]]
    lacks: Mapping[str, str] = {}  # engines that cannot state it, and why
    slowest: float = SLOWEST  # [CPU s]


class Row(NamedTuple):
    """Hold one line of the table."""

    part: str
    case: Annotated[str, "case", "<24"]
    engine: Annotated[str, "engine", "<9"]
    version: str
    method: Annotated[str, "method", "<34"]
    setting: Annotated[float, "step, rtol", "10g"]  # [s]
    error: Annotated[float, "error", "8.1e"]
    unit: Annotated[str, "", "<14"]
    time: Annotated[float, "CPU ms", "9.3g"]
    per: Annotated[str, "", "<20"]
    time_ratio: Annotated[float, "by ours", "8.2g"]  # to the time of ours at this error
    note: Annotated[str, "", "<2"]


class Line(NamedTuple):
    """Hold our time at an error, and those of the others by ours: infinite where they do not get there.

    NaN where an engine has no rows, 0 where ours alone does not get there.
    """

    part: str
    case: Annotated[str, "case", "<24"]
    error: Annotated[float, "at error", "8.0e"]
    unit: Annotated[str, "", "<14"]
    ours: Annotated[float, "ours [ms]", "9.3g"]
    mujoco: Annotated[float, "MuJoCo", "8.2g"]
    pinocchio: Annotated[float, "Pinocchio", "9.2g"]
    bullet: Annotated[float, "Bullet", "8.2g"]
    drake: Annotated[float, "Drake", "8.2g"]
    won: bool  # no other engine is faster at this error
    better: Annotated[str, "faster than ours", "<18"]
    methods: Annotated[str, "", "<2"]


def run(out_dir: Path, full: bool = False, only: str | None = None, resume: bool = False) -> list[Line]:
    """Print the tables; write scoreboard.csv, scoreboard_lines.csv and a picture of each part into `out_dir`.

    only: one of the parts; resume: keep cases that the table in `out_dir` has.  Rows of another machine or other
    versions are not kept.
    """
    host = machine() + "".join(f", {WHEELS[name]} {release(name)}" for name in ("Bullet", "Drake") if release(name))
    print(host)
    path, found = out_dir / "scoreboard.csv", list(tests())
    parts = list(dict.fromkeys(test.part for test in found))
    if only not in (None, *parts):
        raise ValueError(f"only={only!r}: expected one of {', '.join(parts)}")
    rows = kept(path, host) if resume or only else {}
    asked = [test for test in found if only in (None, test.part) and not (resume and test.name in rows)]
    with quick_mujoco() if installed("mujoco") else nullcontext():
        for test in progress_bar(asked, "scoreboard", unit="case"):
            rows[test.name] = print_table(Row, measured(test, ROUNDS_FULL if full else ROUNDS))
            in_order = [row for test in found for row in rows.get(test.name, ())]
            write_table(path, Row._fields, in_order, host)
    for part in PLOTTED:
        shown = [test for test in found if test.part == part and test.asked and test.name in rows]
        if shown:
            plot(out_dir / f"scoreboard_{part}.png", {test.name: rows[test.name] for test in shown}, host)
    lines = (line for test in found for line in lines_of(test, rows.get(test.name, ())))
    return tabulate(out_dir / "scoreboard_lines.csv", Line, lines, host)


def kept(path: Path, host: str) -> dict[str, list[Row]]:
    """Return the rows of a table by case; none of another machine or other versions, nor of a file that is missing."""
    if not path.exists():
        return {}
    notes = [line[2:].rstrip() for line in path.read_text("utf-8").splitlines() if line.startswith("# ")]
    if notes != [str(TABLE), *host.splitlines()]:
        print(f"{path}: of another machine or other versions; nothing of it is kept")
        return {}
    return rows_of(path)


def rows_of(path: Path) -> dict[str, list[Row]]:
    """Return the rows of a table by case, whatever machine and versions they are from."""
    rows: dict[str, list[Row]] = {}
    for _, cells in list(read_csv(path, TABLE))[1:]:
        named: dict[str, Any] = dict(zip(Row._fields, cells, strict=True))
        row = Row(**named | {name: float(named[name] or "nan") for name in ("setting", "error", "time", "time_ratio")})
        rows.setdefault(row.case, []).append(row)
    return rows


# ---------------------------------------------------------------------------------------------- measuring


def measured(test: Comparison, rounds: int) -> list[Row]:
    """Find the errors of all methods, then time all in turn; add rows for the engines without any."""
    rows, runs, times = list[Row](), list[Once](), list[list[float]]()
    for method in progress_bar([*test.methods()], test.name, leave=False):
        last = math.nan
        for before, setting in zip((math.inf, *method.settings), method.settings):
            if last * min(before / setting, 10.0) > test.slowest:
                break
            once = method.ready(setting)
            if method.engine == "ours" and math.isnan(last) and test.part != "first":
                once()  # compiles
            result = once()
            last = result.seconds if result.seconds == result.seconds else last
            rows.append(_row(test, method.engine, method.name, setting, result))
            runs.append(once)
            times.append([result.seconds])
    for _ in progress_bar(range(rounds - 1), f"{test.name}, times", leave=False):
        for once, spent in zip(runs, times):
            if sum(spent) < ENOUGH:
                spent.append(once().seconds)
    rows = [row._replace(time=_short(1e3 * min(spent) / test.span)) for row, spent in zip(rows, times)]
    return [*with_ratios(rows), *_absent(test, rows)]


def _row(test: Comparison, engine: str, method: str, setting: float, result: Result) -> Row:
    return Row(
        test.part, test.name, engine, release(engine), method, setting, _short(result.error), test.unit, math.nan,
        test.per, math.nan, result.note,
    )  # fmt: skip


def _short(number: float) -> float:
    return float(f"{number:.4g}")


def with_ratios(rows: Sequence[Row]) -> list[Row]:
    """Give the rows of other engines their time by that of ours at the same error: zero where ours never has it."""
    ours = list(steady([_point(row) for row in rows if row.engine == "ours"]))
    ratios = [
        row.time / cheapest(row.error, ours, row.case)[0] if row.engine != "ours" and row.error < math.inf and ours
        else math.nan
        for row in rows
    ]  # fmt: skip
    return [row._replace(time_ratio=_short(ratio)) for row, ratio in zip(rows, ratios)]


def _absent(test: Comparison, rows: Sequence[Row]) -> Iterator[Row]:
    """Yield a row for each engine that has none, with the reason."""
    seen = {row.engine for row in rows}
    for engine in ENGINES:
        if engine not in seen:
            missing = not installed(ENGINES[engine])
            why = f"not installed: pip install {WHEELS[engine]}" if missing else test.lacks.get(engine, "not tried")
            nothing = Result(math.nan, math.nan, why)
            yield _row(test, engine, "", math.nan, nothing)


def _point(row: Row) -> Point:
    return Point(row.case, f"{row.engine}: {row.method}", row.setting, row.error, row.time)


def lines_of(test: Comparison, rows: Sequence[Row]) -> Iterator[Line]:
    """Compare the engines at each error."""
    points = list(steady([_point(row) for row in rows if row.time == row.time]))
    for error in test.asked if rows else ():
        costs, names = {}, []
        for engine in ENGINES:
            own = [point for point in points if point.method.startswith(f"{engine}: ")]
            cost, name = cheapest(error, own, test.name)
            costs[engine] = cost if own else math.nan
            names += [name] if math.isfinite(cost) else []
        ours = costs.pop("ours")
        ratios = {engine: math.inf if math.isinf(cost) else cost / ours for engine, cost in costs.items()}
        faster = ", ".join(engine for engine, ratio in ratios.items() if ratio < 1.0)
        by_name = {engine.lower(): ratio for engine, ratio in ratios.items()}
        yield Line(test.part, test.name, error, test.unit, ours, **by_name, won=not faster, better=faster,
                   methods="; ".join(names))  # fmt: skip


# ---------------------------------------------------------------------------------------------- cases


def tests() -> Iterator[Comparison]:
    """Yield all cases."""
    for case in (pendulum(), *linkages(), governor()):
        yield _of_case("multibody", case, STIFF if "A05" in case.name else SMOOTH)
    for case, own in ((free_arm(), SMOOTH), (stiff_arm("standard"), STIFF), (stiff_arm("rotor"), STIFF)):
        yield _of_case("servos", case, own)
    none = {"Pinocchio": "no contact dynamics of its own"}
    for trial in contact.trials():
        yield Comparison("contact", trial.name, trial.unit, "simulated second", trial.duration, trial.asked,
                         partial(contact.methods, trial), none, 3.0)  # fmt: skip
    for what, lacks in creep.LACKS.items():
        yield Comparison("creep", f"{what} held", "m" if what == "box" else "rad", "simulated second", creep.DURATION,
                         (1e-3, 1e-6, 1e-9, 1e-12), partial(creep.methods, what), lacks, 30.0)  # fmt: skip
    yield Comparison("walking", "humanoid walks", "m", "simulated second", rollouts.DURATION, rollouts.ERRORS, walks,
                     none)  # fmt: skip
    yield Comparison("walking", "optimized gait", "", "simulated second", 1.0, (), gaits, none)
    yield Comparison("gradients", "fall, 399 parameters", "relative", "gradient", 1.0, (1e-6,), falling, slowest=10.0)
    yield Comparison("first", "first result, arm", "", "process", 1.0, (), partial(firsts, "arm7"))
    yield Comparison("first", "first result, humanoid", "", "process", 1.0, (), partial(firsts, "humanoid"))


def _of_case(part: str, case: Case, own: Sequence[str]) -> Comparison:
    lacks = {engine: f"cannot state it: {why}" for engine in ENGINES if (why := cannot(engine, case))}
    return Comparison(part, case.name, "rad", "simulated second", case.duration, ENDS,
                      partial(methods, case, own), lacks)  # fmt: skip


def walks() -> Iterator[Method]:
    """Yield the rollouts of a planned walk, of engines that are compared in `rollouts`."""
    for one in rollouts.engines(load_robot("humanoid", locked="simplified"), vectors=False):
        engine = "ours" if one.name in rollouts.OURS else "MuJoCo"
        exact = one.walk(rollouts.FINEST, 1)
        yield Method(engine, one.name.removeprefix("MuJoCo "), one.steps, partial(_walked, one, exact))


def _walked(one: rollouts.Engine, exact: np.ndarray, h: float) -> Once:
    def once() -> Result:
        began = time.process_time()
        path = one.walk(h, 1)
        spent = (time.process_time() - began) / rollouts.COUNT
        upright = rollouts.stands(path)
        fell = f"{1.0 - upright.mean():.0%} fell" if not upright.all() else ""
        return Result(math.inf if fell else rollouts.deviation(path, exact, upright), spent, fell)

    return once


def gaits() -> Iterator[Method]:
    """Yield walks of the optimized gait; MuJoCo and Bullet have its servos and rotors in NumPy beside them."""
    # The ground here only defines what counts as a fall.
    scene = compile_scene(load_robot("humanoid", locked="simplified"), "mipsd", Ground(), "midpoint", 1e-3)
    motion = read_motion(Path(scene.model.source).parent / "optimized_gait.npz", scene.model.joint_names)
    yield Method("ours", "midpoint", (TIMESTEP,), partial(_gait, scene, motion, _own_walk))
    if installed(ENGINES["MuJoCo"]):
        yield Method("MuJoCo", "implicitfast", (TIMESTEP,), partial(_gait, scene, motion, _mujoco_walk))
    if installed(ENGINES["Bullet"]):
        yield Method("Bullet", "semi-implicit Euler", (TIMESTEP,), partial(_gait, scene, motion, _bullet_walk))


def _gait(scene: CompiledScene, motion: Motion, walk: Callable[..., float | None], _: float) -> Once:
    end = motion.begin(WARM_UP + STRIDES)

    def once() -> Result:
        began = time.process_time()
        cost = walk(scene, motion, end)
        said = "falls" if cost is None else f"walks {STRIDES} strides, {cost:.1f} J/m"
        return Result(math.nan, (time.process_time() - began) / end, said)

    return once


def _own_walk(scene: CompiledScene, motion: Motion, end: float) -> float | None:
    own, reference = scene.recompiled(integrator="midpoint", timestep=TIMESTEP), motion.reference(WARM_UP + STRIDES)
    state = standing_state(own, reference.values[0])
    run = simulate(own, end, state, reference, record=("base_q", "energy"), estimate_error=False)
    return _cost(scene, run, motion, end)


def _mujoco_walk(scene: CompiledScene, motion: Motion, end: float) -> float | None:
    reference, floor = motion.reference(WARM_UP + STRIDES), Floor(*FLOORS["20ms_0.9"])
    begin = standing(scene, reference.values[0], sinking(scene, reference.values[0], floor))
    return _cost(scene, replay(scene, end, begin, reference, floor), motion, end)


def _bullet_walk(scene: CompiledScene, motion: Motion, end: float) -> float | None:
    return in_bullet.walk(scene, motion, STRIDES)


def _cost(scene: CompiledScene, run: Trajectory, motion: Motion, end: float) -> float | None:
    """Return the energy per distance [J/m], None after a fall."""
    found = walked(scene, run, motion.begin(WARM_UP), end, STRIDES, slip=False)
    return found.energy / found.distance if found.status == "ok" else None


def falling() -> Iterator[Method]:
    """Yield gradients of a fall."""
    for timed in gradients.falling(gradients.KNOTS[-1]):
        theirs, _, name = timed.row.method.rpartition(", ")
        yield Method(theirs or "ours", name, (math.nan,), partial(_differentiated, timed))


def _differentiated(timed: gradients.Timed, _: float) -> Once:
    def once() -> Result:
        began = time.process_time()
        timed.call()
        return Result(timed.row.error, time.process_time() - began)

    return once


PEERS = {  # programs that load a robot from a folder and make 50 steps
    "MuJoCo": """
import mujoco
m = mujoco.MjModel.from_xml_path("robot.xml")
d = mujoco.MjData(m)
for _ in range(50):
    mujoco.mj_step(m, d)
""",
    "Pinocchio": """
import pinocchio
m = pinocchio.buildModelFromUrdf("robot.urdf")
d, q, v = m.createData(), pinocchio.neutral(m), pinocchio.utils.zero(m.nv)
for _ in range(50):
    v = v + 2e-3 * pinocchio.aba(m, d, q, v, 0.0 * v)
    q = pinocchio.integrate(m, q, 2e-3 * v)
""",
    "Bullet": """
import pybullet
pybullet.connect(pybullet.DIRECT)
pybullet.loadURDF("robot.urdf")
for _ in range(50):
    pybullet.stepSimulation()
""",
    "Drake": """
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import Simulator
plant = MultibodyPlant(2e-3)
Parser(plant).AddModels("robot.urdf")
plant.Finalize()
Simulator(plant).AdvanceTo(0.1)
""",
}


def firsts(robot: str) -> Iterator[Method]:
    """Yield new processes that import, load a robot, and simulate 0.1 s."""
    kind = {"arm7": "free arm", "humanoid": "humanoid on the ground"}[robot]
    folder = tempfile.mkdtemp()  # which the methods share
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    save_robot(load_robot(robot), Path(folder) / "robot.urdf")
    save_robot(load_robot(robot), Path(folder) / "robot.xml", Ground())
    for cache in ("empty cache", "filled cache"):
        yield Method("ours", cache, (math.nan,), partial(_process, folder, first.PROGRAMS[kind]))
    for engine, code in PEERS.items():
        if installed(ENGINES[engine]):
            timed = f"import os, time\nos.chdir({folder!r})\n{code}\nprint()\nprint(time.process_time())"
            yield Method(engine, "", (math.nan,), partial(_process, folder, timed))


def _process(folder: str, program: str, _: float) -> Once:
    return lambda: Result(math.nan, first.seconds(program, folder))


# ---------------------------------------------------------------------------------------------- pictures


def front(points: Sequence[Point]) -> list[Point]:
    """Return the points that no other one beats in both error and time, from the largest error on."""
    found: list[Point] = []
    for point in sorted(points, key=lambda p: (p.error, p.time)):
        if 0.0 < point.error < math.inf and (not found or point.time < found[-1].time):
            found.append(point)
    return found[::-1]


@look()
def plot(path: Path, rows: Mapping[str, Sequence[Row]], notes: str) -> None:
    """Draw time against error by case, of each engine what no other method or setting of it beats."""
    columns = min(3, len(rows))
    lines = -(-len(rows) // columns)
    figure, panels = subplots(3.6 * columns + 0.2, 3.0 * lines + 0.8, lines, columns, squeeze=False)
    for panel in panels.ravel()[len(rows) :]:
        panel.set_axis_off()
    seen = {}
    for panel, (name, of) in zip(panels.ravel(), rows.items()):
        for engine, color, marker in zip(ENGINES, COLORS, "os^Dv"):
            points = front(list(steady([_point(row) for row in of if row.engine == engine and row.time == row.time])))
            points = [point for point in points if 1e-13 < point.error < 1.0]
            if points:
                (seen[engine],) = panel.loglog(
                    [point.error for point in points], [point.time for point in points], color=color, marker=marker,
                    markersize=4, linewidth=2.0 if engine == "ours" else 1.2,
                )  # fmt: skip
        panel.set(title=name, xlabel=f"error [{of[0].unit}]", ylabel=f"CPU ms per {of[0].per}")
    figure.legend(seen.values(), seen, loc="outside lower center", ncols=len(seen))
    figure.suptitle(notes.splitlines()[0], fontsize=8)
    save_figure(figure, path)
