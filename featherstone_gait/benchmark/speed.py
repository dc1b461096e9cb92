"""Time forward and inverse dynamics and the mass matrix beside their error, next to MuJoCo and Pinocchio.

ABA, RNEA and CRBA run inside compiled loops, on one state in float64 and on eight in lanes (per robot: an eighth of the
time of a pass).  Where they are installed, MuJoCo's `mj_forward` and Pinocchio's `aba` get the same URDF and state,
without contact, limits and friction, through a Python loop.  A call of `mj_forward` from Python costs some 0.1 us,
which is not subtracted; that of `aba` is measured on a robot of no joints and subtracted.  The clock of MuJoCo's Python
package, which would cost another 0.6 us a call, is switched off.  All are timed in turn in one process, and
medians of CPU time are compared.  Chains are those of the arm `arm7_spatial`, prolonged.

A second table holds whole steps: scenes of `precision` by the midpoint rule at 1 ms, one run in float64, eight to a
vector, and as many vectors as there are cores, each beside the error of that step.

    featherstone-gait benchmark speed        three minutes
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import numpy as np

from ..core.compile.lanes import WIDTH, aligned
from ..core.tree.layout import Motion, Robot
from ..dynamics import inverse_dynamics, mass_matrix
from ..dynamics.tree import GRAVITY, compile_tree
from ..model import Model
from ..robot_file import load_robot
from ..run.simulate import simulate_batch
from ..run.trajectory import positions
from ..view.style import look, subplots
from . import repeated
from .case import Run, deviation, solution
from .engines import bounded, check_order, disable, in_pinocchio, mujoco, pin, quick_mujoco, spec_of
from .scenes import chain, problems
from .table import in_turn, installed, machine, print_table, save_figure, spread, tabulate, write_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes


LENGTHS = (5, 10, 20, 50, 100, 200)
REPEATS, REPEATS_FULL = 15, 51
SCALARS, LANES = "float64", f"{WIDTH} lanes"
MUJOCO, PINOCCHIO = "mj_forward", "Pinocchio aba"
COLUMNS = ("robot", "joints", "algorithm", "width", "time_us", "spread", "error", "ratio_to_mj_forward")


class Row(NamedTuple):
    """One line of the table."""

    robot: Annotated[str, "robot", "<13"]
    joints: Annotated[int, "joints", "6"]
    algorithm: Annotated[str, "algorithm", "<10"]
    width: Annotated[str, "width", "<8"]
    time: Annotated[float, "us", "9.3f"]  # median of one call for one robot [us]
    spread: Annotated[float, "spread", "7.0%"]  # from the first to the third quartile, relative to the median
    error: Annotated[float, "error", "9.1e"]  # greatest difference from the reference by its greatest value
    ratio: Annotated[float, "ratio", "7.3f"]  # time by that of mj_forward, NaN without MuJoCo


class Step(NamedTuple):
    """One line of the table of steps."""

    scene: Annotated[str, "midpoint, 1 ms", "<26"]
    scalar: Annotated[float, "float64 us", "10.3f"]  # one step in float64 [us]
    lanes: Annotated[float, "lanes us", "9.3f"]  # eight to a vector, one thread, a robot, with the batch's set-up [us]
    scaling: Annotated[float, "all cores", "10.2f"]  # steps per second on all cores by those on one
    error: Annotated[float, "error", "9.1e"]  # at the end of the run [rad or m]
    reference_error: Annotated[float, "reference", "9.1e"]  # of what the error is counted from


class Question(NamedTuple):
    """Hold a state; asked are accelerations under tau, forces for qdd, and the mass matrix."""

    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    tau: np.ndarray


class Answer(NamedTuple):
    """Hold the reference results."""

    qdd: np.ndarray
    tau: np.ndarray
    H: np.ndarray


class Timer(NamedTuple):
    """Hold a call to be timed."""

    algorithm: str
    width: str
    call: Callable[[], object]
    count: int  # type: ignore[assignment]  # evaluations in a call; hides the method of tuples
    error: float


def run(out_dir: Path, full: bool = False) -> list[Row]:
    """Time everything, print the tables, write speed.csv, speed_steps.csv and speed.png; `full` repeats more."""
    host, repeats = machine(), REPEATS_FULL if full else REPEATS
    print(host)
    models = (load_robot("humanoid", locked={}), load_robot("arm7_spatial"), *map(chain, LENGTHS))
    rows = print_table(Row, (row for model in models for row in time_robot(model, repeats)))
    print()
    tabulate(out_dir / "speed_steps.csv", Step, _steps(repeats), host)
    write_table(out_dir / "speed.csv", COLUMNS, rows, host)
    _plot(rows, host, out_dir / "speed.png")
    return rows


def time_robot(model: Model, repeats: int) -> list[Row]:
    """Time all algorithms of all engines in turn."""
    question = _question(model)
    has_mujoco = installed("mujoco")
    timers, answer = _mujoco(model, question) if has_mujoco else ([], _own_answer(model, question))
    pinocchio = _pinocchio(model, question, answer.qdd) if installed("pinocchio") else []
    timers += [*_own_timers(model, question, answer), *pinocchio]
    with quick_mujoco() if has_mujoco else nullcontext():
        times = in_turn([timer.call for timer in timers], repeats).T
    times *= 1e6 / np.array([[timer.count] for timer in timers])
    if pinocchio:  # the call from Python is no part of the algorithm
        times[-2] -= times[-1]
        timers, times = timers[:-1], times[:-1]
    medians, spreads = spread(times)
    robot, unit = (model.name, len(model.joint_names)), medians[0] if has_mujoco else np.nan
    return [Row(*robot, t.algorithm, t.width, a, b, t.error, a / unit) for t, a, b in zip(timers, medians, spreads)]


def _question(model: Model) -> Question:
    """Draw a state within half a radian of zero, with speeds of 1 rad/s and forces of 0.1 N m."""
    rng = np.random.default_rng(0)
    n, nv = len(model.joint_names), model.nv
    q = rng.normal(size=n) * 0.5
    if model.base == "floating":
        q = np.concatenate([[0.1, 0.2, 0.3, 0.9, 0.1, 0.3, -0.2], q])
    qd, qdd, tau = rng.normal(size=(3, nv))
    if model.base == "floating":
        q[3:7] /= np.linalg.norm(q[3:7])
    return Question(q, qd, qdd, 0.1 * tau)


def _own_answer(model: Model, x: Question) -> Answer:
    """Compute each result by the other algorithms."""
    H = inverse_dynamics(model, x.q, 0 * x.qd, np.eye(model.nv), gravity=(0.0, 0.0, 0.0)).T
    bias = inverse_dynamics(model, x.q, x.qd, 0 * x.qdd)
    return Answer(np.linalg.solve(mass_matrix(model, x.q), x.tau - bias), mass_matrix(model, x.q) @ x.qdd + bias, H)


def _mujoco(model: Model, x: Question) -> tuple[list[Timer], Answer]:
    """Prepare `mj_forward` on the same URDF; return it with MuJoCo's results."""
    m = disable(check_order(spec_of(model).compile(), model), "CONTACT", "CONSTRAINT", "DAMPER")
    d = mujoco.MjData(m)
    d.qpos[:], d.qvel[:], d.qacc[:] = x.q, x.qd, x.qdd  # depth first, which is the order of these robots' files
    mujoco.mj_inverse(m, d)
    tau = d.qfrc_inverse.copy()
    d.qfrc_applied[:] = x.tau
    mujoco.mj_forward(m, d)
    H = np.zeros((m.nv, m.nv))
    mujoco.mj_fullM(m, d, H)
    count, call = _passes(model), lambda: mujoco.mj_forward(m, d)
    return [Timer(MUJOCO, SCALARS, _loop(call, count), count, 0.0)], Answer(d.qacc.copy(), tau, H)


def _pinocchio(model: Model, x: Question, exact: np.ndarray) -> list[Timer]:
    """Prepare `aba`, whose error is that of the joints' accelerations, and the call with a robot of no joints."""
    m, none = in_pinocchio(bounded(model)), pin.Model()
    d, empty, zero = m.createData(), none.createData(), np.zeros(0)
    n = len(model.joint_names)
    ids = [m.joints[m.getJointId(name)] for name in model.joint_names]
    q, v, tau = np.zeros(m.nq), np.zeros(m.nv), np.zeros(m.nv)
    if model.base == "floating":  # quaternion x y z w; velocities in the base's own axes
        turn = pin.Quaternion(*x.q[3:7]).matrix()
        q[:3], q[3:7] = x.q[:3], x.q[[4, 5, 6, 3]]
        v[:3], v[3:6], tau[:3], tau[3:6] = turn.T @ x.qd[:3], x.qd[3:6], turn.T @ x.tau[:3], x.tau[3:6]
    at = [joint.idx_v for joint in ids]
    q[[joint.idx_q for joint in ids]], v[at], tau[at] = x.q[-n:], x.qd[-n:], x.tau[-n:]
    error = np.abs(pin.aba(m, d, q, v, tau)[at] - exact[-n:]).max() / np.abs(exact).max()
    count = _passes(model)
    calls = (lambda: pin.aba(m, d, q, v, tau)), (lambda: pin.aba(none, empty, zero, zero, zero))
    return [Timer(PINOCCHIO, SCALARS, _loop(call, count), count, float(error)) for call in calls]


def _loop(call: Callable[[], object], count: int) -> Callable[[], None]:
    def loop() -> None:
        for _ in range(count):
            call()

    return loop


def _own_timers(model: Model, x: Question, answer: Answer) -> list[Timer]:
    forward, inverse, still = (x.q, x.qd, x.tau), (x.q, x.qd, x.qdd), (x.q, 0.0 * x.qd, x.qdd)
    return [
        _timer("ABA", SCALARS, repeated.repeat_aba_rows, model, forward, answer.qdd),
        _timer("ABA", LANES, repeated.repeat_aba_lanes, model, forward, answer.qdd),
        _timer("RNEA", SCALARS, repeated.repeat_rnea_rows, model, inverse, answer.tau),
        _timer("RNEA", LANES, repeated.repeat_rnea_lanes, model, inverse, answer.tau),
        _timer("CRBA", SCALARS, repeated.repeat_crba_rows, model, still, answer.H),
    ]


def _timer(
    algorithm: str, width: str, kernel: Callable, model: Model, inputs: Sequence[np.ndarray], exact: np.ndarray
) -> Timer:
    """Prepare a kernel on one state, or on the same one in every lane."""
    tree = compile_tree(model)
    lanes = (WIDTH,) if width == LANES else ()
    bases = [_filled(a[: -tree.n], lanes) if tree.floating else None for a in inputs]
    joints = [_filled(a[-tree.n :], lanes) for a in inputs]
    work = aligned((1, *tree.workspace_shape(), *lanes))
    base = aligned((1, 6, *lanes)) if tree.floating else None
    out = aligned((1, tree.n, *lanes))
    robot, moving = Robot(tree.bodies, None, np.array(GRAVITY)), Motion(*bases[:2], None, *joints[:2], None)
    arguments: tuple = (robot, moving, bases[2], joints[2], None, (work, None), base, out, None)
    if algorithm == "RNEA":
        arguments = (robot, Motion(*bases, *joints), None, work, base, out)
    elif algorithm == "CRBA":
        base, out = None, np.zeros((1, model.nv, model.nv))
        arguments = (robot._replace(gravity=np.zeros(3)), moving, work, out)
    kernel(1, *arguments)
    result = np.concatenate([a[0] for a in (base, out) if a is not None])
    error = _error(result[..., -1] if lanes else result, exact)
    count = _passes(model)
    return Timer(algorithm, width, lambda: kernel(count, *arguments), count * (WIDTH if lanes else 1), error)


def _passes(model: Model) -> int:
    """Return so many passes that the call from Python does not count."""
    return max(1, 10000 // model.nv)


def _filled(a: np.ndarray, lanes: tuple[int, ...]) -> np.ndarray:
    """Return an array (1, len(a), *lanes) with a in every lane."""
    out = aligned((1, len(a), *lanes))
    out[:] = a.reshape(-1, *(1 for _ in lanes))
    return out


def _error(x: np.ndarray, exact: np.ndarray) -> float:
    return float(np.abs(x - exact).max() / np.abs(exact).max())


def _steps(repeats: int) -> Iterator[Step]:
    """Time whole steps of 1 ms."""
    for case in problems():
        if case.exact is not None or case.name.startswith("free box") or ("midpoint", 1e-3) not in case.settings:
            continue
        exact, own_error = solution(case)
        run = case.ready("midpoint", 1e-3)
        scalar = np.median([run.once() for _ in range(repeats)][1:])
        error = np.nanmax(deviation(case.model, positions(run.trajectory), exact))
        counts = (WIDTH, WIDTH * (os.cpu_count() or 1))
        (few, cpu), (many, _) = (_batch_time(run, count, repeats // 3) for count in counts)
        yield Step(case.name, float(scalar), cpu, few / many, float(error), own_error)


def _batch_time(run: Run, count: int, repeats: int) -> tuple[float, float]:
    """Return wall and CPU time of a step and run [us], `count` at once, including the set-up of `simulate_batch`."""
    case = run.case
    arguments = case.duration, [run.start.y] * count, [case.reference] * count
    times = []
    for _ in range(repeats + 1):
        start = time.perf_counter(), time.process_time()
        simulate_batch(run.scene, *arguments, record=(), record_interval=case.duration, estimate_error=False)
        times.append((time.perf_counter() - start[0], time.process_time() - start[1]))
    wall, cpu = 1e6 * np.median(times[1:], axis=0) / (count * run.ready.plan.steps)
    return float(wall), float(cpu)


STYLES = {
    (MUJOCO, SCALARS): ("0.35", "s-", "MuJoCo mj_forward"),
    (PINOCCHIO, SCALARS): ("0.6", "d-", "Pinocchio aba"),
    ("ABA", SCALARS): ("C0", "o-", "ABA, float64"),
    ("ABA", LANES): ("C0", "o--", "ABA, lanes"),
    ("RNEA", SCALARS): ("C2", "^-", "RNEA, float64"),
    ("RNEA", LANES): ("C2", "^--", "RNEA, lanes"),
    ("CRBA", SCALARS): ("C1", "v-", "CRBA, float64"),
}


@look()
def _plot(rows: list[Row], machine: str, path: Path) -> None:
    """Draw time and error against the length of the chains."""
    figure, (times, errors) = subplots(11, 4.8, 1, 2)
    chains = [row for row in rows if row.robot.startswith("chain")]
    _lines(times, chains, "time")
    times.set(ylabel="time per call and robot [us]", title="Chains: time")
    times.legend(fontsize=8)
    _lines(errors, [row for row in chains if row.algorithm != MUJOCO and row.width == SCALARS], "error")
    errors.set(ylabel="greatest error by greatest value", title="Chains: error")
    figure.suptitle(machine, fontsize=8)
    save_figure(figure, path)


def _lines(axes: Axes, rows: list[Row], value: str) -> None:
    """Draw one of the columns against the number of links."""
    for key, (color, style, label) in STYLES.items():
        line = [row for row in rows if (row.algorithm, row.width) == key]
        if line:
            joints, values = [row.joints for row in line], [getattr(row, value) for row in line]
            axes.loglog(joints, values, style, color=color, label=label, markersize=4)
    lengths = sorted({row.joints for row in rows})
    axes.set_xticks(lengths, [str(n) for n in lengths])
    axes.minorticks_off()
    axes.set_xlabel("links")
