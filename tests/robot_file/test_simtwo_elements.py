"""Scenes of SimTwo: what shells, wheels, drag, buoyancy, surfaces and sensors mean, and that nothing is silent."""

import math
import re
import warnings

import numpy as np
import pytest

from featherstone_gait import (
    Fluid,
    LineSensor,
    Propeller,
    RobotFileError,
    RobotFileWarning,
    SampledSensor,
    compile_scene,
    initial_state,
    load_robot,
    load_scene,
    mass_matrix,
    measure,
    ranges,
    simulate,
)
from featherstone_gait.model.shapes import Box, Cylinder, Sphere

CART = """<robot>
  <solids>
    <cuboid><ID value="box"/><mass value="2"/><size x="0.3" y="0.2" z="0.1"/><pos z="0.1"/><rot_deg z="90"/></cuboid>
  </solids>
  <wheels>
    <default>
      <tyre mass="0.4" radius="0.05" width="0.02" centerdist="0.12"/>
      <motor ri="0.3" vmax="12"/><gear ratio="12"/><controller active="1" period="10"/>
    </default>
    <wheel><axis angle="90"/></wheel>
    <wheel><ID value="left"/><axis angle="-90"/><tyre radius="0.06"/><controller kp="3"/></wheel>
    <wheel><omni/><axis angle="180"/><surface mu="0.8" mu2="0.01"/><motor active="0"/></wheel>
  </wheels>
  %s
</robot>
"""


def written(folder, text, name="cart.xml"):
    (folder / name).write_text(text, encoding="utf-8")
    return folder / name


def quiet(path, load=load_robot, **more):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RobotFileWarning)
        return load(path, **more)


def line_of(text, part):
    """The line of a text on which a part begins."""
    return text[: text.index(part)].count("\n") + 1


def test_wheels_are_cylinders_on_hinges_of_the_first_solid(tmp_path):
    model = quiet(written(tmp_path, CART % ""))
    assert model.joint_names == ("W1", "left", "W3")
    joints = {joint.name: joint for joint in model.moving_joints}
    assert [joint.parent for joint in model.moving_joints] == ["box"] * 3
    np.testing.assert_allclose(joints["W1"].axis, (0.0, -1.0, 0.0), atol=1e-15)  # toward the middle
    np.testing.assert_allclose(joints["left"].xyz, (0.0, -0.12, 0.06), atol=1e-15)  # stands on z = 0
    H = mass_matrix(model, [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(np.diag(H)[6:], 0.5 * 0.4 * np.array([0.05, 0.06, 0.05]) ** 2, rtol=1e-12)
    assert model.mass == pytest.approx(2 + 3 * 0.4)


def test_motors_of_wheels_inherit_from_their_default(tmp_path):
    servos = quiet(written(tmp_path, CART % "")).servos
    assert [*servos] == ["W1", "left"]  # the third is switched off
    assert [servos[name].controller.Kp for name in servos] == [0.5, 3.0]
    assert (servos["left"].resistance, servos["left"].gearbox.ratio) == (0.3, 12.0)


def test_a_motor_that_is_off_leaves_its_friction_and_rotor_at_the_joint(tmp_path):
    """Without current SimTwo's axis has the torque -bv w - fc sign(w), and G² of the rotor's inertia and friction."""
    off = '<motor active="0"/><gear ratio="20"/><rotor J="1e-4" bv="2e-4"/><friction bv="0.03" fc="0.2"/>'
    model = quiet(written(tmp_path, (CART % "").replace('<motor active="0"/>', off)))
    joint = model.moving_joints[2]
    assert (joint.name in model.servos, joint.friction) == (False, 0.2)
    assert joint.damping == pytest.approx(0.03 + 20**2 * 2e-4)
    H = mass_matrix(model, [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert H[8, 8] == pytest.approx(0.5 * 0.4 * 0.05**2 + 20**2 * 1e-4)


def test_omni_wheels_roll_across_their_axis_alone(tmp_path):
    model = quiet(written(tmp_path, CART % ""), load_scene).member("cart").model
    points = {point.link: point for point in model.contacts}
    omni = points["Tyre 180"]
    assert (omni.roller_angle, omni.friction, omni.roller_friction) == (math.pi / 2, 0.8, 0.01)
    assert omni.circle_radius == 0.05
    assert np.abs(omni.axis) == pytest.approx((1.0, 0.0, 0.0))
    assert [point.link for point in model.contacts].count("Tyre 180") == 1
    assert (points["Tyre 90"].roller_angle, points["Tyre 90"].friction) == (None, 1.0)
    chosen = quiet(written(tmp_path, CART % ""), contacts="all")
    assert [point.roller_angle for point in chosen.contacts].count(math.pi / 2) == 1


@pytest.mark.long
def test_three_omni_wheels_go_in_any_direction(tmp_path):
    """Sliding without turning, the robot shares its momentum with the wheels, until these roll by their share of it."""
    text = """<robot>
      <solids><cylinder><ID value="disc"/><mass value="2"/><size x="0.1" z="0.04"/><pos z="0.06"/></cylinder></solids>
      <wheels>
        <default><tyre mass="0.4" radius="0.05" width="0.02" centerdist="0.2"/><surface mu="0.8" mu2="0"/><omni/>
          <motor active="0"/><friction bv="0" fc="0"/></default>
        <wheel><axis angle="0"/></wheel><wheel><axis angle="120"/></wheel><wheel><axis angle="240"/></wheel>
      </wheels></robot>"""
    scene = compile_scene(quiet(written(tmp_path, text), load_scene))
    start = initial_state(scene)
    speeds = scene.state_view(start).base_qd
    speeds[0], speeds[1] = 0.5, 0.2
    run = simulate(scene, 0.5, start, record=("base_qd", "qd"))
    assert run.success
    end = run["base_qd"][-1, :2]
    assert end == pytest.approx(np.array([0.5, 0.2]) * 3.2 / (3.2 + 0.75 * 0.4), rel=5e-3)
    angles = np.radians([0.0, 120.0, 240.0])
    rolling = (-np.sin(angles) * end[0] + np.cos(angles) * end[1]) / 0.05
    assert np.abs(run["qd"][-1]) == pytest.approx(np.abs(rolling), rel=5e-3)


@pytest.mark.parametrize(("kind", "angle"), [("omni", 90), ("mecanumleft", 45), ("mecanumright", -45)])
def test_cylinders_can_be_wheels_with_rollers(tmp_path, kind, angle):
    text = f"""<robot><solids><cuboid><ID value="box"/></cuboid>
      <cylinder><ID value="wheel" kind="{kind}"/><size x="0.05" z="0.02"/><pos x="1"/><rot_deg x="90"/></cylinder>
      </solids><articulations><joint><ID value="turn"/><axis y="1" x="0"/><connect B1="wheel" B2="box"/>
      <type value="Hinge"/></joint></articulations></robot>"""
    model = quiet(written(tmp_path, text), contacts=["wheel"])
    (point,) = model.contacts
    assert math.degrees(point.roller_angle) == pytest.approx(angle)
    assert (point.friction, point.roller_friction) == (1.0, 0.001)
    assert np.abs(point.axis) == pytest.approx((0.0, 1.0, 0.0))


def test_shells_are_fixed_to_their_solid_in_its_frame(tmp_path):
    shells = """<shells>
      <sphere><ID value="pad"/><radius value="0.01"/><pos x="0.1"/><surface mu="0.02"/></sphere>
      <sphere><ID value="pad"/><radius value="0.01"/><pos x="-0.1"/></sphere>
      <cuboid><ID value="load"/><mass value="0.5"/><size x="0.1" y="0.2" z="0.3"/><pos x="0.2"/></cuboid>
    </shells>"""
    text = re.sub("<wheels>.*</wheels>", "", CART % shells, flags=re.DOTALL).replace('<pos z="0.1"/>', "")
    model = quiet(written(tmp_path, text))
    assert model.moving_joints == ()
    assert [type(shape.geometry) for shape in model.shapes] == [Box, Sphere, Sphere, Box]
    assert [shape.friction for shape in model.shapes] == [None, 0.02, None, None]
    assert [shape.link for shape in model.shapes] == ["box", "box_pad", "box_pad_", "box_load"]
    # the box is turned a quarter about z, and so is the load, 0.2 m along y in the robot's frame
    moments = (
        2 * (0.3**2 + 0.1**2) / 12 + 0.5 * ((0.1**2 + 0.3**2) / 12 + 0.2**2),
        2 * (0.2**2 + 0.1**2) / 12 + 0.5 * (0.2**2 + 0.3**2) / 12,
        2 * (0.2**2 + 0.3**2) / 12 + 0.5 * ((0.2**2 + 0.1**2) / 12 + 0.2**2),
    )
    H = mass_matrix(model, [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    assert sorted(np.diag(H)) == pytest.approx(sorted((*moments, 2.5, 2.5, 2.5)), rel=1e-12)


def test_drag_and_buoyancy_are_those_of_a_step(tmp_path):
    text = """<things><sphere><ID value="ball"/><mass value="0.3"/><radius value="0.1"/><pos z="2"/>
      <drag coefficient="0.4" stokes="2e-3" roll="5e-4"/><buoyant mass="-0.2" z="0.05"/></sphere></things>"""
    written(tmp_path, text, "things.xml")
    scene = quiet(written(tmp_path, '<scene><things file="things.xml"/></scene>', "scene.xml"), load_scene)
    assert scene.fluid == Fluid(1.293)
    drag, lift = scene.member("ball").model.immersed
    assert (drag.drag, drag.buoyant, drag.stokes) == (0.4, False, 0.0)
    assert drag.linear_damping == pytest.approx(0.3 * 2e-3 / 1e-3)
    assert drag.turning_damping == pytest.approx([0.4 * 0.3 * 0.01 * 5e-4 / 1e-3] * 3)
    assert drag.turning_drag == pytest.approx([math.pi * 0.01 * 5e-4 / 0.1**5] * 3)
    assert 4 / 3 * math.pi * lift.geometry.radius**3 * 1.293 == pytest.approx(0.2)
    assert (lift.xyz, lift.buoyant) == ((0.0, 0.0, 0.05), True)
    written(tmp_path, text.replace("-0.2", "0.2"), "things.xml")
    with pytest.raises(RobotFileError, match=r"things\.xml: line 1: .*mass is 0\.2 kg"):
        quiet(tmp_path / "scene.xml", load_scene)


@pytest.mark.long
def test_a_floating_ball_loses_its_speed_as_in_simtwo(tmp_path):
    """Neutral buoyancy; a step of 1 ms takes 2e-3 of the velocity and 5e-4 of the angular velocity."""
    text = """<scene><things><sphere><ID value="ball"/><mass value="0.3"/><radius value="0.1"/><pos z="2"/>
      <drag stokes="2e-3" roll="5e-4"/><buoyant mass="-0.3"/></sphere></things></scene>"""
    loaded = quiet(written(tmp_path, text, "scene.xml"), load_scene)
    scene = compile_scene(loaded)
    start = initial_state(scene)
    speeds = scene.state_view(start).base_qd
    speeds[:] = (1.0, 0.0, 0.0, 0.0, 2.0, 0.0)
    run = simulate(scene, 1.0, start, record=("base_qd",))
    assert run.success
    end = run["base_qd"][-1]
    halves = sorted(abs(end[np.abs(speeds) > 0]))
    assert halves == pytest.approx(sorted((math.exp(-2.0), 2.0 * math.exp(-0.5))), rel=1e-3)
    assert np.abs(end[2]) < 1e-6


def test_a_solid_in_the_frame_of_another_is_the_same_as_in_that_of_the_robot(tmp_path):
    text = """<robot><solids><cuboid><ID value="base"/><pos x="1" z="0.5"/><rot_deg z="90"/></cuboid>
      <cylinder><ID value="wheel" kind="omni"/><size x="0.1" z="0.02"/>%s<drag/><buoyant mass="-1" %s="0.1"/></cylinder>
      </solids><articulations><joint><ID value="turn"/><pos x="1" y="0.3" z="0.5"/><axis %s x="0"/>
      <connect B1="wheel" B2="base"/><type value="Hinge"/></joint></articulations></robot>"""
    placed = '<solid id="base"/><pos x="0.3"/><rot_deg y="90"/>', "z", 'y="1"'
    plain = '<pos x="1" y="0.3" z="0.5"/><rot_deg x="-90"/>', "z", 'y="1"'
    one, two = (quiet(written(tmp_path, text % parts), contacts=["wheel"]) for parts in (placed, plain))
    q = [0.1, 0.2, 0.3, 1.0, 0.0, 0.0, 0.0, 0.4]
    np.testing.assert_allclose(mass_matrix(one, q), mass_matrix(two, q), atol=1e-12)
    assert one.contacts[0].axis == pytest.approx(two.contacts[0].axis, abs=1e-12)
    assert one.immersed[1].xyz == pytest.approx((0.0, 0.1, 0.0), abs=1e-12)
    assert two.immersed[1].xyz == pytest.approx((0.0, 0.1, 0.0), abs=1e-12)
    lost = quiet(written(tmp_path, text.replace("%s<drag/>", '<solid id="x"/><drag/>') % ("z", 'y="1"')))
    assert any(note.startswith("cart.xml, line 2: a solid names none") for note in lost.notes)


def test_shells_have_neither_drag_nor_rollers(tmp_path):
    shell = '<shells><cylinder><ID value="a" kind="omni"/><drag stokes="1"/></cylinder></shells>'
    model = quiet(written(tmp_path, CART % shell))
    assert model.immersed == ()
    assert sum("> is not read" in note for note in model.notes) == 2


def test_solids_without_gravity_bear_their_weight(tmp_path):
    model = quiet(written(tmp_path, (CART % "").replace('<pos z="0.1"/>', '<pos z="0.1"/><nogravity/>')))
    assert [link.gravity_compensation for link in model.links] == [1.0, 0.0, 0.0, 0.0]


def test_ball_joints_turn_in_all_directions(tmp_path):
    text = """<robot><solids><cuboid><ID value="one"/></cuboid><sphere><ID value="two"/><pos x="1"/></sphere></solids>
      <articulations><joint><ID value="hip"/><pos x="0.5"/><connect B1="two" B2="one"/><type value="Ball"/></joint>
      </articulations></robot>"""
    model = quiet(written(tmp_path, text))
    assert model.joint_names == ("hip.rx", "hip.ry", "hip.rz")
    assert model.keyframes["scene"][7:] == (1.0, 0.0, 0.0, 0.0)


def named(sensors, name):
    """The sensor of a name."""
    (found,) = [one for one in sensors if one.name == name]
    return found


SENSORS = """<sensors>
    <IRSharp><ID value="ahead"/><beam length="0.4"/><pos x="0.1" z="0.02"/><rot_deg z="-90"/></IRSharp>
    <ranger2d><ID value="fan"/><beam length="3"/><beam angle="90" rays="5"/><pos z="0.2"/></ranger2d>
    <sonar><ID value="sonar"/><beam length="2" angle="20"/></sonar>
    <IRSharp><ID value="fixed"/><pos x="0.5"/><absolute_coords/></IRSharp>
    <floorline><ID value="line"/><beam length="0.1" final_width="0.02"/><rot_deg y="90"/></floorline>
    <inductive><ID value="line"/></inductive>
    <imu><ID value="gyro"/></imu>
    <sonar><ID value="energy"/></sonar>
  </sensors>
  <tools><sonar><ID value="rim"/><solid id="Tyre 90"/></sonar><sonar><ID value="lost"/><solid id="x"/></sonar></tools>
  <tools><solenoid><ID value="grip"/><force fmax="10"/></solenoid></tools>"""


def test_sensors_along_rays_are_those_of_the_model(tmp_path):
    text = CART % SENSORS
    model = quiet(written(tmp_path, text))
    ahead = named(model.sensors, "ahead")
    assert (ahead.link, ahead.reach) == ("box", 0.4)
    # the box is turned a quarter about z and 0.1 m high: its x is the robot's y, and the ray leaves along the robot's x
    np.testing.assert_allclose(ahead.mounted, [[0.0, 0.1, 0.12, 1.0, 0.0, 0.0]], atol=1e-12)
    fan = named(model.sensors, "fan")
    angles = np.degrees(np.arctan2(fan.mounted[:, 4], fan.mounted[:, 3]))
    np.testing.assert_allclose(angles, 90 + np.linspace(-45, 45, 5), atol=1e-9)
    sonar = named(model.sensors, "sonar")
    assert (sonar.nearest, sonar.reach) == (True, 2.0)
    fixed = named(model.sensors, "fixed")
    np.testing.assert_allclose(fixed.mounted, [[0.5, 0.0, 0.0, 1.0, 0.0, 0.0]], atol=1e-12)
    line = named(model.sensors, "line")
    assert (type(line), line.radius, line.reach) == (LineSensor, 0.01, 0.1)
    np.testing.assert_allclose(line.mounted, [[0.0, 0.0, 0.1, 0.0, 0.0, -1.0]], atol=1e-12)
    assert named(model.sensors, "rim").link == "Tyre 90"
    assert named(model.sensors, "lost").link == "box"
    for tag, name in (("inductive", "line"), ("sonar", "energy")):  # which another sensor has, and a channel
        at = line_of(text, f'<{tag}><ID value="{name}"/>')
        assert any(one.startswith(f"cart.xml, line {at}: <{tag}> '{name}' is called") for one in model.notes)
    for words in ("'lost' names no solid", "<inductive> 'line': it measures the distance to any matter", "n x n rays"):
        assert any(words in one for one in model.notes), words
    for name in ("gyro", "grip"):
        assert any(f"{name!r} is left out: " in one for one in model.notes), name
    assert not any("'sonar'" in one for one in model.notes)


def test_sensors_of_a_scene_are_on_its_members_and_in_the_world(tmp_path):
    """Those of a robot have its name before theirs; runs record them, and sessions observe them, by these names."""
    written(tmp_path, CART % SENSORS)
    written(tmp_path, '<sensors><IRSharp><ID name="cell"/><pos z="1"/><rot_deg y="90"/></IRSharp></sensors>', "s.xml")
    text = '<scene><robot><ID name="a"/><body file="cart.xml"/></robot><sensors file="s.xml"/></scene>'
    model = quiet(written(tmp_path, text, "scene.xml"), load_scene)
    assert named(model.member("a").model.sensors, "ahead").link == "box"
    (cell,) = model.sensors
    assert (cell.link, cell.name) == ("world", "cell")
    np.testing.assert_allclose(cell.mounted, [[0.0, 0.0, 1.0, 0.0, 0.0, -1.0]], atol=1e-12)
    scene = compile_scene(model, None, integrator="implicit_euler", timestep=1e-3, fluid=None)
    assert {"cell", "a/ahead", "a/sonar"} < {*scene.sensors}
    assert {*scene.recompiled(timestep=2e-3).sensors} == {*scene.sensors}
    assert scene.sensors["a/ahead"].link == "a/box"
    y = initial_state(scene)
    view = scene.state_view(y)
    still = {"time": np.zeros(1), "base_q": view.base_q[None], "q": view.q[None]}
    late = SampledSensor("cell", noise=0.1)
    exact, noisy = (measure(scene, still, one, 2) for one in ("cell", late))
    assert np.array_equal(measure(scene, still, "a/sonar"), ranges(scene, still, scene.sensors["a/sonar"]))
    assert exact.shape == noisy.shape == (1, 1)
    assert exact[0, 0] == np.inf  # farther than it reaches
    with pytest.raises(ValueError, match=r"no channel or sensor 'sonar'; there are .*a/sonar"):
        measure(scene, still, "sonar")


def test_belts_move_and_propellers_push_by_the_speed_of_their_joint(tmp_path):
    """A belt moves along its x axis at SimTwo's first speed; a propeller that no hinge turns is left out."""
    text = """<robot><solids><belt><ID value="belt"/><size x="1" y="0.4" z="0.05"/><rot_deg z="90"/></belt>
      <propeller><ID value="prop"/><pos x="1"/><thrust coefficient="0.3"/></propeller></solids>
      <articulations><joint><ID value="turn"/><connect B1="prop" B2="belt"/><type value="Hinge"/></joint>
      </articulations></robot>"""
    path = written(tmp_path, text)
    model = load_robot(path, strict=True)
    assert model.propellers == (Propeller("turn", 0.0, linear_thrust=0.3),)
    surface = model.shapes[0].surface
    np.testing.assert_allclose(surface.velocity, [0.0, 1.0, 0.0], atol=1e-15)
    assert surface.command == 0.5
    assert any("line 1: <belt> 'belt'" in note and "command_surface" in note for note in model.notes)
    assert model.shapes[0].geometry == Box((1.0, 0.4, 0.05))
    assert any("line 2" in note and "'prop', 0.3 N s/rad" in note for note in model.notes)
    path = written(tmp_path, text.replace('value="Hinge"', 'value="Fixed"'))
    with pytest.warns(RobotFileWarning, match=r"cart\.xml, line 2: .*'prop', 0\.3 N s/rad.*left out"):
        assert load_robot(path).propellers == ()


BELT = """<robot><solids><belt><ID value="1"/><mass value="20"/><size x="1.5" y="0.4" z="0.05"/><pos z="0.1"/>
  <rot_deg z="90"/></belt></solids><articulations><joint><ID value="held"/><connect B1="world" B2="1"/>
  <type value="Fixed"/></joint></articulations></robot>"""
CONVEYOR = """<scene><robot><ID name="conveyor"/><pos x="0.2"/><body file="belt.xml"/></robot>
  <things><cuboid><ID value="crate"/><size x="0.1" y="0.1" z="0.1"/><pos x="0.2" z="0.175"/></cuboid>
  </things></scene>"""


def conveyor(tmp_path):
    written(tmp_path, BELT, "belt.xml")
    return quiet(written(tmp_path, CONVEYOR, "scene.xml"), load_scene)


def test_a_belt_that_a_joint_holds_to_the_world_is_an_obstacle(tmp_path):
    scene = conveyor(tmp_path)
    (one,) = scene.obstacles
    (shape,) = one.model.shapes
    np.testing.assert_allclose([one.position, shape.xyz], [[0.2, 0.0, 0.0], [0.0, 0.0, 0.1]], atol=1e-15)
    np.testing.assert_allclose(shape.surface.velocity, [0.0, 1.0, 0.0], atol=1e-15)
    assert compile_scene(scene, pairs="all").surface_drives == ("conveyor/1",)


@pytest.mark.long
def test_a_crate_moves_with_a_belt_of_simtwo(tmp_path):
    scene = compile_scene(conveyor(tmp_path), pairs="all")
    run = simulate(scene, 0.8, record=("base_qd",), switches=[(0.4, "conveyor/1", -0.2)])
    speed = run["crate"]["base_qd"][:, 1]
    assert [speed[len(speed) // 2 - 1], speed[-1]] == pytest.approx([0.5, -0.2], abs=1e-3)


@pytest.mark.parametrize(
    "element",
    [
        "<gearbox/>", "<nshells/>", "<shells><nsphere/></shells>", "<solids><cone/></solids>",
        "<sensors><odd/></sensors>", "<wheels><default><encoder/></default></wheels>",
        "<shells><sphere><glow/></sphere></shells>", '<shells><sphere><surface bounce="1"/></sphere></shells>',
        '<articulations><default><gear ke2="3"/></default></articulations>',
        '<wheels><default><tyre tread="3"/></default></wheels>', "<defines><noconst/></defines>",
        '<shells><sphere wide="1"/></shells>',
    ],
)  # fmt: skip
def test_nothing_is_dropped_in_silence(tmp_path, element):
    """The innermost element, or its attribute, is named with file and line."""
    text = CART % element
    name, attribute = re.findall(r'<(\w+)(?: (\w+)="\d+")?/>', element)[0]
    notes = quiet(written(tmp_path, text)).notes
    start = f"cart.xml, line {line_of(text, element)}: "
    assert any(note.startswith(start) and f"<{name}>" in note and attribute in note for note in notes), notes


def test_a_misspelled_property_is_warned_of_and_what_a_hinge_has_no_use_for_is_noted(tmp_path):
    text = """<robot><solids><cuboid><ID value="a"/></cuboid><cuboid><ID value="b"/><mas value="3"/></cuboid></solids>
      <articulations><joint><ID value="j"/><axis x="1"/><axis2 y="1"/><limits Min="-9" Mx="9"/><connect B1="b" B2="a"/>
      <type value="Hinge"/></joint></articulations></robot>"""
    with pytest.warns(
        RobotFileWarning, match=r"<mas> in <cuboid> .* mass meant\?.*Mx of <limits> .* Max meant\?"
    ) as said:
        model = load_robot(written(tmp_path, text))
    assert "axis2" not in str(said[0].message)
    assert any("<axis2> in <joint> is not read" in note for note in model.notes)
    with pytest.raises(RobotFileError, match="mass meant"):
        load_robot(tmp_path / "cart.xml", strict=True)


def test_constants_of_things_and_comments_with_hyphens(tmp_path):
    written(tmp_path, '<things><!-- a -- b --><sphere><ID value="ball"/><radius value="r"/></sphere></things>', "t.xml")
    text = '<scene><things file="t.xml"><defines><const name="r" value="0.2"/></defines></things></scene>'
    scene = quiet(written(tmp_path, text, "scene.xml"), load_scene)
    assert scene.member("ball").model.shapes[0].geometry == Sphere(0.2)


def test_a_robot_is_a_scene_and_a_missing_one_is_left_out(tmp_path):
    written(tmp_path, CART % "")
    assert [placed.name for placed in quiet(tmp_path / "cart.xml", load_scene).members] == ["cart"]
    text = '<scene>\n<robot><ID name="a"/><body file="no.xml"/></robot><robot><body file="cart.xml"/></robot></scene>'
    with pytest.warns(RobotFileWarning, match=r"scene\.xml, line 2: .*'no\.xml'"):
        scene = load_scene(written(tmp_path, text, "scene.xml"))
    assert [placed.name for placed in scene.members] == ["robot"]
    assert isinstance(scene.members[0].model.shapes[1].geometry, Cylinder)


def test_a_scene_says_what_of_it_is_not_read(tmp_path):
    written(tmp_path, CART % "")
    text = """<scene>
      <robot><rot_deg x="10"/><defines><noconst/></defines><body file="cart.xml"/></robot>
      <track file="lines.xml"/>
      <nobstacle/>
      <things><cylinder><ID value="roll" kind="omni"/><size x="0.1" z="0.05"/><rot_deg y="90"/></cylinder>
        <belt><ID value="belt"/></belt></things>
      <sensors file="none.xml"/>
    </scene>"""
    scene = quiet(written(tmp_path, text, "scene.xml"), load_scene)
    (point,) = scene.member("roll").model.contacts
    assert point.roller_angle == math.pi / 2
    left = {"<rot_deg>": 2, "<noconst>": 2, "<track>": 3, "<nobstacle>": 4, "<belt>": 6, "none.xml": 7}
    assert any('pairs="all"' in note for note in scene.notes)
    for word, line in left.items():
        assert any(note.startswith(f"scene.xml, line {line}: ") and word in note for note in scene.notes), word
    with pytest.raises(RobotFileError, match=r"none\.xml"):
        load_scene(tmp_path / "scene.xml", strict=True)
    assert any("load_scene reads all" in note for note in quiet(tmp_path / "scene.xml").notes)


def refused(path):
    """Return whether a file is refused with a message that names the wrong number."""
    try:
        quiet(path)
    except RobotFileError as error:
        return "1/0" in str(error)
    return False


def test_every_number_is_read_or_named(tmp_path):
    """A number that has no value refuses the file, or else a note names its element."""
    shell = '<shells><sphere><mass value="1"/><size radius="2"/><surface mu="1" bounce="0.2"/></sphere></shells>'
    text = (CART % (SENSORS + shell)).replace("</cuboid>", '<drag stokes="1" roll="2"/><buoyant mass="-1"/></cuboid>')
    numbers = list(re.finditer(r'="([-\d.]+)"', text))
    assert len(numbers) > 40
    for found in numbers:
        path = written(tmp_path, text[: found.start(1)] + "1/0" + text[found.end(1) :])
        if not refused(path):
            line = text[: found.start()].count("\n") + 1
            assert any(re.match(rf"cart\.xml, lines? .*\b{line}\b", note) for note in quiet(path).notes), found


def test_the_tiniest_solids_have_drag(tmp_path):
    solid = '<sphere><ID value="a"/><radius value="1e-70"/><drag coefficient="1"/></sphere>'
    scene = quiet(written(tmp_path, f"<scene><things>{solid}</things></scene>"), load_scene)
    assert scene.member("a").model.immersed[0].drag == 1.0
