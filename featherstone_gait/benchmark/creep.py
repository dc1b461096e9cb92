"""Let friction hold a box on a slope, and a joint under its load, for ten minutes in every engine that has friction.

Neither may move, so that the error is how far it has moved since the first second.

box     1 kg on a slope of 15 degrees with a friction coefficient of 0.5, which is half used.  Pinocchio has no contact
        of its own.
joint   A link of 1 kg, its center 0.1 m beside a level axis, whose dry friction of 2 N m is half used.  Drake has
        viscous friction of joints alone, Pinocchio none in its algorithms.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np

from ..core.integrate import INTEGRATORS
from ..model import Ground, Joint, Link, Model
from ..run.simulate import initial_state, simulate
from ..run.trajectory import positions
from ..scene.compile import IntegratorName, compile_scene
from .engines import Lazy, mujoco
from .methods import ENGINES, Method, Once, Result, bullet, plants, world
from .scenes import NO_FALL, box
from .table import installed

analysis, framework = Lazy("pydrake.systems.analysis"), Lazy("pydrake.systems.framework")
shapes, transforms, trees = Lazy("pydrake.geometry"), Lazy("pydrake.math"), Lazy("pydrake.multibody.tree")
DURATION, SETTLED = 600.0, 1.0  # [s]
SLOPE, FRICTION, HOLDING = math.radians(15.0), 0.5, 2.0  # [rad], coefficient, [N m]
G = 9.81  # [m/s^2]
SIZE = (0.4, 0.4, 0.1)  # of the box [m]
STEPS = (1e-2, 2e-3)  # [s]
BESIDE = 0.1  # the link's center, of its axis [m]
DOWN = (-G * math.sin(SLOPE), 0.0, -G * math.cos(SLOPE))  # gravity by the slope [m/s^2]
LACKS = {
    "box": {"Pinocchio": "cannot state it: no contact"},
    "joint": {"Pinocchio": "cannot state it: no dry friction", "Drake": "cannot state it: no dry friction of joints"},
}

Advance = Callable[[float], np.ndarray]  # simulates up to a time [s]; returns what must not move


def methods(what: str) -> Iterator[Method]:
    """Yield all methods of the engines that are installed and have such friction."""
    yield Method("ours", "midpoint", STEPS, partial(_ours, what, "midpoint"))
    yield Method("ours", "ars343", (1e-2,), partial(_ours, what, "ars343"))
    kinds = {"default": "", "impratio 100, noslip 10": 'impratio="100" noslip_iterations="10"'}
    for name, options in kinds.items() if installed(ENGINES["MuJoCo"]) else ():
        yield Method("MuJoCo", f"implicitfast, {name}", STEPS, partial(_mujoco, what, options))
    if installed(ENGINES["Bullet"]):
        yield Method("Bullet", "semi-implicit Euler", STEPS, partial(_bullet, what))
    if installed(ENGINES["Drake"]) and what == "box":
        yield Method("Drake", "discrete, SAP", STEPS, _drake)


def _held(advance: Callable[[], Advance]) -> Result:
    """Return how far a thing moves after the first second [m or rad]."""
    to = advance()
    began = time.process_time()
    first = to(SETTLED)
    moved = float(np.linalg.norm(to(DURATION) - first))
    return Result(moved, time.process_time() - began, "" if moved < 1e-3 else "creeps, silent")


def link() -> Model:
    """Return a link on a level axis, which its friction holds."""
    joint = Joint("hinge", "continuous", "base", "link", axis=(0.0, 1.0, 0.0), friction=HOLDING)
    body = Link("link", 1.0, (BESIDE, 0.0, 0.0), (1e-3, 0.0, 0.0, 1e-3, 0.0, 1e-3))
    return Model("held", (Link("base"), body), (joint,))


def _ours(what: str, integrator: IntegratorName, setting: float) -> Once:
    adaptive = INTEGRATORS[integrator].adaptive
    model, ground = (box(), Ground(friction=FRICTION, slope=SLOPE)) if what == "box" else (link(), None)
    scene = compile_scene(model, None, ground, integrator, None if adaptive else setting, **NO_FALL)
    lying = [0.0, 0.0, 0.5 * SIZE[2] / math.cos(SLOPE), math.cos(0.5 * SLOPE), 0.0, -math.sin(0.5 * SLOPE), 0.0]
    state = initial_state(scene, lying if what == "box" else [0.0])
    record = ("base_q", "q") if what == "box" else ("q",)
    how: dict[str, Any] = {"record": record, "record_interval": SETTLED, "estimate_error": False}
    how |= {"rtol": setting} if adaptive else {}

    def once() -> Result:
        began = time.process_time()
        run = simulate(scene, DURATION, state, **how)
        spent = time.process_time() - began
        place = positions(run)[:, :3]
        moved = float(np.linalg.norm(place[-1] - place[1]))
        return Result(moved if run.ok else math.inf, spent, "" if run.ok else str(run.status))

    return once


def _mujoco(what: str, options: str, h: float) -> Once:
    x, y, z = (0.5 * size for size in SIZE)
    resting = f'<geom type="plane" size="0 0 1" friction="{FRICTION} 0 0"/><body pos="0 0 {z}"><freejoint/>'
    resting += f'<geom type="box" size="{x} {y} {z}" mass="1" friction="{FRICTION} 0 0"/></body>'
    held = f'<body><joint axis="0 1 0" frictionloss="{HOLDING}"/>'
    held += f'<inertial pos="{BESIDE} 0 0" mass="1" diaginertia="1e-3 1e-3 1e-3"/></body>'
    down = " ".join(map(repr, DOWN)) if what == "box" else f"0 0 {-G}"
    option = f'<option integrator="implicitfast" cone="elliptic" timestep="{h}" gravity="{down}" {options}/>'
    text = f"<mujoco>{option}<worldbody>{resting if what == 'box' else held}</worldbody></mujoco>"
    m = mujoco.MjModel.from_xml_string(text)

    def advance() -> Advance:
        d = mujoco.MjData(m)

        def to(end: float) -> np.ndarray:
            mujoco.mj_step(m, d, round((end - d.time) / h))
            return np.array(d.qpos[:3])

        return to

    return partial(_held, advance)


def _bullet(what: str, h: float) -> Once:
    def advance() -> Advance:
        w = world()
        w.resetSimulation()
        w.setGravity(*(DOWN if what == "box" else (0.0, 0.0, -G)))
        w.setPhysicsEngineParameter(fixedTimeStep=h, numSubSteps=0, numSolverIterations=50)
        if what == "box":
            shape = w.createCollisionShape(bullet.GEOM_BOX, halfExtents=[0.5 * size for size in SIZE])
            body = w.createMultiBody(1.0, shape, basePosition=(0.0, 0.0, 0.5 * SIZE[2]))
            floor = w.createMultiBody(0.0, w.createCollisionShape(bullet.GEOM_PLANE, planeNormal=[0, 0, 1]))
            w.changeDynamics(floor, -1, lateralFriction=1.0)  # Bullet takes the product
            w.changeDynamics(body, -1, lateralFriction=FRICTION, linearDamping=0.0, angularDamping=0.0,
                             activationState=bullet.ACTIVATION_STATE_DISABLE_SLEEPING)  # fmt: skip
        else:
            body = w.createMultiBody(
                0.0, linkMasses=[1.0], linkCollisionShapeIndices=[-1], linkVisualShapeIndices=[-1],
                linkPositions=[[0.0] * 3], linkOrientations=[[0.0, 0.0, 0.0, 1.0]], linkParentIndices=[0],
                linkInertialFramePositions=[[BESIDE, 0.0, 0.0]], linkInertialFrameOrientations=[[0.0, 0.0, 0.0, 1.0]],
                linkJointTypes=[bullet.JOINT_REVOLUTE], linkJointAxis=[[0.0, 1.0, 0.0]],
            )  # fmt: skip
            w.changeDynamics(body, 0, localInertiaDiagonal=[1e-3] * 3, linearDamping=0.0, angularDamping=0.0)
            w.setJointMotorControl2(body, 0, bullet.VELOCITY_CONTROL, targetVelocity=0.0, force=HOLDING)

        done = 0

        def to(end: float) -> np.ndarray:
            nonlocal done
            for _ in range(round(end / h) - done):
                w.stepSimulation()
            done = round(end / h)
            place = w.getBasePositionAndOrientation(body)[0] if what == "box" else w.getJointState(body, 0)[:1]
            return np.array(place)

        return to

    return partial(_held, advance)


def _drake(h: float) -> Once:
    builder = framework.DiagramBuilder()
    plant, _ = plants.AddMultibodyPlantSceneGraph(builder, h)
    plant.mutable_gravity_field().set_gravity_vector(DOWN)
    moments = [(SIZE[1] ** 2 + SIZE[2] ** 2) / 12.0, (SIZE[0] ** 2 + SIZE[2] ** 2) / 12.0,
               (SIZE[0] ** 2 + SIZE[1] ** 2) / 12.0]  # fmt: skip
    body = plant.AddRigidBody("box", trees.SpatialInertia(1.0, np.zeros(3), trees.UnitInertia(*moments)))
    rubs, radius = plants.CoulombFriction(FRICTION, FRICTION), 0.01
    for k in range(4):  # a box touches in one point there
        corner = [(k % 2 - 0.5) * SIZE[0], (k // 2 - 0.5) * SIZE[1], radius - 0.5 * SIZE[2]]
        place = transforms.RigidTransform(corner)
        plant.RegisterCollisionGeometry(body, place, shapes.Sphere(radius), f"corner{k}", rubs)
    floor = transforms.RigidTransform()
    plant.RegisterCollisionGeometry(plant.world_body(), floor, shapes.HalfSpace(), "floor", rubs)
    plant.Finalize()
    diagram = builder.Build()

    def advance() -> Advance:
        simulator = analysis.Simulator(diagram)
        context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
        plant.SetFreeBodyPose(context, body, transforms.RigidTransform([0.0, 0.0, 0.5 * SIZE[2]]))
        simulator.Initialize()

        def to(end: float) -> np.ndarray:
            simulator.AdvanceTo(end)
            return np.array(plant.GetPositions(context)[-3:])

        return to

    return partial(_held, advance)
