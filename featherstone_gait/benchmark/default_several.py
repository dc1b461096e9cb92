"""Scenes of several bodies of `benchmark default`, each with the numbers of five seeds, and single bodies beside them.

Durations end before small differences have grown too far: three boxes that fall on each other are judged for 0.3 s.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..dynamics.inverse_kinematics import close_loops
from ..geometry.body import body
from ..model import Ground, Joint, Link, Loop, Model, Tendon
from ..model.pair_contact import PairContact
from ..model.placed import Placed, SceneModel
from ..model.shapes import Box, Capsule, Cylinder, Geometry, Shape, Sphere
from ..robot_file import load_robot
from ..robot_file.scene import load_scene
from ..run.reference import Reference
from ..run.simulate import initial_state
from ..scene.compile import compile_scene
from .case import Case
from .pair_scenes import RADIUS, fixed, floor, free, of_scene
from .table import installed

COMPANY = "company"  # first word of the kinds
SEEDS = 5
CUBE = Box((0.1, 0.1, 0.1))  # [m]
X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
ON_SIDE = (math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0)  # an axis along z lies along y
SLOPE = """<mujoco><option timestep="0.001"/><worldbody>
<geom name="slope" type="box" size="2 2 .1" euler="0 {angle:.6f} 0" pos="{low:.9f} 0 {deep:.9f}" friction="{mu:.6f}"/>
{boxes}</worldbody></mujoco>"""
ON_SLOPE = """<body name="box{k}" pos="{x:.9f} {y:.9f} {z:.9f}" euler="0 {angle:.6f} 0"><freejoint/>
<geom type="box" size=".06 .05 .04" mass="{mass:.6f}" friction="{mu:.6f}"/></body>"""

Maker = Callable[[np.random.Generator], Iterator[Case]]
Where = Mapping[str, Sequence[float]]  # positions or velocities by member


def several_cases(skipped: list[str]) -> Iterator[Case]:
    """Yield the scenes of several and of one, each by all seeds; skipped: takes what is left out, and why."""
    makers: Sequence[Maker] = (objects, slopes, alone, trees, ties, humanoids)
    if not installed("mujoco"):
        skipped.append("company: boxes on slopes need MuJoCo, which reads MJCF")
        makers = tuple(maker for maker in makers if maker is not slopes)
    for maker in makers:
        for seed in range(SEEDS):
            for case in maker(np.random.default_rng(seed)):
                yield case._replace(name=f"{case.name}, seed {seed}")


# ---------------------------------------------------------------------------------------------- parts


def scene_of(
    name: str, members: Sequence[Placed], obstacles: Sequence[Placed], qd: Where | None = None, q: Where | None = None,
    *, duration: float = 0.4, kind: str = "objects", **law: Any,
) -> Case:  # fmt: skip
    """Make a case of members that touch all that they can; law: fields of `PairContact`."""
    scene = compile_scene(SceneModel("scene", tuple(members), (*obstacles, far())), pairs=PairContact(**law))
    kind = f"{COMPANY}, {kind if len(members) > 1 else 'one alone'}"
    case = of_scene(name, kind, scene, duration, qd)
    return case if q is None else case._replace(state=initial_state(scene, q, qd))


def jointed(
    name: str, shape: Geometry, place: Sequence[float], mass: float = 1.0, arm: Sequence[float] = (0.0, 0.0, 0.0),
    kind: str = "continuous", **joint: Any,
) -> Placed:  # fmt: skip
    """Hang a solid of one shape on a joint (about y unless an axis is given), its center at `arm` [m]."""
    return Placed(tree(name, [(shape, mass, arm, kind, (0.0, 0.0, 0.0), joint)]), name, tuple(place))


def tree(name: str, parts: Sequence[tuple], base: Link | None = None, **more: Any) -> Model:
    """Make a chain of solids on joints: (shape, mass, center, kind of joint, its place on the one before, more)."""
    links, joints, shapes = [base or Link("base")], [], []
    for k, (shape, mass, arm, kind, at, joint) in enumerate(parts):
        links.append(replace(body(shape, mass).links[0], name=f"part{k}", center_of_mass=tuple(arm)))
        how = {"axis": Y, "parent": links[k].name} | joint
        joints.append(Joint(name=f"joint{k}", type=kind, child=f"part{k}", xyz=at, **how))
        shapes.append(Shape(f"part{k}", shape, tuple(arm)))
    return Model(name, tuple(links), tuple(joints), shapes=tuple(shapes), **more)


def far() -> Placed:
    """Return a cylinder that nothing touches, so that tables of shapes are alike and all objects run one kernel."""
    return fixed(Cylinder(0.1, 0.1), "far", (0.0, 0.0, -40.0))


def keeper() -> Placed:
    """Return what rests far away with a stop, a spring and a damper, so that all scenes of trees run one kernel."""
    sprung: dict[str, Any] = {"lower": -1.0, "upper": 1.0, "stiffness": 1.0, "damping": 0.1}
    return jointed("keeper", Sphere(RADIUS), (0.0, 0.0, -20.0), kind="revolute", **sprung)


def on_side(placed: Placed) -> Placed:
    return replace(placed, orientation=ON_SIDE)


def cart(name: str, place: Sequence[float], mass: float) -> Placed:
    """Place a floating box on four wheels, whose axles are 8 cm above what they stand on."""
    chassis = replace(body(Box((0.5, 0.2, 0.06)), mass).links[0], name="base")
    at = [(x, y, -0.02) for x in (-0.18, 0.18) for y in (-0.16, 0.16)]
    wheels = [(Sphere(0.06), 0.3, (0.0, 0.0, 0.0), "continuous", one, {"parent": "base"}) for one in at]
    model = replace(tree(name, wheels, chassis), base="floating")
    return Placed(replace(model, shapes=(*model.shapes, Shape("base", Box((0.5, 0.2, 0.06))))), name, tuple(place))


# ---------------------------------------------------------------------------------------------- objects


def objects(rng: np.random.Generator) -> Iterator[Case]:
    """Yield free bodies on each other and on obstacles."""
    u, ball, ground = rng.uniform, Sphere(RADIUS), [floor()]

    def stack(masses: Sequence[float], gap: float = 1e-3) -> list[Placed]:
        return [free(CUBE, f"box{k}", (u(-0.02, 0.02), u(-0.02, 0.02), 0.05 + (0.1 + gap) * k), mass)
                for k, mass in enumerate(masses)]  # fmt: skip

    yield scene_of("stack of three", stack(u(0.3, 3.0, 3).tolist()), ground)
    yield scene_of("stack of five", stack(u(0.3, 3.0, 5).tolist()), ground)
    yield scene_of("heavy on light", stack([0.1, u(5.0, 50.0)]), ground)
    yield scene_of("heavy on light on heavy", stack([10.0, u(0.05, 0.2), u(5.0, 20.0)]), ground)
    low = [(0.0, 0.0, RADIUS), (0.101, 0.0, RADIUS), (0.05, 0.088, RADIUS), (0.05, 0.029, RADIUS + 0.0826)]
    pile = [free(ball, f"ball{k}", np.add(place, u(0.0, 1e-3, 3)).tolist(), u(0.5, 2.0)) for k, place in enumerate(low)]
    yield scene_of("pile of balls", pile, ground, duration=0.3, friction=u(0.1, 0.4))
    heap = [free(ball, f"ball{k}", (0.06 * (k % 2), u(-0.01, 0.01), 0.06 + 0.11 * k)) for k in range(4)]
    yield scene_of("balls fall onto a heap", heap, ground, duration=0.35)
    for name, ratio in (("lossless", 0.0), ("lossy", u(0.1, 0.7))):
        pair = [free(ball, "first", (0.0, 0.0, 0.0)), free(ball, "second", (0.15, 0.0, 0.0), u(0.1, 10.0))]
        speeds = {"first": (u(0.5, 3.0),)}
        yield scene_of(f"two balls meet, {name}", pair, [], speeds, damping_ratio=ratio)
    pair = [free(ball, "first", (0.0, 0.0, 0.0)), free(ball, "second", (0.09, u(0.0, 0.02), 0.06), u(0.3, 3.0))]
    spin = {"first": (u(1.0, 3.0), 0.0, 0.0, 0.0, u(-20.0, 20.0), 0.0)}
    yield scene_of("two balls meet askew", pair, [], spin, friction=u(0.1, 0.9))
    rack = [free(ball, f"ball{k}", (0.1 * math.cos(a) * d, 0.1 * math.sin(a) * d * 1.02, 0.0495))
            for k, (a, d) in enumerate(((0.0, 0.0), (0.53, 1.02), (-0.53, 1.03)))]  # fmt: skip
    cue = free(ball, "cue", (-0.2, u(-0.02, 0.02), 0.0495))
    yield scene_of("billiards", [cue, *rack], ground, {"cue": (u(1.0, 3.0),)}, friction=0.3)
    rolling = {"cue": (u(0.5, 1.5), 0.0, 0.0, 0.0, u(0.0, 30.0), 0.0)}
    yield scene_of("a ball rolls into one", [cue, rack[0]], ground, rolling, friction=0.2, damping_ratio=0.3)
    gap = u(0.035, 0.05)
    dominoes = [free(Box((0.01, 0.05, 0.1)), f"domino{k}", (gap * k, u(-0.01, 0.01), 0.0499), 0.05) for k in range(3)]
    yield scene_of("dominoes", dominoes, ground, {"domino0": (0.3, 0.0, 0.0, 0.0, u(4.0, 6.0), 0.0)}, duration=0.15)
    wall = [fixed(Box((u(0.01, 0.05), 1.0, 1.0)), "wall", (0.6, 0.0, 0.0))]
    shots = [free(Sphere(0.02), f"ball{k}", (-0.1 * k, 0.2 * k, 0.2), u(0.05, 0.5)) for k in range(3)]
    fast = {f"ball{k}": (u(20.0, 80.0),) for k in range(3)}
    yield scene_of("fast balls at a wall", shots, wall, fast, duration=0.1, damping_ratio=0.3)
    row = [free(ball, f"ball{k}", (0.1005 * k + u(0.0, 4e-4), 0.0, 0.0)) for k in range(5)]
    yield scene_of("a ball at a row of four", row, [], {"ball0": (u(0.5, 2.0),)}, damping_ratio=0.05)
    boxes = [free(CUBE, f"box{k}", (u(-0.05, 0.05), u(-0.05, 0.05), 0.12 + 0.16 * k), u(0.5, 2.0), u(-0.6, 0.6))
             for k in range(3)]  # fmt: skip
    yield scene_of("three boxes fall", boxes, ground, duration=0.3)
    rod = on_side(free(Capsule(0.03, 0.3), "rod", (0.0, 0.0, 0.25), u(0.5, 2.0)))
    yield scene_of("a rod falls across a box", [rod, free(CUBE, "box", (u(-0.02, 0.02), 0.03, 0.0498))], ground)
    yield from carried_and_rolling(rng)


def carried_and_rolling(rng: np.random.Generator) -> Iterator[Case]:
    """Yield free bodies that carry, roll, spin and fall across edges."""
    u, ball, ground = rng.uniform, Sphere(RADIUS), [floor()]
    plank = free(Box((0.8, 0.15, 0.02)), "plank", (0.0, 0.0, 0.1097), u(1.0, 3.0))
    roll = on_side(fixed(Cylinder(0.1, 0.5), "roll", (0.0, 0.0, 0.0)))
    ends = [free(ball, f"ball{k}", (0.3 * side, 0.0, 0.18 + u(0.0, 0.05)), u(0.2, 1.0)) for k, side in
            enumerate((-1, 1))]  # fmt: skip
    yield scene_of("a plank balances on a roll under two balls", [plank, *ends], [roll], duration=0.3)
    yield scene_of("a ball is thrown at a box", [free(ball, "ball", (-0.4, u(-0.03, 0.03), 0.08), 0.5),
                   free(CUBE, "box", (0.0, 0.0, 0.0499))], ground, {"ball": (u(2.0, 6.0),)})  # fmt: skip
    big = free(Sphere(0.1), "big", (0.0, 0.0, 0.25), 1.0)
    small = free(Sphere(0.03), "small", (u(0.0, 2e-3), 0.0, 0.39), u(0.02, 0.1))
    yield scene_of("a small ball bounces on a big one", [big, small], ground, damping_ratio=0.1)
    under = free(Box((0.6, 0.3, 0.02)), "plank", (0.0, 0.0, 0.0098), 2.0)
    load = free(CUBE, "box", (0.0, u(-0.05, 0.05), 0.0697), u(0.5, 3.0))
    yield scene_of("a plank is pulled from under a box", [under, load], ground, {"plank": (u(1.0, 2.0),)}, friction=0.3)
    bars = [on_side(fixed(Capsule(0.01, 0.6), f"bar{k}", (0.2 + 0.15 * k, 0.0, 0.0))) for k in range(2)]
    wheels = [on_side(free(Cylinder(0.08, 0.04), f"wheel{k}", (-0.1 * k, 0.2 * k - 0.1, 0.08), u(0.5, 2.0)))
              for k in range(2)]  # fmt: skip
    forward = {f"wheel{k}": (v, 0.0, 0.0, 0.0, 0.0, -v / 0.08) for k, v in enumerate(u(0.8, 1.6, 2))}
    yield scene_of("wheels roll over bars", wheels, [*ground, *bars], forward)
    tops = [top(f"top{k}", (0.3 * k, 0.0), u(0.1, 0.3)) for k in range(2)]
    spins = {f"top{k}": (0.0, 0.0, 0.0, 0.0, 0.0, u(60.0, 150.0)) for k in range(2)}
    yield scene_of("tops on a plate", tops, ground, spins, friction=0.5)
    shelf = [free(CUBE, "box", (u(0.03, 0.06), 0.0, 0.25)), free(ball, "ball", (0.0, 0.12, 0.4))]
    ledge = [*ground, fixed(Box((0.1, 0.4, 0.04)), "ledge", (0.0, 0.05, 0.1))]
    yield scene_of("a box and a ball fall across a ledge", shelf, ledge, duration=0.35)


def top(name: str, place: Sequence[float], lean: float) -> Placed:
    """Place a top at x and y [m] that leans by an angle [rad], on a tip of 5 mm which is 45 mm below its center."""
    link = Link("top", 0.2, (0.0, 0.0, 0.0), (1e-4, 0.0, 0.0, 1e-4, 0.0, 1.5e-4))
    tip = Shape("top", Sphere(5e-3), (0.0, 0.0, -0.045))
    turned = (math.cos(0.5 * lean), math.sin(0.5 * lean), 0.0, 0.0)
    at = (*place, 5e-3 - 2e-4 + 0.045 * math.cos(lean))
    return Placed(Model(name, (link,), (), "floating", shapes=(tip,)), name, at, turned)


def slopes(rng: np.random.Generator) -> Iterator[Case]:
    """Yield boxes on slopes of MJCF files, whose friction decides what they do."""
    for name, low, high in (("stick on", 0.7, 0.9), ("slide down", 0.05, 0.3)):
        angle, boxes = rng.uniform(20.0, 30.0), []
        slope = math.radians(angle)
        for k in range(2):
            along, above = 0.3 * k, 0.0399
            x, z = along * math.cos(slope) + above * math.sin(slope), above * math.cos(slope) - along * math.sin(slope)
            mu, mass = rng.uniform(low, high), rng.uniform(0.3, 3.0)
            boxes.append(ON_SLOPE.format(k=k, x=x, y=0.0, z=z, angle=angle, mass=mass, mu=mu))
        text = SLOPE.format(angle=angle, low=-0.1 * math.sin(slope), deep=-0.1 * math.cos(slope), mu=low,
                            boxes="\n".join(boxes))  # fmt: skip
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "slope.xml"
            path.write_text(text)
            described = load_scene(path)
        scene = compile_scene(replace(described, obstacles=(*described.obstacles, far())), pairs="all")
        yield of_scene(f"boxes {name} a slope of MJCF", f"{COMPANY}, objects", scene, 0.4)


# ---------------------------------------------------------------------------------------------- trees


def trees(rng: np.random.Generator) -> Iterator[Case]:
    """Yield jointed robots that touch each other, objects and their own stops."""
    u, ball = rng.uniform, Sphere(RADIUS)
    rest, ground = keeper(), [floor()]
    how: dict[str, Any] = {"kind": "trees"}
    bar, beside = Box((0.5, 0.04, 0.04)), free(ball, "beside", (0.0, 2.0, 1.0))
    pegs = [fixed(Sphere(0.01), f"peg{k}", (0.4 * math.cos(a), 0.4 * math.sin(a), 0.5), 0.0)
            for k, a in enumerate((u(0.6, 1.2), u(-2.0, -0.6)))]  # fmt: skip
    swing = jointed("bar", bar, (0.0, 0.0, 0.5), u(0.5, 2.0), (0.25, 0.0, 0.0), axis=Z)
    yield scene_of("a bar swings at pegs", [swing, beside, rest], pegs, {"bar": [u(5.0, 30.0)]}, **how)
    target = free(ball, "target", (0.3, 0.2, 0.52), u(0.2, 2.0))
    yield scene_of(
        "a bar swings at a ball", [swing, target, rest], ground, {"bar": [u(3.0, 10.0)]}, duration=0.3, **how
    )
    for name, masses, ratio in (
        ("Newton's cradle", [1.0] * 4, 0.0), ("two pendulums of unequal mass", u(0.2, 5.0, 2), 0.2),
    ):  # fmt: skip
        bobs = [jointed(f"bob{k}", ball, (0.1003 * k, 0.0, 0.5), mass, (0.0, 0.0, -0.3)) for k, mass in
                enumerate(masses)]  # fmt: skip
        raised = {"bob0": [u(0.3, 0.8)]}
        yield scene_of(name, [*bobs, beside, rest], ground, None, raised, duration=0.5, damping_ratio=ratio, **how)
    seesaw = jointed("seesaw", Box((0.8, 0.2, 0.02)), (0.0, 0.0, 0.3), 2.0, kind="revolute", lower=-0.3, upper=0.3)
    pair = [
        free(ball, f"ball{k}", (0.3 * side, 0.0, 0.36 + u(0.0, 0.1)), u(0.2, 2.0)) for k, side in enumerate((-1, 1))
    ]
    yield scene_of("balls on a seesaw", [seesaw, *pair, rest], ground, **how)
    grip: dict[str, Any] = {"kind": "prismatic", "axis": X, "stiffness": 400.0, "damping": 8.0}
    fingers = [jointed(f"finger{s:+d}", Box((0.02, 0.06, 0.1)), (0.062 * s, 0.0, 0.3), 0.2, spring_reference=-0.1 * s,
                       lower=-0.1, upper=0.1, **grip) for s in (-1, 1)]  # fmt: skip
    held = free(CUBE, "held", (0.0, 0.0, 0.3), u(0.1, 1.0))
    yield scene_of("two fingers hold a box", [*fingers, held, rest], ground, **how)
    lifted = free(ball, "held", (0.0, 0.0, 0.3), u(0.1, 0.4))
    yield scene_of("a gripper lifts a ball", [gripper(u(0.1, 0.3)), lifted, rest], ground, **how)
    string: list[tuple] = [
        (Sphere(0.03), 0.3, (0.0, 0.0, -0.08), "continuous", (0.0, 0.0, -0.08 * (k > 0)), {}) for k in range(4)
    ]
    chain = Placed(tree("chain", string), "chain", (0.0, 0.0, 0.8))
    tilt = {"chain": [u(0.5, 0.9), *u(-0.1, 0.1, 3)]}
    wall = fixed(Box((0.1, 1.0, 2.0)), "wall", (0.1, 0.0, 0.5))
    yield scene_of("a chain of balls swings at a wall", [chain, beside, rest], [wall], None, tilt, duration=0.35, **how)
    box = free(CUBE, "box", (-0.05, 0.0, 0.0499), u(0.2, 1.0))
    low = replace(chain, position=(0.0, 0.0, 0.4))
    yield scene_of("a chain of balls swings at a box", [low, box, rest], ground, None, tilt, duration=0.35, **how)
    yield from machines(rng, box)


def machines(rng: np.random.Generator, box: Placed) -> Iterator[Case]:
    """Yield jointed robots that carry, drive and throw; box: a free one."""
    u, ball = rng.uniform, Sphere(RADIUS)
    rest, ground = keeper(), [floor()]
    how: dict[str, Any] = {"kind": "trees"}
    bar, beside = Box((0.5, 0.04, 0.04)), free(ball, "beside", (0.0, 2.0, 1.0))
    stop: dict[str, Any] = {"kind": "revolute", "lower": -0.4, "upper": 0.4}
    bars = [jointed(f"bar{k}", bar, (0.0, 0.3 * k, 0.5), u(0.5, 2.0), (0.25, 0.0, 0.0), **stop) for k in range(2)]
    on = free(ball, "ball", (0.4, 0.0, 0.6), u(0.2, 1.0))
    yield scene_of(
        "bars fall into their stops, under a ball", [*bars, on, rest], ground, {"bar1": [u(0.0, 8.0)]}, **how
    )
    double = Placed(tree("double", [(ball, 1.0, (0.0, 0.0, -0.25), "continuous", (0.0, 0.0, -0.25 * k), {})
                                    for k in range(2)]), "double", (0.0, 0.0, 0.6))  # fmt: skip
    swings = {"double": [u(0.8, 1.2), u(-0.3, 0.3)]}
    box = replace(box, position=(0.0, 0.02, 0.0499))
    yield scene_of("a double pendulum hits a box", [double, box, rest], ground, None, swings, duration=0.35, **how)
    limbs: list[tuple] = [(Box((0.3, 0.05, 0.05)), u(0.5, 1.5), (0.15, 0.0, 0.0), "continuous", (0.3 * k, 0.0, 0.0), {})
             for k in range(2)]  # fmt: skip
    arms = [Placed(tree("left", limbs), "left", (-0.63, 0.0, 0.5)),
            Placed(tree("right", limbs), "right", (0.63, u(-0.03, 0.03), 0.55), (0.0, 0.0, 0.0, 1.0))]  # fmt: skip
    q = {"left": [u(-0.4, -0.2), 0.1], "right": [u(-0.4, -0.2), 0.1]}
    yield scene_of("two arms fall on each other", [*arms, beside, rest], ground, None, q, duration=0.35, **how)
    tray: dict[str, Any] = {"kind": "prismatic", "axis": X, "stiffness": 60.0, "damping": 2.0}
    shuttle = jointed("shuttle", Box((0.5, 0.3, 0.04)), (0.0, 0.0, 0.3), 3.0, spring_reference=u(0.05, 0.2), **tray)
    cargo = [
        free(CUBE, f"box{k}", (u(-0.02, 0.02), u(-0.02, 0.02), 0.3699 + 0.0999 * k), u(0.3, 2.0)) for k in range(2)
    ]
    yield scene_of("a shuttle carries two boxes", [shuttle, *cargo, rest], ground, **how)
    upward: dict[str, Any] = {"kind": "prismatic", "axis": Z, "stiffness": 800.0, "damping": 40.0}
    lift = jointed("lift", Box((0.5, 0.3, 0.04)), (0.0, 0.0, 0.3), 3.0, spring_reference=u(0.08, 0.12), **upward)
    yield scene_of("a lift raises two boxes", [lift, *cargo, rest], ground, **how)
    bumps = [on_side(fixed(Capsule(0.01, 0.8), f"bump{k}", (0.45 + 0.2 * k, 0.0, 0.0))) for k in range(2)]
    v = u(0.8, 1.6)
    rolls = cart("cart", (0.0, 0.0, 0.0798), u(2.0, 5.0))
    yield scene_of("a cart rolls over bars beside a ball", [rolls, beside, rest],
                   [*ground, *bumps], {"cart": [v, 0, 0, 0, 0, 0, *[v / 0.06] * 4]}, **how)  # fmt: skip
    carts = [cart("first", (-0.35, 0.0, 0.0798), 3.0), cart("second", (0.2, u(-0.05, 0.05), 0.0798), u(2.0, 8.0))]
    yield scene_of("two carts meet", [*carts, rest], ground, {"first": [v, 0, 0, 0, 0, 0, *[v / 0.06] * 4]}, **how)
    spring: dict[str, Any] = {
        "kind": "prismatic",
        "axis": Z,
        "stiffness": 300.0,
        "damping": 1.0,
        "lower": -0.2,
        "upper": 0.05,
    }
    pad = jointed("pad", Box((0.2, 0.2, 0.02)), (0.0, 0.0, 0.5), 0.5, **spring)
    thrown = free(ball, "ball", (u(-0.01, 0.01), 0.0, 0.41), u(0.2, 0.8))
    yield scene_of("a spring throws a ball", [pad, thrown, rest], ground, None, {"pad": [u(-0.19, -0.17)]}, **how)
    disc = jointed("disc", Cylinder(0.4, 0.04), (0.0, 0.0, 0.3), 5.0, axis=Z)
    riders = [free(CUBE, f"box{k}", (0.2 * side, 0.0, 0.3699), u(0.3, 2.0)) for k, side in enumerate((-1, 1))]
    yield scene_of("boxes on a turntable", [disc, *riders, rest], ground, {"disc": [u(2.0, 6.0)]}, friction=0.3, **how)


def gripper(up: float) -> Placed:
    """Place a carriage that a spring raises by so much [m], with two fingers that springs close."""
    close: dict[str, Any] = {"axis": X, "stiffness": 400.0, "damping": 8.0, "parent": "part0"}
    parts = [(Box((0.3, 0.04, 0.04)), 1.0, (0.0, 0.0, 0.15), "prismatic", (0.0, 0.0, 0.0),
              {"axis": Z, "stiffness": 300.0, "damping": 20.0, "spring_reference": up})]  # fmt: skip
    for side in (-1.0, 1.0):
        parts.append((Box((0.02, 0.06, 0.14)), 0.2, (0.0, 0.0, 0.03), "prismatic", (0.061 * side, 0.0, 0.0),
                      close | {"spring_reference": -0.05 * side}))  # fmt: skip
    return Placed(tree("gripper", parts), "gripper", (0.0, 0.0, 0.3))


def ties(rng: np.random.Generator) -> Iterator[Case]:
    """Yield a robot with a tendon and one with a loop, beside others that they touch."""
    u, ball, ground = rng.uniform, Sphere(RADIUS), [floor()]
    limbs: list[tuple] = [(Box((0.3, 0.05, 0.05)), u(0.5, 1.5), (0.15, 0.0, 0.0), "continuous", (0.3 * k, 0.0, 0.0), {})
             for k in range(2)]  # fmt: skip
    cord = Tendon("cord", (("joint0", 0.05), ("joint1", -0.03)), (), u(500.0, 3000.0), 2.0)
    finger = Placed(replace(tree("finger", limbs), tendons=(cord,)), "finger", (0.0, 0.0, 0.3))
    target = free(ball, "ball", (u(0.3, 0.5), 0.0, 0.4), u(0.2, 1.0))
    yield scene_of("a finger with a tendon catches a ball", [finger, target, keeper()], ground, kind="ties")
    other = Placed(tree("plain", limbs), "plain", (0.0, 0.0, 0.5))
    yield scene_of("an arm falls on a finger with a tendon", [finger, other, target, keeper()], ground, None,
                   {"plain": [u(-0.1, 0.1), 0.0]}, duration=0.3, kind="ties")  # fmt: skip
    linkage = four_bar()
    q = close_loops(linkage, [u(0.6, 1.0), -1.2, -1.0], joints=["joint1", "joint2"]).tolist()
    member = Placed(linkage, "linkage", (0.0, 0.0, 0.6))
    falls = free(ball, "ball", (u(0.2, 0.4), 0.0, 1.2), u(0.2, 1.0))
    yield scene_of("a ball falls on a four-bar linkage", [member, falls, keeper()], ground, None, {"linkage": q},
                   duration=0.35, kind="ties")  # fmt: skip
    hung = jointed("bob", ball, (0.2, 0.0, 1.3), u(0.3, 2.0), (0.0, 0.0, -0.3))
    yield scene_of("a pendulum beside a four-bar linkage", [member, hung, falls, keeper()], ground, None,
                   {"linkage": q, "bob": [u(0.5, 1.0)]}, duration=0.35, kind="ties")  # fmt: skip


def four_bar() -> Model:
    """Return a crank of 0.2 m, a coupler of 0.5 m and a rocker of 0.4 m on a frame of 0.5 m, in three planes."""
    bars = ((0.2, 0.0, 0.0, "base"), (0.5, 0.05, 0.2, "part0"), (0.4, 0.1, 0.5, "base"))
    parts = [(Box((length, 0.03, 0.03)), length, (0.5 * length, y, 0.0), "continuous", (x, 0.0, 0.0), {"parent": of})
             for length, y, x, of in bars]  # fmt: skip
    pin = Loop("pin", "connect", "part1", "part2", (0.5, 0.0, 0.0), (0.4, 0.0, 0.0))
    return replace(tree("linkage", parts), loops=(pin,))


# ---------------------------------------------------------------------------------------------- humanoids


def humanoids(rng: np.random.Generator) -> Iterator[Case]:
    """Yield humanoids that stand on the ground, beside each other and beside a box that falls."""
    robot, u = load_robot("humanoid", locked="simplified"), rng.uniform
    two = [Placed(robot, f"robot{k}", (0.0, 0.6 * k)) for k in range(2)]
    box = free(CUBE, "box", (0.4, 0.0, u(0.06, 0.2)), u(0.5, 2.0), u(-0.3, 0.3))
    for name, members in (
        ("two humanoids stand", two), ("three humanoids stand", [*two, Placed(robot, "robot2", (0.0, -0.6))]),
        ("a humanoid stands beside a box that falls", [two[0], box]),
    ):  # fmt: skip
        scene = compile_scene(SceneModel("scene", tuple(members), (), Ground()), "mipsd", pairs="all")
        angles = Reference([0.0], u(-0.05, 0.05, (1, scene.tree.n)))
        case = of_scene(name, f"{COMPANY}, humanoids", scene, 0.2, None, angles)
        yield case


# ---------------------------------------------------------------------------------------------- single bodies


def alone(rng: np.random.Generator) -> Iterator[Case]:
    """Yield single bodies on obstacles, and single robots, in the ways of the above."""
    u, ball, ground, brick = rng.uniform, Sphere(RADIUS), [floor()], Box((0.2, 0.1, 0.06))
    yield scene_of("a box stands", [free(CUBE, "box", (0.0, 0.0, 0.051), u(0.3, 3.0))], ground)
    yield scene_of("a box falls askew", [free(brick, "box", (0.0, 0.0, 0.2), 1.0, u(0.1, 0.9))], ground)
    yield scene_of("a box is thrown", [free(brick, "box", (0.0, 0.0, 0.0299))], ground,
                   {"box": (u(0.5, 2.0), 0.0, 0.0, 0.0, 0.0, u(0.0, 6.0))}, friction=u(0.2, 0.6))  # fmt: skip
    yield scene_of("a box on a slope", [free(brick, "box", (0.0, 0.0, 0.0299), 1.0)], [floor(u(0.0, 0.02))],
                   {"box": (u(0.1, 0.5),)}, friction=u(0.2, 0.9))  # fmt: skip
    yield scene_of("a ball bounces", [free(ball, "ball", (0.0, 0.0, u(0.1, 0.3)))], ground, damping_ratio=u(0.0, 0.7))
    yield scene_of("a ball with spin", [free(ball, "ball", (0.0, 0.0, 0.0498))], ground,
                   {"ball": (1.0, 0.0, 0.0, 0.0, u(-40.0, 40.0), 0.0)}, friction=0.3)  # fmt: skip
    wall = [fixed(Box((u(0.01, 0.05), 1.0, 1.0)), "wall", (0.6, 0.0, 0.0))]
    yield scene_of("a fast ball at a wall", [free(Sphere(0.02), "ball", (0.0, 0.0, 0.2), 0.2)], wall,
                   {"ball": (u(20.0, 80.0),)}, duration=0.1, damping_ratio=0.3)  # fmt: skip
    yield scene_of("a rod falls", [free(Capsule(0.03, 0.3), "rod", (0.0, 0.0, 0.25), 1.0, u(0.3, 1.2))], ground)
    wheel = on_side(free(Cylinder(0.08, 0.04), "wheel", (0.0, 0.0, 0.08)))
    bar, v = on_side(fixed(Capsule(0.01, 0.6), "bar", (0.2, 0.0, 0.0))), u(0.8, 1.6)
    yield scene_of("a wheel rolls over a bar", [wheel], [*ground, bar], {"wheel": (v, 0.0, 0.0, 0.0, 0.0, -v / 0.08)})
    yield scene_of("a top on a plate", [top("top", (0.0, 0.0), u(0.1, 0.3))], ground,
                   {"top": (0.0, 0.0, 0.0, 0.0, 0.0, u(60.0, 150.0))}, friction=0.5)  # fmt: skip
    bars = [on_side(fixed(Capsule(0.01, 0.8), f"bump{k}", (0.45 + 0.2 * k, 0.0, 0.0))) for k in range(2)]
    yield scene_of("a cart rolls over bars", [cart("cart", (0.0, 0.0, 0.0798), u(2.0, 5.0))], [*ground, *bars],
                   {"cart": [v, 0, 0, 0, 0, 0, *[v / 0.06] * 4]}, kind="trees")  # fmt: skip
    yield scene_of("a cart is dropped", [cart("cart", (0.0, 0.0, u(0.1, 0.3)), u(2.0, 5.0))], ground, kind="trees")
