"""Rounds of fits on disk, so that an interrupted fit resumes where it was.

The log is a file of JSON lines: a header with the format, then a line for each round of each fit, written and synced
when the round is done.  A fit is known by a number made of all that it depends on, so that one file serves many, and a
fit to other recordings finds nothing there.
"""

from __future__ import annotations

from typing import TypedDict

from ..base.arguments import path as path_of
from ..base.files import FilePath, Format, is_number
from ..base.line_file import LineFile

LOG = Format("servo fit log", 3)
NUMBERS = ("round", "damping", "seconds")
REMEDY = "delete this line and all below, or the whole file to start again"


class FitRound(TypedDict):
    """A fit after a round."""

    round: int
    x: list[float]  # in units of the widths
    damping: float  # of the next step
    seconds: float  # of all rounds
    message: str  # how it ended; empty: it has not


class FitLog:
    """The last round of each fit; use it in a `with` statement.

    Parameters
    ----------
    path : path-like

    Raises
    ------
    OSError
        If another process works with the file.
    ValueError
        If the file is damaged or of another kind.
    """

    def __init__(self, path: FilePath) -> None:
        self.path = path_of("path", path)
        self._rounds: dict[str, FitRound] = {}
        check = lambda content, _: LOG.check(self.path, content.get("format", ""))  # noqa: E731
        self._file = LineFile(self.path, True, {"format": str(LOG)}, check, self._take, REMEDY)

    def __enter__(self) -> FitLog:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def last(self, key: str) -> FitRound | None:
        """Return the last round of a fit, None if there is none."""
        return self._rounds.get(key)

    def append(self, key: str, row: FitRound) -> None:
        """Write a round, and wait until it is on the disk."""
        self._file.write({"fit": key, **row})
        self._file.sync()
        self._rounds[key] = row

    def _take(self, content: dict, what: str, _: int) -> None:
        key, x = content.pop("fit", None), content.get("x")
        whole = isinstance(key, str) and content.keys() == FitRound.__annotations__.keys()
        if not whole or not isinstance(x, list) or not all(map(is_number, [*x, *(content[name] for name in NUMBERS)])):
            raise ValueError(f"{what}: damaged; {REMEDY} (expected fit, {', '.join(FitRound.__annotations__)})")
        self._rounds[key] = FitRound(**content)  # type: ignore[typeddict-item]
