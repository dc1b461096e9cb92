"""Grippers that grasp, lift, hold and let go: the Panda of example_robot_data, and two fingers in closed form."""

from dataclasses import replace

import mujoco
import numpy as np
import published
import pytest
from scenes import rotations
from touching import G, law_of, obstacle, placed

from featherstone_gait.dynamics import forward_kinematics
from featherstone_gait.dynamics.inverse_kinematics import Target, inverse_kinematics
from featherstone_gait.model import Controller, Joint, Link, Mimic, Model, Servo
from featherstone_gait.model.pair_contact import PairContact
from featherstone_gait.model.placed import Placed, SceneModel
from featherstone_gait.model.shapes import Box, Shape
from featherstone_gait.robot_file import load_robot
from featherstone_gait.robot_file.scene import save_scene
from featherstone_gait.run.reference import Reference
from featherstone_gait.run.simulate import initial_state, simulate
from featherstone_gait.scene.compile import compile_scene

pytestmark = [pytest.mark.long, pytest.mark.filterwarnings("ignore::featherstone_gait.robot_file.RobotFileWarning")]

RECORD = ("q", "base_q", "base_qd", "pair", "pair_force", "pair_normal_force", "pair_gap")
OPEN, SQUEEZE, MASS = 0.04, 20.0, 0.1  # width of half an open gripper [m], force of its drive [N], the cube's [kg]
CLOSE, LIFT, UP, LATE, LET_GO = 0.1, 0.5, 1.5, 3.0, 63.0  # times [s]
DOWN = np.diag([1.0, -1.0, -1.0])
TIP = 0.0584 + 0.04525  # from the hand to the middle of its finger tips [m]


# ---------------------------------------------------------------------------------------------- Panda


def panda():
    """The robot, whose drives hold its arm stiffly and press its fingers, of which one follows the other."""
    folder = published.folder("example-robot-data") / "panda_description"
    robot = load_robot(folder / "urdf/panda.urdf", base="fixed", srdf=folder / "srdf/panda.srdf")
    held = Servo(Controller("pd_clamped", Kp=1e5, Kd=1e3))
    pressed = Servo(Controller("pd", Kp=2e4, Kd=200.0, torque_limit=SQUEEZE))
    arm = {name: held for name in robot.joint_names if "finger" not in name}
    return replace(robot, servos={**arm, "panda_finger_joint1": pressed})


def over(robot, height, q0):
    """Posture in which the finger tips are at a height [m], half a meter in front."""
    found = inverse_kinematics(robot, Target("panda_hand", (0.5, 0.0, height + TIP), DOWN), q0,
                               joints=[name for name in robot.joint_names if "finger" not in name])  # fmt: skip
    assert found.ok
    return found.q


def bench():
    """The Panda over a cube on a table, its posture there and 0.2 m higher."""
    robot = panda()
    q = np.array([0.0, -0.3, 0.0, -2.4, 0.0, 2.1, 0.785, OPEN, OPEN])
    low = over(robot, 0.22, q)
    cube = placed(Box((0.04, 0.04, 0.04)), MASS, "cube", (0.5, 0.0, 0.22))
    table = obstacle(Box((0.4, 0.4, 0.2)), "table", (0.5, 0.0, 0.1))
    law = PairContact(friction=0.5)
    return SceneModel("bench", [Placed(robot, "panda"), cube], [table], pairs=law), low, over(robot, 0.42, low)


def grasping(low, high):
    """Close, lift, hold for a minute, open."""
    knots = [(0.0, low, OPEN), (CLOSE, low, OPEN), (LIFT, low, 0.0), (UP, high, 0.0), (LET_GO, high, 0.0),
             (LET_GO + 0.1, high, OPEN)]  # fmt: skip
    values = [[*posture[:7], finger, finger] for _, posture, finger in knots]
    return Reference([knot[0] for knot in knots], values)


def in_hand(scene, run):
    """Position [m] and rotation of the cube in the frame of the hand, by record: (n, 12)."""
    poses = forward_kinematics(scene.members[0].model, run.of("panda")["q"], "panda_hand")
    cube = run.of("cube")["base_q"]
    at = np.einsum("nji,nj->ni", poses.rotation, cube[:, :3] - poses.position)
    turn = np.einsum("nji,njk->nik", poses.rotation, rotations(cube[:, 3:]))
    return np.concatenate([at, turn.reshape(-1, 9)], axis=1)


@pytest.fixture(scope="module")
def grasp():
    scene, low, high = bench()
    compiled = compile_scene(scene, "standard")
    how, start = grasping(low, high), initial_state(compiled, {"panda": low})
    held = simulate(compiled, LET_GO, start, how, record=RECORD, record_interval=0.02)
    gone = simulate(compiled, 0.25, held, how, record=RECORD, record_interval=1e-3)
    return scene, held, gone


def test_a_panda_lifts_a_cube_and_holds_it_for_a_minute(grasp):
    """It slips by less than a micrometer, and each finger presses with half of the drive's force."""
    scene, held, _ = grasp
    assert held.ok, held.message
    late = held["time"] >= LATE
    assert held.of("cube")["base_q"][late, 2].min() > 0.41
    slip = in_hand(scene, held)[late]
    assert np.abs(slip - slip[0]).max() < 1e-6
    for finger in ("leftfinger", "rightfinger"):
        force = held.contact(f"panda/panda_{finger}", "cube")
        np.testing.assert_allclose(force.normal_force[late], 0.5 * SQUEEZE, rtol=1e-6)
    both = held.contact("cube", "panda").force[late]
    np.testing.assert_allclose(both, np.tile([0.0, 0.0, MASS * G], (len(both), 1)), atol=1e-6)
    assert not held.contact("cube", "table").touching[late].any()


def test_what_it_lets_go_falls(grasp):
    """From the moment at which no finger touches it: g t^2 / 2, and it does not turn."""
    _, _, gone = grasp
    assert gone.ok, gone.message
    cube, time, touch = gone.of("cube"), gone["time"], gone.contact("cube")
    free = ~touch.touching & (time > time[0])
    first = int(np.argmax(free))
    fall = slice(first, first + 100)
    assert free[fall].all()
    assert time[first] - time[0] < 0.06
    t, z, v = time[fall] - time[first], cube["base_q"][fall, 2], cube["base_qd"][first, 2]
    np.testing.assert_allclose(z, z[0] + v * t - 0.5 * G * t * t, atol=1e-9)
    assert -G * (time[first] - time[0]) <= v <= 0.0
    np.testing.assert_allclose(cube["base_qd"][fall, 3:], np.tile(cube["base_qd"][first, 3:], (100, 1)), atol=1e-9)


def test_a_panda_in_mujoco_presses_as_hard_and_drops_nothing(tmp_path):
    """MuJoCo runs the same scene, saved as MJCF, with the same reference; its friction lets the cube creep."""
    scene, low, high = bench()
    save_scene(scene, tmp_path / "bench.xml")
    m = mujoco.MjModel.from_xml_path(str(tmp_path / "bench.xml"))
    m.opt.timestep, m.opt.cone, m.opt.impratio = 1e-3, mujoco.mjtCone.mjCONE_ELLIPTIC, 10.0
    m.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST  # whose drives do not ring
    d, how = mujoco.MjData(m), grasping(low, high)
    names = [m.joint(m.actuator_trnid[k, 0]).name.partition("/")[2] for k in range(m.nu)]
    order = [scene.members[0].model.joint_names.index(name) for name in names]
    for name, x in zip(scene.members[0].model.joint_names, low):
        d.joint(f"panda/{name}").qpos[0] = x
    while d.time < 5.0:
        d.ctrl[:] = [np.interp(d.time, how.times, how.values[:, k]) for k in order]
        mujoco.mj_step(m, d)
    cube, pressed, force = m.body("cube/body").id, dict.fromkeys(("left", "right"), 0.0), np.zeros(6)
    for k in range(d.ncon):
        bodies = m.geom_bodyid[d.contact[k].geom]
        if cube in bodies:
            mujoco.mj_contactForce(m, d, k, force)
            (other,) = set(bodies.tolist()) - {cube}
            pressed["left" if "left" in m.body(other).name else "right"] += force[0]
    assert d.body("cube/body").xpos[2] > 0.41
    assert pressed["left"] == pytest.approx(0.5 * SQUEEZE, rel=1e-3)
    assert pressed["right"] == pytest.approx(0.5 * SQUEEZE, rel=1e-3)


# ---------------------------------------------------------------------------------------------- two fingers


def two_fingers(friction, squeeze=SQUEEZE):
    """A cube between two fingers that a drive presses together, each with half of its force."""
    links = [Link(name, 0.1, inertia=(1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4)) for name in ("palm", "left", "right")]
    joints = [
        Joint("left", "prismatic", "palm", "left", axis=(0.0, -1.0, 0.0), lower=0.0, upper=OPEN),
        Joint("right", "prismatic", "palm", "right", axis=(0.0, 1.0, 0.0), lower=0.0, upper=OPEN, mimic=Mimic("left")),
    ]
    pads = [Shape(name, Box((0.02, 0.01, 1.0)), xyz=(0.0, side * 0.005, 0.0)) for name, side in
            (("left", -1.0), ("right", 1.0))]  # fmt: skip
    drive = Servo(Controller("pd", Kp=1e5, Kd=100.0, torque_limit=squeeze))
    hand = Model("hand", tuple(links), tuple(joints), servos={"left": drive}, shapes=tuple(pads))
    cube = placed(Box((0.04, 0.04, 0.04)), MASS, "cube")
    law = PairContact(friction=friction, penetration=1e-5, load=0.5 * SQUEEZE / G)
    return compile_scene(SceneModel("grip", [Placed(hand), cube]), "standard", pairs=law)


@pytest.mark.parametrize("share", [0.5, 0.98, 1.02])
def test_two_fingers_hold_what_their_friction_carries(share):
    """It carries mu times the force of the drive; else the cube falls with what is left of g."""
    friction = share * MASS * G / SQUEEZE
    scene = two_fingers(friction)
    pressed = 0.02 - 0.5 * SQUEEZE / (4 * law_of(scene)[0])
    start = initial_state(scene, {"hand": [pressed, pressed]})
    run = simulate(scene, 0.3, start, Reference([0.0], [[0.0, 0.0]]), record=RECORD, record_interval=1e-3, rtol=1e-6)
    assert run.ok, run.message
    late, v = run["time"] > 0.1, run.of("cube")["base_qd"][:, 2]
    if share > 1.0:
        assert np.abs(v[late]).max() < 1e-9
    else:
        rate = np.polyfit(run["time"][late], v[late], 1)[0]
        assert rate == pytest.approx(-(1.0 - share) * G, rel=1e-3)
