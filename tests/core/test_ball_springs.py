"""Springs and limits of ball joints: closed forms, MuJoCo with the same file, energy, orders, and the same bits."""

import math
from dataclasses import replace

import numpy as np
import pytest
from company import in_company, simulated
from mujoco_oracle import mujoco_model
from scipy.spatial.transform import Rotation

from featherstone_gait import (
    Joint,
    Link,
    Model,
    compile_scene,
    energy,
    forward_dynamics,
    initial_state,
    inverse_dynamics,
    load_robot,
    mass_matrix,
    save_robot,
    simulate,
)
from featherstone_gait.base.portable_math import angle

STILL = (0.0, 0.0, 0.0)
QUIET = {"estimate_error": False}
ALL = ("q", "qd")


def top(inertia=(0.02, 0.03, 0.04), offset=STILL, base="fixed", **joint):
    """A body on a ball joint, about whose center it turns, on a base that may float."""
    xx, yy, zz = inertia
    base_link = Link("base", 0.8, STILL, (0.1, 0.0, 0.0, 0.1, 0.0, 0.1))
    links = base_link, Link("body", 0.5, offset, (xx, 0.0, 0.0, yy, 0.0, zz))
    return Model("top", links, (Joint("ball", "ball", "base", "body", **joint),), base=base)


def turned_by(*vector):
    """Return the quaternion w x y z of a rotation vector."""
    x, y, z, w = Rotation.from_rotvec(vector).as_quat()
    return np.array([w, x, y, z])


def rotation_vector(q):
    return Rotation.from_quat(np.asarray(q)[..., [1, 2, 3, 0]]).as_rotvec()


def test_the_angle_of_a_direction():
    """In all octants and down to the smallest numbers, against the libm."""
    rng = np.random.default_rng(0)
    flat = rng.normal(size=(99, 2)) * [1e-9, 1.0]
    y, x = np.vstack([rng.normal(size=(999, 2)), flat, [[0.0, -1.0], [1e-99, 1e-99]]]).T
    np.testing.assert_allclose(angle(y, x), np.arctan2(y, x), rtol=1e-15, atol=1e-15)
    assert angle(0.0, 0.0) == 0.0


@pytest.mark.parametrize("integrator", ["rk4", pytest.param("dop853", marks=pytest.mark.long)])
def test_a_ball_of_equal_inertias_swings_through_large_angles_as_a_spring(integrator):
    """About one axis the angle is a cos(w t) whatever its size, w = sqrt(K / J)."""
    K, J, a, axis = 2.0, 0.02, 2.5, np.array([1.0, -2.0, 2.0]) / 3.0
    step = 1e-3 if integrator == "rk4" else None
    scene = in_company(top((J, J, J), stiffness=K), integrator, step, gravity=STILL)
    run = simulated(scene, 0.7, turned_by(*(a * axis)), rtol=None if step else 1e-11)
    expected = a * np.cos(math.sqrt(K / J) * run["time"])[:, None] * axis
    np.testing.assert_allclose(rotation_vector(run["q"]), expected, rtol=0, atol=1e-6 if step else 1e-9)


@pytest.mark.quick("fixed")
@pytest.mark.parametrize("base", ["fixed", "floating"])
def test_energy_and_dynamics_know_the_springs(base):
    model = top(offset=(0.1, 0.2, -0.1), base=base, stiffness=3.0)
    first = (7, 6) if base == "floating" else (0, 0)
    loose = replace(model, joints=[replace(model.joints[0], stiffness=0.0)])
    q = np.concatenate([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0][: first[0]], turned_by(1.0, -0.5, 0.8)])
    qd = np.linspace(-1.0, 1.0, first[1] + 3)
    stored = energy(model, q, qd).potential - energy(loose, q, qd).potential
    assert stored == pytest.approx(1.5 * (1.0 + 0.25 + 0.64), rel=1e-12)
    tau = np.zeros(first[1] + 3)
    tau[first[1] :] = -3.0 * np.array([1.0, -0.5, 0.8])
    np.testing.assert_allclose(forward_dynamics(model, q, qd, 0 * tau), forward_dynamics(loose, q, qd, tau), atol=1e-12)
    found, expected = (inverse_dynamics(one, q, qd, 0 * tau) for one in (model, loose))
    np.testing.assert_allclose(found + tau, expected, atol=1e-12)
    if first[0]:
        scene = compile_scene(model, integrator="rk4", timestep=5e-4)
        run = simulate(scene, 0.2, initial_state(scene, q, qd), record=("base_q", "base_qd", *ALL), **QUIET)
        states = (np.hstack([run[f"base_{x}"], run[x]]) for x in ALL)
    else:
        run = simulated(in_company(model, "rk4", 5e-4), 0.2, q, qd)
        states = run["q"], run["qd"]
    total = energy(model, *states).total
    np.testing.assert_allclose(total, total[0], rtol=0, atol=1e-8 * np.abs(total).max())


@pytest.mark.quick("implicit_euler")
@pytest.mark.parametrize("integrator", ["midpoint", "implicit_euler"])
def test_order_with_a_spring(integrator):
    model, ends = top(offset=(0.1, 0.2, -0.1), stiffness=3.0, damping=0.02), []
    for name, h in (("rk4", 1e-4), (integrator, 2e-3), (integrator, 1e-3)):
        start = turned_by(1.0, -0.5, 0.8), [1.0, 2.0, -1.0]
        ends.append(simulated(in_company(model, name, h), 0.2, *start, record=("q",))["q"][-1])
    errors = [np.abs(end - ends[0]).max() for end in ends[1:]]
    assert errors[0] / errors[1] == pytest.approx(4.0 if integrator == "midpoint" else 2.0, rel=0.1)


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["ars343", "extrapolation"])
@pytest.mark.parametrize("upper", [math.inf, 1.0])
def test_error_control_knows_springs_and_limits(integrator, upper):
    model, ends = top(offset=(0.1, 0.2, -0.1), stiffness=3.0, damping=0.02, upper=upper, effort=50.0), []
    for name, tolerance in (("dop853", 1e-11), (integrator, 1e-8)):
        scene = compile_scene(model, integrator=name)
        start = initial_state(scene, turned_by(0.5, -0.5, 0.6), [6.0, -4.0, 2.0])
        run = simulate(scene, 0.3, start, record=("q",), rtol=tolerance, **QUIET)
        ends.append(run["q"][-1])
    turned = np.linalg.norm(rotation_vector(run["q"]), axis=1)
    assert turned.max() > 1.1 if upper == math.inf else 0.99 < turned.max() < 1.05
    np.testing.assert_allclose(ends[1], ends[0], rtol=0, atol=1e-5)


def test_an_implicit_step_bears_any_spring():
    """A spring of a thousand times what explicit steps of this length bear brings the joint to rest at zero."""
    model = top(offset=(0.1, 0.0, 0.0), stiffness=1e6, damping=10.0)
    scene = in_company(model, "implicit_euler", 1e-2)
    assert scene.preflight.largest_explicit_step < 1e-3
    run = simulated(scene, 3.0, turned_by(0.01, -0.02, 0.01))
    assert run.ok
    moment = 0.5 * 9.81 * 0.1
    np.testing.assert_allclose(rotation_vector(run["q"][-1]), [0.0, moment / 1e6, 0.0], rtol=0, atol=2e-8)


@pytest.mark.parametrize("stiffness", [0.0, 5.0])
def test_one_implicit_step_is_a_dense_solution(stiffness):
    """(M + h^2 (K + k n n')) v = M v0 - h (K x + k (|x| - limit) n + c), n the axis of x, beyond a limit."""
    h, x = 1e-3, np.array([0.6, -0.5, 0.4])
    size = np.linalg.norm(x)
    model = top(offset=(0.1, 0.2, -0.1), stiffness=stiffness, upper=size - 0.02)
    scene = in_company(model, "implicit_euler", h, gravity=STILL)
    scene.constants.tendons.stops.damping = 0.0
    k, n = scene.constants.tendons.stops.stiffness[-1], x / size
    run = simulated(scene, h, turned_by(*x), record=("qd",), record_interval=h)
    pull = -h * (stiffness * x + 0.02 * k * n)
    M = mass_matrix(model, turned_by(*x))
    v = np.linalg.solve(M + h * h * (stiffness * np.eye(3) + k * np.outer(n, n)), pull)
    np.testing.assert_allclose(run["qd"][1], v, rtol=0, atol=1e-10 * np.abs(v).max())


def test_a_limit_throws_the_body_back_about_any_axis():
    """With equal inertias the limit meets the whole speed, and takes what its damping takes."""
    model = top((0.02, 0.02, 0.02), upper=0.5, effort=50.0)
    scene = in_company(model, "rk4", 2e-5, gravity=STILL)
    axis = np.array([2.0, 1.0, -2.0]) / 3.0
    run = simulated(scene, 0.4, turned_by(*(0.4 * axis)), 2.0 * axis, record=ALL, record_interval=2e-4)
    turned = rotation_vector(run["q"])
    assert 0.5 < np.linalg.norm(turned, axis=1).max() < 0.55
    assert -2.0 < run["qd"][-1] @ axis < -0.3
    np.testing.assert_allclose(np.cross(turned, axis), 0.0, atol=1e-9)


@pytest.mark.filterwarnings("error")
def test_springs_and_limits_are_those_of_mujoco(tmp_path):
    """Accelerations with springs of a ball joint below another, and the angle at which a limit begins."""
    file, saved = tmp_path / "arm.xml", tmp_path / "saved.xml"
    file.write_text("""<mujoco><compiler angle="radian"/><worldbody><body><joint name="a" type="ball" stiffness="3"
    damping=".1" range="0 1.2" limited="true"/><geom type="box" size=".1 .05 .03" pos=".1 .02 0" mass=".4"/>
    <body pos=".2 0 0" euler=".3 .2 -.4"><joint name="b" type="ball" stiffness="0.7"/>
    <geom type="box" size=".03 .05 .1" pos="0 .1 .1" mass=".2"/></body></body></worldbody></mujoco>""")
    model = load_robot(file, strict=True)
    assert [(j.stiffness, j.upper) for j in model.joints] == [(3.0, 1.2), (0.7, math.inf)]
    save_robot(model, saved)
    again = load_robot(saved, strict=True)
    assert [(j.stiffness, j.upper) for j in again.joints] == [(3.0, 1.2), (0.7, math.inf)]
    mujoco, m, d = mujoco_model(saved)
    rng = np.random.default_rng(0)
    beyond = 0
    for _ in range(20):
        q, qd = rng.normal(size=8), rng.normal(size=6)
        q[:4] /= np.linalg.norm(q[:4])
        q[4:] /= np.linalg.norm(q[4:])
        m.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT
        d.qpos, d.qvel = q, qd
        mujoco.mj_forward(m, d)
        found = forward_dynamics(model, q, qd, [*(-0.1 * qd[:3]), 0.0, 0.0, 0.0])
        np.testing.assert_allclose(found, d.qacc, rtol=0, atol=1e-10 * np.abs(d.qacc).max())
        m.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
        mujoco.mj_forward(m, d)
        turned = np.linalg.norm(rotation_vector(q[:4]))
        beyond += d.nefc
        assert d.nefc == (turned > 1.2)
        if d.nefc:
            assert d.efc_pos[0] == pytest.approx(1.2 - turned, abs=1e-12)
            x = rotation_vector(q[:4]) / turned
            np.testing.assert_allclose(d.efc_J[:3], -x, atol=1e-12)
    assert 0 < beyond < 20


def test_springs_and_limits_through_urdf_and_toml(tmp_path):
    model = top(stiffness=3.0, upper=1.2, effort=40.0)
    save_robot(model, tmp_path / "top.urdf")
    assert load_robot(tmp_path / "top.urdf").joints == model.joints


@pytest.mark.parametrize(
    ("joint", "message"),
    [
        ({"upper": 4.0}, "type 'ball' has limits -inf to 4.0; expected no lower one"),
        ({"lower": -1.0, "upper": 1.0}, "type 'ball' has limits -1.0 to 1.0; expected no lower one"),
        ({"stiffness": 1.0, "spring_reference": 0.1}, "type 'ball' has spring_reference 0.1; expected 0"),
        ({"stiffness": 1.0, "cubic_stiffness": 0.1}, "type 'ball' has a nonlinear spring"),
    ],
)
def test_wrong_springs_and_limits_are_refused(joint, message):
    with pytest.raises(ValueError, match=message):
        top(**joint)
