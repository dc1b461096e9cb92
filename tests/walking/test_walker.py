"""Robots that are to walk, from a file that says nothing of base, contacts or servos."""

from pathlib import Path

import numpy as np
import pytest

from featherstone_gait import load_robot
from featherstone_gait.optimize import OptimizeOptions, main_job, planning
from featherstone_gait.optimize.preparation import prepare
from featherstone_gait.walking import BIOLOID_WALK
from featherstone_gait.walking.generic_servo import LEG, MASS
from featherstone_gait.walking.walker import MARGIN, driven, leg_length, load_walker

HUMANOID = Path(load_robot("humanoid").source)
LEGS = ("hip", "knee", "ankle")


@pytest.fixture
def bare(tmp_path):
    """The humanoid's URDF alone."""
    path = tmp_path / "biped.urdf"
    path.write_bytes(HUMANOID.read_bytes())
    return path


def test_a_bare_file_s_robot_floats_on_its_feet_and_may_hold_all_but_its_legs(bare):
    whole, legs = load_walker(bare), load_walker(bare, legs_only=True)
    own = load_robot("humanoid", locked={})
    assert (whole.base, whole.joint_names) == ("floating", own.joint_names)
    assert {point.link for point in whole.contacts} == {point.link for point in own.contacts}
    assert not whole.servos
    assert legs.joint_names == tuple(name for name in own.joint_names if any(part in name for part in LEGS))
    assert legs.mass == pytest.approx(own.mass, rel=1e-12)
    few = load_walker(bare, joints=legs.joint_names[:3])
    assert few.joint_names == legs.joint_names[:3]
    with pytest.raises(ValueError, match=r"joints: 'tail' is no moving joint of"):
        load_walker(bare, joints=["tail"])


def test_what_a_robot_s_own_files_say_is_kept():
    found, own = load_walker("humanoid"), load_robot("humanoid", locked="simplified")
    few = load_walker("humanoid", joints=own.joint_names[:3])  # what is held already stays so
    assert few.joint_names == own.joint_names[:3]
    for what in ("base", "links", "joints", "contacts", "servos"):
        assert getattr(found, what) == getattr(own, what)


def test_generic_servos_are_as_strong_as_mass_and_legs_ask_for(bare):
    robot = load_walker(bare, legs_only=True)
    assert leg_length(robot) == pytest.approx(LEG, abs=0.05)
    servo = driven(robot, "generic").servos[robot.joint_names[0]]
    known = driven(robot, "ax12").servos[robot.joint_names[0]]
    ratio = servo.motor_constant / servo.resistance / (known.motor_constant / known.resistance)
    assert ratio == pytest.approx(MARGIN * robot.mass * leg_length(robot) / (MASS * LEG), rel=1e-12)
    assert servo.motor_constant / known.motor_constant == pytest.approx(np.sqrt(leg_length(robot) / LEG), rel=1e-12)
    assert set(driven(robot, "generic").servos) == set(robot.joint_names)
    stronger = driven(robot, f"generic:{3.0 * MARGIN}").servos[robot.joint_names[0]]
    assert servo.resistance / stronger.resistance == pytest.approx(3.0, rel=1e-12)
    for wrong in ("generic:much", "generic:-1"):
        with pytest.raises(ValueError, match=r"give generic, or how many times|margin is -1"):
            driven(robot, wrong)


def test_a_search_of_a_robot_without_servos_says_what_to_do(bare, tmp_path):
    with pytest.raises(ValueError, match=r"humanoid has no servos; name one \(--servo\): 'generic' is"):
        main_job(bare, OptimizeOptions(out=tmp_path))


@pytest.mark.long
def test_a_bare_file_s_robot_walks_with_generic_servos(bare, tmp_path):
    how = {"servo": "generic", "legs_only": True, "iterations": 2, "worlds": 0, "test_worlds": 0}
    report = main_job(bare, OptimizeOptions(**how, out=tmp_path, progress=False))
    assert report["after"]["status"] == "ok"
    assert report["after"]["speed"] > 0.05


def test_a_plain_plan_that_falls_gives_way_to_the_cheapest_and_says_so(bare, tmp_path, monkeypatch, capsys):
    asked = []

    def plan_first_gait(_, plan):
        asked.append(plan)
        raise ValueError("out of reach" if plan == "plain" else "no plan walks")

    def gentle_plan(*_, **__):
        raise ValueError("none of 4 plans of slow steps walks")

    monkeypatch.setattr(planning, "plan_first_gait", plan_first_gait)
    monkeypatch.setattr(planning, "_check_strength", lambda job: None)  # by one plan more
    job = prepare(bare, OptimizeOptions(servo="generic", legs_only=True, out=tmp_path))
    start = planning.plan_start(job)  # of a plan of slow steps
    assert start.failure == "ok"
    assert f"a plan of slow steps walks, at {start.value:.1f} J/m" in capsys.readouterr().out
    monkeypatch.setattr(planning, "gentle_plan", gentle_plan)
    with pytest.raises(ValueError, match="no plan walks"):
        planning.plan_start(job)
    assert asked == ["plain", "plain", "cheapest"]
    told = capsys.readouterr().out
    assert "plain plan: out of reach; searching for the cheapest plan that walks" in told
    assert "none of 4 plans of slow steps walks. Other plans are tried all the same" in told


def test_a_plan_that_is_named_is_not_replaced(bare, tmp_path, monkeypatch):
    monkeypatch.setattr(planning, "_check_strength", lambda job: None)  # by one plan more
    monkeypatch.setitem(BIOLOID_WALK, "com_height", 0.5)
    options = OptimizeOptions(servo="generic", legs_only=True, plan="plain", out=tmp_path, progress=False)
    with pytest.raises(ValueError, match="cannot reach"):
        main_job(bare, options)


def test_a_setting_that_a_plan_cannot_keep_is_named_before_anything_is_planned(bare, tmp_path):
    with pytest.raises(ValueError, match="stride_length"):
        main_job(bare, OptimizeOptions(servo="ax12", out=tmp_path, walk={"stride_length": 0.1}, progress=False))
