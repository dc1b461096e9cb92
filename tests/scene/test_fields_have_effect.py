"""Each number of each record changes the run of a scene that lets it matter, or is refused, or a note says why not.

Numbers are found by `dataclasses.fields`, so that a new one is tested, or missing in `SCENES`.
"""

import importlib
import math
import pkgutil
import re
import warnings
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from itertools import product
from typing import get_args

import numpy as np
import pytest

import featherstone_gait.model as package
from featherstone_gait import (
    Box,
    Capsule,
    ContactPoint,
    ContactSensor,
    Controller,
    Cylinder,
    FloorLine,
    Fluid,
    ForceTorqueSensor,
    Gearbox,
    Ground,
    Hull,
    Immersed,
    Joint,
    LineSensor,
    Link,
    Loop,
    Mimic,
    Model,
    PairContact,
    Placed,
    Propeller,
    RangeSensor,
    Reference,
    SampledSensor,
    SceneModel,
    Servo,
    Shape,
    Sphere,
    Spring,
    Supply,
    Surface,
    Tendon,
    compile_scene,
    initial_state,
    simulate,
)
from featherstone_gait.model import HeightField
from featherstone_gait.model.pair_friction import PairFriction
from featherstone_gait.model.servo import TORQUE_LAWS, Law
from featherstone_gait.model.tendon import Via, Wrap
from featherstone_gait.scene.gearbox_kinds import GEARBOX_KINDS

X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
NUMBER = re.compile(r"\b(float|int|bool|Vector|ndarray|Moment)\b")
FIXED, ADAPTIVE = ("implicit_euler", "midpoint", "rk4"), ("ars343", "extrapolation", "dop853")
# Fields that need another change than by a third, of all of them:
OTHER = {
    "Controller.period": 0.024, "Controller.lag": 0.03, "Controller.delay": 0.006, "Controller.wrap": False,
    "Controller.pwm_steps": 255.0,
}  # fmt: skip


def numbers(record, path=()):
    """Yield path, class, field and value of each number within a record, dictionary or tuple."""
    if is_dataclass(record):
        inner = [(f.name, getattr(record, f.name)) for f in fields(record)]
    else:
        inner = list(record.items() if isinstance(record, Mapping) else enumerate(record))
    for key, value in inner:
        if key == "side":  # of which the direction counts, not each number
            yield (*path, (record, key)), value
        elif is_dataclass(value) or (isinstance(value, Mapping | tuple)):
            yield from numbers(value, (*path, (record, key)))
        elif isinstance(value, bool | int | float | np.ndarray):
            yield (*path, (record, key)), value


def name_of(path):
    """Return "Class.field" of a number, of the innermost record that holds it."""
    record, key = next(step for step in reversed(path) if is_dataclass(step[0]))
    return f"{type(record).__name__}.{key}"


def changed(path, value):
    """Return the outermost record with another value at the end of the path."""
    for record, key in reversed(path):
        if is_dataclass(record):
            value = replace(record, **{key: value})
        elif isinstance(record, Mapping):
            value = dict(record) | {key: value}
        else:
            value = type(record)(value if k == key else old for k, old in enumerate(record))
    return value


def other(name, value):
    """Return another value of a number."""
    if name in OTHER:
        return OTHER[name]
    if name == "Wrap.side":  # which side alone
        return tuple(-x for x in value)
    if isinstance(value, bool):
        return not value
    if isinstance(value, np.ndarray):
        return value + 0.1
    return value * 1.3 if value else 0.1


def outcome(run_of, given):
    """Return what a run of the records gives, as bytes by name, and the notes; None where they are refused."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            scene, run = run_of(**given())
        except ValueError:
            return None, ()
    return {name: values.tobytes() for name, values in run.items()}, [*scene.notes, *(str(w.message) for w in said)]


def matters(name, path, value):
    """Return whether a scene states a number, which differs then from what a record has without."""
    record, key = next(step for step in reversed(path) if is_dataclass(step[0]))
    (field,) = (f for f in fields(record) if f.name == key)
    return name not in NO_NUMBERS and not np.array_equal(getattr(record, key), field.default)


def stated(records):
    """Yield name, path and value of what a scene states."""
    for path, value in numbers(records):
        name = name_of(path)
        if matters(name, path, value):
            yield name, path, value


def without_effect(run_of, records):
    """Return the numbers whose change neither changes the run nor is refused or noted."""
    base, _ = outcome(run_of, lambda: records)
    assert base is not None
    found = []
    for name, path, value in stated(records):
        new = other(name, value)
        now, notes = outcome(run_of, lambda path=path, new=new: changed(path, new))
        if now == base and not any(name in note for note in notes):
            found.append(f"{'.'.join(str(key) for _, key in path)}: {name} = {value!r}")
    return found


SERVO = Servo(
    Controller(
        "state", 20.0, 3.0, 0.5, 0.3, 0.012, 0.02, math.inf, 0.01, 0.2, 1023.0, 0.5, 8.0, 0.004, True
    ),
    Gearbox(100.0, 1e-6, 1e-6, 20.0, 0.05, 0.01, 0.1, 0.12, 0.05, 0.5, 1.2, 0.02, 0.05, 0.04, 0.03, 0.02),
    5.0, 3e-3, 0.01, 10.0, 0.5, 300.0, 0.01, 0.02, 0.01, 1e-3, 5e-3,
)  # fmt: skip


SUPPLY = Supply(9.0, 0.5)


def fit(law, gearbox):
    """Return whether a scene takes both."""
    return law not in TORQUE_LAWS or gearbox != "mipsd"


def servo_of(law):
    """A servo of each law, with all numbers that the law knows."""
    if law in TORQUE_LAWS:
        whole = Controller(law, 5.0, Kd=0.05, period=0.012, lag=0.02, torque_limit=1.0, wrap=True)
        return {"servo": replace(SERVO, controller=whole)}
    gains = {"Kp": 1.0, "Kd": 3e-3, "Ki": 1.0, "wrap": False} if law == "pid_speed" else {}
    return {"servo": replace(SERVO, controller=replace(SERVO.controller, law=law, **gains)), "supply": SUPPLY}


def driven(gearbox, integrator):
    """Return the function that runs a servo."""
    return lambda servo, supply=None: arm(servo, supply, gearbox, integrator)


def arm(servo, supply, gearbox, integrator, timestep=1e-3):
    """Two links that hang from servos and go to other angles."""
    inertia = (2e-3, 0.0, 0.0, 2e-3, 0.0, 1e-3)
    links = (Link("base"), *(Link(name, 0.3, (0.0, 0.0, -0.1), inertia) for name in ("upper", "lower")))
    most = math.inf if servo.controller.wrap else 2.0
    joints = tuple(
        Joint(name, "revolute", *ends, (0.0, 0.0, z), axis=Y, lower=-most, upper=most)
        for name, ends, z in (("a", ("base", "upper"), 0.0), ("b", ("upper", "lower"), -0.2))
    )
    model = Model("arm", links, joints, servos={"a": servo, "b": servo}, supply=supply)
    scene = compile_scene(model, gearbox, integrator=integrator, timestep=timestep)
    goal = 2.0 * math.pi if servo.controller.wrap else 0.0
    times = [0.0, 0.2, 0.4, 0.6]
    ends = [[0.0, 0.0], [goal + 1.0, goal - 0.6], [goal - 0.5, goal + 0.4], [goal - 0.5, goal + 0.4]]
    record = ["q", "qd", "energy", "torque", *(["current", "voltage"] if scene.sampled else [])]
    run = simulate(
        scene, 0.6, initial_state(scene, [0.1, -0.2]), Reference(times, ends, "hold"), record=record,
        record_interval=0.024, estimate_error=False,
    )  # fmt: skip
    return scene, run


INERTIA = (2e-3, 1e-4, 2e-4, 3e-3, 1e-4, 1.5e-3)
TURNED = (0.9, 0.1, 0.2, 0.3)
PLACE = {"xyz": (0.05, 0.02, -0.2), "rpy": (0.1, 0.2, 0.3)}
ONE = {
    "lower": -0.03, "upper": 0.03, "effort": 20.0, "damping": 0.02, "friction": 0.01, "armature": 1e-3,
    "stiffness": 1.0, "spring_reference": -0.2, "quadratic_stiffness": 0.3, "cubic_stiffness": 0.5,
    "quadratic_damping": 0.005, "cubic_damping": 0.01,
}  # fmt: skip


def link(name, mass=0.4, compensation=0.1):
    return Link(name, mass, (0.02, 0.01, -0.1), INERTIA, compensation)


def joints():
    """Links on joints of several kinds, of which one follows another."""
    return {"model": Model(
        "jointed", (Link("base"), *map(link, ("one", "two", "three", "four", "five", "six", "seven"))), (
            Joint("swing", "revolute", "base", "one", axis=Y, **PLACE, **ONE),
            Joint("screw", "screw", "one", "two", axis=Z, pitch=0.02, damping=0.02, **PLACE),
            Joint("cross", "universal", "two", "three", axis=X, axis2=Y, degrees={"r1": ONE, "r2": ONE}, **PLACE),
            Joint("slide", "prismatic", "one", "four", axis=Z, mimic=Mimic("swing", 0.1, 0.05), **PLACE),
            Joint("ball", "ball", "base", "five", upper=0.05, damping=0.01, stiffness=0.5, friction=0.005,
                  armature=1e-3, **PLACE),
            Joint("held", "fixed", "five", "six", **PLACE),
            Joint("locked", "revolute", "six", "seven", axis=X, **PLACE),
        ), locked={"locked": 0.4},
    )}  # fmt: skip


def tendons():
    """Two links with tendons of both kinds, and a spring."""
    two = (
        Joint("a", "revolute", "base", "one", axis=Y, **PLACE),
        Joint("b", "revolute", "one", "two", axis=Y, **PLACE),
    )
    path = (Via("base", (0.1, 0.02, 0.03)), Wrap("one", "sphere", 0.12, (0.05, 0.02, -0.1), side=(0.3, 0.02, -0.1)),
            Via("two", (0.1, 0.03, -0.1), 0.8))  # fmt: skip
    law = Controller("pd_clamped", 5.0, Kd=0.1, torque_limit=0.05)
    round_ = Wrap("one", "cylinder", 0.03, (0.01, 0.01, -0.05), (0.1, 1.0, 0.2), (0.1, 0.02, -0.05))
    number = {"stiffness": 5.0, "damping": 0.1, "friction": 0.05}
    return {
        "model": Model(
            "pulled", (Link("base"), link("one"), link("two")), two,
            tendons=(
                Tendon("sum", (("a", 0.5), ("b", 0.3)), (), rest=(-0.01, 0.01), lower=-0.02, upper=0.02, armature=1e-3,
                       controller=law, **number),
                Tendon("run", (), path, rest=(0.1, 0.12), **number),
                Tendon("round", (), (path[0], round_, path[2]), rest=0.1, **number),
            ),
        ),
        "springs": (Spring("base", "two", (0.1, 0.2, 0.3), (0.02, 0.03, -0.1), 20.0, 0.2, 0.3),),
    }  # fmt: skip


def water():
    """A boat with a propeller and shapes of each law in a current."""
    by_speed = {"drag": (0.5, 0.6, 0.7), "turning_drag": 0.3, "linear_damping": 0.1, "turning_damping": 1e-3}
    mujoco = {"buoyant": False, "xyz": (0.05, 0.02, 0.01), "rpy": (0.1, 0.2, 0.3)}
    mass = tuple(tuple(0.1 * (i == j) + 0.01 for j in range(6)) for i in range(6))
    return {
        "model": Model(
            "boat", (link("hull", 1.0), link("screw", 0.1)),
            (Joint("shaft", "continuous", "hull", "screw", axis=X, **PLACE),), "floating",
            immersed=(
                Immersed("hull", Box((0.3, 0.2, 0.1)), PLACE["xyz"], PLACE["rpy"], "", **by_speed, stokes=1.2,
                         added_mass=0.5, added_inertia=(0.1, 0.2, 0.3)),
                Immersed("hull", Sphere(0.1), PLACE["xyz"], PLACE["rpy"], added_matrix=mass, drag=0.4),
                Immersed("hull", Capsule(0.05, 0.2), PLACE["xyz"], PLACE["rpy"], drag=0.4),
                Immersed("hull", Cylinder(0.05, 0.2), PLACE["xyz"], PLACE["rpy"], drag=0.4),
                Immersed("hull", Box((0.3, 0.2, 0.1)), law="box", **mujoco),
                Immersed("hull", Box((0.3, 0.2, 0.1)), law="ellipsoid", fluidcoef=(0.5, 0.3, 1.4, 0.9, 0.8), **mujoco),
            ),
            propellers=(Propeller("shaft", 1e-3, 1e-4, 2e-3),),
        ),
        "fluid": Fluid(900.0, 0.1, 0.03, (0.3, 0.2, 0.1)),
    }  # fmt: skip


def loops():
    """Links that loops of all kinds hold."""
    two = tuple(Joint(a, "ball", "base", b) for a, b in (("p", "one"), ("q", "two")))
    at = {"point_a": (0.0, 0.0, -0.1), "point_b": (0.1, 0.0, -0.1)}
    return {"model": Model("closed", (Link("base"), link("one"), link("two")), two, loops=(
        Loop("rod", "distance", "one", "two", **at, distance=0.1),
        Loop("pin", "hinge", "two", None, axis=(0.6, 0.0, 0.8), rpy_a=PLACE["rpy"], rpy_b=PLACE["rpy"]),
    ))}  # fmt: skip


def belt():
    return Surface((0.1, 0.2, 0.05), (0.1, 0.2, 0.3), (0.02, 0.03, 0.01), "", 0.8)


def wheels(ground):
    """A cart on contact points of all kinds, with sensors."""
    points = (
        ContactPoint("cart", (0.2, 0.1, -0.05), friction=0.5),
        ContactPoint("cart", (0.2, -0.1, -0.03), 0.03, rolling_friction=2e-3),
        ContactPoint("cart", (-0.2, 0.1, -0.02), 0.0, 0.04, (0.0, 0.8, 0.6), True, 0.7, 0.7, 0.1),
        ContactPoint("cart", (-0.2, -0.1, -0.05), surface=belt()),
        ContactPoint("cart", (-0.3, -0.1, -0.05), load_bearing=False),
    )
    level = {"position": (0.02, 0.03, 0.04), "rpy": (0.1, 0.2, 0.3)}
    down = RangeSensor("cart", np.array([[0.3, 0.1, -1.0], [0.2, 0.3, -0.8]]), **level, curve=((0.0, 3.0), (0.5, 0.4)))
    sensors = (
        down,
        replace(down, curve=(), reach=0.13, name="near"),
        replace(down, curve=(), nearest=True, name="sonar"),
        LineSensor("cart", ((0.02, 0.0, 0.0), (0.3, 0.04, 0.0)), 0.03, (0.1, 0.2, -1.0)),
        LineSensor("cart", ((0.02, 0.0, 0.0),), 0.03, (0.1, 0.2, -1.0), 0.065, name="low"),
        ForceTorqueSensor("arm", (0.02, 0.03, 0.04), (0.1, 0.2, 0.3)),
        ContactSensor("cart", 22.0),
        SampledSensor("gyroscope", 0.01, 50.0, 0.02, 3, "late"),
        SampledSensor("gyroscope", (0.01, 0.02, 0.03), 50.0, name="apart"),
    )
    part = (link("cart", 2.0, 0.0), link("arm", compensation=0.0))
    held = (Joint("shoulder", "revolute", "cart", "arm", axis=Y, damping=0.1),)
    sensors = () if ground.field else sensors
    return {"model": Model("cart", part, held, "floating", contacts=points, sensors=sensors), "ground": ground}


def plane():
    tape = (FloorLine(((-0.3, 0.0), (0.2, 0.03), (0.5, 0.2)), 0.05),)
    steps = ((0.1, -0.01), (0.21, 0.02))
    return wheels(Ground(0.6, 2e-3, 0.5, 0.02, 0.1, steps, 0.3, None, (0.2, 0.1), 0.4, (0.1, 0.2), tape))


def field():
    x = np.arange(25.0).reshape(5, 5)
    return wheels(Ground(0.6, 2e-3, 0.5, 0.02, field=HeightField(0.02 * np.sin(x), (0.3, 0.25), (-0.5, -0.55))))


def shape(geometry, link="body", **more):
    return Shape(link, geometry, (0.01, 0.02, 0.0), (0.1, 0.2, 0.3), **more)


def thing(name, position, *shapes):
    return Placed(Model(name, (link("body", 0.5),), (), "floating", shapes=shapes), name, position, TURNED)


def pairs():
    """Bodies of all shapes that slide and roll on obstacles."""
    own = {"friction": 0.5, "torsional_friction": 3e-3, "rolling_friction": 4e-3}
    points = tuple((x, y, z) for x in (-0.04, 0.05) for y in (-0.05, 0.04) for z in (-0.04, 0.06))
    falling = (
        thing("ball", (0.0, 0.01, 0.05), shape(Sphere(0.05), **own)),
        thing("pill", (0.3, 0.01, 0.08), shape(Capsule(0.05, 0.1))),
        thing("disc", (0.6, 0.01, 0.08), shape(Cylinder(0.05, 0.1), priority=2, **own)),
        thing("dice", (0.9, 0.01, 0.08), shape(Box((0.1, 0.11, 0.12)))),
        thing("stone", (1.2, 0.01, 0.08), shape(Hull(points))),
        thing("puck", (1.5, 0.01, 0.08), shape(Box((0.1, 0.11, 0.12)))),
    )
    turned = (0.01, 0.02, 0.03)
    board = Shape("body", Box((3.04, 0.09, 0.2)), (0.0, 0.0, -0.1), turned, priority=1, friction=0.4, surface=belt())
    plate = Model("plate", (Link("body"),), (), shapes=(board,))
    hills = HeightField(0.01 * np.sin(np.arange(25.0).reshape(5, 5)), (0.3, 0.25), (-0.5, -0.55))
    hill = Model("hill", (Link("body"),), (), shapes=(Shape("body", hills, (0.02, 0.03, 0.01), turned),))
    level = (0.99, 0.01, 0.02, 0.03)
    obstacles = Placed(plate, "plate", (0.0, 0.0, 0.0), level), Placed(hill, "hill", (1.5, 0.01, 0.0), level)
    stated = (PairFriction("dice", "plate", 0.3, 3e-3, 2e-3),)
    return {
        "model": SceneModel("things", falling, obstacles, frictions=stated, gravity=(0.5, 0.6, -9.0)),
        "pairs": PairContact("all", 1e-3, 0.5, 0.6, 1e-3, 2e-3, 2.0, 300),
    }  # fmt: skip

COARSE = {"extrapolation": 1e-3, "dop853": 1e-3}  # tolerances: 244 runs of the scene with pairs took 15 minutes


def released(integrator, record):
    """Return the function that runs a scene without servos."""

    def run_of(model, **options):
        h = 1e-3 if integrator in FIXED else None
        falls = {"fall_height": -1.0, "fall_tilt": math.pi}
        scene = compile_scene(model, None, integrator=integrator, timestep=h, **falls, **options)
        state = initial_state(scene, allow_limit_violation=True)
        view = scene.state_view(state)
        if scene.tree.floating:
            view.base_qd[:] = 0.3
        view.qd[:] = 0.0 if scene.model.loops else [0.2 if one == "slide" else 2.0 for one in scene.model.joint_names]
        base = ["base_q", "base_qd"] if scene.tree.floating else []
        what = [*base, "q", "qd", "energy", *record, *(one.name for one in getattr(model, "sensors", ()))]
        return scene, simulate(
            scene, 0.3, state, record=what, record_interval=0.01, rtol=COARSE.get(integrator), estimate_error=False
        )

    return run_of


NO_NUMBERS = {
    "Joint.velocity": "a limit that plans and checks read; a run goes on beyond it",
    "Placed.ground_contact": "a switch, which test_forest.py tests",
    "Model.keyframes": "postures by name",
    "Model.references": "ranges that a judgment keeps to, which test_judge.py tests",
    "PairContact.max_points": "room alone: a run that needs more ends",
    "Mesh.scale": "reads a file; a hull after that",
}
SCENES = {
    "joints": (joints, ["ball_q"]),
    "tendons": (tendons, ["tendon_force"]),
    "water": (water, []),
    "loops": (loops, ["ball_q", "loop_force"]),
    "plane": (plane, ["contact_force", "surface_work"]),
    "field": (field, ["contact_force"]),
    "pairs": (pairs, []),
}


@pytest.mark.long
@pytest.mark.parametrize("integrator", [*FIXED, *ADAPTIVE])
@pytest.mark.parametrize("name", SCENES)
def test_models(name, integrator):
    records, record = SCENES[name]
    assert not without_effect(released(integrator, record), records())


def cases():
    """Yield each law with each integrator, in turn with all gearboxes that fit the law."""
    for (k, law), (i, integrator) in product(enumerate(get_args(Law)), enumerate([*FIXED, *ADAPTIVE])):
        gearboxes = [one for one in GEARBOX_KINDS if fit(law, one)]
        yield law, gearboxes[(k + i) % len(gearboxes)], integrator


@pytest.mark.long
@pytest.mark.parametrize(("law", "gearbox", "integrator"), [*cases()])
def test_servos(law, gearbox, integrator):
    assert not without_effect(driven(gearbox, integrator), servo_of(law))


def test_motor_and_firmware_of_a_rigid_servo():
    """A kind that is compiled for other tests."""
    exact = replace(SERVO, gearbox=Gearbox(100.0, 1e-6, 1e-6, 20.0, 0.05, 0.01))
    servo = replace(exact, controller=replace(SERVO.controller, wrap=False))
    assert not without_effect(driven("rotor", "implicit_euler"), {"servo": servo, "supply": SUPPLY})


def test_all_numbers_are_in_a_scene():
    """Each number of each record of models, but those that have no effect in any run."""
    records = [make() for make, _ in SCENES.values()] + [servo_of(law) for law in get_args(Law)]
    names = {name for one in records for name, *_ in stated(one)}
    found = pkgutil.iter_modules(package.__path__, f"{package.__name__}.")
    modules = [importlib.import_module(one.name) for one in found]
    kinds = {one for module in modules for one in vars(module).values() if isinstance(one, type) and is_dataclass(one)}
    numeric = {f"{one.__name__}.{f.name}" for one in kinds for f in fields(one) if NUMBER.search(str(f.type))}
    assert numeric - names == NO_NUMBERS.keys()


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda: Loop("pin", "connect", "a", rpy_b=(0.1, 0.0, 0.0)), "rpy_b"),
        (lambda: Loop("pin", "weld", "a", axis=Y), "axis"),
        (lambda: Wrap("a", "sphere", 0.1, axis=Y), "axis is"),
        (lambda: Tendon("t", (), [Via("a", share=0.5), Via("b")]), "share"),
        (lambda: Controller("state", torque_limit=2.0), "torque_limit"),
        (lambda: Controller("pd", punch=0.1), "punch"),
    ],
    ids=lambda one: one if isinstance(one, str) else "",
)
def test_numbers_of_another_kind_are_refused(make, name):
    with pytest.raises(ValueError, match=f"{name}.*(leave|give)"):
        make()


def test_numbers_without_effect_are_noted():
    """By the gearbox, the law, the integrator and the type of the joint: field, value, whose, and what to do."""
    held = Joint("held", "fixed", "lower", "tool", damping=0.3)
    servo = replace(SERVO, stick_speed=1e-4, controller=replace(SERVO.controller, law="pid_position", wrap=False))
    links = tuple(map(link, ("base", "lower", "tool")))
    hinge = Joint("hinge", "revolute", "base", "lower", axis=Y)
    robot = Model("arm", links, (hinge, held), servos={"hinge": servo})
    noted = "\n".join(compile_scene(robot, "standard", integrator="rk4").notes)
    for words in (
        "Gearbox.stiffness = 20 of 'hinge' has no effect: .*mipsd", "Gearbox.rotor_inertia = 1e-06 .*rotor",
        "Servo.speed_filter = 0.005 .*state", "Servo.stick_speed = 0.0001 .*ars343", "Joint.damping = 0.3 of 'held'",
    ):  # fmt: skip
        assert re.search(words, noted), words
    assert [note.split()[0] for note in compile_scene(robot, "mipsd").notes] == ["Servo.speed_filter", "Joint.damping"]
    pair = compile_scene([Placed(robot, "one"), Placed(robot, "two", (1.0, 0.0))], "mipsd").notes
    assert pair[0].startswith("one: Servo.speed_filter")
    assert pair[-1].startswith("two: Joint.damping")
