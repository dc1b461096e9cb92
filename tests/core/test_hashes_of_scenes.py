"""The bits of runs that take too long to compile for `test_hashes.py`: one test for each kind of scene, and a gradient.

A change of structure keeps all hashes of both files.  They change together, only in a commit that changes physics on
purpose.  This command compares all of them, and prints each hash that differs beside the stored one:

    python -m pytest -m "long or not long" tests/core/test_hashes.py tests/core/test_hashes_of_scenes.py
"""

import hashlib
import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import published
import pytest
from scenes import NEVER_FALLEN, arm_scene, box_on
from test_forest import ball
from test_hashes import ALONE, digest
from test_loops import rods_on_an_ankle
from test_published_feet import without_meshes
from test_tendons import anchored, tied
from touching import FIXED_STEPS

from featherstone_gait import (
    Ground,
    Joint,
    Link,
    Loop,
    Model,
    Placed,
    Reference,
    close_loops,
    compile_scene,
    gradient,
    initial_state,
    load_robot,
    load_scene,
    run_cost,
    simulate,
)
from featherstone_gait.benchmark.linkages import DOWN, bricard
from featherstone_gait.benchmark.skip import free_arm
from featherstone_gait.walking import with_generic_servos

pytestmark = pytest.mark.long
Y = (0.0, 1.0, 0.0)


def test_a_standing_humanoid_of_nineteen_servos():
    scene = compile_scene(load_robot("humanoid"), "mipsd", Ground(), "ars343")
    assert digest(simulate(scene, 0.1, **ALONE)) == "bda9e8e2b86f81b4"


def test_a_box_that_lands_by_each_integrator():
    """It falls on a corner, then slides on all four."""
    stored = {
        "implicit_euler": "35886619d30d61bc",
        "midpoint": "eb544ddfa3fd5018",
        "rk4": "e662b30518581370",
        "ars343": "646c51a0299c720e",
        "extrapolation": "ebf7744277d9a61c",
        "dop853": "b16cd3d82479f2dc",
    }
    found = {}
    for name in stored:
        step = 1e-3 if name in FIXED_STEPS else None
        scene = box_on(Ground(friction=0.3, penetration=1e-3, damping_ratio=0.5), name, step)
        start = initial_state(scene, [0.0, 0.0, 0.07, 0.9996, 0.02, 0.02, 0.0], [0.5, 0.2, -0.3, 0.0, 0.0, 0.0])
        found[name] = digest(simulate(scene, 0.1, start, **ALONE))
    assert found == stored


def test_boxes_on_a_belt_and_an_arm_that_takes_one():
    """The boxes lie on the belt, which turns round; then a weld joins one of them to the arm, over any distance."""
    scene = compile_scene(load_scene("conveyor"), "rotor", integrator="midpoint", timestep=1e-3)
    start, goal = initial_state(scene, open_loops=["suction"]), Reference([0.0, 0.1], [[0.0, 0.0], [0.1, -0.01]])
    switches = [(0.03, "belt/motor", -1.0), (0.06, "suction", True, math.inf)]
    assert digest(simulate(scene, 0.1, start, goal, switches=switches, **ALONE)) == "0e72549725b170cd"


def test_two_robots_and_a_ball():
    members = [
        Placed(load_robot("arm7"), "arm", position=(1.0, 2.0, 0.5), orientation=(0.8, 0.0, 0.0, 0.6)),
        Placed(load_robot("humanoid", locked="simplified"), "humanoid"),
        Placed(ball(), "ball", position=(-3.0, 0.0)),
    ]
    scene = compile_scene(members, "mipsd", Ground(), "midpoint", 1e-3)
    assert digest(simulate(scene, 0.1, **ALONE)) == "61e2ec659f74de25"


def test_a_chain_of_twenty_links_hung_at_both_ends():
    inertia = (1e-7, 0.0, 0.0, 1e-4, 0.0, 1e-4)
    links = [Link("post"), *(Link(f"bar{k}", 0.1, (0.05, 0.0, 0.0), inertia) for k in range(20))]
    joints = [
        Joint(f"joint{k}", "continuous", one.name, two.name, (0.1 if k else 0.0, 0.0, 0.0), axis=Y)
        for k, (one, two) in enumerate(pairwise(links))
    ]
    pin = Loop("pin", "connect", "bar19", None, (0.1, 0.0, 0.0), (1.2, 0.0, 0.0))
    model = Model("chain", tuple(links), tuple(joints), loops=(pin,))
    scene = compile_scene(model, integrator="ars343")
    start = close_loops(model, [1.0, *[-0.1] * 19])
    assert digest(simulate(scene, 0.1, initial_state(scene, start), **ALONE)) == "e0f118b5fd544696"


def test_bricards_mechanism_whose_loop_has_more_equations_than_joints():
    scene = compile_scene(bricard().scene.model, integrator="rk4", timestep=1e-3, gravity=DOWN)
    assert digest(simulate(scene, 0.1, **ALONE)) == "2b356d249cc46076"


def test_a_floating_leg_with_rods_on_ball_joints(tmp_path):
    model, _ = rods_on_an_ankle(tmp_path)
    guess = np.linspace(-0.05, 0.05, model.nq)
    guess[[3, model.nq - 8, model.nq - 4]] = 1.0  # of quaternions
    scene = compile_scene(model, integrator="implicit_euler", timestep=1e-3, **NEVER_FALLEN)
    assert digest(simulate(scene, 0.1, initial_state(scene, close_loops(model, guess)), **ALONE)) == "cfc01f33777a5797"


@pytest.mark.filterwarnings("ignore::featherstone_gait.RobotFileWarning")
def test_a_published_quadruped_that_stands():
    """ANYmal, of example-robot-data 6.0.0."""
    path = published.folder("example-robot-data") / "anymal_b_simple_description/robots/anymal.urdf"
    robot = with_generic_servos(load_robot(path, base="floating", contacts="feet"), leg=0.55)
    scene = compile_scene(robot, "mipsd", Ground(), "midpoint", 1e-3, **NEVER_FALLEN)
    assert digest(simulate(scene, 0.1, **ALONE)) == "c14892f518037e2f"


@pytest.mark.filterwarnings("ignore::featherstone_gait.RobotFileWarning")
def test_a_published_arm_whose_gripper_has_two_loops(tmp_path):
    """Panda with Robotiq's 2F-85, of playground 0.2.0; its gripper closes."""
    folder = published.folder("mujoco_playground") / "_src" / "manipulation" / "franka_emika_panda_robotiq" / "xmls"
    model = load_robot(without_meshes(folder / "panda_updated_robotiq_2f85.xml", tmp_path))
    assert len(model.loops) == 2
    scene = compile_scene(model, "rotor", integrator="implicit_euler", timestep=1e-3)
    closed = Reference([0.0], [[0.4 if name == "left_driver_joint" else 0.0 for name in model.joint_names]], "hold")
    start = initial_state(scene, allow_limit_violation=True)  # joint 4 is at 0, beyond its range
    assert digest(simulate(scene, 0.1, start, closed, **ALONE)) == "218fa2db81106d7c"


@pytest.mark.nojit
def test_an_arm_with_tendons():
    """Tendons on joints and along a path, two that hang from the world, of which one bends around a drum."""
    arm = free_arm("arm7_spatial")
    model = replace(arm, tendons=[*tied(arm).tendons, *anchored(arm, 0.1).tendons])
    scene = compile_scene(model, integrator="midpoint", timestep=1e-3)
    assert digest(simulate(scene, 0.1, initial_state(scene, np.linspace(0.1, 0.7, 7)), **ALONE)) == "105a7a30926454b0"


def test_a_vehicle_that_dives_by_its_propellers():
    """Its hull is partly in the water: buoyancy, drag, added mass, and thrust of four servos."""
    scene = compile_scene(load_scene("rov"), "rotor", integrator="midpoint", timestep=1e-3)
    start = initial_state(scene)
    scene.state_view(start).base_q[:] = 0.0, 0.0, 0.01, 0.98, 0.1, 0.1, 0.14
    goal = Reference([0.0, 0.1], [[0.0] * 4, [20.0, -20.0, 15.0, 15.0]], "linear")
    assert digest(simulate(scene, 0.1, start, goal, **ALONE)) == "be35ee8a7e6b938d"


@run_cost
def squares(q, qd):
    total = 0.0
    for k in range(q.shape[0]):
        for j in range(q.shape[1]):
            total += (j + 1.0) * q[k, j] ** 2 + 0.1 * qd[k, j] ** 2
    return total


def test_a_gradient_of_an_arm():
    scene = arm_scene(integrator="midpoint")
    goal = Reference([0.0, 0.05, 0.1], np.linspace(0.0, 0.2, 21).reshape(3, 7), "cubic")
    names = "state.q", "state.qd", "reference", "servos.resistance", "links.mass", "links.inertia", "gravity"
    found = gradient(scene, 0.1, squares, names, reference=goal)
    assert found.trajectory.ok
    bits = b"".join(found[name].tobytes() for name in names)
    assert hashlib.sha256(bits).hexdigest()[:16] == "21ee0a82c044b872"
