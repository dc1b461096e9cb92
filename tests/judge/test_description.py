"""Descriptions of what policies observe and drive."""

import pytest

from featherstone_gait.judge import packaged_descriptions, read_description

SIZES = {
    "apollo": 112,
    "berkeley_humanoid": 52,
    "g1": 103,
    "go1": 48,
    "microduck": 51,
    "open_duck_mini_v2": 101,
    "t1": 85,
}  # as their networks have
OWN = """
rate = 50.0
joints = ["left_knee", "right_knee"]
pose = [0.3, -0.3]
[action]
scale = [0.2, 0.3]
[[observation]]
name = "projected_gravity"
[[observation]]
name = "joint_pos"
history = 3
"""


def test_the_package_describes_robots_that_publish_policies():
    assert {name: read_description(name).size for name in packaged_descriptions()} == SIZES


def described(folder, text):
    path = folder / "mine.toml"
    path.write_text(text, "utf-8")
    return read_description(path)


def test_a_file_is_read(tmp_path):
    mine = described(tmp_path, OWN)
    assert (mine.size, mine.name, mine.action.scale) == (3 + 3 * 2, "mine", (0.2, 0.3))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("rate = 50.0\n", "", "lacks rate"),
        ("pose = [0.3, -0.3]\n", "", "lacks pose"),
        ("pose = [0.3, -0.3]", "pose = [0.3]", "pose has 1 numbers; give 2"),
        ("scale = [0.2, 0.3]", "scale = [0.2, 0.3, 0.4]", "action: scale has 3 numbers; give one, or 2"),
        ("rate = 50.0", "rate = 0.0", "rate is 0.0"),
        ("rate = 50.0", 'rate = "fast"', "rate is 'fast'"),
        ("scale = [0.2, 0.3]", 'scale = "wide"', "action: scale is 'wide'"),
        ("scale = [0.2, 0.3]", "max_speed = nan", "action: max_speed is nan"),
        ("[action]\nscale = [0.2, 0.3]", "action = 3", "action is 3; expected a table"),
        ("history = 3", "offset = [nan, 0.0]", "joint_pos.*offset is .nan"),
        ("rate = 50.0", "rates = 50.0", "unknown key 'rates' .did you mean rate"),
        ('name = "joint_pos"', 'name = "joint_position"', "observation: name is 'joint_position'"),
        ('name = "joint_pos"\n', "", "observation 1 has no name"),
        ("history = 3", "history = 0", "joint_pos.*history is 0"),
        ("history = 3", "histories = 3", "unknown key 'histories'"),
        ('name = "joint_pos"', 'name = "phase"', "phase.*period is missing"),
        ('name = "joint_pos"', 'name = "contacts"', "contacts.*links is missing"),
        ('"right_knee"]', '"left_knee"]', "'left_knee' twice"),
        ("pose = [0.3, -0.3]", 'pose = ["a", "b"]', "pose"),
    ],
)
def test_what_is_missing_or_wrong_is_named_with_the_file(old, new, said, tmp_path):
    assert old in OWN
    with pytest.raises(ValueError, match=rf"mine\.toml.*{said}"):
        described(tmp_path, OWN.replace(old, new))


def test_a_description_that_is_not_there_is_told_with_those_that_are():
    with pytest.raises(ValueError, match=r"microdck.*microduck"):
        read_description("microdck")
