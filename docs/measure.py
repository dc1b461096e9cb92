"""Measure what the pages quote and no command of the package writes; keep the reports of searches.

    python docs/measure.py                          all tables, an hour of two cores
    python docs/measure.py plans pushes             by name
    python docs/measure.py keep humanoid_gait.json docs/reproduction/gait_seed_1.json

Tables are written to `docs/reproduction/`, where `docs/tables.py` reads them for the pages.  They are the same on every
machine.  `keep` stores a gait's report, or its arrays (`.npz`), without what depends on the machine.
"""

from __future__ import annotations

import csv
import functools
import itertools
import json
import math
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from featherstone_gait import Ground, Reference, compile_scene, initial_state, load_robot
from featherstone_gait.base.files import Format, complete, write_csv
from featherstone_gait.benchmark.robots import anymal, g1
from featherstone_gait.crosscheck import crosscheck
from featherstone_gait.crosscheck.floors import FLOORS
from featherstone_gait.optimize import AMPLITUDE, optimize_gait, walking_cost
from featherstone_gait.optimize.feedback import search_feedback
from featherstone_gait.optimize.quality import TEST_WORLDS, measure_in_test_worlds
from featherstone_gait.reproduction.maximal import Engine, simulate, simulate_seeds
from featherstone_gait.search import cma_es, run
from featherstone_gait.walking import (
    BIOLOID_WALK,
    BalancedWalk,
    Feedback,
    Motion,
    WalkingCost,
    WalkSettings,
    balanced,
    bounds,
    cheapest_plan,
    generic_feedback,
    motion_of,
    read_walk,
    walking_plan,
)
from featherstone_gait.walking.cheapest_plan import CheapestPlan, States, fit_states
from featherstone_gait.walking.cost_in_worlds import CostInWorlds, in_worlds
from featherstone_gait.walking.disturbed import pushes_survived, rough_field, walk_far
from featherstone_gait.walking.gait import TICK

sys.path.append(str(Path(__file__).resolve().parents[1] / "notebooks"))

import posture as table_3
import setups
import solver_map

ROOT = Path(__file__).resolve().parents[1]
STORED = ROOT / "docs" / "reproduction"
FORMAT = Format("measured table")
KEPT = (
    "settings", "search", "before", "after", "elsewhere", "crosscheck", "plausible", "at_equal_speed",
)  # fmt: skip
FEEDBACK = {False: "without", True: "with"}
Row = dict[str, Any]


def finished(result: Any) -> Any:
    """Return the result of a search; raise KeyboardInterrupt if it was interrupted."""
    if result.status == 2:
        raise KeyboardInterrupt
    return result


@functools.cache
def _plain(states: States) -> WalkingCost:
    return walking_cost(load_robot("humanoid", locked="simplified"), states=states)


@functools.cache
def _cheapest(states: States) -> CheapestPlan:
    return cheapest_plan(_plain(states).scene, states)


def _cost_of_start(cost: WalkingCost) -> Row:
    """Cost and speed of a gait on its own ground, and its cost in the eight worlds of a search."""
    x = cost.gait.to_vector()
    own, (eight, _) = cost.measure([x])[0], in_worlds(cost, 8)(x)
    return {"own_J_per_m": own.cost, "own_m_per_s": own.speed, "worlds_J_per_m": eight}


def _elsewhere(cost: WalkingCost, x: np.ndarray | BalancedWalk) -> Row:
    """Share of 200 worlds that no search has seen in which a gait walks, and percentiles of its cost there."""
    (found,) = measure_in_test_worlds(cost, [x], TEST_WORLDS)
    low, median, high = found["cost"] or ("", "", "")
    return {"walks": found["walks"], "p5_J_per_m": low, "p50_J_per_m": median, "p95_J_per_m": high}


def plans() -> Iterable[Row]:
    """Measure the plain and the cheapest plan on their own ground, in eight worlds and in 200 others."""
    for states in ("step", "stride"):
        for plan in ("plain", "cheapest"):
            cost = _plain(states) if plan == "plain" else _cheapest(states).cost
            yield {"plan": plan, "states": states, **_cost_of_start(cost), **_elsewhere(cost, cost.gait.to_vector())}


def previews() -> Iterable[Row]:
    """Measure two plans with either form of the preview controller."""
    scene = _plain("step").scene
    for name, weights in ("plain", (1e-7, 1e-5, 1e-4)), ("cheapest", (1e-7, 1e-5)):
        walk = WalkSettings(**BIOLOID_WALK) if name == "plain" else _cheapest("step").plan.walk
        auxiliary = [replace(walk, preview="auxiliary_zmp", R=R) for R in weights]
        for each in (replace(walk, preview="cart_table"), *auxiliary):
            plan = walking_plan(scene.model, **asdict(each))
            ahead, sideways = np.sqrt(np.mean((plan.zmp - plan.zmp_reference) ** 2, axis=0))
            cost = WalkingCost(scene, fit_states(scene.model, plan, "step").gait, plan.start_up(1))
            yield {
                "plan": name, "preview": each.preview, "R": each.R if each in auxiliary else "",
                "error_ahead_m": ahead, "error_sideways_m": sideways, "margin_m": plan.margin().min(),
                **_cost_of_start(cost),
            }  # fmt: skip


@functools.cache
def _balanced() -> tuple[Any, Any]:
    """Scene and gait of the walk with feedback."""
    scene = compile_scene(load_robot("humanoid", locked="simplified"), "mipsd", Ground(), "midpoint", 1e-3)
    return scene, read_walk(ROOT / "robots" / "humanoid" / "balanced_gait.npz", scene.model.joint_names)


def grounds() -> Iterable[Row]:
    """Walk a hundred strides on slopes and rough ground, without feedback and with four seeds of the sensors."""
    scene, walk = _balanced()
    slope, right = math.radians(3.0), -0.5 * math.pi
    for name, ground in {
        "level": None, "down 3°": Ground(slope=-slope), "up 3°": Ground(slope=slope),
        "1° down to the left": Ground(slope=slope / 3.0, heading=right),
        "1° down to the right": Ground(slope=-slope / 3.0, heading=right),
        "3° down to the left": Ground(slope=slope, heading=right),
        "3° down to the right": Ground(slope=-slope, heading=right),
        "3 mm rough": Ground(field=rough_field(3e-3)), "3 mm rough, seed 1": Ground(field=rough_field(3e-3, 1)),
        "6 mm rough": Ground(field=rough_field(6e-3)),
    }.items():  # fmt: skip
        for feedback in (False, True):
            for seed in range(4 if feedback else 1):
                far = walk_far(scene, walk, ground, feedback=feedback, seed=seed)
                where = {"ground": name, "feedback": FEEDBACK[feedback], "seed": seed, "fell_at_stride": ""}
                steady = {"strides": far.strides, "heading_deg": math.degrees(far.heading) if far.strides > 10 else ""}
                end = {"J_per_m": far.energy} if far.walked else {"J_per_m": "", "fell_at_stride": far.strides}
                yield where | steady | end


def across() -> Iterable[Row]:
    """Walk on slopes across the way with feedback, as on level ground and leaning uphill; find the pushes survived."""
    scene, walk = _balanced()
    for degrees in (-3, -2, 2, 3):
        roll = math.radians(degrees)
        ground = Ground(slope=roll, heading=0.5 * math.pi)
        for leans in (False, True):
            played = walk.leaning(scene.model, roll) if leans else walk
            far = [walk_far(scene, played, ground, seed=seed) for seed in range(4)]
            walked = [one for one in far if one.walked]
            heading = max((math.degrees(one.heading) for one in walked), default="")
            impulse = pushes_survived(scene.recompiled(ground=ground), played, 4).mean() if abs(degrees) == 2 else ""
            yield {
                "left_side_higher_deg": degrees, "leans": "yes" if leans else "no",
                "runs": len(far), "walk": len(walked), "least_strides": min(one.strides for one in far),
                "heading_deg": heading, "J_per_m": float(np.mean([one.energy for one in walked])) if walked else "",
                "impulse_N_s": impulse,
            }  # fmt: skip


def pushes() -> Iterable[Row]:
    """Find the impulses that the walk survives, without and with feedback."""
    directions = ("ahead", "45°", "left", "135°", "behind", "225°", "right", "315°")
    for feedback in (False, True):
        found = pushes_survived(*_balanced(), 16, feedback=feedback)
        yield {"feedback": FEEDBACK[feedback], **dict(zip(directions, found)), "mean": found.mean()}


def solver() -> Iterable[Row]:
    """Measure the scatter of energy in the paper's kind of simulator."""
    for gearbox in ("standard", "mipsd"):
        for step, sweeps, runs in ((1e-3, 10, 200), (2e-3, 10, 200), (1e-3, 0, 2)):
            _, found = solver_map.swept(gearbox, step, sweeps, 1.0, runs)
            scatter = {"fell": found.fell, "cycle": found.cycle, "repeat": found.repeat, "run": found.run}
            yield {"gearbox": gearbox, "step_s": step, "sweeps": sweeps, "precision": "single", "runs": runs, **scatter}
        nudged = {"fell": "", "cycle": "", "repeat": _nudged(gearbox), "run": ""}
        yield {"gearbox": gearbox, "step_s": 1e-3, "sweeps": 0, "precision": "double", "runs": 6, **nudged}


def _nudged(gearbox: str) -> float:
    """Return how much the same cycle scatters where nothing is random and one joint starts 1e-9 rad off."""
    cost = solver_map.walk(gearbox)
    state, reference = cost.beginning(cost.gait.to_vector())
    starts = state + 1e-9 * np.eye(6, len(state), cost.scene.part("q")[0])
    how: Any = {"engine": Engine(iterations=0, single=False), "record": ("energy",), "record_interval": TICK}
    done = [simulate(cost.scene, cost.end, start, reference, **how) for start in starts]
    return solver_map.deviations(solver_map.energies(cost, done))[1]


def arm() -> Iterable[Row]:
    """Measure how still the arm of seven joints stands in that simulator."""
    upright = Reference([0.0], np.zeros((1, 7)))
    for link, sweeps in itertools.product((0.1, 0.09), (10, 20, 0)):
        scene = compile_scene(setups.arm(link), "standard", integrator="simtwo", timestep=1e-3)
        start = initial_state(scene, 0.01 * np.random.default_rng(0).standard_normal(7))
        how: dict[str, Any] = {"seeds": range(8 if sweeps else 1), "engine": Engine(iterations=sweeps)}
        runs = simulate_seeds(scene, 20.0, start, upright, record=("q",), record_interval=1e-3, **how)
        found = [np.degrees(run["q"][run["time"] >= 10.0, 0]).var() for run in runs if run.status == "ok"]
        yield {"link_kg": link, "link_m": link, "sweeps": sweeps, "variance_deg2": float(np.median(found))}


def posture() -> Iterable[Row]:
    """Measure how still the humanoid of Table 3 stands in that simulator."""
    usual = "floating", "PI", "bioloid2.xml"
    cases = [*itertools.product((10,), (1e-3, 2e-3), ("floating", "fixed"), table_3.LAWS, table_3.MASSES)]
    for sweeps, step, base, law, mass in [*cases, (20, 1e-3, *usual), (50, 1e-3, *usual)]:
        for gearbox in ("standard", "mipsd"):
            what: Any = {"sweeps": sweeps, "base": base, "law": law, "mass": mass}
            _, angles = table_3.hold(gearbox, "bodies", step=step, runs=4, **what)
            fell = int(np.isnan(angles[:, 0, 0]).sum())
            numbers = ["" if math.isnan(x) else float(x) for x in table_3.measured(angles)]
            row = {"gearbox": gearbox, "step_s": step, **what, "runs": len(angles), "fell": fell}
            yield row | dict(zip(table_3.NUMBERS, numbers))


def worlds() -> Iterable[Row]:
    """Search for energy alone on the robot's own floor (0) and in worlds, by two methods; walk in 200 other worlds."""
    first, n = _plain("step"), 800
    x0, limits = first.gait.to_vector(), bounds(first.scene.model, first.gait)
    for count in (0, 1, 2, 4, 8):
        cost = in_worlds(first, count) if count else first
        for method in ("annealing", "CMA-ES"):
            if method == "annealing":
                found = finished(optimize_gait(cost, iterations=n - 1, no_progress=n))
            else:
                asks = cma_es(x0, amplitude=AMPLITUDE, bounds=limits)
                found = finished(run(asks, cost, evaluations=n, map=type(cost).costs, batch=n))
            own = first.measure([found.x])[0]
            costs = {"own_J_per_m": own.cost, "own_m_per_s": own.speed, **_elsewhere(first, found.x)}
            yield {"method": method, "worlds": count, **costs}


ROBOTS: dict[str, Callable[[], WalkingCost]] = {  # and the walks from which their searches begin
    "complete humanoid": lambda: walking_cost(load_robot("humanoid"), states="step"), "ANYmal B": anymal, "G1": g1,
}  # fmt: skip


@functools.cache
def _walk_of(robot: str) -> WalkingCost:
    return ROBOTS[robot]()


@functools.cache
def _found(robot: str) -> np.ndarray:
    return finished(optimize_gait(in_worlds(_walk_of(robot), 8), iterations=400, no_progress=400)).x


@functools.cache
def _found_with_feedback(robot: str) -> tuple[np.ndarray, Feedback]:
    result = finished(search_feedback(in_worlds(_walk_of(robot), 8), iterations=200))
    return result.x_poses, result.walk.feedback


def _motion(cost: WalkingCost, x: np.ndarray) -> Motion:
    return motion_of(cost.gait.from_vector(x), cost.start, cost.blend_strides)


def _gaits(robot: str) -> Iterator[tuple[str, np.ndarray | BalancedWalk]]:
    """Yield the first gait, the one found in eight worlds, and of the G1 both with feedback."""
    cost = _walk_of(robot)
    yield "first", cost.gait.to_vector()
    yield "400 candidates", _found(robot)
    if robot == "G1":
        gains = generic_feedback(cost.scene.model)
        yield "first, feedback", _balanced_walk(cost, cost.gait.to_vector(), gains)
        yield "200 candidates, feedback", _balanced_walk(cost, *_found_with_feedback(robot))


def _balanced_walk(cost: WalkingCost, x: np.ndarray, gains: Feedback | None = None) -> BalancedWalk:
    return balanced(cost.scene, _motion(cost, x), gains, mirror=cost.gait.mirror)


def _on_own_ground(cost: WalkingCost, x: np.ndarray | BalancedWalk) -> Row:
    alone = CostInWorlds(cost, [cost.scene], np.zeros((1, len(cost.gait.joint_names))))
    own = alone.measure([x])[0][0]
    return {"own_J_per_m": own.cost, "own_m_per_s": own.speed, "cost_of_transport": own.cost_of_transport}


def robots() -> Iterable[Row]:
    """Walk with other robots on their own ground, in the eight worlds of the search and in 200 others; push the G1."""
    for robot in ROBOTS:
        cost = _walk_of(robot)
        for gait, x in _gaits(robot):
            eight, _ = in_worlds(cost, 8).costs([x])[0]
            pushed: float | str = ""
            if robot == "G1":
                walk = x if isinstance(x, BalancedWalk) else _balanced_walk(cost, x)
                pushed = float(pushes_survived(cost.scene, walk, 4, feedback=walk is x).mean())
            costs = {**_on_own_ground(cost, x), "worlds_J_per_m": eight, **_elsewhere(cost, x), "pushes_N_s": pushed}
            yield {"robot": robot, "gait": gait, **costs}


def floors() -> Iterable[Row]:
    """Walk with other robots on twelve floors in MuJoCo, and here, on soles of spheres."""
    for robot in ROBOTS:
        cost = _walk_of(robot)
        for gait, x in _gaits(robot):
            own = _on_own_ground(cost, x)
            motion = x if isinstance(x, BalancedWalk) else _motion(cost, x)
            for floor in FLOORS:
                (row,) = crosscheck(motion, cost.scene.model, floors=[floor], soles=["spheres"])["floors"]
                both = {"mujoco": row["mujoco"], "here": row["own"]}
                names = {"walks": "walks", "end": "end_s", "cost": "cost_J_per_m", "speed": "speed_m_per_s"}
                yield {
                    "robot": robot, "gait": gait, "own_J_per_m": own["own_J_per_m"], "own_m_per_s": own["own_m_per_s"],
                    "floor": floor, "sinking_m": row["sinking"],
                    **{f"{side}_{names[key]}": "" if walked[key] is None else walked[key]
                       for side, walked in both.items() for key in names},
                }  # fmt: skip


TABLES: dict[str, Callable[[], Iterable[Row]]] = {
    each.__name__: each
    for each in (
        plans,
        previews,
        grounds,
        across,
        pushes,
        worlds,
        robots,
        floors,
        solver,
        arm,
        posture,
    )
}


def stored(name: str) -> Path:
    return STORED / f"measured_{name}.csv"


def measured(name: str, count: int | None = None) -> list[list[str]]:
    """Return the header and the cells of a table; count: of its first rows."""
    rows = [*itertools.islice(TABLES[name](), count)]
    cells = [[f"{x:.10g}" if isinstance(x, float) else str(x) for x in row.values()] for row in rows]
    return [[*rows[0]], *cells]


def read(name: str) -> list[list[str]]:
    """Return the header and the cells of a table as they are stored."""
    with stored(name).open(encoding="utf-8", newline="") as file:
        return [row for row in csv.reader(file) if not row[0].startswith("#")]


def keep(source: Path, target: Path) -> None:
    """Store a gait's report without what depends on the machine, or its arrays without the candidates of the search."""
    if source.suffix == ".npz":
        with np.load(source) as found, complete(target) as temporary, temporary.open("wb") as file:
            np.savez_compressed(file, **{key: found[key] for key in found.files if key not in ("costs", "visited")})
    else:
        report = json.loads(source.read_text("utf-8"))
        kept = {key: report[key] for key in ("format", "version", *KEPT) if key in report}
        with complete(target) as temporary:
            temporary.write_text(json.dumps(kept) + "\n", "utf-8")


def main(arguments: list[str]) -> None:
    if arguments[:1] == ["keep"]:
        keep(*map(Path, arguments[1:]))
        return
    unknown = [name for name in arguments if name not in TABLES]
    if unknown:
        raise SystemExit(f"measure.py: no table {unknown[0]!r}; tables: {', '.join(TABLES)}")
    for name in arguments or TABLES:
        print(f"{name}: {TABLES[name].__doc__}", flush=True)
        columns, *rows = measured(name)
        write_csv(stored(name), FORMAT, columns, rows, end="\n")


if __name__ == "__main__":
    main(sys.argv[1:])
