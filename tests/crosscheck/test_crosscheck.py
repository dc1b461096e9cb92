"""Gaits in MuJoCo: the replay against this package where both are exact, floors, files, and what others can play."""

import csv
import json
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import mujoco
import numpy as np
import pytest

from featherstone_gait import (
    Ground,
    Reference,
    cli,
    compile_scene,
    initial_state,
    load_robot,
    save_robot,
    simulate,
    standing_state,
)
from featherstone_gait.core.effects.energies import METER
from featherstone_gait.crosscheck import (  # fmt: skip
    FLOORS,
    Floor,
    Motion,
    crosscheck,
    motion_of,
    read_motion,
    replay,
    sinking,
    standing,
    walk_on,
)
from featherstone_gait.crosscheck.in_mujoco import soles_of
from featherstone_gait.crosscheck.servo_chain import ServoChain
from featherstone_gait.model import ContactPoint, Controller, Gearbox, Joint, Link, Model, Servo, Supply
from featherstone_gait.optimize import walking_cost
from featherstone_gait.walking import Pattern, WalkingCost, fit_gait, with_generic_servos
from featherstone_gait.walking.four_legs import four_legged_stride, mirror_by_place
from featherstone_gait.walking.gait_file import ARRAYS, angles_of_goal_positions, write_angles

FIRM = Floor(2e-3, 0.9, impratio=100.0)  # whose friction hardly creeps


@pytest.fixture(scope="module")
def cost():
    return walking_cost(load_robot("humanoid", locked="simplified"))


@pytest.fixture(scope="module")
def motion(cost):
    return motion_of(cost.gait, cost.start)


@pytest.fixture
def gait_file(cost, tmp_path):
    path, gait = tmp_path / "humanoid_gait.npz", cost.gait
    np.savez_compressed(
        path, format=str(ARRAYS), x=gait.to_vector(), first_poses=0.9 * gait.poses, poses=gait.poses, start=cost.start,
        period=gait.period, joint_names=gait.joint_names,
    )  # fmt: skip
    return path


# ---------------------------------------------------------------------------------------------- the replay


@pytest.mark.quick("rotor")
@pytest.mark.parametrize("servos", ["mipsd", "rotor", "standard"])
def test_an_arm_without_contact_moves_as_in_this_package(servos):
    """The same to first order in MuJoCo's step: positions, what drives them, and the energy drawn."""
    model = load_robot("arm7_spatial")
    (servo, *_), n = model.servos.values(), len(model.joint_names)
    servo = replace(servo, gearbox=replace(servo.gearbox, rotor_damping=3e-7))
    model, rng = replace(model, servos=dict.fromkeys(model.joint_names, servo)), np.random.default_rng(0)
    reference = Reference(0.04 * np.arange(13), np.cumsum(0.05 * rng.normal(size=(13, n)), axis=0))
    scene = compile_scene(model, servos, integrator="ars343")
    record = ("q", "current", "energy")
    exact = simulate(scene, 0.5, initial_state(scene, np.zeros(n)), reference, record=record, rtol=1e-9)
    assert exact.error["q"].max() < 1e-8
    runs = [replay(scene, 0.5, np.zeros(n), reference, timestep=h) for h in (1e-4, 5e-5)]
    for name, bound in (("q", 5e-4), ("current", 2.5e-3)):
        errors = [np.abs(run[name] - exact[name]).max() for run in runs]
        assert errors[0] < bound
        assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.1)
    spent = [float(run["energy"][-1, :, METER].sum()) for run in (*runs, exact)]
    assert spent[:2] == pytest.approx(2 * spent[2:], rel=3e-3)


def servo(**given):
    law = {name: given.pop(name) for name in ("law", "Kp", "Ki", "Kd", "Kf") if name in given}
    controller = Controller(**({"law": "state", "Kp": 20.0} | law))
    fields = {"resistance": 8.0, "inductance": 5e-3, "motor_constant": 0.00681, "voltage_limit": 10.0}
    return Servo(controller, Gearbox(254.0, rotor_inertia=1e-7), **(fields | given))


@pytest.mark.parametrize("h", [1e-5, 1e-3, 0.1])
def test_the_current_of_a_turning_motor_is_exact_at_any_step(h):
    chain = ServoChain([servo()], h)
    chain.voltage[:] = 7.0
    w, K, tau = 2.0, 254.0 * 0.00681, 5e-3 / 8.0
    torque = chain.step(np.array([w]))
    steady, share = (7.0 - K * w) / 8.0, h / tau
    assert chain.current[0] == pytest.approx(-steady * np.expm1(-share), rel=1e-12)
    mean = steady * (1.0 + np.expm1(-share) / share)
    assert torque[0] == pytest.approx(K * mean, rel=1e-9)
    assert chain.meter[0] == pytest.approx(h * 7.0 * mean, rel=1e-9)


def test_limits_of_the_current_and_of_its_rate_hold():
    chain = ServoChain([servo(current_limit=0.5, current_slew=150.0), None], 1e-3)
    chain.voltage[:] = 10.0, 0.0
    currents = [(chain.step(np.zeros(2)), chain.current.copy())[1] for _ in range(5)]
    assert np.array(currents) == pytest.approx(np.array([[0.15, 0.3, 0.45, 0.5, 0.5], np.zeros(5)]).T)


@pytest.mark.long
@pytest.mark.parametrize(
    ("law", "Kp", "Kd"), [("state", 20.0, 0.5), ("pid_position", 20.0, 0.5), ("pid_speed", 3.0, 0.01)]
)
def test_the_controllers_are_those_of_the_package(law, Kp, Kd):
    """An arm whose controller has all its terms, an encoder and a filter."""
    gains = {"law": law, "Kp": Kp, "Ki": 30.0, "Kd": Kd, "Kf": 0.2}
    own = servo(**gains, encoder_resolution=0.004, speed_filter=0.02, viscous_friction=0.05)
    model = load_robot("ax12_whole_arm")
    model = replace(model, servos=dict.fromkeys(model.joint_names, own))
    reference = Reference([0.0, 0.15, 0.3], [[0.0], [0.5], [0.2]])
    scene = compile_scene(model, "rotor", None, "midpoint", 1e-4)
    ours = simulate(scene, 0.3, initial_state(scene, [0.0]), reference, record=("q", "voltage"), estimate_error=False)
    theirs = replay(scene, 0.3, np.zeros(1), reference, timestep=1e-4)
    assert np.abs(ours["q"]).max() > 0.1
    assert theirs["q"] == pytest.approx(ours["q"], abs=5e-4)


def test_a_replay_that_diverges_says_so_and_leaves_no_file(tmp_path, monkeypatch):
    """A whole tick is too long a step for the spring of a gearbox."""
    monkeypatch.chdir(tmp_path)
    scene = compile_scene(load_robot("arm7_spatial"), "mipsd")
    run = replay(scene, 1.0, np.zeros(7), Reference([0.0], [np.full(7, 0.5)]), timestep=1e-2)
    assert run.status == "diverged"
    assert run.message == f"arm7_spatial diverged at {run.end_time:.4g} s"
    assert run.end_time < 1.0
    assert list(tmp_path.iterdir()) == []


FIRMWARE = {
    "dead band and punch": {"compliance_margin": 0.005, "punch": 0.3},
    "counts": {"pwm_steps": 1023.0, "duty_limit": 0.5},
    "profile": {"profile_speed": 0.5},
    "delay of less than a tick": {"delay": 0.004},
    "delay of two ticks": {"delay": 0.02},
}
LOADS = {"external_load_friction": 0.2, "motor_load_friction": 0.2}
STRIBECK = {"stribeck_friction": 0.02, "stribeck_speed": 0.3, "stribeck_exponent": 1.2, "stribeck_external_load": 0.1}
QUADRATIC = {"quadratic_external_load": 0.2, "quadratic_motor_load": 0.1}
GEARS = {"backlash": {"backlash": 0.01}, "M3": LOADS, "M4": LOADS | STRIBECK | {"stribeck_motor_load": 0.1}}
GEARS["M6"] = GEARS["M4"] | QUADRATIC | {"motor_load_friction": 0.1}


def changed(model, firmware=None, gear=None, **servo):
    """An arm whose servos have these numbers besides."""
    servos = {
        name: replace(
            own,
            controller=replace(own.controller, **(firmware or {})),
            gearbox=replace(own.gearbox, **(gear or {})),
            **servo,
        )
        for name, own in model.servos.items()
    }
    return replace(model, servos=servos)


def errors_of_replay(model, servos, rtol):
    """Largest difference of a joint [rad] at steps of 0.2 ms, and how it falls with half the step."""
    rng, n = np.random.default_rng(0), len(model.joint_names)
    reference = Reference(0.04 * np.arange(13), np.cumsum(0.05 * rng.normal(size=(13, n)), axis=0))
    scene = compile_scene(model, servos)
    exact = simulate(scene, 0.5, initial_state(scene, np.zeros(n)), reference, record=("q",), rtol=rtol)
    assert exact.ok
    assert exact.error["q"].max() < 3e-6
    runs = [replay(scene, 0.5, np.zeros(n), reference, timestep=h) for h in (2e-4, 1e-4)]
    first, second = (np.abs(run["q"] - exact["q"]).max() for run in runs)
    return first, first / second


@pytest.mark.long
@pytest.mark.parametrize("firmware", FIRMWARE)
def test_firmware_is_that_of_the_package(firmware):
    """Counts jump, where a rounding error of the angle is a whole one: to the same order, less smoothly."""
    error, order = errors_of_replay(changed(load_robot("arm7_spatial"), FIRMWARE[firmware]), "mipsd", 1e-7)
    assert error < 1.5e-3
    assert order == pytest.approx(2.0, rel=0.1)


@pytest.mark.long
def test_a_source_gives_way_as_in_the_package():
    error, order = errors_of_replay(replace(load_robot("arm7_spatial"), supply=Supply(9.0, 0.5)), "mipsd", 1e-7)
    assert error < 5e-4
    assert order == pytest.approx(2.0, rel=0.1)


@pytest.mark.long
@pytest.mark.parametrize(
    ("gear", "servos"), [("backlash", "mipsd"), ("M3", "mipsd"), ("M3", "rotor"), ("M4", "mipsd"), ("M6", "rotor")]
)
def test_gear_trains_rub_and_rattle_as_in_the_package(gear, servos):
    """MuJoCo's joints stick by a constraint, and its budget is that of the last step's loads."""
    model = changed(load_robot("arm7_spatial"), gear=GEARS[gear], coulomb_friction=0.03, stick_speed=0.0)
    error, order = errors_of_replay(model, servos, 1e-6)
    assert error < 1e-3
    assert order == pytest.approx(2.0, rel=0.15)


def test_what_the_replay_lacks_is_refused(cost):
    model = load_robot("ax12_whole_arm")
    pd = Servo(Controller("pd", 10.0, torque_limit=1.0))
    continuous = compile_scene(replace(model, servos={model.joint_names[0]: pd}), "rotor")
    with pytest.raises(ValueError, match=r"lacks .*: the torque law 'pd'; leave it out"):
        replay(continuous, 0.1, np.zeros(1), Reference([0.0], [[0.0]]))
    late = replace(model.servos[model.joint_names[0]], controller=Controller("state", 61.0, delay=1e-3))
    late = compile_scene(replace(model, servos={model.joint_names[0]: late}), "mipsd")
    with pytest.raises(ValueError, match=r"does not divide the controllers' delay of 0\.001 s"):
        replay(late, 0.1, np.zeros(1), Reference([0.0], [[0.0]]), timestep=4e-4)
    with pytest.raises(ValueError, match="does not divide the controllers' period"):
        replay(cost.scene, 0.1, np.zeros(17), Reference([0.0], [np.zeros(10)]), timestep=3e-4)
    with pytest.raises(ValueError, match=r"time_constant is 0\.0001; .*two steps"):
        sinking(cost.scene, cost.start[0], Floor(1e-4, 0.9))


def test_without_mujoco_the_remedy_is_told(motion, monkeypatch, capsys, gait_file):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ImportError, match=r"pip install featherstone-gait\[mjcf\]"):
        crosscheck(motion)
    assert cli.main(["crosscheck", str(gait_file), "--out", str(gait_file.parent)]) == 2
    assert "pip install featherstone-gait[mjcf]" in capsys.readouterr().err


# ---------------------------------------------------------------------------------------------- on the floor


def test_a_standing_humanoid_takes_the_same_torques(cost):
    """Where friction hardly creeps, to 3 mN m of 0.3, the posture to 0.5 mrad."""
    angles = cost.start[0]
    depth = sinking(cost.scene, angles, FIRM)
    hold = Reference([0.0], angles[None])
    theirs = replay(cost.scene, 2.0, standing(cost.scene, angles, depth), hold, FIRM)
    scene = cost.scene.recompiled(ground=Ground(friction=0.9, penetration=depth), timestep=2.5e-4)
    state = standing_state(scene, angles, allow_limit_violation=True)
    ours = simulate(scene, 2.0, state, hold, record=("q", "torque", "base_q"), estimate_error=False)
    assert np.abs(ours["torque"][-1]).max() > 0.25
    assert theirs["torque"][-1] == pytest.approx(ours["torque"][-1], abs=3e-3)
    assert theirs["q"][-1] == pytest.approx(ours["q"][-1], abs=5e-4)
    assert theirs["base_q"][-1, 2] == pytest.approx(ours["base_q"][-1, 2], abs=1.5e-4)


def test_softer_floors_let_the_robot_sink_deeper_and_soles_do_not_matter(cost):
    """With the square of the time constant T, less what MuJoCo's impedance grows by with the depth."""
    depths = {
        (time, soles): sinking(cost.scene, cost.start[0], Floor(time, 0.9, soles))
        for time in (5e-3, 2e-2)
        for soles in ("spheres", "boxes")
    }
    for time in (5e-3, 2e-2):
        assert depths[time, "boxes"] == pytest.approx(depths[time, "spheres"], rel=1e-3)
    assert 6.0 < depths[2e-2, "spheres"] / depths[5e-3, "spheres"] < 16.0


def test_a_stride_on_the_softest_floor_goes_as_here(cost, motion):
    floor, end = Floor(2e-2, 0.9), motion.begin(1)
    angles, reference = motion.start[0], motion.reference(2)
    depth = sinking(cost.scene, angles, floor)
    theirs = replay(cost.scene, end, standing(cost.scene, angles, depth), reference, floor)
    scene = cost.scene.recompiled(ground=Ground(friction=0.9, penetration=depth), timestep=5e-4)
    state = standing_state(scene, angles, allow_limit_violation=True)
    ours = simulate(
        scene, end, state, reference, record=("base_q", "energy"), record_interval=0.01, estimate_error=False
    )
    assert ours["base_q"][-1, 0] > 0.05
    assert np.abs(theirs["base_q"][:, :3] - ours["base_q"][:, :3]).max() < 0.012
    spent = [float(run["energy"][-1, :, METER].sum()) for run in (theirs, ours)]
    assert spent[0] == pytest.approx(spent[1], rel=0.03)


def test_the_ground_beside_it_sinks_alike_and_has_the_same_friction(cost, motion):
    floor, h = Floor(5e-3, 0.7, "boxes"), 1e-3
    outcome = walk_on(cost.scene, motion, floor, strides=1, timestep=h)
    scene = cost.scene.recompiled(ground=Ground(friction=0.7, penetration=outcome.sinking), timestep=h)
    here = replace(cost, scene=scene, strides=1).measure([cost.gait.to_vector()])[0]
    assert outcome.own.measures.cost == here.cost
    assert outcome.mujoco.measures.cost == pytest.approx(here.cost, rel=0.1)
    assert outcome.mujoco.measures.speed == pytest.approx(here.speed, rel=0.1)


def test_who_leans_too_far_falls_in_mujoco(cost, motion):
    """The start with both hips swung out: no gait walks so."""
    away = replace(motion, start=motion.start + np.linspace(0.0, 1.0, len(motion.start))[:, None])
    outcome = walk_on(cost.scene, away, Floor(1e-2, 0.9), strides=1, timestep=5e-4)
    assert not outcome.mujoco.walks
    assert "fell at" in outcome.mujoco.measures.status
    assert 0.2 < outcome.mujoco.end < away.begin(3)


# ---------------------------------------------------------------------------------------------- other robots


def test_boxes_stand_where_round_contact_points_do(cost):
    """Soles whose corners are spheres of 5 mm: a box with its underside 5 mm below their centers does not drop."""
    points = [
        replace(point, position=(*point.position[:2], point.position[2] + 5e-3), radius=5e-3)
        for point in cost.scene.model.contacts
    ]
    scene = cost.scene.recompiled(replace(cost.scene.model, contacts=tuple(points)))
    depths = [sinking(scene, cost.start[0], Floor(1e-2, 0.9, soles)) for soles in ("spheres", "boxes")]
    assert depths[1] == pytest.approx(depths[0], rel=1e-3)
    hold = Reference([0.0], cost.start[:1])
    runs = [
        replay(scene, 0.4, standing(scene, cost.start[0], depth), hold, Floor(1e-2, 0.9, soles))
        for soles, depth in zip(("spheres", "boxes"), depths)
    ]
    heights = [run["base_q"][:, 2] for run in runs]
    assert heights[1] == pytest.approx(heights[0], abs=1e-4)


def test_a_sole_of_two_frictions_is_no_box(cost):
    model = cost.scene.model
    first, *others = model.contacts
    assert soles_of(model) == ("spheres", "boxes")
    assert soles_of(replace(model, contacts=[replace(first, friction=0.2), *others])) == ("spheres",)


@pytest.fixture(scope="module")
def trotting():
    """A table of 2 kg on four legs with point feet, its servos scaled from an AX-12: cost of its first trot."""
    links, joints, feet = [Link("trunk", 2.0, (0, 0, 0), (5e-3, 0, 0, 2e-2, 0, 2e-2))], [], []
    for leg, x, y in (("lf", 0.15, 0.1), ("rf", 0.15, -0.1), ("lh", -0.15, 0.1), ("rh", -0.15, -0.1)):
        places, axes = ((x, y, 0), (0, 0, 0), (0, 0, -0.12)), ((1, 0, 0), (0, 1, 0), (0, 1, 0))
        for k, (place, axis) in enumerate(zip(places, axes)):
            links.append(Link(f"{leg}{k}", 0.1, (0, 0, -0.06 if k else 0), (1e-4, 0, 0, 1e-4, 0, 1e-5)))
            turns = {"xyz": place, "axis": axis, "lower": -2.0, "upper": 2.0}
            joints.append(Joint(f"{leg}_{k}", "revolute", f"{leg}{k - 1}" if k else "trunk", f"{leg}{k}", **turns))
        feet.append(ContactPoint(f"{leg}2", (0, 0, -0.12)))
    robot = with_generic_servos(Model("table", links, joints, base="floating", contacts=feet), leg=0.24)
    posture = np.array([0.0, 0.6, -1.2, 0.0, 0.6, -1.2, 0.0, -0.6, 1.2, 0.0, -0.6, 1.2])
    stride = four_legged_stride(robot, posture, Pattern(period=0.32, step=0.05, lift=0.02))
    gait = fit_gait(stride, 8, mirror=mirror_by_place(robot, posture)).gait
    return WalkingCost(compile_scene(robot, "mipsd", Ground(), "midpoint", 1e-3), gait, posture, blend_strides=2)


def test_a_robot_on_four_point_feet_trots_in_mujoco_as_here(trotting, tmp_path):
    """Given as a model; its feet can be no boxes; files of rows are of it alone."""
    motion = motion_of(trotting.gait, trotting.start, trotting.blend_strides)
    how = {"floors": ["20ms_0.9"], "strides": 4, "timestep": 5e-4, "out": tmp_path / "trot"}
    model = trotting.scene.model
    report = crosscheck(motion, model, **how)
    (row,) = report["floors"]
    assert row["soles"] == "spheres"
    assert row["mujoco"]["walks"]
    assert row["own"]["walks"]
    assert row["mujoco"]["cost"] == pytest.approx(row["own"]["cost"], rel=0.15)
    assert row["mujoco"]["speed"] == pytest.approx(row["own"]["speed"], rel=0.15)
    with pytest.raises(ValueError, match=r"link 'lf2': its 1 contact points .* soles of spheres"):
        crosscheck(motion, model, **how | {"soles": ["boxes"]})
    heavier = replace(model, links=(replace(model.links[0], mass=2.1), *model.links[1:]))
    other = crosscheck(motion, heavier, **how)
    assert other["settings"]["robot"] != report["settings"]["robot"]
    assert other["floors"][0]["own"]["cost"] != row["own"]["cost"]


@pytest.mark.long
def test_a_robot_of_a_file_is_named_with_its_gait(trotting, tmp_path, capsys):
    """`save_robot` and `write_angles` are all that the command needs; of the complete humanoid nothing is held."""
    out = tmp_path / "out"
    save_robot(trotting.scene.model, tmp_path / "table.urdf")
    reference = motion_of(trotting.gait, trotting.start, trotting.blend_strides).reference(2)
    write_angles(tmp_path / "trot.csv", reference.times, reference.values, trotting.gait.joint_names)
    whole = walking_cost(load_robot("humanoid"), states="step")
    steps = motion_of(whole.gait, whole.start).reference(2)
    write_angles(tmp_path / "steps.csv", steps.times, steps.values, whole.gait.joint_names)
    options = ["--floors", "20ms_0.9", "--soles", "spheres", "--strides", "2", "--timestep", "5e-4", "--out", str(out)]
    for gait, robot in (("trot", ["--robot", str(tmp_path / "table.urdf")]), ("steps", ["--locked", "none"])):
        assert cli.main(["crosscheck", str(tmp_path / f"{gait}.csv"), *robot, *options]) == 0
        assert "in MuJoCo it walks 2 strides on 1 of 1 floors" in capsys.readouterr().out
    assert cli.main(["crosscheck", str(tmp_path / "steps.csv"), *options]) == 2  # ten joints
    assert "left_hip_rotation" in capsys.readouterr().err  # the first of those that this robot has locked


# ---------------------------------------------------------------------------------------------- gait files


def test_a_gait_is_the_same_from_arrays_and_from_angles(cost, motion, gait_file, tmp_path):
    names = cost.gait.joint_names
    of_arrays = read_motion(gait_file, names)
    assert of_arrays.digest() == motion.digest()
    reference, path = motion.reference(5), tmp_path / "angles.csv"
    assert np.array_equal(reference.values, cost.reference(cost.gait.to_vector(), 5).values)
    write_angles(path, reference.times, reference.values, names)
    of_angles = read_motion(path, names)
    assert of_angles.start == pytest.approx(motion.start, abs=1e-14)
    assert of_angles.stride == pytest.approx(motion.stride, abs=1e-14)
    assert (of_angles.tick, of_angles.period) == (motion.tick, pytest.approx(cost.gait.period))
    assert read_motion(gait_file, names[::-1]).stride == pytest.approx(motion.stride[:, ::-1])
    assert read_motion(gait_file, names, first=True).poses == pytest.approx(0.9 * motion.poses)


def test_files_that_are_no_gait_are_refused(motion, gait_file, tmp_path):
    path = tmp_path / "angles.csv"
    reference = motion.reference(1)
    write_angles(path, reference.times, reference.values, motion.joint_names)
    with pytest.raises(ValueError, match=r"angles\.csv: its last rows do not repeat"):
        read_motion(path)
    with pytest.raises(ValueError, match=r"only a gait's \.npz"):
        read_motion(path, first=True)
    with pytest.raises(ValueError, match=r"joints are not those of joint_names: .*knee"):
        read_motion(gait_file, ["elbow"])
    with pytest.raises(ValueError, match=r"humanoid\.txt: give a gait's \.npz"):
        read_motion(tmp_path / "humanoid.txt")
    np.savez(tmp_path / "other.npz", poses=np.zeros(3))
    with pytest.raises(ValueError, match=r"other\.npz: lacks joint_names, period, start"):
        read_motion(tmp_path / "other.npz")


# ---------------------------------------------------------------------------------------------- the commands


def test_a_crosscheck_goes_on_from_finished_floors(motion, tmp_path):
    out = tmp_path / "gait"
    how = {"soles": ["spheres"], "strides": 1, "timestep": 1e-3, "out": out}
    first = crosscheck(motion, floors=["10ms_0.9"], **how)
    file = tmp_path / "gait.json"
    content = json.loads(file.read_text("utf-8"))
    assert content["format"].startswith("featherstone_gait crosscheck 1")
    content["floors"][0]["sinking"] = 42.0
    file.write_text(json.dumps(content), "utf-8")
    both = crosscheck(motion, floors=["20ms_0.9", "10ms_0.9"], **how)
    assert [row["floor"] for row in both["floors"]] == ["10ms_0.9", "20ms_0.9"]
    assert both["floors"][0] == first["floors"][0] | {"sinking": 42.0}
    lines = (tmp_path / "gait.csv").read_text("utf-8").splitlines()
    rows = list(csv.DictReader(lines[1:]))
    assert lines[0].startswith("# featherstone_gait crosscheck table 1")
    assert [float(row["mujoco_cost_J_per_m"]) for row in rows] == [row["mujoco"]["cost"] for row in both["floors"]]
    anew = crosscheck(motion, floors=["10ms_0.9"], **(how | {"timestep": 5e-4}))
    assert anew["floors"][0]["sinking"] < 1e-3


@pytest.mark.quick("one")
@pytest.mark.parametrize("floors", [["10ms_0.9"], ["10ms_0.9", "20ms_0.9"]], ids=["one", "two in processes"])
def test_the_command_prints_a_table(gait_file, tmp_path, capsys, floors):
    options = ["--floors", ",".join(floors), "--soles", "spheres", "--strides", "1", "--timestep", "1e-3"]
    assert cli.main(["crosscheck", str(gait_file), "--out", str(tmp_path), *options]) == 0
    shown = capsys.readouterr()
    assert all(line.startswith("compiling ") for line in shown.err.splitlines()), shown.err  # bars are for terminals
    assert f"in MuJoCo it walks 1 strides on {len(floors)} of {len(floors)} floors" in shown.out
    table = json.loads((tmp_path / "humanoid_gait_crosscheck.json").read_text("utf-8"))
    assert [row["floor"] for row in table["floors"]] == floors
    assert all(50.0 < row["mujoco"]["cost"] < 90.0 for row in table["floors"])
    assert cli.main(["crosscheck", str(gait_file), "--out", str(tmp_path), "--floors", "ice"]) == 2
    assert "'2ms_0.6', " in capsys.readouterr().err
    assert len(FLOORS) == 12


def test_an_exported_gait_can_be_played_by_others(gait_file, motion, tmp_path):
    """The counts say the angles to half a count, and in MuJoCo the feet stand on the floor in every pose."""
    out = tmp_path / "out"
    assert cli.main(["export", str(gait_file), "--out", str(out), "--strides", "3"]) == 0
    assert sorted(path.name for path in out.iterdir()) == [
        "humanoid_gait.xml", "humanoid_gait_angles.csv", "humanoid_gait_goal_positions.csv",
    ]  # fmt: skip
    assert read_motion(out / "humanoid_gait_angles.csv").stride == pytest.approx(motion.stride, abs=1e-14)
    counts = np.loadtxt(out / "humanoid_gait_goal_positions.csv", delimiter=",", skiprows=2)[:, 1:]
    off = np.degrees(np.abs(angles_of_goal_positions(counts) - motion.reference(3).values))
    assert 0.1 < off.max() <= 0.5 * 300.0 / 1023.0 + 1e-9
    m = mujoco.MjModel.from_xml_path(str(out / "humanoid_gait.xml"))
    d = mujoco.MjData(m)
    assert [m.key(k).name for k in range(m.nkey)] == ["start", "pose0", "pose1", "pose2", "pose3"]
    for k, pose in enumerate([motion.start[0], *motion.poses]):
        mujoco.mj_resetDataKeyframe(m, d, k)
        mujoco.mj_forward(m, d)
        assert [d.joint(name).qpos[0] for name in motion.joint_names] == pytest.approx(pose.tolist())
        assert -1e-3 < d.contact.dist.min() < 0.0


def test_an_export_names_its_files_and_spares_the_gait(gait_file, tmp_path, capsys):
    assert cli.main(["export", str(gait_file), "--out", str(tmp_path), "--mjcf"]) == 0
    assert sorted(Path(tmp_path).iterdir()) == [tmp_path / "humanoid_gait.npz", tmp_path / "humanoid_gait.xml"]
    assert cli.main(["export", str(gait_file), "--out", str(tmp_path), "--csv"]) == 0
    angles = tmp_path / "humanoid_gait_angles.csv"
    assert cli.main(["export", str(angles), "--out", str(tmp_path), "--csv"]) == 2
    assert "is the gait itself" in capsys.readouterr().err


def test_a_motion_repeats_its_stride(motion):
    reference = motion.reference(3)
    at = [np.searchsorted(reference.times, motion.begin(k) - 1e-9) for k in range(4)]
    for a, b in pairwise(at):
        assert np.array_equal(reference.values[a], reference.values[b])
    assert isinstance(motion, Motion)
    with pytest.raises(ValueError, match="strides is 0"):
        motion.reference(0)
