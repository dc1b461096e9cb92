"""Searches with the paper's scatter in their cost: verdicts by their rules, and a table that gives the same courses."""

from dataclasses import replace

import numpy as np
import pytest

from featherstone_gait.reproduction import noisy_searches
from featherstone_gait.reproduction.noisy_searches import (
    EXPLICITLY,
    FULL,
    ITS_OWN,
    OTHERWISE,
    PUT_IN,
    QUICK,
    STUDY,
    UPDATES,
    Condition,
    Course,
    NoisyResult,
    check,
    plot,
    read,
)
from featherstone_gait.reproduction.search_rules import CORRECTED, RULES
from featherstone_gait.reproduction.what_stops import OURS, PAPERS


def course(condition, gain, longer, converged, iterations=3000):
    at = np.array([0, converged, iterations])
    seen, step = (
        np.array([100.0, 100.0 + 95.0 * gain, 100.0 + 100.0 * gain]),
        0.03 * (1.0 + longer * np.array([0, 1, 1])),
    )
    return Course(condition, iterations, at, seen, seen, step)


def verdicts(mipsd, standard, iterations=3000, program=OURS):
    """Return the verdicts on searches with states of a stride, given as (gain, longer, converged)."""
    courses = [course(Condition(program), *one) for one in mipsd] + [
        course(Condition(program, "standard"), *one) for one in standard
    ]
    return [claim.verdict for claim in check(NoisyResult(iterations, tuple(courses)))]


NEAR = [(-0.14 + 0.01 * k, 0.13 - 0.01 * k, 800 + 20 * k) for k in range(-2, 3)]
LATER = [(-0.1, 0.1, 2600 + 20 * k) for k in range(-2, 3)]


def test_a_number_is_reproduced_within_its_range_and_factor_or_not_at_all():
    assert verdicts(NEAR, LATER) == ["reproduced"] * 4
    far = [(3.0 * gain, 3.0 * longer, 3 * at) for gain, longer, at in NEAR]
    assert verdicts(far, LATER)[:3] == ["not reproduced"] * 3
    wide = [(gain, longer, at) for gain, longer, at in (*NEAR, (-0.6, 1.0, 2900), (-0.6, 1.0, 2900), (-0.6, 1.0, 2900))]
    assert verdicts(wide, LATER)[0] == "reproduced"  # the median is still the paper's
    assert verdicts(NEAR, LATER, iterations=2000) == ["undecided"] * 4
    assert verdicts(NEAR[:4], LATER) == ["undecided"] * 4
    assert verdicts(NEAR, LATER[:4]) == ["reproduced"] * 3 + ["undecided"]


@pytest.mark.parametrize("program", [UPDATES, PAPERS])
def test_each_program_has_verdicts_of_its_own(program):
    assert verdicts(NEAR, LATER, program=program) == ["reproduced"] * 4
    assert verdicts(NEAR, [], program=program) == ["reproduced"] * 3 + ["undecided"]


def test_slower_needs_the_rank_sum_test():
    assert verdicts(NEAR, NEAR)[3] == "not reproduced"
    assert verdicts(NEAR, [(-0.1, 0.1, 900 + at) for at in range(5)])[3] == "reproduced in direction"


def test_all_conditions_of_the_paper_are_searched():
    assert {(c.gearbox, c.states, c.noise) for c in PUT_IN} == {
        (g, s, n) for g, n in (("mipsd", 0.039), ("standard", 0.1462)) for s in ("stride", "step")
    }
    assert {(c.gearbox, c.states, c.noise) for c in ITS_OWN} == {
        (g, s, 0.0) for g in ("mipsd", "standard") for s in ("stride", "step")
    }
    assert {(c.gearbox, c.states, c.noise) for c in EXPLICITLY} == {(c.gearbox, c.states, c.noise) for c in PUT_IN}
    assert {c.rule for c in OTHERWISE} | {CORRECTED} == {*RULES}
    assert len({*STUDY}) == len(STUDY) == 18
    assert (FULL.iterations, FULL.searches, FULL.conditions) == (3000, 10, PUT_IN)


@pytest.mark.long
def test_a_study_goes_on_and_its_table_gives_the_same_courses(tmp_path):
    table, summary = tmp_path / "courses.csv", tmp_path / "summary.csv"
    command = [str(table), str(summary), str(tmp_path / "a.png"), "--iterations", "6", "--searches", "1", "--only"]
    chosen = ["sweeps; mipsd; stride", "explicit; standard; step", "coordinates, mipsd; stride; as", "fewer"]
    for only in chosen:
        assert noisy_searches.main([*command, only, "--threads", "1"]) == 0
    first = table.read_bytes(), summary.read_bytes()
    for only in chosen:
        assert noisy_searches.main([*command, only]) == 0
    assert (table.read_bytes(), summary.read_bytes()) == first
    table.unlink()
    for only in chosen[::-1]:  # from the histories, in another order, in all threads
        assert noisy_searches.main([*command, only]) == 0
    assert (table.read_bytes(), summary.read_bytes()) == first
    assert (tmp_path / "a.png").exists()
    result = read(table)
    assert [c.condition for c in result.courses] == [PUT_IN[0], EXPLICITLY[3], OTHERWISE[1], ITS_OWN[0]]
    again = noisy_searches.run(replace(QUICK, iterations=6, searches=1, conditions=(PUT_IN[0],)))
    np.testing.assert_array_equal(result.courses[0].cost, again.courses[0].cost)
    assert all(np.all(np.diff(c.seen) < 0.0) and c.at[0] == 0 for c in result.courses)
    assert len(plot(result)) == 1
