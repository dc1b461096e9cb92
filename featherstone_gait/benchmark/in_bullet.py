"""The humanoid's walk in Bullet, whose contact is neither ours nor MuJoCo's.

Bodies, joints and contact are Bullet's (`pip install pybullet`), the servos are those of `crosscheck/servo_chain.py`.
Bullet applies a constant torque to each joint over a step.  It has no rotors, so they are integrated beside it: with
the motor's torque and the joint's speed held over a step, a rotor on the spring of its gearbox is a linear system with
an exact solution by a matrix exponential, and the joint gets the mean torque of the gear over the step.  Then the twist
of the gear is corrected by the actual motion of the joint.  The replay is of first order in the step.

The floor has a spring and a damper under each contact point.  Soles are spheres, and friction is Bullet's pyramid.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.linalg import expm

from ..core.effects.push import EVENT_MARGIN
from ..crosscheck.floors import WARM_UP
from ..crosscheck.in_mujoco import RADIUS, SETTLING, TIMESTEP, evaluated, standing
from ..crosscheck.servo_chain import ServoChain
from ..model import Gearbox, Model
from ..scene.compile import CompiledScene
from ..walking.motion import Motion
from .engines import reread
from .methods import world

ITERATIONS = 200  # of Bullet's solver in each step
OWN_DAMPING = 0.1  # of the robot's own in each contact [N s/m], Bullet's default, which it adds to the floor's
FRICTION = 0.9  # of the floor
STIFFNESS, DAMPING = 9900.0, 76.0  # under a contact point [N/m, N s/m]: sinks by 0.3 mm, with 0.7 of critical damping


def rotor_step(gearbox: Gearbox, h: float) -> np.ndarray:
    """Return a rotor's step of h [s] as a map (2, 2, 4), with the motor's torque and the joint's speed held.

    It takes (twist, rotor's speed, motor's torque, joint's speed) to twist and speed, first at the end of the step,
    second in the mean over it.  All at the output side [rad, rad/s, N m]; the twist is rotor less joint.
    """
    inertia, damping = gearbox.reflected_inertia, gearbox.reflected_damping
    rates = np.zeros((6, 6))  # of twist and speed, of what is held, and of the integrals of twist and speed
    rates[0, :4] = 0.0, 1.0, 0.0, -1.0
    rates[1, :4] = np.array([-gearbox.stiffness, -(damping + gearbox.damping), 1.0, gearbox.damping]) / inertia
    rates[4:, :2] = np.eye(2)
    step = expm(rates * h)
    return np.stack([step[:2, :4], step[4:, :4] / h])


class Machine:
    """The robot of a scene in Bullet, on the floor or without one; arrays are (n,) in the order of its joints.

    timestep [s] must divide the tick of the controllers.  There is one machine at a time: the next one clears Bullet's
    world.  Backlash, delays, stops and springs of joints are left out.
    """

    def __init__(self, scene: CompiledScene, floor: bool = True, timestep: float = TIMESTEP) -> None:
        model = scene.model
        self.scene, self.h, self.period = scene, timestep, scene.tick_steps * scene.timestep
        servos = [model.servos[name] for name in model.joint_names]
        self.chain = ServoChain(servos, timestep, model.supply)
        steps = np.stack([rotor_step(servo.gearbox, timestep) for servo in servos])
        self._of_state, self._of_held = steps[..., :2].copy(), steps[..., 2:].copy()
        self._gears = np.array([(servo.gearbox.stiffness, servo.gearbox.damping) for servo in servos]).T
        damping = {joint.name: joint.damping for joint in model.joints}
        self._viscous = np.array([model.servos[name].viscous_friction + damping[name] for name in model.joint_names])
        self._bullet = world()
        self._bullet.resetSimulation()
        self._bullet.setGravity(*map(float, scene.gravity))
        self._bullet.setPhysicsEngineParameter(
            fixedTimeStep=timestep, numSolverIterations=ITERATIONS, numSubSteps=0, solverResidualThreshold=0.0,
            enableConeFriction=0, restitutionVelocityThreshold=0.0, deterministicOverlappingPairs=1,
        )  # fmt: skip
        if floor:
            self._lay()
        self._load(model)

    def _lay(self) -> None:
        bullet = self._bullet
        plane = bullet.createCollisionShape(bullet.GEOM_PLANE, planeNormal=[0, 0, 1])
        self._floor = bullet.createMultiBody(0, plane)
        soft = {"contactStiffness": STIFFNESS, "contactDamping": DAMPING - OWN_DAMPING}
        bullet.changeDynamics(self._floor, -1, lateralFriction=FRICTION)
        bullet.changeDynamics(self._floor, -1, **soft)

    def _load(self, model: Model) -> None:
        """Load the robot, and switch off Bullet's own damping, motors and sleep."""
        bullet = self._bullet

        def load(path: str) -> int:
            Path(path).write_text(_with_soles(Path(path).read_text("utf-8"), model), "utf-8")
            return bullet.loadURDF(path, flags=bullet.URDF_USE_INERTIA_FROM_FILE)

        self._robot = reread(replace(model, shapes=()), "robot.urdf", load)
        links = range(bullet.getNumJoints(self._robot))
        own = {"linearDamping": 0.0, "angularDamping": 0.0, "jointDamping": 0.0, "maxJointVelocity": 1e4}
        own |= {"lateralFriction": 1.0, "activationState": bullet.ACTIVATION_STATE_DISABLE_SLEEPING}
        for link in (-1, *links):
            bullet.changeDynamics(self._robot, link, **own)
        places = {bullet.getJointInfo(self._robot, link)[1].decode(): link for link in links}
        self._joints = [places[name] for name in model.joint_names]
        still = {"forces": [0.0] * len(self._joints)}
        bullet.setJointMotorControlArray(self._robot, self._joints, bullet.VELOCITY_CONTROL, **still)
        bodies = [bullet.getDynamicsInfo(self._robot, link) for link in (-1, *links)]
        self._masses, self._offset = np.array([body[0] for body in bodies]), np.array(bodies[0][3])

    def place(self, q: np.ndarray) -> None:
        """Put the robot at rest at q (7 + n,) [m, -, rad]."""
        bullet, turn = self._bullet, [*q[4:7], q[3]]
        bullet.resetBasePositionAndOrientation(self._robot, q[:3] + self._rotation(turn) @ self._offset, turn)
        bullet.resetBaseVelocity(self._robot, [0, 0, 0], [0, 0, 0])
        for joint, angle in zip(self._joints, q[7:]):
            bullet.resetJointState(self._robot, joint, angle, 0.0)
        self.q, self._speed = np.array(q[7:]), np.zeros(len(q) - 7)
        self._twist, self._rotor, self.torque = np.zeros((3, len(q) - 7))  # torque: of the gears, on the joints [N m]
        self.chain.goal = self.q.copy()

    def tick(self, reference: np.ndarray, rate: np.ndarray) -> None:
        """Make one tick of the controllers, with references [rad] and rates [rad/s], and Bullet's steps in it."""
        self.chain.tick(reference, rate, self.q, self._rotor, self.period)
        for _ in range(round(self.period / self.h)):
            self._step()

    def _step(self) -> None:
        bullet, chain, q, speed = self._bullet, self.chain, self.q, self._speed
        state, held = np.stack([self._twist, self._rotor], 1), np.stack([chain.step(self._rotor), speed], 1)
        moved = self._of_state @ state[:, None, :, None] + self._of_held @ held[:, None, :, None]
        (twist, self._rotor), (mean_twist, mean_speed) = moved[..., 0].transpose(1, 2, 0)
        self.torque = self._gears[0] * mean_twist + self._gears[1] * (mean_speed - speed)
        drive = self.torque - self._viscous * speed + chain.friction(speed)
        bullet.setJointMotorControlArray(self._robot, self._joints, bullet.TORQUE_CONTROL, forces=drive.tolist())
        bullet.stepSimulation()
        states = bullet.getJointStates(self._robot, self._joints)
        self.q, self._speed = (np.array([state[k] for state in states]) for k in (0, 1))
        self._twist = twist + self.h * speed - (self.q - q)  # the joint has turned otherwise than at the speed held
        chain.filter(self._speed)

    def base(self) -> np.ndarray:
        """Return position and quaternion of the base (7,) [m, -]; Bullet's position is its center of mass."""
        center, turn = self._bullet.getBasePositionAndOrientation(self._robot)
        return np.array([*(np.array(center) - self._rotation(turn) @ self._offset), turn[3], *turn[:3]])

    def _rotation(self, turn: Sequence[float]) -> np.ndarray:
        return np.array(self._bullet.getMatrixFromQuaternion(turn)).reshape(3, 3)

    def stands(self) -> bool:
        """Return whether the robot has not fallen, by the scene's own rule."""
        center, turn = self._bullet.getBasePositionAndOrientation(self._robot)
        links = self._bullet.getLinkStates(self._robot, [*range(len(self._masses) - 1)], computeForwardKinematics=1)
        height = self._masses @ [center[2], *(link[0][2] for link in links)] / self._masses.sum()
        upright = self._rotation(turn)[2] @ self.scene.upright
        return bool(upright >= self.scene.fall_upright and height >= self.scene.fall_height)

    def contacts(self) -> np.ndarray:
        """Return depth [m] and normal force [N] of each contact with the floor (k, 2)."""
        found = self._bullet.getContactPoints(self._floor, self._robot)
        return np.array([(max(-contact[8], 0.0), contact[9]) for contact in found]).reshape(-1, 2)


def _with_soles(text: str, model: Model) -> str:
    """Return a URDF for Bullet: collision spheres at the contact points, held joints fixed, no stops."""
    robot = ElementTree.fromstring(text)
    links = {link.get("name"): link for link in robot.iter("link")}
    for point in model.contacts:
        shape = ElementTree.SubElement(links[point.link], "collision")
        ElementTree.SubElement(shape, "origin", xyz=" ".join(map(str, point.position)))
        geometry = ElementTree.SubElement(shape, "geometry")
        ElementTree.SubElement(geometry, "sphere", radius=str(point.radius or RADIUS))
    for joint in robot.iter("joint"):
        if joint.get("name") in model.held:
            joint.set("type", "fixed")
        for limit in joint.iter("limit"):
            limit.attrib |= {"lower": "1", "upper": "-1"}  # Bullet's word for a joint without stops
    return ElementTree.tostring(robot, "unicode")


def stand(scene: CompiledScene, angles: np.ndarray, seconds: float = SETTLING) -> Machine:
    """Return the robot after it has stood with its joints at `angles` (n,) [rad], starting on the floor."""
    machine = Machine(scene)
    machine.place(standing(scene, angles, 0.0))
    for _ in range(round(seconds / machine.period)):
        machine.tick(angles, np.zeros_like(angles))
    return machine


def walk(scene: CompiledScene, motion: Motion, strides: int) -> float | None:
    """Walk a motion; return its energy per distance after two strides [J/m], None after a fall."""
    reference = motion.reference(WARM_UP + strides)
    angles, began, end = reference.values[0], motion.begin(WARM_UP), motion.begin(WARM_UP + strides)
    sinking = float(stand(scene, angles).contacts()[:, 0].sum()) / len(scene.model.contacts)
    machine = Machine(scene)
    machine.place(standing(scene, angles, sinking))
    first, ticks = (math.ceil(time / machine.period - 1e-6) for time in (began, end))
    drive, rate = evaluated(reference, machine.period * np.arange(ticks) - scene.lag + EVENT_MARGIN)
    for k in range(ticks):
        if k == first:
            place, drawn = machine.base(), machine.chain.meter.sum()
        machine.tick(drive[k], rate[k])
        if not machine.stands():
            return None
    return float(machine.chain.meter.sum() - drawn) / float((machine.base() - place)[0])
