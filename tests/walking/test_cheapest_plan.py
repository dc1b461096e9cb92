"""The plan that costs least: found, told of, within limits, the same each time."""

import math
import sys
from dataclasses import replace

import numpy as np
import pytest
from biped import biped

from featherstone_gait import Ground, load_robot
from featherstone_gait.optimize import walking_cost
from featherstone_gait.robot_file import load_servo
from featherstone_gait.scene.compile import compile_scene
from featherstone_gait.walking.cheapest_plan import SLOW, Box, cheapest_plan, first_gait, gentle_plan, speed_limits
from featherstone_gait.walking.cost_in_worlds import in_worlds
from featherstone_gait.walking.gait import TICK
from featherstone_gait.walking.generic_servo import LEG, MASS, scaled_servo, with_generic_servos

FEW = (3, 1)


@pytest.fixture(scope="module")
def scene():
    return compile_scene(load_robot("humanoid", locked="simplified"), "mipsd", Ground(), "midpoint", 1e-3)


def bent(cost):
    """A cost without a simulation: how far the joints are bent, in the mean."""
    return lambda x: (float(np.abs(x).mean()), "ok")


@pytest.fixture(scope="module")
def found(scene):
    return cheapest_plan(scene, count=FEW, searched=bent)


def test_the_best_of_all_trials_is_found_and_lies_at_or_below_the_plain_one(found):
    costs = [trial.cost for trial in found.trials]
    assert len(costs) == 1 + sum(FEW)
    assert found.value == min(costs)
    assert found.value == np.abs(found.gait.to_vector()).mean()
    assert all((trial.status == "ok") == math.isfinite(trial.cost) for trial in found.trials)
    assert any(trial.status != "ok" for trial in found.trials)  # of the box not all can be walked


def test_the_same_seed_finds_the_same_bits_and_another_does_not(scene, found):
    again, other = (cheapest_plan(scene, count=FEW, searched=bent, seed=seed) for seed in (0, 1))
    assert again.gait.to_vector().tobytes() == found.gait.to_vector().tobytes()
    assert again.trials == found.trials
    assert other.trials[1:] != found.trials[1:]


def test_what_the_servos_are_sent_keeps_limits_of_joints_and_speeds(scene, found):
    angles = found.gait.angles(TICK * np.arange(round(found.gait.period / TICK) + 1))
    lower, upper = np.array([(joint.lower, joint.upper) for joint in scene.model.moving_joints]).T
    assert ((angles >= lower) & (angles <= upper)).all()
    assert (np.abs(np.diff(angles, axis=0)) <= TICK * speed_limits(scene.model)).all()


def test_no_joint_is_faster_than_its_servo_without_load_or_its_own_limit():
    model = load_robot("humanoid", locked="simplified")
    assert speed_limits(model) == pytest.approx(np.full(10, 5.590), rel=1e-4)  # of the AX-12 at 10 V
    slow = replace(model, joints=tuple(replace(j, velocity=2.0) if "knee" in j.name else j for j in model.joints))
    assert sorted(set(np.round(speed_limits(slow), 3))) == [2.0, 5.59]


def test_numbers_that_are_held_stay(scene):
    one = cheapest_plan(scene, count=(1,), searched=bent, lift=0.015, step_time=0.3, half_width=0.037)
    assert {(t.walk.lift, t.walk.step_time, t.walk.half_width) for t in one.trials} == {(0.015, 0.3, 0.037)}


def test_servos_too_slow_for_the_slowest_plan_are_named_before_any_plan_is_tried(scene):
    """At 0.15 of the voltage an AX-12 turns at 0.84 rad/s without load."""
    model, tried = scene.model, []
    slow = {name: replace(servo, voltage_limit=0.15 * servo.voltage_limit) for name, servo in model.servos.items()}
    with pytest.raises(ValueError, match=r"rad/s, and without load it reaches 0\.84 rad/s.* 1\.3 rad/s is xc330"):
        cheapest_plan(scene.recompiled(replace(model, servos=slow)), searched=tried.append)
    assert not tried


def test_where_no_plan_can_be_walked_the_most_common_reason_is_told(scene):
    never = lambda cost: lambda x: (math.inf, "fell")  # noqa: E731
    with pytest.raises(ValueError, match=r"none of 3 planned walks can be walked.*give faster servos .* --walk NAME"):
        cheapest_plan(scene, count=(1,), searched=never)
    with pytest.raises(ValueError, match=r"none of 2 planned walks"):
        cheapest_plan(scene, count=(1,), searched=never, box=Box())
    with pytest.raises(ValueError, match="box: lift = "):
        Box(lift=(0.1, 0.05))
    with pytest.raises(ValueError, match="count has 5 numbers"):
        cheapest_plan(scene, count=(1, 1, 1, 1, 1))


@pytest.mark.quick("held0")
@pytest.mark.parametrize("held", [{"step_length": 3.0}, {"com_height": 3.0}, {"half_width": 1.0}])
def test_what_no_leg_reaches_is_told_as_the_reason(scene, held):
    with pytest.raises(ValueError, match=rf"none of 1 planned walks with {next(iter(held))} .* cannot reach"):
        cheapest_plan(scene, count=(2, 1), searched=bent, box=SLOW, **held)


def test_where_nothing_in_the_usual_box_can_be_walked_slower_plans_are_tried(scene):
    """As if the joints were too slow for the usual steps: none of these takes 0.36 s."""
    def usual(cost):
        return bent(cost) if cost.gait.period > 0.72 else lambda x: (math.inf, "no")

    found = cheapest_plan(scene, count=(2,), searched=usual)
    assert len(found.trials) == 5
    assert all(trial.status != "ok" for trial in found.trials[:3])
    assert found.plan.walk.step_time > 0.36
    assert found.plan.walk.lift < 0.025


def with_servos(scene, torque, speed):
    """The humanoid with AX-12 of other torque and speed."""
    servo = scaled_servo(load_servo("ax12"), torque, speed)
    return scene.recompiled(replace(scene.model, servos=dict.fromkeys(scene.model.servos, servo)))


@pytest.mark.long
def test_slow_servos_walk_a_plan_of_slow_steps(scene):
    """With 0.6 of the speed the plain plan's references are too fast for the joints."""
    slow = with_servos(scene, 1.0, 0.6)
    found = gentle_plan(slow)
    assert in_worlds(found.cost, 8)(found.gait.to_vector()) == (found.value, "ok")
    references = found.gait.angles(TICK * np.arange(round(found.gait.period / TICK) + 1))
    speeds = np.abs(np.diff(references, axis=0)).max(axis=0) / TICK
    assert (speeds <= speed_limits(slow.model)).all()
    plain = first_gait(slow, "plain").gait
    references = plain.angles(TICK * np.arange(round(plain.period / TICK) + 1))
    assert np.abs(np.diff(references, axis=0)).max() / TICK > speed_limits(slow.model).min()


def test_weak_servos_are_told_torque_and_speed_of_the_plans_that_fall_and_a_servo_with_a_reserve(scene):
    with pytest.raises(ValueError, match=r"none of 4 plans .* rad/s.* bears 0\.67 N m.* at stall.* is xl430"):
        gentle_plan(with_servos(scene, 0.6, 1.0))
    with pytest.raises(ValueError, match="double_support"):
        gentle_plan(scene, double_support=2.0)


def test_servos_are_no_remedy_where_they_are_strong_and_fast_enough(scene, monkeypatch):
    """Four times the torque and speed of the AX-12, and plans that fall all the same."""
    falls = lambda _: lambda cost: lambda x: (math.inf, "fell")  # noqa: E731
    monkeypatch.setattr(sys.modules[gentle_plan.__module__], "_in_the_same_worlds", falls)
    strong = with_servos(scene, 4.0, 4.0)
    with pytest.raises(ValueError, match=r"none of 4 plans .*: fell; give numbers of a walk.* --walk NAME") as told:
        gentle_plan(strong)
    assert "servo of the package" not in str(told.value)
    with pytest.raises(ValueError, match=r"for this: fell; give numbers of a walk"):
        cheapest_plan(strong, count=(1,))
    with pytest.raises(ValueError, match=r"for this: .* give stronger and faster servos"):
        cheapest_plan(with_servos(scene, 0.6, 1.0), count=(1,))


def test_the_plain_plan_is_that_of_before(scene):
    before, now = walking_cost(scene.model, states="step"), first_gait(scene, "plain", "step")
    assert now.gait.to_vector().tobytes() == before.gait.to_vector().tobytes()
    assert now.start.tobytes() == before.start.tobytes()
    with pytest.raises(ValueError, match="plan"):
        first_gait(scene, "dear")


@pytest.mark.long
def test_the_cheapest_plan_costs_a_third_less_than_the_plain_one_and_walks_in_all_worlds(scene):
    plain = first_gait(scene, "plain")
    cheapest = first_gait(scene, seed=0)
    cost = [in_worlds(one, 8)(one.gait.to_vector())[0] for one in (plain, cheapest)]
    assert cost[1] < cost[0] * 2.0 / 3.0


def test_a_servo_of_twice_the_torque_and_half_the_speed_is_one():
    ax12 = load_servo("ax12")
    other = scaled_servo(ax12, 2.0, 0.5)
    stall = [s.gearbox.ratio * s.motor_constant * s.current_limit for s in (ax12, other)]
    assert stall[1] == pytest.approx(2.0 * stall[0], rel=1e-12)
    model = load_robot("humanoid", locked="simplified")
    slower = replace(model, servos=dict.fromkeys(model.servos, other))
    assert speed_limits(slower) == pytest.approx(0.5 * speed_limits(model), rel=1e-5)


def test_the_bioloids_generic_servo_is_its_own():
    model = biped()
    same = with_generic_servos(model, LEG, margin=MASS / model.mass)
    (servo,) = set(same.servos.values())
    assert servo.resistance == pytest.approx(load_servo("ax12").resistance, rel=1e-12)
    assert [*same.servos] == [*model.joint_names]
