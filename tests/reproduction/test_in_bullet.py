"""Gaits in Bullet: the replay against this package where both are exact, a rotor's step, rows that are kept, a walk."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from featherstone_gait import Reference, compile_scene, initial_state, load_robot, simulate, standing_state
from featherstone_gait.base.files import read_csv
from featherstone_gait.core.effects.energies import METER
from featherstone_gait.core.effects.push import EVENT_MARGIN
from featherstone_gait.crosscheck import read_motion
from featherstone_gait.crosscheck.in_mujoco import evaluated
from featherstone_gait.reproduction import in_bullet as study
from featherstone_gait.reproduction.in_bullet import FLOORS, Machine, Walked

pybullet = pytest.importorskip("pybullet")


@pytest.fixture(scope="module")
def scene():
    return study.humanoid()


@pytest.fixture(scope="module")
def motion(scene):
    file, first = study.GAITS["seed 0"]
    return read_motion(Path(__file__).parents[2] / file, scene.model.joint_names, first=first)


# ---------------------------------------------------------------------------------------------- the replay


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
        machine = Machine(free, None, timestep)
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
@pytest.mark.parametrize(("name", "depth"), [("hard", 1e-5), ("soft", 3.1e-4)])
def test_it_stands_on_either_floor(scene, motion, name, depth):
    """It bears its weight, and its knees carry what they do here but for what the soles creep."""
    angles = motion.reference(1).values[0]
    held = Reference([0.0, 1.0], np.stack([angles, angles]), "linear")
    here = simulate(scene, 2.0, standing_state(scene, angles, allow_limit_violation=True), held, record=("torque",))
    machine = study.stand(scene, angles, FLOORS[name], 2.0)
    assert machine.stands()
    assert machine.contacts()[:, 1].sum() == pytest.approx(9.81 * scene.model.mass, rel=1e-4)
    assert machine.contacts()[:, 0].mean() == pytest.approx(depth, rel=0.02)
    knees = [scene.model.joint_names.index(f"{side}_knee") for side in ("left", "right")]
    assert machine.torque[knees] == pytest.approx(here["torque"][-1, knees], abs=0.012)  # of 0.3 N m


@pytest.mark.long
def test_the_humanoid_s_gait_walks(scene, motion):
    walked = study.walk(scene, motion, FLOORS["hard"], strides=3)
    assert walked.walks
    assert walked.end == pytest.approx(motion.begin(study.WARM_UP + 3))
    assert 0.12 < walked.speed < 0.16
    assert 30.0 < walked.cost < 50.0


def test_a_robot_that_the_replay_lacks_is_refused(scene):
    names, knee = scene.model.servos, scene.model.servos["left_knee"]
    loose = replace(knee, gearbox=replace(knee.gearbox, backlash=0.01))
    late = replace(knee, controller=replace(knee.controller, delay=0.005))
    for servo, what in ((loose, "backlash"), (late, "delays"), (replace(knee, coulomb_friction=0.1), "dry friction")):
        model = replace(scene.model, servos=dict.fromkeys(names, servo))
        with pytest.raises(ValueError, match=f"lacks {what}"):
            Machine(compile_scene(model, "mipsd"), None)
    parts = {
        "springs of joints": {"joints": [replace(j, stiffness=1.0) for j in scene.model.joints]},
        "gravity compensation": {"links": [replace(link, gravity_compensation=0.5) for link in scene.model.links]},
        "contact points": {"contacts": [replace(point, friction=0.2) for point in scene.model.contacts]},
    }
    for what, changed in parts.items():
        with pytest.raises(ValueError, match=f"lacks {what}"):
            Machine(compile_scene(replace(scene.model, **changed), "mipsd"), None)


# ---------------------------------------------------------------------------------------------- the table


@pytest.fixture
def walks(monkeypatch):
    """One gait on two floors, and what was walked."""
    walked = []

    def walk(scene, motion, floor):
        walked.append((floor.stiffness is None, floor.friction))
        if floor.stiffness is None:
            return Walked(False, 2.99, sinking=1e-5)
        return Walked(True, 15.56, 1.0 / 3.0, 0.1, -0.02, 3e-4)

    monkeypatch.setattr(study, "walk", walk)
    monkeypatch.setattr(study, "GAITS", {"seed 0": study.GAITS["seed 0"]})
    monkeypatch.setattr(study, "FRICTIONS", (0.6,))
    return walked


def test_rows_that_are_kept_are_not_walked_again_and_others_are(walks, tmp_path, monkeypatch):
    path = tmp_path / "table.csv"
    study.main([str(path)])
    assert walks == [(True, 0.6), (False, 0.6)]
    whole = path.read_text("utf-8")
    (_, names), *rows = read_csv(path, study.TABLE)
    assert names == study.COLUMNS
    assert [cells for _, cells in rows] == [
        ["seed 0", "hard", "0.6", "False", "2.99", "", "", "", "1e-05"],
        ["seed 0", "soft", "0.6", "True", "15.56", repr(1.0 / 3.0), "0.1", "-0.02", "0.0003"],
    ]
    study.main([str(path)])
    assert len(walks) == 2
    path.write_text("\n".join(whole.splitlines()[:-1]), "utf-8")  # as after an interrupt
    study.main([str(path)])
    assert walks[2:] == [(False, 0.6)]
    assert path.read_text("utf-8") == whole
    monkeypatch.setattr(study, "digest", lambda file: "of other sources")
    study.main([str(path)])
    assert len(walks) == 5
    assert "# sources of other sources" in path.read_text("utf-8").splitlines()


def test_a_file_of_another_kind_is_left_alone(walks, tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("# featherstone_gait worlds table 2, written by version 0.2.0\na,b\n", "utf-8")
    with pytest.raises(ValueError, match="its format is"):
        study.main([str(path)])
    assert path.read_text("utf-8").endswith("a,b\n")
    assert walks == []


def test_without_bullet_it_says_what_to_install(walks, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pybullet", None)
    with pytest.raises(ImportError, match="pip install pybullet"):
        study.main([str(tmp_path / "table.csv")])
