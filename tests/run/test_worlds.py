"""Worlds: runs that differ in physical numbers share lanes, and each has the bits of its own scene alone."""

import dataclasses
import math
import pickle
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest
from scenes import box, box_on

from featherstone_gait import Distribution, Reference, Worlds, compile_scene, load_robot, simulate, simulate_batch
from featherstone_gait.core.compile.jit import JIT, entry, kernel
from featherstone_gait.core.compile.lanes import WIDTH, aligned, as_lanes
from featherstone_gait.core.compile.optional import in_lanes
from featherstone_gait.core.compile.structure import structure
from featherstone_gait.core.compile.varying import Varying, lane_dtype, lane_records
from featherstone_gait.core.tree.layout import BODY
from featherstone_gait.model import Ground, HeightField
from featherstone_gait.run.lane_constants import structure as structure_of
from featherstone_gait.run.prepare import prepare
from featherstone_gait.run.simulate import Push, initial_state
from featherstone_gait.study import read_study, run_study
from featherstone_gait.study.sensitivity import indices
from featherstone_gait.study.settings import _shares
from featherstone_gait.walking.cost_in_worlds import variations

RECORD = ("q", "qd", "energy", "voltage")
ONCE = {"estimate_error": False}
TENTH = Distribution("normal", 0.1)


def arm(servos="mipsd", integrator="implicit_euler", **more):
    return compile_scene(load_robot("ax12_arm"), servos, integrator=integrator, timestep=1e-3, **more)


def swings(scene, count, seed=0):
    """References that move all joints, each otherwise."""
    rng = np.random.default_rng(seed)
    return [Reference([0.0, 0.1, 0.2], rng.uniform(-0.5, 0.5, (3, scene.tree.n))) for _ in range(count)]


def assert_same(run, other, names):
    assert (run.status, run.message, run.end_time) == (other.status, other.message, other.end_time)
    assert run.final.tobytes() == other.final.tobytes()
    for name in ("time", *names):
        assert run[name].tobytes() == other[name].tobytes(), name


def differ(runs):
    """Whether no two runs are the same: a comparison of runs that do not differ would say nothing."""
    return len({run.final.tobytes() for run in runs}) == len(runs)


def leaves(x, path=""):
    """Each array and number of nested constants, with its place."""
    if isinstance(x, tuple):
        for name, part in zip(x._fields, x):
            yield from leaves(part, f"{path}.{name}")
    else:
        yield path, x


def assert_same_scene(a, b):
    """All numbers that a run, its verdict and its start depend on."""
    assert structure_of(a.constants) == structure_of(b.constants)
    for (place, x), (_, y) in zip(leaves(a.constants), leaves(b.constants)):
        assert np.asarray(x).tobytes() == np.asarray(y).tobytes(), place
    for name in ("timestep", "tick_steps", "lag", "gearbox", "fall_height", "fall_upright", "upright", "stiff"):
        assert getattr(a, name) == getattr(b, name), name
    assert a.preflight._replace(reason="") == b.preflight._replace(reason="")
    assert a.ground == b.ground
    assert initial_state(a).tobytes() == initial_state(b).tobytes()
    for part in ("links", "joints", "servos"):
        assert getattr(a.model, part) == getattr(b.model, part)


# ---------------------------------------------------------------------------------------------- records in lanes


@structure
class Constants(NamedTuple):
    bodies: np.ndarray
    gravity: np.ndarray
    absent: None


@structure
class Course(NamedTuple):
    constants: Constants
    h: float
    y: np.ndarray

    SHARED = ("constants", "h")


@kernel
def _sums(run, out):
    for i in range(len(run.constants.bodies)):
        b = run.constants.bodies[i]
        x = b.m
        x += b.c[1] * run.y[i]
        out[i] = x + b.J[5] + b.E[2] + b.parent + run.h * run.constants.gravity[2]


@entry
def _sums_in_lanes(run, out):
    _sums(in_lanes(run), as_lanes(out))


def in_memory(values):
    out = aligned(np.shape(values))
    out[...] = values
    return out


@pytest.mark.bounds
@pytest.mark.nojit
@pytest.mark.parametrize("names", [("m", "c", "J"), ("m",), ("c", "E")])
@pytest.mark.parametrize("numbers", ["shared", "by lane"])
def test_kernels_read_numbers_by_lane_and_shared_ones_alike(names, numbers):
    rng = np.random.default_rng(1)
    table = lane_records(3, lane_dtype(BODY, names))
    for name in ("m", "c", "J", "E"):
        table[name] = rng.normal(size=table[name].shape)
    table.parent = [4, 5, 6]
    by_lane = numbers == "by lane"
    gravity = rng.normal(size=(3, WIDTH) if by_lane else 3)
    h = rng.normal(size=WIDTH) if by_lane else 0.5
    given = [Varying(in_memory(x)) if by_lane else x for x in (gravity, h)]
    y, out, before = in_memory(rng.normal(size=(3, WIDTH))), aligned((3, WIDTH)), table.copy()
    _sums_in_lanes(Course(Constants(Varying(table), given[0], None), given[1], y), out)
    for i, b in enumerate(table):
        expected = (b["m"] + b["c"][1] * y[i]) + b["J"][5] + b["E"][2] + (4.0 + i) + h * gravity[2]
        np.testing.assert_array_equal(out[i], expected)
    assert all(table[name].tobytes() == before[name].tobytes() for name in BODY.names)


def test_fields_by_lane_lie_on_whole_vectors_and_the_others_stay_as_they_are():
    kind = lane_dtype(BODY, ("m", "J"))
    assert kind["m"].shape == (WIDTH,)
    assert kind["J"].shape == (6, WIDTH)
    assert [kind.fields[name][1] % 64 for name in ("m", "J")] == [0, 0]
    assert kind.itemsize % 64 == 0
    assert kind.isalignedstruct
    assert {name: kind[name] for name in BODY.names if name not in ("m", "J")} == {
        name: BODY[name] for name in BODY.names if name not in ("m", "J")
    }


def test_only_what_differs_is_by_lane():
    scene = arm()
    scenes = Worlds(runs=3, servos={"resistance": TENTH}).scenes(scene)
    ready = [prepare(one, 0.1) for one in scenes]
    constants = ready[0].among(ready).of_lanes.constants
    motor = constants.actuator.motor.values.dtype
    assert [name for name in motor.names if motor[name].shape] == ["resistance"]
    # Currents decay by R/L; stops are as stiff as the stall torque asks for; nothing else depends on a resistance.
    varying = {place.partition(".values")[0] for place, _ in leaves(constants) if place.endswith(".values")}
    assert varying <= {".actuator.motor", ".actuator.gear", ".decay", ".stops"}
    assert {".actuator.motor", ".decay"} <= varying


def test_scenes_that_do_not_differ_cost_what_they_did():
    """The lanes of equal scenes hold what the lanes of one scene hold: of the same types, compiled to the same code."""
    scene = arm()
    worlds = Worlds(runs=9, servos={"Kp": scene.model.servos[scene.model.joint_names[0]].controller.Kp})
    ready = [prepare(one, 0.1) for one in worlds.scenes(scene)]
    assert ready[0].among(ready) is ready[0]
    if JIT:
        import numba

        run, alone = (one.arguments_in_lanes([one.start()] * 8)[0] for one in (ready[0], prepare(scene, 0.1)))
        assert numba.typeof(run) == numba.typeof(alone)


# ---------------------------------------------------------------------------------------------- bits


@pytest.mark.quick("a search's")
@pytest.mark.bounds
@pytest.mark.nojit
@pytest.mark.parametrize(
    "values",
    [
        None,
        {"servos": {"resistance": TENTH, "coulomb_friction": TENTH, "Kp": Distribution("normal", 0.1, shared=True)}},
        {"links": {"mass": TENTH, "inertia": TENTH}, "gravity": [(0.0, 0.1 * k, -9.0 - 0.1 * k) for k in range(11)]},
    ],
    ids=["a search's", "servos", "links and gravity"],
)
def test_a_lane_has_the_bits_of_its_own_scene(values, humanoid):
    """Eleven runs: lanes are refilled, and idle at the end; with the JIT off few enough not to take long."""
    scene, duration = arm() if values else humanoid, 0.2 if JIT else 0.01
    worlds = Worlds(runs=11, **values) if values else variations(humanoid, 11)[0]
    references = swings(scene, 11)
    runs = simulate_batch(scene, duration, references=references, worlds=worlds, record=RECORD, **ONCE)
    assert differ(runs)
    for run, own, reference in zip(runs, worlds.scenes(scene), references):
        assert_same(run, simulate(own, duration, reference=reference, record=RECORD, **ONCE), RECORD)


@pytest.fixture(scope="module")
def humanoid():
    return compile_scene(load_robot("humanoid", locked="simplified"), "mipsd", Ground(), "midpoint", 1e-3)


@pytest.fixture(scope="module")
def everything():
    """Every number of ground, servos and links that a gait meets, and the lag; some robots fall."""
    share = Distribution("uniform", 0.2)
    servos = ("resistance", "inductance", "motor_constant", "voltage_limit", "current_limit", "stiffness", "damping")
    return Worlds(
        runs=19,
        ground={name: share for name in ("friction", "penetration", "damping_ratio")}
        | {"height": np.linspace(-0.1, 0.1, 19), "slope": np.linspace(0.0, 0.1, 19)},
        servos={name: share for name in (*servos, "rotor_inertia", "coulomb_friction", "Kp", "speed_filter")}
        | {"lag": np.linspace(0.0, 0.03, 19)},
        links={"mass": share, "inertia": share, "center_of_mass": Distribution("normal", 1e-3, additive=True)},
        gravity=np.array([0.0, 0.0, -9.81]) * np.linspace(0.8, 1.2, 19)[:, None],
        seed=4,
    )


@pytest.fixture(scope="module")
def walks(humanoid):
    """Every third run is thrown about."""
    rng = np.random.default_rng(5)
    sizes = [1.2 if k % 3 == 0 else 0.05 for k in range(19)]
    return [Reference([0.0, 0.2, 0.4], size * rng.uniform(-1, 1, (3, humanoid.tree.n))) for size in sizes]


@pytest.fixture(scope="module")
def alone(humanoid, everything, walks):
    scenes = everything.scenes(humanoid)
    how = dict(record=(*RECORD, "base_q", "contact_force"), **ONCE)
    return [simulate(scene, 0.6, reference=walk, **how) for scene, walk in zip(scenes, walks)]


@pytest.mark.long
@pytest.mark.parametrize("way", ["forward", "backward", "another process", "without refilling"])
def test_all_numbers_at_once_on_the_ground(humanoid, everything, walks, alone, way):
    names = (*RECORD, "base_q", "contact_force")
    assert {run.status for run in alone} >= {"ok", "fell"}
    assert differ(alone)
    order = list(range(19))[:: -1 if way == "backward" else 1]
    scenes, how = everything.scenes(humanoid), dict(record=names, **ONCE)
    if way == "another process":
        how["executor"] = SimpleNamespace(map=lambda work, items: [work(pickle.loads(pickle.dumps(x))) for x in items])
    if way == "without refilling":  # a push that does nothing: times matter, so lanes stay in step
        how["pushes"] = [Push(humanoid.tree.names[0], end=1e-3)]
    runs = simulate_batch([scenes[k] for k in order], 0.6, references=[walks[k] for k in order], **how)
    for k, run in zip(order, runs):
        other = alone[k]
        if way == "without refilling":
            other = simulate(scenes[k], 0.6, reference=walks[k], **how)
        assert_same(run, other, names)


@pytest.mark.long
def test_error_controlled_runs_take_their_own_scenes():
    scene = compile_scene(load_robot("ax12_arm"), "mipsd")
    worlds, references = Worlds(runs=3, servos={"Kp": TENTH}), swings(scene, 3)
    runs = simulate_batch(scene, 0.05, references=references, worlds=worlds, record=RECORD)
    assert differ(runs)
    for run, own, reference in zip(runs, worlds.scenes(scene), references):
        other = simulate(own, 0.05, reference=reference, record=RECORD)
        assert_same(run, other, RECORD)
        assert all(run.error[name].tobytes() == other.error[name].tobytes() for name in RECORD)


@pytest.mark.long
@pytest.mark.parametrize("estimate_error", [None, True])
def test_errors_are_those_of_the_run_alone(estimate_error):
    """Companions at twice the step, and runs at half the step, are worlds as well."""
    scene, how = arm(), {"record": ("q", "qd"), "estimate_error": estimate_error}
    worlds, references = Worlds(runs=4, servos={"resistance": TENTH}), swings(scene, 4)
    runs = simulate_batch(scene, 0.1, references=references, worlds=worlds, **how)
    for run, own, reference in zip(runs, worlds.scenes(scene), references):
        other = simulate(own, 0.1, reference=reference, **how)
        assert_same(run, other, ("q", "qd"))
        assert all(run.error[name].tobytes() == other.error[name].tobytes() for name in ("q", "qd"))
        assert run.error["q"].max() > 0.0


@pytest.mark.long
def test_scenes_of_other_structure_share_no_lanes_and_keep_their_bits():
    """No friction at all, another controller period, another step: other code, or another course."""
    scene = arm()
    kinds = [
        arm(integrator="midpoint"),
        compile_scene(scene.model, "rotor", integrator="implicit_euler", timestep=1e-3),
        compile_scene(scene.model, "mipsd", integrator="implicit_euler", timestep=5e-4),
        *Worlds(servos={"period": [0.005, 0.01, 0.02]}).scenes(scene),
        *Worlds(servos={"viscous_friction": [0.0, 0.1, 0.2], "coulomb_friction": 0.0}).scenes(scene),
    ]
    scenes, references = kinds * 3, swings(scene, 3 * len(kinds))
    runs = simulate_batch(scenes, 0.1, references=references, record=("q",), **ONCE)
    assert len({structure_of(one.constants) for one in kinds}) > 2
    for one, run, reference in zip(scenes, runs, references):
        assert_same(run, simulate(one, 0.1, reference=reference, record=("q",), **ONCE), ("q",))


def test_scenes_of_other_structure_are_not_put_in_step():
    ready = [prepare(scene, 0.1) for scene in (arm(), arm("rotor"))]
    with pytest.raises(ValueError, match="differ in more than numbers"):
        ready[0].run([one.start() for one in ready])


@pytest.mark.long
@pytest.mark.bounds
def test_a_height_field_may_lie_at_other_heights():
    rng = np.random.default_rng(0)
    field = HeightField(0.01 * rng.normal(size=(9, 9)), (0.2, 0.2), (-0.8, -0.8))
    scene = box_on(Ground(field=field, penetration=1e-3))
    worlds = Worlds(ground={"height": np.linspace(-0.05, 0.05, 5), "friction": np.linspace(0.2, 1.0, 5)})
    state = initial_state(scene, [0.0, 0.0, 0.2, 1.0, 0.1, 0.0, 0.0], [0.5, 0.0, 0.0, 0.0, 0.0, 1.0])
    runs = simulate_batch(scene, 0.4, [state] * 5, worlds=worlds, record=("base_q",), **ONCE)
    assert differ(runs)
    for run, own in zip(runs, worlds.scenes(scene)):
        assert_same(run, simulate(own, 0.4, state, record=("base_q",), **ONCE), ("base_q",))


# ---------------------------------------------------------------------------------------------- the scenes of worlds


NUMBERS = {
    "ground": {"friction": 0.3, "penetration": 1e-3, "damping_ratio": 0.3, "height": 0.1, "slope": 0.1, "heading": 0.2},
    "servos": {
        "resistance": 5.0, "inductance": 1e-3, "motor_constant": 0.01, "voltage_limit": 9.0, "current_limit": 1.0,
        "current_slew": 100.0, "viscous_friction": 0.1, "coulomb_friction": 0.1, "encoder_resolution": 1e-3,
        "speed_filter": 0.02, "ratio": 200.0, "rotor_inertia": 1e-7, "rotor_damping": 1e-7, "stiffness": 50.0,
        "damping": 0.2, "backlash": 0.01, "Kp": 20.0, "Ki": 1.0, "Kd": 1.0, "Kf": 0.1, "period": 0.02, "lag": 0.0,
        "compliance_margin": 0.01, "punch": 0.1, "pwm_steps": 885.0, "duty_limit": 0.9,
        "profile_speed": 2.0, "delay": 0.01,
    },
    "links": {"mass": 0.2, "center_of_mass": (0.0, 0.01, 0.02), "inertia": (1e-3, 0.0, 1e-5, 1e-3, 0.0, 1e-3)},
    "joints": {"damping": 0.1, "friction": 0.2, "armature": 1e-3, "effort": 2.0, "lower": -1.0, "upper": 1.0},
}  # fmt: skip


@pytest.mark.nojit
@pytest.mark.parametrize(("section", "name"), [(section, name) for section in NUMBERS for name in NUMBERS[section]])
def test_a_scene_with_another_number_is_the_one_compiled_with_it(section, name, humanoid):
    """Made by way of what the first scene has worked out, or from nothing: the same bits of every number."""
    value, model, ground = NUMBERS[section][name], humanoid.model, humanoid.ground
    numbers = np.broadcast_to(value, _shape(humanoid, section, value))
    (made,) = Worlds(runs=1, **{section: {name: numbers}}).scenes(humanoid)
    if section == "ground":
        ground = dataclasses.replace(ground, **{name: value})
    elif section == "servos":
        servos = {joint: _servo(servo, name, value) for joint, servo in model.servos.items()}
        moving = {joint: servos[joint] if joint in model.joint_names else model.servos[joint] for joint in servos}
        model = dataclasses.replace(model, servos=moving)
    else:
        parts = [
            dataclasses.replace(part, **{name: value}) if section == "links" or part.type != "fixed" else part
            for part in getattr(model, section)
        ]
        model = dataclasses.replace(model, **{section: parts})
    assert_same_scene(made, compile_scene(model, "mipsd", ground, "midpoint", 1e-3))


def _shape(scene, section, value):
    parts = {"ground": 1, "servos": scene.tree.n, "links": len(scene.model.links)}
    count = parts.get(section, sum(joint.type != "fixed" for joint in scene.model.joints))
    return (1, count, *np.shape(value))


def _servo(servo, name, value):
    for part in ("controller", "gearbox"):
        if hasattr(getattr(servo, part), name):
            return dataclasses.replace(servo, **{part: dataclasses.replace(getattr(servo, part), **{name: value})})
    return dataclasses.replace(servo, **{name: value})


@pytest.mark.nojit
def test_an_array_has_an_entry_a_run_even_where_there_are_as_many_parts(humanoid):
    n = humanoid.tree.n
    scenes = Worlds(servos={"Kp": np.arange(1.0, n + 1.0)}).scenes(humanoid)
    gains = [[one.model.servos[name].controller.Kp for name in humanoid.model.joint_names] for one in scenes]
    assert gains == [[k + 1.0] * n for k in range(n)]
    by_part = np.arange(1.0, n + 1.0)[None]
    (one,) = Worlds(servos={"Kp": by_part}).scenes(humanoid)
    assert [one.model.servos[name].controller.Kp for name in humanoid.model.joint_names] == by_part[0].tolist()


@pytest.mark.nojit
def test_one_part_may_be_named():
    scene = arm()
    joint = scene.model.joint_names[0]
    first, second = Worlds(servos={f"{joint}.Kp": [1.0, 2.0]}).scenes(scene)
    assert (first.model.servos[joint].controller.Kp, second.model.servos[joint].controller.Kp) == (1.0, 2.0)
    others = [name for name in scene.model.joint_names if name != joint]
    assert all(second.model.servos[name] == scene.model.servos[name] for name in others)


# ---------------------------------------------------------------------------------------------- draws


def drawn(spread, parts=4, runs=20000, seed=0):
    return spread.drawn(np.linspace(1.0, 2.0, parts), runs, np.random.default_rng(seed)) / np.linspace(1.0, 2.0, parts)


@pytest.mark.nojit
def test_draws_have_the_spread_that_is_asked_for():
    uniform, normal, log = (drawn(Distribution(law, 0.2)) for law in ("uniform", "normal", "lognormal"))
    assert np.abs(uniform - 1.0).max() <= 0.2
    assert uniform.std() == pytest.approx(0.2 / math.sqrt(3.0), rel=0.02)
    assert normal.mean() == pytest.approx(1.0, abs=0.005)
    assert normal.std() == pytest.approx(0.2, rel=0.02)
    assert np.log(log).std() == pytest.approx(0.2, rel=0.02)
    assert np.log(log).mean() == pytest.approx(0.0, abs=0.005)
    added = Distribution("normal", 0.5, additive=True).drawn(np.array([3.0]), 20000, np.random.default_rng(0))
    assert added.std() == pytest.approx(0.5, rel=0.02)
    assert added.mean() == pytest.approx(3.0, abs=0.02)


@pytest.mark.nojit
def test_draws_are_one_a_part_or_one_for_all():
    assert abs(np.corrcoef(drawn(TENTH)[:, :2].T)[0, 1]) < 0.05
    same = drawn(Distribution("normal", 0.1, shared=True))
    np.testing.assert_allclose(same, np.repeat(same[:, :1], 4, axis=1), rtol=1e-14)


@pytest.mark.nojit
def test_a_draw_depends_on_seed_field_and_run_alone():
    scene = arm()

    def resistances(runs, seed=0, **more):
        scenes = Worlds(runs=runs, seed=seed, servos={"resistance": TENTH, **more}).scenes(scene)
        return [[servo.resistance for servo in one.model.servos.values()] for one in scenes]

    few = resistances(3)
    assert resistances(5)[:3] == few
    worlds = Worlds(runs=3, servos={"resistance": TENTH})
    (last,) = worlds.scenes(scene, [2])
    assert [servo.resistance for servo in last.model.servos.values()] == few[2]
    assert resistances(3, Kp=TENTH) == few
    assert resistances(3, seed=1) != few


@pytest.mark.nojit
@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({}, ["no runs and no array"]),
        ({"runs": 3, "servos": {"Kp": [1.0, 2.0]}}, ["runs 3", "Kp 2", "one length"]),
        ({"runs": 3, "servos": {"kp": 1.0}}, ["'kp'", "Kp"]),
        ({"runs": 3, "ground": {"sole.friction": 1.0}}, ["sole.friction", "friction"]),
        ({"runs": 3, "servos": {"law": "state"}}, ["'law'", "resistance"]),
        ({"runs": 3, "links": {"mass": "heavy"}}, ["mass is 'heavy'", "Distribution"]),
        ({"runs": 3, "links": {"mass": math.nan}}, ["mass", "finite"]),
        ({"runs": -1}, ["runs is -1", "0"]),
        ({"gravity": [1.0, 2.0]}, ["gravity", "(2,)", "(runs, 3)"]),
    ],
)
def test_what_makes_no_worlds_is_refused(given, words):
    with pytest.raises(ValueError, match="worlds: ") as caught:
        Worlds(**given)
    assert [word for word in words if word not in str(caught.value)] == []


@pytest.mark.nojit
@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"servos": {"tail.Kp": 1.0}}, ["'tail'", "use one of"]),
        ({"ground": {"friction": 0.5}}, ["ground", "the scene of ax12_arm has none"]),
        ({"links": {"mass": np.ones((3, 9))}}, ["links.mass", "(3, 9)"]),
        ({"links": {"center_of_mass": np.ones((3, 3))}}, ["links.center_of_mass", "(3, 3)", "(3, 1, 3)"]),
        ({"servos": {"resistance": [1.0, -1.0, 1.0]}}, ["world 1", "resistance is -1.0", "> 0"]),
        ({"servos": {"period": [0.01, 0.01, 0.0105]}}, ["world 2", "does not divide"]),
    ],
)
def test_numbers_that_make_no_scene_are_refused(given, words):
    with pytest.raises(ValueError, match="world") as caught:
        Worlds(runs=3, **given).scenes(arm())
    assert [word for word in words if word not in str(caught.value)] == []


@pytest.mark.nojit
@pytest.mark.parametrize(
    ("arguments", "message"),
    [(("cauchy", 0.1), "'lognormal'"), (("normal", -0.1), "scale is -0.1"), (("lognormal", 0.1, True), "factor")],
)
def test_spreads_that_have_no_meaning_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        Distribution(*arguments)


@pytest.mark.nojit
def test_there_is_a_run_for_each_world():
    scene = arm()
    with pytest.raises(ValueError, match=r"scenes have \[1, 2, 1, 1, 3\]|\[.*2.*3.*\] entries"):
        simulate_batch(scene, 0.01, references=swings(scene, 2), worlds=Worlds(runs=3))
    with pytest.raises(TypeError, match="worlds is 3"):
        simulate_batch(scene, 0.01, worlds=3)
    with pytest.raises(ValueError, match="a list of these"):
        simulate_batch(3, 0.01)


@pytest.mark.long
def test_a_box_may_be_of_any_mass_on_ground_as_stiff_as_it_asks():
    """The ground's stiffness follows the weight: each box sinks in by `sinking`."""
    scene = box_on(Ground(penetration=1e-3), model=box())
    worlds = Worlds(links={"mass": [0.1, 1.0, 10.0, 100.0]})
    states = [initial_state(own) for own in worlds.scenes(scene)]
    for run in simulate_batch(scene, 1.0, states, worlds=worlds, record=("base_q", "contact_force"), **ONCE):
        assert run["base_q"][-1, 2] == pytest.approx(0.05 - 1e-3, abs=1e-7)


# ---------------------------------------------------------------------------------------------- sensitivity


def ishigami(x):
    """Of x in [-pi, pi]^3, with known indices (T. Ishigami and T. Homma, 1990; a = 7, b = 0.1)."""
    return np.sin(x[..., 0]) + 7.0 * np.sin(x[..., 1]) ** 2 + 0.1 * x[..., 2] ** 4 * np.sin(x[..., 0])


@pytest.mark.nojit
def test_sobol_indices_of_ishigamis_function():
    shares = _shares({"method": "saltelli", "count": 4096, "seed": 3}, [1, 1, 1])
    found = indices(ishigami(math.pi * (2.0 * shares - 1.0)).reshape(-1, 5))
    for index, first, total in zip(found, (0.3139, 0.4424, 0.0), (0.5576, 0.4424, 0.2437)):
        assert index.first == pytest.approx(first, abs=0.02)
        assert index.total == pytest.approx(total, abs=0.02)
        assert abs(index.total - total) < 2.0 * index.total_error < 0.06


@pytest.mark.nojit
def test_sobol_indices_of_what_is_drawn_together():
    """Of (x1 + x2 + x3) x4 + x5 with the first three in one group, against its variances."""
    x = 2.0 * _shares({"method": "saltelli", "count": 4096, "seed": 5}, [3, 1, 1]) - 1.0
    found = indices((x[:, :3].sum(axis=1) * (1.0 + x[:, 3]) + x[:, 4]).reshape(-1, 5))
    parts = np.array([1.0, 0.0, 1.0 / 3.0, 1.0 / 3.0])  # of the group, x4, x5 alone, of the group with x4
    first, total = parts[:3], parts[:3] + np.array([1.0, 1.0, 0.0]) / 3.0
    for index, alone, together in zip(found, first / parts.sum(), total / parts.sum()):
        assert index.first == pytest.approx(alone, abs=0.02)
        assert index.total == pytest.approx(together, abs=0.02)


@pytest.mark.nojit
def test_runs_without_a_value_take_their_base_sample_along():
    rng = np.random.default_rng(0)
    values = rng.normal(size=(64, 4))
    holed = np.vstack([values, [[1.0, math.nan, 2.0, 3.0]]])
    assert indices(holed) == indices(values)
    assert all(math.isnan(number) for number in indices(np.ones((8, 4)))[0])
    assert all(math.isnan(number) for number in indices(np.full((8, 4), np.nan))[0])


@pytest.mark.long
def test_a_study_tells_which_parameter_matters(tmp_path):
    """Of an arm that is held, the offset follows the tilt it starts with and hardly the inductance."""
    path = tmp_path / "which.toml"
    text = 'robot = "ax12_arm"\nexperiment = "hold"\nduration = 0.2\n[scene]\nintegrator = "implicit_euler"\n'
    text += '[sampling]\nmethod = "saltelli"\ncount = 128\nseed = 1\n'
    text += "[vary]\nposture.tilt = {from = 0.05, to = 0.2}\nservo.inductance = {from = 1e-4, to = 2e-4}\n"
    path.write_text(text, "utf-8")
    study = read_study(path)
    assert len(study) == 128 * 4
    outcome = run_study(study, tmp_path)
    assert outcome.sensitivity.with_suffix(".png").stat().st_size > 1000
    told = outcome.sensitivity.read_text("utf-8").splitlines()
    assert any(line.startswith("# offset_deg: 512 values, mean ") for line in told)
    lines = [line.split(",") for line in told if not line.startswith("#")][1:]
    total = {(line[0], line[1]): float(line[4]) for line in lines if line[4]}
    assert total["offset_deg", "posture.tilt"] > 0.9
    assert total["offset_deg", "servo.inductance"] < 0.05


@pytest.mark.nojit
def test_a_count_that_is_no_power_of_two_is_refused(tmp_path):
    path = tmp_path / "study.toml"
    text = 'robot = "ax12_arm"\nexperiment = "hold"\n[sampling]\nmethod = "saltelli"\ncount = 100\n'
    path.write_text(text + "[vary]\nservo.Kp = {from = 10.0, to = 20.0}\n", "utf-8")
    with pytest.raises(ValueError, match=r"count is 100; 'saltelli' takes a power of two: 128"):
        read_study(path)
