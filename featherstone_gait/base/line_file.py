"""Files of JSON lines to which a long computation appends, and from which it resumes."""

from __future__ import annotations

import errno
import json
import logging
import os
from collections.abc import Callable
from itertools import accumulate
from pathlib import Path
from typing import Any

from .files import claim, parse_json

NO_DISK = (errno.EINVAL, errno.ENOTSUP, errno.EROFS)  # of what has nothing to wait for, such as a pipe
REMEDY = "delete this line and all below to resume before it"
_log = logging.getLogger(__name__)


def _line(content: dict[str, Any]) -> bytes:
    return (json.dumps(content) + "\n").encode()


class LineFile:
    """A file of JSON lines, which one process at a time writes: a line is written whole or not at all.

    An old file is read when it is opened: `check` is called with the content of its first line and with its name for
    messages, `take` with those of each of the others and the line's place in the file; a last line that was cut off is
    dropped.  A new file begins with the line `header`.  `remedy` is what to do about a damaged file.
    """

    def __init__(
        self, path: Path, resume: bool, header: dict[str, Any], check: Callable[[dict[str, Any], str], object],
        take: Callable[[dict[str, Any], str, int], object], remedy: str = REMEDY
    ) -> None:  # fmt: skip
        self.path = path
        try:
            self._file = path.open("a+b" if resume else "x+b", buffering=0)
        except FileExistsError as error:
            raise FileExistsError(f"{path} exists; pass resume=True to continue it, or another file name") from error
        try:
            claim(self._file, path)
            self._file.seek(0)
            place = 0
            with open(self._file.fileno(), "rb", closefd=False) as file:
                for number, line in enumerate(file, start=1):
                    what = f"{path}, line {number}"
                    if not line.endswith(b"\n"):
                        if not (line.startswith(b"{") if number > 1 else _line(header).startswith(line)):
                            raise ValueError(f"{what}: damaged; {remedy}")
                        _log.warning("%s: dropped the last line, which was cut off", path)
                        self._file.truncate(place)
                    elif number == 1:
                        check(parse_json(line, what, remedy), what)
                    else:
                        take(parse_json(line, what, remedy), what, place)
                    place += len(line)
            if self._file.seek(0, os.SEEK_END) == 0:
                self.write(header)
        except BaseException:
            self._file.close()
            raise

    def write(self, *contents: dict[str, Any]) -> list[int]:
        """Hand lines to the system, which keeps them whatever becomes of this process; return their places."""
        lines = [*map(_line, contents)]
        data, complete = memoryview(b"".join(lines)), self._file.seek(0, os.SEEK_END)
        try:
            while data:
                data = data[self._file.write(data) :]
        except OSError as error:
            self._file.truncate(complete)
            raise self._full(error) from error
        return [*accumulate(map(len, lines[:-1]), initial=complete)]

    def sync(self) -> None:
        """Wait until all lines are on the disk; some disks say only then that they are full."""
        try:
            os.fsync(self._file.fileno())
        except OSError as error:
            if error.errno not in NO_DISK:
                raise self._full(error) from error

    def _full(self, error: OSError) -> OSError:
        text = f"{self.path} cannot be written ({error.strerror}); what it holds is complete: make room, and resume"
        return OSError(text)

    def close(self) -> None:
        """Sync and close."""
        with self._file:
            self.sync()
