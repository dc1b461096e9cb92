"""Many runs: in step in one vector, or lane by lane from a queue, over threads or an executor."""

from __future__ import annotations

import os
from collections.abc import Callable, Hashable, Iterable
from concurrent.futures import Executor, ThreadPoolExecutor
from typing import Any

import numpy as np

from ..core.compile.lanes import WIDTH
from ..scene.compile import CompiledScene
from .differing import course, structure
from .lane_engine import Queue, Source, run_lanes
from .prepared import Prepared, Start

BATCH = 32  # runs that an executor is given at a time

Result = tuple[np.ndarray, np.ndarray]  # final state and records


def run_all(starts: list[Start], executor: Executor | None) -> list[Result]:
    """Final state and records of each run, in its own scene; without an executor over all cores.

    Runs whose scenes have one structure share lanes.
    """
    results: list = [None] * len(starts)
    groups: list[tuple[Prepared, list[int]]] = []
    for ready, members in _families(starts):
        family = [starts[i] for i in members]
        if executor is None and _refills(ready.scene, family):
            for i, result in zip(members, _run_refilled(ready, family, os.cpu_count() or 1)):
                results[i] = result
        else:
            parts = _groups(ready.scene, family, _refills(ready.scene, family))
            groups.extend((ready, [members[k] for k in part]) for part in parts)
    batches = [(ready, [starts[i] for i in group]) for ready, group in groups]
    for (_, group), done in zip(groups, _run_groups(batches, executor)):
        for i, result in zip(group, done):
            results[i] = result
    return results


def _families(starts: list[Start]) -> list[tuple[Prepared, list[int]]]:
    """Indices of the runs whose scenes have one structure, and what is ready for the lanes of all of them."""
    if all(start.world is starts[0].world for start in starts):
        return [(starts[0].world, list(range(len(starts))))] if starts else []
    keys: dict[int, Hashable] = {}
    families: dict[Hashable, list[int]] = {}
    for i, start in enumerate(starts):
        if id(start.world) not in keys:
            keys[id(start.world)] = family(start.world)
        families.setdefault(keys[id(start.world)], []).append(i)
    found = []
    for members in families.values():
        worlds = list({id(starts[i].world): starts[i].world for i in members}.values())
        found.append((worlds[0] if worlds[0].scene.adaptive else worlds[0].among(worlds), members))
    return found


def family(world: Prepared) -> Hashable:
    """What runs have in common that share lanes; with error control none do."""
    if world.scene.adaptive:
        return None
    acts = world.controller and world.controller.kind
    return world.scene.integrator, course(world.plan), structure(world.scene.constants), world.channels.tobytes(), acts


def streams(scene: CompiledScene) -> bool:
    """Whether lanes may be at different times: nothing but the controllers' ticks depends on the time."""
    return scene.constants.push is None and scene.sampled and not scene.adaptive


def _refills(scene: CompiledScene, starts: list[Start]) -> bool:
    return streams(scene) and all(start.torques is None for start in starts) and len(starts) > 2


def _run_refilled(ready: Prepared, starts: list[Start], threads: int) -> list[Result]:
    """Every thread drives one vector and takes runs from the same queue."""
    queue, threads = Queue(len(starts)), min(threads, -(-len(starts) // WIDTH))
    drive_lanes(ready, queue, starts.__getitem__, lambda start, y, out: (y, out), threads)
    return queue.answers


def drive_lanes(ready: Prepared, source: Source, begin: Callable[[Any], Start], end: Callable, threads: int) -> float:
    """`run_lanes` in every thread; return the share of the lane-steps that were used."""

    def work(_: object = None) -> tuple[int, int]:
        try:
            return run_lanes(ready, source, begin, end)
        except BaseException:
            source.close()  # or the other threads would go on
            raise

    if threads == 1:
        counts = [work()]
    else:
        counts = _over_threads(ready, work, range(threads), threads)
    used, there = np.sum(counts, axis=0)
    return float(used / max(there, 1))


def _over_threads(ready: Prepared, work: Callable[[Any], Any], items: Iterable[Any], threads: int) -> list[Any]:
    """`work` of each item; what is raised here, by Ctrl-C too, ends all runs within a step."""
    with ThreadPoolExecutor(threads) as pool:
        try:
            return list(pool.map(work, items))
        except BaseException:
            ready.stop[0] = 1
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _run_groups(batches: list[tuple[Prepared, list[Start]]], executor: Executor | None) -> list[list[Result]]:
    """Groups of runs go to the executor, by default to threads."""
    if executor is None and len(batches) > 1:
        return _over_threads(batches[0][0], _run_group, batches, os.cpu_count() or 1)
    return list((executor.map if executor else map)(_run_group, batches))


def _groups(scene: CompiledScene, starts: list[Start], refills: bool) -> list[list[int]]:
    """Indices of the runs that go together; small rests alone."""
    alike: dict[tuple, list[int]] = {}
    for i, start in enumerate(starts):
        key: tuple = ()
        if not refills:
            signals = (start.reference, start.torques)
            key = (start.world.plan.lag, *(k and (k.times.tobytes(), k.period) for k in signals))
        key = (i,) if scene.adaptive else (*key, start.y[scene.layout["end_time"]])
        alike.setdefault(key, []).append(i)
    size = BATCH if refills else WIDTH
    groups = []
    for members in alike.values():
        for k in range(0, len(members), size):
            part = members[k : k + size]
            groups.extend([part] if len(part) > 2 else [[i] for i in part])
    return groups


def _run_group(batch: tuple[Prepared, list[Start]]) -> list[Result]:
    ready, starts = batch
    if _refills(ready.scene, starts):
        return _run_refilled(ready, starts, 1)
    return ready.run(starts)
