"""Histories of searches as files of JSON lines, from which an interrupted search resumes."""

from __future__ import annotations

import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from ..base.files import is_number
from ..base.line_file import REMEDY, LineFile
from .annealing import MESSAGES, AdaptiveSimulatedAnnealing, Visit

SYNC_INTERVAL = 1.0  # between moments at which the history is known to be on the disk, at least [s]


class AnnealingHistory:
    """The visits of an annealing search as JSON lines: a header with the settings, then a line a visit."""

    def __init__(self, path: Path, search: AdaptiveSimulatedAnnealing, resume: bool) -> None:
        self._search, self._synced = search, time.monotonic()
        number = lambda value: value if np.isfinite(value) else str(value)  # noqa: E731  JSON has no infinity
        bounds = None if search.bounds is None else [[number(b) for b in pair] for pair in search.bounds.tolist()]
        self._header = {
            "search": "adaptive simulated annealing", "version": 1,
            **{name: getattr(search, name) for name in ("seed", "max_miss", "max_iterations", "no_progress")},
            "amplitude": search.amplitude.tolist(), "bounds": bounds, "x0": search.x0.tolist(),
        }  # fmt: skip
        self._file = LineFile(path, resume, self._header, self._check, self._replay)
        self.close = self._file.close

    def write(self, visits: Iterable[Visit], statuses: Iterable[str]) -> None:
        """Write visits, and from time to time wait until they are on the disk."""
        for visit, status in zip(visits, statuses):
            self._file.write(_content(visit, status))
        if time.monotonic() - self._synced > SYNC_INTERVAL:
            self._file.sync()
            self._synced = time.monotonic()

    def _check(self, found: dict[str, Any], what: str) -> None:
        expected = self._header
        if is_number(found.get("version")) and found["version"] > expected["version"]:
            raise ValueError(
                f"{what}: the history's format is {found['version']}, of a newer version, and this one reads 1 to "
                f"{expected['version']}; resume with the version that began it, or take another file name"
            )
        for key in expected:
            if key not in ("max_iterations", "no_progress") and found.get(key) != expected[key]:
                raise ValueError(
                    f"{what}: the history's {key} is {found.get(key)}, but this search has {expected[key]}; "
                    "resume with the settings it was begun with, or take another file name"
                )

    def _replay(self, content: dict[str, Any], what: str, _: int) -> None:
        """Repeat a visit of the history, which must be the search's own next one."""
        search = self._search
        if search.status is not None:
            raise ValueError(
                f"{what}: the history is longer than this search may be ({MESSAGES[search.status]}); "
                "raise that setting, or take another file name"
            )
        x, f, text = search.ask(), content.get("f"), content.get("status")
        if content.get("iteration") != search.iteration or content.get("x") != x.tolist():
            wrong = f"not iteration {search.iteration} of this search; lines are missing or changed"
        elif not (f is None or is_number(f)) or not isinstance(text, str) or not text:
            wrong = f"f is {f!r}, status {text!r}; expected a finite number or null, and a text"
        else:
            search.tell(x, np.inf if f is None else f)
            if content == _content(search.visited[-1], text):
                return
            wrong = f"not what this search makes of a cost of {f}"
        raise ValueError(f"{what}: {wrong}; {REMEDY}")


def _content(visit: Visit, text: str) -> dict[str, Any]:
    """Return a visit as JSON will give it back."""
    finite = bool(np.isfinite(visit.f))
    return {
        "iteration": visit.iteration,
        "x": visit.x.tolist(),
        "f": visit.f if finite else None,
        "status": text or ("ok" if finite else "not finite"),
        "accepted": visit.accepted,
        "miss": visit.miss,
    }
