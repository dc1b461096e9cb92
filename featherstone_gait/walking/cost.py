"""The cost of walking: electrical energy per distance over whole strides, after the start.

    cost = E / d,   E = sum over the joints of the integral of max(0, V I) dt,   d = forward displacement of the base,

the meter and the cost of J. Lima et al., "Humanoid gait optimization resorting to an improved simulation model", Int.
J. Advanced Robotic Systems 10 (2013), section 4; E is the motors' energy, without that of the electronics.  The cost of
transport is E / (m g d), g the strength of the scene's gravity.  A run that fails, goes backward or hardly moves has
an infinite cost, and its status says why.

The references go out every 40 ms.  Between two of them the servo runs at the speed that brings it to the next one in
time, as an AX-12 does whose moving speed is sent with its goal position (ROBOTIS e-Manual, AX-12A, control table
address 32): the references are joined by straight lines.  If they were held instead, they would be steps of up to 15
degrees: the humanoid's first gait then costs 89.5 J/m instead of 65.3 (implicit Euler at 1 ms).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import instance, is_real, whole
from ..base.brief import brief
from ..base.files import FilePath
from ..core.effects.energies import METER
from ..dynamics import contact_positions
from ..model import Model
from ..run.reference import Reference
from ..run.simulate import simulate_batch, simulate_stream, standing_state
from ..run.trajectory import Trajectory
from ..scene.compile import CompiledScene
from .gait import MOST_STRIDES, TICK, Gait, check_names, references
from .gait_file import read_angles

if TYPE_CHECKING:
    from ..search.speculation import Candidate, Speculation

SAMPLE = 0.01  # [s] between records; slip is the length of a path, which needs fine samples
LEAST_SPEED = 0.005  # [m/s]; below it the robot does not walk, and energy per distance means nothing
LOADED = 0.01  # share of the robot's weight on a contact point from which its sliding counts
RECORD = ("base_q", "q", "energy", "contact_force")


@dataclass(frozen=True)
class Measures:
    """Measures of a walk over a number of strides; numbers are nan if the robot did not walk all of them.

    Attributes
    ----------
    status : str
        "ok", or why there is no cost.
    strides : int
        Number of strides.
    duration : float
        Time of the strides [s].
    energy : float
        Integral of max(0, V I) of all motors [J].
    distance, sideways : float
        Displacement of the base along x and along y [m].
    slip : float
        Path of a contact point while it bears weight, mean over the points [m per stride].
    weight : float
        Mass times the strength of gravity [N].
    """

    status: str
    strides: int
    duration: float
    energy: float
    distance: float
    sideways: float
    slip: float
    weight: float

    @property
    def cost(self) -> float:
        """Energy per distance [J/m]; infinite unless the status is "ok"."""
        return self.energy / self.distance if self.status == "ok" else math.inf

    @property
    def cost_of_transport(self) -> float:
        """Energy per weight and distance [-]; infinite without weight."""
        return self.cost / self.weight if self.weight > 0.0 else math.inf

    @property
    def speed(self) -> float:
        """Forward speed [m/s]."""
        return self.distance / self.duration

    @property
    def stride_length(self) -> float:
        """Length of a stride [m]; of a biped two steps."""
        return self.distance / self.strides

    def as_dict(self) -> dict[str, float | str | None]:
        """Return all numbers by name; None for those that are not finite, which JSON lacks."""
        names = ("cost", "cost_of_transport", "speed", "stride_length")
        named = asdict(self) | {name: getattr(self, name) for name in names}
        finite = {name: value for name, value in named.items() if name == "status" or math.isfinite(value)}
        return dict.fromkeys(named) | finite


class BatchCost:
    """A cost of vectors that is evaluated for many at once: a subclass has ``costs(vectors)``."""

    costs: Callable[[Any], list[tuple[float, str]]]

    def __call__(self, x: Any) -> tuple[float, str]:
        """Return cost [J/m] and status of one vector."""
        return self.costs([x])[0]


@dataclass(frozen=True, eq=False)
class WalkingCost(BatchCost):
    """The cost of gait vectors (D,) [rad], for `search.minimize`.

    A vector's cost has the same bits whether it is evaluated alone or among others.

    Attributes
    ----------
    scene : CompiledScene
        The robot on its ground.
    gait : Gait
        The first gait, which gives vectors their meaning.
    start : ndarray, shape (nj,) or (m, nj)
        Posture or start-up before the first stride, as of `references` [rad].
    warm_up, strides : int
        Number of strides before the measured ones, and number of these.
    blend_strides : int
        As of `references`.
    """

    scene: CompiledScene
    gait: Gait
    start: np.ndarray
    warm_up: int = 2
    strides: int = 8
    blend_strides: int = 1

    __repr__ = brief

    def __post_init__(self) -> None:
        instance("scene", self.scene, CompiledScene, "give what compile_scene returns")
        instance("gait", self.gait, Gait, "give a Gait, as fit_gait(...).gait")
        check_names("start", self.gait, self.start)
        for name, least in (("warm_up", 0), ("strides", 1), ("blend_strides", 0)):
            whole(name, getattr(self, name), least, "it is a number of strides", MOST_STRIDES)

    def costs(self, vectors: Iterable[ArrayLike]) -> list[tuple[float, str]]:
        """Evaluate many vectors at once; for the searches ``map=WalkingCost.costs``."""
        return [(measures.cost, measures.status) for measures in self.measure(vectors)]

    def evaluate(self, candidates: Speculation) -> float:
        """Evaluate the candidates of a `search.Speculation`: the `evaluate` of `search.minimize`.

        Returns the share of the lane-steps that a candidate was in.
        """

        @functools.cache  # candidates start from the same posture
        def standing(angles: bytes) -> np.ndarray:
            return standing_state(self.scene, np.frombuffer(angles), allow_limit_violation=True)

        def begin(candidate: Candidate) -> tuple[np.ndarray, Reference]:
            signal = self.reference(candidate.x, self.warm_up + self.strides)
            return standing(signal.values[0].tobytes()), signal

        def end(run: Trajectory) -> tuple[float, str]:
            measures = self.measured(run, slip=False)
            return measures.cost, measures.status

        return simulate_stream(
            self.scene, self.end, candidates, begin, end, record=("base_q", "energy"), record_interval=TICK
        )

    def measure(self, vectors: Iterable[ArrayLike]) -> list[Measures]:
        """Simulate gait vectors and measure them."""
        return [self.measured(run) for run in self.simulate(list(vectors))]

    def measured(self, run: Trajectory, slip: bool = True) -> Measures:
        """Measure a run that starts as `beginning` says, with the channels `RECORD` every `SAMPLE`."""
        return measured(self.scene, run, self.mark, self.end, self.strides, slip)

    def simulate(
        self,
        vectors: Iterable[ArrayLike],
        *,
        strides: int | None = None,
        record_interval: float = SAMPLE,
        record: Iterable[str] = RECORD,
        states: Sequence[np.ndarray] | None = None,
        **how: Any,
    ) -> list[Trajectory]:
        """Simulate gait vectors; return a `Trajectory` of each, with the channels `record`.

        strides: after the start, by default those that are needed to measure; states: to start from, by default
        standing; how: pushes, noises, rtol and other arguments of `simulate_batch`; errors are not estimated by
        default.
        """
        strides = self.warm_up + self.strides if strides is None else strides
        signals = [self.reference(x, strides) for x in vectors]
        how |= {"states": states, "record": record, "record_interval": record_interval}
        return walk_runs(self.scene, signals[0].times[-1], signals, **how)

    def beginning(self, x: ArrayLike) -> tuple[np.ndarray, Reference]:
        """Return the standing state from which a vector is measured, and the servos' reference."""
        signal = self.reference(x, self.warm_up + self.strides)
        return standing_state(self.scene, signal.values[0], allow_limit_violation=True), signal

    def reference(self, x: ArrayLike, strides: int) -> Reference:
        """Return the servos' reference: the start and `strides` strides, every 40 ms."""
        times, angles = references(self.gait.from_vector(x), strides, self.start, blend_strides=self.blend_strides)
        return Reference(times, angles, "linear")

    @property
    def mark(self) -> float:
        """Time at which the measured strides begin [s]."""
        ramp = self.blend_strides * round(self.gait.period / TICK)
        start = ramp if np.ndim(self.start) == 1 else len(self.start)
        return start * TICK + self.warm_up * self.gait.period

    @property
    def end(self) -> float:
        """Time at which the measured strides end [s]."""
        return self.mark + self.strides * self.gait.period


def cost_of_motion(scene: CompiledScene, path: FilePath, *, start: float = 0.0, strides: int = 1) -> Measures:
    """Simulate a motion recorded as CSV (`write_angles`) and measure it.

    Parameters
    ----------
    scene : CompiledScene
        The robot on its ground; it starts standing in the first row's posture.
    path : path
        The CSV file.
    start : float
        Time from which the motion is measured, to the last row [s].
    strides : int
        Number of equal strides in that time.

    Returns
    -------
    Measures
        The measures.

    Raises
    ------
    ValueError
        For a file that does not fit the robot, and a `start` beyond its end.
    """
    instance("scene", scene, CompiledScene, "give what compile_scene returns")
    strides = whole("strides", strides, 1, "it is how many strides the motion has", MOST_STRIDES)
    times, angles, _ = read_angles(path, scene.model.joint_names)
    times = times - times[0]
    if not is_real(start) or not 0.0 <= start < times[-1]:
        raise ValueError(f"{path}: start is {start} s; it must lie between 0 and the motion's end at {times[-1]:g} s")
    state, reference = standing_state(scene, angles[0]), Reference(times, angles, "linear")
    (run,) = simulate_batch(
        scene, times[-1], [state], [reference], record=RECORD, record_interval=SAMPLE, estimate_error=False
    )
    return measured(scene, run, start, times[-1], strides)


def measured(
    scene: CompiledScene, run: Trajectory, start: float, end: float, strides: int, slip: bool = True
) -> Measures:
    """Measure a trajectory between two times, to within one sample; slip is nan if it is not asked for."""
    weight = scene.model.mass * math.hypot(*scene.gravity)
    if not run.ok:
        return Measures(run.message, strides, *(math.nan,) * 5, weight)
    window = window_of(run, start, end)
    first, last = window.start, window.stop - 1
    duration = float(run["time"][last] - run["time"][first])
    ahead, sideways = (run["base_q"][last] - run["base_q"][first])[:2].tolist()
    energy = float(np.sum(run["energy"][last, :, METER] - run["energy"][first, :, METER]))
    slid = _slip(scene.model, run, window, LOADED * weight) / strides if slip else math.nan
    status = "ok"
    if ahead < LEAST_SPEED * duration:
        status = f"went {1e3 * ahead:.0f} mm in {duration:.3g} s, less than {1e3 * LEAST_SPEED:g} mm/s forward"
    return Measures(status, strides, duration, energy, ahead, sideways, slid, weight)


def walk_runs(
    scenes: CompiledScene | Sequence[CompiledScene],
    duration: float,
    references: Sequence[Reference],
    offsets: ArrayLike = 0.0,
    **how: Any,
) -> list[Trajectory]:
    """Simulate references from standing, each in its scene, or all in one.

    offsets (n, nj) [rad]: of the first postures; how: of `simulate_batch`; errors are not estimated by default.
    """
    angles = [reference.values[0] for reference in references]
    each = [scenes] * len(angles) if isinstance(scenes, CompiledScene) else scenes
    how["states"] = how.get("states") or [
        standing_state(scene, first + off, allow_limit_violation=True)
        for scene, first, off in zip(each, angles, np.broadcast_to(offsets, np.shape(angles)))
    ]
    return simulate_batch(scenes, duration, references=references, **{"estimate_error": False} | how)


def window_of(run: Trajectory, start: float, end: float) -> slice:
    """Return the samples of a run from `start` to `end` [s], to within one sample."""
    first, last = np.searchsorted(run["time"], [start - 1e-9, end - 1e-9])
    return slice(int(first), int(last) + 1)


def _slip(model: Model, run: Trajectory, window: slice, load: float) -> float:
    """Average the contact points' paths on the ground while both ends of a sample bear more than `load` [N]."""
    points = contact_positions(model, np.hstack([run["base_q"], run["q"]])[window])
    step = np.linalg.norm(np.diff(points[..., :2], axis=0), axis=-1)
    bears = run["contact_force"][window, :, 0] > load
    return float((step * (bears[1:] & bears[:-1])).sum(axis=0).mean())
