"""Experiments that the paper does not have: other searches, disturbances, the complete robot."""

from dataclasses import replace

import numpy as np
import pytest

from featherstone_gait import load_robot
from featherstone_gait.optimize import walking_cost
from featherstone_gait.reproduction import complete_humanoid, method_comparison, robustness
from featherstone_gait.search import AdaptiveSimulatedAnnealing, run
from featherstone_gait.walking import WalkingCost

pytestmark = pytest.mark.long

METHODS = replace(method_comparison.QUICK, evaluations=24)
ROBUST = replace(
    robustness.QUICK, iterations=30, searches=1, robots=2, friction=(0.4, 0.95), slope=(-1.0, 0.0, 1.0),
    mass=(0.9, 1.0, 1.1), supply=(10.0, 12.0), backlash=(0.0, 1.0), push=(0.0, 50.0),
)  # fmt: skip
COMPLETE = replace(complete_humanoid.QUICK, iterations=30, searches=1)


@pytest.fixture(scope="module")
def methods():
    return method_comparison.run(METHODS)


@pytest.fixture(scope="module")
def robust():
    return robustness.run(ROBUST)


@pytest.fixture(scope="module")
def complete():
    return complete_humanoid.run(COMPLETE)


def report(module, result):
    """Claims, after the figures have been drawn."""
    for figure in module.plot(result).values():
        figure.draw_without_rendering()
    claims = module.check(result)
    assert all(claim.paper == "" and claim.ours and claim.why for claim in claims)
    return claims


def test_all_methods_start_from_the_planned_gait_and_get_equal_evaluations(methods):
    pytest.importorskip("cma")
    assert set(methods.best) == set(method_comparison.METHODS)
    for best in methods.best.values():
        assert best.shape == (METHODS.searches, METHODS.evaluations)
        # Differential evolution moves the first gait by its last bit, which a walk of 8 s makes 1e-6 at most.
        np.testing.assert_allclose(best[:, 0], methods.best[method_comparison.PAPERS][0, 0], rtol=1e-6)
        assert (np.diff(best, axis=1) <= 0.0).all()
    report(method_comparison, methods)


def test_a_method_among_others_does_what_it_does_alone(methods):
    cost = walking_cost(load_robot("humanoid", locked="simplified"))
    alone = run(
        method_comparison._search(METHODS, cost, method_comparison.PAPERS, 1), cost,
        evaluations=METHODS.evaluations, map=WalkingCost.costs, batch=4,
    )  # fmt: skip
    np.testing.assert_array_equal(alone.history["best"], methods.best[method_comparison.PAPERS][1])


def test_without_cma_the_claim_says_so(monkeypatch):
    def missing(*_, **__):
        raise ImportError("CMA-ES needs the package cma")

    monkeypatch.setattr(method_comparison, "cma_es", missing)
    result = method_comparison.run(replace(METHODS, evaluations=2))
    assert result.missing == ("CMA-ES",)
    (claim,) = (claim for claim in report(method_comparison, result) if "CMA-ES" in claim.claim)
    assert "not installed" in claim.ours
    assert "pip install" in claim.why


def test_the_papers_search_perturbs_by_the_same_amplitude_as_the_others():
    cost = walking_cost(load_robot("humanoid", locked="simplified"))
    search = method_comparison._search(METHODS, cost, method_comparison.PAPERS, 0)
    assert isinstance(search, AdaptiveSimulatedAnnealing)
    assert (search.amplitude == METHODS.amplitude).all()


def test_a_disturbance_of_no_size_changes_nothing(robust):
    for key in (("friction", 0.95), ("slope", 0.0), ("mass", 1.0), ("supply", 10.0), ("backlash", 0.0)):
        np.testing.assert_array_equal(robust.costs[key], robust.nominal)
    for direction in robustness.DIRECTIONS:
        np.testing.assert_allclose(robust.costs[robustness.PUSHED, (direction, 0.0)], robust.nominal, rtol=1e-6)


def test_disturbances_do_what_physics_says(robust):
    """Uphill, a stride lifts the robot by 58 mm tan 1 deg: 24 N over 1 m times 0.035 between the slopes is 0.8 J/m."""
    cost = {key: costs[0] for key, costs in robust.costs.items()}  # of the planned gait
    assert cost["slope", 1.0] > cost["slope", -1.0]
    assert cost["mass", 1.1] > cost["mass", 0.9]
    for direction in ("left", "right"):
        assert np.isinf(robust.costs[robustness.PUSHED, (direction, 50.0)]).all()  # 5 N s on 2.4 kg: 2 m/s
    assert {cost["uncertain masses", k] for k in range(2)}.isdisjoint(robust.nominal)


def test_what_is_claimed_of_robustness(robust):
    claims = report(robustness, robust)
    assert len(claims) == 5
    assert robust.gaits == ("planned", "found 1", "knew 1")
    assert robust.nominal[1] < robust.nominal[0]


@pytest.mark.parametrize("fallen", [[1], [0], [0, 1, 2]])
def test_gaits_that_fall_are_counted_and_not_divided_by(robust, fallen):
    """Whichever gaits fall undisturbed, and with them under each disturbance."""
    fall = lambda costs: np.where(np.isin(range(len(costs)), fallen), np.inf, costs)  # noqa: E731
    costs = {key: fall(each) for key, each in robust.costs.items()}
    with np.errstate(all="raise"):
        claims = robustness.check(
            replace(robust, nominal=fall(robust.nominal), finer=fall(robust.finer), costs=costs)
        )
    assert "fall" in str(claims)
    assert "nan" not in str(claims)
    if 0 in fallen:
        assert "-100%" not in str(claims)


def test_the_complete_humanoid_walks_and_gains(complete):
    simple, walk = complete.walks["simplified"], complete.walks["complete"]
    assert len(walk.joints) == 19
    assert walk.poses.shape == (1, 4, 19)
    assert set(simple.joints) < set(walk.joints)
    assert len(simple.joints) == 10
    for each in (simple, walk):
        assert each.first.measures.status == "ok"
        assert (each.gains < 0.0).all()
    # Servos that hold the arms where the simplified has them rigid: about as dear before the search.
    assert walk.best[0, 0] == pytest.approx(simple.best[0, 0], rel=0.3)


def test_what_is_claimed_of_the_complete_humanoid(complete):
    assert report(complete_humanoid, complete)[0].verdict == "reproduced"
