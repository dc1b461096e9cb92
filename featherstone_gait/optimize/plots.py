"""Plots of a gait search: convergence and joint angles."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import OptimizeResult

from ..view.style import BAD, BLUE, look
from ..walking.cost import WalkingCost
from .gait_page import candidate_numbers, least_so_far, parts_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@look()
def plot_convergence(result: OptimizeResult) -> Figure:
    """Plot the cost of every candidate and the best so far [J/m], which starts anew where the descent begins.

    Parameters
    ----------
    result : scipy.optimize.OptimizeResult
        Of `optimize_gait` or `optimize_with_limits`, in which some gait walks.

    Returns
    -------
    matplotlib.figure.Figure
        The plot.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 4.0), layout="constrained")
    axes = figure.subplots()
    costs, since = result.history["f"], result.get("since")
    best = np.concatenate([least_so_far(part) for part in parts_of(costs, since)])
    at = candidate_numbers(costs, since, result.nit)
    start = best[np.isfinite(best)][0]
    failed = at[~(costs < 1.5 * start)]
    axes.plot(at, costs, ".", color="0.65", markersize=3, label="candidate")
    axes.plot(failed, np.full(len(failed), 1.5 * start), "|", color=BAD, alpha=0.4, label="fell, or costs more")
    axes.step(at, best, where="post", color=BLUE, label="best so far")
    axes.set(xlabel="candidate", ylabel="energy per distance [J/m]", ylim=(0.0, 1.55 * start), xlim=(0, max(at[-1], 1)))
    axes.legend(loc="lower left")
    return figure


@look()
def plot_angles(cost: WalkingCost, first: np.ndarray, best: np.ndarray) -> Figure:
    """Plot the joint angles of a stride [deg] and the poses, of the first and the optimized gait.

    Parameters
    ----------
    cost : WalkingCost
        The cost that was searched.
    first, best : ndarray, shape (D,)
        Gait vectors [rad], as of `cost.gait.to_vector()`.

    Returns
    -------
    matplotlib.figure.Figure
        The plot.
    """
    from matplotlib.figure import Figure

    names, n = cost.gait.joint_names, len(cost.gait.joint_names)
    columns = math.ceil(n / 2)
    figure = Figure(figsize=(max(2.4 * columns, 5.0), 5.0), layout="constrained")
    panels = figure.subplots(2, columns, sharex=True, squeeze=False).ravel()
    times = np.linspace(0.0, cost.gait.period, 121)
    for x, style, label in ((first, "0.6", "first gait"), (best, BLUE, "optimized gait")):
        gait = cost.gait.from_vector(x)
        knots = np.arange(len(gait.poses)) * gait.period / len(gait.poses)
        for k, panel in enumerate(panels[:n]):
            panel.plot(times, np.degrees(gait.angles(times)[:, k]), color=style, label=label)
            panel.plot(knots, np.degrees(gait.poses[:, k]), "o", color=style, markersize=4)
    for panel, name in zip(panels, names):
        panel.set_title(name.replace("_", " "), parse_math=False)
    for panel in panels[n:]:
        panel.set_axis_off()
    figure.supxlabel("time in the stride [s]", fontsize="medium")
    figure.supylabel("joint angle [deg]", fontsize="medium")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure
