"""Share constants, scaled robots, cases in threads and figures among experiments."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import TYPE_CHECKING, Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from ..base.progress import progress_bar
from ..model import Model
from ..view.style import BLUE, COLORS, ORANGE
from ..view.style import subplots as subplots

if TYPE_CHECKING:
    from matplotlib.axes import Axes

T = TypeVar("T")
R = TypeVar("R")

ENCODER_STEP = math.radians(300.0 / 1023.0)  # of the AX-12 [rad], ROBOTIS e-manual
EXPLICIT: Literal["simtwo"] = "simtwo"  # integrator of the paper's program of 2012
IMPLICIT: Literal["implicit_euler"] = "implicit_euler"
SERVO_COLORS = {"standard": ORANGE, "mipsd": BLUE, "rotor": COLORS[2]}  # the same in all figures
LINE_STYLES = {EXPLICIT: "-", IMPLICIT: "--"}
INTEGRATOR_NAMES = {EXPLICIT: "explicit (simtwo)", IMPLICIT: "implicit_euler"}


def scale_masses(model: Model, times: ArrayLike) -> Model:
    """Scale the masses and inertias of the links; times: a factor, or one for each link."""
    links = [
        replace(x, mass=float(m) * x.mass, inertia=tuple(float(m) * i for i in x.inertia))
        for x, m in zip(model.links, np.broadcast_to(times, len(model.links)))
    ]
    return replace(model, links=tuple(links))


def in_threads(
    function: Callable[[T], R], items: Iterable[T], label: str = "", progress: bool = False, unit: str = "case"
) -> list[R]:
    """Apply a function to each item, one thread for each core; return the results in the order of the items."""
    todo = list(items)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(progress_bar(pool.map(function, todo), label, len(todo), progress=progress, unit=unit))


def draw_band(axes: Axes, x: ArrayLike, curves: Sequence[np.ndarray] | np.ndarray, color: str, label: str) -> None:
    """Draw median and range of curves (n, len(x))."""
    axes.fill_between(x, np.min(curves, axis=0), np.max(curves, axis=0), color=color, alpha=0.15)
    axes.plot(x, np.median(curves, axis=0), color=color, label=label)


def draw_marks(axes: Axes, place: float, values: Sequence[float] | np.ndarray, color: str, half_width: float) -> None:
    """Draw a mark for each value, side by side, and the line of their median."""
    spread = np.linspace(-0.5, 0.5, len(values)) * half_width * (len(values) > 1)
    axes.plot(place + spread, values, "o", ms=5, color=color, alpha=0.6)
    axes.plot([place - half_width, place + half_width], [np.median(values)] * 2, color=color, linewidth=2)
