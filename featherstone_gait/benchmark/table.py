"""Time calls in turn, print and write tables, save pictures, name the machine: what all benchmarks share."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import platform
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, get_type_hints

import numpy as np

from ..base.files import Format, complete, write_csv
from ..core.compile.jit import instruction_set

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TABLE = Format("benchmark table")
PACKAGES = {name: name for name in ("numpy", "scipy", "numba", "llvmlite", "mujoco")} | {"pinocchio": "pin"}
Line = TypeVar("Line", bound=tuple)


def machine() -> str:
    """Return processor and versions, one line each."""
    versions = (f"{name} {importlib.metadata.version(name)}" for module, name in PACKAGES.items() if installed(module))
    return (
        f"{_processor()}, {os.cpu_count()} cores, {instruction_set()}, {platform.system()} {platform.machine()}\n"
        f"Python {platform.python_version()}, {', '.join(versions)}"
    )


def _processor() -> str:
    """Return the name of the processor, which Linux states in a file only."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or "unknown processor"


def installed(module: str) -> bool:
    """Return whether a package can be imported."""
    return importlib.util.find_spec(module) is not None


def in_turn(
    calls: Sequence[Callable[[], object]], repeats: int, clock: Callable[[], float] = time.thread_time, warm: int = 0
) -> np.ndarray:
    """Time several calls in turn, so that a busy machine slows all alike.

    Returns
    -------
    times : ndarray, shape (repeats, calls)
        Seconds of the clock, without the first `warm` turns.
    """
    times = np.zeros((repeats + warm, len(calls)))
    for row in times:
        for k, call in enumerate(calls):
            start = clock()
            call()
            row[k] = clock() - start
    return times[warm:]


def spread(times: np.ndarray) -> tuple[list[float], list[float]]:
    """Return the median of each row (n, repeats), and its quartiles' distance by that."""
    low, middle, high = np.percentile(times, [25, 50, 75], axis=1)
    return middle.tolist(), ((high - low) / middle).tolist()


def print_table(kind: Any, rows: Iterable[Line]) -> list[Line]:
    """Print rows as they are made, and return them; NaN leaves its cell empty.

    The fields that are shown state their heading and the format of their column, width first:
    `Annotated[float, "heading", "8.1e"]`.
    """
    hints = get_type_hints(kind, include_extras=True)
    shown = [(name, *hint.__metadata__) for name, hint in hints.items() if hasattr(hint, "__metadata__")]
    width = {name: int(form.lstrip("<").partition(".")[0].rstrip("%g")) for name, _, form in shown}
    print(" ".join(f"{head:{'' if form[0] == '<' else '>'}{width[name]}}" for name, head, form in shown))
    found = []
    for row in rows:
        cells = ((getattr(row, name), name, form) for name, _, form in shown)
        print(" ".join(f"{x:{form}}" if x == x else " " * width[name] for x, name, form in cells), flush=True)
        found.append(row)
    return found


def write_table(path: Path, columns: Sequence[str], rows: Iterable[Sequence], notes: str = "") -> None:
    """Write CSV whole or not at all, NaN as an empty cell; format and notes are comments above the header.

    A folder that does not exist is made: what took minutes to measure is not to be lost.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    write_csv(path, TABLE, columns, (["" if x != x else x for x in row] for row in rows), notes)


def tabulate(path: Path, kind: Any, rows: Iterable[Line], notes: str) -> list[Line]:
    """Print rows as they are made, write them as CSV under the notes, and return them."""
    found = print_table(kind, rows)
    write_table(path, kind._fields, found, notes)
    return found


def save_figure(figure: Figure, path: Path) -> None:
    """Write a picture whole or not at all."""
    with complete(path) as temporary:
        figure.savefig(temporary, dpi=130)
