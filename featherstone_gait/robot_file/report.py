"""Collect what a reader finds in a file: problems, assumptions and remarks, each with its place; raise errors."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element

from ..base.flaws import FlawError

MAX_SHOWN = 50  # problems in a message
SHOWN_IN_WARNING = 5


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
    """A robot file was read or written, but something was ignored, assumed or lost."""


@contextmanager
def blamed_on(file: str | Path) -> Iterator[None]:
    """Put the file's name before the message of any ValueError, unless it already has one."""
    try:
        yield
    except RobotFileError:
        raise
    except FlawError as error:
        raise refusal(file, [flaw.text for flaw in error.flaws]) from error
    except ValueError as error:
        raise refusal(file, [str(error)]) from error


def refusal(file: str | Path, problems: list[str]) -> RobotFileError:
    """Make the error of a file with one or more problems."""
    if len(problems) == 1:
        return RobotFileError(f"{file}: {problems[0]}", problems)
    rest = len(problems) - MAX_SHOWN
    lines = [f"{file}: {len(problems)} problems", *problems[:MAX_SHOWN], *([f"and {rest} more"] if rest > 0 else [])]
    return RobotFileError("\n  ".join(lines), problems)


def refuse_losses(file: Path, lost: list[str]) -> None:
    """Raise RobotFileError with all that a file would lack which is to be written, if anything."""
    if lost:
        raise refusal(file, [f"{one}; remove it from what is saved, or save with strict=False" for one in lost])


def warn_losses(file: Path, lost: list[str], stacklevel: int) -> None:
    """Emit one warning that lists what a written file lacks, if anything."""
    if lost:
        text = f"{file} is written, but lacks: {'; '.join(lost)} (strict=True refuses this)"
        warnings.warn(text, RobotFileWarning, stacklevel=stacklevel + 1)


class Found(NamedTuple):
    """Something in a file, and its line."""

    line: int  # 0: of the file as a whole
    text: str


class Report:
    """The findings in one file.

    A problem makes the file unusable.  An assumption is something with one meaning, although the file does not state it
    correctly: it is warned about, or with `strict` refused.  A remark is neither.
    """

    def __init__(self, lines: Mapping[Element, int], strict: bool = False) -> None:
        self.lines = lines
        self.strict = strict
        self.places: dict[str, int] = {}  # label, such as "link 'thigh'" -> line
        self.problems: list[Found] = []  # without the assumptions that strict refuses
        self._refused_assumptions: list[Found] = []
        self._assumed: dict[str, list[str]] = {}  # sentence -> labels of the elements
        self._remarks: Counter[str] = Counter()

    def refuse(self, element: Element | None, text: str) -> None:
        """Add a problem; the text names the element, the value, what is allowed and a remedy."""
        self.problems.append(Found(self.lines.get(element, 0) if element is not None else 0, text))

    def refuse_at(self, label: str, text: str) -> None:
        """Add a problem of an element that has been read, by its label."""
        self.problems.append(Found(self.places.get(label, 0), text))

    def assume(self, element: Element, what: str, found: str, taken: str, remedy: str) -> None:
        """Add an assumption: what is found in an element and how it is read; the remedy is for strict reading."""
        self._assume(self.lines[element], what, found, taken, remedy)

    def assume_at(self, label: str, found: str, taken: str, remedy: str) -> None:
        """Add an assumption about an element that has been read, by its label."""
        self._assume(self.places.get(label, 0), label, found, taken, remedy)

    def _assume(self, line: int, what: str, found: str, taken: str, remedy: str) -> None:
        if self.strict:
            self._refused_assumptions.append(Found(line, f"{what}: {found}; {remedy}"))
        self._assumed.setdefault(f"{found}: {taken}", []).append(what)

    def doubt(self, sentence: str) -> None:
        """Add what the file as a whole says that is ignored although the motion depends on it."""
        if self.strict:
            self.refuse(None, f"{sentence}; remove it, or load with strict=False")
        self._assumed.setdefault(sentence, [])

    def remark(self, sentence: str) -> None:
        """Add what does not affect the simulation; repeated sentences are counted."""
        self._remarks[sentence] += 1

    @contextmanager
    def blaming(self, element: Element | None = None) -> Iterator[None]:
        """Catch a ValueError and add it as a problem, of the element or of the one that it names."""
        try:
            yield
        except FlawError as error:
            for flaw in error.flaws:
                line = self.lines[element] if element is not None else self.places.get(flaw.element, 0)
                self.problems.append(Found(line, flaw.text))
        except ValueError as error:
            self.refuse(element, str(error))

    def notes(self) -> tuple[str, ...]:
        """Return a sentence for each kind of thing that was assumed or ignored, assumptions first."""
        remarks = (sentence + (f" ({n} times)" if n > 1 else "") for sentence, n in self._remarks.items())
        return (*self._assumptions(), *remarks)

    def _assumptions(self) -> tuple[str, ...]:
        """Return what was assumed or doubted."""
        several = {sentence: len(labels) - 1 for sentence, labels in self._assumed.items()}
        return tuple(
            labels[0] + (f" and {several[sentence]} more" if several[sentence] else "") + f": {sentence}"
            if labels
            else sentence
            for sentence, labels in self._assumed.items()
        )

    def raise_problems(self, file: Path) -> None:
        """Raise RobotFileError with all problems, in the order of their lines."""
        problems = [*self.problems, *self._refused_assumptions]
        if problems:
            ordered = dict.fromkeys(sorted(problems, key=lambda found: found.line))
            raise refusal(file, [f"line {line}: {text}" if line else text for line, text in ordered])

    def warn(self, file: Path, stacklevel: int) -> None:
        """Emit one warning that lists what was assumed."""
        assumed = self._assumptions()
        if assumed:
            rest = len(assumed) - SHOWN_IN_WARNING
            shown = [*assumed[:SHOWN_IN_WARNING], *([f"and {rest} more in its notes"] if rest > 0 else [])]
            text = f"{file}: {'; '.join(shown)} (strict=True refuses this)"
            warnings.warn(text, RobotFileWarning, stacklevel=stacklevel + 1)
