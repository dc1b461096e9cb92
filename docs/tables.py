"""Write the measured tables and numbers of README and pages: `python docs/tables.py`.

With `--check` nothing is written: what differs is printed, and the exit code is 1.  A table stands below a line
`<!-- table: PAGE.NAME -->`, up to the next empty line; a number stands behind `<!-- number: PAGE.NAME -->`.  Tables of
`keys` come from `docs/keys.py`, all others from files of `docs/reproduction/`, as `docs/tables.toml` describes them:

    files      the files; NAME=FILE gives a file another name
    where      column = value or values: takes the records that have these; `file` is a column too
    columns    header = template
    per        columns: makes one row of all records that are equal in these, and not one of each record
    rows       label = conditions like `where`: makes one row of the records that meet one of them, with a `label`
    across     columns: repeats each header that has a field, for each of their values
    transpose  exchanges rows and columns
    shown      the template of a number

A template is text with fields: `{speed*1000:.0f}` is the first value in the row, times 1000, `{range cost:.1f}` the
least and the largest value, `{count cost}` their number.  Where a value is missing, the text after `??` is taken, else
"-" is.
"""

from __future__ import annotations

import csv
import difflib
import functools
import json
import re
import sys
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).parent))

import keys

DOCS = Path(__file__).resolve().parent
PAGES = [path for path in sorted(DOCS.rglob("*.md")) if DOCS / "notebooks" not in path.parents]  # but copies of these
PAGES.append(DOCS.parent / "README.md")
DESCRIBED = tomllib.loads((DOCS / "tables.toml").read_text("utf-8"))
TABLE = re.compile(r"^(<!-- table: (\S+)\.(\S+) -->\n)(?:\|.*\n)*", re.MULTILINE)
NUMBER = re.compile(r"(<!-- number: (\S+)\.(\S+) -->)-?\d+(?:\.\d+)?(?:e-?\d+)?")
FIELD = re.compile(r"\{(?:(count|range) )?([^{}:*]+)(?:\*([0-9.e-]+))?(?::([^{}]*))?\}")
Record = Mapping[str, Any]
Condition = Mapping[str, Any]


@functools.cache
def records(file: str) -> Sequence[Record]:
    """Return the records of a file: the rows of a CSV, or of a gait's report the first gait and the one found."""
    name, _, path = file.rpartition("=")
    text, named = (DOCS / "reproduction" / path).read_text("utf-8"), {"file": name or path}
    if path.endswith(".csv"):
        rows = csv.DictReader(line for line in text.splitlines() if not line.startswith("#"))
        return [named | {column: cell.removeprefix("'") for column, cell in row.items()} for row in rows]
    report = json.loads(text)
    return [named | {"gait": gait} | _gait(report, key) for gait, key in (("first", "before"), ("found", "after"))]


def _gait(report: dict[str, Any], key: str) -> dict[str, Any]:
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


def _flat(values: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return nested values under names with dots."""
    flat: dict[str, Any] = {}
    for name, value in values.items():
        value = dict(enumerate(value)) if isinstance(value, list) else value
        flat |= _flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {f"{prefix}{name}": value}
    return flat


def selected(files: Iterable[str], conditions: Iterable[Condition]) -> list[Record]:
    """Return the records of the files that meet each of the conditions in turn."""
    every = [record for file in files for record in records(file)]
    found = []
    for condition in conditions:
        allowed = {column: values if isinstance(values, list) else [values] for column, values in condition.items()}
        met = [record for record in every if all(record.get(column) in allowed[column] for column in allowed)]
        if not met:
            raise ValueError(f"no record of {', '.join(files)} has {condition}")
        found += met
    return found


def filled(template: str, row: Sequence[Record]) -> str:
    """Return the text of a template for the records of a row, "-" where a field has no value."""
    for text in template.split(" ?? "):
        fields = FIELD.findall(text)
        if all(any(name in one for one in row) if kind == "count" else _values(name, row) for kind, name, *_ in fields):
            return FIELD.sub(lambda found: _cell(row, *found.groups()), text).strip()
    return "-"


def _values(name: str, row: Sequence[Record]) -> list[Any]:
    return [record[name] for record in row if record.get(name) not in (None, "")]


def _cell(row: Sequence[Record], kind: str | None, name: str, scale: str | None, form: str | None) -> str:
    values = _values(name, row)
    if kind == "count":
        return str(len(values))
    if form is None:
        return str(values[0])
    numbers = [float(scale or 1.0) * float(value) for value in values]
    ends = (min(numbers), max(numbers)) if kind == "range" else numbers[:1]
    return " to ".join(dict.fromkeys(_digits(number, form) for number in ends))


def _digits(number: float, form: str) -> str:
    """Return a number without zeros in its exponent or the sign of nothing; "g" has none of 1 to a million."""
    if form.endswith("g") and 1.0 <= abs(number) < 1e6:
        return f"{float(format(number, form)):g}"
    text = re.sub(r"e([+-])0", r"e\1", format(number, form))
    return text.lstrip("-+").removesuffix("e+0") if float(text) == 0.0 else text


def table(
    files: Sequence[str],
    columns: Mapping[str, str],
    where: Condition | None = None,
    per: Sequence[str] = (),
    rows: Mapping[str, Condition | Sequence[Condition]] | None = None,
    across: Sequence[str] = (),
    transpose: bool = False,
) -> str:
    """Return a table in Markdown."""
    found = [] if rows else selected(files, [where or {}])
    lines = _grouped(found, per) if per else [[record] for record in found]
    for label, conditions in (rows or {}).items():
        both = [{**(where or {}), **each} for each in (conditions if isinstance(conditions, list) else [conditions])]
        lines.append([{"label": label}, *selected(files, both)])
    known = {name for line in lines for record in line for name in record}
    if unknown := {field[1] for text in columns.values() for field in FIELD.findall(text)} - known:
        raise ValueError(f"{', '.join(files)}: there is no column {', '.join(map(repr, unknown))}")
    keys = _grouped((record for line in lines for record in line), across) if across else []
    shown = [(head, text, None) for head, text in columns.items() if "{" not in head]
    for key in keys:
        shown += [(filled(head, key), text, _key(key[0], across)) for head, text in columns.items() if "{" in head]
    cells = [[head for head, *_ in shown]]
    for line in lines:
        parts = [[record for record in line if key in (None, _key(record, across))] for _, _, key in shown]
        cells.append([filled(text, part) for (_, text, _), part in zip(shown, parts)])
    cells = [*map(list, zip(*cells))] if transpose else cells
    cells.insert(1, ["---"] * len(cells[0]))
    return "".join(f"| {' | '.join(row)} |\n".replace("|  |", "| |") for row in cells)


def _grouped(found: Iterable[Record], columns: Sequence[str]) -> list[list[Record]]:
    """Return the records that have all of these columns, with those that are equal in them together."""
    groups: dict[tuple[Any, ...], list[Record]] = {}
    for record in found:
        groups.setdefault(_key(record, columns), []).append(record)
    return [group for key, group in groups.items() if None not in key]


def _key(record: Record, columns: Sequence[str]) -> tuple[Any, ...]:
    return tuple(record.get(column) for column in columns)


def written(text: str) -> str:
    """Return the text of a page with the tables and numbers that the stored results have."""

    def shown(found: re.Match[str]) -> str:
        marker, page, name = found.groups()
        if page == "keys":
            return marker + keys.table(*keys.TABLES[name])
        described = dict(DESCRIBED[page][name])
        if template := described.pop("shown", None):
            return marker + filled(template, selected(described["files"], [described.get("where", {})]))
        return marker + table(**described)

    return NUMBER.sub(shown, TABLE.sub(shown, text))


def main(check: bool) -> int:
    changed = []
    for page in PAGES:
        old = page.read_text("utf-8")
        if (new := written(old)) != old:
            name = str(page.relative_to(DOCS.parent))
            changed += difflib.unified_diff(old.splitlines(), new.splitlines(), name, "stored results", "", "", 0, "")
            if not check:
                page.write_text(new, "utf-8")
    print(*changed, sep="\n")
    return int(check and bool(changed))


if __name__ == "__main__":
    raise SystemExit(main("--check" in sys.argv[1:]))
