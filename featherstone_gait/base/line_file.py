"""Files of JSON lines to which a long computation appends, and from which it resumes."""

from __future__ import annotations

import json
import logging
import os
from pathlib import Path
from typing import Any

from .files import claim

REMEDY = "delete this line and all below to resume before it"
_log = logging.getLogger(__name__)


class LineFile:
    """A file of JSON lines, which one process at a time writes: a line is written whole or not at all.

    `lines` holds those that were complete when it was opened; a last one that was cut off is dropped.  `remedy` is what
    to do about a damaged file.
    """

    def __init__(self, path: Path, resume: bool, remedy: str = REMEDY) -> None:
        self.path = path
        try:
            self._file = path.open("a+b" if resume else "x+b", buffering=0)
        except FileExistsError as error:
            raise FileExistsError(f"{path} exists; pass resume=True to continue it, or another file name") from error
        try:
            claim(self._file, path)
            self.lines = self._complete_lines(remedy)
        except BaseException:
            self._file.close()
            raise

    def write(self, content: dict[str, Any]) -> None:
        """Hand a line to the system, which keeps it whatever becomes of this process."""
        line, complete = (json.dumps(content) + "\n").encode(), self._file.seek(0, os.SEEK_END)
        try:
            while line:
                line = line[self._file.write(line) :]
        except OSError as error:
            self._file.truncate(complete)
            raise OSError(
                f"{self.path} cannot be written ({error.strerror}); what it holds is complete: make room, and resume"
            ) from error

    def sync(self) -> None:
        """Wait until all lines are on the disk."""
        try:
            os.fsync(self._file.fileno())
        except OSError:  # not a file on a disk
            pass

    def close(self) -> None:
        """Sync and close."""
        with self._file:
            self.sync()

    def _complete_lines(self, remedy: str) -> list[bytes]:
        self._file.seek(0)
        data = self._file.read()
        *lines, rest = data.split(b"\n")
        if rest and not rest.startswith(b"{"):
            raise ValueError(f"{self.path}, line {len(lines) + 1}: damaged; {remedy}")
        if rest:
            _log.warning("%s: dropped the last line, which was cut off", self.path)
            self._file.truncate(len(data) - len(rest))
        return lines
