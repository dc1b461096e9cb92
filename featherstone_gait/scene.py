"""From the robot's files to what kernels read: merging, locking, the choice of frames, servos, ground and preflight."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from .core import layout
from .core.batch import exponential
from .core.controller import PID_POSITION, PID_SPEED, STATE_FEEDBACK
from .core.layout import BODY, COLUMNS
from .core.scene import Scene
from .model import Ground, Joint, Link, Model, Servo, inertia_matrix, rotation_from_rpy
from .preflight import Limit, Preflight, coupled_limit, joint_limit

GRAVITY = (0.0, 0.0, -9.81)  # [m/s^2]


class Placement(NamedTuple):
    """Where a link sits: the moving body that carries it and its frame in that body's frame."""

    row: int  # row of the body; 0 is the world or the floating base
    E: np.ndarray  # (3, 3) rotation link -> body frame
    r: np.ndarray  # (3,) origin of the link frame in the body frame [m]


class Tree(NamedTuple):
    """A model laid out for the kernels."""

    bodies: np.recarray  # (n + 1,) BODY
    floating: bool
    names: tuple[str, ...]  # of the rows: the root link, then each joint's child
    placements: dict[str, Placement]  # of every link
    rows: int  # of the workspace: bodies, slots, contact rows

    @property
    def n(self) -> int:
        """Number of moving joints."""
        return len(self.bodies) - 1

    def workspace_shape(self) -> tuple[int, int]:
        return (self.rows, COLUMNS)


@functools.lru_cache(maxsize=64)
def compile_tree(model: Model) -> Tree:
    """Merge what is rigidly connected, turn every joint to z and order bodies depth first, parents before children."""
    links = {link.name: link for link in model.links}
    order = _depth_first(model)
    dof = {name: k for k, name in enumerate(model.joint_names)}
    bodies = np.zeros(len(dof) + 1, BODY)
    bodies[0]["E"] = np.eye(3).ravel()
    root = ({link.name for link in model.links} - {joint.child for joint in model.joints}).pop()
    placements = {root: Placement(0, np.eye(3), np.zeros(3))}
    groups: list[list[str]] = [[root]]
    for joint in order:
        parent = placements[joint.parent]
        E = parent.E @ rotation_from_rpy(joint.rpy)
        r = parent.r + parent.E @ np.array(joint.xyz)
        if joint.name not in dof:
            E, r = _held(joint, model.locked.get(joint.name, 0.0), E, r)
            placements[joint.child] = Placement(parent.row, E, r)
            groups[parent.row].append(joint.child)
            continue
        Q = _rotation_z_to(joint.axis)
        row = len(groups)
        body = bodies[row]
        body["parent"], body["dof"], body["prismatic"] = parent.row, dof[joint.name], joint.type == "prismatic"
        body["E"], body["r"] = (E @ Q).ravel(), r
        placements[joint.child] = Placement(row, Q.T, np.zeros(3))
        groups.append([joint.child])
    for body, group in zip(bodies, groups):
        _merge(body, [(links[name], placements[name]) for name in group])
    rows = len(bodies) + _assign_slots(bodies)
    for row in sorted({placements[point.link].row for point in model.contacts}):
        bodies[row]["contact"] = rows
        rows += 1
    names = tuple(group[0] for group in groups)
    return Tree(bodies.view(np.recarray), model.base == "floating", names, placements, rows)


def _depth_first(model: Model) -> list[Joint]:
    """The joints so that each chain is contiguous: the accumulator of a chain is then reused along it."""
    children: dict[str, list[Joint]] = {}
    for joint in model.joints:
        children.setdefault(joint.parent, []).append(joint)
    root = ({link.name for link in model.links} - {joint.child for joint in model.joints}).pop()
    order, stack = [], children.get(root, [])[::-1]
    while stack:
        joint = stack.pop()
        order.append(joint)
        stack.extend(children.get(joint.child, [])[::-1])
    return order


def rotation_axis(axis, angle: float) -> np.ndarray:
    """Rotation about a unit axis (Rodrigues)."""
    x, y, z = axis
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * K + (1 - math.cos(angle)) * (K @ K)


def _held(joint: Joint, position: float, E, r) -> tuple[np.ndarray, np.ndarray]:
    """The child frame of a fixed or locked joint."""
    if position == 0.0:
        return E, r
    if joint.type == "prismatic":
        return E, r + E @ (position * np.array(joint.axis))
    return E @ rotation_axis(joint.axis, position), r


def _rotation_z_to(axis) -> np.ndarray:
    """A rotation that takes z to the unit vector `axis`; entries are exactly 0 and 1 for coordinate axes."""
    z = np.array(axis)
    x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
    x /= math.sqrt(x @ x)
    return np.column_stack([x, np.cross(z, x), z])


def _merge(body, group: list[tuple[Link, Placement]]) -> None:
    """Mass, centre of mass and inertia of the links that move as one, in the body's frame."""
    m = math.fsum(link.mass for link, _ in group)
    centers = [place.r + place.E @ np.array(link.center_of_mass) for link, place in group]
    c = sum((link.mass * center for (link, _), center in zip(group, centers)), np.zeros(3))
    c = c / m if m > 0 else c
    J = np.zeros((3, 3))
    for (link, place), center in zip(group, centers):
        d = center - c
        J += place.E @ inertia_matrix(link.inertia) @ place.E.T + link.mass * ((d @ d) * np.eye(3) - np.outer(d, d))
    body["m"], body["c"] = m, c
    body["J"] = J[[0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]


def _assign_slots(bodies) -> int:
    """Give each parent an accumulator row, reusing rows whose parent has been passed; return how many are needed."""
    n = len(bodies)
    slot = [-1] * n
    free: list[int] = []
    used = 0
    for i in range(n - 1, -1, -1):
        bodies[i]["leaf"] = slot[i] < 0
        if slot[i] >= 0:
            free.append(slot[i])
        parent = bodies[i]["parent"]
        if i > 0 and slot[parent] < 0:
            bodies[i]["last"] = 1
            if not free:
                free.append(used)
                used += 1
            slot[parent] = free.pop()
    bodies["slot"] = [n + max(s, 0) for s in slot]
    return used


ServoKind = Literal["mipsd", "rotor", "standard"]
INTEGRATORS = {"implicit_euler": 1.0, "midpoint": 0.5, "rk4": 1.0, "simtwo": 1.0}  # name -> theta
LAWS = {"state": STATE_FEEDBACK, "pid_position": PID_POSITION, "pid_speed": PID_SPEED}
NO_SERVO_TICK = 1e-2  # [s] between the checks of a scene without sampled controllers
STOP_DEPTH = 0.01  # [rad or m] that the strongest torque at a joint drives it into its stop


@dataclass(frozen=True, eq=False)
class CompiledScene:
    """A scene ready to run; made by `compile_scene`."""

    model: Model
    tree: Tree
    constants: Scene
    offsets: np.ndarray  # (1,) STATE
    integrator: str
    timestep: float  # [s]
    tick_steps: int  # steps of a controller tick
    lag: float  # [s]
    servos: ServoKind | None
    ground: Ground | None
    preflight: Preflight
    fall_height: float  # [m]
    fall_upright: float  # cosine

    @property
    def theta(self) -> float:
        return INTEGRATORS[self.integrator]

    @property
    def layout(self) -> np.void:
        """Where each part of the state starts."""
        return self.offsets[0]

    def part(self, name: str) -> tuple[int, int]:
        """First and past-the-last index of a part of the state."""
        names = layout.STATE.names
        return int(self.layout[name]), int(self.layout[names[names.index(name) + 1]])

    def shaped(self, name: str, values: np.ndarray) -> np.ndarray:
        """A recorded part (samples, width) in its natural shape."""
        width = {"energy": layout.ENERGIES, "contact_force": 3, "bristle": 2}.get(name)
        return values if width is None else values.reshape(len(values), -1, width)

    def pushed(self, pushes) -> CompiledScene:
        """The scene with external forces."""
        if pushes is None:
            return self
        return replace(self, constants=self.constants._replace(push=pushes[0], push_rows=pushes[1]))


def compile_scene(
    model: Model,
    servos: ServoKind | None = None,
    ground: Ground | None = None,
    integrator: str | None = None,
    timestep: float | None = None,
    gravity=GRAVITY,
    fall_height: float = 0.6,
    fall_tilt: float = math.radians(45),
) -> CompiledScene:
    """Lay a model, its servos and the ground out for the kernels.

    Parameters
    ----------
    servos : "mipsd" (spring-damper gearbox with rotor), "rotor" (rigid, with the rotor's reflected inertia),
        "standard" (rigid, none), or None: no servos, torques from `simulate(tau=...)`
    ground : None where the robot touches nothing
    integrator : "implicit_euler", "midpoint", "rk4" or "simtwo"; None chooses from the preflight
    timestep : [s]; must divide the controllers' period; None chooses
    fall_height, fall_tilt : a floating robot over ground has fallen below this fraction of its standing height, or
        tilted by more than this [rad]

    Raises ValueError on servos that the model does not have and on steps that do not fit.
    """
    tree = compile_tree(model)
    chosen = _joint_servos(model, servos)
    continuous = _is_continuous(model, chosen)
    points = None if ground is None or not model.contacts else model.contacts
    if ground is not None and points is None:
        raise ValueError(
            f"{model.name}: ground without contact points; add [[contacts]] to its TOML or use ground=None"
        )
    armature = _armature(tree, chosen, servos)
    check = _preflight(model, chosen, servos, continuous, ground, armature, integrator, timestep)
    h = check.timestep
    period, lag = _period(model, chosen, continuous, h)
    if check.integrator not in INTEGRATORS:
        raise ValueError(f"integrator {check.integrator!r}; use one of {', '.join(INTEGRATORS)}")
    if check.integrator == "simtwo" and (continuous or not chosen):
        raise ValueError("simtwo is the update order of sampled servos; use implicit_euler for other scenes")
    sampled = bool(chosen) and not continuous
    constants = Scene(
        tree.bodies,
        True if tree.floating else None,
        np.array(gravity, dtype=float),
        _servo_table(tree.n, chosen, h) if sampled else None,
        _gear_table(model, tree.n, chosen) if sampled and servos == "mipsd" else None,
        _pd_table(tree.n, chosen, check, armature, h) if continuous else None,
        np.array([LAWS[s.controller.law] if s else 0 for s in chosen], np.int64) if sampled else None,
        armature,
        _friction_table(model, chosen, check.integrator),
        _stop_table(model, tree, chosen, armature),
        None if points is None else _contact_table(model, tree, ground),
        None if points is None else np.array([tree.placements[p.link].row for p in _by_body(model, tree)], np.int64),
        None if points is None else _ground_table(ground),
        None,
        None,
    )
    stand = _fall_height(model, tree, ground, fall_height) if tree.floating and points else -math.inf
    upright = math.cos(fall_tilt) if tree.floating and points else -2.0
    return CompiledScene(
        model,
        tree,
        constants,
        _offsets(tree, sampled, constants),
        check.integrator,
        h,
        round(period / h),
        lag,
        servos,
        ground,
        check,
        stand,
        upright,
    )


def _joint_servos(model: Model, servos: ServoKind | None) -> list[Servo | None]:
    """The servo of each moving joint; an empty list for a scene without."""
    if servos is None:
        return []
    if servos not in ("mipsd", "rotor", "standard"):
        raise ValueError(f"servos is {servos!r}; use 'mipsd', 'rotor', 'standard' or None")
    if not any(name in model.servos for name in model.joint_names):
        raise ValueError(f"{model.name} has no servos; name them in the [servos] table of its TOML, or use servos=None")
    return [model.servos.get(name) for name in model.joint_names]


def _is_continuous(model: Model, chosen: list[Servo | None]) -> bool:
    kinds = {servo.controller.law in ("pd", "pd_clamped") for servo in chosen if servo}
    if len(kinds) > 1:
        raise ValueError(f"{model.name} mixes pd servos with sampled ones; give all joints one kind of law")
    return kinds == {True}


def _armature(tree: Tree, chosen, servos) -> np.ndarray | None:
    """Reflected inertia G^2 J of rigid gearboxes [kg m^2]."""
    if servos != "rotor":
        return None
    return np.array([s.gearbox.ratio**2 * s.gearbox.rotor_inertia if s else 0.0 for s in chosen])


def _period(model: Model, chosen, continuous: bool, h: float) -> tuple[float, float]:
    """Controller tick and lag [s], one for all joints."""
    if not chosen or continuous:
        return max(1, round(NO_SERVO_TICK / h)) * h, 0.0
    settings = {(s.controller.period, s.controller.lag) for s in chosen if s}
    if len(settings) > 1:
        raise ValueError(f"{model.name}: controllers differ in period or lag: {sorted(settings)}; give them the same")
    period, lag = settings.pop()
    if round(period / h) < 1 or abs(round(period / h) * h - period) > 1e-9 * period:
        raise ValueError(
            f"timestep {h:g} s does not divide the controllers' period of {period:g} s; steps end on ticks"
        )
    return period, lag


def _servo_table(n: int, chosen, h: float) -> np.ndarray:
    table = np.zeros((n, layout.SERVO_COLUMNS))
    table[:, layout.RES] = 1.0  # a joint without a servo: no torque, no current
    for row, servo in zip(table, chosen):
        if servo is None:
            continue
        c, z = servo.controller, math.inf
        if servo.inductance > 0:
            z = h * servo.resistance / servo.inductance
        row[layout.KT] = servo.gearbox.ratio * servo.motor_constant
        row[layout.RES], row[layout.IND] = servo.resistance, servo.inductance
        row[layout.VMAX], row[layout.IMAX], row[layout.SLEW] = (
            servo.voltage_limit,
            servo.current_limit,
            servo.current_slew,
        )
        row[layout.KP], row[layout.KI], row[layout.KD], row[layout.KF] = c.Kp, c.Ki, c.Kd, c.Kf
        row[layout.ENCODER], row[layout.FILTER] = servo.encoder_resolution, servo.speed_filter
        row[layout.DECAY] = exponential(-z)
        row[layout.MEAN] = (1.0 - row[layout.DECAY]) / z
        row[layout.FADE] = exponential(-h / servo.speed_filter) if servo.speed_filter > 0 else 0.0
        row[layout.BV] = servo.viscous_friction
    return table


def _gear_table(model: Model, n: int, chosen) -> np.ndarray:
    table = np.zeros((n, layout.GEAR_COLUMNS))
    table[:, layout.INERTIA] = 1.0
    table[:, layout.RATIO] = 1.0
    for row, servo, name in zip(table, chosen, model.joint_names):
        if servo is None:
            continue
        g = servo.gearbox
        if not (g.stiffness < math.inf and g.rotor_inertia > 0):
            raise ValueError(
                f"{model.name}: joint {name}: mipsd needs a finite stiffness and a rotor inertia > 0; they are "
                f"{g.stiffness} N m/rad and {g.rotor_inertia} kg m^2: choose another gearbox, or servos='rotor'"
            )
        row[:] = (
            g.stiffness,
            g.damping,
            0.5 * g.backlash,
            g.ratio**2 * g.rotor_inertia,
            g.ratio**2 * g.rotor_damping,
            g.ratio,
        )
    return table


def _pd_table(n: int, chosen, check: Preflight, armature, h: float) -> np.ndarray:
    """Fold the spring only where its own period needs it: Euler is more accurate with it at the start of the step."""
    table = np.zeros((n, layout.PD_COLUMNS))
    for row, servo, inertia in zip(table, chosen, check.inertias):
        if servo is not None:
            c = servo.controller
            limit = c.torque_limit if c.torque_limit < math.inf else 1e300
            fold = check.integrator == "midpoint" or h * h * c.Kp > inertia + h * c.Kd
            row[:] = (c.Kp, c.Kd, limit, c.law == "pd", fold)
    return table


def _friction_table(model: Model, chosen, integrator: str) -> np.ndarray | None:
    """Viscous and Coulomb friction of joint and servo; the 2012 order applies the servo's viscous part itself."""
    table = np.zeros((len(model.moving_joints), layout.FRICTION_COLUMNS))
    for k, joint in enumerate(model.moving_joints):
        servo = chosen[k] if chosen else None
        own = servo.viscous_friction if servo and integrator != "simtwo" else 0.0
        table[k] = joint.damping + own, joint.friction + (servo.coulomb_friction if servo else 0.0)
    return table if table.any() else None


def _stop_table(model: Model, tree: Tree, chosen, armature) -> np.ndarray | None:
    """One-sided spring-dampers, critically damped with the inertia that the joint feels at zero."""
    joints = model.moving_joints
    if not any(math.isfinite(j.lower) or math.isfinite(j.upper) for j in joints):
        return None
    table = np.zeros((len(joints), layout.STOP_COLUMNS))
    inertias = 1.0 / np.diag(_mobility(model, armature))
    for k, (row, joint) in enumerate(zip(table, joints)):
        servo = chosen[k] if chosen else None
        torque = model.mass * 9.81 * 0.1
        if servo is not None:
            torque = _stall_torque(servo)
        elif joint.effort < 1e3:
            torque = joint.effort
        stiffness = max(torque, 1e-6) / STOP_DEPTH
        row[:] = max(joint.lower, -1e300), min(joint.upper, 1e300), stiffness, 2.0 * math.sqrt(stiffness * inertias[k])
    return table


def _stall_torque(servo: Servo) -> float:
    if servo.controller.torque_limit < math.inf:
        return servo.controller.torque_limit
    current = min(servo.current_limit, servo.voltage_limit / servo.resistance)
    return servo.gearbox.ratio * servo.motor_constant * current


def _by_body(model: Model, tree: Tree):
    """The contact points, those of one body together."""
    return sorted(model.contacts, key=lambda point: tree.placements[point.link].row)


def _contact_table(model: Model, tree: Tree, ground: Ground) -> np.ndarray:
    """Stiffness and damping from sinking and damping ratio: k = m g / (N sinking), and for small motions about rest
    c = 2 zeta sqrt(k m / N), which Hunt and Crossley's law has at its static depth for d = 2 zeta / sqrt(g sinking)."""
    points = _by_body(model, tree)
    share = model.mass / len(points)
    k = share * 9.81 / ground.sinking
    table = np.zeros((len(points), layout.CONTACT_COLUMNS))
    for row, point in zip(table, points):
        place = tree.placements[point.link]
        row[: layout.CK] = place.r + place.E @ np.array(point.position)
        row[layout.CK], row[layout.CD] = k, 2.0 * ground.damping_ratio / math.sqrt(9.81 * ground.sinking)
        row[layout.CMU] = ground.friction
        row[layout.CTK], row[layout.CTD] = k, 2.0 * max(ground.damping_ratio, 0.1) * math.sqrt(k * share)
    return table


def _ground_table(ground: Ground) -> np.ndarray:
    c, s = math.cos(ground.slope), math.sin(ground.slope)
    table = np.zeros((1 + len(ground.steps), layout.GROUND_COLUMNS))
    table[0] = (-s, 0.0, c, c, 0.0, s, 0.0, 1.0, 0.0, ground.height * c)
    for row, step in zip(table[1:], ground.steps):
        row[:2] = step
    return table


def _fall_height(model: Model, tree: Tree, ground: Ground, fraction: float) -> float:
    """Height of the base [m] below which the robot lies."""
    from .dynamics import forward_kinematics

    q = np.zeros(model.nq)
    q[3] = 1.0
    poses = forward_kinematics(model, q)
    names = [link.name for link in model.links]
    lowest = min(
        (poses.position[k] + poses.rotation[k] @ np.array(p.position))[2]
        for p in model.contacts
        for k in [names.index(p.link)]
    )
    return ground.height - fraction * lowest


def _offsets(tree: Tree, sampled: bool, constants: Scene) -> np.ndarray:
    """Give each part of the state its place."""
    n, base = tree.n, tree.floating
    servo, gear = n * sampled, n * (constants.gear is not None)
    points = 0 if constants.points is None else len(constants.points)
    sizes = {
        "base_q": 7 * base,
        "q": n,
        "base_qd": 6 * base,
        "qd": n,
        "current": servo,
        "rotor": gear,
        "rotor_speed": gear,
        "filtered": servo,
        "bristle": 2 * points,
        "energy": layout.ENERGIES * n,
        "contact_work": 1,
        "voltage": servo,
        "integral": servo,
        "last_error": servo,
        "base_qdd": 6 * base,
        "qdd": n,
        "torque": n,
        "contact_force": 3 * points,
        "increment": n,
        "chatter": n,
        "worst_chatter": n,
        "passes": 2,
        "status": 1,
        "end": 1,
    }
    offsets, at = np.zeros(1, layout.STATE), 0
    for name in layout.STATE.names:
        offsets[0][name] = at
        at += sizes.get(name, 0)
    return offsets


def _mobility(model: Model, armature) -> np.ndarray:
    """The joints' part of M^-1 at zero (n, n): accelerations that torques cause."""
    from .dynamics import mass_matrix

    q = np.zeros(model.nq)
    if model.base == "floating":
        q[3] = 1.0
    n = len(model.moving_joints)
    return np.linalg.inv(mass_matrix(model, q, armature=armature))[model.nv - n :, model.nv - n :]


def _preflight(model, chosen, servos, continuous, ground, armature, integrator, timestep) -> Preflight:
    """Limits of explicit steps, and from them what is not given."""
    own = mobility = _mobility(model, armature)
    limits, dampers, springs = [], [], []
    for k, joint in enumerate(model.moving_joints):
        damping, spring = _stiffest(joint, chosen[k] if chosen else None, servos, continuous)
        limits.append(joint_limit(joint.name, 1.0 / mobility[k, k], damping, spring))
        dampers.append(sum(damping.values()))
        springs.append(sum(spring.values()))
    if servos == "mipsd":  # the gear's spring and damper act between link and rotor
        mobility = mobility + np.diag(
            [1.0 / (s.gearbox.ratio**2 * s.gearbox.rotor_inertia) if s else 0 for s in chosen]
        )
    largest = coupled_limit(mobility, np.array(dampers), np.array(springs))
    if ground is not None:
        limits.append(Limit("contact", 2.0 * math.sqrt(ground.sinking / 9.81), "contact spring"))
        largest = min(largest, limits[-1].step)
    step = timestep if timestep is not None else (1e-3 if chosen or ground is not None else 5e-4)
    if not 0 < step < math.inf:
        raise ValueError(f"timestep is {timestep!r} s; it must be positive and finite")
    if integrator is not None:
        reason = "as asked for"
    elif chosen or ground is not None or largest < 10 * step:
        integrator = "implicit_euler"
        reason = f"an explicit step is limited to {largest:.2g} s, or clips and friction make kinks"
    else:
        integrator, reason = "rk4", "nothing is stiff: order 4"
    inertias = tuple(float(x) for x in 1.0 / np.diag(own))
    return Preflight(tuple(limits), integrator, step, reason, inertias, largest)


def _stiffest(joint: Joint, servo: Servo | None, servos, continuous: bool) -> tuple[dict, dict]:
    """Dampers [N m s/rad] and springs [N m/rad] that act on a joint, by name."""
    damping = {"joint damping": joint.damping}
    if servo is None:
        return damping, {}
    damping["viscous friction"] = servo.viscous_friction
    if continuous:
        return damping | {"pd damping": servo.controller.Kd}, {"pd spring": servo.controller.Kp}
    g = servo.gearbox
    if servos == "mipsd":
        return damping | {"gearbox damping": g.damping}, {"gearbox spring": g.stiffness}
    return damping | {"back-EMF": (g.ratio * servo.motor_constant) ** 2 / servo.resistance}, {}
