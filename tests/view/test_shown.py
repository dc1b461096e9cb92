"""What robots, scenes, channels and motions look like in print and on a page."""

import re
from dataclasses import replace

import numpy as np
import pytest
from pages import data_of

from featherstone_gait import Ground, Trajectory, channel_table, compile_scene, load_robot, simulate, tree_text
from featherstone_gait.core.effects import energies
from featherstone_gait.core.step.state import CHANNELS, RECORDABLE
from featherstone_gait.model import Mimic
from featherstone_gait.view.page import write_animation
from featherstone_gait.view.plotting import plot_motion


def test_the_tree_has_a_line_for_every_link_under_its_parent():
    model = load_robot("humanoid", locked="simplified")
    first, *lines = tree_text(model).splitlines()
    assert first == "humanoid: floating base, 10 moving joints, 2.423 kg"
    assert len(lines) == len(model.links)
    depth = {line.split(": ")[-1].split(", ")[0].strip("│├└─ "): len(re.match("[│├└─ ]*", line)[0]) for line in lines}
    assert next(iter(depth)) == model.root
    for joint in model.joints:
        assert depth[joint.child] == depth[joint.parent] + 3
    (knee,) = (line for line in lines if "left_knee" in line)
    assert knee.endswith("└─ left_knee (revolute, -98 to 32 deg, servo state, 254 : 1): left_shank, 0.082 kg")
    assert "left_elbow (revolute, -90 to 90 deg, locked at 0 deg, servo state" in tree_text(model)


def test_the_tree_tells_couplings_and_meters():
    model = load_robot("arm7")
    first, second = model.joints[:2]
    sliding = replace(second, type="prismatic", lower=-0.1, upper=0.25, mimic=Mimic(first.name, 2.0, -0.5))
    model = replace(model, joints=(first, sliding, *model.joints[2:]), servos={})
    assert f"{second.name} (prismatic, -0.1 to 0.25 m, follows {first.name}: 2 times, -0.5)" in tree_text(model)


def test_a_scene_prints_as_one_line():
    scene = compile_scene(load_robot("humanoid"), "mipsd", Ground(friction=0.7))
    assert repr(scene) == (
        "<scene of humanoid: floating base, 19 joints, mipsd servos, ground of friction 0.7, 0 springs, "
        "ars343>"
    )
    assert "no servos, no ground" in repr(compile_scene(load_robot("arm7")))


def test_a_trajectory_prints_as_one_line():
    values = {"time": np.arange(3.0), "q": np.zeros((3, 2)), "contact_force": np.zeros((3, 8, 3))}
    run = Trajectory(values, "fell", "", 1.25, np.zeros(0))
    assert repr(run) == "<trajectory: fell to 1.25 s, 3 samples of q (2,), contact_force (8, 3)>"


def test_help_of_simulate_lists_every_channel_with_its_unit():
    lines = [line.strip() for line in channel_table().splitlines()]
    told = [line.strip() for line in simulate.__doc__.splitlines()]
    assert [line for line in lines if line not in told] == []
    recordable = [channel for channel in CHANNELS if channel.name in RECORDABLE]
    assert len(lines) == len(recordable)
    for line, channel in zip(lines, recordable):
        assert line.split() == [*channel.name.split(), *line.split()[1:]]
        assert f"{channel.what} [{channel.unit}]" in line
        assert all(label in line for label in channel.labels)


def test_numbers_of_a_channel_have_names():
    labels = next(one.labels for one in CHANNELS if one.name == "energy")
    assert [labels[k] for k in (energies.SUPPLY, energies.METER)] == ["supply", "electrical_no_regeneration"]
    values = np.arange(48.0).reshape(3, 2, 8)
    run = Trajectory({"time": np.arange(3.0), "energy": values}, "ok", "", 2.0, np.zeros(0))
    assert len(labels) == energies.ENERGIES
    for column, label in enumerate(labels):
        assert np.array_equal(run.column("energy", label), values[..., column])
    for name, label, says in (
        ("energy", "loss", "channel 'energy' has no unique label 'loss'; its labels: supply, electrical"),
        ("base_q", "x", "channel 'base_q' has no unique label 'x'"),  # of the position, or of the quaternion
        ("q", "x", "labels: none, as it is a single number"),
        ("speed", "x", "there is no channel 'speed'; channels: base_q, ball_q, q"),
        ("contact_force", "normal", "'contact_force' was not recorded; recorded were time, energy: name it"),
    ):
        with pytest.raises(ValueError, match=says):
            run.column(name, label)


@pytest.fixture(scope="module")
def motion():
    scene = compile_scene(load_robot("arm7"), "rotor")
    return scene, simulate(scene, 0.2, record=("q",))


def test_a_motion_is_drawn_without_the_channel_energy(motion, tmp_path):
    scene, run = motion
    write_animation(tmp_path / "page.html", scene.model, {"arm": run})
    (drawn,) = data_of((tmp_path / "page.html").read_text("utf-8"))["runs"]
    assert drawn["energy"] is None
    assert len(drawn["frames"]) > 1


def test_a_motion_without_its_positions_is_refused(motion, tmp_path):
    scene, run = motion
    without = replace(run, channels={"time": run["time"]})
    floating = load_robot("humanoid")
    with pytest.raises(ValueError, match=r"channel 'q' was not recorded; recorded were time: name it in"):
        write_animation(tmp_path / "page.html", scene.model, {"arm": without})
    with pytest.raises(ValueError, match=r"channel 'base_q' was not recorded; recorded were time, q"):
        plot_motion(floating, run)
    assert list(tmp_path.iterdir()) == []
