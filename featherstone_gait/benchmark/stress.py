"""Numerical stability and honesty: scenes at the edge, and whether a result that is wrong is said to be.

Mass ratios of 1e4, inertias of 1e-8 kg m^2, a chain of 100 links, gear ratios of 1000, gains a hundred times too high,
steps up to 50 ms, stops hit at speed, backlash, kicks, drops from 2 m, deep penetration, random trees.  Each case is run
with every integrator that applies and compared, joint by joint and record by record, with the extrapolation at a
tolerance of 1e-10.  What that itself is wrong by is taken from a tolerance of 1e-9: a case is compared as long as the two
agree to 1e-5, which is as long as its motion can be known at all.

A run is wrong if it is off by more than 1e-3 rad or m anywhere.  It says so by its status, or by its own estimate
(`simulate(..., estimate_error=True)`) if that is at least a tenth of the error.  If neither says so it is silently wrong.
A run that is right but has another status than "ok", or an estimate above both 1e-3 and ten times its error, is a false
alarm.
"""

from __future__ import annotations

import csv
import functools
import math
import os
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from ..model import ContactPoint, Ground, Joint, Link, Model
from ..reference import Reference
from ..robot_file import load_robot, load_servo
from ..scene import ADAPTIVE, CompiledScene, compile_scene
from ..simulation import Push, initial_state, simulate
from ..study.table import complete
from ..trajectory import Trajectory
from .machine import machine

WRONG = 1e-3  # error [rad or m]
HONEST = 10.0  # an error may be so many times its estimate, and an estimate so many times the error
TIGHT, LESS_TIGHT = 1e-10, 1e-9  # tolerances of the reference
KNOWN = 1e-5  # to which these two agree while a case is compared [rad or m]
GRID = 1e-2  # between records [s]
STEPS, STEPS_FULL = (1e-3, 1e-2, 5e-2), (1e-4, 1e-3, 5e-3, 1e-2, 2e-2, 5e-2)  # [s]
TOLERANCES, TOLERANCES_FULL = (1e-3, 1e-6), (1e-2, 1e-3, 1e-4, 1e-6, 1e-8)
FIXED = ("implicit_euler", "midpoint", "rk4", "simtwo")
HELD, BY_STATUS, BY_ESTIMATE = "held", "wrong, by status", "wrong, by estimate"
FALSE, SILENT = "false alarm", "silently wrong"
OUTCOMES = {HELD: "#8fc98f", BY_STATUS: "#3b6fb6", BY_ESTIMATE: "#9cc3e8", FALSE: "#f2c037", SILENT: "#c62828"}
UPRIGHT = (1.0, 0.0, 0.0, 0.0)
STILL = Push("base")  # pushes nothing, so that a case without a kick runs in the kernels of one with


class Case(NamedTuple):
    """What is simulated."""

    name: str
    model: Model
    duration: float  # [s]
    q: Sequence[float]
    qd: Sequence[float] | None = None
    servos: str | None = None
    ground: Ground | None = None
    push: Push = STILL

    def scene(self, integrator: str, timestep: float = 1e-3) -> CompiledScene:
        falls = {} if self.ground is None else {"fall_height": -1e6, "fall_tilt": math.pi}
        return compile_scene(self.model, self.servos, self.ground, integrator, timestep, **falls)

    def run(self, scene: CompiledScene, duration: float, sample: float, rtol=None, estimate=False) -> Trajectory:
        still = None if self.servos is None else Reference([0.0], np.zeros((1, scene.tree.n)))
        record = ("base_q", "q") if self.model.base == "floating" else ("q",)
        state = initial_state(scene, self.q, self.qd)
        return simulate(
            scene, duration, state, still, pushes=[self.push], record=record, sample=sample, rtol=rtol,
            estimate_error=estimate,
        )  # fmt: skip

    @property
    def sampled(self) -> bool:
        """Whether the controllers have a period, into which steps must fit."""
        return any(servo.controller.law not in ("pd", "pd_clamped") for servo in self.model.servos.values())

    @property
    def period(self) -> float:
        """Of the controllers [s]; zero where they are continuous or there are none."""
        return max((servo.controller.period for servo in self.model.servos.values()), default=0.0) * self.sampled


class Truth(NamedTuple):
    """A case at tight tolerance, as long as it can be known."""

    known: float  # [s]
    uncertainty: float  # until then [rad or m]
    positions: np.ndarray  # (records, numbers), every `GRID`


class Setting(NamedTuple):
    """An integrator, with a step [s] or a tolerance."""

    integrator: str
    value: float

    @property
    def label(self) -> str:
        return f"{self.value:.0e}" if self.integrator in ADAPTIVE else f"{1e3 * self.value:g} ms"


class Row(NamedTuple):
    """One line of the table."""

    case: str
    integrator: str
    setting: float  # step [s] or tolerance
    compared: float  # time [s]
    uncertainty: float  # of the reference [rad or m]
    error: float  # largest [rad or m]
    estimate: float  # largest, the run's own [rad or m]
    status: str
    outcome: str


def run(out_dir: Path, full: bool = False) -> list[Row]:
    """Run all cases; print the table, write stress.csv and stress.png into `out_dir`."""
    chosen = settings(full)
    rows = run_cases(cases(full), chosen)
    host = machine()
    _print(rows, chosen)
    print(host)
    _write(Path(out_dir) / "stress.csv", rows, host)
    _plot(Path(out_dir) / "stress.png", rows, chosen)
    return rows


def settings(full: bool = False) -> list[Setting]:
    """The columns of the table."""
    steps, tolerances = (STEPS_FULL, TOLERANCES_FULL) if full else (STEPS, TOLERANCES)
    fixed = [Setting(integrator, h) for integrator in FIXED for h in steps]
    return fixed + [Setting(integrator, rtol) for integrator in ADAPTIVE for rtol in tolerances]


def run_cases(chosen: Sequence[Case], columns: Sequence[Setting]) -> list[Row]:
    """All that applies; each case in a thread, as the kernels release the interpreter."""
    pool = ThreadPoolExecutor(os.cpu_count())
    try:
        work = pool.map(functools.partial(_run_case, columns=columns), chosen)
        return [row for rows in tqdm(work, total=len(chosen), unit="case") for row in rows]
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def _run_case(case: Case, columns: Sequence[Setting]) -> list[Row]:
    truth = truth_of(case)
    rows = (measured(case, truth, setting) for setting in columns if applies(case, setting))
    return [row for row in rows if row is not None]


def truth_of(case: Case) -> Truth:
    """The extrapolation at two tolerances, until they part."""
    scene = case.scene("extrapolation")
    tight, loose = (case.run(scene, case.duration, GRID, rtol) for rtol in (TIGHT, LESS_TIGHT))
    positions = _positions(tight)
    apart = np.maximum.accumulate(_largest(positions - _positions(loose)))
    sound = (apart <= KNOWN) & (tight["time"] <= min(tight.end_time, loose.end_time) + 1e-9)
    last = int(np.argmin(sound)) - 1 if not sound.all() else len(sound) - 1
    return Truth(last * GRID, float(apart[last]), positions[: last + 1])


def applies(case: Case, setting: Setting) -> bool:
    """Whether the integrator is meant for the scene; a step must fit into the controllers' period."""
    if setting.integrator == "dop853":
        return not case.sampled and case.ground is None
    if setting.integrator == "simtwo" and not case.sampled:
        return False
    whole = case.period / setting.value
    return setting.integrator in ADAPTIVE or not case.sampled or (round(whole) >= 1 and abs(whole - round(whole)) < 1e-9)


def measured(case: Case, truth: Truth, setting: Setting) -> Row | None:
    """Compare a run with the reference; None if that is not known for the length of a step."""
    adaptive = setting.integrator in ADAPTIVE
    scene = case.scene(setting.integrator, *(() if adaptive else (setting.value,)))
    every = max(1, round(scene.tick_steps * scene.timestep / GRID), round(scene.timestep / GRID))
    duration = math.floor(truth.known / (every * GRID) + 1e-9) * every * GRID
    if duration == 0.0:
        return None
    found = case.run(scene, duration, every * GRID, setting.value if adaptive else None, estimate=True)
    error = np.abs(_positions(found) - truth.positions[: round(duration / GRID) + 1 : every])
    error, estimate = _worst(error), _worst(_joined(found.error))
    outcome = classify(found.status, error, estimate)
    return Row(case.name, *setting, duration, truth.uncertainty, error, estimate, found.status, outcome)


def classify(status: str, error: float, estimate: float) -> str:
    """Outcome of a run from its status, its largest error and the estimate of it [rad or m]."""
    if error > WRONG:
        if status != "ok":
            return BY_STATUS
        return BY_ESTIMATE if error <= HONEST * estimate else SILENT
    return HELD if status == "ok" and estimate <= max(WRONG, HONEST * error) else FALSE


def _positions(found: Trajectory) -> np.ndarray:
    return _joined(found.channels)


def _joined(channels: dict[str, np.ndarray]) -> np.ndarray:
    """Position and turn of the base and angles of the joints (records, numbers) [m, rad]."""
    if "base_q" not in channels:
        return channels["q"]
    base = channels["base_q"]
    return np.hstack([base[:, :3], 2.0 * base[:, 3:7], channels["q"]])  # a small turn is twice its quaternion's change


def _largest(x: np.ndarray) -> np.ndarray:
    """Of each record; infinite where it is no number."""
    return np.nan_to_num(np.abs(x), nan=np.inf, posinf=np.inf).max(axis=1)


def _worst(x: np.ndarray) -> float:
    return float(_largest(x).max())


# ---------------------------------------------------------------------------------------------- cases


def cases(full: bool = False) -> list[Case]:
    """The rows of the table; those of one kind run in the same kernels."""
    return [*_passive(10 if full else 3), *_continuous(), *_sampled(), *_boxes(), *_humanoids()]


def _passive(trees: int) -> list[Case]:
    light = np.geomspace(1.0, 1e-4, 5)
    tiny = chain([0.1, 0.1, 3e-4], length=0.02)
    rod = chain([1.0], length=0.5, damping=0.05)
    stop = chain([1.0], length=0.5, damping=0.05, limit=0.5, effort=20.0)
    stops = chain([0.2] * 4, limit=0.3, effort=5.0)
    sticky = chain([0.5] * 3, friction=0.05)
    start = [0.6, -0.4, 0.5, -0.3, 0.4]
    return [
        Case("mass ratio 1e4, light end", chain(light), 1.0, start),
        Case("mass ratio 1e4, heavy end", chain(light[::-1]), 1.0, start),
        Case("link of 1e-8 kg m²", tiny, 1.0, start[:3]),
        Case("link of 1e-8 kg m², damped", with_last_damping(tiny, 1e-4), 1.0, start[:3]),
        Case("chain of 100 links", chain([0.02] * 100, length=0.02), 1.0, np.full(100, 0.02)),
        Case("pendulum hits its stop at 15 rad/s", stop, 1.0, [0.0], [15.0]),
        Case("four joints hit their stops", stops, 0.5, np.zeros(4), [6.0, -6.0, 6.0, -6.0]),
        Case("dry friction, comes to rest", sticky, 1.0, start[:3]),
        Case("kick of 1 N s in 10 ms", rod, 1.0, [0.0], push=kick("link1", 100.0, 0.10, 0.11)),
        Case("spun at 50 rad/s", chain([0.2] * 3), 0.5, start[:3], [50.0, -20.0, 30.0]),
        *(_random_case(seed) for seed in range(trees)),
    ]


def _random_case(seed: int) -> Case:
    model, rng = random_tree(10, seed), np.random.default_rng(1000 + seed)
    n = len(model.joints)
    return Case(f"random tree {seed}", model, 1.0, rng.uniform(-1.0, 1.0, n), rng.normal(size=n))


def _continuous() -> list[Case]:
    law = {"law": "pd", "Kp": 12.97, "Kd": 0.374, "coulomb_friction": 0.0}
    stiff = law | {"Kp": 1297.0, "Kd": 37.4}
    clamped = {"law": "pd_clamped", "torque_limit": 1.5}
    light = chain(np.geomspace(0.3, 3e-5, 5), length=0.06)
    arm = "arm7_spatial"
    small, large = np.full(7, 0.05), np.full(7, 0.5)
    return [
        Case("pd arm", servoed(arm, **law), 0.5, small, servos="standard"),
        Case("pd arm, clamped", servoed(arm, **law | clamped), 0.5, large, servos="standard"),
        Case("pd arm, gains x100", servoed(arm, **stiff), 0.5, small, servos="standard"),
        Case("pd arm, gains x100, clamped", servoed(arm, **stiff | clamped), 0.5, large, servos="standard"),
        Case("pd arm, kick of 0.5 N s", servoed(arm, **law), 0.5, 0.0 * small, None, "standard",
             push=kick("link7", 50.0, 0.1, 0.11)),
        Case("pd on mass ratio 1e4", servoed(light, **law), 0.5, small[:5], servos="standard"),
        Case("pd into a stop", servoed(chain([0.1] * 4, limit=0.3), **law | clamped), 0.5, np.zeros(4),
             [10.0, -8.0, 6.0, -4.0], "standard"),
    ]  # fmt: skip


def _sampled() -> list[Case]:
    tilt, arm = np.full(7, 0.1), "arm7"
    far = np.full(7, 0.3)
    narrow = load_robot(arm)
    narrow = replace(narrow, joints=tuple(replace(joint, lower=-0.05, upper=1.0) for joint in narrow.joints))
    return [
        Case("servo arm", servoed(arm), 0.5, tilt, servos="mipsd"),
        Case("servo arm, gear ratio 1000", servoed(arm, ratio=1000.0), 0.5, tilt, servos="mipsd"),
        Case("servo arm, gear ratio 10", servoed(arm, ratio=10.0), 0.3, tilt, servos="mipsd"),
        Case("servo arm, gains x100", servoed(arm, Kp=6100.0), 0.5, tilt, servos="mipsd"),
        Case("servo arm, backlash 3 deg", servoed(arm, backlash=math.radians(3.0)), 0.5, tilt, servos="mipsd"),
        Case("servo arm, gearbox x1000 as stiff", servoed(arm, stiffness=2.5e4, damping=1.0), 0.5, tilt, servos="mipsd"),
        Case("servo arm, controllers of 50 ms", servoed(arm, period=0.05, lag=0.05), 1.0, tilt, servos="mipsd"),
        Case("servo arm, dry friction", servoed(arm, coulomb_friction=0.1), 0.5, tilt, servos="mipsd"),
        Case("servo arm runs into its stops", servoed(narrow), 0.5, far, -5.0 * np.ones(7), "mipsd"),
        Case("servo arm, kick of 0.5 N s", servoed(arm), 0.5, 0.0 * tilt, None, "mipsd",
             push=kick("link7", 50.0, 0.1, 0.11)),
    ]  # fmt: skip


def _boxes() -> list[Case]:
    slope, ice = Ground(slope=0.3, friction=0.2), Ground(friction=0.0)
    on_slope = [0.0, 0.0, 0.05 / math.cos(0.3), math.cos(0.15), 0.0, -math.sin(0.15), 0.0]
    tilted = tilt_of(0.3)
    return [
        Case("drop from 2 m, flat", box(), 1.0, [0.0, 0.0, 2.05, *UPRIGHT], ground=Ground()),
        Case("drop from 2 m, tilted", box(), 1.0, [0.0, 0.0, 2.05 + 0.04, *tilted], ground=Ground()),
        Case("drop from 2 m, hard ground", box(), 0.8, [0.0, 0.0, 2.05, *UPRIGHT], ground=Ground(sinking=1e-6)),
        Case("50 mm deep in the ground", box(), 0.5, [0.0, 0.0, 0.0, *UPRIGHT], ground=Ground()),
        Case("50 mm deep, tilted", box(), 0.5, [0.0, 0.0, 0.05, *tilted], ground=Ground()),
        Case("box of 1 t", box(1000.0), 0.5, [0.0, 0.0, 0.06, *UPRIGHT], ground=Ground()),
        Case("slides down a slope", box(), 0.5, on_slope, ground=slope),
        Case("on ice, kick of 5 N s", box(), 0.5, [0.0, 0.0, 0.0495, *UPRIGHT], None, None, ice,
             kick("base", 500.0, 0.1, 0.11, 0.02)),
    ]  # fmt: skip


def _humanoids() -> list[Case]:
    robot, ground = load_robot("humanoid"), Ground()
    n = len(robot.moving_joints)
    stands = initial_state(compile_scene(robot, "mipsd", ground, "implicit_euler", 1e-3))[:7]
    torso = robot.links[0].name

    def at(height):
        return [*stands[:2], stands[2] + height, *stands[3:7], *np.zeros(n)]

    still = Push(torso)
    return [
        Case("humanoid stands, kick of 2 N s", robot, 0.5, at(0.0), None, "mipsd", ground, kick(torso, 40.0, 0.1, 0.15)),
        Case("humanoid drops from 2 m", robot, 0.8, at(2.0), None, "mipsd", ground, still),
        Case("humanoid 20 mm deep", robot, 0.3, at(-0.02), None, "mipsd", ground, still),
    ]


def kick(link: str, force: float, start: float, end: float, height: float = 0.0) -> Push:
    """A force along x [N] from `start` to `end` [s], `height` above the link's origin [m]."""
    return Push(link, (force, 0.0, 0.0), point=(0.0, 0.0, height), start=start, end=end)


def tilt_of(angle: float) -> tuple[float, ...]:
    """Quaternion of a turn about an axis on no edge [rad]."""
    return math.cos(angle / 2), 0.96 * math.sin(angle / 2), 0.28 * math.sin(angle / 2), 0.0


def chain(masses, length=0.1, damping=1e-5, friction=0.0, limit=100.0, effort=math.inf) -> Model:
    """Rods of the given masses [kg] that hang on one another, axes along y and x in turn."""
    links, joints = [Link("base", 0.0, (0.0, 0.0, 0.0), (0.0,) * 6)], []
    for k, mass in enumerate(masses, start=1):
        thick, thin = float(mass * length**2 / 12), float(0.05 * mass * length**2 / 12)
        links.append(Link(f"link{k}", float(mass), (0.0, 0.0, -length / 2), (thick, 0.0, 0.0, thick, 0.0, thin)))
        joints.append(
            Joint(
                f"joint{k}", "revolute", links[-2].name, links[-1].name, (0.0, 0.0, -length if k > 1 else 0.0),
                axis=(0.0, 1.0, 0.0) if k % 2 else (1.0, 0.0, 0.0), lower=-limit, upper=limit, effort=effort,
                damping=damping, friction=friction,
            )  # fmt: skip
        )
    return Model(f"chain{len(links) - 1}", tuple(links), tuple(joints))


def with_last_damping(model: Model, damping: float) -> Model:
    """The robot with another damper [N m s/rad] in its last joint."""
    return replace(model, joints=(*model.joints[:-1], replace(model.joints[-1], damping=damping)))


def random_tree(n: int, seed: int) -> Model:
    """A tree of n solid boxes with random parents, axes, joint types and masses of 1e-3 to 1 kg."""
    rng = np.random.default_rng(seed)
    links, joints = [Link("base", 0.0, (0.0, 0.0, 0.0), (0.0,) * 6)], []
    for k in range(1, n + 1):
        mass, sides = 10.0 ** rng.uniform(-3.0, 0.0), rng.uniform(0.02, 0.1, 3)
        a, b, c = (mass / 12 * (sides @ sides - sides**2)).tolist()
        links.append(Link(f"link{k}", float(mass), tuple(rng.uniform(-0.05, 0.05, 3).tolist()), (a, 0.0, 0.0, b, 0.0, c)))
        axis = rng.normal(size=3)
        axis = tuple((axis / np.linalg.norm(axis)).tolist())
        kind = "prismatic" if rng.random() < 0.2 else "revolute"
        parent = f"link{rng.integers(1, k)}" if k > 1 else "base"
        xyz, rpy = (tuple(rng.uniform(-x, x, 3).tolist()) for x in (0.1, math.pi))
        joints.append(Joint(f"joint{k}", kind, parent, f"link{k}", xyz, rpy, axis, -100.0, 100.0, damping=1e-4))
    return Model(f"tree{seed}", tuple(links), tuple(joints))


def servoed(model: Model | str, **changes) -> Model:
    """The robot with AX-12 servos of other settings in all joints."""
    model = load_robot(model) if isinstance(model, str) else model
    return replace(model, servos=dict.fromkeys(model.joint_names, load_servo("ax12", **changes)))


def box(mass: float = 1.0) -> Model:
    """A free box of 0.4 x 0.4 x 0.1 m whose lower corners touch the ground."""
    x, y, z = 0.4, 0.4, 0.1
    inertia = (mass * (y * y + z * z) / 12, 0.0, 0.0, mass * (x * x + z * z) / 12, 0.0, mass * (x * x + y * y) / 12)
    contacts = tuple(ContactPoint("base", (sx * x / 2, sy * y / 2, -z / 2)) for sx in (-1, 1) for sy in (-1, 1))
    return Model("box", (Link("base", mass, (0.0, 0.0, 0.0), inertia),), (), "floating", contacts=contacts)


# ---------------------------------------------------------------------------------------------- output


def _print(rows: list[Row], columns: list[Setting]) -> None:
    pass


def _write(path: Path, rows: list[Row], notes: str) -> None:
    pass


def _plot(path: Path, rows: list[Row], columns: list[Setting]) -> None:
    pass
