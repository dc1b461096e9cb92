"""Many runs of a scene: in step in one vector, or lane by lane from a queue, over threads or an executor."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Iterable
from concurrent.futures import Executor, ThreadPoolExecutor
from typing import Any

import numpy as np

from ..build.scene import CompiledScene
from ..core.compile.lanes import WIDTH
from .lane_engine import Queue, Source, run_lanes
from .prepared import Prepared, Start

BATCH = 32  # runs that an executor is given at a time

Result = tuple[np.ndarray, np.ndarray]  # final state and records


def run_all(ready: Prepared, starts: list[Start], executor: Executor | None) -> list[Result]:
    """Final state and records of each run; without an executor over all cores."""
    if executor is None and _refills(ready.scene, starts):
        return _run_refilled(ready, starts, os.cpu_count() or 1)
    return _run_grouped(ready, starts, executor)


def streams(scene: CompiledScene) -> bool:
    """Whether lanes may be at different times: nothing but the controllers' ticks depends on the time."""
    return scene.constants.push is None and scene.sampled and not scene.adaptive


def _refills(scene: CompiledScene, starts: list[Start]) -> bool:
    return streams(scene) and all(start.torques is None for start in starts) and len(starts) > 2


def _run_refilled(ready: Prepared, starts: list[Start], threads: int) -> list[Result]:
    """Every thread drives one vector and takes runs from the same queue."""
    queue, threads = Queue(len(starts)), min(threads, -(-len(starts) // WIDTH))
    drive_lanes(ready, queue, starts.__getitem__, lambda y, out: (y, out), threads)
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


def _run_grouped(ready: Prepared, starts: list[Start], executor: Executor | None) -> list[Result]:
    """Groups of runs go to the executor, by default to threads."""
    groups = _groups(ready.scene, starts, _refills(ready.scene, starts))
    work = functools.partial(_run_group, ready)
    batches = [[starts[i] for i in group] for group in groups]
    if executor is None and len(groups) > 1:
        done = _over_threads(ready, work, batches, os.cpu_count() or 1)
    else:
        done = list((executor.map if executor else map)(work, batches))
    results: list = [None] * len(starts)
    for group, members in zip(groups, done):
        for i, result in zip(group, members):
            results[i] = result
    return results


def _groups(scene: CompiledScene, starts: list[Start], refills: bool) -> list[list[int]]:
    """Indices of the runs that go together; small rests alone."""
    alike: dict[tuple, list[int]] = {}
    for i, start in enumerate(starts):
        key = () if refills else tuple(k and (k.times.tobytes(), k.period) for k in (start.reference, start.torques))
        key = (i,) if scene.adaptive else (*key, start.y[scene.layout["end"]])
        alike.setdefault(key, []).append(i)
    size = BATCH if refills else WIDTH
    groups = []
    for members in alike.values():
        for k in range(0, len(members), size):
            part = members[k : k + size]
            groups.extend([part] if len(part) > 2 else [[i] for i in part])
    return groups


def _run_group(ready: Prepared, starts: list[Start]) -> list[Result]:
    if _refills(ready.scene, starts):
        return _run_refilled(ready, starts, 1)
    return ready.run(starts)
