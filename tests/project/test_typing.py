"""Type checkers accept the words that options take, and refuse others."""

import subprocess
import sys
from typing import get_args

import pytest

from featherstone_gait.core.integrate import INTEGRATORS
from featherstone_gait.envs.environment import RenderMode, Stand
from featherstone_gait.model.placed import OF_SCENE, PlacedGearbox
from featherstone_gait.scene.gearbox_kinds import GEARBOX_KINDS, IntegratorName

RIGHT = """
import numpy as np

from featherstone_gait import Ground, Placed, Session, compile_scene, load_robot, simulate

scene = compile_scene(load_robot("humanoid"), "mipsd", Ground(friction=0.8), integrator="midpoint", pairs="all")
run = simulate(scene, 0.1, record=("q", "energy"))
last: np.ndarray = run["q"][-1]
if run.error is not None:
    print(run.status == "ok", last, run.error["q"].max())
session = Session(scene, 8, "reference")
placed = Placed(load_robot("arm7", base="fixed", mimic="free"), gearbox="rotor")
"""
WRONG = """
from featherstone_gait import Ground, Placed, Reference, Session, compile_scene, load_robot

robot = load_robot("humanoid", base="flying")
compile_scene(robot, "mipds", Ground())
compile_scene(robot, "mipsd", Ground(), integrator="euler")
scene = compile_scene(robot, pairs="every")
Session(scene, 8, "position")
Placed(robot, gearbox="elastic")
Reference([0.0], [[0.0]], kind="spline")
load_robot("humanoid", mimic="coupling")
"""


def test_the_words_are_those_that_the_program_knows():
    assert {*get_args(IntegratorName)} == {*INTEGRATORS}
    assert {*get_args(PlacedGearbox)} == {*GEARBOX_KINDS, OF_SCENE}
    assert [*get_args(RenderMode)] == Stand.metadata["render_modes"]


@pytest.mark.long
def test_a_strict_type_checker_takes_what_is_right_and_refuses_each_word_that_is_wrong(tmp_path):
    (tmp_path / "right.py").write_text(RIGHT, "utf-8")
    (tmp_path / "wrong.py").write_text(WRONG, "utf-8")
    command = [sys.executable, "-m", "mypy", "--strict", "--ignore-missing-imports", "right.py", "wrong.py"]
    said = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True).stdout.splitlines()
    of_wrong = range(1 + WRONG[: WRONG.index("robot =")].count("\n"), 1 + WRONG.count("\n"))
    assert [line.partition(": ")[0] for line in said if "error:" in line] == [f"wrong.py:{k}" for k in of_wrong]
