"""The results that pages show: stored files, the tables made of them, and the commands that make them anew."""

import importlib
import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
STORED = DOCS / "reproduction"


@pytest.fixture(scope="module")
def docs():
    sys.path.insert(0, str(DOCS))
    yield lambda name: importlib.import_module(name)
    sys.path.remove(str(DOCS))


@pytest.fixture
def tables(docs, tmp_path, monkeypatch):
    """The module, on files of this test."""
    module = docs("tables")
    (tmp_path / "a.csv").write_text("# format\nrobot,gait,cost,fell\narm,first,1.25,\narm,last,,3\nleg,first,-0.01,\n")
    (tmp_path / "b.csv").write_text("name,x\none,1e-05\n")
    monkeypatch.setattr(module, "STORED", tmp_path)
    module.records.cache_clear()
    yield module
    module.records.cache_clear()


def test_a_table_has_a_row_for_each_record_or_group(tables):
    block = "```{results-table} a.csv\nrobot | {robot}\ncost | {cost:.1f} J ?? falls, {fell} s\n```\n"
    assert tables.resolved(block) == (
        "| robot | cost |\n| --- | --- |\n| arm | 1.2 J |\n| arm | falls, 3 s |\n| leg | 0.0 J |\n"
    )
    wide = ":rows: robot\n:columns: gait\n | {robot}\n{gait} | {cost*10:.1f} ?? -\nwalk | {count cost} of {count gait}"
    header, _, *rows = tables.table(["a.csv"], wide).splitlines()
    assert header == "| | walk | first | last |"
    assert rows == ["| arm | 1 of 2 | 12.5 | - |", "| leg | 1 of 1 | -0.1 | |"]


def test_labelled_rows_join_records_and_may_be_transposed(tables):
    text = ":transpose:\n | {label}\nleast | {min cost:.2f}\nx | {x:.0e} ?? none\n= all | a.csv; robot=arm + b.csv\n"
    assert tables.table(["a.csv"], text).splitlines()[2:] == ["| least | 1.25 |", "| x | 1e-5 |"]
    assert tables.resolved("It costs {{ a.csv | robot=arm; gait=first | {cost:.1f} }} J.") == "It costs 1.2 J."


@pytest.mark.parametrize(
    ("text", "named"),
    [("cost | {price}", "price"), ("cost | {cost}", "cost"), ("= all | robot=hand", "robot=hand"), ("cost", "cost")],
)
def test_what_the_files_do_not_have_is_refused(tables, text, named):
    with pytest.raises(ValueError, match=named):
        tables.table(["a.csv"], text)


def test_the_readme_shows_the_stored_results(docs, capsys):
    assert docs("readme").main(check=True) == 0, capsys.readouterr().out
    text = docs("readme").README.read_text("utf-8")
    assert docs("readme").written(text.replace("87.8 J/m", "78.8 J/m")) == text
    assert text.count("<!-- results-table") == len(docs("readme").MARKED.findall(text)) > 0


@pytest.mark.parametrize("page", sorted(DOCS.rglob("*.md")), ids=lambda path: path.relative_to(DOCS).as_posix())
def test_pages_find_their_results(docs, page):
    text = docs("tables").resolved(page.read_text("utf-8"))
    assert "{results-table}" not in text or page.name == "README.md"
    assert "{{" not in text


def test_every_stored_file_has_its_command():
    text = (STORED / "README.md").read_text("utf-8")
    rows = re.findall(r"^\| (`[^|]*) \| (`[^|]*) \| ([\d.]+) \|$", text, re.MULTILINE)
    files = {name for names, _, _ in rows for name in re.findall(r"`(.*?)`", names)}
    kept = {path.relative_to(STORED).as_posix() for path in STORED.rglob("*") if path.is_file()} - {"README.md"}
    assert kept - files == set()
    assert [name for name in files if not (STORED / name).resolve().exists()] == []
    for _, command, _ in rows:
        for word in re.findall(r"(?:docs|robots|notebooks)/[\w./]+\.\w+", command):
            assert (ROOT / word).exists(), word
        for module in re.findall(r"-m (featherstone_gait[\w.]*)", command):
            assert importlib.util.find_spec(module), module


@pytest.mark.long
@pytest.mark.parametrize("name", ["plans", "previews", "grounds", "pushes", "solver", "arm", "posture"])
def test_measured_again_a_table_is_the_stored_one(docs, name):
    measure = docs("measure")
    assert measure.measured(name) == measure.read(name)
    assert name in measure.TABLES


@pytest.mark.long
def test_the_stored_gait_walks_as_its_report_says():
    from featherstone_gait import load_robot
    from featherstone_gait.optimize import walking_cost

    folder = ROOT / "robots" / "humanoid"
    report = json.loads((folder / "optimized_gait.json").read_text("utf-8"))
    cost = walking_cost(load_robot("humanoid", locked="simplified"), states="step")
    with np.load(folder / "optimized_gait.npz") as data:
        measures = cost.measure([data["first"], data["x"]])
    assert [m.cost for m in measures] == [report[key]["cost"] for key in ("before", "after")]


def test_reports_are_kept_without_the_machine_and_the_candidates(docs, tmp_path):
    keep = docs("measure").keep
    np.savez(tmp_path / "all.npz", x=[1.0], visited=np.zeros((8, 4)), costs=np.zeros(8), format="gait")
    keep(tmp_path / "all.npz", tmp_path / "kept.npz")
    with np.load(tmp_path / "kept.npz") as found:
        assert sorted(found.files) == ["format", "x"]
        assert (str(found["format"]), found["x"].tolist()) == ("gait", [1.0])
    report = json.loads((STORED / "gait_seed_1.json").read_text("utf-8"))
    (tmp_path / "report.json").write_text(json.dumps(report | {"seconds": 1.0}), "utf-8")
    keep(tmp_path / "report.json", tmp_path / "kept.json")
    kept = json.loads((tmp_path / "kept.json").read_text("utf-8"))
    assert kept == {key: report[key] for key in report if key != "command"}


def test_pages_name_only_timings_that_exist(docs):
    timings = docs("timings").TIMINGS
    texts = [page.read_text("utf-8") for page in DOCS.rglob("*.md")]
    named = {name for text in texts for name in re.findall(r"timings\.py (\w+)", text)}
    assert named == timings.keys()
