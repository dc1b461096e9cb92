"""Define what benchmarks run: a scene, its start and the settings to try; and compute the reference solution.

References come of error control near rounding, and are believed up to where a second tolerance or method leaves them.
"""

from __future__ import annotations

import hashlib
import math
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .. import __version__
from ..base.brief import in_full
from ..base.files import Format, complete, read_arrays
from ..base.processes import process_pool
from ..core.compile.jit import user_cache
from ..core.integrate import INTEGRATORS
from ..model import Model
from ..run.classify import to_trajectory
from ..run.prepare import prepare, with_tolerance
from ..run.reference import Reference
from ..run.simulate import initial_state, simulate
from ..run.start import positions_in
from ..run.trajectory import Trajectory
from ..scene.compile import CompiledScene

Setting = tuple[str, float]  # an integrator, and its step [s] or its tolerance
REFERENCE = Format("reference solution")
LIMIT = 60.0  # CPU seconds of a reference
AGREED = 1e-5  # between two tolerances, up to which they are believed [rad or m]
RTOL = {"extrapolation": (1e-9, 1e-11), "dop853": (1e-10, 1e-12)}  # the second where the first soon loses its way
STEPS = (0.1, 5e-2, 2e-2, 1e-2, 5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4, 5e-5, 2e-5)  # [s]
TOLERANCES = tuple(10.0**-k for k in range(2, 14))
PHYSICAL = ("gearbox", "ground", "gravity", "fall_height", "fall_tilt", "springs")  # arguments of `compile_scene`
STARTING = (
    "base_q", "q", "base_qd", "qd", "current", "rotor", "rotor_speed", "filtered_speed", "tangential_deflection",
    "voltage", "profiled_reference", "delayed",
)  # fmt: skip


class Case(NamedTuple):
    """Describe a run: a scene, its initial state and duration, and the settings to try."""

    name: str
    kind: str  # of what summaries count together
    scene: CompiledScene  # with the integrator that is chosen where none is named
    duration: float  # [s]
    state: np.ndarray
    reference: Reference | None = None
    record_interval: float | None = None  # between records [s]; a controller tick if None
    still: bool = False  # it rests, and nothing else is true
    settings: tuple[Setting, ...] = ()
    best: Setting = ("extrapolation", 1e-13)  # gives the reference solution ...
    check: Setting = ("extrapolation", 1e-12)  # ... and this one its error
    exact: Callable[[np.ndarray], np.ndarray] | None = None  # positions at times [s], in closed form
    tau: np.ndarray | None = None  # torques that act all the time (n,) [N m]

    @property
    def model(self) -> Model:
        return self.scene.model

    @property
    def every(self) -> float:
        """Return the time between records [s]."""
        return self.record_interval or self.scene.tick_steps * self.scene.timestep

    @property
    def record(self) -> tuple[str, ...]:
        return ("base_q", "q", "base_qd", "qd") if self.scene.tree.floating else ("q", "qd")

    @property
    def coordinates(self) -> tuple[np.ndarray, np.ndarray]:
        """Initial positions and velocities."""
        o, n, base, y = self.scene.layout, self.scene.tree.n, self.scene.tree.floating, self.state
        v = np.concatenate([y[o["base_qd"] : o["base_qd"] + 6 * base], y[o["qd"] : o["qd"] + n]])
        return positions_in(self.scene, y), v

    @property
    def signal(self) -> Reference:
        """Return the reference of a case that has one."""
        assert self.reference is not None
        return self.reference

    def by(self, integrator: str, timestep: float | None = None) -> CompiledScene:
        """Compile the scene with another integrator and step [s]; None is the integrator's default step."""
        return self.scene.recompiled(integrator=integrator, timestep=timestep)

    def run(self, scene: CompiledScene, **how: Any) -> Trajectory:
        """Simulate positions and velocities in a scene of `by`; how: further arguments of `simulate`."""
        how |= {"record": self.record, "record_interval": self.every}
        return simulate(scene, self.duration, self.state, self.reference, tau=self.tau, **how)

    def compiled(self, scene: CompiledScene, **how: Any) -> None:
        """Run one tick, which compiles all kernels."""
        self._replace(duration=self.scene.tick_steps * self.scene.timestep, record_interval=None).run(scene, **how)

    def ready(self, integrator: str, setting: float) -> Run:
        """Prepare the compiled run with a step [s] or a tolerance."""
        adaptive = INTEGRATORS[integrator].adaptive
        return Run(self, self.by(integrator, None if adaptive else setting), setting if adaptive else None)


def case_of(name: str, kind: str, scene: CompiledScene, duration: float, q: Any, qd: Any, **more: Any) -> Case:
    """Make a case from initial positions and velocities; None means zero."""
    return Case(name, kind, scene, duration, initial_state(scene, q, qd), **more)


def settings(finest: dict[str, float], coarsest: float = 1e-2) -> tuple[Setting, ...]:
    """List steps from the coarsest [s], or tolerances, down to the finest of each integrator."""
    return tuple(
        (integrator, value)
        for integrator, least in finest.items()
        for value in (TOLERANCES if INTEGRATORS[integrator].adaptive else STEPS)
        if 0.99 * least <= value <= (1.0 if INTEGRATORS[integrator].adaptive else coarsest)
    )


class Run:
    """Hold a compiled run with its arguments prepared, to time the kernel without Python's overhead."""

    def __init__(self, case: Case, scene: CompiledScene, rtol: float | None) -> None:
        self.case, (self.scene, rtol, atol) = case, with_tolerance(scene, rtol, None)
        self.record = ("base_q", "q") if scene.tree.floating else ("q",)
        self.rtol = rtol
        self.ready = prepare(self.scene, case.duration, self.record, case.every, rtol=rtol, atol=atol,
                             driven=case.tau is not None)  # fmt: skip
        self.start = self.ready.start(case.state, case.reference, case.tau)
        self.arguments = self.ready.arguments(self.start)

    def once(self) -> float:
        """Run; return CPU time per simulated second [ms]."""
        self.arguments[1][:] = self.start.y
        start = time.thread_time()
        self.ready.kernel(*self.arguments)
        return 1e3 * (time.thread_time() - start) / self.case.duration

    def call(self) -> float:
        """Run by `simulate`; return its CPU time per simulated second [ms]."""
        case, start = self.case, time.thread_time()
        how: dict[str, Any] = dict(record=self.record, record_interval=case.every, rtol=self.rtol, estimate_error=False)
        simulate(self.scene, case.duration, case.state, case.reference, tau=case.tau, **how)
        return 1e3 * (time.thread_time() - start) / case.duration

    @property
    def trajectory(self) -> Trajectory:
        """Result of the last `once`."""
        return to_trajectory(self.ready, *self.arguments[1:])


# ---------------------------------------------------------------------------------------------- errors


def positions(run: Trajectory | Mapping[str, np.ndarray]) -> np.ndarray:
    """Return positions (samples, nq) of all bases, then of all joints."""
    return np.hstack([run["base_q"].reshape(len(run["q"]), -1), run["q"]]) if "base_q" in run else run["q"]


def separations(model: Model, q: np.ndarray, exact: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return differences of positions (samples, nq): joints and base rotation [rad], and base position [m] or NaN.

    Of several bases the largest counts.
    """
    bases = q.shape[1] - len(model.position_names)
    joints = np.abs(q[:, bases:] - exact[:, bases:]).max(axis=1, initial=0.0)
    if not bases:
        return joints, np.full(len(q), math.nan)
    at, truly = (one[:, :bases].reshape(len(q), -1, 7) for one in (q, exact))
    a, b = at[..., 3:], truly[..., 3:]
    axis = a[..., :1] * b[..., 1:] - b[..., :1] * a[..., 1:] - np.cross(a[..., 1:], b[..., 1:])
    turn = 2.0 * np.arctan2(np.linalg.norm(axis, axis=2), np.abs((a * b).sum(axis=2)))
    shift = np.linalg.norm(at[..., :3] - truly[..., :3], axis=2)
    return np.maximum(joints, turn.max(axis=1)), shift.max(axis=1)


def deviation(model: Model, q: np.ndarray, exact: np.ndarray) -> tuple[float, float]:
    """Return the largest of each of `separations`."""
    angle, shift = separations(model, q, exact)
    return float(angle.max()), float(shift.max())


def distances(scene: CompiledScene, q: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """Return the larger of each pair of `separations` (samples,) [rad or m]."""
    return np.fmax(*separations(scene.model, q, exact))


def estimate_of(run: Trajectory) -> np.ndarray:
    """Return the largest position error that a run estimates (samples,), NaN where it estimates none."""
    samples = len(run["time"])
    stated = [run.error[name].reshape(samples, -1) for name in ("base_q", "q") if run.error and name in run.error]
    return np.hstack(stated).max(axis=1, initial=0.0) if stated else np.full(samples, math.nan)


def velocities(run: Trajectory | Mapping[str, np.ndarray]) -> np.ndarray:
    """Return velocities (samples, nv)."""
    return np.hstack([run["base_qd"].reshape(len(run["qd"]), -1), run["qd"]]) if "base_qd" in run else run["qd"]


# ---------------------------------------------------------------------------------------------- references


def solution(case: Case) -> tuple[np.ndarray, float]:
    """Return positions (samples, nq) by a case's best setting, and how far its check differs [rad or m]."""
    best = case.ready(*case.best)
    if case.exact is not None:
        return case.exact(best.trajectory["time"]), 0.0
    other = case.ready(*case.check)
    best.once()
    other.once()
    reference = positions(best.trajectory)
    return reference, float(np.nanmax(deviation(case.model, positions(other.trajectory), reference)))


class Truth(NamedTuple):
    """Hold reference positions and velocities at the records, and up to when they are known."""

    q: np.ndarray  # (samples, nq)
    qd: np.ndarray  # (samples, nv)
    status: str
    known: int  # so many records
    own_error: float  # what another tolerance changes up to there [rad or m]
    own_speed_error: float = 0.0  # the same of velocities [rad/s or m/s]


def agreed(case: Case, best: Trajectory, other: Trajectory) -> Truth:
    """Return the more accurate run, known up to where the other one leaves it."""
    apart = distances(case.scene, positions(best), positions(other))
    ended = best["time"] > min(best.end_time, other.end_time) + 1e-9
    lost = (apart > AGREED) | ~np.isfinite(apart) | ended
    known = int(np.argmax(lost)) if lost.any() else len(lost)
    faster = np.abs(velocities(best) - velocities(other))[:known]
    own = (float(one[:known].max(initial=0.0)) for one in (apart, faster))
    return Truth(positions(best), velocities(best), best.status, known, *own)


def truth(case: Case, worker: Worker, folder: Path) -> Truth | None:
    """Read the reference from the folder, or compute and keep it there; None where that takes too long."""
    if case.still:
        return resting(case)
    path = folder / f"{digest(case)}.npz"
    kept = read(path)
    if kept is not None and len(kept.q):
        return kept
    if kept is not None and kept.own_error >= LIMIT:
        return None
    methods = ("extrapolation", "dop853") if case.scene.stiff else ("dop853", "extrapolation")
    found = by_method(case, worker, methods[0]) or by_method(case, worker, methods[1])
    nothing = np.zeros((0, 0))
    write(path, found or Truth(nothing, nothing, "", 0, LIMIT))  # that it takes longer than this is kept too
    return found


def by_method(case: Case, worker: Worker, method: str) -> Truth | None:
    """Return the reference of the pair of tolerances that agrees for longer; None if either run takes too long."""
    found: Truth | None = None
    for rtol in RTOL[method]:
        best = worker.call(solved, case, method, rtol)
        other = None if best is None else worker.call(solved, case, method, 10.0 * rtol)
        if best is not None and other is not None:
            pair = agreed(case, best, other)
            found = pair if found is None or pair.known > found.known else found
        if found is None or found.known == len(found.q):
            break
    return found


def solved(case: Case, method: str, rtol: float) -> Trajectory:
    """Run with error control; end the process beyond `LIMIT` CPU seconds."""
    scene = case.by(method)
    case.compiled(scene)
    with at_most(LIMIT):
        return case.run(scene, rtol=rtol, estimate_error=False)


def resting(case: Case) -> Truth:
    """Return the initial state at all records."""
    samples = round(case.duration / case.every) + 1
    return Truth(np.tile(case.coordinates[0], (samples, 1)), np.zeros((samples, case.model.nv)), "ok", samples, 0.0)


def cache_folder() -> Path:
    """Return the default folder of references."""
    return Path(user_cache()) / "references"


def digest(case: Case) -> str:
    """Hash all that a reference depends on: the version of this package, not the integrator chosen by default."""
    scene = case.scene
    chosen = {name: getattr(scene.options, name) for name in PHYSICAL}
    parts = [case.state[slice(*place)].tolist() for name, place in sorted(scene.parts.items()) if name in STARTING]
    r = case.reference
    signal = r and (r.times, r.values, r.kind, r.cyclic)
    company: tuple[Any, ...] = (scene.obstacles, scene.excluded, scene.options.pairs) if scene.pairs else ()
    company += (scene.frictions,) if scene.frictions else ()
    torques = () if case.tau is None else (case.tau.tolist(),)
    with np.printoptions(threshold=sys.maxsize, precision=17):
        text = in_full(
            (__version__, scene.model, chosen, scene.constants.push, parts, signal, case.duration, case.every, *company,
             *torques)
        )  # fmt: skip
    return hashlib.sha256(text.encode()).hexdigest()[:24]


def write(path: Path, found: Truth) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with complete(path) as temporary, temporary.open("xb") as file:
        np.savez_compressed(file, format=str(REFERENCE), **found._asdict())


def read(path: Path) -> Truth | None:
    """Read what `write` wrote; None where the file is missing or damaged."""
    try:
        data: dict[str, Any] = read_arrays(path, REFERENCE)
        own = (float(data[name]) for name in ("own_error", "own_speed_error"))
        return Truth(data["q"], data["qd"], str(data["status"]), int(data["known"]), *own)
    except (OSError, ValueError, KeyError):
        return None


# ---------------------------------------------------------------------------------------------- processes


class Worker:
    """Call functions in one separate process, and in a new one after a call has ended it."""

    def __init__(self) -> None:
        self._pool: ProcessPoolExecutor | None = None

    def call(self, function: Callable[..., Any], *args: Any) -> Any:
        """Return what the function returns, or None where it ended its process: see `at_most`."""
        if self._pool is None:
            self._pool = process_pool(1)
        try:
            return self._pool.submit(function, *args).result()
        except BrokenProcessPool:
            self.close()
            return None

    def close(self) -> None:
        """End the process."""
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)
            self._pool = None


@contextmanager
def at_most(seconds: float) -> Iterator[None]:
    """End the process if the block takes more CPU time [s]; this stops compiled code too.

    Windows has no such clock: there is no limit there.
    """
    if not hasattr(signal, "setitimer"):
        yield
        return
    signal.signal(signal.SIGPROF, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
