"""Count the instructions that compiled code executes, exactly, on Linux with an x86-64 processor.

The kernel writes its records into a locked page of memory.  Its first write raises a signal, whose handler unlocks the
page and sets the processor's trap flag.  From then on each instruction calls the handler, which counts, until a later
record has been written.  This needs no performance counters, which virtual machines hide.
"""

from __future__ import annotations

import ctypes
import functools
import math
import mmap
import platform
import signal
import sys
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from llvmlite.binding import object_file
from numba.core import types
from numba.extending import intrinsic

from ..core.compile.jit import JIT

TRAP, FLAGS = 0x100, 22  # the processor's flag, and where a signal's context has its flags, in words of 8 bytes
SIGNALS = {signal.SIGSEGV: 0x80000004, signal.SIGTRAP: 4}  # SA_SIGINFO; the first only once (SA_RESETHAND)
COUNT, PAGE, SIZE, LAST, EMPTY = range(5)  # what the handler knows
known = np.zeros(5, np.int64)


def records(*shape: int) -> np.ndarray:
    """NaN, in pages of their own."""
    array = np.frombuffer(mmap.mmap(-1, 8 * math.prod(shape))).reshape(shape)
    array[:] = np.nan
    return array


def instructions(call: Callable[[], object], out: np.ndarray, last: int) -> float:
    """Instructions from the first write into `out`, made by `records`, until out[last] is written; or NaN."""
    if not (JIT and sys.platform == "linux" and platform.machine() == "x86_64"):
        return math.nan
    libc, handler, before = ctypes.CDLL(None), _handler(), np.zeros((len(SIGNALS), 19), np.int64)
    known[:] = -2, out.ctypes.data, out.nbytes, out[last:].ctypes.data, out[:1].view(np.int64).flat[0]
    for (number, flags), old in zip(SIGNALS.items(), before):
        action = np.zeros(19, np.int64)  # struct sigaction
        action[0], action[17] = handler.address, flags
        libc.sigaction(int(number), ctypes.c_void_p(action.ctypes.data), ctypes.c_void_p(old.ctypes.data))
    try:
        libc.mprotect(ctypes.c_void_p(out.ctypes.data), ctypes.c_size_t(out.nbytes), 0)
        call()
    finally:
        libc.mprotect(ctypes.c_void_p(out.ctypes.data), ctypes.c_size_t(out.nbytes), 3)
        for number, old in zip(SIGNALS, before):
            libc.sigaction(int(number), ctypes.c_void_p(old.ctypes.data), None)
    return float(known[COUNT]) if out[last:].view(np.int64).flat[0] != known[EMPTY] else math.nan


@functools.cache
def _handler() -> Any:
    """The signals' handler, compiled."""
    mprotect = ctypes.CDLL(None).mprotect
    mprotect.argtypes, mprotect.restype = [ctypes.c_long, ctypes.c_long, ctypes.c_int], ctypes.c_int
    first, at = int(signal.SIGSEGV), known.ctypes.data

    @intrinsic
    def pointer(context: Any, address: Any) -> Any:
        def make(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            return builder.inttoptr(values[0], ir.IntType(8).as_pointer())

        return types.voidptr(address), make

    @numba.cfunc(types.void(types.int32, types.voidptr, types.CPointer(types.int64)))
    def handler(number: Any, info: Any, context: Any) -> None:
        s = numba.carray(pointer(at), (5,), np.int64)  # type: ignore[call-arg]  # Numba gives the first
        if number == first:
            mprotect(s[PAGE], s[SIZE], 3)
            context[FLAGS] |= TRAP
        s[COUNT] += 1
        if number != first and numba.carray(pointer(s[LAST]), (1,), np.int64)[0] != s[EMPTY]:
            context[FLAGS] &= ~TRAP

    return handler


def code_size(kernel: Any, arguments: tuple) -> float:
    """Bytes of a kernel's compiled code, with all that it calls, as the cache holds it; NaN without a cache."""
    cache = getattr(kernel, "_cache", None)
    if cache is None:
        return math.nan
    kinds = tuple(map(kernel.typeof_pyval, arguments))
    found = cache._cache_file.load(cache._index_key(kinds, kernel.targetctx.codegen()))
    if found is None:
        return math.nan
    sections = object_file.ObjectFileRef.from_data(found[0][2][0]).sections()
    return float(sum(section.size() for section in sections if section.is_text()))
