"""Tendons around spheres and cylinders and through rings: MuJoCo's lengths and Jacobians, energy, and touch-down."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from company import in_company, simulated
from mujoco_oracle import mujoco_model
from random_tree import random_states, random_tree
from test_ball_springs import top, turned_by
from test_tendons import anchored, tied

from featherstone_gait import (
    Joint,
    Link,
    Model,
    Placed,
    Tendon,
    Via,
    Wrap,
    compile_scene,
    energy,
    forward_dynamics,
    initial_state,
    load_robot,
    mass_matrix,
    save_robot,
    simulate,
    tendon_jacobian,
    tendon_lengths,
)
from featherstone_gait.dynamics.tendons import spring_forces

STILL = (0.0, 0.0, 0.0)
QUIET = {"estimate_error": False}
FILE = """<mujoco><compiler autolimits="true"/><worldbody><site name="w" pos=".05 0 1.3"/>
<geom name="drum" type="cylinder" size=".06 .1" pos=".02 0 1.12" euler="80 10 0"/><site name="left" pos="-.2 0 1.12"/>
<body pos="0 0 1"><joint name="a" axis="0 1 0"/><joint name="b" axis="1 0 0"/>
<geom type="capsule" fromto="0 0 0 .2 0 0" size=".02" mass=".3"/><geom name="knee" size=".04" pos=".2 0 0" mass="0"/>
<site name="above" pos=".2 0 .2"/><site name="within" pos=".2 0 .01"/><site name="s0" pos=".08 .01 .05"/>
<site name="s1" pos=".1 .02 -.06"/>
<body pos=".2 0 0"><joint name="c" axis="0 1 0"/><joint name="d" axis="0 0 1"/>
<geom type="box" size=".05 .05 .02" pos=".1 0 0" mass=".2"/><site name="s2" pos=".12 .01 .04"/>
<site name="s3" pos=".1 0 -.06"/></body></body></worldbody><tendon>
<spatial name="free" stiffness="20" damping=".2"><site site="s0"/><geom geom="knee"/><site site="s2"/></spatial>
<spatial name="sided" stiffness="30"><site site="s1"/><geom geom="knee" sidesite="above"/><site site="s3"/></spatial>
<spatial name="ring" stiffness="40"><site site="s1"/><geom geom="knee" sidesite="within"/><site site="s2"/></spatial>
<spatial name="drum" stiffness="20"><site site="w"/><geom geom="drum" sidesite="left"/><site site="s0"/>
<pulley divisor="2"/><site site="s0"/><geom geom="knee"/><site site="s3"/></spatial></tendon></mujoco>"""


def wound(base="fixed"):
    """A random robot with a tendon around a sphere, one around a cylinder and one through a ring."""
    tree = random_tree(6, 3, base=base)
    links = [link.name for link in tree.links]
    ends = Via(links[1], (0.4, 0.1, 0.0)), Via(links[-1], (0.0, 0.5, 0.1))
    shapes = (
        Wrap(links[2], "sphere", 0.35),
        Wrap(links[4], "cylinder", 0.3, (0.1, 0.0, 0.0), (1.0, 1.0, 0.5), (0.1, 0.6, 0.2)),
        Wrap(links[3], "sphere", 0.1, (0.0, 0.2, 0.0), side=(0.0, 0.21, 0.0)),
    )
    rows = enumerate(shapes)
    return replace(tree, tendons=[Tendon(f"t{k}", (), (ends[0], one, ends[1]), 20.0 + k, rest=0.1) for k, one in rows])


def swinging(stiffness=40.0):
    """A pendulum whose cord, held aside, meets a fixed drum as it swings."""
    links = Link("base", 0.0, STILL, (0.0,) * 6), Link("bob", 0.5, (0.0, 0.0, -0.5), (0.01, 0.0, 0.0, 0.01, 0.0, 0.01))
    hinge = Joint("j", "continuous", "base", "bob", axis=(0.0, 1.0, 0.0))
    drum = Wrap("base", "cylinder", 0.1, (0.2, 0.0, -0.2), (0.0, 1.0, 0.0), (0.6, 0.0, -0.2))
    path = Via("base", (0.3, 0.0, 0.2)), drum, Via("bob", (0.0, 0.0, -0.5))
    return Model("swing", links, (hinge,), tendons=(Tendon("cord", (), path, stiffness, rest=0.2),))


@pytest.mark.filterwarnings("error")
def test_lengths_and_torques_are_those_of_mujoco(tmp_path):
    """Around a sphere, on a side of it, through it as a ring, and around a drum of the world; also as saved."""
    pytest.importorskip("mujoco", minversion="4")
    file, saved = tmp_path / "arm.xml", tmp_path / "saved.xml"
    file.write_text(FILE)
    model = load_robot(file, strict=True)
    save_robot(model, saved)
    again = load_robot(saved, strict=True)
    rng, bent = np.random.default_rng(0), np.zeros(4, int)
    damping = np.array([t.damping for t in model.tendons])
    for path in (file, saved):
        mujoco, m, d = mujoco_model(path)
        for q, qd in rng.uniform(-1.2, 1.2, (30, 2, 4)):
            d.qpos, d.qvel = q, qd
            mujoco.mj_forward(m, d)
            bent += d.ten_wrapnum > [2, 2, 2, 4]
            lengths, J = tendon_lengths(model, q), tendon_jacobian(model, q)
            np.testing.assert_allclose(lengths, d.ten_length, rtol=0, atol=1e-12)
            np.testing.assert_allclose(tendon_lengths(again, q), lengths, rtol=0, atol=1e-12)
            own = np.zeros((4, 4))
            mujoco.mju_sparse2dense(own, d.ten_J.ravel(), m.ten_J_rownnz, m.ten_J_rowadr, m.ten_J_colind.ravel())
            exact = [0, 1, 3]  # MuJoCo finds the bend at a ring to 1e-6
            np.testing.assert_allclose(J[exact], own[exact], rtol=0, atol=1e-10)
            np.testing.assert_allclose(J[2], own[2], rtol=0, atol=1e-5)
            force = J.T @ (spring_forces(model.tendons, lengths) - damping * (J @ qd))
            np.testing.assert_allclose(force, d.qfrc_passive, rtol=0, atol=1e-4)
    assert (bent > 3).all()
    assert (bent[:3] < 57).any()


@pytest.mark.long
@pytest.mark.parametrize("base", ["fixed", "floating"])
def test_the_jacobian_is_how_lengths_change(base):
    model = wound(base)
    q, qd, _ = random_states(model, 24, 1)
    straight = replace(model, tendons=[replace(one, path=one.path[::2]) for one in model.tendons])
    scene, bent = compile_scene(model, integrator="rk4", timestep=1e-6), np.zeros(3, bool)
    record = ("base_q", "base_qd", "q", "qd", "tendon_length")
    for k in range(24):
        run = simulate(scene, 4e-6, initial_state(scene, q[k], qd[k]), record=record, record_interval=1e-6, **QUIET)
        lengths = run["tendon_length"]
        rate = (8.0 * (lengths[3] - lengths[1]) - (lengths[4] - lengths[0])) / 12e-6
        at, speed = (np.concatenate([run[name][2] for name in record[j:4:2]]) for j in (0, 1))
        np.testing.assert_allclose(rate, tendon_jacobian(model, at) @ speed, rtol=0, atol=1e-7 * np.abs(speed).max())
        bent |= lengths[2] > tendon_lengths(straight, at) + 1e-6
    assert bent.all()


def test_the_kernel_has_the_accelerations_of_the_dynamics():
    """The force along each way, on all three bodies, as external forces give it."""
    model = wound()
    scene = in_company(model, "rk4", 1e-6)
    for q, qd in zip(*random_states(model, 6, 2)[:2]):
        run = simulated(scene, 1e-6, q, qd, record=("q", "qd", "qdd"), record_interval=1e-6)
        expected = forward_dynamics(model, run["q"][1], run["qd"][1], np.zeros(6))
        np.testing.assert_allclose(run["qdd"][1], expected, rtol=0, atol=1e-8 * np.abs(expected).max())


def test_one_implicit_step_is_a_dense_solution():
    """(M + h^2 J' K J) a h = J' f with J of the bent way."""
    model, h = wound(), 1e-3
    scene = in_company(model, "implicit_euler", h, gravity=STILL)
    scene.constants.tendons.table.fold = 1.0
    q = random_states(model, 1, 3)[0][0]
    run = simulated(scene, h, q, record=("qd",), record_interval=h)
    lengths, J = tendon_lengths(model, q), tendon_jacobian(model, q)
    K = np.diag([one.stiffness for one in model.tendons])
    f = spring_forces(model.tendons, lengths)
    qd = h * np.linalg.solve(mass_matrix(model, q) + h * h * J.T @ K @ J, J.T @ f)
    np.testing.assert_allclose(run["qd"][1], qd, rtol=0, atol=1e-10 * np.abs(qd).max())


def test_length_and_slope_are_continuous_at_touch_down():
    model = swinging()
    q = np.linspace(-1.0, 1.0, 20001)[:, None]
    lengths, J = tendon_lengths(model, q)[:, 0], tendon_jacobian(model, q)[:, 0, 0]
    cord = model.tendons[0]
    straight = tendon_lengths(replace(model, tendons=[replace(cord, path=cord.path[::2])]), q)[:, 0]
    bent = lengths > straight + 1e-12
    assert 0.1 < bent.mean() < 0.9
    assert np.abs(np.diff(J)).max() < 1e-3
    np.testing.assert_allclose(np.gradient(lengths, q[:, 0])[1:-1], J[1:-1], rtol=0, atol=1e-4)


@pytest.mark.parametrize("integrator", ["rk4", pytest.param("dop853", marks=pytest.mark.long)])
def test_energy_is_kept_as_a_cord_meets_a_drum(integrator):
    model = swinging(5.0)
    scene = in_company(model, integrator, 2e-4 if integrator == "rk4" else None)
    run = simulated(scene, 3.0, [-1.0], record=("q", "qd"), rtol=None if integrator == "rk4" else 1e-10)
    total = energy(model, run["q"], run["qd"]).total
    assert run["q"].min() < -0.9
    assert run["q"].max() > -0.4
    np.testing.assert_allclose(total, total[0], rtol=0, atol=1e-7 * np.ptp(energy(model, run["q"], run["qd"]).kinetic))


@pytest.mark.long
def test_robots_in_one_scene_move_as_each_alone():
    """With tendons of joints, around shapes and from the world, and with springs and limits of ball joints."""
    free = tied(random_tree(6, 4, base="floating"))
    hung = replace(free, tendons=free.tendons + anchored(free).tendons)
    models = [tied(random_tree(5, 3)), hung, wound("floating"), swinging(), wound()]
    states = [random_states(model, 1, k)[0][0] for k, model in enumerate(models)]
    for base, stiffness in (("fixed", 3.0), ("floating", 3.0), ("fixed", 0.0)):
        models.append(top(offset=(0.1, 0.2, -0.1), base=base, stiffness=stiffness, upper=0.9))
        at = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0] if base == "floating" else []
        states.append([*at, *turned_by(0.5, -0.5, 0.6)])
    scene = compile_scene([Placed(*one) for one in zip(models, "abcdefgh")], integrator="midpoint", timestep=1e-3)
    start = initial_state(scene, dict(zip("abcdefgh", states)))
    together = simulate(scene, 0.05, start, record=("q", "tendon_force"), **QUIET)
    for name, model, q in zip("abcdefgh", models, states):
        alone = compile_scene(model, integrator="midpoint", timestep=1e-3)
        run = simulate(alone, 0.05, initial_state(alone, q), record=("q", "tendon_force"), **QUIET)
        for channel in ("q", "tendon_force"):
            np.testing.assert_array_equal(together[name][channel], run[channel])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Wrap("a", "box", 0.1), "wrap on link 'a': shape is 'box'"),
        (lambda: Wrap("a", "sphere", 0.0), "radius is 0.0"),
        (lambda: Wrap("a", "cylinder", 0.1, axis=STILL), r"axis \(0.0, 0.0, 0.0\) has no length"),
        (lambda: Tendon("t", (), [Wrap("a", "sphere", 0.1), Via("a"), Via("b")]), "stands between no two points"),
        (lambda: Tendon("t", (), [Via("a"), Wrap("a", "sphere", 0.1), Via("b", STILL, 0.0), Via("a")]), "no two"),
    ],
)
def test_a_wrong_wrap_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_a_way_on_the_side_of_a_drum_jumps_where_mujocos_does(tmp_path):
    """The straight way comes to cross the ray away from the side, so that the other way around becomes the shortest."""
    path = tmp_path / "drum.xml"
    path.write_text(
        """<mujoco><worldbody><body name="base"><inertial pos="0 0 0" mass="1" diaginertia=".1 .1 .1"/>
        <site name="s0" pos="-.25 0 .05"/><geom name="drum" type="cylinder" size=".05 .2" euler="90 0 0"/>
        <site name="up" pos="0 0 .12"/><body><joint axis="0 1 0"/><geom size=".02" pos=".25 0 0"/>
        <site name="s1" pos=".3 0 0"/></body></body></worldbody><tendon><spatial stiffness="100"><site site="s0"/>
        <geom geom="drum" sidesite="up"/><site site="s1"/></spatial></tendon></mujoco>"""
    )
    model, m = load_robot(path, base="fixed"), mujoco.MjModel.from_xml_path(str(path))
    d, found, theirs = mujoco.MjData(m), [], []
    for angle in np.linspace(-3.1, 3.1, 401):
        d.qpos[0] = angle
        mujoco.mj_fwdPosition(m, d)
        found.append(tendon_lengths(model, [angle])[0])
        theirs.append(d.ten_length[0])
    np.testing.assert_allclose(found, theirs, rtol=0, atol=1e-12)
    assert np.abs(np.diff(found)).max() > 0.1
