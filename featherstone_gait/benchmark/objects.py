"""Robots that walk and stand with objects that they touch, here and in MuJoCo.

carry   The humanoid walks ten strides of its optimized gait with a box of 50 g across its forearms, which it holds
        forward: with rubber on the arms (friction 2), with less friction, and on bare arms (0.9).  `moved` is how far
        the box slips on the arms after the first two strides.
hit     The humanoid stands, with its servos on, and a ball flies at its trunk with 2 m/s, from ahead, behind or left.
        `moved` is the largest momentum of the ball [N s], in steps of 0.02 N s, after which it stands.
push    The humanoid walks, and another comes at it from behind, from ahead or from the left, with its arms forward, and
        pushes its shoulders; from the left with one arm.  The joints of the other are held and its weight is borne, so
        that it goes on at its speed until it touches.  `moved` is the largest momentum of the other [N s], in steps of
        0.02 N s, with which the humanoid walks on for three strides.
plank   ANYmal B trots over a board of 20 mm that lies loose on the ground.  `moved` is how far it pushes the board.

Both engines have the same bodies, servos, friction and time step.  The ground of MuJoCo has a time constant of 5 ms,
and ours the penetration that the robot has there.  Contact between bodies has MuJoCo's time constant of 5 ms there,
and a penetration of 1 mm under the weight of the robot here: at 0.1 mm a step of `midpoint` does not resolve a hit,
and the ball bounces.  MuJoCo is an extra: pip install featherstone-gait[mjcf].

    featherstone-gait benchmark objects        three minutes
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np

from ..base.rotation import rotation_from_quaternion, rotation_from_rpy
from ..crosscheck import Floor, replay, sinking, standing
from ..dynamics import forward_kinematics
from ..geometry.body import body
from ..model import Ground, Model, rigid_bodies
from ..model.pair_contact import PairContact
from ..model.placed import Placed, SceneModel
from ..model.shapes import Box, Shape, Sphere
from ..robot_file import load_robot
from ..run.reference import Reference
from ..run.simulate import initial_state, simulate
from ..run.trajectory import Trajectory
from ..scene.compile import CompiledScene, compile_scene
from ..walking import Motion, motion_of, read_motion
from .robots import anymal
from .table import machine, tabulate

STEP, EVERY, PENETRATION = 5e-4, 1e-2, 1e-3  # [s], [s], [m]
FRICTION, RUBBER = 0.9, 2.0
CARRIED = RUBBER, 1.5, 1.2, 1.0, FRICTION  # of a box that is carried
SOFT = 5e-3  # time constant of MuJoCo's contact [s]
STRIDES, WARM_UP = 10, 2
BEYOND = 3.0  # time for which a robot is watched after a hit [s]
MOMENTA = tuple(round(0.02 * k, 2) for k in range(1, 151))  # [N s]
ARMS = "left_forearm", "right_forearm"
PUSHED_STRIDES = 3
WAYS = {"ahead": (-1.0, 0.0), "behind": (1.0, 0.0), "left": (0.0, -1.0)}  # of what comes from there
BALL, SPEED, APART = 0.03, 2.0, 0.05  # radius [m], speed [m/s], and distance from the robot at the start [m]


class Row(NamedTuple):
    """Hold the result of one task in one engine."""

    task: Annotated[str, "task", "<20"]
    engine: Annotated[str, "engine", "<7"]
    stands: Annotated[bool, "stands", "6"]  # until the end
    end_s: Annotated[float, "end [s]", "8.2f"]
    moved: Annotated[float, "moved", "9.2g"]  # by the object, or the momentum survived
    unit: Annotated[str, "", "<4"] = "m"  # of it
    speed_m_per_s: Annotated[float, "m/s", "7.3f"] = math.nan


@dataclass(frozen=True)
class Task:
    """Describe a robot that walks or stands with an object."""

    name: str
    alone: CompiledScene  # the robot
    angles: np.ndarray  # of its joints at the start [rad]
    reference: Reference
    duration: float  # [s]
    shape: Box | Sphere  # of the object
    mass: float  # [kg]
    place: tuple[float, float, float]  # of its center, above the height at which the robot stands on the ground [m]
    velocity: tuple[float, float, float]  # [m/s]
    links: tuple[str, ...]  # of the robot, that touch it
    on_ground: bool = False  # whether the object lies there
    friction: float = FRICTION  # of the object and of what touches it
    other: Model | None = None  # in place of shape and mass, one rigid body
    turn: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)  # of the object at the start, a quaternion

    @property
    def model(self) -> Model:
        return self.alone.model


def here(task: Task) -> tuple[Trajectory, np.ndarray]:
    """Run a task in this package; return the robot's run and the object's poses (samples, 7)."""
    depth = sinking(task.alone, task.angles, _floor(), timestep=STEP)
    ground = Ground(friction=FRICTION, penetration=depth)
    thing = task.other or body(task.shape, task.mass, name="thing", friction=task.friction)
    placed = Placed(thing, "thing", task.place, task.turn, ground_contact=task.on_ground)
    members = Placed(task.model, "robot"), placed
    own = dict.fromkeys(shape.link for shape in thing.shapes)
    touching = tuple((f"robot/{link}", f"thing/{other}") for link in task.links for other in own)
    pairs = PairContact(touching, PENETRATION, friction=task.friction, load=task.model.mass)
    model = SceneModel("with an object", members, ground=ground)
    scene = compile_scene(model, "mipsd", None, "midpoint", STEP, pairs=pairs)
    q = standing(task.alone, task.angles, depth)
    state = initial_state(
        scene, {"robot": q, "thing": [*task.place, *task.turn]}, {"thing": [*task.velocity, 0.0, 0.0, 0.0]},
        allow_limit_violation=True,
    )  # fmt: skip
    record = "base_q", "base_qd", "q", "qd"
    run = simulate(
        scene, task.duration, state, task.reference, record=record, record_interval=EVERY, estimate_error=False
    )
    return run.of("robot"), run.of("thing")["base_q"]


def in_mujoco(task: Task) -> tuple[Trajectory, np.ndarray]:
    """Run a task in MuJoCo; return the robot's run and the object's poses (samples, 7)."""
    depth = sinking(task.alone, task.angles, _floor(), timestep=STEP)
    q = standing(task.alone, task.angles, depth)
    objects = partial(_add, task)
    run = replay(task.alone, task.duration, q, task.reference, _floor(), timestep=STEP, objects=objects)
    return run, run["object_q"][:, 0]


def _floor() -> Floor:
    return Floor(SOFT, FRICTION)


def _add(task: Task, spec: Any) -> np.ndarray:
    """Add the object, and geoms on the links that touch it; return its velocity (1, 6)."""

    touch = {"friction": [task.friction, 0.0, 0.0], "solref": [SOFT, 1.0]}
    thing = spec.worldbody.add_body(name="thing", pos=task.place, quat=task.turn)
    thing.add_freejoint()
    # Bit 1: feet, which touch the floor and what lies on it; bit 2: what touches the links.
    kind = {"contype": 3, "conaffinity": 1} if task.on_ground else {"contype": 2, "conaffinity": 0}
    if task.other is None:
        thing.add_geom(**_geom(task.shape), mass=task.mass, priority=1, **kind, **touch)
    else:
        (whole, *_), _ = rigid_bodies(task.other)
        thing.mass, thing.ipos, thing.gravcomp, thing.explicitinertial = whole.mass, whole.center, 1.0, True
        thing.fullinertia = whole.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        poses = forward_kinematics(task.other, np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]))
        for shape in task.other.shapes:
            E, r = (part[task.other.link_rows[shape.link]] for part in poses)
            at = r + E @ np.array(shape.xyz)
            thing.add_geom(**_placed(shape, at, E @ rotation_from_rpy(shape.rpy)), priority=1, **kind, **touch)
    for shape in task.model.shapes if not task.on_ground else ():
        if shape.link in task.links:
            geom = _placed(shape, shape.xyz, rotation_from_rpy(shape.rpy))
            spec.body(shape.link).add_geom(**geom, contype=0, conaffinity=2, **touch)
    return np.array([[*task.velocity, 0.0, 0.0, 0.0]])


def _placed(shape: Shape, at: Sequence[float] | np.ndarray, turn: np.ndarray) -> dict[str, Any]:
    """Describe a massless geom at a place of its body."""
    import mujoco

    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, turn.ravel())
    return _geom(shape.geometry) | {"pos": at, "quat": quat, "mass": 0.0}


def _geom(shape: Any) -> dict[str, Any]:
    import mujoco

    if isinstance(shape, Sphere):
        return {"type": mujoco.mjtGeom.mjGEOM_SPHERE, "size": [shape.radius, 0.0, 0.0]}
    return {"type": mujoco.mjtGeom.mjGEOM_BOX, "size": [0.5 * side for side in shape.size]}


# ---------------------------------------------------------------------------------------------- tasks


def carry(friction: float) -> Task:
    """Walk with a box on the forearms."""
    model = load_robot("humanoid", locked="simplified")
    raised = {f"{side}_front_shoulder": 0.5 * math.pi for side in ("left", "right")}
    model = replace(model, locked={**model.locked, **raised})
    motion, size, top = _gait_of(model), (0.06, 0.2, 0.04), 0.0
    poses = forward_kinematics(model, np.array([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, *motion.start[0]]]))
    rows = {link.name: k for k, link in enumerate(model.links)}
    links = ARMS
    middles = []
    for shape in (shape for shape in model.shapes if shape.link in links):
        turn, at = poses.rotation[0, rows[shape.link]], poses.position[0, rows[shape.link]]
        assert isinstance(shape.geometry, Box)
        middles.append(at + turn @ np.array(shape.xyz))
        top = float(middles[-1][2] + 0.5 * (np.abs(turn) @ np.array(shape.geometry.size))[2])
    place = float(np.mean(middles, axis=0)[0]), 0.0, top + 0.5 * size[2]
    task = _task(f"carry, friction {friction:g}", model, motion, STRIDES, Box(size), 0.05, place, links)
    return replace(task, friction=friction)


def plank() -> Task:
    """Trot over a board."""
    cost = anymal()
    model, motion = cost.scene.model, motion_of(cost.gait, cost.start, blend_strides=cost.blend_strides)
    links = tuple(dict.fromkeys(point.link for point in model.contacts))
    size = 0.3, 0.9, 0.02
    task = _task("plank", model, motion, STRIDES, Box(size), 2.0, (0.65, 0.0, 0.0), links)
    return replace(task, place=(0.65, 0.0, 0.5 * size[2]), on_ground=True)


def hit(origin: str, momentum: float) -> Task:
    """Stand, and be hit by a ball."""
    model = load_robot("humanoid", locked="simplified")
    motion = _gait_of(model)
    (trunk,) = (shape for shape in model.shapes if shape.link == model.root)
    assert isinstance(trunk.geometry, Box)
    way = np.array([*WAYS[origin], 0.0])
    far = 0.5 * float(np.abs(way) @ np.array(trunk.geometry.size)) + BALL + APART
    x, y, z = np.array(trunk.xyz) - far * way
    task = _task("hit", model, motion, 1, Sphere(BALL), momentum / SPEED, (x, y, z), (model.root,))
    still = Reference([0.0], task.angles[None])
    speed = SPEED * way
    return replace(task, reference=still, duration=BEYOND, velocity=(float(speed[0]), float(speed[1]), 0.0))


def push(origin: str, momentum: float) -> Task:
    """Walk, and be pushed by another humanoid."""
    model, other = load_robot("humanoid", locked="simplified"), load_robot("humanoid", locked="all")
    held = {f"{side}_front_shoulder": 0.5 * math.pi for side in ("left", "right")}
    arms = tuple(replace(shape, friction=FRICTION) for shape in other.shapes if shape.link in ARMS)
    borne = tuple(replace(link, gravity_compensation=1.0) for link in other.links)
    other = replace(other, locked={**other.locked, **held}, shapes=arms, links=borne, contacts=())
    way = np.array([*WAYS[origin], 0.0])
    turn = rotation_from_rpy((0.0, 0.0, math.atan2(way[1], way[0])))
    left, right = (_spot(other, arm) for arm in ARMS)
    shoulders = [_spot(model, f"{side}_shoulder_block") for side in ("left", "right")]
    middle, half = np.mean([spot[0] for spot in shoulders], axis=0), shoulders[0][1]
    tip = 0.5 * (left[0] + right[0])
    if way[1]:  # with the left arm at the left shoulder
        middle, tip = shoulders[0][0], left[0]
    far = float(np.abs(way) @ half) + float(left[1][0]) + APART
    x, y, z = middle - far * way - turn @ tip
    motion = _gait_of(model)
    links = model.root, *(shape.link for shape in model.shapes if "shoulder" in shape.link or "upper_arm" in shape.link)
    task = _task("push", model, motion, PUSHED_STRIDES, Sphere(BALL), other.mass, (x, y, z), links)
    speed, yaw = momentum / other.mass * way, math.atan2(way[1], way[0])
    quaternion = math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw)
    return replace(task, velocity=(float(speed[0]), float(speed[1]), 0.0), other=other, turn=quaternion)


def _gait_of(model: Model) -> Motion:
    return read_motion(Path(model.source).parent / "optimized_gait.npz", model.joint_names)


def _spot(model: Model, link: str) -> tuple[np.ndarray, np.ndarray]:
    """Return center and half the extent of a link's box, from the base of a robot with its joints at zero [m]."""
    poses = forward_kinematics(model, np.array([0.0, 0.0, 0.0, 1.0, *[0.0] * (model.nq - 4)]))
    (shape,) = (shape for shape in model.shapes if shape.link == link)
    assert isinstance(shape.geometry, Box)
    E, r = (part[model.link_rows[link]] for part in poses)
    return r + E @ np.array(shape.xyz), 0.5 * np.abs(E) @ np.array(shape.geometry.size)


def _task(
    name: str, model: Model, motion: Motion, strides: int, shape: Box | Sphere, mass: float,
    place: Sequence[float], links: tuple[str, ...],
) -> Task:  # fmt: skip
    """Make a task; place: of the object from the base of the robot, where it stands [m]."""
    alone = compile_scene(model, "mipsd", Ground(friction=FRICTION), "midpoint", STEP)
    reference = motion.reference(WARM_UP + strides)
    height = float(standing(alone, reference.values[0], 0.0)[2])
    x, y, z = place
    duration, still = motion.begin(WARM_UP + strides), (0.0, 0.0, 0.0)
    return Task(name, alone, reference.values[0], reference, duration, shape, mass, (x, y, z + height), still, links)


# ---------------------------------------------------------------------------------------------- what is measured

Engine = Callable[[Task], tuple[Trajectory, np.ndarray]]
ENGINES: dict[str, Engine] = {"here": here, "MuJoCo": in_mujoco}


def carried(task: Task, engine: str) -> Row:
    """Measure how far the box slips on the arms after the first strides."""
    run, thing = ENGINES[engine](task)
    settled = _gait_of(task.model).begin(WARM_UP)
    seen = np.stack([
        rotation_from_quaternion(base[3:]).T @ (at - base[:3]) for base, at in zip(run["base_q"], thing[:, :3])
    ])  # fmt: skip
    after = seen[run["time"] > settled]
    slip = np.linalg.norm((after - after[0])[:, :2], axis=1).max() if len(after) else math.nan
    return Row(task.name, engine, run.status == "ok", run.end_time, float(slip), speed_m_per_s=_speed(run))


def trodden(task: Task, engine: str) -> Row:
    """Measure how far the board moves."""
    run, thing = ENGINES[engine](task)
    moved = float(np.linalg.norm((thing[-1] - thing[0])[:2]))
    return Row(task.name, engine, run.status == "ok", run.end_time, moved, speed_m_per_s=_speed(run))


def _speed(run: Trajectory) -> float:
    return float((run["base_q"][-1, 0] - run["base_q"][0, 0]) / run.end_time)


def survived(make: Callable[[str, float], Task], origin: str, engine: str) -> Row:
    """Find by bisection the largest momentum after which the robot stands."""
    low, high = 0, len(MOMENTA)
    while low < high:
        middle = (low + high) // 2
        run, _ = ENGINES[engine](make(origin, MOMENTA[middle]))
        low, high = (middle + 1, high) if run.status == "ok" else (low, middle)
    name, end = f"{make.__name__} from {origin}", make(origin, MOMENTA[0]).duration
    return Row(name, engine, True, end, MOMENTA[low - 1] if low else 0.0, "N s")


def rows() -> Iterator[Row]:
    """Do all tasks in both engines."""
    jobs: list[Callable[[str], Row]] = [
        *(partial(carried, carry(friction)) for friction in CARRIED), partial(trodden, plank()),
        *(partial(survived, make, origin) for make in (hit, push) for origin in WAYS),
    ]  # fmt: skip
    return (job(engine) for job in jobs for engine in ENGINES)


def run(out_dir: Path, full: bool = False) -> list[Row]:
    """Print the table; write objects.csv into `out_dir`; `full` changes nothing."""
    return tabulate(out_dir / "objects.csv", Row, rows(), machine())
