"""Gaits of other robots than the paper's ten-joint humanoid, in MuJoCo: do they walk there too?

The complete humanoid, whose 19 joints all take part, with its first gait and with one that is searched for energy alone
in eight worlds; ANYmal B, which comes with `example-robot-data`, on its four point feet, with its first trot and an
AX-12 scaled to it (`walking.with_generic_servos`).  They walk on the twelve floors of `featherstone_gait.crosscheck`.

    python -m featherstone_gait.experiments.other_robots TABLE.csv

writes a row a floor; started again it goes on with what is not in `TABLE_walks`.
"""

from __future__ import annotations

import argparse
import json
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from ..benchmark.robots import folders
from ..build.scene import CompiledScene, compile_scene
from ..crosscheck import crosscheck, motion_of
from ..files import FilePath, Format, complete, parse_json, write_csv
from ..model import Ground, Model
from ..optimize import optimize_gait, walking_cost
from ..robot_file import load_robot
from ..walking import Pattern, WalkingCost, fit_gait, four_legged_stride, mirror_by_place, with_generic_servos
from ..walking.cost_in_worlds import in_worlds
from .sources import digest

WORLDS = 8
TABLE, GAIT = Format("table of other robots"), Format("gait of another robot")
SIDES = {"mujoco": "mujoco", "own": "here"}


class Robot(NamedTuple):
    """A robot, how it first walks, and how long is searched for more."""

    first: Callable[[], WalkingCost]
    candidates: int  # 0: the first walk alone


def complete_humanoid() -> WalkingCost:
    """The walk that `optimize` begins with, of the robot with all its joints."""
    return walking_cost(load_robot("humanoid"), states="step")


def anymal() -> WalkingCost:
    """A trot of 120 mm in 0.48 s."""
    robot = with_generic_servos(_published("anymal_b_simple_description/robots/anymal.urdf"), leg=0.55)
    bend = {"HAA": 0.0, "HFE": 0.4, "KFE": -0.8}  # [rad], of the hind legs the other way
    posture = np.array([bend[name[3:]] * (1.0 if name[1] == "F" else -1.0) for name in robot.joint_names])
    stride = four_legged_stride(robot, posture, Pattern(period=0.48, step=0.12, lift=0.06))
    gait = fit_gait(stride, 8, mirror=mirror_by_place(robot, posture)).gait
    return WalkingCost(_scene(robot), gait, posture, blend_strides=2)


ROBOTS = {
    "complete humanoid": Robot(complete_humanoid, 400),
    "ANYmal B": Robot(anymal, 0),
}


def _published(urdf: str) -> Model:
    """Raises ImportError without the package."""
    path = next((folder / urdf for folder in folders() if (folder / urdf).is_file()), None)
    if path is None:
        raise ImportError("ANYmal comes with a package; pip install example-robot-data")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what the file says in another way than it should
        return load_robot(path, base="floating", contacts="feet")


def _scene(robot: Model) -> CompiledScene:
    return compile_scene(robot, "mipsd", Ground(), "midpoint", 1e-3)


def gaits(name: str, folder: Path) -> tuple[WalkingCost, dict[str, np.ndarray]]:
    """Cost of a robot's first gait, and the vectors (D,) of that and of the one that is searched for [rad]."""
    robot, cost = ROBOTS[name], ROBOTS[name].first()
    path, first = folder / f"{name}_{robot.candidates}.json".replace(" ", "_"), cost.gait.to_vector()
    if not robot.candidates:
        return cost, {"first": first}
    if not path.exists():
        result = optimize_gait(in_worlds(cost, WORLDS), iterations=robot.candidates, no_progress=robot.candidates)
        if result.status == 2:
            raise KeyboardInterrupt
        with complete(path) as temporary:
            told = {"format": str(GAIT), "first": first.tolist(), "x": result.x.tolist()}
            temporary.write_text(json.dumps(told), "utf-8")
    told = parse_json(path.read_text("utf-8"), str(path), "delete it")
    GAIT.check(path, told["format"])
    if told["first"] != first.tolist():
        raise ValueError(f"{path}: is of another first gait, of other sources or another version; delete it")
    return cost, {"first": first, f"{robot.candidates} candidates": np.array(told["x"])}


def rows_of(name: str, folder: Path) -> list[list]:
    """A row a gait and floor, soles as spheres; what was walked before is not walked again."""
    rows = []
    cost, vectors = gaits(name, folder)
    for k, (gait, x) in enumerate(vectors.items()):
        own = cost.measure([x])[0]
        motion = motion_of(cost.gait.from_vector(x), cost.start, cost.blend_strides)
        out = folder / f"{name}_{k}_crosscheck".replace(" ", "_")
        report = crosscheck(motion, cost.scene.model, soles=["spheres"], out=out)
        for row in report["floors"]:
            walked = [row[side][key] for side in SIDES for key in ("walks", "end", "cost", "speed")]
            rows.append([name, gait, own.cost, own.speed, row["floor"], row["sinking"], *walked])
    return rows


def write_table(path: FilePath, rows: Sequence[Sequence]) -> None:
    """Rows of `rows_of` as CSV."""
    columns = ["robot", "gait", "own_ground_J_per_m", "own_ground_m_per_s", "floor", "sinking_m"]
    measures = ("walks", "end_s", "cost_J_per_m", "speed_m_per_s")
    columns += [f"{side}_{name}" for side in SIDES.values() for name in measures]
    write_csv(path, TABLE, columns, rows, f"sources {digest(Path(__file__))}")


def main(arguments: Sequence[str] | None = None) -> int:
    """Walk one robot after the other, and write the table after each."""
    parser = argparse.ArgumentParser(description="gaits of other robots in MuJoCo; interrupted to go on")
    parser.add_argument("table", type=Path, metavar="TABLE.csv")
    args = parser.parse_args(arguments)
    folder = Path(str(args.table.with_suffix("")) + "_walks")
    folder.mkdir(parents=True, exist_ok=True)
    rows: list[list] = []
    for name in tqdm(ROBOTS, unit="robot"):
        rows += rows_of(name, folder)
        write_table(args.table, rows)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
