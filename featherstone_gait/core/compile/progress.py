"""What a terminal shows while kernels are compiled, which takes seconds: which, how many, that they are kept."""

import sys
import time

PATIENCE = 0.5  # [s] before anything is said


class Progress:
    """Of one entry and what it calls."""

    def __init__(self, name, kept):
        self.text = f"compiling {name}, once for this kind of scene" + (", kept for the next time" if kept else "")
        self.begun, self.count, self.shown = time.monotonic(), 0, False

    def one_more(self):
        """Count a function."""
        self.count += 1
        seconds = time.monotonic() - self.begun
        if seconds > PATIENCE and sys.stderr is not None and sys.stderr.isatty():
            self.shown = True
            sys.stderr.write(f"\r{self.text}: {self.count} functions, {seconds:.0f} s ")
            sys.stderr.flush()

    def end(self):
        """Leave the line as it is."""
        if self.shown:
            sys.stderr.write("\n")


current = []  # what is being compiled, innermost last
