"""What several experiments do to robots and to figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ..model import Model
from ..view.style import BLUE, COLOURS, ORANGE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SERVO_COLOURS = {"standard": ORANGE, "mipsd": BLUE, "rotor": COLOURS[2]}  # the same in all figures


def heavier(model: Model, times: ArrayLike) -> Model:
    """The masses and inertias of the links this many times their own; times: a number, or one a link."""
    links = [
        replace(x, mass=float(m) * x.mass, inertia=tuple(float(m) * i for i in x.inertia))
        for x, m in zip(model.links, np.broadcast_to(times, len(model.links)))
    ]
    return replace(model, links=tuple(links))


def grid_of_panels(
    width: float, height: float, rows: int = 1, columns: int = 1, **shared: Any
) -> tuple[Figure, np.ndarray]:
    """A figure [inch] and its axes (rows, columns)."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **shared)


def draw_band(axes: Axes, x: ArrayLike, curves: Sequence[np.ndarray] | np.ndarray, color: str, label: str) -> None:
    """Median and range of curves (n, len(x))."""
    axes.fill_between(x, np.min(curves, axis=0), np.max(curves, axis=0), color=color, alpha=0.15)
    axes.plot(x, np.median(curves, axis=0), color=color, label=label)


def draw_marks(axes: Axes, place: float, values: Sequence[float] | np.ndarray, color: str, half_width: float) -> None:
    """A mark a value, side by side, and the line of their median."""
    spread = np.linspace(-0.5, 0.5, len(values)) * half_width * (len(values) > 1)
    axes.plot(place + spread, values, "o", ms=5, color=color, alpha=0.6)
    axes.plot([place - half_width, place + half_width], [np.median(values)] * 2, color=color, linewidth=2)
