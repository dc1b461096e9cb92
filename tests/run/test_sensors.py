"""What sensors read: at rest gravity and weight, in motion what rigid-body kinematics says."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import G, arm_scene, box_on, resting, rotations, standing_humanoid, thrown

from featherstone_gait import ContactSensor, Session, compile_scene, forward_dynamics, simulate_batch
from featherstone_gait.dynamics import center_of_mass
from featherstone_gait.model import Ground
from featherstone_gait.robot_file import load_robot
from featherstone_gait.run import sensors
from featherstone_gait.run.compiled_run import CompiledRun
from featherstone_gait.run.simulate import Push, initial_state, simulate
from featherstone_gait.run.trajectory import Trajectory

CHANNELS = ("q", "base_q", "base_qd", "base_qdd", "contact_force")


@pytest.fixture(scope="module")
def standing():
    scene, run = standing_humanoid("midpoint", 30.0, CHANNELS)
    return scene, run, rotations(run["base_q"][-1:, 3:])[0]


def test_the_accelerometer_of_a_standing_robot_reads_gravity_upward(standing):
    scene, run, R = standing
    np.testing.assert_allclose(R @ sensors.accelerometer(scene, run)[-1], [0.0, 0.0, G], rtol=0, atol=1e-6)
    np.testing.assert_allclose(sensors.gyroscope(scene, run)[-1], 0.0, rtol=0, atol=1e-6)


def test_the_soles_carry_the_weight_and_each_half_of_it(standing):
    scene, run, _ = standing
    forces = sensors.sole_forces(scene, run)
    assert list(forces) == ["left_foot", "right_foot"]
    left, right = forces["left_foot"][-1], forces["right_foot"][-1]
    np.testing.assert_allclose(left + right, [0.0, 0.0, scene.model.mass * G], rtol=0, atol=1e-6)
    assert left[2] == pytest.approx(right[2], rel=1e-6)
    assert left[1] == pytest.approx(-right[1], abs=1e-6)


def test_the_center_of_pressure_of_a_robot_at_rest_is_under_its_center_of_mass(standing):
    scene, run, _ = standing
    pressure = sensors.center_of_pressure(scene, run)[-1]
    mass = center_of_mass(scene.model, np.concatenate([run["base_q"][-1], run["q"][-1]]))
    np.testing.assert_allclose(pressure[:2], mass[:2], rtol=0, atol=1e-6)
    assert pressure[2] == pytest.approx(-scene.ground.penetration, rel=0.05)
    left, right = (sensors.center_of_pressure(scene, run, foot)[-1] for foot in ("left_foot", "right_foot"))
    assert left[1] > 0.0 > right[1]
    np.testing.assert_allclose(0.5 * (left + right)[:2], pressure[:2], rtol=0, atol=1e-6)


@pytest.mark.nojit
def test_in_free_fall_an_accelerometer_in_the_center_of_mass_reads_nothing():
    scene = box_on(Ground(height=-10.0))
    run = simulate(scene, 0.1, initial_state(scene, np.eye(7)[3], [0.1, 0.2, 0.3, 3.0, -2.0, 1.0]), record=CHANNELS)
    np.testing.assert_allclose(sensors.accelerometer(scene, run)[1:], 0.0, rtol=0, atol=1e-12)


@pytest.mark.nojit
def test_beside_the_axis_of_a_spin_an_accelerometer_reads_the_centripetal_acceleration():
    scene = box_on(Ground(height=-10.0))
    run = simulate(scene, 0.1, initial_state(scene, np.eye(7)[3], [0.0, 0.0, 0.0, 0.0, 0.0, 4.0]), record=CHANNELS)
    reading = sensors.accelerometer(scene, run, (0.1, 0.0, 0.02))
    np.testing.assert_allclose(reading[1:], [[-1.6, 0.0, 0.0]] * 10, rtol=0, atol=1e-12)
    np.testing.assert_allclose(sensors.gyroscope(scene, run), [[0.0, 0.0, 4.0]] * 11, rtol=0, atol=1e-12)


def test_an_accelerometer_reads_what_differences_of_its_velocity_say():
    """A tumbling box that lands: specific force times the step is the change of velocity less that by gravity."""
    scene, h, place = box_on(Ground()), 1e-3, np.array([0.1, -0.05, 0.03])
    run = simulate(scene, 0.2, thrown(scene, 0.01, 0.3, (0.2, 0.1, -0.3)), record=CHANNELS, record_interval=h)
    R, omega = rotations(run["base_q"][:, 3:]), run["base_qd"][:, 3:]
    at_origin = np.einsum("kij,kj->ki", R[1:], sensors.accelerometer(scene, run)[1:])
    change = np.diff(run["base_qd"][:, :3], axis=0) / h + [0.0, 0.0, G]
    np.testing.assert_allclose(at_origin, change, rtol=0, atol=1e-3 * np.abs(change).max() + 1e-9)
    lever = sensors.accelerometer(scene, run, place)[1:] - sensors.accelerometer(scene, run)[1:]
    alpha = np.diff(omega, axis=0) / h
    expected = np.cross(alpha, place) + np.cross(omega[1:], np.cross(omega[1:], place))
    np.testing.assert_allclose(lever, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.nojit
def test_on_a_slope_the_ground_carries_a_box_straight_up():
    scene = box_on(Ground(slope=0.2, friction=0.9))
    run = simulate(scene, 2.0, resting(scene), record=CHANNELS)
    force, pressure = sensors.sole_forces(scene, run)["box"][-1], sensors.center_of_pressure(scene, run)[-1]
    np.testing.assert_allclose(force, [0.0, 0.0, G], rtol=0, atol=1e-9)
    np.testing.assert_allclose(pressure[:2], run["base_q"][-1, :2], rtol=0, atol=1e-4)  # plumb under its middle


@pytest.mark.long
def test_a_push_moves_the_center_of_pressure_by_its_moment_over_the_weight():
    scene = box_on(Ground())
    push = Push("box", (0.5, 0.0, 0.0), point=(0.0, 0.0, 0.05))
    run = simulate(scene, 3.0, resting(scene), pushes=[push], record=CHANNELS)
    moved = sensors.center_of_pressure(scene, run)[-1] - run["base_q"][-1, :3]
    assert moved[0] == pytest.approx(0.5 * 0.1 / G, rel=0.02)
    assert moved[1] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.nojit
def test_in_the_air_there_is_no_center_of_pressure():
    scene = box_on(Ground())
    run = simulate(scene, 0.05, thrown(scene, 0.1), record=CHANNELS)
    assert np.isnan(sensors.center_of_pressure(scene, run)).all()
    assert not sensors.sole_forces(scene, run)["box"].any()


@pytest.mark.nojit
def test_encoders_read_the_nearest_step():
    arm, step = load_robot("arm7"), np.radians(0.29)
    servos = {name: replace(servo, encoder_resolution=step) for name, servo in arm.servos.items() if name != "joint7"}
    scene = arm_scene(replace(arm, servos=servos))
    q = np.outer([0.0, 0.4, 0.6, -1.4, -7.6, 1.0], np.full(7, step))
    read = sensors.encoders(scene, Trajectory({"q": q}, "ok", "", 0.0, np.zeros(0)))
    counts = np.outer([0.0, 0.0, 1.0, -1.0, -8.0, 1.0], np.ones(6))
    np.testing.assert_allclose(read[:, :6], counts * step, rtol=0, atol=1e-15)
    assert np.array_equal(read[:, 6], q[:, 6])  # a joint without a servo has no encoder to round it


@pytest.mark.nojit
def test_what_cannot_be_read_is_said():
    scene = box_on(Ground())
    run = simulate(scene, 0.02, record=("q",))
    with pytest.raises(ValueError, match=r"channels \['contact_force'\] were not recorded"):
        sensors.sole_forces(scene, run)
    with pytest.raises(ValueError, match="link 'hand' has no contact points; use one of box"):
        sensors.center_of_pressure(scene, run, "hand")
    with pytest.raises(ValueError, match="an IMU needs a floating base"):
        sensors.gyroscope(arm_scene(), run)
    with pytest.raises(ValueError, match="no ground in this scene"):
        sensors.sole_forces(arm_scene(), run)


# ------------------------------------------------------------------------------------------------ the first sample


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["implicit_euler", "midpoint", "rk4", "dop853", "ars343", "extrapolation"])
def test_the_first_sample_has_the_accelerations_of_the_start(integrator, monkeypatch):
    """They are those of forward dynamics, alone, in lanes and in a session, and leave the run as it is."""
    model, q, qd, tau = load_robot("arm7"), 0.3 * np.arange(7), np.full(7, 0.2), np.full(7, 0.1)
    scene = compile_scene(model, integrator=integrator, timestep=1e-3)
    y = initial_state(scene, q, qd)
    run = simulate(scene, 0.02, y, tau=tau, record=("qdd", "torque"), estimate_error=False)
    wanted = forward_dynamics(model, q, qd, tau)
    np.testing.assert_allclose(run["qdd"][0], wanted, rtol=0, atol=1e-7 * np.abs(wanted).max())
    assert run["torque"][0] == pytest.approx(tau)
    lanes = simulate_batch(scene, 0.02, [y] * 9, taus=[tau] * 9, record=("qdd",), estimate_error=False)
    assert all(np.array_equal(one["qdd"][0], run["qdd"][0]) for one in lanes)
    with Session(scene, n=3, observe=("qdd",), record=("qdd",)) as session:
        free = session.reset(state=y)["qdd"]
        np.testing.assert_allclose(free[2], forward_dynamics(model, q, qd, 0.0 * tau), rtol=0, atol=1e-4)
        session.step(tau)
        assert np.array_equal(session.trajectory(1)["qdd"][0], run["qdd"][0])
    monkeypatch.setattr(CompiledRun, "begins", lambda self, y: False)
    bare = simulate(scene, 0.02, y, tau=tau, record=("qdd", "torque"), estimate_error=False)
    assert not bare["qdd"][0].any()
    assert bare.final.tobytes() == run.final.tobytes()
    assert np.array_equal(bare["qdd"][1:], run["qdd"][1:])


@pytest.mark.long
def test_what_touches_at_the_start_pushes_in_the_first_sample():
    """Depth by stiffness on each corner of a box, by Newton its acceleration, and a switch that is closed."""
    scene = compile_scene(load_robot("humanoid"), "mipsd", Ground(), "midpoint", 1e-3)
    switch = ContactSensor("left_foot", name="touches")
    run = simulate(scene, 0.02, record=("contact_force", "base_qdd", switch, "accelerometer"), estimate_error=False)
    assert (run["contact_force"][0, :, 0] > 1.0).all()
    assert run["touches"][0, 0] == 1.0
    np.testing.assert_allclose(run["accelerometer"][0], run["base_qdd"][0, :3] + [0.0, 0.0, 9.81], atol=1e-6)
    with Session(scene, n=9, observe=("contact_force", switch)) as session:
        seen = session.observe()
        assert np.array_equal(seen["contact_force"][3], run["contact_force"][0])
        assert seen["touches"].all()
