"""Damaged files of every kind that is read: each is read, or refused by an error that names the file."""

import io
import itertools
import re
import shutil
import warnings
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from fuzzing import check_refusal, profiles, time_limit
from hypothesis import given
from hypothesis import strategies as st
from simtwo_scene import ARM

from featherstone_gait import Trajectory, load_robot, load_servo, save_robot
from featherstone_gait.benchmark import precision
from featherstone_gait.core.compile.sealed import SealedFiles
from featherstone_gait.identification import Recording, read_recording, write_recording
from featherstone_gait.model import Model
from featherstone_gait.robot_file.source import robots_folder
from featherstone_gait.search import minimize
from featherstone_gait.study import read_study
from featherstone_gait.study.run import Log
from featherstone_gait.walking import read_angles, write_angles

LIMIT = 20.0  # of a reader [s]
TOKEN = re.compile(rb"[A-Za-z_]\w*|[-+]?\d[\d.eE+-]*|[^\w\s]")
NUMBER = re.compile(rb"(?<![\w.])[-+]?\d[\d.eE+-]*")
VALUES = b"1e400 -1e308 1e308 1e200 1e-320 nan -inf 1_0 0x10 0 -1 1e30 1e9 0.5.5 - true null [] {} '' 1,5".split()
VALUES += ["\u0663".encode(), b"9" * 400, b"9" * 5000, b"[" * 3000]
BYTES = (
    b"\0", b"\xff", b"\xef\xbb\xbf", b'"', b"'", b"<", b">", b"&", b"\r", b"\x1a", b"\xe2\x80\xa8", b",", b"#", b"=",
    b"<!--", b"</link>",
)  # fmt: skip
ENCODINGS = ("utf-16", "utf-16-be", "utf-32", "latin-1", "utf-8-sig", "utf-7")
WORDS = (
    *("", " ", "auto", "false", "free", "ball", "slide", "hinge", "mesh", "plane", "planar", "fixed", "floating"),
    *(
        "revolute",
        "continuous",
        "prismatic",
        "spherical",
        "world",
        "base",
        "joint",
        "knee",
        "robot.xml",
        "a/b",
        "../..",
    ),
    *("0 0 0", "1 2", "0 0 0 0 0 0 0", "1 0 0 0", "-3 3", "%s%n", "&lt;", "a b", "\u00e9", "'", "x" * 300, "1e31"),
)
ATTRIBUTE = re.compile(rb'(?<=[\w:])="[^"<]*"')
ATTRIBUTE_NAME = re.compile(rb'\w+(?==")')
TAG = re.compile(rb"(?<=<)\w+|(?<=</)\w+")
ELEMENT = re.compile(rb'<[A-Za-z]+[^<>]*/>|<(?:link|joint)\b.*?</(?:link|joint)>|\w+="[^"]*"', re.DOTALL)


# ------------------------------------------------------------------------------------------------ damage


def match(draw, pattern, data):
    """Start and end of one of the first 1000 matches of the pattern, of the whole where there is none."""
    found = itertools.islice(pattern.finditer(data), 1000)
    return draw(st.sampled_from([one.span() for one in found] or [(0, len(data))]))


def put(data, place, new):
    return data[: place[0]] + new + data[place[1] :]


def value(draw, data):
    """A number, or a word, becomes something huge or none."""
    return put(data, match(draw, NUMBER if NUMBER.search(data) else TOKEN, data), draw(st.sampled_from(VALUES)))


def swapped(draw, data, pattern=TOKEN):
    """Two words, numbers, signs or elements change places."""
    a, b = sorted(match(draw, pattern, data) for _ in range(2))
    return put(put(data, b, data[slice(*a)]), a, data[slice(*b)]) if a[1] <= b[0] else data


def bits(draw, data):
    changed = bytearray(data)
    for _ in range(draw(st.integers(1, 8)) if data else 0):
        changed[draw(st.integers(0, len(data) - 1))] ^= 1 << draw(st.integers(0, 7))
    return bytes(changed)


def cut(draw, data):
    """A piece is left out: the end, the beginning, or in the middle."""
    a, b = sorted(draw(st.integers(0, len(data))) for _ in range(2))
    return draw(st.sampled_from((data[:a], data[a:], data[:a] + data[b:], b"")))


def moved_line(draw, data):
    """A line is doubled, deleted or put elsewhere."""
    lines = data.split(b"\n")
    line = lines.pop(draw(st.integers(0, len(lines) - 1)))
    for _ in range(draw(st.integers(0, 2))):
        lines.insert(draw(st.integers(0, len(lines))), line)
    return b"\n".join(lines)


def inserted(draw, data):
    at = draw(st.integers(0, len(data)))
    return put(data, (at, at), draw(st.sampled_from(BYTES)) * draw(st.sampled_from((1, 1, 2, 200_000))))


def encoded(draw, data):
    """The text is in an encoding that is not the one it states."""
    text = data.decode("utf-8", "replace")
    at = draw(st.integers(0, len(text)))
    text = text[:at] + draw(st.sampled_from(("\u00e9", "\U0001f916", ""))) + text[at:]
    return text.encode(draw(st.sampled_from(ENCODINGS)), "replace")


def repacked(draw, data):
    """A sound archive, but for the content of one of its files; as it is where it was damaged before."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            files = {name: archive.read(name) for name in archive.namelist()}
    except Exception:  # zipfile raises many kinds
        return data
    name = draw(st.sampled_from(sorted(files)))
    content = files.pop(name)
    if draw(st.booleans()):
        files[draw(st.sampled_from((name, "final.npy", "other")))] = draw(st.sampled_from(PLAIN))(draw, content)
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for name, content in files.items():
            archive.writestr(zipfile.ZipInfo(name), content)  # without the time of day: the same bytes again
    return packed.getvalue()


def word(draw, data):
    """The value of an attribute becomes another word or number."""
    new = draw(st.sampled_from([*WORDS, *(value.decode() for value in VALUES[:20])]))
    return put(data, match(draw, ATTRIBUTE, data), f'="{new}"'.encode())


def renamed(draw, data):
    """An element or attribute takes the name of another."""
    pattern = draw(st.sampled_from((TAG, ATTRIBUTE_NAME)))
    return put(data, match(draw, pattern, data), data[slice(*match(draw, pattern, data))])


def element(draw, data):
    """An element or attribute is left out, doubled, or at the end too."""
    place = match(draw, ELEMENT, data)
    old = data[slice(*place)]
    return draw(st.sampled_from((put(data, place, b""), put(data, place, old + old), data + old)))


PLAIN = (value, value, bits, cut, moved_line, swapped, inserted, encoded)
XML = (value, value, word, word, renamed, element, moved_line, inserted, partial(swapped, pattern=ELEMENT))


@st.composite
def damages(draw, sound, ways):
    """The content of a file, changed in one to three ways."""
    data = sound
    for _ in range(draw(st.integers(1, 3))):
        data = draw(st.sampled_from(ways))(draw, data)
    return data


# ------------------------------------------------------------------------------------------------ files


@dataclass
class Target:
    """A sound file, what reads it, and how it is damaged."""

    path: Path
    read: Callable
    ways: tuple = PLAIN
    options: dict = field(default_factory=dict)  # strategies for the reader's arguments


def robot(path, **how):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = load_robot(path, **how)
    assert isinstance(model, Model)
    return model


URDF_OPTIONS = {
    "strict": st.booleans(),
    "mimic": st.sampled_from(("coupled", "free", "locked")),
    "repair_inertia": st.booleans(),
}


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


MJCF = """
<mujoco model="odd">
  <compiler angle="degree"/><option timestep="0.001"/><size nkey="2" njmax="50"/>
  <default><joint armature="0.02" damping="0.3"/><default class="weak"><joint frictionloss="0.1"/></default></default>
  <asset><mesh name="brick" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/></asset>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body name="trunk" pos="0.1 0.2 0.3" euler="20 30 -40">
      <freejoint/>
      <inertial pos="0.01 0.02 -0.03" mass="3" fullinertia="0.04 0.05 0.03 0.001 0.002 -0.003"/>
      <geom type="capsule" fromto="0 0 0 0.2 0 0.1" size="0.04"/><geom type="mesh" mesh="brick" mass="0"/>
      <body name="hip" pos="0 0.1 -0.1">
        <joint name="yaw" axis="0 0 1" pos="0.01 -0.02 0.03" ref="35" range="-60 100"/>
        <joint name="slide" type="slide" axis="1 1 0" class="weak" range="-0.1 0.2"/>
        <geom type="box" size="0.1 0.05 0.02" pos="0.05 0 0"/>
        <body name="foot" pos="0 0 -0.2">
          <joint name="knee" axis="0 1 0"/><geom size="0.05" mass="1"/><site name="s"/>
          <replicate count="3" offset="0 0 0.1"><geom size="0.01"/></replicate>
        </body>
      </body>
    </body>
  </worldbody>
  <tendon><fixed name="wire"><joint joint="knee" coef="1"/></fixed></tendon>
  <equality><joint joint1="knee" joint2="yaw" polycoef="0 1 0 0 0"/></equality>
  <actuator>
    <position name="p" joint="yaw" kp="20" kv="1" forcerange="-3 3"/><motor joint="slide" gear="3" ctrlrange="-1 1"/>
    <dcmotor joint="knee" motorconst="0.05" resistance="2" input="pos" controller="1 0 0.1 0 0 6" gear="50"/>
  </actuator>
  <keyframe><key name="k" qpos="0 0 1 1 0 0 0 0.1 0 0"/></keyframe>
</mujoco>
"""


def copied(name, folder, ending):
    path = folder / f"attacked.{ending}"
    shutil.copy(robots_folder() / name, path)
    return path


def urdf(folder):
    (folder / "attacked.urdf").write_text(URDF, encoding="utf-8")
    return Target(folder / "attacked.urdf", robot, XML, URDF_OPTIONS)


def urdf_bytes(folder):
    return Target(copied("arm7/arm7.urdf", folder, "urdf"), robot)


def robot_toml(folder):
    copied("humanoid/humanoid.urdf", folder, "urdf")
    path = copied("humanoid/humanoid.toml", folder, "toml")
    return Target(path, lambda path: robot(path.with_suffix(".urdf")))


def servo_toml(folder):
    return Target(copied("servos/ax12.toml", folder, "toml"), load_servo)


def mjcf(folder):
    (folder / "attacked.xml").write_text(MJCF, encoding="utf-8")
    return Target(folder / "attacked.xml", robot, XML)


def simtwo(folder):
    (folder / "attacked.xml").write_text(ARM % "0", encoding="utf-8")
    return Target(folder / "attacked.xml", robot, XML)


def mjcf_written(folder):
    save_robot(load_robot("humanoid"), folder / "attacked.xml")
    return Target(folder / "attacked.xml", robot, (*XML, *PLAIN))


STUDY = """robot = "ax12_arm"
experiment = "hold"
duration = 0.1  # [s]
[scene]
gearbox = "mipsd"
[sampling]
method = "latin_hypercube"
count = 3
seed = 1
[vary]
servo.Kp = {from = 10.0, to = 100.0, scale = "log"}
posture.tilt = [-0.1, 0.1]
"""
ROW = {"variance_deg2": 0.25, "offset_deg": 1e-3, "chatter_rad_s": None, "energy_J": 3.5, "end_s": 0.1}


def study_toml(folder):
    (folder / "attacked.toml").write_text(STUDY, encoding="utf-8")
    return Target(folder / "attacked.toml", read_study)


def study_log(folder):
    (folder / "study.toml").write_text(STUDY, encoding="utf-8")
    study = read_study(folder / "study.toml")

    def rows(path):
        with Log(path, study) as found:
            if found.count == len(study):
                list(found.rows())

    with Log(folder / "attacked.jsonl", study) as begun:
        begun.append([2, 0, 1], [{"status": "ok", **ROW, "message": ""}] * 3)
    return Target(folder / "attacked.jsonl", rows)


def history(folder):
    def resume(path):
        fun = lambda x: float((x**2).sum())  # noqa: E731
        minimize(fun, [1.0, 1.0], amplitude=0.3, max_iterations=8, seed=7, history=path, resume=True)

    resume(folder / "attacked.jsonl")
    return Target(folder / "attacked.jsonl", resume)


def angles_csv(folder):
    time = 0.01 * np.arange(12)
    write_angles(folder / "attacked.csv", time, np.column_stack([time, -time]), ("hip", "knee"))
    return Target(folder / "attacked.csv", read_angles)


def recording_csv(folder):
    time = 0.01 * np.arange(12)
    write_recording(folder / "attacked.csv", Recording("attacked", time, time, time, time))
    return Target(folder / "attacked.csv", read_recording)


def benchmark_csv(folder):
    row = precision.Row("free arm", "rk4", 1e-3, np.nan, 1e-5, np.nan, 1e-12, 3.4, 3.5, 4000, "ok")
    precision.write(folder / "attacked.csv", [row] * 3, "processor")
    return Target(folder / "attacked.csv", precision.read)


def trajectory(folder, ending):
    q, info = np.ones((3, 2)), {"joints": ["a", "b"]}
    run = Trajectory({"time": np.arange(3.0), "q": q}, "ok", "", 2.0, np.zeros(5), info, {"q": q}, {"q": (0, 2)})
    run.save(folder / "attacked")
    ways = (*PLAIN, *[repacked] * 6) if ending == "npz" else PLAIN
    return Target(folder / f"attacked.{ending}", lambda path: repr(Trajectory.load(path)), ways)


def kernel_cache(folder, file):
    SealedFiles(str(folder), "attacked", "stamp").save("key", ["code"])

    def load(_):
        found = SealedFiles(str(folder), "attacked", "stamp").load("key")
        assert found in (None, ["code"]), "damaged code was taken for sound"

    return Target(folder / file, load)


MUJOCO = pytest.mark.skipif(not find_spec("mujoco"), reason="needs mujoco")
KINDS = [
    urdf, urdf_bytes, simtwo, pytest.param(mjcf, marks=MUJOCO), pytest.param(mjcf_written, marks=MUJOCO),
    robot_toml, servo_toml, study_toml, study_log, history, angles_csv, recording_csv, benchmark_csv,
    pytest.param(partial(trajectory, ending="npz"), id="trajectory_npz"),
    pytest.param(partial(trajectory, ending="json"), id="trajectory_json"),
    pytest.param(partial(kernel_cache, file="attacked.nbi"), id="cache_index"),
    pytest.param(partial(kernel_cache, file="attacked.1.nbc"), id="cache_data"),
]  # fmt: skip


# ------------------------------------------------------------------------------------------------ tests


def outcome(target, **how):
    """What a reader makes of a file, or the error by which it refuses it, whose message names the file."""
    try:
        with time_limit(LIMIT):
            return target.read(target.path, **how)
    except (ValueError, TypeError, OSError) as error:
        check_refusal(error, [target.path.stem])
        return error


@profiles(quick=24)
@pytest.mark.parametrize("kind", KINDS)
def test_a_damaged_file_is_read_or_refused_by_name(kind, profile, tmp_path):
    target = kind(tmp_path)
    sound = target.path.read_bytes()
    refused = []

    @profile
    @given(damages(sound, target.ways), st.fixed_dictionaries(target.options))
    def check(data, how):
        target.path.write_bytes(data)
        refused.append(isinstance(outcome(target, **how), Exception))

    check()
    if kind in (urdf, simtwo, mjcf):
        assert 0 < sum(refused) < len(refused)


@pytest.mark.parametrize("kind", KINDS)
def test_a_sound_file_is_read_and_rubbish_is_refused(kind, tmp_path):
    target = kind(tmp_path)
    target.read(target.path)
    target.path.write_bytes(b"\xff\0[<")
    if target.path.suffix not in (".nbi", ".nbc"):
        with pytest.raises((ValueError, OSError), match=target.path.name):
            target.read(target.path)


@pytest.mark.parametrize("piece", [b"<!--", b"<?xml ", b"<a:", b' a:b="'])
def test_what_opens_many_times_and_never_closes_is_refused_in_linear_time(tmp_path, piece):
    target = urdf(tmp_path)
    target.path.write_bytes(b"<robot>" + 200_000 * piece)
    assert isinstance(outcome(target), ValueError)


@pytest.mark.parametrize(
    ("raised", "fault"),
    [
        (ValueError("wrong"), "comes from"),
        (ValueError("attacked.csv: wrong"), "comes from"),
        (FileNotFoundError(2, "no such file", "attacked.csv"), None),
    ],
)
def test_a_fault_is_found(raised, fault):
    def read(_):
        raise raised

    if fault is None:
        assert outcome(Target(Path("attacked.csv"), read)) is raised
    else:
        with pytest.raises(AssertionError, match=fault):
            outcome(Target(Path("attacked.csv"), read))
