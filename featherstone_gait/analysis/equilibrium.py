"""Find equilibria: a robot at rest in a posture, the contact forces, and the references or torques that hold it.

The joints of a robot with a fixed base bear gravity and springs.  A floating base rests on its contacts: with Q(p) the
forces of rest at a base pose p (RNEA), J the contacts' Jacobian, N(p) = k depth their normal forces and f
their friction forces, as long as each point sticks,

    tau = Q(p) - J' (N(p), f),    minimal |tau|^2 + |r f|^2  with the base's six components of tau zero,

r = 1 cm.  Newton's method changes height and tilt alone; f and the rest of p follow by least squares.  Where nothing
balances the base so, moments against rolling, by their coefficients, are among f.  Feet can squeeze the ground between
them: of these solutions the one with the least joint torques and friction is taken.  Where that asks a contact for more
friction than its load gives, others may take it over: whether any f keeps within all cones is decided exactly, by
C. Lawson's iteration for the least largest share of friction, whose weights prove it where none does.  So it is with
loops: their forces are among f, and joints of such robots that have no motor have no torque.  The servo model is then
inverted: torque to current to voltage to reference.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import instance, listed, texts, vector
from ..base.brief import brief
from ..base.fixed_order import product
from ..base.rotation import rotation_from_quaternion
from ..dynamics import coupling_matrix, forward_dynamics, loop_jacobian
from ..dynamics.inverse_kinematics import close_loops
from ..dynamics.loops import leaders_of
from ..model.rest_posture import nearest_posture
from ..run.overlap import overlaps
from ..run.reference import Reference
from ..run.simulate import simulate
from ..run.start import check_scene, initial_state, placed_position, positions_in
from ..scene.compile import CompiledScene
from ..scene.contact import by_body, ground_under
from ..scene.forest import state_index
from .chart import Chart, chart_of, driven_columns
from .holding_servos import Fault, TrimStatus, put_servos
from .rest_loads import Loads, loads_at, of_points, rolling_friction

PASSES, LAYING = 100, 5  # of Newton's method; of that by which feet are laid on the ground
BALANCED = 1e-13  # remaining force on the base, relative to the weight
LONGEST, LARGEST = 20.0, 0.05  # step of Newton's method, relative to the ground's penetration, and of the tilt [rad]
LEVER = 0.1  # length that converts rotations to displacements [m]
NUDGE = 1e-3  # relative to the penetration, for derivatives by the pose
SQUEEZE = 0.01  # r: lever that converts friction to torque [m]
RANK = 1e-9  # of singular values relative to the largest, below which they count as zero
ROUNDING = 1e-12  # of the weight
HALVINGS = 30  # of a step of Newton's method
HOLDING = 1e3  # as SQUEEZE, of friction that is to stay as it is [m]
SHARINGS, BISECTIONS, ROUNDS = 1000, 40, 4  # most passes for the least largest share of friction, after it, of both
MARGIN = 1e-7  # by which friction stays within its limits, where others could not take it over exactly
STILL = 1e-8  # motion in a controller period [rad, m, and by the second]


@dataclass(frozen=True, eq=False)
class Trim:
    """An equilibrium, or the closest that was found.

    Attributes
    ----------
    q : ndarray
        Posture (nq,) [m, -, rad].
    torque : ndarray
        Torques or forces (joints,) that hold the joints [N m or N].
    contact_force : ndarray
        Forces (points, 3) of the ground: normal, along the slope, across [N]; (0, 3) without ground.
    reference : ndarray or None
        References of the servos (joints,) [rad or m]; None without servos.
    tau : ndarray or None
        Torques from outside (joints,), for ``simulate(tau=...)``; None where servos hold the joints.
    state : ndarray
        State (size,) at rest, to begin with.
    residual : float
        Largest acceleration left by forward dynamics [rad/s^2 or m/s^2].
    change : float
        Largest motion in a simulated controller period [rad, m, rad/s, m/s].
    status : str
        "ok", or why it is no equilibrium: see `trim`.
    message : str
        What is wrong, empty if nothing is.
    """

    q: np.ndarray
    torque: np.ndarray
    contact_force: np.ndarray
    reference: np.ndarray | None
    tau: np.ndarray | None
    state: np.ndarray
    residual: float
    change: float
    status: TrimStatus
    message: str

    __repr__ = brief

    @property
    def ok(self) -> bool:
        """Return whether the status is "ok"."""
        return self.status == "ok"


OK: tuple[TrimStatus, str] = ("ok", "")


def trim(
    scene: CompiledScene,
    q: ArrayLike | Mapping[str, ArrayLike] | None = None,
    contacts: Iterable[str] | None = None,
) -> Trim:
    """Find the equilibrium of a robot, or of several, at rest in a posture.

    The joints stay as they are in q, and so do the place and the heading of a floating base; its height and tilt are
    solved for.  Where loops hold it to the world it stays where it is, and they alone bear it.

    Parameters
    ----------
    scene
        A compiled scene.
    q
        Posture (nq,) [m, -, rad].  None: `nearest_posture`.  Of several robots and objects a dictionary, by name; each
        that is not named is at its place.
    contacts
        Names of the links to stand on, whose points are laid on the ground together.  None: the lowest points in q, and
        whatever else touches.

    Returns
    -------
    Trim
        Its status is "ok"; "tips" if the contacts cannot carry the robot; "slips" if no friction within the
        limits of all contacts holds it, or rolling friction; "touches" if a point of another link is in the ground;
        "too weak" if a servo cannot hold its joint; or "moves" if the simulation does not stay at rest, as with
        voltages in counts.

    Raises
    ------
    ValueError
        For a floating base without ground, for links without contacts, and where bodies of `pairs` touch each other.

    Examples
    --------
    >>> found = trim(scene)
    >>> run = simulate(scene, 1.0, found.state, Reference([0.0], found.reference[None]))
    """
    check_scene(scene)
    if scene.members:
        return _of_members(scene, q, contacts)
    model = scene.model
    given = close_loops(model, nearest_posture(model)) if q is None else vector("q", q, model.nq)
    at = positions_in(scene, initial_state(scene, given))  # checked, its quaternions of length 1
    if model.base != "floating" or any(loop.b is None for loop in model.loops):
        return _held(scene, at, np.zeros((len(model.contacts) if scene.ground else 0, 3)), None)
    if scene.ground is None:
        raise ValueError(f"{model.name}: a floating base without ground falls; compile the scene with ground=Ground()")
    used = _used(scene, contacts)
    passes = LAYING if contacts is not None else 0
    laid = _laid(scene, at, used, passes)
    at, force, wrong = found = _balanced(scene, laid, used)
    if wrong and rolling_friction(scene).any():  # moments that nothing needs could be more than there are
        at, force, wrong = found = _balanced(scene, laid, used, rows=5)
    if wrong:  # upright on a slope is far from lying on it
        leaning = _balanced(scene, _laid(scene, _leaning(scene, laid), used, passes), used)
        at, force, wrong = found if leaning[2] else leaning
    if not wrong:
        at, force = _within_cones(scene, at, used, force)
    return _held(scene, at, force, wrong or _contact_fault(scene, at, used, force))


def _of_members(scene: CompiledScene, q: Any, contacts: Iterable[str] | None) -> Trim:
    """Return the equilibria of all members in one, their postures one after the other.

    They do not touch each other: each is at rest as it would be alone.  Raises ValueError where they do.
    """
    state, given = initial_state(scene), {} if q is None else q
    instance("q", given, Mapping, f"give a dictionary by name, q={{{scene.members[0].name!r}: ...}}")
    for name in given:
        scene.member(name)
    links = None if contacts is None else listed("contacts", contacts, "give a list of links")
    found = []
    for member in scene.members:
        at = given.get(member.name)
        if at is None:
            at = placed_position(member)
            first = member.model.base_positions
            at[first:] = nearest_posture(member.model)[first:]
        head = f"{member.name}/"
        own = None if links is None else [name.removeprefix(head) for name in links if name.startswith(head)]
        found.append(trim(member.scene, at, own or None))
        state[state_index(scene, member)] = found[-1].state
    _check_apart(scene, state)
    faults = ((t.status, f"{member.name}: {t.message}") for member, t in zip(scene.members, found) if not t.ok)
    status, message = next(faults, OK)
    driven = scene.constants.actuator is not None
    held = [
        member.model.single_positions(t.q) if t.reference is None else t.reference
        for member, t in zip(scene.members, found)
    ]
    outside = [np.zeros(len(t.torque)) if t.tau is None else t.tau for t in found]
    return Trim(
        q=np.concatenate([t.q for t in found]),
        torque=np.concatenate([t.torque for t in found]),
        contact_force=np.concatenate([t.contact_force.reshape(-1, 3) for t in found]),
        reference=np.concatenate(held) if driven else None,
        tau=np.concatenate(outside) if any(t.tau is not None and t.tau.any() for t in found) or not driven else None,
        state=state,
        residual=max(t.residual for t in found),
        change=max(t.change for t in found),
        status=status,
        message=message,
    )


def _check_apart(scene: CompiledScene, state: np.ndarray) -> None:
    """Raise ValueError where bodies touch each other: their forces are not among those of an equilibrium here."""
    touching = overlaps(scene, state)
    if touching:
        (one, two), _ = touching[0]
        raise ValueError(
            f"{scene.model.name}: trim knows no forces between bodies, and {one!r} touches {two!r} there; let them "
            "come to rest instead: run = simulate(scene, 2.0), and take run.final"
        )


def _used(scene: CompiledScene, contacts: Iterable[str] | None) -> np.ndarray:
    """Return which points may carry load (points,)."""
    links = [point.link for point in scene.model.contacts]
    if contacts is None:
        return np.ones(len(links), dtype=bool)
    chosen = texts("contacts", contacts)
    if not chosen:
        raise ValueError(f"{scene.model.name}: contacts is empty; give links to stand on, or None for what touches")
    for name in chosen:
        if name not in links:
            known = ", ".join(dict.fromkeys(links))
            raise ValueError(f"{scene.model.name}: contacts: link {name!r} has no contact points; those with: {known}")
    return np.array([link in chosen for link in links])


# ------------------------------------------------------------------------------------------------ forces


def _balanced(
    scene: CompiledScene,
    q: np.ndarray,
    used: np.ndarray,
    rows: int = 3,
    aim: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, Fault]:
    """Solve for the posture (nq,) and contact forces (points, rows) that balance the base; return a fault or None too.

    Of five rows the last two are moments against rolling by their coefficient [N].  aim: friction of the points in use
    (count, rows - 1) to stay as near to as balance allows; None: as small as the joints' torques.
    """
    model, chart = scene.model, chart_of(scene, ("base_q",))
    weight = model.mass * float(np.linalg.norm(scene.gravity))
    lever, aim = (SQUEEZE, np.zeros((int(used.sum()), rows - 1))) if aim is None else (HOLDING, aim)
    f = aim.copy()
    scale, loads = _scale(scene), loads_at(scene, q[None])
    for _ in range(PASSES):
        ways, loads, total, columns = _unbalanced(scene, chart, q, f, used, loads)
        columns = np.concatenate([columns, lever * np.eye(3 + f.size, columns.shape[1])[3:]])
        step = _least(columns, np.concatenate([total, lever * (f - aim).ravel()]), _idle(scene))
        left = float(np.abs(total[:6]).max())
        way = step[:3] / max(1.0, abs(step[0]) / LONGEST, np.abs(step[1:3]).max() * scale[1] / LARGEST)
        f, before = f + step[3 : 3 + f.size].reshape(f.shape), q
        for _ in range(HALVINGS):  # of a way that ends in the air, where nothing is known of what is below
            q = _posed(scene, chart, before, (ways.T @ way)[:, None])[0]
            if loads_at(scene, q[None]).depth[0, used].max() > 0.0:
                break
            way = 0.5 * way
        if left <= BALANCED * weight and np.abs(way).max() < 1e-6:
            break
    loads, stiffness = loads_at(scene, q[None]), of_points(scene)
    force = np.zeros((len(used), rows))
    force[used, 0] = stiffness[used] * np.maximum(loads.depth[0, used], 0.0)
    force[used, 1:] = f
    rest = (loads.force[0] - np.einsum("mi,mij->j", force, loads.J[0, :, :rows]))[:6]
    if np.abs(rest).max() <= 1e-9 * weight:
        return q, force, None
    what = f"{float(np.abs(rest).max()):.3g} N or N m of the base are not in balance"
    return q, force, ("tips", f"{what}: the center of mass is not over what carries; give another posture or contacts")


def _unbalanced(
    scene: CompiledScene,
    chart: Chart,
    q: np.ndarray,
    f: np.ndarray,
    used: np.ndarray,
    loads: Loads,
) -> tuple[np.ndarray, Loads, np.ndarray, np.ndarray]:
    """Return what is left of the forces (independent,), and its slopes by height, tilt, friction and loops.

    Before them the directions of `_nudged`, and the loads.  f (count, rows - 1), which becomes 0 of what is in the air.
    """
    model, rows = scene.model, f.shape[1] + 1
    reduced = coupling_matrix(model).matrix
    ways, loads = _nudged(scene, chart, q, loads, used)
    normal = (of_points(scene) * np.maximum(loads.depth, 0.0))[:, used]
    J, on = loads.J[:, used, :rows], normal[0] > 0.0
    f[~on] = 0.0
    total = loads.force - np.einsum("km,kmj->kj", normal, J[:, :, 0]) - np.einsum("mi,kmij->kj", f, J[:, :, 1:])
    total = total @ reduced
    by_pose = (total[1:4] - total[4:]).T / (2.0 * NUDGE)
    by_friction = -((J[0, :, 1:] * on[:, None, None]).reshape(-1, model.nv) @ reduced).T
    loops = -product(loop_jacobian(model, q), reduced) if model.loops else np.zeros((0, reduced.shape[1]))
    return ways, loads, total[0], np.concatenate([by_pose, by_friction, loops.T], axis=1)


def _laid(scene: CompiledScene, q: np.ndarray, used: np.ndarray, passes: int) -> np.ndarray:
    """Lay a posture on the ground, its lowest point at the ground's penetration and its points as level as possible.

    passes: iterations of the Gauss-Newton method, by which the depths of all points become equal.
    """
    assert scene.ground is not None
    chart, loads = chart_of(scene, ("base_q",)), loads_at(scene, q[None])
    for _ in range(passes):
        ways, loads = _nudged(scene, chart, q, loads, used)
        depth = loads.depth[:, used]
        slopes = (depth[1:4] - depth[4:]).T / (2.0 * NUDGE)
        way = np.linalg.lstsq(slopes, scene.ground.penetration - depth[0], rcond=RANK)[0]
        q = _posed(scene, chart, q, (ways.T @ way)[:, None])[0]
        loads = loads_at(scene, q[None])
    up = loads.axes[0, used, 0].mean(axis=0) * (float(loads.depth[0, used].max()) - scene.ground.penetration)
    return np.concatenate([q[:3] + up, q[3:]])


def _leaning(scene: CompiledScene, q: np.ndarray) -> np.ndarray:
    """Return a posture whose base is turned with the ground under it, by what turns the vertical to its normal."""
    assert scene.ground is not None
    n = ground_under(scene.ground, q[None, :3])[0, :3]
    (w, x, y), (a, b, c, d) = np.array([1.0 + n[2], -n[1], n[0]]) / np.sqrt(2.0 + 2.0 * n[2]), q[3:7]
    turned = [w * a - x * b - y * c, w * b + x * a + y * d, w * c - x * d + y * a, w * d + x * c - y * b]
    return np.concatenate([q[:3], turned, q[7:]])


def _scale(scene: CompiledScene) -> np.ndarray:
    """Return scales of height and tilt of a base, of the order of the penetration [m, rad, rad]."""
    assert scene.ground is not None
    return scene.ground.penetration * np.array([1.0, 1.0 / LEVER, 1.0 / LEVER])


def _nudged(
    scene: CompiledScene, chart: Chart, q: np.ndarray, loads: Loads, used: np.ndarray
) -> tuple[np.ndarray, Loads]:
    """Return directions (3, 6) of the base, and the loads in seven poses: q, a little along each, and against each.

    The directions are up along the normal, and rotations about the two tangents through the base.
    """
    normal, first, second = loads.axes[0, used].mean(axis=0)
    back, ways = rotation_from_quaternion(q[3:7]).T, np.zeros((3, 6))
    ways[0, :3], ways[1, 3:], ways[2, 3:] = normal, back @ first, back @ second
    ways *= _scale(scene)[:, None]
    x = np.concatenate([np.zeros((6, 1)), NUDGE * ways.T, -NUDGE * ways.T], axis=1)
    return ways, loads_at(scene, _posed(scene, chart, q, x))


def _posed(scene: CompiledScene, chart: Chart, q: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return postures (k, nq) with the base moved by x (6, k)."""
    y, base = np.zeros(scene.layout["length"]), slice(*scene.part("base_q"))
    y[base] = q[:7]
    moved = np.tile(q, (x.shape[1], 1))
    moved[:, :7] = chart.moved(y, x)[base].T
    return moved


def _least(columns: np.ndarray, force: np.ndarray, zero: np.ndarray) -> np.ndarray:
    """Solve for x that makes components `zero` of `force + columns x` zero if possible, and the others least."""
    rest = np.delete(np.arange(len(force)), zero)
    B, T = columns[zero], columns[rest]
    U, s, V = np.linalg.svd(B)
    rank = int((s > RANK * s.max(initial=0.0)).sum())
    x = -V[:rank].T @ ((U[:, :rank].T @ force[zero]) / s[:rank])
    Z = V[rank:].T
    if not Z.size:
        return x
    U, s, V = np.linalg.svd(T @ Z, full_matrices=False)
    rank = int((s > RANK * np.abs(T).max(initial=0.0)).sum())  # of T, since a ball turns without any effect
    return x - Z @ (V[:rank].T @ ((U[:, :rank].T @ (force[rest] + T @ x)) / s[:rank]))


def _idle(scene: CompiledScene) -> np.ndarray:
    """Return which independent coordinates nothing drives: a base's, and in robots with loops joints without motors."""
    driven = driven_columns(scene) if scene.model.loops else np.ones(len(leaders_of(scene.model)), dtype=bool)
    driven[: scene.model.nv - scene.tree.n] = False
    return np.flatnonzero(~driven)


def _within_cones(
    scene: CompiledScene, q: np.ndarray, used: np.ndarray, force: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the posture and contact forces (points, 3 or 5) that balance the base within the limits of friction.

    They are as near to those given as the limits allow on the way to the forces with the least largest share of
    friction; these themselves where no forces keep within the limits.
    """
    for _ in range(ROUNDS):  # loads change a little with the friction
        on = force[used, 0] > ROUNDING * float(force[:, 0].sum())
        limits = _limits(scene, force)[used][on]
        given = force[used, 1:][on].reshape(*limits.shape, 2)
        if not (limits > 0.0).all() or (np.hypot(given[..., 0], given[..., 1]) <= limits).all():
            break
        _, _, _, columns = _unbalanced(
            scene, chart_of(scene, ("base_q",)), q, force[used, 1:].copy(), used, loads_at(scene, q[None])
        )
        carries = np.ones(columns.shape[1], dtype=bool)
        carries[3 : 3 + force[used, 1:].size] = np.repeat(on, force.shape[1] - 1)
        least = _least_share(given, limits, columns[_idle(scene)][:, carries])
        low, high = 0.0, 1.0
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            f = given + middle * (least - given)
            inside = (np.hypot(f[..., 0], f[..., 1]) <= (1.0 - MARGIN) * limits).all()
            low, high = (low, middle) if inside else (middle, high)
        aim = np.zeros_like(force[used, 1:])
        aim[on] = (given + high * (least - given)).reshape(len(given), -1)
        at, found, wrong = _balanced(scene, q, used, force.shape[1], aim)
        if wrong:
            break
        q, force = at, found
        if (np.hypot(least[..., 0], least[..., 1]) > limits).any():
            break
    return q, force


def _least_share(given: np.ndarray, limits: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """Return friction (points, kinds, 2) of the same effect as that given, with the least largest share of its limits.

    limits (points, kinds) [N]; slopes of what must stay, by height, tilt, friction and loops.  It ends where all are
    within the limits, and where the weighted mean of squares, at most that of the least largest share, is above 1.
    """
    sizes = np.linalg.norm(slopes, axis=0)
    sizes[sizes == 0.0] = 1.0
    _, s, V = np.linalg.svd(slopes / sizes)
    free = (V / sizes)[int((s > RANK * s.max(initial=0.0)).sum()) :, 3 : 3 + given.size].T
    weights, least, best = np.full(limits.shape, 1.0 / limits.size), given, np.inf
    for _ in range(SHARINGS):
        by = np.repeat(np.sqrt(weights) / limits, 2)
        change = np.linalg.lstsq(by[:, None] * free, -by * given.ravel(), rcond=RANK)[0]
        f = given + (free @ change).reshape(given.shape)
        share = np.hypot(f[..., 0], f[..., 1]) / limits
        if share.max() < best:
            least, best = f, float(share.max())
        if best <= 1.0 - 2.0 * MARGIN or float(np.sum(weights * share**2)) > 1.0 or not share.max() > 0.0:
            break
        weights = weights * share
        weights /= weights.sum()
    return least


def _limits(scene: CompiledScene, force: np.ndarray) -> np.ndarray:
    """Return how much friction [N] contacts have, and as much rolling friction, by its coefficient (points, 1 or 2)."""
    normal = force[:, :1]
    slides = of_points(scene, "friction")[:, None] * normal
    return slides if force.shape[1] == 3 else np.hstack([slides, normal])


def _contact_fault(scene: CompiledScene, q: np.ndarray, used: np.ndarray, force: np.ndarray) -> Fault:
    """Return status and message of contacts that slip, or touch and should not; None if there are none."""
    depth = loads_at(scene, q[None]).depth[0]
    for k, point in enumerate(scene.model.contacts):
        if not used[k] and depth[k] > 0.0:
            return "touches", f"contact {k} of {point.link} is {depth[k]:.3g} m in the ground; name it, or lift it"
        along, most = float(np.hypot(*force[k, 1:3])), float(_limits(scene, force)[k, 0])
        if along > most + ROUNDING * float(force[:, 0].sum()):
            what = f"contact {k} of {point.link} needs {along:.3g} N of friction; there are {most:.3g} N"
            return "slips", f"{what}: give more friction, or another posture"
        against = float(np.hypot(*force[k, 3:])) if force.shape[1] > 3 else 0.0
        if against > force[k, 0] * (1.0 + ROUNDING):
            rho = point.rolling_friction
            what = f"contact {k} of {point.link} needs {rho * against:.3g} N m against rolling"
            there = f"there are {rho * force[k, 0]:.3g} N m"
            return "slips", f"{what}; {there}: give more rolling_friction, or another posture"
    return None


# ------------------------------------------------------------------------------------------------ servos


def _held(scene: CompiledScene, q: np.ndarray, force: np.ndarray, fault: Fault) -> Trim:
    """Return the equilibrium with what holds it, tried in a run of one period."""
    model, n, loads = scene.model, scene.tree.n, loads_at(scene, q[None])
    carried = np.einsum("mi,mij->j", force, loads.J[0, :, : force.shape[1]])
    torque, G = np.zeros(model.nv), coupling_matrix(model).matrix
    leaders = leaders_of(model)
    torque[leaders] = G.T @ (loads.force[0] - carried)
    if model.loops:
        loops = product(G.T, loop_jacobian(model, q).T)
        torque[leaders] += loops @ _least(loops, torque[leaders], _idle(scene))
        torque[np.abs(torque) <= ROUNDING * np.abs(loads.force[0]).max(initial=0.0)] = 0.0
    torque[: model.nv - n] = 0.0
    pulls = torque + carried + loads.springs[0]
    residual = forward_dynamics(model, q, np.zeros(model.nv), pulls, gravity=scene.gravity)
    state, torque = initial_state(scene, q, allow_limit_violation=True), torque[model.nv - n :]
    _put_contacts(scene, state, force)
    reference, weak = put_servos(scene, state, model.single_positions(q), torque)
    tau = torque if reference is None else None
    change = _change(scene, state, reference, tau)
    fault = fault or weak
    if fault is None and not change <= STILL:
        fault = "moves", f"in a controller period it moves by {change:.3g} rad or m, or by as much a second"
    status, message = fault or OK
    largest = float(np.abs(residual).max())
    return Trim(q, torque, force[:, :3], reference, tau, state, largest, change, status, message)


def _put_contacts(scene: CompiledScene, state: np.ndarray, force: np.ndarray) -> None:
    """Set the deflections that bear the forces (points, 3), or (points, 5) with those by rolling friction, at rest."""
    contact = scene.constants.contact
    if contact is None:
        return
    order = by_body(scene.model, scene.tree)
    state[slice(*scene.part("contact_force"))] = force[order, :3].ravel()
    deflection = -force[order, 1:3] / contact.points.tangential_stiffness[:, None]
    state[slice(*scene.part("tangential_deflection"))] = deflection.ravel()
    if force.shape[1] > 3:
        rolled = -force[order, 3:] * (contact.rolling.friction / contact.rolling.tangential_stiffness)[:, None]
        state[slice(*scene.part("rolling_deflection"))] = rolled.ravel()


def _change(scene: CompiledScene, state: np.ndarray, reference: np.ndarray | None, tau: np.ndarray | None) -> float:
    """Return the largest motion of base and joints in a simulated controller period; infinite if it fails."""
    period = scene.tick_steps * scene.timestep
    follow = None if reference is None else Reference([0.0], reference[None])
    run = simulate(scene, period, state, follow, tau, record=(), estimate_error=False)
    if run.status not in ("ok", "chatter"):
        return np.inf
    moving = tuple(name for name in scene.state_view(state) if name in ("base_q", "q", "base_qd", "qd"))
    return float(np.abs(chart_of(scene, moving).difference(run.final[:, None], state)).max())
