"""`featherstone-gait reproduce`: notebooks run and stored, what they judge in one table, one report and the page."""

import base64
import csv
import re
from html.parser import HTMLParser

import nbformat
import pytest

from featherstone_gait import cli
from featherstone_gait.reproduction import STATEMENTS, report
from featherstone_gait.reproduction.report import JUDGING, PAGE

PNG = base64.b64encode(b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR\x00\x00\x01\x00\x00\x00\x00\x10" + bytes(20)).decode()


def program(name):
    """The code of a stand-in for a notebook: it judges its statements, each in one case."""
    rows = [
        f"judge({key!r}, {{'a <b>': {[1.0] * len(one.numbers) or True}}}, 'because & so')"
        for key, one in STATEMENTS.items()
        if one.notebook == name
    ]
    return f"from featherstone_gait.reproduction import Judged, judge\nJudged({', '.join(rows)})"


@pytest.fixture
def source(tmp_path):
    """A source tree with a stand-in for each notebook, and for the program that writes pages."""
    (tmp_path / "notebooks").mkdir()
    (tmp_path / "docs" / "images").mkdir(parents=True)
    (tmp_path / "docs" / "tables.py").write_text("open('docs/paper.md', 'w').write('written')")
    v4 = nbformat.v4
    for name in (*JUDGING, PAGE):
        cells = [v4.new_markdown_cell(f"# Title of {name}\n\ntext"), v4.new_code_cell(program(name))]
        if name == PAGE:
            shown = v4.new_output("display_data", data={"image/png": PNG})
            cells = [cells[0], v4.new_code_cell("print('a')\nprint('b')", outputs=[shown])]
        nbformat.write(v4.new_notebook(cells=cells), tmp_path / "notebooks" / f"{name}.ipynb")
    return tmp_path


@pytest.fixture
def quick(monkeypatch):
    """Run cells in this process, as far as what they judge is concerned; return the names of the notebooks."""
    ran = []

    def execute(path):
        ran.append(path.stem)
        notebook = nbformat.read(path, as_version=4)
        if path.stem != PAGE:
            scope = {}
            exec(notebook.cells[1].source.replace("\nJudged", "\nfound = Judged"), scope)
            data = scope["found"]._repr_mimebundle_()
            notebook.cells[1].outputs = [nbformat.v4.new_output("execute_result", data=data)]
            nbformat.write(notebook, path)

    monkeypatch.setattr(report, "execute", execute)
    return ran


class Tags(HTMLParser):
    """Elements that were opened and closed, and addresses that would be fetched."""

    def __init__(self):
        super().__init__()
        self.open, self.addresses = [], []

    def handle_starttag(self, tag, attributes):
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)
        self.addresses += [value for name, value in attributes if name in ("src", "href")]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def test_all_notebooks_are_run_and_their_rows_written(source, quick, capsys):
    assert cli.main(["reproduce", "--quiet", "--out", str(source)]) == 0
    assert quick == [*JUDGING, PAGE]
    said = capsys.readouterr().out
    assert len(re.findall("^ +here: ", said, re.MULTILINE)) == len(STATEMENTS)
    text = (source / "docs" / "reproduction" / "reproduction.csv").read_text("utf-8")
    rows = list(csv.DictReader(line for line in text.splitlines() if not line.startswith("#")))
    assert [row["says"] for row in rows] == [one.says for one in STATEMENTS.values()]
    assert (source / "docs" / "paper.md").read_text() == "written"
    assert (source / "docs" / "images" / "paper.png").read_bytes() == base64.b64decode(PNG)


def test_the_report_stands_alone_and_is_well_formed(source, quick):
    report.reproduce(source=source)
    text = (source / "docs" / "reproduction" / "reproduction.html").read_text("utf-8")
    tags = Tags()
    tags.feed(text)
    assert tags.open == []
    assert [one for one in tags.addresses if not one.startswith("data:image/png;base64,")] == []
    assert 'width="256"' in text
    assert text.index("data:image/png") < text.index("a &lt;b&gt;: ") < text.index("Title of 01_servo</h2>")
    assert "because &amp; so" in text


def test_one_notebook_is_run_and_the_others_keep_what_is_stored(source, quick):
    report.reproduce(source=source)
    quick.clear()
    rows = report.reproduce(["02_arm"], source)
    assert quick == ["02_arm", PAGE]
    assert len(rows) == len(STATEMENTS)


def test_what_is_no_notebook_or_no_source_tree_is_refused(source, quick, tmp_path, capsys):
    assert cli.main(["reproduce", "dance", "--out", str(source)]) == 2
    assert re.search("'dance'.*02_arm", capsys.readouterr().err)
    assert cli.main(["reproduce", "--out", str(tmp_path / "docs")]) == 2
    assert "source tree" in capsys.readouterr().err
    assert quick == []


def test_a_notebook_is_stored_with_its_outputs_once_it_has_run(source):
    path = source / "notebooks" / f"{PAGE}.ipynb"
    report.execute(path)
    (cell,) = [cell for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"]
    assert [output.text for output in cell.outputs] == ["a\nb\n"]
    notebook = nbformat.read(path, as_version=4)
    notebook.cells[1].source = "1 / 0"
    nbformat.write(notebook, path)
    before = path.read_bytes()
    with pytest.raises(RuntimeError, match=rf"{PAGE}.ipynb: a cell raises ZeroDivisionError"):
        report.execute(path)
    assert path.read_bytes() == before


def test_a_cell_that_fails_is_an_exit_code(source, monkeypatch, capsys):
    def fails(path):
        raise RuntimeError(f"{path.name}: a cell raises ValueError: no luck")

    monkeypatch.setattr(report, "execute", fails)
    assert cli.main(["reproduce", "--out", str(source)]) == 1
    assert "01_servo.ipynb: a cell raises" in capsys.readouterr().err
