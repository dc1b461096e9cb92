"""Trajectories as tables: the same numbers under names that say what they are."""

import json
import sys

import numpy as np
import pytest
from scenes import arm_scene

from featherstone_gait import Joint, Link, Loop, Model, compile_scene
from featherstone_gait.run.simulate import initial_state, simulate


@pytest.fixture(scope="module")
def run():
    scene = arm_scene()
    start = initial_state(scene, np.full(7, 0.05))
    return simulate(scene, 0.05, start, record=("q", "energy", "voltage"), estimate_error=False)


@pytest.mark.parametrize(
    ("method", "arguments", "library"),
    [("to_pandas", (), "pandas"), ("to_xarray", (), "xarray"), ("to_parquet", ("run.parquet",), "pyarrow")],
)
def test_a_library_that_is_missing_is_named_with_its_command(run, monkeypatch, method, arguments, library):
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(ImportError, match=rf"needs {library}: pip install featherstone-gait\[tables\]"):
        getattr(run, method)(*arguments)


def test_a_table_has_every_number_under_its_name(run, tmp_path):
    pandas = pytest.importorskip("pandas")
    frame, joints = run.to_pandas(), run.info["joints"]
    assert np.array_equal(frame.index, run["time"])
    assert frame.shape == (len(run["time"]), 7 + 7 + 7 * 8)
    assert np.array_equal(frame[f"q.{joints[2]}"], run["q"][:, 2])
    assert np.array_equal(frame[f"energy.{joints[6]}.copper"], run.column("energy", "copper")[:, 6])
    assert frame.attrs["status"] == run.status
    assert json.loads(frame.attrs["units"])["voltage"] == "V"
    run.to_parquet(tmp_path / "run.parquet")
    again = pandas.read_parquet(tmp_path / "run.parquet")
    assert again.to_numpy().tobytes() == frame.to_numpy().tobytes()
    assert [*again.columns] == [*frame.columns]


def test_a_data_set_has_named_axes_and_units(run):
    pytest.importorskip("xarray")
    found, joints = run.to_xarray(), run.info["joints"]
    assert found["energy"].dims == ("time", "joint", "energy_1")
    assert found["q"].attrs["units"] == "rad"
    copper = found["energy"].sel(joint=joints[3], energy_1="copper")
    assert np.array_equal(copper, run.column("energy", "copper")[:, 3])
    assert found.attrs["status"] == run.status


def test_a_table_names_the_rows_of_a_loop():
    pytest.importorskip("pandas")
    pytest.importorskip("xarray")
    slide = Joint("slide", "prismatic", "frame", "weight", axis=(0.0, 0.0, 1.0))
    pin = Loop("pin", "connect", "weight", "frame")
    model = Model("hung", (Link("frame"), Link("weight", 2.0)), (slide,), loops=(pin,))
    scene = compile_scene(model, integrator="rk4", timestep=1e-3)
    run = simulate(scene, 0.01, record=("loop_force",), estimate_error=False)
    assert set(run.to_pandas()) == {f"loop_force.pin.{axis}" for axis in "xyz"}
    assert run.to_xarray()["loop_force"].dims == ("time", "row")
