"""Inverse kinematics: a posture that puts points of links, or the center of mass, where they are wanted.

Damped least squares (C. W. Wampler, IEEE Trans. SMC 16 (1986); Y. Nakamura and H. Hanafusa, J. Dyn. Sys. Meas. Control
108 (1986)): with the error ``e`` of all targets and its Jacobian ``J`` a step is ``J' (J J' + lambda 1)^-1 e``.  The
damping ``lambda = mu |e|^2`` vanishes with the error, so that convergence stays superlinear (T. Sugihara, IEEE T-RO 27
(2011)); mu follows the gain of each step, and a step without gain is taken back (J. Fan, J. Comput. Math. 21 (2003)).
Joints that are pushed against their limits stand still, the others stop at theirs (D. P. Bertsekas, SIAM J. Control
Optim. 20 (1982)).  The iteration has settled where the error is orthogonal to all columns that may move (J. J. More,
Lecture Notes in Mathematics 630 (1978)).  The result has the same bits on any processor.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import finite, floats, instance, listed, real, shown, texts, vector, whole
from ..base.brief import brief
from ..base.fixed_order import applied, product, solve, total
from ..base.rotation import cross, dot, rotation_from_rpy
from ..core.compile.elementary import NEAR
from ..model import Joint, Loop, Model
from ..model.numpy_dynamics import at_joints
from .jacobians import center_of_mass_at, center_of_mass_jacobian_at, jacobian_at, point_at
from .kinematics import Poses, forward_kinematics
from .loops import loop_gaps, loop_measures
from .states import check_model

Status = Literal["ok", "limits", "out of reach", "not converged"]

MOST_TRIES = 10**9  # iterations, and starts
HEAVIEST = 1e20  # weight, whose square is still far below the largest number
TIGHTEST = 1e-300  # tolerance, whose square is still above zero
SETTLED = 1e-6  # largest cosine between the error and a column of its Jacobian
LEAST_DAMPING = 1e-12  # of the mean of J J' over its diagonal: targets may depend on each other
LEAST_GAIN = 1e-4  # of what a step promises
ROUNDING = 1e-15  # of the squared error: a step that promises less gains nothing
LARGEST_TURN = 1.0  # of a joint or the base in one step [rad]
NUDGE = 0.01  # [rad or m] off a posture that has settled: a stretched arm sees no way inwards
CLOSED = 1e-9  # gap of loops that counts as none [m or rad]
ORTHOGONAL = 1e-6  # how far a rotation matrix may be from one


class Target(NamedTuple):
    """A target of a link: the position of one of its points, its orientation, or both.

    Weights are numbers, or one for each of the world's axes; a part with the weight 0 is ignored.

    Attributes
    ----------
    link : str or None
        Name of the link; None for the robot's center of mass.
    position : array_like, optional
        Position (3,) of the point in the world [m].
    rotation : array_like, optional
        Rotation (3, 3) link -> world, or roll, pitch and yaw (3,) about fixed axes [rad].
    point : array_like
        The point (3,) in the frame of the link [m].
    weight : array_like
        Weight of the position, () or (3,).
    orientation_weight : array_like
        Weight of the rotation, () or (3,).
    """

    link: str | None
    position: ArrayLike | None = None
    rotation: ArrayLike | None = None
    point: ArrayLike = (0.0, 0.0, 0.0)
    weight: ArrayLike = 1.0
    orientation_weight: ArrayLike = 1.0

    def __repr__(self) -> str:
        return brief(self)


class IKResult(NamedTuple):
    """The result of `inverse_kinematics`.

    Attributes
    ----------
    q : numpy.ndarray
        Positions (nq,) within the limits [m, -, rad or m].
    status : {"ok", "limits", "out of reach", "not converged"}
        How the search has ended; see `inverse_kinematics`.
    error : float
        Remaining error: root of the sum of squares of all weighted errors [m and rad].
    iterations : int
        Number of iterations.
    """

    q: np.ndarray
    status: Status
    error: float
    iterations: int

    def __repr__(self) -> str:
        return brief(self)

    @property
    def ok(self) -> bool:
        """True if all targets are met."""
        return self.status == "ok"


def inverse_kinematics(
    model: Model,
    targets: Target | Sequence[Target],
    q0: ArrayLike | None = None,
    *,
    joints: Iterable[str] | None = None,
    hold_base: bool = False,
    restarts: int = 0,
    seed: int = 0,
    tolerance: float = 1e-9,
    max_iterations: int = 200,
) -> IKResult:
    """Find the posture near q0 that meets all targets, or misses them by the least.

    Loops (`Model.loops`) are targets too: their gaps count with the weight 1.

    Parameters
    ----------
    model : Model
        The robot.
    targets : Target or sequence of Target
        What to reach.
    q0 : array_like, optional
        Positions (nq,) to start from [m, -, rad or m]; joints beyond their limits start at them.  None: the middle of
        the joint ranges, 0 where there is none, a floating base at the origin.
    joints : iterable of str, optional
        Names of the joints that may move; None for all.  A coupled joint (`Joint.mimic`) follows its leader exactly.
    hold_base : bool, optional
        Whether a floating base stays as it is in q0.
    restarts : int, optional
        Number of random postures within the limits to start from, one after the other, until one succeeds.
    seed : int, optional
        Seed of these postures.
    tolerance : float, optional
        Error at which the targets are met [m and rad, weighted].
    max_iterations : int, optional
        Limit of iterations for each start.

    Returns
    -------
    IKResult
        The posture.  Its status is "ok"; "limits", if the targets are met only beyond the limits of joints; "out of
        reach", if not even there; or "not converged" within `max_iterations`.  The last three hold near the start:
        other starts may do better.

    Raises
    ------
    ValueError
        For links and joints that do not exist, and for numbers that make no sense.
    """
    check_model(model)
    instance("hold_base", hold_base, (bool, np.bool_), "give True or False")
    remedy = "give Target(link, position) or a list of them"
    found = [targets] if isinstance(targets, Target) else listed("targets", targets, remedy)
    for target in found:
        if not isinstance(target, Target):
            raise ValueError(f"targets holds {shown(target)}; {remedy}")
    goals = [_goal(model, target) for target in found]
    if not goals:
        raise ValueError(f"{model.name}: there is no target; give at least one Target(link, position)")
    real("tolerance", tolerance, TIGHTEST, math.inf, "1e-9 is usual")
    restarts = whole("restarts", restarts, 0, "it is how many other starts are tried", MOST_TRIES)
    max_iterations = whole("max_iterations", max_iterations, 0, "200 is usual", MOST_TRIES)
    seed = whole("seed", seed, 0, "any will do", 2**128 - 1)
    task = _Task(model, goals, _freedom(model, joints, hold_base), tolerance, max_iterations)
    rng, start = np.random.default_rng(seed), _start(task, q0)
    best = _attempt(task, start, rng)
    for _ in range(restarts):
        if best.error < tolerance:
            break
        other = _attempt(task, _anywhere(task, start, rng), rng)
        better = other if other.error < best.error else best
        best = better._replace(iterations=best.iterations + other.iterations)
    return IKResult(best.q, _status(task, best, rng), best.error, best.iterations)


def close_loops(
    model: Model,
    q: ArrayLike,
    *,
    joints: Iterable[str] | None = None,
    hold_base: bool = False,
    tolerance: float = 1e-11,
    max_iterations: int = 200,
) -> np.ndarray:
    """Find the posture near q in which all loops are closed, within the limits of the joints.

    Each step is the shortest in the joints that closes the loops to first order (Gauss and Newton), damped as that of
    `inverse_kinematics`.

    Parameters
    ----------
    model : Model
        The robot.
    q : array_like
        Positions (nq,) to start from [m, -, rad or m]; joints beyond their limits start at them.
    joints : iterable of str, optional
        Names of the joints that may move; None for all.
    hold_base : bool, optional
        Whether a floating base stays where it is.
    tolerance : float, optional
        Root of the sum of squares of all gaps at which the search ends [m and rad]; where it comes no nearer, since
        digits of a file let the axes of a linkage differ, 1e-9 is enough.
    max_iterations : int, optional
        Limit of iterations.

    Returns
    -------
    numpy.ndarray
        Positions (nq,).

    Raises
    ------
    ValueError
        If no posture near q closes all loops; the message names the loop with the largest gap.
    """
    check_model(model)
    instance("hold_base", hold_base, (bool, np.bool_), "give True or False")
    real("tolerance", tolerance, TIGHTEST, math.inf, "1e-11 is usual")
    max_iterations = whole("max_iterations", max_iterations, 0, "200 is usual", MOST_TRIES)
    task = _Task(model, [], _freedom(model, joints, hold_base), tolerance, max_iterations)
    start = _start(task, q)
    if not model.loops:
        return start
    found = _attempt(task, start, np.random.default_rng(0))
    gaps, first, worst = loop_gaps(model, found.q), 0, ("", 0.0)
    poses = forward_kinematics(model, found.q)
    for loop in model.loops:
        gap = math.sqrt(total(gaps[first : first + loop.rows] ** 2))
        gap = 2.0 if is_flipped(model, poses, loop) else gap
        worst, first = max(worst, (loop.name, gap), key=lambda pair: pair[1]), first + loop.rows
    if found.error < max(tolerance, CLOSED) and worst[1] < 2.0:
        return found.q
    raise ValueError(
        f"{model.name}: loops do not close near this posture; the gap of loop {worst[0]!r} stays at {worst[1]:.6g} "
        "[m or rad]: start from a posture closer to a closed one, free more joints, or correct the loop's points"
    )


def is_flipped(model: Model, poses: Poses, loop: Loop) -> bool:
    """Return whether a hinge or weld is turned by half a turn, where its gap vanishes too."""
    if loop.kind not in ("hinge", "weld"):
        return False
    frames = []
    for link, rpy in ((loop.a, loop.rpy_a), (loop.b, loop.rpy_b)):
        own = rotation_from_rpy(rpy)
        frames.append(own if link is None else product(poses.rotation[model.link_index(link)], own))
    if loop.kind == "hinge":
        axis = np.array(loop.axis)
        return dot(applied(frames[0], axis), applied(frames[1], axis)) < 0.0
    return float(total(total(frames[0] * frames[1]))) < 0.0


class _Goal(NamedTuple):
    """A target, checked."""

    link: str | None
    point: np.ndarray  # (3,)
    position: np.ndarray | None  # (3,)
    rotation: np.ndarray | None  # (3, 3)
    weight: np.ndarray  # (3,)
    orientation_weight: np.ndarray  # (3,)


class _Coupling(NamedTuple):
    """A joint that follows another, by their columns: position = multiplier * that of the leader + offset."""

    follower: int
    leader: int
    multiplier: float
    offset: float  # [rad or m]


class _Freedom(NamedTuple):
    """The velocity coordinates that may move, and the joints that follow them."""

    columns: np.ndarray  # (k,) of the velocity coordinates
    joint: np.ndarray  # (k,) whether it is a joint's; the base's six come first
    lower: np.ndarray  # (k,) limits, those of followers included; of the base infinite [rad or m]
    upper: np.ndarray  # (k,)
    turns: np.ndarray  # (k,) whether it is an angle
    followers: list[_Coupling]
    place: np.ndarray  # (nv,) where a joint's column has its number in q; -1 of the base and of ball joints
    balls: list[tuple[int, int]]  # first column, and place in q, of ball joints of which a degree may move
    base: bool  # whether the base may move


class _Task(NamedTuple):
    model: Model
    goals: list[_Goal]
    free: _Freedom
    tolerance: float
    max_iterations: int


class _Found(NamedTuple):
    """The end of a descent."""

    q: np.ndarray
    error: float
    iterations: int
    settled: bool


def _attempt(task: _Task, q: np.ndarray, rng: np.random.Generator) -> _Found:
    """Descend; if that ends on a saddle, such as a stretched arm, descend once more from beside it."""
    found = _descend(task, q)
    if not found.settled or found.error < task.tolerance:
        return found
    step = NUDGE * rng.uniform(-1.0, 1.0, len(task.free.columns))
    again = _descend(task, _moved(task, found.q, step)[0])
    better = again if again.error < found.error * (1.0 - SETTLED) else found
    return better._replace(iterations=found.iterations + again.iterations)


def _descend(task: _Task, q: np.ndarray) -> _Found:
    """Iterate from q until the targets are met or nothing improves."""
    free, mu, (e, J) = task.free, 1.0, _errors(task, q)
    for iteration in range(task.max_iterations):
        size, downhill, z = total(e * e), total(J * e[:, None], axis=0), _coordinates(task, q)
        active = J * np.where(downhill > 0.0, z < free.upper, z > free.lower).astype(float)  # 0 for those at a limit
        lengths = np.sqrt(total(active * active, axis=0) * size)
        settled = (np.abs(total(active * e[:, None], axis=0)) <= SETTLED * lengths).all()
        if math.sqrt(size) < task.tolerance or settled:
            return _Found(q, math.sqrt(size), iteration, True)
        new, step = _moved(task, q, _damped_step(active, e, mu * float(size), free.turns))
        left, (e_new, J_new) = e - applied(J, step), _errors(task, new)
        gain, promised = size - total(e_new * e_new), size - total(left * left)
        if abs(promised) < ROUNDING * size:
            return _Found(q, math.sqrt(size), iteration, True)
        if gain > LEAST_GAIN * promised > 0.0:
            q, e, J = new, e_new, J_new
        if promised <= 0.0 or gain < 0.25 * promised:  # its clipped part may promise nothing
            mu *= 4.0
        elif gain > 0.75 * promised:
            mu *= 0.25
    return _Found(q, math.sqrt(total(e * e)), task.max_iterations, False)


def _damped_step(J: np.ndarray, e: np.ndarray, damping: float, turns: np.ndarray) -> np.ndarray:
    """Compute J' (J J' + damping)^-1 e, shortened as a whole where an angle would turn too far."""
    A = product(J, J.T)
    diagonal = total(np.diag(A)) / len(A)
    A[np.diag_indices(len(A))] += max(damping, LEAST_DAMPING * diagonal)
    step = applied(J.T, solve(A, e[:, None])[:, 0])
    return step / max(1.0, np.abs(step[turns]).max(initial=0.0) / LARGEST_TURN)


def _moved(task: _Task, q: np.ndarray, step: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Take a step (k,) that ends at the limits, followers included; return the positions and the step taken."""
    free, place, new = task.free, task.free.place, q.copy()
    z = _coordinates(task, q)
    end = np.clip(z + step, free.lower, free.upper)
    new[place[free.columns[free.joint]]] = end[free.joint]
    if free.base:
        new[:3], new[3:7] = q[:3] + step[:3], _turned(q[3:7], step[3:6])
    for column, at in free.balls:
        turn = [step[free.columns == column + k].sum() for k in range(3)]
        new[at : at + 4] = _turned(q[at : at + 4], np.array(turn))
    for c in free.followers:
        new[place[c.follower]] = c.multiplier * new[place[c.leader]] + c.offset
    return new, end - z


def _coordinates(task: _Task, q: np.ndarray) -> np.ndarray:
    """Return the positions (k,) of the joints that may move; those of the base count from where it is."""
    return np.where(task.free.joint, q[task.free.place[task.free.columns]], 0.0)


def _turned(quaternion: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Rotate a unit quaternion w x y z by (3,) [rad] in body axes: about its axis, by 2 atan(|turn| / 2)."""
    w, x, y, z = quaternion
    a, b, c = 0.5 * turn
    new = np.array([w - x * a - y * b - z * c, x + w * a + y * c - z * b, y + w * b + z * a - x * c,
                    z + w * c + x * b - y * a])  # fmt: skip
    return new / math.sqrt(total(new * new))


def _errors(task: _Task, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute the weighted error (m,) of all targets, and its decrease by each coordinate that may move (m, k)."""
    model, free = task.model, task.free
    poses = forward_kinematics(model, q)
    parts = [part for goal in task.goals for part in _goal_errors(model, poses, goal)]
    if model.loops:
        measures, J_loops = loop_measures(model, q)
        parts.append((np.ones(J_loops.shape[1]), -measures[0, 0], J_loops[0]))
    weight = np.concatenate([w for w, _, _ in parts])
    e, J = np.concatenate([e for _, e, _ in parts]), np.concatenate([J for _, _, J in parts])
    for c in free.followers:
        J[:, c.leader] += c.multiplier * J[:, c.follower]
    kept = weight > 0.0
    return (weight * e)[kept], (weight[:, None] * J[:, free.columns])[kept]


def _goal_errors(model: Model, poses: Poses, goal: _Goal) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield weights (3,), error (3,) and its Jacobian (3, nv) of position and rotation."""
    if goal.link is None:
        yield goal.weight, goal.position - center_of_mass_at(model, poses), center_of_mass_jacobian_at(model, poses)
        return
    J, row = jacobian_at(model, poses, goal.link, goal.point), model.link_index(goal.link)
    if goal.position is not None:
        yield goal.weight, goal.position - point_at(poses, row, goal.point), J[3:]
    if goal.rotation is not None:
        w, v = _quaternion(product(goal.rotation, poses.rotation[row].T))
        x, y, z = v
        yield goal.orientation_weight, 2.0 * v, product(np.array([[w, -z, y], [z, w, -x], [-y, x, w]]), J[:3])


def _quaternion(R: np.ndarray) -> tuple[float, np.ndarray]:
    """Compute the unit quaternion w >= 0, (x, y, z) of a rotation (S. W. Shepperd, JGCD 1 (1978))."""
    (a, b, c), (d, e, f), (g, h, i) = R
    rows = np.array([
        [1.0 + a + e + i, h - f, c - g, d - b],
        [h - f, 1.0 + a - e - i, b + d, c + g],
        [c - g, b + d, 1.0 - a + e - i, f + h],
        [d - b, c + g, f + h, 1.0 - a - e + i],
    ])  # fmt: skip
    best = int(np.diag(rows).argmax())
    q = rows[best] / (2.0 * math.sqrt(rows[best, best]))
    return (float(q[0]), q[1:]) if q[0] >= 0.0 else (float(-q[0]), -q[1:])


def _status(task: _Task, best: _Found, rng: np.random.Generator) -> Status:
    """Classify the end of the search; a search without limits tells whether limits are in the way."""
    if best.error < task.tolerance:
        return "ok"
    if not best.settled:
        return "not converged"
    without = np.full(len(task.free.columns), math.inf)
    beyond = _attempt(task._replace(free=task.free._replace(lower=-without, upper=without)), best.q, rng)
    return "limits" if beyond.error < task.tolerance else "out of reach"


def _start(task: _Task, q0: ArrayLike | None) -> np.ndarray:
    """Return positions (nq,) to start from, within the limits, with a base quaternion of length 1."""
    model = task.model
    if q0 is None:
        q0 = at_joints(model, [_middle(joint) for joint in model.moving_joints])
    q = np.array(finite(f"{model.name}: q0", q0, (model.nq,)))
    forward_kinematics(model, q)  # checks the numbers
    if model.base == "floating":
        q[3:7] /= math.sqrt(total(q[3:7] * q[3:7]))
    return _moved(task, q, np.zeros(len(task.free.columns)))[0]


def _middle(joint: Joint) -> float:
    """Return the middle of a joint's range; if that is unbounded, 0 or the limit next to it."""
    bounded = math.isfinite(joint.lower) and math.isfinite(joint.upper)
    return 0.5 * (joint.lower + joint.upper) if bounded else min(max(0.0, joint.lower), joint.upper)


def _anywhere(task: _Task, start: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Draw a posture within the limits, for a joint without any within half a turn or 1 m; the base stays."""
    free, z = task.free, _coordinates(task, start)
    reach = np.where(free.turns, math.pi, 1.0)
    lower = np.where(np.isfinite(free.lower), free.lower, z - reach)
    upper = np.where(np.isfinite(free.upper), free.upper, z + reach)
    of_joints = np.arange(len(z)) >= (6 if free.base else 0)
    return _moved(task, start, np.where(of_joints, rng.uniform(lower, upper) - z, 0.0))[0]


def _freedom(model: Model, joints: Iterable[str] | None, hold_base: bool) -> _Freedom:
    """Collect what may move; raise ValueError for a joint that has no coordinate."""
    names, rows = model.joint_names, model.joint_rows
    couplings = [_Coupling(rows[follower], rows[leader], *law) for follower, leader, *law in model.couplings]
    given = names if joints is None else texts("joints", joints, "expected a list of names: write [name]")
    for name in [name for name in given if name not in names]:
        raise ValueError(f"joints: {name!r} is no moving joint of {model.name}; they are {', '.join(names)}: use these")
    wanted = set(given)
    followers = {c.follower for c in couplings}
    free = [k for k, name in enumerate(names) if name in wanted and k not in followers]
    first = model.nv - len(names)
    base = [] if hold_base else list(range(first))
    if not base and not free:
        raise ValueError(f"{model.name}: nothing may move; name joints that may, or let the base")
    ranges = [_range(model, k, couplings) for k in free]
    place = np.full(model.nv, -1)
    for k, (joint, at) in enumerate(zip(model.moving_joints, model.position_slices), start=first):
        place[k] = -1 if joint.type == "ball" else at.start
    balls = [(first + k, model.position_slices[k].start) for k in model.balls if {k, k + 1, k + 2} & set(free)]
    return _Freedom(
        columns=np.array([*base, *(first + k for k in free)], dtype=int),
        joint=np.array([False] * len(base) + [place[first + k] >= 0 for k in free], dtype=bool),
        lower=np.array([-math.inf] * len(base) + [lower for lower, _ in ranges]),
        upper=np.array([math.inf] * len(base) + [upper for _, upper in ranges]),
        turns=np.array([k >= 3 for k in base] + [model.moving_joints[k].type != "prismatic" for k in free], dtype=bool),
        followers=[c._replace(follower=first + c.follower, leader=first + c.leader) for c in couplings],
        place=place,
        balls=balls,
        base=bool(base),
    )


def _range(model: Model, leader: int, couplings: list[_Coupling]) -> tuple[float, float]:
    """Compute the range of a joint in which all its followers are within theirs."""
    joints = model.moving_joints
    lower, upper = joints[leader].lower, joints[leader].upper
    for c in couplings:
        if c.leader == leader and c.multiplier != 0.0:
            ends = [(end - c.offset) / c.multiplier for end in (joints[c.follower].lower, joints[c.follower].upper)]
            lower, upper = max(lower, min(ends)), min(upper, max(ends))
    if lower > upper:
        raise ValueError(
            f"{model.name}: joint {joints[leader].name!r} has no position at which all that follow it are within their "
            "limits; correct the limits, or the multipliers and offsets"
        )
    return lower, upper


def _goal(model: Model, target: Target) -> _Goal:
    """Check a target and return its numbers as arrays; raise ValueError for those that make no sense."""
    what = f"{model.name}: target of " + ("the center of mass" if target.link is None else f"link {target.link!r}")
    if target.link is not None:
        model.link_index(target.link)
    if target.position is None and (target.link is None or target.rotation is None):
        raise ValueError(f"{what} has no position" + (" and no rotation; give one" if target.link else "; give one"))
    if target.link is None and target.rotation is not None:
        raise ValueError(f"{what} has a rotation, which a point has not; leave it out, or name a link")
    goal = _Goal(
        target.link,
        vector(f"{what}: point", target.point, 3),
        None if target.position is None else vector(f"{what}: position", target.position, 3),
        None if target.rotation is None else _rotation(what, target.rotation),
        _weight(what, "weight", target.weight),
        _weight(what, "orientation_weight", target.orientation_weight),
    )
    given = ((goal.position, goal.weight), (goal.rotation, goal.orientation_weight))
    if not any(weight.any() for value, weight in given if value is not None):
        raise ValueError(f"{what} has no weight above 0; leave the target out, or give it one")
    return goal


def _weight(what: str, name: str, value: ArrayLike) -> np.ndarray:
    a = floats(f"{what}: {name}", value, "give one number >= 0, or three")
    if a.shape not in ((), (3,)) or not ((a >= 0.0) & (a <= HEAVIEST)).all():
        raise ValueError(f"{what}: {name} is {value!r}; give one number >= 0, or three, one for each axis of the world")
    return np.broadcast_to(a, 3)


def _rotation(what: str, value: ArrayLike) -> np.ndarray:
    """Return a rotation matrix (3, 3), given as such or as roll, pitch and yaw (3,) [rad]."""
    R = floats(f"{what}: rotation", value, "give a rotation matrix (3, 3) or roll, pitch and yaw (3,) [rad]")
    if R.shape == (3,) and np.isfinite(R).all():
        if not (np.abs(R) <= NEAR).all():
            raise ValueError(f"{what}: rotation is {R.tolist()}; give angles of at most {NEAR:.0f} rad")
        return rotation_from_rpy(R)
    good = R.shape == (3, 3) and np.isfinite(R).all()
    if not good or np.abs(product(R, R.T) - np.eye(3)).max() > ORTHOGONAL or dot(R[0], cross(R[1], R[2])) < 0.0:
        raise ValueError(
            f"{what}: rotation is {R.tolist()}; give a rotation matrix (3, 3), orthogonal and of determinant 1, or "
            "roll, pitch and yaw (3,) [rad]"
        )
    return R
