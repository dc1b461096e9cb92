"""Tell whether a gradient can be trusted where a run makes contacts, meets stops, or changes branches otherwise.

Within a fixed step an event has no time of its own.  As the parameters move it from one step to the next, the computed
cost winds about the true one, with a period of a step and an amplitude that falls with the square of the step; the
slopes of the windings, which the gradient gives, are off by the first power alone, and where an event takes few steps
by more than all of it.  A central difference that moves the events by several steps is the mean over the windings.

Parameters are moved in a few groups of derivatives of like size, so that none hides behind larger ones, and within a
group each by as much as changes the cost equally.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np

from .run_events import Event

GROUPS = 6  # of parameters
# Share of the largest part of the gradient below which parts are taken together: of sudden events, and of others, such
# as slipping and sticking, which bend the cost by little.
NOTABLE, NOTABLE_OF_BENDS = 1e-3, 1e-2
OFF = 0.1  # relative difference from which a gradient is doubtful
FIRST_WIDTH, LEAST_WIDTH, LARGEST_WIDTH = 1e-3, 1e-6, 3e-2  # of widths, relative to the parameters' scales
FINER = math.sqrt(10.0)  # factor between widths
FEW, MANY = 4, 13  # steps by which events move from one side to the other
SUDDEN = ("contact made", "contact broken", "bodies touch", "bodies part", "stop reached", "stop left")

Run: TypeAlias = Callable[[np.ndarray], tuple[float, Sequence[Event]]]  # of parameters that are moved


def doubts(name: str, slopes: np.ndarray, events: Sequence[Event], run: Run, timestep: float) -> str:
    """Return why a gradient is doubtful, empty where nothing speaks against it.

    slopes (n,): derivatives by parameters in units of their scales; events of the run; run: returns the cost and the
    events of a run whose parameters are moved by so many of their scales (n,).
    """
    if not events:
        return ""
    first = next((event for event in events if event.what in SUDDEN), events[0])
    notable = NOTABLE if first.what in SUDDEN else NOTABLE_OF_BENDS
    for group, least in _groups(np.abs(slopes), notable):
        step = np.zeros(len(slopes))
        step[group] = np.where(slopes[group] < 0.0, -1.0, 1.0) / np.maximum(np.abs(slopes[group]), least)
        step /= np.abs(step).max()
        difference, slope = _difference(step, run, timestep), float(np.sum(slopes * step))
        if not abs(difference - slope) <= OFF * max(abs(difference), slope, least):
            return (
                f"{name}: the gradient is doubtful: it takes the {len(events)} events of the run to stay in their "
                f"steps, from {first.time:.6g} s on, {first.what}: {first.where}; where parameters move them by some "
                f"steps, the cost grows at the rate {difference:.3g}, by the gradient {slope:.3g}: give a smaller "
                "timestep or softer contacts, or search without gradients; check(each=True) compares each derivative "
                "with differences"
            )
    return ""


def _groups(sizes: np.ndarray, notable: float) -> list[tuple[np.ndarray, float]]:
    """Return groups of numbers, those of the largest derivatives first, with the least size that counts in each."""
    largest = float(sizes.max(initial=0.0))
    moving = sizes >= notable * largest
    order = np.flatnonzero(moving)[np.argsort(-sizes[moving], kind="stable")]
    groups = [(one, notable * largest) for one in np.array_split(order, min(GROUPS, len(order)))] if largest else []
    return groups + [(np.flatnonzero(~moving), largest)] * bool(groups and not moving.all())


def _difference(step: np.ndarray, run: Run, timestep: float) -> float:
    """Return a central difference of the cost that moves the events by several steps; where they stay, the first."""
    width, way, found = FIRST_WIDTH, 0, math.nan
    while True:
        (up, after), (down, before) = (run(sign * width * step) for sign in (1.0, -1.0))
        shift = _shift(after, before, timestep)
        if shift > 0 or way == 0:
            found = (up - down) / (2.0 * width)
        turn = (shift < FEW) - (shift > MANY)
        other = width * FINER**turn
        if turn in (0, -way) or not LEAST_WIDTH <= other <= LARGEST_WIDTH:
            return found
        way, width = turn, other


def _shift(one: Sequence[Event], other: Sequence[Event], timestep: float) -> int:
    """Return by how many steps the events of two runs differ at most."""
    each, largest = [_times(events) for events in (one, other)], 0
    for key in {**each[0], **each[1]}:
        a, b = (times.get(key, []) for times in each)
        moved = [FEW] if len(a) != len(b) else [round(abs(x - y) / timestep) for x, y in zip(a, b)]
        largest = max([largest, *moved])
    return largest


def _times(events: Sequence[Event]) -> dict[tuple[str, str], list[float]]:
    found: dict[tuple[str, str], list[float]] = {}
    for event in events:
        found.setdefault((event.what, event.where), []).append(event.time)
    return found
