"""Kernels compiled by one process at a time.

Processes share the folder of compiled kernels.  Numba's index of it is read, changed and written back without a lock:
of two processes that compile different versions of one kernel at the same moment, one may lose its entry or, worse,
leave its code under the other's name.  Hence each process compiles a kind of scene for the first time, or loads it,
while it holds a lock; the lock goes with the process, however that ends.
"""

from __future__ import annotations

import os
from contextlib import contextmanager

_seen: set[tuple] = set()


@contextmanager
def one_process_at_a_time(folder: str, *kind):
    """Hold the lock of `folder` the first time that this process meets `kind`."""
    if kind in _seen or not folder:
        yield
        return
    with open(os.path.join(folder, "compiling.lock"), "ab") as file:
        _lock(file)
        yield
    _seen.add(kind)


def _lock(file) -> None:
    try:
        import fcntl
    except ImportError:  # Windows
        import msvcrt

        msvcrt.locking(file.fileno(), msvcrt.LK_LOCK, 1)
    else:
        fcntl.flock(file, fcntl.LOCK_EX)
