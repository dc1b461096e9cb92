"""A noisy search believes what is so: its claimed cost is that of fresh draws, where the least of many is not."""

import numpy as np
import pytest

from featherstone_gait.search import AdaptiveSimulatedAnnealing, minimize, minimize_noisy

SIGMA = 0.5  # of the noise; the sphere begins at 4
WAVES = np.random.default_rng(99).normal(0.0, 40.0, 4)
START = np.ones(4)
REPEATS = 8


def sphere(x):
    return float((x**2).sum())


def noisy_sphere(x, draw):
    """Normal noise: that of one draw differs from place to place, that of one place from draw to draw."""
    a, b = np.random.default_rng(draw).normal(0.0, SIGMA, 2)
    return sphere(x) + a * np.sin(WAVES @ x) + b * np.cos(WAVES @ x)


def search(seed=0, iterations=400):
    return AdaptiveSimulatedAnnealing(
        START, amplitude=0.3, max_iterations=iterations, no_progress=iterations + 1, seed=seed
    )


def assert_same(a, b):
    assert (a.fun, a.error, a.nit, a.duels, a.status) == (b.fun, b.error, b.nit, b.duels, b.status)
    assert len(a.history) == len(b.history)
    for one, other in zip(a.history, b.history):
        assert one.iteration == other.iteration
        assert np.array_equal(one.x, other.x)
        assert one.f == other.f


SEEDS = range(12)


@pytest.fixture(scope="module")
def results():
    return [minimize_noisy(noisy_sphere, search(seed), repeats=REPEATS, seed=seed) for seed in SEEDS]


def test_the_believed_cost_is_unbiased(results):
    """All claims, those of past incumbents too, against the known mean; errors of independent draws."""
    claims = [(belief.f - sphere(belief.x), seed) for seed, r in zip(SEEDS, results) for belief in r.history]
    off = np.array([c for c, _ in claims])
    # Each claim is a mean of independent draws.  The means of the duels would miss this by ten standard errors.
    standard_error = SIGMA / np.sqrt(REPEATS * len(off))
    assert len(off) > 500
    assert abs(off.mean()) < 3.5 * standard_error
    last = np.array([result.fun - sphere(result.x) for result in results])
    assert abs(last.mean()) < 3.5 * SIGMA / np.sqrt(REPEATS * len(last))


def test_the_claimed_error_is_the_claims_scatter(results):
    off = np.array([belief.f - sphere(belief.x) for result in results for belief in result.history])
    error = np.array([belief.error for result in results for belief in result.history])
    # The squares of Student's t with 7 degrees of freedom: 1.4 in the mean, with a standard deviation of 2.8.
    assert np.mean((off / error) ** 2) == pytest.approx(1.4, abs=3.5 * 2.8 / np.sqrt(len(off)))


def test_the_naive_search_claims_what_is_not_so(results):
    """Its best is the luckiest of its draws: some two standard deviations below what that place costs."""
    off = []
    for seed in SEEDS:
        draws = iter(range(10**6))
        found = minimize(
            lambda x, draws=draws, seed=seed: noisy_sphere(x, (seed, next(draws))), START,
            amplitude=0.3, max_iterations=400, no_progress=401, seed=seed,
        )  # fmt: skip
        off.append(found.fun - sphere(found.x))
    assert max(off) < 0.0
    assert np.mean(off) < -SIGMA
    assert abs(np.mean([result.fun - sphere(result.x) for result in results])) < 0.5 * abs(np.mean(off))


def test_it_gets_down_as_far_as_the_noise_lets_it(results):
    assert np.median([sphere(result.x) for result in results]) < 0.5 * sphere(START)


@pytest.mark.parametrize("batch", [2, 16])
def test_the_size_of_a_batch_changes_nothing(results, batch):
    assert_same(minimize_noisy(noisy_sphere, search(3), repeats=REPEATS, seed=3, batch=batch), results[3])


def test_a_seed_is_a_sequence(results):
    assert_same(minimize_noisy(noisy_sphere, search(2), repeats=REPEATS, seed=2), results[2])
    other = minimize_noisy(noisy_sphere, search(2), repeats=REPEATS, seed=1000)
    assert other.fun != results[2].fun


def test_no_draw_is_used_twice_but_for_the_two_of_a_duel():
    seen = {}

    def cost(x, draw):
        seen.setdefault(draw, []).append(tuple(x))
        return noisy_sphere(x, draw)

    result = minimize_noisy(cost, search(iterations=100), repeats=3, seed=5)
    assert sum(map(len, seen.values())) == result.nfev
    twice = [xs for xs in seen.values() if len(xs) > 1]
    assert len(twice) == 3 * result.duels
    assert all(len(xs) == 2 and xs[0] != xs[1] for xs in twice)
    # Screening of x0 and of 100 candidates; of x0 a duel without opponent; and a belief for each incumbent.
    assert result.nfev == 101 + 3 + 6 * result.duels + 3 * len(result.history)
    assert all(draw[0] == 5 for draw in seen)


def test_without_noise_it_is_the_search_itself():
    result = minimize_noisy(lambda x, draw: sphere(x), search(), repeats=2)
    alone = minimize(sphere, START, amplitude=0.3, max_iterations=400, no_progress=401)
    assert np.array_equal(result.x, alone.x)
    assert (result.fun, result.error) == (alone.fun, 0.0)
    assert len(result.history) == alone.history["accepted"].sum()
    assert result.duels == len(result.history) - 1


def test_who_falls_in_one_draw_loses():
    """Beyond the cliff every second draw falls."""

    def cost(x, draw):
        falls = x[0] < 0.5 and np.random.default_rng(draw).random() < 0.5
        return (np.inf, "fell") if falls else noisy_sphere(x, draw)

    # A place that falls in every second draw wins a duel of eight once in 256 times.
    result = minimize_noisy(cost, search(1), repeats=REPEATS)
    assert result.success
    assert result.x[0] >= 0.5
    assert result.fun < sphere(START)


def test_a_start_that_falls_is_left():
    result = minimize_noisy(lambda x, draw: np.inf if x[0] > 0.95 else noisy_sphere(x, draw), search(), repeats=4)
    assert result.history[0].f == np.inf
    assert result.success
    assert result.x[0] <= 0.95
    nothing = minimize_noisy(lambda x, draw: np.nan, search(iterations=30), repeats=2)
    assert not nothing.success
    assert np.array_equal(nothing.x, START)
    assert "finite" in nothing.message


def test_an_interrupt_returns_the_best_believed():
    calls = iter(range(300))

    def cost(x, draw):
        if next(calls, None) is None:
            raise KeyboardInterrupt
        return noisy_sphere(x, draw)

    result = minimize_noisy(cost, search(), repeats=REPEATS)
    assert (result.status, result.success) == (2, False)
    assert result.fun == result.history[-1].f
    assert np.array_equal(result.x, result.history[-1].x)


def test_settings_out_of_range_are_named():
    with pytest.raises(ValueError, match="repeats is 1; expected a whole number from 2"):
        minimize_noisy(noisy_sphere, search(), repeats=1)
    with pytest.raises(ValueError, match="batch is 0; expected a whole number from 1"):
        minimize_noisy(noisy_sphere, search(), batch=0)
    begun = search()
    begun.tell(begun.ask(), 4.0)
    with pytest.raises(ValueError, match="has begun"):
        minimize_noisy(noisy_sphere, begun)
