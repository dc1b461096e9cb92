"""Time calls in turn, print and write tables, save pictures: what all benchmarks share."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..base.files import Format, complete, write_csv

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TABLE = Format("benchmark table")
Shown = Mapping[str, tuple[str, str]]  # field of a row: its heading and the format of its column, width first


def in_turn(
    calls: Sequence[Callable[[], object]], repeats: int, clock: Callable[[], float] = time.thread_time, warm: int = 0
) -> np.ndarray:
    """Time several calls in turn, so that a busy machine slows all alike.

    Returns
    -------
    times : ndarray, shape (repeats, calls)
        Seconds of the clock, without the first `warm` turns.
    """
    times = np.zeros((repeats + warm, len(calls)))
    for row in times:
        for k, call in enumerate(calls):
            start = clock()
            call()
            row[k] = clock() - start
    return times[warm:]


def print_head(shown: Shown) -> None:
    """Print the headings of a table."""
    print(" ".join(f"{head:{'' if form[0] == '<' else '>'}{_width(form)}}" for head, form in shown.values()))


def print_row(row: Any, shown: Shown) -> None:
    """Print a row of a table, a NamedTuple; NaN leaves its cell empty."""
    cells = ((getattr(row, field), form) for field, (_, form) in shown.items())
    print(" ".join(f"{value:{form}}" if value == value else " " * _width(form) for value, form in cells), flush=True)


def _width(form: str) -> int:
    return int(form.lstrip("<").partition(".")[0].rstrip("%g"))


def print_table(rows: Iterable[Any], shown: Shown) -> None:
    """Print headings and rows."""
    print_head(shown)
    for row in rows:
        print_row(row, shown)


def write_table(path: Path, columns: Sequence[str], rows: Iterable[Sequence], notes: str = "") -> None:
    """Write CSV whole or not at all; its format and the notes, such as the machine, are comments above the header."""
    write_csv(path, TABLE, columns, rows, notes)


def save_figure(figure: Figure, path: Path) -> None:
    """Write a picture whole or not at all."""
    with complete(path) as temporary:
        figure.savefig(temporary, dpi=130)
