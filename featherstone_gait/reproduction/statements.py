"""The paper's statements, and the one rule that judges them all.

The paper leaves much out (masses, gains, steps, the first gait), and most answers depend on it.  So a statement is
judged in *cases*: each is one way to choose what is left out, or one reading of a text that has two.

- *holds*: it is true in nine of ten of the cases that decide it; a number: all of ours are within a tenth of it;
- *contradicted*: it is false in nine of ten of these;
- *open*: all else, and where fewer than half of the cases decide.  A number is open, never contradicted, as the paper
  gives the inputs of none; its row says between which values ours lie, and whether the paper's is inside of these.

A rule of all cases would call open what is swept far enough; `counts` of the report says what it would give.

`statements.toml` has the statements in the paper's order.  A notebook judges those that name it, and shows
them as `Judged`; its stored output carries them, and `read_judged` collects them from there.
"""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from html import escape
from pathlib import Path
from typing import Any, Literal

import numpy as np

TENTH = 0.1  # within which a number counts as the paper's; share of the cases that may differ
MIME = "application/vnd.featherstone-gait.statements+json"
Verdict = Literal["holds", "contradicted", "open"]
COLORS: dict[Verdict, str] = {"holds": "#0072b2", "contradicted": "#d55e00", "open": "#b8860b"}
Case = bool | float | Sequence[float] | None  # true, false, undecided, or our number or numbers


@dataclass(frozen=True)
class Statement:
    """A statement of the paper.

    Attributes
    ----------
    key, place, says : str
        Its name here, where it stands in the paper, and what it says.
    leaves_out : str
        What the paper does not give and the answer depends on.
    notebook : str
        The notebook that judges it, without its ending.
    numbers : tuple of float
        What the paper prints; empty if the statement has no number.
    unit : str
        Of the numbers.
    printed : str
        The numbers with the paper's unit, if they are read in another; empty if not.
    """

    key: str
    place: str
    says: str
    leaves_out: str
    notebook: str
    numbers: tuple[float, ...] = ()
    unit: str = ""
    printed: str = ""

    @property
    def paper(self) -> str:
        """The paper's numbers as it prints them, with their unit; "no number" if it prints none."""
        numbers = f"{', '.join(f'{x:g}' for x in self.numbers)} {self.unit}" if self.numbers else "no number"
        return self.printed or numbers


def _statement(key: str, row: Mapping[str, Any]) -> Statement:
    row = dict(row)
    numbers = row.pop("numbers", None) or ([row.pop("number")] if "number" in row else [])
    return Statement(key, numbers=tuple(map(float, numbers)), **row)


STATEMENTS = {
    key: _statement(key, row)
    for key, row in tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8")).items()
}


@dataclass(frozen=True)
class Row:
    """A statement that was judged.

    Attributes
    ----------
    key : str
        Of the statement.
    verdict : str
        "holds", "contradicted" or "open".
    ours : str
        In how many cases it is true, or between which values our numbers lie, and whether the paper's lies inside.
    cases : dict
        Each case with what came out: true, false, None where it cannot be decided, or our number or numbers.
    note : str
        What decides it, and what would change the verdict.
    """

    key: str
    verdict: Verdict
    ours: str
    cases: dict[str, Any]
    note: str

    @property
    def statement(self) -> Statement:
        """The statement itself."""
        return STATEMENTS[self.key]


def judge(key: str, cases: Mapping[str, Case], note: str) -> Row:
    """Judge a statement of the paper by the rule of this module.

    Parameters
    ----------
    key : str
        A key of `STATEMENTS`.
    cases : mapping of str to bool, None, float or sequence of float
        One entry for each choice of what the paper leaves out.  Of a statement with numbers: ours, in the paper's unit;
        NaN or None where a run has none, because its robot
        falls.  Of another: whether it is true, None if undecided.
    note : str
        What decides it, and what would change the verdict.

    Returns
    -------
    Row

    Raises
    ------
    ValueError
        If the statement is not known, there is no case, or a case is not of the statement's kind.
    """
    if key not in STATEMENTS:
        raise ValueError(f"statement is {key!r}; known are {', '.join(STATEMENTS)}")
    if not cases:
        raise ValueError(f"statement {key!r} has no case; give at least one")
    statement = STATEMENTS[key]
    if not statement.numbers:
        found = {name: _truth(key, name, case) for name, case in cases.items()}
        return Row(key, *_of_truths(list(found.values())), found, note)
    numbers = {name: _numbers(statement, name, case) for name, case in cases.items()}
    kept = {name: values[0] if len(values) == 1 else values for name, values in numbers.items()}
    plain = {name: _plain(value) for name, value in kept.items()}  # JSON knows no NaN
    return Row(key, *_of_numbers(statement, list(numbers.values())), plain, note)


def _truth(key: str, name: str, case: Case) -> bool | None:
    if case is None or case in (True, False):
        return None if case is None else bool(case)
    raise ValueError(f"case {name!r} of {key!r} is {case!r}; the statement has no number: give True, False or None")


def _numbers(statement: Statement, name: str, case: Case) -> list[float]:
    values = np.atleast_1d(np.array(case, dtype=object))
    if values.shape != (len(statement.numbers),) or any(isinstance(x, bool | np.bool) for x in values):
        raise ValueError(
            f"case {name!r} of {statement.key!r} is {case!r}; give as many numbers [{statement.unit}] as the paper "
            f"has: {len(statement.numbers)}"
        )
    return [math.nan if x is None else float(x) for x in values]


def _plain(value: float | list[float]) -> Any:
    if isinstance(value, list):
        return [_plain(x) for x in value]
    return value if math.isfinite(value) else None


def _of_truths(cases: list[bool | None]) -> tuple[Verdict, str]:
    true, decided = cases.count(True), len(cases) - cases.count(None)
    undecided = f"undecided in {len(cases) - decided}" if None in cases else ""
    ours = ", ".join(filter(None, (f"true in {true} of {decided} cases" if decided else "", undecided)))
    if 2 * decided < len(cases) or TENTH * decided < true < (1.0 - TENTH) * decided:
        return "open", ours
    return ("holds" if 2 * true > decided else "contradicted"), ours


def _of_numbers(statement: Statement, cases: list[list[float]]) -> tuple[Verdict, str]:
    spans, inside, close = [], [], []
    for paper, ours in zip(statement.numbers, zip(*cases)):
        finite = [x for x in ours if math.isfinite(x)]
        if not finite:
            return "open", f"in none of {len(cases)} cases a number"
        low, high = min(finite), max(finite)
        spans.append(_short(low) if low == high else f"{_short(low)} to {_short(high)}")
        inside.append(low <= paper <= high)
        close.append(len(finite) == len(ours) and all(abs(x - paper) <= TENTH * abs(paper) for x in ours))
    ours_text = f"{'; '.join(spans)} {statement.unit}"
    if all(close):
        return "holds", ours_text
    where = "inside" if all(inside) else "outside" if not any(inside) else f"{sum(inside)} of {len(inside)} inside"
    return "open", f"{ours_text}: the paper's {where}"


def _short(x: float) -> str:
    """Return a number with three digits, or all before the point."""
    return f"{x:.0f}" if abs(x) >= 1000 else f"{x:.3g}"


class Judged:
    """Rows of a notebook, in the paper's order: a table in a notebook, text elsewhere.

    Parameters
    ----------
    *rows : Row
        As `judge` returns them.

    Raises
    ------
    ValueError
        If rows of one notebook miss a statement that names it, or judge one twice.
    """

    def __init__(self, *rows: Row) -> None:
        places = list(STATEMENTS)
        self.rows = sorted(rows, key=lambda row: places.index(row.key))
        keys = [row.key for row in self.rows]
        notebooks = {row.statement.notebook for row in rows}
        if len(notebooks) == 1:
            wanted = [key for key, one in STATEMENTS.items() if one.notebook in notebooks]
            if keys != wanted:
                raise ValueError(f"judged are {', '.join(keys)}; {notebooks.pop()} judges {', '.join(wanted)}, once")

    def __iter__(self) -> Iterator[Row]:
        return iter(self.rows)

    def _repr_mimebundle_(self, **_: object) -> dict[str, Any]:
        rows = [asdict(row) for row in self.rows]
        return {MIME: rows, "text/html": table(self.rows), "text/plain": repr(self)}

    def __repr__(self) -> str:
        return "\n".join(
            f"{row.verdict.upper():12} {row.statement.place}: {row.statement.says}\n{'':12} paper: "
            f"{row.statement.paper}; here: {row.ours}\n{'':12} {row.note}"
            for row in self.rows
        )


def table(rows: Iterable[Row]) -> str:
    """Return rows as a table in HTML, each with its cases and its note behind a click."""
    lines = []
    for row in rows:
        one = row.statement
        cases = "".join(f"<li>{escape(name)}: {escape(_shown(case))}</li>" for name, case in row.cases.items())
        lines.append(
            f"<tr><td>{escape(one.place)}</td><td>{escape(one.says)}<details><summary>why</summary>"
            f"{escape(row.note)}<br>Left out: {escape(one.leaves_out)}.<ul>{cases}</ul></details></td>"
            f"<td>{escape(one.paper)}</td><td>{escape(row.ours)}</td>"
            f'<td><span style="color: {COLORS[row.verdict]}">&#9679;</span>&nbsp;<b>{row.verdict}</b></td></tr>'
        )
    head = "".join(f"<th>{name}</th>" for name in ("Place", "Statement", "Paper", "Here", "Verdict"))
    return f'<table class="statements"><tr>{head}</tr>{"".join(lines)}</table>'


def _shown(case: Any) -> str:
    if case is None:
        return "undecided"
    if isinstance(case, bool):
        return "true" if case else "false"
    if isinstance(case, list):
        return ", ".join(_shown(x) for x in case)
    return _short(case)


def read_judged(notebook: Path) -> list[Row]:
    """Return the rows that the stored output of a notebook carries; none if it was not run."""
    cells = json.loads(notebook.read_text("utf-8"))["cells"]
    outputs = (output for cell in cells for output in cell.get("outputs", ()))
    return [Row(**row) for output in outputs for row in output.get("data", {}).get(MIME, ())]
