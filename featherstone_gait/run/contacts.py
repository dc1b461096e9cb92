"""Read contact between bodies from a run: of two of them over time, and of each pair of links for tables and plots.

The channels of pairs are of slots, whose owner, the channel `pair`, changes with time.  Here they are summed by owner,
slot after slot in their order, so that the sums do not depend on which slots a pair had.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ..base.arguments import shown
from ..base.brief import brief
from ..base.flaws import quoted
from ..core.effects.pair import FAR
from ..core.step.state import BY_NAME
from ..model.placed import SEPARATOR

NEEDED = ("pair", "pair_force", "pair_normal_force", "pair_gap")
BY_PAIR = NEEDED[1:]  # channels that are one quantity of two links: sums, of gaps the least


@dataclass(frozen=True, eq=False)
class ContactHistory:
    """Contact of one body with others over time, as `Trajectory.contact` returns it.

    Attributes
    ----------
    time : ndarray, shape (samples,)
        [s].
    force : ndarray, shape (samples, 3)
        Force on the first body by all that it was asked for with, in world axes [N].
    normal_force : ndarray, shape (samples,)
        Sum of the normal forces of all points [N].
    gap : ndarray, shape (samples,)
        Least gap of the surfaces, negative where they overlap [m]; infinite where nothing is near.
    """

    time: np.ndarray
    force: np.ndarray
    normal_force: np.ndarray
    gap: np.ndarray

    __repr__ = brief

    @property
    def impulse(self) -> np.ndarray:
        """Impulse on the first body since the first sample (samples, 3), the trapezoidal sum of the force [N s].

        Its error falls with the square of the time between records, of which a collision needs some tens.
        """
        steps = 0.5 * np.diff(self.time)[:, None] * (self.force[1:] + self.force[:-1])
        return np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])

    @property
    def touching(self) -> np.ndarray:
        """Whether some point pushes at each sample (samples,) bool."""
        return self.normal_force > 0.0


def contact(self: Any, first: str, second: str | None = None) -> ContactHistory:
    """Return the contact of two bodies of a scene with `pairs` over time.

    Parameters
    ----------
    first, second : str
        "name/link", or "name" for all links of a robot, object or obstacle.  Without a second one all that the first
        can touch, except itself and the contact points on the ground.

    Returns
    -------
    ContactHistory
        Forces are those on the first.

    Raises
    ------
    ValueError
        If the two cannot touch in this run, or one of the channels pair, pair_force, pair_normal_force and pair_gap was
        not recorded.
    """
    names = names_of(self.info)
    signs = _signs(names, first, second)
    missing = [name for name in NEEDED if name not in self.channels]
    if missing:
        raise ValueError(f"contact: {', '.join(missing)} was not recorded: simulate(record=[..., {quoted(NEEDED)}])")
    owners = self.channels["pair"]
    sign = np.array([0.0, *signs])[owners.astype(int)]  # of each slot (samples, slots)
    force = np.zeros((len(owners), 3))
    normal, gap = np.zeros(len(owners)), np.full(len(owners), np.inf)
    for k in range(owners.shape[1]):
        of = sign[:, k] != 0.0
        force[of] += sign[of, k, None] * self.channels["pair_force"][of, k]
        normal[of] += self.channels["pair_normal_force"][of, k]
        gap[of] = np.minimum(gap[of], _gaps(self.channels["pair_gap"][of, k]))
    return ContactHistory(self.channels["time"], force, normal, gap)


def touched(self: Any) -> tuple[tuple[str, str], ...]:
    """Return which links touched each other in a run.

    Returns
    -------
    tuple of (str, str)
        Pairs of links that pushed each other at some sample, in the order of `CompiledScene.pairs`.

    Raises
    ------
    ValueError
        If the scene has no pairs, or pair and pair_normal_force were not recorded.
    """
    names = names_of(self.info)
    missing = [name for name in ("pair", "pair_normal_force") if name not in self.channels]
    if missing:
        raise ValueError(f"touched: {', '.join(missing)} was not recorded: name it in simulate(record=...)")
    owners = self.channels["pair"][self.channels["pair_normal_force"] > 0.0]
    return tuple(dict.fromkeys(names[k] for k in np.unique(owners.astype(int)) - 1))


class PairTable(NamedTuple):
    """A channel of slots by pairs of links."""

    labels: list[str]
    values: np.ndarray  # (samples, pairs, ...)


def by_pair(channels: Mapping[str, np.ndarray], info: Mapping[str, Any], name: str) -> PairTable | None:
    """Return a channel of pairs for each two links that are near each other at some sample; None for other channels.

    Also None where the channel `pair` was not recorded, so that nobody knows whose the slots were.
    """
    if name not in BY_PAIR or "pair" not in channels or not info.get("pairs"):
        return None
    owners, values = channels["pair"].astype(int), channels[name]
    links = [*dict.fromkeys(map(tuple, info["pairs"]))]
    of_row = np.array([-1, *(links.index(tuple(pair)) for pair in info["pairs"])])
    number = of_row[owners]  # of the links (samples, slots)
    near = [k for k in range(len(links)) if (number == k).any()]
    least = name == "pair_gap"
    table = np.full((len(owners), len(near), *values.shape[2:]), np.inf if least else 0.0)
    for column, k in enumerate(near):
        for slot in range(owners.shape[1]):
            of = number[:, slot] == k
            if least:
                table[of, column] = np.minimum(table[of, column], _gaps(values[of, slot]))
            else:
                table[of, column] += values[of, slot]
    return PairTable([" - ".join(links[k]) for k in near], table)


def seen_from(run: Any, name: str) -> tuple[dict[str, np.ndarray], list[tuple[str, str]]]:
    """Return the channels of slots, and the links of each row of the table, as one member of a scene sees them.

    Slots of pairs that are not the member's have no owner and no force.  In each pair of its own the member's link
    comes first, without its name, so that forces are those on it.
    """
    if not run.info.get("pairs") or "pair" not in run.channels:
        return {}, []
    names = names_of(run.info)
    first = np.array([False, *(_is(a, name) for a, _ in names)])
    second = np.array([False, *(_is(b, name) for _, b in names)])
    owners = run.channels["pair"].astype(int)
    own, turned = (first | second)[owners], (second & ~first)[owners]
    channels = {key: values for key, values in run.channels.items() if is_of_slots(key)}
    channels["pair"] = np.where(own, owners, 0)
    if "pair_force" in channels:
        sign = np.where(turned, -1.0, np.where(own, 1.0, 0.0))
        channels["pair_force"] = sign[..., None] * channels["pair_force"]
    pairs = [(b, a) if _is(b, name) and not _is(a, name) else (a, b) for a, b in names]
    return channels, [(own.removeprefix(name + SEPARATOR), other) for own, other in pairs]


def is_of_slots(name: str) -> bool:
    """Return whether a channel is of the slots of pairs."""
    channel = BY_NAME.get(name)
    return channel is not None and channel.of in ("slot", "turning")


def _gaps(values: np.ndarray) -> np.ndarray:
    """Return gaps that are infinite where a slot has no point."""
    return np.where(values < FAR, values, np.inf)


def names_of(info: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return the links of each row of the table of pairs.  Raises ValueError for a run without."""
    if not info.get("pairs"):
        who = info.get("robot", "the run")
        raise ValueError(f"{who}: no bodies touch each other in this run; compile the scene with pairs='all'")
    return [(str(one), str(two)) for one, two in info["pairs"]]


def _signs(names: Sequence[tuple[str, str]], first: str, second: str | None) -> list[float]:
    """Return 1 for each row whose force is that on the first body, -1 where it is that on the second, 0 for others."""
    known = list(dict.fromkeys(link for pair in names for link in pair))
    for what, name in (("first", first), ("second", second)):
        if name is not None and not any(_is(link, name) for link in known):
            bodies = dict.fromkeys(link.partition(SEPARATOR)[0] for link in known)
            raise ValueError(f"contact: {what} is {shown(name)}, which touches nothing here; bodies: {quoted(bodies)}")
    signs = []
    for a, b in names:
        forward = _is(a, first) and not _is(b, first) if second is None else _is(a, first) and _is(b, second)
        backward = _is(b, first) and not _is(a, first) if second is None else _is(b, first) and _is(a, second)
        signs.append(float(forward) - float(backward))
    if not any(signs):
        partners = [b if _is(a, first) else a for a, b in names if _is(a, first) or _is(b, first)]
        raise ValueError(
            f"contact: {shown(first)} and {shown(second)} cannot touch in this run; {first} can touch "
            f"{quoted(dict.fromkeys(partners))}"
        )
    return signs


def _is(link: str, name: Any) -> bool:
    return link == name or (isinstance(name, str) and link.startswith(name + SEPARATOR))
