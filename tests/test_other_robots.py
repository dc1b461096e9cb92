"""Gaits of other robots in MuJoCo: searches that are kept, rows that are those of the crosscheck, and ANYmal."""

import csv
import functools

import published
import pytest

from featherstone_gait.experiments import other_robots as study
from featherstone_gait.optimize import walking_cost
from featherstone_gait.robot_file import load_robot


@pytest.fixture
def quick(monkeypatch):
    """One robot that the kernels know, one floor, one stride."""
    cost = walking_cost(load_robot("humanoid", locked="simplified"), states="step")
    monkeypatch.setattr(study, "ROBOTS", {"humanoid": study.Robot(lambda: cost, 2)})
    short = functools.partial(study.crosscheck, floors=["20ms_0.9"], strides=1, timestep=1e-3)
    monkeypatch.setattr(study, "crosscheck", short)
    return cost


@pytest.mark.long
def test_a_robot_s_gaits_are_kept_and_walk_on_the_floors(quick, tmp_path, monkeypatch):
    monkeypatch.setattr(study, "WORLDS", 1)
    rows = study.rows_of("humanoid", tmp_path)
    assert [row[:2] for row in rows] == [["humanoid", "first"], ["humanoid", "2 candidates"]]
    own = quick.measure([quick.gait.to_vector()])[0]
    assert rows[0][2:5] == [own.cost, own.speed, "20ms_0.9"]
    monkeypatch.setattr(study, "optimize_gait", None)
    assert study.rows_of("humanoid", tmp_path) == rows
    study.write_table(tmp_path / "table.csv", rows)
    lines = (tmp_path / "table.csv").read_text("utf-8").splitlines()
    table = [*csv.DictReader(line for line in lines if not line.startswith("#"))]
    assert [(row["mujoco_walks"], float(row["here_speed_m_per_s"])) for row in table] == [("True", r[13]) for r in rows]
    other = walking_cost(load_robot("humanoid", locked="simplified"), states="step", step_length=0.03)
    monkeypatch.setattr(study, "ROBOTS", {"humanoid": study.Robot(lambda: other, 2)})
    with pytest.raises(ValueError, match=r"humanoid_2\.json: is of another first gait"):
        study.rows_of("humanoid", tmp_path)


@pytest.mark.long
def test_anymal_trots_with_its_file_s_feet_and_servos_scaled_to_it():
    published.folder("example-robot-data")
    cost = study.anymal()
    assert [point.radius for point in cost.scene.model.contacts] == [0.031] * 4
    assert set(cost.scene.model.servos) == set(cost.gait.joint_names)
    found = cost.measure([cost.gait.to_vector()])[0]
    assert found.status == "ok"
    assert found.speed > 0.25
