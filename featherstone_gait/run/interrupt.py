"""Native runs that Ctrl-C ends.

Python handles a signal in the main thread, between two of its own instructions: not before a kernel returns.  A kernel
called from there runs in a thread of its own, which looks at `Run.stop`, while the main thread waits for it.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

import numpy as np

from ..core.step.context import Run

Kernel = Callable[[Run, np.ndarray, np.ndarray], None]
PATIENCE = 0.1  # [s] between looks at signals that were delivered to another thread


def call_interruptibly(kernel: Kernel, run: Run, y: np.ndarray, out: np.ndarray) -> None:
    """Call the kernel; in the main thread, what is raised meanwhile (KeyboardInterrupt) ends it within a step."""
    if threading.current_thread() is not threading.main_thread():
        return kernel(run, y, out)
    _compile(kernel, run, y, out)  # here, where Ctrl-C ends that too
    failures: list[BaseException] = []
    done = threading.Event()  # an interrupted join takes a thread for ended

    def work() -> None:
        try:
            kernel(run, y, out)
        except BaseException as failure:
            failures.append(failure)
        finally:
            done.set()

    thread = threading.Thread(target=work)
    try:
        thread.start()
        while not done.wait(PATIENCE):
            pass
    except BaseException:
        run.stop[0] = 1
        done.wait()
        run.stop[0] = 0
        raise
    finally:
        if done.is_set():
            thread.join()
    if failures:
        raise failures[0]


def _compile(kernel: Kernel, run: Run, y: np.ndarray, out: np.ndarray) -> None:
    """Call the kernel for no step at all, which costs less than to ask whether it has been compiled for these types."""
    kept = y.copy()
    kernel(run._replace(plan=run.plan._replace(steps=0)), y, out[:1])
    y[...] = kept
