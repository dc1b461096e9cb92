"""Classify how a run ended, and whether its result can be believed."""

from __future__ import annotations

from collections import Counter
from typing import Any, NamedTuple

import numpy as np

from ..base.rotation import dot, rotation_from_quaternion
from ..core.effects.energies import ENERGIES, STOPS
from ..core.effects.stop import explicit_limit
from ..core.integrate.adaptive import PROGRESS, STALLED
from ..core.step import pace
from ..core.step.context import Plan
from ..dynamics import center_of_mass, deepest_points
from ..dynamics.tendons import lengths_of
from ..model import Model
from ..model.numpy_dynamics import link_poses
from ..scene.compile import CompiledScene
from ..scene.contact import by_body, over_ground, plane_axes
from .compiled_run import CompiledRun
from .prepare import least_step
from .start import CLOSED, open_rows, positions_in, what_is_loose_at
from .status import OF_CODE, Status
from .trajectory import Trajectory

CHATTER_LIMIT = 0.05  # [rad/s or m/s]; see `worst_chatter` in core/step/state.py
# For a rule that rings about the right mean after an impact: the amplitude of the joint's motion, half of what counts
# as a wrong result [rad or m].
RINGING_LIMIT = 5e-4
BETWEEN = "half of the thinner one, or two depths at rest"
ON_GROUND = "half of what is thin there, or a contact point under twice the weight, or a tenth of the standing height"
LOOSE = 1e-5  # least eigenvalue of the scaled mass matrix, below which it is what ends a run


class Outcome(NamedTuple):
    """The end of a run: status, message and time."""

    status: Status
    message: str  # empty if nothing is wrong
    end_time: float = 0.0  # [s]


def to_trajectory(run: CompiledRun, y: np.ndarray, out: np.ndarray, schedule: Plan | None = None) -> Trajectory:
    """Name the channels and say how the run ended; schedule: of a run that does not begin at zero."""
    scene, schedule = run.scene, run.plan if schedule is None else schedule
    status, message, end = classify(scene, schedule.offset + (schedule.first + schedule.steps) * schedule.h, y)
    passes = y[slice(*scene.part("newton_iterations"))]
    info: dict[str, Any] = {
        "robot": scene.model.name,
        "joints": list(scene.model.joint_names),
        **({"positions": list(scene.model.position_names)} if scene.model.balls else {}),
        "joint_types": [joint.type for joint in scene.model.moving_joints],
        "integrator": scene.integrator,
        "timestep": scene.timestep,
        "reason": scene.preflight.reason,
        "servos": scene.gearbox,
        "worst_chatter": float(max(y[slice(*scene.part("worst_chatter"))], default=0.0)),
        "newton_passes": float(passes[0]),
        "not_converged_steps": float(passes[1]),
    }
    if scene.members:
        info["members"] = {
            member.name: share | _names(member.model) for member, share in zip(scene.members, scene.shares.values())
        }
    if scene.model.loops:
        info["loops"] = [loop.name for loop in scene.model.loops]
        info["loop_rows"] = row_names(scene.model)
    if scene.pairs:
        info["pairs"] = [list(pair) for pair in scene.pairs]  # of each row, which the channel `pair` counts from 1
    if scene.adaptive:
        taken, rejected, evaluations = y[slice(*scene.part("step_control"))][pace.STEPS : pace.LAST]
        info |= {"rtol": run.plan.rtol, "atol": run.plan.atol}
        info |= {"steps": int(taken), "rejected_steps": int(rejected), "evaluations": int(evaluations)}
    return Trajectory(run.named(out, schedule), status, message, end, y, info, parts=scene.parts)


def classify(scene: CompiledScene, end: float, y: np.ndarray) -> Outcome:
    """Classify a run by its final state; end: the time at which the run ends if nothing fails [s]."""
    status = OF_CODE[int(y[scene.layout["status"]])]
    if status is not Status.OK:
        return _failure(scene, status, y)
    wrong = beyond_stability(scene) or _unresolved_stop(scene, y) or _chatter(scene, y)
    missed = y[scene.part("newton_iterations")[0] + 1]
    if wrong is None and missed > 0:
        message = f"{missed:.0f} implicit steps missed their tolerance"
        if scene.model.loops:
            message = f"{missed:.0f} steps missed their tolerance{_opened(scene, y)}: use a smaller timestep"
        if scene.pairs and (scene.method.explicit or scene.method.theta < 1.0):  # forces are not those at steps' ends
            also = "" if scene.method.explicit else f"{message}, or "
            message = (
                f"{also}bodies moved by more than they measure in {scene.timestep:g} s, a step of {scene.integrator}, "
                "and may have jumped over each other: use a smaller timestep, or implicit_euler or error control"
            )
        wrong = Outcome(Status.NOT_CONVERGED, message)
    return Outcome(Status.OK, "", end) if wrong is None else wrong._replace(end_time=end)


def _opened(scene: CompiledScene, y: np.ndarray) -> str:
    """Return part of a sentence that names the loop that is open most in a state, if one is."""
    gaps = open_rows(scene, y)[0]
    names, worst = [loop.name for loop in scene.model.loops for _ in range(loop.rows)], int(gaps.argmax())
    return f", and loop {names[worst]!r} is open by {gaps[worst]:.3g} m or rad" if gaps[worst] > CLOSED else ""


def _strained(scene: CompiledScene, y: np.ndarray) -> str:
    """Return part of a sentence that names the tendon farthest beyond its limits in a state, if one is."""
    alone = [(one.scene, scene.state_of(one.name, y), f"{one.name}/") for one in scene.members]
    found = [(0.0, 0.0, "")]
    for of, own, name in alone or [(scene, y, "")]:
        limited = [one for one in of.model.tendons if one.limited]
        for one, length in zip(limited, lengths_of(of.model, positions_in(of, own), limited).tolist()):
            found += [
                (one.lower - length, one.lower, name + one.name),
                (length - one.upper, one.upper, name + one.name),
            ]
    beyond, limit, tendon = max(found)
    if not beyond > 0.0:
        return ""
    return (
        f", where tendon {tendon!r} is {beyond:.3g} m or rad beyond its limit of {limit:.4g}: check this limit and the "
        "tendon's moment arms there"
    )


def _failure(scene: CompiledScene, status: Status, y: np.ndarray) -> Outcome:
    name, end = scene.model.name, float(y[scene.layout["end_time"]])
    message = f"{_who_fell(scene, y) if status is Status.FELL else name} {status} at {end:.4g} s"
    if status is Status.STEP_TOO_SMALL:
        least = max(least_step(scene), PROGRESS / STALLED)
        message = f"{name}: the tolerance asks for steps below {least:.2g} s at {end:.4g} s{_strained(scene, y)}"
    if status is Status.TOO_MANY_CONTACTS:
        slots = scene.part("pair")[1] - scene.part("pair")[0]
        message = (
            f"{name}: at {end:.4g} s more pairs are near than the {slots} points of the pool hold{_crowded(scene, y)}; "
            "give it more, pairs=PairContact(..., max_points=N), or choose fewer pairs"
        )
    if status is Status.TOO_DEEP:
        message = f"{name}: {_sunk(scene, y)} at {end:.4g} s"
    if status is Status.TOO_COSTLY:
        taken, rejected = y[slice(*scene.part("step_control"))][[pace.STEPS, pace.REJECTED]]
        limit, by = scene.preflight.worst, "discontinuities or fast motion limit them"
        if limit is not None:
            by = f"{limit.joint} limits explicit ones to {limit.step:.2g} s by its {limit.cause}"
        message = (
            f"{name}: {scene.integrator} took {taken + rejected:.0f} steps ({rejected:.0f} rejected) up to "
            f"{end:.4g} s; {by}: raise rtol, or use implicit_euler or midpoint at a fixed step"
        )
    loose = what_is_loose_at(scene, y, LOOSE)
    if status is not Status.FELL and loose is not None:
        return Outcome(status, f"{message}; {loose}", end)
    speeds = np.abs(y[slice(*scene.part("qd"))])
    if status is Status.DIVERGED and len(speeds):
        joint = scene.model.joint_names[int(speeds.argmax())]
        message += f"; in the last sound state the fastest joint was {joint} at {speeds.max():.3g} rad/s or m/s"
    return Outcome(status, message, end)


def _names(model: Model) -> dict[str, Any]:
    """Return the names of a robot, its joints and, where it has ball joints, its positions."""
    positions = {"positions_of": list(model.position_names)} if model.balls else {}
    loops = {"loops_of": [one.name for one in model.loops], "rows_of": row_names(model)} if model.loops else {}
    return {"robot": model.name, "joints_of": list(model.joint_names), **positions, **loops}


def row_names(model: Model) -> list[str]:
    """Return the names of the rows of all loops."""
    return [name for loop in model.loops for name in loop.row_names]


def _crowded(scene: CompiledScene, y: np.ndarray) -> str:
    """Return part of a sentence that names the link with the most points of the pool."""
    owners = y[slice(*scene.part("pair"))].astype(int)
    of_link = Counter(link for row in owners[owners > 0] - 1 for link in scene.pairs[row])
    link, count = max(of_link.items(), key=lambda item: item[1], default=("", 0))
    return f", {count} of which {link!r} has" if count else ""


def _sunk(scene: CompiledScene, y: np.ndarray) -> str:
    """Return a sentence on the deepest contact of a state, by how deep it may be: between bodies, or on the ground."""
    found, pairs, contact = list[tuple[float, float, str, str]](), scene.touching.table, scene.constants.contact
    if pairs is not None:
        rows, gaps = (y[slice(*scene.part(name))] for name in ("pair", "pair_gap"))
        for row, gap in zip(rows[rows > 0].astype(int) - 1, gaps[rows > 0]):
            most = float(pairs.pairs.deepest[row])
            found.append((-gap / most, most, " and ".join(map(repr, scene.pairs[row])), BETWEEN))
    if contact is not None:
        alone = [(one.scene, scene.state_of(one.name, y), f"{one.name}/") for one in scene.members]
        for of, own, name in alone or [(scene, y, "")]:
            if of.constants.contact is not None and of.ground is not None:
                poses, order = link_poses(of.model, positions_in(of, own)), by_body(of.model, of.tree)
                at = deepest_points(of.model, poses, plane_axes(of.ground)[0])
                depths = -over_ground(of.ground, at)[order]
                limits = of.constants.contact.points.deepest
                k = int((depths / limits).argmax())
                link = name + of.model.contacts[order[k]].link
                found.append((float(depths[k] / limits[k]), float(limits[k]), f"{link!r} and 'ground'", ON_GROUND))
    _, most, names, what = max(found, default=(0.0, 0.0, "bodies", BETWEEN))
    return f"{names} are in each other by more than {most:.3g} m: {what}"


def _who_fell(scene: CompiledScene, y: np.ndarray) -> str:
    """Return which robots of a scene have fallen."""
    fallen = []
    for member in scene.members:
        alone, own = member.scene, scene.state_of(member.name, y)
        if alone.tree.floating and alone.tree.n and alone.ground is not None:
            view = alone.state_view(own)
            base, q = view.base_q, positions_in(alone, own)
            upright = float(dot(rotation_from_quaternion(base[3:])[2], alone.upright))
            height = over_ground(alone.ground, center_of_mass(alone.model, q)[None])[0]
            if upright < alone.fall_upright or height < alone.fall_height:
                fallen.append(member.name)
    return ", ".join(fallen) or scene.model.name


def beyond_stability(scene: CompiledScene) -> Outcome | None:
    """Find a fixed step too large for an explicit integrator."""
    largest = scene.method.stability * scene.preflight.sliding_step
    if scene.adaptive or not scene.timestep > largest:
        return None
    message = f"{scene.integrator} is stable up to {largest:.2g} s in this scene; the step is {scene.timestep:g} s"
    return Outcome(Status.NOT_CONVERGED, message)


def _unresolved_stop(scene: CompiledScene, y: np.ndarray) -> Outcome | None:
    """Find a joint whose stop an explicit integrator has met with too large a step."""
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
    return Outcome(Status.NOT_CONVERGED, message)


def _chatter(scene: CompiledScene, y: np.ndarray) -> Outcome | None:
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
    return Outcome(Status.CHATTER, message)
