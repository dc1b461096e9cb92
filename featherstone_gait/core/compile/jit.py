"""Compilation of the kernels: the four decorators, the pipeline and the cache.

`kernel` marks a function that is only called by other kernels, `inline` a small one that is merged into its caller,
`apart` a large one that never is, `entry` one that Python calls: it is cached on disk (with everything it calls) and
releases the GIL.

compiler.py has the passes.  With `FEATHERSTONE_GAIT_COMPILER=plain`, and where a new Numba lacks what compiler.py
changes, Numba's own pipeline takes their place.

Numba's own cache does not see an edit in a *called* file, so the cache lies in a folder named by the hash of all
sources of `core`: other sources, other folder; a stale kernel cannot be loaded.  A package outside of `core` that has
kernels adds its sources by `add_sources`: what is compiled for its functions and types lies in files of its own, whose
stamp is the hash of these sources.  What is compiled for types from anywhere else is not kept.  Code with bounds checks
and code of the plain pipeline have folders of their own.

Numba reads, changes and writes an index without a lock: of two processes that save different versions of one kernel at
the same moment, one may lose its entry or leave its code under the other's name.  Hence one process at a time saves.
Of several that want one kernel, one compiles it; the others wait and read it.  What is damaged on the disk counts as
absent (sealed.py), and where nothing can be written each process compiles for itself: the cache stops no run.

What was compiled beforehand comes first, from a store of the wheel or of `warm-up` (store.py).

Floating point is strict IEEE 754 (no fastmath), which is what makes results equal to the bit in any width, on any
number of threads and with the JIT off.
"""

from __future__ import annotations

import functools
import hashlib
import logging
import os
import re
import shutil
import tempfile
import time
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import numba
import numpy as np
from llvmlite.binding import get_host_cpu_features
from numba.extending import register_jitable

from .lock import lock
from .progress import compiling, current, estimate
from .sealed import SealedFiles
from .store import RECORD, Stored, Stores

JIT = not numba.config.DISABLE_JIT
CompilationError = numba.core.errors.NumbaError
carray = numba.carray  # an array of a pointer, in what `outside` compiles
KEPT, RECENT = 3, 86400.0  # folders of other sources: the last so many stay, and all used within so many seconds
PATIENCE, OFTEN = 300.0, 0.05  # [s] for another process that compiles, and between two looks
OUTSIDE = 1.5  # [s] that a user's function takes about
_log = logging.getLogger(__name__)


def _private_pipeline():
    """Return the module compiler.py, None for Numba's own pipeline."""
    choice = os.environ.get("FEATHERSTONE_GAIT_COMPILER", "")
    if choice not in ("", "plain"):
        remedy = "set it to 'plain' for Numba's own pipeline, or not at all"
        raise ValueError(f"FEATHERSTONE_GAIT_COMPILER is {choice!r}: {remedy}")
    if choice == "plain":
        return None
    try:
        from . import compiler

        return compiler
    except (ImportError, AttributeError) as error:
        _log.warning(
            "Numba %s lacks what compiles kernels fast (%s): Numba's own pipeline takes twice as long, to the same "
            "results", numba.__version__, error,
        )  # fmt: skip
        return None


_PRIVATE = _private_pipeline() if JIT else None
CORE = __name__.rpartition(".compile")[0]
_SOURCES = {CORE: Path(__file__).parents[1]}


def add_sources(module: str, file: str) -> None:
    """Cache what is compiled for functions and types of a module outside of `core`, or of a package and all below it.

    Call it in the module, or the package's `__init__.py`, as `add_sources(__name__, __file__)`.
    """
    path = Path(file)
    _SOURCES[module] = path.parent if path.name == "__init__.py" else path


def source_hash(module: str = CORE) -> str:
    """Hash the sources of `core`, or of another module of `add_sources`."""
    digest = hashlib.sha256()
    root = _SOURCES[module]
    for path in sorted(root.rglob("*.py")) if root.is_dir() else [root]:
        digest.update(path.relative_to(root.parent).as_posix().encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def user_cache() -> str:
    """Return this package's folder in the user's cache; a relative XDG_CACHE_HOME is ignored, as its spec says."""
    root = os.environ.get("XDG_CACHE_HOME", "")
    root = root if os.path.isabs(root) else os.path.join(os.path.expanduser("~"), ".cache")
    return os.path.join(root, "featherstone_gait")


def _cache_folder() -> str:
    """Return the cache folder of these kernels, in NUMBA_CACHE_DIR or the user's cache; "" if none can be written."""
    roots = [root for root in (numba.config.CACHE_DIR, user_cache()) if root]
    key = hashlib.sha256(f"{source_hash()} {numba.__version__}".encode()).hexdigest()[:16]
    kind = ("_boundscheck" if numba.config.BOUNDSCHECK else "") + ("" if _PRIVATE else "_plain")
    for root in roots:
        folder = os.path.join(root, key + kind)
        try:
            new = not os.path.isdir(folder)
            os.makedirs(folder, exist_ok=True)
            tempfile.TemporaryFile(dir=folder).close()  # OSError if no file can be made
            os.utime(folder)
            if new:
                clear_old(folder)
            return folder
        except OSError as error:
            why = error.strerror
    _tell_once(roots[-1], why)
    return ""


def clear_old(folder: str) -> None:
    """Remove the folders beside this one that are of other sources, but the last KEPT and those in use of late."""
    ours = re.compile(r"[0-9a-f]{16}" + re.escape(os.path.basename(folder)[16:]))
    beside = [path for path in Path(folder).parent.iterdir() if ours.fullmatch(path.name) and path.is_dir()]
    used = {path: path.stat().st_mtime for path in beside if (path / "saving.lock").is_file()}
    for path in sorted(used, key=lambda path: used[path], reverse=True)[KEPT:]:
        if used[path] < time.time() - RECENT:
            shutil.rmtree(path, ignore_errors=True)


@functools.cache
def _tell_once(folder: str, why: str | None) -> None:
    remedy = "the next process compiles them anew: make room, or let NUMBA_CACHE_DIR name a folder that can be written"
    _log.warning("%s: compiled kernels cannot be kept (%s); %s", folder, why, remedy)


CACHE_FOLDER = _cache_folder() if JIT else ""
STORES = Stores([Path(__file__).parents[2] / "kernels", *([Path(CACHE_FOLDER) / "kernels"] if CACHE_FOLDER else [])])
recorder = None  # store_writer.py, where `RECORD` of the environment asks for it

_OPTIONS = {"error_model": "numpy", **({"pipeline_class": _PRIVATE.Compiler} if _PRIVATE else {})}
INNER = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, **_OPTIONS}  # never called from Python
INLINE = {"forceinline": True, **INNER}
ENTRY = {"nogil": True, "no_cfunc_wrapper": True, **_OPTIONS}


def kernel(function):
    """Compile `function` where an entry needs it.

    First compiled under an `inline` function it is merged into its caller too, each time that it is called, since Numba
    hands that option down.  A large one that is called in several places is better `apart`.
    """
    return _inner(function, INNER)


def inline(function):
    """Compile `function` as `kernel` does, merged into its caller.

    What works on tuples must be: passed through memory, 24 links cost 1.7 times as much in lanes.
    """
    return _inner(function, INLINE)


def apart(function):
    """Compile `function` as `kernel` does, but keep it out of its caller.

    Numba merges whatever a merged function calls, so that a step becomes one function, for which LLVM takes longer than
    for its parts: more than in proportion, beyond some 30 000 instructions (`largest_function` of a test counts them).
    """
    function.apart = True
    return _inner(function, INNER)


def callable_from_compiled(function):
    """Let compiled functions from elsewhere (`outside`) call `function`, which stays Python where Python calls it."""
    return register_jitable(function) if JIT else function


def _inner(function, options):
    if not JIT:
        return function
    dispatcher = numba.njit(function, **options)
    return _PRIVATE.of_any_integer(dispatcher) if _PRIVATE else dispatcher


def entry(function):
    """Compile `function` for calls from Python: cached on disk, without the GIL."""
    if not JIT:
        return np.errstate(all="ignore")(function)  # compiled code warns of no infinity or NaN
    kept = _with_cache(function) if CACHE_FOLDER else None
    dispatcher = kept or numba.njit(function, **ENTRY)
    dispatcher.compile = functools.partial(_compile, dispatcher, dispatcher.compile, kept is not None)
    dispatcher.get_call_template = functools.partial(_called_by_compiled, dispatcher, dispatcher.get_call_template)
    return dispatcher


def entry_of_process(function):
    """Compile `function` as `entry` does, but keep nothing: for arguments of which a type is this process's own."""
    if not JIT:
        return entry(function)
    dispatcher = numba.njit(function, **ENTRY)
    dispatcher.compile = functools.partial(_compile, dispatcher, dispatcher.compile, False)
    return dispatcher


def direct(dispatcher, *arguments):
    """Return an entry compiled for arguments of these types, which skips the look at types that each call would cost.

    What it is called with must have the same types.
    """
    if not JIT:
        return dispatcher
    return dispatcher.compile(tuple(map(dispatcher.typeof_pyval, arguments)))


def address_of(dispatcher, *arguments):
    """Return the address of an entry compiled for arguments of these types, for `call_entry`; itself with the JIT off.

    It holds in this process.
    """
    if not JIT:
        return dispatcher
    kinds = tuple(map(dispatcher.typeof_pyval, arguments))
    dispatcher.compile(kinds)
    made = dispatcher.overloads[kinds]
    if isinstance(made, Stored):
        return made.address
    return made.library.get_pointer_to_function(made.fndesc.llvm_func_name)


def outside(function, wrapped):
    """Compile a user's function on its own, with bounds and divisors checked, in the wrapper that `call_outside` takes.

    `wrapped(function)` makes the wrapper, of a float and pointers to float64, the second to int64.  Returns what must
    live as long as the address is used, and the address; with the JIT off the wrapper twice.  The function is cached
    beside its source, where Numba can.  Raises NumbaError where it does not compile.
    """
    if not JIT:
        return wrapped(function), wrapped(function)
    identity = _identity_outside(function)
    if identity and (recorder is None or recorder.has(identity)) and (address := STORES.address(identity)):
        return function, address
    options = {"boundscheck": True, "error_model": "python"}
    kept = True
    try:
        inner = numba.njit(function, cache=True, **options)
    except RuntimeError:  # no file of its own
        inner, kept = numba.njit(function, **options), False
    numbers, places = numba.types.CPointer(numba.types.float64), numba.types.CPointer(numba.types.int64)
    kind = numba.types.void(numba.types.float64, numbers, places, numbers, numbers, numbers, numbers)
    with compiling(function.__name__, kept, OUTSIDE):
        made = numba.cfunc(kind)(wrapped(inner))
    if recorder is not None and identity:
        recorder.add_outside(made, identity)
    return (made, inner), made.address


def checked(function):
    """Compile a user's function, or one that calls it, with bounds checked and without the GIL; it is not cached."""
    return numba.njit(function, boundscheck=True, nogil=True) if JIT else function


def _with_cache(function):
    """Return the dispatcher with a cache that stops no run; None if Numba can make no file in the folder."""
    outside, numba.config.CACHE_DIR = numba.config.CACHE_DIR, CACHE_FOLDER
    try:
        dispatcher = numba.njit(function, cache=True, **ENTRY)
    except RuntimeError:  # no place for a cache
        return None
    finally:
        numba.config.CACHE_DIR = outside
    cache = dispatcher._cache
    if not Path(cache.cache_path).is_relative_to(CACHE_FOLDER):
        return None  # Numba's next choice, where edited files it calls would go unseen
    cache._cache_file = _Files(cache, function.__module__)
    cache.load_overload = functools.partial(_load, cache._load_overload if _PRIVATE else cache.load_overload)
    cache.save_overload = functools.partial(_save, cache.save_overload)
    return dispatcher


def _compile(dispatcher, compile_, kept, arguments):
    """Load code for these types from a store, compile it, or read what another process is compiling for them now."""
    kinds = tuple(arguments)
    if kinds in dispatcher.overloads:
        return dispatcher.overloads[kinds].entry_point
    identity = _identity(dispatcher, kinds)
    if identity and not (current or _for_code) and (recorder is None or recorder.has(identity)):
        if STORES.take(dispatcher, kinds, identity):
            return dispatcher.overloads[kinds].entry_point
    with ExitStack() as stack:
        # Within another's compiling a lock could close a circle.
        if kept and not current:
            kind = hashlib.sha256(repr((dispatcher.py_func.__module__, dispatcher.__name__, arguments)).encode())
            stack.enter_context(_alone(os.path.join(CACHE_FOLDER, "compiling", kind.hexdigest()[:32])))
        stack.enter_context(compiling(dispatcher.__name__, kept, estimate(arguments)))
        if _PRIVATE:
            stack.enter_context(_PRIVATE.operators_kept(dispatcher))
        made = compile_(arguments)
    if recorder is not None and identity:
        recorder.add(dispatcher, kinds, identity)
    return made


def _identity(dispatcher, kinds) -> str:
    """Return what code for these types is stored under: entry, types and sources; "" for types from elsewhere."""
    rooms = _rooms(kinds) | {_room(dispatcher.py_func.__module__), CORE}
    if _PRIVATE is None or None in rooms:
        return ""
    sources = [f"{room} {_known_hash(room)}" for room in sorted(rooms)]
    return "\n".join([dispatcher.py_func.__module__, dispatcher.py_func.__qualname__, *map(str, kinds), *sources])


_known_hash = functools.cache(source_hash)


def _identity_outside(function) -> str:
    """Return what code of a function of this package is stored under: its name and all sources; "" for any other."""
    root, code = Path(__file__).parents[2], getattr(function, "__code__", None)
    if _PRIVATE is None or code is None or "<locals>" in function.__qualname__:
        return ""
    file = Path(code.co_filename)
    if not file.is_relative_to(root):
        return ""
    sources = (path.read_bytes() for path in sorted(root.rglob("*.py")))
    hashes = [hashlib.sha256(source).hexdigest() for source in sources]
    return "\n".join([f"{file.relative_to(root).as_posix()}: {function.__qualname__}", *hashes])


def _called_by_compiled(dispatcher, template, args, kws):
    """Return how compiled code calls an entry, which is compiled for that: code of a store is for Python alone."""
    for kinds, made in [*dispatcher.overloads.items()]:
        if isinstance(made, Stored):
            _dropped.append(dispatcher.overloads.pop(kinds))  # which the dispatcher calls on, and does not own
    _for_code.append(dispatcher)
    try:
        return template(args, kws)
    finally:
        _for_code.pop()


_for_code: list = []  # entries that compiled code is about to call
_dropped: list = []


@contextmanager
def _alone(path):
    """Hold the lock of a file, if it can be had within PATIENCE, for a process that hangs must hold up no other."""
    end = time.monotonic() + PATIENCE
    with ExitStack() as stack:
        with suppress(OSError):
            os.makedirs(os.path.dirname(path), exist_ok=True)
            file = stack.enter_context(open(path, "ab"))
            while not lock(file) and time.monotonic() < end:
                time.sleep(OFTEN)
        yield


def _load(load, arguments, context):
    """Return what the cache holds, None if that cannot be used for any reason.

    Numba's own would first import what it knows of NumPy and SciPy, half a second, which finished code does not need
    unless it counts references.
    """
    try:
        return load(arguments, context)
    except Exception as error:
        _log.warning("%s: a kernel cannot be read (%s); it is compiled anew", CACHE_FOLDER, error)
        return None


def _save(save, arguments, compiled) -> None:
    if None in _rooms(arguments):
        return
    try:
        with one_process_at_a_time(CACHE_FOLDER):
            save(arguments, compiled)
    except OSError as error:
        _tell_once(CACHE_FOLDER, error.strerror)


class _Files:
    """The cache files of an entry: those of `core`, and others where modules of `add_sources` take part."""

    def __init__(self, cache, module):
        self.cache, self.module = cache, module

    def load(self, key):
        """Return what is kept under one of Numba's keys, whose first part is the types of the arguments."""
        return self._of(key[0]).load(key)

    def save(self, key, data):
        """Keep it."""
        self._of(key[0]).save(key, data)

    def _of(self, arguments):
        rooms = sorted((_rooms(arguments) | {_room(self.module)}) - {CORE, None})
        stamps = self.cache._impl.locator.get_source_stamp(), *map(source_hash, rooms)
        return SealedFiles(self.cache.cache_path, "-".join([self.cache._impl.filename_base, *rooms]), stamps)


def _room(module):
    return next((room for room in _SOURCES if f"{module}.".startswith(f"{room}.")), None)


def _rooms(kinds) -> set:
    """Return which of `_SOURCES` the classes in the types come from, with None for any other module.

    Code for a class from elsewhere would be found again when its source has changed, and an index that names the class
    cannot be read where its module is missing.
    """
    rooms = set()
    for kind in kinds:
        if (made_by := getattr(kind, "instance_class", None)) is not None:
            rooms.add(_room(made_by.__module__))
        rooms |= _rooms(getattr(kind, "types", ()))
    return rooms


@contextmanager
def one_process_at_a_time(folder):
    """Hold the lock of a cache folder; it goes with the process, however that ends."""
    os.makedirs(folder, exist_ok=True)
    with open(os.path.join(folder, "saving.lock"), "ab") as file:
        lock(file, wait=True)
        yield


def instruction_set() -> str:
    """Return the widest vector instructions of this processor: AVX-512, AVX2 or neither."""
    features = get_host_cpu_features()
    if features.get("avx512f"):
        return "AVX-512"
    return "AVX2" if features.get("avx2") else "neither AVX2 nor AVX-512"


if JIT and _PRIVATE and RECORD in os.environ:
    from .store_writer import Recorder

    STORES, recorder = Recorder.of(os.environ[RECORD])
