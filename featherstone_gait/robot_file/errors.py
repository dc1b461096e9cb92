"""What is said of a robot file that cannot be used."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


class RobotFileError(ValueError):
    """A robot file that cannot be used; the message names file, element, value, what is allowed and a remedy."""


class RobotFileNotFoundError(RobotFileError, FileNotFoundError):
    """A robot file that is not there."""


@contextmanager
def blamed_on(file: str | Path) -> Iterator[None]:
    """Put the file's name before the message of any ValueError, unless it already has one."""
    try:
        yield
    except RobotFileError:
        raise
    except ValueError as error:
        raise RobotFileError(f"{file}: {error}") from error
