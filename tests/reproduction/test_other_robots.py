"""Gaits of other robots in MuJoCo: searches that are kept, rows that are those of the crosscheck, and ANYmal."""

import csv
import functools
from types import SimpleNamespace

import numpy as np
import published
import pytest

from featherstone_gait.base.files import read_csv
from featherstone_gait.optimize import walking_cost
from featherstone_gait.reproduction import other_robots as study
from featherstone_gait.reproduction.tables import write_rows
from featherstone_gait.robot_file import load_robot
from featherstone_gait.walking.cost_in_worlds import in_worlds


@pytest.fixture
def quick(monkeypatch):
    """One robot that the kernels know, one floor, one stride."""
    cost = walking_cost(load_robot("humanoid", locked="simplified"), states="step")
    monkeypatch.setattr(study, "ROBOTS", {"humanoid": study.Robot(lambda: cost, 2, feedback=2)})
    short = functools.partial(study.crosscheck, floors=["20ms_0.9"], strides=1, timestep=1e-3)
    monkeypatch.setattr(study, "crosscheck", short)
    return cost


@pytest.mark.long
def test_a_robot_s_gaits_are_kept_and_walk_on_the_floors(quick, tmp_path, monkeypatch):
    monkeypatch.setattr(study, "WORLDS", 1)
    monkeypatch.setattr(study, "TEST_WORLDS", 2)
    monkeypatch.setattr(study, "pushes_survived", lambda *_, feedback: np.full(8, float(feedback)))
    walked = study.gaits("humanoid", tmp_path)
    rows = study.rows_of("humanoid", tmp_path, *walked)
    gaits = ["first", "2 candidates", "first, feedback", "2 candidates, feedback"]
    assert [row[:2] for row in rows] == [["humanoid", gait] for gait in gaits]
    own = quick.measure([quick.gait.to_vector()])[0]
    assert rows[0][2:5] == [own.cost, own.speed, "20ms_0.9"]
    worlds = study.worth_of("humanoid", tmp_path, *walked)
    assert [row[:3] for row in worlds] == [["humanoid", gait, row[2]] for gait, row in zip(walked[1], rows)]
    assert worlds[0][5:7] == [in_worlds(quick, 1)(quick.gait.to_vector())[0], 1.0]
    assert worlds[0][7] <= worlds[0][8] <= worlds[0][9]
    assert [row[10] for row in worlds] == [0.0, 0.0, 1.0, 1.0]
    monkeypatch.setattr(study, "optimize_gait", None)
    monkeypatch.setattr(study, "measure_in_test_worlds", None)
    again = study.gaits("humanoid", tmp_path)
    assert study.rows_of("humanoid", tmp_path, *again) == rows
    assert study.worth_of("humanoid", tmp_path, *again) == worlds
    write_rows(tmp_path / "worlds.csv", study.WORLDS_TABLE, worlds, study.__file__, study.WORLDS_COLUMNS)
    _, *found = read_csv(tmp_path / "worlds.csv", study.WORLDS_TABLE)
    assert [float(cells[6]) for _, cells in found] == [row[6] for row in worlds]
    write_rows(tmp_path / "table.csv", study.TABLE, rows, study.__file__, study.COLUMNS)
    lines = (tmp_path / "table.csv").read_text("utf-8").splitlines()
    table = [*csv.DictReader(line for line in lines if not line.startswith("#"))]
    assert [(row["mujoco_walks"], float(row["here_speed_m_per_s"])) for row in table] == [("True", r[13]) for r in rows]
    other = walking_cost(load_robot("humanoid", locked="simplified"), states="step", step_length=0.03)
    monkeypatch.setattr(study, "ROBOTS", {"humanoid": study.Robot(lambda: other, 2)})
    with pytest.raises(ValueError, match=r"humanoid_2\.json: belongs to another first gait"):
        study.gaits("humanoid", tmp_path)


@pytest.mark.long
def test_anymal_trots_with_its_file_s_feet_and_servos_scaled_to_it():
    published.folder("example-robot-data")
    cost = study.anymal()
    assert [point.radius for point in cost.scene.model.contacts] == [0.031] * 4
    assert set(cost.scene.model.servos) == set(cost.gait.joint_names)
    found = cost.measure([cost.gait.to_vector()])[0]
    assert found.status == "ok"
    assert found.speed > 0.25


def test_g1_has_the_twelve_joints_of_its_legs_and_the_feet_of_its_file(monkeypatch):
    published.folder("example-robot-data")
    monkeypatch.setattr(study, "cheapest_plan", lambda scene, states: SimpleNamespace(cost=scene))
    model = study.g1().model
    assert len(model.joint_names) == len(set(model.servos)) == 12
    assert {point.link for point in model.contacts} == {"left_ankle_roll_link", "right_ankle_roll_link"}
