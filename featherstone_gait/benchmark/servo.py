"""Find which step holds stiff servos still, and what it costs.

Table 1 is the experiment of Lima et al. 2013, Figs. 7-10: a seven-joint arm holds the vertical for 20 s; variance of
the lowest joint over the last 10 s, for each gearbox, integrator and step.  Table 2 is the same arm in space with the
continuous servo tau = clip(-12.97 q - 0.374 dq/dt, +-1.5 N m), without rotor inertia: error after 0.5 s from 0.05 rad,
and whether it settles from 0.5 rad, where the torque is clipped at first.  An arm that settles may have chattered
before: the status is that of the worst of all steps.

    featherstone-gait benchmark servo        one minute
"""

from __future__ import annotations

import math
import time
from functools import partial
from itertools import product
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np

from ..robot_file import load_robot
from ..run.reference import Reference
from ..run.simulate import initial_state, simulate
from ..scene.compile import GearboxKind, compile_scene
from ..view.style import look, subplots
from .precision import measure
from .scenes import stiff_arm
from .table import in_turn, machine, save_figure, tabulate

GEARBOXES: tuple[GearboxKind, ...] = ("standard", "rotor", "mipsd")
INTEGRATORS = ("implicit_euler", "midpoint", "simtwo")
ARM_STEPS = (1e-3, 5e-3, 1e-2)
PD_STEPS = (1e-4, 1e-3, 5e-3, 1e-2, 2e-2, 5e-2, 1e-1)
SETTLED = 1e-2  # rms joint speed in the last second [rad/s]
APART = 1.5  # times the error before, of points that are labeled


class ArmRow(NamedTuple):
    """One line of table 1."""

    gearbox: Annotated[str, "gearbox", "<9"]
    integrator: Annotated[str, "integrator", "<15"]
    step: Annotated[float, "step [s]", "8g"]  # [s]
    variance: Annotated[float, "[deg^2]", "9.3g"]  # of the lowest joint [deg^2]
    status: Annotated[str, "status", "<8"]
    cost: Annotated[float, "[ms/s]", "7.3g"]  # CPU time per simulated second [ms]


class PdRow(NamedTuple):
    """One line of table 2."""

    integrator: Annotated[str, "integrator", "<15"]
    step: Annotated[float, "step [s]", "8g"]  # [s]
    error: Annotated[float, "[rad]", "8.1e"]  # largest joint error at 0.5 s from 0.05 rad [rad]
    cost: Annotated[float, "[ms/s]", "7.3g"]  # CPU time per simulated second [ms]
    settles: Annotated[
        str, "from 0.5 rad", "<12"
    ]  # from 0.5 rad within 4 s, and the status of the whole run where it is not ok


def run(out_dir: Path, full: bool = False) -> tuple[list[ArmRow], list[PdRow]]:
    """Print both tables; write servo_arm.csv, servo_pd.csv and servo.png into `out_dir`."""
    host, repeats = machine(), 9 if full else 3
    arms = (arm_row(*each, repeats) for each in product(GEARBOXES, INTEGRATORS, ARM_STEPS))
    arm = tabulate(out_dir / "servo_arm.csv", ArmRow, arms, host)
    settings = [*product(INTEGRATORS[:2], PD_STEPS)]
    measured = measure(stiff_arm("standard"), repeats, settings)
    pds = (
        PdRow(row.integrator, row.step, row.angle, row.call, _settling(row.integrator, row.step)) for row in measured
    )
    pd = tabulate(out_dir / "servo_pd.csv", PdRow, pds, host)
    _plot(out_dir / "servo.png", arm, pd)
    return arm, pd


def arm_row(gearbox: GearboxKind, integrator: str, h: float, repeats: int) -> ArmRow:
    """Hold the planar arm upright from a tilt of 0.01 rad a joint."""
    scene = compile_scene(load_robot("arm7"), gearbox, integrator=integrator, timestep=h)
    state, still = initial_state(scene, np.full(7, 0.01)), Reference([0.0], np.zeros((1, 7)))
    hold = partial(simulate, scene, 20.0, state, still, estimate_error=False)
    trajectory, seconds = hold(), in_turn([hold], repeats, time.process_time).min()
    angle = np.degrees(trajectory["q"][:, 0])
    variance = math.nan if trajectory.status == "diverged" else float(angle[len(angle) // 2 :].var())
    return ArmRow(gearbox, integrator, h, variance, trajectory.status, 1e3 * float(seconds) / 20.0)


def settles(integrator: str, h: float) -> tuple[bool, str]:
    """Return whether the arm with stiff servos still moves four seconds after 0.5 rad, and the run's status."""
    case = stiff_arm("standard", 0.5)
    run_ = simulate(case.by(integrator, h), 4.0, case.state, case.reference, estimate_error=False)
    return bool(np.sqrt((run_["qd"][-len(run_["qd"]) // 4 :] ** 2).mean()) > SETTLED), run_.status


def _settling(integrator: str, h: float) -> str:
    moves, status = settles(integrator, h)
    return ("moves on" if moves else "settles") + ("" if status == "ok" else f" ({status})")


@look()
def _plot(path: Path, arm: list[ArmRow], pd: list[PdRow]) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.ticker import LogLocator

    figure, (left, right) = subplots(11, 4.2, 1, 2)
    for gearbox, marker in zip(GEARBOXES, "os^"):
        for integrator, color in zip(INTEGRATORS, ("C0", "C1", "C3")):
            rows = [r for r in arm if (r.gearbox, r.integrator) == (gearbox, integrator) and r.variance > 0]
            steps = [1e3 * r.step for r in rows]
            left.loglog(steps, [r.variance for r in rows], marker=marker, color=color)
    handles = [Line2D([], [], color=c) for c in ("C0", "C1", "C3")]
    handles += [Line2D([], [], color="0.3", marker=m, linestyle="") for m in "os^"]
    left.legend(handles, [*INTEGRATORS, *GEARBOXES], fontsize=8, loc="center", bbox_to_anchor=(0.73, 0.72), ncols=2)
    left.axhline(0.5, color="0.6", linestyle=":")
    left.annotate("chatter", (10.0, 0.5), fontsize=8, ha="right", va="bottom", color="0.4")
    left.set_xticks([1, 5, 10], ["1", "5", "10"])
    left.minorticks_off()
    left.set(xlabel="step [ms]", ylabel="variance of the lowest joint [deg²]", title="Holding the 7-joint arm upright")
    for integrator, color, at, sides in zip(INTEGRATORS, ("C0", "C1"), ((4, 4), (-4, -4)), ("left", "right")):
        line = [r for r in pd if r.integrator == integrator]
        right.loglog([r.error for r in line], [r.cost for r in line], "o-", color=color, label=integrator)
        for before, r in zip([None, *line], line):
            if before is None or r.error > APART * before.error:
                right.annotate(
                    f"{1e3 * r.step:g} ms", (r.error, r.cost), xytext=at, textcoords="offset points", fontsize=7,
                    color=color, ha=sides, va="bottom" if at[1] > 0 else "top",
                )  # fmt: skip
    right.margins(x=0.12)
    right.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    right.yaxis.set_major_formatter("{x:g}")
    right.yaxis.set_minor_formatter("")
    right.set(xlabel="largest joint error after 0.5 s [rad]", ylabel="CPU time per simulated second [ms]")
    right.set_title("Stiff PD servos, no rotor inertia")
    right.legend()
    save_figure(figure, path)
