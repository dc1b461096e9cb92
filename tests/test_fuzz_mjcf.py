"""Damaged MJCF: whatever is in the file, a robot comes of it or a RobotFileError.

FUZZ=20000 in the environment runs that many mutations in place of a few; a failure names the seed that makes it again.
"""

import os
import random
import re
import time
import warnings

import pytest

from featherstone_gait import Model, RobotFileError, load_robot, save_robot

COUNT = int(os.environ.get("FUZZ", "300"))
SEED = int(os.environ.get("FUZZ_SEED", "20261121"))
SLOWEST = 20.0  # [s] of one file; most take a millisecond

VALUES = (
    *("", " ", "0", "-1", "1e400", "-1e400", "nan", "inf", "1e-320", "1e308", "-0", "99999999999999999999", "0 0 0"),
    *("1 2", "0 0 0 0 0 0 0", "true", "false", "auto", "free", "ball", "slide", "mesh", "plane", "world", "é", "a/b"),
    *("../..", "%s%n", "&lt;", "1,2,3", "0x10", "1e5", "3", "-3 3", "1 0 0 0", "joint", "robot.xml"),
)
ATTRIBUTE = re.compile(r'([A-Za-z]+)="([^"]*)"')
ELEMENT = re.compile(r"<[A-Za-z]+[^<>]*/>")
TAG = re.compile(r"</?([A-Za-z]+)")

ROBOT = """
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


def mutated(text, rng):
    """The text with one to four things changed."""
    for _ in range(rng.randint(1, 4)):
        text = rng.choice((_value, _value, _value, _name, _tag, _doubled, _dropped, _swapped, _byte))(text, rng)
    return text


def _value(text, rng):
    found = rng.choice(ATTRIBUTE.findall(text) or [("pos", "0")])
    return text.replace(f'{found[0]}="{found[1]}"', f'{found[0]}="{rng.choice(VALUES)}"', 1)


def _name(text, rng):
    a, b = (rng.choice(ATTRIBUTE.findall(text) or [("pos", "0")])[0] for _ in range(2))
    return text.replace(f"{a}=", f"{b}=", rng.randint(1, 2))


def _tag(text, rng):
    a, b = (rng.choice(TAG.findall(text) or ["body"]) for _ in range(2))
    return re.sub(rf"(</?){a}\b", rf"\1{b}", text, count=rng.choice((1, 2, 0)))


def _doubled(text, rng):
    found = rng.choice(ELEMENT.findall(text) or [""])
    return text.replace(found, found * rng.randint(2, 3), 1)


def _dropped(text, rng):
    return text.replace(rng.choice(ELEMENT.findall(text) or [""]), "", 1)


def _swapped(text, rng):
    a, b = (rng.choice(ELEMENT.findall(text) or [""]) for _ in range(2))
    return text.replace(a, b, 1)


def _byte(text, rng):
    k = rng.randrange(len(text) or 1)
    return text[:k] + rng.choice(["", "<", ">", '"', "&", "\0", "é", chr(rng.randrange(32, 127))]) + text[k + 1 :]


def read(path):
    """The robot of a file, or None if it is refused.  Anything else is a fault of the reader."""
    try:
        model = load_robot(path)
    except RobotFileError as error:
        if str(path) not in str(error):
            raise
        return None
    assert isinstance(model, Model)
    return model


@pytest.mark.parametrize("kind", ["given", "written"])
def test_damaged_mjcf_gives_a_robot_or_its_error(kind, tmp_path):
    text = ROBOT
    if kind == "written":
        save_robot(load_robot("humanoid"), tmp_path / "humanoid.xml")
        text = (tmp_path / "humanoid.xml").read_text()
    path, loaded = tmp_path / "robot.xml", 0
    for k in range(COUNT // 2):
        path.write_text(mutated(text, random.Random(f"{SEED} {kind} {k}")), encoding="utf-8")
        start = time.perf_counter()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                loaded += read(path) is not None
            except Exception as error:
                raise AssertionError(f"FUZZ_SEED={SEED}, mutation {k} of {kind}: {error!r}") from error
        assert time.perf_counter() - start < SLOWEST, f"FUZZ_SEED={SEED}, mutation {k} of {kind}"
    assert 0 < loaded < COUNT // 2
