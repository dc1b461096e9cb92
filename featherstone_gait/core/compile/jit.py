"""How the kernels are compiled: the three decorators, the Numba options and the cache.

`kernel` marks a function that is only called by other kernels, `inline` a small one that is merged into its caller,
`entry` one that Python calls: it is cached on disk (with everything it calls) and releases the GIL.

Numba's own cache does not see an edit in a *called* file, so the cache lies in a folder named by the hash of all
sources of this package: other sources, other folder; a stale kernel cannot be loaded.  Numba does not tell kernels with
bounds checks from those without either, so they have a folder of their own.  It reads, changes and writes the folder's
index without a lock: of two processes that save different versions of one kernel at the same moment, one may lose its
entry or leave its code under the other's name.  Hence one process at a time saves.

Floating point is strict IEEE 754 (no fastmath), which is what makes results equal to the bit in any width, on any
number of threads and with the JIT off.
"""

from __future__ import annotations

import functools
import hashlib
import os
import tempfile
from contextlib import contextmanager
from pathlib import Path

import numba
import numpy as np
from llvmlite.binding import get_host_cpu_features

JIT = not numba.config.DISABLE_JIT


def source_hash() -> str:
    """Hash of every source file of `core`, the key of the cache."""
    digest = hashlib.sha256()
    core = Path(__file__).parents[1]
    for path in sorted(core.rglob("*.py")):
        digest.update(path.relative_to(core).as_posix().encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _cache_folder() -> str:
    """A writable folder for this version of the kernels: NUMBA_CACHE_DIR, the user's cache, or a temporary one."""
    user = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    for root in (numba.config.CACHE_DIR, os.path.join(user, "featherstone_gait")):
        if not root:
            continue
        folder = os.path.join(root, source_hash() + ("_boundscheck" if numba.config.BOUNDSCHECK else ""))
        try:
            os.makedirs(folder, exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            return folder
    return tempfile.mkdtemp(prefix="featherstone_gait_")


CACHE_FOLDER = _cache_folder() if JIT else ""

_OPTIONS = {"error_model": "numpy"}
_INNER = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, **_OPTIONS}  # never called from Python
INLINE = {"forceinline": True, **_INNER}
kernel = numba.njit(**_INNER)
# What works on tuples must be inlined: passed through memory, 24 links cost 1.7 times as much in lanes.
inline = numba.njit(**INLINE)


def entry(function):
    """Compile `function` for calls from Python: cached on disk, without the GIL."""
    if not JIT:
        return _quiet(function)
    outside = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = CACHE_FOLDER
    try:
        dispatcher = numba.njit(function, cache=True, nogil=True, **_OPTIONS)
    finally:
        numba.config.CACHE_DIR = outside
    save = dispatcher._cache.save_overload

    def save_alone(arguments, compiled):
        if all(_in_key(kind) for kind in arguments):
            with one_process_at_a_time(CACHE_FOLDER):
                save(arguments, compiled)

    dispatcher._cache.save_overload = save_alone
    return dispatcher


def _in_key(kind) -> bool:
    """Whether a type is made of classes of `core`, whose sources are the key of the cache.

    Code for a class from elsewhere would be found again when its source has changed, and an index that names the class
    cannot be read where its module is missing.
    """
    made_by = getattr(kind, "instance_class", None)
    ours = made_by is None or made_by.__module__.startswith(__name__.rpartition(".compile")[0] + ".")
    return ours and all(_in_key(part) for part in getattr(kind, "types", ()))


@contextmanager
def one_process_at_a_time(folder):
    """Hold the lock of a cache folder; it goes with the process, however that ends."""
    with open(os.path.join(folder, "saving.lock"), "ab") as file:
        _lock(file)
        yield


def _lock(file) -> None:
    try:
        import fcntl
    except ImportError:  # Windows
        import msvcrt

        msvcrt.locking(file.fileno(), msvcrt.LK_LOCK, 1)
    else:
        fcntl.flock(file, fcntl.LOCK_EX)


def _quiet(function):
    """With the JIT off: IEEE infinities and NaN without NumPy's warnings, as compiled code has them."""

    @functools.wraps(function)
    def call(*args):
        with np.errstate(all="ignore"):
            return function(*args)

    return call


def instruction_set() -> str:
    """The widest vector instructions of this processor: AVX-512, AVX2 or neither."""
    features = get_host_cpu_features()
    if features.get("avx512f"):
        return "AVX-512"
    return "AVX2" if features.get("avx2") else "neither AVX2 nor AVX-512"
