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
from featherstone_gait.reproduction.maximal.world import assembled
from featherstone_gait.run.reference import Reference

SOFT = replace(EXACT, cfm=1e-5)


def fixed(model, timestep=1e-3, **how):
    return compile_scene(model, integrator="implicit_euler", timestep=timestep, **how)


def exact(scene, duration, *start, **how):
    """Run with `EXACT` from q and qd."""
    return maximal.simulate(scene, duration, initial_state(scene, *start), **({"engine": EXACT} | how))


def standing(gearbox="standard"):
    return compile_scene(load_robot("humanoid"), gearbox, Ground(), "simtwo", 1e-3)


def halves_with_the_step(error, most, steps=(1e-3, 5e-4)):
    """Whether the error at the first step is below `most` and falls with the first power of the step."""
    errors = np.array([error(h) for h in steps])
    ratios = errors[:-1] / errors[1:]
    return (errors[0] < most).all() and (ratios > 1.7).all() and (ratios < 2.4).all()


@pytest.mark.long
def test_a_free_fall_is_that_of_semi_implicit_euler():
    """After n steps the velocity is g n h and the way g h^2 n (n + 1) / 2."""
    run = exact(fixed(replace(box(), contacts=())), 0.5, record=("base_q", "base_qd"))
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

    def drift(h):
        scene = fixed(model, h, gravity=(0.0, 0.0, 0.0))
        run = exact(scene, 1.0, [0, 0, 0, 1, 0, 0, 0], [0, 0, 0, *spin], record=("base_q", "base_qd"))
        now = energy(model, run["base_q"], run["base_qd"]).sum(axis=1)
        momentum = (rotations(run["base_q"][:, 3:7]) @ (inertia * run["base_qd"][:, 3:6])[..., None])[..., 0]
        turned = np.linalg.norm(momentum - momentum[0], axis=1).max() / np.linalg.norm(momentum[0])
        return abs(now / now[0] - 1.0).max(), turned

    assert halves_with_the_step(drift, 0.02)


@pytest.mark.long
@pytest.mark.parametrize("swing", [0.1, 1.0, 2.0])
def test_a_pendulum_has_its_period_and_its_energy_drifts_with_the_first_power_of_the_step(swing):
    """4 K(sin(swing / 2)) / omega, omega^2 = m g l / J about the hinge; drift as a share of the swing's energy.

    It is what mending the constraint takes and gives.
    """
    period = 4.0 * ellipk(math.sin(swing / 2) ** 2) / math.sqrt(1.5 * G / 0.5)

    def drift(h):
        run = exact(fixed(pendulum(0.5, damping=0.0), h), 5.0, [swing], record_interval=1e-3)
        q, t, now = run["q"][:, 0], run["time"], energy(pendulum(0.5), run["q"], run["qd"]).sum(axis=1)
        k = np.flatnonzero((q[:-1] > 0) & (q[1:] <= 0))
        assert np.diff(t[k] + 1e-3 * q[k] / (q[k] - q[k + 1])).mean() == pytest.approx(period, rel=1e-4)
        return abs(now - now[0]).max() / (0.25 * G * (1.0 - math.cos(swing)))

    assert halves_with_the_step(drift, 0.004)


@pytest.mark.long
def test_a_stop_and_dry_friction_hold_a_pendulum_and_a_free_one_turns_on():
    run = exact(fixed(pendulum(upper=0.5)), 1.0, [0.2], [3.0], record_interval=1e-3)
    assert 0.5 - 1e-6 < run["q"].max() < 0.5 + 0.01
    weight = 0.25 * G * math.sin(0.5)
    for friction, moves in ((0.95 * weight, True), (1.05 * weight, False)):
        run = exact(fixed(pendulum(damping=0.0, friction=friction)), 1.0, [0.5])
        assert (abs(run["q"][-1, 0] - 0.5) > 1e-2) == moves
        assert moves or abs(run["q"][-1, 0] - 0.5) < 1e-6
    run = exact(fixed(pendulum(damping=0.0), gravity=(0.0, 0.0, 0.0)), 2.0, [0.0], [10.0])
    assert run["q"][-1, 0] == pytest.approx(20.0, rel=1e-3)  # beyond a turn


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
    settled = 30
    mean = (speed[-1] - speed[settled]) / (run["time"][-1] - run["time"][settled])
    assert mean == pytest.approx(pull, abs=2e-3 * G)
    force = run["contact_force"][-1].sum(axis=0)
    assert force[0] == pytest.approx(G * c, rel=2e-3)
    assert abs(force[1]) <= friction * force[0] * (1 + 1e-6)


@pytest.mark.long
def test_a_ball_bounces_as_high_as_it_is_told():
    """From 0.2 m with 0.6: 0.36 of the height, to what a step of 0.1 ms misses; soft contacts take some of it."""
    how = {"engine": replace(EXACT, bounce=0.6), "record": ("base_q",), "record_interval": 1e-3}
    run = exact(box_on(Ground(), timestep=1e-4), 0.4, [0, 0, 0.05 + 0.2, 1, 0, 0, 0], **how)
    z = run["base_q"][:, 2]
    low = int(np.argmin(z[: int(0.3e3)]))
    assert z[low:].max() - 0.05 == pytest.approx(0.36 * 0.2, rel=0.02)


@pytest.mark.parametrize("iterations", [0, 60], ids=["solved", "swept"])
def test_the_ground_bears_the_weight_of_a_robot_that_stands(iterations):
    """Over 0.2 s the mean of all forces is the weight, upright; each is within its pyramid, once solved."""
    scene, engine = standing(), Engine(iterations=iterations, bounce=0.0)
    run = maximal.simulate(scene, 0.4, engine=engine, record=("contact_force",), record_interval=1e-3)
    force, weight = run["contact_force"], scene.model.mass * G
    assert force[-200:].sum(axis=1).mean(axis=0) / weight == pytest.approx([1.0, 0.0, 0.0], abs=0.02)
    assert force[-200:, :, 0].sum(axis=1).mean() / weight == pytest.approx(1.0, abs=5e-3)
    assert iterations or (abs(force[..., 1:]) <= Ground().friction * force[..., :1] + 1e-9 * weight).all()


CHAIN = {"gravity": (0.0, 0.0, 9.81)}  # the arm of seven joints, hanging, let go from 0.3 rad in each


def chain(engine, h=1e-3):
    return exact(fixed(load_robot("arm7"), h, **CHAIN), 0.3, np.full(7, 0.3), engine=engine)["q"][-1]


@pytest.mark.long
def test_small_steps_lead_to_what_the_tree_gives():
    """With the first power of the step, ERP and all: the error halves."""
    scene = compile_scene(load_robot("arm7"), **CHAIN)
    truth = simulate(scene, 0.3, initial_state(scene, np.full(7, 0.3)), rtol=1e-10)["q"][-1]
    assert halves_with_the_step(lambda h: np.abs(chain(EXACT, h) - truth).max(), 0.02, (1e-3, 5e-4, 2.5e-4))


@pytest.mark.long
def test_many_sweeps_lead_to_what_solving_gives():
    """At one step the distance to the solved problem falls below 1e-6 rad, ever smaller with the sweeps."""
    engine = replace(SOFT, erp=0.2)
    errors = [np.abs(chain(replace(engine, iterations=n)) - chain(engine)).max() for n in (10, 50, 200)]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 1e-6


@pytest.mark.long
def test_a_servo_moves_its_joint_as_in_the_tree():
    """MIPSD with the limits and the spring of SimTwo's order in `core`, through slew and current limits: 1e-6 rad."""
    reference, how = Reference([0.0, 0.2], [[0.0], [0.5]]), {"engine": replace(EXACT, damper_share=0.2)}
    for h in (1e-3, 5e-4):
        scene = compile_scene(load_robot("ax12_arm"), "mipsd", integrator="simtwo", timestep=h)
        tree = simulate(scene, 0.5, reference=reference, estimate_error=False)["q"]
        assert np.ptp(tree) > 0.4
        assert np.abs(maximal.simulate(scene, 0.5, None, reference, **how)["q"] - tree).max() < 1e-6


def double_pendulum(inertia=1e-10, axis=(0.0, 1.0, 0.0)):
    """Two hinges with a body of 1 mg and an inertia between them, and a rod; axis: of the second, the first is x."""
    links = (
        Link("base", 0.0, (0.0, 0.0, 0.0), (0.0,) * 6),
        Link("cross", 1e-6, (0.0, 0.0, 0.0), (inertia, 0.0, 0.0, inertia, 0.0, inertia)),
        Link("rod", 1.0, (0.0, 0.0, -0.25), (0.02, 0.0, 0.0, 0.02, 0.0, 0.001)),
    )
    joints = (
        Joint("first", "revolute", "base", "cross", axis=(1.0, 0.0, 0.0)),
        Joint("second", "revolute", "cross", "rod", axis=axis),
    )
    return Model("gimbal", links, joints)


@pytest.mark.long
def test_two_hinges_on_a_small_body_are_a_universal_joint():
    """It moves as the tree does with that body, with the first power of the step."""
    scene, start = compile_scene(double_pendulum()), ([0.5, -0.7], [1.0, 2.0])
    assert len(assembled(fixed(scene.model), EXACT).bodies) == 2
    right = simulate(scene, 0.5, initial_state(scene, *start), rtol=1e-10)["q"][-1]
    assert halves_with_the_step(
        lambda h: np.abs(exact(fixed(scene.model, h), 0.5, *start)["q"][-1] - right).max(), 5e-3
    )


def test_the_hip_of_the_humanoid_is_a_universal_joint_and_its_shoulder_is_not():
    scene = standing("mipsd")
    world = assembled(scene, Engine())
    assert len(world.bodies) == 1 + 18  # the world, and all but the two crosses of 20 bodies
    assert sorted(world.joints.universal.tolist()) == [0] * 15 + [1] * 2
    assert world.bodies.mass.sum() == pytest.approx(scene.model.mass, rel=1e-12)


def digest(run):
    return hashlib.sha256(b"".join(run[name].tobytes() for name in run) + run.final.tobytes()).hexdigest()[:16]


def test_the_same_seed_has_the_same_bits_and_another_has_others_unless_solved():
    """And so has the beginning of a run that is long enough to be handed to the thread that Ctrl-C ends."""
    a, b, again = maximal.simulate_seeds(standing(), 0.05, seeds=[3, 4, 3])
    assert digest(a) == digest(again) == digest(maximal.simulate(standing(), 0.05, seed=3)) != digest(b)
    assert np.array_equal(maximal.simulate(standing(), 15.0, seed=3)["q"][: len(a["q"])], a["q"])
    a, b = maximal.simulate_seeds(standing(), 0.05, seeds=[3, 4], engine=Engine(iterations=0))
    assert digest(a) == digest(b)


@pytest.mark.quick("standard-*")
@pytest.mark.nojit
@pytest.mark.parametrize(
    ("case", "bits"),
    [
        pytest.param("standard", "d6c03a837fb8f09b", marks=pytest.mark.bounds),
        ("mipsd", "3ed23956b3d6aa80"),
        ("box, solved", "a19a3c5376d8a416"),
    ],
)
def test_the_bits_are_these_compiled_or_not(case, bits):
    if case == "box, solved":
        start = [0, 0, 0.0495, 1, 0, 0, 0], [0.5, 0, 0, 0, 0.1, 0]
        run = exact(box_on(Ground(), timestep=1e-3), 0.01, *start, record=("base_q",))
    else:
        scene = compile_scene(load_robot("humanoid", locked="simplified"), case, Ground(), "simtwo", 1e-3)
        reference = Reference([0.0], np.full((1, 10), 0.1))
        run = maximal.simulate(scene, 0.02, None, reference, engine=Engine(iterations=2), seed=5)
    assert digest(run) == bits


@pytest.mark.long
def test_a_robot_that_falls_or_diverges_says_so():
    start = initial_state(standing())
    start[3:7] = math.cos(0.3), 0.0, math.sin(0.3), 0.0
    fell = maximal.simulate(standing(), 2.0, start)
    assert fell.status == "fell"
    assert "fell at" in fell.message
    arm = fixed(load_robot("arm7"), 5e-3)
    lost = exact(arm, 1.0, np.zeros(7), np.full(7, 1e6), engine=replace(EXACT, iterations=2))
    assert lost.status == "diverged"
    assert np.isfinite(lost["q"]).all()


@pytest.mark.parametrize(
    ("scene", "message"),
    [
        (lambda: compile_scene(load_robot("arm7"), "rotor", integrator="simtwo", timestep=1e-3), "inertia of a rotor"),
        (lambda: compile_scene(load_robot("arm7"), "mipsd"), "an integrator of free steps"),
        (lambda: box_on(Ground(steps=((1.0, 0.01),))), "ground that is no plane"),
        (lambda: fixed(double_pendulum(0.0, (0.6, 0.8, 0.0))), "'cross' of .* kg has not an inertia"),
    ],
)
def test_what_it_has_not_is_refused(scene, message):
    with pytest.raises(ValueError, match=message):
        maximal.simulate(scene(), 0.1)


@pytest.mark.parametrize("wrong", [{"iterations": -1}, {"cfm": -1.0}, {"erp": 1.5}, {"seed": -1}])
def test_numbers_out_of_range_are_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        exact(fixed(load_robot("arm7")), 0.1, **(wrong if "seed" in wrong else {"engine": Engine(**wrong)}))
