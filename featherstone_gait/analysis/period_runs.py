"""Run a scene over one controller period from many states, and with moved inputs, in lanes and threads."""

from __future__ import annotations

import functools
import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import ArrayLike

from ..core.compile.jit import direct
from ..core.compile.lanes import WIDTH, aligned
from ..core.integrate.rollout import OK
from ..core.step.signals import Signals
from ..run.compiled_run import CompiledRun, Vector, in_lanes, knots_in_lanes, lane_zeros
from ..run.lane_engine import sampled
from ..run.reference import Reference
from ..run.start import initial_state
from ..run.status import OF_CODE
from ..run.trajectory import Trajectory
from ..scene.compile import CompiledScene

KEPT = 2**17  # numbers of signals (1 MiB) up to which a workspace is left to later calls
BRIEF = 5e4  # steps of vectors by velocities: some 10 ms, for which no thread is started


class PeriodRuns:
    """Map states and inputs to states at the end of the period."""

    def __init__(
        self,
        compiled: CompiledRun,
        state: ArrayLike | Trajectory | None,
        reference: Reference | None,
        tau: Reference | None,
        inputs: tuple[str, ...],
        threads: int | None,
    ) -> None:
        self.compiled, self.inputs, self.threads, self.scene = compiled, inputs, threads, compiled.scene
        self.lanes = 1 if self.scene.adaptive else WIDTH
        self.start = compiled.start(initial_state(self.scene) if state is None else state, reference, tau)
        self.schedule = compiled.schedule(self.start.y)
        self.y = self.start.y.copy()
        self.signals = [f"{name} {one}" for name in inputs if name != "voltage" for one in self.names(name)]
        self._maps: list[_Map] = []  # one for each thread
        self._spare = _spare(self.scene, inputs, tau is not None)
        o = self.scene.layout
        self.y[o["end_time"]] = max(self.y[o["end_time"]], self.scene.timestep)  # it goes on: no first step
        if self.y[o["status"]] != OK:
            raise ValueError(f"{self.scene.model.name}: state: that run has ended; give the state of a sound one")

    def names(self, signal: str) -> list[str]:
        """Return what the columns of a signal act on: joints, then driven tendons; sampled servos see joints alone."""
        tendons = () if signal == "reference" and self.scene.sampled else self.scene.driven_tendons
        return [*self.scene.model.joint_names, *(one.name for one in tendons)]

    def beginnings(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Return states (blocks, size, lanes) of so many runs, and moves of signals (blocks, signals, lanes)."""
        states = aligned((-(-count // self.lanes), len(self.y), self.lanes))
        states[:] = self.y[:, None]
        return states, np.zeros((len(states), len(self.signals), self.lanes))

    def run(self, states: np.ndarray, signals: np.ndarray) -> None:
        """Advance states (blocks, size, lanes) to the end of the period; signals: what moves their own.

        Raises ValueError where a run ends before.
        """
        blocks = len(states)
        brief = blocks * self.schedule.steps * self.scene.model.nv < BRIEF and not self.scene.adaptive
        threads = min(self.threads or (1 if brief else os.cpu_count() or 1), blocks)
        while len(self._maps) < threads:
            self._maps.append(_Map(self, self._spare.pop() if self._spare else None))

        def work(k: int) -> None:
            for block in range(k, blocks, threads):
                self._maps[k](states[block], signals[block])

        if threads == 1:
            work(0)
        else:
            with ThreadPoolExecutor(threads) as pool:
                list(pool.map(work, range(threads)))
        status = states[:, self.scene.layout["status"]]
        if (status != OK).any():
            raise ValueError(
                f"{self.scene.model.name}: within the period a run ends: {OF_CODE[int(status.max())]}; linearize about "
                "a state farther from that"
            )

    def close(self) -> None:
        """Keep vectors for later calls, except those with error control or with the signals of a long period."""
        for one in self._maps:
            samples = one.vector.run.signals.samples
            if one.vector.lanes > 1 and (samples is None or samples.size < KEPT):
                self._spare.append(one.vector)


@functools.lru_cache(maxsize=32)
def _spare(scene: CompiledScene, inputs: tuple[str, ...], driven: bool) -> list[Vector]:
    """Return vectors in no use: to make one takes as long as a hundred steps; the arguments decide its types."""
    return []


class _Map:
    """Advance states (size, lanes) to the end of the period, in place, with signals moved by (signals, lanes)."""

    def __init__(self, system: PeriodRuns, vector: Vector | None) -> None:
        compiled = system.compiled
        if vector is None:
            vector = _vector(system)
        else:
            own = {"plan": system.schedule, "channels": compiled.channels, "stop": compiled.stop}
            vector.run = vector.run._replace(signals=_signals(system, vector.run.signals), **own)
            vector.compiled, vector.out = compiled, lane_zeros((compiled.samples, max(len(compiled.channels), 1)))
        self.vector, first, signals = vector, 0, vector.run.signals
        self._moved: list[tuple[np.ndarray, np.ndarray, slice]] = []  # what kernels read, as it is, what moves it
        for name in (name for name in system.inputs if name != "voltage"):
            knots = signals.torques if name == "torque" else signals.reference
            read = signals.samples if knots is None else knots.cubics
            n = len(system.names(name))
            values = read[:, :, 0].reshape(len(read), -1, system.lanes)[:, :n]
            self._moved.append((values, values.copy(), slice(first, first + n)))
            first += n

    def __call__(self, states: np.ndarray, moves: np.ndarray) -> None:
        for values, own, which in self._moved:
            np.add(own, moves[which], out=values)
        vector = self.vector
        vector.compiled.call(vector.kernel, vector.run, states[:, 0] if vector.lanes == 1 else states, vector.out)


def _vector(system: PeriodRuns) -> Vector:
    """Make a vector of the run, with the kernel of `simulate_batch`."""
    reference, torques = (knots and knots._replace(cubics=knots.cubics.copy()) for knots in system.start[1:3])
    start = system.start._replace(reference=reference, torques=torques)  # which a map moves
    vector = Vector.of(system.compiled, [start], system.lanes)
    if system.lanes > 1:
        signals = vector.run.signals
        if "voltage" in system.inputs:
            signals = signals._replace(reference=None)
        elif system.scene.sampled and signals.torques is None:
            signals = signals._replace(reference=None, samples=_ticks(system))
        vector.run = vector.run._replace(signals=signals)
        vector.kernel = direct(vector.kernel, vector.run, vector.y, vector.out)
    return vector


def _signals(system: PeriodRuns, signals: Signals) -> Signals:
    """Return the signals of a run that a vector had before, as they are in this call."""
    if signals.samples is not None:
        return signals._replace(samples=_ticks(system))
    reference, torques = (
        None if old is None else knots_in_lanes([new] * system.lanes)
        for old, new in ((signals.reference, system.start.reference), (signals.torques, system.start.torques))
    )
    return signals._replace(reference=reference, torques=torques)


def _ticks(system: PeriodRuns) -> np.ndarray:
    """Return what the controllers see at each tick (ticks, joints, 2, lanes)."""
    plan = system.schedule
    return in_lanes([sampled(system.start, plan, 0, -(-plan.steps // plan.per_tick))] * WIDTH)
