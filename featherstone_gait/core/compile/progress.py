"""What a terminal or a notebook shows while kernels are compiled, which takes seconds: which, and how many."""

import gc
import sys
import time
from contextlib import contextmanager

PATIENCE = 0.5  # [s] before anything is said
OFTEN = 0.2  # [s] between two updates of the line
NOTEBOOK = "ipykernel"  # whose streams are no terminals and show a line that is written anew


class Progress:
    """Of one entry and what it calls; its line fits 80 columns."""

    def __init__(self, name, kept):
        self.text = f"compiling {name}" + (" (once, then kept)" if kept else "")
        self.begun, self.count, self.shown = time.monotonic(), 0, 0.0

    def one_more(self):
        """Count a function."""
        self.count += 1
        now = time.monotonic()
        if now - self.begun > PATIENCE and now - self.shown > OFTEN and _watched(sys.stderr):
            self.shown = now
            line = f"{self.text}: {self.count} functions, {now - self.begun:.0f} s"
            sys.stderr.write(f"\r{line[:79]:79}")
            sys.stderr.flush()

    def end(self):
        """Leave the line as it is."""
        if self.shown:
            sys.stderr.write("\n")


def _watched(stream):
    return stream is not None and (stream.isatty() or NOTEBOOK in type(stream).__module__)


current = []  # what is being compiled, innermost last


@contextmanager
def compiling(name, kept):
    """Show that an entry is being compiled; meanwhile no garbage is collected: a compiler keeps nearly all it makes."""
    collects, progress = gc.isenabled(), Progress(name, kept)
    current.append(progress)
    gc.disable()
    try:
        yield
    finally:
        current.remove(progress)
        progress.end()
        if collects:
            gc.enable()
