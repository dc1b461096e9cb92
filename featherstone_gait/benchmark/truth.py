"""What a run should have given: error control near rounding, kept in a folder, and how far it may be believed."""

from __future__ import annotations

import hashlib
import os
import sys
import zipfile
import zlib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .. import __version__
from ..base.files import complete
from ..run.reference import Reference
from ..run.simulate import simulate
from ..run.trajectory import Trajectory, positions
from ..scene.compile import CompiledScene
from .limited import Worker, at_most

LIMIT = 60.0  # CPU seconds of a reference
AGREED = 1e-5  # between two tolerances, up to which they are believed [rad or m]
RTOL = {"extrapolation": (1e-9, 1e-11), "dop853": (1e-10, 1e-12)}  # the second where the first soon loses its way


class Case(NamedTuple):
    """A scene, what it starts from and for how long it runs."""

    name: str
    kind: str  # of what the summary counts together
    scene: CompiledScene  # with the integrator that is chosen where none is named
    duration: float  # [s]
    state: np.ndarray
    reference: Reference | None = None
    record_interval: float | None = None  # [s]; a controller tick if None
    still: bool = False  # it rests, and nothing else is true

    @property
    def every(self) -> float:
        """Time between records [s]."""
        return self.record_interval or self.scene.tick_steps * self.scene.timestep

    @property
    def record(self) -> tuple[str, ...]:
        return ("base_q", "q", "base_qd", "qd") if self.scene.tree.floating else ("q", "qd")

    def run(self, scene: CompiledScene, **how: Any) -> Trajectory:
        return simulate(
            scene, self.duration, self.state, self.reference, record=self.record, record_interval=self.every, **how
        )

    def compiled(self, scene: CompiledScene) -> None:
        """A tick of it compiles all that it needs."""
        self._replace(duration=self.scene.tick_steps * self.scene.timestep, record_interval=None).run(scene)


class Truth(NamedTuple):
    """Positions and velocities at the records, and up to when they are known."""

    q: np.ndarray  # (samples, nq)
    qd: np.ndarray  # (samples, nv)
    status: str
    known: int  # so many records
    own_error: float  # what another tolerance changes up to there [rad or m]


def truth(case: Case, worker: Worker, folder: Path) -> Truth | None:
    """From the folder, or worked out anew and kept there; None where that takes too long."""
    if case.still:
        return resting(case)
    path = folder / f"{digest(case)}.npz"
    kept = read(path)
    if kept is not None and len(kept.q):
        return kept
    if kept is not None and kept.own_error >= LIMIT:
        return None
    preferred = "extrapolation" if case.scene.stiff else "dop853"
    found = by_method(case, worker, preferred)
    if found is None:
        found = by_method(case, worker, "dop853" if case.scene.stiff else "extrapolation")
    nothing = np.zeros((0, 0))
    write(path, found or Truth(nothing, nothing, "", 0, LIMIT))  # that it takes longer than this is kept too
    return found


def by_method(case: Case, worker: Worker, method: str) -> Truth | None:
    """The one of two pairs of tolerances that is known for longer; None if either takes too long."""
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


def resting(case: Case) -> Truth:
    """The state in which the case starts, for ever."""
    o, n, base = case.scene.layout, case.scene.tree.n, 7 * case.scene.tree.floating
    q = np.concatenate([case.state[o["base_q"] : o["base_q"] + base], case.state[o["q"] : o["q"] + n]])
    samples = round(case.duration / case.every) + 1
    return Truth(np.tile(q, (samples, 1)), np.zeros((samples, case.scene.model.nv)), "ok", samples, 0.0)


def solved(case: Case, method: str, rtol: float) -> Trajectory:
    """The run with error control; it ends the process beyond `LIMIT`."""
    scene = case.scene.recompiled(integrator=method, timestep=None)
    case.compiled(scene)
    with at_most(LIMIT):
        return case.run(scene, rtol=rtol, estimate_error=False)


def agreed(case: Case, best: Trajectory, other: Trajectory) -> Truth:
    """The better run, up to where the other one leaves it."""
    apart = distances(case.scene, positions(best), positions(other))
    ended = best["time"] > min(best.end_time, other.end_time) + 1e-9
    lost = (apart > AGREED) | ~np.isfinite(apart) | ended
    known = int(np.argmax(lost)) if lost.any() else len(lost)
    return Truth(positions(best), velocities(best), best.status, known, float(apart[:known].max(initial=0.0)))


def velocities(run: Trajectory) -> np.ndarray:
    """Velocities (samples, nv)."""
    return np.hstack([run["base_qd"], run["qd"]]) if "base_qd" in run else run["qd"]


def distances(scene: CompiledScene, q: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """Largest difference of positions (samples,): of joints, turn of the base [rad], place of the base [m]."""
    base = 7 * scene.tree.floating
    joints = np.abs(q[:, base:] - exact[:, base:]).max(axis=1, initial=0.0)
    if not base:
        return joints
    a, b = q[:, 3:7], exact[:, 3:7]
    axis = a[:, :1] * b[:, 1:] - b[:, :1] * a[:, 1:] - np.cross(a[:, 1:], b[:, 1:])
    turn = 2.0 * np.arctan2(np.linalg.norm(axis, axis=1), np.abs((a * b).sum(axis=1)))
    return np.maximum(joints, np.maximum(turn, np.linalg.norm(q[:, :3] - exact[:, :3], axis=1)))


# ---------------------------------------------------------------------------------------------- kept


def cache_folder() -> Path:
    """Where references are kept if nothing else is said."""
    user = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    return Path(user) / "featherstone_gait" / "references"


def digest(case: Case) -> str:
    """Hash of all that a reference depends on: the version, not the integrator that is chosen today."""
    scene = case.scene
    chosen = {name: getattr(scene.options, name) for name in PHYSICAL}
    parts = [case.state[slice(*place)].tolist() for name, place in sorted(scene.parts.items()) if name in STARTING]
    r = case.reference
    signal = r and (r.times, r.values, r.kind, r.cyclic)
    with np.printoptions(threshold=sys.maxsize, precision=17):
        text = repr((__version__, scene.model, chosen, scene.constants.push, parts, signal, case.duration, case.every))
    return hashlib.sha256(text.encode()).hexdigest()[:24]


PHYSICAL = ("gearbox", "ground", "gravity", "fall_height", "fall_tilt", "springs")  # arguments of `compile_scene`
STARTING = (
    "base_q", "q", "base_qd", "qd", "current", "rotor", "rotor_speed", "filtered_speed", "tangential_deflection",
    "voltage", "profiled_reference", "delayed",
)  # fmt: skip


def write(path: Path, found: Truth) -> Truth:
    path.parent.mkdir(parents=True, exist_ok=True)
    with complete(path) as temporary, temporary.open("xb") as file:
        np.savez_compressed(file, **found._asdict())
    return found


def read(path: Path) -> Truth | None:
    """What `write` wrote; None where there is nothing, or it is damaged."""
    try:
        with path.open("rb") as file, np.load(file) as data:  # a damaged one stays open otherwise
            q, qd = data["q"], data["qd"]
            return Truth(q, qd, str(data["status"]), int(data["known"]), float(data["own_error"]))
    except (OSError, ValueError, KeyError, EOFError, zlib.error, zipfile.BadZipFile):
        return None
