"""Robots that others publish stand on the feet that are found: those of the packages `example-robot-data` and
`pybullet_data`, as far as they are installed, and our own without its TOML.
"""

import shutil

import published
import pytest

from featherstone_gait import (
    center_of_mass,
    contact_positions,
    forward_kinematics,
    load_robot,
    nearest_posture,
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


def test_the_humanoid_stands_without_its_toml(tmp_path):
    path = shutil.copy(robots_folder() / "humanoid" / "humanoid.urdf", tmp_path)
    robot = load_robot(path, base="floating", contacts="feet", locked="all")
    assert {point.link for point in robot.contacts} == {"left_foot", "right_foot"}
    assert margin(robot) > 0.02


def test_the_boxes_of_the_humanoid_overlap_at_rest_only_at_the_hips():
    robot = load_robot("humanoid")
    notes = [f"links '{x}_hip_bracket' and '{x}_thigh' overlap at rest: not checked" for x in ("left", "right")]
    assert list(meeting_shapes(robot).notes) == notes
