"""Rolling resistance of contact points on the ground against closed forms and MuJoCo."""

import math

import numpy as np
import pytest

from featherstone_gait import (
    ContactPoint,
    Ground,
    Joint,
    Link,
    Model,
    Placed,
    SceneModel,
    Sphere,
    body,
    compile_scene,
    initial_state,
    load_scene,
    simulate,
    simulate_batch,
)

G, R, RHO = 9.81, 0.1, 2e-3


def rolling(scene, speed):
    """Return a state in which a ball rolls along x."""
    y = initial_state(scene)
    view = scene.state_view(y)
    view.base_qd[0], view.base_qd[4] = speed, speed / R
    return y


@pytest.mark.long
def test_a_rolling_ball_slows_down_and_rests_on_a_slope_while_its_moment_holds():
    """It loses rho g / (r (1 + J / m r^2)); on a slope it rests up to tan = rho / r."""
    ball = body(Sphere(R), 1.0, rolling_friction=RHO)
    scene = compile_scene(ball, ground=Ground(penetration=1e-5), fall_height=-1e6, fall_tilt=math.pi)
    record = ("base_q", "base_qd", "contact_work")
    run = simulate(scene, 2.0, rolling(scene, 0.5), record=record, rtol=1e-8)
    lost = RHO * G / (1.4 * R)
    t, v = run["time"], run["base_qd"][:, 0]
    assert np.diff(v[20:]) / np.diff(t[20:]) == pytest.approx(-lost, rel=1e-5)
    assert v[-1] == pytest.approx(0.5 - 2.0 * lost, rel=1e-3)
    kinetic = 0.5 * 1.4 * (v[-1] ** 2 - 0.25)
    assert run["contact_work"][-1, 0] == pytest.approx(kinetic, rel=1e-4)  # the ground takes it all
    stopped = simulate(scene, 1.0, run.final, rtol=1e-8, record=record)  # it needs 3.6 s to rest
    assert stopped["base_qd"][-1, 0] == pytest.approx(0.5 - 3.0 * lost, rel=1e-3)
    for share in (0.95, 1.05):
        angle = math.atan(share * RHO / R)
        tilted = compile_scene(ball, ground=Ground(slope=-angle, penetration=1e-5), fall_height=-1e6, fall_tilt=math.pi)
        away = simulate(tilted, 4.0, record=("base_q",), rtol=1e-8)["base_q"][:, 0]
        if share < 1.0:
            assert abs(away[-1] - away[len(away) // 2]) < 1e-7
        else:
            pull = G * (math.sin(angle) - RHO / R * math.cos(angle)) / 1.4 * math.cos(angle)
            assert away[-1] == pytest.approx(0.5 * pull * 16.0, rel=0.02)


def wheel(resistance=RHO):
    """Return a wheel on an axle that slides along x and z."""
    links = Link("ground"), Link("x"), Link("z"), Link("wheel", 1.0, (0.0, 0.0, 0.0), (2e-3, 0.0, 0.0, 4e-3, 0.0, 2e-3))
    joints = (
        Joint("along", "prismatic", "ground", "x", axis=(1.0, 0.0, 0.0), lower=-1e3, upper=1e3),
        Joint("up", "prismatic", "x", "z", axis=(0.0, 0.0, 1.0), lower=-1e3, upper=1e3),
        Joint("axle", "continuous", "z", "wheel", axis=(0.0, 1.0, 0.0)),
    )
    rim = ContactPoint("wheel", (0.0, 0.0, 0.0), circle_radius=R, axis=(0.0, 1.0, 0.0), rolling_friction=resistance)
    return Model("cart", links, joints, contacts=(rim,))


@pytest.mark.long
def test_a_wheel_slows_down_with_all_integrators_and_has_the_same_bits_in_lanes():
    lost = RHO * G / (R * (1.0 + 4e-3 / (1.0 * R * R)))
    for integrator, step in (("implicit_euler", 1e-3), ("midpoint", 1e-3), ("rk4", 1e-4)):
        scene = compile_scene(wheel(), ground=Ground(), integrator=integrator, timestep=step)
        starts = []
        for k in range(9):
            y = initial_state(scene)
            scene.state_view(y).q[1] = R - 5e-4
            scene.state_view(y).qd[:] = 0.3 + 0.1 * k, 0.0, (0.3 + 0.1 * k) / R
            starts.append(y)
        how = {"record": ("qd",), "estimate_error": False}
        together = simulate_batch(scene, 0.5, starts, **how) if integrator == "midpoint" else None
        for k in (0, 8):
            alone = simulate(scene, 0.5, starts[k], **how)
            assert together is None or alone.final.tobytes() == together[k].final.tobytes()
            rate = (alone["qd"][-1, 0] - alone["qd"][20, 0]) / (alone["time"][-1] - alone["time"][20])
            assert rate == pytest.approx(-lost, rel=1e-3)


@pytest.mark.long
def test_balls_of_mjcf_roll_as_in_mujoco(tmp_path):
    """The third friction of geoms of condim 6 is a rolling friction on the ground too."""
    mujoco = pytest.importorskip("mujoco")
    text = """<mujoco><option timestep="1e-3" cone="elliptic" impratio="100"/><worldbody>
      <geom type="plane" size="9 9 .1" friction="1 0 0.002" condim="6"/>
      <body pos="0 0 0.1"><freejoint/><geom type="sphere" size="0.1" mass="1" friction="1 0 0.002" condim="6"/></body>
      </worldbody></mujoco>"""
    (tmp_path / "ball.xml").write_text(text)
    scene = load_scene(tmp_path / "ball.xml")
    assert scene.members[0].model.contacts[0].rolling_friction == 0.002
    members = [Placed(scene.members[0].model, "ball"), Placed(body(Sphere(R), 1.0, name="free"), position=(1.0, 1.0))]
    compiled = compile_scene(SceneModel("two", members, ground=scene.ground))
    y = initial_state(compiled)
    compiled.state_view(y).base_qd[:, [0, 4]] = 0.5, 0.5 / R
    run = simulate(compiled, 1.5, y, record=("base_qd",), rtol=1e-7)
    machine = mujoco.MjModel.from_xml_path(str(tmp_path / "ball.xml"))
    data = mujoco.MjData(machine)
    data.qvel[0], data.qvel[4] = 0.5, 0.5 / R
    for _ in range(1500):
        mujoco.mj_step(machine, data)
    assert data.qvel[0] < 0.32
    assert run["ball"]["base_qd"][-1, 0] == pytest.approx(data.qvel[0], rel=1e-3)
    assert run["free"]["base_qd"][-1, 0] == pytest.approx(0.5, rel=1e-5)  # beside it one that rolls freely


def test_a_point_that_cannot_roll_has_no_resistance():
    with pytest.raises(ValueError, match="rolling_friction"):
        ContactPoint("a", (0.0, 0.0, 0.0), rolling_friction=1e-3)
    with pytest.raises(ValueError, match="rolling_friction"):
        ContactPoint("a", (0.0, 0.0, 0.0), 0.1, rolling_friction=-1e-3)
