"""Robots, runs and colors that several notebooks share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from featherstone_gait.model import Model

COLORS = {"standard": "C1", "mipsd": "C0", "rotor": "C2"}  # of servo models, the same in all figures


def scale_masses(model: Model, times: ArrayLike) -> Model:
    """Scale the masses and inertias of the links; times: a factor, or one for each link."""
    links = [
        replace(x, mass=float(m) * x.mass, inertia=tuple(float(m) * i for i in x.inertia))
        for x, m in zip(model.links, np.broadcast_to(times, len(model.links)))
    ]
    return replace(model, links=tuple(links))
