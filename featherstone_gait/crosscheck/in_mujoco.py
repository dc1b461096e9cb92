"""Replay of a motion in MuJoCo: the robot's bodies, MuJoCo's contact, and the servos of `servo_chain.py`.

A rotor is a body of its own, a hinge at the world with the reflected inertia as armature; the gearbox is a fixed tendon
between rotor and joint with its stiffness and damping.  A rigid gearbox is armature at the joint.  The motor acts on
the rotor, or on the joint; ticks, lag and speeds of the controllers are those of the scene.  Gears with
backlash have no tendon: their tooth forces come from the chain.  Dry friction is MuJoCo's `frictionloss`, in each step
as large as the servo's budget at the loads of the last one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from ..base.arguments import instance, one_of, real
from ..core.effects.energies import ENERGIES, METER, WORK
from ..core.effects.push import EVENT_MARGIN
from ..model import TORQUE_LAWS, ContactPoint, Controller, Ground, Link, Model, Servo, depends_on_load_or_speed
from ..robot_file.markup import element
from ..robot_file.mjcf.read import heard
from ..robot_file.mjcf.write import mjcf_text
from ..run.program import SEEN, CompiledController, State
from ..run.reference import Reference
from ..run.start import positions_in, standing_state
from ..run.status import Status
from ..run.trajectory import Trajectory
from ..scene.compile import CompiledScene
from ..scene.contact import plane_axes
from .servo_chain import ServoChain, is_gentle

Objects = Callable[[Any], np.ndarray]  # adds objects to a specification; returns their velocities (objects, 6)
Soles = Literal["spheres", "boxes"]
SOLES: tuple[Soles, ...] = get_args(Soles)
INSTALL = "the crosscheck runs MuJoCo; install it with pip install featherstone-gait[mjcf]"
TIMESTEP = 2.5e-4  # [s]
RADIUS = 1e-4  # of a contact point as a sphere [m]
THICKNESS = 0.01  # of a box under a link [m]
FLAT = 1e-6  # how far contact points may lie off the underside of one box [m]
SETTLING = 1.0  # time for which a robot stands before its penetration is read [s]
LIGHT = 1e-9, 1e-12  # mass [kg] and moments of inertia [kg m^2] of a rotor's body, beside its armature
LEAST_FRICTION = 1e-9  # of a joint's dry friction [N m], so that MuJoCo keeps a constraint for it
PREFIX = "rotor of "


@dataclass(frozen=True)
class Floor:
    """A floor in MuJoCo, a plane as the scene's: solref = (time_constant, 1), MuJoCo's default solimp, elliptic cone.

    Attributes
    ----------
    time_constant : float
        Time constant of the contact [s]; MuJoCo requires two steps or more.
    friction : float
        Coefficient of sliding friction.
    soles : {"spheres", "boxes"}
        A sphere of 0.1 mm at each contact point, or a box for each link with the contact points as corners.
    impratio : float
        Ratio of frictional to normal impedance; at MuJoCo's default of 1 sticking contacts creep.
    """

    time_constant: float
    friction: float
    soles: Soles = "spheres"
    impratio: float = 1.0


class Machine(NamedTuple):
    """MuJoCo's model, the servos and the joints' addresses; arrays are (n,) in the order of the robot's joints."""

    m: Any
    d: Any
    chain: ServoChain
    q: np.ndarray  # addresses in qpos
    v: np.ndarray  # ... and in qvel
    motor: np.ndarray  # in qvel, of the degrees of freedom that the motors drive
    rotor: np.ndarray | None  # in qpos, of the rotors; None where gearboxes are rigid
    gears: np.ndarray  # (n, 2) stiffness [N m/rad] and damping [N m s/rad] of the gearboxes between
    drives: np.ndarray  # joints with a torque law, in the order of MuJoCo's actuators
    work: np.ndarray  # of these actuators, by joint [J]
    armature: np.ndarray  # that moves with the joint, not with the rotor [kg m^2]
    viscous: np.ndarray  # friction of joint and servo [N m s/rad] ...
    coulomb: np.ndarray  # ... and dry [N m]
    loaded: bool  # whether the dry friction depends on load or speed
    objects: np.ndarray  # (objects, 7) addresses in qpos
    thrown: np.ndarray  # (objects, 6) their first velocities


def replay(
    scene: CompiledScene,
    duration: float,
    q: np.ndarray,
    reference: Reference,
    floor: Floor | None = None,
    *,
    timestep: float = TIMESTEP,
    controller: CompiledController | None = None,
    objects: Objects | None = None,
) -> Trajectory:
    """Run a robot in MuJoCo from rest.

    Parameters
    ----------
    scene : CompiledScene
        The robot with its servos.
    duration : float
        Duration, rounded up to whole ticks of the controllers [s].
    q : ndarray, shape (nq,)
        First positions [m, -, rad].
    reference : Reference
        The servos' reference.
    floor : Floor, optional
        The floor; by default none.
    timestep : float
        MuJoCo's time step, which divides the tick [s].
    controller : CompiledController, optional
        Controller, called in Python with the channels q, qd, base_q, base_qd and base_qdd.
    objects : callable, optional
        Adds free bodies, and geoms that touch them, to the `mujoco.MjSpec` of the robot, of which links are bodies;
        returns the first velocities (objects, 6) of these bodies [m/s, rad/s].

    Returns
    -------
    Trajectory
        A sample at each tick, with the channels time, q, qd, torque (on the joints), current, energy (its column
        "electrical_no_regeneration" alone, others are nan) and, of a floating base, base_q and base_qd; with objects
        also object_q (samples, objects, 7).  The status is "ok", "fell" (by the scene's rule) or "diverged", at
        `end_time`.

    Raises
    ------
    ImportError
        Without MuJoCo.
    ValueError
        For torque laws and springs between bodies, which the replay lacks.
    """
    instance("scene", scene, CompiledScene, "give what compile_scene returns")
    period = scene.tick_steps * scene.timestep
    per_tick = round(period / real("timestep", timestep, 1e-6, period, "give MuJoCo's step [s]"))
    if abs(per_tick * timestep - period) > 1e-9 * period:
        raise ValueError(f"timestep {timestep:g} s does not divide the controllers' period of {period:g} s")
    machine = machine_of(scene, floor, timestep, objects)
    place(machine, q)
    ticks = math.ceil(duration / period - 1e-9)
    drive, rate = evaluated(reference, period * np.arange(ticks) - scene.lag + EVENT_MARGIN)
    acts = None if controller is None else _Acting(controller, scene, machine)
    rows, status = [sample_of(scene, machine)], "ok"
    for k in range(ticks):
        if acts is not None:
            drive[k], rate[k] = acts(k, np.stack([drive[k], rate[k]], axis=1)).T
        advance(machine, drive[k], rate[k], period, per_tick)
        rows.append(sample_of(scene, machine))
        if not np.isfinite(machine.d.qpos).all() or machine.d.warning.number.any():
            status = "diverged"
        elif floor is not None and has_fallen(scene, machine):
            status = "fell"
        if status != "ok":
            break
    end = period * (len(rows) - 1)
    channels = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    channels["time"] = period * np.arange(len(rows))
    message = "" if status == "ok" else f"{scene.model.name} {status} at {end:.4g} s"
    info = {"robot": scene.model.name, "engine": f"MuJoCo {mujoco_version()}", "timestep": timestep}
    return Trajectory(channels, Status(status), message, end, np.empty(0), info)


class _Acting:
    """A user's controller in this engine."""

    def __init__(self, controller: CompiledController, scene: CompiledScene, machine: Machine) -> None:
        if controller.writes != "reference":
            what = f"controller {controller.name} writes {controller.writes}s"
            raise ValueError(f"{what}; the replay in MuJoCo has references alone: write these")
        self._function, self._every, self._machine = controller.function, controller.every(scene), machine
        self._memory = np.zeros(controller.memory)
        self._memory[:] = controller.first_memory
        self._command = np.empty((0, 2))
        self._tick, self._floating = scene.tick_steps * scene.timestep, scene.model.base == "floating"

    def __call__(self, k: int, reference: np.ndarray) -> np.ndarray:
        """Return the command (n, 2) at tick k for a reference (n, 2)."""
        if k % self._every == 0:
            d, machine = self._machine.d, self._machine
            seen = {"q": d.qpos[machine.q], "qd": d.qvel[machine.v]}
            if self._floating:
                seen |= {"base_q": d.qpos[:7], "base_qd": d.qvel[:6], "base_qdd": d.qacc[:6]}
            state = State(*(seen.get(name, np.empty(0)) for name in SEEN))
            self._command = reference.copy()
            self._function(k * self._tick, state, reference, self._command, self._memory)
        return self._command


def standing(scene: CompiledScene, angles: np.ndarray, sinking: float) -> np.ndarray:
    """Return the positions of the robot standing upright with a given penetration of its lowest contact point.

    Parameters
    ----------
    scene : CompiledScene
        The robot on ground.
    angles : ndarray, shape (n,)
        Joint angles [rad].
    sinking : float
        Penetration [m].

    Returns
    -------
    ndarray, shape (nq,)
        Position [m] and quaternion of the base, then the joint angles [rad].
    """
    if scene.ground is None:
        raise ValueError(f"{scene.model.name}: there is no ground to stand on; compile the scene with ground=Ground()")
    q = positions_in(scene, standing_state(scene, angles, allow_limit_violation=True))
    q[2] += (scene.ground.penetration - sinking) / float(plane_axes(scene.ground)[0, 2])
    return q


def sinking(scene: CompiledScene, angles: np.ndarray, floor: Floor, *, timestep: float = TIMESTEP) -> float:
    """Measure the mean penetration of the robot's contact points in MuJoCo's floor after a second of standing.

    Parameters
    ----------
    scene : CompiledScene
        The robot with its servos, on ground.
    angles : ndarray, shape (n,)
        Joint angles that the servos hold [rad].
    floor : Floor
        The floor.
    timestep : float
        MuJoCo's time step [s].

    Returns
    -------
    float
        Penetration [m].

    Raises
    ------
    ImportError, ValueError
        As `replay`; ValueError for a robot that does not stand.
    """
    machine = machine_of(scene, floor, timestep)
    place(machine, standing(scene, angles, 0.0))
    period, still = scene.tick_steps * scene.timestep, np.zeros_like(angles)
    for _ in range(round(SETTLING / period)):
        advance(machine, angles, still, period, round(period / timestep))
    depth = float(np.maximum(-machine.d.contact.dist, 0.0).sum()) / len(scene.model.contacts)
    if has_fallen(scene, machine) or depth <= 0.0:
        raise ValueError(f"{scene.model.name} does not stand in the first posture; its sinking cannot be measured")
    return depth


def evaluated(reference: Reference, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return values and rates (k, n) of a reference at `times` (k,) [s]."""
    knots = reference.knots()
    if knots.period:
        times = knots.times[0] + np.mod(times - knots.times[0], knots.period)
    inside = (knots.times[0] <= times) & (times <= knots.times[-1])
    at = np.clip(times, knots.times[0], knots.times[-1])
    k = np.clip(np.searchsorted(knots.times, at, side="right") - 1, 0, len(knots.cubics) - 1)
    s, (a, b, c, d) = (at - knots.times[k])[:, None], np.moveaxis(knots.cubics[k], 2, 0)
    return a + s * (b + s * (c + s * d)), np.where(inside[:, None], b + s * (2.0 * c + s * 3.0 * d), 0.0)


# ---------------------------------------------------------------------------------------------- stepping


def advance(machine: Machine, reference: np.ndarray, rate: np.ndarray, period: float, count: int) -> None:
    """Make a tick of the controllers and `count` steps of MuJoCo; voltages act when their delay is over."""
    d, chain, h = machine.d, machine.chain, period / count
    d.ctrl[:] = reference[machine.drives]
    waits = round(chain.delay * count / period)
    if abs(waits * h - chain.delay) > 1e-9 * chain.delay:
        raise ValueError(f"timestep {h:g} s does not divide the controllers' delay of {chain.delay:g} s")
    slots, shift = -(-waits // count), waits % count
    if chain.delay and not chain.waiting:
        chain.waiting = [np.zeros_like(chain.voltage)] * (slots - (shift > 0))
    if chain.delay and shift == 0:
        chain.arrive(d.qvel[machine.motor])
    chain.tick(reference, rate, d.qpos[machine.q], d.qvel[machine.motor], period)
    if shift:
        _steps(machine, shift)
        chain.arrive(d.qvel[machine.motor])
    _steps(machine, count - shift)


def _steps(machine: Machine, count: int) -> None:
    """Make steps of MuJoCo with the motors' torques; its warnings (a state that it resets) are in `d.warning`."""
    mujoco, d, chain, joints, motors = _mujoco(), machine.d, machine.chain, machine.v, machine.motor
    speeds, applied, loose = d.qvel, d.qfrc_applied, chain.gears.loose
    with heard(mujoco, []):
        for _ in range(count):
            applied[motors] = 0.0
            applied[joints] = chain.friction(speeds[joints])
            torque = chain.step(speeds[motors])
            applied[motors] += torque
            if machine.rotor is not None:
                torque = _through_gears(machine)
                if loose.any():  # gears with backlash have no tendon
                    pushed = np.where(loose, torque, 0.0)
                    applied[joints] += pushed
                    applied[motors] -= pushed
            if machine.loaded:
                machine.m.dof_frictionloss[joints] = _budget(machine, torque + d.qfrc_actuator[joints])
            mujoco.mj_step(machine.m, d)
            chain.filter(speeds[joints])
            if machine.drives.size:
                machine.work[:] += machine.m.opt.timestep * d.qfrc_actuator[joints] * speeds[joints]


def _through_gears(machine: Machine) -> np.ndarray:
    """Return the gearboxes' torques on the joints [N m]."""
    d, teeth, (stiffness, damping) = machine.d, machine.chain.gears, machine.gears.T
    e, de = d.qpos[machine.rotor] - d.qpos[machine.q], d.qvel[machine.motor] - d.qvel[machine.v]
    sprung = stiffness * e + damping * de
    return np.where(teeth.loose, teeth.torque(e, de), sprung) if teeth.loose.any() else sprung


def _budget(machine: Machine, t_m: np.ndarray) -> np.ndarray:
    """Return the largest dry friction in the next step [N m], from the mechanism's load on the joints in the last.

    The load is t_e of A dv/dt = t_m + t_f + t_e, t_f all friction: the viscous one, and what MuJoCo's constraint gave.
    """
    d, joints, types = machine.d, machine.v, _mujoco().mjtConstraint
    constrained = d.efc_type[: d.nefc] == types.mjCNSTR_FRICTION_DOF
    dry = np.zeros(machine.m.nv)
    dry[d.efc_id[: d.nefc][constrained]] = d.efc_force[: d.nefc][constrained]
    speed = d.qvel[joints]
    t_e = machine.armature * d.qacc[joints] + machine.viscous * speed - t_m - dry[joints]
    return np.maximum(machine.coulomb + machine.chain.gears.budget(speed, t_m, t_e), LEAST_FRICTION)


def place(machine: Machine, q: np.ndarray) -> None:
    """Place the robot at rest with positions q (nq,), its rotors turned as far as its joints."""
    m, d, base = machine.m, machine.d, len(q) - len(machine.q)
    _mujoco().mj_resetData(m, d)
    d.qpos[:base] = q[:base]
    d.qpos[machine.q] = q[base:]
    if machine.rotor is not None:
        d.qpos[machine.rotor] = q[base:]
    if len(machine.thrown):
        d.qvel[-machine.thrown.size :] = machine.thrown.ravel()
    machine.chain.goal, machine.work[:] = q[base:].copy(), 0.0
    _mujoco().mj_forward(m, d)


def sample_of(scene: CompiledScene, machine: Machine) -> dict[str, np.ndarray]:
    """Return the channels of a sample; a base's velocities have the same convention in MuJoCo and here."""
    d, chain = machine.d, machine.chain
    q, v = d.qpos[machine.q], d.qvel[machine.v]
    energy = np.full((len(q), ENERGIES), np.nan)
    energy[:, METER] = chain.meter
    if machine.drives.size:
        energy[:, WORK] = machine.work
    torque = chain.K * chain.current if machine.rotor is None else _through_gears(machine)
    torque = d.qfrc_actuator[machine.v] if machine.drives.size else torque
    base = {"base_q": d.qpos[:7].copy(), "base_qd": d.qvel[:6].copy()} if scene.model.base == "floating" else {}
    if len(machine.objects):
        base["object_q"] = d.qpos[machine.objects]
    return base | {"q": q, "qd": v, "torque": torque, "current": chain.current.copy(), "energy": energy}


def has_fallen(scene: CompiledScene, machine: Machine) -> bool:
    """Check whether the center of mass is too low or the base tilted too far, as `core/integrate/rollout.py` does."""
    d = machine.d
    tilt = np.zeros(9)
    _mujoco().mju_quat2Mat(tilt, d.qpos[3:7])
    upright, height = float(tilt[6:] @ np.array(scene.upright)), d.subtree_com[1, 2]
    if scene.ground is not None:
        up = plane_axes(scene.ground)[0]
        height = d.subtree_com[1] @ up - scene.ground.height * up[2]
    return bool(upright < scene.fall_upright or height < scene.fall_height)


# ---------------------------------------------------------------------------------------------- the robot


def _mujoco() -> Any:
    try:
        import mujoco
    except ImportError as error:
        raise ImportError(INSTALL) from error
    return mujoco


def mujoco_version() -> str:
    """Return MuJoCo's version; raise ImportError without MuJoCo."""
    return str(_mujoco().__version__)


def _servos(scene: CompiledScene, held: bool) -> dict[str, Servo]:
    """Return the servos of the moving joints; raise ValueError for what the replay lacks.

    held: references change at ticks alone, so that a torque law may be an actuator of MuJoCo.
    """
    model = scene.model
    servos = {name: model.servos[name] for name in model.joint_names if scene.gearbox and name in model.servos}
    laws = {name: servo.controller for name, servo in servos.items() if servo.controller.law in TORQUE_LAWS}
    lacks = [name for name, law in laws.items() if not held or law.law != "pd_clamped" or law.wrap]
    missing = [f"{name}: the torque law {laws[name].law!r}" for name in lacks]
    missing += ["springs between bodies"] * bool(scene.springs)
    missing += [f"{one.name}: the drive of a tendon" for one in scene.driven_tendons]
    missing += [f"{one.name}: a tendon of joints and a path" for one in model.tendons if one.joints and one.path]
    missing += ["surfaces that move"] * (scene.constants.surfaces is not None)
    missing += ["rollers of wheels"] * any(point.roller_angle is not None for point in model.contacts)
    missing += ["rolling resistance of contact points"] * any(point.rolling_friction for point in model.contacts)
    if missing:
        raise ValueError(f"{model.name}: the replay in MuJoCo lacks {missing[0]}; leave it out of the robot to compare")
    return servos


def machine_of(
    scene: CompiledScene, floor: Floor | None, h: float, objects: Objects | None = None, held: bool = False
) -> Machine:
    """Build a robot with its servos on a floor, for steps of h [s]; raise ValueError for what the replay lacks.

    held: references change at ticks alone.
    """
    mujoco, model, servos = _mujoco(), scene.model, _servos(scene, held)
    bare, _ = mjcf_text(replace(model, servos={}, contacts=(), shapes=(), keyframes={}, sensors=()))
    spec = mujoco.MjSpec.from_string(_with_rotors(bare, servos if scene.gearbox == "mipsd" else {}))
    if floor is not None:
        _lay(spec, scene, floor, h)
        spec.option.impratio = real("floor: impratio", floor.impratio, 1e-3, 1e6, "1 is MuJoCo's default")
    thrown = np.zeros((0, 6)) if objects is None else objects(spec)
    laws = {name: one.controller for name, one in servos.items() if one.controller.law in TORQUE_LAWS}
    for name, law in laws.items():
        _actuate(spec, name, law)
    m = spec.compile()
    free = m.jnt_qposadr[m.jnt_type == mujoco.mjtJoint.mjJNT_FREE][int(model.base == "floating") :]
    m.opt.timestep, m.opt.gravity[:] = h, scene.gravity
    m.opt.integrator, m.opt.cone = mujoco.mjtIntegrator.mjINT_IMPLICITFAST, mujoco.mjtCone.mjCONE_ELLIPTIC
    joints = [m.joint(name) for name in model.joint_names]
    v = np.array([joint.dofadr[0] for joint in joints])
    armature, loaded = m.dof_armature[v].copy(), any(depends_on_load_or_speed(s.gearbox) for s in servos.values())
    for name, address in zip(model.joint_names, v):
        if name in servos:
            servo = servos[name]
            m.dof_damping[address] += servo.viscous_friction
            m.dof_frictionloss[address] += 0.0 if is_gentle(servo, h) else servo.coulomb_friction
            if scene.gearbox != "mipsd":
                m.dof_damping[address] += servo.gearbox.reflected_damping
            if scene.gearbox == "rotor":
                m.dof_armature[address] += servo.gearbox.reflected_inertia
    q, motor, rotor = np.array([joint.qposadr[0] for joint in joints]), v, None
    if scene.gearbox == "mipsd":
        rotors = [m.joint(PREFIX * (name in servos) + name) for name in model.joint_names]  # else the joint itself
        motor, rotor = (np.array([getattr(x, of)[0] for x in rotors]) for of in ("dofadr", "qposadr"))
    gears = np.zeros((len(v), 2))
    gears[[model.joint_rows[name] for name in servos]] = [
        (servo.gearbox.stiffness, servo.gearbox.damping) for servo in servos.values()
    ]
    rigid = m.dof_armature[v] if scene.gearbox == "rotor" else armature
    viscous, coulomb = m.dof_damping[v].copy(), m.dof_frictionloss[v].copy()
    if loaded:  # budgets come each step
        m.dof_frictionloss[v] = np.maximum(coulomb, LEAST_FRICTION)
    m.dof_solref[v], m.dof_solimp[v, :2] = (2.0 * h, 1.0), 0.9999  # joints that stick hardly creep
    loops = np.isin(m.eq_type, [getattr(mujoco.mjtEq, f"mjEQ_{kind}") for kind in ("CONNECT", "WELD", "TENDON")])
    m.eq_solref[loops], m.eq_solimp[loops, :2] = (2.0 * h, 1.0), 0.9999  # and loops hardly open
    driven = [servos.get(name) if name not in laws else None for name in model.joint_names]
    chain, drives = ServoChain(driven, h, model.supply), np.array([model.joint_rows[name] for name in laws], int)
    return Machine(m, mujoco.MjData(m), chain, q, v, motor, rotor, gears, drives, np.zeros(len(v)), rigid.copy(),
                   viscous, coulomb, loaded, free[:, None] + np.arange(7), thrown)  # fmt: skip


def _with_rotors(text: str, servos: dict[str, Servo]) -> str:
    """Add rotors, and gearboxes between them and the joints, to the robot's MJCF."""
    if not servos:
        return text
    bodies, tendons, (mass, inertia) = list[str](), list[str](), LIGHT
    for name, servo in servos.items():
        gear, rotor = servo.gearbox, PREFIX + name
        reflected, damping = gear.reflected_inertia, gear.reflected_damping
        hinge = {"name": rotor, "axis": "0 0 1", "armature": reflected - inertia, "damping": damping}
        inertial = {"pos": "0 0 0", "mass": mass, "diaginertia": [inertia] * 3}
        bodies += element("body", {"name": rotor}, [*element("inertial", inertial), *element("joint", hinge)])
        # Gears with backlash have a tendon without stiffness.
        spring = {"stiffness": gear.stiffness, "damping": gear.damping} if gear.backlash <= 0.0 else {}
        driving, driven = ({"joint": end, "coef": coef} for end, coef in ((rotor, "1"), (name, "-1")))
        ends = [*element("joint", driving), *element("joint", driven)]
        tendons += element("fixed", {**spring, "springlength": "0"}, ends)
    text = text.replace("</worldbody>", "\n".join([*bodies, "</worldbody>"]))
    return text.replace("</mujoco>", "\n".join(["<tendon>", *tendons, "</tendon>", "</mujoco>"]))


def _actuate(spec: Any, name: str, law: Controller) -> None:
    """Add the position actuator of a joint: a torque Kp (reference - angle) - Kd speed, within its limit."""
    mujoco, most = _mujoco(), law.torque_limit
    limit = {"forcerange": [-most, most]} if most < math.inf else {}
    spec.add_actuator(
        name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT, biastype=mujoco.mjtBias.mjBIAS_AFFINE,
        gainprm=[law.Kp] + [0.0] * 9, biasprm=[0.0, -law.Kp, -law.Kd] + [0.0] * 7, **limit,
    )  # fmt: skip


def _lay(spec: Any, scene: CompiledScene, floor: Floor, h: float) -> None:
    """Add the floor to the specification, where the scene's plane is, and the geoms that touch it to the links."""
    one_of("floor: soles", floor.soles, SOLES)
    time_constant = real("floor: time_constant", floor.time_constant, 2.0 * h, 1.0, "MuJoCo asks for two steps or more")
    friction = real("floor: friction", floor.friction, 0.0, 100.0, "1 is rubber")
    model, ground = scene.model, scene.ground or Ground()
    if not model.contacts or model.base != "floating":
        raise ValueError(f"{model.name}: a floor is for a floating robot with contact points")
    other = {"steps": ground.steps, "velocity": ground.moves, "field": ground.field is not None}
    found = [name for name, value in other.items() if value]
    if found:
        raise ValueError(f"ground: it has {found[0]}; MuJoCo's floor is a plane here: leave it out to compare")
    normal, first, second = plane_axes(ground)
    types, quat = _mujoco().mjtGeom, np.zeros(4)
    _mujoco().mju_mat2Quat(quat, np.stack([first, second, normal], axis=1).ravel())
    spec.worldbody.add_geom(
        type=types.mjGEOM_PLANE, size=[0, 0, 1], friction=[friction, 0.005, 1e-4], solref=[time_constant, 1.0],
        priority=1, contype=0, conaffinity=1, pos=[0.0, 0.0, ground.height], quat=quat,
    )  # fmt: skip
    touching = {"contype": 1, "conaffinity": 0, "mass": 0.0, "solref": [time_constant, 1.0]}
    if floor.soles == "spheres":
        for point in model.contacts:
            if point.circle_radius:
                raise ValueError(f"contact point on link {point.link!r}: MuJoCo has no circles; give points")
            shape = {"type": types.mjGEOM_SPHERE, "size": [point.radius or RADIUS, 0.0, 0.0], "pos": point.position}
            _body(spec, point).add_geom(**shape, **touching, **_own_friction(point))
        return
    links = {link.name: link for link in model.links}
    for name, points in _of_links(model).items():
        (size, pos, quat), own = _box(links[name], points), _own_friction(points[0])
        _body(spec, points[0]).add_geom(type=types.mjGEOM_BOX, size=size, pos=pos, quat=quat, **touching, **own)


def _own_friction(point: ContactPoint) -> dict[str, Any]:
    """Return what gives a geom a friction of its own in place of the floor's."""
    return {} if point.friction is None else {"friction": [point.friction, 0.005, 1e-4], "priority": 2}


def soles_of(model: Model) -> tuple[Soles, ...]:
    """Return the possible kinds of soles: boxes only if the contact points of each link lie in a plane."""
    return SOLES if all(_plane(points) is not None for points in _of_links(model).values()) else ("spheres",)


def _of_links(model: Model) -> dict[str, list[ContactPoint]]:
    """Return the contact points by link."""
    links = dict.fromkeys(point.link for point in model.contacts)
    return {link: [point for point in model.contacts if point.link == link] for link in links}


def _body(spec: Any, point: ContactPoint) -> Any:
    body = spec.body(point.link)
    if body is None:
        raise ValueError(f"contact point on link {point.link!r}: it is a link without mass; put the point elsewhere")
    return body


def _plane(points: Sequence[ContactPoint]) -> np.ndarray | None:
    """Return the normal (3,) of the plane of three or more like contact points; None if there is none."""
    kinds = {(point.radius, point.friction) for point in points}
    if len(points) < 3 or len(kinds) > 1 or any(point.circle_radius for point in points):
        return None
    off = np.array([point.position for point in points])
    off = off - off.mean(axis=0)
    _, spans, axes = np.linalg.svd(off)
    return axes[2] if np.abs(off @ axes[2]).max() <= FLAT < spans[1] else None


def _box(link: Link, contacts: Sequence[ContactPoint]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return half sizes (3,) and center (3,) [m] and orientation (4,) of a box with contact points on its underside.

    Its other sides are along the link's axes, as far as the underside allows.
    """
    normal = _plane(contacts)
    if normal is None:
        found = f"its {len(contacts)} contact points differ, or span no plane"
        raise ValueError(f"link {link.name!r}: {found}; use soles of spheres")
    points = np.array([point.position for point in contacts])
    above = normal @ (np.array(link.center_of_mass) - points.mean(axis=0))
    normal = normal if above >= 0.0 else -normal
    ahead = np.eye(3)[int(np.argmin(np.abs(normal)))]  # the axis most nearly in the plane
    ahead = ahead - normal * (normal @ ahead)
    ahead /= np.linalg.norm(ahead)
    axes = np.stack([ahead, np.cross(normal, ahead), normal], axis=1)
    local = points @ axes
    low, high = local.min(axis=0), local.max(axis=0)
    low[2] -= contacts[0].radius
    high[2] = low[2] + THICKNESS
    quat = np.zeros(4)
    _mujoco().mju_mat2Quat(quat, axes.ravel())
    return 0.5 * (high - low), axes @ (0.5 * (low + high)), quat
