"""The bits of five runs, which are the same under every Numba, pipeline, Python and processor that this runs on.

`.ci/run` runs all of it under the oldest Numba, the newest one and Numba's own pipeline.
"""

import hashlib
from pathlib import Path

import numpy as np
import pytest

from featherstone_gait import (
    Box,
    Cylinder,
    Ground,
    Joint,
    Link,
    Loop,
    Model,
    PairContact,
    Placed,
    Sphere,
    Worlds,
    body,
    close_loops,
    compile_scene,
    initial_state,
    load_robot,
    simulate,
    simulate_batch,
)
from featherstone_gait.walking import read_walk
from featherstone_gait.walking.cost_in_worlds import variations

ALONE = {"estimate_error": False}


@pytest.fixture(scope="module")
def humanoid():
    return compile_scene(load_robot("humanoid", locked="simplified"), "mipsd", Ground(), "midpoint", 1e-3)


def digest(*runs):
    assert {run.status for run in runs} == {"ok"}
    return hashlib.sha256(b"".join(run.final.tobytes() for run in runs)).hexdigest()[:16]


def test_an_arm_under_error_control():
    scene = compile_scene(load_robot("arm7"), "mipsd")
    assert scene.integrator == "ars343"
    assert digest(simulate(scene, 0.2, initial_state(scene, np.linspace(0.1, 0.7, 7)), **ALONE)) == "eccecfdd2400495e"


def test_eight_worlds_of_a_humanoid_in_lanes(humanoid):
    """Beside a ninth that differs from them in all that a search varies: they are compiled as its worlds are."""
    worlds = Worlds(ground={"friction": np.linspace(0.4, 1.1, 8)}), variations(humanoid, 1)[0]
    runs = simulate_batch([scene for some in worlds for scene in some.scenes(humanoid)], 0.2, **ALONE)
    assert digest(*runs[:8]) == "151ecde6da6103be"


def test_a_stride_with_feedback(humanoid):
    walk = read_walk(Path(humanoid.model.source).parent / "balanced_gait.npz")
    run = simulate(humanoid, 0.5, reference=walk.reference(1), controller=walk.controller(humanoid), **ALONE)
    assert digest(run) == "c40d188dc5530e5e"


@pytest.mark.long
@pytest.mark.bounds
@pytest.mark.nojit
def test_a_ball_on_a_cylinder_on_a_box():
    """Their contact points come from code that is compiled apart from the run's, and called by its address."""
    shapes = Box((0.1, 0.1, 0.1)), Cylinder(0.05, 0.1), Sphere(0.05)
    places = (0.0, 0.0, 0.05), (0.01, 0.02, 0.1495), (0.01, 0.0, 0.249)
    pile = [Placed(body(shape, 1.0), name, position=at) for shape, name, at in zip(shapes, "abc", places)]
    scene = compile_scene(pile, None, Ground(), "implicit_euler", 1e-3, pairs=PairContact(load=1.0))
    assert digest(simulate(scene, 0.01, **ALONE)) == "24a0445950f691b2"


@pytest.mark.long
@pytest.mark.nojit
def test_a_pendulum_on_ball_joints():
    inertia = (0.01, 0.002, 0.001, 0.03, 0.0005, 0.02)
    upper, lower = Link("upper", 1.0, (0.02, 0.01, -0.2), inertia), Link("lower", 0.5, (0.0, 0.02, -0.1), inertia)
    elbow = Joint("elbow", "ball", "upper", "lower", (0.0, 0.0, -0.4))
    shoulder = Joint("shoulder", "ball", "ceiling", "upper", (0.0, 0.0, 1.0))
    model = Model("pendulum", (Link("ceiling"), upper, lower), (shoulder, elbow))
    scene = compile_scene(model, None, None, "midpoint", 1e-3)
    start = initial_state(scene, np.linspace(0.1, 0.8, 8), np.linspace(-3.0, 3.0, 6))
    assert digest(simulate(scene, 0.02, start, **ALONE)) == "73a17e5cb82de36a"


@pytest.mark.long
@pytest.mark.bounds
@pytest.mark.nojit
def test_a_pendulum_whose_rod_closes_a_loop():
    """A step moves the quaternion and the hinge, and closes the loop anew."""
    inertia = (0.01, 0.002, 0.001, 0.03, 0.0005, 0.02)
    upper, lower = Link("upper", 1.0, (0.02, 0.01, -0.2), inertia), Link("lower", 0.5, (0.0, 0.02, -0.1), inertia)
    elbow = Joint("elbow", "continuous", "upper", "lower", (0.0, 0.0, -0.4), axis=(0.0, 1.0, 0.0))
    rod = Loop("rod", "distance", "lower", "frame", (0.0, 0.0, -0.3), (0.3, 0.1, -0.6), distance=0.35)
    joints = Joint("ball", "ball", "frame", "upper"), elbow
    model = Model("pendulum", (Link("frame"), upper, lower), joints, loops=(rod,))
    start = close_loops(model, [1.0, 0.1, 0.2, 0.1, 0.3])
    runs = []
    for integrator in ("midpoint", "rk4"):
        scene = compile_scene(model, None, None, integrator, 2e-3)
        runs.append(simulate(scene, 0.02, initial_state(scene, start), **ALONE))
    found = b"".join(run[name].tobytes() for run in runs for name in ("q", "qd"))
    assert hashlib.sha256(found).hexdigest()[:16] == "f152f9b70a3580f7"
