"""Other readings of the paper's search: when it re-heats, how many angles it perturbs."""

from itertools import pairwise

import numpy as np
import pytest

from featherstone_gait.reproduction.search_rules import CORRECTED, RULES, FewerAngles, LiteralTest, visits
from featherstone_gait.search import AdaptiveSimulatedAnnealing, minimize

D = 40
HOW = {"amplitude": 0.1, "max_miss": 5, "max_iterations": 30, "no_progress": 30, "seed": 3}


def searched(kind, fun, **how):
    def evaluate(candidates):
        while (candidate := candidates.take()) is not None:
            candidates.give(candidate, fun(candidate.x))

    search = kind(np.zeros(D), **HOW | how)
    return visits(search, evaluate), search


def sphere(x):
    return float(((x - 0.05) ** 2).sum())


def constant(x):
    return 1.0


def test_a_literal_test_re_heats_once_before_the_next_improvement():
    counts = [v.miss for v in searched(LiteralTest, constant)[1].visited[1:]]
    np.testing.assert_allclose(counts, [1, 2, 3, 4, *(0.1 + np.arange(26))])
    again = [v.miss for v in searched(AdaptiveSimulatedAnnealing, constant)[1].visited[1:]]
    np.testing.assert_allclose(again, [1, 2, 3, 4, *(0.1 + np.arange(26) % 5)])
    for kind in (LiteralTest, AdaptiveSimulatedAnnealing):
        found = searched(kind, sphere)[1].visited
        assert all(after.miss == 1.0 for before, after in pairwise(found) if before.accepted)


def test_fewer_angles_are_perturbed_the_more_misses_there_are():
    search = FewerAngles(np.zeros(D), **HOW)
    whole = AdaptiveSimulatedAnnealing(np.zeros(D), **HOW)
    for miss, count in ((0.1, 40), (1.0, 40), (1.1, 37), (2.0, 20), (3.0, 14), (19.1, 3), (100.0, 1)):
        x = search.candidate(7, np.zeros(D), miss)
        assert np.count_nonzero(x) == count
        np.testing.assert_array_equal(x[x != 0.0], whole.candidate(7, np.zeros(D), 1.0)[x != 0.0])
    others = [tuple(np.flatnonzero(search.candidate(k, np.zeros(D), 8.0))) for k in range(1, 100)]
    assert len(set(others)) == 99  # drawn anew each time
    assert {k for one in others for k in one} == set(range(D))


@pytest.mark.parametrize("kind", [AdaptiveSimulatedAnnealing, LiteralTest, FewerAngles])
def test_a_search_visits_what_it_visits_one_at_a_time(kind):
    history, search = searched(kind, sphere)
    alone = kind(np.zeros(D), **HOW)
    while alone.status is None:
        x = alone.ask()
        alone.tell(x, sphere(x))
    np.testing.assert_array_equal(history["x"], [one.x for one in alone.visited])
    assert history["f"][history["accepted"]][-1] == search.best_f < sphere(np.zeros(D))
    if kind is AdaptiveSimulatedAnnealing:
        np.testing.assert_array_equal(history["x"], minimize(sphere, np.zeros(D), **HOW).history["x"])


def test_each_rule_changes_one_thing():
    first = RULES[CORRECTED]
    changes = [sum(a != b for a, b in zip(first, rule)) for name, rule in RULES.items() if name != CORRECTED]
    assert changes == [1] * 6
