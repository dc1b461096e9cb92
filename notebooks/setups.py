"""Robots, runs and colors that several notebooks share."""

from __future__ import annotations

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import ArrayLike

from featherstone_gait.model import Model
from featherstone_gait.view.style import look

COLORS = {"standard": "C1", "mipsd": "C0", "rotor": "C2"}  # of servo models, the same in all figures


def scale_masses(model: Model, times: ArrayLike) -> Model:
    """Scale the masses and inertias of the links; times: a factor, or one for each link."""
    links = [
        replace(x, mass=float(m) * x.mass, inertia=tuple(float(m) * i for i in x.inertia))
        for x, m in zip(model.links, np.broadcast_to(times, len(model.links)))
    ]
    return replace(model, links=tuple(links))


def draw_angles(panels: dict, sharey: bool = True, ylabel: str = "angle [deg]"):
    """Draw the first joint of runs over time, with legends below; panels: title -> label -> run.  Return the axes."""
    with look():
        _, axes = plt.subplots(1, len(panels), figsize=(9, 3.4), sharey=sharey, layout="constrained")
        for one, (title, runs) in zip(axes, panels.items()):
            for (label, run), style in zip(runs.items(), ("-", "--", ":", "-.")):
                one.plot(run["time"], np.degrees(run["q"][:, 0]), style, label=label)
            one.set(title=title, xlabel="time [s]")
            one.legend(loc="upper center", bbox_to_anchor=(0.5, -0.18), ncols=2)
        axes[0].set_ylabel(ylabel)
    return axes
