"""Each attribute of MJCF that changes MuJoCo's motion changes what is read, or a note or refusal says what becomes.

URDF, TOML and SimTwo have tables of what is known; elsewhere tests ask the same of them.
"""

import re
import warnings
from dataclasses import fields, is_dataclass

import numpy as np
import pytest

from featherstone_gait import RobotFileError, load_robot, load_scene

mujoco = pytest.importorskip("mujoco")

ROBOT = """<mujoco><compiler/><option><flag/></option>
<asset><mesh name="wedge" vertex="0 0 0 0.2 0 0 0 0.2 0 0 0 0.2"/></asset>
<worldbody><geom name="floor" type="plane" size="5 5 1"/>
<body name="base" pos="0 0 .3"><freejoint/><inertial pos="0 0 .01" mass="1" diaginertia=".01 .02 .02"/>
<geom name="hull" type="box" size=".2 .2 .1"/><site name="s0" pos="0.1 0 .3"/>
<body name="arm" pos=".3 0 .2"><joint name="j" axis="0 1 0" range="-1 1" limited="true" damping=".1" stiffness="1"
 frictionloss="0.01"/><geom name="g" type="capsule" size=".05 .2"/><site name="s1" pos="0 0 .2"/>
<body name="tip" pos="0 0 .4"><joint name="k" type="slide" axis="0 0 1" damping="1"/>
<geom name="t" size=".05" priority="1"/></body></body>
<body name="leg" pos="-.3 0 0"><joint name="b" type="ball" damping=".1"/>
<geom name="w" type="mesh" mesh="wedge"/></body></body>
<body name="other" pos="0 2 1"><freejoint/><geom name="o" type="sphere" size=".1"/></body></worldbody>
<contact><pair geom1="t" geom2="floor"/><exclude body1="arm" body2="leg"/></contact>
<equality><connect body1="leg" body2="arm" anchor="0 0 .1"/><joint joint1="k" joint2="j" active="false"/></equality>
<tendon><fixed name="tf" stiffness="3"><joint joint="j" coef="1"/><joint joint="k" coef="2"/></fixed>
<spatial name="ts" stiffness="2" springlength=".1"><site site="s0"/><site site="s1"/></spatial></tendon>
<actuator><position name="ap" joint="j" kp="3" kv=".1"/><motor name="am" joint="k" ctrlrange="-1 1"/>
<velocity name="av" tendon="ts" kv=".2"/></actuator></mujoco>"""
ELEMENTS = (
    "<compiler", "<option", "<flag", "<mesh", '<geom name="floor"', '<body name="arm"', "<freejoint", "<inertial",
    '<geom name="hull"', '<geom name="g"', '<site name="s1"', '<joint name="j"', '<joint name="k"', '<joint name="b"',
    "<pair", "<exclude", "<connect", "<joint joint1", "<fixed", "<spatial", "<position", "<motor", "<velocity",
)  # fmt: skip
VALUES = (
    "0.3", "2", "1", "0", "true", "false", "0.3 0.2", "0.1 0.2 0.3", "1 0 0 0.2", "0.2 0.01 0.001", "enable", "disable",
    "-0.5 0.5", "global", "RK4", "elliptic", "box", "0.1 0.2 0.3 0.4 0.5", "s0", "arm", "0.9 0.95 0.01", "-500 -10",
    "0.1 0 0 0 0 0.2",
)  # fmt: skip
NUMERICS = {  # of MuJoCo's solver and integrator, which are no part of a robot
    "cone", "impratio", "integrator", "iterations", "noslip_iterations", "timestep", "tolerance", "solver", "jacobian",
    "diagexact", "eulerdamp", "warmstart", "refsafe", "ls_iterations", "ls_tolerance", "noslip_tolerance",
    "ccd_iterations", "ccd_tolerance", "nativeccd", "multiccd", "speculative", "override", "island", "midphase",
}  # fmt: skip
TOLD = {("<connect", "solref"), ("<connect", "solimp")}  # by a note whatever the number is: "MuJoCo's give way"


def schema():
    """Return the attributes of each element, by its path."""
    found, path = {}, []
    for line in mujoco.mj_printSchema(False, False).splitlines():
        head = re.match(r"( *)(\S+) \(.\)\s*(.*)", line)
        if head:
            path = [*path[: len(head[1]) // 3], head[2]]
        if path:
            found.setdefault("/".join(path[1:]), []).extend((head[3] if head else line).split())
    return found


def attributes(element, known):
    """Return those of an element that has this beginning."""
    tag = re.match(r"<(\w+)", element)[1]
    inside = "equality/joint" if element == "<joint joint1" else tag
    path = next(x for x in known if x.endswith(inside) and not x.startswith("default"))
    return [name for name in known[path] if name not in ("name", "class", "user")]


def changed(element, attribute, value):
    """Return the file with an attribute of an element set."""
    start = ROBOT.index(element)
    end = ROBOT.index(">", start)
    inside = re.sub(rf'\s{attribute}="[^"]*"', "", ROBOT[start:end])
    close = "/" * inside.endswith("/")
    return f'{ROBOT[:start]}{inside.removesuffix("/")} {attribute}="{value}"{close}{ROBOT[end:]}'


def motion(text):
    """Return where MuJoCo is after 0.3 s; None for a file that it refuses."""
    try:
        m = mujoco.MjModel.from_xml_string(text)
    except ValueError:
        return None
    d = mujoco.MjData(m)
    d.qvel[:], d.ctrl[:] = 0.5 * np.random.default_rng(0).normal(size=m.nv), 0.3
    mujoco.mj_step(m, d, 150)
    return d.qpos.copy()


def words(part):
    """Write all that a model or scene has, but where it is from."""
    if is_dataclass(part):
        return [(f.name, words(getattr(part, f.name))) for f in fields(part) if f.name != "source"]
    if isinstance(part, np.ndarray):
        return part.tolist()
    if isinstance(part, (tuple, list)):
        return [words(one) for one in part]
    return [(key, words(value)) for key, value in part.items()] if hasattr(part, "items") else part


def said(load, path, text):
    """Return what is read and noted of a file, or why it is refused."""
    path.write_text(text)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return words(load(path))
        except RobotFileError as error:
            return str(error)


@pytest.mark.quick("*freejoint*", "*inertial*", "*motor*", '*name="j"*', "*pair*")
@pytest.mark.parametrize("element", ELEMENTS)
def test_no_attribute_that_changes_the_motion_is_dropped_in_silence(element, tmp_path, capfd):
    path, usual, silent = tmp_path / "robot.xml", motion(ROBOT), []
    before = {load: said(load, path, ROBOT) for load in (load_robot, load_scene)}
    for attribute in attributes(element, schema()):
        for value in VALUES if attribute not in NUMERICS and (element, attribute) not in TOLD else ():
            text = changed(element, attribute, value)
            found = motion(text)
            if found is None or (found.shape == usual.shape and np.allclose(found, usual, atol=1e-9)):
                continue
            for load, one in before.items():
                ground = load is load_robot and element == '<geom name="floor"'  # an argument, as a note says
                if said(load, path, text) == one and not ground:
                    silent.append((attribute, value, load.__name__))
            break
    assert not silent
    capfd.readouterr()  # MuJoCo's own warnings


@pytest.mark.parametrize("tag", ["body", "joint", "geom", "site", "option", "compiler"])
def test_unknown_attributes_and_elements_are_refused(tag, tmp_path):
    known = f"<{tag}"
    for text in (
        ROBOT.replace(known, f'{known} wobble="1"', 1),
        ROBOT.replace("<worldbody>", "<wobble/><worldbody>", 1),
    ):
        (tmp_path / "robot.xml").write_text(text)
        for load in (load_robot, load_scene):
            with pytest.raises(RobotFileError, match="wobble"):
                load(tmp_path / "robot.xml")
