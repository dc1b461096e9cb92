"""The gait that `featherstone-gait optimize` finds is kept in robots/humanoid, and is what the README says."""

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from featherstone_gait import load_robot
from featherstone_gait.optimize import walking_cost
from featherstone_gait.optimize.quality import FINER, TEST_SEED, TEST_STRIDES, TEST_WORLDS, measure_limits
from featherstone_gait.walking.cost_in_worlds import CostInWorlds, in_worlds
from featherstone_gait.walking.limits import Watch
from featherstone_gait.walking.motion import read_motion

ROOT = Path(__file__).parents[2]
STORED = ROOT / "robots" / "humanoid" / "optimized_gait.npz"
README = (ROOT / "README.md").read_text("utf-8")
SUBSET = 24  # of the unseen worlds, the first ones


def figures(row):
    """The numbers of the gait found, the second column of the README's row."""
    (line,) = (line for line in README.splitlines() if line.startswith(f"| {row}"))
    return [float(x) for x in re.findall(r"\d+(?:\.\d+)?", line.split("|")[3])]


@pytest.fixture(scope="module")
def cost():
    return walking_cost(load_robot("humanoid", locked="simplified"), states="step")


@pytest.fixture(scope="module")
def x():
    with np.load(STORED) as data:
        return data["x"]


def test_the_stored_gait_says_which_command_found_it(cost, x):
    told = json.loads(STORED.with_suffix(".json").read_text("utf-8"))
    assert told["command"] == "featherstone-gait optimize --crosscheck"
    assert (told["settings"]["seed"], told["settings"]["iterations"], told["settings"]["worlds"]) == (0, 800, 8)
    motion = read_motion(STORED, cost.gait.joint_names)
    assert motion.poses.tobytes() == cost.gait.from_vector(x).poses.tobytes()
    assert motion.stride[:, 0].max() > motion.stride[:, 0].min()


@pytest.mark.long
def test_the_readme_s_energy_and_speed_are_those_of_the_stored_gait(cost, x):
    """To the digits that it prints."""
    measures = cost.measure([x])[0]
    energy, speed = figures("energy per distance, speed on its own floor")
    assert (round(measures.cost, 1), round(1e3 * measures.speed)) == (energy, speed)


@pytest.mark.long
def test_the_readme_s_share_and_costs_hold_in_some_of_the_unseen_worlds(cost, x):
    """All 200 by what the command wrote; of these the first ones are walked again."""
    told = json.loads(STORED.with_suffix(".json").read_text("utf-8"))["elsewhere"]["after"]["each"]
    each = np.array([math.inf if one is None else one for one in told])
    walks = np.isfinite(each)
    low, high = np.percentile(each[walks], (5, 95))
    assert len(each) == TEST_WORLDS
    assert figures("walks 20 strides in 200 other worlds") == [100.0 * walks.mean(), round(low, 1), round(high, 1)]
    assert walks.mean() >= 0.95
    longer = replace(cost, strides=TEST_STRIDES)
    every = in_worlds(longer, TEST_WORLDS, TEST_SEED, timestep=FINER * cost.scene.timestep)
    some = CostInWorlds(longer, every.scenes[:SUBSET], every.offsets[:SUBSET], strict=True)
    costs = np.array([one.cost for one in some.measure([x])[0]])
    assert costs == pytest.approx(each[:SUBSET], rel=1e-12)


@pytest.mark.long
def test_the_readme_s_limits_are_those_of_the_stored_gait(cost, x):
    found = measure_limits(cost, x, Watch(cost.scene.model, cost.start[0]))["limits"]
    kept = sum(one["kept"] for one in found)
    assert figures("keeps to what a real robot asks for")[0] == kept
