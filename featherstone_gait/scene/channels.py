"""Find channels by name, their labels, and their places in a state, which kernels read as one vector of numbers."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, TypeAlias, cast

import numpy as np

from ..base.brief import some
from ..core.step import state
from ..core.step.context import Scene
from ..core.step.state import ALL, BY_NAME, NONE, OWNERS, RECORDABLE, UNITS, Channel, several
from ..dynamics.tree import Tree

OF_SLIDERS = ("m", "m/s", "m/s²", "N")  # units of what turning joints have in rad, rad/s, rad/s² and N m
Share: TypeAlias = dict[str, Any]  # of a member in a scene: see `shares` in forest.py


def channel_table() -> str:
    """List the channels that `simulate` can record.

    Returns
    -------
    str
        A line for each channel: its name, what it is, unit, and the labels of its numbers.
    """
    width = max(map(len, RECORDABLE))
    rows = ((name, BY_NAME[name], ", ".join(BY_NAME[name].labels)) for name in RECORDABLE)
    return "\n".join(f"{name:{width}}  {one.what} [{one.unit}]{labels and f': {labels}'}" for name, one, labels in rows)


def unit_of(name: str, types: Iterable[str]) -> str:
    """Return the unit of a channel whose joints have these types; "A or B" if some turn and some slide."""
    types = list(types)
    unit, kinds = UNITS.get(name, ""), {kind == "prismatic" for kind in types}
    if name == "q" and "ball" in types:
        return "-" if set(types) == {"ball"} else f"{unit} or -"
    turning, _, sliding = unit.partition(" or ")
    if sliding not in OF_SLIDERS or len(kinds) != 1:
        return unit
    return sliding if kinds.pop() else turning


def column_of(name: str, label: str) -> int:
    """Find the index of a channel's number by its label.  Raises ValueError for an unknown channel or label."""
    if name not in BY_NAME:
        raise ValueError(f"there is no channel {name!r}; channels: {', '.join(BY_NAME)}")
    labels = BY_NAME[name].labels
    if labels.count(label) != 1:
        known = ", ".join(labels) or "none, as it is a single number"
        raise ValueError(f"channel {name!r} has no unique label {label!r}; its labels: {known}")
    return labels.index(label)


def joint_labels(info: Mapping[str, Any], name: str) -> list[str]:
    """Return the names of a run's joints, of the channel q those of its numbers, of loops' those of their rows."""
    if name in BY_NAME and BY_NAME[name].of == "row":
        return list(info.get("loop_rows") or ())
    return list(info.get("positions" if name == "q" and "positions" in info else "joints") or ())


def owned(channel: Channel, share: Share, size: int) -> np.ndarray:
    """Return the indices of the numbers of a channel, `size` in the scene, that are a member's."""
    part = OWNERS[channel.of].share
    if part == NONE:
        return np.arange(0)
    if part == ALL or not size:
        return np.arange(size)
    if channel.name == "q" and size == share.get("of_positions"):  # with quaternions, as recorded
        part = "positions"
    first, end = share.get(part, (0, 0)) if part != "base" else (share["base"], share["base"] + 1)
    if channel.of == "base" and share["fixed"]:
        return np.arange(0)
    if channel.of == "delay":  # all servos of a slot stand together
        slots = np.arange(size // share["of_joints"])
        return (slots[:, None] * share["of_joints"] + np.arange(first, end)).ravel()
    return np.arange(channel.width * first, channel.width * end)


class StateView(Mapping[str, np.ndarray]):
    """The channels of a state by name, as views into it: ``view.q[2] = 0.1`` changes the state.

    Channels are attributes and keys: ``view.base_q`` is ``view["base_q"]``.  A channel that the scene does not have is
    empty as an attribute, and no key.  Channels of several numbers for each joint or contact point get an axis, as
    ``view.energy`` (joints, numbers).

    Parameters
    ----------
    y
        States (..., size), as `initial_state` returns one.
    parts
        First and past-the-last index of each channel, as `CompiledScene.parts`.
    """

    def __init__(self, y: np.ndarray, parts: Mapping[str, tuple[int, int]]) -> None:
        self._y, self._parts = y, parts
        self._names = [name for name, (first, end) in parts.items() if end > first]

    def __getattr__(self, name: str) -> np.ndarray:
        if name.startswith("_"):
            raise AttributeError(name)
        if name not in self._parts:
            raise AttributeError(f"a state has no channel {name!r}; channels: {', '.join(self._parts)}")
        first, end = self._parts[name]
        values, channel = self._y[..., first:end], BY_NAME.get(name)
        if channel is not None and several(channel, end - first):
            return values.reshape(*values.shape[:-1], -1, channel.width)
        return values

    def __getitem__(self, name: str) -> np.ndarray:
        if name not in self._names:
            raise KeyError(f"this state has no channel {name!r}; channels: {', '.join(self._names)}")
        return getattr(self, name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self._names]

    def __repr__(self) -> str:
        return f"<state: {some(f'{name} {values.shape}' for name, values in self.items())}>"


def places_of(tree: Tree, constants: Scene) -> np.recarray:
    """Lay the parts of the state out."""
    has = () if constants.actuator is None else cast(Any, constants.actuator).PARTS
    contact, firmware, fed, pairs = constants.contact, constants.firmware, constants.supply is not None, constants.pairs
    return state.lay_out(
        {
            "base": tree.bases,
            "ball": 0 if tree.balls is None else len(tree.balls),
            "joint": tree.n,
            "servo": tree.n * ("servo" in has),
            "rotor": tree.n * ("rotor" in has),
            "point": 0 if contact is None else len(contact.points),
            "tree": 1 if tree.trees is None else len(tree.trees),
            "run": 1,
            "profile": tree.n * (firmware.profile is not None),
            "delay": 0 if firmware.delay is None else tree.n * firmware.delay.slots,
            "fed": tree.n * fed,
            "source": int(fed),
            "slot": 0 if pairs is None else int(pairs.slots[0]),
            "turning": 0 if pairs is None or pairs.turning is None else int(pairs.slots[0]),
            "pairs": int(pairs is not None),
            "tendon": 0 if constants.tendons is None else len(constants.tendons.table),
            "fluid": (constants.fluid is not None or constants.propellers is not None)
            * (1 if tree.trees is None else len(tree.trees)),
            "immersed": 0 if constants.fluid is None else len(constants.fluid.table),
            "loop": 0 if constants.loops is None else len(constants.loops.table),
            "row": 0 if constants.loops is None else int(constants.loops.rows[0]),
            "surface": 0 if constants.surfaces is None else len(constants.surfaces),
            "rolling": 0 if contact is None or contact.rolling is None else len(contact.points),
        }
    )
