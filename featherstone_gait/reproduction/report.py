"""Run the paper's notebooks, collect what they judge, and write the table, the report and the page of the paper."""

from __future__ import annotations

import base64
import html
import json
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from string import Template
from typing import Any

from ..base.files import FilePath, Format, complete, write_csv
from ..base.progress import progress_bar
from .statements import STATEMENTS, Row, read_judged, table

PAPER = (
    'J. Lima, J. Gonçalves, P. Costa, A. Moreira: "Humanoid Gait Optimization Resorting to an Improved Simulation '
    'Model", International Journal of Advanced Robotic Systems 10 (2013), doi 10.5772/54766'
)
FORMAT = Format("reproduction", 4)
COLUMNS = ("place", "says", "paper", "here", "verdict", "leaves_out", "why", "notebook")
SOURCE = Path(__file__).parents[2]  # of the package; a wheel has no notebooks beside it
PAGE = "00_the_paper"  # shows what the others judge
JUDGING = tuple(sorted({one.notebook for one in STATEMENTS.values()}))
SIZE = 2**20  # of an output that the report takes over [B]: pages of meshes are larger


def reproduce(names: Sequence[str] = (), source: FilePath = SOURCE, progress: bool = False) -> list[Row]:
    """Run notebooks of the paper in a source tree and write what follows from them.

    Written are the notebooks with their outputs, `docs/reproduction/reproduction.csv` and `.html`, and picture and
    tables of `docs/paper.md`.  Statements of notebooks that are not run keep what is stored.

    Parameters
    ----------
    names : sequence of str
        Notebooks without their ending; all of the paper by default.
    source : path
        The source tree.
    progress : bool
        Whether a progress bar is shown.

    Returns
    -------
    list of Row
        Every judged statement, in the paper's order.

    Raises
    ------
    FileNotFoundError
        If there are no notebooks: a wheel has none.
    ValueError
        If a name is unknown.
    ImportError
        If nbclient is missing.
    RuntimeError
        If a cell fails; notebooks that ran before are stored.
    """
    source = check(names, source)
    folder = source / "notebooks"
    chosen = [name for name in JUDGING if not names or name in names] + [PAGE]
    with progress_bar(chosen, progress=progress, unit="notebook") as bar:
        for name in bar:
            bar.set_description(name)
            execute(folder / f"{name}.ipynb")
    rows = collected(folder)
    write(rows, folder, source / "docs")
    subprocess.run([sys.executable, str(source / "docs" / "tables.py")], check=True, cwd=source)
    return rows


def check(names: Sequence[str], source: FilePath = SOURCE) -> Path:
    """Return the path of a source tree that has notebooks of these names; raise as `reproduce`."""
    if unknown := [name for name in names if name not in (*JUDGING, PAGE)]:
        raise ValueError(f"there is no notebook {unknown[0]!r} of the paper; notebooks: {', '.join((*JUDGING, PAGE))}")
    source = Path(source)
    if not (source / "notebooks" / f"{PAGE}.ipynb").is_file():
        raise FileNotFoundError(
            f"{source}: no notebooks of the paper; they are part of the source tree, not of the wheel: unpack the "
            "source, `pip install -e .` there, and run the command again"
        )
    return source


def execute(path: Path) -> None:
    """Run a notebook from top to bottom and store it with its outputs, without those for the terminal alone."""
    try:
        import nbformat
        from nbclient import NotebookClient
        from nbclient.exceptions import CellExecutionError
    except ImportError:
        raise ImportError('notebooks are run by nbclient: pip install "featherstone-gait[notebook]"') from None
    notebook = nbformat.read(path, as_version=4)
    client = NotebookClient(notebook, timeout=None, resources={"metadata": {"path": path.parent}})
    try:
        client.execute()
    except CellExecutionError as error:
        said = f"{path.name}: a cell raises {error.ename}: {error.evalue}; open the notebook and run it to see where"
        raise RuntimeError(said) from error
    for cell in notebook.cells:
        if cell.cell_type == "code":
            cell.metadata.pop("execution", None)  # times of day
            cell.outputs = list(_joined(cell.outputs))
    with complete(path) as temporary:
        nbformat.write(notebook, temporary)


def _joined(outputs: Sequence[Any]) -> Iterator[Any]:
    """Yield outputs without stderr, what is printed in pieces in one."""
    last = None
    for output in outputs:
        if output.output_type == "stream":
            if output.name == "stderr":
                continue
            if last is not None and last.output_type == "stream":
                last.text += output.text
                continue
        last = output
        yield output


def collected(folder: FilePath) -> list[Row]:
    """Return the rows that the stored notebooks of a folder carry, in the paper's order."""
    rows = {row.key: row for name in JUDGING for row in read_judged(Path(folder) / f"{name}.ipynb")}
    return [rows[key] for key in STATEMENTS if key in rows]


def counts(rows: Sequence[Row]) -> str:
    """Return how many statements have each verdict, as text."""
    found = Counter(row.verdict for row in rows)
    inside = sum(row.ours.endswith("the paper's inside") for row in rows)
    decided = [list(row.cases.values()) for row in rows if row.verdict != "open" and not row.statement.numbers]
    all_true = sum(all(case in (True, None) for case in cases) for cases in decided)
    none_true = sum(not any(cases) for cases in decided)
    return (
        f"{found['holds']} hold; contradicted: {found['contradicted']}; open: {found['open']}, {inside} of them "
        f"numbers that lie among ours. If no case were let off, {all_true} would hold; contradicted: {none_true}"
    )


def write(rows: Sequence[Row], notebooks: Path, docs: Path) -> None:
    """Write reproduction/reproduction.csv and .html, and the page's picture, into the folder of the pages."""
    out = docs / "reproduction"
    out.mkdir(parents=True, exist_ok=True)
    lines = [
        (s.place, s.says, s.paper, row.ours, row.verdict, s.leaves_out, row.note, s.notebook)
        for row in rows
        for s in [row.statement]
    ]
    write_csv(out / "reproduction.csv", FORMAT, COLUMNS, lines, "as the notebooks of the paper judge")
    page = Template(Path(__file__).with_suffix(".html").read_text("utf-8")).substitute(
        paper=html.escape(PAPER),
        picture="".join(_shown(notebooks / f"{PAGE}.ipynb")),
        counts=html.escape(counts(rows)),
        statements=table(rows),
        sections="".join(_section(notebooks / f"{name}.ipynb") for name in JUDGING),
    )
    with complete(out / "reproduction.html") as temporary:
        temporary.write_text(page, "utf-8")
    picture = re.search(r'src="data:image/png;base64,([^"]+)"', page)
    if picture:
        with complete(docs / "images" / "paper.png") as temporary:
            temporary.write_bytes(base64.b64decode(picture[1]))


def _section(notebook: Path) -> str:
    return f'<h2 id="{notebook.stem}">{html.escape(_title(notebook))}</h2>{"".join(_shown(notebook))}\n'


def _title(notebook: Path) -> str:
    first = "".join(json.loads(notebook.read_text("utf-8"))["cells"][0]["source"])
    return first.splitlines()[0].lstrip("# ")


def _shown(notebook: Path) -> Iterator[str]:
    """Yield a notebook's pictures and pages that move, below the headings that they stand under."""
    heading = ""
    for cell in json.loads(notebook.read_text("utf-8"))["cells"]:
        if cell["cell_type"] == "markdown":
            titles = [line.lstrip("# ").strip() for line in "".join(cell["source"]).splitlines() if line[:3] == "## "]
            heading = titles[-1] if titles else heading
        for output in cell.get("outputs", ()):
            data = output.get("data", {})
            what, moving = "", "".join(data.get("text/html", ()))
            if "image/png" in data:
                what = _picture("".join(data["image/png"]).replace("\n", ""), heading)
            elif moving.startswith("<iframe") and len(moving) < SIZE:
                what = f'<figure class="motion">{moving}</figure>'
            if what:
                yield (f"<h3>{html.escape(heading)}</h3>" if heading else "") + what
                heading = ""


def _picture(png: str, heading: str) -> str:
    width = int.from_bytes(base64.b64decode(png[:64])[16:20], "big")  # the PNG's header
    return f'<figure><img alt="{html.escape(heading)}" width="{width}" src="data:image/png;base64,{png}"></figure>'
