"""Many runs of one scene, eight to a vector; a lane whose run has ended takes the next one.

A vector runs for a segment of some ticks, then lanes whose run fell, diverged or reached its end are handed over.  What
sampled controllers see is worked out beforehand for each tick, so that lanes may be at different times of different
references.  A run's bits do not depend on its lane, its neighbours or the segments it is cut into.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from .core import rollout
from .core.knots import Knots, Signals, sample_ticks
from .core.lanes import WIDTH, aligned

SEGMENT = 25  # ticks between changes of the runs: 0.25 s at the usual 10 ms


class Queue:
    """Indices handed out once each, to any number of threads."""

    def __init__(self, count: int):
        self._indices: Iterator[int] = iter(range(count))
        self._lock = threading.Lock()

    def next(self) -> int | None:
        with self._lock:
            return next(self._indices, None)


class _Occupant(NamedTuple):
    """The run in a lane."""

    index: int
    done: int  # steps
    out: np.ndarray  # its records (samples, channels)


def segment_steps(course: rollout.Plan) -> int:
    """Steps of a segment: whole ticks and whole samples, about `SEGMENT` ticks; the whole run if that does not fit."""
    unit = math.lcm(course.per_tick, course.per_sample)
    steps = unit * max(1, SEGMENT * course.per_tick // unit)
    return steps if steps < course.steps else course.steps


def run_lanes(
    scene,
    course: rollout.Plan,
    channels: np.ndarray,
    runs: Sequence,
    queue: Queue,
    scratch: rollout.Scratch,
    finish: Callable[[int, np.ndarray, np.ndarray], None],
) -> tuple[int, int]:
    """Take runs (y, reference, noise) from the queue until it is empty; call finish(index, y, out) for each.

    scratch: lane arrays of the scene.  Returns how many lane-steps were used and how many there were.
    """
    n, size = scene.tree.n, len(scratch.good)
    y, drive = aligned((size, WIDTH)), aligned((n, 2, WIDTH))
    lanes: list[_Occupant | None] = [None] * WIDTH
    samples = course.steps // course.per_sample + 1
    longest = segment_steps(course)
    used = there = 0
    while True:
        for lane in range(WIDTH):
            if lanes[lane] is None and (index := queue.next()) is not None:
                y[:, lane] = scratch.good[:, lane] = runs[index].y
                lanes[lane] = _Occupant(index, 0, np.zeros((samples, len(channels))))
        busy = [lane for lane in range(WIDTH) if lanes[lane] is not None]
        if not busy:
            return used, there
        steps = min(longest, min(course.steps - lanes[lane].done for lane in busy))
        ticks = aligned((-(-steps // course.per_tick), n, 2, WIDTH))
        for lane in range(WIDTH):
            held = lanes[lane if lanes[lane] is not None else busy[0]]
            if lanes[lane] is None:  # an idle lane repeats a busy one
                y[:, lane], scratch.good[:, lane] = y[:, busy[0]], scratch.good[:, busy[0]]
            _sample(runs[held.index].reference, held.done, course, ticks, lane)
        out = aligned((steps // course.per_sample + 1, max(len(channels), 1), WIDTH))
        noise = None if runs[lanes[busy[0]].index].noise is None else aligned(ticks.shape)
        for lane in range(WIDTH):
            held = lanes[lane if lanes[lane] is not None else busy[0]]
            _sample_noise(runs[held.index].noise, held.done // course.per_tick, noise, lane)
        signals = Signals(None, drive, None, None, None, ticks, noise, None)
        part = course._replace(steps=steps)
        rollout.rollout_lanes(scene.constants, scene.offsets, part, signals, y, scratch, channels, out)
        there += steps * WIDTH
        for lane in busy:
            used += steps
            lanes[lane] = _after(scene, course, lanes[lane], steps, y[:, lane], out[:, : len(channels), lane], finish)


def _sample(reference: Knots, done: int, course: rollout.Plan, ticks: np.ndarray, lane: int) -> None:
    """What the controllers of one lane see in the coming segment."""
    values = np.empty(ticks.shape[:3])
    sample_ticks(reference, course.per_tick, course.h, course.lag, done // course.per_tick, values)
    ticks[..., lane] = values


def _sample_noise(whole, first: int, noise, lane: int) -> None:
    """The noise of one lane in the coming segment."""
    if noise is not None:
        part = whole[first : first + len(noise)]
        noise[: len(part), ..., lane] = part


def _after(scene, course, held: _Occupant, steps: int, y, out, finish) -> _Occupant | None:
    """Keep the records of a segment; hand over a run that has ended."""
    first = held.done // course.per_sample
    held.out[first : first + len(out)] = out
    failed = y[scene.layout["status"]] != rollout.OK
    if not failed and held.done + steps < course.steps:
        return held._replace(done=held.done + steps)
    y = y.copy()
    end = int(scene.layout["end"])
    y[end] = (held.done + round(y[end] / course.h)) * course.h
    held.out[first + len(out) :] = out[-1]
    finish(held.index, y, held.out)
    return None
