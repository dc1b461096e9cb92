"""Gradients through each law alone, against extrapolated differences of whole runs that change no branch."""

import math
import zlib
from dataclasses import replace

import numpy as np
import pytest
from scenes import box, box_on, pendulum, resting

from featherstone_gait import (
    Ground,
    HeightField,
    Push,
    Reference,
    Sphere,
    Supply,
    body,
    compile_scene,
    gradient,
    initial_state,
    load_robot,
    load_servo,
    run_cost,
    simulate,
)
from featherstone_gait.analysis.gradient_check import Given, How, moved_by, scale_of, values_of
from featherstone_gait.model import Controller, Gearbox, Joint, Link, Mimic, Model, Servo, Tendon

pytestmark = pytest.mark.long
WIDTH, AGREE = 2e-5, 1e-8
# With contact: a run solves each step to 1e-9 of its forces, which differences see and gradients do not.  With 1e-14 in
# place of 1e-9 they agree to 1e-10; of what cancels in a derivative that leaves so much of the cost, and what the
# differences of two widths are apart.
ON_GROUND, CANCELS = 1e-7, 1e-10
SMOOTH = {"coulomb_friction": 0.0, "encoder_resolution": 0.0}
ALWAYS = ("state.q", "state.qd", "gravity")


@run_cost
def of_joints(time, q, qd):
    total = 0.0
    for k in range(len(time)):
        for j in range(q.shape[1]):
            total += math.sin(1.0 + k + j) * q[k, j] + 0.1 * math.cos(2.0 * k) * (qd[k, j] - 0.3) ** 2
    return total


@run_cost
def of_a_base(time, base_q, base_qd):
    total = 0.0
    for k in range(len(time)):
        for j in range(7):
            total += math.sin(1.0 + k + j) * base_q[k, j]
        for j in range(6):
            total += 0.1 * math.cos(2.0 * k + j) * (base_qd[k, j] - 0.3) ** 2
    return total


def agrees(given, cost, names, duration=0.06, pushes=(), width=WIDTH, tolerance=AGREE):
    """Assert that derivatives along a random change of each parameter equal differences of order 6."""
    record = tuple(name for name in cost.channels if name != "time")
    how = How(duration, pushes, record, None)
    found = gradient(
        given.scene, duration, cost, names, given.state, given.reference, given.tau, pushes, record_interval=None
    )
    assert found.status in ("ok", "chatter")
    rng = np.random.default_rng(zlib.crc32(given.scene.model.name.encode()))
    for name in names:
        shape = found[name].shape
        along = scale_of(given, name) * rng.uniform(0.3, 1.0, shape) * rng.choice([-1.0, 1.0], shape)
        widths = width * np.array([1.0, 0.5, 0.25])
        ends = [moved_by(given, {name: w * along}, sign) for w in widths for sign in (1.0, -1.0)]
        values = values_of(cost, how, ends).reshape(3, 2)
        first = (values[:, 0] - values[:, 1]) / (2.0 * widths)
        second = (4.0 * first[1:] - first[:-1]) / 3.0
        best = (16.0 * second[1] - second[0]) / 15.0
        slope = float(np.sum(found[name] * along))
        size = max(abs(slope), float(np.max(np.abs(found[name] * along))))
        rounding = 10.0 * np.finfo(float).eps * np.abs(values).max() / widths[-1]  # of the differences
        left = CANCELS * np.abs(values).max() + abs(second[1] - second[0]) if tolerance == ON_GROUND else 0.0
        assert abs(slope - best) <= tolerance * size + rounding + left, (name, slope, best, second)


def rod(gearbox="rotor", integrator="midpoint", servo=None, joint=None, ahead=0.0, **changes):
    """A rod that hangs down, one servo at its hinge; it moves on in one direction, its reference ahead [rad]."""
    model = pendulum(damping=0.02)
    model = replace(model, joints=(replace(model.joints[0], **(joint or {})),))
    if gearbox is not None:
        own = load_servo("ax12", **{**SMOOTH, **changes}) if servo is None else servo
        model = replace(model, servos={"hinge": own})
    scene = compile_scene(model, gearbox, integrator=integrator, timestep=1e-3)
    state = initial_state(scene, [0.3], [0.7])
    times = np.linspace(0.0, 0.06, 4)
    signal = Reference(times, ahead + np.array([[0.3], [0.33], [0.38], [0.42]]), "cubic")
    if gearbox is not None:
        return Given(scene, state, signal)
    return Given(scene, state, None, Reference(times, np.array([[0.0], [0.1], [-0.2], [0.1]]), "cubic"))


@pytest.mark.parametrize("integrator", ["midpoint", "implicit_euler", "rk4"])
def test_a_joint_under_torques(integrator):
    agrees(rod(None, integrator), of_joints, (*ALWAYS, "tau", "links.mass", "joints.damping"))


MOTOR = ("servos.resistance", "servos.motor_constant", "servos.Kp", "servos.ratio", "servos.rotor_inertia")
SERVOS = {
    "an AX-12 with a rigid gear": (rod, {}, MOTOR),
    "one with a spring in its gear": (rod, {"gearbox": "mipsd"}, (*MOTOR, "servos.stiffness", "servos.rotor_damping")),
    "one by the implicit Euler rule": (rod, {"gearbox": "mipsd", "integrator": "implicit_euler"}, MOTOR),
    "one with a coil": (rod, {"inductance": 0.01}, ("servos.inductance", "servos.resistance")),
    "one that sees filtered speeds": (rod, {"speed_filter": 0.02, "Kd": 0.5}, ("servos.speed_filter", "servos.Kd")),
    "one at its voltage limit, of which it takes a share": (
        rod, {"Kp": 1e3, "ahead": 0.2, "duty_limit": 0.7},
        ("servos.voltage_limit", "servos.duty_limit", "servos.resistance"),
    ),
    "one at its current limit": (rod, {"Kp": 1e3, "ahead": 0.2, "current_limit": 0.37}, ("servos.current_limit",)),
    "a position loop": (
        rod, {"law": "pid_position", "Kp": 20.0, "Ki": 5.0, "Kd": 0.1, "Kf": 0.0},
        ("servos.Kp", "servos.Ki", "servos.Kd"),
    ),
    "a speed loop": (
        rod, {"law": "pid_speed", "Kp": 3.0, "Ki": 5.0, "Kd": 0.01, "Kf": 0.0}, ("servos.Kp", "servos.Ki"),
    ),
    "a lag of half a tick": (rod, {"lag": 0.0155}, ("servos.Kp",)),
    "a dead band, a punch, a profile of speed and a delay": (
        rod, {"compliance_margin": 0.005, "punch": 0.3, "profile_speed": 0.2, "delay": 0.013},
        ("servos.compliance_margin", "servos.punch", "servos.profile_speed", "servos.Kp"),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SERVOS)
def test_a_servo(name):
    make, how, numbers = SERVOS[name]
    agrees(make(**how), of_joints, (*ALWAYS, "reference", *numbers))


def test_a_servo_that_goes_the_short_way_round():
    model = pendulum(damping=0.02)
    joint = replace(model.joints[0], type="continuous", lower=-math.inf, upper=math.inf)
    servo = load_servo("ax12", **SMOOTH, wrap=True)
    scene = compile_scene(
        replace(model, joints=(joint,), servos={"hinge": servo}), "rotor", integrator="midpoint", timestep=1e-3
    )
    ahead = Reference(np.linspace(0.0, 0.06, 4), np.array([[3.03], [3.05], [3.08], [3.1]]), "cubic")
    given = Given(scene, initial_state(scene, [3.0], [0.7]), ahead)
    agrees(given, of_joints, ("state.q", "state.qd", "reference", "servos.Kp"), tolerance=ON_GROUND)


def test_a_driven_tendon_without_a_reference_holds_the_length_at_the_start():
    inertia = (0.01, 0.0, 0.0, 0.01, 0.0, 0.01)
    links = [Link(name, 1.0, (0.0, 0.0, -0.1), inertia) for name in ("base", "upper", "lower")]
    joints = [
        Joint("shoulder", "revolute", "base", "upper", axis=(0.0, 1.0, 0.0)),
        Joint("elbow", "revolute", "upper", "lower", xyz=(0.0, 0.0, -0.2), axis=(0.6, 0.8, 0.0)),
    ]
    pull = Tendon("pull", [("shoulder", 0.05), ("elbow", 0.03)], controller=Controller("pd", 400.0, Kd=2.0))
    model = Model("driven", tuple(links), tuple(joints), tendons=[pull])
    scene = compile_scene(model, integrator="midpoint", timestep=1e-3)
    agrees(Given(scene, initial_state(scene, [0.3, -0.2], [0.5, 0.2])), of_joints, ("state.q", "state.qd"))


@pytest.mark.parametrize(("law", "integrator"), [("pd", "midpoint"), ("pd_clamped", "rk4")])
def test_a_continuous_servo(law, integrator):
    servo = Servo(Controller(law, 4.0, Kd=0.1, torque_limit=10.0), Gearbox(1.0, 1e-3))
    given = rod("standard", integrator, servo)
    agrees(given, of_joints, (*ALWAYS, "reference", "servos.Kp", "servos.Kd"))


FRICTIONS = {
    "M1": {"coulomb_friction": 0.05},
    "M6": {
        "stribeck_friction": 0.05, "stribeck_speed": 2.575, "stribeck_exponent": 0.841, "external_load_friction": 0.05,
        "motor_load_friction": 0.3115, "stribeck_external_load": 0.014, "stribeck_motor_load": 0.1877,
        "quadratic_external_load": 0.01, "quadratic_motor_load": 0.0069,
    },
}  # fmt: skip


@pytest.mark.parametrize("model", FRICTIONS)
@pytest.mark.parametrize("gearbox", ["rotor", "mipsd"])
def test_friction_of_a_gear(model, gearbox):
    changes = {"coulomb_friction": 0.05} | FRICTIONS[model]
    numbers = tuple(f"servos.{name}" for name in changes)
    names = (*ALWAYS, "reference", "servos.viscous_friction", *numbers)
    agrees(rod(gearbox, stick_speed=1e-3, **changes), of_joints, names)


def test_a_joint_with_friction_a_stiffening_spring_a_damper_and_an_armature():
    joint = {
        "friction": 0.05, "stiffness": 2.0, "spring_reference": 0.1, "quadratic_stiffness": 1.0, "cubic_stiffness": 3.0,
        "quadratic_damping": 0.02, "cubic_damping": 0.01, "armature": 0.1,
    }  # fmt: skip
    names = ("friction", "damping", "stiffness", "spring_reference", "armature")
    agrees(rod(None, joint=joint), of_joints, (*ALWAYS, "tau", *(f"joints.{name}" for name in names)))


def test_a_joint_beyond_its_stop():
    given = rod(None, joint={"upper": 0.2999})
    agrees(given, of_joints, (*ALWAYS, "tau", "joints.upper"), duration=0.02, width=2e-6)


def test_a_source_that_servos_share():
    model = replace(load_robot("arm7"), supply=Supply(11.1, 0.5))
    servo = load_servo("ax12", **SMOOTH, lag=0.0)
    model = replace(model, servos=dict.fromkeys(model.joint_names, servo))
    scene = compile_scene(model, "rotor", integrator="midpoint", timestep=1e-3)
    q = 0.05 * np.arange(1.0, 8.0)
    given = Given(scene, initial_state(scene, q, np.ones(7)), Reference([0.0, 0.06], [q, q + 0.05]))
    agrees(given, of_joints, (*ALWAYS, "reference", "supply.voltage", "supply.resistance", "servos.resistance"))


def test_joints_that_follow_others():
    links = (Link("base"), *(Link(name, 1.0, (0.0, 0.0, -0.2), (1e-2, 0.0, 0.0, 1e-2, 0.0, 1e-3)) for name in "ab"))
    joints = (
        Joint("first", "revolute", "base", "a", axis=(0.0, 1.0, 0.0)),
        Joint("second", "revolute", "a", "b", xyz=(0.0, 0.0, -0.4), axis=(0.0, 1.0, 0.0), mimic=Mimic("first", 0.7)),
    )
    scene = compile_scene(Model("followers", links, joints), integrator="midpoint", timestep=1e-3)
    given = Given(scene, initial_state(scene, [0.3, 0.21], [0.5, 0.35]), None, np.array([0.2, 0.1]))
    agrees(given, of_joints, (*ALWAYS, "tau", "links.mass"))


def test_a_free_body_that_is_pushed():
    scene = compile_scene(body(Sphere(0.1), 1.0, name="stone"), integrator="midpoint", timestep=1e-3)
    state = initial_state(scene, [0.1, 0.2, 0.3, 0.8, 0.6, 0.0, 0.0], [0.3, -0.2, 0.1, 1.0, 2.0, -0.5])
    push = [Push(scene.model.links[0].name, (1.0, 0.5, 0.2), point=(0.02, 0.0, 0.05), start=0.01, end=0.04)]
    agrees(Given(scene, state), of_a_base, ("state.base_q", "state.base_qd", "gravity", "links.mass"), pushes=push)


def sliding(integrator="midpoint", **ground):
    """A box that slides on its corners and turns."""
    scene = box_on(Ground(friction=0.5, penetration=1e-3, **ground), integrator, 1e-3, box())
    return Given(scene, resting(scene, (1.0, 0.5, 0.0)))


CONTACT = ("state.base_q", "state.base_qd", "gravity", "links.mass", "ground.friction", "ground.penetration")


@pytest.mark.parametrize("integrator", ["midpoint", "implicit_euler", "rk4"])
def test_contact_that_slides(integrator):
    agrees(sliding(integrator), of_a_base, (*CONTACT, "ground.damping_ratio"), width=1e-5, tolerance=ON_GROUND)


def test_contact_on_a_slope_that_moves():
    given = sliding(slope=0.2, velocity=(0.3, 0.1), turning=0.5)
    agrees(given, of_a_base, (*CONTACT, "ground.slope"), width=1e-5, tolerance=ON_GROUND)


def test_contact_that_sticks():
    given = sliding()
    given = given._replace(state=resting(given.scene, (1e-3, 0.0, 0.0)))
    agrees(given, of_a_base, CONTACT, duration=0.03, width=1e-5, tolerance=ON_GROUND)


def test_a_ball_that_rolls_with_resistance():
    scene = compile_scene(
        body(Sphere(0.1), 1.0, rolling_friction=2e-3, name="ball"), ground=Ground(penetration=1e-4),
        integrator="midpoint", timestep=1e-3, fall_height=-1e6, fall_tilt=math.pi,
    )  # fmt: skip
    state = initial_state(scene)
    view = scene.state_view(state)
    view.base_qd[0], view.base_qd[4] = 0.5, 5.0
    names = ("state.base_qd", "gravity", "ground.friction")
    agrees(Given(scene, state), of_a_base, names, width=1e-5, tolerance=ON_GROUND)


def test_a_slope_written_as_a_height_field():
    x = np.linspace(-2.0, 2.0, 81)
    field = HeightField(np.repeat((0.2 * x)[:, None], 81, 1), (0.05, 0.05), (-2.0, -2.0))
    scene = box_on(Ground(friction=0.3, penetration=1e-3, field=field), "midpoint", 1e-3, box())
    start = initial_state(scene)
    scene.state_view(start).base_qd[0] = 0.3
    settled = simulate(scene, 0.2, start, record=("base_q",), estimate_error=False).final

    @run_cost
    def height(base_q):
        return base_q[-1, 2]

    found = gradient(scene, 0.1, height, ["state.base_q"], settled)["state.base_q"]
    assert found[0] == pytest.approx(0.192, abs=1e-3)  # the slope, but for what friction takes
    given = Given(scene, settled)
    agrees(given, height, ("state.base_q", "state.base_qd"), duration=0.05, width=1e-5, tolerance=ON_GROUND)
