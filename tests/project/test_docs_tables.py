"""The programs of `docs/` that write its tables, and measure what no command of the package writes."""

import importlib
import json
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[2] / "docs"))
measure, tables = (importlib.import_module(name) for name in ("measure", "tables"))


def test_tables_group_label_transpose_and_scale(monkeypatch):
    first = {"robot": "arm", "gait": "first", "cost": "1.25", "fell": ""}
    records = [first, first | {"gait": "last", "cost": "", "fell": "3"}, first | {"robot": "leg", "cost": "-0.01"}]
    monkeypatch.setattr(tables, "records", {"a.csv": records, "b.csv": [{"x": "1e-05"}]}.get)
    columns = {"": "{robot}", "walk": "{count cost} of {count gait}", "{gait}": "{cost*10:.1f} ?? falls, {fell} s"}
    grouped = tables.table(["a.csv"], columns, per=["robot"], across=["gait"])
    rule = "| --- | --- | --- | --- |"
    rows = ["| arm | 1 of 2 | 12.5 | falls, 3 s |", "| leg | 1 of 1 | -0.1 | - |"]
    assert grouped.splitlines() == ["| | walk | first | last |", rule, *rows]
    columns = {"": "{label}", "costs": "{range cost:.2f}", "x": "{x:.0e}"}
    both = {"arms": {"robot": ["arm", "hand"]}, "all": [{"robot": "arm"}, {"x": "1e-05"}]}
    shown = tables.table(["a.csv", "b.csv"], columns, rows=both, transpose=True)
    assert shown.splitlines()[2:] == ["| costs | 1.25 | 1.25 |", "| x | - | 1e-5 |"]
    assert tables.filled("{range cost:.2f}", records) == "-0.01 to 1.25"
    with pytest.raises(ValueError, match="price"):
        tables.table(["a.csv"], {"c": "{price}"})
    with pytest.raises(ValueError, match="hand"):
        tables.table(["a.csv"], columns, where={"robot": "hand"})


def test_reports_are_kept_without_the_machine_and_the_candidates(tmp_path):
    keep = measure.keep
    np.savez(tmp_path / "all.npz", x=[1.0], visited=np.zeros((8, 4)), costs=np.zeros(8), format="gait")
    keep(tmp_path / "all.npz", tmp_path / "kept.npz")
    with np.load(tmp_path / "kept.npz") as found:
        assert (sorted(found.files), found["x"].tolist()) == (["format", "x"], [1.0])
    report = json.loads((measure.STORED / "gait_seed_1.json").read_text("utf-8"))
    (tmp_path / "report.json").write_text(json.dumps(report | {"seconds": 1.0}), "utf-8")
    keep(tmp_path / "report.json", tmp_path / "kept.json")
    assert json.loads((tmp_path / "kept.json").read_text("utf-8")) == {k: report[k] for k in report if k != "command"}


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "count"),
    [
        ("plans", 1), ("previews", 5), ("grounds", 10), ("across", 2), ("pushes", 1), ("worlds", 1), ("robots", 1),
        ("floors", 1), ("solver", 2), ("arm", 3), ("posture", 2),
    ],
)
def test_measured_again_the_first_rows_of_a_table_are_the_stored_ones(name, count):
    """Those that take a minute at most; `python docs/measure.py` measures all."""
    assert name in measure.TABLES
    assert measure.measured(name, count) == measure.read(name)[: 1 + count]
