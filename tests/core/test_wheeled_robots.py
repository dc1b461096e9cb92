"""Robots on wheels against the closed forms of their kinematics."""

import math

import numpy as np
import pytest

from featherstone_gait import ContactPoint, Ground, Joint, Link, Model, compile_scene, initial_state, simulate

RADIUS, TRACK = 0.05, 0.3


def cart():
    """Return a cart with two wheels on one axle and a caster that slides before and behind it."""
    inertia = (0.01, 0.0, 0.0, 0.02, 0.0, 0.02)
    links, joints, points = [Link("cart", 2.0, (0.0, 0.0, 0.0), inertia)], [], []
    for name, y in (("left", 0.5 * TRACK), ("right", -0.5 * TRACK)):
        links.append(Link(name, 0.2, (0.0, 0.0, 0.0), (1.3e-4, 0.0, 0.0, 2.5e-4, 0.0, 1.3e-4)))
        joints.append(Joint(name, "continuous", "cart", name, xyz=(0.0, y, 0.0), axis=(0.0, 1.0, 0.0)))
        points.append(ContactPoint(name, (0.0, 0.0, 0.0), circle_radius=RADIUS, axis=(0.0, 1.0, 0.0), friction=0.8))
    for x in (-0.15, 0.15):
        points.append(ContactPoint("cart", (x, 0.0, -RADIUS), friction=0.0))
    return Model("cart", tuple(links), tuple(joints), "floating", contacts=tuple(points))


@pytest.mark.long
def test_a_differential_drive_turns_about_the_point_that_its_wheels_say():
    """Torques bring it to speed without slip; then it rolls along a circle of radius v / w for good."""
    scene = compile_scene(cart(), ground=Ground(penetration=1e-5), fall_height=-1e6)
    run = simulate(scene, 1.0, initial_state(scene), tau=[0.02, 0.03], record=("qd", "base_qd"), rtol=1e-8)
    left, right = run["qd"][-1]
    v, w = 0.5 * RADIUS * (left + right), RADIUS * (right - left) / TRACK
    speed, turning = np.hypot(*run["base_qd"][-1, :2]), run["base_qd"][-1, 5]
    assert [speed, turning] == pytest.approx([v, w], rel=1e-5)
    coasting = simulate(scene, 3.0, run, record=("base_q", "base_qd"), rtol=1e-8)
    v, w = np.hypot(*coasting["base_qd"][-1, :2]), coasting["base_qd"][-1, 5]
    assert [v, w] == pytest.approx([speed, turning], rel=1e-5)  # it loses nothing
    x, y = coasting["base_q"][:, :2].T
    solved = np.linalg.lstsq(np.stack([2 * x, 2 * y, np.ones(len(x))], axis=1), x * x + y * y, rcond=None)[0]
    radius = math.sqrt(solved[2] + solved[0] ** 2 + solved[1] ** 2)
    assert radius == pytest.approx(v / w, rel=1e-5)


def platform(wheels):
    """Return a body on wheels with rollers: x, y, heading of each wheel's way [rad] and angle of its rollers [rad]."""
    links, joints, points = [Link("body", 4.0, (0.0, 0.0, 0.0), (0.03, 0.0, 0.0, 0.05, 0.0, 0.07))], [], []
    for k, (x, y, heading, angle) in enumerate(wheels):
        links.append(Link(f"w{k}", 0.2, (0.0, 0.0, 0.0), (1.4e-4, 0.0, 0.0, 2.5e-4, 0.0, 1.4e-4)))
        place, turn = (x, y, 0.0), (0.0, 0.0, heading)
        joints.append(Joint(f"j{k}", "continuous", "body", f"w{k}", place, turn, (0.0, 1.0, 0.0)))
        points.append(ContactPoint(f"w{k}", (0.0, 0.0, 0.0), 0.0, RADIUS, (0.0, 1.0, 0.0), roller_angle=angle))
    return Model("platform", tuple(links), tuple(joints), "floating", contacts=tuple(points))


def mecanum(a, b):
    return [(x, y, 0.0, -math.copysign(math.pi / 4, x * y)) for x in (a, -a) for y in (b, -b)]


def omni(radius, count, first=0.0):
    turns = [first + 2.0 * math.pi * k / count for k in range(count)]
    return [(radius * math.cos(t), radius * math.sin(t), t + 0.5 * math.pi, math.pi / 2) for t in turns]


SIZES = (0.15, 0.12), (0.1, 0.2), (0.25, 0.25), (0.2, 0.1), (0.3, 0.15)  # [m]
COUNTS = (3, 0.15), (3, 0.3), (4, 0.2), (5, 0.2), (6, 0.25)
BASES = {f"mecanum {a} {b}": mecanum(a, b) for a, b in SIZES}
BASES |= {f"omni {count} {r}": omni(r, count, 0.1) for count, r in COUNTS}


@pytest.mark.long
@pytest.mark.parametrize("base", BASES)
def test_wheels_with_rollers_move_a_base_as_their_kinematics_say(base):
    """Rollers leave free what is across their axes: along these each wheel holds the body to the speed of its rim."""
    wheels = BASES[base]
    scene = compile_scene(platform(wheels), ground=Ground(friction=0.9, penetration=1e-5), fall_height=-1e6)
    start = initial_state(scene)
    scene.state_view(start).base_q[2] = RADIUS - 1e-5
    run = simulate(scene, 1.0, start, tau=[0.05] * len(wheels), record=("base_q", "base_qd", "qd"), rtol=1e-8)
    assert run.ok
    x, y, heading, angle = np.array(wheels).T
    along = heading + 0.5 * math.pi + angle  # of the rollers' axes on the ground
    rows = np.stack([np.cos(along), np.sin(along), x * np.sin(along) - y * np.cos(along)], axis=1)
    rims = RADIUS * run["qd"][-1] * np.cos(along - heading)
    v = np.linalg.lstsq(rows, rims, rcond=None)[0]
    yaw = 2.0 * math.atan2(run["base_q"][-1, 6], run["base_q"][-1, 3])
    c, s = math.cos(yaw), math.sin(yaw)
    vx, vy, w = run["base_qd"][-1, [0, 1, 5]]
    assert np.abs([c * vx + s * vy, c * vy - s * vx, w] - v).max() < 1e-4 * np.abs(v).max()
    if base.startswith("mecanum"):  # by symmetry it goes straight
        assert np.abs([run["base_q"][-1, 1], yaw]).max() < 1e-6
