"""A policy in MuJoCo beside the same policy here: two engines, two servos written apart, one network."""

from pathlib import Path

import numpy as np
import pytest
from little_biped import little_biped

from featherstone_gait import cli, save_robot
from featherstone_gait.crosscheck import Floor, crosscheck_policy
from featherstone_gait.judge.run import scene_of

pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")

NETWORK = Path(__file__).parents[1] / "judge" / "little_biped_walk.onnx"
HOW = {"description": NETWORK.with_suffix(".toml")}
UNITS = {"servos": {"Kp": {"kind": "uniform", "scale": 0.1}, "coulomb_friction": {"kind": "uniform", "scale": 0.3}},
         "links": {"mass": {"kind": "lognormal", "scale": 0.05}},
         "ground": {"penetration": {"kind": "lognormal", "scale": 0.5}}}  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize("time_constant", [5e-3, 1e-2])
def test_a_network_walks_as_fast_and_takes_as_much_in_mujoco_as_here(time_constant):
    """XL330 by BAM's model M6, MuJoCo at 0.2 ms, here at 0.5 ms."""
    scene = scene_of(little_biped(), timestep=5e-4)
    found = crosscheck_policy(NETWORK, scene, 5.0, floor=Floor(time_constant, 0.95), **HOW)
    assert [*found.verdicts, *found.own.verdicts] == ["walks", "walks"]
    for name in ("speed", "energy_per_way", "power", "largest_tilt"):
        assert found.mujoco[name] == pytest.approx(found.own.worlds[name], rel=0.05)


@pytest.mark.long
def test_drawn_units_take_as_much_in_mujoco_as_here():
    found = crosscheck_policy(NETWORK, little_biped(), 3.0, worlds=8, doubts={"worlds": UNITS}, **HOW)
    off = found.mujoco["power"] / found.own.worlds["power"] - 1.0
    assert np.median(np.abs(off)) < 0.03 < np.ptp(found.own.worlds["power"]) / found.own.worlds["power"].mean()
    assert "walks                            8           8" in found.table()


def test_what_mujoco_cannot_be_given_is_refused():
    for doubts, said in [({"link": {"delay": 0.01}}, "delay"), ({"pushes": {"speed": 0.1}}, "pushes"),
                         ({"worlds": {"ground": {"slope": {"kind": "uniform", "scale": 0.1, "additive": True}}}},
                          "slope")]:  # fmt: skip
        with pytest.raises(ValueError, match=f"{said} cannot be drawn in MuJoCo"):
            crosscheck_policy(NETWORK, little_biped(), 1.0, worlds=2, doubts=doubts, **HOW)


@pytest.mark.long
def test_the_command_takes_a_network(tmp_path, capsys):
    save_robot(little_biped(), tmp_path / "little_biped.urdf")
    line = ["crosscheck", str(NETWORK), "--robot", str(tmp_path / "little_biped.urdf"), "--seconds", "1"]
    assert cli.main([*line, "--description", str(HOW["description"]), "--floors", "10ms_0.9,20ms_0.9"]) == 0
    assert capsys.readouterr().out.count("energy by way [J/m]") == 2
