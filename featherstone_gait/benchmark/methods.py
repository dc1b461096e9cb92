"""Solve a `Case` in every engine: this package, MuJoCo, Pinocchio with SciPy, Bullet and Drake.

Each engine gets the same bodies from one URDF or MJCF file, and the best that it has for loops, springs and servos:

MuJoCo      all steps in one call of `mj_step`, without contact and limits.  Loops are equality constraints as hard as
            it lets them be (`solimp` 0.9999, `solref` of two steps), springs are spatial tendons, a servo is a position
            actuator (clamped torque), or the same with the damping at the joint (not clamped).
Pinocchio   `aba`, and `constraintDynamics` with Baumgarte's correction where loops are closed, integrated by SciPy, as
            it has no integrator of its own.  Springs and servos are written here, in NumPy.
Bullet      reduced coordinates.  Loops are point-to-point constraints, servos are torques set before each step.  It
            has no springs between points and no rotors.
Drake       a continuous plant under its integrators with error control, where there are no loops; else, and besides,
            its discrete plant with the SAP solver, the only one that has loops.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache, partial
from importlib.metadata import PackageNotFoundError, version
from typing import Any, NamedTuple

import numpy as np

from ..core.integrate import INTEGRATORS
from ..model import Model
from ..run.trajectory import positions
from .case import Case, solution
from .engines import (
    Lazy,
    bounded,
    disable,
    in_pinocchio,
    integrators,
    loops_in_pinocchio,
    mujoco,
    pin,
    reread,
    rolled,
)  # fmt: skip
from .scenes import STIFF_SERVO
from .table import installed

bullet = Lazy("pybullet")
plants, analysis, trees, parsing = (
    Lazy(f"pydrake.{name}") for name in ("multibody.plant", "systems.analysis", "multibody.tree", "multibody.parsing")
)
# Modules, and packages that have them.
ENGINES = {"ours": "", "MuJoCo": "mujoco", "Pinocchio": "pinocchio", "Bullet": "pybullet", "Drake": "pydrake"}
WHEELS = {"MuJoCo": "mujoco", "Pinocchio": "pin", "Bullet": "pybullet", "Drake": "drake"}

KP, KD, LIMIT = (STIFF_SERVO[name] for name in ("Kp", "Kd", "torque_limit"))
ARMATURE = 254.0**2 * 1e-7  # reflected inertia of an AX-12's rotor [kg m^2]
HARDEST = 0.9999  # of the impedances that MuJoCo takes
SWEEPS = 50  # iterations of Bullet
LOOSEST = 1e-2  # tolerance of Drake's integrators
STEPS = (0.05, 0.02, 1e-2, 5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4, 5e-5, 2e-5, 1e-5)  # [s]
TOLERANCES = tuple(10.0**-k for k in range(3, 13))
WRONG = 1e-2  # error beyond which a row says whether the engine did [rad]
Vector = np.ndarray


class Result(NamedTuple):
    """Hold what a run came to."""

    error: float
    seconds: float  # of the processor [s]
    note: str = ""


Once = Callable[[], Result]


class Method(NamedTuple):
    """Describe an engine with one of its methods and the settings to try."""

    engine: str
    name: str
    settings: Sequence[float]  # steps [s] or tolerances, the coarsest first
    ready: Callable[[float], Once]


Solver = Callable[[], tuple[Vector, float]]  # returns the joint angles at the end, and the CPU time [s]


def release(engine: str) -> str:
    """Return the version of an engine, empty where it is not installed."""
    try:
        return version(WHEELS.get(engine, "featherstone_gait")) if ENGINES[engine] else version("featherstone_gait")
    except PackageNotFoundError:
        return ""


def methods(case: Case, own: Sequence[str]) -> Iterator[Method]:
    """Yield the methods of all engines that are installed and can state the case; own: integrators of this package."""
    exact = solution(case)[0][-1]
    for name in own:
        tried = [value for integrator, value in case.settings if integrator == name]
        yield Method("ours", name, sorted(tried, reverse=True), partial(_ours, case, exact, name))
    makers = {"MuJoCo": in_mujoco, "Pinocchio": in_scipy, "Bullet": in_bullet, "Drake": in_drake}
    for engine, make in makers.items():
        if installed(ENGINES[engine]) and not cannot(engine, case):
            for name, settings, solve in make(case):
                yield Method(engine, name, settings, partial(_theirs, exact, solve))


def cannot(engine: str, case: Case) -> str:
    """Say what an engine lacks for a case."""
    if engine == "Bullet" and case.scene.springs:
        return "no spring between two points"
    if engine == "Bullet" and case.scene.gearbox == "rotor":
        return "no rotor inertia"
    return ""


def _ours(case: Case, exact: Vector, name: str, setting: float) -> Once:
    run = case.ready(name, setting)

    @cache
    def said() -> str:
        """Return the status of `simulate`, which estimates the error."""
        rtol = setting if INTEGRATORS[name].adaptive else None
        return str(case.run(run.scene, **({} if rtol is None else {"rtol": rtol})).status)

    def once() -> Result:
        seconds = 1e-3 * run.once() * case.duration
        error = float(np.abs(positions(run.trajectory)[-1] - exact).max())
        error = error if math.isfinite(error) and run.trajectory.ok else math.inf
        return Result(error, seconds, "" if error < WRONG else f"wrong, {'silent' if said() == 'ok' else said()}")

    return once


def _theirs(exact: Vector, solve: Callable[[float], Solver], setting: float) -> Once:
    """Prepare a run; an engine that fails has an infinite error."""
    solver = solve(setting)

    def once() -> Result:
        try:
            q, seconds = solver()
        except ArithmeticError as failure:
            return Result(math.inf, math.nan, f"failed: {failure}")
        error = float(np.abs(q - exact).max())
        if not math.isfinite(error):
            return Result(math.inf, seconds, "diverged")
        return Result(error, seconds, "" if error < WRONG else "wrong, silent")

    return once


def _steps(case: Case) -> list[float]:
    """List steps from 50 ms on, or from a hundredth of the run, of servo arms a tenth [s]."""
    coarsest = min(0.05, case.duration * (0.01 if case.reference is None else 0.1))
    return [h for h in STEPS if h <= 1.01 * coarsest]


# ---------------------------------------------------------------------------------------------- MuJoCo


def in_mujoco(case: Case) -> Iterator[tuple[str, Sequence[float], Callable[[float], Solver]]]:
    """Yield MuJoCo's integrators, with each way to express the servo."""
    for servo in ("",) if case.reference is None else ("position", "joint damping"):
        m = _mujoco_robot(case, servo)
        for name, kind in integrators("Euler", "implicitfast", "RK4", "discrete"):
            if servo != "joint damping" or name == "Euler":
                yield f"{name}{', ' * bool(servo)}{servo}", _steps(case), partial(_mujoco_solver, m, kind, case)


def _mujoco_robot(case: Case, servo: str) -> Any:
    """Build the robot with a servo at each joint; "joint damping" clamps the spring alone."""
    model = replace(case.model, servos={})
    spec = reread(model, "robot.xml", mujoco.MjSpec.from_file)
    for name in model.joint_names if servo else ():
        joint = spec.joint(name)
        joint.armature = ARMATURE if case.scene.gearbox == "rotor" else 0.0
        actuator = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        if servo == "position":
            actuator.set_to_position(kp=KP, kv=KD)
        else:
            joint.damping[0] = KD
            actuator.set_to_position(kp=KP)
        actuator.forcelimited, actuator.forcerange = True, [-LIMIT, LIMIT]
    for k, spring in enumerate(case.scene.springs):
        tendon = spec.add_tendon(name=f"spring{k}", springlength=[spring.length] * 2)
        tendon.stiffness[0], tendon.damping[0] = spring.stiffness, spring.damping
        for end, link, point in (("a", spring.a, spring.point_a), ("b", spring.b, spring.point_b)):
            spec.body(link).add_site(name=f"{end}{k}", pos=point)
            tendon.wrap_site(f"{end}{k}")
    m = spec.compile()
    m.opt.gravity[:] = case.scene.gravity
    m.eq_solimp[:, :2] = HARDEST
    return disable(m, "CONTACT", *(() if model.loops else ("CONSTRAINT",)))


def _mujoco_solver(m: Any, integrator: Any, case: Case, h: float) -> Solver:
    d, (q, qd), steps = mujoco.MjData(m), case.coordinates, max(1, round(case.duration / h))
    joints = [m.joint(name) for name in case.model.joint_names]
    at_q, at_v = ([getattr(joint, name)[0] for joint in joints] for name in ("qposadr", "dofadr"))

    def solve() -> tuple[Vector, float]:
        mujoco.mj_resetData(m, d)
        m.opt.integrator, m.opt.timestep = integrator, case.duration / steps
        d.qpos[at_q], d.qvel[at_v] = q, qd
        d.qfrc_applied[at_v] = 0.0 if case.tau is None else case.tau
        m.eq_solref[:, 0] = 2.0 * m.opt.timestep  # the least that its manual allows
        path, spent = rolled(m, d, steps, 1)
        if d.warning.number.any():
            raise ArithmeticError("it warns that the state diverges")
        return path[-1, at_q], spent

    return solve


# ---------------------------------------------------------------------------------------------- Pinocchio


def in_scipy(case: Case) -> Iterator[tuple[str, Sequence[float], Callable[[float], Solver]]]:
    """Yield SciPy's solvers, which call Pinocchio."""
    stiff = case.scene.gearbox == "standard" or any(spring.damping for spring in case.scene.springs)
    names: tuple[str, ...] = ("Radau", "LSODA") if stiff else ("DOP853", "LSODA")
    names = ("DOP853",) if case.model.loops else names  # an implicit solver's differences take minutes there
    rates, places = _rates(case)
    for name in names:
        yield f"SciPy {name}", TOLERANCES[: 8 if name == "Radau" else None], partial(_scipy, case, rates, places, name)


def _rates(case: Case) -> tuple[Callable[[float, Vector], Vector], list[int]]:
    """Return the derivative of positions and velocities, and the places of our joints among them."""
    model = bounded(replace(case.model, servos={}))
    m = in_pinocchio(replace(model, loops=()))
    n, places = m.nv, [m.joints[m.getJointId(name)].idx_q for name in model.joint_names]
    if case.scene.gearbox == "rotor":
        m.armature[:] = ARMATURE
    m.gravity.linear = np.array(case.scene.gravity)
    pulls = _springs(m, case)
    loops, driven = loops_in_pinocchio(m, model), case.reference is not None
    d, constant = m.createData(), np.zeros(n)
    constant[places] = 0.0 if case.tau is None else case.tau
    if loops:
        held = pin.StdVec_RigidConstraintData()
        held.extend([loop.createData() for loop in loops])
        pin.initConstraintDynamics(m, d, loops, held)
        proximal = pin.ProximalSettings(1e-12, 1e-8, 10)  # of rows that depend on each other

    def rates(t: float, y: Vector) -> Vector:
        q, v = y[:n], y[n:]
        tau = np.clip(-KP * q - KD * v, -LIMIT, LIMIT) if driven else constant
        tau = tau + pulls(d, q, v) if case.scene.springs else tau
        if loops:
            return np.concatenate([v, pin.constraintDynamics(m, d, q, v, tau, loops, held, proximal)])
        return np.concatenate([v, pin.aba(m, d, q, v, tau)])

    return rates, places


def _springs(m: Any, case: Case) -> Callable[[Any, Vector, Vector], Vector]:
    """Add a frame at each end of each spring; return a function that gives the joint forces of all."""
    ends = []
    for k, spring in enumerate(case.scene.springs):
        for end, link, point in (("a", spring.a, spring.point_a), ("b", spring.b, spring.point_b)):
            frame = m.frames[m.getFrameId(link, pin.BODY)]
            place = frame.placement * pin.SE3(np.eye(3), np.array(point))
            ends.append(m.addFrame(pin.Frame(f"{end}{k}", frame.parentJoint, 0, place, pin.OP_FRAME)))

    def forces(d: Any, q: Vector, v: Vector) -> Vector:
        pin.computeJointJacobians(m, d, q)
        pin.updateFramePlacements(m, d)
        total = np.zeros(m.nv)
        for spring, a, b in zip(case.scene.springs, ends[::2], ends[1::2]):
            line = d.oMf[b].translation - d.oMf[a].translation
            length = math.sqrt(line @ line)
            to_b, to_a = (pin.getFrameJacobian(m, d, end, pin.LOCAL_WORLD_ALIGNED)[:3] for end in (b, a))
            longer = (line / length) @ (to_b - to_a)
            total -= longer * (spring.stiffness * (length - spring.length) + spring.damping * (longer @ v))
        return total

    return forces


def _scipy(case: Case, rates: Callable, places: list[int], method: str, rtol: float) -> Solver:
    from scipy.integrate import solve_ivp

    (q, qd), n = case.coordinates, case.model.nv
    start = np.zeros(2 * n)
    start[places], start[np.add(places, n)] = q, qd

    def solve() -> tuple[Vector, float]:
        begin = time.thread_time()
        answer = solve_ivp(rates, (0.0, case.duration), start, method, rtol=rtol, atol=rtol)
        spent = time.thread_time() - begin
        if not answer.success:
            raise ArithmeticError(answer.message)
        return answer.y[places, -1], spent

    return solve


# ---------------------------------------------------------------------------------------------- Bullet


@cache
def world() -> Any:
    """Return Bullet, with one world."""
    bullet.connect(bullet.DIRECT)
    return bullet


def in_bullet(case: Case) -> Iterator[tuple[str, Sequence[float], Callable[[float], Solver]]]:
    """Yield Bullet's one integrator; more iterations change nothing, with loops neither."""
    yield "semi-implicit Euler", _steps(case), partial(_bullet_solver, case)


def _bullet_solver(case: Case, h: float) -> Solver:
    model, steps = bounded(replace(case.model, servos={}, loops=())), round(case.duration / h)
    q, qd = case.coordinates
    root = replace(model.links[0], mass=1.0, inertia=(1.0, 0.0, 0.0, 1.0, 0.0, 1.0))  # it warns of a fixed one without
    rooted = replace(model, links=(root, *model.links[1:]))

    def solve() -> tuple[Vector, float]:
        w = world()
        w.resetSimulation()
        w.setGravity(*case.scene.gravity)
        w.setPhysicsEngineParameter(fixedTimeStep=h, numSubSteps=0, numSolverIterations=SWEEPS)
        keep = bullet.URDF_USE_INERTIA_FROM_FILE | bullet.URDF_MAINTAIN_LINK_ORDER
        robot = reread(rooted, "robot.urdf", lambda path: w.loadURDF(path, useFixedBase=True, flags=keep))
        numbers = {w.getJointInfo(robot, k)[1].decode(): k for k in range(w.getNumJoints(robot))}
        joints = [numbers[name] for name in model.joint_names]
        free: dict[str, float] = {"linearDamping": 0.0, "angularDamping": 0.0, "jointDamping": 0.0}
        for k in range(-1, w.getNumJoints(robot)):
            w.changeDynamics(robot, k, **free, maxJointVelocity=1e6)
        for joint, angle, speed in zip(joints, q.tolist(), qd.tolist()):
            w.resetJointState(robot, joint, angle, speed)
        w.setJointMotorControlArray(robot, joints, bullet.VELOCITY_CONTROL, forces=[0.0] * len(joints))
        _close_in_bullet(w, robot, case.model)
        begin = time.thread_time()
        for _ in range(steps):
            if case.reference is not None:
                states = np.array([state[:2] for state in w.getJointStates(robot, joints)])
                torques = np.clip(-KP * states[:, 0] - KD * states[:, 1], -LIMIT, LIMIT)
                w.setJointMotorControlArray(robot, joints, bullet.TORQUE_CONTROL, forces=torques.tolist())
            w.stepSimulation()
        spent = time.thread_time() - begin
        return np.array([state[0] for state in w.getJointStates(robot, joints)]), spent

    return solve


def _close_in_bullet(w: Any, robot: int, model: Model) -> None:
    """Hold loops closed by points, two of a hinge; Bullet counts points from centers of mass."""
    links = {w.getJointInfo(robot, k)[12].decode(): k for k in range(w.getNumJoints(robot))}
    centers = {link.name: np.array(link.center_of_mass) for link in model.links}
    for loop in model.loops:
        for k in range(2 if loop.kind == "hinge" else 1):
            ends, along = ((loop.a, loop.point_a), (loop.b, loop.point_b)), np.multiply(k, loop.axis)
            points = [(np.add(point, along) - centers[str(name)]).tolist() for name, point in ends]
            pair = (robot, links.get(str(loop.a), -1), robot, links.get(str(loop.b), -1))
            held = w.createConstraint(*pair, bullet.JOINT_POINT2POINT, [0.0] * 3, *points)
            w.changeConstraint(held, maxForce=1e9)


# ---------------------------------------------------------------------------------------------- Drake


def in_drake(case: Case) -> Iterator[tuple[str, Sequence[float], Callable[[float], Solver]]]:
    """Yield the integrators of Drake's continuous plant, where it can be, and its discrete plant."""
    if not case.model.loops:
        stiff = case.scene.gearbox == "standard" or any(spring.damping for spring in case.scene.springs)
        for name in ("radau3",) if stiff else ("runge_kutta5", "radau3"):
            tolerances = (LOOSEST, *TOLERANCES[:8])
            yield name, tolerances, partial(_drake_solver, case, name)
    yield "discrete, SAP", _steps(case), partial(_drake_solver, case, "")


def _drake_solver(case: Case, scheme: str, setting: float) -> Solver:
    """Prepare a run; scheme: an integrator with error control, empty for the discrete plant."""
    plant = plants.MultibodyPlant(time_step=0.0 if scheme else setting)
    model = replace(case.model, servos={})
    reread(bounded(replace(model, loops=())), "robot.urdf", lambda path: parsing.Parser(plant).AddModels(path))
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(model.links[0].name))
    plant.mutable_gravity_field().set_gravity_vector(case.scene.gravity)
    for spring in case.scene.springs:
        ends = (plant.GetBodyByName(spring.a), spring.point_a, plant.GetBodyByName(spring.b), spring.point_b)
        plant.AddForceElement(trees.LinearSpringDamper(*ends, spring.length, spring.stiffness, spring.damping))
    for loop in model.loops:
        for k in range(2 if loop.kind == "hinge" else 1):
            along = np.multiply(k, loop.axis)
            a, b = plant.GetBodyByName(loop.a), plant.GetBodyByName(loop.b)
            plant.AddBallConstraint(a, np.add(loop.point_a, along), b, np.add(loop.point_b, along))
    driven = case.reference is not None
    for name in model.joint_names if driven else ():
        actuator = plant.AddJointActuator(name, plant.GetJointByName(name), LIMIT)
        actuator.set_controller_gains(trees.PdControllerGains(p=KP, d=KD))
        if case.scene.gearbox == "rotor":
            actuator.set_default_rotor_inertia(ARMATURE)
            actuator.set_default_gear_ratio(1.0)
    plant.Finalize()
    simulator = analysis.Simulator(plant)
    context = simulator.get_mutable_context()
    joints = [plant.GetJointByName(name) for name in model.joint_names]
    at = [joint.position_start() for joint in joints]
    (q, qd), n = case.coordinates, plant.num_positions()
    start, torques = np.zeros(2 * n), np.zeros(n)
    start[at], start[np.add(at, n)] = q, qd
    if driven:
        plant.get_desired_state_input_port(joints[0].model_instance()).FixValue(context, np.zeros(2 * n))
    if case.tau is not None:
        torques[at] = case.tau
        plant.get_applied_generalized_force_input_port().FixValue(context, torques)
    if scheme:
        analysis.ResetIntegratorFromFlags(simulator, scheme, 0.1)
        simulator.get_mutable_integrator().set_target_accuracy(setting)

    def solve() -> tuple[Vector, float]:
        context.SetTime(0.0)
        plant.SetPositionsAndVelocities(context, start)
        try:
            simulator.Initialize()
            begin = time.thread_time()
            simulator.AdvanceTo(case.duration)
        except RuntimeError as failure:
            raise ArithmeticError(str(failure).splitlines()[0][:60]) from failure
        spent = time.thread_time() - begin
        return plant.GetPositions(context)[at], spent

    return solve
