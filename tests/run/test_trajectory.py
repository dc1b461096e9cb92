"""Trajectories: a dictionary of channels that survives the disk, whole or not at all."""

import json

import matplotlib
import numpy as np
import pytest
from scenes import box_on, resting

from featherstone_gait import plot
from featherstone_gait.model import Ground
from featherstone_gait.run.simulate import simulate
from featherstone_gait.run.trajectory import Trajectory

matplotlib.use("Agg")

CHANNELS = ("base_q", "base_qd", "contact_force", "contact_work")


@pytest.fixture(scope="module")
def run():
    scene = box_on(Ground())
    return simulate(scene, 0.1, resting(scene, (0.3, 0.2, 0.1)), record=CHANNELS)


@pytest.mark.nojit
def test_it_is_a_dictionary_of_channels_and_time(run):
    assert set(run) == {"time", *CHANNELS}
    assert len(run) == 5
    assert all(len(values) == 11 for values in run.values())
    with pytest.raises(KeyError):
        run["torque"]


@pytest.mark.parametrize("name", ["run", "run.npz", "run.json", "mu 0.5", "run.2026.npz"])
def test_loading_gives_what_was_saved_to_the_last_bit(run, tmp_path, name):
    run.save(tmp_path / name)
    again = Trajectory.load(tmp_path / name)
    assert set(again) == set(run)
    for channel in run:
        assert again[channel].tobytes() == run[channel].tobytes()
        assert again[channel].shape == run[channel].shape
    assert again.final.tobytes() == run.final.tobytes()
    assert (again.status, again.message, again.end_time, again.info) == (
        run.status,
        run.message,
        run.end_time,
        run.info,
    )


def test_names_that_differ_after_a_dot_are_different_files(run, tmp_path):
    for name in ("slope 0.1", "slope 0.2"):
        run.save(tmp_path / name)
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["slope 0.1.json", "slope 0.1.npz", "slope 0.2.json", "slope 0.2.npz"]


def test_saving_replaces_an_earlier_run(run, tmp_path):
    run.save(tmp_path / "run")
    Trajectory({"time": np.zeros(1)}, "fell", "it fell", 0.5, np.zeros(3)).save(tmp_path / "run")
    again = Trajectory.load(tmp_path / "run")
    assert (again.status, list(again), again.end_time) == ("fell", ["time"], 0.5)
    assert not again.ok


@pytest.mark.parametrize("present", [False, True])
@pytest.mark.parametrize("interruption", [KeyboardInterrupt, OSError])
@pytest.mark.parametrize("writer", ["numpy.savez_compressed", "json.dumps"])
def test_an_interrupted_save_leaves_what_was_there(run, tmp_path, monkeypatch, writer, interruption, present):
    if present:
        run.save(tmp_path / "run")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}

    def interrupted(*arguments, **_):
        if hasattr(arguments[0], "write"):
            arguments[0].write(b"half a")
        raise interruption

    monkeypatch.setattr(writer, interrupted)
    with pytest.raises(interruption):
        run.save(tmp_path / "run")
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_saved_files_have_the_usual_permissions(run, tmp_path):
    (tmp_path / "plain").touch()
    run.save(tmp_path / "run")
    modes = {path.stat().st_mode for path in tmp_path.iterdir()}
    assert len(modes) == 1


def test_the_settings_can_be_read_without_this_package(run, tmp_path):
    run.save(tmp_path / "run")
    described = json.loads((tmp_path / "run.json").read_text())
    assert described["status"] == "ok"
    assert described["info"]["timestep"] == 1e-3
    with np.load(tmp_path / "run.npz") as data:
        np.testing.assert_array_equal(data["channel_time"], run["time"])


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match="nothing here"):
        Trajectory.load(tmp_path / "nothing here")


def test_plotting_draws_a_panel_a_channel(run):
    figure = plot(run, "base_q", "contact_force")
    assert [axes.get_ylabel().split()[0] for axes in figure.axes] == ["base_q", "contact_force"]
    assert all(len(axes.lines) > 0 for axes in figure.axes)
    matplotlib.pyplot.close(figure)


@pytest.mark.parametrize("name", ["channel_base_q", "channel_contact_force", "channel_time", "error_base_qd", "final"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_file_with_what_is_no_number_is_refused_with_its_place(run, tmp_path, name, value):
    run.save(tmp_path / "run")
    with np.load(tmp_path / "run.npz") as data:
        arrays = dict(data)
    if name not in arrays or (name.startswith("error") and value == np.inf):
        return  # errors may be infinite
    arrays[name].reshape(len(arrays[name]), -1)[3, 0] = value
    np.savez(tmp_path / "run.npz", **arrays)
    with pytest.raises(ValueError, match=r"run\.npz: .*row 3, number 0 is (nan|inf)"):
        Trajectory.load(tmp_path / "run")
