"""Where a search stops: what counts as stopping there, and that a study goes on and repeats its bits."""

import math
from dataclasses import replace

import numpy as np
import pytest

from featherstone_gait.base.files import read_csv
from featherstone_gait.reproduction import what_stops
from featherstone_gait.reproduction.tables import write_rows
from featherstone_gait.reproduction.what_stops import (
    CONDITIONS,
    FULL,
    PAPERS,
    QUICK,
    Condition,
    Search,
    StopResult,
    StopRow,
)

PLAIN, FAIR = Condition(), Condition(plan="cheapest")


def ended(condition, cost, longer, converged=700, passed=20, **how):
    """A search that ended so."""
    row = StopRow(
        **{name: getattr(condition, name) for name in ("program", "gearbox", "step", "plan", "states", "floors")},
        seed=0, iterations=FULL.iterations, first=64.0, best=64.0 * (1.0 + cost), cost=cost, longer=longer, fell=0,
        passed=passed, longer_then=0.15, stepped=20, converged=converged, converged_gain=400,
    )  # fmt: skip
    best = np.linspace(1.0, 1.0 + cost, FULL.iterations + 1)
    return Search(replace(row, **how), best)


def verdicts(*searches, iterations=FULL.iterations):
    return [claim.verdict for claim in what_stops.check(StopResult(replace(FULL, iterations=iterations), searches))]


STANDARD, MIPSD = (Condition(PAPERS, gearbox, 2e-3) for gearbox in ("standard", "mipsd"))


def test_a_search_stops_there_if_both_figures_are_within_five_points():
    beyond, there, half = ended(PLAIN, -0.6, 1.2), ended(STANDARD, -0.12, 0.10), ended(MIPSD, -0.12, 0.3)
    assert verdicts(beyond, there)[0] == "reproduced"
    assert verdicts(beyond, half)[0] == "reproduced in direction"
    assert verdicts(beyond)[0] == "not reproduced"
    assert verdicts(beyond, there, iterations=100)[0] == "undecided"


def test_the_cheapest_plan_leaves_less_to_gain_if_it_does_in_each_pair():
    step = replace(PLAIN, states="step"), replace(FAIR, states="step")
    less = ended(PLAIN, -0.6, 1.0), ended(FAIR, -0.5, 1.0)
    more = ended(step[0], -0.6, 1.0), ended(step[1], -0.7, 1.0)
    assert verdicts(*less)[1] == "reproduced"
    assert verdicts(*less, *more)[1] == "reproduced in direction"
    assert verdicts(*more)[1] == "not reproduced"
    assert verdicts(ended(PLAIN, -0.6, 1.0))[1] == "undecided"


def test_the_papers_pair_of_figures_is_reproduced_at_the_documented_step_or_not_at_all():
    documented = Condition(PAPERS, "mipsd")
    assert verdicts(ended(documented, -0.12, 0.10))[2] == "reproduced"
    assert verdicts(ended(documented, -0.4, 0.3), ended(MIPSD, -0.12, 0.10))[2] == "not reproduced"
    assert verdicts(ended(MIPSD, -0.12, 0.10))[2] == "undecided"


def test_the_older_model_is_later_only_where_searches_are_as_long_as_the_paper_s():
    coarse = ended(STANDARD, -0.1, 0.1, converged=2700), ended(MIPSD, -0.3, 0.3, converged=900)
    both = tuple(ended(replace(s.row.condition, step=1e-3), -0.1, 0.1, converged=s.row.converged) for s in coarse)
    assert verdicts(*both)[3] == "undecided"
    assert verdicts(*both, iterations=3000)[3] == "reproduced"
    assert verdicts(*coarse, iterations=3000)[3] == "reproduced in direction"  # not at the documented step
    sooner = ended(STANDARD, -0.1, 0.1, converged=400), coarse[1]
    assert verdicts(*sooner, iterations=3000)[3] == "not reproduced"


def test_every_condition_is_named_and_drawn(tmp_path):
    searches = tuple(ended(condition, -0.3, 0.2, passed=-1, longer_then=math.nan) for condition in CONDITIONS)
    assert len({str(condition) for condition in CONDITIONS}) == len(CONDITIONS) == 12
    assert [one.row.condition for one in searches] == list(CONDITIONS)
    for figure in what_stops.plot(StopResult(FULL, searches)).values():
        figure.draw_without_rendering()
    path = tmp_path / "searches.csv"
    write_rows(path, what_stops.TABLE, [one.row for one in searches], what_stops.__file__)
    lines = [cells for _, cells in read_csv(path, what_stops.TABLE)]
    assert len(lines) == 13
    assert lines[1][:4] == ["reduced coordinates", "mipsd", "0.001", "plain"]


@pytest.mark.long
def test_in_the_paper_s_kind_of_program_a_gait_costs_the_same_when_it_is_asked_for_in_the_same_way():
    cost = what_stops.first_gait(STANDARD)
    x = cost.gait.to_vector()
    first, same, other = (what_stops.swept(cost, x, k) for k in (0, 0, 1))
    assert first == same
    assert 1e-4 < abs(other[0] / first[0] - 1.0) < 1.0


@pytest.mark.long
def test_a_study_goes_on_to_the_same_rows(tmp_path):
    settings = replace(QUICK, iterations=6, repeats=2, folder=str(tmp_path / "a"))
    whole = [what_stops.search(settings, condition, 0).row for condition in (PLAIN, MIPSD)]
    begun = replace(settings, iterations=3, folder=str(tmp_path / "b"))
    for condition in (PLAIN, MIPSD):
        what_stops.search(begun, condition, 0)
    longer = replace(begun, iterations=6)
    assert [what_stops.search(longer, condition, 0).row for condition in (PLAIN, MIPSD)] == whole
