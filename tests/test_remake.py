"""`docs/remake.py`: what makes the numbers of the pages anew, and that they are those which stand there."""

import importlib.util
import json
import re
from pathlib import Path

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
        remake.put(remake.Cells("page.md", "row", ("1",)), text)


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
