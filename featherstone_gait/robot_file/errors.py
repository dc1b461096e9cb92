"""What is said of a robot file: why it cannot be used, or what was passed over or assumed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

MAX_SHOWN = 50  # problems in a message


class RobotFileError(ValueError):
    """A robot file that cannot be used; the message names file, line, element, value, what is allowed and a remedy.

    `problems` lists all that is wrong; the message shows the first MAX_SHOWN.
    """

    problems: tuple[str, ...] = ()

    def __init__(self, message: str, problems: Iterable[str] = ()) -> None:
        super().__init__(message)
        self.problems = tuple(problems) or (message,)


class RobotFileNotFoundError(RobotFileError, FileNotFoundError):
    """A robot file that is not there."""


class RobotFileWarning(UserWarning):
    """A robot file was read, but something in it was passed over or assumed; `Model.notes` lists it all."""


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
    """The error of a file with one problem or more."""
    if len(problems) == 1:
        return RobotFileError(f"{file}: {problems[0]}", problems)
    rest = len(problems) - MAX_SHOWN
    lines = [f"{file}: {len(problems)} problems", *problems[:MAX_SHOWN], *([f"and {rest} more"] if rest > 0 else [])]
    return RobotFileError("\n  ".join(lines), problems)
