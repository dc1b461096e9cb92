"""Run kernels so that Ctrl-C ends them.

Python handles a signal in the main thread, between two of its own instructions, and so not before a kernel returns.
A long kernel called from the main thread therefore runs in another thread and looks at `Run.stop`, while the main
thread waits.  One such thread serves all calls, since starting a thread takes as long as a short run.  Handing a run
over takes time too, so runs with error control, whose length is not known, begin in the thread that calls them.
"""

from __future__ import annotations

import os
import queue
import threading
from collections.abc import Callable
from typing import Any

import numpy as np

from ..core.step.context import Run

Kernel = Callable[[Run, np.ndarray, np.ndarray], Any]
PATIENCE = 0.1  # [s] between looks at signals that were delivered to another thread


_jobs: list[queue.SimpleQueue] = []  # of the thread, if it is there


def ensure_compiled(kernel: Kernel, run: Run, y: np.ndarray, out: np.ndarray) -> None:
    """Compile the kernel by calling it for no step, which costs less than to ask whether it is compiled.

    In the main thread Ctrl-C ends the compilation too.
    """
    kept = y.copy()
    kernel(run._replace(plan=run.plan._replace(steps=0)), y, out[:1])
    y[...] = kept


def call_interruptibly(kernel: Kernel, run: Run, y: np.ndarray, out: np.ndarray) -> None:
    """Call a compiled kernel; in the main thread Ctrl-C, or another exception there, ends it within a step."""
    if threading.current_thread() is not threading.main_thread():
        return kernel(run, y, out)
    failures: list[BaseException] = []
    done = threading.Event()

    def work() -> None:
        try:
            kernel(run, y, out)
        except BaseException as failure:
            failures.append(failure)
        finally:
            done.set()

    if not _jobs:
        _begin()
    try:
        _jobs[0].put(work)
        while not done.wait(PATIENCE):
            pass
    except BaseException:
        run.stop[0] = 1
        ended = threading.Event()  # after all that the thread has been given
        _jobs[0].put(ended.set)
        ended.wait()
        run.stop[0] = 0
        raise
    if failures:
        raise failures[0]


def _begin() -> None:
    """Start the thread; it ends with the program, and a forked process starts its own."""
    jobs: queue.SimpleQueue = queue.SimpleQueue()
    threading.Thread(target=_work, args=(jobs,), name="featherstone_gait runs", daemon=True).start()
    _jobs.append(jobs)


def _work(jobs: queue.SimpleQueue) -> None:
    while True:
        jobs.get()()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_jobs.clear)
