"""What the fuzz tests share: how many examples, a limit on time, and what counts as a proper refusal.

Each property runs in the quick suite with few examples and as `long` with more, the same ones every time, so that a
red run is one of the change at hand.  FEATHERSTONE_GAIT_FUZZ=5000 makes the long ones so many random examples.
"""

import contextlib
import linecache
import os
import signal
import threading
import time
import traceback
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

import featherstone_gait

PACKAGE = str(Path(featherstone_gait.__file__).parent)
REFUSALS = (ValueError, TypeError, OSError, ImportError, RuntimeError)
COMMON = settings(deadline=None, database=None, suppress_health_check=list(HealthCheck), print_blob=True)
RANDOM = int(os.environ.get("FEATHERSTONE_GAIT_FUZZ", "0"))


def profiles(quick):
    """Give a test the argument `profile`: settings with so many examples, and with 16 times as many for `long`."""
    few = pytest.param(settings(COMMON, max_examples=quick, derandomize=True), id="quick")
    more = settings(COMMON, max_examples=RANDOM or 16 * quick, derandomize=not RANDOM)
    return pytest.mark.parametrize("profile", [few, pytest.param(more, id="many", marks=pytest.mark.long)])


class _TooLong(BaseException):
    """Not an Exception, so that nothing catches it on the way."""


@contextlib.contextmanager
def time_limit(seconds):
    """Fail if the block takes more processor time; Python code is interrupted, compiled code is noticed afterwards."""
    interrupts = threading.current_thread() is threading.main_thread() and hasattr(signal, "setitimer")

    def stop(*_):
        raise _TooLong

    start = time.process_time()
    try:
        if interrupts:
            before = signal.signal(signal.SIGPROF, stop)
            signal.setitimer(signal.ITIMER_PROF, seconds)
        yield
    except _TooLong:
        raise AssertionError(f"takes more than {seconds:g} s") from None
    finally:
        if interrupts:
            signal.setitimer(signal.ITIMER_PROF, 0.0)
            signal.signal(signal.SIGPROF, before)
    assert time.process_time() - start < seconds, f"takes more than {seconds:g} s"


def check_refusal(error, words):
    """Fail unless the package itself raised the error, on purpose, and its message has one of the words."""
    if isinstance(error, OSError) and error.filename is not None:
        return
    last = traceback.extract_tb(error.__traceback__)[-1]
    line = linecache.getline(last.filename, last.lineno or 0).strip()
    assert last.filename.startswith(PACKAGE), f"{error!r} comes from {last.filename}:{last.lineno}"
    assert line.startswith("raise"), f"{error!r} is not raised on purpose: {last.filename}:{last.lineno}: {line}"
    assert any(word.lower() in str(error).lower() for word in words), f"{error!r} names none of {words}"
