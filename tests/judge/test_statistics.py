"""Intervals of shares, and what differs between worlds."""

import numpy as np
import pytest

from featherstone_gait.judge.statistics import Z, causes, cliffs_delta, wilson


@pytest.mark.parametrize(("hits", "count"), [(0, 10), (3, 10), (10, 10), (137, 200), (1000, 1000)])
def test_the_ends_of_an_interval_are_as_far_from_the_share_as_they_say(hits, count):
    """Wilson's ends are the shares p whose own standard deviation is |share - p| / Z."""
    share = hits / count
    for end in wilson(hits, count):
        assert (share - end) ** 2 == pytest.approx(Z**2 * end * (1.0 - end) / count, abs=1e-15)
    low, high = wilson(count - hits, count)
    assert wilson(hits, count) == pytest.approx((1.0 - high, 1.0 - low), abs=1e-15)


def test_of_nothing_nothing_is_known():
    assert wilson(0, 0) == (0.0, 1.0)


def test_cliffs_delta_counts_pairs():
    draws = np.random.default_rng(0)
    a, b = draws.integers(0, 9, 40), draws.integers(2, 12, 25)
    by_pair = np.mean([np.sign(x - y) for x in a for y in b])
    assert cliffs_delta(a, b) == pytest.approx(by_pair, abs=1e-15)
    assert (cliffs_delta(b + 20, a), cliffs_delta(a, b + 20)) == (1.0, -1.0)


def test_the_factor_that_decides_is_found_and_chance_is_not_taken_for_it():
    draws = np.random.default_rng(1)
    factors = {f"factor {k}": draws.normal(size=200) for k in range(60)}
    failing = factors["factor 17"] + 0.3 * draws.normal(size=200) > 1.0
    first, second, *_ = causes(factors, failing)
    assert first.name == "factor 17"
    assert first.effect > 0.9
    assert first.chance < 1e-6 < 0.05 < second.chance
    by_chance = [causes(factors, draws.permutation(failing))[0].chance < 0.05 for _ in range(200)]
    assert np.mean(by_chance) < 0.09  # 0.05 is promised; 3 deviations of 200 draws are 0.046
    assert causes(factors, np.arange(200) < 4) == []
