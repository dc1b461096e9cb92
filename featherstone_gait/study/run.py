"""Run a study: batches through an executor, finished runs into a log on disk, and from it the table.

The log is a file of JSON lines, NAME.jsonl: a header with the settings, then a line for each run in order of
completion, written and synced batch by batch.  An incomplete last line is dropped.  Only one process at a time uses a
log.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from concurrent.futures.thread import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from ..base.arguments import shown
from ..base.files import FilePath, Format, is_number, parse_json
from ..base.line_file import LineFile
from ..base.progress import progress_bar
from .measures import COLUMNS, run_batch
from .plot import plot_study
from .sensitivity import write_sensitivity
from .settings import Study
from .table import check_parquet, write_parquet, write_table

QUEUED = 256  # batches handed to the executor at a time: bounds memory, and is enough to keep a cluster busy
SMALL, LARGE, MANY = 8, 64, 1024  # runs of a batch; the larger from this many runs on
LOG = Format("study log")
REMEDY = "delete this line and all below, or the whole file to begin anew"
LOST = ("KilledWorker", "FutureCancelledError")  # what dask raises when workers die again and again, and a scheduler


class Outcome(NamedTuple):
    """The result of `run_study`.

    Attributes
    ----------
    table, picture : Path
        The CSV file with a row for each run, and the PNG file.
    statuses : dict of int
        Number of runs by status.
    computed : int
        Number of runs that were not in the log before.
    sensitivity : Path or None
        Table of Sobol's indices, for the sampling "saltelli".
    """

    table: Path
    picture: Path
    statuses: dict[str, int]
    computed: int
    sensitivity: Path | None = None


def run_study(
    study: Study,
    out: FilePath = ".",
    *,
    executor: Executor | None = None,
    batch: int | None = None,
    progress: bool = False,
    parquet: bool = False,
) -> Outcome:
    """Run a study, or continue it: run what its log does not have yet, then write its table and plot.

    Parameters
    ----------
    study : Study
        What `read_study` returns.
    out : path
        Folder of the log NAME.jsonl, the table NAME.csv, the plot NAME.png and, for the sampling "saltelli", of Sobol's
        indices (`sensitivity`).
    executor : concurrent.futures.Executor, optional
        By default a thread for each core.  It does not change the table.
    batch : int, optional
        Runs per task; by default 8, in studies of at least 1024 runs 64.  It does not change the table.
    progress : bool
        Show a progress bar.
    parquet : bool
        Also write NAME.parquet.

    Returns
    -------
    Outcome

    Raises
    ------
    ValueError
        The log is damaged or has other settings.
    OSError
        Another process uses the log, a file cannot be written, or the executor lost its workers; finished batches are
        kept.
    """
    if batch is not None and batch < 1:
        raise ValueError(f"batch is {batch}; give a whole number >= 1")
    if parquet:
        check_parquet()
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    table = folder / f"{study.name}.csv"
    with Log(table.with_suffix(".jsonl"), study) as log:
        computed = len(study) - log.count
        with progress_bar(total=len(study), initial=log.count, progress=progress, unit="run") as bar:
            if executor is not None:
                _evaluate(study, log, executor, batch, bar)
            elif computed:
                with ThreadPoolExecutor(cores()) as pool:
                    _evaluate(study, log, pool, batch, bar)
        statuses = write_table(table, study, log.rows())
        if parquet:
            write_parquet(table)
        plot_study(study, table, table.with_suffix(".png"))
        saltelli = study.settings["sampling"]["method"] == "saltelli"
        sensitivity = write_sensitivity(study, table) if saltelli else None
    return Outcome(table, table.with_suffix(".png"), statuses, computed, sensitivity)


def cores() -> int:
    """Count the processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _evaluate(study: Study, log: Log, executor: Executor, batch: int | None, bar: tqdm) -> None:
    """Submit all missing runs to the executor, and log their results."""
    running: dict[Future, list[int]] = {}
    again: set[int] = set()  # first runs of batches that were submitted twice

    def submit(runs: list[int]) -> None:
        points = [study.values(run) for run in runs]
        running[executor.submit(run_batch, study.setup, points)] = runs

    def collect() -> None:
        """Wait for a batch and log it; one that failed is tried again.

        Dask's executor ends a batch with an error if its worker is lost while the result is fetched.
        """
        errors = {each: _error(each) for each in wait(running, return_when=FIRST_COMPLETED).done}
        for future, error in sorted(errors.items(), key=lambda item: item[1] is not None):
            runs = running.pop(future)
            if error is None:
                log.append(runs, future.result())
                bar.update(len(runs))
            elif runs[0] in again:
                raise error
            else:
                again.add(runs[0])
                submit(runs)

    try:
        missing = np.flatnonzero(log.places < 0)
        size = batch or (LARGE if len(study) >= MANY else SMALL)
        for k in range(0, len(missing), size):
            submit(missing[k : k + size].tolist())
            if len(running) >= QUEUED:
                collect()
        while running:
            collect()
    except Exception as error:
        if not isinstance(error, BrokenExecutor) and type(error).__name__ not in LOST:
            raise
        raise OSError(f"workers ended unexpectedly ({error}); {log.saved()}") from error
    finally:
        for future in running:
            future.cancel()


def _error(future: Future) -> BaseException | None:
    return CancelledError() if future.cancelled() else future.exception()


class Log:
    """The finished runs on disk; `places` (runs,) are the offsets of their lines, -1 for missing runs."""

    def __init__(self, path: Path, study: Study) -> None:
        self.path = path
        self.places = np.full(len(study), -1, np.int64)
        self.texts, self.numbers = ("status", "message"), tuple(COLUMNS[study.setup.experiment])
        self._header = {"format": str(LOG), "study": "featherstone_gait", "runs": len(study), **study.settings}
        self._file = LineFile(path, True, self._header, self._check, self._take, REMEDY)

    def __enter__(self) -> Log:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    @property
    def count(self) -> int:
        """Number of finished runs."""
        return int((self.places >= 0).sum())

    def saved(self) -> str:
        """Say how to continue after a failure."""
        return f"{self.count} of {len(self.places)} runs are kept in {self.path}; start the study again to continue"

    def append(self, runs: list[int], rows: list[dict]) -> None:
        """Append runs, in whole lines, and wait until they are on the disk."""
        try:
            self.places[runs] = self._file.write(*({"run": run, **row} for run, row in zip(runs, rows)))
            self._file.sync()
        except OSError as error:
            raise OSError(f"{error}; {self.saved()}") from error

    def rows(self) -> Iterator[dict]:
        """Yield all rows in the order of the runs.  Raises ValueError if the file has changed since it was read."""
        with self.path.open("rb") as file:
            for run, place in enumerate(self.places.tolist()):
                file.seek(place)
                remedy = f"something else has written into it: {REMEDY}"
                what = f"{self.path}, run {run}"
                row = self._row(parse_json(file.readline(), what, remedy), what, remedy)
                if row["run"] != run:
                    raise ValueError(f"{self.path}, run {run}: damaged; {remedy} (found run {row['run']})")
                yield row

    def _check(self, found: dict[str, Any], _: str) -> None:
        LOG.check(self.path, found.get("format"))
        for key, value in self._header.items():
            if found.get(key) != value and key != "format":
                raise ValueError(
                    f"{self.path}: was begun with {key} = {shown(found.get(key))}, but this study has "
                    f"{shown(value)}; delete the file to begin anew, or choose another folder"
                )

    def _take(self, row: dict[str, Any], what: str, place: int) -> None:
        self.places[self._row(row, what, REMEDY)["run"]] = place

    def _row(self, row: dict[str, Any], what: str, remedy: str) -> dict[str, Any]:
        """Return a row.  Raises ValueError unless it belongs to this study."""
        whole = row.keys() == {"run", *self.texts, *self.numbers}
        if whole and type(row["run"]) is int and 0 <= row["run"] < len(self.places):
            numbers = (row[name] is None or is_number(row[name]) for name in self.numbers)
            if all(isinstance(row[name], str) for name in self.texts) and all(numbers):
                return row
        expected = f"expected run 0 to {len(self.places) - 1}, texts {self.texts}, numbers {self.numbers}"
        raise ValueError(f"{what}: damaged; {remedy} ({expected})")
