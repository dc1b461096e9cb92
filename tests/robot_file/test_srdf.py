"""SRDF files: which links of a robot do not touch each other."""

from pathlib import Path

import pytest

from featherstone_gait.model.placed import Placed
from featherstone_gait.robot_file import RobotFileWarning, load_robot, save_robot
from featherstone_gait.scene.compile import compile_scene

LINK = """<link name="{0}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>
</inertial><collision><geometry><sphere radius="0.1"/></geometry></collision></link>"""
JOINT = """<joint name="{0}{1}" type="revolute"><parent link="{0}"/><child link="{1}"/><origin xyz="1 0 0"/>
<axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="9" velocity="9"/></joint>"""
URDF = f'<robot name="chain">{"".join(LINK.format(x) for x in "abcd")}{"".join(JOINT.format(*x) for x in ("ab", "bc", "cd"))}</robot>'  # noqa: E501
SRDF = """<robot name="chain">
  <disable_collisions link1="c" link2="a" reason="Never"/>
  <disable_collisions link1="a" link2="c"/>
  <disable_collisions link1="b" link2="elsewhere"/>
</robot>"""


@pytest.fixture
def urdf(tmp_path):
    path = tmp_path / "urdf" / "chain.urdf"
    path.parent.mkdir()
    path.write_text(URDF, "utf-8")
    return path


def pairs(model):
    return {frozenset(link.partition("/")[2] for link in pair) for pair in compile_scene(model, pairs="all").pairs}


def test_without_a_file_all_but_neighbors_touch(urdf):
    assert load_robot(urdf).excluded == ()
    assert pairs(load_robot(urdf)) == {frozenset("ac"), frozenset("ad"), frozenset("bd")}


@pytest.mark.parametrize("place", ["chain.srdf", "../srdf/chain.srdf"])
def test_the_file_beside_a_urdf_is_read(urdf, place):
    path = urdf.parent / place
    path.parent.mkdir(exist_ok=True)
    path.write_text(SRDF, "utf-8")
    model = load_robot(urdf)
    assert model.excluded == (("a", "c"),)
    assert any("'elsewhere'" in note for note in model.notes)
    assert pairs(model) == {frozenset("ad"), frozenset("bd")}
    assert len(compile_scene([Placed(model, "one"), Placed(model, "two", position=(0.0, 2.0, 0.0))], pairs="all").pairs) == 2 * 2 + 16 - 1  # noqa: E501


def test_a_file_is_named(urdf, tmp_path):
    path = tmp_path / "other.srdf"
    text = '<robot><disable_default_collisions link="a"/><enable_collisions link1="d" link2="a"/></robot>'
    path.write_text(text, "utf-8")
    model = load_robot(urdf, srdf=path)
    assert {*model.excluded} == {("a", "b"), ("a", "c")}
    save_robot(model, tmp_path / "saved.urdf")
    assert load_robot(tmp_path / "saved.urdf").excluded == model.excluded


@pytest.mark.parametrize(
    ("text", "says"),
    [("<sdf/>", "<sdf>"), ('<robot><disable_collisions link1="a"/></robot>', "'link2'"), ("<robot", "not well-formed")],
)
def test_a_wrong_file_is_refused_if_named_and_else_ignored_with_a_warning(urdf, text, says):
    path = urdf.with_suffix(".srdf")
    path.write_text(text, "utf-8")
    with pytest.raises(ValueError, match=r"chain\.srdf: ") as error:
        load_robot(urdf, srdf=path)
    assert says in str(error.value)
    with pytest.warns(RobotFileWarning, match=says):
        assert load_robot(urdf).excluded == ()
    with pytest.raises(ValueError, match=r"nowhere\.srdf"):
        load_robot(urdf, srdf=Path("nowhere.srdf"))


def test_pairs_in_the_toml_of_a_robot_are_read_and_checked(urdf):
    toml = urdf.with_suffix(".toml")
    toml.write_text('excluded = [["b", "d"]]\n', "utf-8")
    assert pairs(load_robot(urdf)) == {frozenset("ac"), frozenset("ad")}
    toml.write_text('excluded = [["b", "x"]]\n', "utf-8")
    with pytest.raises(ValueError, match=r"line 1: excluded: there is no link 'x'"):
        load_robot(urdf)
