"""The paper's statements: what it prints, the rule, and that the stored notebooks, table and page agree."""

import csv
from pathlib import Path

import pytest

from featherstone_gait.reproduction import STATEMENTS, Judged, judge
from featherstone_gait.reproduction.report import COLUMNS, JUDGING, collected
from featherstone_gait.reproduction.statements import read_judged

ROOT = Path(__file__).parents[2]
NOTEBOOKS = ROOT / "notebooks"
PRINTED = {  # entered a second time from the paper
    "standard_error": (8.14,),
    "mipsd_error": (0.0022,),
    "standard_scatter": (14.62,),
    "mipsd_scatter": (3.9,),
    "standard_deviation": (0.39, 0.16, 0.50, 0.84),
    "mipsd_deviation": (0.01, 0.01, 0.01, 0.01),
    "converged": (800,),
    "energy_saved": (-14,),
    "longer_steps": (13,),
    "energy_a_step": (round(0.86 * 1.13, 2),),
}


def test_the_papers_numbers_are_those_that_it_prints():
    assert {key: one.numbers for key, one in STATEMENTS.items() if one.numbers} == PRINTED
    assert all(one.unit for one in STATEMENTS.values() if one.numbers)


@pytest.mark.parametrize(
    ("cases", "verdict", "ours"),
    [
        ({"a": True, "b": True}, "holds", "true in 2 of 2 cases"),
        ({"a": False, "b": None}, "contradicted", "true in 0 of 1 cases, undecided in 1"),
        ({"a": True, "b": False}, "open", "true in 1 of 2 cases"),
        ({"a": False, "b": None, "c": None}, "open", "true in 0 of 1 cases, undecided in 2"),
        ({"a": None}, "open", "undecided in 1"),
        (dict.fromkeys("abcdefghi", True) | {"j": False}, "holds", "true in 9 of 10 cases"),
        (dict.fromkeys("abcdefgh", True) | {"j": False}, "open", "true in 8 of 9 cases"),
        (dict.fromkeys("abcdefghi", False) | {"j": True}, "contradicted", "true in 1 of 10 cases"),
    ],
)
def test_a_statement_holds_or_is_contradicted_in_nine_of_ten_cases_that_decide(cases, verdict, ours):
    row = judge("more_stable", cases, "why")
    assert (row.verdict, row.ours, row.cases) == (verdict, ours, cases)


@pytest.mark.parametrize(
    ("values", "verdict", "ours"),
    [
        ([7.4, 8.9], "holds", "7.4 to 8.9 deg²"),
        ([7.3, 8.9], "open", "7.3 to 8.9 deg²: the paper's inside"),
        ([8.2, 80.0], "open", "8.2 to 80 deg²: the paper's outside"),
        ([8.1, float("nan")], "open", "8.1 deg²: the paper's outside"),
        ([None], "open", "in none of 1 cases a number"),
    ],
)
def test_a_number_is_open_with_its_span_unless_every_case_is_within_a_tenth(values, verdict, ours):
    row = judge("standard_error", dict(zip("ab", values)), "why")
    assert (row.verdict, row.ours) == (verdict, ours)
    assert judge("standard_error", row.cases, "why") == row  # what is stored judges alike


def test_several_numbers_are_inside_one_by_one():
    row = judge("standard_deviation", {"a": (0.1, 0.1, 0.6, 0.1), "b": (0.5, 0.2, 0.7, 0.9)}, "why")
    assert row.ours == "0.1 to 0.5; 0.1 to 0.2; 0.6 to 0.7; 0.1 to 0.9 deg: the paper's 3 of 4 inside"


@pytest.mark.parametrize(
    ("key", "cases", "said"),
    [
        ("dance", {"a": True}, "'dance'"),
        ("more_stable", {}, "no case"),
        ("more_stable", {"a": 0.5}, "0.5"),
        ("standard_error", {"a": True}, "deg²"),
        ("standard_deviation", {"a": 0.5}, "has: 4"),
    ],
)
def test_a_case_of_another_kind_is_refused(key, cases, said):
    with pytest.raises(ValueError, match=said):
        judge(key, cases, "why")


def test_a_notebook_judges_each_of_its_statements_once():
    row = judge("step_response", {"a": None}, "<why> & so")
    with pytest.raises(ValueError, match="backlash"):
        Judged(row)
    page = Judged(row, judge("high_ratio", {"a": True}, ""))._repr_mimebundle_()["text/html"]  # of several notebooks
    assert "&lt;why&gt; &amp; so" in page
    assert page.index("Fig. 4") < page.index("Section 3")


@pytest.mark.parametrize("name", JUDGING)
def test_a_stored_notebook_judges_as_the_rule_does(name):
    rows = read_judged(NOTEBOOKS / f"{name}.ipynb")
    assert [row.key for row in rows] == [key for key, one in STATEMENTS.items() if one.notebook == name]
    assert [judge(row.key, row.cases, row.note) for row in rows] == rows
    assert all(row.note for row in rows)


def test_the_table_behind_the_page_is_what_the_notebooks_judge():
    text = (ROOT / "docs" / "reproduction" / "reproduction.csv").read_text("utf-8")
    stored = list(csv.DictReader(line for line in text.splitlines() if not line.startswith("#")))
    for line, row in zip(stored, collected(NOTEBOOKS), strict=True):
        one = row.statement
        told = (one.place, one.says, one.paper, row.ours, row.verdict, one.leaves_out, row.note, one.notebook)
        assert {name: text.removeprefix("'") for name, text in line.items()} == dict(zip(COLUMNS, told))
    assert len(stored) == len(STATEMENTS)
