"""Stored gaits are what the reports beside them say, from which README and pages take their tables."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from featherstone_gait import load_robot
from featherstone_gait.optimize import OptimizeOptions, walking_cost
from featherstone_gait.optimize.planning import plan_first_gait
from featherstone_gait.optimize.preparation import prepare
from featherstone_gait.optimize.quality import FINER, TEST_SEED, TEST_STRIDES, TEST_WORLDS, measure_limits
from featherstone_gait.walking.cost_in_worlds import CostInWorlds, in_worlds
from featherstone_gait.walking.limits import Watch
from featherstone_gait.walking.motion import read_motion

ROOT = Path(__file__).parents[2]
STORED = ROOT / "robots" / "humanoid" / "optimized_gait.npz"
REPORT = json.loads(STORED.with_suffix(".json").read_text("utf-8"))
SUBSET = 24  # of the unseen worlds, the first ones


@pytest.fixture(scope="module")
def cost():
    return walking_cost(load_robot("humanoid", locked="simplified"), states="step")


@pytest.fixture(scope="module")
def x():
    with np.load(STORED) as data:
        return data["x"]


def test_the_stored_gait_says_which_command_found_it(cost, x):
    settings = REPORT["settings"]
    assert REPORT["command"] == "featherstone-gait optimize --crosscheck"
    assert (settings["seed"], settings["iterations"], settings["worlds"]) == (0, 800, 8)
    motion = read_motion(STORED, cost.gait.joint_names)
    assert motion.poses.tobytes() == cost.gait.from_vector(x).poses.tobytes()
    assert motion.stride[:, 0].max() > motion.stride[:, 0].min()


@pytest.mark.long
def test_energy_and_speed_are_those_of_the_report(cost, x):
    with np.load(STORED) as data:
        found = cost.measure([data["first"], x])
    for measures, reported in zip(found, (REPORT["before"], REPORT["after"])):
        assert (measures.cost, measures.speed) == (reported["cost"], reported["speed"])


@pytest.mark.long
def test_costs_in_unseen_worlds_are_those_of_the_report(cost, x):
    """The report has all 200; the first ones are walked again."""
    each = np.array([np.inf if one is None else one for one in REPORT["elsewhere"]["after"]["each"]])
    walks = np.isfinite(each)
    assert len(each) == TEST_WORLDS
    assert REPORT["elsewhere"]["after"]["walks"] == walks.mean() >= 0.95
    assert REPORT["elsewhere"]["after"]["cost"] == pytest.approx(np.percentile(each[walks], (5, 50, 95)))
    longer = replace(cost, strides=TEST_STRIDES)
    every = in_worlds(longer, TEST_WORLDS, TEST_SEED, timestep=FINER * cost.scene.timestep)
    some = CostInWorlds(longer, every.scenes[:SUBSET], every.offsets[:SUBSET], strict=True)
    costs = np.array([one.cost for one in some.measure([x])[0]])
    assert costs == pytest.approx(each[:SUBSET], rel=1e-12)


@pytest.mark.long
def test_limits_are_those_of_the_report(cost, x):
    found = measure_limits(cost, x, Watch(cost.scene.model, cost.start[0]))["limits"]
    reported = REPORT["plausible"]["after"]["limits"]
    assert [one["name"] for one in found] == [one["name"] for one in reported]
    assert [one["value"] for one in found] == pytest.approx([one["value"] for one in reported], rel=1e-9)
    assert all(one["kept"] for one in found)


@pytest.mark.long
@pytest.mark.parametrize("servo", ["ax12", "ax12a"])
def test_gaits_of_other_seeds_are_those_of_their_reports(servo, tmp_path):
    names = ["seed_1", "seed_2"] if servo == "ax12" else ["ax12a_0", "ax12a_1", "ax12a_2"]
    paths = [ROOT / "docs" / "reproduction" / f"gait_{name}.npz" for name in names]
    reports = [json.loads(path.with_suffix(".json").read_text("utf-8")) for path in paths]
    vectors = []
    for path in paths:
        with np.load(path) as data:
            vectors.append(data["x"])
    job = prepare("humanoid", OptimizeOptions(servo=servo, out=tmp_path, progress=False))
    cost = plan_first_gait(job, reports[0]["settings"]["plan"]).cost
    assert [one.cost for one in cost.measure(vectors)] == [report["after"]["cost"] for report in reports]
    watch = Watch(cost.scene.model, cost.start[0])
    for x, report in zip(vectors, reports):
        found = {one["name"]: one["value"] for one in measure_limits(cost, x, watch)["limits"]}
        assert found == pytest.approx({one["name"]: one["value"] for one in report["plausible"]["after"]["limits"]})
