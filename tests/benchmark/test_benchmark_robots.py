"""Published robots that walk: ANYmal and the G1."""

from types import SimpleNamespace

import published
import pytest

from featherstone_gait.benchmark import robots


@pytest.mark.long
def test_anymal_trots_with_its_file_s_feet_and_servos_scaled_to_it():
    published.folder("example-robot-data")
    cost = robots.anymal()
    assert [point.radius for point in cost.scene.model.contacts] == [0.031] * 4
    assert set(cost.scene.model.servos) == set(cost.gait.joint_names)
    found = cost.measure([cost.gait.to_vector()])[0]
    assert found.status == "ok"
    assert found.speed > 0.25


def test_g1_has_the_twelve_joints_of_its_legs_and_the_feet_of_its_file(monkeypatch):
    published.folder("example-robot-data")
    monkeypatch.setattr(robots, "cheapest_plan", lambda scene, states: SimpleNamespace(cost=scene))
    model = robots.g1().model
    assert len(model.joint_names) == len(set(model.servos)) == 12
    assert {point.link for point in model.contacts} == {"left_ankle_roll_link", "right_ankle_roll_link"}
