"""What a run can record, told to people; the table itself is `CHANNELS` in `core/step/state.py`."""

from __future__ import annotations

from ..core.step import state


def channel_table() -> str:
    """A line for each channel that `simulate` records: name, what it is, unit, and the names of its numbers."""
    width = max(map(len, state.RECORDABLE))
    return "\n".join(f"{name:{width}}  {_described(state.BY_NAME[name])}" for name in state.RECORDABLE)


def _described(channel: state.Channel) -> str:
    numbers = f": {', '.join(channel.labels)}" if channel.labels else ""
    return f"{channel.what} [{channel.unit}]{numbers}"


def column_of(name: str, label: str) -> int:
    """The place of a channel's number by its label.  Raises ValueError for a channel or label that there is not."""
    if name not in state.BY_NAME:
        raise ValueError(f"there is no channel {name!r}; channels: {', '.join(state.BY_NAME)}")
    labels = state.BY_NAME[name].labels
    if labels.count(label) != 1:
        known = ", ".join(labels) or "none, it is one number each"
        raise ValueError(f"channel {name!r} has no one number {label!r}; labels: {known}")
    return labels.index(label)
