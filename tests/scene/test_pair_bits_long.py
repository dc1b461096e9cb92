"""Bodies that do not touch change no bit of each other: in lanes, in islands, and with pairs that stay far apart."""

import math

import numpy as np
import pytest
from touching import FIXED_STEPS, G, obstacle, placed, touching

from featherstone_gait import Surface, command_surface
from featherstone_gait.geometry.body import body
from featherstone_gait.model import Ground
from featherstone_gait.model.placed import Placed
from featherstone_gait.model.shapes import Box, Capsule, Cylinder, Sphere
from featherstone_gait.robot_file import load_robot
from featherstone_gait.run.simulate import initial_state, simulate, simulate_batch
from featherstone_gait.scene.compile import compile_scene

pytestmark = pytest.mark.long

DOWN = (0.0, 0.0, -G)
FLOOR = Box((40.0, 40.0, 1.0))
SHAPES = (Box((0.1, 0.1, 0.1)), Sphere(0.05), Cylinder(0.05, 0.1), Capsule(0.04, 0.1), Box((0.2, 0.1, 0.05)))
SEED = 5


def heap(name, x, seed=SEED):
    """Five bodies that fall on each other, about a place."""
    rng = np.random.default_rng(seed)
    found = []
    for k, shape in enumerate(SHAPES):
        turn = rng.normal(size=4)
        at = (x + rng.uniform(-0.03, 0.03), rng.uniform(-0.03, 0.03), 0.12 + 0.16 * k)
        found.append(placed(shape, 0.5 + k, f"{name}{k}", at, tuple(turn / math.sqrt(turn @ turn))))
    return found


def floor():
    return [obstacle(FLOOR, "floor", (0.0, 0.0, -0.5))]


@pytest.mark.parametrize("integrator", ["midpoint", "rk4"])
def test_heaps_in_lanes_have_the_bits_of_each_alone(integrator):
    """Eleven heaps that start in other places: eight share a vector, and what touches differs.

    Slots are shared: a pair that is near in one lane has some in all.  What touches does not roll and spin freely, and
    the floor turns, of each heap at another speed.
    """
    table = body(FLOOR, base="fixed", name="floor", surface=Surface((0.1, 0.0, 0.0), (0.0, 0.0, 0.5)))
    scene = touching(
        heap("h", 0.0), [Placed(table, position=(0.0, 0.0, -0.5))], integrator,
        5e-4 if integrator != "rk4" else 1e-4, DOWN, torsional_friction=1e-3, rolling_friction=1e-3,
    )  # fmt: skip
    starts = []
    for seed in range(11):
        places = {one.name: [*one.position, *one.orientation] for one in heap("h", 0.0, seed)}
        starts.append(command_surface(scene, initial_state(scene, places), "floor/body", 0.25 * seed))
    how = {"record": ("base_q", "base_qd", "pair_work"), "estimate_error": False}
    runs = simulate_batch(scene, 0.25, states=starts, **how)
    ends = {run["base_q"][-1].tobytes() for run in runs}
    assert len(ends) == len(runs)
    for run, start in zip(runs, starts):
        assert run.status == "ok"
        assert run["pair_work"][-1].any()
        alone = simulate(scene, 0.25, start, **how)
        for channel in how["record"]:
            assert alone[channel].tobytes() == run[channel].tobytes(), channel


@pytest.mark.parametrize("integrator", FIXED_STEPS)
def test_heaps_far_apart_move_as_each_alone(integrator):
    timestep = 5e-4 if integrator != "rk4" else 1e-4
    both = {"left": heap("left", -6.0), "right": heap("right", 6.0, SEED + 1)}
    sets = [*both.values(), [*both["left"], *both["right"]]]
    scenes = [touching(some, floor(), integrator, timestep, DOWN, load=10.0) for some in sets]
    *alone, together = [simulate(one, 0.5, record=("base_q", "base_qd"), estimate_error=False) for one in scenes]
    for run, names in zip(alone, both.values()):
        for name in (one.name for one in names):
            for channel in ("base_q", "base_qd"):
                assert np.array_equal(run.of(name)[channel], together.of(name)[channel]), (name, channel)


@pytest.mark.parametrize(("integrator", "speed"), [("implicit_euler", 1.0), ("midpoint", 1.0), ("ars343", 0.0)])
def test_pairs_that_are_never_near_change_no_bit(integrator, speed):
    """A humanoid that holds its posture, and a ball far away: with all pairs as with none.

    Of a ball that rolls error control takes shorter steps, because the pool has no room for all that it could meet.
    """
    robot, runs = load_robot("humanoid"), []
    members = [Placed(robot, "robot"), placed(Sphere(0.1), 0.5, "ball", (3.0, 0.0, 0.1))]
    channels = ("q", "qd", "base_q", "base_qd", "torque")
    for pairs in ("none", "all"):
        scene = compile_scene(members, "mipsd", Ground(), integrator, 1e-3, pairs=pairs)
        start = initial_state(scene, qd={"ball": [speed, 0.0, 0.0, 0.0, 0.0, 0.0]})
        runs.append(simulate(scene, 0.5, start, record=channels))
        assert runs[-1].ok
    for channel in channels:
        assert np.array_equal(runs[0][channel], runs[1][channel]), channel
