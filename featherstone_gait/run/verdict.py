"""How a run ended, and whether to believe it."""

from __future__ import annotations

import numpy as np

from ..core.effects.energies import ENERGIES, STOPS
from ..core.effects.spring import CAUSES as SPRING_CAUSES
from ..core.effects.stop import explicit_limit
from ..core.integrate import rollout
from ..core.step import pace
from ..core.step.context import Plan
from ..scene.compile import CompiledScene
from .prepared import LEAST_STEP, Prepared
from .trajectory import Trajectory

STATUS = {
    rollout.OK: "ok",
    rollout.FELL: "fell",
    rollout.DIVERGED: "diverged",
    rollout.TOO_SMALL: "step too small",
    rollout.TOO_COSTLY: "too costly",
}
CHATTER_LIMIT = 0.05  # [rad/s or m/s]; see `worst_chatter` in core/step/state.py
# A rule that rings about the right mean after an impact: the limit is the angle that this moves a joint to and fro,
# half of what counts as a wrong result [rad or m].
RINGING_LIMIT = 5e-4


def trajectory(ready: Prepared, y: np.ndarray, out: np.ndarray, course: Plan | None = None) -> Trajectory:
    """Name the channels and say how the run ended; course: of `ready.course`, None of a run that begins at zero."""
    scene, course = ready.scene, ready.plan if course is None else course
    status, message, end = verdict(scene, course.offset + (course.first + course.steps) * course.h, y)
    passes = y[slice(*scene.part("newton_iterations"))]
    info = {
        "robot": scene.model.name,
        "joints": list(scene.model.joint_names),
        "integrator": scene.integrator,
        "timestep": scene.timestep,
        "reason": scene.preflight.reason,
        "servos": scene.gearbox,
        "worst_chatter": float(max(y[slice(*scene.part("worst_chatter"))], default=0.0)),
        "newton_passes": float(passes[0]),
        "not_converged_steps": float(passes[1]),
    }
    if scene.adaptive:
        taken, rejected, evaluations = y[slice(*scene.part("step_control"))][pace.STEPS : pace.LAST]
        info |= {"rtol": ready.plan.rtol, "atol": ready.plan.atol}
        info |= {"steps": int(taken), "rejected_steps": int(rejected), "evaluations": int(evaluations)}
    return Trajectory(ready.named(out, course), status, message, end, y, info, parts=scene.parts)


def verdict(scene: CompiledScene, end: float, y: np.ndarray) -> tuple[str, str, float]:
    """Status, message and the time at which the run ended [s], from its final state; end: of a run that is sound."""
    if int(y[scene.layout["status"]]) != rollout.OK:
        return _failure(scene, y)
    wrong = beyond_stability(scene) or _unresolved_stop(scene, y) or _chatter(scene, y) or _not_converged(scene, y)
    return (*(wrong or ("ok", "")), end)


def _failure(scene: CompiledScene, y: np.ndarray) -> tuple[str, str, float]:
    code, end = int(y[scene.layout["status"]]), float(y[scene.layout["end_time"]])
    name, status = scene.model.name, STATUS[code]
    message = f"{name} {status} at {end:.4g} s"
    if code == rollout.TOO_SMALL:
        message = f"{name}: the tolerance asks for steps below {LEAST_STEP:g} s at {end:.4g} s"
    if code == rollout.TOO_COSTLY:
        message = _costly(scene, y, end)
    speeds = np.abs(y[slice(*scene.part("qd"))])
    if code == rollout.DIVERGED and len(speeds):
        joint = scene.model.joint_names[int(speeds.argmax())]
        message += f"; in the last sound state the fastest joint was {joint} at {speeds.max():.3g} rad/s or m/s"
    return status, message, end


def _costly(scene: CompiledScene, y: np.ndarray, end: float) -> str:
    """How dear the run was, and what is likely to limit its steps."""
    taken, rejected = y[slice(*scene.part("step_control"))][[pace.STEPS, pace.REJECTED]]
    least, by = scene.preflight.worst, "kinks or fast motion limit them"
    if least is not None:
        by = f"{least.joint} limits explicit ones to {least.step:.2g} s by its {least.cause}"
    return (
        f"{scene.model.name}: {scene.integrator} took {taken + rejected:.0f} steps ({rejected:.0f} rejected) up to "
        f"{end:.4g} s; {by}: raise rtol, or use implicit_euler or midpoint at a fixed step"
    )


def beyond_stability(scene: CompiledScene) -> tuple[str, str] | None:
    """A fixed step too large for an explicit integrator, or for springs between bodies, which none takes in."""
    check, method, by = scene.preflight, scene.method, ""
    largest = method.stability * check.sliding_step if method.explicit else method.ties * check.spring_step
    if method.adaptive or not scene.timestep > largest:
        return None
    if check.spring_step < 1.01 * check.sliding_step:
        ties = [limit for limit in check.limits if limit.cause in SPRING_CAUSES]
        by = f", by the spring {min(ties, key=lambda limit: limit.step).joint}"
    message = f"{scene.integrator} is stable up to {largest:.2g} s in this scene{by}; the step is {scene.timestep:g} s"
    return "not converged", message


def _unresolved_stop(scene: CompiledScene, y: np.ndarray) -> tuple[str, str] | None:
    """A joint whose stop an explicit integrator has met with too large a step."""
    stops = scene.constants.stops
    if not scene.method.explicit or stops is None:
        return None
    work = y[slice(*scene.part("energy"))].reshape(-1, ENERGIES)[:, STOPS]
    met = (work != 0.0) & (scene.timestep > explicit_limit(stops, scene.preflight.inertias))
    if not met.any():
        return None
    message = (
        f"{scene.model.joint_names[int(met.argmax())]} ran into its stop, which {scene.integrator} does not resolve at "
        f"{scene.timestep:g} s: use implicit_euler or a smaller step"
    )
    return "not converged", message


def _chatter(scene: CompiledScene, y: np.ndarray) -> tuple[str, str] | None:
    chatter, limit = y[slice(*scene.part("worst_chatter"))], CHATTER_LIMIT
    if scene.method.rings:
        limit = max(limit, RINGING_LIMIT / scene.timestep)
    if not len(chatter) or not chatter.max() > limit:
        return None
    joint = scene.model.joint_names[int(chatter.argmax())]
    message = (
        f"the speed of {joint} alternated by {chatter.max():.3g} rad/s from step to step (limit {limit:.3g}): "
        f"a step of {scene.timestep:g} s is too large for {scene.integrator} in this scene"
    )
    return "chatter", message


def _not_converged(scene: CompiledScene, y: np.ndarray) -> tuple[str, str] | None:
    missed = y[scene.part("newton_iterations")[0] + 1]
    return ("not converged", f"{missed:.0f} implicit steps missed their tolerance") if missed > 0 else None
