"""Plot channels beside a live page, with a line at the time that is shown."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from .style import BAD, COLORS

HEIGHT = 200  # of a plot [pixel]
MARGIN = 0.06  # above and below the lines, of their height
QUIET, LINES = "#8a8f98", "rgba(138, 143, 152, 0.2)"  # axes and grid, on light and dark ground
SIDES = {"left": COLORS[0], "right": COLORS[1]}  # where there are more lines than colors
ALL = "all"


class Plotted(NamedTuple):
    """The channels of a run, as of `recorded.channels_of`."""

    caption: str
    status: str
    channels: dict[str, Any]


class Chart:
    """A channel of all runs, one plot below the other; both choices can be changed in the page, under the lock."""

    def __init__(self, gui: Any, lock: Any, runs: Sequence[Plotted], names: Sequence[str], name: str) -> None:
        self.gui, self.lock, self.runs, self.t = gui, lock, runs, 0.0
        self.channel = gui.add_dropdown("channel", tuple(names), initial_value=name)
        self.column = gui.add_dropdown("of", self._columns(), initial_value=ALL)
        self.place = gui.add_folder(None)
        self.lines: list[_Lines] = []
        self.channel.on_update(lambda _: self._choose())
        self.column.on_update(lambda _: self._show())
        self._show()

    def draw(self, t: float) -> None:
        """Move the line to a time [s]."""
        self.t = t
        for lines in self.lines:
            lines.draw(t)

    def _columns(self) -> tuple[str, ...]:
        found = [run.channels[self.channel.value] for run in self.runs if self.channel.value in run.channels]
        return (ALL, *dict.fromkeys(label for channel in found for label in channel["labels"]))

    def _choose(self) -> None:
        with self.lock:
            self.column.options = self._columns()
            self._show()

    def _show(self) -> None:
        """Replace the plots by those of the chosen columns."""
        with self.lock, self.place:
            for lines in self.lines:
                lines.handle.remove()
            self.lines = []
            for run in self.runs:
                if self.channel.value not in run.channels:
                    continue
                channel = run.channels[self.channel.value]
                keep = [k for k, label in enumerate(channel["labels"]) if self.column.value in (ALL, label)]
                if keep:
                    failed = f" ({run.status})" * (run.status != "ok")
                    title = f"{run.caption}{failed}: {self.channel.value}"
                    self.lines.append(_Lines(self.gui, title, channel, keep, self.t))


class _Lines:
    """A plot of some columns.  The line at the time is a further series, which rises from below the axes only there."""

    def __init__(self, gui: Any, title: str, channel: dict[str, Any], keep: Sequence[int], t: float) -> None:
        self.times = np.array(channel["times"])
        self.values = channel["scale"] * np.array(channel["values"], dtype=float)[list(keep)]
        low, high = float(self.values.min()), float(self.values.max())
        margin = MARGIN * (high - low) or 1.0
        self.low, self.high = low - margin, high + margin
        labels = [channel["labels"][k] for k in keep]
        many = len(labels) > len(COLORS)
        colors = [SIDES.get(channel["sides"][k], QUIET) for k in keep] if many else COLORS
        axis = {"stroke": QUIET, "grid": {"stroke": LINES, "width": 1}, "ticks": {"stroke": LINES, "width": 1}}
        points = {"show": False}
        series = [
            {"label": label, "stroke": color, "width": 1.3, "points": points}
            for label, color in zip(labels, colors)
        ]  # fmt: skip
        self.handle = gui.add_uplot(
            self._data(t),
            ({"label": "t [s]"}, *series, {"label": "shown", "stroke": BAD, "width": 1.0, "points": points}),
            title=f"{title} [{channel['unit']}]" if channel["unit"] else title,
            scales={"x": {"time": False}, "y": {"range": (self.low, self.high)}},
            axes=(axis | {"size": 36}, axis | {"size": 52}),
            legend={"show": not many},
            height=HEIGHT,
        )

    def draw(self, t: float) -> None:
        """Move the line to a time [s]."""
        self.handle.data = self._data(t)

    def _data(self, t: float) -> tuple[np.ndarray, ...]:
        """Insert the time `t` three times into times and columns, and add the line there."""
        t = min(max(t, self.times[0]), self.times[-1])
        k = int(np.searchsorted(self.times, t))
        now = [np.interp(t, self.times, column) for column in self.values]
        line = np.full(len(self.times) + 3, 2.0 * self.low - self.high)
        line[k + 1] = self.high
        columns = (np.insert(column, k, [value] * 3) for column, value in zip(self.values, now))
        return np.insert(self.times, k, [t] * 3), *columns, line
