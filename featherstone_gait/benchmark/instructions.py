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
import sys
from collections.abc import Callable

import numpy as np

from ..core.compile.jit import JIT

SIGNALS = {11: 0x80000004, 5: 4}  # of Linux: SIGSEGV, SIGTRAP: SA_SIGINFO; the first only once (SA_RESETHAND)
known = np.zeros(5, np.int64)  # to the handler: count, page, its size, address of the last record, an empty record


def records(*shape: int) -> np.ndarray:
    """Return an array of NaN in memory pages of its own."""
    array = np.frombuffer(mmap.mmap(-1, 8 * math.prod(shape))).reshape(shape)
    array[:] = np.nan
    return array


def instructions(call: Callable[[], object], out: np.ndarray, last: int) -> float:
    """Count instructions from the first write into `out`, made by `records`, until out[last] is written; or NaN."""
    if not (JIT and sys.platform == "linux" and platform.machine() == "x86_64"):
        return math.nan
    libc, handler, before = ctypes.CDLL(None), _handler(), np.zeros((len(SIGNALS), 19), np.int64)
    known[:] = -1, out.ctypes.data, out.nbytes, out[last:].ctypes.data, out[:1].view(np.int64).flat[0]
    for (number, flags), old in zip(SIGNALS.items(), before):
        action = np.zeros(19, np.int64)  # struct sigaction
        action[0], action[17] = handler.ctypes.data, flags
        libc.sigaction(int(number), ctypes.c_void_p(action.ctypes.data), ctypes.c_void_p(old.ctypes.data))
    try:
        if libc.mprotect(ctypes.c_void_p(out.ctypes.data), ctypes.c_size_t(out.nbytes), 0):
            return math.nan
        call()
    finally:
        libc.mprotect(ctypes.c_void_p(out.ctypes.data), ctypes.c_size_t(out.nbytes), 3)
        for number, old in zip(SIGNALS, before):
            libc.sigaction(int(number), ctypes.c_void_p(old.ctypes.data), None)
    counted = known[0] >= 0 and out[last:].view(np.int64).flat[0] != known[4]
    return float(known[0]) if counted else math.nan


@functools.cache
def _handler() -> np.ndarray:
    """Return the signal handler in machine code, which gets the signal in edi and its context in rdx."""
    code = (
        f"49 b8 {known.ctypes.data.to_bytes(8, 'little').hex()}"  # mov r8, known
        "83 ff 0b  75 20"  #                    cmp edi, SIGSEGV; jne trap
        "48 81 8a b0000000 00010000"  #         or qword [rdx + 0xb0], 0x100: the trap flag of the interrupted code
        "49 8b 78 08  49 8b 70 10"  #           mov rdi, [r8 + 8]; mov rsi, [r8 + 16]: the page and its size
        "ba 03000000  b8 0a000000  0f 05  c3"  # mov edx, 3; mov eax, 10; syscall: mprotect; ret
        "49 ff 00"  #                     trap: inc qword [r8]
        "49 8b 40 18  48 8b 00"  #              mov rax, [r8 + 24]; mov rax, [rax]: the last record
        "49 3b 40 20  74 0b"  #                 cmp rax, [r8 + 32]; je end: it is empty
        "48 81 a2 b0000000 fffeffff"  #         and qword [rdx + 0xb0], ~0x100
        "c3"  #                            end: ret
    )
    page = mmap.mmap(-1, mmap.PAGESIZE, prot=mmap.PROT_READ | mmap.PROT_WRITE | mmap.PROT_EXEC)
    page.write(bytes.fromhex(code))
    return np.frombuffer(page, np.uint8)
