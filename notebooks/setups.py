"""Robots, runs and colors that several notebooks share."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from featherstone_gait.model import Model
from featherstone_gait.optimize.planning import walking_cost
from featherstone_gait.robot_file import load_robot
from featherstone_gait.walking.cost import WalkingCost

COLORS = {"standard": "C1", "mipsd": "C0", "rotor": "C2"}  # of servo models, the same in all figures


def scale_masses(model: Model, times: ArrayLike) -> Model:
    """Scale the masses and inertias of the links; times: a factor, or one for each link."""
    links = [
        replace(x, mass=float(m) * x.mass, inertia=tuple(float(m) * i for i in x.inertia))
        for x, m in zip(model.links, np.broadcast_to(times, len(model.links)))
    ]
    return replace(model, links=tuple(links))


def planned_walk(**how: Any) -> WalkingCost:
    """Plan the walk of the paper's ten-joint humanoid; how: options of `walking_cost`."""
    return walking_cost(load_robot("humanoid", locked="simplified"), **how)


def recompiled(cost: WalkingCost, model: Model | None = None, **arguments: Any) -> WalkingCost:
    """Return the walk with another model or other arguments of `compile_scene`."""
    return replace(cost, scene=cost.scene.recompiled(model, **arguments))
