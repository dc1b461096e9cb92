"""Scenes of `benchmark default` whose bodies touch each other: objects, robots, and files of other people."""

from __future__ import annotations

import importlib.util
import math
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..dynamics.tree import GRAVITY
from ..geometry.body import body
from ..geometry.distance import shape_table
from ..model import Ground
from ..model.numpy_dynamics import link_poses
from ..model.pair_contact import PairContact
from ..model.placed import Placed, SceneModel
from ..model.shapes import Box, Capsule, Cylinder, Geometry, Hull, Mesh, Sphere
from ..robot_file import RobotFileWarning, load_robot
from ..robot_file.scene import load_scene
from ..run.overlap import OverlapWarning
from ..run.reference import Reference
from ..run.simulate import initial_state
from ..scene.compile import CompiledScene, compile_scene
from .case import Case

KIND = "pairs"  # first word of the kinds of these scenes
OBJECTS, ROBOTS, OTHERS = f"{KIND}, objects", f"{KIND}, robots", f"{KIND}, files of others"
WEIGHTLESS = (0.0, 0.0, 0.0)
RADIUS = 0.05  # of balls [m]
BRICK = (0.2, 0.1, 0.06)  # [m]
FLOOR = (2.0, 2.0, 0.2)  # of obstacles whose top is at height 0 [m]

Velocities = Mapping[str, Sequence[float]]  # of members, the first of (nv,) [m/s, rad/s]


def pair_cases(skipped: list[str]) -> Iterator[Case]:
    """Yield all scenes; skipped: takes what is left out, and why."""
    for makers in (collisions(), round_bodies(), sliding(), falling(), piles(), robots(), of_others(skipped)):
        yield from makers


# ---------------------------------------------------------------------------------------------- parts


def free(shape: Geometry, name: str, place: Sequence[float], mass: float = 1.0, turn: float = 0.0) -> Placed:
    """Place an object, turned about the y axis by an angle [rad]."""
    turned = (math.cos(0.5 * turn), 0.0, math.sin(0.5 * turn), 0.0)
    return Placed(body(shape, mass, name=name), position=tuple(place), orientation=turned)


def fixed(shape: Geometry, name: str, place: Sequence[float], turn: float = 0.0) -> Placed:
    """Place an obstacle, turned about the y axis by an angle [rad]."""
    turned = (math.cos(0.5 * turn), 0.0, math.sin(0.5 * turn), 0.0)
    return Placed(body(shape, name=name, base="fixed"), position=tuple(place), orientation=turned)


def floor(turn: float = 0.0) -> Placed:
    """Return an obstacle whose top goes through the origin."""
    return fixed(Box(FLOOR), "floor", (-0.1 * math.sin(turn), 0.0, -0.1 * math.cos(turn)), turn)


def case(
    name: str, members: Sequence[Placed], obstacles: Sequence[Placed] = (), speeds: Velocities | None = None, *,
    duration: float = 0.5, gravity: Sequence[float] = GRAVITY, **law: Any,
) -> Case:  # fmt: skip
    """Make the case of objects that touch all that they can; law: fields of `PairContact`."""
    described = SceneModel("scene", tuple(members), tuple(obstacles))
    scene = compile_scene(described, gravity=gravity, pairs=PairContact(**law))
    return of_scene(name, OBJECTS, scene, duration, speeds)


def of_scene(
    name: str, kind: str, scene: CompiledScene, duration: float, speeds: Velocities | None = None,
    reference: Reference | None = None,
) -> Case:  # fmt: skip
    """Make a case that starts at the members' places."""
    size = {member.name: member.model.nv for member in scene.members}
    given = {who: [*v, *[0.0] * (size[who] - len(v))] for who, v in (speeds or {}).items()}
    return Case(name, kind, scene, duration, initial_state(scene, None, given), reference)


# ---------------------------------------------------------------------------------------------- objects


def collisions() -> Iterator[Case]:
    """Yield balls, rods and boxes that meet without weight."""
    ball = Sphere(RADIUS)
    for ratio in (0.0, 0.3, 0.7):
        pair = [free(ball, "first", (0.0, 0.0, 0.0)), free(ball, "second", (0.11, 0.0, 0.0), 2.0)]
        speeds = {"first": (1.0,)}
        yield case(f"two balls, damping ratio {ratio:g}", pair, (), speeds, gravity=WEIGHTLESS, damping_ratio=ratio)
    for friction in (0.1, 1.0):
        pair = [free(ball, "first", (0.0, 0.0, 0.0)), free(ball, "second", (0.08, 0.0, 0.08))]
        spins = {"first": (2.0, 0.0, 0.0, 0.0, 10.0, 0.0)}
        yield case(f"two balls askew, friction {friction:g}", pair, (), spins, gravity=WEIGHTLESS, friction=friction)
    row = [free(ball, f"ball{k}", (2.02 * RADIUS * k, 0.0, 0.0)) for k in range(5)]
    yield case("Newton's cradle", row, (), {"ball0": (1.0,)}, gravity=WEIGHTLESS, damping_ratio=0.0)
    rod = free(Capsule(0.02, 0.3), "rod", (0.0, 0.0, 0.0))
    thrown = [rod, free(ball, "ball", (-0.1, 0.0, 0.14))]
    yield case("ball on a rod's end", thrown, (), {"ball": (1.5,)}, gravity=WEIGHTLESS)
    bricks = [free(Box(BRICK), "first", (0.0, 0.0, 0.0)), free(Box(BRICK), "second", (0.25, 0.03, 0.02), turn=0.4)]
    yield case("two boxes, corner on face", bricks, (), {"second": (-1.0,)}, gravity=WEIGHTLESS)
    plate = fixed(Box((1.0, 1.0, 0.001)), "plate", (0.0, 0.0, 0.0))
    shot, fast = [free(ball, "ball", (0.0, 0.0, 0.3))], {"ball": (3.0, 0.0, -100.0)}
    yield case("ball of 100 m/s on a plate of 1 mm", shot, [plate], fast, duration=0.05)


def round_bodies() -> Iterator[Case]:
    """Yield what rolls."""
    ball = Sphere(RADIUS)
    fixed_ball = fixed(Sphere(0.2), "below", (0.0, 0.0, 0.0))
    for friction in (0.2, 1.0):
        above = [free(ball, "ball", (0.03, 0.0, 0.2482))]
        yield case(f"ball off a ball, friction {friction:g}", above, [fixed_ball], friction=friction)
    for name, shape, height in (
        ("ball", ball, RADIUS), ("cylinder", Cylinder(0.05, 0.2), 0.05), ("capsule", Capsule(0.04, 0.2), 0.04),
    ):  # fmt: skip
        lying = (math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0)  # its axis along y
        member = replace(free(shape, name, (0.0, 0.0, height - 5e-4)), orientation=lying)
        yield case(f"{name} down a slope", [member], [floor()], gravity=(2.0, 0.0, -9.6))
    disc = replace(free(Cylinder(0.1, 0.02), "disc", (0.0, 0.0, 0.11)), orientation=(0.76, 0.65, 0.0, 0.0))
    yield case("disc that topples", [disc], [floor()], {"disc": (0.5, 0.0, 0.0, 0.0, 5.0, 0.0)}, duration=0.3)
    sides = [fixed(Box((1.0, 1.0, 0.02)), f"side{k}", (0.3 * k, 0.0, 0.0), -0.8 * k) for k in (-1, 1)]
    yield case("ball in a groove", [free(ball, "ball", (0.08, 0.0, 0.0))], sides)
    spins = {"ball": (1.0, 0.0, 0.0, 0.0, -40.0, 0.0)}
    yield case("ball with back spin", [free(ball, "ball", (0.0, 0.0, RADIUS))], [floor()], spins, friction=0.3)


def sliding() -> Iterator[Case]:
    """Yield boxes that slide or stick, on obstacles and on each other."""
    brick = Box(BRICK)
    for friction in (0.2, 0.9):
        member, steep = [free(brick, "box", (0.0, 0.0, 0.0296))], (4.0, 0.0, -9.0)
        yield case(f"box on a slope, friction {friction:g}", member, [floor()], gravity=steep, friction=friction)
    thrown = {"box": (1.5, 0.2, 0.0, 0.0, 0.0, 6.0)}
    yield case("box thrown along a floor", [free(brick, "box", (0.0, 0.0, 0.0296))], [floor()], thrown, friction=0.4)
    plank = free(Box((0.6, 0.3, 0.02)), "plank", (0.0, 0.0, 0.0092), 2.0)
    both = [plank, free(brick, "box", (0.0, 0.0, 0.0488))]
    yield case("box on a plank that is pushed away", both, [floor()], {"plank": (2.0,)}, friction=0.3)
    wall = fixed(Box((0.2, 2.0, 2.0)), "wall", (0.7, 0.0, 0.0))
    rod = free(Capsule(0.02, 0.4), "rod", (0.44, 0.0, 0.18), turn=0.7)
    yield case("rod against a wall", [rod], [floor(), wall], friction=0.3)
    member = [free(brick, "box", (0.4, 0.0, 0.0296))]
    yield case("box that slides into a wall", member, [floor(), wall], {"box": (1.5,)})
    wedge = free(Hull(((0, 0, 0), (0.3, 0, 0), (0.3, 0, 0.15), (0, 0.2, 0), (0.3, 0.2, 0), (0.3, 0.2, 0.15))), "wedge",
                 (0.0, 0.0, 0.0), 2.0)  # fmt: skip
    yield case("ball on a wedge", [wedge, free(Sphere(RADIUS), "ball", (0.2, 0.1, 0.16))], [floor()], friction=0.2)


def falling() -> Iterator[Case]:
    """Yield shapes that fall on a floor."""
    shapes: dict[str, Geometry] = {
        "box": Box(BRICK), "cylinder": Cylinder(0.06, 0.1), "capsule": Capsule(0.04, 0.15),
        "hull": Hull(((0.0, 0.0, 0.1), (0.1, 0.0, -0.05), (-0.05, 0.09, -0.05), (-0.05, -0.09, -0.05))),
    }  # fmt: skip
    for name, shape in shapes.items():
        yield case(f"{name} falls askew", [free(shape, name, (0.0, 0.0, 0.2), turn=0.5)], [floor()])
    yield case("box falls flat", [free(Box(BRICK), "box", (0.0, 0.0, 0.1))], [floor()])
    yield case("box falls across an edge", [free(Box(BRICK), "box", (1.02, 0.0, 0.1))], [floor()])
    light, heavy = (free(Box(BRICK), name, (0.0, 0.0, 0.0296 + 0.0592 * k), m) for k, (name, m) in
                    enumerate((("light", 0.1), ("heavy", 100.0))))  # fmt: skip
    yield case("a thousandfold mass on a light box", [light, heavy], [floor()])


def piles() -> Iterator[Case]:
    """Yield what stands on others of its kind, and what falls over."""
    boxes = [free(Box((0.1, 0.1, 0.1)), f"box{k}", (0.0, 0.0, 0.05 + 0.1 * k)) for k in range(3)]
    yield case("stack of three", boxes, [floor()])
    leaning = [replace(box, position=(0.03 * k, 0.0, 0.05 + 0.1 * k)) for k, box in enumerate(boxes)]
    yield case("stack of three that leans", leaning, [floor()])
    places = [(0.0, 0.0, RADIUS), (0.1, 0.0, RADIUS), (0.05, 0.0866, RADIUS), (0.05, 0.0289, RADIUS + 0.0816)]
    balls = [free(Sphere(RADIUS), f"ball{k}", place) for k, place in enumerate(places)]
    yield case("pyramid of balls falls apart", balls, [floor()], duration=0.3, friction=0.2)
    dominoes = [free(Box((0.01, 0.05, 0.1)), f"domino{k}", (0.04 * k, 0.0, 0.05), 0.05) for k in range(4)]
    yield case("dominoes", dominoes, [floor()], {"domino0": (0.3, 0.0, 0.0, 0.0, 6.0, 0.0)})


# ---------------------------------------------------------------------------------------------- robots


def robots() -> Iterator[Case]:
    """Yield arms that strike, push and meet themselves, and humanoids that kick and fall."""
    from ..envs.kick import kick_scene  # needs Gymnasium

    hanging = load_robot("humanoid", base="fixed", locked="simplified")
    foot = [link.name for link in hanging.links].index("right_foot")
    x, y, z = link_poses(hanging, np.zeros(hanging.nq)).position[foot]
    ball = free(Sphere(RADIUS), "ball", (x + 0.2, y, z), 0.2)
    raised = Reference([0.0], [[0.5 if "hip_front" in name else 0.0 for name in hanging.joint_names]])
    for gearbox in ("mipsd", "rotor"):
        members = Placed(hanging, "robot"), ball
        scene = compile_scene(SceneModel("scene", members), gearbox, pairs="all", gravity=WEIGHTLESS)
        yield of_scene(f"a hanging leg strikes a ball, {gearbox}", ROBOTS, scene, 0.5, None, raised)
    scene = compile_scene(hanging, pairs="all")
    inward = [{"left_hip_lateral": -3.0, "right_hip_lateral": 3.0}.get(name, 0.0) for name in hanging.joint_names]
    start = initial_state(scene, None, {"humanoid": inward})
    yield Case("hanging legs fall against each other", ROBOTS, scene, 0.5, start)
    kick = kick_scene().recompiled(integrator=None, timestep=None)
    signal = Reference([0.0], [[0.0] * kick.tree.n])
    yield Case("a humanoid stands before a ball", ROBOTS, kick, 0.3, initial_state(kick), signal)
    humanoid = load_robot("humanoid", locked="simplified")
    scene = compile_scene(humanoid, "mipsd", Ground(), pairs="all", fall_height=-1e6, fall_tilt=4.0)
    signal = Reference([0.0], [[0.0] * scene.tree.n])
    high = [0.0, 0.0, 0.4, math.cos(0.6), 0.0, math.sin(0.6), 0.0, *[0.0] * scene.tree.n]
    start = initial_state(scene, {"humanoid": high})
    yield Case("a humanoid falls on its arms", ROBOTS, scene, 0.5, start, signal)
    shot = free(Sphere(RADIUS), "ball", (-0.5, 0.0, 0.3), 0.1)
    scene = compile_scene(SceneModel("scene", (Placed(humanoid, "robot"), shot), (), Ground()), "mipsd", pairs="all")
    yield of_scene("a ball hits a humanoid", ROBOTS, scene, 0.5, {"ball": (4.0,)}, signal)


# ---------------------------------------------------------------------------------------------- files of others


THINGS = (
    "soccerball.urdf", "duck_vhacd.urdf", "teddy_vhacd.urdf", "lego/lego.urdf", "domino/domino.urdf",
    "jenga/jenga.urdf", "objects/mug.urdf", *(f"random_urdfs/{k}/{k}.obj" for k in ("000", "101", "202", "303")),
)  # fmt: skip
ARMS = ("kuka_iiwa/model.urdf", "franka_panda/panda.urdf", "xarm/xarm6_with_gripper.urdf")
WALKERS = ("laikago/laikago.urdf", "mini_cheetah/mini_cheetah.urdf")
SCENES = {
    "gymnasium": ("envs/mujoco/assets/pusher.xml", "envs/mujoco/assets/humanoid.xml"),
    "dm_control": tuple(f"suite/{name}.xml" for name in ("ball_in_cup", "hopper", "swimmer")),
}


def of_others(skipped: list[str]) -> Iterator[Case]:
    """Yield objects of pybullet_data on a table, its robots on themselves or objects, and scenes of other packages."""
    places = {name: package(name) for name in ("pybullet_data", *SCENES)}
    skipped.extend(f"pairs: {name} is not installed" for name, place in places.items() if place is None)
    makers: list[tuple[str, Callable[[], Case]]] = []
    data = places.pop("pybullet_data")
    if data is not None:
        makers += [(name, partial(on_a_table, data / name)) for name in THINGS]
        makers += [(name, partial(limp, data / name)) for name in ARMS]
        makers += [(name, partial(dropped, data / name)) for name in WALKERS]
    for package_name, place in places.items():
        if place is not None:
            makers += [(name, partial(described, place / name)) for name in SCENES[package_name]]
    for name, make in makers:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", RobotFileWarning)
                warnings.simplefilter("ignore", OverlapWarning)
                yield make()
        except (ValueError, ImportError, OSError) as error:
            skipped.append(f"pairs: {name}: {str(error).splitlines()[0][:110]}")


def package(name: str) -> Path | None:
    spec = importlib.util.find_spec(name)
    return Path(next(iter(spec.submodule_search_locations or ()))) if spec else None


def on_a_table(path: Path) -> Case:
    """Drop the thing, turned, on a block."""
    mesh = path.suffix == ".obj"
    thing = body(Mesh(str(path)), 0.2, name=path.stem) if mesh else load_robot(path, base="floating")
    reach = 0.05 + max(math.hypot(*row.r) + float(row.bound) for row in shape_table(thing).table)
    members = (Placed(thing, "thing", (0.0, 0.0, reach), (0.9, 0.1, 0.3, 0.2)),)
    block = fixed(Box((10.0 * reach, 10.0 * reach, reach)), "block", (0.0, 0.0, -0.5 * reach))
    scene = compile_scene(SceneModel("scene", members, (block,)), pairs="all")
    return of_scene(f"{path.stem} falls on a block", OTHERS, scene, 0.5)


def limp(path: Path) -> Case:
    """Let an arm fall, on itself and on a ball."""
    arm = load_robot(path, base="fixed")
    ball, low = free(Sphere(0.1), "ball", (0.4, 0.0, -0.4), 0.5), fixed(Box(FLOOR), "floor", (0.0, 0.0, -0.6))
    scene = compile_scene(SceneModel("scene", (Placed(arm, "arm"), ball), (low,)), pairs="all")
    joints = arm.moving_joints
    lower, upper = ([min(max(edge, -2.0), 2.0) for edge in edges] for edges in
                    ([joint.lower for joint in joints], [joint.upper for joint in joints]))  # fmt: skip
    q = [0.3 * a + 0.7 * b for a, b in zip(lower, upper)]
    return Case(f"{path.parent.name} falls on a ball", OTHERS, scene, 0.4, initial_state(scene, {"arm": q}))


def dropped(path: Path) -> Case:
    """Drop a limp robot on the floor and on itself."""
    robot = load_robot(path, base="floating")
    scene = compile_scene(SceneModel("scene", (Placed(robot, "robot", (0.0, 0.0, 0.6)),), (floor(),)), pairs="all")
    return of_scene(f"{path.stem} falls on a floor", OTHERS, scene, 0.4)


def described(path: Path) -> Case:
    """Start a scene of a file as it stands, limp."""
    scene = compile_scene(load_scene(path), pairs="all")
    starts = {}
    for member in scene.members:
        base = [*member.placed.position, *member.placed.orientation] if member.model.base == "floating" else []
        near = [min(max(0.0, joint.lower), joint.upper) for joint in member.model.moving_joints]
        starts[member.name] = [*base, *near]
    return Case(f"{path.stem} as its file has it", OTHERS, scene, 0.4, initial_state(scene, starts))
