"""Write the table of a study atomically: a row for each run, in the order of the runs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from ..base.files import Format, complete, read_csv, write_csv
from .measures import COLUMNS
from .settings import Study

TABLE = Format("study table")


def write_table(path: Path, study: Study, rows: Iterable[Mapping[str, Any]]) -> dict[str, int]:
    """Write CSV: run, varied parameters, status, measures, message; return the number of runs by status.

    rows: by column, in the order of the runs.

    The cell of a draw is its mean, in units of its scale.  A comment above the header states the format.  Numbers have
    all their digits; cells without a value are empty.
    """
    names = ["status", *COLUMNS[study.setup.experiment], "message"]
    statuses: Counter[str] = Counter()

    def lines() -> Iterator[list[Any]]:
        for run, row in enumerate(rows):
            statuses[row["status"]] += 1
            yield [run, *study.cells(run), *(row[name] for name in names)]

    write_csv(path, TABLE, ["run", *study.names, *names], lines(), end="\n")
    return dict(statuses.most_common())


def read_columns(table: Path, names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Read some of a table's columns, as text; of all, those of millions of runs would fill the memory."""
    lines = (cells for _, cells in read_csv(table, TABLE))
    header = next(lines)
    places = [header.index(name) for name in names]
    return dict(zip(names, zip(*([cells[k] for k in places] for cells in lines))))


def check_parquet() -> None:
    """Raise ValueError unless pandas can write Parquet."""
    missing = [name for name in ("pandas", "pyarrow") if find_spec(name) is None]
    if missing:
        raise ValueError(
            f"Parquet needs {' and '.join(missing)}: pip install {' '.join(missing)}, or leave it out: the table is "
            "also written as CSV"
        )


def write_parquet(table: Path) -> None:
    """Write the CSV as Parquet beside it."""
    import pandas

    frame = pandas.read_csv(table, skiprows=1, float_precision="round_trip", keep_default_na=False, na_values=[""])
    with complete(table.with_suffix(".parquet")) as temporary:
        frame.to_parquet(temporary, index=False)
