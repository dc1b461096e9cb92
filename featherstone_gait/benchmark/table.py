"""The tables that benchmarks write."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from ..base.files import Format, write_csv

TABLE = Format("benchmark table")


def write_table(path: Path, columns: Sequence[str], rows: Iterable[Sequence], notes: str = "") -> None:
    """Write CSV whole or not at all; its format and the notes, such as the machine, are comments over the header."""
    write_csv(path, TABLE, columns, rows, notes)
