"""One report of the experiments: the paper's claims in its order, our own questions, then each experiment.

`reproduce` runs what is not finished yet and writes, in one folder, reproduction.html (one file, opens anywhere),
reproduction.md with its pictures, reproduction.csv with all claims, and for each finished experiment a file of its
results, from which the next start goes on if name, settings, seed and the sources that it can load are the same.
"""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import html
import inspect
import io
import json
import math
import os
import platform
import re
import time
from collections import Counter
from collections.abc import Sequence
from importlib import import_module, metadata
from pathlib import Path
from string import Template
from traceback import extract_tb
from typing import TYPE_CHECKING, Any, NamedTuple, get_args

from .. import __version__
from ..base.files import FilePath, Format, complete, write_csv
from ..base.progress import progress_bar
from . import EXPERIMENTS
from .claim import NO_CURVE, Claim, Verdict
from .items import ITEMS
from .narrow import stack
from .sources import digest

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PAPER = (
    'J. Lima, J. Gonçalves, P. Costa, A. Moreira: "Humanoid Gait Optimization Resorting to an Improved Simulation '
    'Model", International Journal of Advanced Robotic Systems 10 (2013), doi 10.5772/54766'
)
FORMAT = Format("experiment", 3)
TABLE = Format("reproduction", 3)
TABLE_COLUMNS = ("experiment", "item", "claim", "paper", "here", "factor", "accepted", "verdict")
LABELLED = ("paper", "here", "factor")
PAPER_ONLY = ("item", "paper", "factor")
COLUMNS = ("Item", "Statement", "Paper", "Here", "Factor (accepted)", "Verdict", "Why and where")
PARTS = ("Item", "What it is", "What is here", "File and test")
OWN_COLUMNS = ("Question", "Here", "Answer", "Why and where")
DOTS_PER_INCH = 150  # of pictures
SHOWN_PER_INCH = 105  # CSS pixels, on a page that is wide enough
MINUTES = {  # that an experiment takes on two cores, compiled before: quick, full
    "servo_step": (0.1, 0.1), "arm_fall": (0.1, 0.2),
    "seven_joint_arm": (0.4, 1.5), "ratio_and_joints": (0.3, 1), "energy_repeatability": (0.4, 0.7),
    "posture": (0.3, 0.7),
    "solver_scatter": (0.9, 6), "gait_optimization": (0.4, 8.5), "noisy_searches": (0.3, 15), "what_stops": (0.3, 13),
    "complete_humanoid": (0.2, 0.8),
}  # fmt: skip


class Entry(NamedTuple):
    """One experiment in the report."""

    name: str
    title: str
    claims: tuple[Claim, ...] = ()
    figures: tuple[tuple[str, str, str], ...] = ()  # caption, file, and file of the same for narrow pages, "" if none
    motions: tuple[tuple[str, str], ...] = ()  # caption, page that plays it
    settings: tuple[tuple[str, str, str], ...] = ()  # name, value, unit and reason
    seconds: float = 0.0
    failure: str = ""  # what it raised
    finished: bool = False


def reproduce(
    names: Sequence[str] = (), out: FilePath = ".", full: bool = False, seed: int = 0, progress: bool = False
) -> list[Entry]:
    """Run the named experiments, by default all, and write the report into the folder `out`.

    An experiment that raises is reported as failed, and the others still run.  The report is written after each of
    them.  Raises ValueError for an unknown name.
    """
    _known(names)
    folder = Path(out)
    files = folder / "reproduction_files"
    files.mkdir(parents=True, exist_ok=True)
    chosen = [name for name in EXPERIMENTS if not names or name in names]
    entries = {name: _finished(files, name, full, seed) or Entry(name, name) for name in chosen}
    with progress_bar(entries, progress=progress, unit="experiment") as bar:
        for name in bar:
            bar.set_description(name)
            if not entries[name].finished:
                entries[name] = _entry(files, name, full, seed, progress)
            write_report(folder, list(entries.values()), full, seed)
    return list(entries.values())


def expected(names: Sequence[str] = (), full: bool = False) -> float:
    """Return the expected time of the named experiments on two cores [min], without compilation.

    Raises ValueError for an unknown name.
    """
    _known(names)
    return sum(MINUTES.get(name, (0.0, 0.0))[full] for name in EXPERIMENTS if not names or name in names)


def _known(names: Sequence[str]) -> None:
    for name in names:
        if name not in EXPERIMENTS:
            raise ValueError(f"there is no experiment {name!r}; experiments: {', '.join(EXPERIMENTS)}")


def _key(name: str, full: bool, seed: int) -> tuple[Any, Any, str]:
    """Return module, settings, and the key of the stored results."""
    module = import_module(f".{name}", __package__)
    settings = module.FULL if full else module.QUICK
    program = _program(module)
    return module, settings, hashlib.sha256(f"{name}\n{settings!r}\n{seed}\n{program}".encode()).hexdigest()


def _finished(files: Path, name: str, full: bool, seed: int) -> Entry | None:
    """Return stored results, if settings, seed and program are the same."""
    try:
        return _stored(files / f"{name}.json", _key(name, full, seed)[2])
    except Exception:  # what is wrong with it is told when it runs
        return None


def _entry(files: Path, name: str, full: bool, seed: int, progress: bool) -> Entry:
    """Run an experiment and store its results."""
    try:
        module, settings, key = _key(name, full, seed)
        entry, made = _run(name, module, settings, seed, progress)
    except Exception as error:  # whatever goes wrong in one experiment, the others are reported
        return Entry(name, name, failure=_failure(error))
    for file, data in made.items():
        _write(files / file, data)
    text = json.dumps({"format": str(FORMAT), "key": key} | _plain(entry), indent=1)
    _write(files / f"{name}.json", text.encode())
    return entry


def _run(name: str, module: Any, settings: Any, seed: int, progress: bool) -> tuple[Entry, dict[str, bytes]]:
    """Run an experiment; return its entry and its files by name."""
    start = time.perf_counter()
    known = inspect.signature(module.run).parameters
    how = {"seed": seed, "progress": progress}
    result = module.run(settings, **{name: value for name, value in how.items() if name in known})
    claims = tuple(module.check(result))
    made: dict[str, bytes] = {}
    figures, motions = [], []
    for k, (caption, figure) in enumerate(module.plot(result).items(), start=1):
        wide, narrow = f"{name}_{k}.png", f"{name}_{k}_narrow.png"
        made[wide] = _png(figure)
        if stack(figure):
            made[narrow] = _png(figure)
        figures.append((caption, wide, narrow if narrow in made else ""))
    if hasattr(module, "animate"):
        for k, (caption, page) in enumerate(module.animate(result).items(), start=1):
            made[f"{name}_{k}.html"] = page.encode()
            motions.append((caption, f"{name}_{k}.html"))
    seconds = time.perf_counter() - start
    rest = (tuple(figures), tuple(motions), _settings(settings), seconds, "", True)
    return Entry(name, _title(module), claims, *rest), made


def _png(figure: Figure) -> bytes:
    """Return a figure as PNG with 256 colors, which are enough for lines and bars."""
    from PIL import Image

    buffer, small = io.BytesIO(), io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DOTS_PER_INCH)
    Image.open(buffer).convert("RGB").quantize(256, dither=Image.Dither.NONE).save(small, "png", optimize=True)
    return small.getvalue()


def _plain(entry: Entry) -> dict:
    return entry._asdict() | {"claims": [dataclasses.asdict(claim) for claim in entry.claims]}


def _stored(path: Path, key: str) -> Entry | None:
    """Return the results of an earlier run, None unless they are complete and have this key."""
    try:
        content = json.loads(path.read_text("utf-8"))
        FORMAT.check(path, content.pop("format", None))
        if content.pop("key") != key:
            return None
        content["claims"] = tuple(Claim(**claim) for claim in content["claims"])
        for name in ("figures", "motions", "settings"):
            content[name] = tuple(map(tuple, content[name]))
        entry = Entry(**content)
        needed = [file for _, *files in (*entry.figures, *entry.motions) for file in files if file]
        return entry if all((path.parent / file).is_file() for file in needed) else None
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return None


def _program(module: Any) -> str:
    """Return the version and a digest of all sources on which an experiment depends."""
    file = getattr(module, "__file__", None)
    return f"{__version__} {digest(Path(file)) if file else ''}"


def _failure(error: Exception) -> str:
    """Return the error and where it was raised."""
    frame = extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__}: {error} ({Path(frame.filename).name}, line {frame.lineno})"


def _title(module: Any) -> str:
    return (module.__doc__ or module.__name__).strip().splitlines()[0].rstrip(".")


def _settings(settings: Any) -> tuple[tuple[str, str, str], ...]:
    """Return name and value of each setting, with the comment beside it in the source."""
    try:
        source = inspect.getsource(type(settings))
    except OSError:
        source = ""
    comments = dict(re.findall(r"^ {4}(\w+): .*?  # (.*)$", source, re.MULTILINE))
    return tuple(
        (field.name, _shown(getattr(settings, field.name)), comments.get(field.name, ""))
        for field in dataclasses.fields(settings)
    )


def _shown(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, tuple | list):
        return ", ".join(map(_shown, value))
    return str(value)


def write_report(folder: Path, entries: Sequence[Entry], full: bool, seed: int) -> None:
    """Write reproduction.html, reproduction.md and reproduction.csv."""
    facts = _facts(entries, full, seed)
    files = folder / "reproduction_files"
    _write(folder / "reproduction.html", _html(entries, facts, files).encode())
    write_csv(folder / "reproduction.csv", TABLE, TABLE_COLUMNS, _table(entries), _note(facts))
    _write(folder / "reproduction.md", _markdown(entries, facts, files.name).encode())


def _table(entries: Sequence[Entry]) -> list[tuple[str, ...]]:
    """Return each claim as plain text, in the paper's order; our own questions are last."""
    found = sorted(((entry.name, c) for entry in entries for c in entry.claims), key=lambda pair: pair[1].place)
    return [(name, c.item, c.claim, c.paper, c.ours, c.stated, c.interval, c.word) for name, c in found]


def _note(facts: list[tuple[str, str]]) -> str:
    """Return what the table describes, independent of time and machine."""
    return "\n".join(f"{name}: {text}" for name, text in facts if name in ("Size and seed", "Program"))


def _facts(entries: Sequence[Entry], full: bool, seed: int) -> list[tuple[str, str]]:
    """Return the facts about the report itself."""
    claims = [claim for entry in entries for claim in entry.claims]
    verdicts = Counter(claim.verdict for claim in claims if claim.item)
    counts = [f"{count} {verdict}" for verdict in get_args(Verdict) if (count := verdicts[verdict])]
    own = Counter(claim.word for claim in claims if not claim.item)
    failed = [entry.name for entry in entries if entry.failure]
    waiting = [entry.name for entry in entries if not (entry.finished or entry.failure)]
    packages = ", ".join(f"{name} {metadata.version(name)}" for name in ("numpy", "numba", "scipy"))
    machine = f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores"
    size = "full" if full else "quick"
    facts = [
        ("The paper", ", ".join(counts) or "nothing yet"),
        ("Own questions", ", ".join(f"{count} {word}" for word, count in own.items()) or "none yet"),
        ("Size and seed", f"{size}, seed {seed}"),
        ("Program", f"featherstone-gait {__version__}, Python {platform.python_version()}, {packages}"),
        ("Machine", machine),
        ("Time", f"{sum(entry.seconds for entry in entries):.0f} s in {sum(e.finished for e in entries)} experiments"),
    ]
    facts += [("Failed", ", ".join(failed))] if failed else []
    return facts + ([("Not run yet", ", ".join(waiting))] if waiting else [])


class ReportRow(NamedTuple):
    """A row of the paper's table, or of that of our own questions, whose `item` and paper's cells are empty."""

    item: str
    statement: str
    paper: str
    here: str
    factor: str
    accepted: str
    verdict: str
    why: str
    where: str  # experiment, or file


def _paper_rows(entries: Sequence[Entry]) -> list[ReportRow]:
    """Return a row for each result that the paper states, in its order, then one for each failed experiment."""
    rows = []
    for key, item in ITEMS.items():
        found = [_row(entry.name, c, f"{item.title}. ") for entry in entries for c in entry.claims if c.item == key]
        waits = [ReportRow(key, item.title, "", "", "", "", "not run yet", "", "")] if not (found or item.here) else []
        rows += found + waits
    return rows + [ReportRow("", e.title, "", "", "", "", "failed", e.failure, e.name) for e in entries if e.failure]


def _own_rows(entries: Sequence[Entry]) -> list[ReportRow]:
    """Return the rows of our own questions."""
    return [_row(entry.name, claim) for entry in entries for claim in entry.claims if not claim.item]


def _row(name: str, c: Claim, title: str = "") -> ReportRow:
    statement = c.claim if title.startswith(c.claim) else title + c.claim
    return ReportRow(c.item, statement, c.paper, c.ours, c.stated, c.interval, c.word, c.why, name)


def _parts() -> list[tuple[str, str, str, str]]:
    """Return item, title, what is here, and file and test of the paper's models, methods and scenes."""
    return [(key, x.title, x.here, f"{x.module} {x.test}".strip()) for key, x in ITEMS.items() if x.here]


# ---------------------------------------------------------------------------------------------- HTML

SHADES = {"reproduced": "yes", "yes": "yes", "reproduced in direction": "part", "in part": "part",
          "undecided": "soft", "not run yet": "soft", NO_CURVE: "soft"}  # fmt: skip


def _html(entries: Sequence[Entry], facts: list[tuple[str, str]], files: Path) -> str:
    e = html.escape
    return Template(Path(__file__).with_suffix(".html").read_text("utf-8")).substitute(
        paper=e(PAPER),
        facts="".join(f"<tr><th>{e(name)}</th><td>{e(text)}</td></tr>" for name, text in facts),
        items=_html_table(COLUMNS, _paper_rows(entries)),
        questions=_html_table(OWN_COLUMNS, _own_rows(entries)),
        parts=_html_parts(),
        sections="".join(_html_section(entry, files) for entry in entries if entry.finished or entry.failure),
    )


def _html_table(columns: Sequence[str], rows: Sequence[ReportRow]) -> str:
    head = "".join(f"<th>{name}</th>" for name in columns)
    return (
        f'<table class="claims{" own" * (columns != COLUMNS)}"><tbody><tr class="head">{head}</tr>\n'
        f"{''.join(_html_row(row, columns) for row in rows)}</tbody></table>"
    )


def _html_parts() -> str:
    """Return the table of the paper's models, methods and scenes."""
    head = "".join(f"<th>{name}</th>" for name in PARTS)
    rows = []
    for row in _parts():
        *cells, files = map(html.escape, row)
        breaks = re.sub("([_/ ])", r"\1<wbr>", files)
        rows.append(f"<tr>{''.join(f'<td>{cell}</td>' for cell in cells)}<td><code>{breaks}</code></td></tr>")
    return f'<table class="claims"><tbody><tr class="head">{head}</tr>{"".join(rows)}</tbody></table>'


def _html_row(row: ReportRow, columns: Sequence[str]) -> str:
    e = html.escape
    link = f'<a href="#{e(row.where)}">{e(row.where)}</a>' if row.where else ""
    why = (f"<details><summary>why</summary>{e(row.why)}</details>" if row.why else "") + link
    cells = {
        "item": e(row.item), "statement": e(row.statement), "paper": e(row.paper), "here": e(row.here),
        "factor": _gauge(row.factor, row.accepted),
        "verdict": f'<span class="{SHADES.get(row.verdict, "no")}">{e(row.verdict)}</span>',
        "why": why,
    }  # fmt: skip
    shown = cells if columns == COLUMNS else {name: cells[name] for name in cells if name not in PAPER_ONLY}
    labels = dict(zip(shown, columns))  # shown where the page is narrow
    tags = (f'<td class="{name}"' + f' data-label="{labels[name]}">' * (name in LABELLED) + ">" * (name not in LABELLED)
            for name in shown)  # fmt: skip
    return f"<tr>{''.join(f'{tag}{x}</td>' for tag, x in zip(tags, shown.values()))}</tr>\n"


def _gauge(factor: str, accepted: str) -> str:
    """Return the factor and between which factors it is accepted, as text and on a logarithmic scale, 1/100 to 100."""
    if not factor or float(factor) <= 0.0 or not accepted:
        return factor
    left, right = (_place(float(x)) for x in accepted.split(" to "))
    band = f'<b style="left: {left:.0f}%; width: {right - left:.0f}%"></b>'
    dot = f'<i style="left: {_place(float(factor)):.0f}%"></i>'
    return f'{factor} ({accepted})<span class="gauge" aria-hidden="true">{band}{dot}</span>'


def _place(factor: float) -> float:
    return 50.0 + 25.0 * min(2.0, max(-2.0, math.log10(factor)))


def _html_section(entry: Entry, files: Path) -> str:
    e = html.escape
    parts = [f'<h2 id="{e(entry.name)}">{e(entry.title)}</h2>']
    if entry.failure:
        parts.append(f'<p class="failure">Failed: {e(entry.failure)}</p>')
    for caption, page in entry.motions:
        source = e((files / page).read_text("utf-8"))
        parts.append(
            f'<figure class="motion"><iframe title="{e(caption)}" loading="lazy" srcdoc="{source}"></iframe>'
            f"<figcaption>{e(caption)}</figcaption></figure>"
        )
    for caption, wide, narrow in entry.figures:
        kind = "" if narrow else ' class="wide"'
        other = f'<source media="(max-width: 600px)" srcset="{_inline(files / narrow)}">' if narrow else ""
        parts.append(
            f"<figure{kind}><picture>{other}"
            f'<img alt="{e(caption)}" width="{_width(files / wide)}" src="{_inline(files / wide)}"></picture>'
            f"<figcaption>{e(caption)}</figcaption></figure>"
        )
    cells = "".join(
        f'<tr><td class="name">{e(name)}</td><td>{e(value)}</td><td>{e(comment)}</td></tr>'
        for name, value, comment in entry.settings
    )
    parts.append(
        '<details><summary>Settings</summary><table class="settings"><tr><th>Name</th><th>Value</th>'
        f"<th>Unit, reason</th></tr>{cells}</table></details>"
    )
    if entry.finished:
        parts.append(f'<p class="time">{e(entry.name)}: {entry.seconds:.1f} s</p>')
    return "".join(parts) + "\n"


def _width(file: Path) -> int:
    """Return the width at which a picture is shown, so that all have the same type size."""
    pixels = int.from_bytes(file.read_bytes()[16:20], "big")  # the PNG's header
    return round(pixels * SHOWN_PER_INCH / DOTS_PER_INCH)


def _inline(file: Path) -> str:
    return f"data:image/png;base64,{base64.b64encode(file.read_bytes()).decode()}"


# ---------------------------------------------------------------------------------------------- Markdown


def _markdown(entries: Sequence[Entry], facts: list[tuple[str, str]], files: str) -> str:
    lines = ["# The paper, reproduced", "", _plain_text(PAPER), ""]
    lines += [f"- {name}: {_plain_text(text)}" for name, text in facts]
    items = [_with_place(row) for row in _paper_rows(entries)]
    lines += ["", "## What the paper claims", "", *_markdown_table(COLUMNS, items)]
    own = [[row.statement, row.here, row.verdict, _with_place(row)[-1]] for row in _own_rows(entries)]
    lines += ["", "## Our own questions", "", *_markdown_table(OWN_COLUMNS, own)]
    lines += ["", "## Models, methods and scenes of the paper", "", *_markdown_table(PARTS, _parts())]
    for entry in entries:
        if entry.finished or entry.failure:
            lines += _markdown_section(entry, files)
    return "\n".join(lines) + "\n"


def _with_place(row: ReportRow) -> tuple[str, ...]:
    factor = f"{row.factor} ({row.accepted})" if row.accepted else row.factor
    return (*row[:4], factor, row.verdict, f"{row.why} ({row.where})" if row.where else row.why)


def _markdown_section(entry: Entry, files: str) -> list[str]:
    lines = ["", f"## {_plain_text(entry.title)}", ""]
    if entry.failure:
        lines += [f"**Failed:** {_plain_text(entry.failure)}", ""]
    for caption, page in entry.motions:
        lines += [f"[{_plain_text(caption)}]({files}/{page})", ""]
    for caption, picture, _ in entry.figures:
        lines += [f"![{entry.name}]({files}/{picture})", "", _plain_text(caption), ""]
    lines += ["Settings", "", *_markdown_table(("Name", "Value", "Unit, reason"), entry.settings)]
    return [*lines, "", f"{entry.name}: {entry.seconds:.1f} s"] if entry.finished else lines


def _markdown_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    lines = [f"| {' | '.join(head)} |", f"|{' --- |' * len(head)}"]
    return lines + [f"| {' | '.join(map(_plain_text, row))} |" for row in rows]


def _plain_text(text: str) -> str:
    """Escape a text for Markdown and HTML, in one line."""
    return re.sub(r"([\\`*_{}\[\]<>|#~])", r"\\\1", " ".join(text.split()))


def _write(path: Path, data: bytes) -> None:
    with complete(path) as temporary:
        temporary.write_bytes(data)
