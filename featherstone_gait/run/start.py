"""Make and check the states from which a simulation begins."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import instance, shown, texts, truth, vector
from ..base.fixed_order import total
from ..base.flaws import quoted
from ..core.effects.actuator import controller_of
from ..core.effects.controller import PID_SPEED
from ..core.effects.firmware import TURN
from ..core.step import pace
from ..core.step.closure import Closing, LoopScratch, measure_loops
from ..core.step.signals import Knots
from ..core.tree.loop import BIAS, GAP, PLACE, SPEED
from ..core.tree.rows import make_rows
from ..dynamics import forward_kinematics, loop_gaps
from ..dynamics.algorithms import lengths_of, loop_measures
from ..dynamics.inverse_kinematics import close_loops, is_flipped
from ..model import Model
from ..model.composite import TOLERANCE
from ..model.numpy_dynamics import at_joints, what_is_loose, with_quaternions
from ..model.rest_posture import start_positions
from ..scene.compile import CompiledScene
from ..scene.contact import standing_height
from ..scene.forest import Member, largest_tree, named, state_index
from ..scene.loop import build_loops, joined_loops
from ..scene.tree import check_followers, followed
from .status import OF_CODE
from .trajectory import Trajectory

FIRST_STEP, FIRST_COLUMNS = 1e-3, 5  # where error control begins [s]
CLOSED = 1e-9  # gap at the start that counts as none [m or rad], and speed of it by the fastest coordinate
OVERSHOOT = 1e-2  # beyond a limit, as far as a joint presses into its stop [rad or m]
SHORTEST, LONGEST = 1e-6, 1e6  # quaternion that has a direction


def initial_state(
    scene: CompiledScene,
    q: ArrayLike | Mapping[str, ArrayLike] | None = None,
    qd: ArrayLike | Mapping[str, ArrayLike] | None = None,
    allow_limit_violation: bool = False,
    open_loops: Sequence[str] = (),
) -> np.ndarray:
    """Return the state of a robot at given positions and velocities.

    Rotors and profiled references are at their joints' positions; currents, contact deflections and voltages are zero.

    Parameters
    ----------
    scene
        A compiled scene.
    q
        Positions (nq,) [m, -, rad].  None: joints as in the keyframe "qpos0", which MJCF with `ref` has, else zero,
        with coupled joints where their leaders put them; a floating robot over ground stands with its lowest contact
        point at the ground's `penetration`, or is where loops to the world hold it.  Of a scene of several robots and
        objects a dictionary, by name; each that is not named is at its place.  Where this default is beyond limits,
        a warning names the joints.
    qd
        Velocities (nv,) [m/s, rad/s], or a dictionary of such.  None: zero.
    allow_limit_violation
        Allow a joint more than 0.01 rad or m beyond its limits, whose stop then throws it back.
    open_loops
        Names of loops that are open; `switch_loop` makes them.

    Returns
    -------
    ndarray
        State (size,); `CompiledScene.state_view` names its parts.

    Raises
    ------
    ValueError
        For numbers that do not fit, coupled joints that do not agree with their leaders, and a joint beyond its limits.
    """
    check_scene(scene)
    truth("allow_limit_violation", allow_limit_violation)
    names = loop_names(scene, open_loops)
    if scene.members:
        return _of_members(scene, q, qd, allow_limit_violation, names)
    model, o, n = scene.model, scene.layout, scene.tree.n
    y = np.zeros(o["length"])
    y[o["step_control"] + np.array([pace.STEP, pace.COLUMNS, pace.LAST])] = FIRST_STEP, FIRST_COLUMNS, 1e-4
    default = _default(model, scene, names if q is None else None, stands=q is None)
    if not allow_limit_violation:
        beyond = _beyond_limits(model, default if q is None else vector("q", q, model.nq))
        if beyond and q is not None:
            raise ValueError(f"{model.name}: {beyond[0]}; start it between them, or pass allow_limit_violation=True")
        if beyond:
            remedy = "give q, such as nearest_posture(model), or allow_limit_violation=True"
            text = f"{model.name}: {', '.join(beyond)} at the start, and thrown back by its stop: {remedy}"
            warnings.warn(text, stacklevel=2)
    q = vector("q", default if q is None else q, model.nq)
    qd = vector("qd", np.zeros(model.nv) if qd is None else qd, model.nv)
    check_quaternion(scene, q[3:7], SHORTEST, LONGEST)
    view = scene.state_view(y)
    if model.loops:
        held = build_loops(model).held
        view.loop_closed[:] = [loop.name not in names for loop in model.loops]
        view.loop_place[...] = held[1].reshape(-1, PLACE)
    joints, rates = model.single_positions(q), qd[len(qd) - n :]
    check_followers(model, scene.tree.coupling, joints, rates)
    given = {"q": joints, "qd": rates, "filtered_speed": rates, "rotor": joints, "rotor_speed": rates}
    given |= {"profiled_reference": joints, "base_q": q[:7], "base_qd": qd[:6]}
    for name, values in given.items():
        if name in view:
            view[name][...] = values
    if scene.constants.surfaces is not None:
        view.surface_command[:] = scene.constants.surfaces
    if scene.constants.supply is not None:
        y[o["bus_voltage"]] = scene.constants.supply[0].voltage
    if model.base == "floating":
        view.base_q[3:] /= math.sqrt(total(q[3:7] * q[3:7]))
    for ball, dof, name in zip(view.ball_q, model.balls, model.ball_names):
        turned = q[model.position_slices[dof]]
        check_unit(f"{model.name}: q of ball joint {name!r}", turned, SHORTEST, LONGEST)
        ball[:] = turned / math.sqrt(total(turned * turned))
    if model.loops:
        _check_closed(scene, y)
    return y


def _default(
    model: Model,
    scene: CompiledScene,
    open_loops: Sequence[str] | None = None,
    base: Sequence[float] = (),
    stands: bool = False,
) -> np.ndarray:
    """Return the positions (nq,) of the start, with followers where their leaders put them, and loops closed but these.

    open_loops None: all loops are left as they are.  base: pose (7,) of a floating one, which `stands` puts at the
    height at which it stands on the ground.  Without a pose loops to the world move the base as well.
    """
    q = at_joints(model, followed(scene.tree.coupling, start_positions(model)))
    loops = tuple(loop for loop in model.loops if open_loops is not None and loop.name not in open_loops)
    tied = any(loop.b is None for loop in loops)  # to the world: they close where the base is to be
    q = _with_base(model, scene, q, base, stands) if tied else q
    if loops:
        closed = replace(model, loops=loops)
        if np.abs(loop_gaps(closed, q)).max() > CLOSED:
            q = close_loops(closed, q, hold_base=len(base) > 0 or not tied)
    return q if tied else _with_base(model, scene, q, base, stands)


def _with_base(model: Model, scene: CompiledScene, q: np.ndarray, base: Sequence[float], stands: bool) -> np.ndarray:
    """Return positions (nq,) with a floating base at its pose (7,), on the ground if it stands; no pose keeps it."""
    q = np.array([*base, *q[len(base) :]])
    if stands and model.base == "floating" and scene.ground is not None:
        q[2] = standing_height(model, scene.ground, q)
    return q


def _of_members(
    scene: CompiledScene, q: Any, qd: Any, allow_limit_violation: bool, open_loops: Sequence[str]
) -> np.ndarray:
    """Return the state of all members, each at the positions that are given for it, or else at its place."""
    y, given = np.zeros(scene.layout["length"]), {"q": q, "qd": qd}
    for what, values in given.items():
        remedy = f"give a dictionary by name, {what}={{{scene.members[0].name!r}: ...}}"
        given[what] = {} if values is None else values
        instance(what, given[what], Mapping, remedy)
        for name in given[what]:
            if name not in scene.shares:
                known = ", ".join(member.name for member in scene.members)
                raise ValueError(f"{what}: there is no robot or object {shown(name)}; there are {known}")
    for k, member in enumerate(scene.members):
        opened = [loop.name for loop in member.model.loops if named(member, loop.name) in open_loops]
        own = given["q"].get(member.name)
        own = placed_position(member, opened) if own is None else own
        one = initial_state(member.scene, own, given["qd"].get(member.name), allow_limit_violation, opened)
        y[state_index(scene, member)] = one
        at = [*member.placed.position, 0.0][:3]
        if not member.scene.tree.floating:
            scene.state_view(y).base_q.reshape(-1, 7)[k] = *at, *member.placed.orientation
    if scene.constants.surfaces is not None:  # those of obstacles are no member's
        scene.state_view(y).surface_command[:] = scene.constants.surfaces
    found = joined_loops(scene.members, scene.tree, scene.options.loops)
    if found is not None:
        view = scene.state_view(y)
        view.loop_closed[:] = [loop.name not in open_loops for loop in scene.model.loops]
        view.loop_place[...] = found.held[1].reshape(-1, PLACE)
        _check_closed(scene, y)
    return y


def placed_position(member: Member, open_loops: Sequence[str] = ()) -> np.ndarray:
    """Return the positions (nq,) of a member at its place: a base without a height stands on the ground."""
    model, scene, placed = member.model, member.scene, member.placed
    if model.base == "fixed":
        return _default(model, scene, open_loops)
    base = *[*placed.position, 0.0][:3], *placed.orientation
    return _default(model, scene, open_loops, base, stands=len(placed.position) == 2)


def reset_time(scene: CompiledScene, state: ArrayLike) -> np.ndarray:
    """Return a copy of the final state (size,) of a run with its time at zero.

    A run from it is a new one: references, torques and pushes begin at zero, and controllers forget their last error.

    Parameters
    ----------
    scene
        A compiled scene.
    state
        State (size,).

    Returns
    -------
    ndarray
        State (size,).
    """
    check_scene(scene)
    y = vector("state", state, scene.layout["length"]).copy()
    y[scene.layout["end_time"]] = 0.0
    return y


def standing_state(scene: CompiledScene, angles: ArrayLike, allow_limit_violation: bool = False) -> np.ndarray:
    """Return the state of a floating robot at rest on the ground over the origin, with its base upright.

    Parameters
    ----------
    scene
        A compiled scene with ground.
    angles
        Joint positions (joints,) [rad or m].
    allow_limit_violation
        As in `initial_state`.

    Returns
    -------
    ndarray
        State (size,).

    Raises
    ------
    ValueError
        For a fixed base, without ground, and as `initial_state`.
    """
    check_one(scene, "standing_state")
    model = scene.model
    if model.base != "floating" or scene.ground is None:
        raise ValueError(f"{model.name}: only a floating robot over ground stands; its base is {model.base}")
    check_no_balls(scene, "standing_state")
    q = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, *vector("angles", angles, scene.tree.n)])
    if model.loops:
        passive = [name for name in model.joint_names if name not in model.servos]
        q = close_loops(model, q, joints=passive if model.servos else None, hold_base=True)
    q[2] = standing_height(model, scene.ground, q)
    return initial_state(scene, q, allow_limit_violation=allow_limit_violation)


def check_scene(scene: CompiledScene) -> None:
    """Raise TypeError unless it is one."""
    instance("scene", scene, CompiledScene, "give what compile_scene returns")


def check_one(scene: CompiledScene, what: str) -> None:
    """Raise ValueError for a scene of several robots, where `what` is of one."""
    check_scene(scene)
    if scene.members:
        name = scene.members[0].name
        raise ValueError(
            f"{scene.model.name}: {what} is of one robot alone; take that of one member, "
            f"scene.member({name!r}).scene, and its run, run[{name!r}]"
        )


def check_no_balls(scene: CompiledScene, what: str) -> None:
    """Raise ValueError for a robot with ball joints, whose orientations `what` does not know."""
    if scene.tree.balls is not None:
        names = ", ".join(scene.model.ball_names)
        raise ValueError(
            f"{scene.model.name}: {what} knows no ball joints, here {names}; make them universal joints with "
            "a continuous one, or lock them"
        )


def check_quaternion(scene: CompiledScene, quaternion: np.ndarray, shortest: float, longest: float) -> None:
    """Raise ValueError for the quaternion (4,) of a floating base whose length is not within the bounds."""
    if scene.tree.floating:
        check_unit(f"{scene.model.name}: the base's quaternion q[3:7]", quaternion, shortest, longest)


def check_unit(what: str, quaternion: np.ndarray, shortest: float, longest: float) -> None:
    """Raise ValueError for a quaternion (4,) whose length is not within the bounds."""
    with np.errstate(over="ignore"):
        length = np.linalg.norm(quaternion)
    if not shortest <= length <= longest:
        raise ValueError(
            f"{what} is {quaternion}, of length {length:g}; expected "
            f"{shortest:g} to {longest:g}: give w x y z, [1, 0, 0, 0] is no rotation"
        )


def loop_names(scene: CompiledScene, names: Any, what: str = "open_loops") -> list[str]:
    """Return names of loops of a scene; ValueError for others, which names the argument `what`."""
    names, known = texts(what, names, "give a list of names"), [loop.name for loop in scene.model.loops]
    for name in names:
        if name not in known:
            raise ValueError(f"{what}: there is no loop {name!r}; loops: {quoted(known) or 'none'}: use one of them")
    return names


def gaps_and_speeds(scene: CompiledScene, y: np.ndarray) -> np.ndarray:
    """Compute by how much loops are open in a state [m or rad], and how fast these gaps grow (2, rows)."""
    view = scene.state_view(y)
    if not scene.members:
        rates = np.concatenate([view.base_qd, view.qd])
        return loop_measures(scene.model, positions_in(scene, y), rates, view.loop_place.ravel())[0][0, :2]
    return loop_rows(scene, y)[:2]


def loop_rows(scene: CompiledScene, y: np.ndarray) -> np.ndarray:
    """Compute gaps of loops, their rates and what the rates change by without accelerations, in a state (3, rows)."""
    work = scratch_of_loops(scene)
    measure_loops(scene.constants.loops, scene.constants, scene.places, work, y)
    return work.rows.loops[:, [GAP, SPEED, BIAS]].T


def scratch_of_loops(scene: CompiledScene) -> LoopScratch:
    """Make the scratch arrays with which loops of a state are measured and closed."""
    tree, count = scene.tree, sum(loop.rows for loop in scene.model.loops)
    sides = (1 if tree.trees is None else len(tree.trees)), largest_tree(scene.constants)
    blocks = len(scene.model.loops) + len(scene.model.couplings)
    rows = make_rows(blocks, count + len(scene.model.couplings), sides, count, np.zeros)
    balls = 0 if tree.balls is None else len(tree.balls)
    closing = Closing(np.zeros((len(tree.bodies), 6)), np.zeros(tree.n + 6), np.zeros(7 + 4 * balls))
    return LoopScratch(np.zeros(tree.workspace_shape()), rows, closing)


def open_rows(scene: CompiledScene, y: np.ndarray) -> np.ndarray:
    """Compute the sizes of gaps of closed loops in a state [m or rad], and of their rates (2, rows); 0 of open ones."""
    closed = np.repeat(scene.state_view(y).loop_closed > 0.0, [loop.rows for loop in scene.model.loops])
    return np.where(closed, np.abs(gaps_and_speeds(scene, y)), 0.0)


def _check_closed(scene: CompiledScene, y: np.ndarray) -> None:
    """Raise ValueError for a state in which closed loops are open."""
    model, view, (gaps, speeds) = scene.model, scene.state_view(y), open_rows(scene, y)
    names = [loop.name for loop in model.loops for _ in range(loop.rows)]
    fastest = max(float(np.abs(rates).max(initial=1.0)) for rates in (view.base_qd, view.qd))
    remedies = "give close_loops(model, q)", "give velocities with loop_jacobian(model, q) @ qd = 0"
    if scene.members:
        remedies = "place the members so that its ends meet", "give velocities at which its ends move as one"
    for what, values, most, unit, remedy in (
        ("q", gaps, CLOSED, "m or rad", remedies[0]),
        ("qd", speeds, CLOSED * fastest, "m/s or rad/s", remedies[1]),
    ):
        worst = int(values.argmax())
        if not values[worst] <= most:
            opened = f"loop {names[worst]!r} is open by {values[worst]:.6g} {unit}"
            raise ValueError(
                f"{model.name}: at this {what} {opened}; at most {most:.1g}: {remedy}, or name it in open_loops"
            )
    if scene.members:
        return
    poses, own = forward_kinematics(model, positions_in(scene, y)), build_loops(model).held[1].reshape(-1, PLACE)
    for loop, closed, place, first in zip(model.loops, view.loop_closed, view.loop_place, own):
        if closed and np.array_equal(place, first) and is_flipped(model, poses, loop):
            raise ValueError(
                f"{model.name}: at this q loop {loop.name!r} is off by half a turn; {remedies[0]}, from near a "
                "closed posture"
            )


def _beyond_limits(model: Model, q: np.ndarray) -> list[str]:
    """Say of each joint that is far beyond its limits at positions (nq,) [rad or m] where it is."""
    at = list(zip(model.moving_joints, model.single_positions(q).tolist()))
    for ball, dof in zip((joint for joint in model.joints if joint.name in model.ball_names), model.balls):
        turn = q[model.position_slices[dof]]
        at.append((ball, 2.0 * math.atan2(float(np.linalg.norm(turn[1:])), abs(float(turn[0])))))
    return [
        f"joint {joint.name!r} is at {position:.6g} rad or m, beyond its limits {joint.lower:.6g} to {joint.upper:.6g}"
        for joint, position in at
        if not joint.lower - OVERSHOOT <= position <= joint.upper + OVERSHOOT
    ]


def checked_state(scene: CompiledScene, state: ArrayLike | Trajectory) -> np.ndarray:
    """Return a state (length,), or that at the end of a trajectory, checked to be one of the scene."""
    if not isinstance(state, Trajectory):
        return _sound(scene, state)
    robot, joints = state.info.get("robot"), state.info.get("joints")
    if robot != scene.model.name or list(joints or ()) != list(scene.model.joint_names):
        raise ValueError(
            f"state: the trajectory is of {robot} with the joints {', '.join(joints or ())}; this scene is of "
            f"{scene.model.name} with {', '.join(scene.model.joint_names)}: give its `final` if that is meant"
        )
    if state.parts is not None and state.parts != scene.parts:
        raise ValueError(
            f"state: the trajectory of {state.info.get('robot')} ended in a state of {_sizes(state.parts)}; "
            f"this scene of {scene.model.name} has {_sizes(scene.parts)}: compile it with the same servos and contacts"
        )
    return _sound(scene, state.final)


def _sound(scene: CompiledScene, values: ArrayLike) -> np.ndarray:
    """Return a state as a vector; ValueError for numbers that no run ends with."""
    y = vector("state", values, scene.layout["length"], "what initial_state gave, or the end of a run")
    for base in y[slice(*scene.part("base_q"))].reshape(-1, 7):
        check_quaternion(scene, base[3:], 0.5, 2.0)
    for ball in y[slice(*scene.part("ball_q"))].reshape(-1, 4):
        check_unit(f"{scene.model.name}: a ball joint's quaternion in the state", ball, 0.5, 2.0)
    status, own = y[scene.layout["status"]], y[scene.part("step_control")[0] :]
    if status not in OF_CODE or not (own >= 0.0).all():
        raise ValueError(
            f"{scene.model.name}: state: its last {len(own)} numbers, pace, status {status:g} and time of a run, are "
            f"{own}; `simulate` returns no such state: make it with initial_state"
        )
    if scene.model.loops:
        try:
            _check_closed(scene, y)
        except ValueError as error:
            raise ValueError(f"state: {error}") from error
    return y


def what_is_loose_at(scene: CompiledScene, y: np.ndarray, least: float = TOLERANCE) -> str | None:
    """Describe what can move without inertia in a state (length,); None if nothing can: see `what_is_loose`."""
    if scene.members:
        loose = (what_is_loose_at(one.scene, scene.state_of(one.name, y), least) for one in scene.members)
        return next((one for one in loose if one is not None), None)
    q = positions_in(scene, y)
    return what_is_loose(scene.model, q, scene.constants.armature, least)


def positions_in(scene: CompiledScene, y: np.ndarray) -> np.ndarray:
    """Return the positions q (nq,) in a state (length,) of one robot."""
    base_q, ball_q, joints = (y[slice(*scene.part(name))] for name in ("base_q", "ball_q", "q"))
    return np.concatenate([base_q, with_quaternions(scene.model, joints, ball_q)])


def driven_lengths(scene: CompiledScene, y: np.ndarray) -> np.ndarray:
    """Return the lengths of the tendons that have a drive, in a state (length,) [m or rad]."""
    if not scene.driven_tendons:
        return np.zeros(0)
    if not scene.members:
        return lengths_of(scene.model, positions_in(scene, y), scene.driven_tendons)
    each = (driven_lengths(one.scene, scene.state_of(one.name, y)) for one in scene.members)
    return np.concatenate(list(each))


def columns_of(scene: CompiledScene, signal: ArrayLike) -> int:
    """Return how many numbers a constant signal is to have: those of the joints, or of driven tendons too."""
    return scene.tree.n if np.size(signal) == scene.tree.n else scene.inputs


def _sizes(parts: dict[str, tuple[int, int]]) -> str:
    return ", ".join(f"{name} {end - first}" for name, (first, end) in parts.items() if end > first)


def with_first_error(scene: CompiledScene, y: np.ndarray, reference: Knots | None) -> np.ndarray:
    """Return a first state (length,) with the controllers' last error, so that a derivative term sees no jump."""
    if not scene.sampled or reference is None or y[scene.layout["end_time"]] > 0:  # there is none, or the run goes on
        return y
    n, o, y = scene.tree.n, scene.layout, y.copy()
    firmware = scene.constants.firmware
    goal = reference.cubics[0, :, 0] if firmware.profile is None else y[slice(*scene.part("profiled_reference"))]
    speed = controller_of(scene.constants.actuator).law == PID_SPEED
    error = np.where(speed, 0.0, goal) - np.where(speed, y[o["qd"] : o["qd"] + n], y[o["q"] : o["q"] + n])
    if firmware.wrap is not None:
        whole = np.round(error / TURN)
        whole -= error / TURN - whole <= -0.5
        error -= firmware.wrap * whole * TURN
    if firmware.band is not None:
        error -= np.clip(error, -firmware.band.compliance_margin, firmware.band.compliance_margin)
    y[o["last_error"] : o["last_error"] + n] = error
    return y
