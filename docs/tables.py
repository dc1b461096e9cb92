"""Tables and numbers of the pages, from the CSV and JSON files of `docs/reproduction/`.

A page describes a table in a fenced block, and Sphinx shows the table (`docs/conf.py`); `python docs/readme.py` writes
those of the README, which are described in comments.  For example:

    ```{results-table} floors_planned_stride.csv floors_nominal.csv
    :where: soles=spheres
    :rows: floor
    :columns: file
    floor | {floor}
    {file} | {mujoco_cost_J_per_m:.1f} J/m ?? falls, {mujoco_end_s:.1f} s
    ```

A row is made of one or several records of the files: of one each; with `:rows:`, of those that are equal in these
columns; or, in lines `= label | condition; condition`, of those that meet the conditions: the label is then `{label}`.
`:columns:` repeats the columns whose header has a field in braces for each value of these columns.  `:transpose:`
exchanges rows and columns.  A condition is a file name or `column=value|value`; `+` joins alternatives.

A template is text with fields: `{speed*1000:.0f}` is the first such value of the row's records, times 1000; with
`min`, `max`, `range` or `count` before the name it is of all records that have one: `{range cost:.1f}`.  Where a field
has no value the text after `??` is shown.  `{{ file.csv | condition | template }}` is a number within a page's text.
"""

from __future__ import annotations

import csv
import functools
import itertools
import json
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

STORED = Path(__file__).resolve().parent / "reproduction"
GAIT = "optimized_gait.json"  # stands beside the robot
FIELD = re.compile(r"\{(?:(min|max|range|count) )?([^{}:*]+)(?:\*([0-9.e-]+))?(?::([^{}]*))?\}")
BLOCK = re.compile(r"^```\{results-table\} ([^\n]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
NUMBER = re.compile(r"\{\{ ([^|{}]+) \| ([^|]*) \| (.+?) \}\}")
Record = dict[str, Any]


@functools.cache
def records(file: str) -> tuple[Record, ...]:
    """Return the records of a file: the rows of a CSV, or of a gait's report the first gait and the one found."""
    name, _, file = file.rpartition("=")
    path = STORED.parents[1] / "robots" / "humanoid" / file if file == GAIT else STORED / file
    text = path.read_text("utf-8")
    named = {"file": name or path.stem}
    if path.suffix == ".csv":
        lines = [line for line in text.splitlines() if not line.startswith("#")]
        rows = csv.DictReader(lines)
        return tuple(named | {name: cell.removeprefix("'") for name, cell in row.items()} for row in rows)
    report = json.loads(text)
    return tuple(named | {"gait": name} | _gait(report, key) for name, key in (("first", "before"), ("found", "after")))


def _gait(report: Record, key: str) -> Record:
    """Return what a report says of one gait, under names with dots."""
    limits = {limit["name"]: limit for limit in report["plausible"][key]["limits"]}
    kept = {"kept": sum(limit["kept"] for limit in limits.values()), "limits": len(limits)}
    parts = {"elsewhere": report["elsewhere"][key], "settings": report["settings"], "search": report["search"]}
    parts["plans"] = {row["baseline"]: row for row in report.get("at_equal_speed", ())}
    found = _flat(kept | report[key] | parts | limits)
    if key == "after" and report.get("crosscheck"):
        for name, text in zip(("mujoco", "here"), report["crosscheck"].split(";")):
            counts = re.search(r"on (\d+) of (\d+) floors(?:, ([0-9.]+) to ([0-9.]+) J/m)?", text)
            assert counts, text
            found |= dict(zip((f"{name}.floors", f"{name}.of", f"{name}.low", f"{name}.high"), counts.groups()))
            found[f"{name}.twelve"] = int(counts[1]) // 2  # with one kind of soles
    return found


def _flat(values: Record, prefix: str = "") -> Record:
    """Return nested values under names with dots."""
    flat: Record = {}
    for name, value in values.items():
        if isinstance(value, list):
            value = dict(enumerate(value))
        flat |= _flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {f"{prefix}{name}": value}
    return flat


def _selected(files: Sequence[str], conditions: str) -> list[Record]:
    """Return the records of the files that meet one of the alternatives."""
    found: list[Record] = []
    for alternative in conditions.split(" + "):
        parts = [part.strip() for part in alternative.split(";") if part.strip()]
        named = [part for part in parts if "=" not in part]
        equal = [part.split("=", 1) for part in parts if "=" in part]
        for record in itertools.chain(*(records(file) for file in named or files)):
            if all(str(record[column]) in values.split("|") for column, values in equal):
                found.append(record)
    if not found:
        raise ValueError(f"no record of {', '.join(files)} meets {conditions!r}")
    return found


def filled(template: str, row: Sequence[Record]) -> str:
    """Return the text of a template for the records of a row; raises ValueError where a field has no value."""
    for text in template.split(" ?? "):
        fields = FIELD.findall(text)
        if all(any(name in one for one in row) if kind == "count" else _values(name, row) for kind, name, *_ in fields):
            return FIELD.sub(lambda found: _cell(row, *found.groups()), text).strip()
    raise ValueError(f"{template!r}: a field has no value in any of {len(row)} records")


def _values(name: str, row: Sequence[Record]) -> list[Any]:
    return [record[name] for record in row if record.get(name) not in (None, "")]


def _cell(row: Sequence[Record], kind: str | None, name: str, scale: str | None, form: str | None) -> str:
    values = _values(name, row)
    if kind == "count":
        return str(len(values))
    if form is None and scale is None:
        return str(values[0])
    numbers = [float(scale or 1.0) * float(value) for value in values]
    chosen = {"min": [min(numbers)], "max": [max(numbers)], "range": [min(numbers), max(numbers)], None: numbers[:1]}
    return " to ".join(dict.fromkeys(_digits(number, form or "") for number in chosen[kind]))


def _digits(number: float, form: str) -> str:
    """Return a number without zeros in its exponent or the sign of nothing; "g" has none of 1 to a million."""
    if form.endswith("g") and 1.0 <= abs(number) < 1e6:
        return f"{float(format(number, form)):g}"
    text = re.sub(r"e([+-])0", r"e\1", format(number, form))
    return text.lstrip("-+").removesuffix("e+0") if float(text) == 0.0 else text


def table(files: Sequence[str], description: str) -> str:
    """Return a table in Markdown."""
    options, columns, labels = _parsed(description)
    where = options.get("where", "")
    if labels:
        rows = [
            [{"label": label}, *_selected(files, " + ".join(f"{where};{each}" for each in which.split(" + ")))]
            for label, which in labels
        ]
    else:
        found = _selected(files, where)
        rows = _grouped(found, options["rows"]) if "rows" in options else [[record] for record in found]
    known = {*itertools.chain(*itertools.chain(*rows))}
    for name in (name for _, template in columns for _, name, *_ in FIELD.findall(template)):
        if name not in known:
            raise ValueError(f"{', '.join(files)}: there is no column {name!r}")
    same_in = options.get("columns", "")
    keys = _grouped(itertools.chain(*rows), same_in) if same_in else []
    cells = [[_header(line[0], key) for line, key in _lines(columns, keys)]]
    for row in rows:
        cells.append([])
        for (_, template), key in _lines(columns, keys):
            same = [record for record in row if not key or _key(record, same_in) == _key(key[0], same_in)]
            cells[-1].append(filled(template, same) if same else "")
    cells = [*map(list, zip(*cells))] if "transpose" in options else cells
    cells.insert(1, ["---"] * len(cells[0]))
    return "\n".join(f"| {' | '.join(row)} |".replace("|  |", "| |") for row in cells)


def _parsed(description: str) -> tuple[dict[str, str], list[tuple[str, str]], list[tuple[str, str]]]:
    """Return the options, the columns as header and template, and the rows as label and condition."""
    options, columns, labels = {}, [], []
    for line in filter(None, map(str.strip, description.splitlines())):
        if option := re.fullmatch(r":(where|rows|columns|transpose):\s*(.*)", line):
            options[option[1]] = option[2]
            continue
        first, bar, second = line.removeprefix("= ").partition("|")
        if not bar:
            raise ValueError(f"{line!r}: expected a header and a template, or a label and a condition, between a bar")
        (labels if line.startswith("= ") else columns).append((first.strip(), second.strip()))
    return options, columns, labels


def _grouped(found: Iterable[Record], columns: str) -> list[list[Record]]:
    groups: dict[tuple, list[Record]] = {}
    for record in found:
        groups.setdefault(_key(record, columns), []).append(record)
    return [group for key, group in groups.items() if None not in key]


def _key(record: Record, columns: str) -> tuple:
    return tuple(record.get(name.strip()) for name in columns.split(","))


def _lines(
    columns: Sequence[tuple[str, str]], keys: Sequence[list[Record]]
) -> Iterator[tuple[tuple[str, str], list[Record] | None]]:
    """Yield each column with the records that it is repeated for."""
    once = [line for line in columns if not (keys and "{" in line[0])]
    yield from ((line, None) for line in once)
    yield from ((line, key) for key in keys for line in columns if line not in once)


def _header(text: str, key: list[Record] | None) -> str:
    return filled(text, key) if key else text


def resolved(page: str) -> str:
    """Return the text of a page with its tables and numbers."""
    page = BLOCK.sub(lambda found: table(found[1].split(), found[2]), page)
    return NUMBER.sub(lambda found: filled(found[3], _selected(found[1].split(), found[2])), page)
