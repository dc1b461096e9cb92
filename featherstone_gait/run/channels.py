"""What a run can record, told to people; the table itself is `CHANNELS` in `core/step/state.py`."""

from __future__ import annotations

from typing import Any

from ..base import deprecated
from ..core.step import state

OLD = {  # names until version 0.2
    "passes": "newton_iterations",
    "pace": "step_control",
    "end": "end_time",
    "increment": "velocity_change",
    "bristle": "tangential_deflection",
    "filtered": "filtered_speed",
    "bus": "bus_voltage",
    "goal": "profiled_reference",
}
OLD_LABELS = {"meter": "electrical_no_regeneration", "driver": "driver_loss"}


def current_name(name: Any) -> Any:
    """Return a channel's name, of an old name today's, with a DeprecationWarning; anything else as it is."""
    if isinstance(name, str) and name in OLD:
        deprecated.warn(f"channel {name!r}", repr(OLD[name]))
        return OLD[name]
    return name


def channel_table() -> str:
    """A line for each channel that `simulate` records: name, what it is, unit, and the names of its numbers."""
    width = max(map(len, state.RECORDABLE))
    return "\n".join(f"{name:{width}}  {_described(state.BY_NAME[name])}" for name in state.RECORDABLE)


def _described(channel: state.Channel) -> str:
    numbers = f": {', '.join(channel.labels)}" if channel.labels else ""
    return f"{channel.what} [{channel.unit}]{numbers}"


def column_of(name: str, label: str) -> int:
    """The place of a channel's number by its label.  Raises ValueError for a channel or label that there is not."""
    name = current_name(name)
    if label in OLD_LABELS:
        deprecated.warn(f"label {label!r}", repr(OLD_LABELS[label]))
        label = OLD_LABELS[label]
    if name not in state.BY_NAME:
        raise ValueError(f"there is no channel {name!r}; channels: {', '.join(state.BY_NAME)}")
    labels = state.BY_NAME[name].labels
    if labels.count(label) != 1:
        known = ", ".join(labels) or "none, it is one number each"
        raise ValueError(f"channel {name!r} has no one number {label!r}; labels: {known}")
    return labels.index(label)
