"""`docs/remake.py`: what makes the numbers of the pages anew, and that they are those which stand there."""

import importlib.util
import json
import re
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]
spec = importlib.util.spec_from_file_location("remake", ROOT / "docs" / "remake.py")
remake = importlib.util.module_from_spec(spec)
spec.loader.exec_module(remake)

QUICKEST = [name for name, part in remake.PARTS.items() if part.cells and part.minutes == 0.0]
QUICK = [name for name, part in remake.PARTS.items() if part.cells and 0.0 < part.minutes <= remake.QUICK]


def test_the_readme_s_tables_say_what_the_file_of_the_gait_says():
    for name in QUICKEST:
        assert remake.worked_out(remake.PARTS[name], check=True) == []


@pytest.mark.long
@pytest.mark.parametrize("name", QUICK)
def test_numbers_worked_out_anew_are_those_of_the_pages(name):
    assert remake.worked_out(remake.PARTS[name], check=True) == []


def test_every_timing_names_a_page_that_names_its_command():
    """`docs/timings.py`, which nothing here runs: time decides nothing."""
    spec = importlib.util.spec_from_file_location("timings", ROOT / "docs" / "timings.py")
    timings = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(timings)
    for name, timing in timings.TIMINGS.items():
        pages = re.findall(r"docs/\w+\.md", timing.__doc__)
        assert pages
        assert all((ROOT / page).is_file() for page in pages)
        assert callable(timing), name
    texts = [page.read_text("utf-8") for page in (ROOT / "docs").glob("*.md")]
    named = {name for text in texts for name in re.findall(r"timings\.py (\w+)", text)}
    assert named <= timings.TIMINGS.keys()
    assert len(named) >= 4


def test_a_cell_that_differs_is_told_and_written(tmp_path, monkeypatch, capsys):
    page = tmp_path / "page.md"
    page.write_text("# Numbers\n\n| | a | b | |\n| --- | --- | --- | --- |\n| row | 1.5 m, as said | 2 | |\n", "utf-8")
    part = remake.Part("it", 0.0, cells=lambda: [remake.Cells("page.md", "row", ("1.5 m", "3", None))])
    monkeypatch.setattr(remake, "ROOT", tmp_path)
    monkeypatch.setattr(remake, "KEPT", tmp_path / "remade.json")
    monkeypatch.setattr(remake, "PARTS", {"it": part})
    assert remake.main(["--quick", "--check"]) == 1
    assert "page.md: row: 1.5 m | 3" in capsys.readouterr().out
    assert "| 2 |" in page.read_text("utf-8")
    assert remake.main(["--quick"]) == 0
    assert page.read_text("utf-8").endswith("| row | 1.5 m, as said | 3 | |\n")
    assert remake.main(["--quick", "--check"]) == 0
    assert json.loads((tmp_path / "remade.json").read_text("utf-8"))["it"]["sources"] == remake.sources(part)
    assert "of these sources" in remake.listing()


@pytest.mark.parametrize("text", ["", "| row | 1 |\n| row | 1 |", "| row | 1 | 2 |"])
def test_a_row_that_is_missing_or_twice_there_is_refused(text):
    with pytest.raises(ValueError, match="row"):
        remake.Cells("page.md", "row", ("1",)).put(text)


def test_a_row_is_found_in_the_table_below_a_line_and_words_between_words():
    page = "| row | 1 |\n\n## Here\n\ntext\n\n| a | b |\n| row | 2 |\n\n| row | 3 |\n\nOf 5 m all, of 6 m none."
    assert remake.Cells("page.md", "row", ("4",), "## Here").put(page) == page.replace("| row | 2 |", "| row | 4 |")
    with pytest.raises(ValueError, match="0 rows"):
        remake.Cells("page.md", "row", ("4",), "## There").put(page)
    assert remake.Words("page.md", "Of ", "7 m", " all").put(page) == page.replace("Of 5 m", "Of 7 m")
    for before, after in (("Of ", " some"), ("f ", " m")):
        with pytest.raises(ValueError, match="times"):
            remake.Words("page.md", before, "1", after).put(page)


def test_gaits_are_kept_without_the_candidates_on_their_way(tmp_path):
    np.savez(tmp_path / "all.npz", x=[1.0], visited=np.zeros((800, 40)), costs=np.zeros(800), format="gait")
    remake.put_arrays(tmp_path / "all.npz", tmp_path / "kept.npz")
    with np.load(tmp_path / "kept.npz") as found:
        assert sorted(found.files) == ["format", "x"]
        assert (str(found["format"]), found["x"].tolist()) == ("gait", [1.0])


def test_what_is_not_kept_yet_says_so(monkeypatch):
    part = remake.Part("it", 1.0, ("optimize",), (("humanoid_gait.json", "docs/reproduction/nowhere.json"),))
    monkeypatch.setattr(remake, "PARTS", {"it": part})
    assert "it, not kept yet" in remake.listing()


def test_every_part_says_what_it_writes_and_every_command_is_there():
    for name, part in remake.PARTS.items():
        assert bool(part.cells) != bool(part.command), name
        assert all((remake.PACKAGE / file).is_file() for file in part.modules)
        for _, place in part.files:
            assert (ROOT / place).parent.is_dir()
        for word in part.command:
            assert not re.fullmatch(r"(docs|robots|notebooks)/\S+", word) or (ROOT / word).exists(), word
    text = remake.listing()
    assert all(name in text for name in remake.PARTS)
    assert "featherstone-gait optimize --crosscheck" in text
    assert str(ROOT) not in text
