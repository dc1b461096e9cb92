"""Share constants, scaled robots and cases in threads among experiments."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from ..base.progress import progress_bar
from ..model import Model
from ..view.style import BLUE, COLORS, ORANGE
from ..view.style import subplots as subplots

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
