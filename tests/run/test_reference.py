"""References between, before and after their knots, and through a servo's controller."""

import numba
import numpy as np
import pytest
from scenes import arm_scene, with_controller
from scipy.interpolate import CubicSpline, make_interp_spline

from featherstone_gait.core.compile.jit import JIT
from featherstone_gait.core.step.signals import evaluate
from featherstone_gait.robot_file import load_robot
from featherstone_gait.run.reference import Reference
from featherstone_gait.run.simulate import simulate

TIMES = np.array([-0.3, 0.0, 0.25, 1.0, 1.1, 2.0])
VALUES = np.random.default_rng(1).normal(size=(6, 3))
LOOP = np.vstack([VALUES[:-1], VALUES[:1]])
INSIDE = np.linspace(-0.3, 2.0, 301)[:-1]
EVERYWHERE = np.concatenate([[-5.0, -0.31], INSIDE, TIMES, [2.01, 7.0]])

pytestmark = pytest.mark.nojit


@numba.njit
def sweep(knots, times, out):
    for k in range(len(times)):
        evaluate(knots, times[k], out[k])


def signal(reference, times):
    """Values and rates (samples, n) at the times."""
    out = np.zeros((len(times), reference.values.shape[1], 2))
    sweep(reference.knots(), np.asarray(times, dtype=float), out)
    return out[..., 0], out[..., 1]


def within(times):
    return (times >= TIMES[0]) & (times <= TIMES[-1])


def test_linear_is_that_of_numpy_and_keeps_its_ends():
    values, rates = signal(Reference(TIMES, VALUES), EVERYWHERE)
    expected = np.stack([np.interp(EVERYWHERE, TIMES, column) for column in VALUES.T], axis=1)
    np.testing.assert_allclose(values, expected, rtol=0, atol=1e-14)
    slopes = np.diff(VALUES, axis=0) / np.diff(TIMES)[:, None]
    k = np.clip(np.searchsorted(TIMES, EVERYWHERE, side="right") - 1, 0, 4)
    np.testing.assert_allclose(rates, np.where(within(EVERYWHERE)[:, None], slopes[k], 0.0), rtol=0, atol=1e-13)


def test_hold_keeps_each_value_until_the_next_knot():
    values, rates = signal(Reference(TIMES, VALUES, "hold"), EVERYWHERE)
    k = np.clip(np.searchsorted(TIMES, EVERYWHERE, side="right") - 1, 0, 5)
    assert np.array_equal(values, VALUES[k])
    assert not rates.any()


def test_cubic_is_the_natural_spline_with_its_rate():
    values, rates = signal(Reference(TIMES, VALUES, "cubic"), EVERYWHERE)
    spline = make_interp_spline(TIMES, VALUES, k=3, bc_type="natural")
    clipped = np.clip(EVERYWHERE, TIMES[0], TIMES[-1])
    np.testing.assert_allclose(values, spline(clipped), rtol=0, atol=1e-12)
    expected = np.where(within(EVERYWHERE)[:, None], spline.derivative()(clipped), 0.0)
    np.testing.assert_allclose(rates, expected, rtol=0, atol=1e-11)


@pytest.mark.parametrize("kind", ["hold", "linear", "cubic"])
def test_a_cyclic_signal_repeats_for_ever_and_before_its_beginning(kind):
    reference = Reference(TIMES, LOOP, kind, cyclic=True)
    times = INSIDE + 1e-4  # off the knots, where a rounding error would choose the other side
    once, once_rate = signal(reference, times)
    for cycles in (-3, 1, 40):
        again, again_rate = signal(reference, times + cycles * 2.3)
        np.testing.assert_allclose(again, once, rtol=0, atol=1e-11)
        np.testing.assert_allclose(again_rate, once_rate, rtol=0, atol=1e-9)


def test_a_cyclic_cubic_is_the_periodic_spline():
    values, _ = signal(Reference(TIMES, LOOP, "cubic", cyclic=True), INSIDE)
    np.testing.assert_allclose(values, CubicSpline(TIMES, LOOP, bc_type="periodic")(INSIDE), rtol=0, atol=1e-12)


@pytest.mark.parametrize("kind", ["hold", "linear", "cubic"])
@pytest.mark.parametrize("count", [1, 2])
def test_few_knots_are_enough(kind, count):
    values, _ = signal(Reference(TIMES[:count], VALUES[:count], kind), [-1.0, TIMES[0], 5.0])
    assert np.array_equal(values, VALUES[[0, 0, count - 1]])


def test_the_caller_may_change_its_arrays_afterwards():
    times, values = TIMES.copy(), VALUES.copy()
    reference = Reference(times, values)
    times[:], values[:] = 0.0, 0.0
    assert np.array_equal(reference.times, TIMES)
    assert np.array_equal(reference.values, VALUES)


BAD = {
    "shapes do not fit": (dict(times=[0.0, 1.0], values=[[1.0]]), r"times \(2,\) and values \(1, 1\)"),
    "no knot": (dict(times=[], values=np.zeros((0, 2))), "k > 0"),
    "a row of values": (dict(times=[0.0], values=[1.0]), r"give \(k,\) and \(k, n\)"),
    "times that fall": (dict(times=[0.0, 2.0, 1.0], values=np.zeros((3, 1))), "time 1 s follows 2 s"),
    "a time twice": (dict(times=[0.0, 0.0], values=np.zeros((2, 1))), "times must rise"),
    "not a number": (dict(times=[0.0], values=[[np.nan]]), "not finite"),
    "an endless time": (dict(times=[0.0, np.inf], values=np.zeros((2, 1))), "not finite"),
    "another kind": (dict(times=[0.0], values=[[0.0]], kind="quintic"), "expected 'hold', 'linear' or 'cubic'"),
    "a cycle of one": (dict(times=[0.0], values=[[0.0]], cyclic=True), "two knots"),
    "an open cycle": (dict(times=[0.0, 1.0], values=[[0.0], [1.0]], cyclic=True), "same values at both ends"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_knots_are_refused(case):
    arguments, message = BAD[case]
    with pytest.raises(ValueError, match=message):
        Reference(**arguments)


@pytest.mark.parametrize("lag", [0.0, 0.03])
def test_the_controller_sees_the_reference_a_lag_later(lag):
    """A proportional controller's voltage tells what reference it saw."""
    arm = with_controller(load_robot("arm7"), law="pid_position", Kp=2.0, Ki=0.0, Kd=0.0, Kf=0.0, lag=lag)
    reference = Reference([0.0, 0.05, 0.1], 0.01 * np.random.default_rng(2).normal(size=(3, 7)), "cubic")
    run = simulate(arm_scene(arm), 0.1, reference=reference, record=("q", "voltage"))
    seen = run["voltage"] / 2.0 + run["q"]
    expected, _ = signal(reference, run["time"] - lag)
    resolution = arm.servos[arm.joint_names[0]].encoder_resolution
    np.testing.assert_allclose(seen[:-1], expected[:-1], rtol=0, atol=0.5 * resolution + 1e-12)


@pytest.mark.parametrize("timestep", [1e-3, 7e-4 / 7, 5e-4])
def test_a_tick_on_a_knot_sees_what_begins_there(timestep):
    """Thirds and sevenths of a second are rounded either way; the controller's ticks are whole multiples of 10 ms."""
    arm = with_controller(load_robot("arm7"), law="pid_position", Kp=2.0, Ki=0.0, Kd=0.0, Kf=0.0, lag=0.0)
    times = np.arange(30) * 0.01
    reference = Reference(times, np.repeat(0.001 * np.arange(30)[:, None], 7, axis=1), "hold")
    how = {"reference": reference, "record": ("q", "voltage"), "record_interval": 0.01}
    run = simulate(arm_scene(arm, timestep=timestep), 0.3 if JIT else 0.05, **how)
    seen = (run["voltage"] / 2.0 + run["q"])[:-1, 0]
    resolution = arm.servos[arm.joint_names[0]].encoder_resolution
    np.testing.assert_allclose(seen, 0.001 * np.arange(len(seen)), rtol=0, atol=0.5 * resolution + 1e-12)
