"""The error estimate of each run, from a second one, and the status of a run that it shows wrong."""

import math
import operator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from scenes import pendulum

from featherstone_gait import (
    Ground,
    Reference,
    Trajectory,
    compile_scene,
    initial_state,
    load_robot,
    load_servo,
    simulate,
    simulate_batch,
)
from featherstone_gait.benchmark.default_scenes import AX12_LAW
from featherstone_gait.benchmark.scenes import unlimited
from featherstone_gait.robot_file.servos import with_servo
from featherstone_gait.run.error_estimate import second_run, with_error_estimate
from featherstone_gait.run.prepare import with_tolerance

ARM = unlimited(load_robot("arm7_spatial"))


def thrown(scene, angle):
    return initial_state(scene, np.full(7, angle))


@pytest.fixture(scope="module")
def free():
    return compile_scene(ARM, integrator="ars343")


@pytest.mark.long
def test_the_true_error_lies_near_the_one_that_is_told(free):
    exact = simulate(compile_scene(ARM), 0.5, thrown(free, 0.5), rtol=1e-11)
    for rtol in (1e-2, 1e-3, 1e-4):
        run = simulate(free, 0.5, thrown(free, 0.5), rtol=rtol)
        for name in ("q", "qd"):
            true, told = (np.abs(x).max() for x in (run[name] - exact[name], run.error[name]))
            assert true < 3.0 * told
            assert told < 10.0 * true


@pytest.mark.parametrize(("reach", "share"), [(0.005, 1.0), (3.0, 0.35)])
def test_where_stops_decide_the_steps_the_whole_difference_is_told(reach, share):
    """Between two stops that are near, and between those that it never meets."""
    scene = compile_scene(pendulum(lower=-reach, upper=reach, damping=0.0), integrator="dop853")
    run = simulate(scene, 1.0, initial_state(scene, [0.0], [5.0]))
    other = second_run(scene, run.info["rtol"], run.info["atol"], None)
    coarse = simulate(
        other.scene, 1.0, initial_state(scene, [0.0], [5.0]), rtol=other.rtol, atol=other.atol, estimate_error=False
    )
    difference = np.abs(run["q"] - coarse["q"])
    assert difference.max() > 1e-9
    np.testing.assert_allclose(run.error["q"], share * difference, atol=1e-12)


@pytest.mark.long
def test_impacts_that_a_fixed_step_cuts_short_are_seldom_passed_as_right():
    """A pendulum thrown between stops: a second opinion that is not in order counts more."""
    model, speeds = pendulum(lower=-0.3, upper=0.5), np.linspace(0.5, 12.0, 47)
    euler, exactly = (compile_scene(model, integrator=name, timestep=1e-3) for name in ("implicit_euler", "dop853"))
    runs = simulate_batch(euler, 1.0, [initial_state(euler, [0.0], [v]) for v in speeds])
    exact = simulate_batch(
        exactly, 1.0, [initial_state(exactly, [0.0], [v]) for v in speeds], rtol=1e-11, record_interval=0.01
    )
    wrong = [np.abs(run["qd"] - true["qd"]).max() > 0.1 * np.abs(true["qd"]).max() for run, true in zip(runs, exact)]
    passed = [run.ok for run in runs]
    assert sum(wrong) > 15
    assert sum(passed) > 15
    assert sum(map(operator.and_, wrong, passed)) <= 2


@pytest.mark.long
def test_a_run_beyond_prediction_says_so_and_since_when(free):
    run = simulate(free, 6.0, thrown(free, 1.5))
    assert run.status == "inaccurate"
    assert "uncertain" in run.message
    since = float(run.message.split("from ")[1].split(" s")[0])
    sound = run["time"] < since
    assert (run.error["q"][sound] <= 1e-3).all()
    assert run.error["q"].max() > 1e-3
    assert simulate(free, 6.0, thrown(free, 1.5), estimate_error=False).status == "ok"


@pytest.mark.long
def test_only_what_is_asked_for_is_kept(free):
    run = simulate(free, 0.05, thrown(free, 0.1), record=("torque",))
    assert set(run) == {"time", "torque"}
    assert set(run.error) == {"torque"}
    assert simulate(free, 0.05, thrown(free, 0.1), estimate_error=False).error is None


def test_pieces_alone_and_in_a_batch_have_the_same_error_to_the_bit():
    scene = compile_scene(load_robot("ax12_arm"), "mipsd", integrator="ars343")
    step = Reference([0.0], [[0.5]])
    whole, other = simulate_batch(scene, 0.06, references=[step, Reference([0.0], [[0.1]])])
    first = simulate(scene, 0.02, reference=step)
    rest = simulate(scene, 0.04, first, reference=step)
    assert rest.final.tobytes() == whole.final.tobytes()
    assert rest.second_final.tobytes() == whole.second_final.tobytes()
    assert rest.error["q"].tobytes() == whole.error["q"][2:].tobytes()
    assert other["q"][-1] != whole["q"][-1]


@pytest.mark.long
def test_the_end_of_the_second_run_is_kept_in_the_file(free, tmp_path):
    run = simulate(free, 0.05, thrown(free, 0.1))
    run.save(tmp_path / "run")
    again = Trajectory.load(tmp_path / "run")
    assert again.second_final.tobytes() == run.second_final.tobytes()
    assert again.error["q"].tobytes() == run.error["q"].tobytes()


def test_a_run_that_has_fallen_at_the_start_ends_there():
    humanoid = load_robot("humanoid")
    scene = compile_scene(humanoid, "mipsd", Ground(), integrator="ars343")
    half = math.sin(math.pi / 4)
    q = np.concatenate([[0.0, 0.0, 0.5, half, half, 0.0, 0.0], np.zeros(scene.tree.n)])
    run = simulate(scene, 0.1, initial_state(scene, q, allow_limit_violation=True))
    assert (run.status, run.end_time) == ("fell", 0.0)


@pytest.mark.long
def test_noise_is_the_same_for_both():
    scene = compile_scene(load_robot("ax12_arm"), "mipsd", integrator="ars343")
    noise = np.random.default_rng(0).normal(size=(5, 1, 2)) * (1e-3, 0.1)
    run = simulate(scene, 0.05, reference=Reference([0.0], [[0.2]]), noise=noise)
    assert run.ok
    assert 0.0 < run.error["q"].max() < 1e-4


@pytest.mark.long
def test_a_second_run_that_ends_otherwise_makes_a_run_inaccurate(free):
    run = simulate(free, 0.1, thrown(free, 0.5), estimate_error=False)
    fell = replace(run, status="fell", end_time=0.05)
    told = with_error_estimate(run, fell, 0.25, ("q",))
    assert told.status == "inaccurate"
    assert "in other steps ended otherwise" in told.message


@pytest.mark.long
def test_a_fall_whose_course_is_uncertain_stays_one_and_says_so(free):
    run = simulate(free, 0.1, thrown(free, 0.5), estimate_error=False)
    fell = replace(run, status="fell", message="arm fell at 0.05 s", end_time=0.05)
    off = replace(fell, channels=fell.channels | {"q": fell["q"] + 0.1})
    told = with_error_estimate(fell, off, 0.25, ("q",))
    assert told.status == "fell"
    assert told.message.startswith("arm fell at 0.05 s; ")
    assert "uncertain by 0.025 rad" in told.message
    assert with_error_estimate(fell, fell, 0.25, ("q",)).message == "arm fell at 0.05 s"


# --- fixed steps ---------------------------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.nojit
@pytest.mark.parametrize(("integrator", "order"), [("implicit_euler", 1), ("midpoint", 2), ("rk4", 4)])
@pytest.mark.parametrize("sample", [0.01, 1e-3], ids=["twice the step", "half the step"])
def test_the_error_of_a_fixed_step_is_told_to_within_its_order(integrator, order, sample):
    exact = simulate(compile_scene(ARM), 0.05, thrown(compile_scene(ARM), 0.5), record_interval=sample, rtol=1e-11)
    scene = compile_scene(ARM, integrator=integrator, timestep=1e-3)
    run = simulate(scene, 0.05, thrown(scene, 0.5), record_interval=sample)
    true, told = (np.abs(x).max() for x in (run["q"] - exact["q"], run.error["q"]))
    assert true < 2.0 * told
    assert told < 6.0 * true


@pytest.mark.long
@pytest.mark.nojit
def test_a_fixed_step_that_is_wrong_by_a_hundredth_says_so():
    scene = compile_scene(ARM, integrator="implicit_euler", timestep=5e-3)
    run = simulate(scene, 0.5, thrown(scene, 0.5))
    assert run.status == "inaccurate"
    assert "give a smaller timestep than 0.005 s" in run.message
    exact = simulate(scene, 0.5, thrown(scene, 0.5), rtol=1e-9)
    assert np.abs(run["q"] - exact["q"]).max() > 1e-2
    assert simulate(scene, 0.5, thrown(scene, 0.5), estimate_error=False).ok


@pytest.mark.long
def test_recorded_energies_that_are_wrong_by_more_than_a_hundredth_say_so():
    """A pendulum loses its energy to damping, dry friction and stops: Euler's step takes 7 % of it."""
    model = pendulum(lower=-0.4, upper=0.4, friction=0.02)
    scene = compile_scene(model, integrator="implicit_euler", timestep=1e-3)
    start, record = initial_state(scene, [0.3], [2.0]), ("q", "energy")
    run, exact = simulate(scene, 3.0, start, record=record), simulate(scene, 3.0, start, record=record, rtol=1e-9)
    off = np.abs(run["energy"] - exact["energy"])[-1].max()
    assert off > 0.04 * np.abs(exact["energy"]).max()
    assert off < 3.0 * run.error["energy"][-1].max()
    assert np.abs(run["q"] - exact["q"])[-1] < 1e-2
    assert run.status == "inaccurate"
    assert "energy of hinge" in run.message
    assert simulate(scene, 3.0, start).ok  # where energies are not asked for
    default = simulate(compile_scene(model), 3.0, start, record=record)
    assert default.ok
    assert np.abs(default["energy"] - exact["energy"])[-1].max() < 1e-3 * np.abs(exact["energy"]).max()


@pytest.mark.long
@pytest.mark.nojit
def test_a_finer_run_is_asked_before_a_fixed_step_is_called_inaccurate():
    """At 2 ms the midpoint rule rings at the stop, at 1 ms it does not."""
    scene = compile_scene(pendulum(lower=-0.4, upper=0.4), integrator="midpoint", timestep=1e-3)
    how = {"state": initial_state(scene, [-0.3]), "tau": [1.0]}
    run, exact = simulate(scene, 1.0, **how), simulate(scene, 1.0, **how, rtol=1e-9)
    coarse = simulate(scene.recompiled(timestep=2e-3), 1.0, **how, estimate_error=False)
    assert np.abs(coarse["q"] - run["q"]).max() > 0.03
    true = np.abs(run["q"] - exact["q"]).max()
    assert run.ok
    assert true < 3.0 * run.error["q"].max()
    assert run.error["q"].max() < 1e-2


@pytest.mark.long
@pytest.mark.nojit
def test_pieces_of_fixed_steps_have_the_same_second_run():
    scene = compile_scene(ARM, integrator="midpoint", timestep=1e-3)
    whole = simulate(scene, 0.04, thrown(scene, 0.5))
    first = simulate(scene, 0.02, thrown(scene, 0.5))
    rest = simulate(scene, 0.02, first)
    assert rest.final.tobytes() == whole.final.tobytes()
    assert rest.second_final.tobytes() == whole.second_final.tobytes()
    assert rest.error["q"].tobytes() == whole.error["q"][2:].tobytes()


@pytest.mark.long
@pytest.mark.nojit
def test_steps_that_cannot_be_doubled_have_no_second_run():
    still = Reference([0.0], np.zeros((1, 7)))
    simtwo = compile_scene(load_robot("arm7"), "standard", integrator="simtwo", timestep=1e-3)
    assert simulate(simtwo, 0.01, reference=still).error is None
    scene = compile_scene(ARM, integrator="midpoint", timestep=1e-3)
    by_hand = replace(scene, constants=scene.constants._replace(gravity=np.array([0.0, 0.0, -1.6])))
    assert by_hand.by_hand == ["gravity"]
    assert simulate(by_hand, 0.01).error is None


@pytest.mark.bounds
@pytest.mark.nojit
def test_between_ticks_second_runs_take_two_steps_for_one():
    """Else both would take the same, and tell no error."""
    scene = compile_scene(load_robot("ax12_arm"), "rotor", gravity=(0.0, 0.0, 0.0))
    assert scene.integrator == "ars343"
    run = simulate(scene, 0.1, initial_state(scene, [0.0], [1.0]), Reference([0.0], [[1.0]]), rtol=0.1)
    assert run.error["q"].max() > 1e-9


# --- no less than half, no false alarms ---------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize("timestep", [5e-4, 1e-3, 2e-3])
@pytest.mark.parametrize("what", ["current limit", "stop"])
def test_midpoint_tells_half_of_its_error_at_discontinuities(what, timestep):
    servos, stops = load_robot("ax12_arm"), pendulum(lower=-0.4, upper=0.4)
    model, gearbox = (servos, "rotor") if what == "current limit" else (stops, None)
    scene, exactly = (
        compile_scene(model, gearbox, integrator=name, timestep=timestep) for name in ("midpoint", "extrapolation")
    )
    told = []
    for x in np.linspace(0.5, 1.5, 12):
        goal = {"reference": Reference([0.0], [[x]])} if gearbox else {"state": initial_state(scene, [0.0], [2.0 * x])}
        run = simulate(scene, 0.5, **goal)
        if not gearbox:
            goal["state"] = initial_state(exactly, [0.0], [2.0 * x])
        true = np.abs(run["q"] - simulate(exactly, 0.5, **goal, rtol=1e-9, estimate_error=False)["q"]).max()
        told.append(run.error["q"].max() / true)
    assert np.sort(told)[1] > 0.5
    assert np.median(told) < 6.0


@pytest.mark.long
@pytest.mark.parametrize("steps", [{"pwm_steps": 1023.0}, {"encoder_resolution": math.radians(300.0 / 1023.0)}])
def test_laws_in_counts_tell_half_of_their_error(steps):
    model = with_servo(load_robot("ax12_arm"), "ax12", **steps)
    scene, exactly = compile_scene(model, "rotor"), compile_scene(model, "rotor", integrator="extrapolation")
    told = []
    for x in np.linspace(0.2, 1.5, 24):
        goal = {"reference": Reference([0.0], [[x]])}
        run, exact = simulate(scene, 1.0, **goal, rtol=1e-4), simulate(exactly, 1.0, **goal, rtol=1e-9)
        told.append(run.error["q"].max() / np.abs(run["q"] - exact["q"]).max())
    assert np.sort(told)[1] > 0.5
    assert np.median(told) < 2.0


def test_a_law_in_counts_is_compared_with_a_finer_run():
    arm = load_robot("ax12_arm")
    for servo, share in ((arm, 0.35), (with_servo(arm, "ax12", pwm_steps=1023.0), 1.0)):
        other = second_run(compile_scene(servo, "rotor"), 1e-4, 1e-4, None)
        assert other.share == share
        assert other.rtol == pytest.approx(1e-3 if share < 1.0 else 1e-5)


@pytest.mark.long
def test_a_count_that_a_tenth_of_the_tolerance_misses_is_told():
    """The arm hovers at the edge of a count, where runs at 1e-5 and 1e-6 are both on the wrong side."""
    scene = compile_scene(with_servo(load_robot("ax12_arm"), "ax12", pwm_steps=1023.0), "rotor", None, "extrapolation")
    goal = {"reference": Reference([0.0], [[1.0231397190563514]])}
    run, exact = simulate(scene, 1.0, **goal, rtol=1e-5), simulate(scene, 1.0, **goal, rtol=1e-12, estimate_error=False)
    tenth = simulate(scene, 1.0, **goal, rtol=1e-6, estimate_error=False)
    true = np.abs(run["q"] - exact["q"]).max()
    assert true > 1e-5
    assert np.abs(run["q"] - tenth["q"]).max() < 0.1 * true
    assert 0.5 * true < run.error["q"].max() < 2.0 * true


@pytest.mark.long
def test_records_that_end_all_steps_hide_no_error():
    scene, exactly = (compile_scene(pendulum(damping=0.0), integrator=name) for name in ("extrapolation", "dop853"))
    for angle in (1.0, 2.5, 3.1):
        start = initial_state(scene, [angle])
        run, exact = simulate(scene, 10.0, start, rtol=1e-4), simulate(exactly, 10.0, start, rtol=1e-12)
        true = np.abs(run["q"] - exact["q"]).max()
        assert 0.5 * true < run.error["q"].max() < 3.0 * true


@pytest.mark.long
def test_smooth_motions_that_are_right_are_seldom_called_inaccurate():
    """Pendulums without friction for ten seconds, from small swings to turning over."""
    scene, right, called = compile_scene(pendulum(damping=0.0)), 0, 0
    for angle in np.linspace(0.2, 3.0, 15):
        start = initial_state(scene, [angle])
        exact = simulate(scene, 10.0, start, rtol=1e-12, estimate_error=False)
        for rtol in (1e-4, 1e-5, 1e-6):
            run = simulate(scene, 10.0, start, rtol=rtol)
            true = np.abs(run["q"] - exact["q"]).max()
            assert run.status == "inaccurate" or true < 1.5e-3
            right += true < 1e-3
            called += true < 1e-3 and run.status == "inaccurate"
    assert right > 25
    assert called <= 0.05 * right


# --- what is chosen ------------------------------------------------------------------------------------------------


@pytest.mark.nojit
def test_the_tolerance_takes_another_integrator_only_where_none_is_named():
    arm = load_robot("ax12_arm")
    scene, named = compile_scene(arm, "rotor"), compile_scene(arm, "rotor", integrator="ars343")
    assert simulate(scene, 0.02).info["integrator"] == "ars343"
    loose, strict, asked = (with_tolerance(*one, None)[0] for one in ((scene, 1e-3), (scene, 1e-6), (named, 1e-6)))
    assert (loose.integrator, strict.integrator, asked.integrator) == ("ars343", "extrapolation", "ars343")
    assert strict.preflight.reason.startswith("extrapolation in place of ars343")


@pytest.mark.long
def test_the_tolerance_is_that_of_the_scene_and_the_integrators_own_where_that_is_least():
    arm = load_robot("arm7")
    humanoid = load_robot("humanoid", locked="simplified")
    assert compile_scene(humanoid, "mipsd", Ground()).rtol == 1e-2
    assert compile_scene(arm, "mipsd").rtol == 1e-4
    assert compile_scene(arm, gearbox="rotor").rtol == 1e-4
    assert compile_scene(humanoid, ground=Ground(), integrator="ars343").rtol == 1e-4
    assert compile_scene(arm).rtol == compile_scene(arm).method.rtol == 1e-7
    limp = compile_scene(arm, integrator="ars343")
    start = thrown(limp, 0.5)
    runs = [simulate(limp, 0.1, start, estimate_error=False, **how) for how in ({}, {"rtol": 1e-4}, {"rtol": 1e-2})]
    ends = [run.final for run in runs]
    assert np.array_equal(ends[0], ends[1])
    assert not np.array_equal(ends[0], ends[2])


@pytest.mark.long
@pytest.mark.parametrize("servo", ["ax12a", "margin"])
def test_where_a_law_jumps_the_tolerance_follows(servo):
    """At ten thousand times this tolerance a third of such steps end more than 1e-3 rad off and say ok."""
    arm = load_robot("ax12_arm")
    own = load_servo("ax12", **AX12_LAW) if servo == "margin" else load_servo(servo)
    scene = compile_scene(replace(arm, servos=dict.fromkeys(arm.servos, own)), "rotor")
    assert scene.rtol == 1e-6
    assert scene.largest_jump > 5e-3
    exact, rng = compile_scene(scene.model, "rotor", integrator="extrapolation"), np.random.default_rng(3)
    wrong = 0
    for _ in range(12):
        target = Reference([0.0], rng.uniform(-1.5, 1.5, (1, 1)))
        run, coarse = (simulate(scene, 1.0, reference=target, **how) for how in ({}, {"rtol": 1e-2}))
        truth = simulate(exact, 1.0, reference=target, rtol=1e-9, estimate_error=False)
        assert run.ok
        assert run.info["integrator"] == "extrapolation"
        assert "controllers jump" in run.info["reason"]
        assert np.abs(run["q"] - truth["q"]).max() < 1e-4
        wrong += np.abs(coarse["q"] - truth["q"]).max() > 1e-3
    assert wrong > 0


@pytest.mark.long
def test_seven_servos_that_step_are_right_where_they_say_so():
    scene, rng = compile_scene(load_robot("arm7"), "mipsd"), np.random.default_rng(1)
    for _ in range(10):
        target = Reference([0.0], rng.uniform(-0.8, 0.8, (1, 7)))
        run = simulate(scene, 1.0, reference=target)
        truth = simulate(scene, 1.0, reference=target, rtol=1e-7, estimate_error=False)
        assert run.ok
        assert np.abs(run["q"] - truth["q"]).max() < 1e-3


@pytest.mark.long
@pytest.mark.parametrize(
    ("how", "most"), [({"integrator": "dop853"}, 1.2), ({"integrator": "rk4", "timestep": 2e-4}, 4.0)]
)
def test_explicit_integrators_tell_what_their_softer_dry_friction_does(how, most):
    """A rod that its friction holds creeps under it: twice as far with friction over twice the width."""
    rod = pendulum(friction=1.0)  # 2.45 N m hold it level
    scene = compile_scene(rod, **how)
    start = initial_state(scene, [0.3])
    run = simulate(scene, 1.0, start, record_interval=0.1)
    crept = abs(run["q"][-1, 0] - 0.3)
    assert 1e-4 < crept < 1e-3
    assert 0.9 * crept < run.error["q"][-1, 0] < most * crept
    far = simulate(scene, 10.0, start, record_interval=0.1)
    assert abs(far["q"][-1, 0] - 0.3) > 1e-3
    assert far.status == "inaccurate" if how["integrator"] == "dop853" else far.error["q"][-1, 0] > 1e-3
    assert np.abs(simulate(compile_scene(rod), 10.0, start)["q"] - 0.3).max() < 1e-9


def test_friction_that_is_as_wide_as_the_robot_has_it_is_no_error():
    arm = load_robot("ax12_arm")
    for width, softer in ((0.05, False), (1e-3, False), (0.0, True)):
        servo = load_servo("ax12", coulomb_friction=0.2, stick_speed=width)
        scene = compile_scene(replace(arm, servos=dict.fromkeys(arm.servos, servo)), "rotor", integrator="dop853")
        other = second_run(scene, 1e-7, 1e-7, None)
        assert (other.scene.constants.friction is not scene.constants.friction) == softer
        assert other.share == 1.0


def test_a_friction_law_from_elsewhere_is_left_as_it_is():
    class Own(NamedTuple):
        budget: float

    scene = compile_scene(ARM, integrator="dop853")
    scene = replace(scene, constants=scene.constants._replace(friction=Own(1.0)))
    other = second_run(scene, 1e-7, 1e-7, None)
    assert other.scene.constants is scene.constants
    assert other.scene.by_hand == ["friction"]
    assert other.share == 0.35
