"""Errors and warnings about a robot file."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

MAX_SHOWN = 50  # problems in a message


class RobotFileError(ValueError):
    """A robot file that cannot be used; the message names file, line, element, value, what is allowed and a remedy.

    Attributes
    ----------
    problems : tuple of str
        All problems; the message shows the first MAX_SHOWN.
    """

    problems: tuple[str, ...] = ()

    def __init__(self, message: str, problems: Iterable[str] = ()) -> None:
        super().__init__(message)
        self.problems = tuple(problems) or (message,)


class RobotFileNotFoundError(RobotFileError, FileNotFoundError):
    """A robot file that does not exist."""


class RobotFileWarning(UserWarning):
    """A robot file was read, but something in it was ignored or assumed; `Model.notes` lists it all."""


@contextmanager
def blamed_on(file: str | Path) -> Iterator[None]:
    """Put the file's name before the message of any ValueError, unless it already has one."""
    try:
        yield
    except RobotFileError:
        raise
    except ValueError as error:
        raise refusal(file, [str(error)]) from error


def refusal(file: str | Path, problems: list[str]) -> RobotFileError:
    """Make the error of a file with one or more problems."""
    if len(problems) == 1:
        return RobotFileError(f"{file}: {problems[0]}", problems)
    rest = len(problems) - MAX_SHOWN
    lines = [f"{file}: {len(problems)} problems", *problems[:MAX_SHOWN], *([f"and {rest} more"] if rest > 0 else [])]
    return RobotFileError("\n  ".join(lines), problems)
