"""Reading and writing robot files: what is legal means what URDF says, what is not is refused by name."""

import contextlib
import math
import re
import tomllib
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from featherstone_gait.model import (
    ContactPoint,
    Controller,
    Gearbox,
    Ground,
    Joint,
    Link,
    Mimic,
    Model,
    Servo,
    inertia_matrix,
)
from featherstone_gait.model.placed import SceneModel
from featherstone_gait.model.sensor import SampledSensor
from featherstone_gait.model.shapes import Box, Capsule, Cylinder, Mesh, Shape, Sphere
from featherstone_gait.robot_file import (
    RobotFileError,
    RobotFileNotFoundError,
    RobotFileWarning,
    gearbox_presets,
    load_robot,
    load_servo,
    save_robot,
)
from featherstone_gait.robot_file.scene_toml import PLANAR, TOP
from featherstone_gait.robot_file.sensors import SAMPLED
from featherstone_gait.robot_file.servos import SERVO_KEYS
from featherstone_gait.robot_file.settings import OF_SHAPE, OWN, PASSIVE, SECTIONS
from featherstone_gait.robot_file.source import MAX_BYTES
from featherstone_gait.robot_file.toml_lines import with_lines

URDF = """<?xml version="1.0"?>
<robot name="bot">
  <link name="base"/>
  <link name="thigh">
    <inertial>
      <origin xyz="0.1 0 -0.2" rpy="0 0 0"/>
      <mass value="0.5"/>
      <inertia ixx="0.002" ixy="0" ixz="0" iyy="0.002" iyz="0" izz="0.001"/>
    </inertial>
  </link>
  <link name="foot">
    <inertial><mass value="0.25"/><inertia ixx="1e-3" ixy="0" ixz="0" iyy="1e-3" iyz="0" izz="1e-3"/></inertial>
  </link>
  <joint name="hip" type="revolute">
    <parent link="base"/><child link="thigh"/>
    <origin xyz="0 0 1" rpy="0 0 0.5"/>
    <axis xyz="0 1 0"/>
    <limit lower="-1.5" upper="1.5" effort="2" velocity="6"/>
    <dynamics damping="0.01" friction="0.02"/>
  </joint>
  <joint name="ankle" type="continuous">
    <parent link="thigh"/><child link="foot"/>
    <axis xyz="0 1 0"/>
  </joint>
</robot>
"""

TOML = """base = "floating"
contacts = [{link = "foot", position = [0.1, 0, -0.02]}]
[servos]
default = "ax12"
[servos.joints.hip]
voltage_limit = 9.6
[locked.stiff]
ankle_deg = 90
"""

BODY = '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'


def write(folder, urdf=URDF, toml=None):
    """Write robot.urdf, and robot.toml if there is one; return the path of the first."""
    for name, content in (("robot.urdf", urdf), ("robot.toml", toml)):
        if content is not None:
            (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    return folder / "robot.urdf"


def swap(text, *pairs):
    """The text with each old part, which must be there exactly once, replaced."""
    for old, new in zip(pairs[::2], pairs[1::2]):
        assert text.count(old) == 1, f"{old!r} occurs {text.count(old)} times"
        text = text.replace(old, new)
    return text


def bad(name, *pairs, says):
    return pytest.param(swap(URDF, *pairs), says, id=name)


def chain(link, joint, count):
    """A robot of many links and joints, from templates of the index."""
    body = "".join(link.format(k) for k in range(count)) + "".join(joint.format(k, k + 1) for k in range(count - 1))
    return f'<robot name="long">{body}</robot>'


FIXED = '<joint name="j{0}" type="fixed"><parent link="l{0}"/><child link="l{1}"/></joint>'
BOMB = '<!DOCTYPE r [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]><robot name="&b;"/>'
EXTERNAL = '<!DOCTYPE r [<!ENTITY a SYSTEM "file:///etc/passwd">]><robot name="&a;"/>'
CYCLE = URDF.replace(
    '<link name="base"/>', f'<link name="base"/><link name="p">{BODY}</link><link name="q">{BODY}</link>'
)
CYCLE = CYCLE.replace(
    "</robot>",
    '<joint name="pq" type="continuous"><parent link="p"/><child link="q"/></joint>'
    '<joint name="qp" type="continuous"><parent link="q"/><child link="p"/></joint></robot>',
)
ROOTLESS = URDF.replace(
    "</robot>", '<joint name="back" type="fixed"><parent link="foot"/><child link="base"/></joint></robot>'
)
DECLARATION = '<?xml version="1.0"?>\n'
LIMIT = '<limit lower="-1.5" upper="1.5" effort="2" velocity="6"/>'
INERTIA = 'ixx="0.002" ixy="0" ixz="0" iyy="0.002" iyz="0" izz="0.001"'
FOOT_BODY = (
    '<inertial><mass value="0.25"/><inertia ixx="1e-3" ixy="0" ixz="0" iyy="1e-3" iyz="0" izz="1e-3"/></inertial>'
)


@pytest.mark.parametrize(
    ("change", "doubt"),
    [
        (lambda text: "\n<!-- a robot -->\n" + DECLARATION + text, r"skipped <\?xml ...\?> below line 1"),
        (lambda text: text.replace("</robot>", '<sensor:camera a="b" xacro:if="1"/></robot>'), "prefixes as declared"),
        (lambda text: "\n" + DECLARATION + text.replace("</robot>", "<a:b/></robot>"), "below line 1; took prefixes"),
    ],
)
def test_what_is_no_well_formed_xml_and_has_one_meaning_is_read(tmp_path, change, doubt):
    path, plain = tmp_path / "bot.urdf", URDF.removeprefix(DECLARATION)
    path.write_text(plain)
    whole = load_robot(path)
    path.write_text(change(plain))
    with pytest.warns(RobotFileWarning, match=doubt):
        model = load_robot(path)
    assert (model.links, model.joints) == (whole.links, whole.joints)
    with pytest.raises(RobotFileError, match=doubt.rpartition(";")[0] or doubt):
        load_robot(path, strict=True)


MALFORMED_URDF = [
    # not a URDF at all
    pytest.param("", ["is empty", "write the robot"], id="empty"),
    pytest.param("   \n\t", ["is empty", "write the robot"], id="blank"),
    pytest.param("hello, robot", ["not well-formed XML", "line 1", "correct the syntax"], id="plain_text"),
    pytest.param(b"\x7fELF\x02\x01\x01\x00", ["not well-formed XML", "correct the syntax"], id="binary"),
    pytest.param('{"name": "bot"}', ["not well-formed XML", "correct the syntax"], id="json"),
    pytest.param(URDF[:400], ["not well-formed XML", "line ", "correct the syntax"], id="cut_short"),
    pytest.param(
        URDF.replace("bot", "b\xf6t").encode("latin-1"), ["not well-formed XML", "line 2"], id="latin1_as_utf8"
    ),
    pytest.param(
        '<?xml version="1.0" encoding="klingon"?><robot name="a"/>', ["klingon", "UTF-8"], id="unknown_encoding"
    ),
    pytest.param(
        '<?xml version="1.0" encoding="utf-7"?><robot name="a"/>', ["encoding", "save it as UTF-8"], id="utf7"
    ),
    pytest.param('<sdf version="1.6"/>', ["<sdf>", "expected <robot>", "convert"], id="sdf"),
    pytest.param(BOMB, ["<!DOCTYPE", "entities", "remove"], id="entity_bomb"),
    pytest.param(EXTERNAL, ["<!DOCTYPE", "entities", "remove"], id="external_entity"),
    pytest.param("<!DOCTYPE robot>" + URDF[22:], ["<!DOCTYPE", "remove"], id="doctype"),
    pytest.param("<a>" * 200_000 + "</a>" * 200_000, ["<a>", "256 elements deep", "flatten"], id="nested_200000_deep"),
    pytest.param(
        URDF.replace("</robot>", "<gazebo>" * 300 + "</gazebo>" * 300 + "</robot>"),
        ["<gazebo>", "256", "flatten"],
        id="nested_in_skipped_element",
    ),
    pytest.param(URDF + " " * MAX_BYTES, ["larger than 10000000 bytes", "reduce"], id="huge_file"),
    pytest.param(
        chain('<link name="l{0}"/>', FIXED, 10_001), ["10001 links", "at most 10000", "reduce"], id="too_many_links"
    ),
    # tags, attributes, text
    bad(
        "unknown_tag", '<mass value="0.5"/>', '<mas value="0.5"/>', says=["'thigh'", "<inertial>", "<mas>", "spelling"]
    ),
    bad("misspelled_attribute", 'upper="1.5"', 'uper="1.5"', says=["joint 'hip'", "'uper'", "upper", "spelling"]),
    bad(
        "quaternion", 'xyz="0 0 1" rpy="0 0 0.5"', 'quat_xyzw="0 0 0 1"', says=["'hip'", "'quat_xyzw'", "rpy", "remove"]
    ),
    bad("xacro", "</robot>", '<x:if xmlns:x="http://ros.org/wiki/xacro"/></robot>', says=["xacro}if", "expand"]),
    bad("empty_link_name", 'link name="base"', 'link name=""', says=["link name ''", "plain name"]),
    bad(
        "unprintable_name",
        'joint name="ankle"',
        'joint name="an&#9;kle"',
        says=["joint name", r"an\tkle", "plain name"],
    ),
    bad("no_link_name", '<link name="foot">', "<link>", says=["link", "'name'", "missing", "add it"]),
    bad("no_joint_type", '"ankle" type="continuous"', '"ankle"', says=["joint 'ankle'", "'type'", "add it"]),
    bad("no_parent", '<parent link="base"/>', "", says=["joint 'hip'", "<parent>", "missing", "add it"]),
    bad("no_mass_element", '<mass value="0.5"/>', "", says=["'thigh'", "<mass>", "missing", "add it"]),
    bad("no_inertia_element", f"<inertia {INERTIA}/>", "", says=["'thigh'", "<inertia>", "missing", "add it"]),
    # numbers
    bad("decimal_comma", 'mass value="0.5"', 'mass value="0,5"', says=["'thigh'", "value is '0,5'", "0.15"]),
    bad("underscore", 'mass value="0.5"', 'mass value="1_0"', says=["'thigh'", "value is '1_0'", "write it like"]),
    bad("nan_mass", 'mass value="0.5"', 'mass value="nan"', says=["'thigh'", "value is 'nan'", "write it like"]),
    bad("inf_mass", 'mass value="0.5"', 'mass value="inf"', says=["'thigh'", "value is 'inf'", "write it like"]),
    bad("overflow", 'mass value="0.5"', 'mass value="1e999"', says=["'thigh'", "value is '1e999'", "up to 1e+30"]),
    bad("absurd_size", 'xyz="0.1 0 -0.2"', 'xyz="1e200 0 0"', says=["'thigh'", "xyz is '1e200'", "up to 1e+30"]),
    bad("hexadecimal", 'mass value="0.5"', 'mass value="0x1p-1"', says=["'thigh'", "'0x1p-1'", "write it like"]),
    bad("unit_in_number", 'mass value="0.5"', 'mass value="0.5kg"', says=["'thigh'", "'0.5kg'", "write it like"]),
    bad("arabic_digits", 'mass value="0.5"', 'mass value="\u0661"', says=["'thigh'", "'\u0661'", "write it like"]),
    bad(
        "endless_digits",
        'mass value="0.5"',
        f'mass value="{"1" * 2_000_000}x"',
        says=["'thigh'", "'1111", "write it like"],
    ),
    bad("empty_number", 'mass value="0.5"', 'mass value=""', says=["'thigh'", "value is ''", "write it like"]),
    bad("two_of_three", 'xyz="0 0 1"', 'xyz="0 0"', says=["joint 'hip'", "xyz='0 0'", "2 numbers", "expected 3"]),
    bad(
        "four_of_three",
        'rpy="0 0 0.5"',
        'rpy="0 0 0 1"',
        says=["joint 'hip'", "rpy='0 0 0 1'", "4 numbers", "expected 3"],
    ),
    bad("comma_separated", 'xyz="0 0 1"', 'xyz="0,0,1"', says=["joint 'hip'", "'0,0,1'", "separated by spaces"]),
    bad("nan_limit", 'lower="-1.5"', 'lower="NaN"', says=["joint 'hip'", "lower is 'NaN'", "write it like"]),
    # mass and inertia
    bad(
        "negative_mass",
        'mass value="0.5"',
        'mass value="-0.5"',
        says=["'thigh'", "mass is -0.5", ">= 0", "without <inertial>"],
    ),
    bad("massless_moves", FOOT_BODY, "", says=["'foot'", "mass 0.0", "> 0", "add <inertial>"]),
    bad(
        "point_mass_on_the_axis",
        FOOT_BODY,
        '<inertial><mass value="1"/><inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial>',
        says=["line 11: link 'foot'", "about joint 'ankle'", "0.0", "> 0", "small inertia"],
    ),
    bad(
        "nothing_between_two_hinges",
        """<inertial>
      <origin xyz="0.1 0 -0.2" rpy="0 0 0"/>
      <mass value="0.5"/>
      <inertia ixx="0.002" ixy="0" ixz="0" iyy="0.002" iyz="0" izz="0.001"/>
    </inertial>""",
        "",
        says=["line 4: link 'thigh'", "joint 'hip', joint 'ankle' can move together without inertia", "> 0", "fix"],
    ),
    # joints
    bad(
        "unknown_type", 'type="continuous"', 'type="hinge"', says=["joint 'ankle'", "'hinge'", "'revolute'", "use one"]
    ),
    bad(
        "zero_axis",
        '<axis xyz="0 1 0"/>\n    <limit',
        '<axis xyz="0 0 0"/>\n    <limit',
        says=["'hip'", "length 0.0", "0 0 1"],
    ),
    bad("crossed_limits", 'lower="-1.5"', 'lower="2.5"', says=["joint 'hip'", "lower 2.5, upper 1.5", "swap"]),
    bad("negative_effort", 'effort="2"', 'effort="-2"', says=["joint 'hip'", "effort is -2.0", ">= 0", "correct"]),
    bad(
        "negative_damping",
        'damping="0.01"',
        'damping="-0.01"',
        says=["joint 'hip'", "damping is -0.01", ">= 0", "correct"],
    ),
    bad(
        "negative_friction",
        'friction="0.02"',
        'friction="-1"',
        says=["joint 'hip'", "friction is -1.0", ">= 0", "correct"],
    ),
    # the tree
    pytest.param('<robot name="bot"/>', ["no link", "at least one"], id="no_links"),
    bad(
        "missing_parent",
        'parent link="base"',
        'parent link="bass"',
        says=["joint 'hip'", "no link 'bass'", "define it"],
    ),
    bad(
        "missing_child", 'child link="foot"', 'child link="feet"', says=["joint 'ankle'", "no link 'feet'", "define it"]
    ),
    bad(
        "self_joint",
        '<parent link="thigh"/>',
        '<parent link="foot"/>',
        says=["joint 'ankle'", "'foot'", "two different"],
    ),
    bad(
        "two_link_names",
        'link name="base"',
        'link name="foot"',
        says=["link name 'foot'", "more than once", "own name"],
    ),
    bad(
        "two_joint_names",
        'joint name="ankle"',
        'joint name="hip"',
        says=["line ", "joint name 'hip'", "more than once", "own name"],
    ),
    bad(
        "two_roots",
        '<link name="base"/>',
        f'<link name="base"/><link name="lost">{BODY}</link>',
        says=["'base', 'lost'", "no parent joint", "exactly one", "connect"],
    ),
    bad(
        "two_parents",
        'child link="foot"',
        'child link="thigh"',
        'parent link="thigh"',
        'parent link="foot"',
        says=["link 'thigh'", "'hip' and 'ankle'", "cut the closed loop"],
    ),
    pytest.param(CYCLE, ["'p', 'q'", "cycle", "remove one joint"], id="cycle_beside_the_tree"),
    pytest.param(ROOTLESS, ["'base', 'foot', 'thigh'", "cycle", "remove one joint"], id="cycle_through_the_root"),
]

LENIENT_URDF = [  # refused only if strict
    bad("unknown_top_tag", "</robot>", "<motor/></robot>", says=["robot 'bot'", "<motor>", "<link>", "remove"]),
    bad(
        "unknown_attribute",
        'mass value="0.5"',
        'mass value="0.5" unit="kg"',
        says=["'thigh'", "'unit'", "value", "remove"],
    ),
    bad("stray_text", '<mass value="0.5"/>', '0.5<mass value="0.5"/>', says=["'thigh'", "stray text '0.5'", "remove"]),
    bad("no_robot_name", '<robot name="bot">', "<robot>", says=["<robot>", "'name'", "missing", "add it"]),
    bad(
        "two_children",
        '<child link="foot"/>',
        '<child link="foot"/><child link="foot"/>',
        says=["'ankle'", "2", "<child>", "remove"],
    ),
    bad(
        "two_inertials",
        FOOT_BODY,
        FOOT_BODY * 2,
        says=["link 'foot'", "2 elements <inertial>", "remove"],
    ),
    bad("half_an_inertia", INERTIA, 'ixx="1" iyy="1" izz="1"', says=["'thigh'", "no ixy, ixz, iyz", "add it"]),
    bad("zero_mass", 'mass value="0.5"', 'mass value="0"', says=["'thigh'", "mass is 0", "mass > 0"]),
    bad("negative_moment", 'ixx="0.002"', 'ixx="-0.002"', says=["'thigh'", "-0.002", "positive definite", "correct"]),
    bad(
        "indefinite",
        INERTIA,
        INERTIA.replace('ixy="0"', 'ixy="0.003"'),
        says=["'thigh'", "0.003", "positive definite", "signs"],
    ),
    bad("triangle", 'izz="0.001"', 'izz="0.005"', says=["'thigh'", "0.005", "triangle inequality", "1e-06", "compute"]),
    bad("no_limit", LIMIT, "", says=["joint 'hip'", "'revolute'", "<limit>", "'continuous'"]),
    bad("empty_limit", LIMIT, "<limit/>", says=["joint 'hip'", "lower 0.0, upper 0.0", "state the limits"]),
    bad(
        "empty_inertial",
        '<link name="base"/>',
        '<link name="base"><inertial/></link>',
        says=["'base'", "is empty", "fill it"],
    ),
    bad("one_limit", 'lower="-1.5" ', "", says=["joint 'hip'", "<limit> states only upper", "state both"]),
    bad(
        "endless_limit", 'lower="-1.5" upper="1.5"', 'lower="-inf" upper="inf"', says=["'hip'", "-inf", "'continuous'"]
    ),
    bad("commas", 'xyz="0 0 1"', 'xyz="0, 0, 1"', says=["joint 'hip'", "xyz='0, 0, 1'", "commas", "by spaces"]),
    bad("foreign", "</robot>", '<a:b xmlns:a="c"/></robot>', says=["robot 'bot'", "<{c}b>", "expected <link>"]),
    bad(
        "no_limit_prismatic",
        LIMIT,
        "",
        'type="revolute"',
        'type="prismatic"',
        says=["'hip'", "'prismatic'", "<limit>", "state the limits"],
    ),
    bad("equal_limits", 'lower="-1.5"', 'lower="1.5"', says=["joint 'hip'", "lower 1.5, upper 1.5", "'fixed'"]),
    bad("limits_left_out", 'lower="-1.5" upper="1.5" ', "", says=["joint 'hip'", "lower 0.0, upper 0.0", "'fixed'"]),
]


@pytest.mark.parametrize(("urdf", "says"), MALFORMED_URDF)
def test_a_malformed_urdf_is_refused_by_name(tmp_path, urdf, says):
    for strict in (False, True):
        with pytest.raises(RobotFileError) as caught:
            load_robot(write(tmp_path, urdf), strict=strict)
        for part in ["robot.urdf: ", *says]:
            assert part in str(caught.value)


@pytest.mark.parametrize(("urdf", "says"), LENIENT_URDF)
def test_what_has_one_meaning_loads_with_a_note_and_one_warning(tmp_path, urdf, says):
    path = write(tmp_path, urdf)
    with pytest.warns(RobotFileWarning) as warned:
        robot = load_robot(path)
    assert len(warned) == 1
    assert warned[0].filename == __file__
    assert robot.notes[0] in str(warned[0].message)
    with pytest.raises(RobotFileError) as caught:
        load_robot(path, strict=True)
    for part in ["robot.urdf: ", "line ", *says]:
        assert part in str(caught.value)


def worse(name, *pairs, says):
    return pytest.param(swap(TOML, *pairs), says, id=name)


MALFORMED_TOML = [
    pytest.param("", ["is empty", "remove it"], id="empty"),
    pytest.param("base = floating", ["not TOML", "line 1", "correct the syntax"], id="no_quotes"),
    pytest.param(
        'base = "fixed"\nbase = "fixed"', ["not TOML", "overwrite a value", "correct the syntax"], id="key_twice"
    ),
    pytest.param(b'base = "fl\xf6ating"', ["not UTF-8", "save it as UTF-8"], id="latin1"),
    pytest.param("contacts = " + "[" * 100_000, ["too deeply", "flatten"], id="nested_100000_deep"),
    pytest.param("#" * (MAX_BYTES + 1), ["larger than 10000000 bytes", "reduce"], id="huge_file"),
    worse("unknown_key", "base =", "basis =", says=["'basis'", "base, contacts, servos, supply, locked", "correct"]),
    worse("unknown_base", '"floating"', '"flying"', says=["base is 'flying'", "'floating'", "use one"]),
    worse(
        "servos_not_a_table",
        'default = "ax12"',
        'joints = "ax12"',
        "[servos.joints.hip]\nvoltage_limit = 9.6\n",
        "",
        says=["servos.joints is 'ax12'", "[servos.joints]"],
    ),
    worse("unknown_servo", '"ax12"', '"ax13"', says=["'ax13'", "ax12", "use one"]),
    worse("servo_by_path", '"ax12"', '"../servos/ax12"', says=["'../servos/ax12'", "ax12", "use one"]),
    worse("servo_not_a_name", '"ax12"', "12", says=["servos", "default is 12", "quotes"]),
    worse("unknown_gearbox", '"ax12"', '"ax12"\ngearbox = "gold"', says=["ax12.toml", "'gold'", "physical", "use one"]),
    worse(
        "servos_of_no_joint",
        'default = "ax12"',
        "Kp = 30",
        "[servos.joints.hip]\nvoltage_limit = 9.6\n",
        "",
        says=["servos: Kp would act on no joint", 'default = "ax12"', "[servos.joints.NAME]"],
    ),
    worse(
        "unknown_servo_key", "voltage_limit", "voltage", says=["joint 'hip'", "'voltage'", "voltage_limit", "correct"]
    ),
    worse(
        "unknown_joint_in_servos",
        "servos.joints.hip",
        "servos.joints.knee",
        says=["'knee'", "'hip', 'ankle'", "use one"],
    ),
    worse("text_for_number", "= 9.6", '= "9.6"', says=["joint 'hip'", "voltage_limit is '9.6'", "without quotes"]),
    worse("bool_for_number", "= 9.6", "= true", says=["joint 'hip'", "voltage_limit is True", "expected a number"]),
    worse("number_too_large", "= 9.6", "= 1" + 400 * "0", says=["joint 'hip'", "voltage_limit is beyond", "correct"]),
    worse(
        "negative_resistance",
        "voltage_limit = 9.6",
        "resistance = -8",
        says=["'hip'", "resistance is -8.0", "> 0", "Ohm"],
    ),
    worse(
        "zero_ratio",
        "voltage_limit = 9.6",
        "ratio = 0",
        says=["'hip'", "ratio is 0.0", "> 0", "reverse the joint's axis"],
    ),
    worse("negative_rotor", "voltage_limit = 9.6", "rotor_inertia = -1e-7", says=["'hip'", "-1e-07", ">= 0", "kg m^2"]),
    worse("infinite_resistance", "voltage_limit = 9.6", "resistance = inf", says=["'hip'", "inf", "> 0", "correct"]),
    worse("nan_gain", "voltage_limit = 9.6", "Kp = nan", says=["'hip'", "Kp is nan", ">= 0", "correct"]),
    worse("zero_period", "voltage_limit = 9.6", "period = 0", says=["'hip'", "period is 0.0", "> 0", "unit s"]),
    worse("unknown_law", "voltage_limit = 9.6", 'law = "lqr"', says=["'hip'", "law is 'lqr'", "'state'", "use one"]),
    worse(
        "angle_twice",
        "voltage_limit = 9.6",
        "backlash = 0.1\nbacklash_deg = 1",
        says=["'hip'", "backlash", "twice", "keep one"],
    ),
    worse(
        "degrees_of_no_angle",
        "voltage_limit = 9.6",
        "period_deg = 1",
        says=["'hip'", "'period_deg'", "period", "correct"],
    ),
    worse("servo_not_complete", 'default = "ax12"', "", says=["joint 'hip'", "law is missing", "servo type"]),
    worse(
        "preset_without_type",
        'default = "ax12"',
        "",
        "voltage_limit = 9.6",
        'gearbox = "physical"',
        says=["joint 'hip'", "'physical'", "add type"],
    ),
    worse("unknown_locked_joint", "ankle_deg", "knee_deg", says=["locked", "'knee'", "'ankle'", "use one"]),
    worse("locked_outside", "ankle_deg", "hip_deg", says=["joint 'hip'", "1.5707", "-1.5 to 1.5", "between"]),
    worse(
        "locked_twice",
        "ankle_deg = 90",
        "ankle_deg = 90\nankle = 1",
        says=["locked.stiff", "'ankle'", "twice", "keep one"],
    ),
    worse("locked_nan", "ankle_deg = 90", "ankle = nan", says=["joint 'ankle'", "nan", "finite"]),
    worse("locked_text", "ankle_deg = 90", 'ankle = "90"', says=["locked.stiff", "'ankle'", "'90'", "without quotes"]),
    worse(
        "locked_not_a_table",
        "[locked.stiff]\nankle_deg = 90",
        "[locked]\nankle = 1",
        says=["locked.ankle is 1", "[locked.ankle]"],
    ),
    worse("contact_link", 'link = "foot"', 'link = "toe"', says=["contacts", "'toe'", "'foot'", "use one"]),
    worse(
        "contact_two_numbers", "[0.1, 0, -0.02]", "[0.1, 0]", says=["contacts[0]", "'foot'", "[0.1, 0]", "[x, y, z]"]
    ),
    worse("contact_nan", "[0.1, 0, -0.02]", "[nan, 0, 0]", says=["'foot'", "nan", "3 finite numbers", "correct"]),
    worse("contact_key", "position", "pos", says=["contacts[0]", "'pos'", "position", "correct"]),
    worse(
        "contact_not_a_list",
        '[{link = "foot", position = [0.1, 0, -0.02]}]',
        "3",
        says=["contacts is 3", "expected a list", "position"],
    ),
]


@pytest.mark.parametrize(("toml", "says"), MALFORMED_TOML)
def test_a_malformed_toml_is_refused_by_name(tmp_path, toml, says):
    with pytest.raises(RobotFileError) as caught:
        load_robot(write(tmp_path, URDF, toml))
    for part in [".toml: ", *says]:
        assert part in str(caught.value)


@pytest.mark.parametrize(
    ("locked", "says"),
    [
        ("loose", ["'loose'", "stiff", "[locked.loose]"]),
        ({"knee": 0.0}, ["'knee'", "'hip', 'ankle'", "use one"]),
        ({"hip": 2.0}, ["'hip'", "2.0", "-1.5 to 1.5", "between"]),
        ({"ankle": math.inf}, ["'ankle'", "inf", "expected a number"]),
        (["knee"], ["'knee'", "'hip', 'ankle'", "use one"]),
    ],
)
def test_locking_what_cannot_be_locked_is_refused_by_name(tmp_path, locked, says):
    with pytest.raises(RobotFileError) as caught:
        load_robot(write(tmp_path, URDF, TOML), locked=locked)
    for part in ["robot.urdf: load_robot(locked=", *says]:
        assert part in str(caught.value)


def test_a_file_that_is_not_there_is_both_a_value_error_and_a_file_not_found_error(tmp_path):
    for target in (tmp_path / "none.urdf", str(tmp_path / "none.urdf"), "no_such_robot", "../arm7", ""):
        with pytest.raises(RobotFileNotFoundError) as caught:
            load_robot(target)
        assert isinstance(caught.value, ValueError)
        assert isinstance(caught.value, FileNotFoundError)
    with pytest.raises(RobotFileNotFoundError, match=r"no_such_robot.*arm7.*humanoid.*path of a \.urdf"):
        load_robot("no_such_robot")


def test_a_directory_and_a_device_are_not_robots(tmp_path):
    with pytest.raises(RobotFileError, match=r"is a directory; give the \.urdf file"):
        load_robot(tmp_path)
    (tmp_path / "zero.urdf").symlink_to("/dev/zero")
    with pytest.raises(RobotFileError, match=r"zero\.urdf: is not a regular file; copy"):
        load_robot(tmp_path / "zero.urdf")


@pytest.mark.filterwarnings("ignore::featherstone_gait.robot_file.RobotFileWarning")
@settings(
    max_examples=200, deadline=None, database=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)  # a database would be beside the tests, which may be read alone
@given(st.integers(0, len(URDF) - 1), st.integers(0, 40), st.binary(max_size=8))
def test_a_damaged_file_is_read_or_refused_and_never_anything_else(tmp_path, start, length, noise):
    data = URDF.encode()
    path = write(tmp_path, data[:start] + noise + data[start + length :])
    with contextlib.suppress(RobotFileError):
        assert all(math.isfinite(link.mass) for link in load_robot(path).links)


def test_a_urdf_without_toml_is_a_fixed_robot_without_servos(tmp_path):
    robot = load_robot(write(tmp_path))
    assert (robot.name, robot.base, robot.nq, robot.nv) == ("bot", "fixed", 2, 2)
    assert (robot.locked, robot.servos, robot.contacts, robot.notes) == ({}, {}, (), ())
    assert robot.links[1] == Link("thigh", 0.5, (0.1, 0.0, -0.2), (0.002, 0.0, 0.0, 0.002, 0.0, 0.001))
    assert robot.joints[0] == Joint(
        "hip",
        "revolute",
        "base",
        "thigh",
        (0.0, 0.0, 1.0),
        (0.0, 0.0, 0.5),
        (0.0, 1.0, 0.0),
        -1.5,
        1.5,
        2.0,
        6.0,
        0.01,
        0.02,
    )
    assert robot.source == str(tmp_path / "robot.urdf")


def test_the_default_axis_is_x_as_urdf_says(tmp_path):
    text = swap(URDF, '<axis xyz="0 1 0"/>\n  </joint>', "</joint>")
    assert load_robot(write(tmp_path, text)).joints[1].axis == (1.0, 0.0, 0.0)


@pytest.mark.parametrize("scale", [2.0, 1e-200, 1e29])
def test_an_axis_is_scaled_to_unit_length_and_that_is_noted(tmp_path, scale):
    text = swap(URDF, '<axis xyz="0 1 0"/>\n  </joint>', f'<axis xyz="{3 * scale} 0 {4 * scale}"/></joint>')
    robot = load_robot(write(tmp_path, text))
    assert robot.joints[1].axis == pytest.approx((0.6, 0.0, 0.8), abs=1e-15)
    assert any("'ankle'" in note and "unit length" in note for note in robot.notes)


def test_a_rounded_axis_is_scaled_without_a_note(tmp_path):
    text = swap(URDF, '<axis xyz="0 1 0"/>\n  </joint>', '<axis xyz="0.70710678 0 0.70710678"/></joint>')
    robot = load_robot(write(tmp_path, text))
    assert math.hypot(*robot.joints[1].axis) == pytest.approx(1.0, abs=1e-15)
    assert robot.notes == ()


def test_inertia_given_in_turned_axes_is_turned_into_the_link(tmp_path):
    text = swap(URDF, 'xyz="0.1 0 -0.2" rpy="0 0 0"', f'xyz="0.1 0 -0.2" rpy="{math.pi / 2} 0 0"')
    assert load_robot(write(tmp_path, text)).links[1].inertia == pytest.approx((2e-3, 0, 0, 1e-3, 0, 2e-3), abs=1e-18)


def test_a_flat_plate_meets_the_triangle_inequality(tmp_path):
    text = swap(URDF, INERTIA, 'ixx="0.0012345" ixy="0" ixz="0" iyy="0.0023456" iyz="0" izz="0.0035801"')
    assert load_robot(write(tmp_path, text)).links[1].inertia[5] == 0.0035801


def test_what_plays_no_part_is_skipped_and_noted(tmp_path):
    shape = '<geometry><mesh filename="package://no_such_package/../../../etc/passwd"/></geometry>'
    text = swap(
        URDF,
        '<link name="base"/>',
        f'<link name="base"><visual>{shape}<material name="red"/></visual><collision>{shape}</collision></link>',
        "</robot>",
        '<material name="red"><color rgba="1 0 0 1"/></material><transmission name="t"><type>any</type></transmission>'
        '<gazebo reference="foot"><kp>9</kp></gazebo><gazebo/><mujoco><compiler/></mujoco>'
        '<ros2_control name="c" type="system"/></robot>',
        '<axis xyz="0 1 0"/>\n  </joint>',
        '<axis xyz="0 1 0"/><safety_controller k_velocity="1"/><calibration rising="0"/></joint>',
    )
    robot = load_robot(write(tmp_path, text))
    assert robot.links == load_robot(write(tmp_path)).links
    tags = "material transmission gazebo mujoco ros2_control visual collision safety_controller calibration".split()
    assert len(robot.notes) == len(tags)
    assert len(robot.shapes) == 1
    for tag in tags:
        assert sum(f"<{tag}>" in note for note in robot.notes) == 1
    assert "skipped <gazebo>, another simulator's settings: <kp>" in robot.notes


def test_all_attributes_that_urdf_knows_are_legal(tmp_path):
    text = swap(
        URDF,
        '<robot name="bot">',
        '<robot name="bot" version="1.0" xmlns:xacro="http://ros.org/wiki/xacro" '
        'xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" xsi:schemaLocation="a b">',
        'velocity="6"',
        'velocity="6" acceleration="1" deceleration="1" jerk="1"',
        '<link name="foot">',
        '<link name="foot" type="end">',
    )
    robot = load_robot(write(tmp_path, text))
    assert robot.joints == load_robot(write(tmp_path)).joints
    assert len(robot.notes) == 5


SPRING = "<springStiffness>1.5</springStiffness><springReference>0.5</springReference>"


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("gazebo", "expected"),
    [
        (f'<gazebo reference="hip"><implicitSpringDamper>1</implicitSpringDamper>{SPRING}</gazebo>', (1.5, 0.5)),
        ('<gazebo reference="hip"><springStiffness value=" 2 "/></gazebo>', (2.0, 0.0)),
        (f'<gazebo reference="hip">{SPRING}<springStiffness>3</springStiffness></gazebo>', (3.0, 0.5)),
        (
            '<gazebo reference="hip"><springStiffness>3</springStiffness></gazebo>'
            '<gazebo reference="foot"><turnGravityOff>false</turnGravityOff></gazebo>'
            '<gazebo reference="hip"><springReference>-1e-1</springReference><stopErp>0.2</stopErp></gazebo>',
            (3.0, -0.1),
        ),
    ],
)
def test_springs_of_joints_are_those_of_gazebo(tmp_path, gazebo, expected):
    path = write(tmp_path, swap(URDF, "</robot>", f"{gazebo}</robot>"))
    hip, ankle = load_robot(path, strict=True).joints
    assert (hip.stiffness, hip.spring_reference, ankle.stiffness) == (*expected, 0.0)
    assert hip.damping == 0.01


@pytest.mark.parametrize(
    ("gazebo", "says"),
    [
        (f'<gazebo reference="knee">{SPRING}</gazebo>', "springReference"),
        (f"<gazebo>{SPRING}</gazebo>", "springStiffness"),
        ('<gazebo reference="hip"><axis><spring_stiffness>1</spring_stiffness></axis></gazebo>', "spring_stiffness"),
        ('<gazebo reference="hip"><damping>0.7</damping></gazebo>', "damping"),
        ('<gazebo reference="foot"><turnGravityOff>true</turnGravityOff></gazebo>', "turnGravityOff"),
        ('<gazebo reference="foot"><gravity>0</gravity></gazebo>', "gravity"),
        ('<gazebo reference="foot"><dampingFactor>0.1</dampingFactor></gazebo>', "dampingFactor"),
        ('<gazebo><joint name="loop" type="revolute"/></gazebo>', "joint"),
    ],
)
def test_what_gazebo_would_add_to_the_motion_is_warned_of_or_refused(tmp_path, gazebo, says):
    path = write(tmp_path, swap(URDF, "</robot>", f"{gazebo}</robot>"))
    with pytest.warns(RobotFileWarning, match=says):
        robot = load_robot(path)
    assert robot.joints[0].damping == (0.7 if says == "damping" else 0.01)
    with pytest.raises(RobotFileError, match=says):
        load_robot(path, strict=True)


@pytest.mark.parametrize("stiffness", ["-1", "stiff", "", "nan"])
def test_a_spring_that_is_none_is_refused(tmp_path, stiffness):
    gazebo = f'<gazebo reference="hip"><springStiffness>{stiffness}</springStiffness></gazebo>'
    with pytest.raises(RobotFileError, match="hip"):
        load_robot(write(tmp_path, swap(URDF, "</robot>", f"{gazebo}</robot>")))


def test_the_toml_bears_the_weight_of_links(tmp_path):
    robot = load_robot(write(tmp_path, toml="[links.foot]\ngravity_compensation = 0.5"))
    assert [link.gravity_compensation for link in robot.links] == [0.0, 0.0, 0.5]
    with pytest.raises(RobotFileError, match="there is no link 'head'"):
        load_robot(write(tmp_path, toml="[links.head]\ngravity_compensation = 0.5"))


def test_a_spring_of_the_toml_comes_before_that_of_gazebo(tmp_path):
    text = swap(URDF, "</robot>", f'<gazebo reference="hip">{SPRING}</gazebo></robot>')
    hip = load_robot(write(tmp_path, text, "[joints.hip]\nstiffness = 4\narmature = 0.1")).joints[0]
    assert (hip.stiffness, hip.spring_reference, hip.armature) == (4.0, 0.5, 0.1)


def test_a_default_namespace_changes_nothing(tmp_path):
    text = swap(URDF, '<robot name="bot">', '<robot name="bot" xmlns="http://www.ros.org">')
    assert load_robot(write(tmp_path, text)).links == load_robot(write(tmp_path)).links


def test_utf16_with_a_byte_order_mark_is_read(tmp_path):
    text = swap(URDF, '<?xml version="1.0"?>', '<?xml version="1.0" encoding="utf-16"?>')
    assert load_robot(write(tmp_path, text.encode("utf-16"))).name == "bot"


def test_stops_of_a_continuous_joint_are_skipped_and_noted(tmp_path):
    text = swap(
        URDF, '<axis xyz="0 1 0"/>\n  </joint>', '<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="3"/></joint>'
    )
    robot = load_robot(write(tmp_path, text))
    assert (robot.joints[1].lower, robot.joints[1].upper) == (-math.inf, math.inf)
    assert (robot.joints[1].effort, robot.joints[1].velocity) == (3.0, math.inf)
    assert len(robot.notes) == 2


def test_a_floating_joint_from_a_massless_world_means_a_floating_base(tmp_path):
    world = '<link name="world"/><joint name="free" type="floating"><parent link="world"/><child link="base"/></joint>'
    text = swap(URDF, '<link name="base"/>', f'<link name="base">{BODY}</link>{world}')
    robot = load_robot(write(tmp_path, text))
    assert (robot.base, robot.nq, robot.nv) == ("floating", 9, 8)
    assert [link.name for link in robot.links] == ["base", "thigh", "foot"]
    assert any("'world'" in note for note in robot.notes)
    assert load_robot(tmp_path / "robot.urdf", base="fixed").base == "fixed"


def test_a_fixed_joint_from_a_massless_world_is_a_fixed_robot(tmp_path):
    world = '<link name="world"/><joint name="bolt" type="fixed"><parent link="world"/><child link="base"/></joint>'
    robot = load_robot(write(tmp_path, swap(URDF, '<link name="base"/>', f'<link name="base"/>{world}')))
    assert (robot.base, robot.nq, len(robot.links)) == ("fixed", 2, 4)


def test_a_floating_base_needs_a_mass(tmp_path):
    alone = swap(URDF, FOOT_BODY, "", re.search("<inertial>.*?</inertial>", URDF, re.DOTALL)[0], "")
    with pytest.raises(RobotFileError, match=r"link 'base' moves but has mass 0\.0 kg, with all that it carries 0\.0"):
        load_robot(write(tmp_path, alone), base="floating")
    with pytest.raises(RobotFileError, match=r"floating base 'base', joint 'hip' can move together without inertia"):
        load_robot(write(tmp_path), base="floating")


def test_a_massless_link_may_move_if_something_heavy_is_fixed_to_it(tmp_path):
    text = swap(URDF, FOOT_BODY, "", "</robot>", f'<link name="l9">{BODY}</link></robot>')
    joint = '<joint name="weld" type="{}"><parent link="foot"/><child link="l9"/></joint></robot>'
    assert load_robot(write(tmp_path, swap(text, "</robot>", joint.format("fixed")))).mass == 1.5
    hinge = joint.format("continuous")
    assert load_robot(write(tmp_path, swap(text, "</robot>", hinge))).joint_names == ("hip", "ankle", "weld")
    same_axis = hinge.replace("</joint>", '<axis xyz="0 -1 0"/></joint>')
    with pytest.raises(RobotFileError, match="joint 'ankle', joint 'weld' can move together without inertia"):
        load_robot(write(tmp_path, swap(text, "</robot>", same_axis)))
    assert load_robot(tmp_path / "robot.urdf", locked=["weld"]).joint_names == ("hip", "ankle")


def test_point_masses_off_the_axis_make_a_body_and_on_the_axis_do_not():
    def points(*places):
        links = [Link("base", 0.0, (0, 0, 0), (0,) * 6)]
        links += [Link(f"p{k}", 1.0, place, (0,) * 6) for k, place in enumerate(places)]
        joints = [Joint("hinge", "continuous", "base", "p0", axis=(0.8, 0.6, 0.0))]
        joints += [Joint(f"weld{k}", "fixed", "p0", f"p{k}") for k in range(1, len(places))]
        return Model("points", tuple(links), tuple(joints))

    assert points((0, 0, 0), (1, 0, 0), (0, 1, 0)).mass == 3.0
    assert points((0, 0, 0), (1, 1, 0), (2, 2, 0)).mass == 3.0
    with pytest.raises(ValueError, match=r"link 'p0' with 'p1', 'p2' rigidly attached moves about joint 'hinge' but"):
        points((0, 0, 0), (0.8, 0.6, 0), (1.6, 1.2, 0))


# ---------------------------------------------------------------------------------------------- all that is wrong


def test_all_problems_are_reported_at_once_with_their_lines(tmp_path):
    text = swap(
        URDF,
        'mass value="0.5"',
        'mass value="heavy"',
        'xyz="0 0 1"',
        'xyz="0 0"',
        'effort="2"',
        'effort="-2"',
        'damping="0.01"',
        'damping="-0.01"',
        'child link="foot"',
        'child link="feet"',
    )
    with pytest.raises(RobotFileError) as caught:
        load_robot(write(tmp_path, text))
    problems = [
        ("line 7: link 'thigh'", "heavy"),
        ("line 14: joint 'hip'", "effort is -2.0"),
        ("line 14: joint 'hip'", "damping is -0.01"),
        ("line 16: joint 'hip'", "'0 0' has 2 numbers"),
        ("line 21: joint 'ankle'", "no link 'feet'"),
    ]
    assert len(caught.value.problems) == len(problems)
    for found, (where, what) in zip(caught.value.problems, problems):
        assert found.startswith(where)
        assert what in found
        assert found in str(caught.value)
    assert "robot.urdf: 5 problems" in str(caught.value)


def test_a_message_shows_the_first_fifty_problems_and_the_error_has_all(tmp_path):
    links = "".join(f'<link name="l{k}"><inertial><mass value="x"/></inertial></link>' for k in range(40))
    with pytest.raises(RobotFileError, match="and 31 more") as caught:
        load_robot(write(tmp_path, f'<robot name="r">{links}</robot>'))
    assert len(caught.value.problems) == 81  # no number and no inertia in each, and one of the roots
    assert str(caught.value).count("\n") == 51


def test_strict_reports_the_masses_with_all_the_rest(tmp_path):
    text = swap(URDF, FOOT_BODY, "<contact/>", '<parent link="thigh"/>', '<joint_properties/><parent link="thigh"/>')
    with pytest.raises(RobotFileError) as caught:
        load_robot(write(tmp_path, text), strict=True)
    parts = ["line 12: link 'foot': unknown element <contact>", "line 11: link 'foot' moves but has mass 0.0 kg"]
    parts.append("line 22: joint 'ankle': unknown element <joint_properties>")
    assert len(caught.value.problems) == len(parts)
    assert all(part in str(caught.value) for part in parts)


def test_what_stands_in_many_places_is_one_note(tmp_path):
    text = URDF.replace('<parent link="', '<joint_properties/><parent link="').replace("<mass ", '<mass unit="kg" ')
    with pytest.warns(RobotFileWarning) as warned:
        robot = load_robot(write(tmp_path, text))
    assert robot.notes == (
        "link 'thigh' <inertial> <mass> and 1 more: unknown attribute 'unit' of <mass>: ignored",
        "joint 'hip' and 1 more: unknown element <joint_properties>: ignored",
    )
    assert all(note in str(warned[0].message) for note in robot.notes)


# ---------------------------------------------------------------------------------------------- what lenient means


@pytest.mark.filterwarnings("ignore::featherstone_gait.robot_file.RobotFileWarning")
def test_of_two_elements_the_first_counts(tmp_path):
    text = swap(URDF, '<axis xyz="0 1 0"/>\n  </joint>', '<axis xyz="0 0 1"/><axis xyz="0 1 0"/></joint>')
    robot = load_robot(write(tmp_path, text))
    assert robot.joints[1].axis == (0.0, 0.0, 1.0)
    assert robot.notes == ("joint 'ankle': 2 elements <axis>: the first was taken",)
    same = swap(URDF, '<axis xyz="0 1 0"/>\n  </joint>', '<axis xyz="0 1 0"/><axis xyz="0 1 0"/></joint>')
    assert load_robot(write(tmp_path, same)).notes == ("joint 'ankle': 2 elements <axis>: all the same",)


@pytest.mark.filterwarnings("ignore::featherstone_gait.robot_file.RobotFileWarning")
@pytest.mark.parametrize("limit", ["", "<limit/>", '<limit effort="2"/>', '<limit lower="0" upper="0.0"/>'])
def test_a_hinge_without_limits_or_both_zero_has_no_stops(tmp_path, limit):
    hip = load_robot(write(tmp_path, swap(URDF, LIMIT, limit))).joints[0]
    assert (hip.type, hip.lower, hip.upper) == ("continuous", -math.inf, math.inf)
    slide = swap(URDF, LIMIT, limit, 'name="hip" type="revolute"', 'name="hip" type="prismatic"')
    hip = load_robot(write(tmp_path, slide)).joints[0]
    assert (hip.type, hip.lower, hip.upper) == ("prismatic", -math.inf, math.inf)


@pytest.mark.filterwarnings("ignore::featherstone_gait.robot_file.RobotFileWarning")
def test_a_joint_whose_limits_are_one_position_is_held_there(tmp_path):
    path = write(tmp_path, swap(URDF, 'lower="-1.5" upper="1.5"', 'lower="0.5" upper="0.5"'))
    robot = load_robot(path)
    assert (robot.locked, robot.joint_names) == ({"hip": 0.5}, ("ankle",))
    assert load_robot(path, locked=()).locked == {"hip": 0.5}
    with pytest.raises(RobotFileError, match="outside its limits"):
        load_robot(path, locked={"hip": 0.0})
    save_robot(robot, tmp_path / "saved.urdf")
    assert load_robot(tmp_path / "saved.urdf").locked == {"hip": 0.5}
    with pytest.raises(ValueError, match=r"joint 'hip': limits lower 0\.5, upper 0\.5"):
        replace(robot, locked={})


@pytest.mark.filterwarnings("ignore::featherstone_gait.robot_file.RobotFileWarning")
def test_an_impossible_inertia_is_taken_as_it_is_or_repaired(tmp_path):
    path = write(tmp_path, swap(URDF, 'izz="0.001"', 'izz="0.005"'))
    assert load_robot(path).links[1].inertia == (0.002, 0.0, 0.0, 0.002, 0.0, 0.005)
    repaired = load_robot(path, repair_inertia=True, strict=True)
    assert repaired.links[1].inertia == pytest.approx((0.003, 0.0, 0.0, 0.003, 0.0, 0.003), rel=1e-15)
    assert "from 0.002, 0.002, 0.005 to 0.003, 0.003, 0.003" in repaired.notes[0]
    write(tmp_path, swap(URDF, INERTIA, INERTIA.replace('ixy="0"', 'ixy="0.003"')))
    moments = np.linalg.eigvalsh(inertia_matrix(load_robot(path, repair_inertia=True).links[1].inertia))
    assert moments == pytest.approx([0.002, 0.002, 0.002], rel=1e-8)  # (0 + 0.001 + 0.005) / 3
    assert load_robot(write(tmp_path), repair_inertia=True).links == load_robot(path).links


MILLIMETERS = ('ixx="1e-3"', 'ixx="1e3"', 'iyy="1e-3"', 'iyy="1e3"', 'izz="1e-3"', 'izz="1e3"')  # of the foot


def test_an_inertia_far_beyond_the_robots_size_is_doubted(tmp_path):
    """In kg mm^2 the foot of 0.25 kg has a radius of gyration of 63 m, in a robot of a meter."""
    path = write(tmp_path, swap(URDF, *MILLIMETERS))
    with pytest.warns(RobotFileWarning, match="'foot'.* 63.2 m"):
        robot = load_robot(path)
    assert robot.link("foot").inertia[0] == 1e3
    with pytest.raises(RobotFileError, match="line 11: link 'foot'"):
        load_robot(path, strict=True)


@pytest.mark.filterwarnings("ignore::featherstone_gait.robot_file.RobotFileWarning")
@pytest.mark.parametrize(("radius", "doubted"), [(1.5, True), (1.1, False)])
def test_an_inertia_far_beyond_its_shape_is_doubted(tmp_path, radius, doubted):
    """A foot of 12 cm on a robot of 1.35 m: ten times its size and the robot's size are what a radius may be."""
    box = '<link name="foot"><collision><geometry><box size="0.24 0.02 0.02"/></geometry></collision>'
    inertia = [x.replace("1e3", repr(0.25 * radius**2)) for x in MILLIMETERS]
    robot = load_robot(write(tmp_path, swap(URDF, '<link name="foot">', box, *inertia)))
    assert any("'foot'" in note for note in robot.notes) == doubted


@pytest.mark.filterwarnings("error")
def test_an_inertia_that_never_acts_is_not_doubted(tmp_path):
    """The inertia of a fixed root never acts, and without shapes 1 kg m^2 of a kilogram may be right."""
    heavy = BODY.replace('"1"', '"1e3"').replace('mass value="1e3"', 'mass value="1"')
    text = swap(URDF, '<link name="base"/>', f'<link name="base">{heavy}</link>', '"0 0 1" rpy', '"0 0 .01" rpy')
    text = swap(text, '<mass value="0.25"/>', '<mass value="1"/>', *(x.replace("1e3", "1") for x in MILLIMETERS))
    assert load_robot(write(tmp_path, text)).link("base").inertia[0] == 1e3
    with pytest.raises(RobotFileWarning, match="base"):
        load_robot(write(tmp_path, text), base="floating")


@pytest.mark.filterwarnings("ignore::featherstone_gait.robot_file.RobotFileWarning")
def test_what_makes_the_mass_matrix_indefinite_is_refused_unless_repaired(tmp_path):
    text = swap(URDF, FOOT_BODY, FOOT_BODY.replace('iyy="1e-3"', 'iyy="-1e-3"'))
    with pytest.raises(RobotFileError, match=r"line 11: link 'foot' moves about joint 'ankle' but .*-0\.001"):
        load_robot(write(tmp_path, text))
    assert load_robot(tmp_path / "robot.urdf", repair_inertia=True).joint_names == ("hip", "ankle")


def test_a_massless_cross_between_two_hinges_moves(tmp_path):
    """A universal joint, as many files have it."""
    thigh = re.search("<inertial>.*?</inertial>", URDF, re.DOTALL)[0]
    text = swap(URDF, thigh, "", '<axis xyz="0 1 0"/>\n  </joint>', '<axis xyz="1 0 0"/></joint>')
    robot = load_robot(write(tmp_path, text))
    assert (robot.joint_names, robot.notes) == (("hip", "ankle"), ())


# ---------------------------------------------------------------------------------------------- joints that follow

FINGER = "".join(f'<link name="f{k}">{BODY}</link>' for k in range(5)) + "".join(
    f'<joint name="j{k}" type="revolute"><parent link="f{k - 1}"/><child link="f{k}"/><axis xyz="0 1 0"/>'
    f'<limit lower="-1" upper="1" effort="1" velocity="1"/>@{k}</joint>'
    for k in range(1, 5)
)


def finger(folder, **mimics):
    """A chain of four joints with <mimic> elements by joint name."""
    text = FINGER
    for k in range(1, 5):
        text = text.replace(f"@{k}", mimics.get(f"j{k}", ""))
    return write(folder, f'<robot name="finger">{text}</robot>')


def test_mimic_chains_lead_to_the_joint_at_their_end(tmp_path):
    path = finger(
        tmp_path,
        j2='<mimic joint="j1" multiplier="2" offset="0.1"/>',
        j3='<mimic joint="j2" multiplier="-0.5" offset="0.2"/>',
        j4='<mimic joint="j3"/>',
    )
    robot = load_robot(path, strict=True)
    assert robot.couplings == (
        ("j2", "j1", 2.0, 0.1),
        ("j3", "j1", -1.0, pytest.approx(0.15)),
        ("j4", "j1", -1.0, pytest.approx(0.15)),
    )
    assert robot.joints[1].mimic == Mimic("j1", 2.0, 0.1)
    free = load_robot(path, mimic="free")
    assert (free.couplings, free.locked, len(free.notes)) == ((), {}, 3)
    held = load_robot(path, mimic="locked")
    assert (held.joint_names, held.couplings) == (("j1",), ())
    assert held.locked == pytest.approx({"j2": 0.1, "j3": 0.15, "j4": 0.15})


def test_a_follower_of_a_joint_that_does_not_move_is_held(tmp_path):
    path = finger(tmp_path, j2='<mimic joint="j1" multiplier="2" offset="0.1"/>', j3='<mimic joint="j2"/>')
    assert load_robot(path, locked={"j1": 0.2}).locked == pytest.approx({"j1": 0.2, "j2": 0.5, "j3": 0.5})
    with pytest.warns(RobotFileWarning, match="'j2' is held at 1, since .* asks for 1.9, beyond its limits"):
        far = load_robot(path, locked={"j1": 0.9})
    assert far.locked == {"j1": 0.9, "j2": 1.0, "j3": 1.0}  # as far as they go
    middle = load_robot(path, locked={"j2": 0.0})
    assert (middle.locked, middle.couplings) == ({"j2": 0.0, "j3": 0.0}, ())
    path.write_text(path.read_text().replace('name="j1" type="revolute"', 'name="j1" type="fixed"'))
    assert load_robot(path).locked == pytest.approx({"j2": 0.1, "j3": 0.1})


def test_a_follower_that_is_never_within_its_limits_is_doubted(tmp_path):
    path = finger(tmp_path, j2='<mimic joint="j1" offset="5"/>')
    with pytest.warns(RobotFileWarning, match="'j2' follows joint 'j1', whose limits put it between 4 and 6, beyond"):
        load_robot(path)
    with pytest.raises(RobotFileError, match="beyond its own -1 to 1; remove it"):
        load_robot(path, strict=True)


@pytest.mark.parametrize(
    ("mimics", "says"),
    [
        ({"j2": '<mimic joint="j9"/>'}, ["joint 'j2'", "'j9'", "not there", "correct the name"]),
        ({"j2": '<mimic joint="j2"/>'}, ["joint 'j2'", "circle", "remove one <mimic>"]),
        ({"j1": '<mimic joint="j2"/>', "j2": '<mimic joint="j1"/>'}, ["'j1', 'j2'", "circle", "remove one <mimic>"]),
        ({"j2": "<mimic/>"}, ["joint 'j2'", "'joint' of <mimic> is missing", "add it"]),
        ({"j2": '<mimic joint="j1" multiplier="x"/>'}, ["joint 'j2'", "multiplier is 'x'", "write it like"]),
    ],
)
def test_a_mimic_that_leads_nowhere_is_refused(tmp_path, mimics, says):
    with pytest.raises(RobotFileError) as caught:
        load_robot(finger(tmp_path, **mimics))
    for part in ["robot.urdf: line 1: ", *says]:
        assert part in str(caught.value)


def test_the_ways_to_take_a_mimic_are_three(tmp_path):
    with pytest.raises(ValueError, match="mimic='loose'; expected 'coupled', 'free' or 'locked'"):
        load_robot(write(tmp_path), mimic="loose")


def test_chains_of_couplings_lead_to_the_joint_at_their_end(tmp_path):
    robot = load_robot(finger(tmp_path))
    second = replace(robot.joints[1], mimic=Mimic("j1"))
    assert replace(robot, joints=(robot.joints[0], second, *robot.joints[2:])).couplings == (("j2", "j1", 1.0, 0.0),)
    third = replace(robot.joints[2], mimic=Mimic("j2", 2.0))
    chained = replace(robot, joints=(robot.joints[0], second, third, robot.joints[3]))
    assert chained.couplings == (("j2", "j1", 1.0, 0.0), ("j3", "j1", 2.0, 0.0))
    with pytest.raises(ValueError, match="joint 'j3': it follows 'j9', and there is no such joint"):
        replace(robot, joints=(*robot.joints[:2], replace(third, mimic=Mimic("j9")), robot.joints[3]))


def test_a_coupled_joint_needs_an_inertia_of_its_own(tmp_path):
    """The articulated-body algorithm couples what it has solved."""
    text = finger(tmp_path, j4='<mimic joint="j1"/>').read_text()
    light = text.replace(f'<link name="f4">{BODY}</link>', '<link name="f4"/>')
    for mimic in ("coupled", "free"):
        with pytest.raises(RobotFileError, match="link 'f4' moves but has mass"):
            load_robot(write(tmp_path, light), mimic=mimic)
    assert load_robot(tmp_path / "robot.urdf", mimic="locked").couplings == ()


# ---------------------------------------------------------------------------------------------- collision shapes


def shaped(*geometries):
    """The robot with shapes on its foot."""
    shapes = "".join(
        f'<collision name="c{k}"><origin xyz="0 0 0.{k}" rpy="0.5 0 0"/><geometry>{geometry}</geometry></collision>'
        for k, geometry in enumerate(geometries)
    )
    return swap(URDF, '<link name="foot">', f'<link name="foot">{shapes}')


def test_collision_shapes_are_read(tmp_path):
    text = shaped(
        '<box size="1 2 3"/>',
        '<sphere radius="0.5"/>',
        '<cylinder radius="0.5" length="2"/>',
        '<capsule radius="0.25" length="1"/>',
        '<mesh filename="foot.stl" scale="0.001 0.001 -0.001"/>',
    )
    (tmp_path / "foot.stl").touch()
    robot = load_robot(write(tmp_path, text), strict=True)
    mesh = Mesh(str(tmp_path / "foot.stl"), (0.001, 0.001, -0.001))
    geometries = (Box((1.0, 2.0, 3.0)), Sphere(0.5), Cylinder(0.5, 2.0), Capsule(0.25, 1.0), mesh)
    assert robot.shapes == tuple(
        Shape("foot", geometry, (0.0, 0.0, k / 10), (0.5, 0.0, 0.0), f"c{k}") for k, geometry in enumerate(geometries)
    )
    assert robot.notes == ()
    save_robot(robot, tmp_path / "saved.urdf")
    assert load_robot(tmp_path / "saved.urdf").shapes == robot.shapes


@pytest.mark.parametrize("slashes", ["//", "///"])
@pytest.mark.parametrize(
    "where",
    [
        "bot_description/meshes/foot.stl",
        "bot_description/robots/bot_description/meshes/foot.stl",
        "other/bot_description/meshes/foot.stl",
    ],
)
def test_a_package_is_looked_for_above_the_urdf(tmp_path, where, slashes):
    folder = tmp_path / "bot_description" / "robots"
    folder.mkdir(parents=True)
    mesh = tmp_path / where
    mesh.parent.mkdir(parents=True)
    mesh.touch()
    name = f"package:{slashes}bot_description/meshes/foot.stl"
    robot = load_robot(write(folder, shaped(f'<mesh filename="{name}"/>')))
    assert (robot.shapes[0].geometry, robot.notes) == (Mesh(str(mesh)), ())


def test_packages_come_from_the_caller_and_from_ros(tmp_path, monkeypatch):
    for name in ("a", "b"):
        (tmp_path / name / "pkg").mkdir(parents=True)
        (tmp_path / name / "pkg" / f"{name}.stl").touch()
    (tmp_path / "deep" / "x" / "y" / "z" / "u").mkdir(parents=True)
    meshes = [f'<mesh filename="package://pkg/{name}.stl"/>' for name in ("a", "b", "c")]
    path = write(tmp_path / "deep" / "x" / "y" / "z" / "u", shaped(*meshes))
    assert [shape.geometry.file for shape in load_robot(path).shapes] == [f"package://pkg/{k}.stl" for k in "abc"]
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "b"))
    robot = load_robot(path, package_dirs=[tmp_path / "a"])
    files = [str(tmp_path / "a/pkg/a.stl"), str(tmp_path / "b/pkg/b.stl"), "package://pkg/c.stl"]
    assert [shape.geometry.file for shape in robot.shapes] == files
    assert robot.notes == ("mesh 'package://pkg/c.stl' of a <collision> is not there: its path is kept as written",)


@pytest.mark.parametrize(
    ("geometry", "says"),
    [
        ('<sphere radius="-1"/>', "radius is -1.0 m"),
        ('<box size="1 2"/>', "size='1 2' has 2 numbers"),
        ("<cylinder radius='1'/>", "attribute 'length' of <cylinder> is missing"),
        ("<cone/>", "<collision> has 0 geometries; expected one of <box>, <sphere>"),
        ("<mesh/>", "<mesh> has no filename"),
    ],
)
def test_a_shape_that_cannot_be_is_left_out_and_noted(tmp_path, geometry, says):
    path = write(tmp_path, shaped(geometry, '<sphere radius="1"/>'))
    with pytest.warns(RobotFileWarning, match="the shape was left out"):
        robot = load_robot(path)
    assert [shape.name for shape in robot.shapes] == ["c1"]
    assert any(says in note for note in robot.notes)
    with pytest.raises(RobotFileError, match="line 11: link 'foot'"):
        load_robot(path, strict=True)


BOX = '<geometry><box size="1 1 1"/></geometry>'
DRAKE = 'xmlns:drake="http://drake.mit.edu"'


def colliding(content, end=""):
    """The robot with a collision of this content on its foot."""
    text = swap(URDF, '<link name="foot">', f'<link name="foot"><collision>{content}</collision>')
    return swap(text, "</robot>", f"{end}</robot>")


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (f'<orgin xyz="0 0 1"/>{BOX}', "'origin'"),
        (f'<origin xyz="0 0 1" rypy="1 0 0"/>{BOX}', "'rpy'"),
        (f'<origin quat_xyzw="0 0 0 1"/>{BOX}', "rpy"),
        ('<geometry><boxx size="1 1 1"/></geometry>', "'box'"),
    ],
)
def test_a_misspelled_part_of_a_shape_is_refused_as_one_of_an_inertia_is(tmp_path, content, says):
    with pytest.raises(RobotFileError, match=f"line 11: .*<collision>.*{says}"):
        load_robot(write(tmp_path, colliding(content)))


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (f'<origin xyz="0 0 1"/><origin xyz="0 0 2"/>{BOX}', "2 elements <origin>"),
        (f'<origin xyz="0, 0, 1"/>{BOX}', "commas"),
        ('<origin xyz="0 0 1"/><geometry><box size="1 1 1" scale="2 2 2"/></geometry>', "'scale'"),
        (f'<origin xyz="0 0 1"/>{BOX}<material><contact mu="0"/></material>', "<contact>"),
    ],
)
def test_what_is_ignored_of_a_shape_is_warned_of(tmp_path, content, says):
    path = write(tmp_path, colliding(content))
    with pytest.warns(RobotFileWarning, match=says):
        assert load_robot(path).shapes == (Shape("foot", Box((1.0, 1.0, 1.0)), (0.0, 0.0, 1.0)),)
    with pytest.raises(RobotFileError, match=says):
        load_robot(path, strict=True)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("content", "end"),
    [
        (f'<drake:proximity_properties {DRAKE}><drake:mu_dynamic value="0.1"/><drake:mu_static value="0.2"/>'
         "</drake:proximity_properties>", ""),
        (f'<drake:proximity_properties {DRAKE}><drake:mu_static value="0.1"/></drake:proximity_properties>', ""),
        ('<contact_coefficients mu="0.1" kp="1000"/>', ""),
        ("", '<gazebo reference="foot"><mu1>0.1</mu1><mu2>0.1</mu2></gazebo>'),
        ('<contact_coefficients mu="0.1"/>', '<gazebo reference="foot"><mu1>0.7</mu1></gazebo>'),
    ],
)  # fmt: skip
def test_friction_that_other_programs_read_is_that_of_the_shape(tmp_path, content, end):
    assert load_robot(write(tmp_path, colliding(f"{BOX}{content}", end))).shapes[0].friction == 0.1


@pytest.mark.parametrize(
    ("content", "end", "mu", "says"),
    [
        ("<surface><friction><ode><mu>0.3</mu></ode></friction></surface>", "", 0.3, "<surface>"),
        ("", '<gazebo reference="foot"><mu1>0.3</mu1><mu2>0.1</mu2></gazebo>', 0.3, "<mu2>"),
        ("", '<gazebo reference="hip"><mu1>0.3</mu1></gazebo>', None, "<mu1>"),
        ("", "<gazebo><static>true</static></gazebo>", None, "<static>"),
    ],
)
def test_friction_that_is_doubtful_is_warned_of(tmp_path, content, end, mu, says):
    path = write(tmp_path, colliding(f"{BOX}{content}", end))
    with pytest.warns(RobotFileWarning, match=says):
        assert load_robot(path).shapes[0].friction == mu
    with pytest.raises(RobotFileError, match=says):
        load_robot(path, strict=True)


def test_a_rotor_behind_a_gear_adds_its_inertia_times_the_square_of_the_ratio(tmp_path):
    rotor = f'<drake:gear_ratio {DRAKE} value="100"/><drake:rotor_inertia {DRAKE} value="1e-3"/>'
    end = f'<transmission name="t"><joint name="hip"/><actuator name="m">{rotor}</actuator></transmission>'
    robot = load_robot(write(tmp_path, colliding(BOX, end)), strict=True)
    assert {joint.name: joint.armature for joint in robot.joints}["hip"] == pytest.approx(10.0, rel=1e-15)
    with pytest.raises(RobotFileError, match="'hap'"):
        load_robot(write(tmp_path, colliding(BOX, end.replace("hip", "hap"))))


# ---------------------------------------------------------------------------------------------- settings


def test_base_and_locked_are_the_callers_then_the_tomls_then_the_default(tmp_path):
    heavy = swap(URDF, '<link name="base"/>', f'<link name="base">{BODY}</link>')
    path = write(tmp_path, heavy, TOML + "[locked.default]\nhip = 0.25\n")
    assert (load_robot(path).base, load_robot(path, base="fixed").base) == ("floating", "fixed")
    assert load_robot(path).locked == {"hip": 0.25}
    assert load_robot(path, locked="stiff").locked == {"ankle": math.pi / 2}
    assert load_robot(path, locked={"ankle": 2}).locked == {"ankle": 2.0}
    assert load_robot(path, locked=("hip", "ankle")).joint_names == ()
    assert load_robot(path, locked=()).joint_names == ("hip", "ankle")
    with pytest.raises(RobotFileError, match=r"base is 'flying'; expected one of 'fixed', 'floating'"):
        load_robot(path, base="flying")


def test_servos_come_from_the_default_and_the_joints_own_settings(tmp_path):
    heavy = swap(URDF, '<link name="base"/>', f'<link name="base">{BODY}</link>')
    toml = swap(TOML, "voltage_limit = 9.6", 'gearbox = "code_2012"\nKp = 73\nencoder_resolution_deg = 0.3')
    toml = swap(toml, 'default = "ax12"', 'default = "ax12"\ncurrent_limit = 1.5\nKp = 50')
    servos = load_robot(write(tmp_path, heavy, toml)).servos
    assert servos["ankle"] == load_servo("ax12", current_limit=1.5, Kp=50)
    assert servos["hip"] == load_servo(
        "ax12", "code_2012", current_limit=1.5, Kp=73, encoder_resolution=math.radians(0.3)
    )


def test_the_default_servo_is_for_joints_that_turn(tmp_path):
    toml = '[servos]\ndefault = "ax12"\n'
    path = write(tmp_path, swap(URDF, 'type="revolute"', 'type="prismatic"'), toml)
    assert list(load_robot(path).servos) == ["ankle"]
    write(tmp_path, swap(URDF, 'type="revolute"', 'type="prismatic"'), toml + "[servos.joints.hip]\nratio = 1000\n")
    assert load_robot(path).servos["hip"] == load_servo("ax12", ratio=1000)


def test_a_servo_beside_the_robot_comes_before_one_of_the_package(tmp_path):
    (tmp_path / "ax12.toml").write_text(
        'resistance = 5\ninductance = 0\nmotor_constant = 0.01\nvoltage_limit = 12\nlaw = "pd"\nratio = 10\n'
        "[gearboxes.physical]\nbacklash_deg = 0.5\n"
    )
    servo = load_robot(write(tmp_path, URDF, '[servos]\ndefault = "ax12"\n')).servos["hip"]
    assert servo == Servo(Controller("pd"), Gearbox(10.0, backlash=math.radians(0.5)), 5.0, 0.0, 0.01, 12.0)


def test_the_servos_field_names_do_not_clash():
    names = [f.name for cls in (Servo, Controller, Gearbox) for f in fields(cls)]
    assert len(names) == len(set(names))


def test_what_a_fixed_joint_cannot_have_is_noted(tmp_path):
    fixed = swap(URDF, 'type="revolute"', 'type="fixed"')
    notes = load_robot(write(tmp_path, fixed)).notes
    for tag in ("limit", "dynamics"):
        assert f"skipped <{tag}> of a fixed joint, which does not move" in notes


@pytest.mark.parametrize(
    ("keys", "records", "others"),
    [
        (OWN["links"], (Link,), {"surface"}),  # of its shapes
        (OWN["joints"], (Joint,), set()),
        (PASSIVE, (Joint,), set()),
        (OF_SHAPE, (Shape,), set()),
        (SECTIONS, (Model,), set()),
        (TOP, (SceneModel,), {"robots", "objects"}),  # its members
        (PLANAR, (Ground,), set()),
        (SAMPLED, (SampledSensor,), set()),
        (tuple(key.removesuffix("_deg") for key in SERVO_KEYS), (Servo, Controller, Gearbox), set()),
    ],
    ids=["links", "joints", "text", "shapes", "sections", "scene", "ground", "sensors", "servos"],
)
def test_each_key_of_toml_is_a_field(keys, records, others):
    """Whose effect `test_fields_have_effect.py` tests; readers of other tables take the fields themselves as keys."""
    assert set(keys) - {f.name for record in records for f in fields(record)} == others


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ((("ax13",), {}), "no servo 'ax13'; expected one of 2xl430, ax12"),
        ((("ax12", "gold"), {}), "no gearbox 'gold'; expected one of physical"),
        ((("ax12",), {"mass": 1}), "overrides: unknown key 'mass'"),
        ((("ax12",), {"resistance": -8}), "ax12: servo: resistance is -8.0 [Ohm]; expected > 0"),
    ],
)
def test_a_servo_that_cannot_be_is_refused_by_name(arguments, says):
    with pytest.raises(RobotFileError, match=re.escape(says)):
        load_servo(*arguments[0], **arguments[1])


SERVO = 'law = "pid_position"\nKp = 20\nresistance = 5\ninductance = 0\nmotor_constant = 0.01\nvoltage_limit = 12\n'


def test_a_servo_is_read_from_a_path(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "xl429.toml"
    path.write_text(SERVO + "ratio = 258\n[gearboxes.plain]\n[gearboxes.loose]\nbacklash_deg = 0.5\n")
    expected = Servo(Controller("pid_position", Kp=20.0), Gearbox(258.0), 5.0, 0.0, 0.01, 12.0)
    assert load_servo(path, "plain") == load_servo(str(path), "plain") == load_servo("xl429.toml", "plain") == expected
    assert gearbox_presets(path)["loose"] == Gearbox(258.0, backlash=math.radians(0.5))
    with pytest.raises(RobotFileNotFoundError, match=r"xl431\.toml: there is no such file; correct the path"):
        load_servo("xl431.toml")
    with pytest.raises(RobotFileError, match=r"no servo 'xl429'.*use one, or add xl429\.toml to the robot"):
        load_servo("xl429")
    robot = load_robot(write(tmp_path, URDF, '[servos]\ndefault = "xl429.toml"\ngearbox = "plain"\n'))
    assert robot.servos["hip"] == expected


def test_a_servo_file_without_presets_states_its_one_gearbox(tmp_path):
    path = tmp_path / "own.toml"
    path.write_text(SERVO + "ratio = 100\nstiffness = 30\n")
    assert load_servo(path).gearbox == Gearbox(100.0, stiffness=30.0)
    assert gearbox_presets(path) == {}
    with pytest.raises(RobotFileError, match=r"own\.toml: there is no gearbox 'gold': the file has no \[gearboxes\]"):
        load_servo(path, "gold")
    path.write_text(SERVO)
    with pytest.raises(RobotFileError, match="ratio is missing"):
        load_servo(path)


def test_a_servo_of_torques_needs_no_motor(tmp_path):
    robot = load_robot(
        write(tmp_path, URDF, '[servos.joints.hip]\nlaw = "pd_clamped"\nKp = 30\nKd = 0.5\ntorque_limit = 4\n')
    )
    assert robot.servos["hip"] == Servo(Controller("pd_clamped", Kp=30.0, Kd=0.5, torque_limit=4.0))
    save_robot(robot, tmp_path / "again.urdf")
    assert load_robot(tmp_path / "again.urdf").servos == robot.servos


@pytest.mark.parametrize("name", ["resistance", "inductance", "motor_constant", "voltage_limit"])
def test_a_servo_of_voltages_needs_its_motor(tmp_path, name):
    path = tmp_path / "own.toml"
    path.write_text("ratio = 100\n" + "".join(f"{line}\n" for line in SERVO.splitlines() if not line.startswith(name)))
    with pytest.raises(RobotFileError, match=f"{name} is missing; it is required: add it"):
        load_servo(path)
    if name != "inductance":
        with pytest.raises(ValueError, match=r"resistance is 0.0 \[Ohm\]; expected > 0: .* 'state' drives a motor"):
            Servo(Controller("state"), Gearbox(100.0))


def test_presets_of_a_servo_that_is_not_there_are_refused_by_name():
    with pytest.raises(RobotFileError, match="no servo 'ax13'; expected one of 2xl430, ax12"):
        gearbox_presets("ax13")


def random_robot(seed):
    """A tree of bodies with every kind of joint and every number at full precision."""
    rng = np.random.default_rng(seed)
    links, joints = [Link("root", 1.0, tuple(rng.normal(size=3)), (1.0, 0.1, 0.0, 1.0, 0.0, 1.0))], []
    for k in range(12):
        A = rng.normal(size=(3, 8))
        I = np.trace(A @ A.T) * np.eye(3) - A @ A.T  # of eight point masses: realizable
        body = rng.uniform(0.1, 2), tuple(rng.normal(size=3)), tuple(I[np.triu_indices(3)])
        links.append(Link(f'b & "{k}"', *body, gravity_compensation=rng.normal() if k % 3 == 0 else 0.0))
        kind = ("revolute", "continuous", "prismatic", "fixed")[k % 4]
        axis = rng.normal(size=3)
        numbers = {
            "axis": tuple(axis / np.linalg.norm(axis)),
            "effort": rng.uniform(1, 2),
            "damping": rng.uniform(),
            "friction": rng.uniform(),
            "stiffness": rng.uniform(),
            "spring_reference": rng.normal(),
        }
        limits = {"lower": -rng.uniform(), "upper": rng.uniform()} if kind in ("revolute", "prismatic") else {}
        parent = links[rng.integers(len(links) - 1)].name
        place = {"xyz": tuple(rng.normal(size=3)), "rpy": tuple(rng.normal(size=3))}
        moves = {} if kind == "fixed" else numbers | limits
        joints.append(Joint(f"é < {k}", kind, parent, links[-1].name, **place, **moves))
    servo = load_servo("ax12", "standard", Kp=rng.uniform(), current_limit=math.inf, backlash=rng.uniform())
    contacts = tuple(ContactPoint(links[k % 3].name, tuple(rng.normal(size=3))) for k in range(5))
    locked, servos = (
        {joints[0].name: joints[0].upper, joints[1].name: 1e3},
        {joints[1].name: servo, joints[2].name: servo},
    )
    return Model("b \\ö", tuple(links), tuple(joints), "floating", locked, servos, contacts)


@pytest.mark.parametrize("seed", range(5))
def test_what_is_saved_loads_back_to_the_last_bit(tmp_path, seed):
    robot = random_robot(seed)
    save_robot(robot, tmp_path / "saved.urdf")
    again = load_robot(tmp_path / "saved.urdf")
    for name in ("name", "links", "joints", "base", "locked", "servos", "contacts"):
        assert getattr(again, name) == getattr(robot, name)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["saved.toml", "saved.urdf"]


def test_a_robot_that_cannot_be_saved_leaves_the_old_files_alone(tmp_path):
    path = tmp_path / "saved.urdf"
    robot = random_robot(0)
    save_robot(robot, path)
    before = [(p.name, p.read_bytes()) for p in sorted(tmp_path.iterdir())]
    endless = replace(robot.joints[4], lower=-math.inf)
    with pytest.raises(ValueError, match=r"joint 'é < 4': .*-inf.*'continuous'"):
        save_robot(replace(robot, joints=(*robot.joints[:4], endless, *robot.joints[5:])), path)
    with pytest.raises(ValueError, match=r"saved\.sdf: the file name must end in \.urdf"):
        save_robot(robot, tmp_path / "saved.sdf")
    assert [(p.name, p.read_bytes()) for p in sorted(tmp_path.iterdir())] == before


WRONG = """bace = "floating"
base = "flying"
contacts = [
  {link = "foot", position = [0, 0]},
  {link = "nobody", position = [0, 0, 1], radius = -1},
  {link = "foot", position = [0,
    0, 1], rim = 2},
]
[servos]
default = "ax12"
voltage_limit = "nine"
Kpp = 3
[servos.joints.hip]
current_limit = -1
  period = 0
[servos.joints.toe]
Kp = 1
[supply]
voltage = -3
resistence = '''
two'''
[joints.ankle]
armature = true
mass = 3
[keyframes.crouch]
base = [0, 0]
joints.knees = 2
[keyframes]
list = [0, "x"]
[locked.default]
toe = 5
hip_deg = 40000
"""
LINES = [1, 2, 4, 5, 5, 7, 11, 12, 14, 15, 16, 19, 20, 23, 24, 26, 27, 29, 31, 32]


def test_all_that_is_wrong_with_a_toml_comes_at_once_with_its_line(tmp_path):
    with pytest.raises(RobotFileError) as caught:
        load_robot(write(tmp_path, URDF, WRONG))
    assert [int(text.removeprefix("line ").partition(":")[0]) for text in caught.value.problems] == LINES


def test_all_that_is_wrong_with_a_servo_comes_at_once_with_its_line(tmp_path):
    lines = ['law = "pd"', 'Kp = "3"', "Kd = -1", "period = 0", "Kq = 1", "[about]", "product = 3"]
    lines += ["[gearboxes.physical]", 'ratio = "a"']
    (tmp_path / "odd.toml").write_text("\n".join(lines))
    with pytest.raises(RobotFileError) as caught:
        load_servo(tmp_path / "odd.toml")
    assert [text.partition(":")[0] for text in caught.value.problems] == [f"line {k}" for k in (2, 3, 4, 5, 7, 9)]


def test_lines_are_those_of_the_keys_in_any_toml():
    """Text of several lines, tables within lists, dotted and quoted keys, arrays of tables."""
    text = """
a = '''x
b = 3'''
"c d".e = [1, # ]
  {f = 2, g.h = [
    3]}, "}",
]  # [i]
[j.k]
l = 1979-05-27 07:32:00
[[m]]
n = "\\\\"
[m.o]
p = { q = { r = -inf } }
[[m]]
  n = 2
""".replace("\n", "\r\n")
    table = with_lines(tomllib.loads(text), text)
    assert table == tomllib.loads(text)
    assert table.lines == {"a": 2, "c d": 4, "j": 8, "m": 10}
    assert table["c d"]["e"][1].lines == {"f": 5, "g": 5}
    assert table["c d"]["e"][1]["g"].lines == {"h": 5}
    assert table["j"]["k"].lines == {"l": 9}
    assert [row.lines for row in table["m"]] == [{"n": 11, "o": 12}, {"n": 15}]
    assert table["m"][0]["o"]["p"]["q"].lines == {"r": 13}
