"""Describe what a run can record; the table of channels is `CHANNELS` in `core/step/state.py`."""

from __future__ import annotations

from ..base import deprecated
from ..core.step import state
from ..scene.state_view import current_name

OLD_LABELS = {"meter": "electrical_no_regeneration", "driver": "driver_loss"}


def channel_table() -> str:
    """List the channels that `simulate` can record.

    Returns
    -------
    str
        A line for each channel: its name, what it is, unit, and the labels of its numbers.
    """
    width = max(map(len, state.RECORDABLE))
    return "\n".join(f"{name:{width}}  {_described(state.BY_NAME[name])}" for name in state.RECORDABLE)


def _described(channel: state.Channel) -> str:
    numbers = f": {', '.join(channel.labels)}" if channel.labels else ""
    return f"{channel.what} [{channel.unit}]{numbers}"


def column_of(name: str, label: str) -> int:
    """Find the index of a channel's number by its label.  Raises ValueError for an unknown channel or label."""
    name = current_name(name)
    if label in OLD_LABELS:
        deprecated.warn(f"label {label!r}", repr(OLD_LABELS[label]))
        label = OLD_LABELS[label]
    if name not in state.BY_NAME:
        raise ValueError(f"there is no channel {name!r}; channels: {', '.join(state.BY_NAME)}")
    labels = state.BY_NAME[name].labels
    if labels.count(label) != 1:
        known = ", ".join(labels) or "none, as it is a single number"
        raise ValueError(f"channel {name!r} has no unique label {label!r}; its labels: {known}")
    return labels.index(label)
