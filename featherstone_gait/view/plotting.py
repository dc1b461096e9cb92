"""Plot trajectories: channels against time, and the robot as a stick figure at successive times."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..base.arguments import instance, shown, whole
from ..core.step.state import UNITS
from ..dynamics import check_model, forward_kinematics
from ..model import Model
from ..run.contacts import by_pair
from ..run.trajectory import Trajectory
from ..run.trajectory import positions as positions
from ..scene.channels import joint_labels, unit_of
from .recorded import columns_of, lines_of
from .style import BAD, COLORS, label_ends, look, shown_once
from .visuals import SIDES_OF, side_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_FIGURES = 10**4
MANY = 8  # lines in one panel, beyond which joints are drawn side by side, left and right


class _Table(NamedTuple):
    """A channel as lines."""

    axis: str  # name and unit
    labels: list[str]
    values: np.ndarray  # (samples, lines)
    units: list[str]  # of each line, where they differ


def plot(trajectory: Trajectory, *names: str, axes: Axes | Sequence[Axes] | np.ndarray | None = None) -> Figure:
    """Draw channels of a run against time, one row each.

    Labels stand at the ends of their lines.  More than 8 joints are drawn side by side, left and right by their names,
    partners in one color and to one scale; in given axes the right ones are dashed.  A run that failed is drawn up to
    its failure, which is marked.

    Parameters
    ----------
    trajectory : Trajectory
        What `simulate` returns.
    *names : str
        Channels to draw; all that were recorded if none is named.
    axes : matplotlib axes, optional
        As many axes as names to draw in, instead of a new figure.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ValueError
        A channel was not recorded, or there are not as many axes as names.
    """
    instance("trajectory", trajectory, Trajectory, "give what simulate returns")
    names = names or tuple(name for name in trajectory if name != "time")
    for name in names:
        if not isinstance(name, str) or name not in trajectory:
            raise ValueError(f"names: there is no channel {shown(name)}; channels: {', '.join(map(str, trajectory))}")
    with look():
        if axes is None:
            return shown_once(_rows(trajectory, [_table(trajectory, name) for name in names]))
        panels = np.ravel(np.asarray(axes, dtype=object))
        _check_axes(panels)
        if len(panels) != len(names):
            raise ValueError(f"{len(names)} channels and {len(panels)} axes; give one each")
        for panel, name in zip(panels, names):
            table = _table(trajectory, name)
            _draw(panel, trajectory, table, _styles(table.labels), range(len(table.labels)))
            panel.set_ylabel(table.axis)
        panels[-1].set_xlabel("time [s]")
        return shown_once(panels[-1].figure)


def _rows(trajectory: Trajectory, tables: list[_Table]) -> Figure:
    """Make a figure with a row for each table; tables of many joints have a column for each side of the robot."""
    from matplotlib import pyplot

    sided = [_sides(table.labels) for table in tables]
    columns = max(len(groups) for groups in sided)
    heights = [max(1.9, 0.5 + 0.15 * max(len(group) for _, group in groups)) for groups in sided]
    size = (7.0 if columns == 1 else 3.6 * columns, 0.5 + sum(heights))
    figure = pyplot.figure(figsize=size, layout="constrained")
    grid = figure.add_gridspec(len(tables), columns, height_ratios=heights)
    first = None
    for row, (table, groups) in enumerate(zip(tables, sided)):
        styles, left = _styles(table.labels), None
        for column, (side, group) in enumerate(groups):
            place = grid[row, :] if len(groups) == 1 else grid[row, column]
            panel = figure.add_subplot(place, sharex=first, sharey=left)
            first, left = first or panel, left or panel
            if len(groups) > 1:
                styles = [(color, "-" if stroke == "--" else stroke) for color, stroke in styles]
            _draw(panel, trajectory, table, styles, group, side)
            if side:
                panel.set_title(side)
            if column == 0:
                panel.set_ylabel(table.axis)
            else:
                panel.tick_params(labelleft=False)
            if row == len(tables) - 1:
                panel.set_xlabel("time [s]")
    return figure


def _table(trajectory: Trajectory, name: str) -> _Table:
    """Convert a channel to lines; forces and energies with several numbers are summed over joints or contact points."""
    summed = UNITS.get(name) in ("J", "N")
    types = trajectory.info.get("joint_types", ())
    unit = unit_of(name, types)
    found = by_pair(trajectory.channels, trajectory.info, name)
    if found is not None:
        labels, values = lines_of(found, name)
    else:
        labels, values = columns_of(name, trajectory[name], joint_labels(trajectory.info, name), summed)
    units = [unit_of(name, [kind]) for kind in types]
    differ = len(types) == len(labels) and len({*units}) > 1
    return _Table(f"{name} [{unit}]" if unit else name, labels, values, units if differ else [""] * len(labels))


def _sides(labels: list[str]) -> list[tuple[str, list[int]]]:
    """Group lines into panels: one for all, or if there are many one each for left, right and others."""
    of = {side: [k for k, label in enumerate(labels) if side_of(label) == side] for side in ("left", "right", "")}
    if len(labels) <= MANY or not of["left"] or not of["right"]:
        return [("", list(range(len(labels))))]
    return [(side or "others", group) for side, group in of.items() if group]


def _styles(labels: list[str]) -> list[tuple[str, str]]:
    """Choose color and stroke of each line; left and right partners share a color, and the right one is dashed."""
    if len(labels) <= MANY and len({_partner(label) for label in labels}) == len(labels):
        return [(COLORS[k % len(COLORS)], "-") for k in range(len(labels))]
    kinds = {kind: k for k, kind in enumerate(dict.fromkeys(_partner(label) for label in labels))}
    strokes = ("-", "-.", ":")
    return [
        (COLORS[kinds[_partner(x)] % len(COLORS)],
         "--" if side_of(x) == "right" else strokes[kinds[_partner(x)] // len(COLORS) % 3])
        for x in labels
    ]  # fmt: skip


def _partner(label: str) -> str:
    """Remove the side from a name, so that left and right partners have the same."""
    side = side_of(label)
    words = label.lower().replace("-", "_").split("_")
    return "_".join(word for word in words if word not in {side, *SIDES_OF[side]}) if side else label


def _draw(
    axes: Axes, trajectory: Trajectory, table: _Table, styles: list[tuple[str, str]], lines: Iterable[int],
    side: str = "",
) -> None:  # fmt: skip
    """Draw some lines of a table, up to where the run failed, with labels at their ends."""
    failed, time = trajectory.failed, trajectory["time"]
    last = max(1, int(np.searchsorted(time, trajectory.end_time + 1e-9, side="right"))) if failed else len(time)
    ends = []
    for k in lines:
        color, stroke = styles[k]
        label = _partner(table.labels[k]) if side in ("left", "right") else table.labels[k]
        column = table.values[:last, k]
        axes.plot(time[:last], column, stroke, color=color, label=table.labels[k])
        if np.isfinite(column[-1]):
            unit = f" [{table.units[k]}]" if table.units[k] else ""
            ends.append((float(column[-1]), label.replace("_", " ") + unit, color))
    axes.margins(x=0.0)
    axes.set_xlim(float(time[0]), float(time[-1]) if len(time) > 1 else None)
    if len(table.labels) > 1:
        label_ends(axes, ends, trajectory.end_time if failed else None)
    if failed:
        axes.axvline(trajectory.end_time, color=BAD, linestyle=":", linewidth=1.2)
    if failed or trajectory.status != "ok":
        text = trajectory.status + f" at {trajectory.end_time:.3g} s" * failed
        axes.annotate(
            text, (1.0, 1.0), xycoords="axes fraction", xytext=(-3, -3), textcoords="offset points", color=BAD,
            fontsize=8, ha="right", va="top", fontweight="bold",
            bbox={"facecolor": "white", "alpha": 0.8, "linewidth": 0, "pad": 1},
        )  # fmt: skip


def _check_axes(panels: Iterable[Any]) -> None:
    for panel in panels:
        if not hasattr(panel, "add_collection"):
            raise TypeError(f"axes is {shown(panel)}; give matplotlib's axes, or None")


def plot_motion(
    model: Model, trajectory: Trajectory, axes: Axes | None = None, count: int = 12, view: str = "xz"
) -> Figure:
    """Draw the robot as a stick figure at several times, from dark (start) to light (end).

    Each link is a line from its joint to those of its children, a last link one to its center of mass, a sole one to
    each contact point.

    Parameters
    ----------
    model : Model
        The robot.
    trajectory : Trajectory
        What `simulate` returns, with the channel q, and base_q of a floating base.
    axes : matplotlib axes, optional
        Axes to draw in, instead of a new figure.
    count : int
        Number of stick figures.
    view : str
        The world axes that point right and up, such as "xz".

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ValueError
        A channel was not recorded, or an argument is out of range.
    """
    from matplotlib import colormaps
    from matplotlib.collections import LineCollection

    check_model(model)
    instance("trajectory", trajectory, Trajectory, "give what simulate returns")
    count = whole("count", count, 1, "give the number of figures", MOST_FIGURES)
    if not isinstance(view, str) or len(view) != 2 or set(view) - set("xyz"):
        raise ValueError(f"view is {shown(view)}; give the world axes to the right and up, such as 'xz'")
    if axes is None:
        from matplotlib import pyplot

        _, axes = pyplot.subplots(figsize=(5.0, 5.0), layout="constrained")
    _check_axes([axes])
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
    return shown_once(axes.figure)  # that of axes in a part of a figure is the part


def _sticks(model: Model, q: np.ndarray) -> np.ndarray:
    """Compute both ends (n, lines, 2, 3) of every line in world axes [m]."""
    row = {link.name: k for k, link in enumerate(model.links)}
    ends = [(joint.parent, joint.xyz) for joint in model.joints] + [(p.link, p.position) for p in model.contacts]
    led_on = {name for name, _ in ends}
    ends += [(link.name, link.center_of_mass) for link in model.links if link.name not in led_on]
    poses = forward_kinematics(model, q)
    links = [row[name] for name, _ in ends]
    start = poses.position[:, links]
    end = start + np.einsum("nkij,kj->nki", poses.rotation[:, links], np.array([point for _, point in ends]))
    return np.stack([start, end], axis=2)
