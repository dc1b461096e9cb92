"""Forces on what joints carry: weights at rest, inverse dynamics in motion, MuJoCo's sensors, the ground and bodies."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import G, standing_humanoid

from featherstone_gait import (
    Box,
    ContactSensor,
    ForceTorqueSensor,
    Joint,
    Link,
    Model,
    Placed,
    Push,
    RangeSensor,
    SampledSensor,
    SceneModel,
    Shape,
    body,
    compile_scene,
    forward_kinematics,
    inverse_dynamics,
    load_robot,
    measure,
    save_robot,
    simulate,
)
from featherstone_gait.base.rotation import rotation_from_rpy

INERTIA = (3e-3, 2e-4, -1e-4, 2e-3, 3e-4, 4e-3)  # ixx, ixy, ixz, iyy, iyz, izz


def chain(*kinds):
    """A chain of joints of these kinds, each between links whose frames, centers and axes lie askew."""
    links, joints = [Link("base", 1.0, (0.0, 0.0, 0.1), INERTIA)], []
    for k, kind in enumerate(kinds):
        links.append(Link(f"link{k}", 0.5 + k, (0.1, -0.05, 0.07), INERTIA))
        axis = np.array([0.3, -0.5, 0.8 - k])
        more = {"pitch": 0.02} if kind == "screw" else {}
        if kind not in ("ball", "free", "fixed"):
            more["axis"] = tuple(axis / np.linalg.norm(axis))
        ends, place = (links[-2].name, links[-1].name), ((0.1, 0.2, 0.3), (0.4, -0.6, 0.9))
        joints.append(Joint(f"joint{k}", kind, *ends, *place, **more))
    return Model("chain", tuple(links), tuple(joints))


def moving(model, samples=4, seed=0):
    """Channels of a made-up motion, and positions, velocities and accelerations."""
    rng = np.random.default_rng(seed)
    q, qd, qdd = rng.normal(size=(samples, model.nq)), *rng.normal(size=(2, samples, model.nv))
    for names in model.position_slices:
        if names.stop - names.start == 4:
            q[:, names] /= np.linalg.norm(q[:, names], axis=1)[:, None]
    channels = {"time": 0.01 * np.arange(samples), "q": q, "qd": qd, "qdd": qdd}
    if model.base == "floating":
        q[:, 3:7] /= np.linalg.norm(q[:, 3:7], axis=1)[:, None]
        channels |= {"base_q": q[:, :7], "base_qd": qd[:, :6], "base_qdd": qdd[:, :6]}
        channels |= {name: channels[name][:, 7 if name == "q" else 6 :] for name in ("q", "qd", "qdd")}
    return channels, q, qd, qdd


@pytest.mark.nojit
@pytest.mark.parametrize(
    "model",
    [chain("revolute", "prismatic", "continuous", "fixed", "revolute"), chain("screw", "continuous", "screw"),
     load_robot("humanoid")],
    ids=["chain", "screws", "humanoid"],
)  # fmt: skip
def test_along_the_axis_of_a_joint_it_reads_what_inverse_dynamics_asks_for(model):
    scene = compile_scene(model, None)
    channels, q, qd, qdd = moving(model)
    wanted = inverse_dynamics(model, q, qd, qdd)[:, model.nv - scene.tree.n :]
    for joint, torque in zip(model.moving_joints, wanted.T):
        found = measure(scene, channels, ForceTorqueSensor(joint.child))
        along = np.array(joint.axis)  # which is the same in the child's frame
        force, moment = found[:, :3] @ along, found[:, 3:] @ along
        reading = force if joint.type == "prismatic" else moment + joint.pitch * force
        np.testing.assert_allclose(reading, torque, rtol=0, atol=1e-11 * max(1.0, np.abs(wanted).max()))


@pytest.mark.nojit
@pytest.mark.parametrize("kind", ["ball", "universal", "planar", "cylindrical", "free"])
def test_joints_of_several_degrees_move_what_they_carry(kind):
    """Compare what a hinge beyond such a joint needs, and the sum of all forces by the center of mass."""
    model = chain("revolute", kind, "revolute")
    scene = compile_scene(model, None)
    channels, q, qd, qdd = moving(model)
    wanted = inverse_dynamics(model, q, qd, qdd)
    for joint, column in (("joint0", 0), ("joint2", -1)):
        one = model.joint(joint)
        found = measure(scene, channels, ForceTorqueSensor(one.child))
        np.testing.assert_allclose(found[:, 3:] @ np.array(one.axis), wanted[:, column], rtol=0, atol=1e-11)
    if kind == "ball":  # whose degrees are moments about the axes of the child
        found = measure(scene, channels, ForceTorqueSensor("link1"))
        np.testing.assert_allclose(found[:, 3:], wanted[:, 1:4], rtol=0, atol=1e-11)


@pytest.mark.nojit
def test_at_rest_it_reads_the_weight_of_what_is_beyond():
    """The sensor's place and axes turn force and moment as statics has it."""
    model = load_robot("arm7")
    scene, q = compile_scene(model, None), np.linspace(0.3, -0.7, 7)
    still = {"time": np.zeros(1), "q": q[None], "qd": np.zeros((1, 7)), "qdd": np.zeros((1, 7))}
    link = model.moving_joints[4].child
    poses, beyond = forward_kinematics(model, q), [joint.child for joint in model.moving_joints[4:]]
    rows = [model.link_index(name) for name in beyond]
    sensor = ForceTorqueSensor(link, (0.02, -0.01, 0.03), (0.3, -0.4, 1.1))
    at = poses.position[rows[0]] + poses.rotation[rows[0]] @ sensor.position
    axes = poses.rotation[rows[0]] @ rotation_from_rpy(sensor.rpy)
    force, moment = np.zeros(3), np.zeros(3)
    for row in rows:
        weight = np.array([0.0, 0.0, G * model.links[row].mass])
        force += weight
        moment += np.cross(poses.position[row] + poses.rotation[row] @ model.links[row].center_of_mass - at, weight)
    wanted = [*axes.T @ force, *axes.T @ moment]
    np.testing.assert_allclose(measure(scene, still, sensor)[0], wanted, rtol=0, atol=1e-12)


def test_it_reads_what_mujoco_reads(tmp_path):
    """Compare all seven joints of an arm in motion with the sensors `force` and `torque` at a site of each link."""
    mujoco = pytest.importorskip("mujoco")
    model = load_robot("arm7")
    save_robot(model, tmp_path / "arm.xml")
    spec = mujoco.MjSpec.from_file(str(tmp_path / "arm.xml"))
    links = [joint.child for joint in model.moving_joints]
    for name in links:
        spec.body(name).add_site(name=name, pos=[0.01, 0.02, -0.03])
        for kind in (mujoco.mjtSensor.mjSENS_FORCE, mujoco.mjtSensor.mjSENS_TORQUE):
            spec.add_sensor(type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=name)
    m = spec.compile()
    d, scene, rng = mujoco.MjData(m), compile_scene(model, None), np.random.default_rng(0)
    m.dof_armature[:] = m.dof_damping[:] = m.dof_frictionloss[:] = 0.0
    m.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION
    for _ in range(3):
        d.qpos[:], d.qvel[:] = rng.uniform(-0.5, 0.5, 7), rng.normal(size=7)
        mujoco.mj_forward(m, d)
        channels = {"time": np.zeros(1), "q": d.qpos[None], "qd": d.qvel[None], "qdd": d.qacc[None]}
        for k, name in enumerate(links):
            found = measure(scene, channels, ForceTorqueSensor(name, (0.01, 0.02, -0.03)))[0]
            scale = np.abs(d.sensordata).max()
            np.testing.assert_allclose(found, d.sensordata[6 * k : 6 * k + 6], rtol=0, atol=1e-12 * scale)


# ------------------------------------------------------------------------------------------------ ground and bodies


def test_the_feet_of_a_standing_robot_bear_its_weight_and_their_switches_close():
    feet = [ForceTorqueSensor(foot, name=f"{foot}_force") for foot in ("left_foot", "right_foot")]
    switches = [ContactSensor("left_foot"), ContactSensor("right_foot", 20.0, "no"), ContactSensor("trunk", name="hit")]
    record = ("q", "base_q", "contact_force", "base_qd", "base_qdd", "qd", "qdd", *feet, *switches)
    scene, run = standing_humanoid("midpoint", 30.0, record)
    model = scene.model
    poses = forward_kinematics(model, np.concatenate([run["base_q"], run["q"]], axis=1))
    borne = 0.0
    for sensor in feet:
        R = poses.rotation[-1, model.link_index(sensor.link)]
        borne += R @ run[sensor.name][-1, :3] + [0.0, 0.0, -G * model.links[model.link_index(sensor.link)].mass]
    np.testing.assert_allclose(borne, [0.0, 0.0, -G * model.mass], rtol=0, atol=1e-6)
    assert [run[one.name][-1, 0] for one in switches] == [1.0, 0.0, 0.0]
    assert np.array_equal(measure(scene, run, feet[0]), run["left_foot_force"])
    later = simulate(scene, 0.1, run, record=(*feet, *switches), estimate_error=False)
    for sensor in (*feet, *switches):  # forces of the step before are kept in the state
        assert np.array_equal(later[sensor.name][0], run[sensor.name][-1])


@pytest.mark.long
def test_a_platform_bears_a_box_that_lies_on_it():
    """A cart on a vertical rail, held by a force, under a box: rail and cart read weights, in the scene and alone."""
    cart = Model(
        "lift", (Link("rail"), Link("cart", 2.0, (0.0, 0.0, 0.0), INERTIA)),
        (Joint("up", "prismatic", "rail", "cart", axis=(0.0, 0.0, 1.0)),),
        shapes=(Shape("cart", Box((0.4, 0.4, 0.1))),),
    )  # fmt: skip
    load = body(Box((0.1, 0.1, 0.1)), mass=1.0, name="load")
    members = [Placed(replace(load, contacts=()), "load", (0.1, 0.0, 0.1)), Placed(cart, "lift", (0.0, 0.0, 0.0))]
    scene = compile_scene(SceneModel("lift", members, pairs="all"), None, integrator="implicit_euler", timestep=1e-3)
    sensor, switch = ForceTorqueSensor("lift/cart"), ContactSensor("lift/cart", 5.0)
    side = RangeSensor("world", [[1.0, 0.0, 0.0]], position=(-1.0, 0.0, 0.12))
    run = simulate(
        scene, 2.0, tau=[0.0] * (scene.tree.n - 1) + [3.0 * G], record=("q", "qd", sensor, switch, side),
        estimate_error=False,
    )  # fmt: skip
    assert abs(run["qd"][-1]).max() < 1e-3
    np.testing.assert_allclose(run["force"][-1, :3], [0.0, 0.0, 3.0 * G], rtol=0, atol=0.02)
    assert run["force"][-1, 4] == pytest.approx(-0.1 * G, abs=0.02)  # the moment about y of the load
    assert run["contact"][-1, 0] == 1.0
    assert run["range"][-1, 0] == pytest.approx(1.05, abs=1e-3)


def test_what_it_cannot_know_is_refused():
    model = load_robot("humanoid")
    scene = compile_scene(model, None)
    channels = moving(model)[0]
    pushed = scene.pushed([Push("trunk", (1.0, 0.0, 0.0))])
    for make, message in (
        (lambda: measure(scene, channels, ForceTorqueSensor("trunk")), "which nothing carries"),
        (lambda: measure(scene, channels, ForceTorqueSensor("world")), "nothing carries the world"),
        (lambda: measure(scene, channels, ForceTorqueSensor("wheel")), "is on 'wheel'; links"),
        (lambda: measure(pushed, channels, ForceTorqueSensor("left_foot")), "where pushes act"),
        (lambda: measure(scene, {"time": 0.0, "q": 0.0}, ForceTorqueSensor("left_foot")), "were not recorded"),
        (lambda: ForceTorqueSensor("left_foot", (0.0, 0.0)), "position"),
        (lambda: ContactSensor("left_foot", -1.0), "threshold is -1"),
        (lambda: SampledSensor(ContactSensor("left_foot"), delay=-1.0), "delay is -1"),
    ):
        with pytest.raises(ValueError, match=message):
            make()
