"""Run time against error of every integrator: arms, a humanoid that flies, stands and walks, published problems.

Each problem is run with fixed steps and with tolerances.  The error is the largest of joint angles and turn of the base
[rad], and of the base's position [m], at the end or over all records, against a closed form or a run of error control
near rounding, whose own error is what another integrator or a ten times looser tolerance changes.

The time is that of the compiled run, with all its arguments prepared: least CPU time of some runs, single-threaded, by
simulated time.  A call of `simulate` costs more, which is a column of its own.

The published problems: the free box of the Gazebo benchmark (github.com/scpeters/benchmark, 1 x 4 x 9 m, simple: no
gravity, turning about one axis; complex: thrown, turning about the middle axis, which is unstable) and, of the IFToMM
library of benchmark problems, A01, the pendulum, and A05, the stiff flyball governor (M. Gonzalez et al., A
collaborative benchmarking framework for multibody system dynamics, Engineering with Computers 26 (2010), doi
10.1007/s00366-009-0139-0).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from tqdm import tqdm

from ..base.files import complete, number, read_csv
from ..core.integrate import INTEGRATORS
from ..model import ContactPoint, Ground, HeightField, Joint, Link, Model, Spring
from ..robot_file import load_robot, load_servo
from ..run.prepared import prepare, with_tolerance
from ..run.reference import Reference
from ..run.simulate import initial_state, reset_time, simulate, standing_state
from ..run.trajectory import Trajectory, positions
from ..run.verdict import trajectory
from ..scene.compile import CompiledScene, compile_scene
from ..view.style import look
from .machine import machine
from .table import TABLE, write_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D

STEPS = (0.1, 5e-2, 2e-2, 1e-2, 5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4, 5e-5, 2e-5)  # [s]
TOLERANCES = tuple(10.0**-k for k in range(2, 14))
ENOUGH, REPEATS, REPEATS_FULL = 0.15, 5, 25  # CPU seconds and runs after which a time is believed
STIFF_SERVO: dict[str, Any] = {"law": "pd_clamped", "Kp": 12.97, "Kd": 0.374, "torque_limit": 1.5}


class Problem(NamedTuple):
    """What is simulated."""

    name: str
    model: Model
    arguments: dict  # of `compile_scene`
    duration: float  # [s]
    state: Callable[[CompiledScene], np.ndarray]
    integrators: dict[str, float]  # the finest step [s], or the least tolerance
    reference: Reference | None = None
    record_interval: float | None = None  # time between records [s]; None: the end alone counts
    exact: Callable[[np.ndarray], np.ndarray] | None = None  # joint angles at times [s]
    coarsest: float = 1e-2  # step [s]
    best: str = "extrapolation"  # gives the reference solution ...
    finest: float = 1e-13  # ... with this tolerance
    check: str | None = None  # integrator that tells its error; None: a ten times looser tolerance does

    def scene(self, integrator: str, timestep: float | None = None) -> CompiledScene:
        return compile_scene(self.model, integrator=integrator, timestep=timestep, **self.arguments)

    @property
    def signal(self) -> Reference:
        """The reference of a problem that has one."""
        assert self.reference is not None
        return self.reference

    @property
    def record(self) -> tuple[str, ...]:
        return ("base_q", "q") if self.model.base == "floating" else ("q",)

    def run(self, integrator: str, setting: float) -> Run:
        """The compiled run with a step [s] or a tolerance."""
        adaptive = INTEGRATORS[integrator].adaptive
        scene = self.scene(integrator, None if adaptive else setting)
        every = self.record_interval or self.duration
        return Run(scene, self.duration, self.state(scene), self.reference, every, setting if adaptive else None,
                   self.record)  # fmt: skip


class Row(NamedTuple):
    """One line of the table."""

    problem: str
    integrator: str
    step: float  # [s], NaN with error control
    rtol: float  # NaN with fixed steps
    angle: float  # error of joints and of the base's turn [rad, of sliding joints m]
    shift: float  # error of the base's position [m], NaN where it is fixed
    reference_error: float  # of what the errors are counted from [rad or m]
    time: float  # of the compiled run per simulated second [ms]
    call: float  # of `simulate` per simulated second [ms]
    evaluations: int  # of the derivative or implicit solutions; with fixed steps one or, of rk4, four a step
    status: str

    @property
    def error(self) -> float:
        """The larger one [rad or m]."""
        return self.angle if math.isnan(self.shift) else max(self.angle, self.shift)


class Run:
    """The compiled run of a simulation with its arguments prepared, to be timed without what Python does about it."""

    def __init__(
        self,
        scene: CompiledScene,
        duration: float,
        state: np.ndarray,
        reference: Reference | None,
        record_interval: float | None,
        rtol: float | None = None,
        record: tuple[str, ...] = ("q",),
    ) -> None:
        self.scene, rtol, atol = with_tolerance(scene, rtol, None)
        self.settings = (duration, state, reference, record_interval, rtol, record)
        self.ready = prepare(self.scene, duration, record, record_interval, rtol=rtol, atol=atol)
        self.start = self.ready.start(state, reference)
        self.arguments = self.ready.arguments(self.start)

    def once(self) -> float:
        """Run; return CPU time per simulated second [ms]."""
        self.arguments[1][:] = self.start.y
        start = time.thread_time()
        self.ready.kernel(*self.arguments)
        return 1e3 * (time.thread_time() - start) / self.settings[0]

    def call(self) -> float:
        """The same by `simulate`; return its CPU time per simulated second [ms]."""
        duration, state, reference, record_interval, rtol, record = self.settings
        start = time.thread_time()
        how: dict[str, Any] = dict(record=record, record_interval=record_interval, rtol=rtol, estimate_error=False)
        simulate(self.scene, duration, state, reference, **how)
        return 1e3 * (time.thread_time() - start) / duration

    @property
    def trajectory(self) -> Trajectory:
        return trajectory(self.ready, *self.arguments[1:])


def run(out_dir: Path, full: bool = False) -> list[Row]:
    """Print the table; write precision.csv and precision.png into `out_dir`; `full` repeats runs more often."""
    out_dir = Path(out_dir)
    where = machine()
    print(where)
    rows: list[Row] = []
    for problem in problems():
        rows += measure(problem, REPEATS_FULL if full else REPEATS)
    print_table(rows)
    write(out_dir / "precision.csv", rows, where)
    plot(out_dir / "precision.png", rows, where)
    return rows


def measure(problem: Problem, repeats: int = REPEATS, settings: Sequence[tuple[str, float]] | None = None) -> list[Row]:
    """Rows of a problem; settings: (integrator, step or tolerance) to try, by default all."""
    exact, own_error = solution(problem)
    tried = settings or [
        (integrator, value)
        for integrator, finest in problem.integrators.items()
        for value in (TOLERANCES if INTEGRATORS[integrator].adaptive else STEPS)
        if 0.99 * finest <= value <= (1.0 if INTEGRATORS[integrator].adaptive else problem.coarsest)
    ]
    for integrator in dict.fromkeys(integrator for integrator, _ in tried):
        coarsest = max(value for name, value in tried if name == integrator)
        problem.run(integrator, coarsest).once()  # compiles
    return [
        _row(problem, integrator, value, exact, own_error, repeats)
        for integrator, value in tqdm(tried, desc=problem.name, leave=False, disable=None)
    ]


def solution(problem: Problem) -> tuple[np.ndarray, float]:
    """Positions (samples, nq) as exact as we can tell, and their own error [rad or m]."""
    best = problem.run(problem.best, problem.finest)
    if problem.exact is not None:
        return problem.exact(best.trajectory["time"]), 0.0
    other = problem.run(problem.check or problem.best, problem.finest if problem.check else 10.0 * problem.finest)
    best.once()
    other.once()
    reference = positions(best.trajectory)
    return reference, float(np.nanmax(deviation(problem.model, positions(other.trajectory), reference)))


def deviation(model: Model, q: np.ndarray, exact: np.ndarray) -> tuple[float, float]:
    """Largest errors of positions (samples, nq): joints and turn of the base [rad], place of the base [m] or NaN."""
    if model.base != "floating":
        return float(np.abs(q - exact).max()), math.nan
    a, b = q[:, 3:7], exact[:, 3:7]
    axis = a[:, :1] * b[:, 1:] - b[:, :1] * a[:, 1:] - np.cross(a[:, 1:], b[:, 1:])
    turn = 2.0 * np.arcsin(np.minimum(np.linalg.norm(axis, axis=1), 1.0))
    joints = np.abs(q[:, 7:] - exact[:, 7:]).max(initial=0.0)
    return float(max(turn.max(), joints)), float(np.linalg.norm(q[:, :3] - exact[:, :3], axis=1).max())


def _row(problem: Problem, integrator: str, setting: float, exact: np.ndarray, own_error: float, repeats: int) -> Row:
    run = problem.run(integrator, setting)
    times: list[float] = []
    calls: list[float] = []
    while not times or (len(calls) < repeats and sum(times) + sum(calls) < 1e3 * ENOUGH / problem.duration):
        times += [run.once() for _ in range(3)]  # the first after a call of `simulate` finds cold caches
        calls.append(run.call())
    result = run.trajectory
    failed = result.status in ("diverged", "fell", "step too small", "too costly")
    errors = deviation(problem.model, positions(result), exact)
    if failed:
        errors = (math.inf, math.inf + errors[1])
    adaptive = INTEGRATORS[integrator].adaptive
    evaluations = result.info.get("evaluations", run.ready.plan.steps * INTEGRATORS[integrator].stages)
    step, rtol = (math.nan, setting) if adaptive else (setting, math.nan)
    return Row(problem.name, integrator, step, rtol, *errors, own_error, min(times), min(calls), evaluations,
               result.status)  # fmt: skip


# ---------------------------------------------------------------------------------------------- problems


def problems() -> list[Problem]:
    """All problems, in the order of the table."""
    return [
        free_arm(),
        stiff_arm("standard"),
        stiff_arm("rotor"),
        geared_arm(),
        flying(),
        *humanoids(),
        rolling_ball(),
        free_box("simple"),
        free_box("complex"),
        pendulum(),
        governor(),
    ]


def unlimited(model: Model) -> Model:
    """Without stops."""
    free: dict[str, Any] = {"type": "continuous", "lower": -math.inf, "upper": math.inf}
    moving = model.joint_names
    return replace(model, joints=tuple(replace(j, **free) if j.name in moving else j for j in model.joints))


SMOOTH: dict[str, Any] = {"best": "dop853", "check": "extrapolation"}
ALL = {"implicit_euler": 2e-5, "midpoint": 2e-5, "rk4": 2e-5, "dop853": 1e-13, "extrapolation": 1e-13, "ars343": 1e-6}


def free_arm() -> Problem:
    """Seven links let go at 0.5 rad a joint: chaotic, not stiff."""
    model = unlimited(load_robot("arm7_spatial"))
    return Problem("arm, free", model, {}, 1.0, _at(0.5), ALL, **SMOOTH)


def stiff_arm(servos: str) -> Problem:
    """The arm let go at 0.05 rad, on stiff continuous servos; those without rotor inertia are the stiff ones."""
    arm = unlimited(load_robot("arm7_spatial"))
    servo = load_servo("ax12", **STIFF_SERVO, viscous_friction=0.0, coulomb_friction=0.0)
    model = replace(arm, servos=dict.fromkeys(arm.joint_names, servo))
    name = "arm, stiff servos" if servos == "standard" else "arm, servos with rotors"
    still = Reference([0.0], np.zeros((1, 7)))
    return Problem(name, model, {"gearbox": servos}, 0.5, _at(0.05), ALL, still, check="dop853", coarsest=0.1)


def geared_arm() -> Problem:
    """The planar arm of Lima et al. 2013 with the whole chain: sampled control, motor, spring-damper gearbox."""
    how = {"implicit_euler": 2e-5, "midpoint": 2e-5, "simtwo": 2e-5, "extrapolation": 1e-11, "ars343": 1e-6}
    still = Reference([0.0], np.zeros((1, 7)))
    return Problem("arm, geared servos", load_robot("arm7"), {"gearbox": "mipsd"}, 0.5, _at(0.01), how, still,
                   finest=1e-12)  # fmt: skip


def flying() -> Problem:
    """The humanoid tumbles freely, all joints limp."""
    model = unlimited(replace(load_robot("humanoid", locked="simplified"), servos={}))
    rng = np.random.default_rng(0)
    n = len(model.joint_names)
    q = np.concatenate([[0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0], 0.3 * rng.normal(size=n)])
    qd = 3.0 * rng.normal(size=n + 6)
    return Problem("humanoid, flying", model, {}, 0.5, lambda s: initial_state(s, q, qd), ALL, **SMOOTH)


def humanoids() -> list[Problem]:
    """The humanoid on its soles, with the whole servo chain: it stands for half a second, and it walks a stride."""
    from ..optimize.planning import walking_cost

    cost = walking_cost(load_robot("humanoid", locked="simplified"))
    how = {"implicit_euler": 2e-5, "midpoint": 2e-5, "simtwo": 2e-5, "extrapolation": 1e-8, "ars343": 1e-4}
    common: dict[str, Any] = {"integrators": how, "record_interval": 0.01, "finest": 1e-9}
    scene = {"gearbox": "mipsd", "ground": Ground()}
    signal = cost.reference(cost.gait.to_vector(), cost.warm_up + 1)
    posture = signal.values[0]
    still = Reference([0.0], posture[None])
    state = standing_state(cost.scene, posture)
    start = simulate(cost.scene, cost.mark, state, signal, record_interval=cost.mark, estimate_error=False)
    stride = Reference(signal.times - cost.mark, signal.values, "linear")
    begin = reset_time(cost.scene, start.final)
    stands = Problem("humanoid, standing", cost.scene.model, scene, 0.5, lambda s: standing_state(s, posture),
                     reference=still, **common)  # fmt: skip
    walks = Problem("humanoid, walking a stride", cost.scene.model, scene, cost.gait.period, lambda _: begin,
                    reference=stride, **common)  # fmt: skip
    return [stands, walks]


def rolling_ball() -> Problem:
    """A ball of 0.1 m rolls over the waves of a height field of 5 cm cells for a second."""
    inertia = 0.4 * 0.1**2
    ball = Link("ball", 1.0, (0.0, 0.0, 0.0), (inertia, 0.0, 0.0, inertia, 0.0, inertia))
    model = Model("ball", (ball,), (), "floating", contacts=(ContactPoint("ball", (0.0, 0.0, 0.0), radius=0.1),))
    x = np.arange(-1.0, 1.0, 0.05)
    field = HeightField(0.02 * np.sin(4.0 * x[:, None]) * np.cos(3.0 * x[None, :]), (0.05, 0.05), (-1.0, -1.0))
    scene = {"ground": Ground(friction=5.0, field=field), "fall_height": -1e6, "fall_tilt": 3.2}
    how = {"implicit_euler": 2e-5, "midpoint": 2e-5, "rk4": 2e-5, "extrapolation": 1e-9, "ars343": 1e-6}
    return Problem("ball rolling over waves", model, scene, 1.0,
                   lambda s: initial_state(s, None, [0.3, 0.1, 0.0, -1.0, 3.0, 0.0]), how, record_interval=0.01,
                   finest=1e-10)  # fmt: skip


BOX = (1.0, 4.0, 9.0)  # edges [m]


def free_box(kind: str) -> Problem:
    """A uniform box in free flight for ten seconds."""
    x, y, z = BOX
    inertia = ((y * y + z * z) / 12, 0.0, 0.0, (x * x + z * z) / 12, 0.0, (x * x + y * y) / 12)
    model = Model("box", (Link("box", 1.0, (0.0, 0.0, 0.0), inertia),), (), "floating")
    simple = kind == "simple"
    gravity = (0.0, 0.0, 0.0) if simple else (0.0, 0.0, -9.8)
    velocity = [-0.9, 0.4, 0.1, 0.5, 0.0, 0.0] if simple else [-2.0, 2.0, 8.0, 0.1, 5.0, 0.1]

    def turning(t: np.ndarray) -> np.ndarray:
        """The simple box turns about its first axis and drifts."""
        zero = 0.0 * t
        return np.stack([-0.9 * t, 0.4 * t, 0.1 * t, np.cos(0.25 * t), np.sin(0.25 * t), zero, zero], axis=1)

    return Problem(f"free box, {kind}", model, {"gravity": gravity}, 10.0,
                   lambda s: initial_state(s, [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], velocity),
                   ALL | dict.fromkeys(("implicit_euler", "midpoint", "rk4"), 1e-4),
                   exact=turning if simple else None, coarsest=0.1, **SMOOTH)  # fmt: skip


def pendulum() -> Problem:
    """IFToMM A01: 1 kg at 1 m, let go horizontally; sin(q / 2) = k sn(K - w t), k = sin(45 deg), of elliptic sn."""
    from scipy.special import ellipj, ellipk

    base = Link("base", 0.0, (0.0, 0.0, 0.0), (0.0,) * 6)
    bob = Link("bob", 1.0, (0.0, 0.0, -1.0), POINT)
    model = Model("pendulum", (base, bob), (Joint("hinge", "continuous", "base", "bob", axis=(0.0, 1.0, 0.0)),))
    w, k = math.sqrt(9.81 / (1.0 + POINT[3])), math.sqrt(0.5)

    def swinging(t: np.ndarray) -> np.ndarray:
        return 2.0 * np.arcsin(k * ellipj(ellipk(k * k) - w * t, k * k)[0])[:, None]

    return Problem("IFToMM A01, pendulum", model, {}, 10.0, _at(0.5 * math.pi), ALL, record_interval=0.1,
                   exact=swinging)  # fmt: skip


POINT = (1e-9, 0.0, 0.0, 1e-9, 0.0, 1e-9)  # of a point mass, which the model does not know [kg m^2]


DENSITY, BALL = 3000.0, 5.0  # of the governor's bodies [kg/m^3], of each of its balls [kg]
ROD, CUBE = 1.0, 0.1  # length of shaft and rods, edge of the slider [m]
THICK = 0.01  # shaft and rods [m]
RISE, SPIN = math.radians(30.0), 2.0 * math.pi  # of the rods below the horizontal [rad], of the whole [rad/s]


def governor() -> Problem:
    """IFToMM A05: a Watt governor whose lower rods are springs with dampers; the slider's height and all angles count.

    The shaft turns freely about the vertical and carries the slider and two hinges, a rod on each with a ball at its
    end; from each rod's middle a spring-damper leads to the slider.  All turns at 1 Hz to begin with, the slider half
    way up; then slider and rods swing up and down once in 1.025 s, the slider between 0.5 and 0.744 m.  Given are
    sizes, masses, springs, the slider's place and 30 degrees: from the horizontal, as only there the springs have
    their rest length of 0.5 m.  Hinges and springs sit 0.05 m from the axis, as wide as the slider is, and the balls
    are points: what others have read off the figure.

    The eigenvalues of springs and masses at the start are -8117 and -20.0 1/s, and with the rods against each other
    -1450 and -20.3 1/s, beside a swing of 6.1 rad/s; Euler's step ends at 0.25 ms.  Error control of `dop853` holds at
    any tolerance, that of the extrapolation from 1e-4 on: of a looser one its short columns are unstable, unsaid.
    """
    bar, cube = DENSITY * ROD * THICK**2, DENSITY * CUBE**3
    long, thin = bar * (ROD**2 + THICK**2) / 12.0, bar * THICK**2 / 6.0
    mass = bar + BALL
    center = (0.5 * bar + BALL) * ROD / mass  # of a rod with its ball, from the hinge [m]
    swing = long + bar * (center - 0.5 * ROD) ** 2 + BALL * (ROD - center) ** 2
    links = (
        Link("ground", 0.0, (0.0, 0.0, 0.0), (0.0,) * 6),
        Link("shaft", bar, (0.0, 0.0, 0.5 * ROD), (long, 0.0, 0.0, long, 0.0, thin)),
        Link("slider", cube, (0.0, 0.0, 0.0), tuple(cube * CUBE**2 / 6.0 * x for x in (1, 0, 0, 1, 0, 1))),
        *(Link(name, mass, (0.0, 0.0, -center), (swing, 0.0, 0.0, swing, 0.0, thin)) for name in ("right", "left")),
    )
    up, half, tilt = (0.0, 0.0, 1.0), 0.5 * CUBE, 0.5 * math.pi - RISE
    joints = [
        Joint("shaft", "continuous", "ground", "shaft", axis=up),
        Joint("slider", "prismatic", "shaft", "slider", xyz=(0.0, 0.0, 0.5), axis=up),
    ]
    springs = []
    for name, side in (("right", 1.0), ("left", -1.0)):
        place, turn, axis = (side * half, 0.0, ROD), (0.0, -side * tilt, 0.0), (0.0, -side, 0.0)
        joints.append(Joint(name, "continuous", "shaft", name, place, turn, axis))
        ends = (side * half, 0.0, 0.0), (0.0, 0.0, -0.5 * ROD)
        springs.append(Spring("slider", name, *ends, stiffness=8e5, damping=4e4, length=0.5))
    model = Model("governor", links, tuple(joints))
    return Problem("IFToMM A05, flyball governor", model, {"springs": springs}, 10.0,
                   lambda s: initial_state(s, np.zeros(4), [SPIN, 0.0, 0.0, 0.0]), ALL, record_interval=0.1,
                   coarsest=5e-4, **SMOOTH)  # fmt: skip


def _at(angle: float) -> Callable[[CompiledScene], np.ndarray]:
    """At rest with this angle at all joints."""
    return lambda scene: initial_state(scene, np.full(scene.tree.n, angle))


# ---------------------------------------------------------------------------------------------- output


def print_table(rows: list[Row]) -> None:
    """One block for each problem."""
    for problem in dict.fromkeys(row.problem for row in rows):
        part = [row for row in rows if row.problem == problem]
        print(f"\n{problem}; the reference is exact to {part[0].reference_error:.1e} rad or m")
        print(f"{'integrator':15}{'step or rtol':>14}{'error':>11}{'error':>11}{'time':>11}{'simulate':>11}"
              f"{'evaluations':>13}")  # fmt: skip
        print(f"{'':29}{'[rad]':>11}{'[m]':>11}{'[ms/s]':>11}{'[ms/s]':>11}")
        for r in part:
            setting = f"{1e3 * r.step:g} ms" if math.isnan(r.rtol) else f"{r.rtol:.0e}"
            shift = "" if math.isnan(r.shift) else f"{r.shift:.1e}"
            status = "" if r.status == "ok" else f"  {r.status}"
            print(f"{r.integrator:15}{setting:>14}{r.angle:11.1e}{shift:>11}{r.time:11.4g}{r.call:11.4g}"
                  f"{r.evaluations:13}{status}")  # fmt: skip


def write(path: Path, rows: list[Row], notes: str) -> None:
    """The table as CSV, the notes as comments over it."""
    columns = ["problem", "integrator", "step_s", "rtol", "error_rad", "error_m", "reference_error", "run_ms_per_s",
               "simulate_ms_per_s", "evaluations", "status"]  # fmt: skip
    cells = (["" if isinstance(x, float) and math.isnan(x) else x for x in row] for row in rows)
    write_table(path, columns, cells, notes)


def read(path: Path) -> list[Row]:
    """The rows of a precision.csv.  Raises ValueError, naming file and line, for anything else."""
    return [_read_row(path, line, cells) for line, cells in list(read_csv(path, TABLE))[1:]]


def _read_row(path: Path, line: int, cells: list[str]) -> Row:
    try:
        problem, integrator, *numbers, evaluations, status = cells
        return Row._make([problem, integrator, *map(_read_number, numbers), int(_read_number(evaluations)), status])
    except (ValueError, TypeError, OverflowError) as error:
        what = f"is no row of this benchmark ({error})"
        raise ValueError(f"{path}, line {line}: {what}; run the benchmark again") from error


def _read_number(text: str) -> float:
    value = {"": math.nan, "nan": math.nan, "inf": math.inf}.get(text, number(text))
    if math.isnan(value) and text not in ("", "nan"):
        raise ValueError(f"{text[:40]!r} is no number")
    return value


COLOURS = {
    "implicit_euler": "C0",
    "midpoint": "C2",
    "rk4": "C1",
    "simtwo": "C3",
    "dop853": "C4",
    "extrapolation": "0.15",
    "ars343": "C5",
}


@look()
def plot(path: Path, rows: list[Row], notes: str = "") -> None:
    """A panel for each problem: time against error, of runs that are right to 1 rad or m; right and low is bad."""
    from matplotlib.figure import Figure

    names = list(dict.fromkeys(row.problem for row in rows))
    columns = min(4, len(names))
    lines = -(-len(names) // columns)
    figure = Figure(figsize=(max(3.3 * columns + 0.3, 8.0), 2.9 * lines + 0.9), layout="constrained")
    panels = figure.subplots(lines, columns, squeeze=False).ravel()
    for panel, name in zip(panels, names):
        _panel(panel, [row for row in rows if row.problem == name])
    for panel in panels[len(names) :]:
        panel.set_axis_off()
    for k in range(len(names)):
        panels[k].set_ylabel("CPU time [ms/s]" if k % columns == 0 else "")
    used = [name for name in COLOURS if any(row.integrator == name for row in rows)]
    handles = [_line(name) for name in used]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(used))
    figure.suptitle(
        "CPU milliseconds per simulated second against error; filled: error control, hollow: fixed steps\n" + notes,
        fontsize=9,
    )
    with complete(path) as temporary:
        figure.savefig(temporary, dpi=130)


def _style(name: str) -> dict:
    fill = COLOURS[name] if INTEGRATORS[name].adaptive else "white"
    return {"color": COLOURS[name], "marker": "o", "markersize": 4, "markerfacecolor": fill, "linewidth": 1.2}


def _line(name: str) -> Line2D:
    from matplotlib.lines import Line2D

    return Line2D([], [], label=name, **_style(name))


def _panel(panel: Axes, rows: list[Row]) -> None:
    from matplotlib.ticker import NullFormatter

    for name in COLOURS:
        line = [row for row in rows if row.integrator == name and 0.0 < row.error < 1.0]
        panel.loglog([row.error for row in line], [row.time for row in line], **_style(name))
    if rows[0].reference_error > 0.0:
        panel.axvspan(1e-20, rows[0].reference_error, color="0.9")
    shown = [row.error for row in rows if 0.0 < row.error < 1.0]
    panel.set_xlim(0.3 * min(shown), 3.0 * max(shown))
    panel.set_title(rows[0].problem, fontsize=10)
    panel.set_xlabel("error [rad]" if math.isnan(rows[0].shift) else "error [rad or m]", fontsize=9)
    panel.tick_params(labelsize=8)
    panel.yaxis.set_minor_formatter(NullFormatter())
