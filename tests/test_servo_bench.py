"""Servos identified from recordings of real ones: what is read, what is found again, what is predicted."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenes import pendulum

from featherstone_gait import Reference, compile_scene, load_servo, simulate
from featherstone_gait.cli import main
from featherstone_gait.servo_bench import (
    BASE,
    MODELS,
    STS3250,
    TIMES,
    XL330,
    _Rollouts,
    fit_servo,
    leave_out,
    read_bench,
)

FOLDER = Path(__file__).parents[1] / "robots" / "servos" / "recordings"


def recordings(kind, bench):
    return [read_bench(path, bench) for path in sorted(FOLDER.glob(f"{kind}*.csv"))]


def simulated(rows, bench, friction, values, noise=0.0):
    """The recordings with the angles that the bench itself would show."""
    names = (*BASE, *MODELS[friction], *TIMES)
    every = {name: each.start for name, each in bench.parameters().items()} | values
    (angles,) = _Rollouts(bench, rows, names)([{name: every[name] for name in names}])
    rng = np.random.default_rng(0)
    return [replace(r, angle=a + noise * rng.normal(size=len(a))) for r, a in zip(rows, angles)]


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
        (["time_s,angle_rad"], "goal_rad is there 0 times"),
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


def test_what_made_recordings_is_found_again():
    """Of the model's own recordings with the encoder's noise: within the intervals, and far better than the start."""
    truth = {"torque_constant": 0.36, "torque_per_volt": 0.14, "coulomb_friction": 0.012, "viscous_friction": 0.006}
    rows = [r for r in recordings("xl330_kp200", XL330) if r.motion != "sin_time_square"]
    made = simulated(rows, XL330, "m1", truth, noise=1e-3)
    fit = fit_servo(made, XL330, "m1")
    assert fit.errors.mean() < 1.5e-3
    for name, value in truth.items():
        assert abs(fit.values[name] / value - 1.0) < 0.1
    assert fit.servo.motor_constant == fit.values["torque_constant"]


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


def test_the_command_writes_tables_and_a_picture(tmp_path, capsys):
    files = [str(FOLDER / f"xl330_kp200_{name}.csv") for name in ("sin_sin", "lift_and_drop")]
    other = str(FOLDER / "xl330_kp200_up_and_down.csv")
    command = ["identify", *files, "--servo", "xl330", "--model", "m1", "--predict", other, "--out", str(tmp_path)]
    assert main(command) == 0
    assert "predicted:" in capsys.readouterr().out
    assert {p.name for p in tmp_path.iterdir()} == {"identify.csv", "identify_errors.csv", "identify.png"}
    assert main(["identify", str(tmp_path / "none.csv"), "--servo", "xl330"]) == 2


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
    scene = compile_scene(model, "rotor", integrator="implicit_euler", timestep=1e-3)
    run = simulate(scene, 2.0, reference=Reference([0.0, 1.0], [[0.5], [0.5]]))
    assert run.status == "ok"
    stiffness = servo.controller.Kp * constant / servo.resistance  # [N m/rad]
    assert abs(run["q"][-1, 0] - 0.5) < (0.1 * 9.81 * 0.05 + servo.coulomb_friction) / stiffness + 0.02
