"""From a model, its servos and the ground to the numbers that kernels read, with a preflight of the step."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from .build.tree import GRAVITY, Tree, compile_tree
from .core import layout
from .core.batch import exponential
from .core.controller import PID_POSITION, PID_SPEED, STATE_FEEDBACK
from .core.pace import PACE
from .core.scene import Scene
from .core.spring import SPRING_COLUMNS
from .dynamics import forward_kinematics, inverse_dynamics, mass_matrix, spring_vectors
from .model import Ground, Joint, Model, Servo, Spring, check_springs
from .preflight import Limit, Preflight, coupled_limit, joint_limit

ServoKind = Literal["mipsd", "rotor", "standard"]
INTEGRATORS = {"implicit_euler": 1.0, "midpoint": 0.5, "rk4": 1.0, "simtwo": 1.0, "dop853": 1.0, "extrapolation": 1.0}
ADAPTIVE = ("dop853", "extrapolation")  # with error control; of the others the number is theta of the step
LAWS = {"state": STATE_FEEDBACK, "pid_position": PID_POSITION, "pid_speed": PID_SPEED}
NO_SERVO_TICK = 1e-2  # [s] between the checks of a scene without sampled controllers
STIFF = 5e-3  # [s]; explicit limit below which extrapolation takes implicit steps
STOP_DEPTH = 0.01  # [rad or m] that the strongest torque at a joint drives it into its stop
STOP_SOFT = 0.1  # of that depth, at which a stop is critically damped
TOOTH_LOAD = 0.1  # of the stall torque, at which teeth that meet across a gap are damped as the gearbox is


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
    springs: tuple[Spring, ...]
    preflight: Preflight
    fall_height: float  # [m]
    fall_upright: float  # cosine
    stiff: bool  # something that an implicit step takes in limits explicit steps to less than `STIFF`
    arguments: dict  # of `compile_scene`, after the model

    def recompiled(self, **changes) -> CompiledScene:
        """The scene with other arguments of `compile_scene`; the state's layout stays."""
        return compile_scene(self.model, **(self.arguments | changes))

    @property
    def adaptive(self) -> bool:
        """Whether the integrator chooses its steps by their error."""
        return self.integrator in ADAPTIVE

    @property
    def gravity(self) -> np.ndarray:
        """(3,) [m/s^2], world axes."""
        return self.constants.gravity

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
    springs: Sequence[Spring] = (),
) -> CompiledScene:
    """Lay a model, its servos and the ground out for the kernels.

    Parameters
    ----------
    servos : "mipsd" (spring-damper gearbox with rotor), "rotor" (rigid, with the rotor's reflected inertia),
        "standard" (rigid, none), or None: no servos, torques from `simulate(tau=...)`
    ground : None where the robot touches nothing
    integrator : "implicit_euler", "midpoint", "rk4" or "simtwo" of fixed steps; "extrapolation", or for what is not
        stiff "dop853", which choose their steps by the error that `simulate` allows; None chooses from the preflight
    timestep : [s]; must divide the controllers' period; None chooses.  Of the latter two the grid of ticks and records
    springs : between points of two links.  All integrators take them explicitly: stiff ones are for "dop853"
    fall_height, fall_tilt : a floating robot over ground has fallen below this fraction of its standing height, or
        tilted by more than this [rad]

    Raises ValueError on servos that the model does not have and on steps that do not fit.
    """
    tree = compile_tree(model)
    drive = _drive(model, servos)
    if ground is not None and not model.contacts:
        raise ValueError(f"{model.name}: ground without contact points; add contacts to its TOML, or ground=None")
    check_springs(model.links, springs)
    check = _preflight(model, drive, ground, springs, integrator, timestep)
    if check.integrator not in INTEGRATORS:
        raise ValueError(f"integrator {check.integrator!r}; use one of {', '.join(INTEGRATORS)}")
    if check.integrator == "simtwo" and not drive.sampled:
        raise ValueError("simtwo is the update order of sampled servos; use implicit_euler for other scenes")
    period, lag = _period(model, drive, check.timestep)
    constants = _constants(model, tree, drive, check, ground, springs, gravity)
    stiff = drive.sampled or ground is not None or check.folded_step < STIFF or _sticks(constants)
    falls = tree.floating and ground is not None
    return CompiledScene(
        model=model,
        tree=tree,
        constants=constants,
        offsets=_offsets(tree, constants),
        integrator=check.integrator,
        timestep=check.timestep,
        tick_steps=round(period / check.timestep),
        lag=lag,
        servos=servos,
        ground=ground,
        springs=tuple(springs),
        preflight=check,
        fall_height=_fall_height(model, fall_height) if falls else -math.inf,
        fall_upright=math.cos(fall_tilt) if falls else -2.0,
        stiff=stiff,
        arguments={
            "servos": servos,
            "ground": ground,
            "integrator": check.integrator,
            "timestep": check.timestep,
            "gravity": gravity,
            "fall_height": fall_height,
            "fall_tilt": fall_tilt,
            "springs": tuple(springs),
        },
    )


def _sticks(constants: Scene) -> bool:
    """Whether a joint has Coulomb friction, whose steep part about zero speed is a strong damper."""
    return constants.friction is not None and bool(constants.friction[:, layout.COULOMB].any())


class _Drive(NamedTuple):
    """The servos of a scene, joint by joint."""

    kind: ServoKind | None
    servos: list[Servo | None]  # of each moving joint; empty without servos
    sampled: bool
    continuous: bool
    armature: np.ndarray | None  # reflected inertia G^2 J of rigid gearboxes [kg m^2]

    def of(self, k: int) -> Servo | None:
        return self.servos[k] if self.servos else None


def _drive(model: Model, kind: ServoKind | None) -> _Drive:
    if kind is None:
        return _Drive(None, [], False, False, None)
    if kind not in ("mipsd", "rotor", "standard"):
        raise ValueError(f"servos is {kind!r}; use 'mipsd', 'rotor', 'standard' or None")
    servos = [model.servos.get(name) for name in model.joint_names]
    if not any(servos):
        raise ValueError(f"{model.name} has no servos; name them in the [servos] table of its TOML, or use servos=None")
    laws = {servo.controller.law in ("pd", "pd_clamped") for servo in servos if servo}
    if len(laws) > 1:
        raise ValueError(f"{model.name} mixes pd servos with sampled ones; give all joints one kind of law")
    continuous = laws.pop()
    if continuous and kind == "mipsd":
        raise ValueError(f"{model.name}: a pd servo has no motor to drive a spring-damper gearbox; use servos='rotor'")
    armature = None
    if kind == "rotor":
        armature = np.array([s.gearbox.ratio**2 * s.gearbox.rotor_inertia if s else 0.0 for s in servos])
    return _Drive(kind, servos, not continuous, continuous, armature)


def _constants(model: Model, tree: Tree, drive: _Drive, check: Preflight, ground, springs, gravity) -> Scene:
    """All parameter arrays; None for what the scene lacks."""
    h, sampled = check.timestep, drive.sampled
    laws = [LAWS[servo.controller.law] if servo else 0 for servo in drive.servos] if sampled else None
    rows = [tree.placements[point.link].row for point in _by_body(model, tree)]
    return Scene(
        tree=tree.bodies,
        floating=True if tree.floating else None,
        gravity=np.array(gravity, dtype=float),
        servo=_servo_table(drive, h) if sampled else None,
        gear=_gear_table(model, drive) if sampled and drive.kind == "mipsd" else None,
        pd=_pd_table(drive, check) if drive.continuous else None,
        law=np.array(laws, np.int64) if sampled else None,
        armature=drive.armature,
        friction=_friction_table(model, drive, check.integrator),
        stops=_stop_table(model, drive, check),
        points=None if ground is None else _contact_table(model, tree, ground),
        point_bodies=None if ground is None else np.array(rows, np.int64),
        ground=None if ground is None else _ground_table(ground),
        push=None,
        push_rows=None,
        springs=_spring_table(tree, springs) if springs else None,
        spring_rows=_spring_rows(tree, springs) if springs else None,
    )


def _period(model: Model, drive: _Drive, h: float) -> tuple[float, float]:
    """Controller tick and lag [s], one for all joints."""
    if not drive.sampled:
        return max(1, round(NO_SERVO_TICK / h)) * h, 0.0
    settings = {(s.controller.period, s.controller.lag) for s in drive.servos if s}
    if len(settings) > 1:
        raise ValueError(f"{model.name}: controllers differ in period or lag: {sorted(settings)}; give them the same")
    period, lag = settings.pop()
    if round(period / h) < 1 or abs(round(period / h) * h - period) > 1e-9 * period:
        raise ValueError(
            f"timestep {h:g} s does not divide the controllers' period of {period:g} s; steps end on ticks"
        )
    return period, lag


def _servo_table(drive: _Drive, h: float) -> np.ndarray:
    table = np.zeros((len(drive.servos), layout.SERVO_COLUMNS))
    table[:, layout.RES] = 1.0  # a joint without a servo: no torque, no current
    for row, servo in zip(table, drive.servos):
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


def _gear_table(model: Model, drive: _Drive) -> np.ndarray:
    table = np.zeros((len(drive.servos), layout.GEAR_COLUMNS))
    table[:, layout.INERTIA] = 1.0
    table[:, layout.RATIO] = 1.0
    for row, servo, name in zip(table, drive.servos, model.joint_names):
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
            g.damping / (TOOTH_LOAD * _stall_torque(servo)),
        )
    return table


def _pd_table(drive: _Drive, check: Preflight) -> np.ndarray:
    """Fold the spring only where its own period needs it: Euler is more accurate with it at the start of the step."""
    h = check.timestep
    table = np.zeros((len(drive.servos), layout.PD_COLUMNS))
    for row, servo, inertia in zip(table, drive.servos, check.inertias):
        if servo is not None:
            c = servo.controller
            limit = c.torque_limit if c.torque_limit < math.inf else 1e300
            fold = check.integrator in ("midpoint", "extrapolation") or h * h * c.Kp > inertia + h * c.Kd
            row[:] = (c.Kp, c.Kd, limit, c.law == "pd", fold)
    return table


def _friction_table(model: Model, drive: _Drive, integrator: str) -> np.ndarray | None:
    """Viscous and Coulomb friction of joint and servo; the 2012 order applies the servo's viscous part itself."""
    table = np.zeros((len(model.moving_joints), layout.FRICTION_COLUMNS))
    for k, joint in enumerate(model.moving_joints):
        servo = drive.of(k)
        own = servo.viscous_friction if servo and integrator != "simtwo" else 0.0
        table[k] = joint.damping + own, joint.friction + (servo.coulomb_friction if servo else 0.0)
    return table if table.any() else None


def _stop_table(model: Model, drive: _Drive, check: Preflight) -> np.ndarray | None:
    """One-sided stops, critically damped at a small depth with the inertia that the joint feels at zero."""
    joints = model.moving_joints
    if not any(math.isfinite(j.lower) or math.isfinite(j.upper) for j in joints):
        return None
    table = np.zeros((len(joints), layout.STOP_COLUMNS))
    for k, (row, joint) in enumerate(zip(table, joints)):
        servo = drive.of(k)
        torque = model.mass * 9.81 * 0.1
        if servo is not None:
            torque = _stall_torque(servo)
        elif joint.effort < 1e3:
            torque = joint.effort
        stiffness = max(torque, 1e-6) / STOP_DEPTH
        row[:] = (
            max(joint.lower, -1e300),
            min(joint.upper, 1e300),
            stiffness,
            2.0 * math.sqrt(stiffness * check.inertias[k]),
        )
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


def _spring_table(tree: Tree, springs: Sequence[Spring]) -> np.ndarray:
    """The ends in the frames of the bodies that carry the links, and what joins them."""
    table = np.zeros((len(springs), SPRING_COLUMNS))
    for row, s in zip(table, springs):
        a, b = tree.placements[s.a], tree.placements[s.b]
        row[:] = (*(a.r + a.E @ s.point_a), *(b.r + b.E @ s.point_b), s.stiffness, s.damping, s.length)
    return table


def _spring_rows(tree: Tree, springs: Sequence[Spring]) -> np.ndarray:
    return np.array([[tree.placements[s.a].row, tree.placements[s.b].row] for s in springs], np.int64)


def _fall_height(model: Model, fraction: float) -> float:
    """Height of the base over the ground [m] below which the robot lies."""
    q = np.zeros(model.nq)
    q[3] = 1.0
    poses = forward_kinematics(model, q)
    names = [link.name for link in model.links]
    lowest = min(
        (poses.position[k] + poses.rotation[k] @ np.array(p.position))[2]
        for p in model.contacts
        for k in [names.index(p.link)]
    )
    return -fraction * lowest


def _offsets(tree: Tree, constants: Scene) -> np.ndarray:
    """Give each part of the state its place."""
    n, base = tree.n, tree.floating
    servo, gear = n * (constants.servo is not None), n * (constants.gear is not None)
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
        "pace": PACE,
        "status": 1,
        "end": 1,
    }
    offsets, at = np.zeros(1, layout.STATE), 0
    for name in layout.STATE.names:
        offsets[0][name] = at
        at += sizes.get(name, 0)
    return offsets.view(np.recarray)


def _mobility(model: Model, armature, springs: Sequence[Spring]) -> np.ndarray:
    """J M^-1 J' at zero (n + springs, ...): accelerations of joints and springs' lengths that forces on these cause.

    J holds the joints' own directions, then how fast each spring lengthens.
    """
    q = np.zeros(model.nq)
    if model.base == "floating":
        q[3] = 1.0
    n = len(model.moving_joints)
    J = np.zeros((n + len(springs), model.nv))
    J[:n, model.nv - n :] = np.eye(n)
    if springs:
        J[n:] = _lengthening(model, springs, q)
    return J @ np.linalg.inv(mass_matrix(model, q, armature=armature)) @ J.T


def _lengthening(model: Model, springs: Sequence[Spring], q: np.ndarray) -> np.ndarray:
    """dl/dt of each spring by velocity (springs, nv): the generalised force that holds it against a pull of 1 N."""
    still, rotation = np.zeros(model.nv), forward_kinematics(model, q).rotation
    names = [link.name for link in model.links]
    rows = []
    for spring, d in zip(springs, spring_vectors(model, springs, q)):
        length = np.linalg.norm(d)
        pull = d / length if length > 0 else d
        wrench = {
            link: np.concatenate([np.cross(rotation[names.index(link)] @ point, force), force])
            for link, point, force in ((spring.a, spring.point_a, pull), (spring.b, spring.point_b, -pull))
        }
        rows.append(inverse_dynamics(model, q, still, still, wrench=wrench, gravity=(0.0, 0.0, 0.0)))
    return np.array(rows)


def _preflight(model: Model, drive: _Drive, ground: Ground | None, between, integrator, timestep) -> Preflight:
    """Limits of explicit steps, and from them what is not given; between: the springs between bodies."""
    mobility, n = _mobility(model, drive.armature, between), len(model.moving_joints)
    inertias = tuple(float(x) for x in 1.0 / np.diag(mobility)[:n])
    acting = [(joint.name, *_stiffest(joint, drive.of(k), drive)) for k, joint in enumerate(model.moving_joints)]
    acting += [(f"{s.a} - {s.b}", {"spring's damper": s.damping}, {"spring": s.stiffness}) for s in between]
    limits = [joint_limit(name, 1.0 / own if own > 0 else math.inf, damping, spring)
              for own, (name, damping, spring) in zip(np.diag(mobility), acting)]  # fmt: skip
    dampers, springs = (np.array([sum(x[k].values()) for x in acting]) for k in (1, 2))
    if drive.kind == "mipsd":  # the gear's spring and damper act between link and rotor
        for k, s in enumerate(drive.servos):
            mobility[k, k] += 1.0 / (s.gearbox.ratio**2 * s.gearbox.rotor_inertia) if s else 0.0
    folded = coupled_limit(mobility[:n, :n], dampers[:n], springs[:n])
    largest = coupled_limit(mobility, dampers, springs)
    if ground is not None:
        limits.append(Limit("contact", 2.0 * math.sqrt(ground.sinking / 9.81), "contact spring"))
        folded, largest = min(folded, limits[-1].step), min(largest, limits[-1].step)
    step = timestep if timestep is not None else (1e-3 if drive.servos or ground is not None else 5e-4)
    if not 0 < step < math.inf:
        raise ValueError(f"timestep is {timestep!r} s; it must be positive and finite")
    if integrator is not None:
        reason = "as asked for"
    elif drive.servos or ground is not None or folded < 10 * step:
        integrator = "implicit_euler"
        reason = f"an explicit step is limited to {largest:.2g} s, or clips and friction make kinks"
    else:
        integrator, reason = "dop853", "nothing is stiff: order 8"
        if largest < 10 * step:
            reason = f"springs between bodies limit any step to some {largest:.2g} s: order 8 finds its own"
    return Preflight(tuple(limits), integrator, step, reason, inertias, largest, folded)


def _stiffest(joint: Joint, servo: Servo | None, drive: _Drive) -> tuple[dict, dict]:
    """Dampers [N m s/rad] and springs [N m/rad] that act on a joint, by name."""
    damping = {"joint damping": joint.damping}
    if servo is None:
        return damping, {}
    damping["viscous friction"] = servo.viscous_friction
    if drive.continuous:
        return damping | {"pd damping": servo.controller.Kd}, {"pd spring": servo.controller.Kp}
    g = servo.gearbox
    if drive.kind == "mipsd":
        return damping | {"gearbox damping": g.damping}, {"gearbox spring": g.stiffness}
    return damping | {"back-EMF": (g.ratio * servo.motor_constant) ** 2 / servo.resistance}, {}
