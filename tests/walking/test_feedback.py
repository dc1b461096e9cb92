"""Walking with feedback: the sensors it reads, the bits it keeps, and what it is worth."""

import math
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from featherstone_gait import Ground, Push, compile_scene, load_robot, simulate, simulate_batch
from featherstone_gait.dynamics import center_of_mass, contact_positions
from featherstone_gait.optimize.feedback import search_feedback
from featherstone_gait.run.program import State
from featherstone_gait.run.start import standing_state
from featherstone_gait.walking import balance as law
from featherstone_gait.walking.cost import WalkingCost
from featherstone_gait.walking.cost_in_worlds import CostInWorlds, in_worlds
from featherstone_gait.walking.disturbed import pushes_survived, rough_field, walk_far
from featherstone_gait.walking.feedback import (
    BIOLOID,
    NONE,
    BalancedWalk,
    Feedback,
    Imu,
    add_feedback,
    balanced,
    feedback_of,
    generic_feedback,
    read_walk,
    size_of,
)
from featherstone_gait.walking.gait import Gait, mirror_of
from featherstone_gait.walking.motion import Motion, motion_of, read_motion

BALANCED = Path(__file__).parents[2] / "robots" / "humanoid" / "balanced_gait.npz"
STORED = Path(__file__).parents[2] / "robots" / "humanoid" / "optimized_gait.npz"
QUIET = Imu(gyroscope_noise=0.0, gyroscope_offset=0.0, accelerometer_noise=0.0, accelerometer_offset=0.0)
SOME = Feedback(ankle=2.0, foot=0.5, hip_rate=0.05, hasten=5.0, wait=10.0, quiet=0.006, heading=1.5)


@pytest.fixture(scope="module")
def scene():
    return compile_scene(load_robot("humanoid", locked="simplified"), "mipsd", Ground(), "midpoint", 1e-3)


@pytest.fixture(scope="module")
def walk(scene):
    motion = read_motion(STORED, scene.model.joint_names)
    return balanced(scene, motion, SOME, mirror=mirror_of(scene.model))


def gait_of(scene):
    """The stored gait, and its start."""
    with np.load(STORED) as arrays:
        names = tuple(arrays["joint_names"].tolist())
        return Gait(names, arrays["poses"], float(arrays["period"]), mirror_of(scene.model)), arrays["start"]


def run(scene, walk, strides=4, act=True, **how):
    reference = walk.reference(strides)
    acts = walk.controller(scene, how.pop("seed", 0)) if act else None
    state = standing_state(scene, reference.values[0], allow_limit_violation=True)
    return simulate(scene, walk.begin(strides), state, reference, controller=acts, estimate_error=False, **how)


def sensed(walk, scene, imu, ticks, seed=0, tilt=(0.0, 0.0), spin=(0.0, 0.0, 0.0), q=0.0, qd=0.0):
    """The controller's memory after so many ticks of a trunk with roll and pitch [rad] that turns as told [rad/s].

    The joints are at q + t qd.
    """
    memory = replace(walk, imu=imu).memory(scene, seed)
    command, empty = np.zeros((scene.tree.n, 2)), np.empty(0)
    (a, b), (c, d) = [(math.cos(0.5 * x), math.sin(0.5 * x)) for x in tilt]
    base_q = np.array([0.0, 0.0, 0.3, c * a, c * b, d * a, -d * b])
    state = State(*[empty] * len(State._fields))._replace(
        base_q=base_q, base_qd=np.array([0.0, 0.0, 0.0, *spin]), base_qdd=np.zeros(6)
    )
    for k in range(ticks):
        angles = np.zeros(scene.tree.n) + q + 0.01 * k * qd
        law.balance(0.01 * k, state._replace(q=angles), command, command, memory)
    return memory


@pytest.mark.parametrize(("roll", "pitch"), [(0.2, 0.0), (0.0, 0.15), (-0.1, -0.2)])
def test_a_trunk_at_rest_is_seen_to_lean_as_it_does(walk, scene, roll, pitch):
    memory = sensed(walk, scene, QUIET, 300, tilt=(roll, pitch))
    up = memory[law.UP : law.UP + 3]
    # R = R_y(pitch) R_x(roll): the third row of it is where up is in the trunk's axes.
    expected = (-math.sin(pitch), math.cos(pitch) * math.sin(roll), math.cos(pitch) * math.cos(roll))
    assert np.abs(up - expected).max() < 1e-9


@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 0.0), (0.15, -0.2)])
def test_the_center_of_mass_and_its_speed_are_seen_from_both_soles(walk, scene, roll, pitch):
    """As the dynamics have them, with other angles in each joint; a second later the rate has settled to 1e-9."""
    rng = np.random.default_rng(5)
    q, qd = rng.uniform(-0.4, 0.4, (2, scene.tree.n))
    memory = sensed(walk, scene, QUIET, 300, tilt=(roll, pitch), q=q, qd=0.01 * qd)
    (a, b), (c, d) = [(math.cos(0.5 * x), math.sin(0.5 * x)) for x in (roll, pitch)]
    base = [0.0, 0.0, 0.0, c * a, c * b, d * a, -d * b]

    def seen(t):
        """Center of mass less sole (2, 2) [m]: heights and the axis ahead as for a trunk whose x axis points ahead."""
        state = np.concatenate([base, q + 0.01 * t * qd])
        points = contact_positions(scene.model, state).reshape(2, 4, 3)
        return (center_of_mass(scene.model, state) - points.mean(axis=1))[:, :2]

    last = 0.01 * (299 - 2)  # the readings are two ticks old
    assert np.abs(memory[law.FROM : law.FROM + 4].reshape(2, 2) - seen(last)).max() < 1e-9
    speed = (seen(last) - seen(last - 0.01)) / 0.01
    assert np.abs(memory[law.SPEED : law.SPEED + 4].reshape(2, 2) - speed).max() < 1e-5
    assert np.abs(speed).max() > 1e-4


def test_encoders_tell_whole_steps(walk, scene):
    exact, coarse = (sensed(walk, scene, replace(QUIET, encoder=x), 1, q=0.0149)[law.LINE + 6] for x in (0.0, 0.01))
    assert (exact, coarse) == pytest.approx((0.0149, 0.01), abs=1e-15)


def test_heading_is_the_integral_of_the_gyroscope_less_its_delay(walk, scene):
    imu = replace(QUIET, delay=0.05)
    memory = sensed(walk, scene, imu, 200, spin=(0.0, 0.0, 0.3))
    assert memory[law.HEADING] == pytest.approx(0.3 * 0.01 * (200 - 5), abs=1e-12)


def test_heading_drifts_with_the_gyroscopes_offset(walk, scene):
    memory = sensed(walk, scene, replace(QUIET, gyroscope_offset=0.01), 500, seed=3)
    offset = memory[law.OFFSETS + 2]
    assert offset != 0.0
    assert memory[law.HEADING] == pytest.approx(offset * 5.0, rel=0.05)  # but for the delay, and up that is off


def test_noise_has_the_deviation_that_is_told(walk, scene):
    imu = replace(QUIET, gyroscope_noise=0.02, delay=0.0)
    readings = np.array([sensed(walk, scene, imu, 1, seed)[law.LINE] for seed in range(1000, 1500)])
    # Of 500 draws the deviation is known to 3.2 % (one standard error), the mean to 0.02 / sqrt(500).
    assert readings.std() == pytest.approx(0.02, rel=0.09)
    assert abs(readings.mean()) < 4 * 0.02 / math.sqrt(500)


def test_without_gains_the_gait_is_played_as_it_is(walk, scene):
    none = replace(walk, feedback=Feedback())
    plain, played = run(scene, walk, act=False, record=("base_q",)), run(scene, none, record=("base_q",))
    assert np.abs(plain["base_q"] - played["base_q"]).max() < 1e-9


@pytest.mark.long
def test_lanes_and_seeds(walk, scene):
    """The same bits alone and in lanes, where each run has its own sensors; other seeds are other runs."""
    reference, end = walk.reference(2), walk.begin(2)
    state = standing_state(scene, reference.values[0], allow_limit_violation=True)
    acts = [walk.controller(scene, seed) for seed in range(5)]
    many = simulate_batch(
        [scene] * 5, end, [state] * 5, [reference] * 5, controller=acts, record=("q",), estimate_error=False
    )
    alone = run(scene, walk, 2, seed=3, record=("q",))
    assert alone.final.tobytes() == many[3].final.tobytes()
    assert len({one.final.tobytes() for one in many}) == 5
    push = Push(scene.model.root, (1.0, 2.0, 0.0), (0.0,) * 3, (0.0,) * 3, 2.0, 2.1)  # lanes in step
    many = simulate_batch(
        [scene] * 5, end, [state] * 5, [reference] * 5, controller=acts, pushes=[push], record=("q",),
        estimate_error=False,
    )  # fmt: skip
    assert run(scene, walk, 2, seed=3, record=("q",), pushes=[push]).final.tobytes() == many[3].final.tobytes()


def test_what_is_called_in_python_does_what_is_compiled(walk, scene):
    """The function by itself, fed with what a run passed through, asks for the voltages that the servos had there."""
    found = run(scene, walk, 2, record=("q", "base_q", "base_qd", "base_qdd", "voltage"))
    memory, empty = walk.memory(scene), np.empty(0)
    servos = [scene.model.servos[name] for name in scene.model.joint_names]
    gain, most = (np.array(x) for x in zip(*((one.controller.Kp, one.voltage_limit) for one in servos)))
    command = np.zeros((scene.tree.n, 2))
    for k in range(len(found["time"]) - 1):
        seen = {name: found[name][k] for name in ("base_q", "base_qd", "base_qdd", "q")}
        if k == 0:  # before the first step nothing is known of accelerations; their record is that of an instant later
            seen["base_qdd"] = np.zeros_like(seen["base_qdd"])
        law.balance(0.01 * k, State(*[empty] * len(State._fields))._replace(**seen), command, command, memory)
        volts = np.clip(gain * (command[:, 0] - found["q"][k]), -most, most)
        assert np.abs(volts - found["voltage"][k]).max() < 1e-9


def test_feedback_keeps_a_robot_up_that_falls_without(scene):
    """Over six strides across slopes, down to the left and to the right."""
    walk, fallen = read_walk(BALANCED, scene.model.joint_names), {False: 0, True: 0}
    for degrees in (-3.0, -2.5, -1.5, -0.5, 0.5, 1.5, 2.5, 3.0):
        there = scene.recompiled(ground=Ground(slope=math.radians(degrees), heading=0.5 * math.pi))
        for act in fallen:
            fallen[act] += run(there, walk, 6, act, record=()).status == "fell"
    assert fallen[True] < fallen[False]


@pytest.mark.long
def test_a_slope_rough_ground_and_the_heading_over_a_hundred_strides(scene):
    walk = read_walk(BALANCED, scene.model.joint_names)
    plain = walk_far(scene, walk, feedback=False)
    grounds = [None, *(Ground(slope=math.radians(x)) for x in (-3.0, 3.0)), Ground(field=rough_field(3e-3))]
    found = [walk_far(scene, walk, ground) for ground in grounds]
    assert all(one.walked for one in found)
    assert max(one.heading for one in found) < math.radians(10.0)
    assert found[0].energy < 1.1 * plain.energy
    assert not walk_far(scene, walk, grounds[2], feedback=False).walked


@pytest.mark.long
def test_larger_pushes_are_survived(scene):
    walk = read_walk(BALANCED, scene.model.joint_names)
    with_it, without = (pushes_survived(scene, walk, 4, feedback=on) for on in (True, False))
    assert with_it.mean() > 0.58  # [N s], of 0.44 for a gait that walks without feedback
    assert with_it.mean() > 2.0 * without.mean()


@pytest.mark.long
def test_a_search_finds_better_feedback_and_the_same_again(scene, walk):
    cost = in_worlds(WalkingCost(scene, *gait_of(scene)), 2)
    found = search_feedback(cost, first=Feedback(heading=1.0), poses=False, iterations=8, seed=1)
    again = search_feedback(cost, first=Feedback(heading=1.0), poses=False, iterations=8, seed=1)
    assert found.fun < found.history["f"][0]
    assert found.x.tobytes() == again.x.tobytes()
    both = search_feedback(cost, iterations=2)
    assert both.x_poses.shape == cost.gait.to_vector().shape
    assert both.fun <= both.history["f"][0]


def test_a_file_keeps_the_feedback(walk, scene, tmp_path):
    path = tmp_path / "gait.npz"
    path.write_bytes(STORED.read_bytes())
    assert isinstance(read_walk(path), Motion)
    add_feedback(path, walk)
    found = read_walk(path, scene.model.joint_names)
    assert isinstance(found, BalancedWalk)
    assert found.digest() == walk.digest()
    assert found.memory(scene).tobytes() == walk.memory(scene).tobytes()
    other = replace(walk, motion=replace(walk.motion, stride=walk.motion.stride + 0.1))
    with pytest.raises(ValueError, match=r"gait\.npz: .* another gait"):
        add_feedback(path, other)


def test_gains_belong_to_lengths_and_times(scene):
    big, length = SOME.scaled(4.0), 4.0
    time = math.sqrt(length)
    groups = [length, length, 1.0 / time, length, length, 1.0 / length, 1.0]  # by what a robot 4 times as large has
    np.testing.assert_allclose(big.to_vector() * groups, SOME.to_vector(), rtol=1e-15)
    np.testing.assert_allclose(generic_feedback(scene.model).to_vector(), BIOLOID.to_vector(), rtol=1e-3)
    np.testing.assert_allclose(size_of(scene.model), 1.0, rtol=1e-3)
    with pytest.raises(ValueError, match="length is 0"):
        SOME.scaled(0.0)


def test_the_same_pushes_are_as_hard_for_a_robot_twice_as_large(scene):
    model, twice = scene.model, lambda place: tuple(2.0 * x for x in place)
    large = replace(
        model,
        links=tuple(replace(x, mass=8.0 * x.mass, center_of_mass=twice(x.center_of_mass)) for x in model.links),
        joints=tuple(replace(x, xyz=twice(x.xyz)) for x in model.joints),
        contacts=tuple(replace(x, position=twice(x.position)) for x in model.contacts),
        keyframes={},
    )
    ratio = np.array(size_of(large)) / size_of(replace(model, keyframes={}))
    np.testing.assert_allclose(ratio, [2.0, 8.0 * math.sqrt(2.0)], rtol=1e-9)  # mass times a speed, sqrt(g l)


def test_gains_of_nought_cost_what_the_gait_by_itself_does(scene):
    cost = replace(WalkingCost(scene, *gait_of(scene)), strides=2)
    motion = motion_of(cost.gait, cost.start, cost.blend_strides)
    silent = balanced(scene, motion, NONE, mirror=mirror_of(scene.model))
    here = CostInWorlds(cost, [scene], np.zeros((1, len(scene.model.joint_names))))
    x = cost.gait.to_vector()
    ((found,),), ((own,),) = here.measure([silent]), here.measure([x])
    assert found.status == own.status == "ok"
    found_of, own_of = ((one.energy, one.distance) for one in (found, own))
    assert found_of == pytest.approx(own_of, rel=1e-9)  # the controller interpolates the references itself
    with pytest.raises(ValueError, match="some gaits have feedback and some have not"):
        here.measure([x, silent])


def test_bad_numbers_are_refused(walk, scene):
    with pytest.raises(ValueError, match="hip_rate is nan"):
        Feedback(hip_rate=math.nan)
    with pytest.raises(ValueError, match="quiet is -1"):
        Feedback(quiet=-1.0)
    with pytest.raises(ValueError, match="delay is 1"):
        Imu(delay=1.0)
    with pytest.raises(ValueError, match="whole ticks"):
        replace(walk, imu=Imu(delay=0.013)).memory(scene)
    with pytest.raises(ValueError, match="two legs"):
        balanced(compile_scene(load_robot("arm7"), None), walk.motion)
    with pytest.raises(ValueError, match="gains"):
        feedback_of(np.zeros(len(fields(Feedback)) + 1))
    with pytest.raises(ValueError, match="height"):
        rough_field(-1.0)


@pytest.mark.long
@pytest.mark.parametrize("degrees", [-3.0, 3.0])
def test_a_robot_that_leans_uphill_walks_across_a_slope(scene, degrees):
    walk, roll = read_walk(BALANCED, scene.model.joint_names), math.radians(degrees)
    ground = Ground(slope=roll, heading=0.5 * math.pi)
    far = walk_far(scene, walk.leaning(scene.model, roll), ground)
    assert far.walked
    assert far.heading < math.radians(15.0)
    assert walk.leaning(scene.model, 0.0).motion.digest() == walk.motion.digest()
    if degrees < 0.0:  # downhill to the left the gait for level ground falls
        assert not walk_far(scene, walk, ground, 5).walked
