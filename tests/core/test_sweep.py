"""No step with error control carries a shape through another: what swings, flies and spins meets what is in its way."""

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from featherstone_gait import (
    Box,
    Capsule,
    ContactPoint,
    Ground,
    Joint,
    Link,
    Model,
    Placed,
    SceneModel,
    Shape,
    Sphere,
    compile_scene,
    initial_state,
    simulate,
)
from featherstone_gait.dynamics import forward_kinematics
from tests.support.touching import obstacle, placed, touching

LONG, AT = 0.45, 0.4  # of the bar, and the distance of a peg from its hinge [m]
ANGLES = np.linspace(0.3, 2.6, 12)
SPEEDS = (5.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0)
METHODS = {"default": {}, "rtol 1e-8": {"rtol": 1e-8}, "dop853": {"integrator": "dop853"}}
OFF = 0.04  # share of the speed by which a run may differ from one at steps that are small beside the shapes


def bar_on_a_hinge():
    """A bar in the plane of x and z, whose rod does not reach into the hinge."""
    inertia = 0.2 * LONG * LONG / 12.0
    rod = Link("rod", 0.2, (0.0, 0.0, 0.5 * LONG), (inertia, 0.0, 0.0, inertia, 0.0, 1e-5))
    shape = Shape("rod", Capsule(0.005, LONG - 0.05), (0.0, 0.0, 0.5 * (LONG + 0.05)))
    hinge = Joint("hinge", "revolute", "hub", "rod", axis=(0, 1, 0))
    return Model("bar", (Link("hub"), rod), (hinge,), shapes=(shape,))


def peg_at(angle, radius):
    return obstacle(Sphere(radius), "peg", (AT * math.sin(angle), 0.0, AT * math.cos(angle)))


def last(scene, duration, velocities, channel, estimate_error=False, **options):
    """The velocities at a run's end and whether it says that it is ok."""
    state = initial_state(scene, None if channel == "base_qd" else {}, velocities)
    run = simulate(scene, duration, state, record=(channel,), record_interval=duration, estimate_error=estimate_error,
                   **options)  # fmt: skip
    return run[channel][-1], run.ok


def split(method):
    """What of a method `compile_scene` takes, and what `simulate` does."""
    return {key: value for key, value in method.items() if key != "rtol"}, {
        key: value for key, value in method.items() if key == "rtol"
    }


def steps_of(duration, way, size):
    """A step for which shapes move by a small share of their size, of which a whole number fills the duration [s]."""
    return duration / min(max(math.ceil(way / (0.03 * size)), 50), 60000)


def test_a_bar_meets_pegs():
    for angle, radius, speed in product((0.5, 1.2, 1.9), (0.002, 0.01), (30.0, 200.0)):
        end = (angle + 0.4) / speed
        scene = touching([Placed(bar_on_a_hinge(), "bar")], [peg_at(angle, radius)], timestep=0.1 * end)
        found, ok = last(scene, end, {"bar": [speed]}, "qd", rtol=1e-6)
        assert not ok or found[0] < 0.75 * speed, (angle, radius, speed)


@pytest.mark.long
@pytest.mark.parametrize("speed", SPEEDS)
@pytest.mark.parametrize("method", METHODS)
def test_a_bar_meets_every_peg(method, speed):
    for angle, radius, gravity in product(ANGLES, (0.002, 0.01, 0.03), (0.0, -9.81)):
        members = SceneModel("bar", [Placed(bar_on_a_hinge(), "bar")], [peg_at(angle, radius)])
        end, (compiled, run) = (angle + 0.4) / speed, split(METHODS[method])

        def scene_by(members=members, gravity=gravity, **options):
            return compile_scene(members, gravity=(0.0, 0.0, gravity), pairs="all", **options)

        found, ok = last(scene_by(timestep=0.1 * end, **compiled), end, {"bar": [speed]}, "qd", **run)
        step = steps_of(end, AT * speed * end, radius)
        expected, _ = last(scene_by(integrator="midpoint", timestep=step), end, {"bar": [speed]}, "qd")
        assert not ok or abs(found[0] - expected[0]) < OFF * speed, (angle, radius, gravity, found, expected)


def flyer(rng):
    """A shape and its least half width [m]."""
    size, kind = 10.0 ** rng.uniform(-3.0, -1.3), rng.choice(["ball", "bar", "plate", "box"])
    shape = {
        "ball": Sphere(size), "bar": Capsule(0.3 * size, 6.0 * size), "box": Box((size, 1.5 * size, 2.0 * size)),
        "plate": Box((6.0 * size, 6.0 * size, 0.6 * size)),
    }[kind]  # fmt: skip
    return shape, size, 0.3 * size if kind in ("bar", "plate") else 0.5 * size


def in_the_way(rng, size):
    """Obstacles about the origin, across z, and their size [m]."""
    t, kind = 10.0 ** rng.uniform(-3.0, -1.3), rng.choice(["wall", "post", "grating", "ball", "spokes"])
    if kind == "wall":
        return [obstacle(Box((1.0, 1.0, t)), "wall")], t
    if kind == "post":
        return [obstacle(Box((1.0, 2.0 * t, 2.0 * t)), "post")], t
    if kind == "ball":
        return [obstacle(Sphere(t), "ball")], t
    apart = [(k - 2) * (3.0 * size + 2.0 * t) for k in range(5)]
    if kind == "grating":
        return [obstacle(Box((1.0, t, t)), f"bar {k}", (0.0, y, 0.0)) for k, y in enumerate(apart)], t
    lying = (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)
    return [obstacle(Capsule(t, 1.0), f"spoke {k}", (0.0, y, 0.0), lying) for k, y in enumerate(apart)], t


@pytest.mark.long
@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("method", METHODS)
def test_what_flies_meets_what_is_in_its_way(method, seed):
    rng = np.random.default_rng([seed, len(method)])
    for _ in range(60):
        (shape, size, thin), speed = flyer(rng), 10.0 ** rng.uniform(0.0, math.log10(300.0))
        obstacles, t = in_the_way(rng, size)
        gravity, mass = rng.choice([0.0, -9.81]), 10.0 ** rng.uniform(-3.0, 1.0)
        spin = rng.normal(size=3) * rng.choice([0.0, 1.0]) * 10.0 ** rng.uniform(0.0, 2.3)
        height = max(6.0 * size, t) + t + rng.uniform(0.05, 0.6)
        across = rng.uniform(-0.8, 0.8, 2) * (size + t)
        thrown = placed(shape, mass, "thrown", (*across, height))
        end, velocity = (height + 0.1) / speed, {"thrown": (0.0, 0.0, -speed, *spin)}
        members, (compiled, run) = SceneModel("flight", [thrown], obstacles), split(METHODS[method])

        def scene_by(members=members, gravity=gravity, **options):
            return compile_scene(members, gravity=(0.0, 0.0, gravity), pairs="all", **options)

        found, ok = last(scene_by(timestep=0.1 * end, **compiled), end, velocity, "base_qd", **run)
        step = steps_of(end, height + 0.1, min(thin, t))
        expected, finer = (
            last(scene_by(integrator="midpoint", timestep=h), end, velocity, "base_qd")[0] for h in (step, 0.25 * step)
        )
        off, unsettled = np.linalg.norm(found[:3] - finer[:3]), np.linalg.norm(expected[:3] - finer[:3])
        if off > OFF * max(speed, np.linalg.norm(finer[:3])) + unsettled:
            _, ok = last(scene_by(timestep=0.1 * end, **compiled), end, velocity, "base_qd", True, **run)
            assert not ok, (shape, obstacles, velocity, found, expected, finer)


def arm_of_three():
    """An arm whose joints turn about z, y and y, with a rod to each."""
    links, joints, shapes, up = [Link("base")], [], [], 0.0
    for k, axis in enumerate([(0, 0, 1), (0, 1, 0), (0, 1, 0)]):
        inertia = (1.5e-3, 0.0, 0.0, 1.5e-3, 0.0, 1e-4)
        links.append(Link(f"link {k}", 0.3, (0.0, 0.0, 0.12), inertia))
        joints.append(Joint(f"joint {k}", "revolute", links[k].name, f"link {k}", xyz=(0.0, 0.0, up), axis=axis))
        shapes.append(Shape(f"link {k}", Capsule(0.008, 0.18), (0.0, 0.0, 0.12)))
        up = 0.24
    return Model("arm", tuple(links), tuple(joints), shapes=tuple(shapes))


@pytest.mark.long
@pytest.mark.parametrize("method", METHODS)
def test_the_hand_of_a_robot_meets_a_thin_rod(method):
    """The rod stands where the hand would pass it."""
    rng, compiled_run = np.random.default_rng(len(method)), split(METHODS[method])
    arm, far = Placed(arm_of_three(), "arm"), obstacle(Capsule(0.002, 0.3), "rod", (0.0, 0.0, 5.0))
    hits = 0
    for _ in range(40):
        speed, q = 10.0 ** rng.uniform(0.3, 2.3), {"arm": rng.uniform((-1.0, -0.2, -0.2), (1.0, 1.8, 1.8))}
        v, end = {"arm": speed * rng.uniform(0.3, 1.0, 3)}, 1.5 / speed

        def last_of(rod, steps=None, q=q, v=v, end=end, record=("qd",)):
            compiled, run = compiled_run if steps is None else ({"integrator": "midpoint"}, {})
            step = 0.1 * end if steps is None else end / steps
            scene = compile_scene(SceneModel("hand", [arm], [rod]), "none", None, timestep=step,
                                  gravity=(0.0, 0.0, 0.0), pairs=[("arm/link 2", "rod")], **compiled)  # fmt: skip
            return simulate(scene, end, initial_state(scene, q, v), record=record, record_interval=end,
                            estimate_error=False, **run)  # fmt: skip

        middle = last_of(far, 4000, end=0.5 * end, record=("q",))["q"][-1]
        poses = forward_kinematics(arm.model, middle, "link 2")
        at = poses.rotation @ (0.0, 0.0, 0.2) + poses.position
        rod = obstacle(Capsule(0.002, 0.3), "rod", tuple(at.tolist()))
        found, expected = last_of(rod), last_of(rod, 40000)["qd"][-1]
        hits += bool(np.linalg.norm(expected - last_of(far, 4000)["qd"][-1]) > 0.1 * speed)
        off = np.linalg.norm(found["qd"][-1] - expected)
        assert not found.ok or off < OFF * max(speed, np.linalg.norm(expected)), (q, v, found["qd"][-1], expected)
    assert hits > 20


@pytest.mark.long
@pytest.mark.parametrize("method", METHODS)
def test_a_fast_tip_meets_the_ground(method):
    """It dips into the plane for a small part of its turn."""
    compiled, options = split(METHODS[method])
    bar = replace(bar_on_a_hinge(), contacts=(ContactPoint("rod", (0.0, 0.0, LONG)),), shapes=())
    for dip, speed, angle in product((1e-3, 5e-3, 2e-2), (5.0, 20.0, 50.0, 100.0, 200.0), ANGLES[::2]):
        ground, end = Ground(height=dip - LONG), (angle + 0.6) / speed

        def run(step, ground=ground, end=end, angle=angle, speed=speed, **given):
            scene = compile_scene(bar, ground=ground, timestep=end / math.ceil(end / step), **given)
            state = initial_state(scene, [math.pi - angle], [speed])
            extra = {} if given else options
            return simulate(scene, end, state, record=("qd",), record_interval=end, estimate_error=False, **extra)

        expected, found = run(2e-3 / speed, integrator="midpoint")["qd"][-1], run(0.1 * end, **compiled)
        assert not found.ok or abs(found["qd"][-1] - expected) < OFF * speed, (dip, speed, angle)
