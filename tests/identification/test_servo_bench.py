"""Servos identified from recordings of real ones: what is read, what is found again, what is predicted."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from scenes import pendulum
from scipy.stats import binom

from featherstone_gait import Reference, compile_scene, load_servo, simulate
from featherstone_gait.cli import main
from featherstone_gait.identification import bench as servo_bench
from featherstone_gait.identification import bench_rollouts
from featherstone_gait.identification import effects as servo_effects
from featherstone_gait.identification.bench import (
    MODELS,
    STS3250,
    XL330,
    fit_servo,
    leave_out,
    read_bench,
)
from featherstone_gait.identification.bench_rollouts import BASE, TIMES, Rollouts
from featherstone_gait.identification.effects import COUNT
from featherstone_gait.identification.log import FitLog
from featherstone_gait.run.adjoint import Adjoint
from featherstone_gait.run.compiled_run import Vector
from featherstone_gait.run.prepare import prepare

FOLDER = Path(__file__).parents[2] / "robots" / "servos" / "recordings"


def recordings(kind, bench):
    return [read_bench(path, bench) for path in sorted(FOLDER.glob(f"{kind}*.csv"))]


def simulated(rows, bench, friction, values):
    """The recordings with the angles that the bench itself would show."""
    names = (*BASE, *MODELS[friction], *TIMES)
    every = {name: each.start for name, each in bench.parameters().items()} | values
    (angles,) = Rollouts(bench, rows)([{name: every[name] for name in names}])
    return [replace(r, angle=a) for r, a in zip(rows, angles)]


def seen(rows, seed):
    """The recordings as an encoder with noise of 1 mrad shows them, rounded to its counts."""
    rng = np.random.default_rng(seed)
    noisy = [r.angle + 1e-3 * rng.normal(size=len(r.angle)) for r in rows]
    return [replace(r, angle=COUNT * np.round(angle / COUNT)) for r, angle in zip(rows, noisy)]


TRUTH = {
    "torque_constant": 0.36, "torque_per_volt": 0.14, "armature": 0.0022, "rod_mass": 0.03, "zero": 0.01,
    "coulomb_friction": 0.012, "viscous_friction": 0.006, "angle_age": 0.005,
}  # fmt: skip


def test_a_recording_is_read_as_it_is():
    drop = read_bench(FOLDER / "xl330_kp100_lift_and_drop.csv", XL330)
    assert (drop.gain, drop.mass, drop.length) == (100.0, 0.49, 0.1)
    assert drop.supply == 7.3
    assert 2.0 < drop.release < 6.0
    assert drop.motion == "lift_and_drop"
    assert read_bench(FOLDER / "xl330_kp100_sin_sin.csv", XL330, mass=0.2, gain=50).mass == 0.2


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["time_s,angle_rad"], "column 'goal_rad' is missing"),
        (["time_s,angle_rad,goal_rad,supply_v,torque_on", "0,0,0,7"], "line 2: has 4 values, expected 5"),
        (["time_s,angle_rad,goal_rad,supply_v,torque_on", "0,x,0,7,1"], "line 2, column 'angle_rad': 'x'"),
        (["time_s,angle_rad,goal_rad,supply_v,torque_on", *["0,0,0,7,1"] * 30], "line 3: the time does not rise"),
        (["time_s,angle_rad,goal_rad,supply_v,torque_on", *(f"{k},0,0,7,{k % 2}" for k in range(30))], "takes hold"),
    ],
)
def test_what_is_no_recording_is_refused_by_line(tmp_path, lines, message):
    path = tmp_path / "x_kp5_y.csv"
    path.write_text("\n".join(lines))
    with pytest.raises(ValueError, match=message):
        read_bench(path, XL330)


def test_a_gain_must_be_known(tmp_path):
    path = tmp_path / "mine.csv"
    path.write_bytes((FOLDER / "xl330_kp100_sin_sin.csv").read_bytes())
    with pytest.raises(ValueError, match="--gain"):
        read_bench(path, XL330)


@pytest.mark.long
def test_what_made_recordings_is_found_again():
    """Of the model's own recordings with the encoder's noise; the search starts from numbers up to a half off."""
    rows = [r for r in recordings("xl330_kp200", XL330) if r.motion != "sin_time_square"]
    made = seen(simulated(rows, XL330, "m1", TRUTH), 0)
    fit = fit_servo(made, XL330, "m1", held={"rod_mass": TRUTH["rod_mass"]})
    assert fit.errors.mean() < 1.2e-3  # noise and counts: sqrt(2 / pi) times 1.1 mrad
    for name in ("torque_constant", "torque_per_volt", "armature", "coulomb_friction", "viscous_friction"):
        assert abs(fit.values[name] / TRUTH[name] - 1.0) < 0.03
    assert fit.servo.motor_constant == fit.values["torque_constant"]
    assert fit.held == {"rod_mass": 0.03}


@pytest.mark.long
def test_intervals_hold_as_often_as_they_say():
    """Of 20 synthetic data sets: each parameter within its interval of 95 % as often as chance allows, one in 1000."""
    rows = [
        read_bench(FOLDER / f"xl330_{name}.csv", XL330)
        for name in ("kp200_sin_sin", "kp200_lift_and_drop", "kp800_sin_time_square")
    ]
    made = simulated(rows, XL330, "m1", TRUTH)
    hits = dict.fromkeys(set(TRUTH) - {"rod_mass"}, 0)
    for seed in range(20):
        fit = fit_servo(seen(made, seed), XL330, "m1", held={"rod_mass": TRUTH["rod_mass"]})
        for name in hits:
            low, high = fit.intervals[name]
            hits[name] += low <= TRUTH[name] <= high
    print(hits)
    assert min(hits.values()) >= binom.ppf(1e-3 / len(hits), 20, 0.95)
    assert max(fit.intervals["torque_constant"]) < 1.01 * TRUTH["torque_constant"]


@pytest.mark.long
def test_slopes_are_the_exact_ones():
    """Those by differences beside tangents of the tape, of all but the times: to 1e-5 of each column."""
    (r,) = recordings("xl330_kp200_sin_sin", XL330)
    rollouts, every = Rollouts(XL330, [r]), XL330.parameters()
    names = (*BASE, *MODELS["m4p"])
    values = {name: every[name].start for name in (*names, *TIMES)}
    width = {name: servo_bench.SLOPE_STEP * every[name].width for name in names}
    sets = [values, *(values | {name: values[name] + width[name]} for name in names)]
    (here,), *ahead = rollouts(sets)
    worlds = [bench_rollouts.numbers_of(XL330, r, one) for one in sets]
    worlds.append(bench_rollouts.numbers_of(XL330, r, {name: 1.01 * x + 1e-6 for name, x in values.items()}))
    scenes = bench_rollouts.scenes_of(rollouts.scene, worlds)
    runs = [prepare(scene, rollouts.steps * bench_rollouts.STEP, ("q",), bench_rollouts.STEP) for scene in scenes]
    starts = [rollouts._begin(run, r, one["zero"])[0] for run, one in zip(runs, sets)]
    adjoint = Adjoint(runs[0], starts[0], runs[-1:])
    path = adjoint.run()[:, 0]
    times = bench_rollouts.STEP * np.arange(len(path))
    seen = lambda path: np.interp(r.time - values["angle_age"] - r.time[0], times, path)  # noqa: E731
    assert np.array_equal(seen(path) + values["zero"], here)

    def inputs(start):
        """What the run of a start has in the tape's entries; current limits, which are infinite, do not differ."""
        found, run = np.zeros(adjoint.entries), Vector.of(start.compiled, [start], 1).run
        for slot in adjoint.slots:
            numbers = adjoint.values(slot, run)
            found[slot.first : slot.first + numbers.size] = np.nan_to_num(numbers, posinf=0.0).ravel()
        return found

    directions = np.stack([inputs(start) - inputs(starts[0]) for start in starts[1:]], axis=-1)
    tangents = np.stack([start.y - starts[0].y for start in starts[1:]], axis=-1)
    exact = adjoint.push(tangents, directions)[0][:, 0]
    for k, name in enumerate(names):
        column = seen(exact[:, k]) + (width[name] if name == "zero" else 0.0)
        assert np.linalg.norm(ahead[k][0] - here - column) < 1e-5 * np.linalg.norm(column), name


@pytest.mark.long
def test_an_interrupted_fit_goes_on_to_the_same_bits(tmp_path, monkeypatch):
    monkeypatch.setattr(servo_bench, "MOST_ROUNDS", 2)

    class Interrupted(FitLog):
        def append(self, key, row):
            super().append(key, row)
            raise KeyboardInterrupt

    rows = recordings("xl330_kp200_sin_sin", XL330)
    whole = fit_servo(rows, XL330, "m1")
    assert "round" in whole.message
    path = tmp_path / "fit.jsonl"
    with Interrupted(path) as log, pytest.raises(KeyboardInterrupt):
        fit_servo(rows, XL330, "m1", log=log)
    path.write_bytes(path.read_bytes() + b'{"fit": "')  # as of a process that was killed while it wrote
    with FitLog(path) as log:
        again = fit_servo(rows, XL330, "m1", log=log)
        assert again.values == whole.values
        assert again.intervals == whole.intervals
        assert again.simulations < whole.simulations
        other = fit_servo([replace(rows[0], supply=7.0)], XL330, "m1", log=log)  # is another fit
        assert other.values != whole.values
    with FitLog(path) as log:
        assert fit_servo(rows, XL330, "m1", log=log).values == whole.values


HEADER = '{"format": "featherstone_gait servo fit log 3, written by version 0.2"}'


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([HEADER.replace("servo fit", "study")], "expected featherstone_gait servo fit"),
        ([HEADER.replace("log 3", "log 9")], "reads servo fit log 1 to 3"),
        ([HEADER, "12"], "line 2: damaged"),
        ([HEADER, '{"fit": "a"}'], "line 2: damaged"),
        (["time_s,angle_rad"], "line 1: damaged"),
    ],
)
def test_what_is_no_log_of_fits_is_refused(tmp_path, lines, message):
    path = tmp_path / "fit.jsonl"
    path.write_text("\n".join([*lines, ""]))
    with pytest.raises(ValueError, match=message):
        FitLog(path)
    assert path.read_text() == "\n".join([*lines, ""])


def test_two_processes_do_not_share_a_log(tmp_path):
    with FitLog(tmp_path / "fit.jsonl"), pytest.raises(OSError, match="another process"):
        FitLog(tmp_path / "fit.jsonl")


def test_what_cannot_be_searched_is_refused():
    rows = recordings("xl330_kp200_sin_sin", XL330)
    with pytest.raises(ValueError, match="more"):
        fit_servo(rows, XL330, "m1", more=("mass",))
    with pytest.raises(ValueError, match="held"):
        fit_servo(rows, XL330, "m1", held={"mass": 1.0})
    with pytest.raises(ValueError, match="friction"):
        fit_servo(rows, XL330, "m7")


@pytest.mark.long
def test_a_table_of_effects_goes_on_where_it_was(tmp_path, monkeypatch):
    monkeypatch.setattr(servo_bench, "MOST_ROUNDS", 1)
    rows = [r for r in recordings("xl330_kp200", XL330) if r.motion in ("up_and_down", "sin_sin")]
    table = partial(servo_effects.effects, rows, XL330, lambda r: r.motion, servo_effects.EFFECTS[:1])
    with FitLog(tmp_path / "fit.jsonl") as log:
        first = list(table(log=log))
        size = (tmp_path / "fit.jsonl").stat().st_size
        assert list(table(log=log)) == first
        assert (tmp_path / "fit.jsonl").stat().st_size == size
    assert [*first[0].left_out] == ["sin_sin", "up_and_down"]
    assert f"left out {1e3 * first[0].mean:5.1f}" in first[0].line()


@pytest.mark.long
def test_a_gain_left_out_of_the_fit_is_predicted():
    """The XL330: 25 mrad over whole rollouts, where published parameters are off by 69 to 82 mrad."""
    held = leave_out(recordings("xl330", XL330), XL330, "m4p")
    errors = [errors.mean() for _, _, errors in held.values()]
    assert len(errors) == 3
    assert np.mean(errors) < 0.025


@pytest.mark.long
def test_friction_that_knows_the_load_is_what_tells():
    """Each part buys something: errors of the fit fall from M1 to M4 and with the product of the loads."""
    rows = recordings("xl330", XL330)
    errors = [fit_servo(rows, XL330, friction).errors.mean() for friction in ("m1", "m4", "m4p")]
    assert errors[0] > 1.2 * errors[1] > 1.2 * 1.2 * errors[2]


@pytest.mark.long
def test_the_sts3250_is_met_as_well():
    fit = fit_servo(recordings("sts3250", STS3250), STS3250, "m4")
    assert fit.errors.mean() < 0.012


@pytest.mark.long
def test_the_command_writes_tables_and_a_picture(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(servo_bench, "MOST_ROUNDS", 1)
    files = [str(FOLDER / f"xl330_kp200_{name}.csv") for name in ("sin_sin", "lift_and_drop")]
    other = str(FOLDER / "xl330_kp200_up_and_down.csv")
    common = ["identify", *files, "--servo", "xl330", "--out", str(tmp_path)]
    assert main([*common, "--model", "m1", "--predict", other, "--plot", str(tmp_path / "mine.png")]) == 0
    printed = capsys.readouterr().out
    assert "predicted:" in printed
    assert "correlation of" in printed
    written = {"identify.csv", "identify_errors.csv", "identify.jsonl", "mine.png"}
    assert {p.name for p in tmp_path.iterdir()} == written
    assert main(["identify", str(tmp_path / "none.csv"), "--servo", "xl330"]) == 2

    few = partial(servo_effects.effects, chosen=servo_effects.EFFECTS[:1])
    monkeypatch.setattr(servo_effects, "effects", few)
    assert main([*common, "--effects"]) == 0
    assert "M1, Coulomb" in capsys.readouterr().out
    assert (tmp_path / "identify_effects.csv").read_text().startswith("# featherstone_gait effects of a servo")
    assert main([*common, "--effects", "--predict", other]) == 2


@pytest.mark.quick("xl320-*", "sts3215-*")
@pytest.mark.parametrize(
    ("name", "constant", "armature"),
    [
        ("mx64", 1.663, 0.01096), ("mx106", 2.231, 0.02457), ("xl320", 0.987, 0.00112), ("xl330", 0.3862, 0.001895),
        ("sts3215", 1.2116, 0.0284),
    ],
)  # fmt: skip
def test_published_servos_are_what_was_published(name, constant, armature):
    """Their numbers at the output; and a weight that they carry to its goal, as near as friction lets them."""
    servo = load_servo(name)
    gear = servo.gearbox
    assert abs(gear.ratio * servo.motor_constant / constant - 1.0) < 1e-5
    assert abs(gear.ratio**2 * gear.rotor_inertia / armature - 1.0) < 1e-5
    model = replace(pendulum(0.1, 0.1, damping=0.0), servos={"hinge": servo})
    scene = compile_scene(model, "rotor", integrator="ars343")
    run = simulate(scene, 2.0, reference=Reference([0.0, 1.0], [[0.5], [0.5]]))
    assert run.status == "ok"
    stiffness = servo.controller.Kp * constant / servo.resistance  # [N m/rad]
    assert abs(run["q"][-1, 0] - 0.5) < (0.1 * 9.81 * 0.05 + servo.coulomb_friction) / stiffness + 0.02
