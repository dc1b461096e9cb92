"""Many runs of one scene, eight to a vector; a lane whose run has ended takes the next one.

A vector runs for a segment of some ticks, then lanes whose run fell, diverged, reached its end or is no longer wanted
are handed over.  What sampled controllers see is worked out beforehand for each tick, so that lanes may be at different
times of different references.  A run's bits do not depend on its lane, its neighbours or the segments it is cut into.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from .core import rollout
from .core.knots import Knots, Signals, sample_ticks
from .core.lanes import WIDTH, aligned

SEGMENT = 25  # ticks between changes of the runs: 0.25 s at the usual 10 ms


class Source(Protocol):
    """What lanes get their work from and give the answers to; called from several threads."""

    def take(self, wait: bool) -> Any | None:
        """The key of a run nobody has taken.  None: there are no more, or, unless `wait`, none at present."""

    def wanted(self, key) -> bool:
        """Whether a run taken is still to be finished."""

    def give(self, key, answer) -> None:
        """Take the answer of a run."""

    def close(self) -> None:
        """Hand out no more: a thread has failed."""


class Queue:
    """The source of a known number of runs; its keys are their indices."""

    def __init__(self, count: int):
        self.answers: list = [None] * count
        self._indices: Iterator[int] = iter(range(count))
        self._lock = threading.Lock()

    def take(self, wait: bool = True) -> int | None:
        with self._lock:
            return next(self._indices, None)

    def wanted(self, key: int) -> bool:
        return True

    def give(self, key: int, answer) -> None:
        self.answers[key] = answer

    def close(self) -> None:
        with self._lock:
            self._indices = iter(())


@dataclass
class _Occupant:
    """The run in a lane."""

    key: Any
    run: Any
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
    source: Source,
    begin: Callable[[Any], Any],
    end: Callable[[np.ndarray, np.ndarray], Any],
    scratch: rollout.Scratch,
) -> tuple[int, int]:
    """Simulate what the source hands out until there is no more.

    `begin(key)` returns a run (y, reference, noise), `end(y, out)` the answer from its final state and records;
    scratch: lane arrays of the scene.  Returns how many lane-steps were used and how many there were.
    """
    n, size, status = scene.tree.n, len(scratch.good), int(scene.layout["status"])
    y, drive = aligned((size, WIDTH)), aligned((n, 2, WIDTH))
    lanes: list[_Occupant | None] = [None] * WIDTH
    longest = segment_steps(course)
    whole_out = aligned((longest // course.per_sample + 1, max(len(channels), 1), WIDTH))
    whole_ticks = aligned((-(-longest // course.per_tick), n, 2, WIDTH))
    used = there = 0
    while _fill(lanes, source, begin, course, channels, y, scratch):
        busy = [lane for lane in range(WIDTH) if lanes[lane] is not None]
        steps = min(longest, min(course.steps - lanes[lane].done for lane in busy))
        ticks, out = whole_ticks[: -(-steps // course.per_tick)], whole_out[: steps // course.per_sample + 1]
        noise = None if lanes[busy[0]].run.noise is None else aligned(ticks.shape)
        for lane in range(WIDTH):
            held = lanes[lane]
            if held is None:  # an idle lane repeats a busy one
                held = lanes[busy[0]]
                y[:, lane], scratch.good[:, lane] = y[:, busy[0]], scratch.good[:, busy[0]]
            _sample(held.run.reference, held.done, course, ticks, lane)
            _sample_noise(held.run.noise, held.done // course.per_tick, noise, lane)
        signals = Signals(None, drive, None, None, None, ticks, noise, None)
        part = course._replace(steps=steps)
        rollout.rollout_lanes(scene.constants, scene.offsets, part, signals, y, scratch, channels, out)
        there += steps * WIDTH
        used += steps * len(busy)
        for lane in busy:
            held, first = lanes[lane], lanes[lane].done // course.per_sample
            held.out[first : first + len(out)] = out[:, : len(channels), lane]
            if y[status, lane] != rollout.OK or held.done + steps == course.steps:
                source.give(held.key, end(*_ended(scene, course, held, y[:, lane], first + len(out))))
                lanes[lane] = None
            held.done += steps
    return used, there


def _fill(lanes: list, source: Source, begin, course: rollout.Plan, channels: np.ndarray, y, scratch) -> bool:
    """Give a run to each lane that is free or whose own is no longer wanted; False when there are no more."""
    for lane in range(WIDTH):
        if lanes[lane] is not None and not source.wanted(lanes[lane].key):
            lanes[lane] = None
    samples = course.steps // course.per_sample + 1
    for lane in (lane for lane in range(WIDTH) if lanes[lane] is None):
        key = source.take(wait=lanes.count(None) == WIDTH)  # who has nothing else to do can wait
        if key is None:
            break
        run = begin(key)
        y[:, lane] = scratch.good[:, lane] = run.y
        lanes[lane] = _Occupant(key, run, 0, np.zeros((samples, len(channels))))
    return lanes.count(None) < WIDTH


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


def _ended(scene, course: rollout.Plan, held: _Occupant, y: np.ndarray, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Final state and records of a run that has ended; the records after the end repeat the last one."""
    y, time = y.copy(), int(scene.layout["end"])
    y[time] = (held.done + round(y[time] / course.h)) * course.h
    held.out[samples:] = held.out[samples - 1]
    return y, held.out
