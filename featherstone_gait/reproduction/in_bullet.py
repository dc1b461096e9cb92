"""Gaits of the humanoid in Bullet: do they walk in an engine whose contact is neither ours nor MuJoCo's?

Bodies, joints and contact are Bullet's (`pip install pybullet`), the servos are those of `crosscheck/servo_chain.py`.
Bullet applies a constant torque to each joint over a step.  It has no rotors, so they are integrated beside it: with
the motor's torque and the joint's speed held over a step, a rotor on the spring of its gearbox is a linear system with
an exact solution by a matrix exponential, and the joint gets the mean torque of the gear over the step.  Then the twist
of the gear is corrected by the actual motion of the joint.  The replay is of first order in the step.

The hard floor is Bullet's default; the soft one has a spring and a damper under each contact point.  Soles are spheres,
and friction is Bullet's pyramid.  Each gait walks 20 strides after two, on both floors with three friction
coefficients.

    python -m featherstone_gait.reproduction.in_bullet TABLE.csv

writes a row for each gait and floor, and resumes with those that are not in TABLE.csv.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple
from weakref import finalize

import numpy as np
from scipy.linalg import expm

from ..base.files import Format, read_csv, write_csv
from ..base.progress import progress_bar
from ..core.effects.push import EVENT_MARGIN
from ..crosscheck.floors import STRIDES, WARM_UP
from ..crosscheck.in_mujoco import RADIUS, SETTLING, TIMESTEP, evaluated, standing
from ..crosscheck.servo_chain import ServoChain, is_gentle
from ..model import Gearbox, Ground, Model, Servo
from ..robot_file import load_robot, save_robot
from ..scene.compile import CompiledScene, compile_scene
from ..walking.cost import LEAST_SPEED
from ..walking.motion import Motion, read_motion
from .sources import PACKAGE, digest, digest_of
from .tables import table_arguments

ITERATIONS = 200  # of Bullet's solver in each step
OWN_DAMPING = 0.1  # of the robot's own in each contact [N s/m], Bullet's default, which it adds to the floor's
TABLE = Format("table of gaits in Bullet")
COLUMNS = ["gait", "floor", "friction", "walks", "end_s", "cost_J_per_m", "speed_m_per_s", "sideways_m", "sinking_m"]
GAITS = {  # file in the repository, and whether the gait is that which its search began with
    "first": ("robots/humanoid/optimized_gait.npz", True),
    "seed 0": ("robots/humanoid/optimized_gait.npz", False),
    "seed 1": ("docs/reproduction/gait_seed_1.npz", False),
    "seed 2": ("docs/reproduction/gait_seed_2.npz", False),
    "one floor": ("docs/reproduction/gait_nominal.npz", False),
}
FRICTIONS = (0.6, 0.9, 1.2)


class Floor(NamedTuple):
    """A level floor in Bullet."""

    friction: float  # coefficient
    stiffness: float | None = None  # under a contact point [N/m]; None: Bullet's default, which is hard
    damping: float = 0.0  # ... [N s/m], of a floor with a stiffness


FLOORS = {"hard": Floor(0.9), "soft": Floor(0.9, 9900.0, 76.0)}  # soft: sinks by 0.3 mm, with 0.7 of critical damping


class Walked(NamedTuple):
    """Result of a gait on one floor; cost, speed and sideways are None if it falls."""

    walks: bool  # whether it walked all strides, forward
    end: float  # when it fell, or had walked all strides [s]
    cost: float | None = None  # [J/m]
    speed: float | None = None  # [m/s]
    sideways: float | None = None  # over the strides that are measured [m]
    sinking: float = math.nan  # of the contact points under the robot at rest, in the mean [m]


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
    """The robot of a scene in Bullet, on a floor or without one; arrays are (n,) in the order of its joints.

    timestep [s] must divide the tick of the controllers.  Raises ImportError without Bullet, ValueError for what the
    replay lacks.
    """

    def __init__(self, scene: CompiledScene, floor: Floor | None, timestep: float = TIMESTEP) -> None:
        model = scene.model
        self.scene, self.h, self.period = scene, timestep, scene.tick_steps * scene.timestep
        servos = [model.servos[name] for name in model.joint_names]
        _check(model, servos, timestep)
        self.chain = ServoChain(servos, timestep, model.supply)
        steps = np.stack([rotor_step(servo.gearbox, timestep) for servo in servos])
        self._of_state, self._of_held = steps[..., :2].copy(), steps[..., 2:].copy()
        self._gears = np.array([(servo.gearbox.stiffness, servo.gearbox.damping) for servo in servos]).T
        damping = {joint.name: joint.damping for joint in model.joints}
        self._viscous = np.array([model.servos[name].viscous_friction + damping[name] for name in model.joint_names])
        self._bullet = _World()
        self._bullet.setGravity(*map(float, scene.gravity))
        self._bullet.setPhysicsEngineParameter(
            fixedTimeStep=timestep, numSolverIterations=ITERATIONS, numSubSteps=0, solverResidualThreshold=0.0,
            enableConeFriction=0, restitutionVelocityThreshold=0.0, deterministicOverlappingPairs=1,
        )  # fmt: skip
        if floor is not None:
            self._lay(floor)
        self._load(model)

    def _lay(self, floor: Floor) -> None:
        bullet = self._bullet
        plane = bullet.createCollisionShape(bullet.GEOM_PLANE, planeNormal=[0, 0, 1])
        self._floor = bullet.createMultiBody(0, plane)
        bullet.changeDynamics(self._floor, -1, lateralFriction=floor.friction)
        if floor.stiffness is not None:
            soft = {"contactStiffness": floor.stiffness, "contactDamping": floor.damping - OWN_DAMPING}
            bullet.changeDynamics(self._floor, -1, **soft)

    def _load(self, model: Model) -> None:
        """Load the robot, and switch off Bullet's own damping, motors and sleep."""
        bullet = self._bullet
        with TemporaryDirectory() as folder:
            path = Path(folder) / "robot.urdf"
            save_robot(replace(model, shapes=()), path)
            path.write_text(_with_soles(path.read_text("utf-8"), model), "utf-8")
            self._robot = bullet.loadURDF(str(path), flags=bullet.URDF_USE_INERTIA_FROM_FILE)
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


class _World:
    """Bullet with a world of its own, which is released with this object."""

    def __init__(self) -> None:
        self._bullet = _pybullet()
        self._number = self._bullet.connect(self._bullet.DIRECT)
        finalize(self, self._bullet.disconnect, self._number)

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._bullet, name)
        return partial(found, physicsClientId=self._number) if callable(found) else found


def _pybullet() -> Any:
    try:
        import pybullet  # type: ignore[import-not-found]
    except ImportError as error:
        raise ImportError("this study runs Bullet; install it with pip install pybullet") from error
    return pybullet


def _check(model: Model, servos: Sequence[Servo], h: float) -> None:
    """Raise ValueError for features of a robot that the replay lacks."""
    lacking = ["backlash"] * any(servo.gearbox.backlash > 0.0 for servo in servos)
    lacking += ["delays"] * any(servo.controller.delay > 0.0 for servo in servos)
    sticks = any(servo.coulomb_friction > 0.0 and not is_gentle(servo, h) for servo in servos)
    lacking += ["dry friction that grows within a step"] * sticks
    lacking += ["joints held elsewhere than at 0"] * any(model.held.values())
    sprung = any(joint.stiffness > 0.0 or joint.cubic_stiffness > 0.0 for joint in model.moving_joints)
    lacking += ["springs of joints"] * sprung
    lacking += ["tendons"] * bool(model.tendons)
    lacking += ["gravity compensation"] * any(link.gravity_compensation != 0.0 for link in model.links)
    lacking += ["contact points with friction of their own"] * any(p.friction is not None for p in model.contacts)
    if lacking:
        raise ValueError(f"{model.name}: the replay in Bullet lacks {lacking[0]}; leave it out of the robot")


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


# ---------------------------------------------------------------------------------------------- walks


def humanoid() -> CompiledScene:
    """Return the robot of these gaits; its ground only defines what counts as a fall."""
    return compile_scene(load_robot("humanoid", locked="simplified"), "mipsd", Ground(), "midpoint", 1e-3)


def stand(scene: CompiledScene, angles: np.ndarray, floor: Floor, seconds: float = SETTLING) -> Machine:
    """Return the robot after it has stood with its joints at `angles` (n,) [rad], starting on the floor."""
    machine = Machine(scene, floor)
    machine.place(standing(scene, angles, 0.0))
    for _ in range(round(seconds / machine.period)):
        machine.tick(angles, np.zeros_like(angles))
    return machine


def walk(scene: CompiledScene, motion: Motion, floor: Floor, strides: int = STRIDES) -> Walked:
    """Walk a motion, with two strides before those that are measured.  Raises as `Machine`."""
    reference = motion.reference(WARM_UP + strides)
    angles, began, end = reference.values[0], motion.begin(WARM_UP), motion.begin(WARM_UP + strides)
    sinking = float(stand(scene, angles, floor).contacts()[:, 0].sum()) / len(scene.model.contacts)
    machine = Machine(scene, floor)
    machine.place(standing(scene, angles, sinking))
    first, ticks = (math.ceil(time / machine.period - 1e-6) for time in (began, end))
    drive, rate = evaluated(reference, machine.period * np.arange(ticks) - scene.lag + EVENT_MARGIN)
    for k in range(ticks):
        if k == first:
            place, drawn = machine.base(), machine.chain.meter.sum()
        machine.tick(drive[k], rate[k])
        if not machine.stands():
            return Walked(False, round(machine.period * (k + 1), 9), sinking=sinking)
    ahead, sideways = (machine.base() - place)[:2].tolist()
    if ahead < LEAST_SPEED * (end - began):
        return Walked(False, round(end, 9), sinking=sinking)
    cost = float(machine.chain.meter.sum() - drawn) / ahead
    return Walked(True, round(end, 9), cost, ahead / (end - began), sideways, sinking)


# ---------------------------------------------------------------------------------------------- the table


def kept(path: Path, notes: str) -> dict[tuple[str, ...], list[str]]:
    """Return the rows of a table with these notes, by gait, floor and friction.

    Raises ValueError for a file of another kind.
    """
    if not path.exists():
        return {}
    table = [cells for _, cells in read_csv(path, TABLE)]
    comments = [line[2:] for line in path.read_text("utf-8-sig").splitlines() if line.startswith("# ")]
    if comments[1:] != notes.splitlines() or table[:1] != [COLUMNS]:
        return {}
    return {tuple(cells[:3]): cells for cells in table[1:] if len(cells) == len(COLUMNS)}


def study(path: Path) -> None:
    """Walk all gaits on all floors, and write the table after each.  Raises ImportError, ValueError and OSError."""
    _pybullet()  # says what to install
    gaits = digest_of([PACKAGE.parent / file for file, _ in GAITS.values()])
    notes = f"sources {digest(Path(__file__))}\ngaits {gaits}\npybullet {version('pybullet')}"
    scene = humanoid()
    rows, keys = kept(path, notes), [*product(GAITS, FLOORS, map(str, FRICTIONS))]
    todo = [key for key in keys if key not in rows]
    for gait, floor, friction in progress_bar(todo, total=len(keys), initial=len(keys) - len(todo), unit="walk"):
        file, first = GAITS[gait]
        motion = read_motion(PACKAGE.parent / file, scene.model.joint_names, first=first)
        walked = walk(scene, motion, FLOORS[floor]._replace(friction=float(friction)))
        rows[gait, floor, friction] = [gait, floor, friction, *("" if cell is None else str(cell) for cell in walked)]
        write_csv(path, TABLE, COLUMNS, [rows[key] for key in keys if key in rows], notes)


def main(arguments: Sequence[str] | None = None) -> int:
    """Walk all gaits that are not in the table yet."""
    study(table_arguments("walk gaits of the humanoid in Bullet", arguments).table)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
