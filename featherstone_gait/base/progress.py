"""Progress bars, which are shown on a terminal and in a notebook, and not written into logs."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

from tqdm import tqdm

NOTEBOOK = "ipykernel"  # whose streams are no terminals and show a line that is written anew
FORMAT = "{desc}: {percentage:3.0f}%|{bar}| {elapsed}, {remaining} left{postfix}"


def progress_bar(*args: Any, progress: bool = True, **how: Any) -> tqdm:
    """Make a `tqdm` bar, shown if `progress` is set and errors go to a terminal or a notebook; how: as in `tqdm`.

    While the bar of a whole job is shown, that one moves instead.
    """
    stream = sys.stderr
    seen = stream is not None and (stream.isatty() or NOTEBOOK in type(stream).__module__)
    whole = _WHOLE.get()
    if whole is not None and progress:
        return _Part(*args, whole=whole, **how)
    return tqdm(*args, disable=not (progress and seen), **how)


class WholeJob:
    """The bar of a job with several stages, each with an estimate of its time [s]; it also tells what remains."""

    def __init__(self, stages: Mapping[str, float], progress: bool) -> None:
        self._stages, self._before, self._share, self._parts, self._past = stages, 0.0, 0.0, 1, 0
        self._bar = progress_bar(total=sum(stages.values()), progress=progress, bar_format=FORMAT, smoothing=0.0)

    @contextmanager
    def stage(self, name: str, parts: int = 1) -> Iterator[None]:
        """Let the bars of a stage move the bar of the job, `parts` equal ones in turn; at the end the stage is done."""
        self._share, self._parts, self._past = self._stages[name], parts, 0
        self._bar.set_description(name)
        token = None if self._bar.disable else _WHOLE.set(self)
        try:
            yield
        finally:
            if token is not None:
                _WHOLE.reset(token)
            self._before, self._share = self._before + self._share, 0.0
            self.show(0.0)

    def show(self, done: float, postfix: str | None = None, ended: bool = False) -> None:
        """Show how much of a part is done, 0 to 1, and what its bar tells."""
        at = self._before + self._share * min((self._past + done) / self._parts, 1.0)
        self._past += ended
        self._bar.n = min(max(at, self._bar.n), self._bar.total)
        self._bar.set_postfix_str(postfix or "")

    def close(self) -> None:
        """Leave the bar as it is."""
        self._bar.close()


class _Part(tqdm):
    """A bar that moves the bar of a whole job and is not shown itself."""

    disable: bool

    def __init__(self, *args: Any, whole: WholeJob, **how: Any) -> None:
        self._whole = whole
        super().__init__(*args, **how)

    def display(self, *_: Any, **__: Any) -> bool:
        self._whole.show(self.n / self.total if self.total else 0.0, self.postfix)
        return True

    def close(self) -> None:
        if not self.disable:
            self.disable = True
            self._decr_instances(self)
            self._whole.show(1.0, self.postfix, ended=True)


_WHOLE: ContextVar[WholeJob | None] = ContextVar("whole", default=None)
