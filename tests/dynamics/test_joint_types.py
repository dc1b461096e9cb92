"""Ball, universal, planar, cylindrical, screw and free joints: their kinematics, dynamics and files."""

from dataclasses import replace

import numpy as np
import pytest
from company import in_company, simulated
from pinocchio_oracle import coordinates, pinocchio_model
from random_tree import random_box
from scipy.linalg import expm

from featherstone_gait import (
    Reference,
    RobotFileWarning,
    Session,
    Target,
    compile_scene,
    from_engine,
    initial_state,
    inverse_kinematics,
    linearize,
    load_robot,
    save_robot,
    simulate,
    to_engine,
)
from featherstone_gait.dynamics import (
    center_of_mass,
    energy,
    forward_dynamics,
    forward_kinematics,
    inverse_dynamics,
    mass_matrix,
    momentum,
)
from featherstone_gait.dynamics.jacobians import center_of_mass_jacobian, jacobian, link_index
from featherstone_gait.model import Joint, Link, Mimic, Model
from featherstone_gait.model.numpy_dynamics import link_poses, mass_matrix_at, zero_position
from featherstone_gait.walking.stance import standing

POINT = (0.03, -0.02, 0.05)
AXIS = (0.6, 0.0, 0.8)
KINDS = {
    "ball": {},
    "universal": {"axis": AXIS, "axis2": (0.0, 1.0, 0.0)},
    "planar": {"axis": AXIS},
    "cylindrical": {"axis": AXIS},
    "screw": {"axis": AXIS, "pitch": 0.02},
    "free": {},
    "revolute": {"axis": AXIS, "lower": -3.0, "upper": 3.0},
}
DEGREES = {"ball": 3, "universal": 2, "planar": 3, "cylindrical": 2, "screw": 1, "free": 6, "revolute": 1}


def chain(kinds, base="fixed", seed=0):
    """Boxes one behind the other, connected by joints of these kinds."""
    rng = np.random.default_rng(seed)
    links = [random_box(f"body{k}", rng, 3.0) for k in range(len(kinds) + 1)]
    joints = [
        Joint(
            f"{kind}{k}", kind, f"body{k}", f"body{k + 1}", tuple(rng.uniform(-0.06, 0.06, 3).tolist()),
            tuple(rng.uniform(-3.0, 3.0, 3).tolist()), **KINDS[kind],
        )
        for k, kind in enumerate(kinds)
    ]  # fmt: skip
    return Model("chain", tuple(links), tuple(joints), base)


MODELS = {
    "fixed": chain(("ball", "universal", "revolute", "planar", "screw")),
    "floating": chain(("cylindrical", "ball", "free", "screw", "ball"), "floating", 1),
}


def state(model, seed=0):
    """A posture q (nq,) with unit quaternions, and velocities (nv,)."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-1.0, 1.0, model.nq)
    for at in quaternions(model):
        q[at] /= np.linalg.norm(q[at])
    return q, rng.normal(size=model.nv)


def quaternions(model):
    """Where quaternions stand in q."""
    base = [slice(3, 7)] if model.base == "floating" else []
    return base + [model.position_slices[k] for k in model.balls]


def moved(model, q, v, dt):
    """Positions after a short time: quaternions by exp(dt omega / 2) in body axes."""
    new, joints = q.copy(), model.nv - len(model.moving_joints)
    turns = [(slice(3, 7), v[3:6])] if model.base == "floating" else []
    turns += [(model.position_slices[k], v[joints + k : joints + k + 3]) for k in model.balls]
    new[:3] += dt * v[:3] if model.base == "floating" else 0.0
    for k, (joint, place) in enumerate(zip(model.moving_joints, model.position_slices)):
        if joint.type != "ball":
            new[place] = q[place] + dt * v[joints + k]
    for at, omega in turns:
        angle = dt * np.linalg.norm(omega)
        turn = np.array([np.cos(angle / 2), *(np.sinc(angle / 2 / np.pi) * dt / 2 * omega)])
        w, x, y, z = q[at]
        new[at] = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]]) @ turn
    return new


@pytest.mark.parametrize("kind", KINDS)
def test_a_joint_has_its_degrees_of_freedom(kind):
    model = chain((kind,))
    turns = kind in ("ball", "free")
    assert (model.nv, model.nq) == (DEGREES[kind], DEGREES[kind] + turns)
    assert len(model.joint_names) == model.nv
    assert len(model.position_names) == model.nq
    assert model.q_index(model.joint_names[0]) == 0


@pytest.mark.parametrize("robot", MODELS)
def test_a_jacobian_is_the_derivative_of_the_pose(robot):
    model = MODELS[robot]
    q, _ = state(model)
    link = model.links[-1].name
    row, J, Jc = link_index(model, link), jacobian(model, q, link, POINT), center_of_mass_jacobian(model, q)
    R = forward_kinematics(model, q).rotation[row]

    def pose(at):
        poses = forward_kinematics(model, at)
        place = poses.position[row] + poses.rotation[row] @ POINT
        return np.concatenate([poses.rotation[row].ravel(), place, center_of_mass(model, at)])

    for column, v in enumerate(np.eye(model.nv)):
        values = [pose(moved(model, q, v, k * 1e-3)) for k in (-2, -1, 1, 2)]
        rate = (values[0] - 8 * values[1] + 8 * values[2] - values[3]) / 12e-3
        spin = rate[:9].reshape(3, 3) @ R.T
        assert J[:, column] == pytest.approx([spin[2, 1], spin[0, 2], spin[1, 0], *rate[9:12]], abs=1e-9)
        assert Jc[:, column] == pytest.approx(rate[12:], abs=1e-9)


@pytest.mark.quick("floating")
@pytest.mark.parametrize("robot", MODELS)
def test_dynamics_agree_with_each_other(robot):
    model = MODELS[robot]
    q, v = state(model, 1)
    tau = np.random.default_rng(2).normal(size=model.nv)
    a = forward_dynamics(model, q, v, tau)
    assert inverse_dynamics(model, q, v, a) == pytest.approx(tau, abs=1e-12 * np.abs(a).max())
    H, bias = mass_matrix(model, q), inverse_dynamics(model, q, v, np.zeros(model.nv))
    assert H @ a + bias == pytest.approx(tau, abs=1e-12 * np.abs(a).max())
    assert energy(model, q, v).kinetic == pytest.approx(0.5 * v @ H @ v, rel=1e-13)
    many = forward_dynamics(model, np.tile(q, (9, 1)), v, tau)  # in lanes
    assert np.array_equal(many, np.tile(a, (9, 1)))


def test_plain_numpy_has_the_same_poses_and_masses():
    model = MODELS["fixed"]
    q, _ = state(model, 3)
    assert link_poses(model, q).rotation == pytest.approx(forward_kinematics(model, q).rotation, abs=1e-14)
    assert link_poses(model, q).position == pytest.approx(forward_kinematics(model, q).position, abs=1e-14)
    assert mass_matrix_at(model, q, None) == pytest.approx(mass_matrix(model, q), abs=1e-14)


@pytest.mark.parametrize("robot", MODELS)
def test_accelerations_and_masses_are_those_of_pinocchio(robot):
    pin = pytest.importorskip("pinocchio", reason="needs pin, which the extra `peers` installs")
    model = MODELS[robot]
    theirs, _ = pinocchio_model(model)
    data, tau = theirs.createData(), np.random.default_rng(4).normal(size=model.nv)
    for seed in range(3):
        q, v = state(model, seed)
        p, T = coordinates(theirs, model, q)
        assert T.T @ symmetric(pin.crba(theirs, data, p)) @ T == pytest.approx(mass_matrix(model, q), abs=1e-13)
        bias = T.T @ pin.rnea(theirs, data, p, T @ v, np.zeros(theirs.nv))
        bias += _turning(model, theirs, p, T, v)
        a, scale = forward_dynamics(model, q, v, tau), np.abs(tau).max()
        assert mass_matrix(model, q) @ a + bias == pytest.approx(tau, abs=1e-10 * max(scale, np.abs(bias).max()))


def symmetric(upper):
    return np.triu(upper) + np.triu(upper, 1).T


def _turning(model, theirs, p, T, v):
    """Return M (w x v), which Pinocchio's bias lacks because its base velocity is in the base's own axes."""
    import pinocchio as pin

    if model.base == "fixed":
        return 0.0
    body, extra = T @ v, np.zeros(theirs.nv)
    extra[:3] = -np.cross(body[3:6], body[:3])
    return T.T @ symmetric(pin.crba(theirs, theirs.createData(), p)) @ extra


def top(inertia=(0.002, 0.0, 0.0, 0.002, 0.0, 0.0008)):
    """A symmetric top of 1 kg on its tip."""
    links = Link("ground"), Link("top", 1.0, (0.0, 0.0, 0.1), inertia)
    return Model("top", links, (Joint("tip", "ball", "ground", "top"),))


def test_a_spinning_top_keeps_energy_and_both_momenta():
    model, q = top(), np.array([np.cos(0.3), np.sin(0.3), 0.0, 0.0])
    run = simulated(in_company(model, "rk4", 5e-5), 6.0, q, (0.2, 0.0, 100.0), record_interval=0.1)
    assert run.success
    assert (run["q"].shape, run["qd"].shape) == ((61, 4), (61, 3))
    of = energy(model, run["q"], run["qd"])
    total = of.kinetic + of.potential
    assert total == pytest.approx(np.full(61, total[0]), rel=1e-9)
    assert run["qd"][:, 2] == pytest.approx(np.full(61, 100.0), rel=1e-9)  # about its own axis, without a moment
    R, I = forward_kinematics(model, run["q"]).rotation[:, 1], np.diag([0.012, 0.012, 0.0008])
    vertical = np.einsum("nij,jk,nk->ni", R, I, run["qd"])[:, 2]
    assert vertical == pytest.approx(np.full(61, vertical[0]), rel=1e-9)
    precession = np.unwrap(np.arctan2(-R[:, 0, 2], R[:, 1, 2]))
    assert abs(precession[-1]) > 1.0  # it has moved


def test_the_slow_precession_of_a_fast_top_is_the_closed_form():
    # of a top tilted by b: A cos b w^2 - C s w + m g l = 0, with A about the tip and s the rate about its own axis
    model, tilt, spin = top(), 0.4, 400.0
    A, C, moment = 0.012, 0.0008, 9.81 * 0.1
    a, b = A * np.cos(tilt), C * spin
    rate = (b - np.sqrt(b * b - 4 * a * moment)) / (2 * a)
    omega = (0.0, rate * np.sin(tilt), spin)
    q = np.array([np.cos(tilt / 2), np.sin(tilt / 2), 0.0, 0.0])
    run = simulated(in_company(model, "rk4", 2e-5), 2.0, q, omega, record_interval=0.01)
    axis = forward_kinematics(model, run["q"]).rotation[:, 1, :, 2]
    assert axis[:, 2] == pytest.approx(np.full(len(axis), np.cos(tilt)), abs=1e-9)
    angle = np.unwrap(np.arctan2(axis[:, 1], axis[:, 0]))
    assert (angle[-1] - angle[0]) / 2.0 == pytest.approx(rate, rel=1e-8)


def test_a_free_joint_moves_as_a_floating_base():
    alone = Model("body", (Link("body", 2.0, (0.1, 0.0, 0.2), (0.02, 0.0, 0.0, 0.03, 0.0, 0.04)),), (), "floating")
    held = Model("held", (Link("world"), *alone.links), (Joint("to", "free", "world", "body"),))
    q, v = state(alone)
    expected = forward_dynamics(alone, q, v, np.zeros(6))
    assert forward_dynamics(held, q, v, np.zeros(6)) == pytest.approx(expected, abs=1e-12)
    assert momentum(held, q, v) == pytest.approx(momentum(alone, q, v), abs=1e-13)


def test_a_screw_turns_and_slides():
    model = chain(("screw",))
    poses = forward_kinematics(model, np.array([[0.0], [2.0]]))
    way = poses.position[1, 1] - poses.position[0, 1]
    assert np.linalg.norm(way) == pytest.approx(2.0 * 0.02)
    assert way == pytest.approx(0.04 * poses.rotation[0, 1] @ np.array(AXIS))
    assert mass_matrix(model, np.zeros(1))[0, 0] > 0.0


def test_inverse_kinematics_reaches_a_pose_by_ball_joints():
    model = chain(("ball", "universal", "revolute", "ball"))
    q, _ = state(model, 5)
    goal = forward_kinematics(model, q)
    target = Target(model.links[-1].name, position=goal.position[-1], rotation=goal.rotation[-1])
    found = inverse_kinematics(model, [target])
    poses = forward_kinematics(model, found.q)
    assert found.status == "ok"
    assert poses.position[-1] == pytest.approx(goal.position[-1], abs=1e-8)
    assert poses.rotation[-1] == pytest.approx(goal.rotation[-1], abs=1e-8)
    assert [np.linalg.norm(found.q[at]) for at in quaternions(model)] == pytest.approx([1.0, 1.0])


def test_urdf_gives_the_same_numbers(tmp_path):
    model = replace(chain(tuple(KINDS)), keyframes={"bent": tuple(state(chain(tuple(KINDS)))[0].tolist())})
    save_robot(model, tmp_path / "chain.urdf")
    again = load_robot(tmp_path / "chain.urdf")
    assert again.joints == model.joints
    assert again.keyframes == model.keyframes


def test_joint_types_of_urdf(tmp_path):
    body = '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
    kinds, limit = ("planar", "floating", "spherical"), '<limit lower="-1"/>'
    links = "".join(f'<link name="{k}">{body}</link>' for k in range(4))
    joints = "".join(
        f'<joint name="{kind}" type="{kind}"><parent link="{k}"/><child link="{k + 1}"/><axis xyz="0 0 1"/>'
        f"{limit * (kind == 'spherical')}</joint>"
        for k, kind in enumerate(kinds)
    )
    path = tmp_path / "robot.urdf"
    path.write_text(f'<robot name="r">{links}{joints}</robot>', encoding="utf-8")
    with pytest.warns(RobotFileWarning, match="type 'spherical' has limits"):
        model = load_robot(path)
    assert [joint.type for joint in model.joints] == ["planar", "free", "ball"]
    assert (model.base, model.nv, model.nq) == ("fixed", 12, 14)
    assert model.joint_names[:3] == ("planar.x", "planar.y", "planar.rz")


def test_mjcf_keeps_poses_and_masses(tmp_path):
    pytest.importorskip("mujoco")
    model = chain(("ball", "universal", "revolute", "planar", "cylindrical", "free"))
    q, _ = state(model)
    model = replace(model, keyframes={"bent": tuple(q.tolist())})
    save_robot(model, tmp_path / "chain.xml")
    again = load_robot(tmp_path / "chain.xml")
    assert (again.joint_names, again.position_names) == (model.joint_names, model.position_names)
    assert again.keyframes["bent"] == pytest.approx(q)
    assert mass_matrix(again, q) == pytest.approx(mass_matrix(model, q), abs=1e-12)


def test_accelerations_of_ball_joints_are_those_of_mujoco(tmp_path):
    mujoco = pytest.importorskip("mujoco")
    model = chain(("ball", "revolute", "ball"), "floating", 2)
    save_robot(model, tmp_path / "chain.xml")
    theirs = mujoco.MjModel.from_xml_path(str(tmp_path / "chain.xml"))
    theirs.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    data = mujoco.MjData(theirs)
    tau = 0.1 * np.random.default_rng(1).normal(size=model.nv)
    for seed in range(3):
        q, v = state(model, seed)
        data.qpos[:], data.qvel[:], data.qfrc_applied[:] = q, v, tau
        mujoco.mj_forward(theirs, data)
        a = forward_dynamics(model, q, v, tau)
        assert a == pytest.approx(data.qacc, abs=1e-10 * np.abs(a).max())


def test_other_engines_write_quaternions_of_ball_joints_their_way():
    model = chain(("cylindrical", "ball", "screw", "ball"), "floating", 1)
    q, v = state(model)
    for engine in ("mujoco", "pinocchio", "drake"):
        back = from_engine(engine, model, *to_engine(engine, model, q, v))
        assert back[0] == pytest.approx(q, abs=1e-15)
        assert back[1] == pytest.approx(v, abs=1e-14)
    at = quaternions(model)[1]
    assert to_engine("pinocchio", model, q, v)[0][at] == pytest.approx(np.roll(q[at], -1))
    assert to_engine("mujoco", model, q, v)[0][at] == pytest.approx(q[at])


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"type": "ball", "lower": -1.0, "upper": 1.0}, "'ball' has limits"),
        ({"type": "planar", "stiffness": 3.0}, "stiffness"),
        ({"type": "revolute", "pitch": 0.1, "lower": -1.0, "upper": 1.0}, "pitch"),
        ({"type": "revolute", "axis2": (0.0, 1.0, 0.0), "lower": -1.0, "upper": 1.0}, "axis2"),
        ({"type": "universal", "axis2": (1.0, 0.0, 0.0)}, "parallel"),
        ({"type": "universal", "axis2": (1.0, 2.0, 0.0)}, "unit length"),
        ({"type": "gimbal"}, "'gimbal'"),
    ],
)
def test_a_joint_that_makes_no_sense_is_refused(given, says):
    with pytest.raises(ValueError, match=says):
        Joint("hip", given.pop("type"), "a", "b", **given)


def test_a_ball_joint_has_no_servo_and_is_locked_whole():
    model, servo = top(), load_robot("humanoid").servos["left_knee"]
    with pytest.raises(ValueError, match="degree of a ball joint; a servo turns one axis"):
        replace(model, servos={"tip.rx": servo})
    with pytest.raises(ValueError, match="lock all three"):
        replace(chain(("ball", "revolute")), locked={"ball0.rx": 0.0})
    held = replace(chain(("ball", "revolute")), locked=dict.fromkeys(("ball0.rx", "ball0.ry", "ball0.rz"), 0.0))
    assert held.joint_names == ("revolute1",)


@pytest.mark.long
def test_a_session_reads_and_sets_quaternions():
    model = chain(("ball", "revolute"))
    session = Session(compile_scene(model), n=2, observe=("q", "qd"))
    q, _ = state(model)
    seen = session.set_state("q", np.tile(q, (2, 1)))
    assert seen["q"] == pytest.approx(np.tile(q, (2, 1)))
    assert session.step()["q"].shape == (2, 5)


def test_what_knows_no_ball_joints_says_so():
    with pytest.raises(ValueError, match="servos that walk turn single axes, and tip are ball joints"):
        standing(top())
    with pytest.raises(ValueError, match="q has quaternions of ball joints"):
        linearize(compile_scene(top()), outputs=("q",))


@pytest.mark.long
def test_a_ball_joint_is_linearized_by_its_turns():
    # a rod that hangs by its end: three small turns, two of which swing by m g l = I w^2, and one that is free
    links = Link("ceiling"), Link("rod", 1.0, (0.0, 0.0, -0.2), (0.01, 0.0, 0.0, 0.02, 0.0, 0.001))
    model = Model("rod", links, (Joint("hang", "ball", "ceiling", "rod"),))
    scene = compile_scene(model, integrator="rk4", timestep=1e-3)
    found = linearize(scene, initial_state(scene))
    names = ["q hang.rx", "q hang.ry", "q hang.rz", "qd hang.rx", "qd hang.ry", "qd hang.rz"]
    assert list(found.states) == names
    rates = [-0.2 * 9.81 / (0.01 + 0.04), -0.2 * 9.81 / (0.02 + 0.04), 0.0]
    exact = expm(1e-3 * np.block([[np.zeros((3, 3)), np.eye(3)], [np.diag(rates), np.zeros((3, 3))]]))
    assert found.A == pytest.approx(exact, abs=1e-9)
    assert linearize(scene, initial_state(scene), outputs=("ball_q",)).outputs[1] == "ball_q hang.qx"


def test_a_file_of_ball_joints_is_loaded_with_some_locked(tmp_path):
    save_robot(chain(("ball", "revolute", "universal")), tmp_path / "chain.urdf")
    held = load_robot(tmp_path / "chain.urdf", locked=["ball0", "universal2.r1"])
    assert held.joint_names == ("revolute1", "universal2.r2")
    save_robot(held, tmp_path / "held.urdf")
    assert load_robot(tmp_path / "held.urdf").held == held.held
    with pytest.raises(ValueError, match="several degrees of freedom; hold it at 0"):
        load_robot(tmp_path / "chain.urdf", locked={"ball0": 0.3})


def test_a_universal_joint_has_servos(tmp_path):
    model, servo = chain(("revolute", "universal")), load_robot("humanoid").servos["left_knee"]
    model = replace(model, servos={"universal1.r1": servo, "universal1.r2": servo})
    save_robot(model, tmp_path / "chain.urdf")
    again = load_robot(tmp_path / "chain.urdf")
    assert again.servos == model.servos
    scene = compile_scene(again, "rotor", gravity=(0.0, 0.0, 0.0))
    run = simulate(scene, 0.5, reference=Reference([0.0], [[0.0, 0.2, -0.1]]), estimate_error=False)
    assert run["q"][-1, 1:] == pytest.approx([0.2, -0.1], abs=0.02)


def test_a_degree_of_a_ball_joint_has_no_position():
    model = chain(("ball", "revolute"))
    with pytest.raises(ValueError, match=r"'ball0.ry' has no position of its own"):
        model.q_index("ball0.ry")
    assert model.qd_index("ball0.ry") == 1
    joints = (model.joints[0], replace(model.joints[1], mimic=Mimic("ball0.rx")))
    with pytest.raises(ValueError, match="a degree of a ball joint, which has no position"):
        replace(model, joints=joints)
    with pytest.raises(ValueError, match="keyframe 'flat': the quaternion of ball joint 'ball0' is zero"):
        replace(model, keyframes={"flat": (0.0,) * 5})


def test_what_other_files_and_engines_mean_otherwise_is_told(tmp_path):
    with pytest.raises(ValueError, match="free joints free0 within the tree have other velocities in pinocchio"):
        to_engine("pinocchio", chain(("free",)), np.ones(7), np.zeros(6))
    save_robot(chain(("screw", "universal")), tmp_path / "chain.urdf")
    text = (tmp_path / "chain.urdf").read_text(encoding="utf-8")
    (tmp_path / "other.urdf").write_text(text.replace("universal", "continuous").replace('<screw pitch="0.02"/>', ""))
    with pytest.warns(RobotFileWarning, match=r"a screw without <screw pitch>.*<axis2> of a joint"):
        load_robot(tmp_path / "other.urdf")


def test_quaternions_without_direction_are_refused():
    model = top()
    scene = compile_scene(model)
    with pytest.raises(ValueError, match="quaternion of ball joint tip"):
        forward_kinematics(model, np.zeros(4))
    with pytest.raises(ValueError, match=r"q of ball joint 'tip' is .* of length 0"):
        initial_state(scene, np.zeros(4))
    assert initial_state(scene)[slice(*scene.part("ball_q"))] == pytest.approx(zero_position(model))
