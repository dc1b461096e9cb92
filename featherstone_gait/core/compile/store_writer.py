"""Write a store (store.py): what the entries that a program calls are compiled to, for one or more levels.

`record` runs a program that does so, with all processes that it starts.  The front end of the compiler, which takes
most of the time, runs once; LLVM's passes and code generator run once for each level.  What is kept is not run.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import llvmlite.binding as llvm
import numba
from numba.core.codegen import JITCPUCodegen

from . import compiler
from .lock import lock
from .store import CALL, ENVIRONMENT, RECORD, RUN, Level, Stores, digest, key, purpose

ADDRESS = "numba.dynamic.globals"  # begins the names of variables that hold an address of this process
COUNTED = "NRT_"  # begins the names of functions that count references, which `Stores.address` provides
KEPT = ADDRESS, ".const.pickledata"  # names that are looked for in the end
FAILED = "an index leaves a tuple in a kernel that was compiled beforehand"  # kernels raise nothing else
NO_PICKLES = f"""
@PyExc_IndexError = external global ptr
@said = internal constant [{len(FAILED) + 1} x i8] c"{FAILED}\\00"
declare void @PyErr_SetString(ptr, ptr)
define ptr @numba_unpickle(ptr %0, i32 %1, ptr %2) {{
  %kind = load ptr, ptr @PyExc_IndexError
  call void @PyErr_SetString(ptr %kind, ptr @said)
  ret ptr null
}}"""  # in the place of Numba's function, which unpickles exceptions
PICKLED = re.compile(r'^(@\.const\.pickledata.* = internal .*constant \[\d+ x i8\] )c".*"', re.MULTILINE)
HAS_ADDRESS = re.compile(rf"{ADDRESS}|inttoptr \(i64 -?\d{{6,}} to")
_log = logging.getLogger(__name__)


def record(program: str | Path, folder: Path, levels) -> None:
    """Run a program of Python and keep its kernels in the store `folder`; raise RuntimeError if it fails.

    program: its text, which runs in a folder of its own, or its file, which runs in the current folder.
    """
    with tempfile.TemporaryDirectory() as room:
        path, where = program, None
        if isinstance(program, str):
            path, where = Path(room) / "program.py", room
            path.write_text(program, "utf-8")
        environment = os.environ | {
            RECORD: f"{','.join(levels)}={folder.absolute()}",
            "NUMBA_CACHE_DIR": room,  # where nothing is found that would not be compiled
            "PYTHONPATH": os.pathsep.join(sys.path),
        }
        run = subprocess.run([sys.executable, path], env=environment, cwd=where, capture_output=True, text=True)
    if run.returncode:
        raise RuntimeError(run.stderr.strip().rpartition("\n")[2])


class Refused(Exception):
    """Code that cannot be plain data."""


class Recorder:
    """Keep what entries are compiled for in a store, for some of `store.LEVELS`."""

    def __init__(self, folder: Path, levels):
        self.writers = [_Writer(folder / level, level) for level in levels]
        compiler.Whole.before_passes = staticmethod(llvm.ModuleRef.as_bitcode)

    @classmethod
    def of(cls, asked: str):
        """Return what a process reads and records by `store.RECORD`."""
        names, _, folder = asked.partition("=")
        return Stores([Path(folder)]), cls(Path(folder), names.split(","))

    def has(self, identity) -> bool:
        """Return whether a kernel is in the store, for all levels."""
        return all(key(identity) in Level(each.folder).kernels for each in self.writers)

    def add(self, dispatcher, kinds, identity):
        """Keep what an entry was compiled to for arguments of these types."""
        made, name = dispatcher.overloads[kinds], key(identity)
        names = {
            made.fndesc.llvm_cpython_wrapper_name: CALL + name,
            made.fndesc.llvm_func_name: RUN + name,
            made.target_context.get_env_name(made.fndesc): ENVIRONMENT + name,
        }
        if made.environment.consts:
            _log.warning("%s holds objects of Python: its code is not kept", dispatcher)
        else:
            self._add(name, f"{dispatcher.py_func.__module__}.{dispatcher.__name__}", made.library.linked, names)

    def add_outside(self, made, identity):
        """Keep what a function that compiled code calls was compiled to, by `numba.cfunc`."""
        name, code = key(identity), made._library._final_module.as_bitcode()
        self._add(name, identity.partition("\n")[0], code, {made.native_name: RUN + name})

    def _add(self, name, what, bitcode, names):
        try:
            for each in self.writers:
                each.add(name, what, bitcode, names)
        except Refused as refused:
            _log.warning("%s: its code is not kept", refused)


class _Writer:
    """Generate the machine code of one processor level, and write it to the store."""

    def __init__(self, folder, level):
        self.folder = folder
        usual = numba.config.CPU_NAME, numba.config.CPU_FEATURES
        numba.config.CPU_NAME, numba.config.CPU_FEATURES = level, ""
        try:
            self.codegen = JITCPUCodegen(f"featherstone_gait.{level}")
        finally:
            numba.config.CPU_NAME, numba.config.CPU_FEATURES = usual

    def add(self, name, what, bitcode, names):
        """Keep a kernel by its name in the store; names: what of it can be seen from outside, and under which name."""
        module = llvm.parse_bitcode(bitcode)
        module.link_in(llvm.parse_assembly(NO_PICKLES))
        passes, builder = self.codegen._module_pass_manager()
        passes.run(module, builder)
        needs = set()
        for k, value in enumerate([*module.functions, *module.global_variables]):
            if value.name in names:
                value.name = names[value.name]
            elif value.is_declaration:
                needs.add(value.name)
            elif value.name.startswith(KEPT):
                value.linkage = "internal"
            else:  # of no use to others, least of all by a name of several hundred letters
                value.name, value.linkage = f"own_{k}", "internal"
        unused = llvm.create_new_module_pass_manager()
        unused.add_global_dead_code_eliminate_pass()
        unused.run(module, builder)
        text = str(module)
        if HAS_ADDRESS.search(text):
            raise Refused(f"{what} holds an address of this process")
        module = llvm.parse_assembly(PICKLED.sub(r"\1zeroinitializer", text))
        counts = any(each.startswith(COUNTED) for each in needs)
        if counts and CALL + name in names.values():
            raise Refused(f"{what} counts references")
        needs = {each for each in needs if not each.startswith(("llvm.", COUNTED))}
        code = self.codegen._tm.emit_object(module)
        self._write(name, code, {"entry": what, "sha256": hashlib.sha256(code).hexdigest()}, needs)

    def _write(self, name, code, entry, needs):
        self.folder.mkdir(parents=True, exist_ok=True)
        with open(self.folder / "saving.lock", "ab") as file:
            lock(file, wait=True)
            _replace(self.folder / f"{name}.o", code)
            before = Level(self.folder)
            content = {
                "for": purpose(),
                "needs": sorted(needs.union(before.needs)),
                "kernels": before.kernels | {name: entry},
            }
            text = json.dumps({"sha256": digest(content), "content": content}, indent=1, sort_keys=True)
            _replace(self.folder / "manifest.json", text.encode())


def _replace(path, data):
    """Write a file completely or not at all."""
    partial = path.with_suffix(".partial")
    with open(partial, "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    os.replace(partial, path)
