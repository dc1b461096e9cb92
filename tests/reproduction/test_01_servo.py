"""Notebook 01: one servo by hand and compiled, its step and fall, and a spring in place of backlash."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from featherstone_gait.reproduction.statements import read_judged

NOTEBOOK = Path(__file__).parents[2] / "notebooks" / "01_servo.ipynb"


def run_cells(*needed):
    """Run the code cells that define one of these names."""
    sources = ["".join(cell["source"]) for cell in json.loads(NOTEBOOK.read_text("utf-8"))["cells"]]
    names = {"__name__": "notebook"}
    for source in sources:
        if any(line.startswith(needed) for line in source.splitlines()):
            exec(source.replace("%matplotlib inline", ""), names)
    return names


@pytest.fixture(scope="module")
def notebook():
    return run_cells("ARMS", "def by_hand", "PLAYS")


def test_the_servo_has_the_numbers_that_paper_and_manual_print(notebook):
    servo = notebook["servo"]
    assert (servo.resistance, servo.inductance, servo.motor_constant) == (8.0, 5e-3, 0.006810)
    assert (servo.viscous_friction, servo.coulomb_friction, servo.gearbox.ratio) == (0.01278, 0.0000171, 254.0)
    assert math.degrees(notebook["COUNT"]) == pytest.approx(0.29326, abs=1e-5)
    assert 12 * notebook["NO_LOAD"] == pytest.approx(59 * 2 * math.pi / 60)


def test_the_loop_is_the_compiled_servo(notebook):
    """And its speed that of the printed constants: G K V / R over the dampers of back-EMF and bearing, 5.54 rad/s."""
    assert 0.0 < notebook["off"] < 0.01 * notebook["COUNT"]
    run = notebook["moved"](notebook["arm"])
    assert run["qd"].max() == pytest.approx(5.54, abs=0.01)
    assert math.degrees(run["q"].max()) == pytest.approx(62.02, abs=0.02)


def test_a_spring_moves_the_arm_as_play_does_and_not_the_gear(notebook):
    arm = {name: close for name, close in notebook["found"].items() if name.endswith("arm to a count")}
    gear = [close for name, close in notebook["found"].items() if name.endswith("gear to a tenth")]
    assert [name for name, close in arm.items() if not close] == ["play of 1.0 deg, whole arm upright, arm to a count"]
    assert (len(arm), gear) == (12, [False] * 12)
    assert [row.cases for row in read_judged(NOTEBOOK) if row.key == "backlash"] == [notebook["found"]]
    upright_with_play, with_spring = notebook["shake"]
    assert upright_with_play == pytest.approx(2.2, abs=0.1)
    assert with_spring < 1e-3


def test_no_statement_of_the_servo_is_decided():
    assert {row.key: row.verdict for row in read_judged(NOTEBOOK)} == dict.fromkeys(
        ("step_response", "arm_fall", "backlash"), "open"
    )


@pytest.mark.long
def test_the_fall_is_that_of_a_damped_pendulum_and_hardly_that_of_the_printed_friction():
    """I q'' = -m g d sin q - B_v q', integrated by SciPy; Coulomb friction at the output is a tenth of a count."""
    notebook = run_cells("ARMS", "def by_hand", "SLOPE", "def of_step", "def fall")
    falls, count = notebook["falls"], notebook["COUNT"]
    standard = falls["arm, model"]["forearm, standard"]
    damped = solve_ivp(
        lambda t, y: (y[1], (-notebook["moment"] * math.sin(y[0]) - 0.01278 * y[1]) / notebook["inertia"]),
        (0.0, 2.0), (0.5 * math.pi, 0.0), t_eval=np.minimum(standard["time"], 2.0), rtol=1e-9, atol=1e-12,
    )  # fmt: skip
    assert np.abs(standard["q"][:, 0] - damped.y[0]).max() < 0.2 * count
    none, printed, at_rotor, _ = (run["q"] for run in falls["friction (forearm, standard)"].values())
    assert 0.05 * count < np.abs(printed - none).max() < 0.15 * count
    assert np.abs(at_rotor - none).max() == pytest.approx(24 * count, rel=0.03)
    assert min(standard["q"]) > 0.0 > min(falls["arm, model"]["forearm, mipsd"]["q"])
