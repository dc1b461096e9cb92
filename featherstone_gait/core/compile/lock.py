"""Locks on open files, which go with the process, however that ends."""

import os
import weakref

LOCKED_BYTE = 1 << 40  # Windows locks bytes, and others could not read them: one beyond the end of any file


def lock(file, wait=False) -> bool:
    """Lock an open file until it is closed; False if another process or thread has it and there is no waiting.

    Returns True where the file system has no locks.
    """
    _LOCKED.add(file)
    try:
        return _lock(file, wait)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:
        return True


def _lock(file, wait):
    try:
        import fcntl
    except ImportError:  # Windows
        import msvcrt

        file.seek(LOCKED_BYTE)
        msvcrt.locking(file.fileno(), msvcrt.LK_LOCK if wait else msvcrt.LK_NBLCK, 1)
    else:
        fcntl.flock(file, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
    return True


# A child that is forked would share the lock, and keep it when its parent is killed.
_LOCKED: weakref.WeakSet = weakref.WeakSet()


def _close_in_child():
    for file in list(_LOCKED):
        file.close()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_close_in_child)
