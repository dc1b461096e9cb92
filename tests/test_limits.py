"""What a real robot asks of a gait: closed forms of each quantity, what a search pays, and how a gait is chosen."""

import math
from dataclasses import replace

import numpy as np
import pytest

from featherstone_gait import ContactPoint, Link, Model, Trajectory, clearance, load_robot, load_servo
from featherstone_gait.collision import meeting_shapes
from featherstone_gait.optimize import (
    _limits_told,
    limits_history,
    optimize_gait,
    optimize_with_limits,
    walking_cost,
)
from featherstone_gait.search import minimize
from featherstone_gait.servo_curve import torque_speed
from featherstone_gait.walking import bounds, limits, worth
from featherstone_gait.walking.cost_in_worlds import in_worlds
from featherstone_gait.walking.limits import BY_NAME, Quantity, Watch, Worst, of_servos, paid


@pytest.fixture(scope="module")
def cost():
    return replace(walking_cost(load_robot("humanoid", locked="simplified"), states="step"), warm_up=1, strides=1)


@pytest.fixture(scope="module")
def watch(cost):
    return Watch(cost.scene.model, cost.start[0])


class Level:
    """As much of a scene as feet need."""

    def __init__(self, model):
        self.model, self.gravity = model, (0.0, 0.0, -9.81)


def foot_run(x, z, roll, forces):
    """A foot of 0.2 by 0.1 m at x, z (n,) [m], rolled about its length (n,) [rad], pressed by forces (n,) [N]."""
    foot = Link("foot", 1.0, (0.0, 0.0, 0.0), (1e-3, 0.0, 0.0, 1e-3, 0.0, 1e-3))
    corners = tuple(ContactPoint("foot", (x, y, 0.0)) for x in (-0.1, 0.1) for y in (-0.05, 0.05))
    n, zero = len(x), np.zeros(len(x))
    base = np.column_stack([x, zero, z, np.cos(roll / 2), np.sin(roll / 2), zero, zero])
    force = np.zeros((n, 4, 3))
    force[..., 0] = forces[:, None] / 4.0
    channels = {"time": 0.01 * np.arange(n), "base_q": base, "q": np.zeros((n, 0)), "contact_force": force}
    model = Model("foot", (foot,), (), "floating", contacts=corners)
    return Watch(model, np.zeros(0)), Level(model), Trajectory(channels, "ok", "", 1.0, np.zeros(0))


def test_swing_is_the_lowest_corner_of_a_fast_foot_and_tilt_that_of_a_loaded_one():
    n = 41
    t = np.linspace(0.0, 1.0, n)
    x, z = 0.3 * t * t * (3.0 - 2.0 * t), 0.02 + 0.01 * np.cos(2.0 * np.pi * t)  # at half its way it is 10 mm high
    roll = np.where(t < 0.15, math.radians(4.0), math.radians(1.0))
    forces = np.where(t < 0.1, 9.81, np.where(t < 0.15, 0.05 * 9.81, 0.0))
    roll[t >= 0.1] = math.radians(6.0)  # while it bears a twentieth of its weight, or nothing
    watch, scene, run = foot_run(x, z, roll, forces)
    found = watch.of_feet(scene, run, slice(0, n))
    swing = found["swing"].worst("swing", run["time"])
    assert swing.value == pytest.approx(0.01 - 0.05 * math.sin(math.radians(6.0)), abs=1e-12)
    assert swing.time == pytest.approx(0.2)
    fast = ~np.isnan(found["swing"].values[:, 0])
    assert np.flatnonzero(fast).tolist() == [k for k in range(n) if 4.0 * t[k] * (1.0 - t[k]) > 0.5]
    tilt = found["tilt"].worst("tilt", run["time"])
    assert tilt.value == pytest.approx(2.0 * math.sin(math.radians(2.0)), abs=1e-12)
    assert tilt.kept
    assert tilt.where == "foot"


@pytest.mark.parametrize("name", ["ax12a", "xl430"])
def test_at_full_voltage_a_servo_is_on_its_line_at_every_speed(name):
    """And at rest its torque is the stall torque."""
    servo = load_servo(name)
    curve = torque_speed(servo, points=11)
    model = load_robot("ax12_arm")
    joint = model.joint_names[0]
    scene = Level(model.with_numbers(servos={joint: servo}))
    scene.servos = "standard"
    channels = {"current": curve.current[:, None], "qd": curve.speed[:, None], "torque": curve.torque[:, None]}
    found = of_servos(scene, Trajectory(channels, "ok", "", 1.0, np.zeros(0)), slice(0, 11))
    assert found["line"].values[:, 0] == pytest.approx(1.0, rel=1e-12)
    assert found["torque"].values[0, 0] == pytest.approx(1.0, rel=1e-12)
    assert found["torque"].worst("torque", np.arange(11.0)) == Worst(
        "torque", pytest.approx(1.0), joint, 0.0, pytest.approx(np.mean(found["torque"].values > 0.8))
    )


def test_what_keeps_to_a_limit_with_its_margin_costs_nothing():
    limit = BY_NAME["swing"]
    safe, bare = limit.bound + limit.margin, limit.bound
    assert Quantity(np.array([[safe], [np.nan]]), ("foot",)).excess(limit) == 0.0
    half = Quantity(np.array([[bare], [safe]]), ("foot",))
    assert half.excess(limit) == pytest.approx(0.5 * limit.margin / limit.scale, rel=1e-9)
    assert half.worst("swing", np.zeros(2)).kept
    assert paid([{"swing": 0.0}, {"swing": 0.0}], 0.02, 0.0) == 1.0
    assert paid([{"swing": 0.2}, {"swing": 0.0}], 0.0, 0.0) == pytest.approx(1.0 + 0.1 * limit.weight)
    assert paid([{"swing": 0.0}], -0.04, 0.0) == pytest.approx(1.0 + BY_NAME["drift"].weight)


def test_only_limbs_that_are_apart_at_the_start_are_watched(cost, watch):
    model = cost.scene.model
    names = {tuple(model.shapes[k].link for k in pair) for pair in watch.pairs.tolist()}
    assert ("left_foot", "right_foot") in names
    every = {tuple(model.shapes[k].link for k in pair) for pair in meeting_shapes(model).pairs.tolist()}
    assert ("trunk", "left_thigh") in every - names
    assert ("trunk", "left_foot") in every - names  # far apart, but of one limb
    assert ("left_shank", "left_forearm") in watch.close()
    assert not {tuple(sorted(pair)) for pair in watch.close()} & {tuple(sorted(pair)) for pair in names}


def test_links_apart_are_read_off_what_the_servos_are_sent(cost, watch):
    stride = cost.gait.angles(0.04 * np.arange(16))
    found = watch.apart(stride)
    base = np.tile([0.3, 0.1, 0.2, 1.0, 0.0, 0.0, 0.0], (16, 1))
    assert found.values[:, 0] == pytest.approx(clearance(cost.scene.model, np.hstack([base, stride]), watch.pairs)[0])
    every = clearance(cost.scene.model, np.hstack([base, stride])).distance
    assert (found.values[:, 0] >= every - 1e-9).all()
    assert len(watch.pairs) < len(meeting_shapes(cost.scene.model).pairs)
    assert watch.planned(stride) == 0.0
    inwards = stride.copy()
    for name, sign in (("left_hip_lateral", 1.0), ("right_hip_lateral", -1.0)):
        column = cost.gait.joint_names.index(name)
        inwards[:, column] += sign * 0.15
    outwards = 2.0 * stride - inwards
    assert max(watch.planned(inwards), watch.planned(outwards)) > 0.5  # one of them lets the feet meet


def test_a_gait_pays_for_what_it_passes_in_shares_of_its_cost(cost, watch):
    plain, paying = in_worlds(cost, 2), in_worlds(cost, 2, watch=watch)
    x = cost.gait.to_vector()
    (signal,) = paying._signals([x])
    (walks,) = paying._walked([signal])
    drift = sum(one.measures.sideways / one.measures.distance for one in walks) / 2.0
    factor = paid([one.excess for one in walks], drift, 0.0)
    assert factor > 1.1  # the first gait asks more of its knees than the supply gives
    assert paying(x) == (pytest.approx(factor * plain(x)[0], rel=1e-14), "ok")
    assert paying.verified(x) == (1.0, paying(x)[0])


def test_lanes_that_run_ahead_find_what_one_candidate_at_a_time_finds(cost, watch):
    paying = in_worlds(cost, 2, watch=watch)
    how = {"amplitude": math.radians(4.0)}
    ahead = optimize_gait(paying, iterations=4, **how)
    one = minimize(
        paying, cost.gait.to_vector(), max_iterations=4, bounds=bounds(cost.scene.model, cost.gait), **how
    )
    assert np.array_equal(ahead.history["x"], one.history["x"])
    assert np.array_equal(ahead.history["f"], one.history["f"])


def test_a_search_with_limits_begins_where_the_one_for_energy_ends(cost, watch, tmp_path):
    """And goes on from its two histories to the same."""
    plain, history = in_worlds(cost, 2), tmp_path / "gait_history.jsonl"
    found = optimize_with_limits(plain, watch, history, iterations=6)
    alone = optimize_gait(plain, iterations=3)
    assert (found.nit, found.since, len(found.history["f"])) == (6, 4, 7)
    assert np.array_equal(found.history["f"][:4], alone.history["f"])
    assert np.array_equal(found.history["x"][4], alone.x)
    assert found.history["f"][4] > 1.1 * alone.fun
    assert found.fun == found.history["f"][4:].min()
    limits_history(history).unlink()
    again = optimize_with_limits(plain, watch, history, iterations=6, resume=True)
    assert np.array_equal(again.x, found.x)
    assert "limited" not in optimize_with_limits(plain, watch, tmp_path / "none.jsonl", iterations=0)


def test_the_worst_values_are_named_with_joint_and_time(cost, watch):
    found = worth.plausible(cost, cost.gait.to_vector(), watch)
    told = {one["name"]: one for one in found["limits"]}
    assert [*told] == [limit.name for limit in limits.LIMITS]
    assert "knee" in told["line"]["where"]
    assert cost.mark <= told["line"]["time"] <= cost.end
    assert told["torque"]["value"] < 1.0
    assert told["drift"]["time"] is None
    assert 0.0 < found["current"]["rms"] < found["current"]["peak"] <= 0.9  # the servo's limit [A]
    lines = _limits_told({"before": found, "after": {"limits": None}})
    assert len(lines) == len(limits.LIMITS)
    assert "at most 80 %" in lines[4]


def test_of_the_best_candidates_that_is_taken_which_walks_elsewhere(cost, watch, monkeypatch):
    monkeypatch.setattr(worth, "CHECKED", 2)
    monkeypatch.setattr(worth, "UNSEEN_STRIDES", 1)
    first, poses = cost.gait.to_vector(), cost.gait.poses.copy()
    poses[:, cost.gait.joint_names.index("left_hip_front")] += 0.7
    falls = poses[: len(poses) // 2].ravel()
    history = {"x": np.array([first, falls, first]), "f": np.array([80.0, 20.0, math.inf])}
    x, rows = worth.chosen(cost, watch, history)
    assert np.array_equal(x, first)
    assert [(row["candidate"], row["walks"]) for row in rows] == [(1, 0.0), (0, 1.0)]


def test_power_that_is_always_drawn_is_paid_by_the_time_that_a_metre_takes():
    told = worth.with_standby({"cost": 20.0, "speed": 0.1}, {"electronics": 2.0, "held": 1.0})
    assert told == {"motors": 20.0, "electronics": pytest.approx(40.0), "held": pytest.approx(50.0)}
    assert worth.with_standby({"cost": None, "speed": None}, {"held": 1.0}) == {"motors": None, "held": None}
