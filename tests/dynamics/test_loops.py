"""Loops: closed forms of planar and spatial mechanisms, MuJoCo's and Pinocchio's matrices, files, wrong input."""

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from random_tree import random_states, random_tree

from featherstone_gait import (
    Joint,
    Link,
    Loop,
    Mimic,
    Model,
    Target,
    close_loops,
    compile_scene,
    coupling_matrix,
    degrees_of_freedom,
    forward_dynamics,
    forward_kinematics,
    initial_state,
    inverse_dynamics,
    inverse_kinematics,
    load_robot,
    load_scene,
    loop_forces,
    loop_gaps,
    loop_jacobian,
    mass_matrix,
    save_robot,
    save_scene,
    simulate,
)
from featherstone_gait.base.rotation import rotation_from_rpy, rpy_from_rotation
from featherstone_gait.dynamics.loops import loop_measures

G = 9.81  # [m/s^2]
Y = (0.0, 1.0, 0.0)
STEP = 1e-20  # of complex differentiation: exact to rounding


def bar(name, mass, length, inertia):
    """A rod along x, with its inertia across."""
    return Link(name, mass, (length / 2, 0.0, 0.0), (1e-3, 0.0, 0.0, inertia, 0.0, inertia))


def slope(f, x):
    return f(x + 1j * STEP).imag / STEP


def one_freedom(inertia, height, angle, rate, torque):
    """Lagrange's equation of one coordinate: I x'' + 1/2 I' x'^2 + g (sum m z)' = torque."""
    force = torque - 0.5 * slope(inertia, angle) * rate**2 - G * slope(height, angle)
    return force / inertia(angle).real


# ------------------------------------------------------------------------------------------------ slider-crank


R, L = 0.3, 0.8  # crank and rod [m]


def slider_crank():
    """Angles about y turn x to -z, so that heights are -sin."""
    links = Link("frame"), bar("crank", 1.2, R, 0.02), bar("rod", 0.7, L, 0.05), Link("piston", 2.0)
    joints = (
        Joint("crank", "continuous", "frame", "crank", axis=Y),
        Joint("rod", "continuous", "crank", "rod", (R, 0.0, 0.0), axis=Y),
        Joint("piston", "prismatic", "frame", "piston"),
    )
    return Model("slider crank", links, joints, loops=(Loop("pin", "connect", "rod", "piston", (L, 0.0, 0.0)),))


def rod_angle(x):
    return -np.arcsin(R / L * np.sin(x)) - x


def piston_place(x):
    return R * np.cos(x) + np.sqrt(L**2 - R**2 * np.sin(x) ** 2)


def rod_rate(x):
    return -R / L * np.cos(x) / np.sqrt(1.0 - (R / L * np.sin(x)) ** 2) - 1.0


def piston_rate(x):
    return -R * np.sin(x) - R**2 * np.sin(x) * np.cos(x) / np.sqrt(L**2 - R**2 * np.sin(x) ** 2)


def slider_crank_inertia(x):
    """Twice the kinetic energy at a unit rate of the crank; the rod's center by its rates."""
    turn, slide = 1.0 + rod_rate(x), piston_rate(x)
    both = x + rod_angle(x)
    vx = -R * np.sin(x) - L / 2 * np.sin(both) * turn
    vz = -R * np.cos(x) - L / 2 * np.cos(both) * turn
    return 0.02 + 1.2 * (R / 2) ** 2 + 0.7 * (vx * vx + vz * vz) + 0.05 * turn * turn + 2.0 * slide * slide


def slider_crank_height(x):
    """Sum of the masses times their heights [kg m]."""
    both = x + rod_angle(x)
    return -1.2 * R / 2 * np.sin(x) - 0.7 * (R * np.sin(x) + L / 2 * np.sin(both))


@pytest.mark.nojit
@pytest.mark.parametrize("angle", [0.3, 1.5, 2.8, 4.4])
def test_a_slider_crank_moves_as_its_closed_form(angle):
    model, rate, torque = slider_crank(), 2.0, 1.5
    closed = np.array([angle, rod_angle(angle), piston_place(angle)])
    rates = np.array([1.0, rod_rate(angle), piston_rate(angle)])
    assert np.abs(loop_gaps(model, closed)).max() < 1e-15
    assert np.abs(loop_jacobian(model, closed) @ rates).max() < 1e-15
    found = forward_dynamics(model, closed, rate * rates, [torque, 0.0, 0.0])
    wanted = one_freedom(slider_crank_inertia, slider_crank_height, angle, rate, torque)
    assert found[0] == pytest.approx(wanted, rel=1e-11)
    bent = slope(lambda x: rod_rate(x), angle), slope(piston_rate, angle)
    np.testing.assert_allclose(found[1:], wanted * rates[1:] + rate**2 * np.array(bent), rtol=1e-11)
    assert degrees_of_freedom(model, closed) == 1


def test_loops_close_from_beside_the_closed_posture():
    model = slider_crank()
    found = close_loops(model, [0.7, -1.0, 1.0])
    assert np.abs(loop_gaps(model, found)).max() < 1e-11
    np.testing.assert_allclose(found, [found[0], rod_angle(found[0]), piston_place(found[0])], atol=1e-11)
    held = close_loops(model, [0.7, -1.0, 1.0], joints=["rod", "piston"])
    np.testing.assert_allclose(held, [0.7, rod_angle(0.7), piston_place(0.7)], atol=1e-11)
    reached = inverse_kinematics(model, Target("piston", (0.9, 0.0, 0.0)), held)
    assert reached.ok
    assert piston_place(reached.q[0]) == pytest.approx(0.9, abs=1e-9)


def test_a_gap_that_stays_is_named_with_its_size():
    model = slider_crank()
    far = replace(model, loops=(replace(model.loops[0], point_b=(0.0, 0.2, 0.0)),))
    with pytest.raises(ValueError, match=r"slider crank: .*'pin' stays at 0\.2 .*correct"):
        close_loops(far, [0.7, -1.0, 1.0])


# ------------------------------------------------------------------------------------------------ four-bar


A, B, C, D = 0.4, 1.0, 0.7, 0.9  # crank, coupler, rocker and ground [m]


def four_bar(a=A, b=B, c=C, d=D, loop="connect"):
    links = Link("ground"), bar("crank", 1.0, a, 0.03), bar("coupler", 2.0, b, 0.2), bar("rocker", 1.5, c, 0.1)
    joints = (
        Joint("crank", "continuous", "ground", "crank", axis=Y),
        Joint("coupler", "continuous", "crank", "coupler", (a, 0.0, 0.0), axis=Y),
        Joint("rocker", "continuous", "ground", "rocker", (d, 0.0, 0.0), axis=Y),
    )
    at = {"point_a": (b, 0.0, 0.0), "point_b": (c, 0.0, 0.0)}
    if loop == "distance":  # the coupler is a rod without mass: its place is only a link
        at = {"point_a": (a, 0.0, 0.0), "point_b": (c, 0.0, 0.0), "distance": b}
        return Model("rod", links[:2] + links[3:], joints[::2], loops=(Loop("rod", loop, "crank", "rocker", **at),))
    at |= {"axis": Y} if loop == "hinge" else {}
    return Model("four-bar", links, joints, loops=(Loop("pin", loop, "coupler", "rocker", **at),))


def rocker_angle(x):
    """By the diagonal from the crank's pin to the rocker's foot; angles turn x to -z."""
    px, pz = D - A * np.cos(x), -A * np.sin(x)  # from pin to foot
    at_foot = np.arccos((C * C + px * px + pz * pz - B * B) / (2 * C * np.hypot(px, pz)))
    return np.arctan2(-pz, -px) - at_foot


def four_bar_angles(x):
    rocker = rocker_angle(x)
    ex, ez = D + C * np.cos(rocker) - A * np.cos(x), C * np.sin(rocker) - A * np.sin(x)
    return np.array([x, np.arctan2(ez, ex) - x, rocker])


def four_bar_rates(q):
    """For a unit rate of the crank: the components of the pin's velocity along and across the coupler."""
    crank, coupler, rocker = q[0], q[0] + q[1], q[2]
    turned = A * np.sin(crank - coupler) / (C * np.sin(rocker - coupler))
    swung = A * np.sin(crank - rocker) / (B * np.sin(rocker - coupler))
    return np.array([1.0, swung - 1.0, turned])


@pytest.mark.parametrize("kind", ["connect", "hinge"])
@pytest.mark.parametrize("angle", [0.4, 1.9, 4.0])
def test_a_four_bar_has_the_velocity_ratio_of_its_angles(kind, angle):
    model, q = four_bar(loop=kind), four_bar_angles(angle)
    assert np.abs(loop_gaps(model, q)).max() < 1e-14
    rates = four_bar_rates(q)
    assert np.abs(loop_jacobian(model, q) @ rates).max() < 1e-14
    assert degrees_of_freedom(model, q) == 1
    found = close_loops(model, np.add(q, (0.0, 0.1, -0.1)), joints=["coupler", "rocker"])
    np.testing.assert_allclose(found, q, atol=1e-10)
    # What is bent is the rates' change at a constant rate of the crank; along the rates the loop's forces do no work.
    qd, h = 1.7 * rates, 1e-5
    bent = 1.7**2 * (four_bar_rates(four_bar_angles(angle + h)) - four_bar_rates(four_bar_angles(angle - h))) / (2 * h)
    M, c = mass_matrix(model, q), inverse_dynamics(model, q, qd, np.zeros(3))
    wanted = (rates @ ([1.0, 0.0, 0.0] - c - M @ bent)) / (rates @ M @ rates)
    found = forward_dynamics(model, q, qd, [1.0, 0.0, 0.0])
    np.testing.assert_allclose(found, wanted * rates + bent, rtol=1e-8, atol=1e-8)


def test_a_rod_without_mass_pulls_along_itself():
    q = four_bar_angles(1.1)
    model, rod, qd = four_bar(), four_bar(loop="distance"), 1.3 * four_bar_rates(q)
    light = model.with_numbers(links=[replace(k, mass=1e-7, inertia=(1e-8, 0.0, 0.0, 1e-8, 0.0, 1e-8))
                                      if k.name == "coupler" else k for k in model.links])  # fmt: skip
    assert np.abs(loop_gaps(rod, q[[0, 2]])).max() < 1e-15
    found = forward_dynamics(rod, q[[0, 2]], qd[[0, 2]], [1.0, 0.0])
    np.testing.assert_allclose(found, forward_dynamics(light, q, qd, [1.0, 0.0, 0.0])[[0, 2]], rtol=1e-6)


def test_a_stretched_parallelogram_is_told_to_have_two_freedoms():
    model = four_bar(0.5, 0.8, 0.5, 0.8)
    assert degrees_of_freedom(model, [0.6, -0.6, 0.6]) == 1
    assert degrees_of_freedom(model, [0.0, 0.0, 0.0]) == 2
    found = forward_dynamics(model, np.zeros(3), np.zeros(3), [1.0, 0.0, 0.0])
    assert np.isfinite(found).all()
    assert np.abs(loop_jacobian(model, np.zeros(3)) @ found).max() < 1e-12 * np.abs(found).max()


def test_a_triangle_cannot_move():
    model = four_bar()
    q, foot = four_bar_angles(0.9), (0.0, 0.0, -0.5)
    length = float(np.linalg.norm(forward_kinematics(model, q, "coupler").position - foot))
    brace = Loop("brace", "distance", "coupler", None, point_b=foot, distance=length)
    truss = replace(model, loops=(*model.loops, brace))
    assert degrees_of_freedom(truss, q) == 0
    assert np.abs(forward_dynamics(truss, q, np.zeros(3), [3.0, 0.0, 0.0])).max() < 1e-9


# ------------------------------------------------------------------------------------------------ Bricard's loop


def bricard():
    """Six hinges with alternating right angles; five are joints, the sixth is the loop."""
    links, joints = [Link("link0", 1.0, (0.5, 0.0, 0.0), (0.01, 0.0, 0.0, 0.1, 0.0, 0.1))], []
    for k in range(1, 6):
        links.append(bar(f"link{k}", 1.0, 1.0, 0.1))
        turn = (0.5 if k % 2 else -0.5) * math.pi
        parent, place = f"link{k - 1}", (1.0, 0.0, 0.0)
        joints.append(Joint(f"hinge{k}", "continuous", parent, f"link{k}", place, (turn, 0.0, 0.0), (0.0, 0.0, 1.0)))
    loop = Loop("sixth", "hinge", "link5", "link0", (1.0, 0.0, 0.0), rpy_a=(-0.5 * math.pi, 0.0, 0.0))
    return Model("Bricard", tuple(links), tuple(joints), loops=(loop,))


def bricard_angles(x):
    return np.array([x, even := math.acos(-math.cos(x) / (1.0 + math.cos(x))), x, even, x])


def test_bricards_loop_moves_although_its_equations_outnumber_its_joints():
    model = bricard()
    found = close_loops(model, bricard_angles(0.5) + 0.05)
    assert degrees_of_freedom(model, found) == 1
    odd, even = np.cos(found[::2]), np.cos(found[1::2])
    np.testing.assert_allclose(odd, odd[0], atol=1e-9)  # trihedral: every second angle is the same
    assert np.abs(odd[0] + even + odd[0] * even).max() < 1e-9
    J = loop_jacobian(model, found)
    free = np.linalg.svd(J)[2][-1]
    a = forward_dynamics(model, found, 3.0 * free, np.ones(5))
    bias = loop_measures(model, found, 3.0 * free)[0][0, 2]
    assert np.abs(J @ a + bias).max() < 1e-11 * np.abs(a).max()
    c = inverse_dynamics(model, found, 3.0 * free, np.zeros(5))
    assert free @ (mass_matrix(model, found) @ a + c - 1.0) == pytest.approx(0.0, abs=1e-11 * np.abs(c).max())

# ------------------------------------------------------------------------------------------------ other engines


KINDS = ("connect", "weld", "connect")


def closed_tree(base, seed, kinds=KINDS):
    """A random tree whose loops, between random links and the world, are closed in a random posture."""
    model, rng = random_tree(15, seed, base=base), np.random.default_rng(seed)
    q = random_states(model, 1, seed)[0][0]
    poses, loops = forward_kinematics(model, q), []
    names = [link.name for link in model.links]
    for k, kind in enumerate(kinds):
        one, two = rng.choice(range(1, len(names)), 2, replace=False)
        rpy, point = rng.uniform(-1, 1, 3), rng.uniform(-0.2, 0.2, 3)
        E, r = poses.rotation[one] @ rotation_from_rpy(rpy), poses.position[one] + poses.rotation[one] @ point
        other = None
        if k != 2 or base == "fixed":
            other, back = names[two], poses.rotation[two].T
            E, r = back @ E, back @ (r - poses.position[two])
        rod = rng.uniform(0.1, 0.2, 3) if kind == "distance" else np.zeros(3)
        turned = (tuple(rpy), tuple(rpy_from_rotation(E))) if kind in ("weld", "hinge") else ((0.0,) * 3,) * 2
        far = float(np.linalg.norm(rod))
        loops.append(Loop(f"loop{k}", kind, names[one], other, tuple(point), tuple(r + rod), *turned, distance=far))
    return replace(model, loops=tuple(loops)), q


def closed_rates(model, q, seed):
    """Random velocities at which the loops stay closed."""
    J, qd = loop_jacobian(model, q), random_states(model, 1, seed)[1][0]
    return qd - np.linalg.pinv(J, rcond=1e-10) @ (J @ qd)


def projected(M, force, J, bias):
    """The accelerations of M a = force + J' f, J a + bias = 0; rows may depend on each other."""
    free = np.linalg.solve(M, force)
    W = np.linalg.solve(M, J.T)
    return free - W @ (np.linalg.pinv(J @ W, rcond=1e-11, hermitian=True) @ (J @ free + bias))


@pytest.mark.parametrize("kinds", [KINDS, ("weld", "weld", "distance"), ("hinge", "distance", "connect")])
@pytest.mark.parametrize("base", ["fixed", "floating"])
def test_accelerations_and_forces_solve_the_equations_of_the_own_matrices(base, kinds):
    for seed in range(4):
        model, q = closed_tree(base, seed, kinds)
        assert np.abs(loop_gaps(model, q)).max() < 1e-13
        qd, tau = closed_rates(model, q, seed + 50), np.random.default_rng(seed).normal(size=model.nv)
        a, f = forward_dynamics(model, q, qd, tau), loop_forces(model, q, qd, tau)
        M, c = mass_matrix(model, q), inverse_dynamics(model, q, qd, np.zeros(model.nv))
        measures, J = loop_measures(model, q, qd)
        scale = np.abs(a).max()
        np.testing.assert_allclose(a, projected(M, tau - c, J[0], measures[0, 2]), rtol=0, atol=1e-9 * scale)
        np.testing.assert_allclose(M @ a + c - J[0].T @ f, tau, rtol=0, atol=1e-10 * np.abs(M @ a).max())
        h = 1e-6
        moved = [loop_gaps(model, _moved(model, q, s * h * qd)) for s in (1.0, -1.0)]
        np.testing.assert_allclose(J[0] @ qd, (moved[0] - moved[1]) / (2 * h), atol=1e-7 * np.abs(qd).max())
        np.testing.assert_allclose(measures[0, 1], J[0] @ qd, rtol=0, atol=1e-12 * np.abs(qd).max())
        rates = [loop_jacobian(model, _moved(model, q, s * h * qd)) @ qd for s in (1.0, -1.0)]
        bent = (rates[0] - rates[1]) / (2 * h)
        np.testing.assert_allclose(measures[0, 2], bent, rtol=0, atol=1e-6 * np.abs(qd).max() ** 2)


def _moved(model, q, step):
    """Move by a velocity coordinate step; the base's turn is that of MuJoCo."""
    if model.base == "fixed":
        return q + step
    new = np.concatenate([q[:3] + step[:3], q[3:7] / np.linalg.norm(q[3:7]), q[7:] + step[6:]])
    mujoco.mju_quatIntegrate(new[3:7], step[3:6], 1.0)
    return new


@pytest.mark.parametrize("base", ["fixed", "floating"])
def test_accelerations_solve_the_equations_of_mujocos_matrices(base, tmp_path):
    for seed in range(4):
        model, q = closed_tree(base, seed)
        written, path = model, tmp_path / f"{base}{seed}.xml"
        save_robot(written, path)
        model = load_robot(path)
        m = mujoco.MjModel.from_xml_path(str(path))
        d, tau = mujoco.MjData(m), np.linspace(-1.0, 1.0, m.nv)
        m.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
        q = renamed_positions(model, written, q)
        d.qpos[:], d.qvel[:] = q, (qd := closed_rates(model, q, seed + 50))
        mujoco.mj_forward(m, d)
        J, bias = [], []
        for loop in model.loops:
            ends = [_site_jacobians(m, d, f"{loop.name}_{side}") for side in "ab"]
            parts = 2 if loop.kind == "weld" else 1
            J.append((ends[0][0] - ends[1][0])[: 3 * parts])
            bias.append((ends[0][1] - ends[1][1])[: 3 * parts] @ qd)
        J, bias = np.concatenate(J), np.concatenate(bias)
        rows = d.efc_J.reshape(-1, m.nv)[d.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY]
        assert len(rows) == len(J)
        mine = loop_jacobian(model, q)
        np.testing.assert_allclose(mine, J, rtol=0, atol=1e-12)
        assert np.abs(rows - rows @ np.linalg.pinv(mine) @ mine).max() < 1e-9  # of the same space
        M = np.zeros((m.nv, m.nv))
        mujoco.mj_fullM(m, d, M)
        found = forward_dynamics(model, q, qd, tau)
        wanted = projected(M, tau - d.qfrc_bias, J, bias)
        np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-9 * np.abs(wanted).max())


ROD = """<mujoco><option gravity="0 0 -9.81"/><worldbody><body name="hip" pos="0 0 1"><freejoint/><geom size="0.1"/>
<body name="shank" pos="0.1 0 0"><joint name="knee" axis="0 1 0"/><geom type="box" size="0.05 0.02 0.3" pos="0 0 -0.3"/>
<body name="foot" pos="0 0 -0.6"><joint name="pitch" axis="0 1 0"/><joint name="roll" axis="1 0 0"/>
<geom type="box" size="0.1 0.05 0.02"/></body></body>
<body name="left" pos="0 0.05 0"><joint name="one" type="ball"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.6" size="0.01"/></body>
<body name="right" pos="0 -0.05 0"><joint name="two" type="ball"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.6" size="0.01"/></body></body></worldbody>
<equality><connect body1="left" body2="foot" anchor="0 0 -0.6"/><connect body1="right" body2="foot" anchor="0 0 -0.6"/>
</equality></mujoco>"""


def rods_on_an_ankle(folder):
    """A floating robot and a closed posture of it."""
    path = folder / "ankle.xml"
    path.write_text(ROD)
    model = load_robot(path)
    start = np.zeros(model.nq)
    start[[3, model.nq - 8, model.nq - 4]] = 1.0  # the quaternions of base and rods
    return model, close_loops(model, start + 0.05 * np.sin(np.arange(model.nq)))


def test_rods_on_ball_joints_move_an_ankle_as_in_mujoco(tmp_path):
    model, q = rods_on_an_ankle(tmp_path)
    m = mujoco.MjModel.from_xml_string(ROD)
    d = mujoco.MjData(m)
    assert degrees_of_freedom(model, q) == 6 + 3 + 6 - 6
    qd, tau = closed_rates(model, q, 3), np.linspace(-1.0, 1.0, m.nv)
    m.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    m.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    d.qpos[:], d.qvel[:] = q, qd
    mujoco.mj_forward(m, d)
    assert np.abs(d.efc_pos).max() < 1e-10
    bias = []
    for k, anchors in ((0, (0, 3)), (1, (0, 3))):
        rates = np.zeros((2, 3, m.nv))
        for rate, body, at in zip(rates, (m.eq_obj1id[k], m.eq_obj2id[k]), anchors, strict=True):
            point = d.xpos[body] + d.xmat[body].reshape(3, 3) @ m.eq_data[k, at : at + 3]
            mujoco.mj_jacDot(m, d, rate, None, point, int(body))
        bias.append((rates[0] - rates[1]) @ qd)
    M = np.zeros((m.nv, m.nv))
    mujoco.mj_fullM(m, d, M)
    wanted = projected(M, tau - d.qfrc_bias, d.efc_J.reshape(-1, m.nv), np.concatenate(bias))
    found = forward_dynamics(model, q, qd, tau)
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-9 * np.abs(wanted).max())
    save_robot(model, tmp_path / "written.urdf")
    assert load_robot(tmp_path / "written.urdf").loops == model.loops


def renamed_positions(model, written, q):
    """Positions of a robot in the order of joints of the model that a file gives back."""
    first = written.nq - len(written.joint_names)
    return np.concatenate([q[:first], [q[written.q_index(name)] for name in model.joint_names]])


def _site_jacobians(m, d, name):
    """Jacobian and its rate (6, nv) of a site: the point's rows, then the rotation's."""
    s, (p, r, pd, rd) = m.site(name).id, np.zeros((4, 3, m.nv))
    mujoco.mj_jacSite(m, d, p, r, s)
    mujoco.mj_jacDot(m, d, pd, rd, d.site_xpos[s], int(m.site_bodyid[s]))
    return np.concatenate([p, r]), np.concatenate([pd, rd])


@pytest.mark.long
def test_followers_and_loops_hold_together():
    model, q = closed_tree("fixed", 3, ("connect",))
    names = model.joint_names
    joints = tuple(replace(j, mimic=Mimic(names[1], 0.5)) if j.name == names[4] else j for j in model.joints)
    model = replace(model, joints=joints)
    qd, tau = np.ones(model.nv), np.ones(model.nv)
    a, Gm = forward_dynamics(model, q, qd, tau), coupling_matrix(model).matrix
    M, c = mass_matrix(model, q), inverse_dynamics(model, q, qd, np.zeros(model.nv))
    measures, J = loop_measures(model, q, qd)
    wanted = Gm @ projected(Gm.T @ M @ Gm, Gm.T @ (tau - c), J[0] @ Gm, measures[0, 2])
    np.testing.assert_allclose(a, wanted, rtol=0, atol=1e-9 * np.abs(wanted).max())


def test_accelerations_are_those_of_pinocchio():
    pin = pytest.importorskip("pinocchio")
    from pinocchio_oracle import coordinates, pinocchio_model

    model, q = closed_tree("fixed", 1, ("weld", "connect"))
    theirs, frames = pinocchio_model(model)
    kinds, closures = {"weld": pin.ContactType.CONTACT_6D, "connect": pin.ContactType.CONTACT_3D}, []
    for loop in model.loops:
        ends = []
        for link, rpy, point in ((loop.a, loop.rpy_a, loop.point_a), (loop.b, loop.rpy_b, loop.point_b)):
            frame = theirs.frames[frames[link]]
            ends += [frame.parentJoint, frame.placement * pin.SE3(rotation_from_rpy(rpy), np.array(point))]
        closures.append(pin.RigidConstraintModel(kinds[loop.kind], theirs, *ends, pin.ReferenceFrame.LOCAL))
    data, (p, T) = theirs.createData(), coordinates(theirs, model, q)
    some, datas = pin.StdVec_RigidConstraintModel(), pin.StdVec_RigidConstraintData()
    some.extend(closures)
    datas.extend([one.createData() for one in closures])
    J = loop_jacobian(model, q)
    qd = np.linalg.svd(J)[2][-1]  # closed in velocities as well
    tau = np.linspace(-1.0, 1.0, model.nv)
    pin.initConstraintDynamics(theirs, data, some, datas)
    settings = pin.ProximalSettings(1e-14, 1e-12, 50)
    wanted = T.T @ pin.constraintDynamics(theirs, data, p, T @ qd, T @ tau, some, datas, settings)
    found = forward_dynamics(model, q, qd, tau)
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-9 * np.abs(wanted).max())


def test_many_states_give_the_rows_of_each():
    model, q = closed_tree("floating", 2)
    qs, qd, tau = np.stack([q] * 9), np.random.default_rng(0).normal(size=(9, model.nv)), np.ones(model.nv)
    alone = [forward_dynamics(model, q, v, tau) for v in qd]
    assert forward_dynamics(model, qs, qd, tau).tobytes() == np.stack(alone).tobytes()
    assert loop_forces(model, qs, qd, tau).shape == (9, 12)
    assert loop_jacobian(model, qs).shape == (9, 12, model.nv)


# ------------------------------------------------------------------------------------------------ files


def test_loops_come_back_from_files(tmp_path):
    model, _ = closed_tree("fixed", 0, ("connect", "weld", "hinge", "distance"))
    model = replace(model, loops=(*model.loops, Loop("anchor", "connect", model.links[2].name, None, (0.1, 0.2, 0.3))))
    turning = [replace(j, type="continuous") if j.type == "revolute" else replace(j, lower=-1.0, upper=1.0)
               if j.type == "prismatic" else j for j in model.joints]  # fmt: skip
    model = replace(model, joints=tuple(turning))
    save_robot(model, tmp_path / "bound.urdf")
    assert load_robot(tmp_path / "bound.urdf").loops == model.loops
    save_robot(model, tmp_path / "other.xml")
    once = load_robot(tmp_path / "other.xml")
    assert [loop.kind for loop in once.loops] == ["connect", "weld", "connect", "connect", "distance", "connect"]
    q, free = random_states(once, 1, 5)[0][0], slice(0, 9)
    back = renamed_positions(model, once, q)
    np.testing.assert_allclose(loop_gaps(once, q)[free], loop_gaps(model, back)[free], rtol=0, atol=1e-13)
    assert loop_gaps(once, q)[15] == pytest.approx(loop_gaps(model, back)[14], abs=1e-13)
    save_robot(once, tmp_path / "again.xml")
    again = load_robot(tmp_path / "again.xml")
    for one, two in zip(once.loops, again.loops, strict=True):
        assert (one.name, one.kind, one.a, one.b) == (two.name, two.kind, two.a, two.b)
        for name in ("point_a", "point_b", "rpy_a", "rpy_b", "distance"):
            np.testing.assert_allclose(getattr(one, name), getattr(two, name), rtol=0, atol=1e-14)


BODIES = """<mujoco><worldbody>
<body name="one" pos="0 0 1"><joint name="j" axis="0 1 0"/><geom size="0.1"/><site name="s" pos="0.1 0 0"/></body>
<body name="two" pos="1 0 1" euler="0 0 30"><joint name="k" axis="0 1 0"/><geom size="0.1"/><site name="t"/></body>
</worldbody><equality>%s</equality></mujoco>"""


@pytest.mark.parametrize(
    "text",
    [
        '<connect body1="one" body2="two" anchor="0.3 0.1 0.2"/>',
        '<connect body1="one" anchor="0.3 0.1 0.2"/>',
        '<connect site1="s" site2="t"/>',
        '<weld body1="one" body2="two" anchor="0.1 0.2 0.3"/>',
        '<weld body1="one" body2="two" relpose="0.1 0.2 0.3 0.6 0.8 0 0" torquescale="0.1"/>',
        '<weld body1="two" relpose="0.1 0.2 0.3 0.6 0.8 0 0" anchor="0.3 0.2 0.1"/>',
        '<weld site1="t" site2="s"/>',
    ],
)
def test_equalities_have_the_gaps_of_mujoco(text, tmp_path):
    path = tmp_path / "loop.xml"
    path.write_text(BODIES % text)
    model = load_robot(path)
    m = mujoco.MjModel.from_xml_path(str(path))
    d = mujoco.MjData(m)
    m.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    d.qpos[:] = q = (0.2, -0.1)
    mujoco.mj_forward(m, d)
    gaps = loop_gaps(model, q)
    np.testing.assert_allclose(gaps[:3], d.efc_pos[:3], rtol=0, atol=1e-14)
    if len(gaps) == 6:  # MuJoCo's is half of it, times torquescale, in the axes of a body
        assert np.linalg.norm(d.efc_pos[3:]) == pytest.approx(0.5 * np.linalg.norm(gaps[3:]) * m.eq_data[0, 10])
    assert any("rigid loops" in note for note in model.notes)


def test_a_scene_keeps_the_loops_of_its_members(tmp_path):
    path = tmp_path / "scene.xml"
    pins = '<connect name="pin" body1="one" anchor="0 0 0.3"/><weld name="glue" body1="two" body2="one"/>'
    path.write_text(BODIES % pins.replace('body2="one"', ""))
    placed, flat = load_scene(path), load_robot(path)
    ends = {loop.name: loop for member in placed.members for loop in member.model.loops}
    assert sorted(ends) == ["glue", "pin"]
    for member, angle in zip(placed.members, (0.2, -0.1), strict=True):
        (loop,) = member.model.loops
        gap, whole = loop_gaps(member.model, [angle]), loop_gaps(flat, [0.2, -0.1])
        own = whole[:3] if loop.name == "pin" else whole[3:]
        np.testing.assert_allclose(np.linalg.norm(gap), np.linalg.norm(own), rtol=0, atol=1e-14)
    save_scene(placed, tmp_path / "again.xml")
    again = load_scene(tmp_path / "again.xml")
    for one, two in zip(placed.members, again.members, strict=True):
        assert [loop.name for loop in one.model.loops] == [loop.name for loop in two.model.loops]
        np.testing.assert_allclose(loop_gaps(one.model, [0.3]), loop_gaps(two.model, [0.3]), rtol=0, atol=1e-14)
    path.write_text(BODIES % pins)
    joined, flat = load_scene(path), load_robot(path)
    assert [[loop.name for loop in member.model.loops] for member in joined.members] == [["pin"], []]
    (glue,), own = joined.loops, next(loop for loop in flat.loops if loop.name == "glue")
    assert (glue.a, glue.b, glue.point_a, glue.rpy_a) == ("two/two", "one/one", own.point_a, own.rpy_a)


def test_equalities_that_are_not_active_close_nothing(tmp_path):
    path = tmp_path / "loop.xml"
    path.write_text(BODIES % '<connect body1="one" body2="two" anchor="0 0 0" active="false"/>')
    assert load_robot(path).loops == ()


def test_a_loop_of_toml_takes_the_place_of_the_same_one_in_mjcf(tmp_path):
    path = tmp_path / "loop.xml"
    path.write_text(BODIES % '<connect name="pin" body1="one" body2="two" anchor="0 0 0"/>')
    (tmp_path / "loop.toml").write_text('[[loops]]\nname = "pin"\nkind = "distance"\na = "one"\ndistance = 0.5\n')
    assert load_robot(path).loops == (Loop("pin", "distance", "one", distance=0.5),)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('name = "pin"\nkind = "glue"\na = "one"', ("line 1", "'glue'", "'connect'")),
        ('name = "pin"\nkind = "connect"\na = "nobody"', ("line 1", "'nobody'", "'two'")),
        ('name = "pin"\nkind = "connect"\na = "one"\nb = "one"', ("both ends", "'one'", "two different links")),
        ('name = "pin"\nkind = "distance"\na = "one"', ("distance", "0.0 m", "give the length")),
        ('name = "pin"\nkind = "connect"\na = "one"\ndistance = 1.0', ("1.0 m", "leave it out")),
        ('name = "pin"\nkind = "hinge"\na = "one"\naxis = [0, 0, 2]', ("axis", "unit length")),
        ('name = "pin"\nkind = "connect"\na = "one"\npoint = [0, 0, 2]', ("line 5", "unknown key 'point'", "point_a")),
        ('name = "pin"\nkind = "connect"\na = "one"\npoint_a = [0, 2]', ("line 5", "point_a", "three numbers")),
    ],
)
def test_wrong_loops_of_toml_are_refused_with_line_and_remedy(tmp_path, text, says):
    path = tmp_path / "loop.xml"
    path.write_text(BODIES % "")
    (tmp_path / "loop.toml").write_text(f"[[loops]]\n{text}\n")
    with pytest.raises(ValueError, match=r"loop\.toml: line") as error:
        load_robot(path)
    for word in says:
        assert word in str(error.value)


def test_wrong_loops_are_refused():
    model = four_bar()
    with pytest.raises(ValueError, match="'pin' is used 2 times"):
        replace(model, loops=model.loops * 2)
    with pytest.raises(ValueError, match=r"no link 'nobody'.*'rocker'"):
        replace(model, loops=(replace(model.loops[0], b="nobody"),))
    with pytest.raises(TypeError, match="loops"):
        replace(model, loops=("pin",))
    with pytest.raises(ValueError, match=r"a is 3.*in quotes"):
        Loop("pin", "connect", 3)


def test_scenes_that_cannot_keep_loops_closed_say_what_to_do():
    model = four_bar()
    with pytest.raises(ValueError, match=r"four-bar: integrator 'simtwo'.*'pin'.*'rk4'.*replace\(model, loops=\(\)\)"):
        compile_scene(model, integrator="simtwo")
    assert compile_scene(replace(model, loops=()), integrator="ars343").tree.n == 3


def test_a_start_is_closed_or_refused_with_its_gap():
    model = four_bar()
    scene, q = compile_scene(model), four_bar_angles(0.8)
    assert np.abs(loop_gaps(model, scene.state_view(initial_state(scene)).q)).max() < 1e-11
    with pytest.raises(ValueError, match=r"at this q loop 'pin' is open by 0\..*close_loops\(model, q\)"):
        initial_state(scene, q + 0.01)
    with pytest.raises(ValueError, match=r"at this qd loop 'pin' is open by .* m/s.*loop_jacobian"):
        initial_state(scene, q, np.ones(3))
    assert initial_state(scene, q, four_bar_rates(q)).size


# ------------------------------------------------------------------------------------------------ loops that do nothing


@pytest.mark.parametrize("kind", ["connect", "weld", "hinge", "distance"])
def test_a_loop_within_what_moves_as_one_does_nothing(kind):
    """Its rows move nothing, and their diagonal of L is rounding."""
    humanoid = load_robot("humanoid", locked=["left_knee"])
    more = {"distance": 0.1} if kind == "distance" else {}
    at = {"point_a": (0.03, 0.01, -0.02), "point_b": (0.01, 0.04, 0.06)}
    closed = replace(humanoid, loops=(Loop("extra", kind, "left_thigh", "left_shank", **at, **more),))
    q, qd, tau = (rows[0] for rows in random_states(humanoid, 1, 3))
    assert forward_dynamics(closed, q, qd, tau) == pytest.approx(forward_dynamics(humanoid, q, qd, tau), rel=1e-12)


def test_a_hinge_on_a_hinge_does_nothing():
    joint = Joint("swing", "continuous", "frame", "rod", (0.1, 0.2, 0.3), axis=Y)
    model = Model("pendulum", (Link("frame"), bar("rod", 1.0, 0.5, 0.03)), (joint,))
    twice = replace(model, loops=(Loop("again", "hinge", "frame", "rod", joint.xyz, axis=Y),))
    for angle in (0.0, 0.7, -2.0):
        a = forward_dynamics(twice, [angle], [1.5], [0.2])
        assert a == pytest.approx(forward_dynamics(model, [angle], [1.5], [0.2]), rel=1e-9)
        assert np.abs(loop_forces(twice, [angle], [1.5], [0.2])).max() < 100.0


def test_a_loop_that_is_off_by_half_a_turn_is_refused():
    joint = Joint("turn", "continuous", "frame", "rod", axis=Y)
    model = Model("door", (Link("frame"), bar("rod", 1.0, 0.5, 0.03)), (joint,))
    shut = replace(model, loops=(Loop("shut", "weld", "frame", "rod"),))
    scene = compile_scene(shut)
    with pytest.raises(ValueError, match="'shut' is off by half a turn; give close_loops"):
        initial_state(scene, [math.pi])
    state = initial_state(scene, [0.0])
    state[slice(*scene.part("q"))] = 0.3
    with pytest.raises(ValueError, match="loop 'shut' is open by"):
        simulate(scene, 0.1, state)


def test_a_rod_on_a_ball_joint_is_written_as_mjcf(tmp_path):
    links = Link("frame"), bar("rod", 1.0, 0.5, 0.03)
    model = Model("arm", links, (Joint("ball", "ball", "frame", "rod"),))
    loop = Loop("rod", "distance", "frame", "rod", (0.0, 0.3, 0.0), (0.5, 0.0, 0.0), distance=0.6)
    model = replace(model, loops=(loop,))
    save_robot(model, tmp_path / "arm.xml")
    assert load_robot(tmp_path / "arm.xml").loops[0].distance == pytest.approx(0.6, rel=1e-12)
