"""From a model to the kernels' rows: rotations, links that move as one, and the same bits on any processor."""

import ast
import math
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from processors import PROCESSORS
from random_tree import random_tree

import featherstone_gait
from featherstone_gait.base.fixed_order import applied, product
from featherstone_gait.base.portable_math import sincos
from featherstone_gait.base.rotation import rotation_about, rotation_from_rpy, rotation_z_to
from featherstone_gait.core.compile.elementary import SINCOS_LIMIT
from featherstone_gait.dynamics.tree import compile_tree
from featherstone_gait.model import Joint, Model, depth_first, rigid_bodies
from featherstone_gait.robot_file import load_robot, robot_names, save_robot

PROGRAM = """
import hashlib, sys
import numpy as np
from featherstone_gait.dynamics.tree import compile_tree
from featherstone_gait.dynamics import forward_kinematics
from featherstone_gait.robot_file import load_robot

digest = hashlib.sha256()
for path in sys.argv[1:]:
    model = load_robot(path)
    tree, poses = compile_tree(model), forward_kinematics(model, np.linspace(-2, 3, model.nq))
    for a in (tree.bodies, *poses, *(a for place in tree.placements.values() for a in (place.E, place.r))):
        digest.update(a.tobytes())
print(digest.hexdigest())
"""


def partly_held(seed, base="fixed") -> Model:
    """A random tree, some of whose joints are fixed and some locked."""
    tree, rng = random_tree(20, seed, base=base), np.random.default_rng(seed)
    joints = [replace(j, type="fixed") if rng.random() < 0.2 else j for j in tree.joints]
    moving = [j for j in joints if j.type != "fixed"]
    return replace(tree, joints=tuple(joints), locked={j.name: rng.uniform(-3, 3) for j in moving[::3]})


@pytest.fixture(scope="module")
def robot_files(tmp_path_factory):
    """Random trees with inertias in turned axes and axes that are not of unit length, as files."""
    folder = tmp_path_factory.mktemp("trees")
    paths = [folder / f"tree{seed}.urdf" for seed in range(5)]
    for seed, path in enumerate(paths):
        save_robot(bounded(partly_held(seed)), path)
        text = path.read_text("utf-8").replace('      <origin xyz="', '      <origin rpy="0.3 -0.2 0.7" xyz="')
        path.write_text(re.sub('<axis xyz="[^"]*"', '<axis xyz="0.3 -2 1.7"', text), "utf-8")
    return paths


def bounded(model: Model) -> Model:
    """The same with limits, which URDF asks for."""
    stops = {"revolute": {"lower": -4.0, "upper": 4.0}, "prismatic": {"lower": -4.0, "upper": 4.0}}
    return replace(model, joints=tuple(replace(j, **stops.get(j.type, {})) for j in model.joints))


@pytest.mark.long
def test_bodies_and_poses_have_the_same_bits_on_any_processor(robot_files):
    kinds = [{"OPENBLAS_CORETYPE": kind, "NUMBA_DISABLE_JIT": "1"} for kind in PROCESSORS]
    digests = {str(settings): computed(robot_files, settings) for settings in [{}, *kinds]}
    assert len(set(digests.values())) == 1, digests


def computed(paths, settings) -> str:
    """Digest of bodies, placements and poses, from a process with these environment variables."""
    command, root = [sys.executable, "-c", PROGRAM, *map(str, paths)], Path(__file__).parents[2]
    run = subprocess.run(command, cwd=root, env=os.environ | settings, capture_output=True, text=True, check=True)
    return run.stdout.strip()


def test_what_builds_for_kernels_asks_no_library_for_sums_and_sines():
    """`@`, np.linalg, einsum and libm round differently on another processor."""
    package = Path(featherstone_gait.__file__).parent
    names = {"dot", "matmul", "einsum", "linalg", "sin", "cos", "tan", "exp", "hypot"}
    for path in [package / "base" / "rotation.py", *sorted((package / "scene").glob("*.py"))]:
        nodes = list(ast.walk(ast.parse(path.read_text("utf-8"))))
        used = {node.attr for node in nodes if isinstance(node, ast.Attribute)}
        if path.name == "preflight.py":
            used -= {"linalg"}  # eigenvalues: they choose a method and are told, but no kernel reads them
        assert used & names == set(), path.name
        assert not any(isinstance(node, ast.MatMult) for node in nodes), path.name


def test_roll_pitch_and_yaw_are_turns_about_fixed_axes():
    x, y, z = np.eye(3)
    for roll, pitch, yaw in np.random.default_rng(0).uniform(-7, 7, (50, 3)):
        turned = rotation_about(z, yaw) @ rotation_about(y, pitch) @ rotation_about(x, roll)
        np.testing.assert_allclose(rotation_from_rpy((roll, pitch, yaw)), turned, rtol=0, atol=1e-15)


@pytest.mark.nojit
def test_a_rotation_about_an_axis_keeps_it_and_turns_the_others():
    rng = np.random.default_rng(1)
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    angles = rng.uniform(-7, 7, (4, 5))
    E = rotation_about(axis, angles)
    across = np.cross(axis, [0.3, 0.5, -0.7])
    turned = np.cos(angles)[..., None] * across + np.sin(angles)[..., None] * np.cross(axis, across)
    np.testing.assert_allclose(E @ axis, np.broadcast_to(axis, (4, 5, 3)), rtol=0, atol=1e-15)
    np.testing.assert_allclose(E @ across, turned, rtol=0, atol=1e-15)
    assert (E[2, 3] == rotation_about(axis, angles[2, 3])).all()


def test_quarter_turns_and_coordinate_axes_are_exact():
    assert (rotation_from_rpy((0.0, 0.0, 0.0)) == np.eye(3)).all()
    assert (rotation_about((0.0, 1.0, 0.0), 0.0) == np.eye(3)).all()
    assert rotation_about((0.0, 0.0, 1.0), math.pi / 2)[1, 0] == 1.0
    for axis in (*np.eye(3), *-np.eye(3)):
        Q = rotation_z_to(axis)
        assert (Q[:, 2] == axis).all()
        assert (np.sort(np.abs(Q), axis=None) == [0, 0, 0, 0, 0, 0, 1, 1, 1]).all()
        assert np.linalg.det(Q) == 1.0


def test_sums_in_order_are_the_products_of_linear_algebra():
    rng = np.random.default_rng(2)
    A, B, v = rng.normal(size=(6, 4, 3, 3)), rng.normal(size=(4, 3, 3)), rng.normal(size=(4, 3))
    np.testing.assert_allclose(product(A, B), A @ B, rtol=0, atol=1e-14)
    np.testing.assert_allclose(applied(A, v), (A @ v[..., None])[..., 0], rtol=0, atol=1e-14)


@pytest.mark.nojit
def test_sine_and_cosine_are_numbers_or_arrays_as_given():
    angles = np.linspace(-9, 9, 12).reshape(3, 4)
    sine, cosine = sincos(angles)
    assert (type(sine), sine.shape) == (np.ndarray, (3, 4))
    assert (sine[1, 2], cosine[1, 2]) == sincos(angles[1, 2])
    assert sincos(0) == (0.0, 1.0)
    assert np.isnan(sincos(2 * SINCOS_LIMIT)).all()


def test_an_angle_too_large_to_have_an_exact_sine_is_refused():
    with pytest.raises(ValueError, match=r"joint 'hip': rpy is 300000\.0 rad; at most 205887 rad: subtract whole"):
        Joint("hip", "continuous", "a", "b", rpy=(0.0, 3e5, 0.0))
    tree = random_tree(1, 0, prismatic=0.0)
    tree = replace(tree, joints=(replace(tree.joints[0], type="continuous"),))
    with pytest.raises(ValueError, match=r"locked joint 'joint1': position is -300000.0 rad; at most 205887 rad"):
        replace(tree, locked={"joint1": -3e5})


@pytest.mark.parametrize("base", ["fixed", "floating"])
def test_bodies_carry_every_link_once_and_all_of_the_mass(base):
    for seed in range(5):
        model = partly_held(seed, base)
        bodies, placements = rigid_bodies(model)
        assert sorted(name for body in bodies for name in body.links) == sorted(link.name for link in model.links)
        assert [body.links for body in bodies] == [
            tuple(name for name, place in placements.items() if place.row == row) for row in range(len(bodies))
        ]
        assert {body.frame.joint for body in bodies[1:]} == set(model.moving_joints)
        assert math.fsum(body.mass for body in bodies) == pytest.approx(model.mass, rel=1e-15)


def test_chains_come_in_one_piece_and_parents_first():
    tree = random_tree(30, 3)
    order = depth_first(replace(tree, joints=tree.joints[::-1]))
    placed = {"body0"}
    for before, joint in zip([None, *order], order):
        assert joint.parent in placed
        placed.add(joint.child)
        leaf = before is not None and before.child not in {j.parent for j in order}
        assert before is None or leaf or joint.parent == before.child
    assert len(placed) == 31


@pytest.mark.parametrize("name", robot_names())
def test_robots_along_the_axes_keep_exact_entries(name):
    model = load_robot(name, locked=())
    if any(any(joint.rpy) for joint in model.joints):
        assert name == "omni_robot"  # its axles are 120 degrees apart
        return
    assert set(np.abs(compile_tree(model).bodies.E).flat) == {0.0, 1.0}
