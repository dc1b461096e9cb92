"""What simulations, scenes, references and robots refuse, and that nothing can be changed after it was checked."""

import copy
import math
import pickle
from dataclasses import replace
from datetime import timedelta
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest
from scenes import arm_scene, pendulum

from featherstone_gait import (
    Controller,
    Gearbox,
    Ground,
    Joint,
    Link,
    Model,
    Reference,
    Servo,
    Session,
    Target,
    compile_scene,
    forward_dynamics,
    initial_state,
    inverse_dynamics,
    inverse_kinematics,
    load_robot,
    load_servo,
    nearest_posture,
    plot_motion,
    simulate,
    standing_state,
)
from featherstone_gait.run.prepare import prepare
from featherstone_gait.search import minimize
from featherstone_gait.walking.gait_file import write_angles
from featherstone_gait.walking.plan import WalkSettings
from featherstone_gait.walking.zero_moment_point import multibody_zmp

pytestmark = pytest.mark.nojit


def test_masked_values_are_refused():
    """An array whose mask hides nothing is one like any other."""
    arm = load_robot("arm7")
    hidden = np.ma.masked_array(np.zeros(7), mask=[True, *[False] * 6])
    with pytest.raises(ValueError, match=r"q has masked values: .*; fill them, or leave them out"):
        forward_dynamics(arm, hidden, np.zeros(7), np.zeros(7))
    assert forward_dynamics(arm, np.ma.masked_array(np.zeros(7)), np.zeros(7), np.zeros(7)).shape == (7,)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"gravity": (0.0, -9.81)}, "gravity must be 3 finite numbers"),
        ({"gravity": (0.0, 0.0, -9.81j)}, "gravity is .*3 finite numbers"),
        ({"gravity": "down"}, "gravity is 'down'"),
        ({"fall_tilt": 45}, "fall_tilt is 45; .*math.radians"),
        ({"fall_tilt": -1.0}, "fall_tilt is -1.0"),
        ({"fall_tilt": math.nan}, "fall_tilt is nan"),
        ({"fall_height": math.nan}, "fall_height is nan"),
        ({"fall_height": 1.5}, "fall_height is 1.5; .*fraction"),
        ({"timestep": 1e9}, "timestep is 1000000000.0; .*seconds"),
        ({"timestep": 1e-320}, "timestep is 1e-320"),
        ({"timestep": True}, "timestep is True"),
        ({"integrator": 4}, "integrator is 4; expected 'implicit_euler'"),
    ],
)
def test_scenes_refuse(arguments, message):
    with pytest.raises(ValueError, match=message):
        compile_scene(load_robot("humanoid"), None, Ground(), **arguments)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"duration": 1e9}, "steps of 0.001 s; at most 1e.09: simulate less"),
        (
            {"duration": 1e5, "record": ("q", "qd", "energy"), "record_interval": 1e-3},
            "numbers each; at most .* longer record_interval",
        ),
        ({"duration": 10**400}, "duration is a whole number of 1329 bits"),
        ({"duration": "1"}, "duration is '1'"),
        ({"record_interval": math.inf}, "record_interval is inf"),
        ({"record_interval": math.nan}, "record_interval is nan"),
        ({"record_interval": 1e300}, r"record_interval is 1e\+300"),
        ({"record": "q"}, "record is 'q'; give a list"),
        ({"record": [["q"]]}, "no channel"),
    ],
)
def test_runs_refuse(arguments, message):
    with pytest.raises(ValueError, match=message):
        prepare(arm_scene(), **({"duration": 0.1} | arguments))


def test_a_state_that_no_run_leaves_is_refused():
    scene = arm_scene()
    for part, value in (("status", -1.0), ("status", 0.5), ("step_control", -1e-3), ("end_time", -1.0)):
        state = initial_state(scene)
        state[scene.part(part)[0]] = value
        with pytest.raises(ValueError, match=r"arm7: state: .* make it with initial_state"):
            simulate(scene, 0.1, state)


@pytest.mark.parametrize("size", [0.0, 1e-7, 1e7, 1e200])
def test_a_quaternion_without_a_length_is_refused(size):
    scene = compile_scene(load_robot("humanoid"), None, Ground())
    q = np.zeros(scene.model.nq)
    q[3] = size
    with pytest.raises(ValueError, match=r"quaternion|q must be"):
        initial_state(scene, q)
    with pytest.raises(ValueError, match=r"quaternion|q has a value"):
        forward_dynamics(scene.model, q, np.zeros(scene.model.nv), np.zeros(scene.model.nv))


@pytest.mark.parametrize("wrong", [[1j], ["1.0"], [True], [None], [[1.0], [1.0, 2.0]], "1", None])
def test_what_is_no_real_number_is_refused(wrong):
    model = load_robot("ax12_arm")
    with pytest.raises(ValueError, match="qd is "):
        forward_dynamics(model, [0.0], wrong, [0.0])
    if wrong is not None:
        with pytest.raises(ValueError, match="q is "):
            initial_state(compile_scene(model), wrong)


def test_a_start_beyond_the_limits_is_refused_unless_asked_for():
    scene = compile_scene(load_robot("ax12_arm"))
    upper = scene.model.moving_joints[0].upper
    initial_state(scene, [upper + 0.009])
    with pytest.raises(
        ValueError, match=r"joint 'elbow' is at 3.24159 .* -3.14159 to 3.14159; .*allow_limit_violation=True"
    ):
        initial_state(scene, [upper + 0.1])
    assert initial_state(scene, [upper + 0.1], allow_limit_violation=True)[0] == upper + 0.1


def test_a_start_that_nobody_chose_warns_beyond_the_limits():
    links = (Link("base"), Link("bob", 1.0, (0.1, 0.0, 0.0), (0.01, 0, 0, 0.01, 0, 0.01)))
    knee = Joint("knee", "revolute", "base", "bob", axis=(0.0, 1.0, 0.0), lower=-2.7, upper=-0.9)
    scene = compile_scene(Model("leg", links, (knee,)))
    with pytest.warns(UserWarning, match=r"leg: joint 'knee' is at 0 .* limits -2.7 to -0.9 at the start, and thrown"):
        initial_state(scene)
    initial_state(scene, nearest_posture(scene.model))
    ball = compile_scene(Model("arm", links, (Joint("hip", "ball", "base", "bob", upper=0.5),)))
    with pytest.raises(ValueError, match=r"arm: joint 'hip' is at 1 .* -inf to 0.5; start it between them"):
        initial_state(ball, [math.cos(0.5), 0.0, math.sin(0.5), 0.0])


def test_a_robot_stands_beyond_its_limits_if_asked_to():
    scene = compile_scene(load_robot("humanoid"), "mipsd", Ground())
    angles = [joint.upper + 0.1 for joint in scene.model.moving_joints]
    with pytest.raises(ValueError, match="beyond its limits"):
        standing_state(scene, angles)
    assert np.isfinite(standing_state(scene, angles, allow_limit_violation=True)).all()


def test_a_cyclic_signal_that_would_never_end_is_refused():
    torque = Reference([0.0, 1e-9], [[0.0], [0.0]], cyclic=True)
    with pytest.raises(ValueError, match=r"tau: a period of 1e-09 s with 2 knots .* at most 1e\+08: give a longer"):
        simulate(compile_scene(pendulum(), integrator="dop853"), 1.0, tau=torque)


def test_a_slope_that_is_not_finite_is_refused():
    with pytest.raises(ValueError, match="slope between two knots"):
        Reference([0.0, 1e-300], [[0.0], [1e300]]).knots()


def test_what_was_checked_cannot_be_changed():
    signal, times = Reference([0.0, 1.0], [[0.0], [1.0]]), np.array([0.0, 1.0])
    model = load_robot("humanoid", locked="simplified")
    for array in (signal.values, signal.times, Reference(times, [[0.0], [1.0]]).times):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 3.0
    for table in (model.locked, model.servos, model.keyframes):
        with pytest.raises(TypeError, match="does not support item assignment"):
            table["neck"] = 1.0
    held = dict(model.locked)
    other = replace(model, locked=held)
    held.clear()
    assert other.locked == model.locked
    times[0] = 9.0


def test_a_model_survives_pickle_and_copy():
    model = load_robot("humanoid", locked="simplified")
    for other in (pickle.loads(pickle.dumps(model)), copy.deepcopy(model)):
        assert other.locked == model.locked
        assert other.servos == model.servos
        assert other.links == model.links
        with pytest.raises(TypeError, match="does not support item assignment"):
            other.locked["neck"] = 1.0


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Gearbox(1e200), "ratio is 1e.200 .* of a size from 1e-50 to 1e.50"),
        (lambda: Gearbox(10**400), "ratio is a whole number of 1329 bits"),
        (lambda: Gearbox("254"), "ratio is '254'"),
        (lambda: Controller("pd", Kp=True), "Kp is True"),
        (lambda: Servo(Controller("pid_position"), resistance=1e-320), "resistance is 1e-320"),
    ],
)
def test_numbers_of_servos_are_bounded(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda arm: inverse_dynamics(arm, [0.0], [0.0], [0.0], gravity=None), "gravity"),
        (lambda arm: load_robot("arm7", mimic=np.zeros((2, 2))), "mimic="),
        (lambda arm: Joint("a", "fixed", np.array([1.0, 2.0]), np.array([1.0, 2.0])), "parent"),
        (lambda arm: minimize(None, [0.0, 0.0], amplitude=1.0, max_iterations=3), "fun is None"),
        (lambda arm: minimize(len, [0.0], amplitude=1.0, map=None), "map is None"),
        (lambda arm: plot_motion(arm, {"time": 1.0}), "trajectory is {"),
        (lambda arm: multibody_zmp(load_robot("humanoid"), np.zeros((9, 20)), np.zeros((9, 3)), 0.1, g=0), "g is 0"),
        (lambda arm: write_angles("", [0.0, 1.0], np.zeros((2, 1)), ["a"]), "path is empty"),
        (lambda arm: inverse_kinematics(arm, Target("rod", rotation=[0.0, 0.0, 1e200])), "rotation is"),
    ],
)
def test_what_the_long_attack_found_is_refused_by_name(call, message):
    with pytest.raises((ValueError, TypeError), match=message):
        call(pendulum())


def test_a_whole_number_of_steps_may_be_a_float():
    assert isinstance(WalkSettings(n_steps=4.0).n_steps, int)


LENGTHS = (np.timedelta64(1, "s"), timedelta(seconds=1))


@pytest.mark.parametrize("value", [Decimal("0.1"), Fraction(1, 10), np.array(Decimal("0.1")), *LENGTHS])
def test_numbers_of_other_types_are_refused_with_the_way_to_convert_them(value):
    remedy = "divide it by one second" if value in LENGTHS else r"float\(\)"
    calls = [
        lambda: simulate(arm_scene(), value),
        lambda: compile_scene(pendulum(), timestep=value, integrator="rk4"),
        lambda: Ground(friction=value),
        lambda: replace(pendulum().links[0], mass=value),
        lambda: Reference([0.0, value], np.zeros((2, 1))),
        lambda: compile_scene(pendulum(), gravity=[0.0, 0.0, value]),
        lambda: Session(arm_scene(), value),
        lambda: load_servo("ax12", Kp=value),
    ]
    for call in calls:
        with pytest.raises(ValueError, match=remedy):
            call()


@pytest.mark.parametrize("count", [10**12, 10**40, 1e12])
def test_counts_without_measure_are_refused_at_once(count):
    session = Session(arm_scene(), 2, record=("q",))
    calls = [
        lambda: session.step(ticks=count),
        lambda: Session(arm_scene(), count),
        lambda: Session(arm_scene(), 2, threads=count),
        lambda: minimize(lambda x: 0.0, np.zeros(2), amplitude=0.1, batch=count),
    ]
    for call in calls:
        with pytest.raises(ValueError, match="whole number from"):
            call()
    assert not session.time.any()
