"""Simulate many runs: in step in one vector, or lane by lane from a queue, over threads or an executor."""

from __future__ import annotations

import os
from collections.abc import Callable, Hashable, Iterable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from typing import Any

import numpy as np

from ..core.compile.lanes import WIDTH
from ..core.integrate.rollout import NEVER
from ..scene.compile import CompiledScene
from .compiled_run import CompiledRun, RunInput
from .lane_constants import structure
from .lane_engine import Queue, Source, run_lanes
from .prepare import each_once

BATCH = 32  # runs given to an executor at a time

Result = tuple[np.ndarray, np.ndarray]  # final state and records


def run_all(starts: list[RunInput], executor: Executor | None) -> list[Result]:
    """Return the final state and the records of each run, in its own scene; without an executor over all cores.

    Runs whose scenes have one structure share lanes.
    """
    results: list = [None] * len(starts)
    groups: list[tuple[CompiledRun, list[int]]] = []
    for compiled, members in families([start.compiled for start in starts]):
        family = [starts[i] for i in members]
        refills = _refills(compiled.scene, family)
        if executor is None and refills:
            for i, result in zip(members, _run_refilled(compiled, family, os.cpu_count() or 1)):
                results[i] = result
        else:
            groups.extend((compiled, [members[k] for k in part]) for part in _groups(compiled.scene, family, refills))
    batches = [(compiled, [starts[i] for i in group]) for compiled, group in groups]
    if executor is None and len(batches) > 1:
        answers = over_threads(batches[0][0], _run_group, batches, os.cpu_count() or 1)
    else:
        answers = list((executor.map if executor else map)(_run_group, batches))
    for (_, group), done in zip(groups, answers):
        for i, result in zip(group, done):
            results[i] = result
    return results


def families(runs: Sequence[CompiledRun]) -> list[tuple[CompiledRun, list[int]]]:
    """Group runs whose scenes have one structure: what is compiled for the lanes of all of them, and their indices."""
    members: dict[Hashable, list[int]] = {}
    alike = all(run is runs[0] for run in runs)  # needs no comparison, which takes a quarter of a short call
    for i, key in enumerate([None] * len(runs) if alike else each_once(family, runs)):
        members.setdefault(key, []).append(i)
    found = []
    for indices in members.values():
        own = list({id(runs[i]): runs[i] for i in indices}.values())
        found.append((own[0] if own[0].scene.adaptive else own[0].among(own), indices))
    return found


def family(run: CompiledRun) -> Hashable:
    """Return what runs that share lanes have in common; with error control none do."""
    scene = run.scene
    if scene.adaptive:
        return scene.places.tobytes()
    plan = run.plan._replace(lag=0.0, min_height=float(run.plan.min_height > NEVER))  # in which lanes may differ
    controller = run.controller and run.controller.kind
    return scene.integrator, plan, structure(scene.constants), run.channels.tobytes(), controller


def streams(scene: CompiledScene) -> bool:
    """Return whether lanes may be at different times: nothing but the controllers' ticks depends on the time."""
    return scene.constants.push is None and scene.sampled and not scene.adaptive


def _refills(scene: CompiledScene, starts: list[RunInput]) -> bool:
    return streams(scene) and all(start.torques is None for start in starts) and len(starts) > 2


def _run_refilled(compiled: CompiledRun, starts: list[RunInput], threads: int) -> list[Result]:
    """Drive one vector in each thread; all threads take runs from the same queue."""
    queue, threads = Queue(len(starts)), min(threads, -(-len(starts) // WIDTH))
    drive_lanes(compiled, queue, starts.__getitem__, lambda start, y, out: (y, out), threads)
    return queue.answers


def drive_lanes(
    compiled: CompiledRun, source: Source, begin: Callable[[Any], RunInput], end: Callable, threads: int
) -> float:
    """Call `run_lanes` in every thread; return the share of the lane-steps that were used."""

    def work(_: object = None) -> tuple[int, int]:
        try:
            return run_lanes(compiled, source, begin, end)
        except BaseException:
            source.close()  # or the other threads would go on
            raise

    counts = [work()] if threads == 1 else over_threads(compiled, work, range(threads), threads)
    used, there = np.sum(counts, axis=0)
    return float(used / max(there, 1))


def over_threads(compiled: CompiledRun, work: Callable[[Any], Any], items: Iterable[Any], threads: int) -> list[Any]:
    """Work through the items in threads; an exception here, Ctrl-C too, ends all runs within a step."""
    with ThreadPoolExecutor(threads) as pool:
        try:
            return list(pool.map(work, items))
        except BaseException:
            compiled.stop[0] = 1
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _groups(scene: CompiledScene, starts: list[RunInput], refills: bool) -> list[list[int]]:
    """Return the indices of the runs that go together; of a rest of one or two each goes alone."""
    alike: dict[tuple, list[int]] = {}
    for i, start in enumerate(starts):
        key: tuple = ()
        if not refills:
            signals = (start.reference, start.torques)
            key = (start.compiled.plan.lag, *(k and (k.times.tobytes(), k.period) for k in signals))
        key = (i,) if scene.adaptive else (*key, start.y[scene.layout["end_time"]])
        alike.setdefault(key, []).append(i)
    size = BATCH if refills else WIDTH
    groups = []
    for members in alike.values():
        for k in range(0, len(members), size):
            part = members[k : k + size]
            groups.extend([part] if len(part) > 2 else [[i] for i in part])
    return groups


def _run_group(batch: tuple[CompiledRun, list[RunInput]]) -> list[Result]:
    compiled, starts = batch
    return _run_refilled(compiled, starts, 1) if _refills(compiled.scene, starts) else compiled.run(starts)
