"""Progress bars, which are shown on a terminal and in a notebook, and not written into logs."""

from __future__ import annotations

import sys
from typing import Any

from tqdm import tqdm

from ..core.compile.progress import NOTEBOOK


def progress_bar(*args: Any, progress: bool = True, **how: Any) -> tqdm:
    """Make a `tqdm` bar, shown if `progress` is set and errors go to a terminal or a notebook; how: as in `tqdm`."""
    stream = sys.stderr
    seen = stream is not None and (stream.isatty() or NOTEBOOK in type(stream).__module__)
    return tqdm(*args, disable=not (progress and seen), **how)
