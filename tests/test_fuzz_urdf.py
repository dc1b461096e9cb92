"""URDF texts that are damaged at random are read or refused, in a time that does not explode, and nothing else.

FEATHERSTONE_GAIT_FUZZ sets how many (default: 1000; a release is tried with 20 000), FEATHERSTONE_GAIT_FUZZ_SEED where
to begin.
"""

import math
import os
import re
import warnings

import numpy as np
import pytest

from featherstone_gait.model import Model
from featherstone_gait.robot_file import RobotFileError, RobotFileWarning, load_robot

COUNT = int(os.environ.get("FEATHERSTONE_GAIT_FUZZ", "1000"))
SEED = int(os.environ.get("FEATHERSTONE_GAIT_FUZZ_SEED", "1"))
PARTS = 10  # tests, so that several processes share the work

BODY = (
    '<inertial><origin xyz="0.1 0 -0.2" rpy="0 0.3 0"/><mass value="0.5"/>'
    '<inertia ixx="0.002" ixy="1e-5" ixz="0" iyy="0.002" iyz="0" izz="0.001"/></inertial>'
)
SHAPES = (
    '<visual><geometry><sphere radius="1"/></geometry></visual>'
    '<collision name="c"><origin xyz="0 0 1" rpy="0 0 0"/><geometry><box size="1 2 3"/></geometry></collision>'
    '<collision><geometry><mesh filename="package://p/m.stl" scale="1 1 1"/></geometry></collision>'
    '<collision><geometry><cylinder radius="0.1" length="2"/></geometry></collision>'
)
LINKS = ["world", "base", "thigh", "shank", "foot", "finger1", "finger2"]
JOINTS = [
    ("free", "floating", "world", "base", ""),
    ("hip", "revolute", "base", "thigh", '<limit lower="-1.5" upper="1.5" effort="2" velocity="6"/>'),
    ("knee", "continuous", "thigh", "shank", '<dynamics damping="0.01" friction="0.02"/>'),
    ("ankle", "fixed", "shank", "foot", ""),
    ("grip", "prismatic", "shank", "finger1", '<limit lower="0" upper="0.1" effort="2" velocity="6"/>'),
    (
        "follow",
        "prismatic",
        "shank",
        "finger2",
        '<limit lower="0" upper="0.1" effort="2" velocity="6"/><mimic joint="grip" multiplier="-1" offset="0.1"/>',
    ),
]
URDF = "\n".join(
    [
        '<?xml version="1.0"?>',
        '<robot name="fuzzed">',
        *(f'<link name="{n}">\n{BODY if n != "world" else ""}\n{SHAPES if n == "foot" else ""}</link>' for n in LINKS),
        *(
            f'<joint name="{name}" type="{kind}">\n<parent link="{parent}"/>\n<child link="{child}"/>\n'
            f'<origin xyz="0 0 1" rpy="0 0 0.5"/>\n<axis xyz="0 1 0"/>\n{rest}\n</joint>'
            for name, kind, parent, child, rest in JOINTS
        ),
        "<transmission/><gazebo/>",
        "</robot>",
    ]
)
NUMBERS = "0 -1 1 1e-30 1e30 1e31 -1e30 nan inf -inf 1e-320 0.1.2 1,5 x 3.14159265358979 1e15 \u0663".split()
NAMES = [*LINKS, *(joint[0] for joint in JOINTS), "", "a b", "\u00e9", "'", "x" * 300]
TYPES = "revolute continuous prismatic fixed floating planar spherical ball hinge".split()
TAGS = "link joint inertial mass inertia origin axis limit mimic collision geometry robot visual xyz".split()


def choice(rng, items):
    return items[int(rng.integers(len(items)))]


def spans(pattern, text):
    return [match.span() for match in re.finditer(pattern, text, re.DOTALL)]


def replaced(rng, text, pattern, new):
    """The text with one match of a pattern, drawn at random, replaced."""
    found = spans(pattern, text)
    if not found:
        return text
    start, end = choice(rng, found)
    return text[:start] + new + text[end:]


def mutated(rng, text):
    """One change: of a number, a name, a type, a tag, an element, a line, or bytes."""
    kind = int(rng.integers(10))
    if kind < 3:
        return replaced(rng, text, r"(?<=[\" ])-?\d[\d.e+-]*(?=[\" ])", choice(rng, NUMBERS))
    if kind == 3:
        return replaced(rng, text, r"(?<=(?:name|link)=\")[^\"]*", choice(rng, NAMES))
    if kind == 4:
        return replaced(rng, text, r"(?<=type=\")[^\"]*", choice(rng, TYPES))
    if kind == 5:
        return replaced(rng, text, r"(?<=</|.<)\w+", choice(rng, TAGS))
    if kind == 6:
        return replaced(rng, text, r"<[^<>]*/>|\w+=\"[^\"]*\"", "")
    if kind == 7:
        lines = text.split("\n")
        a, b = rng.integers(len(lines), size=2)
        lines.insert(int(a), lines[int(b)])
        return "\n".join(lines)
    if kind == 8:
        element = choice(rng, spans(r"<(link|joint)\b.*?</\1>", text) or [(0, 0)])
        return text[: element[0]] + text[element[1] :] if rng.random() < 0.5 else text + text[slice(*element)]
    start = int(rng.integers(len(text) + 1))
    return text[:start] + choice(rng, ["<", ">", "&", '"', "\x00", "</link>", "<!--", " "]) + text[start:]


def read(path, how):
    """The robot, or why it is refused."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RobotFileWarning)
            return load_robot(path, **how)
    except RobotFileError as error:
        return error


@pytest.mark.parametrize("part", range(PARTS))
def test_a_damaged_urdf_is_a_robot_or_is_refused(tmp_path, part):
    path, count = tmp_path / "fuzzed.urdf", math.ceil(COUNT / PARTS)
    loaded = 0
    for k in range(part * count, (part + 1) * count):
        rng = np.random.default_rng([SEED, k])
        text = URDF
        for _ in range(int(rng.integers(1, 4))):
            text = mutated(rng, text)
        path.write_text(text, encoding="utf-8")
        how = {"strict": k % 3 == 0, "mimic": ("coupled", "free", "locked")[k % 5 % 3], "repair_inertia": k % 2 == 0}
        try:
            outcome = read(path, how)
        except Exception as error:
            raise AssertionError(f"mutation {k} of seed {SEED}, {how}:\n{text}") from error
        assert isinstance(outcome, Model) or (outcome.problems and str(path) in str(outcome))
        loaded += isinstance(outcome, Model)
    print(f"seed {SEED}, mutations {part * count} to {(part + 1) * count - 1}: {loaded} of {count} load")
    assert 0 < loaded < count
