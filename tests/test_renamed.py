"""Old names work until version 0.3, and say what they are called now."""

import importlib
import inspect
import pickle
import re
import sys
from pathlib import Path
from pkgutil import resolve_name
from types import SimpleNamespace

import pytest

import featherstone_gait
from featherstone_gait import compile_scene, load_robot, renamed

ROOT = Path(__file__).parents[1]
MODULES = [old for old, new in renamed.RENAMED.items() if inspect.ismodule(resolve_name(new))]


@pytest.fixture(autouse=True)
def forgotten(monkeypatch):
    """No old name has been imported yet, and none is left behind."""
    for old in renamed.RENAMED:
        monkeypatch.delitem(sys.modules, old, raising=False)
        module, _, name = old.rpartition(".")
        if module in sys.modules and name in vars(sys.modules[module]):
            monkeypatch.delattr(sys.modules[module], name)
    yield
    for old in renamed.RENAMED:
        sys.modules.pop(old, None)
        vars(featherstone_gait).pop(old.rpartition(".")[2], None)


def said(old):
    new = (renamed.RENAMED | renamed.METHODS)[old]
    return pytest.warns(DeprecationWarning, match=rf"^{old} is now {new};.* until version 0\.3$")


@pytest.mark.parametrize("old", renamed.RENAMED)
def test_an_old_name_is_the_new_object_and_says_so(old):
    module, _, name = old.rpartition(".")
    with said(old):
        assert getattr(importlib.import_module(module), name) is resolve_name(renamed.RENAMED[old])


@pytest.mark.parametrize("old", MODULES)
def test_an_old_module_can_be_imported(old):
    new = importlib.import_module(renamed.RENAMED[old])
    spec = new.__spec__
    with said(old) as warned:
        assert importlib.import_module(old) is new
    assert len(warned) == 1
    assert (new.__name__, new.__spec__) == (renamed.RENAMED[old], spec)


def test_the_warning_points_to_the_line_that_has_the_old_name():
    with said("featherstone_gait.plotting") as warned:
        from featherstone_gait.plotting import plot_motion
    assert plot_motion is featherstone_gait.plot_motion
    assert [each.filename for each in warned] == [__file__]


def test_an_old_module_is_read_from_the_package():
    with said("featherstone_gait.animation") as warned:
        from featherstone_gait import animation
    assert animation is importlib.import_module("featherstone_gait.view.animation")
    assert [each.filename for each in warned] == [__file__]


def test_an_attribute_that_moved_is_found_and_pickles_of_it_load(monkeypatch):
    monkeypatch.setitem(renamed.RENAMED, "featherstone_gait.saved", "featherstone_gait.files.complete")
    with said("featherstone_gait.saved"):
        found = pickle.loads(b"cfeatherstone_gait\nsaved\n.")
    assert found is resolve_name("featherstone_gait.files.complete")


def test_pickles_of_old_modules_load():
    with said("featherstone_gait.plotting"):
        found = pickle.loads(b"cfeatherstone_gait.plotting\nplot_motion\n.")
    assert found is featherstone_gait.plot_motion


def test_old_methods_and_properties_warn_and_answer():
    scene = compile_scene(load_robot("arm7"))
    with said("featherstone_gait.build.scene.CompiledScene.theta"):
        assert scene.theta == scene.method.theta
    for module, name in (("cost", "WalkingCost"), ("constraints", "ConstrainedCost")):
        kind = resolve_name(f"featherstone_gait.walking.{module}.{name}")
        with said(f"featherstone_gait.walking.{module}.{name}.map"):
            assert kind.map(SimpleNamespace(costs=list), None, (1, 2)) == [1, 2]
    assert set(renamed.METHODS) == {
        "featherstone_gait.build.scene.CompiledScene.theta",
        "featherstone_gait.walking.constraints.ConstrainedCost.map",
        "featherstone_gait.walking.cost.WalkingCost.map",
    }


def test_unknown_names_are_still_unknown():
    with pytest.raises(AttributeError, match="module 'featherstone_gait' has no attribute 'plots'"):
        featherstone_gait.plots  # noqa: B018
    with pytest.raises(ModuleNotFoundError, match=r"No module named 'featherstone_gait\.plots'") as error:
        importlib.import_module("featherstone_gait.plots")
    assert error.value.name == "featherstone_gait.plots"
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        resolve_name("featherstone_gait.view.plotting.nothing")


def test_old_names_are_gone_when_their_time_is_over():
    version = tuple(map(int, featherstone_gait.__version__.split(".")[:2]))
    assert version < tuple(map(int, renamed.UNTIL.split("."))) or not renamed.RENAMED


@pytest.mark.parametrize("old", renamed.RENAMED)
def test_readme_and_notebooks_have_the_new_names(old):
    texts = [ROOT / "README.md", *(ROOT / "notebooks").glob("*.ipynb")]
    assert len(texts) > 1
    assert [path.name for path in texts if re.search(rf"\b{re.escape(old)}\b", path.read_text("utf-8"))] == []
