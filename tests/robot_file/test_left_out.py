"""What a file says changes what is read, or a note, warning or error says what becomes of it.

Of MJCF each attribute that changes MuJoCo's motion is asked, of URDF, SimTwo and TOML each attribute, element and key:
left out, misspelled, or unknown.
"""

import re
import tomllib
import warnings
from dataclasses import fields, is_dataclass
from pathlib import Path
from xml.etree.ElementTree import fromstring, tostring

import numpy as np
import pytest

from featherstone_gait import FloorLine, Fluid, Ground, RobotFileError, load_robot, load_scene, load_servo
from featherstone_gait.model.pair_contact import PairContact
from featherstone_gait.model.pair_friction import PairFriction
from featherstone_gait.robot_file.sensors import KINDS, MADE
from featherstone_gait.robot_file.servos import servo_sheet
from featherstone_gait.robot_file.toml import written

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
BARE = """<mujoco><asset><mesh name="wedge" vertex="0 0 0 0.2 0 0 0 0.2 0 0 0 0.2"/>
<hfield name="hf" nrow="2" ncol="2" size="1 1 .1 .1" elevation="0 1 1 0"/><!--asset--></asset><worldbody><!--world-->
<geom name="floor" type="plane" size="5 5 1"/>
<body name="base" pos="0 0 .3"><freejoint/><geom name="hull" type="box" size=".2 .2 .1"/><!--base-->
<site name="s0" pos=".1 .1 .3"/><geom name="knob" size=".04" pos="0 0 .3" contype="0" conaffinity="0"/>
<site name="side" pos="0 0 .5"/><body name="arm" pos=".3 0 .2"><joint name="j" axis="0 1 0" damping=".1"/>
<geom name="g" type="capsule" size=".05 .2"/><site name="s1" pos="0 0 .2"/><body name="tip" pos="0 0 .4">
<joint name="k" type="slide" axis="0 0 1" damping="1" stiffness="9"/><geom name="t" size=".05"/></body></body>
<body name="leg" pos="-.3 0 0"><joint name="l" axis="0 1 0" damping=".1"/><geom name="w" type="box" size=".1 .1 .1"/>
<site name="s2" pos="0 0 .2"/></body></body></worldbody><deformable><!--deformable--></deformable>
<tendon><fixed name="tf"><joint joint="j" coef="1"/><joint joint="k" coef="2"/></fixed><fixed name="tl">
<joint joint="l" coef="1"/></fixed><spatial name="ts"><site site="s0"/><site site="s1"/></spatial><!--tendon--></tendon>
<actuator><!--actuator--></actuator><equality><!--equality--></equality><sensor><!--sensor--></sensor>
<keyframe><!--keyframe--></keyframe><custom><!--custom--></custom><visual><!--visual--></visual></mujoco>"""
WRAP = '<spatial stiffness="30" springlength=".1"><site site="s0"/>%s<site site="s1"/></spatial>'
PARTS = {  # by section and place in the schema: what stands in BARE, and what is around it
    "actuator/general": '<general name="part" joint="j" biastype="affine" gainprm="3" biasprm="0 -3 -.1"/>',
    "actuator/damper": '<damper name="part" joint="j" kv="1" ctrlrange="0 1"/>',
    "actuator/intvelocity": '<intvelocity name="part" joint="j" kp="3" actrange="-1 1"/>',
    "actuator/cylinder": '<cylinder name="part" joint="j" area="1"/>',
    "actuator/muscle": '<muscle name="part" joint="j" lengthrange="0 1"/>',
    "actuator/adhesion": '<adhesion name="part" body="tip" gain="3" ctrlrange="0 1"/>',
    "actuator/dcmotor": '<dcmotor name="part" joint="j" motorconst="1" resistance="9" input="pos" controller="3 0"/>',
    "actuator/pid": '<pid name="part" joint="j" kp="3" kv=".1"/>',
    "actuator/orientation": '<orientation name="part" site="s1" refsite="s2" kp="3"/>',
    "actuator/velocity": '<velocity name="part" jointinparent="l" kv="1"/>',
    "actuator/position": '<position name="part" tendon="tf" kp="3" kv=".1"/>',
    "actuator/motor of a tendon": '<motor name="part" tendon="ts" gear="2"/>',
    "actuator/motor of a site": '<motor name="part" site="s1" gear="1 0 0 0 0 0"/>',
    "actuator/motor of a crank": '<motor name="part" cranksite="s1" slidersite="s0" cranklength=".4"/>',
    "equality/weld": '<weld name="part" body1="leg" body2="arm"/>',
    "equality/connect": '<connect name="part" site1="s2" site2="s1"/>',
    "equality/tendon": '<tendon name="part" tendon1="tl" tendon2="tf"/>',
    "equality/tendon of sites": '<tendon name="part" tendon1="ts"/>',
    "tendon/spatial": WRAP.replace("<spatial", '<spatial name="part"') % '<geom geom="knob" sidesite="side"/>',
    "tendon/spatial/geom": ('<geom geom="knob" sidesite="side"/>', WRAP),
    "tendon/spatial/pulley": (
        '<pulley divisor="2"/><site site="s0"/><site site="s2"/>', WRAP.replace("%s", '<site site="s2"/>%s')
    ),
    "tendon/fixed": '<fixed name="part" stiffness="3"><joint joint="j" coef="1"/></fixed>',
    "asset/mesh": '<mesh name="part" vertex="0 0 0 0.2 0 0 0 0.2 0 0 0 0.2"/>',
    "base/geom of a mesh": '<geom name="part" type="mesh" mesh="wedge"/>',
    "base/geom": '<geom name="part" type="ellipsoid" size=".1 .2 .3" fluidshape="ellipsoid"/>',
    "world/geom of heights": '<geom name="part" type="hfield" hfield="hf" pos="0 0 -.1"/>',
    "world/geom": '<geom name="part" type="box" size="1 1 .05" pos="0 0 .1"/>',
    "base/body": '<body name="part" pos="0 .3 0"><joint type="hinge"/><geom size=".1"/></body>',
    "base/frame": '<frame pos="0 .3 0"><body><joint/><geom size=".1"/></body></frame>',
    "base/replicate": (
        '<replicate count="2" offset="0 .3 0"><body pos="0 .4 0"><joint/><geom size=".1"/></body></replicate>', "%s"
    ),
}  # fmt: skip
MOVELESS = {  # what moves nothing, by where it stands in BARE
    "visual": ('<global fovy="30"/>',),
    "custom": (
        '<numeric name="x" data="1"/>', '<text name="x" data="1"/>',
        '<tuple name="x"><element objtype="body" objname="arm"/></tuple>',
    ),
    "asset": ('<texture name="x" type="2d" builtin="flat" width="2" height="2"/>', '<material name="x"/>'),
    "deformable": (
        '<skin name="x" vertex="0 0 0 1 0 0 0 1 0" face="0 1 2"><bone body="arm" bindpos="0 0 0" bindquat="1 0 0 0" '
        'vertid="0 1 2" vertweight="1 1 1"/></skin>',
        '<flex name="x" dim="2" body="arm tip leg" vertex="0 0 0 0 0 0 0 0 0" element="0 1 2"/>',
    ),
    "keyframe": ('<key name="x"/>', '<key qvel="0 0 1 1 0 0 .1 .1 .1"/>'),
    "world": ("<camera/>", "<light/>", '<body mocap="true"><geom size=".1"/></body>', '<body><geom size=".1"/></body>'),
    "base": ("<site/>", "<camera/>", "<light/>"),
    "sensor": (
        *(f'<{kind} site="s1"/>' for kind in (
            "accelerometer", "gyro", "velocimeter", "magnetometer", "force", "torque", "touch", "rangefinder")),
        *(f'<{kind} joint="j"/>' for kind in ("jointpos", "jointvel", "jointactuatorfrc")), "<clock/>",
        '<framepos objtype="body" objname="arm"/>', '<subtreecom body="base"/>', '<contact geom1="g"/>',
        '<user dim="1"/>',
    ),
}  # fmt: skip
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
    found, path = {"replicate": ["count", "offset", "euler"]}, []  # which it does not list
    for line in mujoco.mj_printSchema(False, False).splitlines():
        head = re.match(r"( *)(\S+) \(.\)\s*(.*)", line)
        if head:
            path = [*path[: len(head[1]) // 3], head[2]]
        if path:
            found.setdefault("/".join(path[1:]), []).extend((head[3] if head else line).split())
    return found


def case_of(element, known):
    """Return a file, the beginning of the element in it to look into, and its attributes."""
    if element in ELEMENTS:
        text, start, inside = ROBOT, element, re.match(r"<(\w+)", element)[1]
        inside = "equality/joint" if element == "<joint joint1" else inside
    else:
        section, _, rest = element.partition("/")
        start, around = PARTS[element] if isinstance(PARTS[element], tuple) else (PARTS[element], "%s")
        text = BARE.replace(f"<!--{section}-->", around % start)
        if section == "asset":
            text = text.replace("<!--base-->", '<geom type="mesh" mesh="part"/>')
        inside = rest.partition(" ")[0] if section in ("base", "world") else element.partition(" ")[0]
    path = next(path for path in known if path.endswith(inside) and not path.startswith("default"))
    return text, start, [name for name in known[path] if name not in ("name", "class", "user")]


def changed(text, element, attribute, value):
    """Return the file with an attribute of an element set."""
    start = text.index(element)
    end = text.index(">", start)
    inside = re.sub(rf'\s{attribute}="[^"]*"', "", text[start:end])
    close = "/" * inside.endswith("/")
    return f'{text[:start]}{inside.removesuffix("/")} {attribute}="{value}"{close}{text[end:]}'


def left_as_a_whole(notes, attribute, element, load):
    """Return whether notes say that an element is left out, or that its softness or gear is another's."""
    ground = element.startswith(("world/", '<geom name="floor"')) and load is load_robot  # an argument
    return ground or any(
        re.match("ignored actuators (of|that|on)", note)
        or ("took equalities" in note and attribute in ("solref", "solimp", "torquescale"))
        or ("gear gain control" in note and attribute == "gear")
        for note in notes
        if "'part'" in note
    )


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


@pytest.mark.quick("*freejoint*", "*inertial*", "*motor", '*name="j"*', "*pair*", "*damper*", "*pulley*", "equality/*")
@pytest.mark.parametrize("element", [*ELEMENTS, *PARTS])
def test_no_attribute_that_changes_the_motion_is_dropped_in_silence(element, tmp_path, capfd):
    text, start, names = case_of(element, schema())
    path, usual, silent = tmp_path / "robot.xml", motion(text), []
    assert usual is not None
    before = {load: said(load, path, text) for load in (load_robot, load_scene)}
    for attribute in names:
        for value in VALUES if attribute not in NUMERICS and (element, attribute) not in TOLD else ():
            new = changed(text, start, attribute, value)
            found = motion(new)
            if found is None or (found.shape == usual.shape and np.allclose(found, usual, atol=1e-9)):
                continue
            for load, one in before.items():
                notes = [] if isinstance(one, str) else dict(one)["notes"]
                if said(load, path, new) == one and not left_as_a_whole(notes, attribute, element, load):
                    silent.append((attribute, value, load.__name__))
            break
    assert not silent
    capfd.readouterr()  # MuJoCo's own warnings


@pytest.mark.parametrize("load", [load_robot, load_scene])
def test_what_moves_nothing_is_noted(load, tmp_path, capfd):
    path = tmp_path / "robot.xml"
    before = said(load, path, BARE.replace("<visual><!--visual--></visual>", ""))
    cases = {part: BARE.replace(f"<!--{section}-->", part) for section, parts in MOVELESS.items() for part in parts}
    for settings in (
        '<option timestep="0.01"/>', '<option><flag island="disable"/></option>', '<size memory="9M"/>',
        '<statistic extent="3"/>',
    ):  # fmt: skip
        cases[settings] = BARE.replace("<mujoco>", f"<mujoco>{settings}")
    for part, text in cases.items():
        text = text if "fovy" in text else text.replace("<visual><!--visual--></visual>", "")
        mujoco.MjModel.from_xml_string(text)
        assert said(load, path, text) != before, part
    capfd.readouterr()


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


# ---------------------------------------------------------------------------------------------- URDF and SimTwo


URDF = """<robot name="r">
<material name="red"><color rgba="1 0 0 1"/><texture filename="t.png"/></material>
<link name="a" type="x"><inertial><origin xyz="0 0 0.1" rpy="0.1 0.2 0.3"/><mass value="2"/>
<inertia ixx="0.02" iyy="0.03" izz="0.04" ixy="0.001" ixz="0.002" iyz="0.003"/></inertial>
<visual name="v"><origin xyz="0 0 0.1" rpy="0 0 0.1"/><geometry><box size="1 1 1"/></geometry></visual>
<collision name="c1" group="g"><origin xyz="0 0 0.1" rpy="0 0 0.1"/><geometry><box size="0.1 0.2 0.3"/></geometry>
<material name="red"><color rgba="1 0 0 1"/></material><verbose value="x"/></collision>
<collision name="c2"><geometry><sphere radius="0.1"/></geometry>
<contact_coefficients mu="0.3" kp="1" kd="2"/></collision>
<collision name="c3"><geometry><cylinder radius="0.1" length="0.2"/></geometry></collision>
<collision name="c4"><geometry><capsule radius="0.1" length="0.2"/></geometry></collision>
<collision name="c5"><geometry><mesh filename="x.stl" scale="2 2 2"/></geometry></collision></link>
<link name="b"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="c"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="k" type="revolute"><parent link="b"/><child link="c"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="5" velocity="6"/></joint>
<joint name="j" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0.1 0 0.2" rpy="0.1 0 0"/>
<axis xyz="0 0 1"/><axis2 xyz="0 1 0"/><screw pitch="0.01"/>
<limit lower="-0.4" upper="0.5" effort="3" velocity="2" acceleration="2" deceleration="3" jerk="1"/>
<dynamics damping="0.1" friction="0.2"/><mimic joint="k" multiplier="2" offset="0.1"/><calibration rising="0.1"/>
<safety_controller k_velocity="10" k_position="20" soft_lower_limit="-0.3" soft_upper_limit="0.4"/></joint>
<transmission name="t"><type>SimpleTransmission</type><joint name="j"/><actuator name="m">
<mechanicalReduction>50</mechanicalReduction></actuator></transmission>
<gazebo reference="j"><implicitSpringDamper>1</implicitSpringDamper><springStiffness>3</springStiffness>
<springReference>0.1</springReference><provideFeedback>1</provideFeedback></gazebo>
<gazebo reference="a"><mu1>0.3</mu1><mu2>0.2</mu2><kp>1e6</kp><selfCollide>1</selfCollide>
<turnGravityOff>1</turnGravityOff><dampingFactor>0.1</dampingFactor><material>Gazebo/Red</material></gazebo>
<gazebo><plugin name="p" filename="f.so"><robotNamespace>/x</robotNamespace></plugin><static>1</static></gazebo>
<sensor name="s" update_rate="30"><parent link="a"/><camera><image width="640" height="480"/></camera></sensor>
<ros2_control name="x" type="system"><joint name="j"/></ros2_control><mujoco><compiler meshdir="m"/></mujoco>
<loop_joint name="lj" type="fixed"><link1 link="a"/><link2 link="b"/></loop_joint></robot>"""
FREE = (
    '<mimic joint="k" multiplier="2" offset="0.1"/>',
    "",
    """<springStiffness>3</springStiffness>
<springReference>0.1</springReference>""",
    "",
)  # what joints of several degrees of freedom are refused with
SOLID = """<%s><ID value="%s" kind="omni"/>
<mass value="2" I11="0.1" I12="0.001" I13="0.002" I22="0.2" I23="0.003" I33="0.25"/>
<size x="0.3" y="0.2" z="0.1" radius="0.12"/><radius value="0.2"/><pos x="0.1" y="0.2" z="0.3"/>
<rot_deg x="10" y="20" z="30"/><surface mu="0.5" mu2="0.1" softness="0.1" bounce="0.2" bounce_tresh="0.1"/>
<drag coefficient="0.1" stokes="0.01" roll="0.02"/><buoyant mass="-0.1" x="0.1" y="0.2" z="0.3"/>
<buoyance mass="-0.2" x="0.1" y="0.2" z="0.3"/><thrust coefficient="0.3"/><nogravity/><metallic/><ferromagnetic/>
<rfidtag/><imovable/><color_rgb r="1"/><texture name="x"/><mesh file="f"/><transparency alpha="0.2"/><canvas/><liquid/>
<painting_target/><solid id="%s"/></%s>"""
MOTOR = """<motor{0} ri="2{1}" li="0.1{1}" ki="0.02{1}" vmax="12{1}" imax="3{1}" active="1" simple="1"/>
<rotor{0} J="1e-4" bv="0.2{1}" fc="0.1"/><gear{0} ratio="2{1}" ke="0.1{1}" bv="0.2{1}" ke2="1" kv2="2"/>
<friction{0} bv="0.1{1}" fc="0.2{1}" coulomblimit="1"/><spring{0} k="2{1}" zeropos="1{1}"/>
<encoder{0} ppr="100" mean="1" stdev="1"/>
<controller{0} mode="{2}" kp="2{1}" ki="3{1}" kd="4{1}" kf="5{1}" period="2{1}" active="1"/>"""
IDLE = MOTOR.replace(' active="1"/>', "/>")  # on where the default is
JOINT = """<joint><ID value="j"/><pos x="0.1" y="0.2" z="0.3"/><axis x="0.1" y="0.2" z="1" wrap="1"/>
<axis2 x="0.1" y="1" z="0.2"/><limits Min="-20" Max="30"/><limits2 Min="-21" Max="31"/><connect B1="b" B2="a"/>
<type value="Hinge"/>%s%s<draw radius="1"/><desc Eng="x"/></joint>"""
TYRE = """<tyre mass="0.3{0}" radius="0.08{0}" width="0.02{0}" centerdist="0.3{0}"/>
<surface mu="0.8{0}" mu2="0.1{0}" softness="1"/><offset x="0.1{0}" y="0.2{0}" z="0.3{0}"/><color_rgb r="1"/>"""
SENSOR = """<IRSharp><ID value="%s"/><beam length="0.5" initial_width="0.1" final_width="0.2" angle="20" rays="5"/>
<pos x="0.1" y="0.2" z="0.3"/><rot_deg x="10" y="20" z="30"/><solid id="b"/><period value="0.1"/>
<noise var_k="1" var_d="2"/><tag value="x"/><force fmax="1"/></IRSharp>"""
SIMTWO = f"""<robot><kind value="humanoid"/><defines><const name="c" value="0.2"/><arg name="d" value="0.1"/></defines>
<solids><cuboid><ID value="a"/><size x="c" y="d" z="c"/></cuboid><cuboid><ID value="e"/></cuboid>
{SOLID % ("cuboid", "b", "a", "cuboid")}</solids>
<shells>{SOLID % ("sphere", "pad", "b", "sphere")}</shells>
<articulations><default>{MOTOR.format("", "5", "pidposition")}
{MOTOR.format("2", "5", "pidposition")}</default>
<joint><ID value="i"/><axis2 x="1"/><connect B1="e" B2="a"/><type value="Universal"/></joint>
{JOINT % (IDLE.format("", "", "state"), IDLE.format("2", "", "state"))}</articulations>
<wheels><default><omni/>{TYRE.format("5")}{MOTOR.format("", "5", "pidposition")}</default>
<wheel><axis angle="90"/></wheel><wheel><ID value="w"/><axis angle="3"/>
{TYRE.format("")}{IDLE.format("", "", "state")}</wheel></wheels>
<sensors>{SENSOR % "one"}</sensors><tools>{SENSOR % "two"}</tools><gearbox/></robot>"""
THINGS = f"""<scene><defines><const name="c" value="0.2"/></defines>
<things>{SOLID % ("cuboid", "b", "a", "cuboid")}</things>
<obstacles>{SOLID % ("cylinder", "o", "a", "cylinder")}</obstacles>
<obstacle><ID name="w"/><pos x="0.1" y="c" z="0.3"/><rot_deg x="10" y="20" z="30"/>
{SOLID % ("sphere", "p", "a", "sphere")}</obstacle>
<sensors>{SENSOR % "one"}</sensors><track><line><position x="1"/></line></track><waypoints/></scene>"""
WHOLE = """visual material transmission gazebo sensor ros2_control mujoco loop_joint calibration safety_controller
verbose implicitSpringDamper plugin static kp selfCollide turnGravityOff dampingFactor provideFeedback axis axis2 screw
limit dynamics contact_coefficients kind color_rgb texture mesh transparency canvas liquid painting_target draw desc
encoder encoder2 noise period tag force track
drag buoyant buoyance thrust rotor2 gear2 friction2 spring2 motor2 controller2 limits2 motor rotor gear friction
spring controller limits solid metallic ferromagnetic rfidtag imovable nogravity waypoints gearbox beam surface radius
size mass mimic imu solenoid""".split()  # which a note, warning or error may name in place of what is inside


def swapped(text, *pairs):
    for old, new in zip(pairs[::2], pairs[1::2]):
        assert old in text
        text = text.replace(old, new)
    return text


def touching(path):
    """Load a robot of which all may touch the ground, so that rollers count."""
    return load_robot(path, contacts="all")


XML = {  # file, and the element to look into
    "urdf": (load_robot, URDF, "."),
    **{f"urdf {kind}": (load_robot, swapped(URDF, 'name="j" type="revolute"', f'name="j" type="{kind}"'), "joint[2]")
       for kind in ("continuous", "prismatic", "fixed", "screw")},
    **{f"urdf {kind}": (load_robot, swapped(URDF, 'name="j" type="revolute"', f'name="j" type="{kind}"', *FREE),
                        "joint[2]")
       for kind in ("floating", "planar", "ball", "universal", "cylindrical")},
    "simtwo": (touching, SIMTWO, "."),
    **{f"simtwo {kind}": (touching, swapped(SIMTWO, "Hinge", kind), "articulations/joint[2]")
       for kind in ("Slider", "Universal", "Ball", "Fixed")},
    "simtwo off": (touching, swapped(SIMTWO, 'active="1" simple', 'active="0" simple'), "articulations/joint[2]"),
    "simtwo without control": (touching, swapped(SIMTWO, 'active="1"/>', 'active="0"/>'), "articulations/joint[2]"),
    "simtwo at the output": (touching, swapped(SIMTWO, ' ke="0.1" bv=', ' ke="0.1" be="0.2" bv='),
                             "articulations/joint[2]"),
    **{f"simtwo {kind}": (touching, swapped(SIMTWO, "<IRSharp>", f"<{kind}>", "</IRSharp>", f"</{kind}>"), "sensors")
       for kind in ("ranger2d", "sonar", "imu", "capacitive", "solenoid")},
    "simtwo floorline": (touching, swapped(SIMTWO, "IRSharp>", "floorline>",
                                             'x="10" y="20" z="30"/><solid id="b"/><per',
                                             'y="20" z="30"/><solid id="b"/><per'), "sensors"),
    **{f"simtwo {kind}": (touching, swapped(SIMTWO, '<cuboid><ID value="b"', f'<{kind}><ID value="b"',
                                                "</cuboid></solids>", f"</{kind}></solids>"), f"solids/{kind}[last()]")
       for kind in ("cylinder", "sphere", "belt", "propeller")},
    "simtwo scene": (load_scene, THINGS, "."),
}  # fmt: skip


def edits(text, where):
    """Yield the edits of an XML file: what is changed, the new word in it, the tags around it, and the file."""
    for k, one in enumerate(fromstring(text).iter()):
        root = fromstring(text)
        above = {child: parent for parent in root.iter() for child in parent}
        element = [*root.iter()][k]
        tags, at = [], element
        while at is not None:
            tags.append(at.tag)
            at = above.get(at)
        tops = [root] if where == "." else root.findall(where)
        if not any(element is inner for top in tops for inner in top.iter()):
            continue
        for name, value in one.attrib.items():
            del element.attrib[name]
            yield f"<{one.tag}> without {name}", "", tags, tostring(root, "unicode")
            odd = f"{name[:-1]}q{name[-1]}"
            element.set(odd, value)
            yield f"<{one.tag}> {odd}", odd, tags, tostring(root, "unicode")
            del element.attrib[odd]
            element.set(name, value)
        element.set("wobble", "1")
        yield f"<{one.tag}> wobble", "wobble", tags, tostring(root, "unicode")
        del element.attrib["wobble"]
        for place, child in enumerate([*element]):
            element.remove(child)
            yield f"<{one.tag}> without <{child.tag}>", "", [child.tag, *tags], tostring(root, "unicode")
            odd = f"{child.tag[:-1]}q{child.tag[-1]}"
            element.insert(place, child)
            child.tag, tag = odd, child.tag
            yield f"<{one.tag}> <{odd}>", odd, tags, tostring(root, "unicode")
            child.tag = tag
        element.append(fromstring("<wobble/>"))
        yield f"<{one.tag}> <wobble>", "wobble", tags, tostring(root, "unicode")


def is_told(before, now, word, tags):
    """Return whether an edit shows in what is read, or a note or error names it, or what it stands in."""
    if isinstance(now, str):
        return True
    told = str(dict(now)["notes"])
    named = any(re.search(rf"\b{tag}\b", told) for tag in tags if tag in WHOLE)
    return (word in told if word else now != before) or named


@pytest.mark.quick("urdf floating", "simtwo imu")
@pytest.mark.parametrize("case", XML)
def test_each_part_of_urdf_and_simtwo_is_read_or_named(case, tmp_path):
    load, text, where = XML[case]
    path = tmp_path / ("robot.urdf" if case.startswith("urdf") else "robot.xml")
    before = said(load, path, text)
    assert not isinstance(before, str), before
    tried = ((what, is_told(before, said(load, path, new), word, tags)) for what, word, tags, new in edits(text, where))
    assert not [what for what, told in tried if not told]


# ---------------------------------------------------------------------------------------------- TOML


TOML_URDF = """<robot name="r"><link name="a"/><link name="b"/><link name="c"/><link name="d"/>
<joint name="j" type="revolute"><parent link="a"/><child link="b"/><limit lower="-3" upper="3" effort="1" velocity="1"/>
</joint><joint name="k" type="continuous"><parent link="a"/><child link="c"/></joint>
<joint name="u" type="universal"><parent link="b"/><child link="d"/><axis xyz="1 0 0"/><axis2 xyz="0 1 0"/></joint>
</robot>"""
BODY = """<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
<collision name="s{0}"><geometry><sphere radius="0.1"/></geometry></collision></link>"""
MOTION = '{velocity = [0.1, 0.2, 0.3], turning = [0.1, 0, 0], center = [0.1, 0, 0], drive = "x", command = 0.5}'
SERVO = """law = "state"
Kp = 2
Ki = 3
Kd = 4
Kf = 5
period = 0.02
lag = 0.03
compliance_margin_deg = 1
punch = 0.1
pwm_steps = 9
duty_limit = 0.9
profile_speed = 7
delay = 0.001
wrap = true
resistance = 2
inductance = 0.1
motor_constant = 0.3
voltage_limit = 11
current_limit = 3
current_slew = 4
viscous_friction = 0.1
coulomb_friction = 0.2
stick_speed = 0.3
encoder_resolution = 0.01
speed_filter = 0.1
"""
GEAR = """ratio = 9
rotor_inertia = 0.1
rotor_damping = 0.2
stiffness = 3
damping = 4
"""
SERVO_FILE = (
    SERVO.replace("_deg", "")
    + """
[about]
product = "x"
source = "y"
quality = "z"
[manual]
source = "m"
voltage = [12]
stall_torque = [1]
stall_current = [2]
no_load_speed = [3]
no_load_current = [0.1]
[gearboxes.physical]
backlash_deg = 0.5
"""
    + GEAR
    + """external_load_friction = 0.1
motor_load_friction = 0.1
load_product_friction = 0.1
stribeck_speed = 2
stribeck_exponent = 3
stribeck_friction = 0.1
stribeck_external_load = 0.1
stribeck_motor_load = 0.1
quadratic_external_load = 0.1
quadratic_motor_load = 0.1
[gearboxes.other]
ratio = 2
"""
)
ROBOT_FILE = f"""base = "floating"
excluded = [["b", "c"]]
included = [["a", "b"]]
[[contacts]]
link = "b"
position = [0.1, 0, 0]
circle_radius = 0.2
axis = [0, 1, 0]
load_bearing = false
friction = 0.3
roller_angle = 0.4
roller_friction = 0.1
surface = {MOTION}
[[contacts]]
link = "c"
position = [0.1, 0, 0]
radius = 0.2
rolling_friction = 0.1
[servos]
default = "two"
gearbox = "other"
resistance = 3
[servos.joints.j]
type = "one"
gearbox = "physical"
encoder_resolution_deg = 1
backlash = 0.1
compliance_margin_deg = 2
[supply]
voltage = 12
resistance = 0.1
[locked.default]
k_deg = 10
[links.c]
gravity_compensation = 0.5
surface = {MOTION}
[joints.j]
upper = 1
armature = 0.1
stiffness = 2
spring_reference = 0.3
quadratic_stiffness = 0.1
cubic_stiffness = 0.2
quadratic_damping = 0.1
cubic_damping = 0.2
[joints.u.degrees.r1]
stiffness = 3
spring_reference = 0.2
[shapes.sb]
friction = 0.3
torsional_friction = 0.1
rolling_friction = 0.2
priority = 2
surface = {MOTION}
[keyframes]
q = [0, 0, 0, 1, 0, 0, 0, 0.1, 0, 0]
[keyframes.home]
base = [0, 0, 1, 1, 0, 0, 0]
joints = {{j = 0.1}}
[[loops]]
name = "one"
kind = "hinge"
a = "b"
b = "c"
point_a = [0.1, 0, 0]
point_b = [0.2, 0, 0]
rpy_a = [0.1, 0, 0]
rpy_b = [0, 0.1, 0]
axis = [0, 1, 0]
[[loops]]
name = "two"
kind = "distance"
a = "b"
distance = 0.3
[[tendons]]
name = "t"
joints = [["j", 1]]
stiffness = 1
damping = 2
rest = 0.1
lower = -1
upper = 2
friction = 0.1
armature = 0.2
controller = {{law = "pd_clamped", Kp = 1, Kd = 2, torque_limit = 3}}
[[tendons]]
name = "v"
stiffness = 1
path = [{{link = "a", point = [0.1, 0, 0]}},
{{link = "b", shape = "cylinder", radius = 0.01, point = [0, 0.3, 0], axis = [0, 1, 0], side = [0.5, 0, 0]}},
{{link = "b", point = [0, 0, 0.2]}}, {{link = "c", share = 0.5}}, {{link = "c", point = [1, 0, 0]}}]
[[immersed]]
link = "b"
geometry = {{shape = "box", size = [1, 2, 3]}}
xyz = [0.1, 0, 0]
rpy = [0.1, 0, 0]
name = "n"
drag = [1, 2, 3]
turning_drag = 0.1
stokes = 0.5
linear_damping = 0.1
turning_damping = 0.2
added_mass = 0.3
added_inertia = 0.4
buoyant = false
[[immersed]]
link = "c"
geometry = {{shape = "sphere", radius = 1}}
added_matrix = {np.eye(6).tolist()}
[[immersed]]
link = "c"
geometry = {{shape = "box", size = [1, 2, 3]}}
law = "ellipsoid"
fluidcoef = [0.1, 0.2, 0.3, 0.4, 0.5]
buoyant = false
[[propellers]]
joint = "j"
thrust = 0.1
torque = 0.2
linear_thrust = 0.3
[[sensors]]
kind = "range"
link = "b"
name = "s1"
position = [0.1, 0, 0]
rpy = [0.1, 0, 0]
directions = [[1, 0, 0], [0, 1, 0]]
reach = 2
nearest = true
curve = [[0.1, 2], [0.5, 1]]
noise = 0.1
rate = 100
delay = 0.01
seed = 3
[[sensors]]
kind = "fan"
link = "b"
name = "s2"
angle = 0.2
rays = 3
[[sensors]]
kind = "line"
link = "b"
name = "s3"
positions = [[0, 0, 0.1]]
radius = 0.01
direction = [0, 1, 0]
reach = 0.3
[[sensors]]
kind = "contact"
link = "b"
name = "s4"
threshold = 2
"""
PLACE = """name = "{0}"
position = [0.1, 0, 1]
{1}
"""
SOLID_KEYS = """friction = 0.1
torsional_friction = 0.2
rolling_friction = 0.3
surface = {0}
"""
SCENE_FILE = f"""name = "s"
gravity = [0, 0, -5]
excluded = [["one/b", "cup/body"]]
[pairs]
select = [["one", "cup"]]
friction = 0.3
penetration = 1e-3
damping_ratio = 0.5
torsional_friction = 0.1
rolling_friction = 0.2
load = 3
max_points = 2
[ground]
friction = 0.5
penetration = 2e-3
damping_ratio = 0.6
velocity = [0.1, 0.2]
turning = 0.3
center = [1, 2]
height = 0.1
slope = 0.1
heading = 0.2
steps = [[0.5, 0.02]]
[[ground.lines]]
points = [[0, 0], [1, 0]]
width = 0.03
[fluid]
density = 900
viscosity = 0.1
level = 2
current = [1, 0, 0]
[[robots]]
file = "r.urdf"
base = "floating"
locked = {{k = 0.2}}
contacts = "all"
gearbox = "none"
ground_contact = false
servos = {{joints = {{j = {{law = "pd", Kp = 1}}}}}}
{PLACE.format("one", "rpy = [0.1, 0, 0]")}
[[objects]]
shape = "cylinder"
radius = 0.1
length = 0.2
mass = 2
inertia = [1, 0, 0, 1, 0, 1]
center_of_mass = [0.1, 0, 0]
{PLACE.format("cup", "orientation = [0, 1, 0, 0]")}{SOLID_KEYS.format(MOTION)}
[[obstacles]]
shape = "box"
size = [1, 2, 3]
{PLACE.format("table", "")}{SOLID_KEYS.format(MOTION)}
[[frictions]]
a = "cup"
b = "table"
friction = 0.7
torsional_friction = 0.1
rolling_friction = 0.2
[[loops]]
name = "grip"
kind = "connect"
a = "one/b"
b = "cup/body"
"""


def spoken(table):
    """Return the keys of a table of TOML and of those in it."""
    inner = table.values() if isinstance(table, dict) else table if isinstance(table, list) else ()
    return {*(table if isinstance(table, dict) else ())}.union(*map(spoken, inner))


def rewritten(table, edit, path=()):
    """Return a table with what an edit does to each table, given with the keys above it."""
    if isinstance(table, dict):
        table = {key: rewritten(value, edit, (*path, key)) for key, value in table.items()}
        return edit(table, path)
    if isinstance(table, list):
        return tuple(rewritten(one, edit, (*path, k)) for k, one in enumerate(table))
    return table


def toml_edits(text):
    """Yield the edits of a TOML file: what is changed, the new word in it, and the file."""
    table, places = tomllib.loads(text), []
    rewritten(table, lambda one, path: places.append((path, [*one])) or one)

    def to(path, change):
        done = rewritten(table, lambda one, at: change(one) if at == path else one)
        return "\n".join(f"{key} = {written(value)}" for key, value in done.items())

    for path, keys in places:
        for key in keys:
            odd = f"{key[:-1]}q{key[-1]}"
            yield f"{path} without {key}", "", to(path, lambda one: {k: x for k, x in one.items() if k != key})  # noqa: B023
            yield f"{path} {odd}", odd, to(path, lambda one: {odd if k == key else k: x for k, x in one.items()})  # noqa: B023
        yield f"{path} wobble", "wobble", to(path, lambda one: {**one, "wobble": 1})


def sheet_and_servo(path):
    """Return all that the file of a servo says, as `words` takes it."""
    return [("sheet", repr(servo_sheet(path))), ("other", load_servo(path, "other")), ("physical", load_servo(path))]


TOML = {
    "robot": (lambda path: load_robot(path.parent / "r.urdf"), ROBOT_FILE, "r.toml"),
    "servo": (sheet_and_servo, SERVO_FILE, "one.toml"),
    "scene": (load_scene, SCENE_FILE, "scene.toml"),
}


@pytest.mark.quick("servo")
@pytest.mark.parametrize("case", TOML)
def test_each_key_of_toml_is_read_or_refused(case, tmp_path):
    load, text, name = TOML[case]
    urdf = re.sub(r'<link name="(.)"/>', lambda one: f'<link name="{one[1]}">{BODY.format(one[1])}', TOML_URDF)
    (tmp_path / "r.urdf").write_text(urdf)
    (tmp_path / "one.toml").write_text(SERVO_FILE)
    (tmp_path / "two.toml").write_text(SERVO_FILE.replace("Kp = 2", "Kp = 9"))
    before = said(load, tmp_path / name, text)
    assert not isinstance(before, str), before
    found = []
    for what, word, new in toml_edits(text):
        now = said(load, tmp_path / name, new)
        if now == before or (word == "wobble" and word not in now):
            found.append(what)
    assert not found


def test_the_files_have_all_keys_that_there_are():
    page = (Path(__file__).parents[2] / "docs" / "toml_keys.md").read_text("utf-8")
    known = {name for row in re.findall(r"^\| (`.*?`) \|", page, re.MULTILINE) for name in re.findall(r"`(\w+)`", row)}
    known -= {*KINDS, *MADE}
    kinds = (Ground, FloorLine, Fluid, PairContact, PairFriction)
    known |= {f.name for kind in kinds for f in fields(kind)} - {"field"}  # which comes from Python
    assert not known - set().union(*(spoken(tomllib.loads(file)) for file in (ROBOT_FILE, SCENE_FILE, SERVO_FILE)))
