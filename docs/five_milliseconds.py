"""Measure how wrong policies are at a step of 5 ms: `python docs/five_milliseconds.py MICRODUCK PLAYGROUND`.

The folders are those of `docs/judged.py`.  Each policy walks in the same drawn worlds in MuJoCo and here, at steps of
5 ms and less; each run is compared, world by world, with that of the same engine at 0.1 ms.  Servos with a period have
one of 1 ms, or the step where that is longer.  Microduck walks on harder floors too, and of the Go1, whose energies
differ most, one thing at a time is changed.  Writes policy_steps.csv and policy_causes.csv of docs/reproduction in
twenty-five minutes.

Time is CPU time: here of the whole loop (sensors, network, servos, contact), for each of eight robots in a vector, as
the difference of a long and a short run; in MuJoCo of `mj_step` alone where the robot stands, without servos, network
and Python.
"""

from __future__ import annotations

import sys
import time
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from judged import PRESET, published, with_servo

from featherstone_gait import Model, load_robot
from featherstone_gait.base.files import Format, write_csv
from featherstone_gait.benchmark.engines import mujoco, quick_mujoco
from featherstone_gait.benchmark.little_biped import NETWORK, little_biped
from featherstone_gait.crosscheck import Floor, PolicyCheck, crosscheck_policy, standing
from featherstone_gait.crosscheck.in_mujoco import advance, machine_of, place
from featherstone_gait.judge import Policy, judge, load_policy
from featherstone_gait.judge.run import HARD, posture_of, scene_of
from featherstone_gait.scene.compile import CompiledScene

OUT = Path(__file__).parent / "reproduction" / "policy_steps.csv"
CAUSES = OUT.with_name("policy_causes.csv")
WORLDS, SECONDS, SHORT = 8, 4.0, 1.0
STEPS = (1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3)  # of both engines [s]; the first is the reference
FLOORS = {5e-3: 9.1e-6, 2e-3: 2.3e-6}  # harder ones: MuJoCo's time constants [s], and penetrations here [m], which are
# those of Microduck at rest in MuJoCo with 10 and 5 ms
KEYS = {"speed": "speed", "J_per_m": "energy_per_way", "transport": "cost_of_transport"}
ARRAYS = ("_error", "_apart")
SOFT = 1e-2  # [s]: the least time constant that MuJoCo's steps of 5 ms allow


class Walker(NamedTuple):
    """A policy on its robot."""

    group: str  # within which policies have ranks
    robot: str
    label: str
    model: Model
    policy: Policy
    command: tuple[float, float, float]


def even(scale: float, **more: object) -> dict[str, object]:
    """Return a uniform distribution of a study."""
    return {"kind": "uniform", "scale": scale, **more}


def doubts(scene: CompiledScene) -> dict[str, Any]:
    """Return what differs between worlds: friction, servos, masses, zeros and sensors."""
    servos = {"Kp": even(0.1)}
    if scene.sampled:
        servos |= {"voltage_limit": even(0.1, shared=True), "resistance": even(0.1), "motor_constant": even(0.05),
                   "coulomb_friction": even(0.3), "viscous_friction": even(0.3)}  # fmt: skip
    return {
        "worlds": {"ground": {"friction": even(0.3)}, "servos": servos, "reference": {"offset": even(0.02)},
                   "links": {"mass": {"kind": "lognormal", "scale": 0.05}}},
        "sensing": {"gyroscope_noise": 0.02, "gyroscope_bias": 0.02, "gravity_noise": 0.01, "mounting": 0.02,
                    "joint_noise": 0.002, "joint_speed_noise": 0.1},
    }  # fmt: skip


def at_step(model: Model, h: float) -> CompiledScene:
    """Return the scene at a step h [s], with servos that are as slow as it is."""
    servos = {
        name: replace(servo, controller=replace(servo.controller, period=max(h, servo.controller.period)))
        for name, servo in model.servos.items()
    }
    return scene_of(replace(model, servos=servos), timestep=h)


def walked(
    one: Walker, h: float, floor: float = SOFT, depth: float = HARD, impratio: float = 1.0, finer: float = 1.0
) -> PolicyCheck:
    """Walk in all worlds, in both engines at a step h [s], in MuJoCo at one finer by a factor."""
    scene = at_step(one.model, h)
    scene = scene.recompiled(ground=replace(scene.ground, penetration=depth))
    lies = Floor(floor, scene.ground.friction, impratio=impratio)
    return crosscheck_policy(one.policy, scene, SECONDS, one.command, worlds=WORLDS, doubts=doubts(scene), floor=lies,
                             timestep=h / finer)  # fmt: skip


def time_in_mujoco(one: Walker, h: float) -> float:
    """Return the CPU time of MuJoCo's steps in a second of standing on both feet [ms]."""
    scene = at_step(one.model, h)
    posture, period = posture_of(one.policy, scene), scene.tick_steps * scene.timestep
    robot = machine_of(scene, Floor(SOFT, scene.ground.friction), h, held=True)
    place(robot, standing(scene, posture, 1e-4))
    taken, steps = [], round(0.05 / h)
    with quick_mujoco():
        for _ in range(20):
            advance(robot, posture, np.zeros_like(posture), period, round(period / h))
            kept = mujoco.MjData(robot.m)
            mujoco.mj_copyData(kept, robot.m, robot.d)
            begun = time.thread_time()
            mujoco.mj_step(robot.m, kept, steps)
            taken.append(time.thread_time() - begun)
    return 1e3 * float(np.median(taken)) / (steps * h)


def time_here(one: Walker, h: float) -> float:
    """Return the CPU time of the whole loop here, in a second of walking [ms]."""
    scene = at_step(one.model, h)
    long, short = (
        judge(one.policy, scene, WORLDS, seconds, one.command, doubts=doubts(scene), again=0, threads=1).seconds
        for seconds in (SECONDS, SHORT)
    )
    return 1e3 * (long["processors"] - short["processors"]) / (WORLDS * (SECONDS - SHORT))


def row(one: Walker, engine: str, floor: float, h: float, found: PolicyCheck, exact: PolicyCheck) -> dict[str, Any]:
    """Compare a run with that at the finest step, and with the other engine, in the worlds in which both walk."""
    runs = {"MuJoCo": (found.verdicts, found.mujoco), "here": (found.own.verdicts, found.own.worlds)}
    (verdicts, worlds), (others, other) = runs.pop(engine), *runs.values()
    right, best = (exact.verdicts, exact.mujoco) if engine == "MuJoCo" else (exact.own.verdicts, exact.own.worlds)
    depth, walks = found.own.scene.ground.penetration, verdicts == "walks"
    cells: dict[str, Any] = {
        "group": one.group, "robot": one.robot, "policy": one.label, "engine": engine, "floor_ms": 1e3 * floor,
        "penetration_mm": 1e3 * depth, "step_ms": 1e3 * h, "worlds": WORLDS, "walks": int(walks.sum()),
    }  # fmt: skip
    for name, key in KEYS.items():
        low, middle, high = np.percentile(worlds[key][walks], (25, 50, 75)) if walks.any() else [np.nan] * 3
        cells |= {name: middle, f"{name}_low": low, f"{name}_high": high}
        for what, mask, than in (("error", right == "walks", best), ("apart", others == "walks", other)):
            both = walks & mask
            cells[f"{name}_{what}"] = worlds[key][both] / than[key][both] - 1.0
    return cells


def summed(cells: dict[str, Any]) -> dict[str, Any]:
    """Return the cells with the median and the 10th and 90th percentile of each array."""
    found = {}
    for name, value in cells.items():
        if isinstance(value, np.ndarray):
            parts = np.percentile(value, (10, 50, 90)) if len(value) else [np.nan] * 3
            found |= dict(zip((f"{name}_low", name, f"{name}_high"), parts))
        else:
            found[name] = value
    return found


def pooled(lines: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the cells of all policies of a group together: their errors alone."""
    first = {name: lines[0][name] for name in ("group", "engine", "floor_ms", "penetration_mm", "step_ms")}
    arrays = {name: np.concatenate([line[name] for line in lines]) for name in lines[0] if name.endswith(ARRAYS)}
    counts = {name: sum(line[name] for line in lines) for name in ("worlds", "walks")}
    times = [line["ms_per_s"] for line in lines if line.get("ms_per_s")]
    return first | {"policy": "all"} | counts | arrays | ({"ms_per_s": np.median(times)} if times else {})


def of_policy(one: Walker, timed: bool) -> list[dict[str, Any]]:
    """Return the rows of a policy at all steps."""
    found = {h: walked(one, h) for h in STEPS}
    rows = []
    for engine, clock in (("MuJoCo", time_in_mujoco), ("here", time_here)):
        for h in STEPS:
            rows.append(row(one, engine, SOFT, h, found[h], found[STEPS[0]]))
            if timed:
                rows[-1]["ms_per_s"] = clock(one, h)
    return rows


def on_harder_floors(one: Walker) -> list[dict[str, Any]]:
    """Return the rows of a policy on harder floors."""
    found = {floor: walked(one, 2e-4, floor, depth) for floor, depth in FLOORS.items()}
    return [row(one, engine, floor, 2e-4, x, x) for engine in ("MuJoCo", "here") for floor, x in found.items()]


def one_at_a_time(one: Walker) -> list[dict[str, Any]]:
    """Return by how much the engines differ at 0.2 ms, with one thing changed in one or both of them."""

    def joints(**numbers: float) -> Walker:
        return one._replace(model=replace(one.model, joints=tuple(replace(x, **numbers) for x in one.model.joints)))

    cases = {
        "nothing": (one, {}), "MuJoCo: step of 0.1 ms": (one, {"finer": 2.0}),
        "MuJoCo: time constant of 5 ms": (one, {"floor": 5e-3}),
        "MuJoCo: time constant of 2 ms, step of 0.1 ms": (one, {"floor": 2e-3, "finer": 2.0}),
        "MuJoCo: impratio of 100": (one, {"impratio": 100.0}), "here: penetration of 1 mm": (one, {"depth": 1e-3}),
        "both: no armature": (joints(armature=0.0), {}), "both: no dry friction of joints": (joints(friction=0.0), {}),
    }  # fmt: skip
    rows = []
    for changed, (walker, how) in cases.items():
        found = walked(walker, 2e-4, **how)
        both = (found.verdicts == "walks") & (found.own.verdicts == "walks")
        theirs, ours = ({name: x[both] for name, x in worlds.items()} for worlds in (found.mujoco, found.own.worlds))
        low, middle, high = np.percentile(theirs["energy_per_way"] / ours["energy_per_way"] - 1.0, (10, 50, 90))
        cells = {"changed": changed, "walks": int(both.sum()), "energy": middle, "low": low, "high": high}
        for engine, worlds in (("mujoco", theirs), ("here", ours)):
            names = {"J_per_m": "energy_per_way", "slip": "slip", "speed": "speed"}
            cells |= {f"{engine}_{name}": np.median(worlds[key]) for name, key in names.items()}
        rows.append(cells)
    return rows


def walkers(microduck: str, playground: str) -> list[Walker]:
    """Load all policies with their robots, Microduck with servos of the package in place of its file's actuators."""
    biped = little_biped()
    own = load_policy(NETWORK, biped, NETWORK.with_suffix(".toml"))
    found = [Walker("little biped", "little biped", "walk", biped, own, (0.1, 0.0, 0.0))]
    for one in published(microduck, playground):
        model = load_robot(one.xml, contacts="feet")
        small = one.robot == "Microduck"
        model = with_servo(model, PRESET) if small else model
        policy = load_policy(one.network, model, one.description)
        found.append(
            Walker(one.robot if small else "five others", one.robot, one.label, model, policy, (one.speed, 0.0, 0.0))
        )
    return found


def write(path: Path, rows: list[dict[str, Any]]) -> None:
    """Write rows as a table of docs/reproduction."""
    columns = [*dict.fromkeys(name for line in rows for name in line)]
    write_csv(path, Format("policy steps", 1), columns, ([line.get(name, "") for name in columns] for line in rows))


def main(microduck: str, playground: str) -> None:
    """Write the tables."""
    warnings.simplefilter("ignore")  # of what the readers leave out
    rows: list[dict[str, Any]] = []
    for one in walkers(microduck, playground):
        first = not any(line["robot"] == one.robot for line in rows)
        rows += of_policy(one, first)
        rows += on_harder_floors(one) if one.group == "Microduck" else []
        if one.label == "go1":
            write(CAUSES, one_at_a_time(one))
        print(one.robot, one.label, flush=True)
    alike: dict[tuple[Any, ...], list[dict[str, Any]]] = {}
    for line in rows:
        alike.setdefault((line["group"], line["engine"], line["floor_ms"], line["step_ms"]), []).append(line)
    for lines in alike.values():  # ranks by the median, the cheapest first
        for k, line in enumerate(sorted(lines, key=lambda line: line["transport"])):
            line["rank"] = k + 1
    rows = [summed(line) for line in [*rows, *map(pooled, alike.values())]]
    write(OUT, rows)


if __name__ == "__main__":
    main(*sys.argv[1:])
