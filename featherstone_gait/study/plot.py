"""Plot a study: its first measure over the varied parameters.

One parameter gives a line, two a map, a grid of three a map for each value of the one with the fewest values.  More
parameters, and random ones, give a panel each, with all runs and the median of those that are "ok".  Parameters with a
single value do not count.  Runs with another status are crosses, at the edge of the panel if they have no value.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..base.files import complete
from ..view.style import BAD, BLUE, look
from .measures import COLUMNS
from .settings import PARAMETERS, Axis, Study
from .table import read_columns

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure

AT_REST = 1e-12  # variance of joints that rest [deg^2]
SHOWN = 20_000  # runs drawn as points
BINS, FEW = 12, 50  # of the median along a parameter that takes more than a few values
DECADES = 30.0  # largest by smallest value from which an axis is logarithmic
SPAN = 1e-16  # smallest by largest value of an axis or color
LABELS = 9  # of an axis of a map
MAPS = 9  # maps side by side


class _Column(NamedTuple):
    """A varied parameter of all runs, as places on an axis."""

    label: str
    x: np.ndarray  # (runs,)
    names: tuple[str, ...] | None  # of the places 0, 1, ...; None for numbers
    axis: Axis

    @property
    def log(self) -> bool:
        return self.names is None and _wide(self.x)


def plot_study(study: Study, table: Path, path: Path) -> None:
    """Plot a study's table to a PNG file."""
    figure = _figure(study, table)
    with complete(path) as temporary:
        figure.savefig(temporary, dpi=130)


@look()
def _figure(study: Study, table: Path) -> Figure:
    from matplotlib.figure import Figure

    columns_of = COLUMNS[study.setup.experiment]
    read = read_columns(table, (*study.names, "status", *columns_of))
    measure, y = _measure(read, tuple(columns_of))
    says = columns_of[measure]
    ok = np.array(read["status"]) == "ok"
    columns = [_column(name, axis, read[name]) for name, axis in zip(study.setup.names, study.axes)]
    mean = "\nmean of the draws [widths]"
    columns += [
        _Column(draw.name + mean, np.array(read[draw.name], dtype=float), None, Axis((), -1.0, 1.0))
        for draw in study.setup.draws
    ]
    columns = [column for column in columns if len(column.axis.values) != 1] or columns[:1]
    shape = [len(column.axis.values) for column in columns]
    grid, several = study.shares is None, len(columns) == 3 and study.shares is None and min(shape) <= MAPS
    count = min(shape) if several else len(columns) if len(columns) > 2 else 1
    width = min(count, 3)
    height = -(-count // width)
    figure = Figure(figsize=(7.0, 4.5) if count == 1 else (3.6 * width, 0.5 + 2.9 * height), layout="constrained")
    panels = figure.subplots(height, width, squeeze=False).ravel()
    if several or (grid and len(columns) == 2):
        _maps(figure, panels, columns, y, ok, says)
    elif len(columns) == 2:
        _scatter(figure, panels[0], columns, y, ok, says)
    else:
        for panel, column in zip(panels, columns):
            _marginal(panel, column, y, ok, line=len(columns) == 1)
        for panel in panels[::width]:
            panel.set_ylabel(says)
        for panel in panels[len(columns) :]:
            panel.set_axis_off()
        if panels[0].get_legend_handles_labels()[1]:
            panels[0].legend(fontsize=8, frameon=False)
    failed = f", {np.sum(~ok)} not ok" if not ok.all() else ""
    title = f"{study.name}: {study.setup.model.name}, {study.setup.experiment}, {len(study)} runs{failed}"
    figure.suptitle(title, parse_math=False)
    return figure


def _measure(read: dict[str, tuple[str, ...]], measures: Sequence[str]) -> tuple[str, np.ndarray]:
    """Choose the first measure and its values; the second if the first is a variance that is rounding alone."""
    for measure in measures:
        y = np.array([float(text) if text else np.nan for text in read[measure]])
        if not (measure == "variance_deg2" and (y[np.isfinite(y)] < AT_REST).all()):
            break
    return measure, y


def _column(name: str, axis: Axis, texts: Sequence[str]) -> _Column:
    unit = PARAMETERS[name]
    if isinstance(unit, str):
        return _Column(name if unit == "-" else f"{name} [{unit}]", np.array(texts, dtype=float), None, axis)
    names = tuple(str(value) for value in axis.values)
    return _Column(name, np.array([names.index(text) for text in texts], dtype=float), names, axis)


def _wide(values: np.ndarray) -> bool:
    """Return whether positive values range so widely that they need a logarithmic axis."""
    known = values[np.isfinite(values)]
    return len(known) > 1 and known.min() > 0 and known.max() > DECADES * known.min()


def _least(values: np.ndarray) -> float:
    """Find the smallest value to show, so that an axis does not have too many decades."""
    known = values[np.isfinite(values)]
    return max(known.min(), SPAN * known.max()) if _wide(values) else known.min()


def _scale_x(panel: Axes, column: _Column) -> None:
    panel.set_xlabel(column.label)
    if column.names is not None:
        panel.set_xticks(range(len(column.names)), column.names, rotation=20 if len(column.names) > 3 else 0)
        panel.set_xlim(-0.5, len(column.names) - 0.5)
    elif column.log:
        panel.set_xscale("log")


def _marginal(panel: Axes, column: _Column, y: np.ndarray, ok: np.ndarray, line: bool) -> None:
    """Draw the measure over one parameter; `line` joins its values, else their median is drawn."""
    _scale_x(panel, column)
    if _wide(y):
        panel.set_yscale("log")
        y = np.maximum(y, _least(y))
    shown = np.zeros(len(y), bool)
    shown[:: -(-len(y) // SHOWN)] = True
    good, bad, lost = (shown & part for part in (ok & np.isfinite(y), ~ok & np.isfinite(y), ~np.isfinite(y)))
    panel.plot(column.x[good], y[good], "o", color=BLUE, markersize=5 if line else 3, alpha=1 if line else 0.4, mew=0)
    marks: dict[str, Any] = {"color": BAD, "markersize": 6 if line else 4, "linestyle": ""}
    panel.plot(column.x[bad], y[bad], "x", label="not ok" if bad.any() else None, **marks)
    marks |= {"transform": panel.get_xaxis_transform(), "label": "no value" if lost.any() else None}
    panel.plot(column.x[lost], np.full(lost.sum(), 0.02), "x", **marks)
    median = _median(column, np.where(ok, y, np.nan))
    if column.names is None:
        panel.plot(*median, color=BLUE, linewidth=1.5, label=None if line else "median")
    elif not line:
        panel.plot(*median, "_", color=BLUE, markersize=18, label="median")


def _median(column: _Column, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute the median of the runs at each value, or in bins along a parameter with more than a few values."""
    x, known = column.x, np.isfinite(y)
    if not column.axis.values or (len(column.axis.values) > FEW and column.names is None):
        spaced = np.geomspace if column.log else np.linspace
        edges = spaced(x.min(), x.max(), BINS + 1)
        place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, BINS - 1)
    else:
        place = np.unique(x, return_inverse=True)[1]
    groups = [known & (place == k) for k in range(place.max() + 1)]
    groups = [group for group in groups if group.any()]
    return np.array([x[g].mean() for g in groups]), np.array([np.median(y[g]) for g in groups])


def _norm(y: np.ndarray) -> Any:
    """Make the color scale for values."""
    from matplotlib.colors import LogNorm, Normalize

    known = y[np.isfinite(y)]
    return (LogNorm if _wide(y) else Normalize)(_least(y), known.max()) if len(known) else Normalize(0.0, 1.0)


def _maps(figure: Figure, panels: np.ndarray, columns: list[_Column], y: np.ndarray, ok: np.ndarray, says: str) -> None:
    """Draw a cell for each run of a grid over two parameters, with a map for each value of a third."""
    shape, norm, titles = [len(column.axis.values) for column in columns], _norm(y), [""]
    values, sound = (x.reshape(-1, *shape[-2:]) for x in (y, ok))
    if len(columns) == 3:
        apart = int(np.argmin(shape))  # the one with the fewest values
        values, sound = (np.moveaxis(x.reshape(shape), apart, 0) for x in (y, ok))
        name, _, unit = columns[apart].label.partition(" [")
        titles = [f"{name} {text} {unit.rstrip(']')}".rstrip() for text in _texts(columns[apart].axis.values)]
        columns = columns[:apart] + columns[apart + 1 :]
    for panel, title, v, o in zip(panels, titles, values, sound):
        image = _cells(panel, columns, v, o, norm)
        panel.set_title(title)
    for panel in panels[len(values) :]:
        panel.set_axis_off()
    if not ok.all():
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower left")
    figure.colorbar(image, ax=panels[: len(values)].tolist(), label=says)


def _texts(values: Sequence[Any]) -> list[str]:
    return [value if isinstance(value, str) else f"{value:.3g}" for value in values]


def _cells(panel: Axes, columns: list[_Column], y: np.ndarray, ok: np.ndarray, norm: Any) -> ScalarMappable:
    """Draw a cell for each run (rows, columns), crosses where it is not ok, gray where it has no value."""
    up, across = columns
    panel.set_facecolor("0.85")
    panel.grid(False)
    image = panel.pcolormesh(y, norm=norm, cmap="viridis")
    for set_ticks, column in ((panel.set_xticks, across), (panel.set_yticks, up)):
        step = -(-len(column.axis.values) // LABELS)
        texts = _texts(column.axis.values[::step])
        set_ticks(0.5 + step * np.arange(len(texts)), texts)
    rows, cells = np.nonzero(~ok)
    panel.plot(0.5 + cells, 0.5 + rows, "X", color=BAD, markersize=8, markeredgecolor="white", label="not ok")
    panel.set(xlabel=across.label, ylabel=up.label)
    return image


def _scatter(figure: Figure, panel: Axes, columns: list[_Column], y: np.ndarray, ok: np.ndarray, says: str) -> None:
    """Draw the measure as the color of points over two parameters."""
    up, across = columns
    panel.set_facecolor("0.85")
    _scale_x(panel, across)
    panel.set_ylabel(up.label)
    if up.names is not None:
        panel.set_yticks(range(len(up.names)), up.names)
    elif up.log:
        panel.set_yscale("log")
    image = panel.scatter(across.x[ok], up.x[ok], c=y[ok], norm=_norm(y), cmap="viridis", s=25)
    panel.plot(across.x[~ok], up.x[~ok], "x", color=BAD, markersize=6, label="not ok")
    if not ok.all():
        panel.legend(fontsize=8, loc="upper left", bbox_to_anchor=(0.0, -0.1), frameon=False)
    figure.colorbar(image, ax=panel, label=says)
