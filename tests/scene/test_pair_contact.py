"""Contact between bodies against closed forms, conserved quantities and the same law integrated by SciPy."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from touching import Disc, G, ball, energy_of, law_of, normal, obstacle, placed, planar, run_of, touching

from featherstone_gait.model import Joint, Link, Model
from featherstone_gait.model.placed import Placed
from featherstone_gait.model.shapes import Box, Capsule, Cylinder, Shape, Sphere

RADIUS = 0.05
DOWN = (0.0, 0.0, -G)
FAR = 0.01  # gap of bodies that do not touch yet [m]


def rebound(speed, d):
    """Speed at which a body leaves that came at `speed` [m/s], by Hunt and Crossley's law of exponent 1.

    v dv / (1 + d v) = -k x dx / m, and x is 0 at both ends.
    """

    def side(v):
        return d * v - math.log1p(d * v)

    return speed if d == 0.0 else -brentq(lambda v: side(v) - side(speed), -(1.0 - 1e-16) / d, 0.0, xtol=1e-15)


def along(gravity_angle):
    """Gravity as on a slope that falls towards x by an angle [rad], whose surface is level."""
    return (G * math.sin(gravity_angle), 0.0, -G * math.cos(gravity_angle))


# ---------------------------------------------------------------------------------------------- balls that collide


def two_balls(heading=0.0, integrator="extrapolation", timestep=None, masses=(1.0, 2.0), **law):
    """The first at rest, the second a gap away, at an angle to the x axis."""
    way = (2 * RADIUS + FAR) * np.array([math.cos(heading), 0.0, math.sin(heading)])
    members = [ball(RADIUS, masses[0], "first"), ball(RADIUS, masses[1], "second", tuple(way))]
    return touching(members, integrator=integrator, timestep=timestep, **law)


@pytest.mark.parametrize("damping_ratio", [0.0, 0.1, 0.7])
def test_two_balls_part_at_the_speed_of_the_law(damping_ratio):
    scene = two_balls(damping_ratio=damping_ratio)
    run = run_of(scene, 0.1, {"first": (1.0, 0.0, 0.0)})
    v = run["base_qd"][-1, :, 0]
    assert v[1] - v[0] == pytest.approx(rebound(1.0, law_of(scene)[1]), rel=1e-6)
    assert v @ (1.0, 2.0) == pytest.approx(1.0, abs=1e-12)
    total = energy_of(scene, run)
    assert total[-1] - total[0] == pytest.approx(run["pair_work"][-1, 0], abs=1e-7)


@pytest.mark.parametrize("friction", [0.1, 3.0])
def test_an_oblique_collision_is_that_of_the_law(friction):
    """Sliding throughout, and with friction that stops the slip; what turns counts in the angular momentum."""
    scene = two_balls(0.5, damping_ratio=0.2, friction=friction)
    run = run_of(scene, 0.1, {"first": (1.0, 0.0, 0.0, 0.0, 3.0, 0.0)})
    a, b = (Disc(RADIUS, m, 0.4 * m * RADIUS**2) for m in (2.0, 1.0))
    a.x, b.v, b.spin = tuple(run["base_q"][0, 1, [0, 2]]), (1.0, 0.0), 3.0
    end = planar(a, b, law_of(scene), 0.1)
    np.testing.assert_allclose(run["base_qd"][-1, 1, [0, 2, 4]], end[2:5], rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(run["base_qd"][-1, 0, [0, 2, 4]], end[7:10], rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(np.array([1.0, 2.0]) @ run["base_qd"][-1, :, :3], [1.0, 0.0, 0.0], atol=1e-12)
    moments = angular_momentum(scene, run)
    np.testing.assert_allclose(moments[-1], moments[0], atol=1e-9)
    total = energy_of(scene, run)
    assert total[-1] - total[0] == pytest.approx(run["pair_work"][-1, 0], abs=1e-7)


def angular_momentum(scene, run):
    """About the origin, of balls [kg m^2/s]."""
    total = 0.0
    for member in scene.members:
        (link,), q, qd = member.model.links, run.of(member.name)["base_q"], run.of(member.name)["base_qd"]
        total = total + link.mass * np.cross(q[:, :3], qd[:, :3]) + link.inertia[0] * qd[:, 3:]
    return total


def test_newtons_cradle_of_five_is_the_law_of_five_masses():
    """Equal balls in a row with gaps, without damping: one comes, nearly all of its speed leaves with the last."""
    gaps, speed, duration = (0.004, 0.001, 0.0005, 0.002), 0.5, 0.1
    x = np.concatenate([[0.0], np.cumsum(2 * RADIUS + np.array(gaps))])
    scene = touching([ball(RADIUS, 0.5, f"b{k}", (float(x[k]), 0.0, 0.0)) for k in range(5)], damping_ratio=0.0)
    run = run_of(scene, duration, {"b0": (speed, 0.0, 0.0)})
    k, d, *_ = law_of(scene)

    def rates(_, y):
        depth, rate = 2 * RADIUS - np.diff(y[:5]), -np.diff(y[5:])
        f = np.array([0.0, *(normal(*pair, k, d) for pair in zip(depth, rate)), 0.0])
        return np.concatenate([y[5:], (f[:-1] - f[1:]) / 0.5])

    start = np.concatenate([x, [speed, 0.0, 0.0, 0.0, 0.0]])
    end = solve_ivp(rates, (0.0, duration), start, "DOP853", rtol=1e-12, atol=1e-14, max_step=1e-4).y[:, -1]
    np.testing.assert_allclose(run["base_q"][-1, :, 0], end[:5], atol=1e-8)
    np.testing.assert_allclose(run["base_qd"][-1, :, 0], end[5:], atol=1e-5 * speed)
    assert run["base_qd"][-1, 4, 0] == pytest.approx(speed, rel=0.02)
    assert run["base_qd"][-1, :, 0].sum() == pytest.approx(speed, abs=1e-12)


# ---------------------------------------------------------------------------------------------- balls on round things


def ball_on_ball(angle, friction, penetration=5e-4, integrator="extrapolation", timestep=None):
    """A ball at an angle from the top of a fixed one, as deep as its weight along the normal asks for."""
    across = 0.1 + RADIUS - penetration * math.cos(angle)
    at = (across * math.sin(angle), 0.0, across * math.cos(angle))
    scene = touching([ball(RADIUS, 1.0, "ball", at)], [obstacle(Sphere(0.1), "fixed")], integrator, timestep, DOWN,
                     friction=friction, penetration=penetration)  # fmt: skip
    return scene, Disc(RADIUS, 1.0, 0.4 * RADIUS**2, x=(at[0], at[2]))


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_a_ball_rolls_off_a_fixed_one_by_the_law(friction):
    scene, rolling = ball_on_ball(0.3, friction)
    run = run_of(scene, 0.3)
    end = planar(rolling, Disc(0.1, math.inf, math.inf), law_of(scene), 0.3, (0.0, -G))
    np.testing.assert_allclose(run["base_qd"][-1, [0, 2, 4]], end[2:5], rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize(("friction", "cosine"), [(0.0, 2 / 3), (1e3, 10 / 17)])
def test_a_ball_leaves_a_fixed_one_at_the_angle_of_rigid_bodies(friction, cosine):
    """Its speed along x stays from there on: sqrt(g L c) c, with c the cosine of the angle; it starts at 0.3.

    The error falls with the penetration.
    """
    errors = []
    for penetration in (1e-3, 1e-4, 1e-5):
        scene, _ = ball_on_ball(0.3, friction, penetration)
        run = run_of(scene, 0.4, rtol=1e-8)
        c = cosine * math.cos(0.3)
        errors.append(abs(run["base_qd"][-1, 0] / (math.sqrt(G * (0.1 + RADIUS) * c) * c) - 1.0))
    assert errors[0] < 2e-2
    assert errors[1] < 0.3 * errors[0]
    assert errors[2] < 0.3 * errors[1]


def on_a_drum(angle, turning, inertia, penetration=5e-4, **how):
    """A ball that rolls at rest, at an angle from the top of a cylinder that turns about its level axis [rad/s]."""
    links = Link("stand", 1.0), Link("drum", 1.0, inertia=(1.0, 0.0, 0.0, inertia, 0.0, 1.0))
    shape = Shape("drum", Cylinder(0.1, 0.4), rpy=(math.pi / 2, 0.0, 0.0))
    axle = Joint("axle", "continuous", "stand", "drum", axis=(0.0, 1.0, 0.0))
    drum = Placed(Model("drum", links, (axle,), shapes=(shape,)))
    across = 0.1 + RADIUS - penetration * math.cos(angle)
    at = (across * math.sin(angle), 0.0, across * math.cos(angle))
    scene = touching([drum, ball(RADIUS, 1.0, "ball", at)], gravity=DOWN, penetration=penetration, load=1.0, **how)
    spin = -turning * 0.1 / RADIUS
    a = Disc(RADIUS, 1.0, 0.4 * RADIUS**2, x=(at[0], at[2]), spin=spin)
    return scene, a, {"drum": (turning,), "ball": (0.0, 0.0, 0.0, 0.0, spin, 0.0)}


@pytest.mark.parametrize("inertia", [0.02, 1e6])
def test_a_ball_rolls_on_a_cylinder_that_turns_by_the_law(inertia):
    """A drum that it brakes, and one that it does not."""
    scene, a, velocities = on_a_drum(0.2, 5.0, inertia)
    run = run_of(scene, 0.2, velocities, record=("base_q", "base_qd", "q", "qd"))
    end = planar(a, Disc(0.1, math.inf, inertia, spin=5.0), law_of(scene), 0.2, (0.0, -G))
    np.testing.assert_allclose(run.of("ball")["base_qd"][-1, [0, 2, 4]], end[2:5], rtol=1e-5, atol=1e-5)
    assert run["qd"][-1, 0] == pytest.approx(end[9], rel=1e-6)


def test_a_ball_rolls_on_a_cylinder_of_steady_speed_as_on_one_at_rest():
    """Rigid and without slip 7/5 L angle'' = g sin(angle), whatever the speed; the error falls with the penetration."""

    def rates(_, y):
        return [y[1], 5 / 7 * G / (0.1 + RADIUS) * math.sin(y[0])]

    exact = solve_ivp(rates, (0.0, 0.2), [0.2, 0.0], "DOP853", rtol=1e-12, atol=1e-14).y[0, -1]
    errors = []
    for penetration in (5e-4, 5e-5, 5e-6):
        scene, _, velocities = on_a_drum(0.2, 5.0, 1e9, penetration)
        x, _, z = run_of(scene, 0.2, velocities).of("ball")["base_q"][-1, :3]
        errors.append(abs(math.atan2(x, z) - exact))
    assert errors[0] < 1e-2
    assert errors[1] < 0.3 * errors[0]
    assert errors[2] < 0.3 * errors[1]


# ---------------------------------------------------------------------------------------------- what rolls

LYING = (math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0)  # the axis of a cylinder along y
SIZE = Box((8.0, 8.0, 1.0))


def on_a_plane(shape, height, angle, orientation=(1.0, 0.0, 0.0, 0.0), **law):
    """A body of a kilogram on an obstacle whose upper side is at z = 0, under gravity as on a slope."""
    floor = obstacle(SIZE, "floor", (0.0, 0.0, -0.5))
    return touching([placed(shape, 1.0, "one", (0.0, 0.0, height), orientation)], [floor], gravity=along(angle), **law)


@pytest.mark.parametrize(
    ("shape", "orientation", "share", "points"),
    [
        (Sphere(RADIUS), (1.0, 0.0, 0.0, 0.0), 5 / 7, 1),
        (Cylinder(RADIUS, 0.2), LYING, 2 / 3, 2),
        (Capsule(RADIUS, 0.2), LYING, None, 2),
    ],
)
@pytest.mark.parametrize("penetration", [5e-4, 5e-6])
def test_what_is_round_rolls_down_an_obstacle(shape, orientation, share, points, penetration):
    """The force acts midway between surfaces that overlap, so that the lever is half the depth shorter."""
    angle, duration = 0.2, 0.4
    scene = on_a_plane(shape, RADIUS, angle, orientation, penetration=penetration)
    depth = G * math.cos(angle) / (points * law_of(scene)[0])
    scene = on_a_plane(shape, RADIUS - depth, angle, orientation, penetration=penetration)
    run = run_of(scene, duration)
    time, v, late = run["time"], run["base_qd"][:, 0], run["time"] > duration / 2
    rate = np.polyfit(time[late], v[late], 1)[0] / (G * math.sin(angle))
    moment = scene.members[0].model.links[0].inertia[0 if points == 1 else 5]
    assert rate == pytest.approx(1.0 / (1.0 + moment / (RADIUS - depth / 2) ** 2), rel=1e-5)
    rigid = 1.0 / (1.0 + moment / RADIUS**2)
    assert rate == pytest.approx(rigid, rel=depth / RADIUS)
    assert share is None or rigid == pytest.approx(share, rel=1e-12)
    assert abs(run["base_q"][-1, 1]) < 1e-9


def circling(radius, thickness, tilt, way, mass=1.0):
    """Turning rate about the vertical [rad/s], velocity of the center and body rates of a disc that rolls in a circle.

    Its axis is `tilt` [rad] from level, and its center at (0, way) of the vertical axis of the circle through 0.
    The rim's lower edge touches.  With the axis e, angular momentum H and the contact at c from the center,
    W z x H = c x m (g z - W^2 way ...): one equation for the rate W.
    """
    axial, across = 0.5 * mass * radius**2, mass * (3 * radius**2 + thickness**2) / 12
    e = np.array([0.0, math.cos(tilt), math.sin(tilt)])  # away from the circle's center, and up
    down = np.array([0.0, math.sin(tilt), -math.cos(tilt)])
    c, z, out = radius * down - 0.5 * thickness * e, np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])

    def motion(rate):
        v = np.array([-rate * way, 0.0, 0.0])
        # v + (W z + s e) x c = 0, along x
        spin = -(v + np.cross(rate * z, c))[0] / np.cross(e, c)[0]
        return v, rate * z + spin * e

    def missing(rate):
        _, w = motion(rate)
        H = across * w + (axial - across) * (w @ e) * e
        force = mass * (G * z - rate**2 * way * out)
        return (np.cross(rate * z, H) - np.cross(c, force))[0]

    rate = brentq(missing, 0.1, 100.0, xtol=1e-14)
    return rate, *motion(rate)


@pytest.mark.parametrize("penetration", [1e-4, 1e-5])
def test_a_disc_rolls_in_a_circle(penetration):
    """Tilted and steady: radius and speed are those of a rigid disc, with an error that falls with the penetration."""
    thickness, tilt, way = 2e-3, 0.35, 0.3
    rate, v, w = circling(0.1, thickness, tilt, way)
    turn = (math.cos(0.5 * (tilt - math.pi / 2)), math.sin(0.5 * (tilt - math.pi / 2)), 0.0, 0.0)  # z of it is e
    height = 0.1 * math.cos(tilt) + 0.5 * thickness * math.sin(tilt)
    one = placed(Cylinder(0.1, thickness), 1.0, "disc", (0.0, way, height), turn)
    floor = [obstacle(SIZE, "floor", (0.0, 0.0, -0.5))]
    scene = touching([one], floor, gravity=DOWN, penetration=penetration, load=4.0)  # on one point of four
    depth = G / law_of(scene)[0]
    one = placed(Cylinder(0.1, thickness), 1.0, "disc", (0.0, way, height - depth), turn)
    scene = touching([one], floor, gravity=DOWN, penetration=penetration, load=4.0)
    c, s = math.cos(tilt - math.pi / 2), math.sin(tilt - math.pi / 2)
    own = np.array([[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]]) @ w
    run = run_of(scene, 1.0, {"disc": (*v, *own)}, rtol=1e-8)
    turned, at = rate * run["time"], run["base_q"][:, :2]
    np.testing.assert_allclose(at, way * np.stack([-np.sin(turned), np.cos(turned)], axis=1), atol=10 * depth)
    np.testing.assert_allclose(np.linalg.norm(run["base_qd"][:, :2], axis=1), np.linalg.norm(v), rtol=10 * depth / 0.1)


# ---------------------------------------------------------------------------------------------- what slides


def stacked(angle, friction, penetration=1e-6, integrator="extrapolation", timestep=None):
    """A plate of a kilogram on an obstacle and a block of half of that on it, at rest but for friction's bristles.

    friction: of plate and obstacle, and of block and plate.
    """
    unit, (lower, upper) = penetration * math.cos(angle), friction
    members = [
        placed(Box((1.0, 0.5, 0.02)), 1.0, "plate", (0.0, 0.0, 0.01 - 1.5 * unit), friction=1.0),
        placed(Box((0.1, 0.1, 0.04)), 0.5, "block", (0.0, 0.0, 0.04 - 2.0 * unit), friction=upper**2),
    ]
    floor = obstacle(SIZE, "floor", (0.0, 0.0, -0.5), friction=lower**2)  # the pair has the geometric mean
    return touching(members, [floor], integrator, timestep, gravity=along(angle), penetration=penetration)


@pytest.mark.parametrize("lower", [0.98, 1.02])
@pytest.mark.parametrize("upper", [0.98, 1.02, 0.5])
def test_a_block_on_a_plate_on_a_slope_slides_where_friction_ends(lower, upper):
    """Friction is given in tangents of the slope; what slides is as fast as the difference asks for."""
    angle = 0.3
    tangent, weight = math.tan(angle), G * math.cos(angle) * math.tan(angle)
    scene = stacked(angle, (lower * tangent, upper * tangent))
    run = run_of(scene, 0.1, rtol=1e-8)
    late = run["time"] > 0.02
    rates = [np.polyfit(run["time"][late], run["base_qd"][late, k, 0], 1)[0] / weight for k in (0, 1)]
    # Each moves on with what friction leaves; the block slides on the plate where it would be the faster one.
    together = max(0.0, 1.0 - lower)
    plate, block = max(0.0, 1.0 - 1.5 * lower + 0.5 * upper), 1.0 - upper
    exact = (plate, block) if block > together else (together, together)
    np.testing.assert_allclose(rates, exact, atol=1e-4)


def falling_plank(angle, friction, penetration=1e-6, mass=4.0):
    """A plank that is level and slides down along an angle, and a block of a kilogram on it."""
    links = (Link("rail", 1.0), Link("plank", mass, inertia=(0.1, 0.0, 0.0, 0.1, 0.0, 0.1)))
    axis = (math.cos(angle), 0.0, -math.sin(angle))
    joint = Joint("slide", "prismatic", "rail", "plank", axis=axis)
    shape = Shape("plank", Box((1.0, 0.5, 0.02)), xyz=(0.0, 0.0, -0.01), friction=friction)
    depth = penetration * (1.0 - math.sin(angle) ** 2)
    model = Model("plank", links, (joint,), shapes=(shape,))
    block = placed(Box((0.1, 0.1, 0.1)), 1.0, "block", (0.0, 0.0, 0.05 - depth), friction=friction)
    return touching([Placed(model), block], gravity=DOWN, penetration=penetration, load=1.0)


@pytest.mark.parametrize("share", [0.9, 0.999, 1.02])
def test_a_block_slips_on_a_plank_that_is_pulled_away_where_mu_g_is_less(share):
    """The plank slides down along an angle of 0.4 rad and pulls the block along, up to a friction of tan 0.4.

    In axes that fall with the plank the block weighs g (1 - sin^2), and is pulled by g sin cos.
    """
    angle, mass = 0.4, 4.0
    c, s, mu = math.cos(angle), math.sin(angle), share * math.tan(0.4)
    run = run_of(falling_plank(angle, mu, mass=mass), 0.05, rtol=1e-8, record=("base_q", "base_qd", "q", "qd"))
    late = run["time"] > 0.02
    rate, block = (np.polyfit(run["time"][late], v[late], 1)[0] for v in (run["qd"][:, 0], run["base_qd"][:, -1, 0]))
    # mass A = (mass g + N) s - mu N c with N = g - A s, unless both fall as one
    fall = G * (mass * s + s - mu * c) / (mass + s * (s - mu * c)) if share < 1.0 else G * s
    pull = mu * (G - fall * s) if share < 1.0 else G * s * c
    assert rate == pytest.approx(fall, rel=1e-5)
    assert block == pytest.approx(pull, rel=1e-5)
    if share < 1.0:
        assert block < fall * c


@pytest.mark.parametrize(("share", "slips"), [(0.98, True), (1.02, False)])
def test_a_rod_leans_on_a_wall_where_friction_below_holds_it(share, slips):
    """A capsule on a rough floor and against a smooth wall: the moments about its foot say how much it needs."""
    angle, length, penetration = 1.0, 0.4, 1e-5
    c, s = math.cos(angle), math.sin(angle)
    need = 0.5 * length * c / (length * s + RADIUS)
    rod = placed(Capsule(RADIUS, length), 1.0, "rod", (-0.5 * length * c - RADIUS, 0.0, 0.5 * length * s + RADIUS),
                 (math.cos(0.5 * (math.pi / 2 - angle)), 0.0, math.sin(0.5 * (math.pi / 2 - angle)), 0.0),
                 friction=share * need)  # fmt: skip
    walls = [obstacle(SIZE, "floor", (0.0, 0.0, -0.5), friction=share * need),
             obstacle(Box((1.0, 8.0, 8.0)), "wall", (0.5, 0.0, 0.0), friction=0.0)]  # fmt: skip
    scene = touching([rod], walls, gravity=DOWN, penetration=penetration)
    run = run_of(scene, 0.3, rtol=1e-8)
    moved = run["base_q"][-1] - run["base_q"][len(run["time"]) // 2]
    assert (np.abs(moved).max() > 1e-3) == slips
    if not slips:
        assert np.abs(moved).max() < 1e-7
