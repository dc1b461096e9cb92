"""The robots that come with the package have the figures that their sources state."""

import math

import numpy as np
import pytest

from featherstone_gait.model import inertia_matrix
from featherstone_gait.robot_file import gearbox_presets, load_robot, load_servo, robot_names, save_robot

G = 9.81  # [m/s^2]
NAMES = ("arm7", "arm7_spatial", "ax12_arm", "ax12_whole_arm", "humanoid")
OF_SCENES = ("balancer", "blimp", "line_follower", "omni_robot", "rov")  # test_packaged_scenes.py says how they move
LEG = ("hip_rotation", "hip_lateral", "hip_front", "knee", "ankle_front", "ankle_lateral")
ARM = ("front_shoulder", "lateral_shoulder", "elbow")
TURNED_BY_MIRRORING = ("hip_rotation", "hip_lateral", "ankle_lateral", "lateral_shoulder", "elbow")

# The scene that the humanoid comes from (SimTwo, bioloid2.xml): mass, center (left or middle), size of each box.
BOXES = {
    "trunk": (0.635, (-0.040, 0.000, 0.010), (0.082, 0.102, 0.137)),
    "left_hip_bracket": (0.143, (-0.035, 0.033, -0.085), (0.070, 0.038, 0.049)),
    "left_thigh": (0.168, (-0.030, 0.033, -0.120), (0.030, 0.048, 0.090)),
    "left_hip_cross": (0.005, (-0.055, 0.032, -0.103), (0.020, 0.020, 0.020)),
    "left_shank": (0.082, (-0.030, 0.033, -0.200), (0.049, 0.047, 0.101)),
    "left_ankle_block": (0.143, (-0.035, 0.033, -0.240), (0.070, 0.038, 0.049)),
    "left_foot": (0.039, (-0.035, 0.032, -0.280), (0.100, 0.060, 0.033)),
    "left_shoulder_block": (0.082, (-0.020, 0.078, 0.043), (0.050, 0.034, 0.038)),
    "left_upper_arm": (0.080, (-0.020, 0.078, 0.000), (0.038, 0.032, 0.040)),
    "left_forearm": (0.102, (-0.020, 0.078, -0.074), (0.037, 0.032, 0.126)),
    "head": (0.100, (-0.020, 0.000, 0.115), (0.030, 0.030, 0.040)),
}


def box(mass, size):
    """ixx ixy ixz iyy iyz izz of a uniform box [kg m^2]."""
    x, y, z = np.square(size)
    return tuple(mass / 12 * np.array([y + z, 0, 0, x + z, 0, x + y]))


def turn(axis, angle):
    """Rotation matrix about a unit axis by the right-hand rule: exp of the cross product's matrix."""
    x, y, z = axis
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * K + (1 - math.cos(angle)) * K @ K


def poses(robot, q=None):
    """Rotation and origin of every link in the root link; joints at q {name: rad}, else at zero; every rpy is 0."""
    root = ({link.name for link in robot.links} - {joint.child for joint in robot.joints}).pop()
    at = {root: (np.eye(3), np.zeros(3))}
    for joint in robot.joints:
        E, r = at[joint.parent]
        assert joint.rpy == (0.0, 0.0, 0.0)
        at[joint.child] = E @ turn(joint.axis, (q or {}).get(joint.name, 0.0)), r + E @ np.array(joint.xyz)
    return at


def centers(robot, q=None):
    at = poses(robot, q)
    return {link.name: at[link.name][1] + at[link.name][0] @ np.array(link.center_of_mass) for link in robot.links}


def about_first_joint(robot):
    """Inertia about the axis of the first joint [kg m^2] and m g d of the robot's moving part, hanging [N m]."""
    center, axis = centers(robot), np.array(robot.joints[0].axis)
    moving = [link for link in robot.links if link.mass > 0]
    inertia = sum(
        axis @ inertia_matrix(link.inertia) @ axis + link.mass * np.sum(np.cross(axis, center[link.name]) ** 2)
        for link in moving
    )
    return inertia, -G * sum(link.mass * center[link.name][2] for link in moving)


@pytest.fixture(scope="module")
def humanoid():
    return load_robot("humanoid")


def test_these_robots_come_with_the_package():
    assert robot_names() == tuple(sorted((*NAMES, *OF_SCENES)))


@pytest.mark.parametrize("name", [*NAMES, *OF_SCENES])
def test_every_robot_survives_saving(tmp_path, name):
    robot = load_robot(name)
    save_robot(robot, tmp_path / "again.urdf")
    again = load_robot(tmp_path / "again.urdf")
    for part in ("name", "links", "joints", "base", "locked", "servos", "contacts", "immersed", "propellers"):
        assert getattr(again, part) == getattr(robot, part)


@pytest.mark.parametrize("name", NAMES)
def test_every_joint_has_the_same_servo_and_only_visual_shapes_are_skipped(name):
    robot = load_robot(name)
    assert all(note.startswith("skipped <visual>") for note in robot.notes)
    assert set(robot.servos) == set(robot.joint_names)
    assert all(servo == load_servo("ax12") for servo in robot.servos.values())


def test_arm7_is_seven_upright_links_on_parallel_axes():
    robot = load_robot("arm7")
    assert (robot.base, robot.nv) == ("fixed", 7)
    assert {joint.axis for joint in robot.joints} == {(0.0, 1.0, 0.0)}
    assert all(joint.upper == -joint.lower == pytest.approx(2 * math.pi) for joint in robot.joints)
    for k, link in enumerate(robot.links[1:]):
        assert link.mass == 0.1
        assert link.inertia == pytest.approx(box(0.1, (0.03, 0.03, 0.1)), rel=1e-8)
        assert centers(robot)[link.name] == pytest.approx((0, 0, 0.1 * k + 0.05), abs=1e-12)


def test_arm7_needs_2_4_newton_meters_per_radian_to_stand():
    """An inverted pendulum stands if the stiffness of its base exceeds m g z of its center of mass."""
    assert about_first_joint(load_robot("arm7"))[1] == pytest.approx(-2.40, abs=0.005)


def test_arm7_spatial_has_the_numbers_of_the_benchmark():
    robot = load_robot("arm7_spatial")
    assert (robot.base, robot.nv) == ("fixed", 7)
    for k, (link, joint) in enumerate(zip(robot.links[1:], robot.joints)):
        assert (link.mass, link.center_of_mass) == (0.075, (0.003, -0.002, 0.034))
        assert link.inertia == (3.84765625e-05, 0, 0, 3.48765625e-05, 0, 1.64e-05)
        assert joint.axis == ((0, 1, 0), (1, 0, 0))[k % 2]
        assert joint.xyz == (0, 0, 0.0675 if k else 0)
        assert (joint.type, joint.lower, joint.upper, joint.effort, joint.velocity) == ("revolute", -1e3, 1e3, 1e3, 1e3)
        assert joint.parent == robot.links[k].name


@pytest.mark.parametrize(
    ("name", "mass", "inertia", "moment"),
    [("ax12_arm", 0.102, 2.76e-4, 0.0360), ("ax12_whole_arm", 0.182, 1.50e-3, 0.138)],
)
def test_the_single_servo_arms_have_the_stated_inertia_and_moment(name, mass, inertia, moment):
    robot = load_robot(name)
    assert robot.mass == pytest.approx(mass, abs=1e-12)
    assert robot.nv == 1
    I, mgd = about_first_joint(robot)
    assert I == pytest.approx(inertia, rel=2e-3)
    assert mgd == pytest.approx(moment, rel=3e-3)
    hanging, raised = centers(robot)["forearm"], centers(robot, {robot.joints[0].name: math.pi / 2})["forearm"]
    assert hanging[:2] == pytest.approx((0, 0), abs=1e-12)
    assert raised == pytest.approx((-hanging[2], 0, 0), abs=1e-12)


def test_the_humanoid_has_the_mass_height_and_center_of_its_source(humanoid):
    assert humanoid.base == "floating"
    assert len(humanoid.joints) == len(humanoid.joint_names) == 19
    assert humanoid.mass == pytest.approx(2.423, abs=1e-12)
    center = sum(link.mass * centers(humanoid)[link.name] for link in humanoid.links) / humanoid.mass
    assert center == pytest.approx((-0.031, 0.0, -0.074), abs=5e-4)
    sole = min((poses(humanoid)[p.link][1] + p.position)[2] for p in humanoid.contacts)
    assert center[2] - sole == pytest.approx(0.2225, abs=1e-4)
    assert 0.135 - sole == pytest.approx(0.4315, abs=1e-12)  # 0.135: the top of the head's box


def test_the_humanoids_links_are_the_boxes_of_its_source(humanoid):
    at = centers(humanoid)
    for link in humanoid.links:
        mass, center, size = BOXES[link.name.replace("right", "left")]
        side = -1 if link.name.startswith("right") else 1
        assert link.mass == mass
        assert link.inertia == pytest.approx(box(mass, size), rel=1e-8)
        assert at[link.name] == pytest.approx((center[0], side * center[1], center[2]), abs=1e-12)


def test_the_humanoids_legs_have_the_lengths_of_its_source(humanoid):
    for side in ("left", "right"):
        at = {name: poses(humanoid)[f"{side}_{name}"][1] for name in ("thigh", "shank", "ankle_block", "foot")}
        sole = {point.position[2] for point in humanoid.contacts if point.link == f"{side}_foot"}
        assert np.linalg.norm(at["shank"] - at["thigh"]) == pytest.approx(0.069, abs=5e-4)
        assert np.linalg.norm(at["ankle_block"] - at["shank"]) == pytest.approx(0.078, abs=5e-4)
        assert sole == {-0.0495}
        assert at["thigh"][2] - at["foot"][2] - sole.pop() == pytest.approx(0.1935, abs=1e-12)
        assert {abs(r[1]) for r in at.values()} == {0.032}  # half the spacing of the hips, 0.064 m


def test_the_humanoids_soles_are_rectangles_centered_sideways_under_the_ankle(humanoid):
    for side in ("left", "right"):
        corners = np.array([point.position for point in humanoid.contacts if point.link == f"{side}_foot"])
        assert len(np.unique(corners, axis=0)) == 4
        assert np.ptp(corners, axis=0) == pytest.approx((0.1, 0.06, 0.0), abs=1e-12)
        assert corners.mean(axis=0) == pytest.approx((-0.013, 0.0, -0.0495), abs=1e-12)


def test_the_humanoids_left_and_right_mirror_each_other(humanoid):
    links = {link.name: link for link in humanoid.links}
    joints = {joint.name: joint for joint in humanoid.joints}
    flip = np.array([1, -1, 1])
    for name in (name for name in links if name.startswith("left")):
        left, right = links[name], links[name.replace("left", "right")]
        assert left.mass == right.mass
        assert np.array_equal(left.center_of_mass * flip, right.center_of_mass)
        assert np.array_equal(left.inertia * np.array([1, -1, 1, 1, -1, 1]), right.inertia)
    for name in (*LEG, *ARM):
        left, right = joints[f"left_{name}"], joints[f"right_{name}"]
        assert np.array_equal(left.xyz * flip, right.xyz)
        assert left.axis == right.axis
        reversed_ = name in TURNED_BY_MIRRORING
        assert (right.lower, right.upper) == ((-left.upper, -left.lower) if reversed_ else (left.lower, left.upper))
    soles = {side: {p.position for p in humanoid.contacts if p.link == f"{side}_foot"} for side in ("left", "right")}
    assert soles["right"] == {(x, -y, z) for x, y, z in soles["left"]}


def test_a_mirrored_posture_is_the_same_angles_with_the_stated_signs(humanoid):
    rng = np.random.default_rng(1)
    q = {f"{side}_{name}": rng.uniform(-1, 1) for side in ("left", "right") for name in (*LEG, *ARM)}
    other = {"left": "right", "right": "left"}

    def mirrored(name):
        side, _, rest = name.partition("_")
        return q[f"{other[side]}_{rest}"] * (-1 if rest in TURNED_BY_MIRRORING else 1)

    here, there = centers(humanoid, q), centers(humanoid, {name: mirrored(name) for name in q})
    for name, point in here.items():
        side, _, rest = name.partition("_")
        twin = f"{other[side]}_{rest}" if side in other else name
        assert there[twin] == pytest.approx(point * [1, -1, 1], abs=1e-12)


@pytest.mark.parametrize(
    ("joint", "degrees", "link", "direction"),
    [
        ("left_lateral_shoulder", -45, "left_forearm", (0, 1, 1)),  # Table 3 of the paper: both raise the arm outwards
        ("right_lateral_shoulder", 25, "right_forearm", (0, -1, 1)),
        ("right_front_shoulder", 25, "right_forearm", (1, 0, 1)),
        ("left_elbow", 45, "left_forearm", (0, -1, 1)),
        ("left_hip_front", 30, "left_foot", (1, 0, 1)),
        ("left_knee", -90, "left_foot", (-1, 0, 1)),
        ("left_hip_lateral", -30, "left_foot", (0, 1, 1)),
    ],
)
def test_a_positive_angle_moves_the_limb_the_way_its_comment_says(humanoid, joint, degrees, link, direction):
    limits = next(j for j in humanoid.joints if j.name == joint)
    assert limits.lower <= math.radians(degrees) <= limits.upper
    moved = centers(humanoid, {joint: math.radians(degrees)})[link] - centers(humanoid)[link]
    for step, sign in zip(moved, direction):
        assert sign == 0 or sign * step > 1e-3


@pytest.mark.parametrize(
    ("joint", "point", "direction"),
    [("left_ankle_front", (1, 0, 0), (0, 0, 1)), ("left_ankle_lateral", (0, 0, -1), (0, -1, 0)),
     ("left_hip_rotation", (1, 0, 0), (0, -1, 0)), ("neck", (1, 0, 0), (0, -1, 0))],
)  # fmt: skip
def test_a_positive_angle_turns_the_body_the_way_its_comment_says(humanoid, joint, point, direction):
    """Toes up; sole to the right; toes to the right; face to the right."""
    axis = next(j.axis for j in humanoid.joints if j.name == joint)
    assert (turn(axis, 0.1) @ point) @ direction == pytest.approx(math.sin(0.1))


def test_a_crouch_with_flat_feet_is_legal_and_keeps_the_foot_below(humanoid):
    """Hip, knee and ankle angles that add up to zero leave the sole level."""
    q = {"left_hip_front": 0.6, "left_knee": -1.2, "left_ankle_front": 0.6}
    limits = {joint.name: (joint.lower, joint.upper) for joint in humanoid.joints}
    assert all(limits[name][0] < angle < limits[name][1] for name, angle in q.items())
    E, r = poses(humanoid, q)["left_foot"]
    assert pytest.approx(np.eye(3), abs=1e-12) == E
    assert poses(humanoid)["left_foot"][1][2] + 0.01 < r[2] < 0
    spread = {"left_hip_lateral": -0.5, "left_ankle_lateral": 0.5}
    assert pytest.approx(np.eye(3), abs=1e-12) == poses(humanoid, spread)["left_foot"][0]


def test_the_humanoids_limits_are_those_of_its_source(humanoid):
    degrees = {
        "left_hip_rotation": (-75, 75), "left_hip_lateral": (-90, 90), "left_hip_front": (-75, 75),
        "left_knee": (-98, 32), "left_ankle_front": (-10, 125), "left_ankle_lateral": (-30, 100),
        "left_front_shoulder": (-120, 120), "left_lateral_shoulder": (-160, 10), "left_elbow": (-90, 90),
        "right_lateral_shoulder": (-10, 160), "neck": (-150, 150),
    }  # fmt: skip
    joints = {joint.name: joint for joint in humanoid.joints}
    for name, limits in degrees.items():
        assert np.degrees((joints[name].lower, joints[name].upper)) == pytest.approx(limits, abs=1e-12)


def test_the_simplified_humanoid_moves_five_joints_a_leg(humanoid):
    simplified = load_robot("humanoid", locked="simplified")
    moving = [f"{side}_{name}" for side in ("left", "right") for name in LEG if name != "hip_rotation"]
    assert list(simplified.joint_names) == moving
    assert (simplified.nq, simplified.nv) == (17, 16)
    assert set(simplified.locked.values()) == {0.0}
    assert simplified.links == humanoid.links


def test_the_ax12_reaches_the_figures_of_its_data_sheet():
    """Torque at the current limit and speed without load, against 16.5 kgf cm and 0.196 s a 60 deg at 10 V."""
    servo = load_servo("ax12", "standard")
    G_K, R, V = servo.gearbox.ratio * servo.motor_constant, servo.resistance, servo.voltage_limit
    assert G_K * servo.current_limit == pytest.approx(1.5567, abs=1e-4)
    assert G_K * servo.current_limit == pytest.approx(16.5e-2 * 9.80665, rel=0.04)
    free = G_K * V / R / (G_K**2 / R + servo.viscous_friction)
    assert free == pytest.approx(5.590, abs=1e-3)
    assert free == pytest.approx(math.radians(60) / 0.196, rel=0.05)
    assert servo.inductance / R == pytest.approx(0.625e-3)


def test_the_ax12s_controller_gives_full_voltage_over_the_compliance_slope():
    servo = load_servo("ax12")
    assert servo.controller.Kp == pytest.approx(servo.voltage_limit / math.radians(32 * 0.293), rel=2e-3)
    assert servo.speed_filter == pytest.approx(-1e-3 / math.log(0.95), abs=1e-6)
    assert servo.current_slew == pytest.approx(0.15 / 1e-3)


def test_the_gearbox_presets_are_readings_of_the_papers_two_numbers():
    presets = gearbox_presets("ax12")
    ratio, K_s, K_B = 254.0, 1e-5, 1e-4
    assert {gearbox.ratio for gearbox in presets.values()} == {ratio}
    readings = {name: (gearbox.stiffness, gearbox.damping) for name, gearbox in presets.items()}
    assert readings["paper_literal"] == pytest.approx((K_s, K_B))
    assert readings["paper_rotor_side"] == pytest.approx((K_s * ratio**2, K_B * ratio**2))
    assert readings["code_2012"] == pytest.approx((K_s * ratio, K_B * ratio**2))
    assert readings["physical"] == (25.0, 0.05)
    assert readings["standard"] == (math.inf, 0.0)
    inertias = {name: gearbox.rotor_inertia for name, gearbox in presets.items()}
    assert inertias.pop("standard") == 0.0
    assert set(inertias.values()) == {1e-7}
