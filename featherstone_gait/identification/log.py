"""Rounds of fits on disk, so that a fit that was interrupted goes on where it was.

The log is a file of JSON lines: a header with the format, then a line for each round of each fit, written and synced
when the round is done.  A fit is known by a number made of all that it depends on, so that one file serves many, and a
fit to other recordings finds nothing there.  A last line that was cut off is dropped.  One process at a time works with
a log.
"""

from __future__ import annotations

import json
import logging
import os
from pathlib import Path
from typing import TypedDict

from ..base.arguments import path as path_of
from ..base.files import FilePath, Format, claim, is_number, parse_json

LOG = Format("servo fit log")
REMEDY = "delete this line and all below, or the whole file to begin anew"
_log = logging.getLogger(__name__)


class FitRound(TypedDict):
    """A fit after a round."""

    round: int
    x: list[float]  # in units of the widths
    seconds: float  # of all rounds
    message: str  # how it ended; empty: it has not


class FitLog:
    """The last round of each fit; use it in a `with`.  Raises OSError if another process is at work with the file."""

    def __init__(self, path: FilePath) -> None:
        self.path = path_of("path", path)
        self.rows: dict[str, FitRound] = {}
        self.file = Path(path).open("a+b", buffering=0)
        try:
            claim(self.file, path)
            if self._read() == 0:
                self._write({"format": str(LOG)})
        except BaseException:
            self.file.close()
            raise

    def __enter__(self) -> FitLog:
        return self

    def __exit__(self, *_: object) -> None:
        self.file.close()

    def last(self, key: str) -> FitRound | None:
        """The last round of a fit, None if there is none."""
        return self.rows.get(key)

    def append(self, key: str, row: FitRound) -> None:
        """Write a round down, and wait until it is on the disk."""
        self._write({"fit": key, **row})
        self.rows[key] = row

    def _write(self, content: dict) -> None:
        end = self.file.seek(0, os.SEEK_END)
        try:
            self.file.write((json.dumps(content) + "\n").encode("ascii"))
            os.fsync(self.file.fileno())
        except OSError as error:
            self.file.truncate(end)
            raise OSError(f"{self.path}: cannot be written ({error.strerror}): make room and start again") from error

    def _read(self) -> int:
        """Take the rounds of earlier starts; return the length of what is sound."""
        self.file.seek(0)
        place = 0
        for number, line in enumerate(self.file.read().splitlines(keepends=True), start=1):
            if not line.endswith(b"\n") and line.startswith(b"{"):
                _log.warning("%s: dropped the last line, which was cut off", self.path)
                self.file.truncate(place)
                break
            what = f"{self.path}, line {number}"
            content = parse_json(line, what, REMEDY)
            if number == 1:
                LOG.check(self.path, content.get("format", ""))
            else:
                self._take(content, what)
            place += len(line)
        return place

    def _take(self, content: dict, what: str) -> None:
        key, x = content.pop("fit", None), content.get("x")
        whole = isinstance(key, str) and content.keys() == FitRound.__annotations__.keys()
        if not whole or not isinstance(x, list) or not all(map(is_number, [*x, content["round"], content["seconds"]])):
            raise ValueError(f"{what}: damaged; {REMEDY} (expected fit, {', '.join(FitRound.__annotations__)})")
        self.rows[key] = FitRound(**content)  # type: ignore[typeddict-item]
