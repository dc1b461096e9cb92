"""The gradient of the cost of walking, against differences that are too short to change a contact's step."""

from dataclasses import replace

import numpy as np
import pytest

from featherstone_gait import load_robot
from featherstone_gait.optimize import walking_cost
from featherstone_gait.walking import cost_and_gradient
from featherstone_gait.walking.cost_in_worlds import in_worlds

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def cost():
    return replace(walking_cost(load_robot("humanoid", locked="simplified")), warm_up=0, strides=1)


def test_the_gradient_of_the_first_gait_is_that_of_short_differences(cost):
    x = cost.gait.to_vector()
    with pytest.warns(RuntimeWarning, match=r"doubtful: .*foot"):  # over widths that move its steps
        value, slope = cost_and_gradient(cost, x)
    assert (value, "ok") == cost(x)
    along = slope / np.linalg.norm(slope)
    widths = np.array([2e-7, 1e-7])
    ends = np.array([one for one, _ in cost.costs([x + sign * w * along for w in widths for sign in (1.0, -1.0)])])
    first, second = (ends[::2] - ends[1::2]) / (2.0 * widths)
    assert first == pytest.approx(second, rel=1e-6)  # they have converged
    assert np.linalg.norm(slope) == pytest.approx(second, rel=1e-6)


def test_the_cost_in_worlds_is_a_mean_and_a_share_of_the_worst(cost):
    worlds = in_worlds(cost, 2)
    x = cost.gait.to_vector()
    with pytest.warns(RuntimeWarning, match="2 of 2 gradients are doubtful"):
        value, slope = cost_and_gradient(worlds, x, threads=2)
    alone = cost_and_gradient(worlds, x, threads=1)
    assert value == alone[0]
    assert slope.tobytes() == alone[1].tobytes()
    assert value == worlds.costs([x])[0][0]


def test_a_gait_that_falls_has_no_gradient(cost):
    value, slope = cost_and_gradient(cost, cost.gait.to_vector() + 0.5)
    assert value == np.inf
    assert np.isnan(slope).all()
