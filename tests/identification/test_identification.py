"""Identification recovers known servos, says how far to trust it, and reads recordings strictly."""

import math
from dataclasses import replace

import numpy as np
import pytest

from featherstone_gait.identification import (
    MOTOR_OFF,
    Recording,
    changed,
    identify,
    predict,
    prediction_error,
    read_recording,
    write_recording,
)
from featherstone_gait.robot_file import load_robot

COUNT = math.radians(300.0 / 1023.0)  # of the AX-12's encoder [rad], ROBOTIS e-manual
TRUTH = {"motor_constant": 0.0072, "viscous_friction": 0.02, "rotor_inertia": 1.5e-7}
STEP = 1e-3  # of simulation here, for data and fit alike: this is about statistics


@pytest.fixture(scope="module")
def arm():
    return load_robot("ax12_whole_arm")


@pytest.fixture(scope="module")
def exact(arm):
    """Recordings without noise of the servo with TRUTH: two motions, a fall."""
    time = 0.01 * np.arange(250)
    blank = [
        Recording("chirp", time, 0.9 * np.sin((1.2 * time) ** 2), 0.0 * time, settings={"Kp": 30.0}),
        Recording("product", time, np.sin(1.1 * time) * np.sin(4.1 * time), 0.0 * time, settings={"Kp": 30.0}),
        Recording("fall", time[:90], 0.0 * time[:90], 0.0 * time[:90] + 1.5, settings=MOTOR_OFF),
    ]
    runs = predict(changed(arm, **TRUTH), blank, timestep=STEP)
    return [Recording(r.name, r.time, r.reference, q, u, r.settings) for r, (q, u) in zip(blank, runs)]


def read(recordings, seed):
    """As an encoder shows them, with noise of half its step."""
    noise = 0.5 * COUNT
    random = np.random.default_rng(seed)
    return [
        Recording(
            r.name,
            r.time,
            r.reference,
            np.rint((r.angle + random.normal(0.0, noise, len(r.time))) / COUNT) * COUNT,
            r.voltage,
            r.settings,
        )
        for r in recordings
    ]


def errors(result):
    return np.array([math.log(result.values[name] / value) for name, value in TRUTH.items()])


# --- the estimates -----------------------------------------------------------------------------------------------


def test_exact_recordings_give_the_parameters_back(arm, exact):
    """From 5 to 50 % off.  The search ends when the cost changes by less than 1e-7 of itself, far below 1e-4 here."""
    result = identify(arm, exact, list(TRUTH), timestep=STEP)
    assert result.converged
    assert np.abs(errors(result)).max() < 1e-4
    assert result.rms.max() < 1e-6


@pytest.mark.long
def test_a_servo_that_counts_is_found_from_any_start(arm, exact):
    """Counts make the errors a staircase.  From starts that are 3 and 1/3 of the truth the fit ends at the truth."""
    counted = changed(arm, encoder_resolution=COUNT, pwm_steps=1023.0, **TRUTH)
    motions = [Recording(r.name, r.time, r.reference, r.angle, settings=r.settings) for r in exact[:2]]
    seen = [replace(r, angle=q) for r, (q, _) in zip(motions, predict(counted, motions, timestep=STEP))]
    names = ["motor_constant", "viscous_friction"]
    for factor in (3.0, 1 / 3):
        start = changed(counted, viscous_friction=factor * TRUTH["viscous_friction"])
        found = identify(start, seen, names, start_range=0.0, timestep=STEP)
        for name in names:
            assert found.values[name] == pytest.approx(TRUTH[name], rel=0.02), name


def test_voltages_alone_tell_the_gain(arm, exact):
    """With a gain that the recordings do not state."""
    motions = [Recording(r.name, r.time, r.reference, r.angle, r.voltage) for r in exact[:2]]
    result = identify(changed(arm, **TRUTH), motions, ["Kp"], timestep=STEP, voltage_weight=0.01)
    assert result.values["Kp"] == pytest.approx(30.0, rel=1e-4)


def correlated(random, count, over):
    """Noise of half an encoder count, whose correlation falls by e over a time [s]; white for 0."""
    left = math.exp(-0.01 / over) if over else 0.0
    found, fresh = np.zeros(count), random.normal(0.0, 0.5 * COUNT, count)
    found[0] = fresh[0]
    for k in range(1, count):
        found[k] = left * found[k - 1] + math.sqrt(1.0 - left * left) * fresh[k]
    return found


@pytest.mark.long
@pytest.mark.parametrize("over", [0.0, 0.05, 0.2])
def test_intervals_hold_the_truth_as_often_as_they_say(arm, exact, over):
    """With the usual options, where each first angle is noisy, and with a fall, whatever the noise's correlation.

    Of 3 x 100 intervals 95 % hold the truth, give or take 1.3 % (binomial) if the parameters' errors are independent,
    2.2 % if they are one; 88 % is three of the latter below.  Standardised errors have the spread 1; over 100 trials
    its own standard deviation is 0.07.  It is below 1, since intervals do not get narrower than those of the textbook.
    """
    start, results = changed(arm, **TRUTH), []
    for seed in range(100):
        random = np.random.default_rng(seed)
        seen = [replace(r, angle=r.angle + correlated(random, len(r.time), over)) for r in exact]
        results.append(identify(start, seen, list(TRUTH), timestep=STEP))
    inside = [[r.intervals[n][0] <= v <= r.intervals[n][1] for n, v in TRUTH.items()] for r in results]
    scores = np.array([errors(r) / r.standard_errors for r in results])
    assert np.mean(inside, axis=0).min() >= 0.88, np.mean(inside, axis=0)
    assert ((scores.std(axis=0) > 0.6) & (scores.std(axis=0) < 1.3)).all(), scores.std(axis=0)
    assert (np.abs(scores.mean(axis=0)) < 3.0 / math.sqrt(100)).all()  # no bias that the spread does not explain


@pytest.mark.long
def test_intervals_hold_for_what_an_encoder_shows(arm, exact):
    """Noise of half a count makes the rounding an independent error: of 3 x 24 intervals 95 % hold the truth."""
    start = changed(arm, **TRUTH)
    results = [identify(start, read(exact, seed), list(TRUTH), timestep=STEP) for seed in range(24)]
    inside = [[r.intervals[n][0] <= v <= r.intervals[n][1] for n, v in TRUTH.items()] for r in results]
    assert np.mean(inside) >= 0.82  # three standard deviations below, if the parameters' errors are one


def test_autocorrelated_errors_widen_the_intervals(arm, exact):
    """A slow drift of 1 deg, as of a loose mount: the textbook's interval does not know it."""
    drifting = [
        Recording(r.name, r.time, r.reference, r.angle + math.radians(1) * np.sin(5 * r.time), r.voltage, r.settings)
        for r in read(exact, 1)
    ]
    result = identify(changed(arm, **TRUTH), drifting, list(TRUTH), timestep=STEP)
    assert result.independent_samples < 0.3 * sum(len(r.time) for r in drifting)
    assert (result.standard_errors / result.textbook_errors).max() > 1.5


def test_a_parameter_without_effect_is_said_to_be_undetermined(arm, exact):
    """Inductance: its time constant of 0.6 ms is far below what readings every 10 ms through an encoder show; and a
    fall with the motor off does not contain it at all."""
    result = identify(changed(arm, **TRUTH), read(exact, 2)[2:], ["inductance"], timestep=STEP)
    assert result.undetermined == ("inductance",)
    assert "not determined" in result.summary()


@pytest.mark.long
def test_a_gain_held_out_is_predicted_as_well_as_noise_allows(arm):
    """The protocol with short motions: encoder and noise inside the control loop, another step than that of the fit."""
    truth = TRUTH | {"resistance": 9.0, "coulomb_friction": 0.03}
    servo, time = changed(arm, encoder_resolution=COUNT, **truth), 0.01 * np.arange(300)
    motions = 0.9 * np.sin(time**2), 1.4 * np.sin(np.pi * time / 6) ** 2, 1.1 * np.sin(1.1 * time) * np.sin(4.1 * time)

    def recorded(gains, starts, seed):
        blank = [Recording("motion", time, each, 0 * time, settings={"Kp": Kp}) for Kp in gains for each in motions]
        still = 0.0 * time[:90]
        blank += [Recording("fall", time[:90], still, still + start, settings=MOTOR_OFF) for start in starts]
        runs = predict(servo, blank, timestep=0.25 * STEP)
        return read([replace(r, angle=q, voltage=u) for r, (q, u) in zip(blank, runs)], seed)

    result = identify(
        changed(arm, coulomb_friction=0.01),  # from Table 2's 1.7e-5 the search sees no slope
        recorded((20.0, 61.0), (1.6, 0.9, -1.2), 5),
        list(truth),
        start_range=2 * COUNT,
        timestep=STEP,
    )
    for name, value in truth.items():
        # standard errors are 0.1 to 0.5 %, the step of 1 ms adds up to 0.2 %: 2 % is far outside both
        assert result.values[name] == pytest.approx(value, rel=0.02), name
    test = recorded((40.0,), (), 6)
    floor = COUNT * math.sqrt(0.5**2 + 1 / 12)
    assert (prediction_error(result.model, test) < 1.2 * floor).all()
    assert (prediction_error(arm, test) > 2 * floor).all()  # before the fit


def test_loads_may_differ_between_recordings(arm):
    forearm, time = load_robot("ax12_arm"), 0.01 * np.arange(150)
    truth = changed(arm, viscous_friction=0.03), changed(forearm, viscous_friction=0.03)
    blank = Recording("fall", time, 0 * time, 0 * time + 1.5, settings=MOTOR_OFF)
    recordings = [Recording("fall", time, 0 * time, predict(m, [blank])[0][0], settings=MOTOR_OFF) for m in truth]
    result = identify([arm, forearm], recordings, ["viscous_friction"])
    assert result.values["viscous_friction"] == pytest.approx(0.03, rel=1e-4)


# --- reading -----------------------------------------------------------------------------------------------------

HEAD = "time [s],reference [rad],angle [rad],voltage [V]"
ROWS = [f"{0.01 * k:.2f},0.5,{0.001 * k},1.5" for k in range(12)]


def table(folder, *lines):
    path = folder / "step.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_recording_is_read_as_written(tmp_path, exact):
    path = tmp_path / "chirp.csv"
    write_recording(path, exact[0])
    again = read_recording(path, Kp=30.0)
    for name in ("time", "reference", "angle", "voltage"):
        assert np.array_equal(getattr(again, name), getattr(exact[0], name))
    assert (again.name, again.settings) == ("chirp", {"Kp": 30.0})
    assert [p.name for p in tmp_path.iterdir()] == ["chirp.csv"]


def test_voltage_may_be_missing_and_time_starts_anywhere(tmp_path):
    rows = [f"{7 + 0.01 * k:.2f},{0.001 * k},0.5" for k in range(12)]
    recording = read_recording(table(tmp_path, "time [s],angle [rad],reference [rad]", *rows))
    assert recording.voltage is None
    assert recording.time == pytest.approx(0.01 * np.arange(12))
    assert recording.reference[0] == 0.5


def test_names_and_units_may_be_others(tmp_path):
    """Write the recording in milliseconds, degrees and millivolts, with more columns."""
    rows = [f"{10 * k},cold,{math.degrees(0.001 * k)!r},{math.degrees(0.5)!r},{1500 + k}" for k in range(12)]
    head = "time_ms,temperature,Angle (deg),goal [deg],voltage_mV"
    recording = read_recording(table(tmp_path, head, *rows))
    assert recording.time == pytest.approx(0.01 * np.arange(12))
    assert recording.angle == pytest.approx(0.001 * np.arange(12), abs=1e-15)
    assert recording.reference == pytest.approx(np.full(12, 0.5))
    assert recording.voltage == pytest.approx(1.5 + 0.001 * np.arange(12))


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ([HEAD.replace("[s]", "[min]"), *ROWS], ["line 1", "'time [min]'", "'min'", "ms"]),
        ([HEAD.replace("angle [", "angel ["), *ROWS], ["line 1", "'angel [rad]'"]),
        ([HEAD + ",torque_on", *(row + ",1" for row in ROWS[:-1]), ROWS[-1] + ",0"], ["'torque_on'", "cut"]),
        ([], ["line 1", "'time [s]' is missing"]),
        (["time,angle [rad]", *ROWS], ["line 1", "'time'", "time [s]"]),
        ([HEAD + ",angle [rad]", *ROWS], ["line 1", "twice"]),
        ([HEAD.replace(",", ";"), *ROWS], ["line 1", "separated by commas"]),
        ([HEAD, *ROWS[:3], "0.03,0.5,abc,1.5", *ROWS[4:]], ["line 5", "'angle [rad]'", "'abc'", "delete"]),
        ([HEAD, *ROWS[:3], "0.03,0.5,,1.5", *ROWS[4:]], ["line 5", "'angle [rad]'", "''"]),
        ([HEAD, *ROWS[:3], "0.03,0.5,nan,1.5", *ROWS[4:]], ["line 5", "'nan'"]),
        ([HEAD, *ROWS[:3], "0.03,0.5,1.5", *ROWS[4:]], ["line 5", "3 values, expected 4"]),
        ([HEAD, *ROWS[:3], "0.03,60,0.1,1.5", *ROWS[4:]], ["line 5", "'reference [rad]'", "degrees to radians"]),
        ([HEAD, *ROWS[:3], "0.02,0.5,0.1,1.5", *ROWS[4:]], ["line 5", "0.02 follows 0.02"]),
        ([HEAD, *ROWS[:3], "30,0.5,0.1,1.5", *ROWS[4:]], ["line 5", "30 follows 0.02", "seconds"]),
        ([HEAD, *ROWS[:9]], ["9 samples", "10"]),
    ],
)
def test_a_damaged_table_is_refused_with_its_place(lines, said, tmp_path):
    with pytest.raises(ValueError, match=r"step\.csv") as error:
        read_recording(table(tmp_path, *lines))
    assert [text for text in said if text not in str(error.value)] == []


def test_recordings_have_as_many_finite_angles_as_times():
    time = np.arange(20.0)
    for angle in (time[1:], np.full(20, np.nan)):
        with pytest.raises(ValueError, match=r"(?s)recording r: angle has the shape .*shape \(20\) as time has"):
            Recording("r", time, time, angle)


def test_settings_must_be_parameters(tmp_path):
    with pytest.raises(ValueError, match=r"'gain'.*Kp"):
        read_recording(table(tmp_path, HEAD, *ROWS), gain=3.0)


@pytest.mark.parametrize(
    ("parameters", "options", "said"),
    [
        (["friction"], {}, "'friction'"),
        ("Kp", {}, "list of names"),
        ([], {}, "list of names"),
        (["Kp", "Kp"], {}, "each once"),
        (["period"], {}, "period cannot be fitted"),
        (["pwm_steps"], {}, "pwm_steps cannot be fitted, the motion is no smooth function of it"),
        (["delay"], {}, "delay cannot be fitted"),
        (["Ki"], {}, "Ki starts at 0.0"),
        (["Kp"], {}, "set by a recording"),
        (["resistance"], {"confidence": 95}, "confidence"),
        (["resistance"], {"start_range": -1.0}, "start_range"),
    ],
)
def test_what_cannot_be_fitted_is_refused(parameters, options, said, arm, exact):
    with pytest.raises(ValueError, match=said):
        identify(arm, exact, parameters, **options)


def test_only_one_joint_is_identified_at_a_time(exact):
    with pytest.raises(ValueError, match=r"arm7.*one moving joint"):
        identify(load_robot("arm7"), exact, ["resistance"])
