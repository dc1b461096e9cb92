"""`featherstone-gait reproduce`: one report, failures in it, finished experiments kept."""

import csv
import json
import re
import subprocess
import sys
from dataclasses import dataclass
from html.parser import HTMLParser
from pathlib import Path
from types import ModuleType

import pytest
from matplotlib.figure import Figure

from featherstone_gait import cli
from featherstone_gait.reproduction import EXPERIMENTS, Claim, ClaimTable, format_claims, number, report, sources
from featherstone_gait.reproduction.claim import classify, plus_minus, within
from featherstone_gait.reproduction.items import ITEMS
from featherstone_gait.reproduction.narrow import WIDTH, stack

NASTY = 'a <b> & "c" | *d* _e_ `f`'


@dataclass(frozen=True)
class Settings:
    duration: float = 2.0  # [s] long <enough>
    gains: tuple[float, ...] = (20.0, 61.0)  # [V/rad]


def stand_in(name, calls, fails=None):
    """An experiment that notes its calls."""
    module = ModuleType(f"featherstone_gait.reproduction.{name}", f"Title of {name}.\n\nMore.")
    module.QUICK, module.FULL = Settings(), Settings(duration=20.0)

    def run(settings, seed, progress):
        calls.append((name, settings.duration, seed))
        if fails:
            raise fails
        return f"{settings.duration} {seed}"

    def plot(result):
        figure = Figure(figsize=(2, 1))
        figure.subplots().set_title(result)
        return {f"caption {NASTY}": figure, "second": Figure(figsize=(1, 1))}

    module.run, module.plot = run, plot
    module.check = lambda result: [
        Claim(NASTY, "1 m", f"{result} | 2 m", "reproduced", "because\nof x", "Fig. 9", 0.5, (0.4, 2.5)),
        Claim("Is it so?", "", "no", "not reproduced", "because of y"),
    ]
    module.animate = lambda result: {"it moves": "<p>page & script</p>"}
    return module


@pytest.fixture
def calls(monkeypatch):
    """Stand-ins for two experiments, first and last; their calls."""
    made = []
    monkeypatch.setattr(report, "EXPERIMENTS", ("first", "last"))
    for name in ("first", "last"):
        monkeypatch.setitem(sys.modules, f"featherstone_gait.reproduction.{name}", stand_in(name, made))
    return made


def fail(monkeypatch, calls, name, error):
    monkeypatch.setitem(sys.modules, f"featherstone_gait.reproduction.{name}", stand_in(name, calls, error))


class Tags(HTMLParser):
    """Elements that were opened and closed, and addresses that would be fetched."""

    def __init__(self):
        super().__init__()
        self.open, self.addresses = [], []

    def handle_starttag(self, tag, attributes):
        if tag not in ("meta", "img", "br", "wbr", "source"):
            self.open.append(tag)
        self.addresses += [value for name, value in attributes if name in ("src", "srcset", "href")]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def test_the_report_stands_alone_and_is_well_formed(calls, tmp_path):
    report.reproduce(out=tmp_path)
    text = (tmp_path / "reproduction.html").read_text("utf-8")
    tags = Tags()
    tags.feed(text)
    assert tags.open == []
    assert all(re.match(r"#|data:image/png;base64,", address) for address in tags.addresses)
    assert text.count("data:image/png;base64,") == 6  # the figure with a panel twice, for narrow pages too
    assert "<b>" not in text
    assert text.count('srcdoc="&lt;p&gt;page &amp; script&lt;/p&gt;"') == 2
    assert "a &lt;b&gt; &amp;" in text
    assert "[s] long &lt;enough&gt;" in text
    assert text.index("2.0 0 | 2 m") < text.index("Title of first</h2>") < text.index("Title of last</h2>")


def test_the_markdown_has_every_claim_and_its_pictures(calls, tmp_path):
    report.reproduce(out=tmp_path)
    lines = (tmp_path / "reproduction.md").read_text("utf-8").splitlines()
    rows = [line for line in lines if line.startswith("| Fig. 9 ")]
    assert len(rows) == 2
    assert len(re.findall(r"(?<!\\)\|", rows[0])) == 8  # seven cells: what the claim holds is escaped
    assert "because of x (first)" in rows[0]
    assert [line for line in lines if line.startswith("| Is it so? | no | no | because of y (first) |")]
    pictures = [re.match(r"!\[\w+\]\((.*)\)", line)[1] for line in lines if line.startswith("![")]
    assert len(pictures) == 4
    assert all((tmp_path / picture).read_bytes().startswith(b"\x89PNG") for picture in pictures)


def test_the_table_has_the_papers_claims_first_and_the_accepted_factors(calls, tmp_path):
    report.reproduce(out=tmp_path)
    text = (tmp_path / "reproduction.csv").read_text("utf-8")
    rows = list(csv.DictReader(line for line in text.splitlines() if not line.startswith("#")))
    assert [(row["experiment"], row["item"]) for row in rows] == [
        ("first", "Fig. 9"), ("last", "Fig. 9"), ("first", ""), ("last", ""),
    ]  # fmt: skip
    assert rows[0]["accepted"] == "0.4 to 2.5"


def test_the_report_says_what_it_is_of(calls, tmp_path):
    report.reproduce(out=tmp_path, full=True, seed=7)
    text = (tmp_path / "reproduction.md").read_text("utf-8")
    assert "full, seed 7" in text
    assert f"featherstone-gait {report.__version__}, Python" in text
    assert calls == [("first", 20.0, 7), ("last", 20.0, 7)]


def test_finished_experiments_are_kept(calls, tmp_path):
    report.reproduce(out=tmp_path)
    written = (tmp_path / "reproduction.html").read_bytes()
    entries = report.reproduce(out=tmp_path)
    assert len(calls) == 2
    assert all(entry.finished for entry in entries)
    assert (tmp_path / "reproduction.html").read_bytes() == written
    report.reproduce(["last"], tmp_path, seed=1)
    assert calls[2:] == [("last", 2.0, 1)]


def test_panels_side_by_side_are_stacked_for_a_telephone():
    figure = Figure(figsize=(10, 3), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    left.set_ylabel("angle [deg]")
    left.plot([0, 1], [0, 1], label="a")
    right.plot([0, 1], [0, 2], label="b")
    figure.legend(loc="outside upper center", ncols=2)
    assert stack(figure)
    figure.draw_without_rendering()
    assert figure.get_size_inches()[0] == WIDTH
    assert right.get_position().y1 < left.get_position().y0
    assert right.get_ylabel() == "angle [deg]"
    assert not stack(Figure())  # no panels


def test_the_gauge_shows_the_factor_on_a_logarithmic_scale():
    assert report._gauge("", "") == ""
    for factor, place in (("1", 50), ("10", 75), ("0.01", 0), ("1e+05", 100)):
        assert f"left: {place}%" in report._gauge(factor, "0.5 to 2")


@pytest.mark.parametrize("damage", ["", "{", "[]", '{"key": 1}'])
def test_a_damaged_or_missing_file_is_made_again(damage, calls, tmp_path):
    report.reproduce(out=tmp_path)
    files = tmp_path / "reproduction_files"
    (files / "first.json").write_text(damage)
    (files / "last_1.png").unlink()
    report.reproduce(out=tmp_path)
    assert calls[2:] == [("first", 2.0, 0), ("last", 2.0, 0)]


def test_another_program_runs_again(calls, monkeypatch, tmp_path):
    report.reproduce(["first"], tmp_path)
    monkeypatch.setattr(report, "_program", lambda module: "another")
    report.reproduce(["first"], tmp_path)
    assert len(calls) == 2


def test_what_is_finished_stays_so_while_others_run(calls, monkeypatch, tmp_path):
    report.reproduce(["last"], tmp_path)
    fail(monkeypatch, calls, "first", KeyboardInterrupt())
    written = []
    monkeypatch.setattr(
        report, "write_report", lambda folder, entries, *_: written.append([e.finished for e in entries])
    )
    with pytest.raises(KeyboardInterrupt):
        report.reproduce(out=tmp_path)
    monkeypatch.setitem(sys.modules, "featherstone_gait.reproduction.first", stand_in("first", calls))
    report.reproduce(out=tmp_path)
    assert written == [[True, True], [True, True]]


def test_after_an_interruption_the_same_call_goes_on(calls, monkeypatch, tmp_path):
    fail(monkeypatch, calls, "last", KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        report.reproduce(out=tmp_path)
    assert "Not run yet: last" in (tmp_path / "reproduction.md").read_text("utf-8")
    monkeypatch.setitem(sys.modules, "featherstone_gait.reproduction.last", stand_in("last", calls))
    report.reproduce(out=tmp_path)
    assert [name for name, *_ in calls] == ["first", "last", "last"]


def test_the_command_says_that_it_goes_on_after_an_interruption(calls, monkeypatch, tmp_path, capsys):
    fail(monkeypatch, calls, "last", KeyboardInterrupt())
    assert cli.main(["reproduce", "--out", str(tmp_path)]) == 130
    assert len(capsys.readouterr().err.splitlines()) > 1  # more than that it was interrupted
    monkeypatch.setitem(sys.modules, "featherstone_gait.reproduction.last", stand_in("last", calls))
    assert cli.main(["reproduce", "--out", str(tmp_path)]) == 0
    assert [name for name, *_ in calls] == ["first", "last", "last"]


def test_a_failed_experiment_is_reported_and_the_others_run(calls, monkeypatch, tmp_path, capsys):
    fail(monkeypatch, calls, "first", RuntimeError("no <luck>"))
    assert cli.main(["reproduce", "--out", str(tmp_path)]) == 1
    text = (tmp_path / "reproduction.html").read_text("utf-8")
    assert "RuntimeError: no &lt;luck&gt;" in text
    assert str(tmp_path.parent) not in text
    assert "Title of last</h2>" in text
    assert "first: failed: RuntimeError" in capsys.readouterr().out
    assert not (tmp_path / "reproduction_files" / "first.json").exists()


def test_an_experiment_that_cannot_be_loaded_is_a_failed_one(calls, monkeypatch, tmp_path):
    monkeypatch.delitem(sys.modules, "featherstone_gait.reproduction.first")
    first, last = report.reproduce(out=tmp_path)
    assert "ModuleNotFoundError" in first.failure
    assert last.finished


def test_an_experiment_gets_of_seed_and_progress_what_it_knows(calls, monkeypatch, tmp_path):
    module = stand_in("last", calls)
    module.run = lambda settings, progress: calls.append(("last", progress)) or ""
    monkeypatch.setitem(sys.modules, "featherstone_gait.reproduction.last", module)
    report.reproduce(out=tmp_path, seed=5)
    assert calls == [("first", 2.0, 5), ("last", False)]


def test_the_command_hands_its_options_over(calls, tmp_path, capsys):
    assert cli.main(["reproduce", "--full", "--seed", "3", "--out", str(tmp_path)]) == 0
    assert calls == [("first", 20.0, 3), ("last", 20.0, 3)]
    assert "reproduced" in capsys.readouterr().out
    assert json.loads((tmp_path / "reproduction_files" / "last.json").read_text("utf-8"))["name"] == "last"


def test_nothing_half_written_stays(calls, monkeypatch, tmp_path):
    def full_disk(self, data):
        raise OSError("no space left")

    monkeypatch.setattr("pathlib.Path.write_bytes", full_disk)
    with pytest.raises(OSError, match="no space"):
        report.reproduce(out=tmp_path)
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_an_unknown_experiment_is_refused(tmp_path, capsys):
    assert cli.main(["reproduce", "dance", "--out", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert "'dance'" in said
    assert "servo_step" in said


ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("key", ITEMS)
def test_every_item_of_the_paper_is_answered(key):
    """By claims that name it, or by a file that is there and a test that holds it."""
    item = ITEMS[key]
    if item.here:
        assert (ROOT / item.module).exists()
        file, _, function = item.test.partition("::")
        assert not item.test or f"def {function}(" in (ROOT / file).read_text("utf-8")
    else:
        sources = [(ROOT / f"featherstone_gait/reproduction/{name}.py").read_text("utf-8") for name in EXPERIMENTS]
        assert [source for source in sources if f'"{key}"' in source]


def test_claims_name_items_of_the_paper_and_no_others():
    for name in EXPERIMENTS:
        source = (ROOT / f"featherstone_gait/reproduction/{name}.py").read_text("utf-8")
        assert set(re.findall(r'"((?:Fig\.|Table|Eq\.|Section) \d+)"', source)) <= set(ITEMS)


def test_a_number_is_reproduced_or_not_and_only_an_order_in_direction():
    number = {"claim": "a", "paper": "1", "ours": "2", "why": "", "item": "Fig. 9"}
    for wrong in (
        {"verdict": "reproduced in direction"},
        {"verdict": "reproduced in direction", "factor": 2.0, "accepted": (0.5, 2.0)},
        {"verdict": "not reproduced", "factor": 2.0},  # no interval
        {"verdict": "reproduced", "factor": 2.1, "accepted": (0.5, 2.0)},
        {"verdict": "reproduced"},  # neither a number, nor an order, nor what holds
        {"verdict": "not reproduced"},
        {"verdict": "reproduced in direction", "holds": True},
        {"verdict": "reproduced", "holds": True, "order": True},
    ):
        with pytest.raises(ValueError, match="'a'"):
            Claim(**number, **wrong)
    assert Claim(**number, verdict="reproduced", factor=2.0, accepted=within(2.0)).interval == "0.5 to 2"
    assert Claim(**number, verdict="not reproduced", holds=True).word == "not reproduced"
    assert Claim(**number, verdict="reproduced in direction", order=True).word == "reproduced in direction"


def test_a_notebook_shows_claims_as_a_table_in_the_papers_order():
    claims = [
        Claim("<own>", "", "1", "reproduced", ""),
        Claim("b", "1", "1", "not reproduced", "x & y", "Table 3", holds=True),
        Claim("a", "1", "1", "reproduced", "", "Fig. 9", 1.0, (0.5, 2.0)),
    ]
    text = ClaimTable(claims)._repr_html_()
    tags = Tags()
    tags.feed(text)
    assert tags.open == []
    assert text.index("Fig. 9") < text.index("Table 3") < text.index("&lt;own&gt;")
    assert "1 (0.5 to 2)" in text
    assert "x &amp; y" in text
    assert str(ClaimTable(claims)) == format_claims(claims)


def test_the_rules_of_verdicts_and_of_errors():
    assert [classify(*x) for x in ((True,), (False, True), (False,), (True, True, False))] == [
        "reproduced", "reproduced in direction", "not reproduced", "undecided",
    ]  # fmt: skip
    assert plus_minus(-0.1354, -0.1354 + 3e-13, ".3f") == "-0.135"
    assert plus_minus(6.31, 6.71, ".2f") == "6.31 ± 0.4"
    assert plus_minus(15.7, 15.68, ".1f") == "15.7"


def test_every_experiment_states_how_long_it_takes():
    assert set(report.MINUTES) == set(EXPERIMENTS)
    assert report.expected(("servo_step",), full=True) == report.MINUTES["servo_step"][1]
    assert report.expected() == pytest.approx(sum(quick for quick, _ in report.MINUTES.values()))


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_every_experiment_explains_its_settings(name):
    module = __import__(f"featherstone_gait.reproduction.{name}", fromlist=["QUICK"])
    assert [row for row in report._settings(module.QUICK) if not row[2]] == []
    assert module.QUICK != module.FULL


@pytest.mark.long
def test_results_belong_to_the_sources_that_their_experiment_loads(tmp_path):
    """All that Python loads with an experiment is counted, and what it never loads is not."""
    code = "import sys; import featherstone_gait.reproduction.complete_humanoid; print(*filter(None, (getattr(m, "
    code += "'__file__', None) for n, m in sys.modules.items() if n.startswith('featherstone_gait'))), sep='\\n')"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    counted = sources.reached(sources.PACKAGE / "reproduction" / "complete_humanoid.py")
    assert {Path(path) for path in loaded} <= counted
    inside = {path.relative_to(sources.PACKAGE).as_posix() for path in counted}
    assert "search/cma_es.py" in inside  # imported by a package's __init__
    assert "view/style.py" in inside
    assert not any(path.startswith(("cli/", "benchmark/")) for path in inside)
    assert "reproduction/posture.py" not in inside


@pytest.mark.parametrize(
    ("ours", "order", "verdict"),
    [
        (2.6, False, "reproduced"),
        (5.5, True, "reproduced"),
        (2.4, False, "not reproduced"),
        (2.4, True, "reproduced in direction"),
        (0.9, True, "not reproduced"),
    ],
)
def test_number_is_the_papers_within_its_factor_and_only_an_order_holds_in_direction(ours, order, verdict):
    claim = number("Fig. 11", "repeats better", 3.75, ours, 1.5, "times", order)
    assert (claim.verdict, claim.factor) == (verdict, pytest.approx(ours / 3.75))
