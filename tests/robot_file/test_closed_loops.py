"""URDF states trees: where a file beside it, or names, state loops, a warning names their ends."""

import warnings

import pytest

from featherstone_gait import RobotFileError, RobotFileWarning, load_robot

LINKS = ("base", "left", "right", "tip_A", "tip_B")


def arms(ends=("tip_A", "tip_B")):
    """Two arms on a base, each with a frame at its end."""
    body = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    links = "".join(f'<link name="{name}">{body}</link>' for name in (*LINKS[:3], *ends))
    text = ""
    for side, end in zip(LINKS[1:3], ends):
        text += f'<joint name="turn_{side}" type="continuous"><parent link="base"/><child link="{side}"/></joint>'
        text += f'<joint name="fix_{end}" type="fixed"><parent link="{side}"/><child link="{end}"/></joint>'
    return f'<robot name="arms">{links}{text}</robot>'


@pytest.fixture
def robot(tmp_path):
    (tmp_path / "robot.urdf").write_text(arms())
    return tmp_path / "robot.urdf"


LISTS = (
    "closed_loop: [['tip_A', 'tip_B']]\ntype: ['6d']\n",
    "name_mot: [turn_left]\nclosed_loop:\n  - [tip_A, tip_B]  # at the end\ntype:\n  - 3d\n",
    "type: ['6d']\nclosed_loop:\n- - fix_tip_A\n  - fix_tip_B\n",
)


@pytest.mark.parametrize("text", LISTS)
def test_a_file_beside_it_that_lists_loops_is_named_with_their_ends(robot, text):
    robot.with_name("robot.yaml").write_text(text)
    with pytest.warns(RobotFileWarning, match="left open the loops .* between links 'tip_A' and 'tip_B': .*loops"):
        load_robot(robot)
    with pytest.raises(RobotFileError, match=r"\[\[loops\]\]"):
        load_robot(robot, strict=True)
    robot.with_suffix(".toml").write_text('[[loops]]\nname = "tip"\nkind = "connect"\na = "tip_A"\nb = "tip_B"\n')
    assert [loop.name for loop in load_robot(robot, strict=True).loops] == ["tip"]


@pytest.mark.parametrize("text", ["closed_loop: []\n", "closed_loop: [[other_A, other_B]]\n", "joints: [tip_A]\n", ""])
def test_files_that_list_no_loops_of_this_robot_say_nothing(robot, text):
    robot.with_name("robot.yaml").write_text(text)
    assert not load_robot(robot, strict=True).loops


@pytest.mark.parametrize(
    "ends", [("closed_loop1_A", "closed_loop1_B"), ("fermeture1_A", "x"), ("closing_1", "closing_2")]
)
def test_names_of_ends_of_loops_are_named(tmp_path, ends):
    (tmp_path / "arms.urdf").write_text(arms(ends))
    with pytest.warns(RobotFileWarning, match=f"left open the loops .* links '{ends[0]}'"):
        load_robot(tmp_path / "arms.urdf")


def test_usual_names_are_none_of_loops(robot):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_robot(robot)
