"""A figure of panels side by side as one of panels below each other, for a telephone."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.legend import Legend

WIDTH = 4.2  # [inch], at which the type of a wide figure can be read on 375 pixels
HEIGHT = 2.6  # of a panel at least [inch]
MOST = 8  # panels: more below each other are no figure
WORDS = 45  # letters that stand beside each other under a panel
LETTERS = 22  # that a column of a legend holds


def stack(figure: Figure) -> bool:
    """Lay the panels of a figure out in one column, `WIDTH` wide; return False if there are too many."""
    places: Any = {axes: spec for axes in figure.axes if (spec := axes.get_subplotspec()) is not None}
    if not 0 < len(places) <= MOST:
        return False
    _, tall = figure.get_size_inches()
    rows = max(spec.get_gridspec().nrows for spec in places.values())
    labels = {spec.rowspan.start: axes.get_ylabel() for axes, spec in [*places.items()][::-1] if axes.get_ylabel()}
    grid = figure.add_gridspec(len(places), 1)
    for k, (axes, spec) in enumerate(places.items()):
        axes.set_subplotspec(grid[k])
        axes.tick_params(labelleft=True, labelbottom=True)
        axes.set_ylabel(axes.get_ylabel() or labels.get(spec.rowspan.start, ""))
        if sum(len(label.get_text()) for label in axes.get_xticklabels()) > WORDS:
            axes.tick_params(axis="x", labelrotation=30)
            for label in axes.get_xticklabels():
                label.set(ha="right", rotation_mode="anchor")
        legend: Any = axes.get_legend()
        if legend is not None and legend._ncols > 1:
            _again(axes, legend, "best")
    lines = sum(_again(figure, legend, "outside lower center") for legend in [*figure.legends])
    height = max(HEIGHT, 0.75 * tall / rows) if len(places) > 1 else min(tall, 1.1 * WIDTH)
    figure.set_size_inches(WIDTH, height * len(places) + 0.22 * lines)
    return True


def _again(owner: Any, legend: Legend, place: str) -> int:
    """Redraw the legend of a figure or of axes in one or two columns; return its number of lines."""
    names, handles = [text.get_text() for text in legend.get_texts()], legend.legend_handles
    columns = 2 if max(map(len, names)) <= LETTERS else 1
    legend.remove()
    owner.legend(handles, names, loc=place, ncols=columns, frameon=False, fontsize=7)
    return -(-len(names) // columns)
