"""Run calls in a separate process, which ends when one takes too much CPU time."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from types import TracebackType
from typing import Any

from ..base.processes import process_pool


class Worker:
    """Call functions in one separate process, and in a new one after a call has ended it."""

    def __init__(self) -> None:
        self._pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> Worker:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._close()

    def call(self, function: Callable[..., Any], *args: Any) -> Any:
        """Return what the function returns, or None where it ended its process: see `at_most`."""
        if self._pool is None:
            self._pool = process_pool(1)
        try:
            return self._pool.submit(function, *args).result()
        except BrokenProcessPool:
            self._close()
            return None

    def _close(self) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)
            self._pool = None


@contextmanager
def at_most(seconds: float) -> Iterator[None]:
    """End the process if the block takes more CPU time [s]; this stops compiled code too.

    Windows has no such clock: there is no limit there.
    """
    if not hasattr(signal, "setitimer"):
        yield
        return
    signal.signal(signal.SIGPROF, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
