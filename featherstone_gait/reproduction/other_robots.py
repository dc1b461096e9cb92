"""Gaits of other robots than the paper's ten-joint humanoid: do they walk in other worlds, and in MuJoCo?

The robots are the complete humanoid with all its 19 joints; ANYmal B on its four point feet, and the Unitree G1 with
the twelve joints of its legs, both from `example-robot-data`.  Their servos are an AX-12 scaled to each robot
(`walking.with_generic_servos`).  Each robot walks with its first gait and with one that is searched for energy alone in
eight worlds; the G1 also walks with a Bioloid's feedback scaled to it (`walking.generic_feedback`), and with poses and
gains that are searched together.  All walk in 200 worlds that no search has seen, and on the twelve floors of
`featherstone_gait.crosscheck`.

    python -m featherstone_gait.reproduction.other_robots TABLE.csv

writes a row for each gait and floor, and a row for each gait into `TABLE_worlds.csv`; it resumes with what is not in
`TABLE_walks`.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..base.files import Format, read_json
from ..base.progress import progress_bar
from ..benchmark.robots import folders
from ..crosscheck import crosscheck, motion_of
from ..model import Ground, Model
from ..optimize.feedback import search_feedback
from ..optimize.planning import walking_cost
from ..optimize.quality import TEST_WORLDS, measure_in_test_worlds
from ..optimize.search import optimize_gait
from ..robot_file import load_robot
from ..scene.compile import CompiledScene, compile_scene
from ..walking import (
    BalancedWalk,
    Motion,
    Pattern,
    WalkingCost,
    balanced,
    cheapest_plan,
    fit_gait,
    four_legged_stride,
    generic_feedback,
    mirror_by_place,
    pushes_survived,
    with_generic_servos,
)
from ..walking.cost import Measures
from ..walking.cost_in_worlds import CostInWorlds, in_worlds
from .tables import kept, table_arguments, write_rows
from .walks import finished

WORLDS, PUSHED = 8, 4  # of the search, and to be pushed in
TABLE, GAIT = Format("table of other robots"), Format("gait of another robot")
WORLDS_TABLE, WORTH = Format("worlds of other robots"), Format("worth of another robot's gait")
SIDES = {"mujoco": "mujoco", "own": "here"}
COLUMNS = ["robot", "gait", "own_ground_J_per_m", "own_ground_m_per_s", "floor", "sinking_m", *(
    f"{side}_{name}" for side in SIDES.values() for name in ("walks", "end_s", "cost_J_per_m", "speed_m_per_s")
)]  # fmt: skip
WORLDS_COLUMNS = [
    "robot", "gait", "own_ground_J_per_m", "own_ground_cost_of_transport", "own_ground_m_per_s",
    "searched_worlds_J_per_m", "walks", *(f"p{share}_J_per_m" for share in (5, 50, 95)), "pushes_N_s",
]  # fmt: skip


class Robot(NamedTuple):
    """A robot, its first walk, and the lengths of its searches."""

    first: Callable[[], WalkingCost]
    candidates: int
    feedback: int = 0  # candidates of a search of poses and feedback from the first gait; 0: it has none


def complete_humanoid() -> WalkingCost:
    """Return the walk with which `optimize` starts, of the robot with all its joints."""
    return walking_cost(load_robot("humanoid"), states="step")


def anymal() -> WalkingCost:
    """Return a trot of 120 mm in 0.48 s."""
    robot = with_generic_servos(_published("anymal_b_simple_description/robots/anymal.urdf"), leg=0.55)
    bend = {"HAA": 0.0, "HFE": 0.4, "KFE": -0.8}  # [rad], of the hind legs the other way
    posture = np.array([bend[name[3:]] * (1.0 if name[1] == "F" else -1.0) for name in robot.joint_names])
    stride = four_legged_stride(robot, posture, Pattern(period=0.48, step=0.12, lift=0.06))
    gait = fit_gait(stride, 8, mirror=mirror_by_place(robot, posture)).gait
    return WalkingCost(_scene(robot), gait, posture, blend_strides=2)


def g1() -> WalkingCost:
    """Return the cheapest of 73 plans, for the robot with all joints but those of its legs held.

    Its servos are twice as strong for its weight as a Bioloid's: with such as these none of 35 plans walks in eight
    worlds.
    """
    urdf = "g1_description/urdf/g1_29dof_rev_1_0.urdf"
    held = [name for name in _published(urdf).joint_names if not any(part in name for part in ("hip", "knee", "ankle"))]
    robot = with_generic_servos(_published(urdf, held), leg=0.75, margin=2.0)
    return cheapest_plan(_scene(robot), "step").cost


ROBOTS = {
    "complete humanoid": Robot(complete_humanoid, 400),
    "ANYmal B": Robot(anymal, 400),
    "G1": Robot(g1, 400, feedback=200),
}


def _published(urdf: str, locked: Sequence[str] = ()) -> Model:
    """Load a published robot; raise ImportError without the package."""
    path = next((folder / urdf for folder in folders() if (folder / urdf).is_file()), None)
    if path is None:
        raise ImportError(f"{Path(urdf).name} comes with a package; pip install example-robot-data")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what the file says in another way than it should
        return load_robot(path, base="floating", contacts="feet", locked=[*locked])


def _scene(robot: Model) -> CompiledScene:
    return compile_scene(robot, "mipsd", Ground(), "midpoint", 1e-3)


Gaits = dict[str, np.ndarray | BalancedWalk]  # vectors (D,) [rad], or with feedback


def gaits(name: str, folder: Path) -> tuple[WalkingCost, Gaits]:
    """Return the cost of a robot, its first gait, the gait found, and two with feedback if it has any."""
    robot, cost = ROBOTS[name], ROBOTS[name].first()
    first = cost.gait.to_vector()

    def searched() -> dict[str, list[float]]:
        n = robot.candidates
        return {"x": finished(optimize_gait(in_worlds(cost, WORLDS), iterations=n, no_progress=n)).x.tolist()}

    content = _kept(folder / f"{name}_{robot.candidates}.json".replace(" ", "_"), first, searched)
    found: Gaits = {"first": first, f"{robot.candidates} candidates": np.array(content["x"])}
    if robot.feedback:
        model, mirror = cost.scene.model, cost.gait.mirror
        found["first, feedback"] = balanced(cost.scene, _motion(cost, first), generic_feedback(model), mirror=mirror)

        def with_feedback() -> dict[str, list[float]]:
            result = finished(search_feedback(in_worlds(cost, WORLDS), iterations=robot.feedback))
            return {"x": result.x_poses.tolist(), "gains": result.walk.feedback.to_vector().tolist()}

        content = _kept(folder / f"{name}_{robot.feedback}_feedback.json".replace(" ", "_"), first, with_feedback)
        motion = _motion(cost, np.array(content["x"]))
        found[f"{robot.feedback} candidates, feedback"] = balanced(cost.scene, motion, content["gains"], mirror=mirror)
    return cost, found


def _kept(path: Path, first: np.ndarray, search: Callable[[], dict[str, list[float]]]) -> dict[str, Any]:
    """Return the result of a search, from its file if it exists; raise ValueError for another first gait."""
    content = kept(path, GAIT, lambda: {"first": first.tolist(), **search()})
    if content["first"] != first.tolist():
        raise ValueError(f"{path}: belongs to another first gait, of other sources or another version; delete it")
    return content


def _motion(cost: WalkingCost, x: np.ndarray) -> Motion:
    return motion_of(cost.gait.from_vector(x), cost.start, cost.blend_strides)


def worth_of(name: str, folder: Path, cost: WalkingCost, found: Gaits) -> list[list]:
    """Return a row for each gait: its cost on its own ground and in the worlds of the search, and in others.

    The last number is the impulse that half of the robots survive, mean of eight directions [N s], where it is asked.
    """
    path = folder / f"{name}_{ROBOTS[name].candidates}_worth.json".replace(" ", "_")
    digits = [x.feedback.to_vector().tolist() if isinstance(x, BalancedWalk) else x.tolist() for x in found.values()]
    if path.exists() and read_json(path, WORTH)["gaits"] != digits:
        path.unlink()
    return kept(path, WORTH, lambda: {"gaits": digits, "rows": _worths(name, cost, found)})["rows"]


def _worths(name: str, cost: WalkingCost, found: Gaits) -> list[list]:
    searched, rows = in_worlds(cost, WORLDS), list[list]()
    for (gait, x), there in zip(found.items(), measure_in_test_worlds(cost, [*found.values()], TEST_WORLDS)):
        own, costs = on_own_ground(cost, x), there["cost"] or [None] * 3
        cells = [own.cost, own.cost_of_transport, own.speed, searched.costs([x])[0][0], there["walks"], *costs]
        pushes = None
        if ROBOTS[name].feedback:
            walk = x if isinstance(x, BalancedWalk) else balanced(cost.scene, _motion(cost, x), mirror=cost.gait.mirror)
            pushes = float(pushes_survived(cost.scene, walk, PUSHED, feedback=walk is x).mean())
        rows.append([name, gait, *cells, pushes])
    return rows


def on_own_ground(cost: WalkingCost, gait: np.ndarray | BalancedWalk) -> Measures:
    """Measure a gait on the ground from which it was searched."""
    alone = CostInWorlds(cost, [cost.scene], np.zeros((1, len(cost.gait.joint_names))))
    return alone.measure([gait])[0][0]


def rows_of(name: str, folder: Path, cost: WalkingCost, found: Gaits) -> list[list]:
    """Return a row for each gait and floor, with spheres as soles; finished walks are not repeated."""
    rows = []
    for k, (gait, x) in enumerate(found.items()):
        own, motion = on_own_ground(cost, x), x if isinstance(x, BalancedWalk) else _motion(cost, x)
        out = folder / f"{name}_{k}_crosscheck".replace(" ", "_")
        report = crosscheck(motion, cost.scene.model, soles=["spheres"], out=out)
        for row in report["floors"]:
            walked = [row[side][key] for side in SIDES for key in ("walks", "end", "cost", "speed")]
            rows.append([name, gait, own.cost, own.speed, row["floor"], row["sinking"], *walked])
    return rows


def main(arguments: Sequence[str] | None = None) -> int:
    """Walk one robot after the other, and write the tables after each."""
    args = table_arguments("walk the gaits of other robots in MuJoCo", arguments)
    folder = Path(str(args.table.with_suffix("")) + "_walks")
    folder.mkdir(parents=True, exist_ok=True)
    rows: list[list] = []
    worlds: list[list] = []
    for name in progress_bar(ROBOTS, unit="robot"):
        walked = gaits(name, folder)
        worlds += worth_of(name, folder, *walked)
        own_table = args.table.with_name(f"{args.table.stem}_worlds.csv")
        write_rows(own_table, WORLDS_TABLE, worlds, __file__, WORLDS_COLUMNS)
        rows += rows_of(name, folder, *walked)
        write_rows(args.table, TABLE, rows, __file__, COLUMNS)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
