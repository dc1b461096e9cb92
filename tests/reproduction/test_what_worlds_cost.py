"""What walking elsewhere costs: searches that are judged where they did not look, kept, and drawn."""

import json

import numpy as np
import pytest

from featherstone_gait.base.files import read_csv
from featherstone_gait.optimize import optimize_gait
from featherstone_gait.reproduction import what_worlds_cost as study
from featherstone_gait.reproduction.tables import write_rows
from featherstone_gait.reproduction.what_worlds_cost import CMA, FIRST, PAPERS, WorldsRow
from featherstone_gait.walking.cost_in_worlds import in_worlds


def row(method, worlds, walks=0.5, cost=30.0, seed=0):
    return WorldsRow(method, worlds, seed, 800, cost, cost, 0.2, 200, walks, 0.9 * cost, cost, 1.1 * cost)


def test_a_search_sees_as_many_candidates_with_either_method():
    first = study.planned()
    x, searched = study.search(PAPERS, 1, 3, candidates=2)
    told = optimize_gait(in_worlds(first, 1, 3), iterations=1, seed=3)
    assert len(told.history["f"]) == 2
    assert np.array_equal(x, told.x)
    assert searched == told.fun == in_worlds(first, 1, 3)(x)[0]
    assert study.search(CMA, 0, 3, candidates=1)[1] == first(first.gait.to_vector())[0]


@pytest.mark.long
def test_a_study_goes_on_with_what_it_has_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(study, "WORLDS", (0, 1))
    whole = [*study.study(tmp_path, searches=1, candidates=2, unseen=3)][-1]
    assert [(r.method, r.worlds) for r in whole] == [(FIRST, 0), (PAPERS, 0), (CMA, 0), (PAPERS, 1), (CMA, 1)]
    assert all(r.unseen == 3 and 3 * r.walks == round(3 * r.walks) for r in whole)
    walked = [r for r in whole if r.walks]
    assert walked
    assert all(r.cost_5 <= r.cost_50 <= r.cost_95 for r in walked)
    assert whole[1].searched == whole[1].own  # on the robot's own floor it is that which was searched for
    monkeypatch.setattr(study, "search", None)
    monkeypatch.setattr(study, "worth", None)
    assert [*study.study(tmp_path, searches=1, candidates=2, unseen=3)][-1] == whole
    kept = next(tmp_path.glob("annealing_0_0_*.json"))
    kept.write_text(json.dumps(json.loads(kept.read_text("utf-8")) | {"walks": 0.25}), "utf-8")
    assert [*study.study(tmp_path, searches=1, candidates=2, unseen=3)][-1][1].walks == 0.25


def test_rows_are_drawn_and_written(tmp_path):
    rows = [row(FIRST, 0, 1.0, 99.0)]
    rows += [row(m, n, w, c, seed) for m, n, w, c in ((PAPERS, 0, 0.7, 21.0), (CMA, 1, 0.4, 25.0), (CMA, 8, 1.0, 30.0))
             for seed in (0, 1)]  # fmt: skip
    panel = study.plot(rows).axes[0]
    said = [text.get_text() for text in panel.texts]
    assert said.count("f") == said.count("1") == said.count("8") == 2
    assert any("first gait: 99 J/m, 100.0 %" in text for text in said)
    path = tmp_path / "table.csv"
    write_rows(path, study.TABLE, rows, study.__file__)
    (_, names), *cells = read_csv(path, study.TABLE)
    assert [float(values[names.index("walks")]) for _, values in cells] == [r.walks for r in rows]
