"""One report of the experiments: all claims first, then each experiment with its figures and settings.

`reproduce` runs what is not finished yet and writes, in one folder, reproduction.html (one file, opens anywhere),
reproduction.md with its pictures, and for each finished experiment a file of its results, from which the next start
goes on if name, settings, seed and program are the same.
"""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import html
import inspect
import io
import json
import os
import platform
import re
import time
from collections import Counter
from collections.abc import Sequence
from importlib import import_module, metadata
from pathlib import Path
from traceback import extract_tb
from typing import TYPE_CHECKING, Any, NamedTuple, get_args

from tqdm import tqdm

from .. import __version__
from ..files import FilePath, Format, complete
from . import EXPERIMENTS
from .claim import Claim, Verdict

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PAPER = (
    'J. Lima, J. Gonçalves, P. Costa, A. Moreira: "Humanoid Gait Optimization Resorting to an Improved Simulation '
    'Model", International Journal of Advanced Robotic Systems 10 (2013), doi 10.5772/54766'
)
FORMAT = Format("experiment")
HEADINGS = ("Experiment", "Claim", "Paper", "Ours", "Verdict", "Why")
DOTS_PER_INCH = 150
COLOURS = dict(zip(get_args(Verdict), ("#1a7f37", "#9a6700", "#b42318")))


class Entry(NamedTuple):
    """What the report says of one experiment."""

    name: str
    title: str
    claims: tuple[Claim, ...] = ()
    figures: tuple[tuple[str, str], ...] = ()  # caption, file
    settings: tuple[tuple[str, str, str], ...] = ()  # name, value, unit and reason
    seconds: float = 0.0
    failure: str = ""  # what it raised
    finished: bool = False


def reproduce(
    names: Sequence[str] = (), out: FilePath = ".", full: bool = False, seed: int = 0, progress: bool = False
) -> list[Entry]:
    """Run the named experiments, all if none is named, and write the report into the folder `out`.

    An experiment that raises is reported as failed, and the others still run.  The report is written after each of
    them.  Raises ValueError for an unknown name.
    """
    for name in names:
        if name not in EXPERIMENTS:
            raise ValueError(f"there is no experiment {name!r}; experiments: {', '.join(EXPERIMENTS)}")
    folder = Path(out)
    files = folder / "reproduction_files"
    files.mkdir(parents=True, exist_ok=True)
    entries = {name: Entry(name, name) for name in EXPERIMENTS if not names or name in names}
    program = _program()
    with tqdm(entries, disable=not progress, unit="experiment") as bar:
        for name in bar:
            bar.set_description(name)
            entries[name] = _entry(files, name, full, seed, program, progress)
            write_report(folder, list(entries.values()), full, seed)
    return list(entries.values())


def _entry(files: Path, name: str, full: bool, seed: int, program: str, progress: bool) -> Entry:
    """From the file of its results if it is of the same settings, seed and program, or else by running it."""
    stored = files / f"{name}.json"
    try:
        module = import_module(f".{name}", __package__)
        settings = module.FULL if full else module.QUICK
        key = hashlib.sha256(f"{name}\n{settings!r}\n{seed}\n{program}".encode()).hexdigest()
        if (entry := _stored(stored, key)) is not None:
            return entry
        entry, pictures = _run(name, module, settings, seed, progress)
    except Exception as error:  # whatever goes wrong in one experiment, the others are reported
        return Entry(name, name, failure=_failure(error))
    for (_, picture), data in zip(entry.figures, pictures):
        _write(files / picture, data)
    _write(stored, json.dumps({"format": str(FORMAT), "key": key} | _plain(entry), indent=1).encode())
    return entry


def _run(name: str, module: Any, settings: Any, seed: int, progress: bool) -> tuple[Entry, list[bytes]]:
    start = time.perf_counter()
    known = inspect.signature(module.run).parameters
    how = {"seed": seed, "progress": progress}
    result = module.run(settings, **{name: value for name, value in how.items() if name in known})
    claims = tuple(module.check(result))
    figures = module.plot(result)
    pictures = [_png(figure) for figure in figures.values()]
    places = tuple((caption, f"{name}_{k}.png") for k, caption in enumerate(figures, start=1))
    seconds = time.perf_counter() - start
    return Entry(name, _title(module), claims, places, _settings(settings), seconds, "", True), pictures


def _png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DOTS_PER_INCH)
    return buffer.getvalue()


def _plain(entry: Entry) -> dict:
    return entry._asdict() | {"claims": [dataclasses.asdict(claim) for claim in entry.claims]}


def _stored(path: Path, key: str) -> Entry | None:
    """The results of an earlier run, None unless all of them are there and of this key."""
    try:
        content = json.loads(path.read_text("utf-8"))
        FORMAT.check(path, content.pop("format", None))
        if content.pop("key") != key:
            return None
        content["claims"] = tuple(Claim(**claim) for claim in content["claims"])
        for name in ("figures", "settings"):
            content[name] = tuple(map(tuple, content[name]))
        entry = Entry(**content)
        return entry if all((path.parent / picture).is_file() for _, picture in entry.figures) else None
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return None


def _program() -> str:
    """Version and a digest of all that results depend on here, so that a changed program runs again."""
    package = Path(__file__).parents[1]
    roots = package, package.parent / "robots"  # where the robots are in the repository; installed, in the package
    digest = hashlib.sha256()
    for path in sorted(path for root in roots for path in root.rglob("*") if path.suffix in (".py", ".toml", ".urdf")):
        digest.update(path.read_bytes())
    return f"{__version__} {digest.hexdigest()}"


def _failure(error: Exception) -> str:
    """The error and where it was raised."""
    frame = extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__}: {error} ({Path(frame.filename).name}, line {frame.lineno})"


def _title(module: Any) -> str:
    return (module.__doc__ or module.__name__).strip().splitlines()[0].rstrip(".")


def _settings(settings: Any) -> tuple[tuple[str, str, str], ...]:
    """Name and value of each setting, with the comment beside it in the source: unit and reason."""
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
    """Write reproduction.html and reproduction.md."""
    facts = _facts(entries, full, seed)
    files = folder / "reproduction_files"
    _write(folder / "reproduction.html", _html(entries, facts, files).encode())
    _write(folder / "reproduction.md", _markdown(entries, facts, files.name).encode())


def _facts(entries: Sequence[Entry], full: bool, seed: int) -> list[tuple[str, str]]:
    """What the report states about itself."""
    verdicts = Counter(claim.verdict for entry in entries for claim in entry.claims)
    counts = [f"{count} {verdict}" for verdict in get_args(Verdict) if (count := verdicts[verdict])]
    failed = [entry.name for entry in entries if entry.failure]
    waiting = [entry.name for entry in entries if not (entry.finished or entry.failure)]
    packages = ", ".join(f"{name} {metadata.version(name)}" for name in ("numpy", "numba", "scipy"))
    machine = f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores"
    size = "full" if full else "quick"
    facts = [
        ("Claims", ", ".join(counts) or "none yet"),
        ("Size and seed", f"{size}, seed {seed}"),
        ("Program", f"featherstone-gait {__version__}, Python {platform.python_version()}, {packages}"),
        ("Machine", machine),
        ("Time", f"{sum(entry.seconds for entry in entries):.0f} s in {sum(e.finished for e in entries)} experiments"),
    ]
    facts += [("Failed", ", ".join(failed))] if failed else []
    return facts + ([("Not run yet", ", ".join(waiting))] if waiting else [])


def _rows(entries: Sequence[Entry]) -> list[tuple[str, ...]]:
    """The table of claims; a failed experiment has one row."""
    rows: list[tuple[str, ...]] = []
    for entry in entries:
        rows += [(entry.name, c.claim, c.paper, c.ours, c.verdict, c.why) for c in entry.claims]
        if entry.failure:
            rows.append((entry.name, entry.title, "", "", "failed", entry.failure))
    return rows


# ---------------------------------------------------------------------------------------------- HTML

STYLE = """
:root { color-scheme: light; }
body { font: 15px/1.5 system-ui, "DejaVu Sans", sans-serif; color: #1f2328; background: #f6f8fa; margin: 0; }
main { max-width: 1180px; margin: 0 auto; padding: 24px 32px 64px; background: #fff; }
h1 { font-size: 26px; margin: 8px 0 4px; } h2 { font-size: 20px; margin: 40px 0 8px; padding-top: 16px;
border-top: 1px solid #d1d9e0; } h3 { font-size: 15px; margin: 20px 0 6px; }
p.source { color: #59636e; margin: 0 0 16px; }
table { border-collapse: collapse; width: 100%; font-size: 13px; line-height: 1.4; }
th { text-align: left; background: #f6f8fa; }
th, td { border: 1px solid #d1d9e0; padding: 6px 9px; vertical-align: top; }
table.facts { width: auto; margin-bottom: 20px; } table.facts th { width: 8em; }
table.settings { width: auto; }
td.name { white-space: nowrap; font-family: ui-monospace, "DejaVu Sans Mono", monospace; }
td.claim { width: 18%; } td.paper { width: 14%; } td.ours { width: 20%; }
td.verdict { font-weight: 600; width: 7em; } a { color: #0969da; text-decoration: none; }
figure { margin: 16px 0 24px; } figure img { max-width: 100%; height: auto; display: block; }
figcaption { color: #59636e; font-size: 13px; margin-top: 4px; max-width: 75em; }
p.failure { border-left: 4px solid #b42318; padding: 8px 12px; background: #fff1f0; }
p.time { color: #59636e; font-size: 13px; }
details summary { cursor: pointer; margin: 12px 0 6px; }
"""


def _html(entries: Sequence[Entry], facts: list[tuple[str, str]], files: Path) -> str:
    e = html.escape
    rows = "".join(map(_html_row, _rows(entries)))
    body = "".join(_html_section(entry, files) for entry in entries if entry.finished or entry.failure)
    about = "".join(f"<tr><th>{e(name)}</th><td>{e(text)}</td></tr>" for name, text in facts)
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>The paper, reproduced</title>'
        f"<style>{STYLE}</style></head>\n<body><main><h1>The paper, reproduced</h1>"
        f'<p class="source">{e(PAPER)}</p><table class="facts">{about}</table>\n'
        f"<table><tr>{''.join(f'<th>{name}</th>' for name in HEADINGS)}</tr>\n{rows}</table>\n{body}"
        "</main></body></html>\n"
    )


def _html_row(row: tuple[str, ...]) -> str:
    name, claim, paper, ours, verdict, why = map(html.escape, row)
    colour = COLOURS.get(row[4], COLOURS["not reproduced"])
    return (
        f'<tr><td class="name"><a href="#{name}">{name}</a></td><td class="claim">{claim}</td>'
        f'<td class="paper">{paper}</td><td class="ours">{ours}</td>'
        f'<td class="verdict" style="color:{colour}">{verdict}</td><td>{why}</td></tr>\n'
    )


def _html_section(entry: Entry, files: Path) -> str:
    e = html.escape
    parts = [f'<h2 id="{e(entry.name)}">{e(entry.title)}</h2>']
    if entry.failure:
        parts.append(f'<p class="failure">Failed: {e(entry.failure)}</p>')
    for caption, picture in entry.figures:
        data = base64.b64encode((files / picture).read_bytes()).decode()
        parts.append(
            f'<figure><img alt="{e(caption)}" src="data:image/png;base64,{data}"><figcaption>{e(caption)}</figcaption>'
            "</figure>"
        )
    cells = "".join(
        f'<tr><td class="name">{e(name)}</td><td>{e(value)}</td><td>{e(comment)}</td></tr>'
        for name, value, comment in entry.settings
    )
    parts.append(
        '<h3>Settings</h3><table class="settings"><tr><th>Name</th><th>Value</th><th>Unit, reason</th></tr>'
        f"{cells}</table>"
    )
    if entry.finished:
        parts.append(f'<p class="time">{e(entry.name)}: {entry.seconds:.1f} s</p>')
    return "".join(parts) + "\n"


# ---------------------------------------------------------------------------------------------- Markdown


def _markdown(entries: Sequence[Entry], facts: list[tuple[str, str]], files: str) -> str:
    lines = ["# The paper, reproduced", "", _plain_text(PAPER), ""]
    lines += [f"- {name}: {_plain_text(text)}" for name, text in facts]
    lines += ["", *_markdown_table(HEADINGS, _rows(entries))]
    for entry in entries:
        if entry.finished or entry.failure:
            lines += _markdown_section(entry, files)
    return "\n".join(lines) + "\n"


def _markdown_section(entry: Entry, files: str) -> list[str]:
    lines = ["", f"## {_plain_text(entry.title)}", ""]
    if entry.failure:
        lines += [f"**Failed:** {_plain_text(entry.failure)}", ""]
    for caption, picture in entry.figures:
        lines += [f"![{entry.name}]({files}/{picture})", "", _plain_text(caption), ""]
    lines += ["Settings", "", *_markdown_table(("Name", "Value", "Unit, reason"), entry.settings)]
    return [*lines, "", f"{entry.name}: {entry.seconds:.1f} s"] if entry.finished else lines


def _markdown_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    lines = [f"| {' | '.join(head)} |", f"|{' --- |' * len(head)}"]
    return lines + [f"| {' | '.join(map(_plain_text, row))} |" for row in rows]


def _plain_text(text: str) -> str:
    """The text with nothing in it that Markdown or HTML would take for markup, in one line."""
    return re.sub(r"([\\`*_{}\[\]<>|#~])", r"\\\1", " ".join(text.split()))


def _write(path: Path, data: bytes) -> None:
    with complete(path) as temporary:
        temporary.write_bytes(data)
