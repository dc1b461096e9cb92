"""Measure how fast `judge` is, where its time goes, and what half the step changes.

A biped with 14 servos XL330 (`little_biped.py`) walks by a network of 96 neurons.  The humanoid with elastic gears
walks by its optimized gait.  Both walk in the default worlds.  Times are those of the runs, without compiling and
without the second runs at half the step.  Shares are CPU time of one thread by Python's profiler: the policy;
observations and measurements; worlds, which are compiled one by one; steps, in Python and in the kernel.  Of the
kernel, servos and contact are what a step of eight robots without stops has more instructions with servos than
without, and standing than in free fall; the rest is the tree, its state and energies.

    featherstone-gait benchmark judge        two minutes
"""

from __future__ import annotations

import cProfile
import math
import pstats
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np

from ..judge import Judgment, Policy, judge, load_policy
from ..judge.meter import Meter
from ..judge.observation import Observer
from ..judge.run import HARD, scene_of
from ..model import Ground, Model
from ..robot_file import load_robot
from ..robot_file.source import robots_folder
from ..run.session import Session
from ..run.simulate import standing_state
from ..run.worlds import Worlds
from ..scene.compile import CompiledScene
from .little_biped import NETWORK, little_biped
from .skip import executed, rollout
from .table import installed, machine, tabulate

WORLDS, SECONDS, REPEATS, REPEATS_FULL = 64, 10.0, 3, 15
KERNEL = "featherstone_gait.core.integrate.rollout.rollout_lanes"
PARTS = {
    "policy_share": (Policy.actions,),
    "observed": (Observer.look, Observer.sample, Meter.take),
    "prepared": (Session.__init__, standing_state),
    "steps": (Session.step,),
}


class Row(NamedTuple):
    """One line of the table."""

    robot: Annotated[str, "robot", "<12"]
    policy: str
    worlds: Annotated[int, "worlds", "6"]
    walks: Annotated[float, "walks", "6.0%"]
    real_time: Annotated[float, "real time", "9.0f"]  # simulated time of all worlds by that of the clock
    policy_share: Annotated[float, "policy", "6.0%"]  # shares of CPU time
    observed: Annotated[float, "observed", "8.0%"]
    prepared: Annotated[float, "worlds", "6.0%"]
    steps: Annotated[float, "steps", "6.0%"]  # in Python
    kernel: Annotated[float, "kernel", "6.0%"]
    servos: Annotated[float, "servos", "6.0%"]  # of the kernel
    contact: Annotated[float, "contact", "7.0%"]
    same: Annotated[float, "same", "5.0%"]  # share of verdicts that half the step keeps
    speed_error: Annotated[float, "speed", "6.1%"]  # median difference at half the step, of worlds that walk both times
    energy_error: Annotated[float, "J/m", "6.1%"]


def run(out_dir: Path, full: bool = False) -> list[Row]:
    """Print the table; write judge.csv into `out_dir`; `full` repeats more often."""
    repeats, host = REPEATS_FULL if full else REPEATS, machine()
    print(host)
    humanoid = load_robot("humanoid", locked="simplified")
    cases: list[tuple[Any, Model, Any]] = [(robots_folder() / "humanoid" / "optimized_gait.npz", humanoid, None)]
    if installed("onnx") and installed("onnxruntime"):
        cases.insert(0, (NETWORK, little_biped(), NETWORK.with_suffix(".toml")))
    else:
        print("no ONNX: install it with pip install featherstone-gait[policy]")
    rows = (measured(load_policy(policy, model, said), model, repeats) for policy, model, said in cases)
    return tabulate(out_dir / "judge.csv", Row, rows, host)


def measured(
    policy: Policy, model: Model, repeats: int, command: tuple[float, float, float] = (0.1, 0.0, 0.0),
    worlds: int = WORLDS, seconds: float = SECONDS,
) -> Row:  # fmt: skip
    """Measure one policy on one robot; the median of some runs, of which the first compiles."""

    def judged(scene: CompiledScene, **how: Any) -> Judgment:
        return judge(policy, scene, worlds, seconds, command, again=0, **how)

    scene = scene_of(model)
    record = judged(scene)
    simulated = float(record.worlds["time"].sum())
    real_time = simulated / float(np.median([judged(scene).seconds["runs"] for _ in range(repeats)]))
    finer = judged(scene.recompiled(timestep=0.5 * scene.timestep))
    both = (record.verdicts == "walks") & (finer.verdicts == "walks")
    errors = (_difference(record.worlds[name][both], finer.worlds[name][both]) for name in ("speed", "energy_per_way"))
    shares = _shares(lambda: judged(scene, threads=1))
    same = float((record.verdicts == finer.verdicts).mean())
    walks, (servos, contact), (speed, energy) = record.walking / worlds, _of_a_step(scene), errors
    return Row(
        model.name, record.policy, worlds, walks, real_time, **shares, servos=servos, contact=contact, same=same,
        speed_error=speed, energy_error=energy,
    )  # fmt: skip


def _difference(values: np.ndarray, finer: np.ndarray) -> float:
    """Return the median relative difference, NaN of none."""
    return float(np.median(np.abs(values / finer - 1.0))) if len(values) else math.nan


def _shares(call: Callable[[], object]) -> dict[str, float]:
    """Return the shares of CPU time of `PARTS`, steps without their kernel, and of the kernel."""
    profile = cProfile.Profile(time.process_time)
    profile.runcall(call)
    found: dict[Any, Any] = pstats.Stats(profile).stats  # type: ignore[attr-defined]
    kernel = sum(value[3] for (_, _, name), value in found.items() if KERNEL in name)
    codes = {part: [one.__code__ for one in functions] for part, functions in PARTS.items()}
    spent = {
        part: sum(found[code.co_filename, code.co_firstlineno, code.co_name][3] for code in own)
        for part, own in codes.items()
    }
    spent |= {"steps": spent["steps"] - kernel, "kernel": kernel}
    whole = max(value[3] for value in found.values())
    return {part: of_it / whole for part, of_it in spent.items()}


def _of_a_step(scene: CompiledScene) -> tuple[float, float]:
    """Return the shares of servos and contact in the instructions of a step of eight robots; NaN if not counted."""
    free = tuple(replace(joint, lower=-math.inf, upper=math.inf) for joint in scene.model.joints)
    model, gearbox, ground = replace(scene.model, joints=free), scene.gearbox, Ground(penetration=HARD)
    how: dict[str, Any] = {"integrator": "midpoint", "record": ("base_q",), "worlds": Worlds(8)}
    bare = executed(rollout(replace(model, servos={}), None, ground, lifted=10.0, **how))
    falling, standing = (executed(rollout(model, gearbox, ground, lifted=z, **how)) for z in (10.0, 0.0))
    return (falling - bare) / standing, (standing - falling) / standing
