"""Bodies that overlap in a state, and where a run starts."""

import math
import warnings

import numpy as np
import pytest

from featherstone_gait.geometry.body import body
from featherstone_gait.geometry.distance import shape_distances
from featherstone_gait.model.placed import Placed, SceneModel
from featherstone_gait.model.rest_posture import nearest_posture
from featherstone_gait.model.shapes import Box, Sphere
from featherstone_gait.robot_file import load_robot
from featherstone_gait.run.overlap import OverlapWarning, overlaps
from featherstone_gait.run.simulate import initial_state, simulate
from featherstone_gait.scene.compile import compile_scene

TURNED = (math.cos(0.6), 0.0, 0.0, math.sin(0.6))
STEPS = dict(integrator="implicit_euler", timestep=1e-3, gravity=(0.0, 0.0, -9.81))


def pile(depth, wall=0.0):
    """Two balls of radius 0.1 m that overlap, and a wall into which the second reaches."""
    ball = body(Sphere(0.1), 1.0)
    balls = [Placed(ball, "a"), Placed(ball, "b", position=(0.2 - depth, 0.0, 0.0), orientation=TURNED)]
    plate = Placed(body(Box((0.02, 1.0, 1.0)), name="wall", base="fixed"), position=(0.31 - depth - wall, 0.0, 0.0))
    return compile_scene(SceneModel("pile", balls, [plate]), pairs="all", **STEPS)


def test_depths_are_those_of_the_shapes():
    assert overlaps(pile(-0.01, -0.01)) == []
    (names, depth), (others, less) = overlaps(pile(0.03, 0.005))
    assert (names, depth) == (("b/body", "a/body"), pytest.approx(0.03, rel=1e-12))
    assert (others, less) == (("b/body", "wall/body"), pytest.approx(0.005, rel=1e-12))


def test_a_robot_overlaps_itself_wherever_it_stands_as_its_distances_say():
    robot = load_robot("humanoid")
    ball = Placed(body(Sphere(0.1), 1.0), "ball", (5.0, 0.0, 1.0))
    scene = compile_scene([Placed(robot, "robot"), ball], pairs="all")
    rng, seen = np.random.default_rng(2), 0
    table = scene.touching.table
    links = [shape.link for shape in robot.shapes]
    for _ in range(10):
        q = nearest_posture(robot)
        q[7:] += rng.uniform(-1.5, 1.5, len(q) - 7)
        own = [k for k, row in enumerate(table.pairs) if row.tree_a == row.tree_b]
        pairs = [[links.index(name.split("/")[1]) for name in scene.pairs[k]] for k in own]
        far = np.array([3.0, -2.0, 1.0, *TURNED, *q[7:]])
        found = dict(overlaps(scene, initial_state(scene, {"robot": far}, allow_limit_violation=True)))
        for pair, distance in zip(pairs, shape_distances(robot, q, np.array(pairs))):
            names = tuple(f"robot/{links[k]}" for k in pair)
            assert found.get(names, 0.0) == pytest.approx(max(-distance, 0.0), abs=1e-12)
            seen += names in found
    assert seen > 5


@pytest.mark.long
def test_a_start_that_overlaps_is_told_by_pair_and_depth():
    with pytest.warns(OverlapWarning, match=r"'b/body' and 'a/body' by 0.03 m"):
        run = simulate(pile(0.03, -0.01), 2e-3, estimate_error=False)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        simulate(pile(0.0005, -0.01), 2e-3, estimate_error=False)
        simulate(pile(0.03, -0.01), 2e-3, run, estimate_error=False)  # goes on
    with pytest.raises(ValueError, match=r"'b/body' and 'wall/body' by 0.015 m.*move them apart"):
        simulate(pile(0.0, 0.015), 2e-3, estimate_error=False)
