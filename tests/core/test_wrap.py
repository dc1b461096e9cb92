"""The short way round: servos of continuous joints whose error is taken modulo a turn."""

import math
from dataclasses import replace

import numpy as np
import pytest
from company import in_company, simulated

from featherstone_gait.crosscheck.servo_chain import ServoChain
from featherstone_gait.model import Controller, Joint, Link, Model, Servo
from featherstone_gait.robot_file import load_robot, load_servo, save_robot
from featherstone_gait.run.reference import Reference
from featherstone_gait.run.simulate import initial_state, simulate
from featherstone_gait.scene.compile import compile_scene

FAR, BACK = math.radians(170.0), math.radians(-170.0)


def disk(servo, kind="continuous", **limits):
    """A disk of 0.01 kg m^2 that a servo turns about a vertical axis."""
    links = (
        Link("stand", 1.0, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)),
        Link("disk", 1.0, (0.0, 0.0, 0.0), (0.006, 0.0, 0.0, 0.006, 0.0, 0.01)),
    )
    joint = Joint("turn", kind, "stand", "disk", axis=(0.0, 0.0, 1.0), **limits)
    return Model("disk", links, (joint,), servos={"turn": servo})


def pd(law="pd", wrap=True):
    return Servo(Controller(law, Kp=4.0, Kd=0.4, wrap=wrap))


def ax12(wrap=True, **law):
    servo = load_servo("ax12")
    return replace(servo, controller=replace(servo.controller, wrap=wrap, **law))


def run_of(servo, integrator="midpoint", gearbox="rotor", times=(0.0, 0.3), goals=(FAR, BACK), duration=2.0):
    scene = compile_scene(disk(servo), gearbox, integrator=integrator, timestep=1e-3)
    reference = Reference(times, np.array(goals)[:, None], "hold")
    return simulate(scene, duration, initial_state(scene, [goals[0]]), reference, estimate_error=False)


def check_short_way(run):
    """From 170 to -170 degrees over 180: 20 degrees."""
    assert run.ok
    assert abs(run["q"][-1, 0] - (BACK + 2.0 * math.pi)) < math.radians(0.5)
    assert run["q"].min() > FAR - math.radians(1.0)


def test_it_moves_twenty_degrees_and_not_340():
    goals = Reference((0.0, 0.3), np.array([[FAR], [BACK]]), "hold")
    scenes = (in_company(disk(pd(wrap=wrap)), "implicit_euler", 1e-3) for wrap in (True, False))
    short_way, long_way = (simulated(scene, 2.0, [FAR], None, goals) for scene in scenes)
    check_short_way(short_way)
    assert abs(long_way["q"][-1, 0] - BACK) < math.radians(0.5)


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["implicit_euler", "midpoint", "rk4", "ars343", "extrapolation", "dop853"])
@pytest.mark.parametrize("law", ["pd", "pd_clamped"])
def test_all_integrators_go_the_short_way(law, integrator):
    check_short_way(run_of(pd(law), integrator))


@pytest.mark.long
@pytest.mark.parametrize("law", ["state", "pid_position"])
@pytest.mark.parametrize("gearbox", ["mipsd", "rotor"])
@pytest.mark.parametrize("profile", [math.inf, 1.0])
def test_servo_chains_go_it_too(law, gearbox, profile):
    """Also toward a goal that moves by no more than a radian a second."""
    Kd = 0.5 if law == "state" else 0.05
    run = run_of(ax12(law=law, Kp=40.0, Ki=0.0, Kd=Kd, profile_speed=profile), gearbox=gearbox)
    assert abs(run["q"][-1, 0] - (BACK + 2.0 * math.pi)) < math.radians(1.0)
    assert run["q"].min() > FAR - math.radians(2.0)


@pytest.mark.long
def test_turns_of_the_reference_do_not_matter():
    """Goals that differ by whole turns give the same motion, up to rounding."""
    plain, turned = (run_of(pd(), goals=(FAR, BACK + turns * 2.0 * math.pi)) for turns in (0, 7))
    assert np.abs(plain["q"] - turned["q"]).max() < 1e-9


@pytest.mark.long
@pytest.mark.parametrize("servo", [pd, ax12])
def test_within_half_a_turn_it_changes_no_bit(servo):
    plain, wrapped = (run_of(servo(wrap=wrap), goals=(0.2, 1.0)) for wrap in (False, True))
    assert plain.final.tobytes() == wrapped.final.tobytes()


@pytest.mark.parametrize(
    ("error", "short"),
    [(math.pi, math.pi), (-math.pi, math.pi), (3.5, 3.5 - 2 * math.pi), (20.0, 20.0 - 6 * math.pi)],
)
def test_the_half_turn_goes_forward(error, short):
    """In NumPy: the voltage of a proportional law is Kp times the short error."""
    chain = ServoChain([ax12(law="state", Kp=1.0, Ki=0.0, Kd=0.0, Kf=0.0)], 1e-3)
    chain.resolution[:], chain.exact[:] = 0.0, True
    chain.tick(np.array([error]), np.zeros(1), np.zeros(1), np.zeros(1), 0.01)
    assert chain.voltage[0] == pytest.approx(short, abs=1e-12)


def test_it_is_read_from_toml(tmp_path):
    save_robot(disk(pd()), tmp_path / "disk.urdf")
    assert "wrap = true" in (tmp_path / "disk.toml").read_text()
    assert load_robot(tmp_path / "disk.urdf").servos["turn"].controller.wrap is True
    (tmp_path / "disk.toml").write_text('[servos]\ndefault = "ax12"\nwrap = true\n')
    assert load_robot(tmp_path / "disk.urdf").servos["turn"].controller.wrap is True
    (tmp_path / "disk.toml").write_text('[servos]\ndefault = "ax12"\nwrap = 1\n')
    with pytest.raises(ValueError, match="wrap"):
        load_robot(tmp_path / "disk.urdf")


def test_joints_that_cannot_turn_round_are_refused():
    for kind, limits in (("revolute", {"lower": -1.0, "upper": 1.0}), ("revolute", {"upper": 1.0}), ("prismatic", {})):
        with pytest.raises(ValueError, match=r"joint turn is .* wrap"):
            compile_scene(disk(pd(), kind, **limits), "rotor")
    with pytest.raises(ValueError, match="pid_speed"):
        Controller("pid_speed", wrap=True)
