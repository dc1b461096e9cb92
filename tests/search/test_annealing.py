"""Adaptive simulated annealing: what it finds, and that it visits the same states however it is run."""

import json
import logging
import random
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from featherstone_gait.search import AdaptiveSimulatedAnnealing, minimize
from featherstone_gait.search.annealing import _noise, _reflect
from featherstone_gait.search.speculation import Speculation

SETTINGS = dict(amplitude=0.3, max_miss=20, max_iterations=300, no_progress=1000, seed=7)


def sphere(x):
    return float((x**2).sum())


def rosenbrock(x):
    return float((100.0 * (x[1:] - x[:-1] ** 2) ** 2 + (1.0 - x[:-1]) ** 2).sum())


def assert_same_visits(a, b):
    for key in ("x", "f", "miss", "accepted"):
        assert np.array_equal(a.history[key], b.history[key], equal_nan=key == "f"), key
    assert np.array_equal(a.x, b.x)
    assert (a.fun, a.nit, a.status) == (b.fun, b.nit, b.status)


def test_it_finds_the_least_of_a_sphere():
    result = minimize(sphere, np.full(4, 2.0), amplitude=0.5, max_iterations=3000, no_progress=3000)
    assert result.success
    assert result.fun < 1e-3
    assert result.fun == sphere(result.x)


def test_it_gets_down_into_the_valley_of_rosenbrock():
    x0 = np.full(10, -1.0)
    result = minimize(rosenbrock, x0, amplitude=0.3, max_iterations=3000, no_progress=3000)
    assert result.fun < 0.03 * rosenbrock(x0)


def test_best_cost_never_rises_and_only_improvements_are_accepted():
    history = minimize(rosenbrock, np.zeros(5), **SETTINGS).history
    best = np.minimum.accumulate(history["f"])
    assert np.array_equal(history["accepted"][1:], history["f"][1:] < best[:-1])


@pytest.mark.parametrize("n", [0, 1, 57])
def test_evaluations_are_counted_exactly(n):
    calls = []

    def cost(x):
        calls.append(x)
        return sphere(x)

    result = minimize(cost, np.ones(3), **{**SETTINGS, "max_iterations": n})
    assert len(calls) == result.nfev == n + 1
    assert result.nit == n
    assert result.status == 0


def test_a_seed_is_a_sequence():
    first, again = (minimize(sphere, np.ones(6), **SETTINGS) for _ in range(2))
    assert_same_visits(first, again)
    other = minimize(sphere, np.ones(6), **{**SETTINGS, "seed": 8})
    assert not np.array_equal(first.history["x"][1], other.history["x"][1])


def philox4x64(counter, key):
    """One block of Philox4x64-10 (Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", SC 2011)."""
    (a, b, c, d), (k, l), word = counter, key, 2**64
    for _ in range(10):
        p, q = 0xD2E7470EE14C6C93 * a, 0xCA5A826395121157 * c
        a, b, c, d = (q // word) ^ b ^ k, q % word, (p // word) ^ d ^ l, p % word
        k, l = (k + 0x9E3779B97F4A7C15) % word, (l + 0xBB67AE8584CAA73B) % word
    return [a, b, c, d]


@pytest.mark.parametrize(("seed", "iteration"), [(0, 1), (7, 2999), (2**63, 1)])
def test_the_noise_is_the_published_generators(seed, iteration):
    blocks = [philox4x64((block, iteration, 0, 0), (seed, 0)) for block in (1, 2)]
    expected = [word // 2**11 * 2.0**-52 - 1.0 for block in blocks for word in block]
    assert _noise(seed, iteration, 8).tolist() == expected


def test_the_noise_is_uniform_and_uncorrelated():
    noise = np.concatenate([_noise(3, k, 40) for k in range(2000)])
    assert noise.min() >= -1.0
    assert noise.max() < 1.0
    assert abs(noise.mean()) < 4.0 / np.sqrt(3 * noise.size)
    assert noise.var() == pytest.approx(1 / 3, abs=4 * np.sqrt(4 / 45 / noise.size))
    assert abs(np.corrcoef(_noise(3, 1, 5000), _noise(3, 2, 5000))[0, 1]) < 4 / np.sqrt(5000)


@pytest.mark.parametrize("batch", [8, 16, 64])
@pytest.mark.parametrize("bounds", [None, np.tile([-0.5, 1.0], (6, 1))])
def test_a_speculative_batch_visits_the_very_same_states(batch, bounds):
    one = minimize(rosenbrock, np.ones(6) * 0.3, bounds=bounds, **SETTINGS)
    many = minimize(rosenbrock, np.ones(6) * 0.3, bounds=bounds, batch=batch, **SETTINGS)
    assert_same_visits(one, many)
    assert many.wasted > 0
    assert many.nfev == one.nfev + many.wasted


def in_threads(count, fun=rosenbrock, steps=None):
    """What `minimize` takes as `evaluate`: that many threads.

    Each evaluation takes the next of the numbers of steps, between which it is given up if it is no longer wanted.
    """

    def evaluate(candidates):
        def work(_):
            while (candidate := candidates.take()) is not None:
                assert candidates.begun < 20_000  # one that is lost is waited for without end
                left = 0 if steps is None else next(steps)
                while left and candidates.wanted(candidate):
                    left -= 1
                if not left:
                    candidates.give(candidate, fun(candidate.x))

        with ThreadPoolExecutor(count) as pool:
            list(pool.map(work, range(count)))

    return evaluate


@pytest.mark.parametrize("threads", [1, 8, 16, 64])
@pytest.mark.parametrize("bounds", [None, np.tile([-0.5, 1.0], (6, 1))])
def test_threads_that_do_not_wait_for_one_another_visit_the_very_same_states(threads, bounds):
    settings = SETTINGS | {"bounds": bounds}
    one = minimize(rosenbrock, np.ones(6) * 0.3, **settings)
    many = minimize(rosenbrock, np.ones(6) * 0.3, evaluate=in_threads(threads), **settings)
    assert_same_visits(one, many)
    assert many.nfev == one.nfev + many.wasted


@pytest.fixture
def restless():
    """Python changes threads every microsecond instead of every 5 ms, so that they meet in the middle of everything."""
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(interval)


@pytest.mark.parametrize("seed", range(8))
def test_no_interleaving_changes_the_states_visited(tmp_path, restless, seed):
    """A few evaluations take ten times as long as most: they overtake one another in many ways."""
    rng = random.Random(seed)
    steps = iter(lambda: int(300 * rng.random() ** 4), None)
    settings = SETTINGS | {"seed": seed, "max_miss": 6, "no_progress": 60, "max_iterations": 150}

    def cost(x):
        return np.nan if x[0] > 0.6 else rosenbrock(x)

    one = minimize(cost, np.zeros(4), history=tmp_path / "one", **settings)
    evaluate = in_threads(2 + 2 * seed, cost, steps)
    many = minimize(cost, np.zeros(4), evaluate=evaluate, history=tmp_path / "many", **settings)
    assert_same_visits(one, many)
    assert (tmp_path / "one").read_bytes() == (tmp_path / "many").read_bytes()


def test_a_candidate_that_may_still_come_is_wanted_while_an_answer_is_taken_in():
    """Else who asks just then would give it up, nobody would finish it, and the search would wait for ever."""
    candidates = Speculation(AdaptiveSimulatedAnnealing(np.ones(2), amplitude=0.1))
    candidates.give(candidates.take(), 1.0)
    _, second, third = (candidates.take() for _ in range(3))
    asked = []

    class Cost(float):
        def __lt__(self, other):
            asked.append(pool.submit(candidates.wanted, third))
            time.sleep(0.02)
            return float(self) < other

    with ThreadPoolExecutor() as pool:
        candidates.give(second, Cost(2.0))
        assert asked
        assert all(answer.result() for answer in asked)


def test_in_any_order_of_answers_the_path_is_that_of_the_sequential_search():
    """Without threads: whoever is in flight answers in random order, and those no longer wanted are let go."""
    one = minimize(rosenbrock, np.zeros(4), **SETTINGS)
    for seed in range(6):
        rng, search = random.Random(seed), AdaptiveSimulatedAnnealing(np.zeros(4), **SETTINGS)
        candidates, flying, visited = Speculation(search), [], []
        while len(visited) < len(one.history["f"]):
            flying = [candidate for candidate in flying if candidates.wanted(candidate)]
            while len(flying) < 12 and (candidate := candidates.take(wait=False)) is not None:
                flying.append(candidate)
            candidate = flying.pop(rng.randrange(len(flying)))
            candidates.give(candidate, rosenbrock(candidate.x))
            visited += candidates.visits(wait=False)
        assert np.array_equal([x for x, _ in visited], one.history["x"])
        assert candidates.take() is None


def test_an_improvement_lets_go_of_what_was_drawn_around_the_old_best():
    search = AdaptiveSimulatedAnnealing(np.ones(2), amplitude=0.1)
    candidates = Speculation(search)
    start = candidates.take()
    candidates.give(start, 10.0)
    first, second, third = (candidates.take() for _ in range(3))
    assert [c.iteration for c in (first, second, third)] == [1, 2, 3]
    candidates.give(second, 5.0)  # better, while the one before it still runs
    assert candidates.wanted(first)
    assert not candidates.wanted(third)
    after = candidates.take()
    assert after.best is second
    candidates.give(first, 7.0)  # better too, so that the second was drawn around the wrong one
    assert not candidates.wanted(after)
    assert candidates.take().best is first
    assert [f for _, (f, _) in candidates.visits()] == [10.0, 7.0]


def test_what_evaluate_raises_comes_out(tmp_path):
    def evaluate(candidates):
        candidates.give(candidates.take(), 1.0)
        raise ArithmeticError("lost")

    with pytest.raises(ArithmeticError, match="lost"):
        minimize(None, np.zeros(2), evaluate=evaluate, history=tmp_path / "history", **SETTINGS)
    assert len((tmp_path / "history").read_text().splitlines()) == 2
    with pytest.raises(RuntimeError, match="returned before the search was over"):
        minimize(None, np.zeros(2), evaluate=lambda candidates: None, **SETTINGS)


def test_an_interrupt_ends_threads_and_keeps_what_was_visited(tmp_path):
    def callback(result):
        if result.nit > 20:
            raise KeyboardInterrupt

    path = tmp_path / "history"
    settings = SETTINGS | {"evaluate": in_threads(4), "history": path}
    cut = minimize(rosenbrock, np.zeros(5), callback=callback, **settings)
    assert cut.status == 2
    resumed = minimize(rosenbrock, np.zeros(5), resume=True, **settings)
    assert_same_visits(resumed, minimize(rosenbrock, np.zeros(5), **SETTINGS))


def test_a_resumed_search_counts_what_it_wastes_itself(tmp_path):
    """One thread evaluates the next candidate alone, so that none is wasted."""
    settings = SETTINGS | {"evaluate": in_threads(1), "history": tmp_path / "history"}
    minimize(None, np.zeros(5), **{**settings, "max_iterations": 20})
    resumed = minimize(None, np.zeros(5), resume=True, **settings)
    assert (resumed.resumed, resumed.wasted, resumed.nfev) == (21, 0, resumed.nit + 1)


def test_a_batch_ends_where_the_search_ends():
    settings = {**SETTINGS, "no_progress": 25}
    one, many = (minimize(sphere, np.ones(3), batch=batch, **settings) for batch in (1, 64))
    assert_same_visits(one, many)
    assert one.status == 1
    assert not one.history["accepted"][-25:].any()


def test_an_executors_map_will_do():
    with ThreadPoolExecutor(2) as pool:
        threaded = minimize(rosenbrock, np.zeros(4), map=pool.map, batch=8, **SETTINGS)
    assert_same_visits(threaded, minimize(rosenbrock, np.zeros(4), **SETTINGS))


def test_misses_narrow_the_search_until_it_is_reheated_again_and_again():
    settings = {**SETTINGS, "max_miss": 4, "max_iterations": 12}
    result = minimize(lambda x: float("nan"), np.zeros(30), **settings)
    assert result.history["miss"] == pytest.approx([1, 1, 2, 3, 0.1, 1.1, 2.1, 3.1, 0.1, 1.1, 2.1, 3.1, 0.1])
    reach = np.abs(result.history["x"][1:]).max(axis=1) * result.history["miss"][1:] / 0.3
    assert (reach < 1.0).all()
    assert (reach > 0.8).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_cost_that_is_no_number_is_a_miss(bad):
    result = minimize(lambda x: bad if x[0] > 0.9 else sphere(x), np.ones(3), **SETTINGS)
    assert result.success
    assert np.isfinite(result.fun)
    assert not result.history["accepted"][~np.isfinite(result.history["f"])].any()
    nothing = minimize(lambda x: bad, np.ones(3), **SETTINGS)
    assert not nothing.success
    assert "finite" in nothing.message
    assert np.array_equal(nothing.x, np.ones(3))


def test_candidates_are_reflected_at_their_bounds():
    lower, upper = np.array([0.0, 0.0, -np.inf, 1.0, 0.0]), np.array([1.0, 1.0, 2.0, 1.0, np.inf])
    reflected = _reflect(np.array([-0.25, 3.75, 2.5, 7.0, -3.0]), lower, upper)
    assert reflected == pytest.approx([0.25, 0.25, 1.5, 1.0, 3.0])
    bounds = np.tile([-0.2, 0.1], (5, 1))
    visited = minimize(sphere, np.zeros(5), bounds=bounds, **SETTINGS).history["x"]
    assert visited.min() >= -0.2
    assert visited.max() <= 0.1


def test_ask_and_tell_are_minimize_by_hand():
    search = AdaptiveSimulatedAnnealing(np.ones(4), **SETTINGS)
    while search.status is None:
        x = search.ask()
        assert np.array_equal(x, search.ask())
        search.tell(x, sphere(x))
    assert search.best_f == minimize(sphere, np.ones(4), **SETTINGS).fun
    with pytest.raises(RuntimeError, match="over: max_iterations"):
        search.ask()


def test_telling_what_was_not_asked_is_refused():
    search = AdaptiveSimulatedAnnealing(np.ones(4), **SETTINGS)
    with pytest.raises(ValueError, match="ask first"):
        search.tell(np.ones(4), 1.0)
    search.ask()
    with pytest.raises(ValueError, match="not the candidate"):
        search.tell(np.zeros(4), 1.0)
    search.ask_batch(5)
    with pytest.raises(ValueError, match="3 costs for 5"):
        search.tell_batch([1.0, 2.0, 3.0])


def interrupted_after(n):
    calls = iter(range(n))

    def cost(x):
        if next(calls, None) is None:
            raise KeyboardInterrupt
        return rosenbrock(x)

    return cost


@pytest.mark.parametrize("batch", [1, 8])
def test_interrupted_and_resumed_is_the_same_to_the_bit(tmp_path, batch):
    path = tmp_path / "history.jsonl"
    cut = minimize(interrupted_after(100), np.zeros(5), history=path, batch=batch, **SETTINGS)
    assert cut.status == 2
    assert not cut.success
    assert cut.fun == rosenbrock(cut.x)
    resumed = minimize(rosenbrock, np.zeros(5), history=path, resume=True, batch=batch, **SETTINGS)
    whole = minimize(rosenbrock, np.zeros(5), history=tmp_path / "whole.jsonl", batch=batch, **SETTINGS)
    assert_same_visits(resumed, whole)
    assert path.read_bytes() == (tmp_path / "whole.jsonl").read_bytes()


def test_a_torn_last_line_is_dropped_with_a_note(tmp_path, caplog):
    path = tmp_path / "history.jsonl"
    whole = minimize(rosenbrock, np.zeros(5), history=path, **SETTINGS)
    complete = path.read_bytes()
    path.write_bytes(complete[:-40])
    with caplog.at_level(logging.WARNING):
        resumed = minimize(rosenbrock, np.zeros(5), history=path, resume=True, **SETTINGS)
    assert "cut off" in caplog.text
    assert_same_visits(resumed, whole)
    assert len(path.read_bytes().splitlines()) == len(complete.splitlines())


@pytest.mark.parametrize("text", ['{"my": "notes"}', '{"my": "notes"', '{"robot": "arm"}\n{"my": '])
def test_a_file_of_others_is_refused_and_left_as_it_is(tmp_path, text):
    """A line that was cut off is dropped only where it can be one of ours."""
    path = tmp_path / "history.jsonl"
    path.write_text(text, "utf-8")
    with pytest.raises(ValueError, match=r"history\.jsonl, line 1"):
        minimize(sphere, np.zeros(2), history=path, resume=True, **SETTINGS)
    assert path.read_text("utf-8") == text


def test_a_finished_search_can_be_carried_on(tmp_path):
    path = tmp_path / "history.jsonl"
    minimize(rosenbrock, np.zeros(5), history=path, **{**SETTINGS, "max_iterations": 100})
    longer = minimize(rosenbrock, np.zeros(5), history=path, resume=True, **SETTINGS)
    assert_same_visits(longer, minimize(rosenbrock, np.zeros(5), **SETTINGS))
    with pytest.raises(ValueError, match=r"line 103: the history is longer .*max_iterations"):
        minimize(rosenbrock, np.zeros(5), history=path, resume=True, **{**SETTINGS, "max_iterations": 100})


def test_resume_without_a_history_begins_one(tmp_path):
    path = tmp_path / "history.jsonl"
    minimize(sphere, np.zeros(2), history=path, resume=True, **SETTINGS)
    assert len(path.read_text().splitlines()) == 302


@pytest.mark.parametrize(
    "change", [dict(seed=1), dict(amplitude=0.2), dict(max_miss=9), dict(bounds=[[-1, np.inf]] * 5)]
)
def test_the_history_of_another_search_is_refused(tmp_path, change):
    path = tmp_path / "history.jsonl"
    minimize(sphere, np.zeros(5), history=path, **SETTINGS)
    with pytest.raises(ValueError, match=f"line 1: the history's {next(iter(change))} is"):
        minimize(sphere, np.zeros(5), history=path, resume=True, **{**SETTINGS, **change})
    with pytest.raises(ValueError, match="line 1: the history's x0 is"):
        minimize(sphere, np.ones(5), history=path, resume=True, **SETTINGS)


@pytest.mark.parametrize("damage", ["{broken", "[1, 2]", "", None])
def test_a_history_damaged_in_the_middle_is_refused_with_its_line(tmp_path, damage):
    path = tmp_path / "history.jsonl"
    minimize(sphere, np.zeros(5), history=path, **SETTINGS)
    lines = path.read_text().splitlines()
    lines[50:51] = [] if damage is None else [damage]
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(ValueError, match="line 51: "):
        minimize(sphere, np.zeros(5), history=path, resume=True, **SETTINGS)


def test_a_history_is_not_overwritten(tmp_path):
    path = tmp_path / "history.jsonl"
    minimize(sphere, np.zeros(5), history=path, **SETTINGS)
    with pytest.raises(FileExistsError, match="resume=True"):
        minimize(sphere, np.zeros(5), history=path, **SETTINGS)


def test_the_history_keeps_why_a_candidate_failed(tmp_path):
    path = tmp_path / "history.jsonl"
    settings = {**SETTINGS, "max_iterations": 3}
    minimize(lambda x: (np.inf, "fell") if x[0] else 1.0, np.zeros(2), history=path, **settings)
    visits = [json.loads(line) for line in path.read_text().splitlines()[1:]]
    assert [v["status"] for v in visits] == ["ok", "fell", "fell", "fell"]
    assert [v["f"] for v in visits] == [1.0, None, None, None]


def test_the_callback_sees_improvements_and_can_stop_the_search():
    seen = []

    def callback(result):
        seen.append(result.fun)
        return len(seen) == 3

    result = minimize(sphere, np.ones(4), callback=callback, **SETTINGS)
    assert result.status == 3
    assert (np.diff(seen) < 0).all()
    assert result.fun == seen[-1]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (dict(amplitude=0.0), "amplitude must be finite and > 0"),
        (dict(max_miss=1), "max_miss = 1 must be a whole number >= 2"),
        (dict(max_iterations=2.5), "max_iterations = 2.5 must be a whole number"),
        (dict(no_progress=0), "no_progress = 0"),
        (dict(seed=-1), "seed = -1"),
        (dict(bounds=[[0, 1]]), r"bounds must be \(3, 2\)"),
        (dict(bounds=[[0, 1], [2, 1], [0, 2]]), r"x0\[1\] = 1.0 lies outside its bounds 2.0\.\.1.0"),
        (dict(batch=0), "batch is 0"),
    ],
)
def test_settings_out_of_range_are_named(change, message):
    with pytest.raises(ValueError, match=message):
        minimize(sphere, np.ones(3), **{**SETTINGS, **change})
    with pytest.raises(ValueError, match="x0 must be a finite"):
        minimize(sphere, [np.nan], **SETTINGS)
