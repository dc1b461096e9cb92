"""Simulate many runs of scenes of one structure, eight to a vector; a lane whose run has ended takes the next one.

A vector runs for a segment of some ticks.  Then each lane whose run fell, diverged, reached its end or is no longer
wanted takes another run, with the numbers in which that run's scene differs.  What sampled controllers see is computed
for each tick beforehand, so that lanes may be at different times of different references.  A run's bits do not depend
on its lane, its neighbors or the segments it is cut into.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from ..core.compile.lanes import WIDTH
from ..core.integrate.rollout import OK
from ..core.step.context import Plan
from ..core.step.signals import Signals, sample_ticks
from .compiled_run import CompiledRun, RunInput, Vector, lane_zeros

SEGMENT = 250  # steps between changes of the runs: 0.25 s, of 25 ticks, at the usual 1 ms and 10 ms


class Source(Protocol):
    """Hand out runs to lanes and take their answers; called from several threads."""

    def take(self, wait: bool) -> Any | None:
        """Return the key of a run nobody has taken; None if there are no more or, unless `wait`, none at present."""

    def wanted(self, key: Any) -> bool:
        """Return whether the answer of a run is still needed."""

    def give(self, key: Any, answer: Any) -> None:
        """Accept the answer of a run."""

    def close(self) -> None:
        """Hand out no more runs, since a thread has failed."""


class Queue:
    """Hand out a known number of runs, whose keys are their indices."""

    def __init__(self, count: int) -> None:
        self.answers: list = [None] * count
        self._indices: Iterator[int] = iter(range(count))
        self._lock = threading.Lock()

    def take(self, wait: bool = True) -> int | None:
        """Return the next index, None if all have been taken."""
        with self._lock:
            return next(self._indices, None)

    def wanted(self, key: int) -> bool:
        """Return True: no run is given up."""
        return True

    def give(self, key: int, answer: Any) -> None:
        """Keep the answer of a run."""
        self.answers[key] = answer

    def close(self) -> None:
        """Hand out no more runs."""
        with self._lock:
            self._indices = iter(())


@dataclass
class _Occupant:
    """The run in a lane."""

    key: Any
    start: RunInput
    schedule: Plan
    done: int  # steps
    out: np.ndarray  # its records (samples, channels)


def segment_steps(plan: Plan) -> int:
    """Return the steps of a segment: whole ticks and samples, about `SEGMENT`; the whole run if that does not fit."""
    unit = math.lcm(plan.per_tick, plan.per_sample)
    steps = unit * max(1, SEGMENT // unit)
    return steps if steps < plan.steps else plan.steps


def run_lanes(
    compiled: CompiledRun,
    source: Source,
    begin: Callable[[Any], RunInput],
    end: Callable[[RunInput, np.ndarray, np.ndarray], Any],
) -> tuple[int, int]:
    """Simulate what the source hands out until there is no more.

    `begin(key)` returns what a run starts from, `end(start, y, out)` the answer from that, its final state and its
    records.  Returns how many lane-steps were used and how many there were.
    """
    plan, n, width = compiled.plan, compiled.scene.tree.n, len(compiled.channels)
    longest, used, there = segment_steps(plan), 0, 0
    all_records = lane_zeros((longest // plan.per_sample + 1, max(width, 1)))
    all_ticks = lane_zeros((-(-longest // plan.per_tick), n, 2))
    drive = lane_zeros((compiled.scene.inputs, 2))
    vector = Vector(compiled, Signals(None, drive, None, None, None, None, None, None), out=all_records)
    lanes: list[_Occupant | None] = [None] * WIDTH
    while _fill(lanes, source, begin, vector):
        busy = [(lane, held) for lane, held in enumerate(lanes) if held is not None]
        steps = min(longest, min(plan.steps - held.done for _, held in busy))
        ticks, records = all_ticks[: -(-steps // plan.per_tick)], all_records[: steps // plan.per_sample + 1]
        noise = None if busy[0][1].start.noise is None else lane_zeros(ticks.shape[:3])
        for lane, held in enumerate(lanes):
            if held is None:  # an idle lane repeats a busy one
                other, held = busy[0]
                vector.repeat(lane, other, held.start)
            ticks[..., lane] = sampled(held.start, held.schedule, held.done, len(ticks))
            if noise is not None and held.start.noise is not None:
                part = held.start.noise[held.done // plan.per_tick :][: len(noise)]
                noise[: len(part), ..., lane] = part
            vector.set_clock(held.schedule, held.done, lane)
        signals = vector.run.signals._replace(samples=ticks, noise=noise)
        new = [lane for lane, held in busy if held.done == 0 and compiled.begins(held.start.y)]
        seen = vector.at_start(signals=signals)[compiled.channels[compiled.late]] if new else None
        vector.step(records, plan=vector.run.plan._replace(steps=steps), signals=signals)
        if seen is not None:
            for lane in new:
                records[0, compiled.late, lane] = seen[:, lane]
        there += steps * WIDTH
        used += steps * len(busy)
        for lane, held in busy:
            first = held.done // plan.per_sample
            held.out[first : first + len(records)] = records[:, :width, lane]
            y = vector.y[:, lane]
            if y[compiled.scene.layout["status"]] != OK or held.done + steps == plan.steps:
                source.give(held.key, end(held.start, *_ended(held, y.copy(), first + len(records))))
                lanes[lane] = None
            held.done += steps
    return used, there


def sampled(start: RunInput, schedule: Plan, done: int, ticks: int) -> np.ndarray:
    """Return what sampled controllers see at the next ticks of a run after `done` steps (ticks, joints, 2)."""
    values = np.zeros((ticks, start.compiled.scene.tree.n, 2))
    sample_ticks(start.reference, schedule, done, values)
    return values


def _fill(lanes: list[_Occupant | None], source: Source, begin: Callable[[Any], RunInput], vector: Vector) -> bool:
    """Give a run to each lane that is free or whose own is no longer wanted; return False when there are no more."""
    for lane in range(WIDTH):
        held = lanes[lane]
        if held is not None and not source.wanted(held.key):
            lanes[lane] = None
    for lane in (lane for lane in range(WIDTH) if lanes[lane] is None):
        key = source.take(wait=lanes.count(None) == WIDTH)  # who has nothing else to do can wait
        if key is None:
            break
        start = begin(key)
        vector.put(lane, start)
        out = np.zeros((vector.compiled.samples, len(vector.compiled.channels)))
        lanes[lane] = _Occupant(key, start, start.compiled.schedule(start.y), 0, out)
    return lanes.count(None) < WIDTH


def _ended(held: _Occupant, y: np.ndarray, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the final state and the records of a run that has ended; later records repeat the last one."""
    layout, schedule = held.start.compiled.scene.layout, held.schedule
    if held.start.y[layout["status"]] == OK:  # y has the time of its last segment
        before = schedule.first + held.done
        y[layout["end_time"]] = schedule.offset + (before + round(y[layout["end_time"]] / schedule.h)) * schedule.h
    held.out[samples:] = held.out[samples - 1]
    return y, held.out
