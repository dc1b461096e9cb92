"""The humanoid's walk in Bullet: against this package where both are exact, and a rotor's step."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from featherstone_gait import Ground, Reference, compile_scene, initial_state, load_robot, simulate, standing_state
from featherstone_gait.benchmark import in_bullet as study
from featherstone_gait.benchmark.in_bullet import Machine
from featherstone_gait.core.effects.energies import METER
from featherstone_gait.core.effects.push import EVENT_MARGIN
from featherstone_gait.crosscheck import read_motion
from featherstone_gait.crosscheck.in_mujoco import evaluated

pybullet = pytest.importorskip("pybullet")


@pytest.fixture(scope="module")
def scene():
    return compile_scene(load_robot("humanoid", locked="simplified"), "mipsd", Ground(), "midpoint", 1e-3)


@pytest.fixture(scope="module")
def motion(scene):
    return read_motion(Path(scene.model.source).parent / "optimized_gait.npz", scene.model.joint_names)


def test_a_rotor_s_step_is_exact():
    """Against a solver of high order, of the end and of the mean, from any state."""
    gearbox, h = load_robot("humanoid", locked="simplified").servos["left_knee"].gearbox, 2.5e-4
    gearbox = replace(gearbox, rotor_damping=1e-6)  # which the humanoid's has not
    inertia, damping = gearbox.ratio**2 * gearbox.rotor_inertia, gearbox.ratio**2 * gearbox.rotor_damping
    twist, speed, torque, joint = 0.02, -1.5, 0.7, 2.0

    def rates(_, x):
        gear = gearbox.stiffness * x[0] + gearbox.damping * (x[1] - joint)
        return [x[1] - joint, (torque - damping * x[1] - gear) / inertia, x[0], x[1]]

    exact = solve_ivp(rates, (0.0, h), [twist, speed, 0.0, 0.0], method="DOP853", rtol=1e-13, atol=1e-16).y[:, -1]
    end, mean = study.rotor_step(gearbox, h) @ [twist, speed, torque, joint]
    assert end == pytest.approx(exact[:2], rel=1e-9)
    assert mean == pytest.approx(exact[2:] / h, rel=1e-9)


@pytest.mark.long
def test_in_free_flight_it_moves_as_in_this_package(scene):
    """To first order in Bullet's step: joints, the base and the energy drawn."""
    model, rng = scene.model, np.random.default_rng(1)
    limits = {joint.name: (joint.lower, joint.upper) for joint in model.joints}
    low, high = np.array([limits[name] for name in model.joint_names]).T
    middle = np.clip(0.0, low + 0.25, high - 0.25)
    reach = np.minimum(np.minimum(middle - low, high - middle) - 0.1, 0.5)  # the replay has no stops
    wander = np.cumsum(0.15 * rng.normal(size=(9, len(low))), axis=0)
    reference = Reference(0.04 * np.arange(9), middle + reach * np.tanh(wander))
    free, ticks = compile_scene(model, "mipsd"), 30
    q = np.array([0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, *reference.values[0]])
    record = ("q", "base_q", "energy")
    exact = simulate(free, 0.3, initial_state(free, q), reference, record=record, rtol=1e-9)
    assert len(exact["q"]) == ticks + 1
    drive, rate = evaluated(reference, 0.01 * np.arange(ticks) - free.lag + EVENT_MARGIN)
    off = []
    for timestep in (5e-4, 2.5e-4):
        machine = Machine(free, False, timestep)
        machine.place(q)
        seen = []
        for k in range(ticks):
            machine.tick(drive[k], rate[k])
            seen.append([*machine.base()[:3], *machine.q])
        drawn = machine.chain.meter.sum() - exact["energy"][-1, :, METER].sum()
        apart = np.abs(np.array(seen) - np.hstack([exact["base_q"][1:, :3], exact["q"][1:]]))
        off.append([apart[:, 3:].max(), apart[:, :3].max(), abs(drawn)])
    coarse, fine = np.array(off)
    assert (coarse < [1.5e-3, 1e-3, 0.02]).all()  # of joints that turn by 0.3 rad, and of 0.96 J
    assert fine / coarse == pytest.approx(0.5, abs=0.1)


@pytest.mark.long
def test_it_stands_on_the_floor(scene, motion):
    """It bears its weight, and its knees carry what they do here but for what the soles creep."""
    angles = motion.reference(1).values[0]
    held = Reference([0.0, 1.0], np.stack([angles, angles]), "linear")
    here = simulate(scene, 2.0, standing_state(scene, angles, allow_limit_violation=True), held, record=("torque",))
    machine = study.stand(scene, angles, 2.0)
    assert machine.stands()
    assert machine.contacts()[:, 1].sum() == pytest.approx(9.81 * scene.model.mass, rel=1e-4)
    assert machine.contacts()[:, 0].mean() == pytest.approx(3.1e-4, rel=0.02)
    knees = [scene.model.joint_names.index(f"{side}_knee") for side in ("left", "right")]
    assert machine.torque[knees] == pytest.approx(here["torque"][-1, knees], abs=0.012)  # of 0.3 N m


@pytest.mark.long
def test_the_humanoid_s_gait_walks(scene, motion):
    assert 30.0 < study.walk(scene, motion, strides=3) < 50.0
