"""A policy in MuJoCo beside the same policy here: two engines, two servos written apart, one loop around both."""

from dataclasses import replace

import numpy as np
import pytest

from featherstone_gait import Controller, Ground, Servo, cli, compile_scene, load_robot, save_robot
from featherstone_gait.benchmark.little_biped import NETWORK, little_biped
from featherstone_gait.crosscheck import Floor, crosscheck_policy
from featherstone_gait.judge import Policy, load_policy
from featherstone_gait.judge.run import scene_of
from featherstone_gait.model import Gearbox
from featherstone_gait.robot_file.source import robots_folder

pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")

HOW = {"description": NETWORK.with_suffix(".toml")}
GAIT = robots_folder() / "humanoid" / "optimized_gait.npz"
WIDE = {"kind": "uniform", "scale": 0.1}
UNITS = {
    "ground": {"friction": {"kind": "uniform", "scale": 0.3}, "penetration": {"kind": "lognormal", "scale": 0.5}},
    "servos": {"Kp": WIDE, "voltage_limit": WIDE, "coulomb_friction": {"kind": "uniform", "scale": 0.3}},
    "links": {"mass": {"kind": "lognormal", "scale": 0.05}},
    "reference": {"offset": {"kind": "uniform", "scale": 0.01}},
}
SLOPES = {
    "slope": {"kind": "uniform", "scale": 0.02, "additive": True},
    "heading": {"kind": "uniform", "scale": 3.14, "additive": True},
}


@pytest.mark.long
@pytest.mark.parametrize("time_constant", [5e-3, 1e-2])
def test_a_network_walks_as_fast_and_takes_as_much_in_mujoco_as_here(time_constant):
    """XL330 by BAM's model M6, MuJoCo at 0.2 ms, here at 1 ms: speeds differ by 2 %, energies by 3 %."""
    found = crosscheck_policy(NETWORK, little_biped(), 5.0, floor=Floor(time_constant, 0.95), **HOW)
    assert [*found.verdicts, *found.own.verdicts] == ["walks", "walks"]
    for name in ("speed", "energy_per_way", "power", "largest_tilt"):
        assert found.mujoco[name] == pytest.approx(found.own.worlds[name], rel=0.1)


@pytest.mark.long
def test_drawn_units_and_slopes_take_as_much_in_mujoco_as_here():
    units = UNITS | {"ground": UNITS["ground"] | SLOPES}
    found = crosscheck_policy(NETWORK, little_biped(), 3.0, worlds=8, doubts={"worlds": units}, **HOW)
    off = found.mujoco["power"] / found.own.worlds["power"] - 1.0
    assert np.median(np.abs(off)) < 0.03 < np.ptp(found.own.worlds["power"]) / found.own.worlds["power"].mean()
    assert "walks                            8           8" in found.table()


@pytest.mark.long
@pytest.mark.parametrize(("slope", "heading"), [(0.1, 0.0), (-0.1, 0.0), (0.1, 1.6)], ids=["up", "down", "across"])
def test_it_slides_down_a_slippery_slope_in_mujoco_as_here(slope, heading):
    """The plane is tilted about a point 0.1 m high; a block would slide 0.25 m, servos that give way add to that."""
    robot = little_biped()
    network = load_policy(NETWORK, robot, **HOW)
    still = Policy(lambda seen: np.zeros((len(seen), 14)), network.description, "still")
    ground = Ground(friction=0.05, penetration=1e-4, slope=slope, heading=heading, height=0.1)
    found = crosscheck_policy(still, scene_of(robot).recompiled(ground=ground), 1.0)
    theirs, ours = (worlds["way"][0] + 1j * worlds["aside"][0] for worlds in (found.mujoco, found.own.worlds))
    assert abs(theirs - ours) < 0.01 < 0.25 < abs(ours)  # [m]
    assert found.mujoco["largest_tilt"] == pytest.approx(found.own.worlds["largest_tilt"], rel=0.01)


@pytest.mark.long
def test_position_actuators_of_mjcf_walk_alike_too():
    """A torque law within its limit is an actuator of MuJoCo, and has no motor: energy is mechanical work, to 1.4 %."""
    robot = little_biped()
    law = Servo(Controller("pd_clamped", 4.0, Kd=0.1, torque_limit=0.4), Gearbox(1.0, rotor_inertia=1e-3))
    scene = scene_of(replace(robot, servos=dict.fromkeys(robot.servos, law)), timestep=2.5e-4)
    found = crosscheck_policy(NETWORK, scene, 3.0, **HOW)
    assert [*found.verdicts, *found.own.verdicts] == ["walks", "walks"]
    for name in ("speed", "energy_per_way"):
        assert found.mujoco[name] == pytest.approx(found.own.worlds[name], rel=0.05)


@pytest.mark.long
def test_pushes_and_drawn_units_cost_the_same_in_mujoco():
    scene = compile_scene(load_robot("humanoid", locked="simplified"), "mipsd", Ground(), "midpoint", 1e-3)
    doubts = {"worlds": UNITS, "link": {"delay": 0.02, "lost": 0.02}, "pushes": {"speed": 0.1, "every": 0.2}}
    found = crosscheck_policy(GAIT, scene, 0.5, worlds=8, doubts=doubts, timestep=5e-4)
    assert found.mujoco["time"] == pytest.approx(found.own.worlds["time"])
    assert found.mujoco["power"] == pytest.approx(found.own.worlds["power"], rel=0.1)  # twice as much by the pushes
    assert np.corrcoef(found.mujoco["way"], found.own.worlds["way"])[0, 1] > 0.9  # by pushes from ahead and behind


def test_what_mujoco_cannot_be_given_is_refused():
    robot = little_biped()
    scene = scene_of(robot)
    law = Servo(Controller("pd", 4.0, Kd=0.05))
    own = load_policy(NETWORK, robot, **HOW)
    for policy, on, more, said in [
        (own, scene, {"doubts": {"roughness": {"height": 0.01}}}, "ground: it has field"),
        (own, scene.recompiled(ground=Ground(steps=((1.0, 0.01),))), {}, "ground: it has steps"),
        (own, scene.recompiled(ground=None), {}, "there is no ground"),
        (own, replace(robot, servos=dict.fromkeys(robot.servos, law)), {}, "the torque law 'pd'"),
        (own, scene, {"timestep": 3e-4}, "does not divide the controllers' period"),
        (replace(own, controller=lambda scene: None), scene, {}, "compiled controller does not run in MuJoCo"),
    ]:
        with pytest.raises(ValueError, match=said):
            crosscheck_policy(policy, on, 1.0, worlds=2, **more)


@pytest.mark.long
def test_the_command_takes_a_network(tmp_path, capsys):
    save_robot(little_biped(), tmp_path / "little_biped.urdf")
    line = ["crosscheck", str(NETWORK), "--robot", str(tmp_path / "little_biped.urdf"), "--seconds", "1"]
    assert cli.main([*line, "--description", str(HOW["description"]), "--floors", "10ms_0.9,20ms_0.9"]) == 0
    assert capsys.readouterr().out.count("energy by way [J/m]") == 2
