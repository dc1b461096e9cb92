"""Stiff servos: what holds still at which step, and what it costs.

Table 1 is the experiment of Lima et al. 2013, Figs. 7-10: a seven-joint arm holds the vertical for 20 s; variance of
the lowest joint over the last 10 s, for each gearbox, integrator and step.  Table 2 is the same arm in space with the
continuous servo tau = clip(-12.97 q - 0.374 dq/dt, +-1.5 N m), without rotor inertia: error after 0.5 s from 0.05 rad,
and whether it settles from 0.5 rad, where the torque is clipped at first.  One that settles may have chattered before:
its status tells of the worst of all steps.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..base.files import complete
from ..robot_file import load_robot, load_servo
from ..run.reference import Reference
from ..run.simulate import initial_state, simulate
from ..run.trajectory import Trajectory
from ..scene.compile import CompiledScene, GearboxKind, compile_scene
from ..view.style import look
from .machine import machine
from .table import write_table

SERVOS: tuple[GearboxKind, ...] = ("standard", "rotor", "mipsd")
INTEGRATORS = ("implicit_euler", "midpoint", "simtwo")
ARM_STEPS = (1e-3, 5e-3, 1e-2)
PD_STEPS = (1e-4, 1e-3, 5e-3, 1e-2, 2e-2, 5e-2, 1e-1)
SETTLED = 1e-2  # rms joint speed in the last second [rad/s]
APART = 1.5  # times the error before, of points that are labeled


class ArmRow(NamedTuple):
    """One line of table 1."""

    servos: str
    integrator: str
    step: float  # [s]
    variance: float  # of the lowest joint [deg^2]
    status: str
    cost: float  # CPU time per simulated second [ms]


class PdRow(NamedTuple):
    """One line of table 2."""

    integrator: str
    step: float  # [s]
    error: float  # largest joint error at 0.5 s from 0.05 rad [rad]
    cost: float  # CPU time per simulated second [ms]
    settles: str  # from 0.5 rad within 4 s, and the status of the whole run where it is not ok


def run(out_dir: Path, full: bool = False) -> tuple[list[ArmRow], list[PdRow]]:
    """Print both tables; write servo_arm.csv, servo_pd.csv and servo.png into `out_dir`."""
    repeats = 9 if full else 3
    arm = [
        arm_row(servos, integrator, h, repeats) for servos in SERVOS for integrator in INTEGRATORS for h in ARM_STEPS
    ]
    pd = pd_rows(repeats)
    print(f"{'gearbox':9} {'integrator':15} {'step':>7} {'variance':>12} {'status':>10} {'cost':>9}")
    print(f"{'':9} {'':15} {'[ms]':>7} {'[deg^2]':>12} {'':>10} {'[ms/s]':>9}")
    for row in arm:
        print(
            f"{row.servos:9} {row.integrator:15} {row.step * 1e3:7.3g} {row.variance:12.3g} {row.status:>10} "
            f"{row.cost:9.3g}"
        )
    print(f"\n{'integrator':15} {'step':>7} {'error':>9} {'cost':>9}  from 0.5 rad")
    print(f"{'':15} {'[ms]':>7} {'[rad]':>9} {'[ms/s]':>9}")
    for r in pd:
        print(f"{r.integrator:15} {r.step * 1e3:7.3g} {r.error:9.2g} {r.cost:9.3g}  {r.settles}")
    out_dir = Path(out_dir)
    write_table(out_dir / "servo_arm.csv", ArmRow._fields, arm, machine())
    write_table(out_dir / "servo_pd.csv", PdRow._fields, pd, machine())
    _plot(out_dir / "servo.png", arm, pd)
    return arm, pd


def arm_row(gearbox: GearboxKind, integrator: str, h: float, repeats: int) -> ArmRow:
    """Hold the planar arm upright from a tilt of 0.01 rad a joint."""
    scene = compile_scene(load_robot("arm7"), gearbox=gearbox, integrator=integrator, timestep=h)
    state, still = initial_state(scene, np.full(7, 0.01)), Reference([0.0], np.zeros((1, 7)))
    trajectory, cost = _timed(scene, 20.0, state, still, repeats)
    angle = np.degrees(trajectory["q"][:, 0])
    variance = float("nan") if trajectory.status == "diverged" else float(angle[len(angle) // 2 :].var())
    return ArmRow(gearbox, integrator, h, variance, trajectory.status, cost)


def pd_rows(repeats: int) -> list[PdRow]:
    """Errors against RK4 at 10 us, whose own is below 1e-12."""
    arm = load_robot("arm7_spatial")
    law: dict[str, Any] = {"law": "pd_clamped", "Kp": 12.97, "Kd": 0.374, "torque_limit": 1.5}
    servo = load_servo("ax12", **law, viscous_friction=0.0, coulomb_friction=0.0)
    model = replace(arm, servos=dict.fromkeys(arm.joint_names, servo))
    still = Reference([0.0], np.zeros((1, 7)))

    def last(integrator: str, h: float, q0: float, duration: float, repeats: int = 1) -> tuple[Trajectory, float]:
        scene = compile_scene(model, gearbox="standard", integrator=integrator, timestep=h)
        return _timed(scene, duration, initial_state(scene, np.full(7, q0)), still, repeats)

    exact = last("rk4", 1e-5, 0.05, 0.5)[0]["q"][-1]
    rows = []
    for integrator in ("implicit_euler", "midpoint"):
        for h in PD_STEPS:
            trajectory, cost = last(integrator, h, 0.05, 0.5, repeats)
            clipped = last(integrator, h, 0.5, 4.0)[0]
            moving = np.sqrt((clipped["qd"][-len(clipped["qd"]) // 4 :] ** 2).mean()) > SETTLED
            settles = ("moves on" if moving else "settles") + ("" if clipped.ok else f" ({clipped.status})")
            rows.append(PdRow(integrator, h, float(np.abs(trajectory["q"][-1] - exact).max()), cost, settles))
    return rows


def _timed(
    scene: CompiledScene, duration: float, state: np.ndarray, reference: Reference, repeats: int
) -> tuple[Trajectory, float]:
    """The trajectory, and the least CPU time of some runs per simulated second [ms]."""
    trajectory = simulate(scene, duration, state, reference, estimate_error=False)
    times = []
    for _ in range(repeats):
        start = time.process_time()
        simulate(scene, duration, state, reference, estimate_error=False)
        times.append(time.process_time() - start)
    return trajectory, 1e3 * min(times) / duration


@look()
def _plot(path: Path, arm: list[ArmRow], pd: list[PdRow]) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.ticker import LogLocator

    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.2), layout="constrained")
    for servos, marker in (("standard", "o"), ("rotor", "s"), ("mipsd", "^")):
        for integrator, color in zip(INTEGRATORS, ("C0", "C1", "C3")):
            rows = [r for r in arm if (r.servos, r.integrator) == (servos, integrator) and r.variance > 0]
            steps = [1e3 * r.step for r in rows]
            left.loglog(steps, [r.variance for r in rows], marker=marker, color=color)
    left.legend(
        [plt.Line2D([], [], color=c) for c in ("C0", "C1", "C3")]
        + [plt.Line2D([], [], color="0.3", marker=m, linestyle="") for m in "os^"],
        [*INTEGRATORS, "standard", "rotor", "mipsd"],
        fontsize=8,
        loc="center",
        bbox_to_anchor=(0.73, 0.72),
        ncols=2,
    )
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
    right.set(
        xlabel="largest joint error after 0.5 s [rad]",
        ylabel="CPU time per simulated second [ms]",
        title="Stiff PD servos, no rotor inertia",
    )
    right.legend()
    with complete(path) as temporary:
        figure.savefig(temporary, dpi=130)
    plt.close(figure)
