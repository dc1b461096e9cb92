"""Kernels compiled beforehand: files of object code with a manifest, which a first result loads instead of compiling.

A store is a folder with one folder for each level of x86-64 processors (LEVELS).  A level has a file of object code for
each kernel, named by its key, and a manifest in JSON: what the code is for (Python, Numba, platform, settings that
change code) and the SHA-256 of each file.  The key is the hash of the entry, the types of its arguments, and the
sources of `core` and of all packages that the types come from, so that code of other sources is not found.  Nothing in
a store is unpickled: a kernel is an ELF file, whose two functions and one variable are named by the key.

A wheel may come with a store (`kernels/` of the package), and `warm-up` fills one in the user's cache
(store_writer.py).  What is for something else is not looked at; what is damaged is reported and counts as absent.  In
both cases the kernel is compiled, to the same bits.
"""

from __future__ import annotations

import hashlib
import json
import logging
import sys
from ctypes import c_void_p
from functools import cache, cached_property
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from typing import NamedTuple

import llvmlite
import llvmlite.binding as llvm
import numba
from numba import _dynfunc
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import cpu_target
from numba.core.runtime import rtsys

LEVELS = {  # names by which LLVM knows them, the widest first, and what tells that a processor is one
    "x86-64-v4": "avx512f avx512bw avx512cd avx512dq avx512vl",
    "x86-64-v3": "avx avx2 bmi bmi2 f16c fma lzcnt movbe sse4.2 popcnt cx16",
}
CALL, RUN, ENVIRONMENT = "call_", "run_", "environment_"  # before the key: called by Python, by kernels; a variable
RECORD = "FEATHERSTONE_GAIT_RECORD"  # LEVEL,LEVEL=FOLDER in the environment: keep what is compiled in a store
SETTINGS = (  # of Numba that change code
    "OPT", "LOOP_VECTORIZE", "SLP_VECTORIZE", "BOUNDSCHECK", "DEBUGINFO_DEFAULT", "ENABLE_AVX", "CPU_NAME",
    "CPU_FEATURES",
)  # fmt: skip
_log = logging.getLogger(__name__)


class Stored(NamedTuple):
    """A kernel that was loaded: in the place of Numba's result of compiling, for calls from Python alone."""

    entry_point: object
    address: int  # for kernels that call it by its address
    objectmode = False


def levels() -> list[str]:
    """Return the levels whose code this processor runs, the widest first."""
    has = llvm.get_host_cpu_features()
    return [name for name, needs in LEVELS.items() if all(has.get(each) for each in needs.split())]


def purpose() -> dict:
    """Return what code that is made in this process is for, but for its level."""
    return {
        "python": EXTENSION_SUFFIXES[0],  # with its version, processor and system
        "numba": numba.__version__,
        "llvmlite": llvmlite.__version__,
        "settings": {name: str(getattr(numba.config, name)) for name in SETTINGS},
    }


def digest(content: dict) -> str:
    """Return the SHA-256 of what a manifest holds."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def key(identity: str) -> str:
    """Return the name of a kernel in a store."""
    return hashlib.sha256(identity.encode()).hexdigest()[:32]


class Level:
    """The code in a store for one level of processors."""

    def __init__(self, folder: Path):
        self.folder, self.kernels, self.needs = folder, {}, ()
        try:
            manifest = json.loads((folder / "manifest.json").read_bytes())
            content = manifest["content"]
            if digest(content) != manifest["sha256"]:
                raise ValueError("its digest is another")
            if content["for"] == purpose():
                self.kernels, self.needs = content["kernels"], content["needs"]
        except FileNotFoundError:
            pass
        except Exception as error:  # what is damaged can be anything
            _log.warning("%s: damaged (%s); kernels are compiled", folder / "manifest.json", error)

    def read(self, name: str) -> bytes | None:
        """Return the object code of a kernel by its key, None if there is no sound one."""
        if name not in self.kernels:
            return None
        path = self.folder / f"{name}.o"
        try:
            code = path.read_bytes()
            if hashlib.sha256(code).hexdigest() == self.kernels[name]["sha256"]:
                return code
            why = "its digest is another"
        except OSError as error:
            why = error.strerror
        _log.warning("%s: damaged (%s); the kernel %s is compiled", path, why, self.kernels[name]["entry"])
        return None


class Stores:
    """The stores of some folders, which are looked through in their order."""

    def __init__(self, folders):
        self.folders = folders

    @cached_property
    def levels(self) -> list[Level]:
        """The widest level of each folder for this processor, where the process has all symbols that the code needs."""
        there = [[folder / name for name in levels() if (folder / name).is_dir()][:1] for folder in self.folders]
        made = [Level(path) for paths in there for path in paths]
        return [each for each in made if all(map(llvm.address_of_symbol, each.needs))]

    def _read(self, name: str) -> bytes | None:
        return next(filter(None, (level.read(name) for level in self.levels)), None)

    def address(self, identity: str) -> int:
        """Return the address of a stored function that compiled code calls, 0 if there is none."""
        name = key(identity)
        code = self._read(name)
        if code is None:
            return 0
        with global_compiler_lock:
            rtsys.initialize(cpu_target.target_context)  # of the arrays that it makes
            return _loaded(code).get_function_address(RUN + name)

    def take(self, dispatcher, kinds, identity: str) -> bool:
        """Let an entry call stored code for arguments of these types; return whether there is some."""
        name = key(identity)
        code = self._read(name)
        if code is None:
            return False
        with global_compiler_lock:
            if kinds not in dispatcher.overloads:
                made = _load(dispatcher.py_func, name, code)
                dispatcher._insert([kind._code for kind in kinds], made.entry_point, False)
                dispatcher.overloads[kinds] = made
        return True


def _load(function, name, code) -> Stored:
    """Put the object code of an entry into memory, and make a function of Python of it."""
    engine = _loaded(code)
    module = sys.modules[function.__module__]
    environment = _dynfunc.Environment(module.__dict__)  # from which Numba's wrappers would take Python's objects
    c_void_p.from_address(engine.get_global_value_address(ENVIRONMENT + name)).value = id(environment)
    call = engine.get_function_address(CALL + name)
    text = function.__doc__ or ""  # None is refused
    made = _dynfunc.make_function(module, function.__name__, text, call, environment, (engine,))
    return Stored(made, engine.get_function_address(RUN + name))


def _loaded(code):
    """Put object code into memory; return the engine that has it."""
    engine = _engine()
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    return engine


@cache
def _engine():
    """Return an engine of LLVM that only loads."""
    target = llvm.Target.from_triple(llvm.get_process_triple())
    machine = target.create_target_machine(reloc="static", codemodel="jitdefault", jit=True)
    return llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
