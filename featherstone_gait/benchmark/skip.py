"""Count what a feature costs a step, by a scene without the feature and one with it: absent features cost nothing.

A step's executed instructions are counted exactly (`instructions.py`), over a step or two after a tenth of a second of
simulation; n/a where they cannot be counted.  Beside them stand its CPU time, the least of some calls of 1000 steps
timed in turn, and the size of the compiled code.  All kernels are those for one robot, implicit Euler at 1 ms, unless
stated otherwise; ticks of controllers are in the time and not in the instructions.

    featherstone-gait benchmark skip        three minutes, compiling aside
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..core.compile.jit import entry
from ..core.integrate.rollout import rollout_lanes
from ..core.step.advance import advance
from ..core.step.context import Run, Step
from ..core.step.newton import solve_step
from ..core.tree.aba import aba
from ..core.tree.layout import Motion, Robot
from ..model import Ground, HeightField, Mimic, Model, Supply
from ..robot_file import load_robot, load_servo
from ..run.compiled_run import CompiledRun
from ..run.prepare import prepare, with_steps
from ..run.simulate import PARTS, simulate, standing_state
from ..run.worlds import Distribution, Worlds
from ..scene.compile import CompiledScene, GearboxKind, compile_scene
from ..scene.external import Push
from ..walking.feedback import BalancedWalk, read_walk
from .instructions import code_size, instructions, records
from .machine import machine
from .session import upright
from .table import in_turn, print_head, print_row, write_table

M4 = {  # friction of an MX-64 by arXiv 2410.08650
    "stribeck_friction": 0.0239, "stribeck_external_load": 0.2343, "stribeck_motor_load": 0.2343,
    "stribeck_speed": 1.52, "stribeck_exponent": 1.33,
}  # fmt: skip
FIRMWARE = {
    "compliance_margin": 5e-3, "punch": 0.3, "pwm_steps": 1023.0, "duty_limit": 0.95, "profile_speed": 2.0,
    "delay": 3e-3,
}  # fmt: skip
LIMP: dict[str, Any] = {"type": "continuous", "lower": -math.inf, "upper": math.inf, "damping": 0.0, "friction": 0.0}
STEP, SETTLE = 1e-3, 0.1  # of the simulation, and time before anything is counted [s]
COUNTED, TIMED = 2, 1000  # steps
REPEATS, REPEATS_FULL = 5, 51
ALLOWED = 0.03  # over a bare ABA loop


class Work(NamedTuple):
    """Hold a kernel that makes some steps; prepare(steps) gives its arguments, the last of which takes its records."""

    kernel: Any  # of Numba
    prepare: Callable[[int], tuple]
    every: int = 1  # steps between records


class Row(NamedTuple):
    """One line of the table: what a step takes without the feature and with it."""

    saving: str
    executed_without: float  # instructions, NaN if they cannot be counted
    time_us_without: float  # of the processor, the least of some calls
    code_without: float  # size of the compiled code [bytes]
    executed_with: float
    time_us_with: float
    code_with: float
    note: str

    @property
    def more(self) -> float:
        return self.executed_with / self.executed_without - 1.0


SHOWN = {
    "saving": ("saving", "<51"), "executed_without": ("instructions", "13.0f"), "executed_with": ("with", "8.0f"),
    "more": ("more", "8.1%"), "time_us_without": ("us", "8.2f"), "time_us_with": ("with", "8.2f"),
    "code_without": ("bytes", "9.0f"), "code_with": ("with", "8.0f"), "note": ("  ", "<2"),
}  # fmt: skip


def run(out_dir: Path, full: bool = False) -> list[Row]:
    """Print the table; write skip.csv into `out_dir`; `full` times more calls."""
    host, rows = machine(), []
    print(f"{host}\n\na step without a feature and with it")
    print_head(SHOWN)
    for name, without, having, note in (*parts(), *savings()):
        without_, with_ = costs([without, having], REPEATS_FULL if full else REPEATS)
        rows.append(Row(name, *without_, *with_, note))
        print_row(rows[-1], SHOWN)
    worst = max(row.more for row in rows if row.saving.startswith("whole step"))
    verdict = "holds" if worst <= ALLOWED else "not counted" if math.isnan(worst) else "does not hold"
    print(f"a whole step takes at most {ALLOWED:.0%} more instructions than a bare loop: {worst:+.1%}, {verdict}")
    write_table(Path(out_dir) / "skip.csv", Row._fields, rows, host)
    return rows


# ---------------------------------------------------------------------------------------------- measuring


@functools.cache
def executed(work: Work) -> float:
    """Count the instructions of a step, the mean of some that neither begin nor end a run; NaN if not counted."""
    work.kernel(*work.prepare(1))
    arguments = work.prepare(2 * COUNTED)
    return instructions(lambda: work.kernel(*arguments), arguments[-1], COUNTED // work.every) / COUNTED


def costs(works: list[Work], repeats: int) -> list[tuple[float, float, float]]:
    """Return instructions, CPU time [us] and code size [bytes] of each; all are timed in turn."""
    counts = [executed(work) for work in works]
    turns = [[partial(work.kernel, *work.prepare(TIMED)) for work in works] for _ in range(repeats)]
    times = np.min([in_turn(turn, 1)[0] for turn in turns], axis=0)
    sizes = [code_size(work.kernel, work.prepare(1)) for work in works]
    return [(count, 1e6 * float(time_) / TIMED, size) for count, time_, size in zip(counts, times, sizes)]


def bare(kernel: Any, *constants: Any) -> Work:
    """Prepare a bare loop; arrays are copied, as it changes some of them."""

    def arguments(steps: int) -> tuple:
        return (steps, *(c.copy() if type(c) is np.ndarray else c for c in constants), records(steps + 1))

    return Work(kernel, arguments)


def rollout(
    model: Model, gearbox: GearboxKind | None = None, ground: Ground | None = None, *, lifted: float = 0.0,
    integrator: str = "implicit_euler", record: tuple[str, ...] = (), every: int = COUNTED,
    controller: Callable[[CompiledScene], Any] | None = None, push: Push | None = None, worlds: Worlds | None = None,
) -> Work:  # fmt: skip
    """Prepare a scene that goes on from its state after a tenth of a second; with worlds eight of it in lanes.

    A robot stands on the ground, or is lifted above it [m].
    """
    scene = compile_scene(model, gearbox, ground, integrator, STEP, fall_height=-1e6, fall_tilt=3.2)
    state = None if ground is None else standing_state(scene, np.zeros(scene.tree.n))
    if state is not None:
        state[scene.layout["base_q"] + 2] += lifted
    pushes = (push,) if push else ()
    start = simulate(scene, SETTLE, state, pushes=pushes, record=(), estimate_error=False).final
    if worlds is not None:
        lanes = [prepare(one, 1.0, ("base_q",)) for one in worlds.scenes(scene)]
        return Work(rollout_lanes, partial(in_lanes, lanes, start, every), every)
    ready = prepare(scene, 1.0, record, pushes=pushes, controller=controller and controller(scene))
    if not record:
        ready = replace(ready, channels=np.array([scene.layout["q"]], np.int64))
    return Work(ready.kernel, partial(alone, ready, start, every), every)


def alone(ready: CompiledRun, start: np.ndarray, every: int, steps: int) -> tuple:
    shorter = with_steps(ready, steps, min(every, steps))
    return shorter.arguments(ready.start(start), records(shorter.samples, len(ready.channels)))


def in_lanes(ready: list[CompiledRun], start: np.ndarray, every: int, steps: int) -> tuple:
    shorter = [with_steps(one, steps, min(every, steps)) for one in ready]
    run_, y, out = shorter[0].arguments_in_lanes([one.start(start) for one in shorter])
    return run_, y, records(*out.shape)


# ---------------------------------------------------------------------------------------------- bare loops


@entry
def aba_loop(
    steps: int, robot: Robot, h: float, q: np.ndarray, qd: np.ndarray, tau: np.ndarray, qdd: np.ndarray, W: np.ndarray,
    out: np.ndarray,
) -> None:  # fmt: skip
    """Make steps of semi-implicit Euler, nothing else."""
    for k in range(steps + 1):
        out[k] = qd[0]
        aba(robot, Motion(None, None, None, q, qd, None), None, tau, None, W, None, qdd)
        for i in range(len(q)):
            qd[i] += h * qdd[i]
            q[i] += h * qd[i]


@entry
def rk4_loop(steps: int, robot: Robot, h: float, z: np.ndarray, W: np.ndarray, out: np.ndarray) -> None:
    """Make Runge-Kutta steps of x = (q, qd); rows of z: x, x at the start of the step, sum of slopes, slope, tau."""
    x, start, total, slope, n = z[0], z[1], z[2], z[3], z.shape[1] // 2
    tau = z[4, :n]
    for k in range(steps + 1):
        out[k] = x[0]
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
def solve_loop(steps: int, run: Run, advances: bool | None, h: float, y: np.ndarray, out: np.ndarray) -> None:
    """Solve an implicit step; unless advances is None, also advance the state: a step without ticks."""
    scene, o, s = run.scene, run.offsets[0], run.work.scratch
    for k in range(steps + 1):
        out[k] = y[0]
        at = Step(scene, None, None, o, y, None, None, None, 0.0, h, h, h, 1.0, None, 1e-9, s.W, s.Z, s.C, s.F)
        solve_step(at)
        if advances is not None:
            advance(at)


def parts() -> Iterator[tuple[str, Work, Work, str]]:
    """Yield rows from a bare loop to the whole step of the free arm, for both integrators of such a scene."""
    scene = compile_scene(free_arm(), integrator="implicit_euler", timestep=STEP)
    n, robot, W = scene.tree.n, Robot(scene.tree.bodies, None, scene.gravity), np.zeros(scene.tree.workspace_shape())
    ready = prepare(scene, STEP)
    run_, y, _ = ready.arguments(ready.start())
    x = np.full((5, 2 * n), 0.1)
    euler, rk4 = bare(aba_loop, robot, STEP, *x[:4, :n], W), bare(rk4_loop, robot, STEP, x, W)
    yield "solution of a step", euler, bare(solve_loop, run_, None, STEP, y), "free arm of 7 joints, by a loop of ABA"
    yield "solution, state, energies, chatter", euler, bare(solve_loop, run_, True, STEP, y), "the same"
    yield "whole step, implicit_euler", euler, rollout(free_arm()), "the same, with ticks, status and records"
    yield "whole step, rk4", rk4, rollout(free_arm(), integrator="rk4"), "by a loop of RK4 with ABA"


# ---------------------------------------------------------------------------------------------- scenes


@functools.cache
def free_arm(name: str = "arm7", locked: str | None = None) -> Model:
    """Return a robot without friction, stops and servos."""
    return changed(load_robot(name, locked=locked), **LIMP)


def changed(model: Model, which: slice = slice(None), **changes: Any) -> Model:
    """Change some moving joints, and leave out the servos."""
    names = model.joint_names[which]
    joints = tuple(replace(j, **changes) if j.name in names else j for j in model.joints)
    return replace(model, joints=joints, servos={})


def driven(**changes: Any) -> Model:
    """Return the arm with AX-12 servos without friction."""
    servo = load_servo("ax12", viscous_friction=0.0, coulomb_friction=0.0, **changes)
    return replace(free_arm(), servos=dict.fromkeys(free_arm().joint_names, servo))


def rubbing(model: Model, **losses: float) -> Model:
    """Give all servos dry friction, which holds, and losses of their gearboxes."""
    servos = {
        name: replace(servo, coulomb_friction=0.01, stick_speed=0.0, gearbox=replace(servo.gearbox, **losses))
        for name, servo in model.servos.items()
    }
    return replace(model, servos=servos)


def shaped(model: Model, **shape: Any) -> Model:
    return replace(model, contacts=tuple(replace(point, **shape) for point in model.contacts))


def balance(scene: CompiledScene) -> Any:
    """Return the feedback that comes with the humanoid."""
    walk = read_walk(Path(scene.model.source).parent / "balanced_gait.npz")
    assert isinstance(walk, BalancedWalk)
    return walk.controller(scene)


def spread(*names: str) -> dict[str, Distribution]:
    """Return distributions so narrow that they do not show in the motion."""
    return {name: Distribution("uniform", 1e-13) for name in names}


def savings() -> Iterator[tuple[str, Work, Work, str]]:
    """Yield rows: name, the work without the feature and with it, and a remark."""
    arm, ground, last = free_arm(), Ground(), slice(-1, None)
    limits: dict[str, Any] = {"type": "revolute", "lower": -3.0, "upper": 3.0}
    held = replace(arm, locked={j.name: 0.0 for j in arm.joints[4:]})
    push = Push(arm.links[-1].name, force=(0.1, 0.0, 0.0))
    plain, rigid, soft = rollout(arm), rollout(driven(), "standard"), rollout(driven(), "mipsd")
    dry, loaded = (rollout(rubbing(driven(), **losses), "standard") for losses in ({}, M4))
    fed = rollout(replace(driven(), supply=Supply(11.1, 0.3)), "standard")
    yield from (
        ("fixed joint lumped (of 7 the last)", rollout(changed(arm, last, type="fixed")), plain, ""),
        ("locked joints lumped (of 7 three)", rollout(held), plain, ""),
        ("no friction", plain, rollout(changed(arm, damping=0.01, friction=0.01)), ""),
        ("no stops", plain, rollout(changed(arm, **limits)), "no joint at its stop"),
        ("no coupled joints", plain, rollout(changed(arm, last, mimic=Mimic(arm.joints[0].name))),
         "the last of 7 follows the first"),
        ("no pushes", plain, rollout(arm, push=push), "one push"),
        ("no recorded channel", rollout(arm, every=1), rollout(arm, record=PARTS, every=1),
         "one number and all channels, each step"),
        ("no servos", plain, rigid, "standard model"),
        ("no rotor", rigid, soft, "standard model and mipsd"),
        ("no friction that knows load and speed", dry, loaded, "M1 and M4 of 7 servos"),
        ("no firmware", rigid, rollout(driven(**FIRMWARE), "standard"), "all of it in 7 servos"),
        ("no supply", rigid, fed, "one that 7 servos share"),
        ("no inductance", rollout(driven(inductance=0.0), "standard"), rigid, "not skipped: same kernel"),
        ("no backlash", soft, rollout(driven(backlash=0.01), "mipsd"), "not skipped: same kernel"),
    )  # fmt: skip
    body = free_arm("humanoid", "simplified")
    flying, standing = rollout(body), rollout(body, None, ground)
    balls = rollout(shaped(body, radius=1e-3), None, ground)
    field = Ground(field=HeightField(np.zeros((20, 20)), (0.1, 0.1), (-1.0, -1.0)))
    level, high = rollout(body, None, field), rollout(body, None, field, lifted=10.0)
    posed, near = (rollout(body, None, ground, record=r, every=1) for r in (("base_q", "q"), ("clearance",)))
    yield from (
        ("no floating base (humanoid)", rollout(replace(body, base="fixed")), flying, ""),
        ("no ground (humanoid)", flying, standing, f"{len(body.contacts)} points, standing"),
        ("nothing near the ground (humanoid)", rollout(body, None, ground, lifted=10.0), standing, "same kernel"),
        ("no clearance (humanoid)", posed, near, "both record poses each step; distances are for after the run"),
        ("no round contacts (humanoid)", standing, balls, "points and spheres"),
        ("no wheels (humanoid)", balls, rollout(shaped(body, circle_radius=1e-3), None, ground), "spheres and discs"),
        ("no height field (humanoid)", standing, level, "level, 400 nodes"),
        ("nothing near the height field (humanoid)", high, level, "same kernel"),
    )
    model = load_robot("humanoid", locked="simplified")
    walker = partial(rollout, model, "mipsd", ground)
    dry, loaded = (rollout(rubbing(model, **losses), "mipsd", ground) for losses in ({}, M4))
    still, alike = walker(), walker(worlds=Worlds(8))
    servos = spread("resistance", "inductance", "motor_constant", "voltage_limit", "stiffness", "damping", "Kp")
    unlike = walker(worlds=Worlds(8, servos=servos, ground=spread("friction", "penetration", "damping_ratio")))
    inertias = walker(worlds=Worlds(8, links=spread("mass", "center_of_mass", "inertia")))
    ticks, eight = "ticks are in its time, not in its instructions", "eight lanes: a step of all"
    yield from (
        ("no friction that knows load and speed (humanoid)", dry, loaded, "M1 and M4 of 10 servos, standing"),
        ("no controller of one's own (humanoid)", still, walker(controller=lambda _: upright), ticks),
        ("no feedback from an IMU (humanoid)", still, walker(controller=balance), ticks),
        ("no worlds of servos and ground (humanoid)", alike, unlike, eight),
        ("no worlds of inertias (humanoid)", alike, inertias, eight),
    )
