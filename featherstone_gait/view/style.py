"""Give all figures one style: colors that color-blind readers distinguish, quiet axes, labels at the ends of lines.

Colors are those of M. Okabe and K. Ito (2008) without yellow, which is too pale for a line.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000", "#7F7F7F")
BLUE, ORANGE, GREY = COLORS[0], COLORS[1], "0.45"
BAD = "#A3160F"  # what failed, always with a word or a cross besides
COLUMN = 3.5  # width of a column of a page [inch]
LOOK: dict[str, Any] = {
    "axes.axisbelow": True, "axes.spines.top": False, "axes.spines.right": False,
    "axes.titlesize": 9.5, "axes.labelsize": 9, "figure.titlesize": 11, "font.size": 9, "grid.alpha": 0.3,
    "grid.linewidth": 0.6, "legend.frameon": False, "legend.fontsize": 8, "lines.linewidth": 1.3,
    "xtick.labelsize": 8, "ytick.labelsize": 8,
}  # fmt: skip


def in_notebook() -> bool:
    """Return whether the program runs in a notebook, which shows HTML."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    return shell is not None and "kernel" in type(shell).__module__


def shown_once(figure: Any) -> Any:
    """Return a figure of pyplot, which a notebook draws once: as the value of its cell, or else when the cell ends."""
    if in_notebook():
        figure.get_figure(root=True)._ipython_display_ = partial(_display, figure)  # IPython calls it to show a value
    return figure


def _display(figure: Any) -> None:
    """Draw a figure in a notebook, and close it, lest the end of the cell draws it again; leave windows alone."""
    from IPython.display import Image, display
    from matplotlib import get_backend, pyplot

    whole, backend = figure.get_figure(root=True), get_backend().lower()
    if "inline" in backend or backend == "agg" or not pyplot.fignum_exists(getattr(whole, "number", -1)):
        picture = BytesIO()
        whole.savefig(picture, format="png", bbox_inches="tight")
        display(Image(picture.getvalue()))
        pyplot.close(whole)


@contextmanager
def look(grid: bool = True) -> Iterator[None]:
    """Apply the style to figures that are made within; grid: draw one in all axes."""
    import matplotlib
    from cycler import cycler

    settings: Any = LOOK | {"axes.prop_cycle": cycler(color=COLORS), "axes.grid": grid}
    with matplotlib.rc_context(settings):
        yield


def subplots(width: float, height: float, rows: int = 1, columns: int = 1, **options: Any) -> tuple[Figure, Any]:
    """Make a figure [inch] and its axes, as `matplotlib.pyplot.subplots` does."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(rows, columns, **options)


def label_ends(axes: Axes, ends: Sequence[tuple[float, str, Any]], x: float | None = None, size: float = 7.5) -> None:
    """Write a label (y, text, color) beside the end of each line, moved apart where they would overlap.

    x: where the lines end, None for the right edge of the axes.
    """
    if not ends:
        return
    low, high = axes.get_ylim()
    figure: Any = axes.figure
    tall = axes.get_position().height * figure.get_figure(root=True).get_figheight() * 72.0 or 100.0
    gap = 1.25 * size / tall
    size *= min(1.0, 1.1 / (gap * max(1, len(ends) - 1)))
    order = sorted(range(len(ends)), key=lambda k: ends[k][0])
    wanted = np.array([(ends[k][0] - low) / ((high - low) or 1.0) for k in order])
    for k, place in zip(order, spread(wanted, gap)):
        _, text, color = ends[k]
        axes.annotate(
            text, (1.0 if x is None else x, place), xytext=(4, 0), textcoords="offset points", color=color,
            xycoords="axes fraction" if x is None else axes.get_xaxis_transform(), fontsize=size, va="center",
            annotation_clip=False, parse_math=False,
        )  # fmt: skip


def spread(wanted: np.ndarray, gap: float) -> np.ndarray:
    """Move rising places (n,) in [0, 1] at least `gap` apart, as near as possible to those wanted.

    If so many do not fit, they are closer together.
    """
    gap = min(gap, 1.0 / max(1, len(wanted) - 1))
    blocks: list[list[float]] = []  # sum of wanted places less the gaps before, count
    for k, place in enumerate(wanted):
        blocks.append([place - gap * k, 1.0])
        while len(blocks) > 1 and blocks[-2][0] / blocks[-2][1] >= blocks[-1][0] / blocks[-1][1]:
            total, count = blocks.pop()
            blocks[-1] = [blocks[-1][0] + total, blocks[-1][1] + count]
    means = [total / count for total, count in blocks for _ in range(int(count))]
    steps = gap * np.arange(len(wanted))
    return np.maximum(np.minimum(np.array(means) + steps, 1.0 - steps[::-1]), steps)
