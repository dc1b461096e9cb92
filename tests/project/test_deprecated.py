"""Old names and paths still work and name the new ones in a DeprecationWarning."""

import importlib
import warnings
from dataclasses import replace

import numpy as np
import pytest

import featherstone_gait

PATHS = {  # old module, a name in it -> where the name is now
    ("gym", "RobotEnv"): "envs",
    ("sensors", "encoders"): "run.sensors",
    ("servo_bench", "ServoFit"): "identification.bench",
    ("servo_curve", "torque_speed"): "identification.curve",
    ("fit_log", "FitLog"): "identification.log",
    ("collision", "meeting_shapes"): "geometry.distance",
    ("maximal", "Engine"): "reproduction.maximal",
    ("experiments", "EXPERIMENTS"): "reproduction",
}
NAMES = {
    "Kink": "Discontinuity",
    "Linearisation": "Linearization",
    "Posture": "IKResult",
    "Spread": "Distribution",
    "linearise": "linearize",
    "restarted": "reset_time",
}
METHODS = {"plot": "plot", "show": "show", "show_live": "show_live", "save_gif": "save_movie"}  # of Trajectory


@pytest.mark.parametrize(("old", "name"), PATHS)
def test_an_old_path_leads_to_the_same_object(old, name):
    new = PATHS[old, name]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of the package `experiments` itself
        module = importlib.import_module(f"featherstone_gait.{old}")
    said = rf"^featherstone_gait\.{old}\.{name} is now featherstone_gait\.{new}\.{name};.* until version 0\.4$"
    with pytest.warns(DeprecationWarning, match=said):
        found = getattr(module, name)
    assert found is getattr(importlib.import_module(f"featherstone_gait.{new}"), name)


@pytest.mark.parametrize(("old", "name"), PATHS)
def test_an_old_path_lists_the_names_of_the_new_one(old, name):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        module, found = importlib.import_module(f"featherstone_gait.{old}"), {}
        exec(f"from featherstone_gait.{old} import *", found)
    assert name in dir(module)
    assert {name for name in found if not name.startswith("__")} == set(dir(module))


def test_the_package_lists_its_names():
    names = [name for name in dir(featherstone_gait) if not name.startswith("__")]
    assert {*featherstone_gait.__all__} <= {*names}
    assert len({*names}) == len(names)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        for old, _ in PATHS:
            importlib.import_module(f"featherstone_gait.{old}")
    listed = {*dir(featherstone_gait)}
    assert "base" in listed
    assert not {"re", "import_module", "renamed", *NAMES, *(old for old, _ in PATHS)} & listed
    optimize = importlib.import_module("featherstone_gait.optimize")
    assert {*optimize.__all__} <= {*dir(optimize)}


def test_objects_list_current_names_alone():
    run = featherstone_gait.Trajectory({"time": np.zeros(1)}, "ok", "", 0.0, np.zeros(0))
    for one, old, new in (
        (run, "companion", "second_final"),
        (run, "plot", "save"),
        (featherstone_gait.Ground(), "sinking", "penetration"),
        (featherstone_gait.Distribution("normal", 0.1), "width", "scale"),
        (featherstone_gait.load_robot("arm7"), "show_tree", "joint"),
    ):
        assert hasattr(type(one), old)
        assert {old, new} & {*dir(one)} == {new}


@pytest.mark.parametrize("old", NAMES)
def test_an_old_name_is_the_new_object(old):
    with pytest.warns(DeprecationWarning, match=rf"^featherstone_gait\.{old} is now .*{NAMES[old]};"):
        found = getattr(featherstone_gait, old)
    assert found is getattr(featherstone_gait, NAMES[old])


@pytest.mark.parametrize("old", METHODS)
def test_an_old_method_calls_the_new_function(old, monkeypatch):
    run = featherstone_gait.Trajectory({"time": np.zeros(1)}, "ok", "", 0.0, np.zeros(0))
    monkeypatch.setattr(featherstone_gait, METHODS[old], lambda *arguments, **options: (arguments, options))
    with pytest.warns(DeprecationWarning, match=rf"^Trajectory\.{old} is now featherstone_gait\.{METHODS[old]};"):
        assert getattr(run, old)("q", captions=["a"]) == ((run, "q"), {"captions": ["a"]})


def test_plot_trajectory_draws_the_channels_of_its_list():
    run = featherstone_gait.Trajectory({"time": np.arange(2.0), "q": np.zeros((2, 1))}, "ok", "", 0.0, np.zeros(0))
    with pytest.warns(DeprecationWarning, match="plot_trajectory.* is now featherstone_gait.plot"):
        figure = featherstone_gait.plot_trajectory(run, ["q"])
    assert [axes.get_ylabel() for axes in figure.axes] == ["q [rad or m]"]


@pytest.mark.parametrize("module", ["gym", "maximal"])
def test_a_name_that_never_was_is_an_attribute_error(module):
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = importlib.import_module(f"featherstone_gait.{module}").nothing


def test_old_arguments_fields_and_channels_give_what_the_new_ones_give():
    arm = featherstone_gait.load_robot("arm7")
    with pytest.warns(DeprecationWarning, match="compile_scene: servos is now gearbox"):
        scene = featherstone_gait.compile_scene(arm, servos="rotor")
    assert scene.gearbox == "rotor"
    with pytest.warns(DeprecationWarning, match=r"'filtered' is now 'filtered_speed'"):
        run = featherstone_gait.simulate(scene, 0.01, record=("filtered",))
    with pytest.warns(DeprecationWarning, match=r"'filtered' is now 'filtered_speed'"):
        assert run["filtered"] is run["filtered_speed"]
    with pytest.warns(DeprecationWarning, match="sinking is now penetration"):
        ground = featherstone_gait.Ground(sinking=1e-3)
    assert ground == featherstone_gait.Ground(penetration=1e-3)
    with pytest.warns(DeprecationWarning, match=r"Ground\.sinking is now Ground\.penetration"):
        assert ground.sinking == 1e-3
    with pytest.warns(DeprecationWarning, match="sinking is now penetration"):
        assert replace(featherstone_gait.Ground(), sinking=1e-3) == ground
    with pytest.raises(TypeError, match="give one of them"):
        featherstone_gait.compile_scene(arm, servos="rotor", gearbox="rotor")
    with pytest.warns(DeprecationWarning, match=r"CompiledScene\.servos is now CompiledScene\.gearbox"):
        assert scene.servos == "rotor"
    with pytest.warns(DeprecationWarning, match="turn_weight is now orientation_weight"):
        target = featherstone_gait.Target("tip", turn_weight=2.0)
    assert target.orientation_weight == 2.0


def test_old_channels_are_found_wherever_channels_are_named():
    scene = featherstone_gait.compile_scene(featherstone_gait.load_robot("arm7"), "rotor")
    state = featherstone_gait.initial_state(scene)
    run = featherstone_gait.simulate(scene, 0.01, record=("filtered_speed",))
    linear = featherstone_gait.linearize(scene, states=("q", "qd", "filtered_speed"))
    for old, new in (
        (lambda: scene.part("filtered"), scene.part("filtered_speed")),
        (lambda: scene.layout["filtered"], scene.layout["filtered_speed"]),
        (lambda: run.error["filtered"], run.error["filtered_speed"]),
        (lambda: run.channels["filtered"], run["filtered_speed"]),
        (lambda: scene.state_view(state).filtered, state[slice(*scene.part("filtered_speed"))]),
        (lambda: scene.state_view(state)["filtered"], state[slice(*scene.part("filtered_speed"))]),
        (lambda: featherstone_gait.linearize(scene, states=("q", "qd", "filtered")).A, linear.A),
        (lambda: linear.of("filtered"), linear.of("filtered_speed")),
    ):
        with pytest.warns(DeprecationWarning, match="channel 'filtered' is now 'filtered_speed'"):
            assert np.array_equal(old(), new)
    with pytest.raises(KeyError, match="nothing"):
        scene.part("nothing")
    with pytest.warns(DeprecationWarning, match="companion is now second_final"):
        again = replace(run, companion=state)
    assert again.second_final is state


@pytest.mark.parametrize(
    ("function", "wrong", "right"), [("Session", "world", "worlds"), ("Ground", "frict", "friction")]
)
def test_an_unknown_argument_is_answered_with_the_known_ones(function, wrong, right):
    with pytest.raises(TypeError, match=rf"no argument '{wrong}'; did you mean {right}\?; its arguments: .*{right}"):
        getattr(featherstone_gait, function)(**{wrong: None})


def test_the_warning_points_to_the_line_that_has_the_old_name():
    arm = featherstone_gait.load_robot("arm7")
    scene = featherstone_gait.compile_scene(arm)
    for old in (
        lambda: featherstone_gait.restarted,
        lambda: featherstone_gait.Ground(sinking=1e-3),
        lambda: featherstone_gait.simulate(scene, 0.01, record=("passes",)),
        lambda: featherstone_gait.compile_scene(arm, servos="rotor"),
    ):
        with pytest.warns(DeprecationWarning, match="until version") as warned:
            old()
        assert {each.filename for each in warned} == {__file__}
