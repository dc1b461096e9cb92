"""Contact with the ground: what friction, impact and rest must do, whatever the integrator."""

import math
from itertools import pairwise

import numpy as np
import pytest
from scenes import (
    G,
    along,
    box,
    box_on,
    elastic_energy,
    normal_to,
    resting,
    standing_humanoid,
    thrown,
    total_energy,
)

from featherstone_gait.model import Ground
from featherstone_gait.robot_file import load_robot
from featherstone_gait.run.sensors import contact_positions
from featherstone_gait.run.simulate import Push, initial_state, simulate
from featherstone_gait.scene.compile import compile_scene

INTEGRATORS = ("implicit_euler", "midpoint", "rk4")
LINEARLY_IMPLICIT = ("implicit_euler", "midpoint")
CHANNELS = ("base_q", "base_qd", "tangential_deflection", "contact_force", "contact_work")
MU = 0.5

every_integrator = pytest.mark.parametrize("integrator", INTEGRATORS)


# Rest.


@pytest.mark.nojit
@pytest.mark.parametrize(("penetration", "damping_ratio"), [(5e-4, 0.7), (2e-3, 0.2), (1e-4, 1.0)])
def test_a_box_sinks_in_as_far_as_asked_for(penetration, damping_ratio):
    scene = box_on(Ground(penetration=penetration, damping_ratio=damping_ratio))
    run = simulate(scene, 1.0, thrown(scene, penetration / 2), record=CHANNELS)
    assert run["base_q"][-1, 2] == pytest.approx(0.05 - penetration, abs=1e-6 * penetration)
    np.testing.assert_allclose(run["contact_force"][-1, :, 0], G / 4, rtol=1e-6)


@pytest.mark.long
@pytest.mark.parametrize("integrator", LINEARLY_IMPLICIT)
def test_a_standing_humanoid_sinks_in_as_asked_carries_its_weight_and_does_not_creep(integrator):
    scene, run = standing_humanoid(integrator, 20.0)
    assert run.ok
    positions = contact_positions(scene, run)
    force = run["contact_force"][-1, :, 0]
    assert force.sum() == pytest.approx(scene.model.mass * G, rel=1e-6)
    assert -positions[-1, :, 2].mean() == pytest.approx(scene.ground.penetration, rel=1e-6)
    np.testing.assert_allclose(-positions[-1, :, 2], force / scene.constants.contact.points.stiffness, rtol=1e-4)
    after_start, last_ten = positions - positions[0], positions[1000:] - positions[1000]
    assert np.abs(after_start[:1001, :, :2]).max() < 1e-4  # [m] in 10 s, settling of the legs included
    assert np.abs(last_ten).max() < 1e-6


@every_integrator
def test_a_resting_box_does_not_creep_at_all(integrator):
    scene = box_on(Ground(friction=MU, slope=0.8 * math.atan(MU)), integrator)
    run = simulate(scene, 20.0, resting(scene), record=CHANNELS)
    half = len(run["base_q"]) // 2
    assert np.abs(run["base_q"][half:] - run["base_q"][half]).max() < 1e-12


# Friction.


@every_integrator
def test_a_box_on_a_slope_sticks_below_and_slips_above_the_angle_of_friction(integrator):
    for difference in (-1e-2, 1e-2):
        slope = math.atan(MU) + difference
        scene = box_on(Ground(friction=MU, slope=slope), integrator)
        run = simulate(scene, 2.0, resting(scene), record=CHANNELS)
        speed = along(scene, run["base_qd"][-1, :3])
        if difference < 0:
            assert abs(speed) < 1e-12
        else:
            assert speed < -0.1


@every_integrator
@pytest.mark.parametrize("slope", [-0.7, 0.5, 0.8])
def test_a_box_slides_down_with_g_times_sine_less_mu_cosine(integrator, slope):
    scene = box_on(Ground(friction=MU, slope=slope), integrator)
    run = simulate(scene, 1.0, resting(scene), record=CHANNELS, record_interval=0.5)
    speed = along(scene, run["base_qd"][:, :3])
    downhill = -math.copysign(1.0, slope)
    expected = downhill * G * (math.sin(abs(slope)) - MU * math.cos(slope))
    assert (speed[2] - speed[1]) / 0.5 == pytest.approx(expected, rel=1e-9)
    sunk = 0.05 - normal_to(scene, run["base_q"][-1, :3])
    assert sunk == pytest.approx(scene.ground.penetration * math.cos(slope), rel=1e-5)


@every_integrator
@pytest.mark.parametrize("direction", [0.0, 0.3, math.pi / 4, 2.0])
def test_friction_stops_a_sliding_box_after_v_squared_over_two_mu_g_in_any_direction(integrator, direction):
    scene = box_on(Ground(friction=MU), integrator)
    v = 1.0
    run = simulate(scene, 1.0, resting(scene, (v * math.cos(direction), v * math.sin(direction), 0.0)), record=CHANNELS)
    x, y = run["base_q"][-1, :2]
    # The bristles, deflected by mu times the penetration, have to be wound up and spring back.
    backlash = 2 * MU * scene.ground.penetration + v * scene.timestep
    assert math.hypot(x, y) == pytest.approx(v**2 / (2 * MU * G), abs=backlash)
    assert math.atan2(y, x) == pytest.approx(direction, abs=1e-9)
    assert np.abs(run["base_qd"][-1]).max() < 1e-9


@pytest.mark.long
@pytest.mark.parametrize("direction", [0.0, 0.7])
def test_a_push_below_mu_m_g_does_not_move_a_box_and_one_above_does(direction):
    scene = box_on(Ground(friction=MU))
    toward = np.array([math.cos(direction), math.sin(direction), 0.0])
    runs = {
        share: simulate(
            scene,
            11.0,
            resting(scene),
            pushes=[Push("box", tuple(share * MU * G * toward), point=(0.0, 0.0, -0.05), start=0.1, end=10.1)],
            record=CHANNELS,
        )
        for share in (0.8, 1.2)
    }
    held = runs[0.8]["base_q"][:, :3] @ toward
    assert held.max() < 1.1 * scene.ground.penetration  # the bristles give by mu times as much as the ground
    assert abs(held[1000] - held[100]) < 1e-9  # creep in 9 s of push
    assert abs(held[-1]) < 1e-5  # it returns
    assert runs[1.2]["base_qd"][1000, :3] @ toward == pytest.approx(0.2 * MU * G * 9.9, rel=0.01)


@pytest.mark.nojit
def test_without_friction_nothing_slows_a_box():
    scene = box_on(Ground(friction=0.0))
    run = simulate(scene, 0.5, resting(scene, (0.3, -0.2, 0.0)), record=CHANNELS)
    np.testing.assert_allclose(run["base_qd"][:, :2], [[0.3, -0.2]] * len(run["base_qd"]), rtol=0, atol=1e-15)


# Impact.


def dropped(integrator, timestep, damping_ratio, tilt=0.2, duration=0.6):
    """A box let fall from 20 mm with some speed sideways, every step recorded."""
    scene = box_on(Ground(friction=MU, damping_ratio=damping_ratio), integrator, timestep)
    state = thrown(scene, 0.02, tilt, (0.1, 0.05, 0.0))
    return scene, simulate(scene, duration, state, record=CHANNELS, record_interval=timestep)


@pytest.mark.parametrize("tilt", [0.0, 0.2])
@pytest.mark.parametrize("damping_ratio", [0.0, 0.1, 0.7])
@pytest.mark.parametrize("timestep", [2e-3, 1e-3])
def test_with_the_implicit_step_energy_never_grows(timestep, damping_ratio, tilt):
    scene, run = dropped("implicit_euler", timestep, damping_ratio, tilt)
    E = total_energy(scene, run)
    assert np.diff(E).max() < 1e-13 * E[0]


@pytest.mark.parametrize("tilt", [0.0, 0.2])
@pytest.mark.parametrize("damping_ratio", [0.0, 0.1, 0.7])
@pytest.mark.parametrize("integrator", ["midpoint", "rk4"])
def test_of_higher_order_energy_grows_at_most_by_a_step_into_the_ground_and_falls_over_each_bounce(
    integrator, damping_ratio, tilt
):
    """A step that meets the ground within it sees the spring late: half a step's path stays unaccounted for."""
    for timestep in (2e-3, 1e-3, 5e-4):
        scene, run = dropped(integrator, timestep, damping_ratio, tilt)
        E = total_energy(scene, run)
        speed = np.abs(run["base_qd"][:, 2]).max() + 0.4 * np.abs(run["base_qd"][:, 3:]).max()
        bound = 0.5 * scene.constants.contact.points.stiffness.sum() * (0.5 * timestep * speed) ** 2
        assert (E - np.minimum.accumulate(E)).max() < bound
        flying = elastic_energy(scene, run) == 0.0
        assert E[flying].max() < E[0] + 1e-12 * E[0]


@every_integrator
def test_a_box_bounces_the_less_the_more_damping(integrator):
    heights = []
    for damping_ratio in (0.0, 0.05, 0.1, 0.2):
        run = dropped(integrator, 5e-4, damping_ratio, tilt=0.0, duration=0.3)[1]
        z, touching = run["base_q"][:, 2], run["contact_force"][:, :, 0].sum(axis=1) > 0.0
        first = int(np.argmax(touching))
        heights.append(z[first:].max() - 0.05)
    assert (np.diff(heights) < 0).all()
    assert heights[0] < 0.02 * (1 + 1e-3)  # never higher than it fell from
    assert heights[3] < 1e-3


def test_without_damping_an_accurate_bounce_returns_all():
    run = dropped("rk4", 1e-4, 0.0, tilt=0.0, duration=0.18)[1]
    assert run["base_q"][1000:, 2].max() - 0.05 == pytest.approx(0.02, rel=2e-3)


# Convergence.


@pytest.mark.parametrize(("integrator", "order"), [("implicit_euler", 1), ("midpoint", 2), ("rk4", 4)])
@pytest.mark.parametrize(
    "velocity", [(0.0, 0.0, -0.02, 0.0, 0.0, 0.0), (0.01, 0.005, -0.02, 0.05, 0.02, 0.05)], ids=["heave", "all"]
)
def test_while_a_box_sticks_the_step_has_its_order(integrator, order, velocity):
    ground = Ground(friction=0.9, damping_ratio=0.3, penetration=5e-3)

    def end(integrator, timestep):
        scene = box_on(ground, integrator, timestep)
        state = initial_state(scene, resting(scene)[:7], velocity)
        run = simulate(scene, 0.06, state, record=CHANNELS)
        assert run["contact_force"][1:, :, 0].min() > 0.0
        return np.concatenate([run["base_q"][-1], run["base_qd"][-1]])

    exact = end("rk4", 2.5e-5)
    steps = np.array([2e-3, 1e-3, 5e-4, 2.5e-4])
    errors = [np.abs(end(integrator, h) - exact).max() for h in steps]
    assert np.polyfit(np.log(steps), np.log(errors), 1)[0] == pytest.approx(order, abs=0.15)


@every_integrator
def test_a_whole_impact_converges(integrator):
    def end(timestep):
        run = dropped(integrator, timestep, 0.3, duration=0.4)[1]
        return np.concatenate([run["base_q"][-1], run["base_qd"][-1]])

    ends = [end(h) for h in (4e-3, 1e-3, 2.5e-4, 6.25e-5)]
    differences = [np.abs(a - b).max() for a, b in pairwise(ends)]
    assert differences[1] < 0.6 * differences[0]
    assert differences[2] < 0.6 * differences[1]
    assert differences[2] < 1e-3


def test_all_integrators_agree_on_an_impact():
    ends = []
    for integrator in INTEGRATORS:
        run = dropped(integrator, 6.25e-5, 0.3, duration=0.4)[1]
        ends.append(np.concatenate([run["base_q"][-1], run["base_qd"][-1]]))
    np.testing.assert_allclose(ends[0], ends[2], rtol=0, atol=1e-3)
    np.testing.assert_allclose(ends[1], ends[2], rtol=0, atol=1e-3)


# The ground's shape.


@every_integrator
def test_steps_in_the_ground_carry_at_their_heights(integrator):
    scene = box_on(Ground(steps=((0.5, 0.02), (1.5, -0.05))), integrator)
    for x, height in [(0.0, 0.0), (1.0, 0.02), (2.0, -0.03)]:
        run = simulate(scene, 1.0, initial_state(scene, [x, 0.0, 0.08, 1.0, 0.0, 0.0, 0.0]), record=CHANNELS)
        assert run["base_q"][-1, 2] == pytest.approx(height + 0.05 - scene.ground.penetration, abs=1e-7)


@pytest.mark.nojit
def test_a_box_on_the_edge_of_a_step_tips_toward_the_low_side():
    scene = box_on(Ground(steps=((0.1, 0.03),)))
    state = initial_state(scene, [0.0, 0.0, 0.081, 1.0, 0.0, 0.0, 0.0])  # the corners at x = 0.2 are over the step
    run = simulate(scene, 0.06, state, record=CHANNELS)
    assert run["base_qd"][-1, 4] < -1.0  # about y: the corners at x = -0.2 sink


def test_a_box_is_placed_on_a_step_to_begin_with():
    scene = box_on(Ground(steps=((-1.0, 0.02),)))
    assert initial_state(scene)[2] == pytest.approx(0.07 - scene.ground.penetration, abs=1e-15)


@every_integrator
def test_raising_the_ground_raises_the_motion(integrator):
    runs = []
    for height in (0.0, 0.25):
        scene = box_on(Ground(height=height, friction=MU), integrator)
        state = initial_state(scene, [0.0, 0.0, height + 0.07, 1.0, 0.0, 0.0, 0.0], [0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
        runs.append(simulate(scene, 0.3, state, record=CHANNELS)["base_q"])
    np.testing.assert_allclose(runs[1], runs[0] + [0, 0, 0.25, 0, 0, 0, 0], rtol=0, atol=1e-12)


@pytest.mark.long
def test_far_from_the_ground_the_bits_are_those_of_a_scene_without():
    parts = ("q", "qd", "base_q", "base_qd", "energy", "rotor", "current")
    model = load_robot("humanoid")
    q, qd = np.eye(model.nq)[3], np.linspace(-1.0, 1.0, model.nv)
    runs = []
    for ground in (Ground(height=-100.0), None):
        scene = compile_scene(model, "mipsd", ground, "implicit_euler", 1e-3)
        runs.append(simulate(scene, 0.3, initial_state(scene, q, qd), record=parts))
    for part in parts:
        assert runs[0][part].tobytes() == runs[1][part].tobytes()
    assert runs[0].end_time == 0.3
    assert np.abs(runs[0]["q"]).max() > 1e-2


def test_contact_forces_come_in_the_order_of_the_model():
    order = [2, 0, 3, 1]
    model = box()
    scene = box_on(Ground(), model=model)
    turned = type(model)("box", model.links, (), "floating", contacts=tuple(model.contacts[k] for k in order))
    leaning = thrown(scene, 0.0, tilt=0.02)
    runs = [
        simulate(box_on(Ground(), model=m), 0.05, leaning, record=CHANNELS, record_interval=1e-3)
        for m in (model, turned)
    ]
    forces = [run["contact_force"][10] for run in runs]
    np.testing.assert_allclose(forces[1], forces[0][order], rtol=1e-9)
