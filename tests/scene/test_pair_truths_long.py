"""Closed forms of contact between bodies: thin plates, rigid limits, momentum and energy, what a ramp does."""

import math

import numpy as np
import pytest
from test_pair_contact import FAR, RADIUS, SIZE, along, two_balls
from touching import FIXED_STEPS, G, ball, energy_of, law_of, obstacle, placed, run_of, touching

from featherstone_gait.model import Ground, Joint, Link, Model
from featherstone_gait.model.placed import Placed, SceneModel
from featherstone_gait.model.shapes import Box, Capsule, Cylinder, Shape
from featherstone_gait.run.simulate import initial_state, simulate
from featherstone_gait.scene.compile import compile_scene

pytestmark = pytest.mark.long

DOWN = (0.0, 0.0, -G)
ALL = ("implicit_euler", "midpoint", "rk4", "ars343", "dop853", "extrapolation")


# ---------------------------------------------------------------------------------------------- fast and thin


@pytest.mark.parametrize("fixed", [True, False])
@pytest.mark.parametrize("integrator", ALL)
def test_a_ball_of_100_m_per_second_does_not_pass_a_plate_of_a_millimeter_unnoticed(integrator, fixed):
    """It bounces, or the run says that it is wrong, also without its error: by the law it sinks in by 22 mm, too deep.

    rk4 and midpoint do not look to the end of a step, and move by more than what is there.
    """
    sheet, thick = Box((1.0, 1.0, 1e-3)), 5e-4
    bullet = ball(RADIUS, 1.0, "ball", (0.0, 0.0, 0.5 + 0.037))
    members = [bullet] if fixed else [bullet, placed(sheet, 100.0, "sheet")]
    scene = touching(members, [obstacle(sheet, "sheet")] if fixed else [], integrator, load=1.0)
    start = initial_state(scene, None, {"ball": [0.0, 0.0, -100.0, 0.0, 0.0, 0.0]})
    run = simulate(scene, 0.02, start, record=("base_q", "base_qd"), estimate_error=False)
    z = run.of("ball")["base_q"][:, 2]
    assert run.status in ("too deep", "not converged" if integrator in ("rk4", "midpoint") else "ok")
    if run.status == "ok":
        assert z.min() > thick
        assert run.of("ball")["base_qd"][-1, 2] > -10.0


# ---------------------------------------------------------------------------------------------- collisions


def rigid(heading, friction, masses=(1.0, 2.0), speed=1.0):
    """Velocity of the first ball after a lossless collision of rigid balls that slip throughout."""
    aside = (2 * RADIUS + FAR) / (2 * RADIUS) * math.sin(heading)  # it comes along x, a gap away
    n = np.array([math.sqrt(1.0 - aside * aside), aside])
    t = np.array([-n[1], n[0]])
    reduced = masses[0] * masses[1] / sum(masses)
    impulse = 2.0 * reduced * speed * n[0]
    slip = speed * t[0]
    push = -impulse * n - math.copysign(friction * impulse, slip) * t
    return np.array([speed, 0.0]) + push / masses[0], -push / masses[1]


def test_a_collision_becomes_that_of_rigid_balls():
    """Its duration, and with it the error, falls with the root of the penetration."""
    errors = []
    for penetration in (1e-3, 1e-5, 1e-7):
        scene = two_balls(0.5, damping_ratio=0.0, friction=0.05, penetration=penetration)
        run = run_of(scene, 0.1, {"first": (1.0, 0.0, 0.0)}, rtol=1e-9)
        found = run["base_qd"][-1][:, [0, 2]]
        errors.append(np.abs(found - np.array(rigid(0.5, 0.05))).max())
    assert errors[0] < 0.1
    assert errors[1] < 0.15 * errors[0]
    assert errors[2] < 0.15 * errors[1]


@pytest.mark.parametrize("integrator", ALL)
def test_newtons_cradle_keeps_momentum_and_energy(integrator):
    """Five balls with gaps and without damping, two of which come.

    Energy is kept up to the error that the run states; steps of first order lose some.
    """
    x = np.cumsum([0.0, 2 * RADIUS + 0.002, 2 * RADIUS + 0.003, 2 * RADIUS + 0.001, 2 * RADIUS + 0.002])
    balls = [ball(RADIUS, 0.5, f"b{k}", (float(x[k]), 0.0, 0.0)) for k in range(5)]
    scene = touching(balls, integrator=integrator, timestep=1e-5 if integrator in FIXED_STEPS else None,
                     damping_ratio=0.0, load=0.5)  # fmt: skip
    start = initial_state(scene, None, {f"b{k}": [0.5, 0.0, 0.0, 0.0, 0.0, 0.0] for k in (0, 1)})
    run = simulate(scene, 0.1, start, record=("base_q", "base_qd"))
    v = run["base_qd"][:, :, 0]
    assert run.status == "ok", run.message
    np.testing.assert_allclose(v.sum(axis=1), 1.0, rtol=1e-12)
    lost = 1.0 - np.sum(v[-1] ** 2) / 0.5
    assert abs(lost) < 20.0 * run.error["base_qd"].max() + 1e-12
    if integrator != "implicit_euler":
        assert abs(lost) < 1e-3


# ---------------------------------------------------------------------------------------------- grounds and ramps


@pytest.mark.parametrize("velocity", [(0.0, 0.0, 0.0), (1.0, 0.5, -1.0)])
@pytest.mark.parametrize("penetration", [5e-4, 5e-6])
def test_a_ball_on_an_obstacle_moves_as_on_the_ground(velocity, penetration):
    """Straight down to rounding; where it rolls the lever differs, by half of the depth."""
    one = ball(RADIUS, 1.0, "ball", (0.0, 0.0, RADIUS + 0.01), friction=0.6)
    ground = Ground(friction=0.6, penetration=penetration)
    how = {"gravity": DOWN, "integrator": "extrapolation"}
    grounded = compile_scene(SceneModel("x", [one], ground=ground), **how)
    floor = [obstacle(SIZE, "floor", (0.0, 0.0, -0.5), friction=0.6)]
    on_obstacle = touching([one], floor, gravity=DOWN, penetration=penetration)
    ends = []
    for scene in (grounded, on_obstacle):
        start = initial_state(scene, None, {"ball": [*velocity, 0.0, 0.0, 0.0]})
        run = simulate(scene, 0.3, start, record=("base_q", "base_qd"), rtol=1e-10, estimate_error=False)
        assert run.status == "ok"
        ends.append(np.concatenate([run.of("ball")["base_q"][-1, :3], run.of("ball")["base_qd"][-1]]))
    assert ends[0][2] == pytest.approx(ends[1][2], abs=1e-9)
    if any(velocity[:2]):
        assert np.abs(ends[0] - ends[1])[:6].max() < 30.0 * penetration
    else:
        np.testing.assert_allclose(ends[0], ends[1], atol=1e-9)


def ramp(angle, friction, mass=4.0, penetration=1e-6):
    """A plank that a rail leads up a ramp, with a block of a kilogram on it; axes are those of the ramp."""
    links = (Link("rail", 1.0), Link("plank", mass, inertia=(0.1, 0.0, 0.0, 0.1, 0.0, 0.1)))
    joint = Joint("slide", "prismatic", "rail", "plank", axis=(-1.0, 0.0, 0.0))
    plank = Shape("plank", Box((1.0, 0.5, 0.02)), xyz=(0.0, 0.0, -0.01), friction=friction)
    block = placed(Box((0.1, 0.1, 0.1)), 1.0, "block", (0.0, 0.0, 0.05 - penetration * math.cos(angle)),
                   friction=friction)  # fmt: skip
    model = Model("plank", links, (joint,), shapes=(plank,))
    return touching([Placed(model), block], gravity=along(angle), penetration=penetration, load=1.0)


@pytest.mark.parametrize("share", [0.6, 0.99, 1.01])
def test_a_block_goes_along_with_a_plank_that_is_pulled_up_a_ramp_up_to_its_friction(share):
    """A force F on plank M and block m: m F / (M + m) is what friction has to carry, of mu m g cos."""
    angle, mass, pull = 0.3, 4.0, 40.0
    weight, fall = G * math.cos(angle), G * math.sin(angle)
    mu = share * pull / (mass + 1.0) / weight
    scene = ramp(angle, mu, mass)
    run = simulate(scene, 0.1, tau=[pull], record=("base_q", "base_qd", "qd"), rtol=1e-8, estimate_error=False)
    assert run.status == "ok"
    late = run["time"] > 0.04
    plank, block = (np.polyfit(run["time"][late], v[late], 1)[0] for v in (run["qd"][:, 0], run["base_qd"][:, -1, 0]))
    exact = (pull / (mass + 1.0) - fall,) * 2
    if share < 1.0:
        exact = (pull - mu * weight) / mass - fall, mu * weight - fall
    np.testing.assert_allclose((plank, -block), exact, rtol=1e-5)


# ---------------------------------------------------------------------------------------------- a disc spins down


def test_a_disc_that_spins_down_only_loses_energy():
    """Kinetic, potential and that of all springs; it comes to lie flat, as deep as the law says."""
    tilt, radius, thickness = 0.5, 0.05, 0.01
    turn = (math.cos(tilt / 2), math.sin(tilt / 2), 0.0, 0.0)
    height = radius * math.sin(tilt) + 0.5 * thickness * math.cos(tilt)
    one = placed(Cylinder(radius, thickness), 0.2, "disc", (0.0, 0.0, height), turn, friction=0.3)
    floor = [obstacle(SIZE, "floor", (0.0, 0.0, -0.5), friction=0.3)]
    scene = touching([one], floor, gravity=DOWN)
    velocities = {"disc": [0.0, 0.0, 0.0, 0.0, 4.0, 6.0]}
    start = initial_state(scene, None, velocities)
    record = ("base_q", "base_qd", "pair_gap", "pair_deflection")
    run = simulate(scene, 3.0, start, record=record, rtol=1e-8, estimate_error=False, record_interval=1e-3)
    assert run.status == "ok", run.message
    k, _, _, kt, _ = law_of(scene)
    x = np.maximum(-run["pair_gap"], 0.0)  # also where a point leaves too fast to be pushed
    z = np.sum(run["pair_deflection"] ** 2, axis=2)
    total = energy_of(scene, run) + 0.5 * k * np.sum(x * x, axis=1) + 0.5 * kt * np.sum(z, axis=1)
    rises = np.diff(total).max()
    assert rises < 1e-6 * total[0]
    assert run["base_q"][-1, 2] == pytest.approx(0.5 * thickness - 5e-4, abs=1e-6)


@pytest.mark.parametrize("offset", [-0.0086, 0.004])
def test_friction_goes_on_where_a_rod_leaves_a_face_for_its_edge(offset):
    """The default agrees with midpoint at fine steps; where friction began anew there, to 1.8 mm alone."""
    half = math.sqrt(0.5)
    rod = placed(Capsule(0.03, 0.3), 1.6, "rod", (0.0, 0.0, 0.25), (half, half, 0.0, 0.0))
    members = [rod, placed(Box((0.1, 0.1, 0.1)), 1.0, "box", (offset, 0.03, 0.0498))]
    floor, ends = [obstacle(Box((9.0, 9.0, 1.0)), "floor", (0.0, 0.0, -0.5))], []
    for integrator, h in (("ars343", 5e-4), ("midpoint", 1e-4)):
        scene = touching(members, floor, integrator, h, DOWN)
        run = simulate(scene, 0.4, record=("base_q",), record_interval=0.01, estimate_error=False)
        assert run.ok
        ends.append(np.hstack([run.of(name)["base_q"] for name in ("rod", "box")]))
    assert np.abs(ends[0] - ends[1]).max() < 5e-5
