"""What a real robot asks of a gait: closed forms of each quantity, what a search sees of it, how a gait is chosen."""

import math
import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import OptimizeResult

from featherstone_gait import ContactPoint, Link, Model, Trajectory, clearance, load_robot, load_servo
from featherstone_gait.geometry.distance import meeting_shapes
from featherstone_gait.identification.curve import torque_speed
from featherstone_gait.optimize import optimize_gait, optimize_with_limits, quality, selection, walking_cost
from featherstone_gait.optimize.summary_table import _limits
from featherstone_gait.walking import descent, limits
from featherstone_gait.walking.cost_in_worlds import in_worlds
from featherstone_gait.walking.descent import descend
from featherstone_gait.walking.limits import BY_NAME, FADES, Quantity, Watch, Worst, of_servos


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
    fast = found["swing"].share[:, 0] >= 1.0
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
    scene.gearbox = "standard"
    channels = {"current": curve.current[:, None], "qd": curve.speed[:, None], "torque": curve.torque[:, None]}
    found = of_servos(scene, Trajectory(channels, "ok", "", 1.0, np.zeros(0)), slice(0, 11))
    assert found["line"].values[:, 0] == pytest.approx(1.0, rel=1e-12)
    assert found["torque"].values[0, 0] == pytest.approx(1.0, rel=1e-12)
    assert found["torque"].worst("torque", np.arange(11.0)) == Worst(
        "torque", pytest.approx(1.0), joint, 0.0, pytest.approx(np.mean(found["torque"].values > 0.8))
    )


def test_a_search_sees_what_is_beyond_a_limit_the_less_the_less_it_counts():
    """In shares of the scale, with the margin, and without a jump where it begins to count."""
    limit = BY_NAME["swing"]
    heights = limit.bound - limit.scale * np.array([0.0, 1.0, 1.0, 1.0, 1.0])
    share = np.array([2.0, 2.0, 1.0, 1.0 - 1e-9, 0.5])
    quantity = Quantity(heights[:, None], share[:, None], ("foot",))
    margin = limit.margin / limit.scale
    expected = [margin, 1.0 + margin, 1.0 + margin, 1.0 + margin, 1.0 + margin - 0.5 * FADES]
    assert quantity.beyond(limit)[:, 0] == pytest.approx(expected, abs=1e-8)
    assert quantity.worst("swing", np.arange(5.0)).share == pytest.approx(2.0 / 3.0)  # of those that count


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
    planned = lambda stride: watch.apart(stride).beyond(BY_NAME["apart"]).max()  # noqa: E731
    assert planned(stride) < 0.0
    inwards = stride.copy()
    for name, sign in (("left_hip_lateral", 1.0), ("right_hip_lateral", -1.0)):
        column = cost.gait.joint_names.index(name)
        inwards[:, column] += sign * 0.15
    outwards = 2.0 * stride - inwards
    assert max(planned(inwards), planned(outwards)) > 0.5  # one of them lets the feet meet


def test_the_best_step_is_where_slopes_balance():
    """Least a'd + price |max(0, r + S'd)|^2 by hand: along one angle a limit is met, along the other nothing holds."""
    price, radius = 2.0, 0.5
    slope, slopes, beyond = np.array([-1.0, -1e-4]), np.array([[4.0], [0.0]]), np.array([-0.4])
    d = descent._best(slope, slopes, beyond, price, radius)
    assert d[0] == pytest.approx((0.4 + 1.0 / (2.0 * price * 4.0)) / 4.0, rel=1e-3)
    assert abs(d[1]) <= radius
    assert -1e-3 <= descent._best(-slope, slopes, beyond, price, 1e-3)[0] < -0.5e-3
    H = descent.hadamard(8, dtype=float)
    assert np.array_equal(H.T @ H, 8.0 * np.eye(8))


def test_slopes_are_measured_with_changes_that_the_encoders_see(cost, watch):
    """Two counts of them, or 0.3 degrees where those are finer."""
    assert descent._Descent(in_worlds(cost, 1), watch).width == descent.WIDTH
    model = cost.scene.model
    coarse = load_servo("ax12", encoder_resolution=math.radians(0.29))
    read = replace(cost, scene=cost.scene.recompiled(replace(model, servos=dict.fromkeys(model.servos, coarse))))
    assert descent._Descent(in_worlds(read, 1), watch).width == 2.0 * math.radians(0.29)


@pytest.mark.long
def test_a_descent_is_the_better_at_its_price_the_longer_it_goes_and_goes_on_from_its_history(cost, watch, tmp_path):
    plain, history = in_worlds(replace(cost, strides=3), 2), tmp_path / "descent.jsonl"
    one = descend(plain, watch, steps=1, history=history)
    first = one.history["f"][0], one.history["broken"][0]
    last = one.fun, one.history["broken"][-1]
    price = lambda f, broken: f / first[0] + descent.PRICE * broken  # noqa: E731
    assert price(*last) < 0.9 * price(*first)
    assert one.fun == pytest.approx(plain(one.x)[0], rel=1e-2)  # but for runs that are repeated at a finer step
    on = descend(plain, watch, steps=2, history=history, resume=True)
    at_once = descend(plain, watch, steps=2)
    assert np.array_equal(on.history["x"], at_once.history["x"])
    assert np.array_equal(on.x, at_once.x)
    with pytest.raises(ValueError, match=r"another search \(seed differs\)"):
        descend(plain, watch, steps=2, seed=1, history=history, resume=True)
    with pytest.raises(FileExistsError, match="resume"):
        descend(plain, watch, steps=2, history=history)


def test_a_descent_begins_with_the_first_gait_that_walks(cost, watch):
    plain, gait = in_worlds(cost, 1), cost.gait.to_vector()
    assert np.array_equal(descend(plain, watch, [_falling(cost), gait], steps=0).x, gait)
    assert math.isinf(descend(plain, watch, [_falling(cost)], steps=1).fun)


def _falling(cost):
    poses = cost.gait.poses.copy()
    poses[:, cost.gait.joint_names.index("left_hip_front")] += 0.7
    return poses[: len(poses) // 2].ravel()


def test_a_search_with_limits_begins_where_the_one_for_energy_ends(cost, watch, tmp_path):
    """And goes on from its two histories to the same."""
    plain, history = in_worlds(cost, 2), tmp_path / "gait_history.jsonl"
    found = optimize_with_limits(plain, watch, history, iterations=6)
    alone = optimize_gait(plain, iterations=3)
    assert (found.nit, found.since, len(found.history["f"])) == (3, 4, 5)  # no step is as short as three candidates
    assert np.array_equal(found.history["f"][:4], alone.history["f"])
    assert np.array_equal(found.history["x"][4], alone.x)
    assert "limited" not in optimize_with_limits(plain, watch, tmp_path / "none.jsonl", iterations=0)


def test_a_search_with_limits_is_made_longer_to_the_bits_of_one_that_was_as_long_at_once(cost, watch, tmp_path, caplog):
    """Its descent begins anew where the longer search ends, and the old one's history is kept."""
    plain, history, begun = in_worlds(cost, 2), tmp_path / "gait_history.jsonl", tmp_path / "gait_limits_history.jsonl"
    optimize_with_limits(plain, watch, history, iterations=6)
    old = begun.read_bytes()
    longer = optimize_with_limits(plain, watch, history, iterations=16, resume=True)
    at_once = optimize_with_limits(plain, watch, tmp_path / "once_history.jsonl", iterations=16)
    assert np.array_equal(longer.history["x"], at_once.history["x"])
    assert begun.read_bytes() == (tmp_path / "once_limits_history.jsonl").read_bytes() != old
    assert (tmp_path / "gait_limits_history.jsonl.old").read_bytes() == old
    assert "3 candidates" in caplog.text


@pytest.mark.parametrize(("kept", "asked"), [(False, [4, 6, 8]), (True, [4])])
def test_a_descent_goes_on_by_half_while_no_gait_keeps_all_limits(cost, watch, tmp_path, monkeypatch, kept, asked):
    module, x, steps = sys.modules[optimize_with_limits.__module__], cost.gait.to_vector(), []
    history = {"x": x[None], "f": np.array([50.0])}
    found = OptimizeResult(
        nit=4, nfev=5, wasted=0, resumed=0, occupancy=1.0, success=True, history=history, tried=history
    )

    def descended(*args, **how):
        steps.append(how["steps"])
        assert how["resume"] is (len(steps) > 1)
        return found

    monkeypatch.setattr(module, "optimize_gait", lambda *args, **how: found)
    monkeypatch.setattr(module, "descend", descended)
    limits = {"limits": [{"kept": True}, {"kept": kept}]}
    monkeypatch.setattr(module, "measure_limits_of_each", lambda cost, vectors, watch: [limits] * len(vectors))
    many = 4 + 1 + 4 * descent.WORK
    optimize_with_limits(in_worlds(cost, 1), watch, tmp_path / "gait_history.jsonl", iterations=many, resume=False)
    assert steps == asked


def test_the_worst_values_are_named_with_joint_and_time(cost, watch):
    found = quality.measure_limits(cost, cost.gait.to_vector(), watch)
    told = {one["name"]: one for one in found["limits"]}
    assert [*told] == [limit.name for limit in limits.LIMITS]
    assert "knee" in told["line"]["where"]
    assert cost.mark <= told["line"]["time"] <= cost.end
    assert told["torque"]["value"] < 1.0
    assert told["drift"]["time"] is None
    assert 0.0 < found["current"]["rms"] < found["current"]["peak"] <= 0.9  # the servo's limit [A]
    heading, *lines = _limits({"before": found, "after": {"limits": None}})
    assert heading.startswith("limits of a real robot")
    assert sum(line.startswith("    worst: ") for line in lines) == 5  # of drift there is no moment
    bounds = [line for line in lines if not line.startswith(" ")]
    assert len(bounds) == len(limits.LIMITS)
    assert "at most 80 %" in bounds[4]
    assert max(map(len, lines)) < 80


def test_of_the_best_candidates_that_is_taken_which_walks_elsewhere(cost, watch, monkeypatch):
    monkeypatch.setattr(selection, "WORLDS", 2)
    monkeypatch.setattr(selection, "TEST_STRIDES", 1)
    first, falls = cost.gait.to_vector(), _falling(cost)
    history = {"x": np.array([first, falls, falls]), "f": np.array([80.0, 20.0, math.inf])}
    x, rows = selection.choose_gait(cost, watch, history)
    assert np.array_equal(x, first)
    assert [(row["candidate"], row["walks"]) for row in rows] == [(0, 1.0), (1, 0.0)]
    kept = sum(one["kept"] for one in quality.measure_limits(cost, first, watch)["limits"])
    assert [row["kept"] for row in rows] == [kept, 0]


def test_power_that_is_always_drawn_is_paid_by_the_time_that_a_meter_takes():
    told = quality.with_standby({"cost": 20.0, "speed": 0.1}, {"electronics": 2.0, "held": 1.0})
    assert told == {"motors": 20.0, "electronics": pytest.approx(40.0), "held": pytest.approx(50.0)}
    assert quality.with_standby({"cost": None, "speed": None}, {"held": 1.0}) == {"motors": None, "held": None}
