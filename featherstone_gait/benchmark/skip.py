"""What a scene does not have costs nothing: each saving with and without, in executed instructions, time and code.

Executed instructions are counted exactly: a forked child runs the kernel instruction by instruction (`ptrace`, Linux),
while the records that the kernel writes into shared memory tell where a tick ends.  That needs no performance counters,
which virtual machines hide.  Where it is not allowed the table says n/a, and what remains are the time and the
instructions of the compiled code.

All kernels are those for one robot, implicit Euler at 1 ms, unless stated otherwise.
"""

from __future__ import annotations

import ctypes
import functools
import math
import mmap
import os
import signal
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from ..core.compile.jit import entry
from ..core.compile.lanes import clamp
from ..core.effects.gearbox import gear_torque
from ..core.effects.motor import current_step
from ..core.integrate.rollout import rollout_lanes
from ..core.step.advance import advance
from ..core.step.context import Run, Step
from ..core.step.newton import solve_step
from ..core.tree.aba import aba
from ..core.tree.layout import Motion, Robot
from ..model import Ground, HeightField, Joint, Mimic, Model, Supply
from ..robot_file import load_robot, load_servo
from ..run.prepared import prepare, with_steps
from ..run.program import CompiledController
from ..run.reference import Reference
from ..run.simulate import PARTS, initial_state, simulate, simulate_batch, standing_state
from ..run.trajectory import Trajectory
from ..run.worlds import Spread, Worlds
from ..scene.compile import CompiledScene, ServoKind, compile_scene
from ..scene.external import Push
from ..walking.feedback import BalancedWalk, read_walk
from .machine import machine
from .session import upright
from .table import write_table

LOSSES = {  # M4, of an MX-64 by arXiv 2410.08650
    "stribeck_friction": 0.0239, "stribeck_external_load": 0.2343, "stribeck_motor_load": 0.2343,
    "stribeck_speed": 1.52, "stribeck_exponent": 1.33,
}  # fmt: skip
FIRMWARE = {
    "compliance_margin": 5e-3, "punch": 0.3, "pwm_steps": 1023.0, "duty_limit": 0.95, "profile_speed": 2.0,
    "delay": 3e-3,
}  # fmt: skip
STEP = 1e-3  # [s]
SETTLE = 0.1  # of simulated time before anything is counted [s]
COUNTED = 10  # steps, a tick
TIMED = 2000  # steps of a timed call
REPEATS, REPEATS_FULL = 9, 51
ALLOWED = 0.03  # over a bare ABA loop


class Work(NamedTuple):
    """Compiled code that does some steps; prepare(steps) gives its arguments and what it writes before and after."""

    kernel: Any  # of Numba
    prepare: Callable[[int], tuple[tuple, np.ndarray]]


class Cost(NamedTuple):
    """What a step takes."""

    executed: float  # instructions, NaN if they cannot be counted
    time: float  # of the processor, the least of some runs: what else it does only adds [us]
    code: float  # instructions of the compiled code


class Row(NamedTuple):
    """One line of the table."""

    saving: str
    without: Cost
    having: Cost
    note: str


def run(out_dir: Path, full: bool = False) -> list[Row]:
    """Print the tables; write skip.csv into `out_dir`."""
    host = machine()
    print(host)
    repeats = REPEATS_FULL if full else REPEATS
    parts = _costs(step_parts(), repeats)
    _print_parts(parts)
    rows = []
    groups = f"{'executed instructions a step':>29}{'us a step':>18}{'instructions of code':>22}"
    pairs = "".join(f"{'without':>{width}}{'with':>8}" for width in (10, 14))
    print(f"\n{'':46}{groups}\n{'saving':46}{'without':>11}{'with':>9}{'more':>9}{pairs}")
    for name, without, having, note in savings():
        costs = _costs({"without": without, "with": having}, repeats)
        rows.append(Row(name, costs["without"], costs["with"], note))
        print(_line(rows[-1]))
    print()
    for name, text in unskipped(rows):
        print(f"{name}: {text}")
    print(handed_over(3 * repeats if full else 3))
    _write(Path(out_dir) / "skip.csv", host, parts, rows)
    return rows


# ---------------------------------------------------------------------------------------------- counting


@functools.cache
def executed(work: Work, steps: int = COUNTED) -> float:
    """Instructions that a step executes, the mean over so many; NaN where the system does not let us count."""
    arguments, marks = work.prepare(steps)
    counts = instructions_at(lambda: work.kernel(*arguments), marks)
    return (counts[1] - counts[0]) / steps if counts else math.nan


def shared_array(*shape: int) -> np.ndarray:
    """NaN, in memory that a child shares."""
    array = np.frombuffer(mmap.mmap(-1, 8 * math.prod(shape))).reshape(shape)
    array[:] = np.nan
    return array


def instructions_at(call: Callable[[], object], marks: np.ndarray) -> list[int] | None:
    """Instructions that a forked child had executed when each of its marks stopped being NaN, in their order.

    None on systems other than Linux, where tracing is forbidden, and if the call ends before the last mark.
    """
    if not sys.platform.startswith("linux"):
        return None
    trace_me, step = 0, 9  # PTRACE_TRACEME, PTRACE_SINGLESTEP of sys/ptrace.h
    ptrace = ctypes.CDLL(None, use_errno=True).ptrace
    ptrace.argtypes, ptrace.restype = [ctypes.c_long] * 4, ctypes.c_long
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of a fork beside threads: the child needs none of them
        child = os.fork()
    if child == 0:
        if ptrace(trace_me, 0, 0, 0) == 0:
            os.kill(os.getpid(), signal.SIGSTOP)
            call()
        os._exit(0)
    counts: list[int] = []
    number = 0
    _, status = os.waitpid(child, 0)
    while not os.WIFEXITED(status) and not os.WIFSIGNALED(status):
        while len(counts) < len(marks) and marks[len(counts)] == marks[len(counts)]:
            counts.append(number)
        if len(counts) == len(marks) or ptrace(step, child, 0, 0) != 0:
            os.kill(child, signal.SIGKILL)
        else:
            number += 1
        _, status = os.waitpid(child, 0)
    return counts if len(counts) == len(marks) else None


def code(work: Work) -> float:
    """Instructions of the compiled code of a kernel, with all that it calls and its wrapper for Python.

    What the compiler merges into what varies by some per cent, even with what it compiled before.
    """
    return _code(work.kernel, tuple(map(work.kernel.typeof_pyval, work.prepare(1)[0])))


@functools.cache
def _code(kernel: Any, signature: tuple) -> float:
    """A kernel that was loaded from the cache has no assembly: compile it once more, beside the cache."""
    afresh = type(kernel)(kernel.py_func, targetoptions=dict(kernel.targetoptions))
    afresh.compile(signature)
    (text,) = afresh.inspect_asm().values()
    return float(sum(map(_is_instruction, text.splitlines())))


def _is_instruction(line: str) -> bool:
    """Of assembly: no label, directive, comment or padding."""
    return line[:1] == "\t" and line[1:2].isalpha() and "nop" not in line


def _costs(works: dict[str, Work], repeats: int) -> dict[str, Cost]:
    """The costs of several pieces of work, timed in turn."""
    for work in works.values():
        work.kernel(*work.prepare(1)[0])
    times = np.zeros((repeats, len(works)))
    for row in times:
        for k, work in enumerate(works.values()):
            arguments, _ = work.prepare(TIMED)
            start = time.thread_time()
            work.kernel(*arguments)
            row[k] = 1e6 * (time.thread_time() - start) / TIMED
    return {
        name: Cost(executed(work), float(least), code(work))
        for (name, work), least in zip(works.items(), times.min(axis=0))
    }


# ---------------------------------------------------------------------------------------------- bare loops


@entry
def aba_loop(
    steps: int,
    robot: Robot,
    h: float,
    q: np.ndarray,
    qd: np.ndarray,
    tau: np.ndarray,
    W: np.ndarray,
    qdd: np.ndarray,
    seen: np.ndarray,
) -> None:
    """Semi-implicit Euler, nothing else."""
    for k in range(steps + 1):
        if k == 0 or k == steps:
            seen[k // steps] = qd[0]
        aba(robot, Motion(None, None, None, q, qd, None), None, tau, None, W, None, qdd)
        for i in range(len(q)):
            qd[i] += h * qdd[i]
            q[i] += h * qd[i]


@entry
def rk4_loop(
    steps: int,
    robot: Robot,
    h: float,
    x: np.ndarray,
    start: np.ndarray,
    total: np.ndarray,
    slope: np.ndarray,
    tau: np.ndarray,
    W: np.ndarray,
    seen: np.ndarray,
) -> None:
    """Runge-Kutta, x = (q, qd)."""
    n = len(tau)
    for k in range(steps + 1):
        if k == 0 or k == steps:
            seen[k // steps] = x[0]
        for i in range(2 * n):
            start[i] = x[i]
            total[i] = 0.0
        for stage in range(4):
            aba(robot, Motion(None, None, None, x[:n], x[n:], None), None, tau, None, W, None, slope[n:])
            weight = 2.0 if stage == 1 or stage == 2 else 1.0
            ahead = h if stage == 2 else 0.5 * h
            for i in range(n):
                slope[i] = x[n + i]
            for i in range(2 * n):
                total[i] += weight * slope[i]
                x[i] = start[i] + ahead * slope[i]
        for i in range(2 * n):
            x[i] = start[i] + (h / 6.0) * total[i]


@entry
def solve_loop(steps: int, run: Run, h: float, y: np.ndarray, seen: np.ndarray) -> None:
    """The solution of an implicit step, after which nothing moves."""
    scene, o, s = run.scene, run.places[0], run.work.scratch
    for k in range(steps + 1):
        if k == 0 or k == steps:
            seen[k // steps] = y[0]
        solve_step(Step(scene, None, None, o, y, None, None, None, 0.0, h, h, h, 1.0, None, 1e-9, s.W, s.Z, s.C, s.F))


@entry
def step_loop(steps: int, run: Run, h: float, y: np.ndarray, seen: np.ndarray) -> None:
    """Solve and advance: a step without ticks and records."""
    scene, o, s = run.scene, run.places[0], run.work.scratch
    for k in range(steps + 1):
        if k == 0 or k == steps:
            seen[k // steps] = y[0]
        at = Step(scene, None, None, o, y, None, None, None, 0.0, h, h, h, 1.0, None, 1e-9, s.W, s.Z, s.C, s.F)
        solve_step(at)
        advance(at)


@entry
def current_loop(
    steps: int,
    motor: np.recarray,
    decay: np.ndarray,
    h: float,
    current: np.ndarray,
    voltage: np.ndarray,
    speed: np.ndarray,
    out: np.ndarray,
    seen: np.ndarray,
) -> None:
    """The law of motors with inductance."""
    for k in range(steps + 1):
        if k == 0 or k == steps:
            seen[k // steps] = h
        for i in range(len(motor)):
            out[i, 0], out[i, 1], out[i, 2] = current_step(motor[i], decay, i, current[i], voltage[i], speed[i], h)


@entry
def resistive_loop(
    steps: int,
    motor: np.recarray,
    decay: np.ndarray,
    h: float,
    current: np.ndarray,
    voltage: np.ndarray,
    speed: np.ndarray,
    out: np.ndarray,
    seen: np.ndarray,
) -> None:
    """The same of a motor without inductance."""
    for k in range(steps + 1):
        if k == 0 or k == steps:
            seen[k // steps] = h
        for i in range(len(motor)):
            m = motor[i]
            free = (voltage[i] - m.torque_constant * speed[i]) / m.resistance
            end = clamp(free, current[i] - m.current_slew * h, current[i] + m.current_slew * h)
            end = clamp(end, -m.current_limit, m.current_limit)
            out[i, 0], out[i, 1], out[i, 2] = end, end, m.torque_constant / m.resistance if end == free else 0.0


@entry
def gear_loop(
    steps: int, gear: np.recarray, h: float, e: np.ndarray, de: np.ndarray, out: np.ndarray, seen: np.ndarray
) -> None:
    """The law of gearboxes with backlash."""
    for k in range(steps + 1):
        if k == 0 or k == steps:
            seen[k // steps] = h
        for i in range(len(gear)):
            out[i, 0], out[i, 1], out[i, 2] = gear_torque(gear[i], e[i], de[i], h)


@entry
def tight_loop(
    steps: int, gear: np.recarray, h: float, e: np.ndarray, de: np.ndarray, out: np.ndarray, seen: np.ndarray
) -> None:
    """The same of a gearbox without backlash."""
    for k in range(steps + 1):
        if k == 0 or k == steps:
            seen[k // steps] = h
        for i in range(len(gear)):
            K, B = gear[i].stiffness, gear[i].damping
            out[i, 0], out[i, 1], out[i, 2] = K * e[i] + B * de[i], h * K + B, B * (de[i] * de[i])


# ---------------------------------------------------------------------------------------------- scenes


def free_arm() -> Model:
    """`arm7` without friction, stops and servos."""
    return _limp(load_robot("arm7"))


def _limp(model: Model) -> Model:
    free: dict[str, Any] = {"type": "continuous", "lower": -math.inf, "upper": math.inf}
    free |= {"damping": 0.0, "friction": 0.0}
    joints = tuple(replace(j, **free) if j.name in model.joint_names else j for j in model.joints)
    return replace(model, joints=joints, servos={})


def _driven(**changes: Any) -> Model:
    """The arm with AX-12 servos without friction."""
    arm = free_arm()
    servo = load_servo("ax12", viscous_friction=0.0, coulomb_friction=0.0, **changes)
    return replace(arm, servos=dict.fromkeys(arm.joint_names, servo))


def _rubbing(model: Model, losses: dict[str, float]) -> Model:
    """The model with dry friction in its servos, which holds, and losses of their gearboxes."""
    servos = {
        name: replace(servo, coulomb_friction=0.01, stick_speed=0.0, gearbox=replace(servo.gearbox, **losses))
        for name, servo in model.servos.items()
    }
    return replace(model, servos=servos)


def _standing_on_servos(model: Model, losses: dict[str, float]) -> Work:
    scene = _compiled(_rubbing(model, losses), "mipsd", Ground())
    return _rollout(scene, standing_state(scene, np.zeros(scene.tree.n)))


def _loop(kernel: Any, *constants: Any) -> Work:
    """A bare loop; arrays are copied, as it changes some of them."""

    def prepare(steps: int) -> tuple[tuple, np.ndarray]:
        seen = shared_array(2)
        return (steps, *(c.copy() if type(c) is np.ndarray else c for c in constants), seen), seen

    return Work(kernel, prepare)


def _rollout(
    scene: CompiledScene,
    state: np.ndarray | None = None,
    push: Push | None = None,
    record: Sequence[str] = (),
    every: int = COUNTED,
    acts: CompiledController | None = None,
) -> Work:
    """A scene that goes on from where it is after a tenth of a second, recorded every so many steps."""
    pushes = (push,) if push else ()
    start = simulate(scene, SETTLE, state, pushes=pushes, record=(), estimate_error=False).final
    ready = prepare(scene, STEP * COUNTED, record, pushes=pushes, controller=acts)
    if not record:
        ready = replace(ready, channels=np.array([scene.layout["q"]], np.int64))

    def arguments(steps: int) -> tuple[tuple, np.ndarray]:
        shorter = with_steps(ready, steps, min(every, steps))  # a record before the first and one after the last step
        out = shared_array(shorter.samples, len(ready.channels))
        return shorter.arguments(ready.start(start), out), out[:: max(1, len(out) - 1), 0]

    return Work(ready.kernel, arguments)


def _lanes(scene: CompiledScene, state: np.ndarray, worlds: Worlds) -> Work:
    """Eight runs in step, each in its world, that begin where one has come to in a tenth of a second."""
    start = simulate(scene, SETTLE, state, record=(), estimate_error=False).final
    ready = [prepare(one, STEP * COUNTED, ("base_q",)) for one in worlds.scenes(scene)]

    def arguments(steps: int) -> tuple[tuple, np.ndarray]:
        shorter = [with_steps(one, steps, steps) for one in ready]
        run, y, out = shorter[0].arguments_in_lanes([one.start(start) for one in shorter])
        seen = shared_array(*out.shape)
        return (run, y, seen), seen[:, 0, 0]

    return Work(rollout_lanes, arguments)


def _spread(*names: str) -> dict[str, Spread]:
    """Numbers that differ by less than shows in the motion."""
    return {name: Spread("uniform", 1e-13) for name in names}


def _compiled(
    model: Model, servos: ServoKind | None = None, ground: Ground | None = None, integrator: str = "implicit_euler"
) -> CompiledScene:
    return compile_scene(model, servos, ground, integrator=integrator, timestep=STEP, fall_height=-1e6, fall_tilt=3.2)


def step_parts() -> dict[str, Work]:
    """From the bare loop to the whole step of the free arm, for both integrators of such a scene."""
    scene, fourth = _compiled(free_arm()), _compiled(free_arm(), integrator="rk4")
    n, zeros, robot = scene.tree.n, np.zeros, Robot(scene.tree.bodies, None, scene.gravity)
    W, x = zeros(scene.tree.workspace_shape()), np.full(2 * n, 0.1)
    y = initial_state(scene, x[:n], x[n:])
    ready = prepare(scene, STEP)
    run_, _, _ = ready.arguments(ready.start(y))
    return {
        "bare ABA loop": _loop(aba_loop, robot, STEP, x[:n], x[n:], zeros(n), W, zeros(n)),
        "+ servo-free forces, Newton's check": _loop(solve_loop, run_, STEP, y),
        "+ state, energies, chatter": _loop(step_loop, run_, STEP, y),
        "+ ticks, status, records: implicit_euler": _rollout(scene, y),
        "bare RK4 loop of ABA": _loop(rk4_loop, robot, STEP, x, x, x, x, zeros(n), W),
        "rk4": _rollout(fourth, initial_state(fourth, x[:n], x[n:])),
    }


def savings() -> Iterator[tuple[str, Work, Work, str]]:
    """Name, the work without and with it, and a remark."""
    arm = free_arm()
    bare = _rollout(_compiled(arm))
    last = arm.joints[-1]
    yield "fixed joint lumped (of 7 the last)", _rollout(_compiled(_changed(arm, last, type="fixed"))), bare, ""
    held = replace(arm, locked={j.name: 0.0 for j in arm.joints[4:]})
    yield "locked joints lumped (of 7 three)", _rollout(_compiled(held)), bare, ""
    rubbed = replace(arm, joints=tuple(replace(j, damping=0.01, friction=0.01) for j in arm.joints))
    yield "no friction", bare, _rollout(_compiled(rubbed)), ""
    limits: dict[str, Any] = {"type": "revolute", "lower": -3.0, "upper": 3.0}
    stopped = replace(arm, joints=tuple(replace(j, **limits) for j in arm.joints))
    yield "no stops", bare, _rollout(_compiled(stopped)), "no joint at its stop"
    paired = _changed(arm, last, mimic=Mimic(arm.joints[0].name))
    yield "no coupled joints", bare, _rollout(_compiled(paired)), "the last of 7 follows the first"
    push = Push(arm.links[-1].name, force=(0.1, 0.0, 0.0))
    yield "no pushes", bare, _rollout(_compiled(arm), push=push), "one push"
    yield "no recorded channel", _rollout(_compiled(arm), every=1), _rollout(_compiled(arm), record=PARTS, every=1), (
        "one number and all channels, each step"
    )
    rigid, soft = _rollout(_compiled(_driven(), "standard")), _rollout(_compiled(_driven(), "mipsd"))
    yield "no servos", bare, rigid, "standard model"
    yield "no rotor", rigid, soft, "standard model and mipsd"
    dry, loaded = (_rollout(_compiled(_rubbing(_driven(), losses), "standard")) for losses in ({}, LOSSES))
    yield "no friction that knows load and speed", dry, loaded, "M1 and M4 of 7 servos"
    firm = _rollout(_compiled(_driven(**FIRMWARE), "standard"))
    yield "no firmware", rigid, firm, "all of it in 7 servos, of a tick a step's share"
    fed = _rollout(_compiled(replace(_driven(), supply=Supply(11.1, 0.3)), "standard"))
    yield "no supply", rigid, fed, "one that 7 servos share"
    direct = _rollout(_compiled(_driven(inductance=0.0), "standard"))
    yield "no inductance (a number of the same kernel)", direct, rigid, "not skipped, see below"
    loose = _rollout(_compiled(_driven(backlash=0.01), "mipsd"))
    yield "no backlash (a number of the same kernel)", soft, loose, "not skipped, see below"
    body = _limp(load_robot("humanoid", locked="simplified"))
    flying = _rollout(_compiled(body))
    yield "no floating base (humanoid)", _rollout(_compiled(replace(body, base="fixed"))), flying, ""
    over = _compiled(body, ground=Ground())
    standing = standing_state(over, np.zeros(over.tree.n))
    high = standing.copy()
    high[over.layout["base_q"] + 2] += 10.0
    yield "no ground (humanoid)", flying, _rollout(over, standing), f"{len(body.contacts)} points, standing"
    plane = _rollout(over, standing)
    yield "nothing near the ground (humanoid)", _rollout(over, high), plane, "same kernel"
    poses = _rollout(over, standing, record=("base_q", "q"), every=1)
    near = _rollout(over, standing, record=("clearance",), every=1)
    yield "no clearance (humanoid)", poses, near, "both record poses each step; distances are for after the run"
    balls = _rollout(*_standing(_reshaped(body, radius=1e-3), Ground()))
    yield "no round contacts (humanoid)", plane, balls, "points and spheres"
    yield "no wheels (humanoid)", balls, _rollout(*_standing(_reshaped(body, rim=1e-3), Ground())), "spheres and discs"
    field, level = _standing(body, Ground(field=HeightField(np.zeros((20, 20)), (0.1, 0.1), (-1.0, -1.0))))
    high = level.copy()
    high[field.layout["base_q"] + 2] += 10.0
    yield "no height field (humanoid)", plane, _rollout(field, level), "level, 400 nodes"
    yield "nothing near the height field (humanoid)", _rollout(field, high), _rollout(field, level), "same kernel"
    walker = _compiled(load_robot("humanoid", locked="simplified"), "mipsd", Ground())
    still = standing_state(walker, np.zeros(walker.tree.n))
    dry, loaded = (_standing_on_servos(walker.model, losses) for losses in ({}, LOSSES))
    yield "no friction that knows load and speed (humanoid)", dry, loaded, "M1 and M4 of 10 servos, standing"
    plain, feedback = _rollout(walker, still), _rollout(walker, still, acts=upright)
    yield "no controller of one's own (humanoid)", plain, feedback, "ticks are in its time, not in its instructions"
    walk = read_walk(Path(walker.model.source).parent / "balanced_gait.npz")
    assert isinstance(walk, BalancedWalk)
    balanced = _rollout(walker, still, acts=walk.controller(walker))
    yield "no feedback from an IMU (humanoid)", plain, balanced, "ticks are in its time, not in its instructions"
    servos = _spread("resistance", "inductance", "motor_constant", "voltage_limit", "stiffness", "damping", "Kp")
    ground, links = _spread("friction", "sinking", "damping_ratio"), _spread("mass", "center_of_mass", "inertia")
    alike = _lanes(walker, still, Worlds(runs=8))
    unlike = _lanes(walker, still, Worlds(runs=8, servos=servos, ground=ground))
    yield "no worlds of servos and ground (humanoid)", alike, unlike, "eight lanes: a step of all"
    unlike = _lanes(walker, still, Worlds(runs=8, links=links))
    yield "no worlds of inertias (humanoid)", alike, unlike, "eight lanes: a step of all"


def _reshaped(model: Model, **round_: Any) -> Model:
    return replace(model, contacts=tuple(replace(point, **round_) for point in model.contacts))


def _standing(model: Model, ground: Ground) -> tuple[CompiledScene, np.ndarray]:
    scene = _compiled(model, ground=ground)
    return scene, standing_state(scene, np.zeros(scene.tree.n))


def _changed(model: Model, joint: Joint, **changes: Any) -> Model:
    return replace(model, joints=tuple(replace(j, **changes) if j is joint else j for j in model.joints))


def unskipped(rows: list[Row]) -> Iterator[tuple[str, str]]:
    """What inductance and backlash cost where they are zero: their share of the laws, alone in a loop."""
    steps = {row.saving: row for row in rows}
    rigid, soft = _compiled(_driven(inductance=0.0), "standard"), _compiled(_driven(), "mipsd")
    n = rigid.tree.n
    small, out, motor = np.full(n, 0.1), np.zeros((n, 3)), rigid.constants.actuator.motor
    loops = {
        "inductance": (current_loop, resistive_loop, (motor, rigid.constants.decay, STEP, small, small, small, out)),
        "backlash": (gear_loop, tight_loop, (soft.constants.actuator.gear, STEP, small, small, out)),
    }
    for name, (with_, without, constants) in loops.items():
        step = steps[f"no {name} (a number of the same kernel)"].without.executed
        more = []
        for kernel in (with_, without):
            work = _loop(kernel, *constants)
            kernel(*work.prepare(1)[0])
            more.append(executed(work))
        extra = EVALUATIONS * (more[0] - more[1])
        share = f"{extra / step:.1%} of a step" if extra == extra else "n/a"
        yield name, f"not skipped where it is zero: costs at most {_count(extra)} instructions, {share}"


EVALUATIONS = 4  # of the law of a joint in a step without clipping: linearized, compared, energies, motor or gear


def handed_over(repeats: int) -> str:
    """Candidates of which every second falls soon: all in one queue, and eight at a time that wait for the last."""
    scene = compile_scene(load_robot("humanoid", locked="simplified"), "mipsd", Ground(), "implicit_euler", STEP)
    stands = standing_state(scene, np.zeros(scene.tree.n))
    falls = stands.copy()
    falls[scene.layout["base_qd"]] = 2.0  # [m/s]
    states = [stands, falls] * 16
    still = [Reference([0.0], np.zeros((1, scene.tree.n)))] * 8
    how: dict[str, Any] = dict(record=(), executor=SimpleNamespace(map=map), estimate_error=False)

    def rollouts(size: int) -> list[Trajectory]:
        return [
            run_
            for k in range(0, len(states), size)
            for run_ in simulate_batch(scene, 2.0, states[k : k + size], still * (size // 8), **how)
        ]

    fallen = [run_.end_time for run_ in rollouts(len(states)) if run_.status == "fell"]
    times = np.zeros((repeats, 2))
    for row in times:
        for k, size in enumerate((len(states), 8)):
            start = time.thread_time()
            rollouts(size)
            row[k] = time.thread_time() - start
    whole, waiting = np.median(times, axis=0)
    spread = np.ptp(times[:, 0] / times[:, 1])
    return (
        f"fallen lanes handed over: {len(fallen)} of {len(states)} walkers fall after {np.median(fallen):.2f} of 2 s; "
        f"processor time {whole / waiting:.2f} +-{0.5 * spread:.2f} of that without handing over"
    )


# ---------------------------------------------------------------------------------------------- output


def _print_parts(parts: dict[str, Cost]) -> None:
    print("\nthe free arm of seven joints, a step of it")
    print(f"{'':46}{'executed':>9}{'by bare':>9}{'us':>8}{'by bare':>9}{'code':>8}")
    bare = next(iter(parts.values()))
    for name, cost in parts.items():
        bare = cost if name.startswith("bare") else bare
        print(
            f"{name:46}{_count(cost.executed):>9}{_ratio(cost.executed, bare.executed):>9}{cost.time:8.2f}"
            f"{_ratio(cost.time, bare.time):>9}{cost.code:8.0f}"
        )
        if name.endswith("implicit_euler") or name == "rk4":
            more = cost.executed / bare.executed - 1.0
            verdict = "n/a" if more != more else f"{more:+.1%}: {'holds' if more <= ALLOWED else 'does not hold'}"
            print(f"at most {ALLOWED:.0%} more instructions than the bare loop: {verdict}")


def _line(row: Row) -> str:
    a, b = row.without, row.having
    more = "n/a" if math.isnan(a.executed) else f"{b.executed / a.executed - 1.0:+.1%}"
    return (
        f"{row.saving:46}{_count(a.executed):>11}{_count(b.executed):>9}{more:>9}{a.time:10.2f}{b.time:8.2f}"
        f"{a.code:14.0f}{b.code:8.0f}  {row.note}"
    )


def _count(x: float) -> str:
    return "n/a" if math.isnan(x) else f"{x:.0f}"


def _ratio(x: float, y: float) -> str:
    return "n/a" if math.isnan(x) or math.isnan(y) else f"{x / y:.3f}"


def _write(path: Path, machine: str, parts: dict[str, Cost], rows: list[Row]) -> None:
    names = ("executed", "time_us", "code")
    columns = ["saving", *(f"{name}_without" for name in names), *(f"{name}_with" for name in names), "note"]
    lines = [[name, *cost, *[""] * len(names), "free arm"] for name, cost in parts.items()]
    write_table(path, columns, [*lines, *([row.saving, *row.without, *row.having, row.note] for row in rows)], machine)
