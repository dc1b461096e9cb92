"""Robots that others publish stand on the feet that are found: those of the packages `example-robot-data`, `playground`
and `pybullet_data`, as far as they are installed, and our own without its TOML.
"""

import shutil
from dataclasses import replace

import mujoco
import numpy as np
import published
import pytest

from featherstone_gait import (
    Ground,
    Reference,
    center_of_mass,
    compile_scene,
    contact_positions,
    forward_kinematics,
    initial_state,
    load_robot,
    nearest_posture,
    simulate,
)
from featherstone_gait.geometry.contact_choice import lowest_levels
from featherstone_gait.geometry.distance import meeting_shapes
from featherstone_gait.robot_file.source import robots_folder
from featherstone_gait.walking.zero_moment_point import polygon_margin, support_polygon

pytestmark = pytest.mark.filterwarnings("ignore::featherstone_gait.robot_file.RobotFileWarning")

STAND = [  # file, what the names of the feet end in, how many they are, whether it takes the reader of meshes
    ("a1/a1.urdf", "_toe", 4, False),
    ("aliengo/aliengo.urdf", "_toe", 4, False),
    ("mini_cheetah/mini_cheetah.urdf", "", 4, True),
    ("a1_description/urdf/a1.urdf", "_foot", 4, False),
    ("b1_description/urdf/b1.urdf", "_foot", 4, False),
    ("go1_description/urdf/go1.urdf", "_foot", 4, False),
    ("go2_description/urdf/go2.urdf", "_foot", 4, True),
    ("g1_description/urdf/g1_29dof_rev_1_0.urdf", "_ankle_roll_link", 2, True),
    ("solo_description/robots/solo12.urdf", "_FOOT", 4, True),
    ("anymal_b_simple_description/robots/anymal.urdf", "_FOOT", 4, False),
]


def margin(robot):
    """How far inside the lowest points the center of mass lies at rest [m]."""
    q = nearest_posture(robot)
    levels = lowest_levels(robot, robot.contacts, forward_kinematics(robot, q))
    low = contact_positions(robot, q)[levels < levels.min() + 1e-3, :2]
    return polygon_margin(center_of_mass(robot, q)[:2], support_polygon(low))


@pytest.mark.parametrize(("name", "ending", "count", "meshes"), STAND, ids=[row[0] for row in STAND])
def test_a_published_robot_has_its_center_of_mass_over_its_feet(name, ending, count, meshes):
    path = published.folder("example-robot-data" if "_description" in name else "pybullet_data") / name
    if meshes:
        pytest.importorskip("trimesh")
        pytest.importorskip("collada")
    robot = load_robot(path, base="floating", contacts="feet", locked="all")
    feet = {point.link for point in robot.contacts}
    assert len(feet) == count
    assert all(foot.endswith(ending) for foot in feet)
    assert robot.nq == 7
    assert margin(robot) > 0.02


KEYFRAMES = [  # robot, scene, keyframe, number of feet, points of a foot
    ("apollo", "scene_mjx_feetonly_flat_terrain", "stand", 2, 4),
    ("berkeley_humanoid", "scene_mjx_feetonly_flat_terrain", "home", 2, 4),
    ("g1", "scene_mjx_feetonly_flat_terrain", "home", 2, 4),
    ("h1", "scene_mjx_feetonly", "home", 2, 6),
    ("op3", "scene_mjx_feetonly", "stand", 2, 8),
    ("spot", "scene_mjx_feetonly_flat_terrain", "home", 4, 1),
    ("t1", "scene_mjx_feetonly_flat_terrain", "home", 2, 4),
]
LASTS = 0.5  # [s]; after it some of these robots, which only hold their joints, begin to fall


def without_meshes(path, folder):
    """Write an MJCF file without the meshes, which its package fetches elsewhere and shows only."""
    spec = mujoco.MjSpec.from_file(str(path))
    for geom in [geom for geom in spec.geoms if geom.type == mujoco.mjtGeom.mjGEOM_MESH]:
        assert (geom.contype, geom.conaffinity) == (0, 0)
        spec.delete(geom)
    for each in [*spec.meshes, *spec.sensors, *spec.textures]:
        spec.delete(each)
    for material in spec.materials:
        material.textures = [""] * 10
    spec.compile()
    (folder / "robot.xml").write_text(spec.to_xml())
    return folder / "robot.xml"


@pytest.mark.long
@pytest.mark.parametrize(("name", "scene", "keyframe", "count", "points"), KEYFRAMES, ids=[row[0] for row in KEYFRAMES])
def test_a_published_robot_stands_in_its_keyframe_as_high_as_in_mujoco(name, scene, keyframe, count, points, tmp_path):
    """Besides what its feet sink in; without dry friction, which creeps in MuJoCo."""
    folder = published.folder("mujoco_playground") / "_src" / "locomotion" / name / "xmls"
    path = without_meshes(folder / f"{scene}.xml", tmp_path)
    robot = load_robot(path, contacts="feet")
    links = [point.link for point in robot.contacts]
    assert {foot: links.count(foot) for foot in links} == dict.fromkeys(links, points)
    assert len({*links}) == count
    q = np.array(robot.keyframes[keyframe])
    robot = replace(robot, joints=tuple(replace(joint, friction=0.0) for joint in robot.joints))
    standing = compile_scene(robot, "rotor", Ground(friction=0.8))
    start, held = initial_state(standing, q), Reference([0.0], [q[7:]], "hold")
    run = simulate(standing, LASTS, start, held, record=("base_q", "q"), record_interval=LASTS)
    end = np.concatenate([run["base_q"][-1], run["q"][-1]])

    m = mujoco.MjModel.from_xml_path(str(path))
    m.dof_frictionloss[:] = 0.0
    m.opt.timestep, m.opt.cone, m.opt.impratio = 1e-3, mujoco.mjtCone.mjCONE_ELLIPTIC, 10.0
    m.opt.noslip_iterations = 20 if name == "spot" else 0  # it would creep apart on its four points
    d = mujoco.MjData(m)
    mujoco.mj_resetDataKeyframe(m, d, m.key(keyframe).id)
    mujoco.mj_step(m, d, round(LASTS / m.opt.timestep))
    depth = -min(contact.dist for contact in d.contact)
    lowest = lowest_levels(robot, robot.contacts, forward_kinematics(robot, end)).min()
    assert run.ok
    assert end[2] - lowest == pytest.approx(d.qpos[2] + depth, abs=5e-4)


def test_the_humanoid_stands_without_its_toml(tmp_path):
    path = shutil.copy(robots_folder() / "humanoid" / "humanoid.urdf", tmp_path)
    robot = load_robot(path, base="floating", contacts="feet", locked="all")
    assert {point.link for point in robot.contacts} == {"left_foot", "right_foot"}
    assert margin(robot) > 0.02


def test_the_boxes_of_the_humanoid_overlap_at_rest_only_at_the_hips():
    robot = load_robot("humanoid")
    notes = [f"links '{x}_hip_bracket' and '{x}_thigh' overlap at rest: not checked" for x in ("left", "right")]
    assert list(meeting_shapes(robot).notes) == notes
