"""Numerical stability under stress, and whether a run that is wrong says so.

Each case runs with each integrator and each step; `extrapolation` at a tolerance of 1e-9 tells the truth, as long as
it agrees with itself at 1e-8 to 1e-5 (rad or m): where motion is chaotic the comparison ends there.  A run is

    held      its positions are within 1e-3 of the truth, or within ten times its own error estimate, status ok
    flagged   they are not, or the truth is not known to the end, and its status says so
    silent    they are not, and its status is ok
    alarm     its status is not ok although they are within 1e-3 to the end

Silent runs should be none, alarms at most one in twenty.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from tqdm import tqdm

from ..base.files import complete
from ..core.integrate import INTEGRATORS
from ..model import ContactPoint, Ground, Joint, Link, Model, Spring
from ..robot_file import load_robot, load_servo
from ..run.reference import Reference
from ..run.simulate import Push, initial_state, simulate
from ..run.trajectory import Trajectory, positions
from ..scene.compile import compile_scene
from ..view.style import look
from .machine import machine
from .precision import unlimited
from .speed import chain
from .table import write_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WRONG = 1e-3  # error that counts [rad or m]
COVERED = 10.0  # times the run's own estimate that it may reach
AGREED = 1e-5  # of the reference at two tolerances [rad or m]
COLOURS = {"held": "#0072B2", "flagged": "#56B4E9", "silent": "#D55E00", "alarm": "#E69F00", "": "white"}


class Case(NamedTuple):
    """Something that may go wrong."""

    name: str
    model: Model
    arguments: dict  # of `compile_scene`
    duration: float  # [s]
    steps: tuple[float, ...]  # [s]
    integrators: tuple[str, ...]
    angle: float = 0.0  # of all joints at the start [rad]
    base: tuple = ()  # position and quaternion of a floating base, then its velocity
    pushes: tuple[Push, ...] = ()

    @property
    def sample(self) -> float:
        """Between records [s]: a whole number of each step."""
        return 1e-4 * math.lcm(*(round(1e4 * step) for step in self.steps))

    def run(self, integrator: str, step: float, **how: Any) -> Trajectory:
        scene = compile_scene(self.model, integrator=integrator, timestep=step, **self.arguments)
        n = scene.tree.n
        q, qd = [*self.base[:7], *[self.angle] * n], [*self.base[7:], *[0.0] * n]
        state = initial_state(scene, q, qd, allow_limit_violation=True)
        still = Reference([0.0], np.zeros((1, n))) if scene.gearbox else None
        record = ("base_q", "q") if self.base else ("q",)
        return simulate(scene, self.duration, state, still, record=record, pushes=self.pushes, **how)


class Row(NamedTuple):
    """One line of the table."""

    case: str
    integrator: str
    step: float  # [s], NaN with error control
    verdict: str
    status: str
    error: float  # largest before `until` [rad or m]
    estimate: float  # the run's own
    until: float  # time up to which the truth is known [s]


def run(out_dir: Path, full: bool = False) -> list[Row]:
    """Print the table; write stress.csv and stress.png into `out_dir`; `full` adds steps of 0.2, 2 and 20 ms."""
    host, rows = machine(), []
    print(host)
    head = ("case", "integrator", "step ms", "verdict", "status", "error", "estimate", "until s")
    print("{:34}{:15}{:>8}  {:9}{:15}{:>9}{:>10}{:>9}".format(*head))
    for case in tqdm(cases(full), desc="cases", leave=False, disable=None):
        for row in judged(case):
            rows.append(row)
            print(
                f"{row.case:34}{row.integrator:15}{1e3 * row.step:8.3g}  {row.verdict:9}{row.status:15}{row.error:9.1e}"
                f"{row.estimate:10.1e}{row.until:9.3g}"
            )
    counts = Counter(row.verdict for row in rows)
    right = counts["held"] + counts["alarm"]
    print(f"{len(rows)} runs: {', '.join(f'{counts[v]} {v}' for v in ('held', 'flagged', 'silent', 'alarm'))}; "
          f"false alarms {counts['alarm'] / max(right, 1):.1%} of the {right} runs that are right")  # fmt: skip
    out_dir = Path(out_dir)
    write_table(out_dir / "stress.csv", Row._fields, rows, host)
    with complete(out_dir / "stress.png") as temporary:
        plot(rows, host).savefig(temporary, dpi=130)
    return rows


def judged(case: Case) -> list[Row]:
    """Rows of a case."""
    truth, other = (case.run("extrapolation", 1e-3, record_interval=case.sample, rtol=rtol) for rtol in (1e-9, 1e-8))
    exact = positions(truth)
    apart = np.abs(exact - positions(other)).max(axis=1) > AGREED
    ended = truth["time"] > min(truth.end_time, other.end_time) + 1e-9
    known = int(np.argmax(apart | ended)) if (apart | ended).any() else len(exact)
    rows = []
    for integrator in case.integrators:
        for step in (math.nan,) if INTEGRATORS[integrator].adaptive else case.steps:
            run = case.run(integrator, 1e-3 if math.isnan(step) else step, record_interval=case.sample)
            error = float(np.abs(positions(run) - exact)[:known].max(initial=0.0))
            told = [values[:known].max(initial=0.0) for values in (run.error or {}).values()]
            estimate = float(max(told, default=math.nan))
            right = error <= WRONG or (run.ok and error <= COVERED * estimate)
            false = error <= WRONG and known == len(exact)
            verdict = ("held" if right else "silent") if run.ok else ("alarm" if false else "flagged")
            rows.append(
                Row(case.name, integrator, step, verdict, run.status, error, estimate, float(truth["time"][known - 1]))
            )
    return rows


# ---------------------------------------------------------------------------------------------- cases


def cases(full: bool = False) -> list[Case]:
    """All of them."""
    more = (2e-4, 2e-3, 2e-2) if full else ()
    return [*_chains(more), *_stiff_arms(more), *_servos(), *_contacts(), _stop(more), _spin(), *_joints()]


def _chains(more: Iterable[float]) -> list[Case]:
    """Seven links and a hundred, let go: masses, inertias and lengths at their extremes."""
    arm = unlimited(load_robot("arm7_spatial"))
    smooth = ("implicit_euler", "midpoint", "rk4", "dop853", "extrapolation", "ars343")
    steps = tuple(sorted((1e-3, 1e-2, *more)))
    heavy, light = _scaled(arm, 7, 1e4), _scaled(arm, 1, 1e4)
    links = [*arm.links[:-1], replace(arm.links[-1], mass=1e-3, inertia=(1e-8, 0.0, 0.0, 1e-8, 0.0, 1e-8))]
    return [
        Case("tip 10 000 times as heavy", heavy, {}, 0.3, steps, smooth, 0.5),
        Case("root 10 000 times as heavy", light, {}, 0.3, steps, smooth, 0.5),
        Case("last link of 1e-8 kg m^2", replace(arm, links=tuple(links)), {}, 0.3, steps, smooth, 0.5),
        Case("hundred links", chain(100), {}, 0.2, steps, smooth, 0.05),
    ]


def _scaled(model: Model, k: int, factor: float) -> Model:
    """The k-th link with so many times its mass and inertia."""
    link = model.links[k]
    heavier = replace(link, mass=factor * link.mass, inertia=tuple(factor * value for value in link.inertia))
    return replace(model, links=(*model.links[:k], heavier, *model.links[k + 1 :]))


def _stiff_arms(more: Iterable[float]) -> list[Case]:
    """Continuous servos without rotor inertia; gains times 1 and 100; clipped or not."""
    integrators = ("implicit_euler", "midpoint", "rk4", "dop853", "extrapolation", "ars343")
    steps = tuple(sorted((1e-3, 1e-2, 5e-2, *more)))
    found = []
    for gain in (1.0, 100.0):
        for angle in (0.05, 0.5):
            arm = unlimited(load_robot("arm7_spatial"))
            law: dict[str, Any] = {"Kp": 12.97 * gain, "Kd": 0.374 * gain, "torque_limit": 1.5 * gain}
            servo = load_servo("ax12", law="pd_clamped", **law, viscous_friction=0.0, coulomb_friction=0.0)
            arm = replace(arm, servos=dict.fromkeys(arm.joint_names, servo))
            name = f"gains times {gain:g}, from {angle:g} rad"
            found.append(Case(name, arm, {"gearbox": "standard"}, 0.5, steps, integrators, angle))
    return found


def _servos() -> list[Case]:
    """The sampled servo chain at the AX-12's gear ratio and at 1000, with and without backlash."""
    found = []
    for ratio, servos, backlash in ((254, "standard", 0), (1000, "standard", 0), (254, "mipsd", 0), (1000, "mipsd", 0),
                                    (254, "mipsd", 1)):  # fmt: skip
        arm = unlimited(load_robot("arm7"))
        servo = load_servo("ax12")
        gearbox = replace(servo.gearbox, ratio=float(ratio), backlash=math.radians(backlash))
        gain = replace(servo.controller, Kp=servo.controller.Kp * 254 / ratio)
        servo = replace(servo, gearbox=gearbox, controller=gain)
        arm = replace(arm, servos=dict.fromkeys(arm.joint_names, servo))
        name = f"{servos}, gear {ratio}" + (f", backlash {backlash} deg" if backlash else "")
        integrators = ("simtwo", "implicit_euler", "midpoint", "extrapolation", "ars343")
        found.append(Case(name, arm, {"gearbox": servos}, 0.2, (1e-3, 1e-2), integrators, 0.02))
    return found


def _contacts() -> list[Case]:
    """A box of 1 kg: sunk in by 2 cm, dropped from 2 m, kicked; the ground gives way by 1 mm under its weight."""
    scene = {"ground": Ground(friction=0.6), "fall_height": -1e6, "fall_tilt": math.pi}
    integrators, turn = ("implicit_euler", "midpoint", "rk4", "extrapolation", "ars343"), (1.0, 0.02, 0.01, 0.0)
    kick = (Push("box", (0.0, 0.0, 0.0), start=9.0), Push("box", (200.0, 30.0, 0.0), start=0.05, end=0.06))

    def case(name: str, height: float, duration: float, pushes: tuple[Push, ...] = kick[:1]) -> Case:
        base = (0.0, 0.0, height, *turn, *[0.0] * 6)
        return Case(name, _box(), scene, duration, (1e-3, 1e-2), integrators, 0.0, base, pushes)

    return [
        case("box sunk in by 2 cm", 0.03, 0.2),
        case("box dropped from 2 m", 2.05, 0.8),
        case("box kicked", 0.05, 0.3, kick[1:]),
    ]


def _box() -> Model:
    inertia = (0.0142, 0.0, 0.0, 0.0142, 0.0, 0.0267)
    corners = tuple(ContactPoint("box", (x, y, -0.05)) for x in (-0.2, 0.2) for y in (-0.2, 0.2))
    return Model("box", (Link("box", 1.0, (0.0,) * 3, inertia),), (), "floating", contacts=corners)


def _stop(more: Iterable[float]) -> Case:
    """A rod that runs into its stop at speed."""
    integrators = ("implicit_euler", "midpoint", "rk4", "dop853", "extrapolation", "ars343")
    return Case("rod runs into its stop", _rod(), {}, 0.8, tuple(sorted((1e-3, 1e-2, *more))), integrators, 1.5)


def _rod() -> Model:
    rod = Link("rod", 1.0, (0.0, 0.0, -0.25), (0.0208, 0.0, 0.0, 0.0208, 0.0, 0.0002))
    joint = Joint("hinge", "revolute", "base", "rod", axis=(0.0, 1.0, 0.0), lower=-0.2, upper=2.0, effort=20.0)
    return Model("rod", (Link("base", 0.0, (0.0,) * 3, (0.0,) * 6), rod), (joint,))


def _spin() -> Case:
    """The box at 50 rad/s about no principal axis, high over a ground without weight."""
    scene = {"ground": Ground(), "gravity": (0.0, 0.0, -1e-9), "fall_height": -1e6, "fall_tilt": 2.0 * math.pi}
    base = (0.0, 0.0, 100.0, 1.0, *[0.0] * 3, *[0.0] * 3, 30.0, 0.0, 40.0)
    integrators = ("implicit_euler", "midpoint", "rk4", "extrapolation", "ars343")
    return Case("box at 50 rad/s", _box(), scene, 1.0, (1e-3, 1e-2), integrators, 0.0, base)


def _joints() -> list[Case]:
    """A rod: on friction that holds it, and on a spring of 1e5 N/m to the wall."""
    integrators = ("implicit_euler", "midpoint", "rk4", "extrapolation", "ars343")
    rod = replace(_rod(), joints=(replace(_rod().joints[0], friction=10.0, lower=-math.inf, upper=math.inf),))
    tie = Spring("base", "rod", (0.3, 0.0, -0.5), (0.0, 0.0, -0.5), 1e5, 10.0, 0.3)
    return [
        Case("rod on stiff friction", rod, {}, 0.5, (1e-3, 1e-2), integrators, 1.5),
        Case("rod on a stiff spring", _rod(), {"springs": (tie,)}, 0.3, (2e-4, 1e-3), integrators, 0.1),
    ]


# ---------------------------------------------------------------------------------------------- picture


@look()
def plot(rows: list[Row], notes: str = "") -> Figure:
    """A cell a run: cases down, integrators and steps across."""
    from matplotlib.colors import ListedColormap
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    names = list(dict.fromkeys(row.case for row in rows))
    columns = sorted({(INTEGRATORS[row.integrator].adaptive, row.integrator, row.step) for row in rows}, key=str)
    kinds = list(COLOURS)
    cells = np.full((len(names), len(columns)), kinds.index(""))
    for row in rows:
        column = next(k for k, c in enumerate(columns) if str(c[1:]) == str((row.integrator, row.step)))
        cells[names.index(row.case), column] = kinds.index(row.verdict)
    figure = Figure(figsize=(11.0, 1.8 + 0.33 * len(names)), layout="constrained")
    axes = figure.subplots()
    axes.pcolormesh(cells, cmap=ListedColormap(list(COLOURS.values())), vmin=-0.5, vmax=len(kinds) - 0.5,
                    edgecolors="white", linewidth=1.5)  # fmt: skip
    labels = [name if math.isnan(step) else f"{name}\n{1e3 * step:g} ms" for _, name, step in columns]
    axes.set_xticks(np.arange(len(columns)) + 0.5, labels, rotation=90, fontsize=8)
    axes.set_yticks(np.arange(len(names)) + 0.5, names, fontsize=9)
    axes.invert_yaxis()
    figure.legend(
        handles=[Patch(facecolor=color, edgecolor="0.8", label=kind or "not run") for kind, color in COLOURS.items()],
        loc="outside upper right", ncols=5,
    )  # fmt: skip
    figure.suptitle(notes, fontsize=7, x=0.01, ha="left")
    return figure
