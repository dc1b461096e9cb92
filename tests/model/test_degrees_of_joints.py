"""Springs and limits of single degrees of joints that have several: the same as of a chain of joints of one degree."""

from dataclasses import replace

import numpy as np
import pytest

from featherstone_gait import Joint, Link, Model, compile_scene, energy, load_robot, save_robot, simulate
from featherstone_gait.run.simulate import initial_state

INERTIA = (0.02, 0.001, 0.002, 0.03, 0.001, 0.015)
ROD = Link("rod", 0.5, (0.1, 0.05, -0.2), INERTIA)
OWN = {"r1": {"lower": -0.3, "upper": 0.4}, "r2": {"stiffness": 3.0, "spring_reference": 0.2, "damping": 0.05}}
CROSS = {"axis": (1.0, 0.0, 0.0), "axis2": (0.0, 1.0, 0.0)}


def universal(**more):
    joint = Joint("u", "universal", "base", "rod", (0.1, 0.0, 0.3), (0.2, -0.1, 0.4), damping=0.01, **CROSS, **more)
    return Model("universal", (Link("base"), ROD), (joint,))


def hinges():
    first = Joint("u.r1", "revolute", "base", "u.r1", (0.1, 0.0, 0.3), (0.2, -0.1, 0.4), CROSS["axis"], -0.3, 0.4,
                  damping=0.01)  # fmt: skip
    second = Joint("u.r2", "continuous", "u.r1", "rod", axis=CROSS["axis2"], damping=0.05, stiffness=3.0,
                   spring_reference=0.2)  # fmt: skip
    return Model("hinges", (Link("base"), Link("u.r1"), ROD), (first, second))


@pytest.mark.long
def test_a_universal_joint_moves_as_its_two_hinges():
    """Through the stop of the first, with the spring of the second, to the same bits."""
    runs = []
    for model in (universal(degrees=OWN), hinges()):
        scene = compile_scene(model, integrator="implicit_euler", timestep=1e-3)
        start = initial_state(scene, [0.0, 0.5], [6.0, -1.0])
        runs.append(simulate(scene, 0.4, start, record=("q", "qd"), estimate_error=False))
    assert runs[0]["q"][:, 0].max() > 0.4
    np.testing.assert_array_equal(runs[0]["q"], runs[1]["q"])


def test_degrees_are_read_and_written(tmp_path):
    model = universal(degrees=OWN)
    q, qd = np.array([0.1, 0.7]), np.zeros(2)
    assert energy(model, q, qd).potential == pytest.approx(energy(hinges(), q, qd).potential, rel=1e-14)
    assert [one.type for one in model.moving_joints] == ["revolute", "continuous"]
    save_robot(model, tmp_path / "u.urdf")
    assert load_robot(tmp_path / "u.urdf").joints == model.joints
    save_robot(model, tmp_path / "written.xml")
    back = load_robot(tmp_path / "written.xml", strict=True).moving_joints
    for mine, its in zip(model.moving_joints, back):
        for name in ("lower", "upper", "stiffness", "spring_reference", "damping"):
            assert getattr(mine, name) == getattr(its, name)
    slider = Joint("p", "planar", "base", "rod", axis=(0.0, 0.0, 1.0), degrees={"y": {"lower": 0.0, "upper": 1.0}})
    assert [one.upper for one in replace(model, joints=[slider]).moving_joints] == [np.inf, 1.0, np.inf]


@pytest.mark.parametrize(
    ("degrees", "message"),
    [
        ({"rx": {"upper": 1.0}}, "degrees has 'rx', and type 'universal': its single degrees are 'r1', 'r2'"),
        ({"r1": {"pitch": 1.0}}, "joint 'u': degree 'r1' has 'pitch'; expected one of 'lower', 'upper'"),
        ({"r1": {"upper": "1"}}, "joint 'u': degree 'r1' has upper '1'; expected a number"),
        (3.0, r"joint 'u': degrees is 3\.0; expected numbers by degree and name"),
        ({"r1": {"lower": 1.0, "upper": 0.0}}, r"joint 'u\.r1': limits lower 1\.0, upper 0\.0"),
        ({"r2": {"stiffness": -1.0}}, r"joint 'u\.r2': stiffness is -1\.0"),
    ],
)
def test_wrong_degrees_are_refused(degrees, message):
    with pytest.raises(ValueError, match=message):
        universal(degrees=degrees)


def test_a_joint_of_one_degree_has_none():
    with pytest.raises(ValueError, match="degrees has 'r1', and type 'revolute': it has no single degrees"):
        Joint("j", "revolute", "base", "rod", lower=-1.0, upper=1.0, degrees={"r1": {"upper": 0.5}})
