"""Scenes of `benchmark default`: published robots, servos and stops, free bodies, a humanoid."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any, get_args

import numpy as np

from ..dynamics.tree import GRAVITY, followed
from ..geometry.contact_choice import with_contacts
from ..model import Ground, Joint, Link, Model, Supply
from ..model.placed import Placed
from ..robot_file import load_robot, load_servo
from ..robot_file.servos import with_servo
from ..run.reference import Reference
from ..run.simulate import initial_state, simulate, standing_state
from ..scene.actuator import GearboxKind
from ..scene.compile import CompiledScene, compile_scene
from .case import Case, case_of
from .default_several import several_cases
from .pair_scenes import pair_cases
from .robots import folders, published
from .scenes import CENTER, NO_FALL, ball, box, humanoids, problems, stressed, unlimited

FREE_HEIGHT = 100.0  # height above a ground that is never touched [m]
WEAK = (0.0, 0.0, -1e-9)  # gravity, which a ground must have [m/s^2]
EVERY = 12  # robot that runs if not all do, and these:
CHOSEN = ("model_for_sdf", "talos_reduced", "xarm6_with_gripper", "centauro")
STEPS_EACH = 4  # random steps
SIXTY = Reference([0.0], [[math.pi / 3.0]])  # [rad]
PUNCH = 32 / 1023 * 10.0  # [V]
AX12_LAW: dict[str, Any] = {
    "compliance_margin": math.radians(0.29), "punch": PUNCH, "Kp": (10.0 - PUNCH) / math.radians(9.4),
    "pwm_steps": 1023.0, "duty_limit": 0.98,
}  # fmt: skip


def cases(
    full: bool = False, robots: Sequence[Path] | None = None, skipped: list[str] | None = None, only: str = ""
) -> Iterator[Case]:
    """Yield all scenes; full: those of all robots and the long ones too; skipped: takes what is left out, and why.

    only: "servos", "bodies", "company", "pairs" or "robots", for these alone.
    """
    places, skipped = folders() if robots is None else robots, [] if skipped is None else skipped
    makers: dict[str, Callable[[], Iterator[Case]]] = {
        "servos": lambda: chain(servo_cases(), step_cases(), friction_cases(), firmware_cases()),
        "bodies": lambda: chain(
            free_cases(), humanoid_cases(full), company_cases(), known_cases(), long_cases() if full else ()
        ),
        "company": lambda: several_cases(skipped),
        "pairs": lambda: pair_cases(skipped),
        "robots": lambda: robot_cases(full, places, skipped),
    }
    if only and only not in makers:
        raise ValueError(f"only: there is no group of scenes {only!r}; there are {', '.join(makers)}")
    for name in [only] if only else makers:
        yield from makers[name]()


# ---------------------------------------------------------------------------------------------- robots


def robot_cases(full: bool, places: Sequence[Path], skipped: list[str]) -> Iterator[Case]:
    """Yield a second of each robot, limp, from a random posture, with and without stops; some float, some fall."""
    if not places:
        skipped.append("published robots: none of example-robot-data, pybullet_data, mani_skill is installed")
    for k, (name, model) in enumerate(published(places, skipped)):
        if full or k % EVERY == 0 or any(chosen in name for chosen in CHOSEN):
            yield from _of_robot(name, model, k, skipped)


def _of_robot(name: str, model: Model, k: int, skipped: list[str]) -> Iterator[Case]:
    makers = [lambda: swinging(name, model, "stops"), lambda: swinging(name, unlimited(model), "no stops")]
    if k % 3 == 0:
        makers.append(lambda: floating(name, model, weightless=k % 2 == 0))
    if k % 4 == 0:
        makers.append(lambda: dropped(name, model))
    for make in makers:
        try:
            yield make()
        except (ValueError, ImportError) as error:
            skipped.append(f"{name}: {str(error).splitlines()[0][:110]}")


def swinging(name: str, model: Model, stops: str) -> Case:
    """Release the robot at rest."""
    scene = compile_scene(model)
    q = posture(scene, name)
    base = [0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0] if model.base == "floating" else []
    return case_of(f"{name}, {stops}", f"robots, {stops}", scene, 1.0, [*base, *q], None)


def floating(name: str, model: Model, weightless: bool) -> Case:
    """Throw the robot, weightless or falling freely."""
    model = replace(model, base="floating")
    scene = compile_scene(model, gravity=(0.0, 0.0, 0.0)) if weightless else compile_scene(model)
    v = np.random.default_rng(zlib.crc32(name.encode())).normal(size=model.nv)
    v[6:] = 0.0
    q = [0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, *posture(scene, name)]
    return case_of(f"{name}, {'weightless' if weightless else 'falling'}", "robots, floating", scene, 1.0, q, v)


def dropped(name: str, model: Model) -> Case:
    """Drop the robot to the ground."""
    model = with_contacts(replace(model, base="floating", contacts=()), "all")
    scene = compile_scene(model, ground=Ground(), **NO_FALL)
    return case_of(f"{name}, on the ground", "robots, ground", scene, 1.0, None, None)


def posture(scene: CompiledScene, name: str) -> np.ndarray:
    """Draw joint positions (n,) within the limits [rad or m], always the same for a name."""
    joints = scene.model.moving_joints
    far = [0.3 if joint.type == "prismatic" else math.pi for joint in joints]
    lower = [max(joint.lower, -reach) for joint, reach in zip(joints, far)]
    upper = [min(joint.upper, reach) for joint, reach in zip(joints, far)]
    rng = np.random.default_rng(zlib.crc32(name.encode()))
    return followed(scene.tree.coupling, rng.uniform(lower, np.maximum(lower, upper)))


# ---------------------------------------------------------------------------------------------- servos


def servo_cases() -> Iterator[Case]:
    """Yield one servo: thrown into its stop, a step of 60 degrees, a reference that it cannot follow."""
    arm = load_robot("ax12_arm")
    thrown: Sequence[tuple[float, GearboxKind]] = (
        (6.0, "mipsd"), (10.0, "mipsd"), (30.0, "mipsd"), (60.0, "mipsd"), (60.0, "rotor"),
    )  # fmt: skip
    for speed, gearbox in thrown:
        scene = compile_scene(arm, gearbox=gearbox)
        yield case_of(f"{gearbox}, into its stop at {speed:g} rad/s", "servos", scene, 0.5, [3.0], [speed])
    t = np.linspace(0.0, 1.0, 101)
    fast = Reference(t, np.sin(4.0 * math.pi * t)[:, None])
    for gearbox in get_args(GearboxKind):
        scene = compile_scene(arm, gearbox=gearbox)
        yield case_of(f"{gearbox}, step of 60 degrees", "servos", scene, 1.0, [0.0], None, reference=SIXTY)
        yield case_of(f"{gearbox}, reference too fast", "servos", scene, 1.0, [0.0], None, reference=fast)


def step_cases() -> Iterator[Case]:
    """Yield steps to random angles: of seven servos at once, and of servos that read their angles in counts."""
    arm, seven = load_robot("ax12_arm"), load_robot("arm7")
    scenes = {
        "seven servos, mipsd": compile_scene(seven, "mipsd"),
        "seven servos, rotor": compile_scene(seven, "rotor"),
        "seven xm430": compile_scene(with_servo(seven, "xm430"), "rotor"),
        "ax12a": compile_scene(with_servo(arm, "ax12a"), "rotor"),
        "ax12a, mipsd": compile_scene(with_servo(arm, "ax12a"), "mipsd"),
        "AX-12's law": compile_scene(with_servo(arm, "ax12", **AX12_LAW), "rotor"),
    }
    for name, scene in scenes.items():
        rng, n = np.random.default_rng(zlib.crc32(name.encode())), scene.tree.n
        for k in range(STEPS_EACH):
            target = Reference([0.0], rng.uniform(-0.8, 0.8, (1, n)))
            yield case_of(f"{name}, random step {k}", "random steps", scene, 1.0, [0.0] * n, None, reference=target)


def friction_cases() -> Iterator[Case]:
    """Yield servos with richer friction models: a step, a slow ramp with stick-slip, a fall."""
    arm = load_robot("ax12_arm")
    mx64 = load_servo("mx64")
    richer = {"motor_load_friction": 0.3115, "stribeck_motor_load": 0.1877, "stribeck_external_load": 0.01407}
    square = {"quadratic_motor_load": 0.0069, "quadratic_external_load": 0.01}
    ramp = Reference([0.0, 2.0], [[0.0], [0.4]])
    for name, servo in {
        "M1 (xl320)": load_servo("xl320"),
        "M4 (mx64)": mx64,
        "M4 (xl330)": load_servo("xl330"),
        "M6 (mx64)": replace(mx64, gearbox=replace(mx64.gearbox, **richer, **square)),
    }.items():
        scene = compile_scene(replace(arm, servos=dict.fromkeys(arm.servos, servo)), "rotor")
        yield case_of(f"{name}, step of 60 degrees", "friction", scene, 1.0, [0.0], None, reference=SIXTY)
        yield case_of(f"{name}, slow ramp", "friction", scene, 2.0, [0.0], None, reference=ramp)
        limp = dict.fromkeys(arm.servos, replace(servo, current_limit=1e-9))
        scene = compile_scene(replace(arm, servos=limp), "rotor")
        yield case_of(f"{name}, let go", "friction", scene, 1.0, [1.2], [-3.0])


def firmware_cases() -> Iterator[Case]:
    """Yield the AX-12's firmware, with profile and delay, and seven of them on a weak battery."""
    arm = load_robot("ax12_arm")
    for name, more in {
        "AX-12's law": {},
        "AX-12's law, profile of 2 rad/s": {"profile_speed": 2.0},
        "AX-12's law, 3 ms late": {"delay": 3e-3},
    }.items():
        scene = compile_scene(with_servo(arm, "ax12", **AX12_LAW, **more), "rotor")
        yield case_of(f"{name}, step of 60 degrees", "firmware", scene, 1.0, [0.0], None, reference=SIXTY)
    scene = compile_scene(replace(load_robot("arm7"), supply=Supply(11.1, 0.3)), "mipsd")
    raised = Reference([0.0], np.full((1, 7), 0.3))
    yield case_of("arm7 on 11.1 V and 0.3 Ohm, raised", "firmware", scene, 1.0, [0.0] * 7, None, reference=raised)


# ---------------------------------------------------------------------------------------------- free bodies


def free_cases() -> Iterator[Case]:
    """Yield bodies that spin and fall far above the ground, and balls that bounce on it."""
    for speed in (5.0, 50.0, 200.0):
        yield spinning(f"box at {speed:g} rad/s", speed, 1.0)
    humanoid = load_robot("humanoid", locked="simplified")
    n = len(humanoid.joint_names)
    turning = [0.0, 0.0, 0.0, 6.0, 6.0, 5.3, *[0.0] * n]  # 10 rad/s
    high = [0.0, 0.0, FREE_HEIGHT, 1.0, 0.0, 0.0, 0.0, *[0.0] * n]
    ways: Sequence[tuple[GearboxKind | None, tuple]] = (("mipsd", WEAK), (None, WEAK), ("mipsd", GRAVITY))
    for gearbox, gravity in ways:
        scene = compile_scene(humanoid, gearbox, Ground(), gravity=gravity, **NO_FALL)
        how = f"{'limp' if gearbox is None else gearbox}, {'weightless' if gravity is WEAK else 'falling'}"
        yield case_of(f"humanoid tumbling, {how}", "free bodies", scene, 2.0, high, turning)
    for ratio in (0.0, 0.1, 0.7):
        scene = compile_scene(ball(), None, Ground(damping_ratio=ratio), **NO_FALL)
        start = [0.0, 0.0, 0.1, 1.0, 0.0, 0.0, 0.0]
        yield case_of(f"ball dropped by 50 mm, damping ratio {ratio:g}", "free bodies", scene, 0.5, start, None)
    for name, speed in (("top, slow", 60.0), ("top, fast", 300.0)):
        scene = compile_scene(top())
        yield case_of(name, "ball joints", scene, 2.0, [math.cos(0.2), math.sin(0.2), 0.0, 0.0], [0.0, 0.0, speed])
    scene = compile_scene(hung())
    start = [math.cos(0.5), math.sin(0.5), 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
    yield case_of("two bars on ball joints", "ball joints", scene, 2.0, start, [0.0, 1.0, 2.0, 0.0, 0.0, 1.0])
    yield case_of("wheel at 1000 rad/s", "free bodies", compile_scene(wheel()), 10.0, None, [1000.0])


def spinning(name: str, speed: float, duration: float, **more: Any) -> Case:
    """Spin the box about no principal axis, far above the ground."""
    scene = compile_scene(box(), None, Ground(), gravity=WEAK, **NO_FALL)
    turning = [0.0, 0.0, 0.0, 0.6 * speed, 0.0, 0.8 * speed]
    return case_of(name, "free bodies", scene, duration, [0.0, 0.0, FREE_HEIGHT, 1.0, 0.0, 0.0, 0.0], turning, **more)


def top() -> Model:
    """Return a top of 0.1 kg on its tip, 3 cm below its center."""
    links = (Link("base"), Link("top", 0.1, (0.0, 0.0, 0.03), (2e-5, 0.0, 0.0, 2e-5, 0.0, 3e-5)))
    return Model("top", links, (Joint("tip", "ball", "base", "top"),))


def hung() -> Model:
    """Return two bars of 0.3 m, hung at ball joints one below the other."""
    bars = (Link(name, 0.5, (0.0, 0.0, -0.15), (4e-3, 0.0, 0.0, 4e-3, 0.0, 1e-4)) for name in ("upper", "lower"))
    joints = (
        Joint("shoulder", "ball", "base", "upper"),
        Joint("elbow", "ball", "upper", "lower", (0.0, 0.0, -0.3)),
    )
    return Model("bars", (Link("base"), *bars), joints)


def wheel() -> Model:
    links = (Link("base"), Link("wheel", 1.0, CENTER, (1e-3, 0.0, 0.0, 1e-3, 0.0, 2e-3)))
    return Model("wheel", links, (Joint("axle", "continuous", "base", "wheel", axis=(0.0, 0.0, 1.0)),))


# ---------------------------------------------------------------------------------------------- humanoid


def humanoid_cases(full: bool) -> Iterator[Case]:
    """Yield the humanoid standing, walking, and falling over with fall detection and without; full: a walk of 4 s."""
    from ..optimize.planning import walking_cost

    yield from humanoids()
    cost = walking_cost(load_robot("humanoid", locked="simplified"))
    signal = cost.reference(cost.gait.to_vector(), 6)
    still = Reference([0.0], signal.values[:1])
    for name, falls in (("fall detection", {}), ("no fall detection", NO_FALL)):
        scene = compile_scene(cost.scene.model, "mipsd", Ground(), **falls)
        q = np.concatenate([[0.0, 0.0, 0.0, math.cos(0.2), 0.0, math.sin(0.2), 0.0], still.values[0]])
        q[2] = standing_state(scene, still.values[0])[scene.layout["base_q"] + 2] + 0.03
        yield case_of(f"humanoid falls over, {name}", "humanoid", scene, 1.0, q, None, reference=still)
    if full:
        scene = compile_scene(cost.scene.model, "mipsd", Ground())
        yield Case("humanoid, walking 4 s", "humanoid", scene, 4.0, standing_state(scene, still.values[0]), signal)


def company_cases() -> Iterator[Case]:
    """Yield scenes of several: a robot that stands beside a ball that falls, and an arm beside one that rolls."""
    robot, arm = (load_robot(name) for name in ("humanoid", "arm7"))
    falling, rolling = (Placed(ball(), "ball", place) for place in ((3.0, 0.0, 0.15), (3.0, 0.0)))
    scene = compile_scene([Placed(robot, "robot"), falling], "mipsd", Ground(damping_ratio=0.1), **NO_FALL)
    still = Reference([0.0], np.zeros((1, scene.tree.n)))
    yield Case("a robot stands beside a ball that falls", "company", scene, 0.5, initial_state(scene), still)
    scene = compile_scene([Placed(arm, "arm"), rolling], "mipsd", Ground(slope=0.1), **NO_FALL)
    raised = Reference([0.0], np.full((1, 7), 0.3))
    yield Case("an arm raises itself beside a ball that rolls", "company", scene, 1.0, initial_state(scene), raised)


def long_cases() -> Iterator[Case]:
    """Yield ten minutes of standing, and of a box that spins at 5 rad/s."""
    humanoid = load_robot("humanoid", locked="simplified")
    scene = compile_scene(humanoid, "mipsd", Ground())
    start = standing_state(scene, np.zeros(scene.tree.n))
    settles = scene.recompiled(integrator="midpoint", timestep=1e-3)
    settled = simulate(settles, 5.0, start, record_interval=1.0, estimate_error=False)
    still = Reference([0.0], np.zeros((1, scene.tree.n)))
    yield Case("humanoid, ten minutes", "long", scene, 600.0, settled.final, still, record_interval=1.0, still=True)
    yield spinning("box at 5 rad/s, ten minutes", 5.0, 600.0, record_interval=1.0)._replace(kind="long")


# ---------------------------------------------------------------------------------------------- of other benchmarks


def known_cases() -> Iterator[Case]:
    """Yield the problems of `precision` without the humanoid's, and the cases of `stress`, recorded at each tick."""
    for case in (*problems(), *stressed()):
        ticks = case.kind == "stress" or case.record_interval == case.duration
        if case.kind != "humanoid":
            yield case._replace(record_interval=None if ticks else case.record_interval)
