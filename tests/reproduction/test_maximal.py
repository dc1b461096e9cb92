"""Bodies and constraints: closed forms, rest, the limit of small steps and many sweeps, and equal bits."""

import hashlib
import math
from dataclasses import replace

import numpy as np
import pytest
from scenes import G, box, box_on, pendulum, resting, rotations
from scipy.special import ellipk

from featherstone_gait import compile_scene, initial_state, load_robot, simulate
from featherstone_gait.dynamics import energy
from featherstone_gait.model import Ground, Joint, Link, Model
from featherstone_gait.reproduction import maximal
from featherstone_gait.reproduction.maximal import EXACT, Engine
from featherstone_gait.reproduction.maximal.layout import AXIS, BODY, DRIVE, JOINT, LAMBDA, PLACE, POINT, SPEED
from featherstone_gait.reproduction.maximal.run import advance
from featherstone_gait.reproduction.maximal.world import assembled, work_of
from featherstone_gait.run.reference import Reference

SOFT = replace(EXACT, cfm=1e-5, soft_cfm=1e-5)


def fixed(model, timestep, **how):
    return compile_scene(model, integrator="implicit_euler", timestep=timestep, **how)


# ---------------------------------------------------------------------------------------------- one body


@pytest.mark.long
def test_a_free_fall_is_that_of_semi_implicit_euler():
    """After n steps the velocity is g n h and the way g h^2 n (n + 1) / 2."""
    scene = fixed(replace(box(), contacts=()), 1e-3)
    run = maximal.simulate(scene, 0.5, engine=EXACT, record=("base_q", "base_qd"))
    n = np.round(run["time"] / 1e-3)
    assert np.abs(run["base_qd"][:, 2] + G * 1e-3 * n).max() < 1e-12
    assert np.abs(run["base_q"][:, 2] + 0.5 * G * 1e-6 * n * (n + 1)).max() < 1e-12


@pytest.mark.long
@pytest.mark.parametrize("axis", range(3))
def test_a_free_body_keeps_spin_and_energy_as_the_step_goes_to_zero(axis):
    """Drift of angular momentum and energy of a tumbling body halves with the step."""
    model = replace(box(size=(0.4, 0.3, 0.1)), contacts=())
    inertia = np.array(model.links[0].inertia)[[0, 3, 5]]
    spin = np.full(3, 2.0)
    spin[axis] = 6.0
    drifts = []
    for h in (1e-3, 5e-4):
        scene = fixed(model, h, gravity=(0.0, 0.0, 0.0))
        start = initial_state(scene, [0, 0, 0, 1, 0, 0, 0], [0, 0, 0, *spin])
        run = maximal.simulate(scene, 1.0, start, engine=EXACT, record=("base_q", "base_qd"))
        now = energy(model, run["base_q"], run["base_qd"]).sum(axis=1)
        momentum = (rotations(run["base_q"][:, 3:7]) @ (inertia * run["base_qd"][:, 3:6])[..., None])[..., 0]
        size = np.linalg.norm(momentum[0])
        drifts.append([abs(now / now[0] - 1.0).max(), np.linalg.norm(momentum - momentum[0], axis=1).max() / size])
    coarse, fine = np.array(drifts)
    assert coarse.max() < 0.02
    assert (1.7 < coarse / fine).all()
    assert (coarse / fine < 2.3).all()


# ---------------------------------------------------------------------------------------------- a pendulum


@pytest.mark.long
@pytest.mark.parametrize("swing", [0.1, 2.0])
def test_a_pendulum_has_its_period(swing):
    """4 K(sin(swing / 2)) / omega, omega^2 = m g l / J about the hinge."""
    length = 0.5
    scene = fixed(pendulum(length, damping=0.0), 1e-3)
    run = maximal.simulate(scene, 6.0, initial_state(scene, [swing]), engine=EXACT, record_interval=1e-3)
    q, t = run["q"][:, 0], run["time"]
    k = np.flatnonzero((q[:-1] > 0) & (q[1:] <= 0))
    crossings = t[k] + 1e-3 * q[k] / (q[k] - q[k + 1])
    period = 4.0 * ellipk(math.sin(swing / 2) ** 2) / math.sqrt(1.5 * G / length)
    assert len(crossings) > 2
    assert np.diff(crossings).mean() == pytest.approx(period, rel=1e-3)


@pytest.mark.long
def test_the_energy_of_a_pendulum_drifts_with_the_first_power_of_the_step():
    """What mending the constraint takes and gives: 0.26 % in five seconds at 1 ms, of the energy of its swing."""
    drifts = []
    for h in (1e-3, 5e-4):
        scene = fixed(pendulum(damping=0.0), h)
        run = maximal.simulate(scene, 5.0, initial_state(scene, [1.0]), engine=EXACT)
        now = energy(scene.model, run["q"], run["qd"]).sum(axis=1)
        drifts.append(abs(now - now[0]).max() / (0.25 * G * (1.0 - math.cos(1.0))))
    assert drifts[0] < 0.004
    assert 1.7 < drifts[0] / drifts[1] < 2.3


@pytest.mark.long
def test_angles_go_on_beyond_a_turn():
    scene = fixed(pendulum(damping=0.0), 1e-3, gravity=(0.0, 0.0, 0.0))
    run = maximal.simulate(scene, 2.0, initial_state(scene, [0.0], [10.0]), engine=EXACT)
    assert run["q"][-1, 0] == pytest.approx(20.0, rel=1e-3)


@pytest.mark.long
def test_a_stop_and_dry_friction_hold_a_pendulum():
    stopped = fixed(pendulum(upper=0.5), 1e-3)
    run = maximal.simulate(stopped, 1.0, initial_state(stopped, [0.2], [3.0]), engine=EXACT, record_interval=1e-3)
    assert 0.5 - 1e-6 < run["q"].max() < 0.5 + 0.01
    weight = 0.25 * G * math.sin(0.5)
    for friction, moves in ((0.95 * weight, True), (1.05 * weight, False)):
        scene = fixed(pendulum(damping=0.0, friction=friction), 1e-3)
        run = maximal.simulate(scene, 1.0, initial_state(scene, [0.5]), engine=EXACT)
        assert (abs(run["q"][-1, 0] - 0.5) > 1e-2) == moves
        assert moves or abs(run["q"][-1, 0] - 0.5) < 1e-6


# ---------------------------------------------------------------------------------------------- contact


@pytest.mark.long
@pytest.mark.parametrize("engine", [SOFT, replace(SOFT, iterations=200)], ids=["solved", "swept"])
@pytest.mark.parametrize("friction", [0.3, 0.45, 0.55])
def test_a_box_on_a_slope_slides_as_coulomb_says_and_sticks_beyond(engine, friction):
    """Down a slope whose tangent is 0.5 with g (sin - mu cos), and not at all from mu = 0.5 on."""
    slope = math.atan(0.5)
    scene = box_on(Ground(friction=friction, slope=slope), timestep=1e-3)
    run = maximal.simulate(scene, 1.0, resting(scene), engine=engine, record=("base_q", "base_qd", "contact_force"))
    c, s = math.cos(slope), math.sin(slope)
    speed = run["base_qd"] @ [c, 0.0, s, 0.0, 0.0, 0.0]
    pull = min(0.0, -G * (s - friction * c))
    k = 30  # from where it has settled on
    assert (speed[-1] - speed[k]) / (run["time"][-1] - run["time"][k]) == pytest.approx(pull, abs=2e-3 * G)
    force = run["contact_force"][-1].sum(axis=0)
    assert force[0] == pytest.approx(G * c, rel=2e-3)
    assert abs(force[1]) <= friction * force[0] * (1 + 1e-6)


@pytest.mark.long
def test_a_ball_bounces_as_high_as_it_is_told():
    """From 0.2 m with 0.6: 0.36 of the height, to what a step of 0.1 ms misses; soft contacts take some of it."""
    scene = box_on(Ground(), timestep=1e-4)
    height = 0.05 + 0.2
    start = initial_state(scene, [0, 0, height, 1, 0, 0, 0])
    run = maximal.simulate(
        scene, 0.4, start, engine=replace(EXACT, bounce=0.6), record=("base_q",), record_interval=1e-3
    )
    z = run["base_q"][:, 2]
    low = int(np.argmin(z[: int(0.3e3)]))
    assert z[low:].max() - 0.05 == pytest.approx(0.36 * 0.2, rel=0.02)


def stack(count, engine):
    """So many boxes of 1 kg, 0.4 m x 0.4 m x 0.1 m, on the ground and on one another; world and work of it."""
    bodies, points = np.zeros(count + 1, BODY), np.zeros(4 * count, POINT)
    model = box()
    inertia = np.array(model.links[0].inertia)
    for k in range(1, count + 1):
        bodies[k]["mass"], bodies[k]["inverse_mass"] = 1.0, 1.0
        bodies[k]["inertia"] = inertia
        bodies[k]["inverse_inertia"][[0, 3, 5]] = 1.0 / inertia[[0, 3, 5]]
        for j, corner in enumerate(model.contacts):
            p = points[4 * (k - 1) + j]
            p["a"], p["b"], p["position"], p["place"] = k, k - 1, corner.position, 4 * (k - 1) + j
            p["normal"], p["first"], p["second"] = (0, 0, 1), (1, 0, 0), (0, 1, 0)
            p["height"], p["friction"] = 0.05 * (k > 1), 0.5
    tables = (bodies, np.zeros(0, JOINT), np.zeros(0, AXIS), points)
    world = (*(t.view(np.recarray) for t in tables), engine.record(), np.zeros(0, DRIVE).view(np.recarray))
    work = work_of(world, 0)
    work[0][1:, 2] = 0.05 + 0.1 * np.arange(count)
    return world, work


@pytest.mark.quick("swept")
@pytest.mark.parametrize("engine", [SOFT, replace(SOFT, iterations=60, shuffle_every=8)], ids=["solved", "swept"])
def test_a_stack_stays_at_rest(engine):
    """Three boxes: after two seconds none has moved by 0.1 mm, and the ground bears all of the weight."""
    world, work = stack(3, engine)
    advance(world, work, np.array([0.0, 0.0, -G]), 1e-3, 2000)
    X, V, rows = work[0], work[3], work[10][0]
    assert np.abs(X[1:, SPEED : SPEED + 6]).max() < 1e-3
    assert np.abs(X[1:, PLACE : PLACE + 3] - [[0, 0, 0.05], [0, 0, 0.15], [0, 0, 0.25]]).max() < 1e-4
    normal = V[:rows:3, LAMBDA].reshape(3, 4).sum(axis=1)
    assert normal == pytest.approx([3 * G, 2 * G, G], rel=1e-2)


# ---------------------------------------------------------------------------------------------- the limit


def hanging_chain(h):
    """The arm of seven joints let go from 0.3 rad in each, hanging: its scene."""
    return fixed(load_robot("arm7"), h, gravity=(0.0, 0.0, 9.81))


def deviation(scene, engine, truth, duration=0.3, **how):
    start = initial_state(scene, np.full(7, 0.3))
    return np.abs(maximal.simulate(scene, duration, start, engine=engine, **how)["q"][-1] - truth).max()


@pytest.fixture(scope="module")
def truth():
    """The chain by the algorithms on the tree, to 1e-10."""
    scene = compile_scene(load_robot("arm7"), gravity=(0.0, 0.0, 9.81))
    return simulate(scene, 0.3, initial_state(scene, np.full(7, 0.3)), rtol=1e-10)["q"][-1]


@pytest.mark.long
def test_small_steps_lead_to_what_the_tree_gives(truth):
    """With the first power of the step, ERP and all: the error halves."""
    errors = [deviation(hanging_chain(h), EXACT, truth) for h in (1e-3, 5e-4, 2.5e-4)]
    assert errors[0] < 0.02
    assert 1.7 < errors[0] / errors[1] < 2.4
    assert 1.8 < errors[1] / errors[2] < 2.2


@pytest.mark.long
def test_many_sweeps_lead_to_what_solving_gives():
    """At one step the distance to the solved problem falls below 1e-6 rad, ever smaller with the sweeps."""
    scene, exact = hanging_chain(1e-3), replace(SOFT, erp=0.2)
    solved = maximal.simulate(scene, 0.3, initial_state(scene, np.full(7, 0.3)), engine=exact)["q"][-1]
    errors = [deviation(scene, replace(exact, iterations=n), solved) for n in (10, 50, 200)]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 1e-6


@pytest.mark.long
def test_a_servo_moves_its_joint_as_in_the_tree():
    """MIPSD with the limits and the spring of SimTwo's order in `core`, through slew and current limits: 1e-6 rad."""
    arm = load_robot("ax12_arm")
    engine = replace(EXACT, damper_share=0.2)
    for h in (1e-3, 5e-4):
        scene = compile_scene(arm, "mipsd", integrator="simtwo", timestep=h)
        reference = Reference([0.0, 0.2], [[0.0], [0.5]])
        tree = simulate(scene, 0.5, reference=reference, estimate_error=False)["q"]
        assert np.ptp(tree) > 0.4
        assert np.abs(maximal.simulate(scene, 0.5, None, reference, engine=engine)["q"] - tree).max() < 1e-6


# ---------------------------------------------------------------------------------------------- joints


def double_pendulum(cross):
    """Two crossed hinges with a body of so many kilograms between them, and a rod."""
    links = (
        Link("base", 0.0, (0.0, 0.0, 0.0), (0.0,) * 6),
        Link("cross", cross, (0.0, 0.0, 0.0), (1e-4 * cross, 0.0, 0.0, 1e-4 * cross, 0.0, 1e-4 * cross)),
        Link("rod", 1.0, (0.0, 0.0, -0.25), (0.02, 0.0, 0.0, 0.02, 0.0, 0.001)),
    )
    joints = (
        Joint("first", "revolute", "base", "cross", axis=(1.0, 0.0, 0.0)),
        Joint("second", "revolute", "cross", "rod", axis=(0.0, 1.0, 0.0)),
    )
    return Model("gimbal", links, joints)


@pytest.mark.long
def test_two_hinges_on_a_small_body_are_a_universal_joint():
    """It moves as the tree does with that body, with the first power of the step."""
    model, start = double_pendulum(1e-6), ([0.5, -0.7], [1.0, 2.0])
    scene = compile_scene(model)
    right = simulate(scene, 0.5, initial_state(scene, *start), rtol=1e-10)["q"][-1]
    errors = []
    for h in (1e-3, 5e-4):
        scene = fixed(model, h)
        assert len(assembled(scene, EXACT)[0]) == 2
        run = maximal.simulate(scene, 0.5, initial_state(scene, *start), engine=EXACT)
        errors.append(np.abs(run["q"][-1] - right).max())
    assert errors[0] < 5e-3
    assert 1.8 < errors[0] / errors[1] < 2.2


def test_the_hip_of_the_humanoid_is_a_universal_joint_and_its_shoulder_is_not():
    scene = compile_scene(load_robot("humanoid"), "mipsd", Ground(), "simtwo", 1e-3)
    bodies, joints, *_ = assembled(scene, Engine())
    assert len(bodies) == 1 + 18  # the world, and all but the two crosses of 20 bodies
    assert sorted(joints.kind.tolist()) == [0] * 15 + [1] * 2
    assert bodies.mass.sum() == pytest.approx(scene.model.mass, rel=1e-12)


@pytest.mark.long
def test_a_weld_holds_as_a_locked_joint():
    arm = load_robot("arm7")
    held = arm.joint_names[3]
    locked = replace(arm, locked={held: 0.0})
    scene = fixed(locked, 2.5e-4, gravity=(0.0, 0.0, 9.81))
    whole = maximal.simulate(scene, 0.3, initial_state(scene, np.full(6, 0.3)), engine=EXACT)["q"][-1]
    scene = fixed(arm, 2.5e-4, gravity=(0.0, 0.0, 9.81))
    start = initial_state(scene, [0.3, 0.3, 0.3, 0.0, 0.3, 0.3, 0.3])
    run = maximal.simulate(scene, 0.3, start, engine=EXACT, welded=[held])["q"][-1]
    assert abs(run[3]) < 1e-4
    assert np.delete(run, 3) == pytest.approx(whole, abs=2e-4)


# ---------------------------------------------------------------------------------------------- bits and failure


def standing(steps=40):
    scene = compile_scene(load_robot("humanoid"), "standard", Ground(), "simtwo", 1e-3)
    return scene, steps * 1e-3


def digest(run):
    return hashlib.sha256(b"".join(run[name].tobytes() for name in run) + run.final.tobytes()).hexdigest()[:16]


def test_the_same_seed_has_the_same_bits_and_another_has_others():
    scene, duration = standing(50)
    runs = maximal.simulate_seeds(scene, duration, seeds=[3, 4, 3])
    assert digest(runs[0]) == digest(runs[2]) == digest(maximal.simulate(scene, duration, seed=3))
    assert digest(runs[0]) != digest(runs[1])


def test_solved_no_seed_matters():
    scene, duration = standing(50)
    runs = maximal.simulate_seeds(scene, duration, seeds=[3, 4], engine=Engine(iterations=0))
    assert digest(runs[0]) == digest(runs[1])


@pytest.mark.quick("standard-*")
@pytest.mark.nojit
@pytest.mark.parametrize(
    ("gearbox", "bits"),
    [pytest.param("standard", "d6c03a837fb8f09b", marks=pytest.mark.bounds), ("mipsd", "3ed23956b3d6aa80")],
)
def test_the_bits_are_these_compiled_or_not(gearbox, bits):
    scene = compile_scene(load_robot("humanoid", locked="simplified"), gearbox, Ground(), "simtwo", 1e-3)
    reference = Reference([0.0], np.full((1, 10), 0.1))
    assert digest(maximal.simulate(scene, 0.02, None, reference, engine=Engine(iterations=2), seed=5)) == bits


@pytest.mark.long
@pytest.mark.nojit
def test_the_solved_bits_are_these_compiled_or_not():
    scene = box_on(Ground(), timestep=1e-3)
    start = initial_state(scene, [0, 0, 0.0495, 1, 0, 0, 0], [0.5, 0, 0, 0, 0.1, 0])
    assert digest(maximal.simulate(scene, 0.01, start, engine=EXACT, record=("base_q",))) == "a19a3c5376d8a416"


@pytest.mark.long
def test_a_robot_that_falls_or_diverges_says_so():
    scene = compile_scene(load_robot("humanoid"), "standard", Ground(), "simtwo", 1e-3)
    start = initial_state(scene)
    start[3:7] = math.cos(0.3), 0.0, math.sin(0.3), 0.0
    fell = maximal.simulate(scene, 2.0, start)
    assert fell.status == "fell"
    assert "fell at" in fell.message
    arm = compile_scene(load_robot("arm7"), integrator="implicit_euler", timestep=5e-3)
    wild = initial_state(arm, np.zeros(7), np.full(7, 1e6))
    lost = maximal.simulate(arm, 1.0, wild, engine=replace(EXACT, iterations=2))
    assert lost.status == "diverged"
    assert np.isfinite(lost["q"]).all()


@pytest.mark.parametrize(
    ("scene", "message"),
    [
        (lambda: compile_scene(load_robot("arm7"), "rotor", integrator="simtwo", timestep=1e-3), "inertia of a rotor"),
        (lambda: compile_scene(load_robot("arm7"), "mipsd"), "an integrator of free steps"),
        (lambda: box_on(Ground(steps=((1.0, 0.01),))), "ground that is no plane"),
        (lambda: fixed(double_pendulum_without_inertia(), 1e-3), "'cross' of .* kg has not an inertia"),
    ],
)
def test_what_it_has_not_is_refused(scene, message):
    with pytest.raises(ValueError, match=message):
        maximal.simulate(scene(), 0.1)


def double_pendulum_without_inertia():
    """A thin body between two hinges that do not cross at right angles."""
    model = double_pendulum(1e-6)
    cross = replace(model.links[1], inertia=(0.0,) * 6)
    return replace(
        model,
        links=(model.links[0], cross, model.links[2]),
        joints=(model.joints[0], replace(model.joints[1], axis=(0.6, 0.8, 0.0))),
    )


@pytest.mark.parametrize(
    ("settings", "message"),
    [({"iterations": -1}, "iterations"), ({"relaxation": 2.5}, "relaxation"), ({"erp": 1.5}, "erp")],
)
def test_settings_out_of_range_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        Engine(**settings)


def test_arguments_that_do_not_fit_are_refused():
    scene = fixed(load_robot("arm7"), 1e-3)
    with pytest.raises(ValueError, match="no moving joint 'elbow'"):
        maximal.simulate(scene, 0.1, welded=["elbow"])
    with pytest.raises(ValueError, match="seed"):
        maximal.simulate(scene, 0.1, seed=-1)
