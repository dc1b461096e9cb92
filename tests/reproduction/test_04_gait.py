"""Notebook 04: its searches are made again, its rules are right, and its verdicts are those of the stored searches."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import searches
from searches import PAPERS, RULES, Condition, End, FewerAngles, Improvement, LiteralTest

from featherstone_gait.reproduction.statements import STATEMENTS, read_judged
from featherstone_gait.search import AdaptiveSimulatedAnnealing

NOTEBOOK = Path(searches.__file__).with_name("04_gait.ipynb")
SWEPT = Condition(PAPERS, step=2e-3)
HOW = {"amplitude": 0.1, "max_miss": 5, "max_iterations": 30, "no_progress": 30, "seed": 3}


def test_a_search_finds_what_is_stored():
    """Gaits, scatter and measures: another motor, gearbox or ground makes other numbers."""
    first, *others = Improvement.make(Condition(), 0, 4)
    stored = [row for row in searches.read(Improvement) if (row.condition, row.seed) == (Condition(), 0)]
    assert [row.iteration for row in others] == [1, 4]
    for row, other in zip((first, *others), stored):
        np.testing.assert_allclose((row.seen, row.cost, row.step), (other.seen, other.cost, other.step), rtol=1e-9)
    walk = searches.first_gait(Condition())
    measures = walk.measure([walk.gait.to_vector()])[0]
    np.testing.assert_allclose((first.cost, first.step), (measures.cost, measures.stride_length / 2), rtol=1e-12)
    assert first.seen != first.cost  # it scatters


def test_the_papers_numbers_are_those_that_it_prints():
    keys = "converged", "energy_saved", "longer_steps", "energy_a_step"
    assert [STATEMENTS[key].numbers for key in keys] == [(800.0,), (-14.0,), (13.0,), (0.97,)]
    assert round((1.0 - 0.14) * (1.0 + 0.13), 2) == 0.97
    assert searches.SCATTER == {"mipsd": 0.039, "standard": 0.1462}


def test_verdicts_are_those_of_the_stored_searches():
    rows = {row.key: row for row in read_judged(NOTEBOOK)}
    found = {c: v for c, v in searches.outcomes().items() if c.gearbox == "mipsd"}
    numbers = {
        "converged": lambda v: v[:, 2], "energy_saved": lambda v: 100.0 * v[:, 0],
        "longer_steps": lambda v: 100.0 * v[:, 1], "energy_a_step": lambda v: (1.0 + v[:, 0]) * (1.0 + v[:, 1]),
    }  # fmt: skip
    for key, number in numbers.items():
        cases = {name.split(";")[0]: case for name, case in rows[key].cases.items()}
        assert cases == pytest.approx({str(c): np.median(number(values)) for c, values in found.items()}, rel=1e-12)
    for condition in found:  # with scatter a step costs within a tenth of what it did: the saving is that of its length
        if condition.scatter:
            assert abs(rows["energy_a_step"].cases[str(condition)] - 1.0) < 0.11
    assert True not in rows["older_slower"].cases.values()
    assert rows["cheaper_and_longer"].verdict != "contradicted"


def test_converged_is_when_a_tenth_of_the_gain_is_left():
    at, seen = [0, 3, 7, 20, 50], [100.0, 60.0, 55.1, 55.0, 50.0]
    assert searches.converged(at, seen) == 20
    assert searches.converged(at, [2.0 * f for f in seen]) == 20  # of the gain, whatever the cost
    assert searches.converged([0], [100.0]) == 0
    low, high = searches.interval(np.arange(10.0))
    assert (low, high) == pytest.approx((1.5, 7.5), abs=0.5)  # by order statistics between the 2nd and the 9th
    assert searches.interval([3.0] * 4) == (3.0, 3.0)
    assert searches.later([7, 8, 9], [1, 2, 3]) == pytest.approx(1 / 20)  # of the 20 ways to order 3 and 3


def visited(kind, fun, **how):
    search = kind(np.zeros(40), **HOW | how)
    while search.status is None:
        search.tell(search.ask(), fun(search.candidate(search.iteration, search.best_x, search.miss)))
    return search.visited


def test_a_literal_test_widens_once_before_the_next_improvement():
    counts = [v.miss for v in visited(LiteralTest, lambda x: 1.0)[1:]]
    np.testing.assert_allclose(counts, [1, 2, 3, 4, *(0.1 + np.arange(26))])
    found = visited(LiteralTest, lambda x: float(((x - 0.05) ** 2).sum()))
    assert all(after.miss == 1.0 for before, after in pairwise(found) if before.accepted)


def test_fewer_angles_are_perturbed_the_more_misses_there_are():
    search, whole = (kind(np.zeros(40), **HOW) for kind in (FewerAngles, AdaptiveSimulatedAnnealing))
    for miss, count in ((0.1, 40), (1.0, 40), (1.1, 37), (2.0, 20), (3.0, 14), (100.0, 1)):
        x = search.candidate(7, np.zeros(40), miss)
        assert np.count_nonzero(x) == count
        np.testing.assert_array_equal(x[x != 0.0], whole.candidate(7, np.zeros(40), 1.0)[x != 0.0])
    assert {k for n in range(1, 100) for k in np.flatnonzero(search.candidate(n, np.zeros(40), 8.0))} == set(range(40))


def test_each_rule_changes_one_thing():
    first, *others = RULES.values()
    assert [sum(a != b for a, b in zip(first, rule)) for rule in others] == [1] * len(others)


def test_the_stored_summary_is_that_of_the_stored_courses(tmp_path):
    searches.summarize(searches.read(Improvement), tmp_path / "noisy_searches.csv")
    ours, stored = ((x / "noisy_searches.csv").read_text().splitlines()[1:] for x in (tmp_path, searches.STORED))
    assert ours == stored


@pytest.mark.long
def test_in_the_papers_kind_of_program_a_gait_costs_the_same_when_it_is_asked_for_in_the_same_way():
    cost = searches.first_gait(SWEPT)
    first, same, other = (searches.swept(cost, cost.gait.to_vector(), k) for k in (0, 0, 1))
    assert first == same
    assert 1e-4 < abs(other[0] / first[0] - 1.0) < 1.0


@pytest.mark.long
def test_chatter_is_taken_as_it_is():
    cost = searches.first_gait(Condition(searches.UPDATES, "standard"))
    x = cost.gait.to_vector()
    assert not np.isfinite(cost.measure([x])[0].cost)
    assert np.isfinite(searches.measure(cost, [x])).all()


@pytest.mark.long
@pytest.mark.parametrize(
    ("kind", "chosen"),
    [(Improvement, ["sweeps, mipsd, stride", "fewer"]), (End, ["mipsd, stride, no scatter, 8 floors"])],
)
def test_a_table_is_continued_and_can_be_made_again(kind, chosen, tmp_path):
    folders = tmp_path / "a", tmp_path / "b"
    for folder, order in zip(folders, (chosen * 2, chosen[::-1])):  # a search that is there is not made again
        folder.mkdir()
        for only in order:
            table = {Improvement: "courses", End: "ends"}[kind]
            searches.main([table, "--only", only, "--searches", "1", "--iterations", "4"], folder)
    first, again = ((folder / kind.file).read_bytes() for folder in folders)
    assert first == again
    assert len({row.condition for row in searches.read(kind, folders[0])}) == len(chosen)
