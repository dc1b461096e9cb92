"""Announce on stderr that kernels are compiled, which takes seconds, and show the progress."""

import gc
import sys
import time
from contextlib import contextmanager

from numba.core.event import Listener, install_listener

PATIENCE = 0.5  # [s] before a terminal's line moves
OFTEN = 0.2  # [s] between two updates of the line
NOTEBOOK = "ipykernel"  # whose streams are no terminals and show a line that is written anew
ANNOUNCED = 1.0  # [s] from which on compiling is announced
# What an entry takes on an idle core of 2026, by the arrays and numbers that it reads beyond the first [s]: of 155
# entries that tests compiled, 77 % took between half and twice as long.
EACH, FIRST = 0.15, 12


class Progress(Listener):
    """Show the progress of compiling one entry: a line, which on a terminal counts the functions that are done."""

    def __init__(self, name, kept, seconds):
        self.seconds = seconds
        about = f"about {self.seconds:.0f} s" if self.seconds >= ANNOUNCED else ""
        how = ", ".join(filter(None, [about, "once, then kept" if kept else ""]))
        self.text = f"compiling {name}" + (f" ({how})" if how else "")
        self.begun, self.count, self.shown = time.monotonic(), 0, 0.0

    def on_start(self, event):
        """Count a function that Numba begins to compile; announce the entry before its first function."""
        stream, first = sys.stderr, self.count == 0
        self.count += 1
        if stream is None or getattr(stream, "plain", False) or current[-1] is not self:
            return
        now = time.monotonic()
        if not (stream.isatty() or NOTEBOOK in type(stream).__module__):
            if first and self.seconds >= ANNOUNCED:
                stream.write(f"{self.text}\n")
                stream.flush()
        elif now - self.begun > PATIENCE and now - self.shown > OFTEN:
            self.shown = now
            line = f"{self.text}: {self.count} functions, {now - self.begun:.0f} s"
            stream.write(f"\r{line[:79]:79}")
            stream.flush()

    def on_end(self, event):
        """Do nothing: functions are counted when they begin."""

    def end(self):
        """Leave the line as it is."""
        if self.shown:
            sys.stderr.write("\n")


def estimate(kinds):
    """Estimate the time of compiling an entry for arguments of these types [s], on an idle core."""
    return EACH * (sum(map(_parts, kinds)) - FIRST)


def _parts(kind):
    """Count the arrays and numbers of an argument that are there: each belongs to an effect that is compiled."""
    inner = getattr(kind, "types", None)
    return (str(kind) != "none") if inner is None else sum(map(_parts, inner))


current = []  # what is being compiled, innermost last


@contextmanager
def compiling(name, kept, seconds):
    """Announce what is compiled, and collect no garbage meanwhile: a compiler keeps nearly all that it makes."""
    collects, progress = gc.isenabled(), Progress(name, kept, seconds)
    current.append(progress)
    gc.disable()
    try:
        with install_listener("numba:compile", progress):
            yield
    finally:
        current.remove(progress)
        progress.end()
        if collects:
            gc.enable()
