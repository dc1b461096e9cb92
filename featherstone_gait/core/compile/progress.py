"""Progress line in a terminal or a notebook while kernels are compiled, which takes seconds."""

import gc
import sys
import time
from contextlib import contextmanager

PATIENCE = 0.5  # [s] before anything is said
OFTEN = 0.2  # [s] between two updates of the line
NOTEBOOK = "ipykernel"  # whose streams are no terminals and show a line that is written anew


class Progress:
    """Progress of compiling one entry and what it calls; the line fits 80 columns."""

    def __init__(self, name, kept):
        self.text = f"compiling {name}" + (" (once, then kept)" if kept else "")
        self.begun, self.count, self.shown = time.monotonic(), 0, 0.0

    def one_more(self):
        """Count a function."""
        self.count += 1
        now, stream = time.monotonic(), sys.stderr
        if now - self.begun <= PATIENCE or now - self.shown <= OFTEN or stream is None:
            return
        if stream.isatty() or NOTEBOOK in type(stream).__module__:
            self.shown = now
            line = f"{self.text}: {self.count} functions, {now - self.begun:.0f} s"
            stream.write(f"\r{line[:79]:79}")
            stream.flush()

    def end(self):
        """Leave the line as it is."""
        if self.shown:
            sys.stderr.write("\n")


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
