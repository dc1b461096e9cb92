"""Compare with Pinocchio, MuJoCo and SciPy: forward dynamics, trajectories at equal error, a humanoid's steps.

All engines read the same URDF, run in turn in one process on one core, and are compared by CPU time as ratios.

Forward dynamics: the rows of `benchmark speed`.  Pinocchio's package is compiled for any x86-64 processor; compiled for
this one it may be faster.

Trajectories: the three scenes of the arm and the closed loops in `benchmark precision`, errors at the end of the run,
from the same reference.  MuJoCo makes all steps in one call of `mj_step`, without contact and limits.  Its servo is a
position actuator (clamped torque), the same with the damping at the joint (not clamped), or a DC motor.  SciPy's
solvers call Pinocchio's `aba`, and `constraintDynamics` with Baumgarte's correction where loops are closed.  MuJoCo's
loops are soft; the squeezer is left out, for URDF does not know its spring.  The cost at an error is interpolated
between neighboring settings of one method on logarithmic scales, but not across a jump of more than a factor 1000,
where a step becomes stable.

Humanoid: it stands, and walks a stride of a planned walk, with ten joints.  MuJoCo has position servos of the same
stiffness, damping and reflected inertia, but no gearbox spring, current and energy meter.  The robots walk
differently, so each engine's error is counted from its own run at a sixteenth of the step.

    featherstone-gait benchmark peers        twelve minutes
"""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np

from ..base.progress import progress_bar
from ..core.compile.lanes import WIDTH
from ..core.integrate.rollout import rollout_lanes
from ..model import Model
from ..robot_file import load_robot
from ..run.reference import Reference
from ..run.simulate import simulate
from ..run.trajectory import positions
from ..scene.compile import compile_scene
from ..view.style import look, subplots
from . import engines, speed
from .case import Case, Run, case_of, deviation, solution
from .engines import bounded, disable, mujoco, pin, rolled
from .linkages import linkages
from .precision import COLORS, ENOUGH, measure
from .scenes import STIFF_SERVO, chain, free_arm, humanoids, stiff_arm
from .table import in_turn, installed, machine, save_figure, tabulate, write_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# From setting and start to the end and CPU time [s].
Solver = Callable[[float, np.ndarray, np.ndarray], tuple[np.ndarray, float]]
Method = tuple[Sequence[float], Solver]  # with the settings to try

KP, KD, LIMIT = (STIFF_SERVO[name] for name in ("Kp", "Kd", "torque_limit"))
ARMATURE = 254.0**2 * 1e-7  # reflected inertia of an AX-12's rotor [kg m^2]
LENGTHS = (7, 10, 20, 50, 100, 200)
REPEATS, REPEATS_FULL = 9, 31
STEPS = (0.1, 0.063, 0.05, 0.04, 0.02, *(m * 10.0**e for e in (-2, -3) for m in (1, 0.5, 0.25)), 2e-4, 1e-4, 5e-5, 2e-5,
         1e-5)  # fmt: skip
FINEST_OF_LOOPS = -4  # of 10 s, down to 0.2 ms
HARDEST = 0.9999  # of the impedances that MuJoCo takes
TOLERANCES = tuple(10.0**-k for k in range(3, 13))
ENGINES = {(speed.MUJOCO, "float64"): "MuJoCo mj_forward", (speed.PINOCCHIO, "float64"): "Pinocchio aba",
           ("ABA", "float64"): "float64", ("ABA", speed.LANES): "lanes"}  # fmt: skip
WHEEL = "of Pinocchio's wheel; its C++ built by clang -O3 -march=x86-64-v3 takes about half of that time"
FIXED = ("implicit_euler", "midpoint")
JUMP = 1e3  # of the error, from which on nothing is interpolated
MS = 1e-3  # [s]
SETTLED = 1e-2  # rms joint speed in the last second [rad/s]
FINER = 16  # a reference's step is the measured one by this
NOISE = 1e-3  # of the references, lane by lane [rad]


class Speed(NamedTuple):
    """Time of forward dynamics or of a step."""

    what: Annotated[str, "", "<27"]
    robot: Annotated[str, "robot", "<13"]
    joints: Annotated[int, "joints", "6"]
    engine: Annotated[str, "engine", "<26"]
    time: Annotated[float, "us", "9.3f"]  # of the processor [us]
    # Forward dynamics: by the greatest acceleration; humanoid: of joints and turn of the trunk.
    error: Annotated[float, "[rad]", "9.1e"]
    shift: Annotated[float, "[m]", "9.1e"] = math.nan  # of the trunk [m]


class Point(NamedTuple):
    """A trajectory with one setting of one method."""

    problem: str
    method: str
    setting: float  # step [s] or tolerance
    error: float  # at the end [rad]
    time: float  # CPU time per simulated second [ms]


class Line(NamedTuple):
    """A bound that is asked for, and the measured figure."""

    line: Annotated[str, "", "<65"]
    asked: Annotated[str, "asked", "<9"]
    measured: Annotated[str, "measured", "<9"]
    met: Annotated[bool, "met", "3"]
    note: Annotated[str, "", "<2"] = ""


def run(out_dir: Path, full: bool = False) -> list[Line]:
    """Print the tables; write peers.csv, peers_speed.csv, peers_lines.csv and peers.png into `out_dir`.

    Raises ValueError without MuJoCo or Pinocchio.
    """
    missing = [name for module, name in (("mujoco", "mujoco"), ("pinocchio", "pin")) if not installed(module)]
    if missing:
        raise ValueError(f'the benchmark peers needs {" and ".join(missing)}: pip install "featherstone-gait[peers]"')
    repeats, host = REPEATS_FULL if full else REPEATS, machine()
    print(host)
    robots = [load_robot("arm7_spatial"), load_robot("humanoid", locked={}), *map(chain, LENGTHS)]
    bar = progress_bar(robots, "forward dynamics")
    speeds = [row for model in bar for row in forward_dynamics(model, repeats)]
    with engines.quick_mujoco():
        speeds += [chain_step(links, repeats) for links in progress_bar(LENGTHS, "chains")]
        for problem in humanoids():
            speeds += [row for integrator in FIXED for row in _own_steps(problem, integrator, repeats)]
            speeds += _mujoco_steps(problem, repeats)
        tabulate(out_dir / "peers_speed.csv", Speed, speeds, host)
        points = []
        for problem in scenes():
            points += trajectories(problem, repeats)
            _print_costs(points, problem.name)
    write_table(out_dir / "peers.csv", Point._fields, points, host)
    _plot(out_dir / "peers.png", points, host)
    return tabulate(out_dir / "peers_lines.csv", Line, lines(speeds, points), host)


# ---------------------------------------------------------------------------------------------- steps


def forward_dynamics(model: Model, repeats: int) -> list[Speed]:
    """Compare the accelerations of one state by all engines."""
    n = len(model.joint_names)
    rows = [(ENGINES.get((row.algorithm, row.width)), row) for row in speed.time_robot(model, repeats)]
    return [Speed("forward dynamics", model.name, n, engine, row.time, row.error) for engine, row in rows if engine]


def _with_reference(case: Case, integrator: str) -> tuple[Run, tuple[float, float]]:
    """Run steps of 1 ms; return the run and its errors, counted from a sixteenth of the step."""
    run_, finer = case.ready(integrator, MS), case.ready(integrator, MS / FINER)
    finer.once()
    run_.once()
    return run_, deviation(case.model, positions(run_.trajectory), positions(finer.trajectory))


def chain_step(links: int, repeats: int) -> Speed:
    """Time a step of a hanging chain by the implicit midpoint rule."""
    scene = compile_scene(chain(links))
    case = case_of(f"chain{links}", "chains", scene, 0.2, [0.01] * links, None, record_interval=0.2)
    run_, (error, _) = _with_reference(case, "midpoint")
    least = min(run_.once() for _ in range(repeats))
    return Speed("step, midpoint 1 ms", case.name, links, "float64", least, error)


def _own_steps(problem: Case, integrator: str, repeats: int) -> list[Speed]:
    """Time steps of the humanoid, alone and in eight lanes."""
    run_, errors = _with_reference(problem, integrator)
    times = in_turn([run_.once, _lane_run(problem, run_)], repeats).min(axis=0)
    microseconds = 1e6 * times / (run_.ready.plan.steps * np.array([1, WIDTH]))
    return [
        Speed(problem.name, "humanoid", len(problem.model.joint_names), f"{integrator}, {width}", float(time_), *errors)
        for width, time_ in zip(("float64", "lanes"), microseconds)
    ]


def _lane_run(problem: Case, run_: Run) -> Callable[[], None]:
    """Prepare the run in eight lanes, whose references differ by a little noise."""
    rng, signal = np.random.default_rng(0), problem.signal
    noisy = (signal.values + NOISE * rng.normal(size=signal.values.shape[1]) for _ in range(WIDTH))
    starts = [run_.start._replace(reference=Reference(signal.times, values).knots()) for values in noisy]
    in_lanes, y, out = run_.ready.arguments_in_lanes(starts)

    def call() -> None:
        y[:] = run_.start.y[:, None]
        rollout_lanes(in_lanes, y, out)

    call()
    return call


def _mujoco_steps(problem: Case, repeats: int) -> list[Speed]:
    """Time steps of MuJoCo's humanoid, its servos' targets renewed every 10 ms as ours are."""
    m, steps, rows = engines.humanoid_of(problem.model), round(problem.duration / MS), []
    for name, integrator in integrators("Euler", "implicitfast", "discrete"):
        m.opt.integrator = integrator
        start = _mujoco_start(m, problem)
        finer, path = (_mujoco_path(m, problem, start, h)[0] for h in (MS / FINER, MS))
        errors = deviation(problem.model, path, finer)
        least = min(_mujoco_path(m, problem, start, MS)[1] for _ in range(repeats))
        rows.append(Speed(problem.name, "humanoid", m.nu, f"MuJoCo {name}", 1e6 * least / steps, *errors))
    return rows


def integrators(*names: str) -> list[tuple[str, Any]]:
    """Return MuJoCo's integrators of these names; older versions lack some."""
    kinds = ((name, getattr(mujoco.mjtIntegrator, f"mjINT_{name.upper()}", None)) for name in names)
    return [(name, kind) for name, kind in kinds if kind is not None]


def _mujoco_start(m: Any, problem: Case) -> np.ndarray:
    """Return the state where the measured part begins: standing, or after walking there."""
    signal = problem.signal
    state = engines.standing_on(m, mujoco.MjData(m), signal.values[0])
    if signal.times[0] < 0.0:
        earlier = Reference(signal.times - signal.times[0], signal.values)
        state = _mujoco_path(m, problem._replace(duration=-signal.times[0], reference=earlier), state, MS)[2]
    state[0] = 0.0
    return state


def _mujoco_path(m: Any, problem: Case, state: np.ndarray, h: float) -> tuple[np.ndarray, float, np.ndarray]:
    """Return positions every 10 ms, CPU time [s] and the state at the end."""
    kind, d, m.opt.timestep = mujoco.mjtState.mjSTATE_FULLPHYSICS, mujoco.MjData(m), h
    mujoco.mj_setState(m, d, state, kind)
    ticks, end, signal = round(problem.duration / 0.01), np.zeros(len(state)), problem.signal
    control = [np.interp(0.01 * np.arange(ticks), signal.times, column) for column in signal.values.T]
    path, spent = rolled(m, d, round(0.01 / h), ticks, np.stack(control, axis=1))
    mujoco.mj_getState(m, d, end, kind)
    return path, spent, end


# ---------------------------------------------------------------------------------------------- trajectories


def scenes() -> list[Case]:
    """Return the arm alone, and with stiff servos without and with rotors; and closed loops without springs."""
    closed = (case for case in linkages() if not case.scene.springs)
    return [free_arm(), stiff_arm("standard"), stiff_arm("rotor"), *closed]


def trajectories(problem: Case, repeats: int) -> list[Point]:
    """Measure error and time of all methods at all their settings."""
    exact = solution(problem)[0][-1]
    points = [
        Point(problem.name, row.integrator, row.step if math.isnan(row.rtol) else row.rtol, row.angle, row.time)
        for row in measure(problem, repeats)
    ]
    q0, qd0 = problem.coordinates
    methods = {**mujoco_methods(problem), **scipy_methods(problem)}
    for name, (settings, solve) in progress_bar(methods.items(), desc=f"peers: {problem.name}", leave=False):
        for setting in settings:
            try:
                q, least = _timed(functools.partial(solve, setting, q0, qd0), repeats)
            except ArithmeticError:
                continue  # it failed: there is no result to compare
            error = float(np.abs(q - exact).max())
            points.append(Point(problem.name, name, setting, error, least / problem.duration))
    return points


def _timed(solve: Callable[[], tuple[np.ndarray, float]], repeats: int) -> tuple[np.ndarray, float]:
    """Return positions at the end, and the least CPU time of some runs [ms]."""
    q, spent = solve()
    times = [spent]
    while len(times) < repeats and sum(times) < ENOUGH:
        times.append(solve()[1])
    if not np.isfinite(q).all():
        raise ArithmeticError
    return q, 1e3 * min(times)


def mujoco_methods(problem: Case) -> dict[str, Method]:
    """Return MuJoCo's integrators, with each way to express the servo."""
    methods: dict[str, Method] = {}
    for servo in ("free",) if problem.reference is None else ("position", "joint damping", "dcmotor"):
        m = _mujoco_arm(problem, servo)
        for name, integrator in integrators("Euler", "implicitfast", "implicit", "RK4", "discrete"):
            if servo != "joint damping" or name == "Euler":
                label = f"MuJoCo {name}" + ("" if servo == "free" else f", {servo}")
                steps = STEPS[: FINEST_OF_LOOPS if problem.model.loops else None]
                methods[label] = (steps, _mujoco_solver(m, integrator, problem))
    return methods


def _mujoco_arm(problem: Case, servo: str) -> Any:
    """Build the arm for MuJoCo with a servo at each joint; "joint damping" clamps the spring alone."""
    if problem.model.loops:
        m = engines.model_of(problem.scene)
        m.eq_solimp[:, :2] = HARDEST  # as rigid as it goes
        return m
    model = bounded(replace(problem.model, servos={}))
    spec, position = engines.spec_of(model), int(mujoco.mjtCtrlInput.mjINPUT_POS)
    for name in model.joint_names if servo != "free" else ():
        joint = spec.joint(name)
        joint.armature = ARMATURE if problem.scene.gearbox == "rotor" else 0.0
        actuator = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        if servo == "dcmotor":
            law = {"motorconst": [math.sqrt(8.0 * KD), 0.0], "controller": [KP, 0.0, KD, 0.0, 0.0, 0.0]}
            actuator.set_to_dcmotor(resistance=8.0, ctrlspec=position, **law)
        elif servo == "position":
            actuator.set_to_position(kp=KP, kv=KD)
        else:
            joint.damping[0] = KD
            actuator.set_to_position(kp=KP)
        actuator.forcelimited, actuator.forcerange = True, [-LIMIT, LIMIT]
    return disable(spec.compile(), "CONTACT", "CONSTRAINT")


def _mujoco_solver(m: Any, integrator: Any, problem: Case) -> Solver:
    d, duration = mujoco.MjData(m), problem.duration
    places = [m.joint(name).qposadr[0] for name in problem.model.joint_names]

    def solve(h: float, q0: np.ndarray, qd0: np.ndarray) -> tuple[np.ndarray, float]:
        mujoco.mj_resetData(m, d)
        steps = max(1, round(duration / h))
        m.opt.integrator, m.opt.timestep = integrator, duration / steps
        d.qpos[places], d.qvel[places] = q0, qd0
        m.eq_solref[:, 0] = 2.0 * m.opt.timestep  # the least that its manual allows
        path, spent = rolled(m, d, steps, 1)
        if d.warning.number.any():
            raise ArithmeticError
        return path[-1, places], spent

    return solve


def scipy_methods(problem: Case) -> dict[str, Method]:
    """Return SciPy's solvers, which call Pinocchio."""
    from scipy.integrate import solve_ivp

    model = bounded(replace(problem.model, servos={}))
    m = engines.in_pinocchio(replace(model, loops=()))
    n, places = m.nv, [m.joints[m.getJointId(name)].idx_q for name in model.joint_names]
    driven, loops = problem.reference is not None, engines.loops_in_pinocchio(m, model)
    if problem.scene.gearbox == "rotor":
        m.armature[:] = ARMATURE
    m.gravity.linear = np.array(problem.scene.gravity)
    d, zero = m.createData(), np.zeros(n)
    if loops:
        held = pin.StdVec_RigidConstraintData()
        held.extend([loop.createData() for loop in loops])
        pin.initConstraintDynamics(m, d, loops, held)
        proximal = pin.ProximalSettings(1e-12, 1e-8, 10)  # of rows that depend on each other

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        q, v = y[:n], y[n:]
        if loops:
            return np.concatenate([v, pin.constraintDynamics(m, d, q, v, zero, loops, held, proximal)])
        tau = np.clip(-KP * q - KD * v, -LIMIT, LIMIT) if driven else zero
        return np.concatenate([v, pin.aba(m, d, q, v, tau)])

    def solve(method: str, rtol: float, q0: np.ndarray, qd0: np.ndarray) -> tuple[np.ndarray, float]:
        y0 = np.zeros(2 * n)
        y0[places], y0[np.add(places, n)] = q0, qd0
        start = time.thread_time()
        answer = solve_ivp(rates, (0.0, problem.duration), y0, method, rtol=rtol, atol=rtol)
        spent = time.thread_time() - start
        if not answer.success:
            raise ArithmeticError
        return answer.y[places, -1], spent

    names: tuple[str, ...] = ("Radau", "LSODA") if problem.scene.gearbox == "standard" else ("Radau", "DOP853", "LSODA")
    names = ("DOP853",) if loops else names  # Radau's Jacobian by differences takes minutes there
    tolerances = {"Radau": TOLERANCES[:8], "DOP853": TOLERANCES[: 7 if loops else None]}
    return {f"SciPy {name}": (tolerances.get(name, TOLERANCES), functools.partial(solve, name)) for name in names}


def cost_at(error: float, points: list[Point]) -> float:
    """Return the CPU time per simulated second [ms] at which one method first has this error; infinite if never."""
    line = sorted(points, key=lambda p: p.setting, reverse=True)
    costs = [p.time for p in line if p.error <= error]
    for a, b in pairwise(line):
        if b.error <= error < a.error < JUMP * b.error:
            share = math.log(a.error / error) / math.log(a.error / b.error)
            costs.append(a.time * (b.time / a.time) ** share)
    return min(costs, default=math.inf)


def cheapest(error: float, points: list[Point], problem: str, which: Callable[[str], bool]) -> tuple[float, str]:
    """Return the least such cost of some methods, and the method."""
    methods = dict.fromkeys(p.method for p in points if p.problem == problem and which(p.method))
    costs = {name: cost_at(error, [p for p in points if (p.problem, p.method) == (problem, name)]) for name in methods}
    name = min(costs, key=costs.__getitem__)
    return costs[name], name if math.isfinite(costs[name]) else "none"


def is_peer(method: str) -> bool:
    return method.startswith(("MuJoCo", "SciPy"))


# ---------------------------------------------------------------------------------------------- lines


def lines(speeds: list[Speed], points: list[Point]) -> list[Line]:
    """Compare what is asked with what was measured."""
    free, stiff, rotor, *closed = (problem.name for problem in scenes())
    steps = [p for p in points if p.problem == stiff and p.setting == 1e-2 and p.method in FIXED]
    best = min(steps, key=lambda p: p.error)
    both = ", ".join(f"{p.method} {p.error:.1e}" for p in steps)
    limit, integrator = max((_clipped_limit(integrator), integrator) for integrator in FIXED)
    rk4 = "MuJoCo RK4"
    found = [
        _times(points, stiff, 1e-6, 20.0),
        _times(points, stiff, 1e-4, 10.0),
        Line("stiff arm: error at 10 ms", "< 1e-3", f"{best.error:.1e}", best.error < 1e-3, both),
        Line("stiff arm from 0.5 rad, clipped: stable up to", ">= 50 ms", f"{1e3 * limit:g} ms", limit >= 0.05,
             integrator),
        _times(points, free, 1e-6, 16.0, rk4),
        _times(points, free, 1e-8, 20.0, rk4),
        _times(points, rotor, 1e-6, 1.5, rk4),
        *(_times(points, name, error, 1.0) for name in closed for error in (1e-3, 1e-6)),
    ]  # fmt: skip
    for what in dict.fromkeys(row.what for row in speeds if row.robot == "humanoid" and "humanoid" in row.what):
        found += _humanoid_lines([row for row in speeds if row.what == what])
    return found + _chain_lines(speeds)


def _clipped_limit(integrator: str) -> float:
    """Return the largest step [s] up to which the stiff arm settles from 0.5 rad."""
    case, good = stiff_arm("standard", 0.5), 0.0
    for h in (1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2, 0.1):
        found = simulate(case.by(integrator, h), 4.0, case.state, case.reference, estimate_error=False)
        last = found["qd"][-len(found["qd"]) // 4 :]
        if np.sqrt((last**2).mean()) > SETTLED or found.status == "diverged":
            break
        good = h
    return good


def _times(points: list[Point], problem: str, error: float, asked: float, peers: str = "") -> Line:
    """Compare the time at this error with that of the peers whose names begin so."""
    ours, method = cheapest(error, points, problem, lambda m: not is_peer(m))
    theirs, peer = cheapest(error, points, problem, lambda m: is_peer(m) and m.startswith(peers))
    note = f"{method} {ours:.3g} ms/s, {peer} {theirs:.3g} ms/s"
    line, ratio = f"{problem}: less CPU time at error {error:.0e}", theirs / ours
    return Line(line, f">= {asked:g} x", f"{ratio:.3g} x", ratio >= asked, note)


def _humanoid_lines(rows: list[Speed]) -> list[Line]:
    """Compare with the fastest of MuJoCo's integrators that keep the robot upright."""
    peers = [row for row in rows if row.engine.startswith("MuJoCo") and row.error < 0.5]
    peer = min(peers, key=lambda row: row.time)
    found = []
    for width, asked in (("float64", 2.0), ("lanes", 10.0)):
        own = next(row for row in rows if row.engine == f"midpoint, {width}")
        ratio = peer.time / own.time
        exact = own.error <= peer.error and own.shift <= peer.shift
        note = (
            f"{own.time:.3g} us, {own.error:.1e} rad, {own.shift:.1e} m; {peer.engine} {peer.time:.3g} us, "
            f"{peer.error:.1e} rad, {peer.shift:.1e} m"
        )
        line = f"{own.what}: step {width}, faster at no larger error"
        found.append(Line(line, f">= {asked:g} x", f"{ratio:.3g} x", ratio >= asked and exact, note))
    return found


def _chain_lines(speeds: list[Speed]) -> list[Line]:
    """Compare forward dynamics of chains with Pinocchio's, and fit how the time of a step grows with the links."""
    dynamics = {(r.robot, r.engine): r.time for r in speeds if r.what == "forward dynamics"}
    chains = dict.fromkeys(robot for robot, _ in dynamics if robot.startswith("chain"))
    found = []
    for width, asked in (("float64", 0.55), ("lanes", 0.11)):
        ratios = {robot: dynamics[robot, width] / dynamics[robot, "Pinocchio aba"] for robot in chains}
        note = ", ".join(f"{robot[5:]} links {ratio:.2f}" for robot, ratio in ratios.items()) + f"; {WHEEL}"
        worst = max(ratios.values())
        found.append(Line(f"ABA, {width}, by Pinocchio's, worst of all chains", f"<= {asked:g}", f"{worst:.3g}",
                          worst <= asked, note))  # fmt: skip
    steps = [row for row in speeds if row.what.startswith("step")]
    slope = np.polyfit(np.log([row.joints for row in steps]), np.log([row.time for row in steps]), 1)[0]
    note = ", ".join(f"{row.joints} links {row.time:.3g} us" for row in steps)
    return [*found, Line("time of a step by links^x", "x <= 1.05", f"{slope:.3f}", slope <= 1.05, note)]


# ---------------------------------------------------------------------------------------------- output


def _print_costs(points: list[Point], problem: str) -> None:
    errors = (1e-2, 1e-4, 1e-6, 1e-8)
    print(f"\n{problem}\nCPU time per simulated second [ms] at error" + "".join(f"{e:>10.0e}" for e in errors))
    part = [p for p in points if p.problem == problem]
    for method in dict.fromkeys(p.method for p in part):
        costs = [cost_at(e, [p for p in part if p.method == method]) for e in errors]
        print(f"  {method:41}" + "".join(f"{c:10.3g}" if math.isfinite(c) else f"{'-':>10}" for c in costs))


@look()
def _plot(path: Path, points: list[Point], notes: str) -> None:
    """Draw a panel for each of the scenes."""
    problems = list(dict.fromkeys(p.problem for p in points))
    figure, panels = subplots(18.0, 9.0, 2, 3)
    for panel in panels.flat[len(problems) :]:
        panel.set_axis_off()
    for panel, problem in zip(panels.flat, problems):
        _scene_panel(panel, [p for p in points if p.problem == problem])
    figure.suptitle(notes, fontsize=8)
    save_figure(figure, path)


GREYS = {"MuJoCo Euler": "tab:brown", "MuJoCo implicitfast": "tab:pink", "MuJoCo implicit": "tab:cyan",
         "MuJoCo RK4": "tab:gray", "MuJoCo discrete": "tab:olive",
         "SciPy Radau": "gold", "SciPy DOP853": "navy", "SciPy LSODA": "lime"}  # fmt: skip
DASHES = {"": "-", ", position": "-", ", joint damping": "--", ", dcmotor": ":"}


def _scene_panel(panel: Axes, points: list[Point]) -> None:
    """Draw time against error; circles are this package's integrators, crosses other engines."""
    for method in dict.fromkeys(p.method for p in points):
        line = [p for p in points if p.method == method and 1e-14 < p.error < 1.0]
        name, comma, servo = method.partition(",")
        peer = is_peer(method)
        panel.loglog(
            [p.error for p in line], [p.time for p in line], DASHES[comma + servo], label=method,
            color=GREYS[name] if peer else COLORS[name], marker="x" if peer else "o", markersize=4,
            linewidth=1.0 if peer else 2.0,
        )  # fmt: skip
    panel.set(title=points[0].problem, xlabel="error at the end [rad]", ylabel="CPU time per simulated second [ms]")
    panel.legend(fontsize=6.5, loc="center left", bbox_to_anchor=(1.0, 0.5))
