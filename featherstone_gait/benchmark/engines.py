"""Build robots for MuJoCo and Pinocchio, and run MuJoCo without the overhead of its Python package."""

from __future__ import annotations

import ctypes
import math
import statistics
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from ..base.rotation import rotation_from_rpy
from ..model import Ground, Model
from ..robot_file import save_robot
from ..scene.compile import CompiledScene
from .case import Case, Truth, at_most, distances
from .table import installed

PEER_STEP = 2e-3  # MuJoCo's default [s]
STIFFNESS = 400.0  # of drifted loops in Pinocchio [1/s^2]
LONGEST = 10.0  # of a case that MuJoCo runs [s]


def integrators(*names: str) -> list[tuple[str, Any]]:
    """Return MuJoCo's integrators of these names; older versions lack some."""
    kinds = ((name, getattr(mujoco.mjtIntegrator, f"mjINT_{name.upper()}", None)) for name in names)
    return [(name, kind) for name, kind in kinds if kind is not None]


class Lazy:
    """An optional package, imported when something of it is first used."""

    def __init__(self, module: str) -> None:
        self._module = module

    def __getattr__(self, name: str) -> Any:
        found = self.__dict__[name] = getattr(import_module(self._module), name)
        return found


mujoco, rollout, pin = Lazy("mujoco"), Lazy("mujoco.rollout"), Lazy("pinocchio")


@contextmanager
def quick_mujoco() -> Iterator[None]:
    """Switch off the clock by which MuJoCo's Python package times every step, and its warnings on the screen."""
    library = next(Path(mujoco.__file__).parent.glob("libmujoco*"), None)
    clock = ctypes.c_void_p.in_dll(ctypes.CDLL(str(library)), "mjcb_time") if library else ctypes.c_void_p()
    before, clock.value = clock.value, None
    mujoco.set_mju_user_warning(lambda text: None)
    try:
        yield
    finally:
        clock.value = before
        mujoco.set_mju_user_warning(None)


def reread(model: Model, name: str, read: Callable[[str], Any], ground: Ground | None = None) -> Any:
    """Write the robot into a file of that name, and read it."""
    with tempfile.TemporaryDirectory() as folder:
        save_robot(model, Path(folder) / name, ground)
        return read(str(Path(folder) / name))


def spec_of(model: Model) -> Any:
    """Read the robot's URDF as a MuJoCo specification, its root kept as a body, free if it floats."""
    spec = reread(model, f"{model.name}.urdf", mujoco.MjSpec.from_file)
    spec.compiler.fusestatic = False
    if model.base == "floating":
        spec.worldbody.first_body().add_freejoint()
    return spec


def check_order(m: Any, model: Model) -> Any:
    """Return MuJoCo's robot; raise RuntimeError if its mass or its order of joints differs."""
    order = tuple(m.joint(k).name for k in range(m.njnt))[-len(model.joint_names) :]
    if not np.isclose(m.body_mass.sum(), model.mass) or order != model.joint_names:
        raise RuntimeError(f"{model.name}: MuJoCo has another mass or order of joints; the comparison would be void")
    return m


def disable(m: Any, *flags: str) -> Any:
    """Disable parts of MuJoCo's dynamics, such as CONTACT or DAMPER; return the robot."""
    for flag in flags:
        m.opt.disableflags |= getattr(mujoco.mjtDisableBit, f"mjDSBL_{flag}")
    return m


def rolled(m: Any, d: Any, steps: int, samples: int, control: np.ndarray | None = None) -> tuple[np.ndarray, float]:
    """Return positions (samples + 1, nq) every so many steps, each sample under a row of control, and CPU time [s]."""
    path, seconds = [d.qpos.copy()], 0.0
    for k in range(samples):
        if control is not None:
            d.ctrl[:] = control[k]
        start = time.thread_time()
        mujoco.mj_step(m, d, steps)
        seconds += time.thread_time() - start
        path.append(d.qpos.copy())
    return np.array(path), seconds


def humanoid_of(model: Model) -> Any:
    """Build the humanoid of `humanoid_spec` for MuJoCo."""
    return humanoid_spec(model).compile()


def humanoid_spec(model: Model) -> Any:
    """Describe the humanoid for MuJoCo, with a floor, position servos, and spheres as contacts, which alone collide."""
    free: dict[str, Any] = {"type": "fixed", "lower": -math.inf, "upper": math.inf}
    joints = tuple(replace(j, **free) if j.name in model.locked else j for j in model.joints)
    moving = {name: model.servos[name] for name in model.joint_names}
    model = replace(model, joints=joints, locked={}, servos=moving, shapes=())
    spec = spec_of(model)
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], friction=[0.95, 0.005, 1e-4])
    for point in model.contacts:
        x, y, z = point.position
        geom = {"size": [1e-3, 0, 0], "pos": [x, y, z + 1e-3], "friction": [0.95, 0.005, 1e-4], "mass": 0.0}
        spec.body(point.link).add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, contype=0, conaffinity=1, **geom)
    for joint in model.moving_joints:
        servo = model.servos[joint.name]
        torque = servo.gearbox.ratio * servo.motor_constant
        kp = 1.0 / (1.0 / servo.gearbox.stiffness + servo.resistance / (torque * servo.controller.Kp))
        kv = torque**2 / servo.resistance + servo.viscous_friction + servo.gearbox.reflected_damping
        spec.joint(joint.name).armature = servo.gearbox.reflected_inertia
        actuator = spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        actuator.set_to_position(kp=kp, kv=kv)
        limit = torque * servo.current_limit
        actuator.forcelimited, actuator.forcerange = True, [-limit, limit]
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    return spec


def standing_on(m: Any, d: Any, angles: np.ndarray) -> np.ndarray:
    """Return the full physics state of the robot standing at these angles, its lowest sphere on the floor."""
    mujoco.mj_resetData(m, d)
    d.qpos[7:] = angles
    d.qpos[2] = 1.0
    mujoco.mj_forward(m, d)
    spheres = m.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE
    d.qpos[2] -= d.geom_xpos[spheres, 2].min() - 1e-3
    mujoco.mj_forward(m, d)
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = np.zeros(mujoco.mj_stateSize(m, kind))
    mujoco.mj_getState(m, d, state, kind)
    return state


# ---------------------------------------------------------------------------------------------- Pinocchio


def bounded(model: Model) -> Model:
    """Give joints without limits wide ones: Pinocchio describes unlimited ones by sine and cosine, which is slower."""
    wide: dict[str, Any] = {"lower": -1e3, "upper": 1e3, "effort": 1e3, "velocity": 1e3}
    kinds: dict[str, Any] = {"continuous": "revolute", "prismatic": "prismatic"}
    joints = (
        replace(j, type=kinds[j.type], **wide) if j.type in kinds and j.lower == -math.inf else j for j in model.joints
    )
    return replace(model, joints=tuple(joints))


def in_pinocchio(model: Model) -> Any:
    base = (pin.JointModelFreeFlyer(),) if model.base == "floating" else ()
    m = reread(model, "robot.urdf", lambda path: pin.buildModelFromUrdf(path, *base))
    if m.nv != model.nv:
        raise RuntimeError(f"{model.name}: Pinocchio reads another robot from its URDF; the comparison would be void")
    return m


def loops_in_pinocchio(m: Any, model: Model) -> Any:
    """Return loops `connect` and `hinge` as rigid constraints of Pinocchio; a hinge holds two points of its axis."""
    found = pin.StdVec_RigidConstraintModel()
    baumgarte = pin.BaumgarteCorrectorParameters(STIFFNESS, 2.0 * math.sqrt(STIFFNESS))
    for loop in model.loops:
        turns = rotation_from_rpy(loop.rpy_a), rotation_from_rpy(loop.rpy_b)
        for k in range(2 if loop.kind == "hinge" else 1):
            ends = []
            for link, point, turn in zip((loop.a, loop.b), (loop.point_a, loop.point_b), turns):
                at = pin.SE3(np.eye(3), np.add(point, turn @ np.multiply(k, loop.axis)))
                frame = m.frames[m.getFrameId(link, pin.BODY) if link else 0]
                ends += [frame.parentJoint, frame.placement * at]
            held = pin.RigidConstraintModel(pin.ContactType.CONTACT_3D, m, *ends)
            held.setBaumgarteCorrectorParameters(baumgarte)
            found.append(held)
    return found


# ---------------------------------------------------------------------------------------------- cases of `default`


def peer_run(case: Case, exact: Truth) -> tuple[float, float]:
    """Return MuJoCo's position error [rad or m], NaN where laws differ, and CPU time per simulated second [ms].

    Both are NaN without MuJoCo, and for servos and springs, which it has not.
    """
    scene = case.scene
    if not installed("mujoco") or scene.gearbox or scene.springs or case.duration > LONGEST:
        return math.nan, math.nan
    try:
        m = model_of(scene)
    except ValueError:
        return math.nan, math.nan
    with quick_mujoco(), at_most(30.0):
        runs = [_rolled(m, case) for _ in range(3)]
    error = float(distances(scene, runs[0][0], exact.q)[: exact.known].max()) if same_laws(scene) else math.nan
    return error, statistics.median(seconds for _, seconds in runs) * 1e3 / case.duration


def same_laws(scene: CompiledScene) -> bool:
    """Return whether the scene has nothing that MuJoCo models differently: ground, stops, dry friction, couplings."""
    parts = scene.constants
    rubs = any(joint.friction > 0 for joint in scene.model.moving_joints)
    return parts.contact is None and parts.stops is None and parts.coupling is None and not rubs


def model_of(scene: CompiledScene) -> Any:
    """Build the scene's robot for MuJoCo; raise ValueError where MJCF cannot express it."""
    m = reread(scene.model, "robot.xml", mujoco.MjModel.from_xml_path, scene.ground)
    m.opt.gravity[:] = scene.gravity
    if scene.ground is None:
        disable(m, "CONTACT")
    return m


def _rolled(m: Any, case: Case) -> tuple[np.ndarray, float]:
    """Return positions (samples, nq) in this package's order of joints, and the CPU time [s]."""
    d, base, (q, qd) = mujoco.MjData(m), case.scene.tree.floating, case.coordinates
    balls_of = {f"{ball}.{axis}": ball for ball in case.model.ball_names for axis in ("rx", "ry", "rz")}
    joints = [m.joint(name) for name in dict.fromkeys(balls_of.get(name, name) for name in case.model.joint_names)]
    balls = [joint.type[0] == mujoco.mjtJoint.mjJNT_BALL for joint in joints]
    at_q = [*range(7 * base), *_places((joint.qposadr[0] for joint in joints), balls, 4)]
    d.qpos[at_q], d.qvel[[*range(6 * base), *_places((joint.dofadr[0] for joint in joints), balls, 3)]] = q, qd
    path, seconds = rolled(m, d, round(case.every / PEER_STEP), round(case.duration / case.every))
    return path[:, at_q], seconds


def _places(first: Iterable[int], balls: Iterable[bool], width: int) -> Iterator[int]:
    """Yield the indices of the numbers of joints, of a ball joint `width` and of another one 1."""
    for at, ball in zip(first, balls):
        yield from range(at, at + (width if ball else 1))
