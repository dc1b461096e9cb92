"""Pictures of trajectories: channels against time, and the robot as a stick figure at successive instants."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..arguments import instance, listed, shown, whole
from ..core.step.state import BY_NAME, UNITS
from ..dynamics import check_model, forward_kinematics
from ..model import Model

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ..trajectory import Trajectory

MOST_FIGURES = 10**4
STYLES = ("-", "--", ":")  # of every ten lines, which have ten colours


def plot_trajectory(
    trajectory: Trajectory, names: Sequence[str], axes: Axes | Sequence[Axes] | np.ndarray | None = None
) -> Figure:
    """Draw channels against time [s], one panel each, in `axes` if given; return the figure.

    Raises ValueError on an unknown channel and on another number of axes than of names.
    """
    instance("trajectory", trajectory, Mapping, "give what simulate returns")
    names = listed("names", names, "give a list of channels")
    if not names:
        raise ValueError("names is empty; give a list of channels")
    for name in names:
        if not isinstance(name, str) or name not in trajectory:
            raise ValueError(f"names: there is no channel {shown(name)}; channels: {', '.join(map(str, trajectory))}")
    if axes is None:
        from matplotlib import pyplot

        size = (7.0, 1.0 + 2.0 * len(names))
        _, axes = pyplot.subplots(len(names), sharex=True, squeeze=False, figsize=size, layout="constrained")
    panels = np.ravel(np.asarray(axes))
    _check_axes(panels)
    if len(panels) != len(names):
        raise ValueError(f"{len(names)} channels and {len(panels)} axes; give one each")
    for panel, name in zip(panels, names):
        _plot_channel(panel, trajectory, name)
    panels[-1].set_xlabel("time [s]")
    return panels[-1].figure


def _check_axes(panels: Iterable[Any]) -> None:
    for panel in panels:
        if not hasattr(panel, "add_collection"):
            raise TypeError(f"axes is {shown(panel)}; give matplotlib's axes, or None")


def _plot_channel(axes: Axes, trajectory: Trajectory, name: str) -> None:
    """One panel; forces and energies of several numbers a joint or contact point are summed over these."""
    channel, values, labels = BY_NAME.get(name), trajectory[name], trajectory.info.get("joints")
    if values.ndim == 3 and channel is not None and channel.unit in ("J", "N"):
        values, labels = values.sum(axis=1), channel.labels
    values = values.reshape(len(values), -1)
    if labels is None or len(labels) != values.shape[1]:
        labels = [str(k) for k in range(values.shape[1])]
    for k, (column, label) in enumerate(zip(values.T, labels)):
        axes.plot(trajectory["time"], column, STYLES[k // 10 % 3], linewidth=1.2, label=label)
    axes.set_ylabel(f"{name} [{UNITS[name]}]" if name in UNITS else name)
    axes.grid(alpha=0.3)
    if trajectory.end_time < trajectory["time"][-1]:
        axes.axvline(trajectory.end_time, color="0.2", linestyle=":", linewidth=1.2)
    if values.shape[1] > 1:
        size = 8 if values.shape[1] <= 10 else 6
        axes.legend(frameon=False, fontsize=size, labelspacing=0.2, loc="upper left", bbox_to_anchor=(1.0, 1.05))


def plot_motion(
    model: Model, trajectory: Trajectory, axes: Axes | None = None, count: int = 12, view: str = "xz"
) -> Figure:
    """Draw the robot as a stick figure at `count` instants from the start (dark) to the end (light); return the figure.

    Each link is a line from its joint to those of its children, a last link one to its centre of mass, a sole one to
    each contact point.  view: the world axes to the right and up.  The trajectory needs the channel q, and base_q of a
    floating base.
    """
    from matplotlib import colormaps
    from matplotlib.collections import LineCollection

    check_model(model)
    instance("trajectory", trajectory, Mapping, "give what simulate returns")
    count = whole("count", count, 1, "give the number of figures", MOST_FIGURES)
    if not isinstance(view, str) or len(view) != 2 or set(view) - set("xyz"):
        raise ValueError(f"view is {shown(view)}; give the world axes to the right and up, such as 'xz'")
    if axes is None:
        from matplotlib import pyplot

        _, axes = pyplot.subplots(figsize=(5.0, 5.0), layout="constrained")
    _check_axes([axes])
    if not hasattr(trajectory, "end_time"):
        raise TypeError(f"trajectory is {type(trajectory).__name__}; give what simulate returns")
    last = np.searchsorted(trajectory["time"], trajectory.end_time - 1e-9)  # of a failed run the end is earlier
    rows = np.linspace(0, min(int(last), len(trajectory["time"]) - 1), count).round().astype(int)
    colors = colormaps["viridis"](np.linspace(0.0, 0.9, count))
    right, up = ("xyz".index(axis) for axis in view)
    sticks = _sticks(model, positions(trajectory, model)[rows])[..., [right, up]]
    for figure, color in zip(sticks, colors):
        axes.add_collection(LineCollection(figure, colors=[color], linewidths=2.0, capstyle="round"))
        axes.plot(*figure[:, 0].T, "o", color=color, markersize=3)
    axes.set(xlabel=f"{view[0]} [m]", ylabel=f"{view[1]} [m]")
    middle, half = 0.5 * (sticks.max((0, 1, 2)) + sticks.min((0, 1, 2))), 0.55 * np.ptp(sticks, (0, 1, 2)).max()
    axes.set(xlim=(middle[0] - half, middle[0] + half), ylim=(middle[1] - half, middle[1] + half), aspect="equal")
    axes.grid(alpha=0.3)
    return axes.figure  # type: ignore[return-value]  # that of axes in a part of a figure is the part


def positions(trajectory: Trajectory, model: Model | None = None) -> np.ndarray:
    """Positions q (samples, nq) as the functions of `dynamics` take them.

    Raises ValueError, if the model is given, where one of its channels was not recorded.
    """
    for name in ("base_q",) * (model is not None and model.base == "floating") + ("q",) * (model is not None):
        if name not in trajectory:
            known = ", ".join(trajectory)
            raise ValueError(f"channel {name!r} is not recorded, {known} are: name it in simulate(record=...)")
    return np.hstack([trajectory["base_q"], trajectory["q"]]) if "base_q" in trajectory else trajectory["q"]


def _sticks(model: Model, q: np.ndarray) -> np.ndarray:
    """Both ends (n, lines, 2, 3) of every line, in the world [m]."""
    row = {link.name: k for k, link in enumerate(model.links)}
    ends = [(joint.parent, joint.xyz) for joint in model.joints] + [(p.link, p.position) for p in model.contacts]
    led_on = {name for name, _ in ends}
    ends += [(link.name, link.center_of_mass) for link in model.links if link.name not in led_on]
    poses = forward_kinematics(model, q)
    links = [row[name] for name, _ in ends]
    start = poses.position[:, links]
    end = start + np.einsum("nkij,kj->nki", poses.rotation[:, links], np.array([point for _, point in ends]))
    return np.stack([start, end], axis=2)
