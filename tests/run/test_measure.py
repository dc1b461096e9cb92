"""Sensors: lines on the floor by closed forms, infrared curves, noise, rate and delay, the same bits anywhere."""

import math
from dataclasses import replace

import numpy as np
import pytest

from featherstone_gait import (
    ContactSensor,
    FloorLine,
    ForceTorqueSensor,
    Ground,
    LineSensor,
    Placed,
    RangeSensor,
    Reference,
    SampledSensor,
    SceneModel,
    Session,
    compile_scene,
    forward_kinematics,
    load_robot,
    measure,
    simulate,
    simulate_batch,
)

DOWN = RangeSensor("world", [[0.0, 0.0, -1.0]], position=(0.0, 0.0, 0.5), name="down")


@pytest.fixture(scope="module")
def arm():
    scene = compile_scene(load_robot("ax12_arm"), "mipsd", integrator="implicit_euler", timestep=1e-3)
    return on(scene, FloorLine(((0.2, -1.0), (0.2, 1.0)), 0.05), height=-1.0)


def on(scene, *lines, **ground):
    """Return the scene over a ground with these lines, which sensors see and nothing meets."""
    return replace(scene, options=scene.options._replace(ground=Ground(lines=lines, **ground)))


def channels(q, interval=0.01):
    """Channels of a made-up run of the arm."""
    return {"time": interval * np.arange(len(q)), "q": np.reshape(q, (-1, 1))}


def dark(scene, sensor):
    return measure(scene, channels([0.0]), sensor)[0]


def segment(distance, radius):
    """The share of a disc that lies beyond a straight edge at a distance from its center, negative if it is inside."""
    half = math.acos(min(max(distance / radius, -1.0), 1.0))
    return (half - math.sin(half) * math.cos(half)) / math.pi


# ------------------------------------------------------------------------------------------------ lines on the floor


@pytest.mark.nojit
@pytest.mark.parametrize("turn", [0.0, 0.7, 2.5])
def test_a_spot_that_crosses_an_edge_is_dark_by_the_segment_of_its_disc(arm, turn):
    """Cross the edge of a wide line, which lies at any angle, in 13 places."""
    ahead, left = np.array([math.cos(turn), math.sin(turn)]), np.array([-math.sin(turn), math.cos(turn)])
    line = FloorLine([0.5 * left - 2 * ahead, 0.5 * left + 2 * ahead], 1.0)  # from 0 to 1 m on the left
    at = np.linspace(-0.012, 0.012, 13)
    places = [(*(0.3 * ahead + y * left), 0.1) for y in at]
    found = dark(on(arm, line), LineSensor("world", places, 0.01))
    np.testing.assert_allclose(found, [segment(-y, 0.01) for y in at], rtol=0, atol=1e-13)


@pytest.mark.nojit
def test_what_lines_cover_together_counts_once(arm):
    """Compare the area within a wide spot with that of figures whose area is known."""
    w, radius = 0.06, 3.0
    spot = LineSensor("world", ((0.5, 0.5, 1.0),), radius)
    line, cross = FloorLine(((0.0, 0.5), (1.0, 0.5)), w), FloorLine(((0.5, 0.0), (0.5, 1.0)), w)
    corner = FloorLine(((0.0, 0.0), (1.0, 0.0), (1.0, 1.0)), w)
    square = FloorLine(((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0), (0.0, 0.0)), w)
    for lines, area in (
        ((), 0.0),
        ((line,), w),
        ((line, line, FloorLine(((0.2, 0.5), (0.4, 0.5)), w)), w),
        ((line, cross), 2 * w - w * w),
        ((corner,), 2 * w),
        ((FloorLine(corner.points[::-1], w),), 2 * w),
        ((square,), 4 * w),
        ((square, corner, line), 5 * w - w * w),
    ):
        assert dark(on(arm, *lines), spot)[0] * math.pi * radius**2 == pytest.approx(area, abs=1e-12)


@pytest.mark.nojit
@pytest.mark.parametrize("turn", [0.4, 2.5, 5.774538558746286])
def test_a_line_that_doubles_back_is_as_dark_as_without_the_way_back(arm, turn):
    """At most angles rounding leaves a turn of 1e-17 between both ways."""
    ahead = np.array([math.cos(turn), math.sin(turn)])
    spots = LineSensor("world", [(*(x * ahead), 0.1) for x in (0.19, 0.25, 0.3)], 0.1)
    wanted, *others = (
        dark(on(arm, FloorLine([tuple(x * ahead) for x in along], 0.05)), spots)
        for along in ((0.0, 0.3), (0.0, 0.3, 0.12), (0.0, 0.1, 0.3))
    )
    for found in others:
        np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-12)


@pytest.mark.nojit
def test_points_are_dark_or_not_and_what_returns_no_light_is_dark(arm):
    scene = on(arm, FloorLine(((0.0, 0.0), (1.0, 0.0)), 0.1))
    points = LineSensor("world", ((0.5, 0.04, 0.3), (0.5, 0.06, 0.3), (-0.01, 0.0, 0.3)), 0.0)
    assert dark(scene, points).tolist() == [1.0, 0.0, 0.0]
    assert dark(scene, replace(points, reach=0.2)).tolist() == [1.0] * 3
    assert dark(scene, replace(points, direction=(0.0, 0.0, 1.0))).tolist() == [1.0] * 3
    slanted = replace(points, positions=((0.5, 0.3, 0.3),), direction=(0.0, -1.0, -1.0))
    assert dark(scene, slanted).tolist() == [1.0]
    assert dark(on(arm, FloorLine(((0.0, 0.0), (1.0, 0.0)), 0.1), height=0.2), slanted).tolist() == [0.0]


def test_a_sensor_on_a_link_sees_the_line_that_it_passes(arm):
    model = arm.model
    tip = model.links[-1].name
    sensor = LineSensor(tip, ((0.05, 0.0, 0.0),), 0.03, direction=(1.0, 0.0, 0.0))
    run = simulate(arm, 0.3, reference=Reference([0.0], [[0.6]]), record=("q", sensor), estimate_error=False)
    assert {*run} == {"time", "q", "line"}
    poses = forward_kinematics(model, run["q"], tip)
    start = poses.position + 0.05 * poses.rotation[..., 0]
    along = poses.rotation[..., 0]
    ground = along[:, 2] < -1e-6
    far = (-1.0 - start[:, 2]) / np.where(ground, along[:, 2], -1.0)
    x = start[:, 0] + far * along[:, 0]
    wanted = [segment(0.175 - at, 0.03) - segment(0.225 - at, 0.03) if met else 1.0 for at, met in zip(x, ground)]
    np.testing.assert_allclose(run["line"][:, 0], wanted, rtol=0, atol=1e-12)


@pytest.mark.nojit
def test_an_infrared_sensor_gives_the_voltage_of_its_curve(arm):
    """A wall, here the ground, at distances of the table, between them and beyond; below the peak the voltage falls."""
    curve = ((0.02, 1.2), (0.06, 3.1), (0.1, 2.3), (0.3, 0.9), (0.8, 0.4))
    for distance, volts in ((0.06, 3.1), (0.2, 1.6), (0.8, 0.4), (2.0, 0.4), (0.04, 2.15), (0.0, 1.2)):
        sensor = RangeSensor.infrared("world", curve, position=(0.0, 0.0, distance), rpy=(0.0, 0.5 * math.pi, 0.0))
        assert dark(on(arm), sensor)[0] == pytest.approx(volts, abs=1e-12)
    distances = np.linspace(0.06, 0.8, 50)
    np.testing.assert_allclose(sensor.distance(sensor.voltage(distances)), distances, rtol=1e-12)
    assert sensor.distance([0.0, 9.0]).tolist() == [0.8, 0.06]


# ------------------------------------------------------------------------------------------------ noise, rate, delay


def whiteness(x):
    """The largest correlation of a series with itself, 1 to 20 samples later."""
    x = x - x.mean()
    return max(abs(float((x[:-k] * x[k:]).mean() / x.var())) for k in range(1, 21))


@pytest.mark.nojit
def test_noise_has_its_deviation_and_is_white(arm):
    n, deviation = 120000, 0.02
    run = channels(np.zeros(n))
    sensor = SampledSensor("q", noise=deviation, seed=3)
    draws = {k: measure(arm, run, replace(sensor, seed=seed), k % 2)[:, 0] for k, seed in ((0, 3), (1, 3), (2, 4))}
    draws[3] = measure(arm, run, replace(sensor, name="other"))[:, 0]
    for x in draws.values():
        assert x.std() == pytest.approx(deviation, rel=5.0 / math.sqrt(2 * n))
        assert abs(x.mean()) < 5.0 * deviation / math.sqrt(n)
        assert whiteness(x) < 5.0 / math.sqrt(n)
        assert ((x / deviation) ** 4).mean() == pytest.approx(3.0, rel=0.05)  # of a normal distribution: 5 deviations
    assert np.abs(np.corrcoef([*draws.values()]) - np.eye(4)).max() < 5.0 / math.sqrt(n)
    both = SampledSensor(LineSensor("world", ((0.0, 0.0, 1.0), (0.1, 0.0, 1.0))), noise=(0.1, 0.3))
    spread = measure(arm, channels(np.zeros(4000)), both).std(axis=0)
    np.testing.assert_allclose(spread, [0.1, 0.3], rtol=0.1)


@pytest.mark.nojit
@pytest.mark.parametrize("first", [0, 13])
def test_answers_stand_between_measurements_and_come_late_by_the_delay(arm, first):
    """Of a ramp, measured at 20 Hz and answered 0.03 s later, also in a run that goes on from another."""
    ramp = channels(0.1 * np.arange(60))
    ramp["time"] += 0.01 * first
    found = measure(arm, ramp, SampledSensor("q", rate=20.0, delay=0.03))[:, 0]
    shown = [max(((k + first - 3) // 5) * 5 - first, 0) for k in range(60)]  # records that the answers are of
    np.testing.assert_array_equal(found, 0.1 * np.array(shown))
    assert all((k + first - 3) % 5 == 0 for k in 1 + np.flatnonzero(np.diff(found)))
    exact, late = (measure(arm, ramp, SampledSensor("q", noise=0.1, delay=d)) for d in (0.0, 0.07))
    np.testing.assert_array_equal(late[7:], exact[:-7])


def test_a_session_answers_what_runs_have_alone_and_in_a_batch(arm):
    sampled = SampledSensor(DOWN, noise=0.01, rate=50.0, delay=0.03, seed=7, name="late")
    watched = (sampled, LineSensor("world", ((0.2, 0.0, 0.0),), name="dark"), SampledSensor("encoders", noise=1e-3))
    session = Session(arm, 9, observe=("q", *watched), record=("q", *watched), threads=1)
    rng, ticks = np.random.default_rng(0), 9
    actions = rng.uniform(-0.3, 0.3, (ticks, 9, 1))
    seen = [{name: x.copy() for name, x in session.observe().items()}]
    for action in actions:
        seen.append({name: x.copy() for name, x in session.step(action).items()})
    references = [Reference(np.arange(ticks) * session.tick, actions[:, k], "hold") for k in range(9)]
    how = {"estimate_error": False, "record": ("q", *watched)}
    runs = simulate_batch(arm, ticks * session.tick, references=references, **how)
    alone = simulate(arm, ticks * session.tick, reference=references[5], estimate_error=False)
    for k, run in enumerate(runs):
        own = session.trajectory(k)
        assert {*run} == {*own} == {"time", "q", "late", "dark", "sampled encoders"}
        for name in own:
            assert np.array_equal(own[name], run[name])
            assert name == "time" or np.array_equal([one[name][k] for one in seen], run[name])
    for sensor in watched:
        assert np.array_equal(measure(arm, alone, sensor, 5), runs[5][sensor.name])
    assert len({float(one["late"][3, 0]) for one in seen}) == 4  # (k - 3) // 2 of k = 0 to 9


def test_a_session_goes_on_with_its_answers(arm, tmp_path):
    """Copies, files and resets of one robot keep noise and delay."""
    sampled = SampledSensor("q", noise=0.01, rate=50.0, delay=0.04)
    session = Session(arm, 2, observe=(sampled,))
    action = np.array([[0.2], [-0.2]])
    name = "sampled q"
    first = [session.observe()[name].copy(), *(session.step(action)[name].copy() for _ in range(7))]
    session.reset(np.array([True, False]))
    other = session.copy()
    session.save(tmp_path / "kept.npz")
    later = [session.observe()[name].copy(), *(session.step(action)[name].copy() for _ in range(7))]
    assert np.array_equal([one[0] for one in later], [one[0] for one in first])
    assert np.array_equal([other.observe()[name], *(other.step(action)[name].copy() for _ in range(7))][1:], later[1:])
    fresh = Session(arm, 2, observe=(sampled,))
    fresh.restore(tmp_path / "kept.npz")
    assert np.array_equal([fresh.step(action)[name].copy() for _ in range(7)], later[1:])
    with pytest.raises(ValueError, match="another scene"):
        Session(arm, 2, observe=(replace(sampled, noise=0.02),)).restore(tmp_path / "kept.npz")


def two_arms(arm, *sensors):
    """A scene of two arms, each with these sensors."""
    model = replace(arm.model, sensors=sensors)
    return SceneModel("two", [Placed(model, name, (k, 0.0, 0.0)) for k, name in enumerate("ab")])


@pytest.mark.nojit
def test_a_sampled_sensor_names_another_sensor_of_its_robot(arm):
    """By its own name it reads that sensor with noise, alone and in a scene of two robots."""
    noisy = SampledSensor("down", noise=0.01, seed=2)
    alone = replace(arm, model=replace(arm.model, sensors=(DOWN, noisy)))
    run = channels(np.zeros(400))
    exact, read = (measure(alone, run, name) for name in ("down", "sampled down"))
    assert (read - exact).std() == pytest.approx(0.01, rel=0.2)
    np.testing.assert_array_equal(read, measure(arm, run, SampledSensor(DOWN, noise=0.01, seed=2, name="sampled down")))
    scene = compile_scene(two_arms(arm, DOWN, noisy), gearbox=None)
    both = {"time": run["time"], "q": np.zeros((400, 2)), "base_q": np.zeros((400, 0, 7))}
    for name in "ab":
        wanted = SampledSensor(DOWN, noise=0.01, seed=2, name=f"{name}/sampled down")
        np.testing.assert_array_equal(measure(scene, both, wanted.name), measure(scene, both, wanted))
    SceneModel("two", two_arms(arm, DOWN).members, sensors=[SampledSensor("b/down", name="late")])


@pytest.mark.nojit
def test_sensors_are_called_otherwise_than_channels_and_each_other(arm):
    """What is recorded under the name of a channel is the channel, of a built-in sensor that sensor."""
    run = channels(np.zeros(40))
    model = replace(arm.model, sensors=(SampledSensor("encoders", noise=1.0),))
    scene = replace(arm, model=model)
    assert measure(scene, run, "sampled encoders").std() > 0.5
    assert not measure(scene, run, "encoders").any()
    encoders, other = SampledSensor("q", name="encoders"), SampledSensor("q", name="other")
    for make, message in (
        (lambda: replace(model, sensors=(encoders,)), "a sensor is called 'encoders'"),
        (lambda: SceneModel("two", two_arms(arm).members, sensors=(encoders,)), "a sensor is called 'encoders'"),
        (lambda: replace(model, sensors=(replace(DOWN, name="time"),)), "a sensor is called 'time'"),
        (lambda: Session(arm, observe=("q", SampledSensor("q", name="q"))), "observe: a sensor is called 'q'"),
        (lambda: Session(arm, observe=(DOWN, replace(DOWN, reach=1.0))), "observe: two have the same name"),
        (lambda: simulate(arm, 0.1, record=(encoders,)), "record: a sensor is called 'encoders'"),
        (lambda: Session(arm, observe=(other, replace(other, seed=1))), "two have the same name"),
        (lambda: replace(model, sensors=(SampledSensor("nonsense"),)), "is of 'nonsense'; give a channel, or one of"),
        (lambda: replace(model, sensors=(other, SampledSensor("other"))), "is of 'other'"),
        (lambda: replace(model, sensors=(SampledSensor("sole_forces"),)), "is of 'sole_forces'"),
        (lambda: SceneModel("two", two_arms(arm, DOWN).members, sensors=[SampledSensor("down", name="x")]), "'down'"),
    ):
        with pytest.raises(ValueError, match=message):
            make()


def test_wrong_sensors_are_named(arm):
    run = channels(np.zeros(4))
    for make, message in (
        (lambda: LineSensor("world", ((0.0, 0.0),)), r"positions are"),
        (lambda: LineSensor("world", direction=(0.0, 0.0, 0.0)), "has no length"),
        (lambda: LineSensor("world", radius=-1.0), "radius is -1"),
        (lambda: FloorLine(((0.0, 0.0),)), "points has 1"),
        (lambda: FloorLine(((0.0, 0.0), (0.0, 0.0))), "points 0 and 1 are both"),
        (lambda: FloorLine(((0.0, 0.0), (1.0, 0.0)), 0.0), "width is 0"),
        (lambda: Ground(lines=[((0.0, 0.0), (1.0, 0.0))]), "give FloorLine"),
        (lambda: RangeSensor.infrared("world", ((0.2, 1.0), (0.1, 2.0))), "rising"),
        (lambda: RangeSensor.infrared("world", []), "curve is empty"),
        (lambda: RangeSensor.infrared("world", ((-0.1, 1.0), (0.1, 2.0))), "from 0 on"),
        (lambda: replace(arm.model, sensors=(ForceTorqueSensor("world"),)), "is on 'world'; links: "),
        (lambda: replace(arm.model, sensors=(ContactSensor("world"),)), "is on 'world'; links: "),
        (lambda: measure(arm, run, SampledSensor(DOWN, noise=(0.0, 0.0, 0.0))), "noise has 3 entries"),
        (lambda: DOWN.voltage(0.1), "make it with a curve"),
        (lambda: SampledSensor("q", noise=-1.0), "noise is -1"),
        (lambda: SampledSensor("q", rate=0.0), "rate is 0"),
        (lambda: SampledSensor("q", delay=-0.1), "delay is -0.1"),
        (lambda: SampledSensor(3.0), "give a sensor"),
        (lambda: measure(arm, run, SampledSensor("q", rate=30.0)), "not a whole number of records of 0.01 s"),
        (lambda: measure(arm, run, SampledSensor("q", delay=0.005)), "its delay of 0.005 s"),
        (lambda: measure(arm, run, SampledSensor("q", noise=(0.1, 0.2))), "noise has 2 entries"),
        (lambda: measure(arm, run, "lidar"), "no channel or sensor 'lidar'"),
        (lambda: measure(arm, run, SampledSensor("sole_forces")), "several arrays"),
        (lambda: measure(arm, run, LineSensor("foot")), "is on 'foot'; links: "),
        (lambda: measure(arm, {"time": run["time"]}, "encoders"), r"channels \['q'\] were not recorded"),
        (lambda: simulate(arm, 0.1, record=(DOWN, replace(DOWN, reach=1.0))), "two have the same name"),
        (lambda: simulate(arm, 0.1, record=("sole_forces",)), "several arrays"),
        (lambda: Session(arm, observe=(SampledSensor("q", rate=77.0),)), "not a whole number of ticks"),
    ):
        with pytest.raises((ValueError, TypeError), match=message):
            make()
