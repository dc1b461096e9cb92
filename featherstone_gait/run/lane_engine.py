"""Many runs of scenes of one structure, eight to a vector; a lane whose run has ended takes the next one.

A vector runs for a segment of some ticks, then lanes whose run fell, diverged, reached its end or is no longer wanted
are handed over.  A run brings the numbers in which its scene differs from others into its lane.  What sampled
controllers see is worked out beforehand for each tick, so that lanes may be at different times of different references.
A run's bits do not depend on its lane, its neighbors or the segments it is cut into.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from ..core.compile.lanes import WIDTH, aligned
from ..core.integrate.rollout import OK, rollout_lanes
from ..core.step.context import Plan, Run
from ..core.step.signals import Signals, sample_ticks
from .prepared import Prepared, Start, lane_zeros, set_clock

SEGMENT = 250  # steps between changes of the runs: 0.25 s, of 25 ticks, at the usual 1 ms and 10 ms


class Source(Protocol):
    """What lanes get their work from and give the answers to; called from several threads."""

    def take(self, wait: bool) -> Any | None:
        """The key of a run nobody has taken.  None: there are no more, or, unless `wait`, none at present."""

    def wanted(self, key: Any) -> bool:
        """Whether a run taken is still to be finished."""

    def give(self, key: Any, answer: Any) -> None:
        """Take the answer of a run."""

    def close(self) -> None:
        """Hand out no more: a thread has failed."""


class Queue:
    """The source of a known number of runs; its keys are their indices."""

    def __init__(self, count: int) -> None:
        self.answers: list = [None] * count
        self._indices: Iterator[int] = iter(range(count))
        self._lock = threading.Lock()

    def take(self, wait: bool = True) -> int | None:
        with self._lock:
            return next(self._indices, None)

    def wanted(self, key: int) -> bool:
        return True

    def give(self, key: int, answer: Any) -> None:
        self.answers[key] = answer

    def close(self) -> None:
        with self._lock:
            self._indices = iter(())


@dataclass
class _Occupant:
    """The run in a lane."""

    key: Any
    start: Start
    course: Plan
    done: int  # steps
    out: np.ndarray  # its records (samples, channels)


def segment_steps(course: Plan) -> int:
    """Steps of a segment: whole ticks and whole samples, about `SEGMENT`; the whole run if that does not fit."""
    unit = math.lcm(course.per_tick, course.per_sample)
    steps = unit * max(1, SEGMENT // unit)
    return steps if steps < course.steps else course.steps


def run_lanes(
    ready: Prepared,
    source: Source,
    begin: Callable[[Any], Start],
    end: Callable[[Start, np.ndarray, np.ndarray], Any],
) -> tuple[int, int]:
    """Simulate what the source hands out until there is no more.

    `begin(key)` returns what a run starts from, `end(start, y, out)` the answer from that, its final state and its
    records.  Returns how many lane-steps were used and how many there were.
    """
    course, channels = ready.plan, ready.channels
    n, layout = ready.scene.tree.n, ready.scene.layout
    status = int(layout["status"])
    whole = ready.bound_in_lanes(Signals(None, lane_zeros((n, 2)), None, None, None, None, None, None))
    y = lane_zeros(len(whole.good))
    lanes: list[_Occupant | None] = [None] * WIDTH
    longest = segment_steps(course)
    whole_out = lane_zeros((longest // course.per_sample + 1, max(len(channels), 1)))
    whole_ticks = aligned((-(-longest // course.per_tick), n, 2, WIDTH))
    used = there = 0
    while _fill(lanes, source, begin, ready, y, whole):
        busy = [(lane, held) for lane, held in enumerate(lanes) if held is not None]
        steps = min(longest, min(course.steps - held.done for _, held in busy))
        ticks, out = whole_ticks[: -(-steps // course.per_tick)], whole_out[: steps // course.per_sample + 1]
        noise = None if busy[0][1].start.noise is None else aligned(ticks.shape)
        for lane in range(WIDTH):
            held = lanes[lane]
            if held is None:  # an idle lane repeats a busy one
                other, held = busy[0]
                y[:, lane], whole.good[:, lane] = y[:, other], whole.good[:, other]
                ready.put(whole, lane, held.start)
                if whole.signals.program is not None:
                    memory = whole.signals.program.memory
                    memory[..., lane] = memory[..., other]
            _sample(held, ticks, lane)
            _sample_noise(held.start.noise, held.done // course.per_tick, noise, lane)
            set_clock(whole, held.course, held.done, lane)
        signals = whole.signals._replace(samples=ticks, noise=noise)
        ready.call(rollout_lanes, whole._replace(plan=whole.plan._replace(steps=steps), signals=signals), y, out)
        there += steps * WIDTH
        used += steps * len(busy)
        for lane, held in busy:
            first = held.done // course.per_sample
            held.out[first : first + len(out)] = out[:, : len(channels), lane]
            if y[status, lane] != OK or held.done + steps == course.steps:
                source.give(held.key, end(held.start, *_ended(layout, held, y[:, lane], first + len(out))))
                lanes[lane] = None
            held.done += steps
    return used, there


def _fill(
    lanes: list[_Occupant | None],
    source: Source,
    begin: Callable[[Any], Start],
    ready: Prepared,
    y: np.ndarray,
    whole: Run,
) -> bool:
    """Give a run to each lane that is free or whose own is no longer wanted; False when there are no more."""
    for lane in range(WIDTH):
        held = lanes[lane]
        if held is not None and not source.wanted(held.key):
            lanes[lane] = None
    for lane in (lane for lane in range(WIDTH) if lanes[lane] is None):
        key = source.take(wait=lanes.count(None) == WIDTH)  # who has nothing else to do can wait
        if key is None:
            break
        start = begin(key)
        y[:, lane] = whole.good[:, lane] = start.y
        ready.put(whole, lane, start)
        out = np.zeros((ready.samples, len(ready.channels)))
        lanes[lane] = _Occupant(key, start, start.world.course(start), 0, out)
    return lanes.count(None) < WIDTH


def _sample(held: _Occupant, ticks: np.ndarray, lane: int) -> None:
    """What the controllers of one lane see in the coming segment."""
    values = np.empty(ticks.shape[:3])
    sample_ticks(held.start.reference, held.course, held.done, values)
    ticks[..., lane] = values


def _sample_noise(whole: np.ndarray | None, first: int, noise: np.ndarray | None, lane: int) -> None:
    """The noise of one lane in the coming segment."""
    if noise is not None and whole is not None:
        part = whole[first : first + len(noise)]
        noise[: len(part), ..., lane] = part


def _ended(layout: np.void, held: _Occupant, y: np.ndarray, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Final state and records of a run that has ended; the records after the end repeat the last one."""
    y, time, course = y.copy(), int(layout["end_time"]), held.course
    if held.start.y[layout["status"]] == OK:  # the time of its last segment, to which what was before is added
        y[time] = course.offset + (course.first + held.done + round(y[time] / course.h)) * course.h
    held.out[samples:] = held.out[samples - 1]
    return y, held.out
